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
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.base.results import Tabular
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.joints import joint_ranges
from pupper_analysis.robot.robot import Robot, acts_at_rest
from pupper_analysis.robot.tool import Tool
from pupper_analysis.stance.posture import Posture
from pupper_analysis.statics.equilibrium import utilise
from pupper_analysis.tools.hold.motions import JointMotions

Array = NDArray[np.float64]

_AGREED = 3
"""Searches that end at the same torque, and then no other is begun."""

_SAME = 1e-9  # in parts of the torque

_SWEEPS = 30
_GAIN = 1e-10  # of a sweep, in parts of the torque: less is rounding

_PEAK = 1e-6
"""How closely a greatest torque is sought between looks (rad, m): it is 1e-12 of it off."""

_OUT = 1e300
"""Above any torque [N m]. Its negative is the value where a loop cannot be closed."""

_NO_SHARE = 1e-12


class TorqueSearch:
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
        """Search the largest torque of a motor in one direction from several postures.

        The search ends early if several start postures lead to the same torque.

        Args:
            joint: Index of the joint.
            sign: Direction of the torque, 1 or -1.
            starts: Start postures, shape (nu,) [rad, m] each.

        Returns:
            sign x torque [N m, N], and the posture, shape (nu,).
        """
        ends: list[tuple[float, Array]] = []
        for start in starts:
            ends.append(self.climb(joint, sign, start))
            best = max(ends, key=lambda end: end[0])
            alike = sum(end[0] >= best[0] - _SAME * abs(best[0]) for end in ends)
            if alike >= _AGREED:
                break
        # Loops are closed between their places where it is worth it.
        return self.climb(joint, sign, best[1], fine=True) if self._motions.bent.any() else best

    def climb(
        self, joint: int, sign: float, qpos: Array, *, fine: bool = False
    ) -> tuple[float, Array]:
        """Search the largest torque of a motor in one direction, motion by motion from a posture.

        Args:
            joint: Index of the joint.
            sign: Direction of the torque, 1 or -1.
            qpos: Start posture, shape (nu,) [rad, m].
            fine: Refine maxima between the samples of closed loops.

        Returns:
            sign x torque [N m, N], and the posture, shape (nu,).
        """
        best = self._torque(joint, sign, qpos)
        loads = np.abs(self._motions.shares[joint]) > _NO_SHARE
        matter = self._matters[loads].any(axis=0)
        chosen = [way for way, moved in enumerate(self._motions.moved) if matter[moved].any()]
        for _ in range(_SWEEPS):
            before = best
            for way in chosen:
                length = self._peak(joint, sign, qpos, way, best, fine=fine)
                there = self._motions.along(qpos, way, length)
                found = -math.inf if there is None else self._torque(joint, sign, there)
                if there is not None and found > best:
                    best, qpos = found, there
            if best - before <= _GAIN * abs(best):
                break
        return best, qpos

    def torques(self, qpos: Array) -> Array:
        """Return the motor torques in a posture, shape (nu,) [N m or N]; zeros at a singularity."""
        config = Configuration(self._robot, qpos)
        try:
            return config.by_motors(self._load(config))
        except ConfigurationError:
            return np.zeros(len(qpos))

    def _peak(
        self, joint: int, sign: float, qpos: Array, way: int, here: float, *, fine: bool
    ) -> float:
        """Returns where along a way a torque is greatest (rad, m)."""
        motions = self._motions
        low, high = motions.span(qpos, way)

        def at(length: float) -> float:
            there = motions.along(qpos, way, length)
            return -_OUT if there is None else self._torque(joint, sign, there)

        moved = motions.moved[way]
        if self._waves and not motions.bent[way] and motions.slides[moved].all():
            return max((low, high), key=at)  # a line
        if len(moved) > 1 or not self._waves:
            looks = np.linspace(low, high, motions.places(way))
            bent = bool(motions.bent[way])
            return _sampled(at, looks, fine=fine or not bent, everywhere=bent)
        spring = sign * float(motions.shares[joint, moved[0]] * self.stiffness[moved[0]])
        third = 2 * math.pi / 3
        ahead, behind = at(third) - spring * third, at(-third) + spring * third
        mean = (here + ahead + behind) / 3
        sine, cosine = (ahead - behind) / math.sqrt(3), here - mean
        return _crest(cosine, sine, spring, low, high)

    def _load(self, config: Configuration) -> Array:
        load = config.load()
        return load + self._payload * self._tool.load_per_mass(config) if self._payload else load

    def _torque(self, joint: int, sign: float, qpos: Array) -> float:
        config = Configuration(self._robot, qpos)
        load = self._load(config)
        if self._motions.constant[joint]:
            return sign * float(self._motions.shares[joint] @ load)
        try:
            return sign * float(config.by_motors(load)[joint])
        except ConfigurationError:  # at a dead point nothing holds the loop
            return -_OUT


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


