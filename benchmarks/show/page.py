"""The page of an episode, a case or a log."""

import contextlib
from pathlib import Path
from typing import Any

from benchmarks.scoring.metric import Metric
from benchmarks.scoring.registry import BOARD_METRICS
from benchmarks.show.drives import Drive, Shown
from benchmarks.show.figures import error_charts, path_map, slip_charts
from benchmarks.show.slip import slips_of
from castor_envs.errors import InputError
from castor_envs.files import check_writable, write_atomically, writing
from castor_envs.rendering.pages.page import MARK, render


def page_of(shown: Shown, assets: str | None = None, home: str | None = None) -> str:
    """Return the page. assets: as in `render`. home: where the page leads back to, None of a page that stands alone."""
    names = shown.estimators
    metrics = metrics_of(shown)
    return render(
        Path(__file__).parent,
        "episode.html",
        assets,
        shown=shown,
        home=home,
        names=names,
        metrics=metrics,
        table=[
            (name, [(_shown(metric, shown, name), shown.scores[name].get(metric.name)) for metric in metrics])
            for name in names
            if name in shown.scores
        ],
        drives=[drawn(drive, names) for drive in shown.drives],
    )


def drawn(drive: Drive, names: list[str]) -> dict[str, Any]:
    """Return what a page shows of a drive."""
    slips = slips_of(drive) if len(drive.samples) > 1 else None
    places = [] if slips is None else slips.worst()
    return {
        "name": drive.name,
        "vehicle": drive.vehicle.name,
        "duration": float(drive.log.t[-1] - drive.log.t[0]),
        "way": float(drive.way[-1]),
        "truth": "true path" if drive.dense else "reference poses" if drive.known.any() else None,
        "floor": drive.floor,
        "map": path_map(drive, names, places),
        "errors": error_charts(drive, names),
        "slips": [] if slips is None else slip_charts(slips),
        "places": places,
    }


def metrics_of(shown: Shown) -> list[Metric]:
    """Return the metrics that the scores of a page have, those of a terminal's board first."""
    present = [m for name, m in BOARD_METRICS.items() if any(name in scores for scores in shown.scores.values())]
    return sorted(present, key=lambda metric: (metric.column is None, metric.place))


def _shown(metric: Metric, shown: Shown, name: str) -> str:
    return metric.shown(shown.scores[name].get(metric.name))


def check_page(path: Path) -> None:
    """Raise InputError where a page cannot be written, or would replace a file that is not one of these pages."""
    if path.exists():
        ours = False
        with contextlib.suppress(OSError):
            ours = MARK.encode() in path.read_bytes()[:2000]
        if not ours:
            raise InputError(f"--out {path}: is there already, and no page of this command; name another file")
    with writing(f"--out {path}"):
        check_writable(path)


def write_page(path: Path, page: str) -> None:
    """Write a page; raises InputError where `check_page` does."""
    check_page(path)
    with writing(f"--out {path}"):
        write_atomically(path, page)
