"""Spectrum of a MuJoCo step at a state, with contacts, servos and integrator.

`step_stability` returns the modes that grow. Such a mode is a hypothesis: the linearisation is
valid for motions of micrometres only if a foot carries almost no load, and it depends on the
finite-difference step if a joint has dry friction. ``simulation.growth`` tests the hypothesis in a
nudged simulation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import mujoco
import numpy as np

from pupper_analysis.base import lapack
from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.base.results import Result
from pupper_analysis.models.mjcf import JointKind, silence_mujoco

DIFFERENCE_STEP = 1e-7
"""Step of the centred differences of a MuJoCo step, for positions [m, rad] and velocities [m/s,
rad/s]. Contact forces are nonlinear over 1e-5 m. Measured: the error of the eigenvalues is 1e-9
with this step, and with 1e-6."""

SECOND_STEP = 3e-8
"""Second finite-difference step [m, rad, and rates], with which the spectrum is repeated to check
the growing modes. Two public MJCFs with dry friction have a spectral radius of 1.041 with
``DIFFERENCE_STEP``, and of 1.000 with this step."""

_RATE_TOLERANCE = 0.3
"""Relative difference between the growths per time step (|eigenvalue| - 1) of two modes, up to
which both finite-difference steps show the same mode. Chosen, not tuned."""

DIFFERENCE_SOLVER_TOLERANCE = 1e-14
"""Upper bound of MuJoCo's solver tolerance while a time step is linearised by finite differences.
Measured with the default of 1e-8: the solver sometimes stops an iteration earlier on one side of a
difference, and an element of the matrix deviates by 0.03. The model is changed in place, since a
copy with the meshes of a humanoid is slow."""


SLEEP_FLAG = mujoco.mjtEnableBit.mjENBL_SLEEP.value
"""Enable flag of ``<flag sleep="enable"/>``."""


def copy_data(model: mujoco.MjModel, data: mujoco.MjData) -> mujoco.MjData:
    """Return a copy of a state with separate memory, evaluated by ``mj_forward``.

    Args:
        model: MuJoCo model.
        data: State, of which all inputs of a step are copied (``mjSTATE_INTEGRATION``).
    """
    state = np.empty(mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_INTEGRATION.value))
    mujoco.mj_getState(model, data, state, mujoco.mjtState.mjSTATE_INTEGRATION.value)
    own = mujoco.MjData(model)
    mujoco.mj_setState(model, own, state, mujoco.mjtState.mjSTATE_INTEGRATION.value)
    mujoco.mj_forward(model, own)
    return own


def step_derivative(
    model: mujoco.MjModel, data: mujoco.MjData, difference: float = DIFFERENCE_STEP
) -> Array:
    """Compute the derivative of the next state by the state, shape (2 nv + na, 2 nv + na).

    Rows and columns are in the tangent space of (qpos, qvel, act), in MuJoCo's order.

    Args:
        model: MuJoCo model. During the call, the tolerance of the solver is tightened, and sleeping
            is disabled.
        data: State; not changed, but derived quantities (for example accelerations) may be
            recomputed.
        difference: Step of the central finite differences [m, rad; m/s, rad/s].
    """
    size = 2 * model.nv + model.na
    matrix, tolerance = np.zeros((size, size)), float(model.opt.tolerance)
    flags = int(model.opt.enableflags)
    model.opt.tolerance = min(tolerance, DIFFERENCE_SOLVER_TOLERANCE)
    # Sleeping bodies have no derivative: a change of their state wakes them, or is ignored.
    model.opt.enableflags = flags & ~SLEEP_FLAG
    if flags & SLEEP_FLAG:
        data = copy_data(model, data)
    try:
        if model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4.value:  # not supported by MuJoCo
            return _difference_steps(model, data, matrix, difference)
        with silence_mujoco():  # unstable models: the caller judges the derivative
            mujoco.mjd_transitionFD(model, data, difference, True, matrix, None, None, None)
    finally:
        model.opt.tolerance, model.opt.enableflags = tolerance, flags
    return matrix


def _difference_steps(
    model: mujoco.MjModel, data: mujoco.MjData, matrix: Array, difference: float = DIFFERENCE_STEP
) -> Array:
    """Compute the derivative of the next state by the state into ``matrix``, and return it.

    The method is that of centred differences of complete MuJoCo steps, for the integrator RK4,
    which ``mjd_transitionFD`` does not support. Rows and columns of ``matrix`` are in the tangent
    space of (qpos, qvel, act); ``difference`` is the step [m, rad; m/s, rad/s].
    """
    own, nv = copy_data(model, data), model.nv
    ends = [(np.empty(model.nq), np.empty(nv), np.empty(model.na)) for _ in range(2)]
    for column in range(len(matrix)):
        for end, size in zip(ends, (-difference, difference), strict=True):
            mujoco.mj_copyData(own, model, data)
            change = np.zeros(len(matrix))
            change[column] = size
            mujoco.mj_integratePos(model, own.qpos, change[:nv], 1.0)
            own.qvel += change[nv : 2 * nv]
            own.act += change[2 * nv :]
            mujoco.mj_step(model, own)
            end[0][:], end[1][:], end[2][:] = own.qpos, own.qvel, own.act
        moved = np.empty(nv)
        mujoco.mj_differentiatePos(model, moved, 2 * difference, ends[0][0], ends[1][0])
        rates = [(ends[1][part] - ends[0][part]) / (2 * difference) for part in (1, 2)]
        matrix[:, column] = np.concatenate([moved, *rates])
    return matrix


HOLD_DURATION = 12.0
"""Duration for which a stand must hold to count as holding [s]. Slower failures are accepted,
because MuJoCo's regularised friction always slips a little: at the payload limit of Pupper v3, a
deviation doubles in 30 s."""

SETTLING_TIME = 0.5
"""Time for which a state settles before it is evaluated [s]. Contacts settle within 0.05 s; a mode
that doubles in a second grows by a factor of 1.4 only."""

_MAX_SETTLING_TIME = 600.0
"""Largest accepted settling time of `step_stability` [s]. Chosen, not tuned."""

_LIMIT_DISTANCE = 10 * DIFFERENCE_STEP
"""Distance of a joint position from a joint limit [rad, m] up to which the finite differences are
computed twice, with the limit moved to this distance on either side (`_evaluate_at_limits`).
Centred differences across a limit mix two regimes: ANYmal at a knee limit seemed to oscillate at 9
Hz, but came to rest in simulations."""

_NEUTRAL_RATE = 1e-4
"""Upper bound of |eigenvalue - 1| / (time step) of a mode that counts as neither growing nor
decaying [1/s]: such a mode needs 1.9 hours or more to double. The error of the eigenvalue replaces
the bound if it is larger. Chosen, not tuned."""

_EIGENVALUE_ERROR = 1e-9
"""Numerical error of a well-conditioned eigenvalue of the linearised MuJoCo step, measured for
finite differences with ``DIFFERENCE_STEP``. A mode whose eigenvalue has a smaller absolute value,
or a smaller angle in the complex plane [rad], is therefore not counted as an oscillation."""

_MAX_EIGENVALUE_ERROR = 1e-5
"""Upper bound of the error of an ill-conditioned eigenvalue near 1. For example, a wheel that rolls
freely has a double eigenvalue 1 with a single eigenvector; an error e of the matrix changes it by
sqrt(e). Chosen, not tuned."""

_MAX_REST_SPEED = 0.1
"""Largest element of qvel of a state at rest [m/s, rad/s]. Pupper v3 sags with up to 0.02 after the
settling time. If a state is faster, a growing mode may have moved the robot out of its initial
state, which is then evaluated as well."""

_MIN_THROWING_DOUBLINGS = 6
"""Number of doublings of a mode within the settling time from which the mode explains why a robot
has left its initial state: 6 doublings turn 1 mm into 64 mm. A robot that has left it without such
a mode was not in equilibrium there, and the modes of the initial state have no meaning (Pupper v3
while it sinks on soft servos: doubling times from 1.5 to 25 s for the same rest position)."""

_MIN_NAMED_SHARE = 0.5
"""Amplitude of a joint in a mode, relative to the largest amplitude, from which a message about the
mode contains the joint. Chosen, not tuned."""

_MAX_NAMED_JOINTS = 4
"""Largest number of joints with which a message describes a mode. Chosen, not tuned."""


@dataclass(frozen=True, eq=False)
class Mode(Result):
    """Mode of a step at a state: an eigenvalue, or a conjugate pair.

    Attributes:
        growth: |eigenvalue| - 1, per step.
        frequency: Frequency (Hz); 0 without oscillation.
        damping_ratio: 1 for decay without oscillation, 0 for an undamped oscillation, negative for
            growth.
        time_constant: Time in which the mode grows or decays by a factor of e (s).
        doubling_time: Time in which the mode doubles (s); None if the mode decays, or is sustained
            (``is_sustained``).
        joints: Joints with the largest motion in the mode, largest first.
        without_dry_friction: Whether the spectrum is that without dry friction of joints and
            tendons.
        repeated_at_second_step: Whether the spectrum with ``SECOND_STEP`` has the mode as well;
            also True if that spectrum was not computed.
        nudge: Largest initial deviation of a position (joint or base) in the simulation that
            measured growth (rad or m), 0 if only velocities deviated; None if the mode is known
            from the spectrum only. With a value, ``doubling_time`` is the simulated time.
    """

    growth: float = field(metadata={"unit": "1"})
    frequency: float = field(metadata={"unit": "Hz"})
    damping_ratio: float = field(metadata={"unit": "1"})
    time_constant: float = field(metadata={"unit": "s"})
    doubling_time: float | None = field(metadata={"unit": "s"})
    joints: tuple[str, ...]
    without_dry_friction: bool = False
    repeated_at_second_step: bool = True
    nudge: float | None = field(default=None, metadata={"unit": "rad or m"})
    _direction: Array | None = None
    _nudge_unit: str = "rad"

    @property
    def nudge_unit(self) -> str:
        """Unit (m or rad) of ``nudge``, the deviation from which growth was measured.

        m if the position with the largest initial deviation is a translation.
        """
        return self._nudge_unit

    @property
    def direction(self) -> Array:
        """Direction of the mode in the tangent space of (qpos, qvel, act), shape (2 nv + na,).

        The largest deviation of a position is 1 rad or 1 m, if any position deviates.
        """
        assert self._direction is not None
        return self._direction

    @property
    def is_sustained(self) -> bool:
        """Whether a simulation shows an oscillation that neither grows nor decays."""
        return self.nudge is not None and self.doubling_time is None

    @property
    def shakes(self) -> bool:
        """True if the mode counts as an oscillation.

        The phase advances by more than 1 rad within the time constant, and the period is shorter
        than ``HOLD_DURATION`` (slower modes are creep).
        """
        swings = 2 * math.pi * self.frequency * self.time_constant > 1
        return swings and self.frequency * HOLD_DURATION > 1

    def grows_within(self, duration: float) -> bool:
        """Return True if this mode grows fast enough to matter within ``duration`` [s].

        True for a sustained or growing oscillation of any rate, since the robot does not come to
        rest. Another mode must have a doubling time below the duration.
        """
        if self.doubling_time is None:
            return self.is_sustained
        return self.shakes or self.doubling_time < duration


@dataclass(frozen=True, eq=False)
class Stability(Result):
    """Stability of a state of a MuJoCo model, with the critical modes.

    Attributes:
        timestep: Time step (s).
        radius: Largest absolute eigenvalue of a step, with dry friction.
        unstable: Modes that grow, fastest first; those that need the absence of dry friction, only
            if they grow within ``HOLD_DURATION``. After ``confirm_growth``, modes that leave the
            state within ``HOLD_DURATION`` are confirmed by a simulation.
        least_damped: Decaying oscillation with the smallest damping ratio, with or without dry
            friction; None if no oscillation decays.
        speed: Largest element of qvel at the evaluated state (m/s or rad/s). If the state is not at
            rest, the spectrum does not describe the stability.
        uses_noslip_solver: Whether MuJoCo's no-slip solver is active. Friction then holds buckling
            modes until the contact slips; a simulation shows such modes, the spectrum does not.
        refuted_modes: Modes that grow in the spectrum, and that a nudged simulation does not
            confirm.
    """

    timestep: float = field(metadata={"unit": "s"})
    radius: float = field(metadata={"unit": "1"})
    unstable: tuple[Mode, ...]
    least_damped: Mode | None
    speed: float = field(metadata={"unit": "m/s or rad/s"})
    uses_noslip_solver: bool
    refuted_modes: tuple[Mode, ...] = ()

    @property
    def at_rest(self) -> bool:
        """True if ``speed``, the largest element of qvel, is at most 0.1 (m/s or rad/s).

        Only then are the growth rates of the modes meaningful.
        """
        return self.speed <= _MAX_REST_SPEED

    @property
    def stable(self) -> bool:
        """Whether no mode grows at the evaluated state."""
        return not self.unstable

    @property
    def doubling_time(self) -> float | None:
        """Doubling time of the first mode in ``unstable``, which grows fastest [s].

        None if no mode grows, or this mode is a sustained oscillation.
        """
        return self.unstable[0].doubling_time if self.unstable else None

    @property
    def damping_ratio(self) -> float:
        """Smallest damping ratio of all oscillations; 1 without any, negative if one grows.

        Growing modes count if `Mode.shakes` is true.
        """
        swinging = [mode for mode in self.unstable if mode.shakes]
        swinging += [self.least_damped] if self.least_damped is not None else []
        return min((mode.damping_ratio for mode in swinging), default=1.0)

    def modes_growing_within(self, duration: float = HOLD_DURATION) -> tuple[Mode, ...]:
        """Return the unstable modes for which `Mode.grows_within` is true for a duration [s].

        If MuJoCo's no-slip solver is active (``uses_noslip_solver``), only oscillations are
        returned, because friction prevents slow buckling.
        """
        growing = (mode for mode in self.unstable if mode.grows_within(duration))
        return tuple(mode for mode in growing if mode.shakes or not self.uses_noslip_solver)

    def is_stable_for(self, duration: float = HOLD_DURATION) -> bool:
        """Return True if no mode grows enough within a duration [s]; see `modes_growing_within`."""
        return not self.modes_growing_within(duration)


@check_arguments
def step_stability(
    model: mujoco.MjModel, data: mujoco.MjData, *, settle: float = SETTLING_TIME
) -> Stability:
    """Evaluate the stability of a state by the eigenvalues of a MuJoCo step.

    A step maps a deviation x of (qpos, qvel, act) to A x, with contacts, servos under their
    commands (``data.ctrl``), friction and integrator of the model. A mode with an eigenvalue
    outside of the unit circle grows: as an oscillation if complex (the robot shakes), otherwise
    monotonically (it buckles). With time step h, the rate is ln|eigenvalue| / h.

    Dry friction of joints and tendons is viscous in MuJoCo while nothing slides, and hides a mode
    until a push overcomes the friction. Modes that grow within ``HOLD_DURATION``
    (`Mode.grows_within`) in a model without this friction are therefore returned as well, with
    ``Mode.without_dry_friction``. The friction of contacts is not changed.

    The spectrum is valid for states at rest (``Stability.speed``) and small deviations. For larger
    pushes, simulate.

    Source: MuJoCo documentation, ``mjd_transitionFD``; in the tangent space of qpos.

    Args:
        model: MuJoCo model. During the call the solver tolerance is smaller, sleeping is disabled,
            joint limits may be displaced by up to 2e-6 rad or m, and the dry friction of joints and
            tendons may be zero.
        data: State with ``ctrl``; not changed.
        settle: Time for which the state is simulated first [s].

    Returns:
        The growing modes with and without dry friction, and the decaying oscillation with the
        smallest damping ratio.

    Raises:
        ConfigurationError: If an argument has another type, or ``settle`` is not from 0 to 600 s.
    """
    if not 0 <= settle <= _MAX_SETTLING_TIME:
        raise ConfigurationError(
            "settle", diagnose("settling-time", settle=settle, most=_MAX_SETTLING_TIME)
        )
    return judge_settled(model, data, settle)[0]


def judge_settled(
    model: mujoco.MjModel, data: mujoco.MjData, settle: float
) -> tuple[Stability, mujoco.MjData]:
    """Simulate a state for a settling time, and compute the stability in the settled state.

    Returns the result as of `step_stability`, and the state to which the result applies: normally
    the state after settling. The result applies to the initial state in three cases:

    - ``settle`` is below half a time step,
    - the simulation diverges,
    - only the initial state is at rest, and its fastest growing mode doubles more than
      ``_MIN_THROWING_DOUBLINGS`` times during settling, so that the mode explains the motion.
    """
    start, data = data, copy_data(model, data)
    steps = round(settle / model.opt.timestep)
    if not steps:
        return _evaluate_friction(model, data), data
    with silence_mujoco():
        mujoco.mj_step(model, data, steps)
    before = copy_data(model, start)
    if data.time < start.time + (steps - 0.5) * model.opt.timestep:
        # The simulation diverged, and MuJoCo reset the state.
        return _evaluate_friction(model, before), before
    found = _evaluate_friction(model, data)
    if found.at_rest:
        return found, data
    other = _evaluate_friction(model, before)
    threw = (other.doubling_time or math.inf) < settle / _MIN_THROWING_DOUBLINGS
    return (other, before) if other.at_rest and threw else (found, data)


def _evaluate_friction(model: mujoco.MjModel, data: mujoco.MjData) -> Stability:
    """Evaluate a state with and without the dry friction of joints and tendons.

    The result is that with dry friction. Growing modes without dry friction are added if they grow
    within ``HOLD_DURATION``. The least damped mode is that with the smaller damping ratio of both.
    """
    found = _mark_repeated(model, data, _evaluate_at_limits(model, data))
    rubbing = model.dof_frictionloss, model.tendon_frictionloss
    rubs = any(values.any() for values in rubbing)
    if not rubs:
        return found
    kept = [values.copy() for values in rubbing]
    for values in rubbing:
        values[:] = 0.0
    try:
        free = _mark_repeated(model, data, _evaluate_at_limits(model, copy_data(model, data)))
    finally:
        for values, before in zip(rubbing, kept, strict=True):
            values[:] = before
    freed = [
        replace(mode, without_dry_friction=True)
        for mode in free.unstable
        if mode.grows_within(HOLD_DURATION)
    ]
    unstable = sorted([*found.unstable, *freed], key=lambda mode: -mode.growth)
    damped = [found.least_damped] if found.least_damped is not None else []
    damped += (
        [replace(free.least_damped, without_dry_friction=True)]
        if free.least_damped is not None
        else []
    )
    least = min(damped, key=lambda mode: mode.damping_ratio, default=None)
    return replace(found, unstable=tuple(unstable), least_damped=least)


def _mark_repeated(model: mujoco.MjModel, data: mujoco.MjData, found: Stability) -> Stability:
    """Set ``repeated_at_second_step`` of the growing modes, by a second spectrum.

    A growing mode that disappears with the other finite-difference step, ``SECOND_STEP``, may be an
    error of the differences. If `Stability.modes_growing_within` returns no mode, no second
    spectrum is computed, and the result is ``found``.
    """
    if not found.modes_growing_within():
        return found
    second = _evaluate_at_limits(model, copy_data(model, data), SECOND_STEP).unstable

    def repeats(mode: Mode) -> bool:
        """Return True if the second spectrum has a mode with nearly the growth rate of ``mode``.

        The second spectrum is computed with the finite-difference step ``SECOND_STEP``. The rates
        differ by at most ``_RATE_TOLERANCE`` (relative).
        """
        return any(
            abs(again.growth - mode.growth) <= _RATE_TOLERANCE * mode.growth for again in second
        )

    modes = (replace(mode, repeated_at_second_step=repeats(mode)) for mode in found.unstable)
    return replace(found, unstable=tuple(modes))


def _evaluate_at_limits(
    model: mujoco.MjModel, data: mujoco.MjData, difference: float = DIFFERENCE_STEP
) -> Stability:
    """Evaluate the spectrum of a state in which joints may be at their limits.

    Finite differences are invalid across a limit. If joints are within `_LIMIT_DISTANCE` of the
    positions at which limits begin to act (``margin`` included), these positions are moved to this
    distance from the joint positions, once so that the joints are inside and once so that they are
    beyond. The result with the larger spectral radius is returned.
    ``difference`` is the finite-difference step.
    """
    scalar = np.isin(model.jnt_type, (JointKind.HINGE, JointKind.SLIDE))
    angles = data.qpos[model.jnt_qposadr][:, None]
    ends = angles + np.outer(model.jnt_margin, (-1.0, 1.0))  # limits at the present position
    limited = (scalar & (model.jnt_limited == 1))[:, None]
    edges = limited & (np.abs(ends - model.jnt_range) <= _LIMIT_DISTANCE)
    if not edges.any():
        return _Modes(model, data, difference).summarise()
    ranges, found = model.jnt_range.copy(), []
    try:
        for apart in (-_LIMIT_DISTANCE, _LIMIT_DISTANCE):
            moved = ends + np.array([apart, -apart])
            model.jnt_range[:] = np.where(edges, moved, ranges)
            found.append(_Modes(model, copy_data(model, data), difference).summarise())
    finally:
        model.jnt_range[:] = ranges
    return max(found, key=lambda result: result.radius)


class _Modes:
    """Eigenvalues and eigenvectors of a step at a state.

    Args:
        model: MuJoCo model.
        data: State, after ``mj_forward`` or ``mj_step``.
        difference: Step of the centred differences.
    """

    def __init__(
        self, model: mujoco.MjModel, data: mujoco.MjData, difference: float = DIFFERENCE_STEP
    ) -> None:
        self._model, self._data = model, data
        matrix = step_derivative(model, data, difference)
        matrix = np.where(np.isfinite(matrix), matrix, 0.0)
        self._values, left, self._vectors = lapack.eig(matrix)
        aligned = np.abs(np.sum(left.conj() * self._vectors, axis=0))
        error = np.minimum(
            _EIGENVALUE_ERROR / np.maximum(aligned, _EIGENVALUE_ERROR), _MAX_EIGENVALUE_ERROR
        )
        self._growth = np.abs(self._values) - 1
        still = np.maximum(_NEUTRAL_RATE * float(model.opt.timestep), error)
        self._drifts = np.abs(self._values - 1) <= still
        # An undamped pendulum must not count as growing by rounding.
        self._grows = (self._growth > still) & ~self._drifts

    def summarise(self) -> Stability:
        """Create the `Stability` of the modes: growing modes, and the least damped oscillation."""
        model, data = self._model, self._data
        single = self._values.imag >= 0  # one of each conjugate pair
        growing = np.flatnonzero(self._grows & single)
        growing = growing[np.argsort(-self._growth[growing])]
        # A mode that decays within a step is no oscillation.
        decaying = single & ~self._grows & ~self._drifts & (self._growth > -1 + _EIGENVALUE_ERROR)
        swinging = np.flatnonzero(decaying & (np.abs(np.angle(self._values)) > _EIGENVALUE_ERROR))
        damped = [self._damping_ratio(mode) for mode in swinging.tolist()]
        return Stability(
            timestep=float(model.opt.timestep),
            radius=1 + float(self._growth.max(initial=-1.0)),
            unstable=tuple(self._make_mode(mode) for mode in growing.tolist()),
            least_damped=self._make_mode(int(swinging[int(np.argmin(damped))])) if damped else None,
            speed=float(np.abs(data.qvel).max(initial=0.0)),
            uses_noslip_solver=bool(model.opt.noslip_iterations > 0),
        )

    def _damping_ratio(self, mode: int) -> float:
        """Return the damping ratio of the mode with eigenvalue number ``mode``.

        The ratio is ``-Re(s) / abs(s)`` with s = ln(eigenvalue): 1 for monotonic decay, 0 for an
        undamped oscillation, negative for growth.
        """
        exponent = np.log(self._values[mode])
        return float(-exponent.real / abs(exponent))

    def _make_mode(self, mode: int) -> Mode:
        """Create the result for eigenvalue number ``mode``."""
        timestep = float(self._model.opt.timestep)
        value, growth = self._values[mode], float(self._growth[mode])
        constant = timestep / abs(math.log1p(growth)) if growth else math.inf
        return Mode(
            growth=growth,
            frequency=abs(float(np.angle(value))) / (2 * math.pi * timestep),
            damping_ratio=self._damping_ratio(mode),
            time_constant=constant,
            doubling_time=math.log(2) * constant if self._grows[mode] else None,
            joints=select_most_moving(self._joint_motions(mode)),
            _direction=self._mode_direction(mode),
        )

    def _mode_direction(self, mode: int) -> Array:
        """Return the real part of a mode's eigenvector, shape (2 nv + na,).

        The eigenvector is divided by its largest position component (one of the first nv).
        """
        vector = self._vectors[:, mode]
        largest = vector[int(np.abs(vector[: self._model.nv]).argmax())] if self._model.nv else 1.0
        return np.asarray(np.real(vector / largest)) if largest else np.real(vector)

    def _joint_motions(self, mode: int) -> dict[str, float]:
        """Return the relative amplitude of each joint in a mode [rad, m], without free joints.

        Only the ratios of the amplitudes have a meaning: an eigenvector has no scale.
        """
        model, moves = self._model, np.abs(self._vectors[: self._model.nv, mode])
        ends = [*model.jnt_dofadr[1:].tolist(), model.nv] if model.njnt else []
        return {
            model.joint(joint).name: float(moves[model.jnt_dofadr[joint] : end].max())
            for joint, end in enumerate(ends)
            if model.jnt_type[joint] != JointKind.FREE
        }


def select_most_moving(shares: dict[str, float]) -> tuple[str, ...]:
    """Return the names of up to `_MAX_NAMED_JOINTS` joints that move most, the largest first.

    Joints that do not move, or less than `_MIN_NAMED_SHARE` of the largest motion, are omitted.

    Args:
        shares: {joint: magnitude of its motion}, for example amplitudes [rad, m]; only the ratios
            count.
    """
    names = sorted(shares, key=shares.__getitem__, reverse=True)
    least = _MIN_NAMED_SHARE * shares[names[0]] if names else 0.0
    return tuple(name for name in names[:_MAX_NAMED_JOINTS] if shares[name] >= least > 0)
