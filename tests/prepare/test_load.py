"""Published robots stand without manual preparation: MuJoCo's simulation is the reference."""

from __future__ import annotations

import itertools
import math
import re
from pathlib import Path

import mujoco
import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.base.errors import PupperAnalysisError
from pupper_analysis.prepare import drives
from pupper_analysis.prepare.feet import report_sideways_limbs
from pupper_analysis.robot.robot import Robot
from tests.support.conversions import write_standing_urdf
from tests.support.legged import Pair, biped, from_the_ground, fuse_trunk, quadruped, rewrite_file


def load(pair: Pair, **values: object) -> Robot:
    return pa.load_robot(*pair, **values)  # type: ignore[arg-type]


def find_note(robot: Robot, text: str) -> str:
    """Return the text of the first note that contains a text; fail if there is none."""
    found = [note for note in robot.notes if text in str(note)]
    assert found, robot.notes
    return str(found[0])


def verify_held_stand(robot: Robot) -> pa.simulation.StandVerification:
    """Return the verification of a stand; assert relative torque and force errors below 1e-5."""
    found = pa.verify_stand(robot, pa.stance.solve_stand_on_soft_ground(robot))
    assert found.passed, found.failures
    assert found.torque_error < 1e-5
    assert found.force_error < 1e-5
    return found


def test_limbs_attached_to_the_world_are_not_a_fixed_base(tmp_path: Path) -> None:
    """MuJoCo's own conversion of a URDF has no body for the root link, and loses its mass."""
    robot = load(fuse_trunk(quadruped(tmp_path, keyframe="", floor=True)))
    assert not robot.floating
    (held,) = (note for note in robot.notes if note.code == "base-kept-in-the-world")
    assert "attaches the limbs to the world" in str(held)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "frame"),
    [("own", "own"), ("a geom", "toe"), ("a link and a body", ("FL_calf", "FL_calf"))],
)
def test_feet_named_in_one_file_are_used_for_both(name: str, frame: object, tmp_path: Path) -> None:
    """Reference: foot position (0.2, 0.15, -0.4) m at zero angles, by hand, and the radius of the
    sphere.
    """
    foot = '<geom name="{}" type="sphere" size="0.02" pos="0 0 -0.2"/>'
    pair = quadruped(tmp_path, foot="@")
    text = pair.mjcf.read_text()
    for leg in ("FL", "FR", "RL", "RR"):
        text = text.replace("@", foot.format(f"{leg}_toe"), 1)
    pair.mjcf.write_text(text)
    feet: dict[str, object] = {leg: f"{leg}_toe" for leg in ("FL", "FR", "RL", "RR")}
    if isinstance(frame, tuple):
        feet["FL"] = frame
    robot = load(pair, feet=feet)
    assert set(robot.feet) == {"FL", "FR", "RL", "RR"}
    place = pa.Configuration(robot, robot.neutral()).foot_positions()["FL"]
    np.testing.assert_allclose(place, [0.2, 0.15, -0.4], atol=1e-12)
    assert robot.contact_radius["FL"] == 0.02


@pytest.mark.slow
def test_quadruped_without_named_feet_floor_and_servos_is_completed_and_stands(
    tmp_path: Path,
) -> None:
    """Reference: MuJoCo holds the predicted stand."""
    robot = load(quadruped(tmp_path))
    assert set(robot.feet) == {"FL_calf", "FR_calf", "RL_calf", "RR_calf"}
    assert "FL_calf on FL_calf" in find_note(robot, "feet detected")
    assert "'home'" in find_note(robot, "start pose")
    find_note(robot, "a plane with MuJoCo's default contact was added")
    find_note(robot, "no position servos")
    assert verify_held_stand(robot).torque_error < 1e-6
    swing = {"FL_calf": 0.02, "RR_calf": 0.02}
    with pytest.raises(pa.ConfigurationError, match="at least 3, or a flat foot, are required"):
        pa.solve_stand(robot, pa.StandTask(swing=swing))


