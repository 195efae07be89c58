"""Measured torques as a least-squares problem, whose noise has a memory and is of all joints."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from pupper_analysis.identification.estimate import Linearised, Posterior, estimate_parameters
from pupper_analysis.identification.motions.residuals import root_mean_square
from pupper_analysis.identification.noise import SeriesNoise
from pupper_analysis.identification.parameters import ParameterTable
from pupper_analysis.identification.torques.blocks import MeasuredTorques
from pupper_analysis.identification.torques.couplings import Coupling
from pupper_analysis.identification.torques.equations import TorqueEquations
from pupper_analysis.robot.robot import Robot

Array = NDArray[np.float64]

_ROUNDS = 6
"""Of fits, each with the noise that the one before has left."""

_ROUGH = 1e-5
"""Of each equation's cost: a tenth of a standard deviation where there are a thousand. Where they
are not explained, steps in masses and coms, which act by their product, get slow before."""

_SAME_NOISE = 0.02
"""Of deviations: noise that changes by no more changes no interval that is shown."""


TORQUES = "torques"
"""Subject of the lag of torques behind positions: one for all of them."""


@dataclass(frozen=True, eq=False)
class Torques:
    """Measured torques of some runs, and what they are linear in.

    What is told at a moment is the torque of the motion before, by a lag: that is taken to be the
    torque of the motion as it was taken, less its change in the time in which the lag is longer.

    Attributes:
        equations: How.
        measured: What was measured.
        matrices: Of each run (blocks, joints, numbers).
        rates: How these change (1/s).
        torques: Of each run (blocks, joints) (N m, N).
    """

    equations: TorqueEquations
    measured: MeasuredTorques
    matrices: tuple[Array, ...]
    rates: tuple[Array, ...]
    torques: tuple[Array, ...]

    @staticmethod
    def of(robot: Robot, measured: MeasuredTorques, couplings: Sequence[Coupling] = ()) -> Torques:
        """Returns the equations of what was measured."""
        joints = list(measured.bands)
        equations = TorqueEquations(robot, joints, couplings)
        matrices, rates = zip(*(equations.regressor(run) for run in measured.runs), strict=True)
        torques = tuple(run.torque[:, joints] for run in measured.runs)
        return Torques(equations, measured, matrices, rates, torques)

    def predicted(self, table: ParameterTable, x: Array) -> list[Array]:
        """Returns torques (blocks, joints) of each run that parameters predict (N m, N)."""
        numbers, _ = self.equations.numbers(table, x)
        return [matrix @ numbers for matrix in self._at(table, x)]

    def off(self, table: ParameterTable, x: Array, *, held_out: bool) -> list[Array]:
        """Returns predicted less measured torques (blocks, joints) of each run; NaN of others."""
        return [
            np.where((run.held_out == held_out)[:, None], predicted - torque, np.nan)
            for run, predicted, torque in zip(
                self.measured.runs, self.predicted(table, x), self.torques, strict=True
            )
        ]

    def _at(self, table: ParameterTable, x: Array) -> list[Array]:
        """Returns what torques are linear in, at a lag."""
        longer = table.value(x, "lag", TORQUES, "", 0.0) - self.measured.lag
        return [
            matrix - longer * rate for matrix, rate in zip(self.matrices, self.rates, strict=True)
        ]

    def _slopes(self, table: ParameterTable, x: Array) -> list[Array]:
        """Returns how predicted torques change with parameters (blocks, joints, parameters)."""
        numbers, slopes = self.equations.numbers(table, x)
        found = [matrix @ slopes for matrix in self._at(table, x)]
        place = table.place("lag", TORQUES)
        if place is not None:
            for one, rate in zip(found, self.rates, strict=True):
                one[:, :, place] = -rate @ numbers
        return found

    def fit(self, table: ParameterTable, start: Array | None = None) -> Posterior:
        """Returns the parameters, with the covariance that the noise's memory makes.

        Each joint counts by its noise's long-run deviation, as in fits of motions; the covariance
        is that of such an estimate ("sandwich"). What encoders' noise makes of accelerations is in
        the torques of several joints, so that their innovations belong together.

        Args:
            table: The parameters.
            start: To begin with; the stated values by default.

        Raises:
            FitError: If it does not converge.
        """
        x = table.stated.copy() if start is None else start
        noise: list[SeriesNoise] = []
        left = self.off(table, x, held_out=False)
        for turn in range(_ROUNDS):
            before = noise
            noise = [
                # At first without memory, as what is left is no noise yet.
                SeriesNoise.of([one[:, at] for one in left])
                if turn
                else SeriesNoise.white(root_mean_square(one[:, at] for one in left))
                for at in range(len(self.equations.joints))
            ]
            if turn > 1 and all(
                abs(one.long_run / other.long_run - 1) < _SAME_NOISE
                for one, other in zip(noise, before, strict=True)
            ):
                break
            posterior = estimate_parameters(
                table,
                self._linearise(table, noise),
                x,
                enough=_ROUGH * sum(int(np.isfinite(one).sum()) for one in left),
            )
            x = posterior.mean
            left = self.off(table, x, held_out=False)
        return self._with_memory(table, posterior, noise, left)

    def _linearise(
        self, table: ParameterTable, noise: Sequence[SeriesNoise]
    ) -> Callable[[Array, Array], Linearised]:
        """Returns what whitens torques by each joint's noise."""
        sizes = np.array([one.long_run for one in noise])

        def linearise(x: Array, _about: Array) -> Linearised:
            left = np.concatenate(self.off(table, x, held_out=False)) / sizes
            rows = np.concatenate(self._slopes(table, x)) / sizes[:, None]
            counted = np.isfinite(left)
            return Linearised.of(left[counted], rows[counted])

        return linearise

    def _with_memory(
        self,
        table: ParameterTable,
        posterior: Posterior,
        noise: Sequence[SeriesNoise],
        left: Sequence[Array],
    ) -> Posterior:
        """Returns the same with the covariance that the noise makes, by its memory."""
        width = table.width
        correlation = innovations_together(noise, left)
        spread = np.zeros((len(table), len(table)))
        for off, slopes in zip(left, self._slopes(table, posterior.mean), strict=True):
            counted = np.isfinite(off)
            backs = [
                one.spread(np.where(counted[:, at, None], slopes[:, at], 0.0)) / one.long_run**2
                for at, one in enumerate(noise)
            ]
            for at, one in enumerate(backs):
                for beside, other in enumerate(backs):
                    spread += correlation[at, beside] * one @ other.T
        narrow = np.linalg.inv(posterior.information + posterior.precision)
        spread *= posterior.rows / max(posterior.freedom, 1.0)  # what parameters took of the noise
        spread = width[:, None] * spread * width + posterior.precision
        covariance = narrow @ spread @ narrow
        covariance = (covariance + covariance.T) / 2
        return replace(posterior, covariance=width[:, None] * covariance * width)


def innovations_together(noise: Sequence[SeriesNoise], left: Sequence[Array]) -> Array:
    """Returns the correlation (joints, joints) of what is new in each joint's noise."""
    news = []
    for off in left:
        filled = np.where(np.isfinite(off), off, 0.0)
        news.append(
            np.column_stack(
                [
                    lfilter(np.r_[1.0, -one.coefficients], [1.0], column)
                    for one, column in zip(noise, filled.T, strict=True)
                ]
            )
        )
    moments = sum((one.T @ one for one in news), np.zeros((len(noise), len(noise))))
    sizes = np.sqrt(np.maximum(np.diag(moments), np.finfo(float).tiny))
    found: Array = moments / np.outer(sizes, sizes)
    np.fill_diagonal(found, 1.0)
    return found
