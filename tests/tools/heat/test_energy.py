"""Electrical energy of motors at rest."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.models.motors.energy import compute_motor_energy
from pupper_analysis.tools.heat.heat import study_heat
from tests.support.motor_energy import SOURCES, check_balance, make_driven_robot


@pytest.mark.slow
@pytest.mark.parametrize("source", SOURCES)
def test_energy_at_rest_is_copper_loss(source: str, tmp_path: Path) -> None:
    """``heat`` and ``study`` compute a stance at rest. Reference: the energy without speed.

    The windings are cold: `HeatStudy.motors` states the loss at the temperature of the resistance.
    """
    robot, motors = make_driven_robot(source, tmp_path)
    study = study_heat(robot, pa.StandTask(), motors)
    torques = np.array([[motor.torque for motor in study.motors]])
    names = [motor.joint for motor in study.motors]
    energy = check_balance(compute_motor_energy(motors, names, torques, np.zeros((2, 12)), 1.0))
    cold = sum(motor.cold_loss or 0.0 for motor in study.motors)
    assert energy.electrical == pytest.approx(cold, rel=1e-12)
    assert (energy.work, energy.friction) == (0.0, 0.0)
