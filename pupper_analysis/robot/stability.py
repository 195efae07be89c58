"""Stability of a simulated state, from the eigenvalues of a linearised MuJoCo step.

The step includes contacts, servos and the integrator. `step_stability` returns the modes that grow.
A growing mode is only a hypothesis, for two reasons. If a foot carries almost no load, the
linearisation is valid only for motions of micrometres. If a joint has dry friction, the
linearisation depends on the finite-difference step. ``simulation.growth`` tests the hypothesis in a
nudged simulation.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
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
"""Finite-difference step with which a MuJoCo time step is linearised, for positions [m, rad] and
velocities [m/s, rad/s]. The step must be small, because contact forces are nonlinear over 1e-5 m.
Measured: the error of the eigenvalues is about 1e-9."""

SECOND_STEP = 3e-8
"""Second finite-difference step, for positions [m, rad] and velocities [m/s, rad/s]. Growing modes
count as repeatable if the spectrum with this step contains them as well. Reason: two public MJCFs
with dry friction have a spectral radius of 1.041 with ``DIFFERENCE_STEP``, and of 1.000 with this
step."""

_RATE_TOLERANCE = 0.3
"""Largest relative difference [1] between the growths per time step, |eigenvalue| - 1, of two modes
that count as the same mode. The modes are computed with two finite-difference steps. Chosen, not
tuned.
"""

_EQUAL_GROWTH_RTOL = 1e-3
"""Upper bound of the relative difference between the growths per time step [1] of a mode with and a
mode without dry friction that count as the same mode. Chosen, not tuned: a joint that dry friction
holds does not take part in a mode."""

_CONVERGED_TOLERANCE, _MIN_CONVERGED_ITERATIONS = 1e-14, 100
"""Upper bound of MuJoCo's solver tolerance [1], and lower bound of the maximum of iterations [1],
with which contact forces converge (`use_converged_solver`). The second is MuJoCo's default. With
the default tolerance of 1e-8, Newton's method sometimes ends an iteration earlier on one side of a
finite difference; an element of the matrix then deviates by 0.03 (measured)."""


def has_converged_solver(model: mujoco.MjModel) -> bool:
    """Return True if a model's solver computes contact forces as in linearised steps, or nearly.

    Otherwise the modes of the linearised step (`step_derivative`) are not modes of the model.
    """
    is_newton = model.opt.solver == mujoco.mjtSolver.mjSOL_NEWTON
    return bool(is_newton and model.opt.iterations >= _MIN_CONVERGED_ITERATIONS)


def use_converged_solver(model: mujoco.MjModel) -> None:
    """Change a model's solver options, so that contact forces converge to rounding.

    The solver becomes Newton's method, since CG and PGS do not converge that far. Measured on
    Pupper v3 at rest: elements of the linearised step deviate by 2.8 with CG, and by 0.08 with PGS,
    both with the tolerance of 1e-14.
    """
    model.opt.solver = mujoco.mjtSolver.mjSOL_NEWTON
    model.opt.tolerance = min(float(model.opt.tolerance), _CONVERGED_TOLERANCE)
    model.opt.iterations = max(int(model.opt.iterations), _MIN_CONVERGED_ITERATIONS)


def remove_negligible_friction(model: mujoco.MjModel) -> None:
    """Set ``condim`` 1 for contacts whose sliding friction is at most MuJoCo's minimum.

    MuJoCo replaces a sliding friction below ``mjMINMU`` (1e-5) by this minimum. Such a contact
    sticks for motions of nanometres only. A finite difference is larger, and mixes sticking and
    slipping. Torsional and rolling friction of these contacts is removed, too. Models with the flag
    ``override`` are not changed.
    """
    if model.opt.enableflags & mujoco.mjtEnableBit.mjENBL_OVERRIDE.value:
        return
    is_slippery = model.geom_friction[:, 0] <= mujoco.mjMINMU
    # If two priorities are equal, MuJoCo combines the larger condim with the larger friction.
    rough = np.flatnonzero((model.geom_condim == 1) & ~is_slippery)
    is_combined = np.isin(model.geom_priority, model.geom_priority[rough])
    model.geom_condim[is_slippery & ~is_combined] = 1
    model.pair_dim[(model.pair_friction[:, :2] <= mujoco.mjMINMU).all(axis=1)] = 1


SLEEP_FLAG = mujoco.mjtEnableBit.mjENBL_SLEEP.value
"""Bit of MuJoCo's enable flags that lets resting bodies sleep, ``<flag sleep="enable"/>``. MuJoCo
does not simulate a sleeping body."""


def copy_data(model: mujoco.MjModel, data: mujoco.MjData) -> mujoco.MjData:
    """Return a copy of a MuJoCo state with separate memory, evaluated by ``mj_forward``.

    Args:
        model: MuJoCo model.
        data: State. All inputs of a time step are copied (``mjSTATE_INTEGRATION``).
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
    """Linearise a MuJoCo time step: derivative of the next state with respect to the state.

    Computed by central differences (``mjd_transitionFD``; complete steps for the integrator RK4).

    Args:
        model: MuJoCo model. During the call, the solver converges (`use_converged_solver`),
            sleeping is disabled, and negligible friction is removed
            (`remove_negligible_friction`).
        data: State; not changed, but derived quantities (for example accelerations) may be
            recomputed.
        difference: Finite-difference step [m, rad; m/s, rad/s].

    Returns:
        Matrix, shape (2 nv + na, 2 nv + na). Rows and columns are in the tangent space of (qpos,
        qvel, act), in MuJoCo's order.
    """
    size = 2 * model.nv + model.na
    matrix, option, flags = np.zeros((size, size)), model.opt, int(model.opt.enableflags)
    solver = option.solver, option.tolerance, option.iterations
    dimensions = model.geom_condim.copy(), model.pair_dim.copy()
    use_converged_solver(model)
    remove_negligible_friction(model)
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
        option.solver, option.tolerance, option.iterations = solver
        option.enableflags = flags
        model.geom_condim[:], model.pair_dim[:] = dimensions
    return matrix


