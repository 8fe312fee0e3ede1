"""Chipmunk's step of bodies on joints, as far as vehicles need it: without collisions.

Everything here is plain Python for numba to compile (`castor_envs.physics.compiled_loop`), for one world or for lanes
of them. The method is that of Chipmunk 7 (``cpSpaceStep``, ``cpPivotJoint.c``, ``cpSimpleMotor.c``,
``cpDampedRotarySpring.c``), impulse by impulse in the same order; results differ from pymunk's by rounding.

A step moves the bodies, lets springs and forces change their velocities, and then corrects the velocities joint by
joint, by impulses that are remembered for the next step, `iterations` times (a projected Gauss-Seidel method).
"""

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
import pymunk
from numpy.typing import NDArray
from pymunk.constraints import Constraint, DampedRotarySpring, PivotJoint, SimpleMotor

from castor_envs.kernels.select import where
from castor_envs.kernels.trigonometry import cosine_and_sine

PIVOT, MOTOR, SPRING = 0, 1, 2

# Of each body its centre of mass in N, its heading, and their rates; where it is ahead of that; the inverse of its mass
# and of its moment of inertia; what force and torque it feels.
BODY = np.dtype([(name, float) for name in ("x", "y", "angle", "v_x", "v_y", "spin")])
PLACE = np.dtype([(name, float) for name in ("x", "y", "angle", "cos", "sin")])
INVERSE = np.dtype([(name, float) for name in ("mass", "inertia")])
LOAD = np.dtype([(name, float) for name in ("x", "y", "torque")])

JOINT = np.dtype(
    [
        # the two bodies; of a pivot its place on them, and what share of a gap is closed, a second
        ("kind", np.int64),
        ("a", np.uint64),
        ("b", np.uint64),
        ("a_x", float),
        ("a_y", float),
        ("b_x", float),
        ("b_y", float),
        ("closing", float),
        # of a motor and a spring: the inertia between bodies; of a motor its rate (rad/s) and greatest impulse
        # (N m s); of a spring its stiffness (N m/rad), its angle at rest, the share of the rate that it damps, and by
        # what shares of it both bodies are braked
        ("inertia", float),
        ("rate", float),
        ("most", float),
        ("stiffness", float),
        ("rest", float),
        ("damped", float),
        ("braking_a", float),
        ("braking_b", float),
        # of the last step: impulse (of a motor in x alone); of a pivot its arms on both bodies, and the inverse of
        # the mass that it feels; wanted velocity
        ("impulse_x", float),
        ("impulse_y", float),
        ("arm_a_x", float),
        ("arm_a_y", float),
        ("arm_b_x", float),
        ("arm_b_y", float),
        ("mass_xx", float),
        ("mass_xy", float),
        ("mass_yy", float),
        ("wanted_x", float),
        ("wanted_y", float),
    ],
    align=True,
)


def joint_records(bodies: Sequence[pymunk.Body], joints: Sequence[Constraint], dt: float) -> NDArray[np.void]:
    """Return a record for each joint between the bodies, for steps of dt (s)."""
    number = {body.id: i for i, body in enumerate(bodies)}
    records = np.zeros(len(joints), dtype=JOINT)
    for record, joint in zip(records, joints, strict=True):
        a, b = joint.a, joint.b
        record["a"], record["b"] = number[a.id], number[b.id]
        inverse_inertia = 1.0 / a.moment + 1.0 / b.moment
        record["inertia"] = 1.0 / inverse_inertia
        if isinstance(joint, PivotJoint):
            record["kind"] = PIVOT
            record["a_x"], record["a_y"] = joint.anchor_a
            record["b_x"], record["b_y"] = joint.anchor_b
            record["closing"] = -(1.0 - joint.error_bias**dt) / dt
        elif isinstance(joint, SimpleMotor):
            record["kind"] = MOTOR
        elif isinstance(joint, DampedRotarySpring):
            record["kind"], record["stiffness"], record["rest"] = SPRING, joint.stiffness, joint.rest_angle
            record["damped"] = 1.0 - math.exp(-joint.damping * dt * inverse_inertia)
            record["braking_a"], record["braking_b"] = (
                record["damped"] * record["inertia"] / body.moment for body in (a, b)
            )
        else:
            raise TypeError(f"the solver knows no {type(joint).__name__}")
    return records


@lru_cache
def solving_order(joints: tuple[tuple[int, int, int], ...], iterations: int) -> NDArray[np.uint16]:
    """Return joints, by their indices, in an order in which a step may correct velocities; not to be changed.

    As `iterations` times one joint after the other, but what waits for nothing comes first: along a chain, the next
    iteration starts at one end while the last is still on its way to the other. Joints that share a body keep their
    order, so results are the same to the last bit, and the processor has several joints to work on at once.

    joints: of each its kind and its two bodies.
    """
    ready: dict[int, int] = {}
    turns = []
    for turn in range(iterations * len(joints)):
        kind, *ends = joints[turn % len(joints)]
        level = max(ready.get(end, 0) for end in ends)
        ready.update(dict.fromkeys(ends, level + 1))
        turns.append((level, kind, turn % len(joints)))
    return np.array([turn[2] for turn in sorted(turns)], dtype=np.uint16)


def places_ahead(bodies, ahead, places):
    """Fill in where bodies (b,) are `ahead` seconds on."""
    for i in range(len(bodies)):
        body, place = bodies[i], places[i]
        place.x, place.y = body.x + ahead * body.v_x, body.y + ahead * body.v_y
        place.angle = body.angle + ahead * body.spin
        place.cos, place.sin = cosine_and_sine(place.angle)


