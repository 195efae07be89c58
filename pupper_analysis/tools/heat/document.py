"""Document of heat: first motor to reach the limit, losses, battery, and temperatures over time.

Input is a `HeatStudy`; output is a document that is independent of the output format.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.models.motors.assignment import describe_weak_motor
from pupper_analysis.models.motors.thermal import list_thermal_motors
from pupper_analysis.present import document as doc
from pupper_analysis.present.document import NextStep, join_words, text
from pupper_analysis.present.documents.registry import build_document
from pupper_analysis.present.documents.standing import robot_notes, task_text
from pupper_analysis.present.verdict import split_ties
from pupper_analysis.robot.alike import name_joints
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.heat.heat import HeatStudy, MotorHeat

_MAX_CURVES = 3
"""Largest number of curves in the plot of temperatures, of the motors that are first to reach their
limit. With limits and a mark, more curves would have equal styles. Chosen, not tuned."""


_LIMIT_TEMPERATURE = "limit_temperature"
"""Name of the largest permitted temperature of the winding in `MotorHeat.unknown`."""

EXAMPLE_LIMIT = 100.0
"""Example of a limit temperature [degC] in the command that the report proposes if the data of a
motor lack the limit. Chosen, not tuned.
"""


@build_document.register(HeatStudy)
def heat_document(study: HeatStudy, robot: Robot | None = None) -> doc.Document:
    """Create the report of the motor temperatures of a stance, for ``build_document``."""
    first = _describe_first_motor(study.first, _format_ambient(study))
    exceeds_limits = bool(study.weak or study.overheats)
    is_cool = study.known and not exceeds_limits
    unknown = tuple(_describe_unknown(study))
    losses = tuple(_describe_losses(study))
    if study.battery_time is not None and (is_cool or exceeds_limits):
        first, losses = (*first[:1], *losses, *first[1:]), ()  # the user asks for the duration
    final = study.first.steady_temperature
    is_temperature_known = not exceeds_limits and final is not None and math.isfinite(final)
    states_first = is_cool or is_temperature_known
    weak = tuple(_describe_weak_count(study))
    _, broken, ties = split_ties(study.ties)
    failures: tuple[doc.Words, ...] = (*broken, *unknown)
    if exceeds_limits:
        failures = (*first[:1], *broken, *ties, *first[1:], *weak, *unknown)
    if is_temperature_known and _lacks_limit_only(study):
        failures, first = (*broken, *_describe_temperature_without_limit(study)), ()
    return doc.Document(
        text("heat"),
        doc.Name(study.name),
        (_make_table(study), *_list_plots(study)),
        passed=study.passed,
        verdict=text(_select_verdict(study)),
        failures=failures,
        findings=(
            *(first[:1] if states_first else ()),
            *(() if exceeds_limits else ties),
            *(first[1:] if states_first else ()),
            *losses,
            *_describe_torque_alone(study),
        ),
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
    if word := split_ties(study.ties)[0]:
        return word
    return "heat-cool" if study.passed else "UNKNOWN"


def _select_next_step(study: HeatStudy) -> NextStep:
    """Return the command that the report proposes to run next."""
    if study.overheats or study.weak:
        return NextStep("best", ("utilisation",))
    if _lacks_limit_only(study):
        return NextStep("heat", ("--limit", f"{EXAMPLE_LIMIT:g}"))
    if any(motor.unknown and motor.torque for motor in study.motors):
        return NextStep("heat", ("--list-motors",), robot_typed=False, omitted=("*",))
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
        ambient=_format_ambient(study),
        example=f"{EXAMPLE_LIMIT:g}",
    )


def _format_minutes(seconds: float) -> str:
    """Return a time [s] in minutes, with at most three digits below 100 minutes."""
    minutes = seconds / 60
    return f"{minutes:.0f}" if minutes >= 100 else f"{minutes:.3g}"


def _format_ambient(study: HeatStudy) -> str:
    """Return the temperature [degC] of the air at the first motor; "" if no curve is known."""
    ambient = float(study.temperatures[0, study.motors.index(study.first)])
    return f"{ambient:.3g}" if math.isfinite(ambient) else ""


def _describe_first_motor(motor: MotorHeat, ambient: str) -> tuple[doc.Words, ...]:
    """Describe the result of a motor, such as the time to the limit, and the motor itself.

    ``ambient`` is the temperature of the air [degC], or "".
    """
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
        ambient=ambient,
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
            first=doc.Name(numbers[0]),
            more=str(len(numbers) - 1) if len(numbers) > 1 else "",
        )
    if study.omitted:
        yield text(
            "heat-omitted", joints=join_words([doc.Name(joint) for joint in study.omitted[:4]])
        )


def _describe_torque_alone(study: HeatStudy) -> Iterable[doc.Words]:
    """Yield the largest torque, and the motors with thermal data, if nothing else is known.

    Nothing is yielded if the losses are known, the limit temperature is the only missing number, or
    a motor is too weak or too hot.
    """
    lacking = [motor for motor in study.motors if motor.unknown and motor.torque]
    is_judged = study.weak or study.overheats or study.loss is not None
    if not lacking or is_judged or _lacks_limit_only(study):
        return
    largest = max(lacking, key=lambda motor: abs(motor.torque))
    yield text(
        "heat-torque-alone",
        torque=f"{abs(largest.torque):.2f}",
        joint=doc.Name(largest.joint),
        known=join_words([doc.Name(name) for name in list_thermal_motors()]),
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


def heat_plots(study: HeatStudy) -> list[doc.Plot]:
    """Create the plot of the winding temperatures over time, or of the torques of weak motors.

    Raises:
        ConfigurationError: If no temperature of a loaded motor is known, for example.
    """
    plots = list(_list_plots(study))
    if not plots:
        raise ConfigurationError("figure", diagnose("no-temperature-known"))
    return plots


def _list_plots(study: HeatStudy) -> Iterable[doc.Plot]:
    """Yield the plot that supports the verdict: torques if motors are too weak, or temperatures.

    If a motor is too weak, the stance is impossible, and no temperatures are stated. Nothing is
    yielded if no temperature of a loaded motor is known.
    """
    if study.weak:
        yield _make_torque_plot(study)
        return
    known = [index for index, motor in enumerate(study.motors) if _has_curve(motor)]
    if known and study.times[-1]:
        yield _make_temperature_plot(study, _group_equal_curves(study, known))


def _has_curve(motor: MotorHeat) -> bool:
    """Return True if the temperature of the winding over time is known."""
    return motor.steady_temperature is not None


def _make_torque_plot(study: HeatStudy) -> doc.BarPlot:
    """Create the bar plot of each motor's torque, in % of its largest torque at rest."""
    bars = [
        doc.PlotBar(
            doc.Name(motor.joint),
            100 * abs(motor.torque) / motor.largest_torque,
            limit=100.0,
        )
        for motor in study.motors
        if motor.largest_torque
    ]
    return doc.BarPlot(
        _make_plot_title(study, "heat-torque-plot"),
        doc.Axis(text("heat-share"), "%", ".0f"),
        bars,
        (text("heat-stance-torque"), None, text("heat-largest-torque")),
    )


