"""How long a castor's angle is off by the same rounding: closed forms, and that the sample rate makes no difference."""

import numpy as np
import pytest

from estimators.filtering.creep import CARRIED, FIXED, STEERED, TRAILING
from estimators.filtering.rounding import GOES_ON, kept, repeats
from estimators.filtering.sample import WHEEL
from estimators.steps.rolling_equations import CASTOR, ROW

OFFSET = 0.07


def castor(kind=TRAILING, lasted=1.0, repeated=0.0, settling=1.0):
    """Return the record of a castor whose reading has stayed for so many samples."""
    of = np.zeros((1, 1), CARRIED).view(np.recarray)
    of["kind"], of["offset"] = kind, OFFSET
    of["lasted"], of["repeated"], of["settling"] = lasted, repeated, settling
    return of


def parts(changes, carried, way=0.0, *, settles=False):
    """Yield what is kept of the error in samples where a reading changes or not; the castor rolls `way`, m, in each."""
    castors, wheels, rows = (np.zeros((1, 1), of).view(np.recarray) for of in (CASTOR, WHEEL, ROW))
    wheels["radius"], wheels["count"] = 1.0, 1.0
    for changed in changes:
        castors["swivel"] = float(changed)
        repeats(castors, carried, wheels, rows, 0, np.full((1, 1), way))
        yield kept(carried[0, 0], settles)


def information(changes):
    """Return what readings tell of an angle that all are off from, in readings whose errors are new."""
    return sum((1 - part) / (1 + part) for part in parts(changes, castor()))  # innovations are independent


@pytest.mark.parametrize("lasted", [1.0, 8.0])
def test_the_error_is_forgotten_by_the_ratio_of_times(lasted):
    correlation = np.cumprod([*parts([False] * 100, castor(STEERED, lasted))])
    np.testing.assert_allclose(correlation, lasted / (lasted + np.arange(1, 101)), rtol=1e-12)


def test_where_a_reading_changes_its_error_is_new():
    carried = castor(repeated=50.0)
    assert [*parts([True], carried)] == [0.0]
    assert (carried["lasted"][0, 0], carried["repeated"][0, 0]) == (51.0, 0.0)


def test_a_castor_that_turns_slowly_tells_as_much_at_any_sample_rate():
    """A step takes 0.2 s: 4, 10 and 50 samples at 20, 50 and 250 Hz. Were all readings new, it would be as many times
    as much."""
    steps = 40
    told = [information(([True] + [False] * (per_step - 1)) * steps) / steps for per_step in (1, 4, 10, 50)]
    np.testing.assert_allclose(told, [1.0, 1.28, 1.33, 1.35], rtol=0.03)


def test_a_castor_that_stands_tells_hardly_more_than_its_last_reading():
    turned = ([True] + [False] * 9) * 10
    stood = information(turned + [False] * 1000) - information(turned)
    assert stood == pytest.approx(0.5 * np.log(1010 / 20), rel=0.02)


def test_castors_that_the_floor_turns_go_on_while_wheels_say_so():
    carried, turned_by_a_motor = castor(), castor(STEERED)
    way, n = OFFSET / 7, 7
    *_, part = parts([False] * n, carried, way, settles=True)
    assert carried["settling"][0, 0] == pytest.approx(np.exp(-1.0))
    assert part == pytest.approx(1 / (1 + 12 * (GOES_ON * np.exp(-1.0)) ** 2))
    *_, part = parts([False] * n, turned_by_a_motor, way, settles=True)
    assert part == n / (n + 1)


def test_a_castor_that_does_not_swivel_keeps_its_angle():
    assert kept(castor(FIXED)[0, 0], True) == 1.0
