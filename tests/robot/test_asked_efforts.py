"""Effort limits that a caller requests bound statics, models and simulations; placeholder efforts
are named.
"""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.base.errors import ConfigurationError, UnknownNameError
from pupper_analysis.cli.stance_options import parse_efforts
from pupper_analysis.models.efforts import EffortCode, JointEffort, placeholder_efforts
from pupper_analysis.present.documents.loads import format_example_efforts
from pupper_analysis.present.verdict import split_verdict_lines
from pupper_analysis.robot.build import rebuild_robot, with_efforts
from pupper_analysis.robot.servos import model_with_servos
from pupper_analysis.robot.tool import with_payload
from pupper_analysis.stance.stand import stand_statics
from pupper_analysis.statics.equilibrium import ForceDistribution
from tests.support import arm
from tests.support.variants import load, stand_of


@pytest.mark.parametrize("effort", [0.7, 30.0])  # less, and more, than the file's
def test_requested_efforts_bound_statics_and_simulation(effort: float) -> None:
    """Effort limits [N m], also with payload, and the force ranges of MuJoCo's servos equal the
    request at the knees and the file's 3 N m elsewhere.
    """
    robot = load("v3")
    knees = [name for name in robot.joint_names if name.endswith("_3")]
    requested = with_efforts(robot, dict.fromkeys(knees, effort))
    wanted = [effort if name in knees else 3.0 for name in robot.joint_names]
    np.testing.assert_allclose(requested.effort_limits, wanted)
    np.testing.assert_allclose(with_payload(requested, 0.5).effort_limits, wanted)
    model = model_with_servos(requested, kp=1e6, kd=0.0).model
    for name, limit in zip(robot.joint_names, wanted, strict=True):
        actuator = requested.mj_convention.actuator_index[requested.joint_names.index(name)]
        assert model.actuator_forcerange[actuator].tolist() == pytest.approx([-limit, limit])
        assert not model.jnt_actfrclimited[model.joint(name).id] or name not in knees
    assert "efforts-as-asked" in {note.code for note in requested.notes}
    assert with_efforts(robot, {}) is robot
    by_pattern = with_efforts(robot, {"*": 30.0, "*_3": effort})  # the last pattern counts
    np.testing.assert_allclose(
        by_pattern.effort_limits, [effort if name in knees else 30.0 for name in robot.joint_names]
    )
    with pytest.raises(UnknownNameError, match=re.escape("*knee*")):
        with_efforts(robot, {"*knee*": 1.0})
    with pytest.raises(ConfigurationError, match="'3' is not a number"):
        with_efforts(robot, {"*": "3"})  # type: ignore[dict-item]


_LIFT_URDF = """<robot name="lift"><link name="base"/><link name="arm">
<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
</link><link name="tray">
<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
</link>
<joint name="turn" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" effort="7" velocity="1"/></joint>
<joint name="lift" type="prismatic"><parent link="arm"/><child link="tray"/><axis xyz="0 0 1"/>
<limit lower="0" upper="1" effort="50" velocity="1"/></joint></robot>"""

_LIFT_MJCF = """<mujoco><worldbody><body name="arm">
<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/><joint name="turn" axis="0 0 1" range="-60 60"/>
<body name="tray"><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
<joint name="lift" type="slide" axis="0 0 1" range="0 1"/></body></body></worldbody>
<actuator><motor joint="turn" forcelimited="true" forcerange="-6 6"/>
<motor joint="lift" forcelimited="true" forcerange="-40 40"/></actuator></mujoco>"""


def test_efforts_of_slides_are_reported_in_newtons(tmp_path: Path) -> None:
    """The limit of a prismatic joint is a force: the definition of ``effort`` in URDF."""
    urdf, mjcf = tmp_path / "lift.urdf", tmp_path / "lift.xml"
    urdf.write_text(_LIFT_URDF)
    mjcf.write_text(_LIFT_MJCF)
    robot = pa.load_robot(urdf, mjcf)
    differing = next(note for note in robot.notes if note.code == "effort-limits-differ")
    assert "turn 6 N m (MJCF) of 7 N m" in str(differing)
    assert "lift 40 N (MJCF) of 50 N" in str(differing)
    assert not str(differing).count("50 N m")
    requested = str(with_efforts(robot, {"turn": 2.0, "lift": 30.0}).notes[-1])
    assert "turn 2 N m instead of 6 N m" in requested
    assert "lift 30 N instead of 40 N" in requested
    assert not requested.count("40 N m")


