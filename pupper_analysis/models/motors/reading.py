"""Reading of motors: data files of this package, TOML files, and parameter files of servo models.

`find_motor` accepts a name of `list_motors` or a file. `read_bam_parameters` reads the JSON files
of the servo models m1 to m6 (Duclusaud, Passault, Padois and Ly 2024, "Extended Friction Models for
the Physics Simulation of Servo Actuators").
"""

from __future__ import annotations

import json
from importlib.resources import files
from pathlib import Path
from typing import Any

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError, InputError, ModelError, UnknownNameError
from pupper_analysis.base.inputs import MAX_TEXT_BYTES, path_exists, read_input, read_toml
from pupper_analysis.models.motors.motor import NUMBER_KINDS, Motor
from pupper_analysis.models.motors.units import UNIT_KINDS, parse_motor_quantity

_DATA_FOLDER = files("pupper_analysis.models.motors") / "data"
"""Folder of this package with a TOML file per motor."""

BAM_MODELS = {
    "m1": (),
    "m2": (),
    "m3": ("load_friction_base",),
    "m4": ("load_friction_base",),
    "m5": ("load_friction_motor",),
    "m6": ("load_friction_motor",),
}
"""{friction model of BAM (Better Actuator Models): parameter of the load-proportional friction of a
driving motor}; () without such a parameter. Other terms of the models, such as Stribeck and
quadratic terms, are not read."""


def list_motors() -> tuple[str, ...]:
    """Return the sorted names of the motors for which this package contains a data file."""
    return tuple(
        sorted(
            path.name.removesuffix(".toml")
            for path in _DATA_FOLDER.iterdir()
            if path.name.endswith(".toml")
        )
    )


@check_arguments
def find_motor(name: str) -> Motor:
    """Return a motor of this package by name, or read a motor from a TOML or JSON file.

    Args:
        name: Name of `list_motors`, or path.

    Raises:
        UnknownNameError: If ``name`` is neither a known name nor a file, or a key of a file is
            unknown.
        ConfigurationError: If ``name`` is no text.
        ModelError: If the file cannot be read, or is not valid. A ``name`` with a suffix is a file.
        OutputError: If this run of the command line also writes the file.
    """
    if name in list_motors():
        return read_motor(Path(str(_DATA_FOLDER / f"{name}.toml")))
    path = Path(name)
    if not name or (not path_exists(path) and not path.suffix):
        raise UnknownNameError("motors", "motor", name, list_motors())
    return read_bam_parameters(path) if path.suffix.lower() == ".json" else read_motor(path)


def read_motor(path: Path) -> Motor:
    """Read a motor from a TOML file: ``name``, ``source``, and numbers with units.

    Raises:
        ModelError: If the file cannot be read, states no source, contains a value that is not
            valid, or contains numbers that contradict each other.
        OutputError: If this run of the command line also writes the file.
        UnknownNameError: If a key is unknown.
    """
    try:
        _, stated = read_toml(path)
    except InputError as error:
        raise ModelError(path, error.cause) from error
    name, source = stated.pop("name", path.stem), stated.pop("source", "")
    sources = stated.pop("sources", {})
    texts = [name, source, *(sources.values() if isinstance(sources, dict) else [None])]
    if not name or not all(isinstance(text, str) for text in texts):
        raise ModelError(path, diagnose("motor-name-or-source"))
    if not source:
        raise ModelError(path, diagnose("motor-without-source"))
    for key in (*stated, *sources):
        if key not in NUMBER_KINDS:
            raise UnknownNameError(path, "number", key, NUMBER_KINDS)
    return _make_motor(path, name, source, stated, sources)


def read_bam_parameters(path: Path) -> Motor:
    """Read the JSON parameter file of a BAM servo model, m1 to m6.

    Torque constant, friction and armature in these files are at the output: the gear ratio is
    therefore 1. The gear efficiency is 1 minus the load-dependent friction of the model, and is
    unknown for m1 and m2.

    Raises:
        ModelError: If the file cannot be read, or is not valid.
        OutputError: If this run of the command line also writes the file.
    """
    try:
        stated = json.loads(read_input(path, MAX_TEXT_BYTES))
    except InputError as error:
        raise ModelError(path, error.cause) from error
    except (ValueError, RecursionError) as error:
        raise ModelError(path, diagnose("motor-not-json", message=str(error))) from error
    model = stated.get("model") if isinstance(stated, dict) else None
    if not isinstance(model, str) or model not in BAM_MODELS:
        raise ModelError(path, diagnose("motor-no-bam-model", models=list(BAM_MODELS)))
    if "kt" not in stated or "actuator" not in stated:
        raise ModelError(path, diagnose("motor-numbers-unknown", numbers=["kt", "actuator"]))
    numbers: dict[str, Any] = {
        "torque_constant": f"{stated['kt']!r} N m/A",
        "gear_ratio": 1,
    }
    for key in BAM_MODELS[model]:
        if key not in stated:
            raise ModelError(path, diagnose("motor-numbers-unknown", numbers=[key]))
        numbers["load_friction"] = stated[key]
        if isinstance(stated[key], int | float):  # other types are rejected below
            numbers["gear_efficiency"] = 1 - stated[key]
    for key, name, unit in (
        ("R", "resistance", "ohm"),
        ("armature", "rotor_inertia", "kg m^2"),
        ("friction_base", "coulomb_friction", "N m"),
        ("friction_viscous", "viscous_friction", "N m s/rad"),
    ):
        if key in stated:
            numbers[name] = f"{stated[key]!r} {unit}"
    return _make_motor(path, f"{stated['actuator']} ({model})", str(path), numbers, {})


def _make_motor(
    path: Path, name: str, source: str, stated: dict[str, Any], sources: dict[str, str]
) -> Motor:
    """Create a `Motor` from texts with numbers and units, such as ``80 mN m/A``.

    ``stated`` is {field of `Motor`: text}. ``sources`` is {field of `Motor`: source}, for fields
    with another source than ``source``.
    """
    try:
        numbers = {
            key: parse_motor_quantity(key, text, UNIT_KINDS[NUMBER_KINDS[key]])
            for key, text in stated.items()
        }
    except ConfigurationError as error:
        problem = diagnose("motor-number", name=error.field, problem=error.problem)
        raise ModelError(path, problem) from error
    try:
        return Motor(name=name, source=source, sources=sources, **numbers)
    except ModelError as error:  # names the motor; a message about a file names the file
        raise ModelError(path, error.cause) from error