def _difference_steps(
    model: mujoco.MjModel, data: mujoco.MjData, matrix: Array, difference: float = DIFFERENCE_STEP
) -> Array:
    """Linearise a MuJoCo step (RK4) by central differences of complete steps; fill ``matrix``."""
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
"""Duration for which a stand must hold [s]. A mode with a longer doubling time is accepted unless
it oscillates, because MuJoCo's regularised friction slips slowly."""

SETTLING_TIME = 0.5
"""Default simulated time before a state is evaluated [s]. Contacts need less time to settle, and a
mode that doubles in a second grows by a factor of only 1.4. Chosen, not tuned."""

_MAX_SETTLING_TIME = 600.0
"""Largest accepted settling time of `step_stability` [s]. Chosen, not tuned."""

_LIMIT_DISTANCE = 10 * DIFFERENCE_STEP
"""Distance from a joint limit [rad, m] up to which a joint counts as near the limit. The spectrum
is then evaluated at this distance on either side of the limit, since centred differences across a
limit mix two regimes."""

_NEUTRAL_RATE = 1e-4
"""Value of |eigenvalue - 1| / (time step) up to which a mode counts as neither growing nor decaying
[1/s], unless the numerical error of the eigenvalue is larger. A mode with this growth rate doubles
in 1.9 hours. Chosen, not tuned."""

_EIGENVALUE_ERROR = 1e-9
"""Numerical error of a well-conditioned eigenvalue of the linearised MuJoCo step [1], measured with
``DIFFERENCE_STEP``. A decaying mode counts as oscillation only if angle and magnitude of its
eigenvalue exceed this value."""

_MAX_EIGENVALUE_ERROR = 1e-5
"""Upper bound of the assumed error of an ill-conditioned eigenvalue [1]. For example, a wheel that
rolls freely has a double eigenvalue 1 with a single eigenvector. An error e of the matrix changes
this eigenvalue by sqrt(e). Chosen, not tuned."""

_MAX_REST_SPEED = 0.1
"""Largest absolute element of qvel with which a state counts as at rest [m/s, rad/s]. Chosen, not
tuned: a robot may still sag slowly after the settling time."""

_MIN_THROWING_DOUBLINGS = 6
"""Number of doublings of a mode within the settling time, above which the mode explains a motion
out of the initial state: 6 doublings turn 1 mm into 64 mm."""

_MIN_NAMED_SHARE = 0.5
"""Lower bound of the amplitude of a joint that a message about a mode names, relative to the
largest amplitude [1]. Chosen, not tuned."""

