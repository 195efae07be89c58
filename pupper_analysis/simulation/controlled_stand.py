"""Stability of a standing robot under sampled joint PD control with a delay.

`ControlledStand` replaces the servos of a robot in a stand by torque motors, and linearises the
robot once. With the deviation x of (qpos, qvel, act) and the motor torques u, a time step is x' = A
x + B u (MuJoCo documentation, ``mjd_transitionFD``). The controller measures joint angles q and
velocities v once per control period and commands

    u = torque that holds the stand + kp (q of the stand - q) - kd v,

which acts after the delay. `find_worst_mode` returns the mode of the closed loop that grows
fastest; `survives_simulation` simulates the same controller in MuJoCo, with all friction.

The linear model has no dry friction of joints and tendons. This friction holds a joint at rest like
a large damper, so that unstable gains may appear stable; a moving joint lacks this damping.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.base.results import Result
from pupper_analysis.models.mjcf import silence_mujoco
from pupper_analysis.robot.stability import (
    HOLD_DURATION,
    copy_data,
    remove_negligible_friction,
    select_most_moving,
    use_converged_solver,
)
from pupper_analysis.simulation.rollout import StandStart

MAX_RATE = 100_000.0
"""Upper bound of the control rate that `ControlledStand` accepts [Hz]: motor drives run at 10 to 40
kHz. Chosen, not tuned."""

MAX_DELAY = 0.5
"""Upper bound of the delay between measurement and effect of a command that `ControlledStand`
accepts [s]. Chosen: legged robots are controlled within 0.1 s."""

MAX_GROWTH_RATE = math.log(2) / HOLD_DURATION
"""Upper bound of the growth rate of a mode [1/s] that counts as stable. At this rate a deviation
doubles in ``HOLD_DURATION``, the time for which a stand must hold. Slower modes are, for example,
creep of MuJoCo's friction."""

_MAX_STEPS_PER_PERIOD = 64
"""Upper bound of the number of time steps into which a control period is divided, so that the delay
is a whole number of steps. Exception: the time step of the model may require more steps. Chosen,
not tuned.
"""

_DELAY_TOLERANCE = 1e-6
"""Tolerance [1] up to which a difference counts as rounding. The differences are those of a number
of time steps from a whole number (relative if above 1, for the delay), and of the imaginary part of
an eigenvalue of the closed loop from 0. Chosen, not tuned.
"""

_TRANSIENT_RATIO = 0.1
"""Ratio [1] of the amplitudes of a mode after and before the delay plus a control period. Modes
with a smaller ratio do not count for the damping ratio: a delay adds modes that decay before a
command acts. Chosen, not tuned.
"""

_DIFFERENCE_STEP = 1e-6
"""Step of the central differences that linearise a time step [m, rad, m/s, rad/s, N m]. Measured on
v3: the modes differ by less than 1e-6 (relative) from those with a step of 1e-7."""

_NUDGE_ANGLE, _NUDGE_SPEED = 0.02, 0.2
"""Initial displacement [rad, m] or velocity [rad/s, m/s] of the joint that moves most, in a
simulation that starts with a deviation along a mode. Chosen, not tuned."""

_REST_SPEED = 0.01
"""Upper bound of the joint velocities [rad/s, m/s] with which a robot counts as at rest at the end
of a simulation. Chosen: 5 % of `_NUDGE_SPEED`.
"""

_COMPARED_SHARE = 0.2
"""Length of each of two intervals of a simulation, as a fraction of the simulated time [1]. The
first interval ends at half the time, the second at the end. The largest joint velocities of both
are compared to decide if the motion decays. Chosen, not tuned."""

_MAX_DECAY_RATIO = 0.9
"""Upper bound [1] of the ratio (largest joint velocity before the end) / (largest joint velocity
before the middle of a simulation) with which an oscillation counts as decaying. Both velocities are
taken in intervals of `_COMPARED_SHARE`. Chosen, not tuned."""

_MAX_JOINT_SPEED = 100.0
"""Joint velocity [rad/s, m/s] at which a simulation of the controlled stand fails. Chosen, not
tuned."""

_MAX_SHIFT_RATIO = 1.1
"""Factor [1] in the upper bound of the largest joint displacement in the second half of a
simulation: factor * (displacement at half the time) + `_MIN_SHIFT`. If a displacement exceeds the
bound, the robot has left the stand. Chosen, not tuned."""

