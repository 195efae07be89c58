"""Points of links, sites and bodies that carry payloads, in both engines' models."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.tool import find_tool, with_payload
from tests.support.engines import evaluate_mujoco, load_by_mujoco
from tests.support.repository import ROOT
from tests.support.states import random_state
from tests.support.variants import NAMES, load

MJCF = ROOT / "mjcf/pupper_skeleton.xml"


@pytest.mark.parametrize("frame", ["leg_front_l_2", "leg_back_r_3_foot_site"])
def test_payload_on_a_link_adds_the_torque_of_virtual_work_in_both_models(frame: str) -> None:
    """Reference: virtual work, m g times the vertical Jacobian of the point."""
    robot, mass, place = load("v3"), 0.3, np.array([0.01, -0.02, 0.03])
    loaded = with_payload(robot, mass, find_tool(robot, frame).translated(place))
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
    added = Configuration(loaded, qpos).static_load() - Configuration(robot, qpos).static_load()
    weight = mass * float(np.linalg.norm(robot.gravity))
    assert added[2] == pytest.approx(weight)
    assert added[6:] == pytest.approx(weight * rises, abs=1e-8)
    assert np.abs(added[6:]).max() > 1e-3
    ours = Configuration(loaded, qpos).static_load()
    assert load_by_mujoco(loaded, qpos) == pytest.approx(ours, abs=1e-9)
    assert loaded.total_mass == pytest.approx(robot.total_mass + mass)
    with pytest.raises(pa.UnknownNameError, match="no frame 'hand'") as caught:
        find_tool(robot, "hand")
    assert "leg_front_l_2" in caught.value.known


POINT = (0.05, -0.02, 0.08)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_payload_is_equal_in_both_models(name: str) -> None:
    """Reference: `cross_check`, and MuJoCo's bias forces [N, N m]; the total mass grows by 2.5
    kg.
    """
    loaded = with_payload(load(name), 2.5, POINT)
    check = pa.cross_check(loaded)
    assert check.passed, check.worst
    qpos, qvel = random_state(loaded, 1)
    data = evaluate_mujoco(loaded, qpos, qvel)
    config = pa.Configuration(loaded, qpos, qvel)
    index = loaded.mj_convention.qvel_index
    np.testing.assert_allclose(config.bias_forces(), data.qfrc_bias[index], atol=1e-9)
    assert loaded.total_mass == pytest.approx(load(name).total_mass + 2.5, abs=1e-12)


def test_a_payload_keeps_changed_effort_limits() -> None:
    """Halved effort limits remain; two payloads of 1 kg equal one of 2 kg in the mass matrix."""
    robot = load("v3")
    model = robot.pin_model.copy()
    efforts = np.array(model.effortLimit)
    efforts[6:] /= 2
    model.effortLimit = efforts
    weak = replace(robot, pin_model=model)
    loaded = with_payload(weak, 1.0, POINT)
    np.testing.assert_array_equal(loaded.effort_limits, robot.effort_limits / 2)
    assert loaded.joint_names == robot.joint_names
    assert loaded.stand_height == robot.stand_height
    assert loaded.contact_points == robot.contact_points
    assert with_payload(robot, 0.0) is robot
    twice = with_payload(with_payload(robot, 1.0, POINT), 1.0, POINT)
    once = with_payload(robot, 2.0, POINT)
    qpos, _ = random_state(robot, 3)
    one, two = (pa.Configuration(each, qpos).mass_matrix() for each in (once, twice))
    np.testing.assert_allclose(two, one, atol=1e-12)


def test_payload_on_a_fixed_base_or_at_an_invalid_point_is_refused() -> None:
    with pytest.raises(pa.ConfigurationError, match="fixed base"):
        with_payload(load("v3", fixed_base=True), 1.0)
    with pytest.raises(pa.ConfigurationError, match="point"):
        with_payload(load("v3"), 1.0, (0.0, 0.0))


@pytest.mark.slow
@pytest.mark.parametrize("frame", ["geom_1", "FL_foot"])
def test_payload_on_a_geom_shifts_the_com_by_its_place_in_mujoco(frame: str) -> None:
    """A geom of a free base, and of a leg.

    Reference: the pose of the geom in MuJoCo's data, and m p = (M + m) c' - M c.
    """
    robot, mass, offset = pa.load_robot(MJCF), 1.0, (0.01, 0.0, 0.0)
    loaded = with_payload(robot, mass, (frame, *offset))
    model = robot.mj_model
    data = mujoco.MjData(model)
    data.qpos[:] = robot.neutral()
    mujoco.mj_kinematics(model, data)
    geom = data.geom(frame)
    expected = geom.xpos + geom.xmat.reshape(3, 3) @ offset
    before = Configuration(robot, robot.neutral()).center_of_mass() * robot.total_mass
    after = Configuration(loaded, loaded.neutral()).center_of_mass() * loaded.total_mass
    np.testing.assert_allclose(after - before, mass * expected, atol=1e-9)


TWO_HINGES = """<mujoco><worldbody><body name="arm"><joint name="pan" axis="0 0 1"/>
<joint name="tilt" axis="0 1 0"/><geom size="0.05" pos="0.3 0 0" mass="1"/>
<site name="end" pos="0.5 0 0"/></body></worldbody>
<actuator><position joint="pan" kp="100" kv="10"/>
<position joint="tilt" kp="100" kv="10"/></actuator>
</mujoco>"""


def test_tool_on_a_body_with_two_hinges_moves_with_both(tmp_path: Path) -> None:
    """Reference: closed form of the position at a tilt of 0.4 rad."""
    (tmp_path / "two.xml").write_text(TWO_HINGES)
    robot = pa.load_robot(tmp_path / "two.xml")
    tool, tilt = find_tool(robot, "end"), 0.4
    assert tool.chain == ("pan", "tilt")
    position = tool.position(Configuration(robot, np.array([0.0, tilt])))
    assert position == pytest.approx([0.5 * np.cos(tilt), 0.0, -0.5 * np.sin(tilt)], abs=1e-12)
