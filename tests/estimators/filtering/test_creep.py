"""The creep of contacts in a sample: forces balance, and it is that of the simulation."""

import dataclasses

import numpy as np
import pytest

from castor_envs.motion.kinematics import Geometry, constraint_matrix
from castor_envs.physics.robot_world import RobotWorld
from castor_envs.vehicles.presets import preset
from estimators import CalibratingFilter
from estimators.filtering.creep import (
    ARM,
    CREEP,
    FREE_X,
    HOLD,
    OF_CASTOR,
    ROWS,
    SCALE,
    TWIST,
    YIELD,
    crept,
    forced,
    timed,
    yields,
)
from estimators.steps.rolling_equations import swivelled

PERIOD = 0.05


class Contacts:
    """What kernels work on: of the prototype, its castors at odd angles, contacts yielding as drawn."""

    def __init__(self, robot=None):
        self.robot = robot or preset("asoc-prototype")
        estimator = CalibratingFilter()
        estimator.reset(self.robot, np.zeros(3))
        parts = estimator._stack.parts
        self.castors, self.carried, self.wheels, self.rows = (
            part.reshape(1, -1).view(np.recarray) for part in parts[:4]
        )
        self.chassis = parts[12].reshape(1, -1).view(np.recarray)
        self.chassis["grip"] = np.inf  # yielding by metres, contacts would not bear what accelerates
        n, m = self.carried.shape[1], self.rows.shape[1]
        self.found, self.held, self.small = np.zeros((ROWS, m)), np.zeros((OF_CASTOR, n)), np.zeros((4, 3))
        self.before, self.found[SCALE] = np.zeros(3 + 2 * n + 2 * n), 1.0

    def turn(self, before, after):
        """Let castors swivel from angles (n,) to angles, rad; their contacts are in the order of the filter's."""
        for angle in (before, after):
            swivelled(self.castors, 0, np.array([angle]) / (2 * np.pi) * 5143, 0.5)
        by_body, by_castor = constraint_matrix(Geometry.of(self.robot), (np.asarray(before) + after) / 2)
        kept = [0, 1, 2, 3, 4, 5, 6, 8, 10]  # one side of each castor
        self.moves, self.found[ARM] = by_body[kept].T.copy(), -by_castor[kept]

    def creep(self, along, across, turn):
        """The creep (m,) under forces in a sample of this motion, after that `before`."""
        body = self.castors, self.carried, self.chassis, self.rows, 0, along, across, turn
        forced(*body, self.before, 0, self.moves, self.found, self.held, self.small)
        return self.found[CREEP].copy()


@pytest.fixture(name="contacts")
def _contacts():
    drawn = np.random.default_rng(4)
    contacts = Contacts()
    contacts.turn([0.3, -1.2, 2.0], [0.35, -1.15, 1.9])
    contacts.found[YIELD] = np.exp(drawn.standard_normal(9))
    contacts.before[:9] = 0.01 * drawn.standard_normal(9)
    return contacts


@pytest.fixture(name="straight")
def _straight():
    """Contacts of a robot that drives straight ahead, its castors trailing."""
    contacts = Contacts()
    contacts.turn([0.0, 0.0, 0.0], [0.0, 0.0, 0.0])
    return contacts


def test_at_even_speed_samples_of_any_length_make_no_contact_creep(straight):
    straight.found[YIELD] = 0.01
    straight.creep(0.01, 0.0, 0.0)
    last = 1.0
    for lasts in (1.4, 0.6, 2.0, 1.0):
        straight.chassis["longer"] = lasts / last
        np.testing.assert_allclose(straight.creep(0.01 * lasts, 0.0, 0.0), 0.0, atol=1e-15)
        last = lasts


