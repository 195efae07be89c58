"""Largest payload of a stance, and the failure that limits the payload.

`payload_limit` solves the loaded stance for increasing masses, and bisects the masses at which the
stance, the motors and the servos fail. The smallest of these bounds is verified by simulation. The
result is the smallest bound with the cause. `simulate_payload` simulates a single mass.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.errors import (
    ConfigurationError,
    NotSettlingError,
    StanceUnreachableError,
    StaticsInfeasibleError,
)
from pupper_analysis.base.results import Result, Tabular
from pupper_analysis.base.units import EFFORT_UNIT
from pupper_analysis.models.efforts import EffortCode
from pupper_analysis.prepare.judge import judge_simulation, judge_stand
from pupper_analysis.prepare.limits import list_driven_limits, list_overloaded_joints
from pupper_analysis.robot.joints import find_footless_joints
from pupper_analysis.robot.robot import Robot, borrow, describe_unstated_efforts
from pupper_analysis.robot.servos import command_ranges, compute_command_lead, model_with_servos
from pupper_analysis.robot.stability import HOLD_DURATION
from pupper_analysis.robot.tool import FramePoint, Tool, find_place, with_payload
from pupper_analysis.robot.touching import with_contacts
from pupper_analysis.simulation.alone import find_mass_by_commands_alone
from pupper_analysis.simulation.mass_bound import (
    TOLERANCE_FACTOR,
    bisect_mass,
    find_holding_mass,
)
from pupper_analysis.simulation.rollout import make_stand_start
from pupper_analysis.simulation.stability import evaluate_spectrum, evaluate_stability
from pupper_analysis.simulation.trial import Failure, NudgeTrial, simulate_nudges
from pupper_analysis.simulation.verdict import (
    UNKNOWN_CODES,
    Ending,
    Question,
    Verdict,
    VerdictCode,
    find_overloaded_motors,
)
from pupper_analysis.simulation.verify import StandVerification, verify_stand
from pupper_analysis.stance.soft_ground import solve_loaded_stand, solve_stand_as_simulated
from pupper_analysis.stance.solver import SearchContext
from pupper_analysis.stance.stand import Stand, solve_stand, stand_statics
from pupper_analysis.stance.task import StandTask
from pupper_analysis.statics.equilibrium import (
    UNLIMITED_MASS_RATIO,
    GravityCompensation,
    compute_reference_mass,
)


@dataclass(frozen=True, eq=False)
class PayloadTrial(NudgeTrial):
    """Simulations of a stand with a payload, one for each of twelve nudges of the base.

    Attributes:
        mass: Mass of the payload [kg].
    """

    mass: float = field(metadata={"unit": "kg"})


@check_arguments
def simulate_payload(
    robot: Robot,
    stance: StandTask | Stand,
    mass: float,
    point: FramePoint = (0.0, 0.0, 0.0),
    *,
    kp: ArrayLike | None = None,
    kd: ArrayLike | None = None,
    duration: float = HOLD_DURATION,
    until_failure: bool = False,
) -> PayloadTrial:
    """Simulate a stance with a payload after each of twelve nudges of the base.

    A nudge is a small initial velocity of the base (``simulate_nudges``). The servos have
    feed-forward torques for the load.

    Args:
        robot: The robot.
        stance: Stand task, or a stand, of which only the task is used.
        mass: Mass of the payload [kg].
        point: Position of the payload [m] in the frame of the base, or of a named link, site, body
            or geom, as in ``with_payload``.
        kp: Servo stiffness [N m/rad, N/m], scalar or shape (nu,); the model's own by default.
        kd: Servo damping [N m s/rad, N s/m], scalar or shape (nu,); the model's own by default.
        duration: Simulated time after each nudge [s], 2 to 600. A simulation ends earlier if its
            outcome is known.
        until_failure: Whether to end all simulations once the earliest failure is known.

    Returns:
        The outcome of the simulations.

    Raises:
        StanceUnreachableError: If the loaded stance is out of reach.
        StaticsInfeasibleError: If no contact forces balance the loaded stance.
    """
    loaded, stand = solve_loaded_stand(robot, stance, mass, point)
    trial = simulate_nudges(
        loaded, stand, kp=kp, kd=kd, duration=duration, until_failure=until_failure
    )
    return PayloadTrial(**vars(trial), mass=float(mass))


MAX_BOUND_RATIO = 10.0
"""Factor [1] on the larger of the robot's mass and the first payload that fails by one of three
criteria (stance, motors, servos). The search for the bounds of the other criteria ends at the
product at the latest. If a simulation refutes a servo bound of 0, the next simulated mass is at
most this factor times the robot's mass. Chosen, not tuned.
"""

FAILING_RATIO = 1.03
"""Ratio [1] of the payload that `_raise_servo_bound` simulates first to the payload bound of the
servos. If the robot holds this payload in simulation, the bound was too small and is raised.
Chosen, not tuned.
"""

LONG_SIMULATION_RTOL = 0.02
"""Relative tolerance [1] of the bisections in which simulations of 12 s decide: the payload bound
of the servos, and the payload with position commands alone. Also the relative distance from the
servo bound to a larger mass at which `_confirm_servo_bound` evaluates the stability. Chosen, not
tuned.
"""

BINDING_BOUND_RTOL, BOUND_RTOL = 1e-6, 1e-3
"""Relative tolerances [1] of the bisected payload bounds of stance, motors and servos.
``BINDING_BOUND_RTOL`` applies to the smallest bound, unless the servos set it. ``SIMULATION_RTOL``
and `LONG_SIMULATION_RTOL` apply to bounds that simulations correct. Chosen, not tuned.
"""

_FIRST_MASS_RATIO = 0.25
"""First evaluated mass above 0, relative to the robot's mass. Chosen, not tuned."""

