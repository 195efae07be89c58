"""Reads anybody's URDF or MJCF: what is malformed is refused with its file and line."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Final

import mujoco
from lxml import etree

from pupper_analysis.errors import ModelError

MAX_BYTES: Final = 20_000_000
"""Largest file that is read."""

MAX_DEPTH: Final = 250
"""Deepest nesting of XML elements."""

_NUMBER = re.compile(r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?")


@dataclass(frozen=True)
class Place:
    """Where something stands.

    Attributes:
        file: The file.
        line: Its line, from 1; None where the file as a whole is meant.
    """

    file: Path
    line: int | None = None

    def __str__(self) -> str:
        return self.file.name if self.line is None else f"{self.file.name}:{self.line}"


@dataclass(frozen=True, eq=False)
class UrdfFile:
    """A URDF that can be loaded.

    Attributes:
        path: The file.
        text: Its XML.
        root: The parsed XML, without comments; ``sourceline`` is an element's line.
        packages: Folders of packages, for ``package://``.
        notes: What was assumed on reading, in plain words.
    """

    path: Path
    text: str = field(repr=False)
    root: etree._Element = field(repr=False)
    packages: Mapping[str, Path] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def place(self, kind: str, name: str, child: str | None = None) -> Place:
        """Finds an element.

        Args:
            kind: Its tag: ``"link"``, ``"joint"``, ``"material"`` ...
            name: Its name.
            child: A path below it (``"limit"``, ``"inertial/mass"``): the innermost that exists.

        Returns:
            Its file and line; the file alone where there is no such element.
        """
        named = (e for e in (*self.root, *self.root.iter(kind)) if e.tag == kind)
        element = next((e for e in named if e.get("name") == name), None)
        if element is None:
            return Place(self.path)
        for tag in child.split("/") if child else ():
            below = element.find(tag)
            if below is None:
                break
            element = below
        return Place(self.path, element.sourceline)

    def resolve_mesh(self, filename: str) -> Path | None:
        """Finds the file that a mesh's ``filename`` means.

        ``package://NAME/...`` and ``model://NAME/...`` are looked up in ``packages``, then in the
        folders of ``ROS_PACKAGE_PATH``, then in the folders above the URDF. Other names are
        relative to the URDF.

        Returns:
            The file, or None where there is none.
        """
        scheme, separator, rest = filename.partition("://")
        if not separator:
            return _existing(self.path.parent / filename)
        if scheme == "file":
            return _existing(self.path.parent / rest)
        if scheme not in ("package", "model"):
            return None
        package, _, inside = rest.partition("/")
        for folder in self._package_folders(package):
            found = _existing(folder / inside)
            if found is not None:
                return found
        return None

    def _package_folders(self, package: str) -> Iterator[Path]:
        if package in self.packages:
            yield Path(self.packages[package])
        for entry in filter(None, os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep)):
            yield from _folders_of_package(Path(entry), package)
        for folder in self.path.absolute().parents:
            yield from _folders_of_package(folder, package)


@dataclass(frozen=True)
class _Node:
    """An element of an MJCF with its includes put in."""

    tag: str
    attributes: Mapping[str, str]
    place: Place
    children: list[_Node]


@dataclass(frozen=True, eq=False)
class MjcfFile:
    """An MJCF that MuJoCo has parsed.

    Attributes:
        path: The file.
        spec: What MuJoCo read, not compiled, without what needs files that are missing.
        files: The file and all it includes.
        notes: What was left out on reading, in plain words.
    """

    path: Path
    spec: mujoco.MjSpec = field(repr=False)
    files: tuple[Path, ...] = ()
    notes: tuple[str, ...] = ()
    _index: Mapping[tuple[str, str], _Node] = field(default_factory=dict, repr=False)

    def place(self, kind: str, name: str, child: str | None = None) -> Place:
        """Finds an element, in the file where it really stands.

        Args:
            kind: Its tag: ``"body"``, ``"joint"``, ``"geom"``, ``"site"``, ``"key"`` ..., or its
                section: ``"actuator"``, ``"sensor"``, ``"equality"``, ``"tendon"``, ``"contact"``.
            name: Its name; an actuator's joint will do, a default's class, and for a joint
                without a name its body.
            child: A path below it (``"inertial"``): the innermost that exists.

        Returns:
            Its file and line; the file alone where there is no such element.
        """
        node = self._index.get((kind, name))
        if node is None:
            return Place(self.path)
        for tag in child.split("/") if child else ():
            tags = ("joint", "freejoint") if tag == "joint" else (tag,)
            below = next((c for c in node.children if c.tag in tags), None)
            if below is None:
                break
            node = below
        return node.place

    def compile(self) -> mujoco.MjModel:
        """Compiles a copy of the spec.

        Raises:
            ModelError: If MuJoCo refuses it; the message is MuJoCo's.
        """
        try:
            with _quiet():
                return self.spec.copy().compile()
        except (ValueError, RuntimeError) as error:
            raise ModelError(self.path, f"MuJoCo cannot compile it: {_one_line(error)}") from error


def read_model(
    path: str | Path, packages: Mapping[str, Path] | None = None
) -> UrdfFile | MjcfFile:
    """Reads a URDF or an MJCF; the root element tells which it is.

    Args:
        path: The file.
        packages: Folders of packages, for a URDF's ``package://``.

    Raises:
        ModelError: If it cannot be loaded; one line that tells where and why.
    """
    path = Path(path)
    text, root = _parse(path)
    if root.tag == "mujoco":
        return _read_mjcf(path, root)
    return _read_urdf(path, text, root, packages)


def read_urdf(path: str | Path, packages: Mapping[str, Path] | None = None) -> UrdfFile:
    """Reads a URDF.

    Args:
        path: The file.
        packages: Folders of packages, for ``package://``.

    Raises:
        ModelError: If it cannot be loaded; one line that tells where and why.
    """
    path = Path(path)
    text, root = _parse(path)
    return _read_urdf(path, text, root, packages)


def read_mjcf(path: str | Path) -> MjcfFile:
    """Reads an MJCF with all it includes.

    Raises:
        ModelError: If it cannot be loaded; one line that tells where and why.
    """
    path = Path(path)
    _, root = _parse(path)
    return _read_mjcf(path, root)


def _read_urdf(
    path: Path, text: str, root: etree._Element, packages: Mapping[str, Path] | None
) -> UrdfFile:
    return UrdfFile(path, text, root, MappingProxyType(dict(packages or {})))


def _read_mjcf(path: Path, root: etree._Element) -> MjcfFile:
    try:
        with _quiet():
            spec = mujoco.MjSpec.from_file(str(path))
    except (ValueError, RuntimeError) as error:
        raise ModelError(path, f"not a valid MJCF: {_one_line(error)}") from error
    return MjcfFile(path, spec, (path,), ())


def _parse(path: Path) -> tuple[str, etree._Element]:
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ModelError(path, f"cannot be read: {error}") from error
    parser = etree.XMLParser(
        resolve_entities=False, no_network=True, load_dtd=False, huge_tree=False,
        remove_comments=True, remove_pis=True, encoding="utf-8",
    )
    try:
        return text, etree.fromstring(text.encode(), parser)
    except etree.XMLSyntaxError as error:
        raise ModelError(path, _one_line(error)) from error


def _existing(path: Path) -> Path | None:
    return path if path.is_file() else None


def _folders_of_package(folder: Path, package: str) -> Iterator[Path]:
    if folder.name == package:
        yield folder
    if (folder / package).is_dir():
        yield folder / package


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())


@contextmanager
def _quiet() -> Iterator[None]:
    yield