@pytest.mark.slow
@pytest.mark.parametrize(
    "keyframe", ["", "0 2.4 -2.6", "0 0.1 0.4"], ids=["none", "lies", "beyond"]
)
def test_start_pose_without_a_usable_keyframe_is_found(keyframe: str, tmp_path: Path) -> None:
    """The keyframe is missing, lies on the ground, or is beyond the joint limits."""
    robot = load(quadruped(tmp_path, keyframe=keyframe))
    assert "a stand was found" in find_note(robot, "keyframe")
    assert len(robot.feet) == 4
    assert (robot.home[7:] > robot.lower_limits).all()
    assert (robot.home[7:] < robot.upper_limits).all()
    if not keyframe:
        verify_held_stand(robot)


@pytest.mark.slow
def test_start_pose_is_that_of_the_keyframe(tmp_path: Path) -> None:
    """Closed form: two links of 0.2 m, 0.7 rad from the vertical, on a sphere of 0.02 m."""
    robot = load(quadruped(tmp_path, keyframe="0 0.7 -1.4"))
    np.testing.assert_allclose(robot.home[7:], [0, 0.7, -1.4] * 4)
    assert robot.stand_height == pytest.approx(0.4 * np.cos(0.7) + 0.02)


@pytest.mark.slow
def test_servos_and_floor_of_the_file_are_kept(tmp_path: Path) -> None:
    robot = load(quadruped(tmp_path, actuators="position", floor=True))
    assert not [note for note in robot.notes if "servos" in str(note) or "plane" in str(note)]
    assert robot.mj_model.actuator_gainprm[0, 0] == 150
    verify_held_stand(robot)


@pytest.mark.slow
def test_base_without_free_joint_is_freed_unless_fixed_base_is_requested(tmp_path: Path) -> None:
    pair = quadruped(tmp_path, free=False)
    robot = load(pair)
    assert robot.floating
    find_note(robot, "a free joint was added")
    verify_held_stand(robot)
    held = load(pair, fixed_base=True)
    assert not held.floating
    assert not held.feet


@pytest.mark.slow
def test_foot_box_of_a_leg_with_three_joints_has_one_contact_point(tmp_path: Path) -> None:
    """Such a leg cannot keep the box flat: the lowest corner of the start pose touches."""
    box = '<geom type="box" size="0.02 0.02 0.02" pos="0 0 -0.2"/>'
    robot = load(quadruped(tmp_path, foot=box))
    assert all(len(points) == 1 for points in robot.feet.values())


def test_limbs_without_shapes_are_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(pa.ModelError, match=r"no feet were found.*FL_calf"):
        load(quadruped(tmp_path, foot=""))


@pytest.mark.slow
def test_foot_shape_of_the_mjcf_counts_if_the_urdf_has_a_cylinder(tmp_path: Path) -> None:
    """As on B2 and M20, whose MJCF has spheres: a leaning cylinder would be in the ground."""
    pair = quadruped(tmp_path, keyframe="")
    text = pair.urdf.read_text()
    for leg in ("FL", "FR", "RL", "RR"):
        shape = (
            '<origin xyz="0 0 -0.2" rpy="1.5707963 0 0"/>'
            '<geometry><cylinder radius="0.02" length="0.03"/></geometry>'
        )
        head = f'<link name="{leg}_calf">'
        assert head in text
        text = text.replace(head, f"{head}<collision>{shape}</collision>")
    pair.urdf.write_text(text)
    robot = load(pair)
    find_note(robot, "a stand was found")
    verify_held_stand(robot)
    pa.solve_stand(robot, pa.StandTask(roll=0.1))
    long = '<geom type="cylinder" size="0.02 0.15" euler="1.5707963 0 0" pos="0 0 -0.188"/>'
    rewrite_file(pair.mjcf, ('pos="0 0 -0.2"/>', f'pos="0 0 -0.2"/>{long}'))
    with pytest.raises(pa.StanceUnreachableError, match=r"calf penetrates the ground by .* mm"):
        pa.solve_stand(load(pair), pa.StandTask(offset=(0.0, 0.06)))


