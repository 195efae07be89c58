"""The worst posture of each motor: the one in which gravity asks most of it.

Searched for from several postures, joint by joint. What is held in one posture of thousands is
computed without what a configuration sets up.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.base.results import Tabular
from pupper_analysis.robot.configuration import AtRest, Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.tool import Tool, carrying_link
from pupper_analysis.stance.posture import Posture, check_held, joint_ranges
from pupper_analysis.tools.hold.motions import JointMotions

Array = NDArray[np.float64]

ROUNDING = 1e-8
"""N m per N of weight: by which two ways to compute a torque may differ."""


class JointLoads:
    """Looks at what motors and couplings of joints hold in postures (5 us each).

    Gravity, by Pinocchio; springs of joints and gravity compensation, which are gravity on lighter
    links; and only where a MJCF has more that acts at rest, such as springs of tendons, MuJoCo.

    Args:
        robot: A robot whose base is held.
        postures: (n, nu) some, at which ``Configuration.load`` is compared.

    Attributes:
        stiffness: (nu,) of joints' springs (N m/rad, N/m).
        rest: (nu,) where these pull to (rad, m).
        springs_alone: Whether nothing but these and gravity acts.
    """

    def __init__(self, robot: Robot, postures: Iterable[Array]) -> None:
        self._robot, self._structure = robot, robot.structure
        self._model, self._lifted = robot.structure.model, _compensation(robot)
        self._data = self._model.createData()
        self._lift = None if self._lifted is None else self._lifted.createData()
        self._others: AtRest | None = None
        model = robot.mj_model
        joints = [model.joint(name).id for name in robot.joint_names]
        self.stiffness = np.array(model.jnt_stiffness[joints])
        self.rest = np.array(model.qpos_spring[model.jnt_qposadr[joints]])
        self._sprung = bool(self.stiffness.any())
        if robot.acts_at_rest:
            most = ROUNDING * robot.total_mass * float(np.linalg.norm(robot.gravity))
            off = [self.load(qpos) - Configuration(robot, qpos).load() for qpos in postures]
            if np.abs(off).max(initial=0.0) > most:
                self._others = AtRest(robot)
        self.springs_alone = self._others is None

    def with_mass(self, tool: Tool, mass: float) -> JointLoads:
        """Returns the same of the robot with a point mass at a tool (kg)."""
        loaded = object.__new__(JointLoads)
        vars(loaded).update(vars(self))
        model = self._model.copy()
        frame = model.frames[self._structure.links[tool.link]]
        weight = pin.Inertia(mass, frame.placement.act(tool.offset), np.zeros((3, 3)))
        model.inertias[frame.parentJoint] = model.inertias[frame.parentJoint] + weight
        loaded._model = model
        return loaded

    def load(self, qpos: Array) -> Array:
        """Returns what is held in a posture (nu,) at rest (N m, N): ``Configuration.load``."""
        q = self._structure.convention.unit_q(qpos)
        forces = pin.computeGeneralizedGravity(self._model, self._data, q)
        if self._others is not None:
            return self._structure.dual(forces) - self._others.forces(qpos)
        if self._lifted is not None:
            forces = forces - pin.computeGeneralizedGravity(self._lifted, self._lift, q)
        load = self._structure.dual(forces)
        return load + self.spring_load(qpos) if self._sprung else load

    def spring_load(self, qpos: Array) -> Array:
        """Returns what springs of joints leave to motors (nu,) in a posture."""
        pulled: Array = self.stiffness * (qpos - self.rest)
        return pulled


def compensated(robot: Robot) -> Iterable[tuple[str, Array, float]]:
    """Yields what gravity compensation carries: a link, a place in it (3,) (m), and mass (kg)."""
    model = robot.mj_model
    for body in np.flatnonzero(model.body_gravcomp).tolist():
        link, place = carrying_link(robot, body, model.body_ipos[body])
        yield link, place, float(model.body_gravcomp[body] * model.body_mass[body])


def _compensation(robot: Robot) -> pin.Model | None:
    """Returns the model of a robot that has the masses that gravity compensation carries."""
    carried = list(compensated(robot))
    if not carried:
        return None
    model, none = robot.structure.model.copy(), pin.Inertia(0.0, np.zeros(3), np.zeros((3, 3)))
    for joint in range(model.njoints):
        model.inertias[joint] = none
    for link, place, mass in carried:
        frame = model.frames[robot.structure.links[link]]
        weight = pin.Inertia(mass, frame.placement.act(place), np.zeros((3, 3)))
        own = model.inertias[frame.parentJoint]
        model.inertias[frame.parentJoint] = own + weight if own.mass else weight
    return model


_AGREED = 3
"""Searches that end at the same torque, and then no other is begun."""

_SAME = 1e-9  # in parts of the torque

_SWEEPS = 30
_GAIN = 1e-10  # of a sweep, in parts of the torque: less is rounding

_CLOSER = 1e-6
"""Gain of a sweep between a loop's places that is worth another, in parts of the torque."""

