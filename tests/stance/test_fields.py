"""The table of task fields: each field is in the task's JSON, text, options and error messages."""

from __future__ import annotations

import json
import math
import re
from dataclasses import fields
from typing import Any

import pytest

import pupper_analysis as pa
from pupper_analysis import cli
from pupper_analysis.base.results import to_json
from pupper_analysis.cli.stance_fields import OPTION_FIELDS, make_task
from pupper_analysis.present.documents.standing import task_text
from pupper_analysis.stance.fields import FIELDS, Field

NUMBERS = {"length": 0.0123, "angle": math.radians(7.5), "position": 0.1309}


def choose_value(field: Field) -> Any:
    """Return a value of a field that differs from the default."""
    if field.kind == "contact":
        return {"FL": pa.Contact(pa.Plane((0.0123, 0, 0), (-1, 0, 0), 0.5))}
    one = (0.0123, -0.0345) if field.axes or field.choices else NUMBERS[field.kind]
    return {"FL": one} if field.per else one


def numbers_of(value: Any) -> Any:
    """Return a value for ``approx``; of values per foot, the value of the single foot."""
    if isinstance(value, dict):
        ((foot, one),) = value.items()
        assert foot == "FL"
        return pytest.approx(one, rel=1e-12)
    return pytest.approx(value, rel=1e-12)


def is_near(found: Any, expected: Any) -> bool:
    one = found["FL"] if isinstance(found, dict) else found
    if isinstance(one, pa.Contact):
        return bool(one == expected["FL"])
    return bool(one == numbers_of(expected))


def task_with(field: Field) -> pa.StandTask:
    others = {"offset": (0.0, 0.0)} if field.name == "com_margin" else {}
    return pa.StandTask().with_values({**others, field.name: choose_value(field)})


def format_typed(field: Field) -> str:
    """Return the text of a field's test value as a user types it."""
    if field.axes or field.choices:
        text = "12.3mm,-3.45cm"
    else:
        lengths = {"length": "12.3mm", "contact": "wall:12.3mm,mu=0.5"}
        text = {**lengths, "angle": "7.5deg", "position": "130.9mm"}[field.kind]
    return f"FL={text}" if field.per else text


def test_field_table_contains_each_field_of_task_and_ground() -> None:
    """Reference: the fields of the dataclasses, and their defaults."""
    of = {"task": pa.StandTask, "ground": pa.Ground}
    for part, kind in of.items():
        # Fields without an entry: the ground itself, the initial guess, and the planes of contacts.
        own = {field.name for field in fields(kind)} - {"ground", "ik_seed", "_planes"}
        assert own == {field.name for field in FIELDS.values() if field.part == part}
    usual = pa.StandTask().values()
    assert usual == {name: field.default_value for name, field in FIELDS.items()}


@pytest.mark.parametrize("field", FIELDS.values(), ids=FIELDS)
def test_each_field_appears_in_task_json_and_text(field: Field) -> None:
    """Both languages state the same numbers."""
    task = task_with(field)
    assert task.values()[field.name] == choose_value(field)
    content = json.loads(to_json(task))
    found = (content if field.part == "task" else content[field.part])[field.name]
    assert found == json.loads(to_json(choose_value(field)))
    if field.name == "uphill":  # only the text of a slope states it
        task = task.with_values({"slope": 0.1})
    text, plain = task_text(task), task_text(pa.StandTask())
    assert text.en != plain.en
    assert re.search("[\u4e00-\u9fff]", text.zh)
    number = re.compile(r"-?\d+\.?\d*")
    assert number.findall(text.zh) == number.findall(text.en)
    assert str(task) == text.en


@pytest.mark.parametrize("field", FIELDS.values(), ids=FIELDS)
def test_each_field_refuses_invalid_values(field: Field) -> None:
    """The error names the field."""
    wrong: list[Any] = [math.nan, "much", True, (1.0,), (0.0, math.inf)]
    if not (field.axes or field.choices):
        wrong += [field.low - 1e-3] * math.isfinite(field.low)
        wrong += [field.high + 0.01] * math.isfinite(field.high) + [field.low] * field.open
    for value in wrong:
        with pytest.raises(pa.ConfigurationError) as refused:
            pa.StandTask().with_values({field.name: {"FL": value} if field.per else value})
        assert refused.value.field.startswith(field.name)
    if field.per:
        with pytest.raises(pa.ConfigurationError, match=field.name):
            pa.StandTask().with_values({field.name: 0.1})


CLOSED_FIELDS = [
    field
    for field in FIELDS.values()
    if field.part == "task" and math.isfinite(field.low) and not (field.open or field.per)
]


