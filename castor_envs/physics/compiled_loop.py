"""The loop over the substeps of a sample period, to be compiled: wheel forces, and the bodies on their joints."""

from typing import Any

from castor_envs.kernels.select import any_of, where
from castor_envs.physics.solver import places_ahead, step_bodies
from castor_envs.physics.tyre import wheel_forces


def advance(
    world: Any,
    bodies: Any,
    inverse: Any,
    joints: Any,
    order: Any,
    wheels: Any,
    patches: Any,
    cables: Any,
    loads: Any,
    middle: Any,
    end: Any,
    state: Any,
    kept: Any,
) -> None:
    """Run the substeps of a sample period of a world: one record (`castor_envs.physics.stepper.WORLD`).

    loads, middle and end (b,), kept (s,): scratch. state (s,): what bodies, joints and wheels are views of.
    Lanes with fewer substeps than others run on with them; their state is kept when they are done, and put back.
    """
    w = world[0]
    for step in range(w.substeps):
        places_ahead(bodies, 0.5 * w.dt, middle)
        places_ahead(bodies, w.dt, end)
        wheel_forces(bodies, middle, end, wheels, patches, cables, w.climbing, w.dt, loads)
        step_bodies(bodies, inverse, joints, order, w.gravity_x, w.gravity_y, w.dt, loads, end)
        if w.fewest <= step + 1 and w.fewest < w.substeps:
            done = w.own_substeps == 1.0 + step
            if any_of(done):
                for i in range(len(state)):
                    kept[i] = where(done, state[i], kept[i])
    if w.fewest < w.substeps:
        for i in range(len(state)):
            state[i] = kept[i]
