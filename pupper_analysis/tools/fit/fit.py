"""Fit of a robot's numbers to measurements, whatever was measured."""

from __future__ import annotations

from collections.abc import Sequence

from numpy.typing import ArrayLike

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.fit.measurements.log import Log
from pupper_analysis.tools.fit.measurements.stands import MeasuredStands
from pupper_analysis.tools.fit.motions.fit import HOLD_OUT_FRACTION, fit_motion
from pupper_analysis.tools.fit.parameters import Prior
from pupper_analysis.tools.fit.result import Fit
from pupper_analysis.tools.fit.stands.fit import fit_stands


@check_arguments
def fit(
    robot: Robot,
    measurements: MeasuredStands | Log | Sequence[Log],
    *,
    priors: Sequence[Prior | str] = (),
    kp: ArrayLike | None = None,
    kd: ArrayLike | None = None,
    weight: float | None = None,
    encoder: float | None = None,
    hold_out: float | Sequence[Log] | None = None,
) -> Fit:
    """Fits a robot's numbers to what was measured of it: stands at rest, or logs of motions.

    See ``fit_stands`` and ``fit_motion`` of ``pupper_analysis.tools.fit``.

    Args:
        robot: The robot.
        measurements: Stands, by ``read_stands``; or a log or logs, by ``read_log``.
        priors: What is known before: ``mass=50%``, ``com:base=5mm``, ``kp=0`` (it is right).
        kp: Stiffness of the servos (N m/rad), one or (nu,); the model's own by default.
        kd: Of logs: their damping (N m s/rad); likewise.
        weight: Of stands: mass of the whole robot by a scale (kg).
        encoder: Of stands: standard deviation of a position (rad); from its step by default.
        hold_out: Of logs: the share of each, at its end, that is predicted instead of fitted (0.2
            by default); or logs that are.

    Raises:
        ConfigurationError: If an option is none of these measurements.
        FitError: If it does not converge.
        MeasurementError: If the measurements are none of this robot's, or tell nothing.
    """
    stands = isinstance(measurements, MeasuredStands)
    unused = {"kd": kd, "hold_out": hold_out} if stands else {"weight": weight, "encoder": encoder}
    for name, value in unused.items():
        if value is not None:
            measured = "stands" if stands else "log"
            raise ConfigurationError(name, diagnose("option-of-others", measured=measured))
    if isinstance(measurements, MeasuredStands):
        return fit_stands(robot, measurements, priors=priors, weight=weight, kp=kp, encoder=encoder)
    share = HOLD_OUT_FRACTION if hold_out is None else hold_out
    logs = [measurements] if isinstance(measurements, Log) else measurements
    return fit_motion(robot, logs, priors=priors, hold_out=share, kp=kp, kd=kd)
