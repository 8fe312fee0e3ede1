import math

import numpy as np
import pytest

from castor_envs.errors import InputError
from castor_envs.floor import Cable, Floor, Patch
from castor_envs.geometry.se2 import compose
from castor_envs.rendering import Renderer
from castor_envs.rendering.caption import error_text
from castor_envs.rendering.drawing.palette import BEAM, ESTIMATE, FAINT_PATH, SLIDING, TRUE_PATH, TYRE
from castor_envs.rendering.train_figure import frame_curve
from castor_envs.vehicles.presets import FRAME_LENGTH, cfmmr

ARENA = (-1.5, 1.5, -1.5, 1.5)
SIZE = (420, 440)
FLOOR = Floor(
    patches=(Patch(center=(0.5, 0.4), size=(0.6, 0.3), friction=0.1, angle=0.4),),
    cables=(Cable(center=(0.0, -0.3), direction=0.3, length=0.9, diameter=0.01),),
)


@pytest.fixture
def new_renderer():
    made = []

    def make(n=3, floor=None, **how):
        how = {"mode": "rgb_array", "fps": 1000, "size": SIZE, "arena": ARENA, **how}
        made.append(Renderer(cfmmr(n), floor or Floor(), **how))
        return made[-1]

    yield make
    for renderer in made:
        renderer.close()


def arc(n, turn, front=(0.0, 0.0, 0.0), points=13):
    """Return axle poses (n, 3) and frames of a train whose frames are arcs of angle `turn`, from closed form."""

    def along(s):
        """Return poses (..., 3) a length s behind the front axle."""
        psi = -s * turn / FRAME_LENGTH
        return compose(front, np.stack([-s * np.sinc(psi / np.pi), -s * _cosc(psi), psi], axis=-1))

    poses = along(FRAME_LENGTH * np.arange(n))
    frames = [along(FRAME_LENGTH * np.linspace(f + 1, f, points))[:, :2] for f in range(n - 1)]
    return poses, frames


def _cosc(psi):
    """Return (1 - cos psi) / psi."""
    return np.sin(psi / 2) * np.sinc(psi / 2 / np.pi)


def picture(renderer, poses, frames, **options):
    """Return a picture without history, without the caption, as signed integers."""
    renderer.reset()
    return renderer.draw(poses, frames, **options).astype(int)[: round(renderer.view.bottom)]


def near(frame, color):
    return np.all(np.abs(frame - color) < 12, axis=-1)


def mask_center(mask):
    """Return the mean place of the pixels of a mask: x to the right, y down."""
    rows, columns = np.nonzero(mask)
    return np.array([columns.mean(), rows.mean()]) + 0.5


def near_at(renderer, frame, place, color, reach=2):
    """Return whether a colour is seen within `reach` pixels of a place (2,) of N."""
    x, y = renderer.view.pixel(place).astype(int)
    return bool(near(frame[y - reach : y + reach + 1, x - reach : x + reach + 1], color).any())


def wheel_places(poses, ahead=0.0):
    """Return where the wheels are in N, (2N, 2), axle by axle, left then right, or what is `ahead` of their middles."""
    lateral = cfmmr(2).modules[0].castors[0].wheels[0].lateral
    return np.array([compose(pose, (ahead, side * lateral, 0.0))[:2] for pose in poses for side in (1, -1)])


def test_arcs_of_this_file_are_arcs():
    poses, frames = arc(4, 0.5, (0.3, -0.2, 0.4))
    center = compose(poses[0], (0.0, FRAME_LENGTH / 0.5, 0.0))[:2]
    np.testing.assert_allclose(np.hypot(*(np.concatenate(frames) - center).T), FRAME_LENGTH / 0.5)
    np.testing.assert_allclose(np.diff(poses[:, 2]), -0.5)
    for f, frame in enumerate(frames):
        np.testing.assert_allclose(frame[[0, -1]], poses[[f + 1, f], :2], atol=1e-12)
        np.testing.assert_allclose(np.hypot(*np.diff(frame, axis=0).T).sum(), FRAME_LENGTH, rtol=1e-3)


@pytest.mark.parametrize("n", [2, 3, 7, 10])
def test_pictures_are_height_by_width_by_color(new_renderer, n):
    renderer = new_renderer(n, FLOOR)
    poses, frames = arc(n, 0.4, (1.2, 0.3, 0.3))
    shown = renderer.draw(
        poses, frames, estimate=poses + 0.05, target=poses[0], time=2.0, sliding=np.arange(2 * n) % 3 == 0
    )
    assert shown.shape == (SIZE[1], SIZE[0], 3)
    assert shown.dtype == np.uint8
    assert shown.flags.writeable
    assert shown.flags.c_contiguous


def test_same_calls_make_the_same_pixels(new_renderer):
    def film():
        renderer = new_renderer(4, FLOOR)
        for t in np.linspace(0.0, 1.0, 10):
            poses, frames = arc(4, t - 0.5, (t, t - 0.5, t))
            yield renderer.draw(poses, frames, estimate=poses + 0.03 * t, target=poses[0], time=t)

    pictures = list(film())
    for first, second in zip(pictures, film(), strict=True):
        np.testing.assert_array_equal(first, second)
    assert np.any(pictures[0] != pictures[-1])


