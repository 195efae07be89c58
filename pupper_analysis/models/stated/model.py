"""A robot as its file states it, the same for each format: what looks at it is written once.

Unlike in an engine's model, links that are fixed to others are kept apart, as in the file.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property

import mujoco
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.base.arrays import inertia_of
from pupper_analysis.base.diagnostics import Diagnostic
from pupper_analysis.models.attributes import JointAttribute
from pupper_analysis.models.mjcf_file import MjcfFile
from pupper_analysis.models.places import Place
from pupper_analysis.models.shapes import Pose, Shape
from pupper_analysis.models.urdf_file import UrdfFile

Array = NDArray[np.float64]


HINGE, SLIDE, BALL, FREE, FIXED = "hinge", "slide", "ball", "free", "fixed"


@dataclass(frozen=True, eq=False)
class Inertial:
    """What a file states, or what follows from shapes.

    Attributes:
        mass: kg.
        com: (3,) in the body's frame (m).
        inertia: (3, 3) about the com, in the body's axes (kg m^2).
        stated: Whether the file states it, and does not leave it to the shapes.
        rounding: Half a unit of the last digit of the stated inertia, at most (kg m^2).
    """

    mass: float
    com: Array
    inertia: Array
    stated: bool
    rounding: float = 0.0

    @staticmethod
    def of(inertia: pin.Inertia, *, stated: bool, rounding: float = 0.0) -> Inertial:
        """Returns what an inertia is, in the body's frame."""
        com, tensor = np.array(inertia.lever), np.array(inertia.inertia)
        return Inertial(float(inertia.mass), com, tensor, stated, rounding)

    @property
    def rigid(self) -> pin.Inertia:
        """The same, as it is moved and added up."""
        return inertia_of(self.mass, self.com, self.inertia)

    @property
    def moments(self) -> Array:
        """The principal moments (kg m^2), ascending; NaN if the inertia is beyond all numbers."""
        if not np.isfinite(self.inertia).all():
            return np.full(3, np.nan)
        return np.asarray(np.linalg.eigvalsh(self.inertia), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class Joint:
    """A joint.

    Attributes:
        name: Its name.
        kind: One of HINGE, SLIDE, BALL, FREE, FIXED.
        parent: The body it is fixed to.
        child: The body it moves.
        position: (3,) at zero angles, in the base frame (m).
        axis: (3,) unit vector at zero angles, in the base frame; (0, 0, 0) where it has none.
        raw_axis: (3,) as written.
        stated: {kind of a number: its value} of what the file states of it, as in `attributes`: in
            the unit of the format's joints, an effort as it acts at the joint. What it does not
            state is not there: unknown is not zero.
        lower: rad or m; -inf if unlimited.
        upper: rad or m.
        effort: N m or N; inf if unlimited.
    """

    name: str
    kind: str
    parent: str
    child: str
    position: Array
    axis: Array
    raw_axis: Array
    stated: Mapping[str, float]
    lower: float
    upper: float
    effort: float

    @property
    def moves(self) -> bool:
        """Whether it is a hinge or a slide."""
        return self.kind in (HINGE, SLIDE)

    @property
    def unit(self) -> str:
        """The unit of its coordinate."""
        return "m" if self.kind == SLIDE else "rad"


@dataclass(frozen=True, eq=False)
class Frame:
    """A named frame on a body: a site of an MJCF.

    Attributes:
        name: Its name.
        position: (3,) in the body's frame (m).
    """

    name: str
    position: Array


@dataclass(frozen=True, eq=False)
class Link:
    """A link of a URDF, a body of an MJCF.

    Attributes:
        name: Its name.
        parent: Its parent's; None for a root (a child of the world).
        pose: At zero angles, in the base frame.
        joints: Those between its parent and it (several only in an MJCF).
        inertial: None if the file gives it neither mass nor shapes with mass.
        shapes: Drawn or touching.
        frames: Named frames on it.
    """

    name: str
    parent: str | None
    pose: Pose
    joints: tuple[Joint, ...]
    inertial: Inertial | None
    shapes: tuple[Shape, ...]
    frames: tuple[Frame, ...] = ()

    @property
    def moving(self) -> bool:
        """Whether it can move relative to its parent."""
        return any(joint.kind != FIXED for joint in self.joints)

    @property
    def mass(self) -> float:
        """In kg; 0 where none is stated."""
        return 0.0 if self.inertial is None else self.inertial.mass


@dataclass(frozen=True, eq=False)
class RobotModel:
    """A model.

    Attributes:
        format: ``"urdf"``, ``"mjcf"``, or the name of another.
        link_tag: What a body is called in the format.
        base: The name of the base; "" if there is no body.
        links: By name, parents first.
        notes: What was left out.
    """

    format: str
    link_tag: str
    base: str
    links: dict[str, Link]
    notes: tuple[Diagnostic, ...]

    @cached_property
    def joints(self) -> dict[str, Joint]:
        """All joints, by name."""
        return {joint.name: joint for body in self.links.values() for joint in body.joints}

    @cached_property
    def total_mass(self) -> float:
        """Of all bodies (kg)."""
        return sum(body.mass for body in self.links.values())

    @cached_property
    def _children(self) -> dict[str, list[Link]]:
        children: dict[str, list[Link]] = {name: [] for name in self.links}
        for body in self.links.values():
            if body.parent is not None:
                children[body.parent].append(body)
        return children

    @property
    def in_degrees(self) -> bool:
        """Whether the file states angles in degrees."""
        return False

    def inertial_part(self, part: str) -> str:
        """Returns where the mass, origin or inertia of a body stands below it in the format."""
        return f"inertial/{part}" if self.format == "urdf" else "inertial"

    def words(self, attribute: JointAttribute) -> tuple[str, str | None]:
        """Returns what a joint's number is called in the format, and where it is below a joint."""
        if self.format == "urdf" and attribute.urdf is not None:
            return " ".join(attribute.urdf), attribute.urdf[0]
        return (attribute.mjcf or (attribute.kind,))[0], None

    def children(self, name: str) -> list[Link]:
        """Returns the bodies whose parent is the one named."""
        return self._children[name]

    def descendants(self, name: str) -> Iterator[Link]:
        """Yields the children of a body, their children, and so on."""
        for child in self.children(name):
            yield child
            yield from self.descendants(child.name)

    def fixed_group(self, name: str) -> list[Link]:
        """Returns a body and all that is fixed to it, directly or not; nothing of the world."""
        if name not in self.links:
            return []
        group = [self.links[name]]
        for child in self.children(name):
            if not child.moving:
                group += self.fixed_group(child.name)
        return group

    def carrier(self, name: str) -> str:
        """Returns the moving body, or root, to which a body is fixed; the world is its own."""
        link = self.links.get(name)
        while link is not None and not link.moving and link.parent is not None:
            name = link.parent
            link = self.links.get(name)
        return name

    def is_negligible(self, body: Link) -> bool:
        """Whether a body weighs less than 1e-4 of all: a placeholder, or a label stuck on."""
        return body.mass < 1e-4 * self.total_mass

    def ancestors(self, name: str) -> Iterator[str]:
        """Yields the parent of a body, its parent, and so on."""
        parent = self.links[name].parent
        while parent is not None:
            yield parent
            parent = self.links[parent].parent


@dataclass(frozen=True, eq=False)
class UrdfModel(RobotModel):
    """A model in a URDF.

    Attributes:
        file: The file.
    """

    file: UrdfFile


@dataclass(frozen=True, eq=False)
class MjcfModel(RobotModel):
    """A model in an MJCF.

    Attributes:
        file: The file.
        mj_model: What MuJoCo makes of it; None if it refuses it.
        refusal: MuJoCo's message if it refuses the file as it stands, and the place it names.
        body_names: The name here of each of MuJoCo's bodies, by id.
    """

    file: MjcfFile
    mj_model: mujoco.MjModel | None
    refusal: tuple[Diagnostic, Place] | None
    body_names: tuple[str, ...]

    @property
    def in_degrees(self) -> bool:
        """Whether the file states angles in degrees."""
        return bool(self.file.spec.compiler.degree)
