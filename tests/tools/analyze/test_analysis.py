"""Analyses of robots: joint motions, leg lengths and failures that the analysis adds to the results
of other modules.
"""

from __future__ import annotations

import copy
import json
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.robot.joints import leg_joints
from pupper_analysis.tools.analyze import analysis as analysis_module
from pupper_analysis.tools.analyze.analysis import (
    compute_leg_jacobians,
    measure_leg_lengths,
    summarise_joints,
)
from tests.support.commands import answer
from tests.support.legged import biped
from tests.support.robots import Frame, Part, mjcf_text, urdf_text, write
from tests.support.tiny import TINY_MJCF, TINY_URDF
from tests.support.variants import load


@pytest.mark.slow
@pytest.mark.usefixtures("shared_rollouts")
@pytest.mark.parametrize("name", pa.VARIANTS)
def test_every_variant_is_as_predicted_and_verified_if_its_file_stands(name: str) -> None:
    """References: MuJoCo's residual, and simulation of the stand. In bare MuJoCo the file of
    v3-long-leg sinks onto its shanks, tilted by 16 deg.
    """
    analysis = pa.analyze_variant(pa.load_variant(name))
    assert analysis.verified is (name != "v3-long-leg"), analysis.failures
    assert analysis.stand.foot_error < 1e-9
    assert analysis.verification.mujoco_residual < 1e-9
    assert analysis.verification.joint_error < 1e-3
    assert analysis.verification.torque_error < 0.01
    assert analysis.verification.force_error < 0.01
    assert analysis.verification.height_deviation < 5e-5
    assert analysis.check.passed
    json.loads(analysis.to_json())


def test_joint_motions_follow_from_their_axes() -> None:
    """The names of the tutorial mean roll, pitch, pitch; the axes of v3 are pitch, roll, pitch."""
    v3 = summarise_joints(pa.load_variant("v3"))
    assert [joint.motion for joint in v3] == ["pitch", "roll", "pitch"] * 4
    for joint in v3:
        side = 1.0 if "_l_" in joint.name else -1.0
        expected = [-1, 0, 0] if joint.motion == "roll" else [0, side, 0]
        np.testing.assert_allclose(joint.axis, expected, atol=1e-9)
    skeleton = summarise_joints(pa.load_variant("original"))
    assert [joint.motion for joint in skeleton] == ["roll", "pitch", "pitch"] * 4


@pytest.mark.slow
def test_motion_of_a_prismatic_joint_is_a_direction_or_oblique(
    tiny: pa.Robot, tmp_path: Path
) -> None:
    """Axes of the files: (0, 0, 1) is "along z", (0, 1, 1) is "oblique slide"."""
    found = {joint.name: joint.motion for joint in summarise_joints(tiny)}
    assert found["push"] == "along z"
    assert found["turn"] == found["bend"] == "oblique"  # the arm is tilted by 0.3 rad
    slide = '<origin xyz="-0.1 0 0"/><axis xyz="0 0 1"/>'
    assert slide in TINY_URDF
    (tmp_path / "tiny.urdf").write_text(TINY_URDF.replace(slide, slide.replace("0 0 1", "0 1 1")))
    (tmp_path / "tiny.xml").write_text(
        TINY_MJCF.replace('type="slide" axis="0 0 1"', 'type="slide" axis="0 1 1"')
    )
    oblique = pa.load_robot(urdf=tmp_path / "tiny.urdf", mjcf=tmp_path / "tiny.xml", feet=["foot"])
    found = {joint.name: joint.motion for joint in summarise_joints(oblique)}
    assert found["push"] == "oblique slide"