@pytest.mark.slow
def test_flat_foot_is_lifted_as_a_whole(tmp_path: Path) -> None:
    """Each contact point of the foot is 30 mm above the ground; the other foot has all forces."""
    robot = load(biped(tmp_path))
    task = pa.StandTask(swing={"left_tilt_link": 0.03}, com="inside", com_margin=0.005)
    stand = pa.solve_stand(robot, task)
    centres = pa.Configuration(robot, stand.qpos).foot_positions()
    for point in robot.feet["left_tilt_link"]:
        assert centres[point][2] == pytest.approx(0.03, abs=1e-9)
    forces = pa.stance.stand_statics(robot, stand).contact_forces
    assert forces.keys() == set(robot.feet["right_tilt_link"])


def test_unknown_keyframe_is_refused_with_the_valid_names(tmp_path: Path) -> None:
    with pytest.raises(pa.UnknownNameError, match=r"crouch.*home"):
        load(quadruped(tmp_path), keyframe="crouch")


@pytest.mark.slow
def test_contact_points_equal_the_contacts_of_mujoco(tmp_path: Path) -> None:
    """Horizontal positions within 10 um, and depths within 10 nm."""
    robot = load(biped(tmp_path))
    stand = pa.stance.solve_stand_on_soft_ground(robot)
    data = mujoco.MjData(robot.mj_model)
    robot.mj_convention.set_state(data, stand.qpos)
    mujoco.mj_forward(robot.mj_model, data)
    theirs = sorted(tuple(np.round(touch.pos[:2], 6)) for touch in data.contact)
    ours = sorted(tuple(np.round(p[:2], 6)) for p in stand.contact_points.values())
    np.testing.assert_allclose(theirs, ours, atol=1e-5)
    depths = sorted(-touch.dist for touch in data.contact)
    np.testing.assert_allclose(sorted(stand.depths.values()), depths, atol=1e-8)


@pytest.mark.slow
def test_the_torque_of_an_ankle_is_the_centre_of_pressures(tmp_path: Path) -> None:
    """By hand: force times lever, less the weight of the foot below the joint."""
    robot = load(biped(tmp_path))
    task = pa.StandTask(com=(0.05, 0.0), com_margin=0.01)
    stand = pa.solve_stand(robot, task)
    held = pa.stance.stand_statics(robot, stand)
    ankle = robot.joint_names.index("left_ankle")
    joint = pa.Configuration(robot, stand.qpos).joint_position("left_ankle")
    points = robot.feet["left_tilt_link"]
    about = sum(
        np.cross(held.contact_points[point] - joint, held.contact_forces[point]) for point in points
    )
    # The foot, 0.6 kg, has its com 0.02 m ahead of the joint; its weight turns the other way.
    foot = np.cross([0.02, 0, -0.05], [0, 0, -0.6 * 9.81])
    assert held.joint_torques[ankle] == pytest.approx(-(about + foot)[1], rel=1e-9)


@pytest.mark.slow
def test_sag_on_flat_feet_equals_the_settled_simulation(tmp_path: Path) -> None:
    """Reference: height loss [m] after 8 s without feed-forward, within 1e-4 of its value."""
    robot = load(biped(tmp_path))
    stand = pa.stance.solve_stand_on_soft_ground(robot)
    sag = pa.steady_state(robot, stand)
    assert not sag.failures
    seen = pa.verify_stand(robot, stand, feedforward=False, duration=8.0, nudged=0)
    assert sag.height_loss == pytest.approx(seen.height_loss, rel=1e-4)
    assert sag.height_loss > 1e-3


