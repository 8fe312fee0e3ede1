"""Rigid alignment: it undoes any motion of a whole path, and leaves the least errors."""

import numpy as np
from scipy.optimize import least_squares

from castor_envs.geometry.alignment import aligned
from castor_envs.geometry.se2 import compose

RANDOM = np.random.default_rng(3)
SIZE = 0.3


def path():
    """A path of 40 poses."""
    return np.cumsum(RANDOM.normal(size=(40, 3)) * [0.1, 0.1, 0.2], axis=0)


def test_a_path_that_was_moved_as_a_whole_comes_back():
    reference = path()
    np.testing.assert_allclose(aligned(compose([3.0, -2.0, 2.5], reference), reference, SIZE), reference, atol=1e-12)


def test_no_other_motion_of_the_whole_leaves_smaller_errors():
    """Against a search: by the chords of headings' errors."""
    reference = path()
    off = reference + RANDOM.normal(size=reference.shape) * 0.05

    def errors(moved):
        found = compose(moved, off) - reference
        return np.column_stack([found[:, :2], 2 * SIZE * np.sin(found[:, 2:] / 2)]).ravel()

    best = least_squares(errors, np.zeros(3), xtol=1e-12, ftol=1e-12, gtol=1e-12)
    np.testing.assert_allclose(aligned(off, reference, SIZE), compose(best.x, off), atol=1e-6)


def test_a_robot_that_turns_on_the_spot_is_aligned_by_its_headings():
    reference = np.column_stack([np.zeros((20, 2)), np.linspace(0.0, 6.0, 20)])
    found = aligned(compose([1.0, 1.0, -0.7], reference), reference, SIZE)
    np.testing.assert_allclose(found, reference, atol=1e-12)


def test_one_pose_is_met():
    np.testing.assert_allclose(
        aligned(np.array([[1.0, 2.0, 3.0]]), np.array([[0.0, 0.5, 0.2]]), SIZE), [[0.0, 0.5, 0.2]]
    )
