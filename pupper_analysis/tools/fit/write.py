"""Write a fit to a folder: corrected models, encoder offsets, samples of the posterior and JSON.

Parameter values are rounded according to their standard deviations. A parameter that hardly changed
keeps the value of the file. The models are copies of the original files: only changed values and
the inertias of changed masses differ. Random samples of all parameters are drawn jointly from the
posterior, for the command `study`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from glob import escape
from pathlib import Path

import numpy as np
import orjson
import pinocchio as pin

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.csv_text import csv_text
from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.errors import InputError
from pupper_analysis.base.files import Writing, write_all
from pupper_analysis.base.inputs import MAX_TEXT_BYTES, read_input
from pupper_analysis.base.kinds import FIT_FOLDER
from pupper_analysis.base.provenance import to_marked_json
from pupper_analysis.robot.compare.differences import PropertyKey
from pupper_analysis.robot.matching.sources import BODY_KINDS
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import list_position_servos
from pupper_analysis.tools.fit.estimate import Posterior
from pupper_analysis.tools.fit.parameters import AXES as COMPONENTS
from pupper_analysis.tools.fit.parameters import PARAMETER_KINDS, Parameter, ParameterTable
from pupper_analysis.tools.fit.result import PARAMETER_FIELDS
from pupper_analysis.tools.sync.numbers import (
    JOINT_PARAMETER_KINDS,
    SERVO_KINDS,
    WrittenNumbers,
    write_numbers,
)

_UNCHANGED_STDS = 1e-3
"""Largest difference (in standard deviations) between an estimate and the stated value for which
the stated value is written instead of the estimate. Chosen, not tuned.
"""

_EXTRA_DIGITS = 2
"""Decimal digits written beyond the first digit of a standard deviation. Chosen, not tuned:
rounding changes a value by at most 0.5 % of the standard deviation."""

_FACTOR_KINDS = ("mass", "kp", "friction", "damping", "armature")
"""Kinds of fitted parameters that are written for `study` as factors on the model's value. CoM
positions are written as displacements. Parameters of other kinds are not written for `study`.
"""


@dataclass(frozen=True, eq=False)
class FitFiles:
    """Values of a fit as they were written to the robot's files.

    Attributes:
        models: Corrected URDF and MJCF.
        vector: Rounded parameter values, shape (n,), each in the unit of the parameter. Masses and
            kp are at least 10 % of the stated value before rounding.
        diagnostics: Notes on changed servo gains and armatures that the files cannot state.
    """

    models: WrittenNumbers
    vector: Array
    diagnostics: tuple[Diagnostic, ...]


def _round_parameters(vector: Array, posterior: Posterior) -> Array:
    """Return the parameters ``vector``, shape (n,), rounded according to their standard deviations.

    A parameter very near the stated value gets that value (`_UNCHANGED_STDS`).
    """
    return np.array(
        [
            parameter.stated
            if abs(value - parameter.stated) <= _UNCHANGED_STDS * std
            else round(value, _EXTRA_DIGITS - math.floor(math.log10(std)))
            for parameter, value, std in zip(
                posterior.parameters, vector.tolist(), posterior.std.tolist(), strict=True
            )
        ]
    )


def _collect_numbers(
    robot: Robot, posterior: Posterior, vector: Array
) -> tuple[dict[PropertyKey, float | Array], list[Diagnostic]]:
    """Collect the changed values to write to the model files, and notes on omitted values.

    ``vector`` contains the fitted values, shape (n,). The result has the keys (kind, link or
    joint).
    """
    numbers: dict[PropertyKey, float | Array] = {}
    notes: list[Diagnostic] = []
    servos, added_servos = (
        list_position_servos(robot),
        {parameter.joint for parameter in robot.description.made_servos},
    )
    one_file = robot.description.converted == "mjcf"
    for parameter, value, std in zip(
        posterior.parameters, vector.tolist(), posterior.std.tolist(), strict=True
    ):
        stated = parameter.stated
        if parameter.kind in SERVO_KINDS:
            stated = servos.get(parameter.subject, (math.nan, math.nan))[
                SERVO_KINDS.index(parameter.kind)
            ]
        if abs(value - stated) <= _UNCHANGED_STDS * std:
            continue
        if (
            parameter.kind in SERVO_KINDS
            and (math.isnan(stated) or parameter.subject in added_servos)
        ) or (one_file and parameter.kind in (*SERVO_KINDS, "armature")):
            why = diagnose("mjcf-alone-states-it" if one_file else "servo-of-no-file")
            notes.append(diagnose("not-in-the-files", parameter=parameter.name, why=why))
        elif parameter.kind in BODY_KINDS and parameter.component:
            _set_com_component(numbers, robot, parameter, value)
        elif parameter.kind in (*BODY_KINDS, *JOINT_PARAMETER_KINDS, *SERVO_KINDS):
            numbers[parameter.kind, parameter.subject] = value
    return numbers, notes


def _set_com_component(
    numbers: dict[PropertyKey, float | Array], robot: Robot, parameter: Parameter, value: float
) -> None:
    """Set a component of a link's CoM [m] in ``numbers``, the fitted values to write to the files.

    The CoM is that of all links that are fixed together, in the frame of their Pinocchio joint.
    """
    model = robot.pin_model
    joint = model.frames[model.getFrameId(parameter.subject, pin.FrameType.BODY)].parentJoint
    com = np.array(numbers.get((parameter.kind, parameter.subject), model.inertias[joint].lever))
    com[COMPONENTS.index(parameter.component)] = value
    numbers[parameter.kind, parameter.subject] = com


def _format_factor_name(parameter: Parameter, value: float) -> str:
    """Return the name of a fitted parameter's variable in `study`; empty if it is not written."""
    if parameter.kind == "com":
        return f"com_{parameter.component}:{escape(parameter.subject)}"
    kind = "frictionloss" if parameter.kind == "friction" else parameter.kind
    return (
        f"{kind}:{escape(parameter.subject)}" if parameter.kind in _FACTOR_KINDS and value else ""
    )