@pytest.mark.slow
@pytest.mark.parametrize(("ahead", "held"), [(0.088, True), (0.092, False)])
def test_biped_tips_if_the_com_is_beyond_the_edge_of_its_soles(
    ahead: float, held: bool, tmp_path: Path
) -> None:
    """The soles, 0.18 m long, reach 0.09 m to either side of their middle."""
    robot = load(biped(tmp_path))
    points = pa.solve_stand(robot).contact_points
    middle = float(np.mean([place[0] for place in points.values()]))
    task = pa.StandTask(com=(middle + ahead, 0.0), height=0.5)
    if held:
        statics = pa.stance.stand_statics(robot, pa.solve_stand(robot, task))
        assert statics.com_margin == pytest.approx(0.09 - ahead, abs=1e-9)
    else:
        with pytest.raises(pa.ConfigurationError, match=r"2\.0 mm outside the support polygon"):
            pa.solve_stand(robot, task)


@pytest.mark.slow
def test_flat_feet_stand_on_steps_of_a_slope_and_one_is_lifted(tmp_path: Path) -> None:
    """Reference: all points of each sole are on their step within 1 nm, and MuJoCo holds the stand
    on one foot.
    """
    robot = load(biped(tmp_path))
    heights = {"left_tilt_link": 0.02, "right_tilt_link": 0.045}
    ground = pa.Ground(slope=0.08, uphill=0.5, heights=heights)
    stand = pa.stance.solve_stand_on_soft_ground(robot, pa.StandTask(ground=ground))
    for foot, points in robot.feet.items():
        for point in points:
            place = stand.contact_points[point]
            assert ground.height(place[:2], foot) == pytest.approx(place[2], abs=1e-9)
    assert pa.verify_stand(robot, stand).mujoco_residual < 1e-9
    sag = pa.steady_state(robot, stand)
    assert not sag.failures
    on_one = pa.StandTask(ground=ground, swing={"left_tilt_link": 0.03})
    assert pa.verify_stand(robot, pa.stance.solve_stand_on_soft_ground(robot, on_one)).passed


@pytest.mark.slow
@pytest.mark.parametrize(
    ("below", "framed"), [(0.78, False), (0.78, True), (1.7, False), (0.72 - 1e-9, False)]
)
def test_base_frame_on_the_ground_is_raised_to_the_com_of_the_base(
    tmp_path: Path, below: float, framed: bool
) -> None:
    """As for Berkeley Humanoid Lite: with the frame at the CoM of the base, the stand has equal
    joint positions and is 0.1 m higher. Also if soles are below the frame by rounding, as TIAGo's
    wheels.
    """
    plain = load(biped(tmp_path))
    pair = from_the_ground(biped(tmp_path), below)
    if framed:  # shapes and limbs of the base are inside a <frame>
        text = pair.mjcf.read_text().replace('<geom type="box"', '<frame><geom type="box"', 1)
        text = re.sub(r"(</body>\s*</worldbody>)", r"</frame>\1", text)
        pair.mjcf.write_text(text)
    robot = load(pair)
    raised = f"raised by {1000 * (below + 0.1):.0f} mm to the base's CoM"
    assert raised in find_note(robot, "below all limbs")
    # The pelvis' com is 0.1 m above the frame that it has otherwise.
    height = plain.stand_height
    one = pa.solve_stand(plain, pa.StandTask(height=height))
    two = pa.solve_stand(robot, pa.StandTask(height=height + 0.1))
    np.testing.assert_allclose(two.qpos[7:], one.qpos[7:], atol=1e-8)
    assert two.qpos[2] - one.qpos[2] == pytest.approx(0.1, abs=1e-9)
    verify_held_stand(robot)
    assert not [note for note in plain.notes if note.code == "base-frame-lifted"]


@pytest.mark.slow
def test_tilted_base_frame_gives_a_note(tmp_path: Path) -> None:
    """The base body is turned by 90 deg about y."""
    pair = quadruped(tmp_path)
    text = re.sub(r"<keyframe>.*</keyframe>", "", pair.mjcf.read_text(), flags=re.DOTALL)
    turned = text.replace('<body name="trunk"', '<body name="trunk" quat="0.7 0 0.7 0"', 1)
    for written, tilted in ((text, False), (turned, True)):
        pair.mjcf.write_text(written)
        codes = {note.code for note in pa.load_robot(pair.mjcf).notes}
        assert ("base-frame-tilted" in codes) is tilted


