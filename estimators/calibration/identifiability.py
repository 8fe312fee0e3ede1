"""Identifiability: changes of a robot's parameters that logs do not show, in words, and the drives that would show
them."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from castor_envs.errors import InputError
from castor_envs.geometry.arrays import Array
from castor_envs.motion.rolling import Rolled, roll
from estimators.calibration.drives import DRIVES, REFERENCE, TYPICAL, Poses, logged
from estimators.calibration.maximum_likelihood.calibrate import Calibration, information_of
from estimators.calibration.parameters import Parameter

WHOLLY, HARDLY = 0.99, 0.3
"""Length of a change's part in the unseen directions above which the change is unseen, and below which it is seen."""

WELL = 0.01
"""Largest standard error (see `UNSEEN` of the maximum-likelihood method) after a drive that is proposed."""


COVERAGE = 1.96
"""Standard errors on either side of a 95 % interval."""

FILE = 1.0
"""Prior standard deviation of an unseen change, in parts of the scales: no robot file is off by a whole length."""

NOTHING = 0.5
"""Standard error, in parts of the scales, above which logs hold no information on a change."""

RESTS = 0.5
"""Part of a parameter's standard error: a change that moves it by more would widen its interval by over a tenth."""


class Unseen(NamedTuple):
    """A change of the parameters that the logs do not show.

    shown_by: the simplest drive that would show it; None: no drive. moves (P,): standard deviations of the change that
    these logs alone leave, in parts of the parameters' scales. width: its 95 % interval, as text; "" if it has no unit.
    """

    what: str
    shown_by: str | None
    moves: Array
    width: str = ""

    def __str__(self) -> str:
        text = f"{self.what} ({self.width})" if self.width else self.what
        if self.shown_by is None:
            return f"{text}: makes no difference to any drive; keeps the robot file's numbers"
        return f"{text}: keeps the robot file's numbers; {self.shown_by} would show it"


def unseen_of(calibration: Calibration) -> tuple[Unseen, ...]:
    """Return the changes that the logs of a calibration do not show; empty if they show all parameters."""
    left, parameters = calibration.unseen, calibration.parameters
    changes: list[tuple[str, Array]] = []
    for name, change in _known_changes(parameters, calibration.before):
        part = left @ change
        if len(left) and np.linalg.norm(part) > WHOLLY:
            changes.append((name, change[None]))
            # The rest: all unseen directions at right angles to this one.
            left = np.linalg.svd(part[None])[2][1:] @ left
    if len(left):
        concerned = np.linalg.norm(left, axis=0) > HARDLY
        names = [p.name for p, is_in in zip(parameters, concerned, strict=True) if is_in]
        changes.append(
            (f"{len(left)} combinations of {', '.join(names)}" if len(left) > 1 else " against ".join(names), left)
        )
    drives, spread = _Drives(calibration), np.linalg.inv(calibration.information + np.eye(len(parameters)) / FILE**2)
    found = []
    for name, change in changes:
        moves = np.sqrt(np.diag(change.T @ (change @ spread @ change.T) @ change))
        found.append(Unseen(name, drives.showing(change), moves, _width(parameters, moves)))
    return tuple(found)


def rests_on(calibration: Calibration, unseen: Sequence[Unseen]) -> list[tuple[Unseen, ...]]:
    """Return for every parameter the unseen changes in which its interval assumes that the robot file is right."""
    scale = np.array([p.scale for p in calibration.parameters])
    moved = [effect.moves * scale > RESTS * calibration.standard_errors for effect in unseen]
    return [tuple(effect for effect, by in zip(unseen, moved, strict=True) if by[i]) for i in range(len(scale))]


