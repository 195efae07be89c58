"""Verify stands: MuJoCo's simulation against the prediction by Pinocchio.

`verify_stand` simulates a stand, nudges the robot (adds a small velocity), and compares settled
torques, forces and positions with the statics. `mujoco_balance_residual` evaluates the balance
without a simulation.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any, ClassVar

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.array_types import Array
from pupper_analysis.base.arrays import project_perpendicular, rotation_from_quaternion
from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.base.results import Pictured, Tabular
from pupper_analysis.base.units import EFFORT_UNIT, POSITION_UNIT
from pupper_analysis.robot.contact import contact_offset
from pupper_analysis.robot.joints import force_unit, is_slide, joint_unit
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import Servos, command_ranges, compute_command_lead
from pupper_analysis.robot.stability import HOLD_DURATION, Stability
from pupper_analysis.simulation import monitor
from pupper_analysis.simulation.causes import (
    describe_refuted,
    find_chatter,
    find_creep,
    find_instability,
    lacks_decay,
    proves_unrest,
)
from pupper_analysis.simulation.monitor import (
    MEASURING_TIME,
    ContactRecord,
    SimulationSettings,
    record_contacts,
)
from pupper_analysis.simulation.rollout import (
    STATE_SPEC,
    StandStart,
    check_duration,
    make_stand_start,
    simulate_commands,
    weld_generalized_forces,
    with_stand_contacts,
)
from pupper_analysis.simulation.stability import (
    BOUNCING_TIME,
    Nudge,
    evaluate_final_stability,
    is_solver_error,
    measure_response,
    moves_equally_without_nudge,
    remains_small,
    simulate_nudge,
)
from pupper_analysis.simulation.verdict import TWO_ROBOTS_CODE, Creep, Outcome
from pupper_analysis.stance.sag.steady_state import SteadyState
from pupper_analysis.stance.stand import Stand
from pupper_analysis.statics.equilibrium import GravityCompensation


def mujoco_balance_residual(robot: Robot, stand: Stand, prediction: GravityCompensation) -> float:
    """Compute how well predicted forces balance a stand in MuJoCo's model, without a simulation.

    The residual is g - J^T f - S^T tau, minus the load that closed loops transfer between joints.
    Here g are MuJoCo's bias forces minus passive forces, and J is the contact Jacobian of the MJCF.
    The forces f of contacts and welds and the motor torques tau are those of ``prediction``,
    computed from the URDF.

    Returns:
        Largest magnitude of the residual [N, N m]; nearly 0 if both files describe the same robot.
    """
    model, data = robot.mj_model, mujoco.MjData(robot.mj_model)
    robot.mj_convention.set_state(data, stand.qpos)
    mujoco.mj_fwdPosition(model, data)
    mujoco.mj_fwdVelocity(model, data)
    remainder = data.qfrc_bias - data.qfrc_passive
    jacobian = np.zeros((3, model.nv))
    centres = monitor.foot_centres(robot, data)
    for foot in stand.stance_feet:
        radius, depth = robot.contact_radius[foot], stand.depths[foot]
        point = centres[foot] + contact_offset(radius, stand.normals[foot], depth)
        mujoco.mj_jac(model, data, jacobian, None, point, robot.contact_places[foot][0])
        remainder -= jacobian.T @ prediction.contact_forces[foot]
    for push in (
        weld_generalized_forces(robot, stand, prediction).values() if robot.fixed_parts else ()
    ):
        remainder[robot.mj_convention.qvel_index] -= push
    joints = robot.mj_convention.qvel_index[-robot.nu :]
    if robot.closure is not None:
        remainder[joints] -= robot.closure.load_transfer(stand.qpos) @ remainder[joints]
    remainder[joints] -= prediction.joint_torques
    return float(np.abs(remainder).max())


STABLE_DEVIATION = 5e-3
"""Bound of the standard deviation of the base's height [m] of a robot that stands still, in a
second such as the last before the nudge (a small velocity of all coordinates). If the bound is
reached, `verify_stand` reports that the robot does not stand still. Chosen, not tuned."""

JOINT_TOLERANCE = 1e-3
"""Bound of the difference between simulated and predicted joint positions [rad, m] in a verified
stand with feed-forward. Without feed-forward, the deadband by dry friction is added. Chosen, not
tuned.
"""

FORCE_TOLERANCE = 1e-2
"""Bound [1] of the relative differences of motor torques and of foot forces between simulation and
prediction in a verified stand with feed-forward. Differences of torques are divided by
`torque_scale`, of foot forces by the predicted force (`MIN_FORCE_SCALE`). Chosen, not tuned.
"""

MIN_FORCE_SCALE = 0.05
"""Lower bound of the force by which the error of a foot force is divided. It is a fraction [1] of
the predicted vertical load on all feet, or of the weight with welds or grips. Without the bound,
feet with almost no load would have large relative errors. Chosen, not tuned."""

MAX_SINKING_RATIO = 0.1
"""Upper bound [1] of the height loss of a verified stand with feed-forward, divided by the CoM
height above the feet. A stand loses height, for example, if the legs are too short to compensate
for the penetration of the feet. Chosen, not tuned."""

_MAX_SLIP_RATIO = 0.1
"""Upper bound [1] of the displacement of a foot along its ground, divided by the CoM height above
the feet, without a note that the foot has slid. Chosen as `MAX_SINKING_RATIO`."""

MAX_BALANCE_RESIDUAL_RATIO = 1e-3
"""Upper bound of `mujoco_balance_residual` [N, N m] divided by the weight [N], above which the two
files describe different robots. The rounding of numbers in files causes 1e-6. Chosen, not tuned.
"""

TORQUE_SCALE_LEVER = 1e-3
"""Lever arm [m] in the lower bound of `torque_scale`: (robot weight) * (lever arm). Without a lower
bound, relative torque errors would be infinite if all predicted torques are zero. Chosen, not
tuned."""

SETTLED_DRIFT = 5e-4
"""Bound of the magnitude of the base's mean vertical velocity in the last second before the nudge
[m/s] of a robot that stands still. Chosen, not tuned."""

_SAMPLE_TIME = 0.02
"""Time between the samples of the base height in the result of `verify_stand` [s]. Chosen, not
tuned."""

NUDGED_FRACTION = 7 / 12
"""Default fraction [1] of the simulated time of a stand that follows the nudge. By default the
simulation lasts 12 s: 5 s to settle, and 7 s in which the nudge must decay. Chosen, not tuned.
"""

_FRAME_TIME = 0.1
"""Time between the configurations in the result of `verify_stand` [s]. Short enough for an
animation. Chosen, not tuned."""


@dataclass(frozen=True, eq=False, kw_only=True)
class StandVerification(Outcome, SimulationSettings, Pictured, Tabular):
    """Simulation of a stand compared with the prediction, with the ``SimulationSettings``.

    Settled values are means over the last second before the nudge (a small velocity of all
    coordinates). Predictions are Pinocchio's. For a robot without a free base, heights and tilts of
    the base are 0. The lift-off direction of a foot is upward, or the normal of the foot's separate
    plane, such as a wall.

    Attributes:
        passed: Whether the stand is verified.
        failures: Reasons of the failure.
        stays: Whether the robot stands still on its feet, also after the nudge, as predicted or
            not. With feed-forward, a foot may be idle before it settles, or if URDF and MJCF
            describe different robots.
        collapses: Whether the simulation diverged, or the robot has fallen over, sunk, been thrown
            up or left its place at the end; for a fixed base, whether a joint ends far from the
            stand.
        is_lifted: Whether the robot ends upright, with its CoM more than 30 % above the stand.
        base_height: Settled height of the base (m).
        height_deviation: Standard deviation of the base's height in the last second before the
            nudge (m).
        height_drift: Rate of the base's height in the last second before the nudge (m/s); negative
            if the base sinks.
        height_loss: Height of the stand minus ``base_height`` (m); equal to ``servo_sag`` plus
            ``contact_sag``.
        servo_sag: Height lost by joint deflection (m).
        contact_sag: Height lost by the softness of feet and ground (m).
        tilt: Angle between the base's orientation at the end and the orientation in the task (rad).
        foot_slip: {stance foot: settled distance of a contact point from the target, across the
            lift-off direction} (m); the largest of the foot.
        joint_error: Largest deviation of a joint from the stand in the last second before the
            nudge.
        joint_error_unit: Unit of ``joint_error``: rad, or m for a slide.
        joint_positions: (nu,) settled joint positions (rad or m).
        joint_torques: (nu,) settled motor torques or forces (N m or N).
        predicted_torques: (nu,) predicted motor torques or forces (N m or N).
        torque_units: (nu,) unit of each settled and predicted torque: N m for a hinge, N for a
            slide.
        torque_error: Largest torque deviation, divided by the larger of two torques: the largest
            predicted torque, and the weight times ``TORQUE_SCALE_LEVER``.
        foot_forces: {foot: (3,)} settled force of the ground on the foot, in world axes (N); for
            welds and grips, force of MuJoCo's constraint.
        predicted_forces: {foot: (3,)} predicted forces, in world axes (N).
        force_error: Largest deviation of a foot force along the lift-off direction, divided by the
            larger of two forces: the prediction, and ``MIN_FORCE_SCALE`` times the load on all
            feet. For a grip, the force vectors are compared. None without stance feet and grips.
        mujoco_residual: Largest magnitude in g - J^T f - S^T tau with MuJoCo's g and J and the
            predicted f and tau (N, N m), less the load of closed loops.
        stability: Growing modes and stability margin of the settled state; of the initial state if
            the robot fell before the nudge; of a repeated simulation if the settled state is not at
            rest.
        nudge: Response to the nudge; None if the robot was not nudged.
        time: (n,) times of the height samples (s).
        height: (n,) base heights at ``time`` (m).
        motion_time: (m,) times of the configurations (s).
        motion: (m, nq) configurations at these times, rounded to six decimals, for animations.
    """

    _key_fields: ClassVar[tuple[str, ...]] = ("passed", "failures")

    stays: bool
    base_height: float = field(metadata={"unit": "m"})
    height_deviation: float = field(metadata={"unit": "m"})
    height_drift: float = field(metadata={"unit": "m/s"})
    height_loss: float = field(metadata={"unit": "m"})
    servo_sag: float = field(metadata={"unit": "m"})
    contact_sag: float = field(metadata={"unit": "m"})
    tilt: float = field(metadata={"unit": "rad"})
    foot_slip: dict[str, float] = field(metadata={"unit": "m"})
    joint_error: float = field(metadata={"unit": POSITION_UNIT})
    joint_error_unit: str
    joint_positions: Array = field(metadata={"unit": POSITION_UNIT})
    joint_torques: Array = field(metadata={"unit": EFFORT_UNIT})
    predicted_torques: Array = field(metadata={"unit": EFFORT_UNIT})
    torque_units: tuple[str, ...]
    foot_forces: dict[str, Array] = field(metadata={"unit": "N"})
    predicted_forces: dict[str, Array] = field(metadata={"unit": "N"})
    mujoco_residual: float = field(metadata={"unit": "N or N m"})
    stability: Stability
    nudge: Nudge | None
    time: Array = field(metadata={"unit": "s"})
    height: Array = field(metadata={"unit": "m"})
    motion_time: Array = field(metadata={"unit": "s"})
    motion: Array = field(metadata={"unit": "m, 1 (quaternion) and rad"})

    def _columns(self) -> dict[str, Array]:
        """Return {column: values} of a table: time [s] and height of the base [m], (n,) each."""
        return {"time": self.time, "height": self.height}

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name != "_stand"}

    @property
    def stand(self) -> Stand | None:
        """Stand that was simulated; None for a copied or unpickled verification."""
        stand: Stand | None = vars(self).get("_stand")
        return stand


@check_arguments
def verify_stand(
    robot: Robot,
    stand: Stand,
    *,
    feedforward: bool = True,
    kp: ArrayLike | None = None,
    kd: ArrayLike | None = None,
    integrator: str | None = None,
    duration: float = HOLD_DURATION,
    nudged: float | None = None,
    settled: SteadyState | None = None,
    until_failure: bool = False,
) -> StandVerification:
    """Simulate a stand in MuJoCo, and compare the simulation with Pinocchio's prediction.

    The stand is verified if the simulation meets all conditions:

    1. The robot settles, and stands still only on its feet.
    2. With feed-forward, settled torques, foot forces and joint positions agree with the
       prediction, and the height loss is at most `MAX_SINKING_RATIO` of the CoM height. Without
       feed-forward, the robot does not collapse (`StandVerification.collapses`).
    3. The robot comes to rest again near the stand after a nudge: a velocity of all coordinates
       (``NUDGE_SPEED`` of ``robot.fall``). A foot with almost no load may bounce (`remains_small`),
       and the constraint solver may have small errors (`is_solver_error`). Motion that is the same
       without the nudge, such as creep, does not count (`moves_equally_without_nudge`).
    4. No mode of the linearised step grows within ``HOLD_DURATION`` (12 s), unless a simulation
       refutes the mode.

    A posture of a robot with a fixed base (``held_stand``) is verified in the same way. Without
    feed-forward, such a posture is compared with ``settled``, if given.

    The prediction is ``gravity_compensation`` with minimum tangential forces, the equilibrium that
    MuJoCo's creeping friction sustains. MuJoCo's ground is soft: if the feet carry unequal loads, a
    stand for rigid ground tilts, and the loads change. Use ``solve_stand_on_soft_ground`` for a
    stand that holds as predicted.

    Args:
        robot: Robot.
        stand: Stand.
        feedforward: Whether ctrl = q* + tau / kp (joint positions plus static torques); otherwise
            ctrl = q*.
        kp: Servo stiffness [N m/rad, N/m], scalar or shape (nu,); the model's own by default.
        kd: Servo damping [N m s/rad, N s/m], scalar or shape (nu,); the model's own by default.
        integrator: MuJoCo's integrator; the model's own by default.
        duration: Simulated time [s], 2 to 600.
        nudged: Part of the duration after the nudge [s], at most ``duration`` minus 1 s. Default:
            7/12 of ``duration``, within this bound. With 0 there is no nudge, and settled values
            are measured at the end.
        settled: Predicted equilibrium without feed-forward. Used only if ``feedforward`` is False,
            the equilibrium has no failures, and the robot has a fixed base and no stance feet.
        until_failure: Whether the nudge is omitted if the robot does not stand still before, and
            the simulations that test growing modes if motion or nudge proves that the robot does
            not stay. This hardly ever changes ``passed`` and ``stays``; ``stability`` and
            ``failures`` then contain modes that are not tested.

    Returns:
        Comparison; ``failures`` contains the reasons if the stand is not verified.

    Raises:
        ConfigurationError: If an argument is out of range, or the stand belongs to another robot,
            for example.
        ModelError: If the servo gains of a joint are unknown, for example.
        StaticsInfeasibleError: If no contact forces balance the stand.
    """
    given, robot = robot, with_stand_contacts(robot, stand)
    check_duration(duration)
    simulated = stand if stand.own_robot is given else stand.with_robot(given)
    nudge_duration = _nudge_duration(duration, nudged)
    held = make_stand_start(
        robot, stand, feedforward=feedforward, kp=kp, kd=kd, integrator=integrator
    )
    robot, drive, ctrl, prediction = held.robot, held.drive, held.ctrl, held.prediction
    reference = monitor.StandReference.from_configuration(robot, stand.qpos, stand.task.rotation())
    timestep = float(drive.model.opt.timestep)

    def rests(states: Array) -> bool:
        """Return True if the robot stands still in the states (n, size) of a second."""
        return _is_at_rest(robot, reference, states, timestep)

    run = settle_and_nudge(
        drive,
        held.start,
        ctrl,
        duration - nudge_duration,
        nudge_duration,
        reference.has_collapsed,
        rests=rests if until_failure else None,
        until_failure=until_failure,
    )
    total_load = _compute_total_load(robot, prediction)
    shares = _compute_load_shares(robot, stand, prediction, total_load)
    loaded = {foot for foot, share in shares.items() if share >= monitor.LIGHT_FOOT_LOAD}
    record = record_contacts(
        robot,
        drive.model,
        stand,
        run.states,
        ctrl,
        run.settling,
        loaded,
        is_released=not feedforward,
    )
    result = _compare_with_prediction(
        robot, stand, drive, prediction, run, record, reference, MIN_FORCE_SCALE * total_load
    )
    result = replace(result, feedforward=feedforward)
    has_light_foot = len(loaded) < len(shares)
    failures, stays, rest_cause = _evaluate_standing(
        robot, stand, held, run, record, reference, result, has_light_foot=has_light_foot
    )
    if feedforward:
        failures += _find_deviations(robot, stand, record, result, stays=stays)
    failures += _describe_height_loss(result, reference.com_height, failures)
    if feedforward:
        failures.sort(key=lambda failure: failure.code != TWO_ROBOTS_CODE)  # the cause first
    elif settled is not None and not settled.failures and _is_fixed_without_feet(robot, stand):
        failures += _compare_with_equilibrium(robot, result, settled)
    failures += find_chatter(robot, drive, run.states, ctrl) if failures else []
    notes = _list_notes(result, reference.com_height, record.lifted, shares, rest_cause)
    judged = replace(
        result,
        passed=not failures,
        failures=tuple(failures),
        stays=stays,
        creep=None if result.collapses else measure_creep(robot, stand, drive.model, run.states),
        notes=tuple(notes),
    )
    vars(judged)["_stand"] = simulated
    return judged


def _list_notes(
    result: StandVerification,
    com_height: float,
    lifted: Mapping[str, float],
    shares: Mapping[str, float],
    rest_cause: str | None,
) -> list[Diagnostic]:
    """List the notes on a simulation: lifts of light feet, harmless motion, modes, and slip.

    ``rest_cause`` is the code of the harmless motion after the nudge, or None. For ``lifted`` and
    ``shares`` see `_describe_light_feet`. ``com_height`` [m] is the initial height of the CoM.
    """
    notes = _describe_light_feet(lifted, shares)
    if rest_cause is not None and result.nudge is not None:
        notes.append(_describe_remaining_motion(rest_cause, result.nudge))
    if not result.collapses:
        notes += describe_refuted(result.stability)
        notes += _describe_slip(result, com_height)
    return notes


def _evaluate_standing(
    robot: Robot,
    stand: Stand,
    held: StandStart,
    run: SettlingRun,
    record: ContactRecord,
    reference: monitor.StandReference,
    result: StandVerification,
    *,
    has_light_foot: bool,
) -> tuple[list[Diagnostic], bool, str | None]:
    """Return the failures of standing, whether the robot stays, and a code of the remaining motion.

    The code belongs to the note about the harmless cause of motion after the nudge (a bouncing
    foot, or an error of the constraint solver); None without such motion. ``has_light_foot`` is
    True if a foot has a predicted load below `LIGHT_FOOT_LOAD`, and may bounce.
    """
    failures = _find_standing_failures(robot, reference, run.states, record, result)
    if failures:
        failures += find_creep(robot, stand, held.prediction)
    nudge = result.nudge
    cause, is_equal, model = None, False, held.drive.model
    if not failures and nudge is not None and not nudge.decayed:
        is_fast = lacks_decay(nudge)
        # A light foot may bounce although the samples of the record show no lift.
        if has_light_foot:
            cause = "light-foot-bounces"
        elif is_fast and is_solver_error(model, run.last[-1], held.ctrl, nudge, run.last):
            cause = "solver-error-moves"
        if cause and not remains_small(model, run.states[-1], held.ctrl, nudge, run.last):
            cause = None
        nudged = run.states[run.settling :]
        is_equal = (
            cause is None
            and is_fast
            and moves_equally_without_nudge(model, run.last[-1], held.ctrl, nudge, nudged)
        )
    is_harmless = cause is not None or is_equal
    failures += find_instability(result.stability, nudge, is_harmless=is_harmless)
    stays = not result.collapses and (
        not failures or _stands_despite_idle_feet(robot, record, result, failures)
    )
    return failures, stays, cause


def _compute_total_load(robot: Robot, prediction: GravityCompensation) -> float:
    """Return the predicted vertical load on all feet [N]; with welds or grips, the robot's weight.

    With a weld, the sum of foot forces is no scale, since a weld may carry all weight or pull down.
    """
    if robot.fixed_parts:
        return robot.weight
    predicted = robot.per_foot(prediction.contact_forces)
    return float(sum(force[2] for force in predicted.values()))


def _compute_load_shares(
    robot: Robot, stand: Stand, prediction: GravityCompensation, total_load: float
) -> dict[str, float]:
    """Return {foot: force along the lift-off direction / ``total_load`` [N]} of the prediction."""
    normals = stand.lift_directions(robot)
    predicted = robot.per_foot(prediction.contact_forces)
    return {foot: float(force @ normals[foot]) / total_load for foot, force in predicted.items()}


def _stands_despite_idle_feet(
    robot: Robot,
    record: ContactRecord,
    result: StandVerification,
    failures: Sequence[Diagnostic],
) -> bool:
    """Return True if all failures are unloaded feet, and the prediction may be the cause.

    This requires feed-forward. Either the feet carry load from the last second before the nudge on,
    or the balance equations show that URDF and MJCF describe different robots.
    """
    if not result.feedforward or result.collapses:
        return False
    if any(failure.code != "foot-idle" for failure in failures):
        return False
    idle = {failure.subject.name for failure in failures if failure.subject is not None}
    return not idle & record.idle_late or bool(
        describe_model_mismatch(robot, result.mujoco_residual, robot.usual_weight)
    )


def _is_fixed_without_feet(robot: Robot, stand: Stand) -> bool:
    """Return True if the base is fixed and the stand has no stance feet."""
    return robot.is_base_fixed and not stand.stance_feet


def _describe_light_feet(
    lifted: Mapping[str, float], shares: Mapping[str, float]
) -> list[Diagnostic]:
    """Create a note for each foot with little load that left the ground.

    ``lifted`` contains the times of the first lifts [s], ``shares`` the fractions of the load [1].
    """
    return [
        diagnose(
            "light-foot-lifts",
            subject=("foot", foot),
            share=Quantity(shares.get(foot, 0.0), "1"),
            time=Quantity(moment, "s"),
        )
        for foot, moment in lifted.items()
    ]


def _describe_remaining_motion(code: str, nudge: Nudge) -> Diagnostic:
    """Create the note about small motion after a nudge: light-foot-bounces, solver-error-moves."""
    after, further = Quantity(nudge.duration, "s"), Quantity(BOUNCING_TIME, "s")
    if code == "light-foot-bounces":
        return diagnose("light-foot-bounces", left=nudge.left, after=after, further=further)
    return diagnose("solver-error-moves", left=nudge.left, after=after, further=further)


CREEP_TIME = 10.0
"""Time [s] at the end of a simulation over which the creep of a stand, its slow mean motion, is
measured. Chosen, not tuned."""


def measure_creep(robot: Robot, stand: Stand, model: mujoco.MjModel, states: Array) -> Creep:
    """Measure the creep of a stand: the slow mean motion of base, feet and joints in a simulation.

    A mean speed is a displacement over the last `CREEP_TIME` (or the whole simulation, if shorter),
    divided by the duration. ``states`` are the states after each step (mjSTATE_FULLPHYSICS), shape
    (n, size).
    """
    steps = min(round(CREEP_TIME / float(model.opt.timestep)), len(states) - 1)
    first, last = states[-1 - steps], states[-1]
    duration = float(last[0] - first[0])
    data, centres = mujoco.MjData(model), []
    for state in (first, last):
        mujoco.mj_setState(model, data, state, STATE_SPEC)
        mujoco.mj_kinematics(model, data)
        centres.append(monitor.foot_centres(robot, data))
    displacements = [
        np.linalg.norm(centres[1][foot] - centres[0][foot]) for foot in stand.stance_feet
    ]
    joints = np.abs(last - first)[1 + robot.mj_convention.qpos_index[-robot.nu :]]
    slides = np.array([is_slide(robot, joint) for joint in robot.joint_names], dtype=bool)
    displacements += joints[slides].tolist()
    base_rotation = 0.0
    if robot.floating:
        pose_columns = 1 + robot.mj_convention.qpos_index[:7]
        displacements.append(np.linalg.norm(last[pose_columns[:3]] - first[pose_columns[:3]]))
        rotation = rotation_from_quaternion(first[pose_columns[3:]])
        base_rotation = monitor.rotation_angle(robot, rotation, last)
    rate = max(float(joints[~slides].max(initial=0.0)), base_rotation) / duration
    return Creep(duration, float(max(displacements, default=0.0)) / duration, rate)


def _nudge_duration(duration: float, nudged: float | None) -> float:
    """Return the simulated time after the nudge [s]: ``nudged``, or a default if None.

    Raises:
        ConfigurationError: If ``nudged`` is negative or too long.
    """
    max_duration = duration - MEASURING_TIME
    if nudged is None:
        return min(NUDGED_FRACTION * duration, max_duration)
    if not 0 <= nudged <= max_duration:
        problem = diagnose(
            "not-between", given=f"{nudged} s", low=0, high=Quantity(max_duration, "s")
        )
        raise ConfigurationError("nudged", problem)
    return nudged


@dataclass(frozen=True, eq=False)
class SettlingRun:
    """Simulation of a robot under a constant command, with a nudge (a small velocity) after a time.

    Attributes:
        states: States after each step (mjSTATE_FULLPHYSICS), shape (n, size).
        settling: Number of states before the nudge.
        last: States of the last second before the nudge, shape (m, size).
        diverged: Whether the simulation diverged before the nudge.
        stability: Stability of the settled state, or of a state near the initial state
            (`evaluate_final_stability`).
        nudge: Response to the nudge; None without a nudge.
    """

    states: Array
    settling: int
    last: Array
    diverged: bool
    stability: Stability
    nudge: Nudge | None


def settle_and_nudge(
    drive: Servos,
    start: Array,
    ctrl: Array,
    seconds: float,
    nudge_duration: float,
    has_failed: Callable[[Array], bool],
    *,
    rests: Callable[[Array], bool] | None = None,
    until_failure: bool = False,
) -> SettlingRun:
    """Simulate a robot under a constant command, then after a nudge, and evaluate the stability.

    A nudge is a small velocity of all coordinates.

    Args:
        drive: Servos and MuJoCo model.
        start: Initial state (mjSTATE_FULLPHYSICS), shape (size,).
        ctrl: Actuator commands, shape (model.nu,).
        seconds: Simulated time before the nudge [s].
        nudge_duration: Simulated time after the nudge [s]; 0 for no nudge.
        has_failed: Function that returns True for a state that is no longer the expected stand.
        rests: Function that returns False for the states of the last second before the nudge if the
            robot does not stand still. There is then no nudge, and no test of growing modes. None
            for a nudge in any case.
        until_failure: Whether the simulations that test growing modes are omitted if the response
            to the nudge `proves_unrest`.
    """
    model = drive.model
    timestep = float(model.opt.timestep)
    settling_states = simulate_commands(
        model, start, np.tile(ctrl, (max(2, round(seconds / timestep)), 1))
    )
    diverged, last_second = (
        monitor.has_diverged(settling_states, timestep),
        settling_states[-round(MEASURING_TIME / timestep) :],
    )
    is_lost = diverged or has_failed(settling_states[-1])
    states, nudge = settling_states, None
    is_resting = diverged or rests is None or rests(last_second)
    if nudge_duration and not diverged and is_resting:
        nudged_states = simulate_nudge(model, settling_states[-1], ctrl, nudge_duration)
        nudge = measure_response(model, settling_states[-1], nudged_states, last_second)
        states = np.concatenate([settling_states, nudged_states])
    is_decided = not is_resting or (until_failure and nudge is not None and proves_unrest(nudge))
    stability = evaluate_final_stability(
        drive,
        start,
        settling_states[-1],
        ctrl,
        has_fallen=is_lost,
        tests_growth=not is_decided,
    )
    return SettlingRun(states, len(settling_states), last_second, diverged, stability, nudge)


@np.errstate(invalid="ignore", over="ignore")  # diverged values are reported by ``collapses``
def _compare_with_prediction(
    robot: Robot,
    stand: Stand,
    drive: Servos,
    prediction: GravityCompensation,
    run: SettlingRun,
    record: ContactRecord,
    reference: monitor.StandReference,
    force_scale: float,
) -> StandVerification:
    """Create the comparison of a simulation with the predicted static equilibrium of the stand.

    ``passed``, ``stays`` and ``feedforward`` of the result are placeholders (True), and failures
    are empty. ``force_scale`` [N] is the smallest force by which the error of a foot's force is
    divided.
    """
    timestep = float(drive.model.opt.timestep)
    states, settled, drops = run.states, run.last, record.compute_foot_drops(stand)
    base_height = float(monitor.base_heights(robot, settled).mean())
    height_deviation, height_drift = _measure_height_motion(robot, settled, timestep)
    height_loss = float(stand.qpos[2]) - base_height if robot.floating else 0.0
    contact_sag = stand.base_drop(robot, drops)
    joints = settled[:, 1 + robot.mj_convention.qpos_index[-robot.nu :]]
    joint_deviations = np.abs(joints - stand.joint_positions(robot)).max(axis=0)
    torque_deviation = float(np.abs(record.torques - prediction.joint_torques).max())
    has_diverged = monitor.has_diverged(states, timestep)
    normals = stand.lift_directions(robot)
    predicted_forces, force_error = _compare_forces(
        robot, prediction, record.forces, normals, force_scale
    )
    step, frame = (max(1, round(period / timestep)) for period in (_SAMPLE_TIME, _FRAME_TIME))
    return StandVerification(
        passed=True,
        failures=(),
        stays=True,
        collapses=reference.has_collapsed(states[-1]) or has_diverged,
        feedforward=True,
        integrator=drive.integrator,
        timestep=timestep,
        duration=len(states) * timestep,
        kp=drive.kp,
        kd=drive.kd,
        base_height=base_height,
        height_deviation=height_deviation,
        height_drift=height_drift,
        height_loss=height_loss,
        servo_sag=height_loss - contact_sag,
        contact_sag=contact_sag,
        tilt=monitor.rotation_angle(robot, stand.task.rotation(), states[-1]),
        foot_slip=_measure_foot_slip(robot, drops, normals),
        joint_error=float(joint_deviations.max()),
        joint_error_unit=find_worst_unit(robot, joint_deviations),
        joint_positions=joints.mean(axis=0),
        joint_torques=record.torques,
        predicted_torques=prediction.joint_torques,
        torque_units=prediction.torque_units,
        torque_error=torque_deviation / torque_scale(robot, prediction.joint_torques),
        foot_forces=record.forces,
        predicted_forces=predicted_forces,
        force_error=force_error,
        mujoco_residual=mujoco_balance_residual(robot, stand, prediction),
        stability=run.stability,
        nudge=run.nudge,
        time=states[::step, 0].copy(),
        height=monitor.base_heights(robot, states[::step]).copy(),
        motion_time=states[::frame, 0].copy(),
        motion=np.round(states[::frame, 1 + robot.mj_convention.qpos_index], 6),
        is_lifted=reference.is_lifted(states[-1]) and not has_diverged,
    )


def _compare_forces(
    robot: Robot,
    prediction: GravityCompensation,
    forces: Mapping[str, Array],
    normals: Mapping[str, Array],
    force_scale: float,
) -> tuple[dict[str, Array], float | None]:
    """Return {foot, weld or grip: predicted force (3,) [N]}, and the largest relative error [1].

    Errors of feet are along the lift-off direction ``normals``, errors of grips are norms. Both are
    divided by the predicted force, at least ``force_scale`` [N]. The error is None without feet and
    grips.
    """
    predicted = robot.per_foot(prediction.contact_forces)
    errors = [
        abs(float((forces[foot] - force) @ normals[foot]))
        / max(float(force @ normals[foot]), force_scale)
        for foot, force in predicted.items()
    ]
    weld_forces = {name: wrench[:3] for name, wrench in prediction.weld_wrenches.items()}
    for name in robot.grips:
        grip_deviation = float(np.linalg.norm(forces[name] - weld_forces[name]))
        errors.append(grip_deviation / max(float(np.linalg.norm(weld_forces[name])), force_scale))
    return predicted | weld_forces, max(errors, default=None)


def _measure_foot_slip(
    robot: Robot, drops: Mapping[str, Array], normals: Mapping[str, Array]
) -> dict[str, float]:
    """Return {foot: largest tangential displacement of its contact points [m]}.

    ``drops`` are the displacements of the points, shape (3,) [m], ``normals`` the lift-off
    directions.
    """
    return {
        foot: max(
            float(np.linalg.norm(project_perpendicular(drops[point], normals[foot])))
            for point in robot.feet[foot]
        )
        for foot in robot.feet_with(drops)
    }


def _describe_height_loss(
    result: StandVerification, com_height: float, failures: Sequence[Diagnostic]
) -> list[Diagnostic]:
    """Create the message that a simulated robot settles too far below its stand; empty if not.

    The limit is `MAX_SINKING_RATIO` times ``com_height`` [m]. Without feed-forward sag is expected,
    so that a collapse is reported instead. After a collapse with other ``failures``, nothing is
    reported.
    """
    share = result.height_loss / com_height
    is_lost = share > MAX_SINKING_RATIO if result.feedforward else result.collapses
    if not is_lost or (result.collapses and failures):
        return []
    loss, sunk = Quantity(result.height_loss, "m"), Quantity(result.contact_sag, "m")
    if not result.feedforward:
        return [diagnose("sags-too-far", loss=loss, share=share)]
    return [diagnose("height-lost", loss=loss, share=share, sunk=sunk)]


def _describe_slip(result: StandVerification, com_height: float) -> list[Diagnostic]:
    """Create the note about the foot that slid farthest; empty up to `_MAX_SLIP_RATIO`.

    ``com_height`` is the CoM height of the stand above the feet [m].
    """
    foot = max(result.foot_slip, key=result.foot_slip.__getitem__, default=None)
    if foot is None or not result.foot_slip[foot] > _MAX_SLIP_RATIO * com_height:
        return []
    slip = result.foot_slip[foot]
    return [
        diagnose(
            "foot-slid",
            subject=("foot", foot),
            distance=Quantity(slip, "m"),
            share=Quantity(slip / com_height, "1"),
            alone=not result.feedforward,
        )
    ]


def _find_standing_failures(
    robot: Robot,
    reference: monitor.StandReference,
    states: Array,
    record: ContactRecord,
    result: StandVerification,
) -> list[Diagnostic]:
    """Create messages about the reasons why a simulated robot does not stand still on its feet.

    ``states`` are the simulated states after each step, shape (n, size).
    """
    failures = list(record.failures)
    if monitor.has_diverged(states, result.timestep):
        failures.insert(0, monitor.describe_divergence(result.integrator, result.timestep))
    if reference.has_fallen(states[-1]):
        height = float(monitor.base_heights(robot, states[-1]))
        failures.insert(0, monitor.describe_fall(reference.tilt(states[-1]), height))
    if robot.is_base_fixed and reference.has_collapsed(states[-1]):
        failures.append(diagnose("posture-left"))
    if not result.height_deviation < STABLE_DEVIATION:
        deviation = Quantity(result.height_deviation, "m")
        failures.append(diagnose("height-deviates", deviation=deviation))
    if not abs(result.height_drift) < SETTLED_DRIFT:
        drift = Quantity(result.height_drift, "m/s")
        failures.append(diagnose("height-drifts", drift=drift))
    return failures


def _measure_height_motion(robot: Robot, states: Array, timestep: float) -> tuple[float, float]:
    """Return standard deviation [m] and mean rate [m/s] of the base's height in ``states``."""
    heights = monitor.base_heights(robot, states)
    duration = timestep * (len(heights) - 1)
    return float(heights.std()), float(heights[-1] - heights[0]) / duration


