"""How much of the gap of measured robots the finder leaves, and how much a fit of a few parameters leaves.

    python scripts/studies/study_measured_robots.py DATA [--only NAME...] [--add] [--plain]

DATA holds the folder `optiodom` (`castor_envs.logs.importers.optiodom`). The runs of every session are taken
alternately for calibration and as held-out runs, those that turn left and those that turn right each by themselves if
there are enough; the only run of a session is cut in half. The fit is independent of this package: dead reckoning by
textbook formulas, and the parameters with which it comes nearest to the reference on the calibration runs (scipy's
least_squares). Stored in docs/measured.json, and shown in docs/diagnosis-trials.md, is the rms distance between plain
odometry and the reference over whole held-out runs: as described, with the fitted parameters, and with the finder's
robot file. For each of the three alike, a run starts at its first reference pose; its clock's offset and rate, and the
tracked point of all runs are those with which this distance is least. --plain: fit and description only, no finder, and
nothing is stored. --add: keep the stored sessions that are not named.
"""

import argparse
import json
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from castor_envs.errors import InputError
from castor_envs.files import write_atomically
from castor_envs.geometry.arrays import Array
from castor_envs.geometry.se2 import compose, relative_pose
from castor_envs.logs.importers.optiodom import Session, find_sessions, read_session
from castor_envs.logs.log import Log
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.diagnose import examine
from discrepancy.validation.cost import odometry

FORMAT = "castor-measured/1"
DOCS = Path(__file__).parents[2] / "docs"
PAGE, FIGURES = DOCS / "diagnosis-trials.md", DOCS / "measured.json"
START, END = "<!-- table: made by scripts/studies/study_measured_robots.py -->\n", "<!-- end of measured table -->\n"

CLOCK = np.array([0.5, 0.003])
"""s and s/s: how far the clocks of reference and encoders are apart, at the start of a run and in rate. The times of
the data were rescaled by hand."""

MOUNT = np.array([0.1, 0.1, 0.1])
"""m, m and rad: how far from the robot's origin the tracked point may be, and how its axes may be turned."""

WRONG = 0.05
"""How far the fitted parameters may be off: as a part, or in rad."""

LITTLE = 0.03
"""m: weight of these three, so that they matter only where nothing else tells."""

REACH = 0.2
"""m: a heading off by 1 rad counts like a place off by this much; about the size of these robots."""

EVERY = 10
"""Of so many reference poses one is used to fit parameters; all are used to measure the distance."""

Odometry = Callable[[Array, Log], Array]


def differential(values: Array, log: Log, robot: RobotDescription) -> Array:
    """Return the path (N, 3) of two wheels, by factors on the left and right radius and on the track."""
    wheels = robot.castors[0].wheels
    radius = np.array([wheel.radius for wheel in wheels]) * (1 + values[:2])
    left, right = (np.diff(log.wheel, axis=0) * _per_count(robot)[:2] * radius).T
    return _integrated((left + right) / 2, 0.0, (right - left) / ((1 + values[2]) * 2 * wheels[0].lateral))


def tricycle(values: Array, log: Log, robot: RobotDescription) -> Array:
    """Return the path (N, 3) of a steered and driven wheel, by factors on its radius and on the wheel base, and the
    steering angle (rad) in which the encoder reads 0."""
    front = robot.castors[0]
    read = log.pivot[:, 0] * 2 * np.pi / (front.pivot_counts_per_rev or 1.0) - front.pivot_zero
    angle = (read[1:] + read[:-1]) / 2 + values[2]
    way = np.diff(log.wheel[:, 0]) * _per_count(robot)[0] * front.wheels[0].radius * (1 + values[0])
    return _integrated(way * np.cos(angle), 0.0, way * np.sin(angle) / ((1 + values[1]) * front.pivot[0]))


def omni(values: Array, log: Log, robot: RobotDescription) -> Array:
    """Return the path (N, 3) of three omni wheels, by factors on their radii and on their distance from the centre."""
    radius = np.array([castor.wheels[0].radius for castor in robot.castors]) * (1 + values[:3])
    heading = np.array([castor.angle for castor in robot.castors])
    x, y = np.array([castor.pivot for castor in robot.castors]).T * (1 + values[3])
    rolls = np.column_stack([np.cos(heading), np.sin(heading), x * np.sin(heading) - y * np.cos(heading)])
    way = np.diff(log.wheel, axis=0) * _per_count(robot) * radius
    return _integrated(*np.linalg.solve(rolls, way.T))


