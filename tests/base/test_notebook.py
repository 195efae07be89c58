"""Tables of results in notebooks: values, units and escaped names."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.base.notebook import format_value
from pupper_analysis.base.results import Result
from pupper_analysis.base.units import POSITION_UNIT
from pupper_analysis.statics.equilibrium import FootLoad
from tests.support.variants import load, stand_of


@dataclass(frozen=True, eq=False)
class Sample(Result):
    torque: float = field(metadata={"unit": "N m"})
    shares: np.ndarray = field(metadata={"unit": "1"})
    forces: dict[str, np.ndarray] = field(metadata={"unit": "N"})
    name: str
    hidden: float | None = None


def rows_of(shown: Any) -> dict[str, tuple[str, str]]:
    """Return {field: (value, unit)} of a table, as an XML parser reads the HTML."""
    text = shown._repr_html_().replace("&ndash;", "none").replace("<br>", "<br/>")
    found = {}
    for row in ElementTree.fromstring(text).iterfind("tbody/tr"):
        name, value, unit = ("".join(cell.itertext()) for cell in row)
        found[name] = value, unit
    return found


def test_a_table_states_each_field_with_its_unit() -> None:
    sample = Sample(0.123456, np.array([0.5, 1.0]), {"FL": np.array([0.0, 0.0, 8.0])}, "<b>", None)
    assert rows_of(sample) == {
        "torque": ("0.1235", "N m"),
        "shares": ("0.5, 1", "1"),
        "forces": ("FL: 0, 0, 8", "N"),
        "name": ("<b>", ""),
        "hidden": ("none", ""),
    }


def test_names_in_a_mapping_are_escaped() -> None:
    assert format_value({"<script>": 1.0}) == "&lt;script&gt;: 1"


def test_rounding_noise_is_shown_as_zero() -> None:
    assert format_value(np.array([1e-17, 2.0, -3e-18])) == "0, 2, 0"
    assert format_value({"knee": -1e-16, "hip": 2.0}) == "knee: 0<br>hip: 2"
    assert format_value({"mass": 2e6, "inertia": 1e-6}) == "mass: 2000000<br>inertia: 0.000001"
    assert format_value((-1e-16, 2.0)) == "0, 2"
    assert format_value([1e-17, 2]) == "0, 2"
    assert format_value([1e-17, np.int64(2)]) == "0, 2"
    assert format_value([3e-17, 10**400]).endswith(f", {10**400}")
    assert format_value([1e-17, True]).endswith(", True")
    assert format_value(np.append(np.full(20, -1e-17), 3.0)) == "array of 21, 0 to 3"
    assert repr(FootLoad(np.array([-1e-17, 0.0, 7.5]), np.zeros(3), 0.0)).startswith(
        "FootLoad(force=[0, 0, 7.5]"
    )
    assert format_value(np.array([1e-6, 2.0])) == "0.000001, 2"


def test_missing_numbers_of_an_array_are_not_shown_as_zero() -> None:
    assert format_value(np.array([1.0, np.nan, np.inf])) == "1, nan, inf"


def test_the_range_of_an_array_ignores_missing_numbers_and_counts_them() -> None:
    values = np.append(np.full(3, np.nan), np.arange(10.0))
    assert format_value(values) == "array of 13, 0 to 9, 3 nan"
    assert format_value(np.full(13, np.nan)) == "array of 13, all nan"


@dataclass(frozen=True, eq=False)
class Nested(Result):
    sample: Sample
    interval: pa.stance.Interval
    intervals: dict[str, pa.stance.Interval]
    unit: str = "kg"
    limit: float = field(default=1.5, metadata={"unit": "varies"})

    def _field_units(self) -> dict[str, dict[str, str]]:
        return {"intervals": {"x": "m", "yaw": "rad"}}


def test_nested_results_are_short_texts_with_units() -> None:
    """Reference: the values of the nested fields. A dictionary in a field needs a table."""
    interval = pa.stance.Interval(-0.1, 0.25)
    sample = Sample(1.5, np.ones(2), {}, "<b>")
    rows = rows_of(Nested(sample, interval, {"x": interval, "yaw": interval}))
    assert rows["sample"][0].startswith("Sample")
    assert "1.5N m" in rows["sample"][0]
    assert rows["interval"][0] == "low -0.1 rad or m, high 0.25 rad or m"
    assert rows["intervals"][0] == ("x: low -0.1 m, high 0.25 myaw: low -0.1 rad, high 0.25 rad")
    assert rows["limit"] == ("1.5", "kg")


@pytest.mark.slow
def test_the_table_of_the_best_stance_labels_angles_lengths_and_the_objective() -> None:
    best = pa.best_stance(load("v3"))
    rows = rows_of(best)
    assert rows["value"] == (f"{best.value:.4g}", "1")
    assert re.search(r"height: 0\.\d+ m", rows["coordinates"][0])
    assert re.search(r"pitch: -?[\d.]+ rad", rows["coordinates"][0])
    assert re.search(r"x: low -?[\d.]+ m, high [\d.]+ m", rows["bounds"][0])
    assert re.search(r"yaw: low -0.3 rad, high 0.3 rad", rows["bounds"][0])
    frame = best.to_dataframe()
    assert dict(zip(frame.coordinate, frame.unit, strict=True))["yaw"] == "rad"
    np.testing.assert_array_equal(frame.value, [*best.coordinates.values()])


def test_positions_of_long_objects_have_the_unit_of_their_container() -> None:
    @dataclass(frozen=True, eq=False)
    class Long(Result):
        """Result with a field without a short text."""

        position: float = field(metadata={"unit": POSITION_UNIT})
        forces: np.ndarray = field(metadata={"unit": "N"})

    item = Long(0.5, np.ones((9, 9)))

    assert format_value((item,), "m") == "position 0.5 m, ..."
    assert format_value((item,)) == f"position 0.5 {POSITION_UNIT}, ..."


def test_long_arrays_and_mappings_are_summarised() -> None:
    assert format_value(np.arange(24.0).reshape(8, 3)) == "array of 8 x 3, 0 to 23"
    entries = format_value({f"joint{index}": float(index) for index in range(15)})
    assert entries.count("<br>") == 12
    assert entries.endswith("and 3 more")


@pytest.mark.parametrize(("value", "text"), [(np.inf, "inf"), (-np.inf, "-inf"), (np.nan, "nan")])
def test_numbers_that_are_not_finite_are_shown(value: float, text: str) -> None:
    assert format_value(value) == text


def test_robot_configuration_stand_and_statics_have_tables() -> None:
    """Reference: the attributes that the tables show."""
    robot, stand = load("v3"), stand_of("v3")
    config = pa.Configuration(robot, stand.qpos)
    assert rows_of(robot)["total_mass"] == (f"{robot.total_mass:.4g}", "kg")
    position, unit = rows_of(config)["base position"]
    assert unit == "m"
    assert float(position.split(", ")[2]) == pytest.approx(stand.qpos[2], rel=1e-3)
    assert rows_of(stand)["foot_error"][1] == "m or rad"
    statics = rows_of(pa.gravity_compensation(config))
    torques, unit = statics["joint_torques"]
    named = re.findall(r"(leg_\w+?_\d): (-?[\d.]+)", torques)
    assert ([joint for joint, _ in named], unit) == ([*robot.joint_names], "N m")
    computed = pa.gravity_compensation(config).joint_torques
    np.testing.assert_allclose([float(text) for _, text in named], computed, rtol=1e-3, atol=1e-9)
    # The stand is symmetric: joint positions and tangential forces are zero up to rounding.
    assert "e-" not in rows_of(config)["joint positions"][0] + statics["foot_loads"][0]


def test_tables_and_reprs_start_with_the_violations_of_a_stand() -> None:
    """The required clearance, 0.2 m, is larger than the height of each part of v3."""
    robot, stand = load("v3"), stand_of("v3")
    posture = pa.solve_posture(robot, [pa.stance.CoMTask((0, 0, 0.1))], start=stand)
    assert posture.stand is not None
    assert "blocked" not in posture._repr_html_() + repr(posture) + repr(stand)
    near = posture.stand.for_task(replace(posture.stand.task, ground_clearance=0.2))
    (message,) = near.blocked
    blocked = replace(posture, stand=near)
    (name, (text, _)), *rest = rows_of(blocked).items()
    assert (name, text) == ("stand.blocked", str(message))
    assert repr(blocked).startswith(f"SolvedPosture(stand.blocked='{message}', ")
    assert repr(near).startswith(f"Stand(blocked='{message}', ")
    # The stand is a table in the cell.
    shown = dict(rest)["stand"][0]
    assert "foot_error" in shown
    assert shown.count(str(message)) == 1


def test_the_repr_of_a_configuration_states_robot_and_base() -> None:
    text = repr(pa.Configuration(load("v3"), stand_of("v3").qpos))
    assert text.startswith("<Configuration of 'v3': base at (")
    assert text.endswith("m, 12 joints, at rest>")


def test_a_configuration_with_a_fixed_base_shows_its_joints_only() -> None:
    """Reference: qpos of a fixed base contains the joint positions alone."""
    robot = load("v3", fixed_base=True)
    config = pa.Configuration(robot, np.linspace(0.1, 0.3, robot.nq))
    rows = rows_of(config)
    assert "base position" not in rows
    assert rows["joint positions"][0].startswith("leg_front_r_1: 0.1")
    assert "fixed base, 12 joints" in repr(config)
