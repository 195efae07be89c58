"""Does it hold: MuJoCo's floating-base simulation of a stand, against what Pinocchio predicts.

First the stand itself by MuJoCo's kinematics and dynamics.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.arrays import project_perpendicular, rotation_from_quaternion
from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.base.results import Tabular
from pupper_analysis.robot.contact import contact_offset
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import Servos, command_ranges, compute_command_lead
from pupper_analysis.robot.stability import HOLD_DURATION, Stability
from pupper_analysis.simulation import monitor
from pupper_analysis.simulation.causes import (
    describe_refuted,
    find_chatter,
    find_creep,
    find_instability,
)
from pupper_analysis.simulation.monitor import LAST, SimulationSettings, Watch, watch_contacts
from pupper_analysis.simulation.rollout import (
    STATE,
    begin_stand,
    check_stand,
    simulate,
    weld_pushes,
)
from pupper_analysis.simulation.stability import (
    Nudge,
    measure_response,
    simulate_nudge,
    stability_after,
)
from pupper_analysis.simulation.verdict import Creep, Outcome
from pupper_analysis.stance.sag.steady_state import SteadyState
from pupper_analysis.stance.stand import Stand
from pupper_analysis.statics.equilibrium import GravityCompensation

Array = NDArray[np.float64]


def balance_by_mujoco(robot: Robot, stand: Stand, prediction: GravityCompensation) -> float:
    """Checks stand and statics with MuJoCo's kinematics and dynamics of the MJCF."""
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
    for push in weld_pushes(robot, stand, prediction).values() if robot.welds else ():
        remainder[robot.mj_convention.qvel_index] -= push
    joints = robot.mj_convention.qvel_index[-robot.nu :]
    if robot.closure is not None:
        remainder[joints] -= robot.closure.push(stand.qpos) @ remainder[joints]
    remainder[joints] -= prediction.joint_torques
    return float(np.abs(remainder).max())


STABLE_DEVIATION = 5e-3
"""A stand is stable if the base's height deviates by less than this in the last second (m)."""

JOINT_TOLERANCE = 1e-3
"""Joint error that a verified stand may have with feed-forward (rad)."""

FORCE_TOLERANCE = 1e-2
"""Relative error that a verified stand's torques and foot forces may have with feed-forward."""

LIGHT = 0.05
"""Share of the weight below which a foot's force is not what its error is measured by."""

ANOTHER_ROBOT = 1e-3
"""Share of the weight by which MuJoCo's balance may be off; 1e-6 is what rounded files leave."""

LEVER = 1e-3
"""The robot's weight on this lever (m) is what deviations of torques are measured by where less is
predicted: joints about vertical axes hold nothing."""

SETTLED_DRIFT = 5e-4
"""A base whose height changes faster than this in the last second has not settled (m/s)."""

_SAMPLE_TIME = 0.02  # s between the states that are looked at closely
NUDGED = 7 / 12  # of the time by default: 5 s to settle, and 7 s in which 1e-3 must be forgotten
_FRAME = 0.1  # s between those that are kept: an eye sees what it does, and results stay small


