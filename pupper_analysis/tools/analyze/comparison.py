"""Compares variants with each other."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.results import Result
from pupper_analysis.present.document import (
    Cell,
    Column,
    Name,
    Table,
    number_cell,
    text,
)
from pupper_analysis.present.verdict import verdict_of_files
from pupper_analysis.pupper.variants import VariantSpec
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.analyze.analysis import Analysis

Array = NDArray[np.float64]


def variants_table(variants: Iterable[tuple[VariantSpec, Robot]]) -> Table:
    """Returns what variants there are."""
    return Table(
        text("variants"),
        (
            Column(text("variant"), left=True),
            Column(text("base"), left=True),
            Column(Name("leg_scale"), "1"),
            Column(Name("torso_mass_scale"), "1"),
            Column(text("mass"), "kg"),
            Column(text("stand-height"), "mm"),
        ),
        tuple(
            (
                Name(spec.name),
                Name(spec.base),
                number_cell(spec.leg_scale, "g"),
                number_cell(spec.torso_mass_scale, "g"),
                number_cell(robot.total_mass, ".3f"),
                number_cell(robot.stand_height, ".1f", scale=1e3),
            )
            for spec, robot in variants
        ),
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
        thigh_shape_ratio: Of the lengths of the shapes that span the thighs; None without any.
        height: Of the base, in the task (m).
        peak_torque: The greatest torque (N m).
        peak_utilisation: The greatest motor utilisation.
        servo_sag: Without feed-forward (m).
        stands_without: Whether it stands without feed-forward.
        contact_sag: With feed-forward (m).
        torque_error: Of the simulation against the prediction, relative.
        force_error: Likewise.
        cross_check: Worst relative deviation.
        verified: The verdict.
        converted: Which of the robot's models was made of the other one, if one was.
    """

    name: str
    base: str
    total_mass: float
    mass_ratio: float | None
    thigh_ratio: float | None
    thigh_shape_ratio: float | None
    height: float
    peak_torque: float
    peak_utilisation: float
    servo_sag: float
    stands_without: bool
    contact_sag: float
    torque_error: float
    force_error: float
    cross_check: float
    verified: bool
    converted: str = ""


@dataclass(frozen=True)
class RatioReference:
    """What ratios are taken to.

    Attributes:
        total_mass: kg, or None.
        thigh_length: m, or None.
        thigh_shape_length: m, or None.
    """

    total_mass: float | None
    thigh_length: float | None
    thigh_shape_length: float | None


def compare_with_base(
    analysis: Analysis, base: str, reference: RatioReference | None
) -> ComparisonRow:
    """Puts an analysis beside its base model.

    Args:
        analysis: The analysis.
        base: The base model's name, or the robot's files.
        reference: The base model's values; None of files.
    """
    nothing = reference or RatioReference(None, None, None)
    assert analysis.stand.task.height is not None
    return ComparisonRow(
        name=analysis.name,
        base=base,
        total_mass=analysis.total_mass,
        mass_ratio=_ratio(analysis.total_mass, nothing.total_mass),
        thigh_ratio=_ratio(analysis.thigh_length, nothing.thigh_length),
        thigh_shape_ratio=_ratio(analysis.thigh_shape_length, nothing.thigh_shape_length),
        height=analysis.stand.task.height,
        peak_torque=float(np.abs(analysis.statics.joint_torques).max()),
        peak_utilisation=float(analysis.statics.motor_utilisation.max()),
        servo_sag=analysis.sagging.servo_sag,
        stands_without=analysis.sagging.passed,
        contact_sag=analysis.verification.contact_sag,
        torque_error=analysis.verification.torque_error,
        force_error=analysis.verification.force_error,
        cross_check=max(quantity.relative for quantity in analysis.check.quantities),
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
        ("thigh-ratio-drawn-shape", "1", "thigh_shape_ratio", ".3f", 1.0),
        ("stand-height", "mm", "height", ".1f", 1e3),
        ("peak-torque", "N m", "peak_torque", ".3f", 1.0),
        ("peak-utilisation", "%", "peak_utilisation", ".1f", 100.0),
        ("servo-sag", "mm", "servo_sag", ".3f", 1e3),
        ("contact-softness", "mm", "contact_sag", ".3f", 1e3),
        ("torque-off-prediction", "%", "torque_error", ".3f", 100.0),
        ("foot-force-off-prediction", "%", "force_error", ".3f", 100.0),
        ("cross-check-worst", "1", "cross_check", ".1e", 1.0),
    )
    cells: list[tuple[Cell, ...]] = []
    for row in rows:
        numbers = [
            number_cell(getattr(row, field), form, scale=scale)
            for _, _, field, form, scale in columns
        ]
        stands = text("stands") if row.stands_without else text("FAILS").marked("bad")
        verdict = verdict_of_files(_verdict(row), row.converted).marked(
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
