"""What a fit gives: corrected models, offsets of encoders, and all of it as data."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from glob import escape
from pathlib import Path

import numpy as np
import orjson
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.base.csv_text import csv_text
from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.errors import InputError
from pupper_analysis.base.files import Writing, write_all
from pupper_analysis.base.inputs import MAX_TEXT_BYTES, read_input
from pupper_analysis.base.kinds import FIT_FOLDER
from pupper_analysis.base.provenance import to_marked_json
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import list_position_servos
from pupper_analysis.tools.fit.estimate import Posterior
from pupper_analysis.tools.fit.parameters import AXES as COMPONENTS
from pupper_analysis.tools.fit.parameters import KINDS, Parameter, ParameterTable
from pupper_analysis.tools.fit.result import PARAMETER_FIELDS
from pupper_analysis.tools.sync.frames import Key
from pupper_analysis.tools.sync.numbers import (
    BODY_KINDS,
    JOINT_KINDS,
    SERVO_KINDS,
    WrittenNumbers,
    write_numbers,
)

Array = NDArray[np.float64]

_NOTHING = 1e-3
"""Of a standard deviation: an estimate that is so near to what the file says leaves it."""

_DIGITS = 2
"""Written beyond the first of a standard deviation: what is rounded away nobody knows."""

_FACTORS = ("mass", "kp", "friction", "damping", "armature")
"""Kinds of which studies and policies have a factor."""


@dataclass(frozen=True, eq=False)
class FitFiles:
    """What was written of a fit.

    Attributes:
        models: The corrected URDF and MJCF.
        vector: (n,) the parameters as they are written, of as many digits as are known.
        diagnostics: What is in no model.
    """

    models: WrittenNumbers
    vector: Array
    diagnostics: tuple[Diagnostic, ...]


def _rounded(vector: Array, posterior: Posterior) -> Array:
    """Returns parameters of as many digits as are known; what has not moved is as it is stated."""
    return np.array(
        [
            one.stated
            if abs(value - one.stated) <= _NOTHING * std
            else round(value, _DIGITS - math.floor(math.log10(std)))
            for one, value, std in zip(
                posterior.parameters, vector.tolist(), posterior.std.tolist(), strict=True
            )
        ]
    )


def _numbers(
    robot: Robot, posterior: Posterior, vector: Array
) -> tuple[dict[Key, float | Array], list[Diagnostic]]:
    """Returns the numbers of the files that change, and what else was estimated."""
    numbers: dict[Key, float | Array] = {}
    left: list[Diagnostic] = []
    servos, added = (
        list_position_servos(robot),
        {one.joint for one in robot.description.made_servos},
    )
    one_file = robot.description.converted == "mjcf"
    for one, value, std in zip(
        posterior.parameters, vector.tolist(), posterior.std.tolist(), strict=True
    ):
        stated = one.stated
        if one.kind in SERVO_KINDS:
            stated = servos.get(one.subject, (math.nan, math.nan))[SERVO_KINDS.index(one.kind)]
        if abs(value - stated) <= _NOTHING * std:
            continue
        if (one.kind in SERVO_KINDS and (math.isnan(stated) or one.subject in added)) or (
            one_file and one.kind in (*SERVO_KINDS, "armature")
        ):
            why = diagnose("mjcf-alone-states-it" if one_file else "servo-of-no-file")
            left.append(diagnose("not-in-the-files", parameter=one.name, why=why))
        elif one.kind in BODY_KINDS and one.component:
            _put_component(numbers, robot, one, value)
        elif one.kind in (*BODY_KINDS, *JOINT_KINDS, *SERVO_KINDS):
            numbers[one.kind, one.subject] = value
    return numbers, left


def _put_component(
    numbers: dict[Key, float | Array], robot: Robot, one: Parameter, value: float
) -> None:
    """Puts one entry of a com among the numbers; the others are the file's."""
    model = robot.pin_model
    at = model.frames[model.getFrameId(one.subject, pin.FrameType.BODY)].parentJoint
    com = np.array(numbers.get((one.kind, one.subject), model.inertias[at].lever))
    com[COMPONENTS.index(one.component)] = value
    numbers[one.kind, one.subject] = com


def _name(one: Parameter, value: float) -> str:
    """Returns what studies call a factor on a number of the corrected model; "" of none."""
    if one.kind == "com":
        return f"com_{one.component}:{escape(one.subject)}"
    kind = "frictionloss" if one.kind == "friction" else one.kind
    return f"{kind}:{escape(one.subject)}" if one.kind in _FACTORS and value else ""


NUM_SAMPLES = 512
"""Robots that are drawn: their mean is off by a twentieth of a standard deviation."""


