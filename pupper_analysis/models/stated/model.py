"""Robot model as specified by a file, independent of the format.

Links that are fixed to other links remain separate, unlike in the models of the engines.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property

import mujoco
import numpy as np
import pinocchio as pin

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.arrays import make_inertia
from pupper_analysis.base.diagnostics import Diagnostic
from pupper_analysis.base.units import JointUnits, select_joint_units
from pupper_analysis.models.attributes import JointAttribute
from pupper_analysis.models.mjcf_file import MjcfFile
from pupper_analysis.models.places import Place
from pupper_analysis.models.shapes import Pose, Shape
from pupper_analysis.models.urdf_file import UrdfFile
from pupper_analysis.models.urdf_tree import WORLD_LINK

HINGE_JOINT = "hinge"
"""Kind of a joint that rotates about an axis."""

SLIDE_JOINT = "slide"
"""Kind of a joint that translates along an axis."""

BALL_JOINT = "ball"
"""Kind of a joint with three rotations."""

FREE_JOINT = "free"
"""Kind of a joint with six degrees of freedom; also of other joints, such as a planar joint of a
URDF."""

FIXED_JOINT = "fixed"
"""Kind of a joint without motion."""


@dataclass(frozen=True, eq=False)
class Inertial:
    """Mass, CoM and inertia of a link, specified by the file or derived from the shapes.

    Attributes:
        mass: Mass [kg].
        com: Centre of mass (3,) [m] in the frame of the body.
        inertia: Inertia (3, 3) [kg m^2] about the CoM, in the axes of the body.
        stated: Whether the file specifies the values; otherwise the values are derived from the
            shapes.
        rounding: Largest rounding error [kg m^2] of the specified entries: half a unit of the last
            digit of an entry that is not zero.
    """

    mass: float
    com: Array
    inertia: Array
    stated: bool
    rounding: float = 0.0

    @staticmethod
    def of(inertia: pin.Inertia, *, stated: bool, rounding: float = 0.0) -> Inertial:
        """Convert a spatial inertia [kg, m, kg m^2] to an `Inertial`, expressed in the same frame.

        Args:
            inertia: Spatial inertia.
            stated: Whether the file specifies the values.
            rounding: Largest rounding error of the inertia's entries [kg m^2].
        """
        com, tensor = np.array(inertia.lever), np.array(inertia.inertia)
        return Inertial(float(inertia.mass), com, tensor, stated, rounding)

    @property
    def spatial_inertia(self) -> pin.Inertia:
        """Spatial inertia [kg, m, kg m^2], expressed in the frame of the body."""
        return make_inertia(self.mass, self.com, self.inertia)

    @property
    def moments(self) -> Array:
        """Principal moments of inertia (3,) [kg m^2], ascending; NaN if an entry is not finite."""
        if not np.isfinite(self.inertia).all():
            return np.full(3, np.nan)
        return np.asarray(np.linalg.eigvalsh(self.inertia), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class Joint:
    """Joint of a robot model, as specified by a file, in the base frame.

    Attributes:
        name: Name of the joint.
        kind: ``HINGE_JOINT``, ``SLIDE_JOINT``, ``BALL_JOINT``, ``FREE_JOINT`` or ``FIXED_JOINT``.
        parent: Parent body of the joint.
        child: Body that the joint moves.
        position: Position (3,) [m] in the base frame, with all joint positions zero.
        axis: Unit vector (3,) in the base frame, with all joint positions zero; (0, 0, 0) for an
            axis of zero, and for ball and free joints of an MJCF.
        raw_axis: Axis (3,) as in the file.
        stated: {kind of parameter, such as ``damping`` (`attributes`): value} of the parameters
            that the file specifies, in SI units. An effort is converted to a torque at the joint.
            Missing parameters are unknown, not zero.
        lower: Lower limit [rad, m]; -inf if unlimited.
        upper: Upper limit [rad, m]; inf if unlimited.
        effort: Effort limit [N m, N]; inf if the file states no limit.
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
        """Whether the joint is a hinge or a slide."""
        return self.kind in (HINGE_JOINT, SLIDE_JOINT)

    @property
    def units(self) -> JointUnits:
        """Units of position, velocity, effort etc. of the joint."""
        return select_joint_units(slides=self.kind == SLIDE_JOINT)

    @property
    def unit(self) -> str:
        """Unit of the joint coordinate, rad or m."""
        return self.units.position


@dataclass(frozen=True, eq=False)
class Frame:
    """Named frame on a body: a site of an MJCF.

    Attributes:
        name: Name of the frame.
        position: Position (3,) [m] in the frame of the body.
    """

    name: str
    position: Array


