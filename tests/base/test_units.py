"""Units of published numbers: metadata of fields, independent of docstrings."""

from __future__ import annotations

import importlib
import json
import math
import pkgutil
import re
import sys
from dataclasses import Field, dataclass, field, fields, is_dataclass

import pytest

import pupper_analysis as pa
from pupper_analysis.base.provenance import to_marked_json
from pupper_analysis.base.results import Result
from pupper_analysis.base.units import (
    DIMENSIONLESS_UNIT,
    HINGE_UNITS,
    SLIDE_UNITS,
    VARYING_UNIT,
    combine_joint_units,
    find_common_units,
    find_untyped_degrees,
    units_of,
)

NUMERIC = re.compile(r"\b(float|Array|NDArray\[np\.float64\]|Position)\b")
"""Annotation of a field with measured or computed numbers; integers are counts and indices."""

_SYMBOL = r"(kg|N|m|s|rad|W|J|V|A|degC|Hz|1)(\^2)?"
UNIT = re.compile(rf"{_SYMBOL}( {_SYMBOL})*(/{_SYMBOL})?( \(quaternion\))?")
"""Unit as results write it: "N m s/rad", "rad^2/s^2"."""


def list_published_classes() -> list[type]:
    """Return each result class, and each dataclass that the fields of a result class name."""
    dataclasses: dict[str, list[type]] = {}
    for module in pkgutil.walk_packages(pa.__path__, "pupper_analysis."):
        if not module.name.endswith("__main__"):
            for kind in vars(importlib.import_module(module.name)).values():
                if isinstance(kind, type) and is_dataclass(kind) and kind.__module__ == module.name:
                    dataclasses.setdefault(kind.__name__, []).append(kind)
    kinds = [kind for same in dataclasses.values() for kind in same if issubclass(kind, Result)]
    for kind in kinds:  # grows while it is read
        for published in published_fields(kind):
            for name in re.findall(r"\w+", str(published.type)):
                meant = vars(sys.modules[kind.__module__]).get(name)
                found = dataclasses.get(name, ()) if meant is None else (meant,)
                kinds += [cls for cls in found if is_dataclass(cls) and cls not in kinds]
    return kinds


def published_fields(kind: type) -> list[Field[object]]:
    """Return the fields of a class that JSON contains."""
    return [class_field for class_field in fields(kind) if not class_field.name.startswith("_")]


def test_each_published_number_states_a_unit_or_is_dimensionless() -> None:
    kinds = list_published_classes()
    assert len(kinds) > 100
    without = [
        f"{kind.__module__}.{kind.__qualname__}.{published_field.name}"
        for kind in kinds
        for published_field in published_fields(kind)
        if NUMERIC.search(str(published_field.type)) and "unit" not in published_field.metadata
    ]
    assert without == []


def test_units_are_written_in_one_form() -> None:
    assert list_published_classes()
    for kind in list_published_classes():
        for published_field in published_fields(kind):
            unit = published_field.metadata.get("unit", DIMENSIONLESS_UNIT)
            for part in re.split(r" or | and |, ", unit):
                assert part == VARYING_UNIT or UNIT.fullmatch(part), (
                    kind,
                    published_field.name,
                    unit,
                )


def test_units_stay_if_a_docstring_is_reworded() -> None:
    @dataclass(frozen=True)
    class Load(Result):
        """Load of a motor, in a docstring without units."""

        torque: float = field(metadata={"unit": "N m"})
        share: float = field(metadata={"unit": DIMENSIONLESS_UNIT})
        name: str = ""

    assert units_of(Load) == {"torque": "N m"}
    written = json.loads(to_marked_json({"load": Load(1.0, 0.5)}))
    assert written["provenance"]["units"] == {"torque": "N m"}


def test_units_of_a_base_class_are_those_of_its_subclass() -> None:
    from pupper_analysis.statics.equilibrium import Equilibrium, GravityCompensation

    inherited = units_of(Equilibrium)
    assert inherited["joint_torques"] == "N m or N"
    assert inherited.items() <= units_of(GravityCompensation).items()


@pytest.mark.parametrize(
    ("angle", "degrees"), [(20.0, 20.0), (-5.5, -5.5), (math.radians(200), None), (200.0, None)]
)
def test_degrees_are_proposed_only_for_a_typed_number_in_range_as_degrees(
    angle: float, degrees: float | None
) -> None:
    """An angle that was typed with its unit (200 deg) is not proposed as 3.49 deg."""
    assert find_untyped_degrees(angle, -math.pi, math.pi) == degrees


@pytest.mark.parametrize(
    ("task", "hint"),
    [
        ({"pitch": -5}, "math.radians(-5)"),
        ({"contacts": {"FR": pa.Slope(0.1)}, "roll": 200}, ""),
        ({"pitch": math.radians(200)}, ""),
    ],
)
def test_an_angle_out_of_range_is_refused_with_degrees_if_they_are_in_range(
    task: dict[str, object], hint: str
) -> None:
    """The hint is the value as a user writes it in Python, where the text -5deg is refused."""
    with pytest.raises(pa.ConfigurationError) as caught:
        pa.StandTask(**task)
    assert ("for degrees write" in str(caught.value)) == bool(hint)
    assert hint in str(caught.value)


def test_a_slope_without_unit_is_refused_with_the_value_in_degrees() -> None:
    """8 rad is 458 deg; 8 deg is a slope."""
    with pytest.raises(pa.ConfigurationError, match=r"for degrees write math\.radians\(8\)"):
        pa.Slope(8)


def test_units_of_several_joints_are_one_or_both() -> None:
    """By hand; a hinge has N m/rad, a slide N/m."""
    assert combine_joint_units([]) == combine_joint_units([HINGE_UNITS] * 2) == HINGE_UNITS
    assert combine_joint_units([SLIDE_UNITS]) == SLIDE_UNITS
    mixed = combine_joint_units([SLIDE_UNITS, HINGE_UNITS])
    assert mixed == find_common_units(["N m", "N"]) == find_common_units(["m", "rad"])
    assert (mixed.stiffness, mixed.damping) == ("N m/rad or N/m", "N m s/rad or N s/m")