def _is_at_rest(
    robot: Robot, reference: monitor.StandReference, states: Array, timestep: float
) -> bool:
    """Return True if a robot's height is at rest in the last second, and it has not collapsed."""
    deviation, drift = _measure_height_motion(robot, states, timestep)
    is_still = deviation < STABLE_DEVIATION and abs(drift) < SETTLED_DRIFT
    return is_still and not reference.has_collapsed(states[-1])


def torque_scale(robot: Robot, torques: Array) -> float:
    """Return the reference torque [N m, N] for relative errors of joint torques.

    The result is the largest magnitude of ``torques``, shape (nu,), or the weight times
    `TORQUE_SCALE_LEVER`, if larger. Without gravity, the weight is that on Earth.
    """
    return max(float(np.abs(torques).max()), TORQUE_SCALE_LEVER * robot.usual_weight)


def friction_and_deadband(robot: Robot, kp: Array) -> tuple[Array, Array]:
    """Return each joint's dry friction, and the position deadband that this friction causes.

    The deadband is friction / kp: the position deviation at which dry friction balances a servo
    with the stiffness ``kp``, shape (nu,) [N m/rad, N/m].

    Returns:
        Dry friction, shape (nu,) [N m, N]; deadband, shape (nu,) [rad, m], 0 for a joint with kp =
        0.
    """
    friction = robot.mj_model.dof_frictionloss[robot.mj_convention.qvel_index[-robot.nu :]]
    return friction, np.divide(friction, kp, out=np.zeros(robot.nu), where=kp > 0)


