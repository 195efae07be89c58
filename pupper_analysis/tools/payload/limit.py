"""Largest payload of a stance, and the failure that limits the payload.

`payload_limit` evaluates the loaded stance for increasing masses, bisects four bounds (stance,
motors, servos, simulation), and returns the smallest with its cause.
"""

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
    """Simulations of a loaded stand that is nudged in twelve directions.

    Attributes:
        mass: Mass of the payload (kg).
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
    """Simulate a stance with a payload, nudged as in ``simulate_nudges``.

    The simulation starts in the stand that ``stand --payload`` judges (``solve_loaded_stand``),
    with feed-forward torques for the load.

    Args:
        robot: The robot.
        stance: The stance; of a stand, its task.
        mass: Mass of the payload [kg].
        point: Place of the payload, as in ``with_payload``.
        kp: Servo stiffness [N m/rad]; the model's own by default.
        kd: Servo damping [N m s/rad]; the model's own by default.
        duration: Simulated time [s], at least 2.

    Returns:
        The outcome of the simulations.

    Raises:
        ConfigurationError: If an argument is out of its range, or the robot cannot stand.
        ModelError: If the model has no position servos, and kp and kd are not both given.
        StanceUnreachableError: If the loaded stance is out of reach.
        StaticsInfeasibleError: If no contact forces balance the loaded stance.
    """
    loaded, stand = solve_loaded_stand(robot, stance, mass, point)
    trial = simulate_nudges(loaded, stand, kp=kp, kd=kd, duration=duration)
    return PayloadTrial(**vars(trial), mass=float(mass))


Array = NDArray[np.float64]

UNLIMITED_MASS_RATIO = 1e4
"""Payload relative to the robot's mass at which the search ends: no bound up to there means no
limit. Chosen, not tuned."""

MAX_BOUND_RATIO = 10.0
"""Largest searched mass, relative to the first mass that fails or the robot's mass, if larger:
larger bounds are reported as infinite. Chosen, not tuned."""

VERIFIED_FRACTION = 0.97
"""Fraction of the limit with which the loaded stance is judged, and simulated with nudges: below
the limit, since no servo, floor or hand is exact to a percent. Chosen, not tuned."""

SIMULATION_RTOL = 0.02
"""Relative tolerance of a mass bisected by simulations, if the limit of the equilibrium does not
hold. The squared value, relative to the limit of the equilibrium, is the absolute tolerance.
Chosen, not tuned."""

BINDING_BOUND_RTOL, BOUND_RTOL = 1e-6, 1e-3
"""Relative tolerances of the binding bound (rounded down) and of the other bounds of motors and
stance. Chosen, not tuned."""

_FIRST_MASS_RATIO = 0.25
"""First evaluated mass, relative to the robot's mass. Chosen, not tuned."""

_MASS_GROWTH = 1.5
"""Factor between successive masses before the first bound: a narrower window of failure may be
missed. Chosen, not tuned."""

_FAST_MASS_GROWTH = 3.0
"""Factor between successive masses beyond the first bound. Chosen, not tuned."""

_MAX_FRICTION_NEEDED = 10.0
"""Largest friction coefficient of a stance that slides; if more is needed, the stance tips. Chosen,
not tuned."""


