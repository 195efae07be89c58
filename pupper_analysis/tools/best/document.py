"""Document of a best stance: coordinates, result of the search, torques and verdict.

Input is a ``BestStudy``. The document extends the document of the simulated stand by the
coordinates, by the objective before and after the search and, for a payload, by its limit.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import replace

from pupper_analysis.cli.stance_fields import format_as_options
from pupper_analysis.present import document as doc
from pupper_analysis.present.document import get_english, join_words, text
from pupper_analysis.present.documents.loads import mass_text
from pupper_analysis.present.documents.registry import build_document, make_document
from pupper_analysis.present.documents.standing import quantity_columns, task_text
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.task import Point, StandTask
from pupper_analysis.stance.workspace import ANGLE_COORDINATES
from pupper_analysis.statics.equilibrium import find_hardest_motor
from pupper_analysis.tools.best.best import BestStance, BestStudy
from pupper_analysis.tools.best.search import Objective
from pupper_analysis.tools.best.space import BoundKind
from pupper_analysis.tools.stand.document import describe_height, stance_document

_OBJECTIVE_TEXTS = {
    Objective.MARGIN: "distance-of-the-com",
    Objective.PAYLOAD: "payload",
}
"""{objective: key of its text in the catalogue}. The utilisation has its own line."""


@build_document.register(BestStudy)
def best_document(study: BestStudy, robot: Robot | None = None) -> doc.Document:
    """Create the document of a search for the best stance: the simulated stand, and the search."""
    stand_document = stance_document(study.stance, robot)
    blocks: tuple[doc.Block, ...] = (_make_coordinate_table(study.best), *stand_document.blocks)
    # The largest motor load is a detail: line 1 states it if it is the objective.
    load, *others = stand_document.findings
    stance = describe_height(study.stance) or task_text(study.best.stand.task)
    others = [line for line in others if get_english(line) != stance.en]
    coordinates = stance.with_short_form(_shorten_coordinates(study.best))
    more = [line for line in stand_document.details if get_english(line) != coordinates.en]
    step = _make_next_step(study, stand_document.next_step)
    limit = tuple(_describe_active_bounds(study.best))
    result = _make_search_line(study)
    word_of_verdict = stand_document.verdict
    if isinstance(word_of_verdict, doc.Text) and not doc.fits_first_line(
        word_of_verdict, study.stance.name, result
    ):
        result = _make_search_line(study, full=False)
    messages: tuple[doc.Words, ...] = (result, *limit, coordinates, *others)
    if not study.passed:  # the reason of the failure is line 2
        messages = (result, *others, *limit, coordinates)
    details: tuple[doc.Words, ...] = (load, *more)
    failures, verdict = stand_document.failures, stand_document.verdict
    if study.best.payload is not None:
        loaded = make_document(study.best.payload)
        blocks = (*(block for block in loaded.blocks if isinstance(block, doc.Table)), *blocks)
        # Both documents describe the same stance: omit repeated lines.
        shown = (*stand_document.findings, *stand_document.details)
        # The limit follows the number, which is a reason if the payload fails.
        number, rest = loaded.findings[: loaded.passed], loaded.findings[bool(loaded.passed) :]
        messages = (messages[0], *rest[:1], *messages[1:])
        further = (*number, *rest[1:], *loaded.details)
        details += tuple(line for line in further if line not in shown)
        failures += tuple(line for line in loaded.failures if line not in failures)
        verdict = verdict if loaded.passed else loaded.verdict
    return replace(
        stand_document,
        kind=text("best-stance"),
        blocks=blocks,
        passed=study.passed,
        verdict=verdict,
        failures=failures,
        findings=messages,
        details=details,
        next_step=step,
    )


def _make_next_step(study: BestStudy, stand_step: doc.NextStep | None) -> doc.NextStep:
    """Return the command to suggest next, for example `path` to the best stance."""
    task = study.best.stand.task
    if not study.passed:
        gains = () if stand_step is None else stand_step.words
        if "--kp" in gains:
            return doc.NextStep("best", (study.best.objective.value, *gains))
        return doc.NextStep("stand")
    if not study.best.improved:  # `stand` has no more to state about the initial stance
        return doc.NextStep("push" if study.best.objective is Objective.PAYLOAD else "payload")
    if task.feet:  # no option specifies places of feet in the world
        return doc.NextStep("workspace")
    # `stand` proposes `gains` if kd exceeds the bound of an explicit PD controller.
    has_other_gains = stand_step is not None and stand_step.command == "gains"
    command = "gains" if has_other_gains else "path"
    return doc.NextStep(command, stance_found=True, stance_words=_format_stance_options(task))


def _format_stance_options(task: StandTask) -> tuple[str, ...]:
    """Format the coordinates of a stance as options of a command, rounded to 0.1 mm and 0.1 deg.

    Options whose numbers are all zero are omitted. The reserves of the search (`JOINT_RESERVE`,
    `EDGE_RESERVE_RATIO`) exceed the rounding.
    """
    roll, pitch, yaw = (
        math.radians(round(math.degrees(angle), 1)) for angle in (task.roll, task.pitch, task.yaw)
    )
    rounded = replace(
        task,
        height=None if task.height is None else round(task.height, 4),
        offset=None if task.offset is None else _round_point(task.offset),
        foot_offsets={foot: _round_point(offset) for foot, offset in task.foot_offsets.items()},
        roll=roll,
        pitch=pitch,
        yaw=yaw,
    )
    options = format_as_options(rounded, _OPTION_ATTRIBUTES)
    return tuple(
        word
        for option, values in options.items()
        for value in values
        if re.search("[1-9]", value.rpartition("=")[2])
        for word in (option, value)
    )


_OPTION_ATTRIBUTES = ("height", "offset", *ANGLE_COORDINATES, "foot_offsets")
"""Attributes of the stand task that the search determines, in the order of their options."""


def _round_point(point: Point) -> Point:
    """Round x and y [m] to 0.1 mm."""
    return round(point[0], 4) + 0.0, round(point[1], 4) + 0.0


def _describe_active_bounds(best: BestStance) -> Iterator[doc.Text]:
    """Yield the text of the bounds that limit the objective of a best stance, if any.

    A payload states its own limit, and a utilisation its motor. A CoM margin that no bound limits
    is a local optimum.
    """
    if best.objective is Objective.PAYLOAD or not best.improved:
        return
    by_kind = {
        kind: [bound for bound in best.active_bounds if bound.kind is kind] for kind in BoundKind
    }
    parts: list[doc.Words] = []
    if joints := by_kind[BoundKind.JOINT]:
        names = [bound.name for bound in joints]
        parts.append(text("best-limited-by-joints", joint=doc.Name(names[0]), more=len(names) - 1))
    if legs := by_kind[BoundKind.LEG]:
        names = [bound.name for bound in legs]
        parts.append(text("best-limited-by-legs", leg=doc.Name(names[0]), more=len(names) - 1))
    if steps := by_kind[BoundKind.STEP]:
        largest = 1e3 * max(abs(bound.value) for bound in steps)
        parts.append(text("best-limited-by-steps", largest=f"{largest:.0f}"))
    if base := by_kind[BoundKind.BASE]:
        names_of_base = join_words([text(bound.name) for bound in base])
        parts.append(text("best-limited-by-base", coordinates=names_of_base))
    if parts:
        yield text("best-limited", bounds=join_words(parts))
    elif best.objective is Objective.MARGIN:
        yield text("best-not-limited")


def _make_search_line(study: BestStudy, *, full: bool = True) -> doc.Text:
    """Make the line with the value of the objective in the initial task and in the best stance.

    A motor utilisation has the name and the torque of the most loaded motor. Unless ``full``, the
    short form contains the utilisation without "of the limit".
    """
    best = study.best
    improved = best.improved
    if best.objective is Objective.UTILISATION:
        statics = study.stance.statics
        peak = find_hardest_motor(statics)
        torque = abs(float(statics.joint_torques[peak]))
        return text(
            "best-utilisation",
            count=best.evaluations,
            share=f"{100 * best.value:.4g}",
            rounded=f"{100 * best.value:.3g}",
            torque=doc.format_widened(torque, ".2f"),
            unit=statics.torque_units[peak],
            joint=doc.Name(statics.joint_names[peak]),
            nominal=f"{100 * best.nominal_value:.4g}",
            rounded_nominal=f"{100 * best.nominal_value:.3g}",
            improved=improved,
            full=full,
        )
    values: tuple[object, object] = (mass_text(best.value), mass_text(best.nominal_value))
    if best.objective is not Objective.PAYLOAD:
        values = (f"{1e3 * best.value:.4g} mm", f"{1e3 * best.nominal_value:.4g} mm")
    return text(
        "best-of-count-stances",
        count=best.evaluations,
        what=text(_OBJECTIVE_TEXTS[best.objective]),
        value=values[0],
        compensated=best.payload is not None and best.payload.depends_on_feedforward,
        nominal=values[1],
        improved=improved,
    )


def _shorten_coordinates(best: BestStance) -> doc.Text:
    """Return the coordinates of the best stance in short: mm and degrees.

    For example, ``found: base height 180.6 mm, x +13 mm, pitch +1 deg; feet moved ≤18 mm``.
    Coordinates that round to zero are omitted.
    """
    feet: dict[str, list[float]] = {}
    for name, value in best.coordinates.items():
        foot = name.rpartition(" ")[0]
        if foot:
            feet.setdefault(foot, []).append(value)
    largest = 1e3 * max((math.hypot(*moved) for moved in feet.values()), default=0.0)
    height = best.stand.task.height
    parts = [text("best-height", height=f"{1e3 * height:.1f}")] if height else []
    for names, scale, unit in (
        (("x", "y"), 1e3, "mm"),
        (ANGLE_COORDINATES, math.degrees(1.0), "deg"),
    ):
        shown = {name: f"{scale * best.coordinates.get(name, 0.0):+.0f}" for name in names}
        moved = [
            text("best-coordinate", name=text(name), number=number)
            for name, number in shown.items()
            if float(number)
        ]
        parts += [text("best-moved", coordinates=join_words(moved), unit=unit)] if moved else []
    groups = [join_words(parts)] if parts else []
    if round(largest):
        groups.append(text("best-feet-moved", largest=f"{largest:.0f}"))
    return text("best-found", stance=join_words(groups, "semicolon"))


def _make_coordinate_table(best: BestStance) -> doc.Table:
    """Create the table of the searched coordinates of the best stance [mm or deg]."""
    rows: list[tuple[doc.Cell, ...]] = []
    for name, value in best.coordinates.items():
        angle = name in ANGLE_COORDINATES
        cell = doc.number_cell(value, "+.1f", scale=math.degrees(1.0) if angle else 1e3)
        rows.append((doc.Name(name), cell, doc.Name("°" if angle else "mm")))
    return doc.Table(
        text("where-the-best-stance"),
        quantity_columns(of="coordinate"),
        tuple(rows),
    )
