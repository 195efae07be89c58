"""The document of an analysis: all that was found out about one robot."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from pupper_analysis.base.results import Result
from pupper_analysis.present import document as doc
from pupper_analysis.present.document import (
    Cell,
    Column,
    Name,
    Table,
    join_words,
    number_cell,
    text,
    word,
)
from pupper_analysis.present.documents.loads import (
    load_blocks,
    origins_text,
    proof_text,
    view_block,
)
from pupper_analysis.present.documents.registry import build_document
from pupper_analysis.present.documents.sources import (
    cite_page,
    files_text,
)
from pupper_analysis.present.documents.standing import (
    ground_word,
    height_plot,
    list_motions,
    quantity_columns,
    run_rows,
    stand_table,
    task_text,
)
from pupper_analysis.present.verdict import qualify_verdict_word, split_verdict_lines
from pupper_analysis.robot.robot import Robot
from pupper_analysis.simulation.verify import StandVerification
from pupper_analysis.statics.equilibrium import peak_utilisation
from pupper_analysis.tools.analyze.analysis import Analysis
from pupper_analysis.tools.analyze.gain_sweep import GainSweep


@build_document.register(Analysis)
def analysis_document(analysis: Analysis, robot: Robot | None = None) -> doc.Document:
    """Returns all that was found out about one robot; see ``build``."""
    runs = (analysis.verification, analysis.sagging)
    first, more = split_verdict_lines(analysis.verdict)
    blocks: list[doc.Block] = [
        view_block(robot, analysis.stand, analysis.statics, list_motions(runs)),
        *_structure(analysis, robot),
        stand_table(analysis.stand, analysis.statics),
        *load_blocks(
            analysis.statics,
            analysis.min_max_torque,
            analysis.verification,
            [joint.effort for joint in analysis.joints],
            [joint.effort_origin for joint in analysis.joints],
            {doc.Column(text("hanging"), "N m"): analysis.hanging_torques.tolist()},
        ),
        *simulation_blocks(analysis),
        deviation_table(analysis.sweep),
        _jacobians(analysis),
        _check(analysis),
    ]
    return doc.Document(
        text("analysis"),
        doc.Name(analysis.name),
        tuple(blocks),
        passed=analysis.verified,
        verdict=_verdict_word(analysis),
        failures=tuple(map(doc.diagnostic_text, analysis.failures)),
        findings=(*_key_figures(analysis), *first, *_fall(analysis.sagging)),
        details=tuple(more),
        brief=True,
        notes=tuple(map(doc.diagnostic_text, analysis.notes)),
    )


def _verdict_word(analysis: Analysis) -> doc.Text:
    if not analysis.verified:
        return text("FAILED")
    return qualify_verdict_word("VERIFIED", analysis.verdict.converted)


def _key_figures(analysis: Analysis) -> Iterable[doc.Words]:
    """Says in a line each: mass and peak torque; how high it stands; how well the files agree."""
    statics = analysis.statics
    share = statics.motor_utilisation
    limited = not np.isnan(share).all()
    most = int(np.nanargmax(share if limited else np.abs(statics.joint_torques)))
    peak = text(
        "mass-kg-peak-torque-torque",
        mass=f"{analysis.total_mass:.3f}",
        ground=ground_word(analysis.stand.depths.values()),
        torque=f"{statics.joint_torques[most]:+.3f}",
        joint=doc.Name(statics.joint_names[most]),
    )
    if limited:
        peak = text("peak-share-of-its-limit", peak=peak, share=f"{share[most]:.1%}")
    yield peak
    yield text(
        "stands-height-mm-high",
        height=f"{1e3 * analysis.stand.qpos[2]:.1f}",
        held=_height(analysis.verification),
        let_go=_height(analysis.sagging),
    )
    check = analysis.check
    worst = next(one for one in check.quantities if one.name == check.worst)
    yield text(
        "urdf-and-mjcf-worst-deviation",
        relative=f"{worst.relative:.1e}",
        quantity=word(worst.name),
    )


def _height(run: StandVerification) -> doc.Words:
    if not np.isfinite(run.base_height):
        return text("diverged")
    return doc.Name(f"{1e3 * run.base_height:.1f} mm")


def _fall(without: StandVerification) -> Iterable[doc.Words]:
    """Says that it does not stand without feed-forward, if so."""
    if not without.passed:
        why = join_words(map(doc.diagnostic_text, without.failures), "semicolon")
        yield text("does-not-stand-without-feed-forward", why=why).with_mark("warn")


def _structure(analysis: Analysis, robot: Robot | None) -> Iterable[doc.Block]:
    yield doc.Lines(
        (
            text(
                "model-sizes",
                nq=analysis.nq,
                nv=analysis.nv,
                nu=analysis.nu,
                mass=f"{analysis.total_mass:.3f}",
                com=doc.vector_cell(1e3 * analysis.center_of_mass, "+.1f"),
            ),
            text(
                "thigh-thigh-calf-calf",
                thigh=_millimetres(analysis.thigh_length),
                calf=_millimetres(analysis.calf_length),
            ),
            task_text(analysis.stand.task),
            files_text(robot),
        )
    )
    yield _joints(analysis)
    yield doc.Table(
        text("masses-of-the-bodies"),
        (
            doc.Column(text("base-or-joint-that-moves"), left=True),
            doc.Column(text("mass"), "kg"),
        ),
        tuple(
            (doc.Name(name), doc.number_cell(mass, ".3f"))
            for name, mass in analysis.link_masses.items()
        ),
        (text("fixed-links-are-counted"),),
        (files_text(robot), cite_page("explanation/statics.md", "Scaling a robot")),
    )


def _joints(analysis: Analysis) -> doc.Table:
    """Returns what each joint does and can."""
    rows: list[tuple[doc.Cell, ...]] = []
    for joint in analysis.joints:
        scale = 1e3 if joint.slides else math.degrees(1.0)
        cells: list[doc.Cell] = [
            doc.Name(joint.name),
            word(joint.motion),
            doc.vector_cell(joint.axis, "+.2f" if joint.oblique else "+.0f"),
            doc.number_cell(joint.lower, "+.1f", scale=scale),
            doc.number_cell(joint.upper, "+.1f", scale=scale),
            *(
                doc.number_cell(value, "g")
                for value in (
                    joint.effort,
                    joint.velocity,
                    joint.armature,
                    joint.damping,
                    joint.friction,
                )
            ),
        ]
        rows.append(tuple(cells))
    origins = (joint.effort_origin for joint in analysis.joints)
    notes: list[doc.Words] = [text("axes-at-zero-angles")]
    if slides := [joint.name for joint in analysis.joints if joint.slides]:
        notes.append(text("limits-of-slides", joints=", ".join(slides)))
    return doc.Table(
        text("joints-in-actuator-order"),
        (
            doc.Column(text("joint"), left=True),
            doc.Column(text("motion"), left=True),
            doc.Column(text("axis"), "1", left=True),
            doc.Column(text("lower limit"), "°"),
            doc.Column(text("upper limit"), "°"),
            doc.Column(text("effort"), "N m"),
            doc.Column(text("velocity"), "rad/s"),
            doc.Column(text("armature"), "kg m²"),
            doc.Column(text("damping"), "N m s/rad"),
            doc.Column(text("friction"), "N m"),
        ),
        tuple(rows),
        (*notes, text("effort-origins", origins=origins_text(origins))),
        (
            text("source-joints"),
            cite_page("reference/conventions.md", "Coordinates"),
        ),
    )


def _millimetres(length: float | None) -> str:
    return "-" if length is None else f"{1e3 * length:.1f} mm"


def _jacobians(analysis: Analysis) -> doc.Block:
    rows: list[tuple[doc.Cell, ...]] = [
        (
            doc.Name(foot),
            *(doc.vector_cell(row, "+.4f") for row in jacobian.matrix),
            doc.vector_cell(jacobian.singular_values, ".4f"),
            doc.number_cell(jacobian.condition, ".2f"),
        )
        for foot, jacobian in analysis.foot_jacobians.items()
    ]
    return doc.Table(
        text("foot-jacobians-in-world-axes"),
        (
            doc.Column(text("foot"), left=True),
            *(doc.Column(doc.Name(f"v{axis}"), "m/rad", left=True) for axis in "xyz"),
            doc.Column(text("singular-values"), "m/rad", left=True),
            doc.Column(text("condition"), "1"),
        ),
        tuple(rows),
        (),
        (
            text("source-jacobians"),
            cite_page("reference/conventions.md", "Frames and feet"),
        ),
    )


def _check(analysis: Analysis) -> doc.Block:
    check = analysis.check
    rows: list[tuple[doc.Cell, ...]] = []
    for quantity in check.quantities:
        exact = quantity.deviation == 0
        rows.append(
            (
                word(quantity.name),
                doc.Name("" if exact else quantity.where),
                doc.Name("" if exact else quantity.whose),
                doc.Number(f"{quantity.relative:.1e}", quantity.relative),
                text("ok") if quantity.passed else text("differs").with_mark("bad"),
            )
        )
    return doc.Table(
        text(
            "cross-check-urdf-and-mjcf",
            count=check.configurations,
            tolerance=f"{check.tolerance:g}",
        ),
        (
            doc.Column(text("quantity"), left=True),
            doc.Column(text("worst-at"), left=True),
            doc.Column(text("deviation-of"), left=True),
            doc.Column(text("relative"), "1"),
            doc.Column(text("verdict"), left=True),
        ),
        tuple(rows),
        tuple(map(doc.diagnostic_text, check.notes)),
        (
            text("source-cross-check"),
            cite_page("explanation/models.md", "The square"),
        ),
    )


def simulation_blocks(analysis: Analysis) -> Iterable[doc.Block]:
    """Returns what the simulations of a stand say, with feed-forward and without."""
    run = analysis.verification
    both = (run, analysis.sagging)
    verdicts = tuple(
        text("stands") if one.passed else text("FAILED").with_mark("bad") for one in both
    )
    table = doc.Table(
        text(
            "simulation-with-gains",
            seconds=f"{run.duration:g}",
            integrator=doc.Name(run.integrator),
            step=f"{1e3 * run.timestep:g}",
            kp=_interval(run.kp),
            kd=_interval(run.kd),
        ),
        quantity_columns(text("with-feed-forward"), text("without")),
        (*run_rows(both), (text("verdict"), *verdicts, doc.Name(""))),
        (),
        (cite_page("explanation/static-deflection.md", "The equilibrium"), proof_text(run)),
    )
    yield table
    yield height_plot(both, float(analysis.stand.qpos[2]))


def _interval(values: doc.Array) -> str:
    low, high = float(values.min()), float(values.max())
    return f"{low:g}" if low == high else f"{low:g} … {high:g}"


def deviation_table(sweep: GainSweep) -> doc.Table:
    """Return the table of height deviations [mm] by servo gains; gains without rest are marked."""
    deviations = [
        [
            doc.number_cell(value, ".2g", "" if lasts else "bad", 1e3)
            if np.isfinite(value)
            else text("fell")
            for value, lasts in zip(*row, strict=True)
        ]
        for row in zip(sweep.height_deviation, sweep.lasts, strict=True)
    ]
    restless = (np.isfinite(sweep.height_deviation) & ~sweep.lasts).any()
    notes: list[doc.Words] = [
        text("marked-gains-come-to-no-rest"),
    ] * bool(restless)
    notes += [
        text(
            "height-deviation-disturbed" if sweep.amplitude else "height-deviation-undisturbed",
            seconds=f"{sweep.duration:g}",
            force=f"{sweep.amplitude:g}",
            frequency=f"{sweep.frequency:g}",
            integrator=doc.Name(sweep.integrator),
        ),
        text("stiffer-servos-move-less"),
        text("source-gain-sweep"),
    ]
    return doc.Table(
        text("height-deviation-by-servo-gains"),
        (
            doc.Column(text("kp-kd"), "N m/rad \\ N m s/rad", left=True),
            *(doc.Column(doc.Name(f"kd {kd:g}"), "mm") for kd in sweep.kd),
        ),
        tuple(
            (doc.number_cell(kp, "g"), *row) for kp, row in zip(sweep.kp, deviations, strict=True)
        ),
        tuple(notes),
    )


@dataclass(frozen=True, eq=False)
class ComparisonRow(Result):
    """One robot beside the others. Ratios are to its base model, unscaled; files have none.

    Attributes:
        name: The robot.
        base: Its base model, or its files.
        total_mass: kg.
        mass_ratio: Of the total masses; None for a robot of files.
        thigh_ratio: Of the hip-to-knee distances; None for legs of one joint.
        height: Of the base, in the task (m).
        peak_torque: The greatest torque (N m).
        peak_utilisation: The greatest motor utilisation.
        servo_sag: Without feed-forward (m).
        stands_without: Whether it stands without feed-forward.
        verified: The verdict.
        converted: Which of the robot's models was made of the other one, if one was.
    """

    name: str
    base: str
    total_mass: float = field(metadata={"unit": "kg"})
    mass_ratio: float | None = field(metadata={"unit": "1"})
    thigh_ratio: float | None = field(metadata={"unit": "1"})
    height: float = field(metadata={"unit": "m"})
    peak_torque: float = field(metadata={"unit": "N m"})
    peak_utilisation: float = field(metadata={"unit": "1"})
    servo_sag: float = field(metadata={"unit": "m"})
    stands_without: bool
    verified: bool
    converted: str = ""


def compare_with_base(
    analysis: Analysis, base: str, mass: float | None, thigh: float | None
) -> ComparisonRow:
    """Puts an analysis beside its base model.

    Args:
        analysis: The analysis.
        base: The base model's name, or the robot's files.
        mass: Of the base model (kg); None of files.
        thigh: The length of its thigh (m); None of files.
    """
    assert analysis.stand.task.height is not None
    return ComparisonRow(
        name=analysis.name,
        base=base,
        total_mass=analysis.total_mass,
        mass_ratio=_ratio(analysis.total_mass, mass),
        thigh_ratio=_ratio(analysis.thigh_length, thigh),
        height=analysis.stand.task.height,
        peak_torque=float(np.abs(analysis.statics.joint_torques).max()),
        peak_utilisation=peak_utilisation(analysis.statics.motor_utilisation),
        servo_sag=analysis.sagging.servo_sag,
        stands_without=analysis.sagging.passed,
        verified=analysis.verified,
        converted=analysis.verdict.converted,
    )


def _verdict(row: ComparisonRow) -> str:
    """Returns a row's verdict: one that rests on feed-forward says so."""
    if not row.verified:
        return "FAILED"
    return "VERIFIED" if row.stands_without else "VERIFIED with feed-forward"


