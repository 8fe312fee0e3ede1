"""How far wheels disagree, and what effects add to it: against robots that are described otherwise."""

import dataclasses
from functools import cache
from typing import Any

import numpy as np
import pytest

from castor_envs.effects.dimensions import Track, WheelRadius
from castor_envs.motion.kinematics import Geometry
from castor_envs.motion.trajectories import wander
from castor_envs.vehicles.presets import preset
from discrepancy.hypotheses.candidates import stacked
from discrepancy.posterior.linearise import linearise
from discrepancy.trials.pymunk_generator import drive
from estimators.likelihood.disagreement import LEAST, Disagreement

ROBOT = preset("asoc-prototype")


@cache
def log():
    return drive(ROBOT, wander(np.random.default_rng([3, 1]), duration=15.0), 3, duration=15.0)


@cache
def seen():
    return linearise(ROBOT, [log()])


def test_in_good_order_wheels_agree_but_for_what_rounding_leaves():
    (disagreement,) = seen().disagreements
    assert disagreement.scale.max() < 1.5 * LEAST
    assert np.abs(disagreement.beside([])).max() < 6


@pytest.mark.parametrize("effect", [WheelRadius(castor=1, wheel=1, value=1e-3), Track(castor=2, value=1e-3)])
def test_what_an_effect_adds_is_by_how_much_wheels_of_a_robot_with_it_disagree_less(effect):
    (design,) = seen().designs
    real, state, other = design.geometry, design.state, Geometry.of(ROBOT.with_effects(effect).as_built())
    before, after = (design.model.disagreement(geometry, state) for geometry in (real, other))
    changed = dataclasses.replace(
        design.changes,
        changed=stacked(real, [other]),
        change=np.array([effect.value]),
        readings=design.columns[0].only([]),
        slips=design.columns[1].only([]),
    )
    less = design.model.agreement_by(changed, slice(0, len(state) - 1))
    assert np.abs(before - after).max() > 1e-6
    np.testing.assert_allclose(effect.value * less[..., 0], before - after, atol=0.02 * np.abs(before - after).max())


def test_windows_beyond_what_is_usual_count_with_their_distance():
    (disagreement,) = seen().disagreements
    off = np.zeros_like(disagreement.seen)
    likely = []
    for far in (0.0, 1.0, 10.0, 20.0, 30.0):
        off[3, 0] = far * LEAST
        likely.append(dataclasses.replace(disagreement, seen=off.copy()).statistics()[2])
    independent = 1 - 3 / disagreement.seen.shape[1]  # rows: a motion of the body was fitted to them
    assert likely[0] - likely[1] == pytest.approx(0.5 * independent)
    assert likely[2] - likely[3] == pytest.approx(likely[3] - likely[4])


@pytest.mark.parametrize("correlation", [0.0, 0.9, 0.95])
def test_correlated_windows_have_the_density_of_their_process(correlation):
    """An autoregressive process: its density in closed form, by the covariance of all windows of a row."""
    (disagreement,) = seen().disagreements
    random, (count, rows) = np.random.default_rng(1), (200, disagreement.seen.shape[1])
    lag = np.abs(np.subtract.outer(np.arange(count), np.arange(count)))
    covariance = (20 * LEAST) ** 2 * correlation**lag
    off = np.linalg.cholesky(covariance) @ random.normal(size=(count, rows))
    none = np.zeros((0, disagreement.by_size.shape[2])), np.zeros((0, 0))
    quick = (*(0 * of for of in disagreement.quick[:2]), 0.0, *none)
    long = dataclasses.replace(
        disagreement,
        seen=off,
        shared=np.zeros((*off.shape, 0)),
        turned=np.zeros(off.shape),
        linked=np.minimum(np.arange(count), 1.0)[:, None] * np.ones(rows),
        by_size=np.ones((*off.shape, disagreement.by_size.shape[2]), dtype=np.float32),
        counted=np.ones(count, dtype=bool),
        quick=quick,
    )
    information, _, likely = long.statistics()
    independent = 1 - 3 / rows
    inverse = np.linalg.inv(covariance)
    density = -(rows * np.linalg.slogdet(covariance)[1] + np.sum(off * (inverse @ off))) / 2
    assert likely / independent == pytest.approx(density, abs=0.01 * off.size)  # the process is estimated, robustly
    assert information[0, 0] / independent == pytest.approx(rows * np.sum(inverse), rel=0.15)


