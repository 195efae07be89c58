"""Continuous torques of motors, as typed numbers and from the data of a motor."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

import pupper_analysis as pa
from pupper_analysis.base.errors import ConfigurationError, ModelError, UnknownNameError
from pupper_analysis.cli.stance_options import limit_by_peak, parse_continuous_torques
from pupper_analysis.models.motors.reading import find_motor
from pupper_analysis.models.motors.thermal import ThermalNetwork, compute_continuous_torque
from tests.support.commands import run_command
from tests.support.legged import quadruped, rewrite_file
from tests.support.variants import load


def test_a_motor_states_the_torque_at_its_limit_temperature() -> None:
    """Reference: the final temperature of the winding at that torque."""
    robot = load("v3")
    torques, motors = parse_continuous_torques(("dephy-actpack", "*_1=0.5"), robot)
    assert set(torques) == set(robot.joint_names)
    assert torques["leg_front_r_1"] == 0.5
    assert set(motors) == {name for name in robot.joint_names if not name.endswith("_1")}
    motor = find_motor("dephy-actpack")
    current = motor.compute_current(torques["leg_front_r_3"])
    assert ThermalNetwork.of_motor(motor, current).steady_temperature == pytest.approx(115.0)


def test_unknown_numbers_and_words_are_refused() -> None:
    robot = load("v3")
    with pytest.raises(ModelError, match=r"needed: winding_resistance.*continuous_torque"):
        parse_continuous_torques(("dynamixel-xm540-w270",), robot)
    with pytest.raises(UnknownNameError, match="most similar names are: dephy-actpack"):
        parse_continuous_torques(("dephy",), robot)
    with pytest.raises(ConfigurationError, match="not a number"):
        parse_continuous_torques(("8Nm",), robot)
    with pytest.raises(ModelError, match="no such file"):
        parse_continuous_torques(("missing.toml",), robot)


def test_a_data_sheet_states_the_torque_if_thermal_numbers_are_unknown() -> None:
    """Reference: the nominal torque of the data sheet; an ambient temperature excludes it."""
    robot = load("v3")
    torques, _ = parse_continuous_torques(("lk-tech-mg4005-10",), robot)
    assert set(torques.values()) == {1.0}
    with pytest.raises(ModelError, match="winding_resistance"):
        compute_continuous_torque(find_motor("lk-tech-mg4005-10"), ambient=40.0)


@pytest.mark.slow
def test_payload_and_hold_name_a_motor_that_cannot_exert_the_torque(
    capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """Reference: the typed current limit times the torque per current, 0.4 N m."""
    path = tmp_path / "weak.toml"
    path.write_text(
        'name = "weak"\nsource = "bench"\noutput_torque_constant = "0.4 N m/A"\n'
        'current_limit = "1 A"\ncontinuous_torque = "0.4 N m"\n'
    )
    status, out, err = run_command(capfd, "payload", "v3", "--continuous", str(path))
    assert status == 1, err
    line = out.splitlines()[0]
    assert re.search(r"_3 needs 0\.47\d* N m, its motor exerts 0\.4 N m \(current", line)
    words = ("--continuous", str(path), "--joints", "leg_front_r_2=80deg", "--payload", "2")
    status, out, err = run_command(capfd, "hold", "v3", *words)
    assert status == 1, err
    assert "needs" in out.splitlines()[0]


@pytest.mark.slow
def test_hold_compares_torques_with_the_continuous_torques(
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


@pytest.mark.slow
def test_best_stance_compares_torques_with_the_continuous_torques(
    capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """The peak torques of v3 are 3 N m: with 0.6 N m the utilisation is five times as large."""
    found = []
    for number, options in enumerate([(), ("--continuous", "0.6")]):
        path = tmp_path / f"{number}.json"
        status, _, err = run_command(
            capfd, "best", "utilisation", "v3", *options, "--json", str(path)
        )
        assert status in (0, 1), err
        found.append(json.loads(path.read_text())["best"]["nominal_value"])
    assert found[1] == pytest.approx(5 * found[0], rel=1e-6)


@pytest.mark.slow
def test_continuous_torque_is_at_most_the_peak_torque(
    capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """The limits of v3 are 3 N m; a motor without torque stays without torque."""
    for options, limits in (
        (("--continuous", "100"), (3.0, 3.0)),
        (("--effort", "*_3=1", "--continuous", "2"), (2.0, 1.0)),
    ):
        path = tmp_path / "hold.json"
        status, _, err = run_command(capfd, "hold", "v3", *options, "--json", str(path), "--force")
        assert status in (0, 1), err
        content = json.loads(path.read_text())
        assert (content["limits"][0], content["limits"][2]) == limits
    pair = quadruped(tmp_path, floor=True, actuators="position")
    rewrite_file(pair.urdf, ('effort="80"', 'effort="0"'), count=1)
    robot = pa.load_robot(*pair)
    [null] = [limit.joint for limit in robot.efforts if limit.without_torque]
    assert limit_by_peak(robot, dict.fromkeys(robot.joint_names, 500.0)) == {
        joint: 80.0 for joint in robot.joint_names if joint != null
    }
