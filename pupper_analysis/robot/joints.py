"""What each joint of a robot does, and how long its legs are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.base.results import Result
from pupper_analysis.models.efforts import EffortStatement
from pupper_analysis.models.joint_kinds import JointKind
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot

Array = NDArray[np.float64]


_OBLIQUE = ("oblique", "oblique slide")
"""What a joint does whose axis is along none of the base's: turns, or slides."""


@dataclass(frozen=True, eq=False)
class JointSummary(Result):
    """What a joint does, and what it can.

    Attributes:
        name: Its name, in both files.
        motion: ``roll``, ``pitch`` or ``yaw``, as far as the axis is within 1 degree of x, y or z
            of the base at zero angles; otherwise ``oblique``. Of a joint that slides ``along x``,
            ``along y`` or ``along z``; otherwise ``oblique slide``.
        axis: (3,) its axis in the base frame at zero angles.
        lower: rad (here and below, of a joint that slides: m for rad, N for N m, kg for kg m^2).
        upper: rad.
        effort: What its motor can give either way, the least that both files state (N m).
        velocity: rad/s.
        armature: Of the MJCF (kg m^2).
        damping: N m s/rad.
        friction: N m.
        effort_origin: Which statement of which file ``effort`` is; None without a limit.
    """

    name: str
    motion: str
    axis: Array
    lower: float
    upper: float
    effort: float
    velocity: float
    armature: float
    damping: float
    friction: float
    effort_origin: EffortStatement | None

    @property
    def oblique(self) -> bool:
        """Whether its axis is along none of the base's."""
        return self.motion in _OBLIQUE


def joint_summaries(robot: Robot) -> tuple[JointSummary, ...]:
    """Tells of each joint what it does and what it can, in actuator order."""
    rest = Configuration(robot, robot.neutral())
    model, v = robot.pin_model, robot.pin_convention.v_index
    summaries = []
    for index, name in enumerate(robot.joint_names):
        axis = rest.joint_axis(name)
        summaries.append(
            JointSummary(
                name=name,
                motion=_motion(axis, is_slide=is_slide(robot, name)),
                axis=axis,
                lower=float(robot.lower_limits[index]),
                upper=float(robot.upper_limits[index]),
                effort=float(robot.effort_limits[index]),
                velocity=float(robot.velocity_limits[index]),
                armature=float(model.armature[v[index]]),
                damping=float(model.damping[v[index]]),
                friction=float(model.friction[v[index]]),
                effort_origin=robot.efforts[index].origin,
            )
        )
    return tuple(summaries)


def is_slide(robot: Robot, joint: str) -> bool:
    """Tells whether a joint slides."""
    kind = robot.mj_model.jnt_type[robot.mj_model.joint(joint).id]
    return bool(kind == JointKind.SLIDE)


def _motion(axis: Array, *, is_slide: bool) -> str:
    """Returns the word for what a joint does; see ``JointSummary``."""
    direction = int(np.argmax(np.abs(axis)))
    aligned = abs(axis[direction]) > np.cos(np.radians(1.0))
    if is_slide:
        return f"along {'xyz'[direction]}" if aligned else _OBLIQUE[1]
    return ("roll", "pitch", "yaw")[direction] if aligned else _OBLIQUE[0]


def leg_joints(robot: Robot, foot: str) -> tuple[str, ...]:
    """Returns the joints that move a foot against the base, from the base outwards.

    Raises:
        UnknownNameError: If the foot is unknown.
    """
    model = robot.pin_model
    frame = model.frames[
        model.getFrameId(robot.contact_frames[robot.check_foot(foot)], pin.FrameType.BODY)
    ]
    support = [model.names[joint] for joint in model.supports[frame.parentJoint]]
    return tuple(name for name in support if name in robot.joint_names)


def leg_lengths(robot: Robot) -> tuple[float | None, float | None]:
    """Returns the lengths of the first leg's thigh and calf (m); None for one that it lacks.

    The thigh reaches from the last joint but one to the knee; the calf from the knee to the foot,
    in the plane of the leg (without the foot's sideways offset along the knee's axis). The knee is
    the leg's last joint; a leg of one joint has no thigh.
    """
    foot = robot.contact_points[0]
    rest = Configuration(robot, robot.neutral())
    joints = leg_joints(robot, foot)
    if not joints:
        return None, None
    knee = joints[-1]
    calf = rest.foot_positions()[foot] - rest.joint_position(knee)
    axis = rest.joint_axis(knee)
    calf_length = float(np.linalg.norm(calf - (calf @ axis) * axis))
    if len(joints) == 1:
        return None, calf_length
    thigh = rest.joint_position(knee) - rest.joint_position(joints[-2])
    return float(np.linalg.norm(thigh)), calf_length
