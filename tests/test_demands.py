"""Demands that give way: all of them at the nominal stand, and half way there."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import load

import pupper_analysis as pa
from pupper_analysis.demands import DEMANDS, differ, in_words, shrunk

TASK = pa.StandTask(
    height=0.15,
    roll=0.2,
    pitch=-0.4,
    offset=(0.02, -0.04),
    foot_offsets={"FL": (0.02, 0.01)},
    lifted={"RR": 0.02},
    ground=pa.Ground(0.1, 0.5, {"FR": 0.02}),
    ground_clearance=0.01,
)


def test_none_of_it_is_the_nominal_stand_and_all_of_it_the_task() -> None:
    robot = load("v3")
    assert shrunk(robot, TASK, DEMANDS, 1.0) == TASK
    nominal = shrunk(robot, TASK, DEMANDS, 0.0)
    stand, plain = (
        pa.solve_stand(robot, nominal),
        pa.solve_stand(robot, pa.StandTask(lifted={"RR": 1e-9})),
    )
    np.testing.assert_allclose(stand.qpos[2:7], plain.qpos[2:7], atol=1e-9)
    assert not differ(robot, pa.StandTask(yaw=0.3), ["roll", "height", "ground"])
    assert differ(robot, pa.StandTask(yaw=0.3), ["roll", "yaw"])


@pytest.mark.parametrize("demand", DEMANDS)
def test_one_gives_way_and_the_others_stay(demand: str) -> None:
    robot = load("v3")
    half = shrunk(robot, TASK, [demand], 0.5)
    for other in set(DEMANDS) - {demand}:
        assert getattr(half, other) == getattr(TASK, other)
    expected = {
        "height": (0.15 + robot.stand_height) / 2,
        "roll": 0.1,
        "pitch": -0.2,
        "offset": (0.01, -0.02),
        "foot_offsets": {"FL": (0.01, 0.005)},
        "lifted": {"RR": 0.01},
        "ground": pa.Ground(0.05, 0.5, {"FR": 0.01}),
        "ground_clearance": 0.005,
    }
    if demand in expected:
        found = getattr(half, demand)
        assert found == expected[demand] or found == pytest.approx(expected[demand])
    else:
        assert half == TASK


def test_placed_feet_go_towards_their_nominal_places() -> None:
    robot = load("v3")
    nominal = pa.Configuration(robot, robot.neutral()).foot_positions()["FL"]
    task = pa.StandTask(feet={"FL": (0.1, 0.1)})
    place = shrunk(robot, task, ["feet"], 0.5).feet["FL"]
    np.testing.assert_allclose(place, (nominal[:2] + 0.1) / 2)


def test_in_words() -> None:
    assert in_words(TASK, "height") == "0.150 m"
    assert in_words(TASK, "roll") == "11.5 deg"
    assert in_words(TASK, "offset") == "(20, -40) mm"
    assert in_words(TASK, "ground") == "slope 5.7 deg, steps FR 20 mm"
    assert in_words(TASK, "lifted") == "RR 20 mm"
    assert in_words(TASK, "ground_clearance") == "10.0 mm"
    assert in_words(TASK, "foot_offsets") == "FL (20, 10) mm"
