"""What a stance can carry: the greatest mass with which it still holds, and what fails beyond."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache, cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.errors import (
    NotSettlingError,
    StanceUnreachableError,
    StaticsInfeasibleError,
)
from pupper_analysis.base.results import Result
from pupper_analysis.models.efforts import EffortCode
from pupper_analysis.prepare.judge import judge_stand
from pupper_analysis.prepare.limits import list_driven_limits
from pupper_analysis.robot.joints import free_joints
from pupper_analysis.robot.robot import Robot, lend
from pupper_analysis.robot.servos import command_ranges, compute_command_lead, model_with_servos
from pupper_analysis.robot.stability import HOLD_DURATION
from pupper_analysis.robot.tool import Place, Tool, find_place, with_payload
from pupper_analysis.robot.touching import touching
from pupper_analysis.simulation.rollout import make_stand_start
from pupper_analysis.simulation.stability import evaluate_spectrum, evaluate_stability
from pupper_analysis.simulation.trial import Failure, NudgeTrial, simulate_nudges
from pupper_analysis.simulation.verdict import (
    UNKNOWN_CODES,
    Question,
    Verdict,
    VerdictCode,
    find_overloaded_motors,
)
from pupper_analysis.stance.soft_ground import solve_loaded_stand, solve_stand_as_simulated
from pupper_analysis.stance.solver import SearchContext
from pupper_analysis.stance.stand import Stand, solve_stand, stand_statics
from pupper_analysis.stance.task import StandTask
from pupper_analysis.statics.equilibrium import GravityCompensation


@dataclass(frozen=True, eq=False)
class PayloadTrial(NudgeTrial):
    """Simulations of a loaded stand that is nudged from all sides.

    Attributes:
        mass: Of the payload (kg).
    """

    mass: float = field(metadata={"unit": "kg"})


@check_arguments
def simulate_payload(
    robot: Robot,
    stance: StandTask | Stand,
    mass: float,
    point: Place = (0.0, 0.0, 0.0),
    *,
    kp: ArrayLike | None = None,
    kd: ArrayLike | None = None,
    duration: float = HOLD_DURATION,
) -> PayloadTrial:
    """Simulates a stance with a mass on the robot, as ``simulate_nudges`` does.

    It begins in the stand that ``stand --payload`` judges (``solve_loaded_stand``), with
    feed-forward for the load.

    Args:
        robot: The robot.
        stance: The stance; of a stand, its task.
        mass: Of the payload (kg).
        point: Where it is, as in ``with_payload``.
        kp: Servo stiffness (N m/rad); the model's own by default.
        kd: Servo damping (N m s/rad); the model's own by default.
        duration: Simulated time (s), at least 2.

    Returns:
        What happened.

    Raises:
        ConfigurationError: If an argument is out of its range, or the robot cannot stand.
        ModelError: If the model has no position servos, and kp and kd are not both given.
        StanceUnreachableError: If the stance is out of reach with that load.
        StaticsInfeasibleError: If no contact forces balance it.
    """
    loaded, stand = solve_loaded_stand(robot, stance, mass, point)
    seen = simulate_nudges(loaded, stand, kp=kp, kd=kd, duration=duration)
    return PayloadTrial(**vars(seen), mass=float(mass))


Array = NDArray[np.float64]

UNLIMITED_MASS_RATIO = 1e4
"""A payload above this many times the robot's mass is as good as unlimited."""

MAX_BOUND_RATIO = 10.0
"""Bounds of more than so many times the least are not looked for."""

VERIFIED_FRACTION = 0.97
"""The part of the limit with which the loaded stance is judged, and simulated nudged: just below
it, as no servo, floor or hand is exact to a percent."""

SIMULATION_RTOL = 0.02
"""To what part of itself a mass is found that holds in simulation, where that of the equilibrium
does not; to its square of the equilibrium's, below which it is as good as none."""

BINDING_BOUND_RTOL, BOUND_RTOL = 1e-6, 1e-3
"""To what part of itself a bound of motors or of the stance is found that binds, rounded down, and
others."""

_FIRST = 0.25  # the first mass tried, in parts of the robot's
_GROWTH = 1.5
"""Factor from one mass tried to the next: a window of failure narrower than this may be missed."""

_FASTER = 3.0  # factor beyond the mass at which the first bound gives way
_GRIPLESS = 10.0
"""A friction coefficient that no foot has: where more is needed, it is not friction that lacks."""


