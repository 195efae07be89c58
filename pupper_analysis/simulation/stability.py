"""Stability of a robot at rest on servos: spectrum of MuJoCo's step, and nudged simulations.

Inputs are a stand or a simulated state, and constant servo commands. The output is a `Stability`.
First the eigenvalues and modes (eigenvectors) of MuJoCo's linearised step are computed. Then a
nudged simulation of the unmodified model confirms or refutes the modes that grow within
``HOLD_DURATION`` (`judge_stability`). A nudge is a small velocity of all coordinates.
`simulate_nudge` simulates a nudge, and `measure_response` measures the remaining motion (`Nudge`).
"""

from __future__ import annotations

import contextlib
import copy
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.array_types import Array
from pupper_analysis.base.results import Result
from pupper_analysis.models.mjcf import JointKind, scalar_joints
from pupper_analysis.robot.fall import NUDGE_SPEED, nudge_velocity
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import Servos
from pupper_analysis.robot.stability import (
    SETTLING_TIME,
    Stability,
    judge_settled,
    step_stability,
    use_converged_solver,
)
from pupper_analysis.simulation import monitor
from pupper_analysis.simulation.growth import confirm_growth
from pupper_analysis.simulation.rollout import (
    STATE_SPEC,
    make_stand_start,
    rest_state,
    simulate_commands,
    with_stand_contacts,
)
from pupper_analysis.stance.sag.steady_state import SteadyState, steady_state
from pupper_analysis.stance.stand import Stand

CONTACT_SETTLING_TIME = 0.05
"""Time [s] for which a predicted equilibrium is simulated before the modes are computed. In this
time the contact forces converge, since the prediction is accurate to first order in the creep (slow
slip of loaded contacts). Chosen, not tuned."""


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
    """Judge if a stand is stable against small motions, from the eigenvalues of a MuJoCo step.

    The evaluated state is normally that of the settled stand; without feed-forward, that of the
    equilibrium of the servos (`steady_state`, feet pinned). If the state is at rest, and a mode is
    predicted to grow within ``HOLD_DURATION``, nudged simulations test this prediction
    (`confirm_growth`).

    Args:
        robot: Robot.
        stand: Stand.
        feedforward: Whether ctrl = q* + tau / kp (joint positions plus static torques); otherwise
            ctrl = q*.
        kp: Servo stiffness [N m/rad, N/m], scalar or shape (nu,); the model's own by default.
        kd: Servo damping [N m s/rad, N s/m], scalar or shape (nu,); the model's own by default.
        integrator: MuJoCo's integrator; the model's own by default.

    Returns:
        Modes that grow, with doubling times, and the stability margin.

    Raises:
        ConfigurationError: If an argument is out of range, or the stand belongs to another robot,
            for example.
        ModelError: If the servo gains of a joint are unknown, for example.
        StaticsInfeasibleError: If no contact forces balance the stand.
        NoEquilibriumError: If there is no equilibrium near the stand without feed-forward.
    """
    robot = with_stand_contacts(robot, stand)
    if not feedforward:
        pose = steady_state(robot, stand, kp=kp)
        return rest_stability(robot, stand, pose, kp=kp, kd=kd, integrator=integrator)
    held = make_stand_start(robot, stand, kp=kp, kd=kd, integrator=integrator)
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
    """Judge the stability of the equilibrium ``pose`` that servos reach without feed-forward.

    Args:
        robot: Robot.
        stand: Stand whose joint positions are commanded.
        pose: Equilibrium of the servos, from `steady_state`.
        kp: Servo stiffness [N m/rad, N/m], scalar or shape (nu,); the model's own by default.
        kd: Servo damping [N m s/rad, N s/m], scalar or shape (nu,); the model's own by default.
        integrator: MuJoCo's integrator; the model's own by default.

    Raises:
        ConfigurationError: If an argument is out of range, or the stand belongs to another robot,
            for example.
        ModelError: If the servo gains of a joint are unknown, for example.
        StaticsInfeasibleError: If no contact forces balance the stand.
    """
    held = make_stand_start(robot, stand, feedforward=False, kp=kp, kd=kd, integrator=integrator)
    start = rest_state(held.robot, held.drive, pose.qpos, held.ctrl)
    return evaluate_stability(held.drive, start, held.ctrl, CONTACT_SETTLING_TIME)


