"""Texts on servo gains with their bounds, in the documents of stances and analyses.

Inputs are the bounds of the gains, and the servos on which a verdict depends.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import Protocol

import numpy as np

from pupper_analysis.base.diagnostics.templates import format_number
from pupper_analysis.base.units import round_down, round_up
from pupper_analysis.present import document as doc
from pupper_analysis.present.document import get_english, text
from pupper_analysis.present.verdict import make_given_clause, make_servo_clause
from pupper_analysis.robot.as_published import ServoSource, ServosUsed
from pupper_analysis.simulation.servo_bounds import ServoBounds


def split_servo_statement(
    lines: Iterable[doc.Words], servos: ServosUsed
) -> tuple[tuple[doc.Words, ...], tuple[doc.Words, ...]]:
    """Divide lines into those without and those with the statement on added or given servos."""
    listed = tuple(lines)
    if servos.made:
        clause = make_servo_clause(servos, good=True)
    elif servos.source is ServoSource.GIVEN:
        clause = make_given_clause(servos, good=True)
    else:
        return listed, ()
    repeated = doc.diagnostic_text(clause.message).en
    kept = tuple(line for line in listed if get_english(line) != repeated)
    return kept, tuple(line for line in listed if get_english(line) == repeated)


class DampingBound(Protocol):
    """Result with ``largest_kd_factor``, as in `ServoBounds`; None without a bound."""

    @property
    def largest_kd_factor(self) -> float | None:
        """Largest factor on the damping with which an explicit PD controller is stable [1]."""


def exceeds_explicit_damping(servos: DampingBound | None) -> bool:
    """Return True if kd exceeds the bound of an explicit PD controller; False if none is known."""
    factor = None if servos is None else servos.largest_kd_factor
    return factor is not None and factor < 1


def describe_servo_gains(servos: ServoBounds | None, used: ServosUsed) -> Iterable[doc.Words]:
    """Yield the servo gains, with the known bounds: a lower bound of kp, an upper bound of kd.

    If the gains of the joints differ, the bounds are factors on all gains. A lower bound equal to
    the present gains is not printed: the estimate was larger, but the stand holds in simulation.

    Args:
        servos: Gains with bounds; None if unknown.
        used: Servos that the verdict depends on.
    """
    if servos is None or not servos.classes:
        return
    joint_class, implicit = servos.classes[0], servos.integrator.startswith("implicit")
    least, most, scales = servos.least_kp_factor, servos.largest_kd_factor, servos.uniform
    kp, kd = (joint_class.kp, joint_class.kd) if scales else (1.0, 1.0)
    units = servos.units
    bounded = most is not None and math.isfinite(most)
    over = exceeds_explicit_damping(servos)
    low = least is not None and least > 1
    yield text(
        "servo-gains" if scales else "servo-factors",
        kp=format_number(joint_class.kp, ".3g"),
        kp_unit=units.stiffness,
        kd=format_number(joint_class.kd, ".3g"),
        kd_unit=units.damping,
        least="" if least is None else format_bound(least * kp, kp, upper=False),
        most=format_bound(most * kd, kd, upper=True) if most is not None and bounded else "",
        added=bool(used.made),
        low=low,
        enough=least is not None and least < 1,
        edge=least == 1,
        exceeded=over,
        within=bounded and not over,
        step=format_number(1e3 * servos.timestep, ".3g"),
        rate=f"{1 / servos.timestep:.4g}",
        implicit=servos.integrator if implicit else "",
    )


def round_bound(bound: float, gain: float, *, upper: bool) -> float:
    """Round a bound of a servo gain to three significant digits, or more if the gain is near.

    An upper bound is rounded down, a lower bound up: the printed bound fulfils the exact bound. If
    `_MAX_BOUND_DIGITS` digits suffice, the rounded bound is above, equal to or below the gain as
    displayed (three digits), as the exact bound and gain are. ``bound`` and ``gain`` may also be
    factors on gains. ``upper``: whether the bound is the upper one.
    """
    displayed = float(f"{gain:.3g}")
    round_inward = round_down if upper else round_up
    for digits in range(_BOUND_DIGITS, _MAX_BOUND_DIGITS):
        rounded = round_inward(bound, digits)
        if np.sign(rounded - displayed) == np.sign(bound - gain):
            return rounded
    return round_inward(bound, _MAX_BOUND_DIGITS)


def format_bound(bound: float, gain: float, *, upper: bool) -> str:
    """Format a bound of a servo gain, rounded by `round_bound`, mostly without exponent."""
    return format_number(round_bound(bound, gain, upper=upper), "g")


def make_bound_cell(bound: float | None, gain: float, *, upper: bool) -> doc.Number:
    """Create the table cell of a bound of a servo gain; an empty cell without a bound."""
    if bound is None:
        return doc.number_cell(None, "g")
    return replace(doc.number_cell(round_bound(bound, gain, upper=upper), "g"), value=bound)


_BOUND_DIGITS, _MAX_BOUND_DIGITS = 3, 6
"""Usual and largest number of significant digits of a displayed bound of a servo gain. Chosen, not
tuned."""
