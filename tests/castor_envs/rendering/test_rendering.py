import builtins
import dataclasses
import hashlib
import math
import os
import subprocess
import sys
from pathlib import Path as FilePath

import numpy as np
import pytest
from gymnasium.error import DependencyNotInstalled

from castor_envs.errors import InputError
from castor_envs.floor import Cable, Floor, Patch
from castor_envs.rendering import Renderer, ground, outlines
from castor_envs.rendering.drawing.palette import SLIDING, TRUE_PATH
from castor_envs.rendering.outlines import castor_outlines, chassis_outline, swept_radius
from castor_envs.vehicles.presets import cfmmr, differential, preset, preset_names
from castor_envs.vehicles.robot import Castor, RobotDescription, Wheel

ROOT = FilePath(__file__).parents[3]
ARENA = (-1.0, 1.0, -1.0, 1.0)
SIZE = (320, 300)
CROWDED = Floor(
    patches=(
        Patch(center=(0.5, 0.4), size=(0.6, 0.3), friction=0.1, angle=0.4),
        Patch(center=(-0.5, 0.4), size=(0.3, 0.3), friction=1.5),
    ),
    cables=(Cable(center=(0.0, -0.3), direction=0.3, length=0.9, diameter=0.01),),
    slope=(0.03, -0.02),
)
FAR = (50.0, 50.0, 0.0)


@pytest.fixture
def new_renderer():
    made = []

    def make(robot="asoc-prototype", floor=None, **how):
        robot = preset(robot) if isinstance(robot, str) else robot
        how = {"mode": "rgb_array", "fps": 1000, "size": SIZE, "arena": ARENA, **how}
        made.append(Renderer(robot, floor or Floor(), **how))
        return made[-1]

    yield make
    for renderer in made:
        renderer.close()


def picture(renderer, pose, angles=None, **options):
    """Return a picture without history, as signed integers."""
    renderer.reset()
    angles = np.zeros(len(renderer.vehicle.castors)) if angles is None else angles
    return renderer.draw(pose, angles, **options).astype(int)


def robot_mask(renderer, pose, angles=None):
    """Return which pixels the robot changes: the picture differs from one with the robot far outside."""
    return np.any(picture(renderer, pose, angles) != picture(renderer, FAR, angles), axis=-1)


def mask_center(mask):
    """Return the mean place of the pixels of a mask: x to the right, y down."""
    rows, columns = np.nonzero(mask)
    return np.array([columns.mean(), rows.mean()]) + 0.5


def near(frame, color):
    return np.all(np.abs(frame.astype(int) - color) < 12, axis=-1)


def polygon_center(polygon):
    """Return the centroid of a polygon's area."""
    x, y = polygon.T
    cross = x * np.roll(y, -1) - np.roll(x, -1) * y
    return (polygon + np.roll(polygon, -1, axis=0)).T @ cross / (3 * cross.sum())


def inside(points, hull, slack=1e-9):
    """Return which points (m, 2) lie inside a convex counter-clockwise polygon (k, 2)."""
    edge = np.roll(hull, -1, axis=0) - hull
    to = points[:, None] - hull
    return np.all(edge[:, 0] * to[..., 1] - edge[:, 1] * to[..., 0] >= -slack, axis=1)


def run_python(code, tmp_path, **environment):
    """Run code in another process, without a display, warnings as errors."""
    kept = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY") and not k.startswith("SDL")}
    path = os.pathsep.join([str(tmp_path), str(ROOT)])
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code],
        env={**kept, "PYTHONPATH": path, **environment},
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


DRAW = """
import sys
from castor_envs.vehicles.presets import preset
from castor_envs.floor import Floor
from castor_envs.rendering import Renderer
assert "pygame" not in sys.modules
renderer = Renderer(preset("asoc-prototype"), Floor(), "rgb_array", 20, size=(320, 300), arena=(-1, 1, -1, 1))
frame = renderer.draw((0.2, 0.1, 0.5), (0.1, 0.2, 0.3), estimate=(0.2, 0.12, 0.45), time=1.5)
"""

