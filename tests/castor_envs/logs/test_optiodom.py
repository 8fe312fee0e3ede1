"""The OptiOdom importer, on sessions made here and, where they are, on the measured ones."""

import dataclasses
import itertools
import os
from pathlib import Path

import numpy as np
import pytest

from castor_envs.errors import InputError
from castor_envs.logs.csv import read_log
from castor_envs.logs.importers import import_sessions, importer, importer_of
from castor_envs.logs.importers.optiodom import direction, find_sessions, published_correction, read_session
from castor_envs.motion.kinematics import Geometry, forward
from castor_envs.vehicles.load import load_robot
from estimators.likelihood.log_likelihood import LogLikelihood

METADATA = {
    "type": ["diff"],
    "ngear": [43.7],
    "encRes": [64],
    "Li": [0.2],
    "Di": [0.084, 0.09],
    "Thi": [],
    "N": [2],
    "L": [0.75],
}
TRICYCLE = {
    "type": ["tricyc"],
    "ngear": [1],
    "encRes": [1600],
    "Li": [0.15],
    "Di": [0.065],
    "Thi": [0.02],
    "N": [1],
    "L": [],
}
OMNI = {
    "type": ["omni3"],
    "ngear": [12],
    "encRes": [1024],
    "Li": [0.195],
    "Di": [0.102, 0.1, 0.104],
    "Thi": [],
    "N": [1],
    "L": [],
}
# time, x, y, heading (wrapped on purpose), right, left
RUN = ["0,0,0,3.1,9,9", "0.05,0.1,0.2,3.14,4,6", "0.1,0.2,0.1,-3.1,-0,1", "0.15,0.3,0.1,-3.0,5,-2"]


def write_session(root, name="1", kind="diff/square", metadata=METADATA, runs=(RUN, RUN[:3])):
    folder = root / "optiodom" / kind / name
    folder.mkdir(parents=True)
    lines = [",".join([key, *map(str, values)]) + "," * (4 - len(values)) for key, values in metadata.items()]
    (folder / f"{name}_metadata.csv").write_text("\n".join(lines) + "\n")
    for k, rows in enumerate(runs, start=1):
        (folder / f"{name}_run-{k:02d}.csv").write_text("\n".join(rows) + "\n")
    return folder


def test_a_differential_session_keeps_sides_counts_and_truth(tmp_path):
    session = read_session(write_session(tmp_path))
    (axle,) = session.robot.castors
    left, right = axle.wheels
    assert (left.radius, right.radius) == (0.045, 0.042)
    assert left.lateral - right.lateral == pytest.approx(0.2)
    assert left.counts_per_rev == right.counts_per_rev == pytest.approx(43.7 * 64)
    assert (session.type, session.side, session.name) == ("diff", 0.75, "1")
    assert session.robot.sample_period == 0.05
    run, short = session.runs
    np.testing.assert_array_equal(run.wheel, [[0, 0], [6, 4], [7, 4], [5, 9]])
    np.testing.assert_array_equal(run.t, [0, 0.05, 0.1, 0.15])
    assert run.reference is not None
    np.testing.assert_allclose(run.reference[:, 2], [3.1, 3.14, 2 * np.pi - 3.1, 2 * np.pi - 3.0])
    assert len(short) == 3
    assert session.directions == ("ccw", "ccw")


def test_a_tricycle_has_a_virtual_steering_encoder(tmp_path):
    step = 2 * np.pi / 800
    rows = [
        f"{0.05 * k},0,0,{-0.01 * k},{k},{round(angle, 8)}" for k, angle in enumerate([0, step, -3 * step, -71 * step])
    ]
    session = read_session(write_session(tmp_path, metadata=TRICYCLE, runs=(rows,)))
    (run,) = session.runs
    front, rear = session.robot.castors
    np.testing.assert_array_equal(run.pivot[:, 0], [0, 1, -3, -71])
    np.testing.assert_array_equal(run.wheel[:, 0], [0, 1, 3, 6])
    assert front.pivot == (0.15, 0.0)
    assert front.pivot_counts_per_rev == 800
    assert front.pivot_zero == -0.02  # the metadata's offset is added to the reading, pivot_zero is taken off
    assert rear.steering == "fixed"
    assert session.robot.driven_wheels == (0,)
    assert session.side is None
    assert session.directions == ("cw",)


