"""The loop over the substeps of a sample period, to be compiled: wheel forces, and the bodies on their joints."""

from typing import Any

from castor_envs.physics.solver import places_ahead, step_bodies
from castor_envs.physics.tyre import wheel_forces


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
