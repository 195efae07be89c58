"""Design of a study: variable values, the resulting robot and stand, and measured columns.

Diagnostics of failed designs are stored as plain data. Therefore the messages can be rendered later
in any language.
"""

from __future__ import annotations

import difflib
import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import orjson

from pupper_analysis.base.arguments import check_type
from pupper_analysis.base.diagnostics import (
    Diagnostic,
    Phrase,
    Quantity,
    Severity,
    Source,
    Subject,
    Term,
    Value,
    Vector,
    diagnose,
    entry,
)
from pupper_analysis.base.errors import (
    ConfigurationError,
    ModelError,
    NoEquilibriumError,
    NoStiffnessError,
    NotSettlingError,
    NotStandingError,
    PupperAnalysisError,
    StanceUnreachableError,
    StaticsInfeasibleError,
    VariantError,
)
from pupper_analysis.base.frozen import FrozenDict
from pupper_analysis.cli.next_step import complete_command
from pupper_analysis.models.description import Description
from pupper_analysis.models.mjcf import spec_to_data
from pupper_analysis.models.motors.motor import Motor
from pupper_analysis.models.xml import parse_text, to_text
from pupper_analysis.prepare.convert.files import FileSource, RobotFiles
from pupper_analysis.present.document import NextStep
from pupper_analysis.pupper.variant_files import describe_variant, parse_robot_word
from pupper_analysis.pupper.variants import (
    BASE_MODELS,
    ScalableVariant,
    VariantSpec,
    get_variant_spec,
)
from pupper_analysis.robot.build import build_robot, rebuild_robot
from pupper_analysis.robot.robot import Robot, rename_robot
from pupper_analysis.robot.tool import with_payload
from pupper_analysis.stance.fields import FIELDS, ROBOT_FIELDS
from pupper_analysis.stance.stand import solve_stand
from pupper_analysis.stance.task import StandTask
from pupper_analysis.tools.study.measures import METRICS, Design, Metric
from pupper_analysis.tools.study.motors import (
    MOTOR_KIND,
    assign_motors,
    is_motor_variable,
    with_motors,
)
from pupper_analysis.tools.study.parameters import (
    ADDITIVE_KINDS,
    JOINT_STANCE_KINDS,
    LINK_STANCE_KINDS,
    SERVO_KINDS,
    VariablePattern,
    scale_robot,
    with_gains,
    with_ground_friction,
    without_visuals,
)


def to_record(message: Diagnostic) -> dict[str, Any]:
    """Convert a diagnostic (message) to JSON data; `from_record` is the inverse."""
    subject, sources = message.subject, message.sources
    return {
        "code": message.code,
        "severity": message.severity.value,
        "subject": None if subject is None else [subject.kind, subject.name],
        "values": {name: _encode_value(value) for name, value in message.values.items()},
        "sources": [
            [source.file, source.line, source.element, source.attribute] for source in sources
        ],
    }


def from_record(record: dict[str, Any]) -> Diagnostic:
    """Convert the JSON data of `to_record` back to a diagnostic.

    Raises:
        KeyError: If the catalogue no longer contains the code of the diagnostic.
    """
    entry(record["code"])
    return Diagnostic(
        record["code"],
        Severity(record["severity"]),
        None if record["subject"] is None else Subject(*record["subject"]),
        FrozenDict({name: _decode_value(value) for name, value in record["values"].items()}),
        tuple(Source(*source) for source in record["sources"]),
    )


def _encode_value(value: Value) -> Any:
    """Encode a value of a diagnostic as JSON data."""
    if isinstance(value, tuple):
        return [_encode_value(item) for item in value]
    if isinstance(value, Diagnostic):
        return {"diagnostic": to_record(value)}
    if isinstance(value, Quantity):
        return {"quantity": [value.value, value.unit]}
    if isinstance(value, Vector):
        return {"vector": [list(value.values), value.unit]}
    if isinstance(value, Phrase):
        return {"phrase": [str(value), value.chinese]}
    return {"term": str(value)} if isinstance(value, Term) else value


