"""Collect the mesh files of a URDF for an MJCF; convert formats that MuJoCo cannot read to OBJ.

Inputs are the paths of a URDF's meshes. Outputs are mesh files, and the names by which the MJCF
refers to the files. There is a name for each file and scale. The conversion of visual meshes can be
deferred (`DeferredMeshes`). Files that cannot be read are omitted and reported.
"""

from __future__ import annotations

import os
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import mujoco
from lxml import etree

from pupper_analysis.base.array_types import Array, IntArray
from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.errors import InputError
from pupper_analysis.base.inputs import read_input
from pupper_analysis.models.mesh_limits import MAX_MESH_BYTES
from pupper_analysis.models.mesh_scenes import UnreadableError, read_merged_mesh
from pupper_analysis.models.mjcf import silence_mujoco
from pupper_analysis.models.mjcf_file import find_flat_mesh
from pupper_analysis.models.places import one_line
from pupper_analysis.models.urdf_file import UrdfFile, describe_missing_meshes
from pupper_analysis.models.xml import add_element, make_unique_name

_PACKAGE_PREFIX = "package://"
"""Prefix of a file of a ROS package, as in ``package://go2_description/meshes/calf.dae``."""


class MeshFiles:
    """Collection of the meshes of a new MJCF, converted from the mesh files of a URDF.

    Each file occurs once per scale (as text). Meshes are registered (`register_mesh`), and then
    added to the MJCF (`write`).

    Attributes:
        urdf: URDF.
        output: Path of the MJCF.
        copied: True to copy all meshes to a folder beside the MJCF.
        made: {path of the file: content} of the mesh files to be written: converted or copied.
        defers: True to convert meshes that are only visual later (`DeferredMeshes`).
    """

    def __init__(
        self, urdf: UrdfFile, output: Path, *, copied: bool = False, defers: bool = False
    ) -> None:
        self.urdf, self.output, self.copied, self.defers = urdf, output, copied, defers
        self._deferred: dict[tuple[Path, str], _DeferredFile] = {}
        self.made: dict[Path, bytes] = {}
        self._left: dict[Diagnostic, list[str]] = {}
        self._lost: dict[Diagnostic, list[str]] = {}
        self._left_visuals: dict[Diagnostic, list[str]] = {}
        self._names: dict[tuple[Path, str], str] = {}
        self._taken: set[str] = set()
        self._places: dict[Path, Path] = {}
        self._stems: set[str] = set()
        self._touching: set[tuple[Path, str]] = set()
        self._shells: set[Path] = set()
        self._collided = {mesh.get("filename") for mesh in urdf.root.iterfind(".//collision//mesh")}

    @property
    def notes(self) -> list[Diagnostic]:
        """Notes on meshes that were left out of the MJCF, a note per reason."""
        return [
            diagnose("meshes-left", files=files, why=why, package=self._package_of(why, files))
            for why, files in self._left.items()
        ] + _describe_left_visuals(self._left_visuals)

    @staticmethod
    def _package_of(why: Diagnostic, files: Sequence[str]) -> str:
        """Return the first ROS package that missing mesh files name; empty without one."""
        missing_files = files if why.code == "no-such-mesh-file" else ()
        named = (
            file.removeprefix(_PACKAGE_PREFIX)
            for file in missing_files
            if file.startswith(_PACKAGE_PREFIX)
        )
        return next(named, "").partition("/")[0]

    @property
    def lost_collision_meshes(self) -> list[Diagnostic]:
        """Notes on the collision meshes that were left out of the MJCF, a note per reason."""
        return [
            diagnose("collision-meshes-lost", files=files, why=why)
            for why, files in self._lost.items()
        ]

    @property
    def missing_files(self) -> Diagnostic | None:
        """Message about missing files of registered meshes, with the remedy; None without any."""
        return describe_missing_meshes(self._left.get(diagnose("no-such-mesh-file"), []))

    def register_mesh(self, mesh: etree._Element, *, touches: bool) -> str | None:
        """Register a ``<mesh>`` of the URDF for the MJCF, and return the mesh name in the MJCF.

        A flat mesh may be registered as a surface without volume.

        Args:
            mesh: Element ``<mesh>``.
            touches: True for a collision mesh. MuJoCo computes the convex hull of such a mesh.

        Returns:
            Name of the mesh. None if the mesh is left out, for example because the file is missing;
            `notes` report the reason.
        """
        file = str(mesh.get("filename"))
        if not file.strip():
            self._record_loss(
                diagnose("mesh-filename-empty"), self._locate_mesh(mesh), touches=touches
            )
            return None
        scale = mesh.get("scale") or "1 1 1"
        path = self.urdf.resolve_mesh(file)
        if path is None:
            self._record_loss(diagnose("no-such-mesh-file"), file, touches=touches)
            return None
        path = path.resolve()
        if (path, scale) in self._names and (not touches or (path, scale) in self._touching):
            return self._names[path, scale]
        if not touches and file in self._collided:
            # MuJoCo caches a mesh as it first occurs. If its first occurrence had no hull, the
            # hull, which takes most of the time, would be computed again for each model.
            hulled = self.register_mesh(mesh, touches=True)
            if hulled is not None:
                return hulled
        is_visual = not touches and path.suffix.lower() in _CONVERTIBLE_SUFFIXES
        defers = self.defers and is_visual
        try:
            if defers:
                self._deferred[path, scale] = _DeferredFile(path, scale, file, read_mesh_file(path))
            else:
                self._add_content(path)
        except UnreadableError as error:
            self._record_loss(error.reason, file, touches=touches, is_visual=is_visual)
            return None
        content = self.made.get(self._choose_path(path))
        try:
            if not defers:
                _test_compile(content, path, scale, touches=touches, shell=path in self._shells)
        except ValueError as error:
            if find_flat_mesh(error) is None:
                reason = diagnose("mesh-refused", message=_extract_message(error))
                self._record_loss(reason, file, touches=touches, is_visual=is_visual)
                return None
            self._shells.add(path)
            return self.register_mesh(mesh, touches=touches)
        if touches:
            self._touching.add((path, scale))
            self._deferred.pop((path, scale), None)
        if (path, scale) not in self._names:
            self._names[path, scale] = make_unique_name(path.stem, self._taken)
        return self._names[path, scale]

    def _locate_mesh(self, mesh: etree._Element) -> str:
        """Return the link and the line of a ``<mesh>``, to name a mesh without a filename."""
        link = next((str(link.get("name")) for link in mesh.iterancestors("link")), "")
        return f"{link} ({self.urdf.path.name}:{mesh.sourceline})"

    def file_of(self, mesh: etree._Element, assets: dict[str, bytes]) -> str | None:
        """Return the file name with which MuJoCo's URDF importer finds a collision ``<mesh>``.

        Args:
            mesh: Element ``<mesh>``.
            assets: Receives {name: content} of converted and copied meshes.

        Returns:
            File name: a key of ``assets`` for a converted or copied mesh, otherwise a path. None if
            the mesh is left out.
        """
        if self.register_mesh(mesh, touches=True) is None:
            return None
        path = self.urdf.resolve_mesh(str(mesh.get("filename")))
        assert path is not None
        place = self._choose_path(path.resolve())
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
        """Add the registered meshes to the ``<asset>`` of an MJCF.

        File names are relative to the folder of the MJCF, unless ``assets`` is given.

        Args:
            asset: Element ``<asset>``; extended in place.
            used: Names of the meshes that the MJCF needs; None: all registered meshes.
            assets: Receives {name: content} of converted and copied meshes. None if the caller
                writes the files.
        """
        for (path, scale), name in self._names.items():
            if used is not None and name not in used:
                continue
            place = self._choose_path(path)
            file = self._make_relative(place)
            if (path, scale) in self._deferred and assets is not None:
                file = _PLACEHOLDER_FILE
                assets[file] = _PLACEHOLDER
            elif assets is not None:
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

    @property
    def deferred(self) -> DeferredMeshes | None:
        """Visual meshes whose conversion was deferred; None if no conversion was deferred."""
        files = {self._names[key]: file for key, file in self._deferred.items()}
        return DeferredMeshes(files) if files else None

    def _make_relative(self, path: Path) -> str:
        """Return the path of a mesh file as text, relative to the folder of the MJCF."""
        return os.path.relpath(path, self.output.parent.resolve())

    def _choose_path(self, path: Path) -> Path:
        """Choose the path that the MJCF uses for a mesh file: the same, or that of a copy."""
        ending = path.suffix.lower()
        if ending in MUJOCO_MESH_SUFFIXES and not self.copied:
            return path
        if path not in self._places:  # unique: folders may contain equal names
            folder = self.output.resolve().with_name(f"{self.output.stem}_meshes")
            stem = make_unique_name(path.stem, self._stems)
            name = f"{stem}{ending if ending in MUJOCO_MESH_SUFFIXES else '.obj'}"
            self._places[path] = folder / name
        return self._places[path]

    def _add_content(self, path: Path) -> None:
        """Read a mesh file; store the content in ``made`` if it must be converted or copied."""
        place, readable = self._choose_path(path), path.suffix.lower() in MUJOCO_MESH_SUFFIXES
        content = self.made.get(place)
        if content is None:
            content = read_mesh_file(path) if readable else convert_to_obj(path)
        if place != path:
            self.made[place] = content

    def _record_loss(
        self, why: Diagnostic, file: str, *, touches: bool = False, is_visual: bool = False
    ) -> None:
        """Record that a mesh file is left out of the MJCF, with the reason, for the notes.

        ``is_visual`` is True for a visual mesh in a format that must be converted.
        """
        left = self._left_visuals if is_visual else self._left
        for found in (left, self._lost) if touches else (left,):
            files = found.setdefault(why, [])
            if file not in files:
                files.append(file)


