"""Motions as measurements: what a log tells of the robot that made it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import solve_toeplitz
from scipy.signal import fftconvolve, lfilter

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.base.errors import ConfigurationError, MeasurementError
from pupper_analysis.robot.build import build_robot
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import Servos, model_with_servos
from pupper_analysis.tools.fit.estimate import LinearisedResiduals, Posterior, estimate_parameters
from pupper_analysis.tools.fit.measurements.log import Log
from pupper_analysis.tools.fit.measurements.log_quality import find_column_step, inspect_log
from pupper_analysis.tools.fit.motions.rollouts import (
    DELAY_PARAMETERS,
    MomentCoordinates,
    Run,
    Simulator,
    split_runs,
)
from pupper_analysis.tools.fit.parameters import ParameterTable, Prior, apply_priors, parse_priors
from pupper_analysis.tools.fit.result import MotionFit, describe_parameters, estimate_kp_over_mass

Array = NDArray[np.float64]

HOLD_OUT_FRACTION = 0.2
"""Of each log, at its end: what is predicted, and not fitted."""


_MISFIT = 2.0
"""What is left, in parts of an encoder's noise, from which a model does not explain a motion: of
half of the joints."""

_MISFIT_OF_ONE = 10.0
"""The same of a single joint: a clock that shakes by a tenth of an interval leaves 3, a joint that
touches something, or whose column is another's, hundreds."""


@check_arguments
def fit_motion(
    robot: Robot,
    logs: Sequence[Log],
    *,
    priors: Sequence[Prior | str] = (),
    hold_out: float | Sequence[Log] = HOLD_OUT_FRACTION,
    kp: ArrayLike | None = None,
    kd: ArrayLike | None = None,
) -> MotionFit:
    """Estimates a robot's numbers from what its joints did.

    The robot hangs, or is fixed. Its motion under the commands is simulated (MuJoCo); the
    parameters are those that make what encoders would have told most like what they told, by
    Gauss-Newton steps with priors about the file's numbers. What is left is taken for noise with a
    memory, and intervals follow from it.

    Args:
        robot: The robot; a free base is held where its MJCF has it.
        logs: Of its motions.
        priors: What is known before; as for ``fit_stands``.
        hold_out: The share of each log, at its end, that is predicted instead of fitted; or logs
            that are.
        kp: Stated stiffness of the servos (N m/rad), one or (nu,); the model's own by default.
        kd: Stated damping (N m s/rad); likewise.

    Raises:
        ConfigurationError: If an argument is out of its range.
        FitError: If it does not converge.
        MeasurementError: If a log is none of this robot's, or nothing can be made of it; if no file
            states gains of its servos, and none are given; if a log that is to be predicted repeats
            one that is fitted.
        ModelError: If the model has motors that are no servos, and no gains are given.
        UnknownNameError: If a log has joints that the robot has not.
    """
    known = parse_priors(priors)
    if robot.floating:
        robot = build_robot(robot.description, fixed_base=True)
    if isinstance(hold_out, int | float):
        if not 0 <= hold_out < 1:
            finding = diagnose("not-between", given=hold_out, low=0, high=1)
            raise ConfigurationError("hold_out", finding)
        shared = [(log, float(hold_out)) for log in logs]
    else:
        shared = [*((log, 0.0) for log in logs), *((log, 1.0) for log in hold_out)]
    drive = model_with_servos(robot, kp, kd)
    made = {servo.joint for servo in robot.description.made_servos}  # so that it stands: no one's
    for log, _ in shared if kp is None or kd is None else ():
        if lacking := [name for name in log.joints if name in made]:
            raise MeasurementError(log.source, diagnose("command-without-gains", joints=lacking))
    notes = tuple(one for log, _ in shared for one in inspect_log(robot, log))
    runs = tuple(
        run
        for log, share in shared
        for run in split_runs(log.order_joints(robot), robot.home, share)
    )
    _check(robot, drive, logs, runs)
    table = _parameters(robot, drive, {name for log, _ in shared for name in log.joints}, known)
    interval = float(np.median([log.interval for log, _ in shared]))
    motion = MotionResiduals(Simulator(robot, drive, table, interval), runs)
    for log in () if isinstance(hold_out, int | float) else hold_out:
        alike = measure_replay(
            [*motion.fitted, *split_runs(log.order_joints(robot), robot.home, 1.0)]
        )
        if alike > _REPLAY:
            raise MeasurementError(log.source, diagnose("held-out-was-fitted", correlation=alike))
    return _report_motions(logs, notes, motion, motion.fit())


