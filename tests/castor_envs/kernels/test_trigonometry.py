"""Cosine and sine by plain arithmetic are those of the library, nearly to the last bit."""

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from castor_envs.kernels.trigonometry import cosine_and_sine

angles = st.floats(-1e4, 1e4) | st.integers(-6000, 6000).map(lambda quarters: quarters * math.pi / 2)


@given(angles)
def test_as_the_library(angle):
    cosine, sine = cosine_and_sine(angle)
    assert abs(cosine - math.cos(angle)) < 2.3e-16  # half a last bit each, and what rounding at a power of two adds
    assert abs(sine - math.sin(angle)) < 2.3e-16


@given(angles)
def test_symmetric_to_the_last_bit(angle):
    cosine, sine = cosine_and_sine(angle)
    assert cosine_and_sine(-angle) == (cosine, -sine)
    assert abs(math.hypot(cosine, sine) - 1.0) < 4e-16


def test_exact_on_the_axes():
    assert cosine_and_sine(0.0) == (1.0, 0.0)
    for quarters, (cosine, sine) in enumerate([(0, 1), (-1, 0), (0, -1), (1, 0)], start=1):
        np.testing.assert_allclose(cosine_and_sine(quarters * math.pi / 2), (cosine, sine), rtol=0, atol=2.5e-16)
