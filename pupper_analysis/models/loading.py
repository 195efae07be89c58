"""Reading of URDFs and MJCFs; malformed files raise an error with file and, if known, line.

Other formats have readers in separate packages, found by `base.tools.formats`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol, cast

from pupper_analysis.base.diagnostics import Diagnostic, Severity, diagnose
from pupper_analysis.base.errors import ModelError
from pupper_analysis.base.runs import register_input
from pupper_analysis.base.tools import find_format
from pupper_analysis.models.mjcf_file import MjcfFile, mjcf_from, read_mjcf
from pupper_analysis.models.objects import ModelObject, check_model, is_object, read_objects
from pupper_analysis.models.places import (
    Place,
    forget_lines,
    make_element_error,
    make_file_error,
)
from pupper_analysis.models.published import expand_xacro, find_file, is_uri, is_xacro
from pupper_analysis.models.stated.model import RobotModel
from pupper_analysis.models.urdf_file import UrdfFile, read_urdf, urdf_from
from pupper_analysis.models.xacro_declarations import remove_declarations
from pupper_analysis.models.xml import parse_file_text, parse_xml


@dataclass(frozen=True)
class CheckFinding:
    """Finding of a check of a file: the element at fault, and the message.

    Attributes:
        kind: Tag of the element at fault.
        name: Name of the element; "" for the whole file.
        message: Description of the problem.
        child: Path below the element, for the line number.
        place: Location, if the element cannot be found by name.
        severity: Severity, if it differs from the severity of the rule; otherwise None.
    """

    kind: str
    name: str
    message: Diagnostic
    child: str | None = None
    place: Place | None = None
    severity: Severity | None = None


Check = Callable[[Any], Iterator[CheckFinding]]
"""Check of the audit: a function of a ``RobotModel``, or of the subclass of a specific format, that
yields findings."""


class ModelFile(Protocol):
    """Interface of a model file in memory, in any format."""

    @property
    def path(self) -> Path:
        """Path of this model file."""

    def place(self, kind: str, name: str, child: str | None = None) -> Place:
        """Return the location (file and line) of an element of this model.

        Args:
            kind: Kind of the element, for example ``link`` or ``joint``.
            name: Name of the element.
            child: Child element to locate instead. Default: the element itself.
        """


class FormatReader(Protocol):
    """Interface of the module ``reader`` of a further file format (other than URDF and MJCF)."""

    CHECKS: Mapping[str, Check]
    """{name of an audit rule, of the format or of this package: check that the format adds to
    it}."""

    def read_file(self, path: Path) -> ModelFile:
        """Read a model file of this format, without building the robot."""

    def read_model(self, file: Any) -> RobotModel:
        """Convert a file from `read_file` to links and joints of the robot, for checks."""

    def read_as_urdf(self, path: Path) -> UrdfFile:
        """Read a file of this format, and convert the model to a URDF with the same values.

        Messages name the original format (``stands_for`` of the result).

        Raises:
            ModelError: If the file cannot be read, or URDF cannot state the model.
            MissingPackageError: If a package that the reader needs is not installed.
        """

    def read_as_mjcf(self, path: Path) -> MjcfFile:
        """Read a file of this format, and convert the model to an MJCF with the same values.

        Messages name the original format (``stands_for`` of the result).

        Raises:
            ModelError: If the file cannot be read, or MJCF cannot state the model.
            MissingPackageError: If a package that the reader needs is not installed.
        """


def reader_of(path: str | Path | ModelObject) -> FormatReader | None:
    """Return the reader for a file of another format than URDF and MJCF, selected by suffix.

    None for other suffixes, addresses (``package://``, ``https://``), and robots in memory.

    Raises:
        ConfigurationError: If ``path`` is neither a path, a text nor a robot in memory.
    """
    if is_object(path):
        return None
    check_model("path", path)
    if is_uri(str(path)):
        return None
    model_format = find_format(Path(cast(str | Path, path)))
    return (
        None
        if model_format is None
        else cast(FormatReader, import_module(f"{model_format.package}.reader"))
    )


def read_model(
    path: str | Path | ModelObject,
    packages: Mapping[str, Path] | None = None,
    xacro: Mapping[str, str] | None = None,
) -> UrdfFile | MjcfFile:
    """Read a URDF or an MJCF from a file or from memory; the root element determines the format.

    An MJCF that MuJoCo parses but does not compile is also returned, with the error in ``refusal``.

    Args:
        path: The file, the name of a published robot, ``package://NAME/FILE``, or a robot in memory
            (see `read_objects`).
        packages: {ROS package: its folder}, for ``package://`` and for ``$(find)`` in a xacro file.
        xacro: {argument: value} with which a xacro file is expanded, which evaluates the Python
            expressions in the file. None: nothing is evaluated.

    Raises:
        ConfigurationError: If ``path`` is of another type, for example.
        ModelError: If the file cannot be loaded, for example because xacro must be expanded.
        UnknownNameError: If a robot of MuJoCo Menagerie or an argument of a xacro file is unknown.
        OutputError: If this run of the command line also writes the file, or for example a mesh.
    """
    if is_object(path):
        with read_objects([cast(ModelObject, path)], packages) as in_memory:
            return in_memory.files[0]
    check_model("path", path)
    path = find_file(cast(str | Path, path), packages)
    register_input(path)
    if xacro is not None and is_xacro(path):
        text = expand_xacro(path, packages, xacro)
        root = parse_file_text(path, text)
        forget_lines(root)
        if root.tag in ("mujoco", "mujocoinclude"):
            raise make_file_error(Place(path), diagnose("xacro-of-mjcf"))
        return urdf_from(path, text, root, packages)
    text, root = parse_xml(path)
    if root.tag in ("mujoco", "mujocoinclude"):
        return mjcf_from(path, root)
    if root.tag != "robot":
        problem = diagnose("no-model", tag=str(root.tag), sdf=root.tag == "sdf")
        raise make_element_error(path, root, problem)
    return urdf_from(path, text, root, packages)


def read_as_urdf(
    model: str | Path | ModelObject,
    packages: Mapping[str, Path] | None = None,
    xacro: Mapping[str, str] | None = None,
) -> UrdfFile:
    """Read a robot as a URDF: a URDF, a file that is converted to a URDF, or a URDF in memory.

    Args:
        model: Path, name of a published robot, or robot in memory. The suffix of the path selects
            the reader of another format.
        packages: {ROS package: its folder}, for ``package://`` and for ``$(find)`` in a xacro file.
        xacro: {argument: value} with which a xacro file is expanded; None: nothing is evaluated.

    Raises:
        ConfigurationError: If ``model`` is of another type, for example.
        ModelError: If the file or object cannot be read, or is not a URDF.
        UnknownNameError: If a robot of MuJoCo Menagerie or an argument of a xacro file is unknown.
        MissingPackageError: If a package that the reader of the format needs is not installed.
        OutputError: If this run of the command line also writes the file, or for example a mesh.
    """
    reader = reader_of(model)
    if reader is not None:
        return reader.read_as_urdf(Path(cast(str | Path, model)))
    if not is_object(model):
        path = find_file(cast(str | Path, model), packages)
        if xacro is None or not is_xacro(path):
            return read_urdf(path, packages)
        model = path
    file = read_model(model, packages, xacro)
    if not isinstance(file, UrdfFile):
        raise ModelError(file.path, diagnose("object-of-other-format", wanted="URDF"))
    return file


def read_as_mjcf(
    model: str | Path | ModelObject, packages: Mapping[str, Path] | None = None
) -> MjcfFile:
    """Read a robot as an MJCF: an MJCF, a file that is converted to an MJCF, or an MJCF in memory.

    Args:
        model: Path, name of a published robot, or robot in memory. The suffix of the path selects
            the reader of another format.
        packages: {ROS package: its folder}, for ``package://`` in ``model``.

    Raises:
        ConfigurationError: If ``model`` is of another type, for example.
        ModelError: If the file or object cannot be read or compiled, or is not an MJCF.
        UnknownNameError: If MuJoCo Menagerie has no such robot.
        MissingPackageError: If a package that the reader of the format needs is not installed.
        OutputError: If this run of the command line also writes the file, or for example a mesh.
    """
    reader = reader_of(model)
    if reader is not None:
        return reader.read_as_mjcf(Path(cast(str | Path, model)))
    if not is_object(model):
        return read_mjcf(find_file(cast(str | Path, model), packages))
    file = read_model(model, packages)
    if not isinstance(file, MjcfFile):
        raise ModelError(file.path, diagnose("object-of-other-format", wanted="MJCF"))
    file.check_compiled()
    return file


def kind_of(path: Path) -> str | None:
    """Return the format of a file that describes a robot: ``"urdf"``, ``"mjcf"`` or None.

    A scene, an MJCF that only includes the robot, does not count. A file with the suffix ``.urdf``
    is not opened.

    Raises:
        OutputError: If this run of the command line also writes the file.
    """
    if path.suffix.lower() == ".urdf":
        return "urdf"
    try:
        _, root = parse_xml(path)
        if root.tag == "robot":
            remove_declarations(path, root, lambda _: None)
    except ModelError:
        return None
    if root.tag == "robot":
        return "urdf" if root.find("link") is not None else None
    return "mjcf" if root.tag == "mujoco" and root.find("worldbody/body") is not None else None
