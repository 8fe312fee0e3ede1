"""Exported files as the program `evo` reads them: its ATE and RPE are ours, and it draws the floor.

`evo` (M. Grupp, https://github.com/MichaelGrupp/evo) is run as a program, in a home of its own for its settings.
"""

import json
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from benchmarks.export.cases import export_cases, export_form, write_poses
from benchmarks.export.floor_map import floor_map
from benchmarks.results.rows import ResultsStore
from benchmarks.run.plan import Assignment, run
from benchmarks.scoring.path_metrics import absolute_trajectory_error, relative_pose_error
from benchmarks.tasks.task import Episode, Run
from castor_envs.floor import Cable, Floor, Patch
from castor_envs.logs.log import Log
from castor_envs.logs.trajectory_files import export_kitti, export_tum
from castor_envs.vehicles.presets import preset
from estimators.plugins.registry import load_estimator

EVO = Path(sys.executable).parent
needs_evo = pytest.mark.skipif(
    not (EVO / "evo_ape").exists(), reason="the program evo is not installed: pip install evo, or the extra `test`"
)
FLOOR = Floor(
    patches=(Patch(center=(1.0, 2.0), size=(0.6, 0.2), friction=0.0, angle=np.pi / 2),),
    cables=(Cable(center=(-1.0, 0.5), direction=0.0, length=0.4, diameter=0.01),),
)


@pytest.fixture
def evo(tmp_path):
    """Return a function that runs one of evo's programs and returns the statistics that it stores."""
    home = tmp_path / "home"
    home.mkdir()

    def call(program, *arguments, results=True):
        environment = os.environ | {"HOME": str(home), "MPLBACKEND": "Agg"}
        options = ["--save_results", str(tmp_path / f"{program}.zip"), "--no_warnings"] if results else []
        command = [EVO / program, *map(str, arguments), *options]
        done = subprocess.run(command, env=environment, cwd=tmp_path, capture_output=True, text=True, timeout=120)
        assert done.returncode == 0, done.stdout + done.stderr
        if not results:
            return None
        with zipfile.ZipFile(tmp_path / f"{program}.zip") as stored:
            found = json.loads(stored.read("stats.json"))
        (tmp_path / f"{program}.zip").unlink()
        return found

    return call


def even_path(samples=81, step=0.05):
    """Return times and two paths whose samples are all `step` (m) apart: an arc of 3 m, and an estimate that strays."""
    t, s = 0.05 * np.arange(samples), step * np.arange(samples)
    chord = 2 * 3.0 * np.sin(step / 6.0)
    heading = s / 3.0
    along = (step / chord) * np.stack([3.0 * np.sin(heading), 3.0 - 3.0 * np.cos(heading)], axis=1)
    true = np.column_stack([along, heading])
    off = np.random.default_rng(3).normal(0, (0.002, 0.002, 0.003), (samples, 3)).cumsum(axis=0)
    off[0] = 0.0
    return t, true, true + off


@needs_evo
@pytest.mark.parametrize(("form", "export"), [("tum", export_tum), ("kitti", lambda path, t, p: export_kitti(path, p))])
def test_relative_and_absolute_errors_are_those_of_evo(evo, tmp_path, form, export):
    t, true, estimate = even_path()
    export(tmp_path / "true.txt", t, true)
    export(tmp_path / "estimate.txt", t, estimate)
    files = (form, "true.txt", "estimate.txt")
    assert evo("evo_ape", *files)["rmse"] == pytest.approx(float(absolute_trajectory_error(true, estimate)), rel=1e-9)
    # All pairs of samples 20 steps, and so 1 m, apart: evo counts frames where we measure the way.
    pairs = ("--delta", "20", "--delta_unit", "f", "--all_pairs")
    ours = relative_pose_error(true, estimate, distance=1.0)
    assert evo("evo_rpe", *files, *pairs)["mean"] == pytest.approx(float(ours.translation), rel=1e-9)
    by_angle = evo("evo_rpe", *files, *pairs, "-r", "angle_rad")["mean"]
    assert by_angle == pytest.approx(float(ours.rotation), rel=1e-6)