def test_a_steering_angle_is_read_to_the_decimals_that_it_has(tmp_path):
    rows = ["0,0,0,0,0,-0.23561945", "0.05,0,0,0,1,-0.24"]
    (run,) = read_session(write_session(tmp_path, metadata=TRICYCLE, runs=(rows,))).runs
    np.testing.assert_array_equal(run.pivot[:, 0], [-30, -30 - 1])


def test_an_omni_session_is_rolled_as_the_authors_matrix_says(tmp_path):
    rows = ["0,0,0,3.1,9,9,9", "0.04,0,0,3.0,1,2,-3", "0.08,0,0,3,-4,0,5"]
    session = read_session(write_session(tmp_path, metadata=OMNI, runs=(rows,)))
    (run,) = session.runs
    np.testing.assert_array_equal(run.wheel, [[0, 0, 0], [1, 2, -3], [-3, 2, 2]])
    assert run.pivot.shape == (3, 0)
    robot = session.robot
    assert (session.type, robot.sample_period, session.directions) == ("omni3", 0.04, ("cw",))
    assert [wheel.radius for wheel in robot.wheels] == [0.051, 0.05, 0.052]
    assert {(wheel.grip, wheel.roller_angle, wheel.counts_per_rev) for wheel in robot.wheels} == {("omni", 0.0, 12288)}
    np.testing.assert_allclose([np.hypot(*castor.pivot) for castor in robot.castors], 0.195)
    geometry = Geometry.of(robot)
    for v1, v2, v3 in np.eye(3):  # rolled distances, and how the authors' programs move the robot by them
        expected = [(v2 - v1) / np.sqrt(3), (2 * v3 - v1 - v2) / 3, -(v1 + v2 + v3) / (3 * 0.195)]
        twist = forward(geometry, geometry.angle, np.zeros(3), np.array([v1, v2, v3]) / geometry.radius)
        np.testing.assert_allclose(twist, expected, atol=1e-12)


def test_sessions_are_found_by_name(tmp_path):
    folders = [write_session(tmp_path, name, kind) for name, kind in (("20", "diff/free"), ("10", "tricyc/free"))]
    assert find_sessions(tmp_path) == {"10": folders[1], "20": folders[0]}
    with pytest.raises(InputError, match=r"optiodom: no such folder"):
        find_sessions(tmp_path / "elsewhere")
    (tmp_path / "bare" / "optiodom").mkdir(parents=True)
    with pytest.raises(InputError, match=r"holds no session"):
        find_sessions(tmp_path / "bare")


def test_sessions_are_recognised_and_written_as_logs(tmp_path):
    for name in ("10", "20"):
        write_session(tmp_path / "data", name)
    assert importer_of(tmp_path / "data") == importer("optiodom")
    written = dict(import_sessions(tmp_path / "data", tmp_path / "out"))
    assert [folder.relative_to(tmp_path / "out").as_posix() for folder in written] == ["10", "20"]
    for folder, session in written.items():
        assert load_robot(str(folder / "robot.json")) == session.vehicle
        for number, run in enumerate(session.runs, start=1):
            log = read_log(folder / f"run-{number}.csv", session.vehicle)
            np.testing.assert_array_equal(log.wheel, run.wheel)
            np.testing.assert_array_equal(log.reference, run.reference)
    with pytest.raises(InputError, match="no importer recognises"):
        importer_of(tmp_path)
    with pytest.raises(InputError, match="no such folder"):
        importer_of(tmp_path / "gone")
    with pytest.raises(InputError, match=r"run-1.csv: is a file; give the folder"):
        importer_of(tmp_path / "out" / "10" / "run-1.csv")
    with pytest.raises(InputError, match="did you mean 'optiodom'"):
        importer("optidom")


def changed(**values):
    return {key: value for key, value in {**METADATA, **values}.items() if value is not None}


