"""What servos are commanded so that they follow a path: feed-forward, step by step."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from numbers import Real

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.robot.compliance import GroundLaw
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import Servos, model_with_servos
from pupper_analysis.robot.terrain import on_ground
from pupper_analysis.simulation.rollout import place_on_ground
from pupper_analysis.stance.problem import ground_normals
from pupper_analysis.stance.stand import Stand
from pupper_analysis.tools.path.dynamics import joint_resistance
from pupper_analysis.tools.path.plan import StancePath

Array = NDArray[np.float64]

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
    robot = on_ground(robot, first.task.ground, first.rigid_targets)
    drive = drive_of(robot)
    timestep = (
        _fine_timestep(robot, first, drive) if timestep is None else _checked_timestep(timestep)
    )
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


def _checked_timestep(value: object) -> float:
    """Returns a time step that was given (s).

    Raises:
        ConfigurationError: If it is none.
    """
    number = float(value) if isinstance(value, Real) else math.nan
    if isinstance(value, bool) or not 0 < number < math.inf:
        problem = diagnose("timestep-not-positive", given=repr(value))
        raise ConfigurationError("timestep", problem)
    if not 1e-6 <= number <= 1.0:
        problem = diagnose("timestep-not-valid", given=repr(value))
        raise ConfigurationError("timestep", problem)
    return number
