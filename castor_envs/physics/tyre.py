"""The wheel force law. The one home of contact physics.

Everything here is plain Python that numba also compiles: `castor_envs.physics.stepper` runs `wheel_forces` as it stands
(reference) or inside `castor_envs.physics.compiled_loop`, for one world or for lanes of them. What may differ between
lanes, all reals, is chosen by `where`, not by `if`.

A wheel touches the floor through bristles (a single-point brush tyre with relaxation length; Pacejka, *Tire
and Vehicle Dynamics*, ch. 7). With slip velocity s = contact velocity - tread velocity, rolling speed V = |r
omega| and bristle deflection z,

    dz/dt = s - (V / sigma + k y) z          F = -k z - c dz/dt          |F| <= friction * load

so at rest the contact is a spring (no creep), in steady rolling F = -k sigma s / V (slip in proportion to
force, with slip stiffness k sigma), and beyond the friction circle the bristles slide. A contact that yields
by y (m/s for each N) lets its bristles go at y k z more, so that at rest s = -y F. Each substep is implicit
in z and in the wheel's spin.

On a cable the centre of the wheel rises by h(p), p the distance in plan from the cable's axis: the wheel
rolls sqrt(1 + h'^2) times its plan path and, by virtual work, pays the climbing force -load * grad h.
"""

import math

import numpy as np

from castor_envs.kernels.select import any_of, where

OFF, SERVO, VOLTAGE = 0, 1, 2
STANDARD, OMNI = 0, 1

WHEEL = np.dtype(
    [
        # where: body index, contact point in the body's frame (from its centre of mass), rolling direction there
        ("body", np.uint64),
        ("x", float),
        ("y", float),
        ("cos", float),
        ("sin", float),
        # what: radius, spin inertia, load, grip, bristles (stiffness k and damping c along and across), sigma, y
        ("radius", float),
        ("inertia", float),
        ("load", float),
        ("grip", np.int64),
        ("roller", float),
        ("friction", float),
        ("stiffness_long", float),
        ("stiffness_lat", float),
        ("damping_long", float),
        ("damping_lat", float),
        ("relaxation", float),
        ("creep_compliance", float),
        # motor: mode, gains, limits, command (rad/s; as voltage, a fraction of the full one)
        ("drive", np.int64),
        ("proportional", float),
        ("integral_gain", float),
        ("max_torque", float),
        ("max_speed", float),
        ("command", float),
        # state: angle, spin, servo integral, bristle deflections
        ("angle", float),
        ("speed", float),
        ("integral", float),
        ("stretch_long", float),
        ("stretch_lat", float),
        # of the last substep: force on the wheel (along, across), friction limit, motor torque, rise on a
        # cable
        ("force_long", float),
        ("force_lat", float),
        ("limit", float),
        ("torque", float),
        ("rise", float),
        # what the above make of a substep's length dt (`for_substeps`): dt / sigma; along and across c / dt,
        # k + c / dt, 1 over it, and dt k y
        ("relaxing", float),
        ("damped_long", float),
        ("damped_lat", float),
        ("stiff_long", float),
        ("stiff_lat", float),
        ("giving_long", float),
        ("giving_lat", float),
        ("yielding_long", float),
        ("yielding_lat", float),
    ],
    align=True,
)
CLOSE = 1e-6
"""A step of Newton's method, as a share of what it steps, after which the error, its square, is rounding."""
NO_FORCE = 1e-60
"""N: a friction limit up to it is none, so that its square is still a number."""


def for_substeps(wheels, dt):
    """Fill in what records of wheels say about substeps of dt (s)."""
    wheels["relaxing"] = dt / wheels["relaxation"]
    for way in ("long", "lat"):
        stiffness = wheels[f"stiffness_{way}"]
        wheels[f"damped_{way}"] = wheels[f"damping_{way}"] / dt
        wheels[f"stiff_{way}"] = stiffness + wheels[f"damped_{way}"]
        wheels[f"giving_{way}"] = 1.0 / wheels[f"stiff_{way}"]
        wheels[f"yielding_{way}"] = dt * stiffness * wheels["creep_compliance"]


def friction_at(x, y, otherwise, patches):
    """Return the friction coefficient at a place: of the last patch that covers it, on what it covers, else
    `otherwise`."""
    friction = otherwise
    for i in range(len(patches)):
        right, up = x - patches[i, 0], y - patches[i, 1]
        along = patches[i, 2] * right + patches[i, 3] * up
        across = patches[i, 2] * up - patches[i, 3] * right
        covered = (abs(along) <= patches[i, 4]) & (abs(across) <= patches[i, 5])
        friction = where(covered, patches[i, 6] + patches[i, 7] * friction, friction)
    return friction