def test_leg_jacobian_of_a_planar_leg() -> None:
    """Closed form of a straight leg: a pitch joint moves the foot along -x by its distance
    to the foot, the roll joint along y by the leg length, and no joint along z.
    """
    robot = pa.load_variant("original")
    jacobians = compute_leg_jacobians(pa.Configuration(robot, robot.neutral()))
    expected = np.array([[0, -0.19, -0.11], [0.19, 0, 0], [0, 0, 0]])
    np.testing.assert_allclose(jacobians["FL"].matrix, expected, atol=1e-15)
    assert jacobians["FL"].condition > 1e12
    bent = pa.Configuration(robot, np.concatenate([robot.neutral()[:7], [0, 0.9, -1.5] * 4]))
    for jacobian in compute_leg_jacobians(bent).values():
        assert jacobian.condition == pytest.approx(np.linalg.cond(jacobian.matrix))


def test_foot_that_no_joint_moves_has_a_jacobian_without_columns(tmp_path: Path) -> None:
    """The foot of the tiny robot, moved from the hand to the base."""
    toe = '<origin xyz="0 0 -0.1"/>\n    <parent link="hand"/><child link="foot"/>'
    shape, site = (
        f'<{word} pos="0 0 -0.1"/>'
        for word in ('geom type="sphere" size="0.02"', 'site name="foot"')
    )
    assert toe in TINY_URDF
    urdf = TINY_URDF.replace(toe, toe.replace("hand", "base"))
    mjcf = TINY_MJCF.replace(shape, "").replace(site, "")
    mjcf = mjcf.replace("<freejoint/>", f"<freejoint/>{shape}{site}")
    files = write(tmp_path, urdf, mjcf)
    robot = pa.load_robot(urdf=files.urdf, mjcf=files.mjcf, feet=["foot"])
    jacobian = compute_leg_jacobians(pa.Configuration(robot, robot.neutral()))["foot"]
    assert jacobian.joints == ()
    assert jacobian.matrix.shape == (3, 0)
    assert jacobian.condition == np.inf


@pytest.mark.slow
def test_failed_verification_and_failed_cross_check_are_reported() -> None:
    """Motors of 0.2 N m where knees hold 0.36 N m, and a body of 10 g more in the MJCF."""
    robot = pa.load_variant("original")
    weak = copy.copy(robot.mj_model)
    weak.actuator_forcerange[:] = (-0.2, 0.2)  # the knees hold 0.36 N m
    analysis = pa.analyze_variant(replace(robot, mj_model=weak))
    assert not analysis.verified
    assert not analysis.verification.passed
    assert any("fell over" in str(failure) for failure in analysis.failures)
    assert any("effort limits" in str(failure) for failure in analysis.failures)

    heavy = copy.copy(robot.mj_model)
    heavy.body_mass[1] += 0.01
    analysis = pa.analyze_variant(replace(robot, mj_model=heavy))
    assert not analysis.verified
    assert any("body masses" in str(failure) for failure in analysis.failures)


LEGS = {"FR": (0.1, -0.08), "FL": (0.1, 0.08), "RR": (-0.1, -0.08), "RL": (-0.1, 0.08)}


def telescope(folder: Path) -> pa.Robot:
    """Return a box on four legs of one joint each, which slides."""
    heavy = {"inertia": (1e-3, 1e-3, 1e-3, 0.0, 0.0, 0.0), "damping": 0.0, "friction": 0.0}
    parts = {"base": Part("base", mass=2.0, **heavy)}
    for leg, (x, y) in LEGS.items():
        parts[leg] = Part(
            f"{leg}_leg", "base", f"{leg}_slide", "prismatic", (x, y, 0.0), axis=(0.0, 0.0, 1.0),
            mass=0.1, lower=-0.05, upper=0.05, effort=40.0, armature=0.0, **heavy,
        )  # fmt: skip
    frames = [Frame(f"{leg}_foot", f"{leg}_leg", (0.0, 0.0, -0.15)) for leg in LEGS]
    floor = '<geom type="plane" size="1 1 1"/>'
    text = mjcf_text(parts, frames, base_position=(0.0, 0.0, 0.17), scene=floor)
    text = text.replace("<site", '<geom type="sphere" size="0.02" pos="0 0 -0.15"/><site')
    text = text.replace("<motor", '<position kp="2000" kv="40"').replace("ctrlrange", "forcerange")
    files = write(folder, urdf_text(parts, frames), text)
    return pa.load_robot(*files, feet={leg: f"{leg}_foot" for leg in LEGS})


