"""The document of a plan of stands: which to take, and what they will tell."""

from __future__ import annotations

from pupper_analysis.identification.stands.plan import StandPlan
from pupper_analysis.identification.told import Told
from pupper_analysis.report import document as doc
from pupper_analysis.report.documents.fit import SHOWN_UNITS, TOLD_BY
from pupper_analysis.report.documents.registry import build_document
from pupper_analysis.report.words import text
from pupper_analysis.robot.robot import Robot


@build_document.register(StandPlan)
def plan_document(plan: StandPlan, _: Robot | None = None) -> doc.Document:
    """Returns which stands to take, and the interval that they leave of each parameter."""
    told = sum(one.told is Told.DATA for one in plan.expected)
    return doc.Document(
        text("plan-of-stands"),
        doc.Name(plan.name),
        (_stands(plan), _expected(plan)),
        told=(
            text(
                "planned-stands",
                stands=str(len(plan.stands)),
                candidates=str(plan.candidates),
                told=str(told),
                parameters=str(len(plan.expected)),
            ),
            text("how-to-take-stands"),
        ),
    )


def _stands(plan: StandPlan) -> doc.Table:
    joints = list(plan.stands[0].command)
    columns = (
        doc.Column(text("planned-stand"), left=True),
        doc.Column(text("feet-in-the-air"), left=True),
        doc.Column(text("come-from"), left=True),
        doc.Column(text("utilisation"), "%"),
        *(doc.Column(doc.Name(joint), "deg", detail=True) for joint in joints),
    )
    factor, _ = SHOWN_UNITS["rad"]
    rows: tuple[tuple[doc.Cell, ...], ...] = tuple(
        (
            doc.Name(one.name),
            doc.Name(" ".join(one.swing)),
            doc.Name(one.approach),
            doc.number_cell(one.utilisation, ".0f", scale=100.0),
            *(doc.number_cell(one.command[joint], ".2f", scale=factor) for joint in joints),
        )
        for one in plan.stands
    )
    return doc.Table(text("stands-to-take"), columns, rows)


def _expected(plan: StandPlan) -> doc.Table:
    rows: list[tuple[doc.Cell, ...]] = []
    for one in plan.expected:
        factor, unit = SHOWN_UNITS.get(one.unit, (1.0, one.unit))
        rows.append(
            (
                doc.Name(one.name),
                doc.Name(unit),
                doc.number_cell(one.stated, ".4g", scale=factor),
                doc.number_cell(one.before, ".2g", scale=factor),
                doc.number_cell(one.after, ".2g", scale=factor),
                text(TOLD_BY[one.told]),
            )
        )
    columns = (
        doc.Column(text("parameter"), left=True),
        doc.Column(text("unit"), left=True),
        doc.Column(text("in-the-file")),
        doc.Column(text("known-before")),
        doc.Column(text("known-after")),
        doc.Column(text("told-by"), left=True),
    )
    return doc.Table(text("what-stands-will-tell"), columns, tuple(rows), detail=True)
