"""Stability of a robot at rest on its servos: spectrum of MuJoCo's step, and nudged simulations."""

from __future__ import annotations

from dataclasses import dataclass, field

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.results import Result
from pupper_analysis.models.mjcf import scalar_joints
from pupper_analysis.robot.fall import NUDGE_SPEED, nudge_velocity
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import Servos
from pupper_analysis.robot.stability import SETTLING_TIME, Stability, judge_settled, step_stability
from pupper_analysis.simulation import monitor
from pupper_analysis.simulation.growth import confirm_growth
from pupper_analysis.simulation.rollout import (
    STATE,
    begin_stand,
    check_standing,
    rest_state,
    simulate,
)
from pupper_analysis.stance.sag.steady_state import SteadyState, steady_state
from pupper_analysis.stance.stand import Stand

Array = NDArray[np.float64]

MEETING = 0.05
"""s in which contacts meet their loads, where an equilibrium has been found already: the prediction
is of first order in friction's creep."""


@check_arguments
def stand_stability(
    robot: Robot,
    stand: Stand,
    *,
    feedforward: bool = True,
    kp: ArrayLike | None = None,
    kd: ArrayLike | None = None,
    integrator: str | None = None,
) -> Stability:
    """Judges whether a stand is stable, by the eigenvalues of one of MuJoCo's steps.

    It takes milliseconds unless a mode grows; then a nudged simulation of up to 36 s tests whether
    the mode does grow (``confirm_growth``). With feed-forward the stand is judged; without, the
    equilibrium of the servos (``steady_state``, feet pinned). Larger pushes are not covered.

    Args:
        robot: The robot.
        stand: How it stands.
        feedforward: Command ctrl = q* + tau / kp instead of ctrl = q*.
        kp: Servo stiffness (N m/rad); the model's own by default.
        kd: Servo damping (N m s/rad); the model's own by default.
        integrator: MuJoCo's integrator; the model's own by default.

    Returns:
        The modes that grow, with their doubling times, and the margin.

    Raises:
        ConfigurationError: If an argument is out of its range, or the base is fixed.
        ModelError: If the model has no servos and no gains are given.
        StaticsInfeasibleError: If no contact forces balance the stand.
        NoEquilibriumError: If it comes to rest nowhere near without feed-forward.
    """
    robot = check_standing(robot, stand)
    if not feedforward:
        pose = steady_state(robot, stand, kp=kp)
        return rest_stability(robot, stand, pose, kp=kp, kd=kd, integrator=integrator)
    held = begin_stand(robot, stand, kp=kp, kd=kd, integrator=integrator)
    return evaluate_stability(held.drive, held.start, held.ctrl)


def rest_stability(
    robot: Robot,
    stand: Stand,
    pose: SteadyState,
    *,
    kp: ArrayLike | None = None,
    kd: ArrayLike | None = None,
    integrator: str | None = None,
) -> Stability:
    """Judges where the servos, commanded the stand alone, let a robot come to rest.

    Args:
        robot: The robot.
        stand: The stand that is commanded.
        pose: Where it comes to rest: ``steady_state``.
        kp: As for ``stand_stability``, like the next two.
        kd: Likewise.
        integrator: Likewise.

    Returns:
        The modes that grow there, and the margin.
    """
    held = begin_stand(robot, stand, feedforward=False, kp=kp, kd=kd, integrator=integrator)
    start = rest_state(held.robot, held.drive, pose.qpos, held.ctrl)
    return evaluate_stability(held.drive, start, held.ctrl, MEETING)


RESTING = 5e-3
"""What moves faster does not rest (m/s, rad/s): feet creep by less."""


def stability_after(
    drive: Servos, start: Array, end: Array, ctrl: Array, *, lost: bool = False
) -> Stability:
    """Judges where a simulation has come to rest under a command.

    Where it was begun, if it has come to no rest; what threw off one that is lost grew there, and a
    wreck that lies at rest has a spectrum of its own.
    """
    found = evaluate_stability(drive, start if lost else end, ctrl, 0.0)
    return found if lost or found.speed <= RESTING else evaluate_stability(drive, start, ctrl)


def evaluate_stability(
    drive: Servos, state: Array, ctrl: Array, settle: float = SETTLING_TIME
) -> Stability:
    """Judge a state (mjSTATE_FULLPHYSICS) under a command; see ``judge_stability``."""
    data = mujoco.MjData(drive.model)
    mujoco.mj_setState(drive.model, data, state, STATE)
    data.ctrl[:] = ctrl
    return judge_stability(drive.model, data, settle=settle)


def evaluate_spectrum(drive: Servos, state: Array, ctrl: Array) -> Stability:
    """Compute the spectrum at a state (mjSTATE_FULLPHYSICS) under a command; see ``Stability``."""
    data = mujoco.MjData(drive.model)
    mujoco.mj_setState(drive.model, data, state, STATE)
    data.ctrl[:] = ctrl
    return step_stability(drive.model, data)