@pytest.mark.slow
def test_leg_of_one_slide_has_no_lengths(tmp_path: Path) -> None:
    """Closed form of the slide force: weight / 4 less the leg's own 0.1 kg times g [N]."""
    robot = telescope(tmp_path)
    assert measure_leg_lengths(robot) == (None, None)
    analysis = pa.analyze_variant(robot, pa.StandTask(height=0.16))
    assert analysis.verified, analysis.failures
    assert analysis.thigh_length is None
    weight = analysis.total_mass * 9.81
    np.testing.assert_allclose(analysis.statics.joint_torques, -(weight / 4 - 0.981), rtol=1e-6)


V3_LEG = (np.hypot(0.0494, 0.0685), np.hypot(0.06231, 0.06216))


@pytest.mark.parametrize(
    ("name", "lengths"),
    [
        ("original", (0.08, 0.11)),
        ("long-leg", (0.12, 0.165)),
        ("v3", V3_LEG),
        ("v3-long-leg", (1.5 * V3_LEG[0], 1.5 * V3_LEG[1])),
    ],
)
def test_leg_lengths_are_those_of_the_file(name: str, lengths: tuple[float, float]) -> None:
    """Thigh and calf [m]; reference: joint positions, read in the files."""
    assert measure_leg_lengths(load(name)) == pytest.approx(lengths, rel=1e-12)


def test_leg_with_ankles_has_no_lengths(tmp_path: Path) -> None:
    """The last joint of this biped is an ankle, 50 mm above the ground."""
    pair = biped(tmp_path)
    assert measure_leg_lengths(pa.load_robot(urdf=pair.urdf, mjcf=pair.mjcf)) == (None, None)


def test_joints_of_a_leg_are_those_between_base_and_foot() -> None:
    robot = load("v3")
    assert leg_joints(robot, "RL") == ("leg_back_l_1", "leg_back_l_2", "leg_back_l_3")
    with pytest.raises(pa.UnknownNameError, match="FR, FL, RR, RL"):
        leg_joints(robot, "XX")


def test_analysis_of_an_unreachable_stance_is_refused() -> None:
    with pytest.raises(pa.StanceUnreachableError):
        pa.analyze_variant(load("v3"), pa.StandTask(height=0.4))


@pytest.mark.slow
@pytest.mark.usefixtures("shared_rollouts")
def test_analysis_judges_the_stand_on_rigid_ground(monkeypatch: pytest.MonkeyPatch) -> None:
    """As `stand` does: the nominal stand is then compared with the file only once."""
    judged, real = [], analysis_module.judge_simulation

    def judge(*args: Any, **options: Any) -> Any:
        judged.append(args[1])
        return real(*args, **options)

    monkeypatch.setattr(analysis_module, "judge_simulation", judge)
    analysis = pa.analyze_variant(load("v3"))
    assert max(analysis.stand.depths.values()) > 1e-3
    assert max(judged[0].depths.values()) == 0
    assert judged[0].task == analysis.stand.task


@pytest.mark.slow
@pytest.mark.usefixtures("shared_rollouts")
def test_gain_sweep_is_computed_only_if_it_is_printed_written_or_drawn(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Half of the time is that of the sweep. The short output does not depend on it."""
    short = answer("analyze", "v3", "--no-figures", "--json", "all.json", folder=tmp_path)
    sweep = json.loads((tmp_path / "all.json").read_text())["variants"]["v3"]["sweep"]
    assert np.shape(sweep["height_deviation"]) == (5, 5)
    monkeypatch.setattr(analysis_module, "sweep_gains", Mock(side_effect=AssertionError))
    alone = answer("analyze", "v3", "--no-figures", folder=tmp_path)
    assert alone.stdout == short.stdout.replace("written: all.json\n", "")
    for more in (("-v",), ("--format", "markdown"), ("--report", "page.html")):
        found = answer("analyze", "v3", "--no-figures", *more, folder=tmp_path)
        assert found.returncode == 3, more  # the sweep ends it
