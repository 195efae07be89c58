"""What documents of stands share: the robot as it was loaded, what is asked, the ground, units."""

from __future__ import annotations

from collections.abc import Iterable

from pupper_analysis.base.diagnostics import merge_diagnostics
from pupper_analysis.present import document as doc
from pupper_analysis.present.document import Column, Text, Words, tell, text
from pupper_analysis.present.documents.sources import files_text
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.stand import Stand
from pupper_analysis.stance.task import StandTask
from pupper_analysis.statics.equilibrium import GravityCompensation


def quantity_columns(*values: Words, of: str = "quantity") -> tuple[Column, ...]:
    """Returns the columns of such a table.

    Args:
        *values: Of which runs or files the values are; ``value`` alone where none is given.
        of: What each row is; a key of the catalogue.
    """
    named = values or (text("value"),)
    middle = (Column(name) for name in named)
    return (Column(text(of), left=True), *middle, Column(text("unit"), left=True))


def task_text(task: StandTask) -> Text:
    """Returns what is asked of a stand, as the task itself says it."""
    return Text(str(task), lambda: task.said("zh"))


def robot_notes(robot: Robot | None) -> tuple[Words, ...]:
    """Returns a robot's files, and what was assumed of it."""
    return () if robot is None else (files_text(robot), *map(tell, merge_diagnostics(robot.notes)))


def ground_text(depths: Iterable[float]) -> Text:
    """Says on which ground it was simulated, of feet that sink in by ``depths`` (m), or do not."""
    deepest = max(depths, default=0.0)
    if not deepest:
        return text("feet-sunk-into-mujocos-soft")
    return text(
        "all-this-is-on-mujocos",
        depth=f"{1e3 * deepest:.2f}",
    )


def ground_word(depths: Iterable[float]) -> Text:
    """Says of which ground numbers are: of feet that sink in by ``depths`` (m), or do not."""
    return text("on-simulated-ground" if max(depths, default=0.0) else "on-rigid-ground")


def stand_table(stand: Stand, statics: GravityCompensation | None) -> doc.Table:
    """Returns how high a stand is, and how far from falling, from touching and from slipping."""
    near, links = stand.ground_clearance, stand.self_clearance
    loads = statics.foot_loads.values() if statics is not None else ()
    known: tuple[tuple[str, float | None, str, float, str], ...] = (
        ("height-of-the-base", stand.task.height, "mm", 1e3, ".1f"),
        ("com-margin", stand.com_margin, "mm", 1e3, ".1f"),
        ("ground-clearance", near.distance if near else None, "mm", 1e3, ".1f"),
        ("distance-between-links", links.distance if links else None, "mm", 1e3, ".1f"),
        (
            "friction-used",
            max((one.friction_utilisation for one in loads), default=None),
            "%",
            100.0,
            ".1f",
        ),
    )
    rows = tuple(
        (text(name), doc.number_cell(value, form, scale=scale), doc.Name(unit))
        for name, value, unit, scale, form in known
        if value is not None
    )
    columns = quantity_columns()
    return doc.Table(text("stance"), columns, rows, detail=True)