def _width(parameters: Sequence[Parameter], moves: Array) -> str:
    """Return the 95 % interval of an unseen change, of the parameter that it moves most."""
    units = {p.unit for p, by in zip(parameters, moves, strict=True) if by > HARDLY * moves.max()}
    if np.linalg.norm(moves) > NOTHING:
        return "these logs say nothing of it"
    if len(units) > 1:
        return ""
    widest = COVERAGE * float(moves.max())
    return f"± {100 * widest:.2g} %" if units == {"m"} else f"± {np.degrees(widest):.2g} deg"


def scale_rests_on_pivots(calibration: Calibration) -> bool:
    """Whether all lengths are only as good as the pivots' places in the robot file: no pose, no pivot found."""
    kinds = {p.kind for p in calibration.parameters}
    free = any(castor.steering == "free" for castor in calibration.robot.castors)
    return free and not calibration.poses and "pivot_x" not in kinds


def _known_changes(parameters: tuple[Parameter, ...], values: Array) -> Iterator[tuple[str, Array]]:
    """Yield changes with a name, in parts of the scales, of length 1."""
    scale = np.array([p.scale for p in parameters])
    kind = np.array([p.kind for p in parameters])
    pivot = {(p.castor, p.kind): value for p, value in zip(parameters, values, strict=True)}
    turned = {
        "pivot_x": lambda p: pivot.get((p.castor, "pivot_y"), 0.0),
        "pivot_y": lambda p: -pivot.get((p.castor, "pivot_x"), 0.0),
        "pivot_zero": lambda _: 1.0,
        "angle": lambda _: -1.0,
    }
    lengths = np.array([p.unit == "m" for p in parameters])
    # Without a pivot encoder the wheels' lateral positions define the axle's middle.
    sideways = (kind == "lateral") & ("pivot_zero" not in kind)
    named = [
        ("the scale (all lengths together)", np.where(lengths, values, 0.0)),
        ("the direction of the body's axes", np.array([turned.get(p.kind, lambda _: 0.0)(p) for p in parameters])),
        ("the place of the body's origin, x", np.where(kind == "pivot_x", 1.0, 0.0)),
        ("the place of the body's origin, y", np.where(kind == "pivot_y", 1.0, 0.0)),
        ("the place of the body's origin, y", np.where(sideways, 1.0, 0.0)),
        *((p.name, np.where(np.arange(len(parameters)) == i, 1.0, 0.0)) for i, p in enumerate(parameters)),
    ]
    for name, change in named:
        length = np.linalg.norm(change / scale)
        if length > 0:
            yield name, change / scale / length


class _Drives:
    """Drives of the calibrated robot, simple ones first; the information of each is computed on demand."""

    def __init__(self, calibration: Calibration):
        self._calibration = calibration
        self._robot = calibration.calibrated
        self._rolled: dict[str, list[Rolled]] = {}
        self._told: dict[str, Array | None] = {}

    def showing(self, changes: Array) -> str | None:
        """Return the first drive after which all of these changes (c, P) would be seen."""
        for poses, reference in REFERENCE.items():
            for drive in DRIVES:
                name = f"{drive} {reference}"
                if name not in self._told:
                    self._told[name] = self._tell(drive, poses)
                told = self._told[name]
                if told is None:
                    continue
                strength, way = np.linalg.eigh(self._calibration.information + told)
                if np.linalg.norm(changes @ way[:, strength < WELL**-2], axis=1).max() < HARDLY:
                    return name
        return None

    def _tell(self, drive: str, poses: Poses) -> Array | None:
        """Return the information (P, P) of a drive; None if the robot cannot drive it."""
        if drive not in self._rolled:  # the same whether poses are taken or not
            try:
                self._rolled[drive] = [roll(self._robot, trajectory) for trajectory in DRIVES[drive](self._robot)]
            except InputError:
                self._rolled[drive] = []
        if not self._rolled[drive]:
            return None
        logs = [logged(self._robot, rolled, poses) for rolled in self._rolled[drive]]
        return information_of(self._robot, self._calibration.parameters, logs, TYPICAL, self._calibration.creeps)
