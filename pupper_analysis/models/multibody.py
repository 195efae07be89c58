"""A tree of joints and the bodies that they move, as two files share it: joints, inertias, frames.

Fixed children are folded into the body that carries them. Frames of bodies are a matter of choice:
two files can describe one robot with different link frames. `matching.alignment` brings the frames
of one set to those of another.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.base.arrays import inertia_of
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ModelError
from pupper_analysis.models.attributes import JOINT_ATTRIBUTES

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class TreeBody:
    """A moving body.

    Attributes:
        mass: kg.
        com: (3,) in the body's frame (m).
        inertia: (3, 3) about the com, in the body's axes (kg m^2).
        link: What the file calls it: the link, or MuJoCo's body, that the joint moves, to which
            others may be fixed; empty if that is not known.
    """

    mass: float
    com: Array
    inertia: Array
    link: str = ""

    @staticmethod
    def of(inertia: pin.Inertia, link: str = "") -> TreeBody:
        """Returns the body of an inertia in its frame."""
        tensor = np.array(inertia.inertia)
        return TreeBody(float(inertia.mass), np.array(inertia.lever), tensor, link)

    @property
    def rigid(self) -> pin.Inertia:
        """Its inertia, in its frame."""
        return inertia_of(self.mass, self.com, self.inertia)

    def moved(self, pose: pin.SE3) -> TreeBody:
        """Returns it in the frame in which its own stands in a pose."""
        turn = np.array(pose.rotation)
        com, inertia = np.array(pose.act(self.com)), turn @ self.inertia @ turn.T
        return replace(self, com=com, inertia=inertia)


@dataclass(frozen=True, eq=False)
class TreeJoint:
    """A joint, and how the body that it moves is attached to its parent.

    Attributes:
        parent: The joint that moves the parent body, or the base's name.
        position: (3,) of the joint, in the parent body's frame (m).
        rotation: (3, 3) from the body's axes to the parent's, at zero.
        axis: (3,) unit vector in the body's frame.
        slides: Whether it is prismatic.
        lower: rad (or m).
        upper: rad (or m).
        effort: N m (or N).
        velocity: rad/s (or m/s); infinite where a file cannot state it.
        armature: kg m^2 (or kg).
        damping: N m s/rad (or N s/m).
        friction: N m (or N).
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
        """Where the body is in its parent, at zero."""
        return pin.SE3(self.rotation, self.position)

    def placed(self, placement: pin.SE3) -> TreeJoint:
        """Returns it elsewhere."""
        position, rotation = np.array(placement.translation), np.array(placement.rotation)
        return replace(self, position=position, rotation=rotation)


