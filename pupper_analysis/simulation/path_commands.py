"""What servos are told so that they follow a path: feed-forward, step by step."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from numbers import Real

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.diagnostics import diagnose
from pupper_analysis.errors import ConfigurationError
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import Servos, model_with_servos
from pupper_analysis.robot.terrain import on_ground
from pupper_analysis.simulation.rollout import place_on_ground
from pupper_analysis.stance.path.sinking import AT_REST, find_sunk_motion
from pupper_analysis.stance.path.stance_path import StancePath
from pupper_analysis.stance.stand import Stand

Array = NDArray[np.float64]

TIMESTEP = 2.5e-4
"""The longest time step of a simulation of a path (s). An implicit integrator moves joints as if
they had kd x the time step more inertia, and its contacts do not know: with 4 ms the skeleton's
torques are off by up to 15 % from that alone, with 1 ms by 4 %, with this by 1 %."""

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
    """A path at the time steps of a simulation, and what the servos are told.

    Attributes:
        path: The path.
        robot: The robot on the path's ground.
        drive: Its MuJoCo model, with servos.
        start: The full physics state at rest in the first stance.
        time: (n,) after each step (s).
        qpos: (n, nq) of the path after each step, the legs longer by what their feet sink into the
            ground.
        torques: (n, nu) of the motors at the start of each step: the path's, and what makes the
            legs longer (N m).
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
    """Returns what the servos are told, step by step.

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
    robot = on_ground(robot, first.task.ground, first.foot_targets)
    drive = drive_of(robot)
    timestep = (
        _fine_timestep(robot, first, drive) if timestep is None else _checked_timestep(timestep)
    )
    drive.model.opt.timestep = timestep
    robot = replace(robot, mj_model=drive.model)  # a contact may depend on the time step
    # No step goes beyond the end: what the feet still sink would there be at rest of a sudden.
    steps = max(1, math.floor(float(path.time[-1]) / timestep + _STEP_ROUNDING))
    times: Array = np.linspace(timestep, steps * timestep, steps)
    motion = find_sunk_motion(robot, path)
    first = replace(first, qpos=motion.qpos[0])
    spline, starts = CubicSpline(path.time, motion.qpos, bc_type=AT_REST), times - timestep
    joints, end = slice(robot.nq - robot.nu, None), path.time[-1]
    torques = CubicSpline(path.time, motion.torques)(np.minimum(starts, end))
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
        ctrl=np.array([drive.command(robot, *row) for row in zip(ahead, torques, strict=True)]),
    )


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