_MIN_SHIFT = 1e-3
"""Absolute term [rad, m] in the upper bound of the largest joint displacement in the second half of
a simulation (see `_MAX_SHIFT_RATIO`). Measured: v3 creeps by 0.01 mrad in 12 s, without a failure.
"""

_MAX_SHIFT = 0.1
"""Upper bound of the displacement of a joint from the stand [rad, m]. A simulation of the
controller fails if a joint exceeds the bound. Chosen: five times `_NUDGE_ANGLE`."""

MAX_POWER = 12
"""Largest exponent p of the factors 2^p with which the gains are multiplied in the search for
stable gains. The smallest exponent is -p. See `MAX_FACTOR`."""

MAX_FACTOR = 2.0**MAX_POWER
"""Largest factor [1] with which the gains are multiplied in the search for stable gains: 4096. The
smallest factor is the inverse. Chosen larger than the range of kp of common robots, for example 5
to 2000 N m/rad."""

FACTOR_TOLERANCE = 0.005
"""Relative tolerance [1] of the bisection for the largest stable factor on the gains of the linear
model. Chosen, not tuned."""


@dataclass(frozen=True, eq=False)
class WorstMode(Result):
    """Mode of a closed control loop that grows fastest, or decays slowest if all modes decay.

    Attributes:
        growth_rate: Growth rate (1/s); negative if the mode decays.
        frequency: Frequency (Hz); 0 without oscillation.
        joints: Joints with a motor that have the largest motion in the mode, largest first.
    """

    growth_rate: float = field(metadata={"unit": "1/s"})
    frequency: float = field(metadata={"unit": "Hz"})
    joints: tuple[str, ...]
    _direction: Array

    @property
    def stable(self) -> bool:
        """Whether the growth rate is at most `MAX_GROWTH_RATE`, so that a stand still holds."""
        return self.growth_rate <= MAX_GROWTH_RATE