@dataclass(frozen=True, eq=False)
class MultibodyTree:
    """A robot as a tree of joints.

    Attributes:
        base: The base's name.
        floating: Whether the base is free.
        bodies: {base or joint: the body it moves}.
        joints: {joint: joint}, parents first.
        frames: {frame: (base or joint that moves it, (3,) position in that body's frame (m))}.
        gravity: (3,) m/s^2.
        base_damping: Of the free joint, in all six directions: an MJCF's default class may give it
            some (N s/m and N m s/rad).
        base_armature: Likewise (kg and kg m^2).
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
        """Returns the joints whose parent is a body."""
        return list(self._children.get(body, ()))  # of its own: callers take from it

    @cached_property
    def _children(self) -> dict[str, list[str]]:
        found: dict[str, list[str]] = {}
        for name, joint in self.joints.items():
            found.setdefault(joint.parent, []).append(name)
        return found

    def carried_by(self, body: str) -> list[str]:
        """Returns the frames that a body carries."""
        return list(self._carried.get(body, ()))

    @cached_property
    def _carried(self) -> dict[str, list[str]]:
        found: dict[str, list[str]] = {}
        for name, (owner, _) in self.frames.items():
            found.setdefault(owner, []).append(name)
        return found

    def parents_first(self) -> list[str]:
        """Returns the joints branch by branch: Pinocchio wants each subtree in one piece."""
        return self.below(self.base)

    def below(self, body: str) -> list[str]:
        """Returns all joints that a body carries, branch by branch, parents first."""
        order: list[str] = []
        waiting = self.children(body)[::-1]
        while waiting:
            order.append(waiting.pop())
            waiting += self.children(order[-1])[::-1]
        return order

    def part(self, names: Collection[str]) -> MultibodyTree:
        """Returns some joints alone, the bodies that they move, and the frames on those."""
        frames = [frame for name in names for frame in self.carried_by(name)]
        return replace(
            self,
            bodies={name: self.bodies[name] for name in names},
            joints={name: self.joints[name] for name in names},
            frames={frame: self.frames[frame] for frame in frames},
        )


_OF_PINOCCHIO = tuple(one for one in JOINT_ATTRIBUTES if one.pinocchio)


def from_pinocchio(
    model: pin.Model, base: str, joint_names: Iterable[str], frames: Mapping[str, str]
) -> MultibodyTree:
    """Reads the parameters of a Pinocchio model.

    Args:
        model: The model; joints of one degree of freedom, and a free flyer if the base is free.
        base: A name for the base.
        joint_names: The joints.
        frames: {name: BODY frame of the model}.

    Raises:
        ModelError: If a joint is called like the base: bodies go by the joints that move them.
    """
    names = set(joint_names)
    if base in names:
        raise ModelError(model.name, diagnose("joint-named-like-base", subject=("link", base)))
    floating = model.nv > len(names)
    root = 1 if floating else 0
    owner = {0: base, root: base}
    links = _links(model)
    bodies = {base: TreeBody.of(model.inertias[root], links.get(root, ""))}
    joints: dict[str, TreeJoint] = {}
    for index in range(root + 1, model.njoints):
        name = str(model.names[index])
        owner[index] = name
        kind = model.joints[index]
        # Of the joint alone: the data of a model grow with the square of its size, and more.
        motion = np.array(kind.createData().S).reshape(6)
        slides = not motion[3:].any()
        q, v = kind.idx_q, kind.idx_v
        bounded = kind.nq == 1
        joints[name] = TreeJoint(
            parent=owner[int(model.parents[index])],
            position=np.array(model.jointPlacements[index].translation),
            rotation=np.array(model.jointPlacements[index].rotation),
            axis=motion[:3] if slides else motion[3:],
            slides=slides,
            lower=float(model.lowerPositionLimit[q]) if bounded else -np.inf,
            upper=float(model.upperPositionLimit[q]) if bounded else np.inf,
            **{one.field: float(getattr(model, one.pinocchio)[v]) for one in _OF_PINOCCHIO},
        )
        bodies[name] = TreeBody.of(model.inertias[index], links.get(index, ""))
    places = {}
    for name, frame in frames.items():
        found = model.frames[model.getFrameId(frame, pin.FrameType.BODY)]
        places[name] = (owner[int(found.parentJoint)], np.array(found.placement.translation))
    return MultibodyTree(
        base=base,
        floating=floating,
        bodies=bodies,
        joints=joints,
        frames=places,
        gravity=np.array(model.gravity.linear),
        base_damping=float(model.damping[0]) if floating else 0.0,
        base_armature=float(model.armature[0]) if floating else 0.0,
    )


def joint_placements(model: pin.Model, q: Array) -> list[pin.SE3]:
    """Returns where each joint of a model is, the universe first, at Pinocchio's q (model.nq,).

    Without the data of the model, which grow with the cube of its size.
    """
    placements = [pin.SE3.Identity()]
    for index in range(1, model.njoints):
        kind = model.joints[index]
        data = kind.createData()
        kind.calc(data, q)
        above = placements[model.parents[index]]
        placements.append(above * model.jointPlacements[index] * data.M)
    return placements


def _links(model: pin.Model) -> dict[int, str]:
    """Returns {joint: the link that it moves}: the first of those that move with it."""
    found: dict[int, str] = {}
    for frame in model.frames:
        if frame.type == pin.FrameType.BODY:
            found.setdefault(int(frame.parentJoint), str(frame.name))
    return found


_OF_BODIES = ("mass", "com", "inertia")
_OF_JOINTS = {
    **{kind: kind for kind in ("position", "rotation", "axis", "parent")},
    "type": "slides",
    **{one.kind: one.field for one in JOINT_ATTRIBUTES if one.field},
}
"""{kind of a difference: the field of `TreeJoint`}."""


def with_value_of(one: MultibodyTree, two: MultibodyTree, kind: str, element: str) -> MultibodyTree:
    """Returns a robot with another's value of one thing.

    Args:
        one: The robot.
        two: The other, with bodies, joints and frames of the same names.
        kind: What is taken, as a `Difference` between the two is called.
        element: Of which body, joint or frame; what is of the robot as a whole takes the base's.
    """
    if kind in _OF_BODIES:
        body = replace(one.bodies[element], **{kind: getattr(two.bodies[element], kind)})
        return replace(one, bodies={**one.bodies, element: body})
    if kind == "frame":
        return replace(one, frames={**one.frames, element: two.frames[element]})
    if kind == "gravity" or element not in one.joints:
        field = kind if kind == "gravity" else f"base_{kind}"
        return replace(one, **{field: getattr(two, field)})
    field = _OF_JOINTS[kind]
    joint = replace(one.joints[element], **{field: getattr(two.joints[element], field)})
    taken = replace(one, joints={**one.joints, element: joint})
    if kind == "parent" and len(taken.parents_first()) < len(taken.joints):
        # That parent alone closes a ring of joints: all of them are taken.
        joints = {n: replace(j, parent=two.joints[n].parent) for n, j in one.joints.items()}
        return replace(one, joints=joints)
    return taken
