"""The document of a fit to motions: how well it predicts others, and what it tells."""

from __future__ import annotations

import math
from collections.abc import Iterator

from pupper_analysis.fit.motion_result import FittedMotion
from pupper_analysis.report import document as doc
from pupper_analysis.report import plots
from pupper_analysis.report.documents.fit import open_lines, parameter_tables
from pupper_analysis.report.documents.registry import build_document
from pupper_analysis.report.words import text
from pupper_analysis.robot.robot import Robot


@build_document.register(FittedMotion)
def motion_document(fit: FittedMotion, _: Robot | None = None) -> doc.Document:
    """Returns what logs of motions tell of a robot; see ``build_document``."""
    return doc.Document(
        text("fit-of-motions"),
        doc.Name(fit.name),
        (*parameter_tables(fit.estimates), _joints(fit)),
        passed=fit.explained,
        verdict=text("model-explains") if fit.explained else text("model-does-not-explain"),
        failures=tuple(doc.tell(one) for one in fit.failures),
        told=(
            *_errors(fit),
            text("motion-rests-on", seconds=f"{fit.seconds:.1f}", source=doc.Name(fit.source)),
            *open_lines(fit.estimates, fit.together),
        ),
        notes=tuple(doc.tell(one) for one in fit.diagnostics),
    )


def _errors(fit: FittedMotion) -> Iterator[doc.Words]:
    """Yields what is off in what was not fitted, beside the robot's own repeatability."""
    if math.isfinite(fit.held_out):
        yield text(
            "held-out-error",
            after=f"{1e3 * fit.held_out:.2f}",
            before=f"{1e3 * fit.held_out_before:.2f}",
        )
    else:
        yield text("nothing-held-out", after=f"{1e3 * fit.fitted:.2f}")
    if math.isfinite(fit.repeatability):
        yield text("repeatability-is", own=f"{1e3 * fit.repeatability:.2f}")
    else:
        yield text("repeatability-unknown")


def _joints(fit: FittedMotion) -> plots.BarPlot:
    """Returns what is off at each joint, and its encoder's noise."""
    bars = [
        plots.Bar(doc.Name(name), 1e3 * off, 1e3 * fit.encoder_noise[name])
        for name, off in fit.by_joint.items()
        if math.isfinite(off)
    ]
    return plots.BarPlot(
        text("off-at-joints"),
        plots.Axis(text("root-mean-square"), "mrad", ".2f"),
        bars,
        (text("root-mean-square"), text("encoder-noise"), text("limit")),
    )
