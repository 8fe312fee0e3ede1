"""Finds the size at which a case's effects have the strength that was drawn, and measures it in both of its logs."""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from castor_envs.effects.clocks import SampleJitter
from castor_envs.errors import InputError
from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import Log
from castor_envs.vehicles.presets import preset
from discrepancy.trials.cases import Case
from discrepancy.trials.generators import Generator
from discrepancy.trials.hidden import Hidden, Outside, catalogued, class_of, outside_in
from discrepancy.trials.outside import Misreading
from discrepancy.trials.reading import EXACT
from discrepancy.trials.strength.separation import StrengthMetric, apart, is_physical
from discrepancy.validation import cost

CLOSE = 1.5
"""Factor between drawn and measured strength above which the size is corrected, once: every run costs seconds, scores
use the measured strength, and the draw only sets its spread over cases."""

FASTER = 1e-4
"""Part by which the second run of a floor is faster."""

OVER_FLOOR = 3.0
"""Least strength of effects on the physics, as a multiple of the floor (the z between two runs without effect)."""


@dataclass(frozen=True, eq=False)
class Strength:
    """Strength of the hidden effects in one log. cost: m per 10 m, of each; z, z_sep: of each beside the other hidden
    effects; nearest: the class at the distance z_sep. A z that is not well above the floor is 0, and so is its z_sep.

    cosine: of the first effect's signal with the nearest class of the catalogue; None without a signal. floor: z
    between two runs without effect; None where no hidden effect changes the motion.
    """

    cost: tuple[float, ...]
    z: tuple[float, ...]
    z_sep: tuple[float, ...]
    nearest: tuple[str, ...]
    cosine: float | None
    floor: float | None


class TrialRun:
    """One of a case's two motions, driven by the nominal robot and by robots with effects.

    like: the run of the other motion, whose floor serves for both.
    """

    def __init__(
        self, case: Case, log_number: int, generator: Generator, duration: float, like: "TrialRun | None" = None
    ) -> None:
        self._like = like
        self.robot, self.seed, self.reference = preset(case.robot), case.seeds[log_number], case.reference
        self._motion, self._drive, self._duration = case.motion(log_number, duration), generator.drive, duration
        self._driven: dict[tuple[tuple[Hidden, ...], float], Log] = {}

    def drive(self, *hidden: Hidden, faster: float = 0.0) -> Log:
        """Return the exact log of the robot with effects, perhaps a little faster; raises ValueError where the robot
        gets lost.

        Logs are cached.
        """
        if (key := (hidden, faster)) not in self._driven:
            runs = [dataclasses.replace(run, speed=run.speed * (1.0 + faster)) for run in self._motion.runs]
            log = self._drive(
                self.robot.with_effects(*catalogued(hidden)),
                dataclasses.replace(self._motion, runs=tuple(runs)),
                self.seed,
                duration=self._duration,
                outside=outside_in(hidden),
                rounded=False,
                noise=EXACT,
            )
            if not (np.isfinite(log.wheel).all() and np.isfinite(log.pivot).all()):
                raise ValueError("the simulation did not hold")
            self._driven[key] = log
        return self._driven[key]

    @cached_property
    def nominal(self) -> Log:
        """The log of the robot without effects."""
        return self.drive()

    @cached_property
    def metric(self) -> StrengthMetric:
        """The metric of the robot without effects."""
        return StrengthMetric(self.robot, self.nominal, reference=self.reference)

    @cached_property
    def floor(self) -> float:
        """The z between two runs without effect.

        Simulators repeat themselves to the last bit, and the draws of a seed (start angles, phases) are the same with
        and without an effect. So the second run drives the same motion faster by `FASTER`: this shows how much
        residuals depend on small changes, such as the sense in which a castor swings round.
        """
        if self._like is not None:
            return self._like.floor
        return float(np.linalg.norm(self.metric.signal(self.drive(faster=FASTER))))

    def made(self, hidden: Hidden) -> Log:
        """Return the exact log with one hidden effect: on a new run if it changes the motion (`_moves`), else on the
        nominal run."""
        return self.drive(hidden) if self._moves(hidden) else self.metric.read(hidden)

    def z(self, hidden: Hidden) -> float:
        """Return z of one hidden effect; 0 where it is not well above the floor."""
        if isinstance(hidden, SampleJitter):
            return self.metric.jitter_strength(hidden.value)
        return self._above_floor(hidden, float(np.linalg.norm(self.metric.signal(self.made(hidden)))))

    def cost(self, hidden: Hidden) -> float:
        """Return the cost in use of ignoring one hidden effect, m per 10 m.

        For an effect outside the catalogue: the distance between odometry with and without it. Where it changes the
        motion: the distance of odometry from the reference, less that of the nominal robot, in quadrature.
        """
        if not isinstance(hidden, Outside):
            return cost.cost_of(self.robot, hidden, [self.nominal]) or 0.0

        def off(path: Array | None, log: Log) -> float:
            assert path is not None  # exact logs have a pose in every row
            return cost.rms_of([cost.apart(path, cost.odometry(self.robot, log))]) or 0.0

        real, nominal = self.made(hidden), self.nominal
        if not self._moves(hidden):
            return off(cost.odometry(self.robot, nominal), real)
        return float(np.sqrt(max(off(real.reference, real) ** 2 - off(nominal.reference, nominal) ** 2, 0.0)))

    def strength(self, hidden: tuple[Hidden, ...]) -> Strength:
        """Return the strengths of hidden effects, z and z_sep each with the other effects projected out."""
        metric, nothing = self.metric, np.zeros_like(self.metric.signal(self.nominal))
        signals = [nothing if isinstance(item, SampleJitter) else metric.signal(self.made(item)) for item in hidden]
        alone, z, z_sep, nearest = apart(signals), [], [], []
        for k, item in enumerate(hidden):
            if isinstance(item, SampleJitter):  # nothing else looks like it
                z.append(metric.jitter_strength(item.value))
                z_sep.append(z[k])
                nearest.append("")
                continue
            z.append(self._above_floor(item, alone[k]))
            far, name = metric.separation(signals[k], class_of(item), *signals[:k], *signals[k + 1 :])
            z_sep.append(far if z[k] > 0 else 0.0)
            nearest.append(name)
        return Strength(
            tuple(map(self.cost, hidden)),
            tuple(z),
            tuple(z_sep),
            tuple(nearest),
            metric.cosine(signals[0]) if signals[0].any() else None,
            self.floor if any(map(self._moves, hidden)) else None,
        )

    def _above_floor(self, hidden: Hidden, size: float) -> float:
        """Return a norm less the floor, in quadrature, where the physics differ; 0 below `OVER_FLOOR` times it."""
        if not self._moves(hidden):
            return size
        return float(np.sqrt(size**2 - self.floor**2)) if size > OVER_FLOOR * self.floor else 0.0

    def _moves(self, hidden: Hidden) -> bool:
        """Whether a hidden effect changes the motion: on the robot itself, or on what its castors are steered by.

        A castor that is steered by a wrong reading points elsewhere, and its reading is as commanded.
        """
        if isinstance(hidden, Outside):
            physical = not isinstance(hidden, Misreading)
        else:
            physical = is_physical(self.robot, hidden)
        if physical or not self.robot.driven_castors or isinstance(hidden, SampleJitter):
            return physical
        return not np.array_equal(self.metric.read(hidden).pivot, self._unchanged.pivot)

    @cached_property
    def _unchanged(self) -> Log:
        """The nominal run as sensors without effects report it."""
        return self.metric.read()


