"""The unmodified MJCF is simulated from its keyframe; its result is the first part of each
verdict.
"""

from __future__ import annotations

import copy
import math
import re
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.models.mjcf_file import read_mjcf
from pupper_analysis.models.transmission import Drive
from pupper_analysis.prepare import self_check
from pupper_analysis.prepare.own_run import own_run
from pupper_analysis.prepare.published_model import PublishedModel
from pupper_analysis.prepare.self_check import compare_nominal_stand
from pupper_analysis.present.verdict import format_verdict
from pupper_analysis.robot.as_published import OwnCommands
from pupper_analysis.robot.robot import PublishedFile
from pupper_analysis.robot.servos import find_servos_used
from pupper_analysis.robot.tool import with_payload
from pupper_analysis.simulation.rollout import make_stand_start
from pupper_analysis.simulation.verdict import Verdict, VerdictCode
from pupper_analysis.tools.stand.stance import study_stance
from tests.support import legged, random_legged
from tests.support.every_command import Truth, simulate_truth
from tests.support.legged import edited_by, rewrite_file
from tests.support.slips import SLIPS, standing
from tests.support.variants import load


def verdict_of(pair: legged.Pair) -> Verdict:
    robot = pa.load_robot(*pair)
    return pa.judge_stand(robot, pa.solve_stand(robot))


def write_slip(folder: Path, name: str, seed: int = 0) -> legged.Pair:
    pair, random = standing(folder), np.random.default_rng(seed)
    edited_by(pair.mjcf, lambda text: SLIPS[name](text, random))
    return pair


@pytest.mark.slow
def test_verdict_holds_if_the_unmodified_file_stands(tmp_path: Path) -> None:
    """Reference: bare MuJoCo with the unmodified file (`simulate_truth`).

    Heights are predicted within 10 nm.
    """
    pair = standing(tmp_path)
    assert simulate_truth(pair.mjcf, pair.mjcf) is Truth.STANDS
    robot = pa.load_robot(*pair)
    verdict = pa.judge_stand(robot, pa.solve_stand(robot))
    own, published = verdict.keyframe_run, verdict.published
    assert own is not None
    assert own.commands is OwnCommands.STATED
    assert not own.falls
    assert own.worst is not None
    assert own.worst.drive is Drive.SERVO
    assert abs(own.worst.off) < 0.03
    assert published is not None
    assert not published.differs
    assert [run.feedforward for run in published.runs] == [True, False]
    for run in published.runs:  # the prediction includes the creep of the feet
        assert abs(run.height_error) < 1e-8
        assert run.torque_error < 1e-4
    assert verdict.code is VerdictCode.HOLDS
    assert "unmodified MJCF, from keyframe home, 5 s: CoM height" in format_verdict(verdict)
    assert not verdict.servos.made


@pytest.mark.slow
def test_height_loss_excludes_the_drop_of_a_keyframe_in_the_air(tmp_path: Path) -> None:
    """By hand: the CoM is 46 mm below the base. The feet are 0.15 m above the ground in the
    keyframe, as in that of Pupper v3.
    """
    pair = standing(tmp_path)
    force = ("<position ", '<position forcerange="-40 40" ')
    rewrite_file(pair.mjcf, ('qpos="0 0 0.35 ', 'qpos="0 0 0.5 '), force)
    own = own_run(pa.load_robot(*pair))
    assert own is not None
    assert not own.collapses
    # Height of the CoM, 46 mm below the base, which is 0.35 m high in the stand.
    assert own.end_height == pytest.approx(0.304, abs=0.01)
    assert own.height == pytest.approx(0.307, abs=1e-3)  # at reset, less the clearance
    assert own.clearance == pytest.approx(0.15, abs=1e-3)
    assert "keyframe-falls" not in {found.rule for found in pa.audit_model(pair.mjcf).findings}


