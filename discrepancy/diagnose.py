"""From logs to a report: the pre-flight, the diagnosis, the replay through the full simulation, the page.

Mistakes of wiring that the pre-flight finds are undone in the logs before anything else is looked for, and stand in the
robot file that is written: encoders are exchanged after all else that they do.
"""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from castor_envs.effects.catalogue import readings
from castor_envs.effects.clocks import ClockSkew, SampleJitter
from castor_envs.errors import InputError
from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry
from castor_envs.vehicles.effect import Effect
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.discriminating_drive import SeparatingDrive, separating_drives
from discrepancy.hypotheses.candidates import without
from discrepancy.posterior.finder import Diagnosis, diagnose
from discrepancy.posterior.linearise import Linearised, linearise
from discrepancy.posterior.verdicts import MATERIAL, Material
from discrepancy.preflight import Mistake, Preflight, check_logs, preflight
from discrepancy.report import answers, pictures, plain_data, sentences
from discrepancy.report.parts import names_apart
from discrepancy.report.plain_data import Data
from discrepancy.report.traces import Errors, Traces, along_the_way, traces_of
from discrepancy.validation.replay import Replay, joined, replay
from estimators.calibration.maximum_likelihood import State, straightened
from estimators.likelihood.log_likelihood import Noise

Logs = Mapping[str, Log]


@threadpool_limits.wrap(limits=1)  # of linear algebra: small matrices, for which more threads wait for each other
def posterior_of(
    robot: RobotDescription, logs: Logs, held_out: Logs, clean: Logs, material: Material = MATERIAL
) -> tuple[tuple[Mistake, ...], Diagnosis[RobotDescription, Linearised]]:
    """Return the gross mistakes in logs, and what logs without these say by `posterior.finder.diagnose`."""
    prepared = _prepared(robot, logs, held_out, clean)
    return prepared.checked.mistakes, _posterior(prepared, material)


@dataclass(frozen=True, eq=False)
class Examined:
    """The diagnosis: as data (castor-diagnosis/2), and the robot with the named effects; None if none is named.

    seen: logs, and held-out ones if there are any, each with its residuals without and with the named effects.
    nominal, explained: the robot without and with these, as logs with their wiring undone show it, but for effects on
    time. replays: of the logs, without and with it. drives: those that would separate ambiguous answers.
    """

    data: Data
    found: RobotDescription | None
    seen: Mapping[str, tuple[Logs, Linearised, Linearised | None]]
    nominal: RobotDescription
    explained: RobotDescription
    replays: tuple[Replay, Replay | None] | None
    drives: tuple[SeparatingDrive, ...] = ()

    def page(self) -> str:
        """Return the report as one HTML page."""
        data = self.data
        shown: list[pictures.Picture | None] = [*answers.drawn(data)]
        if self.replays is not None:
            shown.append(pictures.replays(*self.replays))
        shown.append(pictures.drift({of: _errors(*left) for of, left in self.seen.items()}))
        shown += [] if data["where"] is None else self._maps(data["where"]["log"])
        return answers.html_of(data, [picture for picture in shown if picture is not None])

    def _maps(self, name: str) -> list[pictures.Picture]:
        """Return maps of slip in the log with this name: over time and, if there is a reference, on the floor."""
        logs, before, after = self.seen["these logs"]
        k = list(logs).index(name)
        plain = _traces(self.nominal, logs[name], before.state, k)
        mended = None if after is None else _traces(self.explained, logs[name], after.state, k)
        left = mended or plain
        maps = [pictures.slip(plain, mended), *([pictures.floor(left)] if len(left.times) else [])]
        called = f"{names_apart(logs)[name]}: " if len(logs) > 1 else ""
        return [dataclasses.replace(picture, caption=f"{called}{picture.caption}") for picture in maps]


