"""Motor torques and contact forces as tables and plots, for documents of stands and analyses.

Inputs are static equilibria, a simulation of the stand and the effort limits with their origins.
Outputs are cells, tables, plots and views of `document`, with torques in N m and forces in N in
world axes.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.arguments import find_name_patterns
from pupper_analysis.base.diagnostics.templates import format_number
from pupper_analysis.base.units import READ_IN, floor_within_rounding, round_down, round_up
from pupper_analysis.models.efforts import EffortStatement
from pupper_analysis.present import document as doc
from pupper_analysis.present.document import join_words, text
from pupper_analysis.present.documents.sources import cite_page
from pupper_analysis.robot.robot import Robot
from pupper_analysis.simulation.verify import StandVerification
from pupper_analysis.stance.stand import Stand
from pupper_analysis.statics.equilibrium import (
    Equilibrium,
    GravityCompensation,
    find_hardest_motor,
    peak_utilisation,
)

NO_COLUMNS: Mapping[doc.Column, Any] = MappingProxyType({})
"""Empty default of the argument ``more`` of `torque_table`: the table has no further columns."""

WARNING_UTILISATION, FULL_UTILISATION = 0.9, 1.0
"""Motor utilisations (torque / effort limit) at which the mark of a cell changes. Above
``WARNING_UTILISATION`` the cell is marked as a warning, above ``FULL_UTILISATION`` as bad. At 1 the
motor reaches the effort limit. The value 0.9 is chosen, not tuned.
"""


def format_example_efforts(
    unknown: Collection[str], torques: Mapping[str, float], units: Mapping[str, str]
) -> tuple[str, ...]:
    """Return options ``--effort`` with an example for the motors without a stated limit.

    The example is the largest of the torques, rounded up (`format_required_effort`). A simulation
    with nudges may need more torque. Hinges and slides have separate examples; the number is the
    same for both if either have no torque. Empty if all torques are zero.

    Args:
        unknown: Joints of the motors without a stated limit.
        torques: {joint: torque [N m, N]} of all motors.
        units: {joint: unit of the torque} of all motors, N m or N.
    """
    words: list[str] = []
    largest = max((abs(torques[joint]) for joint in torques if joint in unknown), default=0.0)
    if largest == 0:
        return ()
    for unit in dict.fromkeys(units.values()):
        joints = [joint for joint in torques if joint in unknown and units[joint] == unit]
        torque = max((abs(torques[joint]) for joint in joints), default=0.0) or largest
        example = format_required_effort(torque)
        for pattern in find_name_patterns(joints, torques):
            words += ("--effort", f"{pattern}={example}")
    return tuple(words)


def format_required_effort(torque: float) -> str:
    """Format a torque that a motor must be able to exert [N m, N], rounded up to three digits."""
    return format_number(round_up(abs(torque), 3), ".3g")


def utilisation_cell(share: float, limit: float) -> doc.Number:
    """Create a table cell with a motor utilisation in percent, with a bar and a warning colour.

    ``share`` is |torque| / limit [1].
    """
    if limit == 0 or not (math.isfinite(share) and math.isfinite(limit)):
        return doc.number_cell(None, "")
    mark = "bad" if share > FULL_UTILISATION else "warn" if share > WARNING_UTILISATION else ""
    return doc.Number(f"{100 * share:.1f}", 100 * share, mark, min(share, 1.0))


def format_share(share: float) -> str:
    """Format a motor utilisation [1] in percent with three digits; "" if it is not finite."""
    return format_number(100 * share, ".3g") if math.isfinite(share) else ""


def format_share_values(share: float) -> dict[str, str]:
    """Return the values of a text on a motor utilisation [1]; each may be "".

    ``share`` is the utilisation in percent. ``zero`` is "0" for an effort limit of 0 (infinite
    utilisation), ``unknown`` is "unknown" for an unknown limit (NaN).
    """
    return {
        "share": format_share(share),
        "zero": "0" if math.isinf(share) else "",
        "unknown": "unknown" if math.isnan(share) else "",
    }


def format_peak_load(statics: Equilibrium) -> dict[str, Any]:
    """Return the values of a text on the most loaded motor (`find_hardest_motor`).

    The values are those of `format_share_values`, ``torque`` [N m, N] with its ``unit``, and
    ``joint``.
    """
    peak = find_hardest_motor(statics)
    return {
        **format_share_values(float(statics.motor_utilisation[peak])),
        "torque": doc.format_widened(abs(float(statics.joint_torques[peak])), ".2f"),
        "unit": statics.torque_units[peak],
        "joint": doc.Name(statics.joint_names[peak]),
    }


def limit_cell(limit: float, form: str = "g") -> doc.Cell:
    """Create a table cell with a torque limit, or "unknown" if the limit is not finite."""
    return doc.number_cell(limit, form) if math.isfinite(limit) else text("limit-unknown")


def mass_text(mass: float) -> doc.Words:
    """Format the largest payload mass [kg], rounded down by `round_mass`.

    NaN is formatted as "unknown", infinity as "no limit".
    """
    if math.isnan(mass):
        return text("limit-unknown")
    if math.isinf(mass):
        return text("no-limit")
    shown = round_mass(mass)
    return doc.Name(f"{format_number(shown, '.2g' if 0 < shown < 0.1 else '.2f')} kg")


def round_mass(mass: float) -> float:
    """Round a finite payload mass [kg] down to 0.01 kg, below 0.1 kg to two digits."""
    return round_down(mass, 2) if mass < 0.1 else floor_within_rounding(100 * mass) / 100


def proof_text(verification: StandVerification) -> doc.Text:
    """Create the sentence that a simulation verified the predicted torques and foot forces."""
    return text(
        "source-verified",
        seconds=f"{verification.duration:g}",
        torque=format_number(verification.torque_error, ".2%"),
        force=""
        if verification.force_error is None
        else format_number(verification.force_error, ".2%"),
    )


def load_blocks(
    statics: GravityCompensation,
    min_max_torque: GravityCompensation,
    verification: StandVerification,
    limits: Sequence[float],
    origins: Iterable[EffortStatement | None],
    units: Sequence[str],
    more: Mapping[doc.Column, Sequence[float]],
) -> list[doc.Block]:
    """Create the table and the plot of motor torques, and the table of contact forces.

    Args:
        statics: Equilibrium with minimum tangential forces; its torques are the prediction.
        min_max_torque: Equilibrium with the smallest peak utilisation of the motors.
        verification: Simulation with feed-forward torques.
        limits: Effort limits, shape (nu,) [N m, N].
        origins: Attribute and file that state each joint's limit; None for a joint without limit.
        units: Unit of each joint position, shape (nu,): rad, or m for a slide.
        more: Further columns, {column: values of shape (nu,)}.
    """
    source = (
        text("source-torques"),
        cite_page("explanation/statics.md", "Static balance of a standing robot"),
        proof_text(verification),
    )
    peak = _format_fraction(peak_utilisation(min_max_torque.motor_utilisation))
    notes = (
        text("torque-distributions", peak=peak),
        text("limit-origins", origins=origins_text(origins)),
        *describe_slides(statics.joint_names, units),
    )
    compared = {
        doc.Column(text("simulated"), "N m"): verification.joint_torques.tolist(),
        doc.Column(text("min-max-torque"), "N m"): min_max_torque.joint_torques.tolist(),
        **more,
    }
    torques = torque_table(statics, limits, compared)
    return [
        replace(torques, notes=notes, source=source),
        torque_plot(statics, verification.joint_torques.tolist(), limits),
        _make_contact_table(statics, verification),
    ]


def get_display_scales(units: Iterable[str]) -> NDArray[np.float64]:
    """Return the factors, shape (nu,), that convert joint positions [rad, m] to [deg, mm]."""
    return np.array([READ_IN[unit][0] for unit in units])


def describe_slides(names: Iterable[str], units: Iterable[str]) -> list[doc.Words]:
    """Create the note of a table that the values of slides are in N and mm, other than of hinges.

    Args:
        names: Joints of the table.
        units: Unit of each joint's position: rad or m.

    Returns:
        List with the note, which names the slides; empty without a slide.
    """
    slides = [name for name, unit in zip(names, units, strict=True) if unit == "m"]
    return [text("units-of-slides", joints=", ".join(slides))] if slides else []


def _format_fraction(value: float) -> str:
    """Format a fraction [1] as a text in percent; a dash if ``value`` is not finite."""
    return format_number(value, ".1%") if math.isfinite(value) else "-"


def torque_table(
    statics: GravityCompensation,
    limits: Sequence[float],
    more: Mapping[doc.Column, Sequence[float | None]] = NO_COLUMNS,
) -> doc.Table:
    """Create the table of motor torques, limits and utilisations.

    ``limits`` [N m; of slides N] and the values of ``more``, further columns, have the shape (nu,).
    """
    form = doc.widen_format("+.4f", statics.joint_torques.tolist())
    rows: list[tuple[doc.Cell, ...]] = [
        (
            doc.Name(name),
            doc.number_cell(statics.joint_torques[index], form),
            limit_cell(limits[index]),
            utilisation_cell(float(statics.motor_utilisation[index]), limits[index]),
            *(
                doc.number_cell(values[index], "+.2f" if column.unit == "°" else form)
                for column, values in more.items()
            ),
        )
        for index, name in enumerate(statics.joint_names)
    ]
    columns = (
        doc.Column(text("joint"), left=True),
        doc.Column(text("torque"), "N m"),
        doc.Column(text("limit"), "N m"),
        doc.Column(text("utilisation"), "%"),
        *more,
    )
    return doc.Table(text("motor-torques"), columns, tuple(rows))


def origins_text(origins: Iterable[EffortStatement | None]) -> doc.Text:
    """Create the text that lists where torque limits come from: attributes and files (origins)."""
    counts = Counter(
        None if origin is None else (origin.attribute, origin.file) for origin in origins
    )
    listed = []
    for origin, count in counts.most_common():
        place = text("no-limit-stated" if origin is None else "as-asked")
        if origin is not None and origin[1]:
            place = text("attribute-in-the-file", attribute=origin[0], file=origin[1])
        several = len(counts) > 1
        listed.append(text("place-count", place=place, count=count) if several else place)
    return join_words(listed)


def torque_plot(
    statics: GravityCompensation,
    simulated: Sequence[float],
    limits: Sequence[float],
    *,
    title: doc.Words | None = None,
    worst: Sequence[float] | None = None,
) -> doc.BarPlot:
    """Create the bar plot of motor torques as percentages of the limits: predicted and simulated.

    A motor without a positive limit has no bar, but the torque as text. Without any positive limit,
    the bars are torques [N m, N]. If all utilisations are small, the limit is outside of the plot.

    Args:
        statics: Equilibrium with the predicted torques.
        simulated: Simulated torques, shape (nu,) [N m, N].
        limits: Effort limits, shape (nu,) [N m, N].
        title: Title; default: motor torques against their limits.
        worst: Largest utilisation of each motor over all postures, shape (nu,) [1].
    """
    if not any(math.isfinite(limit) and limit > 0 for limit in limits):
        return _make_plain_torque_plot(statics, simulated, title)
    bars, far = [], _is_limit_far(statics, limits, worst)
    for index, name in enumerate(statics.joint_names):
        torque, limit, unit = (
            float(statics.joint_torques[index]), float(limits[index]), statics.torque_units[index]
        )  # fmt: skip
        scale = 100 / limit if math.isfinite(limit) and limit > 0 else math.nan
        share = scale * abs(torque)
        label: doc.Words = doc.Name(f"{format_number(share, '.1f')} % of {limit:g} {unit}")
        if math.isnan(scale):
            key = "torque-without-limit" if limit else "torque-with-zero-limit"
            label = text(key, torque=f"{format_number(abs(torque), '.3g')} {unit}")
        bars.append(
            doc.PlotBar(
                doc.Name(name),
                share,
                scale * abs(float(simulated[index])),
                None if far or math.isnan(scale) else 100.0,
                point=None if worst is None else 100 * float(worst[index]),
                label=label,
            )
        )
    return doc.BarPlot(
        title or text("motor-torques-against-their-limits"),
        doc.Axis(text("utilisation"), "%", ".1f"),
        bars,
        (
            text("predicted-by-pinocchio"),
            text("simulated-by-mujoco"),
            None if far else text("limit"),
            None if worst is None else text("worst-of-all-postures"),
        ),
    )


def _is_limit_far(
    statics: GravityCompensation, limits: Sequence[float], worst: Sequence[float] | None
) -> bool:
    """Return True if all utilisations are so small that the limit is outside of the plot."""
    ratios = np.abs(statics.joint_torques) / np.where(np.greater(limits, 0), limits, np.nan)
    shares = np.append(ratios, [] if worst is None else worst)
    return bool(np.nanmax(shares) < _MIN_SHARE_WITH_LIMIT)


_MIN_SHARE_WITH_LIMIT = 0.3
"""Smallest peak utilisation [1] with which a plot of utilisations shows the limit. With smaller
utilisations, differences between the bars would hardly be visible. Chosen, not tuned."""


def _make_plain_torque_plot(
    statics: GravityCompensation, simulated: Sequence[float], title: doc.Words | None
) -> doc.BarPlot:
    """Create the bar plot of motor torques [N m, N] whose limits are not stated."""
    bars = [
        doc.PlotBar(
            doc.Name(name),
            float(statics.joint_torques[index]),
            float(simulated[index]),
            unit=statics.torque_units[index],
        )
        for index, name in enumerate(statics.joint_names)
    ]
    units = ", ".join(dict.fromkeys(statics.torque_units))
    return doc.BarPlot(
        title or text("motor-torques"),
        doc.Axis(text("torque"), units, "+.3f"),
        bars,
        (text("predicted-by-pinocchio"), text("simulated-by-mujoco"), None),
    )


def contact_table(statics: GravityCompensation) -> doc.Table:
    """Create the table of the contact forces [N] on feet, welds and grips, in world axes.

    For feet, the table also has the friction utilisation.
    """
    loads: dict[str, tuple[Iterable[float], float | None]] = {
        **{
            foot: (load.force, load.friction_utilisation)
            for foot, load in statics.foot_loads.items()
        },
        **{name: (wrench[:3], None) for name, wrench in statics.weld_wrenches.items()},
    }
    form = doc.widen_format("+.3f", (value for force, _ in loads.values() for value in force))
    rows: list[tuple[doc.Cell, ...]] = [
        (
            doc.Name(name),
            *(doc.number_cell(value, form) for value in force),
            doc.number_cell(share, ".1f", scale=100),
        )
        for name, (force, share) in loads.items()
    ]
    columns = (
        doc.Column(text("foot"), left=True),
        *(doc.Column(text("force-axis", axis=axis), "N") for axis in "xyz"),
        doc.Column(text("friction-used"), "%"),
    )
    return doc.Table(text("contact-forces-on-the-feet"), columns, tuple(rows))


def _make_contact_table(statics: GravityCompensation, verification: StandVerification) -> doc.Table:
    """Create the table of contact forces [N], with notes on centres of pressure, for example."""
    flat = len(statics.foot_loads) < len(statics.contact_forces)
    notes = [
        text(
            "centre-of-pressure-of-foot",
            foot=doc.Name(foot),
            place=doc.vector_cell(load.centre_of_pressure, "+.4f"),
        )
        for foot, load in statics.foot_loads.items()
        if flat
    ]
    notes += [
        text("weld-bears", name=doc.Name(name), moment=doc.vector_cell(wrench[3:], "+.4g"))
        if wrench[3:].any()
        else text("grip-bears", name=doc.Name(name), force=f"{math.hypot(*wrench[:3]):.4g}")
        for name, wrench in statics.weld_wrenches.items()
    ]
    source = cite_page("explanation/statics.md", "Contact forces that persist in MuJoCo")
    table = contact_table(statics)
    return replace(table, notes=tuple(notes), source=(source, proof_text(verification)))


def view_block(
    robot: Robot | None,
    stand: Stand,
    statics: GravityCompensation | None,
    motions: Sequence[doc.Motion] = (),
) -> doc.SceneView:
    """Create the 3-D view of a stand; without a robot, a view that contains no scene.

    Without ``statics``, loads are omitted.
    """
    return doc.SceneView(
        text("view-title"),
        None if robot is None else doc.StandScene(robot, stand, statics, motions),
        text("view-note"),
    )
