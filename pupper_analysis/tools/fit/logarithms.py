"""Coordinates of parameters in which what is known before is normal: logarithms of what scales."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.tools.fit.estimate import Linearised, Posterior
from pupper_analysis.tools.fit.parameters import KINDS, ParameterTable

Array = NDArray[np.float64]


class Logarithms:
    """A vector of parameters by logarithms of masses and stiffness, and back.

    Stands tell kp and masses by their ratio. Were each normal, all smaller together would be more
    probable than all larger: twelve kp that differ by a tenth differ by less if all are halved, and
    the most probable robot was 13 % too light. Factors are as probable either way.

    In place of x there stands x0 + x0 log(x / x0), x0 being the stated value: in the parameter's
    unit, the same near x0, and with the same width before.

    Args:
        table: The parameters.

    Attributes:
        least: (n,) below which coordinates mean nothing.
    """

    def __init__(self, table: ParameterTable) -> None:
        kinds = [KINDS[one.kind] for one in table]
        self._factors = np.array([kind.factor for kind in kinds], dtype=bool)
        self._stated = table.stated
        above = np.array([kind.positive for kind in kinds], dtype=bool) & ~self._factors
        self.least: Array = np.where(above, 0.0, -np.inf)

    def to_parameters(self, logarithms: Array) -> Array:
        """Returns parameters (n,) of coordinates (n,)."""
        return np.where(self._factors, self._stated * self.rates(logarithms), logarithms)

    def of_parameters(self, vector: Array) -> Array:
        """Returns coordinates (n,) of parameters (n,)."""
        found, stated = vector.copy(), self._stated[self._factors]
        found[self._factors] = stated * (1 + np.log(vector[self._factors] / stated))
        return found

    def rates(self, logarithms: Array) -> Array:
        """Returns how fast parameters change with coordinates (n,): x / x0 of what scales."""
        found = np.ones(len(logarithms))
        stated = self._stated[self._factors]
        found[self._factors] = np.exp(logarithms[self._factors] / stated - 1)
        return found

    def linearise(self, told: Linearised, logarithms: Array) -> Linearised:
        """Returns measurements about coordinates, of those about the parameters that they are."""
        rates = self.rates(logarithms)
        information = rates[:, None] * told.information * rates
        return replace(told, information=information, gradient=rates * told.gradient)

    def of_posterior(self, posterior: Posterior) -> Posterior:
        """Returns what is known of parameters, as it is of coordinates, linear about the best.

        What was known before is as wide as it is there: of a robot twice as heavy, twice as wide.
        """
        rates, step = self.rates(posterior.mean), posterior.open_step
        return replace(
            posterior,
            parameters=tuple(
                replace(one, width=float(rate) * one.width)
                for one, rate in zip(posterior.parameters, rates, strict=True)
            ),
            mean=self.to_parameters(posterior.mean),
            covariance=rates[:, None] * posterior.covariance * rates,
            open_step=None if step is None else rates * step,
        )