MAX_RESTING_SPEED = 5e-3
"""Upper bound of the speed [m/s, rad/s] of a robot at rest, in judgements of simulated motion.
Chosen, not tuned.
"""


def evaluate_final_stability(
    drive: Servos,
    start: Array,
    end: Array,
    ctrl: Array,
    *,
    has_fallen: bool = False,
    tests_growth: bool = True,
) -> Stability:
    """Judge the stability of a robot at the end of a simulation, from the modes of MuJoCo's step.

    The evaluated state is that of `find_final_spectrum`.

    Args:
        drive: MuJoCo model with servos.
        start: Initial state of the simulation (mjSTATE_FULLPHYSICS).
        end: Final state of the simulation (mjSTATE_FULLPHYSICS).
        ctrl: Command of the actuators, shape (model.nu,).
        has_fallen: Whether the simulation has failed. If True, the initial state is evaluated.
        tests_growth: Whether a nudged simulation confirms or refutes the growing modes.
    """
    spectrum, settled = find_final_spectrum(drive, start, end, ctrl, has_fallen=has_fallen)
    return confirm_growth(spectrum, drive.model, settled, ctrl) if tests_growth else spectrum


def find_final_spectrum(
    drive: Servos, start: Array, end: Array, ctrl: Array, *, has_fallen: bool = False
) -> tuple[Stability, mujoco.MjData]:
    """Compute the modes of MuJoCo's linearised step at the end of a simulation.

    The final state is evaluated if the robot is at rest. Otherwise the state is normally that of a
    new simulation of `SETTLING_TIME` (`judge_settled`). If the simulation has failed, the initial
    state is evaluated: the modes that upset the robot grow there.

    Args:
        drive: MuJoCo model with servos.
        start: Initial state of the simulation (mjSTATE_FULLPHYSICS).
        end: Final state of the simulation (mjSTATE_FULLPHYSICS).
        ctrl: Command of the actuators, shape (model.nu,).
        has_fallen: Whether the simulation has failed.

    Returns:
        Modes, not yet tested by a simulation; and the state at which the modes were computed.
    """
    first = start if has_fallen else end
    spectrum, settled = _find_modes(drive.model, _restore_state(drive, first, ctrl), 0.0)
    if has_fallen or spectrum.speed <= MAX_RESTING_SPEED:
        return spectrum, settled
    return _find_modes(drive.model, _restore_state(drive, start, ctrl), SETTLING_TIME)


def _restore_state(drive: Servos, state: Array, ctrl: Array) -> mujoco.MjData:
    """Return MuJoCo data in a state (mjSTATE_FULLPHYSICS), with actuator commands ``ctrl``."""
    data = mujoco.MjData(drive.model)
    mujoco.mj_setState(drive.model, data, state, STATE_SPEC)
    data.ctrl[:] = ctrl
    return data


def evaluate_stability(
    drive: Servos, state: Array, ctrl: Array, settle: float = SETTLING_TIME
) -> Stability:
    """Judge the stability of a state under a constant command, by modes and a nudged simulation.

    Args:
        drive: MuJoCo model with servos.
        state: State (mjSTATE_FULLPHYSICS).
        ctrl: Command of the actuators, shape (model.nu,).
        settle: Time for which the state is simulated before the modes are computed [s].
    """
    return judge_stability(drive.model, _restore_state(drive, state, ctrl), settle=settle)


def evaluate_spectrum(
    drive: Servos, state: Array, ctrl: Array, settle: float = SETTLING_TIME
) -> Stability:
    """Compute the modes of MuJoCo's linearised step at a state under a constant command.

    Growing modes are not tested by a simulation (`evaluate_stability` does this).

    Args:
        drive: MuJoCo model with servos.
        state: State (mjSTATE_FULLPHYSICS).
        ctrl: Command of the actuators, shape (model.nu,).
        settle: Time for which the state is simulated before the modes are computed [s].
    """
    return _find_modes(drive.model, _restore_state(drive, state, ctrl), settle)[0]


