"""Why logs with torques cannot be fitted, or not as they are."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.errors import MeasurementError
from pupper_analysis.identification.measurements.log import Log
from pupper_analysis.identification.measurements.log_quality import find_quantum
from pupper_analysis.identification.torques.blocks import MeasuredTorques
from pupper_analysis.robot.robot import Robot

Array = NDArray[np.float64]

_STEPS = 3.0
"""Quanta by which a position that is told anew has changed: of an encoder that turns slowly it is
one."""


def check_positions_are_new(log: Log) -> None:
    """Checks that a log has a position of its own at each sample, where joints move.

    Where a log is written faster than encoders are read, positions are steps, and have neither
    velocity nor acceleration.

    Raises:
        MeasurementError: If not.
    """
    repeated = {
        name: kept
        for name, column in zip(log.joints, log.position.T, strict=True)
        if (kept := repeats(column)) > 1
    }
    if repeated:
        joints, kept = list(repeated), max(repeated.values())
        interval = Quantity(kept * log.interval, "s")
        told = diagnose("positions-repeated", joints=joints, count=kept, interval=interval)
        raise MeasurementError(log.source, told)


def repeats(values: Array) -> int:
    """Returns for how many samples (n,) a moving joint's position is told, as a rule."""
    told = values[np.isfinite(values)]
    steps = np.diff(told)
    new = np.flatnonzero(steps)
    if len(new) < 2 or np.median(np.abs(steps[new])) < _STEPS * find_quantum(told):
        return 1
    return round(float(np.median(np.diff(new))))


def why_nothing(
    robot: Robot, logs: Sequence[Log], measured: MeasuredTorques | None
) -> MeasurementError:
    """Returns why there is no equation to fit."""
    source = logs[0].source if logs else robot.name
    if measured is None:
        return MeasurementError(source, diagnose("nothing-to-fit"))
    told: Diagnostic
    jumping = [robot.joint_names[at] for at, band in measured.bands.items() if not band.told]
    if jumping:
        told = diagnose("positions-jump", joints=jumping)
    else:
        told = diagnose("joints-turn-too-soon", length=Quantity(measured.length, "s"))
    return MeasurementError(source, told)
