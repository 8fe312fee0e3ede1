"""From logs to a report: the pre-flight, the diagnosis, the replay through the full simulation, the page.

Mistakes of wiring that the pre-flight finds are undone in the logs before anything else is looked for, and stand in the
robot file that is written: encoders are exchanged after all else that they do.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from castor_envs.effects.catalogue import readings
from castor_envs.errors import InputError
from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry
from castor_envs.vehicles.effect import Effect
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.inference.findings import WEAKEST_FIRST, Diagnosis, Left
from discrepancy.inference.forward_selection import diagnose
from discrepancy.posterior.finder import Diagnosis as Posterior
from discrepancy.posterior.finder import diagnose as diagnose_by_posterior
from discrepancy.posterior.verdicts import MATERIAL, Material
from discrepancy.preflight import Mistake, Preflight, check_logs, preflight
from discrepancy.report import pictures
from discrepancy.report.page import html_of
from discrepancy.report.text import Data, as_data, mistake_data
from discrepancy.report.traces import traces_of
from discrepancy.validation.replay import Replay, joined, replay

Logs = Mapping[str, Log]


@dataclass(frozen=True, eq=False)
class Examination:
    """What was found: as data (castor-diagnosis/1), and the robot with it; None if nothing is named."""

    data: Data
    found: RobotDescription | None
    diagnosis: Diagnosis
    logs: Logs
    mistakes: tuple[Mistake, ...]
    replays: tuple[Replay, Replay | None] | None

    def page(self) -> str:
        """Return the report as one HTML page."""
        log, diagnosis = next(iter(self.logs.values())), self.diagnosis
        before = _traces(diagnosis.nominal, log, diagnosis.before)
        after = None
        if diagnosis.after is not None:
            after = _traces(diagnosis.explained, log, diagnosis.after)
        named = [finding.chosen[0].candidate.what for finding in diagnosis.findings]
        shown = [
            pictures.paths(before, after),
            pictures.errors(before, after),
            pictures.slip(before, after),
            pictures.floor(before),
            pictures.candidates(self.data["candidates"], named),
        ]
        if self.replays is not None:
            shown.append(pictures.replays(*self.replays))
        return html_of(self.data, shown)


def examine(robot: RobotDescription, logs: Logs, held_out: Logs, clean: Logs, *, replayed: bool = True) -> Examination:
    """Return what logs, by their names, say of a robot, as `diagnosis.diagnose` does with what surrounds it.

    Gross mistakes of the logs are undone in held-out ones too; clean logs, of before, are mended by what is wrong with
    themselves. replayed: whether to drive the full simulation as the logs.
    Raises InputError for logs of which nothing can be said before they, or the robot file, are mended.
    """
    mended, once, checked, wiring, straight, kept_back, good = _prepared(robot, logs, held_out, clean)
    diagnosis = diagnose(mended, list(straight.values()), list(kept_back.values()), good, once)
    found = _found(robot, checked, wiring, diagnosis)
    data = as_data(diagnosis, straight) | {
        "robot_hash": robot.hash(),
        "held_out_logs": list(held_out),
        "clean_logs": list(clean),
        "preflight": [*(mistake.what for mistake in checked.mistakes), *checked.remarks],
        "effects": [] if found is None else found.to_dict()["effects"][len(robot.effects) :],
    }
    _add_mistakes(data, checked.mistakes)
    unsure = next((finding for finding in data["findings"] if finding["verdict"] == "ambiguous"), None)
    data["cannot_be_told_apart"] = [] if unsure is None else unsure["cannot_be_told_apart"]
    data["separating_motion"] = None if unsure is None else unsure["separating_motion"]
    data["where"], data["replay"] = _where(straight, diagnosis), None
    if not replayed:
        return Examination(data, found, diagnosis, straight, checked.mistakes, None)
    nominal = diagnosis.nominal
    replays = _replays(nominal, diagnosis.explained, straight, diagnosis.before, diagnosis.after)
    held = _replays(nominal, diagnosis.explained, kept_back, *(diagnosis.held_out or (None, None)))
    data["replay"] = _replay_data(diagnosis, replays, held)
    return Examination(data, found, diagnosis, straight, checked.mistakes, replays)


def posterior_of(
    robot: RobotDescription, logs: Logs, held_out: Logs, clean: Logs, material: Material = MATERIAL
) -> tuple[tuple[Mistake, ...], Posterior]:
    """Return the gross mistakes in logs, and what logs without these say by `posterior.finder.diagnose`."""
    mended, once, checked, _, straight, kept_back, good = _prepared(robot, logs, held_out, clean)
    found = diagnose_by_posterior(mended, list(straight.values()), list(kept_back.values()), good, once, material)
    return checked.mistakes, found


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
        preflight(robot, list(log_set.values()), list(log_set)) if log_set else Preflight(())
        for log_set in (logs, held_out, clean)
    )
    for result in (checked, kept, before):
        if result.fatal:
            raise InputError("; ".join(mistake.what for mistake in result.mistakes))
    (mended, wiring), (once, good_wiring) = _mended(robot, checked), _mended(robot, before)
    straight, kept_back = (
        {name: _unwired(robot, wiring, log) for name, log in log_set.items()} for log_set in (logs, held_out)
    )
    good = [_unwired(robot, good_wiring, log) for log in clean.values()]
    return _Prepared(mended, once, checked, wiring, straight, kept_back, good)


def _mended(robot: RobotDescription, checked: Preflight) -> tuple[RobotDescription, Sequence[Effect]]:
    """Return the robot with the gross mistakes of some logs, and those of its wiring, which are undone in the logs."""
    wiring = [effect for effect in checked.effects if effect.wiring]
    return robot.with_effects(*(effect for effect in checked.effects if not effect.wiring)), wiring


def _found(
    robot: RobotDescription, checked: Preflight, wiring: Sequence[Effect], diagnosis: Diagnosis
) -> RobotDescription | None:
    doubtful = {effect for mistake in checked.mistakes if mistake.alternatives for effect in mistake.effects}
    built = [effect for effect in checked.effects if not effect.wiring and effect not in doubtful]
    effects = [*built, *diagnosis.effects, *(effect for effect in wiring if effect not in doubtful)]
    return robot.with_effects(*effects) if effects else None


def _add_mistakes(data: Data, mistakes: Sequence[Mistake]) -> None:
    """Put gross mistakes before the other findings."""
    if not mistakes:
        return
    told = [mistake_data(mistake) for mistake in mistakes]
    verdicts = [finding["verdict"] for finding in told] + [data["verdict"]] * bool(data["findings"])
    data["reason"] = "; ".join([mistake.what for mistake in mistakes] + [data["reason"]] * bool(data["findings"]))
    data["findings"] = [*told, *data["findings"]]
    data["verdict"] = min(verdicts, key=WEAKEST_FIRST.index)


def _unwired(robot: RobotDescription, wiring: Sequence[Effect], log: Log) -> Log:
    """Return the log as it would be with its encoders where they belong; each such mistake undoes itself."""
    if not wiring:
        return log
    geometry, driven, sensed = Geometry.of(robot.as_built()), list(robot.driven_wheels), list(robot.pivot_encoders)
    turn, per_rev = geometry.pivot_counts_per_rev[sensed], geometry.counts_per_rev[driven]
    wheel, castor = np.zeros((len(log), len(robot.wheels))), np.zeros((len(log), len(robot.castors)))
    wheel[:, driven] = log.wheel * 2 * np.pi / per_rev
    unwrapped = np.column_stack(
        [np.unwrap(column, period=period) for column, period in zip(log.pivot.T, turn, strict=True)]
    ).reshape(len(log), -1)
    castor[:, sensed] = unwrapped * 2 * np.pi / turn - geometry.pivot_zero[sensed]
    for effect in reversed(wiring):
        wheel, castor = readings(robot.with_effects(effect), log.t, wheel, castor)
    pivot = (castor[:, sensed] + geometry.pivot_zero[sensed]) * turn / (2 * np.pi)
    return dataclasses.replace(
        log, wheel=np.round(wheel[:, driven] * per_rev / (2 * np.pi), 6), pivot=np.round(pivot, 6)
    )


def _where(logs: Logs, diagnosis: Diagnosis) -> Data:
    """Return where most slip is: its channel, time and place, of the log that has most."""
    worst = []
    for k, (name, log) in enumerate(logs.items()):
        traces = traces_of(diagnosis.nominal, log, diagnosis.before.state.states[k])
        worst.append({"log": name, **traces.worst()})
    return max(worst, key=lambda entry: entry["most_slip_m"])


def _traces(robot: RobotDescription, log: Log, left: Left) -> Any:
    return traces_of(robot, log, left.state.states[0], left.state.clocks[0], left.state.mount)


def _replays(
    robot: RobotDescription, found: RobotDescription, logs: Logs, before: Left | None, after: Left | None
) -> tuple[Replay, Replay | None] | None:
    """Return what the full simulation leaves, without and with what was found; None where it cannot be told."""
    if before is None or not logs:
        return None
    try:
        first = _replay(robot, logs, before)
        return first, _replay(found, logs, after) if after is not None else None
    except InputError:
        return None


def _replay(robot: RobotDescription, logs: Logs, left: Left) -> Replay:
    mount, clocks = left.state.mount, left.state.clocks
    return joined([replay(robot, log, clock=clocks[k], mount=mount) for k, log in enumerate(logs.values())])


def _replay_data(
    diagnosis: Diagnosis,
    replays: tuple[Replay, Replay | None] | None,
    held_out: tuple[Replay, Replay | None] | None,
) -> Data | None:
    if replays is None:
        return None
    noise, data = diagnosis.before.noise, {}
    for before, after, pair in (("before", "after", replays), ("held_out_before", "held_out_after", held_out)):
        for key, replayed in zip((before, after), pair or (None, None), strict=True):
            data[key] = None if replayed is None else replayed.summary()
    if diagnosis.before.position is not None:
        data["before"]["expected"] = replays[0].expected(noise.position, noise.heading)
    return data
