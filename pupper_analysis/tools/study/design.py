"""One design: its numbers, the robot and stand that they make, and what is measured of it.

Its diagnostics are kept as plain data: what is reported today can be said tomorrow, in any
language.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, fields
from functools import lru_cache
from typing import Any

import numpy as np
import orjson

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
from pupper_analysis.models.description import Description
from pupper_analysis.models.mjcf import spec_to_data
from pupper_analysis.prepare.convert.files import FileSource, RobotFiles
from pupper_analysis.pupper.variant_files import describe_variant, split_word
from pupper_analysis.pupper.variants import BASES, Scaled, VariantSpec, variant_spec
from pupper_analysis.robot.build import build_robot, rebuild_robot
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.tool import with_payload
from pupper_analysis.stance.fields import FIELDS, ROBOT_FIELDS
from pupper_analysis.stance.stand import solve_stand
from pupper_analysis.stance.task import StandTask
from pupper_analysis.tools.study.measures import METRICS, Design, Metric
from pupper_analysis.tools.study.parameters import (
    ADDITIVE_KINDS,
    JOINT_STANCE_KINDS,
    LINK_STANCE_KINDS,
    SERVO_KINDS,
    VariablePattern,
    scale_robot,
    with_friction,
    with_gains,
    without_visuals,
)


def to_record(message: Diagnostic) -> dict[str, Any]:
    """Returns a diagnostic as JSON can hold it, from which ``from_record`` makes it again."""
    subject, sources = message.subject, message.sources
    return {
        "code": message.code,
        "severity": message.severity.value,
        "subject": None if subject is None else [subject.kind, subject.name],
        "values": {name: _recorded(value) for name, value in message.values.items()},
        "sources": [[one.file, one.line, one.element, one.attribute] for one in sources],
    }


def from_record(kept: dict[str, Any]) -> Diagnostic:
    """Returns the diagnostic of a record.

    Raises:
        KeyError: If the catalogue has its code no more.
    """
    entry(kept["code"])
    return Diagnostic(
        kept["code"],
        Severity(kept["severity"]),
        None if kept["subject"] is None else Subject(*kept["subject"]),
        FrozenDict({name: _restored(value) for name, value in kept["values"].items()}),
        tuple(Source(*one) for one in kept["sources"]),
    )


def _recorded(value: Value) -> Any:
    """Returns a value; what is no plain one is a dict with its kind as the key."""
    if isinstance(value, tuple):
        return [_recorded(one) for one in value]
    if isinstance(value, Diagnostic):
        return {"diagnostic": to_record(value)}
    if isinstance(value, Quantity):
        return {"quantity": [value.value, value.unit]}
    if isinstance(value, Vector):
        return {"vector": [list(value.values), value.unit]}
    if isinstance(value, Phrase):
        return {"phrase": [str(value), value.chinese]}
    return {"term": str(value)} if isinstance(value, Term) else value


def _restored(kept: Any) -> Value:
    if isinstance(kept, list):
        return tuple(map(_restored, kept))
    if not isinstance(kept, dict):
        return kept  # type: ignore[no-any-return]  # a number, a text, true or false, None
    ((kind, value),) = kept.items()
    if kind == "diagnostic":
        return from_record(value)
    if kind == "quantity":
        return Quantity(*value)
    if kind == "phrase":
        return Phrase(*value)
    return Vector(tuple(value[0]), value[1]) if kind == "vector" else Term(value)


# Where the robots of a study come from.


_KNOWN = ("take", "body", "feet", "name", "joints", "keyframe", "packages")
"""What a study may say of files, besides the files."""


def load_file_source(given: Mapping[str, Any]) -> FileSource:
    """Loads the robot of a study, without what is only looked at.

    Args:
        given: {``urdf``, ``mjcf`` or both, or ``models``: its files; and other arguments of
            ``load_robot``}.

    Raises:
        ConfigurationError: If an option is not ``load_robot``'s, or the robot cannot stand.
        ModelError: As ``load_robot``.
    """
    options = dict(given)
    models = options.pop("models", ())
    unknown = [name for name in options if name not in (*_KNOWN, "urdf", "mjcf")]
    if unknown or not (models or "urdf" in options or "mjcf" in options):
        problem = diagnose("no-files-of-a-robot", given=repr(dict(given)), known=_KNOWN)
        raise ConfigurationError("robot", problem)
    files = RobotFiles.of(*models, **options)
    robot = files.load()
    if not robot.floating or not robot.contact_points:
        raise ConfigurationError("robot", diagnose("no-feet-to-stand-on", robot=robot.name))
    bare = rebuild_robot(robot, mjcf=without_visuals(robot.description).mjcf)
    return FileSource(files, bare)


@dataclass(frozen=True)
class Variants(Scaled):
    """The robots that scales make of a variant.

    Attributes:
        whole: Whether with all that is only looked at.
    """

    whole: bool = False

    def robot(self, scales: Mapping[str, float]) -> Robot:
        """Makes the variant of some scales.

        Raises:
            VariantError: If a scale is not a finite positive number, or nothing can be made so.
        """
        spec = self.scaled(scales)
        described = describe_variant(spec)
        depth = BASES[spec.base].foot_depth(spec.leg_scale)
        return build_robot(
            described if self.whole else without_visuals(described), foot_depth=depth
        )

    def asked(self) -> dict[str, Any]:
        """Returns the spec."""
        return {"base": self.spec.base, **self.scales}


RobotSource = FileSource | Variants
"""Makes robots, here and in other processes: it can be pickled."""


def make_robot_source(robot: Any) -> RobotSource:
    """Returns the source of a robot that is given in one of the ways of ``Study``.

    Raises:
        ConfigurationError: If it is given in another.
        VariantError: If there is no such variant.
    """
    if isinstance(robot, str):
        meant = split_word(robot)
        if isinstance(meant, tuple):
            return load_file_source({"models": meant})
        return Variants(variant_spec(meant))
    if isinstance(robot, VariantSpec):
        return Variants(robot)
    if isinstance(robot, Mapping) and "base" in robot:
        base, others = robot["base"], {n: one for n, one in robot.items() if n != "base"}
        meant = split_word(base) if isinstance(base, str) else base
        if isinstance(meant, tuple):
            return load_file_source({"models": meant, **others})
        known = [field.name for field in fields(VariantSpec)]
        unknown = [name for name in robot if name not in known]
        if unknown:
            problem = diagnose("variant-has-no-field", known=known, unknown=unknown[0])
            raise ConfigurationError("robot", problem)
        return Variants(VariantSpec(**robot))
    if isinstance(robot, Mapping):
        return load_file_source(robot)
    raise ConfigurationError("robot", diagnose("no-source-of-robots", given=repr(robot)))


def hash_description(description: Description) -> str:
    """Returns a hash of all that a description says: the same files have the same hash."""
    parts = {
        "urdf": description.urdf,
        "mjcf": spec_to_data(description.mjcf),
        "feet": dict(description.contact_points),
        "soles": dict(description.feet),
        "geoms": dict(description.foot_geoms),
        "nominal": dict(description.nominal),
    }
    return hashlib.sha256(orjson.dumps(_plain(parts), option=orjson.OPT_SORT_KEYS)).hexdigest()


def _plain(value: Any) -> Any:
    """Returns a value as JSON can hold it, each number whole; folders are left out."""
    if isinstance(value, Mapping):
        return {str(key): _plain(one) for key, one in value.items() if key != "folder"}
    if isinstance(value, list | tuple):
        return [_plain(one) for one in value]
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
"""{number of the stance: its field, and which number of a point}; they change no model.

