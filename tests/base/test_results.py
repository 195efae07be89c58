"""Results as JSON and tables: complete and valid JSON, with null for numbers that are not
finite.
"""

import copy
import json
import math
import pickle
import sys
from dataclasses import dataclass, fields, replace
from enum import Enum
from functools import cache
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.base.diagnostics import Phrase, diagnose
from pupper_analysis.base.frozen import FrozenDict
from pupper_analysis.base.results import Result, shorten_paths
from tests.support.repository import ROOT
from tests.support.variants import load, stand_of

strict = {"parse_constant": lambda word: pytest.fail(f"{word} is not JSON")}


@dataclass(frozen=True, eq=False)
class Sample(Result):
    vector: np.ndarray
    number: float
    feet: dict[str, np.ndarray]


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (np.float64(1.5), 1.5),
        (np.int64(3), 3),
        (np.bool_(True), True),
        (np.float32(0.5), 0.5),
        (pa.errors.Infeasibility.PULL, "a foot would have to pull"),
        (MappingProxyType({"a": 1}), {"a": 1}),
        ((1, 2), [1, 2]),
        ({1: "a"}, {"1": "a"}),
        (None, None),
    ],
)
def test_values_of_other_types_become_json(value: object, expected: object) -> None:
    assert json.loads(pa.results.to_json(value)) == expected


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, np.float64(math.nan)])
def test_values_that_are_not_finite_become_null(value: float) -> None:
    """Also in arrays with a stride of two, which orjson does not accept directly."""
    for document in (
        {"x": value},
        {"x": [value]},
        Sample(np.array([value]), value, {"a": np.array(value)}),
    ):
        text = pa.results.to_json(document)
        assert "null" in text
        json.loads(text, **strict)
    strided = np.array([value, 0.0, value, 0.0])[::2]
    json.loads(pa.results.to_json(strided), **strict)


@pytest.mark.parametrize(
    "array",
    [
        np.arange(6.0).reshape(2, 3).T,
        np.arange(10.0)[::2],
        np.asfortranarray(np.arange(6.0).reshape(2, 3)),
        np.array(2.5),
        np.array([True, False]),
        np.array([1, 2], dtype=np.int32),
        np.zeros((0, 3)),
    ],
    ids=["transposed", "strided", "columns first", "scalar", "bool", "int32", "empty"],
)
def test_arrays_of_any_layout_become_json(array: np.ndarray) -> None:
    assert json.loads(pa.results.to_json({"x": array}))["x"] == array.tolist()


def test_arrays_of_a_result_become_lists() -> None:
    sample = Sample(np.array([1.5, -2.0]), 3.25, {"FR": np.eye(2)})
    assert sample.to_dict() == {
        "vector": [1.5, -2.0],
        "number": 3.25,
        "feet": {"FR": [[1, 0], [0, 1]]},
    }
    assert json.loads(sample.to_json()) == sample.to_dict()
    assert "\n  " in sample.to_json()


def test_json_keeps_all_digits() -> None:
    """Random bit patterns of finite doubles, in arrays and alone."""
    bits = np.random.default_rng(1).integers(0, 2**63, 200, dtype=np.uint64)
    values = np.concatenate([bits.view(float), -bits.view(float), [0.1, 5e-324, 1.7976e308]])
    values = values[np.isfinite(values)]
    assert len(values) > 300
    assert json.loads(pa.results.to_json(values)) == values.tolist()
    assert [json.loads(pa.results.to_json(value)) for value in values.tolist()] == values.tolist()


def test_values_without_a_json_form_raise() -> None:
    class Plain(Enum):
        A = object()

    for value in (object(), {"x": {1, 2}.__iter__()}, Plain.A, b"1", [1 + 2j], "\ud800"):
        with pytest.raises(pa.ConfigurationError, match="not representable in JSON"):
            pa.results.to_json(value)


def test_results_and_tasks_are_immutable() -> None:
    """Functions rely on checks of the constructor, for example of a stand's orientation."""
    stand = stand_of("v3")
    for one in (stand, pickle.loads(pickle.dumps(stand)), copy.deepcopy(stand)):
        with pytest.raises(ValueError, match="read-only"):
            one.qpos[3:7] = 0.0, 1.0, 0.0, 0.0
        with pytest.raises(ValueError, match="read-only"):
            one.foot_targets["FL"][2] += 0.1
        task = one.task
        for mapping in (one.foot_targets, one.depths, task.foot_offsets, task.ground.heights):
            before = dict(mapping)
            for change in (
                lambda m: m.update(FL=(math.nan, 0.0)),
                lambda m: m.pop("FL", None),
                lambda m: m.clear(),
                lambda m: m.__ior__({"FL": 0.0}),
                lambda m: m.__setitem__("FL", 0.0),
            ):
                with pytest.raises(TypeError, match="cannot be changed"):
                    change(mapping)
            assert mapping == before


