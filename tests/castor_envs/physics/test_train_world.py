"""Trains in physics: rolling, bending, symmetry, energy, friction, and an independent integration in scipy."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymunk.constraints import PivotJoint
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from castor_envs.errors import InputError
from castor_envs.floor import Cable, Floor, Patch
from castor_envs.geometry.se2 import compose
from castor_envs.physics.train_world import TrainWorld
from castor_envs.vehicles.presets import cfmmr
from castor_envs.vehicles.train import Frame

G = 9.80665
RADIUS, HALF_TRACK, LENGTH = 0.075, 0.16, 0.35
ICE = Floor(patches=(Patch(center=(0.0, 0.0), size=(100.0, 100.0), friction=0.0),))


def changed(train, frame=None, **contact):
    """The train with fields of all frames (a dict) and of all modules' contacts replaced."""
    modules = tuple(
        dataclasses.replace(module, contact=dataclasses.replace(module.contact, **contact)) for module in train.modules
    )
    frames = tuple(dataclasses.replace(described, **(frame or {})) for described in train.frames)
    return dataclasses.replace(train, modules=modules, frames=frames)


def lopsided(n=3):
    """A train none of whose parts are alike, but for left and right."""
    train = cfmmr(n)
    modules = tuple(
        dataclasses.replace(module, mass=3.0 + i, inertia=0.03 + 0.01 * i) for i, module in enumerate(train.modules)
    )
    frames = tuple(
        dataclasses.replace(frame, length=0.35 + 0.05 * f, bending_stiffness=0.5 + 0.3 * f)
        for f, frame in enumerate(train.frames)
    )
    return dataclasses.replace(train, modules=modules, frames=frames)


def rates(speed, turning):
    """Wheel rates (2N,) of axles that roll at `speed` (N,) and turn at `turning` (N,)."""
    speed, turning = np.broadcast_arrays(speed, turning)
    return np.stack([speed - HALF_TRACK * turning, speed + HALF_TRACK * turning], axis=-1).ravel() / RADIUS


def waves(n, t, speed=0.2, sharpest=1.2):
    """Commands at time t of axles that follow each other along a path of curvature sharpest * sin(2 pi s / 2 m)."""
    ramp = min(t, 1.0)
    covered = speed * (0.5 * ramp**2 + max(t - 1.0, 0.0)) - LENGTH * np.arange(n)
    curvature = np.where(covered > 0, sharpest * np.sin(math.pi * covered), 0.0)
    return rates(speed * ramp, speed * ramp * curvature)


def pivots(world):
    return [joint for joint in world.simulation.space.constraints if isinstance(joint, PivotJoint)]


def gap(joints):
    """The widest gap of pivots, m."""
    return max(math.dist(j.a.local_to_world(j.anchor_a), j.b.local_to_world(j.anchor_b)) for j in joints)


@pytest.mark.parametrize("n", [2, 4, 7, 10])
@pytest.mark.parametrize("slope", [(0.0, 0.0), (0.1, -0.2)])
def test_wheels_carry_all_weight_each_pair_its_module_and_half_of_its_frames(n, slope):
    train = lopsided(n)
    world = TrainWorld(train, Floor(slope=slope))
    across = G / math.sqrt(1 + slope[0] ** 2 + slope[1] ** 2)
    frames = [0.0, *(frame.linear_density * frame.length for frame in train.frames), 0.0]
    modules = [module.mass + module.castors[0].mass for module in train.modules]
    carried = [module + (frames[i] + frames[i + 1]) / 2 for i, module in enumerate(modules)]
    np.testing.assert_allclose(world.wheels["load"], np.repeat(carried, 2) / 2 * across)
    assert sum(body.mass for body in world.simulation.space.bodies) == pytest.approx(sum(modules) + sum(frames))