DRAW_TRAIN = """
import sys
import numpy as np
from castor_envs.vehicles.presets import cfmmr
from castor_envs.floor import Floor
from castor_envs.rendering import Renderer
assert "pygame" not in sys.modules
renderer = Renderer(cfmmr(2), Floor(), "rgb_array", 20, size=(320, 300), arena=(-1, 1, -1, 1))
poses = np.array([(0.35, 0.0, 0.0), (0.0, 0.0, 0.0)])
frame = renderer.draw(poses, [poses[::-1, :2]], estimate=poses + 0.1, time=1.5)
"""


@pytest.mark.parametrize("name", preset_names())
def test_pictures_are_height_by_width_by_color(new_renderer, name):
    renderer = new_renderer(name, CROWDED)
    robot = renderer.vehicle
    for sliding in (None, np.arange(len(robot.wheels)) % 2 == 0):
        frame = renderer.draw(
            (0.1, 0.2, 0.3),
            np.linspace(0, 2, len(robot.castors)),
            estimate=(0.12, 0.2, 0.31),
            target=(0.1, 0.2, 0.3),
            time=3.0,
            sliding=sliding,
        )
        assert frame.shape == (SIZE[1], SIZE[0], 3)
        assert frame.dtype == np.uint8
        assert frame.flags.writeable
        assert frame.flags.c_contiguous


def test_same_calls_make_the_same_pixels(new_renderer):
    def film():
        renderer = new_renderer(floor=CROWDED)
        for t in np.linspace(0.0, 1.0, 15):
            pose = np.array([math.cos(4 * t) / 2, t - 0.5, 5 * t])
            yield renderer.draw(pose, (t, 2 * t, 3 * t), estimate=pose + 0.02 * t, target=pose, time=t)

    for first, second in zip(film(), film(), strict=True):
        np.testing.assert_array_equal(first, second)


def test_same_pixels_in_another_process_without_a_display(new_renderer, tmp_path):
    code = DRAW + "import hashlib, pygame\nassert not pygame.display.get_init()\n"
    code += "print(hashlib.sha256(frame.tobytes()).hexdigest())"
    frame = new_renderer().draw((0.2, 0.1, 0.5), (0.1, 0.2, 0.3), estimate=(0.2, 0.12, 0.45), time=1.5)
    assert run_python(code, tmp_path).strip() == hashlib.sha256(frame.tobytes()).hexdigest()


def test_trains_are_the_same_in_another_process_without_a_display(tmp_path):
    poses = np.array([(0.35, 0.0, 0.0), (0.0, 0.0, 0.0)])
    renderer = Renderer(cfmmr(2), Floor(), "rgb_array", 20, size=SIZE, arena=ARENA)
    frame = renderer.draw(poses, [poses[::-1, :2]], estimate=poses + 0.1, time=1.5)
    assert frame is not None
    code = DRAW_TRAIN + "import hashlib, pygame\nassert not pygame.display.get_init()\n"
    code += "print(hashlib.sha256(frame.tobytes()).hexdigest())"
    assert run_python(code, tmp_path).strip() == hashlib.sha256(frame.tobytes()).hexdigest()


def test_a_frame_stays_as_it_is_when_the_next_is_drawn(new_renderer):
    renderer = new_renderer()
    first = renderer.draw((0.0, 0.0, 0.0), np.zeros(3))
    before = first.copy()
    renderer.draw((0.5, 0.5, 1.0), np.zeros(3))
    np.testing.assert_array_equal(first, before)