def test_keyframe_upside_down_is_named_and_not_the_body(tmp_path: Path) -> None:
    """A keyframe of H1 with quaternion 0 1 0 0: the advice was to rotate the content of the body.

    Reference: the legs point along -z of the base, so that the stance of the body is unchanged.
    """
    pair = quadruped(tmp_path)
    upright = pa.load_robot(mjcf=pair.mjcf)
    rewrite_file(pair.mjcf, (" 1 0 0 0 ", " 0 1 0 0 "))
    robot = pa.load_robot(mjcf=pair.mjcf)
    (note,) = (note for note in robot.notes if note.code == "base-frame-tilted")
    assert note.values["keyframe"] == "home"
    assert "correct the orientation of the body in the keyframe" in str(note)
    assert robot.stand_height == pytest.approx(upright.stand_height, abs=1e-6)


@pytest.mark.parametrize(
    ("turn", "axis", "back"), [("x", "+y", (-1, 0)), ("y", "-x", (0, -1)), ("xx", "+z", (2, 0))]
)
def test_urdf_with_a_lying_base_is_refused_with_a_remedy(
    turn: str, axis: str, back: tuple[int, int], tmp_path: Path
) -> None:
    """The base is turned by 90 or 180 deg; the message gives the axis along which the limbs end and
    the inverse rotation as rpy [rad].
    """
    path = write_standing_urdf(tmp_path)
    rpy = " ".join(str(0.5 * math.pi * turn.count(letter)) for letter in "xyz")
    lying = (
        '<link name="lying"/><joint name="down" type="fixed"><parent link="lying"/>'
        f'<child link="trunk"/><origin rpy="{rpy}" xyz="0 0 0"/></joint></robot>'
    )
    rewrite_file(path, ("</robot>", lying))
    message = " ".join(map(str, report_sideways_limbs(pa.load_robot(path, fixed_base=True))))
    if turn == "xx":
        with pytest.raises(PupperAnalysisError) as refused:
            pa.solve_stand(pa.load_robot(path))
        assert message in str(refused.value)
    assert f"the limbs end along {axis} of the base frame" in message
    (stated,) = re.findall('rpy="([^"]*)"', message)
    np.testing.assert_allclose([float(x) for x in stated.split()], [*np.pi / 2 * np.array(back), 0])


MESH = '<asset><mesh name="{}" vertex="{}"/></asset><worldbody>'


@pytest.mark.slow
def test_a_round_mesh_is_a_ball(tmp_path: Path) -> None:
    """MuJoCo's contacts of a mesh jump from vertex to vertex; the sphere through them does not."""
    directions = np.random.default_rng(0).normal(size=(600, 3))
    places = 0.025 * directions / np.linalg.norm(directions, axis=1)[:, None]
    text = " ".join(f"{value:.9g}" for value in places.ravel())
    pair = quadruped(tmp_path, foot='<geom type="mesh" mesh="ball" pos="0 0 -0.2"/>')
    rewrite_file(pair.mjcf, ("<worldbody>", MESH.format("ball", text)))
    robot = load(pair)
    find_note(robot, "fitted to round feet")
    for radius in robot.contact_radius.values():
        assert radius == pytest.approx(0.025, abs=3e-4)  # facets are a little inside
    place = pa.Configuration(robot, robot.neutral()).foot_positions()["FL_calf"]
    np.testing.assert_allclose(place, [0.2, 0.15, -0.4], atol=3e-4)
    verify_held_stand(robot)


@pytest.mark.slow
def test_feet_that_touch_only_certain_shapes_touch_a_floor_that_is_added(tmp_path: Path) -> None:
    """As for Cassie, whose left and right legs have separate contact bits."""
    foot = '<geom type="sphere" size="0.02" pos="0 0 -0.2" contype="2" conaffinity="4"/>'
    robot = load(quadruped(tmp_path, foot=foot))
    assert len(robot.contact_points) == 4
    verify_held_stand(robot)


