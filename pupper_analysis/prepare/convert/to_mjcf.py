"""A URDF as an MJCF that is ready for simulation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.base.errors import ModelError
from pupper_analysis.models.conversion import UrdfImport
from pupper_analysis.models.mjcf_file import MjcfFile, mjcf_of_text
from pupper_analysis.models.mjcf_xml import MjcfXml
from pupper_analysis.models.urdf_file import UrdfFile
from pupper_analysis.models.urdf_tree import origin_of, set_origin
from pupper_analysis.models.xml import add_element, to_text
from pupper_analysis.prepare.convert.from_urdf import WORLD, UrdfBodies
from pupper_analysis.prepare.convert.meshes import Meshes
from pupper_analysis.prepare.convert.repair import (
    Repair,
    carry_shapes,
    mend_inertials,
    merge_fixed,
    repaired_urdf,
)
from pupper_analysis.prepare.passes import Feet

LIMBS = 2
"""A base that carries so many limbs or more is free, as in ``load_robot``."""


@dataclass(frozen=True)
class MjcfOptions:
    """What a URDF does not say.

    Attributes:
        feet: The feet's links, or {foot: link}; None: they are found.
        fixed_base: Whether the base is fixed; None: a base with two limbs or more is free.
        merge_fixed: Whether links on fixed joints become part of the body that carries them.
        armature: {joint: rotor inertia (kg m^2)}.
        sag: What the joint that holds most gives way (rad); None: it is found by trial.
        damping_ratio: Of the base's bounce on its servos; None: it is found by trial.
        repair_inertia: Whether inertials of moving links that no body can have are repaired.
        copy_meshes: Whether all meshes are copied to a folder beside the MJCF.
    """

    feet: Feet | None = None
    fixed_base: bool | None = None
    merge_fixed: bool = False
    armature: Mapping[str, float] | None = None
    sag: float | None = None
    damping_ratio: float | None = None
    repair_inertia: bool = False
    copy_meshes: bool = False


@dataclass(frozen=True)
class BareMjcf:
    """A URDF's links, shapes and couplings as an MJCF, before anything is added.

    Attributes:
        urdf: The URDF, with the inertials that were repaired.
        mjcf: The MJCF, without its meshes.
        meshes: Its meshes.
        bodies: What is known of its bodies.
        free: Whether its base is free.
        carried: Links whose shapes were moved to the bodies that carry them.
        notes: What was assumed.
        repairs: Inertials that were repaired.
    """

    urdf: UrdfFile
    mjcf: MjcfXml
    meshes: Meshes
    bodies: UrdfBodies
    free: bool
    carried: tuple[str, ...]
    notes: tuple[Diagnostic, ...]
    repairs: tuple[Repair, ...]

    @staticmethod
    def of(urdf: UrdfFile, output: Path, options: MjcfOptions, *, free: bool | None) -> BareMjcf:
        """Makes it; whether its base is free is found, if it is not said."""
        if all(joint.kind in ("fixed", "floating") for joint in urdf.tree.joints.values()):
            raise ModelError(urdf.path, diagnose("no-joint-moves"))
        meshes = Meshes(urdf, output, copied=options.copy_meshes)
        bodies = UrdfBodies(urdf, meshes, dict(options.armature or {}))
        mjcf = MjcfXml.of_urdf(str(urdf.root.get("name")))
        freed = _is_free(urdf, bodies) if free is None else free
        bodies.add(mjcf, free=freed)
        moved, repairs = mend_inertials(urdf, mjcf, repair=options.repair_inertia)
        mended = repaired_urdf(urdf, mjcf, repairs)
        notes = [*urdf.notes, *moved, *(repair.diagnostic for repair in repairs)]
        if options.merge_fixed:
            merged = merge_fixed(mjcf)
            if merged:
                notes.append(diagnose("fixed-links-are-sites", links=merged))
        carried = carry_shapes(mjcf)
        if carried:
            notes.append(diagnose("shapes-carried", links=carried))
        for name, rgba in bodies.materials.items():
            add_element(mjcf.section("asset"), "material", name=name, rgba=rgba)
        for follower, mimic in bodies.mimics.items():
            mjcf.add_coupling(follower, *mimic)
        return BareMjcf(
            mended, mjcf, meshes, bodies, freed, tuple(carried), tuple(notes), tuple(repairs)
        )

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
        tree, assets = self.urdf.tree.copy(), dict[str, bytes]()
        for body in self.mjcf.bodies:
            link, mended = tree.links[body.name], body.inertia
            link.remove("visual", *(("inertial",) if mended is None else ()))
            if mended is not None and (link.inertia is None or mended != link.inertia):
                link.set_inertia(mended)
            for _, shape, geometry in list(link.shapes):
                if geometry is not None and geometry.tag == "mesh":
                    file = self.meshes.file_of(geometry, assets)
                    geometry.set("filename", file or "")
                    if file is None:
                        link.element.remove(shape)
        for name in self.carried:
            link, joint = tree.links[name], tree.above[name]
            for shape in link.element.findall("collision"):
                set_origin(shape, joint.origin * origin_of(shape))
                tree.links[joint.parent].element.append(shape)
        return UrdfImport(self.urdf.path, to_text(tree.root), assets)


def bare_mjcf(urdf: UrdfFile) -> tuple[UrdfFile, MjcfFile, UrdfImport]:
    """Makes the MJCF of a URDF in memory, its base fixed as it is in the URDF.

    Links whose inertia no body can have get the nearest that one can, and a gram if they have no
    mass; the notes of the MJCF say so.

    Returns:
        The URDF with such inertials, the MJCF, and that URDF for MuJoCo's own importer.

    Raises:
        ModelError: If MuJoCo cannot have the robot, or nothing that moves has a mass.
    """
    bare = BareMjcf.of(urdf, urdf.path, MjcfOptions(repair_inertia=True), free=False)
    made_up = {repair.link for repair in bare.repairs if not repair.mass > 0}
    if {body.name for body in bare.mjcf.bodies if body.moves} <= made_up:
        # Whatever is said of its motors would be of masses that nobody stated.
        raise ModelError(urdf.path, diagnose("robot-without-mass", mass=Quantity(0.0, "kg")))
    stated = {shape.get("name") for shape in urdf.root.iter("collision")}
    for geom in bare.mjcf.geoms:
        if geom.get("name") not in stated:
            geom.attrib.pop("name", None)  # a foot is called as its link then
    left = (*bare.bodies.notes, *bare.meshes.notes)
    made = replace(bare.file(visuals=True), notes=(*bare.notes, *left))
    return bare.urdf, made, bare.imported()


def _is_free(urdf: UrdfFile, bodies: UrdfBodies) -> bool:
    """Tells whether the base carries two limbs or more, and is not the world."""
    if bodies.root == WORLD or bodies.floats:
        return bodies.floats
    tree = urdf.tree
    carried = [
        joint for link in tree.fixed_group(bodies.root) for joint in tree.below.get(link, ())
    ]
    return sum(not joint.is_fixed for joint in carried) >= LIMBS
