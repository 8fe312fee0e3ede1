"""Logs of a train of two axles with hidden effects, on perfect rolling built here, and effects to hide."""

import dataclasses

import numpy as np
import pytest
from numpy.polynomial import Polynomial

from castor_envs.effects.dimensions import AllWheelRadius, Track, WheelRadius
from castor_envs.effects.train import ForeshorteningLeftOut, FrameLength, GaugeDrift, GaugeGain, GaugeNoise
from castor_envs.logs.log import Log
from castor_envs.vehicles.presets import cfmmr

TRAIN, SPEED, SECONDS = cfmmr(2), 0.3, 12.0
LENGTH, STEP = TRAIN.frames[0].length, 1e-3
COUNTS = 2000  # a turn


def path(s, seed):
    """Heading of a winding path at arc lengths s, m."""
    a, b = np.random.default_rng(seed).uniform(-0.5, 0.5, 2)
    return 0.9 * np.sin((1.4 + 0.2 * a) * s + b) + 0.1 * s


def driven(
    seed=1,
    *,
    gains=(1.0,) * 4,
    dead=(),
    drift=0.0,
    shortening=1.0,
    longer=0.0,
    tracks=(1.0, 1.0),
    radii=(1.0,) * 4,
    noise=1.0,
    stops=np.inf,
    lost=None,
    straight=False,
    reference=True,
    seconds=SECONDS,
):
    """A log of two axles that roll along one path without slip or force, the frame bent along it.

    What sensors read is worked out here: curvature of the path at the gauges, a parabola through them in the least
    squares, its integrals along the frame by the trapezium rule.
    """
    random = np.random.default_rng([seed, 5])
    t = 0.05 * np.arange(round(seconds / 0.05) + 1)
    front = SPEED * (t + 0.3 * np.sin(1.1 * t))
    grid = np.arange(-LENGTH - 0.1, front[-1] + 0.1, STEP)
    heading = np.zeros_like(grid) if straight else path(grid, seed)
    x, y = (np.concatenate([[0.0], np.cumsum(STEP * f((heading[1:] + heading[:-1]) / 2))]) for f in (np.cos, np.sin))
    at = np.stack([front, front - LENGTH - longer], axis=1)
    pose = np.stack([np.interp(at, grid, column) for column in (x, y, heading)], axis=-1)

    rolled, turned = at - at[0], pose[..., 2] - pose[0, :, 2]
    half = 0.16 * np.array(tracks)
    wheel = np.stack([rolled - half * turned, rolled + half * turned], axis=-1).reshape(-1, 4)
    counts = wheel / (0.075 * np.array(radii)) * COUNTS / (2 * np.pi)
    if lost is not None:
        which, start, end, share = lost
        inside = (t[1:] > start) & (t[1:] <= end)
        counts[1:, which] -= np.cumsum(share * inside * np.diff(counts[:, which]))

    places = LENGTH * (np.arange(4) + 0.5) / 4
    bend = np.gradient(heading, grid)
    kappa = np.interp(at[:, 1:] + places, grid, bend) * np.array(gains) + random.normal(0.0, 0.4, 4)
    kappa += noise * 0.1 * random.standard_normal(kappa.shape) + drift * t[:, None]
    kappa[:, [number - 1 for number in dead]] = 0.0
    s = np.linspace(0.0, LENGTH, 401)
    rps = np.zeros((len(t), 3))
    for k, reading in enumerate(kappa):
        phi = Polynomial.fit(places, reading, 2).integ(lbnd=0.0)(s)
        rps[k] = np.trapezoid(np.cos(phi), s), np.trapezoid(np.sin(phi), s), phi[-1]
    rps[:, 0] = LENGTH - shortening * (LENGTH - rps[:, 0])
    last = np.searchsorted(t, stops)
    age = np.where(t > stops, t - t[min(last, len(t) - 1)], 0.0)
    rps[last:] = rps[min(last, len(t) - 1)]

    truth = pose + random.normal(0.0, 1e-3, pose.shape)
    truth[np.arange(len(t)) % 20 > 0] = np.nan
    soft = dataclasses.replace(TRAIN.frames[0], bending_stiffness=1e-6)
    log = Log(
        t=t,
        wheel=np.round(counts + random.uniform(size=4)),
        pivot=np.zeros((len(t), 0)),
        reference=truth.reshape(-1, 6) if reference else None,
        rps=rps,
        rps_age=age[:, None],
    )
    return log, dataclasses.replace(TRAIN, frames=(soft,))


HIDDEN = [
    ({"gains": (1.1,) * 4}, GaugeGain(frame=1, value=0.1), None),
    ({"gains": (1.0, 1.0, 1.0, 0.7)}, GaugeGain(frame=1, gauge=4, value=-0.3), None),
    ({"drift": 0.02}, GaugeDrift(frame=1, value=0.02), None),
    ({"shortening": 0.3}, ForeshorteningLeftOut(frame=1, value=0.7), None),
    ({"longer": 0.008}, FrameLength(frame=1, value=0.008), None),
    ({"tracks": (1.02, 1.0)}, Track(castor=1, value=0.02), 1),
    ({"radii": (1.0, 1.0, 1.0, 1.01)}, WheelRadius(castor=1, wheel=2, value=0.01), 2),
    ({"radii": (0.99, 0.99, 1.0, 1.0)}, AllWheelRadius(value=-0.01), 1),
    ({"noise": 5**0.5}, GaugeNoise(frame=1, value=0.2), None),
]


@pytest.fixture(name="driven", scope="session")
def _driven():
    """The function that makes such a log, and the train as it is described, its frames so soft that they do not make
    axles creep."""
    return driven


@pytest.fixture(params=HIDDEN, ids=lambda case: case[1].name)
def hidden_effect(request):
    """What to hide, by `driven`, the effect that it is, and the axle whose module has it."""
    return request.param
