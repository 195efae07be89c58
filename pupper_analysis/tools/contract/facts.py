"""Statements about joints that sources contain, and the registry of readers.

A reader returns `JointSource` objects. A `Statement` refers to a joint by the name, pattern or
index in the source; a `Fact` refers to a joint of the robot. `LocatedValue` is a value of a file
with the line.
"""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping
from copy import deepcopy
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any, Final, NamedTuple, Protocol

import yaml

from pupper_analysis.base.diagnostics import Diagnostic, Severity, diagnose
from pupper_analysis.base.errors import ModelError
from pupper_analysis.base.results import Result
from pupper_analysis.models.places import Place, make_file_error, one_line

CLASS_KEY: Final = "class_type"
"""Key of the class of a table in files of Isaac Lab, as ``module:Class``. Also added to a table
with a tag ``!!python/object:module.Class``, as mjlab writes it."""

ENTRY_POINT_GROUP: Final = "pupper_analysis.contract"
"""Group of Python entry points with which other packages register reader modules (`SourceReader`),
as ``name = "its.module"``."""

MAX_VALUES: Final = 200_000
"""Largest number of values that are read from a source, or of steps in the evaluation of a Python
file and its imports. Chosen, to bound time and memory.
"""


class Origin(StrEnum):
    """Origin of a number."""

    STATED = "stated"
    """The file states the number."""
    DEFAULT = "default"
    """Default of a framework, for a number that the file does not state."""
    DERIVED = "derived"
    """Computed from other numbers of the file."""
    ASSUMED = "assumed"
    """The file states the number, but not for which joint: the joint order is assumed. Also a
    neutral value in a policy contract that no file states."""
    UNKNOWN = "unknown"
    """No file states the number."""


class Role(StrEnum):
    """Role of a source. In `read_contract`, the earlier role is the reference."""

    TRAINER = "trainer"
    POLICY = "policy"
    DEPLOYMENT = "deployment"
    DRIVER = "driver"
    MODEL = "model"


FIELD_TABLE: Final[Mapping[str, Any]] = tomllib.loads(
    Path(__file__).with_name("fields.toml").read_text("utf-8")
)
"""Content of ``fields.toml``: the compared quantities, such as kp, and the names of keys in each
file format.
"""

KEY_ALIASES: Final[Mapping[str, list[str]]] = FIELD_TABLE["names"]
"""{concept, such as joint names: keys that file formats use for the concept, the preferred first}.
A dot in a key separates nested keys."""

OBSERVATION_ALIASES: Final[Mapping[str, str]] = {
    alias: name for name, aliases in FIELD_TABLE["observed"].items() for alias in aliases
}
"""{name of an observation term in a library: common name}."""

OBSERVATION_SIZES: Final[Mapping[str, int | str]] = FIELD_TABLE["observed_sizes"]
"""{common name of an observation term: number of its elements, or ``joints`` or ``actions`` for the
number of joints or actions of the policy}."""


class QuantityKind(NamedTuple):
    """Properties of a quantity.

    Attributes:
        unit: Unit for a hinge.
        severity: Severity of a difference between sources; None if the quantity is only listed.
        mirrored: How the values of a left joint and the corresponding right joint are compared. 1:
            the values must be equal. -1: the values must be equal or opposite, as the directions of
            the joint axes require. 0: the values are not compared.
        is_setting: Whether the quantity belongs to the source, not to a joint.
    """

    unit: str
    severity: Severity | None
    mirrored: int
    is_setting: bool


QUANTITIES: Final[Mapping[str, QuantityKind]] = {
    name: QuantityKind(
        row["unit"],
        Severity(row["differs"]) if "differs" in row else None,
        row.get("mirrored", 0),
        row.get("whole", False),
    )
    for name, row in FIELD_TABLE["quantities"].items()
}
"""{quantity, such as ``time step``: unit and rules of comparison}, from ``fields.toml``."""


def find_quantity_kind(quantity: str) -> QuantityKind:
    """Return unit, severity of a difference, and symmetry of a quantity, for example of ``kp``.

    A quantity that is not in `QUANTITIES`, such as the scale of an observation term, belongs to a
    whole file instead of a joint.
    """
    return QUANTITIES.get(quantity, QuantityKind("1", Severity.ERROR, 0, is_setting=True))


