"""Simulation of a path in MuJoCo, with servo commands that include feed-forward.

`path_commands` adapts a path to MuJoCo's soft ground and computes servo commands for each time
step. `track_path` simulates the commands and compares the motion with the path. `study_path` plans
and simulates the path from the nominal stand to a requested stance.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.array_types import Array
from pupper_analysis.base.arrays import rotation_from_quaternion
from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.base.frozen import FrozenDict
from pupper_analysis.base.results import Result
from pupper_analysis.base.units import (
    DAMPING_UNIT,
    POSITION_UNIT,
    STIFFNESS_UNIT,
)
from pupper_analysis.models.motors.energy import MotorEnergy, compute_motor_energy
from pupper_analysis.models.motors.motor import Motor
from pupper_analysis.prepare.judge import judge_simulation
from pupper_analysis.robot.compliance import GroundLaw
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import (
    Servos,
    integrate_servo_damping,
    model_with_servos,
    read_torque_ranges,
)
from pupper_analysis.robot.terrain import build_on_ground
from pupper_analysis.simulation import monitor
from pupper_analysis.simulation.causes import describe_growth
from pupper_analysis.simulation.rollout import place_on_ground, simulate_commands
from pupper_analysis.simulation.servo_bounds import bound_explicit_damping
from pupper_analysis.simulation.stability import stand_stability
from pupper_analysis.simulation.verdict import Outcome, Question, Verdict
from pupper_analysis.simulation.verify import find_worst_unit
from pupper_analysis.stance.problem import ground_normals
from pupper_analysis.stance.soft_ground import solve_stand_as_simulated
from pupper_analysis.stance.stand import Stand, solve_stand, stand_statics
from pupper_analysis.stance.task import StandTask
from pupper_analysis.tools.path.dynamics import joint_resistance
from pupper_analysis.tools.path.plan import StancePath, stance_path

MAX_TIMESTEP = 2.5e-4
"""Upper bound of the default time step [s]. An implicit integrator adds kd x time step to the
inertia of a joint, which the contacts ignore. Measured if the Pupper variant ``original`` lifts a
foot by 20 mm in 0.5 s: the torque error is larger than at 0.1 ms, by 17.5 % of the largest torque
at 4 ms, 2 % at 1 ms, and 0.4 % at this bound."""

_SPLINE_ENDS = ("clamped", "not-a-knot")
"""Boundary conditions of the cubic splines of configurations over time, at the start and at the
end. The path starts at rest. The velocity at the end is not prescribed, because the last time step
of the simulation may end before the path."""

_NEWTON_STEPS = 2
"""Number of Newton iterations that extend the legs by the penetration of the ground. Chosen, not
tuned."""

_MAX_ADDED_INERTIA = 0.075
"""Upper bound of kd x time step / joint inertia [1], from which `_select_timestep` computes the
time step, since an implicit integrator adds kd x time step to the inertia of a joint.
`MIN_TIMESTEP` has priority. Chosen as the ratio of the Pupper variant ``original`` at
`MAX_TIMESTEP`. Measured if A1 squats to 80 % of its height in 0.4 s: the torque error is 9 % with a
ratio of 0.5, and 3 % with 0.07.
"""

MIN_TIMESTEP = 1e-5
"""Lower bound of the time step [s] that is computed from joint inertia and servo damping. The model
may have a smaller time step. Chosen, not tuned.
"""

_STEP_ROUNDING = 1e-6
"""Rounding tolerance [time steps] when the number of whole time steps in a duration is computed.
Chosen, not tuned.
"""


@dataclass(frozen=True, eq=False)
class PathCommands:
    """Path and servo commands at the n time steps of a simulation.

    Attributes:
        path: Path for rigid ground.
        robot: Robot on the ground of the path.
        drive: MuJoCo model of the robot, with servos.
        start: Full physics state of MuJoCo, at rest in the first stance.
        time: Shape (n,) [s]; time at the end of each step.
        qpos: Shape (n, nq); configuration of the path at the end of each step, with legs extended
            by the penetration of the feet.
        torques: Shape (n, nu) [N m, or N for a slide]; motor torques at the start of each step, for
            extended legs.
        ctrl: Shape (n, nu); command during each step: q* + (tau + kd dq*/dt) / kp, in the units of
            the actuators.
    """

    path: StancePath
    robot: Robot
    drive: Servos
    start: Array
    time: Array
    qpos: Array
    torques: Array
    ctrl: Array


def path_commands(
    robot: Robot,
    path: StancePath,
    drive_of: Callable[[Robot], Servos] = model_with_servos,
    timestep: float | None = None,
) -> PathCommands:
    """Compute the servo commands q* + (tau + kd dq*/dt) / kp for each time step of a path.

    Args:
        robot: Robot.
        path: Path of this robot.
        drive_of: Function that returns the servos of a robot. Default: the servos of the model.
        timestep: Time step of the simulation [s], as in ``track_path``.

    Raises:
        ConfigurationError: If an argument is out of range, or the path belongs to another robot.
        ModelError: If a joint has no motor or no position servo, for example.
    """
    from scipy.interpolate import CubicSpline

    if path.joint_names != robot.joint_names or path.qpos.shape[1] != robot.nq:
        raise ConfigurationError("path", diagnose("path-of-another-robot", robot=robot.name))
    first = path.stances[0]
    robot = build_on_ground(first.check(robot), first.task.ground, first.rigid_targets)
    drive = drive_of(robot)
    if timestep is None:
        timestep = _select_timestep(robot, first, drive)
    elif not 1e-6 <= timestep <= 1.0:
        raise ConfigurationError("timestep", diagnose("timestep-not-valid", given=timestep))
    drive.model.opt.timestep = timestep
    robot = replace(robot, mj_model=drive.model)  # a contact may depend on the time step
    steps = max(1, math.floor(float(path.time[-1]) / timestep + _STEP_ROUNDING))
    times: Array = np.linspace(timestep, steps * timestep, steps)
    sunk, motors = _extend_legs(robot, path)
    first = replace(first, qpos=sunk[0])
    spline, starts = CubicSpline(path.time, sunk, bc_type=_SPLINE_ENDS), times - timestep
    joints, end = slice(robot.nq - robot.nu, None), path.time[-1]
    torques = CubicSpline(path.time, motors)(np.minimum(starts, end))
    # MuJoCo's velocity is the difference of positions over a step. Servo damping acts on the
    # velocity at the start of the step or, with an implicit integrator, at its end.
    damped = times if drive.is_implicit else starts
    places = [np.clip(moments, 0.0, end) for moments in (damped - timestep, damped)]
    rates = (spline(places[1]) - spline(places[0]))[:, joints] / timestep
    ahead = spline(np.minimum(starts, end))[:, joints] + rates * drive.kd / drive.kp
    return PathCommands(
        path=path,
        robot=robot,
        drive=drive,
        start=place_on_ground(robot, drive, first, torques[0]),
        time=times,
        qpos=spline(np.minimum(times, end)),
        torques=torques,
        ctrl=drive.command(robot, ahead, torques),
    )


def _extend_legs(robot: Robot, path: StancePath) -> tuple[Array, Array]:
    """Adapt a path for rigid ground to MuJoCo's soft ground, by extending the legs.

    Creep of rolling feet and the inertia of sinking legs are not modelled.

    Returns:
        Configurations, shape (n, nq), and motor torques, shape (n, nu) [N m, or N for a slide].
    """
    from scipy.interpolate import CubicSpline

    normal_of = ground_normals(robot, path.stances[0].task.ground)
    normals = np.array([normal_of[foot] for foot in path.feet])
    laws = [GroundLaw.of_contact(robot, foot) for foot in path.feet]
    radius = np.array([robot.contact_radius[foot] for foot in path.feet])
    pressing = np.maximum((path.forces * normals).sum(axis=-1), 0.0)
    depths = np.array(
        [
            _compute_depths(law, loads, path.time)
            for law, loads in zip(laws, pressing.T, strict=True)
        ]
    ).T
    rows = []
    for qpos, depth in zip(path.qpos, depths, strict=True):
        config = Configuration(robot, qpos)
        targets = config.foot_centres(path.feet) - depth[:, None] * normals
        for _ in range(_NEWTON_STEPS):
            error = (targets - config.foot_centres(path.feet)).ravel()
            jacobians = config.foot_jacobians()
            legs = np.concatenate([jacobians[foot][:, 6:] for foot in path.feet])
            step = np.concatenate([np.zeros(7), np.linalg.lstsq(legs, error, rcond=1e-6)[0]])
            config = Configuration(robot, config.qpos + step)
        rows.append(config.qpos)
    extension = CubicSpline(path.time, (np.array(rows) - path.qpos)[:, 7:], bc_type=_SPLINE_ENDS)
    base = np.zeros((len(rows), 6))
    qvel = path.qvel + np.hstack([base, extension(path.time, 1)])
    qacc = path.qacc + np.hstack([base, extension(path.time, 2)])
    torques = []
    for index, qpos in enumerate(rows):
        config = Configuration(robot, qpos, qvel[index])
        # MuJoCo's contact point is at half the penetration.
        touching = -(radius - depths[index] / 2)[:, None] * normals
        contacts = config.point_jacobians(path.feet, touching)
        left = (
            config.mass_matrix() @ path.qacc[index] + config.bias_forces() - config.passive_forces()
        )
        left += joint_resistance(robot, qvel[index], qacc[index])
        left -= np.einsum("nij,ni->j", contacts, path.forces[index])
        for foot, moment in zip(path.feet, path.moments[index], strict=True):
            left -= config.frame_jacobian(robot.contact_frames[foot])[3:].T @ moment
        # The extended legs shift the CoM. Distribute the change of the total wrench over the feet
        # in proportion to their loads.
        jacobian = (pressing[index][:, None, None] * contacts).reshape(-1, robot.nv)
        more = np.linalg.lstsq(jacobian[:, :6].T, left[:6], rcond=1e-9)[0]
        torques.append((left - more @ jacobian)[robot.nv - robot.nu :])
    return np.array(rows), np.array(torques)


def _compute_depths(law: GroundLaw, loads: Array, time: Array) -> Array:
    """Compute the penetration of a foot, shape (n,) [m], under time-varying loads, shape (n,) [N].

    MuJoCo's contact satisfies R f = k d r + b dr/dt + d2r/dt2. f is the force, r the penetration, d
    the impedance, and R the regularisation; k and b are stiffness and damping of the ground law.
    For a load that is linear in ``time``, shape (n,) [s], the penetration is approximately the
    static depth for the load at an earlier time, by b / (k d).
    """
    depths = np.array([law.depth(load) for load in loads])
    lag = law.damping / (law.stiffness * law.impedance(float(depths.mean())))
    delayed: Array = np.interp(time - lag, time, depths)
    return delayed


def _select_timestep(robot: Robot, first: Stand, drive: Servos) -> float:
    """Select a time step [s] for which implicit servo damping adds little to joint inertias."""
    inertia = np.diag(Configuration(robot, first.qpos).mass_matrix())[robot.nv - robot.nu :]
    damped = drive.kd > 0
    shortest_decay = float(np.min(inertia[damped] / drive.kd[damped], initial=math.inf))
    upper = min(float(drive.model.opt.timestep), MAX_TIMESTEP)
    return min(upper, max(MIN_TIMESTEP, _MAX_ADDED_INERTIA * shortest_decay))


@dataclass(frozen=True, eq=False)
class PathThere(Result):
    """Path from the nominal stand to a stance, with a simulation.

    Attributes:
        name: Name of the robot.
        stand: Stand at the end of the path.
        path: Path.
        tracking: Result of the simulation.
        verdict: Verdict on tracking, and the conditions.
        largest_kd_factor: Largest factor on the damping with which an explicit PD controller is
            stable in the final stand (`ServoBounds`); None without a bound, and if the path fails.
    """

    _key_fields: ClassVar[tuple[str, ...]] = ("verdict", "name")

    name: str
    stand: Stand
    path: StancePath
    tracking: PathTracking
    verdict: Verdict
    largest_kd_factor: float | None = field(default=None, metadata={"unit": "1"})

    @property
    def passed(self) -> bool:
        """Whether the verdict on the tracking of the path in simulation is positive."""
        return self.verdict.passed


def study_path(
    robot: Robot,
    task: StandTask,
    seconds: float,
    *,
    kp: ArrayLike | None = None,
    kd: ArrayLike | None = None,
    motors: Mapping[str, Motor] | None = None,
) -> PathThere:
    """Plan a path from the nominal stand to a stance, simulate it, and judge the tracking.

    Args:
        robot: Robot.
        task: Requested stance.
        seconds: Duration of the path [s].
        kp: Servo stiffness [N m/rad, N/m], scalar or shape (nu,). Default: the gains of the model.
        kd: Servo damping [N m s/rad, N s/m], scalar or shape (nu,). Default: the gains of the
            model.
        motors: {joint: motor}, for the utilisation in the torque-speed region of the motors and
            the electrical energy. The simulation limits torques by the effort limits of the robot
            only.

    Returns:
        Stand at the end, path, tracking and verdict. The verdict requires a tracked path, and a
        stable final stand: no mode of the linearised dynamics grows within 12 s.

    Raises:
        ConfigurationError: If an argument is invalid for the robot, or the base is fixed, for
            example.
        StanceUnreachableError: If the stance, or a sample of the path, is out of reach.
        StaticsInfeasibleError: If the stance, or a sample of the path, cannot be held.
    """
    stand, path = plan_path(robot, task, seconds, motors=motors)
    return simulate_path(robot, stand, path, kp=kp, kd=kd, motors=motors)


def plan_path(
    robot: Robot,
    task: StandTask,
    seconds: float,
    *,
    motors: Mapping[str, Motor] | None = None,
) -> tuple[Stand, StancePath]:
    """Plan a path from the nominal stand to a stance, without a simulation.

    Returns the stand at the end, and the path. Arguments and errors: `study_path`.
    """
    stand = solve_stand(robot, task)
    return stand, stance_path(robot, plan_stances(robot, stand), seconds, motors=motors)


def simulate_path(
    robot: Robot,
    stand: Stand,
    path: StancePath,
    *,
    kp: ArrayLike | None = None,
    kd: ArrayLike | None = None,
    motors: Mapping[str, Motor] | None = None,
) -> PathThere:
    """Simulate a path that ends at a stand, and judge the tracking.

    ``stand`` and ``path`` are results of `plan_path`. Other arguments, and errors: `study_path`.
    """
    tracking = track_path(robot, path, kp=kp, kd=kd, motors=motors)
    # An instability of the final stand can need more time to develop than the path takes.
    held = solve_stand_as_simulated(robot, stand)
    stability = stand_stability(robot, held, kp=kp, kd=kd)
    leaving = tuple(map(describe_growth, stability.modes_growing_within()[:1]))
    ran = Outcome(
        passed=tracking.passed and not leaving,
        failures=(*tracking.failures, *leaving),
        duration=float(path.time[-1]),
        torque_error=tracking.torque_error,
        stability=stability,
    )
    verdict = judge_simulation(
        robot,
        stand,
        ran,
        statics=stand_statics(robot, held),
        question=Question.TRACKED,
        kp=kp,
        kd=kd,
    )
    factor = None
    if verdict.passed:
        with contextlib.suppress(ConfigurationError):  # a diverging step has no linear model
            factor = bound_explicit_damping(robot, held, kp=kp, kd=kd)
    return PathThere(
        name=robot.name,
        stand=stand,
        path=path,
        tracking=tracking,
        verdict=verdict,
        largest_kd_factor=factor,
    )


def plan_stances(robot: Robot, stand: Stand) -> list[StandTask]:
    """Return the stand tasks on a path that starts at the nominal base pose and ends at a stand.

    If the stand lifts a foot, a task with all feet on the ground is in between.
    """
    task = stand.task
    x, y, _ = Configuration(robot, stand.qpos).center_of_mass()
    final = replace(task, com=(float(x), float(y)), com_margin=0.0, offset=None)
    nominal = StandTask(
        feet=task.feet,
        foot_offsets=task.foot_offsets,
        ground=task.ground,
        ik_seed=task.ik_seed,
    )
    return [nominal, *([replace(final, swing={})] if task.swing else []), final]


MAX_JOINT_ERROR = 0.1
"""Position error of a joint [rad, m] at and above which a simulated path counts as not tracked.
Chosen, not tuned.
"""

MAX_TORQUE_ERROR = 0.05
"""Torque error, divided by the largest torque of the path [1], above which a simulated path counts
as not tracked. Chosen, not tuned.
"""

MIN_LIFTED_HEIGHT = 2e-3
"""Planned height of a foot [m] above which the foot must not touch the ground in the simulation.
Chosen, not tuned.
"""

MIN_LOADED_FRACTION = 0.05
"""Planned load of a foot, divided by the robot's weight [1], above which the foot must touch the
ground in the simulation. Chosen, not tuned.
"""

_NUM_CHECKED_STATES = 400
"""Approximate number of simulated states whose contacts are checked, for paths of 0.4 to 8 s.
Chosen, not tuned.
"""


@dataclass(frozen=True, eq=False)
class PathTracking(Result):
    """Simulated motion of a path, compared with the plan.

    Attributes:
        passed: True if the path was tracked.
        failures: Reasons why the path was not tracked.
        integrator: Integrator of MuJoCo.
        timestep: Time step of the simulation.
        kp: Shape (nu,); servo stiffness.
        kd: Shape (nu,); servo damping.
        joint_error: Largest deviation of a joint position from the path with extended legs.
        joint_error_unit: Unit of ``joint_error``: rad, or m for a slide.
        height_error: Largest deviation of the height of the base.
        orientation_error: Largest angle between the orientation of the base and of the path, in
            the checked states. This error, ``torque_error`` and ``foot_slip`` are infinite if the
            simulation diverged.
        torque_error: Largest deviation of a motor torque from the commanded feed-forward, in any
            time step, divided by the largest torque of the path.
        foot_slip: {contact point: largest distance, along the ground, between the centre of the
            foot and the path, while the foot is loaded}. Rolling that differs from the path counts
            as well as sliding.
        energy: Electrical energy of the motors in the simulation; None without motors, or if the
            simulation diverged.
    """

    passed: bool
    failures: tuple[Diagnostic, ...]
    integrator: str
    timestep: float = field(metadata={"unit": "s"})
    kp: Array = field(metadata={"unit": STIFFNESS_UNIT})
    kd: Array = field(metadata={"unit": DAMPING_UNIT})
    joint_error: float = field(metadata={"unit": POSITION_UNIT})
    joint_error_unit: str
    height_error: float = field(metadata={"unit": "m"})
    orientation_error: float = field(metadata={"unit": "rad"})
    torque_error: float = field(metadata={"unit": "1"})
    foot_slip: dict[str, float] = field(metadata={"unit": "m"})
    energy: MotorEnergy | None = None


@check_arguments
def track_path(
    robot: Robot,
    path: StancePath,
    *,
    kp: ArrayLike | None = None,
    kd: ArrayLike | None = None,
    integrator: str | None = None,
    timestep: float | None = None,
    motors: Mapping[str, Motor] | None = None,
) -> PathTracking:
    """Simulate a path on the free base, with servo commands q* + (tau + kd dq*/dt) / kp.

    The velocity term compensates the servo damping, which acts on the absolute joint velocity;
    without this term the joints lag by kd / kp (20 ms for v3). The joint positions q* contain an
    extension of the legs. The extension equals the penetration of the feet into MuJoCo's soft
    ground under the loads of the motion. tau is computed for the extended legs. Creep of rolling
    feet is not compensated.

    A path is tracked if all these conditions hold:

    - The simulation does not diverge, and the robot does not fall.
    - Joint errors are below `MAX_JOINT_ERROR`; torque errors are at most `MAX_TORQUE_ERROR`.
    - No motor saturates; torques and speeds of the path are within the limits.
    - Loaded feet (`MIN_LOADED_FRACTION`) stay on the ground; lifted feet (`MIN_LIFTED_HEIGHT`) and
      other parts do not touch the ground.

    Contacts and falls are checked at intervals (`_NUM_CHECKED_STATES`).

    Args:
        robot: Robot without loops, couplings, welds and grips.
        path: Path of this robot.
        kp: Servo stiffness [N m/rad, N/m]. Default: the gains of the model.
        kd: Servo damping [N m s/rad, N s/m]. Default: the gains of the model.
        integrator: Integrator of MuJoCo. Default: the integrator of the model.
        timestep: Time step of the simulation [s]. Default: see ``_select_timestep``.
        motors: {joint: motor}, for the electrical energy.

    Raises:
        ConfigurationError: If an argument is out of range, the path belongs to another robot, or
            the robot has loops, couplings, welds or grips.
        ModelError: If a joint has no motor, or no position servo while kp and kd are not both
            given, or if the ground cannot be added (``build_on_ground``).
    """
    robot.check_tree("how a path is tracked")
    plan = path_commands(
        robot, path, lambda there: model_with_servos(there, kp, kd, integrator), timestep
    )
    robot, model, joints = plan.robot, plan.drive.model, slice(robot.nq - robot.nu, None)
    states = simulate_commands(model, plan.start, plan.ctrl)
    simulated = states[:, 1 + robot.mj_convention.qpos_index]
    deviation = simulated[:, joints] - plan.qpos[:, joints]
    joint_error = float(np.abs(deviation).max())
    unit = find_worst_unit(robot, np.abs(deviation).max(axis=0))

    timestep = float(model.opt.timestep)
    interval = min(max(float(path.time[-1]) / _NUM_CHECKED_STATES, 1e-3), 0.02)
    step = max(1, round(interval / timestep))
    evaluations = np.arange(step - 1, len(states), step)
    energy: MotorEnergy | None = None
    tilt, torque_error, slip = math.inf, math.inf, dict.fromkeys(path.feet, math.inf)
    if monitor.has_diverged(states, timestep):
        failures = [monitor.describe_divergence(plan.drive.integrator, timestep)]
    else:
        failures, tilt, slip = _check_states(plan, states, evaluations)
        torques = _compute_torques(plan, states)
        saturated, torque_error = _compare_torques(plan, *torques)
        failures += saturated
        if motors:
            dofs = 1 + model.nq + robot.mj_convention.qvel_index[robot.nv - robot.nu :]
            speeds = np.vstack([plan.start, states])[:, dofs]
            energy = compute_motor_energy(motors, robot.joint_names, torques[0], speeds, timestep)
    failures += _find_exceeded_limits(path)
    if not torque_error <= MAX_TORQUE_ERROR:
        failures.append(diagnose("motor-torque-off-path", error=torque_error))
    if not joint_error < MAX_JOINT_ERROR:
        failures.append(diagnose("joint-off-path", error=Quantity(joint_error, unit)))
    return PathTracking(
        passed=not failures,
        failures=tuple(failures),
        integrator=plan.drive.integrator,
        timestep=timestep,
        kp=plan.drive.kp,
        kd=plan.drive.kd,
        joint_error=joint_error,
        joint_error_unit=unit,
        height_error=float(np.abs(simulated[:, 2] - plan.qpos[:, 2]).max()),
        orientation_error=tilt,
        torque_error=torque_error,
        foot_slip=slip,
        energy=energy,
    )


def _find_exceeded_limits(path: StancePath) -> Iterator[Diagnostic]:
    """Yield a failure if a torque, and if a speed, of a path exceeds the limit of the joint."""
    if path.peak_utilisation > 1:
        share = _as_finite(path.peak_utilisation)
        motor = path.motors.get(path.peak_joint, "")
        yield diagnose("motor-overloaded-on-path", share=share, motor=motor)
    if path.peak_speed_utilisation > 1:
        fastest, share = ("joint", path.fastest_joint), _as_finite(path.peak_speed_utilisation)
        yield diagnose("joint-too-fast", subject=fastest, share=share)


def _compute_torques(plan: PathCommands, states: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Compute the simulated torques by the servo law, shape (n, nu) [N m, or N for a slide].

    Returns:
        Torques; mask, shape (n, nu), True if the motor saturates.
    """
    drive, robot, model = plan.drive, plan.robot, plan.drive.model
    public = robot.mj_convention
    history = np.vstack([plan.start, states])
    joints = slice(robot.nq - robot.nu, None)
    dofs = 1 + model.nq + public.qvel_index[robot.nv - robot.nu :]
    target = plan.ctrl[:, model.actuator_ctrladr[public.actuator_index]] / drive.gear
    positions, speeds = history[:-1, 1 + public.qpos_index[joints]], history[:, dofs]
    unlimited = drive.kp * (target - positions) - drive.kd * speeds[:-1]
    ranges = read_torque_ranges(model, public.actuator_index)
    torques = np.clip(unlimited, *ranges.T)
    applied = integrate_servo_damping(model, drive.kd, torques, speeds, ranges)
    return applied, torques != unlimited


