"""Checks of arguments."""

from __future__ import annotations

import inspect
import math
import reprlib
import types
import typing
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import fields
from enum import Enum
from functools import cache, wraps
from numbers import Integral, Real
from os import PathLike
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.diagnostics import (
    Diagnostic,
    Quantity,
    Term,
    diagnose,
)
from pupper_analysis.base.errors import ConfigurationError

_P = ParamSpec("_P")
_T = TypeVar("_T")


def check_finite(name: str, value: object) -> float:
    """Returns a finite number.

    Args:
        name: The argument's name, for the message.
        value: What was given.

    Raises:
        ConfigurationError: If it is no finite number.
    """
    if isinstance(value, bool) or not isinstance(value, Real):
        raise ConfigurationError(name, diagnose("no-number", value=reprlib.repr(value)))
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise ConfigurationError(name, diagnose("not-finite", value=number))
    return number


def real_array(name: str, values: ArrayLike) -> NDArray[np.float64]:
    """Returns a new array of real numbers.

    What NumPy would turn into such without a word is refused: texts, truth values, the real parts
    of complex numbers, what a mask hides.

    Args:
        name: The argument's name, for the message.
        values: What was given.

    Raises:
        ConfigurationError: If it is no such array.
    """
    if type(values) is np.ndarray and values.dtype == np.float64:
        return values.copy()  # a stand's qpos: nothing to find out
    if np.ma.is_masked(values):
        raise ConfigurationError(name, diagnose("array-is-masked"))
    try:
        found = np.asarray(values)
        if found.dtype.kind == "O" and not all(map(_is_real, found.flat)):
            raise ConfigurationError(name, diagnose("array-of-other-things"))
        if found.dtype.kind not in "iufO":
            message = diagnose("array-of-another-type", type=str(found.dtype))
            raise ConfigurationError(name, message)
        return np.array(found, dtype=float)
    except (TypeError, ValueError, OverflowError) as error:
        message = diagnose("no-array", problem=str(error))
        raise ConfigurationError(name, message) from error


def _is_real(value: object) -> bool:
    return isinstance(value, Real) and not isinstance(value, _TRUTHS)


def check_vector(name: str, values: ArrayLike, size: int) -> NDArray[np.float64]:
    """Returns a vector (size,) of finite numbers.

    Args:
        name: The argument's name, for the message.
        values: What was given.
        size: How long it must be.

    Raises:
        ConfigurationError: If it is no such vector.
    """
    found = real_array(name, values)
    if found.shape != (size,):
        message = diagnose("array-of-another-shape", size=size, shape=str(found.shape))
        raise ConfigurationError(name, message)
    # Quicker than to look at each; where the length overflows, each is looked at.
    if not math.isfinite(math.hypot(*found.tolist())) and not np.isfinite(found).all():
        index = int(np.flatnonzero(~np.isfinite(found))[0])
        message = diagnose("element-not-finite", index=index, value=found[index])
        raise ConfigurationError(name, message)
    return found


FARTHEST = 1000.0
"""m: beyond, what is given is no length of a robot; beyond all measure, numbers overflow."""


def check_length(name: str, value: object) -> float:
    """Returns a length or a coordinate (m).

    Args:
        name: The argument's name, for the message.
        value: What was given.

    Raises:
        ConfigurationError: If it is no finite number, or farther than 1000 m.
    """
    number = check_finite(name, value)
    if abs(number) > FARTHEST:
        message = diagnose(
            "length-beyond", length=Quantity(number, "m"), farthest=Quantity(FARTHEST, "m")
        )
        raise ConfigurationError(name, message)
    return number


def check_arguments(function: Callable[_P, _T]) -> Callable[_P, _T]:
    """Lets a public function refuse arguments that are not of the types it says.

    What it says no type of (arrays, literals) it has to check itself, and so the values.

    Raises:
        ConfigurationError: On the call, naming the argument.
    """
    positional = tuple(
        name
        for name, parameter in inspect.signature(function).parameters.items()
        if parameter.kind is inspect.Parameter.POSITIONAL_OR_KEYWORD
    )

    @wraps(function)
    def call(*args: _P.args, **kwargs: _P.kwargs) -> _T:
        fits = _tests(function)
        # What does not fit the signature is left to the call, whose TypeError is Python's own.
        for given in (zip(positional, args, strict=False), kwargs.items()):
            for name, value in given:
                if name in fits and not fits[name](value):
                    check_type(name, value, _hints(function)[name])
        return function(*args, **kwargs)

    return call


