"""Template of the TOML file that defines observation and action of a policy.

`write_template` writes the frequent keys of the contract (`_MEANINGS`) as comments: keys that a
file states with their source, missing keys to be completed, and optional keys.
"""

from __future__ import annotations

import ast
import json
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from pupper_analysis.base.files import write_atomically
from pupper_analysis.base.kinds import MODEL_KIND
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.contract.deployment import Deployment
from pupper_analysis.tools.walk.contract import TERM_SIZES
from pupper_analysis.tools.walk.policy import read_statements

_REQUIRED_KEYS = ("observation", "default", "action-scale", "rate")
"""Keys of a policy contract that have no default value. The template marks a required key that no
file states.
"""

_MEANINGS = {
    "observation": "terms of a frame of the observation, in order",
    "joints": "joints in the order of the policy; without: the order of the robot's actuators",
    "default": "joint positions that observed positions are relative to [rad]",
    "action-offset": "joint positions for an action of zero [rad]; without: the default",
    "action-scale": "change of joint positions for an action of 1 [rad]",
    "kp": "servo stiffness [N m/rad]; without: the servos of the robot's files",
    "kd": "servo damping [N m s/rad]",
    "effort": "torque limits at the joints [N m]; without: those of the robot's files",
    "rate": "rate of the policy [Hz]",
    "latency": "delay from an observation to the command [s]; without: 0",
    "clip": "bound of the magnitude of each observation; without: none",
    "action-clip": "bound of the magnitude of each action; without: none",
    "history": "number of frames of each term; without: 1; a term may state its own history",
    "phase-rate": "frequency of the gait phase [Hz], if a phase is observed",
}
"""{key of a policy contract: comment above the key in the template}, in the order of the file."""


def list_missing_bases(sources: Sequence[str]) -> list[str]:
    """Return the imported base classes of Python classes whose files are not found, by name.

    The file of a module is searched in the folders above the source.

    Args:
        sources: Files of deployment and trainer, or ``FILE:NAME``.
    """
    missing: dict[str, None] = {}
    for source in sources:
        path = Path(source if Path(source).suffix == ".py" else source.rpartition(":")[0])
        if path.suffix != ".py":
            continue
        with suppress(OSError, SyntaxError, ValueError):
            tree = ast.parse(path.read_bytes())
            modules = {
                alias.asname or alias.name: (statement.module or "", statement.level)
                for statement in tree.body
                if isinstance(statement, ast.ImportFrom)
                for alias in statement.names
            }
            for statement in tree.body:
                for base in statement.bases if isinstance(statement, ast.ClassDef) else ():
                    name = base.id if isinstance(base, ast.Name) else ""
                    if name in modules and not _finds_module(path, *modules[name]):
                        missing[name] = None
    return list(missing)


def _finds_module(path: Path, module: str, level: int) -> bool:
    """Return True if a folder above a Python file contains the file or package of a module."""
    folders = path.resolve().parents
    relative = Path(*module.split("."))
    searched = folders if level == 0 else folders[level - 1 : level]
    return any(
        (folder / relative).with_suffix(".py").is_file() or (folder / relative).is_dir()
        for folder in searched
    )


def write_template(
    policy: Path, robot: Robot, deployment: Deployment | None = None
) -> tuple[Path, tuple[str, ...]]:
    """Write a template of the TOML file that defines a policy's observation and action.

    Returns:
        Path of the TOML file beside the policy; keys that the user must complete.

    Raises:
        ModelError: If the policy cannot be read.
        OutputError: If the file cannot be written, or would replace another file.
    """
    network, statements = read_statements(policy, deployment)
    stated = {key: statement for statement in statements for key in statement.values}
    missing = tuple(key for key in _REQUIRED_KEYS if key not in stated)
    lines = [
        f"# Observation and action of {policy.name}: {network.inputs} inputs, {network.outputs} "
        f"outputs, for {robot.name}.",
        "# Keys that other files state are comments; without the # they replace these numbers.",
        f"# Terms: {', '.join(TERM_SIZES)}.",
    ]
    suggestions = _suggest_values(robot, network.outputs)
    for key, meaning in _MEANINGS.items():
        lines += ["", f"# {meaning}"]
        if key in stated:
            source = stated[key]
            place = source.places.get(key, source.file)
            origin = source.origins.get(key, "stated")
            lines.append(f"# {key} = {_format_toml_value(source.values[key])}  # {origin}: {place}")
        elif key in missing:
            lines.append(f"# {key} = {suggestions.get(key, '')}  # unknown: complete this line")
        else:
            lines.append(f"# {key} = {suggestions.get(key, '')}".rstrip())
    path = policy.parent / f"{policy.stem}.toml"
    with write_atomically(path, MODEL_KIND) as file:
        file.write(("\n".join(lines) + "\n").encode())
    return path, missing


def _suggest_values(robot: Robot, outputs: int) -> dict[str, str]:
    """Suggest TOML values for ``observation`` and, if possible, ``joints`` and ``default``.

    If the policy commands fewer joints than the robot has, all joints are suggested as ``joints``:
    the user deletes the others.
    """
    terms = ["angular-velocity", "gravity", "command", "joint-positions", "joint-velocities"]
    values: dict[str, Any] = {"observation": [*terms, "last-action"]}
    if robot.nu >= outputs:
        values["joints"] = list(robot.joint_names)
    if robot.nu == outputs:
        values["default"] = np.round(robot.home[-robot.nu :], 6).tolist()
    return {key: _format_toml_value(value) for key, value in values.items()}


def _format_toml_value(value: Any) -> str:
    """Return a value as TOML: a number, a text, a truth value, a list, or a table in braces."""
    if isinstance(value, dict):
        return (
            "{"
            + ", ".join(f"{key} = {_format_toml_value(item)}" for key, item in value.items())
            + "}"
        )
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_format_toml_value, value)) + "]"
    return f"{value:.12g}" if isinstance(value, float) else json.dumps(value)