@pytest.mark.parametrize("pose", [(0.0, 0.0, 0.0), (1.0, -2.0, 2.5)])
def test_a_train_starts_at_rest_where_it_is_put(pose):
    train = lopsided(3)
    world = TrainWorld(train, pose=pose, bends=[0.4, -0.7])
    np.testing.assert_allclose(world.poses[0], pose, atol=1e-12)
    np.testing.assert_allclose(world.relative_poses[:, 2], [0.4, -0.7], atol=1e-12)
    np.testing.assert_allclose(world.twists, 0.0, atol=1e-12)
    assert gap(pivots(world)) < 1e-12
    for bend, angles, shape, rear, front in zip(
        [0.4, -0.7], world.joint_angles, world.frame_shapes, world.poses[1:], world.poses, strict=False
    ):
        np.testing.assert_allclose(angles, bend / 6, atol=1e-12)
        np.testing.assert_allclose(shape[[0, -1]], [rear[:2], front[:2]], atol=1e-12)
    straight = TrainWorld(train, pose=pose)
    behind = np.array([0.0, 0.35, 0.75])[:, None] * [math.cos(pose[2]), math.sin(pose[2])]
    np.testing.assert_allclose(straight.poses[:, :2], np.array(pose[:2]) - behind, atol=1e-12)


def test_wheels_stand_at_the_ends_of_their_axle_however_heavy_the_frames_on_it():
    world = TrainWorld(changed(lopsided(3), {"linear_density": 20.0}), pose=(0.3, 0.1, 0.8), bends=[0.4, -0.7])
    bodies = list(world.simulation.space.bodies)
    for wheel, left in zip(world.wheels, [True, False] * 3, strict=True):
        place = bodies[wheel["body"]].local_to_world((float(wheel["x"]), float(wheel["y"])))
        axle = world.poses[wheel["body"]]
        np.testing.assert_allclose(place, compose(axle, [0.0, HALF_TRACK if left else -HALF_TRACK, 0.0])[:2])


@pytest.mark.parametrize("n", [2, 5, 10])
def test_a_train_driven_straight_stays_straight(n):
    world = TrainWorld(cfmmr(n))
    for k in range(60):
        world.advance(rates(np.full(n, 0.25 * min(1.0, k / 20)), 0.0))
    np.testing.assert_allclose(world.poses[:, 1:], 0.0, rtol=0, atol=1e-9)
    covered = 0.25 * (0.05 * 19 / 2 + 0.05 * 40)  # half a second's ramp in steps, then steady; servos lag 1 / 20 s
    np.testing.assert_allclose(world.poses[:, 0] + LENGTH * np.arange(n), covered, rtol=0.02)
    np.testing.assert_allclose(world.relative_poses[:, 0], LENGTH, atol=1e-6)


def test_with_stiff_contact_every_axle_rolls():
    """No side slip, wheels turn as their axle's twist says, and its track is its wheels' odometry."""
    n = 3
    train = changed(cfmmr(n), slip_stiffness_long=4000.0, slip_stiffness_lat=4000.0, damping=1e-4)
    world = TrainWorld(train)
    start, worst = world.poses, 0.0
    odometry, before = start.copy(), world.wheel_angles
    for k in range(100):
        world.advance(waves(n, 0.05 * (k + 0.5)))
        twists = world.twists
        worst = max(worst, np.abs(twists[:, 1]).max())
        expected = rates(twists[:, 0], twists[:, 2])
        np.testing.assert_allclose(world.wheels["speed"], expected, atol=2e-4 / RADIUS)
        rolled = (world.wheel_angles - before).reshape(n, 2) * RADIUS
        before = world.wheel_angles
        ahead, turn = rolled.mean(axis=1), (rolled[:, 1] - rolled[:, 0]) / (2 * HALF_TRACK)
        chord = ahead * np.sinc(turn / (2 * math.pi))
        odometry = compose(odometry, np.stack([chord * np.cos(turn / 2), chord * np.sin(turn / 2), turn], axis=-1))
    assert worst < 2e-4  # m/s
    assert np.ptp(world.poses[:, 1]) > 0.1
    np.testing.assert_allclose(world.poses, odometry, atol=1e-3)


FLOOR = Floor(
    patches=(Patch(center=(0.2, 0.15), size=(0.3, 0.4), friction=0.1, angle=0.4),),
    cables=(Cable(center=(0.1, 0.05), direction=1.3, length=0.9, diameter=0.006),),
    slope=(0.04, -0.02),
)


def commands(n, k):
    """Smooth commands that differ from wheel to wheel, so that axles fight and slip."""
    return 3.0 + 2.0 * np.sin(0.13 * k + 0.7 * np.arange(2 * n))


