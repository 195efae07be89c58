"""Results are dataclasses that turn into JSON."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from pathlib import PurePath
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import orjson
from numpy.typing import ArrayLike

from pupper_analysis.base.diagnostics import Diagnostic, diagnose, format_number
from pupper_analysis.base.errors import ConfigurationError, MissingPackageError
from pupper_analysis.base.frozen import freeze

if TYPE_CHECKING:
    import pandas as pd


def to_json(result: object) -> str:
    """Returns a result, or a container of results, as indented JSON.

    Arrays become lists; a number that is not finite becomes null.

    Raises:
        ConfigurationError: If something in it has no form in JSON, such as bytes.
    """
    options = (
        orjson.OPT_SERIALIZE_NUMPY
        | orjson.OPT_INDENT_2
        | orjson.OPT_NON_STR_KEYS
        | orjson.OPT_PASSTHROUGH_DATACLASS
    )
    try:
        return orjson.dumps(result, default=to_plain, option=options).decode()
    except orjson.JSONEncodeError as error:
        if isinstance(error.__cause__, ConfigurationError):
            raise error.__cause__ from None
        message = diagnose("no-json", problem=str(error))
        raise ConfigurationError("result", message) from error


def to_plain(value: Any) -> Any:
    """Returns what JSON is made of in place of a value that it does not know."""
    if isinstance(value, Diagnostic):
        return value.to_dict()
    if is_dataclass(value):
        names = [f.name for f in fields(value) if f.name[0] != "_"]
        return {name: getattr(value, name) for name in (*names, *getattr(value, "_reported", ()))}
    if hasattr(value, "tolist"):  # an array that is not contiguous
        return value.tolist()
    if hasattr(value, "keys"):  # a mapping that is no dict
        return dict(value)
    if isinstance(value, float | PurePath):  # a number with a unit
        return str(value) if isinstance(value, PurePath) else float(value)
    raise ConfigurationError("result", diagnose("no-json-of", type=type(value).__name__))


_WIDTH = 220
"""Characters of what a result's ``repr`` shows: two or three lines of a terminal."""

_MOST_SHOWN = 3
"""Numbers or names of a field that are shown one by one."""


class Result:
    """Base of the results.

    Their ``repr`` is short: arrays and long lists are shown by their sizes. ``to_json`` has it all.
    Nothing in them can be written to: other functions take them for checked.

    JSON has their fields, and those properties that a class names in ``_reported``.
    """

    _reported: ClassVar[tuple[str, ...]] = ()

    def __init_subclass__(cls) -> None:
        # A dataclass writes its own __repr__, unless the class itself has one.
        cls.__repr__ = Result.__repr__  # type: ignore[method-assign]

    def __post_init__(self) -> None:
        own = vars(self)
        for name, value in own.items():
            if type(value) is dict or (type(value) is np.ndarray and value.flags.writeable):
                own[name] = freeze(value)

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        Result.__post_init__(self)  # an array that was pickled can be written to

    def __repr__(self) -> str:
        shown = ", ".join(f"{name}={value}" for name, value in self._shown())
        if len(shown) > _WIDTH:
            shown = f"{shown[:_WIDTH].rpartition(', ')[0]}, ..."
        return f"{type(self).__name__}({shown})"

    def _shown(self) -> list[tuple[str, str]]:
        return [(f.name, shorten(getattr(self, f.name))) for f in fields(self)]  # type: ignore[arg-type]

    def to_json(self) -> str:
        """Returns the result as indented JSON."""
        return to_json(self)

    def to_dict(self) -> dict[str, Any]:
        """Returns the result as plain dictionaries, lists and numbers."""
        value: dict[str, Any] = orjson.loads(self.to_json())
        return value


class Tabular(Result):
    """Base of the results that are tables: one row per joint, sample, direction or finding."""

    def _columns(self) -> Mapping[str, ArrayLike | Iterable[object]]:
        """Returns {column: its values}, all of one length."""
        raise NotImplementedError

    def to_dataframe(self) -> pd.DataFrame:
        """Returns the table as a pandas ``DataFrame``; units are those of the fields.

        Raises:
            MissingPackageError: If pandas is not installed.
        """
        try:
            import pandas as pd
        except ImportError as error:
            raise MissingPackageError("pandas", "pandas") from error
        return pd.DataFrame({name: list(values) for name, values in self._columns().items()})  # type: ignore[arg-type]


def shorten(value: object) -> str:
    """Returns a value in few words: numbers with 6 digits, what is long by its size."""
    if isinstance(value, Enum):
        return repr(value.value)
    if isinstance(value, float):
        return format_number(value, ".6g")
    if isinstance(value, str):
        return repr(value if len(value) <= 60 else f"{value[:57]}...")
    if isinstance(value, np.ndarray):
        if value.ndim == 1 and value.size <= _MOST_SHOWN:
            return f"[{', '.join(shorten(item) for item in value.tolist())}]"
        return f"<array {' x '.join(map(str, value.shape))}>"
    if isinstance(value, Mapping):
        names = ", ".join(map(str, list(value)[:_MOST_SHOWN])) + (
            ", ..." if len(value) > _MOST_SHOWN else ""
        )
        return f"<{len(value)}: {names}>" if value else "{}"
    if isinstance(value, tuple | list):
        if len(value) <= _MOST_SHOWN and all(isinstance(item, str | float | int) for item in value):
            return f"({', '.join(shorten(item) for item in value)})"
        return f"<{len(value)} {type(value[0]).__name__}>"
    if isinstance(value, Result):
        return f"{type(value).__name__}(...)"
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