@pytest.mark.parametrize("n", [2, 5])
@pytest.mark.parametrize("turn", [0.5, -0.3])
def test_wheels_and_frames_are_where_they_are_in_the_world(new_renderer, n, turn):
    renderer = new_renderer(n)
    poses, frames = arc(n, turn, (0.7, 0.1, 0.6))
    shown = picture(renderer, poses, frames)
    for ahead in (0.05, -0.05):  # the axle covers their middles
        assert all(near_at(renderer, shown, place, TYRE, reach=1) for place in wheel_places(poses, ahead))
    assert all(near_at(renderer, shown, shape[len(shape) // 2], BEAM, reach=1) for shape in frames)
    beams = np.argwhere(near(shown, BEAM))[:, ::-1] + 0.5
    shapes = renderer.view.pixel(np.concatenate(arc(n, turn, (0.7, 0.1, 0.6), points=200)[1]))
    assert np.min(np.hypot(*(beams[:, None] - shapes).transpose(2, 0, 1)), axis=1).max() < 4.0


def test_a_bent_frame_is_drawn_bent(new_renderer):
    renderer = new_renderer(2)
    poses, frames = arc(2, 1.0)
    shown = picture(renderer, poses, frames)
    bulge, chord = frames[0][len(frames[0]) // 2], poses[:, :2].mean(axis=0)
    assert np.hypot(*(bulge - chord)) * renderer.view.scale > 5
    assert near_at(renderer, shown, bulge, BEAM, reach=0)
    assert not near_at(renderer, shown, chord, BEAM, reach=0)


def test_the_train_moves_as_far_as_its_poses(new_renderer):
    renderer = new_renderer(3)

    nothing = picture(renderer, *arc(3, 0.4, (50.0, 50.0, 0.0)))

    def center(front):
        return mask_center(np.any(picture(renderer, *arc(3, 0.4, front)) != nothing, axis=-1))

    moved = center((0.7, 0.5, 0.4)) - center((0.3, -0.3, 0.4))
    np.testing.assert_allclose(moved, np.array([0.4, -0.8]) * renderer.view.scale, atol=0.5)


@pytest.mark.parametrize("heading", [0.0, 0.7, 2.5, -1.9])
def test_frames_lie_behind_the_front_axle(new_renderer, heading):
    renderer = new_renderer(2)
    poses, frames = arc(2, 0.0, (0.0, 0.0, heading))
    x, y = mask_center(near(picture(renderer, poses, frames), BEAM)) - renderer.view.pixel(poses[0, :2])
    assert abs(math.remainder(math.atan2(y, -x) - heading, math.tau)) < math.radians(3)


def test_only_sliding_wheels_change_color(new_renderer):
    renderer = new_renderer(3)
    poses, frames = arc(3, 0.4, (0.5, 0.3, 0.4))
    assert not near(picture(renderer, poses, frames, sliding=np.zeros(6, dtype=bool)), SLIDING).any()
    for wheel, place in enumerate(wheel_places(poses)):
        shown = picture(renderer, poses, frames, sliding=np.arange(6) == wheel)
        assert np.hypot(*(mask_center(near(shown, SLIDING)) - renderer.view.pixel(place))) < 1.5


def test_the_ghost_stands_where_the_belief_is(new_renderer):
    renderer = new_renderer(3)
    poses, frames = arc(3, 0.4, (0.7, 0.8, 0.2))
    believed, shapes = arc(3, -0.4, (0.7, -0.7, 0.0))
    before, after = picture(renderer, poses, frames), picture(renderer, poses, frames, estimate=believed)
    assert not near(before, ESTIMATE).any()
    for pose in believed:
        assert near_at(renderer, after, pose[:2], ESTIMATE, reach=1)
    for shape in shapes:
        # A dash is somewhere near the middle; ends are under the axles.
        assert near_at(renderer, after, shape[len(shape) // 2], ESTIMATE, reach=7)
    rows = round(renderer.view.bottom) - 40  # above what is written about the error
    marks = np.argwhere(near(after[:rows], ESTIMATE))[:, ::-1] + 0.5
    reach = 0.25  # m: half the track, half a wheel
    nearest = np.min(
        np.hypot(*(marks[:, None] - renderer.view.pixel(np.concatenate(shapes))).transpose(2, 0, 1)), axis=1
    )
    assert nearest.max() < reach * renderer.view.scale
    for pose in poses:
        assert not near_at(renderer, after, pose[:2], ESTIMATE, reach=8)


@pytest.mark.parametrize("wild", [math.nan, math.inf])
def test_a_belief_that_is_not_finite_is_not_drawn(new_renderer, wild):
    renderer = new_renderer(3)
    poses, frames = arc(3, 0.4)
    believed = poses.copy()
    believed[2, 1] = wild
    np.testing.assert_array_equal(picture(renderer, poses, frames, estimate=believed), picture(renderer, poses, frames))


@pytest.mark.parametrize("turn", [0.0, 0.5, -1.0])
def test_ghost_frames_leave_and_reach_their_axles_like_a_beam(turn):
    (front, rear), (shape,) = arc(2, turn, (0.2, 0.3, 1.0), points=400)
    curve = frame_curve(rear, front, FRAME_LENGTH)
    np.testing.assert_allclose(curve[[0, -1]], [rear[:2], front[:2]], atol=1e-12)
    first, last = curve[1] - curve[0], curve[-1] - curve[-2]
    assert math.atan2(first[1], first[0]) == pytest.approx(rear[2], abs=0.05)
    assert math.atan2(last[1], last[0]) == pytest.approx(front[2], abs=0.05)
    apart = np.min(np.hypot(*(curve[:, None] - shape).transpose(2, 0, 1)), axis=1)
    assert apart.max() < 0.005  # a bent beam to within what a picture shows


def test_the_mean_error_of_the_axles_is_written():
    poses, _ = arc(2, 0.0)
    estimate = np.add(poses, [(0.03, 0.04, 0.0), (0.0, -0.01, 0.0)])
    assert error_text(poses, estimate) == "estimate off by 30.0 mm, mean of 2 axles"
    assert error_text(poses[0], estimate[0] + [0.0, 0.0, 0.1]) == "estimate off by 50.0 mm, +5.73°"


def test_paths_of_front_and_last_axle_stay_until_reset(new_renderer):
    renderer = new_renderer(2)
    parked = arc(2, 0.0, (0.0, 1.0, 0.0))
    clean = picture(renderer, *parked)
    for x in np.linspace(-0.8, 0.8, 30):
        # Beside each other, so that neither path covers the other.
        poses = np.array([(x, -0.5, 0.0), (x, -0.9, 0.0)])
        renderer.draw(poses, [poses[::-1, :2]])
    shown = renderer.draw(*parked).astype(int)[: round(renderer.view.bottom)]
    assert near_at(renderer, shown, (0.0, -0.5), TRUE_PATH, reach=1)
    assert near_at(renderer, shown, (0.0, -0.9), FAINT_PATH, reach=1)
    np.testing.assert_array_equal(picture(renderer, *parked), clean)


def test_a_whole_target_looks_like_one_that_grew(new_renderer):
    way = np.stack([np.linspace(-0.8, 0.8, 30), np.full(30, -0.7), np.zeros(30)], axis=1)
    grown, redrawn = new_renderer(2), new_renderer(2)
    train = arc(2, 0.3)
    last = [grown.draw(*train, target=place) for place in way][-1]
    np.testing.assert_array_equal(last, redrawn.draw(*train, target=way))
    assert np.any(last[: round(redrawn.view.bottom)] != picture(new_renderer(2), *train))


def test_places_far_outside_do_no_harm(new_renderer):
    renderer = new_renderer(3)
    poses, frames = arc(3, 0.4)
    for far in (1e3, -1e9, 1e15):
        renderer.draw(poses, frames, estimate=poses * (1, 1, 0) + (far, -far, far), target=(far, far, 0.0))
    far, frames = arc(3, 0.4, (-1e8, 1e8, 0.0))
    assert renderer.draw(far, frames).shape == (SIZE[1], SIZE[0], 3)


def test_human_mode_shows_a_window_until_it_is_closed(new_renderer, monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    renderer = new_renderer(mode="human")
    train = arc(3, 0.4)
    assert renderer.draw(*train) is None
    import pygame

    window = pygame.display.get_surface()
    shown = pygame.surfarray.array3d(window).transpose(1, 0, 2)
    np.testing.assert_array_equal(shown, new_renderer().draw(*train))
    pygame.event.post(pygame.event.Event(pygame.QUIT))
    for _ in range(2):
        assert renderer.draw(*train) is None
        assert not pygame.display.get_init()


def test_an_impossible_mode_is_refused(new_renderer):
    with pytest.raises(InputError, match="'human' or 'rgb_array', got 'ansi'"):
        new_renderer(mode="ansi")


POSES, FRAMES = arc(3, 0.4)
NOWHERE = POSES.copy()
NOWHERE[1, 0] = math.nan


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"pose": POSES[:2]}, r"pose must be finite, of shape \(3, 3\), got shape \(2, 3\)"),
        ({"pose": POSES[0]}, "pose must be"),
        ({"pose": NOWHERE}, "pose must be finite"),
        ({"shape": FRAMES[:1]}, "2 polylines, got 1"),
        ({"shape": [FRAMES[0], FRAMES[1][:1]]}, "frame B must be two or more finite points"),
        ({"shape": [np.full((5, 2), math.inf), FRAMES[1]]}, "frame A must be"),
        ({"shape": [POSES, FRAMES[1]]}, "frame A must be"),
        ({"estimate": POSES[0]}, r"estimate must have shape \(3, 3\), got \(3,\)"),
        ({"sliding": [True, False]}, r"sliding must have shape \(6,\), got \(2,\)"),
    ],
)
def test_what_is_no_train_is_refused(new_renderer, given, message):
    with pytest.raises(ValueError, match=message):
        new_renderer().draw(**{"pose": POSES, "shape": FRAMES, **given})
