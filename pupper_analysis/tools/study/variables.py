"""Variables of a study: lists of values and probability distributions.

`Variable` maps probabilities to values, and `Sampling` generates the designs block by block: the
product of all lists, or a scrambled Sobol sequence if a variable has a distribution.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from pupper_analysis.base.arguments import check_finite, check_type
from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.errors import ConfigurationError

if TYPE_CHECKING:
    import pandas as pd

_MIN_PROBABILITY = 2.0**-33
"""Lower bound of a probability p and of 1 - p: an eighth of the step 2^-30 of scipy's Sobol
sequence. The bound is necessary since the normal quantile is infinite at 0 and 1. Chosen, not
tuned.
"""


def _evaluate_normal(mean: float, deviation: float, probabilities: Array) -> Array:
    """Return the quantiles of a normal distribution at n probabilities, shape (n,).

    ``mean`` and ``deviation`` (standard deviation) have the unit of the variable.
    """
    from scipy.special import ndtri

    quantiles: Array = mean + deviation * ndtri(
        np.clip(probabilities, _MIN_PROBABILITY, 1 - _MIN_PROBABILITY)
    )
    return quantiles


_QUANTILE_FUNCTIONS: Mapping[str, Callable[[float, float, Array], Array]] = {
    "uniform": lambda low, high, probability: low + (high - low) * probability,
    "log_uniform": lambda low, high, probability: low * (high / low) ** probability,
    "normal": _evaluate_normal,
}
"""Quantile function of each distribution: {kind: function of two parameters and probabilities}."""


@dataclass(frozen=True)
class Variable:
    """Values of a variable of a study: a list, or a distribution.

    Attributes:
        kind: ``values`` (all equally likely), ``linspace``, ``motors``, or a distribution:
            ``uniform`` or ``log_uniform`` with lower and upper bound, ``normal`` with mean and
            standard deviation.
        numbers: Parameters, as in the study file. For motors, the codes (`encode_motor`).
        labels: Names of motors, as in the study file; empty for other kinds.
    """

    kind: str
    numbers: tuple[float, ...]
    labels: tuple[str, ...] = ()

    @property
    def levels(self) -> tuple[float, ...] | None:
        """Values of a study variable with a list or ``linspace``; None for a distribution."""
        if self.kind == "linspace":
            low, high, count = self.numbers
            return tuple(np.linspace(low, high, int(count)).tolist())
        return self.numbers if self.kind in ("values", "motors") else None

    @property
    def range(self) -> tuple[float, float]:
        """Smallest and largest value of a study variable; infinite for a normal distribution."""
        if self.kind == "normal":
            return -math.inf, math.inf
        listed = self.levels or self.numbers
        return min(listed), max(listed)

    def at(self, probabilities: Array) -> Array:
        """Map probabilities to values of a study variable: evaluate the quantile function.

        For a list, all values are equally likely.

        Args:
            probabilities: Numbers between 0 and 1, shape (n,).

        Returns:
            Values, shape (n,), in the unit of the variable.
        """
        if self.levels is None:
            return _QUANTILE_FUNCTIONS[self.kind](self.numbers[0], self.numbers[1], probabilities)
        index = np.minimum((probabilities * len(self.levels)).astype(int), len(self.levels) - 1)
        quantiles: Array = np.array(self.levels)[index]
        return quantiles

    def to_dict(self) -> dict[str, Any]:
        """Return a study variable as in a study file: {kind: parameters}.

        Motors are {"motors": {name: code}}, so that a table can be read without motor files.
        """
        if self.labels:
            return {self.kind: dict(zip(self.labels, self.numbers, strict=True))}
        return {self.kind: list(self.numbers)}

    def code_of(self, value: Any) -> float:
        """Convert a value of a study variable to the stored number, for motors the code."""
        if isinstance(value, str):
            return self.numbers[self.labels.index(value)]
        return float(value)

    def name_values(self, column: pd.Series[Any]) -> pd.Series[Any]:
        """Replace motor numbers in a column by motor names; columns of other variables are kept."""
        if not self.labels:
            return column
        return column.map(dict(zip(self.numbers, self.labels, strict=True)))


MAX_LEVELS = 1_000_000
"""Maximum number of values of a variable; a longer list is refused. Chosen, not tuned."""


def linspace(low: float, high: float, count: int) -> Variable:
    """Create a variable of a study with evenly spaced values, in the unit of the variable.

    Args:
        low: First value.
        high: Last value, above `low`.
        count: Number of values, 2 to `MAX_LEVELS`.

    Raises:
        ConfigurationError: If the interval is empty, a bound is not finite, or the count is no
            integer or out of range.
    """
    first, last = _check_interval("linspace", low, high)
    check_type("count", count, int)
    if not 2 <= count <= MAX_LEVELS:
        problem = diagnose(
            "levels-out-of-range", count=count, low=first, high=last, most=MAX_LEVELS
        )
        raise ConfigurationError("linspace", problem)
    return Variable("linspace", (first, last, int(count)))


def values(numbers: Sequence[float]) -> Variable:
    """Create a variable of a study that takes the values of a list, in the unit of the variable.

    Raises:
        ConfigurationError: If ``numbers`` is empty, or a value is not finite or occurs twice, for
            example.
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
    """Create a variable of a study that is distributed uniformly between two bounds.

    The bounds are in the unit of the variable.

    Raises:
        ConfigurationError: If the interval is empty, or a bound is not finite.
    """
    return Variable("uniform", _check_interval("uniform", low, high))