MODELS: dict[str, tuple[Callable[[Array, Log, RobotDescription], Array], tuple[str, ...]]] = {
    "diff": (differential, ("left radius", "right radius", "track")),
    "tricyc": (tricycle, ("radius", "wheel base", "steering zero")),
    "omni3": (omni, ("radius 1", "radius 2", "radius 3", "distance")),
}


def _per_count(robot: RobotDescription) -> Array:
    """Return the angle (rad) per count of each driven wheel."""
    return np.array([2 * np.pi / (robot.wheels[k].counts_per_rev or np.nan) for k in robot.driven_wheels])


def _integrated(forward: Array, left: Array | float, turned: Array) -> Array:
    """Return the path (N, 3) of steps along and across the mean heading of each step."""
    psi = np.concatenate([[0.0], np.cumsum(turned)])
    mean = (psi[1:] + psi[:-1]) / 2
    x, y = forward * np.cos(mean) - left * np.sin(mean), forward * np.sin(mean) + left * np.cos(mean)
    steps = np.column_stack([x, y])
    return np.column_stack([np.vstack([np.zeros(2), np.cumsum(steps, axis=0)]), psi])


class Placed:
    """Paths by odometry, laid on the reference: by the first pose and the clock of each run, and the tracked point."""

    def __init__(self, logs: Sequence[Log], every: int = 1) -> None:
        self.logs, self.every = logs, every
        self.begin = np.zeros(3 + 2 * len(logs))

    def errors(self, numbers: Array, paths: Sequence[Array]) -> Array:
        """Return the distances (m) in x, y and heading at all poses, then what the priors of clocks and tracked point
        ask."""
        mount, clocks = numbers[:3], numbers[3:].reshape(-1, 2)
        off = []
        for log, path, clock in zip(self.logs, paths, clocks, strict=True):
            assert log.reference is not None
            since = log.t - log.t[0]
            t = since[:: self.every]
            taken = np.clip(t + clock[0] + clock[1] * t, 0.0, since[-1])
            tracked = compose(np.column_stack([np.interp(taken, since, column) for column in path.T]), mount)
            off.append(compose(log.reference[0], relative_pose(tracked[0], tracked)) - log.reference[:: self.every])
        asked = LITTLE * np.concatenate([(clocks / CLOCK).ravel(), mount / MOUNT])
        return np.concatenate([(np.concatenate(off) * [1.0, 1.0, REACH]).ravel(), asked])

    def rms(self, paths: Sequence[Array]) -> float:
        """Return the rms distance (m) of all poses, where it is least."""
        found = least_squares(self.errors, self.begin, x_scale="jac", args=(paths,))
        left = self.errors(found.x, paths)[: -len(self.begin)].reshape(-1, 3)
        return float(np.sqrt(np.mean(np.sum(left[:, :2] ** 2, axis=1))))


def fitted(session: Session, logs: Sequence[Log]) -> Array:
    """Return the parameters with which odometry comes nearest to the reference of logs."""
    model, names = MODELS[session.type]
    placed = Placed(logs, EVERY)

    def errors(numbers: Array) -> Array:
        off = placed.errors(numbers[len(names) :], [model(numbers, log, session.robot) for log in logs])
        return np.concatenate([off, LITTLE * numbers[: len(names)] / WRONG])

    begin = np.concatenate([np.zeros(len(names)), placed.begin])
    return least_squares(errors, begin, x_scale="jac").x[: len(names)]


def halves(session: Session) -> tuple[dict[str, Log], dict[str, Log]]:
    """Return the runs for calibration and the held-out ones: alternately of each way of turning, if that can be."""
    runs = {f"run-{k}": run for k, run in enumerate(session.runs, start=1)}
    names = list(runs)
    if len(runs) == 1:
        (run,), middle = session.runs, len(session.runs[0]) // 2
        return {"first half": _cut(run, slice(None, middle))}, {"second half": _cut(run, slice(middle, None))}
    ways = [
        [name for name, way in zip(names, session.directions, strict=True) if way == turned] for turned in ("cw", "ccw")
    ]
    kept = [name for way in ways for name in way[1::2]] or names[1::2]
    return {name: runs[name] for name in names if name not in kept}, {
        name: runs[name] for name in names if name in kept
    }


def _cut(log: Log, rows: slice) -> Log:
    reference = None if log.reference is None else log.reference[rows]
    return Log(t=log.t[rows], wheel=log.wheel[rows], pivot=log.pivot[rows], reference=reference)


