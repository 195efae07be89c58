"""Multibody trees of a robot's URDF and MJCF, and normalisation of a URDF for matching.

Input: a robot, or the XML of a URDF. `kinematic_trees` returns `MultibodyTree` objects with equal
names for URDF and MJCF. Other functions prepare a URDF for matching with an MJCF: no shapes, no
massless root links, and no floating or planar joints. If the MJCF has no base body, the mass of the
base is removed from the URDF.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
from lxml import etree

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.arrays import make_placement
from pupper_analysis.base.diagnostics import (
    Diagnostic,
    Quantity,
    Term,
    diagnose,
)
from pupper_analysis.models import multibody
from pupper_analysis.models.conversion import pinocchio_from_mujoco, pinocchio_from_urdf
from pupper_analysis.models.mjcf import list_free_joints
from pupper_analysis.models.multibody import MultibodyTree
from pupper_analysis.models.urdf_file import to_engine_xml
from pupper_analysis.models.urdf_tree import UrdfTree
from pupper_analysis.robot.coordinates import MujocoConvention
from pupper_analysis.robot.robot import Robot


def kinematic_trees(robot: Robot) -> tuple[MultibodyTree, MultibodyTree]:
    """Return the multibody trees of a robot's URDF and MJCF, with equal names of bodies and joints.

    The trees are expressed in the base frame if the base is free, and in the world frame if the
    base is fixed.

    Returns:
        Tree of the URDF; tree of the MJCF.
    """
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
    return urdf, with_null_efforts(mjcf, robot.description.null_efforts)


def with_null_efforts(tree: MultibodyTree, joints: Collection[str]) -> MultibodyTree:
    """Set the effort limit of given joints to zero in a multibody tree; return a copy.

    The MJCF states an empty force range for these joints, for example "0 0", which a compiled model
    does not contain as a limit (``models.efforts.find_null_efforts``).

    Args:
        tree: Tree of the MJCF.
        joints: Names of the joints; names that the tree lacks are ignored.
    """
    null = {name: replace(tree.joints[name], effort=0.0) for name in joints if name in tree.joints}
    return replace(tree, joints={**tree.joints, **null})


def base_pose(robot: Robot) -> pin.SE3:
    """Return the world pose of the base body in the MJCF, for a robot with a fixed base."""
    data = mujoco.MjData(robot.mj_model)
    mujoco.mj_kinematics(robot.mj_model, data)
    body = robot.mj_model.body(robot.mj_base).id
    return make_placement(data.xquat[body], data.xpos[body])


def compute_poses_at_zero(tree: multibody.MultibodyTree) -> dict[str, pin.SE3]:
    """Return the poses of all bodies of a tree at zero joint positions, in the frame of the tree.

    Returns:
        {base or joint: pose of the moved body}.
    """
    poses = {tree.base: pin.SE3.Identity()}
    for name in tree.parents_first():
        joint = tree.joints[name]
        poses[name] = poses[joint.parent] * joint.placement
    return poses


def list_joint_axes_at_zero(tree: multibody.MultibodyTree) -> dict[str, tuple[Array, Array]]:
    """Return the joint positions and axes at zero joint positions, in the frame of the tree.

    Returns:
        {joint: (position (3,) [m], unit axis (3,))}.
    """
    poses = compute_poses_at_zero(tree)
    return {
        name: (np.array(poses[name].translation), poses[name].rotation @ joint.axis)
        for name, joint in tree.joints.items()
    }


@dataclass(frozen=True, eq=False)
class Reference:
    """Compiled MJCF of a matched robot, with a name for each body and joint.

    Attributes:
        model: Compiled model of the file, which may contain objects other than the robot.
        names: Equivalent model in which all bodies and joints have names.
        joint_names: Joints of the robot, as named in ``names``.
        base: Base of the robot, as named in ``names``.
    """

    model: mujoco.MjModel
    names: mujoco.MjModel
    joint_names: Sequence[str]
    base: str

    def joints(self) -> list[int]:
        """Return the MuJoCo ids of the robot's joints, without the joints of other objects.

        The free joint of the base, if any, comes first.
        """
        base = self.names.body(self.base).id
        free_ids = list_free_joints(self.model)
        base_joints = [joint for joint in free_ids if self.model.jnt_bodyid[joint] == base]
        return [*base_joints, *(self.names.joint(name).id for name in self.joint_names)]

    def convention(self) -> MujocoConvention:
        """Return the indices of the robot's coordinates in ``qpos`` and ``qvel`` of ``model``.

        Actuators are not indexed: ``actuator_index`` is -1 for each joint.
        """
        model, joints = self.model, self.joints()
        num_free = len(joints) - len(self.joint_names)
        starts = zip(model.jnt_qposadr[joints], model.jnt_dofadr[joints], strict=True)
        qpos: list[int] = []
        qvel: list[int] = []
        for index, (position, velocity) in enumerate(starts):
            qpos += range(position, position + (7 if index < num_free else 1))
            qvel += range(velocity, velocity + (6 if index < num_free else 1))
        return MujocoConvention(
            qpos_index=np.array(qpos, dtype=np.int64),
            qvel_index=np.array(qvel, dtype=np.int64),
            actuator_index=np.full(len(self.joint_names), -1),
        )

    def bodies(self) -> set[int]:
        """Return the ids of the bodies in kinematic trees with the robot's base or joints."""
        model = self.model
        robot_bodies = {self.names.body(self.base).id}
        robot_bodies |= {int(model.jnt_bodyid[joint]) for joint in self.joints()}
        roots = {int(model.body_rootid[body]) for body in robot_bodies} - {0}
        return {body for body in range(model.nbody) if int(model.body_rootid[body]) in roots}