def ride(train, floor, pose, bends, order, samples=60, **options):
    """Poses of all axles (samples, N, 3); wheel commands in the given order."""
    world, rows = TrainWorld(train, floor, pose=pose, bends=bends, **options), []
    for k in range(samples):
        world.advance(commands(train.n_axles, k)[order])
        rows.append(world.poses)
    return np.array(rows)


def test_left_and_right_exchanged_a_train_drives_the_mirrored_path():
    train, flip = lopsided(3), np.array([1.0, -1.0, -1.0])
    mirrored_floor = Floor(
        patches=tuple(
            dataclasses.replace(patch, center=(patch.center[0], -patch.center[1]), angle=-patch.angle)
            for patch in FLOOR.patches
        ),
        cables=tuple(
            dataclasses.replace(cable, center=(cable.center[0], -cable.center[1]), direction=-cable.direction)
            for cable in FLOOR.cables
        ),
        slope=(FLOOR.slope[0], -FLOOR.slope[1]),
    )
    pose, bends = np.array([0.0, 0.05, 0.3]), np.array([0.5, -0.2])
    plain = ride(train, FLOOR, pose, bends, np.arange(6))
    mirror = ride(train, mirrored_floor, pose * flip, -bends, [1, 0, 3, 2, 5, 4])
    assert np.ptp(plain[:, 0, 1]) > 0.05
    np.testing.assert_allclose(mirror, plain * flip, rtol=0, atol=1e-9)


@pytest.mark.parametrize(("shift", "turn"), [((3.0, -2.0), 0.0), ((0.0, 0.0), 2.1), ((-1.0, 4.0), -0.9)])
def test_a_train_started_elsewhere_drives_the_same_path_there(shift, turn):
    train, start = lopsided(3), np.array([*shift, turn])
    pose, bends = np.array([0.0, 0.05, 0.3]), [0.5, -0.2]
    path = ride(train, Floor(), pose, bends, np.arange(6))
    moved = ride(train, Floor(), compose(start, pose), bends, np.arange(6))
    np.testing.assert_allclose(moved, compose(start, path), rtol=0, atol=1e-9)