@pytest.mark.slow
@pytest.mark.parametrize("legs", ["0 1.2 -2.3", "0 1.35 -2.6"])
@pytest.mark.parametrize("gap", [2e-4, 1e-2])
def test_a_robot_whose_legs_retract_before_its_feet_touch_collapses(
    tmp_path: Path, legs: str, gap: float
) -> None:
    """In bare MuJoCo the CoM loses 49 and 64 % of its height at reset.

    The feet are 0.07 and 10 mm above the floor at reset, and the servos pull the legs up in
    flight. The height of the CoM at the first contact was taken for the initial height.
    """
    pair = standing(tmp_path)
    edits = (" ".join(["0 0.6 -1.2"] * 4) + '"/></key', " ".join([legs] * 4) + '"/></key')
    rewrite_file(pair.mjcf, edits, ('qpos="0 0 0.35 ', f'qpos="0 0 {0.35 + gap} '))
    model = mujoco.MjModel.from_xml_path(str(pair.mjcf))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    height = float(data.subtree_com[1][2])
    assert not data.ncon
    mujoco.mj_step(model, data, round(5.0 / model.opt.timestep))
    assert data.subtree_com[1][2] < 0.55 * height
    own = own_run(pa.load_robot(*pair))
    assert own is not None
    assert own.height + own.clearance == pytest.approx(height, abs=1e-6)
    assert own.end_height == pytest.approx(float(data.subtree_com[1][2]), abs=2e-3)
    assert own.collapses
    assert own.fails


def test_robot_that_slides_away_counts_as_collapsed(tmp_path: Path) -> None:
    """Reference: g t^2 / 2 with friction 0.01. The robot stays upright."""
    pair = standing(tmp_path)
    robot = pa.load_robot(*pair)
    ice = ('type="plane"', 'priority="1" friction="0.01" type="plane"')
    rewrite_file(pair.mjcf, ("<option ", '<option gravity="0.6 0 -9.81" '), ice)
    run = own_run(replace(robot, published=PublishedFile(read_mjcf(pair.mjcf))))
    assert run is not None
    assert run.end_height == pytest.approx(run.height, rel=0.1)
    assert run.away == pytest.approx(0.5 * (0.6 - 0.01 * 9.81) * run.duration**2, rel=0.05)
    assert run.collapses
    assert run.has_left_place
    assert "keyframe-falls" in {found.rule for found in pa.audit_model(pair.mjcf).findings}


@pytest.mark.slow
def test_robot_that_lands_on_its_knees_has_fallen(tmp_path: Path) -> None:
    """The robot starts above the ground and ends on its knees, at a CoM height of 0.195 m."""
    pair = standing(tmp_path)
    text = pair.mjcf.read_text().replace('qpos="0 0 0.35 ', 'qpos="0 0 0.5 ')
    text = text.replace(" ".join(["0 0.6 -1.2"] * 4), " ".join(["0 0 -2.5"] * 4))
    knee = '<geom type="sphere" size="0.03" pos="0 0 -0.2"/>'
    pair.mjcf.write_text(re.sub(r'(<body name="\w+_thigh"[^>]*>)', rf"\1{knee}", text))
    own = own_run(pa.load_robot(*pair))
    assert own is not None
    assert own.end_height == pytest.approx(0.195, abs=0.01)  # of the com; the base is at 0.23 m
    assert own.collapses
    assert not own.has_left_place
    assert "keyframe-falls" in {found.rule for found in pa.audit_model(pair.mjcf).findings}


@pytest.mark.slow
def test_affine_actuator_with_zero_bias_is_not_a_torque_motor(tmp_path: Path) -> None:
    """``biastype="affine"`` defines a servo: the file is simulated with its own commands, and
    falls."""
    pair = standing(tmp_path)
    servo = 'general gainprm="150" biastype="affine" biasprm="0 0 0"'
    rewrite_file(pair.mjcf, ('kp="150" kv="5"', ""), ("<position", f"<{servo}"))
    robot = pa.load_robot(*pair)
    own = own_run(robot)
    assert own is not None
    assert own.collapses
    assert {made.instead_of for made in robot.description.made_servos} == {Drive.OTHER}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("kp of one has the wrong sign", "a servo whose stiffness is negative"),
        ("kp is 0", "a servo without stiffness"),
        ("ctrl is of lying down", "unmodified MJCF, from keyframe home, 5 s: COLLAPSES"),
        ("gear of all is -1", "unmodified MJCF, from keyframe home, 5 s: COLLAPSES"),
    ],
)
def test_verdict_fails_if_the_unmodified_file_falls(tmp_path: Path, name: str, text: str) -> None:
    """Reference: bare MuJoCo with the unmodified file (`simulate_truth`)."""
    pair = write_slip(tmp_path, name)
    assert simulate_truth(pair.mjcf, pair.mjcf) in (Truth.FALLS, Truth.ELSEWHERE)
    verdict = verdict_of(pair)
    assert verdict.code is VerdictCode.OWN_DRIVES_FAIL
    assert not verdict.passed
    assert text in format_verdict(verdict)