def check_fields(instance: Any) -> None:
    """Checks that a dataclass's fields are of the types it says.

    Raises:
        ConfigurationError: If not, naming the field.
    """
    kind: Any = type(instance)
    hints = _hints(kind)
    for one in fields(instance):
        check_type(one.name, getattr(instance, one.name), hints[one.name])


def check_type(name: str, value: object, hint: Any) -> None:
    """Checks that an argument is of a type.

    Raises:
        ConfigurationError: If not.
    """
    if _test(hint)(value):
        return
    message = diagnose(
        "of-another-type",
        value=reprlib.repr(value),
        wanted=[_kind(option) for option in _options(hint)],
    )
    raise ConfigurationError(name, message)


@cache
def _hints(described: Any) -> dict[str, Any]:
    return typing.get_type_hints(described)


@cache
def _tests(function: Any) -> dict[str, Callable[[Any], bool]]:
    """Returns what tells of each of a function's arguments whether it is of the type it says."""
    return {name: _test(hint) for name, hint in _hints(function).items()}


_NUMBERS: dict[Any, Any] = {float: Real, int: Integral}

_NAMED: dict[Any, str] = {
    float: "a number",
    int: "a whole number",
    types.NoneType: "None",
    str: "a text",
    bool: "True or False",
    Path: "a path",
}
"""What types are called that are no objects of this package."""


_TRUTHS = (bool, np.bool_)


def _options(hint: Any) -> tuple[Any, ...]:
    """Returns the types of a union; of no union, itself."""
    union = typing.get_origin(hint) in (typing.Union, types.UnionType)
    return typing.get_args(hint) if union else (hint,)


@cache
def _test(hint: Any) -> Callable[[Any], bool]:
    """Returns what checks whether a value is of a type; yes of a type that cannot be checked.

    It is made once per type: arguments are checked more often than types are written.
    """
    options = _options(hint)
    if len(options) > 1:
        if any(inspect.isclass(option) and issubclass(option, Enum) for option in options):
            return _anything  # by name as well: who looks it up knows the names
        tests = tuple(_test(option) for option in options)
        return lambda value: any(test(value) for test in tests)
    if hint in _NUMBERS:
        kind = _NUMBERS[hint]
        return lambda value: (
            type(value) is hint or (isinstance(value, kind) and not isinstance(value, _TRUTHS))
        )
    if hint is bool:
        return lambda value: isinstance(value, _TRUTHS)
    if hint in (None, types.NoneType):
        return lambda value: value is None
    if hint is Path:
        return lambda value: isinstance(value, PathLike)
    if inspect.isclass(hint) and typing.get_origin(hint) is None:
        return lambda value: isinstance(value, hint)
    kind, inner = typing.get_origin(hint), typing.get_args(hint)
    if kind is Mapping:
        key = _test(inner[0])
        return lambda value: isinstance(value, Mapping) and all(map(key, value))
    if kind in (Sequence, Iterable):
        return _listed(_test(inner[0]), of_known_length=kind is Sequence)
    return _anything


def _anything(_: Any) -> bool:
    return True


def _listed(element: Callable[[Any], bool], *, of_known_length: bool) -> Callable[[Any], bool]:
    """Returns what tells whether a value is a sequence, or anything to go through, of elements."""

    def test(value: Any) -> bool:
        listed = isinstance(value, Sequence) and not isinstance(value, str | bytes)
        array = isinstance(value, np.ndarray) and value.ndim
        if of_known_length and not listed and not array:
            return False
        # What can be looked at but once is looked at by whom it is given to.
        again = listed or array
        return isinstance(value, Iterable) and (not again or all(map(element, value)))

    return test


def _kind(option: Any) -> Diagnostic | Term:
    """Returns what a type is called in an error."""
    kind, inner = typing.get_origin(option), typing.get_args(option)
    name = getattr(option, "__name__", str(option))
    if kind in (Sequence, Iterable):
        each = [_kind(inside) for inside in _options(inner[0])]
        return diagnose("sequence-of", each=each)
    if kind is Mapping:
        return Term("a mapping of names")
    if option in _NAMED:
        return Term(_NAMED[option])
    return diagnose("object-of", type=name)
