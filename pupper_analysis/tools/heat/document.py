"""Document of heat: first motor to reach the limit, losses, battery, and temperatures over time.

Input is a `HeatStudy`; output is a document that is independent of the output format.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.models.motors.assignment import describe_weak_motor
from pupper_analysis.present import document as doc
from pupper_analysis.present.document import NextStep, join_words, text
from pupper_analysis.present.documents.registry import build_document
from pupper_analysis.present.documents.standing import robot_notes, task_text
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.heat.heat import HeatStudy, MotorHeat

_MAX_CURVES = 4
"""Largest number of motors in the plot of temperatures: the hottest motors, and the motor that the
report names first. Chosen, not tuned."""


_LIMIT_TEMPERATURE = "limit_temperature"
"""Name of the largest permitted temperature of the winding in `MotorHeat.unknown`."""

_EXAMPLE_LIMIT = 100.0
"""Example of a limit temperature [degC] in the command that the report proposes if the data of a
motor lack the limit. Chosen, not tuned.
"""


@build_document.register(HeatStudy)
def heat_document(study: HeatStudy, robot: Robot | None = None) -> doc.Document:
    """Create the report of the motor temperatures of a stance, for ``build_document``."""
    first = _describe_first_motor(study.first)
    exceeds_limits = bool(study.weak or study.overheats)
    unknown = tuple(_describe_unknown(study))
    losses = tuple(_describe_losses(study))
    if study.battery_time is not None and (study.passed or exceeds_limits):
        first, losses = (*first[:1], *losses, *first[1:]), ()  # the user asks for the duration
    final = study.first.steady_temperature
    is_temperature_known = not exceeds_limits and final is not None and math.isfinite(final)
    weak = tuple(_describe_weak_count(study))
    failures: tuple[doc.Words, ...] = (*first, *weak, *unknown) if exceeds_limits else unknown
    if is_temperature_known and _lacks_limit_only(study):
        failures, first = tuple(_describe_temperature_without_limit(study)), ()
    return doc.Document(
        text("heat"),
        doc.Name(study.name),
        (_make_table(study), *_list_plots(study)),
        passed=study.passed,
        verdict=text(_select_verdict(study)),
        failures=failures,
        findings=(*first, *losses) if study.passed or is_temperature_known else losses,
        details=(task_text(study.stand.task), text("heat-model")),
        brief=True,
        notes=robot_notes(robot),
        next_step=_select_next_step(study),
    )


def _select_verdict(study: HeatStudy) -> str:
    """Return the catalogue key of the verdict: motors too weak, hot, cool, or unknown."""
    if study.weak:
        return "heat-weak"
    if study.overheats:
        return "heat-hot"
    return "heat-cool" if study.passed else "UNKNOWN"


def _select_next_step(study: HeatStudy) -> NextStep:
    """Return the command that the report proposes to run next."""
    if study.overheats or study.weak:
        return NextStep("best", ("utilisation",))
    if _lacks_limit_only(study):
        return NextStep("heat", ("--limit", f"{_EXAMPLE_LIMIT:g}"))
    return NextStep("payload" if study.passed else "stand")


def _lacks_limit_only(study: HeatStudy) -> bool:
    """Return True if the limit temperature is the only number that the verdict lacks."""
    lacking = {number for motor in study.motors if motor.torque for number in motor.unknown}
    complete = not study.omitted and study.missing_masses is None
    return complete and lacking == {_LIMIT_TEMPERATURE}


def _describe_temperature_without_limit(study: HeatStudy) -> Iterable[doc.Words]:
    """Yield the final temperature and the hottest joint, if no limit temperature is known."""
    first = study.first
    yield text(
        "heat-settles-without-limit",
        final=f"{first.steady_temperature:.3g}",
        motor=doc.Name(first.motor),
    )
    yield text(
        "heat-limit-required",
        joint=doc.Name(first.joint),
        torque=f"{abs(first.torque):.2f}",
        loss="" if first.loss is None else f"{first.loss:.3g}",
        example=f"{_EXAMPLE_LIMIT:g}",
    )


def _format_minutes(seconds: float) -> str:
    """Return a time [s] in minutes, with at most three digits below 100 minutes."""
    minutes = seconds / 60
    return f"{minutes:.0f}" if minutes >= 100 else f"{minutes:.3g}"


def _describe_first_motor(motor: MotorHeat) -> tuple[doc.Words, ...]:
    """Describe the result of a motor, such as the time to the limit, and the motor itself."""
    time, final = motor.time_to_limit, motor.steady_temperature
    torque = f"{abs(motor.torque):.2f}"
    if motor.too_weak and motor.largest_torque is not None:
        weak = describe_weak_motor(
            motor.joint, motor.motor, motor.torque, motor.largest_torque, motor.limiting_number
        )
        return (doc.diagnostic_text(weak),)
    permanent = motor.continuous_torque
    is_limit_unknown = motor.limit_temperature is None and final is not None and final < math.inf
    if (final is None or is_limit_unknown) and permanent is not None:  # from the data sheet
        key = "heat-above-rating" if motor.overheats else "heat-within-rating"
        return (
            text(key, torque=torque, rating=f"{permanent:.3g}"),
            text("heat-rated-motor", joint=doc.Name(motor.joint), motor=doc.Name(motor.motor)),
        )
    limit = "" if motor.limit_temperature is None else f"{motor.limit_temperature:.3g}"
    if time is not None and math.isfinite(time):
        result = text("heat-reaches", time=_format_duration(time), limit=limit)
    elif final is not None and math.isfinite(final):
        result = text("heat-settles", final=f"{final:.3g}", limit=limit)
    else:
        result = text("heat-runs-away")
    cause = text(
        "heat-hottest-motor",
        joint=doc.Name(motor.joint),
        torque=torque,
        loss="" if motor.loss is None else f"{motor.loss:.3g}",
    )
    return result, cause


def _format_duration(time: float) -> str:
    """Return a time [s] in min, or in s below 60 s."""
    return f"{_format_minutes(time)} min" if time >= 60.0 else f"{time:.2g} s"


def _describe_unknown(study: HeatStudy) -> Iterable[doc.Words]:
    """Yield the texts on assumed masses, unknown motor numbers, and joints without motor."""
    if study.missing_masses is not None:
        yield doc.diagnostic_text(study.missing_masses)
    lacking: dict[str, tuple[str, ...]] = {}
    for motor in study.motors:
        if motor.unknown and motor.torque:
            lacking.setdefault(motor.motor, motor.unknown)
    for name, numbers in lacking.items():
        yield text(
            "heat-unknown",
            motor=doc.Name(name),
            numbers=join_words([doc.Name(number) for number in numbers]),
            limit=_LIMIT_TEMPERATURE in numbers,
        )
    if study.omitted:
        yield text(
            "heat-omitted", joints=join_words([doc.Name(joint) for joint in study.omitted[:4]])
        )


def _describe_weak_count(study: HeatStudy) -> Iterable[doc.Words]:
    """Yield the text with the number of motors that are too weak, if any."""
    if study.weak:
        yield text("heat-weak-count", count=len(study.weak), total=len(study.motors))


def _describe_losses(study: HeatStudy) -> Iterable[doc.Words]:
    """Yield the text of the copper loss, with the battery current and duration."""
    if study.loss is None:
        return
    current, time = study.battery_current, study.battery_time
    yield text(
        "heat-losses",
        loss=f"{study.loss:.3g}",
        current="" if current is None else f"{current:.3g}",
        voltage="" if study.supply_voltage is None else f"{study.supply_voltage:.3g}",
        minutes="" if time is None or math.isinf(time) else _format_minutes(time),
    )


def _make_table(study: HeatStudy) -> doc.Table:
    """Create the table of torque, current, loss, temperature and time to the limit per motor."""
    form = doc.widen_format("+.3f", [motor.torque for motor in study.motors])
    rows: list[tuple[doc.Cell, ...]] = [
        (
            doc.Name(motor.joint),
            doc.Name(motor.motor),
            doc.number_cell(motor.torque, form),
            doc.number_cell(motor.continuous_torque, ".3g"),
            doc.number_cell(motor.largest_torque, ".3g"),
            doc.number_cell(motor.current, ".3g"),
            doc.number_cell(motor.cold_loss, ".3g"),
            doc.number_cell(_drop_nonfinite(motor.steady_loss), ".3g"),
            doc.number_cell(_drop_nonfinite(motor.steady_temperature), ".1f"),
            doc.number_cell(motor.limit_temperature, ".0f"),
            doc.number_cell(_drop_nonfinite(motor.time_to_limit), ".1f", scale=1 / 60),
        )
        for motor in study.motors
    ]
    return doc.Table(
        text("heat-by-joint"),
        (
            doc.Column(text("heat-joint"), left=True),
            doc.Column(text("heat-motor"), left=True),
            doc.Column(text("heat-torque"), "N m"),
            doc.Column(text("heat-continuous"), "N m"),
            doc.Column(text("heat-largest"), "N m"),
            doc.Column(text("heat-current"), "A"),
            doc.Column(text("heat-cold-loss"), "W"),
            doc.Column(text("heat-final-loss"), "W"),
            doc.Column(text("heat-final"), "°C"),
            doc.Column(text("heat-limit"), "°C"),
            doc.Column(text("heat-minutes"), "min"),
        ),
        tuple(rows),
        (text("heat-table-note"),),
    )


def _drop_nonfinite(value: float | None) -> float | None:
    """Return ``value`` for a table cell; None (an empty cell) if infinite, NaN or None."""
    return None if value is None or not math.isfinite(value) else value


def heat_plots(study: HeatStudy) -> list[doc.LinePlot]:
    """Create the plot of the winding temperatures over time.

    Raises:
        ConfigurationError: If no temperature of a loaded motor is known, for example.
    """
    plots = list(_list_plots(study))
    if not plots:
        raise ConfigurationError("figure", diagnose("no-temperature-known"))
    return plots


def _list_plots(study: HeatStudy) -> Iterable[doc.LinePlot]:
    """Yield the plot of the temperatures of the hottest and limiting motors, if known."""
    known = [
        index for index, motor in enumerate(study.motors) if motor.steady_temperature is not None
    ]
    if not known or not study.times[-1]:
        return
    ends = study.temperatures[-1]
    hottest = sorted(known, key=lambda index: -float(ends[index]))[:_MAX_CURVES]
    first = study.motors.index(study.first)
    if first in known and first not in hottest:
        hottest[-1] = first
    hottest.sort(key=lambda index: index != first)
    minutes = study.times / 60
    series = [
        doc.Series(doc.Name(study.motors[index].joint), minutes, study.temperatures[:, index])
        for index in hottest
    ]
    limits = {study.motors[index].limit_temperature for index in hottest} - {None}
    series += [
        doc.Series(text("heat-limit"), minutes, np.full(len(minutes), limit), reference=True)
        for limit in sorted(limit for limit in limits if limit is not None)
    ]
    yield doc.LinePlot(
        text("heat-plot"),
        doc.Axis(text("heat-time"), "min", ".3g"),
        doc.Axis(text("heat-temperature"), "°C", ".3g"),
        series,
    )