@pytest.mark.slow
def test_servo_with_gain_of_the_wrong_sign_is_replaced_and_named(tmp_path: Path) -> None:
    """No note claims that position servos are missing, and ``as_is`` refuses the joint."""
    pair = write_slip(tmp_path, "kp of one has the wrong sign", seed=3)
    robot = pa.load_robot(*pair)
    (made,) = robot.description.made_servos
    assert made.instead_of is Drive.WRONG_SIGN
    assert not any("no position servos:" in str(note) for note in robot.notes)
    as_is = pa.load_robot(*pair, as_is=True)
    with pytest.raises(pa.ModelError, match=f"{made.joint}.*is not a position servo"):
        study_stance(as_is, pa.StandTask())


# {cause: (old text, new text, element of the cause, text in its line or None)}
_TIED = "<equality>\n<{}/></equality><actuator>"
_OVERRIDE = '<option o_solref="0.05 1">\n<flag override="enable"/></option><option '
_EXCLUDE = '<contact>\n<exclude body1="world" body2="FL_calf"/></contact><actuator>'
CAUSES = {
    "exclude": ("<actuator>", _EXCLUDE, "world and FL_calf", None),
    "override": ("<option ", _OVERRIDE, "flag override", None),
    "weld": ("<actuator>", _TIED.format('weld name="hung" body1="trunk"'), "hung", "<weld"),
    "connect": (
        "<actuator>",
        _TIED.format('connect name="hung" body1="trunk" anchor="0 0 0"'),
        "hung",
        "<connect",
    ),
    "ctrlrange": ('kp="150"', 'ctrlrange="-1.1 1.1" kp="150"', "FL_roll", "<position"),
    "timeconst": ('kp="150"', 'timeconst="20" kp="150"', "FL_roll", "<position"),
}


@pytest.mark.slow
@pytest.mark.parametrize("cause", CAUSES)
def test_cause_of_a_deviation_is_named_with_its_line(tmp_path: Path, cause: str) -> None:
    """One cause is planted in the MJCF; disabling this cause removes 99 % of the deviation."""
    old, new, element, line = CAUSES[cause]
    pair = standing(tmp_path)
    rewrite_file(pair.mjcf, (old, new))
    robot = pa.load_robot(*pair)
    verdict = pa.judge_stand(robot, pa.solve_stand(robot))
    assert verdict.published is not None
    assert verdict.published.differs
    (found,) = verdict.published.causes
    assert (found.code, found.elements[0]) == (cause, element)
    assert (found.line is None) == (line is None)  # unnamed elements have no line
    assert (line or "") in pair.mjcf.read_text().splitlines()[(found.line or 1) - 1]
    assert found.remaining is not None
    assert found.remaining < 0.01
    assert verdict.code is not VerdictCode.HOLDS
    assert element in format_verdict(verdict)


@pytest.mark.slow
def test_two_files_of_different_robots_are_named_as_the_cause(tmp_path: Path) -> None:
    """The trunk of the MJCF is 1 kg heavier."""
    pair = standing(tmp_path)
    rewrite_file(pair.mjcf, ('mass="4"', 'mass="5"'))
    published = verdict_of(pair).published
    assert published is not None
    assert published.differs
    assert [cause.code for cause in published.causes] == ["pair"]


@pytest.mark.slow
def test_angles_as_commands_of_motors_fail_the_verdict(tmp_path: Path) -> None:
    """Servos without gains are motors, to which the keyframe commands 0.6 and -1.2 N m.

    Without ctrl, the fall of uncommanded motors does not fail.
    """
    pair = legged.quadruped(tmp_path, floor=True)
    own = own_run(pa.load_robot(*pair))
    assert own is not None
    assert own.collapses  # motors without commands exert no torque
    assert not own.fails
    angles = " ".join(["0 0.6 -1.2"] * 4)
    rewrite_file(pair.mjcf, ('name="home"', f'name="home" ctrl="{angles}"'))
    robot = pa.load_robot(*pair)
    own = own_run(robot)
    assert own is not None
    assert own.collapses
    assert own.fails
    assert pa.judge_stand(robot, pa.solve_stand(robot)).code is VerdictCode.OWN_DRIVES_FAIL