@pytest.mark.slow
def test_foot_mesh_that_is_not_round_gives_a_note(tmp_path: Path) -> None:
    """Feet that are boxes become spheres, on which MuJoCo holds the stand."""
    corners = itertools.product((-0.03, 0.03), (-0.02, 0.02), (-0.02, 0.02))
    vertices = " ".join(str(value) for corner in corners for value in corner)
    pair = quadruped(tmp_path, foot='<geom type="mesh" mesh="block" pos="0 0 -0.2"/>')
    rewrite_file(pair.mjcf, ("<worldbody>", MESH.format("block", vertices)))
    robot = load(pair)
    find_note(robot, "spheres at their lowest points")
    verify_held_stand(robot)
    assert not any(note.code == "balls-for-feet" for note in load(quadruped(tmp_path)).notes)


@pytest.mark.slow
def test_defaults_for_the_robots_geoms_are_not_the_added_floors(tmp_path: Path) -> None:
    """Reference: MuJoCo's default plane. With the default of the robot's geoms, Cassie's feet of
    condim 1 would have no friction on the floor.
    """
    pair = quadruped(tmp_path)
    default = (
        '<default><geom contype="0" conaffinity="0" condim="1" margin="0.01" solref="0.005 1" '
        'type="box"/></default><worldbody>'
    )
    sphere = 'type="sphere"'
    rewrite_file(pair.mjcf, ("<worldbody>", default), (sphere, f'{sphere} contype="1" margin="0"'))
    robot = load(pair)
    plain = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><geom type="plane" size="0 0 1"/></worldbody></mujoco>'
    )
    floor = robot.mj_model.geom("floor")
    for word in ("type", "condim", "friction", "solref", "solimp", "margin", "gap", "priority"):
        assert getattr(floor, word).tolist() == getattr(plain.geom(0), word).tolist(), word
    verify_held_stand(robot)


@pytest.mark.slow
def test_zeros_that_differ_are_brought_together(tmp_path: Path) -> None:
    """The URDF counts one knee from 0.3 rad before the MJCF's zero: the same robot."""
    pair = quadruped(tmp_path)
    plain = load(pair)
    origin = (
        '<child link="FL_calf"/><origin xyz="0.0 0.0 -0.2"/><axis xyz="0 1 0"/>'
        '<limit lower="-2.6" upper="-0.4"'
    )
    turned = origin.replace('-0.2"/>', '-0.2" rpy="0 -0.3 0"/>')
    turned = turned.replace('lower="-2.6" upper="-0.4"', 'lower="-2.3" upper="-0.1"')
    rewrite_file(pair.urdf, (origin, turned))
    robot = load(pair)
    assert "FL_knee by +17.19 deg" in find_note(robot, "another zero angle")
    np.testing.assert_allclose(robot.lower_limits, plain.lower_limits, atol=1e-12)
    first, second = (pa.stance.solve_stand_on_soft_ground(loaded).qpos for loaded in (robot, plain))
    np.testing.assert_allclose(first, second, atol=1e-9)
    verify_held_stand(robot)


@pytest.mark.parametrize(
    "wrong",
    [
        {"feet": 3},
        {"feet": "FL_calf"},
        {"feet": {"FL": 1}},
        {"feet": {"FL": ("FL_calf",)}},
        {"feet": ["FL_calf", "FL_calf"]},
        {"joints": [1]},
        {"keyframe": 3},
    ],
    ids=str,
)
def test_wrong_arguments_are_refused_by_name(wrong: dict[str, object], tmp_path: Path) -> None:
    with pytest.raises(pa.ConfigurationError, match=next(iter(wrong))):
        load(quadruped(tmp_path), **wrong)


