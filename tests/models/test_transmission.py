"""Types of actuators at joints and tendons, from their force laws."""

from __future__ import annotations

import mujoco
import pytest

from pupper_analysis.models.transmission import (
    Drive,
    classify_joint_drive,
    list_falling_base_joints,
    list_play_joints,
    list_tendon_servos,
)


def test_dcmotor_at_a_tendon_is_no_servo() -> None:
    """The tendon's id, 1, is not the id of a joint: the model has a single joint."""
    model = mujoco.MjModel.from_xml_string("""
    <mujoco><worldbody><body><joint name="j"/><geom size="0.1"/></body></worldbody>
    <tendon>
    <fixed name="slack"><joint joint="j" coef="1"/></fixed>
    <fixed name="driven"><joint joint="j" coef="1"/></fixed>
    </tendon>
    <actuator><dcmotor tendon="driven" motorconst="0.1" resistance="1"/></actuator></mujoco>""")
    assert list_tendon_servos(model, 0) == []
    assert classify_joint_drive(model, 0) is Drive.TENDON


def _make_planar_robot(axis: str, root: str = "", motors: str = '<motor joint="knee"/>') -> str:
    return f"""<mujoco><worldbody><body name="torso" pos="0 0 1">
      <joint name="slide" type="slide" axis="{axis}" {root}/><joint name="tilt" axis="0 1 0"/>
      <geom size="0.1" mass="1"/><body pos="0 0 -0.3"><joint name="knee" axis="0 1 0"/>
      <geom size="0.05" mass="0.1"/></body></body></worldbody>
      <actuator>{motors}</actuator></mujoco>"""


@pytest.mark.parametrize(
    ("text", "falls"),
    [
        (_make_planar_robot("0 0 1"), True),
        (_make_planar_robot("1 0 0"), False),
        (_make_planar_robot("0 0 1", 'range="-0.05 0.05" limited="true"'), False),
        (_make_planar_robot("0 0 1", 'stiffness="2000"'), False),
        (_make_planar_robot("0 0 1", motors='<position joint="slide" kp="2000"/>'), False),
    ],
    ids=["vertical", "horizontal", "range", "spring", "servo"],
)
def test_base_on_an_undriven_vertical_slide_falls(text: str, falls: bool) -> None:
    """Reference: the height of the base after 1 s in bare MuJoCo."""
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, nstep=round(1.0 / model.opt.timestep))
    assert bool(data.body("torso").xpos[2] < 0.5) is falls
    names = [model.joint(joint).name for joint in list_falling_base_joints(model)]
    assert names == (["slide", "tilt"] if falls else [])


def test_file_without_actuators_has_no_falling_base() -> None:
    """Such a file states no motors at all, so each joint may have one."""
    model = mujoco.MjModel.from_xml_string(_make_planar_robot("0 0 1", motors=""))
    assert list_falling_base_joints(model) == []
    model = mujoco.MjModel.from_xml_string(
        _make_planar_robot("0 0 1", motors='<motor joint="slide"/><motor joint="knee"/>')
    )
    assert list_falling_base_joints(model) == []
    assert list_falling_base_joints(model, {"slide"}) == [0, 1]


def test_coaxial_hinge_without_motor_is_play() -> None:
    """The play does not change the motion: in bare MuJoCo, only the sum of both angles does."""
    play = '<joint name="{}" axis="{}" pos="{}"/>'
    joints = play.format("play", "0 -1 0", "0 0 0") + play.format("other", "1 0 0", "0 0 0")
    joints += play.format("apart", "0 1 0", "0 0 0.1")
    text = _make_planar_robot("0 0 1").replace("</body></body>", joints + "</body></body>")
    model = mujoco.MjModel.from_xml_string(text)
    assert [model.joint(joint).name for joint in list_play_joints(model)] == ["play"]
    places = []
    for knee, turned in ((0.3, 0.0), (0.5, 0.2)):
        data = mujoco.MjData(model)
        data.joint("knee").qpos, data.joint("play").qpos = knee, turned
        mujoco.mj_kinematics(model, data)
        places.append(data.xmat[2])
    assert places[0] == pytest.approx(places[1])


@pytest.mark.parametrize(
    ("actuator", "drive"),
    [
        ('position joint="j" kp="5" gear="0"', Drive.NO_GEAR),
        ('motor joint="j" gear="0"', Drive.NO_GEAR),
        ('position joint="j" kp="0"', Drive.NO_STIFFNESS),
        ('position joint="j" kp="5"', Drive.SERVO),
    ],
)
def test_actuator_with_gear_of_zero_is_no_servo_without_stiffness(
    actuator: str, drive: Drive
) -> None:
    """Reference: the attributes of the file; texts of `stand` state the type."""
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body><joint name="j"/><geom size="0.1"/></body></worldbody>'
        f"<actuator><{actuator}/></actuator></mujoco>"
    )
    assert classify_joint_drive(model, 0) is drive
    assert drive.has_invalid_stiffness is (drive is not Drive.SERVO)
