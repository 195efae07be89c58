"""The document of the best stance: how it was found, what it costs, and whether it holds."""

from __future__ import annotations

import math
from dataclasses import replace

from pupper_analysis.present import document as doc
from pupper_analysis.present.document import text
from pupper_analysis.present.documents.loads import mass_text
from pupper_analysis.present.documents.registry import build_document, make_document
from pupper_analysis.present.documents.standing import quantity_columns
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.best.best import BestStance, BestStudy
from pupper_analysis.tools.best.search import Objective
from pupper_analysis.tools.stand.document import stance_document

_WHAT = {
    Objective.UTILISATION: "peak-motor-utilisation",
    Objective.MARGIN: "distance-of-the-com",
    Objective.PAYLOAD: "payload",
}


@build_document.register(BestStudy)
def best_document(study: BestStudy, robot: Robot | None = None) -> doc.Document:
    """Returns the best stance, how it was found, and what is found out about it; see ``build``."""
    found = stance_document(study.stance, robot)
    blocks: tuple[doc.Block, ...] = (_coordinates(study.best), *found.blocks)
    messages: tuple[doc.Words, ...] = (_search(study.best), *found.findings)
    details = found.details
    failures, verdict = found.failures, found.verdict
    if study.best.payload is not None:
        loaded = make_document(study.best.payload)
        blocks = (*(block for block in loaded.blocks if isinstance(block, doc.Table)), *blocks)
        # The stance of both is the same, and told once.
        messages += tuple(line for line in loaded.findings if line not in found.findings)
        details += tuple(line for line in loaded.details if line not in found.details)
        failures += loaded.failures
        verdict = verdict if loaded.passed else loaded.verdict
    return replace(
        found,
        kind=text("best-stance"),
        blocks=blocks,
        passed=study.passed,
        verdict=verdict,
        failures=failures,
        findings=messages,
        details=details,
    )


def _search(best: BestStance) -> doc.Text:
    values: tuple[object, object] = (mass_text(best.value), mass_text(best.nominal_value))
    if best.objective is not Objective.PAYLOAD:
        unit, scale = (" mm", 1e3) if best.objective is Objective.MARGIN else (" %", 100.0)
        values = (f"{scale * best.value:.4g}{unit}", f"{scale * best.nominal_value:.4g}{unit}")
    return text(
        "best-of-count-stances",
        count=best.evaluations,
        what=text(_WHAT[best.objective]),
        value=values[0],
        nominal=values[1],
    )


def _coordinates(best: BestStance) -> doc.Table:
    rows: list[tuple[doc.Cell, ...]] = []
    for name, value in best.coordinates.items():
        angle = name in ("roll", "pitch", "yaw")
        cell = doc.number_cell(value, "+.1f", scale=math.degrees(1.0) if angle else 1e3)
        rows.append((doc.Name(name), cell, doc.Name("°" if angle else "mm")))
    return doc.Table(
        text("where-the-best-stance"),
        quantity_columns(of="coordinate"),
        tuple(rows),
    )