def rise_between(start_x, start_y, end_x, end_y, radius, cables):
    """Return how a wheel's centre rises on a short way over the highest cable there, else zeros.

    That is its rise h halfway, the share of the way that lies on the cable, and in the middle of that share the
    gradient of h: the edges of a cable are sharp, so half a substep more or less on it would be felt.
    """
    rise, share, gradient_x, gradient_y, highest = 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(len(cables)):
        right, up = 0.5 * (start_x + end_x) - cables[i, 0], 0.5 * (start_y + end_y) - cables[i, 1]
        along, middle = cables[i, 2] * right + cables[i, 3] * up, cables[i, 2] * up - cables[i, 3] * right
        half = 0.5 * abs(cables[i, 2] * (end_y - start_y) - cables[i, 3] * (end_x - start_x))
        clear = abs(middle) - half
        beside = (clear <= 0.0) | (clear * clear < 4.0 * radius * cables[i, 5])
        near = beside & (abs(along) <= cables[i, 4])
        if any_of(near):
            flat, reach, edge = radius - cables[i, 5], radius + cables[i, 5], 2.0 * math.sqrt(radius * cables[i, 5])
            over_edge = (half > 0.0) & (abs(middle) + half > edge)
            low = where(middle - half < -edge, -edge, middle - half)
            high = where(middle + half > edge, edge, middle + half)
            on_it = where(high > low, high - low, 0.0)
            across = where(over_edge, 0.5 * (low + high), middle)
            part = where(over_edge, on_it / (2.0 * where(over_edge, half, 1.0)), 1.0)
            root = math.sqrt(reach * reach - across * across)
            up_it = where(abs(middle) < edge, middle, edge)
            risen = where(abs(middle) < edge, math.sqrt(reach * reach - up_it * up_it) - flat, 0.0)
            higher = near & (root - flat > highest)
            highest, share = where(higher, root - flat, highest), where(higher, part, share)
            gradient_x = where(higher, across * cables[i, 3] / root, gradient_x)
            gradient_y = where(higher, -across * cables[i, 2] / root, gradient_y)
            rise = where(higher, risen, rise)
    return rise, share, gradient_x, gradient_y


def force_on_circle(pull, turning, resisting, lateral, share, limit):
    """Return the force along and across: pull / (turning * slack + resisting) and lateral / slack.

    Slack is the least that is >= 1 and keeps the force, `share` times as large along, within the friction limit. It is
    found by Newton's method on 1 / hypot, which is concave and nearly linear in slack: it closes in from below.
    """
    slack, easing, less = 1.0, 1.0 / (turning + resisting), 1.0
    force_long, force_lat = pull * easing, lateral
    square = share * force_long * (share * force_long) + force_lat * force_lat
    sliding = (square > limit * limit) & (limit > NO_FORCE)
    for _ in range(30):
        if not any_of(sliding):
            break
        along, across = share * force_long, force_lat
        falling = along * along * turning * easing + across * across * less
        step = square * (math.sqrt(square) / limit - 1.0) / falling
        slack = where(sliding, slack + step, slack)
        easing, less = 1.0 / (turning * slack + resisting), 1.0 / slack
        force_long, force_lat = pull * easing, lateral * less
        square = share * force_long * (share * force_long) + force_lat * force_lat
        sliding = sliding & (step > CLOSE * slack)
    return where(limit > NO_FORCE, force_long, 0.0), where(limit > NO_FORCE, force_lat, 0.0)


