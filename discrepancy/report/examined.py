"""What was found about a robot, with all that its report holds: as data and as a page."""

import dataclasses
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from castor_envs.effects.clocks import ClockOffset
from castor_envs.logs.log import Log
from castor_envs.vehicles.load import Vehicle
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.discriminating_drive import SeparatingDrive
from discrepancy.posterior.finder import RobotDiagnosis
from discrepancy.posterior.linearise import Linearised
from discrepancy.preflight.undo import Undone
from discrepancy.report import answers, pictures, plain_data, sentences
from discrepancy.report.parts import names_apart
from discrepancy.report.plain_data import Data
from discrepancy.report.traces import Errors, Traces, along_the_way
from discrepancy.validation.replay import Replay

Replays = tuple[Replay, Replay | None]


@dataclass(frozen=True, eq=False)
class Fit:
    """Logs, linearised and replayed without the named effects and, if there are any, with them.

    nominal, explained: the robot without and with these, as logs with their wiring undone show it, but for effects on
    time. replays: None where there are none.
    """

    logs: Mapping[str, Log]
    nominal: RobotDescription
    before: Linearised
    explained: RobotDescription
    after: Linearised | None
    replays: Replays | None

    @property
    def best(self) -> tuple[RobotDescription, Linearised]:
        """The robot with the named effects, if there are any, and the logs linearised with it."""
        return (self.nominal, self.before) if self.after is None else (self.explained, self.after)

    def errors(self) -> tuple[list[Errors], list[Errors]]:
        """Return by how much odometry is off the reference in each log, without and with the named effects."""

        def of(seen: Linearised | None) -> list[Errors]:
            if seen is None:
                return []
            fitted = zip(self.logs.values(), seen.state.states, seen.state.clocks, seen.errors, strict=True)
            return [along_the_way(*log) for log in fitted]

        return of(self.before), of(self.after)

    def most_slip(self) -> Data:
        """Return where most slip is left: its channel, time and place, of the log that has most."""
        robot, seen = self.best
        worst = [
            {"log": name, **Traces(robot, log, state).worst()}
            for (name, log), state in zip(self.logs.items(), seen.state.states, strict=True)
        ]
        return max(worst, key=lambda entry: entry["most_slip_m"])

    def clocks(self) -> Iterator[str]:
        """Yield remarks on logs whose reference was taken half a sample and more before or after the times of its rows,
        on average: it is fitted, and clean logs alone make an answer of it."""
        _, seen = self.best
        for (name, log), (offset, rate) in zip(self.logs.items(), seen.state.clocks.tolist(), strict=True):
            early = offset + rate * (log.t[-1] - log.t[0]) / 2
            if abs(early) > np.median(np.diff(log.t)) / 2:
                which, other = ("early", "late") if early > 0 else ("late", "early")
                yield (
                    f"{name}: the reference is {abs(early) * 1e3:.3g} ms {which}, or all encoders are {other} by as "
                    "much: that is fitted, and not counted"
                )

    def maps(self, name: str) -> list[pictures.Picture]:
        """Return maps of slip in the log with this name: over time and, if there is a reference, on the floor."""
        k, called = list(self.logs).index(name), f"{names_apart(self.logs)[name]}: " if len(self.logs) > 1 else ""
        plain, *mended = (
            Traces(robot, self.logs[name], seen.state.states[k])
            for robot, seen in ((self.nominal, self.before), (self.explained, self.after))
            if seen is not None
        )
        left = [plain, *mended][-1]
        maps = [pictures.slip(plain, *mended), *([pictures.floor(left)] if left.posed else [])]
        return [dataclasses.replace(picture, caption=f"{called}{picture.caption}") for picture in maps]


@dataclass(frozen=True, eq=False)
class Examined:
    """The diagnosis: as data (castor-diagnosis/2), and the robot, or train, with the named effects; None if none is
    named.

    seen: these logs, and held-out ones if there are any, of a robot. drives: those that would separate ambiguous
    answers.
    """

    data: Data
    found: Vehicle | None
    seen: Mapping[str, Fit] = field(default_factory=dict)
    drives: tuple[SeparatingDrive, ...] = ()

    @classmethod
    def of(
        cls,
        undone: Undone,
        diagnosis: RobotDiagnosis,
        seen: Mapping[str, Fit],
        drives: Sequence[SeparatingDrive | None],
    ) -> "Examined":
        """Return what is told. drives: for each answer, None where there is none."""
        checked, described = undone.checked, undone.described
        named = diagnosis.found.effects[len(diagnosis.robot.effects) :]
        these, *held_out = ((fit.before, fit.after) for fit in seen.values())
        logs = undone.logs, undone.held_out, undone.clean
        told = any(isinstance(effect, ClockOffset) for effect in named)
        on_clocks = [] if told else [remark for fit in seen.values() for remark in fit.clocks()]
        data = plain_data.as_data(diagnosis, logs, these, next(iter(held_out), None), checked.mistakes) | {
            "robot_hash": described.hash(),
            "preflight": [*(mistake.what for mistake in checked.mistakes), *checked.remarks, *on_clocks],
            "too_little": checked.blind,
            "effects": [dataclasses.asdict(effect) for effect in undone.added(named)],
            "replay": _replay_data(*seen.values()),
        }
        for answer, drive in zip(data["answers"], drives, strict=True):
            answer["separating_drive"] = None if drive is None else plain_data.drive_data(drive)
        if sentences.unexplained(data):
            data["where"] = seen["these logs"].most_slip()
        return cls(_finite(data), undone.found(named), seen, tuple(drive for drive in drives if drive is not None))

    def page(self) -> str:
        """Return the report as one HTML page."""
        shown: list[pictures.Picture | None] = [*answers.drawn(self.data)]
        if (these := self.seen.get("these logs")) is not None:
            shown += [] if these.replays is None else [pictures.replays(*these.replays)]
            shown.append(pictures.drift({title: fit.errors() for title, fit in self.seen.items()}))
            shown += [] if self.data["where"] is None else these.maps(self.data["where"]["log"])
        return answers.html_of(self.data, [picture for picture in shown if picture is not None])


def _replay_data(these: Fit, held_out: Fit | None = None) -> Data | None:
    """Return summaries of replays, with the gap that the reference's noise alone leaves."""
    if these.replays is None:
        return None
    pairs = these.replays, (None if held_out is None else held_out.replays) or (None, None)
    keys = ("before", "after", "held_out_before", "held_out_after")
    replays = [None if replay is None else replay.summary() for pair in pairs for replay in pair]
    data: Data = dict(zip(keys, replays, strict=True))
    if (best := these.best[1]).gap is not None:
        heading = None if math.isnan(best.gap[1]) else best.noise.heading
        data["before"]["expected"] = these.replays[0].expected(best.noise.position, heading)
    return data


def _finite(data: Data) -> Data:
    """Return plain data with null for numbers that JSON does not have."""
    return json.loads(json.dumps(data), parse_constant=lambda number: None)
