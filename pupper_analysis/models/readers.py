"""Readers of formats besides URDF and MJCF: whoever has one is found by `base.tools.formats`."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol, cast

from pupper_analysis.base.diagnostics import Diagnostic, Severity
from pupper_analysis.base.tools import format_of
from pupper_analysis.models.mjcf_file import MjcfFile
from pupper_analysis.models.places import Place
from pupper_analysis.models.stated.model import RobotModel
from pupper_analysis.models.urdf_file import UrdfFile


@dataclass(frozen=True)
class Found:
    """What a check of a file yields.

    Attributes:
        kind: The tag of the element at fault.
        name: Its name; "" where the file as a whole is at fault.
        told: What is wrong with it.
        child: A path below the element, for the line.
        place: Where it is, if the element cannot be found by its name.
        severity: If less bad than the rule says.
    """

    kind: str
    name: str
    told: Diagnostic
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
