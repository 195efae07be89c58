"""Servos put in place of torque motors hold the robot as predicted, whatever the motors' gears."""

from __future__ import annotations

import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.prepare import drives, judge, self_check
from pupper_analysis.prepare.notes import report_joints_without_actuator
from pupper_analysis.prepare.self_check import compare_as_published, compare_nominal_stand
from pupper_analysis.present.document import get_english
from pupper_analysis.pupper.variants import find_model_folder
from pupper_analysis.robot.servos import find_servos_used, model_with_servos
from pupper_analysis.robot.tool import with_payload
from pupper_analysis.simulation.rollout import make_stand_start
from pupper_analysis.simulation.settling import calms_after_base_nudges
from pupper_analysis.simulation.verdict import VerdictCode
from pupper_analysis.tools.stand.document import stance_document
from pupper_analysis.tools.stand.stance import study_stance
from tests.support.legged import quadruped, rewrite_file
from tests.support.random_legged import draw_robot, write_robot
from tests.support.variants import load, stand_of


@pytest.mark.slow
def test_servos_instead_of_geared_motors_hold_as_predicted(tmp_path: Path) -> None:
    """Reference: simulation of the published file, whose motors the servo law commands.

    Gains and limits in notes are those at the joint.
    """
    pair = quadruped(tmp_path, floor=True)
    rewrite_file(pair.mjcf, ('ctrlrange="-30 30"', 'gear="3" ctrlrange="-10 10"'))
    robot = pa.load_robot(*pair)
    made = {servo.joint: servo for servo in robot.description.made_servos}
    assert set(made) == set(robot.joint_names)
    drive = model_with_servos(robot)
    np.testing.assert_allclose(drive.kp, [made[name].kp for name in robot.joint_names])
    np.testing.assert_allclose(drive.kd, [made[name].kd for name in robot.joint_names])
    np.testing.assert_allclose(robot.effort_limits, 30.0)
    [steps] = [
        addition
        for addition in robot.description.added
        if "integrator" in getattr(addition, "values", {})
    ]
    assert "integrator implicitfast, 2 ms" in str(steps.reason)
    assert steps.values["timestep"] == 0.002
    published = compare_nominal_stand(robot)
    assert published is not None
    assert not published.differs
    for run in published.runs:
        assert abs(run.height_error) < 1e-8
        assert run.torque_error < 1e-5


@pytest.mark.slow
@pytest.mark.parametrize("seed", [701, 708])
def test_added_servos_suit_the_time_step_of_the_file(tmp_path: Path, seed: int) -> None:
    """At the 2 ms of the file, the robot of seed 701 oscillated on the servos that held it at 1 ms
    (kp 2700, kd 130).
    """
    robot = pa.load_robot(write_robot(draw_robot(seed), tmp_path).mjcf)
    assert robot.published is not None
    assert robot.published.file is not None
    assert robot.mj_model.opt.timestep == robot.published.file.model.opt.timestep == 2e-3
    verdict = pa.judge_stand(robot, pa.solve_stand(robot))
    assert verdict.code is VerdictCode.HOLDS_ON_ADDED_SERVOS
    assert verdict.published is not None
    assert not verdict.published.differs
    assert verdict.keyframe_run is not None
    assert not verdict.keyframe_run.falls


