"""Documents of pushes: largest impulses of a stance by direction, and response to a push.

Inputs are the largest pushes of robots, or a simulated push. Outputs are documents that are
independent of the output format, with impulses in N s.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.results import Result
from pupper_analysis.base.units import floor_within_rounding
from pupper_analysis.present import document as doc
from pupper_analysis.present.document import NextStep, get_english, text
from pupper_analysis.present.documents.loads import view_block
from pupper_analysis.present.documents.motors import describe_motor_energy
from pupper_analysis.present.documents.registry import build_document, compare_results
from pupper_analysis.present.documents.standing import (
    ground_text,
    quantity_columns,
    robot_notes,
    task_text,
)
from pupper_analysis.present.plots import Canvas, draw_plots, draw_result
from pupper_analysis.present.verdict import judged_document, select_step_after_failure
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.push.bench import PULSE_DURATION, PushTrial
from pupper_analysis.tools.push.recovery import PushedStance, PushRecovery

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@build_document.register(PushedStance)
def push_document(pushed: PushedStance, robot: Robot | None = None) -> doc.Document:
    """Create the report of the largest pushes of a stance."""
    unpushed = pushed.recovery.failures_without_push
    number, *limit = _describe_weakest_push(pushed)
    answer = (text("it-does-not-stand-so"), number) if unpushed else (number, *limit[1:])
    region = tuple(_describe_region(pushed))
    return judged_document(
        text("pushes"),
        pushed,
        (
            view_block(robot, pushed.stand, None),
            _make_push_table(pushed),
            push_plot({pushed.name: pushed.recovery}, pushed.name),
        ),
        answer,
        limit=limit[0] if limit else None,
        failures=() if pushed.within_region else region,
        word=text("push-beyond") if pushed.verdict.passed and not pushed.passed else None,
        number_first=bool(unpushed) or pushed.peak_torques is not None,
        details=(
            *(region if pushed.within_region else ()),
            *describe_motor_energy(pushed.energy),
            task_text(pushed.stand.task),
            ground_text(pushed.stand.depths.values()),
        ),
        notes=robot_notes(robot),
        next_step=_select_next_step(pushed),
    )


def _select_next_step(pushed: PushedStance) -> NextStep:
    """Return the command to suggest after a push study."""
    if pushed.peak_torques is not None:
        return NextStep("audit")
    if pushed.passed:
        return NextStep("best", ("margin",))
    return select_step_after_failure(pushed.verdict, NextStep("stand"))


def _describe_weakest_push(pushed: PushedStance) -> Iterable[doc.Words]:
    """Yield texts of the weakest push, such as direction [degrees] and impulse [N s]."""
    recovery = pushed.recovery
    if recovery.failures_without_push:
        yield text("of-mass-kg", mass=doc.format_widened(recovery.mass, ".2f"))
        return
    if pushed.peak_torques is not None:
        names, peaks = pushed.joint_names, pushed.peak_torques
        unlimited = [names.index(name) for name in pushed.unknown_limits]
        hardest = max(unlimited, key=lambda joint: float(peaks[joint]))
        yield text(
            "push-unknown",
            impulse=_format_weakest_impulse(recovery),
            direction=f"{math.degrees(recovery.weakest_direction):.0f}",
            torque=f"{float(peaks[hardest]):.3g} {pushed.torque_units[hardest]}",
            hardest=doc.Name(names[hardest]),
        )
        return
    degrees = round(math.degrees(recovery.weakest_direction)) % 360
    yield text(
        "weakest-at-directiondeg-impulse",
        direction=str(degrees),
        side=text(_SIDES[degrees]) if degrees in _SIDES else "",
        rounded=_format_weakest_impulse(recovery),
        count=len(recovery.directions),
        one=len(recovery.directions) == 1,
        impulse=_format_weakest_impulse(recovery),
        speed=doc.format_widened(recovery.weakest_impulse / recovery.mass, ".2f"),
        mass=doc.format_widened(recovery.mass, ".2f"),
    )
    yield text(
        "push-limited",
        failure=doc.diagnostic_text(recovery.weakest_failure),
    )
    yield text(
        "push-tipping",
        tipping=doc.format_widened(float(min(recovery.tipping_estimate)), ".2f"),
    )


_SIDES = {0: "push-to-front", 90: "push-to-left", 180: "push-to-back", 270: "push-to-right"}
"""{angle from forward, about the vertical axis [deg]: key of the name of this direction}."""


def _format_weakest_impulse(recovery: PushRecovery) -> str:
    """Return the weakest impulse [N s], rounded down to the decimals of the resolution.

    A push with the printed impulse does not exceed the largest survived push.
    """
    decimals = max(0, -math.floor(math.log10(recovery.resolution)))
    shown = floor_within_rounding(recovery.weakest_impulse * 10**decimals) / 10**decimals
    return f"{shown:.{decimals}f}"


def _describe_region(pushed: PushedStance) -> Iterable[doc.Words]:
    """Yield a text that compares torques with torque-speed regions, if motors are assigned."""
    peaks, times = pushed.region_peaks, pushed.beyond_times
    if peaks is None or times is None:
        return
    joint = int(np.nanargmax(peaks if pushed.within_region else times))
    peak = float(peaks[joint])
    yield text(
        "push-within-motors" if pushed.within_region else "push-beyond-motors",
        joint=doc.Name(pushed.joint_names[joint]),
        motor=doc.Name(pushed.motors[pushed.joint_names[joint]]),
        peak=f"{100 * peak:.0f}" if peak < _MAX_PRINTED_SHARE else "> 1000",
        time=f"{1e3 * float(times[joint]):.0f}",
    )


_MAX_PRINTED_SHARE = 10.0
"""Utilisation of a torque-speed region from which only "> 1000 %" is printed, since the utilisation
is infinite at the no-load speed. Chosen, not tuned.
"""


def _make_push_table(pushed: PushedStance) -> doc.Table:
    """Create the table of the largest pushes, a direction per row."""
    recovery = pushed.recovery
    impulses = [*recovery.impulses, *recovery.tipping_estimate]
    form = doc.widen_format(".2f", impulses)
    rows: list[tuple[doc.Cell, ...]] = [
        (
            doc.number_cell(math.degrees(angle), ".0f"),
            doc.number_cell(recovery.impulses[index], form),
            doc.number_cell(recovery.velocity_steps[index], ".3f"),
            doc.number_cell(recovery.tipping_estimate[index], form),
            doc.diagnostic_text(recovery.failures[index]),
        )
        for index, angle in enumerate(recovery.directions)
    ]
    return doc.Table(
        text("largest-push-that-the-stand"),
        (
            doc.Column(text("direction"), "°"),
            doc.Column(text("impulse"), "N s"),
            doc.Column(text("step-of-velocity"), "m/s"),
            doc.Column(text("a-rigid-robot-tips"), "N s"),
            doc.Column(text("failure-then"), left=True),
        ),
        tuple(rows),
        (text("push-directions"),),
        (
            text(
                "each-is-found-by-simulations",
                count=recovery.rollouts,
                simulated=f"{recovery.simulated:.3g}",
                seconds=f"{recovery.duration:g}",
                resolution=f"{recovery.resolution:g}",
            ),
        ),
    )


def push_plot(pushed: Mapping[str, PushRecovery], rigid: str) -> doc.LinePlot:
    """Create the plot of the largest survived impulses [N s] over the direction, a line per robot.

    Args:
        pushed: {name of the robot: largest pushes}.
        rigid: Key of the robot for which the tipping estimate (rigid body) is also drawn, if
            finite.
    """
    series = [
        _make_closed_series(
            doc.Name(name),
            recovery.directions,
            recovery.impulses,
            note=doc.Name(f"{_format_weakest_impulse(recovery)} N s"),
            marked_index=int(np.argmin(np.abs(recovery.directions - recovery.weakest_direction))),
        )
        for name, recovery in pushed.items()
    ]
    tipping = pushed[rigid]
    impulses = [value for recovery in pushed.values() for value in recovery.impulses]
    impulses += tipping.tipping_estimate.tolist()
    if np.isfinite(tipping.tipping_estimate).all():
        name = text("tipping-estimate", name=doc.Name(rigid))
        series.append(
            _make_closed_series(name, tipping.directions, tipping.tipping_estimate, reference=True)
        )
    return doc.LinePlot(
        text("largest-push-that-the-stand-survives", duration=f"{1e3 * PULSE_DURATION:g}"),
        doc.Axis(text("direction"), "°", ".0f"),
        doc.Axis(text("impulse"), "N s", doc.widen_format(".2f", impulses), low=0.0),
        series,
        text("impulse-in-weakest-direction"),
    )


@draw_result.register(PushRecovery)
def plot_recovery(recovery: PushRecovery, _: Robot | None, canvas: Canvas) -> tuple[Axes, ...]:
    """Plot the largest survived impulse [N s] over the direction of the push."""
    title = doc.Name(get_english(text("pushes")))
    return draw_plots([push_plot({"stand": recovery}, "stand")], title, canvas)


def _make_closed_series(
    name: doc.Words, directions: Array, values: Array, **options: Any
) -> doc.Series:
    """Create a plot line, closed at 360 deg, of values (n,) over directions (n,) [rad]."""
    degrees = np.append(np.degrees(directions), 360.0)
    return doc.Series(name, degrees, np.append(values, values[0]), points=True, **options)


@compare_results.register(PushedStance)
def compare_pushes(first: PushedStance, results: Sequence[Result]) -> tuple[doc.Block, ...]:
    """Create a table and a plot of the largest pushes of several robots.

    The tipping estimate of the first robot is drawn. Empty if the push directions differ.
    """
    pushes = cast("Sequence[PushedStance]", results)
    directions = first.recovery.directions
    if len({pushed.recovery.directions.tobytes() for pushed in pushes}) != 1:
        return ()
    rows: list[tuple[doc.Cell, ...]] = [
        (
            doc.number_cell(math.degrees(angle), ".0f"),
            *(doc.number_cell(pushed.recovery.impulses[index], ".2f") for pushed in pushes),
        )
        for index, angle in enumerate(directions)
    ]
    table = doc.Table(
        text("largest-push-that-the-stand"),
        (
            doc.Column(text("direction"), "°"),
            *(doc.Column(doc.Name(pushed.name), "N s") for pushed in pushes),
        ),
        tuple(rows),
        (text("push-directions"),),
    )
    recoveries = {pushed.name: pushed.recovery for pushed in pushes}
    return table, push_plot(recoveries, first.name)


@build_document.register(PushTrial)
def trial_document(trial: PushTrial, _: Robot | None = None) -> doc.Document:
    """Create the report of a simulated push."""
    columns = quantity_columns()
    rows = (
        (text("change-of-velocity"), doc.number_cell(trial.velocity_step, ".2f"), doc.Name("m/s")),
    )
    return doc.Document(
        text("pushes"),
        text(
            "pushed-with",
            impulse=f"{trial.impulse:.2f}",
            direction=f"{math.degrees(trial.direction):.0f}",
        ),
        (doc.Table(text("push"), columns, rows),),
        passed=trial.failure is None,
        verdict=text("it-recovers") if trial.failure is None else text("FAILS"),
        failures=() if trial.failure is None else (doc.diagnostic_text(trial.failure),),
    )