@pytest.mark.parametrize("pose", [(0.0, 0.0, 0.0), (0.45, 0.3, 0.0), (-0.5, 0.25, 2.0), (0.3, -0.4, -1.0)])
@pytest.mark.parametrize("name", ["swerve", "6-castor"])
def test_symmetric_robots_stand_around_their_pose(new_renderer, name, pose):
    renderer = new_renderer(name)
    nose_counts = 2.5  # px: the nose and the castors' offsets make the shape a little longer on one side
    center = mask_center(robot_mask(renderer, pose))
    assert np.hypot(*(center - renderer.view.pixel(pose[:2]))) < nose_counts


def test_the_robot_moves_as_far_as_its_pose(new_renderer):
    renderer = new_renderer("tricycle")
    start = mask_center(robot_mask(renderer, (-0.3, -0.2, 0.4)))
    moved = mask_center(robot_mask(renderer, (0.1, 0.3, 0.4))) - start
    np.testing.assert_allclose(moved, np.array([0.4, -0.5]) * renderer.view.scale, atol=0.5)


@pytest.mark.parametrize("heading", [0.0, 0.7, 2.5, -1.9])
def test_a_tricycle_points_where_it_heads(new_renderer, heading):
    renderer = new_renderer("tricycle")
    x, y = mask_center(robot_mask(renderer, (0.0, 0.0, heading))) - renderer.view.pixel((0.0, 0.0))
    assert abs(math.remainder(math.atan2(-y, x) - heading, math.tau)) < math.radians(3)


def mirrored(robot):
    """Return the robot seen in a mirror along its x axis."""

    def mirror(castor):
        wheels = tuple(dataclasses.replace(wheel, lateral=-wheel.lateral) for wheel in reversed(castor.wheels))
        x, y = castor.pivot
        return dataclasses.replace(castor, pivot=(x, -y), wheels=wheels, angle=-castor.angle)

    return dataclasses.replace(robot, castors=tuple(mirror(castor) for castor in robot.castors))


@pytest.mark.parametrize("name", ["asoc-prototype", "powered-caster", "tricycle"])
def test_a_mirrored_robot_makes_a_mirrored_picture(new_renderer, name):
    renderer = new_renderer(name)
    reflected = new_renderer(mirrored(renderer.vehicle))
    angles = np.linspace(0.4, 2.0, len(renderer.vehicle.castors))
    rows = round(renderer.view.bottom)
    frame = picture(renderer, (0.2, 0.15, 0.6), angles)[40 : rows - 40]
    mirror_picture = picture(reflected, (0.2, -0.15, -0.6), -angles)[40 : rows - 40]
    robot = np.any(frame != picture(renderer, FAR, angles)[40 : rows - 40], axis=-1)
    assert robot.sum() > 1000
    assert np.mean(np.abs(frame - mirror_picture[::-1])[robot]) < 0.15 * np.mean(np.abs(frame - mirror_picture)[robot])


def test_castors_turn_by_their_angles(new_renderer):
    renderer = new_renderer("1-castor")
    half_turn = picture(renderer, (0.0, 0.0, math.pi), (0.0,))
    same_castor = picture(renderer, (0.0, 0.0, 0.0), (math.pi,))
    turned_castor = picture(renderer, (0.0, 0.0, 0.0), (0.5,))
    x, y = renderer.view.pixel((0.0, 0.0)).astype(int)
    reach = int(0.115 * renderer.view.scale)  # the castor alone, without the chassis' edge and nose

    def castor(frame):
        return frame[y - reach : y + reach, x - reach : x + reach]

    assert np.mean(np.abs(castor(half_turn) - castor(same_castor))) < 1.0
    assert np.mean(np.abs(castor(half_turn) - castor(turned_castor))) > 10.0


