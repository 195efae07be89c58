"""Rules about referenced files, and about models that MuJoCo refuses.

Input is the model of a file. Paths of meshes are resolved, and the STL and OBJ files of a URDF are
parsed; missing meshes are grouped, for example by package and folder. `choose_mesh_axes` decides
whether the rules see the COLLADA meshes of a URDF turned.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from pupper_analysis.base.diagnostics import Diagnostic, Quantity, Severity, diagnose
from pupper_analysis.base.files import describe_os_error
from pupper_analysis.base.inputs import read_change_time
from pupper_analysis.base.tools import find_format
from pupper_analysis.models.loading import CheckFinding
from pupper_analysis.models.mjcf_file import MjcfFile
from pupper_analysis.models.places import Place
from pupper_analysis.models.published import existing_file, is_pointer
from pupper_analysis.models.stated.model import (
    MjcfModel,
    UrdfModel,
)
from pupper_analysis.models.stated.urdf import (
    MAX_READ_MESH_BYTES,
    MESH_SUFFIXES,
    find_turn,
    read_mesh_file,
    read_urdf_model,
)
from pupper_analysis.models.urdf_file import UrdfFile
from pupper_analysis.tools.audit.registry import compute_hull_distance, list_known_points, rule


@rule
def mujoco_refuses(robot: MjcfModel) -> Iterator[CheckFinding]:
    """Report MuJoCo's error if the unmodified file does not compile."""
    if robot.refusal is not None:
        problem, place = robot.refusal
        yield CheckFinding("mujoco", "", diagnose("mujoco-refuses", problem=problem), place=place)


@rule
def mesh_missing(robot: UrdfModel | MjcfModel) -> Iterator[CheckFinding]:
    """Report missing mesh files, grouped by severity, Git LFS pointers, package and folder.

    The severity is WARNING for visual meshes of a URDF, and for files that may exist elsewhere,
    such as Git LFS pointers, URLs and ``package://`` paths. MuJoCo refuses an MJCF with a missing
    mesh.
    """
    refused = isinstance(robot, MjcfModel)
    kind = "mesh" if refused else "link"
    # The folder is None for an empty filename.
    groups: dict[tuple[bool, bool, str, str | None], list[_MissingMesh]] = {}
    for missing in _list_missing_meshes(robot):
        package, has_path, _ = missing.name.removeprefix("package://").partition("/")
        package = package if has_path and missing.name.startswith("package://") else ""
        folder: str | None = "" if package else missing.name.rpartition("/")[0]
        if not missing.name.strip():
            folder = None
        touches = (missing.touches or refused) and not package
        groups.setdefault((missing.pointer, touches, package, folder), []).append(missing)
    for (pointer, touches, package, folder), group in groups.items():
        names = tuple(dict.fromkeys(missing.name for missing in group))
        if folder is None:
            for missing in group:
                severity = None if touches else Severity.WARNING
                message = diagnose("mesh-without-filename")
                yield CheckFinding(
                    kind, missing.owner, message, place=missing.place, severity=severity
                )
            continue
        if pointer:
            message = diagnose("mesh-is-lfs-pointer", meshes=names)
        else:
            message = diagnose(
                "mesh-missing",
                meshes=names,
                first="/".join(names[0].split("/")[-2:]),
                more=len(names) - 1 or None,
                package=package or None,
                folder=_find_package_folder(robot.file.path, names[0]) if package else None,
            )
        is_error = touches and not pointer and "://" not in names[0]
        first, severity = group[0], None if is_error else Severity.WARNING
        yield CheckFinding(kind, first.owner, message, place=first.place, severity=severity)


_MAX_SEARCHED_FOLDERS = 1000
"""Largest number of folders in which a missing package is searched. Chosen, not tuned: the search
takes about 10 ms."""

_NUM_SEARCHED_PARENTS = 2
"""Number of folders, from the folder of a URDF upward, whose subfolders are searched for a missing
package. Chosen, not tuned."""