def test_a_note_names_joints_without_a_stated_limit_until_limits_are_set() -> None:
    """Without its ``forcerange``, the limit of a motor is unknown; the other motor has 6 N m."""
    robot = pa.load_robot(_LIFT_MJCF.replace(' forcelimited="true" forcerange="-40 40"', ""))
    assert robot.effort_limits.tolist() == [6.0, math.inf]
    (note,) = [note for note in robot.notes if note.code == "torque-limits-unstated"]
    assert note.values["joints"] == ("lift",)
    assert "pa.robot.with_efforts(robot, {joint: N m})" in str(note)
    assert "--effort [JOINTS=]NM" in str(note)
    assert note in with_efforts(robot, {"turn": 2.0}).notes
    limited = with_efforts(robot, {"lift": 30.0})
    assert "torque-limits-unstated" not in {note.code for note in limited.notes}


def test_invalid_efforts_and_joints_are_refused() -> None:
    robot = load("v3")
    for effort in (0.0, -1.0, math.inf, math.nan):
        with pytest.raises(ConfigurationError, match="leg_front_r_1"):
            with_efforts(robot, {"leg_front_r_1": effort})
    with pytest.raises(UnknownNameError, match="knee"):
        with_efforts(robot, {"knee": 1.0})


@pytest.mark.slow
def test_verdict_names_placeholder_efforts_until_efforts_are_requested(tmp_path: Path) -> None:
    """All efforts are 2,000 N m.

    With requested efforts the payload is below 3 kg: 9 N m at 0.4 m carry 2.3 kg.
    """
    path = tmp_path / "arm.urdf"
    efforts = "|".join(f"{effort}" for effort in arm.EFFORTS.values())
    path.write_text(re.sub(f'effort="({efforts})"', 'effort="2000"', arm.URDF))
    robot = pa.load_robot(path)
    verdict = pa.hold_posture(robot).verdict
    (message,) = [remark for remark in verdict.remarks if "effort" in remark.code]
    assert message.code == "rests-on-placeholder-efforts"
    assert any(
        str(message) in str(line) for line in split_verdict_lines(verdict)[0]
    )  # also without -v
    assert sorted(message.values["joints"]) == ["a_turn", "elbow", "shoulder"]  # not the slide
    requested = with_efforts(robot, {"shoulder": 30.0, "elbow": 9.0, "a_turn": 5.0})
    held = pa.hold_posture(requested)
    assert not [remark for remark in held.verdict.remarks if "effort" in remark.code]
    assert held.payload.worst_posture_mass is not None
    assert held.payload.worst_posture_mass < 3.0  # kg: 9 N m at 0.4 m; hundreds by 2000 N m


@pytest.mark.parametrize(
    ("motor", "code"),
    [
        (JointEffort("knee", 1000.0, 3.0), "effort-beyond-links"),
        (JointEffort("knee", 1000.0, 5.0), None),
        (JointEffort("knee", 1010.0, 3.0), None),  # not round, hence no placeholder
        (JointEffort("knee", 30.0, 3.0, 1e-4), "effort-beyond-armature"),
        (JointEffort("knee", 30.0, 3.0, 1e-3), None),
        (JointEffort("knee", math.inf, 3.0, 1e-3), None),
        (JointEffort("knee", 1e3, 1e-9), None),  # between two marks on a link
    ],
)
def test_placeholder_effort_is_judged_by_the_links_and_armature_of_its_motor(
    motor: JointEffort, code: str | None
) -> None:
    """Cases by hand: a round effort that links of 3 N m do not need, or that would accelerate the
    armature beyond any motor.
    """
    codes = [message.code for _, message in placeholder_efforts([motor], 100.0)]
    assert codes == ([] if code is None else [code])


def test_equal_efforts_of_all_motors_are_judged_by_the_weight_of_the_robot() -> None:
    """By hand: 6 motors of 10 N m are 60 N m, 91 and 89 times the robot's; the limit is 90."""
    motors = [JointEffort(f"joint{number}", 10.0, 0.1) for number in range(6)]
    assert not list(placeholder_efforts(motors, 60 / 89))
    ((joints, message),) = placeholder_efforts(motors, 60 / 91)
    assert len(joints) == 6
    assert message.code == "efforts-beyond-robot"
    assert message.values["same"]
    assert message.values["share"] == pytest.approx(91)


