"""A chain of links is an Euler-Bernoulli beam: closed forms of statics, swings and damping, and how it converges.

Here a chain is clamped to a wall behind; its front end is free.
"""

import dataclasses
import math
from typing import NamedTuple

import numpy as np
import pymunk
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from castor_envs.errors import InputError
from castor_envs.physics.beam import Clamp, chain, half_link
from castor_envs.physics.train_world import TrainWorld
from castor_envs.vehicles.presets import cfmmr
from castor_envs.vehicles.train import Frame

DEFAULT = dataclasses.replace(cfmmr(2).frames[0], damping=0.0)
FRAMES = {
    "the preset's": DEFAULT,
    "short and stiff": Frame(length=0.12, bending_stiffness=6.0, linear_density=2.0, damping=0.0),
    "long and soft": Frame(length=1.5, bending_stiffness=0.8, linear_density=0.3, damping=0.0),
}


def with_links(frame, links):
    return dataclasses.replace(frame, links=links)


def first_frequency(frame):
    """Of a clamped beam with a free end, rad/s."""
    return 1.87510407**2 * math.sqrt(frame.bending_stiffness / (frame.linear_density * frame.length**4))


class Cantilever(NamedTuple):
    space: pymunk.Space
    tip: pymunk.Body
    bodies: list[pymunk.Body]
    end: tuple[float, float]

    def pose(self):
        """Pose of the free end."""
        return np.array([*self.tip.local_to_world(self.end), self.tip.angle])


def cantilever(frame, dt):
    """A straight chain at rest; its front half link stands for a free end: hardly any inertia of its own."""
    space = pymunk.Space()
    space.iterations = 4 * frame.links
    mass, inertia, middle = half_link(frame, -1.0)
    assert inertia == 0.0
    tip = pymunk.Body(mass, 0.01 * mass * (frame.length / frame.links) ** 2)
    tip.position = (frame.length + float(middle[0]), float(middle[1]))
    links, joints = chain(frame, Clamp(space.static_body, np.zeros(2)), Clamp(tip, -middle), dt)
    space.add(tip, *links, *joints)
    return Cantilever(space, tip, [tip, *links], (-float(middle[0]), 0.0))


def stable_substep(frame):
    """The free end's half link swings fastest, with sqrt(k / inertia); s."""
    mass, _, _ = half_link(frame, -1.0)
    h = frame.length / frame.links
    return 0.5 / math.sqrt(frame.bending_stiffness / h / (0.01 * mass * h**2))


def at_rest_under(frame, force=0.0, torque=0.0):
    """The cantilever under a force across (N) and a torque (N m) at its end, after all swinging is braked."""
    dt, swing = stable_substep(frame), first_frequency(frame)
    beam = cantilever(frame, dt)
    slowed = math.exp(-2 * swing * 10 * dt)
    steps = math.ceil(30 / swing / dt)
    for k in range(steps):
        share = min(1.0, 3 * k / steps)
        beam.tip.apply_force_at_world_point((0.0, share * force), beam.tip.local_to_world(beam.end))
        beam.tip.torque += share * torque
        beam.space.step(dt)
        if k % 10 == 0:
            for body in beam.bodies:
                body.velocity, body.angular_velocity = body.velocity * slowed, body.angular_velocity * slowed
    return beam, dt


def deflection_ratio(frame):
    """Deflection under a small load at the end over P L^3 / 3 E I."""
    load = 1e-3 * frame.bending_stiffness / frame.length**2
    beam, _ = at_rest_under(frame, force=load)
    return float(beam.pose()[1]) / (load * frame.length**3 / (3 * frame.bending_stiffness))


@pytest.mark.parametrize("name", FRAMES)
def test_an_end_load_deflects_the_tip_by_p_l_cubed_over_three_e_i(name):
    assert deflection_ratio(FRAMES[name]) == pytest.approx(1.0, abs=0.01)


