"""Test in nudged simulations of the unmodified model whether a stand's growing modes really grow.

A mode is an eigenvector of the linearised simulation step. The eigenvalues, called the spectrum
(``robot.stability``), predict that a deviation x along a mode grows as x(t) = x(0) 2^(t/T). The
prediction is tested, since the linearisation may be valid for micrometres only, and dry friction
makes it depend on the finite-difference step:

1. Two simulations start at the tested state, displaced along the modes by +p and -p. The model's
   friction of joints and contacts is used.
2. The deviation D(t) is half the difference of the two simulations: the largest over the joints.
   Motion of both simulations, such as creep, cancels. D is infinite after a divergence.
3. The modes are confirmed if D grows by a factor of ``2 ** DOUBLINGS`` over the smallest value,
   within ``LONGEST_TRIAL`` seconds, without slowing down. The doubling time T is half the time of
   two successive doublings. If the simulation diverges, fewer doublings are sufficient.
4. If a foot has almost no load (``monitor.find_light_bodies``), growth must continue until a joint
   is displaced by ``LEAVING_ANGLE``, or for twice ``LONGEST_TRIAL``. Growth that ends earlier is a
   transient: the foot leaves the ground, or takes load. The test starts anew at its end.
5. Modes that shake are confirmed, too, if the oscillation of the difference is sustained: the
   growth may end in a limit cycle. A constant difference, which dry friction leaves, is none.
6. A mode may shake in the spectrum, but grow in the simulation without an oscillation, and more
   slowly than ``HOLD_DURATION`` per doubling. The mode then counts as slow buckling: a foot with
   almost no load may open and close in the linearised step.
7. Otherwise the simulation refutes the modes: the simulation decides, and the disagreement is
   reported.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import mujoco
import numpy as np

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.results import Result
from pupper_analysis.models.mjcf import JointKind, scalar_joints
from pupper_analysis.robot.fall import nudge_velocity
from pupper_analysis.robot.stability import HOLD_DURATION, Mode, Stability, select_most_moving
from pupper_analysis.simulation import monitor
from pupper_analysis.simulation.rollout import STATE_SPEC, full_state, roll_out

DOUBLINGS = 3
"""Number of doublings [1] of the deviation D that confirm growing modes in a growth test. D is half
the difference of two simulations with opposite initial displacements. Growth that is exponential
only within micrometres ends earlier, when a contact opens or takes load. Chosen, not tuned."""

MODE_NUDGE_ANGLE, MODE_NUDGE_SPEED = 1e-4, 0.1
"""Upper bounds of the initial deviation along a mode in a growth test: of a position [rad, m] and
of a velocity [rad/s, m/s]. Chosen small: ``2 ** DOUBLINGS * MODE_NUDGE_ANGLE`` at a leg of 0.1 m
moves a foot by 80 um. A foot with 1/10,000 of the weight is 10 um deep."""

FREEING_ANGLE, FREEING_SPEED = 1e-2, 1.0
"""Upper bounds of the initial deviation along modes that grow only without dry friction
(``Mode.without_dry_friction``): of a position [rad, m] and of a velocity [rad/s, m/s]. Dry friction
may stop a small nudge along these modes. Chosen larger than the deviation that dry friction
holds: 0.01 N m at a servo of 5 N m/rad hold 2e-3 rad."""

LONGEST_TRIAL = (DOUBLINGS + 1) * HOLD_DURATION
"""Simulated time [s] after which a test for exponential growth without a result ends. Derived:
`DOUBLINGS` doublings of a mode that doubles in ``HOLD_DURATION``, and one more ``HOLD_DURATION``
for the decay of other motion.
"""

LEAVING_ANGLE = 1e-2
"""Lower bound of the displacement of a joint from the tested state [rad, m] with which a growing
mode is confirmed although a foot has almost no load. Chosen equal to
``stability.MAX_JOINT_DISPLACEMENT``. Measured on three robots with feet that carry 1e-5 to 1e-4 of
the weight: the difference of two simulations grows by five doublings to 0.01 to 0.09 mrad, or by
six to 2.6 mrad, and then stops.
"""

_CHUNK_DURATION = 2.0
"""Interval of simulated time [s], about, after which a growth test evaluates if the motion has
grown or decayed. Chosen, not tuned.
"""

_DECAYED_RATIO = 1e-2
"""Ratio [1] of the deviation D to a reference, below which the motion of a growth test has decayed.
The reference is the smaller of the bound of the initial deviation and the maximum of D in the first
time window. D is half the difference of the two simulations. Chosen, not tuned.
"""

_HALF_TIME, _HALF_GROWTH = 1.5 * HOLD_DURATION, 1.5
"""Simulated time [s] and growth factor [1] of an early end of a growth test. After this time, the
test ends if the deviation D (half the difference of the two simulations) is below `_HALF_GROWTH`
times its smallest value. The time begins at the start, or at the end of the last transient. An
oscillation counts as sustained only after this time. Exponential growth with a doubling time of
``HOLD_DURATION`` has a factor of 2.8."""

_ENDED_GROWTH = 1.25
"""Lower bound [1] of the ratio of maxima of the deviation D in a growth test, now and two doubling
times ago; below, growth has ended. The ratio is 4 for exponential growth. Measured: Pupper v3 with
a foot on a slope and 2 kg leaves its stand; the smallest ratio is 1.9, when the growth slows down.
"""

_MAX_DOUBLING_RATIO = 1.6
"""Upper bound [1] of the ratio (time of a doubling) / (time of the previous doubling) of growth
that counts as exponential. Half a window of time is added to the bound. Chosen between 1, for
exponential growth, and 2, for a drift at constant speed, such as creep."""

_SUSTAINED_RATIO = 0.5
"""Lower bound [1] of the ratio (final amplitude) / (first maximum of the deviation D) of a
sustained oscillation in a growth test. D is half the difference of the two simulations. Chosen, not
tuned.
"""

_MIN_OSCILLATION_RATIO = 0.5
"""Lower bound [1] of the ratio (amplitude) / (maximum of the deviation D) of an oscillation in a
growth test. With a smaller ratio, growth slower than a doubling in ``HOLD_DURATION`` counts as
buckling. Chosen between 1, for an oscillation about the undisturbed motion, and 0.25, for
exponential growth that doubles in one period.
"""

_MAX_WINDOW = 1.0
"""Upper bound [s] of the length of the time windows of a growth test. The difference of the two
simulations may oscillate, so only its maximum in each window is evaluated. Chosen, not tuned."""


@dataclass(frozen=True, eq=False)
class GrowthTrial(Result):
    """Result of a growth test: two simulations, displaced along modes in opposite directions.

    Attributes:
        nudge: Largest initial deviation of a position (rad or m); 0 if only velocities deviate.
        duration: Simulated time (s).
        doubling_time: Half the time of two successive doublings (s); None if the deviation does not
            grow by ``2 ** DOUBLINGS``, or the growth slows down or ends. If the simulation diverges
            before, mean time of a doubling.
        joints: Joints with the largest final deviations, the largest first.
        sustained: Whether modes that shake leave an oscillation that does not decay.
    """

    nudge: float = field(metadata={"unit": "rad or m"})
    duration: float = field(metadata={"unit": "s"})
    doubling_time: float | None = field(metadata={"unit": "s"})
    joints: tuple[str, ...]
    sustained: bool = False
    _oscillates: bool = True


def confirm_growth(
    stability: Stability, model: mujoco.MjModel, data: mujoco.MjData, ctrl: Array
) -> Stability:
    """Test by simulation if modes that grow within ``HOLD_DURATION`` in the linear model do grow.

    A mode is an eigenvector of MuJoCo's linearised simulation step.
    `Stability.modes_growing_within` selects the modes. Each test simulates deviations along modes
    (`simulate_growth`).

    Args:
        stability: Modes of the linearised step at the state.
        model: MuJoCo model.
        data: State whose modes ``stability`` contains; not changed.
        ctrl: Command of the actuators, shape (model.nu,).

    Returns:
        Stability with the result of the tests; ``stability`` itself if there is nothing to test, or
        if the state is not at rest.

        - ``unstable`` contains one mode for all modes that a test confirmed together. Its doubling
          time is taken from the simulation; it may be longer than ``HOLD_DURATION``. The doubling
          time is None for a sustained oscillation.
        - ``refuted_modes`` contains the tested modes that the simulation does not confirm.
        - Selected modes that were not tested are omitted.
    """
    leaving = stability.modes_growing_within()
    if not leaving or not stability.at_rest:
        return stability
    unstable = [mode for mode in stability.unstable if mode not in leaving]
    refuted: list[Mode] = []
    start, light_bodies = full_state(model, data), monitor.find_light_bodies(model, data)
    for freed in (False, True):
        modes = [mode for mode in leaving if mode.without_dry_friction is freed]
        if not modes:
            continue
        confirmed = None
        for angle, speed in _nudge_sizes(modes):
            trial = simulate_growth(
                model, start, ctrl, modes, angle, speed, until_left=bool(light_bodies)
            )
            if trial.doubling_time is not None or trial.sustained:
                displacement = _make_displacement(model, modes, angle, speed)
                confirmed = replace(
                    _make_confirmed_mode(modes, trial, stability.timestep),
                    _nudge_unit=find_dof_unit(
                        model, int(np.abs(displacement[: model.nv]).argmax())
                    ),
                )
                break
        if confirmed is None:
            refuted += modes
            continue
        unstable.append(confirmed)
        if unstable[-1].grows_within(HOLD_DURATION):
            break
    unstable.sort(key=lambda mode: -mode.growth)
    return replace(stability, unstable=tuple(unstable), refuted_modes=tuple(refuted))


def _nudge_sizes(modes: list[Mode]) -> list[tuple[float, float]]:
    """Return initial deviations for tests of modes: pairs of [rad, m] and [rad/s, m/s].

    The large pair is for modes whose small deviations dry friction would stop.
    """
    small, large = (MODE_NUDGE_ANGLE, MODE_NUDGE_SPEED), (FREEING_ANGLE, FREEING_SPEED)
    if not modes[0].without_dry_friction:
        return [small]
    # A limit cycle ends growth; the larger nudge may start outside of it.
    return [small, large] if any(mode.shakes for mode in modes) else [large]


def simulate_growth(
    model: mujoco.MjModel,
    start: Array,
    ctrl: Array,
    modes: list[Mode],
    angle: float,
    speed: float,
    *,
    until_left: bool = False,
) -> GrowthTrial:
    """Simulate deviations along modes until growth is confirmed or refuted, or the time is over.

    The module docstring describes the test. Two simulations start with opposite deviations. Growth
    is confirmed if half their difference grows exponentially by a factor of ``2 ** DOUBLINGS``.

    Args:
        model: MuJoCo model.
        start: State at rest (mjSTATE_FULLPHYSICS), shape (size,).
        ctrl: Command of the actuators, shape (model.nu,).
        modes: Modes along which the state is displaced.
        angle: Upper bound of the initial deviation of a position [rad, m].
        speed: Upper bound of the initial deviation of a velocity [rad/s, m/s].
        until_left: Whether growth counts only if it continues until a joint is displaced by
            `LEAVING_ANGLE`, or for twice `LONGEST_TRIAL`. Used if a foot has almost no load.
    """
    displacement = _make_displacement(model, modes, angle, speed)
    joints = scalar_joints(model)
    columns = 1 + model.jnt_qposadr[joints] if len(joints) else 1 + np.arange(model.nq)
    timestep = float(model.opt.timestep)
    window = max(1, round(min(max(map(_window_duration, modes)), _MAX_WINDOW) / timestep))
    chunk = max(1, round(_CHUNK_DURATION / timestep / window)) * window
    workers = [mujoco.MjData(model) for _ in range(2)]
    states = np.array([_displace_state(model, start, sign * displacement) for sign in (1.0, -1.0)])
    maxima: list[float] = []
    lows, highs = list[Array](), list[Array]()  # of the signed difference, in each window
    deviations, time, doubling = np.zeros(len(columns)), 0.0, None
    first = 0  # window in which the last transient ended
    while time < LONGEST_TRIAL or (doubling is not None and time < 2 * LONGEST_TRIAL):
        control = np.tile(ctrl, (1, chunk, 1))
        rollouts = roll_out(model, workers, states, control)
        valid = _count_valid_steps(states[:, 0], rollouts, timestep)
        signed = _halve_difference(rollouts[:, :, columns], valid)
        deviations = np.abs(signed[valid - 1]) if valid else deviations
        windows = signed.reshape(-1, window, len(columns))
        lows, highs = [*lows, *windows.min(axis=1)], [*highs, *windows.max(axis=1)]
        maxima += np.abs(windows).max(axis=(1, 2)).tolist()
        states, time = rollouts[:, -1], time + chunk * timestep
        recent = np.array(maxima[first:])
        doubling = _doubling_time_of(recent, window * timestep, lost=valid < chunk)
        moved = np.abs(states[:, columns] - start[columns]).max()
        has_left = not until_left or moved >= LEAVING_ANGLE
        if valid < chunk or (doubling is not None and has_left):
            break
        if doubling is not None and _has_ended(recent, doubling / (window * timestep)):
            doubling, first = None, len(maxima) - 1
        if maxima[-1] < _DECAYED_RATIO * min(angle, maxima[0]):
            doubling = None
            break
        recent = np.array(maxima[first:])
        is_slow = bool(maxima[-1] < _HALF_GROWTH * recent.min())
        if is_slow and len(recent) * window * timestep >= _HALF_TIME:
            break
    names = [model.joint(joint).name for joint in joints]
    joint_deviations = dict(zip(names, np.nan_to_num(deviations).tolist(), strict=False))
    steady = time >= _HALF_TIME and any(mode.shakes for mode in modes)
    period = max((1 / mode.frequency for mode in modes if mode.shakes), default=0.0)
    count = math.ceil(period / (window * timestep))
    amplitude = _final_amplitude(np.array(lows), np.array(highs), max(count, 1))
    sustained = steady and not amplitude < _SUSTAINED_RATIO * maxima[0]  # True if not finite
    grown = first + _count_windows_until_grown(np.array(maxima[first:]))
    amplitude = _final_amplitude(np.array(lows[:grown]), np.array(highs[:grown]), max(count, 1))
    oscillates = not amplitude < _MIN_OSCILLATION_RATIO * maxima[grown - 1]
    names_of_most_moving = select_most_moving(joint_deviations)
    nudge = float(np.abs(displacement[: model.nv]).max())
    return GrowthTrial(nudge, time, doubling, names_of_most_moving, sustained, oscillates)


def _count_valid_steps(times: Array, rollouts: Array, timestep: float) -> int:
    """Count the steps before the first of two simulations diverges; n without divergence.

    ``times`` are the initial times, shape (2,) [s], ``rollouts`` the states after each step, shape
    (2, n, size).
    """
    advances = np.diff(rollouts[..., 0], axis=1, prepend=times[:, None]) > timestep / 2
    is_valid = advances & np.isfinite(rollouts).all(axis=-1)
    diverged = np.flatnonzero(~(is_valid[0] & is_valid[1]))
    return int(diverged[0]) if len(diverged) else rollouts.shape[1]


@np.errstate(invalid="ignore", over="ignore")
def _halve_difference(positions: Array, valid: int) -> Array:
    """Return half the difference of the joint positions of two simulations, (n, joints) [rad, m].

    From step ``valid`` on, the difference is infinite: after a divergence, MuJoCo resets the state.
    """
    half: Array = (positions[0] - positions[1]) / 2
    half[valid:] = np.inf
    return half


def _has_ended(maxima: Array, doubling: float) -> bool:
    """Return True if the growth of a deviation has ended, from its maxima in windows, (n,).

    ``doubling`` is the doubling time of the growth, in windows.
    """
    begin = int(maxima[: _count_windows_until_grown(maxima)].argmin())
    largest, since = np.maximum.accumulate(maxima[begin:]), math.ceil(2 * doubling)
    return bool(len(largest) > since and largest[-1] < _ENDED_GROWTH * largest[-1 - since])


def _count_windows_until_grown(maxima: Array) -> int:
    """Count the time windows until a deviation has grown by ``2 ** DOUBLINGS``; n if it has not.

    ``maxima`` are the largest deviations in n windows.
    """
    grown = np.flatnonzero(maxima >= 2.0**DOUBLINGS * np.minimum.accumulate(maxima))
    return int(grown[0]) + 1 if len(grown) else len(maxima)


@np.errstate(invalid="ignore", over="ignore")
def _final_amplitude(lows: Array, highs: Array, count: int) -> float:
    """Return the largest oscillation amplitude [rad, m] of a joint in the last ``count`` windows.

    ``lows`` and ``highs`` are the extreme signed deviations in n windows, shape (n, joints) [rad,
    m].
    """
    return float(np.max(highs[-count:].max(axis=0) - lows[-count:].min(axis=0)) / 2)


def _make_displacement(
    model: mujoco.MjModel, modes: list[Mode], angle: float, speed: float
) -> Array:
    """Compute the initial displacement of (qpos, qvel, act) along modes, shape (2 nv + na,).

    Each mode is scaled before the summation, so that a fast mode, with large velocities, does not
    hide a slow mode. Modes that the second finite-difference step does not repeat are left out;
    without other modes, the displacement is a random velocity. The sum is within ``angle`` [m, rad]
    and ``speed`` [m/s, rad/s].
    """
    nv = model.nv
    repeated = [mode for mode in modes if mode.repeated_at_second_step]
    if not repeated:
        velocity = nudge_velocity(model)
        displacement = np.zeros(2 * nv + model.na)
        displacement[nv : 2 * nv] = speed * velocity / np.abs(velocity).max()
        return displacement

    def scale(displacement: Array) -> Array:
        """Scale a displacement (2 nv + na,) until it reaches a bound of positions or velocities."""
        largest_angle = np.abs(displacement[:nv]).max() / angle
        largest_speed = np.abs(displacement[nv : 2 * nv]).max() / speed
        return np.asarray(displacement / max(largest_angle, largest_speed))

    return scale(np.sum([scale(mode.direction) for mode in repeated], axis=0))


def find_dof_unit(model: mujoco.MjModel, dof: int) -> str:
    """Return the unit, m or rad, of the degree of freedom with the index ``dof`` in qvel."""
    joint = int(model.dof_jntid[dof])
    is_translation = dof - int(model.jnt_dofadr[joint]) < _NUM_TRANSLATIONS.get(
        int(model.jnt_type[joint]), 0
    )
    return "m" if is_translation else "rad"


_NUM_TRANSLATIONS = {int(JointKind.FREE): 3, int(JointKind.SLIDE): 1}
"""{type of a joint: number of its first degrees of freedom that are translations}."""


def _displace_state(model: mujoco.MjModel, start: Array, displacement: Array) -> Array:
    """Return a state (mjSTATE_FULLPHYSICS), displaced in the tangent space.

    ``displacement`` has the shape (2 nv + na,): positions [m, rad], velocities [m/s, rad/s],
    activations.
    """
    data, nv = mujoco.MjData(model), model.nv
    mujoco.mj_setState(model, data, start, STATE_SPEC)
    mujoco.mj_integratePos(model, data.qpos, np.ascontiguousarray(displacement[:nv]), 1.0)
    data.qvel += displacement[nv : 2 * nv]
    data.act += displacement[2 * nv :]
    return full_state(model, data)


def _doubling_time(mode: Mode) -> float:
    """Return the time [s] in which the deviation along a mode doubles; infinite if undefined."""
    return mode.doubling_time or math.inf


def _window_duration(mode: Mode) -> float:
    """Return the length [s] of the time window in which a mode's maximum deviation is taken."""
    period = 1 / mode.frequency if mode.frequency else 0.0
    return max(period, _doubling_time(mode) / 4)


