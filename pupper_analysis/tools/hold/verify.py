"""Does a posture hold: MuJoCo's simulation of a robot whose base is held, against Pinocchio's."""

from __future__ import annotations

from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.results import Tabular
from pupper_analysis.base.units import EARTH
from pupper_analysis.prepare.bare import Bare, Hold, place_held, self_controlled
from pupper_analysis.prepare.judge import remarks_of_files
from pupper_analysis.prepare.own_run import (
    NOTHING,
    as_loaded,
    hold_of_angles,
    is_limp,
    joint_places,
    raw_model,
    run_alone,
    states_ctrl,
)
from pupper_analysis.prepare.self_check import Predicted, compared_with_file, with_lines
from pupper_analysis.robot.alike import structure
from pupper_analysis.robot.as_published import OwnCommands, OwnRun, Published
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import model_with_servos, servos_used
from pupper_analysis.robot.stability import LASTING, Stability
from pupper_analysis.robot.tool import Tool
from pupper_analysis.simulation import monitor
from pupper_analysis.simulation.causes import find_instability
from pupper_analysis.simulation.monitor import TOUCH, SimulationSettings, pushing_bodies
from pupper_analysis.simulation.stability import Nudge, rest_state
from pupper_analysis.simulation.verdict import Simulated, Verdict, beyond_limits, judge_stance
from pupper_analysis.simulation.verify import (
    NUDGED,
    deviations,
    drive_limits,
    load_by_mujoco,
    settle_and_nudge,
    two_robots,
)
from pupper_analysis.stance.posture import Posture, check_held, with_give
from pupper_analysis.statics.equilibrium import GravityCompensation, gravity_compensation
from pupper_analysis.tools.hold.sag import SaggedPosture

Array = NDArray[np.float64]

AWAY = 0.5
"""A joint that ends further from the posture has left it (rad, m)."""

_LEVER = 1e-3
"""The robot's weight on this lever (m) is what deviations of torques are measured by where less is
predicted: joints about vertical axes hold nothing."""


_SAMPLE_TIME = 0.1  # s between the states that are looked at, and kept


@dataclass(frozen=True, eq=False)
class PostureVerification(SimulationSettings, Tabular):
    """What a simulation made of a posture, against the prediction, and the ``SimulationSettings``.

    Settled values are means over the last second before the nudge. Predictions are Pinocchio's,
    from the URDF.

    Attributes:
        passed: Whether the posture is verified.
        failures: If not, why.
        collapses: Whether it has diverged, or a joint ends far from the posture.
        joint_names: In actuator order.
        joint_positions: (nu,) settled (rad, m).
        predicted_positions: (nu,) the posture with feed-forward, where servos let it sag without;
            not a number where that is not predicted.
        joint_error: The largest deviation of the first from the second (rad, m).
        joint_torques: (nu,) of the motors, settled (N m, N).
        predicted_torques: (nu,) likewise.
        torque_error: Largest deviation / ``torque_scale``.
        torque_scale: The largest torque that holds the posture, or that of the weight on a lever of
            1 mm (N m); without gravity, of the weight that it would have on the ground.
        tool_sag: (3,) how far the tool has settled from where the posture has it (m).
        mujoco_residual: Largest deviation of the torques that hold the posture by MuJoCo's dynamics
            of the MJCF from Pinocchio's of the URDF (N m, N).
        stability: Of where it settled: the modes that grow, and the margin.
        nudge: What became of the nudge; None if it diverged before.
        force_error: None: no foot carries.
        time: (n,) samples (s).
        motion: (n, nu) joint positions at these.
    """

    passed: bool
    failures: tuple[Diagnostic, ...]
    collapses: bool
    joint_names: tuple[str, ...]
    joint_positions: Array
    predicted_positions: Array
    joint_error: float
    joint_torques: Array
    predicted_torques: Array
    torque_error: float
    torque_scale: float
    tool_sag: Array
    mujoco_residual: float
    stability: Stability
    nudge: Nudge | None
    force_error: float | None
    time: Array
    motion: Array

    def _columns(self) -> dict[str, ArrayLike]:
        joints = dict(zip(self.joint_names, self.motion.T, strict=True))
        return {"time": self.time, **joints}


