"""What Python's reader of TOML leaves out: the line of a key; and writing."""

from __future__ import annotations

import json
import math
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pupper_analysis.base import inputs
from pupper_analysis.base.diagnostics import Diagnostic
from pupper_analysis.base.errors import InputError, ModelError
from pupper_analysis.models.places import one_line, source_name

Key = tuple[str | int, ...]
"""The way to a value: names of keys, and numbers (from 0) in arrays."""


@dataclass(frozen=True, eq=False)
class TomlFile:
    """A TOML file that was read.

    Attributes:
        path: The file.
        text: Its text.
        values: Its values.
    """

    path: Path
    text: str = field(repr=False)
    values: dict[str, Any]

    def line_of(self, key: Key) -> int | None:
        """Returns the line, from 1, of the statement that brings in a key; None if none does.

        The text is read from its beginning to the end of each line, as far as that is TOML: the
        statement after which the key is there, is its own.
        """
        start = None
        lines = self.text.split("\n")
        for number, line in enumerate(lines, start=1):
            if start is None and line.strip() and not line.lstrip().startswith("#"):
                start = number
            try:
                values = tomllib.loads("\n".join(lines[:number]))
            except tomllib.TOMLDecodeError:
                continue  # in the middle of a statement
            if _has(values, key):
                return start
            start = None
        return None

    def error(self, key: Key, problem: Diagnostic) -> ModelError:
        """Returns the error that tells the line of a key, and what is wrong with it."""
        return ModelError(source_name(self.path, self.line_of(key)), problem)


def _has(values: Any, key: Key) -> bool:
    for part in key:
        if isinstance(part, int):
            if not isinstance(values, list) or len(values) <= part:
                return False
        elif not isinstance(values, dict) or part not in values:
            return False
        values = values[part]
    return True


def read_toml(path: Path) -> TomlFile:
    """Reads a TOML file.

    Raises:
        ModelError: If it cannot be read; the message tells the line.
    """
    try:
        return TomlFile(path, *inputs.read_toml(path))
    except InputError as error:
        raise ModelError(source_name(path, error.line), error.cause) from error


def toml_value(value: object) -> str:
    """Writes a number, a text, or a list or table of such, as TOML.

    Floats are written with the fewest digits that are read back as the same number.
    """
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int | float):
        return repr(value) if math.isfinite(value) else str(value)
    if isinstance(value, str):
        # JSON's text is TOML's, but for this one, and for half a pair of surrogates.
        text = value.encode("utf-8", errors="replace").decode()
        return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, list | tuple):
        return "[" + ", ".join(toml_value(each) for each in value) + "]"
    if isinstance(value, Mapping):
        pairs = (f"{toml_value(str(key))} = {toml_value(each)}" for key, each in value.items())
        return "{" + ", ".join(pairs) + "}"
    raise TypeError(f"{type(value).__name__} is not written to TOML")


def toml_table(name: str, values: Mapping[str, object], comments: Iterable[str] = ()) -> str:
    """Writes one element of an array of tables, with lines of comment above its keys."""
    said = [f"# {toml_value(one_line(comment))[1:-1]}" for comment in comments]
    keys = [f"{key} = {toml_value(value)}" for key, value in values.items()]
    return "\n".join([f"[[{name}]]", *said, *keys]) + "\n"