_PLACEHOLDER_FILE = "deferred_visual_mesh.obj"
"""Name of the file that stands for visual meshes whose conversion is deferred."""

_PLACEHOLDER = b"""v 0 0 0
v 0.01 0 0
v 0 0.01 0
v 0 0 0.01
f 1 3 2
f 1 2 4
f 1 4 3
f 2 3 4
"""
"""OBJ of a tetrahedron that represents deferred meshes, since MuJoCo refuses a geom without mesh.
Three edges of 1 cm meet at a right-angled corner.
"""


@dataclass(frozen=True)
class _DeferredFile:
    """Visual mesh file that is not converted yet.

    Attributes:
        path: File.
        scale: Scale of the mesh, as text.
        name: File name in the URDF.
        content: Content of the file.
    """

    path: Path
    scale: str
    name: str
    content: bytes


class DeferredMeshes:
    """Visual meshes of a URDF whose slow conversion is deferred.

    In the MJCF, a tetrahedron represents each mesh until `insert` is called.
    """

    def __init__(self, files: Mapping[str, _DeferredFile]) -> None:
        self._files = dict(files)

    def insert(self, spec: mujoco.MjSpec) -> list[Diagnostic]:
        """Convert the deferred meshes, and insert them into a spec, in place.

        Meshes that cannot be converted, or that MuJoCo refuses, are removed with their geoms.

        Returns:
            Notes on the removed meshes, a note per reason.
        """
        removed: dict[Diagnostic, list[str]] = {}
        assets = dict(spec.assets)
        for mesh in list(spec.meshes):
            file = self._files.get(mesh.name)
            if file is None:
                continue
            try:
                asset, content, shell = self._convert_mesh(mesh.name)
            except UnreadableError as error:
                files = removed.setdefault(error.reason, [])
                files += [] if file.name in files else [file.name]
                for geom in [geom for geom in spec.geoms if geom.meshname == mesh.name]:
                    spec.delete(geom)
                spec.delete(mesh)
                continue
            mesh.file, assets[asset] = asset, content
            if shell:
                mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
        spec.assets = assets
        return _describe_left_visuals(removed)

    def _convert_mesh(self, name: str) -> tuple[str, bytes, bool]:
        """Convert a deferred mesh to OBJ, and test if MuJoCo accepts the mesh.

        Returns:
            File name, content, and True if the mesh is flat: a surface without volume.
        """
        file = self._files[name]
        content = _convert_content(file.content, file.path.suffix.lower())
        for shell in (False, True):
            try:
                _test_compile(content, file.path, file.scale, touches=False, shell=shell)
            except ValueError as error:
                if shell or find_flat_mesh(error) is None:
                    problem = diagnose("mesh-refused", message=_extract_message(error))
                    raise UnreadableError(problem) from error
            else:
                break
        return f"{name}.obj", content, shell


