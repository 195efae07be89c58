"""Residual of MuJoCo's constraint solver per model, and the reaction to a solver that is
inexact.
"""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.prepare import simulable
from pupper_analysis.prepare.simulable import MAX_SOLVER_RESIDUAL, compute_solver_residual
from tests.support.legged import quadruped, rewrite_file
from tests.support.variants import load, stand_of

EXACT = ("solver-made-dense", "solver-inexact")
DENSE = int(mujoco.mjtJacobian.mjJAC_DENSE.value)


def compute_residual_at_stand(iterations: int, kind: mujoco.mjtSolver) -> float:
    """Return the residual of MuJoCo's solver for v3 with its feet 1 mm in the ground."""
    robot = load("v3")
    model = robot.mj_model.__copy__()
    model.opt.iterations, model.opt.solver = iterations, int(kind.value)
    data, qpos = mujoco.MjData(model), stand_of("v3").qpos.copy()
    qpos[2] -= 1e-3
    robot.mj_convention.set_state(data, qpos)
    return compute_solver_residual(model, data, model.body(robot.mj_base).id)


def test_residual_is_negligible_for_a_solver_with_enough_iterations() -> None:
    """Newton and PGS with 100 iterations leave less than 1e-6 of the weight."""
    assert compute_residual_at_stand(100, mujoco.mjtSolver.mjSOL_NEWTON) < 1e-6
    assert (
        compute_residual_at_stand(100, mujoco.mjtSolver.mjSOL_PGS) < 1e-6
    )  # its accelerations follow its forces


def test_solver_that_stops_early_is_inexact() -> None:
    assert compute_residual_at_stand(1, mujoco.mjtSolver.mjSOL_CG) > MAX_SOLVER_RESIDUAL


def test_solver_residual_is_zero_in_the_air_and_its_push_is_removed() -> None:
    """In the air the residual is below 1e-12, and the push is removed afterwards."""
    robot = load("v3")
    model, data = robot.mj_model, mujoco.MjData(robot.mj_model)
    qpos = stand_of("v3").qpos.copy()
    qpos[2] += 1.0
    robot.mj_convention.set_state(data, qpos)
    assert compute_solver_residual(model, data, model.body(robot.mj_base).id) < 1e-12
    com = data.subtree_com[model.body(robot.mj_base).id].copy()
    mujoco.mj_forward(model, data)
    assert not data.xfrc_applied.any()  # the push is removed
    np.testing.assert_array_equal(com, data.subtree_com[model.body(robot.mj_base).id])


@pytest.fixture
def sparse_newton_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    """Replace the residual of the sparse solver by 90 %, as measured for ToddlerBot; no small model
    was found for which it fails.
    """
    monkeypatch.setattr(
        simulable,
        "compute_solver_residual",
        lambda model, data, base: 0.9 if mujoco.mj_isSparse(model) else 0.0,
    )


@pytest.mark.usefixtures("sparse_newton_fails")
def test_dense_jacobian_is_used_if_the_sparse_one_loses_forces(tmp_path: Path) -> None:
    """The sparse solver is replaced by one that loses 90 % of the weight."""
    pair = quadruped(tmp_path)
    rewrite_file(pair.mjcf, ("<worldbody>", '<option jacobian="sparse"/><worldbody>'))
    robot = pa.load_robot(*pair)
    assert robot.mj_model.opt.jacobian == DENSE
    (warning,) = [str(note) for note in robot.notes if note.code in EXACT]
    assert "90 % of the weight" in warning
    assert 'jacobian="dense"' in warning


@pytest.mark.slow
def test_inexact_solver_is_kept_with_a_note(tmp_path: Path) -> None:
    """CG with one iteration is simulated as the file specifies; the note is absent with the default
    solver.
    """
    pair = quadruped(tmp_path)
    option = '<option solver="CG" iterations="1" ls_iterations="1"/>'
    rewrite_file(pair.mjcf, ("<worldbody>", f"{option}<worldbody>"))
    robot = pa.load_robot(*pair)
    assert robot.mj_model.opt.iterations == 1
    (warning,) = [str(note) for note in robot.notes if note.code in EXACT]
    assert "is unreliable" in warning
    rewrite_file(pair.mjcf, (option, ""))
    robot = pa.load_robot(*pair)
    assert not any(note.code in EXACT for note in robot.notes)
