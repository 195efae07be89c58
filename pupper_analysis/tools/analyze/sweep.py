"""How steady a stand is, by servo gains: tables and a plot of a sweep."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np

from pupper_analysis.present import document as doc
from pupper_analysis.present.document import text
from pupper_analysis.tools.analyze.gain_sweep import GainSweep


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
