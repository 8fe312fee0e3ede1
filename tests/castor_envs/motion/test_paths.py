"""Paths for trains: one smooth curve for all axles, measured along its length."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from castor_envs.errors import InputError
from castor_envs.motion.paths import (
    PATHS,
    TrainPath,
    arc,
    axles_behind,
    named_path,
    random_path,
    s_bend,
    straight,
)

legs = st.lists(st.tuples(st.floats(0.05, 2.0), st.floats(-3.0, 3.0)), min_size=1, max_size=6)
STEP = 1e-5


@given(legs=legs)
def test_a_path_is_a_curve_by_its_length_with_the_curvature_of_its_legs(legs):
    """|d pose / ds| = 1 along the heading, d psi / ds = curvature, on every leg, before and after them all."""
    path = TrainPath("any", tuple(legs))
    ends = np.cumsum([length for length, _ in legs])
    middles = np.concatenate([[-0.7], ends - 0.5 * np.array([length for length, _ in legs]), [ends[-1] + 0.4]])
    expected = [0.0, *(curvature for _, curvature in legs), 0.0]
    (before, _), (pose, curvature), (after, _) = (path.at(middles + d) for d in (-STEP, 0.0, STEP))
    np.testing.assert_array_equal(curvature, expected)
    slope = (after - before) / (2 * STEP)
    heading = np.stack([np.cos(pose[:, 2]), np.sin(pose[:, 2])], axis=-1)
    np.testing.assert_allclose(slope[:, :2], heading, atol=1e-8)
    np.testing.assert_allclose(slope[:, 2], expected, atol=1e-8)


@given(legs=legs)
def test_a_path_has_no_jumps_where_legs_meet(legs):
    path = TrainPath("any", tuple(legs))
    joints = np.concatenate([[0.0], np.cumsum([length for length, _ in legs])])
    (before, _), (at_joint, _), (after, _) = (path.at(joints + d) for d in (-1e-9, 0.0, 1e-9))
    np.testing.assert_allclose(before, at_joint, atol=1e-8)
    np.testing.assert_allclose(after, at_joint, atol=1e-8)
    np.testing.assert_allclose(path.at(0.0)[0], 0.0, atol=1e-12)


@given(legs=legs, s=st.floats(-3.0, 0.0))
def test_behind_its_start_a_path_is_the_straight_line_into_it(legs, s):
    pose, curvature = TrainPath("any", tuple(legs)).at(s)
    np.testing.assert_allclose(pose, [s, 0.0, 0.0], atol=1e-12)
    assert curvature == (0.0 if s < 0 else legs[0][1])


@given(legs=legs, beyond=st.floats(0.01, 3.0))
def test_beyond_its_end_a_path_goes_straight_on(legs, beyond):
    path = TrainPath("any", tuple(legs))
    length = sum(length for length, _ in legs)
    end, _ = path.at(length)
    pose, curvature = path.at(length + beyond)
    x, y, psi = end
    np.testing.assert_allclose(pose, [x + beyond * math.cos(psi), y + beyond * math.sin(psi), psi], atol=1e-9)
    assert curvature == 0.0


def test_lengths_of_any_shape_give_poses_of_that_shape():
    poses, curvatures = s_bend().at(np.linspace(-1, 4, 12).reshape(3, 2, 2))
    assert poses.shape == (3, 2, 2, 3)
    assert curvatures.shape == (3, 2, 2)


def test_it_takes_the_time_of_a_start_a_steady_drive_and_a_stop():
    path = TrainPath("long", ((3.0, 0.5),), speed=0.5, acceleration=0.25)
    assert path.duration == pytest.approx(3.0 / 0.5 + 0.5 / 0.25)
    covered, speed = path.progress(np.array([0.0, 2.0, 4.0, 8.0, 9.0]))
    np.testing.assert_allclose(covered, [0.0, 0.5, 1.5, 3.0, 3.0], atol=1e-12)
    np.testing.assert_allclose(speed, [0.0, 0.5, 0.5, 0.0, 0.0], atol=1e-12)
    assert TrainPath("short", ((0.25, 0.0),), speed=10.0, acceleration=0.25).duration == pytest.approx(2.0)


def test_named_paths_lead_where_their_names_say():
    def end(path):
        return path.at(path.length)[0]

    np.testing.assert_allclose(end(straight(2.0)), [2.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(end(arc(1.0, math.pi)), [0.5 - 0.5, 2.0, math.pi], atol=1e-12)
    np.testing.assert_allclose(end(arc(2.0, math.pi / 2)), [2.5, 2.5, math.pi / 2], atol=1e-12)
    np.testing.assert_allclose(end(s_bend(0.8, math.pi / 2)), [0.5 + 1.6 + 0.5, 1.6, 0.0], atol=1e-12)
    for name, make in PATHS.items():
        assert named_path(name) == make()
    assert {"straight", "arc", "s-bend"} <= set(PATHS)
    path = TrainPath("mine", ((1.0, 0.3),))
    assert named_path(path) is path


@given(seed=st.integers(0, 2**32 - 1), sharpest=st.floats(0.1, 3.0))
def test_random_paths_are_arcs_of_the_lengths_and_curvatures_described(seed, sharpest):
    path = random_path(np.random.default_rng(seed), sharpest)
    lengths, curvatures = np.array(path.legs).T
    assert 5.0 <= lengths.sum() <= 6.0
    assert lengths.min() >= 0.4
    assert lengths.max() <= 1.0
    assert np.abs(curvatures).max() <= sharpest
    assert random_path(np.random.default_rng(seed), sharpest) == path


def test_a_random_path_is_drawn_from_the_generator_given():
    random = np.random.default_rng(4)
    first, second = named_path("random", random), named_path("random", random)
    assert first != second
    assert named_path("random", np.random.default_rng(4)) == first


@pytest.mark.parametrize(
    ("name", "said"), [("s-bent", "did you mean 's-bend'"), ("xyz", "straight"), (3, "3"), (None, "None")]
)
def test_an_unknown_path_is_refused_by_name(name, said):
    with pytest.raises(InputError, match=said):
        named_path(name, np.random.default_rng(0))


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"legs": ()}, "no leg"),
        ({"legs": ((0.0, 1.0),)}, "length above 0"),
        ({"legs": ((1.0, 0.0), (-0.5, 1.0))}, r"-0\.5"),
        ({"legs": ((math.inf, 0.0),)}, "inf"),
        ({"legs": ((math.nan, 0.0),)}, "nan"),
        ({"legs": ((1.0, math.inf),)}, "finite curvature"),
        ({"legs": ((1.0, math.nan),)}, "finite curvature"),
        ({"legs": ((1.0, 0.0),), "speed": 0.0}, "speed"),
        ({"legs": ((1.0, 0.0),), "speed": math.inf}, "speed"),
        ({"legs": ((1.0, 0.0),), "acceleration": -1.0}, "acceleration"),
        ({"legs": ((1.0, 0.0),), "acceleration": math.nan}, "acceleration"),
    ],
)
def test_an_impossible_path_is_refused_and_says_why(wrong, said):
    with pytest.raises(InputError, match=said) as error:
        TrainPath("mine", **wrong)
    assert "'mine'" in str(error.value)


def test_axles_stand_a_frame_s_length_behind_each_other():
    np.testing.assert_allclose(axles_behind([0.35, 0.5, 0.1]), [0.0, 0.35, 0.85, 0.95])
    np.testing.assert_array_equal(axles_behind([]), [0.0])


def test_on_an_arc_axles_are_as_far_apart_as_a_frame_bent_like_the_arc():
    """The chord between them is 2 R sin(L / 2 R): a frame between them bends without any force along it."""
    poses, _ = arc(1.0, math.pi).at(2.0 - axles_behind([0.35, 0.35]))
    for front, rear in pairwise(poses):
        assert math.dist(front[:2], rear[:2]) == pytest.approx(2 * math.sin(0.175), abs=1e-12)
        assert front[2] - rear[2] == pytest.approx(0.35)


@pytest.mark.parametrize("legs", [((1,),), ((1, 0, 0),), "ab", (("a", 0),), None, 3])
def test_legs_that_are_no_pairs_are_refused(legs):
    with pytest.raises(InputError, match="legs are pairs of numbers"):
        TrainPath("odd", legs)


def test_a_speed_that_is_no_number_is_refused():
    with pytest.raises(InputError, match="speed must be a finite number"):
        TrainPath("odd", ((1.0, 0.0),), speed="a")  # pyright: ignore[reportArgumentType]


def test_a_path_with_stops_is_driven_as_paths_from_stop_to_stop():
    """From rest to rest over s m at v and a takes s / v + v / a (closed form of a trapezoid)."""
    path = TrainPath("stops", ((3.0, 0.5), (2.0, -0.5)), speed=0.5, acceleration=0.5, stops=(1.0, 3.5))
    assert path.duration == pytest.approx(5.0 / 0.5 + 3 * 0.5 / 0.5)
    covered, speed = path.progress([0.0, 3.0, 3.5, 9.0, 13.0, 14.0])
    np.testing.assert_allclose(covered, [0.0, 1.0, 1.0625, 3.5, 5.0, 5.0])
    np.testing.assert_allclose(speed, [0.0, 0.0, 0.25, 0.0, 0.0, 0.0], atol=1e-12)


@pytest.mark.parametrize("stops", [(0.0,), (2.0,), (1.0, 0.5), (1.0, 1.0), (float("nan"),)])
def test_stops_that_are_none_are_refused(stops):
    with pytest.raises(InputError, match=r"stops must increase .* 2 m"):
        TrainPath("odd", ((2.0, 0.0),), stops=stops)