@pytest.mark.slow
def test_a_deviation_that_the_prepared_robot_shares_is_no_difference_of_the_file() -> None:
    """Reference: v3 with servos of negative damping, in MuJoCo: the motors do not come to rest.

    Without feed-forward the prediction is not reached, by 7 % in torque after 5 s. If the prepared
    robot moves alike, the file is not different from the robot. If the prepared robot has the
    damping of v3, and rests, the file is different.
    """
    robot = load("v3")
    restless = copy.copy(robot.mj_model)
    restless.dof_damping[:] = restless.dof_frictionloss[:] = 0.0
    restless.actuator_biasprm[:, 2] = 0.034
    fed, alone = self_check.predict_stand(robot, pa.solve_stand(robot))
    moving = replace(robot, mj_model=restless)
    published = PublishedModel.from_model(copy.copy(restless), moving)
    run = self_check.simulate_prediction(published, moving, alone)
    assert run is not None
    assert run.differs
    assert run.keeps_moving
    assert not run.collapses
    prepared = self_check._simulate_prepared_robot(moving, alone)
    assert self_check._keep_moving_alike(alone, run, prepared)
    assert not self_check._keep_moving_alike(fed, run, prepared)
    assert not self_check._keep_moving_alike(alone, run, None)
    resting = self_check._simulate_prepared_robot(robot, alone)
    assert resting is not None
    assert not self_check._keep_moving_alike(alone, run, resting)
    assert not self_check.compare_with_file(published, moving, [alone]).differs
    assert self_check.compare_with_file(published, robot, [alone]).differs


@pytest.mark.slow
def test_a_changed_model_is_simulated_until_its_deviation_is_decided() -> None:
    """Reference: simulations until the end. A robot of 10 % more weight needs more torque at rest.

    A deviation at rest ends the simulation early. A deviation that falls, of motors that shake, and
    the prediction itself do not.
    """
    robot = load("v3")
    _, alone = self_check.predict_stand(robot, pa.solve_stand(robot))
    heavy, shaking = (copy.copy(robot.mj_model) for _ in range(2))
    heavy.body_mass *= 1.1
    shaking.dof_damping[:] = shaking.dof_frictionloss[:] = 0.0
    shaking.actuator_biasprm[:, 2] = 0.034
    for model, differs, seconds in (
        (heavy, True, 3),
        (shaking, True, 5),
        (robot.mj_model, False, 5),
    ):
        published = PublishedModel.from_model(copy.copy(model), robot)
        full = self_check.simulate_prediction(published, robot, alone)
        brief = self_check.simulate_prediction(published, robot, alone, until_decided=True)
        assert full is not None
        assert brief is not None
        assert full.differs is brief.differs is differs
        assert (full.duration, brief.duration) == (5, seconds)
        tolerance = 0.02 if seconds < 5 else 0.0
        assert brief.torque_error == pytest.approx(full.torque_error, abs=tolerance, rel=0)


def write_random_robot(seed: int, folder: Path, options: str = "") -> pa.Robot:
    """Write and load a random robot with position servos, a keyframe and a floor."""
    drawn = replace(
        random_legged.draw_robot(seed), motors="position", base="free", keyframe=True, floor=True
    )
    pair = random_legged.write_robot(drawn, folder)
    text = pair.mjcf.read_text().replace("<option ", f"<option {options} ")
    pair.mjcf.write_text(text)
    return pa.load_robot(pair.urdf, pair.mjcf)


@pytest.mark.slow
def test_forces_that_relax_slowly_after_the_nudge_are_no_difference(tmp_path: Path) -> None:
    """In bare MuJoCo the torque deviation falls by e every 6.8 s, to 2e-5 of the torque in 60 s.

    The nudge moves the feet by micrometres, and friction with an impratio of 100 creeps slowly:
    4 s after the nudge the torques were off by 8.4 %, without a cause.
    """
    robot = write_random_robot(720020, tmp_path, 'cone="elliptic" impratio="100"')
    published = compare_nominal_stand(robot)
    assert published is not None
    assert not published.differs
    assert all(10 < run.duration < 40 for run in published.runs)


