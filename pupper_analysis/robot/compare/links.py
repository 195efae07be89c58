"""The links of which each moving body is made, in both files, in the same frame.

Links on fixed joints are folded into the body that carries them before two files are compared. The
fold says that a body differs; which of its links differs, the links alone can say.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.base.arrays import INERTIA_ENTRIES, inertia_tensor
from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.models.conversion import inertia_of_body, pinocchio_from_mujoco
from pupper_analysis.models.multibody import MultibodyTree, TreeBody
from pupper_analysis.models.urdf_tree import UrdfTree
from pupper_analysis.robot.compare.differences import Difference
from pupper_analysis.robot.matching.sources import Sources
from pupper_analysis.robot.matching.trees import poses_at_zero
from pupper_analysis.robot.robot import Robot

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ComparedLink:
    """One link's inertial, in the frame of the body that it is a part of.

    Attributes:
        name: The URDF's link, or the MJCF's body.
        body: Its mass (kg), com (m) and inertia about that (kg m^2).
        axes: (3, 3) from the link's own axes to the body's.
    """

    name: str
    body: TreeBody
    axes: Array


Links = Mapping[str, tuple[ComparedLink, ...]]
"""{base or joint: the links with mass that move with it}."""


def urdf_links(robot: Robot) -> Links:
    """Returns the links of the URDF's bodies, in the frames of its own tree."""
    model = robot.pin_model
    found: dict[str, list[ComparedLink]] = {}
    for name, link in UrdfTree.of(robot.description.urdf).links.items():
        own = link.inertia
        if own is None or not own.mass or not model.existFrame(name, pin.FrameType.BODY):
            continue
        frame = model.frames[model.getFrameId(name, pin.FrameType.BODY)]
        body = TreeBody.of(own).moved(frame.placement)
        mover = _mover(robot, model, int(frame.parentJoint))
        found.setdefault(mover, []).append(
            ComparedLink(name, body, np.array(frame.placement.rotation))
        )
    return {mover: tuple(links) for mover, links in found.items()}


def mjcf_links(robot: Robot, raw: MultibodyTree, aligned: MultibodyTree) -> Links:
    """Returns the links of the MJCF's bodies, in the frames to which its tree was aligned.

    Args:
        robot: The robot.
        raw: The MJCF's tree, in its own link frames.
        aligned: The same in others.
    """
    model, mujoco_model = pinocchio_from_mujoco(robot.mj_model), robot.mj_model
    here, there = poses_at_zero(raw), poses_at_zero(aligned)
    found: dict[str, list[ComparedLink]] = {}
    for index in np.flatnonzero(mujoco_model.body_mass > 0):
        name = str(mujoco_model.body(index).name)
        frame = model.frames[model.getFrameId(name, pin.FrameType.BODY)]
        mover = _mover(robot, model, int(frame.parentJoint))
        pose = there[mover].actInv(here[mover]) * frame.placement
        own = TreeBody.of(inertia_of_body(mujoco_model, index)).moved(pose)
        found.setdefault(mover, []).append(ComparedLink(name, own, np.array(pose.rotation)))
    return {mover: tuple(links) for mover, links in found.items()}


def _mover(robot: Robot, model: pin.Model, joint: int) -> str:
    """Returns the joint that moves a frame's body, or the base."""
    name = str(model.names[joint])
    return name if name in robot.joint_names else robot.base


def fold_bodies(*bodies: TreeBody) -> TreeBody:
    """Returns one body that is made of some, all in the same frame."""
    return from_moments(sum((body_moments(body) for body in bodies), start=np.zeros(10)))


def body_moments(body: TreeBody) -> Array:
    """Returns a body's mass, first and second moments about its frame's origin (10,).

    They add up when bodies are put together: the mass (kg), the first moments (kg m), and the six
    entries of the inertia about the origin (kg m^2).
    """
    c = body.com
    about = body.inertia + body.mass * (float(c @ c) * np.eye(3) - np.outer(c, c))
    entries = [about[place] for place in INERTIA_ENTRIES.values()]
    return np.array([body.mass, *(body.mass * c), *entries])


def from_moments(values: Array) -> TreeBody:
    """Returns the body of some moments, which `moments` returns."""
    mass = float(values[0])
    com = values[1:4] / mass if mass else np.zeros(3)
    shift = mass * (float(com @ com) * np.eye(3) - np.outer(com, com))
    return TreeBody(mass, com, inertia_tensor(values[4:]) - shift)


def mass_shares(difference: Difference, urdf: Sources, mjcf: Sources) -> tuple[Diagnostic, ...]:
    """Says of which links or bodies a mass, a com or an inertia is made, with their lines."""
    if difference.kind not in ("mass", "com", "inertia"):
        return ()
    told = []
    for file, sources in (("URDF", urdf), ("MJCF", mjcf)):
        heavy = [(name, mass) for name, mass in sources.members(difference.element) if mass]
        if len(heavy) < 2:
            continue
        total = sum(mass for _, mass in heavy)
        heavy.sort(key=lambda member: -member[1])
        members_told = [
            diagnose(
                "share-of-a-body",
                subject=("body", name),
                mass=Quantity(mass, "kg"),
                share=Quantity(mass / total, "1"),
                place=str(sources.weight(difference.kind, name)),
            )
            for name, mass in heavy[:_LISTED]
        ]
        rest = total - sum(mass for _, mass in heavy[:_LISTED])
        told.append(
            diagnose(
                "body-is-made-of",
                file=file,
                members=members_told,
                more=len(heavy[_LISTED:]),
                rest=Quantity(rest, "kg"),
            )
        )
    return tuple(told)


_LISTED = 6
"""Links of a body that are listed, the heaviest first."""
