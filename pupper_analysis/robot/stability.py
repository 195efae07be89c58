"""Spectrum of one MuJoCo step at a state, with contacts, servos and integrator as they are.

A mode that grows is a hypothesis: the linearisation is valid for motions of micrometres only if a
foot carries next to nothing, and it depends on the finite-difference step if a joint has dry
friction. ``simulation.growth`` tests the hypothesis in a nudged simulation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.base.results import Result
from pupper_analysis.models.mjcf import JointKind, silence_mujoco

Array = NDArray[np.float64]

DIFFERENCE_STEP = 1e-7
"""Step of the centred differences (m, rad, and their rates). Contacts are curved over 1e-5; the
error of the eigenvalues is 1e-9 with this step, and as much with 1e-6."""

SECOND_STEP = 3e-8
"""Step with which a mode that grows must be found again. Two public MJCFs with dry friction have a
spectral radius of 1.041 with ``DIFFERENCE_STEP``, and of 1.000 with this step."""

_RATE_TOLERANCE = 0.3
"""Relative difference of the growth per step up to which both steps agree on a mode."""

_TOLERANCE = 1e-14
"""Of the solver while differences are taken: with the usual 1e-8 it sometimes ends an iteration
earlier on one side of a difference, and an element is off by 0.03. A copy of the model, with the
meshes of a humanoid, takes longer than all else."""


SLEEP_FLAG = mujoco.mjtEnableBit.mjENBL_SLEEP.value
"""``<flag sleep="enable"/>``."""


def copy_data(model: mujoco.MjModel, data: mujoco.MjData) -> mujoco.MjData:
    """Returns data of its own at the same state.

    Args:
        model: The model.
        data: The state.
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
    """Compute the derivative of a step by the state, shape (2 nv + na, 2 nv + na).

    Args:
        model: MuJoCo model. The tolerance of its solver is tightened during the call.
        data: State; it is not changed.
        difference: Step of the centred differences (m, rad, and their rates).
    """
    size = 2 * model.nv + model.na
    matrix, tolerance = np.zeros((size, size)), float(model.opt.tolerance)
    flags = int(model.opt.enableflags)
    model.opt.tolerance = min(tolerance, _TOLERANCE)
    # What sleeps has no derivative: a change of its state wakes it, or is forgotten.
    model.opt.enableflags = flags & ~SLEEP_FLAG
    if flags & SLEEP_FLAG:
        data = copy_data(model, data)
    try:
        if model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4.value:  # which MuJoCo's has not
            return _differences(model, data, matrix, difference)
        mujoco.mjd_transitionFD(model, data, difference, True, matrix, None, None, None)
    finally:
        model.opt.tolerance, model.opt.enableflags = tolerance, flags
    return matrix


def _differences(
    model: mujoco.MjModel, data: mujoco.MjData, matrix: Array, difference: float = DIFFERENCE_STEP
) -> Array:
    """Fill in centred differences of whole steps."""
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
"""How long what is said to hold must hold (s). Regularised friction creeps, and what is carried by
it buckles slowly: v3's payload limit doubles a deviation in 30 s."""

SETTLING_TIME = 0.5
"""Time for which a state settles before it is judged (s): contacts meet their loads in some 0.05 s,
and a mode that doubles in a second has multiplied rounding by 1.4."""

_LONGEST_DOUBLING = 600.0  # s: what is simulated at most, as of a stand

_EDGE = 10 * DIFFERENCE_STEP
"""So near to its limit a joint is at it (rad, m): differences would be taken half inside, half
outside, and their mean is the motion of neither. ANYmal at a hard limit of its knees was said to
shake at 9 Hz, and forgot each nudge."""

_NEUTRAL_RATE = 1e-4
"""Rate of a mode that neither grows nor decays (1/s): it takes two hours to double."""

_NOISE = 1e-9
"""Error of a well-conditioned eigenvalue."""

