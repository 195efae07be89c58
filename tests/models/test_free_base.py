"""A base on slides and hinges, or slides and a ball joint, counts as one free base in every
command.
"""

from __future__ import annotations

import re
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest

import pupper_analysis as pa
from pupper_analysis.models.spec_tree import join_free_base
from tests.support.conversions import convert_file
from tests.support.legged import Pair, quadruped, rewrite_file

SLIDES = "".join(
    f'<joint name="pelvis_t{word}" type="slide" axis="{axis}" range="-5 5"/>'
    for word, axis in (("x", "1 0 0"), ("z", "0 0 1"), ("y", "0 1 0"))
)
BALL = '<joint name="ball" type="ball"/>'
HINGES = "".join(
    f'<joint name="{word}" axis="{axis}" range="-3 3"/>'
    for word, axis in (("list", "1 0 0"), ("tilt", "0 1 0"), ("turn", "0 0 1"))
)
POSE = "0 0 0.35 1 0 0 0"


def replace_free_joint(pair: Pair, turning: str, place: str) -> Pair:
    """Replace the free joint of the base by slides and the given joints, as in OpenSim's models."""
    rewrite_file(pair.mjcf, ("<freejoint/>", SLIDES + turning), (POSE, place))
    return pair


@pytest.mark.slow
@pytest.mark.parametrize(
    ("turning", "place"), [(HINGES, "0 0.35 0 0 0 0"), (BALL, "0 0.35 0 1 0 0 0")]
)
def test_crosscheck_and_convert_read_six_joints_as_a_free_base(
    turning: str, place: str, tmp_path: Path
) -> None:
    """The URDF has a free base. The files differ at most in effort limits, and the converted URDF
    does not contain the slides.
    """
    pair = replace_free_joint(quadruped(tmp_path), turning, place)
    compared = pa.compare_models(pair.urdf, pair.mjcf)
    assert compared.only_mjcf == ()
    assert {difference.kind for difference in compared.differences} <= {"effort"}  # the motors'
    _, found = convert_file(pair.mjcf, "back.urdf")
    assert found.agree, found.failures
    assert "pelvis_tx" not in (tmp_path / "back.urdf").read_text()


@pytest.mark.slow
def test_stand_with_six_joints_equals_the_stand_with_a_free_joint(tmp_path: Path) -> None:
    """Reference: qpos of the same robot with a free joint, within 1e-9."""
    (tmp_path / "free").mkdir()
    free = quadruped(tmp_path / "free")
    pair = replace_free_joint(quadruped(tmp_path), HINGES, "0 0.35 0 0 0 0")
    robots = [pa.load_robot(urdf=files.urdf, mjcf=files.mjcf) for files in (free, pair)]
    assert robots[1].floating
    first, second = (pa.solve_stand(robot) for robot in robots)
    np.testing.assert_allclose(first.qpos, second.qpos, atol=1e-9)


@pytest.mark.parametrize(
    "change",
    [
        ('name="pelvis_tx" type="slide"', 'name="pelvis_tx" type="slide" stiffness="9"'),
        ('axis="0 1 0" range="-5 5"', 'axis="1 0 1" range="-5 5"'),  # in a plane
        ("<actuator>", '<actuator><motor joint="pelvis_tx"/>'),  # a gantry
    ],
)  # fmt: skip
def test_base_joints_are_not_joined_if_held_or_driven(
    change: tuple[str, str], tmp_path: Path
) -> None:
    """A spring, three slides in one plane, or a motor at the base: the spec keeps its joints."""
    pair = replace_free_joint(quadruped(tmp_path), HINGES, "0 0.35 0 0 0 0")
    spec = mujoco.MjSpec.from_file(str(rewrite_file(pair.mjcf, change)))
    count = len(spec.joints)
    assert not join_free_base(spec)
    assert len(spec.joints) == count


def test_equality_of_another_joint_is_kept_if_the_base_joints_have_no_names(
    tmp_path: Path,
) -> None:
    """The equality holds a knee at an angle; MuJoCo's second joint is then empty."""
    unnamed = re.sub(' name="[a-z_]*"', "", SLIDES + HINGES)
    pair = quadruped(tmp_path)
    rewrite_file(pair.mjcf, ("<freejoint/>", unnamed), (POSE, "0 0.35 0 0 0 0"))
    held = '<equality><joint joint1="FL_knee" polycoef="-1 0 0 0 0"/></equality>'
    rewrite_file(pair.mjcf, ("</mujoco>", f"{held}</mujoco>"))
    spec = mujoco.MjSpec.from_file(str(pair.mjcf))
    assert join_free_base(spec)
    model = spec.compile()
    assert (model.jnt_type[0], model.neq) == (mujoco.mjtJoint.mjJNT_FREE, 1)
    assert model.eq_obj1id[0] == model.joint("FL_knee").id


def test_base_joints_are_not_joined_if_the_urdf_has_one_of_them(tmp_path: Path) -> None:
    pair = replace_free_joint(quadruped(tmp_path), HINGES, "0 0.35 0 0 0 0")
    spec = mujoco.MjSpec.from_file(str(pair.mjcf))
    assert not join_free_base(spec, stated={"tilt"})
    assert join_free_base(spec, stated={"FL_knee"})


def test_slide_is_not_locked_without_limits(tmp_path: Path) -> None:
    """A cart on two slides and a hinge, as TidyBot's, whose URDF had limits of 0 to 0 m."""
    path = tmp_path / "cart.xml"
    inertial = '<inertial mass="2" pos="0 0 0.1" diaginertia="0.1 0.1 0.1"/>'
    path.write_text(
        "<mujoco><worldbody><body name='cart'>"
        "<joint name='x' type='slide' axis='1 0 0'/><joint name='y' type='slide' axis='0 1 0'/>"
        f"<joint name='turn'/>{inertial}"
        f"<body name='arm' pos='0 0 0.3'><joint name='lift' axis='0 1 0'/>{inertial}</body>"
        "</body></worldbody></mujoco>"
    )
    _, found = convert_file(path, "cart.urdf")
    assert found.passed, found.failures
    assert sum("is a slide without limits" in str(text) for text in found.not_converted) == 2
    model = pin.buildModelFromUrdf(str(tmp_path / "cart.urdf"))
    for name in ("x", "y"):
        index = model.joints[model.getJointId(name)].idx_q
        assert model.lowerPositionLimit[index] == -1e3
        assert model.upperPositionLimit[index] == 1e3