def _describe_left_visuals(left: Mapping[Diagnostic, Sequence[str]]) -> list[Diagnostic]:
    """Create a note per reason for visual meshes that were left out, from {reason: files}."""
    return [diagnose("visual-meshes-left", files=files, why=why) for why, files in left.items()]


def _test_compile(
    content: bytes | None, path: Path, scale: str, *, touches: bool, shell: bool
) -> None:
    """Raise ValueError if MuJoCo refuses a mesh, by compiling a model with this mesh alone.

    ``content`` is that of the file; None to read ``path``. ``scale`` contains the factors along x,
    y and z. ``touches`` is True if the mesh can collide; MuJoCo then computes its convex hull.
    ``shell`` is True for a surface without volume.
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


def _extract_message(error: ValueError) -> str:
    """Return the message of MuJoCo's error without prefix and element name."""
    return one_line(error).removeprefix("Error: ").split(" Element name")[0].rstrip(". ,")


MUJOCO_MESH_SUFFIXES: Final = (".stl", ".obj")
"""Suffixes of the mesh formats that MuJoCo reads without a conversion. MuJoCo's own ``.msh`` is not
accepted."""

_CONVERTIBLE_SUFFIXES: Final = (".dae", ".glb", ".off", ".ply")
"""Suffixes of the mesh formats that are converted to OBJ. Archives are not converted: the size of
their content is not bounded."""


