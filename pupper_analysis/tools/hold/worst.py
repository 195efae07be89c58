"""The worst posture of each motor: the one in which gravity asks most of it.

Searched for from several postures, joint by joint.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.results import Tabular
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot, acts_at_rest
from pupper_analysis.robot.tool import Tool
from pupper_analysis.stance.posture import Posture, joint_ranges
from pupper_analysis.statics.equilibrium import utilise
from pupper_analysis.tools.hold.motions import JointMotions

Array = NDArray[np.float64]

_AGREED = 3
"""Searches that end at the same torque, and then no other is begun."""

_SAME = 1e-9  # in parts of the torque

_SWEEPS = 30
_GAIN = 1e-10  # of a sweep, in parts of the torque: less is rounding

_LOOKS = 24
"""Along a joint that others follow, or where torques are no single wave."""

_PEAK = 1e-6
"""How closely a greatest torque is sought between looks (rad, m): it is 1e-12 of it off."""

_NO_SHARE = 1e-12


class Search:
    """Climbs from posture to posture to where a motor holds most.

    Args:
        robot: A robot whose base is held.
        motions: How its joints move.
        tool: Where it carries.
        payload: What it carries there (kg).
    """

    def __init__(self, robot: Robot, motions: JointMotions, tool: Tool, payload: float) -> None:
        self._robot, self._motions, self._tool, self._payload = robot, motions, tool, payload
        model, joints = robot.structure.model, robot.mj_model.jnt_stiffness
        numbers = [robot.structure.joints[name] for name in robot.joint_names]
        carried = np.array([[other in model.supports[one] for other in numbers] for one in numbers])
        self.stiffness = joints[[robot.mj_model.joint(name).id for name in robot.joint_names]]
        # What gravity and springs of joints ask is a wave, and a line; and so is what carries.
        plain = copy.copy(robot.mj_model)
        plain.jnt_stiffness[:] = plain.body_gravcomp[:] = 0.0
        self._waves = not acts_at_rest(plain)
        self._matters = carried | carried.T | (not self._waves)

    def highest(self, joint: int, sign: float, starts: list[Array]) -> tuple[float, Array]:
        """Returns the most that a motor holds with a sign (N m, N), and where, from some postures.

        No other is begun from if several end alike.
        """
        ends: list[tuple[float, Array]] = []
        for start in starts:
            ends.append(self.climb(joint, sign, start))
            best = max(ends, key=lambda end: end[0])
            alike = sum(end[0] >= best[0] - _SAME * abs(best[0]) for end in ends)
            if alike >= _AGREED:
                break
        return best

    def climb(self, joint: int, sign: float, qpos: Array) -> tuple[float, Array]:
        """Returns the most that a motor holds with a sign (N m, N), and where, near a posture."""
        best = self._torque(joint, sign, qpos)
        loads = np.abs(self._motions.shares[joint]) > _NO_SHARE
        matter = self._matters[loads].any(axis=0)
        chosen = [way for way, moved in enumerate(self._motions.moved) if matter[moved].any()]
        for _ in range(_SWEEPS):
            before = best
            for way in chosen:
                length = self._peak(joint, sign, qpos, way, best)
                there = self._motions.along(qpos, way, length)
                found = self._torque(joint, sign, there)
                if found > best:
                    best, qpos = found, there
            if best - before <= _GAIN * abs(best):
                break
        return best, qpos

    def _peak(self, joint: int, sign: float, qpos: Array, way: int, here: float) -> float:
        """Returns where along a way a torque is greatest (rad, m)."""
        motions = self._motions
        low, high = motions.span(qpos, way)

        def at(length: float) -> float:
            return self._torque(joint, sign, motions.along(qpos, way, length))

        moved = motions.moved[way]
        if self._waves and motions.slides[moved].all():
            return max((low, high), key=at)  # a line
        if len(moved) > 1 or not self._waves:
            return _sampled(at, np.linspace(low, high, _LOOKS))
        spring = sign * float(motions.shares[joint, moved[0]] * self.stiffness[moved[0]])
        third = 2 * math.pi / 3
        ahead, behind = at(third) - spring * third, at(-third) + spring * third
        mean = (here + ahead + behind) / 3
        sine, cosine = (ahead - behind) / math.sqrt(3), here - mean
        return _crest(cosine, sine, spring, low, high)

    def _torque(self, joint: int, sign: float, qpos: Array) -> float:
        config = Configuration(self._robot, qpos)
        load = config.load()
        if self._payload:
            load = load + self._payload * self._tool.load_per_mass(config)
        return sign * float(self._motions.shares[joint] @ load)


def _crest(cosine: float, sine: float, rate: float, low: float, high: float) -> float:
    """Returns where in [low, high] a cos x + b sin x + r x is greatest."""
    ends, size = [low, high], math.hypot(cosine, sine)
    if abs(rate) <= size and size > 0:
        # b cos x - a sin x + r = 0; of its two solutions in a turn one is a crest.
        first, swing = math.atan2(sine, cosine), math.asin(rate / size)
        base = first + swing
        turns = range(
            math.floor((low - base) / (2 * math.pi)) + 1,
            math.floor((high - base) / (2 * math.pi)) + 1,
        )
        ends += [base + 2 * math.pi * turn for turn in turns]
    return max(ends, key=lambda x: cosine * math.cos(x) + sine * math.sin(x) + rate * x)


def _sampled(at: Callable[[float], float], looks: Array) -> float:
    """Returns where a function is greatest: beside the greatest of some looks."""
    from scipy import optimize  # slow to import

    found = np.array([at(look) for look in looks])
    top = int(np.argmax(found))
    low, high = looks[max(top - 1, 0)], looks[min(top + 1, len(looks) - 1)]
    if np.ptp(found) <= _GAIN * abs(found[top]) or high - low <= _PEAK:
        return float(looks[top])
    best = optimize.minimize_scalar(
        lambda length: -at(length), bounds=(low, high), method="bounded", options={"xatol": _PEAK}
    )
    return float(max((looks[top], low, best.x, high), key=at))


_STARTS = 12
"""Random postures that a search begins from, besides the one that is asked about."""

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
        still: Joints of loops that do not move in proportion: they are where the posture has them.
    """

    joint_names: tuple[str, ...]
    joint_torques: Array = field(metadata={"unit": "N m or N"})
    postures: Array = field(metadata={"unit": "rad or m"})
    limits: Array = field(metadata={"unit": "N m or N"})
    utilisation: Array = field(metadata={"unit": "1"})
    endless: Diagnostic | None
    still: tuple[str, ...]

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
    random postures until several end alike. That is no proof: there may be a posture that asks for
    more, though none of 20,000 random ones did of seven arms and hands. Loops whose joints do not
    move in proportion, as a gripper's four bars, stay as the posture has them (``still``).

    Args:
        robot: A robot whose base is held.
        posture: Where joints are that do not matter.
        tool: Where the payload is.
        payload: A mass at the tool (kg).
        near: The worst postures for another payload: searches begin there.
        bearing: (nu,) which motors bear the payload, if that is known: all else is as ``near``.
    """
    motions = JointMotions(robot, posture)
    starts = motions.random(_STARTS)
    asked = np.ones(robot.nu, dtype=bool) if near is None or bearing is None else bearing
    search = Search(robot, motions, tool, payload)
    torques, postures = np.zeros(robot.nu), np.tile(posture.qpos, (robot.nu, 1))
    if near is not None:
        torques[~asked], postures[~asked] = near.joint_torques[~asked], near.postures[~asked]
    for joint in np.flatnonzero(asked).tolist():
        begin = [posture.qpos, *starts]
        if near is not None:
            begin.insert(0, near.postures[joint])
        for sign in (1.0, -1.0):
            found, at = search.highest(joint, sign, begin)
            if found > abs(torques[joint]):
                torques[joint], postures[joint] = sign * found, at
    torques[np.abs(torques) <= _NOTHING * robot.weight] = 0.0
    return WorstPostures(
        joint_names=robot.joint_names,
        joint_torques=torques,
        postures=postures,
        limits=robot.effort_limits,
        utilisation=np.where(torques != 0, utilise(robot, torques), 0.0),
        endless=_endless(robot, motions, search.stiffness),
        still=tuple(robot.joint_names[joint] for joint in motions.still),
    )


def _endless(robot: Robot, motions: JointMotions, stiffness: Array) -> Diagnostic | None:
    """Returns why a torque may have no greatest: a slide, or a spring, goes on without end."""
    if motions.endless:
        return diagnose("slide-not-limited")
    free = ~np.isfinite(joint_ranges(robot)).all(axis=1)
    return diagnose("springs-turn-freely") if (free & (stiffness != 0)).any() else None
