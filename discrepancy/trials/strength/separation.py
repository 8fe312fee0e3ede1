"""z: the strength of an effect in a log, in standard deviations; z_sep: its distance from every other effect.

    z = |P W (r_with - r_without)|        z_sep = min over other effects of |that, less its projection on their signals|

r: residuals of the robot file without the effect (`whitening`), of logs with and without it, counts not rounded, no
noise of the reference. W whitens them by the declared noise (`whitening`). P projects out what any diagnosis fits
anyway: the reference's clock offset and the tracked point (x, y and yaw on the body). Steps of the reference do not
depend on the start pose; there are none in a log without a reference.
"""

import dataclasses
from collections.abc import Sequence
from functools import cached_property

import numpy as np
from scipy import sparse

from castor_envs.effects.catalogue import (
    catalogue,
    creep_compliance_of,
    floor_of,
    radii_of,
    readings,
    reference,
    slip_of,
)
from castor_envs.effects.clocks import SampleJitter
from castor_envs.errors import InputError
from castor_envs.floor import Floor
from castor_envs.geometry.arrays import Array
from castor_envs.geometry.se2 import compose
from castor_envs.geometry.steps import Motion, Slip
from castor_envs.logs.log import Log, unwrapped
from castor_envs.motion.kinematics import Geometry
from castor_envs.physics.contact_motion import ContactMotion
from castor_envs.vehicles.effect import Effect
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.posterior.reference import KINDS
from discrepancy.trials.hidden import Hidden, catalogued, class_of, outside_in
from discrepancy.trials.reading import angles_of, counts_of
from discrepancy.trials.strength.whitening import Layout, NoiseModel, Whitening, steps_left
from discrepancy.validation.windows import Windows

SMALL = 1e-4
"""s, m and rad: changes of nuisances for numerical derivatives."""

FAINT = 1e-3
"""Standard deviations per s, m or rad: a nuisance with a smaller signal is unobservable."""

MOUNT_STEPS = 4
"""Gauss-Newton steps to fit the tracked point and yaw: from 0.5 rad off to rounding."""

LEAST = 1e-6
"""Standard deviations: an effect whose signal at its step's size is smaller is unobservable."""

FITTED_ANYWAY = frozenset(name for kind in KINDS for name in (kind.name, *kind.indistinguishable_from))
"""Effects that are nuisances, which a log alone does not tell: of an offset of all clocks only the ends of the log
remain, of the tracked point nothing."""