class ControlledStand:
    """Robot in a stand with torque motors and a sampled PD controller, to test gains and delay.

    The controller measures joint positions and velocities once per control period. The command acts
    after the delay. The robot is linearised once, at rest in the stand.

    Args:
        held: Initial state and model of the stand. Torque motors replace the servos of the model.
        rate: Control rate [Hz]. None means one command per time step of the model in ``held``.
        delay: Time between measurement and effect of a command [s].

    Attributes:
        model: MuJoCo model with torque motors and ``timestep``.
        period: Control period [s].
        steps: Number of time steps per control period.
        timestep: Time step of ``model`` [s]: ``period`` / ``steps``.
        delay: Delay, rounded to time steps [s].
        delay_steps: Number of time steps of the delay.

    Raises:
        ConfigurationError: If rate or delay is out of range, or the linear model is not finite.
    """

    def __init__(self, held: StandStart, rate: float | None = None, delay: float = 0.0) -> None:
        self._held, conv = held, held.robot.mj_convention
        self._driven = np.flatnonzero(conv.actuator_index >= 0)
        actuators = conv.actuator_index[self._driven]
        self.model = copy.copy(held.drive.model)
        self.period, self.steps, self.delay_steps = _divide_period(
            float(self.model.opt.timestep), rate, delay
        )
        self.timestep = self.period / self.steps
        self.delay = self.delay_steps * self.timestep
        _replace_servos(self.model, actuators, held.drive.gear[self._driven])
        self.model.opt.timestep = self.timestep
        # Euler and implicitfast both integrate the damping of joints implicitly. MuJoCo cannot
        # differentiate RK4.
        self.model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST.value
        self._controls = self.model.actuator_ctrladr[actuators]
        self._dofs = conv.qvel_index[-held.robot.nu :][self._driven]
        self._places = conv.qpos_index[-held.robot.nu :][self._driven]
        self._torques = held.prediction.joint_torques[self._driven]
        self._start = self._make_start()
        self._first, self._late, self._prompt = self._linearise_period()

    def _make_start(self) -> mujoco.MjData:
        """Return the simulation state of the stand at rest; controls are the holding torques."""
        data = mujoco.MjData(self.model)
        mujoco.mj_setState(
            self.model, data, self._held.start, mujoco.mjtState.mjSTATE_FULLPHYSICS.value
        )
        data.ctrl[:] = self._held.ctrl
        data.ctrl[self._controls] = self._torques
        mujoco.mj_forward(self.model, data)
        return data

    def _linearise_period(self) -> tuple[Array, Array, Array]:
        """Linearise the motion in one control period: x' = F x + L u_late + P u_prompt.

        x and x' are the deviations of (qpos, qvel, act) from the stand before and after the period.
        An earlier command u_late [N m] may still act at the beginning of a period, then the later
        command u_prompt acts. Dry friction of joints and tendons is zero, and contacts with
        MuJoCo's smallest friction are frictionless.

        Returns:
            F, shape (n, n), L and P, shape (n, number of driven joints).
        """
        model = copy.copy(self.model)
        model.dof_frictionloss[:] = 0.0
        model.tendon_frictionloss[:] = 0.0
        use_converged_solver(model)
        remove_negligible_friction(model)
        model.opt.enableflags &= ~mujoco.mjtEnableBit.mjENBL_SLEEP.value
        size = 2 * model.nv + model.na
        state, inputs = np.zeros((size, size)), np.zeros((size, model.nu))
        data = copy_data(model, self._start)
        with silence_mujoco():  # of an unstable model; the derivative is checked below
            mujoco.mjd_transitionFD(model, data, _DIFFERENCE_STEP, True, state, inputs, None, None)
        effect = inputs[:, self._controls]
        if not (np.isfinite(state).all() and np.isfinite(effect).all()):
            raise ConfigurationError(
                "kp", diagnose("gains-not-finite", robot=self._held.robot.name)
            )
        sums, powers = [np.zeros_like(effect)], [np.eye(size)]
        for _ in range(self.steps):
            sums.append(sums[-1] + powers[-1] @ effect)
            powers.append(powers[-1] @ state)
        late = self.delay_steps % self.steps
        return powers[-1], powers[self.steps - late] @ sums[late], sums[self.steps - late]

    def compute_joint_inertias(self) -> Array:
        """Compute the inertia that each motor accelerates in the stand: torque / mean acceleration.

        The acceleration is averaged over a control period. The other motors keep their torques, and
        the feet are on MuJoCo's soft ground.

        Returns:
            Inertia [kg m^2, kg], shape (nu,); NaN for joints without motor, and if the torque does
            not accelerate the joint.
        """
        motors = np.arange(len(self._driven))
        changes = (self._late + self._prompt)[self.model.nv + self._dofs, motors]
        inertias = np.full(self._held.robot.nu, math.nan)
        inertias[self._driven] = [
            self.period / change if change > 0 else math.nan for change in changes.tolist()
        ]
        return inertias

    def find_worst_mode(self, kp: Array, kd: Array) -> WorstMode:
        """Find the mode of the closed control loop with the largest growth rate.

        The state of the closed loop consists of the state of the robot (qpos, qvel, act) and of
        previous commands.

        Args:
            kp: Stiffness of all joints, shape (nu,) [N m/rad, N/m].
            kd: Damping of all joints, shape (nu,) [N m s/rad, N s/m].
        """
        values, vectors = np.linalg.eig(self._closed_loop(kp, kd))
        size = np.abs(values)
        worst = int(size.argmax())
        moves = np.abs(vectors[self._dofs, worst])
        names = [self._held.robot.joint_names[joint] for joint in self._driven.tolist()]
        return WorstMode(
            growth_rate=math.log(max(float(size[worst]), 1e-300)) / self.period,
            frequency=abs(float(np.angle(values[worst]))) / (2 * math.pi * self.period),
            joints=select_most_moving(dict(zip(names, moves.tolist(), strict=True))),
            _direction=self._scale_direction(vectors[: 2 * self.model.nv, worst]),
        )

    def _scale_direction(self, vector: NDArray[np.complex128]) -> Array:
        """Scale a mode to an initial deviation (2 nv,) [m, rad, m/s, rad/s] of a simulation.

        The joint that moves most has a displacement of `_NUDGE_ANGLE` or a velocity of
        `_NUDGE_SPEED`.
        """
        nv = self.model.nv
        scales = np.repeat([_NUDGE_ANGLE, _NUDGE_SPEED], nv)
        joints = np.concatenate([self._dofs, nv + self._dofs])
        sizes = np.abs(vector / scales)[joints]
        largest = joints[int(sizes.argmax())]
        if not sizes.any():
            return np.zeros(2 * nv)
        scaled: Array = np.real(vector / vector[largest]) * float(scales[largest])
        return scaled

    def is_stable(self, kp: Array, kd: Array) -> bool:
        """Return True if no mode of the closed control loop grows faster than `MAX_GROWTH_RATE`.

        Args:
            kp: Stiffness of all joints, shape (nu,) [N m/rad, N/m].
            kd: Damping of all joints, shape (nu,) [N m s/rad, N s/m].
        """
        values = np.linalg.eigvals(self._closed_loop(kp, kd))
        return math.log(float(np.abs(values).max())) / self.period <= MAX_GROWTH_RATE

    def find_smallest_damping_ratio(self, kp: Array, kd: Array) -> float:
        """Find the smallest damping ratio of the oscillating modes of the closed control loop.

        The eigenvalue of a mode is z = exp(s T), where T is the control period. The damping ratio
        of the mode is -Re(s) / abs(s). Modes that decay within the delay plus a control period
        (`_TRANSIENT_RATIO`) are not considered.

        Args:
            kp: Stiffness of all joints, shape (nu,) [N m/rad, N/m].
            kd: Damping of all joints, shape (nu,) [N m s/rad, N s/m].

        Returns:
            Damping ratio [1], at most 1; 1 if no mode oscillates, negative if an oscillation grows.
        """
        values = np.linalg.eigvals(self._closed_loop(kp, kd)).astype(complex)
        is_real = np.abs(values.imag) <= _DELAY_TOLERANCE
        oscillates = (values.imag > _DELAY_TOLERANCE) | (is_real & (values.real < 0))
        lasts = np.abs(values) ** (self.delay_steps / self.steps + 1) > _TRANSIENT_RATIO
        exponents = np.log(values[lasts & oscillates])
        return float(np.min(-exponents.real / np.abs(exponents), initial=1.0))

    def _closed_loop(self, kp: Array, kd: Array) -> Array:
        """Return the transition matrix (n, n) of the closed loop over one control period.

        The states are the deviations of `_linearise_period`, then previous commands [N m], the
        latest first.
        """
        nv, count = self.model.nv, len(self._driven)
        feedback = np.zeros((count, len(self._first)))
        rows = np.arange(count)
        feedback[rows, self._dofs] = -kp[self._driven]
        feedback[rows, nv + self._dofs] = -kd[self._driven]
        size, pending = len(self._first), self.delay_steps // self.steps + 1
        matrix = np.zeros((size + pending * count,) * 2)
        matrix[:size, :size] = self._first
        blocks = [
            slice(size + row * count, size + (row + 1) * count) for row in range(pending)
        ]  # commands of the previous period, of the period before ...
        matrix[:size, blocks[-1]] += self._late
        if pending == 1:
            matrix[:size, :size] += self._prompt @ feedback
        else:
            matrix[:size, blocks[-2]] += self._prompt
        matrix[blocks[0], :size] = feedback
        for newer, older in pairwise(blocks):
            matrix[older, newer] = np.eye(count)
        return matrix

    def survives_simulation(
        self, kp: Array, kd: Array, *, duration: float, mode: WorstMode
    ) -> bool:
        """Simulate the controlled stand from a deviation along a mode; return True if it holds.

        The MuJoCo model has torque motors instead of the servos, and all friction. The stand holds
        if the driven joints stay near the stand, and come to rest or oscillate less and less.

        Args:
            kp: Stiffness of all joints, shape (nu,) [N m/rad, N/m].
            kd: Damping of all joints, shape (nu,) [N m s/rad, N s/m].
            duration: Simulated time [s].
            mode: Mode of this controlled stand (`find_worst_mode`), along which the robot is
                displaced.
        """
        data = copy_data(self.model, self._start)
        qpos, qvel, ctrl = data.qpos, data.qvel, data.ctrl  # views: an access to MjData is slow
        target, stiff = qpos[self._places], kp[self._driven]
        damp = kd[self._driven]
        mujoco.mj_integratePos(self.model, qpos, mode._direction[: self.model.nv], 1.0)
        qvel += mode._direction[self.model.nv :]
        error, velocity = target - qpos[self._places], qvel[self._dofs]
        commands = [self._torques] * (self.delay_steps + 1)
        num_steps = round(duration / self.timestep)
        half_shift = half_speed = end_speed = 0.0
        for step in range(num_steps):
            if step % self.steps == 0:
                commands.append(self._torques + stiff * error - damp * velocity)
            else:
                commands.append(commands[-1])
            ctrl[self._controls] = commands[-1 - self.delay_steps]
            mujoco.mj_step(self.model, data)
            error, velocity = target - qpos[self._places], qvel[self._dofs]
            speed = float(np.maximum.reduce(np.abs(velocity)))
            shift = float(np.maximum.reduce(np.abs(error)))
            if not speed < _MAX_JOINT_SPEED or shift > _MAX_SHIFT:
                return False
            if 2 * step < num_steps:
                half_shift = shift
            elif shift > half_shift * _MAX_SHIFT_RATIO + _MIN_SHIFT:
                return False
            if 0 <= num_steps - 2 * step < 2 * _COMPARED_SHARE * num_steps:
                half_speed = max(half_speed, speed)
            elif num_steps - step < _COMPARED_SHARE * num_steps:
                end_speed = max(end_speed, speed)
        return end_speed < max(_REST_SPEED, _MAX_DECAY_RATIO * half_speed)


