"""The drawing of a robot's file: parts stand where the file says, read off the figure in mm."""

import dataclasses

import numpy as np
import pytest
from matplotlib.patches import Polygon

from castor_envs.rendering.drawing import palette
from castor_envs.rendering.layout import layout_figure
from castor_envs.vehicles.presets import any_preset, cfmmr, preset


def tyres(figure, color):
    """Return the middles (k, 2), mm, of polygons of a colour."""
    (axes,) = figure.axes
    shapes = [patch for patch in axes.patches if isinstance(patch, Polygon)]
    wanted = [shape for shape in shapes if np.allclose(shape.get_facecolor()[:3], np.array(color) / 255)]
    corners = [shape.get_xy() for shape in wanted]
    return np.array([(corner.min(axis=0) + corner.max(axis=0)) / 2 for corner in corners])


def words(figure):
    return [text.get_text() for text in figure.axes[0].texts]


def arrows(figure):
    """Return start and end (k, 2, 2), mm, of the arrows on wheels."""
    found = [
        text
        for text in figure.axes[0].texts
        if text.arrow_patch is not None
        and text.get_text() == ""
        and np.allclose(text.arrow_patch.get_edgecolor()[:3], np.array(palette.ESTIMATE) / 255)
    ]
    return np.array([(text.xyann, text.xy) for text in found])


def test_wheels_stand_beside_and_behind_their_pivots():
    figure = layout_figure(preset("asoc-prototype"))
    pivots = 240.0 * np.array([(np.cos(a), np.sin(a)) for a in (0.0, 2 * np.pi / 3, 4 * np.pi / 3)])
    expected = [pivot + np.array([-72.0, side]) for pivot in pivots for side in (58.0, -58.0)]
    np.testing.assert_allclose(tyres(figure, palette.TYRE), expected, atol=0.5)
    assert {"1l: r 38.1", "3r: r 38.1", "castor 2\nfree, offset 72"} <= set(words(figure))


def test_arrows_show_which_way_counts_rise():
    """Omni wheels that roll about the origin: all of them clockwise, as the preset says."""
    starts, ends = np.moveaxis(arrows(layout_figure(preset("omni3"))), 1, 0)
    assert len(starts) == 3
    turning = starts[:, 0] * (ends - starts)[:, 1] - starts[:, 1] * (ends - starts)[:, 0]
    assert np.all(turning < 0)


def test_idle_wheels_are_grey_and_the_line_of_turning_is_drawn():
    figure = layout_figure(preset("tricycle"))
    np.testing.assert_allclose(tyres(figure, palette.IDLE_TYRE), [(0, 170), (0, -170)], atol=0.5)
    assert len(arrows(figure)) == 1
    assert "dashed" in figure.texts[0].get_text()


def test_axles_of_a_train_stand_a_frame_apart():
    train = cfmmr(2)
    longer = dataclasses.replace(train, frames=(dataclasses.replace(train.frames[0], length=0.5),))
    figure = layout_figure(longer)
    expected = [(0, 160), (0, -160), (-500, 160), (-500, -160)]
    np.testing.assert_allclose(tyres(figure, palette.TYRE), expected, atol=0.5)
    assert "frame A, 500" in words(figure)


@pytest.mark.parametrize("name", ["1-castor", "swerve", "cfmmr-10"])
def test_all_of_it_is_within_the_picture(name):
    (axes,) = layout_figure(any_preset(name)).axes
    low, high = axes.viewLim.min, axes.viewLim.max
    middles = tyres(axes.figure, palette.TYRE)
    assert np.all((middles > low) & (middles < high))
