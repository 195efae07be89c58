"""Motions as measurements: what a log tells of the robot that made it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

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
from pupper_analysis.tools.fit.estimate import (
    JacobianReuse,
    Linearised,
    Posterior,
    estimate_parameters,
)
from pupper_analysis.tools.fit.measurements.log import Log
from pupper_analysis.tools.fit.measurements.log_quality import LogQuality, find_quantum, inspect_log
from pupper_analysis.tools.fit.motions.rollouts import (
    SERVOS,
    Moments,
    Run,
    Simulator,
    split_runs,
)
from pupper_analysis.tools.fit.parameters import (
    KINDS,
    ParameterTable,
    Prior,
    give_widths,
    parse_priors,
)
from pupper_analysis.tools.fit.result import MotionFit, describe_parameters, find_combinations

Array = NDArray[np.float64]

# How fits of logs begin: a base that is held, and which part of each log is predicted.

HOLD_OUT = 0.2
"""Of each log, at its end: what is predicted, and not fitted."""


def hold_base(robot: Robot) -> Robot:
    """Returns a robot whose base is held where its MJCF has it."""
    return build_robot(robot.description, fixed_base=True) if robot.floating else robot


def share_out(
    logs: Sequence[Log], hold_out: float | Sequence[Log]
) -> tuple[tuple[Log, float], ...]:
    """Returns logs, each with the share at its end that is predicted: 1 of those held out whole.

    Args:
        logs: To be fitted.
        hold_out: A share of each, or logs beside them that are not fitted.

    Raises:
        ConfigurationError: If it is no share.
    """
    if not isinstance(hold_out, int | float):
        return (*((log, 0.0) for log in logs), *((log, 1.0) for log in hold_out))
    if not 0 <= hold_out < 1:
        raise ConfigurationError("hold_out", diagnose("not-between", given=hold_out, low=0, high=1))
    return tuple((log, float(hold_out)) for log in logs)


_STEP_ERROR = 0.3
"""What finer steps of the simulation change, in parts of what is left: with more, derivatives by
coarse ones are those of another robot."""

_LOOKS = 200
"""Postures of a log in which parts are looked at that may touch."""

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
        priors: What is known before; as for ``fit_stands``.
        hold_out: The share of each log, at its end, that is predicted instead of fitted; or logs
            that are.
        kp: Stated stiffness of the servos (N m/rad), one or (nu,); the model's own by default.
        kd: Stated damping (N m s/rad); likewise.

    Raises:
        ConfigurationError: If an argument is out of its range.
        FitError: If it does not converge.
        MeasurementError: If a log is none of this robot's, or nothing can be made of it; if no file
            states gains of its servos, and none are given.
        ModelError: If the model has motors that are no servos, and no gains are given.
        UnknownNameError: If a log has joints that the robot has not.
    """
    motion, qualities = begin_motion(robot, logs, priors, hold_out, kp, kd)
    posterior = motion.fit()
    while motion.step_error(posterior.mean) > _STEP_ERROR:
        motion = motion.with_steps(2 * motion.simulator.steps)
        posterior = motion.fit(posterior.mean)
    return _report_motions(motion.simulator.robot, logs, qualities, motion, posterior)


def begin_motion(
    robot: Robot,
    logs: Sequence[Log],
    priors: Sequence[Prior | str],
    hold_out: float | Sequence[Log],
    kp: ArrayLike | None,
    kd: ArrayLike | None,
) -> tuple[Motion, tuple[LogQuality, ...]]:
    """Returns logs beside simulations of the same robot, and what the logs are.

    The arguments, and what is raised, are those of ``fit_motion``.
    """
    known = parse_priors(priors)
    robot, shared = hold_base(robot), share_out(logs, hold_out)
    drive = model_with_servos(robot, kp, kd)
    if kp is None or kd is None:
        _check_gains(robot, [log for log, _ in shared])
    qualities = tuple(inspect_log(robot, log, drive.kp) for log, _ in shared)
    runs: list[Run] = []
    for (log, share), quality in zip(shared, qualities, strict=True):
        runs += split_runs(log.of(robot), quality.jumps, robot.home, share)
    _check(robot, drive, logs, runs)
    table = _parameters(robot, drive, qualities, known)
    interval = float(np.median([quality.interval for quality in qualities]))
    return Motion(Simulator(robot, drive, table, interval), runs), qualities