def find_largest_damping_factor(loop: ControlledStand, kp: Array, kd: Array) -> float:
    """Find the largest factor on the damping gains with which a controlled stand is stable.

    Args:
        loop: Controlled stand.
        kp: Stiffness of all joints, shape (nu,) [N m/rad, N/m].
        kd: Damping of all joints to which the factor applies, shape (nu,) [N m s/rad, N s/m].

    Returns:
        Factor [1], at most `FACTOR_TOLERANCE` below the largest one. Infinite if the stand is
        stable up to `MAX_FACTOR`; NaN if no tried power of 2 is stable.
    """

    def is_stable(factor: float) -> bool:
        """Return True if the stand is stable with ``factor`` times the damping."""
        return loop.is_stable(kp, factor * kd)

    powers = sorted(range(-MAX_POWER, MAX_POWER + 1), key=abs)
    stable = next((2.0**power for power in powers if is_stable(2.0**power)), math.nan)
    while stable < MAX_FACTOR:
        if not is_stable(2 * stable):
            return bisect_factor(is_stable, stable, 2 * stable, FACTOR_TOLERANCE)
        stable *= 2
    return math.nan if math.isnan(stable) else math.inf


def bisect_factor(
    is_inside: Callable[[float], bool], inside: float, outside: float, tolerance: float
) -> float:
    """Find by bisection, on a logarithmic scale, the factor at which a condition changes.

    Args:
        is_inside: Condition of a factor: True at ``inside``, False at ``outside``.
        inside: Factor for which the condition is True.
        outside: Factor for which the condition is False.
        tolerance: Upper bound of the width of the final interval, as a difference of natural
            logarithms [1].

    Returns:
        End of the final interval for which the condition is True.
    """
    while abs(math.log(outside / inside)) > tolerance:
        middle = math.sqrt(inside * outside)
        inside, outside = (middle, outside) if is_inside(middle) else (inside, middle)
    return inside


