"""One stance has one answer: every command, page and function tells the same numbers of it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.tools.live.model import Model, predict_sag, simulate_stance
from pupper_analysis.tools.live.state import LiveVariants, State
from tests.support.commands import answer as run_command
from tests.support.variants import load

ROLL = 4.0  # deg: unequal loads, so that on soft ground angles are others than on rigid ground
TASK = pa.StandTask(roll=np.radians(ROLL))


def answer(folder: Path, *arguments: str) -> dict[str, Any]:
    done = run_command(*arguments, "--json", "it.json", folder=folder)
    assert done.returncode in (0, 1), done.stderr
    found: dict[str, Any] = json.loads((folder / "it.json").read_text())
    return found


@pytest.mark.longest
def test_commands_page_and_interface_tell_the_same_of_a_stance(tmp_path: Path) -> None:
    robot = load("v3")
    stand = pa.stance.solve_stand_as_simulated(robot, TASK)
    held, rest = pa.stance.stand_statics(robot, stand), pa.steady_state(robot, stand)
    rigid = pa.stance.stand_statics(robot, pa.solve_stand(robot, TASK))
    assert np.abs(rigid.joint_torques - held.joint_torques).max() > 0.01  # it matters which

    one = answer(tmp_path, "stand", "v3", "--roll", f"{ROLL}deg")
    asked = ("analyze", "v3", "--roll", str(TASK.roll), "--no-figures")
    other = answer(tmp_path, *asked)["variants"]["v3"]
    live = Model(LiveVariants(pa.VARIANTS["v3"])).answer(State(roll=ROLL))
    played, settled = simulate_stance(live), predict_sag(live).settled
    assert live.stand is not None
    assert live.statics is not None
    assert settled is not None

    angles = stand.joint_positions(robot)
    assert one["joint_positions"] == pytest.approx(angles, abs=1e-12)
    for qpos in (one["stand"]["qpos"], other["stand"]["qpos"], live.stand.qpos):
        assert qpos == pytest.approx(stand.qpos, abs=1e-12)
    for torques in (one["statics"]["joint_torques"], other["statics"]["joint_torques"],
                    live.statics.joint_torques):  # fmt: skip
        assert torques == pytest.approx(held.joint_torques, abs=1e-12)
    for height in (one["settled"]["base_height"], settled.base_height):
        assert height == pytest.approx(rest.base_height, abs=1e-12)
    for which, run in (("verification", played.verification), ("sagging", played.sagging)):
        for content in (one[which], other[which]):
            assert content["base_height"] == pytest.approx(run.base_height, abs=1e-9)
            assert content["joint_torques"] == pytest.approx(run.joint_torques, abs=1e-9)
    assert one["verdict"]["code"] == other["verdict"]["code"] == played.verdict.code
    # What is predicted is what is simulated: of one and the same stand, each way.
    assert played.verification.joint_torques == pytest.approx(held.joint_torques, abs=1e-6)
    assert played.sagging.base_height == pytest.approx(rest.base_height, abs=5e-4)


def test_out_of_reach_on_soft_ground_it_is_the_stand_on_rigid_ground() -> None:
    """Legs that are straight on rigid ground do not reach down by what feet sink."""
    robot = load("v3")
    highest = pa.stance.reachable_heights(robot).high
    stand = pa.stance.solve_stand_as_simulated(robot, pa.StandTask(height=highest - 1e-5))
    assert not any(stand.depths.values())
    with pytest.raises(pa.StanceUnreachableError):
        pa.stance.solve_stand_on_soft_ground(
            robot, pa.StandTask(height=highest - 1e-5), explain=False
        )
