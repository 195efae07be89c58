"""What documents of fits have in common: parameters, and what measurements cannot tell."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence

from pupper_analysis.base.units import READ_IN
from pupper_analysis.present import document as doc
from pupper_analysis.present.document import join_words, text
from pupper_analysis.present.documents.registry import build_document
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.fit.parameters import OF_SURROUNDINGS
from pupper_analysis.tools.fit.record.recorder import Recording
from pupper_analysis.tools.fit.result import (
    Combination,
    Correlation,
    Determined,
    Estimate,
    Fit,
    MotionFit,
)
from pupper_analysis.tools.fit.stands.fit import JointResidual, StandFit
from pupper_analysis.tools.fit.stands.plan import StandPlan

TITLES = {
    "mass": "fitted-mass",
    "com": "fitted-com",
    "offset": "fitted-offset",
    "kp": "fitted-kp",
    "kd": "fitted-kd",
    "friction": "fitted-friction",
    "damping": "fitted-damping",
    "armature": "fitted-armature",
    "delay": "fitted-delay",
}
"""{kind of parameter: title of its table}."""

DETERMINED_BY = {
    Determined.DATA: "determined-by-data",
    Determined.PARTLY: "determined-by-partly",
    Determined.PRIOR: "determined-by-prior",
}


def describe_fit(
    fit: Fit, title: doc.Words, messages: Iterable[doc.Words], left: Iterable[doc.Block]
) -> doc.Document:
    """Returns the document of a fit.

    Args:
        fit: The fit.
        title: Its title.
        messages: What it rests on, and how well it explains that.
        left: What is left unexplained, and where.
    """
    return doc.Document(
        title,
        doc.Name(fit.name),
        (*parameter_tables(fit.estimates), *_correlations(fit.correlations), *left),
        passed=fit.explained,
        verdict=text("model-explains") if fit.explained else text("model-does-not-explain"),
        failures=tuple(doc.tell(one) for one in fit.failures),
        findings=(*messages, *open_lines(fit.estimates, fit.combinations)),
        notes=tuple(doc.tell(one) for one in fit.diagnostics),
    )


def parameter_tables(estimates: Iterable[Estimate]) -> list[doc.Block]:
    """Returns tables of estimates: what measurements tell by kind, and the rest in detail."""
    given = list(estimates)
    own = [one for one in given if one.kind not in OF_SURROUNDINGS]
    finding = [one for one in own if one.determined is Determined.DATA]
    blocks: list[doc.Block] = [
        _table(text(TITLES[kind]), [one for one in finding if one.kind == kind])
        for kind in dict.fromkeys(one.kind for one in finding)
    ]
    for title, rest in (
        ("determined-in-part", [one for one in own if one.determined is Determined.PARTLY]),
        ("prior-alone", [one for one in own if one.determined is Determined.PRIOR]),
        ("fitted-surroundings", [one for one in given if one.kind in OF_SURROUNDINGS]),
    ):
        if rest:
            blocks.append(_table(text(title), rest, detail=True))
    return blocks


def open_lines(
    estimates: Iterable[Estimate], combinations: Iterable[Combination]
) -> list[doc.Words]:
    """Returns what measurements leave open: combinations, and what the prior holds."""
    own = [one for one in estimates if one.kind not in OF_SURROUNDINGS]
    partly = [one for one in own if one.determined is Determined.PARTLY]
    untold = [one for one in own if one.determined is Determined.PRIOR]
    return [*_open(combinations), *_held(partly, untold)]


def _open(combinations: Iterable[Combination]) -> Iterable[doc.Words]:
    """Yields what cannot be distinguished, and what else to measure."""
    for one in combinations:
        names = doc.Name(", ".join(one.names[:_MOST]) + (", ..." if one.names[_MOST:] else ""))
        yield text(
            "only-ratio-determined" if one.ratio else "only-together-determined", names=names
        )
        if one.measurements:
            named = [
                text("remedy-and-factor", remedy=text(code), factor=f"{factor:.1f}")
                for code, factor in one.measurements.items()
            ]
            yield text("what-would-tell", measurements=join_words(named))


_MOST = 6


def _held(partly: list[Estimate], untold: list[Estimate]) -> Iterable[doc.Words]:
    if partly or untold:
        yield text("held-by-prior", partly=str(len(partly)), count=str(len(untold)))


def _table(title: doc.Words, estimates: list[Estimate], *, detail: bool = False) -> doc.Table:
    """Returns estimates with their intervals, what moved most before."""
    units = {one.unit: READ_IN.get(one.unit, (1.0, one.unit)) for one in estimates}
    shared = next(iter(units.values()))[1] if len(units) == 1 else ""
    rows: tuple[tuple[doc.Cell, ...], ...] = tuple(
        (
            doc.Name(one.name),
            *([] if shared else [doc.Name(units[one.unit][1])]),
            doc.number_cell(one.stated, ".4g", scale=units[one.unit][0]),
            doc.number_cell(one.mean, ".4g", scale=units[one.unit][0]),
            doc.number_cell(one.high - one.mean, ".2g", scale=units[one.unit][0]),
            doc.number_cell(one.mean - one.stated, "+.3g", scale=units[one.unit][0]),
            text(DETERMINED_BY[one.determined]),
        )
        for one in estimates
    )
    columns = (
        doc.Column(text("parameter"), left=True),
        *([] if shared else [doc.Column(text("unit"), left=True)]),
        doc.Column(text("in-the-file"), shared),
        doc.Column(text("fitted"), shared),
        doc.Column(text("half-of-95"), shared),
        doc.Column(text("fitted-difference"), shared),
        doc.Column(text("determined-by"), left=True),
    )
    return doc.Table(title, columns, rows, detail=detail)


def _correlations(found: Sequence[Correlation]) -> Iterator[doc.Table]:
    """Yields which parameters are off together, the strongest before."""
    if not found:
        return
    rows: tuple[tuple[doc.Cell, ...], ...] = tuple(
        (doc.Name(one.one), doc.Name(one.other), doc.number_cell(one.correlation, "+.2f"))
        for one in found[:MOST_ROWS]
    )
    columns = (
        doc.Column(text("parameter"), left=True),
        doc.Column(text("other-parameter"), left=True),
        doc.Column(text("correlation"), "1"),
    )
    yield doc.Table(text("parameters-off-together"), columns, rows, detail=True)


MOST_ROWS = 20
"""Of a table of what is strongest: all of it is in the JSON."""


def plot_joints(
    title: doc.Words,
    axis: doc.Axis,
    by_joint: Mapping[str, float],
    noise: Mapping[str, float],
    noise_name: doc.Words,
    scale: float = 1.0,
) -> doc.BarPlot:
    """Returns what is off at each joint, beside its sensor's noise.

    Args:
        title: Of the plot.
        axis: What is off.
        by_joint: {joint: root mean square of it}; those that are not numbers are left out.
        noise: {joint: of its sensor, likewise}.
        noise_name: What that is.
        scale: What both are multiplied by to be in the axis's unit.
    """
    bars = [
        doc.Bar(doc.Name(name), scale * off, scale * noise[name])
        for name, off in by_joint.items()
        if math.isfinite(off)
    ]
    return doc.BarPlot(title, axis, bars, (axis.name, noise_name, None))


@build_document.register(MotionFit)
def motion_fit_document(fit: MotionFit, _: Robot | None = None) -> doc.Document:
    """Returns what logs of motions tell of a robot; see ``build_document``."""
    finding = (
        *_errors(fit),
        text("motion-rests-on", seconds=f"{fit.seconds:.1f}", source=doc.Name(fit.source)),
    )
    return describe_fit(fit, text("fit-of-motions"), finding, [_joints(fit)])


def _errors(fit: MotionFit) -> Iterator[doc.Words]:
    """Yields what is off in what was not fitted, beside the robot's own repeatability."""
    if math.isfinite(fit.held_out):
        yield text(
            "held-out-error",
            after=f"{math.degrees(fit.held_out):.3f}",
            before=f"{math.degrees(fit.held_out_before):.3f}",
        )
    else:
        yield text("nothing-held-out", after=f"{math.degrees(fit.fitted):.3f}")
    if math.isfinite(fit.repeatability):
        yield text("repeatability-is", own=f"{math.degrees(fit.repeatability):.3f}")
    else:
        yield text("repeatability-unknown")


