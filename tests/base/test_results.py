"""Results as JSON and tables: complete and valid JSON, with null for numbers that are not
finite.
"""

import copy
import importlib
import json
import math
import pickle
import pkgutil
import re
import sys
from dataclasses import dataclass, fields, is_dataclass, replace
from enum import Enum
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Any

import mujoco
import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.base.diagnostics import Phrase, diagnose
from pupper_analysis.base.frozen import FrozenDict
from pupper_analysis.base.results import Result, shorten_paths
from pupper_analysis.statics.equilibrium import GravityCompensation
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
    for copied in (stand, pickle.loads(pickle.dumps(stand)), copy.deepcopy(stand)):
        with pytest.raises(ValueError, match="read-only"):
            copied.qpos[3:7] = 0.0, 1.0, 0.0, 0.0
        with pytest.raises(ValueError, match="read-only"):
            copied.foot_targets["FL"][2] += 0.1
        task = copied.task
        for mapping in (copied.foot_targets, copied.depths, task.foot_offsets, task.ground.heights):
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
    first, second = (
        pa.StandTask(swing={"FL": 0.02}, ground=pa.Ground(heights={"FR": height}))
        for height in (0.01, 0.02)
    )
    assert len({first, second, pa.StandTask(), replace(first), pa.StandTask(height=None)}) == 3


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


def list_result_types(base: type = Result) -> set[type]:
    """Return all dataclasses of the package that derive from ``Result``."""
    for module in pkgutil.walk_packages(pa.__path__, "pupper_analysis."):
        if not module.name.endswith("__main__"):
            importlib.import_module(module.name)
    found, rest = set[type](), [base]
    while rest:
        rest += (kind := rest.pop()).__subclasses__()
        if is_dataclass(kind) and kind.__module__.startswith("pupper_analysis."):
            found.add(kind)
    return found


def test_docstring_of_each_result_names_its_fields_and_where_they_are_described() -> None:
    """Reference: the fields of the dataclass."""
    assert "described in ``Equilibrium``: ``joint_names``, ``joint_torques``" in " ".join(
        (GravityCompensation.__doc__ or "").split()
    )
    for kind in list_result_types():
        for item in fields(kind):  # type: ignore[arg-type]
            if not item.name.startswith("_"):
                assert re.search(rf"\b{item.name}\b", kind.__doc__ or ""), (kind, item.name)


def test_each_key_field_exists() -> None:
    kinds = list_result_types()
    assert len(kinds) > 90
    for kind in kinds:
        public = {item.name for item in fields(kind)}  # type: ignore[arg-type]
        for name in kind._key_fields:  # type: ignore[attr-defined]
            assert name in public or isinstance(getattr(kind, name), property), (kind, name)


class Opaque:
    pass


@pytest.mark.parametrize(
    "value",
    [Opaque(), len, Opaque, "x" * 500, {f"key {n}" * 20: n for n in range(9)}, [Opaque()] * 9],
)
def test_repr_of_each_result_type_is_short_and_shows_no_address(value: object) -> None:
    """Each field of each public result contains the same value, as far as its class permits."""
    for kind in list_result_types():
        if kind._warnings:  # type: ignore[attr-defined]  # computed from the fields
            continue
        result = object.__new__(kind)
        for item in fields(kind):  # type: ignore[arg-type]
            object.__setattr__(result, item.name, value)
        stubs = {name: value for name in kind._key_fields if name not in vars(result)}  # type: ignore[attr-defined]
        shown = type(kind.__name__, (kind,), stubs)
        object.__setattr__(result, "__class__", shown)
        text = repr(result)
        assert len(text) <= 200
        assert " at 0x" not in text
        assert "\n" not in text
        assert text.startswith(f"{kind.__name__}(")


def test_repr_starts_with_the_key_fields() -> None:
    """Reference: the values of the results."""
    stand = stand_of("v3")
    assert repr(stand).startswith(f"Stand(solved=True, foot_error={stand.foot_error:.6g}, height_")
    changed = mujoco.MjSpec.from_file(str(ROOT / "mjcf" / "pupper_v3.xml"))
    changed.body("base_link").mass = 2.0
    diff = pa.diff_models(ROOT / "mjcf" / "pupper_v3.xml", changed)
    assert repr(diff).startswith(
        "ModelDiff(same=False, changes=<1: ModelChange(kind='mass', element='base_link', ...)>"
    )
    frame = diff.to_dataframe()
    assert (frame["old"][0], frame["new"][0], frame["unit"][0]) == (
        pytest.approx(load("v3").mj_model.body("base_link").mass[0]),
        2.0,
        "kg",
    )


def assert_numbers_have_units(result: Any) -> None:
    frame = result.to_dataframe()
    numbers = {str(name) for name in frame.columns if frame[name].dtype.kind == "f"}
    assert numbers
    assert "unit" in frame or numbers <= set(frame.attrs["units"]), type(result)


def test_each_number_in_a_dataframe_of_a_stand_has_a_unit() -> None:
    robot, stand = load("v3"), stand_of("v3")
    held = pa.gravity_compensation(pa.Configuration(robot, stand.qpos))
    assert held.to_dataframe().attrs["units"] == {"torque": "N m", "utilisation": "1"}
    verified = pa.verify_stand(robot, stand, duration=2.0)
    assert verified.to_dataframe().attrs["units"] == {"time": "s", "height": "m"}
    assert_numbers_have_units(stand)


@pytest.mark.slow
def test_dataframes_of_studies_equal_the_arrays_and_have_units() -> None:
    """References: the masses [kg] and intervals of the results."""
    robot = load("v3")
    workspace, payload = pa.stance.base_workspace(robot), pa.payload_limit(robot)
    for result in (payload, workspace):
        assert_numbers_have_units(result)
    assert payload.to_dataframe()["mass"][0] == payload.upper_bound
    row = workspace.to_dataframe().set_index("direction").loc["pitch"]
    assert (row.low, row.unit) == (workspace.intervals["pitch"].low, "rad")


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


def test_results_of_a_robot_in_memory_contain_no_invented_path() -> None:
    """Reference: MuJoCo's folder of the meshes, in which no file ``<MjSpec ...>`` exists."""
    file = ROOT / "mjcf" / "pupper_v3.xml"
    spec = mujoco.MjSpec.from_file(str(file))
    assert spec.modelfiledir
    spec.body("base_link").mass = 2.0
    audit = pa.audit_model(spec)
    diff = pa.diff_models(file, spec)
    compared = pa.compare_models(ROOT / "urdf" / "pupper_v3.urdf", spec)
    for result, name in ((audit, audit.file), (diff, diff.new), (compared, compared.mjcf)):
        assert name == "<MjSpec pupper_v3>"
        text = result.to_json()
        assert name in text
        assert f"/{name}" not in text
    assert diff.old == str(file)
    assert compared.differences[0].element == "base_link"