_VAGUE = 1e-5
"""Error up to which an ill-conditioned eigenvalue at 1 may be noise: a wheel that rolls freely has
two there, with one eigenvector, and differences part them by the root of their error."""

_RESTING = 0.1
"""Greatest speed of what has settled (m/s, rad/s): v3's sag swings by 0.02 after half a second.
What is faster may have been thrown off by a mode that doubles within steps: the start is judged
too."""

_THROWN = 6
"""So often a mode doubles while it settles that throws off what began within a millimetre, to the
speed above. What began without balance and moves on for that (servos that sag) is not at rest, and
where it began, nothing is: v3 half way down on soft servos told 1.5 to 25 s for the same rest."""

_NAMED_SHARE = 0.5
"""Of the greatest share in a mode: what moves by less is not named."""

_MOST_NAMED_JOINTS = 4  # that are named


@dataclass(frozen=True, eq=False)
class Mode(Result):
    """A way in which a state deviates from itself step by step: an eigenvalue, or a pair of them.

    Attributes:
        growth: |eigenvalue| - 1, per step.
        frequency: Hz; 0: it does not swing.
        damping_ratio: 1: it decays without swinging; 0: it swings on; negative: it grows.
        time_constant: In which it grows or decays by a factor of e (s).
        doubling_time: s; None if it decays, or if it is ``sustained``.
        joints: Those that move most in it, the first most of all.
        freed: Whether the mode is that of a motion which has overcome the dry friction of joints
            and tendons.
        repeated: Whether the spectrum with ``SECOND_STEP`` has the mode, too.
        nudge: Deviation of a joint from which growth was measured in simulation (rad, m); None of
            a mode that is known from the spectrum alone. If it is given, ``doubling_time`` is the
            simulated one.
    """

    growth: float = field(metadata={"unit": "1"})
    frequency: float = field(metadata={"unit": "Hz"})
    damping_ratio: float = field(metadata={"unit": "1"})
    time_constant: float = field(metadata={"unit": "s"})
    doubling_time: float | None = field(metadata={"unit": "s"})
    joints: tuple[str, ...]
    freed: bool = False
    repeated: bool = True
    nudge: float | None = field(default=None, metadata={"unit": "rad or m"})
    _direction: Array | None = None

    @property
    def direction(self) -> Array:
        """Direction of the mode in the tangent space of (qpos, qvel, act), shape (2 nv + na,).

        The largest deviation of a position is 1 rad or 1 m.
        """
        assert self._direction is not None
        return self._direction

    @property
    def sustained(self) -> bool:
        """Whether a simulation shows an oscillation that neither grows nor decays."""
        return self.nudge is not None and self.doubling_time is None

    @property
    def shakes(self) -> bool:
        """Whether it swings faster than it grows; what grows otherwise buckles.

        What takes longer for a swing than a stand is to last is no shaking, but creep.
        """
        swings = 2 * math.pi * self.frequency * self.time_constant > 1
        return swings and self.frequency * HOLD_DURATION > 1

    def grows_within(self, duration: float) -> bool:
        """Tells whether it leaves the state in that time (s).

        What shakes never comes to rest, however slowly it grows. What buckles on regularised
        friction may stay for minutes; it stays for a time in which it does not double.
        """
        if self.doubling_time is None:
            return self.sustained
        return self.shakes or self.doubling_time < duration