def draw_samples(
    posterior: Posterior, vector: Array, count: int = NUM_SAMPLES, seed: int = 0
) -> tuple[tuple[str, ...], Array]:
    """Draws robots that the measurements leave possible, their numbers together.

    Measurements tell sums and ratios: of v3, weighed, the whole mass to 0.2 %, and how it is shared
    among links hardly. Numbers that are drawn each by itself are robots that were excluded. Robots
    with a link of no mass, or a servo of no stiffness, are drawn again. (Drawn by logarithms, none
    would be below zero, but a sum of masses is no sum of logarithms: v3's whole mass was 2.957 ±
    0.094 kg for 2.787 ± 0.006.) Gravity is linear in masses m and first moments m c: these are
    drawn, and a com is off by m0 / m of what it is at the mass m0 that is written. What else means
    nothing below zero is cut off there.

    Args:
        posterior: What is known of the parameters.
        vector: (n,) the parameters as they are written.
        count: How many robots.
        seed: Of the generator.

    Returns:
        (k,) what studies call the numbers, and (count, k) factors on the corrected model's, or what
        is added to them (m).
    """
    rng, parameters = np.random.default_rng(seed), posterior.parameters
    table = ParameterTable(parameters)
    widths = np.array([one.width for one in parameters])
    scaled = np.linalg.cholesky(posterior.covariance / np.outer(widths, widths))
    scales = np.array([KINDS[one.kind].factor for one in parameters], dtype=bool)
    drawn = np.zeros((0, len(vector)))
    for _ in range(_MOST_DRAWS):
        off = rng.standard_normal((count, len(vector))) @ (widths[:, None] * scaled).T
        fits = (vector + off > _LEAST * vector)[:, scales].all(axis=1)
        drawn = np.concatenate([drawn, off[fits]])[:count]
        if len(drawn) == count:
            break
    names, columns = [], []
    for at, one in enumerate(parameters):
        if name := _name(one, float(vector[at])):
            names.append(name)
            column = drawn[:, at]
            if one.kind != "com":
                column = np.maximum(0.0, 1 + column / vector[at])
            elif (mass := table.find_index("mass", one.subject)) is not None:
                column = column / (1 + drawn[:, mass] / vector[mass])
            columns.append(column)
    return tuple(names), np.array(columns).T


_MOST_DRAWS = 100
"""Times as many: where not one in a hundred has all masses above zero, fewer are written."""

_LEAST = 0.1
"""Of a mass or a stiffness: a link that weighs a tenth of it is another link."""


_ABOUT_SAMPLES = """\
# Samples of a fitted robot. One a row: factors on the corrected models' numbers, com_x, com_y, \
com_z: to be added (m).
"""


def _csv(header: Iterable[str], rows: Iterable[Iterable[object]], about: str = "") -> bytes:
    return (about + csv_text([header, *rows])).encode()


def _json(
    posterior: Posterior,
    vector: Array,
    models: WrittenNumbers,
    messages: tuple[Diagnostic, ...],
    fit: object,
) -> bytes:
    rows = [
        {name: getattr(one, name) for name in PARAMETER_FIELDS}
        | {"mean": mean, "std": std, "low": low, "high": high, "written": value}
        for one, mean, std, (low, high), value in zip(
            posterior.parameters,
            posterior.mean.tolist(),
            posterior.std.tolist(),
            posterior.interval.tolist(),
            vector.tolist(),
            strict=True,
        )
    ]
    document = {
        "urdf": None if models.urdf is None else str(models.urdf),
        "mjcf": None if models.mjcf is None else str(models.mjcf),
        "files": models.hash_contents(),
        "parameters": rows,
        "covariance": posterior.covariance,
        "edits": [replace(edit, file=Path(edit.file).name) for edit in models.edits],
        "diagnostics": messages,
        **({} if fit is None else {"fit": fit}),
    }
    return to_marked_json(document).encode()


# Writes what a fit found: models, offsets, and samples for those who train policies.


def write_fit(
    robot: Robot,
    posterior: Posterior,
    folder: str | Path,
    *,
    fit: object = None,
    files: tuple[Path | None, Path | None] | None = None,
    force: bool = False,
) -> FitFiles:
    """Writes a fit to a folder: all of its files, or none.

    The corrected URDF and MJCF, with the meshes and included files that they need, as they stand to
    each other; no byte of the models is another but those of numbers that changed. ``fit.json``
    has all parameters with their covariance, ``offsets.csv`` what encoders show beyond the angle
    (take it from a position, add it to a command), ``samples.csv`` robots that the measurements
    leave possible, by the names that studies have.

    Args:
        robot: The robot, as its files have it.
        posterior: What is known of its parameters.
        folder: Where to; made if need be.
        fit: The result that is written to ``fit.json``, too.
        files: The URDF and the MJCF, if they are not those that the robot was loaded from.
        force: Replace files that no fit has written, or that were edited since; but never those
            that the robot was loaded from.

    Returns:
        What was written.

    Raises:
        ModelError: If not all numbers can be written.
        OutputError: If a file cannot be or must not be replaced, or is one that the robot was
            loaded from.
    """
    folder, parameters = Path(folder), posterior.parameters
    least = [_LEAST * one.stated if KINDS[one.kind].factor else -np.inf for one in parameters]
    vector = _rounded(np.maximum(posterior.mean, least), posterior)
    numbers, left = _numbers(robot, posterior, vector)
    models = write_numbers(robot, numbers, files=files)
    finding = tuple(left)
    contents = {"fit.json": _json(posterior, vector, models, finding, fit)}
    offsets = [
        (one.subject, f"{value:.9g}", f"{math.degrees(value):.7g}")
        for one, value in zip(parameters, vector.tolist(), strict=True)
        if one.kind == "offset"
    ]
    if offsets:
        contents["offsets.csv"] = _csv(("joint", "offset_rad", "offset_deg"), offsets)
    names, samples = draw_samples(posterior, vector)
    if names:
        rows = [[f"{value:.12g}" for value in row] for row in samples.tolist()]
        contents["samples.csv"] = _csv(names, rows, _ABOUT_SAMPLES)
    writings = models.make_writings(folder, _made_before(folder), force=force)
    writings += [
        Writing(folder / name, content, FIT_FOLDER.files[name], force=force)
        for name, content in contents.items()
    ]
    write_all(writings)
    return FitFiles(models, vector, finding)


def _made_before(folder: Path) -> dict[str, str]:
    """Returns {place: hash} of the models that a fit has written to that folder."""
    try:
        found = orjson.loads(read_input(folder / "fit.json", MAX_TEXT_BYTES, own=True))
        return {str(place): str(known) for place, known in found["files"].items()}
    except (InputError, ValueError, TypeError, KeyError, AttributeError):
        return {}
