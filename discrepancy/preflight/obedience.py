"""How far motors do what they are told: what a log's commands say of its encoders' wiring.

A motor turns its own wheel or castor, whatever its encoder is connected to. So an encoder that counts backwards, or
shows another wheel, contradicts the command, even where the encoders agree with each other as the robot steers by them.
Motors may fail to do as they are told, as where wheels are driven against each other. So what counts is by how much
better another encoder, or the same one backwards, would follow the command.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import Log
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.preflight.checks import GAP
from discrepancy.preflight.reading import Channels, Reading
from discrepancy.preflight.stretches import STEP, unwrapped
from discrepancy.preflight.stretches import WINDOW as STEPS_A_WINDOW

WINDOW = STEP * STEPS_A_WINDOW
"""s: turns are summed over this long, in which motors follow their commands."""

OBEYED = 0.05
"""Share of squares by which another encoder may follow better by chance."""

TINY = 1e-12
"""rad2: turns whose squares are less are none."""


class Obedience:
    """The share of turns that commands explain better of other encoders, under any reading of logs; 0 without any."""

    def __init__(self, robot: RobotDescription, logs: Sequence[Log], dead: frozenset[int] = frozenset()) -> None:
        """dead: channels that never change and are left out."""
        channels = Channels(robot)
        at = [channels.pivot_of.get(i + 1) for i in robot.driven_castors]
        steered = [(k, channel) for k, channel in enumerate(at) if channel is not None and channel not in dead]
        driven = [(k, channel) for k, channel in enumerate(channels.wheels) if channel not in dead]
        kinds = [
            _kind(robot, [(log, log.command) for log in logs if log.command is not None], driven),
            _kind(robot, [(log, log.steering_command) for log in logs if log.steering_command is not None], steered),
        ]
        self._kinds = [kind for kind in kinds if kind is not None]

    def share(self, reading: Reading) -> float:
        """Return the share of squares of the turns of wheels, and that of castors, in sum, as far as above `OBEYED`."""
        shares = (np.sum(left) / np.sum(whole) for left, whole in self._squares(reading))
        return sum(max(float(share) - OBEYED, 0.0) for share in shares)

    def each(self, reading: Reading) -> float:
        """Return the mean of the shares of all motors, however little some of them turn."""
        shares = [left / np.maximum(whole, TINY) for left, whole in self._squares(reading)]
        return float(np.mean(np.concatenate(shares))) if shares else 0.0

    def _squares(self, reading: Reading) -> Iterator[tuple[Array, Array]]:
        """Yield for wheels and for castors the sums of squares of the turns that each motor's encoder shows under a
        reading (c,): those that commands explain less than of another encoder, and all."""
        for kind in self._kinds:
            at = [reading.source.index(channel) for channel in kind.channels]
            backwards = [int(reading.gain[channel] < 0) for channel in at]
            least = np.min(kind.left[:, kind.channels], axis=(1, 2))
            left, whole = kind.left[np.arange(len(at)), at, backwards], kind.turned[at]
            yield np.maximum(left - least, 0.0) * whole, whole


class _Kind(NamedTuple):
    """What commands explain of turns.

    channels (c,): those of the motors. left (c, all channels, 2): the share of squares that each command leaves of the
    turns of each channel, forwards and backwards. turned (all channels,): these squares.
    """

    channels: list[int]
    left: Array
    turned: Array


def _kind(
    robot: RobotDescription, logs: Sequence[tuple[Log, Array]], columns: Sequence[tuple[int, int]]
) -> _Kind | None:
    """Return what commands (K, c), rad/s, explain of turns in logs; None if nothing was told, or nothing moved.

    columns: of a command, and the channel of its motor. A command is followed in any proportion above 0, as counts per
    turn may be wrong, and with any small delay.
    """
    parts = [_windows(robot, log, command[:, [k for k, _ in columns]]) for log, command in logs]
    if not parts or not columns:
        return None
    turned, told, changed = (np.concatenate(each) for each in zip(*parts, strict=True))
    seen = np.all(np.isfinite(told) & np.isfinite(changed), axis=1) & np.all(np.isfinite(turned), axis=1)
    turned, told, changed, channels = turned[seen], told[seen], changed[seen], [channel for _, channel in columns]
    if not np.any(turned[:, channels]) or not np.any(told):
        return None
    squares = np.sum(turned**2, axis=0)
    left = []
    for by in np.stack([told, changed], axis=-1).swapaxes(0, 1):
        followed = np.linalg.lstsq(by, turned, rcond=None)[0]
        unexplained = np.sum((turned - by @ followed) ** 2, axis=0)
        ways = [np.where(sign * followed[0] > 0, unexplained, squares) for sign in (1, -1)]
        left.append(np.stack(ways, axis=-1) / np.maximum(squares, TINY)[:, None])
    return _Kind(channels, np.array(left), squares)


def _windows(robot: RobotDescription, log: Log, command: Array) -> tuple[Array, Array, Array]:
    """Return turns (V, all channels) of a log, what was told (V, c), and how that changed, summed over windows."""
    driven, sensed = list(robot.driven_wheels), list(robot.pivot_encoders)
    per_wheel = np.array([robot.wheels[k].counts_per_rev or np.nan for k in driven])
    per_pivot = np.array([robot.castors[i].pivot_counts_per_rev or np.nan for i in sensed])
    angle = np.column_stack([log.wheel / per_wheel, unwrapped(log.pivot, per_pivot) / per_pivot]) * 2 * np.pi
    steps = np.diff(log.t)
    period = float(np.median(steps))
    told = np.where(steps > GAP * period, np.nan, steps)[:, None] * command[:-1]
    changed = np.diff(told, axis=0, prepend=told[:1])
    size = max(1, round(WINDOW / period))
    whole = len(told) // size * size
    turned, told, changed = (
        part[:whole].reshape(-1, size, part.shape[1]).sum(axis=1) for part in (np.diff(angle, axis=0), told, changed)
    )
    return turned, told, changed
