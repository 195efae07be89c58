"""How MuJoCo tracks a path: through stances, or to one."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.arrays import rotation_from_quaternion
from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.base.frozen import FrozenDict
from pupper_analysis.base.results import Result, Tabular
from pupper_analysis.prepare.judge import judge
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import model_with_servos
from pupper_analysis.simulation import monitor
from pupper_analysis.simulation.causes import describe_growth
from pupper_analysis.simulation.rollout import simulate
from pupper_analysis.simulation.stability import stand_stability
from pupper_analysis.simulation.verdict import Asked, Outcome, Verdict
from pupper_analysis.stance.soft_ground import solve_stand_as_simulated
from pupper_analysis.stance.stand import Stand, solve_stand, stand_statics
from pupper_analysis.stance.task import StandTask
from pupper_analysis.tools.path.path_commands import PathCommands, path_commands
from pupper_analysis.tools.path.plan import StancePath, stance_path

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
        tracking.passed and not leaving,
        (*tracking.failures, *leaving),
        float(path.time[-1]),
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
        feet=task.feet, foot_offsets=task.foot_offsets, ground=task.ground, ik_seed=task.ik_seed
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
class PathTracking(Tabular):
    """What a simulation made of a path.

    Attributes:
        passed: Whether it was tracked.
        failures: If not, why.
        integrator: MuJoCo's integrator.
        timestep: s.
        kp: (nu,) N m/rad.
        kd: (nu,) N m s/rad.
        joint_error: The largest deviation of a joint from the path (rad).
        joint_error_rms: Root mean square over joints and time (rad).
        height_error: The largest deviation of the base's height (m).
        orientation_error: The largest angle between the base's orientation and the path's (rad).
        torque_error: The largest deviation of a motor's torque from the commanded feed-forward, in
            any step of time / the largest torque of the path.
        foot_slip: {foot: the largest horizontal distance of its centre from the path's, while it
            carries (m)}. A foot is a sphere and rolls, so this is not zero without sliding.
        time: (n,) moments of the next (s).
        joints: (n, nu) joint positions (rad).
        height: (n,) the base's (m).
    """

    passed: bool
    failures: tuple[Diagnostic, ...]
    integrator: str
    timestep: float
    kp: Array
    kd: Array
    joint_error: float
    joint_error_rms: float
    height_error: float
    orientation_error: float
    torque_error: float
    foot_slip: dict[str, float]
    time: Array
    joints: Array
    height: Array

    def _columns(self) -> dict[str, Array]:
        joints = {f"q {number}": values for number, values in enumerate(self.joints.T)}
        return {"time": self.time, "height": self.height, **joints}


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
    if path.infeasible.any():
        moment = Quantity(path.time[int(np.argmax(path.infeasible))], "s")
        failures.append(diagnose("no-contact-forces-on-path", time=moment))
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
        joint_error_rms=float(np.sqrt(np.mean(deviation**2))),
        height_error=float(np.abs(simulated[:, 2] - plan.qpos[:, 2]).max()),
        orientation_error=tilt,
        torque_error=torque_error,
        foot_slip=slip,
        time=plan.time[evaluations],
        joints=simulated[evaluations, joints],
        height=simulated[evaluations, 2],
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
    slip = dict.fromkeys(path.feet, 0.0)
    weight = robot.total_mass * float(np.linalg.norm(robot.gravity))
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
        centres, targets = watcher.foot_centres(), Configuration(robot, goal).foot_positions()
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
                away = float(np.linalg.norm((centres[foot] - targets[foot])[:2]))
                slip[foot] = max(slip[foot], away)
        for event in seen:
            events.setdefault(event, sight.time)
    failures = [
        replace(event, values=FrozenDict({**event.values, "time": Quantity(moment, "s")}))
        for event, moment in events.items()
    ]
    return failures, tilt, slip