_MASS_GROWTH = 1.5
"""Factor [1] between successive payload masses before the first failure, and in searches for a
failing mass above a known bound. A failure that occurs only in a narrower interval of masses may be
missed. Chosen, not tuned.
"""

_FAST_MASS_GROWTH = 3.0
"""Factor between successive payload masses after the first of three criteria (stance, motors,
servos) has failed. The mass still grows, to find the bounds of the other criteria. Chosen, not
tuned."""

_MAX_FRICTION_NEEDED = 10.0
"""Largest friction coefficient [1] with which a stance that fails would be in balance, at which the
failure is called sliding. If balance needs more friction, or is impossible with any friction, the
failure is called tipping. Chosen, not tuned.
"""


@dataclass(frozen=True, eq=False)
class Bound(Result):
    """Largest payload [kg] that one kind of failure permits: stance, motors, servos, simulation.

    Attributes:
        mass: Largest mass below the bound [kg]; infinite without a bound, or if the bound is larger
            than all searched masses (``MAX_BOUND_RATIO``).
        failure: Failure above the bound.
        failing_parts: Motors, joints, feet or bodies of the failure.
    """

    mass: float = field(metadata={"unit": "kg"})
    failure: Failure
    failing_parts: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class PayloadLimit(Tabular):
    """Largest payload of a stance, with bounds and assumptions.

    The values belong to the loaded stand (``solve_loaded_stand``): the mass is welded to the robot,
    the CoM is at the place that the task requires, and the feet penetrate the simulated ground.

    Attributes:
        name: Name of the robot.
        mass: Largest payload [kg], equal to ``upper_bound``; not a number if ``code`` is
            ``unknown`` and ``upper_bound`` is not 0.
        upper_bound: Smallest of the four bounds [kg]; motors with an unknown torque limit set no
            bound.
        code: ``unknown`` if a loaded motor has an unknown torque limit, or if the stance holds and
            a moving link has an unknown mass; else ``zero`` if a motor has no torque, else
            ``stated``.
        binding: Name of the smallest bound: ``stance``, ``motors``, ``servos`` or ``simulation``.
        stance: Bound of the stance: a larger mass has no loaded stand within reach and in balance,
            or brings another part of the robot to the ground.
        motors: Bound of the motors: a larger mass needs a torque above the limit of a motor. The
            contact forces are those with the smallest tangential components.
        servos: Bound of the servos if torque limits are ignored: with a larger mass, a servo
            command exceeds the range, or a deviation leaves the stand within 12 s.
        simulation: Bound of the simulation: the largest simulated mass with which the stance holds,
            also after nudges of the base. Infinite if the smallest of the other bounds holds in
            simulation, or is 0 or infinite. 0 if the stance fails without payload.
        point: (3,) position of the payload in the frame of ``link`` [m].
        link: Link of the URDF with the payload.
        unknown_limits: Motors that carry the load and whose torque limit is unknown.
        stand: Loaded stand with ``upper_bound``; stand without payload if ``upper_bound`` is
            infinite.
        offset: (2,) position of the base of ``stand`` from the centre of the feet, as
            ``StandTask.offset`` [m].
        joint_names: (nu,) joints, in actuator order.
        joint_torques: (nu,) motor torques or forces in ``stand`` (N m or N).
        torque_units: (nu,) unit of each torque: N m for a hinge, N for a slide.
        contact_forces: {foot: (3,)} contact forces in ``stand``, in world axes [N].
        verdict: Verdict of the stance with ``upper_bound``; without payload if ``upper_bound`` is 0
            or infinite.
        trial: Simulation with the mass of ``verdict`` and twelve nudges of the base; None if
            ``upper_bound`` is 0 or infinite.
        continuous: Joints whose effort limit is a continuous torque; the limits of the other joints
            are peak torques.
        weak_motors: Named motors that cannot exert the torques of ``stand`` even for moments.
        carried: Mass of the payload of the command line [kg] (``--payload``), to which all results
            are additional.
        mass_by_commands_alone: Largest simulated payload with which the stance holds with position
            commands alone, without feed-forward torques [kg]; not a number if not computed.
        failures_alone: Failures of the smallest simulated payload that does not hold with position
            commands alone; empty if not computed.
        motor_utilisation: (nu,) ratio of motor torque to torque limit in ``stand``; not a number
            for an unknown limit.
    """

    _key_fields: ClassVar[tuple[str, ...]] = ("mass", "binding", "code")
    _warnings: ClassVar[tuple[str, ...]] = ("unknown_reasons",)

    name: str
    mass: float = field(metadata={"unit": "kg"})
    upper_bound: float = field(metadata={"unit": "kg"})
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
    joint_torques: Array = field(metadata={"unit": EFFORT_UNIT})
    torque_units: tuple[str, ...]
    contact_forces: dict[str, Array] = field(metadata={"unit": "N"})
    verdict: Verdict
    trial: PayloadTrial | None
    continuous: tuple[str, ...] = ()
    weak_motors: tuple[Diagnostic, ...] = ()
    carried: float = field(default=0.0, metadata={"unit": "kg"})
    mass_by_commands_alone: float = field(default=math.nan, metadata={"unit": "kg"})
    failures_alone: tuple[Diagnostic, ...] = ()
    motor_utilisation: Array = field(default_factory=lambda: np.empty(0), metadata={"unit": "1"})

    @property
    def torque_by_joint(self) -> dict[str, float]:
        """{joint: static motor torque [N m or N] in ``stand``}."""
        return dict(zip(self.joint_names, self.joint_torques.tolist(), strict=True))

    def _columns(self) -> dict[str, list[object]]:
        """Return {column: values} of a table with a row per bound, the smallest mass first."""
        bounds = self.bounds
        return {
            "bound": [*bounds],
            "mass": [bound.mass for bound in bounds.values()],
            "failure": [str(bound.failure) for bound in bounds.values()],
            "failing_parts": [bound.failing_parts for bound in bounds.values()],
        }

    def get_torque_unit(self, joint: str) -> str:
        """Return the unit of the motor torque of a joint: N m for a hinge, N for a slide."""
        return self.torque_units[self.joint_names.index(joint)]

    @property
    def bounds(self) -> dict[str, Bound]:
        """Bounds of the payload, ``{name: bound with mass in kg}``, the smallest mass first.

        The names are ``stance``, ``motors``, ``servos`` and ``simulation``.
        """
        names = ("stance", "motors", "servos", "simulation")
        bounds: dict[str, Bound] = {name: getattr(self, name) for name in names}
        return dict(sorted(bounds.items(), key=lambda item: item[1].mass))

    @property
    def unknown_reasons(self) -> tuple[Diagnostic, ...]:
        """Reasons why ``mass`` is not a number: unknown torque limits, or links without valid mass.

        Empty if ``mass`` is known.
        """
        if not math.isnan(self.mass):
            return ()
        limits = self.unknown_limits
        remarks = (note for note in self.verdict.remarks if note.code == "link-masses-unknown")
        return (*((describe_unstated_efforts(limits),) if limits else ()), *remarks)

    @property
    def failure(self) -> Failure:
        """Kind of failure that occurs if the payload exceeds the limit."""
        return self.bounds[self.binding].failure

    @property
    def failing_parts(self) -> tuple[str, ...]:
        """Names of motors, joints, feet or bodies that fail if the payload exceeds the limit."""
        return self.bounds[self.binding].failing_parts

    @property
    def depends_on_feedforward(self) -> bool:
        """Whether the stance with the payload fails in simulation with position commands alone.

        False if that stance was not simulated, for example because the stance fails anyway.
        """
        return self.verdict.commands_alone not in (None, Ending.HOLDS)

    @property
    def passed(self) -> bool:
        """Whether the largest payload is known and positive, and the stance holds in simulation."""
        return self.mass > 0 and self.verdict.passed and (self.trial is None or self.trial.survived)


