"""Read-only dictionaries and arrays, for results and tasks."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from typing import Any, NoReturn, TypeVar

_K = TypeVar("_K")
"""Type of the keys of a `FrozenDict`."""
_V = TypeVar("_V")
"""Type of the values of a `FrozenDict`."""


class FrozenDict(dict[_K, _V]):
    """Read-only dictionary; hashable if all values are hashable."""

    def _raise_read_only(self, *_: Any, **__: Any) -> NoReturn:
        """Raise TypeError; replaces the methods that modify a dictionary."""
        raise TypeError("it belongs to a result or a task, and cannot be changed: dict(it) copies")

    __setitem__ = __delitem__ = clear = pop = popitem = setdefault = update = _raise_read_only
    __ior__ = _raise_read_only

    def __hash__(self) -> int:  # type: ignore[override]
        return hash(frozenset(self.items()))

    def __reduce__(self) -> tuple[Callable[[Any], Any], tuple[dict[_K, _V]]]:
        return freeze, (dict(self),)  # arrays that were pickled can be written to


def freeze(value: Any) -> Any:
    """Return a read-only version of an array or a ``dict``, with the same content.

    Arrays and dictionaries in the values of a ``dict`` become read-only, too. Other values, for
    example lists and tuples, are returned unchanged. A writeable array is returned as a read-only
    view: the array itself stays writeable.
    """
    kind = type(value)
    if kind is float or kind is str:
        return value
    if kind is dict:
        return FrozenDict({name: freeze(item) for name, item in value.items()})
    numpy = sys.modules.get("numpy")  # without it there are no arrays, and it is slow to import
    if numpy is not None and kind is numpy.ndarray and value.flags.writeable:
        view = value.view()
        view.setflags(write=False)
        return view
    return value


class ReadOnlyFields:
    """Base class of dataclasses whose fields, if arrays or dictionaries, are read-only (`freeze`).

    The fields are also read-only after unpickling: NumPy restores arrays as writeable.
    """

    def __post_init__(self) -> None:
        freeze_fields(self, *vars(self))

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        ReadOnlyFields.__post_init__(self)


def freeze_fields(instance: object, *names: str) -> None:
    """Make attributes of an instance read-only in place (`freeze`); skip missing attributes."""
    own = vars(instance)
    for name in names:
        if name in own and (frozen := freeze(own[name])) is not own[name]:
            own[name] = frozen


def freeze_arrays(arrays: Mapping[str, Any]) -> FrozenDict[str, Any]:
    """Return {name: read-only copy} of named arrays.

    The result contains views of the copies. NumPy refuses to make a view of a read-only array
    writeable.
    """
    copies = {name: array.copy() for name, array in arrays.items()}
    for array in copies.values():
        array.flags.writeable = False
    return FrozenDict({name: array.view() for name, array in copies.items()})