A metric of the same name, such as ``com_margin``, would be in the same column of the table.
"""

ROBOT_VARIABLES = {name: field for name, field in ROBOT_FIELDS.items() if not field.axes}
"""Numbers of the robot, for all joints and feet alike."""

FIELD_OF_VARIABLE = {name: field for name, (field, _) in STANCE_VARIABLES.items()} | ROBOT_VARIABLES

MAX_CACHED_ROBOTS = 8
"""So many robots and stands are remembered: neighbours in a product of lists share them."""


@dataclass(eq=False)
class DesignBuilder:
    """Makes designs of numbers.

    Attributes:
        source: Of the robots.
        task: The stance, where a design does not say otherwise.
        point: Where a payload is (m); see ``robot.tool.find_place``.
    """

    source: RobotSource
    task: StandTask
    point: tuple[str | float, ...]

    def __post_init__(self) -> None:
        remember = lru_cache(MAX_CACHED_ROBOTS)
        self._scaled = remember(lambda scales: self.source.robot(dict(scales)))
        self._loaded = remember(lambda numbers: self._robot(dict(numbers)))
        self._stand = remember(
            lambda model, stance: solve_stand(
                self._loaded(model), apply_stance_values(self.task, dict(stance)), explain=False
            )
        )

    def design(self, numbers: Mapping[str, float]) -> Design:
        """Makes a design.

        Raises:
            PupperAnalysisError: If there is none; ``classify_failure`` says of which kind.
        """
        gains = {n: v for n, v in numbers.items() if is_servo_variable(n)}
        stance = {n: v for n, v in numbers.items() if n in STANCE_VARIABLES or is_stance_pattern(n)}
        model = {n: v for n, v in numbers.items() if n not in gains and n not in stance}
        for name in ("kp", "kd"):
            if name in gains:
                ROBOT_VARIABLES[name].check_range(name, gains[name])
        key = tuple(sorted(model.items()))
        robot, stand = self._loaded(key), self._stand(key, tuple(sorted(stance.items())))
        own = not gains
        if gains:
            robot = with_gains(robot, gains.pop("kp", None), gains.pop("kd", None), gains)
        return Design(robot, stand, own_servos=own, point=self.point)

    def _robot(self, numbers: Mapping[str, float]) -> Robot:
        scales = {name: v for name, v in numbers.items() if name in self.source.scales}
        factors = {name: v for name, v in numbers.items() if ":" in name}
        robot = scale_robot(self._scaled(tuple(sorted(scales.items()))), factors)
        if "friction" in numbers:
            robot = with_friction(robot, numbers["friction"])
        if "payload" in numbers:
            robot = with_payload(robot, numbers["payload"], self.point)
            # Its stands are its own here: the com is over the feet with the payload.
        return robot


def is_servo_variable(name: str) -> bool:
    """Whether a number is one of the servos alone."""
    return name.partition(":")[0] in SERVO_KINDS


def is_stance_pattern(name: str) -> bool:
    """Whether a number is one of the stance: ``posture:JOINT``, ``contacts:LINK``."""
    return name.partition(":")[0] in (*JOINT_STANCE_KINDS, *LINK_STANCE_KINDS)


def apply_stance_values(task: StandTask, numbers: Mapping[str, float]) -> StandTask:
    """Returns a task with a design's numbers.

    Raises:
        ConfigurationError: If a number is out of its range.
    """
    changes: dict[str, Any] = {}
    values = task.values()
    for name, (known, axis) in STANCE_VARIABLES.items():
        if name in numbers and known.axes:
            point = list(changes.get(known.name, values[known.name]) or (0.0,) * len(known.axes))
            point[axis] = numbers[name]
            changes[known.name] = tuple(point)
        elif name in numbers:
            changes[known.name] = numbers[name]
    for name in filter(is_stance_pattern, numbers):
        field, _, of = name.partition(":")
        whole = changes.get(field, values[field])
        number = whole[of].at(numbers[name]) if field in LINK_STANCE_KINDS else numbers[name]
        changes[field] = {**whole, of: number}
    return task.having(changes)


def check_variable_name(name: str, source: RobotSource) -> None:
    """Checks that a study can vary a number.

    Raises:
        ConfigurationError: If there is none of that name; the message lists the names.
    """
    if (
        VariablePattern.parse(name) is None
        and name not in FIELD_OF_VARIABLE
        and name not in source.scales
    ):
        finding = diagnose("no-number-to-vary", known=(*source.scales, *FIELD_OF_VARIABLE))
        raise ConfigurationError(f"vary[{name!r}]", finding)


def check_variable_range(name: str, low: float, high: float) -> None:
    """Checks that a variable's values make sense; those of no bounds are judged one by one.

    Raises:
        ConfigurationError: If not.
    """
    kind, colon, _ = name.partition(":")
    if kind in ADDITIVE_KINDS and colon:  # the robot's own limits count
        return
    field = FIELD_OF_VARIABLE.get(name)
    least, most, unit = (
        (0.0, math.inf, "x") if field is None else (field.low, field.high, field.unit)
    )
    above = (
        kind in ("mass", "inertia", "length", "kp") or not colon if field is None else field.open
    )
    below = low <= least if above else low < least
    if (math.isfinite(low) and below) or (math.isfinite(high) and high > most):
        finding = diagnose(
            "out-of-range",
            first=low,
            last=high,
            open=above,
            low=least,
            high=most if math.isfinite(most) else None,
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
"""What is raised of a design that cannot stand so; of others it is not known."""


def classify_failure(error: BaseException) -> str:
    """Returns of which kind a failure is, in words that a table can be sorted by."""
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
    return next((word for kind, word in kinds.items() if isinstance(error, kind)), "error")


def measure_design(
    maker: DesignBuilder, numbers: Mapping[str, float], metrics: tuple[Metric, ...]
) -> Row:
    """Makes a design and measures it; what fails is said in the row.

    A metric that fails leaves the others: the row's reason is that of the first that did. Of a
    design that cannot stand, a metric that has a value of what has fallen has this one.
    """
    row: Row = dict.fromkeys(FAILURE_COLUMNS)
    try:
        design = maker.design(numbers)
    except Exception as error:
        fallen = {one.name: one.fallen for one in metrics if one.fallen is not None}
        finding = {**row, **make_failure_columns(classify_failure(error), describe_error(error))}
        return {**finding, **fallen} if isinstance(error, STAND_FAILURES) else finding
    for metric in metrics:
        try:
            row.update(_columns(metric.name, metric.function(design)))
        except Exception as error:
            if isinstance(error, STAND_FAILURES) and metric.fallen is not None:
                row[metric.name] = metric.fallen
            if row["failure"] is None:
                row |= make_failure_columns(classify_failure(error), describe_error(error))
                row["failed_metric"] = metric.name
    return row


Row = dict[str, Any]

FAILURE_COLUMNS = ("failure", "failed_metric", "reason", "diagnostic")
"""Columns that tell what failed: of which kind, in measuring what (None: in making it), and why: in
English, and as the record of a diagnostic."""


def make_failure_columns(kind: str, reason: Diagnostic) -> Row:
    """Returns a row's columns of what failed."""
    kept = orjson.dumps(to_record(reason)).decode()
    return {"failure": kind, "reason": str(reason), "diagnostic": kept}


def measure_columns(design: Design, metrics: tuple[Metric, ...]) -> dict[str, float]:
    """Returns {column: value} of the metrics that a design has; one that fails has none."""
    row: dict[str, float] = {}
    for metric in metrics:
        with suppress(PupperAnalysisError):
            row.update(_columns(metric.name, metric.function(design)))
    return row


def _columns(name: str, found: Any) -> Row:
    if isinstance(found, Mapping):
        return {f"{name}.{key}": _value(name, value) for key, value in found.items()}
    return {name: _value(name, found)}


def _value(name: str, value: Any) -> float:
    """Returns a metric's value as a number: 1 for True, 0 for False."""
    try:
        return float(value)
    except (TypeError, ValueError) as error:
        finding = diagnose("measured-no-number", found=repr(value))
        raise ConfigurationError(name, finding) from error


def describe_error(error: BaseException) -> Diagnostic:
    """Returns why a design failed; of an error that is not this package's, what it says."""
    if isinstance(error, PupperAnalysisError):
        return error.diagnostic
    return diagnose("other-error", error=type(error).__name__, message=str(error))