@check_arguments
def payload_limit(
    robot: Robot,
    stance: StandTask | Stand | None = None,
    point: FramePoint = (0.0, 0.0, 0.0),
    *,
    kp: ArrayLike | None = None,
    kd: ArrayLike | None = None,
    commands_alone: bool = False,
) -> PayloadLimit:
    """Find the largest point mass that a robot can carry in a stance.

    For each mass the loaded stance is solved on the simulated ground, with feed-forward for the
    loaded robot. If the smallest bound is positive and finite, the stance with this mass is judged
    and simulated with twelve nudges of the base. If the stance fails, the largest mass that holds
    is bisected by simulations. The result is therefore a mass that holds in simulation.

    Args:
        robot: The robot.
        stance: Stand task, or a stand, of which only the task is used. Default: the nominal stand.
        point: Position of the mass [m] in the frame of the base, or of a named link, site, body or
            geom, as in ``with_payload``.
        kp: Servo stiffness [N m/rad, N/m], scalar or shape (nu,); the model's own by default.
        kd: Servo damping [N m s/rad, N s/m], scalar or shape (nu,); the model's own by default.
        commands_alone: Whether to compute also ``mass_by_commands_alone``, the payload without
            feed-forward torques, if this is smaller. Requires further simulations.

    Returns:
        The limit with bounds and assumptions.

    Raises:
        StanceUnreachableError: If the stance is out of reach without payload.
        StaticsInfeasibleError: If the stance slides or tips without payload.
        NotSettlingError: If the penetration depths of a robot without loops and couplings do not
            converge without payload.
        ConfigurationError: If an argument is out of range or invalid for the robot, for example a
            payload on a base that is fixed.
        ModelError: If a joint has no motor, or no position servo while kp and kd are not both
            given, or if the loaded model cannot be built, for example.
        UnknownNameError: If the task names a foot, joint or contact, or ``point`` a frame, that the
            robot does not have.
    """
    place = find_place(robot, point)
    if isinstance(stance, Stand):
        robot = stance.check(robot)
        task = stance.task
    else:
        task = stance or StandTask()
        robot = with_contacts(robot, task.contacts)
    if robot.floating and robot.is_base_fixed and not place.chain:
        raise ConfigurationError("point", diagnose("payload-on-fixed-base", robot=robot.name))
    # Raise, with an explanation, if the stance has no stand without payload.
    stand_statics(robot, solve_stand_as_simulated(robot, solve_stand(robot, task)))
    search = _PayloadSearch(robot, task, place, kp, kd)
    simulations = _PayloadSimulations(robot, task, place, kp, kd)
    bounds = _add_simulated_bounds(search.find_bounds(), simulations)
    limit = _make_payload_limit(robot, place, bounds, search, simulations)
    if commands_alone and limit.passed and limit.depends_on_feedforward:
        mass = find_mass_by_commands_alone(
            simulations.simulate_commands_alone,
            limit.upper_bound,
            LONG_SIMULATION_RTOL**2 * limit.upper_bound,
            LONG_SIMULATION_RTOL,
        )
        failures = simulations.find_failures_alone(mass) or limit.verdict.failures_alone
        limit = replace(limit, mass_by_commands_alone=mass, failures_alone=failures)
    return limit


