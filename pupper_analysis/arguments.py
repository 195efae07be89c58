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

from pupper_analysis.errors import ConfigurationError

_P = ParamSpec("_P")
_T = TypeVar("_T")

_MADE_BY = {
    "Robot": "load_variant and load_robot make one",
    "Stand": "solve_stand makes one",
    "StandTask": "for example StandTask(height=0.12)",
    "StancePath": "stance_path makes one",
    "Configuration": "Configuration(robot, qpos) is one",
    "Ground": "for example Ground(slope=0.1)",
    "VariantSpec": "for example VariantSpec('v3', leg_scale=1.2)",
}
"""How those who have none get one."""


def finite(name: str, value: object) -> float:
    """Returns a finite number.

    Args:
        name: The argument's name, for the message.
        value: What was given.

    Raises:
        ConfigurationError: If it is no finite number.
    """
    if isinstance(value, bool) or not isinstance(value, Real):
        raise ConfigurationError(name, f"{reprlib.repr(value)} is not a number")
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise ConfigurationError(name, f"{number} is not finite")
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
        raise ConfigurationError(name, "some of its elements are masked: give the numbers")
    try:
        found = np.asarray(values)
        if found.dtype.kind == "O" and not all(map(_is_real, found.flat)):
            raise ConfigurationError(name, "not an array of numbers: it holds other things")
        if found.dtype.kind not in "iufO":
            raise ConfigurationError(name, f"not an array of real numbers: it is {found.dtype}")
        return np.array(found, dtype=float)
    except (TypeError, ValueError, OverflowError) as error:
        raise ConfigurationError(name, f"not an array of numbers: {error}") from error


def _is_real(value: object) -> bool:
    return isinstance(value, Real) and not isinstance(value, _TRUTHS)


def vector(name: str, values: ArrayLike, size: int) -> NDArray[np.float64]:
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
        raise ConfigurationError(name, f"its shape must be ({size},), not {found.shape}")
    # Quicker than to look at each; where the squares overflow, each is looked at.
    with np.errstate(over="ignore"):
        squares = found.dot(found)
    if not math.isfinite(squares) and not np.isfinite(found).all():
        index = int(np.flatnonzero(~np.isfinite(found))[0])
        raise ConfigurationError(name, f"element {index} is {found[index]}; it must be finite")
    return found


FARTHEST = 1000.0
"""m: beyond, what is given is no length of a robot; beyond all measure, numbers overflow."""


def length(name: str, value: object) -> float:
    """Returns a length or a coordinate (m).

    Args:
        name: The argument's name, for the message.
        value: What was given.

    Raises:
        ConfigurationError: If it is no finite number, or farther than 1000 m.
    """
    number = finite(name, value)
    if abs(number) > FARTHEST:
        raise ConfigurationError(name, f"{number:g} m is beyond {FARTHEST:g} m; lengths are in m")
    return number


def checked(function: Callable[_P, _T]) -> Callable[_P, _T]:
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
    for name, hint, fits in _fields(kind):
        value = getattr(instance, name)
        if not fits(value):
            check_type(name, value, hint)


@cache
def _fields(kind: Any) -> tuple[tuple[str, Any, Callable[[Any], bool]], ...]:
    """Returns name and type of a dataclass's fields, and what tells whether a value is of it."""
    hints = _hints(kind)
    return tuple((one.name, hints[one.name], _test(hints[one.name])) for one in fields(kind))


def check_type(name: str, value: object, hint: Any) -> None:
    """Checks that an argument is of a type.

    Raises:
        ConfigurationError: If not.
    """
    if _test(hint)(value):
        return
    wanted = _words(hint)
    made_by = [_MADE_BY[kind] for kind in _MADE_BY if kind in wanted.split()]
    hints = f"; {'; '.join(made_by)}" if made_by else ""
    raise ConfigurationError(name, f"{reprlib.repr(value)} is not {wanted}{hints}")


@cache
def _hints(described: Any) -> dict[str, Any]:
    return typing.get_type_hints(described)


@cache
def _tests(function: Any) -> dict[str, Callable[[Any], bool]]:
    """Returns what tells of each of a function's arguments whether it is of the type it says."""
    return {name: _test(hint) for name, hint in _hints(function).items()}


_NUMBERS: dict[Any, tuple[Any, str]] = {
    float: (Real, "a number"),
    int: (Integral, "a whole number"),
}


_TRUTHS = (bool, np.bool_)


def _options(hint: Any) -> tuple[Any, ...]:
    """Returns the types of a union; of no union, itself."""
    union = typing.get_origin(hint) in (typing.Union, types.UnionType)
    return typing.get_args(hint) if union else (hint,)


@cache
def _test(hint: Any) -> Callable[[Any], bool]:
    """Returns what tells whether a value is of a type; yes where the type is none that can be told.

    It is made once per type: arguments are checked more often than types are written.
    """
    options = _options(hint)
    if len(options) > 1:
        if any(inspect.isclass(option) and issubclass(option, Enum) for option in options):
            return _anything  # by name as well: who looks it up knows the names
        tests = tuple(_test(option) for option in options)
        return lambda value: any(test(value) for test in tests)
    if hint in _NUMBERS:
        kind = _NUMBERS[hint][0]
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


def _words(hint: Any) -> str:
    """Returns a type as the message of an error has it."""
    words = []
    for option in _options(hint):
        kind, inner = typing.get_origin(option), typing.get_args(option)
        name = getattr(option, "__name__", str(option))
        if option in _NUMBERS:
            words.append(_NUMBERS[option][1])
        elif kind in (Sequence, Iterable):
            words.append(f"a sequence, each {_words(inner[0])}")
        elif kind is Mapping:
            words.append("a mapping of names")
        elif option is types.NoneType:
            words.append("None")
        else:
            plain = {"str": "a text", "bool": "True or False", "Path": "a path"}
            words.append(plain.get(name, f"a {name}"))
    return " or ".join(words)
