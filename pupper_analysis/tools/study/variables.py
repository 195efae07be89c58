"""What varies in a study: lists of values, and distributions."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.arguments import check_finite, check_type
from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.errors import ConfigurationError

Array = NDArray[np.float64]


_TAIL = 2.0**-33
"""Half of the finest step of Sobol's sequence: shares nearer to 0 or 1 would be infinitely far."""


def _normal(mean: float, deviation: float, shares: Array) -> Array:
    from scipy.special import ndtri

    spread: Array = mean + deviation * ndtri(np.clip(shares, _TAIL, 1 - _TAIL))
    return spread


_QUANTILES: Mapping[str, Callable[[float, float, Array], Array]] = {
    "uniform": lambda low, high, shares: low + (high - low) * shares,
    "log_uniform": lambda low, high, shares: low * (high / low) ** shares,
    "normal": _normal,
}
"""{kind of a distribution: its inverse}; a log-uniform one is as likely within each factor of 2."""


@dataclass(frozen=True)
class Variable:
    """Values that one number of a design takes.

    Attributes:
        kind: ``values``, each as likely as the others; ``linspace``; or a distribution: ``uniform``
            or ``log_uniform``, of the least and the greatest value; ``normal``, of the mean and the
            standard deviation.
        numbers: As a study's file has them.
    """

    kind: str
    numbers: tuple[float, ...]

    @property
    def levels(self) -> tuple[float, ...] | None:
        """The values, if they are finitely many; None of a distribution."""
        if self.kind == "linspace":
            low, high, count = self.numbers
            return tuple(np.linspace(low, high, int(count)).tolist())
        return self.numbers if self.kind == "values" else None

    @property
    def range(self) -> tuple[float, float]:
        """The least and the greatest value; infinite where there is none."""
        if self.kind == "normal":
            return -math.inf, math.inf
        listed = self.levels or self.numbers
        return min(listed), max(listed)

    def at(self, shares: Array) -> Array:
        """Returns the quantiles (n,) of shares (n,) between 0 and 1: the inverse distribution."""
        if self.levels is None:
            return _QUANTILES[self.kind](self.numbers[0], self.numbers[1], shares)
        index = np.minimum((shares * len(self.levels)).astype(int), len(self.levels) - 1)
        found: Array = np.array(self.levels)[index]
        return found

    def to_dict(self) -> dict[str, Any]:
        """Returns it as a study's file has it: {kind: its numbers}."""
        return {self.kind: list(self.numbers)}


MAX_LEVELS = 1_000_000
"""Of one variable: a longer list is a distribution."""


def linspace(low: float, high: float, count: int) -> Variable:
    """Makes evenly spaced values.

    Args:
        low: The first.
        high: The last.
        count: How many, at least 2.

    Raises:
        ConfigurationError: If they are none.
    """
    first, last = _ordered("linspace", low, high)
    check_type("count", count, int)
    if not 2 <= count <= MAX_LEVELS:
        problem = diagnose(
            "levels-out-of-range", count=count, low=first, high=last, most=MAX_LEVELS
        )
        raise ConfigurationError("linspace", problem)
    return Variable("linspace", (first, last, int(count)))


def values(numbers: Sequence[float]) -> Variable:
    """Makes a variable of a list of values.

    Raises:
        ConfigurationError: If it is empty, or a value is no finite number or there twice.
    """
    check_type("values", numbers, Sequence[float])
    listed = tuple(check_finite("values", value) for value in numbers)
    if not 1 <= len(listed) <= MAX_LEVELS:
        finding = diagnose("values-out-of-range", count=len(listed), most=MAX_LEVELS)
        raise ConfigurationError("values", finding)
    if len(set(listed)) < len(listed):
        raise ConfigurationError("values", diagnose("value-there-twice", listed=str(list(listed))))
    return Variable("values", listed)


def uniform(low: float, high: float) -> Variable:
    """Makes a uniform distribution.

    Raises:
        ConfigurationError: If its range is empty.
    """
    return Variable("uniform", _ordered("uniform", low, high))


def log_uniform(low: float, high: float) -> Variable:
    """Makes a distribution whose logarithm is uniform.

    Raises:
        ConfigurationError: If its range is empty, or not above 0.
    """
    first, last = _ordered("log_uniform", low, high)
    if first <= 0:
        raise ConfigurationError("log_uniform", diagnose("logarithm-of-negative", low=first))
    return Variable("log_uniform", (first, last))


def normal(mean: float, deviation: float) -> Variable:
    """Makes a normal distribution of a mean and a standard deviation.

    Raises:
        ConfigurationError: If the deviation is not above 0.
    """
    spread = check_finite("normal", deviation)
    if spread <= 0:
        raise ConfigurationError("normal", diagnose("deviation-not-positive", deviation=spread))
    return Variable("normal", (check_finite("normal", mean), spread))


VARIABLE_MAKERS: Mapping[str, Callable[..., Variable]] = {
    "linspace": linspace,
    "values": lambda *numbers: values(numbers),
    "uniform": uniform,
    "normal": normal,
    "log_uniform": log_uniform,
}
"""How a study's file says each kind."""


