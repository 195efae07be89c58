"""Measured torques as a least-squares problem, whose noise has a memory and is of all joints."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from pupper_analysis.identification.estimate import Linearised, Posterior, estimate_parameters
from pupper_analysis.identification.noise import SeriesNoise, root_mean_square
from pupper_analysis.identification.parameters import ParameterTable
from pupper_analysis.identification.torques.blocks import MeasuredTorques
from pupper_analysis.identification.torques.couplings import Coupling
from pupper_analysis.identification.torques.equations import TorqueEquations
from pupper_analysis.identification.torques.moments import SecondMoments
from pupper_analysis.robot.robot import Robot

Array = NDArray[np.float64]

_ROUNDS = 6
"""Of fits, each with the noise that the one before has left."""

_SAME_NOISE = 0.02
"""Of deviations: noise that changes by no more changes no interval that is shown."""


_GAIN = 0.1
"""What is known of a torque's gain before: motors' currents by a constant of a data sheet."""

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

    def _linear(self, moments: SecondMoments, y: Array) -> tuple[list[Array], list[Array]]:
        """Returns predicted less measured torques that are fitted, and their derivatives.

        Args:
            moments: What the parameters are made of.
            y: (n,) of these.

        Returns:
            Of each run (blocks, joints) and (blocks, joints, n).
        """
        table, inside = moments.table, moments.with_least_masses(y)
        numbers, by_parameters = self.equations.numbers(table, moments.to_parameters(inside))
        slopes = by_parameters @ moments.derivative(inside)
        numbers = numbers + slopes @ (y - inside)  # they are linear
        place, off, by_moments = table.place("lag", TORQUES), [], []
        for run, matrix, rate, torque in zip(
            self.measured.runs, self._at(table, y), self.rates, self.torques, strict=True
        ):
            off.append(np.where(run.held_out[:, None], np.nan, matrix @ numbers - torque))
            by_moments.append(matrix @ slopes)
            if place is not None:
                by_moments[-1][:, :, place] = -rate @ numbers
        return off, by_moments

    def fit(self, table: ParameterTable, start: Array | None = None) -> Posterior:
        """Returns the parameters, with the covariance that the noise's memory makes.

        Steps are in moments, of which torques are linear. Each joint counts by its noise's
        long-run deviation, as in fits of motions; the covariance is that of such an estimate
        ("sandwich"). What encoders' noise makes of accelerations is in the torques of several
        joints, so that their innovations belong together.

        Args:
            table: The parameters.
            start: To begin with; the stated values by default.

        Raises:
            FitError: If it does not converge.
        """
        moments = SecondMoments(table, self.equations.mass)
        y = moments.of_parameters(table.stated if start is None else start)
        noise: list[SeriesNoise] = []
        left, _ = self._linear(moments, y)
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
            linearise = self._linearise(moments, noise)
            posterior = estimate_parameters(table, linearise, y)
            y = posterior.mean
            left, _ = self._linear(moments, y)
        return self._with_memory(moments, posterior, noise)

    def find_gains(self, posterior: Posterior) -> tuple[Array, Array]:
        """Returns how many times its size each joint's torque is told, beside the others'.

        Links' weights are in the torques of several joints. So, had each sensor a gain of its own,
        which no parameter is, measurements would tell it but for one that all have in common.

        Args:
            posterior: What is known of parameters, if all gains are 1.

        Returns:
            The gains (joints,), those of the others being 1 on average, and standard deviations.
        """
        table = ParameterTable(posterior.parameters)
        moments = SecondMoments(table, self.equations.mass)
        y = moments.of_parameters(posterior.mean)
        left, slopes = self._linear(moments, y)
        joints = left[0].shape[1]
        sizes = [SeriesNoise.of([one[:, at] for one in left]).long_run for at in range(joints)]
        z = (y - table.stated) / table.width
        whole = np.zeros((len(table) + joints, len(table) + joints))
        downhill = np.zeros(len(whole))
        whole[:-joints, :-joints] = table.precision
        downhill[:-joints] = -table.precision @ z
        whole[-joints:, -joints:] = np.eye(joints) / _GAIN**2
        for off, by_moments, torque in zip(left, slopes, self.torques, strict=True):
            for at, size in enumerate(sizes):
                told = np.isfinite(off[:, at])
                rows = np.zeros((int(told.sum()), len(whole)))
                rows[:, :-joints] = by_moments[told, at] * table.width
                rows[:, len(table) + at] = (off + torque)[told, at]
                whole += rows.T @ rows / size**2
                downhill -= rows.T @ off[told, at] / size**2
        covariance = np.linalg.inv(whole)
        beside = np.eye(joints) - (1 - np.eye(joints)) / max(joints - 1, 1)
        gains = beside @ (covariance @ downhill)[-joints:]
        spread: Array = np.sqrt(np.diag(beside @ covariance[-joints:, -joints:] @ beside.T))
        return 1 + gains, spread

    def _linearise(
        self, moments: SecondMoments, noise: Sequence[SeriesNoise]
    ) -> Callable[[Array, Array], Linearised]:
        """Returns what whitens torques of moments by each joint's noise."""
        sizes = np.array([one.long_run for one in noise])

        def linearise(y: Array, _about: Array) -> Linearised:
            off, slopes = self._linear(moments, y)
            left, rows = np.concatenate(off) / sizes, np.concatenate(slopes) / sizes[:, None]
            counted = np.isfinite(left)
            return Linearised.of(left[counted], rows[counted])

        return linearise

    def _with_memory(
        self,
        moments: SecondMoments,
        posterior: Posterior,
        noise: Sequence[SeriesNoise],
    ) -> Posterior:
        """Returns what is known of parameters, with the covariance that the noise's memory makes.

        What is known of moments is what ``posterior`` says.
        """
        width, size = moments.table.width, len(moments.table)
        left, by_moments = self._linear(moments, posterior.mean)
        correlation = innovations_together(noise, left)
        spread = np.zeros((size, size))
        for off, slopes in zip(left, by_moments, strict=True):
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
        inside = moments.with_least_masses(posterior.mean)
        bends = moments.bends(inside, (covariance + covariance.T) / 2)
        return moments.of_posterior(posterior, inside, covariance, bends)


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