NUM_SAMPLES = 512
"""Default number of robots in ``samples.csv``. The parameters of each robot are drawn at random
from the posterior distribution. The standard error of their mean is 1/sqrt(512), 4 % of a standard
deviation.
"""


def draw_samples(
    posterior: Posterior, vector: Array, count: int = NUM_SAMPLES, seed: int = 0
) -> tuple[tuple[str, ...], Array]:
    """Draw random robots from the posterior distribution of a fit, as samples for `study`.

    All parameters of a robot are drawn jointly. Independent draws would give robots that the
    measurements exclude: measurements determine, for example, the total mass, but hardly the
    distribution of the mass over the links. Robots with a very small mass or kp are rejected.
    Masses are normally distributed: log-normal masses would bias the total mass. A CoM deviation is
    divided by the drawn factor on the body's mass, because gravity depends on mass times CoM
    position.

    Args:
        posterior: Distribution of the parameters.
        vector: Parameter values as written to the corrected model files, shape (n,).
        count: Number of robots. Fewer are returned if too many draws are rejected.
        seed: Seed of the generator.

    Returns:
        Names of k variables of `study`, and the values, shape (number of robots, k). A value is a
        factor on the value of the corrected model, or a displacement of a CoM [m].
    """
    rng, parameters = np.random.default_rng(seed), posterior.parameters
    table = ParameterTable(parameters)
    widths = np.array([parameter.width for parameter in parameters])
    scaled = np.linalg.cholesky(posterior.covariance / np.outer(widths, widths))
    scales = np.array(
        [PARAMETER_KINDS[parameter.kind].factor for parameter in parameters], dtype=bool
    )
    deviations = np.zeros((0, len(vector)))
    for _ in range(_MAX_DRAW_ROUNDS):
        deviation = rng.standard_normal((count, len(vector))) @ (widths[:, None] * scaled).T
        accepted = (vector + deviation > _MIN_FACTOR * vector)[:, scales].all(axis=1)
        deviations = np.concatenate([deviations, deviation[accepted]])[:count]
        if len(deviations) == count:
            break
    names, columns = [], []
    for index, parameter in enumerate(parameters):
        if name := _format_factor_name(parameter, float(vector[index])):
            names.append(name)
            column = deviations[:, index]
            if parameter.kind != "com":
                column = np.maximum(0.0, 1 + column / vector[index])
            elif (mass := table.find_index("mass", parameter.subject)) is not None:
                column = column / (1 + deviations[:, mass] / vector[mass])
            columns.append(column)
    return tuple(names), np.array(columns).T


_MAX_DRAW_ROUNDS = 100
"""Upper bound of the rounds in which random robots are drawn until the requested number is
accepted. Chosen, not tuned.
"""

