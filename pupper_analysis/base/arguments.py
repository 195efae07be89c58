"""Checks of arguments of public functions and of fields of dataclasses.

Each check raises a ``ConfigurationError`` that contains the name of the argument.
"""

from __future__ import annotations

import inspect
import math
import re
import reprlib
import sys
import types
import typing
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import fields
from enum import Enum
from fnmatch import fnmatchcase
from functools import cache, wraps
from glob import escape
from numbers import Integral, Real
from os import PathLike
from pathlib import Path
from typing import Any, ParamSpec, TypeGuard, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.diagnostics import (
    Diagnostic,
    Quantity,
    Term,
    diagnose,
)
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.base.runs import is_command_line
from pupper_analysis.base.units import find_untyped_degrees, lacks_unit

_P = ParamSpec("_P")
"""Parameters of a function whose arguments `check_arguments` checks."""

_T = TypeVar("_T")
"""Type of the result of a function whose arguments `check_arguments` checks."""


def is_finite_number(value: object) -> TypeGuard[float]:
    """Return True for a finite int or float; False for a bool."""
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def check_finite(name: str, value: object) -> float:
    """Return an argument as a float; raise an error if it is no finite real number.

    Raises:
        ConfigurationError: If the value is no finite real number, or a bool.
    """
    if isinstance(value, np.ndarray) and not value.ndim and value.dtype != object:
        value = value[()]  # the number in an array of shape ()
    if isinstance(value, _BOOLEAN_TYPES) or not isinstance(value, Real):
        raise ConfigurationError(name, diagnose("no-number", value=reprlib.repr(value)))
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise ConfigurationError(name, diagnose("not-finite", value=number))
    return number


def match_names(pattern: str, names: Iterable[str]) -> list[str]:
    """Return the elements of ``names`` that a pattern selects, in the order of ``names``.

    A name that equals the pattern is the only result, because names may contain brackets
    (``arm[0]``).

    Args:
        pattern: Name, or pattern with the wildcards of ``fnmatch``, such as ``leg_*_3``;
            case-sensitive.
        names: Names, for example of joints.
    """
    listed = list(names)
    if pattern in listed:
        return [pattern]
    return [name for name in listed if fnmatchcase(name, pattern)]


def find_name_patterns(chosen: Sequence[str], names: Iterable[str]) -> list[str]:
    """Find few patterns that together select some names, and no others (`match_names`).

    A pattern is a start of a name, an end of a name, or a complete name. In each step the pattern
    that selects the most remaining names is taken; of equal patterns the longest.

    Args:
        chosen: Names that the patterns select.
        names: All names, including the chosen ones.

    Returns:
        Patterns with the wildcard ``*``, such as ``leg_*``; ``["*"]`` if all names are chosen.
    """
    listed, remaining = list(names), set(chosen)
    if remaining >= set(listed):
        return ["*"]
    candidates = {
        pattern
        for name in chosen
        for length in range(1, len(name) + 1)
        for pattern in (f"{escape(name[:length])}*", f"*{escape(name[-length:])}", name)
    }
    selections = {pattern: set(match_names(pattern, listed)) for pattern in sorted(candidates)}
    selections = {
        pattern: selected for pattern, selected in selections.items() if selected <= remaining
    }
    patterns = []
    while remaining:
        best = max(
            selections, key=lambda pattern: (len(selections[pattern] & remaining), len(pattern))
        )
        if len(selections[best] & remaining) == 1:
            best = next(name for name in listed if name in remaining)  # a name needs no wildcard
        patterns.append(best)
        remaining -= selections[best]
    return patterns


def real_array(name: str, values: ArrayLike) -> NDArray[np.float64]:
    """Convert an argument to a new array of floats of any shape; reject other types than numbers.

    Infinite values and NaN are accepted. Texts, Booleans and complex numbers are rejected, also as
    single elements of a sequence: NumPy would convert them silently. Masked arrays with a masked
    element are also rejected.

    Raises:
        ConfigurationError: If the values are rejected, or cannot be converted.
    """
    if type(values) is np.ndarray and values.dtype == np.float64:
        return values.copy()  # the usual case, such as the qpos of a stand
    if np.ma.is_masked(values):
        raise ConfigurationError(name, diagnose("array-is-masked"))
    try:
        array = np.asarray(values)
        if array.dtype.kind == "O" and not all(map(_is_real_number, array.flat)):
            attribute = _suggest_attribute(values, name)
            raise ConfigurationError(name, diagnose("array-of-other-things", attribute=attribute))
        if not array.ndim and array.dtype.kind in "SU":
            raise ConfigurationError(name, diagnose("text-no-array", given=reprlib.repr(values)))
        if array.dtype.kind not in "iufO":
            message = diagnose("array-of-another-type", type=str(array.dtype))
            raise ConfigurationError(name, message)
        if _contains_boolean(values):  # NumPy converts a Boolean among numbers to 0 or 1
            raise ConfigurationError(name, diagnose("array-of-another-type", type="bool"))
        return np.array(array, dtype=float)
    except (TypeError, ValueError, OverflowError) as error:
        message = diagnose("no-array", problem=str(error))
        raise ConfigurationError(name, message) from error


