"""Chipmunk's step of bodies on joints, as far as vehicles need it: without collisions, with the same arithmetic.

Everything here is plain Python for numba to compile (`castor_envs.physics.compiled_loop`). The operations are those of
Chipmunk 7 (``cpSpaceStep``, ``cpPivotJoint.c``, ``cpSimpleMotor.c``, ``cpDampedRotarySpring.c``) in the same order, so
results are those of pymunk to the last bit wherever both are compiled without fused operations.

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

from castor_envs.geometry.arrays import Array
from castor_envs.kernels.select import where
from castor_envs.physics.trigonometry import cosine_and_sine

PIVOT, MOTOR, SPRING = 0, 1, 2

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
        # (N m s); of a spring its stiffness (N m/rad), its angle at rest, and the share of the rate that it damps
        ("inertia", float),
        ("rate", float),
        ("most", float),
        ("stiffness", float),
        ("rest", float),
        ("damped", float),
        # of the last step: impulse (of a motor or spring in x alone), arms on both bodies, inverse of the mass that a
        # pivot feels, wanted velocity
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
        else:
            raise TypeError(f"the solver knows no {type(joint).__name__}")
    return records


@lru_cache
def solving_order(joints: tuple[tuple[int, int, int], ...], iterations: int) -> NDArray[np.uint64]:
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
    return np.array([turn[2] for turn in sorted(turns)], dtype=np.uint64)


def places_ahead(motion: Array, ahead: float, places: Array) -> None:
    """Fill in where bodies are `ahead` seconds on: x, y, angle, and its cosine and sine, (b, 5)."""
    for i in range(len(motion)):
        angle = motion[i, 2] + ahead * motion[i, 5]
        places[i, 0] = motion[i, 0] + ahead * motion[i, 3]
        places[i, 1] = motion[i, 1] + ahead * motion[i, 4]
        places[i, 2] = angle
        places[i, 3], places[i, 4] = cosine_and_sine(angle)


def step_bodies(motion, inverse, joints, order, gravity_x, gravity_y, dt, loads, places):
    """Advance bodies by dt.

    motion (b, 6): x, y, angle, v_x, v_y, angular velocity. inverse (b, 2): of masses and inertias. order: of
    `solving_order`. loads (b, 3): forces and torques. places: of `places_ahead` by dt.
    """
    for i in range(len(motion)):
        motion[i, 0], motion[i, 1], motion[i, 2] = places[i, 0], places[i, 1], places[i, 2]
    for k in range(len(joints)):
        prepare(joints[k], motion, inverse, dt, places)
    for i in range(len(motion)):
        motion[i, 3] += (gravity_x + loads[i, 0] * inverse[i, 0]) * dt
        motion[i, 4] += (gravity_y + loads[i, 1] * inverse[i, 0]) * dt
        motion[i, 5] += loads[i, 2] * inverse[i, 1] * dt
    for k in range(len(joints)):
        joint = joints[k]
        if joint.kind == PIVOT:
            push(joint, motion, inverse, joint.impulse_x, joint.impulse_y)
        elif joint.kind == MOTOR:
            twist(joint, motion, inverse, joint.impulse_x)
    for k in range(len(order)):
        joint = joints[order[k]]
        if joint.kind == PIVOT:
            hold(joint, motion, inverse)
        elif joint.kind == MOTOR:
            rate = motion[joint.b, 5] - motion[joint.a, 5] + joint.rate
            before = joint.impulse_x
            wanted = before - rate * joint.inertia
            wanted = where(wanted < -joint.most, -joint.most, wanted)
            joint.impulse_x = where(wanted > joint.most, joint.most, wanted)
            twist(joint, motion, inverse, joint.impulse_x - before)
        else:
            rate = motion[joint.a, 5] - motion[joint.b, 5]
            braked = (joint.wanted_x - rate) * joint.damped
            joint.wanted_x = rate + braked
            before = joint.impulse_x
            change = before - (before - braked * joint.inertia)
            joint.impulse_x = before - change
            twist(joint, motion, inverse, -change)


def prepare(joint, motion, inverse, dt, places):
    """Find a joint's arms and masses for a step; a spring turns its bodies."""
    a, b = joint.a, joint.b
    if joint.kind == SPRING:
        torque = (motion[a, 2] - motion[b, 2] - joint.rest) * joint.stiffness
        joint.impulse_x, joint.wanted_x = torque * dt, 0.0
        twist(joint, motion, inverse, joint.impulse_x)
    elif joint.kind == PIVOT:
        c, s = places[a, 3], places[a, 4]
        a_x, a_y = c * joint.a_x - s * joint.a_y, s * joint.a_x + c * joint.a_y
        c, s = places[b, 3], places[b, 4]
        b_x, b_y = c * joint.b_x - s * joint.b_y, s * joint.b_x + c * joint.b_y
        mass, inertia_a, inertia_b = inverse[a, 0] + inverse[b, 0], inverse[a, 1], inverse[b, 1]
        xx = mass + a_y * a_y * inertia_a + b_y * b_y * inertia_b
        yy = mass + a_x * a_x * inertia_a + b_x * b_x * inertia_b
        xy = -a_x * a_y * inertia_a + -b_x * b_y * inertia_b
        inverse_determinant = 1.0 / (xx * yy - xy * xy)
        joint.mass_xx, joint.mass_yy = yy * inverse_determinant, xx * inverse_determinant
        joint.mass_xy = -xy * inverse_determinant
        joint.wanted_x = (motion[b, 0] + b_x - (motion[a, 0] + a_x)) * joint.closing
        joint.wanted_y = (motion[b, 1] + b_y - (motion[a, 1] + a_y)) * joint.closing
        joint.arm_a_x, joint.arm_a_y, joint.arm_b_x, joint.arm_b_y = a_x, a_y, b_x, b_y


def twist(joint, motion, inverse, impulse):
    """Turn the second body by an impulse (N m s), and the first one back."""
    motion[joint.a, 5] -= impulse * inverse[joint.a, 1]
    motion[joint.b, 5] += impulse * inverse[joint.b, 1]


def push(joint, motion, inverse, x, y):
    """Push the second body by an impulse (N s) at a pivot, and the first one back."""
    a, b = joint.a, joint.b
    motion[a, 3] -= x * inverse[a, 0]
    motion[a, 4] -= y * inverse[a, 0]
    motion[a, 5] += inverse[a, 1] * (joint.arm_a_y * x - joint.arm_a_x * y)
    motion[b, 3] += x * inverse[b, 0]
    motion[b, 4] += y * inverse[b, 0]
    motion[b, 5] += inverse[b, 1] * (joint.arm_b_x * y - joint.arm_b_y * x)


def hold(joint, motion, inverse):
    """Correct the velocities of a pivot's bodies so that it stays together."""
    a, b = joint.a, joint.b
    spin_a, spin_b = motion[a, 5], motion[b, 5]
    x = motion[b, 3] - joint.arm_b_y * spin_b - (motion[a, 3] - joint.arm_a_y * spin_a)
    y = motion[b, 4] + joint.arm_b_x * spin_b - (motion[a, 4] + joint.arm_a_x * spin_a)
    x, y = joint.wanted_x - x, joint.wanted_y - y
    before_x, before_y = joint.impulse_x, joint.impulse_y
    joint.impulse_x = before_x + (joint.mass_xx * x + joint.mass_xy * y)
    joint.impulse_y = before_y + (joint.mass_xy * x + joint.mass_yy * y)
    push(joint, motion, inverse, joint.impulse_x - before_x, joint.impulse_y - before_y)
