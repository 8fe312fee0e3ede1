"""The loop over the substeps of a sample period, to be compiled: wheel forces, and the bodies on their joints.

Imported to be compiled only (`castor_envs.kernels`).
"""

from typing import Any

from numba.extending import register_jitable

from castor_envs.physics import solver, tyre
from castor_envs.physics.solver import places_ahead, step_bodies
from castor_envs.physics.tyre import wheel_forces

_WHEELS = tyre.friction_at, tyre.rise_between, tyre.slack_on_circle, tyre.turn_wheel, tyre.contact_at, wheel_forces
_BODIES = places_ahead, step_bodies, solver.prepare, solver.twist, solver.push, solver.hold
for _law in (*_WHEELS, *_BODIES):
    register_jitable(_law)


def advance(
    worlds: Any,
    motion: Any,
    inverse: Any,
    joints: Any,
    order: Any,
    wheels: Any,
    patches: Any,
    cables: Any,
    loads: Any,
    middle: Any,
    end: Any,
) -> None:
    """Run the substeps of a sample period of all worlds, one after the other.

    worlds (n,): records (`castor_envs.physics.stepper.WORLD`), which say what rows of all others are theirs.
    """
    for n in range(len(worlds)):
        w = worlds[n]
        bodies = motion[w.body : w.body_end]
        masses, on = inverse[w.body : w.body_end], joints[w.joint : w.joint_end]
        turns, rolling = order[w.turn : w.turn_end], wheels[w.wheel : w.wheel_end]
        slippery, rough = patches[w.patch : w.patch_end], cables[w.cable : w.cable_end]
        forces = loads[w.body : w.body_end]
        halfway, after = middle[w.body : w.body_end], end[w.body : w.body_end]
        for _ in range(w.substeps):
            places_ahead(bodies, 0.5 * w.dt, halfway)
            places_ahead(bodies, w.dt, after)
            wheel_forces(bodies, halfway, after, rolling, slippery, rough, w.climbing, w.dt, forces)
            step_bodies(bodies, masses, on, turns, w.gravity_x, w.gravity_y, w.dt, forces, after)