def test_time_stamps_say_how_long_samples_are(straight):
    """Of samples that last 1, 1.4 and 0.6 nominal periods; the first has none before it, the last no later stamp."""
    clock, found = np.array([[-np.inf, -np.inf, PERIOD, PERIOD]]), []
    for time in (1.0, 1.0 + 1.4 * PERIOD, 1.0 + 2.0 * PERIOD, 1.0 + 2.0 * PERIOD):
        clock[0, 0] = time
        timed(straight.chassis, clock, 0)
        found.append((straight.chassis["longer"][0, 0], straight.chassis["quicker"][0, 0]))
    expected = [(1.0, 1.0), (1.4, 2 / 1.4 / 2.4), (0.6 / 1.4, 2 / 0.6 / 2.0), (1 / 0.6, 2 / 1.6)]
    np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_a_force_is_a_mass_times_a_change_of_speed_whatever_the_samples_are(straight):
    """From 0.2 to 0.21 m/s, in two samples of 0.05 s, or the second of 0.1 s: within the time between their middles."""
    straight.found[YIELD], forces = 0.01, []
    for lasts in (1.0, 2.0):
        straight.chassis["longer"], straight.chassis["quicker"] = 1.0, 1.0
        straight.before[:] = 0.0
        straight.creep(0.01, 0.0, 0.0)
        straight.chassis["longer"], straight.chassis["quicker"] = lasts, 2 / (lasts * (lasts + 1))
        forces.append(straight.creep(0.0105 * lasts, 0.0, 0.0)[0])
    assert forces[0] == pytest.approx(1.5 * forces[1], rel=1e-9)


def test_noise_of_samples_moves_no_contact_in_the_end(straight):
    """Each sample's noise accelerates and slows down again. With the way of the later sample alone contacts would creep
    forward by a tenth of what they creep to and fro."""
    ways = 0.01 * (1 + 0.1 * np.random.default_rng(2).standard_normal(400))
    ways[0] = ways[-1] = 0.01
    per_count = straight.wheels["radius"][0, 0] * straight.wheels["count"][0, 0]
    found = []
    for way in ways:
        counts = np.full((1, 6), way / per_count)
        of_robot = straight.carried, straight.wheels, straight.rows, 0
        yields(*of_robot, counts, straight.chassis, straight.before, straight.found)
        found.append(straight.creep(way, 0.0, 0.0)[:6])
    crept = np.array(found[1:])  # the first sample starts from rest
    assert np.all(np.abs(crept.sum(axis=0)) < 1e-4 * np.abs(crept).sum(axis=0))


def held_by(contacts, castor):
    """By how much contacts (m,) move for a swivel of a castor."""
    return np.where(contacts.rows[0].castor == castor, -contacts.found[ARM], 0.0)


def test_forces_bear_what_accelerates_and_twist_no_castor(contacts):
    """A body of mass alone, in its origin: the contacts' forces are mass times acceleration, without any moment."""
    for part in (contacts.carried["mass"], contacts.carried["inertia"], contacts.chassis["inertia"]):
        part[...] = 0.0
    contacts.before[:] = 0.0
    creep = contacts.creep(0.01, 0.02, 0.0)
    force = -creep / contacts.found[YIELD]
    mass = contacts.chassis["mass"][0, 0]
    np.testing.assert_allclose(contacts.moves @ force, mass * np.array([0.01, 0.02, 0.0]), atol=1e-9 * mass)
    for castor in range(3):
        assert held_by(contacts, castor) @ force == pytest.approx(0.0, abs=1e-12)


def test_a_castor_is_twisted_by_what_turns_it(contacts):
    creep = contacts.creep(0.01, 0.02, 0.03)
    force = -creep / contacts.found[YIELD]
    for castor in range(3):
        assert held_by(contacts, castor) @ force == pytest.approx(contacts.held[TWIST, castor], rel=1e-9)
    assert (contacts.held[HOLD] > 0.0).all()


def test_a_motion_that_goes_on_needs_no_force(contacts):
    """Castors in line with a straight way: the second sample of it makes no contact creep."""
    contacts.turn([0.0, 0.0, 0.0], [0.0, 0.0, 0.0])
    contacts.creep(0.01, 0.0, 0.0)
    np.testing.assert_allclose(contacts.creep(0.01, 0.0, 0.0), 0.0, atol=1e-15)