def test_what_is_the_same_all_the_time_counts_less_than_what_is_new_in_each_window():
    """On a circle, wheels that disagree by ten times what rounding leaves, for 60 s: if each window were a measurement
    of its own, that would be exp(830) times less likely."""
    (disagreement,) = seen().disagreements
    count, rows = 60, disagreement.seen.shape[1]
    empty = np.zeros((count, rows))
    by_size = np.zeros((count, rows, disagreement.by_size.shape[2]), dtype=np.float32)
    noise, likely = LEAST * np.random.default_rng(2).normal(size=(count, rows)), []
    for constant in (0.0, 10 * LEAST):
        parts = {"seen": noise + constant, "shared": empty[..., None][..., :0], "turned": empty, "by_size": by_size}
        parts["linked"] = empty + np.minimum(np.arange(count), 1.0)[:, None]
        told = dataclasses.replace(disagreement, counted=np.ones(count, dtype=bool), **parts)
        likely.append(told.statistics()[2])
    independent = count * (rows - 3) * np.log(10)
    assert 0 < likely[0] - likely[1] < independent / 5


def test_what_each_row_may_disagree_by_counts_as_correlated_noise():
    """In closed form: a part of a pattern, normal with standard deviation 1, adds the pattern's outer product to the
    covariance of its row."""
    (disagreement,) = seen().disagreements
    plain = dataclasses.replace(disagreement, seen=np.zeros_like(disagreement.seen))
    pattern = np.random.default_rng(0).normal(size=plain.seen.shape) * 3 * LEAST
    rows = plain.seen.shape[1]
    none = np.zeros((rows, plain.by_size.shape[2])), np.zeros((rows, rows))
    by_row = pattern[..., None] * np.eye(rows)
    doubtful = dataclasses.replace(plain, shared=by_row, quick=(*plain.quick[:3], *none))
    (before, _, likely), (after, _, less_likely) = plain.statistics(), doubtful.statistics()
    count = before.shape[0] // 2
    independent = 1 - 3 / plain.seen.shape[1]
    lost, determinant = np.zeros((count, count)), 0.0
    for row in range(plain.seen.shape[1]):
        of_row = plain.by_size[:, row].astype(float)
        precision = np.eye(len(of_row)) * independent / plain.usual.size[:, row] ** 2
        covariance = np.linalg.inv(precision) + np.outer(pattern[:, row], pattern[:, row])
        lost += of_row.T @ (precision - np.linalg.inv(covariance)) @ of_row
        determinant += np.linalg.slogdet(covariance @ precision)[1]
    np.testing.assert_allclose((before - after)[:count, :count], lost, atol=1e-6 * np.abs(lost).max())
    assert likely - less_likely == pytest.approx(determinant / 2)


class Told:
    """A model of which the disagreement is told."""

    def __init__(self, model, disagreement):
        self._model, self._disagreement = model, disagreement

    def __getattr__(self, name):
        return getattr(self._model, name)

    def disagreement(self, *_):
        return self._disagreement


def test_rows_that_give_way_unequally_are_found_to_by_as_much():
    """Of a wheel that is described too large, so that it drags the others, 20 % more is left to be seen in the rows of
    one castor, 20 % less in the others: as the likeliest numbers of the rows say, and little is left."""
    (design,), (log_,) = seen().designs, (log(),)
    effect = WheelRadius(castor=1, wheel=1, value=0.05)
    geometry, state, model = Geometry.of(ROBOT.with_effects(effect).as_built()), design.state, design.model
    caused = model.disagreement(geometry, state) - model.disagreement(design.geometry, state)
    factor = np.where(np.arange(caused.shape[1]) < 2, 1.2, 0.8)
    left = model.disagreement(design.geometry, state) + 0.5 * factor * caused
    told: Any = Told(model, left)
    found = Disagreement.of(told, design.changes, log_.t, caused[..., None], np.zeros(caused.shape, dtype=bool))
    assert 0.4 < found.share < 0.6
    assert found.usual.size.max() < 2 * LEAST


def test_wheels_that_a_motor_turns_on_the_floor_may_disagree_more():
    """By the angle that they turn, which the log's encoders and reference give without any model."""
    robot = preset("powered-caster")
    turning = drive(robot, wander(np.random.default_rng([3, 1]), duration=10.0), 3, duration=10.0)
    (disagreement,) = linearise(robot, [turning], among=()).disagreements
    assert turning.reference is not None
    known = np.isfinite(turning.reference[:, 2])
    body = np.interp(turning.t, turning.t[known], np.unwrap(turning.reference[known, 2]))
    per_turn = float(robot.castors[0].pivot_counts_per_rev or 0)
    heading = body[:, None] + np.unwrap(turning.pivot, period=per_turn, axis=0) * 2 * np.pi / per_turn
    angle = np.abs(np.diff(heading[::10], axis=0)).sum(axis=0)  # of half a second, in which noise hardly counts
    way = np.add.reduceat(disagreement.way, np.cumsum(disagreement.steps) - disagreement.steps)
    shown = np.sum((disagreement.turned * way[:, None]) ** 2, axis=0)
    np.testing.assert_allclose(shown[disagreement.along], angle, rtol=0.1)
    steered, plain = 0.01 * disagreement.turned, np.full(disagreement.seen.shape, 1e-3)
    for size in (np.hypot(plain, steered), plain):
        seen = np.random.default_rng(0).normal(size=size.shape) * size
        noisy = dataclasses.replace(disagreement, seen=seen)
        assert np.sqrt(np.mean(noisy.beside([]) ** 2)) == pytest.approx(1.0, abs=0.15)
        assert np.median(noisy.usual.size / size) == pytest.approx(1.0, abs=0.3)


