"""Limits of the base workspace: stands at a limit are solved, stands beyond it are refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.stance.workspace import (
    _describe_com_mismatch,
    _solve_at,
    base_workspace,
    find_interval,
    reachable_heights,
)
from pupper_analysis.statics.support_polygon import com_margin
from tests.support.legged import edit_pair, quadruped
from tests.support.variants import load


def is_reached(robot: pa.Robot, task: pa.StandTask) -> bool:
    try:
        return pa.solve_stand(robot, task, explain=False).foot_error < 1e-9
    except pa.StanceUnreachableError:
        return False


def test_com_of_the_mjcf_beside_that_of_the_urdf_is_reported(tmp_path: Path) -> None:
    """Reference: a trunk of mass m, shifted by y, moves the CoM of the robot by y m / M.

    A common factor on all masses moves no CoM, and no end of an interval.
    """
    pair = edit_pair(quadruped(tmp_path), {}, {"<compiler ": '<compiler settotalmass="99" '})
    heavier = pa.load_robot(*pair)
    start = pa.solve_stand(heavier)
    assert heavier.mj_model.body_subtreemass[0] == pytest.approx(99)
    assert _describe_com_mismatch(heavier, [start]) is None
    trunk = heavier.mj_model.body("trunk")
    shifted = pa.load_robot(*edit_pair(pair, {}, {r'(<inertial pos="\S+) \S+ ': r"\1 0.02 "}, 1))
    message = _describe_com_mismatch(shifted, [start])
    assert message is not None
    expected = abs(0.02 - trunk.ipos[1]) * trunk.mass[0] / 99
    assert message.values["distance"].value == pytest.approx(expected, rel=1e-6)
    assert f"URDF {shifted.total_mass:.3f} kg, MJCF 99.000 kg, CoM " in message.short


@pytest.mark.slow
def test_workspace_of_different_files_contains_the_message(tmp_path: Path) -> None:
    """`stand` says DISAGREES for these files; the workspace of equal files has no message."""
    pair = quadruped(tmp_path)
    assert base_workspace(pa.load_robot(*pair)).mismatch is None
    edit_pair(pair, {}, {r'(<inertial pos="\S+) \S+ ': r"\1 0.02 "}, 1)
    found = base_workspace(pa.load_robot(*pair))
    assert found.mismatch is not None
    assert repr(found).startswith("BaseWorkspace(mismatch='the files describe different robots")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["v3", "long-leg"])
def test_limits_of_rotations_are_tight_and_symmetric(name: str) -> None:
    """Reference: the solver reaches each limit angle, and not 1 mrad beyond.

    By symmetry the limits of roll, yaw and y are opposite within 2e-3 rad or m.
    """
    robot = load(name)
    workspace = base_workspace(robot)
    for direction in ("roll", "pitch", "yaw"):
        interval = workspace.intervals[direction]
        assert interval.low < 0 < interval.high
        for value, sign in ((interval.low, -1), (interval.high, 1)):
            assert is_reached(robot, pa.StandTask(**{direction: value}))
            if abs(value) < 1.56:  # not the end of the angle's range
                assert not is_reached(robot, pa.StandTask(**{direction: value + sign * 1e-3}))
    for direction in ("roll", "yaw"):  # the named joints are at their limits there, and no others
        for end, limit in zip((-1, 1), workspace.limits[direction], strict=True):
            interval = workspace.intervals[direction]
            value = interval.high if end > 0 else interval.low
            angles = pa.solve_stand(robot, pa.StandTask(**{direction: value})).qpos[7:]
            reserve = np.minimum(angles - robot.lower_limits, robot.upper_limits - angles)
            names = [
                name for name, left in zip(robot.joint_names, reserve, strict=True) if left < 0.01
            ]
            if limit.code == "workspace-ends-at-joint-limits":
                assert names == [*limit.values["joints"]]
            else:
                assert names == []
    for direction in ("roll", "yaw", "y"):  # left and right are mirror images
        interval = workspace.intervals[direction]
        assert interval.low == pytest.approx(-interval.high, abs=2e-3)


@pytest.mark.slow
def test_base_shift_ends_at_the_polygon_or_at_full_leg_length() -> None:
    """Reference: at the limit of x the CoM is inside the support polygon; 0.2 mm beyond, the stand
    is out of reach or has no contact forces in balance.
    """
    robot = load("v3")
    workspace = base_workspace(robot)
    x = workspace.intervals["x"]
    assert [limit.code for limit in workspace.limits["x"]] == ["workspace-ends-at-support"] * 2
    assert workspace.limits["height"][1].code == "workspace-ends-at-reach"
    tall = pa.solve_stand(robot, pa.StandTask(height=workspace.intervals["height"].high))
    foot = pa.Configuration(robot, tall.qpos).frame_jacobian(robot.contact_frames["FL"])
    leg = foot[:3, [6 + robot.joint_names.index(f"leg_front_l_{n}") for n in (1, 2, 3)]]
    assert np.linalg.svd(leg, compute_uv=False)[-1] < 0.01  # m/rad: the leg is stretched
    for value, sign in ((x.low, -1), (x.high, 1)):
        inside = pa.solve_stand(robot, pa.StandTask(offset=(value, 0.0)))
        assert pa.stance.stand_statics(robot, inside).com_margin >= 0
        beyond = pa.StandTask(offset=(value + sign * 2e-4, 0.0))
        if is_reached(robot, beyond):
            with pytest.raises(pa.StaticsInfeasibleError):
                pa.stance.stand_statics(robot, pa.solve_stand(robot, beyond))


@pytest.mark.slow
def test_workspace_of_a_tilted_task_is_inside_the_level_workspace() -> None:
    """Roll and pitch shorten the reachable height interval at both ends."""
    robot = load("v3")
    level = reachable_heights(robot)
    tilted = reachable_heights(robot, pa.StandTask(roll=0.2, pitch=0.1))
    assert level.low < tilted.low < tilted.high < level.high
    with pytest.raises(pa.StanceUnreachableError):
        reachable_heights(robot, pa.StandTask(height=1.0))
    assert base_workspace(robot, pa.StandTask(yaw=0.1)).start.task == replace(
        pa.StandTask(yaw=0.1), height=robot.stand_height, com="centre"
    )


def test_com_inside_stays_at_its_place_while_the_base_pitches() -> None:
    """Reference: the CoM of the start, which the task leaves anywhere inside the margin."""
    robot = load("v3")
    task = pa.StandTask(swing={"FL": 0.02}, com="inside", com_margin=0.01)
    start = pa.solve_stand(robot, task)
    pitched = _solve_at(robot, start, "pitch", 0.1, None, default_guesses_only=False)
    com, expected = (
        pa.Configuration(robot, stand.qpos).center_of_mass()[:2] for stand in (pitched, start)
    )
    np.testing.assert_allclose(com, expected, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("task", [{"com": "inside"}, {"offset": (0.0, 0.0)}])
def test_base_shift_ends_at_the_com_margin(task: dict[str, object]) -> None:
    """At both limits of x the CoM is as near to the edge of the support polygon as permitted."""
    robot = load("original")
    start = pa.solve_stand(robot, pa.StandTask(com_margin=0.065, **task))  # type: ignore[arg-type]
    free = find_interval(robot, pa.solve_stand(robot), "x")
    bound = find_interval(robot, start, "x")
    assert free.low < bound.low < bound.high < free.high
    for value in (bound.low, bound.high):
        stand = _solve_at(robot, start, "x", value, None, default_guesses_only=False)
        assert stand is not None
        com = pa.Configuration(robot, stand.qpos).center_of_mass()
        assert com_margin(com, stand.contact_points) == pytest.approx(0.065, abs=1e-4)


def test_highest_stand_has_straight_legs() -> None:
    """Closed form: a leg of 0.19 m, slightly inclined by the base offset of 5 mm, and a radius of
    0.018 m.
    """
    robot = load("original")
    heights = reachable_heights(robot)
    assert heights.high == pytest.approx(0.208, abs=3e-4)
    assert heights.high < 0.208
    stand = pa.solve_stand(robot, pa.StandTask(heights.high))
    assert np.hypot(heights.high - 0.018, stand.qpos[0]) == pytest.approx(0.19, abs=2e-4)
    assert is_reached(robot, pa.StandTask(heights.low))
    for height in (heights.low - 3e-4, heights.high + 3e-4):
        assert not is_reached(robot, pa.StandTask(height))


@pytest.mark.slow
def test_search_for_a_limit_ends_at_the_sufficient_distance() -> None:
    """Reference: the limits without a sufficient distance."""
    robot = load("original")
    start, complete = pa.solve_stand(robot), base_workspace(robot).intervals
    for direction, enough in (("pitch", 0.3), ("roll", 0.45), ("height", 0.02)):
        begin = float(getattr(start.task, direction))
        found = find_interval(robot, start, direction, enough)
        for limit, end, side in (
            (found.low, complete[direction].low, -1.0),
            (found.high, complete[direction].high, 1.0),
        ):
            if side * (end - begin) < enough:
                assert limit == pytest.approx(end, abs=1e-9)
            else:
                assert side * (limit - begin) >= enough


def test_base_welded_to_the_world_has_no_range() -> None:
    task = pa.StandTask(contacts={"base": pa.Weld()})
    for search in (base_workspace, reachable_heights):
        with pytest.raises(pa.ConfigurationError, match="welded to the world"):
            search(load("v3"), task)