def step_bodies(bodies, inverse, joints, order, gravity_x, gravity_y, dt, loads, places):
    """Advance bodies (b,) by dt. order: of `solving_order`. places: of `places_ahead` by dt."""
    for i in range(len(bodies)):
        body, place = bodies[i], places[i]
        body.x, body.y, body.angle = place.x, place.y, place.angle
    for k in range(len(joints)):
        prepare(joints[k], bodies, inverse, dt, places)
    for i in range(len(bodies)):
        body, load, its = bodies[i], loads[i], inverse[i]
        body.v_x += (gravity_x + load.x * its.mass) * dt
        body.v_y += (gravity_y + load.y * its.mass) * dt
        body.spin += load.torque * its.inertia * dt
    for k in range(len(joints)):
        joint = joints[k]
        if joint.kind == PIVOT:
            push(joint, bodies, inverse, joint.impulse_x, joint.impulse_y)
        elif joint.kind == MOTOR:
            twist(joint, bodies, inverse, joint.impulse_x)
    for k in range(len(order)):
        joint = joints[order[k]]
        if joint.kind == PIVOT:
            hold(joint, bodies, inverse)
        elif joint.kind == MOTOR:
            rate = bodies[joint.b].spin - bodies[joint.a].spin + joint.rate
            before = joint.impulse_x
            wanted = before - rate * joint.inertia
            wanted = where(wanted < -joint.most, -joint.most, wanted)
            joint.impulse_x = where(wanted > joint.most, joint.most, wanted)
            twist(joint, bodies, inverse, joint.impulse_x - before)
        else:
            a, b = bodies[joint.a], bodies[joint.b]
            spin_a, spin_b = a.spin, b.spin
            braked = joint.wanted_x - (spin_a - spin_b)
            a.spin, b.spin = spin_a + braked * joint.braking_a, spin_b - braked * joint.braking_b
            joint.wanted_x = spin_a - spin_b + braked * joint.damped


def prepare(joint, bodies, inverse, dt, places):
    """Find a joint's arms and masses for a step; a spring turns its bodies."""
    a, b = bodies[joint.a], bodies[joint.b]
    if joint.kind == SPRING:
        torque = (a.angle - b.angle - joint.rest) * joint.stiffness
        joint.wanted_x = 0.0
        twist(joint, bodies, inverse, torque * dt)
    elif joint.kind == PIVOT:
        place = places[joint.a]
        a_x, a_y = place.cos * joint.a_x - place.sin * joint.a_y, place.sin * joint.a_x + place.cos * joint.a_y
        place = places[joint.b]
        b_x, b_y = place.cos * joint.b_x - place.sin * joint.b_y, place.sin * joint.b_x + place.cos * joint.b_y
        inertia_a, inertia_b = inverse[joint.a].inertia, inverse[joint.b].inertia
        mass = inverse[joint.a].mass + inverse[joint.b].mass
        xx = mass + a_y * a_y * inertia_a + b_y * b_y * inertia_b
        yy = mass + a_x * a_x * inertia_a + b_x * b_x * inertia_b
        xy = -a_x * a_y * inertia_a + -b_x * b_y * inertia_b
        inverse_determinant = 1.0 / (xx * yy - xy * xy)
        joint.mass_xx, joint.mass_yy = yy * inverse_determinant, xx * inverse_determinant
        joint.mass_xy = -xy * inverse_determinant
        joint.wanted_x = (b.x + b_x - (a.x + a_x)) * joint.closing
        joint.wanted_y = (b.y + b_y - (a.y + a_y)) * joint.closing
        joint.arm_a_x, joint.arm_a_y, joint.arm_b_x, joint.arm_b_y = a_x, a_y, b_x, b_y


def twist(joint, bodies, inverse, impulse):
    """Turn the second body by an impulse (N m s), and the first one back."""
    bodies[joint.a].spin -= impulse * inverse[joint.a].inertia
    bodies[joint.b].spin += impulse * inverse[joint.b].inertia


def push(joint, bodies, inverse, x, y):
    """Push the second body by an impulse (N s) at a pivot, and the first one back.

    All is read before anything is written: a compiler must take every body for any other's memory.
    """
    a, b, its_a, its_b = bodies[joint.a], bodies[joint.b], inverse[joint.a], inverse[joint.b]
    a_x, a_y = a.v_x - x * its_a.mass, a.v_y - y * its_a.mass
    b_x, b_y = b.v_x + x * its_b.mass, b.v_y + y * its_b.mass
    spin_a = a.spin + its_a.inertia * (joint.arm_a_y * x - joint.arm_a_x * y)
    spin_b = b.spin + its_b.inertia * (joint.arm_b_x * y - joint.arm_b_y * x)
    a.v_x, a.v_y, a.spin = a_x, a_y, spin_a
    b.v_x, b.v_y, b.spin = b_x, b_y, spin_b


def hold(joint, bodies, inverse):
    """Correct the velocities of a pivot's bodies so that it stays together."""
    a, b = bodies[joint.a], bodies[joint.b]
    x = b.v_x - joint.arm_b_y * b.spin - (a.v_x - joint.arm_a_y * a.spin)
    y = b.v_y + joint.arm_b_x * b.spin - (a.v_y + joint.arm_a_x * a.spin)
    x, y = joint.wanted_x - x, joint.wanted_y - y
    x, y = joint.mass_xx * x + joint.mass_xy * y, joint.mass_xy * x + joint.mass_yy * y
    push(joint, bodies, inverse, x, y)
    joint.impulse_x += x
    joint.impulse_y += y
