"""Table of the keys with which files of trainers, deployments and drivers name quantities.

``keys.toml`` contains the keys; a ``pupper-analysis.toml`` may add keys. A `KeyRule` is a quantity,
a path of keys, and the shape of the value. `KeyRule.list_statements` reads a value.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from pathlib import Path
from typing import Any, Final

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import InputError, ModelError
from pupper_analysis.base.inputs import CONFIG_NAME, is_input, read_change_time, read_toml
from pupper_analysis.models.places import Place, make_file_error, make_input_error
from pupper_analysis.tools.contract.facts import (
    QUANTITIES,
    LocatedValue,
    Origin,
    Statement,
    find_quantity_kind,
)

JOINT_ORDER: Final = "joint order"
"""Quantity of a key whose value is the list of joint names in the order of the source's lists."""

_FORMS: Final = ("table", "trainer", "actuator")
"""Valid values of ``of`` in an entry of ``keys.toml``: kind of the source in which a key is
searched, a table (YAML, JSON), a trainer's configuration, or an actuator of a trainer."""

_SHAPES: Final = ("", "number", "list", "table")
"""Valid values of ``shape`` in an entry of ``keys.toml``: required shape of the value of a key;
empty for any shape."""

_MATCHES: Final = ("name", "part")
"""Valid values of ``match`` in an entry of ``keys.toml``, which applies to a table {joint: number}.
``name``: the keys of the table are names or patterns of joints. ``part``: the keys are parts of
joint names.
"""


@dataclass(frozen=True)
class KeyRule:
    """Rule for a key of a file: quantity and shape of the value.

    Attributes:
        quantity: Quantity, or ``observation NAME``.
        path: Keys of nested tables, in lower case.
        form: Format: ``table``, ``trainer`` or ``actuator``.
        shape: Required shape of the value: ``number``, ``list`` or ``table``; empty for any.
        match: Whether keys of a table are names or patterns (``name``), or parts of names
            (``part``).
        rest: Key whose number applies to all joints that no other key selects; empty if there is no
            such key.
        joints: Regular expressions of the joints to which a number belongs; all joints if empty.
        inverse: Whether the value is the reciprocal of the quantity.
    """

    quantity: str
    path: tuple[str, ...]
    form: str = "table"
    shape: str = ""
    match: str = "name"
    rest: str = ""
    joints: tuple[str, ...] = ()
    inverse: bool = False

    def accepts(self, node: LocatedValue) -> bool:
        """Return True if a node has a value, and the value has the required shape (``shape``).

        A text, for example, counts as a number.
        """
        value = node.value
        shape = "list" if isinstance(value, list) else "table" if node.table else "number"
        return node.is_present and self.shape in ("", shape)

    def list_statements(self, node: LocatedValue) -> Iterator[Statement]:
        """Yield the statements of this rule's quantity in a number, a list, or {joint: number}."""
        inner = node.items[0] if len(node.items) == 1 else node
        node = inner if isinstance(inner.value, list) else node
        statements = list(node.make_statements(self.quantity, self.joints))
        if self.match == "part":
            # The key of the other joints comes first: of several statements the last counts.
            statements.sort(key=lambda statement: statement.joint.lower() != self.rest)
        for statement in statements:
            key, value, origin = statement.joint, statement.value, statement.origin
            is_rest = bool(self.rest) and key.lower() == self.rest
            if self.inverse and value is not None:
                value, origin = 1.0 / value if value > 0 else None, Origin.DERIVED
            yield replace(
                statement,
                joint=".*" if is_rest else key,
                is_part=self.match == "part" and key not in ("", ".*") and not is_rest,
                is_rest=is_rest,
                value=value,
                origin=origin,
            )


@cache
def _load_builtin_rules() -> tuple[KeyRule, ...]:
    """Return the rules of ``keys.toml``."""
    path = Path(__file__).with_name("keys.toml")
    entries = tomllib.loads(path.read_text("utf-8"))["key"]
    return tuple(rule for entry in entries for rule in _make_rules(entry, path))


def load_order_keys(source: Path) -> tuple[tuple[str, ...], ...]:
    """Return the keys under which a configuration file lists its joint names in order.

    The user defines such keys in ``pupper-analysis.toml``.

    Args:
        source: Configuration file, near which ``pupper-analysis.toml`` is searched.

    Returns:
        Nested keys in lower case, such as ("robot", "joints"), for each definition.

    Raises:
        ModelError: If the user's file cannot be read, or an entry is not valid.
    """
    return tuple(rule.path for rule in _load_rules("table", source) if rule.quantity == JOINT_ORDER)


def load_key_rules(form: str, source: Path) -> tuple[KeyRule, ...]:
    """Return the rules that find numbers in a file of a format by the names of keys.

    Rules of the user are the last, and have precedence. Rules of joint orders are left out.
    ``form`` is ``table``, ``trainer`` or ``actuator``; ``source`` is the file to which the rules
    are applied.

    Raises:
        ModelError: If the user's file cannot be read, or an entry is not valid.
    """
    return tuple(rule for rule in _load_rules(form, source) if rule.quantity != JOINT_ORDER)