def _find_binding(bounds: Mapping[str, Bound]) -> str:
    """Return the name of the smallest payload bound ("motors", ...)."""
    return min(bounds, key=lambda name: bounds[name].mass)


def _add_simulated_bounds(
    bounds: Mapping[str, Bound], simulations: _PayloadSimulations
) -> dict[str, Bound]:
    """Add the bound ``simulation`` to the payload bounds of stance, motors and servos [kg].

    Simulations may also raise the bound of the servos.
    """
    completed = dict(bounds)
    if _find_binding(completed) == "servos":
        completed["servos"] = _raise_servo_bound(completed, simulations.holds)
    static_limit = completed[_find_binding(completed)].mass
    completed["simulation"] = (
        _bisect_simulation_bound(static_limit, simulations)
        if 0 < static_limit < math.inf
        else Bound(math.inf, Failure.NOTHING, ())
    )
    return completed


def _make_payload_limit(
    robot: Robot,
    place: Tool,
    bounds: Mapping[str, Bound],
    search: _PayloadSearch,
    simulations: _PayloadSimulations,
) -> PayloadLimit:
    """Create the result from the payload bounds, with stand, verdict and nudged simulation."""
    binding = _find_binding(bounds)
    mass_limit = bounds[binding].mass
    has_finite_limit = 0 < mass_limit < math.inf
    loaded_stand = search.get_loaded_stand(mass_limit if math.isfinite(mass_limit) else 0.0)
    unknown_limits = _find_unknown_limits(robot, place)
    is_powerless = any(limit.without_torque for limit in list_driven_limits(robot))
    assert loaded_stand.stand is not None
    assert loaded_stand.statics is not None
    verdict = simulations.judge(mass_limit if has_finite_limit else 0.0)
    is_unknown = bool(unknown_limits) or verdict.code is VerdictCode.MASSES_UNKNOWN
    known_code = EffortCode.ZERO if is_powerless else EffortCode.STATED
    return PayloadLimit(
        name=robot.name,
        mass=math.nan if is_unknown and mass_limit > 0 else mass_limit,
        upper_bound=mass_limit,
        code=EffortCode.UNKNOWN if is_unknown else known_code,
        binding=binding,
        stance=bounds["stance"],
        motors=bounds["motors"],
        servos=bounds["servos"],
        simulation=bounds["simulation"],
        continuous=(),
        weak_motors=(),
        point=place.offset,
        link=place.link,
        unknown_limits=unknown_limits,
        stand=loaded_stand.stand,
        offset=loaded_stand.stand.qpos[:2] - loaded_stand.stand.centre(robot)[:2],
        joint_names=robot.joint_names,
        joint_torques=loaded_stand.statics.joint_torques,
        torque_units=loaded_stand.statics.torque_units,
        contact_forces=loaded_stand.statics.contact_forces,
        motor_utilisation=loaded_stand.statics.motor_utilisation,
        verdict=verdict,
        trial=simulations.simulate_nudged(mass_limit) if has_finite_limit else None,
    )