_MAX_NAMED_JOINTS = 4
"""Maximum number of joints that a message about a mode names. Chosen, not tuned."""


@dataclass(frozen=True, eq=False)
class Mode(Result):
    """Mode of a linearised MuJoCo step: one eigenvalue, or a conjugate pair of eigenvalues.

    Attributes:
        growth: |eigenvalue| - 1: relative growth per time step.
        frequency: Frequency (Hz); 0 without oscillation.
        damping_ratio: 1 for decay without oscillation, 0 for an undamped oscillation, negative for
            growth.
        time_constant: Time in which the mode grows or decays by a factor of e (s); inf if neither.
        doubling_time: Time in which the mode doubles (s); None if the mode does not grow, or is
            sustained (``is_sustained``).
        joints: Joints with the largest motion in the mode, largest first.
        without_dry_friction: Whether the mode is taken from the spectrum without dry friction of
            joints and tendons.
        repeated_at_second_step: Whether the spectrum with ``SECOND_STEP`` contains the mode as
            well. Also True if that spectrum was not computed.
        nudge: Initial deviation in the simulation that measured the growth (rad or m). The value is
            the largest deviation of a joint or base position, or 0 if only velocities deviated.
            None if the mode is known only from the spectrum. With a nudge, ``doubling_time`` is
            measured in the simulation.
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
        """Unit of ``nudge``, m or rad."""
        return self._nudge_unit

    @property
    def direction(self) -> Array:
        """Direction of the mode in the tangent space of (qpos, qvel, act), shape (2 nv + na,).

        The real part of the eigenvector, scaled so that the largest deviation of a position is 1
        rad or 1 m. Not scaled if no position deviates.
        """
        assert self._direction is not None
        return self._direction

    @property
    def is_sustained(self) -> bool:
        """Whether a simulation shows a sustained oscillation: it neither grows nor decays."""
        return self.nudge is not None and self.doubling_time is None

    @property
    def shakes(self) -> bool:
        """True if the mode counts as an oscillation.

        Its phase then advances by more than 1 rad within the time constant, and its period is below
        12 s (``HOLD_DURATION``): slower modes count as creep.
        """
        swings = 2 * math.pi * self.frequency * self.time_constant > 1
        return swings and self.frequency * HOLD_DURATION > 1

    def grows_within(self, duration: float) -> bool:
        """Return True if this mode prevents a robot from staying at rest for ``duration`` [s].

        True for a sustained oscillation, a growing oscillation (``shakes``), or a doubling time
        below ``duration``.
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
        unstable: Modes that grow, fastest first. A mode that grows only without dry friction is
            included if it oscillates, or grows within 12 s (``HOLD_DURATION``). For a state at
            rest, ``confirm_growth`` replaces the modes that grow within 12 s by modes that a
            simulation has confirmed.
        least_damped: Oscillation with the smallest damping ratio among the oscillations that do not
            grow, with or without dry friction; None if there is none.
        speed: Largest absolute element of qvel at the evaluated state (m/s or rad/s). If the state
            is not at rest, the spectrum does not describe the stability.
        uses_noslip_solver: Whether MuJoCo's no-slip solver is active. Friction then stops buckling
            until the contact slips. A simulation shows this, the spectrum does not.
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
        """True if ``speed``, the largest absolute element of qvel, is at most 0.1 (m/s or rad/s).

        The growth rates of the modes are meaningful only if this is true.
        """
        return self.speed <= _MAX_REST_SPEED

    @property
    def stable(self) -> bool:
        """Whether ``unstable`` is empty: no mode counts as growing at the evaluated state."""
        return not self.unstable

    @property
    def doubling_time(self) -> float | None:
        """Doubling time [s] of the fastest growing mode, the first in ``unstable``.

        None if no mode grows, or if that mode is a sustained oscillation.
        """
        return self.unstable[0].doubling_time if self.unstable else None

    @property
    def damping_ratio(self) -> float:
        """Smallest damping ratio of the oscillations; 1 without oscillations.

        Negative if a growing mode oscillates (`Mode.shakes`).
        """
        swinging = [mode for mode in self.unstable if mode.shakes]
        swinging += [self.least_damped] if self.least_damped is not None else []
        return min((mode.damping_ratio for mode in swinging), default=1.0)

    def modes_growing_within(self, duration: float = HOLD_DURATION) -> tuple[Mode, ...]:
        """Return the unstable modes that grow within a duration [s], by `Mode.grows_within`.

        If MuJoCo's no-slip solver is active (``uses_noslip_solver``), only oscillations are
        returned, because friction prevents slow buckling.
        """
        growing = (mode for mode in self.unstable if mode.grows_within(duration))
        return tuple(mode for mode in growing if mode.shakes or not self.uses_noslip_solver)

    def is_stable_for(self, duration: float = HOLD_DURATION) -> bool:
        """Return True if no mode grows within a duration [s]; see `modes_growing_within`."""
        return not self.modes_growing_within(duration)


