"""The document of a fit to stands at rest: what the robot weighs, what is not explained."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from pupper_analysis.identification.result import Estimate
from pupper_analysis.identification.stands.result import JointResidual, StandFit
from pupper_analysis.identification.told import Told
from pupper_analysis.report import document as doc
from pupper_analysis.report import plots
from pupper_analysis.report.documents.fit import MOST_ROWS, describe_fit
from pupper_analysis.report.documents.registry import build_document
from pupper_analysis.report.words import text
from pupper_analysis.robot.robot import Robot


@build_document.register(StandFit)
def stand_fit_document(fit: StandFit, _: Robot | None = None) -> doc.Document:
    """Returns what stands at rest tell of a robot; see ``build_document``."""
    told = (
        text("fit-rests-on", stands=str(fit.stands), source=doc.Name(fit.source)),
        _total(fit.total_mass),
        *_worst(fit.joint_residuals[:1]),
    )
    left: list[doc.Block] = [_residuals(fit), *_joint_residuals(fit.joint_residuals)]
    return describe_fit(fit, text("fit-of-stands"), told, left)


def _total(mass: Estimate) -> doc.Words:
    values = {
        "mean": f"{mass.mean:.3f}",
        "half": f"{mass.high - mass.mean:.3f}",
        "stated": f"{mass.stated:.3f}",
    }
    if mass.told is Told.DATA:
        return text("total-mass-told", **values)
    return text("total-mass-not-told", **values)


def _worst(first: Iterable[JointResidual]) -> Iterator[doc.Words]:
    for one in first:
        yield text(
            "worst-residual",
            joint=doc.Name(one.joint),
            stand=doc.Name(one.stand),
            off=f"{1e3 * one.off:+.2f}",
            times=f"{abs(one.deviations):.1f}",
        )


def _joint_residuals(found: Sequence[JointResidual]) -> Iterator[doc.Table]:
    """Yields what is left at joints, the most surprising before."""
    if not found:
        return
    rows: tuple[tuple[doc.Cell, ...], ...] = tuple(
        (
            doc.Name(one.stand),
            doc.Name(one.joint),
            doc.number_cell(one.off, "+.2f", scale=1e3),
            doc.number_cell(one.deviations, "+.1f"),
        )
        for one in found[:MOST_ROWS]
    )
    columns = (
        doc.Column(text("planned-stand"), left=True),
        doc.Column(text("joint"), left=True),
        doc.Column(text("measured-less-predicted"), "mrad"),
        doc.Column(text("in-standard-deviations"), "1"),
    )
    yield doc.Table(text("residuals-of-joints"), columns, rows, detail=True)


def _residuals(fit: StandFit) -> plots.BarPlot:
    """Returns how well each stand is explained, the worst before."""
    worst = sorted(fit.residuals.items(), key=lambda one: -one[1])
    return plots.BarPlot(
        text("residuals-of-stands"),
        plots.Axis(text("residual-rms"), "sigma", ".2f"),
        [plots.Bar(doc.Name(name), value) for name, value in worst],
        (text("residual-rms"), None, None),
    )