def test_creep_that_nobody_knows_balances_but_for_slip_of_the_whole_robot(contacts):
    """Its forces are neither on castors nor, beyond the slip G G' / M, on the body."""
    contacts.creep(0.01, 0.02, 0.03)
    covariance, inverse = np.zeros((9, 9)), np.zeros((4, 3))
    of_castors = contacts.held, contacts.small, inverse
    crept(covariance, 0, contacts.rows, 0, 1.0, contacts.moves, contacts.found, *of_castors)
    whole = contacts.moves.T @ inverse[:3] @ contacts.moves
    left = covariance - whole
    np.testing.assert_allclose(left, left.T, atol=1e-15)
    assert np.linalg.eigvalsh(left).min() > -1e-9
    assert np.linalg.matrix_rank(left, tol=1e-9) == 3  # nine contacts, three motions of the body, three castors
    by_force = left / contacts.found[YIELD]
    np.testing.assert_allclose(by_force @ contacts.moves.T, 0.0, atol=1e-9)
    for castor in range(3):
        np.testing.assert_allclose(by_force @ held_by(contacts, castor), 0.0, atol=1e-9)
    free = contacts.moves.T + np.array(
        [
            contacts.found[ARM, i] * contacts.held[:3, row.castor] / contacts.held[HOLD, row.castor]
            for i, row in enumerate(contacts.rows[0])
        ]
    )
    np.testing.assert_allclose(contacts.found[FREE_X:], free.T, atol=1e-12)


def test_it_is_the_creep_of_the_simulation():
    """The prototype starts with castors in line: wheels creep by their way times acceleration over stiffness."""
    robot, acceleration = preset("asoc-prototype"), 0.4
    world = RobotWorld(robot, twist=(0.1, 0.0, 0.0))
    contacts, radius = Contacts(robot), robot.wheels[0].radius
    contacts.turn([0.0, 0.0, 0.0], [0.0, 0.0, 0.0])
    seen, expected, speed, x = [], [], 0.1, 0.0
    for k in range(20):
        before = world.wheel_angles[0]
        speed += acceleration * PERIOD
        world.advance(np.full(6, speed / radius))
        moved, x = world.pose[0] - x, world.pose[0]
        rolled = radius * (world.wheel_angles[0] - before)
        contacts.found[YIELD] = rolled * np.repeat([1.0, 0.5], [6, 3])
        crept_by = contacts.creep(moved, 0.0, 0.0)
        if k >= 10:
            seen.append(moved - rolled)
            expected.append(crept_by)
    np.testing.assert_allclose(np.array(expected)[:, 0], seen, rtol=0.02)
    by_hand = -speed * PERIOD * acceleration / (robot.contact.slip_stiffness_long * 9.80665)
    assert seen[-1] == pytest.approx(by_hand, rel=0.05)


def test_softer_contacts_creep_more(contacts):
    """Half the stiffness, twice the creep under the same acceleration."""
    soft = dataclasses.replace(contacts.robot.contact, slip_stiffness_long=40.0, slip_stiffness_lat=40.0)
    other = Contacts(dataclasses.replace(contacts.robot, contact=soft))
    other.turn([0.3, -1.2, 2.0], [0.35, -1.15, 1.9])
    other.found[YIELD], other.before[:] = contacts.found[YIELD], contacts.before
    np.testing.assert_allclose(other.creep(0.01, 0.02, 0.03), 2.0 * contacts.creep(0.01, 0.02, 0.03), rtol=1e-9)


def test_no_contact_bears_more_than_its_friction(contacts):
    contacts.chassis["grip"] = 1e-3
    most = 1e-3 * contacts.found[YIELD] * contacts.rows["contacts"][0]
    for motion in ((0.02, -0.01, 0.03), (1.0, 2.0, -1.0), (-50.0, 0.0, 9.0)):
        assert np.all(np.abs(contacts.creep(*motion)) <= most)
    np.testing.assert_allclose(np.abs(contacts.creep(100.0, 90.0, 50.0)), most)


def test_stamps_of_a_burst_are_a_period_apart(straight):
    """Five at once, then the next when it is due; and a clock that was set back tells nothing."""
    clock = np.array([[-np.inf, -np.inf, PERIOD, PERIOD]])
    for time in (1.0, 1.0001, 1.0002, 1.0003, 1.0004, 1.0 + 5 * PERIOD, 0.2, 0.2 + PERIOD):
        clock[0, 0] = time
        timed(straight.chassis, clock, 0)
        assert straight.chassis["longer"][0, 0] == pytest.approx(1.0)
        assert straight.chassis["gap"][0, 0] == 0.0