@dataclass(frozen=True)
class Statement:
    """Number in a source, not yet assigned to a joint of the robot.

    Attributes:
        quantity: Key of `QUANTITIES`, or ``observation NAME`` for the scale of an observation.
        value: Value in SI units; None if the expression is not constant.
        place: File and line.
        joint: Joint name, or a regular expression that must match the complete joint name. If
            ``is_part`` is True: a part of joint names. "" for a setting, or if ``index`` is stated.
        index: Index from 0 into the ``order`` of the source, if no name is stated; otherwise None.
        count: Length of the list that ``index`` refers to.
        decimals: Decimals of the number as written; None for a computed number.
        expression: Text of an expression that is not constant.
        origin: Origin of the number.
        basis: Framework and version of a default; empty for another origin.
        is_part: Whether ``joint`` is a part of joint names. For default angles and action offsets,
            ``joint`` is the complete name if a joint with this name exists.
        is_rest: Whether the number applies to all joints that no other key selects.
    """

    quantity: str
    value: float | None
    place: Place
    joint: str = ""
    index: int | None = None
    count: int = 0
    decimals: int | None = None
    expression: str = ""
    origin: Origin = Origin.STATED
    basis: str = ""
    is_part: bool = False
    is_rest: bool = False


@dataclass(frozen=True)
class ObservedTerm:
    """Term of a policy's observation, such as joint positions, in a source.

    Attributes:
        name: Name in the source, or the name of the term's function.
        scales: Factor, or a factor per element; None if unknown.
        place: File and line.
        history: Number of time steps of the term in an observation; 0 if not stated.
        clip: Lower and upper bound before scaling; None if not stated.
        frame_order: ``oldest first`` or ``newest first`` if the observation is a sequence of
            frames with all terms; empty if not stated.
    """

    name: str
    scales: tuple[float, ...] | None
    place: Place
    history: int = 0
    clip: tuple[float, float] | None = None
    frame_order: str = ""

    @property
    def scale(self) -> float | None:
        """Factor on the first element of this term; None if unknown."""
        return self.scales[0] if self.scales else None

    @property
    def common_name(self) -> str:
        """Name of this observation term of a policy, common to the known training libraries."""
        return OBSERVATION_ALIASES.get(self.name, self.name)


@dataclass(frozen=True, eq=False)
class Fact(Result):
    """Number that a source specifies.

    Attributes:
        source: Name of the source.
        joint: Name of the joint in the model; "" for a setting.
        quantity: Quantity.
        value: Value in SI units; None if the expression is not constant.
        unit: Unit of ``value``.
        place: ``file:line``.
        expression: Text of an expression that is not constant.
        origin: ``stated``, ``default`` (of a framework), ``derived`` (from other numbers) or
            ``assumed`` (the joint order of the list).
        basis: Framework and version of a default; empty for another origin.
        decimals: Decimals of the number as written; None for a computed number.
    """

    source: str
    joint: str
    quantity: str
    value: float | None = field(metadata={"unit": "varies"})
    unit: str
    place: str
    expression: str
    origin: str
    basis: str = ""
    decimals: int | None = None

    @property
    def implied(self) -> bool:
        """Whether the file does not state the number: a framework's default or a derived number."""
        return self.origin in (Origin.DEFAULT, Origin.DERIVED)

    @property
    def number(self) -> float:
        """Value of this number, in ``unit``; 0 if its expression in the file is not constant."""
        return self.value or 0.0


