"""Held postures of a robot with a fixed base, compared with closed forms and both engines."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.present.documents.registry import build_report
from pupper_analysis.present.markdown import write_markdown
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.tool import find_tool
from pupper_analysis.simulation.verdict import VerdictCode
from pupper_analysis.simulation.verify import verify_stand
from pupper_analysis.stance.posture import find_posture, held_stand
from pupper_analysis.stance.sag.steady_state import steady_state
from pupper_analysis.statics.equilibrium import gravity_compensation
from pupper_analysis.tools.stand.stance import study_stance
from tests.support import arm as by_hand
from tests.support.arm import STIFFNESS, arm, load_arm
from tests.support.engines import load_by_mujoco
from tests.tools.hold.test_limits import FOUR_BARS

POSTURE = {"a_turn": 0.7, "shoulder": -0.6, "elbow": 1.1, "b_slide": 0.05}
ANGLES = tuple(POSTURE.values())  # of the closed forms


def test_torques_sag_and_tool_position_equal_the_closed_form() -> None:
    """References: closed forms of `by_hand`, MuJoCo's load, and simulations with the servos."""
    robot = arm()
    held = pa.hold_posture(robot, POSTURE)
    wanted = by_hand.holding_torques(*ANGLES)
    torques = dict(zip(robot.joint_names, held.statics.joint_torques, strict=True))
    assert robot.joint_names == by_hand.ORDER
    assert torques == pytest.approx(wanted, abs=1e-12)
    by_mujoco = load_by_mujoco(robot, held.posture.qpos)
    assert by_mujoco == pytest.approx(held.statics.joint_torques, abs=1e-12)
    assert held.tool.name == "tip"
    assert held.tool_position == pytest.approx(by_hand.tip_position(*ANGLES), abs=1e-12)
    assert held.passed
    assert held.verdict.code is VerdictCode.HOLDS
    assert held.verification.torque_error < 1e-6

    assert held.settled is not None
    rest = dict(zip(robot.joint_names, held.settled.qpos, strict=True))
    there = by_hand.holding_torques(*(rest[name] for name in POSTURE))
    for name, angle in POSTURE.items():
        assert STIFFNESS[name] * (angle - rest[name]) == pytest.approx(there[name], abs=1e-9)
    moved = by_hand.tip_position(*(rest[name] for name in POSTURE)) - by_hand.tip_position(*ANGLES)
    assert held.tool_sag == pytest.approx(moved, abs=1e-12)
    assert moved[2] < -5e-3
    assert held.sagging.joint_positions == pytest.approx(held.settled.qpos, abs=1e-6)
    own = (
        held.verdict.keyframe_run
    )  # servos of the file, commanded with the angles only, sag by the same amount
    assert own is not None
    assert own.worst is not None
    sag = held.settled.qpos - held.posture.qpos
    assert own.worst.off == pytest.approx(sag[np.abs(sag).argmax()], abs=1e-5)
    elsewhere = replace(held.settled, qpos=held.settled.qpos + 2e-3)
    stand, alone = held_stand(robot, held.posture), {"feedforward": False, "duration": 3.0}
    run = verify_stand(robot, stand, settled=elsewhere, **alone)  # type: ignore[arg-type]
    assert [failure.code for failure in run.failures] == ["joint-off"]


def test_omitted_joints_are_at_mid_range_or_in_the_keyframe(tmp_path: Path) -> None:
    robot = arm()
    middle = {name: np.mean(ends) for name, ends in by_hand.RANGES.items()}
    found = find_posture(robot, {"*l*": 0.1, "elbow": 0.5})
    wanted = middle | {"shoulder": 0.1, "b_slide": 0.1, "elbow": 0.5}
    assert dict(zip(robot.joint_names, found.qpos, strict=True)) == pytest.approx(wanted)
    assert set(found.requested_joints) == {"elbow", "b_slide", "shoulder"}

    keys = '<keyframe><key name="home" qpos="0.1 -0.2 0.3 0.04"/><key name="out" qpos="9 0 1 0"/>'
    keys += '<key name="zero" ctrl="0 0 0 0"/>'
    text = by_hand.MJCF.replace("</mujoco>", f"{keys}</keyframe></mujoco>")
    keyed = load_arm(tmp_path, mjcf=text)
    found = find_posture(keyed)  # in the tree's order in the file, in actuator order here
    assert found.keyframe == "home"
    assert found.qpos == pytest.approx([0.3, 0.04, -0.2, 0.1])
    with pytest.raises(pa.ConfigurationError, match=r"^keyframe: elbow at 0 deg, outside"):
        find_posture(keyed, keyframe="zero")  # without qpos: qpos0, as in MuJoCo
    with pytest.raises(
        pa.ConfigurationError, match=r"^keyframe: a_turn at 515.7 deg, outside .* deg$"
    ):
        find_posture(keyed, keyframe="out")
    with pytest.raises(pa.UnknownNameError, match="home"):
        find_posture(keyed, keyframe="none")
    with pytest.raises(pa.ConfigurationError, match="finite"):
        find_posture(keyed, {"elbow": np.nan})


