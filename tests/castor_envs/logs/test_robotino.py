"""The Robotino importer, on runs made here and, where they are, on the measured ones."""

import math
import os
from pathlib import Path

import numpy as np
import pytest

from castor_envs.errors import InputError
from castor_envs.geometry.se2 import relative_pose
from castor_envs.logs.importers import importer, importer_of
from castor_envs.logs.importers.robotino import COUNTS, PIXEL, RADIUS, find_sessions, read_session
from castor_envs.motion.kinematics import Geometry, forward

HEADING = "Time;Motor;...\nms;ticks;...\nt;setvel;m1pos;m2pos;m3pos;xpos;ypos;ang;dang;\n"


def write_runs(root, folder="one_surface_type/gray_surface", runs=((),), heading=HEADING):
    place = root / "robotino" / "datasets" / folder
    place.mkdir(parents=True)
    for k, rows in enumerate(runs):
        text = "".join(";".join(map(str, row)) + ";\n" for row in rows)
        (place / f"exp{k:02d}.csv").write_text(heading + text)
    return place


# t, setvel, three counts, x and y in pixels, degrees, dang
RUN = ((0.5, 0, 0, 1, 2, 800, 900, 359.5, 0), (30.5, 0, -10, 1, 12, 801, 890, 0.5, 0))


def test_pixels_become_metres_with_y_up_and_headings_unwrapped(tmp_path):
    session = read_session(write_runs(tmp_path, runs=(RUN,)))
    (run,) = session.runs
    np.testing.assert_allclose(run.t, [0.0005, 0.0305])
    np.testing.assert_array_equal(run.wheel, [[0, 1, 2], [-10, 1, 12]])
    assert run.reference is not None
    np.testing.assert_allclose(np.diff(run.reference[:, :2], axis=0), [[PIXEL[0], 10 * PIXEL[1]]])
    np.testing.assert_allclose(np.degrees(run.reference[:, 2]), [449.5, 450.5])
    assert session.vehicle.sample_period == pytest.approx(0.03)


def test_the_robot_moves_as_the_authors_matrix_says(tmp_path):
    """Row i of the matrix: a wheel turns by (-sin a vx + cos a vy + R omega) / r, a = 60, 180 and 300 deg."""
    geometry = Geometry.of(read_session(write_runs(tmp_path, runs=(RUN,))).vehicle)
    a, r, distance = np.array([math.pi / 3, math.pi, 5 * math.pi / 3]), 0.04, 0.125
    for twist in np.eye(3):
        rates = np.column_stack([-np.sin(a), np.cos(a), np.full(3, distance)]) @ twist / r
        np.testing.assert_allclose(forward(geometry, geometry.angle, np.zeros(3), rates), twist, atol=1e-12)


def test_folders_are_sessions_whatever_they_are_called(tmp_path):
    for folder in ("one_surface_type/gray_surface", "other/gray_surface", "two_surface_types/ice_lawn"):
        write_runs(tmp_path, folder, runs=(RUN, RUN))
    assert set(find_sessions(tmp_path)) == {"gray", "other-gray", "ice_lawn"}
    assert importer_of(tmp_path) == importer("robotino")
    with pytest.raises(InputError, match="no such folder"):
        find_sessions(tmp_path / "elsewhere")
    (tmp_path / "bare" / "robotino").mkdir(parents=True)
    with pytest.raises(InputError, match="holds no session"):
        find_sessions(tmp_path / "bare")


@pytest.mark.parametrize(
    ("rows", "heading", "complaint"),
    [
        (RUN[:1], HEADING, "exp00.csv: a run needs"),
        (RUN, HEADING.replace("m2pos", "motor2"), "exp00.csv:3: column 'm2pos'"),
        ((RUN[0], (30.5, 0, "x", 1, 2, 3, 4, 5, 0)), HEADING, "exp00.csv:5: column 'm1pos': 'x' is not a number"),
        ((RUN[1], RUN[0]), HEADING, "exp00.csv:5: column 't'"),
        ((RUN[0], (30.5, 0, 1)), HEADING, "exp00.csv:5: has"),
    ],
)
def test_what_is_garbled_is_named(tmp_path, rows, heading, complaint):
    with pytest.raises(InputError, match=complaint):
        read_session(write_runs(tmp_path, runs=(rows,), heading=heading))


@pytest.mark.skipif(
    not (Path(os.environ.get("CASTOR_DATA", "/nowhere")) / "robotino").is_dir(), reason="Robotino's data are not here"
)
def test_the_measured_robot_goes_where_its_wheels_roll():
    """On the hard floor odometry and camera agree on direction, and on distance up to slip."""
    session = read_session(find_sessions(os.environ["CASTOR_DATA"])["table"])
    geometry = Geometry.of(session.vehicle)
    for run in session.runs:
        assert run.reference is not None
        turned = (run.wheel[-1] - run.wheel[0]) * 2 * math.pi / COUNTS
        rolled = forward(geometry, geometry.angle, np.zeros(3), turned)
        went = relative_pose(run.reference[0], run.reference[-1])
        ratio = complex(*went[:2]) / complex(*rolled[:2])
        assert 0.8 < abs(ratio) < 1.0
        assert abs(math.atan2(ratio.imag, ratio.real)) < math.radians(20)  # it turns by up to 30 deg, slipping
        assert RADIUS * abs(turned).max() < 3.0
