"""The mesh files of a URDF as an MJCF names them: as OBJ, where MuJoCo does not read them."""

from __future__ import annotations

import io
import os
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Final

import mujoco
from lxml import etree

from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.errors import InputError
from pupper_analysis.base.inputs import read_input
from pupper_analysis.models.mjcf import silence_mujoco
from pupper_analysis.models.mjcf_file import flat_mesh
from pupper_analysis.models.places import one_line
from pupper_analysis.models.urdf_file import UrdfFile
from pupper_analysis.models.xml import add_element, make_unique_name

_PACKAGE = "package://"


class MeshFiles:
    """The meshes of a new MJCF, each file with each scale once.

    Attributes:
        notes: What was left out.
        copied: Whether all meshes are copied to a folder beside the MJCF.
        made: {path that the MJCF names: content} of meshes that are written beside the MJCF: in
            formats that MuJoCo cannot read, or copied.
    """

    def __init__(self, urdf: UrdfFile, output: Path, *, copied: bool = False) -> None:
        self.urdf, self.output, self.copied = urdf, output, copied
        self.made: dict[Path, bytes] = {}
        self._left: dict[Diagnostic, list[str]] = {}
        self._lost: dict[Diagnostic, list[str]] = {}
        self._names: dict[tuple[Path, str], str] = {}
        self._taken: set[str] = set()
        self._places: dict[Path, Path] = {}
        self._stems: set[str] = set()
        self._touching: set[tuple[Path, str]] = set()
        self._shells: set[Path] = set()
        self._collided = {mesh.get("filename") for mesh in urdf.root.iterfind(".//collision//mesh")}

    @property
    def notes(self) -> list[Diagnostic]:
        """What was left out, by reason."""
        return [
            diagnose("meshes-left", files=files, why=why, package=self._package_of(why, files))
            for why, files in self._left.items()
        ]

    @staticmethod
    def _package_of(why: Diagnostic, files: Sequence[str]) -> str:
        """Returns the first ROS package of which files are not there; empty if none is."""
        there_not = files if why.code == "no-such-mesh-file" else ()
        named = (file.removeprefix(_PACKAGE) for file in there_not if file.startswith(_PACKAGE))
        return next(named, "").partition("/")[0]

    @property
    def lost(self) -> list[Diagnostic]:
        """Which files cannot be what the robot touches with, by reason."""
        return [
            diagnose("collision-meshes-lost", files=files, why=why)
            for why, files in self._lost.items()
        ]

    @property
    def missing(self) -> Diagnostic | None:
        """Which files are not there, and what helps; None if all are."""
        files = self._left.get(diagnose("no-such-mesh-file"), [])
        packages = any("://" in file for file in files)
        return diagnose("meshes-missing", files=files, packages=packages) if files else None

    def name(self, mesh: etree._Element, *, touches: bool) -> str | None:
        """Returns the name of a URDF's <mesh> in the MJCF; None if it is left out.

        Args:
            mesh: The element.
            touches: Whether it is one for collisions, whose hull MuJoCo works out.
        """
        file = str(mesh.get("filename"))
        scale = mesh.get("scale") or "1 1 1"
        path = self.urdf.resolve_mesh(file)
        if path is None:
            self._leave(diagnose("no-such-mesh-file"), file, touches=touches)
            return None
        path = path.resolve()
        if (path, scale) in self._names and (not touches or (path, scale) in self._touching):
            return self._names[path, scale]
        if not touches and file in self._collided:
            # MuJoCo keeps a mesh as it first meets it: the hull, most of the work, would be made
            # anew in every model if the first had none.
            hulled = self.name(mesh, touches=True)
            if hulled is not None:
                return hulled
        try:
            self._take(path)
        except UnreadableError as error:
            self._leave(error.reason, file, touches=touches)
            return None
        content = self.made.get(self._place(path))
        try:
            _compile(content, path, scale, touches=touches, shell=path in self._shells)
        except ValueError as error:
            if flat_mesh(error) is None:
                self._leave(diagnose("mesh-refused", message=_said(error)), file, touches=touches)
                return None
            self._shells.add(path)
            return self.name(mesh, touches=touches)
        if touches:
            self._touching.add((path, scale))
        if (path, scale) not in self._names:
            self._names[path, scale] = make_unique_name(path.stem, self._taken)
        return self._names[path, scale]

    def file_of(self, mesh: etree._Element, assets: dict[str, bytes]) -> str | None:
        """Returns what MuJoCo reads for a URDF's <mesh> that touches; None if it is left out.

        Args:
            mesh: The element.
            assets: Takes {name: content} of meshes that are written anew.
        """
        if self.name(mesh, touches=True) is None:
            return None
        path = self.urdf.resolve_mesh(str(mesh.get("filename")))
        assert path is not None
        place = self._place(path.resolve())
        if place in self.made:
            assets[place.name] = self.made[place]
        return place.name if place in self.made else str(place)

    def write(
        self,
        asset: etree._Element,
        *,
        used: Collection[str] | None = None,
        assets: dict[str, bytes] | None = None,
    ) -> None:
        """Adds the meshes to an MJCF's <asset>.

        Args:
            asset: The element.
            used: The names of those that are needed; all by default.
            assets: Takes {name: content} of the meshes that are written anew, if there is to be no
                file; all other paths are absolute then.
        """
        for (path, scale), name in self._names.items():
            if used is not None and name not in used:
                continue
            place = self._place(path)
            file = self._relative(place)
            if assets is not None:
                file = str(place)
                if place in self.made:
                    file = place.name
                    assets[file] = self.made[place]
            scaled = [float(word) for word in scale.split()] != [1.0, 1.0, 1.0]
            own = Path(file).stem == name
            add_element(
                asset,
                "mesh",
                name=None if own else name,
                file=Path(file).as_posix(),
                scale=scale if scaled else None,
                inertia="shell" if path in self._shells else None,
            )

    def _relative(self, path: Path) -> str:
        """Returns a file's path from the folder of the MJCF."""
        return os.path.relpath(path, self.output.parent.resolve())

    def _place(self, path: Path) -> Path:
        """Returns the file that the MJCF names for a file of the URDF."""
        ending = path.suffix.lower()
        if ending in MUJOCO_MESH_SUFFIXES and not self.copied:
            return path
        if path not in self._places:  # two of one name may come from different folders
            folder = self.output.resolve().with_name(f"{self.output.stem}_meshes")
            stem = make_unique_name(path.stem, self._stems)
            name = f"{stem}{ending if ending in MUJOCO_MESH_SUFFIXES else '.obj'}"
            self._places[path] = folder / name
        return self._places[path]

    def _take(self, path: Path) -> None:
        """Writes a mesh anew if it is in a format that MuJoCo does not read.

        Raises:
            UnreadableError: If it cannot be, or is too large.
        """
        place, readable = self._place(path), path.suffix.lower() in MUJOCO_MESH_SUFFIXES
        content = self.made.get(place)
        if content is None:
            content = read_mesh(path) if readable else convert_to_obj(path)
        if place != path:
            self.made[place] = content

    def _leave(self, why: Diagnostic, file: str, *, touches: bool = False) -> None:
        for found in (self._left, self._lost) if touches else (self._left,):
            files = found.setdefault(why, [])
            if file not in files:
                files.append(file)