@dataclass(frozen=True, eq=False)
class Stability(Result):
    """Whether a state of a MuJoCo model is stable, and what of it is least so.

    Attributes:
        timestep: s.
        radius: The greatest absolute eigenvalue of a step, with dry friction.
        unstable: The modes that grow, the fastest first. After ``confirm_growth`` those that would
            leave the state within ``HOLD_DURATION`` are confirmed by a simulation.
        least_damped: The mode with the least damping ratio of those that swing and decay, with dry
            friction or once that is overcome.
        speed: The greatest element of qvel where it was judged (m/s, rad/s): a state that is not at
            rest is not judged by this.
        sticks: Whether friction sticks (``noslip_iterations``): it holds what would buckle until it
            slips, and what its iterations leave is no mode: only a simulation shows.
        refuted: Modes that grow by the spectrum, and do not in a nudged simulation.
    """

    timestep: float = field(metadata={"unit": "s"})
    radius: float = field(metadata={"unit": "1"})
    unstable: tuple[Mode, ...]
    least_damped: Mode | None
    speed: float = field(metadata={"unit": "m/s or rad/s"})
    sticks: bool
    refuted: tuple[Mode, ...] = ()

    @property
    def at_rest(self) -> bool:
        """Whether it was at rest, near enough to be judged."""
        return self.speed <= _RESTING

    @property
    def stable(self) -> bool:
        """Whether no mode grows, however slowly."""
        return not self.unstable

    @property
    def doubling_time(self) -> float | None:
        """In which the fastest mode that grows doubles (s); None if none grows."""
        return self.unstable[0].doubling_time if self.unstable else None

    @property
    def damping_ratio(self) -> float:
        """The least damping ratio of the modes that swing: 1 without any, negative if one grows."""
        swinging = [mode for mode in self.unstable if mode.shakes]
        swinging += [self.least_damped] if self.least_damped is not None else []
        return min((mode.damping_ratio for mode in swinging), default=1.0)

    def modes_growing_within(self, duration: float = HOLD_DURATION) -> tuple[Mode, ...]:
        """Returns the modes with which it does not stay for that time (s); see ``grows_within``."""
        growing = (mode for mode in self.unstable if mode.grows_within(duration))
        return tuple(mode for mode in growing if mode.shakes or not self.sticks)

    def lasts(self, duration: float = HOLD_DURATION) -> bool:
        """Tells whether it stays for that time (s) when it is nudged."""
        return not self.modes_growing_within(duration)


@check_arguments
def step_stability(
    model: mujoco.MjModel, data: mujoco.MjData, *, settle: float = SETTLING_TIME
) -> Stability:
    """Judges the stability of a state, by the eigenvalues of one of MuJoCo's steps.

    A step takes a deviation x of (qpos, qvel, act) to A x, with the contacts, the servos under
    their commands (``data.ctrl``), friction, and the integrator as they are. Where an eigenvalue of
    A is beyond the unit circle, the deviation grows: by swinging if it is complex (the robot
    shakes), without if it is real (it buckles). In a time step h, its rate is ln|eigenvalue| / h.

    Dry friction of joints and tendons, which MuJoCo makes viscous if nothing slides, hides a mode
    until a push overcomes it. So the modes that leave within ``HOLD_DURATION`` without it are
    returned, too (``Mode.freed``). Contacts keep their friction.

    Only what is at rest can be judged so (``Stability.speed``), and only what is near: whether a
    state survives a harder push, a simulation tells.

    Source: MuJoCo documentation, ``mjd_transitionFD``; in the tangent space of qpos.

    Args:
        model: MuJoCo model. During the call its solver's tolerance is tighter, and the dry friction
            of its joints and tendons may be zero.
        data: The state, with ``ctrl``; it stays as it is.
        settle: Time for which it is simulated first (s).

    Returns:
        The modes that grow, and what is left of those that do not.

    Raises:
        ConfigurationError: If an argument is no such thing, or the time is not from 0 to 600 s.
    """
    if not 0 <= settle <= _LONGEST_DOUBLING:
        raise ConfigurationError(
            "settle", diagnose("settling-time", settle=settle, most=_LONGEST_DOUBLING)
        )
    return judge_settled(model, data, settle)[0]


