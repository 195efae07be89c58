"""Dictionaries and arrays that cannot be written to."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from typing import Any, NoReturn, TypeVar

_K = TypeVar("_K")
_V = TypeVar("_V")


class FrozenDict(dict[_K, _V]):
    """A dictionary that cannot be changed, and so can be hashed if its values can."""

    def _refuse(self, *_: Any, **__: Any) -> NoReturn:
        raise TypeError("it belongs to a result or a task, and cannot be changed: dict(it) copies")

    __setitem__ = __delitem__ = clear = pop = popitem = setdefault = update = _refuse
    __ior__ = _refuse

    def __hash__(self) -> int:  # type: ignore[override]
        return hash(frozenset(self.items()))

    def __reduce__(self) -> tuple[Callable[[Any], Any], tuple[dict[_K, _V]]]:
        return freeze, (dict(self),)  # arrays that were pickled can be written to


def freeze(value: Any) -> Any:
    """Returns an array or a dictionary that cannot be written to, with the same content.

    Of an array that can be it is a view: whoever made it may go on with its own.
    """
    kind = type(value)
    if kind is float or kind is str:
        return value
    if kind is dict:
        return FrozenDict({name: freeze(one) for name, one in value.items()})
    numpy = sys.modules.get("numpy")  # without it there are no arrays, and it is slow to import
    if numpy is not None and kind is numpy.ndarray and value.flags.writeable:
        view = value.view()
        view.setflags(write=False)
        return view
    return value


def freeze_arrays(arrays: Mapping[str, Any]) -> FrozenDict[str, Any]:
    """Returns copies of arrays by names that many results may share: nobody can make them writable.

    Of what cannot be written to a view cannot be made writable either.
    """
    copies = {name: one.copy() for name, one in arrays.items()}
    for one in copies.values():
        one.flags.writeable = False
    return FrozenDict({name: one.view() for name, one in copies.items()})