def judge_stability(
    model: mujoco.MjModel, data: mujoco.MjData, *, settle: float = SETTLING_TIME
) -> Stability:
    """Judge the stability of a state: the one rule for all commands.

    A mode of the spectrum (``step_stability``) that would leave the state counts only if a nudged
    simulation of the unmodified model confirms it; see ``confirm_growth``.

    Args:
        model: MuJoCo model.
        data: State, with ``ctrl``; it is not changed.
        settle: Time for which the state is simulated first (s).
    """
    found, judged = judge_settled(model, data, settle)
    return confirm_growth(found, model, judged, data.ctrl.copy())


LEFT = 1e-2
"""A joint that is further from where it was before the nudge has left it (rad, m)."""

_DECAYING = 0.9
"""Motion in the last third of the time is at most this part of that in the second third: what
swings on, or in a cycle of its own, is as fast in both."""

_GONE = 1e-2
"""Part of the nudge below which motion is what contacts and the solver make: it has decayed."""


@dataclass(frozen=True, eq=False)
class Nudge(Result):
    """What became of a nudge.

    Attributes:
        speed: Of the nudge (m/s, rad/s), in each coordinate up to this.
        time: When it was given (s).
        duration: What was simulated of it (s).
        motion: Greatest speed in the second third of that time, by creep apart (m/s, rad/s).
        left: The same in the last third.
        moved: The greatest way of a joint from where it was before, in the last third, beyond what
            it had crept already (rad, m).
        farthest: The same at any time after the nudge: what comes back has left all the same.
        decayed: Whether the motion ``left`` is less, or nothing to speak of.
    """

    speed: float = field(metadata={"unit": "m/s or rad/s"})
    time: float = field(metadata={"unit": "s"})
    duration: float = field(metadata={"unit": "s"})
    motion: float = field(metadata={"unit": "m/s or rad/s"})
    left: float = field(metadata={"unit": "m/s or rad/s"})
    moved: float = field(metadata={"unit": "rad or m"})
    farthest: float = field(metadata={"unit": "rad or m"})
    decayed: bool

    @property
    def stays(self) -> bool:
        """Whether no joint ever left where it was."""
        return self.farthest < LEFT


def simulate_nudge(model: mujoco.MjModel, state: Array, ctrl: Array, duration: float) -> Array:
    """Simulates what becomes of a state when everything is nudged, base and joints.

    Args:
        model: The model.
        state: The state (mjSTATE_FULLPHYSICS) at rest.
        ctrl: (nu,) what is commanded.
        duration: s.

    Returns:
        (n, size) the states after each step.
    """
    start, first = state.copy(), 1 + model.nq
    start[first : first + model.nv] += nudge_velocity(model)
    steps = max(3, round(duration / model.opt.timestep))
    return simulate(model, start, np.tile(ctrl, (steps, 1)))


@np.errstate(invalid="ignore", over="ignore")  # of what has diverged: it has not decayed
def measure_response(
    model: mujoco.MjModel, before: Array, states: Array, creep: Array | None = None
) -> Nudge:
    """Measures what became of a nudge.

    Feet creep on MuJoCo's friction, at a speed that hardly changes: only what differs from a
    straight line in time is motion.

    Args:
        model: The model.
        before: (size,) the state before it.
        states: (n, size) those after it.
        creep: (n, size) states before it, over which feet creep: what goes on at most so fast is
            not the nudge's.
    """
    third, timestep = len(states) // 3, float(model.opt.timestep)
    windows = states[third : 2 * third], states[-third:]
    motion, left = (_swinging(rows[:, 1 + model.nq : 1 + model.nq + model.nv]) for rows in windows)
    whole = not monitor.has_diverged(states, timestep)
    hinges = model.jnt_qposadr[scalar_joints(model)]
    distances = np.abs(states[:, 1 + hinges] - before[1 + hinges])
    if creep is not None:
        rates = np.abs(creep[-1] - creep[0])[1 + hinges] / (creep[-1, 0] - creep[0, 0])
        distances = np.maximum(distances - np.outer(states[:, 0] - before[0], rates), 0.0)
    gone = left <= max(_DECAYING * motion, _GONE * NUDGE_SPEED)
    return Nudge(
        speed=NUDGE_SPEED,
        time=float(before[0]),
        duration=len(states) * timestep,
        motion=motion,
        left=left,
        moved=float(distances[-third:].max(initial=0.0)),
        farthest=float(distances.max(initial=0.0)),
        decayed=bool(whole and gone),
    )


def _swinging(rates: Array) -> float:
    """Returns the greatest deviation of rates (n, nv) from straight lines in time."""
    time = np.linspace(-1.0, 1.0, len(rates))
    rates_found = (time @ rates) / (time @ time)
    return float(np.abs(rates - rates.mean(axis=0) - np.outer(time, rates_found)).max(initial=0.0))
