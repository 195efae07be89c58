"""What simulations made of a stand: tables, drawings, and motions to step through."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from pupper_analysis.present import document as doc
from pupper_analysis.present.document import text
from pupper_analysis.present.documents.loads import proof_text
from pupper_analysis.present.documents.sources import page_of
from pupper_analysis.present.documents.standing import quantity_columns
from pupper_analysis.simulation.verify import StandVerification

if TYPE_CHECKING:
    from pupper_analysis.simulation.gain_sweep import GainSweep


def height_plot(runs: Sequence[StandVerification], task: float) -> doc.LinePlot:
    """Draws the base's height over the simulated time, with feed-forward and without.

    Args:
        runs: The simulations.
        task: The height that was asked for (m).
    """
    series = [
        doc.Series(
            text("with-feed-forward") if run.feedforward else text("without"),
            run.time,
            1e3 * run.height,
            note=_lost(run),
            fails=bool(run.failures),
        )
        for run in runs
    ]
    ends = np.array([runs[0].time[0], max(run.time[-1] for run in runs)])
    asked = doc.Name(f"{1e3 * task:.1f} mm")
    series.append(
        doc.Series(text("task"), ends, np.full(2, 1e3 * task), note=asked, reference=True)
    )
    return doc.LinePlot(
        text("height-of-the-simulated-base"),
        doc.Axis(text("time"), "s", ".2f"),
        doc.Axis(text("base-height"), "mm", ".2f"),
        series,
        text("plot-height-lost"),
    )


def _lost(run: StandVerification) -> doc.Words:
    lost = doc.number_cell(run.height_loss, ".2f", scale=1e3).text
    return text("loss-fails", loss=lost) if run.failures else doc.Name(f"{lost} mm")


def sweep_blocks(sweep: GainSweep) -> Iterable[doc.Block]:
    """Returns how steady a stand is, by servo gains."""
    yield deviation_table(sweep)
    damping = [
        [
            _damping_cell(bool(lasts), float(time), float(ratio))
            for lasts, time, ratio in zip(*row, strict=True)
        ]
        for row in zip(sweep.lasts, sweep.doubling_time, sweep.damping_ratio, strict=True)
    ]
    title = text("damping-ratio-of-the-least")
    how = text("of-the-undisturbed-stand")
    yield _by_gains(sweep, title, "1", damping, [how])
    yield from _sweep_plot(sweep)


def deviation_table(sweep: GainSweep) -> doc.Table:
    """Returns how much the base moves, by servo gains (mm); marked where it comes to no rest."""
    deviations = [
        [
            doc.number_cell(value, ".4f", "" if lasts else "bad", 1e3)
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
            "standard-deviation-of-the-bases",
            seconds=f"{sweep.duration:g}",
            force=f"{sweep.amplitude:g}",
            frequency=f"{sweep.frequency:g}",
            integrator=doc.Name(sweep.integrator),
        ),
        text("stiffer-servos-move-less"),
        text("source-gain-sweep"),
    ]
    return _by_gains(sweep, text("height-deviation-by-servo-gains"), "mm", deviations, notes)


def _damping_cell(lasts: bool, doubling_time: float, damping_ratio: float) -> doc.Cell:
    """Returns how a pair of gains is damped, or that it does not last."""
    if math.isnan(doubling_time):
        return text("does-not-rest").marked("bad")
    if not lasts:
        return text("doubles-in-time", time=f"{doubling_time:.2g}").marked("bad")
    return doc.number_cell(damping_ratio if math.isfinite(damping_ratio) else None, ".2f")


def _by_gains(
    sweep: GainSweep,
    title: doc.Words,
    unit: str,
    cells: Sequence[Sequence[doc.Cell]],
    notes: Sequence[doc.Words],
) -> doc.Table:
    """Returns a table with a row for each kp and a column for each kd."""
    return doc.Table(
        title,
        (
            doc.Column(text("kp-kd"), "N m/rad \\ N m s/rad", left=True),
            *(doc.Column(doc.Name(f"kd {kd:g}"), unit) for kd in sweep.kd),
        ),
        tuple((doc.number_cell(kp, "g"), *row) for kp, row in zip(sweep.kp, cells, strict=True)),
        tuple(notes),
    )


def _sweep_plot(sweep: GainSweep) -> Iterable[doc.Block]:
    finite = [
        (kp, row)
        for kp, row in zip(sweep.kp, sweep.height_deviation, strict=True)
        if np.isfinite(row).any()
    ]
    if finite and len(sweep.kd) > 1:
        yield doc.LinePlot(
            text("height-deviation-by-servo-gains"),
            doc.Axis(text("kd"), "N m s/rad", "g", log=bool(sweep.kd.min() > 0)),
            doc.Axis(text("height-deviation"), "mm", ".4f", log=True),
            [
                doc.Series(
                    doc.Name(f"kp {kp:g} N m/rad"), sweep.kd, _positive(1e3 * row), points=True
                )
                for kp, row in finite
            ],
        )


def _positive(values: doc.Array) -> doc.Array:
    """Returns values without those that a logarithmic axis has no place for."""
    return np.where(values > 0, values, np.nan)


def motions_of(runs: Sequence[StandVerification]) -> list[doc.Motion]:
    """Returns the simulated motions."""
    return [
        doc.Motion(
            text("simulated-with-feed-forward")
            if run.feedforward
            else text("simulated-without-feed-forward"),
            run.motion_time,
            run.motion,
        )
        for run in runs
    ]


def contact_text(sag: float) -> doc.Text:
    """Says how much deeper the feet are in the ground, or how much less deep.

    Args:
        sag: By which contacts lower the base (m); below zero where servos that give way take load
            off the contacts.
    """
    shown = f"{1e3 * abs(sag):.2f}"
    return text("contacts-rise" if sag < 0 and float(shown) else "contacts-sink", depth=shown)


def run_rows(
    runs: Sequence[Any], names: Collection[str] | None = None
) -> tuple[tuple[doc.Cell, ...], ...]:
    """Returns what simulations made of a stand: a row per quantity, a column per run.

    Args:
        runs: ``StandVerification`` each, or what else has the quantities, such as ``SteadyState``.
        names: Keys of the quantities; by default all.
    """
    return tuple(
        (
            text(name),
            *(doc.number_cell(of(run), format, scale=scale) for run in runs),
            doc.Name(unit),
        )
        for name, unit, of, format, scale in _QUANTITIES
        if names is None or name in names
    )


def simulated_table(run: StandVerification) -> doc.Table:
    """Returns what one simulation made of a stand."""
    return doc.Table(
        text("simulation", seconds=f"{run.duration:g}"),
        quantity_columns(text("with-feed-forward") if run.feedforward else text("without")),
        run_rows([run]),
        (),
        (page_of("explanation/verification.md", "Random stances"), proof_text(run)),
        detail=True,
    )


SAG = ("loss-of-height", "of-it-servo-sag", "of-it-contact-softness")
"""Quantities of a run that are predicted, too."""

_QUANTITIES: tuple[tuple[str, str, Callable[[StandVerification], float], str, float], ...] = (
    ("base-height", "mm", lambda run: run.base_height, ".2f", 1e3),
    ("loss-of-height", "mm", lambda run: run.height_loss, ".3f", 1e3),
    ("of-it-servo-sag", "mm", lambda run: run.servo_sag, ".3f", 1e3),
    ("of-it-contact-softness", "mm", lambda run: run.contact_sag, "+.3f", 1e3),
    (
        "deviation-of-height-last-second",
        "mm",
        lambda run: run.height_deviation,
        ".5f",
        1e3,
    ),
    ("drift-of-height-last-second", "mm/s", lambda run: run.height_drift, "+.4f", 1e3),
    ("tilt-against-the-task", "°", lambda run: math.degrees(run.tilt), ".4f", 1.0),
    ("foot-slip", "mm", lambda run: max(run.foot_slip.values()), ".4f", 1e3),
    ("joint-error", "°", lambda run: math.degrees(run.joint_error), ".2g", 1.0),
    ("torque-off-prediction-of-the-largest", "%", lambda run: run.torque_error, ".3f", 100.0),
    ("vertical-foot-force-off-prediction", "%", lambda run: run.force_error, ".3f", 100.0),
)
"""What is shown of a run: name, unit, value in SI units, its format, and what it is scaled by."""
