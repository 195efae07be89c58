"""The MJCF of a URDF: bodies, joints, inertias and shapes, number by number."""

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
from pupper_analysis.models.attributes import (
    COUPLING_TIME_CONSTANT,
    FLOOR_NAME,
    PASSIVE_ATTRIBUTES,
    UNSTATED,
    Number,
)
from pupper_analysis.models.conversion import UrdfImport
from pupper_analysis.models.mjcf_file import MjcfFile, mjcf_of_text
from pupper_analysis.models.places import make_element_error
from pupper_analysis.models.urdf_file import UrdfFile, states_no_limits
from pupper_analysis.models.urdf_tree import UrdfJoint, UrdfLink, UrdfTree
from pupper_analysis.models.xml import (
    add_element,
    is_zero,
    make_unique_name,
    to_text,
    write_halves,
    write_numbers,
)
from pupper_analysis.prepare.convert.meshes import MeshFiles
from pupper_analysis.prepare.convert.repair import (
    WORLD_LINK,
    LinkBodies,
    Repair,
    move_massless_shapes,
    repair_inertials,
    write_repairs,
)
from pupper_analysis.prepare.passes import Feet

_ZERO = "0 0 0"

_POINT = "0.001"
"""Radius of a sphere that a URDF gives none (m): Drake's models have points at a sole's corners."""

_SIZES = {
    "box": ("size",),
    "sphere": ("radius",),
    "cylinder": ("radius", "length"),
    "capsule": ("radius", "length"),
}
"""The attributes of a URDF's shapes that are lengths."""


VISUAL_CLASS: Final = "visual"
"""The class of geoms that are only seen."""

COLLISION_CLASS: Final = "collision"
"""The class of geoms that touch."""


@dataclass(frozen=True, eq=False)
class MjcfXml:
    """An MJCF that is made of a URDF.

    Attributes:
        root: Its ``<mujoco>``.
    """

    root: etree._Element

    @staticmethod
    def of_urdf(name: str) -> MjcfXml:
        """Begins an MJCF whose angles are a URDF's, about fixed axes.

        What has no ``<inertial>`` weighs nothing in it.
        """
        root = etree.Element("mujoco", {"model": name})
        add_element(root, "compiler", angle="radian", eulerseq="XYZ", inertiafromgeom="false")
        default = add_element(root, "default")
        seen = add_element(default, "default", class_=VISUAL_CLASS)
        add_element(seen, "geom", contype="0", conaffinity="0", group="2")
        add_element(add_element(default, "default", class_=COLLISION_CLASS), "geom", group="3")
        add_element(root, "asset")
        add_element(root, "worldbody")
        return MjcfXml(root)

    def copy(self) -> MjcfXml:
        """Returns an MJCF with XML of its own."""
        return MjcfXml(copy.deepcopy(self.root))

    @property
    def text(self) -> str:
        """Its XML, as it is so far."""
        return str(etree.tostring(self.root, encoding="unicode"))

    def section(self, tag: str) -> etree._Element:
        """Returns a section of the file, which is added where there is none."""
        found = self.root.find(tag)
        return add_element(self.root, tag) if found is None else found

    def body(self, name: str) -> etree._Element:
        """Returns a body by its name."""
        return next(body for body in self.root.iter("body") if body.get("name") == name)

    @property
    def geoms(self) -> list[etree._Element]:
        """All geoms, those of the world and of classes included."""
        return list(self.root.iter("geom"))

    @property
    def used_meshes(self) -> set[str]:
        """The meshes of its geoms."""
        return {str(geom.get("mesh")) for geom in self.geoms}

    def remove_visuals(self) -> None:
        """Takes out what is only seen."""
        for geom in self.geoms:
            if geom.get("class") == VISUAL_CLASS:
                geom.getparent().remove(geom)

    def add_coupling(self, follower: str, leader: str, multiplier: Number, offset: Number) -> None:
        """Makes a joint follow another: q = offset + multiplier q of the leader."""
        add_element(
            self.section("equality"),
            "joint",
            joint1=follower,
            joint2=leader,
            polycoef=f"{format_number(offset)} {format_number(multiplier)} 0 0 0",
            solref=write_numbers([COUPLING_TIME_CONSTANT, 1.0]),
        )


def format_number(number: Number) -> str:
    """Returns how a number is written, or what was written of it."""
    return number if isinstance(number, str) else write_numbers(number)