@dataclass(frozen=True, eq=False)
class Bound(Result):
    """One of the limits of a payload.

    Attributes:
        mass: kg; infinite if there is none, or only one far above the least (``MAX_BOUND_RATIO``).
        failure: What gives way just above.
        where: The motors, joints, feet or bodies concerned.
    """

    mass: float = field(metadata={"unit": "kg"})
    failure: Failure
    where: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class PayloadLimit(Result):
    """The greatest mass with which a stance holds, and what that rests on.

    All is of the loaded stand: the robot with the mass on it, its com where the task says, its feet
    sunk into the ground that is simulated (``solve_loaded_stand``).

    Attributes:
        name: The robot's name.
        mass: kg; the least of the four bounds, infinite if none binds; not a number if a motor that
            bears the load has an unknown torque limit, or a link an unknown mass.
        at_most: kg; the least of the four bounds, without motors whose limit is unknown.
        code: ``unknown`` if a motor that bears the load has an unknown torque limit, or a moving
            link an unknown mass, ``zero`` if a motor has no torque, else ``stated``.
        binding: Which of them it is: ``stance``, ``motors``, ``servos`` or ``simulation``.
        stance: Up to where there is a loaded stand: the base comes where the load asks for it, and
            the contacts bear it.
        motors: Up to where no motor is beyond its effort limit, with the contact forces that last.
        servos: Up to where the servos can be commanded so far, and no deviation grows within 12 s
            by the spectrum of MuJoCo's step, without the help of dry friction, however strong the
            motors are.
        simulation: Up to where ``VERIFIED_FRACTION`` of it holds in simulation, where that is
            less; 0 where the stance does not hold without payload.
        point: (3,) where the mass is attached, in the frame of ``link`` (m).
        link: Of the URDF, that carries it.
        unknown_limits: The motors that bear the load and whose torque limit no file states.
        stand: The loaded stand with ``mass``; without, if that is infinite.
        offset: (2,) of the base from the centre of the feet in it, as ``StandTask.offset`` (m).
        joint_names: (nu,) in actuator order.
        joint_torques: (nu,) in it (N m).
        contact_forces: {foot: (3,)} in it, in world axes (N).
        verdict: The one judge's, of the stance with ``VERIFIED_FRACTION`` of ``mass``; without
            payload, if that is nothing or infinite.
        trial: The simulation of the same nudged from all sides; None without one.
        continuous: Joints whose effort limit is a torque that lasts; of the others it is the peak.
    """

    name: str
    mass: float = field(metadata={"unit": "kg"})
    at_most: float = field(metadata={"unit": "kg"})
    code: EffortCode
    binding: str
    stance: Bound
    motors: Bound
    servos: Bound
    simulation: Bound
    point: Array = field(metadata={"unit": "m"})
    link: str
    unknown_limits: tuple[str, ...]
    stand: Stand
    offset: Array = field(metadata={"unit": "m"})
    joint_names: tuple[str, ...]
    joint_torques: Array = field(metadata={"unit": "N m"})
    contact_forces: dict[str, Array] = field(metadata={"unit": "N"})
    verdict: Verdict
    trial: PayloadTrial | None
    continuous: tuple[str, ...] = ()

    @property
    def torque_of(self) -> dict[str, float]:
        """{joint: torque in ``stand`` (N m)}."""
        return dict(zip(self.joint_names, self.joint_torques.tolist(), strict=True))

    @property
    def bounds(self) -> dict[str, Bound]:
        """The four bounds, the least first."""
        names = ("stance", "motors", "servos", "simulation")
        bounds: dict[str, Bound] = {name: getattr(self, name) for name in names}
        return dict(sorted(bounds.items(), key=lambda item: item[1].mass))

    @property
    def failure(self) -> Failure:
        """What gives way first."""
        return self.bounds[self.binding].failure

    @property
    def where(self) -> tuple[str, ...]:
        """The motors, joints, feet or bodies concerned."""
        return self.bounds[self.binding].where

    @property
    def passed(self) -> bool:
        """Whether a payload is known that it carries, and holds with; False if it is unknown."""
        return self.mass > 0 and self.verdict.passed and (self.trial is None or self.trial.held)


