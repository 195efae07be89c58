"""Points of a robot that carry: of links, sites and bodies, in both models."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.tool import find_tool, with_payload
from pupper_analysis.simulation.verify import load_by_mujoco
from tests.support.variants import load


@pytest.mark.parametrize("frame", ["leg_front_l_2", "leg_back_r_3_foot_site"])
def test_a_payload_on_a_link_weighs_where_it_is_in_both_models(frame: str) -> None:
    """By virtual work: it adds m |g| times the rate at which its point rises."""
    robot, mass, place = load("v3"), 0.3, np.array([0.01, -0.02, 0.03])
    loaded = with_payload(robot, mass, find_tool(robot, frame).moved(place))
    random = np.random.default_rng(4)
    qpos = robot.home + random.uniform(-0.3, 0.3, robot.nq)
    qpos[3:7] /= np.linalg.norm(qpos[3:7])
    link, step = find_tool(robot, frame).link, 1e-6
    heights = []
    for way in (step, -step):
        moved = np.tile(qpos, (robot.nu, 1))
        moved[:, 7:] += way * np.eye(robot.nu)
        placed = [Configuration(robot, one) for one in moved]
        heights.append(
            [(one.frame_position(link) + one.frame_rotation(link) @ place)[2] for one in placed]
        )
    rises = (np.array(heights[0]) - heights[1]) / (2 * step)
    added = Configuration(loaded, qpos).load() - Configuration(robot, qpos).load()
    weight = mass * float(np.linalg.norm(robot.gravity))
    assert added[2] == pytest.approx(weight)
    assert added[6:] == pytest.approx(weight * rises, abs=1e-8)
    assert np.abs(added[6:]).max() > 1e-3
    assert load_by_mujoco(loaded, qpos) == pytest.approx(
        Configuration(loaded, qpos).load(), abs=1e-9
    )
    assert loaded.total_mass == pytest.approx(robot.total_mass + mass)
    with pytest.raises(pa.UnknownNameError, match="leg_front_l_2"):
        find_tool(robot, "hand")


TWO_AT_ONE = """<mujoco><worldbody><body name="arm"><joint name="pan" axis="0 0 1"/>
<joint name="tilt" axis="0 1 0"/><geom size="0.05" pos="0.3 0 0" mass="1"/>
<site name="end" pos="0.5 0 0"/></body></worldbody>
<actuator><position joint="pan" kp="100" kv="10"/>
<position joint="tilt" kp="100" kv="10"/></actuator>
</mujoco>"""


def test_a_body_with_two_joints_moves_with_both(tmp_path: Path) -> None:
    """What is on it is behind the second one."""
    (tmp_path / "two.xml").write_text(TWO_AT_ONE)
    robot = pa.load_robot(tmp_path / "two.xml")
    tool, tilt = find_tool(robot, "end"), 0.4
    assert tool.chain == ("pan", "tilt")
    place = tool.position(Configuration(robot, np.array([0.0, tilt])))
    assert place == pytest.approx([0.5 * np.cos(tilt), 0.0, -0.5 * np.sin(tilt)], abs=1e-12)