_MIN_FACTOR = 0.1
"""Lower bound of masses and kp that are written or sampled, as a fraction of the stated value or of
the written value. Chosen, not tuned.
"""


_SAMPLES_HEADER = """\
# Samples of a fitted robot. One a row: factors on the corrected models' numbers, com_x, com_y, \
com_z: to be added (m).
"""
"""Comment line before the header of the CSV file with samples of fitted robots."""


def _format_csv(header: Iterable[str], rows: Iterable[Iterable[object]], about: str = "") -> bytes:
    """Return the content of a CSV file, with the comment lines ``about`` before the header."""
    return (about + csv_text([header, *rows])).encode()


def _format_json(
    posterior: Posterior,
    vector: Array,
    models: WrittenNumbers,
    messages: tuple[Diagnostic, ...],
    fit: object,
) -> bytes:
    """Return the content of ``fit.json``: files, parameters, covariance, edits, notes and fit.

    ``vector`` contains the rounded parameter values, shape (n,).
    """
    rows = [
        {name: getattr(parameter, name) for name in PARAMETER_FIELDS}
        | {"mean": mean, "std": std, "low": low, "high": high, "written": value}
        for parameter, mean, std, (low, high), value in zip(
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


def write_fit(
    robot: Robot,
    posterior: Posterior,
    folder: str | Path,
    *,
    fit: object = None,
    files: tuple[Path | None, Path | None] | None = None,
    force: bool = False,
) -> FitFiles:
    """Write a fit to a folder, so that other commands can use the corrected robot.

    The files are:

    - Corrected URDF and MJCF, with the meshes and included files that they need, in the same
      relative folders.
    - ``fit.json``: all parameters with the covariance.
    - ``offsets.csv``, if encoder offsets are parameters: measured position minus true position.
    - ``samples.csv``, if `study` can vary a parameter: samples of the posterior, with the variable
      names of `study`.

    Args:
        robot: Robot, with the values of the files.
        posterior: Distribution of the parameters.
        folder: Output folder, created if necessary.
        fit: Result that is included in ``fit.json``.
        files: URDF and MJCF, if the robot was not loaded from files.
        force: Whether to replace existing files that no fit has written, and models that were
            edited after an earlier fit. Files from which the robot was loaded are never replaced.

    Returns:
        Corrected models, rounded parameter values, and notes on servo gains and armatures that the
        files cannot state.

    Raises:
        ModelError: If a value cannot be written to the files, or a file cannot be read.
        OutputError: If a file cannot be written, must not be replaced, or is a file from which the
            robot was loaded.
    """
    folder, parameters = Path(folder), posterior.parameters
    lower_bounds = [
        _MIN_FACTOR * parameter.stated if PARAMETER_KINDS[parameter.kind].factor else -np.inf
        for parameter in parameters
    ]
    vector = _round_parameters(np.maximum(posterior.mean, lower_bounds), posterior)
    numbers, notes = _collect_numbers(robot, posterior, vector)
    models = write_numbers(robot, numbers, files=files)
    diagnostics = tuple(notes)
    contents = {"fit.json": _format_json(posterior, vector, models, diagnostics, fit)}
    offsets = [
        (parameter.subject, f"{value:.9g}", f"{math.degrees(value):.7g}")
        for parameter, value in zip(parameters, vector.tolist(), strict=True)
        if parameter.kind == "offset"
    ]
    if offsets:
        contents["offsets.csv"] = _format_csv(("joint", "offset_rad", "offset_deg"), offsets)
    names, samples = draw_samples(posterior, vector)
    if names:
        rows = [[f"{value:.12g}" for value in row] for row in samples.tolist()]
        contents["samples.csv"] = _format_csv(names, rows, _SAMPLES_HEADER)
    writings = models.make_writings(folder, _read_own_hashes(folder), force=force)
    writings += [
        Writing(folder / name, content, FIT_FOLDER.files[name], force=force)
        for name, content in contents.items()
    ]
    write_all(writings)
    return FitFiles(models, vector, diagnostics)


def _read_own_hashes(folder: Path) -> dict[str, str]:
    """Read the hashes of the models that an earlier fit wrote to a folder: {relative path: hash}.

    The result is empty if they cannot be read.
    """
    try:
        document = orjson.loads(read_input(folder / "fit.json", MAX_TEXT_BYTES, rewritten=True))
        return {str(place): str(digest) for place, digest in document["files"].items()}
    except (InputError, ValueError, TypeError, KeyError, AttributeError):
        return {}
