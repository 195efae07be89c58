"""Convert a URDF to an MJCF: bodies, joints, inertias and shapes.

Input is a validated URDF; output is the XML of an MJCF with a fixed or free base, as
`ConvertedMjcf`. Ground, servos and feet are added later, by the passes of the preparation. When a
robot is loaded from a URDF alone, the conversion fixes the base; a pass may free the base later.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

import numpy as np
import pinocchio as pin
from lxml import etree

from pupper_analysis.base.arrays import INERTIA_ENTRIES, inertia_entries, inertia_tensor
from pupper_analysis.base.diagnostics import (
    Diagnostic,
    Quantity,
    Term,
    diagnose,
)
from pupper_analysis.base.errors import ModelError
from pupper_analysis.base.units import select_joint_units
from pupper_analysis.models.attributes import (
    COUPLING_TIME_CONSTANT,
    FLOOR_NAME,
    MIN_UNSTATED_LIMIT,
    PASSIVE_ATTRIBUTES,
    AttributeValue,
)
from pupper_analysis.models.conversion import UrdfImport
from pupper_analysis.models.mjcf_file import MjcfFile, mjcf_of_text
from pupper_analysis.models.places import make_element_error
from pupper_analysis.models.urdf_file import UrdfFile, states_no_limits
from pupper_analysis.models.urdf_tree import WORLD_LINK, UrdfJoint, UrdfLink, UrdfTree
from pupper_analysis.models.xml import (
    add_element,
    is_zero,
    join_numbers,
    make_unique_name,
    to_text,
    write_halves,
)
from pupper_analysis.prepare.convert.meshes import MeshFiles
from pupper_analysis.prepare.convert.repair import (
    LinkBodies,
    Repair,
    move_massless_shapes,
    repair_inertials,
    write_repairs,
)
from pupper_analysis.prepare.passes import Feet
from pupper_analysis.prepare.simulable import make_massless_link_error

_ZERO_VECTOR = "0 0 0"
"""Text that replaces a missing vector (``xyz`` [m], ``rpy`` [rad]) of a URDF."""

_POINT_RADIUS = "0.001"
"""Radius [m], as text, of a collision sphere whose radius in the URDF is zero. Models of Drake have
such spheres at the corners of a sole. Chosen, not tuned.
"""

_SIZE_ATTRIBUTES = {
    "box": ("size",),
    "sphere": ("radius",),
    "cylinder": ("radius", "length"),
    "capsule": ("radius", "length"),
}
"""{tag of a URDF shape: its attributes that are lengths [m]}, to find shapes with a size of zero or
below.
"""


VISUAL_CLASS: Final = "visual"
"""Name of the MJCF default class of visual geoms."""

COLLISION_CLASS: Final = "collision"
"""Name of the MJCF default class of collision geoms."""


@dataclass(frozen=True, eq=False)
class MjcfXml:
    """XML of an MJCF that is made from a URDF, with methods to add elements.

    Attributes:
        root: Element ``<mujoco>``.
    """

    root: etree._Element

    @staticmethod
    def create_empty(name: str) -> MjcfXml:
        """Create an empty MJCF with the conventions of a URDF.

        Angles are in radians; Euler angles are about fixed axes. A body without ``<inertial>`` has
        no mass. The default classes of visual and collision geoms are defined.
        """
        root = etree.Element("mujoco", {"model": name})
        add_element(root, "compiler", angle="radian", eulerseq="XYZ", inertiafromgeom="false")
        default = add_element(root, "default")
        visual = add_element(default, "default", class_=VISUAL_CLASS)
        add_element(visual, "geom", contype="0", conaffinity="0", group="2")
        add_element(add_element(default, "default", class_=COLLISION_CLASS), "geom", group="3")
        add_element(root, "asset")
        add_element(root, "worldbody")
        return MjcfXml(root)

    def copy(self) -> MjcfXml:
        """Return a copy of this MJCF with separate XML elements."""
        return MjcfXml(copy.deepcopy(self.root))

    @property
    def text(self) -> str:
        """XML text of this MJCF."""
        return str(etree.tostring(self.root, encoding="unicode"))

    def section(self, tag: str) -> etree._Element:
        """Return the top-level element with a tag, such as ``asset``; add a missing element."""
        found = self.root.find(tag)
        return add_element(self.root, tag) if found is None else found

    def body(self, name: str) -> etree._Element:
        """Return the ``<body>`` element with a name."""
        return next(body for body in self.root.iter("body") if body.get("name") == name)

    @property
    def geoms(self) -> list[etree._Element]:
        """All ``<geom>`` elements, including those of the world and of default classes."""
        return list(self.root.iter("geom"))

    @property
    def used_meshes(self) -> set[str]:
        """Names of the meshes that the geoms of this MJCF use."""
        return {mesh for geom in self.geoms if (mesh := geom.get("mesh")) is not None}

    def remove_visuals(self) -> None:
        """Remove the visual geoms (MJCF class ``visual``) from this MJCF, in place."""
        for geom in self.geoms:
            if geom.get("class") == VISUAL_CLASS:
                geom.getparent().remove(geom)

    def add_coupling(
        self, follower: str, leader: str, multiplier: AttributeValue, offset: AttributeValue
    ) -> None:
        """Add an equality that couples two joints: q = offset + multiplier * q_leader [rad, m].

        Args:
            follower: Name of the dependent joint, whose position is q.
            leader: Name of the driving joint, whose position is q_leader.
            multiplier: Multiplier, as number or text.
            offset: Offset [rad, m], as number or text.
        """
        add_element(
            self.section("equality"),
            "joint",
            joint1=follower,
            joint2=leader,
            polycoef=f"{format_xml_value(offset)} {format_xml_value(multiplier)} 0 0 0",
            solref=join_numbers([COUPLING_TIME_CONSTANT, 1.0]),
        )


def format_xml_value(number: AttributeValue) -> str:
    """Format a number as text for XML; a text is returned unchanged."""
    return number if isinstance(number, str) else join_numbers(number)


@dataclass
class UrdfBodies:
    """Converter from the links of a URDF to the bodies of an MJCF.

    Angles are unchanged: with ``eulerseq="XYZ"`` (fixed axes), ``euler`` of an MJCF equals ``rpy``
    of a URDF.

    Attributes:
        urdf: URDF.
        tree: Links to be converted.
        meshes: Meshes of the URDF.
        armature: {joint: rotor inertia [kg m^2, kg]}.
        notes: Notes on parts that an MJCF cannot express, or that were left out.
        materials: {name: rgba} of the used materials.
        mimics: {joint: (leader, multiplier, offset)} as text; the joint follows the leader.
        efforts: {joint: effort limit [N m or N]} as text, for joints with a limit and without
            coupling.
        root: Name of the base link.
        frames: Names of all links in ``tree``.
    """

    urdf: UrdfFile
    tree: UrdfTree
    meshes: MeshFiles
    armature: Mapping[str, float]
    notes: list[Diagnostic] = field(default_factory=list)
    materials: dict[str, str] = field(default_factory=dict)
    mimics: dict[str, tuple[str, str, str]] = field(default_factory=dict)
    efforts: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.root = self.tree.base.name
        self._colors = {
            str(material.get("name")): str(material.find("color").get("rgba"))
            for material in self.urdf.root.iter("material")
            if material.find("color") is not None and material.get("name")
        }
        self._geoms = {FLOOR_NAME}
        self.frames = set(self.tree.links)

    def add(self, mjcf: MjcfXml, *, free: bool) -> None:
        """Convert all links of the URDF to bodies of an MJCF, with joints, inertials and shapes.

        Args:
            mjcf: MJCF; the bodies are added in place.
            free: True to add a free joint to the base.

        Raises:
            ModelError: If a joint below the base is floating or planar, for example.
        """
        links, worldbody = self.tree.links, mjcf.section("worldbody")
        if WORLD_LINK in links and (free or WORLD_LINK not in self.tree.fixed_group(self.root)):
            problem = diagnose("link-named-world", subject=("link", WORLD_LINK))
            raise make_element_error(self.urdf.path, links[WORLD_LINK].element, problem)
        if self.root == WORLD_LINK:
            self._fill_body(worldbody, links[self.root])
            return
        body = add_element(worldbody, "body", name=self.root)
        if free:
            add_element(body, "freejoint", name=make_unique_name("root", set(self.tree.joints)))
        self._fill_body(body, links[self.root])

    def _fill_body(self, body: etree._Element, link: UrdfLink) -> None:
        """Add inertial and shapes of a link to a body, then all child bodies with their joints."""
        if link.inertial is not None and body.tag != "worldbody":
            _add_mjcf_inertial(body, link.inertial)
        for kind, shape, geometry in link.shapes:
            if geometry is None:
                subject = "link", link.name
                self.notes.append(diagnose("empty-shape-left", subject=subject, tag=kind))
            else:
                self._add_shape(body, link.name, kind, shape, geometry)
        for joint in self.tree.child_joints.get(link.name, ()):
            xyz, rpy = _read_origin(joint.element)
            name = joint.child
            if name == WORLD_LINK:  # fixed to the world, but not the world of MuJoCo
                name = make_unique_name(f"{WORLD_LINK}_link", self.frames)
            inner = add_element(body, "body", name=name, pos=xyz, euler=rpy)
            self._add_joint(inner, joint)
            self._fill_body(inner, self.tree.links[joint.child])

    def _add_joint(self, body: etree._Element, urdf_joint: UrdfJoint) -> None:
        """Add a joint of the URDF to a body of the MJCF; nothing is added for a fixed joint.

        The coupling of the joint, or its effort limit, is recorded in ``mimics`` or ``efforts``.
        """
        if urdf_joint.is_fixed:
            return
        joint, kind, name = urdf_joint.element, urdf_joint.kind, urdf_joint.name
        if kind in ("floating", "planar"):
            problem = diagnose("joint-free-inside", subject=("joint", name), kind=Term(kind))
            raise make_element_error(self.urdf.path, joint, problem)
        self._check_axis(joint)
        axis, limit, dynamics = (joint.find(tag) for tag in ("axis", "limit", "dynamics"))
        bounds = None
        if kind != "continuous" and not states_no_limits(urdf_joint):
            bounds = f"{limit.get('lower') or 0} {limit.get('upper') or 0}"
            low, high = (float(word) for word in bounds.split())
            if not low < high:
                subject = "joint", name
                self.notes.append(
                    diagnose("empty-range-left", subject=subject, lower=low, upper=high)
                )
                bounds = None
        add_element(
            body,
            "joint",
            name=name,
            type="slide" if kind == "prismatic" else None,
            axis="1 0 0" if axis is None else axis.get("xyz"),
            range=bounds,
            **{
                attribute.mjcf[0]: _read_nonzero(dynamics, attribute.urdf[1])
                for attribute in PASSIVE_ATTRIBUTES
                if attribute.urdf
            },
            armature=join_numbers(self.armature[name]) if name in self.armature else None,
        )
        effort = _read_nonzero(limit, "effort")
        if effort is not None and float(effort) < 0:
            unit = select_joint_units(slides=kind == "prismatic").effort
            limit = Quantity(float(effort), unit)
            self.notes.append(diagnose("effort-negative", subject=("joint", name), effort=limit))
        if effort is not None and not 0 < float(effort) < MIN_UNSTATED_LIMIT:
            effort = None  # MuJoCo ignores an empty range; the robot's description keeps the limit
        mimic = urdf_joint.mimic
        if mimic is not None and self._is_mimic(urdf_joint):
            factors = mimic.get("multiplier") or "1", mimic.get("offset") or "0"
            self.mimics[name] = str(mimic.get("joint")), *factors
            if effort is not None:  # a dependent joint has no motor
                body[-1].set("actuatorfrcrange", f"-{effort.removeprefix('+')} {effort}")
        elif effort is not None:
            self.efforts[name] = effort

    def _is_mimic(self, joint: UrdfJoint) -> bool:
        """Return True if a joint has a valid mimic; add a note if the mimic is invalid."""
        if joint.mimic is None:
            return False
        leader_name, visited = str(joint.mimic.get("joint")), {joint.name}
        leader = self.tree.joints.get(leader_name)
        while leader is not None and leader.mimic is not None and leader.name not in visited:
            visited.add(leader.name)
            leader = self.tree.joints.get(str(leader.mimic.get("joint")))
        if leader is None or leader.is_fixed or leader.name in visited:
            message = diagnose(
                "mimic-leads-nowhere", subject=("joint", joint.name), leader=leader_name
            )
            self.notes.append(message)
            return False
        return True

    def _check_axis(self, joint: etree._Element) -> None:
        """Raise ModelError if the axis of a joint has length zero."""
        axis = joint.find("axis")
        if axis is not None and is_zero(axis.get("xyz") or _ZERO_VECTOR):
            problem = diagnose("axis-without-direction", subject=("joint", str(joint.get("name"))))
            raise make_element_error(self.urdf.path, axis, problem)

    def _add_shape(
        self,
        body: etree._Element,
        link: str,
        kind: str,
        shape: etree._Element,
        geometry: etree._Element,
    ) -> None:
        """Add a shape of a link to a body as geom; ``kind`` is ``"visual"`` or ``"collision"``."""
        attributes = self._convert_geometry(geometry, kind)
        if attributes is None:
            return
        xyz, rpy = _read_origin(shape)
        name = None
        if kind == "collision":
            name = make_unique_name(str(shape.get("name") or f"{link}_collision"), self._geoms)
        add_element(
            body,
            "geom",
            name=name,
            class_=kind,
            **attributes,
            pos=xyz,
            euler=rpy,
            material=self._find_material(shape) if kind == "visual" else None,
        )

    def _convert_geometry(self, geometry: etree._Element, kind: str) -> dict[str, str] | None:
        """Convert the geometry of a URDF shape to {attribute: text} of a geom; None if left out."""
        tag = str(geometry.tag)
        sizes = " ".join(str(geometry.get(word)) for word in _SIZE_ATTRIBUTES.get(tag, ()))
        is_point = tag == "sphere" and is_zero(sizes) and kind == "collision"
        if is_point:
            message = diagnose("points-made-spheres", radius=Quantity(float(_POINT_RADIUS), "m"))
            self.notes += [message] if message not in self.notes else []
        elif any(float(size) <= 0 for size in sizes.split()):
            message = diagnose("flat-shape-left", tag=tag, sizes=sizes)
            self.notes += [message] if message not in self.notes else []
            return None
        if tag == "mesh":
            name = self.meshes.register_mesh(geometry, touches=kind == "collision")
            return None if name is None else {"type": "mesh", "mesh": name}
        if tag == "sphere":
            return {
                "type": "sphere",
                "size": _POINT_RADIUS if is_point else str(geometry.get("radius")),
            }
        if tag == "box":
            return {"type": "box", "size": write_halves(str(geometry.get("size")))}
        if tag in ("cylinder", "capsule"):
            half = write_halves(str(geometry.get("length")))
            return {"type": tag, "size": f"{geometry.get('radius')} {half}"}
        self.notes.append(diagnose("shape-left", tag=tag))
        return None

    def _find_material(self, shape: etree._Element) -> str | None:
        """Return the MJCF material for a shape's colour, or None; record a new colour."""
        material = shape.find("material")
        if material is None:
            return None
        color = material.find("color")
        rgba = color.get("rgba") if color is not None else None
        name = str(material.get("name") or "")
        rgba = rgba or self._colors.get(name)
        if rgba is None:
            return None
        material_name = next((key for key, value in self.materials.items() if value == rgba), None)
        if material_name is None:
            material_name = make_unique_name(name or "color", {FLOOR_NAME, *self.materials})
            self.materials[material_name] = rgba
        return material_name