@dataclass(frozen=True)
class JointSource:
    """Content of a source: numbers of joints, joint order and observations.

    A source is a file, or one of several configurations in a file.

    Attributes:
        name: Name of the file, if needed with parent folders and the name of the configuration.
        path: Path of the file.
        role: Role of the source.
        statements: Statements. Of several for a joint the last counts.
        order: Joint names in the order of the policy's arrays; empty if none are stated.
        order_place: File and line of ``order``.
        motors: For each joint of the policy, the index in the robot's order of motors; empty if not
            stated.
        motor_names: Joint names in the robot's order of motors; empty if not stated.
        breadth_first: Whether the trainer sorts joints by depth in the tree.
        observations: Observations of the policy, in order.
        notes: Content that could not be read.
        name_lists: {key: list of texts} of other keys, which may state the order of the lists.
        unlimited: {joint: file and line of its actuator} of a model's joints with an actuator but
            without an effort limit.
        unread: {quantity: reason} of values that are no numbers.
        number_lists: {key: length} of lists of numbers that are not read, although the key contains
            a word for a quantity of joints, such as ``viscous_friction``.
        format: Format of a model: ``urdf``, ``mjcf``, or the name of another format; "" for a
            source that is no model.
    """

    name: str
    path: Path
    role: Role
    statements: tuple[Statement, ...] = ()
    order: tuple[str, ...] = ()
    order_place: Place | None = None
    motors: tuple[int, ...] = ()
    motor_names: tuple[str, ...] = ()
    breadth_first: bool = False
    observations: tuple[ObservedTerm, ...] = ()
    notes: tuple[Diagnostic, ...] = ()
    name_lists: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    unlimited: Mapping[str, Place] = field(default_factory=dict)
    unread: Mapping[str, Diagnostic] = field(default_factory=dict)
    number_lists: Mapping[str, int] = field(default_factory=dict)
    format: str = ""

    def make_fact(self, statement: Statement, joint: str = "") -> Fact:
        """Create a `Fact` from a `Statement`: assign a number of this file to a joint of the robot.

        Args:
            statement: Number in this file, in SI units.
            joint: Joint of the robot; empty if the number applies to no single joint, for example a
                control period.
        """
        return Fact(
            self.name,
            joint,
            statement.quantity,
            statement.value,
            find_quantity_kind(statement.quantity).unit,
            statement.place.path,
            statement.expression,
            str(statement.origin),
            statement.basis,
            statement.decimals,
        )

    @property
    def content(self) -> tuple[tuple[object, ...], ...]:
        """Numbers, joint order and observations without places, to find equal sources."""
        statements = sorted(str((s.quantity, s.joint, s.index, s.value)) for s in self.statements)
        observations = [(term.name, term.scales, term.history) for term in self.observations]
        return tuple(statements), self.order, self.motors, tuple(observations)


@dataclass(frozen=True)
class Request:
    """Request to a reader: a file, and the configurations to read from the file.

    Attributes:
        path: File.
        name: Name of a configuration in the file; "" for all.
        folders: Further folders to search for imported modules.
    """

    path: Path
    name: str = ""
    folders: tuple[Path, ...] = ()


class SourceReader(Protocol):
    """Interface of a reader of source files: a module with these names.

    Attributes:
        FILE_SUFFIXES: File name suffixes, in lower case.
        read: Function that yields the sources in a file; none if the file is of another kind.
    """

    FILE_SUFFIXES: tuple[str, ...]
    read: Callable[[Request], Iterable[JointSource]]


@cache
def load_readers() -> tuple[SourceReader, ...]:
    """Import all reader modules: modules that read statements about joints from source files.

    Other installed Python packages may register modules under `ENTRY_POINT_GROUP`.
    """
    from importlib.metadata import entry_points

    folder = Path(__file__).parent / "readers"
    names = {f"{__package__}.readers.{path.stem}" for path in folder.glob("[a-z]*.py")}
    external = [point.module for point in entry_points(group=ENTRY_POINT_GROUP)]
    modules: Any = [import_module(name) for name in (*sorted(names), *sorted(external))]
    return tuple(modules)