def test_a_tool_may_be_a_link_or_a_site() -> None:
    """Reference: central differences of the tool position."""
    config = Configuration(arm(), find_posture(arm(), POSTURE).qpos)
    for name in ("tip", "hand", "fore"):
        tool = find_tool(arm(), name)
        step = 1e-6
        columns = [
            tool.position(Configuration(arm(), config.qpos + way))
            - tool.position(Configuration(arm(), config.qpos - way))
            for way in step * np.eye(4)
        ]
        slopes = np.array(columns).T / (2 * step)
        assert tool.jacobian(config) == pytest.approx(slopes, abs=1e-8)
    assert find_tool(arm(), "fore").chain == ("a_turn", "shoulder", "elbow")
    with pytest.raises(pa.UnknownNameError, match="upper"):
        find_tool(arm(), "thumb")


def test_posture_fails_if_motors_are_too_weak(tmp_path: Path) -> None:
    """References: closed-form elbow torque, 2 % above and below the effort limit. With half of this
    torque as the limit, there is no equilibrium without feed-forward.
    """
    needs = abs(by_hand.holding_torques(0.0, 0.0, 0.5, 0.1)["elbow"])
    posture = {"a_turn": 0.0, "shoulder": 0.0, "elbow": 0.5, "b_slide": 0.1}
    for share, holds in ((1.02, True), (0.98, False)):
        urdf = by_hand.URDF.replace('effort="9.0"', f'effort="{share * needs}"')
        robot = load_arm(tmp_path, urdf=urdf)
        stand = held_stand(robot, find_posture(robot, posture))
        found = verify_stand(robot, stand, duration=4.0)
        assert found.passed is holds
        assert ("motors-give-all" in [failure.code for failure in found.failures]) is not holds
    settled = steady_state(robot, stand)  # the weak elbow sags to a smaller gravity torque
    alone = verify_stand(robot, stand, feedforward=False, settled=settled)
    assert alone.passed
    assert alone.joint_positions[0] > 0.525
    urdf = by_hand.URDF.replace('effort="9.0"', f'effort="{0.5 * needs}"')
    robot = load_arm(tmp_path, urdf=urdf)
    stand = held_stand(robot, find_posture(robot, posture))
    with pytest.raises(pa.errors.NoEquilibriumError, match="equilibrium ends"):
        steady_state(robot, stand)
    fallen = verify_stand(robot, stand, feedforward=False, duration=4.0)
    assert fallen.collapses
    assert [failure.code for failure in fallen.failures] == ["posture-left"]


COUPLED = 'joint1="b_slide" joint2="elbow" polycoef="0.02 {ratio} 0 0"'


def test_missing_equilibrium_of_an_arm_is_not_explained_by_a_stand(tmp_path: Path) -> None:
    """The reason named open loops of a stand: the arm has a coupling, and no stand. Half of the
    closed-form torque does not hold the elbow.
    """
    coupling = f"<equality><joint {COUPLED.format(ratio='0 0')}/></equality></mujoco>"
    needs = abs(by_hand.holding_torques(0.0, 0.0, 0.5, 0.1)["elbow"])
    servo = f'<position joint="b_slide" kp="{STIFFNESS["b_slide"]}" kv="20"/>'
    robot = load_arm(
        tmp_path,
        urdf=by_hand.URDF.replace('effort="9.0"', f'effort="{0.5 * needs}"'),
        mjcf=by_hand.MJCF.replace("</mujoco>", coupling).replace(servo, ""),
    )
    assert robot.closure is not None
    stand = held_stand(robot, find_posture(robot, {"a_turn": 0.0, "shoulder": 0.0, "elbow": 0.5}))
    with pytest.raises(pa.errors.NoEquilibriumError, match=r"the equilibrium ends$"):
        steady_state(robot, stand)