def _doubling_time_of(maxima: Array, window: float, *, lost: bool) -> float | None:
    """Return the doubling time [s] of a deviation from its maxima in windows of time, shape (n,).

    The doubling time is half the time of two successive doublings, or a mean if the simulation
    diverged (``lost``). None without sufficient growth. A window is ``window`` [s] long.
    """
    if not math.isfinite(maxima[0]):
        return window  # diverged within the first window: an upper bound of the doubling time
    least = np.minimum.accumulate(maxima)
    grown = np.flatnonzero(maxima >= 2.0**DOUBLINGS * least)
    if not maxima.min() > 0 or not (lost or len(grown)):
        return None
    first = int(maxima[: grown[0]].argmin()) if len(grown) else int(maxima.argmin())
    rising = np.maximum.accumulate(maxima[first:])
    rising = rising[: np.count_nonzero(np.isfinite(rising)) + 1]  # up to the divergence
    highest = rising[np.isfinite(rising)][-1]
    levels = maxima[first] * 2.0 ** np.arange(1, 2 + math.log2(max(highest / maxima[first], 1)))
    times = [_crossing_time(rising, level, window) for level in levels if level <= highest]
    for last in range(DOUBLINGS - 1, len(times)):
        before, middle, end = (0.0, *times)[last - 1 : last + 2]
        if end - middle <= _MAX_DOUBLING_RATIO * (middle - before) + window / 2:
            return (end - before) / 2
    return window * len(rising) / max(len(times), 1) if lost else None