def test_what_contacts_slip_on_average_as_motors_turn_them_is_not_seen():
    """All contacts slip to the side by 1 mm for each rad that motors turn them, by angles that encoders tell."""
    robot = preset("powered-caster")
    turning = drive(robot, wander(np.random.default_rng([3, 1]), duration=20.0), 3, duration=20.0)
    (design,) = linearise(robot, [turning], among=()).designs
    model, geometry, state = design.model, design.geometry, design.state
    heading = state[:, 2:3] + model.counts[:, :4] * 2 * np.pi / np.array([4096.0])
    slips = np.concatenate([np.zeros((len(state) - 1, 4)), 1e-3 * np.diff(heading, axis=0)], axis=1)
    caused, none = slips - model.explained(geometry, state, slips), np.zeros(slips.shape)
    plain = model.disagreement(geometry, state)
    seen = []
    for disagreement in (plain, plain + caused):
        told: Any = Told(model, disagreement)
        seen.append(Disagreement.of(told, design.changes, turning.t, none[..., None], none > 0).seen)
    starts = np.arange(0, len(slips), 20)
    way = np.add.reduceat(np.abs(model.rolled(geometry, state)).max(axis=1), starts)[:, None]
    by_slip = np.add.reduceat(caused, starts, axis=0) / way
    assert np.sqrt(np.mean((seen[1] - seen[0]) ** 2)) < 0.1 * np.sqrt(np.mean(by_slip**2))


def test_wheels_that_are_driven_against_each_other_disagree_until_castors_turn():
    """A process that half a turn every ten windows ends and begins anew, five times as large: its density in closed
    form, by the covariance of all windows, within what robust estimates of its size and correlation lose."""
    (disagreement,) = seen().disagreements
    random, (count, rows), new = np.random.default_rng(1), (400, disagreement.seen.shape[1]), 1.5 * LEAST
    turns = np.arange(count) % 10 == 9
    kept = np.where(turns, 0.95 * np.exp(-np.pi), 0.95)
    sizes = np.where(turns, np.hypot(new, 5 * new / np.sqrt(1 - 0.95**2)), new)
    mixing = np.eye(count)
    for k in range(1, count):
        mixing[k, :k] = kept[k] * mixing[k - 1, :k]
    root = mixing * sizes
    off = root @ random.normal(size=(count, rows))
    none = np.zeros((0, disagreement.by_size.shape[2])), np.zeros((0, 0))
    told = dataclasses.replace(
        disagreement,
        seen=off,
        shared=np.zeros((*off.shape, 0)),
        turned=np.sqrt(np.pi) * turns[:, None] * np.ones(rows),
        linked=(np.arange(count) > 0)[:, None] * np.exp(-np.pi * turns)[:, None] * np.ones(rows),
        by_size=np.ones((*off.shape, disagreement.by_size.shape[2]), dtype=np.float32),
        counted=np.ones(count, dtype=bool),
        quick=(*(0 * of for of in disagreement.quick[:2]), 0.0, *none),
    )
    white = np.linalg.solve(root, off)
    density = -(rows * np.linalg.slogdet(root)[1] + np.sum(white**2) / 2)
    likely = told.statistics()[2] / (1 - 3 / rows)
    assert likely == pytest.approx(density, abs=0.05 * off.size)
    size = np.sqrt(np.sum(root**2, axis=1))
    assert np.median(told.usual.size / size[:, None]) == pytest.approx(1.0, abs=0.3)
    unlinked = dataclasses.replace(told, linked=np.zeros(off.shape)).statistics()[2] / (1 - 3 / rows)
    assert likely > unlinked + 0.3 * off.size


def test_a_robot_whose_wheels_cannot_contradict_each_other_has_none():
    robot = preset("differential")
    plain = drive(robot, wander(np.random.default_rng([3, 1]), duration=10.0, holonomic=False), 3, duration=10.0)
    (disagreement,) = linearise(robot, [plain]).disagreements
    assert np.abs(disagreement.seen).max() < 1e-9
    assert isinstance(disagreement, Disagreement)
