"""A robot's two models as trees of parameters, with the same names; and a URDF's own tree."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
from lxml import etree
from numpy.typing import NDArray

from pupper_analysis.base.arrays import placement_of
from pupper_analysis.base.diagnostics import (
    Diagnostic,
    Quantity,
    Term,
    diagnose,
)
from pupper_analysis.models import multibody
from pupper_analysis.models.conversion import pinocchio_from_mujoco, pinocchio_from_urdf
from pupper_analysis.models.mjcf import free_joints
from pupper_analysis.models.multibody import MultibodyTree
from pupper_analysis.models.urdf_file import for_engines
from pupper_analysis.models.urdf_tree import UrdfTree
from pupper_analysis.robot.coordinates import MujocoConvention
from pupper_analysis.robot.robot import Robot

Array = NDArray[np.float64]


def kinematic_trees(robot: Robot) -> tuple[MultibodyTree, MultibodyTree]:
    """Returns the parameters of the URDF and of the MJCF; of a fixed base, in the world's frame."""
    frames = {**robot.description.contact_points, **robot.description.frames}
    urdf = multibody.from_pinocchio(
        robot.pin_model,
        robot.base,
        robot.joint_names,
        {name: pair[0] for name, pair in frames.items()},
    )
    mjcf = multibody.from_pinocchio(
        pinocchio_from_mujoco(robot.mj_model),
        robot.base,
        robot.joint_names,
        {name: pair[1] for name, pair in frames.items()},
    )
    return urdf, mjcf


def base_pose(robot: Robot) -> pin.SE3:
    """Returns where a fixed base stands in the world, by the MJCF."""
    data = mujoco.MjData(robot.mj_model)
    mujoco.mj_kinematics(robot.mj_model, data)
    body = robot.mj_model.body(robot.mj_base).id
    return placement_of(data.xquat[body], data.xpos[body])


def poses_at_zero(tree: multibody.MultibodyTree) -> dict[str, pin.SE3]:
    """Returns where each body's frame is at zero angles, in the base's."""
    poses = {tree.base: pin.SE3.Identity()}
    for name in tree.parents_first():
        joint = tree.joints[name]
        poses[name] = poses[joint.parent] * joint.placement
    return poses


def at_zero(tree: multibody.MultibodyTree) -> dict[str, tuple[Array, Array]]:
    """Returns where each joint is at zero, and its axis, both in the base's frame."""
    poses = poses_at_zero(tree)
    return {
        name: (np.array(poses[name].translation), poses[name].rotation @ joint.axis)
        for name, joint in tree.joints.items()
    }


@dataclass(frozen=True, eq=False)
class Reference:
    """A compiled MJCF, and the names by which its elements are called.

    Attributes:
        model: What MuJoCo makes of the file, as it is; it may hold more than the robot.
        names: The same, in which every body and joint has a name.
        joint_names: The robot's joints, by those names.
        base: Its base, likewise.
    """

    model: mujoco.MjModel
    names: mujoco.MjModel
    joint_names: Sequence[str]
    base: str

    def joints(self) -> list[int]:
        """Returns the ids of the robot's joints, and of the free one of its base."""
        base = self.names.body(self.base).id
        free = free_joints(self.model)
        loose = [joint for joint in free if self.model.jnt_bodyid[joint] == base]
        return [*loose, *(self.names.joint(name).id for name in self.joint_names)]

    def convention(self) -> MujocoConvention:
        """Returns where the public coordinates are; other objects of a scene may float as well."""
        model, joints = self.model, self.joints()
        free = len(joints) - len(self.joint_names)
        starts = zip(model.jnt_qposadr[joints], model.jnt_dofadr[joints], strict=True)
        qpos: list[int] = []
        qvel: list[int] = []
        for number, (position, velocity) in enumerate(starts):
            qpos += range(position, position + (7 if number < free else 1))
            qvel += range(velocity, velocity + (6 if number < free else 1))
        return MujocoConvention(
            qpos_index=np.array(qpos, dtype=np.int64),
            qvel_index=np.array(qvel, dtype=np.int64),
            actuator_index=np.full(len(self.joint_names), -1),
        )

    def bodies(self) -> set[int]:
        """Returns the ids of the robot's bodies: all on the trees of its base and its joints."""
        model = self.model
        found = {self.names.body(self.base).id}
        found |= {int(model.jnt_bodyid[joint]) for joint in self.joints()}
        roots = {int(model.body_rootid[body]) for body in found} - {0}
        return {body for body in range(model.nbody) if int(model.body_rootid[body]) in roots}


# The side of a URDF in matching: its base, its joints, its links.


def without_shapes(urdf: etree._Element) -> etree._Element:
    """Returns a copy of a URDF's XML without visuals and collision shapes."""
    tree = UrdfTree(urdf).copy()
    tree.remove_shapes()
    return tree.root


