"""Points of links, sites and bodies that carry payloads, in both engines' models."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest

import pupper_analysis as pa
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.tool import find_tool, with_payload
from pupper_analysis.robot.touching import with_contacts
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
        placed = [Configuration(robot, qpos) for qpos in moved]
        heights.append(
            [
                (config.frame_position(link) + config.frame_rotation(link) @ place)[2]
                for config in placed
            ]
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
    first, second = (pa.Configuration(model, qpos).mass_matrix() for model in (once, twice))
    np.testing.assert_allclose(second, first, atol=1e-12)


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


TURNED_INERTIAL = """<inertial><mass value="1"/>
<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>"""

TURNED_URDF = f"""<robot name="arm"><link name="stem">{TURNED_INERTIAL}</link>
<link name="arm">{TURNED_INERTIAL}</link>
<joint name="pan" type="revolute"><parent link="stem"/><child link="arm"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" effort="9" velocity="9"/></joint>
<link name="flange"/><joint name="bolt" type="fixed"><parent link="arm"/><child link="flange"/>
<origin xyz="0.2 0.1 0.3" rpy="0.4 -0.7 1.2"/></joint></robot>"""

TURNED_MJCF = """<mujoco><compiler angle="radian"/><worldbody><body name="stem">
<inertial pos="0 0 0" mass="1" diaginertia="0.01 0.01 0.01"/><body name="arm">
<joint name="pan" axis="0 0 1" range="-1 1"/>
<inertial pos="0 0 0" mass="1" diaginertia="0.01 0.01 0.01"/>
<body name="plate" pos="0.1 0 0.2" euler="0.9 0.5 0.1"><geom name="cover" type="box" mass="0"
size="0.1 0.1 0.1" pos="0.1 0.2 0" euler="-0.8 0.3 0.6"/>
<site name="palm" pos="0.2 0 0.1" euler="0.3 1.1 -0.6"/></body></body></body></worldbody>
<actuator><position joint="pan" kp="100" kv="10"/></actuator></mujoco>"""


def load_turned_arm(folder: Path, *, visuals: bool = True) -> pa.Robot:
    """Write and load an arm with frames that are rotated against its only moving link."""
    (folder / "arm.urdf").write_text(TURNED_URDF)
    (folder / "arm.xml").write_text(TURNED_MJCF)
    return pa.load_robot(folder / "arm.urdf", folder / "arm.xml", visuals=visuals)


@pytest.mark.parametrize("frame", ["palm", "plate", "cover", "flange"])
def test_a_place_in_a_named_frame_is_along_the_axes_of_this_frame(
    tmp_path: Path, frame: str
) -> None:
    """Reference: MuJoCo's pose of the site, body or geom; Pinocchio's pose of the URDF link.

    The payload adds m p to the mass moment, which locates the payload in both models.
    """
    robot = load_turned_arm(tmp_path)
    mass, offset = 2.0, np.array([0.03, -0.05, 0.07])
    data = mujoco.MjData(robot.mj_model)
    data.qpos[:] = robot.neutral()
    mujoco.mj_kinematics(robot.mj_model, data)
    if frame == "flange":
        pin_data = robot.pin_model.createData()
        pin.framesForwardKinematics(robot.pin_model, pin_data, pin.neutral(robot.pin_model))
        pose = pin_data.oMf[robot.pin_model.getFrameId(frame)]
        rotation, position = pose.rotation, pose.translation
    else:
        kind = {"palm": data.site, "plate": data.body, "cover": data.geom}[frame](frame)
        rotation, position = kind.xmat.reshape(3, 3), kind.xpos
    expected = position + rotation @ offset
    loaded = with_payload(robot, mass, (frame, *offset))
    moments = [
        Configuration(model, model.neutral()).center_of_mass() * model.total_mass
        for model in (robot, loaded)
    ]
    np.testing.assert_allclose(moments[1] - moments[0], mass * expected, atol=1e-9)
    loaded_data = mujoco.MjData(loaded.mj_model)
    mujoco.mj_forward(loaded.mj_model, loaded_data)
    np.testing.assert_allclose(loaded_data.body("payload").xpos, expected, atol=1e-9)


def test_a_hand_touches_at_its_offset_along_the_axes_of_the_named_site(tmp_path: Path) -> None:
    """Reference: MuJoCo's pose of the site, and the position of the contact point of the hand."""
    robot, offset = load_turned_arm(tmp_path), (0.03, -0.05, 0.07)
    held = with_contacts(robot, {"base": pa.Weld(), "palm": pa.Weld(offset=offset)})
    data = robot.compute_kinematics()
    expected = data.site("palm").xpos + data.site("palm").xmat.reshape(3, 3) @ offset
    config = Configuration(held, held.neutral())
    contact = config.foot_positions()["palm"] - config.frame_position("stem")
    np.testing.assert_allclose(contact, expected, atol=1e-9)


def test_a_hand_of_a_robot_that_is_not_drawn_has_its_ball(tmp_path: Path) -> None:
    """The ball collides with no geom of the arm, so that MuJoCo's ``discardvisual`` removed it."""
    robot = load_turned_arm(tmp_path, visuals=False)
    table = pa.Contact(pa.Plane((0.0, 0.0, 1.0), (0.0, 0.0, 0.1), 0.5), radius=0.02)
    held = with_contacts(robot, {"base": pa.Weld(), "palm": table})
    balls = {foot: geom for geom, foot in held.foot_geoms.items()}
    assert held.mj_model.geom_size[balls["palm"], 0] == 0.02