@check_arguments
def payload_limit(
    robot: Robot,
    stance: StandTask | Stand | None = None,
    point: Place = (0.0, 0.0, 0.0),
    *,
    kp: ArrayLike | None = None,
    kd: ArrayLike | None = None,
) -> PayloadLimit:
    """Finds the greatest point mass that a robot can carry in a stance.

    It is the greatest with which ``stand --payload`` holds. Each mass that is tried is put on the
    robot, and the stance solved anew, so that the base moves from under the load if the com shall
    be over the feet; on the ground that is simulated. Servos are commanded the pose with the
    feed-forward torques of the loaded robot. What holds by that is then judged as ``stand`` does,
    and simulated nudged from all sides; where either fails, less is looked for.

    Args:
        robot: The robot.
        stance: The stance; of a stand, its task. The nominal stand by default.
        point: Where the mass is, as in ``with_payload``.
        kp: Servo stiffness (N m/rad), one or (nu,); the model's own by default.
        kd: Servo damping (N m s/rad), one or (nu,); the model's own by default.

    Returns:
        The limit, and what it rests on.

    Raises:
        StanceUnreachableError: If the stance is out of reach without payload.
        StaticsInfeasibleError: If it slides or tips without payload.
        ConfigurationError: If an argument is out of its range, or makes no sense for the robot.
        ModelError: If the model has no position servos, and kp and kd are not both given.
    """
    place = find_place(robot, point)
    if isinstance(stance, Stand):
        robot = stance.check(robot)
        task = stance.task
    else:
        task = stance or StandTask()
        robot = touching(robot, task.contacts)
    # Without payload a refusal explains itself.
    stand_statics(robot, solve_stand_as_simulated(robot, solve_stand(robot, task)))
    search = _Search(robot, task, place, kp, kd)
    bounds = search.bounds()
    binding = min(bounds, key=lambda name: bounds[name].mass)
    most = bounds[binding].mass

    @cache
    def judged(mass: float) -> Verdict:
        loaded = with_payload(robot, mass, place)
        trial = tried(mass) if mass else None
        found = judge_stand(loaded, solve_stand(loaded, task), trial=trial, kp=kp, kd=kd)
        return replace(found, asked=Question.CARRIES)

    @cache
    def tried(mass: float) -> PayloadTrial:
        return simulate_payload(robot, task, mass, place, kp=kp, kd=kd)

    simulation = Bound(math.inf, Failure.NOTHING, ())
    if 0 < most < math.inf:
        simulation = _simulated(most, judged, tried)
    bounds["simulation"] = simulation
    if simulation.mass < most:
        binding, most = "simulation", simulation.mass
    carries = 0 < most < math.inf
    held = search.at(most if math.isfinite(most) else 0.0)
    unknown = _unknown_limits(robot, place)
    null = any(limit.without_torque for limit in list_driven_limits(robot))
    known = EffortCode.ZERO if null else EffortCode.STATED
    assert held.stand is not None
    assert held.statics is not None
    verdict = judged(VERIFIED_FRACTION * most if carries else 0.0)
    massless = verdict.code is VerdictCode.MASSES_UNKNOWN
    return PayloadLimit(
        name=robot.name,
        mass=math.nan if (unknown or massless) and most > 0 else most,
        at_most=most,
        code=EffortCode.UNKNOWN if unknown or massless else known,
        binding=binding,
        **bounds,
        continuous=(),
        point=place.offset,
        link=place.link,
        unknown_limits=unknown,
        stand=held.stand,
        offset=held.stand.qpos[:2] - held.stand.centre(robot)[:2],
        joint_names=robot.joint_names,
        joint_torques=held.statics.joint_torques,
        contact_forces=held.statics.contact_forces,
        verdict=verdict,
        trial=tried(VERIFIED_FRACTION * most) if carries else None,
    )


def _unknown_limits(robot: Robot, place: Tool) -> tuple[str, ...]:
    """Return the joints that carry a foot or the payload and whose torque limit no file states."""
    aside = set(free_joints(robot)) - set(place.chain)
    unknown = (
        limit.joint for limit in list_driven_limits(robot) if limit.code is EffortCode.UNKNOWN
    )
    return tuple(name for name in unknown if name not in aside)


FailureCause = tuple[Failure, tuple[str, ...]] | None
"""What fails, and where: the motors, joints, feet or bodies concerned; None if nothing does."""