def make_variable(name: str, given: object) -> Variable:
    """Makes a variable of what a study gives: a number, a list, {kind: numbers}, or a variable.

    Args:
        name: The varied number's, for messages.
        given: What was given.

    Raises:
        ConfigurationError: If it is none of these.
    """
    try:
        if isinstance(given, Variable):
            return given
        if isinstance(given, Mapping):
            ((kind, numbers),) = given.items() if len(given) == 1 else (("", ()),)
            if kind == "grid":
                raise ConfigurationError("grid", _ambiguous(numbers))
            if (
                kind not in VARIABLE_MAKERS
                or not isinstance(numbers, Sequence)
                or isinstance(numbers, str)
            ):
                finding = diagnose(
                    "no-kind-of-variable", given=repr(dict(given)), known=VARIABLE_MAKERS
                )
                raise ConfigurationError("kind", finding)
            return VARIABLE_MAKERS[kind](*numbers)
        if isinstance(given, Sequence | np.ndarray):
            return values(given)  # type: ignore[arg-type]
        return values([given])  # type: ignore[list-item]
    except ConfigurationError as error:
        raise ConfigurationError(f"vary[{name!r}]", error.diagnostic) from error
    except TypeError as error:
        problem = diagnose("numbers-of-variable", given=repr(given))
        raise ConfigurationError(f"vary[{name!r}]", problem) from error


def _ambiguous(numbers: Any) -> Diagnostic:
    """Returns what the two things are that ``grid`` could mean."""
    listed = ", ".join(map(str, numbers)) if isinstance(numbers, list | tuple) else str(numbers)
    return diagnose("grid-is-ambiguous", listed=listed)


def _ordered(name: str, low: float, high: float) -> tuple[float, float]:
    first, last = check_finite(name, low), check_finite(name, high)
    if not first < last:
        raise ConfigurationError(name, diagnose("interval-empty", low=first, high=last))
    return first, last


# Which designs a study has: the product of lists, or Sobol's sequence.


BLOCK_SIZE = 4096
"""Designs that are made at a time: a power of 2, as Sobol's sequence is even over such."""

MAX_SAMPLES = 2**30
"""What Sobol's sequence has."""


@dataclass(frozen=True)
class Sampling:
    """The designs of a study, made block by block, so that none need be kept.

    Where all variables have finitely many values the designs are their product, the last variable
    changing first. Where there is a distribution they are a scrambled Sobol sequence: the first n
    of more samples are the n of fewer, so that a study can grow.

    Source: Sobol, "On the distribution of points in a cube", 1967; Owen's scrambling (scipy.stats).

    Attributes:
        variables: {name: its values}.
        samples: How many, of a sequence; None for a product.
        seed: Of the sequence's scrambling.
    """

    variables: Mapping[str, Variable]
    samples: int | None
    seed: int

    def __post_init__(self) -> None:
        spread = [name for name, variable in self.variables.items() if variable.levels is None]
        if spread and self.samples is None:
            raise ConfigurationError("samples", diagnose("samples-missing", name=spread[0]))
        if not spread and self.samples is not None:
            finding = diagnose("samples-of-lists", product=self.product)
            raise ConfigurationError("samples", finding)
        if self.samples is not None and not 1 <= self.samples <= MAX_SAMPLES:
            finding = diagnose("count-not-from-to", count=self.samples, least=1, most=MAX_SAMPLES)
            raise ConfigurationError("samples", finding)
        if not 0 <= self.seed < 2**63:
            raise ConfigurationError("seed", diagnose("seed-out-of-range", seed=self.seed))

    @property
    def product(self) -> int:
        """How many designs the product of all lists has."""
        return math.prod(len(variable.levels or ()) for variable in self.variables.values())

    def __len__(self) -> int:
        return self.product if self.samples is None else self.samples

    def blocks(self) -> Iterator[Array]:
        """Yields the designs, (n, variables) at a time."""
        columns = list(self.variables.values())
        if self.samples is None:
            levels = [np.array(column.levels or ()) for column in columns]
            sizes = [len(listed) for listed in levels]
            for start in range(0, self.product, BLOCK_SIZE):
                numbers = np.arange(start, min(start + BLOCK_SIZE, self.product))
                index = np.unravel_index(numbers, sizes) if sizes else ()
                block = np.zeros((len(numbers), len(columns)))
                for place, (listed, at) in enumerate(zip(levels, index, strict=True)):
                    block[:, place] = listed[at]
                yield block
            return
        from scipy.stats import qmc

        sequence = qmc.Sobol(len(columns), scramble=True, rng=np.random.default_rng(self.seed))
        for start in range(0, self.samples, BLOCK_SIZE):
            shares = sequence.random(BLOCK_SIZE)[: self.samples - start]
            yield np.column_stack(
                [one.at(share) for one, share in zip(columns, shares.T, strict=True)]
            )
