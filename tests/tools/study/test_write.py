"""Designs written as files have the values that the study measured."""

from __future__ import annotations

import json
import math
import shlex
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
import pytest

import pupper_analysis as pa
from pupper_analysis.cli import shared
from pupper_analysis.cli.stance_fields import OPTION_FIELDS, make_task, read_stance_file
from pupper_analysis.stance.stance_file import format_stance
from pupper_analysis.tools.study.design import DesignBuilder
from pupper_analysis.tools.study.write import (
    WrittenDesign,
    _list_changed_metrics,
    write_design,
)
from tests.support.commands import answer
from tests.support.legged import quadruped

METRICS = ["total_mass", "peak_utilisation", "torque", "servo_sag", "stands"]


def write_studied_design(
    robot: Any, vary: dict[str, Any], folder: Path, number: int = 1, **options: Any
) -> WrittenDesign:
    study = pa.Study(robot, vary, METRICS, **options)
    study.run(folder, workers=1)
    return write_design(study, number, folder)


def read_values(stance: Path) -> dict[str, Any]:
    """Read {field: value of the option} from a stance file."""
    values = read_stance_file(stance)
    for name, value in values.items():
        if not (OPTION_FIELDS[name].per or OPTION_FIELDS[name].axes or OPTION_FIELDS[name].choices):
            values[name] = shared.parse_measure(name, OPTION_FIELDS[name].kind, value, value)
    return values


@pytest.fixture(scope="module")
def heavy(tmp_path_factory: pytest.TempPathFactory) -> WrittenDesign:
    """Write a v3 with longer legs, heavier hips and stiffer servos: the second of two designs."""
    vary = {"leg_scale": [1.2], "mass:*_1": [1.1], "kp": [5.0, 10.0]}
    return write_studied_design("v3", vary, tmp_path_factory.mktemp("study"), 2)


@pytest.mark.parametrize(
    ("measured", "found", "agrees"),
    [
        (1.0, 1.0 + 1e-7, True),
        (1.0, 1.001, False),
        (math.inf, math.inf, True),
        (math.inf, 300.0, False),
        (300.0, math.inf, False),
        (math.inf, -math.inf, False),
        (1.0, math.nan, False),
    ],
)
def test_changed_metrics_of_a_written_design_are_found(
    measured: float, found: float, agrees: bool
) -> None:
    """An infinite time agrees with an infinite time only. Reference: comparison by hand."""
    changes = list(_list_changed_metrics(1, {"time": measured}, {"time": found}))
    assert [change.code for change in changes] == ([] if agrees else ["written-design-differs"])


@pytest.mark.slow
def test_written_design_has_the_measured_values(heavy: WrittenDesign) -> None:
    assert heavy.passed
    assert heavy.numbers == {"leg_scale": 1.2, "mass:*_1": 1.1, "kp": 10.0}
    assert len(heavy.study_values) == 4 + 12
    for name, value in heavy.study_values.items():
        assert heavy.file_values[name] == pytest.approx(value, rel=1e-6, abs=1e-9)
    assert heavy.study_values["servo_sag"] > 1e-3  # not all are zeros that agree


@pytest.mark.slow
def test_bare_engines_read_the_design(heavy: WrittenDesign) -> None:
    """Masses and gains, by the importers that MuJoCo and Pinocchio bring along."""
    base = pa.load_variant("v3")
    urdf = pin.buildModelFromUrdf(str(heavy.urdf), pin.JointModelFreeFlyer())
    model = mujoco.MjModel.from_xml_path(str(heavy.mjcf))
    for leg in ("front_r", "front_l", "back_r", "back_l"):
        hip, knee = f"leg_{leg}_1", f"leg_{leg}_3"
        old, new = (model.inertias[model.getJointId(hip)].mass for model in (base.pin_model, urdf))
        assert new == pytest.approx(1.1 * old, rel=1e-9)
        old, new = (model.inertias[model.getJointId(knee)].mass for model in (base.pin_model, urdf))
        assert new == pytest.approx(1.2 * old, rel=1e-9)
    assert model.body_mass.sum() == pytest.approx(
        sum(inertia.mass for inertia in urdf.inertias), rel=1e-9
    )
    assert model.actuator_gainprm[:, 0] == pytest.approx(10.0)
    assert model.actuator_biasprm[:, 1] == pytest.approx(-10.0)


@pytest.mark.slow
def test_written_design_leaves_the_payload_to_the_command(tmp_path: Path) -> None:
    """Reference: total mass [kg] of MuJoCo's model without payload; the metrics of the study are
    measured with the payload, and the stance file has the tilt.
    """
    pair = quadruped(tmp_path)
    files = {"urdf": str(pair.urdf), "mjcf": str(pair.mjcf)}
    found = write_studied_design(
        files, {"payload": [0.5], "pitch": [0.1], "kp": [80.0], "kd": [2.0]}, tmp_path / "out"
    )
    assert found.passed, found.failures
    before = mujoco.MjModel.from_xml_path(files["mjcf"]).body_mass.sum()
    after = mujoco.MjModel.from_xml_path(str(found.mjcf)).body_mass.sum()
    assert after == pytest.approx(before, rel=1e-9)
    assert found.file_values["total_mass"] == pytest.approx(before + 0.5, rel=1e-9)
    words = found.command.split()
    assert words[words.index("--payload") + 1] == "0.5kg"
    assert 'pitch = "0.1rad"' in found.stance.read_text()


