"""The worst posture of each motor: searched for, from several postures, joint by joint."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.results import Tabular
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.tool import Tool
from pupper_analysis.stance.posture import Posture, check_held, joint_ranges
from pupper_analysis.tools.hold.looks import Looks
from pupper_analysis.tools.hold.search import Search
from pupper_analysis.tools.hold.ways import Ways

Array = NDArray[np.float64]

_STARTS = 12
"""Random postures that a search begins from, besides the one that is asked about."""

_POOL = 500
"""Random postures of a robot whose loops bend: searches also begin from the worst of them, as loops
of several joints, not all of whose positions close, have many that are worst near themselves."""

_WORST = 3
"""How many of these."""

_CHECKED = 8
"""Random postures in which what is looked at is compared with what a configuration holds."""

_NOTHING = 1e-14
"""N m per N of weight: what joints about vertical axes hold is rounding."""


@dataclass(frozen=True, eq=False)
class WorstPostures(Tabular):
    """The posture in which gravity asks most of each motor.

    Attributes:
        joint_names: In actuator order.
        joint_torques: (nu,) the greatest found, with its sign (N m, N).
        postures: (nu, nu) where; a row for each motor (rad, m).
        limits: (nu,) of the motors (N m, N).
        utilisation: (nu,) the greatest found / limit.
        endless: Why there may be no greatest torque; None if there is.
    """

    joint_names: tuple[str, ...]
    joint_torques: Array
    postures: Array
    limits: Array
    utilisation: Array
    endless: Diagnostic | None

    def _columns(self) -> dict[str, ArrayLike]:
        return {
            "joint": self.joint_names,
            "torque": self.joint_torques,
            "utilisation": self.utilisation,
        }


@check_arguments
def worst_postures(
    robot: Robot,
    posture: Posture,
    tool: Tool,
    *,
    payload: float = 0.0,
    near: WorstPostures | None = None,
    bearing: NDArray[np.bool_] | None = None,
) -> WorstPostures:
    """Finds for each motor the posture in which gravity, and springs of joints, ask most of it.

    A torque is a + b cos q + c sin q of each joint's angle q with the others where they are
    (a + b q of a slide; a spring at the joint adds k q), so that three looks give its greatest
    along a joint in closed form. A search goes from joint to joint until that gains nothing, from
    random postures until several end alike. That is no proof, but of Panda, UR5,
    UR10 and Jaco what it finds is within 0.2 % of an upper bound (support functions along the
    tree), wherever a joint holds more than 0.05 N m.

    Args:
        robot: A robot whose base is held.
        posture: Where joints are that do not matter.
        tool: Where the payload is.
        payload: A mass at the tool (kg).
        near: The worst postures for another payload: searches begin there.
        bearing: (nu,) which motors bear the payload, if that is known: all else is as ``near``.

    Raises:
        ConfigurationError: If the base is free.
    """
    check_held(robot)
    ways = Ways(robot, posture)
    starts = ways.random(max(_STARTS, _CHECKED))
    looks = Looks(robot, starts[:_CHECKED])
    asked = np.ones(robot.nu, dtype=bool) if near is None or bearing is None else bearing
    search = Search(robot, ways, looks.with_mass(tool, payload) if payload else looks)
    torques, postures = np.zeros(robot.nu), np.tile(posture.qpos, (robot.nu, 1))
    if near is not None:
        torques[~asked], postures[~asked] = near.joint_torques[~asked], near.postures[~asked]
    pool = ways.random(_POOL) if ways.bent.any() and near is None else []
    sampled = np.array([search.torques(qpos) for qpos in pool])
    for joint in np.flatnonzero(asked).tolist():
        begin = [posture.qpos, *starts[:_STARTS]]
        if near is not None:
            begin.insert(0, near.postures[joint])
        for sign in (1.0, -1.0):
            most = np.argsort(-sign * sampled[:, joint])[:_WORST] if pool else ()
            found, at = search.highest(
                joint, sign, [*begin[:1], *(pool[one] for one in most), *begin[1:]]
            )
            if found > abs(torques[joint]):
                torques[joint], postures[joint] = sign * found, at
    torques[np.abs(torques) <= _NOTHING * robot.total_mass * np.linalg.norm(robot.gravity)] = 0.0
    most, limits = np.abs(torques), robot.effort_limits
    with np.errstate(divide="ignore", invalid="ignore"):
        used = np.where(most > 0, most / limits, 0.0)
    return WorstPostures(
        joint_names=robot.joint_names,
        joint_torques=torques,
        postures=postures,
        limits=limits,
        utilisation=used,
        endless=_endless(robot, ways, looks),
    )


def _endless(robot: Robot, ways: Ways, looks: Looks) -> Diagnostic | None:
    """Returns why a torque may have no greatest: a slide, or a spring, goes on without end."""
    if ways.endless:
        return diagnose("slide-not-limited")
    free = ~np.isfinite(joint_ranges(robot)).all(axis=1)
    return diagnose("springs-turn-freely") if (free & (looks.stiffness != 0)).any() else None
