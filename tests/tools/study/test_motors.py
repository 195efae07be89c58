"""Motors as rows of a study, requirements, and designs recomputed from bare MuJoCo."""

from __future__ import annotations

import json
import math
import re
import shlex
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pandas as pd
import pinocchio as pin
import pytest

import pupper_analysis as pa
from pupper_analysis.base.errors import ConfigurationError, ModelError, UnknownNameError
from pupper_analysis.models.motors.motor import Motor
from pupper_analysis.models.motors.reading import find_motor
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.stance.stand import stand_statics
from pupper_analysis.tools.study import measures
from pupper_analysis.tools.study.document import study_document
from pupper_analysis.tools.study.motors import encode_motor, with_motors
from pupper_analysis.tools.study.outcome import check_objectives, study_outcome
from pupper_analysis.tools.study.requirements import Requirement
from pupper_analysis.tools.study.study import Study, read_study
from pupper_analysis.tools.study.write import write_design
from tests.support import slips
from tests.support.commands import run_command
from tests.support.legged import quadruped
from tests.support.printing import printed
from tests.support.repository import ROOT
from tests.support.variants import load

PRESENT = find_motor("steadywin-gim4305-10")
OTHER = Motor(
    *("other", "bench"),
    rotor_inertia=2e-5,
    gear_ratio=10.0,
    output_torque_constant=0.6,
    peak_torque=5.0,
    continuous_torque=2.0,
    resistance=1.0,
    no_load_speed=20.0,
    kp=8.0,
    kd=0.2,
    mass=0.200,
)


def test_motors_change_mass_effort_speed_inertia_and_gains() -> None:
    """References: the numbers of the motor; both engines; the origin of the joint in MuJoCo.

    A motor at a hip adds its mass to the base, at the axis of the joint.
    """
    robot = load("v3")
    joint = "leg_front_r_1"
    found = with_motors(robot, {joint: OTHER}, PRESENT)
    index = robot.joint_names.index(joint)
    assert found.total_mass == pytest.approx(robot.total_mass + 0.06, rel=1e-12)
    assert found.mj_model.body_mass.sum() == pytest.approx(found.total_mass, rel=1e-9)
    before, after = (
        Configuration(model, model.neutral()).center_of_mass() for model in (robot, found)
    )
    data = robot.compute_kinematics()
    anchor = data.xanchor[robot.mj_model.joint(joint).id]
    expected = (robot.total_mass * before + 0.06 * anchor) / found.total_mass
    np.testing.assert_allclose(after, expected, atol=1e-6)
    assert found.effort_limits[index] == 5.0
    assert found.effort_limits[index + 1] == robot.effort_limits[index + 1]
    dof = found.mj_model.joint(joint).dofadr[0]
    assert found.mj_model.dof_armature[dof] == pytest.approx(2e-5 * 100)
    speeds = found.pin_model.velocityLimit[found.pin_convention.v_index]
    assert speeds[index] == 20.0
    actuator = found.mj_convention.actuator_index[index]
    assert found.mj_model.actuator_gainprm[actuator, 0] == 8.0
    assert found.mj_model.actuator_biasprm[actuator, 2] == pytest.approx(-0.2)


@pytest.mark.slow
def test_mass_matrices_of_both_engines_agree_with_other_motors() -> None:
    """Reference: MuJoCo's mass matrix; Pinocchio's follows from the URDF."""
    robot = with_motors(load("v3"), dict.fromkeys(load("v3").joint_names, OTHER), PRESENT)
    from pupper_analysis.tools.crosscheck.crosscheck import cross_check

    assert cross_check(robot).passed