@pytest.mark.slow
def test_existing_design_files_are_not_replaced(heavy: WrittenDesign) -> None:
    folder = heavy.urdf.parent.parent
    study = pa.Study("v3", {"leg_scale": [1.2], "mass:*_1": [1.1], "kp": [5.0, 10.0]}, METRICS)
    write_design(study, 2, folder)  # the same: nothing is to be written
    text = heavy.urdf.read_text()
    try:
        heavy.urdf.write_text(text + "<!-- mine -->")
        with pytest.raises(pa.OutputError):
            write_design(study, 2, folder)
        assert heavy.urdf.read_text().endswith("mine -->")
    finally:
        heavy.urdf.write_text(text)
    with pytest.raises(pa.ConfigurationError, match="no design 3: the study has 2"):
        write_design(study, 3, folder)


@pytest.mark.slow
def test_files_of_another_robot_are_reported(
    heavy: WrittenDesign, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The written files are loaded with 1 g more: the metrics differ, which is reported."""
    from pupper_analysis.tools.study import write

    study = pa.Study("v3", {"leg_scale": [1.2], "mass:*_1": [1.1], "kp": [5.0, 10.0]}, METRICS)
    loaded = write.load_robot

    def heavier(*files: Any, **options: Any) -> pa.Robot:
        return pa.robot.with_payload(loaded(*files, **options), 1e-3)

    monkeypatch.setattr(write, "load_robot", heavier)
    found = write_design(study, 2, heavy.urdf.parent.parent)
    assert not found.passed
    assert {failure.values["metric"] for failure in found.failures} >= {
        "total_mass",
        "peak_utilisation",
    }


def test_metric_that_fails_for_the_written_files_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The written files are loaded with 20 kg more, with which the servos hold no stand."""
    from pupper_analysis.tools.study import write

    loaded = write.load_robot
    monkeypatch.setattr(
        write,
        "load_robot",
        lambda *files, **options: pa.robot.with_payload(loaded(*files, **options), 20.0),
    )
    found = write_studied_design("v3", {"kp": [5.0, 10.0]}, tmp_path)
    assert found.study_values["stands"] == 1.0
    assert found.file_values["stands"] == 0.0
    assert math.isnan(found.file_values["servo_sag"])
    differing = {failure.values["metric"] for failure in found.failures}
    assert differing >= {"servo_sag", "stands"}


def test_a_stance_as_a_file_is_the_stance(tmp_path: Path) -> None:
    """Typed again it is the same task, to the last bit."""
    task = pa.StandTask(
        height=0.1234567890123, roll=0.05, com="inside", com_margin=0.011,
        foot_offsets={"FL": (0.01, -0.02)}, swing={"FR": 0.03}, ground=pa.Ground(slope=0.1),
    )  # fmt: skip
    (tmp_path / "stance.toml").write_text(format_stance(task))
    assert make_task(read_values(tmp_path / "stance.toml")) == task


@pytest.mark.slow
def test_written_stance_keeps_the_place_of_a_foot(tmp_path: Path) -> None:
    """Reference: the required position (x, y) [m] of the foot, at which the printed command must
    put its sphere; ``feet`` has no option, so that the file contains an offset.
    """
    place = (0.09, -0.07)
    found = write_studied_design(
        "v3", {"kp": [10.0]}, tmp_path, stand=pa.StandTask(feet={"FR": place})
    )
    assert found.passed
    words = shlex.split(found.command)[1:]
    targets = json.loads(answer(*words, "--json", "-").stdout)["stand"]["foot_targets"]
    np.testing.assert_allclose(targets["FR"][:2], place, atol=1e-12)
    assert targets["FL"][0] < 0.08  # the other feet keep their places


def test_stance_without_option_is_refused() -> None:
    with pytest.raises(pa.ConfigurationError, match="'feet', for which no option exists"):
        format_stance(pa.StandTask(feet={"FR": (0.09, -0.07)}))


@pytest.mark.slow
def test_study_command_writes_a_design(tmp_path: Path) -> None:
    (tmp_path / "s.toml").write_text(
        'robot = "v3"\nmeasure = ["total_mass"]\n[vary]\nkp = { values = [5, 10] }\n'
    )
    done = answer("study", str(tmp_path / "s.toml"), "-o", str(tmp_path / "o"), "--write", "2")
    assert done.returncode == 0, done.stderr
    assert "Design 2" in done.stdout
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "o/design-2/v3-leg1-torso1.xml"))
    assert model.actuator_gainprm[:, 0] == pytest.approx(10)


@pytest.mark.slow
def test_command_of_a_written_design_holds_the_torques_of_the_design(heavy: WrittenDesign) -> None:
    """Reference: joint torques [N m] of the design in memory, on soft ground; the printed command
    is run.
    """
    words = shlex.split(heavy.command)[1:]
    found = json.loads(answer(*words, "--json", "-").stdout)
    study = pa.Study("v3", {"leg_scale": [1.2], "mass:*_1": [1.1], "kp": [5.0, 10.0]}, METRICS)
    design = DesignBuilder(study.source, study.task, study.point).design(heavy.numbers)
    torques = pa.stance.stand_statics(design.robot, design.simulated_stand).joint_torques
    held = found["statics"]["joint_torques"]
    np.testing.assert_allclose(held, torques, rtol=1e-9, atol=1e-9)