def test_reference_and_compiled_stepper_agree():
    """Of a train of three axles on a rough floor, with servos, voltage and motors off by turns."""
    paths = []
    for stepper in ("reference", "compiled"):
        random, rows = np.random.default_rng(7), []
        world = TrainWorld(lopsided(3), FLOOR, bends=0.3, stepper=stepper, substeps=100)
        for k in range(18):
            drive = ("servo", "voltage", "off")[k // 3 % 3]
            limit = 6.0 if drive == "servo" else 0.4
            world.advance(random.uniform(0, limit, 6), drive)
            rows.append([*world.poses.ravel(), *world.wheel_angles, *np.concatenate(world.joint_angles)])
        paths.append(np.array(rows))
    assert np.ptp(paths[0][:, 0]) > 0.1
    np.testing.assert_allclose(paths[1], paths[0], rtol=0, atol=1e-12)


def test_the_same_drive_is_the_same_bit_for_bit():
    first, second = (ride(lopsided(3), FLOOR, (0.0, 0.0, 0.0), 0.3, np.arange(6), samples=20) for _ in range(2))
    assert first.tobytes() == second.tobytes()


@pytest.mark.parametrize("friction", [0.8, 0.15])
def test_halving_the_substep_moves_no_axle_of_an_s_bend_by_a_millimetre(friction):
    train, ends = changed(cfmmr(3), friction=friction), []
    for finer in (1, 2):
        world = TrainWorld(train, substeps=finer * TrainWorld(train).substeps)
        for k in range(220):
            world.advance(waves(3, 0.05 * (k + 0.5)))
        ends.append(world.poses)
    assert abs(ends[0][0, 0]) > 1.5
    assert np.hypot(*(ends[1] - ends[0])[:, :2].T).max() < 1e-3
    assert np.abs(ends[1] - ends[0])[:, 2].max() < 5e-3


@pytest.mark.parametrize("n", [2, 4, 7, 10])
def test_pivots_hold_and_nothing_breaks_in_an_s_bend(n):
    world, worst = TrainWorld(cfmmr(n)), 0.0
    assert len(pivots(world)) == 6 * (n - 1)
    for k in range(220):
        world.advance(waves(n, 0.05 * (k + 0.5)))
        worst = max(worst, gap(pivots(world)))
        # Bent as the path between the axles: never by more than its sharpest arc and what swings.
        assert np.abs(world.relative_poses[:, 2]).max() < 1.2 * LENGTH + 0.1
    assert worst < 1e-5
    assert world.poses[0, 0] > 1.5


@pytest.mark.parametrize("n", [2, 4, 7, 10])
def test_random_full_commands_break_nothing(n):
    """Frames bend far, pivots hold, and once the wheels are stopped all is still."""
    random, world, worst = np.random.default_rng(n), TrainWorld(cfmmr(n)), 0.0
    command = np.zeros(2 * n)
    for k in range(80):
        if k % 10 == 0:
            command = random.uniform(-10, 10, 2 * n)
        world.advance(command)
        worst = max(worst, gap(pivots(world)))
    assert worst < 2e-4
    for _ in range(60):
        world.advance(np.zeros(2 * n))
    assert np.abs(world.twists).max() < 1e-3


def end_pose_of_drawn_frame(force, stiffness):
    """Front clamp in the rear clamp's frame, for an axle behind that only holds against side slip: a force across."""
    bent = solve_ivp(
        lambda s, u: (math.cos(u[2]), math.sin(u[2]), force / stiffness * u[0]),
        (0, LENGTH),
        np.zeros(3),
        rtol=1e-10,
        atol=1e-12,
    )
    return bent.y[:, -1]


@pytest.mark.parametrize("curvature", [0.5, -1.0, 1.8])
def test_an_axle_that_is_only_drawn_bends_its_frame_as_statics_says(curvature):
    """Round and round at rest to each other, no force along on the rear axle and no moment: it only keeps its track.

    So the frame is bent by one force across at its rear end (elastica), and such that both axles roll about one
    centre: curvature = sin(phi) / x. (Much damped, or it would shimmy as an aircraft's nose wheel does.)
    """
    train = changed(cfmmr(2), {"damping": 0.01}, slip_stiffness_long=800.0, slip_stiffness_lat=800.0, damping=2e-4)
    front, rear = train.modules
    train = dataclasses.replace(train, modules=(front, dataclasses.replace(rear, max_wheel_torque=1e-9)))
    world = TrainWorld(train, substeps=300)
    for k in range(300):
        speed = 0.15 * min(1.0, k / 20) * np.array([1.0, 0.0])
        world.advance(rates(speed, speed * curvature))
    real = world.twists[0, 2] / world.twists[0, 0]
    assert real == pytest.approx(curvature, rel=0.01)
    stiffness = train.frames[0].bending_stiffness

    def missed(force):
        x, _, phi = end_pose_of_drawn_frame(force, stiffness)
        return math.sin(phi) / x - real

    strongest = math.copysign(3.0 * stiffness / LENGTH**2, curvature)
    x, y, phi = end_pose_of_drawn_frame(brentq(missed, 0.0, strongest), stiffness)
    assert abs(phi) > 0.15
    np.testing.assert_allclose(world.relative_poses[0, :2], [x, y], rtol=0, atol=0.01 * LENGTH)
    assert world.relative_poses[0, 1] == pytest.approx(y, rel=0.02)
    assert world.relative_poses[0, 2] == pytest.approx(phi, rel=0.01)
    assert math.hypot(*world.relative_poses[0, :2]) < LENGTH - abs(phi) ** 2 / 40 * LENGTH  # the chord draws in


seeds = st.integers(0, 2**32 - 1)


@pytest.mark.parametrize("n", [2, 4, 7])
@pytest.mark.parametrize("floor", [Floor(), Floor(slope=(0.05, -0.03)), ICE], ids=["level", "slope", "ice"])
@given(seed=seeds)
@settings(max_examples=2, deadline=None)
def test_with_motors_off_energy_does_not_grow(n, floor, seed):
    """Set going by bent frames and, where there is friction, by motors."""
    random = np.random.default_rng(seed)
    world = TrainWorld(cfmmr(n), floor, bends=random.uniform(-1.0, 1.0, n - 1))
    for _ in range(6):
        world.advance(random.uniform(-4, 4, 2 * n))
    energy = [world.energy()]
    for _ in range(40):
        world.advance(np.zeros(2 * n), "off")
        energy.append(world.energy())
    assert np.all(np.diff(energy) <= 1e-6 * np.abs(energy[:-1]) + 1e-9)
    assert energy[-1] < energy[0]


def test_energy_of_a_train_at_rest_is_what_bent_frames_hold():
    """E I phi^2 / 2 L each."""
    train = lopsided(4)
    world, bends = TrainWorld(train), np.array([0.6, -0.3, 0.9])
    assert world.energy() == pytest.approx(0.0, abs=1e-9)
    world = TrainWorld(train, bends=bends)
    held = [f.bending_stiffness * bend**2 / (2 * f.length) for f, bend in zip(train.frames, bends, strict=True)]
    assert world.energy() == pytest.approx(sum(held), rel=1e-9)


def momentum(world):
    """Linear momentum, angular momentum about the origin of N; and the centre of mass."""
    total, place, mass = np.zeros(3), np.zeros(2), 0.0
    for body in world.simulation.space.bodies:
        (x, y), (vx, vy) = body.position, body.velocity
        total += body.mass * np.array([vx, vy, x * vy - y * vx])
        total[2] += body.moment * body.angular_velocity
        place, mass = place + body.mass * np.array([x, y]), mass + body.mass
    return total, place / mass


@pytest.mark.parametrize("n", [2, 5])
def test_on_ice_momentum_stays_whatever_motors_and_frames_do(n):
    random = np.random.default_rng(1)
    world = TrainWorld(lopsided(n), ICE, bends=0.8 * (-1.0) ** np.arange(n - 1))
    bodies = world.simulation.space.bodies
    for body in bodies:  # in flight, turning about the origin, as one
        x, y = body.position
        body.velocity, body.angular_velocity = (0.5 - 0.4 * y, 0.3 + 0.4 * x), 0.4
    before, place = momentum(world)
    mass, straightest = sum(body.mass for body in bodies), math.inf
    for _ in range(40):
        world.advance(random.uniform(-10, 10, 2 * n))
        np.testing.assert_allclose(momentum(world)[0], before, rtol=1e-4)
        straightest = min(straightest, abs(world.relative_poses[0, 2]))
    np.testing.assert_allclose(momentum(world)[1], place + before[:2] / mass * world.time, atol=1e-6)
    assert straightest < 0.4  # frames swing


def two_axles(rear_friction, *, front_torque=3.0, bends=0.0):
    """A train held behind by servos on a patch, in front on good floor; returns the world."""
    train = cfmmr(2)
    front, rear = train.modules
    train = dataclasses.replace(train, modules=(dataclasses.replace(front, max_wheel_torque=front_torque), rear))
    patch = Patch(center=(-LENGTH, 0.0), size=(0.5, 2.0), friction=rear_friction)
    return TrainWorld(train, Floor(patches=(patch,)), bends=bends)


WEIGHT = G * (5.0 + 0.25 * LENGTH)  # N, of a module and half a frame of 0.5 kg/m


def test_an_axle_slides_when_its_frame_pulls_harder_than_friction_allows():
    """Its wheels stand, and all that its frame pulls with is friction times its weight."""
    world = two_axles(rear_friction=0.1)
    for k in range(40):
        world.advance([0.1 / RADIUS * min(1.0, k / 10)] * 2 + [0.0] * 2)
    np.testing.assert_allclose(world.twists[:, 0], 0.1, rtol=0.01)
    np.testing.assert_allclose(world.wheels["speed"][2:], 0.0, atol=1e-3 / RADIUS)
    np.testing.assert_allclose(world.wheels["force_long"][2:].sum(), -0.1 * WEIGHT, rtol=1e-6)
    np.testing.assert_allclose(world.wheels["force_long"][:2].sum(), 0.1 * WEIGHT, rtol=0.02)


@pytest.mark.parametrize(("share", "slides"), [(0.9, False), (1.1, True)])
def test_an_axle_slides_from_friction_times_its_weight_on(share, slides):
    """The front motors pull with that share of it."""
    world = two_axles(rear_friction=0.1, front_torque=share * 0.1 * WEIGHT * RADIUS / 2)
    for _ in range(30):
        world.advance([5.0, 5.0, 0.0, 0.0])
    settled = world.poses[1, 0]
    for _ in range(20):
        world.advance([5.0, 5.0, 0.0, 0.0])
    if slides:
        assert world.poses[1, 0] - settled > 0.05
    else:
        assert abs(world.poses[1, 0] - settled) < 1e-5
        assert abs(world.poses[1, 0] + LENGTH) < 5e-3  # the servos give way a little before they hold


def test_a_bent_frame_unbends_on_slippery_floor_only():
    """Its moment E I phi / L wrings the axles round, down to friction times load times half the track."""
    bend, friction = 1.0, 0.04
    held = two_axles(rear_friction=0.8, bends=bend)
    sliding = two_axles(rear_friction=friction, bends=bend)
    for _ in range(60):
        held.advance(np.zeros(4))
        sliding.advance(np.zeros(4))
    stiffness = held.train.frames[0].bending_stiffness
    assert held.relative_poses[0, 2] == pytest.approx(bend, rel=0.05)
    left = stiffness * sliding.relative_poses[0, 2] / LENGTH
    assert abs(left) <= friction * WEIGHT * HALF_TRACK * 1.05
    assert abs(sliding.poses[1, 2] + bend) > 0.3
    assert abs(sliding.poses[0, 2]) < 0.05


class Ideal:
    """Two axles that roll without slip on a massless beam with small bends; Maggi's way with multipliers.

    q = (X, Y, psi of the rear axle; y, phi of the front one in the rear one's frame), x from the beam being as long as
    it is. Derivatives of the position map come from central differences. Motors: torque falls linearly with speed.
    """

    STEP = 1e-5

    def __init__(self, train):
        frame, self.train = train.frames[0], train
        module = train.modules[0]
        half = 0.5 * frame.linear_density * frame.length
        mass, inertia = module.mass + module.castors[0].mass + half, module.inertia + module.castors[0].inertia
        self.mass = np.diag([mass, mass, inertia] * 2)
        self.spin = module.castors[0].wheels[0].inertia
        self.torque, self.fastest = module.max_wheel_torque, module.max_wheel_speed
        l = self.length = frame.length  # noqa: E741
        self.beam = frame.bending_stiffness / l**3 * np.array([[12.0, -6 * l], [-6 * l, 4 * l**2]])
        self.losses = self.beam * frame.damping / frame.bending_stiffness
        self.shortening = np.array([[6 / 5, -l / 10], [-l / 10, 2 / 15 * l**2]]) / l

    def axles(self, q):
        """Poses of rear and front axle, flat (6,)."""
        bend = q[3:]
        x = self.length - 0.5 * bend @ self.shortening @ bend
        return np.concatenate([q[:3], compose(q[:3], np.array([x, *bend]))])

    def jacobian(self, q):
        steps = self.STEP * np.eye(5)
        return np.array([(self.axles(q + d) - self.axles(q - d)) / (2 * self.STEP) for d in steps]).T

    def rows(self, q):
        """Of each axle: speed ahead and sideways, and turning, by the rates of q: (2, 3, 5)."""
        by_q, rows = self.jacobian(q), []
        for axle, psi in ((by_q[:3], q[2]), (by_q[3:], q[2] + q[4])):
            c, s = math.cos(psi), math.sin(psi)
            rows.append(np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) @ axle)
        return np.array(rows)

    def rhs(self, t, state, command):
        """Rates of q, q', and the wheels' angles; command: share of full voltage, front axle first."""
        q, rate = state[:5], state[5:10]
        by_q, rows = self.jacobian(q), self.rows(q)
        later, before = q + self.STEP * rate, q - self.STEP * rate
        by_q_rate = (self.jacobian(later) - self.jacobian(before)) / (2 * self.STEP) @ rate
        rows_rate = (self.rows(later) - self.rows(before)) / (2 * self.STEP) @ rate
        front_and_rear = rows[::-1], rows_rate[::-1]
        sides = np.array([-HALF_TRACK, HALF_TRACK])
        by_wheel, by_wheel_rate = (
            np.reshape([axle[0] + side * axle[2] for axle in axles for side in sides], (4, -1)) / RADIUS
            for axles in front_and_rear
        )
        by_wheel_rate, spinning = by_wheel_rate[:, 0], by_wheel @ rate
        torque = self.torque * (command - spinning / self.fastest)
        mass = by_q.T @ self.mass @ by_q + self.spin * by_wheel.T @ by_wheel
        force = by_wheel.T @ (torque - self.spin * by_wheel_rate) - by_q.T @ self.mass @ by_q_rate
        force[3:] -= self.beam @ q[3:] + self.losses @ rate[3:]
        sideways = rows[:, 1]
        system = np.block([[mass, sideways.T], [sideways, np.zeros((2, 2))]])
        solved = np.linalg.solve(system, np.concatenate([force, -rows_rate[:, 1]]))
        return np.concatenate([rate, solved[:5], spinning])


