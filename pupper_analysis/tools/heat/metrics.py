"""Metrics of the motors of a design, for `study`. ``METRICS``: {name: arguments of the metric}."""

from __future__ import annotations

import math
from typing import Any

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError, ModelError
from pupper_analysis.models.motors.assignment import describe_weak_motor
from pupper_analysis.tools.heat.heat import HeatStudy, study_heat


def _compute_design_heat(design: Any) -> HeatStudy:
    """Return the heat of the motors of a design of a study, in the stand of the design."""
    _check_motors(design)
    study = study_heat(design.robot, design.stand, design.motors)
    if study.omitted:
        raise ConfigurationError("motor", diagnose("joints-without-motor", joints=study.omitted))
    return study


def _check_motors(design: Any) -> None:
    """Raise a ConfigurationError if the study of a design varies no motor."""
    if not design.motors:
        raise ConfigurationError("motor", diagnose("no-motor-varied"))


def _measure_continuous_utilisation(design: Any) -> float:
    """Return the largest |torque| / continuous torque [1] of the motors of a design."""
    ratios = [0.0]
    for heat in design.compute_once(_compute_design_heat).motors:
        if heat.continuous_torque is None:
            raise ModelError(
                heat.motor, diagnose("motor-numbers-unknown", numbers=["continuous_torque"])
            )
        ratios.append(abs(heat.torque) / heat.continuous_torque)
    return max(ratios)


def _measure_time_until_hot(design: Any) -> float:
    """Return the time until the first winding reaches the limit [s]; infinite if none does."""
    times = [math.inf]
    for heat in design.compute_once(_compute_design_heat).motors:
        if heat.time_to_limit is None and heat.torque:
            if heat.too_weak and heat.largest_torque is not None:
                problem = describe_weak_motor(
                    heat.joint, heat.motor, heat.torque, heat.largest_torque, heat.limiting_number
                )
            else:
                unknown = heat.unknown or ("winding_resistance", "winding_capacity")
                problem = diagnose("motor-numbers-unknown", numbers=[*unknown])
            raise ModelError(heat.motor, problem)
        times.append(math.inf if heat.time_to_limit is None else heat.time_to_limit)
    return min(times)


def _measure_copper_loss(design: Any) -> float:
    """Return the copper loss of all motors [W]; not a number if a motor is too weak."""
    study = design.compute_once(_compute_design_heat)
    for heat in study.motors:
        if heat.cold_loss is None and not heat.too_weak:
            motor = design.motors[heat.joint]
            _ = motor.winding_ohms, motor.output_torque_per_ampere  # raises: one is unknown
    return math.nan if study.loss is None else study.loss


def _sum_numbers(design: Any, number: str) -> float:
    """Return the sum of a motor field, such as ``mass`` [kg], over the motors of a design."""
    _check_motors(design)
    return math.fsum(motor.get(number) for motor in design.motors.values())


METRICS: dict[str, dict[str, Any]] = {
    "continuous_utilisation": {"function": _measure_continuous_utilisation, "unit": "1"},
    "time_until_hot": {"function": _measure_time_until_hot, "unit": "s"},
    "copper_loss": {"function": _measure_copper_loss, "unit": "W"},
    "motor_mass": {"function": lambda design: _sum_numbers(design, "mass"), "unit": "kg"},
    "motor_price": {"function": lambda design: _sum_numbers(design, "price"), "unit": "USD"},
}
"""{name of a metric of studies: arguments of `Metric` except the name}."""
