"""Where the joints of a standing robot are that carry no foot: its arms, its head."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import replace
from fnmatch import fnmatchcase

import numpy as np

from pupper_analysis.arguments import check_arguments, check_finite
from pupper_analysis.diagnostics import Quantity, diagnose
from pupper_analysis.errors import ConfigurationError, UnknownNameError
from pupper_analysis.models.joint_kinds import JointKind
from pupper_analysis.robot.build import rebuild_robot
from pupper_analysis.robot.robot import Robot

_ROUNDED = 1e-6
"""A position that is further beyond a limit is out of range (rad, m): both are typed."""


@check_arguments
def with_posture(robot: Robot, joints: Mapping[str, float]) -> Robot:
    """Returns a robot whose joints that carry no foot are elsewhere in its home and its stands.

    A search for a stand begins there, and leaves them there to some milliradians.

    Args:
        robot: The robot.
        joints: {joint, or a pattern such as ``*elbow*``: its position (rad, m)}; of patterns that
            match the same joint the last counts.

    Raises:
        UnknownNameError: If there is no such joint; the message lists those that are.
        ConfigurationError: If a joint carries a foot or is part of a loop, or the position is out
            of its range.
    """
    given = named_positions(robot, joints)
    if not given:
        return robot
    model = robot.structure.model
    bound = {
        model.names[one]
        for foot in robot.structure.parents.values()
        for one in list(model.supports[foot])
    }
    if robot.closure is not None:
        both = (*robot.closure.following.tolist(), *robot.closure.leading.tolist())
        bound |= {robot.joint_names[joint] for joint in both}
    nominal = dict(robot.description.nominal)
    spec, mj_model = robot.description.mjcf.copy(), robot.mj_model
    key = next((one for one in spec.keys if one.name == "home"), None) or next(
        iter(spec.keys), None
    )
    qpos = np.array(mj_model.qpos0 if key is None else key.qpos)
    for name, position in given.items():
        if name in bound:
            raise ConfigurationError("posture", diagnose("joint-is-the-stands", joint=name))
        index = robot.joint_names.index(name)
        ends = float(robot.lower_limits[index]), float(robot.upper_limits[index])
        check_in_range(robot, name, position, ends, "posture")
        qpos[mj_model.jnt_qposadr[mj_model.joint(name).id]] = nominal[name] = position
    if key is None:
        spec.add_key(name="home", qpos=qpos)
    else:
        key.qpos = qpos
    built = rebuild_robot(robot, mjcf=spec, nominal=nominal)
    digest = hashlib.sha256(np.round(qpos, 9).tobytes()).hexdigest()[:8]
    return replace(
        built,
        published_model=robot.published_model,
        fingerprint=f"{robot.fingerprint} {digest}",
    )


def named_positions(robot: Robot, joints: Mapping[str, float]) -> dict[str, float]:
    """Returns {joint: its position} of {joint, or a pattern: position}.

    Raises:
        UnknownNameError: If a pattern matches no joint.
        ConfigurationError: If a position is no finite number.
    """
    given: dict[str, float] = {}
    for pattern, value in joints.items():
        chosen = [joint for joint in robot.joint_names if fnmatchcase(joint, pattern)]
        if not chosen:
            raise UnknownNameError(robot.name, "joint", pattern, robot.joint_names).at("joints")
        given |= dict.fromkeys(chosen, check_finite(f"joints {pattern!r}", value))
    return given


def check_in_range(
    robot: Robot, joint: str, position: float, ends: tuple[float, float], argument: str
) -> None:
    """Checks that a joint's position is within its range.

    Raises:
        ConfigurationError: If it is not.
    """
    low, high = ends
    if not low - _ROUNDED <= position <= high + _ROUNDED:
        unit = joint_unit(robot, joint)
        problem = diagnose(
            "joint-out-of-range",
            subject=("joint", joint),
            position=Quantity(position, unit),
            low=Quantity(low, unit),
            high=Quantity(high, unit),
        )
        raise ConfigurationError(argument, problem)


def joint_unit(robot: Robot, joint: str) -> str:
    """Returns the unit of a joint's position: rad, or m of one that slides."""
    model = robot.mj_model
    return "m" if model.jnt_type[model.joint(joint).id] == JointKind.SLIDE else "rad"
