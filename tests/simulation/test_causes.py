"""Causes for which a simulation does not come to rest: pulses of the ground force."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.robot.servos import model_with_servos
from pupper_analysis.simulation.causes import find_chatter
from pupper_analysis.simulation.rollout import place_on_ground, simulate_commands
from tests.support.legged import quadruped


@pytest.mark.parametrize(
    ("option", "says"),
    [
        ('<option impratio="10"/>', 'impratio of 10 is meant for cone="elliptic"'),
        ('<option impratio="10" cone="elliptic"/>', "a longer solref"),
        ("", "a longer solref"),
    ],
)
def test_ground_that_pushes_in_pulses_is_named_as_a_cause(
    option: str, says: str, tmp_path: Path
) -> None:
    """States whose base height alternates by 2 mm, as in the simulation of a Booster K1 on a
    slope.
    """
    pair = quadruped(tmp_path, actuators="position")
    text = pair.mjcf.read_text()
    pair.mjcf.write_text(text.replace("<worldbody>", f"{option}<worldbody>", 1))
    robot = pa.load_robot(urdf=pair.urdf, mjcf=pair.mjcf)
    stand = pa.stance.solve_stand_on_soft_ground(robot)
    drive = model_with_servos(robot)
    ctrl = drive.command(robot, stand.joint_positions(robot), None)
    start = place_on_ground(
        robot, drive, stand, pa.stance.stand_statics(robot, stand).joint_torques
    )
    states = simulate_commands(drive.model, start, np.tile(ctrl, (200, 1)))
    assert find_chatter(robot, drive, states, ctrl) == []
    states = np.tile(states[-1], (200, 1))
    states[::2, 3] += 2e-3  # the base's height, every other step: it bears all, or nothing
    (message,) = find_chatter(robot, drive, states, ctrl)
    assert message.code == "contacts-rattle"
    assert message.values["share"] == pytest.approx(0.5, abs=1e-3)
    assert says in str(message)
