"""Load a robot from a URDF, an MJCF, or both.

Inputs are file names, or robots in memory, and options. `read_pair` reads the files. If there is a
single file, the other model is converted from this file in memory (`ModelPair`). `load_robot` then
runs the passes of the preparation (`prepare.passes`), and returns a `Robot` with notes on all
changes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import cast

import mujoco
import numpy as np

from pupper_analysis.base.arguments import check_arguments, check_type
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError, ModelError
from pupper_analysis.models.conversion import UrdfImport
from pupper_analysis.models.loading import read_model
from pupper_analysis.models.mjcf import silence_mujoco
from pupper_analysis.models.mjcf_file import MjcfFile, read_mjcf
from pupper_analysis.models.objects import ModelObject, check_model, is_object, read_objects
from pupper_analysis.models.published import find_file, make_xacro_request
from pupper_analysis.models.urdf_file import UrdfFile, read_urdf, urdf_from
from pupper_analysis.models.xml import parse_text
from pupper_analysis.prepare.convert.from_urdf import convert_urdf_in_memory
from pupper_analysis.prepare.convert.to_urdf import ConvertedUrdf, with_one_robot
from pupper_analysis.prepare.passes import Feet, make_robot
from pupper_analysis.robot.robot import PublishedFile, Robot

_URDF_NOTE_CODES = (
    "armature-from-mjcf",
    "effort-unstated",
    "fixed-base-stands",
    "root-link-left-out",
)
"""Codes of notes about a URDF. The notes are omitted if the URDF was converted from the MJCF: the
user has no URDF.
"""


@dataclass(frozen=True, eq=False)
class ModelPair:
    """URDF and MJCF of a robot; the model without a file is converted from the other.

    Attributes:
        urdf: URDF.
        mjcf: MJCF.
        converted: ``"urdf"`` or ``"mjcf"`` if this model was converted from the other model; empty
            if both have files.
        imported: URDF for MuJoCo's own importer; None if there is an MJCF file, or if the URDF was
            made from a Pinocchio model.
    """

    urdf: UrdfFile
    mjcf: MjcfFile
    converted: str = ""
    imported: UrdfImport | None = None

    @staticmethod
    def from_file(file: UrdfFile | MjcfFile, *, defer_visuals: bool = False) -> ModelPair:
        """Complete a single file to a pair: convert it to the other format in memory.

        Args:
            file: URDF or MJCF.
            defer_visuals: True to convert the visual meshes of a URDF later, when they are first
                needed (`make_robot`).

        Raises:
            ModelError: If the other format cannot represent the robot, for example because no joint
                moves.
        """
        if isinstance(file, UrdfFile):
            urdf, mjcf, imported = convert_urdf_in_memory(file, defer_visuals=defer_visuals)
            return ModelPair(urdf, mjcf, "mjcf", imported)
        return ModelPair(_convert_mjcf_in_memory(file), file, "urdf")

    def add_source(self, robot: Robot, keyframe: str | None = None) -> Robot:
        """Add the published file to a robot, and a note if a model was converted from the other.

        Args:
            robot: Robot that was prepared from this pair.
            keyframe: Requested keyframe; None if none was requested.
        """
        file = None if self.converted == "mjcf" else self.mjcf
        robot = replace(robot, published=PublishedFile(file, keyframe, self.imported))
        if not self.converted:
            return robot
        description = replace(robot.description, converted=self.converted)
        source = self.urdf if self.converted == "mjcf" else self.mjcf
        format_name = self.converted.upper()
        message = diagnose("one-model-converted", made=format_name, file=source.path.name)
        ignored_codes = _URDF_NOTE_CODES if self.converted == "urdf" else ()
        kept = [note for note in robot.notes if note.code not in ignored_codes]
        return replace(robot, description=description, notes=(message, *kept))


def _convert_mjcf_in_memory(file: MjcfFile) -> UrdfFile:
    """Convert an MJCF to a URDF in memory; ball joints are fixed if possible, or refused."""
    text = ConvertedUrdf.from_mjcf(file, file.path, fix_balls=True).text
    urdf = urdf_from(file.path, text, parse_text(text), None)
    if all(joint.is_fixed for joint in urdf.tree.joints.values()):
        model = file.model
        balls = [
            model.joint(int(joint)).name
            for joint in np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_BALL)
        ]
        problem = diagnose("ball-joints-alone", joints=balls) if balls else diagnose("no-joints")
        raise ModelError(file.path, problem)
    return urdf


def read_pair(
    *models: str | Path | ModelObject,
    urdf: str | Path | None = None,
    mjcf: str | Path | None = None,
    take: str | None = None,
    body: str | None = None,
    packages: Mapping[str, str | Path] | None = None,
    xacro: bool = False,
    xacro_args: Mapping[str, str] | None = None,
    defer_visuals: bool = False,
) -> ModelPair:
    """Read the files of a robot, and convert a missing URDF or MJCF from the other model.

    Args:
        *models: A URDF, an MJCF, or both, in any order: paths, XML texts or objects.
        urdf: Path of the URDF.
        mjcf: Path of the MJCF.
        take: ``"urdf"`` or ``"mjcf"``: use only the file of this format. The other file is read,
            but ignored.
        body: Root body or any other body of the robot, for an MJCF with several robots. None: the
            robot is detected if there is no URDF.
        packages: {ROS package: folder}, for ``package://`` paths of the URDF and ``$(find)`` of a
            xacro file.
        xacro: True to expand xacro files, which evaluates the Python expressions in the files.
        xacro_args: {argument of the xacro file: value}; other arguments have default values.
        defer_visuals: True to convert the visual meshes of a URDF file later, in the preparation.

    Raises:
        ConfigurationError: If there is no file, or if two files have the same format, for example.
        ModelError: If a file cannot be read, or the other format cannot represent the robot, for
            example.
        UnknownNameError: If the MJCF has no such body.
    """
    for name, folder in (packages or {}).items():
        check_type(f"packages[{name}]", folder, str | Path)
    folders = {name: Path(folder) for name, folder in (packages or {}).items()}
    objects = [model for model in models if is_object(model)]
    paths: list[str | Path] = []
    for model in models:
        if not is_object(model):
            check_model("model", model)
            paths.append(cast(str | Path, model))
    named = [*paths, *(path for path in (urdf, mjcf) if path is not None)]
    request = make_xacro_request(named, folders, xacro=xacro, arguments=xacro_args)

    def read(path: str | Path) -> UrdfFile | MjcfFile:
        """Read a URDF or MJCF from a path."""
        return read_model(path, folders, request)

    with read_objects(objects, folders) as in_memory:
        files = [*in_memory.files, *map(read, paths)]
        pair = _pair_files(
            files,
            read,
            urdf=urdf,
            mjcf=mjcf,
            take=take,
            body=body,
            folders=folders,
            defer_visuals=defer_visuals and not objects,
        )
        if in_memory.source is None or pair.converted != "mjcf":
            return pair
        # MuJoCo's import of the URDF would lack the armature.
        return replace(pair, mjcf=in_memory.add_pinocchio_values(pair.mjcf), imported=None)


def _pair_files(
    files: list[UrdfFile | MjcfFile],
    read_file: Callable[[str | Path], UrdfFile | MjcfFile],
    *,
    urdf: str | Path | None,
    mjcf: str | Path | None,
    take: str | None,
    body: str | None,
    folders: Mapping[str, Path],
    defer_visuals: bool,
) -> ModelPair:
    """Select the URDF and the MJCF among files; convert a missing model from the other model.

    ``files`` were read from positional arguments, and are extended in place. The options are those
    of `read_pair`.
    """
    for path, kind, read in ((urdf, UrdfFile, read_urdf), (mjcf, MjcfFile, read_mjcf)):
        if path is not None:
            files.append(read_file(path))
            if not isinstance(files[-1], kind):
                read(find_file(path, folders))  # raises an error that names the actual format
    found = {"urdf" if isinstance(file, UrdfFile) else "mjcf": file for file in files}
    if not files or len(found) < len(files):
        paths = [str(file.path) for file in files]
        raise ConfigurationError("model", diagnose("not-one-robots-files", files=paths))
    if take is not None and take not in found:
        raise ConfigurationError("take", diagnose("take-what-is-not-there", take=take))
    if take is not None:
        found = {take: found[take]}
    urdf_file, mjcf_file = found.get("urdf"), found.get("mjcf")
    if body is not None and not isinstance(mjcf_file, MjcfFile):
        raise ConfigurationError("body", diagnose("body-of-an-mjcf"))
    if isinstance(mjcf_file, MjcfFile):
        mjcf_file.check_compiled()
        if urdf_file is None or body is not None:
            mjcf_file = with_one_robot(mjcf_file, body)
    if isinstance(urdf_file, UrdfFile) and isinstance(mjcf_file, MjcfFile):
        return ModelPair(urdf_file, mjcf_file)
    return ModelPair.from_file(mjcf_file or next(iter(found.values())), defer_visuals=defer_visuals)


@check_arguments
@silence_mujoco()
def load_robot(
    *models: str | Path | ModelObject,
    urdf: str | Path | None = None,
    mjcf: str | Path | None = None,
    take: str | None = None,
    body: str | None = None,
    feet: Feet | None = None,
    fixed_base: bool = False,
    name: str | None = None,
    joints: Mapping[str, str] | None = None,
    keyframe: str | None = None,
    packages: Mapping[str, str | Path] | None = None,
    xacro: bool = False,
    xacro_args: Mapping[str, str] | None = None,
    as_is: bool = False,
    visuals: bool = True,
) -> Robot:
    """Load a robot from a URDF, an MJCF or both, as published.

    The files need not describe a robot that can stand. What is missing is added in memory, and
    reported in ``notes``:

    - A missing URDF or MJCF is converted from the other model.
    - Joints with different names are matched. Joints that a single file contains are held at zero.
    - A missing floor, free base and position servos are added if needed.
    - If the robot stands in no keyframe of the MJCF, a stand is searched.

    Servos and visual meshes are usually made when first needed, for example by the first access to
    ``mj_model``, ``description`` or ``notes``. Access to ``pin_model``, joint names or feet does
    not trigger this. Mesh files may be read again when visual meshes are made.

    Args:
        *models: Path of a URDF or an MJCF, or of both, in any order; a name in MuJoCo Menagerie or
            ``robot_descriptions``; ``package://NAME/FILE``; or a robot in memory: XML text,
            ``mujoco.MjSpec``, ``mujoco.MjModel``, ``yourdfpy.URDF``, ``pin.RobotWrapper``, or
            ``pin.Model`` with or without a ``pin.GeometryModel`` of collision shapes. Objects are
            not modified. ``pa.load_robot`` also accepts the name of a variant, such as ``"v3"``.
        urdf: Path of the URDF.
        mjcf: Path of the MJCF.
        take: ``"urdf"`` or ``"mjcf"``: use only the file of this format, and ignore the other file.
        body: Root body or any other body of the robot, for an MJCF with several robots.
        feet: Frames of the feet, or {foot: frame}. A frame is a link of the URDF; a geom, site or
            body of the MJCF; or a pair of both. By default feet are detected: the collision geoms
            at the ends of the lowest limbs. An empty list means no feet.
        fixed_base: Fix the base in the world, at the pose in the MJCF.
        name: Name of the robot; by default the name in the MJCF.
        joints: {joint in the URDF: joint in the MJCF}, for joints that are not matched by name.
        keyframe: Keyframe of the MJCF to start from; by default ``home``, or another in which the
            robot stands.
        packages: {ROS package: folder}, for ``package://`` paths of the URDF and ``$(find)`` of a
            xacro file.
        xacro: True to expand xacro files by the package ``xacro``, which evaluates the Python
            expressions in the files: only for files that you trust. Without it, a xacro file is
            read if all its xacro elements are unused declarations.
        xacro_args: {argument of the xacro file: value}, with ``xacro=True``; other arguments have
            default values.
        as_is: True to add no servos, motors and contact exclusions, and to keep the contacts of all
            shapes. Soles are then not replaced by balls.
        visuals: Whether the robot has visual geoms. Use False if the robot is not drawn or written:
            the MuJoCo model is then smaller, and is made faster. Without effect if ``feet`` is
            given.

    Returns:
        Robot; ``robot.description.converted`` is the format of a converted model.

    Raises:
        ConfigurationError: If an argument is invalid: for example, of the wrong type, no file, two
            files of the same format, or a foot that is named twice.
        ModelError: If no robot can be made of the files. Examples: a file cannot be read, both
            files have no joint in common, no feet are found, or a joint has several motors.
        UnknownNameError: If a foot, joint, keyframe or body does not exist; the message lists valid
            names.
    """
    pair = read_pair(
        *models,
        urdf=urdf,
        mjcf=mjcf,
        take=take,
        body=body,
        packages=packages,
        xacro=xacro,
        xacro_args=xacro_args,
        defer_visuals=feet is None,  # a named foot may be a visual geom
    )
    return make_robot(
        pair.urdf,
        pair.mjcf,
        feet=feet,
        fixed_base=fixed_base,
        name=name,
        joints=joints,
        keyframe=keyframe,
        as_is=as_is,
        visuals=visuals,
        finish=lambda robot: pair.add_source(robot, keyframe),
    )


@silence_mujoco()
def load_mjcf_robot(file: MjcfFile) -> Robot:
    """Load a robot from an MJCF that was already read, as `load_robot` does with ``visuals=False``.

    Raises:
        ModelError: If no robot can be made of the file, for example if it has several robots.
    """
    file.check_compiled()
    pair = ModelPair.from_file(with_one_robot(file, None))
    return make_robot(
        pair.urdf,
        pair.mjcf,
        visuals=False,
        finish=pair.add_source,
    )