class _PayloadSimulations:
    """Simulations of a stance with a payload; `judge` and `simulate_nudged` cache their results."""

    def __init__(
        self,
        robot: Robot,
        task: StandTask,
        place: Tool,
        kp: ArrayLike | None,
        kd: ArrayLike | None,
    ) -> None:
        self._robot, self._task, self._place = robot, task, place
        self._kp, self._kd = kp, kd
        self._trials: dict[float, PayloadTrial] = {}
        self._verdicts: dict[float, Verdict] = {}
        self._runs_alone: dict[float, StandVerification] = {}

    def simulate_nudged(self, mass: float) -> PayloadTrial:
        """Simulate the stance with a payload [kg] and nudges, until the first failure is known."""
        if mass not in self._trials:
            robot, task, place = self._robot, self._task, self._place
            self._trials[mass] = simulate_payload(
                robot, task, mass, place, kp=self._kp, kd=self._kd, until_failure=True
            )
        return self._trials[mass]

    def judge(self, mass: float) -> Verdict:
        """Return the verdict of `judge_stand` for the stance with a payload [kg]."""
        if mass not in self._verdicts:
            loaded = with_payload(self._robot, mass, self._place)
            trial = self.simulate_nudged(mass) if mass else None
            stand = solve_stand(loaded, self._task)
            verdict = judge_stand(loaded, stand, trial=trial, kp=self._kp, kd=self._kd)
            self._verdicts[mass] = replace(verdict, question=Question.CARRIES)
        return self._verdicts[mass]

    def judge_with_feedforward(self, mass: float) -> Verdict:
        """Return the verdict of `judge_simulation` for the stance with a payload [kg].

        There is no simulation with position commands alone.
        """
        loaded = with_payload(self._robot, mass, self._place)
        stand = solve_stand(loaded, self._task)
        held = solve_stand_as_simulated(loaded, stand)
        fed = verify_stand(loaded, held, kp=self._kp, kd=self._kd, until_failure=True)
        return judge_simulation(
            loaded,
            stand,
            fed,
            statics=stand_statics(loaded, held),
            trial=self.simulate_nudged(mass) if fed.passed else None,
            kp=self._kp,
            kd=self._kd,
        )

    def simulate_commands_alone(self, mass: float) -> StandVerification | None:
        """Simulate a payload [kg] with position commands alone; None if there is no stand."""
        try:
            loaded, stand = solve_loaded_stand(self._robot, self._task, mass, self._place)
        except (StanceUnreachableError, StaticsInfeasibleError, NotSettlingError):
            return None
        run = verify_stand(
            loaded, stand, feedforward=False, kp=self._kp, kd=self._kd, until_failure=True
        )
        self._runs_alone[mass] = run
        return run

    def find_failures_alone(self, mass: float) -> tuple[Diagnostic, ...]:
        """Return the failures of the next larger payload simulated with position commands alone.

        Empty if no payload above ``mass`` [kg] was simulated.
        """
        larger = [mass_alone for mass_alone in self._runs_alone if mass_alone > mass]
        return self._runs_alone[min(larger)].failures if larger else ()

    def holds(self, mass: float) -> bool:
        """Return True if a stand with a payload [kg] exists, and holds with feed-forward."""
        try:
            return _holds_in_simulation(self.judge_with_feedforward(mass))
        except (StanceUnreachableError, StaticsInfeasibleError, NotSettlingError):
            return False


