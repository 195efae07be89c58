"""Stance files: the requirements of a stand task as TOML text, whose keys are command-line options.

``--stance FILE`` of commands reads such files, and results as JSON that contain a stand
(`cli.stance_fields.read_stance_file`).
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import orjson

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.robot.plane import Contact, Weld
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.fields import FIELDS
from pupper_analysis.stance.problem import nominal_foot_positions
from pupper_analysis.stance.start_file import walk_tables
from pupper_analysis.stance.task import StandTask


def format_stance(task: StandTask) -> str:
    """Format a stand task as TOML text, the content of a file for ``--stance``.

    The text does not contain the initial guess ``ik_seed``.

    Raises:
        ConfigurationError: If a requirement has no option (`express_by_options`).
    """
    _check_options(task, "stand")
    lines, tables = [], []
    for name, value in task.values().items():
        field = FIELDS[name]
        if not field.help or value == field.default_value:
            continue
        if field.per:
            tables += [
                f"{field.option}.{json.dumps(element)} = {_format_stance_value(item)}"
                for element, item in value.items()
            ]
        else:
            lines.append(f"{field.option} = {_format_stance_value(value, field.unit)}")
    return "".join(f"{line}\n" for line in (*lines, *tables))


def express_by_options(robot: Robot, task: StandTask) -> StandTask:
    """Return the stand task that a stance file for a robot can contain: only fields with an option.

    Positions of feet become offsets from the nominal positions, equal to rounding. The initial
    guess ``ik_seed`` is removed.
    """
    nominal = nominal_foot_positions(robot)
    offsets = {
        foot: tuple((np.array(place) - nominal[foot]).tolist()) for foot, place in task.feet.items()
    }
    return replace(task, feet={}, foot_offsets={**task.foot_offsets, **offsets}, ik_seed=None)


def _check_options(task: StandTask, where: str) -> None:
    """Raise an error for ``where`` if a requirement of a stand task has no option."""
    for name, value in task.values().items():
        if not FIELDS[name].help and value != FIELDS[name].default_value:
            raise ConfigurationError(where, diagnose("stance-without-option", field=name))


def _format_stance_value(value: Any, unit: str = "") -> str:
    """Format a value of the stance as TOML; a single length or angle has a unit, such as "0.1m"."""
    if isinstance(value, tuple):
        return f"[{', '.join(map(_format_stance_value, value))}]"
    if isinstance(value, str | Contact | Weld):
        return json.dumps(str(value))
    return json.dumps(f"{value!r}{unit}" if unit in ("m", "rad") else value)


def read_task_of_results(file: str, text: str) -> StandTask:
    """Read the task of the first ``stand`` in results, such as those of ``best --json``.

    Args:
        file: Path of the file, for errors.
        text: Content of the file (JSON).

    Raises:
        ConfigurationError: If the results contain no stand, or the task has a value that no option
            specifies, for example.
    """
    try:
        results = orjson.loads(text)
    except orjson.JSONDecodeError as error:
        problem = diagnose("results-without-stance", problem=str(error))
        raise ConfigurationError(file, problem) from error
    stands = [table.get("stand") for table in walk_tables(results)]
    tasks = [stand.get("task") for stand in stands if isinstance(stand, Mapping)]
    given = next((task for task in tasks if isinstance(task, Mapping)), None)
    if given is None:
        raise ConfigurationError(file, diagnose("results-without-stance", problem=""))
    try:
        task = StandTask.from_dict({**given, "ik_seed": None})
    except ConfigurationError as error:
        raise ConfigurationError(file, error.diagnostic) from None
    _check_options(task, file)
    return task
