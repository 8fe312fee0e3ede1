"""An independent integration: minimal coordinates, mass matrix, own tyres and motors, scipy's solver; then compare.

Coordinates are q = (x, y, psi, theta of each castor that pivots). Points of the plane are complex numbers: a point that
sits at p in the frame of B, or at a in the frame of a castor that pivots at p, is at

    z = x + i y + exp(i psi) p + exp(i (psi + theta)) a

so its derivatives by x, y, psi and theta are 1, i, i (z - x - i y) and i exp(i (psi + theta)) a, and its acceleration
has beyond them times q'' the part -psi'^2 exp(i psi) p - (psi' + theta')^2 exp(i (psi + theta)) a. Kane's equations
follow: the sum over masses of Re(conj(derivative) * (mass * acceleration - force)) is zero for each coordinate.
"""

import dataclasses
import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from castor_envs.floor import Floor
from castor_envs.motion.controllers import KinematicController
from castor_envs.physics.robot_world import RobotWorld
from castor_envs.physics.wheel_state import SERVO_BANDWIDTH
from castor_envs.vehicles.presets import preset

STEERING_BANDWIDTH = 2000.0  # rad/s: how fast a steering motor within its torque limit takes up its commanded rate


def unsaturated(wanted, limit):
    """1 within a motor's limit, 0 beyond, steep instead of sudden between: so a solver can follow the limit."""
    return np.clip((limit - np.abs(wanted)) / (1e-3 * limit), 0.0, 1.0)


class Model:
    """Equations of motion of a robot whose wheels carry `loads` (N), written from its description alone."""

    def __init__(self, robot, floor, loads):
        self.robot, self.loads = robot, np.array(loads)
        slope = complex(*floor.slope)
        across = floor.gravity / math.sqrt(1 + abs(slope) ** 2)
        self.downhill, castors = -slope * across, robot.castors
        self.free = [i for i, castor in enumerate(castors) if castor.steering != "fixed"]
        self.dofs = 3 + len(self.free)
        self.column = {i: 3 + j for j, i in enumerate(self.free)}
        self.theta = np.array([castor.angle for castor in castors])
        self.steering = [self.column[i] for i in robot.driven_castors]
        self.steering_inertia = np.array([castors[i].inertia for i in robot.driven_castors])

        # Masses as points: chassis, then castors. Wheels' contact points likewise, each with its castor.
        self.mass = np.array([robot.mass, *(castor.mass for castor in castors)])
        self.inertia = np.array([robot.inertia, *(castor.inertia for castor in castors)])
        pivots = np.array([complex(*castor.pivot) for castor in castors])
        offsets = np.array([castor.offset for castor in castors])
        self.of = np.array(robot.wheel_castors)
        lateral = np.array([wheel.lateral for wheel in robot.wheels])
        self.in_body = np.array([complex(*robot.center_of_mass), *pivots, *pivots[self.of]])
        self.in_castor = np.array([0.0, *-offsets, *(-offsets[self.of] + 1j * lateral)])
        self.castor = np.array([-1, *range(len(castors)), *self.of])
        self.points_on = {column: np.flatnonzero(self.castor == i) for i, column in self.column.items()}

        self.radius = np.array([wheel.radius for wheel in robot.wheels])
        self.spin_inertia = np.array([wheel.inertia for wheel in robot.wheels])
        contact = robot.contact
        self.limit = contact.friction * self.loads
        self.k_long = contact.slip_stiffness_long * self.loads / contact.relaxation_length
        self.k_lat = contact.slip_stiffness_lat * self.loads / contact.relaxation_length
        felt = self.spin_inertia + self.loads / across * self.radius**2
        self.motor = np.array([wheel.driven for wheel in robot.wheels], dtype=float)
        self.p_gain, self.i_gain = SERVO_BANDWIDTH * felt, SERVO_BANDWIDTH**2 / 4 * felt

    def points(self, q, rates):
        """Return derivatives by q (points, dofs), and velocity and left-over acceleration (points,)."""
        theta, turning = self.theta.copy(), np.zeros(len(self.theta))
        theta[self.free], turning[self.free] = q[3:], rates[3:]
        e = np.exp(1j * q[2])
        body, arm = e * self.in_body, e * np.exp(1j * theta)[self.castor] * self.in_castor
        by_q = np.zeros((len(body), self.dofs), dtype=complex)
        by_q[:, 0], by_q[:, 1], by_q[:, 2] = 1, 1j, 1j * (body + arm)
        for column, on in self.points_on.items():
            by_q[on, column] = 1j * arm[on]
        spin = rates[2] + np.append(turning, 0.0)[self.castor]
        return by_q, by_q @ rates, -(rates[2] ** 2) * body - spin**2 * arm, e * np.exp(1j * theta)

    def tyres(self, long, lat, v, heading, spin):
        """Return force in N (complex) along with its part on the tread, and the rates of both bristle deflections."""
        v = v * np.conj(heading)
        rolling = np.abs(self.radius * spin) / self.robot.contact.relaxation_length
        d_long, d_lat = v.real - self.radius * spin - rolling * long, v.imag - rolling * lat
        damping = self.robot.contact.damping
        pull, push = -self.k_long * (long + damping * d_long), -self.k_lat * (lat + damping * d_lat)
        share = np.minimum(1.0, self.limit / np.maximum(np.hypot(pull, push), 1e-12))
        sliding = share < 1.0
        pull, push = pull * share, push * share
        d_long = np.where(sliding, (-pull / self.k_long - long) / damping, d_long)
        d_lat = np.where(sliding, (-push / self.k_lat - lat) / damping, d_lat)
        return heading * (pull + 1j * push), pull, d_long, d_lat

    def rhs(self, t, state, wheel_command, steering_command):
        """Return the derivative of q, q', steering integrals, spins, servo integrals, bristles along and across."""
        d, w = self.dofs, len(self.radius)
        q, rates, steered = state[:d], state[d : 2 * d], state[2 * d : -4 * w]
        spin, integral, long, lat = state[-4 * w :].reshape(4, w)
        by_q, velocity, left_over, direction = self.points(q, rates)
        bodies = len(self.mass)
        mass = np.real(np.conj(by_q[:bodies]).T * self.mass @ by_q[:bodies])
        mass[2, 2] += self.inertia.sum()
        for i, column in self.column.items():
            mass[[2, column, column], [column, 2, column]] += self.inertia[i + 1]
        push = self.mass * (self.downhill - left_over[:bodies])
        force, pull, d_long, d_lat = self.tyres(long, lat, velocity[bodies:], direction[self.of], spin)
        loads = np.real(np.conj(by_q).T @ np.concatenate([push, force]))
        late, gain = steering_command - rates[self.steering], STEERING_BANDWIDTH * self.steering_inertia
        wanted, limit = gain * (late + STEERING_BANDWIDTH / 4 * steered), self.robot.max_steering_torque
        loads[self.steering] += np.clip(wanted, -limit, limit)
        d_steered = late * unsaturated(wanted, limit)
        error = (wheel_command - spin) * self.motor
        wanted, limit = self.p_gain * error + self.i_gain * integral, self.robot.max_wheel_torque
        torque = np.clip(wanted, -limit, limit)
        d_spin = (torque - self.radius * pull) / self.spin_inertia
        d_integral = error * unsaturated(wanted, limit)
        return np.concatenate([rates, np.linalg.solve(mass, loads), d_steered, d_spin, d_integral, d_long, d_lat])


