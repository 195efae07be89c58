"""A robot whose motors can give what is asked about, in place of what its files state."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.diagnostics import Quantity, diagnose
from pupper_analysis.base.errors import ConfigurationError, UnknownNameError
from pupper_analysis.models.attributes import BY_KIND
from pupper_analysis.models.efforts import EffortLimit, EffortStatement
from pupper_analysis.models.xml import to_text
from pupper_analysis.robot.build import rebuild_robot
from pupper_analysis.robot.robot import Robot


@check_arguments
def with_efforts(robot: Robot, efforts: Mapping[str, float]) -> Robot:
    """Returns the robot with other limits of its motors, said in its notes.

    For files with placeholders. They bound what is computed and what is simulated of the robot; its
    file as it was published is simulated with its own.

    Args:
        robot: The robot.
        efforts: {joint: what its motor can give either way, at the joint (N m; N of a slide)}.

    Returns:
        The robot; itself, if nothing is asked.

    Raises:
        UnknownNameError: If it has no such joint.
        ConfigurationError: If one is not positive and finite.
    """
    for name, effort in efforts.items():
        if name not in robot.joint_names:
            raise UnknownNameError(robot.name, "joint", name, robot.joint_names)
        if isinstance(effort, bool) or not 0 < effort < math.inf:
            problem = diagnose("effort-not-valid", joint=name, effort=effort)
            raise ConfigurationError("effort", problem)
    if not efforts:
        return robot
    urdf, mjcf = robot.description.trees()
    stated, told = dict(robot.description.efforts), []
    before = {limit.joint: limit for limit in robot.efforts}
    for name, effort in efforts.items():
        urdf.joints[name].state(BY_KIND["effort"], effort)
        mjcf.limit_effort(name, effort)
        range_ = (-effort, effort)
        origin = EffortStatement.of("", "joint", name, "effort", range_)
        stated[name] = EffortLimit(name, *range_, origin, (origin,))
        own = before[name].least
        told.append(
            diagnose(
                "effort-in-place-of",
                subject=("joint", name),
                effort=Quantity(effort, "N m"),
                own=Quantity(own, "N m") if own < math.inf else None,
            )
        )
    built = rebuild_robot(robot, urdf=to_text(urdf.root), mjcf=mjcf.spec, efforts=stated)
    return replace(built, notes=(*robot.notes, diagnose("efforts-as-asked", joints=told)))