def convert_to_obj(path: Path) -> bytes:
    """Convert a mesh file to the text of an OBJ file, with all parts merged.

    Args:
        path: Mesh file in a format that MuJoCo cannot read: .dae, .glb, .off or .ply.

    Raises:
        UnreadableError: If the format is not supported, or the file is too large or broken.
    """
    ending = path.suffix.lower()
    if ending not in _CONVERTIBLE_SUFFIXES:
        formats = (*MUJOCO_MESH_SUFFIXES, *_CONVERTIBLE_SUFFIXES)
        raise UnreadableError(diagnose("mesh-format-not-read", formats=formats))
    return _convert_content(read_mesh_file(path), ending)


def _convert_content(data: bytes, ending: str) -> bytes:
    """Convert the content of a mesh file to OBJ; ``ending`` is its suffix, such as ``.dae``."""
    mesh = read_merged_mesh(data, ending)
    return format_obj(mesh.vertices, mesh.faces, mesh.metadata.get("name"))


def format_obj(vertices: Array, faces: IntArray, name: str | None) -> bytes:
    """Format a triangle mesh as the content of an OBJ file.

    Args:
        vertices: Positions, shape (n, 3), in the unit of the file; written with eight decimals.
        faces: Triangles, shape (m, 3), as row indices of ``vertices``, from 0.
        name: Name of the object; None for an object without name.
    """
    title = "" if name is None else f"\no {name}\n"
    places = "v %.8f %.8f %.8f\n" * len(vertices) % tuple(vertices.ravel().tolist()) or "v \n"
    corners = "f %d %d %d\n" * len(faces) % tuple((faces + 1).ravel().tolist()) or "f \n"
    return f"{_OBJ_COMMENT}{title}{places}{corners}\n".encode()


_OBJ_COMMENT = "# https://github.com/mikedh/trimesh\n"
"""First line of a converted OBJ file: the address of trimesh, which reads the mesh files."""


def read_mesh_file(path: Path) -> bytes:
    """Read a mesh file, if it is not too large, and return the content.

    Raises:
        UnreadableError: If the file is larger than `MAX_MESH_BYTES`, or cannot be read.
    """
    try:
        return read_input(path, MAX_MESH_BYTES)
    except InputError as error:
        if error.cause.code == "file-too-large":
            raise UnreadableError(
                diagnose("mesh-too-large", most=MAX_MESH_BYTES // 10**6)
            ) from error
        raise UnreadableError(diagnose("mesh-broken")) from error