def _make_plot_title(study: HeatStudy, key: str) -> doc.Text:
    """Create the title of a plot: quantity, motors, and ambient temperature if known."""
    motors = dict.fromkeys(motor.motor for motor in study.motors)
    known = [index for index, motor in enumerate(study.motors) if _has_curve(motor)]
    ambient = sorted({float(study.temperatures[0, index]) for index in known})
    ends = dict.fromkeys(f"{temperature:.3g}" for temperature in ambient[:1] + ambient[-1:])
    return text(key, motors=join_words(map(doc.Name, motors)), ambient=", ".join(ends))


def _group_equal_curves(study: HeatStudy, known: list[int]) -> list[list[int]]:
    """Group motors with equal temperature curves and limits; the most critical group first.

    Curves are equal if their temperatures differ by at most `_EQUAL_TEMPERATURES`. ``known`` are
    the indices of the motors with a curve.
    """

    def rank(index: int) -> tuple[bool, float, float]:
        """Return a sort key: the first motor of the study, the time to the limit, the end."""
        time = study.motors[index].time_to_limit
        end = float(study.temperatures[-1, index])
        first = study.motors[index] is study.first
        return not first, math.inf if time is None else time, -end

    groups: list[list[int]] = []
    for index in sorted(known, key=rank):
        curve, limit = study.temperatures[:, index], study.motors[index].limit_temperature
        for group in groups:
            if limit == study.motors[group[0]].limit_temperature and np.allclose(
                curve, study.temperatures[:, group[0]], rtol=0.0, atol=_EQUAL_TEMPERATURES
            ):
                group.append(index)
                break
        else:
            groups.append([index])
    return groups