_FINE = 1e-4
"""How closely a joint of a loop is placed at the end (rad, m): the torque is 1e-8 of it off."""

_SAMPLES = 24
"""JointLoads along a joint that others follow, where torques are no single wave."""

_PEAK = 1e-6
"""How closely their greatest is then sought (rad, m): the torque at it is 1e-12 of it off."""

_OUT = 1e300
"""Less than any torque, turned over: where no loop closes."""

_NO_SHARE = 1e-12


class Search:
    """Climbs from posture to posture to where a motor holds most.

    Args:
        robot: A robot whose base is held.
        ways: How its joints move.
        loads: What it holds.
    """

    def __init__(self, robot: Robot, motions: JointMotions, loads: JointLoads) -> None:
        self._robot, self._motions, self._loads = robot, motions, loads
        model = robot.structure.model
        numbers = [robot.structure.joints[name] for name in robot.joint_names]
        carried = np.array([[other in model.supports[one] for other in numbers] for one in numbers])
        self._matters = carried | carried.T | (not loads.springs_alone)

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
        if self._motions.bent.any():
            return self.refine(joint, sign, *best)
        return best

    def refine(self, joint: int, sign: float, best: float, qpos: Array) -> tuple[float, Array]:
        """Climbs on, with all joints of a loop at once, and between its places."""
        motions = self._motions
        for _ in range(_SWEEPS):
            before = best
            for way in self._chosen(joint):
                if not motions.bent[way]:
                    there = [motions.along(qpos, way, self._peak(joint, sign, qpos, way, best))]
                else:
                    there = motions.closed_before(qpos, way)
                    nearest = max(
                        [qpos, *there], key=lambda place: self._torque(joint, sign, place)
                    )
                    near = (nearest, *self._peaks(joint, sign, nearest, way))
                    there = [nearest, *(self._between(joint, sign, one, way) for one in near)]
                for place in there:
                    found = self._torque(joint, sign, place)
                    if found > best:
                        best, qpos = found, place
            if best - before <= _CLOSER * abs(best):
                break
        return best, qpos

    def climb(self, joint: int, sign: float, qpos: Array) -> tuple[float, Array]:
        """Returns the most that a motor holds with a sign (N m, N), and where, near a posture."""
        motions, best = self._motions, self._torque(joint, sign, qpos)
        chosen = self._chosen(joint)
        for _ in range(_SWEEPS):
            before = best
            for way in chosen:
                if motions.bent[way]:
                    there = [place for place in motions.places(qpos, way) if place is not None]
                else:
                    there = [motions.along(qpos, way, self._peak(joint, sign, qpos, way, best))]
                for place in there:
                    found = self._torque(joint, sign, place)
                    if found > best:
                        best, qpos = found, place
            if best - before <= _GAIN * abs(best):
                break
        return best, qpos

    def torques(self, qpos: Array) -> Array:
        """Returns what all motors hold in a posture (nu,) (N m, N); 0 at a dead point."""
        found = np.array([self._torque(joint, 1.0, qpos) for joint in range(len(qpos))])
        return np.where(np.isfinite(found), found, 0.0)

    def _chosen(self, joint: int) -> list[int]:
        """Returns the ways that matter to what a motor holds."""
        loads = np.abs(self._motions.shares[joint]) > _NO_SHARE
        matter = self._matters[loads].any(axis=0)
        return [way for way, moved in enumerate(self._motions.moved) if matter[moved].any()]

    def _peaks(self, joint: int, sign: float, qpos: Array, way: int) -> list[Array]:
        """Returns the places along a way that bends next to which no torque is greater."""
        places = self._motions.places(qpos, way)
        found = [-math.inf if it is None else self._torque(joint, sign, it) for it in places]
        beside = [-math.inf, *found, -math.inf]
        highest = map(max, beside[:-2], beside[2:])
        return [
            place
            for place, own, most in zip(places, found, highest, strict=True)
            if place is not None and own >= most
        ]

    def _between(self, joint: int, sign: float, qpos: Array, way: int) -> Array:
        """Returns where along a way that bends, near a posture, a torque is greatest."""
        from scipy import optimize  # slow to import

        def lacking(position: float) -> float:
            there = self._motions.bend(qpos, way, position)
            return _OUT if there is None else -self._torque(joint, sign, there)

        here = float(qpos[self._motions.free[way]])
        low, high = (self._closing(qpos, way, here, end) for end in self._motions.around(qpos, way))
        found = optimize.minimize_scalar(
            lacking, bounds=(low, high), method="bounded", options={"xatol": _FINE}
        )
        ends = (self._motions.bend(qpos, way, at) for at in (low, float(found.x), high))
        closed = [end for end in ends if end is not None]
        return max(closed, key=lambda there: self._torque(joint, sign, there), default=qpos)

    def _closing(self, qpos: Array, way: int, here: float, end: float) -> float:
        """Returns how far a loop closes on the way from here, where it does, to an end (rad, m)."""
        if self._motions.bend(qpos, way, end) is not None:
            return end
        while abs(end - here) > _PEAK:
            middle = (here + end) / 2
            closes = self._motions.bend(qpos, way, middle) is not None
            here, end = (middle, end) if closes else (here, middle)
        return here

    def _peak(self, joint: int, sign: float, qpos: Array, way: int, here: float) -> float:
        """Returns where along a way, which does not bend, a torque is greatest (rad, m)."""
        motions = self._motions
        low, high = motions.span(qpos, way)

        def at(length: float) -> float:
            return self._torque(joint, sign, motions.along(qpos, way, length))

        moved = motions.moved[way]
        if len(moved) > 1 or not self._loads.springs_alone:
            return _sampled(at, low, high)
        if motions.slides[moved[0]]:
            return max((low, high), key=at)
        spring = sign * float(motions.shares[joint, moved[0]] * self._loads.stiffness[moved[0]])
        third = 2 * math.pi / 3
        ahead, behind = at(third) - spring * third, at(-third) + spring * third
        mean = (here + ahead + behind) / 3
        sine, cosine = (ahead - behind) / math.sqrt(3), here - mean
        return _crest(cosine, sine, spring, low, high)

    def _torque(self, joint: int, sign: float, qpos: Array) -> float:
        load = self._loads.load(qpos)
        if self._motions.constant[joint]:
            return sign * float(self._motions.shares[joint] @ load)
        closure = self._robot.closure
        assert closure is not None
        try:
            pushed = closure.push(qpos)[joint]
        except ConfigurationError:  # at a dead point nothing holds the loop
            return -math.inf
        return sign * float(load[joint] - pushed @ load)


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