@pytest.mark.slow
@pytest.mark.parametrize(("ratio", "rate"), [("0.05 0", 0.05), ("0.02 0.015", 0.056)])
def test_torque_of_a_leading_joint_includes_its_follower(
    tmp_path: Path, ratio: str, rate: float
) -> None:
    """Closed form by virtual work; the opening of MuJoCo's soft coupling is predicted."""
    coupling = f"<equality><joint {COUPLED.format(ratio=ratio)}/></equality></mujoco>"
    servo = f'<position joint="b_slide" kp="{STIFFNESS["b_slide"]}" kv="20"/>'
    text = by_hand.MJCF.replace("</mujoco>", coupling).replace(servo, "")
    assert text.count("<position") == 3
    robot = load_arm(tmp_path, mjcf=text)
    held = pa.hold_posture(robot, {"shoulder": -0.4, "elbow": 1.2, "a_turn": 0.0})
    assert held.passed
    at = dict(zip(robot.joint_names, held.posture.qpos, strict=True))
    tree = by_hand.holding_torques(0.0, -0.4, 1.2, at["b_slide"])
    torques = dict(zip(robot.joint_names, held.statics.joint_torques, strict=True))
    assert torques["elbow"] == pytest.approx(tree["elbow"] + rate * tree["b_slide"], rel=1e-6)
    assert torques["b_slide"] == 0.0
    with pytest.raises(pa.ConfigurationError, match="do not close"):  # they are not both to be had
        find_posture(robot, {"elbow": 1.2, "b_slide": at["b_slide"] + 0.02})
    off = held.verification.joint_positions - held.posture.qpos
    opened = dict(zip(robot.joint_names, off, strict=True))["b_slide"]
    assert opened > 3e-3
    assert held.verification.joint_error < 1e-4
    assert held.worst.endless is None


def test_held_robot_hangs_without_ground_contact() -> None:
    """The ground does not collide, and the legs hold their posture in the air."""
    robot = pa.load_variant("v3", fixed_base=True)
    stand = held_stand(robot, find_posture(robot))
    assert verify_stand(robot, stand, duration=3.0).passed
    settled = steady_state(robot, stand)
    assert not settled.failures
    alone = verify_stand(robot, stand, feedforward=False, settled=settled)
    assert alone.passed, alone.failures
    assert "ground-touches-nothing" in {note.code for note in robot.notes}
    free = pa.load_variant("v3")  # so does one whose base is welded, all feet lifted
    task = pa.StandTask(contacts={"base": pa.Weld()}, swing=dict.fromkeys(free.feet, 0.05))
    lifted = pa.solve_stand(free, task)
    hanging = pa.gravity_compensation(Configuration(robot, lifted.qpos[7:]), contacts=[])
    torques = pa.stance.stand_statics(free, lifted).joint_torques
    np.testing.assert_array_equal(torques, hanging.joint_torques)


def test_hold_refuses_a_free_base_and_stand_refuses_no_feet() -> None:
    with pytest.raises(pa.ConfigurationError, match="fixed_base"):
        pa.hold_posture(pa.load_variant("v3"))
    with pytest.raises(pa.ConfigurationError, match="hold"):
        pa.solve_stand(arm())


@pytest.mark.slow
def test_any_mass_is_held_without_gravity(tmp_path: Path) -> None:
    """The torque error is relative to the torques under normal gravity, so zero torques give no
    NaN."""
    floating = by_hand.MJCF.replace("<option ", '<option gravity="0 0 0" ')
    held = pa.hold_posture(load_arm(tmp_path, mjcf=floating), POSTURE)
    assert held.verdict.code is VerdictCode.HOLDS
    assert held.verification.torque_error < 1e-9
    assert not held.statics.joint_torques.any()
    assert held.payload.mass == held.payload.worst_posture_mass == np.inf
    page = write_markdown(build_report([("", held)]))
    assert "any mass at tip in this posture" in page
    assert "nan" not in page
    assert "inf kg" not in page