def test_an_end_load_turns_the_tip_by_p_l_squared_over_two_e_i():
    frame, load = DEFAULT, 1e-3
    beam, _ = at_rest_under(frame, force=load)
    assert beam.pose()[2] == pytest.approx(load * frame.length**2 / (2 * frame.bending_stiffness), rel=1e-4)


@pytest.mark.parametrize("links", [3, 6, 12])
def test_the_deflection_converges_with_the_square_of_the_number_of_links(links):
    """The midpoint rule: each of n joints carries the bend of its piece."""
    assert deflection_ratio(with_links(DEFAULT, links)) == pytest.approx(1 - 1 / (4 * links**2), abs=2e-5)


@pytest.mark.parametrize("slenderness", [0.3, 1.0, 10.0])
def test_no_frame_is_too_short_to_bend_without_shear(slenderness):
    """A beam that sheared would deflect the more beyond P L^3 / 3 E I the shorter it is."""
    long_frame, short_frame = DEFAULT, dataclasses.replace(DEFAULT, length=DEFAULT.length * slenderness)
    assert deflection_ratio(short_frame) == pytest.approx(deflection_ratio(long_frame), abs=2e-5)


@pytest.mark.parametrize("bend", [-90, -20, 5, 45, 90])
def test_a_moment_at_the_tip_bends_the_frame_to_an_arc(bend):
    bend, frame = math.radians(bend), DEFAULT
    beam, _ = at_rest_under(frame, torque=frame.bending_stiffness * bend / frame.length)
    radius = frame.length / bend
    x, y, angle = beam.pose()
    assert angle == pytest.approx(bend, rel=1e-4)
    assert math.dist((x, y), (radius * math.sin(bend), radius * (1 - math.cos(bend)))) < 0.01 * frame.length
    assert y == pytest.approx(radius * (1 - math.cos(bend)), rel=0.01)


def elastica(frame, force):
    """End pose of an inextensible beam under a force across at its end, that keeps its direction (shooting)."""

    def end(curvature):
        def along(s, u):
            return math.cos(u[2]), math.sin(u[2]), u[3], -force / frame.bending_stiffness * math.cos(u[2])

        return solve_ivp(along, (0, frame.length), (0, 0, 0, curvature), rtol=1e-10, atol=1e-12).y[:, -1]

    straight = force * frame.length / frame.bending_stiffness
    return end(brentq(lambda curvature: end(curvature)[3], 0.0, 1.01 * straight))[:3]


@pytest.mark.parametrize("load", [0.5, 2.0, 5.0])
def test_a_large_end_load_bends_the_frame_to_the_elastica(load):
    """load: in E I / L^2; the largest turns the end by 70 deg."""
    force = load * DEFAULT.bending_stiffness / DEFAULT.length**2
    expected = elastica(DEFAULT, force)
    beam, _ = at_rest_under(dataclasses.replace(DEFAULT, damping=0.001), force=force)
    x, y, angle = beam.pose()
    assert expected[2] > 0.2
    assert math.dist((x, y), expected[:2]) < 0.01 * DEFAULT.length
    assert angle == pytest.approx(expected[2], rel=0.01)


def swing(frame, beam, dt, periods):
    """How the free end swings (N,), m, and the frequency of it, rad/s, from its zeros upwards."""
    y = np.empty(math.ceil(periods * 2 * math.pi / first_frequency(frame) / dt))
    for k in range(len(y)):
        beam.space.step(dt)
        y[k] = beam.tip.position.y
    up = np.flatnonzero((y[:-1] < 0) & (y[1:] >= 0))
    zeros = (up - y[up] / (y[up + 1] - y[up])) * dt
    assert len(zeros) >= periods - 2
    return y, 2 * math.pi * (len(zeros) - 1) / (zeros[-1] - zeros[0])