def test_motor_at_a_frame_without_mass_belongs_to_the_body_that_carries_the_frame(
    tmp_path: Path,
) -> None:
    """Reference: a point mass of -0.1 kg at the axis of the joint, added to MuJoCo's CoM.

    A published A1 has this form: the base of both files has no mass, and the trunk is fixed to the
    base.
    """
    pair = quadruped(tmp_path)
    mount = (
        '<link name="mount"/><joint name="weld" type="fixed"><parent link="trunk"/>'
        '<child link="mount"/><origin xyz="0.2 0 0" rpy="0 0 0.5"/></joint>'
    )
    inertial = re.search(r"<inertial[^>]*/>", pair.mjcf.read_text())[0]  # type: ignore[index]
    shell = f'<body name="shell" pos="0.1 0 0" euler="0 0 0.5">{inertial}</body>'
    text = pair.mjcf.read_text().replace('type="box"', 'type="box" mass="0"')
    pair.mjcf.write_text(text.replace(inertial, shell, 1))
    text = pair.urdf.read_text()
    trunk = re.search(r'<link name="trunk">.*?</link>', text, re.DOTALL)[0]  # type: ignore[index]
    moved = (
        f'<link name="trunk"/>{trunk.replace("trunk", "shell")}'
        '<joint name="shell_weld" type="fixed"><parent link="trunk"/><child link="shell"/>'
        f'<origin xyz="0.1 0 0" rpy="0 0 0.5"/></joint>{mount}'
    )
    pair.urdf.write_text(text.replace(trunk, moved, 1))
    robot = pa.load_robot(pair.urdf, pair.mjcf)
    light = replace(OTHER, mass=0.04, kp=None, kd=None)
    found = with_motors(robot, {"FL_roll": light}, PRESENT)
    assert found.total_mass == pytest.approx(robot.total_mass - 0.1, rel=1e-9)
    assert found.mj_model.body_mass.sum() == pytest.approx(found.total_mass, rel=1e-9)
    data, after = robot.compute_kinematics(), found.compute_kinematics()
    base = robot.mj_model.body(robot.mj_base).id
    anchor = data.xanchor[robot.mj_model.joint("FL_roll").id]
    expected = (robot.total_mass * data.subtree_com[base] - 0.1 * anchor) / found.total_mass
    np.testing.assert_allclose(after.subtree_com[base], expected, atol=1e-9)
    config = Configuration(found, found.neutral())
    np.testing.assert_allclose(config.center_of_mass(), expected, atol=1e-9)


def test_motors_that_no_robot_can_have_are_refused() -> None:
    robot = load("v3")
    light = Motor("light", "bench", mass=1e-3, peak_torque=1.0)
    heavy = Motor("heavy", "bench", mass=3.0, peak_torque=1.0)
    with pytest.raises(
        ConfigurationError, match="check that present_motor is the motor in the files"
    ):
        with_motors(robot, {"leg_front_r_2": light}, heavy)
    with pytest.raises(ModelError, match="peak_torque"):
        with_motors(robot, {"leg_front_r_1": Motor("bare", "bench", mass=0.1)}, PRESENT)


STUDY: dict[str, Any] = {"robot": "v3", "measure": ["motor_mass"], "present_motor": PRESENT}


@pytest.mark.parametrize(
    ("changes", "error", "words"),
    [
        ({"vary": {"motor": [1.0]}}, ConfigurationError, "not a list of names or files"),
        ({"vary": {"motor": ["dephy-actpak"]}}, UnknownNameError, "dephy-actpack"),
        ({"vary": {"motor:*_9": ["dephy-actpack"]}}, UnknownNameError, "leg_front_r_1"),
        (
            {"vary": {"motor:*_3": ["t-motor-ak80-6"], "motor:leg_back*": ["lk-tech-mg4005-10"]}},
            ConfigurationError,
            r"motor:leg_back\*'\]: 'motor:\*_3' already selects a motor for leg_back_r_3",
        ),
        ({"require": {"motor_mass": "< 1e999"}}, ConfigurationError, "< 1e999' is not true"),
        ({"require": {"motor_mass": float("nan")}}, ConfigurationError, "nan is not true"),
        ({"vary": {"kp": [5.0]}}, ConfigurationError, "no motor is varied"),
        ({"present_motor": None}, ConfigurationError, "present_motor = "),
        ({"present_motor": "dynamixel-mx-64"}, ModelError, "needed: mass"),
        ({"require": {"motor_mass": "light"}}, ConfigurationError, "is not true, false, a number"),
        ({"require": {"stands": True}}, ConfigurationError, "stands"),
        ({"minimise": "stands"}, ConfigurationError, "stands"),
        ({"minimise": "motor"}, ConfigurationError, "motor"),
    ],
)
def test_bad_studies_of_motors_are_refused(
    changes: dict[str, Any], error: type[Exception], words: str
) -> None:
    options = {**STUDY, "vary": {"motor": ["dephy-actpack"]}, **changes}
    with pytest.raises(error, match=words):
        Study(options.pop("robot"), options.pop("vary"), options.pop("measure"), **options)