def _check(robot: Robot, drive: Servos, logs: Sequence[Log], runs: Sequence[Run]) -> None:
    """Checks that there is something to fit, and that what moves is driven by a servo.

    Raises:
        MeasurementError: If not.
    """
    if not runs or not any(run.counts.any() for run in runs):
        source = logs[0].source if logs else robot.name
        raise MeasurementError(source, diagnose("nothing-to-fit"))
    for log in logs:
        for name, command in zip(log.joints, log.command.T, strict=True):
            if not np.isfinite(command).any() or drive.kp[robot.joint_names.index(name)] <= 0:
                raise MeasurementError(log.source, diagnose("joint-without-servo", joint=name))


def _parameters(
    robot: Robot, drive: Servos, named: set[str], priors: Sequence[Prior]
) -> ParameterTable:
    """Returns what is estimated: of joints that are in a log, and of the links that they move.

    Damping of a servo and of its joint do the same: the joint's is estimated.
    """
    bodies = Simulator(robot, drive, ParameterTable(()), 1.0, 1).bodies
    model, dofs = bodies.model, robot.mj_convention.qvel_index
    wanted: list[tuple[str, str, str, float]] = []
    kinds = {
        "kp": drive.kp,
        "damping": model.dof_damping[dofs],
        "friction": model.dof_frictionloss[dofs],
        "armature": model.dof_armature[dofs],
        "offset": np.zeros(robot.nu),
    }
    for joint, name in enumerate(robot.joint_names):
        if name in named:
            wanted += [(kind, name, "", float(values[joint])) for kind, values in kinds.items()]
    for joint, (name, link) in enumerate(zip(robot.joint_names, bodies.links, strict=True)):
        if name in named and bodies.mass[joint] > 0:
            wanted.append(("mass", link, "", float(bodies.mass[joint])))
            wanted += [
                ("com", link, axis, float(bodies.com[joint, at])) for at, axis in enumerate("xyz")
            ]
    return ParameterTable(apply_priors([*wanted, *DELAY_PARAMETERS], priors))


def _report_motions(
    logs: Sequence[Log], notes: Iterable[Diagnostic], motion: MotionResiduals, posterior: Posterior
) -> MotionFit:
    """Returns a fit with how far its predictions are from what was measured."""
    robot = motion.simulator.robot
    off: dict[tuple[str, str], list[Array]] = {}
    for name, x in (("before", motion.table.stated), ("after", posterior.mean)):
        for run in motion.runs:
            one = motion.finer.predict_positions(run, [x])[0] - run.position
            for part in ("counts", "held_out"):
                off.setdefault((name, part), []).append(np.where(getattr(run, part), one, np.nan))
    rms = {key: compute_rms(one) for key, one in off.items()}
    part = "held_out" if math.isfinite(rms["after", "held_out"]) else "counts"
    joints = range(robot.nu)
    by_joint = np.array(
        [compute_rms(one[:, joint] for one in off["after", part]) for joint in joints]
    )
    noise = np.array([_encoder_noise([run.position[:, j] for run in motion.runs]) for j in joints])
    posterior = _widened(posterior, max(1.0, float(np.nanmedian(by_joint / noise))))
    return MotionFit(
        name=robot.name,
        source=", ".join(log.source for log in logs),
        estimates=tuple(describe_parameters(posterior)),
        kp_over_mass=estimate_kp_over_mass(posterior),
        failures=tuple(_unexplained(robot, by_joint, noise, rms["after", part])),
        diagnostics=(*notes, *_notes(motion.runs, rms["after", part], rms["before", part])),
        posterior=posterior,
        seconds=sum(log.duration for log in logs),
        held_out=rms["after", "held_out"],
        held_out_before=rms["before", "held_out"],
        fitted=rms["after", "counts"],
        fitted_before=rms["before", "counts"],
        repeatability=measure_repeatability(motion.runs),
        by_joint=dict(zip(robot.joint_names, by_joint.tolist(), strict=True)),
        encoder_noise=dict(zip(robot.joint_names, noise.tolist(), strict=True)),
    )


