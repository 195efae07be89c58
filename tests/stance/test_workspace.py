"""How far a stand can go: limits are tight, and known ones are found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.stance.workspace import (
    base_workspace,
    find_interval,
    reachable_heights,
    solve_stand_at,
)
from tests.support.variants import load


def reached(robot: pa.Robot, task: pa.StandTask) -> bool:
    try:
        return pa.solve_stand(robot, task, explain=False).foot_error < 1e-9
    except pa.StanceUnreachableError:
        return False


@pytest.mark.parametrize("name", ["v3", "long-leg"])
def test_limits_are_tight_in_every_direction(name: str) -> None:
    robot = load(name)
    workspace = base_workspace(robot)
    for direction in ("roll", "pitch", "yaw"):
        interval = workspace.intervals[direction]
        assert interval.low < 0 < interval.high
        for value, sign in ((interval.low, -1), (interval.high, 1)):
            assert reached(robot, pa.StandTask(**{direction: value}))
            if abs(value) < 1.56:  # not the end of the angle's range
                assert not reached(robot, pa.StandTask(**{direction: value + sign * 1e-3}))
    for direction in ("roll", "yaw", "y"):  # left and right are mirror images
        interval = workspace.intervals[direction]
        assert interval.low == pytest.approx(-interval.high, abs=2e-3)


def test_shifts_end_where_the_com_leaves_the_polygon_or_the_legs_end() -> None:
    robot = load("v3")
    x = base_workspace(robot).intervals["x"]
    for value, sign in ((x.low, -1), (x.high, 1)):
        inside = pa.solve_stand(robot, pa.StandTask(offset=(value, 0.0)))
        assert pa.stance.stand_statics(robot, inside).com_margin >= 0
        beyond = pa.StandTask(offset=(value + sign * 2e-4, 0.0))
        if reached(robot, beyond):
            with pytest.raises(pa.StaticsInfeasibleError):
                pa.stance.stand_statics(robot, pa.solve_stand(robot, beyond))


def test_the_task_is_where_it_begins() -> None:
    robot = load("v3")
    level = reachable_heights(robot)
    tilted = reachable_heights(robot, pa.StandTask(roll=0.2, pitch=0.1))
    assert level.low < tilted.low < tilted.high < level.high
    with pytest.raises(pa.StanceUnreachableError):
        reachable_heights(robot, pa.StandTask(height=1.0))
    assert base_workspace(robot, pa.StandTask(yaw=0.1)).start.task == replace(
        pa.StandTask(yaw=0.1), height=robot.stand_height, com="centre"
    )


def test_com_anywhere_inside_stays_where_the_stand_has_it() -> None:
    robot = load("v3")
    task = pa.StandTask(swing={"FL": 0.02}, com="inside", com_margin=0.01)
    start = pa.solve_stand(robot, task)
    place = pa.Configuration(robot, start.qpos).center_of_mass()[:2]
    other = solve_stand_at(robot, start, "pitch", 0.1)
    found = pa.Configuration(robot, other.qpos).center_of_mass()[:2]
    np.testing.assert_allclose(found, place, atol=1e-9)
    interval = base_workspace(robot, task).intervals["pitch"]
    assert interval.low < -0.2
    assert interval.high > 0.2


def test_an_end_that_is_far_enough_need_not_be_found() -> None:
    robot = pa.load_variant("original")
    start = pa.solve_stand(robot)
    whole = pa.stance.base_workspace(robot).intervals
    for direction, enough in (("pitch", 0.3), ("roll", 0.45), ("height", 0.02)):
        begin = float(getattr(start.task, direction))
        some = find_interval(robot, start, direction, enough)
        for found, end, side in (
            (some.low, whole[direction].low, -1.0),
            (some.high, whole[direction].high, 1.0),
        ):
            if side * (end - begin) < enough:
                assert found == pytest.approx(end, abs=1e-9)
            else:
                assert side * (found - begin) >= enough
