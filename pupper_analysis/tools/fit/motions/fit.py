"""Motions as measurements: what a log tells of the robot that made it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.base.errors import ConfigurationError, MeasurementError
from pupper_analysis.robot.build import build_robot
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import Servos, model_with_servos
from pupper_analysis.tools.fit.estimate import Posterior
from pupper_analysis.tools.fit.measurements.log import Log
from pupper_analysis.tools.fit.measurements.log_quality import LogQuality, find_quantum, inspect_log
from pupper_analysis.tools.fit.motions.residuals import Motion, root_mean_square
from pupper_analysis.tools.fit.motions.rollouts import (
    SERVOS,
    Run,
    Simulator,
    split_runs,
)
from pupper_analysis.tools.fit.parameters import (
    ParameterTable,
    Prior,
    give_widths,
    parse_priors,
)
from pupper_analysis.tools.fit.result import MotionFit, describe_parameters, find_together

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


Array = NDArray[np.float64]

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
    return _told(motion.simulator.robot, logs, qualities, motion, posterior)


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


def _told(
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
        together=find_together(posterior),
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
    """Yields what else is to be said."""
    if off > before:
        yield diagnose(
            "motion-predicted-worse", now=Quantity(off, "rad"), stated=Quantity(before, "rad")
        )
    there = np.concatenate([run.position for run in motion.runs])
    there = there[np.isfinite(there).all(axis=1)]
    looks = there[:: max(1, len(there) // _LOOKS)]
    touching = motion.simulator.bodies.touching(looks)
    if touching:
        yield diagnose("log-parts-touch", bodies=touching)


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
