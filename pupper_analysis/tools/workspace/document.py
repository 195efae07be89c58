"""Document of a workspace: range of the base in each direction, with planted feet."""

from __future__ import annotations

import math

from pupper_analysis.present import document as doc
from pupper_analysis.present.document import join_words, text
from pupper_analysis.present.documents.loads import view_block
from pupper_analysis.present.documents.registry import build_document
from pupper_analysis.present.documents.standing import quantity_columns, robot_notes, task_text
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.workspace import BaseWorkspace

_ANGLE_DIRECTIONS = ("roll", "pitch", "yaw")
"""Directions of a base workspace with ranges in angles; the report shows these in degrees."""


def _select_ranges(ranges: dict[str, doc.Text], *, angles: bool) -> list[doc.Text]:
    """Return the ranges of the angles, or those of the lengths."""
    return [
        line for direction, line in ranges.items() if (direction in _ANGLE_DIRECTIONS) is angles
    ]


@build_document.register(BaseWorkspace)
def workspace_document(workspace: BaseWorkspace, robot: Robot | None = None) -> doc.Document:
    """Create the report of a base workspace: reachable range of each direction [mm, deg].

    `build_document` calls this function for a `BaseWorkspace`.
    """
    rows: list[tuple[doc.Cell, ...]] = []
    ranges = {}
    for direction, interval in workspace.intervals.items():
        angle = direction in _ANGLE_DIRECTIONS
        scale, unit = (math.degrees(1.0), "°") if angle else (1e3, "mm")
        low, high = (
            doc.number_cell(end, "+.1f", scale=scale) for end in (interval.low, interval.high)
        )
        rows.append((text(direction), low, high, doc.Name(unit)))
        ends = {"low": low.text, "high": high.text, "unit": unit}
        ranges[direction] = text("range-of-direction", direction=text(direction), **ends)
    table = doc.Table(
        text("how-far-the-base"),
        quantity_columns(text("from"), text("to"), of="direction"),
        tuple(rows),
        (text("of-reach-and-balance-alone"),),
    )
    return doc.Document(
        text("workspace"),
        doc.Name(workspace.name),
        (table, view_block(robot, workspace.start, None)),
        findings=(
            text("range-in-short", ranges=join_words(_select_ranges(ranges, angles=False))),
            text("range-of-angles", ranges=join_words(_select_ranges(ranges, angles=True))),
        ),
        details=(task_text(workspace.start.task),),
        brief=True,
        notes=robot_notes(robot),
        next_step=doc.NextStep("best", ("margin",)),
    )