def _joints(fit: MotionFit) -> doc.BarPlot:
    """Returns what is off at each joint, and its encoder's noise."""
    return plot_joints(
        text("off-at-joints"),
        doc.Axis(text("root-mean-square"), "deg", ".3f"),
        fit.by_joint,
        fit.encoder_noise,
        text("encoder-noise"),
        scale=math.degrees(1.0),
    )


@build_document.register(StandFit)
def stand_fit_document(fit: StandFit, _: Robot | None = None) -> doc.Document:
    """Returns what stands at rest tell of a robot; see ``build_document``."""
    finding = (
        text("fit-rests-on", stands=str(fit.stands), source=doc.Name(fit.source)),
        _total(fit.total_mass),
        _com(fit.com),
        *_kp_factor(fit),
        *_worst(fit.joint_residuals[:1]),
    )
    left: list[doc.Block] = [_residuals(fit), *_joint_residuals(fit.joint_residuals)]
    return describe_fit(fit, text("fit-of-stands"), finding, left)


def _total(mass: Estimate) -> doc.Words:
    values = {
        "mean": f"{mass.mean:.3f}",
        "half": f"{mass.high - mass.mean:.3f}",
        "stated": f"{mass.stated:.3f}",
    }
    if mass.determined is Determined.DATA:
        return text("total-mass-determined", **values)
    return text("total-mass-undetermined", **values)