@dataclass(frozen=True, eq=False, kw_only=True)
class StandVerification(Outcome, SimulationSettings, Tabular):
    """What a simulation made of a stand, against the prediction, and the ``SimulationSettings``.

    Settled values are means over the last second before the nudge. Predictions are Pinocchio's,
    from the URDF. Of a robot that its file fixes, heights, ways and tilts of the base are 0.

    Attributes:
        passed: Whether the stand is verified.
        failures: If not, why.
        stays: Whether it stands still on its feet and does so again after the nudge, as predicted
            or not.
        collapses: Whether it has diverged, fallen over, sunk or been thrown up by 30 % of its
            height at the end; of one whose base is fixed, whether a joint ends far from the stand.
        base_height: Settled (m).
        height_deviation: Standard deviation of the base's height in that second (m).
        height_drift: Rate of the base's height in that second (m/s): still sinking if negative.
        height_loss: Task's height less the settled one (m); the sum of the next two.
        servo_sag: The part lost in the joints (m).
        contact_sag: The part lost in the softness of feet and ground (m).
        tilt: Angle of the base's orientation at the end against the task's (rad).
        foot_slip: {foot: horizontal distance from its target} at the end (m); of one on a plane of
            its own along that.
        joint_error: The largest deviation of a joint from the stand in that second (rad).
        joint_positions: (nu,) settled (rad, m).
        joint_torques: (nu,) of the motors, settled (N m).
        predicted_torques: (nu,) (N m).
        torque_error: Largest deviation / largest predicted torque, or that of the weight on
            ``LEVER``, if that is more.
        foot_forces: {foot: (3,)} of the ground on the foot, settled, in world axes (N); of what is
            welded or grips, that of MuJoCo's constraint.
        predicted_forces: {foot: (3,)} (N); likewise.
        force_error: Largest deviation of a vertical foot force / its prediction (or / ``LIGHT`` of
            the weight, where a foot is predicted to carry less than that); on a plane of its own
            the force that presses counts, and of a grip all of it. None where no foot carries.
        mujoco_residual: Largest element of g - J^T f - S^T tau with MuJoCo's g and J and the
            predicted f and tau (N, N m), less what closed loops carry.
        stability: Of where it settled: the modes that grow, and the margin; where it fell, of
            where it began.
        nudge: What became of the nudge; None if it was not given.
        time: (n,) samples (s).
        height: (n,) the base's height at these (m).
        motion_time: (m,) fewer samples (s).
        motion: (m, nq) the configurations at these, to six digits: to be looked at.
    """

    stays: bool
    base_height: float = field(metadata={"unit": "m"})
    height_deviation: float = field(metadata={"unit": "m"})
    height_drift: float = field(metadata={"unit": "m/s"})
    height_loss: float = field(metadata={"unit": "m"})
    servo_sag: float = field(metadata={"unit": "m"})
    contact_sag: float = field(metadata={"unit": "m"})
    tilt: float = field(metadata={"unit": "rad"})
    foot_slip: dict[str, float] = field(metadata={"unit": "m"})
    joint_error: float = field(metadata={"unit": "rad"})
    joint_positions: Array = field(metadata={"unit": "rad or m"})
    joint_torques: Array = field(metadata={"unit": "N m"})
    predicted_torques: Array = field(metadata={"unit": "N m"})
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
        return {"time": self.time, "height": self.height}


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
) -> StandVerification:
    """Simulates a stand on the floating base, and compares it with Pinocchio's prediction.

    Or a posture of a robot whose base is fixed (``held_stand``).

    The prediction is ``gravity_compensation`` with minimum tangential forces: the equilibrium that
    lasts in a simulator whose friction creeps. MuJoCo's ground is soft: where the feet bear unequal
    loads a stand for rigid ground tilts by milliradians, and the loads change by percents;
    ``solve_stand_on_soft_ground`` is the stand that does hold as predicted.

    What it settles at is measured first. Then everything is nudged (``NUDGE``), and must come to
    rest again; and no mode of the step's spectrum may grow within ``HOLD_DURATION`` (12 s), nor
    shake at all, so that it stands for longer than is simulated.

    Args:
        robot: The robot.
        stand: How it shall stand.
        feedforward: Command ctrl = q* + tau / kp instead of ctrl = q*.
        kp: Servo stiffness (N m/rad); the model's own by default.
        kd: Servo damping (N m s/rad); the model's own by default.
        integrator: MuJoCo's integrator; the model's own by default.
        duration: Simulated time (s), at least 2.
        nudged: The part of it after the nudge (s); 7 of 12 by default. 0: it is not nudged, and
            what it settles at is measured at the end.
        settled: Where it is predicted to rest without feed-forward: what nothing but its fixed base
            holds, so that nothing creeps, is to do so.

    Returns:
        The comparison; ``failures`` says why a stand is not verified.

    Raises:
        ConfigurationError: If an argument is out of its range, or a stand's base is fixed.
        ModelError: If the model has no servos and no gains are given.
        StaticsInfeasibleError: If no contact forces balance the stand.
    """
    robot = check_stand(robot, stand, duration)
    after = _time_after(duration, nudged)
    held = begin_stand(robot, stand, feedforward=feedforward, kp=kp, kd=kd, integrator=integrator)
    robot, drive, prediction = held.robot, held.drive, held.prediction
    start, ctrl = held.start, held.ctrl
    upright = monitor.Upright.of(robot, stand.qpos, stand.task.rotation())
    run = settle_and_nudge(drive, start, ctrl, duration - after, after, upright.has_collapsed)
    predicted = robot.per_foot(prediction.contact_forces)
    out = stand.lift_directions(robot)
    borne = sum(force[2] for force in predicted.values())
    if robot.welds:  # which may bear more than all, and hands hold down
        borne = robot.weight
    light = LIGHT * borne
    shares = {foot: float(force @ out[foot]) / borne for foot, force in predicted.items()}
    loaded = {foot for foot, share in shares.items() if share >= monitor.LIGHT_FOOT}
    watch = watch_contacts(robot, drive.model, stand, run.states, ctrl, run.settling, loaded)
    found = replace(
        _measured(robot, stand, drive, prediction, run, watch, upright, light),
        feedforward=feedforward,
    )
    failures = _failures(robot, upright, run.states, watch, found)
    if failures:
        failures += find_creep(robot, stand, prediction)
    failures += find_instability(found.stability, found.nudge)
    stays = not failures
    if feedforward:
        failures += _deviations(robot, stand, watch, found)
    elif settled is not None and not settled.failures and robot.bolted and not stand.stance_feet:
        failures += _off_rest(robot, found, settled)
    failures += find_chatter(robot, drive, run.states, ctrl) if failures else []
    notes = [
        diagnose(
            "light-foot-lifts",
            subject=("foot", foot),
            share=Quantity(shares.get(foot, 0.0), "1"),
            time=Quantity(moment, "s"),
        )
        for foot, moment in watch.lifted.items()
    ]
    if not found.collapses:
        notes += describe_refuted(found.stability)
    return replace(
        found,
        passed=not failures,
        failures=tuple(failures),
        stays=stays,
        creep=None if found.collapses else measure_creep(robot, stand, drive.model, run.states),
        notes=tuple(notes),
    )