def _decode_value(encoded: Any) -> Value:
    """Convert JSON data of `_encode_value` back to the value of a diagnostic."""
    if isinstance(encoded, list):
        return tuple(map(_decode_value, encoded))
    if not isinstance(encoded, dict):
        return encoded  # type: ignore[no-any-return]  # a number, a text, true or false, None
    ((kind, value),) = encoded.items()
    if kind == "diagnostic":
        return from_record(value)
    if kind == "quantity":
        return Quantity(*value)
    if kind == "phrase":
        return Phrase(*value)
    return Vector(tuple(value[0]), value[1]) if kind == "vector" else Term(value)


# Sources of the robots of a study.


_FILE_OPTIONS = (
    "take",
    "body",
    "feet",
    "name",
    "joints",
    "keyframe",
    "packages",
    "xacro",
    "xacro_args",
)
"""Options that a study may specify in addition to the files: arguments of `load_robot`."""


def load_file_source(arguments: Mapping[str, Any]) -> FileSource:
    """Load the robot of a study from files, without unneeded visual geoms (`without_visuals`).

    Args:
        arguments: The files, as ``models`` (a sequence of paths) or as ``urdf``, ``mjcf`` or both;
            and other arguments of `load_robot`.

    Raises:
        ConfigurationError: If no file is given, or the robot has no feet to stand on, for example.
        ModelError: If no robot can be made of the files.
    """
    options = dict(arguments)
    models = options.pop("models", ())
    unknown = [name for name in options if name not in (*_FILE_OPTIONS, "urdf", "mjcf")]
    if unknown or not (models or "urdf" in options or "mjcf" in options):
        problem = diagnose("no-files-of-a-robot", given=repr(dict(arguments)), known=_FILE_OPTIONS)
        raise ConfigurationError("robot", problem)
    check_type("models", models, Sequence[str])
    for name in ("urdf", "mjcf"):
        check_type(name, options.get(name), str | Path | None)
    packages = options.get("packages")
    check_type("packages", packages, Mapping[str, str | Path] | None)
    for name, folder in (packages or {}).items():
        check_type(f"packages[{name!r}]", folder, str | Path)
    files = RobotFiles.from_arguments(*models, **options)
    robot = files.load()
    if "name" not in options:
        robot = rename_robot(robot, str(files))
    try:
        robot.check_floating("study-of-fixed-base")
    except ConfigurationError as error:
        if not set(options) - {"urdf", "mjcf"}:
            paths = *files.models, *map(str, options.values())
            error.add_note(complete_command(NextStep("hold", paths, robot_typed=False)))
        raise
    if not robot.contact_points:
        raise ConfigurationError("robot", diagnose("no-feet-to-stand-on", robot=robot.name))
    bare = rebuild_robot(robot, mjcf=without_visuals(robot.description).mjcf)
    return FileSource(files, bare)