def _find_unknown_limits(robot: Robot, place: Tool) -> tuple[str, ...]:
    """Return the motor joints that may carry load and have no stated torque limit."""
    unloaded_joints = set(find_footless_joints(robot)) - set(place.chain)
    unknown_joints = (
        limit.joint for limit in list_driven_limits(robot) if limit.code is EffortCode.UNKNOWN
    )
    return tuple(joint for joint in unknown_joints if joint not in unloaded_joints)


FailureCause = tuple[Failure, tuple[str, ...]] | None
"""Kind of a failure, and names of the motors, joints, feet or bodies that fail; None without a
failure."""


def _raise_servo_bound(bounds: dict[str, Bound], holds: Callable[[float], bool]) -> Bound:
    """Return the payload bound of the servos, raised if the robot holds more mass in simulation.

    A bound that is set by a command out of range is kept.
    """
    bound = bounds["servos"]
    if not 0 < bound.mass < math.inf or bound.failure is Failure.COMMAND:
        return bound
    next_mass = min(bounds["stance"].mass, bounds["motors"].mass)
    low, high = 0.0, FAILING_RATIO * bound.mass
    while holds(high):
        low, high = high, _MASS_GROWTH * high
        if high > next_mass:
            return Bound(math.inf, Failure.NOTHING, ())
    if not low:
        return bound
    return _bisect_mass(
        lambda mass: None if holds(mass) else (bound.failure, bound.failing_parts),
        low,
        high,
        (bound.failure, bound.failing_parts),
        LONG_SIMULATION_RTOL * low,
    )


def _bisect_simulation_bound(static_limit: float, simulations: _PayloadSimulations) -> Bound:
    """Find the largest mass that holds in simulation, also after nudges of the base.

    Infinite if ``static_limit`` [kg], the smallest static bound, holds.
    """

    def find_cause(mass: float) -> FailureCause:
        """Return why a simulation with a mass [kg] fails; None if the stance holds."""
        trial = simulations.simulate_nudged(mass)
        if trial.failure is not None:
            return trial.failure, trial.failing_parts
        verdict = (
            simulations.judge(mass)
            if mass == static_limit
            else simulations.judge_with_feedforward(mass)
        )
        return None if _holds_in_simulation(verdict) else _name_failure(verdict)

    cause = find_cause(static_limit)
    if cause is None:
        return Bound(math.inf, Failure.NOTHING, ())
    if not _holds_in_simulation(simulations.judge(0.0)):
        return Bound(0.0, Failure.UNLOADED, ())
    mass, failure = find_holding_mass(find_cause, static_limit, cause)
    return Bound(mass, *failure)


def _name_failure(verdict: Verdict) -> FailureCause:
    """Return the first failure of a verdict, with its joints, if it is a mode that grows."""
    failure = next((one for one in verdict.failures if one.code in _MODE_FAILURES), None)
    if failure is None:
        return Failure.SIMULATED, ()
    joints = failure.values["joints"]
    assert isinstance(joints, tuple)
    return _MODE_FAILURES[failure.code], tuple(map(str, joints))


_MODE_FAILURES = {"mode-buckles": Failure.BUCKLING, "mode-shakes": Failure.SHAKING}
"""{code of a failure of the simulation: failure that limits the payload}."""


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
    """Bisect the payload bound between ``low`` [kg], without failure, and ``high``, with ``cause``.

    ``tolerance`` is absolute [kg], ``relative_tolerance`` relative to the lower end of the bracket;
    the larger tolerance applies.
    """
    assert cause is not None
    mass, failure = bisect_mass(find_cause, low, high, cause, tolerance, relative_tolerance)
    return Bound(mass, *failure)


