"""Torques as measurements: what a log in which they were measured tells of the robot."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.arguments import check_arguments
from pupper_analysis.arrays import inertia_entries
from pupper_analysis.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.errors import ConfigurationError, MeasurementError
from pupper_analysis.identification.estimate import NORMAL_95, Posterior
from pupper_analysis.identification.held_out import HOLD_OUT, hold_base, share_out
from pupper_analysis.identification.links import AXES
from pupper_analysis.identification.measurements.log import Log
from pupper_analysis.identification.measurements.log_quality import LogQuality, inspect_log
from pupper_analysis.identification.noise import root_mean_square
from pupper_analysis.identification.parameters import (
    KINDS,
    ParameterTable,
    Prior,
    give_widths,
    parse_priors,
)
from pupper_analysis.identification.result import describe_parameters
from pupper_analysis.identification.told import find_together
from pupper_analysis.identification.torques.blocks import MeasuredTorques, measure_torques
from pupper_analysis.identification.torques.couplings import (
    Coupling,
    coupling_rows,
    parse_coupling,
)
from pupper_analysis.identification.torques.doubts import check_positions_are_new, why_nothing
from pupper_analysis.identification.torques.equations import ENTRIES, OF_JOINTS
from pupper_analysis.identification.torques.estimate import TORQUES, Torques
from pupper_analysis.identification.torques.result import TorqueFit
from pupper_analysis.robot.robot import Robot

Array = NDArray[np.float64]

_ROUNDS = 5
"""Of fits, each with torques as late as the one before has found them; two or three as a rule."""

_SAME_LAG = 1e-3
"""s: in a millisecond no torque changes but in proportion to time."""

_MOST_LAG = 0.1
"""s: what is later was never put on one clock."""

_LACKS = 0.2
"""Of a joint's torque: what a model leaves, beyond the sensor's noise, that it does not explain.
Columns that are swapped leave most of it, and a wrist whose torque is nearly all friction as much
as this where its friction is none of Coulomb's (Staubli's TX40)."""

_AGAINST = -0.3
"""Correlation of a measured torque with that of the file's own numbers, from which on it pulls the
other way: where a file is wrong there is little of it, and not the opposite."""

_HARDLY = 0.1
"""Of a measured torque: where the file's own numbers make less, as friction is the rest, they do
not tell which way it is."""

_GAIN, _SURE = 0.03, 4.0
"""Of a torque, and standard deviations: by so much a gain differs that is to be told. Constants of
motors are as good as that, and friction that is none of Coulomb's looks like a percent."""

_TOLD = 1.0
"""Of a direction's information in the priors' widths: measurements tell it as well as these."""


@check_arguments
def fit_torques(
    robot: Robot,
    logs: Sequence[Log],
    *,
    priors: Sequence[Prior | str] = (),
    hold_out: float | Sequence[Log] = HOLD_OUT,
    couplings: Sequence[Coupling | str] = (),
) -> TorqueFit:
    """Estimates a robot's numbers from torques that were measured while it moved.

    The robot is bolted down, or hangs. Velocities and accelerations are those of its encoders,
    filtered without a lag where they are louder than noise; torques are linear in masses, first
    and second moments, dry and viscous friction, armature and a sensor's bias, with Pinocchio's
    joint-torque regressor. Equations are means over windows in which a joint turns one way. What is
    left is taken for noise with a memory, of all joints together.

    Args:
        robot: The robot; a free base is held where its MJCF has it.
        logs: Of its motions; each joint with its position and torque (at the joint: after the
            gear).
        priors: What is known before; as for ``fit_stands``. Of friction, damping, armature and
            bias nothing is known by default, but that they make no more than the whole torque.
        hold_out: The share of each log, at its end, that is predicted instead of fitted; or logs
            that are.
        couplings: Motors that turn with several joints and have friction of their own, as
            ``motor_6=joint_5+joint_6`` of a wrist whose sixth motor turns with both.

    Raises:
        ConfigurationError: If an argument is out of its range.
        FitError: If it does not converge.
        MeasurementError: If a log is none of this robot's, has no torques, or no motion.
        UnknownNameError: If a log has joints that the robot has not.
    """
    known = parse_priors(priors)
    robot, shared = hold_base(robot), share_out(logs, hold_out)
    qualities = tuple(inspect_log(robot, log) for log, _ in shared)
    for log, _ in shared:
        for at, name in enumerate(log.joints):
            if log.torque is None or not np.isfinite(log.torque[:, at]).any():
                raise MeasurementError(log.source, diagnose("joint-without-torque", joint=name))
        check_positions_are_new(log)
        _check_free(robot, log)
    bound = [parse_coupling(one) if isinstance(one, str) else one for one in couplings]
    rows = coupling_rows(robot, bound, [name for log in logs for name in log.joints])
    placed, shares = [log.of(robot) for log, _ in shared], [share for _, share in shared]
    lag, start = 0.0, None
    for _ in range(_ROUNDS):
        measured = measure_torques(placed, shares, robot.home, rows, lag)
        if measured is None or not any(_counted(measured, held_out=False)):
            raise why_nothing(robot, logs, measured)
        torques = Torques.of(robot, measured, bound)
        table = _parameters(torques, known)
        posterior = torques.fit(table, start)
        found = table.value(posterior.mean, "lag", TORQUES, "", 0.0)
        if abs(found - lag) < _SAME_LAG:
            break
        lag, start = float(np.clip(found, -_MOST_LAG, _MOST_LAG)), posterior.mean
    return _told(torques, logs, qualities, table, posterior)