@pytest.mark.slow
def test_a_file_that_hops_after_an_upward_nudge_differs_by_its_time_step(tmp_path: Path) -> None:
    """The file has 2 ms; added servos shorten the step of the prepared robot to 1 ms.

    Reference: MuJoCo with both time steps, in the eighth second after a nudge of 0.05 m/s.
    """
    drawn = random_legged.draw_robot(931404)
    drawn = replace(drawn, base="free", keyframe=True, floor=True, motors="position")
    pair = random_legged.write_robot(drawn, tmp_path)
    robot = pa.load_robot(pair.urdf, pair.mjcf)
    stand = pa.solve_stand(robot, pa.StandTask(height=0.7 * robot.base_height))
    begun = make_stand_start(robot, pa.solve_stand_as_simulated(robot, stand))
    speeds = []
    for timestep in (0.002, 0.001):
        model = begun.drive.model
        model.opt.timestep = timestep
        data = mujoco.MjData(model)
        mujoco.mj_setState(model, data, begun.start, mujoco.mjtState.mjSTATE_FULLPHYSICS.value)
        data.ctrl[:] = begun.ctrl
        data.qvel[2] = 0.05
        mujoco.mj_step(model, data, nstep=round(7 / timestep))
        fastest = 0.0
        for _ in range(round(1 / timestep)):
            mujoco.mj_step(model, data)
            fastest = max(fastest, float(np.abs(data.qvel).max()))
        speeds.append(fastest)
    assert speeds[0] > 0.05
    assert speeds[1] < 1e-6
    published = self_check.compare_as_published(robot, stand, find_servos_used(robot))
    assert published is not None
    assert published.differs
    assert [cause.code for cause in published.causes] == ["timestep"]


@pytest.mark.slow
def test_passive_joints_with_springs_get_no_servo(tmp_path: Path) -> None:
    """The roll joints of the feet have a spring, no actuator, and an effort of zero.

    Reference: MuJoCo with the unmodified file, in which nothing but the spring acts on these
    joints. An external servo held these joints, and the torques were off by 1.6 %.
    """
    robot = write_random_robot(720007, tmp_path)
    passive = robot.description.passive_joints
    assert [name.partition("/")[2] for name in passive] == ["j_0_5", "j_1_5"]
    assert not robot.description.made_servos
    published = compare_nominal_stand(robot)
    assert published is not None
    assert not published.differs
    verdict = pa.judge_stand(robot, pa.solve_stand(robot))
    assert verdict.code is VerdictCode.HOLDS
    assert not {remark.code for remark in verdict.remarks} & {"motors-without-torque"}
    stiff = pa.judge_stand(robot, pa.solve_stand(robot), kp=38.2, kd=1.91)
    assert stiff.passed
    loaded = with_payload(robot, 1.26, (0.0, 0.037, 0.0))
    disagreeing = pa.judge_stand(loaded, pa.solve_stand(loaded))
    assert disagreeing.code is VerdictCode.DISAGREES  # with the spring, the feet are not flat
    assert disagreeing.failures[-1].code == "passive-joints-loaded"


@pytest.mark.slow
@pytest.mark.parametrize("tilt", [15, 45])
def test_robot_without_servos_holds_on_a_tilted_floor_as_in_bare_mujoco(
    tmp_path: Path, tilt: int
) -> None:
    """The verdict was HOLDS at each tilt. Reference: bare MuJoCo with the added servos, on the
    unmodified floor, from the stand that is turned with the floor.
    """
    angle = math.radians(tilt)
    floor = f'<worldbody><geom type="plane" size="0 0 1" euler="0 {angle} 0"/>'
    text = re.sub(
        "<actuator>.*</actuator>", "", legged.quadruped(tmp_path).mjcf.read_text(), flags=re.S
    )
    mjcf = tmp_path / "tilted.xml"
    mjcf.write_text(text.replace("<worldbody>", floor))
    robot = pa.load_robot(mjcf=mjcf)
    stand = pa.solve_stand(robot)
    spec = mujoco.MjSpec.from_file(str(mjcf))
    spec.delete(spec.keys[0])
    for servo in robot.description.made_servos:
        actuator = spec.add_actuator(target=servo.joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        actuator.set_to_position(kp=servo.kp, kv=servo.kd)
    model = spec.compile()
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    data = mujoco.MjData(model)
    turn = np.array([math.cos(angle / 2), 0.0, math.sin(angle / 2), 0.0])
    mujoco.mju_rotVecQuat(data.qpos[:3], stand.qpos[:3], turn)
    mujoco.mju_mulQuat(data.qpos[3:7], turn, stand.qpos[3:7])
    for number, servo in enumerate(robot.description.made_servos):
        position = stand.qpos[7 + robot.joint_names.index(servo.joint)]
        data.ctrl[number] = data.joint(servo.joint).qpos[0] = position
    while data.time < 5.0:
        mujoco.mj_step(model, data)
    normal = [math.sin(angle), 0.0, math.cos(angle)]
    base = data.body("trunk")
    stands = base.xmat.reshape(3, 3)[:, 2] @ normal > 0.95 and base.xpos @ normal > 0.3
    assert bool(stands) is (tilt == 15)
    assert pa.judge_stand(robot, stand).passed is bool(stands)