@pytest.mark.parametrize(
    ("large", "number", "others", "total", "found"),
    [
        (1000.0, 1, 150.0, 86.8, True),  # HyQ with one edited hip: 1.17 m times its weight
        (1000.0, 4, 150.0, 86.8, True),
        (1000.0, 5, 150.0, 86.8, False),  # no exception among the joints
        (1000.0, 1, 210.0, 86.8, False),  # 4.8 times
        (990.0, 1, 150.0, 86.8, False),  # not round
        (1000.0, 1, 150.0, 180.0, False),  # 0.57 m
    ],
)
def test_round_effort_far_above_the_others_is_a_placeholder(
    large: float, number: int, others: float, total: float, found: bool
) -> None:
    """By hand: links of 30 kg bound an effort by 7500 N m, and the sum by 90 N m/kg."""
    efforts = [large] * number + [others] * (12 - number)
    motors = [JointEffort(f"joint{row}", effort, 30.0) for row, effort in enumerate(efforts)]
    messages = list(placeholder_efforts(motors, total))
    assert [names for names, _ in messages] == (
        [tuple(f"joint{row}" for row in range(number))] if found else []
    )
    for _, message in messages:
        assert message.code == "effort-beyond-others"
        assert message.values["lever"].value == pytest.approx(large / (total * 9.81))


@pytest.mark.filterwarnings("error")
def test_effort_that_no_motor_has_is_refused_or_counts_as_zero() -> None:
    """1 / 1e-300 overflows in squares: NumPy warned, and utilisations had no meaning."""
    robot = load("v3")
    with pytest.raises(pa.ConfigurationError, match=r"1e-300 N m at .* of at least 0\.000001 N m"):
        with_efforts(robot, {"leg_front_r_1": 1e-300})
    text = robot.description.urdf
    changed = re.sub(r'effort="[^"]*"', 'effort="1e-300"', text)
    stated = rebuild_robot(robot, urdf=changed)
    assert {limit.code for limit in stated.efforts} == {EffortCode.ZERO}
    assert not stated.effort_limits.any()
    stand = stand_of("v3")
    shares = stand_statics(
        stated, stand.with_robot(stated), distribution=ForceDistribution.MIN_MAX_TORQUE
    )
    assert np.isinf(shares.motor_utilisation).any()


def test_patterns_of_efforts_leave_out_passive_joints(tmp_path: Path) -> None:
    """A joint without motor got the torque limit of all motors. Its own name selects it."""
    servo = f'<position joint="a_turn" kp="{arm.STIFFNESS["a_turn"]}" kv="20"/>'
    urdf = re.sub(r' effort="[^"]*"', "", arm.URDF).replace(
        'lower="-3.0" upper="3.0"', 'lower="-3.0" upper="3.0" effort="0"'
    )
    robot = arm.load_arm(tmp_path, urdf, arm.MJCF.replace(servo, ""))
    assert robot.passive_joints == ("a_turn",)
    assert parse_efforts(("40",), robot) == {"elbow": 40, "b_slide": 40, "shoulder": 40}
    assert parse_efforts(("a_turn=3",), robot) == {"a_turn": 3}
    requested = with_efforts(robot, {"*": 40.0})
    limits = {limit.joint: limit.symmetric_torque for limit in requested.efforts}
    assert limits == {"elbow": 40, "b_slide": 40, "shoulder": 40, "a_turn": 0}


def test_proposed_efforts_name_all_unknown_motors() -> None:
    """A slide without load was left out, so the payload was still unknown with the command."""
    units = {"lift": "N", "hip": "N m", "knee": "N m", "pin": "N m"}
    torques = {"lift": 0.0, "hip": 3.0, "knee": -5.0, "pin": 0.0}
    words = format_example_efforts(("lift", "hip", "knee"), torques, units)
    assert words == ("--effort", "lift=5", "--effort", "hip=5", "--effort", "knee=5")
    assert format_example_efforts(("lift",), torques, units) == ()