def _read_nonzero(parent: etree._Element | None, attribute: str) -> str | None:
    """Return the text of an attribute; None if it is missing, or all numbers in it are zero."""
    text = None if parent is None else parent.get(attribute)
    return None if text is None or is_zero(text) else text


def _read_origin(parent: etree._Element) -> tuple[str | None, str | None]:
    """Read xyz [m] and rpy [rad] of an element's <origin> as text; zeros become None."""
    origin = parent.find("origin")
    xyz, rpy = (
        (None if origin is None else origin.get(name)) or _ZERO_VECTOR for name in ("xyz", "rpy")
    )
    return None if is_zero(xyz) else xyz, None if is_zero(rpy) else rpy


def _add_mjcf_inertial(body: etree._Element, inertial: etree._Element) -> None:
    """Add an <inertial> of the URDF to a body, unless zero, with the tensor in body axes."""
    mass, inertia = str(inertial.find("mass").get("value")), inertial.find("inertia")
    texts = [str(inertia.get(name)) for name in INERTIA_ENTRIES]
    xyz, rpy = _read_origin(inertial)
    if is_zero(mass) and all(is_zero(text) for text in texts):
        return
    if rpy is not None:
        tensor = inertia_tensor(map(float, texts))
        rotation = pin.rpy.rpyToMatrix(np.array(rpy.split(), dtype=float))
        rotated = rotation @ tensor @ rotation.T
        texts = join_numbers(inertia_entries(rotated)).split()
    diagonal = all(is_zero(text) for text in texts[3:])
    add_element(
        body,
        "inertial",
        pos=xyz or _ZERO_VECTOR,
        mass=mass,
        diaginertia=" ".join(texts[:3]) if diagonal else None,
        fullinertia=None if diagonal else " ".join(texts),
    )