def _compare_with_equilibrium(
    robot: Robot, result: StandVerification, settled: SteadyState
) -> list[Diagnostic]:
    """Create messages about deviations from an equilibrium that dry friction cannot explain."""
    friction, deadband = friction_and_deadband(robot, result.kp)
    scale, joints = torque_scale(robot, settled.joint_torques), settled.qpos[-robot.nu :]
    torques = float(np.abs(result.joint_torques - settled.joint_torques).max()) / scale
    moved = np.abs(result.joint_positions - joints)
    messages = describe_deviations(
        float(moved.max()),
        torques,
        float(deadband.max()),
        friction.max() / scale,
        unit=find_worst_unit(robot, moved),
    )
    return (
        [*messages, *describe_drive_limits(robot, result, settled.joint_torques, joints)]
        if messages
        else []
    )


def find_worst_unit(robot: Robot, deviations: Array) -> str:
    """Return the unit, rad or m, of the joint with the largest of ``deviations``, shape (nu,).

    NaN counts as the largest value.
    """
    worst = int(np.argmax(np.nan_to_num(deviations, nan=np.inf)))
    return joint_unit(robot, robot.joint_names[worst])


def describe_deviations(
    joint: float,
    torque: float,
    deadband: float = 0.0,
    friction_share: float = 0.0,
    details: Mapping[str, Any] = MappingProxyType({}),
    unit: str = "rad",
) -> list[Diagnostic]:
    """Create messages if joint positions or torques deviate from the prediction beyond tolerances.

    The tolerances are `JOINT_TOLERANCE` plus ``deadband``, and `FORCE_TOLERANCE` plus
    ``friction_share``.

    Args:
        joint: Largest joint deviation, in ``unit``.
        torque: Largest torque deviation, relative to `torque_scale` [1].
        deadband: Joint deviation that dry friction can hold [rad, m], added to the tolerance.
        friction_share: Torque deviation that dry friction can hold, relative to `torque_scale` [1].
        details: Values of the message about torques: joint with the largest torque deviation,
            predicted and simulated torque.
        unit: Unit of ``joint``, rad or m.
    """
    messages = []
    if not joint < JOINT_TOLERANCE + deadband:
        messages.append(diagnose("joint-off", error=Quantity(joint, unit)))
    if not torque < FORCE_TOLERANCE + friction_share:
        numbers: dict[str, Any] = dict.fromkeys(("joint", "predicted", "simulated"))
        numbers |= details
        messages.append(diagnose("motor-torque-off", error=torque, **numbers))
    return messages


