"""Numeric fields of a stance as parameters of studies."""

from __future__ import annotations

import math

import pytest

import pupper_analysis as pa
from pupper_analysis.stance.fields import FIELDS, Field
from pupper_analysis.tools.study.design import STANCE_VARIABLES, check_variable_range
from pupper_analysis.tools.study.design import apply_stance_values as task_of_numbers
from pupper_analysis.tools.study.measures import METRICS
from tests.stance.test_fields import choose_value, task_with


@pytest.mark.parametrize("field", FIELDS.values(), ids=FIELDS)
def test_each_field_that_is_a_number_is_a_parameter_of_studies(field: Field) -> None:
    own = {name: axis for name, (known, axis) in STANCE_VARIABLES.items() if known is field}
    if field.per == "joint":
        made = task_of_numbers(task_with(field), {f"{field.name}:knee": 0.5})
        assert made.values()[field.name] == {**choose_value(field), "knee": 0.5}
        check_variable_range(f"{field.name}:knee", -1.0, 1.0)
    if field.per or field.choices or field.name in METRICS:
        assert not own  # a measure's column has the name
        return
    assert len(own) == max(1, len(field.axes))
    value = choose_value(field)
    numbers = {name: value[axis] if field.axes else value for name, axis in own.items()}
    assert task_of_numbers(pa.StandTask(), numbers).values()[field.name] == value
    for name in own:
        check_variable_range(
            name, *sorted((field.low + 1e-6, 0.1)) if math.isfinite(field.low) else (0, 1)
        )
        if math.isfinite(field.low):
            with pytest.raises(pa.ConfigurationError, match="must be"):
                check_variable_range(name, field.low - 1e-3, 0.1)
    if field.axes:  # a coordinate of a point leaves the other unchanged
        second = list(own)[1]
        moved = task_of_numbers(task_with(field), {second: 0.5})
        assert moved.values()[field.name] == (value[0], 0.5)