@check_arguments
def step_stability(
    model: mujoco.MjModel, data: mujoco.MjData, *, settle: float = SETTLING_TIME
) -> Stability:
    """Evaluate the stability of a state by the eigenvalues of a MuJoCo step.

    A time step maps a deviation x of (qpos, qvel, act) to A x. A includes contacts, friction, the
    integrator, and the servos with their commands (``data.ctrl``). A mode grows if its eigenvalue
    is outside of the unit circle. With a complex eigenvalue, the robot oscillates (shakes); with a
    positive real eigenvalue, it buckles monotonically. With the time step h, the growth rate is
    ln|eigenvalue| / h [1/s].

    While nothing slides, MuJoCo's dry friction of joints and tendons acts as viscous friction,
    which hides modes until a push overcomes it. Therefore the spectrum without this friction is
    computed as well; its additional modes are marked by ``Mode.without_dry_friction``.

    The spectrum is valid for states at rest (``Stability.speed``) and small deviations. For larger
    deviations, use a simulation.

    Source: MuJoCo documentation, ``mjd_transitionFD``.

    Args:
        model: MuJoCo model. The call changes and restores the solver options, the sleep flag,
            joint limits (by up to 2e-6 rad or m), and the dry friction of joints and tendons.
        data: State with ``ctrl``; not changed.
        settle: Simulated time before the evaluation [s], from 0 to 600 s.

    Returns:
        The growing modes with and without dry friction, and the oscillation with the smallest
        damping ratio of all oscillations that do not grow.

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
    """Simulate a state for a settling time, and compute its stability as in `step_stability`.

    The evaluated state is normally the state after settling. It is the initial state if the
    simulation diverges, or if a growing mode of the initial state explains that the robot moved
    away, for example.

    Args:
        model: MuJoCo model; changed during the call, and restored.
        data: Initial state; not changed.
        settle: Settling time [s].

    Returns:
        The stability, and the evaluated state.
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
    start_stability = _evaluate_friction(model, before)
    threw = (start_stability.doubling_time or math.inf) < settle / _MIN_THROWING_DOUBLINGS
    return (start_stability, before) if start_stability.at_rest and threw else (found, data)


def _evaluate_friction(model: mujoco.MjModel, data: mujoco.MjData) -> Stability:
    """Evaluate the stability of a state, and add modes that grow without dry friction."""
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
        for mode in _list_further_modes(free.unstable, found.unstable)
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


def _list_further_modes(modes: Iterable[Mode], known: Iterable[Mode]) -> list[Mode]:
    """Return the modes that ``known`` does not contain, compared by growth per time step."""
    further = list(modes)
    for mode in known:
        equal = [
            candidate
            for candidate in further
            if abs(candidate.growth - mode.growth) <= _EQUAL_GROWTH_RTOL * mode.growth
        ]
        alike = [candidate for candidate in equal if candidate.joints == mode.joints]
        for match in (alike or equal)[:1]:
            further.remove(match)
    return further


def _mark_repeated(model: mujoco.MjModel, data: mujoco.MjData, found: Stability) -> Stability:
    """Check growing modes with ``SECOND_STEP``, and set their ``repeated_at_second_step``."""
    if not found.modes_growing_within():
        return found
    second = _evaluate_at_limits(model, copy_data(model, data), SECOND_STEP).unstable

    def repeats(mode: Mode) -> bool:
        """Return True if the second spectrum has a mode with nearly the same growth per step."""
        return any(
            abs(again.growth - mode.growth) <= _RATE_TOLERANCE * mode.growth for again in second
        )

    modes = (replace(mode, repeated_at_second_step=repeats(mode)) for mode in found.unstable)
    return replace(found, unstable=tuple(modes))


