"""The picture of UMBmark's end points before and after a correction."""

import io

import numpy as np
import pytest
from matplotlib.image import imread

from benchmarks.scatter import umbmark_scatter
from castor_envs.errors import InputError

BEFORE = ([[-0.010, -0.006, 0.1], [-0.012, -0.007, 0.1]], [[-0.023, 0.020], [-0.024, 0.021], [-0.022, 0.019]])
AFTER = ([[0.001, 0.002]], [[-0.001, 0.001]])


def test_all_end_points_and_centroids_are_drawn_in_millimetres():
    figure = umbmark_scatter(BEFORE, AFTER)
    (axes,) = figure.axes
    drawn = [np.asarray(collection.get_offsets()) for collection in axes.collections]
    assert [len(points) for points in drawn] == [2, 1, 3, 1, 1, 1, 1, 1]
    np.testing.assert_allclose(drawn[0], 1e3 * np.array(BEFORE[0])[:, :2])
    np.testing.assert_allclose([drawn[1][0], drawn[3][0]], [[-11, -6.5], [-23, 20]])
    np.testing.assert_allclose(drawn[-1], [[-1, 1]])
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    pixels = imread(io.BytesIO(buffer.getvalue()))[..., :3]
    for color in ((0, 114, 178), (213, 94, 0)):
        assert np.any(np.all(np.abs(pixels - np.array(color) / 255) < 0.02, axis=-1))


@pytest.mark.parametrize("cw", [[], [[np.nan, 0.0]], [0.1, 0.2]])
def test_runs_that_cannot_be_drawn_are_named(cw):
    with pytest.raises(InputError, match="before, cw: give the finite return errors"):
        umbmark_scatter((cw, BEFORE[1]), AFTER)
