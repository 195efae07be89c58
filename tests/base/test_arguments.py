"""Wrong arguments of each public function raise an error of the package that names the argument."""

from __future__ import annotations

import inspect
import math
from collections import UserList, deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import fields
from fractions import Fraction
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.base.arguments import (
    check_arguments,
    check_finite,
    check_length,
    check_type,
    find_name_patterns,
    match_names,
    real_array,
)
from tests.support.names import public, public_modules
from tests.support.tiny import Files
from tests.support.variants import load, stand_of

APART = {  # each tested with wrong arguments below, or by the tests of its own module
    *("to_json", "load_robot", "fit", "fit_motion", "fit_stands", "pareto_front", "study_outcome"),
    *("plan_stands", "tool_payload", "write_design", "write_plan"),
    "write_report",
}
OFFERED = {
    name: value
    for module in (pa, *public_modules())
    for name, value in public(module).items()
    if inspect.isfunction(value)
}
FUNCTIONS = sorted(OFFERED.keys() - APART)
JUNK = ("v3", b"v3", -1, 0, 1e308, math.nan, None, object(), [], {}, [None], {"x": None}, ())
SLOW = {"push_recovery", "best_stance", "simulate_payload", "simulate_push", "sweep_gains"}


@pytest.fixture
def usual(tiny_files: Files, tmp_path: Path) -> dict[str, Any]:
    """Return valid arguments, by name."""
    robot, stand = load("v3"), stand_of("v3")
    return {
        "robot": robot,
        "stand": stand,
        "stance": stand,
        "model": robot.mj_model,
        "data": mujoco.MjData(robot.mj_model),
        "variant": "v3",
        "folder": tmp_path,
        "path": str(tiny_files.mjcf),
        "urdf": tiny_files.urdf,
        "source": tiny_files.urdf,
        "old": tiny_files.urdf,
        "new": tiny_files.urdf,
        "output": tmp_path / "new.xml",
        "mjcf": tiny_files.mjcf,
        "config": pa.Configuration(robot, stand.qpos),
        "qacc": np.zeros(robot.nv),
        "tasks": [pa.StandTask()],
        "qpos": [stand.qpos],
        "stances": [pa.StandTask(), pa.StandTask(pitch=0.01)],
        "seconds": 0.5,
        "posture": pa.posture.find_posture(pa.load_variant("v3", fixed_base=True)),
        "tool": pa.robot.find_tool(robot, "leg_front_l_3"),
        "mass": 0.1,
        "impulse": 0.1,
        "configurations": 2,
        "low": 0.5,
        "high": 1.5,
        "count": 3,
        "mean": 1.0,
        "deviation": 0.1,
        "numbers": [1.0, 2.0],
        "duration": 2.0,
        "directions": 3,
        "log": pa.identification.Log(
            "log", np.arange(3.0), ("j",), np.zeros((3, 1)), np.zeros((3, 1))
        ),
    }


