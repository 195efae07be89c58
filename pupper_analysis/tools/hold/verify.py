"""Does a posture hold: MuJoCo's simulation of a robot whose base is held, against Pinocchio's."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.base.results import Tabular
from pupper_analysis.base.units import EARTH
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import (
    Servos,
    command_lead,
    command_ranges,
    model_with_servos,
)
from pupper_analysis.robot.stability import LASTING, Stability
from pupper_analysis.robot.tool import Tool
from pupper_analysis.simulation import monitor
from pupper_analysis.simulation.causes import find_instability
from pupper_analysis.simulation.nudge import Nudge, measure_response, simulate_nudge
from pupper_analysis.simulation.rollout import (
    STATE,
    full_state,
    settled_activations,
    simulate,
)
from pupper_analysis.simulation.stability import evaluate_stability
from pupper_analysis.simulation.verify import (
    ANOTHER_ROBOT,
    FORCE_TOLERANCE,
    JOINT_TOLERANCE,
    NUDGED,
    RESTING,
    load_by_mujoco,
)
from pupper_analysis.simulation.watch import LAST, TOUCH, SimulationSettings, pushing_bodies
from pupper_analysis.stance.posture import Posture, check_held, with_give
from pupper_analysis.tools.hold.sag import SaggedPosture

Array = NDArray[np.float64]
Indices = NDArray[np.int_]

AWAY = 0.5
"""A joint that ends further from the posture has left it (rad, m)."""

_LEVER = 1e-3
"""The robot's weight on this lever (m) is what deviations of torques are measured by where less is
predicted: joints about vertical axes hold nothing."""


_SATURATED = 1e-6
"""A motor that is so near to its limit, in parts of it, gives all it can."""

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
    config = Configuration(robot, posture.qpos)
    torques = config.by_motors(config.load())
    ctrl = drive.command(robot, posture.qpos, torques if feedforward else None)
    resting = with_give(robot, posture.qpos)
    joints = 1 + robot.mj_convention.qpos_index
    run = _run(drive, _begin(robot, drive, resting, ctrl), ctrl, duration, joints)
    look = _Look(robot, drive, ctrl)
    found = _measured(robot, config, tool, drive, run, look)
    found = replace(_against(found, resting, torques), feedforward=feedforward)
    if not feedforward:
        nowhere = np.full(robot.nu, np.nan)
        found = _against(
            found,
            nowhere if sagged is None else sagged.qpos,
            nowhere if sagged is None else sagged.joint_torques,
        )
    weight = _weight(robot)
    seen = run.states[:: max(1, round(_SAMPLE_TIME / found.timestep))]
    touching = {pair for state in seen for pair in look.touching(state, TOUCH * weight)}
    failures = [monitor.tell_divergence(drive.integrator, found.timestep)] if run.diverged else []
    failures += [diagnose("parts-touch", bodies=pair) for pair in sorted(touching)]
    failures += _deviations(robot, found, weight)
    failures += find_instability(found.stability, found.nudge)
    return replace(found, passed=not failures, failures=tuple(failures))


@dataclass(frozen=True, eq=False)
class _Run:
    """What was simulated: so many states settle before the nudge."""

    states: Array
    settled: Array
    diverged: bool
    stability: Stability
    nudge: Nudge | None


def _run(drive: Servos, start: Array, ctrl: Array, duration: float, joints: Indices) -> _Run:
    """Simulates what becomes of a state under a command, and of a nudge after it has settled.

    Joints are where states have them.
    """
    timestep = float(drive.model.opt.timestep)
    steps = round((1 - NUDGED) * duration / timestep)
    quiet = simulate(drive.model, start, np.tile(ctrl, (steps, 1)))
    settled = quiet[-round(LAST / timestep) :]
    diverged = monitor.has_diverged(quiet, timestep)
    # What threw it off grew where it began: where it hangs instead has a spectrum of its own.
    left = diverged or _left(quiet[-1, joints] - start[joints])
    judged = evaluate_stability(drive, start if left else quiet[-1], ctrl, 0.0)
    if not left and judged.speed > RESTING:
        judged = evaluate_stability(drive, start, ctrl)
    if diverged:
        return _Run(quiet, settled, diverged, judged, None)
    later = simulate_nudge(drive.model, quiet[-1], ctrl, NUDGED * duration)
    nudge = measure_response(drive.model, quiet[-1], later, settled)
    return _Run(np.concatenate([quiet, later]), settled, diverged, judged, nudge)


@np.errstate(invalid="ignore", over="ignore")  # of what has diverged
def _measured(
    robot: Robot, config: Configuration, tool: Tool, drive: Servos, run: _Run, look: _Look
) -> PostureVerification:
    """Compares a rollout with what is predicted with feed-forward, and does not judge it yet."""
    timestep = float(drive.model.opt.timestep)
    step, joints = max(1, round(_SAMPLE_TIME / timestep)), 1 + robot.mj_convention.qpos_index
    positions = run.settled[:, joints].mean(axis=0)
    torques = config.by_motors(config.load())
    residual = config.by_motors(load_by_mujoco(robot, config.qpos)) - torques
    return PostureVerification(
        passed=True,
        failures=(),
        collapses=run.diverged or _left(run.states[-1, joints] - config.qpos),
        feedforward=True,
        integrator=drive.integrator,
        timestep=timestep,
        duration=len(run.states) * timestep,
        kp=drive.kp,
        kd=drive.kd,
        joint_names=robot.joint_names,
        joint_positions=positions,
        predicted_positions=config.qpos,
        joint_error=math.nan,
        joint_torques=np.mean([look.torques(state) for state in run.settled[::step]], axis=0),
        predicted_torques=torques,
        torque_error=math.nan,
        torque_scale=max(float(np.abs(torques).max()), _LEVER * _weight(robot)),
        tool_sag=_moved(robot, tool, positions, config),
        mujoco_residual=float(np.abs(residual).max()),
        stability=run.stability,
        nudge=run.nudge,
        force_error=None,
        time=run.states[::step, 0].copy(),
        motion=np.round(run.states[::step][:, joints], 6),
    )


def _weight(robot: Robot) -> float:
    """Returns the weight (N); of what floats in space, that on Earth: a scale for what is off."""
    return robot.total_mass * (float(np.linalg.norm(robot.gravity)) or EARTH)


def _left(moved: Array) -> bool:
    """Tells whether a joint is far from the posture, by which all (nu,) have moved (rad, m)."""
    return not (np.abs(moved) < AWAY).all()


def _against(found: PostureVerification, positions: Array, torques: Array) -> PostureVerification:
    """Compares what was measured with a prediction (nu,) each."""
    with np.errstate(invalid="ignore"):
        return replace(
            found,
            predicted_positions=positions,
            joint_error=float(np.abs(found.joint_positions - positions).max()),
            predicted_torques=torques,
            torque_error=float(np.abs(found.joint_torques - torques).max() / found.torque_scale),
        )


def _begin(robot: Robot, drive: Servos, qpos: Array, ctrl: Array) -> Array:
    """Returns the state (mjSTATE_FULLPHYSICS) at rest in a posture."""
    data = mujoco.MjData(drive.model)
    robot.mj_convention.set_state(data, qpos)
    data.ctrl[:] = ctrl
    data.act[:] = settled_activations(drive.model, data.ctrl)
    return full_state(drive.model, data)


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
    off = []
    if not found.joint_error < JOINT_TOLERANCE + way:
        off.append(diagnose("joint-off", error=Quantity(found.joint_error, "rad")))
    if not found.torque_error < FORCE_TOLERANCE + share:
        off.append(diagnose("motor-torque-off", error=found.torque_error))
    weakest, strongest = robot.effort_ranges.T * (1 - _SATURATED)
    given = found.joint_torques
    full = np.flatnonzero((given <= weakest) | (given >= strongest))
    if off and full.size:
        names = [robot.joint_names[joint] for joint in full]
        off.append(diagnose("motors-give-all", joints=names, released=not found.feedforward))
    low, high = command_ranges(robot).T
    command = found.predicted_positions + command_lead(found.predicted_torques, found.kp)
    cut = np.flatnonzero((command < low) | (command > high))
    if off and found.feedforward and cut.size:
        names = [robot.joint_names[joint] for joint in cut]
        off.append(diagnose("commands-cut-off", joints=names))
    if off and found.mujoco_residual > ANOTHER_ROBOT * weight:
        mass = Quantity(robot.mj_model.body_subtreemass[0], "kg")
        off.append(
            diagnose(
                "files-of-two-robots",
                mjcf=mass,
                residual=found.mujoco_residual,
                urdf=Quantity(robot.total_mass, "kg"),
            )
        )
    return off


class _Look:
    """Looks at single states of a rollout under a command."""

    def __init__(self, robot: Robot, drive: Servos, ctrl: Array) -> None:
        self._robot, self._model, self._ctrl = robot, drive.model, ctrl
        self._data = mujoco.MjData(drive.model)

    def torques(self, state: Array) -> Array:
        """Returns what motors give (nu,) (N m, N)."""
        self._forward(state)
        given: Array = self._data.qfrc_actuator[self._robot.mj_convention.qvel_index]
        return given

    def touching(self, state: Array, least: float) -> set[tuple[str, str]]:
        """Returns the pairs of bodies that push on each other by so much (N)."""
        self._forward(state)
        return pushing_bodies(self._model, self._data, least)

    def _forward(self, state: Array) -> None:
        mujoco.mj_setState(self._model, self._data, state, STATE)
        self._data.ctrl[:] = self._ctrl
        mujoco.mj_forward(self._model, self._data)
