"""What documents of fits have in common: parameters, and what measurements cannot tell."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence

from pupper_analysis.base.units import READ_IN
from pupper_analysis.present import document as doc
from pupper_analysis.present.document import text
from pupper_analysis.present.documents.registry import build_document
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.fit.parameters import SURROUNDINGS_KINDS
from pupper_analysis.tools.fit.record.recorder import Recording
from pupper_analysis.tools.fit.result import Determined, Estimate, Fit, MotionFit
from pupper_analysis.tools.fit.stands.fit import StandFit
from pupper_analysis.tools.fit.stands.plan import StandPlan


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
    own = [one for one in fit.estimates if one.kind not in SURROUNDINGS_KINDS]
    parts = {by: [one for one in own if one.determined is by] for by in Determined}
    finding, partly, untold = parts.values()
    tables = [
        (text(f"fitted-{kind}"), [one for one in finding if one.kind == kind], False)
        for kind in dict.fromkeys(one.kind for one in finding)
    ]
    tables += [
        (text("determined-in-part"), partly, True),
        (text("prior-alone"), untold, True),
        (text("fitted-surroundings"), [one for one in fit.estimates if one not in own], True),
    ]
    held = text("held-by-prior", partly=str(len(partly)), count=str(len(untold)))
    return doc.Document(
        title,
        doc.Name(fit.name),
        (*(_table(name, rows, detail=more) for name, rows, more in tables if rows), *left),
        passed=fit.explained,
        verdict=text("model-explains") if fit.explained else text("model-does-not-explain"),
        failures=tuple(doc.tell(one) for one in fit.failures),
        findings=(*messages, *([held] if partly or untold else [])),
        notes=tuple(doc.tell(one) for one in fit.diagnostics),
    )


def _table(
    title: doc.Words, estimates: Sequence[Estimate], *, detail: bool = False, planned: bool = False
) -> doc.Table:
    """Returns estimates with their intervals, or those that a plan will leave."""
    units = {one.unit: READ_IN.get(one.unit, (1.0, one.unit)) for one in estimates}
    shared = next(iter(units.values()))[1] if len(units) == 1 else ""
    rows: list[tuple[doc.Cell, ...]] = []
    for one in estimates:
        scale, unit = units[one.unit]
        values = [(one.stated, ".4g"), (one.mean, ".4g"), (one.high - one.mean, ".2g")]
        values += [(one.mean - one.stated, "+.3g")]
        cells = [doc.number_cell(value, form, scale=scale) for value, form in values]
        chosen = [cells[0], cells[2]] if planned else cells
        named = [doc.Name(one.name), *([] if shared else [doc.Name(unit)])]
        rows.append((*named, *chosen, text(f"determined-by-{one.determined}")))
    after = text("fitted"), text("half-of-95"), text("fitted-difference")
    numbers = text("in-the-file"), *((text("known-after"),) if planned else after)
    columns = (
        doc.Column(text("parameter"), left=True),
        *([] if shared else [doc.Column(text("unit"), left=True)]),
        *(doc.Column(name, shared) for name in numbers),
        doc.Column(text("determined-by"), left=True),
    )
    return doc.Table(title, columns, tuple(rows), detail=detail)


@build_document.register(MotionFit)
def motion_fit_document(fit: MotionFit, _: Robot | None = None) -> doc.Document:
    """Returns what logs of motions tell of a robot; see ``build_document``."""
    finding = (
        *_errors(fit),
        text("motion-rests-on", seconds=f"{fit.seconds:.1f}", source=doc.Name(fit.source)),
        *([text("kp-over-mass", **_with_half(ratio))] if (ratio := fit.kp_over_mass) else []),
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
    bars = [
        doc.Bar(doc.Name(name), math.degrees(off), math.degrees(fit.encoder_noise[name]))
        for name, off in fit.by_joint.items()
        if math.isfinite(off)
    ]
    axis = doc.Axis(text("root-mean-square"), "deg", ".3f")
    return doc.BarPlot(text("off-at-joints"), axis, bars, (axis.name, text("encoder-noise"), None))


@build_document.register(StandFit)
def stand_fit_document(fit: StandFit, _: Robot | None = None) -> doc.Document:
    """Returns what stands at rest tell of a robot; see ``build_document``."""
    finding = (
        text("fit-rests-on", stands=str(fit.stands), source=doc.Name(fit.source)),
        _total(fit.total_mass),
        _com(fit.com),
        *_kp_factor(fit),
        *(
            text(
                "worst-residual",
                joint=doc.Name(one.joint),
                stand=doc.Name(one.stand),
                off=f"{math.degrees(one.off):+.3f}",
                times=f"{abs(one.deviations):.1f}",
            )
            for one in fit.joint_residuals[:1]
        ),
        *([text("kp-over-mass", **_with_half(ratio))] if (ratio := fit.kp_over_mass) else []),
    )
    return describe_fit(fit, text("fit-of-stands"), finding, [_residuals(fit)])


def _with_half(one: Estimate) -> dict[str, str]:
    return {"mean": f"{one.mean:.3f}", "half": f"{one.high - one.mean:.3f}"}


def _total(mass: Estimate) -> doc.Words:
    values = {**_with_half(mass), "stated": f"{mass.stated:.3f}"}
    known = mass.determined is Determined.DATA
    return text("total-mass-determined" if known else "total-mass-undetermined", **values)


def _com(com: Sequence[Estimate]) -> doc.Words:
    values = {one.component: f"{1e3 * one.mean:.1f}" for one in com}
    halves = {f"d{one.component}": f"{1e3 * (one.high - one.mean):.1f}" for one in com}
    stated = ", ".join(f"{1e3 * one.stated:.1f}" for one in com)
    return text("whole-com", **values, **halves, stated=stated)


def _kp_factor(fit: StandFit) -> Iterator[doc.Words]:
    if (factor := fit.kp_factor) is not None:
        values = _with_half(factor)
        if any(one.kind == "added" for one in fit.estimates):
            yield text("kp-factor-by-a-known-mass", **values)
        elif fit.weight is None:
            yield text("kp-factor", **values)
            yield text("what-would-tell")
        else:
            yield text("kp-factor-weighed", **values, weight=f"{fit.weight:.4g}")


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
    expected = _table(text("what-stands-will-tell"), plan.expected, detail=True, planned=True)
    return doc.Document(
        text("plan-of-stands"),
        doc.Name(plan.name),
        (_stands(plan), expected),
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
    columns = (
        doc.Column(text("planned-stand"), left=True),
        doc.Column(text("feet-in-the-air"), left=True),
        doc.Column(text("turned-by"), "deg"),
        doc.Column(text("known-mass-on"), "kg"),
        doc.Column(text("utilisation"), "%"),
        *(doc.Column(doc.Name(joint), "deg", detail=True) for joint in joints),
    )
    factor, _ = READ_IN["rad"]
    rows: tuple[tuple[doc.Cell, ...], ...] = tuple(
        (
            doc.Name(one.name),
            doc.Name(" ".join(one.swing)),
            doc.number_cell(one.heading, ".0f", scale=factor),
            doc.number_cell(one.added, ".4g"),
            doc.number_cell(one.utilisation, ".0f", scale=100.0),
            *(doc.number_cell(one.command[joint], ".2f", scale=factor) for joint in joints),
        )
        for one in plan.stands
    )
    return doc.Table(text("stands-to-take"), columns, rows)


@build_document.register(Recording)
def recording_document(one: Recording, _: Robot | None = None) -> doc.Document:
    """Returns which stands were taken; see ``build_document``."""
    counts = {"taken": len(one.taken), "had": len(one.had), "left": len(one.left)}
    values = {name: str(count) for name, count in counts.items()}
    said = "stands-taken" if one.left else "all-stands-taken"
    return doc.Document(
        text("recording-of-stands"),
        doc.Name(one.name),
        (),
        passed=one.complete,
        verdict=text("recording-complete") if one.complete else text("recording-incomplete"),
        failures=tuple(doc.tell(finding) for finding in one.findings),
        findings=(text(said, file=doc.Name(one.file), **values),),
    )