@dataclass
class UrdfBodies:
    """Makes the bodies of an MJCF from the links of a URDF.

    Angles stay as the URDF has them: with ``eulerseq="XYZ"``, about fixed axes, an MJCF's ``euler``
    is a URDF's ``rpy``.

    Attributes:
        urdf: The file.
        tree: Its links, as they are to be bodies.
        meshes: Its meshes.
        armature: {joint: rotor inertia (kg m^2)}.
        notes: What an MJCF cannot say, or what was left out.
        materials: {name: rgba} that shapes use.
        mimics: {joint: what it follows, multiplier, offset}, as they are written.
        efforts: {joint: effort limit (N m or N)}, of those that follow no other and have one.
        root: The link that is the base.
        frames: All links.
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
        """Adds all bodies to an MJCF.

        Raises:
            ModelError: If a link cannot be a body of MuJoCo.
        """
        links, worldbody = self.tree.links, mjcf.section("worldbody")
        if WORLD_LINK in links and (self.root != WORLD_LINK or free):
            problem = diagnose("link-named-world", subject=("link", WORLD_LINK))
            raise make_element_error(self.urdf.path, links[WORLD_LINK].element, problem)
        if self.root == WORLD_LINK:
            self._fill(worldbody, links[self.root])
            return
        body = add_element(worldbody, "body", name=self.root)
        if free:
            add_element(body, "freejoint", name=make_unique_name("root", set(self.tree.joints)))
        self._fill(body, links[self.root])

    def _fill(self, body: etree._Element, link: UrdfLink) -> None:
        """Adds to a body what its link has, and the links that it carries."""
        if link.inertial is not None and body.tag != "worldbody":
            _add_inertial(body, link.inertial)
        for kind, shape, geometry in link.shapes:
            if geometry is None:
                subject = "link", link.name
                self.notes.append(diagnose("empty-shape-left", subject=subject, tag=kind))
            else:
                self._add_shape(body, link.name, kind, shape, geometry)
        for joint in self.tree.below.get(link.name, ()):
            xyz, rpy = _origin(joint.element)
            inner = add_element(body, "body", name=joint.child, pos=xyz, euler=rpy)
            self._add_joint(inner, joint)
            self._fill(inner, self.tree.links[joint.child])

    def _add_joint(self, body: etree._Element, stated: UrdfJoint) -> None:
        if stated.is_fixed:
            return
        joint, kind, name = stated.element, stated.kind, stated.name
        if kind in ("floating", "planar"):
            problem = diagnose("joint-free-inside", subject=("joint", name), kind=Term(kind))
            raise make_element_error(self.urdf.path, joint, problem)
        self._check_axis(joint)
        axis, limit, dynamics = (joint.find(tag) for tag in ("axis", "limit", "dynamics"))
        bounds = None
        if kind != "continuous" and not states_no_limits(stated):
            bounds = f"{limit.get('lower') or 0} {limit.get('upper') or 0}"
            low, high = (float(word) for word in bounds.split())
            if not low < high:
                moved = "joint", name
                self.notes.append(
                    diagnose("empty-range-left", subject=moved, lower=low, upper=high)
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
                one.mjcf[0]: _stated(dynamics, one.urdf[1])
                for one in PASSIVE_ATTRIBUTES
                if one.urdf
            },
            armature=write_numbers(self.armature[name]) if name in self.armature else None,
        )
        effort = _stated(limit, "effort")
        if effort is not None and float(effort) < 0:
            limit = Quantity(float(effort), "N m")
            self.notes.append(diagnose("effort-negative", subject=("joint", name), effort=limit))
        if effort is not None and not 0 < float(effort) < UNSTATED:
            effort = None  # MuJoCo ignores an empty range; the URDF's statement is kept beside it
        mimic = stated.mimic
        if mimic is not None and self._follows(stated):
            factors = mimic.get("multiplier") or "1", mimic.get("offset") or "0"
            self.mimics[name] = str(mimic.get("joint")), *factors
            if effort is not None:  # no motor, whose limit it could be
                body[-1].set("actuatorfrcrange", f"-{effort.removeprefix('+')} {effort}")
        elif effort is not None:
            self.efforts[name] = effort

    def _follows(self, joint: UrdfJoint) -> bool:
        """Tells whether a joint mimics another; notes if there is none that moves."""
        if joint.mimic is None:
            return False
        meant, passed = str(joint.mimic.get("joint")), {joint.name}
        leader = self.tree.joints.get(meant)
        while leader is not None and leader.mimic is not None and leader.name not in passed:
            passed.add(leader.name)
            leader = self.tree.joints.get(str(leader.mimic.get("joint")))
        if leader is None or leader.is_fixed or leader.name in passed:
            message = diagnose("mimic-leads-nowhere", subject=("joint", joint.name), leader=meant)
            self.notes.append(message)
            return False
        return True

    def _check_axis(self, joint: etree._Element) -> None:
        axis = joint.find("axis")
        if axis is not None and is_zero(axis.get("xyz") or _ZERO):
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
        attributes = self._geometry(geometry, kind)
        if attributes is None:
            return
        xyz, rpy = _origin(shape)
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
            material=self._material(shape) if kind == "visual" else None,
        )

    def _geometry(self, geometry: etree._Element, kind: str) -> dict[str, str] | None:
        tag = str(geometry.tag)
        sizes = " ".join(str(geometry.get(word)) for word in _SIZES.get(tag, ()))
        point = tag == "sphere" and is_zero(sizes) and kind == "collision"
        if point:
            message = diagnose("points-made-spheres", radius=Quantity(float(_POINT), "m"))
            self.notes += [message] if message not in self.notes else []
        elif any(float(size) <= 0 for size in sizes.split()):
            message = diagnose("flat-shape-left", tag=tag, sizes=sizes)
            self.notes += [message] if message not in self.notes else []
            return None
        if tag == "mesh":
            name = self.meshes.name(geometry, touches=kind == "collision")
            return None if name is None else {"type": "mesh", "mesh": name}
        if tag == "sphere":
            return {"type": "sphere", "size": _POINT if point else str(geometry.get("radius"))}
        if tag == "box":
            return {"type": "box", "size": write_halves(str(geometry.get("size")))}
        if tag in ("cylinder", "capsule"):
            half = write_halves(str(geometry.get("length")))
            return {"type": tag, "size": f"{geometry.get('radius')} {half}"}
        self.notes.append(diagnose("shape-left", tag=tag))
        return None

    def _material(self, shape: etree._Element) -> str | None:
        material = shape.find("material")
        if material is None:
            return None
        color = material.find("color")
        rgba = color.get("rgba") if color is not None else None
        name = str(material.get("name") or "")
        rgba = rgba or self._colors.get(name)
        if rgba is None:
            return None
        known = next((key for key, value in self.materials.items() if value == rgba), None)
        if known is None:
            known = make_unique_name(name or "color", {FLOOR_NAME, *self.materials})
            self.materials[known] = rgba
        return known


def _stated(parent: etree._Element | None, attribute: str) -> str | None:
    """Returns an attribute, if it is there and not zero."""
    text = None if parent is None else parent.get(attribute)
    return None if text is None or is_zero(text) else text


def _origin(parent: etree._Element) -> tuple[str | None, str | None]:
    """Returns the position and the angles of an <origin>; None where they are zero."""
    origin = parent.find("origin")
    xyz, rpy = ((None if origin is None else origin.get(name)) or _ZERO for name in ("xyz", "rpy"))
    return None if is_zero(xyz) else xyz, None if is_zero(rpy) else rpy


def _add_inertial(body: etree._Element, inertial: etree._Element) -> None:
    """Adds an <inertial> with the URDF's numbers; a turned tensor is turned into the body's axes.

    An MJCF takes products of inertia in the body's axes only.
    """
    mass, given = str(inertial.find("mass").get("value")), inertial.find("inertia")
    texts = [str(given.get(name)) for name in INERTIA_ENTRIES]
    xyz, rpy = _origin(inertial)
    if is_zero(mass) and all(is_zero(text) for text in texts):
        return
    if rpy is not None:
        tensor = inertia_tensor(map(float, texts))
        turn = pin.rpy.rpyToMatrix(np.array(rpy.split(), dtype=float))
        turned = turn @ tensor @ turn.T
        texts = write_numbers(inertia_entries(turned)).split()
    diagonal = all(is_zero(text) for text in texts[3:])
    add_element(
        body,
        "inertial",
        pos=xyz or _ZERO,
        mass=mass,
        diaginertia=" ".join(texts[:3]) if diagonal else None,
        fullinertia=None if diagonal else " ".join(texts),
    )


# A URDF as an MJCF in memory, before anything is added.


MIN_FREE_BASE_LIMBS = 2
"""A base that carries so many limbs or more is free, as in ``load_robot``."""


@dataclass(frozen=True)
class MjcfOptions:
    """What a URDF does not say.

    Attributes:
        feet: The feet's links, or {foot: link}; None: they are found.
        fixed_base: Whether the base is fixed; None: a base with two limbs or more is free.
        armature: {joint: rotor inertia (kg m^2)}.
        repair_inertia: Whether inertials of moving links that no body can have are repaired.
        copy_meshes: Whether all meshes are copied to a folder beside the MJCF.
    """

    feet: Feet | None = None
    fixed_base: bool | None = None
    armature: Mapping[str, float] | None = None
    repair_inertia: bool = False
    copy_meshes: bool = False


@dataclass(frozen=True)
class ConvertedMjcf:
    """A URDF's links, shapes and couplings as an MJCF, before anything is added.

    Attributes:
        urdf: The URDF, with the inertials that were repaired.
        mjcf: The MJCF, without its meshes.
        meshes: Its meshes.
        bodies: What is known of its bodies.
        free: Whether its base is free.
        notes: What was assumed.
        repairs: Inertials that were repaired.
    """

    urdf: UrdfFile
    mjcf: MjcfXml
    meshes: MeshFiles
    bodies: UrdfBodies
    free: bool
    notes: tuple[Diagnostic, ...]
    repairs: tuple[Repair, ...]

    @staticmethod
    def of(
        urdf: UrdfFile, output: Path, options: MjcfOptions, *, free: bool | None
    ) -> ConvertedMjcf:
        """Makes it; whether its base is free is found, if it is not said."""
        if all(joint.kind in ("fixed", "floating") for joint in urdf.tree.joints.values()):
            raise ModelError(urdf.path, diagnose("no-joint-moves"))
        tree = urdf.tree.copy()
        floats = _take_floating(tree)
        freed = _is_free(tree, floats=floats) if free is None else free
        links = LinkBodies(tree, freed)
        moved, repairs = repair_inertials(urdf, links, repair=options.repair_inertia)
        mended = write_repairs(urdf, links, repairs)
        notes = [*urdf.notes, *moved, *(repair.diagnostic for repair in repairs)]
        carried = move_massless_shapes(links)
        if carried:
            notes.append(diagnose("shapes-carried", links=carried))
        meshes, rotors = MeshFiles(urdf, output, copied=options.copy_meshes), options.armature or {}
        bodies = UrdfBodies(urdf, tree, meshes, rotors)
        mjcf = MjcfXml.of_urdf(str(urdf.root.get("name")))
        bodies.add(mjcf, free=freed)
        for name, rgba in bodies.materials.items():
            add_element(mjcf.section("asset"), "material", name=name, rgba=rgba)
        for follower, mimic in bodies.mimics.items():
            mjcf.add_coupling(follower, *mimic)
        return ConvertedMjcf(mended, mjcf, meshes, bodies, freed, tuple(notes), tuple(repairs))

    def file(self, *, visuals: bool = False) -> MjcfFile:
        """Returns the MJCF as far as it is made, as if it were read from the URDF's file.

        Args:
            visuals: Whether it has what only looks are for.

        Raises:
            ModelError: If MuJoCo refuses it.
        """
        draft, assets = self.mjcf.copy(), dict[str, bytes]()
        if not visuals:
            draft.remove_visuals()
        used = None if visuals else draft.used_meshes
        self.meshes.write(draft.section("asset"), used=used, assets=assets)
        return replace(mjcf_of_text(self.urdf.path, draft.text, assets), of_urdf=True)

    def imported(self) -> UrdfImport:
        """Returns the URDF for MuJoCo's own importer, as far as it touches.

        What no body can weigh, which MuJoCo refuses, is where it was given to, and so are shapes of
        links without mass: the importer, too, makes them the body's that carries them.
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


