"""Motions as measurements: what a log tells of the robot that made it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.errors import FitError, MeasurementError
from pupper_analysis.fit.estimate import Linearised, Posterior, estimate_parameters
from pupper_analysis.fit.log import Log
from pupper_analysis.fit.log_quality import LogQuality, inspect_log
from pupper_analysis.fit.noise import SeriesNoise
from pupper_analysis.fit.parameters import ParameterTable, Prior, give_widths
from pupper_analysis.fit.rollouts import SERVOS, Run, Simulator, split_runs
from pupper_analysis.robot.build import build_robot
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import Servos, model_with_servos

Array = NDArray[np.float64]

HOLD_OUT = 0.2
"""Of each log, at its end: what is predicted, and not fitted."""

_ROUNDS = 4
"""Of fits, each with the noise that the one before has left; the last two differ by a hundredth."""

_SAME_NOISE = 0.02
"""Of deviations: what is left does not change by more when the noise is that of the round before."""

_NEAR = 0.1
"""Of the priors' widths: so far derivatives of a motion are the same within some percent. Steps with
those converge to the same within so many percent of a standard deviation."""

_GLANCE = 12.0
"""s of motion that are fitted first: from there a step or two are left for all of it."""

_MISFIT = 2.0
"""What is left, in parts of an encoder's noise, from which a model does not explain a motion."""


@dataclass(frozen=True, eq=False)
class MotionFit:
    """What logs tell of a robot's parameters.

    Attributes:
        robot: Its base is held.
        drive: Its servos.
        qualities: What the logs are.
        posterior: The parameters, and how sure.
        held_out: Root mean square of what is off in motions that were not fitted (rad); NaN if
            there are none.
        held_out_before: The same with the file's own numbers (rad).
        fitted: The same in motions that were fitted (rad).
        fitted_before: With the file's own numbers (rad).
        repeatability: How far the robot itself is from its mean over runs of the same commands
            (rad, root mean square); NaN if no two are the same.
        by_joint: (nu,) what is off in motions that were not fitted, or of those that were (rad).
        encoder_noise: (nu,) of the encoders (rad).
        steps: Of the simulation between two samples.
        diagnostics: What is to be said.
    """

    robot: Robot
    drive: Servos
    qualities: tuple[LogQuality, ...]
    posterior: Posterior
    held_out: float
    held_out_before: float
    fitted: float
    fitted_before: float
    repeatability: float
    by_joint: Array
    encoder_noise: Array
    steps: int
    diagnostics: tuple[Diagnostic, ...]