def judge_stability(
    model: mujoco.MjModel, data: mujoco.MjData, *, settle: float = SETTLING_TIME
) -> Stability:
    """Judge the stability of a state of a MuJoCo model: eigenvalues of a step, then a simulation.

    The eigenvalues (modes) are those of the linearised time step. A nudged simulation tests modes
    that grow within ``HOLD_DURATION`` from a state at rest (`confirm_growth`).

    Args:
        model: MuJoCo model.
        data: State, with ``ctrl``; not changed.
        settle: Time for which the state is simulated before the modes are computed [s].
    """
    spectrum, settled = _find_modes(model, data, settle)
    return confirm_growth(spectrum, model, settled, data.ctrl.copy())


def _find_modes(
    model: mujoco.MjModel, data: mujoco.MjData, settle: float
) -> tuple[Stability, mujoco.MjData]:
    """Simulate a state for ``settle`` [s]; return the modes, at rest also without light contacts.

    A body with less than ``LIGHT_FOOT_LOAD`` of the load may leave the ground as friction creeps.
    On Pupper v3 with 2 kg and one foot on a slope, such a foot hid a growing mode that MuJoCo's
    simulation shows.

    Returns:
        Spectrum, and the state of the spectrum.
    """
    spectrum, settled = judge_settled(model, data, settle)
    light = monitor.find_light_bodies(model, settled) if spectrum.at_rest else ()
    if not light:
        return spectrum, settled
    with _without_contacts(model, light):
        lifted = step_stability(model, settled, settle=0.0)
    # Modes that depend on the finite-difference step may be errors, and do not count as known.
    known = [mode.growth for mode in spectrum.unstable if mode.repeated_at_second_step]
    fastest = max(known, default=0.0)
    added = [
        mode
        for mode in lifted.modes_growing_within()
        if mode.growth > fastest and not mode.without_dry_friction
    ]
    unstable = sorted([*spectrum.unstable, *added], key=lambda mode: -mode.growth)
    return replace(spectrum, unstable=tuple(unstable)), settled


@contextlib.contextmanager
def _without_contacts(model: mujoco.MjModel, bodies: tuple[int, ...]) -> Iterator[None]:
    """Disable all contacts of bodies (also of ``<pair>`` elements) in a ``with`` block."""
    geoms = np.flatnonzero(np.isin(model.geom_bodyid, bodies))
    pairs = np.isin(model.pair_geom1, geoms) | np.isin(model.pair_geom2, geoms)
    kept = model.geom_contype.copy(), model.geom_conaffinity.copy(), model.pair_margin.copy()
    model.geom_contype[geoms] = model.geom_conaffinity[geoms] = 0
    model.pair_margin[pairs] = _NO_CONTACT_MARGIN
    try:
        yield
    finally:
        model.geom_contype[:], model.geom_conaffinity[:], model.pair_margin[:] = kept


_NO_CONTACT_MARGIN = -1e3
"""Contact margin [m] that disables a contact pair. MuJoCo creates a contact only if the distance of
two geoms is below the margin, here an overlap of 1 km."""


MAX_JOINT_DISPLACEMENT = 1e-2
"""Displacement of a joint after a nudge [rad, m], without creep, from which the nudge has displaced
the robot. Chosen, not tuned.
"""

_MAX_SPEED_RATIO = 0.9
"""Upper bound [1] of the ratio (speed in the last third) / (speed in the second third) of the time
after a nudge, with which the motion counts as decaying. A sustained oscillation has a ratio of 1.
Chosen, not tuned."""

_DECAYED_RATIO = 1e-2
"""Upper bound [1] of the ratio (speed in the last third of the time after a nudge) / (speed of the
nudge), with which the motion counts as decayed. Chosen, not tuned."""


