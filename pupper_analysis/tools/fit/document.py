"""Documents of fits, plans and recordings.

Inputs are a fit of motions or stands, a plan of stands, or a recording of stands or of a policy.
Outputs are documents that are independent of the output format, with values in displayed units.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence

from pupper_analysis.base.diagnostics import Quantity, diagnose
from pupper_analysis.base.units import READ_IN
from pupper_analysis.present import document as doc
from pupper_analysis.present.document import text
from pupper_analysis.present.documents.registry import build_document
from pupper_analysis.robot.joints import joint_unit
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.fit.parameters import SURROUNDINGS_KINDS
from pupper_analysis.tools.fit.record.listen import TraceRecording
from pupper_analysis.tools.fit.record.recorder import Recording
from pupper_analysis.tools.fit.result import Determined, Estimate, Fit, MotionFit
from pupper_analysis.tools.fit.stands.fit import StandFit
from pupper_analysis.tools.fit.stands.plan import StandPlan


def describe_fit(
    fit: Fit,
    title: doc.Words,
    answer: Iterable[doc.Words],
    details: Iterable[doc.Words],
    extra_blocks: Iterable[doc.Block],
) -> doc.Document:
    """Create the report of a fit: estimates by kind, plots, verdict, failures and notes.

    ``answer`` contains key figures of the fit, ``details`` further statements, and ``extra_blocks``
    plots of the residuals.
    """
    robot_estimates = [
        estimate for estimate in fit.estimates if estimate.kind not in SURROUNDINGS_KINDS
    ]
    parts = {
        determined: [estimate for estimate in robot_estimates if estimate.determined is determined]
        for determined in Determined
    }
    by_data, partly, by_prior = parts.values()
    tables = [
        (text(f"fitted-{kind}"), [estimate for estimate in by_data if estimate.kind == kind], False)
        for kind in dict.fromkeys(estimate.kind for estimate in by_data)
    ]
    tables += [
        (text("determined-in-part"), partly, True),
        (text("prior-alone"), by_prior, True),
        (
            text("fitted-surroundings"),
            [estimate for estimate in fit.estimates if estimate not in robot_estimates],
            True,
        ),
    ]
    counts = text(
        "parameters-determined",
        count=len(by_data),
        parameters=len(robot_estimates),
        partly=len(partly),
        prior=len(by_prior),
    )
    return doc.Document(
        title,
        doc.Name(fit.name),
        (
            *(
                _make_estimate_table(name, rows, detail=detail)
                for name, rows, detail in tables
                if rows
            ),
            *extra_blocks,
        ),
        passed=fit.explained,
        verdict=text("model-explains") if fit.explained else text("model-does-not-explain"),
        failures=tuple(doc.diagnostic_text(failure) for failure in fit.failures),
        findings=(*answer, *_describe_largest_change(by_data), counts),
        details=tuple(details),
        brief=True,
        notes=tuple(doc.diagnostic_text(note) for note in fit.diagnostics),
    )


def _describe_largest_change(estimates: Sequence[Estimate]) -> Iterator[doc.Words]:
    """Yield the text of the estimate that changed most, in posterior standard deviations."""
    changes = [
        (abs(estimate.mean - estimate.stated) / estimate.std, estimate)
        for estimate in estimates
        if estimate.std > 0
    ]
    if changes:
        _, estimate = max(changes, key=lambda change: change[0])
        scale, unit = READ_IN.get(estimate.unit, (1.0, estimate.unit))
        yield text(
            "largest-change",
            name=doc.Name(estimate.name),
            mean=f"{scale * estimate.mean:.4g}",
            half=f"{scale * (estimate.high - estimate.mean):.2g}",
            unit="" if unit == "1" else unit,
            stated=f"{scale * estimate.stated:.4g}",
        )


def _make_estimate_table(
    title: doc.Words, estimates: Sequence[Estimate], *, detail: bool = False, planned: bool = False
) -> doc.Table:
    """Create the table of estimates with intervals, a row per parameter.

    If ``planned`` is True, the intervals are predicted, before any measurement. If ``detail`` is
    True, the short terminal view omits the table.
    """
    units = {
        estimate.unit: READ_IN.get(estimate.unit, (1.0, estimate.unit)) for estimate in estimates
    }
    shared = next(iter(units.values()))[1] if len(units) == 1 else ""
    rows: list[tuple[doc.Cell, ...]] = []
    for estimate in estimates:
        scale, unit = units[estimate.unit]
        values = [
            (estimate.stated, ".4g"),
            (estimate.mean, ".4g"),
            (estimate.high - estimate.mean, ".2g"),
        ]
        values += [(estimate.mean - estimate.stated, "+.3g")]
        cells = [doc.number_cell(value, form, scale=scale) for value, form in values]
        chosen = [cells[0], cells[2]] if planned else cells
        named = [doc.Name(estimate.name), *([] if shared else [doc.Name(unit)])]
        rows.append((*named, *chosen, text(f"determined-by-{estimate.determined}")))
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
    """Create the report of a fit of model parameters to measured motions."""
    error, repeatability = _describe_errors(fit)
    details = (
        repeatability,
        text("motion-rests-on", seconds=f"{fit.seconds:.1f}", source=doc.Name(fit.source)),
        *([text("kp-over-mass", **_format_estimate(ratio))] if (ratio := fit.kp_over_mass) else []),
    )
    return describe_fit(
        fit, text("fit-of-motions"), [error], details, [*_make_joint_error_plots(fit)]
    )


def _describe_errors(fit: MotionFit) -> Iterator[doc.Words]:
    """Yield the texts of RMS prediction error and repeatability of the measurements, in degrees."""
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


def _format_position(position: float, unit: str) -> str:
    """Format a signed position [rad, m] in degrees or mm, with the unit."""
    factor, shown = READ_IN[unit]
    return f"{factor * position:+.3f} {shown}"


def _make_joint_error_plots(fit: MotionFit) -> Iterator[doc.BarPlot]:
    """Yield the bar plots of position errors and encoder noise: hinges, then slides, if any."""
    for slides in (False, True):
        factor, unit = READ_IN["m" if slides else "rad"]
        bars = [
            doc.PlotBar(doc.Name(name), factor * error, factor * fit.encoder_noise[name])
            for name, error in fit.by_joint.items()
            if math.isfinite(error) and (name in fit.slides) == slides
        ]
        if bars or not slides:
            axis = doc.Axis(text("root-mean-square"), unit, ".3f")
            legend = (axis.name, text("encoder-noise"), None)
            yield doc.BarPlot(text("off-at-joints"), axis, bars, legend)


@build_document.register(StandFit)
def stand_fit_document(fit: StandFit, _: Robot | None = None) -> doc.Document:
    """Create the report of a fit of model parameters to measured stands."""
    mass, factors = _describe_total_mass(fit), list(_describe_kp_factor(fit))
    undetermined = tuple(_describe_undetermined_mass(fit.total_mass))
    answer: tuple[doc.Words, ...] = (mass, *undetermined, *factors)
    if fit.kp_factor is not None and fit.weight is None:
        both = _describe_mass_and_kp(fit, fit.kp_factor)
        answer = (both, *undetermined, *factors[1:])
    elif fit.kp_factor is not None:
        answer = (*factors, mass, *undetermined)  # the user typed the mass, and asks for kp
    details = (
        text("fit-rests-on", stands=str(fit.stands), source=doc.Name(fit.source)),
        _describe_com(fit.com),
        *(
            text(
                "worst-residual",
                joint=doc.Name(residual.joint),
                stand=doc.Name(residual.stand),
                off=_format_position(residual.residual, residual.unit),
                times=f"{abs(residual.deviations):.1f}",
            )
            for residual in fit.joint_residuals[:1]
        ),
        *([text("kp-over-mass", **_format_estimate(ratio))] if (ratio := fit.kp_over_mass) else []),
    )
    return describe_fit(
        fit, text("fit-of-stands"), answer, details, [_make_stand_residual_plot(fit)]
    )


def _format_estimate(estimate: Estimate) -> dict[str, str]:
    """Format mean and half width of the 95 % interval of an estimate: {"mean" or "half": text}."""
    return {"mean": f"{estimate.mean:.3f}", "half": f"{estimate.high - estimate.mean:.3f}"}


def _format_rounded_estimate(estimate: Estimate) -> dict[str, str]:
    """Format an estimate and the stated value with two decimals, more for a narrow interval."""
    half = estimate.high - estimate.mean
    decimals = max(2, 1 - math.floor(math.log10(half))) if half > 0 else 2
    values = {"mean": estimate.mean, "half": half, "stated": estimate.stated}
    return {name: f"{value:.{decimals}f}" for name, value in values.items()}


def _describe_mass_and_kp(fit: StandFit, kp_factor: Estimate) -> doc.Words:
    """Return the text of total mass [kg] and mean ratio of estimated to stated kp."""
    mass, kp = _format_estimate(fit.total_mass), _format_estimate(kp_factor)
    rounded = _format_rounded_estimate(kp_factor)
    return text(
        "total-mass-and-kp",
        mass=mass["mean"],
        mass_half=mass["half"],
        mass_stated=f"{fit.total_mass.stated:.3f}",
        kp=kp["mean"],
        kp_half=kp["half"],
        added=any(estimate.kind == "added" for estimate in fit.estimates),
        **_format_rounded_estimate(fit.total_mass),
        factor=rounded["mean"],
        factor_half=rounded["half"],
    )


def _describe_total_mass(fit: StandFit) -> doc.Words:
    """Return the text of the total mass [kg]: estimate, interval, stated value, and weight.

    The text also states if the weight is the stated value: the estimate then repeats the input.
    """
    mass = fit.total_mass
    values = {**_format_estimate(mass), "stated": f"{mass.stated:.3f}"}
    if fit.weight is None:
        return text("total-mass-determined", **values)
    repeated = f"{fit.weight:.4g}" == f"{mass.stated:.4g}"  # as the proposed command writes it
    key = "total-mass-of-the-file" if repeated else "total-mass-weighed"
    return text(key, **values, weight=f"{fit.weight:.4g}")


def _describe_undetermined_mass(mass: Estimate) -> Iterator[doc.Words]:
    """Yield the text of a total mass that the measurements do not determine, with the remedies."""
    if mass.determined is not Determined.DATA:
        stated = mass.stated
        yield text("total-mass-undetermined", stated=f"{stated:.3f}", replaced=f"{stated:.4g}")


def _describe_com(com: Sequence[Estimate]) -> doc.Words:
    """Return the text of the CoM of the whole robot [mm]; ``com`` contains the components [m]."""
    values = {estimate.component: f"{1e3 * estimate.mean:.1f}" for estimate in com}
    halves = {
        f"d{estimate.component}": f"{1e3 * (estimate.high - estimate.mean):.1f}" for estimate in com
    }
    stated = ", ".join(f"{1e3 * estimate.stated:.1f}" for estimate in com)
    return text("whole-com", **values, **halves, stated=stated)


def _describe_kp_factor(fit: StandFit) -> Iterator[doc.Words]:
    """Yield the text of the mean ratio of estimated to stated kp, if the fit estimates kp.

    A second text may suggest measurements that separate kp from mass.
    """
    if (factor := fit.kp_factor) is not None:
        values = _format_estimate(factor)
        if any(estimate.kind == "added" for estimate in fit.estimates):
            yield text("kp-factor-by-a-known-mass", **values)
        elif fit.weight is None:
            yield text("kp-factor", **values)
            if fit.total_mass.determined is Determined.DATA:
                yield text("what-would-tell")  # otherwise stated with the undetermined mass
        else:
            yield text("kp-factor-weighed", **values, weight=f"{fit.weight:.4g}")


def _make_stand_residual_plot(fit: StandFit) -> doc.BarPlot:
    """Create the bar plot of the RMS residual of each stand, in standard deviations."""
    worst = sorted(fit.residuals.items(), key=lambda item: -item[1])
    return doc.BarPlot(
        text("residuals-of-stands"),
        doc.Axis(text("residual-rms"), "sigma", ".2f"),
        [doc.PlotBar(doc.Name(name), value) for name, value in worst],
        (text("residual-rms"), None, None),
    )


@build_document.register(StandPlan)
def plan_document(plan: StandPlan, _: Robot | None = None) -> doc.Document:
    """Create the report of a measurement plan: stands, and predicted interval per parameter."""
    num_determined = plan.determined.total()
    known_mass, others = _describe_known_mass(plan), _describe_other_parameters(plan)
    expected = _make_estimate_table(
        text("what-stands-will-tell"), plan.expected, detail=True, planned=True
    )
    return doc.Document(
        text("plan-of-stands"),
        doc.Name(plan.name),
        (_make_stand_table(plan), expected),
        passed=True,
        verdict=text("fit-planned"),
        warned=not num_determined,
        findings=(
            text(
                "planned-stands",
                stands=str(len(plan.stands)),
                candidates=str(plan.candidates),
                determined=str(num_determined),
                parameters=str(len(plan.expected)),
                kinds=_count_most_common_kind(plan),
                angles=sum(len(stand.command) for stand in plan.stands),
            ),
            *(others if plan.more_stands_help else known_mass),
            *(known_mass if plan.more_stands_help else others),
            text("typed-bridge"),
        ),
        details=(text("how-to-take-stands"),),
        brief=True,
    )


def _count_most_common_kind(plan: StandPlan) -> doc.Text | str:
    """Return the most common kind of determined parameters, such as ``8 of them kp``.

    Parameters count that the measurements alone determine. The result is empty without any.
    """
    if not plan.determined:
        return ""
    ((kind, count),) = plan.determined.most_common(1)
    return text("most-common-kind", count=count, kind=doc.word(kind))


def _describe_other_parameters(plan: StandPlan) -> Iterator[doc.Words]:
    """Yield the text about parameters that the stands do not determine, and the remedies.

    The remedies are more stands, and known values (``--prior``). The text names the most common
    kind that even all candidates do not determine. Without such parameters, there is no text.
    """
    of_robot = Counter(
        estimate.kind for estimate in plan.expected if estimate.kind not in SURROUNDINGS_KINDS
    )
    remaining = of_robot - Counter(plan.determined_by_all)
    if remaining:
        ((kind, count),) = remaining.most_common(1)
        yield text(
            "more-stands",
            stands=plan.candidates,
            determined=sum(plan.determined_by_all.values()),
            kind=kind,
            count=count,
        )


def _describe_known_mass(plan: StandPlan) -> Iterator[doc.Words]:
    """Yield the text of a plan's known mass [kg], with position [mm] and number of stands."""
    if (place := plan.place) is not None:
        loaded = [stand for stand in plan.stands if stand.added]
        x, y, z = (f"{1e3 * value:.1f}" for value in place.offset)
        mass = f"{max((stand.added for stand in loaded), default=0.0):.4g}"
        yield text(
            "put-it-there",
            mass=mass,
            link=doc.Name(place.link),
            x=x,
            y=y,
            z=z,
            stands=len(loaded),
        )