def fit_motion(
    robot: Robot,
    logs: Sequence[Log],
    *,
    priors: Iterable[Prior] = (),
    hold_out: float | Sequence[Log] = HOLD_OUT,
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
        priors: What is known of parameters before; others have their kind's.
        hold_out: The share of each log, at its end, that is predicted instead of fitted; or logs
            that are.
        kp: Stated stiffness of the servos (N m/rad), one or (nu,); the model's own by default.
        kd: Stated damping (N m s/rad); likewise.

    Raises:
        ConfigurationError: If an argument is out of its range.
        FitError: If it does not converge.
        MeasurementError: If a log is none of this robot's, or nothing can be made of it.
        ModelError: If the model has no servos and no gains are given.
        UnknownNameError: If a log has joints that the robot has not.
    """
    if robot.floating:
        robot = build_robot(robot.description, fixed_base=True)
    drive = model_with_servos(robot, kp, kd)
    share = hold_out if isinstance(hold_out, int | float) else 0.0
    others = () if isinstance(hold_out, int | float) else tuple(hold_out)
    qualities = tuple(inspect_log(robot, log, drive.kp) for log in (*logs, *others))
    runs: list[Run] = []
    for number, (log, quality) in enumerate(zip((*logs, *others), qualities, strict=True)):
        whole = 1.0 if number >= len(logs) else share
        runs += split_runs(log.of(robot), quality.jumps, robot.home, whole)
    _check(robot, drive, logs, runs)
    table = _parameters(robot, drive, qualities, tuple(priors))
    interval = float(np.median([quality.interval for quality in qualities]))
    simulator = Simulator(robot, drive, table, interval)
    motion = Motion(simulator, runs)
    posterior = motion.fit()
    return _told(robot, drive, qualities, motion, posterior)


def _check(robot: Robot, drive: Servos, logs: Sequence[Log], runs: Sequence[Run]) -> None:
    """Checks that there is something to fit, and that what moves is driven by a servo.

    Raises:
        MeasurementError: If not.
    """
    if not runs or not any(run.counts.any() for run in runs):
        raise MeasurementError(logs[0].source, diagnose("nothing-to-fit"))
    for log in logs:
        for name in log.joints:
            joint = robot.joint_names.index(name)
            commanded = np.isfinite(log.command[:, log.joints.index(name)]).any()
            if not commanded or drive.kp[joint] <= 0:
                raise MeasurementError(log.source, diagnose("joint-without-servo", joint=name))


def _parameters(
    robot: Robot, drive: Servos, qualities: Sequence[LogQuality], priors: tuple[Prior, ...]
) -> ParameterTable:
    """Returns what is estimated: of joints that are in a log, and of the links that they move.

    Damping of a servo and of its joint do the same: the joint's is estimated, kd if a prior says.
    """
    bodies = Simulator(robot, drive, ParameterTable(()), 1.0, 1).bodies
    model, dofs = bodies.model, robot.mj_convention.qvel_index
    named = {name for quality in qualities for name in quality.joints}
    wanted: list[tuple[str, str, str, float]] = []
    kinds = {
        "kp": drive.kp,
        "kd": drive.kd,
        "damping": model.dof_damping[dofs],
        "friction": model.dof_frictionloss[dofs],
        "armature": model.dof_armature[dofs],
        "offset": np.zeros(robot.nu),
    }
    if not any(prior.kind == "kd" for prior in priors):
        del kinds["kd"]
    for joint, name in enumerate(robot.joint_names):
        if name in named:
            wanted += [(kind, name, "", float(values[joint])) for kind, values in kinds.items()]
    for joint, (name, link) in enumerate(zip(robot.joint_names, bodies.links, strict=True)):
        if name in named and bodies.mass[joint] > 0:
            wanted.append(("mass", link, "", float(bodies.mass[joint])))
            wanted += [
                ("com", link, axis, float(bodies.com[joint, at])) for at, axis in enumerate("xyz")
            ]
    wanted.append(("delay", SERVOS, "", 0.0))
    return ParameterTable(give_widths(wanted, priors))


class Motion:
    """Measured and simulated runs, and how far they are apart.

    Args:
        simulator: Simulates them.
        runs: As they were measured.
    """

    def __init__(self, simulator: Simulator, runs: Sequence[Run]) -> None:
        self.simulator, self.runs, self.table = simulator, tuple(runs), simulator.table
        self.fitted = tuple(run for run in runs if run.counts.any())
        self._noise: tuple[SeriesNoise, ...] = ()
        self._last: tuple[Array, list[Array]] | None = None
        self._slopes: tuple[Array, list[dict[int, tuple[Array, Array]]]] | None = None

    def residuals(self, x: Array) -> list[Array]:
        """Returns predicted less measured positions (n, nu) of each run that is fitted (rad)."""
        if self._last is None or not np.array_equal(self._last[0], x):
            found = [
                self.simulator.predict(run, [x])[0] - np.where(run.counts, run.position, np.nan)
                for run in self.fitted
            ]
            self._last = x.copy(), found
        return self._last[1]

    def slopes(self, x: Array) -> list[dict[int, tuple[Array, Array]]]:
        """Returns derivatives of predicted positions of each run, from parameters near by."""
        width = self.table.width
        if self._slopes is None or np.abs((x - self._slopes[0]) / width).max() > _NEAR:
            found = []
            for run, left in zip(self.fitted, self.residuals(x), strict=True):
                measured = np.where(run.counts, run.position, 0.0)
                here = np.where(run.counts, left + measured, np.nan)
                here = self.simulator.predict(run, [x])[0] if np.isnan(here).any() else here
                found.append(dict(self.simulator.jacobian(run, x, here)))
            self._slopes = x.copy(), found
        return self._slopes[1]

    def linearise(self, x: Array, _about: Array) -> Linearised:
        """Returns whitened residuals as sums; derivatives are made when they are asked for."""
        return _Lazy(self, x.copy(), self._noise)  # type: ignore[return-value]

    def fit(self) -> Posterior:
        """Returns the parameters, with the noise that they leave.

        Raises:
            FitError: If it does not converge.
        """
        x = self._glance()
        left = self.residuals(x)
        # At first without memory, as what is left is no noise yet.
        self._noise = tuple(
            SeriesNoise.white(_rms([one[:, joint] for one in left]))
            for joint in range(left[0].shape[1])
        )
        for _ in range(_ROUNDS):
            posterior = estimate_parameters(self.table, self.linearise, x)
            x = posterior.mean
            before = np.array([one.deviation for one in self._noise])
            left = self.residuals(x)
            self._noise = tuple(
                SeriesNoise.of([one[:, joint] for one in left]) for joint in range(len(before))
            )
            now = np.array([one.deviation for one in self._noise])
            if np.abs(now / before - 1).max() < _SAME_NOISE:
                return posterior
        return estimate_parameters(self.table, self.linearise, x)


    def _glance(self) -> Array:
        """Returns parameters that suit the first seconds, where there are many more."""
        left, first = _GLANCE, []
        for run in self.fitted:
            if left > 0:
                first.append(run.until(left))
                left -= float(first[-1].time[-1])
        if sum(len(run.time) for run in first) > 0.7 * sum(len(run.time) for run in self.fitted):
            return self.table.stated.copy()
        if not any(run.counts.any() for run in first):
            return self.table.stated.copy()
        return Motion(self.simulator, first).fit().mean


class _Lazy:
    """What ``Linearised`` has, but derivatives are made where they are needed: not of a trial."""

    log_noise = 0.0

    def __init__(self, motion: Motion, x: Array, noise: tuple[SeriesNoise, ...]) -> None:
        self._motion, self._x, self._noise = motion, x, noise
        self._white = [
            np.column_stack([one.whiten(left[:, joint]) for joint, one in enumerate(noise)])
            for left in motion.residuals(x)
        ]
        told = [np.isfinite(white) for white in self._white]
        self.rows = int(sum(one.sum() for one in told))
        self.chi2 = float(sum((white[one] ** 2).sum() for white, one in zip(self._white, told)))  # noqa: B905

    @cached_property
    def _sums(self) -> tuple[Array, Array]:
        size = len(self._motion.table)
        information, gradient = np.zeros((size, size)), np.zeros(size)
        groups = self._motion.simulator.groups
        for white, slopes in zip(self._white, self._motion.slopes(self._x), strict=True):
            for number, (places, by_places) in slopes.items():
                for at, joint in enumerate(groups[number][0]):
                    told = np.isfinite(white[:, joint])
                    rows = self._noise[joint].whiten(by_places[:, at])[told]
                    information[np.ix_(places, places)] += rows.T @ rows
                    gradient[places] += rows.T @ white[told, joint]
        return information, gradient

    @property
    def information(self) -> Array:
        """(n, n) sum of A^T A."""
        return self._sums[0]

    @property
    def gradient(self) -> Array:
        """(n,) sum of A^T r."""
        return self._sums[1]


def _rms(series: Iterable[Array]) -> float:
    """Returns the root mean square of what is not NaN; NaN of nothing."""
    whole = np.concatenate([one.ravel() for one in series])
    told = whole[np.isfinite(whole)]
    return float(np.sqrt(np.mean(told**2))) if told.size else math.nan


def _told(
    robot: Robot,
    drive: Servos,
    qualities: tuple[LogQuality, ...],
    motion: Motion,
    posterior: Posterior,
) -> MotionFit:
    """Returns a fit with how far its predictions are from what was measured."""
    off = {}
    for name, x in (("before", motion.table.stated), ("after", posterior.mean)):
        found = [motion.simulator.predict(run, [x])[0] - run.position for run in motion.runs]
        off[name] = [
            [np.where(getattr(run, part), one, np.nan) for run, one in zip(motion.runs, found)]  # noqa: B905
            for part in ("counts", "held_out")
        ]
    fitted, held_out = off["after"]
    shown = held_out if np.isfinite(_rms(held_out)) else fitted
    by_joint = np.array([_rms(one[:, joint] for one in shown) for joint in range(robot.nu)])
    noise = np.array(
        [_encoder_noise([run.position[:, joint] for run in motion.runs]) for joint in range(robot.nu)]
    )
    whole = MotionFit(
        robot=robot,
        drive=drive,
        qualities=qualities,
        posterior=posterior,
        held_out=_rms(held_out),
        held_out_before=_rms(off["before"][1]),
        fitted=_rms(fitted),
        fitted_before=_rms(off["before"][0]),
        repeatability=_repeatability(motion.runs),
        by_joint=by_joint,
        encoder_noise=noise,
        steps=motion.simulator.steps,
        diagnostics=(),
    )
    return whole


def _encoder_noise(series: Sequence[Array]) -> float:
    """Returns the standard deviation of what no motion is, by third differences.

    Of noise without memory their variance is 20 times its own; a motion of some Hz has none.
    """
    return _rms([np.diff(one, 3) for one in series]) / math.sqrt(20.0)


def _repeatability(runs: Sequence[Run]) -> float:
    """Returns how far positions are from their mean over runs of the same commands (rad)."""
    off, alike = [], []
    for run in runs:
        for group in alike:
            count = min(len(run.time), len(group[0].time))
            one, other = run.command[:count], group[0].command[:count]
            if count > len(run.time) / 2 and np.allclose(one, other, rtol=0, atol=_SAME_COMMAND):
                group.append(run)
                break
        else:
            alike.append([run])
    for group in alike:
        if len(group) > 1:
            count = min(len(run.time) for run in group)
            stacked = np.array([run.position[:count] for run in group])
            share = math.sqrt((len(group) - 1) / len(group))  # the mean is of the same runs
            off.append((stacked - stacked.mean(axis=0)) / share)
    return _rms(off) if off else math.nan


_SAME_COMMAND = 1e-6
"""rad: commands that differ by no more are the same."""
