"""Document of an analysis, and the table that compares several robots.

Input is an ``Analysis``. The table has a row of key figures per robot.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.results import Result
from pupper_analysis.base.units import (
    EFFORT_UNIT,
    HINGE_UNITS,
    JointUnits,
    find_common_units,
)
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
    format_peak_load,
    load_blocks,
    origins_text,
    proof_text,
    view_block,
)
from pupper_analysis.present.documents.registry import build_document
from pupper_analysis.present.documents.servos import (
    describe_servo_gains,
    exceeds_explicit_damping,
    split_servo_statement,
)
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
from pupper_analysis.present.verdict import (
    join_ground_touches,
    qualify_verdict_word,
    report_refused_file,
    split_verdict_lines,
)
from pupper_analysis.robot.robot import Robot
from pupper_analysis.simulation.verdict import TWO_ROBOTS_CODE, Ending
from pupper_analysis.simulation.verify import StandVerification
from pupper_analysis.statics.equilibrium import peak_utilisation
from pupper_analysis.tools.analyze.analysis import Analysis
from pupper_analysis.tools.analyze.gain_sweep import GainSweep


@build_document.register(Analysis)
def analysis_document(analysis: Analysis, robot: Robot | None = None) -> doc.Document:
    """Create the report of an analysis: stand, loads, simulations and verdict.

    Without ``robot``, the 3-D view is empty.
    """
    runs = (analysis.verification, analysis.sagging)
    first, more = split_verdict_lines(analysis.verdict)
    load, height, *others = _make_key_figures(analysis)
    failures = _list_failures(analysis)
    warnings = tuple(_select_warnings(analysis, first))
    if not (failures or analysis.verified or analysis.verdict.passed):
        failures, warnings = first, ()  # only the verdict on the stand is bad
    repeated: tuple[doc.Words, ...] = ()
    gains = tuple(describe_servo_gains(analysis.servos, analysis.verdict.servos))
    if gains:  # `stand` states the gains, too
        warnings, repeated = split_servo_statement(warnings, analysis.verdict.servos)
    blocks: list[doc.Block] = [
        view_block(robot, analysis.stand, analysis.statics, list_motions(runs)),
        *_make_structure_blocks(analysis, robot),
        stand_table(analysis.stand, analysis.statics),
        *load_blocks(
            analysis.statics,
            analysis.min_max_torque,
            analysis.verification,
            [joint.effort for joint in analysis.joints],
            [joint.effort_origin for joint in analysis.joints],
            ["m" if joint.is_sliding else "rad" for joint in analysis.joints],
            {doc.Column(text("hanging"), "N m"): analysis.hanging_torques.tolist()},
        ),
        *simulation_blocks(analysis),
        *_make_sweep_tables(analysis),
        _make_jacobian_table(analysis),
        _make_check_table(analysis),
    ]
    return doc.Document(
        text("analysis"),
        doc.Name(analysis.name),
        tuple(blocks),
        passed=analysis.verified,
        verdict=_make_verdict_word(analysis),
        failures=failures[:_MAX_SHOWN_FAILURES],
        findings=(
            load,
            *gains,
            height,
            *(() if failures else (*report_refused_file(analysis.verdict), *warnings)),
        ),
        details=(
            *others,
            *repeated,
            *failures[_MAX_SHOWN_FAILURES:],
            *(warnings if failures else ()),
            *more,
        ),
        brief=True,
        notes=tuple(map(doc.diagnostic_text, analysis.notes)),
        next_step=_select_next_step(analysis),
    )


_MAX_SHOWN_FAILURES = 2
"""Largest number of failures in the short answer; further failures are details. Chosen, not
tuned."""

_CROSS_CHECK_CODE = "models-deviate"
"""Code of the failures that report a deviating quantity of the cross-check."""


def _list_failures(analysis: Analysis) -> tuple[doc.Words, ...]:
    """List the failures of an analysis, causes before effects."""
    order = sorted(analysis.failures, key=lambda failure: failure.code != TWO_ROBOTS_CODE)
    other_failures = [failure for failure in order if failure.code != _CROSS_CHECK_CODE]
    check = analysis.check
    failed = sum(not quantity.passed for quantity in check.quantities)
    if not failed:
        return tuple(map(doc.diagnostic_text, other_failures))
    worst = max(check.quantities, key=lambda quantity: quantity.relative)
    line = text(
        "quantities-deviate",
        count=failed,
        quantities=len(check.quantities),
        relative=f"{worst.relative:.1e}",
        quantity=word(worst.name),
    )
    causes = [failure for failure in other_failures if failure.code == TWO_ROBOTS_CODE]
    effects = [failure for failure in other_failures if failure.code != TWO_ROBOTS_CODE]
    return (*map(doc.diagnostic_text, causes), line, *map(doc.diagnostic_text, effects))


def _select_next_step(analysis: Analysis) -> doc.NextStep:
    """Return the command to suggest next, such as ``payload`` for a verified robot.

    It is ``gains`` if kd exceeds the bound of an explicit PD controller, as after `stand`.
    """
    if analysis.verified:
        over = exceeds_explicit_damping(analysis.servos)
        return doc.NextStep("gains" if over else "payload")
    differs = not all(quantity.passed for quantity in analysis.check.quantities)
    return doc.NextStep("crosscheck" if differs else "stand")


def _select_warnings(analysis: Analysis, first: Iterable[doc.Text]) -> Iterable[doc.Words]:
    """Yield the warnings ``first`` of the verdict, then other failures without feed-forward.

    The failures are omitted if the verdict contains these (``Verdict.commands_alone``).
    """
    yield from first
    alone = analysis.verdict.commands_alone
    if alone in (None, Ending.HOLDS):
        yield from _report_fall(analysis.sagging)


def _make_verdict_word(analysis: Analysis) -> doc.Text:
    """Return the word that is displayed as the verdict, such as VERIFIED or FAILED."""
    key = _get_verdict_key(analysis.verified, analysis.sagging.passed)
    return qualify_verdict_word(
        key,
        analysis.verdict.converted,
        ideal_servos=exceeds_explicit_damping(analysis.servos),
    )


def _make_key_figures(analysis: Analysis) -> Iterable[doc.Words]:
    """Yield lines with mass and largest load, base height, and worst cross-check deviation."""
    yield text(
        "mass-kg-peak-torque-torque",
        mass=doc.format_widened(analysis.total_mass, ".3f"),
        ground=ground_word(analysis.stand.depths.values()),
        # Beside the verdict on ideal servos, the line has no more room.
        simulated=analysis.verified and not exceeds_explicit_damping(analysis.servos),
        **format_peak_load(analysis.statics),
    )
    yield text(
        "stands-height-mm-high",
        height=f"{1e3 * analysis.stand.qpos[2]:.1f}",
        held=_format_height(analysis.verification),
        let_go=_format_height(analysis.sagging),
        sunk=_format_sunk_height(analysis),
    )
    check = analysis.check
    worst = next(quantity for quantity in check.quantities if quantity.name == check.worst)
    yield text(
        "urdf-and-mjcf-worst-deviation",
        relative=f"{worst.relative:.1e}",
        quantity=word(worst.name),
    )


def _format_height(run: StandVerification) -> doc.Words:
    """Format the base height of a simulation in mm; the word "diverged" if it is not finite."""
    if not np.isfinite(run.base_height):
        return text("diverged")
    return doc.Name(f"{1e3 * run.base_height:.1f} mm")


def _format_sunk_height(analysis: Analysis) -> str:
    """Format the loss of base height without feed-forward in mm; "" if the run diverged."""
    sunk = 1e3 * (analysis.stand.qpos[2] - analysis.sagging.base_height)
    return f"{sunk:.1f}" if np.isfinite(sunk) else ""


def _report_fall(without: StandVerification) -> Iterable[doc.Words]:
    """Yield a warning with the reasons if the simulation without feed-forward failed."""
    if not without.passed:
        failures = join_ground_touches(without.failures)
        why = join_words(map(doc.diagnostic_text, failures), "semicolon")
        yield text("does-not-stand-without-feed-forward", why=why).with_mark("warn")


def _make_structure_blocks(analysis: Analysis, robot: Robot | None) -> Iterable[doc.Block]:
    """Yield the model data: sizes, mass, CoM, leg lengths, and the tables of joints and masses."""
    yield doc.Lines(
        (
            text(
                "model-sizes",
                nq=analysis.nq,
                nv=analysis.nv,
                nu=analysis.nu,
                mass=doc.format_widened(analysis.total_mass, ".3f"),
                com=doc.vector_cell(1e3 * analysis.center_of_mass, "+.1f"),
            ),
            text(
                "thigh-thigh-calf-calf",
                thigh=_format_length(analysis.thigh_length),
                calf=_format_length(analysis.calf_length),
            ),
            task_text(analysis.stand.task),
            files_text(robot),
        )
    )
    yield _make_joint_table(analysis)
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


def _make_joint_table(analysis: Analysis) -> doc.Table:
    """Create the table of joints: axis, limits, effort, velocity and passive terms, a row each.

    Position limits are in degrees, of slides in mm; the other columns are in SI units.
    """
    rows: list[tuple[doc.Cell, ...]] = []
    for joint in analysis.joints:
        scale = 1e3 if joint.is_sliding else math.degrees(1.0)
        cells: list[doc.Cell] = [
            doc.Name(joint.name),
            word(joint.motion),
            doc.vector_cell(joint.axis, "+.2f" if joint.is_oblique else "+.0f"),
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
    if slides := [joint.name for joint in analysis.joints if joint.is_sliding]:
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


def _format_length(length: float | None) -> str:
    """Format a length [m] in mm; a dash for None."""
    return "-" if length is None else f"{1e3 * length:.1f} mm"


def _make_sweep_tables(analysis: Analysis) -> list[doc.Table]:
    """Return the table of the gain sweep; none if the analysis has no gain sweep."""
    if analysis.sweep is None:
        return []
    return [deviation_table(analysis.sweep, find_common_units(analysis.statics.torque_units))]


def _make_jacobian_table(analysis: Analysis) -> doc.Block:
    """Create the table of foot Jacobians in world axes, a row per contact point.

    The columns are the three rows of the Jacobian, singular values and condition number.
    """
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


def _make_check_table(analysis: Analysis) -> doc.Block:
    """Create the table of the cross-check: the largest relative deviation of each quantity."""
    check = analysis.check
    rows: list[tuple[doc.Cell, ...]] = []
    for quantity in check.quantities:
        exact = quantity.deviation == 0
        rows.append(
            (
                word(quantity.name),
                doc.Name("" if exact else quantity.location),
                doc.Name("" if exact else quantity.edge),
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
            cite_page("explanation/models.md", "Four evaluations"),
        ),
    )


def simulation_blocks(analysis: Analysis) -> Iterable[doc.Block]:
    """Create the table and the height plot of the simulations with and without feed-forward."""
    run = analysis.verification
    both = (run, analysis.sagging)
    verdicts = tuple(
        text("stands") if simulation.passed else text("FAILED").with_mark("bad")
        for simulation in both
    )
    table = doc.Table(
        text(
            "simulation-with-gains",
            seconds=f"{run.duration:g}",
            integrator=doc.Name(run.integrator),
            step=f"{1e3 * run.timestep:g}",
            kp=_format_interval(run.kp),
            kd=_format_interval(run.kd),
        ),
        quantity_columns(text("with-feed-forward"), text("without")),
        (*run_rows(both), (text("verdict"), *verdicts, doc.Name(""))),
        (),
        (cite_page("explanation/static-deflection.md", "The equilibrium"), proof_text(run)),
    )
    yield table
    yield height_plot(both, float(analysis.stand.qpos[2]))


def _format_interval(values: Array) -> str:
    """Format the smallest and the largest of some values; one number if both are equal."""
    low, high = float(values.min()), float(values.max())
    return f"{low:g}" if low == high else f"{low:g} … {high:g}"


def deviation_table(sweep: GainSweep, units: JointUnits) -> doc.Table:
    """Create the table of base height deviations [mm], a row per kp and a column per kd.

    A deviation is marked if the undisturbed robot does not stay at rest with these gains. ``units``
    are the units of kp and kd.
    """
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
            doc.Column(text("kp-kd"), f"{units.stiffness} \\ {units.damping}", left=True),
            *(doc.Column(doc.Name(f"kd {kd:g}"), "mm") for kd in sweep.kd),
        ),
        tuple(
            (doc.number_cell(kp, "g"), *row) for kp, row in zip(sweep.kp, deviations, strict=True)
        ),
        tuple(notes),
    )


@dataclass(frozen=True, eq=False)
class ComparisonRow(Result):
    """Key figures of a robot in the comparison.

    Attributes:
        name: Name of the robot.
        base: Name of the base model, or the robot's files.
        total_mass: Mass of the robot (kg).
        mass_ratio: Total mass relative to the base model; None for a robot from files.
        thigh_ratio: Thigh length relative to the base model; None if the thigh length is unknown,
            or for a robot from files.
        height: Base height of the task (m).
        peak_torque: Largest torque magnitude (N m or N).
        peak_utilisation: Largest motor utilisation.
        servo_sag: Height loss by servo deflection without feed-forward (m).
        stands_without: True if the simulation without feed-forward holds.
        verified: True if the analysis is verified.
        converted: Model that was converted from the other model, ``urdf`` or ``mjcf``; empty if
            neither was.
        peak_torque_unit: Unit of ``peak_torque``: N m of a hinge, N of a slide.
    """

    name: str
    base: str
    total_mass: float = field(metadata={"unit": "kg"})
    mass_ratio: float | None = field(metadata={"unit": "1"})
    thigh_ratio: float | None = field(metadata={"unit": "1"})
    height: float = field(metadata={"unit": "m"})
    peak_torque: float = field(metadata={"unit": EFFORT_UNIT})
    peak_utilisation: float = field(metadata={"unit": "1"})
    servo_sag: float = field(metadata={"unit": "m"})
    stands_without: bool
    verified: bool
    converted: str = ""
    peak_torque_unit: str = HINGE_UNITS.effort


def compare_with_base(
    analysis: Analysis, base: str, mass: float | None, thigh: float | None
) -> ComparisonRow:
    """Return the key figures of an analysis as a table row, with ratios to the unscaled robot.

    ``mass`` [kg] and ``thigh`` length [m] are those of the unscaled variant; None if unknown.
    ``base`` is the name of this variant, or the robot's files.
    """
    assert analysis.stand.task.height is not None
    return ComparisonRow(
        name=analysis.name,
        base=base,
        total_mass=analysis.total_mass,
        mass_ratio=_compute_ratio(analysis.total_mass, mass),
        thigh_ratio=_compute_ratio(analysis.thigh_length, thigh),
        height=analysis.stand.task.height,
        peak_torque=float(np.abs(analysis.statics.joint_torques).max()),
        peak_utilisation=peak_utilisation(analysis.statics.motor_utilisation),
        servo_sag=analysis.sagging.servo_sag,
        stands_without=analysis.sagging.passed,
        verified=analysis.verified,
        converted=analysis.verdict.converted,
        peak_torque_unit=analysis.statics.torque_units[
            int(np.argmax(np.abs(analysis.statics.joint_torques)))
        ],
    )


def _get_verdict_key(verified: bool, stands_without: bool) -> str:
    """Return the key, in the catalogue of texts, of an analysis verdict, such as "VERIFIED"."""
    if not verified:
        return "FAILED"
    return "VERIFIED" if stands_without else "VERIFIED with feed-forward"


def _compute_ratio(length: float | None, reference: float | None) -> float | None:
    """Return a length or mass divided by the reference; None if a value is unknown, for example."""
    return length / reference if length is not None and reference else None


def comparison_table(rows: Sequence[ComparisonRow]) -> Table:
    """Create the table of mass, height, torques, servo sag and verdict, a row per robot."""
    unit = find_common_units(row.peak_torque_unit for row in rows).effort
    columns = (
        ("mass", "kg", "total_mass", ".3f", 1.0),
        ("mass-ratio", "1", "mass_ratio", ".3f", 1.0),
        ("thigh-ratio-hip-to-knee", "1", "thigh_ratio", ".3f", 1.0),
        ("stand-height", "mm", "height", ".1f", 1e3),
        ("peak-torque", unit, "peak_torque", ".3f", 1.0),
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
        verdict = qualify_verdict_word(
            _get_verdict_key(row.verified, row.stands_without), row.converted
        ).with_mark("good" if row.verified else "bad")
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
