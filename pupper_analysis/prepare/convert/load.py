"""Loads a robot from its URDF, from its MJCF, or from both.

Where there is one file, the other model is made of it in memory.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from pupper_analysis.base.arguments import check_arguments, check_type
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError, ModelError
from pupper_analysis.models.conversion import UrdfImport
from pupper_analysis.models.loading import read_model
from pupper_analysis.models.mjcf import silence_mujoco
from pupper_analysis.models.mjcf_file import MjcfFile, read_mjcf
from pupper_analysis.models.published import find_file
from pupper_analysis.models.urdf_file import UrdfFile, read_urdf, urdf_from
from pupper_analysis.models.xml import parse_text
from pupper_analysis.prepare.convert.from_urdf import convert_urdf_in_memory
from pupper_analysis.prepare.convert.to_urdf import ConvertedUrdf, with_one_robot
from pupper_analysis.prepare.passes import Feet, make_robot
from pupper_analysis.robot.robot import PublishedFile, Robot

_OF_A_URDF = ("armature-from-mjcf", "effort-unstated", "fixed-base-stands", "root-link-left-out")
"""What is told of a URDF beside an MJCF, and is no news of one that was made of it."""


@dataclass(frozen=True, eq=False)
class ModelPair:
    """Both models of a robot.

    Attributes:
        urdf: The URDF.
        mjcf: The MJCF.
        converted: ``"urdf"`` or ``"mjcf"``: which of them was made of the other one; empty if each
            has a file.
        imported: A URDF that is alone, for MuJoCo's own importer.
    """

    urdf: UrdfFile
    mjcf: MjcfFile
    converted: str = ""
    imported: UrdfImport | None = None

    @staticmethod
    def of(file: UrdfFile | MjcfFile) -> ModelPair:
        """Makes the other model of a file, in memory.

        Raises:
            ModelError: If the other format cannot have the robot.
        """
        if isinstance(file, UrdfFile):
            urdf, mjcf, imported = convert_urdf_in_memory(file)
            return ModelPair(urdf, mjcf, "mjcf", imported)
        return ModelPair(_bare_urdf(file), file, "urdf")

    def mark(self, robot: Robot) -> Robot:
        """Returns the robot of these models, which knows which of them was made."""
        if not self.converted:
            return robot
        description = replace(robot.description, converted=self.converted)
        source = self.urdf if self.converted == "mjcf" else self.mjcf
        made = self.converted.upper()
        message = diagnose("one-model-converted", made=made, file=source.path.name)
        known = _OF_A_URDF if self.converted == "urdf" else ()
        own = [note for note in robot.notes if note.code not in known]
        return replace(robot, description=description, notes=(message, *own))


def _bare_urdf(file: MjcfFile) -> UrdfFile:
    """Makes the URDF of an MJCF in memory; its ball joints are fixed, as beside a hand-made one.

    Raises:
        ModelError: If a URDF cannot have the robot.
    """
    text = ConvertedUrdf.of(file, file.path, fix_balls=True).text
    made = urdf_from(file.path, text, parse_text(text), None)
    if all(joint.is_fixed for joint in made.tree.joints.values()):
        raise ModelError(file.path, diagnose("no-joints"))
    return made


def read_pair(
    *models: str | Path,
    urdf: str | Path | None = None,
    mjcf: str | Path | None = None,
    take: str | None = None,
    body: str | None = None,
    packages: Mapping[str, str | Path] | None = None,
) -> ModelPair:
    """Reads a robot's files, and makes the model that has none.

    Args:
        *models: A URDF, an MJCF, or one of each, in any order.
        urdf: Path of the URDF.
        mjcf: Path of the MJCF.
        take: ``"urdf"`` or ``"mjcf"``: of two files, go on with this one alone.
        body: The robot's root in an MJCF of several; where there is no URDF, it is found if it can
            be.
        packages: {ROS package: its folder}, for ``package://`` paths of the URDF.

    Raises:
        ConfigurationError: If there is no file, or two of one format.
        ModelError: If a file cannot be read, or the other format cannot have the robot.
    """
    folders = {name: Path(folder) for name, folder in (packages or {}).items()}
    for model in models:
        check_type("model", model, str | Path)
    files = [read_model(model, folders) for model in models]
    for path, kind, read in ((urdf, UrdfFile, read_urdf), (mjcf, MjcfFile, read_mjcf)):
        if path is not None:
            files.append(read_model(path, folders))
            if not isinstance(files[-1], kind):
                read(find_file(path))  # refuses it, and says what it is
    found = {"urdf" if isinstance(file, UrdfFile) else "mjcf": file for file in files}
    if not files or len(found) < len(files):
        paths = [str(file.path) for file in files]
        raise ConfigurationError("model", diagnose("not-one-robots-files", files=paths))
    if take is not None and take not in found:
        raise ConfigurationError("take", diagnose("take-what-is-not-there", take=take))
    if take is not None:
        found = {take: found[take]}
    one, other = found.get("urdf"), found.get("mjcf")
    if body is not None and not isinstance(other, MjcfFile):
        raise ConfigurationError("body", diagnose("body-of-an-mjcf"))
    if isinstance(other, MjcfFile):
        other.check_compiled()
        if one is None or body is not None:
            other = with_one_robot(other, body)
    if isinstance(one, UrdfFile) and isinstance(other, MjcfFile):
        return ModelPair(one, other)
    return ModelPair.of(other or next(iter(found.values())))


@check_arguments
@silence_mujoco()
def load_robot(
    *models: str | Path,
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
    as_is: bool = False,
) -> Robot:
    """Loads a robot from its URDF, its MJCF or both, as they were published.

    What the files lack is made up for in memory, and each such thing is said in ``notes``: the
    model of which there is no file is made of the other one, joints whose names differ are matched,
    those that only one file has are held at zero, a floor, a free base and position servos are
    added, and where the MJCF has no keyframe in which the robot stands, a stand is looked for.

    Args:
        *models: Path of a URDF or an MJCF, or of both, in any order. ``pa.load_robot`` also accepts
            the name of a variant, such as ``"v3"``.
        urdf: Path of the URDF.
        mjcf: Path of the MJCF.
        take: ``"urdf"`` or ``"mjcf"``: of two files, go on with this one alone.
        body: The robot's root in an MJCF of several robots, or any body of it.
        feet: The feet's frames, or {foot: its frame}; a frame is a link of the URDF, or a geom,
            site or body of the MJCF, or a pair of both. By default the feet are the collision geoms
            at the ends of the limbs that are lowest in the start pose; an empty list: no feet.
        fixed_base: Fix the base in the world, at the pose that the MJCF gives it.
        name: The robot's name; by default the MJCF's.
        joints: {joint in the URDF: joint in the MJCF}, of those that are not matched by name.
        keyframe: The MJCF's keyframe to start from; by default ``home``, or another in which the
            robot stands.
        packages: {ROS package: its folder}, for ``package://`` paths of the URDF.
        as_is: Add no servos, and alter no shapes: what the file has is to hold the robot.

    Returns:
        The robot; ``robot.description.converted`` tells which model was made of the other one.

    Raises:
        ConfigurationError: If an argument is of another kind, or no file is given.
        ModelError: If a file cannot be read, the two have no joints in common, or no feet are
            found.
        UnknownNameError: If a foot, joint or keyframe is not there; the message lists what is.
    """
    pair = read_pair(*models, urdf=urdf, mjcf=mjcf, take=take, body=body, packages=packages)
    robot = make_robot(
        pair.urdf,
        pair.mjcf,
        feet=feet,
        fixed_base=fixed_base,
        name=name,
        joints=joints,
        keyframe=keyframe,
        as_is=as_is,
    )
    file = None if pair.converted == "mjcf" else pair.mjcf
    published = PublishedFile(file, keyframe, pair.imported)
    return pair.mark(replace(robot, published=published))
