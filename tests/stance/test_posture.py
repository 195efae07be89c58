"""Postures of joints that carry no foot: kept in stands, with payloads and on paths; MuJoCo is the
reference.
"""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.robot.build import rebuild_robot
from pupper_analysis.robot.tool import with_payload
from pupper_analysis.stance.posture import find_posture
from tests.support import arm
from tests.support.random_legged import draw_robot, write_robot
from tests.support.variants import load


@pytest.mark.slow
def test_posture_of_a_tail_is_kept_and_changes_the_foot_forces(tmp_path: Path) -> None:
    """Three legs and a tail at two positions; MuJoCo's torques agree, and the tail's motor torque
    differs by more than 1e-3 N m."""
    pair = write_robot(draw_robot(57), tmp_path)
    robot = pa.load_robot(pair.urdf, pair.mjcf)
    tail = next(name for name in robot.joint_names if "wag" in name)
    index = robot.joint_names.index(tail)
    forces = {}
    for position in (-0.45, 0.4):
        task = pa.StandTask(posture={"*wag*": position})
        for loaded in (robot, with_payload(robot, 0.1)):
            stand = pa.solve_stand(loaded, task)
            assert stand.joint_positions(loaded)[index] == pytest.approx(position, abs=1e-9)
        stand = pa.solve_stand(robot, task)
        assert f"*wag* at {math.degrees(position):.4g} deg" in str(stand.task)
        assert pa.verify_stand(robot, stand, duration=2.0, nudged=0.0).torque_error < 2e-2
        forces[position] = pa.stance.stand_statics(robot, stand).joint_torques[index]
    assert abs(forces[-0.45] - forces[0.4]) > 1e-3
    # The next stand does not depend on the posture; a refusal does not relax the posture.
    assert abs(pa.solve_stand(robot).joint_positions(robot)[index]) < 0.1
    with pytest.raises(pa.StanceUnreachableError) as refused:
        pa.solve_stand(robot, pa.StandTask(height=5 * robot.stand_height, posture={tail: 0.3}))
    nearest = refused.value.nearest
    assert nearest is not None
    assert nearest.joint_positions(robot)[index] == pytest.approx(0.3, abs=1e-9)
    assert tail not in refused.value.at_limit
    leg = next(name for name in robot.joint_names if name != tail)
    for wrong, message in (
        ({leg: 0.1}, "carries a foot"),
        ({tail: 2.0}, "outside"),
        ({"x": 0.0}, tail),
    ):
        with pytest.raises((pa.ConfigurationError, pa.UnknownNameError), match=message):
            pa.solve_stand(robot, pa.StandTask(posture=wrong))
    # On a path, the joint moves monotonically between both positions.
    tasks = [pa.StandTask(posture={tail: -0.2}), pa.StandTask(posture={"*wag*": 0.4})]
    path = pa.stance.stance_path(robot, tasks, 2.0)
    angles, rates = path.qpos[:, 7 + index], path.qvel[:, 6 + index]
    assert angles[[0, -1]] == pytest.approx([-0.2, 0.4], abs=1e-9)
    assert np.diff(angles).min() > -1e-12
    assert np.gradient(angles, path.time)[5:-5] == pytest.approx(rates[5:-5], abs=2e-3)
    assert rates.max() == pytest.approx(0.6 / 2.0 * 15 / 8, rel=1e-6)  # of the minimum-jerk law


def test_weld_that_forces_a_joint_out_of_its_range_is_named(tmp_path: Path) -> None:
    """The elbow is straight at the zero angles of the file, and its range begins at 0.2 rad."""
    files = tmp_path / "arm.urdf", tmp_path / "arm.xml"
    weld = '<equality><weld name="bolt" body1="world" body2="hand"/></equality></mujoco>'
    texts = arm.URDF, arm.MJCF.replace("</mujoco>", weld)
    for file, text in zip(files, texts, strict=True):
        file.write_text(text)
    robot = pa.load_robot(*files)
    with pytest.raises(ConfigurationError) as refused:
        find_posture(robot)
    message = str(refused.value)
    assert re.search("elbow at -?0 deg, outside 11.46 deg to 137.5 deg", message)
    assert "weld bolt" in message
    assert "within the ranges" in message


def test_joints_without_limits_are_solved_with_different_margins() -> None:
    """Continuous joints have no limits; the margin of a previous task must not remain."""
    robot = load("v3")
    urdf = robot.description.urdf.replace('type="revolute"', 'type="continuous"')
    endless = rebuild_robot(robot, urdf=urdf)
    assert np.isinf(endless.upper_limits).all()
    tasks = [pa.StandTask(height=0.13, joint_margin=margin) for margin in (0.0, 0.1, 0.0)]
    assert all(stand.solved for stand in pa.solve_stands(endless, tasks))


def test_follower_with_a_wide_range_does_not_move_the_leader_out_of_its_range(
    tmp_path: Path,
) -> None:
    """Reference: the middle of the leader's range, and the coupling with factor 1.

    The range of the follower is ten times too wide, as in a published file of a gripper.
    """
    fingers = "".join(
        f'<link name="{name}"><inertial><mass value="0.1"/><inertia ixx="1e-4" iyy="1e-4" '
        'izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        f'<joint name="{name}" type="prismatic"><parent link="palm"/><child link="{name}"/>'
        f'<axis xyz="0 {sign} 0"/><limit lower="0.03" upper="{upper}" effort="9" velocity="1"/>'
        f"{mimic}</joint>"
        for name, sign, upper, mimic in (
            ("left", 1, 0.11, ""),
            ("right", -1, 1.1, '<mimic joint="left" multiplier="1" offset="0"/>'),
        )
    )
    path = tmp_path / "gripper.urdf"
    path.write_text(f'<robot name="gripper"><link name="palm"/>{fingers}</robot>')
    posture = find_posture(pa.load_robot(path, fixed_base=True))
    np.testing.assert_allclose(posture.qpos, 0.07, atol=1e-9)


def test_base_that_falls_on_undriven_joints_is_not_held() -> None:
    """A planar hopper was held by a servo that was added to its vertical slide."""
    robot = pa.load_robot(mjcf=PLANAR)
    message = "its base falls on the joints rise, tilt, which no motor drives"
    with pytest.raises(ConfigurationError, match=message):
        find_posture(robot)
    robot.complete_stages()
    assert {servo.joint for servo in robot.description.made_servos} >= {"rise", "tilt"}
    with pytest.raises(ConfigurationError, match=message):
        find_posture(robot)
    with pytest.raises(ConfigurationError, match=message):
        pa.solve_stand(robot)


PLANAR = """<mujoco model="hopper"><worldbody><body name="torso" pos="0 0 1">
  <joint name="rise" type="slide" axis="0 0 1"/><joint name="tilt" axis="0 1 0"/>
  <geom size="0.1" mass="1"/><body name="shin" pos="0 0 -0.3">
  <joint name="knee" axis="0 1 0" range="-1 1" limited="true"/>
  <geom size="0.05" mass="0.1"/></body></body></worldbody>
  <actuator><motor joint="knee" ctrlrange="-9 9" ctrllimited="true"/></actuator></mujoco>"""
"""Robot whose torso rises and tilts without motors."""