CREEP_TIME = 10.0
"""Time at the end of a simulation over which creep is measured (s)."""


def measure_creep(robot: Robot, stand: Stand, model: mujoco.MjModel, states: Array) -> Creep:
    """Measure the mean speeds of base, feet and joints over the last ``CREEP_TIME`` of states."""
    steps = min(round(CREEP_TIME / float(model.opt.timestep)), len(states) - 1)
    first, last = states[-1 - steps], states[-1]
    duration = float(last[0] - first[0])
    data, centres = mujoco.MjData(model), []
    for state in (first, last):
        mujoco.mj_setState(model, data, state, STATE)
        mujoco.mj_kinematics(model, data)
        centres.append(monitor.foot_centres(robot, data))
    ways = [np.linalg.norm(centres[1][foot] - centres[0][foot]) for foot in stand.stance_feet]
    joints = np.abs(last - first)[1 + robot.mj_convention.qpos_index[-robot.nu :]]
    turned = 0.0
    if robot.floating:
        place = 1 + robot.mj_convention.qpos_index[:7]
        ways.append(np.linalg.norm(last[place[:3]] - first[place[:3]]))
        rotation = rotation_from_quaternion(first[place[3:]])
        turned = monitor.turned_by(robot, rotation, last)
    rate = max(float(joints.max(initial=0.0)), turned) / duration
    return Creep(duration, float(max(ways, default=0.0)) / duration, rate)