def integrated(model, commands, start):
    """Poses and pivot angles after each sample period, commands held during it."""
    robot, driven = model.robot, list(model.robot.driven_wheels)
    state = np.zeros(2 * model.dofs + len(model.steering) + 4 * len(model.radius))
    state[: model.dofs], rows = start, []
    for wheel, steering in commands:
        command = np.zeros(len(model.radius))
        command[driven] = np.clip(wheel, -robot.max_wheel_speed, robot.max_wheel_speed)
        steering = np.clip(steering, -robot.max_steering_speed, robot.max_steering_speed)
        options = {"method": "LSODA", "rtol": 1e-4, "atol": 1e-6}
        state = solve_ivp(model.rhs, (0, robot.sample_period), state, args=(command, steering), **options).y[:, -1]
        rows.append(state[: model.dofs])
    return np.array(rows)


def wanted_twist(robot, t, speed):
    sideways = 0.0 if robot.castors[0].steering == "fixed" else 0.6 * math.cos(1.3 * t)
    return speed * min(1.0, t / 0.5) * np.array([math.cos(0.8 * t), sideways, 2.5 * math.sin(1.7 * t)])


@pytest.mark.parametrize(
    ("name", "friction", "speed"),
    [
        ("asoc-prototype", 0.8, 0.5),
        pytest.param("asoc-prototype", 0.15, 0.4, marks=pytest.mark.slow),  # slides most of the time
        ("differential", 0.15, 0.8),
        ("powered-caster", 0.8, 0.25),
    ],
)
def test_an_independent_integration_agrees_within_a_millimetre(name, friction, speed):
    robot = preset(name)
    robot = dataclasses.replace(robot, contact=dataclasses.replace(robot.contact, friction=friction))
    floor = Floor(slope=(0.06, -0.04))
    weight = 9.80665 * (robot.mass + sum(castor.mass for castor in robot.castors))
    even = weight / math.sqrt(1 + 0.06**2 + 0.04**2) / len(robot.wheels)
    model = Model(robot, floor, [even] * len(robot.wheels))
    world, controller, commands, path = RobotWorld(robot, floor), KinematicController(robot), [], []
    for k in range(round(2.0 / robot.sample_period)):
        wanted = wanted_twist(robot, (k + 0.5) * robot.sample_period, speed)
        commands.append(controller.commands(world.castor_angles, wanted))
        world.advance(*commands[-1])
        path.append([*world.pose, *world.castor_angles[model.free]])
    path, expected = np.array(path), integrated(model, commands, np.zeros(model.dofs))
    assert np.ptp(path[:, :2]) > 0.2
    assert np.max(np.hypot(*(path - expected)[:, :2].T)) < 1e-3
    assert np.max(np.abs(path[:, 2:] - expected[:, 2:])) < 5e-3