def test_an_independent_integration_with_ideal_rolling_agrees_within_half_a_millimetre():
    train = changed(
        cfmmr(2),
        frame={"linear_density": 0.1, "links": 8, "bending_stiffness": 1.0, "damping": 0.0005},
        slip_stiffness_long=4000.0,
        slip_stiffness_lat=4000.0,
        damping=1e-4,
    )
    model, world = Ideal(train), TrainWorld(train)
    state = np.concatenate([[-LENGTH, 0, 0, 0, 0], np.zeros(5), np.zeros(4)])
    path, expected = [], []
    for k in range(50):
        t = 0.05 * k
        turn = 0.06 * math.sin(2.0 * t) * np.array([-1, 1, 0.4, -0.4])
        command = 0.25 * min(1.0, t) + turn
        world.advance(command, "voltage")
        state = solve_ivp(model.rhs, (0, 0.05), state, args=(command,), rtol=1e-5, atol=1e-7).y[:, -1]
        path.append(world.poses)
        expected.append(model.axles(state[:5]).reshape(2, 3)[::-1])
    path, expected = np.array(path), np.array(expected)
    assert path[-1, 0, 0] > 0.3
    assert np.abs(path[:, 0, 2] - path[:, 1, 2]).max() > 0.1
    assert np.hypot(*np.moveaxis(path - expected, -1, 0)[:2]).max() < 5e-4
    assert np.abs(path - expected)[..., 2].max() < 1e-3
    np.testing.assert_allclose(world.wheel_angles, state[10:], atol=5e-4 / RADIUS)


