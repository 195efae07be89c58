"""The derivative of one of MuJoCo's steps by the state."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

STEP = 1e-7
"""Of the centred differences (m, rad, and their rates): contacts are stiff, and curved over 1e-5;
eigenvalues come out to 1e-9, where 1e-6 leaves as much."""

_TOLERANCE = 1e-14
"""Of the solver while differences are taken: with the usual 1e-8 it sometimes ends an iteration
earlier on one side of a difference, and an element is off by 0.03. A copy of the model, with the
meshes of a humanoid, takes longer than all else."""


SLEEP = mujoco.mjtEnableBit.mjENBL_SLEEP.value
"""``<flag sleep="enable"/>``."""


def copy_data(model: mujoco.MjModel, data: mujoco.MjData) -> mujoco.MjData:
    """Returns data of its own at the same state.

    Args:
        model: The model.
        data: The state.
    """
    state = np.empty(mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_INTEGRATION.value))
    mujoco.mj_getState(model, data, state, mujoco.mjtState.mjSTATE_INTEGRATION.value)
    own = mujoco.MjData(model)
    mujoco.mj_setState(model, own, state, mujoco.mjtState.mjSTATE_INTEGRATION.value)
    mujoco.mj_forward(model, own)
    return own


def step_derivative(model: mujoco.MjModel, data: mujoco.MjData) -> Array:
    """Returns the derivative of a step by the state, (2 nv + na, 2 nv + na).

    Args:
        model: The model. While this runs, the tolerance of its solver is tighter.
        data: The state; it stays as it is.
    """
    size = 2 * model.nv + model.na
    matrix, tolerance = np.zeros((size, size)), float(model.opt.tolerance)
    flags = int(model.opt.enableflags)
    model.opt.tolerance = min(tolerance, _TOLERANCE)
    # What sleeps has no derivative: a change of its state wakes it, or is forgotten.
    model.opt.enableflags = flags & ~SLEEP
    if flags & SLEEP:
        data = copy_data(model, data)
    try:
        if model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4.value:  # which MuJoCo's has not
            return _differences(model, data, matrix)
        mujoco.mjd_transitionFD(model, data, STEP, True, matrix, None, None, None)
    finally:
        model.opt.tolerance, model.opt.enableflags = tolerance, flags
    return matrix


def _differences(model: mujoco.MjModel, data: mujoco.MjData, matrix: Array) -> Array:
    """Fills in centred differences of whole steps."""
    own, nv = copy_data(model, data), model.nv
    ends = [(np.empty(model.nq), np.empty(nv), np.empty(model.na)) for _ in range(2)]
    for column in range(len(matrix)):
        for end, size in zip(ends, (-STEP, STEP), strict=True):
            mujoco.mj_copyData(own, model, data)
            change = np.zeros(len(matrix))
            change[column] = size
            mujoco.mj_integratePos(model, own.qpos, change[:nv], 1.0)
            own.qvel += change[nv : 2 * nv]
            own.act += change[2 * nv :]
            mujoco.mj_step(model, own)
            end[0][:], end[1][:], end[2][:] = own.qpos, own.qvel, own.act
        moved = np.empty(nv)
        mujoco.mj_differentiatePos(model, moved, 2 * STEP, ends[0][0], ends[1][0])
        rates = [(ends[1][part] - ends[0][part]) / (2 * STEP) for part in (1, 2)]
        matrix[:, column] = np.concatenate([moved, *rates])
    return matrix