def _make_stand_table(plan: StandPlan) -> doc.Table:
    """Create the table of planned stands, a row per stand, with the commands [degrees or mm]."""
    scales = {
        joint: READ_IN["m" if joint in plan.slides else "rad"] for joint in plan.stands[0].command
    }
    columns = (
        doc.Column(text("planned-stand"), left=True),
        doc.Column(text("feet-in-the-air"), left=True),
        doc.Column(text("turned-by"), "deg"),
        doc.Column(text("known-mass-on"), "kg"),
        doc.Column(text("utilisation"), "%"),
        *(doc.Column(doc.Name(joint), scale[1], detail=True) for joint, scale in scales.items()),
    )
    degrees, _ = READ_IN["rad"]
    rows: tuple[tuple[doc.Cell, ...], ...] = tuple(
        (
            doc.Name(stand.name),
            doc.Name(" ".join(stand.swing)),
            doc.number_cell(stand.heading, ".0f", scale=degrees),
            doc.number_cell(stand.added, ".4g"),
            doc.number_cell(stand.utilisation, ".0f", scale=100.0),
            *(
                doc.number_cell(stand.command[joint], ".2f", scale=factor)
                for joint, (factor, _) in scales.items()
            ),
        )
        for stand in plan.stands
    )
    return doc.Table(text("stands-to-take"), columns, rows)