@check_arguments
def verify_posture(
    robot: Robot,
    posture: Posture,
    tool: Tool,
    *,
    sagged: SaggedPosture | None = None,
    feedforward: bool = True,
    kp: ArrayLike | None = None,
    kd: ArrayLike | None = None,
    integrator: str | None = None,
    duration: float = LASTING,
) -> PostureVerification:
    """Simulates a posture on its servos, and compares it with Pinocchio's prediction.

    It begins at rest in the posture. What it settles at is measured first; then everything is
    nudged, and must come to rest again, and no mode of the step's spectrum may grow.

    Args:
        robot: A robot whose base is held.
        posture: The posture that is commanded.
        tool: Whose sag is computed.
        sagged: Where it is predicted to rest without feed-forward.
        feedforward: Command ctrl = q* + tau / kp instead of ctrl = q*.
        kp: Servo stiffness (N m/rad); the model's own by default.
        kd: Servo damping (N m s/rad); the model's own by default.
        integrator: MuJoCo's integrator; the model's own by default.
        duration: Simulated time (s), at least 3.

    Returns:
        The comparison; ``failures`` says why a posture is not verified.

    Raises:
        ConfigurationError: If an argument is out of its range, or the base is free.
        ModelError: If the model has no servos and no gains are given.
    """
    check_held(robot)
    drive = model_with_servos(robot, kp, kd, integrator)
    config, weight = Configuration(robot, posture.qpos), _weight(robot)
    torques = config.by_motors(config.load())
    ctrl = drive.command(robot, posture.qpos, torques if feedforward else None)
    resting, predicted = with_give(robot, posture.qpos), torques
    start = rest_state(robot, drive, resting, ctrl)
    if not feedforward:
        nowhere = np.full(robot.nu, np.nan)
        resting = nowhere if sagged is None else sagged.qpos
        predicted = nowhere if sagged is None else sagged.joint_torques
    joints = 1 + robot.mj_convention.qpos_index

    def left(state: Array) -> bool:
        return not (np.abs(state[joints] - start[joints]) < AWAY).all()

    run = settle_and_nudge(drive, start, ctrl, (1 - NUDGED) * duration, NUDGED * duration, left)
    timestep = float(drive.model.opt.timestep)
    step = max(1, round(_SAMPLE_TIME / timestep))
    watcher, dofs = monitor.Watcher(robot, drive.model), robot.mj_convention.qvel_index
    given, touching = [], set[tuple[str, str]]()
    for state in run.states[::step]:
        watcher.look(state, ctrl)
        touching |= pushing_bodies(drive.model, watcher.data, TOUCH * weight)
    for state in run.last[::step]:
        watcher.look(state, ctrl)
        given.append(watcher.data.qfrc_actuator[dofs].copy())
    with np.errstate(invalid="ignore", over="ignore"):  # of what has diverged
        positions, motors = run.last[:, joints].mean(axis=0), np.mean(given, axis=0)
        scale = max(float(np.abs(torques).max()), _LEVER * weight)
        residual = config.by_motors(load_by_mujoco(robot, config.qpos)) - torques
        found = PostureVerification(
            passed=True,
            failures=(),
            collapses=run.diverged or left(run.states[-1]),
            feedforward=feedforward,
            integrator=drive.integrator,
            timestep=timestep,
            duration=len(run.states) * timestep,
            kp=drive.kp,
            kd=drive.kd,
            joint_names=robot.joint_names,
            joint_positions=positions,
            predicted_positions=resting,
            joint_error=float(np.abs(positions - resting).max()),
            joint_torques=motors,
            predicted_torques=predicted,
            torque_error=float(np.abs(motors - predicted).max() / scale),
            torque_scale=scale,
            tool_sag=_moved(robot, tool, positions, config),
            mujoco_residual=float(np.abs(residual).max()),
            stability=run.stability,
            nudge=run.nudge,
            force_error=None,
            time=run.states[::step, 0].copy(),
            motion=np.round(run.states[::step][:, joints], 6),
        )
    failures = [monitor.tell_divergence(drive.integrator, timestep)] if run.diverged else []
    failures += [diagnose("parts-touch", bodies=pair) for pair in sorted(touching)]
    failures += _deviations(robot, found, weight)
    failures += find_instability(found.stability, found.nudge)
    return replace(found, passed=not failures, failures=tuple(failures))


def _weight(robot: Robot) -> float:
    """Returns the weight (N); of what floats in space, that on Earth: a scale for what is off."""
    return robot.total_mass * (float(np.linalg.norm(robot.gravity)) or EARTH)


def _moved(robot: Robot, tool: Tool, positions: Array, config: Configuration) -> Array:
    """Returns how far (3,) the tool is from where it should be; not a number if that diverged."""
    if not np.isfinite(positions).all():
        return np.full(3, np.nan)
    return tool.position(Configuration(robot, positions)) - tool.position(config)


