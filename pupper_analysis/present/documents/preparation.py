"""The document of a loaded robot: what was done to make two files one that can stand."""

from __future__ import annotations

from pupper_analysis.base.diagnostics import merge_diagnostics
from pupper_analysis.prepare.load import Preparation
from pupper_analysis.present import document as doc
from pupper_analysis.present.document import text, word
from pupper_analysis.present.documents.registry import build_document
from pupper_analysis.robot.robot import Robot


@build_document.register(Preparation)
def preparation_document(loading: Preparation, _: Robot | None = None) -> doc.Document:
    """Returns how a robot was loaded, pass by pass; see ``build``."""
    robot = text(
        "robot-free" if loading.floating else "robot-held",
        mass=f"{loading.mass:.3f}",
        joints=len(loading.joints),
        feet=len(loading.feet),
    )
    ready = () if loading.passes else (text("files-are-ready"),)
    shown = {note for run in loading.passes for note in run.done}
    return doc.Document(
        text("loading-title"),
        doc.Name(loading.name),
        (_passes(loading),) if loading.passes else (),
        told=(robot, *ready),
        notes=tuple(
            map(doc.tell, merge_diagnostics([note for note in loading.notes if note not in shown]))
        ),
    )


def _passes(loading: Preparation) -> doc.Table:
    rows: list[tuple[doc.Cell, ...]] = []
    for run in loading.passes:
        done = tuple(map(doc.tell, run.done)) or (text("nothing-to-do"),)
        rows += [(doc.Name(run.name), word(run.does), done[0])]
        rows += [(doc.Name(""), doc.Name(""), more) for more in done[1:]]
    columns = tuple(
        doc.Column(text(key), left=True)
        for key in ("pass-of-loading", "what-it-does", "what-it-did")
    )
    return doc.Table(text("passes-run"), columns, tuple(rows))
