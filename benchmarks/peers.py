"""The nominal stand, solved by other libraries for inverse kinematics as in their documentation.

Pink (with quadprog) uses Pinocchio's model of the URDF, Mink (with daqp) MuJoCo's model of the
MJCF. Both get our tasks: foot positions, orientation and height of the base, CoM above the centre
of the feet. The iteration stops if the foot error is below `MIN_FOOT_ERROR`, or is not halved by a
step, or after `MAX_STEPS` steps.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec

import mujoco
import numpy as np
import pinocchio as pin
from measure import Accuracy, Rival

import pupper_analysis as pa

MIN_FOOT_ERROR = 1e-14
"""Foot error [m] below which the iteration stops: smaller errors are rounding."""

MAX_STEPS = 50
"""Maximum number of steps. Chosen, not tuned."""


def stand_peers(robot: pa.Robot, stand: pa.Stand) -> tuple[Rival, ...]:
    """Return the installed libraries as alternative implementations of a stand."""
    makers = {"pink": _make_pink, "mink": _make_mink}
    return tuple(make(robot, stand) for name, make in makers.items() if find_spec(name))


def _make_rival(
    name: str, robot: pa.Robot, stand: pa.Stand, run: Callable[[], np.ndarray]
) -> Rival:
    """Return an alternative implementation whose accuracy is its largest foot error [m]."""

    def accuracy() -> Accuracy:
        places = pa.Configuration(robot, run()).foot_positions()
        missed = [np.linalg.norm(places[foot] - at) for foot, at in stand.foot_targets.items()]
        return Accuracy(float(max(missed)), np.inf, "m")

    return Rival(name, run, accuracy)


def _initial_guess(robot: pa.Robot, stand: pa.Stand) -> np.ndarray:
    """Return the home pose at the height of a stand, as qpos."""
    qpos = robot.home.copy()
    qpos[2] = stand.qpos[2]
    return qpos


def _make_pink(robot: pa.Robot, stand: pa.Stand) -> Rival:
    """Return Pink as an alternative implementation."""
    import pink
    from pink.tasks import ComTask, FrameTask

    model, data = robot.pin_model, robot.pin_model.createData()
    q = robot.pin_convention.q(_initial_guess(robot, stand))
    centre = np.mean(list(stand.contact_points.values()), axis=0)

    def run() -> np.ndarray:
        configuration = pink.Configuration(model, data, q)
        feet = []
        for foot, target in stand.foot_targets.items():
            feet.append(FrameTask(robot.contact_frames[foot], 1.0, 0.0))
            feet[-1].set_target(pin.SE3(np.eye(3), target))
        base = FrameTask(robot.base, [0.0, 0.0, 1.0], 1.0)
        base.set_target(pin.SE3(np.eye(3), np.array([0.0, 0.0, stand.qpos[2]])))
        com = ComTask([1.0, 1.0, 0.0])
        com.set_target(centre)
        tasks, nearest = [*feet, base, com], np.inf
        for _ in range(MAX_STEPS):
            velocity = pink.solve_ik(configuration, tasks, 1.0, solver="quadprog")
            configuration.integrate_inplace(velocity, 1.0)
            # The frame's axes turn with the foot; the length of the miss is the same in any.
            missed = max(np.linalg.norm(task.compute_error(configuration)[:3]) for task in feet)
            if missed < MIN_FOOT_ERROR or missed > nearest / 2:
                break
            nearest = missed
        return robot.pin_convention.qpos(np.array(configuration.q))

    return _make_rival("Pink (quadprog)", robot, stand, run)


def _make_mink(robot: pa.Robot, stand: pa.Stand) -> Rival:
    """Return Mink as an alternative implementation."""
    import mink

    model, convention = robot.mj_model, robot.mj_convention
    state = mujoco.MjData(model)
    convention.set_state(state, _initial_guess(robot, stand))
    q = state.qpos.copy()
    sites = {foot: _find_site(model, *place) for foot, place in robot.contact_places.items()}
    centre = np.mean(list(stand.contact_points.values()), axis=0)
    upright = mink.SO3.identity()

    def run() -> np.ndarray:
        configuration = mink.Configuration(model, q)
        feet = []
        for foot, target in stand.foot_targets.items():
            feet.append(mink.FrameTask(sites[foot], "site", 1.0, 0.0))
            feet[-1].set_target(mink.SE3.from_rotation_and_translation(upright, target))
        base = mink.FrameTask(robot.mj_base, "body", [0.0, 0.0, 1.0], 1.0)
        place = np.array([0.0, 0.0, stand.qpos[2]])
        base.set_target(mink.SE3.from_rotation_and_translation(upright, place))
        com = mink.ComTask([1.0, 1.0, 0.0])
        com.set_target(centre)
        tasks, nearest = [*feet, base, com], np.inf
        for _ in range(MAX_STEPS):
            velocity = mink.solve_ik(configuration, tasks, 1.0, solver="daqp")
            configuration.integrate_inplace(velocity, 1.0)
            missed = max(np.linalg.norm(task.compute_error(configuration)[:3]) for task in feet)
            if missed < MIN_FOOT_ERROR or missed > nearest / 2:
                break
            nearest = missed
        return configuration.data.qpos[convention.qpos_index].copy()

    return _make_rival("Mink (daqp)", robot, stand, run)


def _find_site(model: mujoco.MjModel, body: int, place: np.ndarray) -> str:
    """Return the name of the site at the centre of a foot.

    Args:
        model: MuJoCo model.
        body: Id of the body of the foot.
        place: Position (3,) [m] of the centre in the frame of the body.
    """
    for number in range(model.nsite):
        site = model.site(number)
        if int(site.bodyid[0]) == body and np.abs(site.pos - place).max() < 1e-9:
            return str(site.name)
    raise LookupError(f"no site in the middle of the foot on {model.body(body).name}")
