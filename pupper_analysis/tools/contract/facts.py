"""What sources state of joints: facts, each with its file and line; and who reads which file."""

from __future__ import annotations

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

ENTRY_POINT_GROUP: Final = "pupper_analysis.contract"
"""The group of entry points by which a distribution offers readers: ``name = "its.module"``."""

MAX_VALUES: Final = 200_000
"""Values that are read of one source: the largest configurations that were seen have 4,000, and a
module of a training library takes some 10,000 expressions to be worked out."""


class Role(StrEnum):
    """What a source is for, in the order in which one is held against another."""

    TRAINER = "trainer"
    POLICY = "policy"
    DEPLOYMENT = "deployment"
    DRIVER = "driver"
    MODEL = "model"


FIELD_TABLE: Final[Mapping[str, Any]] = tomllib.loads(
    Path(__file__).with_name("fields.toml").read_text("utf-8")
)
"""What formats call what they state; the file explains its keys."""

KEY_ALIASES: Final[Mapping[str, list[str]]] = FIELD_TABLE["names"]
"""{what is named: by which keys}."""

OBSERVATION_ALIASES: Final[Mapping[str, str]] = {
    alias: name for name, aliases in FIELD_TABLE["observed"].items() for alias in aliases
}
"""{what a library calls a part of what a policy observes: what the others do}."""


class QuantityKind(NamedTuple):
    """A quantity.

    Attributes:
        unit: Of a joint that turns.
        severity: Of a difference; None of what is listed alone.
        mirrored: How it is of the other side's joint: 1 the same, -1 by the joint's axis, 0 not
            held against it.
        is_setting: Whether it is of a source as a whole, and not of a joint.
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


def find_quantity_kind(quantity: str) -> QuantityKind:
    """Returns what a quantity is; what is none of ``QUANTITIES`` is a scale of what is observed."""
    return QUANTITIES.get(quantity, QuantityKind("1", Severity.ERROR, 0, is_setting=True))


FORMAT_KEYS: Final[Mapping[str, Mapping[str, str]]] = {
    form: {
        key: name for name, row in FIELD_TABLE["quantities"].items() for key in row.get(form, ())
    }
    for form in ("table", "settings", "actuator")
}
"""{format: {what it calls it: quantity}}."""


@dataclass(frozen=True)
class Statement:
    """One number that a source states.

    Attributes:
        quantity: A key of ``QUANTITIES``; of observations ``observation NAME``.
        value: In SI units; None of an expression that is no constant.
        place: Where.
        joint: The joint's name, or a regular expression that all of it matches; "" of a setting.
        index: In place of a name: which of the source's ``order``, from 0.
        count: Of how many numbers the list is that ``index`` counts in.
        decimals: Digits after the point, as it is written; None of what was computed.
        expression: What stands there, of what is no constant.
        implied: Whether the source leaves it to its library's default.
    """

    quantity: str
    value: float | None
    place: Place
    joint: str = ""
    index: int | None = None
    count: int = 0
    decimals: int | None = None
    expression: str = ""
    implied: bool = False


@dataclass(frozen=True, eq=False)
class Fact(Result):
    """One number that a source states.

    Attributes:
        source: The source's name.
        joint: The joint, by the model's name; "" of a setting.
        quantity: What it is.
        value: In SI units; None of an expression that is no constant.
        unit: Its unit.
        place: ``file:line``.
        expression: What stands there, of what is no constant.
        implied: Whether the source leaves it to its library's default.
        decimals: Digits after the point, as it is written; None of what was computed.
    """

    source: str
    joint: str
    quantity: str
    value: float | None = field(metadata={"unit": "varies"})
    unit: str
    place: str
    expression: str
    implied: bool
    decimals: int | None = None

    @property
    def number(self) -> float:
        """Its value; 0 of what is no number."""
        return self.value or 0.0


@dataclass(frozen=True)
class Source:
    """What was read of one source.

    Attributes:
        name: The file's name, and the configuration's in it.
        path: The file.
        role: What it is for.
        statements: What it states; of several of one joint the last counts.
        order: The names of joints in the order in which a policy has them; empty if it names none.
        order_place: Where that stands.
        motors: Which motor of the robot's own order each of ``order`` is; empty if not stated.
        motor_names: The robot's own order of motors, by name; empty if not stated.
        breadth_first: Whether a trainer puts joints in the order of their depth in the tree.
        observations: What a policy observes, in order: (name, scale, place).
        notes: What could not be read.
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
    observations: tuple[tuple[str, float | None, Place], ...] = ()
    notes: tuple[Diagnostic, ...] = ()

    def fact(self, said: Statement, joint: str = "") -> Fact:
        """Returns a statement as one of a joint of the robot; of itself as a whole, if of none."""
        return Fact(
            self.name,
            joint,
            said.quantity,
            said.value,
            find_quantity_kind(said.quantity).unit,
            said.place.path,
            said.expression,
            said.implied,
            said.decimals,
        )

    @property
    def content(self) -> tuple[tuple[object, ...], ...]:
        """What it states, wherever that stands: two of the same are one."""
        said = sorted(str((s.quantity, s.joint, s.index, s.value)) for s in self.statements)
        seen = [(name, scale) for name, scale, _ in self.observations]
        return tuple(said), self.order, self.motors, tuple(seen)