def _ratio(length: float | None, reference: float | None) -> float | None:
    return length / reference if length is not None and reference else None


def comparison_table(rows: Sequence[ComparisonRow]) -> Table:
    """Returns the table that compares robots: a row each, so that it can be sorted."""
    columns = (
        ("mass", "kg", "total_mass", ".3f", 1.0),
        ("mass-ratio", "1", "mass_ratio", ".3f", 1.0),
        ("thigh-ratio-hip-to-knee", "1", "thigh_ratio", ".3f", 1.0),
        ("stand-height", "mm", "height", ".1f", 1e3),
        ("peak-torque", "N m", "peak_torque", ".3f", 1.0),
        ("peak-utilisation", "%", "peak_utilisation", ".1f", 100.0),
        ("servo-sag", "mm", "servo_sag", ".3f", 1e3),
    )
    cells: list[tuple[Cell, ...]] = []
    for row in rows:
        numbers = [
            number_cell(getattr(row, field), form, scale=scale)
            for _, _, field, form, scale in columns
        ]
        stands = text("stands") if row.stands_without else text("FAILS").with_mark("bad")
        verdict = qualify_verdict_word(_verdict(row), row.converted).with_mark(
            "good" if row.verified else "bad"
        )
        cells.append((Name(row.name), verdict, stands, *numbers))
    return Table(
        text("comparison-ratios-to-the-unscaled"),
        (
            Column(text("robot"), left=True),
            Column(text("verdict"), left=True),
            Column(text("without-feed-forward"), left=True),
            *(Column(text(name), unit) for name, unit, *_ in columns),
        ),
        tuple(cells),
    )