@pytest.mark.slow
def test_welded_base_gives_the_results_of_a_fixed_base(tmp_path: Path) -> None:
    """Reference: the held posture of the robot with a fixed base. The base has 20 g, and the robot
    has a closed loop.
    """
    (tmp_path / "bars.xml").write_text(FOUR_BARS.replace('mass="1"', 'mass=".02"'))
    robot = pa.load_robot(tmp_path / "bars.xml")
    held = pa.hold_posture(robot, {"crank": 0.3}, tool="rod")
    seed = tuple(held.posture.qpos.tolist())
    task = pa.StandTask(height=0.8, contacts={"base": pa.Weld()}, ik_seed=seed)
    stance = study_stance(robot, task)
    # Its loops open by micrometres along other joints.
    assert stance.statics.joint_torques == pytest.approx(held.statics.joint_torques, rel=1e-3)
    assert stance.settled is not None
    assert held.settled is not None
    assert stance.settled.qpos[7:] == pytest.approx(held.settled.qpos, abs=1e-3)
    assert np.abs(held.settled.qpos - held.posture.qpos).max() > 5e-3
    assert stance.verdict.code is held.verdict.code
    assert held.verdict.keyframe_run is not None
    assert stance.verdict.keyframe_run == held.verdict.keyframe_run
    place = (held.tool.link, *held.tool.offset.tolist())
    limit = pytest.importorskip("pupper_analysis.tools.payload.limit")
    carried = limit.payload_limit(robot, task, place)
    bound = min(held.payload.mass, held.payload.servos)
    assert min(carried.motors.mass, carried.servos.mass) == pytest.approx(bound, rel=2e-3)
    # After a nudge the motor exerts more: the mass that holds in simulation is found to 1 %.
    assert 0.985 * bound < carried.mass <= 1.002 * bound


def test_posture_with_touching_parts_fails(tmp_path: Path) -> None:
    """A sphere at the hand, 5 mm inside a sphere at the base, or beside it."""
    posture = {"a_turn": 0.0, "shoulder": 0.0, "elbow": 0.5, "b_slide": 0.1}
    place = by_hand.tip_position(0.0, 0.0, 0.5, 0.1 - by_hand.SLIDE)
    for beside, codes in ((0.0, {"parts-touch"}), (0.1, set())):
        x, y, z = place + np.array([0.0, beside, -0.095])
        text = by_hand.MJCF.replace('<site name="tip"', '<geom size=".05"/><site name="tip"')
        post = f'<body name="base"><geom size=".05" pos="{x} {y} {z}"/>'
        robot = load_arm(tmp_path, mjcf=text.replace('<body name="base">', post))
        stand = held_stand(robot, find_posture(robot, posture))
        found = {failure.code for failure in verify_stand(robot, stand, duration=3.0).failures}
        assert (found & {"parts-touch"}) == codes


@pytest.mark.slow
def test_a_light_welded_base_does_not_shake(tmp_path: Path) -> None:
    """Reference: 4 s in MuJoCo. A base of 50 g on MuJoCo's soft weld would oscillate."""
    (tmp_path / "arm.xml").write_text(
        by_hand.MJCF.replace(
            '<body name="base">', '<body name="base"><geom size=".02" mass=".05"/>'
        )
    )
    robot = pa.load_robot(tmp_path / "arm.xml")
    task = pa.StandTask(height=1.0, contacts={"base": pa.Weld()})
    stand = pa.stance.solve_stand_as_simulated(robot, task)
    assert pa.verify_stand(robot, stand, duration=4.0).passed


@pytest.mark.parametrize(
    ("joints", "said"),
    [
        ({"elbow": 3.0}, "171.9 deg, outside"),
        ({"knee": 0.0}, "shoulder"),
        ({"elbow": np.nan}, "finite"),
    ],
)
def test_invalid_posture_is_refused(joints: dict[str, float], said: str) -> None:
    with pytest.raises((pa.ConfigurationError, pa.UnknownNameError), match=said):
        find_posture(arm(), joints)


