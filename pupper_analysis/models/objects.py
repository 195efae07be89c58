"""Robots in memory (objects of MuJoCo, Pinocchio and yourdfpy, and XML texts) as model files.

The objects are not modified. Except for ``UrdfFile`` and ``MjcfFile``, their file names and line
numbers are unknown; a note states this.
"""

from __future__ import annotations

import reprlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Protocol, TypeAlias, runtime_checkable

import mujoco
import numpy as np
import pinocchio as pin

from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.errors import ConfigurationError, ModelError
from pupper_analysis.models.decompile import make_spec_of_model
from pupper_analysis.models.mjcf import compile_spec, silence_mujoco, to_xml
from pupper_analysis.models.mjcf_file import MjcfFile, mjcf_of_spec
from pupper_analysis.models.pinocchio_urdf import write_urdf_of_model
from pupper_analysis.models.places import forget_lines, make_element_error, one_line
from pupper_analysis.models.urdf_file import UrdfFile, urdf_from
from pupper_analysis.models.xml import parse_file_text


@runtime_checkable
class UrdfObject(Protocol):
    """Parsed URDF of another package that writes its XML, such as ``yourdfpy.URDF``."""

    def write_xml_string(self, **kwargs: Any) -> bytes:
        """Return the XML text of the URDF; ``kwargs`` are options of the object's own method."""


ModelObject: TypeAlias = (
    mujoco.MjSpec
    | mujoco.MjModel
    | pin.Model
    | pin.GeometryModel
    | pin.RobotWrapper
    | UrdfObject
    | UrdfFile
    | MjcfFile
)
"""Robot in memory. A ``pin.GeometryModel`` contains the shapes of a ``pin.Model``; a
``pin.RobotWrapper`` contains both. ``UrdfFile`` and ``MjcfFile`` are files that have been read.
"""


def is_object(model: object) -> bool:
    """Return True if an argument is a robot in memory (an object or an XML text), not a path."""
    if isinstance(model, str):
        return model.lstrip("\ufeff \t\r\n").startswith("<")
    kinds = (
        *(mujoco.MjSpec, mujoco.MjModel, pin.Model, pin.GeometryModel, pin.RobotWrapper),
        *(UrdfFile, MjcfFile),
    )
    return isinstance(model, kinds) or (
        not isinstance(model, Path | type) and isinstance(model, UrdfObject)
    )


def check_model(argument: str, model: object) -> None:
    """Check that a model is a path, a text or a robot in memory.

    Raises:
        ConfigurationError: If the model has another type; the message lists the accepted types.
    """
    if not isinstance(model, str | PathLike) and not is_object(model):
        given = " ".join(reprlib.repr(model).split())
        raise ConfigurationError(argument, diagnose("no-robot", value=given))


def require_path(argument: str, model: object) -> None:
    """Raise an error if a model is a robot in memory, because it has no file to write.

    Raises:
        ConfigurationError: If the model is an object or an XML text.
    """
    if is_object(model):
        raise ConfigurationError(argument, diagnose("object-without-file"))


@dataclass(frozen=True, eq=False)
class ObjectFiles:
    """`UrdfFile` and `MjcfFile` objects that were made of robots in memory.

    Attributes:
        files: Model files.
        source: First Pinocchio model among the objects, for armature and gravity, which a URDF
            cannot state; None if there is none.
        folder: Temporary folder with the meshes of the Pinocchio model.
    """

    files: tuple[UrdfFile | MjcfFile, ...]
    source: pin.Model | None
    folder: Path

    def add_pinocchio_values(self, mjcf: MjcfFile) -> MjcfFile:
        """Add armature and gravity of the Pinocchio model to an MJCF; a URDF cannot state them.

        Meshes in `folder` become assets in memory.

        Returns:
            Modified copy; ``mjcf`` itself without a Pinocchio model.

        Raises:
            ModelError: If MuJoCo does not compile the result, for example.
        """
        if self.source is None:
            return mjcf
        model, spec = self.source, mjcf.spec.copy()
        spec.option.gravity = np.array(model.gravity.linear)
        for joint in spec.joints:
            if model.existJointName(joint.name):
                dof = model.joints[model.getJointId(joint.name)].idx_v
                joint.armature = float(model.armature[dof])
        contents = dict(spec.assets)
        for mesh in spec.meshes:
            file = Path(mesh.file)
            if file.parent == self.folder:
                contents[file.name], mesh.file = file.read_bytes(), file.name
        spec.assets = contents
        return replace(mjcf, spec=spec, _model=compile_spec(spec.copy(), mjcf.path))


@contextmanager
def read_objects(
    models: Sequence[ModelObject | str], packages: Mapping[str, Path] | None = None
) -> Iterator[ObjectFiles]:
    """Context manager: convert robots in memory to `UrdfFile` and `MjcfFile` objects.

    Meshes of a geometry model are in a private temporary folder, which is removed at the end.

    Args:
        models: Objects. A ``pin.GeometryModel`` contains the shapes of the only ``pin.Model``.
        packages: {ROS package: its folder}, for ``package://`` in a URDF.

    Raises:
        ConfigurationError: If a geometry model does not belong to exactly one ``pin.Model``, for
            example.
        ModelError: If no robot can be made of an object; the message names the reason.
        OutputError: If this run of the command line also writes a file that a model uses.
    """
    parts = [part for model in models for part in _split_wrapper(model)]
    shapes = [model for model in parts if isinstance(model, pin.GeometryModel)]
    non_geometry_models = [model for model in parts if not isinstance(model, pin.GeometryModel)]
    owners = [model for model in non_geometry_models if isinstance(model, pin.Model)]
    if len(shapes) > 1 or (shapes and len(owners) != 1):
        raise ConfigurationError("model", diagnose("geometry-without-model"))
    if shapes and not _is_geometry_of(shapes[0], owners[0]):
        raise ConfigurationError("model", diagnose("geometry-of-another-model"))
    geometry = shapes[0] if shapes else None
    with TemporaryDirectory() as folder:
        files = [
            _read_object(model, geometry, packages, Path(folder)) for model in non_geometry_models
        ]
        yield ObjectFiles(tuple(files), owners[0] if owners else None, Path(folder))


