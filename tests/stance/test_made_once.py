"""What is made once and used again gives what a new one gives."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.statics.equilibrium import balance_load
from tests.support.variants import load


def test_what_the_motors_hold_is_found_once_for_a_stand(monkeypatch: pytest.MonkeyPatch) -> None:
    robot, found = load("v3"), []

    def counted(*given: object, **named: object) -> pa.statics.GravityCompensation:
        found.append(named["distribution"])
        return balance_load(*given, **named)  # type: ignore[arg-type]

    monkeypatch.setattr("pupper_analysis.stance.stand.balance_load", counted)
    stand = pa.solve_stand(robot, pa.StandTask(height=0.11))
    held = pa.stance.stand_statics(robot, stand)
    assert pa.stance.stand_statics(robot, stand) is held
    pa.steady_state(robot, stand)
    assert len(found) == 1
    loaded = pa.stance.stand_statics(pa.robot.with_payload(robot, 1.0), stand)
    assert loaded.joint_torques.tolist() != held.joint_torques.tolist()
    peak = pa.stance.stand_statics(robot, stand, distribution="min-max torque")
    assert peak.joint_torques.tolist() != held.joint_torques.tolist()
    again = pickle.loads(pickle.dumps(stand))
    np.testing.assert_array_equal(
        pa.stance.stand_statics(robot, again).joint_torques, held.joint_torques
    )
    assert len(found) == 4
