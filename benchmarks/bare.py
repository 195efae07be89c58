"""The same jobs by the bare engines: what the package adds to them is what it costs.

Each job is the least that anybody would have to write who uses the engine alone: names looked up
beforehand, no argument checked, no result put into the public convention.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np
import pinocchio as pin
import placo

import pupper_analysis as pa
from pupper_analysis.robot.servos import servos
from pupper_analysis.simulation.rollout import place_on_ground
from pupper_analysis.stance.clearance import Shapes

SIMULATED = 12.0  # s: until a robot that is let go rests


@dataclass(frozen=True)
class Job:
    """A job, ours and the engine's.

    Attributes:
        name: What is done.
        engine: By what it is compared.
        goal: How much longer ours may take.
        ours: Does it.
        bare: Does it with the engine alone.
        accuracy: Says how exact ours is.
    """

    name: str
    engine: str
    goal: float
    ours: Callable[[], object]
    bare: Callable[[], object]
    accuracy: Callable[[], str]


def jobs(variant: str) -> list[Job]:
    """Returns the jobs for a variant."""
    robot = pa.load_variant(variant)
    stand = pa.solve_stand(robot)
    return [
        _stand(robot),
        _quantities(robot, stand),
        *(_statics(robot, stand, kind) for kind in ("minimum tangential", "minimum torque")),
        _steady_state(robot, stand),
        _loading(variant),
    ]


def _stand(robot: pa.Robot) -> Job:
    stand, wrapper = pa.solve_stand(robot), Shapes(robot).wrapper
    height, start = float(stand.qpos[2]), robot.home.copy()
    start[2] = height
    q = robot.pin_convention.q(start)

    def bare() -> None:
        wrapper.state.q = q
        wrapper.update_kinematics()
        solver = placo.KinematicsSolver(wrapper)
        solver.enable_joint_limits(True)
        feet = []
        for foot, target in stand.foot_targets.items():
            feet.append(solver.add_position_task(robot.foot_frames[foot], target))
            feet[-1].configure(foot, "soft", 1.0)
        solver.add_orientation_task(robot.base, np.eye(3)).configure("turn", "hard")
        tall = solver.add_position_task(robot.base, np.array([0.0, 0.0, height]))
        tall.mask.set_axises("z")
        tall.configure("height", "hard")
        over = solver.add_com_task(np.zeros(3))
        over.target_world = np.mean(list(stand.contact_points.values()), axis=0)
        over.mask.set_axises("xy")
        over.configure("com", "hard")
        solver.add_regularization_task(1e-9)
        for _ in range(stand.iterations):
            solver.solve(True)
            wrapper.update_kinematics()

    return Job(
        "solve_stand",
        "PlaCo's loop, as many steps",
        1.5,
        lambda: pa.solve_stand(robot),
        bare,
        lambda: f"feet {stand.foot_error:.0e} m",
    )


def _quantities(robot: pa.Robot, stand: pa.Stand) -> Job:
    model, data = robot.pin_model, robot.pin_model.createData()
    q = robot.pin_convention.q(stand.qpos)
    frames = [model.getFrameId(frame) for frame in robot.foot_frames.values()]

    def ours() -> tuple[np.ndarray, ...]:
        config = pa.Configuration(robot, stand.qpos)
        feet = np.array(list(config.foot_jacobians().values()))
        return feet, config.center_of_mass(), config.mass_matrix(), config.gravity()

    def bare() -> tuple[np.ndarray, ...]:
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacements(model, data)
        world = pin.LOCAL_WORLD_ALIGNED
        feet = [pin.getFrameJacobian(model, data, frame, world)[:3] for frame in frames]
        com = pin.centerOfMass(model, data, q, False)
        inertia = pin.crba(model, data, q)
        return np.array(feet), com, inertia, pin.computeGeneralizedGravity(model, data, q)

    def accuracy() -> str:
        turn = robot.pin_convention.velocity_map(stand.qpos)
        feet, com, upper, gravity = bare()
        inertia = np.triu(upper) + np.triu(upper, 1).T
        expected = feet @ turn, com, turn.T @ inertia @ turn, turn.T @ gravity
        away = [
            np.abs(one - other).max() / np.abs(other).max()
            for one, other in zip(ours(), expected, strict=True)
        ]
        return f"{max(away):.0e} of Pinocchio's"

    return Job("J, com, M, g of a Configuration", "Pinocchio", 2.0, ours, bare, accuracy)


def _statics(robot: pa.Robot, stand: pa.Stand, kind: str) -> Job:
    config, wrapper = pa.Configuration(robot, stand.qpos), Shapes(robot).wrapper
    wrapper.state.q = robot.pin_convention.q(stand.qpos)
    wrapper.update_kinematics()
    solver = placo.DynamicsSolver(wrapper)
    held = solver.add_frame_task(robot.base, wrapper.get_T_world_frame(robot.base))
    held.configure("base", "hard", 1.0, 1.0)
    for foot, frame in robot.foot_frames.items():
        task = solver.add_position_task(frame, wrapper.get_T_world_frame(frame)[:3, 3])
        task.configure(foot, "hard", 1.0)
        contact = solver.add_unilateral_point_contact(task)
        contact.mu = robot.contacts[foot].sliding_friction
        if kind == "minimum tangential":
            contact.weight_forces, contact.weight_tangentials = 1.0, 1e6
    solver.torque_cost = 1.0 if kind == "minimum torque" else 0.0
    kept = solver, wrapper  # which the solver does not keep itself

    def bare() -> np.ndarray:
        result = kept[0].solve(False)
        if not result.success:
            raise ArithmeticError("PlaCo finds no forces")
        return np.array(result.tau)

    def ours() -> pa.GravityCompensation:
        return pa.gravity_compensation(config, distribution=kind)

    def accuracy() -> str:
        found = ours()
        left = max(found.residual_force, found.residual_torque)
        placos = bare()[robot.pin_convention.v_index]
        away = np.abs(found.joint_torques - placos).max()
        return f"balance {left:.0e} N, N m; PlaCo's torques {away:.0e} N m off"

    return Job(
        f"gravity_compensation, {kind}",
        "PlaCo's dynamics",
        2.0,
        ours,
        bare,
        accuracy,
    )


def _steady_state(robot: pa.Robot, stand: pa.Stand) -> Job:
    drive = servos(robot)
    torques = pa.gravity_compensation(pa.Configuration(robot, stand.qpos)).joint_torques
    start = place_on_ground(robot, drive, stand, torques)
    control = drive.command(robot, stand.joint_positions(robot))
    data = mujoco.MjData(drive.model)
    steps = round(SIMULATED / drive.model.opt.timestep)

    def bare() -> None:
        mujoco.mj_resetData(drive.model, data)
        mujoco.mj_setState(drive.model, data, start, mujoco.mjtState.mjSTATE_FULLPHYSICS.value)
        data.ctrl[:] = control
        mujoco.mj_step(drive.model, data, steps)

    return Job(
        "steady_state",
        f"MuJoCo, {SIMULATED:g} s",
        1 / 20,
        lambda: pa.steady_state(robot, stand),
        bare,
        lambda: f"left over {pa.steady_state(robot, stand).residual:.0e} N, N m, m",
    )


def _loading(variant: str) -> Job:
    description = pa.load_variant(f"{variant}-long-leg" if variant == "v3" else variant).description

    def bare() -> mujoco.MjModel:
        pin.buildModelFromXML(description.urdf, pin.JointModelFreeFlyer())
        return mujoco.MjSpec.from_file(str(description.mjcf_source)).compile()

    return Job(
        "load_variant, derived, not the first time",
        "parsing and compiling",
        1.5,
        lambda: pa.load_variant(description.name),
        bare,
        lambda: "-",
    )