_SATURATION_RTOL = 1e-6
"""Relative tolerance [1] of the saturation of motors. A motor counts as saturated if the torque is
beyond the torque limit, or below the limit by at most this fraction. Chosen, not tuned."""


def describe_drive_limits(
    robot: Robot, run: StandVerification, predicted: Array, positions: Array
) -> list[Diagnostic]:
    """Create messages about saturated motors, and feed-forward commands beyond the command ranges.

    Such limits may be the cause of a deviation from the prediction.

    Args:
        robot: Robot.
        run: Simulation that deviates from the prediction.
        predicted: Predicted motor torques, shape (nu,) [N m, N].
        positions: Predicted joint positions, shape (nu,) [rad, m].
    """
    weakest, strongest = robot.effort_ranges.T * (1 - _SATURATION_RTOL)
    saturated = (run.joint_torques <= weakest) | (run.joint_torques >= strongest)
    saturated &= ~np.isin(robot.joint_names, robot.description.passive_joints)
    low, high = command_ranges(robot).T
    command = positions + compute_command_lead(predicted, run.kp)
    is_clipped = ((command < low) | (command > high)) & run.feedforward
    names, messages = np.array(robot.joint_names), []
    if saturated.any():
        joints = names[saturated].tolist()
        messages.append(diagnose("motors-give-all", joints=joints, released=not run.feedforward))
    if is_clipped.any():
        messages.append(diagnose("commands-cut-off", joints=names[is_clipped].tolist()))
    return messages


