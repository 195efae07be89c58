"""Coordinates of parameters in which forces are linear: first moments in place of coms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.tools.fit.estimate import Posterior
from pupper_analysis.tools.fit.links import AXES
from pupper_analysis.tools.fit.parameters import ParameterTable

Array = NDArray[np.float64]

LEAST_MASS = 0.01
"""Of the stated mass: a lighter body's com is anywhere, and no simulation is of use."""


class Moments:
    """A vector of parameters by first moments, and back.

    Gravity and inertia act by m and m c. A step that is good in them is none in m and c, as
    d(m c) = m dc + c dm + dm dc: where mass and com of a link are told by their product alone, and
    each to no better than the prior, the last term was 20 standard deviations of what was measured.

    In place of a com c there stands c0 + (m / m0) (c - c0), c0 and m0 being the stated ones: a
    length, the com itself at the stated mass, and linear in the moment and the mass. Its prior is
    the com's.

    Args:
        table: The parameters.
    """

    def __init__(self, table: ParameterTable) -> None:
        pairs = []
        for place, one in enumerate(table):
            mass = table.place("mass", one.subject) if one.kind == "com" else None
            if mass is not None and one.component in AXES:
                pairs.append((place, mass))
        self._coms, self._masses = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
        self._stated_com, self._stated_mass = table.stated[self._coms], table.stated[self._masses]

    def _lightness(self, vector: Array) -> Array:
        """Returns m0 / m of each com."""
        least = LEAST_MASS * self._stated_mass
        found: Array = self._stated_mass / np.maximum(vector[self._masses], least)
        return found

    def to_parameters(self, moments: Array) -> Array:
        """Returns parameters (n,) of moments (n,)."""
        found = moments.copy()
        off = moments[self._coms] - self._stated_com
        found[self._coms] = self._stated_com + self._lightness(moments) * off
        return found

    def of_parameters(self, vector: Array) -> Array:
        """Returns moments (n,) of parameters (n,)."""
        found = vector.copy()
        off = vector[self._coms] - self._stated_com
        found[self._coms] = self._stated_com + off / self._lightness(vector)
        return found

    def derivative(self, moments: Array) -> Array:
        """Returns how parameters change with moments (n, n)."""
        found, lightness = np.eye(len(moments)), self._lightness(moments)
        off = moments[self._coms] - self._stated_com
        found[self._coms, self._coms] = lightness
        found[self._coms, self._masses] = -(lightness**2) * off / self._stated_mass
        return found

    def of_posterior(
        self, posterior: Posterior, moments: Array, covariance: Array, bends: Array
    ) -> Posterior:
        """Returns what is known of parameters, of what is known of moments.

        Args:
            posterior: Of moments.
            moments: (n,) where these are taken to be.
            covariance: (n, n) of them, in the priors' widths.
            bends: (draws, n) how far parameters are from where straight lines lead, likewise.
        """
        width = np.array([one.width for one in posterior.parameters])
        turn = self.derivative(moments) * width / width[:, None]
        back, step = np.linalg.inv(turn), posterior.open_step
        covariance = turn @ covariance @ turn.T + bends.T @ bends / len(bends)
        covariance = (covariance + covariance.T) / 2
        return replace(
            posterior,
            mean=self.to_parameters(moments),
            covariance=width[:, None] * covariance * width,
            information=back.T @ posterior.information @ back,
            precision=back.T @ posterior.precision @ back,
            open_step=None if step is None else width * (turn @ (step / width)),
        )