def convert_urdf_in_memory(urdf: UrdfFile) -> tuple[UrdfFile, MjcfFile, UrdfImport]:
    """Makes the MJCF of a URDF in memory, its base fixed as it is in the URDF.

    Links whose inertia no body can have get the nearest that one can, and a gram if they have no
    mass; the notes of the MJCF say so.

    Returns:
        The URDF with such inertials, the MJCF, and that URDF for MuJoCo's own importer.

    Raises:
        ModelError: If MuJoCo cannot have the robot, or nothing that moves has a mass.
    """
    bare = ConvertedMjcf.of(urdf, urdf.path, MjcfOptions(repair_inertia=True), free=False)
    made_up = {repair.link for repair in bare.repairs if not repair.mass > 0}
    if {joint.child for joint in bare.bodies.tree.moving} <= made_up:
        # Whatever is said of its motors would be of masses that nobody stated.
        raise ModelError(urdf.path, diagnose("robot-without-mass", mass=Quantity(0.0, "kg")))
    stated = {shape.get("name") for shape in urdf.root.iter("collision")}
    for geom in bare.mjcf.geoms:
        if geom.get("name") not in stated:
            geom.attrib.pop("name", None)  # a foot is called as its link then
    left = (*bare.bodies.notes, *bare.meshes.notes)
    made = replace(bare.file(visuals=True), notes=(*bare.notes, *left))
    return bare.urdf, made, bare.imported()


def _take_floating(tree: UrdfTree) -> bool:
    """Makes the link on a floating joint below a root without mass the root, in place."""
    base = tree.base
    below = tree.below.get(base.name, [])
    floats = base.inertial is None and [joint.kind for joint in below] == ["floating"]
    if floats:
        tree.remove_base()
    return floats


def _is_free(tree: UrdfTree, *, floats: bool) -> bool:
    """Tells whether the base carries two limbs or more, and is not the world."""
    base = tree.base.name
    if base == WORLD_LINK or floats:
        return floats
    carried = [joint for link in tree.fixed_group(base) for joint in tree.below.get(link, ())]
    return sum(not joint.is_fixed for joint in carried) >= MIN_FREE_BASE_LIMBS