def studied(session: Session, finder: bool = True) -> dict[str, Any]:
    """Return what the fit and the finder leave of a session's held-out gap, as plain data."""
    logs, held_out = halves(session)
    model, names = MODELS[session.type]
    kept, values, begin = list(held_out.values()), fitted(session, list(logs.values())), time.process_time()
    placed = Placed(kept)
    row = {
        "session": session.name,
        "type": session.type,
        "runs": len(logs),
        "held_out": len(held_out),
        "as_described_mm": 1e3 * placed.rms([model(np.zeros(len(names)), log, session.robot) for log in kept]),
        "fit_mm": 1e3 * placed.rms([model(values, log, session.robot) for log in kept]),
        "fit": dict(zip(names, values.tolist(), strict=True)),
    }
    if not finder:
        return row
    examined = examine(session.robot, logs, held_out, {})
    found = session.robot if examined.found is None else examined.found
    row["finder_mm"] = 1e3 * placed.rms([odometry(found, log) for log in kept])
    answers = [{key: answer[key] for key in ("what", "verdict", "size", "unit")} for answer in examined.data["answers"]]
    gaps = {key: examined.data[key] for key in ("verdict", "gap", "held_out_gap")}
    return row | gaps | {"answers": answers, "cpu_s": round(time.process_time() - begin)}


def line(row: Mapping[str, Any]) -> str:
    """Return a session in a row of the table."""
    cells = [row["session"], row["type"], f"{row['runs']} + {row['held_out']}"]
    cells += [_figures(row.get(key)) for key in ("as_described_mm", "fit_mm", "finder_mm")]
    cells += [f"{row['finder_mm'] / row['fit_mm']:.2f}"] if "finder_mm" in row else ["-"]
    named = [answer["what"] for answer in row.get("answers", ()) if answer["verdict"] == "named"]
    return f"| {' | '.join([*cells, row.get('verdict', '-'), '; '.join(named) or '-'])} |\n"


def _figures(value: float | None) -> str:
    return "-" if value is None else f"{value:#.3g}".rstrip(".")


def table(figures: Mapping[str, Any]) -> str:
    """Return the table of all sessions."""
    heads = [
        "session",
        "robot",
        "runs",
        "as described, mm",
        "own fit, mm",
        "finder, mm",
        "finder / fit",
        "verdict",
        "named",
    ]
    rows = [f"| {' | '.join(heads)} |\n", f"|{' --- |' * len(heads)}\n"]
    return "".join([*rows, *(line(row) for row in figures["sessions"])])


def with_table(page: str, figures: Mapping[str, Any]) -> str:
    """Return the page with a new table between its marks."""
    before, rest = page.split(START)
    return before + START + "\n" + table(figures) + "\n" + END + rest.split(END, 1)[1]


def main() -> None:
    """Study the sessions of a folder."""
    parser = argparse.ArgumentParser(description="How much of the gap of measured robots the finder leaves.")
    parser.add_argument("data", type=Path, help="folder that holds `optiodom`")
    parser.add_argument("--only", nargs="*", default=None, help="names of sessions; all, if left out")
    parser.add_argument("--add", action="store_true", help="keep the stored sessions that are not named")
    parser.add_argument("--plain", action="store_true", help="no finder, and nothing is stored")
    arguments = parser.parse_args()
    stored = json.loads(FIGURES.read_text(encoding="utf-8"))["sessions"] if arguments.add else []
    rows = {row["session"]: row for row in stored}
    for name, folder in find_sessions(arguments.data).items():
        if arguments.only is not None and name not in arguments.only:
            continue
        try:
            row = studied(read_session(folder), finder=not arguments.plain)
        except InputError as problem:
            print(f"{name}: {problem}", flush=True)
            continue
        print(line(row), *(f"{answer}" for answer in row.get("answers", ())), row["fit"], flush=True)
        rows[name] = row
        if not arguments.plain:
            figures = {
                "format": FORMAT,
                "sessions": sorted(rows.values(), key=lambda row: (row["type"], row["session"])),
            }
            write_atomically(FIGURES, json.dumps(figures, indent=1) + "\n")
    if not arguments.plain:
        figures = json.loads(FIGURES.read_text(encoding="utf-8"))
        write_atomically(PAGE, with_table(PAGE.read_text(encoding="utf-8"), figures))


if __name__ == "__main__":
    main()
