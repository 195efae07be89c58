"""The greatest gravity torque of each motor over all postures: a proven upper bound."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.posture.looks import compensated
from pupper_analysis.posture.support import Grid, Support
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.tool import Tool

Array = NDArray[np.float64]

_NO_SHARE = 1e-12
"""A motor's part of a joint's torque that is rounding."""


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
        for link, place, mass in compensated(robot):
            tree = tree.with_mass(robot, Tool("", link, place, ()), -mass)
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

    def greatest(self, shares: Array) -> Array:
        """Returns upper bounds (m, 2) of motors' gravity torques, and of their negatives (N m, N).

        Over all positions of all joints within their ranges, each for itself.

        Args:
            shares: (m, n) what each motor holds of the joints' torques.
        """
        order = self.outwards()
        behind: dict[int, list[int]] = {joint: [] for joint in (-1, *order)}
        for joint in order:
            behind[self.parents[joint]].append(joint)
        made: dict[int, _Carried] = {}
        for joint in reversed(order):  # from the ends inwards
            others = {other: made.pop(other) for other in behind[joint]}
            made[joint] = self._carried(joint, others, shares[:, joint])
        strength = float(np.linalg.norm(self.gravity))
        most = np.zeros((len(shares), 2))
        up = -self.gravity / strength if strength else np.array([0.0, 0.0, 1.0])
        for joint in behind[-1]:
            # A torque is linear in where up is: its negative is bounded with up turned over.
            for sign, there in enumerate((up, -up)):
                found = made[joint].support.at(self.placements[joint].rotation.T @ there)
                most[made[joint].motors, sign] += strength * found[1:]
        return most

    def outwards(self) -> list[int]:
        """Returns the joints, carriers first."""
        done: list[int] = []
        left = list(range(len(self.parents)))
        while left:
            ready = [joint for joint in left if self.parents[joint] in (-1, *done)]
            done += ready
            left = [joint for joint in left if joint not in ready]
        return done

    def _carried(self, joint: int, others: dict[int, _Carried], share: Array) -> _Carried:
        """Returns what a joint carries, of whose torque motors hold a share (m,) each."""
        grid, mass = Grid.about(self.axes[joint]), float(self.masses[joint])
        moments, size = grid.directions @ self.moments[joint], np.linalg.norm(self.moments[joint])
        torques = dict[int, Array]()  # of motors, as far as what they hold is behind
        sizes = dict[int, float]()
        for other, carried in others.items():
            place = self.placements[other]
            found = carried.support.at(grid.directions @ place.rotation)
            moments = moments + found[0] + carried.mass * (grid.directions @ place.translation)
            size += carried.support.sizes[0] + abs(carried.mass) * np.linalg.norm(place.translation)
            mass += carried.mass
            for motor, table, most in zip(
                carried.motors, found[1:], carried.support.sizes[1:].tolist(), strict=True
            ):
                torques[motor] = torques.get(motor, 0.0) + table
                sizes[motor] = sizes.get(motor, 0.0) + most
        if self.slides[joint]:
            along = mass * (grid.directions @ self.axes[joint])
            low, high = self.ranges[joint]
            with np.errstate(invalid="ignore"):
                moments = moments + np.where(along == 0, 0.0, np.maximum(low * along, high * along))
            own, reach = np.stack([along, -along]), abs(mass)
        else:
            own, reach = grid.across(moments), float(size)
        for motor in np.flatnonzero(np.abs(share) > _NO_SHARE).tolist():
            part = float(share[motor])
            torques[motor] = torques.get(motor, 0.0) + abs(part) * own[0 if part > 0 else 1]
            sizes[motor] = sizes.get(motor, 0.0) + abs(part) * reach
        if self.slides[joint]:
            size += abs(mass) * max(abs(low), abs(high))
        values = np.stack([moments, *torques.values()])
        support = Support(grid, values, np.array([size, *sizes.values()]))
        if not self.slides[joint]:
            support = support.turned(*self.ranges[joint])
        return _Carried(mass, list(torques), support)


@dataclass(frozen=True, eq=False)
class _Carried:
    """What a joint carries, by directions in the frame that the joint stands in.

    Attributes:
        mass: kg.
        motors: Whose torque, or part of it, each table but the first bounds.
        support: Of the first moments about the joint; then of torques, per |g|, by where up is.
    """

    mass: float
    motors: list[int]
    support: Support


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
