"""Fit of logs: estimate parameters from motions of a robot whose base is held.

Inputs are commands and measured positions of the joints over time. The motion is simulated in
MuJoCo; the parameters minimise the difference between predicted and measured positions and the
deviation from the priors. The weights follow from the autocorrelated residual noise.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import solve_toeplitz
from scipy.signal import fftconvolve, lfilter

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.array_types import Array, IntArray
from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.base.errors import ConfigurationError, MeasurementError
from pupper_analysis.robot.build import build_robot
from pupper_analysis.robot.joints import is_slide, joint_unit
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import Servos, model_with_servos
from pupper_analysis.tools.fit.estimate import (
    HALF_WIDTH_95,
    LinearisedResiduals,
    Posterior,
    estimate_parameters,
)
from pupper_analysis.tools.fit.measurements.log import Log
from pupper_analysis.tools.fit.measurements.log_quality import find_column_step, inspect_log
from pupper_analysis.tools.fit.motions.rollouts import (
    DELAY_PARAMETERS,
    LogSegment,
    MomentCoordinates,
    Simulator,
    shorten_run,
    split_runs,
)
from pupper_analysis.tools.fit.motions.wiring import find_log_wiring
from pupper_analysis.tools.fit.parameters import (
    PARAMETER_KINDS,
    ParameterTable,
    Prior,
    apply_priors,
    parse_priors,
)
from pupper_analysis.tools.fit.result import MotionFit, describe_parameters, estimate_kp_over_mass

HOLD_OUT_FRACTION = 0.2
"""Default fraction at the end of each run that is predicted, not fitted. A run is a part of a log
without clock jumps. Chosen, not tuned."""


_MAX_NOISE_RATIO = 2.0
"""Largest accepted median, over the joints whose readings vary, of the ratio of RMS position error
to encoder noise. If the median is larger, the fit fails since the model does not explain the
motion. Chosen, not tuned.
"""

_MAX_JOINT_NOISE_RATIO = 10.0
"""Largest accepted ratio of RMS position error to encoder noise of a single joint. If the ratio is
larger, the fit fails. Measured: clock jitter of a tenth of the sampling interval gives a ratio of
3.
"""


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
    """Estimate a robot's parameters from logs of motions.

    The base of the robot must have been fixed during the motion. MuJoCo simulates the motion under
    the logged commands. Gauss-Newton steps minimise the difference between simulated and measured
    positions, with priors about the stated values. The residuals are modelled as autocorrelated
    noise, which determines the intervals.

    Args:
        robot: Robot. A free base is fixed.
        logs: Logs of the robot's motions.
        priors: Prior standard deviations, for example ``mass=50%`` or ``com:base=5mm``. With
            ``kp=0``, the stated kp is exact and is not estimated.
        hold_out: Measurements that are predicted instead of fitted: a fraction at the end of each
            run (part of a log without clock jumps), or separate logs.
        kp: Stated servo stiffness [N m/rad, N/m], a scalar or shape (nu,); the model's by default.
        kd: Stated servo damping [N m s/rad, N s/m], a scalar or shape (nu,); the model's by
            default.

    Raises:
        ConfigurationError: If a prior, a gain or the fraction of ``hold_out`` is invalid.
        FitError: If no minimum is found; for example, the iteration does not converge.
        MeasurementError: If a log cannot be used or does not belong to this robot, for example
            because no joint moves.
        ModelError: If the servo gains of a joint are unknown, for example.
        UnknownNameError: If a log contains a joint that the robot lacks.
    """
    prior_list = parse_priors(priors)
    if robot.floating:
        robot = build_robot(robot.description, fixed_base=True)
    if isinstance(hold_out, int | float):
        if not 0 <= hold_out < 1:
            finding = diagnose("not-between", given=hold_out, low=0, high=1)
            raise ConfigurationError("hold_out", finding)
        log_fractions = [(log, float(hold_out)) for log in logs]
    else:
        log_fractions = [*((log, 0.0) for log in logs), *((log, 1.0) for log in hold_out)]
    servos = model_with_servos(robot, kp, kd)
    # Servos that were added on loading have no stated gains.
    added_servos = {servo.joint for servo in robot.description.made_servos}
    for log, _ in log_fractions if kp is None or kd is None else ():
        if without_gains := [name for name in log.joints if name in added_servos]:
            raise MeasurementError(
                log.source, diagnose("command-without-gains", joints=without_gains, default_kp=None)
            )
    notes = tuple(note for log, _ in log_fractions for note in inspect_log(robot, log))
    runs = tuple(
        run
        for log, fraction in log_fractions
        for run in split_runs(log.order_joints(robot), robot.home, fraction)
    )
    _check_runs(robot, servos, logs, runs)
    if wrong_wiring := find_log_wiring(robot, servos, runs):
        raise MeasurementError(", ".join(log.source for log, _ in log_fractions), wrong_wiring)
    table = _make_parameters(
        robot, servos, {name for log, _ in log_fractions for name in log.joints}, prior_list
    )
    interval = float(np.median([log.interval for log, _ in log_fractions]))
    motion = MotionResiduals(Simulator(robot, servos, table, interval), runs)
    for log in () if isinstance(hold_out, int | float) else hold_out:
        correlation = measure_replay(
            [*motion.fitted, *split_runs(log.order_joints(robot), robot.home, 1.0)]
        )
        if correlation > _MIN_REPLAY_CORRELATION:
            raise MeasurementError(
                log.source, diagnose("held-out-was-fitted", correlation=correlation)
            )
    return _report_motions(logs, notes, motion, motion.fit())


def _check_runs(
    robot: Robot, drive: Servos, logs: Sequence[Log], runs: Sequence[LogSegment]
) -> None:
    """Check that there are samples to fit, and that logged joints have commands and a servo."""
    if not runs or not any(run.counts.any() for run in runs):
        source = logs[0].source if logs else robot.name
        raise MeasurementError(source, diagnose("nothing-to-fit"))
    for log in logs:
        for name, command in zip(log.joints, log.command.T, strict=True):
            if not np.isfinite(command).any() or drive.kp[robot.joint_names.index(name)] <= 0:
                raise MeasurementError(log.source, diagnose("joint-without-servo", joint=name))
    for run in runs:
        is_measured = np.isfinite(run.position).any(axis=0)
        for joint in np.flatnonzero(is_measured & np.isnan(run.command).any(axis=0)):
            problem = diagnose("joint-without-servo", joint=robot.joint_names[joint])
            raise MeasurementError(", ".join(log.source for log in logs), problem)


def _make_parameters(
    robot: Robot, drive: Servos, log_joints: set[str], priors: Sequence[Prior]
) -> ParameterTable:
    """Create the parameters: joints in the logs, moved links, and delays.

    The damping kd of the servos is no parameter: an error of kd appears in the estimated damping of
    the joint, since both have the same effect. The default prior of the damping is therefore at
    least as wide as the error of kd (`_KD_SHARE`).
    """
    bodies = Simulator(robot, drive, ParameterTable(()), 1.0, 1).bodies
    model, dofs = bodies.model, robot.mj_convention.qvel_index
    candidates: list[tuple[str, str, str, float]] = []
    kinds = {
        "kp": drive.kp,
        "damping": model.dof_damping[dofs],
        "friction": model.dof_frictionloss[dofs],
        "armature": model.dof_armature[dofs],
        "offset": np.zeros(robot.nu),
    }
    for joint, name in enumerate(robot.joint_names):
        if name in log_joints:
            candidates += [(kind, name, "", float(values[joint])) for kind, values in kinds.items()]
    for joint, (name, link) in enumerate(zip(robot.joint_names, bodies.links, strict=True)):
        if name in log_joints and bodies.mass[joint] > 0:
            candidates.append(("mass", link, "", float(bodies.mass[joint])))
            candidates += [
                ("com", link, axis, float(bodies.com[joint, component]))
                for component, axis in enumerate("xyz")
            ]
    damping = PARAMETER_KINDS["damping"]
    widths = np.maximum(damping.share * kinds["damping"], damping.width)
    widths = np.maximum(widths, _KD_SHARE * drive.kd)
    defaults = [
        Prior("damping", name, width=float(width))
        for name, width in zip(robot.joint_names, widths, strict=True)
        if name in log_joints
    ]
    parameters = apply_priors([*candidates, *DELAY_PARAMETERS], [*defaults, *priors])
    return ParameterTable(parameters)


_KD_SHARE = PARAMETER_KINDS["kp"].share
"""Standard deviation of kd, as a fraction of the stated kd. Drivers convert kp and kd alike."""


def _report_motions(
    logs: Sequence[Log], notes: Iterable[Diagnostic], motion: MotionResiduals, posterior: Posterior
) -> MotionFit:
    """Create the result of a fit from the distribution of the parameters (`posterior`).

    Positions are predicted with small time steps, with the stated and with the estimated
    parameters.
    """
    robot = motion.simulator.robot
    errors: dict[tuple[str, str], list[Array]] = {}
    for name, vector in (("before", motion.table.stated), ("after", posterior.mean)):
        for run in motion.runs:
            series = motion.fine_simulator.predict_positions(run, [vector])[0] - run.position
            for subset in ("counts", "held_out"):
                errors.setdefault((name, subset), []).append(
                    np.where(getattr(run, subset), series, np.nan)
                )
    rms = {key: compute_rms(error) for key, error in errors.items()}
    subset = "held_out" if math.isfinite(rms["after", "held_out"]) else "counts"
    joints = range(robot.nu)
    by_joint = np.array(
        [compute_rms(series[:, joint] for series in errors["after", subset]) for joint in joints]
    )
    noise = np.array(
        [_estimate_encoder_noise([run.position[:, j] for run in motion.runs]) for j in joints]
    )
    ratio, _ = _compute_noise_ratios(by_joint, noise)
    posterior = _inflate_covariance(posterior, max(1.0, ratio))
    return MotionFit(
        name=robot.name,
        slides=tuple(joint for joint in robot.joint_names if is_slide(robot, joint)),
        source=", ".join(log.source for log in logs),
        estimates=tuple(describe_parameters(posterior)),
        kp_over_mass=estimate_kp_over_mass(posterior),
        failures=(
            *_report_stall(posterior),
            *_report_misfit(robot, by_joint, noise, rms["after", subset]),
        ),
        diagnostics=(
            *notes,
            *_report_notes(motion.runs, rms["after", subset], rms["before", subset]),
        ),
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


def _inflate_covariance(posterior: Posterior, noise_ratio: float) -> Posterior:
    """Return the distribution for measurement noise that is ``noise_ratio`` times as large.

    Errors beyond the encoder noise are errors of the model, which shift parameters in unknown
    directions. The prior is unchanged.
    """
    width = np.array([parameter.width for parameter in posterior.parameters])
    sizes, inverse_square = np.outer(width, width), noise_ratio**-2
    information = (
        inverse_square * np.linalg.inv(posterior.covariance / sizes)
        + (1 - inverse_square) * posterior.precision
    )
    return replace(posterior, covariance=sizes * np.linalg.inv(information))


def _compute_noise_ratios(by_joint: Array, noise: Array) -> tuple[float, Array]:
    """Return the ratio of position error to encoder noise: median, and values of shape (nu,).

    Constant readings contain no noise, so that a substitute noise is used. NaN without
    measurements.
    """
    has_noise = noise > 0
    typical_noise = float(np.median(noise[has_noise])) if has_noise.any() else _MIN_NOISE_STD
    ratios = by_joint / np.where(has_noise, noise, typical_noise)
    return float(np.nanmedian(ratios[has_noise] if has_noise.any() else ratios)), ratios


def _report_stall(posterior: Posterior) -> Iterator[Diagnostic]:
    """Yield a failure if the iteration ended too far from the minimum of the cost.

    The interval of each parameter is widened by the step that did not decrease the cost as
    predicted. A step within the 95 % interval of the measurement noise is therefore no failure.
    """
    step = math.sqrt(posterior.unrealised_decrease)
    if step > HALF_WIDTH_95:
        yield diagnose("motion-fit-not-converged", sigmas=step, most=HALF_WIDTH_95)


def _report_misfit(
    robot: Robot, by_joint: Array, noise: Array, rms_error: float
) -> Iterator[Diagnostic]:
    """Yield a failure if the fitted model does not explain the motion.

    RMS errors ``by_joint`` and encoder ``noise`` have the shape (nu,) [rad, m]; NaN if not
    measured.
    """
    median_ratio, noise_ratios = _compute_noise_ratios(by_joint, noise)
    if (
        median_ratio > _MAX_NOISE_RATIO
        or np.nanmax(noise_ratios, initial=0.0) > _MAX_JOINT_NOISE_RATIO
    ):
        worst = int(np.nanargmax(by_joint))
        yield diagnose(
            "motion-not-explained",
            left=Quantity(rms_error, "rad"),
            noise=Quantity(float(np.nanmedian(noise)), "rad"),
            worst=robot.joint_names[worst],
            most=Quantity(by_joint[worst], joint_unit(robot, robot.joint_names[worst])),
        )


def _report_notes(
    runs: Sequence[LogSegment], rms_error: float, stated_error: float
) -> Iterator[Diagnostic]:
    """Yield warnings about worse predictions than before the fit, and about repeated motions.

    Both RMS position errors [rad and m mixed] belong to the same samples.
    """
    if rms_error > stated_error:
        yield diagnose(
            "motion-predicted-worse",
            now=Quantity(rms_error, "rad"),
            stated=Quantity(stated_error, "rad"),
        )
    correlation = measure_replay(runs)
    if correlation > _MIN_REPLAY_CORRELATION:
        yield diagnose("held-out-is-a-replay", correlation=correlation)


_MIN_REPLAY_CORRELATION = 0.95
"""Correlation of the commands of two runs above which both count as the same motion. A held-out
motion that repeats a fitted motion does not test the fit. Measured: at least 0.99 in repeated logs,
and about 0.5 or less in other motions of the same joints.
"""


def _align_commands(pattern: Array, series: Array) -> tuple[float, float]:
    """Find a motion in another: shift [samples] of best agreement, and the correlation there.

    ``pattern`` is searched in ``series``. Both are commands, shape (samples, nu) [rad, m]. The
    result is (0, 0) if a comparison is not possible, for example with a constant pattern.
    """
    centred_pattern = pattern - pattern.mean(axis=0)
    is_constant = np.abs(centred_pattern).max(initial=0.0) <= _MIN_NOISE_STD
    if len(series) < len(pattern) or is_constant:
        return 0.0, 0.0
    centred_series, ones = series - series.mean(axis=0), np.ones((len(pattern), 1))
    correlations = fftconvolve(centred_series, centred_pattern[::-1], "valid", axes=0).sum(axis=1)
    mean = fftconvolve(centred_series, ones, "valid", axes=0) / len(pattern)
    energy = (fftconvolve(centred_series**2, ones, "valid", axes=0) - len(pattern) * mean**2).sum(
        axis=1
    )
    correlations /= np.sqrt(
        np.maximum(energy, _MIN_NOISE_STD**2 * len(pattern)) * (centred_pattern**2).sum()
    )
    best_index = int(correlations.argmax())
    best_correlation = float(correlations[best_index])
    if 0 < best_index < len(correlations) - 1:
        before, peak, after = correlations[best_index - 1 : best_index + 2]
        if (curvature := before - 2 * peak + after) < 0:
            return best_index + float((before - after) / curvature) / 2, best_correlation
    return float(best_index), best_correlation


def _get_middle_half(rows: Array) -> Array:
    """Return the middle half of ``rows``, shape (n, ...), the samples of a log.

    Another log of the same motion contains this half also after a shift by up to a quarter of the
    samples.
    """
    return rows[len(rows) // 4 : len(rows) - len(rows) // 4]


def measure_replay(runs: Sequence[LogSegment]) -> float:
    """Compute the largest correlation [1] between held-out and fitted commands.

    Held-out samples are excluded from the fit, to validate the fit. A correlation near 1 means that
    the held-out motion repeats a fitted motion, possibly at another time. The result is 0 if no run
    has a held-out part.
    """
    fitted = [run.command[run.counts.any(axis=1)] for run in runs]
    parts = [_get_middle_half(run.command[run.held_out.any(axis=1)]) for run in runs]
    return max(
        (_align_commands(part, series)[1] for part in parts if len(part) for series in fitted),
        default=0.0,
    )


def measure_repeatability(runs: Sequence[LogSegment]) -> float:
    """Compute the RMS error with which joint positions repeat under equal commands [rad, m mixed].

    The RMS difference of the positions in two runs with the same commands is divided by sqrt(2).
    NaN, for example, if no commands are repeated.
    """
    differences = []
    for index, run in enumerate(runs):
        for earlier_run in runs[:index]:
            shift, correlation = _align_commands(_get_middle_half(run.command), earlier_run.command)
            if correlation > _MIN_REPLAY_CORRELATION:
                positions = _get_middle_half(run.position)
                sample_times = shift + np.arange(len(positions))
                earlier_times = np.arange(len(earlier_run.position))
                earlier_positions = np.column_stack(
                    [
                        np.interp(sample_times, earlier_times, column)
                        for column in earlier_run.position.T
                    ]
                )
                # The variance of a difference is twice the variance of a run.
                differences.append((positions - earlier_positions) / math.sqrt(2.0))
                break
    return compute_rms(differences) if differences else math.nan


def _estimate_encoder_noise(series: Sequence[Array]) -> float:
    """Estimate the standard deviation [rad, m] of a joint's encoder noise from third differences.

    For white noise of variance s^2, the variance of third differences is 20 s^2. The median is
    used, since joints jump for a moment after a new command. The result is at least the rounding
    noise of the encoder step. NaN without differences.
    """
    steps = np.concatenate([np.abs(np.diff(column, 3)) for column in series])
    steps = steps[np.isfinite(steps)]
    quantum = max(find_column_step(column[np.isfinite(column)]) for column in series)
    if not steps.size:
        return math.nan
    return max(
        float(np.median(steps)) / _NORMAL_MEDIAN / math.sqrt(20.0), quantum / math.sqrt(12.0)
    )


_NORMAL_MEDIAN = 0.6744897501960817
"""Median of the absolute value of a standard normal variable. The median of absolute differences of
readings is divided by this value to obtain a standard deviation.
"""

_MIN_DECREASE = 0.04
"""Predicted decrease of the cost (squared residuals in standard deviations) below which the
iteration has converged. The estimate is then within sqrt(0.04) = 0.2 standard deviations of the
minimum. An error of 0.2 makes an interval about 2 % too narrow: sqrt(1 + 0.04). Chosen, not
tuned."""

_FIRST_PASS_MIN_DECREASE = 10.0
"""Predicted decrease of the cost (chi2 plus prior) below which the first pass ends. The first pass
assumes white noise. Chosen, not tuned.
"""

_FIRST_PASS_DURATION = 5.0
"""Smallest duration [s] to which `shorten_run` shortens the runs of the first pass. The first pass
needs most iterations, and determines only the initial guess of the second pass. Chosen, not tuned.
"""

_MIN_RELATIVE_DECREASE = 5e-3
"""Decrease of the cost, relative to the cost, at or below which slow progress is a stall. The cost
is then limited by the model, for example by joints that stick: 0.5 % of the cost changes the RMS
residual by 0.25 %. Chosen, not tuned.
"""

_STALL_RTOL = 0.1
"""Largest predicted decrease, as a fraction of the cost, with which a stalled iteration gives a
result (``stall_rtol`` of `estimate_parameters`). Measured on a log of v3 (4 s, encoders of 12
bits): the iteration stalls with a predicted decrease of 2 to 10 %.
"""

_MAX_DERIVATIVE_DISTANCE = 4.0
"""Largest squared distance [posterior variances] of the parameters from the point of the last
derivatives. Up to this distance the derivatives are reused, since they need many simulations. A
value of 4 corresponds to two standard deviations. Chosen, not tuned.
"""

_SCALED_KINDS = ("kp", "friction", "damping", "armature", "mass", "com")
"""Kinds of parameters of which a motion determines the ratio to kp. The parameter of a CoM is the
first moment (`MomentCoordinates`).
"""

_MIN_KP_FRACTION = 1e-3
"""Lower bound of kp, as a fraction of the stated kp, in the logarithm of a term of the cost.
Chosen, not tuned.
"""

_FINE_STEP_FACTOR = 4
"""Factor on the number of simulation steps for predictions, compared with derivatives. Chosen, not
tuned."""


class MotionResiduals:
    """Residuals between measured and simulated runs, whitened by noise models, for a fit.

    Predictions use fine simulation steps; derivatives use coarse steps, since derivatives need many
    times as many simulations. The first pass of a fit uses coarse steps and shortened runs.

    Args:
        simulator: Simulator with coarse steps.
        runs: Measured runs.
    """

    def __init__(self, simulator: Simulator, runs: Sequence[LogSegment]) -> None:
        self.simulator, self.runs, self.table = simulator, tuple(runs), simulator.table
        self.fitted = tuple(run for run in runs if run.counts.any())
        self.fine_simulator = simulator.with_steps(_FINE_STEP_FACTOR * simulator.steps)
        self._predictor = self.fine_simulator
        self.moments = MomentCoordinates(self.table)
        self._noise: tuple[SeriesNoise, ...] = ()
        self._is_autoregressive = False
        self._derivative_point: Array | None = None
        self._information: Array | None = None
        self._jacobians: list[Mapping[int, tuple[IntArray, Array]]] = []
        self._scaled_columns, self._kp_columns = self._find_scaled_parameters()
        self._square_deviations = np.zeros(len(self.table))

    def _find_scaled_parameters(self) -> tuple[IntArray, IntArray]:
        """Return the indices of parameters that are determined relative to a kp, and of this kp.

        A common factor on kp, friction, damping, armature, masses and moments of a joint and its
        link hardly changes the motion.
        """
        links = dict(
            zip(self.simulator.bodies.links, self.simulator.robot.joint_names, strict=True)
        )
        pairs = []
        for index, parameter in enumerate(self.table):
            joint = links.get(parameter.subject, parameter.subject)
            kp = self.table.find_index("kp", joint)
            if parameter.kind in _SCALED_KINDS and kp is not None:
                pairs.append((index, kp))
        scaled, kps = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
        return scaled, kps

    def _correct_scale_bias(self, moments: Array) -> tuple[float, Array]:
        """Return a cost term against the bias of a common factor, and its derivative (n,).

        The measurements determine the ratios of parameters to kp; the prior determines their common
        factor. The prior's squares z_i^2 (deviations in prior widths) favour small factors. The
        term -2 sum_i w_i ln(kp / stated kp) cancels this preference: w_i is the fraction of z_i^2
        that the measurements determine.
        """
        kp = np.maximum(moments, _MIN_KP_FRACTION * self.table.stated)[self._kp_columns]
        weights = self._square_deviations[self._scaled_columns]
        derivative = np.zeros(len(moments))
        np.add.at(derivative, self._kp_columns, -2 * weights / kp)
        ratios = kp / self.table.stated[self._kp_columns]
        return float(-2 * weights @ np.log(ratios)), derivative

    def linearise(self, moments: Array, noise_point: Array) -> LinearisedResiduals:
        """Linearise the whitened residuals of all runs, for ``estimate_parameters``.

        The residuals are predicted minus measured joint positions, divided by the long-run standard
        deviation of the noise.

        Args:
            moments: Parameters in first-moment coordinates (`MomentCoordinates`), shape (n,).
            noise_point: ``moments`` itself, to estimate the noise again; any other array for a
                trial with earlier noise and derivatives.
        """
        vector = self.moments.to_parameters(moments)
        residuals = [
            self._predictor.predict_positions(run, [vector])[0]
            - np.where(run.counts, run.position, np.nan)
            for run in self.fitted
        ]
        if moments is noise_point:
            fit_noise = (
                SeriesNoise.fit_autoregression if self._is_autoregressive else SeriesNoise.fit_white
            )
            self._noise = tuple(
                fit_noise([series[:, joint] for series in residuals])
                for joint in range(residuals[0].shape[1])
            )
            distance = (
                None
                if self._derivative_point is None
                else (moments - self._derivative_point) / self.table.width
            )
            if (
                distance is None
                or distance @ self._information @ distance > _MAX_DERIVATIVE_DISTANCE
            ):
                self._derivative_point = moments.copy()
                self._jacobians = [
                    differentiate_motion(
                        self.simulator, self.moments, run, moments, self._information
                    )
                    for run in self.fitted
                ]
        size = len(self.table)
        information, gradient = np.zeros((size, size)), np.zeros(size)
        whitened = [
            series / np.array([noise.long_run_std for noise in self._noise]) for series in residuals
        ]
        for indices, rows, joint, run in self._iterate_derivatives():
            is_finite = np.isfinite(whitened[run][:, joint])
            scaled = rows[is_finite] / self._noise[joint].long_run_std
            information[indices[:, None], indices] += scaled.T @ scaled
            gradient[indices] += scaled.T @ whitened[run][is_finite, joint]
        if moments is noise_point:
            width = self.table.width
            scaled_information = width[:, None] * information * width
            self._information = scaled_information + self.table.precision
            determined = np.diag(np.linalg.solve(self._information, scaled_information))
            deviations = (moments - self.table.stated) / width
            self._square_deviations = determined * deviations * (self.table.precision @ deviations)
        extra_cost, derivative = self._correct_scale_bias(moments)
        gradient += derivative / 2
        all_residuals = np.concatenate([series[np.isfinite(series)] for series in whitened])
        return LinearisedResiduals(
            information,
            gradient,
            float(all_residuals @ all_residuals),
            all_residuals.size,
            extra_cost=extra_cost,
        )

    def _iterate_derivatives(self) -> Iterator[tuple[IntArray, Array, int, int]]:
        """Yield the derivatives of the predicted positions of each joint in each run.

        Yields:
            Indices of k parameters, derivatives by these parameters, shape (samples, k), joint
            index and run index.
        """
        for run, jacobians in enumerate(self._jacobians):
            for group, (indices, jacobian) in jacobians.items():
                for column, joint in enumerate(self.simulator.groups[group][0]):
                    yield indices, jacobian[:, column], joint, run

    def fit(self) -> Posterior:
        """Estimate the parameters by weighted least squares, and return the distribution.

        The residuals of each joint are divided by the long-run standard deviation of the joint's
        noise. All matrices are in units of the prior widths, shape (n, n) for n parameters:

        - A: information of the measurements, the sum of J^T J with the Jacobian J of the residuals.
        - P: prior precision, the inverse of the prior covariance.
        - B: covariance of J^T r under the autocorrelated noise, with the residuals r.

        The covariance of the parameters is the sandwich estimate (A + P)^-1 (B + P) (A + P)^-1,
        wider if the iteration stalled.

        Raises:
            FitError: If the iteration does not converge, for example.
        """
        moments = self.moments.from_parameters(self.table.stated)
        whole_runs = self.fitted
        shortened_runs = tuple(shorten_run(run, _FIRST_PASS_DURATION) for run in whole_runs)
        for is_second_pass, min_decrease in (
            (False, _FIRST_PASS_MIN_DECREASE),
            (True, _MIN_DECREASE),
        ):
            self._is_autoregressive = is_second_pass
            self.fitted = whole_runs if is_second_pass else shortened_runs
            self._predictor = self.fine_simulator if is_second_pass else self.simulator
            if is_second_pass and shortened_runs != whole_runs:
                self._derivative_point = None  # the derivatives belong to shortened runs
            posterior = estimate_parameters(
                self.table,
                self.linearise,
                moments,
                min_decrease=min_decrease,
                min_relative_decrease=_MIN_RELATIVE_DECREASE,
                stall_rtol=_STALL_RTOL,
            )
            moments = posterior.mean
        width = self.table.width
        gradient_covariance = np.zeros((len(moments), len(moments)))
        for indices, rows, joint, run in self._iterate_derivatives():
            noise = self._noise[joint]
            weighted = np.where(self.fitted[run].counts[:, joint, None], rows, 0.0)
            propagated = noise.propagate_weights(weighted / noise.long_run_std**2)
            gradient_covariance[indices[:, None], indices] += propagated @ propagated.T
        information = posterior.information + posterior.precision
        inverse = np.linalg.inv(information)
        gradient_covariance = width[:, None] * gradient_covariance * width + posterior.precision
        # ``covariance`` includes the unrealised step of the last iteration.
        covariance = posterior.covariance / np.outer(width, width)
        covariance = inverse @ (gradient_covariance - information) @ inverse + covariance
        return self.moments.transform_posterior(posterior, covariance)


# Residuals of a fitted motion as autocorrelated noise.


_MAX_LAGS = 20
"""Order of the autoregressive noise model [samples]: 100 ms at 200 Hz. Chosen, not tuned."""

_MIN_NOISE_STD = 1e-6
"""Lower bound of a noise standard deviation [rad, m], which keeps the weights finite. Commands that
deviate from the mean by at most this value count as constant. Chosen, not tuned.
"""

_SAMPLES_PER_LAG = 20
"""Smallest number of samples per coefficient of the autoregressive noise model. With fewer samples,
the noise is assumed to be white. Chosen, not tuned.
"""


@dataclass(frozen=True, eq=False)
class SeriesNoise:
    """Autoregressive noise model of a joint's residuals: e_k = sum_i c_i e_(k-i) + w_k.

    w is white noise with the standard deviation s. Residuals of a motion are correlated in time: a
    resting encoder repeats the same value, and errors of the model last. A sum over many samples is
    as uncertain as a sum of independent samples with the long-run standard deviation s / (1 - sum
    c).

    Attributes:
        coefficients: Coefficients c, shape (lags,).
        innovation: Standard deviation s of w [rad, m].
        deviation: Standard deviation of e [rad, m].
    """

    coefficients: Array
    innovation: float
    deviation: float

    @staticmethod
    def fit_white(series: Sequence[Array]) -> SeriesNoise:
        """Return white noise with the RMS of given residuals as the standard deviation [rad, m].

        Each series of residuals has the shape (n,) [rad, m]; NaN is ignored. The standard deviation
        is at least ``_MIN_NOISE_STD``.
        """
        deviation = float(np.fmax(compute_rms(series), _MIN_NOISE_STD))  # fmax ignores NaN
        return SeriesNoise(np.zeros(0), deviation, deviation)

    @staticmethod
    def fit_autoregression(series: Sequence[Array]) -> SeriesNoise:
        """Fit autoregressive noise to some residual series by the Yule-Walker equations.

        Each series belongs to a run, and has the shape (n,) [rad, m]; NaN if missing. White noise
        is returned if the samples are too few, for example.
        """
        filled = [np.where(np.isfinite(series_part), series_part, 0.0) for series_part in series]
        count = int(sum(np.isfinite(series_part).sum() for series_part in series))
        white = SeriesNoise.fit_white(series)
        if count < _SAMPLES_PER_LAG * _MAX_LAGS or white.deviation <= _MIN_NOISE_STD:
            return white
        autocovariances = np.array(
            [sum(float(row[lag:] @ row[: max(len(row) - lag, 0)]) for row in filled) / count
             for lag in range(_MAX_LAGS + 1)]
        )  # fmt: skip
        coefficients = solve_toeplitz(autocovariances[:-1], autocovariances[1:])
        variance = max(
            float(autocovariances[0] - coefficients @ autocovariances[1:]), _MIN_NOISE_STD**2
        )
        return SeriesNoise(coefficients, math.sqrt(variance), white.deviation)

    @property
    def long_run_std(self) -> float:
        """Standard deviation of a joint's noise e over long times [rad, m]: s / (1 - sum c).

        The value is at least the standard deviation of e.
        """
        return max(self.innovation / (1 - float(self.coefficients.sum())), self.deviation)

    def propagate_weights(self, weights: Array) -> Array:
        """Return B^T, shape (m, n), of the covariance B^T B of m weighted sums of n noise samples.

        ``weights`` has the shape (n, m).
        """
        filter_coefficients = [1.0, *-self.coefficients]
        return np.asarray(lfilter([self.innovation], filter_coefficients, weights[::-1], axis=0)).T


def compute_rms(series: Iterable[Array]) -> float:
    """Compute the root mean square of all finite values in one or more arrays, in the same unit.

    NaN if there are no finite values.
    """
    values = np.concatenate([array.ravel() for array in series])
    finite_values = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(finite_values**2))) if finite_values.size else math.nan


# Derivatives of predicted motions: differences along uncertain directions.


_DIFFERENCE_STEP = 0.1
"""Finite-difference step along an eigenvector of the information matrix, in posterior standard
deviations along this eigenvector. Measured on v3: with steps of 0.1 to 1, the intervals of the
estimated parameters agree to 1 %.
"""

_INITIAL_DIFFERENCE_STEP = 1e-2
"""Finite-difference step of the first derivatives, in prior standard deviations. The posterior is
not known at that time. Chosen, not tuned.
"""

_BOUNDED_KINDS = ("friction", "armature")
"""Kinds of parameters whose negative values the simulation replaces by 0. Derivatives near 0 are
evaluated at the size of the largest negative finite-difference step."""


def differentiate_motion(
    simulator: Simulator,
    moments: MomentCoordinates,
    run: LogSegment,
    point: Array,
    information: Array | None = None,
) -> Mapping[int, tuple[IntArray, Array]]:
    """Compute the derivatives of predicted joint positions by the parameters of a fit.

    The parameters are first-moment coordinates (`MomentCoordinates`). Joints that affect each other
    form a group. The finite-difference steps are along eigenvectors of the information matrix of a
    group. With steps along single parameters, the intervals were a quarter too narrow. A common
    factor on kp, friction and masses hardly changes the motion, but the errors of single steps add
    up to a false effect of this factor.

    Args:
        simulator: Simulator.
        moments: Conversion of first-moment coordinates to parameters.
        run: Part of a log that is simulated.
        point: First-moment coordinates, shape (n,).
        information: Information of the coordinates, shape (n, n), in units of the prior widths;
            None for steps along single parameters.

    Returns:
        {index of the group in `simulator.groups`: (indices of k parameters, derivatives of shape
        (samples, joints of the group, k) [rad or m per unit of the parameter])}.
    """
    groups, common_parameters = (
        simulator.groups,
        simulator.bodies.find_common_parameters(simulator.table),
    )
    num_turns, width = max(len(columns) for _, columns in groups), simulator.table.width
    changes = np.zeros((num_turns + len(common_parameters), len(point)))
    steps = []
    for columns in (*(columns for _, columns in groups), common_parameters):
        steps.append(_make_steps(columns, information))
        rows = slice(len(columns)) if len(steps) <= len(groups) else slice(num_turns, None)
        changes[rows, columns] = steps[-1]
    changes *= width
    # The simulation replaces negative values by 0, which would spoil the differences.
    is_bounded = [parameter.kind in _BOUNDED_KINDS for parameter in simulator.table]
    point = np.maximum(point, np.where(is_bounded, -changes.min(axis=0), -np.inf))

    vectors = [moments.to_parameters(vector) for vector in (point, *(point + changes))]
    predicted = simulator.predict_positions(run, vectors)
    moved = predicted[1:] - predicted[0]
    derivatives: dict[int, tuple[IntArray, Array]] = {}
    for number, (joints, columns) in enumerate(groups):
        indices = np.array([*columns, *common_parameters], dtype=np.int64)
        by_step = np.moveaxis(moved[:, :, joints], 0, 2)
        jacobians = np.concatenate(
            [
                by_step[..., : len(columns)] @ np.linalg.inv(steps[number]).T,
                by_step[..., num_turns:] @ np.linalg.inv(steps[-1]).T,
            ],
            axis=2,
        )
        derivatives[number] = indices, jacobians / width[indices]
        simulator.replace_lag_derivatives(vectors[0], *derivatives[number])
    return derivatives


def _make_steps(columns: list[int], information: Array | None) -> Array:
    """Return finite-difference steps of k parameters, in units of the prior widths, shape (k, k).

    The rows are along eigenvectors of ``information``, shape (n, n), in the same units, or along
    single parameters without it.
    """
    if information is None:
        return _INITIAL_DIFFERENCE_STEP * np.eye(len(columns))
    values, directions = np.linalg.eigh(information[np.ix_(columns, columns)])
    return np.asarray(_DIFFERENCE_STEP * (directions / np.sqrt(values)).T)