# Conversion of a URDF in memory, before the preparation adds elements.


MIN_FREE_BASE_LIMBS = 2
"""Lower bound of the number of moving joints at the base of a URDF (limbs) with which the converted
robot may get a free base by default."""


@dataclass(frozen=True)
class MjcfOptions:
    """Options of the conversion of a URDF to an MJCF.

    Attributes:
        feet: Links of the feet, or {foot: link}; None: feet are detected.
        fixed_base: True for a fixed base, False for a free base. None: the base is free if it
            floats in the URDF, or has at least two limbs and is not the link ``world``.
        armature: {joint: rotor inertia [kg m^2, kg]}, which a URDF does not contain; None: no rotor
            inertia.
        repair_inertia: True to repair invalid inertials, and to give mass to moving links without
            mass. False to refuse a URDF that needs such a repair.
        copy_meshes: True to copy all meshes to a folder beside the MJCF.
        defer_visuals: True to convert visual meshes later (`DeferredMeshes`).
    """

    feet: Feet | None = None
    fixed_base: bool | None = None
    armature: Mapping[str, float] | None = None
    repair_inertia: bool = False
    copy_meshes: bool = False
    defer_visuals: bool = False


@dataclass(frozen=True)
class ConvertedMjcf:
    """MJCF that was converted from a URDF: links, shapes and couplings, without floor and servos.

    Attributes:
        urdf: URDF with the repaired inertials.
        mjcf: MJCF without mesh assets.
        meshes: Meshes of the MJCF, converted from the mesh files of the URDF.
        bodies: Converter of the links, with notes and with records of materials and couplings.
        free: True if the base is free in the MJCF.
        notes: Notes on assumptions.
        repairs: Inertials that MuJoCo would refuse, with their replacements.
    """

    urdf: UrdfFile
    mjcf: MjcfXml
    meshes: MeshFiles
    bodies: UrdfBodies
    free: bool
    notes: tuple[Diagnostic, ...]
    repairs: tuple[Repair, ...]

    @staticmethod
    def from_urdf(
        urdf: UrdfFile, output: Path, options: MjcfOptions, *, free: bool | None
    ) -> ConvertedMjcf:
        """Convert the links, shapes and couplings of a URDF to an MJCF.

        Args:
            urdf: URDF.
            output: Path of the new MJCF, which is not written.
            options: Options. ``fixed_base`` and ``feet`` are not used here.
            free: True for a free base, False for a fixed base. None: the base is free if it floats
                in the URDF, or has at least `MIN_FREE_BASE_LIMBS` limbs and is not ``world``.

        Raises:
            ModelError: If no joint moves, or the URDF cannot be converted.
        """
        if all(joint.kind in ("fixed", "floating") for joint in urdf.tree.joints.values()):
            raise ModelError(urdf.path, diagnose("no-joint-moves"))
        tree = urdf.tree.copy()
        is_floating = _remove_massless_root(tree)
        has_free_base = has_limbs(tree, is_floating=is_floating) if free is None else free
        links = LinkBodies(tree, has_free_base)
        moved_notes, repairs = repair_inertials(urdf, links, repair=options.repair_inertia)
        mended = write_repairs(urdf, links, repairs)
        notes = [*urdf.notes, *moved_notes, *(repair.diagnostic for repair in repairs)]
        moved_shapes = move_massless_shapes(links)
        if moved_shapes:
            notes.append(diagnose("shapes-carried", links=moved_shapes))
        meshes = MeshFiles(urdf, output, copied=options.copy_meshes, defers=options.defer_visuals)
        rotors = options.armature or {}
        bodies = UrdfBodies(urdf, tree, meshes, rotors)
        mjcf = MjcfXml.create_empty(str(urdf.root.get("name")))
        bodies.add(mjcf, free=has_free_base)
        for name, rgba in bodies.materials.items():
            add_element(mjcf.section("asset"), "material", name=name, rgba=rgba)
        for follower, mimic in bodies.mimics.items():
            mjcf.add_coupling(follower, *mimic)
        return ConvertedMjcf(
            mended, mjcf, meshes, bodies, has_free_base, tuple(notes), tuple(repairs)
        )

    def make_file(self, *, visuals: bool = False) -> MjcfFile:
        """Create the converted MJCF in memory, as if it had been read from the path of the URDF.

        Args:
            visuals: True to include visual geoms.

        Raises:
            ModelError: If MuJoCo refuses the MJCF, or a number of the compiled model is not valid.
        """
        draft, assets = self.mjcf.copy(), dict[str, bytes]()
        if not visuals:
            draft.remove_visuals()
        used = None if visuals else draft.used_meshes
        self.meshes.write(draft.section("asset"), used=used, assets=assets)
        return replace(mjcf_of_text(self.urdf.path, draft.text, assets), of_urdf=True)

    def make_import(self) -> UrdfImport:
        """Create a URDF for MuJoCo's own importer, without visual shapes.

        Some elements are changed as in the converted MJCF, for example invalid inertials. Shapes
        with a mesh that cannot be used are omitted.
        """
        tree, assets = self.bodies.tree.copy(), dict[str, bytes]()
        for link in tree.links.values():
            link.remove("visual")
            for _, shape, geometry in list(link.shapes):
                if geometry is not None and geometry.tag == "mesh":
                    file = self.meshes.file_of(geometry, assets)
                    geometry.set("filename", file or "")
                    if file is None:
                        link.element.remove(shape)
        return UrdfImport(self.urdf.path, to_text(tree.root), assets)