def test_tasks_can_be_hashed() -> None:
    one, other = (
        pa.StandTask(swing={"FL": 0.02}, ground=pa.Ground(heights={"FR": height}))
        for height in (0.01, 0.02)
    )
    assert len({one, other, pa.StandTask(), replace(one), pa.StandTask(height=None)}) == 3


@cache
def results_of(name: str) -> list[object]:
    robot, stand = load(name), stand_of(name)
    return [
        stand,
        pa.gravity_compensation(pa.Configuration(robot, stand.qpos)),
        pa.gravity_compensation(pa.Configuration(robot, stand.qpos), []),
        pa.verify_stand(robot, stand, duration=2.0),
        pa.verify_stand(robot, stand, feedforward=False, duration=2.0),
        pa.simulation.sweep_gains(robot, stand, kp=[20.0], kd=[1.0], duration=2.0),
    ]


def test_json_of_a_result_contains_each_field_and_all_numbers() -> None:
    """Reference: the arrays of the results; numbers that are not finite become null."""
    for result in results_of("v3"):
        parsed = json.loads(result.to_json(), **strict)  # type: ignore[attr-defined]
        names = {field.name for field in fields(result)}  # type: ignore[arg-type]
        assert names <= set(parsed)
        for name in names:
            value = getattr(result, name)
            if isinstance(value, np.ndarray):
                expected = (
                    np.where(np.isfinite(value), value, None) if value.dtype.kind == "f" else value
                )
                np.testing.assert_array_equal(np.array(parsed[name], expected.dtype), expected)
        assert parsed == result.to_dict()  # type: ignore[attr-defined]


def test_repr_is_short_and_contains_the_key_values() -> None:
    for name in ("original", "v3"):
        robot = load(name)
        assert repr(robot) == (
            f"<Robot {name!r}: {robot.total_mass:.3f} kg, a free base, 12 joints, 4 feet>"
        )
        for result in results_of(name):
            text = repr(result)
            assert len(text) < 260
            assert text.startswith(f"{type(result).__name__}(")
            assert "\n" not in text
    small = Sample(np.array([1.5, -2.0]), 3.25, {"FR": np.eye(2)})
    assert repr(small) == "Sample(vector=[1.5, -2], number=3.25, feet=<1: FR>)"


@pytest.mark.slow
def test_tables_become_dataframes() -> None:
    """References: the arrays of statics, gain sweep and path."""
    robot, stand = load("v3"), stand_of("v3")
    held = pa.gravity_compensation(pa.Configuration(robot, stand.qpos))
    frame = held.to_dataframe()
    assert list(frame.columns) == ["joint", "torque", "utilisation"]
    assert tuple(frame["joint"]) == robot.joint_names
    np.testing.assert_array_equal(frame["torque"], held.joint_torques)
    np.testing.assert_allclose(frame["utilisation"], np.abs(frame["torque"]) / robot.effort_limits)
    sweep = pa.simulation.sweep_gains(
        robot, stand, kp=[5.0, 20.0], kd=[0.1, 0.3, 1.0], duration=2.0
    )
    frame = sweep.to_dataframe()
    row = frame[(frame.kp == 20.0) & (frame.kd == 0.3)]
    assert float(row.height_deviation.iloc[0]) == sweep.height_deviation[1, 1]
    path = pa.stance.stance_path(robot, [pa.StandTask(), pa.StandTask(pitch=0.05)], 1.0)
    frame = path.to_dataframe()
    knee = robot.joint_names[2]
    np.testing.assert_array_equal(frame[f"q {knee}"], path.joint_positions()[:, 2])
    np.testing.assert_array_equal(frame[f"tau {knee}"], path.torques[:, 2])
    findings = pa.audit_model(ROOT / "urdf" / "pupper_v3.urdf").to_dataframe()
    assert list(findings.columns)[:2] == ["rule", "severity"]


def test_to_dataframe_names_the_package_if_pandas_is_missing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    held = pa.gravity_compensation(pa.Configuration(load("v3"), stand_of("v3").qpos))
    with pytest.raises(pa.MissingPackageError, match=r"pip install 'pupper-analysis\[pandas\]'"):
        held.to_dataframe()


def test_temporary_folder_is_removed_from_diagnostics_in_mappings() -> None:
    """The mappings of results and diagnostics are read-only dictionaries."""
    noted = diagnose("problem", problem="/x/folder/a.xml", sources=Path("/x/folder/a.xml"))
    phrase = Phrase("reads /x/folder/a.xml", "/x/folder/a.xml")
    short = shorten_paths(FrozenDict(joint=noted, task=phrase), "/x/folder/")
    assert str(short["joint"]) == "a.xml"
    assert short["joint"].sources[0].file == "a.xml"
    assert (str(short["task"]), short["task"].chinese) == ("reads a.xml", "a.xml")
    assert type(short) is FrozenDict
    assert shorten_paths(noted, "/y/") is noted