def _suggest_attribute(value: object, name: str) -> str | None:
    """Return the Python text of the attribute that an array argument needs; None if unknown.

    For example, the text for a `Stand` in place of ``qpos`` is ``stand.qpos``.
    """
    kind = type(value)
    if not kind.__module__.startswith("pupper_analysis.") or not hasattr(value, name):
        return None
    return f"{re.split(r'(?=[A-Z])', kind.__name__)[-1].lower()}.{name}"


def _is_real_number(value: object) -> bool:
    """Return True for a real number that is no Boolean."""
    return isinstance(value, Real) and not isinstance(value, _BOOLEAN_TYPES)


def _contains_boolean(values: object) -> bool:
    """Return True for a Boolean or an array of Booleans, also inside nested sequences."""
    if isinstance(values, np.ndarray):
        return bool(values.dtype.kind == "b")
    elements = np.array(values, dtype=object)  # NumPy finds the sequences, and keeps the elements
    return any(
        isinstance(element, _BOOLEAN_TYPES)
        or (isinstance(element, np.ndarray) and _contains_boolean(element))  # of shape ()
        for element in elements.flat
    )


def check_vector(name: str, values: ArrayLike, size: int) -> NDArray[np.float64]:
    """Convert an argument to a vector (size,) of finite numbers, or raise an error.

    Raises:
        ConfigurationError: If the values are no such vector.
    """
    vector = real_array(name, values)
    if vector.shape != (size,):
        message = diagnose("array-of-another-shape", size=size, shape=str(vector.shape), rows="")
        raise ConfigurationError(name, message)
    # The norm is faster than a test of each element. The norm of finite elements may overflow, so
    # the elements are tested if the norm is not finite.
    if not math.isfinite(math.hypot(*vector.tolist())) and not np.isfinite(vector).all():
        index = int(np.flatnonzero(~np.isfinite(vector))[0])
        message = diagnose("element-not-finite", index=index, value=vector[index])
        raise ConfigurationError(name, message)
    return vector


def check_direction(name: str, values: ArrayLike) -> NDArray[np.float64]:
    """Return the unit vector (3,) of a direction of any length.

    The vector is first scaled, because squares of components below 1e-162 or above 1e154 would
    underflow or overflow.

    Raises:
        ConfigurationError: If the values are no finite vector (3,), or all zero.
    """
    vector = np.zeros(0) if isinstance(values, str) else real_array(name, values)
    if vector.shape != (3,) or not np.isfinite(vector).all() or not vector.any():
        given = " ".join(reprlib.repr(values).split())
        raise ConfigurationError(name, diagnose("direction-not-a-vector", given=given))
    scaled = np.ldexp(vector, -math.frexp(np.abs(vector).max())[1])  # without rounding
    unit: NDArray[np.float64] = scaled / math.hypot(*scaled.tolist())
    return unit


def check_names(name: str, values: Iterable[str]) -> tuple[str, ...]:
    """Return an iterable of names as a tuple; raise an error for a single text.

    The elements are not checked.

    Raises:
        ConfigurationError: If the value is a text, bytes or no iterable.
    """
    is_scalar_array = isinstance(values, np.ndarray) and not values.ndim
    if is_scalar_array or isinstance(values, str | bytes) or not isinstance(values, Iterable):
        check_type(name, values, Iterable[str])
    return tuple(values)


MAX_LENGTH = 1000.0
"""Maximum absolute value of a length or coordinate [m] that `check_length` and similar checks
accept. The bound prevents overflow in later computations. Chosen, not tuned: no robot is larger."""


def check_length(name: str, value: object) -> float:
    """Return a length or a coordinate [m] as a float; raise an error beyond `MAX_LENGTH`.

    Raises:
        ConfigurationError: If the value is no finite number, or its magnitude exceeds
            ``MAX_LENGTH``.
    """
    number = check_finite(name, value)
    if abs(number) > MAX_LENGTH:
        message = diagnose(
            "length-beyond",
            length=Quantity(number, "m"),
            farthest=Quantity(MAX_LENGTH, "m"),
            written=suggest_millimetres(number),
        )
        raise ConfigurationError(name, message)
    return number


