"""Electrical energy of the motors on a path."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.simulation.rollout import simulate_commands
from pupper_analysis.tools.path.tracking import path_commands, study_path
from tests.support.motor_energy import SOURCES, check_balance, compute_bare_work, make_driven_robot


@pytest.mark.slow
@pytest.mark.parametrize("source", SOURCES)
def test_energy_of_a_path_is_balanced(source: str, tmp_path: Path) -> None:
    """Reference: the change of momentum in bare MuJoCo, step by step."""
    robot, motors = make_driven_robot(source, tmp_path)
    height = 0.14 if robot.name == "v3" else 0.30
    there = study_path(robot, pa.StandTask(height=height), 1.0, motors=motors)
    energy = check_balance(there.tracking.energy)
    plan = path_commands(robot, there.path)
    states = simulate_commands(plan.drive.model, plan.start, plan.ctrl)
    series = np.vstack([plan.start, states])
    bare = compute_bare_work(plan.drive.model, series, plan.ctrl)
    assert energy.work == pytest.approx(bare, rel=1e-6, abs=1e-6 * energy.copper)