def _compare_torques(
    plan: PathCommands, torques: Array, is_saturated: NDArray[np.bool_]
) -> tuple[list[Diagnostic], float]:
    """Describe saturated motors, and compute the largest torque error |simulated - planned| [1].

    The error is relative to the largest planned torque of the path on rigid ground.
    ``is_saturated`` is the mask of the saturated motors, shape (n, nu).
    """
    robot, events = plan.robot, []
    for column in np.flatnonzero(is_saturated.any(axis=0)):
        moment = Quantity(plan.time[int(np.argmax(is_saturated[:, column]))], "s")
        motor = "joint", robot.joint_names[int(column)]
        events.append(diagnose("motor-at-limit", subject=motor, time=moment))
    largest = float(np.abs(plan.path.torques).max())
    return events, float(np.abs(torques - plan.torques).max()) / largest


def _as_finite(utilisation: float) -> float | None:
    """Return a utilisation [1]; None if it is infinite (a limit of 0) or not a number."""
    return utilisation if math.isfinite(utilisation) else None


def _check_states(
    plan: PathCommands, states: Array, evaluations: NDArray[np.int64]
) -> tuple[list[Diagnostic], float, dict[str, float]]:
    """Check selected simulated states for wrong contacts, orientation errors, slip and falls.

    ``states`` (n, size) are the states at the end of each step, ``evaluations`` indices of states.

    Returns:
        Failures with the time of their first occurrence; largest orientation error of the base
        [rad]; {contact point: largest distance [m], along the ground, from its planned position
        while loaded}.
    """
    path, robot = plan.path, plan.robot
    watcher = monitor.ContactSampler(robot, plan.drive.model)
    events: dict[Diagnostic, float] = {}
    normals = ground_normals(robot, path.stances[0].task.ground)
    slip = dict.fromkeys(path.feet, 0.0)
    weight = robot.weight
    tilt = 0.0
    for index in evaluations:
        sight = watcher.sample(states[index], plan.ctrl[min(index + 1, len(plan.ctrl) - 1)])
        found = [
            diagnose(
                "body-touches-ground",
                subject=("body", body),
                surface=watcher.find_surface(body),
                time=None,
            )
            for body in sorted(sight.bodies)
        ]
        goal = plan.qpos[index]
        rotation = rotation_from_quaternion(goal[3:7] / np.linalg.norm(goal[3:7]))
        base = watcher.data.qpos[robot.mj_convention.qpos_index[:7]]
        turn = rotation.T @ rotation_from_quaternion(base[3:])
        tilt = max(tilt, float(np.linalg.norm(pin.log3(turn))))
        if monitor.StandReference.from_configuration(robot, goal, rotation).has_fallen(
            states[index]
        ):
            found.append(diagnose("fell-over", tilt=None, height=None, time=None))
        centres = monitor.foot_centres(robot, watcher.data)
        targets = Configuration(robot, goal).foot_positions()
        idle = sight.unloaded_feet(robot.feet)
        sample = int(np.abs(path.time - sight.time).argmin())
        for column, foot in enumerate(path.feet):
            load, parent = path.loads[sample, column] / weight, robot.foot_of(foot)
            # A negative load belongs to a foot that would have to be glued to the ground.
            if (load > MIN_LOADED_FRACTION or load < 0) and parent in idle:
                found.append(diagnose("foot-idle", subject=("foot", foot), time=None))
            if path.clearance[sample, column] > MIN_LIFTED_HEIGHT and parent in sight.forces:
                found.append(diagnose("lifted-foot-touches", subject=("foot", parent), time=None))
            if path.stance_feet[sample, column]:
                along_ground = np.cross(normals[foot], centres[foot] - targets[foot])
                slip[foot] = max(slip[foot], float(np.linalg.norm(along_ground)))
        for event in found:
            events.setdefault(event, sight.time)
    failures = [
        replace(event, values=FrozenDict({**event.values, "time": Quantity(moment, "s")}))
        for event, moment in events.items()
    ]
    return failures, tilt, slip