def test_motor_as_a_typed_objective_is_refused_before_the_run() -> None:
    options = {**STUDY, "vary": {"motor": ["dephy-actpack"]}}
    study = Study(options.pop("robot"), options.pop("vary"), options.pop("measure"), **options)
    with pytest.raises(ConfigurationError, match="motor"):
        check_objectives(study, (), ("motor",))


def test_unknown_values_meet_no_requirement() -> None:
    """Reference: comparison by hand. NaN meets neither an upper nor a lower bound."""
    table = pd.DataFrame({"heat": [0.5, 1.0, np.nan, np.inf], "stands": [1.0, 0.0, 1.0, np.nan]})
    cases = {
        "< 1": [True, False, False, False],
        "<= 1": [True, True, False, False],
        ">0.5": [False, True, False, True],
        ">= 5e-1": [True, True, False, True],
    }
    for text, expected in cases.items():
        assert Requirement.parse("heat", text).is_met(table).tolist() == expected
    assert Requirement.parse("stands", True).is_met(table).tolist() == [True, False, True, False]
    assert Requirement.parse("other", "< 1").is_met(table).tolist() == [False] * 4


def test_question_about_the_lightest_motors_is_a_short_file() -> None:
    """Reference: the file; 4 lengths, 4 motors and 3 stiffnesses."""
    path = ROOT / "examples/motors.toml"
    assert len(path.read_text().splitlines()) <= 15
    study = Study.read(path)
    assert len(study) == 4 * 4 * 3
    assert len(study.motors) == 4
    assert [item.text for item in study.requirements][-1] == "time_until_hot > 600"


def test_code_of_a_motor_follows_its_name_and_numbers() -> None:
    """A motor with another source and equal numbers has the same code."""
    assert encode_motor(replace(OTHER, source="data sheet")) == encode_motor(OTHER)
    assert encode_motor(replace(OTHER, kp=9.0)) != encode_motor(OTHER)
    assert encode_motor(PRESENT) != encode_motor(OTHER)
    assert encode_motor(OTHER) == int(encode_motor(OTHER)) < 2**53


FILE = """robot = "v3"
present_motor = "steadywin-gim4305-10"
measure = ["motor_mass", "continuous_utilisation", "time_until_hot", "stands", "set_down"]
minimise = "motor_mass"
require = { stands = true, set_down = true, continuous_utilisation = "< 1" }

[vary]
motor = ["weak.toml", "lk-tech-mg4005-10", "t-motor-ak80-6"]
kp = [10.0]
payload = [1.0]
"""

WEAK = """name = "weak"
source = "bench"
output_torque_constant = "0.5 N m/A"
resistance = "1 ohm"
peak_torque = "3 N m"
continuous_torque = "0.5 N m"
mass = "100 g"
"""


