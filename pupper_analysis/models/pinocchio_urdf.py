"""URDF of a Pinocchio model, for users who have only a ``pin.Model``.

The URDF has the joints, inertias, limits and body frames of the model, and the shapes of its
geometry model. Meshes are written as STL files. A URDF cannot state armature and gravity: the
caller reads these values from the model.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Final

import coal  # comes with pin
import numpy as np
import pinocchio as pin
from lxml import etree

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ModelError
from pupper_analysis.models.attributes import MIN_UNSTATED_LIMIT
from pupper_analysis.models.urdf_tree import set_origin
from pupper_analysis.models.xml import add_element, join_numbers, make_unique_name, to_text

_MAX_POSITION: Final = 1e6
"""Absolute value [rad, m] from which a joint limit counts as missing, because Pinocchio uses the
largest double for "no limit". Chosen, not tuned.
"""

_IDENTITY_ATOL: Final = 1e-12
"""Tolerance of the equality of a body frame and the frame of its joint: positions [m] and entries
of the rotation matrix [1]. The link of the joint gets the name of the first equal body frame.
Chosen, not tuned.
"""

_WORLD: Final = "world"
"""Name of the root link above a free base."""


def write_urdf_of_model(
    model: pin.Model, geometry: pin.GeometryModel | None, folder: Path, source: str
) -> str:
    """Return the URDF text of a Pinocchio model, and write its meshes.

    Args:
        model: Model of one robot, with joints of one degree of freedom and at most one free flyer.
        geometry: Collision shapes; None for none.
        folder: Folder for the meshes.
        source: Name of the model, for messages.

    Raises:
        ModelError: If a URDF cannot state a joint or shape, for example a slide without limits.
    """
    floating = _check_joints(model, source)
    writer = _UrdfWriter(model, floating, source)
    writer.add_links()
    for index, item in enumerate([] if geometry is None else geometry.geometryObjects):
        writer.add_shape(item, folder, index)
    return to_text(writer.root)


def _check_joints(model: pin.Model, source: str) -> bool:
    """Return True if the base is free; raise a ModelError if a URDF cannot state the joints."""
    flyers = [
        index for index in range(1, model.njoints) if model.joints[index].shortname() == _FREE_FLYER
    ]
    if len(flyers) > 1:
        names = [str(model.names[index]) for index in flyers]
        raise ModelError(source, diagnose("several-free-flyers", joints=names))
    if flyers and (flyers[0] != 1 or model.parents[1] != 0 or model.parents.tolist().count(0) > 2):
        problem = diagnose("free-flyer-not-first", joint=str(model.names[flyers[0]]))
        raise ModelError(source, problem)
    for index in range(1 + len(flyers), model.njoints):
        joint = model.joints[index]
        motion = None if joint.nv != 1 else _read_motion(model, index)
        if motion is None or (motion[:3].any() and motion[3:].any()):
            kind = joint.shortname().removeprefix("JointModel")
            raise ModelError(
                source,
                diagnose("pinocchio-joint-not-in-urdf", joint=str(model.names[index]), kind=kind),
            )
    return bool(flyers)


_FREE_FLYER: Final = "JointModelFreeFlyer"
"""Pinocchio's name of a free joint."""


def _read_motion(model: pin.Model, index: int) -> Array:
    """Return a joint's unit motion vector (linear, angular), shape (6,), in the joint frame."""
    return np.array(model.joints[index].createData().S).reshape(6)