@dataclass(frozen=True)
class Variants(ScalableVariant):
    """Source of a study's robots: a variant, scaled by the values of the variables.

    Attributes:
        whole: True to keep visual geoms and meshes in the MJCF.
    """

    whole: bool = False

    def robot(self, scales: Mapping[str, float]) -> Robot:
        """Build the robot of the variant with scale factors, {name: factor}, such as ``leg_scale``.

        Raises:
            VariantError: If a scale is not a finite positive number, or the scaled variant is not
                valid.
            ModelError: If a base file is missing or damaged, for example.
        """
        spec = self.with_scales(scales)
        described = describe_variant(spec)
        depth = BASE_MODELS[spec.base].foot_depth(spec.leg_scale)
        return build_robot(
            described if self.whole else without_visuals(described), foot_depth=depth
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the base and the scale factors of the variant as plain data, {name: value}."""
        return {"base": self.spec.base, **self.scales}


RobotSource = FileSource | Variants
"""Object that builds the robots of a study from scale factors. Instances can be pickled, so that
worker processes can build robots.
"""


def make_robot_source(robot: Any) -> RobotSource:
    """Create the source of a study's robots from the argument ``robot`` of `Study`.

    Args:
        robot: A text, a `VariantSpec` or a mapping. A text is the name of a variant, or contains
            names of robot files joined by ``+``. A mapping contains such a text as ``base``, with
            scale factors or file options, or contains files and options (`load_file_source`).

    Raises:
        ConfigurationError: If the argument has none of the supported forms, for example.
        ModelError: If the files of the robot cannot be used.
    """
    if isinstance(robot, str):
        parsed = parse_robot_word(robot)
        if isinstance(parsed, tuple):
            return load_file_source({"models": parsed})
        return Variants(get_variant_spec(parsed))
    if isinstance(robot, VariantSpec):
        return Variants(robot)
    if isinstance(robot, Mapping) and "base" in robot:
        base, options = robot["base"], {key: value for key, value in robot.items() if key != "base"}
        parsed = parse_robot_word(base) if isinstance(base, str) else base
        if isinstance(parsed, tuple):
            return load_file_source({"models": parsed, **options})
        field_names = [field.name for field in fields(VariantSpec)]
        unknown = [name for name in robot if name not in field_names]
        if unknown:
            problem = diagnose("variant-has-no-field", known=field_names, unknown=unknown[0])
            raise ConfigurationError("robot", problem)
        return Variants(VariantSpec(**robot))
    if isinstance(robot, Mapping):
        return load_file_source(robot)
    raise ConfigurationError("robot", diagnose("no-source-of-robots", given=repr(robot)))


def hash_description(description: Description) -> str:
    """Compute the SHA-256 hash of a robot description as hexadecimal text.

    The hash depends on the URDF, the MJCF with its mesh files and, for example, the feet, but not
    on the folder of the MJCF.
    """
    parts = {
        "urdf": description.urdf,
        "mjcf": _remove_asset_folders(spec_to_data(description.mjcf)),
        "feet": dict(description.contact_points),
        "soles": dict(description.feet),
        "geoms": dict(description.foot_geoms),
        "nominal": dict(description.nominal),
    }
    return hashlib.sha256(
        orjson.dumps(_to_json_value(parts), option=orjson.OPT_SORT_KEYS)
    ).hexdigest()


def _remove_asset_folders(spec: Mapping[str, Any]) -> dict[str, Any]:
    """Replace absolute paths in the data of a spec by file names and hashes of the contents.

    MuJoCo reads the mesh files of a robot that was converted from a URDF by absolute paths.
    """
    labels = {
        path: f"{Path(path).name} {hashlib.sha256(content).hexdigest()}"
        for path, content in spec["assets"].items()
        if Path(path).is_absolute()
    }
    if not labels:
        return dict(spec)
    root = parse_text(spec["xml"])
    for element in root.iter("*"):
        for attribute, value in element.attrib.items():
            if value in labels:
                element.set(attribute, labels[value])
    assets = {labels.get(path, path): content for path, content in spec["assets"].items()}
    return {**spec, "xml": to_text(root), "assets": assets}


def _to_json_value(value: Any) -> Any:
    """Convert a value to JSON data for a hash, without rounding: ``repr`` of scalars, array bytes.

    Entries named ``folder`` are left out.
    """
    if isinstance(value, Mapping):
        return {str(key): _to_json_value(item) for key, item in value.items() if key != "folder"}
    if isinstance(value, list | tuple):
        return [_to_json_value(item) for item in value]
    if isinstance(value, np.ndarray):
        return [list(value.shape), value.tobytes().hex()]
    return repr(value)


STANCE_VARIABLES = {
    name: (known, axis)
    for known in FIELDS.values()
    if not known.per and not known.choices
    for axis, name in enumerate([f"{known.name}_{x}" for x in known.axes] or [known.name])
    if name not in METRICS
}
"""{variable of a study that changes the stance: (field of the stand task, index into the field's
axes)}. The model does not depend on stance variables. A field whose name is also a metric, such as
``com_margin``, is left out, since both would use the same column of the table.
"""

ROBOT_VARIABLES = {name: field for name, field in ROBOT_FIELDS.items() if not field.axes}
"""{variable: field} of the robot's variables that apply to the whole robot, without a pattern of
joint or body names: payload, friction, and the gains of all servos."""

FIELD_OF_VARIABLE = {name: field for name, (field, _) in STANCE_VARIABLES.items()} | ROBOT_VARIABLES
"""{variable of the stance or of the whole robot: field that defines unit and range}."""

MAX_CACHED_ROBOTS = 8
"""Maximum number of entries in each cache of a builder (robots and stands). Chosen, not tuned."""


@dataclass(eq=False)
class DesignBuilder:
    """Builds designs from variable values, with caches of robots and stands.

    Attributes:
        source: Source of the robots.
        task: Stand task. The value of a stance variable replaces the value in the task.
        point: Position of the payload: (x, y, z) [m] in the base frame, or (frame, x, y, z).
        motors: {code: motor} of the motor variables (`encode_motor`).
        present_motor: Motor whose mass the files include; None without motor variables.
    """

    source: RobotSource
    task: StandTask
    point: tuple[str | float, ...]
    motors: Mapping[float, Motor] = field(default_factory=dict)
    present_motor: Motor | None = None

    def __post_init__(self) -> None:
        cache = lru_cache(MAX_CACHED_ROBOTS)
        self._cached_scaled_robot = cache(lambda scales: self.source.robot(dict(scales)))
        self._cached_robot = cache(lambda numbers: self._build_robot(dict(numbers)))
        self._cached_stand = cache(
            lambda model, stance: solve_stand(
                self._cached_robot(model),
                apply_stance_values(self.task, dict(stance)),
                explain=False,
            )
        )

    def design(self, numbers: Mapping[str, float]) -> Design:
        """Build the robot of a design and solve the stance, for given values of the variables.

        Args:
            numbers: {variable: value in the unit of the variable}.

        Raises:
            PupperAnalysisError: If the robot cannot be built or the stance cannot be solved.
        """
        gains = {name: value for name, value in numbers.items() if is_servo_variable(name)}
        stance = {
            name: value
            for name, value in numbers.items()
            if name in STANCE_VARIABLES or is_stance_pattern(name)
        }
        model = {
            name: value
            for name, value in numbers.items()
            if name not in gains and name not in stance
        }
        for name in ("kp", "kd"):
            if name in gains:
                ROBOT_VARIABLES[name].check_range(name, gains[name])
        key = tuple(sorted(model.items()))
        robot, stand = (
            self._cached_robot(key),
            self._cached_stand(key, tuple(sorted(stance.items()))),
        )
        motors = assign_motors(robot, numbers, self.motors)
        own_servos = not gains and not motors
        if gains:
            robot = with_gains(robot, gains.pop("kp", None), gains.pop("kd", None), gains)
        return Design(robot, stand, own_servos=own_servos, point=self.point, motors=motors)

    def robot_without_payload(self, numbers: Mapping[str, float]) -> Robot:
        """Build the robot of a design with the servo gains of the design, without the payload.

        Args:
            numbers: {variable: value in the unit of the variable}.

        Raises:
            PupperAnalysisError: If the robot cannot be built.
        """
        model = {
            name: value
            for name, value in numbers.items()
            if not (
                is_servo_variable(name)
                or name in STANCE_VARIABLES
                or is_stance_pattern(name)
                or name == "payload"
            )
        }
        robot = self._cached_robot(tuple(sorted(model.items())))
        gains = {name: value for name, value in numbers.items() if is_servo_variable(name)}
        if not gains:
            return robot
        return with_gains(robot, gains.pop("kp", None), gains.pop("kd", None), gains)

    def _build_robot(self, numbers: Mapping[str, float]) -> Robot:
        """Build the robot of a design, from {variable that changes the model: value}."""
        scales = {name: value for name, value in numbers.items() if name in self.source.scales}
        factors = {
            name: value
            for name, value in numbers.items()
            if ":" in name and not is_motor_variable(name)
        }
        robot = scale_robot(self._cached_scaled_robot(tuple(sorted(scales.items()))), factors)
        if self.present_motor is not None:
            assigned = assign_motors(robot, numbers, self.motors)
            robot = with_motors(robot, assigned, self.present_motor)
        if "friction" in numbers:
            robot = with_ground_friction(robot, numbers["friction"])
        if "payload" in numbers:
            robot = with_payload(robot, numbers["payload"], self.point)
            # The stand is solved for this robot: its CoM includes the payload.
        return robot


def is_servo_variable(name: str) -> bool:
    """Return True if a variable is a servo gain: ``kp``, ``kd``, or a pattern of either."""
    return name.partition(":")[0] in SERVO_KINDS


def is_stance_pattern(name: str) -> bool:
    """Return True if a study variable is a required value of a joint or link in the stance.

    An example is ``posture:JOINT``, the required position of a joint.
    """
    return name.partition(":")[0] in (*JOINT_STANCE_KINDS, *LINK_STANCE_KINDS)


def apply_stance_values(task: StandTask, numbers: Mapping[str, float]) -> StandTask:
    """Return a copy of a stand task in which the stance variables of a design have their values.

    ``numbers`` is {variable: value in the unit of the field}; other variables are ignored.

    Raises:
        ConfigurationError: If a value is out of range, or contradicts another value of the task.
    """
    changes: dict[str, Any] = {}
    values = task.values()
    for name, (stance_field, axis) in STANCE_VARIABLES.items():
        if name in numbers and stance_field.axes:
            point = list(
                changes.get(stance_field.name, values[stance_field.name])
                or (0.0,) * len(stance_field.axes)
            )
            point[axis] = numbers[name]
            changes[stance_field.name] = tuple(point)
        elif name in numbers:
            changes[stance_field.name] = numbers[name]
    for name in filter(is_stance_pattern, numbers):
        field_name, _, element = name.partition(":")
        values_by_element = changes.get(field_name, values[field_name])
        element_value = (
            values_by_element[element].with_plane_parameter(numbers[name])
            if field_name in LINK_STANCE_KINDS
            else numbers[name]
        )
        changes[field_name] = {**values_by_element, element: element_value}
    return task.with_values(changes)


def check_variable_name(name: str, source: RobotSource) -> None:
    """Check the form of the name of a study variable.

    The pattern of ``KIND:PATTERN`` is not compared with the robot.

    Raises:
        ConfigurationError: If no variable has this name or kind; the message contains similar or
            valid names.
    """
    known_names = (*source.scales, *FIELD_OF_VARIABLE, MOTOR_KIND)
    if VariablePattern.parse(name) is None and name not in known_names:
        finding = diagnose(
            "no-number-to-vary",
            alike=difflib.get_close_matches(name, known_names, cutoff=0.75),
            known=known_names,
        )
        raise ConfigurationError(f"vary[{name!r}]", finding)


def check_variable_range(name: str, low: float, high: float) -> None:
    """Check the smallest and largest value of a variable (``low``, ``high``) against the bounds.

    Infinite bounds of a distribution, for example, are not checked.

    Raises:
        ConfigurationError: If a finite value is out of bounds.
    """
    kind, colon, _ = name.partition(":")
    if (kind in ADDITIVE_KINDS and colon) or is_motor_variable(name):
        return
    known = FIELD_OF_VARIABLE.get(name)
    lower_bound, upper_bound, unit = (
        (0.0, math.inf, "x") if known is None else (known.low, known.high, known.unit)
    )
    is_open = (
        kind in ("mass", "inertia", "length", "kp") or not colon if known is None else known.open
    )
    is_below = low <= lower_bound if is_open else low < lower_bound
    if (math.isfinite(low) and is_below) or (math.isfinite(high) and high > upper_bound):
        finding = diagnose(
            "out-of-range",
            first=low,
            last=high,
            open=is_open,
            low=lower_bound,
            high=upper_bound if math.isfinite(upper_bound) else None,
            unit=unit,
        )
        raise ConfigurationError(f"vary[{name!r}]", finding)


STAND_FAILURES = (
    StanceUnreachableError,
    StaticsInfeasibleError,
    NoEquilibriumError,
    NotStandingError,
    NotSettlingError,
)
"""Errors that mean that the robot of a design cannot stand in the stance. After such an error, a
metric has the value `Metric.fallen`, if defined.
"""


def classify_failure(error: BaseException) -> str:
    """Return the kind of failure of an error: the text in the column ``failure`` of a table.

    For example "unreachable", "not settling" or "invalid"; "error" for all unlisted errors.
    """
    kinds = {
        StanceUnreachableError: "unreachable",
        NoEquilibriumError: "no equilibrium",
        NotStandingError: "does not stay up",
        NoStiffnessError: "no stiffness",
        NotSettlingError: "not settling",
        ConfigurationError: "invalid",
        VariantError: "invalid",
        ModelError: "invalid",
    }
    if isinstance(error, StaticsInfeasibleError):
        return str(error.reason.value)
    return next((label for kind, label in kinds.items() if isinstance(error, kind)), "error")


def measure_design(
    builder: DesignBuilder, numbers: Mapping[str, float], metrics: tuple[Metric, ...]
) -> DesignRow:
    """Build a design, evaluate all metrics, and return the row of the table with the results.

    Errors of the design or of metrics do not leave this function; the row records the first
    failure. ``numbers`` is {variable: value in the unit of the variable}.
    """
    row: DesignRow = dict.fromkeys(FAILURE_COLUMNS)
    try:
        design = builder.design(numbers)
    except Exception as error:
        fallen_values = {
            metric.name: metric.fallen for metric in metrics if metric.fallen is not None
        }
        failed_row = {**row, **make_failure_columns(classify_failure(error), describe_error(error))}
        return {**failed_row, **fallen_values} if isinstance(error, STAND_FAILURES) else failed_row
    for metric in metrics:
        try:
            row.update(_make_columns(metric.name, metric.function(design)))
        except Exception as error:
            if isinstance(error, STAND_FAILURES) and metric.fallen is not None:
                row[metric.name] = metric.fallen
            if row["failure"] is None:
                row |= make_failure_columns(classify_failure(error), describe_error(error))
                row["failed_metric"] = metric.name
    return row


DesignRow = dict[str, Any]
"""Row of the table of a study: {column: value}."""

FAILURE_COLUMNS = ("failure", "failed_metric", "reason", "diagnostic")
"""Columns that describe a failure: kind; the metric that failed (None if the design could not
be built, exceeded the time limit or ended the worker process); the reason in English; the reason as
the record of a diagnostic (JSON)."""


def make_failure_columns(kind: str, reason: Diagnostic) -> DesignRow:
    """Return the table columns that describe why a design failed, except ``failed_metric``."""
    record = orjson.dumps(to_record(reason)).decode()
    return {"failure": kind, "reason": str(reason), "diagnostic": record}


def measure_columns(design: Design, metrics: tuple[Metric, ...]) -> dict[str, float]:
    """Evaluate the metrics of a design, and return {column: value in the unit of the metric}.

    A metric with an error of this package is left out. If the robot cannot stand, the value is
    ``Metric.fallen``, if the metric has this number.
    """
    row: dict[str, float] = {}
    for metric in metrics:
        try:
            row.update(_make_columns(metric.name, metric.function(design)))
        except PupperAnalysisError as error:
            if isinstance(error, STAND_FAILURES) and metric.fallen is not None:
                row[metric.name] = metric.fallen
    return row


def _make_columns(name: str, measured: Any) -> DesignRow:
    """Return the table columns with the result of a metric: {``NAME`` or ``NAME.KEY``: number}."""
    if isinstance(measured, Mapping):
        return {f"{name}.{key}": _to_float(name, value) for key, value in measured.items()}
    return {name: _to_float(name, measured)}


def _to_float(name: str, value: Any) -> float:
    """Return the value that the metric ``name`` measured as a float: 1 for True, 0 for False."""
    try:
        return float(value)
    except (TypeError, ValueError) as error:
        finding = diagnose("measured-no-number", found=repr(value))
        raise ConfigurationError(name, finding) from error


def describe_error(error: BaseException) -> Diagnostic:
    """Return the diagnostic of an error; for an error of another package, type and message."""
    if isinstance(error, PupperAnalysisError):
        return error.diagnostic
    return diagnose("other-error", error=type(error).__name__, message=str(error))