def test_wheels_stand_where_the_rolling_constraints_put_them():
    robot = preset("powered-caster")
    angles = np.array([0.3, -1.0, 2.0, 3.0])
    for castor, outline, angle in zip(robot.castors, castor_outlines(robot, angles), angles, strict=True):
        c, s = math.cos(angle), math.sin(angle)
        x, y, wheel = -castor.offset, castor.wheels[0].lateral, castor.wheels[0]
        expected = np.add(castor.pivot, (c * x - s * y, s * x + c * y))
        (tyre,) = outline.tyres
        np.testing.assert_allclose(polygon_center(tyre), expected, atol=1e-12)
        along = (tyre - expected) @ (c, s)
        np.testing.assert_allclose([along.min(), along.max()], [-wheel.radius, wheel.radius], atol=1e-4)


@pytest.mark.parametrize("name", preset_names())
def test_the_chassis_covers_its_castors_at_all_angles(name):
    robot = preset(name)
    hull = chassis_outline(robot)
    for angle in np.linspace(0.0, 6.0, 7):
        for outline in castor_outlines(robot, np.full(len(robot.castors), angle)):
            assert np.all(inside(np.concatenate(outline.tyres), hull, slack=1e-5))
    for castor in robot.castors:
        distance = np.hypot(*(hull - castor.pivot).T)
        assert distance.min() > swept_radius(castor) - 1e-12


def test_fixed_castors_ignore_the_angles_given(new_renderer):
    renderer = new_renderer("differential")
    np.testing.assert_array_equal(
        picture(renderer, (0.0, 0.0, 0.2), (0.0,)), picture(renderer, (0.0, 0.0, 0.2), (1.3,))
    )


def test_omni_wheels_show_their_rollers(new_renderer):
    standard, omni = Wheel(radius=0.1), Wheel(radius=0.1, grip="omni", roller_angle=math.pi / 4)
    frames = [
        picture(
            new_renderer(
                RobotDescription(name="one wheel", castors=(Castor(pivot=(0, 0), steering="fixed", wheels=(w,)),))
            ),
            (0.0, 0.0, 0.0),
        )
        for w in (standard, omni)
    ]
    assert np.any(frames[0] != frames[1])