def _widened(posterior: Posterior, times: float) -> Posterior:
    """Returns what is known if measurements' noise is so many times what it was taken to be.

    What is left beyond the encoders' noise is of the model: it shifts numbers, and nobody knows
    which way. What was known before is as it was.
    """
    width = np.array([one.width for one in posterior.parameters])
    sizes, share = np.outer(width, width), times**-2
    whole = share * np.linalg.inv(posterior.covariance / sizes) + (1 - share) * posterior.precision
    return replace(posterior, covariance=sizes * np.linalg.inv(whole))


def _unexplained(robot: Robot, by_joint: Array, noise: Array, off: float) -> Iterator[Diagnostic]:
    """Yields what the fitted model does not explain."""
    left = by_joint / noise
    if np.nanmedian(left) > _MISFIT or np.nanmax(left, initial=0.0) > _MISFIT_OF_ONE:
        worst = int(np.nanargmax(by_joint))
        yield diagnose(
            "motion-not-explained",
            left=Quantity(off, "rad"),
            noise=Quantity(float(np.nanmedian(noise)), "rad"),
            worst=robot.joint_names[worst],
            most=Quantity(by_joint[worst], "rad"),
        )


def _notes(runs: Sequence[Run], off: float, before: float) -> Iterator[Diagnostic]:
    """Yields what else is to be said."""
    if off > before:
        yield diagnose(
            "motion-predicted-worse", now=Quantity(off, "rad"), stated=Quantity(before, "rad")
        )
    alike = measure_replay(runs)
    if alike > _REPLAY:
        yield diagnose("held-out-is-a-replay", correlation=alike)


_REPLAY = 0.95
"""Correlation of what was held out with something that was fitted: logs of one motion, started
anew, have 0.99 and more; another motion of the same joints hardly 0.5."""


def _align(part: Array, whole: Array) -> tuple[float, float]:
    """Returns after how many samples of other commands some commands begin, and how alike they are.

    By the greatest correlation of all joints together, and a parabola about it.
    """
    wanted = part - part.mean(axis=0)
    if len(whole) < len(part) or not wanted.any():
        return 0.0, 0.0
    moved, ones = whole - whole.mean(axis=0), np.ones((len(part), 1))
    alike = fftconvolve(moved, wanted[::-1], "valid", axes=0).sum(axis=1)
    mean = fftconvolve(moved, ones, "valid", axes=0) / len(part)
    energy = (fftconvolve(moved**2, ones, "valid", axes=0) - len(part) * mean**2).sum(axis=1)
    alike /= np.sqrt(np.maximum(energy, _LEAST**2 * len(part)) * (wanted**2).sum())
    best = int(alike.argmax())
    found = float(alike[best])
    if 0 < best < len(alike) - 1:
        before, here, after = alike[best - 1 : best + 2]
        if (bend := before - 2 * here + after) < 0:
            return best + float((before - after) / bend) / 2, found
    return float(best), found