def judge_settled(
    model: mujoco.MjModel, data: mujoco.MjData, settle: float
) -> tuple[Stability, mujoco.MjData]:
    """Return the result of ``step_stability`` and the state that it is about.

    That is the state after settling. It is the initial state if the simulation diverges, or if the
    initial state has a mode so fast that it throws off the robot while it settles.
    """
    start, data = data, copy_data(model, data)
    steps = round(settle / model.opt.timestep)
    if not steps:
        return _judged(model, data), data
    with silence_mujoco():
        mujoco.mj_step(model, data, steps)
    before = copy_data(model, start)
    if data.time < start.time + (steps - 0.5) * model.opt.timestep:
        # It diverged, and MuJoCo began anew.
        return _judged(model, before), before
    found = _judged(model, data)
    if found.at_rest:
        return found, data
    other = _judged(model, before)
    threw = (other.doubling_time or math.inf) < settle / _THROWN
    return (other, before) if other.at_rest and threw else (found, data)


def _judged(model: mujoco.MjModel, data: mujoco.MjData) -> Stability:
    """Judge a state with the dry friction of joints and tendons, and without."""
    found = _repeated(model, data, _judged_at_limits(model, data))
    rubbing = model.dof_frictionloss, model.tendon_frictionloss
    rubs = any(values.any() for values in rubbing)
    if not rubs:
        return found
    kept = [values.copy() for values in rubbing]
    for values in rubbing:
        values[:] = 0.0
    try:
        free = _repeated(model, data, _judged_at_limits(model, copy_data(model, data)))
    finally:
        for values, before in zip(rubbing, kept, strict=True):
            values[:] = before
    freed = [
        replace(mode, freed=True) for mode in free.unstable if mode.grows_within(HOLD_DURATION)
    ]
    unstable = sorted([*found.unstable, *freed], key=lambda mode: -mode.growth)
    damped = [found.least_damped] if found.least_damped is not None else []
    damped += [replace(free.least_damped, freed=True)] if free.least_damped is not None else []
    least = min(damped, key=lambda mode: mode.damping_ratio, default=None)
    return replace(found, unstable=tuple(unstable), least_damped=least)


def _repeated(model: mujoco.MjModel, data: mujoco.MjData, found: Stability) -> Stability:
    """Mark the leaving modes that the spectrum with ``SECOND_STEP`` does not have."""
    if not found.modes_growing_within():
        return found
    second = _judged_at_limits(model, copy_data(model, data), SECOND_STEP).unstable

    def repeats(mode: Mode) -> bool:
        return any(
            abs(again.growth - mode.growth) <= _RATE_TOLERANCE * mode.growth for again in second
        )

    modes = (replace(mode, repeated=repeats(mode)) for mode in found.unstable)
    return replace(found, unstable=tuple(modes))


def _judged_at_limits(
    model: mujoco.MjModel, data: mujoco.MjData, difference: float = DIFFERENCE_STEP
) -> Stability:
    """Judge a state; if joints are at their limits, on both sides of these: the worse counts."""
    scalar = np.isin(model.jnt_type, (JointKind.HINGE, JointKind.SLIDE))
    angles = data.qpos[model.jnt_qposadr][:, None]
    ends = angles + np.outer(
        model.jnt_margin, (-1.0, 1.0)
    )  # limits of which they would be at the edge
    limited = (scalar & (model.jnt_limited == 1))[:, None]
    edges = limited & (np.abs(ends - model.jnt_range) <= _EDGE)
    if not edges.any():
        return _Modes(model, data, difference).judged()
    ranges, found = model.jnt_range.copy(), []
    try:
        for apart in (-_EDGE, _EDGE):
            moved = ends + np.array([apart, -apart])
            model.jnt_range[:] = np.where(edges, moved, ranges)
            found.append(_Modes(model, copy_data(model, data), difference).judged())
    finally:
        model.jnt_range[:] = ranges
    return max(found, key=lambda one: one.radius)