@build_document.register(Recording)
def recording_document(recording: Recording, robot: Robot | None = None) -> doc.Document:
    """Create the report of a recording of stands: recorded, existing and missing stands."""
    counts = {
        "taken": len(recording.recorded_stands),
        "had": len(recording.existing_stands),
        "left": len(recording.missing_stands),
    }
    values = {name: str(count) for name, count in counts.items()}
    message = "stands-taken" if recording.missing_stands else "all-stands-taken"
    summary = text(message, file=doc.Name(recording.file), **values)
    reasons = tuple(doc.diagnostic_text(finding) for finding in recording.findings)
    friction: tuple[doc.Words, ...] = ()
    if angles := recording.friction_angles:
        joint = max(angles, key=lambda name: angles[name])
        angle = Quantity(angles[joint], "rad" if robot is None else joint_unit(robot, joint))
        friction = (doc.diagnostic_text(diagnose("friction-of-joints", joint=joint, angle=angle)),)
    return doc.Document(
        text("recording-of-stands"),
        doc.Name(recording.name),
        (),
        passed=recording.complete,
        verdict=text("recording-complete") if recording.complete else text("recording-incomplete"),
        failures=(summary, *reasons) if recording.missing_stands else reasons,
        findings=friction if recording.missing_stands else (summary, *friction),
    )


@build_document.register(TraceRecording)
def recorded_trace_document(recording: TraceRecording, _: Robot | None = None) -> doc.Document:
    """Create the report of a recorded policy: samples, and signals that were not received."""
    summary = text(
        "trace-recorded",
        samples=str(recording.samples),
        period=f"{1e3 * recording.period:.3g}",
        file=doc.Name(recording.file),
    )
    missing = text("trace-lacks-signals", names=doc.Name(", ".join(recording.missing)))
    return doc.Document(
        text("recording-of-a-policy"),
        doc.Name(recording.name),
        (),
        passed=recording.complete,
        verdict=text("recording-complete") if recording.complete else text("recording-incomplete"),
        failures=() if recording.complete else (summary, missing),
        findings=(
            *((summary,) if recording.complete else ()),
            *map(doc.diagnostic_text, recording.findings),
        ),
    )