def _deviations(robot: Robot, found: PostureVerification, weight: float) -> list[Diagnostic]:
    """Says what is not as predicted, of a robot of a weight (N)."""
    if np.isnan(found.predicted_positions).any():
        return [diagnose("posture-left")] if found.collapses else []
    # Dry friction may hold a joint where its servo would have to pull harder to move it.
    rubbing = robot.mj_model.dof_frictionloss[robot.mj_convention.qvel_index]
    rubbing = rubbing * (not found.feedforward)
    way = np.divide(rubbing, found.kp, out=np.zeros(robot.nu), where=found.kp > 0).max(initial=0.0)
    share = rubbing.max(initial=0.0) / found.torque_scale
    off = deviations(found.joint_error, found.torque_error, way, share)
    if off:
        torques = found.joint_torques, found.predicted_torques
        off += drive_limits(robot, found, *torques, found.predicted_positions)
        off += two_robots(robot, found.mujoco_residual, weight)
    return off


# Its verdict: what was simulated, and what the robot's file does there.

_THERE = 1e-6
"""A posture that is so near to a keyframe's is its (rad, m)."""


def judge_held(
    robot: Robot,
    posture: Posture,
    fed: Simulated,
    alone: Simulated | None,
    statics: GravityCompensation,
    *,
    kp: ArrayLike | None = None,
    kd: ArrayLike | None = None,
) -> Verdict:
    """Weighs what was simulated of a posture of a robot whose base is held, as ``judge`` does.

    Args:
        robot: The robot, with what it carries.
        posture: Where it is commanded to be.
        fed: The simulation with feed-forward.
        alone: The simulation without.
        statics: What its motors hold.
        kp: Servo stiffness (N m/rad), one or (nu,); the model's own by default.
        kd: Servo damping (N m s/rad), one or (nu,); the model's own by default.

    Raises:
        ModelError: If the robot has no position servos, and kp and kd are not both given.
    """
    servos, empty = servos_used(robot, kp, kd), as_loaded(robot)
    bare = gravity_compensation(Configuration(empty, posture.qpos), contacts=[])
    return judge_stance(
        fed,
        alone,
        servos,
        overloaded=beyond_limits(statics),
        own=own_run_held(robot, posture.qpos),
        published=as_published_held(robot, posture.qpos, bare.joint_torques),
        converted=robot.description.converted,
        remarks=(*structure(robot), *remarks_of_files(robot)),
    )


def own_run_held(robot: Robot, qpos: Array) -> OwnRun | None:
    """Returns what the file of a robot whose base is held does by itself in a posture.

    With a keyframe's ctrl where it is that keyframe's posture, and the XML states one; else with
    its servos told the posture.

    Args:
        robot: The robot.
        qpos: (nu,) joint positions.

    Returns:
        What it does; None where its base is free in the file, or commands of its own control it.
    """
    robot = as_loaded(robot)
    model = None if robot.floating else robot.once(raw_model)
    if model is None:
        return None
    bare = Bare.of(model, robot)
    if bare.floating or self_controlled(bare, robot):
        return None
    data, key = place_held(bare, robot, qpos), None
    places = joint_places(bare, robot)
    for number in range(model.nkey):
        there = np.abs(model.key_qpos[number, places] - qpos).max(initial=0.0) < _THERE
        if there and states_ctrl(robot, number):
            key = number
            mujoco.mj_resetDataKeyframe(model, data, number)
            break
    angles = hold_of_angles(bare, robot, data, qpos)
    if key is not None:
        angles = Hold(data.ctrl.copy(), data.act.copy(), NOTHING, {})
    run = run_alone(bare, robot, data, angles, standing=False)
    return replace(
        run,
        keyframe="" if key is None else model.key(key).name or f"keyframe {key + 1}",
        commands=OwnCommands.ANGLES if key is None else OwnCommands.STATED,
        limp=is_limp(bare),
    )


def as_published_held(robot: Robot, qpos: Array, torques: Array) -> Published | None:
    """Returns how the file of a robot whose base is held differs in a posture.

    Its servos are given the posture and the torques that hold it there: ctrl = q* + tau / kp.

    Args:
        robot: The robot; of one that was changed since it was loaded, how it was loaded.
        qpos: (nu,) joint positions.
        torques: (nu,) that hold it as it was loaded (N m, N).

    Returns:
        What comes of it; None where there is no file, or its base is free in it.
    """
    robot = as_loaded(robot)
    if robot.floating or robot.published is None or robot.published.as_prepared:
        return None
    model = robot.once(raw_model)
    if model is None:
        return None
    bare = Bare.of(model, robot)
    if bare.floating:
        return None
    found = compared_with_file(bare, robot, [Predicted(True, qpos, torques, qpos)])
    return replace(found, causes=with_lines(found.causes, robot))
