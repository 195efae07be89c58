"""The nominal stand by other libraries for inverse kinematics, each as its own documents have it.

Pink (with quadprog) works on Pinocchio's model of the URDF, Mink (with daqp) on MuJoCo's of the
MJCF. Both are told what ours is: feet in their places, the base's turn and height, the com over the
centre. They stop when the feet are as near as ours are, or come no nearer.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec

import mujoco
import numpy as np
import pinocchio as pin
from measure import Accuracy, Rival

import pupper_analysis as pa

NEAR = 1e-14
"""m: what two libraries reach and more would be rounding."""

MOST_STEPS = 50


def stand_peers(robot: pa.Robot, stand: pa.Stand) -> tuple[Rival, ...]:
    """Returns those that are installed."""
    makers = {"pink": _pink, "mink": _mink}
    return tuple(make(robot, stand) for name, make in makers.items() if find_spec(name))


def _rival(name: str, robot: pa.Robot, stand: pa.Stand, run: Callable[[], np.ndarray]) -> Rival:
    """Judges by the same errors as ours: the feet's, of the configuration in public coordinates."""

    def accuracy() -> Accuracy:
        places = pa.Configuration(robot, run()).foot_positions()
        missed = [np.linalg.norm(places[foot] - at) for foot, at in stand.foot_targets.items()]
        return Accuracy(float(max(missed)), np.inf, "m")

    return Rival(name, run, accuracy)


def _begin(robot: pa.Robot, stand: pa.Stand) -> np.ndarray:
    qpos = robot.home.copy()
    qpos[2] = stand.qpos[2]
    return qpos


def _pink(robot: pa.Robot, stand: pa.Stand) -> Rival:
    import pink
    from pink.tasks import ComTask, FrameTask

    model, data = robot.pin_model, robot.pin_model.createData()
    q = robot.pin_convention.q(_begin(robot, stand))
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
        for _ in range(MOST_STEPS):
            velocity = pink.solve_ik(configuration, tasks, 1.0, solver="quadprog")
            configuration.integrate_inplace(velocity, 1.0)
            # The frame's axes turn with the foot; the length of the miss is the same in any.
            missed = max(np.linalg.norm(task.compute_error(configuration)[:3]) for task in feet)
            if missed < NEAR or missed > nearest / 2:
                break
            nearest = missed
        return robot.pin_convention.qpos(np.array(configuration.q))

    return _rival("Pink (quadprog)", robot, stand, run)


def _mink(robot: pa.Robot, stand: pa.Stand) -> Rival:
    import mink

    model, convention = robot.mj_model, robot.mj_convention
    state = mujoco.MjData(model)
    convention.set_state(state, _begin(robot, stand))
    q = state.qpos.copy()
    sites = {foot: _site(model, *place) for foot, place in robot.contact_places.items()}
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
        for _ in range(MOST_STEPS):
            velocity = mink.solve_ik(configuration, tasks, 1.0, solver="daqp")
            configuration.integrate_inplace(velocity, 1.0)
            missed = max(np.linalg.norm(task.compute_error(configuration)[:3]) for task in feet)
            if missed < NEAR or missed > nearest / 2:
                break
            nearest = missed
        return configuration.data.qpos[convention.qpos_index].copy()

    return _rival("Mink (daqp)", robot, stand, run)


def _site(model: mujoco.MjModel, body: int, place: np.ndarray) -> str:
    """Returns the site in the middle of a foot."""
    for number in range(model.nsite):
        site = model.site(number)
        if int(site.bodyid[0]) == body and np.abs(site.pos - place).max() < 1e-9:
            return str(site.name)
    raise LookupError(f"no site in the middle of the foot on {model.body(body).name}")
