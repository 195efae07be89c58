"""The command ``stand``: printed text, written files, exit status, and refusals."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from pupper_analysis import StandTask, Weld, load_variant, solve_stand
from pupper_analysis.models.mjcf_file import read_mjcf
from pupper_analysis.models.urdf_file import read_urdf
from pupper_analysis.prepare.passes import PREPARATION_PASSES, LoadRequest, prepare_robot
from pupper_analysis.present.document import MAX_ANSWER_WIDTH
from pupper_analysis.pupper import VariantSpec
from pupper_analysis.stance import minimum_stiffness
from pupper_analysis.tools.stand.stance import explain_loading, study_stance
from tests.support import arm
from tests.support.commands import check_refusal, run_command
from tests.support.legged import quadruped, quadruped_with_slides
from tests.support.printing import printed
from tests.support.repository import ROOT


@pytest.mark.slow
def test_the_table_of_joints_is_a_file_and_a_dataframe(
    capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """Reference: the stance itself; torques with sign, utilisation relative to each motor's
    limit."""
    path = tmp_path / "joints.csv"
    status, out, err = run_command(capfd, "stand", "v3", "--height", "12cm", "--csv", str(path))
    assert status == 0, err
    assert out.endswith(f"written: {path}\n")
    robot = load_variant("v3")
    stance = study_stance(robot, StandTask(height=0.12))
    table = stance.to_dataframe()
    rows = [line.split(",") for line in path.read_text().splitlines()]
    assert rows[0] == [
        *("joint", "position (rad)", "torque (N m)", "limit (N m)", "utilisation"),
        "simulated_torque (N m)",
    ]
    assert [row[0] for row in rows[1:]] == list(robot.joint_names) == list(table["joint"])
    numbers = np.array([row[1:] for row in rows[1:]], dtype=float)
    np.testing.assert_array_equal(numbers, table.drop(columns="joint").to_numpy())
    np.testing.assert_array_equal(numbers[:, 0], stance.stand.qpos[7:])
    np.testing.assert_allclose(numbers[:, 3], np.abs(numbers[:, 1]) / numbers[:, 2], rtol=1e-12)
    np.testing.assert_allclose(numbers[:, 4], numbers[:, 1], atol=1e-6)
    sunk, rigid = (
        stance.stand.to_dataframe(),
        solve_stand(robot, StandTask(height=0.12)).to_dataframe(),
    )
    np.testing.assert_allclose(sunk["z"] + sunk["depth"], rigid["z"], rtol=1e-12)
    y = dict(zip(sunk["foot"], sunk["y"].to_numpy(), strict=True))
    assert y["FL"] > 0 > y["FR"]
    path.write_text("mine\n")
    status, _, err = run_command(capfd, "stand", "v3", "--csv", str(path))
    assert (status, path.read_text()) == (2, "mine\n"), err


@pytest.mark.slow
def test_positions_of_slides_are_in_millimetres_and_in_the_file_in_metres(
    capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """Reference: the knees, which are slides, in the configuration of the JSON result."""
    robot = quadruped_with_slides(tmp_path)
    table, result = tmp_path / "joints.csv", tmp_path / "result.json"
    options = ("--csv", str(table), "--json", str(result), "-v")
    for _ in range(2):  # the second run recognises the table, and replaces it
        _, out, err = run_command(capfd, "stand", str(robot), *options)
        assert not err
    assert table.read_text().startswith("joint,position (rad or m),torque (N m or N),")
    knee = json.loads(result.read_text())["stand"]["qpos"][9]
    assert abs(knee) > 1e-3
    (row,) = [line.split() for line in out.splitlines() if line.startswith("FL_knee ")]
    assert float(row[-1]) == pytest.approx(1e3 * knee, abs=0.01)
    assert "For slides (FL_knee, FR_knee, RL_knee, RR_knee), read mm" in out


@pytest.mark.slow
def test_options_of_gains_margins_and_scales_are_applied(
    capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """References: requested gains, clearances and scales; `minimum_stiffness` of the same stand."""
    path = tmp_path / "all.json"
    status, out, err = run_command(
        capfd,
        *("stand", "-v", "--leg-scale", "1.1", "--torso-mass-scale", "1.2", "--minimum-stiffness"),
        *("--kp", "80", "--kd", "1.5", "--self-clearance", "0.002", "--ground-clearance", "0.005"),
        *("--offset", "0.01,0", "--json", str(path)),
    )
    assert status == 0, err
    content = json.loads(path.read_text())
    assert content["name"] == "skeleton-leg1.1-torso1.2"
    assert content["verification"]["kp"] == [80.0] * 12
    assert content["verification"]["kd"] == [1.5] * 12
    assert content["stand"]["self_clearance"]["distance"] > 0.002 - 1e-6
    assert content["stand"]["ground_clearance"]["distance"] > 0.005 - 1e-6
    assert content["stand"]["task"]["offset"] == [0.01, 0.0]
    robot = load_variant(VariantSpec(leg_scale=1.1, torso_mass_scale=1.2))
    least = minimum_stiffness(robot, solve_stand(robot, StandTask(offset=(0.01, 0.0))))
    assert content["minimum_stiffness"] == pytest.approx(least, rel=1e-2)
    stated = f"without gravity compensation: {content['minimum_stiffness']:.2f} N m/rad"
    assert f"minimum stiffness {stated}" in out


@pytest.mark.slow
def test_soft_servos_lead_to_gains_with_which_the_robot_stands(
    capfd: pytest.CaptureFixture[str],
) -> None:
    """Reference: a new run with the proposed gains.

    `--minimum-stiffness` was proposed; its answer did not contain the minimum stiffness.
    """
    _, soft, _ = run_command(capfd, "stand", "v3", "--kp", "2")
    (proposed,) = re.findall(r"next: pupper-analysis (.*)", soft)
    assert shlex.split(proposed)[:3] == ["stand", "v3", "--kp"]
    status, out, _ = run_command(capfd, *shlex.split(proposed))
    assert (status, out.split()[0]) == (0, "HOLDS")
    assert out.splitlines()[0].startswith("HOLDS v3: ")

    _, requested, _ = run_command(capfd, "stand", "v3", "--kp", "2", "--minimum-stiffness")
    second, third = requested.splitlines()[1:3]
    robot = load_variant("v3")
    least = minimum_stiffness(robot, solve_stand(robot, StandTask()))
    (printed_kp,) = re.findall(r"^  minimum stiffness .*: ([\d.]+) N m/rad \(statics\)", second)
    assert float(printed_kp) == pytest.approx(least, rel=0.02)
    assert "gains v3 --kp 2" in third


@pytest.mark.slow
def test_minimum_stiffness_is_found_if_the_given_one_is_too_low() -> None:
    robot = load_variant("v3-long-leg")
    result = study_stance(robot, StandTask(), kp=4.0, kd=0.1, stiffness=True)
    assert result.settled is None
    assert result.minimum_stiffness is not None
    assert 4.0 < result.minimum_stiffness < 6.0


@pytest.mark.slow
def test_missing_minimum_stiffness_is_reported_with_its_reason() -> None:
    """With a welded base no stiffness is the least one; the option was ignored."""
    result = study_stance(load_variant("v3"), StandTask(contacts={"base": Weld()}), stiffness=True)
    assert (result.minimum_stiffness, result.passed) == (None, True)
    assert "does not stand without feed-forward with any kp" in printed(result)


@pytest.mark.slow
def test_overloaded_motors_are_reported() -> None:
    """Reached and in balance, but held by no motor of 3 N m."""
    robot = load_variant(VariantSpec(base="v3", torso_mass_scale=12.0))
    result = study_stance(robot, StandTask())
    assert not result.passed
    assert set(result.overloaded_motors) == {
        name for name in robot.joint_names if name.endswith("_3")
    }
    assert "OVERLOADED" in printed(result)
    assert not study_stance(load_variant("v3"), StandTask()).overloaded_motors


BAD = {
    "name and files": (["v3", "--urdf", "a.urdf"], "the robot is specified more than once"),
    "base and files": (["--base", "v3", "--urdf", "a.urdf"], "or --urdf and --mjcf"),
    "no scale": (["--leg-scale", "0"], "greater than 0"),
    "a map alone": (["--map", "a=b"], "--map applies only to files, not to a variant"),
    "no damping": (["v3", "--kp", "-3"], "kp"),
    "too near": (["v3", "--self-clearance", "0.05"], "Possible with all else unchanged: self_"),
    "too high": (["v3", "--height", "0.3"], "height 191.9 mm"),
    "too steep": (["v3", "--slope", "0.9"], "ground slope 34.8 deg"),
    "below the ground": (["v3", "--height", "-0.1"], "not above the ground"),
    "no such foot": (["v3", "--swing", "XX=0.02"], "no foot 'XX'; there are: FR, FL, RR, RL"),
    "two lifted": (["v3", "--swing", "FL=0.02", "--swing", "FR=0.02"], "only 2 feet carry"),
    "no number": (["v3", "--step", "FL=high"], "'high' in 'FL=high' is not a valid length"),
    "no place": (
        ["v3", "--com", "insde"],
        "'insde' is not of the form X,Y (10mm,0), centre, inside",
    ),
    "slides": (["v3", "--slope", "0.8", "--pitch", "-0.8"], "balance needs 1.030"),
    "a bar out of reach": (
        ["v3", "--contact", "FL=bar:40cm,0,2cm,0,1,0,1cm"],
        "Possible with all else unchanged: contacts FL=bar:",
    ),
    "figure in a folder": (["v3", "--figure", "."], "the path is a folder"),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", BAD)
def test_invalid_input_is_refused_in_one_line(
    case: str, capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    arguments, message = BAD[case]
    output = [] if "--json" in arguments else ["--json", "all.json"]
    check_refusal(capfd, tmp_path, ["stand", *arguments, *output], message)


@pytest.mark.slow
def test_explanation_equals_the_loaded_robot(tmp_path: Path) -> None:
    pair = quadruped(tmp_path)
    files = read_urdf(pair.urdf), read_mjcf(pair.mjcf)
    explained, robot = explain_loading(*files, LoadRequest())
    assert explained.feet == tuple(robot.feet)
    assert explained.mass == pytest.approx(float(robot.mj_model.body_mass.sum()))
    _, runs = prepare_robot(*files, LoadRequest())
    assert [run_pass.name for run_pass in explained.passes] == [run.name for run in runs]


@pytest.mark.slow
def test_explain_prints_the_passes_in_their_order(
    capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """Reference: ``PREPARATION_PASSES``."""
    pair, path = quadruped(tmp_path), tmp_path / "passes.json"
    words = ("stand", *map(str, pair), "--explain", "--json", str(path))
    status, out, err = run_command(capfd, *words)
    assert status == 0, err
    passes = json.loads(path.read_text())["passes"]
    names = [run_pass["name"] for run_pass in passes]
    assert names == [
        preparation_pass.name
        for preparation_pass in PREPARATION_PASSES
        if preparation_pass.name in names
    ]
    printed_names = [run_pass["name"] for run_pass in passes if run_pass["done"]]
    assert "add-servos" in printed_names
    places = [out.index(f"\n{name} ") for name in printed_names]
    assert places == sorted(places)


@pytest.mark.slow
def test_explain_of_a_variant_names_the_next_command_and_hides_idle_passes(
    capfd: pytest.CaptureFixture[str],
) -> None:
    """Reference: mass and feet of v3, and the passes with changes in `explain_loading`."""
    status, out, err = run_command(capfd, "stand", "v3", "--explain")
    assert status == 0, err
    verdict, changes, step, *_ = out.splitlines()
    assert verdict.startswith("READY pupper_v3: 3.170 kg, free base, 12 joints, feet leg_front_r_3")
    assert " passes changed or completed the files" in changes
    assert step == "  next: pupper-analysis stand v3"
    assert "nothing to do" not in out


_BASE = (
    '<link name="base"><inertial><mass value="2"/>'
    '<inertia ixx=".01" iyy=".01" izz=".01" ixy="0" ixz="0" iyz="0"/></inertial></link>'
)
"""Base of an arm with a mass [kg] and inertia [kg m^2]."""


@pytest.mark.slow
def test_a_limit_of_zero_is_stated_and_a_bolted_base_has_no_height(
    capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """Reference: the URDF of an arm, in which one shoulder has ``effort="0"``.

    The limit was printed as unknown, and the height of the base as 0.
    """
    for name, effort in (("stated", ""), ("zero", "0")):
        text = arm.URDF.replace('<link name="base"/>', _BASE)
        assert _BASE in text
        if effort:
            text = re.sub(r'effort="[^"]*"', f'effort="{effort}"', text)
        (tmp_path / f"{name}.urdf").write_text(text)
    weld = ("--contact", "base=weld")
    status, out, err = run_command(capfd, "stand", str(tmp_path / "zero.urdf"), *weld, "-v")
    assert status == 1, err
    assert "the files state a limit of 0" in out
    assert "limit unknown" not in out
    status, out, err = run_command(capfd, "stand", str(tmp_path / "stated.urdf"), *weld)
    assert status == 0, err
    assert "height" not in out
    _, out, _ = run_command(capfd, "stand", str(tmp_path / "stated.urdf"), *weld, "-v")
    assert "base bolted to the world" in out


@pytest.mark.slow
def test_base_of_a_robot_on_a_welded_foot_is_not_reported_as_bolted(
    capfd: pytest.CaptureFixture[str],
) -> None:
    """Reference: the task, which welds one foot, lifts the others, and leaves the base free."""
    lifted = [word for foot in ("FR", "RL", "RR") for word in ("--swing", f"{foot}=1cm")]
    _, out, err = run_command(
        capfd, "stand", "v3", "--contact", "FL=weld", *lifted, "--com", "inside", "-v"
    )
    # Line 2 is what fails without gravity compensation; height and gains follow.
    assert out.splitlines()[1].startswith("  FAILS without gravity compensation: "), err
    assert "kp 5" in out
    assert "bolted" not in out
    assert "height" in out


@pytest.mark.slow
def test_the_second_line_states_the_gains_with_their_bounds(
    capfd: pytest.CaptureFixture[str],
) -> None:
    """Reference: least kp 2.44 (bare MuJoCo: 2.25 to 2.38), largest kd 2.6 (2.7 to 3.0)."""
    status, out, err = run_command(capfd, "stand", "v3")
    assert status == 0, err
    assert "kp 5 N m/rad (min 2.44), kd 0.1 N m s/rad (max 2.6); sinks" in out.splitlines()[1]
    assert max(map(len, out.splitlines())) <= MAX_ANSWER_WIDTH


@pytest.mark.slow
@pytest.mark.parametrize(
    "words", [("stand", "v3", "--payload", "6.67kg"), ("hold", "v3", "--payload", "4.5kg")]
)
def test_first_line_with_a_long_verdict_names_the_joint(
    capfd: pytest.CaptureFixture[str], words: tuple[str, ...]
) -> None:
    """The line ended "= 50.1 % of the limit ...", without the joint that bears the load."""
    status, out, err = run_command(capfd, *words)
    assert status == 0, err
    first = out.splitlines()[0]
    assert re.search(r" = [\d.]+ % \(leg_(front|back)_[lr]_[123]\)$", first)
    assert len(first) <= MAX_ANSWER_WIDTH


@pytest.mark.slow
def test_failure_under_a_payload_leads_to_the_largest_payload(
    capfd: pytest.CaptureFixture[str],
) -> None:
    """40 kg on 3.17 kg: `best margin` with the same mass was proposed, and was refused."""
    ended, out, _ = run_command(capfd, "stand", "v3", "--payload", "40kg", "--payload-at=0,0,1cm")
    assert (ended, out.startswith("FAILS v3 + 40 kg at ")) == (1, True)
    words = shlex.split(out.splitlines()[2].partition("next: ")[2])
    assert words[1:] == ["payload", "v3", "--payload-at", "0,0,1cm"]


@pytest.mark.slow
def test_servos_below_the_least_stiffness_get_one_that_stands(
    capfd: pytest.CaptureFixture[str],
) -> None:
    """Reference: the command with the stated kp stands without gravity compensation."""
    ended, out, _ = run_command(capfd, "stand", "v3", "--kp", "2.3")
    assert (ended, out.startswith("HOLDS only with gravity compensation v3: ")) == (0, True)
    stated = "kp 2.3 N m/rad too low without gravity compensation: stands with "
    assert stated in out.splitlines()[1]
    number = out.splitlines()[1].partition(stated)[2].partition(";")[0]
    ended, out, _ = run_command(capfd, "stand", "v3", "--kp", number)
    assert (ended, out.startswith("HOLDS v3: ")) == (0, True)


@pytest.mark.slow
def test_next_command_of_soft_servos_keeps_the_typed_gains(
    capfd: pytest.CaptureFixture[str],
) -> None:
    """The gains of some joints are doubled, the others keep the typed kp; the command stands."""
    ended, out, _ = run_command(capfd, "stand", "v3", "--kp", "1")
    assert (ended, out.startswith("FAILS v3: ")) == (1, True)
    assert "leg_*_1 too soft (kp 1 N m/rad): stands with 2 times these gains" in out.splitlines()[1]
    words = shlex.split(out.splitlines()[2].partition("next: ")[2])
    assert words[1:] == [
        *("stand", "v3", "--kp", "1", "--kp", "leg_*_1=2", "--kd", "leg_*_1=0.2"),
    ]
    ended, out, _ = run_command(capfd, *words[1:])
    assert (ended, "HOLDS" in out.splitlines()[0]) == (0, True)


def test_overridden_contacts_are_the_second_line_of_a_failure(
    capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """With a contact time constant of 0.5 s from the flag, the robot sinks into the ground."""
    options = '<option o_solref="0.5 1"><flag override="enable"/></option>'
    text = (ROOT / "mjcf/pupper_skeleton.xml").read_text()
    mjcf = tmp_path / "soft.xml"
    mjcf.write_text(text.replace("<worldbody>", f"{options}<worldbody>"))
    status, out, _ = run_command(capfd, "stand", str(mjcf))
    first, second, *_ = out.splitlines()
    assert (status, first.split()[0]) == (1, "FAILS")
    assert second.strip() == "contact parameters are overridden by flag override"