@pytest.mark.parametrize("field", CLOSED_FIELDS, ids=lambda field: field.name)
def test_value_below_a_permitted_lower_bound_is_refused_by_the_bound(field: Field) -> None:
    """The bound is permitted: "not above" would be wrong."""
    assert pa.StandTask().with_values({field.name: field.low}) is not None
    with pytest.raises(pa.ConfigurationError) as refused:
        pa.StandTask().with_values({field.name: field.low - 1e-3})
    expected = "angle-out-of-range" if field.unit == "rad" else "below-the-least"
    assert refused.value.problem.code == expected


@pytest.mark.parametrize("field", OPTION_FIELDS.values(), ids=OPTION_FIELDS)
def test_each_field_is_an_option_with_the_same_value(field: Field) -> None:
    """Reference: the value of the field; without an option, the default task."""
    command = cli.find_command("stand")
    context = command.make_context("stand", [f"--{field.option}", format_typed(field)])
    typed = {name: context.params[name] for name in OPTION_FIELDS}
    assert is_near(make_task(typed).values()[field.name], choose_value(field))
    default = command.make_context("stand", [])
    assert make_task({name: default.params[name] for name in OPTION_FIELDS}) == pa.StandTask()


ON_PAGE: dict[str, Any] = {
    **{"length": 12.3, "angle": 7.5, "point": (12.3, -34.5), "position": 0.1309},
    "contact": pa.Contact(pa.Plane((0.0123, 0, 0), (-1, 0, 0), 0.5)),
}
SLIDING = {name: field for name, field in FIELDS.items() if field.slider}


def test_task_text_has_fixed_order_and_units() -> None:
    """Reference: a text written by hand."""
    task = pa.StandTask(
        height=0.12,
        roll=math.radians(1.5),
        offset=(0.01, -0.02),
        foot_offsets={"FL": (0.003, 0.004)},
        feet={"FR": (0.1, -0.2)},
        swing={"RL": 0.05},
        ground=pa.Ground(slope=math.radians(6), uphill=math.radians(77), heights={"RR": 0.008}),
        com_margin=0.009,
        joint_margin=math.radians(11),
        ground_clearance=0.013,
        self_clearance=0.014,
        posture={"*elbow*": 0.5236},
    )
    assert str(task) == (
        "height 120.0 mm, roll 1.5 deg, pitch 0.0 deg, yaw 0.0 deg, base (10, -20) mm from the "
        "centre, FR at (100, -200) mm, FL moved by (3, 4) mm, RL lifted 50 mm, slope 6.0 deg, "
        "rising towards 77 deg, RR on 8 mm, CoM in the support polygon (margin >= 9 mm), "
        "joint-limit margin 11.0 deg, ground clearance 13 mm, links 14 mm apart, "
        "*elbow* at 0.5236 rad or m"
    )
    assert task.describe("zh").startswith("高度 120.0 mm，横滚 1.5 deg，")


@pytest.mark.parametrize("field", FIELDS.values(), ids=FIELDS)
def test_task_is_restored_from_json_and_from_changed_values_alone(field: Field) -> None:
    task = task_with(field)
    assert pa.StandTask.from_dict(json.loads(to_json(task))) == task
    alone = {
        name: value
        for name, value in task.values().items()
        if value != FIELDS[name].default_value and name != "contacts"
    }
    if field.name != "contacts":
        assert pa.StandTask.from_dict(alone) == task
    with pytest.raises(pa.ConfigurationError, match="unknown field of a stance; valid: height, "):
        pa.StandTask.from_dict({f"{field.name}s_": 0.1})


@pytest.mark.parametrize("field", OPTION_FIELDS.values(), ids=OPTION_FIELDS)
def test_example_of_each_option_is_a_valid_value(field: Field) -> None:
    context = cli.find_command("stand").make_context(
        "stand", ["v3", f"--{field.option}", field.example.strip("'")]
    )
    task = make_task({name: context.params[name] for name in OPTION_FIELDS})
    assert task.values()[field.name] != pa.StandTask().values()[field.name]


def test_examples_of_options_are_in_mm_or_degrees() -> None:
    units = {"m": ("mm", "cm"), "rad": ("deg",)}
    for option in cli.find_command("stand").params:
        if option.name in OPTION_FIELDS:
            text, unit = getattr(option, "help", "") or "", FIELDS[option.name].unit
            assert "(m)" not in text, option.name
            assert "(rad" not in text, option.name
            if unit in units:
                example = text.partition("e.g. ")[2]
                assert any(unit_text in example for unit_text in units[unit]), option.name


def test_text_of_a_task_states_a_requested_position_of_the_com() -> None:
    assert "com" not in str(pa.StandTask(com="centre", com_margin=0.01))
    for margin in (0.0, 0.01):
        expected = f"CoM in the support polygon (margin >= {1e3 * margin:.0f} mm)"
        assert expected in str(pa.StandTask(com="inside", com_margin=margin))
    assert "CoM at (10, 20) mm" in str(pa.StandTask(com=(0.01, 0.02)))