def convert_urdf_in_memory(
    urdf: UrdfFile, *, defer_visuals: bool = False
) -> tuple[UrdfFile, MjcfFile, UrdfImport]:
    """Convert a URDF to an MJCF in memory, with a fixed base.

    Invalid inertias are repaired; the notes of the MJCF report the repairs.

    Args:
        urdf: URDF.
        defer_visuals: True to convert visual meshes later, by ``MjcfFile.deferred_visuals``.

    Returns:
        URDF with repaired inertials, MJCF, and this URDF for MuJoCo's own importer.

    Raises:
        ModelError: If the URDF cannot be converted, for example because no joint moves.
    """
    options = MjcfOptions(repair_inertia=True, defer_visuals=defer_visuals)
    converted = ConvertedMjcf.from_urdf(urdf, urdf.path, options, free=False)
    massless = {repair.link for repair in converted.repairs if not repair.mass > 0}
    if {joint.child for joint in converted.bodies.tree.moving} <= massless:
        # All torques would depend on masses that the file does not state.
        if not any((link.inertia or pin.Inertia.Zero()).mass for link in urdf.tree.links.values()):
            raise ModelError(urdf.path, diagnose("robot-without-mass", mass=Quantity(0.0, "kg")))
        first = next(joint.child for joint in converted.bodies.tree.moving)
        raise make_massless_link_error(urdf.place("link", first), "link", first)
    stated = {shape.get("name") for shape in urdf.root.iter("collision")}
    for geom in converted.mjcf.geoms:
        if geom.get("name") not in stated:
            geom.attrib.pop("name", None)  # a foot is then named after its link
    left = (*converted.bodies.notes, *converted.meshes.notes)
    deferred = converted.meshes.deferred
    mjcf = replace(
        converted.make_file(visuals=True),
        notes=(*converted.notes, *left),
        deferred_visuals=None if deferred is None else deferred.insert,
    )
    return converted.urdf, mjcf, converted.make_import()


def _remove_massless_root(tree: UrdfTree) -> bool:
    """Remove the root link of a URDF if it only states a free base; return True if removed.

    Such a link has no mass and no moments of inertia, and a floating joint as its only joint.
    """
    base = tree.base
    below = tree.child_joints.get(base.name, [])
    inertia = base.inertia
    has_inertia = inertia is not None and bool(inertia.mass or np.any(inertia.inertia))
    is_floating = not has_inertia and [joint.kind for joint in below] == ["floating"]
    if is_floating:
        tree.remove_base()
    return is_floating


def has_limbs(tree: UrdfTree, *, is_floating: bool) -> bool:
    """Return True if the robot of a URDF gets a free base by default.

    This is so if the base floats in the URDF (``is_floating``), or if at least
    `MIN_FREE_BASE_LIMBS` moving joints are attached to a base other than the world.
    """
    base = tree.base.name
    if base == WORLD_LINK or is_floating:
        return is_floating
    carried = [
        joint for link in tree.fixed_group(base) for joint in tree.child_joints.get(link, ())
    ]
    return sum(not joint.is_fixed for joint in carried) >= MIN_FREE_BASE_LIMBS
