"""Predict the motion of a robot near rest with the linearised MuJoCo time step.

Let d[n] be the change of the state in step n. Near rest, d[n+1] = A d[n], with the derivative A of
the step at a constant command. The sum of these changes is the displacement (`LinearStep.predict`).
`LinearStep.reproduces` compares the prediction with a simulated interval.
"""

from __future__ import annotations

import math

import mujoco
import numpy as np

from pupper_analysis.base.array_types import Array
from pupper_analysis.robot.stability import step_derivative

_MAX_SAMPLE_TIME = 0.05
"""Upper bound of the time between the evaluated displacements of a prediction [s], unless the time
step of the model is longer. Derived: an oscillation at 2 Hz is sampled ten times per period. Its
displacement between two samples exceeds the samples by at most about 5 %: 1 / cos(pi / 10) =
1.051."""

_INTERVAL_RTOL, _INTERVAL_ATOL = 0.1, 1e-6
"""Relative [1] and absolute [m, rad] tolerance of a predicted displacement. `LinearStep.reproduces`
rejects the linear model if the error exceeds rtol * (largest simulated displacement) + atol.
Chosen, not tuned.
"""


class LinearStep:
    """Linearised time step of a MuJoCo model at a state, with constant actuator commands.

    Args:
        model: MuJoCo model.
        data: State, after ``mj_forward``, with ``ctrl``.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        self._model, self._timestep = model, float(model.opt.timestep)
        # Number of steps between two evaluated displacements, a power of two.
        self._stride = 1
        power = total = step_derivative(model, data)
        while 2 * self._stride * self._timestep <= _MAX_SAMPLE_TIME:
            total = total + power @ total
            power, self._stride = power @ power, 2 * self._stride
        self._power, self._total = power, total

    def predict(self, before: Array, state: Array, duration: float) -> Array:
        """Predict with the linear model how far the robot moves from a state, at later times.

        The model extrapolates the change in the last time step, from ``before`` to ``state``. The
        displacement is predicted at n times, with an interval of at most `_MAX_SAMPLE_TIME` or one
        time step. The last time is ``duration`` or slightly later.

        Args:
            before: State one time step before ``state`` (mjSTATE_FULLPHYSICS), shape (size,).
            state: State (mjSTATE_FULLPHYSICS) from which displacements are measured, shape (size,).
            duration: Predicted time after ``state`` [s].

        Returns:
            Displacements, shape (n, 2 nv + na), in the tangent space: positions [m, rad],
            velocities [m/s, rad/s], activations. Values may be infinite or NaN if a mode grows.
        """
        return self._predict_displacements(
            before, state, math.ceil(duration / (self._stride * self._timestep))
        )

    def reproduces(self, states: Array) -> bool:
        """Return True if this linear model predicts simulated positions from the first two states.

        ``states`` after successive steps (mjSTATE_FULLPHYSICS) have the shape (n, size). The
        tolerances are `_INTERVAL_RTOL` and `_INTERVAL_ATOL`. The result is False if the states are
        too few.
        """
        count, nv = (len(states) - 2) // self._stride, self._model.nv
        if count < 1:
            return False
        predicted = self._predict_displacements(states[0], states[1], count)[:, :nv]
        later = states[1 + self._stride :: self._stride][:count]
        simulated = np.array([self.subtract(states[1], state)[:nv] for state in later])
        most = float(np.abs(simulated).max(initial=0.0))
        error = float(np.abs(predicted - simulated).max(initial=0.0))
        return error <= _INTERVAL_RTOL * most + _INTERVAL_ATOL

    def _predict_displacements(self, before: Array, state: Array, count: int) -> Array:
        """Predict displacements from ``state`` at ``count`` sample times, (count, 2 nv + na).

        ``before`` is the state one step before ``state``.
        """
        change = self.subtract(before, state)
        displacements, displacement = np.empty((count, len(change))), np.zeros(len(change))
        with np.errstate(over="ignore", invalid="ignore"):  # growth without bound
            for index in range(count):
                displacement = displacement + self._total @ change
                displacements[index], change = displacement, self._power @ change
        return displacements

    def subtract(self, before: Array, state: Array) -> Array:
        """Compute the change from a state to another state, in the tangent space, (2 nv + na,).

        The states are mjSTATE_FULLPHYSICS. The change contains positions [m, rad], velocities [m/s,
        rad/s] and activations.
        """
        model = self._model
        ends = 1 + model.nq, 1 + model.nq + model.nv + model.na
        positions = np.empty(model.nv)
        mujoco.mj_differentiatePos(model, positions, 1.0, before[1 : ends[0]], state[1 : ends[0]])
        return np.concatenate([positions, (state - before)[ends[0] : ends[1]]])
