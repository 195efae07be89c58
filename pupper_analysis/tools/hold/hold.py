"""What a posture of a robot whose base is held costs, and whether it holds."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.diagnostics import Diagnostic
from pupper_analysis.base.errors import NoEquilibriumError
from pupper_analysis.base.results import Tabular
from pupper_analysis.models.efforts import EffortStatement
from pupper_analysis.models.joint_kinds import has_free_joint
from pupper_analysis.prepare.judge import judge_held
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.payload import with_payload
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.tool import Tool, find_tool
from pupper_analysis.simulation.verdict import Verdict
from pupper_analysis.stance.posture import Posture, find_posture, joint_units
from pupper_analysis.statics.equilibrium import GravityCompensation, gravity_compensation
from pupper_analysis.tools.hold.force import ToolForce, tool_force
from pupper_analysis.tools.hold.payload import ToolPayload, tool_payload
from pupper_analysis.tools.hold.reach import ReachLoad, reach_load
from pupper_analysis.tools.hold.sag import SaggedPosture, sag_posture
from pupper_analysis.tools.hold.verify import PostureVerification, verify_posture
from pupper_analysis.tools.hold.worst import WorstPostures, worst_postures

Array = NDArray[np.float64]

TRIED = 0.95
"""Part of the payload that is simulated, the lesser of what motors and servos hold: at the
limit rounding decides whether it holds."""


@dataclass(frozen=True, eq=False)
class Hold(Tabular):
    """A posture of a robot whose base is held, what it costs, and whether it holds.

    Attributes:
        name: The robot's name.
        hangs: Whether its base, which is held, is free in the MJCF; the ground touches nothing.
        posture: Where it is told to be.
        units: (nu,) of the joints' positions: rad, or m of one that slides; of its motor, N for
            N m.
        tool: Where it carries, and is pushed.
        tool_position: (3,) in the world (m).
        limits: (nu,) of the motors' torques, the least that both files state (N m).
        limit_origins: (nu,) which statement of which file each is; None without a limit.
        statics: What the motors hold.
        verification: The simulation, with feed-forward.
        sagging: The simulation without.
        sagged: Where servos let it come to rest without; None where that is not predicted.
        unsettled: Why ``sagged`` is None; None where it is not.
        verdict: Whether it holds, and what that rests on.
        worst: The worst posture of each motor.
        carried: Mass at the tool, which all is of (kg).
        payload: What the motors hold at the tool besides.
        payload_trial: The simulation, with feed-forward, of ``TRIED`` of it in the posture; None
            where nothing is carried, or nothing limits it.
        force: How hard the tool can be pushed.
        reach: What the motors hold over the tool's reach.
    """

    name: str
    hangs: bool
    posture: Posture
    units: tuple[str, ...]
    tool: Tool
    tool_position: Array
    limits: Array
    limit_origins: tuple[EffortStatement | None, ...]
    statics: GravityCompensation
    verification: PostureVerification
    sagging: PostureVerification
    sagged: SaggedPosture | None
    unsettled: Diagnostic | None
    verdict: Verdict
    worst: WorstPostures
    carried: float
    payload: ToolPayload
    payload_trial: PostureVerification | None
    force: ToolForce
    reach: ReachLoad

    @property
    def passed(self) -> bool:
        """Whether it holds, by its verdict."""
        return self.verdict.passed

    def _columns(self) -> dict[str, ArrayLike]:
        return {
            "joint": self.statics.joint_names,
            "position": self.posture.qpos,
            "torque": self.statics.joint_torques,
            "utilisation": self.statics.motor_utilisation,
        }


@check_arguments
def hold_posture(
    robot: Robot,
    joints: Mapping[str, float] | None = None,
    *,
    keyframe: str | None = None,
    tool: str | None = None,
    payload: float = 0.0,
    kp: ArrayLike | None = None,
    kd: ArrayLike | None = None,
) -> Hold:
    """Finds out what a posture of a robot whose base is held costs, and whether it holds.

    Args:
        robot: A robot whose base is held: an arm, a hand, or one that is loaded with
            ``fixed_base=True``.
        joints: {joint, or a pattern such as ``*elbow*``: its position (rad, m)}.
        keyframe: The MJCF's keyframe for the other joints; by default ``home`` or the first if
            there is one, else they are in the middle of their ranges.
        tool: A link of the URDF, or a site, body or geom of the MJCF; by default the end of the
            longest chain of joints.
        payload: Mass at the tool (kg), which all that follows is of.
        kp: Servo stiffness (N m/rad), one or (nu,); the model's own by default.
        kd: Servo damping (N m s/rad), one or (nu,); the model's own by default.

    Raises:
        ConfigurationError: If the base is free, or an argument makes no sense for the robot.
        UnknownNameError: If a joint, the keyframe or the tool is not there.
        ModelError: If the robot has no position servos, and kp and kd are not both given.
    """
    posture, point = find_posture(robot, joints, keyframe=keyframe), find_tool(robot, tool)
    robot = with_payload(robot, payload, point)
    config = Configuration(robot, posture.qpos)
    statics = gravity_compensation(config, contacts=[])
    sagged, unsettled = None, None
    try:
        sagged = sag_posture(robot, posture, point, kp=kp)
    except NoEquilibriumError as error:
        unsettled = error.diagnostic
    fed = verify_posture(robot, posture, point, kp=kp, kd=kd)
    alone = verify_posture(robot, posture, point, sagged=sagged, feedforward=False, kp=kp, kd=kd)
    worst = worst_postures(robot, posture, point)
    more = tool_payload(robot, posture, point, worst, kp=kp)
    trial = None
    most = min(more.mass, more.servos)
    if 0 < most < math.inf:
        loaded = with_payload(robot, TRIED * most, point)
        trial = verify_posture(loaded, posture, find_tool(loaded, point.name), kp=kp, kd=kd)
    return Hold(
        name=robot.name,
        hangs=has_free_joint(robot.description.mjcf),
        posture=posture,
        units=joint_units(robot),
        tool=point,
        tool_position=point.position(config),
        limits=robot.effort_limits,
        limit_origins=tuple(limit.origin for limit in robot.efforts),
        statics=statics,
        verification=fed,
        sagging=alone,
        sagged=sagged,
        unsettled=unsettled,
        verdict=judge_held(robot, posture, fed, alone, statics, kp=kp, kd=kd),
        worst=worst,
        payload=more,
        carried=float(payload),
        payload_trial=trial,
        force=tool_force(robot, posture, point),
        reach=reach_load(robot, posture, point),
    )