def test_only_sliding_wheels_change_color(new_renderer):
    renderer = new_renderer()
    bottom = round(renderer.view.bottom)
    pose, angles = (0.0, 0.0, 0.4), (0.0, 1.0, 2.0)
    assert not near(picture(renderer, pose, angles, sliding=np.zeros(6, dtype=bool))[:bottom], SLIDING).any()
    for wheel in range(6):
        frame = picture(renderer, pose, angles, sliding=np.arange(6) == wheel)[:bottom]
        outline = castor_outlines(renderer.vehicle, angles)[wheel // 2].tyres[wheel % 2]
        c, s = math.cos(0.4), math.sin(0.4)
        expected = renderer.view.pixel(polygon_center(outline) @ np.array([(c, s), (-s, c)]))
        assert np.hypot(*(mask_center(near(frame, SLIDING)) - expected)) < 1.5


def test_the_trail_stays_until_reset(new_renderer):
    renderer = new_renderer()
    bottom = round(renderer.view.bottom)
    clean = picture(renderer, (0.0, 0.7, 0.0))
    renderer.reset()
    for x in np.linspace(-0.8, 0.8, 30):
        renderer.draw((x, -0.7, 0.0), np.zeros(3), estimate=(x, -0.65, 0.0), target=(x, -0.75, 0.0))
    frame = renderer.draw((0.0, 0.7, 0.0), np.zeros(3))
    rows, columns = np.nonzero(near(frame[:bottom], TRUE_PATH))
    left, right = renderer.view.pixel([(-0.8, -0.7), (0.8, -0.7)])
    on_the_line = np.abs(rows + 0.5 - left[1]) < 3
    assert columns[on_the_line].min() == pytest.approx(left[0], abs=6)
    assert columns[on_the_line].max() == pytest.approx(right[0], abs=6)
    renderer.reset()
    np.testing.assert_array_equal(renderer.draw((0.0, 0.7, 0.0), np.zeros(3)), clean)


def test_a_whole_target_looks_like_one_that_grew(new_renderer):
    way = np.stack([np.linspace(-0.8, 0.8, 30), np.full(30, -0.7), np.zeros(30)], axis=1)
    grown, redrawn = new_renderer(), new_renderer()
    last = [grown.draw((0.0, 0.0, 0.0), np.zeros(3), target=place) for place in way][-1]
    np.testing.assert_array_equal(last, redrawn.draw((0.0, 0.0, 0.0), np.zeros(3), target=way))
    without = new_renderer().draw((0.0, 0.0, 0.0), np.zeros(3))
    y = round(redrawn.view.pixel((0.0, -0.7))[1])
    assert np.any(last[y - 2 : y + 3] != without[y - 2 : y + 3])


def test_the_ghost_stands_where_the_estimate_is(new_renderer):
    renderer = new_renderer("swerve")
    bottom = round(renderer.view.bottom) - 40  # above what is written about the error
    pose, estimate = (-0.4, 0.0, 0.0), (0.45, 0.2, 0.0)
    changed = np.any(picture(renderer, pose, estimate=estimate) != picture(renderer, pose), axis=-1)[:bottom]
    assert np.hypot(*(mask_center(changed) - renderer.view.pixel(estimate[:2]))) < 4


@pytest.mark.parametrize("wild", [(math.nan, 0.0, 0.0), (0.0, math.inf, 0.0)])
def test_an_estimate_that_is_not_finite_is_not_drawn(new_renderer, wild):
    renderer = new_renderer()
    np.testing.assert_array_equal(picture(renderer, (0.0, 0.0, 0.0), estimate=wild), picture(renderer, (0.0, 0.0, 0.0)))


def test_places_far_outside_do_no_harm(new_renderer):
    renderer = new_renderer(floor=Floor(cables=(Cable(center=(0, 0), direction=0, length=1e5, diameter=0.01),)))
    for far in (1e3, -1e9, 1e15):
        renderer.draw((0.0, 0.0, 0.0), np.zeros(3), estimate=(far, -far, far), target=(far, far, 0.0))
    assert renderer.draw((-1e8, 1e8, 0.0), np.zeros(3)).shape == (SIZE[1], SIZE[0], 3)


def test_the_floor_is_drawn(new_renderer):
    plain, crowded = (picture(new_renderer(floor=floor), FAR) for floor in (Floor(), CROWDED))
    view = new_renderer().view
    for place in ((0.5, 0.33), (-0.55, 0.45), (0.0, -0.3)):
        x, y = view.pixel(place).astype(int)
        assert np.any(plain[y - 2 : y + 3, x - 2 : x + 3] != crowded[y - 2 : y + 3, x - 2 : x + 3])
    x, y = view.pixel((0.2, 0.2)).astype(int)
    np.testing.assert_array_equal(plain[y, x], crowded[y, x])


def test_the_whole_arena_is_in_the_picture_at_one_scale(new_renderer):
    for size, arena in [((800, 300), (-3, 3, -1, 5)), ((200, 700), (0, 1, 0, 20))]:
        view = new_renderer(size=size, arena=arena).view
        x_min, x_max, y_min, y_max = arena
        corners = view.pixel([(x_min, y_min), (x_max, y_max), (x_min, y_max), (x_max, y_min)])
        assert np.all((corners > 0) & (corners < (size[0], view.bottom)))
        across, up = view.pixel((1.0, 0.0)) - view.pixel((0.0, 0.0)), view.pixel((0.0, 1.0)) - view.pixel((0.0, 0.0))
        np.testing.assert_allclose((across, up), [(view.scale, 0.0), (0.0, -view.scale)])
        np.testing.assert_allclose(view.place(corners[0]), (x_min, y_min))


def test_human_mode_shows_a_window_until_it_is_closed(new_renderer, monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    renderer = new_renderer(mode="human")
    expected = new_renderer()
    pose, angles = (0.2, 0.1, 0.5), np.zeros(3)
    assert renderer.draw(pose, angles) is None
    import pygame

    window = pygame.display.get_surface()
    shown = pygame.surfarray.array3d(window).transpose(1, 0, 2)
    np.testing.assert_array_equal(shown, expected.draw(pose, angles))
    renderer.close()
    renderer.close()
    assert not pygame.display.get_init()
    assert renderer.draw(pose, angles) is None
    assert pygame.display.get_init()


def test_the_run_goes_on_when_the_user_closes_the_window(new_renderer, monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    renderer = new_renderer(mode="human")
    renderer.draw((0.0, 0.0, 0.0), np.zeros(3))
    import pygame

    pygame.event.post(pygame.event.Event(pygame.QUIT))
    for _ in range(2):
        assert renderer.draw((0.0, 0.0, 0.0), np.zeros(3)) is None
        assert not pygame.display.get_init()


def test_pictures_survive_others_quitting_pygame(new_renderer):
    renderer = new_renderer()
    first = picture(renderer, (0.0, 0.0, 0.0))
    import pygame

    pygame.quit()
    np.testing.assert_array_equal(picture(renderer, (0.0, 0.0, 0.0)), first)


def test_human_mode_without_a_display_says_what_to_do(new_renderer, monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "no-such-driver")
    with pytest.raises(InputError, match="'rgb_array' needs none"):
        new_renderer(mode="human").draw((0.0, 0.0, 0.0), np.zeros(3))


def test_pygame_comes_quietly(tmp_path):
    # what pygame imports where setuptools is installed, which warns in its newer versions
    (tmp_path / "pkg_resources.py").write_text(
        "import warnings\n"
        "warnings.warn('pkg_resources is deprecated as an API', DeprecationWarning, stacklevel=2)\n"
        "def resource_exists(package, name): return False\n"
        "def resource_stream(package, name): raise NotImplementedError\n"
    )
    assert run_python(DRAW + "assert 'pkg_resources' in sys.modules", tmp_path) == ""


def test_without_pygame_the_remedy_is_named(new_renderer, monkeypatch):
    real = builtins.__import__

    def without_pygame(name, *arguments):
        if name.partition(".")[0] == "pygame":
            raise ImportError(name)
        return real(name, *arguments)

    monkeypatch.setattr(builtins, "__import__", without_pygame)
    with pytest.raises(DependencyNotInstalled, match="pip install pygame"):
        new_renderer(differential())


@pytest.mark.parametrize(
    ("how", "message"),
    [
        ({"mode": "ansi"}, "'human' or 'rgb_array', got 'ansi'"),
        ({"arena": (1.0, -1.0, 0.0, 1.0)}, "arena must be"),
        ({"arena": (0.0, math.inf, 0.0, 1.0)}, "arena must be"),
        ({"size": (10, 10)}, "100 x 100 pixels"),
    ],
)
def test_impossible_views_are_refused(new_renderer, how, message):
    with pytest.raises(InputError, match=message):
        new_renderer(**how)


def test_a_pose_that_is_not_finite_is_refused(new_renderer):
    with pytest.raises(ValueError, match="three finite numbers"):
        new_renderer().draw((math.nan, 0.0, 0.0), np.zeros(3))


def test_of_the_largest_patch_only_what_is_seen_is_hatched(monkeypatch, new_renderer):
    """As many lines as in a picture of a patch that is hardly larger than the picture."""
    drawn = []
    monkeypatch.setattr(ground, "bar", lambda *line: drawn.append(line) or outlines.bar(*line))
    counts = []
    for side in (20.0, 1e4, 1e7):
        floor = Floor(patches=(Patch(center=(0.3, -0.2), size=(side, side), friction=0.2, angle=0.3),))
        drawn.clear()
        new_renderer(floor=floor).draw(np.zeros(3), np.zeros(3))
        counts.append(len(drawn))
    assert 20 < counts[0] < 500
    assert max(counts) - min(counts) <= 1