def suggest_degrees(angle: float, low: float, high: float) -> str | None:
    """Return the text with which a user writes an angle in degrees, if degrees were meant.

    The text is ``5deg`` on the command line, and ``math.radians(5)`` in Python.

    Args:
        angle: Angle that is out of range [rad].
        low: Lower limit of the angle [rad].
        high: Upper limit of the angle [rad].

    Returns:
        The text; None if degrees were probably not meant (`find_untyped_degrees`).
    """
    degrees = find_untyped_degrees(angle, low, high)
    if degrees is None:
        return None
    return f"{degrees:g}deg" if is_command_line() else f"math.radians({degrees:g})"


def suggest_millimetres(*lengths: float) -> str | None:
    """Format a length or point in m as text, if its user has probably written mm.

    For example, ``"0.12"`` for a length of 120, and ``"(0.02, 0)"`` for the point (20, 0).

    Args:
        lengths: Length, or coordinates of a point [m].

    Returns:
        The text; None if mm were probably not meant (`lacks_unit`), or on the command line, which
        requires a unit of such lengths.
    """
    if is_command_line() or not any(lacks_unit("length", length) for length in lengths):
        return None
    text = ", ".join(f"{length / 1000:g}" for length in lengths)
    return text if len(lengths) == 1 else f"({text})"


def check_arguments(function: Callable[_P, _T]) -> Callable[_P, _T]:
    """Decorate a public function, so that each call checks the arguments against the type hints.

    Only types are checked; the function itself must check the values. Any value is accepted for
    unsupported type hints, for example arrays, tuples and literals. Not all nested values are
    checked.

    Raises:
        ConfigurationError: In the call, if the type of an argument does not match the type hint.
    """
    positional = tuple(
        name
        for name, parameter in inspect.signature(function).parameters.items()
        if parameter.kind is inspect.Parameter.POSITIONAL_OR_KEYWORD
    )

    @wraps(function)
    def call(*args: _P.args, **kwargs: _P.kwargs) -> _T:
        """Check the types of the arguments, and call the decorated function."""
        type_tests = _make_type_tests(function)
        # Arguments that do not match the signature raise Python's own TypeError in the call.
        for arguments in (zip(positional, args, strict=False), kwargs.items()):
            for name, value in arguments:
                if name in type_tests and not type_tests[name](value):
                    check_type(name, value, _get_type_hints(function)[name])
        return function(*args, **kwargs)

    return call


def check_fields(instance: Any) -> None:
    """Check the types of the fields of a dataclass instance against the type hints of the class.

    Raises:
        ConfigurationError: If the type of a field does not match the type hint.
    """
    dataclass_type: Any = type(instance)
    hints = _get_type_hints(dataclass_type)
    for field in fields(instance):
        check_type(field.name, getattr(instance, field.name), hints[field.name])


def check_type(name: str, value: object, hint: Any) -> None:
    """Check a value against a type hint; accept any value if the hint is not supported.

    Raises:
        ConfigurationError: If the type of the value does not match the hint.
    """
    if _make_type_test(hint)(value):
        return
    options = _list_union_members(hint)
    wanted = [_describe_type(option) for option in options]
    given = " ".join(reprlib.repr(value).split())
    names = [getattr(option, "__name__", "") for option in options]
    member = next((option for option in names if option in _UNION_CODES), None)
    if member is not None:
        raise ConfigurationError(
            name, diagnose(_UNION_CODES[member], value=given, text=isinstance(value, str))
        )
    required = next((name for name in names if name in _REMEDIES), "")
    remedy = _REMEDIES.get(required)
    if required == "StandTask" and isinstance(value, Mapping) and all(map(_is_identifier, value)):
        stated = ", ".join(f"{field}={reprlib.repr(value[field])}" for field in value)
        remedy = " ".join(f"pa.StandTask({stated})".split())
    message = diagnose("of-another-type", value=given, wanted=wanted, remedy=remedy)
    raise ConfigurationError(name, message)


def _is_identifier(key: object) -> bool:
    """Return True for a text that is a Python identifier."""
    return isinstance(key, str) and key.isidentifier()


@cache
def _get_type_hints(described: Any) -> dict[str, Any]:
    """Return the type hints of a function or class by name; text annotations are resolved."""
    return typing.get_type_hints(described)


@cache
def _make_type_tests(function: Any) -> dict[str, Callable[[Any], bool]]:
    """Return {name: function that tests a value against its type hint} of a function."""
    return {name: _make_type_test(hint) for name, hint in _get_type_hints(function).items()}


_MAX_DOUBLE = int(sys.float_info.max)
"""Largest absolute value of an integer that is accepted as a float: the largest finite float."""

_NUMBER_TYPES: dict[Any, Any] = {float: Real, int: Integral}
"""{type in an annotation: abstract type of the accepted numbers}; NumPy's numbers are included."""