def _find_package_folder(urdf: Path, name: str) -> str | None:
    """Return a folder that contains the mesh ``package://PACKAGE/...``, whatever the folder's name.

    The subfolders of the folders above the URDF are searched, two levels deep. The path is relative
    to the folder of the URDF; None if there is no such folder.
    """
    inside = name.removeprefix("package://").partition("/")[2]
    home = urdf.absolute().parent
    count = 0
    for parent in (home, *home.parents)[:_NUM_SEARCHED_PARENTS]:
        for pattern in ("*", "*/*"):
            for folder in sorted(parent.glob(pattern)):
                count += 1
                if count > _MAX_SEARCHED_FOLDERS:
                    return None
                if (folder / inside).is_file():
                    return Path(os.path.relpath(folder, home)).as_posix()
    return None


@dataclass(frozen=True)
class _MissingMesh:
    """Mesh file that does not exist, or is a pointer of Git LFS.

    Attributes:
        name: File name, as written.
        owner: Link of a URDF, or mesh asset of an MJCF.
        place: File and line.
        pointer: True if a path to which the name may refer is a pointer of Git LFS.
        touches: True if the mesh is used for collisions.
    """

    name: str
    owner: str
    place: Place
    pointer: bool
    touches: bool = False


def _list_missing_meshes(robot: UrdfModel | MjcfModel) -> Iterator[_MissingMesh]:
    """Yield the mesh files of a model that do not exist or are pointers of Git LFS."""
    if isinstance(robot, MjcfModel):
        yield from _list_missing_in_mjcf(robot.file)
        return
    seen: set[str] = set()
    touching = {mesh.get("filename", "") for mesh in robot.file.root.iterfind(".//collision//mesh")}
    for owner, link in robot.file.tree.links.items():
        for mesh in link.element.iter("mesh"):
            name = mesh.get("filename", "")
            if name not in seen and robot.file.resolve_mesh(name) is None:
                place = Place(robot.file.path, mesh.sourceline)
                pointer = any(map(is_pointer, robot.file.list_mesh_places(name)))
                yield _MissingMesh(name, owner, place, pointer, name in touching)
            if name.strip():  # each element without a filename is reported
                seen.add(name)


@rule
def mesh_unreadable(robot: UrdfModel) -> Iterator[CheckFinding]:
    """Find mesh files of a URDF with an error (`find_mesh_problem`), each file once."""
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
    """Check whether a file is a valid mesh, and return the reason if not.

    STL and OBJ files up to `MAX_READ_MESH_BYTES` are parsed; other formats are hardly checked.

    Returns:
        Message of the error; None if no error was found.
    """
    ending = path.suffix.lower()
    if ending not in _MESH_SUFFIXES and find_format(path) is None:
        return diagnose("mesh-of-no-format", ending=ending)
    try:
        if path.stat().st_size > MAX_READ_MESH_BYTES:
            return None
        start = b""
        if ending == ".dae":
            with path.open("rb") as file:
                start = file.read(_PROLOGUE_BYTES)
    except OSError as error:  # for example deleted since the path was found
        return diagnose("no-mesh", problem=describe_os_error(error))
    if ending == ".dae":  # not every reader accepts the same COLLADA files
        return None if b"COLLADA" in start else diagnose("mesh-no-collada")
    if ending not in MESH_SUFFIXES:
        return None
    found = read_mesh_file(path, read_change_time(path))
    return found if isinstance(found, Diagnostic) else None


MIN_JOINT_GAP = 0.03
"""Distance [m] between the shapes of a link and the farthest of the next moving joints, up to which
the link's mesh counts as correctly oriented. Measured on 15 public URDFs whose distances depend on
the up axis of the meshes: at most 18 mm in 13 files (Laikago), 78 to 170 mm in 11 links of each of
iCub's two files.
"""

MIN_AXIS_VOTES = 2
"""Smallest number of links that need the turn, with which the meshes of a URDF are turned. Chosen,
not tuned."""