class _Modes:
    """The modes of a step at a state.

    Args:
        model: The model.
        data: The state, after ``mj_forward`` or ``mj_step``.
    """

    def __init__(
        self, model: mujoco.MjModel, data: mujoco.MjData, difference: float = DIFFERENCE_STEP
    ) -> None:
        self._model, self._data = model, data
        matrix = step_derivative(model, data, difference)
        matrix = np.where(np.isfinite(matrix), matrix, 0.0)
        self._values, left, self._vectors = linalg.eig(matrix, left=True)
        aligned = np.abs(np.sum(left.conj() * self._vectors, axis=0))
        error = np.minimum(_NOISE / np.maximum(aligned, _NOISE), _VAGUE)
        self._growth = np.abs(self._values) - 1
        still = np.maximum(_NEUTRAL_RATE * float(model.opt.timestep), error)
        self._drifts = np.abs(self._values - 1) <= still
        # A pendulum without damping swings on, and rounding lets it grow by nothing.
        self._grows = (self._growth > still) & ~self._drifts

    def judged(self) -> Stability:
        """Returns what there is to say of them."""
        model, data = self._model, self._data
        single = self._values.imag >= 0  # of a pair of conjugates, one
        growing = np.flatnonzero(self._grows & single)
        growing = growing[np.argsort(-self._growth[growing])]
        # What is gone within a step is no swing.
        decaying = single & ~self._grows & ~self._drifts & (self._growth > -1 + _NOISE)
        swinging = np.flatnonzero(decaying & (np.abs(np.angle(self._values)) > _NOISE))
        damped = [self._damping(mode) for mode in swinging.tolist()]
        return Stability(
            timestep=float(model.opt.timestep),
            radius=1 + float(self._growth.max(initial=-1.0)),
            unstable=tuple(self._mode(mode) for mode in growing.tolist()),
            least_damped=self._mode(int(swinging[int(np.argmin(damped))])) if damped else None,
            speed=float(np.abs(data.qvel).max(initial=0.0)),
            sticks=bool(model.opt.noslip_iterations > 0),
        )

    def _damping(self, mode: int) -> float:
        exponent = np.log(self._values[mode])
        return float(-exponent.real / abs(exponent))

    def _mode(self, mode: int) -> Mode:
        timestep = float(self._model.opt.timestep)
        value, growth = self._values[mode], float(self._growth[mode])
        constant = timestep / abs(math.log1p(growth)) if growth else math.inf
        return Mode(
            growth=growth,
            frequency=abs(float(np.angle(value))) / (2 * math.pi * timestep),
            damping_ratio=self._damping(mode),
            time_constant=constant,
            doubling_time=math.log(2) * constant if self._grows[mode] else None,
            joints=select_most_moving(self._joints(mode)),
            _direction=self._direction(mode),
        )

    def _direction(self, mode: int) -> Array:
        """Return a mode's real direction, scaled to a largest deviation of a position of 1."""
        vector = self._vectors[:, mode]
        largest = vector[int(np.abs(vector[: self._model.nv]).argmax())] if self._model.nv else 1.0
        return np.asarray(np.real(vector / largest)) if largest else np.real(vector)

    def _joints(self, mode: int) -> dict[str, float]:
        """Returns how far each joint moves (rad, m); the base's own motion is none."""
        model, moves = self._model, np.abs(self._vectors[: self._model.nv, mode])
        ends = [*model.jnt_dofadr[1:].tolist(), model.nv] if model.njnt else []
        return {
            model.joint(joint).name: float(moves[model.jnt_dofadr[joint] : end].max())
            for joint, end in enumerate(ends)
            if model.jnt_type[joint] != JointKind.FREE
        }


def select_most_moving(shares: dict[str, float]) -> tuple[str, ...]:
    """Return the few names with the greatest shares, the greatest first."""
    names = sorted(shares, key=shares.__getitem__, reverse=True)
    least = _NAMED_SHARE * shares[names[0]] if names else 0.0
    return tuple(name for name in names[:_MOST_NAMED_JOINTS] if shares[name] >= least > 0)