def log_uniform(low: float, high: float) -> Variable:
    """Create a variable of a study whose logarithm is distributed uniformly.

    The bounds ``low`` and ``high`` are in the unit of the variable.

    Raises:
        ConfigurationError: If the interval is empty, a bound is not finite, or the lower bound is
            not positive.
    """
    first, last = _check_interval("log_uniform", low, high)
    if first <= 0:
        raise ConfigurationError("log_uniform", diagnose("logarithm-of-negative", low=first))
    return Variable("log_uniform", (first, last))


def normal(mean: float, deviation: float) -> Variable:
    """Create a variable of a study with a normal distribution.

    Args:
        mean: Mean, in the unit of the variable.
        deviation: Standard deviation, in the unit of the variable.

    Raises:
        ConfigurationError: If the standard deviation is not positive, or an argument is not a
            finite number.
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
"""{kind of a variable in a study file: function that creates the variable from parameters}."""


def make_variable(name: str, requested: object) -> Variable:
    """Create a study variable from a number, a list, {kind: parameters}, or a variable.

    Args:
        name: Name of the variable, for messages.
        requested: Value from the study.

    Raises:
        ConfigurationError: If the value has another form, or the parameters are not valid.
    """
    try:
        if isinstance(requested, Variable):
            return requested
        if isinstance(requested, Mapping):
            ((kind, numbers),) = requested.items() if len(requested) == 1 else (("", ()),)
            if kind == "grid":
                raise ConfigurationError("grid", _diagnose_grid(numbers))
            if kind == "motors" and isinstance(numbers, Mapping) and numbers:
                codes = tuple(check_finite(f"code of {motor}", numbers[motor]) for motor in numbers)
                return Variable(kind, codes, tuple(numbers))
            if (
                kind not in VARIABLE_MAKERS
                or not isinstance(numbers, Sequence)
                or isinstance(numbers, str)
            ):
                finding = diagnose(
                    "no-kind-of-variable", given=repr(dict(requested)), known=VARIABLE_MAKERS
                )
                raise ConfigurationError("kind", finding)
            return VARIABLE_MAKERS[kind](*numbers)
        if isinstance(requested, Sequence | np.ndarray):
            return values(requested)  # type: ignore[arg-type]
        return values([requested])  # type: ignore[list-item]
    except ConfigurationError as error:
        raise ConfigurationError(f"vary[{name!r}]", error.diagnostic) from error
    except TypeError as error:
        problem = diagnose("numbers-of-variable", given=repr(requested))
        raise ConfigurationError(f"vary[{name!r}]", problem) from error


def _diagnose_grid(numbers: Any) -> Diagnostic:
    """Return the message for a variable ``{grid: numbers}``, a form that does not exist."""
    listed = ", ".join(map(str, numbers)) if isinstance(numbers, list | tuple) else str(numbers)
    return diagnose("grid-is-ambiguous", listed=listed)


def _check_interval(name: str, low: float, high: float) -> tuple[float, float]:
    """Return both bounds as floats; refuse bounds that are not finite or not ascending."""
    first, last = check_finite(name, low), check_finite(name, high)
    if not first < last:
        raise ConfigurationError(name, diagnose("interval-empty", low=first, high=last))
    return first, last


# Designs of a study: product of lists, or Sobol sequence.


BLOCK_SIZE = 4096
"""Number of designs that `Sampling.blocks` generates at once, to bound the memory. The number is a
power of 2, because the points of a Sobol sequence are balanced in groups of 2^k. Chosen, not tuned.
"""

MAX_SAMPLES = 2**30
"""Maximum number of samples: the length of scipy's Sobol sequence with 30 bits."""