def _simulated(
    most: float, judged: Callable[[float], Verdict], tried: Callable[[float], PayloadTrial]
) -> Bound:
    """Return the largest mass of which ``VERIFIED_FRACTION`` holds in simulation.

    What equilibria say is exact for a stand that is let alone; how far a nudge takes feet that
    lift, soles that pivot and motors that saturate, and what else is wrong with a file, simulation
    alone tells.
    """

    def trouble(mass: float) -> FailureCause:
        trial = tried(VERIFIED_FRACTION * mass)
        if trial.failure is not None:
            return trial.failure, trial.where
        return None if _holds(judged(VERIFIED_FRACTION * mass)) else (Failure.SIMULATED, ())

    found = trouble(most)
    if found is None:
        return Bound(math.inf, Failure.NOTHING, ())
    if not _holds(judged(0.0)):
        return Bound(0.0, Failure.UNLOADED, ())
    return _bisect(trouble, 0.0, most, found, SIMULATION_RTOL**2 * most, SIMULATION_RTOL)


def _holds(verdict: Verdict) -> bool:
    """Return True if a stance holds in simulation, even if torque limits or masses are unknown."""
    return verdict.passed or verdict.code in UNKNOWN_CODES


def _bisect(
    trouble: Callable[[float], FailureCause],
    low: float,
    high: float,
    found: FailureCause,
    least: float,
    part: float = 0.0,
) -> Bound:
    """Returns the greatest mass without trouble, to ``least`` (kg) or a part, and what is above.

    Args:
        trouble: Of a mass (kg).
        low: A mass without.
        high: A mass with trouble.
        found: That trouble.
        least: How near is near enough (kg).
        part: Or in parts of what is found, if that is more.
    """
    assert found is not None
    while high - low > max(least, part * low):
        middle = (low + high) / 2
        if (other := trouble(middle)) is None:
            low = middle
        else:
            high, found = middle, other
    return Bound(low, *found)


@dataclass(frozen=True, eq=False)
class _Held:
    """A loaded stand, or why there is none."""

    robot: Robot
    stand: Stand | None
    trouble: FailureCause

    @cached_property
    def statics(self) -> GravityCompensation | None:
        """What its motors hold."""
        return None if self.stand is None else stand_statics(self.robot, self.stand)


