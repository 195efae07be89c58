"""How MuJoCo tracks a path: through stances, or to one."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.arrays import rotation_from_quaternion
from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.base.frozen import FrozenDict
from pupper_analysis.base.results import Result
from pupper_analysis.prepare.judge import judge
from pupper_analysis.robot.compliance import GroundLaw
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import Servos, model_with_servos
from pupper_analysis.robot.terrain import on_ground
from pupper_analysis.simulation import monitor
from pupper_analysis.simulation.causes import describe_growth
from pupper_analysis.simulation.rollout import place_on_ground, simulate
from pupper_analysis.simulation.stability import stand_stability
from pupper_analysis.simulation.verdict import Asked, Outcome, Verdict
from pupper_analysis.stance.problem import ground_normals
from pupper_analysis.stance.soft_ground import solve_stand_as_simulated
from pupper_analysis.stance.stand import Stand, solve_stand, stand_statics
from pupper_analysis.stance.task import StandTask
from pupper_analysis.tools.path.dynamics import joint_resistance
from pupper_analysis.tools.path.plan import StancePath, stance_path

TIMESTEP = 2.5e-4
"""The longest time step of a simulation of a path (s). An implicit integrator moves joints as if
they had kd x the time step more inertia, and its contacts do not know: with 4 ms the skeleton's
torques are off by up to 15 % from that alone, with 1 ms by 4 %, with this by 1 %."""

_AT_REST = ("clamped", "not-a-knot")
"""Ends of splines of joints: a path begins at rest, and its last step may end short of its end."""

_STEPS = 2  # of Newton's iteration, for legs that get longer by millimetres

_ADDED = 0.075
"""Share of a joint's inertia that its servo's damping may seem to add within a time step: what it
is for the skeleton in ``TIMESTEP``. In that, it is half of the knee's inertia for A1 (kd 13 N m
s/rad, no rotors), whose fastest squat is then off by 17 %, and loses the ground; with 40 us by 3 %.
"""

FINEST = 1e-5
"""The shortest time step that is chosen (s): a path of a second then takes a second or two."""

_STEP_ROUNDING = 1e-6
"""Of a time step: what a path's time may be short of a number of them, by rounding."""