@dataclass(frozen=True, eq=False)
class Bound(Result):
    """One bound of a payload.

    Attributes:
        mass: Largest mass below the bound (kg); infinite without a bound, or if the bound is larger
            than all searched masses (``MAX_BOUND_RATIO``).
        failure: Failure above the bound.
        where: Motors, joints, feet or bodies of the failure.
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
        """{joint: motor torque [N m] in the loaded stand, ``stand``}."""
        return dict(zip(self.joint_names, self.joint_torques.tolist(), strict=True))

    @property
    def bounds(self) -> dict[str, Bound]:
        """Bounds of the payload, {name: bound}, sorted by mass, the smallest first.

        The names are ``stance``, ``motors``, ``servos`` and ``simulation``.
        """
        names = ("stance", "motors", "servos", "simulation")
        bounds: dict[str, Bound] = {name: getattr(self, name) for name in names}
        return dict(sorted(bounds.items(), key=lambda item: item[1].mass))

    @property
    def failure(self) -> Failure:
        """Kind of failure above the binding (smallest) bound."""
        return self.bounds[self.binding].failure

    @property
    def where(self) -> tuple[str, ...]:
        """Names of the motors, joints, feet or bodies that fail above the binding bound."""
        return self.bounds[self.binding].where

    @property
    def passed(self) -> bool:
        """Whether the robot carries a known payload: ``mass`` > 0, and its simulations hold.

        False if the mass is unknown (NaN).
        """
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
    """Find the largest point mass that a robot can carry in a stance.

    The result is the largest mass with which ``stand --payload`` holds. For each mass the loaded
    stance is solved on the simulated ground; if the task requires the CoM above the feet, the base
    shifts. Servos are commanded the pose with the feed-forward torques of the loaded robot. The
    limit of the equilibria is then judged as by ``stand``, and simulated with nudges in twelve
    directions; if either fails, a smaller mass is bisected by simulation.

    Args:
        robot: The robot.
        stance: The stance; of a stand, its task. The nominal stand by default.
        point: Place of the mass, as in ``with_payload``.
        kp: Servo stiffness [N m/rad], a scalar or (nu,); the model's own by default.
        kd: Servo damping [N m s/rad], a scalar or (nu,); the model's own by default.

    Returns:
        The limit with its bounds and assumptions.

    Raises:
        StanceUnreachableError: If the stance is out of reach without payload.
        StaticsInfeasibleError: If the stance slides or tips without payload.
        ConfigurationError: If an argument is out of its range, or invalid for the robot.
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
    search = _PayloadSearch(robot, task, place, kp, kd)
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
        simulation = _bisect_simulation_bound(most, judged, tried)
    bounds["simulation"] = simulation
    if simulation.mass < most:
        binding, most = "simulation", simulation.mass
    carries = 0 < most < math.inf
    held = search.stand_with(most if math.isfinite(most) else 0.0)
    unknown = _find_unknown_limits(robot, place)
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


def _find_unknown_limits(robot: Robot, place: Tool) -> tuple[str, ...]:
    """Return the joints that carry a foot or the payload and whose torque limit no file states."""
    unloaded_joints = set(free_joints(robot)) - set(place.chain)
    unknown = (
        limit.joint for limit in list_driven_limits(robot) if limit.code is EffortCode.UNKNOWN
    )
    return tuple(name for name in unknown if name not in unloaded_joints)


FailureCause = tuple[Failure, tuple[str, ...]] | None
"""Failure with its motors, joints, feet or bodies; None without a failure."""


def _bisect_simulation_bound(
    static_limit: float, judged: Callable[[float], Verdict], tried: Callable[[float], PayloadTrial]
) -> Bound:
    """Return the largest mass of which ``VERIFIED_FRACTION`` holds in simulation.

    The bound is infinite if ``static_limit`` holds, and 0 if the stance fails without payload.
    Equilibria are exact for an undisturbed stand. Lifting feet, pivoting soles and saturating
    motors after a nudge, and errors of the files, appear only in a simulation.
    """

    def find_cause(mass: float) -> FailureCause:
        trial = tried(VERIFIED_FRACTION * mass)
        if trial.failure is not None:
            return trial.failure, trial.where
        return (
            None
            if _holds_in_simulation(judged(VERIFIED_FRACTION * mass))
            else (Failure.SIMULATED, ())
        )

    cause = find_cause(static_limit)
    if cause is None:
        return Bound(math.inf, Failure.NOTHING, ())
    if not _holds_in_simulation(judged(0.0)):
        return Bound(0.0, Failure.UNLOADED, ())
    return _bisect_mass(
        find_cause, 0.0, static_limit, cause, SIMULATION_RTOL**2 * static_limit, SIMULATION_RTOL
    )


def _holds_in_simulation(verdict: Verdict) -> bool:
    """Return True if a stance holds in simulation, even if torque limits or masses are unknown."""
    return verdict.passed or verdict.code in UNKNOWN_CODES


