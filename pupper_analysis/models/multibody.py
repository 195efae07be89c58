"""``MultibodyTree``: joints, bodies and frames of a robot, for comparison of two files.

Bodies that are fixed to each other are merged to one body. Link frames are a convention: two files
can describe the same robot with different link frames. `robot.matching.alignment` transforms the
frames of one tree to the frames of another tree.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pinocchio as pin

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.arrays import make_inertia
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ModelError
from pupper_analysis.models.attributes import JOINT_ATTRIBUTES, JointAttribute, known_limit


@dataclass(frozen=True, eq=False)
class TreeBody:
    """Moving body, merged with all bodies fixed to it.

    Attributes:
        mass: Mass [kg].
        com: Centre of mass (3,) [m] in the frame of the body.
        inertia: Inertia (3, 3) [kg m^2] about the CoM, in the axes of the body.
        link: Link, or MuJoCo body, that the joint moves; "" if unknown.
    """

    mass: float
    com: Array
    inertia: Array
    link: str = ""

    @staticmethod
    def of(inertia: pin.Inertia, link: str = "") -> TreeBody:
        """Convert a spatial inertia of Pinocchio to a body, expressed in the same frame.

        Args:
            inertia: Mass [kg], CoM [m] and rotational inertia [kg m^2].
            link: Link of the URDF, or body of the MJCF; "" if unknown.
        """
        tensor = np.array(inertia.inertia)
        return TreeBody(float(inertia.mass), np.array(inertia.lever), tensor, link)

    @property
    def spatial_inertia(self) -> pin.Inertia:
        """Spatial inertia of this body [kg, m, kg m^2], in the frame of the body."""
        return make_inertia(self.mass, self.com, self.inertia)

    def transform(self, pose: pin.SE3) -> TreeBody:
        """Express CoM and inertia of this body in another frame; return a copy.

        Args:
            pose: Pose of the body's current frame in the new frame.
        """
        rotation = np.array(pose.rotation)
        com, inertia = np.array(pose.act(self.com)), rotation @ self.inertia @ rotation.T
        return replace(self, com=com, inertia=inertia)


@dataclass(frozen=True, eq=False)
class TreeJoint:
    """Hinge or slide: parent, pose of the moved body in the parent body, axis and parameters.

    Attributes:
        parent: Name of the parent body: of the joint that moves it, or of the base.
        position: Position (3,) [m] in the frame of the parent body.
        rotation: Rotation (3, 3) from the axes of the moved body to the axes of the parent body, at
            a joint position of zero.
        axis: Unit vector (3,) in the frame of the moved body.
        slides: Whether the joint is prismatic.
        lower: Lower limit [rad, m].
        upper: Upper limit [rad, m].
        effort: Effort limit [N m, N]; infinite if not stated.
        velocity: Velocity limit [rad/s, m/s]; infinite if not stated.
        armature: Armature [kg m^2, kg].
        damping: Damping [N m s/rad, N s/m].
        friction: Friction loss [N m, N].
    """

    parent: str
    position: Array
    rotation: Array
    axis: Array
    slides: bool
    lower: float
    upper: float
    effort: float
    velocity: float
    armature: float
    damping: float
    friction: float

    @property
    def placement(self) -> pin.SE3:
        """Pose of the body in the frame of the parent body, at a joint position of zero."""
        return pin.SE3(self.rotation, self.position)

    def with_placement(self, placement: pin.SE3) -> TreeJoint:
        """Return a copy of the joint with another pose of the moved body in the parent body."""
        position, rotation = np.array(placement.translation), np.array(placement.rotation)
        return replace(self, position=position, rotation=rotation)


@dataclass(frozen=True, eq=False)
class MultibodyTree:
    """Robot as a tree of joints; a body, except the base, has the name of the joint that moves it.

    Attributes:
        base: Name of the base.
        floating: Whether the base is free.
        bodies: {base or joint: moved body}.
        joints: {name: joint}; parents first in a tree of `from_pinocchio`.
        frames: {frame: (base or joint that moves the frame, position (3,) [m] in the frame of the
            moved body)}.
        gravity: Gravity (3,) [m/s^2].
        base_damping: Damping of the free joint in all six directions [N s/m, N m s/rad]; an MJCF
            may set the damping by a default class.
        base_armature: Armature of the free joint in all six directions [kg, kg m^2].
    """

    base: str
    floating: bool
    bodies: Mapping[str, TreeBody]
    joints: Mapping[str, TreeJoint]
    frames: Mapping[str, tuple[str, Array]]
    gravity: Array
    base_damping: float = 0.0
    base_armature: float = 0.0

    def children(self, body: str) -> list[str]:
        """Return the names of the child joints of a body, as a new list.

        Args:
            body: Name of the base, or of the joint that moves the body.
        """
        return list(self._children_by_body.get(body, ()))

    @cached_property
    def _children_by_body(self) -> dict[str, list[str]]:
        """{body: joints whose parent is the body}, for bodies with such joints."""
        found: dict[str, list[str]] = {}
        for name, joint in self.joints.items():
            found.setdefault(joint.parent, []).append(name)
        return found

    def list_frames(self, body: str) -> list[str]:
        """Return the names of the frames that are fixed to a body.

        Args:
            body: Name of the base, or of the joint that moves the body.
        """
        return list(self._frames_by_body.get(body, ()))

    @cached_property
    def _frames_by_body(self) -> dict[str, list[str]]:
        """{body: frames that are fixed to the body}, for bodies with frames."""
        found: dict[str, list[str]] = {}
        for name, (owner, _) in self.frames.items():
            found.setdefault(owner, []).append(name)
        return found

    def parents_first(self) -> list[str]:
        """Return the names of all joints below the base in depth-first order."""
        return self.list_descendants(self.base)

    def list_descendants(self, body: str) -> list[str]:
        """Return the names of all joints below a body, in depth-first order.

        Args:
            body: Name of the base, or of the joint that moves the body.
        """
        order: list[str] = []
        pending = self.children(body)[::-1]
        while pending:
            order.append(pending.pop())
            pending += self.children(order[-1])[::-1]
        return order

    def select_joints(self, names: Collection[str]) -> MultibodyTree:
        """Return a tree with some of the joints, and the bodies and frames that these joints move.

        Args:
            names: Joints. The base with its body and frames is not included.
        """
        frames = [frame for name in names for frame in self.list_frames(name)]
        return replace(
            self,
            bodies={name: self.bodies[name] for name in names},
            joints={name: self.joints[name] for name in names},
            frames={frame: self.frames[frame] for frame in frames},
        )


_PINOCCHIO_ATTRIBUTES = tuple(attribute for attribute in JOINT_ATTRIBUTES if attribute.pinocchio)
"""Joint parameters that a Pinocchio model contains."""


def _read_attribute(model: pin.Model, attribute: JointAttribute, index: int) -> float:
    """Return an attribute of the joint with a velocity index; inf for an unknown limit."""
    value = float(getattr(model, attribute.pinocchio)[index])
    return known_limit(value) if attribute.unstated == math.inf else value


def from_pinocchio(
    model: pin.Model, base: str, joint_names: Iterable[str], frames: Mapping[str, str]
) -> MultibodyTree:
    """Return the multibody tree of a Pinocchio model.

    Args:
        model: Model with joints of one degree of freedom; with a free flyer if the base is free.
        base: Name that the base gets in the tree.
        joint_names: Names of all joints with one degree of freedom. If the model has more degrees
            of freedom, the base is free.
        frames: {name in the tree: BODY frame of the model}.

    Raises:
        ModelError: If a joint has the name of the base, because bodies are named by joint names.
    """
    names = set(joint_names)
    if base in names:
        raise ModelError(model.name, diagnose("joint-named-like-base", subject=("link", base)))
    floating = model.nv > len(names)
    root = 1 if floating else 0
    body_by_joint = {0: base, root: base}
    links = _find_links(model)
    bodies = {base: TreeBody.of(model.inertias[root], links.get(root, ""))}
    joints: dict[str, TreeJoint] = {}
    for index in range(root + 1, model.njoints):
        name = str(model.names[index])
        body_by_joint[index] = name
        joint_model = model.joints[index]
        # Data of the joint only: the data of the model grow with at least the square of its size.
        motion = np.array(joint_model.createData().S).reshape(6)
        slides = not motion[3:].any()
        q, v = joint_model.idx_q, joint_model.idx_v
        bounded = joint_model.nq == 1
        joints[name] = TreeJoint(
            parent=body_by_joint[int(model.parents[index])],
            position=np.array(model.jointPlacements[index].translation),
            rotation=np.array(model.jointPlacements[index].rotation),
            axis=motion[:3] if slides else motion[3:],
            slides=slides,
            lower=float(model.lowerPositionLimit[q]) if bounded else -np.inf,
            upper=float(model.upperPositionLimit[q]) if bounded else np.inf,
            **{
                attribute.field: _read_attribute(model, attribute, v)
                for attribute in _PINOCCHIO_ATTRIBUTES
            },
        )
        bodies[name] = TreeBody.of(model.inertias[index], links.get(index, ""))
    frame_positions = {}
    for name, frame in frames.items():
        pin_frame = model.frames[model.getFrameId(frame, pin.FrameType.BODY)]
        frame_positions[name] = (
            body_by_joint[int(pin_frame.parentJoint)],
            np.array(pin_frame.placement.translation),
        )
    return MultibodyTree(
        base=base,
        floating=floating,
        bodies=bodies,
        joints=joints,
        frames=frame_positions,
        gravity=np.array(model.gravity.linear),
        base_damping=float(model.damping[0]) if floating else 0.0,
        base_armature=float(model.armature[0]) if floating else 0.0,
    )


def joint_placements(model: pin.Model, q: Array) -> list[pin.SE3]:
    """Return the world placement of each joint of a Pinocchio model, without ``pin.Data``.

    ``pin.Data`` is avoided because its size grows at least with the square of the number of joints.

    Args:
        model: Pinocchio model.
        q: Pinocchio's configuration, shape (model.nq,).

    Returns:
        Placements [m], in the order of the joint indices. Element 0 belongs to Pinocchio's joint
        "universe" and is the identity.
    """
    placements = [pin.SE3.Identity()]
    for index in range(1, model.njoints):
        joint_model = model.joints[index]
        data = joint_model.createData()
        joint_model.calc(data, q)
        parent_placement = placements[model.parents[index]]
        placements.append(parent_placement * model.jointPlacements[index] * data.M)
    return placements


def _find_links(model: pin.Model) -> dict[int, str]:
    """Return {joint index: first link that the joint moves}."""
    links: dict[int, str] = {}
    for frame in model.frames:
        if frame.type == pin.FrameType.BODY:
            links.setdefault(int(frame.parentJoint), str(frame.name))
    return links


_BODY_FIELDS = ("mass", "com", "inertia")
"""Fields of `TreeBody` that a comparison evaluates; also the kinds of differences of bodies."""

_JOINT_FIELDS = {
    **{kind: kind for kind in ("position", "rotation", "axis", "parent")},
    "type": "slides",
    **{attribute.kind: attribute.field for attribute in JOINT_ATTRIBUTES if attribute.field},
}
"""{kind of a difference between two models' joints: field of `TreeJoint` with the value}."""


def copy_value(
    tree: MultibodyTree, source: MultibodyTree, kind: str, element: str
) -> MultibodyTree:
    """Return a copy of a tree with one value of another tree, such as a mass or a joint axis.

    If a new parent of a joint creates a loop, the parents of all joints are copied.

    Args:
        tree: Tree to modify; the result is a copy.
        source: Tree with the new value, and with the same names of bodies, joints and frames.
        kind: Kind of the value, as in a `Difference` between the trees.
        element: Body, joint or frame. For values of the whole robot, the base.
    """
    if kind in _BODY_FIELDS:
        body = replace(tree.bodies[element], **{kind: getattr(source.bodies[element], kind)})
        return replace(tree, bodies={**tree.bodies, element: body})
    if kind == "frame":
        return replace(tree, frames={**tree.frames, element: source.frames[element]})
    if kind == "gravity" or element not in tree.joints:
        field = kind if kind == "gravity" else f"base_{kind}"
        return replace(tree, **{field: getattr(source, field)})
    field = _JOINT_FIELDS[kind]
    joint = replace(tree.joints[element], **{field: getattr(source.joints[element], field)})
    modified = replace(tree, joints={**tree.joints, element: joint})
    if kind == "parent" and len(modified.parents_first()) < len(modified.joints):
        # The parents form a loop.
        joints = {
            name: replace(old_joint, parent=source.joints[name].parent)
            for name, old_joint in tree.joints.items()
        }
        return replace(tree, joints=joints)
    return modified
