"""The greatest gravity torque at each joint over all postures: a proven upper bound."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.posture.support import Grid, Support
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.tool import Tool, carrying_link

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class GravityTree:
    """The joints of a robot whose base is held, and what they carry.

    Attributes:
        parents: (n,) number of the joint that carries each; -1: the base.
        placements: Of each joint in the frame of the one that carries it.
        axes: (n, 3) in its own frame.
        slides: (n,) whether it slides.
        ranges: (n, 2) of its positions (rad, m).
        masses: (n,) of the link that it moves, less what gravity compensation carries (kg).
        moments: (n, 3) mass times com of that link, in the joint's frame (kg m).
        gravity: (3,) m/s^2.
    """

    parents: tuple[int, ...]
    placements: tuple[pin.SE3, ...]
    axes: Array
    slides: NDArray[np.bool_]
    ranges: Array
    masses: Array
    moments: Array
    gravity: Array

    @staticmethod
    def of(robot: Robot, ranges: Array) -> GravityTree:
        """Returns the tree of a robot, its joints in actuator order and of these ranges (nu, 2)."""
        model = robot.structure.model
        numbers = [robot.structure.joints[name] for name in robot.joint_names]
        order = {number: index for index, number in enumerate(numbers)}
        screws = np.array([np.ravel(model.joints[number].createData().S) for number in numbers])
        slides = np.linalg.norm(screws[:, 3:], axis=1) < 0.5
        axes = np.where(slides[:, None], screws[:, :3], screws[:, 3:])
        inertias = [model.inertias[number] for number in numbers]
        masses = np.array([float(inertia.mass) for inertia in inertias])
        moments = np.array([inertia.mass * inertia.lever for inertia in inertias])
        tree = GravityTree(
            parents=tuple(order.get(int(model.parents[number]), -1) for number in numbers),
            placements=tuple(model.jointPlacements[number] for number in numbers),
            axes=axes / np.linalg.norm(axes, axis=1, keepdims=True),
            slides=slides,
            ranges=ranges,
            masses=masses,
            moments=moments,
            gravity=robot.gravity,
        )
        carried = robot.mj_model.body_gravcomp
        for body in np.flatnonzero(carried).tolist():
            link, place = carrying_link(robot, body, robot.mj_model.body_ipos[body])
            mass = -float(carried[body] * robot.mj_model.body_mass[body])
            tree = tree.with_mass(robot, Tool("", link, place, ()), mass)
        return tree

    def with_mass(self, robot: Robot, tool: Tool, mass: float) -> GravityTree:
        """Returns the tree with a point mass (kg) at a tool."""
        frame = robot.structure.model.frames[robot.structure.links[tool.link]]
        names = list(robot.structure.model.names)
        if not frame.parentJoint:
            return self
        joint = robot.joint_names.index(names[frame.parentJoint])
        masses, moments = self.masses.copy(), self.moments.copy()
        masses[joint] += mass
        moments[joint] += mass * frame.placement.act(tool.offset)
        return GravityTree(
            self.parents,
            self.placements,
            self.axes,
            self.slides,
            self.ranges,
            masses,
            moments,
            self.gravity,
        )

    def greatest(self) -> Array:
        """Returns upper bounds (n, 2) of each joint's gravity torque, and of its negative (N m, N).

        Over all positions of all joints within their ranges, each for itself.
        """
        count = len(self.parents)
        grids = [Grid.about(axis) for axis in self.axes]
        order = self.outwards()
        carried, sizes = self.masses.copy(), np.zeros(count)
        behind: dict[int, list[int]] = {joint: [] for joint in range(-1, count)}
        for joint in order:
            behind[self.parents[joint]].append(joint)
        # What each joint carries, as it turns: from the ends inwards.
        moved: dict[int, Support] = {}
        torques: dict[int, list[tuple[int, int]]] = {}
        bounds: dict[int, Support] = {}
        for joint in reversed(order):
            directions = grids[joint].directions
            values = (directions @ self.moments[joint])[None]
            sizes[joint] = np.linalg.norm(self.moments[joint])
            for other in behind[joint]:
                place = self.placements[other]
                values = values + carried[other] * (directions @ place.translation)
                values = values + moved[other].at(directions @ place.rotation)
                lever = np.linalg.norm(place.translation)
                carried[joint] += carried[other]
                sizes[joint] += abs(carried[other]) * lever + float(moved[other].sizes[0])
            own = Support(grids[joint], values, sizes[[joint]])
            moved[joint] = self._positioned(joint, own, carried[joint])
            names = [(joint, 0), (joint, 1)]
            tables, scales = [self._torque(joint, own, carried[joint])], [sizes[joint]] * 2
            if self.slides[joint]:
                scales = [abs(carried[joint])] * 2
            for other in behind[joint]:
                names += torques.pop(other)
                found = bounds.pop(other)
                tables.append(found.at(directions @ self.placements[other].rotation))
                scales += found.sizes.tolist()
            both = Support(grids[joint], np.concatenate(tables), np.array(scales))
            torques[joint] = names
            bounds[joint] = both if self.slides[joint] else both.turned(*self.ranges[joint])
        strength = float(np.linalg.norm(self.gravity))
        found_most = np.zeros((count, 2))
        up = -self.gravity / strength if strength else np.array([0.0, 0.0, 1.0])
        for joint in behind[-1]:
            there = bounds[joint].at(self.placements[joint].rotation.T @ up)
            for (which, sign), most in zip(torques[joint], there, strict=True):
                found_most[which, sign] = strength * most
        return found_most

    def outwards(self) -> list[int]:
        """Returns the joints, carriers first."""
        done: list[int] = []
        left = list(range(len(self.parents)))
        while left:
            ready = [joint for joint in left if self.parents[joint] in (-1, *done)]
            done += ready
            left = [joint for joint in left if joint not in ready]
        return done

    def _positioned(self, joint: int, own: Support, mass: float) -> Support:
        """Returns the moments that a joint's link attains in the frame that carries the joint."""
        low, high = self.ranges[joint]
        if not self.slides[joint]:
            return own.turned(low, high)
        along = mass * (own.grid.directions @ self.axes[joint])
        with np.errstate(invalid="ignore"):
            most = np.where(along == 0, 0.0, np.maximum(low * along, high * along))
        longest = abs(mass) * max(abs(low), abs(high))
        return Support(own.grid, own.values + most, own.sizes + longest)

    def _torque(self, joint: int, own: Support, mass: float) -> Array:
        """Returns a joint's torque and its negative (2, rows, steps) by where up is, per |g|."""
        grid = own.grid
        if self.slides[joint]:
            along = mass * (grid.directions @ self.axes[joint])
            return np.stack([along, -along])
        across = np.cross(grid.directions, self.axes[joint])
        lengths = np.linalg.norm(across, axis=-1, keepdims=True)
        ways = np.divide(across, lengths, out=np.zeros_like(across), where=lengths > 1e-12)
        ways[lengths[..., 0] <= 1e-12] = grid.basis[:, 0]
        both: Array = np.concatenate([own.at(ways), own.at(-ways)]) * lengths[..., 0]
        return both