@dataclass(frozen=True, eq=False)
class Link:
    """Link of a URDF, or body of an MJCF.

    Attributes:
        name: Name of the link.
        parent: Parent link; None for a root (a child of the world).
        pose: Pose in the base frame, with all joint positions zero.
        joints: Joints between the parent and the link; an MJCF may have several.
        inertial: Inertia; None if the file specifies neither mass nor shapes with mass.
        shapes: Visual and collision shapes.
        frames: Named frames on the link.
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
        """Whether the link can move relative to its parent."""
        return any(joint.kind != FIXED_JOINT for joint in self.joints)

    @property
    def mass(self) -> float:
        """Mass [kg] of this link; 0 if the file specifies no mass."""
        return 0.0 if self.inertial is None else self.inertial.mass


@dataclass(frozen=True, eq=False)
class RobotModel:
    """Robot model as specified by a file of any format: links, joints and notes.

    Attributes:
        format: ``"urdf"``, ``"mjcf"``, or the name of another format.
        link_tag: Tag of a body in the format.
        base: Name of the base; "" if MuJoCo does not compile an MJCF, ``world`` for an MJCF without
            bodies.
        links: {name: link}, parents first.
        notes: Notes of the reader, for example on elements that were left out.
    """

    format: str
    link_tag: str
    base: str
    links: dict[str, Link]
    notes: tuple[Diagnostic, ...]

    @cached_property
    def joints(self) -> dict[str, Joint]:
        """Joints of the file as ``{name: joint}``.

        Joints of an MJCF without names have the names "(BODY)", "(BODY #2)" ... Of joints with the
        same name, one is contained.
        """
        return {joint.name: joint for body in self.links.values() for joint in body.joints}

    @cached_property
    def total_mass(self) -> float:
        """Mass of all links of this robot [kg]."""
        return sum(body.mass for body in self.links.values())

    @cached_property
    def has_free_base(self) -> bool:
        """Whether the base counts as free, as the base of a legged robot does.

        The file has a joint of the kind ``FREE_JOINT``, or several moving links at the base: the
        URDF of a legged robot usually contains no free joint. Links that are fixed to the base
        count as part of the base. A URDF without such a joint whose root link is the world
        (`WORLD_LINK`) has a fixed base.
        """
        if any(joint.kind == FREE_JOINT for joint in self.joints.values()):
            return True
        if self.format == "urdf" and self.base == WORLD_LINK:
            return False
        group = self.fixed_group(self.base)
        return sum(child.moving for link in group for child in self.children(link.name)) > 1

    @cached_property
    def _children_by_name(self) -> dict[str, list[Link]]:
        """{link: child links}, for all links."""
        children: dict[str, list[Link]] = {name: [] for name in self.links}
        for body in self.links.values():
            if body.parent is not None:
                children[body.parent].append(body)
        return children

    @property
    def in_degrees(self) -> bool:
        """Whether the file specifies angles in degrees."""
        return False

    def inertial_path(self, part: str) -> str:
        """Return the XML path from a link to its mass, CoM or inertia, such as ``inertial/mass``.

        Args:
            part: ``mass``, ``origin`` or ``inertia``.
        """
        return f"inertial/{part}" if self.format == "urdf" else "inertial"

    def locate_parameter(self, attribute: JointAttribute) -> tuple[str, str | None]:
        """Return the name of a joint parameter in the file format, and the element that states it.

        Returns:
            Name for messages, and tag of the joint's child element that contains the parameter,
            such as ("limit effort", "limit") in a URDF. The tag is None if there is no such child.
        """
        if self.format == "urdf" and attribute.urdf is not None:
            return " ".join(attribute.urdf), attribute.urdf[0]
        return (attribute.mjcf or (attribute.kind,))[0], None

    def children(self, name: str) -> list[Link]:
        """Return the child links of a link."""
        return self._children_by_name[name]

    def descendants(self, name: str) -> Iterator[Link]:
        """Yield the descendants of a link, depth first; the link itself is not included."""
        for child in self.children(name):
            yield child
            yield from self.descendants(child.name)

    def fixed_group(self, name: str) -> list[Link]:
        """Return a link and the descendants that are fixed to it; empty without such a link."""
        if name not in self.links:
            return []
        group = [self.links[name]]
        for child in self.children(name):
            if not child.moving:
                group += self.fixed_group(child.name)
        return group

    def find_moving_body(self, name: str) -> str:
        """Return the name of the moving link to which a link is fixed: itself, or an ancestor.

        The ancestor is the nearest that moves, or the root if no ancestor moves.
        """
        link = self.links.get(name)
        while link is not None and not link.moving and link.parent is not None:
            name = link.parent
            link = self.links.get(name)
        return name

    def is_negligible(self, body: Link) -> bool:
        """Return True if a link has less than 1e-4 of the total mass, for example a placeholder."""
        return body.mass < 1e-4 * self.total_mass

    def ancestors(self, name: str) -> Iterator[str]:
        """Yield the names of the ancestors of a link, from the parent to the root."""
        parent = self.links[name].parent
        while parent is not None:
            yield parent
            parent = self.links[parent].parent


@dataclass(frozen=True, eq=False)
class UrdfModel(RobotModel):
    """Robot model as specified by a URDF.

    Attributes:
        file: The file.
        turned: Whether COLLADA meshes with another up axis are turned until z is up.
    """

    file: UrdfFile
    turned: bool = False


@dataclass(frozen=True, eq=False)
class MjcfModel(RobotModel):
    """Robot model as specified by an MJCF.

    Attributes:
        file: The file.
        mj_model: Compiled model; None if MuJoCo does not compile the file.
        refusal: Message of MuJoCo and the location, if the file does not compile, or compiles only
            because the reader turned flat meshes into shells; None otherwise, for example if only
            mesh files are missing.
        body_names: Names of all bodies as in ``links``, indexed by MuJoCo's body id.
    """

    file: MjcfFile
    mj_model: mujoco.MjModel | None
    refusal: tuple[Diagnostic, Place] | None
    body_names: tuple[str, ...]

    @property
    def in_degrees(self) -> bool:
        """Whether the file specifies angles in degrees."""
        return bool(self.file.spec.compiler.degree)