def strip_roots(
    root: etree._Element, source: Path, other: multibody.MultibodyTree
) -> tuple[etree._Element, list[Diagnostic]]:
    """Takes out root links without mass, as long as they carry one fixed or floating joint.

    Where such a link's frame, not that of the base on it, is the one that the MJCF has, the link
    stays: whichever brings the joints nearer to the MJCF's.
    """
    candidates: list[tuple[etree._Element, list[Diagnostic]]] = [(root, [])]
    while True:
        tree, said = UrdfTree(candidates[-1][0]).copy(), list(candidates[-1][1])
        base = tree.base
        joints = tree.below.get(base.name, [])
        if (base.mass or 0.0) > 0 or [joint.kind for joint in joints] not in (
            ["fixed"],
            ["floating"],
        ):
            break
        left = "link", base.name
        said.append(diagnose("root-link-left-out", subject=left, file=source.name, sources=source))
        tree.remove_base()
        if joints[0].kind == "floating":
            candidates.clear()  # the base cannot stay on a joint that floats by itself
        candidates.append((tree.root, said))
    there = at_zero(other)

    def distance(tree: etree._Element) -> float:
        here = at_zero(urdf_tree(tree, source))
        common = [name for name in here if name in there]
        apart = sum(float(np.linalg.norm(here[name][0] - there[name][0])) for name in common)
        return round(apart, 6)

    if len(candidates) == 1 or not other.floating:
        return candidates[-1]  # a fixed base is put where the MJCF has it
    # The last of the equally good: no needless root.
    best = min(reversed(candidates), key=lambda candidate: distance(candidate[0]))
    return best[0], best[1]


def take_mass_of_base(root: etree._Element, source: Path) -> list[Diagnostic]:
    """Takes the inertials off the base and what is fixed to it, in place; tells what they weighed.

    For an MJCF whose base is the world, which has no mass: a fixed base's has no effect either.
    """
    tree, masses = UrdfTree(root), {}
    for name in tree.fixed_group(tree.base.name):
        stated = tree.links[name].mass
        if stated is not None:
            masses[name] = stated
            tree.links[name].remove("inertial")
    if not any(masses.values()):
        return []
    heaviest, mass = max(masses, key=masses.__getitem__), Quantity(sum(masses.values()), "kg")
    base = "link", heaviest
    return [diagnose("mass-of-base-left-out", subject=base, mass=mass, file=source.name)]


def moving_joints(root: etree._Element) -> tuple[list[str], list[str], list[Diagnostic]]:
    """Returns the names of the hinges and slides, and of other joints, which are fixed, in place.

    These are floating and planar ones inside the tree: what they carry is compared as at rest. The
    third says so.
    """
    moving, others, notes = [], [], []
    for name, joint in UrdfTree(root).joints.items():
        if joint.moves:
            moving.append(name)
        elif not joint.is_fixed:
            others.append(name)
            kind = Term(joint.kind)
            joint.fix()
            notes.append(diagnose("joint-fixed", subject=("joint", name), kind=kind))
    return moving, others, notes


def links_of(root: etree._Element, robot: Robot) -> dict[str, str]:
    """Returns {base or joint: the link that it moves}."""
    tree = UrdfTree(root)
    moved = {name: link for name, link in tree.moved_links.items() if name in robot.joint_names}
    return {robot.base: tree.base.name, **moved}


def urdf_tree(
    root: etree._Element, source: Path, base: str = "", frames: Iterable[str] = ()
) -> multibody.MultibodyTree:
    """Returns the parameters of a URDF's joints and bodies, with a free base.

    Args:
        root: Its XML; all its joints are fixed, hinges or slides.
        source: Where it came from, for messages.
        base: What its base is called.
        frames: Links whose places count.

    Raises:
        ModelError: If Pinocchio cannot read it.
    """
    model = pinocchio_from_urdf(for_engines(root), source, floating=True)
    names = list(model.names)[2:]
    return multibody.from_pinocchio(model, base, names, {name: name for name in frames})


Mimics = Mapping[str, tuple[str, float, float]]
"""{joint: (the joint that it follows, multiplier, offset)}: q = multiplier q_other + offset."""


def urdf_mimics(root: Any) -> dict[str, tuple[str, float, float]]:
    """Returns the joints of a parsed URDF that follow others: their ``<mimic>``."""
    found = {}
    for name, joint in UrdfTree(root).joints.items():
        mimic = joint.mimic
        if mimic is not None and not joint.is_fixed:
            numbers = (float(mimic.get("multiplier", 1)), float(mimic.get("offset", 0)))
            found[name] = (str(mimic.get("joint")), *numbers)
    return found