def solve_size(case: Case, trial_run: TrialRun) -> Case | None:
    """Return a case with its hidden effects in sizes of about the strength that was drawn; None where they cannot have
    it."""
    measure = {"cost": trial_run.cost, "z": trial_run.z}[case.measure]
    hidden = list(case.hidden)
    try:
        for k, target in enumerate(case.targets):
            begun = _begun(hidden[k], target, trial_run) if case.measure == "z" else hidden[k]
            hidden[k] = _sized(begun, target, measure, trial_run)
    except (InputError, ValueError, ArithmeticError):
        return None
    return dataclasses.replace(case, hidden=tuple(hidden))


def _sized(hidden: Hidden, target: float, measure: Callable[[Hidden], float], trial_run: TrialRun) -> Hidden:
    """Return a hidden effect in about the size at which a measure of it is the target; raises ValueError where there is
    none.

    The size is scaled in proportion (to its power), then corrected once.
    """
    slope, before = hidden.power if isinstance(hidden, Outside) else 1.0, None
    for _ in range(2):
        if not (measured := measure(hidden)) > 0.0:
            raise ValueError(f"{class_of(hidden)} does not show")
        if 1 / CLOSE < measured / target < CLOSE:
            break
        point = np.log([abs(hidden.value), measured])
        if before is not None and abs(point[0] - before[0]) > 1e-9:
            slope = float((point[1] - before[1]) / (point[0] - before[0])) or slope
        before = point
        size = float(hidden.value * np.exp(np.log(target / measured) / slope))
        hidden = dataclasses.replace(hidden, value=size)
        trial_run.robot.with_effects(*catalogued([hidden])).as_built()  # raises for a size that it cannot have
    return hidden


def _begun(hidden: Hidden, target: float, trial_run: TrialRun) -> Hidden:
    """Return a start: a physical effect in the size that its signature requires; other effects in the size of their
    step."""
    if isinstance(hidden, Outside | SampleJitter) or not is_physical(trial_run.robot, hidden):
        return hidden
    alone = float(np.linalg.norm(trial_run.metric.signature(hidden)))
    if alone * abs(hidden.value) <= 0.01:
        return hidden
    return dataclasses.replace(hidden, value=float(np.copysign(target / alone, hidden.value)))