MISTAKES = [
    (changed(type=["omni4"]), RUN, r"1_metadata.csv:1: column 'type': 'omni4' cannot .* of diff, tricyc or omni3"),
    (changed(Li=None), RUN, r"1_metadata.csv: column 'Li': is missing or blank"),
    (changed(Li=[]), RUN, r"1_metadata.csv: column 'Li': is missing or blank"),
    (changed(Li=["wide"]), RUN, r"1_metadata.csv:4: column 'Li': 'wide' is not a number"),
    (changed(Li=[-0.2]), RUN, r"1_metadata.csv:4: column 'Li': -0.2 is not above 0"),
    (changed(Di=[0.084]), RUN, r"1_metadata.csv:5: column 'Di': has 1 values; give 2"),
    (changed(N=[1.5]), RUN, r"1_metadata.csv:7: column 'N': 1.5 is not a whole number"),
    (changed(N=[2]), RUN, r"1_run-02.csv: cannot be read"),
    (METADATA, RUN[:1], r"1_run-01.csv: a run needs at least 2 rows, not 1"),
    (METADATA, [*RUN, "0.2,0,0,0,1"], r"1_run-01.csv:5: 5 cells where the columns of a run are 6"),
    (METADATA, [*RUN, "0.2,0,0,zero,1,1"], r"1_run-01.csv:5: column 'heading': 'zero' is not a number"),
    (METADATA, [*RUN, "0.2,0,0,0,1,nan"], r"1_run-01.csv:5: column 'left increment': 'nan' is not finite"),
    (METADATA, [*RUN, "0.1,0,0,0,1,1"], r"1_run-01.csv:5: column 'time': 0.1 does not come after 0.15"),
    (TRICYCLE, [*RUN[:1], "0.05,0,0,0,1,0.004"], r"1_run-01.csv:.: column 'steering angle': .* not a multiple of"),
    ({**OMNI, "Di": [0.1, 0.1]}, RUN, r"1_metadata.csv:5: column 'Di': has 2 values; give 3"),
    (OMNI, RUN, r"1_run-01.csv:1: 6 cells where the columns of a run are 7"),
    (OMNI, ["0,0,0,0,1,1,1", "1,0,0,0,1,1,one"], r"1_run-01.csv:2: column 'increment 3': 'one' is not a number"),
]


@pytest.mark.parametrize(("metadata", "run", "message"), MISTAKES)
def test_garbled_sessions_are_named_with_their_place(tmp_path, metadata, run, message):
    folder = write_session(tmp_path, metadata=metadata, runs=(run,))
    with pytest.raises(InputError, match=message):
        read_session(folder)


def test_missing_folders_and_metadata_are_named(tmp_path):
    with pytest.raises(InputError, match=r"gone: no such folder"):
        read_session(tmp_path / "gone")
    with pytest.raises(InputError, match=r"_metadata.csv: cannot be read"):
        read_session(tmp_path)


def test_unknown_corrections_name_the_known_ones():
    with pytest.raises(InputError, match="did you mean '230620202042'"):
        published_correction("230620202043")


def test_a_correction_changes_the_axle_and_nothing_else(tmp_path):
    robot = read_session(write_session(tmp_path)).robot
    correction = published_correction("230620202042")
    corrected = correction.apply(robot)
    left, right = corrected.castors[0].wheels
    assert 2 * right.radius / (2 * left.radius) == pytest.approx(correction.diameter_ratio, rel=1e-12)
    assert right.radius + left.radius == pytest.approx(0.084, rel=1e-12)
    assert left.lateral - right.lateral == pytest.approx(correction.wheel_base, rel=1e-12)
    assert correction.apply(corrected) == corrected
    assert corrected.sample_period == robot.sample_period


# The published worked examples. Error: truth minus odometry at the last row. Centroids in mm, of the clockwise and of
# the counter-clockwise runs; largest end error in mm, nominal and corrected; wheel base and diameters D_R, D_L in m.
PUBLISHED = {
    "230620202042": ([[-10.9, -6.2], [-23.2, 19.7]], 33.3, 7.2, (0.20146, 0.08395, 0.08405)),
    "230620202144": (None, 66.8, 4.6, (0.20130, 0.08398, 0.08402)),
}


@pytest.mark.parametrize("name", PUBLISHED)
def test_the_corrections_are_the_printed_ones_to_the_printed_digit(name):
    correction = published_correction(name)
    assert (correction.wheel_base, *correction.diameters) == pytest.approx(PUBLISHED[name][3], abs=0.51e-5)


@pytest.fixture(scope="module")
def sessions():
    root = Path(os.environ.get("CASTOR_DATA", ""))
    if not os.environ.get("CASTOR_DATA") or not (root / "optiodom").is_dir():
        pytest.skip("the measured data are absent: CASTOR_DATA names no folder that holds optiodom/")
    return find_sessions(root)