@dataclass(frozen=True, eq=False)
class PathCommands:
    """A path at the time steps of a simulation, and what the servos are commanded.

    Attributes:
        path: The path.
        robot: The robot on the path's ground.
        drive: Its MuJoCo model, with servos.
        start: The full physics state at rest in the first stance.
        time: (n,) after each step (s).
        qpos: (n, nq) of the path after each step, the legs longer by what their feet sink into the
            ground.
        torques: (n, nu) of the motors at the start of each step: the path's, for legs that are
            longer (N m).
        ctrl: (n, nu) during each step: q* + (tau + kd dq*/dt) / kp, in the actuators' units.
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
    """Returns what the servos are commanded, step by step.

    Args:
        robot: The robot.
        path: A path of this robot's.
        drive_of: Returns the servos of the robot on the path's ground; the model's own by default.
        timestep: As in ``track_path``.

    Raises:
        ConfigurationError: If an argument is out of its range, or the path is another robot's.
        ModelError: If the model has no servos and no gains are given.
    """
    from scipy.interpolate import CubicSpline

    if path.joint_names != robot.joint_names or path.qpos.shape[1] != robot.nq:
        raise ConfigurationError("path", diagnose("path-of-another-robot", robot=robot.name))
    first = path.stances[0]
    robot = on_ground(first.check(robot), first.task.ground, first.rigid_targets)
    drive = drive_of(robot)
    if timestep is None:
        timestep = _fine_timestep(robot, first, drive)
    elif not 1e-6 <= timestep <= 1.0:
        raise ConfigurationError("timestep", diagnose("timestep-not-valid", given=timestep))
    drive.model.opt.timestep = timestep
    robot = replace(robot, mj_model=drive.model)  # a contact may depend on the time step
    steps = max(1, math.floor(float(path.time[-1]) / timestep + _STEP_ROUNDING))
    times: Array = np.linspace(timestep, steps * timestep, steps)
    sunk, motors = _on_soft_ground(robot, path)
    first = replace(first, qpos=sunk[0])
    spline, starts = CubicSpline(path.time, sunk, bc_type=_AT_REST), times - timestep
    joints, end = slice(robot.nq - robot.nu, None), path.time[-1]
    torques = CubicSpline(path.time, motors)(np.minimum(starts, end))
    # MuJoCo's velocity is the difference of positions over a step. The servo's damping acts on the
    # one that leads to the step's start or, implicit, to its end.
    damped = times if drive.implicit else starts
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


def _on_soft_ground(robot: Robot, path: StancePath) -> tuple[Array, Array]:
    """Returns a path whose feet are sunk: configurations (n, nq), and torques (n, nu) (N m).

    The base stays, and each leg is longer by what its foot sinks under the force that it has in
    motion, a moment ago (``_depths``); joints resist as they then turn. With the rigid path's
    commands the robot would sink by those depths, and tilt where they are unequal: the lifts of the
    variants would be off by 13 % of torque, and so they are by 2 to 4 % (v3-long-leg's: 7). That
    feet creep as they roll, and the inertia of legs that sink, is left out.

    Args:
        robot: The robot on the path's ground.
        path: Its path, which is for rigid ground.
    """
    from scipy.interpolate import CubicSpline

    out = ground_normals(robot, path.stances[0].task.ground)
    normals = np.array([out[foot] for foot in path.feet])
    laws = [GroundLaw.of(robot, foot) for foot in path.feet]
    radius = np.array([robot.contact_radius[foot] for foot in path.feet])
    pressing = np.maximum((path.forces * normals).sum(axis=-1), 0.0)
    depths = np.array([_depths(*one, path.time) for one in zip(laws, pressing.T, strict=True)]).T
    rows = []
    for qpos, deep in zip(path.qpos, depths, strict=True):
        config = Configuration(robot, qpos)
        places = config.foot_places(path.feet) - deep[:, None] * normals
        for _ in range(_STEPS):
            missing = (places - config.foot_places(path.feet)).ravel()
            jacobians = config.foot_jacobians()
            legs = np.concatenate([jacobians[foot][:, 6:] for foot in path.feet])
            step = np.concatenate([np.zeros(7), np.linalg.lstsq(legs, missing, rcond=1e-6)[0]])
            config = Configuration(robot, config.qpos + step)
        rows.append(config.qpos)
    longer = CubicSpline(path.time, (np.array(rows) - path.qpos)[:, 7:], bc_type=_AT_REST)
    base = np.zeros((len(rows), 6))
    qvel = path.qvel + np.hstack([base, longer(path.time, 1)])
    qacc = path.qacc + np.hstack([base, longer(path.time, 2)])
    torques = []
    for index, qpos in enumerate(rows):
        config = Configuration(robot, qpos, qvel[index])
        # MuJoCo's contact is half way down.
        touching = -(radius - depths[index] / 2)[:, None] * normals
        contacts = config.point_jacobians(path.feet, touching)
        left = config.mass_matrix() @ path.qacc[index] + config.bias_forces() - config.passive()
        left += joint_resistance(robot, qvel[index], qacc[index])
        left -= np.einsum("nij,ni->j", contacts, path.forces[index])
        for foot, moment in zip(path.feet, path.moments[index], strict=True):
            left -= config.frame_jacobian(robot.contact_frames[foot])[3:].T @ moment
        # The com has moved with the legs; each foot takes of that in proportion to its load.
        jacobian = (pressing[index][:, None, None] * contacts).reshape(-1, robot.nv)
        more = np.linalg.lstsq(jacobian[:, :6].T, left[:6], rcond=1e-9)[0]
        torques.append((left - more @ jacobian)[robot.nv - robot.nu :])
    return np.array(rows), np.array(torques)


def _depths(law: GroundLaw, loads: Array, time: Array) -> Array:
    """Returns how deep a foot is under loads (n,) that change with time (m).

    MuJoCo's contact gives R f = k d r + b dr/dt + d2r/dt2: under a load that grows evenly the depth
    is that of the load b / (k d) earlier (40 ms for v3), with d the impedance.
    """
    depths = np.array([law.depth(load) for load in loads])
    lag = law.damping / (law.stiffness * law.impedance(float(depths.mean())))
    late: Array = np.interp(time - lag, time, depths)
    return late


def _fine_timestep(robot: Robot, first: Stand, drive: Servos) -> float:
    """Returns a time step in which the servos' damping adds next to nothing to inertias (s)."""
    inertia = np.diag(Configuration(robot, first.qpos).mass_matrix())[robot.nv - robot.nu :]
    damped = drive.kd > 0
    slowest = float(np.min(inertia[damped] / drive.kd[damped], initial=math.inf))
    own = min(float(drive.model.opt.timestep), TIMESTEP)
    return min(own, max(FINEST, _ADDED * slowest))


Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PathThere(Result):
    """The path from the nominal stand to a stance, and how MuJoCo follows it.

    Attributes:
        name: The robot's name.
        stand: Where it leads.
        path: The path.
        tracking: The simulation of it.
        verdict: Whether it is followed, and what that rests on.
    """

    name: str
    stand: Stand
    path: StancePath
    tracking: PathTracking
    verdict: Verdict

    @property
    def passed(self) -> bool:
        """Whether it is followed, by its verdict."""
        return self.verdict.passed


def study_path(
    robot: Robot,
    task: StandTask,
    seconds: float,
    *,
    kp: ArrayLike | None = None,
    kd: ArrayLike | None = None,
) -> PathThere:
    """Moves from the nominal stand to a stance, and simulates that.

    Args:
        robot: The robot.
        task: The stance.
        seconds: How long it takes (s).
        kp: Servo stiffness (N m/rad), one or (nu,); the model's own by default.
        kd: Servo damping (N m s/rad), one or (nu,); the model's own by default.

    Raises:
        StanceUnreachableError: If a sample is out of reach; says where.
        StaticsInfeasibleError: If a sample cannot be held; says where.
        ConfigurationError: If the task, or another argument, makes no sense for the robot.
        ModelError: If the robot has no position servos, and kp and kd are not both given.
    """
    stand = solve_stand(robot, task)
    path = stance_path(robot, way_to(robot, stand), seconds)
    tracking = track_path(robot, path, kp=kp, kd=kd)
    # Where it leads it shall stay: what shakes there may take longer than the path to show.
    held = solve_stand_as_simulated(robot, stand)
    stability = stand_stability(robot, held, kp=kp, kd=kd)
    leaving = tuple(map(describe_growth, stability.leaving()[:1]))
    ran = Outcome(
        passed=tracking.passed and not leaving,
        failures=(*tracking.failures, *leaving),
        duration=float(path.time[-1]),
        torque_error=tracking.torque_error,
        stability=stability,
    )
    return PathThere(
        name=robot.name,
        stand=stand,
        path=path,
        tracking=tracking,
        verdict=judge(
            robot, stand, ran, statics=stand_statics(robot, held), asked=Asked.TRACKED, kp=kp, kd=kd
        ),
    )


def way_to(robot: Robot, stand: Stand) -> list[StandTask]:
    """Returns the stances that lead to a stand: the nominal one, with its feet where they are.

    Where a foot is lifted, the weight is first shifted on to the others.
    """
    task = stand.task
    x, y, _ = Configuration(robot, stand.qpos).center_of_mass()
    over = replace(task, com=(float(x), float(y)), com_margin=0.0, offset=None)
    nominal = StandTask(
        feet=task.feet,
        foot_offsets=task.foot_offsets,
        ground=task.ground,
        ik_seed=task.ik_seed,
    )
    return [nominal, *([replace(over, swing={})] if task.swing else []), over]


TRACKING_TOLERANCE = 0.1
"""Joint error up to which a path counts as tracked (rad)."""

TORQUE_TOLERANCE = 0.05
"""Deviation of a motor's torque up to which a path counts as tracked, relative to the largest."""

LIFT_CLEARANCE = 2e-3
"""A foot must not touch if it shall be higher than this (m)."""

LOADED = 0.05
"""A foot that shall carry more than this share of the weight must not lose the ground."""

_LOOKS = 400
"""Of a simulation: states that are looked at closely, evenly spaced by 1 to 20 ms. A foot that an
impossible path loses is off the ground for some hundredths of the path's time."""


@dataclass(frozen=True, eq=False)
class PathTracking(Result):
    """What a simulation made of a path.

    Attributes:
        passed: Whether it was tracked.
        failures: If not, why.
        integrator: MuJoCo's integrator.
        timestep: s.
        kp: (nu,) N m/rad.
        kd: (nu,) N m s/rad.
        joint_error: The largest deviation of a joint from the path (rad).
        height_error: The largest deviation of the base's height (m).
        orientation_error: The largest angle between the base's orientation and the path's (rad).
        torque_error: The largest deviation of a motor's torque from the commanded feed-forward, in
            any step of time / the largest torque of the path.
        foot_slip: {foot: the largest horizontal distance of its centre from the path's, while it
            carries (m)}. A foot is a sphere and rolls, so this is not zero without sliding.
    """

    passed: bool
    failures: tuple[Diagnostic, ...]
    integrator: str
    timestep: float = field(metadata={"unit": "s"})
    kp: Array = field(metadata={"unit": "N m/rad"})
    kd: Array = field(metadata={"unit": "N m s/rad"})
    joint_error: float = field(metadata={"unit": "rad"})
    height_error: float = field(metadata={"unit": "m"})
    orientation_error: float = field(metadata={"unit": "rad"})
    torque_error: float = field(metadata={"unit": "1"})
    foot_slip: dict[str, float] = field(metadata={"unit": "m"})


@check_arguments
def track_path(
    robot: Robot,
    path: StancePath,
    *,
    kp: ArrayLike | None = None,
    kd: ArrayLike | None = None,
    integrator: str | None = None,
    timestep: float | None = None,
) -> PathTracking:
    """Simulates a path on the floating base: servos commanded ctrl = q* + (tau + kd dq*/dt) / kp.

    The velocity's part makes up for the servos' damping, which knows no wanted velocity: without it
    they lag by kd / kp (20 ms for v3). The legs are longer by what the feet sink into MuJoCo's soft
    ground under their loads in motion, and the torques are those of the path with legs so long.
    That feet creep as they roll, and what else shows where a path takes less than a second, is not
    fed forward.

    A path is tracked if joints and torques stay within ``TRACKING_TOLERANCE`` and
    ``TORQUE_TOLERANCE``, no motor is at its limit, stance feet stay on the ground, swing feet
    off it, and nothing else touches it.

    Args:
        robot: The robot.
        path: A path of this robot's.
        kp: Servo stiffness (N m/rad); the model's own by default.
        kd: Servo damping (N m s/rad); the model's own by default.
        integrator: MuJoCo's integrator; the model's own by default.
        timestep: Of the simulation (s); by default the model's own, or ``TIMESTEP`` if that is
            shorter, or what servos with so much damping need, down to ``FINEST``.

    Raises:
        ConfigurationError: If an argument is out of its range, or the path is another robot's.
        ModelError: If the model has no servos and no gains are given.
    """
    robot.check_tree("how a path is tracked")
    plan = path_commands(
        robot, path, lambda there: model_with_servos(there, kp, kd, integrator), timestep
    )
    robot, model, joints = plan.robot, plan.drive.model, slice(robot.nq - robot.nu, None)
    states = simulate(model, plan.start, plan.ctrl)
    simulated = states[:, 1 + robot.mj_convention.qpos_index]
    deviation = simulated[:, joints] - plan.qpos[:, joints]
    joint_error = float(np.abs(deviation).max())

    timestep = float(model.opt.timestep)
    apart = min(max(float(path.time[-1]) / _LOOKS, 1e-3), 0.02)
    step = max(1, round(apart / timestep))
    evaluations = np.arange(step - 1, len(states), step)
    tilt, torque_error, slip = math.inf, math.inf, dict.fromkeys(path.feet, math.inf)
    if monitor.has_diverged(states, timestep):
        failures = [monitor.tell_divergence(plan.drive.integrator, timestep)]
    else:
        failures, tilt, slip = _watch(plan, states, evaluations)
        saturated, torque_error = _torques(plan, states)
        failures += saturated
    if path.peak_utilisation > 1:
        failures.append(diagnose("motor-overloaded-on-path", share=path.peak_utilisation))
    if path.peak_speed_utilisation > 1:
        fastest, share = ("joint", path.fastest_joint), path.peak_speed_utilisation
        failures.append(diagnose("joint-too-fast", subject=fastest, share=share))
    if not torque_error <= TORQUE_TOLERANCE:
        failures.append(diagnose("motor-torque-off-path", error=torque_error))
    if not joint_error < TRACKING_TOLERANCE:
        failures.append(diagnose("joint-off-path", error=Quantity(joint_error, "rad")))
    return PathTracking(
        passed=not failures,
        failures=tuple(failures),
        integrator=plan.drive.integrator,
        timestep=timestep,
        kp=plan.drive.kp,
        kd=plan.drive.kd,
        joint_error=joint_error,
        height_error=float(np.abs(simulated[:, 2] - plan.qpos[:, 2]).max()),
        orientation_error=tilt,
        torque_error=torque_error,
        foot_slip=slip,
    )


def _torques(plan: PathCommands, states: Array) -> tuple[list[Diagnostic], float]:
    """Returns which motors are at their limits, and the largest relative error of a torque.

    By the servos' law, with the velocity that the integrator has it act on: an implicit one's at a
    step's end, of which ``qfrc_actuator`` does not know.
    """
    drive, robot, model = plan.drive, plan.robot, plan.drive.model
    public = robot.mj_convention
    before = np.vstack([plan.start, states[:-1]])
    joints = slice(robot.nq - robot.nu, None)
    dofs = 1 + model.nq + public.qvel_index[robot.nv - robot.nu :]
    target = plan.ctrl[:, model.actuator_ctrladr[public.actuator_index]] / drive.gear
    position = before[:, 1 + public.qpos_index[joints]]
    velocity = (states if drive.implicit else before)[:, dofs]
    asked = drive.kp * (target - position) - drive.kd * velocity
    limited = model.actuator_forcelimited[public.actuator_index].astype(bool)
    ranges = model.actuator_forcerange[public.actuator_index] * drive.gear[:, None]
    ranges = np.where(limited[:, None], ranges, [-np.inf, np.inf])
    given = np.clip(asked, ranges.min(axis=1), ranges.max(axis=1))
    events = []
    over = given != asked
    for column in np.flatnonzero(over.any(axis=0)):
        moment = Quantity(plan.time[int(np.argmax(over[:, column]))], "s")
        motor = "joint", robot.joint_names[int(column)]
        events.append(diagnose("motor-at-limit", subject=motor, time=moment))
    largest = float(np.abs(plan.path.torques).max())
    return events, float(np.abs(given - plan.torques).max()) / largest


def _watch(
    plan: PathCommands, states: Array, evaluations: NDArray[np.int64]
) -> tuple[list[Diagnostic], float, dict[str, float]]:
    """Looks at states; returns failures, tilt (rad) and the feet's slip (m)."""
    path, robot = plan.path, plan.robot
    watcher = monitor.Watcher(robot, plan.drive.model)
    events: dict[Diagnostic, float] = {}
    out = ground_normals(robot, path.stances[0].task.ground)
    slip = dict.fromkeys(path.feet, 0.0)
    weight = robot.weight
    tilt = 0.0
    for index in evaluations:
        sight = watcher.look(states[index], plan.ctrl[min(index + 1, len(plan.ctrl) - 1)])
        seen = [
            diagnose("body-touches-ground", subject=("body", body), time=None)
            for body in sorted(sight.bodies)
        ]
        goal = plan.qpos[index]
        rotation = rotation_from_quaternion(goal[3:7] / np.linalg.norm(goal[3:7]))
        base = watcher.data.qpos[robot.mj_convention.qpos_index[:7]]
        turn = rotation.T @ rotation_from_quaternion(base[3:])
        tilt = max(tilt, float(np.linalg.norm(pin.log3(turn))))
        if monitor.Upright.of(robot, goal, rotation).has_fallen(states[index]):
            seen.append(diagnose("fell-over", tilt=None, height=None, time=None))
        centres = monitor.foot_centres(robot, watcher.data)
        targets = Configuration(robot, goal).foot_positions()
        idle = sight.idle(robot.feet)
        sample = int(np.abs(path.time - sight.time).argmin())
        for column, foot in enumerate(path.feet):
            load, own = path.loads[sample, column] / weight, robot.foot_of(foot)
            # A load below zero is that of a foot which would have to be held to the ground.
            if (load > LOADED or load < 0) and own in idle:
                seen.append(diagnose("foot-idle", subject=("foot", foot), time=None))
            if path.clearance[sample, column] > LIFT_CLEARANCE and own in sight.forces:
                seen.append(diagnose("lifted-foot-touches", subject=("foot", foot), time=None))
            if path.stance_feet[sample, column]:
                away = np.cross(out[foot], centres[foot] - targets[foot])  # along its ground
                slip[foot] = max(slip[foot], float(np.linalg.norm(away)))
        for event in seen:
            events.setdefault(event, sight.time)
    failures = [
        replace(event, values=FrozenDict({**event.values, "time": Quantity(moment, "s")}))
        for event, moment in events.items()
    ]
    return failures, tilt, slip
