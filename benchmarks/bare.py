"""The same computations by this package and by the engines alone; the difference is the package's
own cost.

The engine's version of a job is the shortest code that a user of the engine would write: names are
looked up in advance, arguments are not checked, and results are not converted to the public
convention.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import mujoco
import mujoco.rollout
import numpy as np
import pinocchio as pin
import placo
from measure import Accuracy, Job, Rival
from peers import stand_peers

import pupper_analysis as pa
from pupper_analysis.robot.servos import model_with_servos
from pupper_analysis.simulation.rollout import (
    FORCED_CONTROL_SPEC,
    make_forced_controls,
    place_on_ground,
)
from pupper_analysis.stance.solver import SearchContext

SIMULATED = 12.0  # s: until a robot that is let go rests
"""Simulated time [s] in which a released robot comes to rest."""

SWEPT, AMPLITUDE, FREQUENCY = 4.0, 2.0, 1.2  # s, N, Hz: a cell of a gain sweep, as by default
"""Duration [s], force amplitude [N] and frequency [Hz] of a cell of a gain sweep: the defaults."""

KP, KD = (10.0, 30.0, 60.0, 120.0), (0.5, 1.0, 2.0, 5.0)  # N m/rad, N m s/rad: sixteen cells
"""Stiffness [N m/rad] and damping [N m s/rad] of the sixteen cells."""

ROUNDING_TOLERANCE = 1e-12  # of two computations of one number: rounding
"""Largest difference between two computations of the same number; larger differences are no
rounding."""


def jobs(variant: str) -> list[Job]:
    """Return the jobs for a variant.

    `ratios.measure_state` calls this function in older checkouts, so its name must not change.
    """
    robot = pa.load_variant(variant)
    stand = pa.solve_stand(robot)
    return [
        _stand(robot),
        _stands(robot),
        _quantities(robot, stand),
        *(_statics(robot, stand, kind) for kind in ("minimum tangential", "minimum torque")),
        _steady_state(robot, stand),
        _gain_sweep(robot, stand),
        _loading(variant),
    ]


def _stand(robot: pa.Robot) -> Job:
    """Return the job that solves a single stand."""
    stand, context = pa.solve_stand(robot), SearchContext(robot)
    return Job(
        "solve_stand",
        lambda: pa.solve_stand(robot),
        lambda: Accuracy(pa.solve_stand(robot).foot_error, 1e-9, "m, the feet"),
        Rival("PlaCo's loop, as many steps", _make_placo_solver(robot, context, stand)),
        1.3,
        stand_peers(robot, stand),
    )


def _make_placo_solver(
    robot: pa.Robot, context: SearchContext, stand: pa.Stand
) -> Callable[[], None]:
    """Return a function that solves a stand from the home pose by PlaCo alone, in as many steps."""
    height, start = float(stand.qpos[2]), robot.home.copy()
    start[2] = height
    q = robot.pin_convention.q(start)
    turned = robot.pin_convention.q(stand.qpos)[3:7]

    def run() -> None:
        wrapper = context.solver.placo_robot.wrapper  # lent for as long as the context is held
        wrapper.state.q = q
        wrapper.update_kinematics()
        solver = placo.KinematicsSolver(wrapper)
        solver.enable_joint_limits(True)
        feet = []
        for foot, target in stand.foot_targets.items():
            feet.append(solver.add_position_task(robot.contact_frames[foot], target))
            feet[-1].configure(foot, "soft", 1.0)
        turn = pin.Quaternion(turned).toRotationMatrix()
        solver.add_orientation_task(robot.base, turn).configure("turn", "hard")
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

    return run


def make_smooth_tasks(robot: pa.Robot, count: int) -> list[pa.StandTask]:
    """Return a smooth sequence of stand tasks, with varying height, roll, pitch and yaw."""
    return [
        pa.StandTask(
            height=robot.stand_height * (0.97 + 0.02 * np.cos(phase)),
            roll=0.05 * np.sin(2 * phase),
            pitch=0.03 * np.sin(phase),
            yaw=0.06 * np.sin(phase),
        )
        for phase in np.linspace(0, 2 * np.pi, count)
    ]


def _stands(robot: pa.Robot) -> Job:
    """Return the job that solves a sequence of 1,000 stands."""
    tasks, context = make_smooth_tasks(robot, 1000), SearchContext(robot)
    singly = [pa.solve_stand(robot, task) for task in tasks]
    loops = [_make_placo_solver(robot, context, stand) for stand in singly]

    def bare() -> None:
        for loop in loops:
            loop()

    def accuracy() -> Accuracy:
        pairs = zip(pa.solve_stands(robot, tasks), singly, strict=True)
        away = max(float(np.abs(first.qpos - second.qpos).max()) for first, second in pairs)
        return Accuracy(away, ROUNDING_TOLERANCE, "m, rad off the single calls'")

    return Job(
        "solve_stands, 1,000 in a sequence",
        lambda: pa.solve_stands(robot, tasks),
        accuracy,
        Rival("PlaCo's loops, as many steps as single calls", bare),
        1.3,
    )


def _quantities(robot: pa.Robot, stand: pa.Stand) -> Job:
    """Return the job that computes foot Jacobians, CoM, mass matrix and gravity."""
    model, data = robot.pin_model, robot.pin_model.createData()
    q = robot.pin_convention.q(stand.qpos)
    frames = [model.getFrameId(frame) for frame in robot.contact_frames.values()]

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

    def accuracy() -> Accuracy:
        turn = np.zeros((robot.nv, robot.nv))  # v_pin = turn qvel
        turn[:3, :3] = pa.Configuration(robot, stand.qpos).base_rotation().T
        turn[3:6, 3:6] = np.eye(3)
        turn[robot.pin_convention.v_index, np.arange(6, robot.nv)] = 1.0
        feet, com, upper, gravity = bare()
        inertia = np.triu(upper) + np.triu(upper, 1).T
        expected = feet @ turn, com, turn.T @ inertia @ turn, turn.T @ gravity
        away = [
            np.abs(first - second).max() / np.abs(second).max()
            for first, second in zip(ours(), expected, strict=True)
        ]
        return Accuracy(float(max(away)), ROUNDING_TOLERANCE, "off Pinocchio's, relative")

    mujocos = _make_mujoco_quantities(robot, stand)

    def agreement() -> Accuracy:
        pairs = zip(mujocos(), ours(), strict=True)
        away = [np.abs(first - second).max() / np.abs(second).max() for first, second in pairs]
        return Accuracy(float(max(away)), np.inf, "off ours, relative")

    return Job(
        "J, com, M, g of a Configuration",
        ours,
        accuracy,
        Rival("Pinocchio", bare),
        2.0,
        (Rival("MuJoCo's Python calls", mujocos, agreement),),
    )


def _make_mujoco_quantities(
    robot: pa.Robot, stand: pa.Stand
) -> Callable[[], tuple[np.ndarray, ...]]:
    """Return a function that computes the same quantities with MuJoCo alone."""
    model, data = robot.mj_model, mujoco.MjData(robot.mj_model)
    convention = robot.mj_convention
    convention.set_state(data, stand.qpos)
    q, order = data.qpos.copy(), convention.qvel_index
    base = model.body(robot.mj_base).id
    places = list(robot.contact_places.values())

    def run() -> tuple[np.ndarray, ...]:
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        feet = np.zeros((len(places), 3, model.nv))
        for jacobian, (body, place) in zip(feet, places, strict=True):
            point = data.xpos[body] + data.xmat[body].reshape(3, 3) @ place
            mujoco.mj_jac(model, data, jacobian, None, point, body)
        mujoco.mj_crb(model, data)
        inertia, gravity = np.zeros((model.nv, model.nv)), np.zeros(model.nv)
        mujoco.mj_fullM(model, data, inertia)
        mujoco.mj_rne(model, data, 0, gravity)
        com = data.subtree_com[base].copy()
        return feet[:, :, order], com, inertia[np.ix_(order, order)], gravity[order]

    return run


def _make_placo_statics(
    robot: pa.Robot, states: np.ndarray, kind: str
) -> Callable[[], list[np.ndarray]]:
    """Return a function that computes the joint torques of states with a prepared solver of PlaCo.

    Args:
        robot: Robot.
        states: States qpos, shape (n, nq).
        kind: Distribution of the contact forces.
    """
    context = SearchContext(robot)
    wrapper = context.solver.placo_robot.wrapper
    qs = [robot.pin_convention.q(state) for state in states]
    solver = placo.DynamicsSolver(wrapper)
    held = solver.add_frame_task(robot.base, np.eye(4))
    held.configure("base", "hard", 1.0, 1.0)
    feet = []
    for foot, frame in robot.contact_frames.items():
        task = solver.add_position_task(frame, np.zeros(3))
        task.configure(foot, "hard", 1.0)
        feet.append((frame, task))
        contact = solver.add_unilateral_point_contact(task)
        contact.mu = robot.contacts[foot].sliding_friction
        if kind == "minimum tangential":
            contact.weight_forces, contact.weight_tangentials = 1.0, 1e6
    solver.torque_cost = 1.0 if kind == "minimum torque" else 0.0
    kept = solver, context  # which the solver does not keep itself

    def place(q: np.ndarray) -> None:
        wrapper.state.q = q
        wrapper.update_kinematics()
        held.T_world_frame = wrapper.get_T_world_frame(robot.base)
        for frame, task in feet:
            task.target_world = wrapper.get_T_world_frame(frame)[:3, 3]

    def solve() -> np.ndarray:
        result = kept[0].solve(False)
        if not result.success:
            raise ArithmeticError("PlaCo finds no forces")
        return np.array(result.tau)

    def run() -> list[np.ndarray]:
        torques = []
        for q in qs:
            if len(qs) > 1:  # a state alone is placed once
                place(q)
            torques.append(solve())
        return torques

    place(qs[0])
    return run


def _statics(robot: pa.Robot, stand: pa.Stand, kind: str) -> Job:
    """Return the job that computes the contact forces and torques of a stand."""
    config = pa.Configuration(robot, stand.qpos)
    bare = _make_placo_statics(robot, stand.qpos[None], kind)

    def ours() -> pa.statics.GravityCompensation:
        return pa.gravity_compensation(config, distribution=kind)

    def accuracy() -> Accuracy:
        found = ours()
        left = max(found.residual_force, found.residual_torque)
        placos = bare()[0][robot.pin_convention.v_index]
        away = np.abs(found.joint_torques - placos).max()
        return Accuracy(left, 1e-9, f"N, N m out of balance (PlaCo's torques {away:.0e} N m off)")

    rival = Rival("PlaCo's dynamics", bare)
    return Job(f"gravity_compensation, {kind}", ours, accuracy, rival, 1.8)


def _steady_state(robot: pa.Robot, stand: pa.Stand) -> Job:
    """Return the job that computes the equilibrium of the servos on soft ground."""
    drive = model_with_servos(robot)
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
        lambda: pa.steady_state(robot, stand),
        lambda: Accuracy(pa.steady_state(robot, stand).residual, 1e-9, "N, N m, m left over"),
        Rival(f"MuJoCo, {SIMULATED:g} s", bare),
        1 / 20,
    )


def _gain_sweep(robot: pa.Robot, stand: pa.Stand) -> Job:
    """Return the job that simulates a stand with a force for each pair of gains."""
    drives = [model_with_servos(robot, kp, kd, "implicitfast") for kp in KP for kd in KD]
    models = [drive.model for drive in drives]
    torques = pa.stance.stand_statics(robot, stand).joint_torques
    starts = np.array([place_on_ground(robot, drive, stand, torques) for drive in drives])
    steps = round(SWEPT / models[0].opt.timestep)
    command = drives[0].command(robot, stand.joint_positions(robot))
    control, force = make_forced_controls(
        robot, models[0], command, 1, steps
    )  # with the same force
    pace = 2 * np.pi * FREQUENCY * models[0].opt.timestep
    force[0, :, 2] = AMPLITUDE * np.sin(pace * np.arange(steps))
    datas = [mujoco.MjData(models[0]) for _ in range(os.cpu_count() or 1)]
    size, full = 2 * models[0].nv + models[0].na, mujoco.mjtState.mjSTATE_FULLPHYSICS.value

    def growth(model: mujoco.MjModel, start: np.ndarray) -> list[np.ndarray]:
        """Return the eigenvalues of the linearised time step, with dry friction and without."""
        data, found = mujoco.MjData(model), []
        mujoco.mj_setState(model, data, start, full)
        data.ctrl[:] = command
        mujoco.mj_step(model, data, 12)
        for friction in (1.0, 0.0):
            kept, matrix = model.dof_frictionloss.copy(), np.zeros((size, size))
            model.dof_frictionloss *= friction
            mujoco.mjd_transitionFD(model, data, 1e-7, True, matrix, None, None, None)
            model.dof_frictionloss[:] = kept
            found.append(np.linalg.eigvals(matrix))
        return found

    def bare() -> None:
        with mujoco.rollout.Rollout(nthread=len(datas)) as pool:
            pool.rollout(models, datas, starts, control, control_spec=FORCED_CONTROL_SPEC)
        with ThreadPoolExecutor(len(datas)) as pool:
            list(pool.map(growth, models, starts))

    def accuracy() -> Accuracy:
        first, second = (
            pa.simulation.sweep_gains(robot, stand, kp=KP, kd=KD).height_deviation for _ in range(2)
        )
        away = np.abs(np.nan_to_num(first, posinf=1.0) - np.nan_to_num(second, posinf=1.0)).max()
        return Accuracy(float(away), 0.0, "m between two runs")

    return Job(
        f"sweep_gains, {len(models)} cells of {SWEPT:g} s",
        lambda: pa.simulation.sweep_gains(robot, stand, kp=KP, kd=KD),
        accuracy,
        Rival("mujoco.rollout, mjd_transitionFD", bare),
        1 / 0.95,
        quick=False,
    )


def _loading(variant: str) -> Job:
    """Return the job that derives and loads a variant."""
    description = pa.load_variant(f"{variant}-long-leg" if variant == "v3" else variant).description

    def bare() -> mujoco.MjModel:
        pin.buildModelFromXML(description.urdf, pin.JointModelFreeFlyer())
        mujoco.MjSpec.from_file(str(description.mjcf_source))
        return description.mjcf.copy().compile()  # of longer legs, whose meshes are scaled

    def accuracy() -> Accuracy:
        robot = pa.load_variant(description.name)
        away = abs(robot.total_mass / float(robot.mj_model.body_mass.sum()) - 1)
        return Accuracy(away, 1e-9, "of its mass between the two models")

    return Job(
        "load_variant, derived, not the first time",
        lambda: pa.load_variant(description.name),
        accuracy,
        Rival("parsing and compiling", bare),
        1.4,
    )
