"""How far a stand can go: limits are tight, and known ones are found."""

from __future__ import annotations

from dataclasses import replace

import pytest
from conftest import load

import pupper_analysis as pa
from pupper_analysis.envelope import pose_envelope, reachable_heights


def reached(robot: pa.Robot, task: pa.StandTask) -> bool:
    try:
        return pa.solve_stand(robot, task, explain=False).foot_error < 1e-9
    except pa.StanceUnreachableError:
        return False


def test_the_highest_stand_has_straight_legs() -> None:
    """The feet are off the hips by the base's shift alone, 5 mm: 0.19 m of leg, 0.018 m of foot."""
    robot = load("original")
    heights = reachable_heights(robot)
    assert heights.high == pytest.approx(0.208, abs=3e-4)
    assert heights.high < 0.208
    assert reached(robot, pa.StandTask(heights.low))
    assert reached(robot, pa.StandTask(heights.high))
    assert not reached(robot, pa.StandTask(heights.low - 3e-4))
    assert not reached(robot, pa.StandTask(heights.high + 3e-4))


@pytest.mark.parametrize("name", ["v3", "long-leg"])
def test_limits_are_tight_in_every_direction(name: str) -> None:
    robot = load(name)
    envelope = pose_envelope(robot)
    for direction in ("roll", "pitch", "yaw"):
        interval = envelope.intervals[direction]
        assert interval.low < 0 < interval.high
        for value, sign in ((interval.low, -1), (interval.high, 1)):
            assert reached(robot, pa.StandTask(**{direction: value}))
            if abs(value) < 1.56:  # not the end of the angle's range
                assert not reached(robot, pa.StandTask(**{direction: value + sign * 1e-3}))
    for direction in ("roll", "yaw", "y"):  # left and right are mirror images
        interval = envelope.intervals[direction]
        assert interval.low == pytest.approx(-interval.high, abs=2e-3)


def test_shifts_end_where_the_com_leaves_the_polygon_or_the_legs_end() -> None:
    robot = load("v3")
    x = pose_envelope(robot).intervals["x"]
    for value, sign in ((x.low, -1), (x.high, 1)):
        inside = pa.solve_stand(robot, pa.StandTask(offset=(value, 0.0)))
        assert pa.stand_statics(robot, inside).com_margin >= 0
        beyond = pa.StandTask(offset=(value + sign * 2e-4, 0.0))
        if reached(robot, beyond):
            with pytest.raises(pa.StaticsInfeasibleError):
                pa.stand_statics(robot, pa.solve_stand(robot, beyond))


def test_the_task_is_where_it_begins() -> None:
    robot = load("v3")
    level = reachable_heights(robot)
    tilted = reachable_heights(robot, pa.StandTask(roll=0.2, pitch=0.1))
    assert level.low < tilted.low < tilted.high < level.high
    with pytest.raises(pa.StanceUnreachableError):
        reachable_heights(robot, pa.StandTask(height=1.0))
    assert pose_envelope(robot, pa.StandTask(yaw=0.1)).task == replace(
        pa.StandTask(yaw=0.1), height=robot.stand_height
    )
