"""Coordinates of parameters in which torques are linear: first and second moments."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.arrays import inertia_entries
from pupper_analysis.identification.links import AXES
from pupper_analysis.identification.moments import LEAST_MASS, Moments
from pupper_analysis.identification.parameters import ParameterTable
from pupper_analysis.identification.torques.equations import ENTRIES

Array = NDArray[np.float64]

_DRAWS = 200
"""Pairs: what bends adds to a deviation is known to a twentieth."""


class SecondMoments(Moments):
    """A vector of parameters by first and second moments, and back.

    Torques are linear in m, m c and the inertia about a fixed point. In place of a com c there
    stands c0 + e, with e = (m / m0) (c - c0), as in ``Moments``; and in place of an inertia I about
    c the part of that about c0 in which e is not linear, I + (m0^2 / m) (e.e 1 - e e^T). In these
    a fit is one step, however little is known of masses.

    Args:
        table: The parameters.
        masses: {link: kg}, the stated masses.

    Attributes:
        table: The parameters.
    """

    def __init__(self, table: ParameterTable, masses: Mapping[str, float]) -> None:
        super().__init__(table)
        self.table, self._kg = table, dict(masses)

    def with_least_masses(self, moments: Array) -> Array:
        """Returns moments (n,) whose masses are none of nothing."""
        found = moments.copy()
        for link, stated in self._kg.items():
            place = self.table.place("mass", link)
            if place is not None:
                found[place] = max(found[place], LEAST_MASS * stated)
        return found

    def to_parameters(self, moments: Array) -> Array:
        """Returns parameters (n,) of moments (n,)."""
        found = super().to_parameters(moments)
        for places, moved, _ in self._moved(moments):
            found[places] -= moved
        return found

    def of_parameters(self, vector: Array) -> Array:
        """Returns moments (n,) of parameters (n,)."""
        found = super().of_parameters(vector)
        for places, moved, _ in self._moved(found):
            found[places] += moved
        return found

    def derivative(self, moments: Array) -> Array:
        """Returns how parameters change with moments (n, n)."""
        found = super().derivative(moments)
        for places, _, slopes in self._moved(moments):
            for place, slope in slopes.items():
                found[places, place] -= slope
        return found

    def bends(self, mean: Array, covariance: Array) -> Array:
        """Returns how far parameters are from where straight lines lead (draws, n), in widths.

        Of moments that are drawn as they are known: a com is its moment by a mass, which makes the
        farther end of its interval far where the mass may be small. No draw counts for more than
        what was known before.

        Args:
            mean: (n,) moments.
            covariance: (n, n) of these, in the priors' widths.
        """
        width = self.table.width
        random = np.random.default_rng(0)
        # Rounding makes what is known best negative by less than it is of what is known least.
        drawn = random.multivariate_normal(
            np.zeros(len(mean)), covariance, _DRAWS, check_valid="ignore", method="eigh"
        )
        drawn = np.concatenate([drawn, -drawn])
        best = self.to_parameters(mean)
        ends = [self.to_parameters(self.with_least_masses(one)) for one in mean + width * drawn]
        off = (np.array(ends) - best) / width
        straight = drawn @ (self.derivative(mean) * width / width[:, None]).T
        bent: Array = np.clip(off - straight, -1, 1)
        return bent

    def _moved(self, moments: Array) -> Iterator[tuple[list[int], Array, dict[int, Array]]]:
        """Yields where inertias stand, what is added to them, and its derivatives by place."""
        for link, stated in self._kg.items():
            places = [self.table.place("inertia", link, entry) for entry in ENTRIES]
            told = [at for at, place in enumerate(places) if place is not None]
            if not told:
                continue
            off, units = np.zeros(3), {}
            for axis, unit in zip(AXES, np.eye(3), strict=True):
                place = self.table.place("com", link, axis)
                if place is not None:
                    off += (moments[place] - self.table.stated[place]) * unit
                    units[place] = unit
            mass = self.table.place("mass", link)
            kg = stated if mass is None else max(float(moments[mass]), LEAST_MASS * stated)
            share = stated**2 / kg
            moved = share * _about(off, off)[told]
            slopes = {place: 2 * share * _about(off, unit)[told] for place, unit in units.items()}
            if mass is not None:
                slopes[mass] = -moved / kg
            yield [place for place in places if place is not None], moved, slopes


def _about(one: Array, other: Array) -> Array:
    """Returns the entries (6,) of the symmetrical part of a.b 1 - a b^T."""
    outer = np.outer(one, other)
    return inertia_entries((one @ other) * np.eye(3) - (outer + outer.T) / 2)