def _check_free(robot: Robot, log: Log) -> None:
    """Checks that what is told moves by itself: fingers that are coupled rest as they are.

    Raises:
        ConfigurationError: If a loop or a coupling binds a joint of the log.
    """
    closure = robot.closure
    if closure is not None:
        bound = {robot.joint_names[joint] for joint in (*closure.leading, *closure.following)}
        told = [name for name in log.joints if name in bound]
        if told:
            raise ConfigurationError("log", diagnose("log-of-bound-joints", joints=told))


def _counted(measured: MeasuredTorques, *, held_out: bool) -> list[bool]:
    """Returns of each run whether any of its torques is to be fitted, or predicted."""
    return [bool(np.isfinite(run.torque[run.held_out == held_out]).any()) for run in measured.runs]


def _parameters(torques: Torques, priors: Sequence[Prior]) -> ParameterTable:
    """Returns what is estimated: of joints whose torques are told, and of the links they move."""
    equations = torques.equations
    wanted: list[tuple[str, str, str, float]] = [
        (kind, name, "", value)
        for name in equations.drives
        for kind, value in equations.stated(name).items()
    ]
    for link in equations.links.values():
        wanted.append(("mass", link, "", equations.mass[link]))
        wanted += [
            ("com", link, axis, value)
            for axis, value in zip(AXES, equations.com[link].tolist(), strict=True)
        ]
        entries = inertia_entries(equations.inertia[link]).tolist()
        wanted += [
            ("inertia", link, entry, value) for entry, value in zip(ENTRIES, entries, strict=True)
        ]
    wanted.append(("lag", TORQUES, "", 0.0))
    widths = dict(_own_widths(torques))
    said = [(prior.kind, prior.subject) for prior in priors]
    return ParameterTable(
        one
        if any(kind == one.kind and fnmatchcase(one.subject, name) for kind, name in said)
        else replace(one, width=max(one.width, widths.get((one.kind, one.subject), 0.0)))
        for one in give_widths(wanted, priors)
    )


def _own_widths(torques: Torques) -> Iterator[tuple[tuple[str, str], float]]:
    """Yields what is known of a kind of number of a subject before, where kinds know too much.

    Small servos are what widths of friction are made for. Of any joint it is known that friction,
    damping, armature and bias each make no more than all of its torque. A body's products of
    inertia, which files have as zero, are unknown as its moments are, and all of them at least by
    what a com does that is elsewhere.
    """
    equations, runs = torques.equations, torques.measured.runs
    fitted = [~run.held_out for run in runs]

    def usual(series: Iterable[Array]) -> float:
        return root_mean_square(one[rows] for one, rows in zip(series, fitted, strict=True))

    sizes = np.array(
        [usual([one[:, at] for one in torques.torques]) for at in range(len(equations.joints))]
    )
    for name, drive in equations.drives.items():
        torque = float((sizes[drive != 0] / np.abs(drive[drive != 0])).min())
        if math.isfinite(torque):
            velocity = usual(run.velocity[..., equations.joints] @ drive for run in runs)
            acceleration = usual(run.acceleration[..., equations.joints] @ drive for run in runs)
            by_kind = (torque, torque / velocity, torque / acceleration, torque)
            for kind, width in zip(OF_JOINTS, by_kind, strict=True):
                yield (kind, name), width
    for link, inertia in equations.inertia.items():
        moment = KINDS["inertia"].share * float(np.trace(inertia)) / 3
        yield ("inertia", link), math.hypot(moment, equations.mass[link] * KINDS["com"].width ** 2)