def choose_mesh_axes(file: UrdfFile) -> UrdfModel:
    """Read a URDF; turn the up axis of COLLADA meshes to z if several links fit only when turned.

    A link fits if the shapes of the link are close to the next joints.
    """
    as_read = read_urdf_model(file)
    names = list_turned_links(file)
    if not names:
        return as_read
    turned = read_urdf_model(file, turn=True)
    pairs = [(measure_joint_gap(as_read, name), measure_joint_gap(turned, name)) for name in names]
    for_turn, against = (
        sum(unchosen > max(MIN_JOINT_GAP, 2 * chosen) for unchosen, chosen in votes)
        for votes in (pairs, [pair[::-1] for pair in pairs])
    )
    return turned if for_turn >= MIN_AXIS_VOTES and for_turn > 3 * against else as_read


def list_turned_links(file: UrdfFile) -> list[str]:
    """Return the names of the links with a COLLADA mesh whose up axis is not z."""
    return [
        name
        for name, link in file.tree.links.items()
        if any(find_turn(file, mesh) is not None for mesh in link.element.iter("mesh"))
    ]


def measure_joint_gap(robot: UrdfModel, name: str) -> float:
    """Return the largest distance [m] between the shapes of a link and the next moving joints.

    The distance is a lower bound; 0 if unknown.
    """
    body = robot.links[name]
    points, _ = list_known_points([body], body)
    to_frame = body.pose.inverse()
    ends = [
        to_frame.point(child.joints[0].position) for child in robot.children(name) if child.moving
    ]
    if points is None:
        return 0.0
    return max([0.0, *(compute_hull_distance(points, end) for end in ends)])


@rule
def mesh_lies_across(robot: UrdfModel) -> Iterator[CheckFinding]:
    """Find a URDF with COLLADA meshes that fit the links only with the up axis turned to z.

    The turn decreases the distance between the shapes of a link and the next joints. The finding
    names the link with the largest decrease.
    """
    if not robot.turned:
        return
    as_read = read_urdf_model(robot.file)
    gaps = {name: measure_joint_gap(as_read, name) for name in list_turned_links(robot.file)}
    turned = {name: measure_joint_gap(robot, name) for name in gaps}
    worst = max(gaps, key=lambda name: gaps[name] - turned[name])
    message = diagnose(
        "mesh-lies-across",
        gap=Quantity(gaps[worst], "m"),
        turned=Quantity(turned[worst], "m"),
        count=sum(gap > MIN_JOINT_GAP for gap in gaps.values()),
        least=Quantity(MIN_JOINT_GAP, "m"),
    )
    yield CheckFinding("link", worst, message, "visual")


_MESH_SUFFIXES = (
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
"""Suffixes of mesh files that MuJoCo, Gazebo, Bullet, Drake or RViz reads. A file with another
suffix is reported as no mesh, unless a package has registered the format.
"""

_PROLOGUE_BYTES = 4096
"""Number of bytes at the start of a ``.dae`` file that are searched for the word ``COLLADA``; a
file without the word is reported as no mesh. Chosen, not tuned."""


def _list_missing_in_mjcf(file: MjcfFile) -> Iterator[_MissingMesh]:
    """Yield the mesh files of an MJCF that are missing, or are pointers of Git LFS."""
    folders = [Path()]
    for attributes, _ in file.elements("compiler"):
        folders += [Path(attributes.get(what, "")) for what in ("meshdir", "assetdir")]
    tops = {path.parent / folder for path in file.files for folder in folders}
    for attributes, place in file.elements("mesh"):
        name = attributes.get("file", "")
        path = Path(name.replace("\\", "/"))
        places = [top / inside for top in tops for inside in (path, path.name)]
        if name and not any(map(existing_file, places)):
            known = attributes.get("name") or path.stem
            pointer = any(map(is_pointer, places))
            yield _MissingMesh(name, known, place, pointer, name in file.missing_collision_meshes)


def find_first_place(file: MjcfFile, tag: str, attribute: str) -> Place | None:
    """Return file and line of the first element with a tag and an attribute in an MJCF, or None."""
    return next((place for found, place in file.elements(tag) if attribute in found), None)