@needs_evo
@pytest.mark.parametrize("form", ["tum", "kitti"])
def test_the_ate_of_a_board_is_that_of_evo(evo, tmp_path, fake_tasks, jobs_here, form):
    results, task = tmp_path / "results", fake_tasks.Arcs()
    run([Assignment(task, (0,), (load_estimator("dead-reckoning-1"),))], results)
    (row,) = ResultsStore(results).rows(task.name, task.version)
    export_cases(task, (0,), tmp_path / "out", export_form(form), results)
    folder = tmp_path / "out" / "case-0"
    found = [
        evo("evo_ape", form, folder / f"{name}.{form}", folder / f"{name}-dead-reckoning-1-{row.source_hash}.{form}")
        for name in ("run-01-cw", "run-02-ccw")
    ]
    assert np.mean([stats["rmse"] for stats in found]) == pytest.approx(row.scores["ate"], rel=1e-9)


def episode_on(floor):
    t = 0.5 * np.arange(5)
    pose = np.column_stack([np.linspace(0, 1, 5), np.linspace(0, 1, 5), np.full(5, np.pi / 4)])
    return Episode(
        preset("differential"),
        (Run(Log(t=t, wheel=np.zeros((5, 2)), pivot=np.empty((5, 0)), reference=pose), floor=floor),),
    )


@needs_evo
def test_evo_draws_the_exported_floor(evo, tmp_path):
    beside = Patch(center=(0.7, 0.4), size=(0.3, 0.3), friction=0.0)
    write_poses(tmp_path / "case", episode_on(Floor(patches=(beside,))), "tum", {})
    drawing = ("--plot_mode", "xy", "--ros_map_yaml", "case/run-01-floor.yaml", "--save_plot", "plot.png")
    evo("evo_traj", "tum", "case/run-01.tum", *drawing, "--no_warnings", results=False)
    (plot,) = tmp_path.glob("plot*traj*.png")
    pixels = np.asarray(Image.open(plot).convert("RGB"))
    rows, columns = np.nonzero(np.all(pixels == 0, axis=-1))  # the patch: evo draws the darkest shade black
    way = np.argwhere(np.ptp(pixels.astype(int), axis=-1) > 20)  # the path, from (0, 0) to (1, 1)
    (top, left), (bottom, right) = way.min(axis=0), way.max(axis=0)
    assert (columns.mean() - left) / (right - left) == pytest.approx(0.7, abs=0.03)
    assert (bottom - rows.mean()) / (bottom - top) == pytest.approx(0.4, abs=0.03)


def test_the_floor_is_written_where_it_is_not_even(tmp_path):
    for name, floor in (("even", Floor()), ("unknown", None), ("laid", FLOOR)):
        write_poses(tmp_path / name, episode_on(floor), "tum", {})
    assert [path.name for path in (tmp_path / "even").iterdir()] == ["run-01.tum"]
    assert [path.name for path in (tmp_path / "unknown").iterdir()] == ["run-01.tum"]
    assert Floor.load(tmp_path / "laid" / "run-01-floor.json") == FLOOR


def test_the_map_shows_patches_and_cables_where_they_lie():
    picture, resolution, origin = floor_map(FLOOR, np.array([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0)]))

    def shade(x, y):
        return picture[len(picture) - 1 - int((y - origin[1]) / resolution), int((x - origin[0]) / resolution)]

    assert (shade(0.0, 0.0), shade(1.0, 2.0), shade(-1.0, 0.5)) == (254, 120, 0)
    assert (shade(1.0, 2.28), shade(1.0, 2.32), shade(1.08, 2.0), shade(1.12, 2.0)) == (120, 254, 120, 254)
    assert (shade(-0.82, 0.5), shade(-0.78, 0.5), shade(-1.0, 0.52)) == (0, 254, 254)


def test_a_map_of_a_long_way_is_coarser_not_larger():
    picture, resolution, _ = floor_map(FLOOR, np.array([(0.0, 0.0, 0.0), (1000.0, 10.0, 0.0)]))
    assert max(picture.shape) <= 4001
    assert resolution == pytest.approx(1002.2 / 4000, rel=1e-3)