@dataclass(frozen=True, eq=False)
class _LoadedStand:
    """Stand of a robot with a payload, or the reason why there is none.

    Attributes:
        robot: Robot with the payload; without a stand, the robot without payload.
        stand: Stand of the loaded robot; None if there is none.
        cause: Reason why there is no stand; None with a stand.
    """

    robot: Robot
    stand: Stand | None
    cause: FailureCause

    @cached_property
    def statics(self) -> GravityCompensation | None:
        """Static torques and forces of the loaded stand; None without a stand."""
        return None if self.stand is None else stand_statics(self.robot, self.stand)


class _PayloadSearch:
    """Search for the payloads at which stance, motors and servos begin to fail.

    Each ``find_..._failure`` method returns the failure with a payload of a given mass [kg].
    """

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
        model_with_servos(robot, kp, kd)  # raises ModelError if the robot has no servos
        self._last_stand = 0.0, self._solve_stand(0.0)

    def find_bounds(self) -> dict[str, Bound]:
        """Find the payload bounds of stance, motors and servos: {"stance": bound [kg], ...}.

        Simulations check the bound of the servos (`_confirm_servo_bound`).
        """
        find_causes = {
            "stance": self.find_stance_failure,
            "motors": self.find_motor_failure,
            "servos": self.find_spectrum_failure,
        }
        low = dict.fromkeys(find_causes, 0.0)
        high: dict[str, tuple[float, FailureCause]] = {}
        mass, ceiling = 0.0, UNLIMITED_MASS_RATIO * compute_reference_mass(self._robot)
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
            growth = _MASS_GROWTH if not high else _FAST_MASS_GROWTH
            mass = max(growth * mass, _FIRST_MASS_RATIO * self._robot.total_mass)
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
        binding = min(bounds, key=lambda name: bounds[name].mass)
        mass_limit = bounds[binding].mass
        # The bound of the servos depends on a chosen doubling time, and is not refined.
        if 0 < mass_limit < math.inf and binding != "servos":
            # At least the upper end of the bracket, whose width is relative to the failing mass.
            width = BOUND_RTOL * max(2 * mass_limit, TOLERANCE_FACTOR * high[binding][0])
            above = min(high[binding][0], mass_limit + width)
            cause = find_causes[binding](above) or (
                bounds[binding].failure,
                bounds[binding].failing_parts,
            )
            bounds[binding] = _bisect_mass(
                find_causes[binding], mass_limit, above, cause, BINDING_BOUND_RTOL * mass_limit
            )
        return bounds

    def get_loaded_stand(self, mass: float) -> _LoadedStand:
        """Return the stand of the robot with a payload [kg].

        Only the last stand is cached: the model of each loaded robot contains the robot's meshes.
        """
        if self._last_stand[0] != mass:
            self._last_stand = mass, self._solve_stand(mass)
        return self._last_stand[1]

    def _solve_stand(self, mass: float) -> _LoadedStand:
        """Solve the stand with a payload [kg], or return the reason why there is no stand."""
        try:
            return _LoadedStand(
                *solve_loaded_stand(self._robot, self._task, mass, self._point), None
            )
        except StanceUnreachableError as error:
            blocked = (reason.subject.name for reason in error.blocked if reason.subject)
            return _LoadedStand(self._robot, None, (Failure.REACH, (*error.shortfall, *blocked)))
        except StaticsInfeasibleError as error:
            needed = error.friction_needed
            slides = needed is not None and needed <= _MAX_FRICTION_NEEDED
            failure = Failure.SLIDING if slides else Failure.TIPPING
            return _LoadedStand(self._robot, None, (failure, error.feet))
        except NotSettlingError:  # for example, a sole that is loaded at its edge
            return _LoadedStand(self._robot, None, (Failure.TIPPING, ()))

    def find_stance_failure(self, mass: float) -> FailureCause:
        """Return the failure of the stance with a payload [kg], or None.

        There is no stand, or a part other than a foot touches the ground, for example.
        """
        loaded = self.get_loaded_stand(mass)
        if loaded.stand is None or loaded.statics is None:
            return loaded.cause
        stand = loaded.stand
        with borrow(loaded.robot, SearchContext) as context:
            shapes = context.shapes
            # No depths: these would exempt parts from the penetration of the feet.
            geometry = shapes.move_to(stand.qpos), stand.task.ground, stand.rigid_targets
            lowest = shapes.find_lowest_part(*geometry, {})
        return None if lowest is None or lowest.distance > 0 else (Failure.GROUND, lowest.links)

    def find_motor_failure(self, mass: float) -> FailureCause:
        """Return the failure of motors above their torque limit with a payload [kg], or None.

        None also if there is no stand.
        """
        loaded = self.get_loaded_stand(mass)
        if loaded.statics is None or loaded.stand is None:
            return None
        if self._kp is None and self._kd is None:
            positions = loaded.stand.joint_positions(loaded.robot)
            overloaded = list_overloaded_joints(loaded.robot, loaded.statics, positions)
        else:  # the servos at the joints replace the actuators of tendons
            overloaded = find_overloaded_motors(loaded.statics)
        return (Failure.MOTOR, overloaded) if overloaded else None

    def _confirm_servo_bound(self, bounds: dict[str, Bound]) -> Bound:
        """Check the payload bound of the servos by simulations, and correct a wrong bound.

        The bound in ``bounds`` is computed from the eigenvalues of the linearised time step.
        """
        bound, other_masses = bounds["servos"], [bounds["stance"].mass, bounds["motors"].mass]
        find_cause = self.find_servo_failure
        if bound.failure is Failure.COMMAND:
            return bound
        if bound.mass == 0:
            if (cause := find_cause(0.0)) is not None:
                return Bound(0.0, *cause)
            # No simulation confirms the mode without payload: the spectrum bounds no mass.
            bound = Bound(math.inf, Failure.NOTHING, ())
            other_masses.append(MAX_BOUND_RATIO * self._robot.total_mass)
        mass_limit = min(bound.mass, *other_masses)
        if not 0 < mass_limit < math.inf:
            return bound
        below = (1 - BOUND_RTOL) * mass_limit
        if (cause := find_cause(below)) is not None:
            if find_cause(0.0) is not None:
                return Bound(0.0, *cause)
            return _bisect_mass(
                find_cause, 0.0, below, cause, BOUND_RTOL * below, LONG_SIMULATION_RTOL
            )
        if bound.mass > mass_limit:
            return bound
        low, high = bound.mass, (1 + LONG_SIMULATION_RTOL) * bound.mass
        while (cause := find_cause(high)) is None:
            low, high = high, _MASS_GROWTH * high
            if high > min(other_masses):
                return Bound(math.inf, Failure.NOTHING, ())
        return _bisect_mass(find_cause, low, high, cause, LONG_SIMULATION_RTOL * low)

    def find_spectrum_failure(self, mass: float) -> FailureCause:
        """Return the failure of the servos with a payload [kg], without simulation, or None.

        Modes that grow only without dry friction, or that depend on the finite-difference step, are
        omitted: only a simulation can decide whether the robot leaves the stand.
        """
        return self.find_servo_failure(mass, is_simulated=False)

    def find_servo_failure(self, mass: float, *, is_simulated: bool = True) -> FailureCause:
        """Return the reason why position servos do not hold the stand with a payload [kg], or None.

        A servo command is outside its range, or a mode of the linearised time step grows away from
        the stand within `HOLD_DURATION`. Torque limits are ignored. None also if there is no stand.

        Args:
            mass: Mass of the payload [kg].
            is_simulated: Whether a simulation must confirm the growth of the modes.
        """
        loaded = self.get_loaded_stand(mass)
        if loaded.stand is None or loaded.statics is None:
            return None
        start = make_stand_start(loaded.robot, loaded.stand, kp=self._kp, kd=self._kd)
        drive, names = start.drive, loaded.robot.joint_names
        lead = compute_command_lead(loaded.statics.joint_torques, drive.kp)
        target = loaded.stand.joint_positions(loaded.robot) + lead
        low, high = command_ranges(loaded.robot).T
        if (out_of_range := (target < low) | (target > high)).any():
            return Failure.COMMAND, tuple(names[index] for index in np.flatnonzero(out_of_range))
        drive.model.actuator_forcelimited[:] = 0
        drive.model.jnt_actfrclimited[:] = 0
        evaluate = evaluate_stability if is_simulated else evaluate_spectrum
        leaving = evaluate(drive, start.start, start.ctrl).modes_growing_within()
        if not is_simulated:
            leaving = tuple(
                mode
                for mode in leaving
                if mode.repeated_at_second_step and not mode.without_dry_friction
            )
        if not leaving:
            return None
        failure = Failure.SHAKING if leaving[0].shakes else Failure.BUCKLING
        return failure, leaving[0].joints