# Normalisation of a URDF for matching.


def without_shapes(urdf: etree._Element) -> etree._Element:
    """Return a copy of a URDF's XML without visual and collision shapes."""
    tree = UrdfTree(urdf).copy()
    tree.remove_shapes()
    return tree.root


def strip_roots(
    root: etree._Element, source: Path, other: multibody.MultibodyTree
) -> tuple[etree._Element, list[Diagnostic]]:
    """Return a URDF without massless root links that have a single fixed or floating joint.

    If the MJCF has a free base, the number of removed links minimises the sum of the distances [m]
    between joints with equal names in both files.

    Args:
        root: Root element of the URDF; not modified.
        source: File, for messages.
        other: Tree of the MJCF.

    Returns:
        Modified copy, or ``root`` itself if no link is removed; diagnostics of the removed links.
    """
    candidates: list[tuple[etree._Element, list[Diagnostic]]] = [(root, [])]
    while True:
        tree, notes = UrdfTree(candidates[-1][0]).copy(), list(candidates[-1][1])
        base = tree.base
        joints = tree.child_joints.get(base.name, [])
        if (base.mass or 0.0) > 0 or [joint.kind for joint in joints] not in (
            ["fixed"],
            ["floating"],
        ):
            break
        subject = "link", base.name
        notes.append(
            diagnose("root-link-left-out", subject=subject, file=source.name, sources=source)
        )
        tree.remove_base()
        if joints[0].kind == "floating":
            candidates.clear()  # a floating joint must be removed
        candidates.append((tree.root, notes))
    other_joints = list_joint_axes_at_zero(other)

    def distance(tree: etree._Element) -> float:
        """Return the sum of the distances [m] of joints with equal names in both files.

        The sum is rounded to 1 um, so that equal candidates compare as equal.
        """
        joints = list_joint_axes_at_zero(urdf_tree(tree, source))
        common = [name for name in joints if name in other_joints]
        total = sum(
            float(np.linalg.norm(joints[name][0] - other_joints[name][0])) for name in common
        )
        return round(total, 6)

    if len(candidates) == 1 or not other.floating:
        return candidates[-1]  # the frame of a fixed base is moved to that of the MJCF
    # Of equal candidates, the one with the fewest links.
    best = min(reversed(candidates), key=lambda candidate: distance(candidate[0]))
    return best[0], best[1]


def remove_base_mass(root: etree._Element, source: Path) -> list[Diagnostic]:
    """Remove the inertias of a URDF's base and of links fixed to the base, in place.

    Use this function if the MJCF has no base body, and therefore no mass of the base.

    Args:
        root: Root element of the URDF; modified.
        source: File of the URDF, for messages.

    Returns:
        Diagnostic of the removed mass; empty if the mass is zero.
    """
    tree, masses = UrdfTree(root), {}
    for name in tree.fixed_group(tree.base.name):
        link_mass = tree.links[name].mass
        if link_mass is not None:
            masses[name] = link_mass
            tree.links[name].remove("inertial")
    if not any(masses.values()):
        return []
    heaviest, mass = max(masses, key=masses.__getitem__), Quantity(sum(masses.values()), "kg")
    subject = "link", heaviest
    return [diagnose("mass-of-base-left-out", subject=subject, mass=mass, file=source.name)]


def fix_other_joints(root: etree._Element) -> tuple[list[str], list[str], list[Diagnostic]]:
    """Change floating and planar joints of a URDF to fixed joints, in place; list the other joints.

    Args:
        root: Root element of the URDF; modified.

    Returns:
        Names of the hinges and slides; names of the changed joints; diagnostics of the changed
        joints.
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
    """Return the URDF link that moves with each joint, {base or joint: name of the link}.

    Args:
        root: Root element of the URDF.
        robot: The robot. Its name of the base is the key of the root link.
    """
    tree = UrdfTree(root)
    links = {name: link for name, link in tree.moved_links.items() if name in robot.joint_names}
    return {robot.base: tree.base.name, **links}


def urdf_tree(
    root: etree._Element, source: Path, base: str = "", frames: Iterable[str] = ()
) -> multibody.MultibodyTree:
    """Return the multibody tree of a URDF, with a free base.

    Args:
        root: Root element; all joints are fixed, hinges or slides.
        source: File, for messages.
        base: Name that the base gets in the tree.
        frames: Links that become frames of the tree.

    Raises:
        ModelError: If Pinocchio cannot read the URDF.
    """
    model = pinocchio_from_urdf(to_engine_xml(root), source, floating=True)
    names = list(model.names)[2:]
    return multibody.from_pinocchio(model, base, names, {name: name for name in frames})


Mimic = tuple[str, float, float]
"""Mimic coupling q = multiplier q_leader + offset: (leader, multiplier, offset [rad, m])."""

Mimics = Mapping[str, Mimic]
"""Mimic couplings, {joint: coupling}."""


def urdf_mimics(root: Any) -> dict[str, tuple[str, float, float]]:
    """Read the mimic couplings of a URDF; mimic tags of fixed joints are ignored.

    Args:
        root: Root element of the URDF.

    Returns:
        {joint: (leader, multiplier, offset [rad, m])}: q = multiplier q_leader + offset.
    """
    mimics = {}
    for name, joint in UrdfTree(root).joints.items():
        mimic = joint.mimic
        if mimic is not None and not joint.is_fixed:
            numbers = (float(mimic.get("multiplier", 1)), float(mimic.get("offset", 0)))
            mimics[name] = (str(mimic.get("joint")), *numbers)
    return mimics
