"""Types of the engines' models in ``engine_types.pyi``, against the installed engines."""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterator
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest

import pupper_analysis as pa
from pupper_analysis.robot import engine_types
from tests.support import typed_user
from tests.support.variants import load

CLASSES = {
    node.name: node
    for node in ast.parse(Path(engine_types.__file__).with_suffix(".pyi").read_text()).body
    if isinstance(node, ast.ClassDef)
}

MODELS: dict[str, Callable[[pa.Robot], object]] = {
    "PinocchioModel": lambda robot: robot.pin_model,
    "PinocchioData": lambda robot: robot.pin_data(),
    "PinocchioGeometryModel": lambda robot: robot.collision_model,
    "MujocoModel": lambda robot: robot.mj_model,
    "MujocoSpec": lambda robot: robot.mj_spec(),
}


def declared_attributes(name: str) -> Iterator[tuple[str, str]]:
    """Yield (attribute, declared type) of a class."""
    for node in CLASSES[name].body:
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            yield node.target.id, ast.unparse(node.annotation)


def has_type(value: object, declared: str) -> bool:
    """Return True if a value has the declared type; the elements of a sequence too."""
    if declared.startswith("NDArray["):
        dtype = getattr(np, declared.removeprefix("NDArray[np.").rstrip("]"))
        return isinstance(value, np.ndarray) and value.dtype == dtype
    if declared.startswith("Sequence["):
        element = declared.removeprefix("Sequence[").removesuffix("]")
        return all(has_type(item, element) for item in value)  # type: ignore[attr-defined]
    return type(value).__name__ == declared


@pytest.mark.parametrize("name", MODELS)
def test_declared_types_are_those_of_the_engine(name: str, tiny: pa.Robot) -> None:
    model = MODELS[name](tiny)
    wrong = {
        attribute: (declared, type(getattr(model, attribute, None)))
        for attribute, declared in declared_attributes(name)
        if not has_type(getattr(model, attribute, None), declared)
    }
    assert not wrong
    methods = {node.name for node in CLASSES[name].body if isinstance(node, ast.FunctionDef)}
    assert all(callable(getattr(model, method)) for method in methods - {"__get__"})


def test_classes_are_those_of_the_engines() -> None:
    expected = [mujoco.MjModel, mujoco.MjSpec, pin.Data, pin.GeometryModel, pin.Model]
    assert [getattr(engine_types, name) for name in engine_types.__all__] == expected
    assert set(CLASSES) == set(MODELS) == set(engine_types.__all__)


def test_declared_methods_return_the_declared_types(tiny: pa.Robot) -> None:
    model = tiny.pin_model
    assert type(model.copy()) is pin.Model
    assert type(model.createData()) is pin.Data
    assert type(model.getFrameId(model.frames[-1].name)) is int
    assert type(model.getJointId(model.names[-1])) is int
    assert type(model.existFrame("nothing")) is type(model.existJointName("nothing")) is bool
    assert type(tiny.mj_spec().compile()) is mujoco.MjModel
    assert type(tiny.mj_spec().to_xml()) is str


def test_typed_script_runs_on_v3() -> None:
    """`assert_type` has no effect at run time: each attribute exists, and each call is valid."""
    robot = load("v3")
    typed_user.use_models(robot)
    typed_user.use_stand(robot)
