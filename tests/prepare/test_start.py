"""Initial configurations of the search for a start pose."""

from __future__ import annotations

import itertools
import math
import re
import shutil
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import shapely

import pupper_analysis as pa
from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import StanceUnreachableError
from pupper_analysis.prepare import start
from pupper_analysis.prepare.start import clip_to_limits
from pupper_analysis.robot.servos import list_position_servos
from pupper_analysis.stance.soft_ground import solve_stand_on_soft_ground
from tests.support import random_legged
from tests.support.legged import (
    biped,
    edit_pair,
    planar,
    quadruped,
    rewrite_file,
    shift_base_com,
)
from tests.support.slips import standing
from tests.support.variants import load, stand_of


def test_omitted_joints_are_at_zero_clipped_to_their_limits() -> None:
    robot = load("original")
    low, high = robot.lower_limits, robot.upper_limits
    np.testing.assert_array_equal(clip_to_limits(robot), np.clip(0.0, low, high))
    first, second = robot.joint_names[:2]
    expected = np.clip(0.0, low, high)
    expected[:2] = high[0], np.clip(0.1, low[1], high[1])
    np.testing.assert_array_equal(clip_to_limits(robot, {first: 99.0, second: 0.1}), expected)


@pytest.mark.slow
def test_keyframe_without_a_stand_is_replaced_by_a_reachable_height(
    tmp_path: Path,
) -> None:
    """In the keyframe the base would be 77 mm high, and legs overlap."""
    description = load("v3").description
    straight = "1 0 0 0 " + " ".join(["0"] * 12)
    folded = "1 0 0 0 " + " ".join(["0 0 0.7", "0 0 -0.7"] * 2)
    mjcf = tmp_path / "mjcf/robot.xml"
    mjcf.parent.mkdir()
    for part in description.mjcf_source.parent.glob("*.xml"):
        shutil.copy(part, mjcf.parent)
    mjcf.write_text(description.mjcf_source.read_text())
    rewrite_file(mjcf, (straight, folded))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # meshes are not beside it
        robot = pa.load_robot(description.urdf_source, mjcf, feet=description.contact_points)
    assert pa.solve_stand(robot).task.height == robot.stand_height == pytest.approx(0.139)
    assert "start-pose-found" in {note.code for note in robot.notes}


