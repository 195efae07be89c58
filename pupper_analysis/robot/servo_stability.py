"""Whether position servos are too stiff for a time step of MuJoCo's."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh

Array = NDArray[np.float64]

_HALVINGS = 40  # of the time step, in search of a stable one: to 1e-12 of it


@dataclass(frozen=True, eq=False)
class ServoStability:
    """How far servos are from the limit of stability, without contacts and force limits.

    Attributes:
        ratio: Above 1 they are beyond it.
        shares: (nv,) how much each degree of freedom moves in the mode that is the least stable.
        timestep: The longest stable time step (s) with these gains, the model's if that is stable.
    """

    ratio: float
    shares: Array
    timestep: float


def servo_stability(
    model: mujoco.MjModel, data: mujoco.MjData, stiffness: Array, damping: Array, implicit: Array
) -> ServoStability | None:
    """Tests the stability of all servos together, at a configuration.

    MuJoCo's Euler step is v' = v - (M + h D)^-1 h (K x + (C + D) v), x' = x + h v', with D, the
    damping of joints and motors, implicit, and the servos' K and C explicit. An eigenvalue leaves
    the unit circle at -1 if x^T (h C + h^2 K / 2) x > x^T (2 M + h D) x for some x, that is, if the
    greatest generalised eigenvalue of the two matrices exceeds 1; for one joint without stiffness
    and D, if h kd / I > 2. The implicit integrators have C in D.
    Source: the Jury criterion for the step's characteristic polynomial; MuJoCo documentation,
    "Computation: Numerical integration".

    Args:
        model: The model.
        data: After ``mj_forward``.
        stiffness: (nv,) K of the servos (N m/rad).
        damping: (nv,) C of the servos (N m s/rad).
        implicit: (nv,) D (N m s/rad).

    Returns:
        The stability; None with a singular mass matrix, or absurd numbers.
    """
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    explicit, damped = damping, implicit
    if model.opt.integrator != mujoco.mjtIntegrator.mjINT_EULER.value:
        explicit, damped = np.zeros(model.nv), implicit + damping
    elif model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_EULERDAMP.value:
        explicit, damped = damping + implicit, np.zeros(model.nv)

    def worst(step: float) -> tuple[float, Array]:
        gains = np.diag(step * explicit + step**2 * stiffness / 2)
        values, vectors = eigh(gains, 2 * mass + step * np.diag(damped))
        return float(values[-1]), np.abs(vectors[:, -1])

    step = float(model.opt.timestep)
    try:
        ratio, shares = worst(step)
        low, high = (step, step) if ratio <= 1 else (0.0, step)
        for _ in range(_HALVINGS if ratio > 1 else 0):
            middle = (low + high) / 2
            low, high = (middle, high) if worst(middle)[0] <= 1 else (low, middle)
    except (np.linalg.LinAlgError, ValueError):
        return None
    return ServoStability(ratio, shares, low)