def _check_gains(robot: Robot, logs: Sequence[Log]) -> None:
    """Checks that files state the gains of servos that moved: those made to stand are no one's.

    Raises:
        MeasurementError: If not.
    """
    made = {servo.joint for servo in robot.description.made_servos}
    for log in logs:
        lacking = [name for name in log.joints if name in made]
        if lacking:
            raise MeasurementError(log.source, diagnose("command-without-gains", joints=lacking))


def _check(robot: Robot, drive: Servos, logs: Sequence[Log], runs: Sequence[Run]) -> None:
    """Checks that there is something to fit, and that what moves is driven by a servo.

    Raises:
        MeasurementError: If not.
    """
    if not runs or not any(run.counts.any() for run in runs):
        source = logs[0].source if logs else robot.name
        raise MeasurementError(source, diagnose("nothing-to-fit"))
    for log in logs:
        for name in log.joints:
            joint = robot.joint_names.index(name)
            commanded = np.isfinite(log.command[:, log.joints.index(name)]).any()
            if not commanded or drive.kp[joint] <= 0:
                raise MeasurementError(log.source, diagnose("joint-without-servo", joint=name))


def _parameters(
    robot: Robot, drive: Servos, qualities: Sequence[LogQuality], priors: Sequence[Prior]
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


def _report_motions(
    robot: Robot,
    logs: Sequence[Log],
    qualities: tuple[LogQuality, ...],
    motion: Motion,
    posterior: Posterior,
) -> MotionFit:
    """Returns a fit with how far its predictions are from what was measured."""
    off = {}
    for name, x in (("before", motion.table.stated), ("after", posterior.mean)):
        found = [motion.finer.predict(run, [x])[0] - run.position for run in motion.runs]
        off[name] = [
            [np.where(getattr(run, part), one, np.nan) for run, one in zip(motion.runs, found)]  # noqa: B905
            for part in ("counts", "held_out")
        ]
    fitted, held_out = off["after"]
    shown = held_out if np.isfinite(root_mean_square(held_out)) else fitted
    by_joint = np.array(
        [root_mean_square(one[:, joint] for one in shown) for joint in range(robot.nu)]
    )
    noise = np.array(
        [
            _encoder_noise([run.position[:, joint] for run in motion.runs])
            for joint in range(robot.nu)
        ]
    )
    names, before = robot.joint_names, root_mean_square(off["before"][shown is held_out])
    return MotionFit(
        name=robot.name,
        source=", ".join(log.source for log in logs),
        estimates=tuple(describe_parameters(posterior)),
        combinations=find_combinations(posterior),
        failures=tuple(_unexplained(robot, by_joint, noise, root_mean_square(shown))),
        diagnostics=(
            *(one for quality in qualities for one in quality.diagnostics),
            *_notes(motion, root_mean_square(shown), before),
        ),
        posterior=posterior,
        seconds=sum(log.duration for log in logs),
        held_out=root_mean_square(held_out),
        held_out_before=root_mean_square(off["before"][1]),
        fitted=root_mean_square(fitted),
        fitted_before=root_mean_square(off["before"][0]),
        repeatability=_repeatability(motion.runs),
        by_joint=dict(zip(names, by_joint.tolist(), strict=True)),
        encoder_noise=dict(zip(names, noise.tolist(), strict=True)),
        steps=motion.finer.steps,
    )


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


def _notes(motion: Motion, off: float, before: float) -> Iterator[Diagnostic]:
    if off > before:
        yield diagnose(
            "motion-predicted-worse", now=Quantity(off, "rad"), stated=Quantity(before, "rad")
        )
    alike = replayed(motion.runs)
    if alike > _REPLAY:
        yield diagnose("held-out-is-a-replay", correlation=alike)
    there = np.concatenate([run.position for run in motion.runs])
    there = there[np.isfinite(there).all(axis=1)]
    seen = there[:: max(1, len(there) // _LOOKS)]
    touching = motion.simulator.bodies.touching(seen)
    if touching:
        yield diagnose("log-parts-touch", bodies=touching)


_REPLAY = 0.95
"""Correlation of what was held out with something that was fitted: logs of one motion, started
anew, have 0.99 and more; another motion of the same joints hardly 0.5."""


def replayed(runs: Sequence[Run]) -> float:
    """Returns how alike what was held out is to what was fitted, by its commands, wherever it was.

    The greatest correlation of the middle half of a held-out part with any part as long of what was
    fitted: logs of one motion are shifted against each other.
    """
    most = 0.0
    fitted = [run.command[run.counts.any(axis=1)] for run in runs]
    for run in runs:
        part = run.command[run.held_out.any(axis=1)]
        part = part[len(part) // 4 : len(part) - len(part) // 4]
        if not len(part):
            continue
        wanted = part - part.mean(axis=0)
        for base in fitted:
            if len(base) < len(part) or not wanted.any():
                continue
            moved = base - base.mean(axis=0)
            ones = np.ones((len(part), 1))
            alike = fftconvolve(moved, wanted[::-1], "valid", axes=0).sum(axis=1)
            mean = fftconvolve(moved, ones, "valid", axes=0) / len(part)
            energy = (fftconvolve(moved**2, ones, "valid", axes=0) - len(part) * mean**2).sum(
                axis=1
            )
            least = _LEAST**2 * len(part)
            size = np.sqrt(np.maximum(energy, least) * (wanted**2).sum())
            most = max(most, float((alike / size).max()))
    return most


def _encoder_noise(series: Sequence[Array]) -> float:
    """Returns the standard deviation of what no motion is, by third differences.

    Of noise without memory their variance is 20 times its own; a motion of some Hz has hardly any.
    By their median, as joints that are kicked by a new command have for a moment; and no less than
    the encoder's quantum makes.
    """
    steps = np.concatenate([np.abs(np.diff(one, 3)) for one in series])
    steps = steps[np.isfinite(steps)]
    quantum = max(find_quantum(one) for one in series)
    if not steps.size:
        return math.nan
    return max(float(np.median(steps)) / _MEDIAN / math.sqrt(20.0), quantum / math.sqrt(12.0))


_MEDIAN = 0.6744897501960817
"""Of the magnitude of a normal number of deviation 1."""


def _repeatability(runs: Sequence[Run]) -> float:
    """Returns how far positions are from their mean over runs of the same commands (rad)."""
    off: list[Array] = []
    alike: list[list[Run]] = []
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
    return root_mean_square(off) if off else math.nan


_SAME_COMMAND = 1e-6
"""rad: commands that differ by no more are the same."""


IntArray = NDArray[np.int64]

_ROUNDS = 4
"""Of fits, each with the noise that the one before has left."""

_SAME_NOISE = 0.05
"""Of deviations: noise that changes by no more changes no interval that is shown."""

_ENOUGH = 0.04
"""Of the cost: a fifth of a standard deviation, by which an interval is 2 % too narrow."""

_ROUGHLY = 1.0
"""Of the cost: a standard deviation, which is near enough while the noise is another."""

_GLANCED = 1e-4
"""Of the cost: near enough while noise is not known, as it is some times what it begins with."""

_GLANCE = 12.0
"""s of motion that are fitted first: from there a step or two are left for all of it."""

_DRAWS = 12
"""Of parameters, each with its opposite: by them a deviation that bends is known to a sixth."""

_FINER = 4
"""Times the steps of what derivatives are made with has what is compared with measurements: its
error, that of dry friction, falls with the square. Derivatives are right to 1 % without."""

_MOST_STEPS = 16
"""Between two samples: 0.3 ms at 200 Hz. What changes still is an impact, and not the step."""


class Motion:
    """Measured and simulated runs, and how far they are apart.

    Fine steps predict; coarse ones, of which there are thirty for one, make derivatives.

    Args:
        simulator: Simulates them.
        runs: As they were measured.
        known: (n, n) what is known of moments before these runs, in the priors' widths.
    """

    def __init__(
        self, simulator: Simulator, runs: Sequence[Run], known: Array | None = None
    ) -> None:
        self.simulator, self.runs, self.table = simulator, tuple(runs), simulator.table
        self.fitted = tuple(run for run in runs if run.counts.any())
        self.moments = Moments(self.table)
        self.positive = np.array([KINDS[one.kind].positive for one in self.table], dtype=bool)
        self._noise: tuple[SeriesNoise, ...] = ()
        self._last: tuple[Array, list[Array]] | None = None
        self._jacobians: list[Mapping[int, tuple[IntArray, Array]]] = []
        self._dear, self._known = JacobianReuse(self.renew), known
        self.finer = simulator.with_steps(_FINER * simulator.steps)

    def residuals(self, x: Array) -> list[Array]:
        """Returns predicted less measured positions (n, nu) of each run that is fitted (rad)."""
        if self._last is None or not np.array_equal(self._last[0], x):
            found = [
                self.finer.predict(run, [x])[0] - np.where(run.counts, run.position, np.nan)
                for run in self.fitted
            ]
            self._last = x.copy(), found
        return self._last[1]

    def renew(self, moments: Array) -> None:
        """Makes derivatives of predicted positions by moments (n,), as they are there."""
        known = self.known
        self._jacobians = [
            differentiate(self.simulator, self.moments, run, moments, known) for run in self.fitted
        ]

    @property
    def known(self) -> Array | None:
        """(n, n) what is known of moments by now, in the priors' widths; None before all."""
        if self._last is None or not self._jacobians:
            return self._known
        finding = _Lazy(self._last[1], self._jacobians, self._noise, self.simulator.groups)
        width = self.table.width
        found: Array = width[:, None] * finding.information * width + self.table.precision
        return found

    def linearise(self, moments: Array, _about: Array) -> Linearised:
        """Returns whitened residuals as sums; these are made when they are asked for."""
        left = self.residuals(self.moments.to_parameters(moments))
        return _Lazy(left, self._jacobians, self._noise, self.simulator.groups)  # type: ignore[return-value]

    def with_steps(self, steps: int) -> Motion:
        """Returns the same with other steps of the simulation between two samples."""
        return Motion(self.simulator.with_steps(steps), self.runs, self.known)

    def step_error(self, x: Array) -> float:
        """Returns what finer steps change, in parts of what is left (root mean squares)."""
        if self.simulator.steps >= _MOST_STEPS:
            return 0.0
        run = self.fitted[0].until(_GLANCE)
        change = self.finer.predict(run, [x])[0] - self.simulator.predict(run, [x])[0]
        return root_mean_square([np.where(run.counts, change, np.nan)]) / root_mean_square(
            self.residuals(x)
        )

    def fit(self, start: Array | None = None, *, near: bool = True) -> Posterior:
        """Returns the parameters, with the noise that they leave.

        They are those of least squares, in which each joint counts by its noise's long-run
        deviation. Their covariance is that which noise with its memory gives such parameters
        ("sandwich"): for H = A + 1, in the priors' widths, H^-1 (B + 1) H^-1, where B is the
        covariance of the gradient.

        Args:
            start: To begin with; by default what suits the first seconds.
            near: Whether what it leaves is noise, rather than motion.

        Raises:
            FitError: If it does not converge.
        """
        first = self._glance(start) if start is None or not near else None
        x = start if first is None else first
        begin = self.moments.of_parameters(self.table.stated if x is None else x)
        posterior = self._descend(
            begin, _ROUNDS, near=first is not None or (near and start is not None)
        )
        return self._with_memory(posterior)

    def _descend(self, y: Array, rounds: int, *, near: bool) -> Posterior:
        """Returns the most probable moments, in rounds with the noise that the one before has left.

        Args:
            y: (n,) moments to begin with.
            rounds: How many at most; the last is the one that ends where it should.
            near: Whether what is left at first is noise, rather than motion.
        """
        for turn in range(rounds):
            left, before = self.residuals(self.moments.to_parameters(y)), self._noise
            self._noise = tuple(
                SeriesNoise.of([one[:, joint] for one in left])
                if turn or near
                else SeriesNoise.white(root_mean_square(one[:, joint] for one in left))
                for joint in range(left[0].shape[1])
            )
            last = turn == _ROUNDS - 1 or (turn > 0 and _alike(before, self._noise))
            rough = _ROUGHLY if turn or near else _GLANCED * sum(one.size for one in left)
            posterior = estimate_parameters(
                self.table,
                self.linearise,
                y,
                enough=_ENOUGH if last else rough,
                jacobian=self._dear,
            )
            y = posterior.mean
            # What led nowhere leads nowhere with a noise that is hardly another.
            if last or (turn and posterior.open_step is not None):
                break
        return posterior

    def _with_memory(self, posterior: Posterior) -> Posterior:
        """Returns the same with the covariance that the noise's memory makes."""
        size, width = len(self.table), self.table.width
        spread = np.zeros((size, size))
        groups = self.simulator.groups
        for run, jacobians in zip(self.fitted, self._jacobians, strict=True):
            for number, (places, by_places) in jacobians.items():
                for at, joint in enumerate(groups[number][0]):
                    noise = self._noise[joint]
                    counted = np.where(run.counts[:, joint, None], by_places[:, at], 0.0)
                    back = noise.spread(counted / noise.long_run**2)
                    spread[places[:, None], places] += back @ back.T
        narrow = np.linalg.inv(posterior.information + posterior.precision)
        spread = width[:, None] * spread * width + posterior.precision
        covariance = narrow @ spread @ narrow
        if posterior.open_step is not None:
            open_step = posterior.open_step / width
            covariance += np.outer(open_step, open_step)
        bends = self._bends(posterior, covariance)
        return self.moments.of_posterior(posterior, posterior.mean, covariance, bends)

    def _bends(self, posterior: Posterior, covariance: Array) -> Array:
        """Returns how far parameters are from where straight lines lead (draws, n), in widths.

        Moments are drawn as they are known. What measurements do not tell takes what they do with
        it where that bends: an armature is determined with the inertia of its link, which goes with
        the square of a com. So each draw is led back to what suits the measurements, by one step
        with the same derivatives.

        Args:
            posterior: The moments.
            covariance: (n, n) of these, in the priors' widths.
        """
        width, size = self.table.width, len(self.table)
        drawn = np.random.default_rng(0).multivariate_normal(
            np.zeros(size), covariance, _DRAWS, method="eigh"
        )
        drawn = np.concatenate([drawn, -drawn])
        least = np.where(self.positive, -posterior.mean / width, -np.inf)
        drawn = np.maximum(drawn, least)
        begin = posterior.mean + width * drawn
        gradients = np.zeros((len(drawn), size))
        for run, jacobians in zip(self.fitted, self._jacobians, strict=True):
            vectors = [posterior.mean, *begin]
            found = self.simulator.predict_all(
                run, np.array([self.moments.to_parameters(one) for one in vectors])
            )
            for number, (places, by_places) in jacobians.items():
                for at, joint in enumerate(self.simulator.groups[number][0]):
                    counted = run.counts[:, joint]
                    rows = by_places[counted, at] * width[places]
                    bent = found[1:, counted, joint] - found[0, counted, joint]
                    bent -= drawn[:, places] @ rows.T
                    gradients[:, places] += bent @ rows / self._noise[joint].long_run ** 2
        whole = posterior.information + posterior.precision
        led = np.maximum(drawn - np.linalg.solve(whole, gradients.T).T, least)
        mean = self.moments.to_parameters(posterior.mean)
        turn = self.moments.derivative(posterior.mean) * width / width[:, None]
        off = np.array(
            [self.moments.to_parameters(one) - mean for one in posterior.mean + width * led]
        )
        # What was known before is known still.
        bends: Array = np.clip(off / width - drawn @ turn.T, -1, 1)
        return bends

    def _glance(self, start: Array | None) -> Array | None:
        """Returns parameters that suit the first seconds, where there are many more."""
        left, first = _GLANCE, []
        for run in self.fitted:
            if left > 0:
                first.append(run.until(left))
                left -= float(first[-1].time[-1])
        if sum(len(run.time) for run in first) > 0.7 * sum(len(run.time) for run in self.fitted):
            return None
        if not any(run.counts.any() for run in first):
            return None
        motion = Motion(self.simulator, first)
        begin = motion.moments.of_parameters(self.table.stated if start is None else start)
        found = motion._descend(begin, 2, near=False)
        self._known = motion.known
        return self.moments.to_parameters(found.mean)


class _Lazy:
    """What ``Linearised`` has, but sums are made where they are needed: not of a trial."""

    log_noise = 0.0

    def __init__(
        self,
        left: Sequence[Array],
        jacobians: Sequence[Mapping[int, tuple[IntArray, Array]]],
        noise: tuple[SeriesNoise, ...],
        groups: Sequence[tuple[list[int], list[int]]],
    ) -> None:
        self._jacobians, self._noise, self._groups = jacobians, noise, groups
        self._white = [one / np.array([own.long_run for own in noise]) for one in left]
        finding = [np.isfinite(white) for white in self._white]
        self.rows = int(sum(one.sum() for one in finding))
        self.chi2 = float(sum((white[one] ** 2).sum() for white, one in zip(self._white, finding)))  # noqa: B905
        self._size = 1 + max(int(places.max()) for one in jacobians for places, _ in one.values())

    @cached_property
    def _sums(self) -> tuple[Array, Array]:
        size = self._size
        information, gradient = np.zeros((size, size)), np.zeros(size)
        for white, jacobians in zip(self._white, self._jacobians, strict=True):
            for number, (places, by_places) in jacobians.items():
                for at, joint in enumerate(self._groups[number][0]):
                    finding = np.isfinite(white[:, joint])
                    rows = by_places[finding, at] / self._noise[joint].long_run
                    information[places[:, None], places] += rows.T @ rows
                    gradient[places] += rows.T @ white[finding, joint]
        return information, gradient

    @property
    def information(self) -> Array:
        """(n, n) sum of A^T A."""
        return self._sums[0]

    @property
    def gradient(self) -> Array:
        """(n,) sum of A^T r."""
        return self._sums[1]


def _alike(one: Sequence[SeriesNoise], other: Sequence[SeriesNoise]) -> bool:
    """Says whether two noises of all joints are the same."""
    return all(
        abs(own.long_run / its.long_run - 1) < _SAME_NOISE
        for own, its in zip(one, other, strict=True)
    )


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
    def white(deviation: float) -> SeriesNoise:
        """Returns noise without memory."""
        deviation = max(deviation, _LEAST) if math.isfinite(deviation) else _LEAST
        return SeriesNoise(np.zeros(0), deviation, deviation)

    @staticmethod
    def of(series: Sequence[Array]) -> SeriesNoise:
        """Returns the noise that some series (n,) are; NaN are missing.

        By Yule's and Walker's equations, whose noise never grows; so many lags as Schwarz's
        criterion has worth it.
        """
        filled = [np.where(np.isfinite(one), one, 0.0) for one in series]
        count = int(sum(np.isfinite(one).sum() for one in series))
        if count == 0:
            return SeriesNoise.white(_LEAST)
        moments = np.array(
            [sum(float(one[lag:] @ one[: max(len(one) - lag, 0)]) for one in filled) / count
             for lag in range(_MOST_LAGS + 1)]
        )  # fmt: skip
        deviation = math.sqrt(moments[0])
        best = SeriesNoise.white(deviation)
        if count < _SAMPLES_PER_LAG * _MOST_LAGS or deviation <= _LEAST:
            return best
        least = math.inf
        for lags in range(_MOST_LAGS + 1):
            given = solve_toeplitz(moments[:lags], moments[1 : lags + 1]) if lags else np.zeros(0)
            variance = max(float(moments[0] - given @ moments[1 : lags + 1]), _LEAST**2)
            worth = count * math.log(variance) + lags * math.log(count)
            if worth < least:
                least, best = worth, SeriesNoise(given, math.sqrt(variance), deviation)
        return best

    @property
    def long_run(self) -> float:
        """Standard deviation of independent samples that tell as little; that of e at least."""
        return max(self.innovation / (1 - float(self.coefficients.sum())), self.deviation)

    def spread(self, weights: Array) -> Array:
        """Returns B^T with B^T B the covariance of sums of the noise with weights (n, m): (m, n).

        The noise is w through a filter; so its sums are those of w with the weights through the
        filter backwards.
        """
        back = lfilter([self.innovation], [1.0, *-self.coefficients], weights[::-1], axis=0)
        turned: Array = back.T
        return turned


def root_mean_square(series: Iterable[Array]) -> float:
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


def differentiate(
    simulator: Simulator,
    moments: Moments,
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
    groups, shared = simulator.groups, simulator.bodies.shared(simulator.table)
    turns, width = max(len(columns) for _, columns in groups), simulator.table.width
    changes = np.zeros((turns + len(shared), len(at)))
    steps = []
    for columns in (*(own for _, own in groups), shared):
        steps.append(_steps(columns, known))
        rows = slice(len(columns)) if len(steps) <= len(groups) else slice(turns, None)
        changes[rows, columns] = steps[-1]
    changes *= width

    vectors = [moments.to_parameters(one) for one in (at, *(at + changes))]
    predicted = simulator.predict_all(run, np.array(vectors))
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
    return found


def _steps(columns: list[int], known: Array | None) -> Array:
    """Returns steps (rows) of some parameters in their priors' widths."""
    if known is None:
        return _FIRST_STEP * np.eye(len(columns))
    values, directions = np.linalg.eigh(known[np.ix_(columns, columns)])
    steps: Array = _STEP * (directions / np.sqrt(values)).T
    return steps
