"""The document of a fit to motions: how well it predicts others, and what it tells."""

from __future__ import annotations

import math
from collections.abc import Iterator

from pupper_analysis.identification.motions.result import MotionFit
from pupper_analysis.report import document as doc
from pupper_analysis.report import plots
from pupper_analysis.report.documents.fit import describe_fit, plot_joints
from pupper_analysis.report.documents.registry import build_document
from pupper_analysis.report.words import text
from pupper_analysis.robot.robot import Robot


@build_document.register(MotionFit)
def motion_fit_document(fit: MotionFit, _: Robot | None = None) -> doc.Document:
    """Returns what logs of motions tell of a robot; see ``build_document``."""
    told = (
        *_errors(fit),
        text("motion-rests-on", seconds=f"{fit.seconds:.1f}", source=doc.Name(fit.source)),
    )
    return describe_fit(fit, text("fit-of-motions"), told, [_joints(fit)])


def _errors(fit: MotionFit) -> Iterator[doc.Words]:
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


def _joints(fit: MotionFit) -> plots.BarPlot:
    """Returns what is off at each joint, and its encoder's noise."""
    return plot_joints(
        text("off-at-joints"),
        plots.Axis(text("root-mean-square"), "mrad", ".2f"),
        fit.by_joint,
        fit.encoder_noise,
        text("encoder-noise"),
        scale=1e3,
    )
