"""Results are dataclasses that turn into JSON."""

from __future__ import annotations

from typing import Any

import orjson


def to_json(result: object) -> str:
    """Returns a result, or a container of results, as indented JSON.

    Arrays become lists; a number that is not finite becomes null.
    """
    options = orjson.OPT_SERIALIZE_NUMPY | orjson.OPT_INDENT_2 | orjson.OPT_NON_STR_KEYS
    return orjson.dumps(result, default=_fallback, option=options).decode()


def _fallback(value: Any) -> Any:
    if hasattr(value, "tolist"):  # an array that is not contiguous
        return value.tolist()
    if hasattr(value, "keys"):  # a mapping that is no dict
        return dict(value)
    raise TypeError(f"{type(value).__name__} cannot become JSON")


class Result:
    """Base of the results."""

    def to_json(self) -> str:
        """Returns the result as indented JSON."""
        return to_json(self)

    def to_dict(self) -> dict[str, Any]:
        """Returns the result as plain dictionaries, lists and numbers."""
        value: dict[str, Any] = orjson.loads(self.to_json())
        return value
