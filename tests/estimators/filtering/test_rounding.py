"""How long a castor's angle is off by the same rounding: closed forms, and that the sample rate makes no difference."""

import numpy as np
import pytest

from estimators.filtering.creep import CARRIED, FIXED, STEERED, TRAILING
from estimators.filtering.rounding import FRESH, repeats, unread
from estimators.filtering.sample import WHEEL
from estimators.steps.rolling_equations import CASTOR, ROW

STEP = 2e-3
ROUNDING = STEP**2 / 12
OFFSET = 0.07


def castor(kind=TRAILING, lasted=1.0, repeated=0.0, settling=1.0):
    """Return the record of a castor whose reading has stayed for so many samples."""
    of = np.zeros((1, 1), CARRIED).view(np.recarray)
    of["step"], of["kind"], of["offset"] = STEP, kind, OFFSET
    of["lasted"], of["repeated"], of["settling"] = lasted, repeated, settling
    return of


def samples(changes, carried, way=0.0):
    """Yield u^2 and R of samples in which a reading changes or not; its one wheel rolls `way`, m, in each."""
    castors, wheels, rows = (np.zeros((1, 1), of).view(np.recarray) for of in (CASTOR, WHEEL, ROW))
    wheels["radius"], wheels["count"] = 1.0, 1.0
    for changed in changes:
        castors["swivel"] = STEP * changed
        repeats(castors, carried, wheels, rows, 0, np.full((1, 1), way))
        yield unread(carried[0, 0], False)


def information(changes):
    """Return what samples tell of an angle that all readings are off from, in readings whose errors are new."""
    variance, told = ROUNDING, 0.0
    for swivels, measured in samples(changes, castor()):
        part = measured / (variance + swivels + measured)  # of the last error that is left
        variance = (variance + swivels) * part
        told += (1 - part) ** 2 / (ROUNDING * (1 - part**2))  # innovations are independent
    return told * ROUNDING


@pytest.mark.parametrize("lasted", [1.0, 8.0])
def test_the_error_keeps_its_variance_and_forgets_by_the_ratio_of_times(lasted):
    carried = castor(STEERED, lasted)
    variance, correlation = ROUNDING, 1.0
    for n, (swivels, measured) in enumerate(samples([False] * 100, carried), start=1):
        part = measured / (variance + swivels + measured)
        variance, correlation = (variance + swivels) * part, correlation * part
        assert variance == pytest.approx(ROUNDING)
        assert correlation == pytest.approx(lasted / (lasted + n))


def test_where_a_reading_changes_its_error_is_new():
    (_, measured) = next(samples([True], castor(repeated=50.0)))
    assert measured == pytest.approx(ROUNDING, rel=0.01)
    assert unread(castor()[0, 0], False)[0] == (FRESH * STEP) ** 2


def test_a_castor_that_turns_slowly_tells_as_much_at_any_sample_rate():
    """A step takes 0.2 s: 4, 10 and 50 samples at 20, 50 and 250 Hz. Were all readings new, it would be as many
    times as much."""
    steps = 40
    told = [information(([True] + [False] * (per_step - 1)) * steps) / steps for per_step in (1, 4, 10, 50)]
    np.testing.assert_allclose(told, [1.0, 1.28, 1.33, 1.35], rtol=0.03)


def test_a_castor_that_stands_tells_hardly_more_than_its_last_reading():
    turned = ([True] + [False] * 9) * 10
    assert information(turned + [False] * 1000) - information(turned) == pytest.approx(
        0.5 * np.log(1010 / 20), rel=0.02
    )


def test_castors_that_the_floor_turns_go_on_while_wheels_say_so():
    carried = castor()
    assert [*samples([False] * 7, carried, way=OFFSET / 7)][-1][0] == ROUNDING / 7
    assert carried["settling"][0, 0] == pytest.approx(np.exp(-1.0))
    assert unread(carried[0, 0], True)[0] == pytest.approx((FRESH * STEP) ** 2 * np.exp(-2.0))
    turned_by_a_motor = castor(STEERED, repeated=7.0)
    assert unread(turned_by_a_motor[0, 0], True)[0] == ROUNDING / 7


def test_a_castor_that_does_not_swivel_has_no_angle_beyond_a_reading():
    assert unread(castor(FIXED)[0, 0], True)[0] == 0.0
