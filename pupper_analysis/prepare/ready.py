"""Are two files ready: do they make the robot that is asked for as they are?"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import mujoco

from pupper_analysis.base.errors import ModelError
from pupper_analysis.models.description import Description
from pupper_analysis.models.mjcf import JointKind
from pupper_analysis.models.mjcf_file import MjcfFile
from pupper_analysis.models.urdf_file import UrdfFile
from pupper_analysis.prepare import notes
from pupper_analysis.prepare.base import free_of_friction
from pupper_analysis.prepare.motors import joints_of_several_motors
from pupper_analysis.prepare.solver import solver_error
from pupper_analysis.prepare.start import first_stand
from pupper_analysis.robot.build import build_robot
from pupper_analysis.robot.floor import level_ground
from pupper_analysis.robot.matching.urdf import urdf_mimics
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import own_servos

_FEWEST = 3  # contact points on which a robot stands


@dataclass(frozen=True, eq=False)
class Request:
    """What is asked for when a robot is loaded.

    Attributes:
        feet: {foot: its frames in URDF and MJCF}; None: they are looked for.
        fixed_base: Whether the base is fixed in the world.
        name: The robot's name; None: the MJCF's.
        joints: {joint in the URDF: joint in the MJCF}.
        keyframe: The MJCF's keyframe to start from; None: the first in which the robot stands.
        as_is: Whether no servos are added, and no shapes altered.
    """

    feet: Mapping[str, tuple[str, str]] | None = None
    fixed_base: bool = False
    name: str | None = None
    joints: Mapping[str, str] | None = None
    keyframe: str | None = None
    as_is: bool = False


def ready_robot(urdf: UrdfFile, mjcf: MjcfFile, request: Request) -> Robot | None:
    """Builds the robot of two files as they are; None if something is to be made up for.

    They are ready where feet are named, whose frames both have, and joints alike; where nothing
    else lies in the scene, and the ground is level or missing. A robot without feet, whose base is
    held, is ready only if it is to be taken as it is: it may lack servos, or overlap.

    Raises:
        ModelError: If they are ready, and make no robot all the same.
    """
    if request.feet is None or request.joints or request.keyframe is not None:
        return None
    if not _same_joints(urdf, mjcf.spec) or not _known(urdf, mjcf.spec, request):
        return None
    if not request.fixed_base and not _may_stand(urdf, mjcf.spec):
        return None
    robot = _built(urdf, mjcf, request)
    if robot is None or (robot.floating and _needs_more(robot)):
        return None
    if robot.floating and not request.as_is and not _may_be_commanded_to_stand(robot):
        return None
    if not (robot.floating or request.feet or request.as_is):
        return None
    said = (*notes.bound_joints(robot), *notes.tell_uncommanded(robot))
    return replace(robot, notes=(*urdf.notes, *mjcf.notes, *said, *robot.notes))


def _same_joints(urdf: UrdfFile, spec: mujoco.MjSpec) -> bool:
    """Tells whether both have joints of the same names, of one robot alone."""
    tree = urdf.tree
    moving = {
        joint.name for joint in tree.joints.values() if joint.kind not in ("fixed", "floating")
    }
    free = [joint for joint in spec.joints if joint.type == JointKind.FREE]
    hinges = {joint.name for joint in spec.joints if joint.type != JointKind.FREE}
    return moving == hinges and len(free) <= 1


def _known(urdf: UrdfFile, spec: mujoco.MjSpec, request: Request) -> bool:
    """Tells whether both have the frames of the feet that are named."""
    places = {element.name for element in (*spec.sites, *spec.bodies, *spec.geoms)}
    named = (request.feet or {}).values()
    return all(one in urdf.tree.links and other in places for one, other in named)


def _may_stand(urdf: UrdfFile, spec: mujoco.MjSpec) -> bool:
    """Tells whether nothing is to be done to the ground, and no joint follows in the URDF alone.

    A ground that is missing is no reason; one that is not level at z = 0, or has more on it, is.
    So is a base that hangs by its free joint's friction.
    """
    if urdf_mimics(urdf.root):
        return False
    if not any(joint.type == JointKind.FREE for joint in spec.joints):
        return True
    mine = spec.copy()
    changed = [*level_ground(mine), *free_of_friction(mine)]
    return all(change.code == "ground-added" for change in changed)


def _built(urdf: UrdfFile, mjcf: MjcfFile, request: Request) -> Robot | None:
    """Builds the robot; None if a foot is named for a body whose sole is no sphere around it."""
    feet = request.feet or {}
    description = Description(
        name=request.name or mjcf.spec.modelname,
        urdf=urdf.text,
        urdf_source=urdf.path,
        mjcf=mjcf.spec,
        mjcf_source=mjcf.path,
        contact_points=feet,
    )
    try:
        return build_robot(description, fixed_base=request.fixed_base)
    except ModelError:
        bodies = {body.name for body in mjcf.spec.bodies}
        if request.fixed_base or not all(other in bodies for _, other in feet.values()):
            raise
        return None


def _may_be_commanded_to_stand(robot: Robot) -> bool:
    """Tells whether there are servos, and a stand at the height that the keyframe gives it.

    What stands at no height, on two points, needs none.
    """
    if len(robot.contact_points) < _FEWEST:
        return True
    return set(robot.joint_names) <= own_servos(robot).keys() and first_stand(robot) is not None


def _needs_more(robot: Robot) -> bool:
    """Tells whether joints lack limits, have several motors, or are not solved for exactly."""
    endless = robot.closure is not None and bool(robot.pin_convention.unbounded.any())
    return (
        endless or bool(joints_of_several_motors(robot.mj_model)) or solver_error(robot) is not None
    )