def _compile(content: bytes | None, path: Path, scale: str, *, touches: bool, shell: bool) -> None:
    """Lets MuJoCo compile a mesh.

    Raises:
        ValueError: If it does not take it.
    """
    spec = mujoco.MjSpec()
    spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE
    name = path.name
    if content is not None:
        name = (
            f"{path.stem}{path.suffix if path.suffix.lower() in MUJOCO_MESH_SUFFIXES else '.obj'}"
        )
        spec.assets = {name: content}
    mesh = spec.add_mesh(
        name="mesh",
        file=name if content is not None else str(path),
        scale=[float(word) for word in scale.split()],
    )
    if shell:
        mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
    geom = spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="mesh")
    geom.contype = geom.conaffinity = int(touches)
    try:
        with silence_mujoco():
            spec.compile()
    except RuntimeError as error:
        raise ValueError(str(error)) from error


def _said(error: ValueError) -> str:
    return one_line(error).removeprefix("Error: ").split(" Element name")[0].rstrip(". ,")


MUJOCO_MESH_SUFFIXES: Final = (".stl", ".obj")
"""Endings of the mesh files that MuJoCo reads."""

_CONVERTIBLE: Final = (".dae", ".glb", ".off", ".ply")
"""Endings of those that are read here: no archives, whose content may be of any size and kind."""

MAX_MESH_BYTES: Final = 50_000_000
"""Largest mesh file that is read: twice the largest of a published robot that was seen, and of
as much text MuJoCo works out the hull within a minute."""

MAX_MESH_VERTICES: Final = 1_000_000
"""Most vertices of a mesh: MuJoCo takes 5 s and 2 GB to compile so many, each time it does. The
most of a published robot that was seen are 830,000, three for each triangle (Go1's trunk)."""


class UnreadableError(Exception):
    """A mesh file is not taken.

    Attributes:
        reason: Why, of several files.
    """

    def __init__(self, reason: Diagnostic) -> None:
        self.reason = reason
        super().__init__(str(reason))


def convert_to_obj(path: Path) -> bytes:
    """Returns a mesh as OBJ, all its parts in one.

    Raises:
        UnreadableError: If it is in no format that is read, or too large, or broken.
    """
    ending = path.suffix.lower()
    if ending not in _CONVERTIBLE:
        formats = (*MUJOCO_MESH_SUFFIXES, *_CONVERTIBLE)
        raise UnreadableError(diagnose("mesh-format-not-read", formats=formats))
    import trimesh  # comes with yourdfpy, and is slow to import

    data = read_mesh(path)
    try:
        scene = trimesh.load_scene(io.BytesIO(data), file_type=ending[1:], skip_materials=True)
        count = sum(
            len(scene.geometry[scene.graph[node][1]].vertices)
            for node in scene.graph.nodes_geometry
        )
        _check_count(count, MAX_MESH_VERTICES)
        for shape in scene.geometry.values():
            shape.visual = None  # else pictures are put together for all parts: 200 MB a mesh
        text: str = trimesh.exchange.obj.export_obj(
            scene.to_mesh(), include_color=False, include_texture=False, include_normals=False
        )
        return text.encode()
    except UnreadableError:
        raise
    except Exception as error:  # whatever the many readers raise of broken files
        raise UnreadableError(diagnose("mesh-broken")) from error


def read_mesh(path: Path) -> bytes:
    """Returns the content of a mesh file that is no larger than any mesh of a robot.

    Raises:
        UnreadableError: If it is, or cannot be read.
    """
    try:
        return read_input(path, MAX_MESH_BYTES)
    except InputError as error:
        if error.cause.code == "file-too-large":
            raise UnreadableError(
                diagnose("mesh-too-large", most=MAX_MESH_BYTES // 10**6)
            ) from error
        raise UnreadableError(diagnose("mesh-broken")) from error


def _check_count(vertices: int, most: int) -> None:
    if vertices > most:
        raise UnreadableError(diagnose("mesh-has-too-many-vertices", most=most))