def end_errors(session, robot):
    """Truth minus odometry at the end, m, by the midpoint rule on counts: independent of estimators and kinematics."""
    left, right = robot.castors[0].wheels
    errors = []
    for run in session.runs:
        step = np.diff(run.wheel, axis=0) * 2 * np.pi / left.counts_per_rev * [left.radius, right.radius]
        turn = (step[:, 1] - step[:, 0]) / (left.lateral - right.lateral)
        x, y, psi = run.reference[0]
        middle = psi + np.cumsum(turn) - turn / 2
        ahead = step.mean(axis=1)
        errors.append(run.reference[-1, :2] - [x + ahead @ np.cos(middle), y + ahead @ np.sin(middle)])
    return np.array(errors)


@pytest.mark.parametrize("name", PUBLISHED)
def test_the_published_worked_example_comes_out(sessions, name):
    centroids, nominal_error, corrected_error, _ = PUBLISHED[name]
    session = read_session(sessions[name])
    assert session.directions == ("cw",) * 3 + ("ccw",) * 3
    nominal = 1e3 * end_errors(session, session.robot)
    if centroids:
        np.testing.assert_allclose([nominal[:3].mean(axis=0), nominal[3:].mean(axis=0)], centroids, atol=0.1)
    assert np.linalg.norm(nominal, axis=1).max() == pytest.approx(nominal_error, abs=0.1)
    corrected = 1e3 * end_errors(session, published_correction(name).apply(session.robot))
    assert np.linalg.norm(corrected, axis=1).max() == pytest.approx(corrected_error, abs=0.1)


@pytest.mark.parametrize("name", PUBLISHED)
def test_the_published_procedure_gives_the_published_factors(sessions, name):
    """UMBmark (Borenstein, Feng 1996) from the x of the centroids, as the authors' program has it."""
    session, correction = read_session(sessions[name]), published_correction(name)
    error = end_errors(session, session.robot)
    assert session.side is not None
    cw, ccw = error[:3, 0].mean(), error[3:, 0].mean()
    alpha, beta = (cw + ccw) / (-4 * session.side), (cw - ccw) / (-4 * session.side)
    if name == "230620202042":
        assert np.degrees([alpha, beta]) == pytest.approx([0.651, -0.236], abs=6e-4)
    wheel_base_factor = (np.pi / 2) / (np.pi / 2 - alpha)
    radius, half = session.side / 2 / np.sin(beta / 2), wheel_base_factor * correction.nominal_wheel_base / 2
    assert wheel_base_factor == pytest.approx(correction.wheel_base_factor, abs=0.6e-5)
    assert (radius + half) / (radius - half) == pytest.approx(correction.diameter_ratio, abs=0.6e-5)


def test_the_omni_wheels_are_taken_in_the_only_order_and_sense_that_follow_the_path(sessions):
    session = read_session(sessions["211220201842"])
    (run,) = session.runs
    truth = run.reference
    assert truth is not None
    length = np.linalg.norm(np.diff(truth[:, :2], axis=0), axis=1).sum()
    assert length == pytest.approx(8.466, abs=1e-3)
    geometry = Geometry.of(session.robot)
    farthest = {}  # distance between odometry, with nominal numbers, and truth, over the length of the path
    for order in itertools.permutations(range(3)):
        for sense in itertools.product((1, -1), repeat=3):
            rewired = dataclasses.replace(run, wheel=run.wheel[:, order] * np.array(sense))
            away = (LogLikelihood(geometry, rewired).odometry(geometry) - truth)[:, :2]
            farthest[order, sense] = np.linalg.norm(away, axis=1).max() / length
    assert farthest.pop(((0, 1, 2), (1, 1, 1))) == pytest.approx(0.0184, abs=2e-4)
    assert len(farthest) == 47
    assert min(farthest.values()) == pytest.approx(0.167, abs=1e-3)


def test_every_measured_session_is_read(sessions):
    for name, folder in sessions.items():
        session = read_session(folder)
        assert session.name == name
        assert all(run.reference is not None and np.isfinite(run.reference).all() for run in session.runs)
        assert session.directions == tuple(direction(run) for run in session.runs)