def names_joint_quantity(key: str, source: Path) -> bool:
    """Return True if a key contains a known key of a quantity of joints, such as ``friction``.

    Whole words are compared, without plural endings: ``viscous_friction`` contains ``friction``.

    Args:
        key: Key in a file, such as the name of a constant.
        source: File, near which ``pupper-analysis.toml`` is searched.

    Raises:
        ModelError: If the user's file cannot be read, or an entry is not valid.
    """
    words = f"_{_normalise_key(key)}_"
    return any(
        f"_{_normalise_key(rule.path[-1])}_" in words
        for form in _FORMS
        for rule in load_key_rules(form, source)
        if not find_quantity_kind(rule.quantity).is_setting
    )


def _normalise_key(key: str) -> str:
    """Return the words of a key in lower case, without plural endings, joined by ``_``."""
    return "_".join(word.rstrip("s") or word for word in re.split(r"[\W_]+", key.lower()))


def _load_rules(form: str, source: Path) -> tuple[KeyRule, ...]:
    """Return all rules of a format; rules of the user, which have precedence, are the last.

    The user's ``pupper-analysis.toml`` is searched in the folder of ``source`` and the folders
    above, then from the current folder.

    Raises:
        ModelError: If the user's file cannot be read, or an entry is not valid.
    """
    rules = _load_builtin_rules()
    for folder in (source.absolute().parent, Path.cwd()):
        paths = (parent / CONFIG_NAME for parent in (folder, *folder.parents))
        path = next((path for path in paths if is_input(path)), None)
        if path is not None:
            rules += _read_user_rules(path, read_change_time(path))
            break
    return tuple(rule for rule in rules if rule.form == form)


@lru_cache(maxsize=8)
def _read_user_rules(path: Path, _time: int) -> tuple[KeyRule, ...]:
    """Read the key rules of a user's ``pupper-analysis.toml``.

    ``_time`` is the time of the last change, which is part of the key of the cache.

    Raises:
        ModelError: If the file cannot be read, or an entry is not valid.
    """
    try:
        _, values = read_toml(path)
    except InputError as error:
        raise make_input_error(path, error) from error
    table = values.get("contract", {})
    entries = table.get("key", []) if isinstance(table, dict) else None
    if not isinstance(entries, list):
        raise _make_entry_error(path, "[[contract.key]]")
    return tuple(rule for entry in entries for rule in _make_rules(entry, path))


def _make_rules(entry: Any, path: Path) -> Iterator[KeyRule]:
    """Yield a rule for each name in an entry of ``keys.toml`` or of a user's file.

    Raises:
        ModelError: If the entry is not valid.
    """
    if not isinstance(entry, Mapping):
        raise _make_entry_error(path, "[[contract.key]]")
    known = ("quantity", "names", "of", "shape", "match", "rest", "joints", "inverse")
    for key in entry:
        if key not in known:
            raise _make_entry_error(path, key, known)
    quantity, names = entry.get("quantity"), entry.get("names")
    is_known = isinstance(quantity, str) and (
        quantity in (JOINT_ORDER, *QUANTITIES) or quantity.startswith("observation ")
    )
    if not is_known:
        raise _make_entry_error(path, f"quantity = {quantity!r}", (JOINT_ORDER, *QUANTITIES))
    if not _is_text_list(names) or not names:
        raise _make_entry_error(path, f"names = {names!r}")
    choices = {"of": _FORMS, "shape": _SHAPES, "match": _MATCHES}
    chosen = {key: entry.get(key, values[0]) for key, values in choices.items()}
    for key, values in choices.items():
        if chosen[key] not in values:
            raise _make_entry_error(path, f"{key} = {chosen[key]!r}", tuple(filter(None, values)))
    rest, joints, inverse = (
        entry.get("rest", ""),
        entry.get("joints", []),
        entry.get("inverse", False),
    )
    if not isinstance(rest, str) or not _is_text_list(joints) or not isinstance(inverse, bool):
        raise _make_entry_error(
            path, f"rest = {rest!r}, joints = {joints!r}, inverse = {inverse!r}"
        )
    for name in names:
        yield KeyRule(
            str(quantity),
            tuple(name.lower().split(".")),
            chosen["of"],
            chosen["shape"],
            chosen["match"],
            rest.lower(),
            tuple(joints),
            inverse,
        )


def _is_text_list(value: Any) -> bool:
    """Return True for a list, possibly empty, of texts that are not empty."""
    return isinstance(value, list) and all(isinstance(item, str) and item for item in value)


def _make_entry_error(path: Path, problem: str, known: Sequence[str] = ()) -> ModelError:
    """Return the error about an entry that defines a key, with the valid values."""
    return make_file_error(
        Place(path), diagnose("contract-key-entry", problem=problem, known=tuple(known))
    )