@pytest.mark.slow
def test_start_pose_allows_the_nominal_stand(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As for a biped that moves its CoM sideways only with bent legs.

    With the CoM anywhere inside the support polygon, the legs reach lower than with the CoM at the
    centre.
    """
    files = biped(tmp_path)
    usual, least = pa.load_robot(*files).stand_height, 0.70
    assert usual < least
    solve = start.solve_stand

    def solve_high(robot: pa.Robot, *args: Any, **others: Any) -> pa.Stand:
        if robot.stand_height < least:
            raise StanceUnreachableError("as if", {}, {})
        return solve(robot, *args, **others)

    monkeypatch.setattr(start, "solve_stand", solve_high)
    assert least < pa.load_robot(*files).stand_height < 0.8


@pytest.mark.slow
def test_feet_below_axes_about_the_vertical_are_put_aside(tmp_path: Path) -> None:
    """Feet below the first, vertical axes would turn the legs by large angles as the base moves.

    The joint ranges end at 57 degrees. Reference: turns below 0.2 rad in the stand.
    """
    files = random_legged.write_robot(random_legged.ring(40040, 3, 4.0), tmp_path)
    robot = pa.load_robot(files.urdf, files.mjcf)
    assert "start-pose-found" in {note.code for note in robot.notes}
    stand = pa.solve_stand(robot)
    turned = stand.joint_positions(robot)[::3]
    assert np.abs(turned).max() < 0.2
    assert stand.com_error < 1e-9


@pytest.mark.slow
def test_robot_without_a_stand_has_servos(tmp_path: Path) -> None:
    """A nominal stand is out of reach, since a box reaches deeper than the feet."""
    files = quadruped(tmp_path)
    deep = '<geom type="box" size="0.02 0.02 0.45"/><body name="FL_hip"'
    rewrite_file(files.mjcf, ('<body name="FL_hip"', deep))
    robot = pa.load_robot(*files)
    assert start.solve_nominal_stand(robot) is None
    assert list_position_servos(robot).keys() == set(robot.joint_names)
    assert {"no-start-pose", "servos-added"} <= {note.code for note in robot.notes}


@pytest.mark.parametrize(("friction", "stands"), [(0.06, False), (0.0613, True)])
def test_no_stand_is_searched_if_friction_cannot_carry_the_weight(
    friction: float, stands: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Reference: feet slide on level ground if friction < 0.6 / 9.81 = 0.06116, the ratio of the
    horizontal and the vertical part of gravity."""
    pair = standing(tmp_path)
    ice = f'priority="1" friction="{friction}" type="plane"'
    rewrite_file(pair.mjcf, ("<option ", '<option gravity="0.6 0 -9.81" '), ('type="plane"', ice))
    solved: list[pa.Robot] = []
    solve = start.solve_nominal_stand
    monkeypatch.setattr(
        start, "solve_nominal_stand", lambda robot: solved.append(robot) or solve(robot)
    )
    robot = pa.load_robot(*pair)
    assert ("no-start-pose" in {note.code for note in robot.notes}) is not stands
    solved.clear()
    assert (start.search_start(robot, [robot.home[7:]]) is not None) is stands
    assert bool(solved) is stands


@pytest.mark.slow
def test_keyframe_from_which_the_file_stands_is_the_start_pose(tmp_path: Path) -> None:
    """Its knee is 3 mrad beyond the limit, as G1's thumb in the Menagerie; bare MuJoCo stands."""
    pair = standing(tmp_path)
    rewrite_file(pair.mjcf, (" ".join(["0 0.6 -1.2"] * 4), " ".join(["0 0.6 -1.203"] * 4)))
    rewrite_file(pair.mjcf, ('range="-2.6 -0.4"', 'range="-1.2 -0.4"'))
    robot = pa.load_robot(*pair)
    codes = {note.code for note in robot.notes}
    assert codes >= {"start-pose-is-keyframe", "keyframe-beyond-limits"}
    (beyond,) = [note for note in robot.notes if note.code == "keyframe-beyond-limits"]
    assert "the start pose has these joints at their limits" in str(beyond)
    model = mujoco.MjModel.from_xml_path(str(pair.mjcf))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_step(model, data, nstep=2000)
    knees = robot.nominal[2::3]
    np.testing.assert_allclose(knees, -1.2)
    stand = pa.solve_stand_as_simulated(robot)
    assert stand.qpos[2] == pytest.approx(float(data.qpos[2]), abs=0.02)


@pytest.mark.slow
def test_joints_of_a_reversed_keyframe_beyond_their_limits_are_named(tmp_path: Path) -> None:
    """The keyframe with the opposite signs bends the knees the wrong way. Motors hold no pose.

    H1: the message was only that there was no keyframe with which a level stand exists.
    """
    pair = standing(tmp_path)
    rewrite_file(pair.mjcf, (" ".join(["0 0.6 -1.2"] * 4), " ".join(["0 -0.6 1.2"] * 4)))
    motors = re.sub(
        r'<position ([^>]*?) kp="[^"]*" kv="[^"]*"', r"<motor \1", pair.mjcf.read_text()
    )
    pair.mjcf.write_text(motors)
    robot = pa.load_robot(*pair)
    (beyond,) = [note for note in robot.notes if note.code == "keyframe-beyond-limits"]
    assert beyond.values["joints"] == tuple(f"{leg}_knee" for leg in ("FL", "FR", "RL", "RR"))
    assert beyond.values["excess"].value == pytest.approx(1.2 + 0.4)
    assert "stands from this keyframe" not in str(beyond)
    assert "start-pose-found" in {note.code for note in robot.notes}


@pytest.mark.slow
def test_only_the_preferred_keyframe_beyond_the_limits_is_named(tmp_path: Path) -> None:
    """A second keyframe such as "down" is no stand, and its joints are no fault of the file.

    Reference: the joint positions of both keyframes, beyond the limits of the knees.
    """
    pair = standing(tmp_path)
    poses = [" ".join([leg] * 4) for leg in ("0 0.6 -1.2", "0 -0.6 1.2", "0 1.5 -2.9")]
    rewrite_file(pair.mjcf, (poses[0], poses[1]))
    key = re.search(r"<key [^>]*/>", pair.mjcf.read_text())
    assert key is not None
    down = re.sub(r'name="\w+"', 'name="down"', key[0]).replace(poses[1], poses[2])
    assert 'name="down"' in down
    rewrite_file(pair.mjcf, (key[0], key[0] + down))
    motors = re.sub(
        r'<position ([^>]*?) kp="[^"]*" kv="[^"]*"', r"<motor \1", pair.mjcf.read_text()
    )
    pair.mjcf.write_text(motors)
    model = mujoco.MjModel.from_xml_path(str(pair.mjcf))
    assert (model.key_qpos[:, 9::3][:, 0] > -0.4).tolist() == [True, False]
    assert model.key_qpos[1, 9] < -2.6
    notes = [note for note in pa.load_robot(*pair).notes if note.code == "keyframe-beyond-limits"]
    assert [note.subject.name for note in notes if note.subject is not None] == ["home"]


@pytest.mark.slow
def test_a_keyframe_that_stands_but_has_no_level_stand_is_named(tmp_path: Path) -> None:
    """Reference: bare MuJoCo stands from the keyframe, whose knees are at their limits.

    The CoM is 57 mm in front of the centre of the feet. A base that is shifted by this distance
    needs longer legs at the same height.
    """
    pair = standing(tmp_path)
    pose = " ".join(["0 0.2 -0.4"] * 4)
    trunk = '<inertial pos="{} 0 0" mass="4" diaginertia="0.02 0.05 0.06"/>'
    text = pair.mjcf.read_text().replace(" ".join(["0 0.6 -1.2"] * 4), pose)
    text = text.replace(trunk.format(0), trunk.format(0.12))
    pair.mjcf.write_text(text.replace('qpos="0 0 0.35 ', 'qpos="0 0 0.411 '))
    model = mujoco.MjModel.from_xml_path(str(pair.mjcf))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_step(model, data, nstep=round(5.0 / model.opt.timestep))
    assert data.xpos[1, 2] == pytest.approx(0.411, abs=5e-3)
    assert data.xmat[1, 8] > math.cos(0.05)
    robot = pa.load_robot(pair.mjcf)
    messages = {note.code: str(note) for note in robot.notes}
    assert "start-pose-found" in messages
    assert messages["keyframe-without-stand"].startswith(
        "keyframe 'home': the robot stands from this keyframe"
    )
    assert "in which the robot stands" not in messages["start-pose-found"]


@pytest.mark.slow
@pytest.mark.parametrize("seed", [40000, 40005])
def test_soles_of_legs_with_five_joints_are_level_in_the_nominal_stand(
    seed: int, tmp_path: Path
) -> None:
    """Bent legs turn the soles otherwise than straight legs.

    Reference: in MuJoCo's model all bottom corners of both boxes are on the ground, and the CoM is
    inside their convex hull.
    """
    robot = pa.load_robot(*random_legged.write_robot(random_legged.irregular_biped(seed), tmp_path))
    stand = pa.solve_stand(robot)
    model, data = robot.mj_model, mujoco.MjData(robot.mj_model)
    robot.mj_convention.set_state(data, stand.qpos)
    mujoco.mj_forward(model, data)
    corners = [
        data.geom_xpos[geom] + data.geom_xmat[geom].reshape(3, 3) @ (model.geom_size[geom] * signs)
        for geom in np.flatnonzero((model.geom_type == 6) & (model.geom_contype != 0))
        for signs in ([1, 1, -1], [1, -1, -1], [-1, 1, -1], [-1, -1, -1])
    ]
    assert np.abs(np.array(corners)[:, 2]).max() < 1e-6
    area = shapely.MultiPoint(np.array(corners)[:, :2]).convex_hull
    assert area.contains(shapely.Point(data.subtree_com[0][:2]))


def test_searched_start_pose_lets_the_feet_penetrate_soft_ground(tmp_path: Path) -> None:
    """With 0.2 rad to the limits, only the highest stand is found: nearly straight legs.

    It is 22 mm below straight legs; the feet penetrate this ground by 32 mm.
    """
    pair = quadruped(tmp_path, floor=True, keyframe="")
    edit_pair(pair, {'lower="-2.6" upper="-0.4"': 'lower="-1.15" upper="0"'}, {})
    rewrite_file(pair.mjcf, ('range="-2.6 -0.4"', 'range="-1.15 0"'))
    rewrite_file(pair.mjcf, ('type="plane"', 'type="plane" solref="0.11 1" priority="1"'))
    robot = pa.load_robot(*pair)
    assert "start-pose-found" in {note.code for note in robot.notes}
    stand = solve_stand_on_soft_ground(robot)
    model, data = robot.mj_model, mujoco.MjData(robot.mj_model)
    robot.mj_convention.set_state(data, stand.qpos)
    mujoco.mj_forward(model, data)
    assert -data.contact.dist.min() == pytest.approx(0.032, abs=0.001)


@pytest.mark.slow
def test_level_soles_have_the_requested_height_within_the_joint_limits(tmp_path: Path) -> None:
    """Reference: Pinocchio's contact points at the found joint positions."""
    robot = pa.load_robot(*biped(tmp_path))
    for height in (0.9 * robot.stand_height, robot.stand_height):
        joints = start._level_soles(robot, clip_to_limits(robot), height, 0.05)
        assert joints is not None
        places = pa.Configuration(robot, robot.make_qpos(joints)).foot_positions()
        lowest = [place[2] - robot.contact_radius[point] for point, place in places.items()]
        assert lowest == pytest.approx([-height] * len(lowest), abs=1e-4 * height)
        assert (joints >= robot.lower_limits).all()
        assert (joints <= robot.upper_limits).all()
    assert start._level_soles(robot, clip_to_limits(robot), 9.0, 0.05) is None


def test_level_soles_are_searched_with_one_configuration_per_step(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Errors and derivative at the same joint positions share the forward kinematics."""
    robot = load("v3")
    visited: list[Array] = []

    class CountedConfiguration(pa.Configuration):
        def __init__(self, robot: pa.Robot, qpos: Array) -> None:
            super().__init__(robot, qpos)
            visited.append(self.qpos)

    monkeypatch.setattr(start, "Configuration", CountedConfiguration)
    assert start._level_soles(robot, clip_to_limits(robot), robot.stand_height, 0.05) is not None
    assert len(visited) > 4
    assert all((before != after).any() for before, after in itertools.pairwise(visited))


def test_stands_are_not_searched_for_wheels(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No joint moves the centre of a wheel: on TIAGo Pro the search took a minute without a result.

    Reference: the searches of Pupper v3, which has legs.
    """
    wheels = "".join(
        f'<body name="{x}{y}" pos="{x} {y} 0"><joint axis="0 1 0"/><geom size="0.1"/></body>'
        for x in (-0.3, 0.3)
        for y in (-0.2, 0.2)
    )
    path = tmp_path / "cart.xml"
    path.write_text(
        '<mujoco><worldbody><body name="cart" pos="0 0 0.1"><freejoint/>'
        f'<geom type="box" size="0.3 0.1 0.05"/>{wheels}</body></worldbody></mujoco>'
    )
    robot = pa.load_robot(path)
    searches: list[str] = []
    monkeypatch.setattr(start, "_search_poses", lambda *_: searches.append("poses"))
    monkeypatch.setattr(start, "_find_level_soles", lambda *_: searches.append("soles"))
    assert start.search_start(robot, [clip_to_limits(robot)]) is None
    assert searches == []
    assert start.search_start(load("v3"), [clip_to_limits(load("v3"))]) is None
    assert searches == ["poses", "poses", "soles"]


def test_stands_are_not_searched_if_no_contact_force_carries_the_weight(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two points have no support polygon, and negative friction permits no force. The searches took
    10 s and more, without a result. Reference: the nominal stand of the same joint positions.
    """
    robot = load("v3")
    on_two_points = pa.load_robot(*quadruped(tmp_path), feet=["FL_calf", "RR_calf"])
    contacts = {
        point: replace(contact, friction=(-1.0, -1.0, *contact.friction[2:]))
        for point, contact in robot.contacts.items()
    }
    searches: list[str] = []
    monkeypatch.setattr(start, "_search_poses", lambda *_: searches.append("poses"))
    monkeypatch.setattr(start, "_find_level_soles", lambda *_: searches.append("soles"))
    assert start.solve_nominal_stand(robot) is not None
    for hopeless in (on_two_points, replace(robot, contacts=contacts)):
        assert start.solve_nominal_stand(hopeless) is None
        assert start.search_start(hopeless, [hopeless.nominal]) is None
        assert searches == []


@pytest.mark.slow
def test_robot_with_a_foot_on_the_base_is_loaded(tmp_path: Path) -> None:
    """Three legs and the trunk as feet: the search of a start pose raised StopIteration."""
    pair = quadruped(tmp_path, actuators="position")
    feet = ["FL_calf", "FR_calf", "RL_calf", "trunk"]
    robot = pa.load_robot(*pair, feet=feet)
    assert set(robot.feet) == set(feet)


def test_start_keyframe_is_at_the_origin_and_has_the_height_of_the_stand() -> None:
    """The stand is moved by 10 and 20 mm; height and joints are rounded to micrometres and urad."""
    robot, stand = load("v3"), stand_of("v3")
    qpos = stand.qpos + np.array([0.01, 0.02, *np.zeros(len(stand.qpos) - 2)])
    keyframe = start.make_start_keyframe(
        robot, replace(stand, qpos=qpos), diagnose("start-pose-found", height=None)
    )
    data = mujoco.MjData(robot.mj_model)
    robot.mj_convention.set_state(data, qpos)
    np.testing.assert_allclose(keyframe.qpos[2:], data.qpos[2:], rtol=0, atol=5.1e-7)
    assert keyframe.qpos[:2] == (0.0, 0.0)
    assert keyframe.qpos[2] == round(qpos[2], 6)


@pytest.mark.slow
def test_legs_of_two_joints_stand_within_the_reach_of_forward_kinematics(tmp_path: Path) -> None:
    """Closed form: with the ankle at angle a, the base is l sin(a) + r above the ground.

    The hips only yaw and each ankle has one angle, so that height and horizontal position of a foot
    are not independent. The dimensions are those of RealAnt.
    """
    length, radius, reach = 0.1216, 0.032, 0.094
    legs = ""
    for number, (x, y) in enumerate(((1, 1), (-1, 1), (-1, -1), (1, -1))):
        legs += f"""<body pos="{reach * x} {reach * y} 0"><joint name="hip{number}" axis="0 0 1"
        range="-40 40"/><geom type="sphere" size="0.02" mass="0.03" contype="0" conaffinity="0"/>
        <body><joint name="ankle{number}" axis="{-y} {x} 0" range="30 100"/>
        <geom type="capsule" size="{radius}" mass="0.08"
        fromto="0 0 0 {length / 2**0.5 * x} {length / 2**0.5 * y} 0"/></body></body>"""
    motors = "".join(
        f'<motor joint="{part}{number}" ctrlrange="-10 10"/>'
        for number in range(4)
        for part in ("hip", "ankle")
    )
    path = tmp_path / "ant.xml"
    path.write_text(
        f"""<mujoco model="ant"><worldbody><geom name="floor" type="plane" size="9 9 1"/>
        <body name="torso" pos="0 0 0.3"><freejoint/><geom type="sphere" size="0.055" mass="1"/>
        {legs}</body></worldbody><actuator>{motors}</actuator></mujoco>"""
    )
    robot = pa.load_robot(mjcf=path)
    stand = pa.solve_stand(robot)
    joints = dict(zip(robot.joint_names, stand.joint_positions(robot), strict=True))
    for number in range(4):
        angle = joints[f"ankle{number}"]
        assert stand.qpos[2] == pytest.approx(length * math.sin(angle) + radius, abs=1e-6)
    assert pa.judge_stand(robot, stand).passed


@pytest.mark.slow
def test_legs_of_two_joints_stand_where_their_planes_are_tilted(tmp_path: Path) -> None:
    """The planes of the legs are tilted by 0.1 mrad, as by an angle of 1.5708 in a public URDF.

    At another height the feet move sideways, and the CoM is 10 mm aside: the feet were out of reach
    by 8 nm to 8 mm at every height. Reference: bare MuJoCo's feet, level at the solved joints.
    """
    pair = planar(quadruped(tmp_path, floor=True, actuators="position", keyframe=""))
    pair = shift_base_com(pair, 0.01)
    text = pair.mjcf.read_text()
    for side, tilt in (("L", 1e-4), ("R", -1e-4)):
        text = re.sub(rf'(<body name=".{side}_thigh" )', rf'\1euler="{tilt} 0 0" ', text)
    pair.mjcf.write_text(text)
    robot = pa.load_robot(mjcf=pair.mjcf, visuals=False)
    stand = pa.solve_stand(robot)
    model = mujoco.MjModel.from_xml_path(str(pair.mjcf))
    data = mujoco.MjData(model)
    for name, angle in zip(robot.joint_names, stand.joint_positions(robot), strict=True):
        data.qpos[model.jnt_qposadr[model.joint(name).id]] = angle
    data.qpos[2] = stand.task.height
    mujoco.mj_kinematics(model, data)
    spheres = [geom for geom in range(model.ngeom) if model.geom_rbound[geom] == 0.02]
    assert data.geom_xpos[spheres, 2] == pytest.approx([0.02] * 4, abs=1e-8)