def describe_model_mismatch(robot: Robot, residual: float, weight: float) -> list[Diagnostic]:
    """Create the message that URDF and MJCF describe different robots, if forces do not balance.

    The residual is too large if it exceeds `MAX_BALANCE_RESIDUAL_RATIO` times the weight.

    Args:
        robot: Robot.
        residual: Largest unbalanced generalised force [N, N m] in MuJoCo's model under the
            predicted contact forces and motor torques (`mujoco_balance_residual`).
        weight: Weight of the robot [N].

    Returns:
        List with the message, or an empty list.
    """
    if residual <= MAX_BALANCE_RESIDUAL_RATIO * weight:  # false for NaN: forces do not balance
        return []
    urdf, mjcf = robot.describe_masses()
    return [diagnose("files-of-two-robots", mjcf=mjcf, residual=residual, urdf=urdf)]


_MIN_UNPREDICTED_DEPTH = 1e-4
"""Penetration of a foot [m] above which soft ground may be the cause of a deviation of a stand that
was solved for rigid ground. Chosen, not tuned.
"""


def _find_deviations(
    robot: Robot,
    stand: Stand,
    record: ContactRecord,
    result: StandVerification,
    *,
    stays: bool,
) -> list[Diagnostic]:
    """Create messages about deviations of a simulation from the prediction, and known causes.

    ``stays`` is True if the robot stands still.
    """
    errors = np.abs(result.joint_torques - result.predicted_torques)
    worst = int(np.argmax(np.nan_to_num(errors, nan=np.inf)))
    name = robot.joint_names[worst]
    unit = force_unit(robot, name)
    details = {
        "joint": name,
        "predicted": Quantity(float(result.predicted_torques[worst]), unit),
        "simulated": Quantity(float(result.joint_torques[worst]), unit),
    }
    moved = np.abs(result.joint_positions - stand.joint_positions(robot))
    messages = describe_deviations(
        result.joint_error, result.torque_error, details=details, unit=find_worst_unit(robot, moved)
    )
    if result.force_error is not None and not result.force_error < FORCE_TOLERANCE:
        messages.append(diagnose("foot-force-off", error=result.force_error))
    weight = robot.usual_weight
    if messages:
        messages += describe_drive_limits(
            robot, result, result.predicted_torques, stand.joint_positions(robot)
        )
    if messages and (mismatch := describe_model_mismatch(robot, result.mujoco_residual, weight)):
        return [*messages, *mismatch]
    if messages and record.touching:
        return [*messages, *(diagnose("parts-touch", bodies=pair) for pair in record.touching)]
    drops = record.compute_foot_drops(stand)
    depth = max((float(drop @ stand.normals[foot]) for foot, drop in drops.items()), default=0.0)
    if messages and stays and depth > _MIN_UNPREDICTED_DEPTH and not any(stand.depths.values()):
        messages.append(diagnose("feet-penetrate-rigid-ground", depth=Quantity(depth, "m")))
    return messages
