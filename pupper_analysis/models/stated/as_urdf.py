"""A robot model as a URDF in memory: what compares files compares it, and names its own places."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from lxml import etree

from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.models.attributes import JOINT_ATTRIBUTES
from pupper_analysis.models.places import refuse_file
from pupper_analysis.models.stated.as_mjcf import joints_without, notes_of
from pupper_analysis.models.stated.model import (
    BALL,
    FIXED,
    FREE,
    HINGE,
    SLIDE,
    Joint,
    Link,
    Pose,
)
from pupper_analysis.models.stated.usd import UsdModel, read_usd_model
from pupper_analysis.models.unlimited import ENDLESS_SLIDE
from pupper_analysis.models.urdf_file import UrdfFile, urdf_from
from pupper_analysis.models.urdf_tree import UrdfTree
from pupper_analysis.models.usd_file import PrimPlaces, UsdFile, read_usd
from pupper_analysis.models.xml import to_text


@dataclass(frozen=True, eq=False)
class UsdAsUrdf(PrimPlaces, UrdfFile):
    """A USD that can be asked what a URDF is asked.

    Attributes:
        usd: The file, to whose prims the places lead.
        gains: {joint: stiffness and damping of its servo}, see `UsdModel.gains`.
    """

    usd: UsdFile | None = None
    gains: Mapping[str, tuple[float, float]] = field(default_factory=dict)


def read_usd_as_urdf(path: Path) -> UsdAsUrdf:
    """Reads a USD as a URDF of the same numbers.

    Raises:
        ModelError: If it cannot be read, or says what no URDF can.
        MissingPackageError: If usd-core is not installed.
    """
    file = read_usd(path)
    model = read_usd_model(file)
    root = urdf_of(model).root
    made = urdf_from(path, to_text(root), root, {})
    notes: list[Diagnostic] = [diagnose("usd-compared-as-urdf", file=path.name), *model.notes]
    notes += notes_of(model)
    if model.loops:
        notes.append(diagnose("usd-loops-left-out", joints=[edge.name for edge in model.loops]))
    unknown = {"effort": joints_without(model, "effort")}
    if unknown["effort"]:
        notes.append(diagnose("usd-efforts-unknown", joints=unknown["effort"]))
    told = (*notes, *(note for note in made.notes if note.code != "effort-or-velocity-unstated"))
    return UsdAsUrdf(path, made.text, made.root, {}, told, unknown, file, model.gains)


def urdf_of(model: UsdModel) -> UrdfTree:
    """Writes a model as a URDF: links, joints and inertials of the base's tree; no shapes.

    Raises:
        ModelError: If a joint moves in a way that no URDF's joint does.
    """
    tree = UrdfTree(etree.Element("robot", name=model.file.path.stem))
    names = [model.base, *(link.name for link in model.descendants(model.base))]
    poses: dict[str, Pose] = {}
    if any(joint.moves for joint in model.links[model.base].joints):  # the world holds it so
        tree.new_link("world")
        poses["world"] = model.mount.inverse()
    # A URDF's joint is at the origin of the link that it moves: the frames are put there.
    poses |= {name: _frame(model.links[name]) for name in names}
    for name in names:
        link, added = model.links[name], tree.new_link(name)
        if link.inertial is not None:
            added.set_inertia((poses[name].inverse() * link.pose).placed.act(link.inertial.rigid))
        for joint in link.joints:
            if joint.parent not in poses:
                continue  # a free base has no joint
            if joint.kind in (BALL, FREE):
                place = model.file.place("joint", joint.name)
                raise refuse_file(place, diagnose("usd-joint-of-several-axes"))
            _add_joint(tree, model, joint, poses)
    return tree


def _frame(link: Link) -> Pose:
    joints = [joint for joint in link.joints if joint.moves]
    return Pose(joints[0].position, link.pose.rotation) if joints else link.pose


def _add_joint(tree: UrdfTree, model: UsdModel, joint: Joint, poses: Mapping[str, Pose]) -> None:
    """Adds a joint, of where the links' frames are in the base's."""
    frame = poses[joint.child]
    endless = not (math.isfinite(joint.lower) or math.isfinite(joint.upper))
    kinds = {HINGE: "continuous" if endless else "revolute", SLIDE: "prismatic", FIXED: "fixed"}
    placed = (poses[joint.parent].inverse() * frame).placed
    added = tree.new_joint(joint.name, kinds[joint.kind], joint.parent, joint.child, placed)
    if not joint.moves:
        return
    added.set_axis(frame.rotation.T @ joint.axis)
    stated: Mapping[str, float] = joint.stated
    if not (endless and joint.kind == HINGE):
        ends = np.clip((joint.lower, joint.upper), -ENDLESS_SLIDE, ENDLESS_SLIDE)
        stated = {**stated, "lower limit": float(ends[0]), "upper limit": float(ends[1])}
    for one in JOINT_ATTRIBUTES:
        if one.urdf is not None and one.kind in stated:
            added.state(one, stated[one.kind])
    mimic = model.edges[joint.name].mimic
    if mimic is not None:
        added.follow(*mimic)