@dataclass(frozen=True)
class Request:
    """What a reader is asked for.

    Attributes:
        path: The file.
        name: Which of its configurations; "" for those that there are.
        folders: Where else modules are looked for that it imports.
    """

    path: Path
    name: str = ""
    folders: tuple[Path, ...] = ()


class Reader(Protocol):
    """A reader of sources: a module.

    Attributes:
        SUFFIXES: How the names of its files end.
        read: Yields what a file holds; nothing if it is of another kind.
    """

    SUFFIXES: tuple[str, ...]
    read: Callable[[Request], Iterable[Source]]


@cache
def load_readers() -> tuple[Reader, ...]:
    """Returns all readers, our own first."""
    from importlib.metadata import entry_points

    own = Path(__file__).parent / "readers"
    names = {f"{__package__}.readers.{path.stem}" for path in own.glob("[a-z]*.py")}
    others = [point.module for point in entry_points(group=ENTRY_POINT_GROUP)]
    modules: Any = [import_module(name) for name in (*sorted(names), *sorted(others))]
    return tuple(modules)


@dataclass(frozen=True)
class Node:
    """A value of a file that has lines: what a YAML, a JSON or a Python file states.

    Attributes:
        value: A number, a text, a truth, None; a list or a dict of nodes; else what a reader knows.
        place: Where it stands.
        decimals: Of a number that is written: its digits after the point.
    """

    value: Any
    place: Place
    decimals: int | None = field(default=None, compare=False)

    def __deepcopy__(self, memo: dict[int, Any]) -> Node:
        return replace(self, value=deepcopy(self.value, memo))

    @property
    def is_present(self) -> bool:
        """Whether it is anything."""
        return self.value is not None

    @property
    def table(self) -> dict[Any, Node]:
        """It as a table, or the fields that it has; empty if it is neither."""
        held = getattr(self.value, "fields", self.value)
        return held if isinstance(held, dict) else {}

    def get(self, *keys: str) -> Node:
        """Returns what is below it, by names; nothing, where there is none."""
        node = self
        for key in keys:
            node = node.table.get(key, Node(None, node.place))
        return node

    def find_first(self, names: str) -> Node:
        """Returns the first of several that is below it: of ``KEY_ALIASES``."""
        found = (self.get(*one.split(".")) for one in KEY_ALIASES[names])
        return next((one for one in found if one.is_present), Node(None, self.place))

    @property
    def number(self) -> float | None:
        """It as a number; None if it is none."""
        value = self.value
        if isinstance(value, bool) or not isinstance(value, int | float):
            return None
        try:
            return float(value)
        except OverflowError:
            return None

    @property
    def items(self) -> list[Node]:
        """It as a list; itself alone if it is none."""
        return self.value if isinstance(self.value, list) else [self] * self.is_present

    @property
    def texts(self) -> tuple[str, ...]:
        """It as texts; empty unless it is a text, or a list of nothing else."""
        found = tuple(one.value for one in self.items)
        return found if all(isinstance(one, str) and one for one in found) else ()

    def make_statement(self, quantity: str, joint: str = "", **where: Any) -> Statement:
        """Returns its statement: a number, or an expression that is none."""
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
        """Yields statements of a number for all, a list by index, or a table by name or pattern.

        Args:
            quantity: Which; of a source as a whole there is one statement, if it is a number.
            joints: Patterns of those that a number alone is of; all, if empty.
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


# Files of YAML and JSON, each value with its line.


_FLOAT = re.compile(r"[-+]?(\d[\d_]*\.?\d*|\.\d+)([eE][-+]?\d+)?$")
"""Numbers as people write them: YAML 1.1 has ``1e-3`` as a text, its readers in C++ as a number."""

_WRITTEN = re.compile(r"[-+]?\d*\.?(\d*)(?:[eE]([-+]?\d{1,9}))?")


def read_yaml_nodes(path: Path, text: str) -> list[Node]:
    """Returns the documents of a YAML, of which JSON is a part.

    Tags are no types: a list of whatever tag is a list. An alias is what it stands for. Weights of
    networks are left out.

    Raises:
        ModelError: If it is none, or holds too much; it tells the line.
    """
    try:
        loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
        documents = list(yaml.compose_all(text, Loader=loader))
        left = [MAX_VALUES]
        return [_node(path, one, left) for one in documents if one is not None]
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        problem = one_line(error.problem or error.context or "")
        message = diagnose("contract-no-yaml", problem=problem)
        raise make_file_error(Place(path, mark.line + 1 if mark else None), message) from error
    except yaml.YAMLError as error:
        raise ModelError(path, diagnose("contract-no-yaml", problem=one_line(error))) from error


def _node(path: Path, node: yaml.Node, left: list[int]) -> Node:
    place = Place(path, node.start_mark.line + 1)
    left[0] -= 1
    if left[0] < 0:
        raise make_file_error(place, diagnose("contract-too-much", most=MAX_VALUES))
    if isinstance(node, yaml.MappingNode):
        found, merged = dict[str, Node](), dict[str, Node]()
        for key, value in node.value:
            plain = isinstance(key, yaml.ScalarNode)
            name = str(key.value) if plain else f"? {key.start_mark.index}"
            made = Node([], place) if name == "weights" else _node(path, value, left)
            if key.tag.endswith(":merge"):
                for part in reversed(made.items):
                    merged |= part.value if isinstance(part.value, dict) else {}
            elif name in found:
                place = Place(path, key.start_mark.line + 1)
                raise make_file_error(place, diagnose("contract-twice", key=name))
            else:
                found[name] = made
        return Node(merged | found, place)
    if isinstance(node, yaml.SequenceNode):
        return Node([_node(path, one, left) for one in node.value], place)
    quoted = node.style in ("'", '"', "|", ">")
    return Node(str(node.value), place) if quoted else parse_scalar(str(node.value), place)


def parse_scalar(said: str, place: Place) -> Node:
    """Returns what a text without quotes is: nothing, a truth, a number, or a text."""
    if said.lower() in ("", "~", "null"):
        return Node(None, place)
    if said.lower() in ("true", "false"):
        return Node(said.lower() == "true", place)
    if len(said) <= 64 and _FLOAT.match(said):
        plain = said.replace("_", "")
        return Node(float(plain), place, count_decimals(plain))
    if said.lower() in (".inf", "-.inf", "inf", "-inf"):
        return Node(float(said.replace(".", "")), place, 0)
    return Node(said, place)


def count_decimals(text: str) -> int:
    """Returns the digits after the point of a number as it is written; with its exponent."""
    found = _WRITTEN.fullmatch(text.replace("_", ""))
    return 0 if found is None else max(0, len(found[1]) - int(found[2] or 0))
