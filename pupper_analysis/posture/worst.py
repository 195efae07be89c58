"""The worst posture of each motor: searched for, and bounded from above for all."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.arguments import check_arguments
from pupper_analysis.diagnostics import Diagnostic, diagnose
from pupper_analysis.posture.gravity_tree import GravityTree, tree_torques
from pupper_analysis.posture.looks import ROUNDING, Looks
from pupper_analysis.posture.posture import Posture, check_held, joint_ranges
from pupper_analysis.posture.search import Search
from pupper_analysis.posture.ways import Ways
from pupper_analysis.results import Tabular
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.tool import Tool

Array = NDArray[np.float64]

_STARTS = 12
"""Random postures that a search begins from, besides the one that is asked about."""

_POOL = 500
"""Random postures of a robot whose loops bend: searches also begin from the worst of them, as loops
of several joints, not all of whose positions close, have many that are worst near themselves."""

_WORST = 3
"""How many of these."""

_CHECKED = 8
"""Random postures in which gravity on the tree is compared with what motors and springs hold."""

_NO_SHARE = 1e-12

_NOTHING = 1e-14
"""N m per N of weight: what joints about vertical axes hold is rounding."""


class Everywhere(StrEnum):
    """Whether a motor holds in every posture."""

    HOLDS = "holds everywhere"
    FAILS = "does not hold everywhere"
    OPEN = "not decided"


@dataclass(frozen=True, eq=False)
class WorstPostures(Tabular):
    """The posture in which gravity asks most of each motor.

    Attributes:
        joint_names: In actuator order.
        joint_torques: (nu,) the greatest found, with its sign (N m, N).
        postures: (nu, nu) where; a row for each motor (rad, m).
        bounds: (nu,) what no posture exceeds, either way (N m, N); infinite where none is known.
        limits: (nu,) of the motors (N m, N).
        utilisation: (nu,) the greatest found / limit.
        everywhere: (nu,) whether the motor holds in every posture; by the bound if it does, by the
            posture if it does not.
        unproven: Why there is no bound; None if there is.
    """

    joint_names: tuple[str, ...]
    joint_torques: Array
    postures: Array
    bounds: Array
    limits: Array
    utilisation: Array
    everywhere: tuple[Everywhere, ...]
    unproven: Diagnostic | None

    def _columns(self) -> dict[str, ArrayLike]:
        return {
            "joint": self.joint_names,
            "torque": self.joint_torques,
            "bound": self.bounds,
            "utilisation": self.utilisation,
            "everywhere": [one.value for one in self.everywhere],
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
    along a joint in closed form; a search goes from joint to joint, from several postures. That no
    posture exceeds what is found by much says the bound of ``GravityTree.greatest``.

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
    bounds, unproven = torque_bounds(
        robot, ways, looks, tool, payload, starts[:_CHECKED], asked=asked
    )
    search = Search(robot, ways, looks.with_mass(tool, payload) if payload else looks)
    torques, postures = np.zeros(robot.nu), np.tile(posture.qpos, (robot.nu, 1))
    if near is not None:
        torques[~asked], postures[~asked] = near.joint_torques[~asked], near.postures[~asked]
        bounds[~asked] = near.bounds[~asked, None]
    pool = ways.random(_POOL) if ways.bent.any() and near is None else []
    sampled = np.array([search.torques(qpos) for qpos in pool])
    for joint in np.flatnonzero(asked).tolist():
        begin = [posture.qpos, *starts[:_STARTS]]
        if near is not None:
            begin.insert(0, near.postures[joint])
        for column, sign in enumerate((1.0, -1.0)):
            goal = bounds[joint, column]
            if goal <= abs(torques[joint]):
                continue
            most = np.argsort(-sign * sampled[:, joint])[:_WORST] if pool else ()
            found, at = search.highest(
                joint, sign, [*begin[:1], *(pool[one] for one in most), *begin[1:]], goal
            )
            if found > abs(torques[joint]):
                torques[joint], postures[joint] = sign * found, at
    torques[np.abs(torques) <= _NOTHING * robot.total_mass * np.linalg.norm(robot.gravity)] = 0.0
    most, limits = np.abs(torques), robot.effort_limits
    either = np.maximum(bounds.max(axis=1), most)  # a bound is one up to rounding
    with np.errstate(divide="ignore", invalid="ignore"):
        used = np.where(most > 0, most / limits, 0.0)
    return WorstPostures(
        joint_names=robot.joint_names,
        joint_torques=torques,
        postures=postures,
        bounds=either,
        limits=limits,
        utilisation=used,
        everywhere=tuple(
            Everywhere.HOLDS
            if bound <= limit
            else Everywhere.FAILS
            if found > limit
            else Everywhere.OPEN
            for found, bound, limit in zip(most, either, limits, strict=True)
        ),
        unproven=unproven,
    )


def torque_bounds(
    robot: Robot,
    ways: Ways,
    looks: Looks,
    tool: Tool,
    payload: float,
    samples: Sequence[Array],
    *,
    asked: NDArray[np.bool_],
) -> tuple[Array, Diagnostic | None]:
    """Finds what no posture exceeds: each motor's torque, and its negative (N m, N).

    Gravity's is bounded over all positions of all joints, each for itself; springs of joints add
    what they do at the ends of ranges.

    Args:
        robot: A robot whose base is held.
        ways: How its joints move.
        looks: What it holds.
        tool: Where a payload is.
        payload: Its mass (kg).
        samples: Postures (nu,) in which both are compared with the robot.
        asked: (nu,) of which motors.

    Returns:
        The bounds (nu, 2), infinite where there is none; and why one motor has none.
    """
    bounds = np.full((robot.nu, 2), math.inf)
    if ways.endless:
        return bounds, diagnose("slide-not-limited")
    tree = GravityTree.of(robot, joint_ranges(robot))
    off = [
        tree_torques(tree, qpos) + looks.spring_load(qpos) - looks.load(qpos) for qpos in samples
    ]
    weight = robot.total_mass * float(np.linalg.norm(robot.gravity))
    told = np.all(np.abs(off) <= ROUNDING * weight, axis=0)
    holds = np.abs(ways.shares) > _NO_SHARE
    known = ways.constant & ~(holds & ~told).any(axis=1)
    bounded = known & asked
    shares = ways.shares[bounded]
    most = tree.with_mass(robot, tool, payload).greatest(shares)
    if looks.stiffness.any():
        here = shares @ looks.spring_load(ways.origin)
        rates = shares * looks.stiffness @ ways.steps
        # A spring at a joint that turns freely has no greatest torque.
        endless = np.argwhere(~np.isfinite(joint_ranges(robot)))[:, 0]
        for way, moved in enumerate(ways.moved):
            turns = np.isin(moved, endless).any()
            low, high = (-math.inf, math.inf) if turns else ways.span(ways.origin, way)
            rate = rates[:, [way]]
            with np.errstate(invalid="ignore"):
                ends = np.where(rate == 0, 0.0, rate * np.array([low, high]))
            most += np.column_stack([ends.max(axis=1), -ends.min(axis=1)])
        most += np.column_stack([here, -here])
    bounds[bounded] = most
    if not told.all():
        return bounds, diagnose("springs-act-at-rest")
    if not known.all():
        return bounds, diagnose("loops-bend-ways")
    return bounds, None if np.isfinite(most).all() else diagnose("springs-turn-freely")