def _light_footed_biped() -> str:
    """Return a URDF of a biped with line feet: dimensions and masses of the public robot HECTOR.

    The inertia about the ankle is 2e-4 kg m^2, since the URDF states no armature.
    """
    chain = (
        ("hip", "0 0 1", (0, 0.047, -0.1265), 0.0, 0.778, (0.067, 0.011, -0.061), (1.2, 1.4, 1.0)),
        (
            "roll",
            "1 0 0",
            (0.0465, 0.015, -0.0705),
            0.0,
            0.677,
            (-0.057, -0.014, 0),
            (0.5, 0.6, 0.8),
        ),
        ("thigh", "0 1 0", (-0.06, 0.018, 0), 0.785, 1.607, (0, 0.02, -0.057), (6.0, 5.8, 1.8)),
        ("calf", "0 1 0", (0, 0, -0.22), -1.571, 0.163, (0, 0.02, -0.114), (0.71, 0.71, 0.07)),
        ("toe", "0 1 0", (0, 0, -0.22), 0.785, 0.184, (0.011, 0.018, -0.017), (0.05, 0.21, 0.2)),
    )
    parts = [
        '<robot name="light_feet"><link name="trunk"><inertial><mass value="4.87"/>'
        '<inertia ixx="0.052" iyy="0.0441" izz="0.0184" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    ]
    for side, sign in (("L", 1), ("R", -1)):
        parent = "trunk"
        for name, axis, (x, y, z), pitch, mass, com, moments in chain:
            link, (xx, yy, zz) = f"{side}_{name}", (1e-3 * moment for moment in moments)
            sole = (
                f'<collision><origin xyz="0.01 {0.0194 * sign} -0.02"/><geometry>'
                '<box size="0.15 0.02 0.04"/></geometry></collision>'
            )
            parts.append(
                f'<link name="{link}"><inertial><origin xyz="{com[0]} {com[1] * sign} {com[2]}"/>'
                f'<mass value="{mass}"/><inertia ixx="{xx}" iyy="{yy}" izz="{zz}" ixy="0" ixz="0"'
                f' iyz="0"/></inertial>{sole if name == "toe" else ""}</link>'
                f'<joint name="{link}_joint" type="revolute"><parent link="{parent}"/>'
                f'<child link="{link}"/><origin xyz="{x} {y * sign} {z}" rpy="0 {pitch} 0"/>'
                f'<axis xyz="{axis}"/><limit lower="-1.7" upper="1.7" effort="67" velocity="20"/>'
                "</joint>"
            )
            parent = link
    return "".join([*parts, "</robot>"])


@pytest.mark.slow
def test_time_step_of_a_light_footed_robot_lets_it_rest(tmp_path: Path) -> None:
    """Reference: a plain MuJoCo loop from the stand, nudged by 1 mm/s and 1 mrad/s, comes to rest.

    At 0.5 ms no gains of `add_position_servos` brought it to rest: its contacts chattered.
    """
    file = tmp_path / "light_feet.urdf"
    file.write_text(_light_footed_biped())
    robot = pa.load_robot(file)
    stance = study_stance(robot, pa.StandTask())
    assert stance.verdict.code is VerdictCode.HOLDS_ON_ADDED_SERVOS
    document = stance_document(stance)
    findings, details = (
        [get_english(words) for words in lines] for lines in (document.findings, document.details)
    )
    assert sum(line.startswith("added servos: kp") for line in findings) == 1
    assert not any("on servos that were added" in line for line in findings)  # stated once
    assert sum("on servos that were added" in line for line in details) == 1
    held = make_stand_start(robot, stance.stand)
    model = held.drive.model
    assert model.opt.timestep == 2e-3 / 8
    data = mujoco.MjData(model)
    mujoco.mj_setState(model, data, held.start, mujoco.mjtState.mjSTATE_FULLPHYSICS.value)
    data.ctrl[:], data.qvel[:] = held.ctrl, 1e-3
    mujoco.mj_step(model, data, round(10.0 / model.opt.timestep))
    assert np.abs(data.qvel).max() < 1e-5
    assert data.qpos[2] == pytest.approx(stance.stand.qpos[2], abs=1e-3)


@pytest.mark.slow
def test_motion_after_nudges_of_the_base_decays_at_a_smaller_time_step(tmp_path: Path) -> None:
    """Reference: the largest speed in a plain MuJoCo loop, 5 to 6 s after a push along y."""
    file = tmp_path / "light_feet.urdf"
    file.write_text(_light_footed_biped())
    robot = pa.load_robot(file)
    stand = pa.solve_stand(robot)
    for timestep, decays in ((2.5e-4, True), (5e-4, False)):
        robot.mj_model.opt.timestep = timestep
        assert calms_after_base_nudges(robot, stand) == decays
        held = make_stand_start(robot, stand)
        model = held.drive.model
        assert model.opt.timestep == timestep
        data = mujoco.MjData(model)
        mujoco.mj_setState(model, data, held.start, mujoco.mjtState.mjSTATE_FULLPHYSICS.value)
        data.ctrl[:] = held.ctrl
        data.qvel[1] += 0.05
        mujoco.mj_step(model, data, round(5.0 / timestep))
        largest = 0.0
        for _ in range(round(1.0 / timestep)):
            mujoco.mj_step(model, data)
            largest = max(largest, float(np.abs(data.qvel).max()))
        assert (largest < 1e-3) == decays
        assert (largest > 0.1) == (not decays)


@pytest.mark.slow
@pytest.mark.parametrize("alone", [True, False])
def test_time_step_is_reduced_if_contacts_chatter_after_nudges_of_the_base(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, alone: bool
) -> None:
    """As for the reduced Talos, which rests only with feed-forward, and chatters at 2 and 1 ms.

    A stub replaces the simulation of chatter. Without a time step that prevents chatter, the first
    candidate is used.
    """
    file, chattering = tmp_path / "robot.urdf", [2e-3, 1e-3]
    file.write_text((find_model_folder("urdf") / "pupper_v3.urdf").read_text())
    tried = []

    def calms(robot: pa.Robot, _stand: pa.Stand, **_gains: np.ndarray) -> bool:
        tried.append(float(robot.mj_model.opt.timestep))
        return tried[-1] not in chattering

    rests = drives.comes_to_rest

    def rests_if_fed(robot: pa.Robot, stand: pa.Stand, *, feedforward: bool, **gains: Any) -> bool:
        return (feedforward or alone) and rests(robot, stand, feedforward=feedforward, **gains)

    monkeypatch.setattr(drives, "calms_after_base_nudges", calms)
    monkeypatch.setattr(drives, "comes_to_rest", rests_if_fed)
    assert pa.load_robot(file).mj_model.opt.timestep == 5e-4
    assert tried == [2e-3, 1e-3, 5e-4]
    tried.clear()
    chattering += [5e-4, 2.5e-4]
    assert pa.load_robot(file).mj_model.opt.timestep == 2e-3
    assert tried == [2e-3, 1e-3, 5e-4, 2.5e-4]


FINGERS = 12


@pytest.mark.slow
def test_gains_of_joints_with_coupled_fingers_do_not_oscillate(tmp_path: Path) -> None:
    """Romeo's hands shook at 18 Hz: damping of a servo acts on its own joint first."""
    parts = []
    for number in range(FINGERS):
        parent = f"tip{number - 1}" if number % 3 else "base_link"
        away = 0.02 if number % 3 else 0.1
        mimic = '<mimic joint="finger0"/>' if number else ""
        parts.append(
            f"""<link name="tip{number}"><inertial><origin xyz="0.001 0 0"/><mass value="0.002"/>
            <inertia ixx="1e-6" iyy="1e-6" izz="1e-6" ixy="0" ixz="0" iyz="0"/></inertial></link>
            <joint name="finger{number}" type="revolute"><parent link="{parent}"/>
            <child link="tip{number}"/><origin xyz="{away} 0 0"/><axis xyz="0 1 0"/>
            <limit lower="-1" upper="1" effort="1" velocity="1"/>{mimic}</joint>"""
        )
    file = tmp_path / "robot.urdf"
    text = (find_model_folder("urdf") / "pupper_v3.urdf").read_text()
    file.write_text(text.replace("</robot>", f"{''.join(parts)}</robot>"))
    robot = pa.load_robot(file)
    assert robot.closure is not None
    restless = {"no-servos-bring-it-to-rest", "rests-with-feed-forward-alone"}
    assert not {note.code for note in robot.notes} & restless
    seen = pa.verify_stand(robot, pa.stance.solve_stand_on_soft_ground(robot), nudged=0.0)
    assert seen.passed, seen.failures


@pytest.mark.slow
def test_nominal_stand_is_compared_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A verdict without payload and a verdict with payload use the same comparison."""
    pair = quadruped(tmp_path, floor=True)
    rewrite_file(pair.mjcf, ('ctrlrange="-30 30"', 'gear="3" ctrlrange="-10 10"'))
    robot = pa.load_robot(*pair)
    simulated = []
    simulate = self_check.simulate_prediction
    monkeypatch.setattr(
        self_check,
        "simulate_prediction",
        lambda *args, **options: simulated.append(1) or simulate(*args, **options),
    )
    servos = find_servos_used(robot, None, None)
    first = compare_as_published(robot, pa.solve_stand(robot), servos)
    assert simulated
    count = len(simulated)
    assert compare_as_published(robot, pa.solve_stand(robot), servos) is first
    loaded = with_payload(robot, 1.0, (0.0, 0.0, 0.0))
    assert compare_as_published(loaded, pa.solve_stand(loaded), servos) is first
    assert len(simulated) == count
    tilted = compare_as_published(robot, pa.solve_stand(robot, pa.StandTask(pitch=0.05)), servos)
    assert tilted is not first
    assert len(simulated) > count


def test_smaller_time_step_is_not_simulated_if_gains_suit_the_step_of_the_file(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The published file does not rest with these gains, and is no reason for a smaller step."""
    robot, stand = load("v3"), stand_of("v3")
    step, gains = float(robot.mj_model.opt.timestep), np.ones((2, robot.nu))
    simulated: list[float] = []

    def rest(robot: pa.Robot, *_: object, **__: object) -> bool:
        simulated.append(float(robot.mj_model.opt.timestep))
        return True

    replaced: dict[str, Any] = {
        "comes_to_rest": rest,
        "make_missing_servos": lambda *_: [],
        "_list_candidates": lambda *_, **__: [
            drives._ServoCandidate(divisor, *gains) for divisor in (1, 1, 2, 4)
        ],
        "_is_as_predicted": lambda *_: True,
        "calms_after_base_nudges": lambda *_, **__: True,
        "compile_published_model": lambda *_: object(),
        "settles_in_place": lambda *_: False,
        "_record_added_servos": lambda *_: robot,
        "_build_with_servos": lambda *_: robot,
    }
    for name, value in replaced.items():
        monkeypatch.setattr(drives, name, value)
    original: Any = SimpleNamespace(of_urdf=False)
    made = drives.add_position_servos(robot, stand, original)
    assert made.num_rest_modes == 2
    assert simulated == [step] * 4  # two candidates, with and without feed-forward


@pytest.mark.parametrize(
    ("removed", "count"),
    [(r"FL_knee", 11), (r"FL_knee|RR_roll", 10), (r"\w+", 0), (r"no_joint", 0)],
)
def test_joints_without_actuator_are_reported_if_other_joints_have_actuators(
    tmp_path: Path, removed: str, count: int
) -> None:
    """Reference: the joints at which MuJoCo's actuators exert no torque, whatever the ctrl is."""
    pair = quadruped(tmp_path, floor=True)
    text = re.sub(rf'<motor joint="(?:{removed})"[^>]*/>', "", pair.mjcf.read_text())
    pair.mjcf.write_text(text)
    model = mujoco.MjModel.from_xml_path(str(pair.mjcf))
    data = mujoco.MjData(model)
    data.ctrl[:] = 1.0
    mujoco.mj_forward(model, data)
    robot = pa.load_robot(*pair)
    bare = [
        name for name in robot.joint_names if data.qfrc_actuator[model.joint(name).dofadr[0]] == 0
    ]
    messages = list(report_joints_without_actuator(robot))
    if not count:
        assert messages == []
        return
    (message,) = messages
    assert list(message.values["joints"]) == bare
    assert message.values["count"] == count == robot.nu - len(bare)
    remarks = judge._list_model_remarks(robot, pa.solve_stand(robot), None, given_gains=True)
    assert message in remarks
