"""The document of a fit to measured torques: how well it predicts others, and what it tells."""

from __future__ import annotations

import math
from collections.abc import Iterator

from pupper_analysis.identification.torques.result import TorqueFit
from pupper_analysis.report import document as doc
from pupper_analysis.report import plots
from pupper_analysis.report.documents.fit import describe_fit, plot_joints
from pupper_analysis.report.documents.registry import build_document
from pupper_analysis.report.words import text
from pupper_analysis.robot.robot import Robot


@build_document.register(TorqueFit)
def torque_fit_document(fit: TorqueFit, _: Robot | None = None) -> doc.Document:
    """Returns what measured torques tell of a robot; see ``build_document``."""
    told = (
        *_errors(fit),
        text("motion-rests-on", seconds=f"{fit.seconds:.1f}", source=doc.Name(fit.source)),
        text(
            "torques-rest-on",
            equations=str(fit.equations),
            length=f"{1e3 * fit.length:.3g}",
            cutoff=f"{min(fit.cutoff.values()):.3g}",
        ),
        text("directions-told", directions=str(fit.directions), parameters=str(len(fit.estimates))),
    )
    return describe_fit(fit, text("fit-of-torques"), told, [_joints(fit)])


def _errors(fit: TorqueFit) -> Iterator[doc.Words]:
    """Yields what is off in torques that were not fitted."""
    held_out = math.isfinite(fit.held_out)
    after = fit.held_out if held_out else fit.fitted
    before = fit.held_out_before if held_out else fit.fitted_before
    yield text(
        "held-out-torque" if held_out else "no-torque-held-out",
        after=f"{after:.3g}",
        share=f"{100 * after / fit.torque:.2g}",
        before=f"{before:.3g}",
        share_before=f"{100 * before / fit.torque:.2g}",
    )


def _joints(fit: TorqueFit) -> plots.BarPlot:
    """Returns what is off at each joint, and its sensor's noise."""
    return plot_joints(
        text("torque-off-at-joints"),
        plots.Axis(text("root-mean-square"), "N m", ".3g"),
        fit.by_joint,
        fit.torque_noise,
        text("torque-noise"),
    )
