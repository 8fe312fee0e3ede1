"""Draw the picture of every page in docs/estimators, and write the sentence below it that says what it shows.

    python scripts/pictures/make_estimator_pictures.py [PAGE...]     (20 s of CPU)

Each picture is of one recorded case that no board scores: on the left the true way (grey) and the estimated one, on the
right the position error over time. `PICTURES` says which case a page shows, and which estimators of it.
"""

import sys
import warnings
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.run.worker_estimate import Failure, estimate_singly, observed_runs
from benchmarks.scoring.registry import BOARD_METRICS, score
from benchmarks.tasks import official_tasks
from benchmarks.tasks.task import Episode
from castor_envs.files import write_atomically
from castor_envs.geometry.arrays import Array
from estimators import load_estimator

PAGES = Path(__file__).parents[2] / "docs" / "estimators"
START, END = "<!-- picture: made by scripts/pictures/make_estimator_pictures.py -->\n", "<!-- end of picture -->\n"
CASE = 900_000
"""The first of the seeds that no board scores."""

COLORS = ("#d55e00", "#0072b2", "#009e73")
WIDTH, HEIGHT, MARGIN = 640, 260, 34


class Picture(NamedTuple):
    """What a page shows: a task, and estimators by their specs."""

    task: str
    estimators: tuple[str, ...]


PICTURES = {
    "dead-reckoning": Picture("bursts-prototype", ("dead-reckoning-1",)),
    "ipec": Picture("bursts-prototype", ("ipec-1",)),
    "cast": Picture("bursts-prototype", ("cast-0",)),
    "cast-arc": Picture("bursts-prototype", ("cast-arc-0",)),
    "wheel-odometry": Picture("bursts-prototype", ("wheel-odometry", "holmberg-khatib", "tidybot")),
    "filter": Picture("bursts-prototype", ("filter",)),
    "wpilib-swerve": Picture("bursts-swerve", ("tidybot", "holmberg-khatib")),
    "skid-ratio": Picture("bursts-swerve", ("skid-ratio",)),
    "module-mean": Picture("bursts-swerve", ("module-mean",)),
    "wheel-gyro": Picture("gyro-swerve", ("wheel-gyro",)),
    "invariant-ekf": Picture("gyro-swerve", ("invariant-ekf",)),
    "train-odometry": Picture("train-3-cables", ("train-odometry",)),
    "grpec": Picture("train-3-cables", ("grpec-xy", "grpec-phi", "grpec-dev")),
    "rmspec": Picture("train-3-cables", ("rmspec",)),
    "train-least-squares": Picture("train-3-cables", ("train-least-squares",)),
    "inlier-least-squares": Picture("train-3-cables", ("inlier-least-squares",)),
    "two-truck-ipec": Picture("train-2-cables", ("two-truck-ipec",)),
    "train-filter": Picture("train-3-cables", ("train-filter",)),
}
"""By page. WPILib's wheel is an extra; its equations are those of others, which stand in for it."""


@cache
def recorded(task: str) -> Episode:
    """Return the case of a task."""
    (found,) = (one for one in official_tasks() if one.name == task)
    return found.record(CASE)


@cache
def followed(task: str, spec: str) -> tuple[Array, float] | None:
    """Return an estimator's poses (M, 3), of a train (N, M, 3), and its ATE, m; None where it declines."""
    episode = recorded(task)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        estimates = estimate_singly(spec, load_estimator(spec).source_hash, observed_runs(episode))
    if isinstance(estimates, Failure):
        return None
    poses = [estimate.poses for estimate in estimates]
    return poses[0], score(episode, poses)["ate"]


def sentence(page: str) -> str | None:
    """Return what a page's picture shows, in words; None where an estimator of it declines."""
    task, specs = PICTURES[page]
    found = {spec: followed(task, spec) for spec in specs}
    shown = BOARD_METRICS["ate"].shown
    if any(one is None for one in found.values()):
        return None
    errors = ", ".join(f"`{spec}` {shown(one[1])[:4].rstrip('.')} mm" for spec, one in found.items() if one is not None)
    return f"Case {CASE} of `{task}`, true way grey; ATE: {errors}."