@dataclass(frozen=True)
class LocatedValue:
    """Value of a YAML, JSON or Python file, with the place.

    Attributes:
        value: Number, text, truth value or None; list or dict of nodes; or an object of a reader.
        place: File and line.
        decimals: Decimals of a number as written; None otherwise.
    """

    value: Any
    place: Place
    decimals: int | None = field(default=None, compare=False)

    def __deepcopy__(self, memo: dict[int, Any]) -> LocatedValue:
        return replace(self, value=deepcopy(self.value, memo))

    @property
    def is_present(self) -> bool:
        """True if the value of this node of a YAML, JSON or Python file is not None."""
        return self.value is not None

    @property
    def table(self) -> dict[Any, LocatedValue]:
        """{key: node} of a dict, or {field: node} of an object, in this node; otherwise empty."""
        content = getattr(self.value, "fields", self.value)
        return content if isinstance(content, dict) else {}

    def get(self, *keys: str) -> LocatedValue:
        """Return the value at a path of nested dict keys in this node, as a node.

        If a key is missing, a node with the value None is returned.
        """
        node = self
        for key in keys:
            node = node.table.get(key, LocatedValue(None, node.place))
        return node

    def find_first(self, names: str) -> LocatedValue:
        """Return the value in this table for a concept, such as joint names, in any file format.

        Without such a value, the result is a node with the value None.

        Args:
            names: Concept, a key of `KEY_ALIASES`, which lists the keys of the formats.
        """
        candidates = (self.get(*alias.split(".")) for alias in KEY_ALIASES[names])
        return next(
            (item for item in candidates if item.is_present), LocatedValue(None, self.place)
        )

    @property
    def number(self) -> float | None:
        """Value of this node of a file as a float; None if the value is no number or too large.

        Texts and booleans are no numbers.
        """
        value = self.value
        if isinstance(value, bool) or not isinstance(value, int | float):
            return None
        try:
            return float(value)
        except OverflowError:
            return None

    @property
    def items(self) -> list[LocatedValue]:
        """Items of this node if it is a list, else the node alone; empty if its value is None."""
        return self.value if isinstance(self.value, list) else [self] * self.is_present

    @property
    def texts(self) -> tuple[str, ...]:
        """Value of this node of a data file, a text or a list of texts, as a tuple of texts.

        Empty if the value or an item is no text, or an empty text.
        """
        texts = tuple(item.value for item in self.items)
        return texts if all(isinstance(item, str) and item for item in texts) else ()

    def make_statement(self, quantity: str, joint: str = "", **where: Any) -> Statement:
        """Create a `Statement` from this value: number of a quantity, taken in SI units.

        A value that is no number becomes a text, ``expression``.

        Args:
            quantity: Quantity.
            joint: Name of the joint, or regular expression of joint names; "" if the quantity
                belongs to the whole source, or if ``index`` is passed.
            **where: Further attributes of `Statement`.
        """
        number = self.number
        shown = "[...]" if isinstance(self.value, list | dict) else str(self.value)
        return Statement(
            quantity,
            number,
            self.place,
            joint,
            decimals=self.decimals,
            expression="" if number is not None else shown,
            **where,
        )

    def make_statements(self, quantity: str, joints: Iterable[str] = ()) -> Iterator[Statement]:
        """Yield the statements of a quantity in this node: a number, a list or a table.

        An element of a list refers to a joint by index, an entry of a table by name or pattern.

        Args:
            quantity: Name of the quantity. If the quantity belongs to the whole source instead of a
                joint (a setting), only a number is yielded, as a single statement.
            joints: Patterns of the joints to which a single number applies; all joints if empty.
        """
        if find_quantity_kind(quantity).is_setting:
            if self.number is not None:
                yield self.make_statement(quantity)
        elif isinstance(self.value, dict):
            for name, node in self.value.items():
                if node.is_present:
                    yield node.make_statement(quantity, str(name))
        elif isinstance(self.value, list):
            for index, node in enumerate(self.value):
                yield node.make_statement(quantity, index=index, count=len(self.value))
        elif self.is_present:
            for pattern in list(joints) or [".*"]:
                yield self.make_statement(quantity, pattern)


# YAML and JSON with line numbers.


_FLOAT_PATTERN = re.compile(r"[-+]?(\d[\d_]*\.?\d*|\.\d+)([eE][-+]?\d+)?$")
"""Pattern of an unquoted text in a YAML file that is read as a number. Includes ``1e-3``, a text in
YAML 1.1, but a number for C++ readers.
"""

_OCTAL_PATTERN = re.compile(r"[-+]?0[0_]*[1-7][0-7_]+$")
"""Pattern of an integer such as ``010``: 8 for readers of YAML 1.1, 10 for readers of YAML 1.2.
Such a text is not read as a number.
"""

_INFINITY_PATTERN = re.compile(r"[-+]?(\.?inf|infinity)$", re.IGNORECASE)
"""Pattern of an infinite number of YAML (``.inf``), Python (``inf``) or its JSON (``Infinity``)."""

_DECIMALS_PATTERN = re.compile(r"[-+]?\d*\.?(\d*)(?:[eE]([-+]?\d{1,9}))?")
"""Pattern of a number as written, with groups for the decimals and the exponent."""