@pytest.mark.slow
def test_narrower_joint_limits_of_both_files_are_used(tmp_path: Path) -> None:
    """As for Pi Plus, whose knees have a one-sided range in the MJCF only, and for NimbRo-OP2X,
    whose joints are continuous in the URDF.
    """
    pair = quadruped(tmp_path, keyframe="")
    rewrite_file(pair.mjcf, ('range="-1.5 2.5"', 'range="-1.5 0.6"'))
    robot = load(pair)
    assert "_pitch -1.5 to 0.6" in find_note(robot, "narrower limits of the MJCF")
    names = [name for name in robot.joint_names if name.endswith("_pitch")]
    found = dict(zip(robot.joint_names, robot.home[7:].tolist(), strict=True))
    assert max(found[name] for name in names) <= 0.6
    verify_held_stand(robot)
    assert not [note for note in load(quadruped(tmp_path)).notes if "limits" in str(note)]
    # Continuous joints of the URDF without a <limit>, as those of NimbRo-OP2X.
    text = re.sub(r'<limit lower="-1.5" [^>]*>', "", pair.urdf.read_text())
    pair.urdf.write_text(re.sub(r'(_pitch" type=)"revolute"', r'\1"continuous"', text))
    robot = load(pair)
    pitches = [robot.joint_names.index(name) for name in names]
    np.testing.assert_array_equal(robot.upper_limits[pitches], 2.5)
    np.testing.assert_array_equal(robot.effort_limits[pitches], 30.0)  # the MJCF's
    verify_held_stand(robot)


@pytest.mark.slow
def test_feet_behind_a_prismatic_joint_are_at_their_true_position(tmp_path: Path) -> None:
    """The origin of a slide is arbitrary along and beside its axis, so the foot position must not
    depend on it."""
    pair = quadruped(tmp_path, floor=True, keyframe="0 0.1 0")
    urdf, mjcf = pair.urdf.read_text(), pair.mjcf.read_text()
    urdf, knees = re.subn(
        r'(<joint name="\w+_knee" type=")revolute(".*?<axis xyz=")0 1 0(".*?lower=")[^"]*'
        r'(" upper=")[^"]*',
        r"\g<1>prismatic\g<2>0 0 1\g<3>-0.08\g<4>0.08",
        urdf,
    )
    assert knees == 4
    pair.urdf.write_text(urdf)
    mjcf, knees = re.subn(
        r'(_knee") axis="0 1 0" range="[^"]*"',
        r'\1 type="slide" axis="0 0 1" range="-.08 .08"',
        mjcf,
    )
    assert knees == 4
    # The calf's frame 30 mm aside and 50 mm up; the com and the foot's sphere stay.
    mjcf = re.sub(r'(_calf" pos=")0 0 -0.2', r"\g<1>0.03 0 -0.15", mjcf)
    mjcf = mjcf.replace('pos="0 0 -0.1" mass="0.2"', 'pos="-0.03 0 -0.15" mass="0.2"')
    mjcf = mjcf.replace('size="0.02" pos="0 0 -0.2"', 'size="0.02" pos="-0.03 0 -0.25"')
    pair.mjcf.write_text(mjcf)
    assert pa.compare_models(pair.urdf, pair.mjcf).differences[0].kind == "effort"  # the motors'
    robot = load(pair)
    verify_held_stand(robot)


@pytest.mark.slow
def test_base_with_three_slides_and_a_ball_joint_is_free(tmp_path: Path) -> None:
    """Reference: the same robot with a free joint. XBot-L's base is free in this way."""
    expected = load(quadruped(tmp_path))
    pair = quadruped(tmp_path)
    parts = "".join(f'<joint type="slide" axis="{axis}"/>' for axis in ("1 0 0", "0 1 0", "0 0 1"))
    free = ("<freejoint/>", f'{parts}<joint type="ball"/>')
    rewrite_file(pair.mjcf, free, ('qpos="0 0 0.35', 'qpos="0 0 0'))
    robot = load(pair)
    find_note(robot, "three slides and a ball joint")
    assert robot.floating
    np.testing.assert_allclose(robot.home, expected.home, atol=1e-12)
    assert robot.stand_height == pytest.approx(expected.stand_height, abs=1e-12)
    verify_held_stand(robot)


