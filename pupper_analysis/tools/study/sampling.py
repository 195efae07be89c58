"""Which designs a study has: the product of lists, Sobol's sequence, or Saltelli's scheme."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.tools.study.variables import Variable

Array = NDArray[np.float64]

BLOCK = 4096
"""Designs that are made at a time: a power of 2, as Sobol's sequence is even over such."""

MOST_SAMPLES = 2**30
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
            told = diagnose("samples-of-lists", product=self.product)
            raise ConfigurationError("samples", told)
        if self.samples is not None and not 1 <= self.samples <= MOST_SAMPLES:
            told = diagnose("count-not-from-to", count=self.samples, least=1, most=MOST_SAMPLES)
            raise ConfigurationError("samples", told)
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
            sizes = [len(column.levels or ()) for column in columns]
            for start in range(0, self.product, BLOCK):
                numbers = np.arange(start, min(start + BLOCK, self.product))
                index = np.unravel_index(numbers, sizes) if sizes else ()
                block = np.zeros((len(numbers), len(columns)))
                for place, (column, at) in enumerate(zip(columns, index, strict=True)):
                    block[:, place] = np.array(column.levels)[at]
                yield block
            return
        from scipy.stats import qmc

        sequence = qmc.Sobol(len(columns), scramble=True, rng=np.random.default_rng(self.seed))
        for start in range(0, self.samples, BLOCK):
            shares = sequence.random(BLOCK)[: self.samples - start]
            yield at_shares(self.variables, shares)


def at_shares(variables: Mapping[str, Variable], shares: Array) -> Array:
    """Returns the designs (n, variables) at shares (n, variables) of each distribution."""
    columns = [one.at(share) for one, share in zip(variables.values(), shares.T, strict=True)]
    return np.column_stack(columns)