def test_a_command_beyond_a_motor_s_speed_is_as_its_highest():
    beyond, highest = TrainWorld(cfmmr(2)), TrainWorld(cfmmr(2))
    for _ in range(5):
        beyond.advance([1e3, 1e3, 1e3, 1e3])
        highest.advance([10.0, 10.0, 10.0, 10.0])
    np.testing.assert_array_equal(beyond.poses, highest.poses)


def test_physics_that_goes_wrong_says_so():
    train = dataclasses.replace(cfmmr(2), frames=(Frame(length=0.35),))
    world = TrainWorld(train, substeps=3)

    def wring():
        for _ in range(40):
            world.advance([3.0, -3.0, -3.0, 3.0])

    with pytest.raises(InputError, match="unstable"):
        wring()


HEAVY = {
    "10 kg": (10.0, 0.1, Frame(length=0.35, damping=0.0)),
    "30 kg": (30.0, 0.5, Frame(length=0.35, damping=0.0)),
    "long": (
        17.7,
        0.3,
        Frame(length=0.864, bending_stiffness=1.4, linear_density=0.1336, damping=1e-4, links=8),
    ),
    "long, turning easily": (
        17.7,
        0.03,
        Frame(length=0.864, bending_stiffness=1.4, linear_density=0.1336, damping=1e-4, links=8),
    ),
}


@pytest.mark.parametrize("case", HEAVY)
def test_light_frames_swing_heavy_axles_as_long_as_they_should(case):
    """Motors off, from bent frames: energy grows by no more than a hundred-thousandth in all, and after 1 s as much is
    left as with four times the substeps, to a tenth."""
    mass, inertia, frame = HEAVY[case]
    module = dataclasses.replace(cfmmr(2).modules[0], mass=mass, inertia=inertia)
    train = dataclasses.replace(cfmmr(2), modules=(module, module), frames=(frame,))
    left = []
    for finer in (1, 4):
        world = TrainWorld(train, bends=0.8, substeps=finer * TrainWorld(train).substeps)
        energy = [world.energy()]
        for _ in range(20):
            world.advance(np.zeros(4), "off")
            energy.append(world.energy())
        assert np.max(np.array(energy) - np.minimum.accumulate(energy)) < 2e-5 * energy[0]
        left.append(energy[-1] / energy[0])
    assert left[0] == pytest.approx(left[1], abs=0.1)