def _replace_servos(model: mujoco.MjModel, actuators: NDArray[np.int64], gear: Array) -> None:
    """Convert servos to torque motors, in place: ctrl becomes the torque at the joint [N m].

    ``gear`` is the gear ratio of each of these actuators.
    """
    model.actuator_gaintype[actuators] = mujoco.mjtGain.mjGAIN_FIXED.value
    model.actuator_biastype[actuators] = mujoco.mjtBias.mjBIAS_NONE.value
    model.actuator_dyntype[actuators] = mujoco.mjtDyn.mjDYN_NONE.value
    model.actuator_gainprm[actuators, 0] = 1 / gear
    model.actuator_biasprm[actuators] = 0.0
    model.actuator_ctrllimited[model.actuator_ctrladr[actuators]] = 0


def _divide_period(timestep: float, rate: float | None, delay: float) -> tuple[float, int, int]:
    """Divide a control period into time steps that, if possible, divide the delay [s], too.

    ``timestep`` [s] is the largest time step; also the period if ``rate`` [Hz] is None.

    Returns:
        Period [s], time steps per period, and time steps of the delay (rounded).
    """
    if rate is not None and not 0 < rate <= MAX_RATE:
        raise ConfigurationError("rate", diagnose("rate-not-valid", given=rate, most=MAX_RATE))
    if not 0 <= delay <= MAX_DELAY:
        raise ConfigurationError("delay", diagnose("delay-not-valid", given=delay, most=MAX_DELAY))
    period = timestep if rate is None else 1 / rate
    least = max(1, math.ceil(period / timestep - _DELAY_TOLERANCE))
    for steps in range(least, max(least, _MAX_STEPS_PER_PERIOD) + 1):
        number = delay * steps / period
        if abs(number - round(number)) <= _DELAY_TOLERANCE * max(1.0, number):
            break
    return period, steps, round(delay * steps / period)