_REMEDIES = {
    "Configuration": "pa.Configuration(robot, stand.qpos)",
    "Robot": "pa.load_robot",
    "Stand": "pa.solve_stand (or posture.stand of a solved posture)",
    "StandTask": "pa.StandTask(height=0.12)",
}
"""{name of a required class: text that describes how to obtain an object of this class}."""

_UNION_CODES = {"UrdfObject": "no-robot", "Tool": "no-frame-point"}
"""{class name: code of a message about the accepted types}, for arguments whose type is a union
with this class.
"""

_TYPE_NAMES: dict[Any, str] = {
    float: "a number",
    int: "a whole number",
    types.NoneType: "None",
    str: "a text",
    bool: "True or False",
    Path: "a path",
}
"""{type: name in error messages}; the names are keys of ``diagnostics/catalogue/terms.toml``, which
contains the translations."""


_BOOLEAN_TYPES = (bool, np.bool_)
"""Types of Booleans. Arguments that require a number reject values of these types."""


def _list_union_members(hint: Any) -> tuple[Any, ...]:
    """Return the members of a union type; for a type that is no union, only the type itself."""
    union = typing.get_origin(hint) in (typing.Union, types.UnionType)
    return typing.get_args(hint) if union else (hint,)


@cache
def _make_type_test(hint: Any) -> Callable[[Any], bool]:
    """Return a function that tests whether a value has a type; it accepts any if unsupported."""
    options = _list_union_members(hint)
    if len(options) > 1:
        if any(inspect.isclass(option) and issubclass(option, Enum) for option in options):
            # Members of the enum may be given by name; the function that looks up the name checks.
            return _accept_anything
        tests = tuple(_make_type_test(option) for option in options)
        return lambda value: any(test(value) for test in tests)
    if hint in _NUMBER_TYPES:
        kind = _NUMBER_TYPES[hint]
        return lambda value: (
            type(value) is hint
            or (
                isinstance(value, kind)
                and not isinstance(value, _BOOLEAN_TYPES)
                and (hint is int or not isinstance(value, int) or abs(value) <= _MAX_DOUBLE)
            )
        )
    if hint is bool:
        return lambda value: isinstance(value, _BOOLEAN_TYPES)
    if hint in (None, types.NoneType):
        return lambda value: value is None
    if hint is Path:
        return lambda value: isinstance(value, PathLike)
    if inspect.isclass(hint) and typing.get_origin(hint) is None:
        return lambda value: isinstance(value, hint)
    kind, inner = typing.get_origin(hint), typing.get_args(hint)
    if kind is Mapping:
        key = _make_type_test(inner[0])
        return lambda value: isinstance(value, Mapping) and all(map(key, value))
    if kind in (Sequence, Iterable):
        return _make_elements_test(_make_type_test(inner[0]), of_known_length=kind is Sequence)
    return _accept_anything


def _accept_anything(_: Any) -> bool:
    """Return True; test for type hints whose values are not checked."""
    return True


def _make_elements_test(
    element: Callable[[Any], bool], *, of_known_length: bool
) -> Callable[[Any], bool]:
    """Return a function that tests whether a value is an iterable whose elements pass a test.

    With ``of_known_length``, the value must be a sequence or an array. The elements of other
    iterables are not tested.
    """

    def has_valid_elements(value: Any) -> bool:
        """Return True if a value is an iterable whose elements pass the test ``element``.

        Only elements of sequences and arrays are tested: a test would consume an iterator.
        """
        is_sequence = isinstance(value, Sequence) and not isinstance(value, str | bytes)
        is_array = isinstance(value, np.ndarray) and value.ndim
        if of_known_length and not is_sequence and not is_array:
            return False
        if isinstance(value, np.ndarray) and not is_array:  # an array without elements to iterate
            return False
        # Other iterables are not tested: the test would consume an iterator.
        reusable = is_sequence or is_array
        if isinstance(value, str | bytes):  # an iterable of characters is not meant
            return False
        return isinstance(value, Iterable) and (not reusable or all(map(element, value)))

    return has_valid_elements


def _describe_type(option: Any) -> Diagnostic | Term:
    """Return the name of a type for error messages, such as "a number" or "a mapping of names"."""
    kind, inner = typing.get_origin(option), typing.get_args(option)
    name = getattr(option, "__name__", str(option))
    if kind in (Sequence, Iterable):
        names = [_describe_type(inside) for inside in _list_union_members(inner[0])]
        return diagnose("sequence-of", each=names)
    if kind is Mapping:
        return Term("a mapping of names")
    if option in _TYPE_NAMES:
        return Term(_TYPE_NAMES[option])
    return diagnose("object-of", type=name, vowel=name[:1].lower() in "aeiou")