def _bisect_mass(
    find_cause: Callable[[float], FailureCause],
    low: float,
    high: float,
    cause: FailureCause,
    tolerance: float,
    relative_tolerance: float = 0.0,
) -> Bound:
    """Return the largest mass without a failure, by bisection, with the failure above.

    Args:
        find_cause: Function that returns the failure with a mass [kg].
        low: Mass without a failure [kg].
        high: Mass with a failure [kg].
        cause: Failure with ``high``.
        tolerance: Absolute tolerance [kg].
        relative_tolerance: Tolerance relative to the lower end, if larger.
    """
    assert cause is not None
    while high - low > max(tolerance, relative_tolerance * low):
        middle = (low + high) / 2
        if (other := find_cause(middle)) is None:
            low = middle
        else:
            high, cause = middle, other
    return Bound(low, *cause)


@dataclass(frozen=True, eq=False)
class _LoadedStand:
    """Loaded stand, or the cause if there is none."""

    robot: Robot
    stand: Stand | None
    cause: FailureCause

    @cached_property
    def statics(self) -> GravityCompensation | None:
        """Torques and contact forces of the stand with the trial payload; None without a stand."""
        return None if self.stand is None else stand_statics(self.robot, self.stand)


class _PayloadSearch:
    """Search for the mass at which each bound fails."""

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
        self._last = 0.0, self._solve_stand(0.0)

    def bounds(self) -> dict[str, Bound]:
        """Return the bounds {name: bound} of stance, motors and servos."""
        find_causes = {"stance": self.stance, "motors": self.motors, "servos": self.spectrum}
        low = dict.fromkeys(find_causes, 0.0)
        high: dict[str, tuple[float, FailureCause]] = {}
        mass, ceiling = 0.0, UNLIMITED_MASS_RATIO * self._robot.total_mass
        while len(high) < len(find_causes) and "stance" not in high and mass < ceiling:
            for name in [name for name in find_causes if name not in high]:
                cause = find_causes[name](mass)
                if cause is None:
                    low[name] = mass
                else:
                    high[name] = mass, cause
                    if name == "stance":
                        break
            if high:
                ceiling = min(ceiling, MAX_BOUND_RATIO * max(mass, self._robot.total_mass))
            step = _MASS_GROWTH if not high else _FAST_MASS_GROWTH
            mass = max(step * mass, _FIRST_MASS_RATIO * self._robot.total_mass)
        unlimited = Bound(math.inf, Failure.NOTHING, ())
        bounds = {
            name: _bisect_mass(
                find_causes[name], low[name], *high[name], BOUND_RTOL * high[name][0]
            )
            if name in high
            else unlimited
            for name in find_causes
        }
        bounds["servos"] = self._confirm_servo_bound(bounds)
        first = min(bounds, key=lambda name: bounds[name].mass)
        mass_limit = bounds[first].mass
        if 0 < mass_limit < math.inf and first != "servos":  # whose edge is a doubling time
            above = min(high[first][0], mass_limit * (1 + 2 * BOUND_RTOL))
            cause = find_causes[first](above) or (bounds[first].failure, bounds[first].where)
            bounds[first] = _bisect_mass(
                find_causes[first], mass_limit, above, cause, BINDING_BOUND_RTOL * mass_limit
            )
        return bounds

    def stand_with(self, mass: float) -> _LoadedStand:
        """Return the loaded stand with a mass [kg]; only the last one is cached, to save memory."""
        if self._last[0] != mass:
            self._last = mass, self._solve_stand(mass)
        return self._last[1]

    def _solve_stand(self, mass: float) -> _LoadedStand:
        """Solve the loaded stand with a mass [kg]."""
        try:
            return _LoadedStand(
                *solve_loaded_stand(self._robot, self._task, mass, self._point), None
            )
        except StanceUnreachableError as error:
            where = [*error.shortfall, *(one.subject.name for one in error.blocked if one.subject)]
            return _LoadedStand(self._robot, None, (Failure.REACH, tuple(where)))
        except StaticsInfeasibleError as error:
            needed = error.friction_needed
            slides = needed is not None and needed <= _MAX_FRICTION_NEEDED
            failure = Failure.SLIDING if slides else Failure.TIPPING
            return _LoadedStand(self._robot, None, (failure, error.feet))
        except NotSettlingError:  # it almost tips
            return _LoadedStand(self._robot, None, (Failure.TIPPING, ()))

    def stance(self, mass: float) -> FailureCause:
        """Return why there is no loaded stand with a mass [kg]; None if there is one."""
        loaded = self.stand_with(mass)
        if loaded.stand is None or loaded.statics is None:
            return loaded.cause
        stand = loaded.stand
        with lend(loaded.robot, SearchContext) as context:
            shapes = context.shapes
            # Parts at their actual positions, without the penetration that feet have.
            geometry = shapes.move_to(stand.qpos), stand.task.ground, stand.rigid_targets
            lowest = shapes.lowest_part(*geometry, {})
        return None if lowest is None or lowest.distance > 0 else (Failure.GROUND, lowest.links)

    def motors(self, mass: float) -> FailureCause:
        """Return the motors above their limits with a mass [kg]; None if there are none."""
        statics = self.stand_with(mass).statics
        overloaded = () if statics is None else find_overloaded_motors(statics)
        return (Failure.MOTOR, overloaded) if overloaded else None

    def _confirm_servo_bound(self, bounds: dict[str, Bound]) -> Bound:
        """Return the bound of the servos, after simulations just below and just above.

        The spectrum gives the bound in milliseconds per mass; it is searched again by simulations
        (``servos``) only if they disagree.
        """
        bound, other_masses = bounds["servos"], [bounds["stance"].mass, bounds["motors"].mass]
        if bound.failure is Failure.COMMAND or bound.mass == 0:
            return bound
        most = min(bound.mass, *other_masses)
        if not 0 < most < math.inf:
            return bound
        below = (1 - BOUND_RTOL) * most
        if (cause := self.servos(below)) is not None:
            if self.servos(0.0) is not None:
                return Bound(0.0, *cause)
            return _bisect_mass(self.servos, 0.0, below, cause, BOUND_RTOL * below, SIMULATION_RTOL)
        if bound.mass > most:
            return bound
        low, high = bound.mass, (1 + SIMULATION_RTOL) * bound.mass
        while (cause := self.servos(high)) is None:
            low, high = high, _MASS_GROWTH * high
            if high > min(other_masses):
                return Bound(math.inf, Failure.NOTHING, ())
        return _bisect_mass(self.servos, low, high, cause, SIMULATION_RTOL * low)

    def spectrum(self, mass: float) -> FailureCause:
        """Return why the servos do not hold a mass [kg], from the linearised dynamics only.

        The reasons are those of ``servos``, without simulation. Modes that dry friction hides are
        omitted, and modes that depend on the finite-difference step: only a simulation decides on
        both.
        """
        return self.servos(mass, simulated=False)

    def servos(self, mass: float, *, simulated: bool = True) -> FailureCause:
        """Return why servos do not hold a mass [kg]: a command out of range, or a mode that grows.

        Motor torques are unlimited here: a saturated motor has no stiffness, and is a bound of its
        own.
        """
        loaded = self.stand_with(mass)
        if loaded.stand is None or loaded.statics is None:
            return None
        start = make_stand_start(loaded.robot, loaded.stand, kp=self._kp, kd=self._kd)
        drive, names = start.drive, loaded.robot.joint_names
        lead = compute_command_lead(loaded.statics.joint_torques, drive.kp)
        target = loaded.stand.joint_positions(loaded.robot) + lead
        low, high = command_ranges(loaded.robot).T
        if (beyond := (target < low) | (target > high)).any():
            return Failure.COMMAND, tuple(names[index] for index in np.flatnonzero(beyond))
        drive.model.actuator_forcelimited[:] = 0
        drive.model.jnt_actfrclimited[:] = 0
        evaluate = evaluate_stability if simulated else evaluate_spectrum
        leaving = evaluate(drive, start.start, start.ctrl).modes_growing_within()
        if not simulated:
            leaving = tuple(mode for mode in leaving if mode.repeated and not mode.freed)
        if not leaving:
            return None
        failure = Failure.SHAKING if leaving[0].shakes else Failure.BUCKLING
        return failure, leaving[0].joints