@threadpool_limits.wrap(limits=1)
def examine(
    robot: RobotDescription, logs: Logs, held_out: Logs, clean: Logs, material: Material = MATERIAL
) -> Examined:
    """Return the diagnosis of a robot by logs with their names, as `posterior_of`, with all that its report holds.

    Residuals with the named effects are those of the robot file that is written, linearised afresh from the logs.
    """
    prepared = _prepared(robot, logs, held_out, clean)
    diagnosis, checked = _posterior(prepared, material), prepared.checked
    effects = diagnosis.found.effects[len(diagnosis.robot.effects) :]
    found = _found(robot, checked, prepared.wiring, effects)
    explained = without(diagnosis.found, SampleJitter)

    def left(log_set: Logs) -> Linearised | None:
        chosen_logs = list(log_set.values())
        return linearise(explained, chosen_logs, creep=diagnosis.creep, among=()) if effects and chosen_logs else None

    seen = {"these logs": (prepared.logs, diagnosis.before, left(prepared.logs))}
    if diagnosis.held_out is not None:
        seen["held-out logs"] = (prepared.held_out, diagnosis.held_out[0], left(prepared.held_out))
    nominal, explained_now = (without(vehicle, ClockSkew) for vehicle in (diagnosis.robot, explained))
    replays, *held = (
        _replays(
            nominal, explained_now, log_set, *(None if linearised is None else linearised.state for linearised in pair)
        )
        for log_set, *pair in seen.values()
    )
    best = seen["these logs"][2] or diagnosis.before
    noise = None if best.gap is None else best.noise
    data = plain_data.as_data(diagnosis, checked.mistakes, *(after for _, _, after in seen.values())) | {
        "robot_hash": robot.hash(),
        "logs": list(logs),
        "held_out_logs": list(held_out),
        "clean_logs": list(clean),
        "preflight": [*(mistake.what for mistake in checked.mistakes), *checked.remarks],
        "effects": [] if found is None else found.to_dict()["effects"][len(robot.effects) :],
        "replay": _replay_data(noise, replays, next(iter(held), None)),
        "where": None,
    }
    drives = separating_drives(diagnosis.robot, diagnosis.answers, diagnosis.after)
    for plain, drive in zip(data["answers"], drives, strict=True):
        plain["separating_drive"] = None if drive is None else plain_data.drive_data(drive)
    if sentences.unexplained(data):
        log_set, before, after = seen["these logs"]
        last = (nominal, before) if after is None else (explained_now, after)
        with suppress(InputError):  # where a castor without an encoder points is not measured
            data["where"] = _where(last[0], log_set, last[1].state)
    proposed = tuple(drive for drive in drives if drive is not None)
    return Examined(_finite(data), found, seen, nominal, explained_now, replays, proposed)


def _finite(data: Any) -> Any:
    """Return plain data with null for numbers that JSON does not have."""
    if isinstance(data, Mapping):
        return {key: _finite(value) for key, value in data.items()}
    if isinstance(data, list | tuple):
        return [_finite(value) for value in data]
    return None if isinstance(data, float) and not math.isfinite(data) else data


class _Prepared(NamedTuple):
    """What is diagnosed: the robot and that of clean logs, with gross mistakes that are not of wiring; what was found
    beforehand; and logs with their wiring undone."""

    robot: RobotDescription
    before: RobotDescription
    checked: Preflight
    wiring: Sequence[Effect]
    logs: dict[str, Log]
    held_out: dict[str, Log]
    clean: list[Log]


def _prepared(robot: RobotDescription, logs: Logs, held_out: Logs, clean: Logs) -> _Prepared:
    """Return logs with their gross mistakes undone; raises InputError for such as cannot be undone."""
    for given in (logs, held_out, clean):
        check_logs(given)
    checked, kept, before = (
        preflight(robot, list(log_set.values()), list(log_set)).serious if log_set else Preflight(())
        for log_set in (logs, held_out, clean)
    )
    for result in (checked, kept, before):
        if result.fatal:
            raise InputError("; ".join(mistake.what for mistake in result.mistakes))
    (mended, wiring), (once, good_wiring) = _mended(robot, checked), _mended(robot, before)
    straight, kept_back = (_straight(robot, mended, wiring, log_set) for log_set in (logs, held_out))
    good = _straight(robot, once, good_wiring, clean)
    return _Prepared(mended, once, checked, wiring, straight, kept_back, list(good.values()))


def _posterior(prepared: _Prepared, material: Material) -> Diagnosis[RobotDescription, Linearised]:
    logs, held_out = list(prepared.logs.values()), list(prepared.held_out.values())
    return diagnose(prepared.robot, logs, held_out, prepared.clean, prepared.before, material)


def _mended(robot: RobotDescription, checked: Preflight) -> tuple[RobotDescription, Sequence[Effect]]:
    """Return the robot with the gross mistakes of some logs, and those of its wiring, which are undone in the logs."""
    wiring = [effect for effect in checked.effects if effect.wiring]
    return robot.with_effects(*(effect for effect in checked.effects if not effect.wiring)), wiring


