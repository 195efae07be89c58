"""What sources state of joints: facts, each with its file and line; and who reads which file."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any, Final, NamedTuple

from pupper_analysis.base.diagnostics import Diagnostic, Severity
from pupper_analysis.models.places import Place

GROUP: Final = "pupper_analysis.contract"
"""The group of entry points by which a distribution offers readers: ``name = "its.module"``."""

MOST: Final = 200_000
"""Values that are read of one source: the largest configurations that were seen have 4,000, and a
module of a training library takes some 10,000 expressions to be worked out."""


class Role(StrEnum):
    """What a source is for, in the order in which one is held against another."""

    TRAINER = "trainer"
    POLICY = "policy"
    DEPLOYMENT = "deployment"
    DRIVER = "driver"
    MODEL = "model"


class Kind(NamedTuple):
    """A quantity.

    Attributes:
        unit: Of a joint that turns.
        severity: Of a difference; None of what is listed alone.
        mirrored: How it is of the other side's joint: 1 the same, -1 by the joint's axis, 0 not
            held against it.
    """

    unit: str
    severity: Severity | None
    mirrored: int = 1


_ERROR, _WARNING = Severity.ERROR, Severity.WARNING

QUANTITIES: Final[Mapping[str, Kind]] = {
    "time step": Kind("s", None, 0),
    "decimation": Kind("1", None, 0),
    "policy step": Kind("s", _ERROR, 0),
    "latency": Kind("s", _ERROR, 0),
    "actions": Kind("1", _ERROR, 0),
    "observed numbers": Kind("1", None, 0),
    "default angle": Kind("rad", _ERROR, -1),
    "action scale": Kind("rad", _ERROR),
    "action offset": Kind("rad", _ERROR, -1),
    "sign": Kind("1", _ERROR, 0),
    "kp": Kind("N m/rad", _ERROR),
    "kd": Kind("N m s/rad", _ERROR),
    "effort": Kind("N m", _WARNING),
    "velocity": Kind("rad/s", _WARNING),
    "lower limit": Kind("rad", _WARNING, 0),
    "upper limit": Kind("rad", _WARNING, 0),
    "armature": Kind("kg m^2", _WARNING),
    "friction": Kind("N m", _WARNING),
    "damping": Kind("N m s/rad", _WARNING),
    "start angle": Kind("rad", None, 0),
    "start kp": Kind("N m/rad", None, 0),
    "start kd": Kind("N m s/rad", None, 0),
    "friction coefficient": Kind("1", None, 0),
}
"""Of a source as a whole, then of joints. How a policy's step is made up may differ, the step may
not; how many numbers are observed depends on how many steps of them are. What passive joints damp
is no gain of a servo; at which angles a model begins, and with which gains a robot stands up, need
not be what its policy has; a friction of PhysX is no torque."""


def kind_of(quantity: str) -> Kind:
    """Returns what a quantity is; what is none of ``QUANTITIES`` is a scale of what is observed."""
    return QUANTITIES.get(quantity, Kind("1", _ERROR, 0))


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

    @property
    def content(self) -> tuple[tuple[object, ...], ...]:
        """What it states, wherever that stands: two of the same are one."""
        said = sorted(
            (one.quantity, one.joint, str(one.index), str(one.value)) for one in self.statements
        )
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


class Reader(NamedTuple):
    """A reader of sources: a module with ``SUFFIXES`` and ``read``.

    Attributes:
        name: What it is called.
        suffixes: How the names of its files end.
        read: Yields what a file holds; nothing if it is of another kind.
    """

    name: str
    suffixes: tuple[str, ...]
    read: Callable[[Request], Iterable[Source]]


@cache
def readers() -> tuple[Reader, ...]:
    """Returns all readers, our own first."""
    from importlib.metadata import entry_points

    own = Path(__file__).parent / "readers"
    names = {f"{__package__}.readers.{path.stem}" for path in own.glob("[a-z]*.py")}
    others = [point.module for point in entry_points(group=GROUP)]
    modules = [import_module(name) for name in (*sorted(names), *sorted(others))]
    return tuple(Reader(one.__name__, tuple(one.SUFFIXES), one.read) for one in modules)


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

    def get(self, *keys: str) -> Node | None:
        """Returns what is below it, by names; None where there is nothing."""
        node: Node | None = self
        for key in keys:
            if node is None:
                return None
            held = node.value if isinstance(node.value, dict) else getattr(node.value, "fields", {})
            node = held.get(key)
        return None if node is None or node.value is None else node

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
        return self.value if isinstance(self.value, list) else [self]

    @property
    def text(self) -> str:
        """It as a text; "" if it is none."""
        return self.value if isinstance(self.value, str) else ""

    @property
    def texts(self) -> tuple[str, ...]:
        """It as texts; empty unless it is a text, or a list of nothing else."""
        found = tuple(one.text for one in self.items)
        return found if all(found) else ()


def stated(
    quantity: str, node: Node, joint: str = "", index: int | None = None, count: int = 0
) -> Statement:
    """Returns the statement of a node: a number, or an expression that is none."""
    number = node.number
    shown = "[...]" if isinstance(node.value, list | dict) else str(node.value)
    said = "" if number is not None else shown
    return Statement(quantity, number, node.place, joint, index, count, node.decimals, said)


def per_joint(quantity: str, node: Node | None, joints: Iterable[str] = ()) -> Iterator[Statement]:
    """Yields statements of a number for all, a list by index, or a table by name or pattern.

    Args:
        quantity: Which.
        node: The value; nothing is stated if there is none.
        joints: Patterns of those that a number alone is of; all, if empty.
    """
    if node is None:
        return
    if isinstance(node.value, dict):
        for name, value in node.value.items():
            if value.value is not None:
                yield stated(quantity, value, str(name))
    elif isinstance(node.value, list):
        for index, value in enumerate(node.value):
            yield stated(quantity, value, index=index, count=len(node.value))
    else:
        for pattern in list(joints) or [".*"]:
            yield stated(quantity, node, pattern)


def matches(pattern: str, name: str) -> bool:
    """Whether a joint's name is a name, or matches all of a regular expression."""
    if pattern in (name, ".*"):
        return True
    return is_pattern(pattern) and re.fullmatch(pattern, name) is not None


@cache
def is_pattern(text: str) -> bool:
    """Whether a text is a regular expression, and none whose time may grow without bound."""
    often = len(_REPEATED.findall(text))
    try:
        return often <= _MOST_REPEATED and not _NESTED.search(text) and bool(re.compile(text))
    except (re.error, RecursionError, OverflowError):
        return False


_REPEATED: Final = re.compile(r"[+*{?]")
_MOST_REPEATED: Final = 5
"""A name of n letters is tried in some n^5 / 120 ways."""
_NESTED: Final = re.compile(r"[+*}?)][+*{]")
"""A repetition of a repetition, or of a group, which may have some, or alternatives."""