def test_servos_that_need_feed_forward_are_used_if_no_others_hold(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """HyQ: feet slide by more than 5 mm as the servos sag without feed-forward."""
    rests = drives.comes_to_rest

    def slides(robot: Robot, stand: pa.Stand, *, feedforward: bool, **gains: np.ndarray) -> bool:
        return feedforward and rests(robot, stand, feedforward=True, **gains)

    monkeypatch.setattr(drives, "comes_to_rest", slides)
    robot = load(quadruped(tmp_path))
    assert any(n.code == "rests-with-feed-forward-alone" for n in robot.notes)
    assert pa.verify_stand(robot, pa.stance.solve_stand_on_soft_ground(robot)).passed


@pytest.mark.slow
def test_servos_with_other_torques_than_predicted_are_the_last_choice(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As for Pi Plus, whose light feet rest against each other: torques are off by 45 %.

    All candidates come to rest here; the stiffest is tried first.
    """
    pair = quadruped(tmp_path)
    stiffest = float(load(pair).mj_model.actuator_gainprm[:, 0].max())

    def is_softer(_robot: Robot, _stand: pa.Stand, kp: np.ndarray, _kd: np.ndarray) -> bool:
        return bool(kp.max() < stiffest)

    monkeypatch.setattr(drives, "comes_to_rest", lambda *_, **__: True)
    monkeypatch.setattr(drives, "_is_as_predicted", is_softer)
    assert 0 < load(pair).mj_model.actuator_gainprm[:, 0].max() < stiffest
    monkeypatch.setattr(drives, "_is_as_predicted", lambda *_: False)
    robot = load(pair)
    assert robot.mj_model.actuator_gainprm[:, 0].max() == stiffest
    assert not [note for note in robot.notes if "come to rest" in str(note)]


@pytest.mark.slow
def test_names_with_another_prefix_are_matched_with_a_note(tmp_path: Path) -> None:
    robot = load(quadruped(tmp_path, prefix="rob_"))
    assert "FL_roll = rob_FL_roll" in find_note(robot, "other names")
    verify_held_stand(robot)


@pytest.mark.slow
def test_joint_of_the_mjcf_alone_is_fixed_at_zero_and_named(tmp_path: Path) -> None:
    """The head of 0.3 kg is in the MJCF alone: the verdict states both masses."""
    robot = load(quadruped(tmp_path, head=True))
    assert "nod" in find_note(robot, "joints of the MJCF alone are held at zero")
    found = pa.verify_stand(robot, pa.stance.solve_stand_on_soft_ground(robot))
    assert found.failures[0].code == "files-of-two-robots"
    assert "8.700 kg" in str(found.failures[0])
    assert "8.400 kg" in str(found.failures[0])


@pytest.mark.slow
def test_contact_margin_raises_the_feet_by_the_margin(tmp_path: Path) -> None:
    """Reference: depth of the same feet without margin, less 4 mm."""
    sphere = '<geom type="sphere" size="0.02" pos="0 0 -0.2" margin="0.004"/>'
    robot = load(quadruped(tmp_path, foot=sphere))
    stand = pa.stance.solve_stand_on_soft_ground(robot)
    bare = pa.stance.solve_stand_on_soft_ground(load(quadruped(tmp_path)))
    for foot, depth in stand.depths.items():
        assert depth == pytest.approx(bare.depths[foot] - 0.004, abs=1e-9)
    verify_held_stand(robot)


@pytest.mark.slow
def test_overlapping_bodies_do_not_push_each_other(tmp_path: Path) -> None:
    """The thigh overlaps the trunk in the start pose; the robot stands."""
    pair = quadruped(tmp_path)
    text = pair.mjcf.read_text()
    fat = '<geom type="sphere" size="0.09" pos="0 0 -0.1"/>'
    pair.mjcf.write_text(text.replace('<body name="FL_calf"', fat + '<body name="FL_calf"', 1))
    robot = load(pair)
    assert "FL_thigh and trunk" in find_note(robot, "overlap in the start pose")
    verify_held_stand(robot)