@dataclass(frozen=True, eq=False)
class Nudge(Result):
    """Response of a stand to a nudge, a small velocity of all coordinates.

    Attributes:
        speed: Upper bound of the velocity changes by the nudge (m/s or rad/s).
        time: Simulated time of the nudge (s).
        duration: Simulated time after the nudge (s).
        motion: Largest speed in the second third of ``duration``, without creep (m/s or rad/s).
            For a free base, the increase of the mean speed by the nudge counts, too.
        left: Largest speed in the last third of ``duration``, with the same definition as
            ``motion`` (m/s or rad/s).
        moved: Largest displacement of a joint in the last third of ``duration``, from its position
            before the nudge, without the creep (rad or m).
        farthest: Largest displacement of a joint at any time after the nudge, without the creep
            (rad or m).
        decayed: Whether the simulation did not diverge and ``left`` is small: at most 90 % of
            ``motion``, or at most 1 % of the nudge.
        moved_unit: Unit of ``moved``: rad for a hinge, m for a slide.
        farthest_unit: Unit of ``farthest``: rad for a hinge, m for a slide.
    """

    speed: float = field(metadata={"unit": "m/s or rad/s"})
    time: float = field(metadata={"unit": "s"})
    duration: float = field(metadata={"unit": "s"})
    motion: float = field(metadata={"unit": "m/s or rad/s"})
    left: float = field(metadata={"unit": "m/s or rad/s"})
    moved: float = field(metadata={"unit": "rad or m"})
    farthest: float = field(metadata={"unit": "rad or m"})
    decayed: bool
    moved_unit: str = "rad"
    farthest_unit: str = "rad"

    @property
    def stays(self) -> bool:
        """Whether all joints moved by less than `MAX_JOINT_DISPLACEMENT` after the nudge.

        Creep, the slow motion before the nudge, is subtracted if it was measured.
        """
        return self.farthest < MAX_JOINT_DISPLACEMENT


def simulate_nudge(model: mujoco.MjModel, state: Array, ctrl: Array, duration: float) -> Array:
    """Simulate a state after a nudge: a velocity perturbation of all coordinates, base and joints.

    Args:
        model: MuJoCo model.
        state: State (mjSTATE_FULLPHYSICS) without the nudge.
        ctrl: Actuator commands, shape (model.nu,).
        duration: Simulated time [s].

    Returns:
        States after each step (mjSTATE_FULLPHYSICS), shape (n, size).
    """
    steps = count_nudged_steps(model, duration)
    return simulate_commands(model, nudge_state(model, state), np.tile(ctrl, (steps, 1)))


def nudge_state(model: mujoco.MjModel, state: Array) -> Array:
    """Return a copy of a state (mjSTATE_FULLPHYSICS) with all velocities [m/s, rad/s] perturbed."""
    nudged, first = state.copy(), 1 + model.nq
    nudged[first : first + model.nv] += nudge_velocity(model)
    return nudged


def count_nudged_steps(model: mujoco.MjModel, duration: float) -> int:
    """Return the number of steps of a nudged simulation of ``duration`` [s], at least 3."""
    return max(3, round(duration / float(model.opt.timestep)))


