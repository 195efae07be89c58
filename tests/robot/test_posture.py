"""Joints that carry no foot are where they are told to be, in stands and with payloads."""

from __future__ import annotations

from pathlib import Path

import pytest

import pupper_analysis as pa
from pupper_analysis.robot.payload import with_payload
from pupper_analysis.robot.posture import with_posture
from tests.support.random_legged import drawn, written


@pytest.mark.slow
def test_a_tail_is_where_it_is_told_to_be(tmp_path: Path) -> None:
    """Three legs and a tail, whose weight changes what the feet carry."""
    pair = written(drawn(57), tmp_path)
    robot = pa.load_robot(pair.urdf, pair.mjcf, self_check=False)
    tail = next(name for name in robot.joint_names if "wag" in name)
    index = robot.joint_names.index(tail)
    forces = {}
    for position in (-0.45, 0.4):
        posed = with_posture(robot, {"*wag*": position})
        for loaded in (posed, with_payload(posed, 0.1)):
            stand = pa.solve_stand(loaded)
            assert stand.joint_positions(loaded)[index] == pytest.approx(position, abs=5e-3)
        stand = pa.solve_stand(posed)
        assert pa.verify_stand(posed, stand, duration=2.0, nudged=0.0).torque_error < 2e-2
        forces[position] = pa.stance.stand_statics(posed, stand).joint_torques[index]
        assert posed.fingerprint != robot.fingerprint
        with pytest.raises(pa.ConfigurationError, match="stand of"):
            stand.check(robot)
    assert abs(forces[-0.45] - forces[0.4]) > 1e-3
    leg = next(name for name in robot.joint_names if name != tail)
    for wrong, said in (
        ({leg: 0.1}, "carries a foot"),
        ({tail: 2.0}, "outside"),
        ({"x": 0.0}, tail),
    ):
        with pytest.raises((pa.ConfigurationError, pa.UnknownNameError), match=said):
            with_posture(robot, wrong)
