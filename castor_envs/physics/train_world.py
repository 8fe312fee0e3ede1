"""The world of a train: axle modules on wheels, joined by frames that bend."""

import dataclasses
import math

import numpy as np
import pymunk
from numpy.typing import ArrayLike
from pymunk.constraints import Constraint

from castor_envs.errors import InputError
from castor_envs.floor import Floor
from castor_envs.geometry.arrays import Array
from castor_envs.geometry.bodies import motion_of, pose_of, twist_of
from castor_envs.geometry.se2 import compose, inverse, relative_pose
from castor_envs.physics.beam import Clamp, bent_pose, chain, chain_points, frame_substeps, half_link, link_inertia
from castor_envs.physics.stepper import Drive, Simulation, Stepper, move
from castor_envs.physics.wheel_state import MOST_SUBSTEPS, enough_substeps, wheel_records
from castor_envs.vehicles.train import TrainDescription
from castor_envs.vehicles.weight import chassis, combined

ITERATIONS_PER_LINK = 3  # the solver's impulses travel along a chain by one joint an iteration
LIGHT = 200.0
"""Times as heavy as its frame's links an axle may be before substeps and iterations grow, both with the root of it: the
solver's impulses turn a heavy axle by light links little by little, and what is left of it feeds or damps the frame.
They grow up to the most substeps there may be."""


class TrainWorld:
    """A train on a floor, at rest at the start.

    Bodies: each module with the half links clamped to it, then each frame's links. Wheels as in `RobotWorld`; they
    carry their module and half of each frame on it.

    train: effects are folded in. pose: of the front axle in N. bends (F,): angle by which each frame is bent evenly at
    the start, rad (positive: the front axle is turned to the left against the rear one). stepper, substeps: as for
    `RobotWorld`.
    """

    def __init__(
        self,
        train: TrainDescription,
        floor: Floor | None = None,
        *,
        pose: ArrayLike = (0.0, 0.0, 0.0),
        bends: ArrayLike = 0.0,
        stepper: Stepper = "compiled",
        substeps: int | None = None,
    ) -> None:
        self.train = train.as_built()
        self.floor = floor or Floor()
        frames, n = self.train.frames, self.train.n_axles
        bends = np.broadcast_to(np.asarray(bends, dtype=float), (len(frames),))
        poses = [np.asarray(pose, dtype=float)]
        for frame, bend in zip(frames, bends, strict=True):
            poses.append(compose(poses[-1], inverse(bent_pose(frame, bend))))

        ahead, behind = [None, *frames], [*frames, None]
        records = []
        self.centers, bodies = [], []
        for i, module in enumerate(self.train.modules):
            clamped = [frame for frame in (ahead[i], behind[i]) if frame is not None]
            carried = sum(0.5 * frame.linear_density * frame.length for frame in clamped)
            loaded = dataclasses.replace(module, mass=module.mass + carried)
            wheels = wheel_records(loaded, self.floor)
            parts = [chassis(module)]
            parts += [half_link(frame, side) for frame, side in ((ahead[i], 1.0), (behind[i], -1.0)) if frame]
            mass, inertia, center = combined(parts)
            body = pymunk.Body(mass, inertia)
            move(body, motion_of(poses[i][:2], poses[i][2], np.zeros(3), center))
            shift = chassis(loaded)[2] - center
            wheels["x"] += shift[0]
            wheels["y"] += shift[1]
            wheels["body"] = i
            records.append(wheels)
            self.centers.append(center)
            bodies.append(body)
        self.wheels = np.concatenate(records)
        needed = [enough_substeps(module, wheels) for module, wheels in zip(self.train.modules, records, strict=True)]
        needed += [frame_substeps(frame, self.train.sample_period) for frame in frames]
        lightest = [link_inertia(frame)[0] for frame in frames]
        heaviest = [max(bodies[f].mass, bodies[f + 1].mass) for f in range(len(frames))]
        finer = math.sqrt(max(1.0, *(m / link / LIGHT for m, link in zip(heaviest, lightest, strict=True))))
        finer = min(finer, max(1.0, MOST_SUBSTEPS / max(needed)))
        substeps = substeps or math.ceil(finer * max(needed))
        if substeps > MOST_SUBSTEPS:
            raise InputError(
                f"train {self.train.name!r}: a sample period would take {substeps} substeps of physics, more than "
                f"{MOST_SUBSTEPS}; a frame is too stiff or too damped for its weight, or has too many links"
            )

        joints: list[Constraint] = []
        self.frame_bodies = []
        for f, (frame, bend) in enumerate(zip(frames, bends, strict=True)):
            rear, front = (Clamp(bodies[i], -self.centers[i]) for i in (f + 1, f))
            links, frame_joints = chain(frame, rear, front, self.train.sample_period / substeps, bend)
            self.frame_bodies.append(np.array([f + 1, *range(len(bodies), len(bodies) + len(links)), f]))
            bodies += links
            joints += frame_joints
        self.limits = np.repeat([module.max_wheel_speed for module in self.train.modules], 2)
        self.simulation = Simulation(
            f"train {self.train.name!r}",
            bodies,
            joints,
            self.wheels,
            self.floor,
            sample_period=self.train.sample_period,
            substeps=substeps,
            iterations=math.ceil(finer * ITERATIONS_PER_LINK * max(frame.links for frame in frames)),
            stepper=stepper,
        )
        self._n = n
        self._start = self.simulation.motion.copy()

    def restart(self) -> None:
        """Start again where it was put, as if made anew."""
        self.simulation.restart(self._start)

    def advance(self, wheel_command: ArrayLike, drive: Drive = "servo") -> None:
        """Run one sample period with constant commands (2N,), axle by axle, left first; as `RobotWorld.advance`."""
        limits = self.limits if drive == "servo" else np.ones_like(self.limits)
        self.simulation.command(np.arange(2 * self._n), wheel_command, limits, drive)
        self.simulation.advance()

    @property
    def time(self) -> float:
        """Since the start, s."""
        return self.simulation.time

    @property
    def substeps(self) -> int:
        """Substeps a sample period."""
        return self.simulation.substeps

    @property
    def poses(self) -> Array:
        """Poses of the axles in N, (N, 3), front first; psi unwrapped."""
        motion = self.simulation.motion
        return np.array([pose_of(motion[i], center) for i, center in enumerate(self.centers)])

    @property
    def twists(self) -> Array:
        """Twists of the axles, each in its own frame, (N, 3)."""
        motion = self.simulation.motion
        return np.array([twist_of(motion[i], center) for i, center in enumerate(self.centers)])

    @property
    def relative_poses(self) -> Array:
        """True pose of each frame's front axle in its rear axle's frame, (F, 3)."""
        poses = self.poses
        return relative_pose(poses[1:], poses[:-1])

    @property
    def joint_angles(self) -> list[Array]:
        """Of each frame the angles (links,) of its joints, from the rear, rad."""
        angle = self.simulation.motion[:, 2]
        return [turned[1:] - turned[:-1] for turned in (angle[bodies] for bodies in self.frame_bodies)]

    @property
    def frame_shapes(self) -> list[Array]:
        """Of each frame the points (links + 2, 2) in N from the rear axle to the front one."""
        rear = self.poses[1:]
        return [
            compose(pose, chain_points(frame, angles))[:, :2]
            for pose, frame, angles in zip(rear, self.train.frames, self.joint_angles, strict=True)
        ]

    @property
    def wheel_angles(self) -> Array:
        """How far each wheel has turned since the start (2N,), rad."""
        return np.array(self.wheels["angle"])

    def energy(self) -> float:
        """Return all mechanical energy, J."""
        return self.simulation.energy()