def _found(
    robot: RobotDescription, checked: Preflight, wiring: Sequence[Effect], named: Sequence[Effect]
) -> RobotDescription | None:
    """Return the robot as its file is written: with gross mistakes that are certain, and the effects named."""
    doubtful = {effect for mistake in checked.mistakes if mistake.alternatives for effect in mistake.effects}
    built = [effect for effect in checked.effects if not effect.wiring and effect not in doubtful]
    effects = [*built, *named, *(effect for effect in wiring if effect not in doubtful)]
    return robot.with_effects(*effects) if effects else None


def _straight(
    robot: RobotDescription, mended: RobotDescription, wiring: Sequence[Effect], logs: Logs
) -> dict[str, Log]:
    """Return logs with their encoders where they belong, and the axes of their tracker along the body's.

    mended: the robot with gross mistakes that are not of wiring.
    """
    unwired = [_unwired(robot, wiring, log) for log in logs.values()]
    return dict(zip(logs, straightened(Geometry.of(mended.as_built()), unwired)[0], strict=True))


def _unwired(robot: RobotDescription, wiring: Sequence[Effect], log: Log) -> Log:
    """Return the log as it would be with its encoders where they belong; each such mistake undoes itself."""
    if not wiring:
        return log
    geometry, driven, sensed = Geometry.of(robot.as_built()), list(robot.driven_wheels), list(robot.pivot_encoders)
    turn, per_rev = geometry.pivot_counts_per_rev[sensed], geometry.counts_per_rev[driven]
    wheel, castor = np.zeros((len(log), len(robot.wheels))), np.zeros((len(log), len(robot.castors)))
    wheel[:, driven] = log.wheel * 2 * np.pi / per_rev
    unwrapped = np.zeros_like(log.pivot, dtype=np.float64)
    for k, (column, period) in enumerate(zip(log.pivot.T, turn, strict=True)):
        unwrapped[:, k] = np.unwrap(column, period=period)
    castor[:, sensed] = unwrapped * 2 * np.pi / turn - geometry.pivot_zero[sensed]
    for effect in reversed(wiring):
        wheel, castor = readings(robot.with_effects(effect), log.t, wheel, castor)
    pivot = (castor[:, sensed] + geometry.pivot_zero[sensed]) * turn / (2 * np.pi)
    return dataclasses.replace(
        log, wheel=np.round(wheel[:, driven] * per_rev / (2 * np.pi), 6), pivot=np.round(pivot, 6)
    )


def _where(robot: RobotDescription, logs: Logs, at: State) -> Data:
    """Return where most slip is: its channel, time and place, of the log that has most."""
    worst = []
    for k, (name, log) in enumerate(logs.items()):
        traces = traces_of(robot, log, at.states[k])
        worst.append({"log": name, **traces.worst()})
    return max(worst, key=lambda entry: entry["most_slip_m"])


def _traces(robot: RobotDescription, log: Log, at: State, k: int = 0) -> Traces:
    """Return the traces of the log k that a state is of."""
    return traces_of(robot, log, at.states[k], at.clocks[k], at.mount)


def _errors(logs: Logs, before: Linearised, after: Linearised | None) -> tuple[list[Errors], list[Errors]]:
    """Return by how much odometry is off the reference in each log, without and with the named effects."""

    def of(seen: Linearised | None) -> list[Errors]:
        if seen is None:
            return []
        fitted = zip(logs.values(), seen.state.states, seen.state.clocks, seen.errors, strict=True)
        return [along_the_way(*log) for log in fitted]

    return of(before), of(after)


def _replays(
    robot: RobotDescription,
    found: RobotDescription,
    logs: Logs,
    before: State | None = None,
    after: State | None = None,
) -> tuple[Replay, Replay | None] | None:
    """Return the replays by the full simulation, without and with the effects found; None where there are none."""
    if before is None or not logs:
        return None
    try:
        first = _replay(robot, logs, before)
        return first, _replay(found, logs, after) if after is not None else None
    except InputError:
        return None


def _replay(robot: RobotDescription, logs: Logs, at: State) -> Replay:
    mount, clocks = at.mount, at.clocks
    return joined([replay(robot, log, clock=clocks[k], mount=mount) for k, log in enumerate(logs.values())])


def _replay_data(
    noise: Noise | None,
    replays: tuple[Replay, Replay | None] | None,
    held_out: tuple[Replay, Replay | None] | None,
) -> Data | None:
    if replays is None:
        return None
    data = {}
    for before, after, pair in (("before", "after", replays), ("held_out_before", "held_out_after", held_out)):
        for key, replayed in zip((before, after), pair or (None, None), strict=True):
            data[key] = None if replayed is None else replayed.summary()
    if noise is not None:
        data["before"]["expected"] = replays[0].expected(noise.position, noise.heading)
    return data
