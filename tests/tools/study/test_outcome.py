"""Evaluation of a study's table: Pareto fronts, main effects, recorded diagnostics."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy import stats

import pupper_analysis as pa
from pupper_analysis.base.diagnostics import Phrase, Quantity, Source, Term, Vector, diagnose
from pupper_analysis.tools.study.design import from_record, to_record
from pupper_analysis.tools.study.outcome import (
    _assign_cells,
    compute_main_effects,
    find_column_unit,
    pareto_front,
)
from tests.support.legged import quadruped_with_slides
from tests.support.variants import load


def test_pareto_front_dominates_all_other_designs() -> None:
    """Reference: comparison of all pairs of 300 designs."""
    random = np.random.default_rng(0)
    table = pd.DataFrame(random.integers(0, 12, (300, 3)).astype(float), columns=["a", "b", "c"])
    table.loc[5, "b"] = np.nan
    senses = {"a": "min", "b": "max", "c": "min"}
    front = pareto_front(table, senses)
    signs = np.array([1.0, -1.0, 1.0])

    def beats(one: np.ndarray, other: np.ndarray) -> bool:
        return bool((signs * one <= signs * other).all() and (one != other).any())

    complete = table.dropna().to_numpy()
    expected = [row for row in complete if not any(beats(rival, row) for rival in complete)]
    assert sorted(map(tuple, front.to_numpy())) == sorted(map(tuple, expected))
    assert list(front["a"]) == sorted(front["a"])
    assert 3 < len(front) < 100
    with pytest.raises(pa.ConfigurationError, match="'d': 'min' is not a column"):
        pareto_front(table, {"d": "min"})
    with pytest.raises(pa.ConfigurationError, match="'least'"):
        pareto_front(table, {"a": "least"})
    for odd in (["x", "y", "z"], [object()] * 3, [10**400] * 3):
        with pytest.raises(pa.ConfigurationError, match="column 'o'"):
            pareto_front(pd.DataFrame({"o": odd}), {"o": "min"})


def test_main_effects_are_kelleys_of_fishers_ratio() -> None:
    """With F = (between / (k - 1)) / (within / (n - k)), by scipy: a fraction of the variance."""
    random = np.random.default_rng(2)
    x, other = np.repeat([1.0, 2.0, 4.0], 5), np.tile([0.0, 1.0, 2.0, 3.0, 4.0], 3)
    made = pd.DataFrame({"x": x, "y": other, "m": 0.3 * x + random.normal(size=15)})
    found = compute_main_effects(made, ["x", "y"], "m")
    for name, groups in (("x", 3), ("y", 5)):
        ratio = stats.f_oneway(*(part["m"] for _, part in made.groupby(name))).statistic
        between = groups - 1
        share = between * (ratio - 1) / (between * ratio + len(made) - groups)
        assert found[name] == pytest.approx(max(0.0, share), abs=1e-12)
    assert 0 < found["x"] < 1
    many = np.random.default_rng(5).uniform(size=(600, 2))  # each value once: in evenly wide cells
    sampled = pd.DataFrame({"x": many[:, 0], "y": many[:, 1], "m": 3 * many[:, 0]})
    shares = compute_main_effects(sampled, ["x", "y"], "m")
    assert shares["x"] == pytest.approx(1 - 1 / 14**2, abs=3e-3)  # 14 cells: variance inside a cell
    assert shares["y"] < 0.05


def test_main_effects_of_an_additive_function_are_shares_of_its_variance() -> None:
    """Closed form: of y = 3 a + b on a grid, 9/10 and 1/10; without the upper half of a, 0.675.

    Noise and rounding of a constant have no effect.
    """
    a, b = (values.ravel() for values in np.meshgrid(np.linspace(0, 1, 12), np.linspace(0, 1, 12)))
    table = pd.DataFrame({"a": a, "b": b, "y": 3 * a + b, "noise": 0.0, "same": 0.075})
    table["noise"] = np.random.default_rng(1).normal(size=len(table))
    table.loc[::2, "same"] += 1e-16
    shares = compute_main_effects(table, ("a", "b"), "y")
    assert shares["a"] == pytest.approx(0.9, abs=0.01)
    assert shares["b"] == pytest.approx(0.1, abs=0.08)
    assert max(compute_main_effects(table, ("a", "b"), "noise").values()) < 0.1
    assert compute_main_effects(table, ("a", "b"), "same") == {"a": 0.0, "b": 0.0}
    table.loc[table["a"] > 0.5, "y"] = np.nan  # designs without a value do not count
    assert compute_main_effects(table, ("a", "b"), "y")["a"] == pytest.approx(0.675, abs=0.08)


def test_main_effects_of_ishigamis_function_are_its_first_sobol_indices() -> None:
    """Ishigami and Homma (1990), a = 7, b = 0.1: 0.314, 0.442 and 0."""
    values = np.random.default_rng(0).uniform(-np.pi, np.pi, (20_000, 3))
    table = pd.DataFrame(values, columns=["x", "y", "z"])
    x, y, z = values.T
    table["f"] = np.sin(x) + 7 * np.sin(y) ** 2 + 0.1 * z**4 * np.sin(x)
    shares = compute_main_effects(table, ["x", "y", "z"], "f")
    assert [shares[name] for name in "xyz"] == pytest.approx([0.314, 0.442, 0.0], abs=0.02)


def test_cells_of_many_values_have_one_width_and_few_values_are_cells() -> None:
    """400 values: sqrt(400 / 3) = 11 intervals; 48 values: four; up to 24 values: themselves."""
    values = np.random.default_rng(0).uniform(2.0, 5.0, 400)
    cells, width = _assign_cells(values), np.ptp(values) / 11
    assert {*cells.tolist()} == {*range(11)}
    assert (np.abs(values - values.min() - width * (cells + 0.5)) <= width / 2 * 1.000001).all()
    even = _assign_cells(np.linspace(0.0, 1.0, 48)).astype(int)
    assert np.bincount(even).tolist() == [12, 12, 12, 12]
    few = np.array([1.0, 4.0, 1.0, 2.0])
    np.testing.assert_array_equal(_assign_cells(few), few)
    np.testing.assert_array_equal(_assign_cells(values[:24]), values[:24])


def test_recorded_diagnostics_render_in_each_language() -> None:
    missed = diagnose(
        "foot-misses-target",
        subject=("foot", "FL"),
        gap=Quantity(0.002, "m"),
        sources=Source("a.urdf", 7, "joint/limit", "effort"),
    )
    within = diagnose(
        "name-unknown", kind=Term("joint"), unknown="joint", known=("a", "term: joint")
    )
    one = diagnose(
        "com-moved-otherwise",
        body="base",
        moved=Vector((0.0, 1.5, 0.0), "m"),
        asked=Vector((0.0, 0.0, 0.0), "m"),
    )
    phrase = diagnose("problem", problem=Phrase("height 1 m", "高度 1 m"))
    nested = diagnose("argument-not-valid", field="f", problem=within)
    for kept in (missed, within, one, phrase, nested):
        again = from_record(json.loads(json.dumps(to_record(kept))))
        assert again == kept
        assert (again.text("en"), again.text("zh")) == (kept.text("en"), kept.text("zh"))


def test_units_of_torques_and_stiffnesses_are_those_of_the_joints(tmp_path: Path) -> None:
    """A slide has forces in N; values of hinges and slides together have both units."""
    robot = pa.load_robot(quadruped_with_slides(tmp_path))
    units = {
        "torque.FL_knee": "N",
        "torque.FL_pitch": "N m",
        "peak_torque": "N m or N",
        "walk_torque": "N m or N",
        "minimum_stiffness": "N m/rad or N/m",
        "kp": "N m/rad or N/m",
        "kd": "N m s/rad or N s/m",
        "utilisation.FL_knee": "",
        "sag": "m",
        "payload": "kg",
        "mass:base": "",
    }
    assert {column: find_column_unit(column, robot) for column in units} == units
    hinges = {"torque.leg_front_l_1": "N m", "peak_torque": "N m", "minimum_stiffness": "N m/rad"}
    assert {column: find_column_unit(column, load("v3")) for column in hinges} == hinges