def test_listed_files_are_in_the_folder_of_the_study(tmp_path: Path) -> None:
    """Files of ``models`` and of motors in ``values`` are found from another working folder."""
    pair = slips.standing(tmp_path)
    (tmp_path / "weak.toml").write_text(WEAK)
    (tmp_path / "study.toml").write_text(
        f'present_motor = "weak.toml"\nmeasure = ["total_mass"]\n'
        f'robot = {{ models = ["{pair.urdf.name}", "{pair.mjcf.name}"] }}\n'
        f'[vary]\n"motor:FL_knee" = {{ values = ["weak.toml"] }}\n'
    )
    study = Study.read(tmp_path / "study.toml")
    assert [motor.name for motor in study.motors.values()] == ["weak"]
    assert "FL_knee" in study.base.joint_names


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> tuple[Study, Path]:
    folder = tmp_path_factory.mktemp("motors")
    (folder / "weak.toml").write_text(WEAK)
    (folder / "study.toml").write_text(FILE)
    study = Study.read(folder / "study.toml")
    with ThreadPoolExecutor(1) as executor:  # a thread needs no start of a process
        study.execute(folder / "results", executor=executor)
    return study, folder / "results"


@pytest.mark.slow
def test_lightest_motor_that_meets_the_requirements_is_the_best(
    measured: tuple[Study, Path],
) -> None:
    """References: masses of 12 motors; the continuous torque of the data sheets."""
    study, folder = measured
    outcome = study_outcome(study, folder)
    assert outcome.table["motor"].str.endswith("weak.toml").tolist() == [True, False, False]
    assert outcome.table["motor_mass"].tolist() == pytest.approx([1.2, 12 * 0.154, 12 * 0.485])
    assert outcome.front["motor"].tolist() == ["lk-tech-mg4005-10"]
    assert outcome.feasible == 2
    assert outcome.requirements["continuous_utilisation < 1"] == 2
    used = outcome.table["continuous_utilisation"]
    assert used[0] > 1
    assert np.isnan(outcome.table["time_until_hot"][0])  # beyond the data sheet: time unknown
    assert (outcome.table["time_until_hot"][1:] == np.inf).all()
    document = study_document(outcome)
    assert "2 of 3 designs meet all requirements" in document.findings[0].en
    assert "∞" in printed(document)
    assert "best: design 2, motor lk-tech-mg4005-10" in document.findings[0].en
    pd.testing.assert_frame_equal(read_study(folder), study.table(folder))
    pd.testing.assert_frame_equal(outcome.table, study.table(folder))
    assert outcome.table["stands"].dtype == outcome.front["stands"].dtype == bool


@pytest.mark.slow
def test_designs_agree_with_bare_mujoco(measured: tuple[Study, Path]) -> None:
    """Reference: MuJoCo alone, from the written files and the numbers of the motors.

    The payload is added by MjSpec. The robot is set down from 2 mm: the height of the base changes
    by less than a tenth. The torques of the statics, as feed-forward of the servos, hold the joint
    positions to 1e-3 rad; the largest torque is that of the study.
    """
    study, folder = measured
    table = study.table(folder)
    continuous = {"weak": 0.5, "lk-tech-mg4005-10": 1.0, "t-motor-ak80-6": 6.0}
    masses = {"weak": 0.1, "lk-tech-mg4005-10": 0.154, "t-motor-ak80-6": 0.485}
    for number in (1, 2, 3):
        written = write_design(study, number, folder)
        assert written.passed, written.failures
        assert "--payload 1.0kg" in written.command
        row = table.iloc[number - 1]
        name = Path(row["motor"]).stem
        spec = mujoco.MjSpec.from_file(str(written.mjcf))
        bare = load("v3").total_mass + 12 * (masses[name] - 0.14)
        assert spec.copy().compile().body_mass.sum() == pytest.approx(bare, rel=1e-9)
        base = next(body for body in spec.bodies if list(body.joints))
        weight = base.add_body(name="weight")
        weight.mass, weight.inertia, weight.explicitinertial = 1.0, [1e-9] * 3, True
        model = spec.compile()
        design = study_design(study, number, folder)
        stand = design.simulated_stand
        statics = stand_statics(design.robot, stand)
        order = design.robot.mj_convention.actuator_index
        sagged = simulate(model, design, stand.qpos[7:], drop=0.002)
        assert sagged.qpos[2] > 0.9 * stand.qpos[2]
        held = simulate(model, design, stand.qpos[7:] + statics.joint_torques / 10.0)
        joints = held.qpos[design.robot.mj_convention.qpos_index[7:]]
        np.testing.assert_allclose(joints, stand.qpos[7:], atol=1e-3)
        used = float(np.abs(held.actuator_force[order]).max()) / continuous[name]
        assert used == pytest.approx(row["continuous_utilisation"], rel=0.01)
        assert row["stands"] == row["set_down"] == 1.0