def drawn(page: str) -> str:
    """Return a page's picture as SVG."""
    task, specs = PICTURES[page]
    run = recorded(task).runs[0]
    found = [one[0] for spec in specs if (one := followed(task, spec)) is not None]
    truth, t = run.truth, run.log.t[run.samples]
    front = truth if truth.ndim == 2 else truth[0]
    ways = [front, *(poses if poses.ndim == 2 else poses[0] for poses in found)]
    errors = [1e3 * np.hypot(*np.moveaxis((poses - truth)[..., :2], -1, 0)) for poses in found]
    errors = [error if error.ndim == 1 else error.mean(axis=0) for error in errors]
    half, inner = WIDTH / 2, np.array([WIDTH / 2 - 2 * MARGIN, HEIGHT - 2 * MARGIN])
    xy = np.concatenate([way[:, :2] for way in ways])
    low, size = xy.min(axis=0), np.ptp(xy, axis=0)
    scale = float(np.min(inner / np.maximum(size, 1e-9)))
    top = max(float(error.max()) for error in errors)
    lines = []
    for color, width, way in zip(("#aaaaaa", *COLORS), (5, 1.5, 1.5, 1.5), ways, strict=False):
        points = (way[:, :2] - low) * scale
        lines.append(_line(points * [1, -1] + [MARGIN, HEIGHT - MARGIN], color, width))
    for color, error in zip(COLORS, errors, strict=False):
        points = np.column_stack([inner[0] * t / t[-1] + half + MARGIN, HEIGHT - MARGIN - inner[1] * error / top])
        lines.append(_line(points, color, 1.5))
    words = [
        (MARGIN, 18, "#555555", f"way, {size[0]:.1f} m by {size[1]:.1f} m"),
        (half + MARGIN, 18, "#555555", f"position error, up to {top:.0f} mm in {t[-1]:.0f} s"),
        *((half + MARGIN, 36 + 16 * k, COLORS[k], spec) for k, spec in enumerate(specs)),
    ]
    text = [f'<text x="{x:.0f}" y="{y}" fill="{color}">{word}</text>' for x, y, color, word in words]
    axis = f'<path d="M{half + MARGIN:.0f} {HEIGHT - MARGIN}h{inner[0]:.0f}" stroke="#aaaaaa"/>'
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" font-family="sans-serif"'
    ground = f'<rect width="{WIDTH}" height="{HEIGHT}" fill="#ffffff"/>'
    return "\n".join([f'{head} font-size="13">', ground, axis, *lines, *text, "</svg>", ""])


def _line(points: Array, color: str, width: float) -> str:
    place = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
    return f'<polyline points="{place}" fill="none" stroke="{color}" stroke-width="{width}"/>'


def with_picture(text: str, page: str, said: str) -> str:
    """Return a page with the picture and what it shows between its marks."""
    before, rest = text.split(START)
    return (
        f"{before}{START}\n![{page} on a recorded case](pictures/{page}.svg)\n\n{said}\n\n{END}{rest.split(END, 1)[1]}"
    )


def main(pages: list[str]) -> None:
    """Write pictures and sentences of the pages."""
    for page in pages or list(PICTURES):
        said, file = sentence(page), PAGES / f"{page}.md"
        if said is None:
            print(f"{page}: left as it is; an estimator of it declines here")
            continue
        (PAGES / "pictures").mkdir(exist_ok=True)
        write_atomically(PAGES / "pictures" / f"{page}.svg", drawn(page))
        write_atomically(file, with_picture(file.read_text(encoding="utf-8"), page, said))


if __name__ == "__main__":
    main(sys.argv[1:])