def _middle(rows: Array) -> Array:
    """Returns the middle half of some rows: of logs that are shifted against each other."""
    return rows[len(rows) // 4 : len(rows) - len(rows) // 4]


def measure_replay(runs: Sequence[Run]) -> float:
    """Returns how alike what was held out is to what was fitted, by its commands, wherever it was.

    The greatest correlation of the middle half of a held-out part with any part as long of what was
    fitted.
    """
    fitted = [run.command[run.counts.any(axis=1)] for run in runs]
    parts = [_middle(run.command[run.held_out.any(axis=1)]) for run in runs]
    return max((_align(part, own)[1] for part in parts if len(part) for own in fitted), default=0.0)


def measure_repeatability(runs: Sequence[Run]) -> float:
    """Returns how far the robot is from itself over runs of the same commands (rad).

    The middle half of each run beside the first run that it repeats, as their commands align; NaN
    if none does.
    """
    off = []
    for number, run in enumerate(runs):
        for other in runs[:number]:
            shift, alike = _align(_middle(run.command), other.command)
            if alike > _REPLAY:
                own = _middle(run.position)
                at = shift + np.arange(len(own))
                there = np.arange(len(other.position))
                its = np.column_stack([np.interp(at, there, one) for one in other.position.T])
                off.append((own - its) / math.sqrt(2.0))  # each is off from what both would be
                break
    return compute_rms(off) if off else math.nan


def _encoder_noise(series: Sequence[Array]) -> float:
    """Returns the standard deviation of what no motion is, by third differences.

    Of noise without memory their variance is 20 times its own; a motion of some Hz has hardly any.
    By their median, as joints that are kicked by a new command have for a moment; and no less than
    the encoder's quantum makes.
    """
    steps = np.concatenate([np.abs(np.diff(one, 3)) for one in series])
    steps = steps[np.isfinite(steps)]
    quantum = max(find_column_step(one[np.isfinite(one)]) for one in series)
    if not steps.size:
        return math.nan
    return max(float(np.median(steps)) / _MEDIAN / math.sqrt(20.0), quantum / math.sqrt(12.0))


_MEDIAN = 0.6744897501960817
"""Of the magnitude of a normal number of deviation 1."""


IntArray = NDArray[np.int64]

_ENOUGH = 0.04
"""Of the cost: a fifth of a standard deviation, by which an interval is 2 % too narrow."""

_ROUGHLY = 10.0
"""Of the cost: near enough while what is left is motion, and its noise is not known."""

_NEAR = 4.0
"""Of the cost: derivatives from two standard deviations away do; a simulation makes them slowly."""

_FINER = 4
"""Times the steps of what derivatives are made with has what is compared with measurements: its
error, that of dry friction, falls with the square. Derivatives are right to 1 % without."""


class MotionResiduals:
    """Measured and simulated runs, and how far they are apart.

    Fine steps predict; coarse ones, of which there are thirty for one, make derivatives.

    Args:
        simulator: Simulates them.
        runs: As they were measured.
    """

    def __init__(self, simulator: Simulator, runs: Sequence[Run]) -> None:
        self.simulator, self.runs, self.table = simulator, tuple(runs), simulator.table
        self.fitted = tuple(run for run in runs if run.counts.any())
        self.finer = simulator.with_steps(_FINER * simulator.steps)
        self.moments = MomentCoordinates(self.table)
        self._noise: tuple[SeriesNoise, ...] = ()
        self._remembers = False
        self._at: Array | None = None
        self._known: Array | None = None
        self._jacobians: list[Mapping[int, tuple[IntArray, Array]]] = []

    def linearise(self, moments: Array, about: Array) -> LinearisedResiduals:
        """Returns whitened residuals as sums; see ``estimate_parameters``.

        Noise is what is left at ``about``, and derivatives are made near it.
        """
        x = self.moments.to_parameters(moments)
        left = [
            self.finer.predict_positions(run, [x])[0] - np.where(run.counts, run.position, np.nan)
            for run in self.fitted
        ]
        if moments is about:
            kind = SeriesNoise.fit_autoregression if self._remembers else SeriesNoise.fit_white
            self._noise = tuple(
                kind([one[:, joint] for one in left]) for joint in range(left[0].shape[1])
            )
            off = None if self._at is None else (moments - self._at) / self.table.width
            if off is None or off @ self._known @ off > _NEAR:
                self._at = moments.copy()
                self._jacobians = [
                    differentiate_motion(self.simulator, self.moments, run, moments, self._known)
                    for run in self.fitted
                ]
        size = len(self.table)
        information, gradient = np.zeros((size, size)), np.zeros(size)
        white = [one / np.array([own.long_run_std for own in self._noise]) for one in left]
        for places, rows, joint, run in self._rows():
            finding = np.isfinite(white[run][:, joint])
            counted = rows[finding] / self._noise[joint].long_run_std
            information[places[:, None], places] += counted.T @ counted
            gradient[places] += counted.T @ white[run][finding, joint]
        if moments is about:
            width = self.table.width
            self._known = width[:, None] * information * width + self.table.precision
        whole = np.concatenate([one[np.isfinite(one)] for one in white])
        return LinearisedResiduals(information, gradient, float(whole @ whole), whole.size)

    def _rows(self) -> Iterator[tuple[IntArray, Array, int, int]]:
        """Yields parameters, derivatives by them (n, ...), the joint, and the run."""
        for run, jacobians in enumerate(self._jacobians):
            for number, (places, by_places) in jacobians.items():
                for at, joint in enumerate(self.simulator.groups[number][0]):
                    yield places, by_places[:, at], joint, run

    def fit(self) -> Posterior:
        """Returns the parameters, with the noise that they leave.

        They are those of least squares, in which each joint counts by its noise's long-run
        deviation. Their covariance is that which noise with its memory gives such parameters
        ("sandwich"): for H = A + 1, in the priors' widths, H^-1 (B + 1) H^-1, where B is the
        covariance of the gradient.

        Raises:
            FitError: If it does not converge.
        """
        y = self.moments.from_parameters(self.table.stated)
        for self._remembers, enough in ((False, _ROUGHLY), (True, _ENOUGH)):
            posterior = estimate_parameters(self.table, self.linearise, y, enough=enough)
            y = posterior.mean
        width = self.table.width
        spread = np.zeros((len(y), len(y)))
        for places, rows, joint, run in self._rows():
            noise = self._noise[joint]
            counted = np.where(self.fitted[run].counts[:, joint, None], rows, 0.0)
            back = noise.propagate_weights(counted / noise.long_run_std**2)
            spread[places[:, None], places] += back @ back.T
        whole = posterior.information + posterior.precision
        narrow = np.linalg.inv(whole)
        spread = width[:, None] * spread * width + posterior.precision
        # With what was promised and not found.
        promised = posterior.covariance / np.outer(width, width)
        covariance = narrow @ (spread - whole) @ narrow + promised
        return self.moments.transform_posterior(posterior, covariance)


# What is left of a fitted motion, as noise that remembers itself.


_MOST_LAGS = 20
"""100 ms at 200 Hz: what remembers longer is seen by what it does in that time."""

_LEAST = 1e-6
"""rad, m: no encoder's noise is less, and no weight is infinite."""

_SAMPLES_PER_LAG = 20
"""Fewer tell nothing of a coefficient."""


@dataclass(frozen=True, eq=False)
class SeriesNoise:
    """Noise of one joint: e_k = sum_i c_i e_(k-i) + w_k, with w of standard deviation s.

    Residuals of a motion follow each other: an encoder that is still says the same for long, and
    what a model lacks lasts. A sum over many samples is as uncertain as that of independent ones of
    the deviation s / (1 - sum c), its long-run deviation.

    Attributes:
        coefficients: (lags,) c.
        innovation: s.
        deviation: Of e.
    """

    coefficients: Array
    innovation: float
    deviation: float

    @staticmethod
    def fit_white(series: Sequence[Array]) -> SeriesNoise:
        """Returns noise without memory, that some series (n,) are."""
        deviation = float(np.fmax(compute_rms(series), _LEAST))  # which is NaN of nothing
        return SeriesNoise(np.zeros(0), deviation, deviation)

    @staticmethod
    def fit_autoregression(series: Sequence[Array]) -> SeriesNoise:
        """Returns the noise that some series (n,) are; NaN are missing.

        By Yule's and Walker's equations, whose noise never grows.
        """
        filled = [np.where(np.isfinite(one), one, 0.0) for one in series]
        count = int(sum(np.isfinite(one).sum() for one in series))
        white = SeriesNoise.fit_white(series)
        if count < _SAMPLES_PER_LAG * _MOST_LAGS or white.deviation <= _LEAST:
            return white
        moments = np.array(
            [sum(float(one[lag:] @ one[: max(len(one) - lag, 0)]) for one in filled) / count
             for lag in range(_MOST_LAGS + 1)]
        )  # fmt: skip
        given = solve_toeplitz(moments[:-1], moments[1:])
        variance = max(float(moments[0] - given @ moments[1:]), _LEAST**2)
        return SeriesNoise(given, math.sqrt(variance), white.deviation)

    @property
    def long_run_std(self) -> float:
        """Standard deviation of independent samples that tell as little; that of e at least."""
        return max(self.innovation / (1 - float(self.coefficients.sum())), self.deviation)

    def propagate_weights(self, weights: Array) -> Array:
        """Returns B^T with B^T B the covariance of sums of the noise with weights (n, m): (m, n).

        The noise is w through a filter; so its sums are those of w with the weights through the
        filter backwards.
        """
        turned = [1.0, *-self.coefficients]
        return np.asarray(lfilter([self.innovation], turned, weights[::-1], axis=0)).T


def compute_rms(series: Iterable[Array]) -> float:
    """Returns the root mean square of what is not NaN; NaN of nothing."""
    whole = np.concatenate([one.ravel() for one in series])
    finding = whole[np.isfinite(whole)]
    return float(np.sqrt(np.mean(finding**2))) if finding.size else math.nan


# How predicted motions change with parameters: differences along what is known to be uncertain.


_STEP = 0.1
"""Of a standard deviation: by that parameters are changed for a derivative. From 0.1 to 1 the
intervals of a v3 are the same to 1 %, and motions hardly bend in the least of these."""

_FIRST_STEP = 1e-2
"""Of a prior's width, while nothing else is known."""


def differentiate_motion(
    simulator: Simulator,
    moments: MomentCoordinates,
    run: Run,
    at: Array,
    known: Array | None = None,
) -> Mapping[int, tuple[IntArray, Array]]:
    """Returns how predicted positions change with parameters by moments.

    kp, friction, masses all larger by the same factor move nothing, but each alone moves much: by
    parameters one at a time, errors of large derivatives add up to what looks as if the factor were
    told, and intervals are a quarter too narrow. So steps are along principal directions of what is
    known, each as long as it is uncertain.

    Joints that move no body of each other's are changed together, as they do not feel it.

    Args:
        simulator: Predicts them.
        moments: Makes parameters of moments.
        run: The run.
        at: (n,) moments.
        known: (n, n) what is known of these, in the priors' widths: inverse of a covariance. None:
            the priors alone, and steps are one parameter at a time.

    Returns:
        {group of joints: (numbers of the parameters that act on it, (n, joints, parameters))}.
    """
    groups, shared = simulator.groups, simulator.bodies.find_common_parameters(simulator.table)
    turns, width = max(len(columns) for _, columns in groups), simulator.table.width
    changes = np.zeros((turns + len(shared), len(at)))
    steps = []
    for columns in (*(own for _, own in groups), shared):
        steps.append(_steps(columns, known))
        rows = slice(len(columns)) if len(steps) <= len(groups) else slice(turns, None)
        changes[rows, columns] = steps[-1]
    changes *= width

    vectors = [moments.to_parameters(one) for one in (at, *(at + changes))]
    predicted = simulator.predict_positions(run, vectors)
    moved = predicted[1:] - predicted[0]
    found: dict[int, tuple[IntArray, Array]] = {}
    for number, (joints, columns) in enumerate(groups):
        places = np.array([*columns, *shared], dtype=np.int64)
        by_step = np.moveaxis(moved[:, :, joints], 0, 2)
        jacobians = np.concatenate(
            [
                by_step[..., : len(columns)] @ np.linalg.inv(steps[number]).T,
                by_step[..., turns:] @ np.linalg.inv(steps[-1]).T,
            ],
            axis=2,
        )
        found[number] = places, jacobians / width[places]
        simulator.replace_lag_derivatives(vectors[0], *found[number])
    return found


def _steps(columns: list[int], known: Array | None) -> Array:
    """Returns steps (rows) of some parameters in their priors' widths."""
    if known is None:
        return _FIRST_STEP * np.eye(len(columns))
    values, directions = np.linalg.eigh(known[np.ix_(columns, columns)])
    return np.asarray(_STEP * (directions / np.sqrt(values)).T)
