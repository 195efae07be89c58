"""How MuJoCo tracks a path through stances."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from numbers import Real

import mujoco
import mujoco.rollout
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline

from pupper_analysis import contact
from pupper_analysis.configuration import Configuration
from pupper_analysis.convention import rotation_from_quaternion
from pupper_analysis.errors import ConfigurationError
from pupper_analysis.path import StancePath
from pupper_analysis.results import Result
from pupper_analysis.robot import Robot, on_ground
from pupper_analysis.simulation import (
    FALLEN_TILT,
    STATE,
    Servos,
    diverged,
    lean,
    place_on_ground,
    servos,
)
from pupper_analysis.sink import sunk_path

Array = NDArray[np.float64]

TRACKING_TOLERANCE = 0.1
"""Joint error up to which a path counts as tracked (rad)."""

LIFT_CLEARANCE = 2e-3
"""A foot must not touch if it shall be higher than this (m)."""

LOADED = 0.05
"""A foot that shall carry more than this share of the weight must not lose the ground."""

TIMESTEP = 1e-3
"""The longest time step of a simulation of a path (s). An implicit integrator moves joints as if
they had kd x the time step more inertia, and its contacts do not know: with 4 ms the skeleton's
torques are off by up to 15 % from that alone."""

_SAMPLE = 0.02  # s between the states that are looked at closely


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
        joint_error_rms: Root mean square over joints and time (rad).
        height_error: The largest deviation of the base's height (m).
        orientation_error: The largest angle between the base's orientation and the path's (rad).
        torque_error: The largest deviation of a motor's torque / the largest of the path.
        foot_slip: {foot: the largest horizontal distance of its centre from the path's, while it
            carries (m)}. A foot is a sphere and rolls, so this is not zero without sliding.
        time: (n,) moments of the next (s).
        joints: (n, nu) joint positions (rad).
        height: (n,) the base's (m).
    """

    passed: bool
    failures: tuple[str, ...]
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


@dataclass(frozen=True, eq=False)
class PathCommands:
    """A path at the time steps of a simulation, and what the servos are told.

    Attributes:
        path: The path.
        robot: The robot on the path's ground.
        drive: Its MuJoCo model, with servos.
        start: The full physics state at rest in the first stance.
        time: (n,) after each step (s).
        qpos: (n, nq) of the path after each step, the legs longer by what their feet sink into the ground.
        torques: (n, nu) of the path, at the start of each step (N m).
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
    *,
    kp: ArrayLike | None = None,
    kd: ArrayLike | None = None,
    integrator: str | None = None,
    timestep: float | None = None,
) -> PathCommands:
    """Returns what the servos are told, step by step; the arguments are those of ``track_path``.

    Raises:
        ConfigurationError: If an argument is out of its range, or the path is another robot's.
        ModelError: If the model has no servos and no gains are given.
    """
    if path.joint_names != robot.joint_names or path.qpos.shape[1] != robot.nq:
        raise ConfigurationError("path", f"it is not a path of {robot.name}")
    first = path.stances[0]
    robot = on_ground(robot, first.task.ground, first.foot_targets)
    drive = servos(robot, kp, kd, integrator)
    drive.model.opt.timestep = timestep = _timestep(drive.model, timestep)
    robot = replace(robot, mj_model=drive.model)  # a contact may depend on the time step
    times = timestep * np.arange(1, max(1, round(path.time[-1] / timestep)) + 1)
    sunk = sunk_path(robot, path)
    first = replace(first, qpos=sunk[0])
    spline, starts = CubicSpline(path.time, sunk, bc_type="clamped"), times - timestep
    joints, end = slice(robot.nq - robot.nu, None), path.time[-1]
    torques = CubicSpline(path.time, path.torques)(np.minimum(starts, end))
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
        start=place_on_ground(robot, drive, first, path.torques[0]),
        time=times,
        qpos=spline(np.minimum(times, end)),
        torques=torques,
        ctrl=np.array([drive.command(robot, *row) for row in zip(ahead, torques, strict=True)]),
    )


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
    ground (``sunk_path``). The torques are those at rest; inertia, and the ground's resistance to
    feet that roll (v3's, of 0.01 m), are not in them.

    Args:
        robot: The robot.
        path: A path of this robot's.
        kp: Servo stiffness (N m/rad); the model's own by default.
        kd: Servo damping (N m s/rad); the model's own by default.
        integrator: MuJoCo's integrator; the model's own by default.

    Raises:
        ConfigurationError: If an argument is out of its range, or the path is another robot's.
        ModelError: If the model has no servos and no gains are given.
    """
    plan = path_commands(robot, path, kp=kp, kd=kd, integrator=integrator)
    robot, model, joints = plan.robot, plan.drive.model, slice(robot.nq - robot.nu, None)
    states = mujoco.rollout.rollout(model, mujoco.MjData(model), plan.start, plan.ctrl[None])[0][0]
    simulated = states[:, 1 + robot.mj_convention.qpos_index]
    deviation = simulated[:, joints] - plan.qpos[:, joints]
    joint_error = float(np.abs(deviation).max())

    timestep = float(model.opt.timestep)
    step = max(1, round(_SAMPLE / timestep))
    looks = np.arange(step - 1, len(states), step)
    tilt, torque_error, slip = math.inf, math.inf, dict.fromkeys(path.feet, math.inf)
    if diverged(states, timestep):
        failures = [f"the simulation diverged ({plan.drive.integrator}, {1e3 * timestep:g} ms)"]
    else:
        failures, tilt, torque_error, slip = _watch(plan, states, looks)
    if path.peak_utilisation > 1:
        failures.append(f"a motor would have to give {path.peak_utilisation:.0%} of its limit")
    if not joint_error < TRACKING_TOLERANCE:
        failures.append(f"a joint is off by {joint_error:.2f} rad")
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
        time=plan.time[looks],
        joints=simulated[looks, joints],
        height=simulated[looks, 2],
    )