def _sampled(at: Callable[[float], float], looks: Array, *, fine: bool, everywhere: bool) -> float:
    """Return the argument of the maximum of a function on an interval.

    The function is evaluated at `looks`. With `fine`, a bounded scalar minimisation (scipy) follows
    around the largest value, or, with `everywhere`, around each local maximum: between samples of
    a closed loop the global maximum need not be next to the largest sample.
    """
    from scipy import optimize  # slow to import

    found = np.array([at(look) for look in looks])
    top = int(np.argmax(found))
    if not fine or np.ptp(found) <= _GAIN * abs(found[top]):
        return float(looks[top])
    beside = np.concatenate([[-math.inf], found, [-math.inf]])
    peaks = (found > -_OUT) & (found >= np.maximum(beside[:-2], beside[2:]))
    chosen = [float(looks[top])]
    for number in np.flatnonzero(peaks).tolist() if everywhere else [top]:
        ends = looks[max(number - 1, 0)], looks[min(number + 1, len(looks) - 1)]
        low, high = (_nearest(at, float(looks[number]), float(end)) for end in ends)
        if high - low > _PEAK:
            best = optimize.minimize_scalar(
                lambda length: -at(length),
                bounds=(low, high),
                method="bounded",
                options={"xatol": _PEAK},
            )
            chosen += [low, best.x, high]
    return float(max(chosen, key=at))


def _nearest(at: Callable[[float], float], here: float, end: float) -> float:
    """Return the last argument between `here` and `end` at which the function is defined."""
    if at(end) > -_OUT:
        return end
    while abs(end - here) > _PEAK:
        middle = (here + end) / 2
        here, end = (middle, end) if at(middle) > -_OUT else (here, middle)
    return here


_STARTS = 12
"""Random postures that a search begins from, besides the one that is asked about."""

_POOL = 500
"""Number of random postures of a robot with loops whose joints do not move in proportion. Searches
start from the worst of them, too: such loops have many local maxima. Chosen, not tuned."""

_WORST = 3
"""Number of those postures from which a search starts."""

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
    joint_torques: Array = field(metadata={"unit": "N m or N"})
    postures: Array = field(metadata={"unit": "rad or m"})
    limits: Array = field(metadata={"unit": "N m or N"})
    utilisation: Array = field(metadata={"unit": "1"})
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
    """Search for each motor the posture in which gravity and joint springs load it most.

    As a function of one joint angle q, a torque is a + b cos q + c sin q (a + b q for a slide; a
    spring at the joint adds k q). Three samples therefore give the maximum over one joint in closed
    form. A search maximises over one joint after another until the torque no longer increases. It
    is repeated from random postures until several searches agree. The result is no proof: another
    posture may have a larger torque. None of 20,000 random postures of seven arms and hands did.

    Args:
        robot: Robot with a fixed base.
        posture: Posture; supplies the positions of joints that do not affect a torque.
        tool: Point at which the payload is attached.
        payload: Mass at the tool [kg].
        near: Worst postures for another payload, as additional start.
        bearing: Motors that bear the payload, shape (nu,). With ``near``, only these are searched;
            the results of other motors are copied.
    """
    motions = JointMotions(robot, posture)
    starts = motions.random(_STARTS)
    asked = np.ones(robot.nu, dtype=bool) if near is None or bearing is None else bearing
    search = TorqueSearch(robot, motions, tool, payload)
    torques, postures = np.zeros(robot.nu), np.tile(posture.qpos, (robot.nu, 1))
    if near is not None:
        torques[~asked], postures[~asked] = near.joint_torques[~asked], near.postures[~asked]
    pool = motions.random(_POOL) if motions.bent.any() and near is None else []
    sampled = np.array([search.torques(qpos) for qpos in pool])
    for joint in np.flatnonzero(asked).tolist():
        begin = [posture.qpos, *starts]
        if near is not None:
            begin.insert(0, near.postures[joint])
        for sign in (1.0, -1.0):
            most = np.argsort(-sign * sampled[:, joint])[:_WORST] if pool else ()
            found, at = search.highest(
                joint, sign, [*begin[:1], *(pool[one] for one in most), *begin[1:]]
            )
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
    )


def _endless(robot: Robot, motions: JointMotions, stiffness: Array) -> Diagnostic | None:
    """Returns why a torque may have no greatest: a slide, or a spring, goes on without end."""
    if motions.endless:
        return diagnose("slide-not-limited")
    free = ~np.isfinite(joint_ranges(robot)).all(axis=1)
    return diagnose("springs-turn-freely") if (free & (stiffness != 0)).any() else None