def turn_wheel(wheel, v_long, v_lat, limit, dt):
    """Advance one wheel's spin and bristles by dt; leaves `force_long` and `force_lat` in the wheel's record.

    v_long: how fast the contact runs along the path of the rolling wheel; v_lat: across; m/s. limit:
    friction * load, N.
    """
    if wheel.grip == OMNI:
        v_long = v_long + wheel.roller * v_lat
    radius, inertia, spin = wheel.radius, wheel.inertia, wheel.speed
    relaxed = 1.0 + abs(radius * spin) * wheel.relaxing

    # Motor: torque = a - b * spin at the end of the substep, within +-max_torque.
    a, b = 0.0, 0.0
    if wheel.drive == SERVO:
        a = wheel.proportional * wheel.command + wheel.integral_gain * (wheel.integral + dt * wheel.command)
        b = wheel.proportional + wheel.integral_gain * dt
    elif wheel.drive == VOLTAGE:
        a = wheel.max_torque * wheel.command
        b = wheel.max_torque / wheel.max_speed

    # Contact: force along = (f0 + f1 * spin at the end of the substep) / slack. Slack is 1 while the bristles stick;
    # a sliding contact has as much as brings the force back to the friction circle, at the spin that this force leaves.
    held, held_lat = wheel.damped_long * wheel.stretch_long, wheel.damped_lat * wheel.stretch_lat
    stiff = wheel.stiff_long / (relaxed + wheel.yielding_long)
    f0, f1 = held - stiff * (wheel.stretch_long + dt * v_long), stiff * dt * radius
    lateral, share = 0.0, 1.0
    if wheel.grip == STANDARD:
        stiff_lat = wheel.stiff_lat / (relaxed + wheel.yielding_lat)
        lateral = held_lat - stiff_lat * (wheel.stretch_lat + dt * v_lat)
    else:
        share = math.sqrt(1.0 + wheel.roller * wheel.roller)
    speed, torque, force_long, force_lat = spin, 0.0, 0.0, 0.0
    for _ in range(2):
        turning, pushed, resisting = inertia + dt * b, inertia * spin + dt * a, dt * radius * f1
        pull = f0 * turning + f1 * pushed
        force_long, force_lat = force_on_circle(pull, turning, resisting, lateral, share, limit)
        speed = (pushed - dt * radius * force_long) / turning
        torque = a - b * speed
        beyond = abs(torque) > wheel.max_torque
        if not any_of(beyond):
            break
        a, b = where(beyond, math.copysign(wheel.max_torque, torque), a), where(beyond, 0.0, b)
    wheel.stretch_long = (held - force_long) * wheel.giving_long
    if wheel.grip == STANDARD:
        wheel.stretch_lat = (held_lat - force_lat) * wheel.giving_lat
    if wheel.drive == SERVO:
        followed = wheel.integral + dt * (wheel.command - speed)
        wheel.integral = where(abs(torque) < wheel.max_torque, followed, wheel.integral)
    wheel.angle += dt * speed
    wheel.speed = speed
    wheel.force_long, wheel.force_lat = force_long, force_lat
    wheel.limit, wheel.torque = limit, torque


def contact_at(wheel, place):
    """Return the arm to the contact and the rolling direction, in N, of a wheel on a body at a place."""
    c, s = place.cos, place.sin
    return (
        c * wheel.x - s * wheel.y,
        s * wheel.x + c * wheel.y,
        c * wheel.cos - s * wheel.sin,
        s * wheel.cos + c * wheel.sin,
    )


def wheel_forces(bodies, middle, end, wheels, patches, cables, climbing, dt, loads):
    """Advance all wheels by dt and add up what they do to the bodies.

    bodies (b,), middle and end, their places half of dt and dt ahead, loads (overwritten): records of
    `castor_envs.physics.solver`.
    """
    for i in range(len(loads)):
        load = loads[i]
        load.x, load.y, load.torque = 0.0, 0.0, 0.0
    for k in range(len(wheels)):
        wheel = wheels[k]
        body, place = bodies[wheel.body], middle[wheel.body]
        arm_x, arm_y, e_x, e_y = contact_at(wheel, place)
        u_x, u_y = body.v_x - body.spin * arm_y, body.v_y + body.spin * arm_x
        v_long, v_lat = u_x * e_x + u_y * e_y, u_y * e_x - u_x * e_y
        limit = wheel.load * friction_at(place.x + arm_x, place.y + arm_y, wheel.friction, patches)

        # Forces act at the end of the substep: a cable's is the mean over half a substep before and after.
        place = end[wheel.body]
        arm_x, arm_y, e_x, e_y = contact_at(wheel, place)
        share, gradient_x, gradient_y, longer = 0.0, 0.0, 0.0, 1.0
        if len(cables):
            place_x, place_y, way_x, way_y = place.x + arm_x, place.y + arm_y, 0.5 * dt * u_x, 0.5 * dt * u_y
            wheel.rise, share, gradient_x, gradient_y = rise_between(
                place_x - way_x, place_y - way_y, place_x + way_x, place_y + way_y, wheel.radius, cables
            )
            climb = gradient_x * e_x + gradient_y * e_y
            longer = 1.0 + share * (math.sqrt(1.0 + climb * climb) - 1.0)
        turn_wheel(wheel, longer * v_long, v_lat, limit, dt)
        along, across = longer * wheel.force_long, wheel.force_lat
        if wheel.grip == OMNI:
            across = wheel.roller * wheel.force_long
        force_x, force_y = along * e_x - across * e_y, along * e_y + across * e_x
        if climbing and len(cables):
            force_x -= share * wheel.load * gradient_x
            force_y -= share * wheel.load * gradient_y
        load = loads[wheel.body]
        load.x += force_x
        load.y += force_y
        load.torque += arm_x * force_y - arm_y * force_x
