"""Rules about what a file refers to, and whether it hangs together."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from pupper_analysis.base.diagnostics import Diagnostic, Severity, diagnose
from pupper_analysis.base.tools import find_format
from pupper_analysis.models.loading import CheckFinding
from pupper_analysis.models.mjcf_file import MjcfFile
from pupper_analysis.models.places import Place
from pupper_analysis.models.published import existing_file, is_pointer
from pupper_analysis.models.stated.model import (
    MjcfModel,
    UrdfModel,
)
from pupper_analysis.models.stated.urdf import MAX_MESH_BYTES, read_mesh_file
from pupper_analysis.tools.audit.registry import rule


@rule
def mujoco_refuses(robot: MjcfModel) -> Iterator[CheckFinding]:
    """Compiles the file."""
    if robot.refusal is not None:
        problem, place = robot.refusal
        yield CheckFinding("mujoco", "", diagnose("mujoco-refuses", problem=problem), place=place)


@rule
def mesh_missing(robot: UrdfModel | MjcfModel) -> Iterator[CheckFinding]:
    """Report each missing mesh file once per package and folder.

    The severity is ERROR if a link touches with the mesh, and for each missing mesh of an MJCF,
    which MuJoCo refuses. Files in Git LFS, or in a package that is not found, may be elsewhere:
    they are a WARNING.
    """
    refused = isinstance(robot, MjcfModel)
    kind = "mesh" if refused else "link"
    among: dict[tuple[bool, bool, str, str], list[_Missing]] = {}
    for missing in _missing(robot):
        package, there, _ = missing.name.removeprefix("package://").partition("/")
        package = package if there and missing.name.startswith("package://") else ""
        folder = "" if package else missing.name.rpartition("/")[0]
        touches = (missing.touches or refused) and not package
        among.setdefault((missing.pointer, touches, package, folder), []).append(missing)
    for (pointer, touches, package, _), several in among.items():
        names = tuple(dict.fromkeys(missing.name for missing in several))
        if pointer:
            message = diagnose("mesh-is-lfs-pointer", meshes=names)
        else:
            message = diagnose("mesh-missing", meshes=names, package=package or None)
        gone = touches and not pointer and "://" not in names[0]
        first, severity = several[0], None if gone else Severity.WARNING
        yield CheckFinding(kind, first.owner, message, place=first.place, severity=severity)


@dataclass(frozen=True)
class _Missing:
    """A mesh that is not there, or in Git LFS alone; whose it is, and whether it touches."""

    name: str
    owner: str
    place: Place
    pointer: bool
    touches: bool = False


def _missing(robot: UrdfModel | MjcfModel) -> Iterator[_Missing]:
    if isinstance(robot, MjcfModel):
        yield from _missing_in_mjcf(robot.file)
        return
    seen: set[str] = set()
    touching = {mesh.get("filename", "") for mesh in robot.file.root.iterfind(".//collision//mesh")}
    for owner, link in robot.file.tree.links.items():
        for mesh in link.element.iter("mesh"):
            name = mesh.get("filename", "")
            if name not in seen and robot.file.resolve_mesh(name) is None:
                place = Place(robot.file.path, mesh.sourceline)
                pointer = is_pointer(robot.file.path.parent / name)
                yield _Missing(name, owner, place, pointer, name in touching)
            seen.add(name)


@rule
def mesh_unreadable(robot: UrdfModel) -> Iterator[CheckFinding]:
    """Opens each STL and OBJ once; see ``find_mesh_problem``."""
    seen: set[Path] = set()
    for owner, link in robot.file.tree.links.items():
        for mesh in link.element.iter("mesh"):
            name = mesh.get("filename", "")
            path = robot.file.resolve_mesh(name)
            if path is None or path in seen:
                continue
            seen.add(path)
            problem = find_mesh_problem(path)
            if problem is not None:
                place = Place(robot.file.path, mesh.sourceline)
                message = diagnose("mesh-unreadable", mesh=name, problem=problem)
                yield CheckFinding("link", owner, message, place=place)


def find_mesh_problem(path: Path) -> Diagnostic | None:
    """Says what keeps a file from being a mesh; None if nothing does, or it is not read here.

    STL and OBJ are read, of COLLADA the start. A file of more than ``MAX_MESH_BYTES`` bytes is not
    opened.
    """
    ending = path.suffix.lower()
    if ending not in _FORMATS and find_format(path) is None:
        return diagnose("mesh-of-no-format", ending=ending)
    if path.stat().st_size > MAX_MESH_BYTES:
        return None
    if ending == ".dae":
        with path.open("rb") as file:
            start = file.read(_PROLOGUE)
        return None if b"COLLADA" in start else diagnose("mesh-no-collada")
    if ending not in (".stl", ".obj"):
        return None
    found = read_mesh_file(path, path.stat().st_mtime_ns)
    return found if isinstance(found, Diagnostic) else None


_FORMATS = (
    ".stl",
    ".obj",
    ".msh",
    ".dae",
    ".ply",
    ".off",
    ".glb",
    ".gltf",
    ".fbx",
    ".3ds",
    ".mesh",
    ".wrl",
    ".iv",
)
"""Endings of meshes that MuJoCo, Gazebo, Bullet, Drake or RViz read; whole formats have theirs."""

_PROLOGUE = 4096
"""Bytes of an XML before its first element, with comments."""


def _missing_in_mjcf(file: MjcfFile) -> Iterator[_Missing]:
    folders = [Path()]
    for attributes, _ in file.elements("compiler"):
        folders += [Path(attributes.get(what, "")) for what in ("meshdir", "assetdir")]
    tops = {path.parent / folder for path in file.files for folder in folders}
    for attributes, place in file.elements("mesh"):
        name = attributes.get("file", "")
        places = [top / inside for top in tops for inside in (name, Path(name).name)]
        if name and not any(map(existing_file, places)):
            known = attributes.get("name") or Path(name).stem
            pointer = any(map(is_pointer, places))
            yield _Missing(name, known, place, pointer, name in file.lacking)


def find_first_place(file: MjcfFile, tag: str, attribute: str) -> Place | None:
    """Returns the place of the first element of a kind with an attribute, of an MJCF."""
    return next((place for found, place in file.elements(tag) if attribute in found), None)