def _watch(
    plan: PathCommands, states: Array, looks: NDArray[np.int64]
) -> tuple[list[str], float, float, dict[str, float]]:
    """Looks at states; returns failures, tilt (rad), torque error and the feet's slip (m)."""
    path, robot, model = plan.path, plan.robot, plan.drive.model
    data = mujoco.MjData(model)
    events: dict[str, float] = {}
    slip = dict.fromkeys(path.feet, 0.0)
    tilt = torque_error = 0.0
    for index in looks:
        mujoco.mj_setState(model, data, states[index], STATE)
        data.ctrl[:] = plan.ctrl[index]
        mujoco.mj_forward(model, data)
        forces, others = contact.ground_forces(model, data, robot.soles)
        seen = [f"{body} touches the ground" for body in sorted(others)]
        goal = plan.qpos[index]
        rotation = rotation_from_quaternion(goal[3:7] / np.linalg.norm(goal[3:7]))
        base = data.qpos[robot.mj_convention.qpos_index[:7]]
        turn = rotation.T @ rotation_from_quaternion(base[3:])
        tilt = max(tilt, float(np.linalg.norm(pin.log3(turn))))
        if lean(robot, rotation, states[index]) > FALLEN_TILT or base[2] < 0.5 * goal[2]:
            seen.append("it fell over")
        torque = data.qfrc_actuator[robot.mj_convention.qvel_index[6:]]
        torque_error = max(torque_error, float(np.abs(torque - plan.torques[index]).max()))
        sample = min(len(path.time) - 1, round(float(data.time) / path.time[1]))
        targets = Configuration(robot, path.qpos[sample]).foot_positions()
        for column, foot in enumerate(path.feet):
            load = path.loads[sample, column] / path.loads[sample].sum()
            if load > LOADED and (foot not in forces or forces[foot][2] <= 0):
                seen.append(f"foot {foot} carries nothing")
            if path.clearance[sample, column] > LIFT_CLEARANCE and foot in forces:
                seen.append(f"foot {foot} is lifted, and touches the ground")
            if path.carrying[sample, column]:
                body, place = robot.foot_places[foot]
                centre = data.xpos[body] + data.xmat[body].reshape(3, 3) @ place
                away = float(np.linalg.norm((centre - targets[foot])[:2]))
                slip[foot] = max(slip[foot], away)
        for event in seen:
            events.setdefault(event, float(data.time))
    failures = [f"{event} at {moment:.2f} s" for event, moment in events.items()]
    return failures, tilt, torque_error / float(np.abs(path.torques).max()), slip


def _timestep(model: mujoco.MjModel, given: float | None) -> float:
    """Returns the time step of the simulation (s)."""
    if given is None:
        return min(float(model.opt.timestep), TIMESTEP)
    number = float(given) if isinstance(given, Real) else math.nan
    if isinstance(given, bool) or not 0 < number < math.inf:
        raise ConfigurationError("timestep", f"{given!r} is not a finite number above 0")
    return number
