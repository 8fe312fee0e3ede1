"""Rolling without slip, integrated here once more: points of the castors as complex numbers, no code of the project."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from castor_envs.robot import Castor, RobotDescription, Wheel


@dataclass(frozen=True)
class Motion:
    """Exact motion of a robot over `duration` seconds; sampled at will."""

    robot: RobotDescription
    duration: float
    state: Callable

    def sampled(self, steps: int):
        """Return the true poses (steps + 1, 3) and the observations of unrounded encoders at evenly spaced times."""
        t = np.linspace(0.0, self.duration, steps + 1)
        castors = self.robot.castors
        state = self.state(t)
        pose, theta, rolled = state[:3].T, state[3 : 3 + len(castors)], state[3 + len(castors) :]
        radius = np.array([wheel.radius for castor in castors for wheel in castor.wheels])
        counts = np.array([wheel.counts_per_rev for castor in castors for wheel in castor.wheels])
        wheel = np.diff(rolled, prepend=rolled[:, :1]).T / (2 * np.pi * radius) * counts
        pivot = [
            (theta[i] + castor.pivot_zero) / (2 * np.pi) * castor.pivot_counts_per_rev
            for i, castor in enumerate(castors)
            if castor.pivot_counts_per_rev
        ]
        pivot = np.array(pivot).reshape(-1, len(t)).T
        return pose, [{"wheel": wheel[k], "pivot": pivot[k], "time": t[k : k + 1]} for k in range(len(t))]


def exact_motion(robot, twist, duration, theta=None, pose=(0.0, 0.0, 0.0)):
    """Integrate castor angles and rolled distances for the body twist (v_x, v_y, omega) = twist(t)."""
    castors = robot.castors
    pivots = [complex(*castor.pivot) for castor in castors]

    def rates(t, state):
        v_x, v_y, omega = twist(t)
        turned = np.exp(1j * state[2])
        velocity = (v_x + 1j * v_y) * turned
        swivel, rolling = [], []
        for i, castor in enumerate(castors):
            of_pivot = velocity + 1j * omega * pivots[i] * turned
            heading = np.exp(1j * (state[2] + state[3 + i]))
            seen = of_pivot / heading  # along the castor, and to its left
            spin = omega if castor.steering == "fixed" else seen.imag / castor.offset
            swivel.append(spin - omega)
            rolling += [seen.real - wheel.lateral * spin for wheel in castor.wheels]
        return [velocity.real, velocity.imag, omega, *swivel, *rolling]

    if theta is None:
        theta = [castor.angle for castor in castors]
    start = [*pose, *theta, *[0.0] * len(robot.wheels)]
    solution = solve_ivp(rates, (0.0, duration), start, method="DOP853", rtol=1e-12, atol=1e-13, dense_output=True)
    return Motion(robot, duration, solution.sol)


def odd_robot(n=3, centred=True):
    """A robot with nothing equal on it: radii, laterals (also on one castor), offsets, encoders, zeros, pivots."""
    random = np.random.default_rng(n)
    pivots = random.uniform(-0.3, 0.3, (n, 2)) + 0.5 * np.exp(2j * np.pi * np.arange(n) / n).view(float).reshape(n, 2)
    if centred:
        pivots -= pivots.mean(axis=0)
    castors = []
    for x, y in pivots:
        left, right = (
            Wheel(lateral=side * random.uniform(0.05, 0.09), radius=random.uniform(0.03, 0.05), counts_per_rev=counts)
            for side, counts in ((1, 1200.0), (-1, 1000.0))
        )
        castors.append(
            Castor(
                pivot=(x, y),
                offset=random.uniform(0.05, 0.1),
                pivot_counts_per_rev=int(random.integers(1000, 6000)),
                pivot_zero=random.uniform(-3, 3),
                wheels=(left, right),
            )
        )
    return RobotDescription(name="odd", castors=tuple(castors))


def winding(t):
    """A smooth twist in which all three components change sign."""
    return 0.3 * np.cos(0.7 * t) + 0.05, 0.3 * np.sin(0.9 * t), 0.7 * np.sin(1.1 * t + 0.4)


def drive(estimator, robot, observations, pose=(0.0, 0.0, 0.0)):
    """Return the poses (N, 3) of an estimator."""
    estimator.reset(robot, np.array(pose, dtype=float))
    return np.array([estimator.update(observation) for observation in observations])


def noise(robot, seed=0, steps=30, counts=15):
    """Observations that no rolling robot makes: every wheel and pivot at random."""
    random = np.random.default_rng(seed)
    wheels, pivots = len(robot.driven_wheels), len(robot.pivot_encoders)
    wheel = random.integers(-counts, counts, (steps, wheels)).astype(float)
    wheel[0] = 0.0
    pivot = random.integers(0, 1000, (steps, pivots)).astype(float)
    return [{"wheel": wheel[k], "pivot": pivot[k], "time": np.array([0.05 * k])} for k in range(steps)]


@pytest.fixture(scope="session", name="exact_motion")
def _exact_motion():
    return exact_motion


@pytest.fixture(scope="session", name="odd_robot")
def _odd_robot():
    return odd_robot


@pytest.fixture(scope="session", name="winding")
def _winding():
    return winding


@pytest.fixture(scope="session", name="drive")
def _drive():
    return drive


@pytest.fixture(scope="session", name="noise")
def _noise():
    return noise