def frequency_ratio(frame):
    """First natural frequency over that of the beam; released from the shape under an end load, 97 % first mode."""
    beam, dt = at_rest_under(frame, force=0.01 * frame.bending_stiffness / frame.length**2)
    y, frequency = swing(frame, beam, dt, periods=8)
    late = len(y) // 4
    assert np.abs(y[-late:]).max() == pytest.approx(np.abs(y[:late]).max(), rel=0.03)  # undamped
    return frequency / first_frequency(frame)


@pytest.mark.parametrize("name", FRAMES)
def test_a_clamped_frame_swings_with_the_first_natural_frequency(name):
    assert frequency_ratio(FRAMES[name]) == pytest.approx(1.0, abs=0.03)


def test_the_frequency_converges_with_the_square_of_the_number_of_links():
    coarse, middle, fine = (frequency_ratio(with_links(DEFAULT, links)) - 1 for links in (3, 6, 12))
    assert coarse / middle == pytest.approx(4, abs=0.6)
    assert middle / fine == pytest.approx(4, abs=0.6)


@pytest.mark.parametrize(("links", "substep"), [(3, 4e-4), (6, 4e-4), (6, 1e-4), (12, 1e-4)])
@pytest.mark.parametrize("damping", [0.0005, 0.002])
def test_swings_decay_as_kelvin_and_voigt_say(links, substep, damping):
    """At c omega^2 / (2 E I), whatever the substep: the moment is c times the rate of curvature."""
    frame = dataclasses.replace(with_links(DEFAULT, links), damping=damping)
    beam = cantilever(frame, substep)
    beam.tip.moment = 0.25 * beam.tip.mass * (frame.length / frame.links) ** 2  # calmer at long substeps
    for body in beam.bodies:  # pushed nearly in the first mode's shape, s^2
        s = float(body.position.x) / frame.length
        body.velocity, body.angular_velocity = (0.0, 0.02 * s**2), 0.04 * s / frame.length
    y, frequency = swing(frame, beam, substep, periods=7)
    tops = np.flatnonzero((y[1:-1] > y[:-2]) & (y[1:-1] >= y[2:])) + 1
    tops = tops[tops * substep > 2 * math.pi / frequency]  # higher modes have died away
    decay = -np.polyfit(tops * substep, np.log(y[tops]), 1)[0]
    assert len(tops) >= 5
    assert decay == pytest.approx(damping * frequency**2 / (2 * frame.bending_stiffness), rel=0.03)


@pytest.mark.parametrize("bend", [-1.2, 0.4, 1.0])
def test_a_bent_frame_s_chord_is_that_of_an_arc_as_long_as_the_frame(bend):
    """It is shorter than the frame by L - 2 R sin(L / 2 R), and what links change of that falls with 1 / n^2."""
    errors = []
    for links in (6, 12, 24):
        train = cfmmr(3)
        frame = with_links(train.frames[0], links)
        train = dataclasses.replace(train, frames=(frame, frame))
        world = TrainWorld(train, pose=(0.3, -0.2, 0.5), bends=[bend, 0.0])
        front, middle, rear = world.poses
        radius = frame.length / bend
        shorter = frame.length - math.dist(front[:2], middle[:2])
        errors.append(shorter - (frame.length - 2 * radius * math.sin(bend / 2)))
        assert front[2] - middle[2] == pytest.approx(bend)
        assert abs(errors[-1]) < 2.5 / links**2 * shorter
        assert math.dist(middle[:2], rear[:2]) == pytest.approx(frame.length, abs=1e-12)
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.05)
    assert errors[1] / errors[2] == pytest.approx(4, rel=0.05)


@pytest.mark.parametrize(
    "changes", [{"bending_stiffness": 1e6}, {"damping": 100.0}, {"linear_density": 1e-6}, {"length": 1e-3}]
)
def test_a_frame_that_would_take_too_many_substeps_is_refused(changes):
    frame = dataclasses.replace(DEFAULT, **changes)
    with pytest.raises(InputError, match=r"substeps.*frame"):
        TrainWorld(dataclasses.replace(cfmmr(2), frames=(frame,)))