def _make_temperature_plot(study: HeatStudy, groups: list[list[int]]) -> doc.LinePlot:
    """Create the plot of the temperatures of the most critical groups of motors, with limits.

    The curves end at `_MAX_RISE_RATIO` times the limit, as temperature rise. The first time to a
    limit is marked.
    """
    minutes, drawn = study.times / 60, groups[:_MAX_CURVES]
    series = [
        doc.Series(
            doc.Name(name_joints([study.motors[index].joint for index in sorted(group)])),
            *_cut_curve(minutes, study.temperatures[:, group[0]], study.motors[group[0]]),
            note=_describe_end(study.motors[group[0]]),
        )
        for group in drawn
    ]
    first = study.first
    limits = {study.motors[group[0]].limit_temperature for group in drawn} - {None}
    series += [
        doc.Series(
            text("heat-limit"),
            minutes[[0, -1]],
            np.full(2, limit),
            reference=True,
            note=doc.Name(f"{limit:.3g} °C"),
        )
        for limit in sorted(limit for limit in limits if limit is not None)
    ]
    time, limit = first.time_to_limit, first.limit_temperature
    if time is not None and limit is not None and 0 < time <= study.times[-1]:
        name = text("heat-first-at-limit", time=_format_duration(time))
        series.append(doc.Series(name, [time / 60], [limit], points=True, marked_index=0))
    return doc.LinePlot(
        _make_plot_title(study, "heat-plot"),
        doc.Axis(text("heat-time"), "min", ".3g"),
        doc.Axis(text("heat-temperature"), "°C", ".3g"),
        series,
        _describe_omitted_curves(study, groups),
    )


def _describe_end(motor: MotorHeat) -> doc.Words | None:
    """Return the final temperature or the time to the limit of a motor, for the legend."""
    time, final = motor.time_to_limit, motor.steady_temperature
    if time is not None and math.isfinite(time):
        return text("heat-curve-reaches", time=_format_duration(time))
    if final is not None and math.isfinite(final):
        return text("heat-curve-settles", final=f"{final:.3g}")
    return text("heat-curve-rises")


def _describe_omitted_curves(study: HeatStudy, groups: list[list[int]]) -> doc.Words | None:
    """Return a remark on motors without a curve: unknown temperature, or less critical motors."""
    unknown = [motor.joint for motor in study.motors if motor.torque and not _has_curve(motor)]
    unknown += study.omitted
    cooler = sum(map(len, groups[_MAX_CURVES:]))
    if not unknown and not cooler:
        return None
    shown = join_words([doc.Name(joint) for joint in unknown[:_MAX_NAMED_JOINTS]])
    return text(
        "heat-not-drawn",
        cooler=cooler or "",
        both=bool(cooler and unknown),
        unknown=shown if unknown else "",
        more=len(unknown) - _MAX_NAMED_JOINTS if len(unknown) > _MAX_NAMED_JOINTS else "",
    )


def _cut_curve(minutes: Array, temperatures: Array, motor: MotorHeat) -> tuple[Array, Array]:
    """Return the part of a rising curve, shape (n,), up to `_MAX_RISE_RATIO` times the limit."""
    limit, ambient = motor.limit_temperature, float(temperatures[0])
    end = math.inf if limit is None else ambient + _MAX_RISE_RATIO * (limit - ambient)
    if limit is None or limit <= ambient or temperatures[-1] <= end:
        return minutes, temperatures
    inside = temperatures < end
    crossing = float(np.interp(end, temperatures, minutes))
    return np.append(minutes[inside], crossing), np.append(temperatures[inside], end)


_MAX_RISE_RATIO = 1.3
"""Largest temperature rise over the ambient air that is drawn, divided by the rise at the limit
[1]. Chosen, not tuned."""

_EQUAL_TEMPERATURES = 0.5
"""Largest difference of two temperature curves that are drawn as one [K]. Below the accuracy of the
thermal model, and hardly visible. Chosen, not tuned."""

_MAX_NAMED_JOINTS = 4
"""Largest number of joints that the remark on motors without a curve names. Chosen, not tuned."""