class _UrdfWriter:
    """Writer of a Pinocchio model to a new URDF.

    Args:
        model: Pinocchio model that is written.
        floating: Whether the first joint is a free flyer, which is written as type ``floating``.
        source: Name of the model, for messages.

    Attributes:
        root: Root element.
    """

    def __init__(self, model: pin.Model, floating: bool, source: str) -> None:
        self.root = etree.Element("robot", name=str(model.name) or "robot")
        self._model, self._floating, self._source = model, floating, source
        self._links: dict[int, etree._Element] = {}
        self._link_names: set[str] = set()
        self._joint_names = {str(name) for name in model.names}

    def add_links(self) -> None:
        """Add the links and joints of the Pinocchio model to the URDF.

        The link of a joint has the name of the first body frame that equals the joint's frame, if
        any. Other body frames of a written link get links of their own, fixed to this link.
        """
        model = self._model
        frames = [frame for frame in model.frames if frame.type == pin.FrameType.BODY]
        own: dict[int, pin.Frame] = {}
        for frame in frames:
            if frame.placement.isIdentity(_IDENTITY_ATOL):
                own.setdefault(int(frame.parentJoint), frame)
        if self._floating:
            add_element(self.root, "link", name=make_unique_name(_WORLD, self._link_names))
        for index in range(1 if self._floating else 0, model.njoints):
            fallback = "base" if index == 0 else str(model.names[index])
            name = str(own[index].name) if index in own else fallback
            link = add_element(self.root, "link", name=make_unique_name(name, self._link_names))
            self._links[index] = link
            _add_urdf_inertial(link, model.inertias[index])
        for index in range(1, model.njoints):
            self._add_joint(index)
        kept = {id(frame) for frame in own.values()}
        for frame in frames:
            parent = self._links.get(int(frame.parentJoint))
            if id(frame) in kept or parent is None:
                continue
            link = make_unique_name(str(frame.name), self._link_names)
            add_element(self.root, "link", name=link)
            joint = add_element(
                self.root,
                "joint",
                name=make_unique_name(f"{link}_fixed", self._joint_names),
                type="fixed",
            )
            add_element(joint, "parent", link=str(parent.get("name")))
            add_element(joint, "child", link=link)
            set_origin(joint, frame.placement)

    def _add_joint(self, index: int) -> None:
        """Add a Pinocchio joint to the URDF; raise ModelError for a slide without two limits.

        If a hinge has a single limit, the missing limit is written as `MIN_UNSTATED_LIMIT`, since a
        URDF has no infinite numbers.
        """
        model = self._model
        is_flyer = self._floating and index == 1
        name, parent = str(model.names[index]), int(model.parents[index])
        element = add_element(self.root, "joint", name=name)
        add_element(
            element, "parent", link=_WORLD if is_flyer else str(self._links[parent].get("name"))
        )
        add_element(element, "child", link=str(self._links[index].get("name")))
        set_origin(element, model.jointPlacements[index])
        if is_flyer:
            element.set("type", "floating")
            return
        motion, joint = _read_motion(model, index), model.joints[index]
        slides = not motion[3:].any()
        add_element(
            element, "axis", xyz=join_numbers(motion[:3] if slides else motion[3:], 1, None)
        )
        lower, upper = (
            float(limits[joint.idx_q]) if joint.nq == 1 else bound
            for limits, bound in (
                (model.lowerPositionLimit, -np.inf),
                (model.upperPositionLimit, np.inf),
            )
        )
        stated = {
            word: end
            for word, end in (("lower", lower), ("upper", upper))
            if abs(end) < _MAX_POSITION
        }
        if slides and len(stated) < 2:
            raise ModelError(self._source, diagnose("pinocchio-slide-without-limits", joint=name))
        element.set("type", "prismatic" if slides else "revolute" if stated else "continuous")
        dof = joint.idx_v
        limits = {
            word: _write_limit(float(values[dof]))
            for word, values in (("effort", model.effortLimit), ("velocity", model.velocityLimit))
        }
        if stated:
            ends = {"lower": -MIN_UNSTATED_LIMIT, "upper": MIN_UNSTATED_LIMIT} | stated
            limits |= {word: _format_number(end) for word, end in ends.items()}
        add_element(element, "limit", **limits)
        damping, friction = float(model.damping[dof]), float(model.friction[dof])
        if damping or friction:
            add_element(
                element,
                "dynamics",
                damping=_format_number(damping),
                friction=_format_number(friction),
            )

    def add_shape(self, item: pin.GeometryObject, folder: Path, index: int) -> None:
        """Add a collision shape to the link that moves with the shape's parent joint.

        Meshes are written to ``folder`` as ``shape_INDEX.stl``. Shapes without such a link, for
        example obstacles in the world, are skipped.

        Raises:
            ModelError: If a shape has no counterpart in a URDF.
        """
        link = self._links.get(int(item.parentJoint))
        if link is None:  # an obstacle in the world
            return
        collision = add_element(link, "collision", name=str(item.name))
        set_origin(collision, item.placement)
        shape = add_element(collision, "geometry")
        solid = item.geometry
        if isinstance(solid, coal.Sphere):
            add_element(shape, "sphere", radius=_format_number(solid.radius))
        elif isinstance(solid, coal.Box):
            add_element(shape, "box", size=join_numbers(2 * solid.halfSide, 1, None))
        elif isinstance(solid, coal.Capsule | coal.Cylinder):
            tag = "capsule" if isinstance(solid, coal.Capsule) else "cylinder"
            length, radius = _format_number(2 * solid.halfLength), _format_number(solid.radius)
            add_element(shape, tag, radius=radius, length=length)
        else:
            file = folder / f"shape_{index}.stl"
            file.write_bytes(_make_stl(solid, str(item.name), self._source))
            add_element(shape, "mesh", filename=str(file))


def _make_stl(solid: coal.CollisionGeometry, name: str, source: str) -> bytes:
    """Convert a mesh, convex shape or ellipsoid to the bytes of an STL file [m].

    Other shapes raise a ModelError with ``name`` and ``source``.
    """
    import trimesh  # comes with yourdfpy, and is slow to import

    if isinstance(solid, coal.Ellipsoid):
        mesh = trimesh.creation.icosphere(subdivisions=4)
        mesh.apply_scale(np.array(solid.radii))
    elif isinstance(solid, coal.ConvexBase):
        mesh = trimesh.Trimesh(np.array(solid.points())).convex_hull
    elif hasattr(solid, "tri_indices"):
        triangles = map(solid.tri_indices, range(solid.num_tris))
        faces = [[triangle[corner] for corner in range(3)] for triangle in triangles]
        mesh = trimesh.Trimesh(np.array(solid.vertices()), faces, process=False)
    else:
        kind = type(solid).__name__
        raise ModelError(source, diagnose("pinocchio-shape-not-in-urdf", geom=name, kind=kind))
    return bytes(mesh.export(file_type="stl"))


def _add_urdf_inertial(link: etree._Element, inertia: pin.Inertia) -> None:
    """Add ``<inertial>`` to a link, unless mass and inertia are zero."""
    matrix = np.array(inertia.inertia)
    if not inertia.mass and not matrix.any():
        return
    element = add_element(link, "inertial")
    set_origin(element, pin.SE3(np.eye(3), np.array(inertia.lever)))
    add_element(element, "mass", value=_format_number(inertia.mass))
    entries = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2)}
    moments: Mapping[str, str] = {
        word: _format_number(matrix[entry]) for word, entry in (entries | {"izz": (2, 2)}).items()
    }
    add_element(element, "inertia", **moments)


def _format_number(number: float) -> str:
    """Return the shortest text of a number that is read back without loss."""
    return repr(float(number))


def _write_limit(limit: float) -> str:
    """Return the text of an effort or velocity limit, which is bounded by `MIN_UNSTATED_LIMIT`."""
    return _format_number(limit) if limit < MIN_UNSTATED_LIMIT else f"{MIN_UNSTATED_LIMIT:g}"