def _time_after(duration: float, nudged: float | None) -> float:
    """Returns for how long a nudge is simulated (s).

    Raises:
        ConfigurationError: If it leaves less than a second, in which it settles.
    """
    most = duration - LAST
    if nudged is None:
        return min(NUDGED * duration, most)
    if not 0 <= nudged <= most:
        problem = diagnose("not-between", given=f"{nudged} s", low=0, high=Quantity(most, "s"))
        raise ConfigurationError("nudged", problem)
    return nudged


@dataclass(frozen=True, eq=False)
class Settled:
    """What became of a command.

    Attributes:
        states: (n, size) after each step.
        settling: How many of them are before the nudge.
        last: The last second of these.
        diverged: Whether they broke down.
        stability: Of where it settled.
        nudge: What became of the nudge; None if it was not given.
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
    after: float,
    lost: Callable[[Array], bool],
) -> Settled:
    """Simulates what a state settles at under a command, and then what becomes of a nudge.

    Args:
        drive: What is simulated.
        start: (size,) the state.
        ctrl: (nu,) the command.
        seconds: For how long it settles (s).
        after: How long the nudge is simulated (s); 0: there is none.
        lost: Tells whether a state is no longer what was to be held.
    """
    model = drive.model
    timestep = float(model.opt.timestep)
    quiet = simulate(model, start, np.tile(ctrl, (max(2, round(seconds / timestep)), 1)))
    diverged, last = monitor.has_diverged(quiet, timestep), quiet[-round(LAST / timestep) :]
    gone = diverged or lost(quiet[-1])
    judged, states, nudge = stability_after(drive, start, quiet[-1], ctrl, lost=gone), quiet, None
    if after and not diverged:
        later = simulate_nudge(model, quiet[-1], ctrl, after)
        nudge = measure_response(model, quiet[-1], later, last)
        states = np.concatenate([quiet, later])
    return Settled(states, len(quiet), last, diverged, judged, nudge)


@np.errstate(invalid="ignore", over="ignore")  # of what has diverged: it is judged to have
def _measured(
    robot: Robot,
    stand: Stand,
    drive: Servos,
    prediction: GravityCompensation,
    run: Settled,
    watch: Watch,
    upright: monitor.Upright,
    light: float,
) -> StandVerification:
    """Compares a rollout with what was predicted, and does not judge it yet.

    A foot's force is compared with what was predicted for it, or with ``light`` (N) if that is
    more.
    """
    timestep = float(drive.model.opt.timestep)
    states, settled, drops = run.states, run.last, watch.drops(stand)
    resting = monitor.base_heights(robot, settled)
    base_height = float(resting.mean())
    height_loss = float(stand.qpos[2]) - base_height if robot.floating else 0.0
    contact_sag = stand.base_drop(robot, drops)
    joints = settled[:, 1 + robot.mj_convention.qpos_index[-robot.nu :]]
    joint_error = float(np.abs(joints - stand.joint_positions(robot)).max())
    off = float(np.abs(watch.torques - prediction.joint_torques).max())
    predicted = robot.per_foot(prediction.contact_forces)
    out = stand.lift_directions(robot)
    errors = [
        abs(float((watch.forces[foot] - force) @ out[foot])) / max(float(force @ out[foot]), light)
        for foot, force in predicted.items()
    ]
    held = {name: wrench[:3] for name, wrench in prediction.weld_wrenches.items()}
    for name in robot.grips:
        off_grip = float(np.linalg.norm(watch.forces[name] - held[name]))
        errors.append(off_grip / max(float(np.linalg.norm(held[name])), light))
    step, frame = (max(1, round(every / timestep)) for every in (_SAMPLE_TIME, _FRAME))
    return StandVerification(
        passed=True,
        failures=(),
        stays=True,
        collapses=upright.has_collapsed(states[-1]) or monitor.has_diverged(states, timestep),
        feedforward=True,
        integrator=drive.integrator,
        timestep=timestep,
        duration=len(states) * timestep,
        kp=drive.kp,
        kd=drive.kd,
        base_height=base_height,
        height_deviation=float(resting.std()),
        height_drift=float(resting[-1] - resting[0]) / (timestep * (len(resting) - 1)),
        height_loss=height_loss,
        servo_sag=height_loss - contact_sag,
        contact_sag=contact_sag,
        tilt=monitor.turned_by(robot, stand.task.rotation(), states[-1]),
        foot_slip={
            foot: max(
                float(np.linalg.norm(project_perpendicular(drops[point], out[foot])))
                for point in robot.feet[foot]
            )
            for foot in robot.feet_with(drops)
        },
        joint_error=joint_error,
        joint_positions=joints.mean(axis=0),
        joint_torques=watch.torques,
        predicted_torques=prediction.joint_torques,
        torque_error=off / torque_scale(robot, prediction.joint_torques),
        foot_forces=watch.forces,
        predicted_forces=predicted | held,
        force_error=max(errors, default=None),
        mujoco_residual=balance_by_mujoco(robot, stand, prediction),
        stability=run.stability,
        nudge=run.nudge,
        time=states[::step, 0].copy(),
        height=monitor.base_heights(robot, states[::step]).copy(),
        motion_time=states[::frame, 0].copy(),
        motion=np.round(states[::frame, 1 + robot.mj_convention.qpos_index], 6),
    )


def _failures(
    robot: Robot, upright: monitor.Upright, states: Array, watch: Watch, found: StandVerification
) -> list[Diagnostic]:
    """Says why the robot does not stand still on its feet, if it does not."""
    failures = list(watch.failures)
    if monitor.has_diverged(states, found.timestep):
        failures.insert(0, monitor.tell_divergence(found.integrator, found.timestep))
    if upright.has_fallen(states[-1]):
        height = float(monitor.base_heights(robot, states[-1]))
        failures.insert(0, monitor.tell_fall(upright.lean(states[-1]), height))
    if robot.bolted and upright.has_collapsed(states[-1]):
        failures.append(diagnose("posture-left"))
    if not found.height_deviation < STABLE_DEVIATION:
        deviation = Quantity(found.height_deviation, "m")
        failures.append(diagnose("height-deviates", deviation=deviation))
    if not abs(found.height_drift) < SETTLED_DRIFT:
        drift = Quantity(found.height_drift, "m/s")
        failures.append(diagnose("height-drifts", drift=drift))
    return failures


def torque_scale(robot: Robot, torques: Array) -> float:
    """Returns what deviations of torques are measured by (N m): the largest; see ``LEVER``."""
    return max(float(np.abs(torques).max()), LEVER * robot.usual_weight)


def dry_friction(robot: Robot, kp: Array) -> tuple[Array, Array]:
    """Returns what joints (nu,) rub with (N m, N), and how far servos let them stick (rad, m)."""
    rubbing = robot.mj_model.dof_frictionloss[robot.mj_convention.qvel_index[-robot.nu :]]
    return rubbing, np.divide(rubbing, kp, out=np.zeros(robot.nu), where=kp > 0)


def _off_rest(robot: Robot, found: StandVerification, settled: SteadyState) -> list[Diagnostic]:
    """Says so if it rests elsewhere than predicted, by more than dry friction may hold it."""
    rubbing, way = dry_friction(robot, found.kp)
    scale, joints = torque_scale(robot, settled.joint_torques), settled.qpos[-robot.nu :]
    torques = float(np.abs(found.joint_torques - settled.joint_torques).max()) / scale
    moved = float(np.abs(found.joint_positions - joints).max())
    off = deviations(moved, torques, float(way.max()), rubbing.max() / scale)
    return [*off, *drive_limits(robot, found, settled.joint_torques, joints)] if off else []


def deviations(
    joint: float,
    torque: float,
    way: float = 0.0,
    share: float = 0.0,
    details: Mapping[str, Any] = MappingProxyType({}),
) -> list[Diagnostic]:
    """Return the deviations of joints and torques that exceed the tolerances.

    Args:
        joint: Largest deviation of a joint [rad].
        torque: Largest deviation of a torque, in parts of the largest torque.
        way: Deviation of a joint that dry friction may cause [rad].
        share: Deviation of a torque that dry friction may cause, in parts of the largest torque.
        details: Joint with the largest deviation of a torque; predicted and simulated torque.
    """
    off = []
    if not joint < JOINT_TOLERANCE + way:
        off.append(diagnose("joint-off", error=Quantity(joint, "rad")))
    if not torque < FORCE_TOLERANCE + share:
        numbers = dict.fromkeys(("joint", "predicted", "simulated")) | dict(details)
        off.append(diagnose("motor-torque-off", error=torque, **numbers))
    return off


_SATURATED = 1e-6
"""A motor that is so near to its limit, in parts of it, gives all it can."""


def drive_limits(
    robot: Robot, run: StandVerification, predicted: Array, positions: Array
) -> list[Diagnostic]:
    """Says which motors give all they can, and which servos cannot be commanded so far.

    Args:
        robot: The robot.
        run: A simulation that is not as predicted.
        predicted: (nu,) as predicted (N m).
        positions: (nu,) where its joints were predicted to be (rad).
    """
    weakest, strongest = robot.effort_ranges.T * (1 - _SATURATED)
    full = (run.joint_torques <= weakest) | (run.joint_torques >= strongest)
    low, high = command_ranges(robot).T
    command = positions + compute_command_lead(predicted, run.kp)
    cut = ((command < low) | (command > high)) & run.feedforward
    names, told = np.array(robot.joint_names), []
    if full.any():
        joints = names[full].tolist()
        told.append(diagnose("motors-give-all", joints=joints, released=not run.feedforward))
    if cut.any():
        told.append(diagnose("commands-cut-off", joints=names[cut].tolist()))
    return told


def two_robots(robot: Robot, residual: float, weight: float) -> list[Diagnostic]:
    """Says so if MuJoCo's balance is off (N, N m) by more of a weight (N) than one robot's is."""
    if not residual > ANOTHER_ROBOT * weight:
        return []
    mjcf = Quantity(robot.mj_model.body_subtreemass[0], "kg")
    urdf = Quantity(robot.total_mass, "kg")
    return [diagnose("files-of-two-robots", mjcf=mjcf, residual=residual, urdf=urdf)]


def _deviations(
    robot: Robot,
    stand: Stand,
    watch: Watch,
    found: StandVerification,
) -> list[Diagnostic]:
    """Says what is not as predicted."""
    errors = np.abs(found.joint_torques - found.predicted_torques)
    worst = int(np.argmax(np.nan_to_num(errors)))
    details = {
        "joint": robot.joint_names[worst],
        "predicted": Quantity(float(found.predicted_torques[worst]), "N m"),
        "simulated": Quantity(float(found.joint_torques[worst]), "N m"),
    }
    off = deviations(found.joint_error, found.torque_error, details=details)
    if found.force_error is not None and not found.force_error < FORCE_TOLERANCE:
        off.append(diagnose("foot-force-off", error=found.force_error))
    weight = robot.usual_weight
    if off:
        off += drive_limits(robot, found, found.predicted_torques, stand.joint_positions(robot))
    if off and (two := two_robots(robot, found.mujoco_residual, weight)):
        return [*off, *two]
    if off and watch.touching:
        return [*off, *(diagnose("parts-touch", bodies=pair) for pair in watch.touching)]
    return off
