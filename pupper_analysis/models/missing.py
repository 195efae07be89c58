"""Meshes that an MJCF cannot have: what needs missing files is left out, flat ones become shells.

Textures and skins too. MuJoCo refuses flat meshes as solids.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import Final

import mujoco

from pupper_analysis.base.diagnostics import Diagnostic, Term, diagnose
from pupper_analysis.models.mjcf import silence_mujoco
from pupper_analysis.models.mjcf_tree import Node, Tree
from pupper_analysis.models.packages import existing_file, is_pointer
from pupper_analysis.models.places import Place, refuse_file


def leave_out_missing(
    spec: mujoco.MjSpec, tree: Tree, index: Mapping[tuple[str, str], Node]
) -> list[Diagnostic]:
    """Takes out of a spec what needs files that are missing; returns what it took out."""
    folders = tuple(tree.folders)

    def missing(file: str, folder: str) -> bool:
        name = Path(file).name if spec.strippath else file
        return bool(file) and not any(existing_file(top / folder / name) for top in folders)

    meshes = {m.name: m.file for m in spec.meshes if missing(m.file, m.compiler.meshdir)}
    hfields = {h.name: h.file for h in spec.hfields if missing(h.file, h.compiler.meshdir)}
    textures = {
        t.name: next(filter(None, (t.file, *t.cubefiles)))
        for t in spec.textures
        if any(missing(file, t.compiler.texturedir) for file in (t.file, *t.cubefiles))
    }
    skins = {s.name: s.file for s in spec.skins if missing(s.file, s.compiler.meshdir)}
    if not (meshes or hfields or textures or skins):
        return []
    geoms = [g for g in spec.geoms if g.meshname in meshes or g.hfieldname in hfields]
    for geom in geoms:
        if geom.meshname in meshes and gives_mass(spec, geom):
            body = geom.parent.name
            place = index[("body", body)].place if ("body", body) in index else Place(tree.path)
            raise refuse_file(
                place,
                diagnose(
                    "mass-of-missing-mesh",
                    subject=("body", body),
                    geom=geom.name,
                    file=meshes[geom.meshname],
                ),
            )
    names = {geom.name for geom in geoms if geom.name}
    _refuse_wrapped(tree.root, names)
    users = _users(spec, tree.root, names)
    files = {"mesh": meshes, "height field": hfields, "texture": textures, "skin": skins}
    notes = [
        diagnose("files-missing", kind=Term(kind), files=dict.fromkeys(named.values()))
        for kind, named in files.items()
        if named
    ]
    notes += _pointers(spec, folders, {*meshes.values(), *hfields.values(), *skins.values()})
    if users:
        notes.append(diagnose("users-left-out", users=users))
    for element in geoms:
        spec.delete(element)
    for name in textures:
        for material in spec.materials:
            if name in list(material.textures):
                material.textures = ["" if t == name else t for t in material.textures]
    for elements, gone in (
        (spec.meshes, meshes),
        (spec.hfields, hfields),
        (spec.textures, textures),
        (spec.skins, skins),
    ):
        for element in list(elements):
            if element.name in gone:
                spec.delete(element)
    return notes


def _pointers(spec: mujoco.MjSpec, folders: tuple[Path, ...], files: set[str]) -> list[Diagnostic]:
    """Tells which files are there, but are pointers of Git LFS."""
    names = {Path(file).name if spec.strippath else file for file in files}
    found = [
        name
        for name in sorted(names)
        if any(is_pointer(top / folder / name) for top in folders for folder in _folders(spec))
    ]
    return [diagnose("files-are-lfs-pointers", files=found)] if found else []


def _folders(spec: mujoco.MjSpec) -> set[str]:
    return {element.compiler.meshdir for element in (*spec.meshes, *spec.hfields, *spec.skins)}


def gives_mass(spec: mujoco.MjSpec, geom: mujoco.MjsGeom) -> bool:
    """Says whether MuJoCo would take (part of) a body's inertia from a geom."""
    body = geom.parent
    if body.name == spec.worldbody.name:
        return False
    from_geom = geom.compiler.inertiafromgeom
    if from_geom == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE or (
        from_geom == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_AUTO and body.explicitinertial
    ):
        return False
    low, high = geom.compiler.inertiagrouprange
    weight = geom.density if math.isnan(geom.mass) else geom.mass
    return bool(low <= geom.group <= high and weight != 0)


def _refuse_wrapped(root: Node, names: set[str]) -> None:
    for section in root.children:
        for tendon in section.children if section.tag == "tendon" else ():
            for part in tendon.children:
                if part.attributes.get("geom") in names:
                    geom = ("geom", part.attributes["geom"])
                    raise refuse_file(
                        part.place, diagnose("tendon-wraps-missing-mesh", subject=geom)
                    )


def _users(spec: mujoco.MjSpec, root: Node, names: set[str]) -> list[Diagnostic]:
    """Deletes the sensors, contact pairs and tuples that refer to geoms; returns what they are."""
    kind = mujoco.mjtObj.mjOBJ_GEOM
    tuples = {
        node.attributes.get("name")
        for section in root.children
        if section.tag == "custom"
        for node in section.children
        if any(part.attributes.get("objname") in names for part in node.children)
    }
    users = [
        *(
            ("sensor", sensor)
            for sensor in spec.sensors
            if (sensor.objtype == kind and sensor.objname in names)
            or (sensor.reftype == kind and sensor.refname in names)
        ),
        *(("contact pair", p) for p in spec.pairs if {p.geomname1, p.geomname2} & names),
        *(("tuple", element) for element in spec.tuples if element.name in tuples),
    ]
    told = [diagnose("named-element", subject=(what, user.name)) for what, user in users]
    for _, user in users:
        spec.delete(user)
    return told


_FLAT: Final = re.compile(r"mesh volume is too small: (.*?) \. Try setting inertia to shell")


def flat_mesh(error: BaseException) -> str | None:
    """Returns the mesh whose volume is too small for MuJoCo; None if the error is another."""
    found = _FLAT.search(str(error))
    return found[1] if found else None


def compile_with_shells(make: Callable[[], mujoco.MjSpec]) -> tuple[mujoco.MjModel, list[str], str]:
    """Compiles a spec with its flat meshes as shells.

    A mesh gives its geom a centre and axes, a mass only where a body has no <inertial>: then a
    shell would weigh something else, and it stays refused.

    Args:
        make: Makes the spec, anew each time, for compiling changes it.

    Returns:
        The model, the meshes that were taken as shells, and what MuJoCo says of the first.
    """
    shells: list[str] = []
    said = ""
    while True:
        spec = make()
        put_shells(spec, shells)
        try:
            with silence_mujoco():
                return spec.compile(), shells, said
        except ValueError as error:
            name = flat_mesh(error)
            if name is None or name in shells or _weighs(spec, name):
                raise
            shells.append(name)
            said = said or str(error)


def put_shells(spec: mujoco.MjSpec, names: Collection[str]) -> None:
    """Makes shells of some meshes, in place."""
    for mesh in spec.meshes:
        if mesh.name in names:
            mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL


def taken_as_shells(names: list[str]) -> Diagnostic:
    """Tells which meshes are taken as shells."""
    return diagnose("flat-meshes-as-shells", names=names, version=mujoco.__version__)


def _weighs(spec: mujoco.MjSpec, name: str) -> bool:
    return any(geom.meshname == name and gives_mass(spec, geom) for geom in spec.geoms)