def _com(com: Sequence[Estimate]) -> doc.Words:
    values = {one.component: f"{1e3 * one.mean:.1f}" for one in com}
    halves = {f"d{one.component}": f"{1e3 * (one.high - one.mean):.1f}" for one in com}
    stated = ", ".join(f"{1e3 * one.stated:.1f}" for one in com)
    return text("whole-com", **values, **halves, stated=stated)


def _kp_factor(fit: StandFit) -> Iterator[doc.Words]:
    if (factor := fit.kp_factor) is not None:
        values = {"mean": f"{factor.mean:.3f}", "half": f"{factor.high - factor.mean:.3f}"}
        if any(one.kind == "added" for one in fit.estimates):
            yield text("kp-factor-by-a-known-mass", **values)
        elif fit.weight is None:
            yield text("kp-factor", **values)
        else:
            yield text("kp-factor-weighed", **values, weight=f"{fit.weight:.4g}")


def _worst(first: Iterable[JointResidual]) -> Iterator[doc.Words]:
    for one in first:
        yield text(
            "worst-residual",
            joint=doc.Name(one.joint),
            stand=doc.Name(one.stand),
            off=f"{math.degrees(one.off):+.3f}",
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
            doc.number_cell(one.off, "+.3f", scale=math.degrees(1.0)),
            doc.number_cell(one.deviations, "+.1f"),
        )
        for one in found[:MOST_ROWS]
    )
    columns = (
        doc.Column(text("planned-stand"), left=True),
        doc.Column(text("joint"), left=True),
        doc.Column(text("measured-less-predicted"), "deg"),
        doc.Column(text("in-standard-deviations"), "1"),
    )
    yield doc.Table(text("residuals-of-joints"), columns, rows, detail=True)


def _residuals(fit: StandFit) -> doc.BarPlot:
    """Returns how well each stand is explained, the worst before."""
    worst = sorted(fit.residuals.items(), key=lambda one: -one[1])
    return doc.BarPlot(
        text("residuals-of-stands"),
        doc.Axis(text("residual-rms"), "sigma", ".2f"),
        [doc.Bar(doc.Name(name), value) for name, value in worst],
        (text("residual-rms"), None, None),
    )


