"""Continuous torques of motors, as typed numbers and from the data of a motor."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from pupper_analysis.base.errors import ConfigurationError, ModelError
from pupper_analysis.cli.stance_options import parse_continuous_torques
from pupper_analysis.models.motors.reading import find_motor
from pupper_analysis.models.motors.thermal import ThermalNetwork
from tests.support.commands import run_command
from tests.support.variants import load


def test_a_motor_states_the_torque_at_its_limit_temperature() -> None:
    """Reference: the final temperature of the winding at that torque."""
    robot = load("v3")
    torques = parse_continuous_torques(("dephy-actpack", "*_1=0.5"), robot)
    assert set(torques) == set(robot.joint_names)
    assert torques["leg_front_r_1"] == 0.5
    motor = find_motor("dephy-actpack")
    current = motor.compute_current(torques["leg_front_r_3"])
    assert ThermalNetwork.of_motor(motor, current).steady_temperature == pytest.approx(115.0)


def test_unknown_numbers_and_words_are_refused() -> None:
    robot = load("v3")
    with pytest.raises(ModelError, match="unknown, but needed: winding_resistance"):
        parse_continuous_torques(("steadywin-gim4305-10",), robot)
    with pytest.raises(ConfigurationError, match="not a number"):
        parse_continuous_torques(("dephy",), robot)
    with pytest.raises(ModelError, match="no such file"):
        parse_continuous_torques(("missing.toml",), robot)


@pytest.mark.slow
def test_hold_compares_torques_with_the_continuous_ones(
    capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """Reference: the typed numbers."""
    path = tmp_path / "hold.json"
    status, _, err = run_command(
        capfd, "hold", "v3", "--continuous", "*_3=0.6", "--json", str(path)
    )
    assert status in (0, 1), err
    content = json.loads(path.read_text())
    assert content["limits"][2::3] == [0.6] * 4
    assert content["limits"][0] == 3.0