def _sampled(at: Callable[[float], float], low: float, high: float) -> float:
    """Returns where in [low, high] a function is greatest that is no single wave."""
    from scipy import optimize  # slow to import

    samples = np.linspace(low, high, _SAMPLES)
    top = int(np.argmax([at(look) for look in samples]))
    ends = samples[max(top - 1, 0)], samples[min(top + 1, _SAMPLES - 1)]
    if ends[1] - ends[0] < 1e-12:
        return float(samples[top])
    found = optimize.minimize_scalar(
        lambda length: -at(length), bounds=ends, method="bounded", options={"xatol": _PEAK}
    )
    return float(max((found.x, samples[top]), key=at))


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
    random postures until several end alike. That is no proof: there may be a posture that asks for
    more, though none of 20,000 random ones did of seven arms and hands.

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
    motions = JointMotions(robot, posture)
    starts = motions.random(max(_STARTS, _CHECKED))
    loads = JointLoads(robot, starts[:_CHECKED])
    asked = np.ones(robot.nu, dtype=bool) if near is None or bearing is None else bearing
    search = Search(robot, motions, loads.with_mass(tool, payload) if payload else loads)
    torques, postures = np.zeros(robot.nu), np.tile(posture.qpos, (robot.nu, 1))
    if near is not None:
        torques[~asked], postures[~asked] = near.joint_torques[~asked], near.postures[~asked]
    pool = motions.random(_POOL) if motions.bent.any() and near is None else []
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
        endless=_endless(robot, motions, loads),
    )


def _endless(robot: Robot, motions: JointMotions, loads: JointLoads) -> Diagnostic | None:
    """Returns why a torque may have no greatest: a slide, or a spring, goes on without end."""
    if motions.endless:
        return diagnose("slide-not-limited")
    free = ~np.isfinite(joint_ranges(robot)).all(axis=1)
    return diagnose("springs-turn-freely") if (free & (loads.stiffness != 0)).any() else None