def read_yaml_nodes(path: Path, text: str) -> list[LocatedValue]:
    """Parse the documents of a YAML or JSON file to nodes with line numbers.

    Most tags are ignored, and nothing is imported. Aliases are replaced by values. The values of
    keys ``weights`` are replaced by an empty list.

    Raises:
        ModelError: If the text is not valid YAML, or has too many values, for example.
    """
    try:
        loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
        documents = list(yaml.compose_all(text, Loader=loader))
        left = [MAX_VALUES]
        return [
            _convert_yaml_node(path, document, left)
            for document in documents
            if document is not None
        ]
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        problem = one_line(error.problem or error.context or "")
        message = diagnose("contract-no-yaml", problem=problem)
        raise make_file_error(Place(path, mark.line + 1 if mark else None), message) from error
    except yaml.YAMLError as error:
        raise ModelError(path, diagnose("contract-no-yaml", problem=one_line(error))) from error


def _convert_yaml_node(path: Path, node: yaml.Node, left: list[int]) -> LocatedValue:
    """Convert a node of PyYAML, with all nodes in it, to a `LocatedValue` with lines.

    ``left[0]`` is the number of values that may still be read; each value decrements this number.

    Raises:
        ModelError: If ``left[0]`` is used up, or a table repeats a key.
    """
    place = Place(path, node.start_mark.line + 1)
    left[0] -= 1
    if left[0] < 0:
        raise make_file_error(place, diagnose("contract-too-much", most=MAX_VALUES))
    if isinstance(node, yaml.MappingNode):
        table, merged = dict[str, LocatedValue](), dict[str, LocatedValue]()
        for key, value in node.value:
            plain = isinstance(key, yaml.ScalarNode)
            name = str(key.value) if plain else f"? {key.start_mark.index}"
            child_node = (
                LocatedValue([], place)
                if name == "weights"
                else _convert_yaml_node(path, value, left)
            )
            if key.tag.endswith(":merge"):
                for part in reversed(child_node.items):
                    merged |= part.value if isinstance(part.value, dict) else {}
            elif name in table:
                place = Place(path, key.start_mark.line + 1)
                raise make_file_error(place, diagnose("contract-twice", key=name))
            else:
                table[name] = child_node
        if name := _get_python_name(node, "object"):
            table.setdefault(CLASS_KEY, LocatedValue(name, place))
        return LocatedValue(merged | table, place)
    if isinstance(node, yaml.SequenceNode):
        return LocatedValue([_convert_yaml_node(path, child, left) for child in node.value], place)
    if name := _get_python_name(node, "name"):
        return LocatedValue(name, place)
    quoted = node.style in ("'", '"', "|", ">")
    return LocatedValue(str(node.value), place) if quoted else parse_scalar(str(node.value), place)


def _get_python_name(node: yaml.Node, kind: str) -> str:
    """Return the dotted name in a tag ``!!python/KIND:NAME`` of a node; empty without this tag."""
    head, _, name = str(node.tag).partition(f":python/{kind}:")
    return name if head == "tag:yaml.org,2002" else ""


def parse_scalar(text: str, place: Place) -> LocatedValue:
    """Convert an unquoted scalar of YAML to a node: None, truth value, number or text."""
    if text.lower() in ("", "~", "null"):
        return LocatedValue(None, place)
    if text.lower() in ("true", "false"):
        return LocatedValue(text.lower() == "true", place)
    if len(text) <= 64 and _FLOAT_PATTERN.match(text) and not _OCTAL_PATTERN.match(text):
        plain = text.replace("_", "")
        if math.isfinite(number := float(plain)):  # 1e999 is a text: a double would be infinite
            return LocatedValue(number, place, count_decimals(plain))
    if _INFINITY_PATTERN.match(text):
        return LocatedValue(float(text.replace(".", "")), place, 0)
    return LocatedValue(text, place)


def count_decimals(text: str) -> int:
    """Return the number of decimals of a number as written; 0 for other texts.

    The exponent counts: ``1.25e-3`` has 5 decimals, ``1.25e2`` has none.
    """
    match = _DECIMALS_PATTERN.fullmatch(text.replace("_", ""))
    return 0 if match is None else max(0, len(match[1]) - int(match[2] or 0))