@np.errstate(invalid="ignore", over="ignore")  # diverged values: not decayed
def measure_response(
    model: mujoco.MjModel, before: Array, states: Array, creep: Array | None = None
) -> Nudge:
    """Measure the motion after a nudge: speeds [m/s, rad/s] and joint displacements [rad, m].

    Feet creep slowly on MuJoCo's soft friction, also without a nudge. To exclude creep, a straight
    line in time is fitted to each velocity and subtracted. An increase of the mean velocity of a
    free base counts as remaining speed, too: without friction the base keeps the velocity of the
    nudge.

    Args:
        model: MuJoCo model.
        before: State before the nudge (mjSTATE_FULLPHYSICS), shape (size,).
        states: States after each step after the nudge, shape (n, size), n > 2.
        creep: States before the nudge, shape (m, size), m > 1. From them, the creep of the joints
            and the mean velocity of the base are taken. None: no creep is subtracted from
            displacements, and no mean velocity is compared.
    """
    third, timestep = len(states) // 3, float(model.opt.timestep)
    windows = states[third : 2 * third], states[-third:]
    velocities = slice(1 + model.nq, 1 + model.nq + model.nv)
    motion, left = (measure_speed_deviation(rows[:, velocities]) for rows in windows)
    if creep is not None:
        drifts = (_measure_base_drift(model, rows, creep) for rows in windows)
        motion, left = (max(pair) for pair in zip((motion, left), drifts, strict=True))
    is_finite = not monitor.has_diverged(states, timestep)
    joints = np.asarray(scalar_joints(model))
    columns = 1 + model.jnt_qposadr[joints]
    units = np.where(model.jnt_type[joints] == JointKind.SLIDE, "m", "rad")
    distances = np.abs(states[:, columns] - before[columns])
    if creep is not None:
        rates = np.abs(creep[-1] - creep[0])[columns] / (creep[-1, 0] - creep[0, 0])
        distances = np.maximum(distances - np.outer(states[:, 0] - before[0], rates), 0.0)
    is_decayed = left <= max(_MAX_SPEED_RATIO * motion, _DECAYED_RATIO * NUDGE_SPEED)
    moved, moved_unit = _find_largest(distances[-third:], units)
    farthest, farthest_unit = _find_largest(distances, units)
    return Nudge(
        speed=NUDGE_SPEED,
        time=float(before[0]),
        duration=len(states) * timestep,
        motion=motion,
        left=left,
        moved=moved,
        farthest=farthest,
        decayed=bool(is_finite and is_decayed),
        moved_unit=moved_unit,
        farthest_unit=farthest_unit,
    )


BOUNCING_TIME = 28.0
"""Additional simulated time [s] after a nudge in `remains_small`. In this time the remaining motion
must not grow, for example the motion of a bouncing foot with almost no load. Chosen: the sum of
this time and the 12 s of a verified stand is 40 s."""


_MAX_BOUNCE_RATIO = 1.5
"""Upper bound [1] of the ratio (speed at the end of `BOUNCING_TIME`) / (speed after the nudge),
with which the motion does not grow. Chosen between 1 and 5: the ratio of irregular bounces varies
about 1, and growth that doubles in 12 s has a ratio of 2^(28/12) = 5."""


def remains_small(
    model: mujoco.MjModel, end: Array, ctrl: Array, nudge: Nudge, creep: Array | None = None
) -> bool:
    """Continue a nudged simulation; return True if the remaining motion stays small.

    A foot with almost no load may bounce by micrometres for a long time, and shakes the robot. This
    is no failure if joint displacements stay small for `BOUNCING_TIME`, and speeds are small at the
    end. Errors of the constraint solver are no failure under the same conditions.

    Args:
        model: MuJoCo model.
        end: State at the end of the nudged simulation (mjSTATE_FULLPHYSICS).
        ctrl: Actuator commands, shape (model.nu,).
        nudge: Response in the nudged simulation.
        creep: States before the nudge, with which `measure_response` has measured ``nudge``.
    """
    known = max(nudge.motion, nudge.left)
    steps = round(BOUNCING_TIME / float(model.opt.timestep))
    states = simulate_commands(model, end, np.tile(ctrl, (steps, 1)))
    further = measure_response(model, end, states, creep)
    is_finite = not monitor.has_diverged(states, float(model.opt.timestep))
    highest = min(_MAX_BOUNCE_RATIO * known, MAX_RESTING_SPEED)
    return is_finite and further.left <= highest and further.stays