def _split_wrapper(model: ModelObject | str) -> tuple[ModelObject | str, ...]:
    """Split a ``pin.RobotWrapper`` into model and collision model; keep other objects."""
    if not isinstance(model, pin.RobotWrapper):
        return (model,)
    shapes = model.collision_model
    return (model.model,) if shapes is None else (model.model, shapes)


def _is_geometry_of(geometry: pin.GeometryModel, model: pin.Model) -> bool:
    """Return True if joints and frames of a geometry model's shapes fit to a Pinocchio model."""
    return all(
        item.parentJoint < model.njoints
        and item.parentFrame < model.nframes
        and model.frames[item.parentFrame].parentJoint == item.parentJoint
        for item in geometry.geometryObjects
    )


def _read_object(
    model: Any,
    geometry: pin.GeometryModel | None,
    packages: Mapping[str, Path] | None,
    folder: Path,
) -> UrdfFile | MjcfFile:
    """Convert a robot in memory (object or XML text) to a `UrdfFile` or `MjcfFile`.

    ``geometry`` contains the shapes of a ``pin.Model``; its meshes are written to ``folder``.
    """
    if isinstance(model, UrdfFile | MjcfFile):
        return model
    if isinstance(model, str):
        return _make_text_file(model, "XML text", packages)
    if isinstance(model, mujoco.MjSpec):
        name = f"MjSpec {model.modelname}"
        path = Path(model.modelfiledir) / f"<{name}>"
        return _read_spec(path, model, name)
    if isinstance(model, mujoco.MjModel):
        spec = make_spec_of_model(model, "MjModel")
        name = f"MjModel {spec.modelname}"
        return mjcf_of_spec(Path(f"<{name}>"), spec, (_make_memory_note(name),))
    if isinstance(model, pin.Model):
        name = f"pin.Model {model.name}"
        path = Path(f"<{name}>")
        text = write_urdf_of_model(model, geometry, folder, str(path))
        return _read_urdf(path, text, packages, _make_memory_note(name))
    try:
        text = model.write_xml_string()
    except Exception as error:  # another package may raise any exception
        problem = diagnose("object-not-written", message=one_line(error))
        raise ModelError(type(model).__name__, problem) from error
    name = f"{type(model).__module__.partition('.')[0]}.{type(model).__name__}"
    return _make_text_file(text.decode(), name, packages)


def _read_spec(path: Path, spec: mujoco.MjSpec, name: str) -> MjcfFile:
    """Return the `MjcfFile` of a spec; if its XML is not usable, via the compiled model.

    The XML of a spec with an attached model may be missing, because the compiler settings differ,
    or the folder of the attached model's files is unknown.
    """
    note, file = _make_memory_note(name), None
    problem: Exception | None = None
    try:
        with silence_mujoco():
            to_xml(spec)
        file = mjcf_of_spec(path, spec, (note,))
        if all(found.code != "files-missing" for found in file.notes):
            return file
    except (ValueError, RuntimeError, mujoco.FatalError) as unwritten:
        problem = unwritten
    except ModelError as error:
        if error.cause.code != "mass-of-missing-mesh":
            raise
        problem = error
    try:
        with silence_mujoco():
            decompiled = make_spec_of_model(spec.copy().compile(), name)
    except (ValueError, RuntimeError, ModelError):  # files are missing, or the spec is not valid
        if file is not None:
            return file
        if isinstance(problem, ModelError):
            raise problem from None
        return mjcf_of_spec(path, spec, (note,))
    reason = "" if file or isinstance(problem, ModelError) else one_line(problem)
    return mjcf_of_spec(path, decompiled, (note, diagnose("spec-read-compiled", message=reason)))


def _make_memory_note(name: str) -> Diagnostic:
    """Return the note that a robot was read from memory, without file names and line numbers."""
    return diagnose("model-in-memory", name=name)


def _make_text_file(
    text: str, name: str, packages: Mapping[str, Path] | None
) -> UrdfFile | MjcfFile:
    """Convert an XML text in memory to a `UrdfFile` or `MjcfFile`.

    Relative paths in the text start at the current folder. ``name`` is the kind of the robot in
    memory, for messages.
    """
    path = Path(f"<{name}>")
    text = text.lstrip("\ufeff \t\r\n")
    root = parse_file_text(path, text)
    if root.tag == "mujoco":
        try:
            spec = mujoco.MjSpec.from_string(text)
        except (ValueError, RuntimeError) as error:
            problem = diagnose("mjcf-not-valid", message=one_line(error))
            raise ModelError(str(path), problem) from error
        return mjcf_of_spec(path, spec, (_make_memory_note(name),))
    if root.tag != "robot":
        problem = diagnose("no-model", tag=str(root.tag), sdf=root.tag == "sdf")
        raise make_element_error(path, root, problem)
    return _read_urdf(path, text, packages, _make_memory_note(name))


def _read_urdf(
    path: Path, text: str, packages: Mapping[str, Path] | None, note: Diagnostic
) -> UrdfFile:
    """Read a URDF from a text without a file; the elements get no line numbers.

    ``note`` is put in front of the notes of the URDF.
    """
    root = parse_file_text(path, text)
    forget_lines(root)
    file = urdf_from(path, text, root, packages)
    return replace(file, notes=(note, *file.notes))