def _told(
    torques: Torques,
    logs: Sequence[Log],
    qualities: tuple[LogQuality, ...],
    table: ParameterTable,
    posterior: Posterior,
) -> TorqueFit:
    """Returns a fit with how far its predictions are from what was measured."""
    equations, measured = torques.equations, torques.measured
    stated = table.stated.copy()
    stated[[one.kind == "lag" for one in table]] = measured.lag  # of the log, and of no file
    before, after = (
        [torques.off(table, x, held_out=late) for late in (False, True)]
        for x in (stated, posterior.mean)
    )
    late = bool(np.isfinite(root_mean_square(after[1])))
    names = [equations.robot.joint_names[joint] for joint in equations.joints]
    seen = [
        np.where((run.held_out == late)[:, None], run.torque[:, equations.joints], np.nan)
        for run in measured.runs
    ]
    by_joint, by_joint_before, size = (
        np.array([root_mean_square(one[:, at] for one in whole) for at in range(len(names))])
        for whole in (after[late], before[late], seen)
    )
    noise = np.array(
        [_noise([one[:, at] for pair in after for one in pair]) for at in range(len(names))]
    )
    return TorqueFit(
        name=equations.robot.name,
        source=", ".join(log.source for log in logs),
        estimates=tuple(describe_parameters(posterior)),
        together=find_together(posterior),
        failures=tuple(_unexplained(names, by_joint, noise, size)),
        diagnostics=(
            *(one for quality in qualities for one in quality.diagnostics),
            *_gains(torques, names, posterior),
            *_notes(torques, names, torques.predicted(table, stated), root_mean_square(after[late]),
                    root_mean_square(before[late])),
        ),
        posterior=posterior,
        seconds=sum(run.seconds for run in measured.runs),
        held_out=root_mean_square(after[1]),
        held_out_before=root_mean_square(before[1]),
        fitted=root_mean_square(after[0]),
        fitted_before=root_mean_square(before[0]),
        torque=root_mean_square(seen),
        by_joint=dict(zip(names, by_joint.tolist(), strict=True)),
        by_joint_before=dict(zip(names, by_joint_before.tolist(), strict=True)),
        torque_noise=dict(zip(names, noise.tolist(), strict=True)),
        cutoff={
            name: measured.bands[joint].cutoff
            for name, joint in zip(names, equations.joints, strict=True)
        },
        length=measured.length,
        equations=posterior.rows,
        directions=int((np.linalg.eigvalsh(posterior.information) > _TOLD).sum()),
    )  # fmt: skip


def _noise(series: Sequence[Array]) -> float:
    """Returns the standard deviation of what is left that is another from mean to mean.

    By third differences, whose variance is 20 times that of noise without memory.
    """
    steps = np.concatenate([np.diff(one, 3) for one in series])
    return root_mean_square([steps]) / math.sqrt(20.0)


def _unexplained(
    names: Sequence[str], by_joint: Array, noise: Array, size: Array
) -> Iterator[Diagnostic]:
    """Yields what the fitted model does not explain."""
    lacks = np.sqrt(np.maximum(by_joint**2 - np.nan_to_num(noise) ** 2, 0.0)) / size
    bad = [at for at in np.argsort(-lacks).tolist() if lacks[at] > _LACKS]
    if bad:
        yield diagnose(
            "torques-not-explained",
            joints=[names[at] for at in bad],
            worst=names[bad[0]],
            left=Quantity(by_joint[bad[0]], "N m"),
            torque=Quantity(size[bad[0]], "N m"),
        )


def _gains(torques: Torques, names: Sequence[str], posterior: Posterior) -> Iterator[Diagnostic]:
    """Yields whose torque is told too large or too small, beside those of other joints."""
    gains, spread = torques.find_gains(posterior)
    off = np.where(np.abs(gains - 1) > _GAIN, np.abs(gains - 1) / spread, 0.0)
    worst = int(np.argmax(off))
    if off[worst] > _SURE:
        yield diagnose(
            "torque-gain-differs",
            joint=names[worst],
            gain=float(gains[worst]),
            spread=float(NORMAL_95 * spread[worst]),
        )


def _notes(
    torques: Torques, names: Sequence[str], stated: Sequence[Array], off: float, before: float
) -> Iterator[Diagnostic]:
    """Yields what else is to be said."""
    if off > before:
        yield diagnose(
            "torques-predicted-worse", now=Quantity(off, "N m"), stated=Quantity(before, "N m")
        )
    backwards = []
    for at, name in enumerate(names):
        seen = np.concatenate([one[:, at] for one in torques.torques])
        said = np.concatenate([one[:, at] for one in stated])
        both = np.isfinite(seen)
        if both.sum() < 2 or not said[both].std() > _HARDLY * seen[both].std() > 0:
            continue
        if np.corrcoef(seen[both], said[both])[0, 1] < _AGAINST:
            backwards.append(name)
    if backwards:
        yield diagnose("torque-against-the-model", joints=backwards)