@pytest.mark.slow
def test_design_that_stands_only_undisturbed_is_marked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Reference: the simulated drop, here from a height from which the robot collapses."""
    study = Study("v3", {"kp": [2.5], "payload": [0.0]}, ["stands", "set_down"])
    with ThreadPoolExecutor(1) as executor:
        study.execute(tmp_path, executor=executor)
    assert study.table(tmp_path)["set_down"].tolist() == [1.0]
    assert not write_design(study, 1, tmp_path).warnings
    monkeypatch.setattr(measures, "SET_DOWN_HEIGHT", 1.0)
    (warning,) = write_design(study, 1, tmp_path).warnings
    assert warning.code == "stands-only-undisturbed"


def simulate(
    model: mujoco.MjModel, design: Any, command: np.ndarray, drop: float = 0.0
) -> mujoco.MjData:
    data = mujoco.MjData(model)
    data.qpos[design.robot.mj_convention.qpos_index] = design.simulated_stand.qpos
    data.qpos[2] += drop
    data.ctrl[design.robot.mj_convention.actuator_index] = command
    while data.time < 3.0:
        mujoco.mj_step(model, data)
    return data


def study_design(study: Study, number: int, folder: Path) -> Any:
    from pupper_analysis.tools.study.design import DesignBuilder

    row = study.table(folder).iloc[number - 1]
    codes = {name: variable.code_of(row[name]) for name, variable in study.variables.items()}
    builder = DesignBuilder(
        study.source, study.task, study.point, study.motors, study.present_motor
    )
    return builder.design(codes)


@pytest.mark.slow
def test_study_whose_designs_all_fail_states_the_reason_instead_of_a_front(tmp_path: Path) -> None:
    """No robot can have the motor. Reference: no row has a value of the objective."""
    light = Motor("light", "bench", mass=1e-3, peak_torque=1.0)
    (tmp_path / "light.toml").write_text(
        'name = "light"\nsource = "bench"\nmass = "1 g"\npeak_torque = "1 N m"\n'
    )
    heavy = replace(light, name="heavy", mass=3.0)
    study = Study(
        "v3",
        {"motor": [str(tmp_path / "light.toml")]},
        ["motor_mass"],
        present_motor=heavy,
        minimise="motor_mass",
    )
    with ThreadPoolExecutor(1) as executor:
        study.execute(tmp_path / "results", executor=executor)
    outcome = study_outcome(study, tmp_path / "results")
    assert outcome.objectives == {"motor_mass": "min"}
    assert outcome.front.empty
    assert "check that present_motor is the motor in the files" in str(outcome.table["reason"][0])
    assert "NONE" in study_document(outcome).verdict.en  # type: ignore[union-attr]


CATALOGUE = {
    "present": {"peak_torque": "3 N m", "continuous_torque": "1 N m", "mass": "140 g"},
    "stiff": {
        **{"peak_torque": "4 N m", "continuous_torque": "1 N m", "mass": "200 g"},
        **{"rotor_inertia": "2e-5 kg m^2", "no_load_speed": "20 rad/s"},
        **{"kp": "14 N m/rad", "kd": "0.2 N m s/rad"},
    },
    "warm": {
        **{"peak_torque": "5 N m", "mass": "110 g", "no_load_speed": "35 rad/s"},
        **{"rotor_inertia": "1e-5 kg m^2", "resistance_temperature": "25 degC"},
        **{"resistance_rise": "0.00393 1/K", "winding_resistance": "20 K/W"},
        **{"winding_capacity": "40 J/K", "ambient_temperature": "25 degC"},
        "limit_temperature": "60 degC",
    },
}
"""{motor: numbers}. Each motor has 0.5 N m/A at the output, a gear of 10 and 1 ohm."""

CATALOGUE_STUDY = """robot = "v3"
present_motor = "present.toml"
measure = ["continuous_utilisation", "time_until_hot", "stands"]
[vary]
leg_scale = [1.2]
motor = ["present.toml", "stiff.toml", "warm.toml"]
payload = [1.0]
"""


@pytest.fixture(scope="module")
def catalogue(tmp_path_factory: pytest.TempPathFactory) -> tuple[Study, Path]:
    folder = tmp_path_factory.mktemp("catalogue")
    for name, numbers in CATALOGUE.items():
        texts = {"name": name, "source": "bench", "output_torque_constant": "0.5 N m/A"}
        texts |= {"resistance": "1 ohm", **numbers}
        lines = [f'{key} = "{text}"' for key, text in texts.items()]
        (folder / f"{name}.toml").write_text("\n".join([*lines, "gear_ratio = 10"]))
    (folder / "study.toml").write_text(CATALOGUE_STUDY)
    study = Study.read(folder / "study.toml")
    with ThreadPoolExecutor(1) as executor:
        study.execute(folder / "results", executor=executor)
    return study, folder / "results"


@pytest.mark.slow
def test_written_files_alone_contain_the_numbers_of_the_motors(
    catalogue: tuple[Study, Path],
) -> None:
    """References: the motor files; bare MuJoCo and Pinocchio, from the written files alone.

    The files contain no payload: the masses differ by 12 motors only. Rotor inertia x gear^2 is the
    armature. A motor without rotor inertia, speed or gains keeps the numbers of the robot.
    """
    study, folder = catalogue
    own = load("v3")
    masses = {}
    for number, (name, numbers) in enumerate(CATALOGUE.items(), start=1):
        written = write_design(study, number, folder)
        model = mujoco.MjModel.from_xml_path(str(written.mjcf))
        pin_model = pin.buildModelFromUrdf(str(written.urdf), pin.JointModelFreeFlyer())
        masses[name] = float(model.body_mass.sum())
        assert pin.computeTotalMass(pin_model) == pytest.approx(masses[name], rel=1e-9)
        effort = float(numbers["peak_torque"].split()[0])
        speed = float(numbers["no_load_speed"].split()[0]) if "no_load_speed" in numbers else None
        inertia = float(numbers["rotor_inertia"].split()[0]) if "rotor_inertia" in numbers else None
        for index, joint in enumerate(own.joint_names):
            actuator = next(
                number for number in range(model.nu)
                if model.actuator_trnid[number, 0] == model.joint(joint).id
            )  # fmt: skip
            before = own.mj_convention.actuator_index[index]
            old = own.mj_model.actuator_gainprm[before, 0], own.mj_model.actuator_biasprm[before, 2]
            kp, bias = (14.0, -0.2) if name == "stiff" else old
            assert model.actuator_gainprm[actuator, 0] == pytest.approx(kp)
            assert model.actuator_biasprm[actuator, 1:3] == pytest.approx([-kp, bias])
            np.testing.assert_allclose(model.actuator_forcerange[actuator], [-effort, effort])
            assert model.actuator_forcelimited[actuator]
            armature = own.mj_model.joint(joint).dofadr[0]
            armature = own.mj_model.dof_armature[armature] if inertia is None else 100 * inertia
            assert model.dof_armature[model.joint(joint).dofadr[0]] == pytest.approx(armature)
            column = pin_model.joints[pin_model.getJointId(joint)].idx_v
            assert pin_model.effortLimit[column] == pytest.approx(effort)
            kept = own.pin_model.velocityLimit[own.pin_convention.v_index[index]]
            assert pin_model.velocityLimit[column] == pytest.approx(speed or kept)
    assert masses["stiff"] - masses["present"] == pytest.approx(12 * 0.060, rel=1e-6)
    assert masses["warm"] - masses["present"] == pytest.approx(-12 * 0.030, rel=1e-6)


@pytest.mark.slow
def test_three_designs_and_their_minutes_agree_with_bare_mujoco(
    catalogue: tuple[Study, Path],
) -> None:
    """References: bare MuJoCo from the written files with 1 kg; the closed form of one node.

    The robot stands for 3 s. The largest torque of MuJoCo at rest, divided by 0.5 N m/A, is the
    current i. The winding reaches the limit after C / s ln(dT_inf / (dT_inf - dT_limit)) with
    s = 1 / R_th - i^2 R alpha and dT_inf = i^2 R / s (ambient temperature = that of R).
    """
    study, folder = catalogue
    table = study.table(folder)
    hottest = []
    for number, name in enumerate(CATALOGUE, start=1):
        written = write_design(study, number, folder)
        assert written.passed
        row, design = table.iloc[number - 1], study_design(study, number, folder)
        assert written.file_values["time_until_hot"] == pytest.approx(row["time_until_hot"])
        spec = mujoco.MjSpec.from_file(str(written.mjcf))
        base = next(body for body in spec.bodies if list(body.joints))
        weight = base.add_body(name="weight", pos=np.asarray(design.point[-3:], dtype=float))
        weight.mass, weight.inertia, weight.explicitinertial = 1.0, [1e-9] * 3, True
        stand = design.simulated_stand
        torques = stand_statics(design.robot, stand).joint_torques
        kp = 14.0 if name == "stiff" else float(design.robot.mj_model.actuator_gainprm[0, 0])
        held = simulate(spec.compile(), design, stand.qpos[7:] + torques / kp)
        joints = held.qpos[design.robot.mj_convention.qpos_index[7:]]
        np.testing.assert_allclose(joints, stand.qpos[7:], atol=1e-3)
        largest = float(np.abs(held.actuator_force).max())
        hottest.append(largest)
        if name == "warm":
            loss = (largest / 0.5) ** 2
            slope = 1 / 20 - loss * 0.00393
            final = loss / slope
            time = 40 / slope * math.log(final / (final - 35))
            assert row["time_until_hot"] == pytest.approx(time, rel=0.02)
            permanent = 0.5 * math.sqrt(35 / 20 / (1 + 0.00393 * 35))
            assert row["continuous_utilisation"] == pytest.approx(largest / permanent, rel=0.01)
        else:
            assert row["time_until_hot"] == math.inf
            assert row["continuous_utilisation"] == pytest.approx(largest / 1.0, rel=0.01)
        assert row["stands"] == 1.0
    assert hottest[1] > hottest[0] > hottest[2]  # the heavier the motors, the larger the torque


@pytest.mark.slow
def test_payload_is_added_once_to_the_written_files(
    catalogue: tuple[Study, Path], capfd: pytest.CaptureFixture[str]
) -> None:
    """The printed command adds 1 kg to the written files. Reference: the row of the study.

    If the files contained the payload, the torque would be that of 2 kg.
    """
    study, folder = catalogue
    written = write_design(study, 3, folder)
    program, command, *options = shlex.split(written.command)
    assert (program, command) == ("pupper-analysis", "stand")
    motor = str(folder.parent / "warm.toml")
    _, out, _ = run_command(capfd, "heat", *options, "--motor", motor, "--json", "-")
    found = json.loads(out)
    hottest = max(abs(motor["torque"]) for motor in found["motors"])
    permanent = 0.5 * math.sqrt(35 / 20 / (1 + 0.00393 * 35))
    used = study.table(folder)["continuous_utilisation"][2]
    assert hottest / permanent == pytest.approx(used, rel=1e-6)
    times = [motor["time_to_limit"] for motor in found["motors"] if motor["time_to_limit"]]
    assert min(times) == pytest.approx(study.table(folder)["time_until_hot"][2], rel=1e-6)
    assert run_command(capfd, command, *options)[0] == 0
