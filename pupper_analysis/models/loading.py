"""Reads anybody's URDF or MJCF: what is malformed is refused with its file and line.

Formats besides these two have readers in other packages, found by `base.tools.formats`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol, cast

from pupper_analysis.base.arguments import check_type
from pupper_analysis.base.diagnostics import Diagnostic, Severity, diagnose
from pupper_analysis.base.errors import ModelError
from pupper_analysis.base.runs import note_input
from pupper_analysis.base.tools import format_of
from pupper_analysis.models.mjcf_file import MjcfFile, mjcf_from
from pupper_analysis.models.places import NO_LINE, Place, refusal_at
from pupper_analysis.models.published import XACRO, expand_xacro, find_file
from pupper_analysis.models.stated.model import RobotModel
from pupper_analysis.models.urdf_file import UrdfFile, urdf_from
from pupper_analysis.models.xml import parse_file_text, parse_xml


@dataclass(frozen=True)
class Found:
    """What a check of a file yields.

    Attributes:
        kind: The tag of the element at fault.
        name: Its name; "" where the file as a whole is at fault.
        message: What is wrong with it.
        child: A path below the element, for the line.
        place: Where it is, if the element cannot be found by its name.
        severity: If less bad than the rule says.
    """

    kind: str
    name: str
    message: Diagnostic
    child: str | None = None
    place: Place | None = None
    severity: Severity | None = None


Check = Callable[[Any], Iterator[Found]]
"""Takes a ``RobotModel`` (a ``UrdfModel`` and the like, if it is for that format alone)."""


class ModelFile(Protocol):
    """A file that was read."""

    @property
    def path(self) -> Path:
        """The file."""

    def place(self, kind: str, name: str, child: str | None = None) -> Place:
        """Finds an element; see `UrdfFile.place`."""


class Reader(Protocol):
    """What the module ``reader`` of a format's package has."""

    CHECKS: Mapping[str, Check]
    """{rule of the audit, its own or one of ours: what looks for it besides ours}."""

    def read_file(self, path: Path) -> ModelFile:
        """Reads a file."""

    def read_model(self, file: Any) -> RobotModel:
        """Returns the robot that a file states."""

    def read_as_urdf(self, path: Path) -> UrdfFile:
        """Reads a file as a URDF of the same numbers; its ``stands_for`` names the format."""

    def read_as_mjcf(self, path: Path) -> MjcfFile:
        """Reads a file as an MJCF of the same numbers, likewise."""


def reader_of(path: Path) -> Reader | None:
    """Returns who reads a file, by its name; None of a URDF's or an MJCF's."""
    found = format_of(path)
    return None if found is None else cast(Reader, import_module(f"{found.package}.reader"))


def read_model(path: str | Path, packages: Mapping[str, Path] | None = None) -> UrdfFile | MjcfFile:
    """Reads a URDF or an MJCF; the root element tells which it is.

    A xacro file is expanded, if that package is installed: its elements have no lines then.

    An MJCF that MuJoCo parses but does not compile is returned, too, with its ``refusal``.

    Args:
        path: The file, or ``robot_descriptions:NAME``.
        packages: Folders of packages, for a URDF's ``package://``.

    Raises:
        ModelError: If it cannot be loaded; one line that tells where and why.
    """
    check_type("path", path, str | Path)
    path = find_file(path)
    note_input(path)
    if path.suffix == XACRO:
        text = expand_xacro(path)
        root = parse_file_text(path, text)
        for element in root.iter():
            element.sourceline = NO_LINE
    else:
        text, root = parse_xml(path)
    if root.tag in ("mujoco", "mujocoinclude"):
        return mjcf_from(path, root)
    if root.tag != "robot":
        raise refusal_at(path, root, diagnose("no-model", tag=str(root.tag)))
    return urdf_from(path, text, root, packages)


def kind_of(path: Path) -> str | None:
    """Returns ``urdf`` or ``mjcf``; None of what is neither, or a part that other files include.

    An MJCF counts if it has a body of its own: a scene has but a floor around a robot's file.
    """
    if path.suffix.lower() == ".urdf":
        return "urdf"
    try:
        _, root = parse_xml(path)
    except ModelError:
        return None
    if root.tag == "robot":
        return "urdf" if root.find("link") is not None else None
    return "mjcf" if root.tag == "mujoco" and root.find("worldbody/body") is not None else None