@pytest.mark.slow
@pytest.mark.parametrize("name", FUNCTIONS)
def test_wrong_arguments_raise_errors_of_the_package(
    name: str, usual: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each argument gets values of wrong type and range. Each message has one line, and the number
    of refusals is at least the number of arguments.
    """
    monkeypatch.chdir(tmp_path)
    function = OFFERED[name]
    parameters = inspect.signature(function).parameters
    if name == "track_path":
        usual["path"] = pa.stance.stance_path(usual["robot"], usual["stances"], 0.5)
    right = {key: usual[key] for key in parameters if key in usual}
    wrong = 0
    for key, parameter in parameters.items():
        hint = str(parameter.annotation)
        for junk in JUNK:
            if (junk is None and "None" in hint) or (name in SLOW and _may_be_valid(junk, hint)):
                continue
            refusal = _get_refusal(function, {**right, key: junk})
            if refusal is not None:
                wrong += 1
                assert refusal
                assert "\n" not in refusal
    assert wrong >= len(parameters)


def _get_refusal(function: Callable[..., object], arguments: dict[str, Any]) -> str | None:
    """Return the message of the error that a call raises; None if it raises none."""
    try:
        function(**arguments)
    except pa.PupperAnalysisError as error:
        return str(error)
    return None


def _may_be_valid(junk: object, hint: str) -> bool:
    """Return True if a value may be valid, so that the function would run to its end."""
    if "Array" in hint:  # arrays of gains are checked when servos are made
        return True
    kinds = {bool: "bool", int: "int", float: "float", str: "str"}
    if isinstance(junk, int | float) and not isinstance(junk, bool):
        return "float" in hint or "int" in hint or "Array" in hint
    return kinds.get(type(junk), "Mapping" if junk == {} else "?") in hint or junk is None


@pytest.mark.parametrize("field", [*pa.StandTask.__dataclass_fields__])
@pytest.mark.parametrize("junk", [object(), b"x", 1e308, float("nan"), [None], {"x": None}, {5: 1}])
def test_invalid_field_of_a_task_raises_by_name(field: str, junk: Any) -> None:
    with pytest.raises(pa.ConfigurationError, match=field.split("_")[0]):
        pa.solve_stand(load("v3"), pa.StandTask(**{field: junk}))


@pytest.mark.parametrize("kind", [pa.Ground, pa.matching.Tolerances, pa.pupper.VariantSpec])
@pytest.mark.parametrize("junk", [object(), b"x", [None], {5: 1}])
def test_invalid_field_of_a_dataclass_raises(kind: type, junk: Any) -> None:
    names = [field.name for field in fields(kind) if field.init]
    assert names
    for field in names:
        with pytest.raises(pa.PupperAnalysisError):
            kind(**{field: junk})


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: pa.analyze_variant("v3"), "robot: 'v3' is not a Robot; use pa.load_robot"),
        (lambda: pa.solve_stand(load("v3"), 0.12), "task: 0.12 is not a StandTask or None"),
        (lambda: pa.solve_stand(load("v3"), {"height": 0.1}), "use pa.StandTask(height=0.1)"),
        (lambda: pa.solve_stand(load("v3"), {5: 1}), "use pa.StandTask(height=0.12)"),
        (
            lambda: pa.Configuration(load("v3"), stand_of("v3")),
            "qpos: not an array of numbers; use stand.qpos",
        ),
        (
            lambda: pa.gravity_compensation(stand_of("v3")),
            "use pa.Configuration(robot, stand.qpos)",
        ),
        (
            lambda: pa.gravity_compensation(load("v3"), stand_of("v3")),
            "use pa.Configuration(robot, stand.qpos)",
        ),
        (lambda: pa.Configuration(load("v3"), "x"), "qpos: 'x' is a text, not an array of numbers"),
        (lambda: pa.stance.AxisAlignTask("x", (1, 0, 0)), "a point; neither is given"),
        (
            lambda: pa.stance.AxisAlignTask("x", "x", point=(1, 0, 0)),
            "axis: 'x' is not a direction",
        ),
        (
            lambda: pa.payload_limit(load("v3"), point="base_link"),
            "('base_link', 0, 0, 0.08), in m",
        ),
        (lambda: pa.payload_limit(load("v3"), point=5), "(robot.base, 0, 0, 0.08), in m"),
        (lambda: pa.solve_stand(load("v3"), explain="x"), "explain: 'x' is not True or False"),
        (lambda: pa.stance.stance_path(load("v3"), ["x"], 1.0), "each element a StandTask"),
        (lambda: stand_of("v3").for_task(3), "task: 3 is not a StandTask"),
        (lambda: stand_of("v3").with_robot(3), "robot: 3 is not a Robot"),
        (
            lambda: pa.Configuration(load("v3"), stand_of("v3").qpos).frame_jacobian(None),
            "v3: no link None; ",
        ),
        (
            lambda: load("v3").jacobian_to_mujoco(stand_of("v3").qpos, np.zeros((3, 5))),
            "shape (3, 5) is wrong; required: (n, 18)",
        ),
        (
            lambda: pa.verify_stand(load("v3"), stand_of("v3"), integrator="foo"),
            "integrator: 'foo' is unknown; valid: Euler",
        ),
        (lambda: pa.StandTask(height=np.array(True)), "height: "),
        (lambda: pa.load_variant(5), "name 5 is not valid; known variants"),
        (lambda: pa.cross_check(load("v3"), seed=-1), "seed: -1 is not a whole number"),
        (lambda: pa.audit_model(5), "path: 5 is not a robot; give a path, a name"),
        (lambda: pa.StandTask(height=1e6), "height: 1000000 m is out of range; at most 1000 m"),
        (lambda: pa.load_variant(pa.pupper.VariantSpec(leg_scale=1e-6)), "try scales closer to 1"),
        (
            lambda: pa.load_variant(pa.pupper.VariantSpec("v3", 1e300)),
            "the scale must be at most 1000",
        ),
    ],
)
def test_error_message_names_the_wrong_argument(call: Callable[[], object], message: str) -> None:
    with pytest.raises(pa.PupperAnalysisError) as caught:
        call()
    assert message in str(caught.value)


RIGHT = (
    *((1, float), (np.float32(1), float), (np.int64(1), int), (np.True_, bool)),
    *((None, float | None), (Path("x"), str | Path), ("x", str | Path)),
    *(({"a": 1.0}, Mapping[str, float]), ([1.0], Sequence[float]), (np.ones(3), Sequence[float])),
)
WRONG = ((True, float), (1, bool), ("x", Sequence[str]), ({1: 1.0}, Mapping[str, float]))


def test_check_type_accepts_only_the_annotated_type() -> None:
    for value, hint in RIGHT:
        check_type("x", value, hint)
    for value, hint in WRONG:
        with pytest.raises(pa.ConfigurationError, match=r"^x: "):
            check_type("x", value, hint)


@pytest.mark.parametrize("junk", [object(), 1.0, b"x", [None]])
def test_studies_and_reports_raise_for_wrong_arguments(junk: Any, tmp_path: Path) -> None:
    """No file is written."""
    calls: dict[str, Callable[[], object]] = {
        "table": lambda: pa.study.pareto_front(junk, {"mass": "min"}),
        "study": lambda: pa.study.study_outcome(junk, tmp_path / "x"),
        "study:": lambda: pa.study.write_design(junk, 1, tmp_path / "x"),
        "results": lambda: pa.report.write_report(junk, tmp_path / "x.html"),
    }
    for field, call in calls.items():
        with pytest.raises(pa.ConfigurationError, match=field.strip(": ")):
            call()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (np.zeros(19) + 1j, "complex128"),
        (np.ma.masked_array(np.zeros(19), mask=[True] + 18 * [False]), "masked"),
        (["0.1"] * 19, "not an array of real numbers"),
        ([True] * 19, "bool"),
        ([10**400] * 19, "too large"),
        ([None] * 19, "some elements are not numbers"),
        ([[1.0], [1.0, 2.0]], "not an array of numbers"),
    ],
)
def test_values_raise_unless_an_array_of_real_numbers(given: Any, message: str) -> None:
    """NumPy would convert such values, and drop for example an imaginary part."""
    robot, stand = load("v3"), stand_of("v3")
    calls: list[Callable[[], object]] = [
        lambda: pa.Configuration(robot, given),
        lambda: pa.steady_state(robot, stand, kp=given),
        lambda: pa.verify_stand(robot, stand, kp=given, kd=0.1),
    ]
    for call in calls:
        with pytest.raises(pa.ConfigurationError, match=message) as caught:
            call()
        assert "\n" not in str(caught.value)


def test_fits_and_plans_check_their_arguments(tmp_path: Path) -> None:
    """The message begins with the name of the wrong argument; no file is written."""
    robot = load("v3")
    a_log = pa.identification.Log("log", np.zeros(1), ("j",), *np.zeros((2, 1, 1)))
    for name, call in (
        ("measurements", lambda: pa.fit(robot, "stands")),
        ("robot", lambda: pa.fit("v3", None)),
        ("weight", lambda: pa.fit(robot, a_log, weight=3.5)),
        ("logs", lambda: pa.identification.fit_motion(robot, "log")),
        ("count", lambda: pa.identification.plan_stands(robot, 0)),
        ("seed", lambda: pa.identification.plan_stands(robot, 3, seed=-1)),
        ("robot", lambda: pa.identification.plan_stands("v3", 3)),
        ("plan", lambda: pa.identification.write_plan("plan", tmp_path / "plan.csv")),
        ("robot", lambda: pa.posture.tool_payload("posture", None, None, None)),
    ):
        with pytest.raises(pa.PupperAnalysisError, match=f"^{name}: "):
            call()
    assert not list(tmp_path.iterdir())


def test_numbers_above_the_accepted_range_are_refused_in_one_line() -> None:
    """Python integers have no largest value, and 1e308 overflows in a product."""
    robot, stand = load("v3"), stand_of("v3")
    with pytest.raises(pa.VariantError, match="must be a finite number") as caught:
        pa.pupper.VariantSpec("v3", leg_scale=10**400)
    assert len(str(caught.value)) < 200
    with pytest.raises(pa.ConfigurationError, match="exceeds the maximum"):
        pa.statics.inverse_dynamics(pa.Configuration(robot, stand.qpos), np.full(robot.nv, 1e308))
    with pytest.raises(pa.ConfigurationError, match=r"between 0 and 1e\+09") as refused:
        pa.payload_limit(robot, stand, kp=np.full(robot.nu, 1e308))
    assert "\n" not in str(refused.value)
    with pytest.raises(pa.ConfigurationError, match="not a mapping of names"):
        pa.Ground(heights={"FL": 0.1}).steps({2: np.zeros(3)})  # type: ignore[dict-item]


def test_checked_function_keeps_name_documentation_and_signature() -> None:
    @check_arguments
    def twice(number: float, *, times: int = 2) -> float:
        """Documented."""
        return number * times

    assert (twice(2), twice(2.0, times=3)) == (4, 6.0)
    assert (twice.__name__, twice.__doc__) == ("twice", "Documented.")
    assert list(inspect.signature(twice).parameters) == ["number", "times"]
    with pytest.raises(TypeError, match="missing"):
        twice()  # type: ignore[call-arg]


def test_message_about_a_robot_in_place_of_a_task_is_short() -> None:
    with pytest.raises(pa.ConfigurationError) as caught:
        pa.solve_stand(load("v3"), load("v3"))  # type: ignore[arg-type]
    assert len(str(caught.value)) < 200


def test_length_beyond_1000_m_is_refused() -> None:
    assert check_length("x", -1000) == -1000.0
    for value in (1000.1, -1000.1, float("inf"), 10**400):
        with pytest.raises(pa.ConfigurationError):
            check_length("x", value)
    with pytest.raises(pa.ConfigurationError, match="not finite"):
        check_finite("x", 10**400)


def test_fractions_and_integers_are_accepted_as_coordinates() -> None:
    state = [Fraction(0)] * 3 + [1] + [0] * 15
    qpos = pa.Configuration(load("v3"), state).qpos
    assert qpos.tolist() == [0.0] * 3 + [1.0] + [0.0] * 15


def test_numbers_without_a_float_and_arrays_without_a_length_are_refused() -> None:
    """Reference: `float` raises an OverflowError, and `iter` a TypeError, for these values."""

    @check_arguments
    def take(*, number: float = 0.0, count: int = 0, parts: Iterable[float] = ()) -> None:
        del number, count, parts

    take(number=10**300, count=10**400, parts=np.array([1.0]))
    for wrong in ({"number": 10**400}, {"number": -(10**400)}, {"parts": np.array(1.0)}):
        with pytest.raises(pa.ConfigurationError):
            take(**wrong)


@pytest.mark.parametrize(
    ("pattern", "selected"),
    [("arm[0]", ["arm[0]"]), ("arm[01]", ["arm0"]), ("arm*", ["arm0", "arm[0]"]), ("ARM0", [])],
)
def test_a_name_with_brackets_is_selected_by_its_exact_name(
    pattern: str, selected: list[str]
) -> None:
    assert match_names(pattern, ["arm0", "arm[0]", "leg"]) == selected


@pytest.mark.parametrize(
    "given",
    [
        *([True, 1.0], (2, False), [[0.5, 1.0], [True, 1.0]], [np.True_, 1.0]),
        *([np.array([True]), [1]], [np.array(True), 1.0]),
        *(deque([True, 1.0]), [deque([True]), [1.0]], UserList([0.5, False])),
    ],
    ids=repr,
)
def test_a_boolean_among_numbers_is_no_number(given: Any) -> None:
    """NumPy would convert it to 0 or 1."""
    with pytest.raises(pa.ConfigurationError, match="bool"):
        real_array("values", given)
    assert real_array("values", [[1, 2.5], (3, 4)]).tolist() == [[1.0, 2.5], [3.0, 4.0]]


@pytest.mark.parametrize(
    ("chosen", "others", "expected"),
    [
        (["panda_joint1", "panda_joint2"], ["panda_finger_joint1"], ["panda_joint*"]),
        (["FL_hip", "FR_hip"], ["FL_knee", "FR_knee"], ["*_hip"]),
        (["a", "b"], [], ["*"]),
        (["turn", "elbow", "lift"], ["slide"], ["turn", "elbow", "lift"]),
        (["arm[0]", "arm[1]"], ["arm0"], ["arm[[]*"]),
        ([], ["slide"], []),
    ],
)
def test_patterns_select_the_chosen_names_and_no_others(
    chosen: list[str], others: list[str], expected: list[str]
) -> None:
    """Reference: `match_names`, which the command line uses for patterns."""
    patterns = find_name_patterns(chosen, [*chosen, *others])
    assert sorted(patterns) == sorted(expected)
    selected = {name for pattern in patterns for name in match_names(pattern, [*chosen, *others])}
    assert selected == set(chosen)


def test_number_in_an_array_without_dimensions_is_a_number() -> None:
    assert pa.StandTask(height=np.array(0.12)) == pa.StandTask(height=0.12)
    with pytest.raises(pa.ConfigurationError, match="height"):
        pa.StandTask(height=np.array([0.12]))