def moves_equally_without_nudge(
    model: mujoco.MjModel, before: Array, ctrl: Array, nudge: Nudge, states: Array
) -> bool:
    """Return True if a robot that moves after a nudge would move equally without the nudge.

    An example is creep whose speed changes, since `measure_response` compares the mean velocity of
    the base with that before the nudge. Here the state before the nudge is simulated without the
    nudge. In the last third of the time, velocities must agree to `_DECAYED_RATIO` of the nudge.

    Args:
        model: MuJoCo model.
        before: State before the nudge (mjSTATE_FULLPHYSICS).
        ctrl: Actuator commands, shape (model.nu,).
        nudge: Response to the nudge.
        states: States after each step after the nudge, shape (n, size), n > 2.
    """
    if nudge.decayed or not nudge.stays:
        return False
    unnudged = simulate_commands(model, before, np.tile(ctrl, (len(states), 1)))
    if monitor.has_diverged(states, float(model.opt.timestep)):
        return False
    velocities, last = slice(1 + model.nq, 1 + model.nq + model.nv), len(states) - len(states) // 3
    differences = states[last:, velocities] - unnudged[last:, velocities]
    return float(np.abs(differences).max(initial=0.0)) <= _DECAYED_RATIO * NUDGE_SPEED


def is_solver_error(
    model: mujoco.MjModel,
    before: Array,
    ctrl: Array,
    nudge: Nudge,
    creep: Array | None = None,
) -> bool:
    """Return True if the motion after a nudge is an error of MuJoCo's constraint solver.

    The solvers CG and PGS end before contact forces converge, and the errors move a robot at rest.
    Measured on Pupper v3 with CG: 4e-4 rad/s, and 4e-7 rad/s with the tolerance 1e-14. The nudge is
    simulated again with converged forces (Newton). The motion is an error if it is slow
    (`MAX_RESTING_SPEED`), moves no joint far, and decays with converged forces.

    Args:
        model: MuJoCo model; not changed.
        before: State before the nudge (mjSTATE_FULLPHYSICS).
        ctrl: Actuator commands, shape (model.nu,).
        nudge: Response in the nudged simulation of ``model``.
        creep: States before the nudge, with which `measure_response` has measured ``nudge``.
    """
    if nudge.decayed or not (nudge.stays and max(nudge.motion, nudge.left) < MAX_RESTING_SPEED):
        return False
    exact = copy.copy(model)
    use_converged_solver(exact)
    states = simulate_nudge(exact, before, ctrl, nudge.duration)
    converged = measure_response(exact, before, states, creep)
    return converged.decayed and converged.stays


def _find_largest(distances: Array, units: NDArray[np.str_]) -> tuple[float, str]:
    """Return the largest of joint displacements, shape (n, joints) [rad, m], and its unit.

    NaN counts as the largest value.
    """
    if not distances.size:
        return 0.0, "rad"
    joint = int(np.argmax(distances.max(axis=0)))  # NaN counts as largest
    return float(distances[:, joint].max()), str(units[joint])


def _measure_base_drift(model: mujoco.MjModel, states: Array, creep: Array) -> float:
    """Return the largest increase of a mean base velocity by a nudge [m/s, rad/s], at least 0.

    ``states`` are the states after, and ``creep`` the states before the nudge, shape (n, size)
    each.
    """
    free = model.dof_jntid[:, None] == np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE)
    columns = 1 + model.nq + np.flatnonzero(free.any(axis=1))
    after, before = (np.abs(rows[:, columns].mean(axis=0)) for rows in (states, creep))
    return float((after - before).max(initial=0.0))


def measure_speed_deviation(velocities: Array) -> float:
    """Compute how fast a robot shakes: the largest speed, without slow motion such as creep.

    ``velocities`` at equal time intervals have the shape (n, nv) [m/s, rad/s]. The result is the
    largest deviation from a linear trend in time [m/s and rad/s mixed].
    """
    return float(measure_speed_deviations(velocities).max(initial=0.0))


def measure_speed_deviations(velocities: Array) -> Array:
    """Compute the largest deviation of each velocity from its linear trend in time, shape (nv,).

    ``velocities`` at equal time intervals have the shape (n, nv) [m/s, rad/s].
    """
    time = np.linspace(-1.0, 1.0, len(velocities))
    slopes = (time @ velocities) / (time @ time)
    deviations: Array = np.abs(velocities - velocities.mean(axis=0) - np.outer(time, slopes)).max(
        axis=0, initial=0.0
    )
    return deviations
