"""Unnamed alternatives: what has no name in the catalogue is not given the name of what looks like it."""

# pyright: reportOptionalIterable=false

import numpy as np
import pytest
from scipy.signal import lsim

from castor_envs.geometry.arrays import Array
from castor_envs.motion.mobility import moves_sideways
from castor_envs.motion.trajectories import wander
from castor_envs.vehicles.presets import preset
from discrepancy.hypotheses.candidates import SWAYING
from discrepancy.posterior.finder import diagnose
from discrepancy.trials.outside import FlatSpot, SwingingPoint, WeakStretch
from discrepancy.trials.pymunk_generator import drive

pytestmark = pytest.mark.slow

DAMPING = 0.5


class SoftMast(SwingingPoint):
    """The tracked point is on a mast of this natural frequency (Hz), a spring and a damper in each direction, that the
    body's acceleration bends."""

    def tracked(self, t: Array, pose: Array) -> Array:
        at, seen, natural = np.arange(t[0], t[-1], 0.002), pose.copy(), 2 * np.pi * self.value
        oscillator = [-1.0, 0.0, 0.0], [1.0, 2 * DAMPING * natural, natural**2]  # bends by this times the way
        for axis in (0, 1):
            _, bent, _ = lsim(oscillator, np.interp(at, t, pose[:, axis]) - pose[0, axis], at - at[0])
            seen[:, axis] += np.interp(t, at, bent)
        return seen


def examined(name, outside):
    robot = preset(name)
    log, held_out = (
        drive(
            robot,
            wander(np.random.default_rng([seed, 1]), duration=40.0, holonomic=moves_sideways(robot)),
            seed,
            duration=40.0,
            outside=outside,
        )
        for seed in (3, 4)
    )
    return diagnose(robot, [log], [held_out])


@pytest.mark.parametrize("name", ["1-castor", "asoc-prototype"])
def test_a_soft_mast_is_no_wrong_dimension(name):
    """Were it to bend at once, the size would be minus one over the square of its natural frequency."""
    diagnosis = examined(name, SoftMast(castor=1, wheel=None, value=2.0))
    (answer,) = (answer for answer in diagnosis.answers if answer.verdict != "negligible")
    assert (answer.verdict, answer.candidate) == ("unexplained", SWAYING)
    assert -1.5 < answer.size * (2 * np.pi * 2.0) ** 2 < -0.5


def test_no_effect_stays_in_the_model_that_only_fits_like_what_has_no_name():
    """Without a name for the mast, fits with an offset of the castor are likelier than without."""
    diagnosis = examined("1-castor", SoftMast(castor=1, wheel=None, value=1.3))
    assert diagnosis.verdict == "unexplained"
    assert diagnosis.found.effects == ()
    before, after = (seen.gap for seen in diagnosis.held_out)
    assert after == pytest.approx(before)


def test_a_flat_spot_is_not_surely_an_eccentric_wheel():
    """Of a wheel that repeats an error every turn, an eccentric one explains the part that goes up and down once."""
    diagnosis = examined("differential", FlatSpot(castor=1, wheel=1, value=0.1, seed=1))
    assert diagnosis.verdict in ("ambiguous", "unexplained")
    assert not any(answer.verdict == "named" for answer in diagnosis.answers)


def test_an_encoder_that_reads_too_little_for_a_while_is_told_with_its_times():
    """0.5 % for 7 s, of which a third passes for creep."""
    outside = WeakStretch(castor=2, wheel=1, value=0.005, seed=6)
    first, lasts = np.random.default_rng(outside.seed).uniform((5.0, 4.0), (40.0, 12.0))
    diagnosis = examined("4-castor", outside)
    assert diagnosis.verdict == "unexplained"
    (answer,) = (answer for answer in diagnosis.answers if answer.verdict == "unexplained")
    assert answer.candidate.what.startswith("wheel_2l reads in proportion too much from ")
    start, _, end, _ = answer.candidate.what.partition(" from ")[2].split()
    assert abs(float(start) - first) < 1.0
    assert abs(float(end) - min(first + lasts, 40.0)) < 1.0
    assert answer.size / outside.value == pytest.approx(-0.68, abs=0.05)


def test_counts_that_are_lost_once_are_no_bursts():
    """However many seconds that lasts: 1 % for 7 s was told as bursts of lost counts, as sure, as it was in each."""
    diagnosis = examined("4-castor", WeakStretch(castor=2, wheel=1, value=0.01, seed=6))
    (answer,) = (answer for answer in diagnosis.answers if answer.verdict != "negligible")
    assert answer.verdict in ("ambiguous", "unexplained")
    assert answer.unnamed