def describes_load(
    robot: Robot, tree: GravityTree, samples: Sequence[Array], tolerance: float
) -> bool:
    """Tells whether gravity on a tree is all that motors hold, at some configurations (nq,).

    Springs, wind and loops are not; what is meant differs by no more than a tolerance (N m, N).
    """
    return all(
        float(np.abs(tree_torques(tree, qpos) - Configuration(robot, qpos).load()).max())
        <= tolerance
        for qpos in samples
    )


def tree_torques(tree: GravityTree, qpos: Array) -> Array:
    """Returns the gravity torque of each joint of a tree (n,), from its masses and moments."""
    count = len(tree.parents)
    placed: dict[int, pin.SE3] = {-1: pin.SE3.Identity()}
    masses, moments = np.zeros(count), np.zeros((count, 3))
    order = tree.outwards()
    for joint in order:
        axis, way = tree.axes[joint], float(qpos[joint])
        motion = (
            pin.SE3(np.eye(3), way * axis)
            if tree.slides[joint]
            else pin.SE3(pin.AngleAxis(way, axis).toRotationMatrix(), np.zeros(3))
        )
        placed[joint] = placed[tree.parents[joint]] * tree.placements[joint] * motion
        masses[joint] = tree.masses[joint]
        rotated = placed[joint].rotation @ tree.moments[joint]
        moments[joint] = rotated + tree.masses[joint] * placed[joint].translation
    for joint in reversed(order):
        if tree.parents[joint] >= 0:
            masses[tree.parents[joint]] += masses[joint]
            moments[tree.parents[joint]] += moments[joint]
    torques = np.zeros(count)
    for joint in range(count):
        axis = placed[joint].rotation @ tree.axes[joint]
        lever = moments[joint] - masses[joint] * placed[joint].translation
        pull = masses[joint] * axis if tree.slides[joint] else np.cross(axis, lever)
        torques[joint] = -tree.gravity @ pull
    return torques