class _Search:
    """The search for the mass at which each bound gives way."""

    def __init__(
        self,
        robot: Robot,
        task: StandTask,
        point: Tool,
        kp: ArrayLike | None,
        kd: ArrayLike | None,
    ) -> None:
        self._robot, self._task, self._point = robot, task, point
        self._kp, self._kd = kp, kd
        model_with_servos(robot, kp, kd)  # refuses what cannot be driven
        self._last = 0.0, self._at(0.0)

    def bounds(self) -> dict[str, Bound]:
        """Returns the bounds {name: bound} by the stand, the motors and the servos."""
        asked = {"stance": self.stance, "motors": self.motors, "servos": self.spectrum}
        low = dict.fromkeys(asked, 0.0)
        high: dict[str, tuple[float, FailureCause]] = {}
        mass, ceiling = 0.0, UNLIMITED_MASS_RATIO * self._robot.total_mass
        while len(high) < len(asked) and "stance" not in high and mass < ceiling:
            for name in [name for name in asked if name not in high]:
                found = asked[name](mass)
                if found is None:
                    low[name] = mass
                else:
                    high[name] = mass, found
                    if name == "stance":
                        break
            if high:
                ceiling = min(ceiling, MAX_BOUND_RATIO * max(mass, self._robot.total_mass))
            step = _GROWTH if not high else _FASTER
            mass = max(step * mass, _FIRST * self._robot.total_mass)
        none = Bound(math.inf, Failure.NOTHING, ())
        bounds = {
            name: _bisect(asked[name], low[name], *high[name], BOUND_RTOL * high[name][0])
            if name in high
            else none
            for name in asked
        }
        bounds["servos"] = self._confirmed(bounds)
        first = min(bounds, key=lambda name: bounds[name].mass)
        near = bounds[first].mass
        if 0 < near < math.inf and first != "servos":  # whose edge is a doubling time
            above = min(high[first][0], near * (1 + 2 * BOUND_RTOL))
            found = asked[first](above) or (bounds[first].failure, bounds[first].where)
            bounds[first] = _bisect(asked[first], near, above, found, BINDING_BOUND_RTOL * near)
        return bounds

    def at(self, mass: float) -> _Held:
        """Returns how it stands with a mass (kg); one is kept: fifty robots are half a gigabyte."""
        if self._last[0] != mass:
            self._last = mass, self._at(mass)
        return self._last[1]

    def _at(self, mass: float) -> _Held:
        """Puts a mass on the robot (kg)."""
        try:
            return _Held(*solve_loaded_stand(self._robot, self._task, mass, self._point), None)
        except StanceUnreachableError as error:
            where = [*error.shortfall, *(one.subject.name for one in error.blocked if one.subject)]
            return _Held(self._robot, None, (Failure.REACH, tuple(where)))
        except StaticsInfeasibleError as error:
            needed = error.friction_needed
            slides = needed is not None and needed <= _GRIPLESS
            failure = Failure.SLIDING if slides else Failure.TIPPING
            return _Held(self._robot, None, (failure, error.feet))
        except NotSettlingError:  # it almost tips
            return _Held(self._robot, None, (Failure.TIPPING, ()))

    def stance(self, mass: float) -> FailureCause:
        """Tells why there is no loaded stand with a mass (kg)."""
        held = self.at(mass)
        if held.stand is None or held.statics is None:
            return held.trouble
        stand = held.stand
        with lend(held.robot, SearchContext) as context:
            shapes = context.shapes
            # As the parts are, which in reach may sink as their own feet do.
            there = shapes.move_to(stand.qpos), stand.task.ground, stand.rigid_targets
            lowest = shapes.lowest_part(*there, {})
        return None if lowest is None or lowest.distance > 0 else (Failure.GROUND, lowest.links)

    def motors(self, mass: float) -> FailureCause:
        """Tells which motors are beyond their limits with a mass (kg)."""
        statics = self.at(mass).statics
        over = () if statics is None else find_overloaded_motors(statics)
        return (Failure.MOTOR, over) if over else None

    def _confirmed(self, bounds: dict[str, Bound]) -> Bound:
        """Return the bound of the servos, after simulations just below and just above.

        The spectrum gives the bound in milliseconds per mass; it is searched again by simulations
        (``servos``) only if they disagree.
        """
        found, others = bounds["servos"], [bounds["stance"].mass, bounds["motors"].mass]
        if found.failure is Failure.COMMAND or found.mass == 0:
            return found
        most = min(found.mass, *others)
        if not 0 < most < math.inf:
            return found
        below = (1 - BOUND_RTOL) * most
        if (trouble := self.servos(below)) is not None:
            if self.servos(0.0) is not None:
                return Bound(0.0, *trouble)
            return _bisect(self.servos, 0.0, below, trouble, BOUND_RTOL * below, SIMULATION_RTOL)
        if found.mass > most:
            return found
        low, high = found.mass, (1 + SIMULATION_RTOL) * found.mass
        while (trouble := self.servos(high)) is None:
            low, high = high, _GROWTH * high
            if high > min(others):
                return Bound(math.inf, Failure.NOTHING, ())
        return _bisect(self.servos, low, high, trouble, SIMULATION_RTOL * low)

    def spectrum(self, mass: float) -> FailureCause:
        """Return why servos do not hold a mass (kg) by the spectrum alone; see ``servos``.

        Modes that dry friction hides are left out, and modes that depend on the finite-difference
        step: only a simulation decides on both.
        """
        return self.servos(mass, simulated=False)

    def servos(self, mass: float, *, simulated: bool = True) -> FailureCause:
        """Return why servos do not hold a mass (kg): a command out of range, or a mode that grows.

        Motors are taken to be as strong as needed: a motor that saturates has no stiffness, and is
        a bound of its own.
        """
        held = self.at(mass)
        if held.stand is None or held.statics is None:
            return None
        begun = make_stand_start(held.robot, held.stand, kp=self._kp, kd=self._kd)
        drive, names = begun.drive, held.robot.joint_names
        lead = compute_command_lead(held.statics.joint_torques, drive.kp)
        target = held.stand.joint_positions(held.robot) + lead
        low, high = command_ranges(held.robot).T
        if (beyond := (target < low) | (target > high)).any():
            return Failure.COMMAND, tuple(names[index] for index in np.flatnonzero(beyond))
        drive.model.actuator_forcelimited[:] = 0
        drive.model.jnt_actfrclimited[:] = 0
        evaluate = evaluate_stability if simulated else evaluate_spectrum
        leaving = evaluate(drive, begun.start, begun.ctrl).modes_growing_within()
        if not simulated:
            leaving = tuple(mode for mode in leaving if mode.repeated and not mode.freed)
        if not leaving:
            return None
        failure = Failure.SHAKING if leaving[0].shakes else Failure.BUCKLING
        return failure, leaving[0].joints