class StrengthMetric:
    """Measures the strength of effects on one run.

    robot: nominal. exact: a log of its run, counts not rounded, the true pose in every row; its castor angles and
    distances are used for whitening. reference: whether the finder's log has one.
    """

    def __init__(
        self, robot: RobotDescription, exact: Log, noise_model: NoiseModel | None = None, *, reference: bool = True
    ) -> None:
        self.robot, self.exact = robot.as_described(), exact
        self._geometry = Geometry.of(self.robot)
        period = float(np.median(np.diff(exact.t)))
        self._layout = Layout(len(exact), period, reference=reference)
        windows = self._windows(self._geometry, exact)
        self._whitening = Whitening(self._layout, windows, exact, noise_model or NoiseModel())
        self._base = self._residuals(windows, exact)
        self._by_nuisance = np.stack([self._nuisance(k) for k in range(4)], axis=-1)
        seen = np.linalg.norm(self._by_nuisance, axis=0) > FAINT
        self._by_nuisance[:, ~seen] = 0.0

    def signal(self, log: Log) -> Array:
        """Return the whitened residuals of a log less those of the metric's run, nuisances projected out.

        The tracked point and the tracker's yaw are fitted first: they may be far from their linear range, as where a
        pivot's bias turns the body of a robot with one castor.
        """
        mount = np.zeros(3)
        for _ in range(MOUNT_STEPS if self._by_nuisance.any() and log.reference is not None else 0):
            away = self._whitening.whitened(np.nan_to_num(self._of(_mounted(log, mount)) - self._base))
            mount -= np.linalg.lstsq(self._by_nuisance, away, rcond=1e-9)[0][1:]
        return self._cleared(np.nan_to_num(self._of(_mounted(log, mount)) - self._base))

    def read(self, *hidden: Hidden) -> Log:
        """Return the metric's run as sensors with these effects report it, the physics unchanged."""
        robot, exact = self.robot.with_effects(*catalogued(hidden)), self.exact
        assert exact.reference is not None
        angle, pose, w = angles_of(self.robot, exact), exact.reference, len(robot.wheels)
        if (outside := outside_in(hidden)) is not None:
            angle, pose = outside.changed(robot, exact.t, angle, pose), outside.tracked(exact.t, pose)
        angle = np.column_stack(readings(robot, exact.t, angle[:, :w], angle[:, w:]))
        wheel, pivot = counts_of(robot, angle)
        return dataclasses.replace(exact, wheel=wheel, pivot=pivot, reference=reference(robot, exact.t, pose))

    def signature(self, effect: Effect) -> Array:
        """Return the signal per unit of an effect, to first order.

        For an effect on the robot's dimensions or contacts: the decrease of the residuals of the same counts as the
        dimensions change and as contacts slip as predicted.
        """
        real = self.robot.with_effects(effect)
        if not is_physical(self.robot, effect):
            return self.signal(self.read(effect)) / effect.value
        slip = slip_of(ContactMotion(real, self._motion))
        windows = self._windows(Geometry.of(real.as_built()), self.exact, slip)
        return self._cleared(self._base - self._residuals(windows, self.exact)) / effect.value

    @cached_property
    def _motion(self) -> Motion:
        angle, w = angles_of(self.robot, self.exact), len(self.robot.wheels)
        angle[:, [k for k in range(w) if k not in self.robot.driven_wheels]] = np.nan
        assert self.exact.reference is not None
        return Motion(self.exact.t, self.exact.reference, angle[:, :w], angle[:, w:])

    @cached_property
    def signatures(self) -> dict[str, Array]:
        """Signatures (size, k), of length 1, of each class of the catalogue that is observable on this run."""
        found: dict[str, list[Array]] = {}
        for effect in catalogue(self.robot):
            if effect.wiring or effect.name in FITTED_ANYWAY or isinstance(effect, SampleJitter):
                continue
            try:
                signature = self.signature(effect)
            except InputError:
                continue
            length = float(np.linalg.norm(signature))
            if length * abs(effect.value) > LEAST:
                found.setdefault(class_of(effect), []).append(signature / length)
        return {name: np.stack(signature, axis=-1) for name, signature in found.items()}

    def separation(self, signal: Array, class_name: str, *nuisances: Array) -> tuple[float, str]:
        """Return z_sep of a signal of the class `class_name`, and the nearest other class.

        nuisances: signals of further effects in the log; they are projected out.
        """
        left = {
            name: float(np.linalg.norm(without(signal, signature, *nuisances)))
            for name, signature in self.signatures.items()
            if name != class_name
        }
        nearest = min(left, key=left.__getitem__)
        return left[nearest], nearest

    def cosine(self, signal: Array) -> float:
        """Return the largest cosine between a signal and the span of a class of the catalogue."""
        least, _ = self.separation(signal, "")
        return float(np.sqrt(max(1.0 - (least / np.linalg.norm(signal)) ** 2, 0.0)))

    @cached_property
    def jitter(self) -> Array:
        """The variances that jitter with a variance of 1 s^2 adds to whitened residuals, along its own axes."""
        turn = self._geometry.pivot_counts_per_rev[self._geometry.sensed]
        counts = np.column_stack([unwrapped(self.exact.pivot, turn), self.exact.wheel])
        before = np.diff(counts, axis=0) / np.diff(self.exact.t)[:, None]  # readings at other times are extrapolated
        rate = np.concatenate([before[:1], before])
        samples, channels = rate.shape
        place = np.arange(samples * channels)
        by_time = sparse.csr_array((rate.ravel(), (place, place // channels)), shape=(len(place), samples))
        spread = self._cleared(sparse.csr_array(self._whitening.by_counts @ by_time).toarray())
        return np.maximum(np.linalg.eigvalsh(spread.T @ spread), 0.0)

    def jitter_strength(self, sigma: float) -> float:
        """Return sqrt(2 KL) of the whitened residuals with jitter of `sigma` (s) from those without."""
        return gaussian_strength(sigma**2 * self.jitter)

    def _of(self, log: Log) -> Array:
        return self._residuals(self._windows(self._geometry, log), log)

    def _windows(self, geometry: Geometry, log: Log, slip: Slip | None = None) -> Windows:
        return Windows(geometry, log.wheel, log.pivot, self._layout.q, slip)

    def _residuals(self, windows: Windows, log: Log) -> Array:
        """Return parity in the frame of the metric's run, window by window, then steps."""
        parity = np.einsum("wij,wi->wj", self._whitening.null, windows.left)
        return np.concatenate([parity.ravel(), steps_left(self._layout, windows, log).ravel()])  # NaN: no pose

    def _cleared(self, residuals: Array) -> Array:
        return without(self._whitening.whitened(residuals), self._by_nuisance)

    def _nuisance(self, k: int) -> Array:
        """Return whitened derivatives by the clock's offset (0) and the tracked point's x, y, and yaw (1, 2, 3)."""
        assert self.exact.reference is not None
        t, pose = self.exact.t, self.exact.reference
        if k == 0:
            later = 2 * pose - np.stack([np.interp(t - SMALL, t, coordinate) for coordinate in pose.T], axis=-1)
            moved = dataclasses.replace(self.exact, reference=later)
        else:
            moved = _mounted(self.exact, SMALL * np.eye(3)[k - 1])
        return self._whitening.whitened(self._of(moved) - self._base) / SMALL


def _mounted(log: Log, mount: Array) -> Log:
    """Return a log whose reference is that of a tracker mounted at a pose (3,) on the body."""
    if log.reference is None or not mount.any():
        return log
    return dataclasses.replace(log, reference=compose(log.reference, mount))


def gaussian_strength(excess: Array) -> float:
    """Return sqrt(2 KL) of N(0, diag(1 + excess)) from N(0, 1)."""
    return float(np.sqrt(np.sum(excess - np.log1p(excess))))


def without(signal: Array, *spans: Array) -> Array:
    """Return a signal (size, ...) less its projection on all spans together, each (size,) or (size, k)."""
    if not spans:
        return signal
    columns = np.column_stack(spans)
    columns = columns / np.maximum(np.linalg.norm(columns, axis=0), LEAST)
    return signal - columns @ np.linalg.lstsq(columns, signal, rcond=1e-6)[0]


def is_physical(robot: RobotDescription, effect: Effect) -> bool:
    """Whether an effect changes the motion of the robot, and not only the readings of its sensors."""
    real = robot.with_effects(effect)
    built = _moving_parts(real.as_built()) != _moving_parts(robot.as_described()) or radii_of(real) is not None
    return built or floor_of(real, Floor()) != Floor() or creep_compliance_of(real) != 0.0


def _moving_parts(robot: RobotDescription) -> RobotDescription:
    """Return a robot with encoders of one kind."""
    castors = []
    for castor in robot.castors:
        wheels = [dataclasses.replace(wheel, counts_per_rev=wheel.counts_per_rev and 1.0) for wheel in castor.wheels]
        castors.append(dataclasses.replace(castor, wheels=tuple(wheels), pivot_zero=0.0))
    return dataclasses.replace(robot, castors=tuple(castors))


def apart(signals: Sequence[Array]) -> list[float]:
    """Return z of each of several signals after projecting out the others."""
    return [
        float(np.linalg.norm(without(signal, *(signature for j, signature in enumerate(signals) if j != k))))
        for k, signal in enumerate(signals)
    ]
