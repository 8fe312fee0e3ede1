"""Rolling without slip, integrated here once more: points of the castors as complex numbers, no code of the project."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from castor_envs.vehicles.presets import cfmmr
from castor_envs.vehicles.robot import Castor, RobotDescription, Wheel


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
        counts = np.array([wheel.counts_per_rev or np.nan for castor in castors for wheel in castor.wheels])
        wheel = np.diff(rolled, prepend=rolled[:, :1]).T / (2 * np.pi * radius) * counts
        wheel = wheel[:, np.isfinite(counts)]
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
            if castor.steering == "fixed":
                spin = omega
            elif castor.offset:
                spin = seen.imag / castor.offset
            else:  # turned to where the pivot goes
                spin = omega + swivel_of(i, t)
            swivel.append(spin - omega)
            rolling += [
                seen.real - wheel.lateral * spin + np.tan(wheel.roller_angle) * (seen.imag - castor.offset * spin)
                for wheel in castor.wheels
            ]
        return [velocity.real, velocity.imag, omega, *swivel, *rolling]

    def of_pivot_in_body(i, t):
        v_x, v_y, omega = twist(t)
        return v_x + 1j * v_y + 1j * omega * pivots[i]

    def swivel_of(i, t, dt=1e-5):
        return np.angle(of_pivot_in_body(i, t + dt) / of_pivot_in_body(i, t - dt)) / (2 * dt)

    if theta is None:
        theta = [
            castor.angle if castor.offset or castor.steering == "fixed" else np.angle(of_pivot_in_body(i, 0.0))
            for i, castor in enumerate(castors)
        ]
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


def circling(n=3, speed=0.4, curvature=0.8, seconds=2.0):
    """A train whose axles all follow one circle (a line, at curvature 0), exact counts and frames bent along it.

    Returns the train, the true poses (K, N, 3) and the observations.
    """
    train = cfmmr(n)
    wheel = train.modules[0].castors[0].wheels[0]
    assert wheel.counts_per_rev is not None
    t = np.arange(round(seconds / train.sample_period) + 1) * train.sample_period
    length = train.frames[0].length
    along = speed * t[:, None] - length * np.arange(n)
    if curvature == 0.0:
        truth = np.stack([along, 0 * along, 0 * along], axis=-1)
        bent = [length, 0.0, 0.0]
    else:
        at = curvature * along
        truth = np.stack([np.sin(at) / curvature, (1 - np.cos(at)) / curvature, at], axis=-1)
        angle = curvature * length
        bent = [np.sin(angle) / curvature, (1 - np.cos(angle)) / curvature, angle]
    roll = speed * train.sample_period * (1 - curvature * wheel.lateral * np.array([1.0, -1.0]))
    counts = np.tile(roll / (2 * np.pi * wheel.radius) * wheel.counts_per_rev, n)
    observations = [
        {
            "wheel": counts * (k > 0),
            "time": t[k : k + 1],
            "rps": np.tile(bent, n - 1),
            "rps_age": np.zeros(n - 1),
        }
        for k in range(len(t))
    ]
    return train, truth, observations


def standing(n, relative, times=(0.0, 10.0)):
    """Observations of a train that stands still while its frames say the same."""
    return [
        {
            "wheel": np.zeros(2 * n),
            "time": np.array([time]),
            "rps": np.array(relative, dtype=float).ravel(),
            "rps_age": np.zeros(n - 1),
        }
        for time in times
    ]


def snapshots(count, n, deviant, seed=0):
    """Random configurations: truth and OD poses (count, N, 3), relative poses (count, N - 1, 3).

    Odometry is off by 1 cm and 1 deg, relative poses by 2 cm and 2 deg; deviant axles by 10 to 30 cm and 10 to 60 deg.
    """
    random = np.random.default_rng(seed)
    angle = random.uniform(-1.0, 1.0, (count, n - 1))
    chord = 0.35 * np.sinc(angle / (2 * np.pi))
    relative = np.stack([chord * np.cos(angle / 2), chord * np.sin(angle / 2), angle], axis=-1)
    truth = np.zeros((count, n, 3))
    truth[:, -1] = random.uniform([-1, -1, -3], [1, 1, 3], (count, 3))
    for i in range(n - 2, -1, -1):
        rear, seen = truth[:, i + 1], relative[:, i]
        place = (rear[:, 0] + 1j * rear[:, 1]) + np.exp(1j * rear[:, 2]) * (seen[:, 0] + 1j * seen[:, 1])
        truth[:, i] = np.stack([place.real, place.imag, rear[:, 2] + seen[:, 2]], axis=-1)
    od = truth + random.normal(size=truth.shape) * [0.01, 0.01, np.radians(1.0)]
    for k in range(count):
        for i in random.choice(n, deviant, replace=False):
            bearing, distance = random.uniform(-np.pi, np.pi), random.uniform(0.1, 0.3)
            turn = random.choice([-1, 1]) * np.radians(random.uniform(10.0, 60.0))
            od[k, i] += [distance * np.cos(bearing), distance * np.sin(bearing), turn]
    return truth, od, relative + random.normal(size=relative.shape) * [0.02, 0.02, np.radians(2.0)]


def mean_error(poses, truth):
    """Return the mean distance (...) between poses and truth (..., N, 3), m."""
    return np.hypot(poses[..., 0] - truth[..., 0], poses[..., 1] - truth[..., 1]).mean(axis=-1)


@pytest.fixture(scope="session", name="circling")
def _circling():
    return circling


@pytest.fixture(scope="session", name="standing")
def _standing():
    return standing


@pytest.fixture(scope="session", name="snapshots")
def _snapshots():
    return snapshots


@pytest.fixture(scope="session", name="mean_error")
def _mean_error():
    return mean_error


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