@build_document.register(StandPlan)
def plan_document(plan: StandPlan, _: Robot | None = None) -> doc.Document:
    """Returns which stands to take, and the interval that they leave of each parameter."""
    finding = sum(one.determined is Determined.DATA for one in plan.expected)
    return doc.Document(
        text("plan-of-stands"),
        doc.Name(plan.name),
        (_stands(plan), _expected(plan)),
        findings=(
            text(
                "planned-stands",
                stands=str(len(plan.stands)),
                candidates=str(plan.candidates),
                determined=str(finding),
                parameters=str(len(plan.expected)),
            ),
            *_where_added(plan),
            text("how-to-take-stands"),
        ),
    )


def _where_added(plan: StandPlan) -> Iterator[doc.Words]:
    if (place := plan.place) is not None:
        loaded = [one for one in plan.stands if one.added]
        x, y, z = (f"{1e3 * value:.1f}" for value in place.offset)
        mass = f"{max((one.added for one in loaded), default=0.0):.4g}"
        on = str(len(loaded))
        yield text("put-it-there", mass=mass, link=doc.Name(place.link), x=x, y=y, z=z, stands=on)


def _stands(plan: StandPlan) -> doc.Table:
    joints = list(plan.stands[0].command)
    turned = any(one.heading for one in plan.stands)
    loaded = any(one.added for one in plan.stands)
    columns = (
        doc.Column(text("planned-stand"), left=True),
        doc.Column(text("feet-in-the-air"), left=True),
        *([doc.Column(text("turned-by"), "deg")] if turned else []),
        *([doc.Column(text("known-mass-on"), "kg")] if loaded else []),
        doc.Column(text("utilisation"), "%"),
        *(doc.Column(doc.Name(joint), "deg", detail=True) for joint in joints),
    )
    factor, _ = READ_IN["rad"]
    rows: tuple[tuple[doc.Cell, ...], ...] = tuple(
        (
            doc.Name(one.name),
            doc.Name(" ".join(one.swing)),
            *([doc.number_cell(one.heading, ".0f", scale=factor)] if turned else []),
            *([doc.number_cell(one.added, ".4g")] if loaded else []),
            doc.number_cell(one.utilisation, ".0f", scale=100.0),
            *(doc.number_cell(one.command[joint], ".2f", scale=factor) for joint in joints),
        )
        for one in plan.stands
    )
    return doc.Table(text("stands-to-take"), columns, rows)


def _expected(plan: StandPlan) -> doc.Table:
    rows: list[tuple[doc.Cell, ...]] = []
    for one in plan.expected:
        factor, unit = READ_IN.get(one.unit, (1.0, one.unit))
        rows.append(
            (
                doc.Name(one.name),
                doc.Name(unit),
                doc.number_cell(one.stated, ".4g", scale=factor),
                doc.number_cell(one.before, ".2g", scale=factor),
                doc.number_cell(one.after, ".2g", scale=factor),
                text(DETERMINED_BY[one.determined]),
            )
        )
    columns = (
        doc.Column(text("parameter"), left=True),
        doc.Column(text("unit"), left=True),
        doc.Column(text("in-the-file")),
        doc.Column(text("known-before")),
        doc.Column(text("known-after")),
        doc.Column(text("determined-by"), left=True),
    )
    return doc.Table(text("what-stands-will-tell"), columns, tuple(rows), detail=True)


@build_document.register(Recording)
def recording_document(one: Recording, _: Robot | None = None) -> doc.Document:
    """Returns which stands were taken; see ``build_document``."""
    counts = {"taken": len(one.taken), "had": len(one.had), "left": len(one.left)}
    values = {name: str(count) for name, count in counts.items()}
    return doc.Document(
        text("recording-of-stands"),
        doc.Name(one.name),
        (),
        passed=one.complete,
        verdict=text("recording-complete") if one.complete else text("recording-incomplete"),
        failures=tuple(doc.tell(finding) for finding in one.findings),
        findings=(text("stands-taken", file=doc.Name(one.file), **values),),
    )
