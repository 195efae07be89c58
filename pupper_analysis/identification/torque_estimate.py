"""Measured torques as a least-squares problem, whose noise has a memory and is of all joints."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from pupper_analysis.identification.couplings import Coupling
from pupper_analysis.identification.estimate import Linearised, Posterior, estimate_parameters
from pupper_analysis.identification.noise import SeriesNoise
from pupper_analysis.identification.parameters import ParameterTable
from pupper_analysis.identification.residuals import root_mean_square
from pupper_analysis.identification.torque_blocks import MeasuredTorques
from pupper_analysis.identification.torque_equations import TorqueEquations
from pupper_analysis.robot.robot import Robot

Array = NDArray[np.float64]

_ROUNDS = 6
"""Of fits, each with the noise that the one before has left."""

_ROUGH = 1e-5
"""Of each equation's cost: a tenth of a standard deviation where there are a thousand. Where they
are not explained, steps in masses and coms, which act by their product, get slow before."""

_SAME_NOISE = 0.02
"""Of deviations: noise that changes by no more changes no interval that is shown."""


@dataclass(frozen=True, eq=False)
class Torques:
    """Measured torques of some runs, and what they are linear in.

    Attributes:
        equations: How.
        measured: What was measured.
        matrices: Of each run (blocks, joints, numbers).
        torques: Of each run (blocks, joints), less those of bodies that are known (N m, N).
    """

    equations: TorqueEquations
    measured: MeasuredTorques
    matrices: tuple[Array, ...]
    torques: tuple[Array, ...]

    @staticmethod
    def of(robot: Robot, measured: MeasuredTorques, couplings: Sequence[Coupling] = ()) -> Torques:
        """Returns the equations of what was measured."""
        joints = list(measured.bands)
        equations = TorqueEquations(robot, joints, couplings)
        matrices, torques = [], []
        for run in measured.runs:
            matrix, rest = equations.regressor(run)
            matrices.append(matrix)
            torques.append(run.torque[:, joints] - rest)
        return Torques(equations, measured, tuple(matrices), tuple(torques))

    def off(self, numbers: Array, *, held_out: bool) -> list[Array]:
        """Returns predicted less measured torques (blocks, joints) of each run; NaN of others."""
        return [
            np.where((run.held_out == held_out)[:, None], matrix @ numbers - torque, np.nan)
            for run, matrix, torque in zip(
                self.measured.runs, self.matrices, self.torques, strict=True
            )
        ]

    def fit(self, table: ParameterTable) -> Posterior:
        """Returns the parameters, with the covariance that the noise's memory makes.

        Each joint counts by its noise's long-run deviation, as in fits of motions; the covariance
        is that of such an estimate ("sandwich"). What encoders' noise makes of accelerations is in
        the torques of several joints, so that their innovations belong together.

        Args:
            table: The parameters.

        Raises:
            FitError: If it does not converge.
        """
        x = table.stated.copy()
        noise: list[SeriesNoise] = []
        left = self.off(self.equations.numbers(table, x)[0], held_out=False)
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
            left = self.off(self.equations.numbers(table, x)[0], held_out=False)
        return self._with_memory(table, posterior, noise, left)

    def _linearise(
        self, table: ParameterTable, noise: Sequence[SeriesNoise]
    ) -> Callable[[Array, Array], Linearised]:
        """Returns what whitens torques by each joint's noise."""
        rows: list[Array] = []
        asked: list[Array] = []
        for run, matrix, torque in zip(
            self.measured.runs, self.matrices, self.torques, strict=True
        ):
            for at, one in enumerate(noise):
                counted = np.isfinite(torque[:, at]) & ~run.held_out
                rows.append(matrix[counted, at] / one.long_run)
                asked.append(torque[counted, at] / one.long_run)
        whole, right = np.concatenate(rows), np.concatenate(asked)
        squared = whole.T @ whole

        def linearise(x: Array, _about: Array) -> Linearised:
            numbers, slopes = self.equations.numbers(table, x)
            left = whole @ numbers - right
            return Linearised(
                information=slopes.T @ squared @ slopes,
                gradient=slopes.T @ (whole.T @ left),
                chi2=float(left @ left),
                rows=len(left),
            )

        return linearise

    def _with_memory(
        self,
        table: ParameterTable,
        posterior: Posterior,
        noise: Sequence[SeriesNoise],
        left: Sequence[Array],
    ) -> Posterior:
        """Returns the same with the covariance that the noise makes, by its memory."""
        slopes, width = self.equations.numbers(table, posterior.mean)[1], table.width
        correlation = _innovations_together(noise, left)
        spread = np.zeros((len(table), len(table)))
        for off, matrix in zip(left, self.matrices, strict=True):
            counted = np.isfinite(off)
            backs = [
                one.spread(np.where(counted[:, at, None], matrix[:, at] @ slopes, 0.0))
                / one.long_run**2
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


def _innovations_together(noise: Sequence[SeriesNoise], left: Sequence[Array]) -> Array:
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