@dataclass(frozen=True)
class Sampling:
    """Generator of the designs of a study, block by block, so that memory use is bounded.

    If all variables are lists, the designs are the product of the lists; the last variable changes
    fastest. If a variable has a distribution, the designs are a scrambled Sobol sequence. The first
    n samples do not depend on the number of samples. Therefore a study can be extended.

    Source: Sobol, "On the distribution of points in a cube", 1967; Owen's scrambling (scipy.stats).

    Attributes:
        variables: {name: variable}.
        samples: Number of samples of the sequence; None for a product.
        seed: Seed of the scrambling.
    """

    variables: Mapping[str, Variable]
    samples: int | None
    seed: int

    def __post_init__(self) -> None:
        continuous = [name for name, variable in self.variables.items() if variable.levels is None]
        if continuous and self.samples is None:
            raise ConfigurationError("samples", diagnose("samples-missing", name=continuous[0]))
        if not continuous and self.samples is not None:
            finding = diagnose("samples-of-lists", product=self.product)
            raise ConfigurationError("samples", finding)
        if self.samples is not None and not 1 <= self.samples <= MAX_SAMPLES:
            finding = diagnose("count-not-from-to", count=self.samples, least=1, most=MAX_SAMPLES)
            raise ConfigurationError("samples", finding)
        if not 0 <= self.seed < 2**63:
            raise ConfigurationError("seed", diagnose("seed-out-of-range", seed=self.seed))

    @property
    def product(self) -> int:
        """Number of designs in the full grid of variables; 0 if a variable is a distribution."""
        return math.prod(len(variable.levels or ()) for variable in self.variables.values())

    def __len__(self) -> int:
        return self.product if self.samples is None else self.samples

    def blocks(self) -> Iterator[Array]:
        """Yield the variable values of the designs in blocks, shape (n, variables)."""
        columns = list(self.variables.values())
        if self.samples is None:
            levels = [np.array(column.levels or ()) for column in columns]
            sizes = [len(level_values) for level_values in levels]
            for start in range(0, self.product, BLOCK_SIZE):
                numbers = np.arange(start, min(start + BLOCK_SIZE, self.product))
                index = np.unravel_index(numbers, sizes) if sizes else ()
                block = np.zeros((len(numbers), len(columns)))
                for column_index, (level_values, level_index) in enumerate(
                    zip(levels, index, strict=True)
                ):
                    block[:, column_index] = level_values[level_index]
                yield block
            return
        from scipy.stats import qmc

        sequence = qmc.Sobol(len(columns), scramble=True, rng=np.random.default_rng(self.seed))
        for start in range(0, self.samples, BLOCK_SIZE):
            probabilities = sequence.random(BLOCK_SIZE)[: self.samples - start]
            yield np.column_stack(
                [
                    variable.at(probability)
                    for variable, probability in zip(columns, probabilities.T, strict=True)
                ]
            )
