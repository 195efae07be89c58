"""Response map of a walking policy: achieved velocities and dead zones."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.tools.walk.document import response_document
from pupper_analysis.tools.walk.gait import simulate_walk
from pupper_analysis.tools.walk.policy import Policy
from pupper_analysis.tools.walk.response import ResponseAxis, ResponseMap, map_response
from tests.support.commands import run_command
from tests.support.variants import load
from tests.tools.walk import made

GRID = np.arange(-5, 6) / 5


def make_axis(achieved: np.ndarray, fallen: np.ndarray | None = None) -> ResponseAxis:
    none = np.zeros(len(GRID), dtype=np.int64)
    return ResponseAxis("left", GRID, achieved, 0 * achieved, none if fallen is None else fallen)


@pytest.mark.parametrize(
    ("low", "high"), [(0.0, 0.0), (-0.2, 0.0), (0.0, 0.4), (-0.6, 0.2), (-1.0, 1.0)]
)
def test_dead_zone_is_the_range_of_commands_without_response(low: float, high: float) -> None:
    """Closed form: nothing is achieved within the zone, 90 % outside."""
    dead = np.array([low - 1e-9 <= command <= high + 1e-9 for command in GRID])
    assert make_axis(np.where(dead, 0.0, 0.9 * GRID)).dead_zone == pytest.approx((low, high))


def test_wrong_direction_is_a_dead_zone_and_a_fall_is_not() -> None:
    assert make_axis(-0.5 * GRID).dead_zone == pytest.approx((-1.0, 1.0))
    fallen = np.where(GRID > 0, 1, 0)
    achieved = np.where(GRID > 0, np.nan, 0.9 * GRID)
    axis = make_axis(achieved, fallen)
    assert axis.dead_zone == (0.0, 0.0)
    whole = ResponseMap("v3", "p", (axis,), 1, 5.0, ())
    assert not whole.passed
    shown = response_document(whole)
    assert "0.2, 0.4" in str(shown.findings[0])
    assert replace(whole, axes=(make_axis(0.9 * GRID),)).passed


@pytest.mark.slow
def test_achieved_velocities_equal_single_walks(tmp_path: Path) -> None:
    """Reference: `simulate_walk` for single commands; the gate of the policy closes at zero."""
    policy, robot = Policy.load(made.trot(tmp_path / "trot.json")), load("v3")
    found = map_response(robot, policy, (0.13, 0, 0), seconds=3.0, workers=1)
    (axis,) = found.axes
    assert axis.axis == "forward"
    for index in (0, 5, 10):
        command = (float(axis.commanded[index]), 0, 0)
        gait = simulate_walk(robot, policy, command, seconds=3.0, warm_up=1.5).gaits[0]
        assert axis.achieved[index] == gait.velocity[0]
    assert axis.achieved[10] > 0.05
    assert (
        found.to_json()
        == map_response(robot, policy, (0.13, 0, 0), seconds=3.0, workers=2).to_json()
    )


def test_invalid_limits_are_refused(tmp_path: Path) -> None:
    policy = Policy.load(made.write_standing_policy(tmp_path / "still.json"))
    for limits in ((1.0, 1.0), (float("nan"), 0, 0), (1e3, 0, 0), (0, 0, 0)):
        with pytest.raises(ConfigurationError):
            map_response(load("v3"), policy, limits)


@pytest.mark.slow
def test_command_maps_the_response_of_a_policy_that_stands(
    capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """A standing policy ignores all commands."""
    policy, page = made.write_standing_policy(tmp_path / "still.json"), tmp_path / "map.html"
    words = ("walk", "v3", "--policy", str(policy), "--response", "--command", "0.5,0,0")
    status, out, err = run_command(capfd, *words, "--seconds", "3", "--report", str(page))
    assert status == 1, err
    assert out.startswith("IGNORES COMMANDS v3 by still.json: dead zone forward")
    assert "from -0.5 to 0.5 m/s" in out
    assert "achieved = commanded" in page.read_text(encoding="utf-8")