def _evaluate_at_limits(
    model: mujoco.MjModel, data: mujoco.MjData, difference: float = DIFFERENCE_STEP
) -> Stability:
    """Evaluate the stability of a state in which joints may be at limits.

    Finite differences across a limit are invalid. Limits near the present position are therefore
    moved to either side; the evaluation with the larger spectral radius is returned.
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
    """Eigenvalues and eigenvectors of a linearised MuJoCo step at a state.

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
        """Create a `Stability` with the growing modes and the least damped oscillation."""
        model, data = self._model, self._data
        single = self._values.imag >= 0  # one of each conjugate pair
        growing = np.flatnonzero(self._grows & single)
        growing = growing[np.argsort(-self._growth[growing])]
        # A mode that decays within a step is no oscillation.
        decaying = single & ~self._grows & ~self._drifts & (self._growth > -1 + _EIGENVALUE_ERROR)
        swinging = np.flatnonzero(decaying & (np.abs(np.angle(self._values)) > _EIGENVALUE_ERROR))
        damped = [self._compute_damping_ratio(mode) for mode in swinging.tolist()]
        return Stability(
            timestep=float(model.opt.timestep),
            radius=1 + float(self._growth.max(initial=-1.0)),
            unstable=tuple(self._make_mode(mode) for mode in growing.tolist()),
            least_damped=self._make_mode(int(swinging[int(np.argmin(damped))])) if damped else None,
            speed=float(np.abs(data.qvel).max(initial=0.0)),
            uses_noslip_solver=bool(model.opt.noslip_iterations > 0),
        )

    def _compute_damping_ratio(self, mode: int) -> float:
        """Return the damping ratio -Re(s) / abs(s) of a mode index, with s = ln(eigenvalue)."""
        exponent = np.log(self._values[mode])
        return float(-exponent.real / abs(exponent))

    def _make_mode(self, mode: int) -> Mode:
        """Create the `Mode` of the eigenvalue with the index ``mode``."""
        timestep = float(self._model.opt.timestep)
        value, growth = self._values[mode], float(self._growth[mode])
        constant = timestep / abs(math.log1p(growth)) if growth else math.inf
        return Mode(
            growth=growth,
            frequency=abs(float(np.angle(value))) / (2 * math.pi * timestep),
            damping_ratio=self._compute_damping_ratio(mode),
            time_constant=constant,
            doubling_time=math.log(2) * constant if self._grows[mode] else None,
            joints=select_most_moving(self._joint_motions(mode)),
            _direction=self._compute_mode_direction(mode),
        )

    def _compute_mode_direction(self, mode: int) -> Array:
        """Return the real part of eigenvector / largest position entry, shape (2 nv + na,)."""
        vector = self._vectors[:, mode]
        largest = vector[int(np.abs(vector[: self._model.nv]).argmax())] if self._model.nv else 1.0
        return np.asarray(np.real(vector / largest)) if largest else np.real(vector)

    def _joint_motions(self, mode: int) -> dict[str, float]:
        """Return {joint: relative amplitude in a mode}, without free joints."""
        model, moves = self._model, np.abs(self._vectors[: self._model.nv, mode])
        ends = [*model.jnt_dofadr[1:].tolist(), model.nv] if model.njnt else []
        return {
            model.joint(joint).name: float(moves[model.jnt_dofadr[joint] : end].max())
            for joint, end in enumerate(ends)
            if model.jnt_type[joint] != JointKind.FREE
        }


def select_most_moving(shares: dict[str, float]) -> tuple[str, ...]:
    """Select the joints that move most, for a message; the largest motion comes first.

    At most four joints are selected. Joints that move much less than the first are omitted.

    Args:
        shares: {joint: magnitude of its motion}, for example amplitudes [rad, m]. Only the ratios
            are used.
    """
    names = sorted(shares, key=shares.__getitem__, reverse=True)
    least = _MIN_NAMED_SHARE * shares[names[0]] if names else 0.0
    return tuple(name for name in names[:_MAX_NAMED_JOINTS] if shares[name] >= least > 0)
