"""Why a simulation does not come to rest: jolts of the ground."""

from __future__ import annotations

import numpy as np

import pupper_analysis as pa
from pupper_analysis.robot.servos import model_with_servos
from pupper_analysis.simulation.causes import find_chatter
from tests.simulation.test_monitor import state_at
from tests.support.variants import load, stand_of


def test_a_ground_that_pushes_by_jolts_rattles() -> None:
    """As if it went up and down from step to step: the ground gives now more, now less."""
    robot, stand = load("original"), stand_of("original")
    drive = model_with_servos(robot)
    at_rest = pa.stance.solve_stand_on_soft_ground(robot).qpos
    ctrl = drive.command(robot, stand.joint_positions(robot))
    shares = []
    for way in (0.0, 1e-4, 1e-3, 2e-3):
        states = []
        for number in range(50):
            qpos = at_rest.copy()
            qpos[2] += way if number % 2 else -way
            states.append(state_at(robot, drive.model, qpos))
        message = find_chatter(robot, drive, np.array(states), ctrl)
        shares.append(sum(float(one.values["share"]) for one in message))
    assert shares[:2] == [0.0, 0.0]  # what varies by less than a twentieth is told by none
    assert 0.1 < shares[2] < 0.9
    assert shares[3] > 1.5 * shares[2]