@pytest.mark.slow
def test_linkage_with_two_pivots_in_the_world_is_one_robot(tmp_path: Path) -> None:
    """Reference: bare MuJoCo at rest on servos of 10,000 N m/rad, which do not sag."""
    arm = """<body name="{0}1" pos="{1} 0 1"><joint name="{0}m" axis="0 1 0" range="-3 3"/>
    <geom type="capsule" fromto="0 0 0 {1} 0 -0.15" size="0.01" mass="0.3" contype="0"/>
    <body name="{0}2" pos="{1} 0 -0.15"><joint name="{0}p" axis="0 1 0" range="-3 3"/>
    <geom type="capsule" fromto="0 0 0 {2} 0 -0.2" size="0.01" mass="0.3" contype="0"/>
    </body></body>"""
    servos = "".join(f'<position name="{n}m" joint="{n}m" kp="10000" kv="100"/>' for n in "ab")
    path = tmp_path / "linkage.xml"
    path.write_text(
        f"""<mujoco><compiler angle="radian"/><option integrator="implicitfast" timestep="0.001"/>
        <default><geom conaffinity="0"/></default><worldbody>
        {arm.format("a", -0.1, 0.2)}{arm.format("b", 0.1, -0.2)}</worldbody>
        <equality><connect body1="a2" body2="b2" anchor="0.2 0 -0.2"/></equality>
        <actuator>{servos}</actuator></mujoco>"""
    )
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    for _ in range(4000):
        mujoco.mj_step(model, data)
    robot = pa.load_robot(mjcf=path)
    config = Configuration(robot, find_posture(robot).qpos)
    statics = gravity_compensation(config, contacts=[])
    torques = dict(zip(robot.joint_names, statics.joint_torques, strict=True))
    expected = {"am": data.actuator_force[0], "bm": data.actuator_force[1]}
    assert expected["am"] == pytest.approx(0.662, abs=0.002)
    for joint, torque in expected.items():
        assert torques[joint] == pytest.approx(torque, rel=2e-3)


def test_two_arms_in_the_world_without_a_coupling_are_several_robots(tmp_path: Path) -> None:
    arm = (
        """<body name="{0}1"><joint name="{0}j" axis="0 1 0"/><geom size="0.1" mass="1"/></body>"""
    )
    path = tmp_path / "arms.xml"
    path.write_text(f"<mujoco><worldbody>{arm.format('a')}{arm.format('b')}</worldbody></mujoco>")
    with pytest.raises(pa.ModelError, match="several robots"):
        pa.load_robot(mjcf=path)


@pytest.mark.slow
def test_payload_by_commands_alone_is_the_largest_that_holds_without_feedforward() -> None:
    """Reference: `hold_posture` with the mass as payload, below and above the reported mass.

    The motors hold 0.72 kg in the worst posture; servos with kp 30 N m/rad need feed-forward.
    """
    posture = {"shoulder": -0.4, "elbow": 0.9}
    held = pa.hold_posture(arm(), posture, kp=30.0, kd=1.0, commands_alone=True)
    mass = held.mass_by_commands_alone
    assert 0 < mass < held.payload.worst_posture_mass
    for ratio, holds in ((1.0, True), (1.03, False)):
        loaded = pa.hold_posture(arm(), posture, kp=30.0, kd=1.0, payload=ratio * mass)
        assert loaded.passed
        assert (loaded.verdict.commands_alone == "holds") is holds


@pytest.mark.slow
def test_payload_that_holds_without_feedforward_has_no_second_mass() -> None:
    """Reference: `hold_posture` with the payload limit holds without feed-forward."""
    posture = {"shoulder": -0.4, "elbow": 0.9}
    held = pa.hold_posture(arm(), posture, commands_alone=True)
    assert np.isnan(held.mass_by_commands_alone)
    limit = held.payload.worst_posture_mass
    loaded = pa.hold_posture(arm(), posture, payload=limit)
    assert loaded.verdict.commands_alone == "holds"
    assert np.isnan(pa.hold_posture(arm(), posture, kp=30.0, kd=1.0).mass_by_commands_alone)
