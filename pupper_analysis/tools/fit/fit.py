"""Entry point of a fit: selects the method by the kind of measurements."""

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
    """Estimate a robot's parameters from measurements: stands at rest, or logs of motions.

    Stands are passed to ``pa.identification.fit_stands``, logs to ``pa.identification.fit_motion``.

    Args:
        robot: The robot.
        measurements: Stands of ``read_stands``, or a log or several logs of ``read_log``.
        priors: Prior standard deviations, for example ``mass=50%`` or ``com:base=5mm``. With
            ``kp=0``, the stated kp is exact and is not estimated.
        kp: Stated servo stiffness [N m/rad, N/m], a scalar or shape (nu,); the model's by default.
        kd: Stated servo damping [N m s/rad, N s/m], a scalar or shape (nu,); the model's by
            default. For logs only.
        weight: Mass of the whole robot on a scale [kg]. For stands only.
        encoder: Standard deviation of a joint position [rad, m]; by default derived from the
            encoder step, 2e-4 if no step is found. For stands only.
        hold_out: Measurements that are predicted instead of fitted: a fraction at the end of each
            run (part of a log without clock jumps; 0.2 by default), or separate logs. For logs
            only.

    Raises:
        ConfigurationError: If an argument is invalid, or does not apply to the measurements. For
            stands also if the base is fixed, or the robot has closed loops, couplings, welds or
            grips.
        FitError: If no parameters are found; for example, the iteration does not converge.
        MeasurementError: If the measurements do not belong to this robot, or cannot be used.
        ModelError: If the servo gains of a joint are unknown, for example.
        UnknownNameError: If the measurements name a joint, foot or link that the robot lacks.
    """
    stands = isinstance(measurements, MeasuredStands)
    unused = {"kd": kd, "hold_out": hold_out} if stands else {"weight": weight, "encoder": encoder}
    for name, value in unused.items():
        if value is not None:
            measured = "stands" if stands else "log"
            raise ConfigurationError(name, diagnose("option-of-others", measured=measured))
    if isinstance(measurements, MeasuredStands):
        return fit_stands(robot, measurements, priors=priors, weight=weight, kp=kp, encoder=encoder)
    fraction = HOLD_OUT_FRACTION if hold_out is None else hold_out
    logs = [measurements] if isinstance(measurements, Log) else measurements
    return fit_motion(robot, logs, priors=priors, hold_out=fraction, kp=kp, kd=kd)