def _crossing_time(rising: Array, level: float, window: float) -> float:
    """Return the time [s] at which a sequence, sampled every ``window`` [s], rises to a level.

    The logarithm is interpolated linearly. The first element must be below ``level``, the last must
    not.
    """
    after = int(np.searchsorted(rising, level))
    low, high = np.log(rising[after - 1]), np.log(rising[after])
    if not math.isfinite(high):
        return window * after
    return window * (after - 1 + float((math.log(level) - low) / (high - low)))


def _make_confirmed_mode(modes: list[Mode], trial: GrowthTrial, timestep: float) -> Mode:
    """Return the mode that a growth test confirms, with the simulated growth and joints.

    The result is the tested mode with the nearest doubling time, or a mode that oscillates if only
    a sustained oscillation is confirmed.
    """
    if trial.doubling_time is None:
        mode = next(mode for mode in modes if mode.shakes)
        joints = trial.joints or mode.joints
        return replace(mode, doubling_time=None, joints=joints, nudge=trial.nudge)
    simulated, constant = math.log(trial.doubling_time), trial.doubling_time / math.log(2)
    mode = min(modes, key=lambda mode: abs(math.log(_doubling_time(mode)) - simulated))
    if trial.doubling_time >= HOLD_DURATION and not trial._oscillates:
        mode = replace(mode, frequency=0.0, damping_ratio=-1.0)
    return replace(
        mode,
        growth=math.expm1(timestep / constant),
        time_constant=constant,
        doubling_time=trial.doubling_time,
        joints=trial.joints or mode.joints,
        nudge=trial.nudge,
    )
