"""The document of one push: whether the stand recovers from it."""

from __future__ import annotations

import math

from pupper_analysis.report import document as doc
from pupper_analysis.report.documents.quantities import quantity_columns
from pupper_analysis.report.documents.registry import build_document
from pupper_analysis.report.words import text
from pupper_analysis.robot.robot import Robot
from pupper_analysis.simulation.push_trial import PushTrial


@build_document.register(PushTrial)
def trial_document(trial: PushTrial, _: Robot | None = None) -> doc.Document:
    """Returns what one push makes of a stand; see ``build``."""
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
        failures=() if trial.failure is None else (doc.tell(trial.failure),),
    )
