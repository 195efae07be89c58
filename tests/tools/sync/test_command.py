"""The command ``sync``: exit status, printed text, and refusals."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import pytest

import pupper_analysis as pa
from pupper_analysis.robot.compare.differences import UNWRITTEN_KINDS
from pupper_analysis.tools.sync.plan import _UNWRITTEN_REASONS
from tests.support.commands import Answer, answer
from tests.support.repository import ROOT
from tests.support.robots import change_part, quadruped, write_parts
from tests.support.variants import load

ROBOT = quadruped()
DIFFERENT = change_part(change_part(ROBOT, "base", mass=7.5), "thigh1", effort=25.0, armature=0.5)


def run(folder: Path, *arguments: str) -> Answer:
    return answer("sync", "robot.urdf", "robot.xml", *arguments, folder=folder)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_parts(tmp_path, ROBOT, change_part(DIFFERENT, "thigh1", armature=0.01))
    return tmp_path


def test_without_a_choice_the_differences_are_listed(folder: Path) -> None:
    before = (folder / "robot.xml").read_bytes()
    result = run(folder)
    assert result.returncode == 1
    assert result.stderr == ""
    assert "1. link base: mass 6 kg in the URDF, 7.5 kg in the MJCF (+25 %)" in result.stdout
    assert "   robot.urdf:5   robot.xml:7" in result.stdout
    assert "2. joint hip1: effort 21 N m in the URDF, 25 N m in the MJCF" in result.stdout
    assert "No file was changed. --take urdf writes the values of the URDF" in result.stdout
    assert '--take urdf:"link base: mass"' in result.stdout
    assert (folder / "robot.xml").read_bytes() == before


def test_sync_prints_the_written_values(folder: Path) -> None:
    result = run(folder, "--take", "urdf:1", "--take", "mjcf:effort")
    assert result.returncode == 0
    assert "body base > inertial: mass: 7.5 -> 6" in result.stdout
    assert "joint hip1 > limit: effort: 21.0 -> 25" in result.stdout


def test_all_values_of_one_file_are_written_and_reported(folder: Path) -> None:
    """Mass 6 kg and effort 21 N m of the URDF; afterwards both files agree."""
    output = folder / "all.json"
    result = run(folder, "--take", "urdf", "--backup", "--json", str(output))
    assert (result.returncode, result.stderr) == (0, "")
    lines = result.stdout.splitlines()
    assert lines[0] == "AGREE robot.urdf and robot.xml: attributes written: 2"
    assert "robot.xml:7: body base > inertial: mass: 7.5 -> 6" in lines
    assert any(line.endswith("motor m_hip1: ctrlrange: -25.0 25.0 -> -21 21") for line in lines)
    assert any(line.startswith("the old file is kept as ") for line in lines)
    assert lines[-1] == f"written: {output}"
    content = json.loads(output.read_text())
    assert content["edits"][0] == {
        "file": "robot.xml",
        "line": 7,
        "element": "body base > inertial",
        "attribute": "mass",
        "old": "7.5",
        "new": "6",
    }
    assert content["agree"] is True
    again = run(folder)
    assert again.returncode == 0
    assert "no difference within the tolerances" in again.stdout


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--take", "urdf:tail"], "no difference 'tail'"),
        (["--map", "a"], "'a' is not of the form URDF=MJCF"),
        (["--tolerance", "mass=0"], "mass=0.0 is not positive"),
        (["--package", "a=/nowhere"], "/nowhere is not a folder"),
        (["--json", "robot.urdf/a.json"], "robot.urdf is not a folder"),
    ],
)
def test_invalid_input_gives_exit_status_2_and_changes_no_file(
    folder: Path, arguments: list[str], said: str
) -> None:
    before = (folder / "robot.xml").read_bytes()
    result = run(folder, *arguments)
    assert (result.returncode, result.stdout) == (2, "")
    assert said in result.stderr
    assert (folder / "robot.xml").read_bytes() == before


def test_dry_run_prints_a_diff(folder: Path) -> None:
    before = (folder / "robot.urdf").read_bytes()
    result = run(folder, "--take", "mjcf:mass", "--dry-run")
    assert result.returncode == 1
    assert '-<mass value="6.0"/>\n+<mass value="7.5"/>' in result.stdout
    assert "\n--- a/robot.urdf\n+++ b/robot.urdf\n@@ " in result.stdout
    assert (
        "\nNot written\njoint hip1: effort: no file was chosen for this difference" in result.stdout
    )
    message = "DISAGREE robot.urdf and robot.xml: attributes that would be written: 1"
    left = "  differences left: 1 (joint hip1: effort); nothing written (--dry-run)"
    assert result.stdout.splitlines()[:2] == [message, left]
    assert (folder / "robot.urdf").read_bytes() == before
    # The files do not agree yet if all differences are chosen in a trial.
    everything = run(folder, "--take", "mjcf", "--dry-run").stdout.splitlines()
    assert everything[0].startswith("WOULD AGREE robot.urdf and robot.xml: attributes that would")
    assert everything[1] == "  nothing written (--dry-run)"
    assert everything[2].startswith("  next: pupper-analysis sync ")
    assert (folder / "robot.urdf").read_bytes() == before


def test_difference_within_the_tolerance_is_written_with_a_smaller_tolerance(
    tmp_path: Path,
) -> None:
    """6 and 6.00001 kg: a relative difference of 1.7e-6."""
    files = write_parts(tmp_path, ROBOT, change_part(ROBOT, "base", mass=6.00001))
    before = files.mjcf.read_bytes()
    assert run(tmp_path, "--take", "urdf").returncode == 0
    assert files.mjcf.read_bytes() == before
    fine = ("--tolerance", "mass=1e-7", "--tolerance", "dynamics=1e-7")
    assert run(tmp_path, *fine).returncode == 1
    assert run(tmp_path, *fine, "--take", "urdf").returncode == 0
    assert 'mass="6"' in files.mjcf.read_text()


def test_robot_in_memory_is_refused_because_files_are_written_in_place() -> None:
    text = (ROOT / "mjcf" / "pupper_v3.xml").read_text()
    with pytest.raises(pa.ConfigurationError, match="mjcf: this robot in memory"):
        pa.sync_models(ROOT / "urdf" / "pupper_v3.urdf", text)
    with pytest.raises(pa.ConfigurationError, match="urdf: ") as error:
        pa.sync_models(load("v3").pin_model, ROOT / "mjcf" / "pupper_v3.xml")  # type: ignore[arg-type]
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("efforts", "side"), [((21.0, 25.0), "urdf"), ((0.0, 25.0), "mjcf"), ((None, 25.0), "mjcf")]
)
def test_proposed_side_states_the_value(
    tmp_path: Path, efforts: tuple[float | None, float], side: str
) -> None:
    """A value that the URDF lacks, or an exporter's zero, is not proposed for the MJCF."""
    urdf, mjcf = (change_part(ROBOT, "thigh1", effort=effort or 0.0) for effort in efforts)
    write_parts(tmp_path, urdf, mjcf)
    file = tmp_path / "robot.urdf"
    if efforts[0] is None:
        file.write_text(file.read_text().replace('effort="0.0"', 'effort="1e9"'))
    assert f"next: pupper-analysis sync robot.urdf robot.xml --take {side} " in run(tmp_path).stdout


@pytest.mark.parametrize(
    ("pattern", "placeholder"),
    [
        (r'(<mass value=")1.506(")', "1000"),
        (r'(effort=")3(")', "1000"),
        (r'(effort=")3(")', "1e9"),
        (r'(<mass value=")0\.\d+(")', "1"),
        (r'(effort=")3(")', "4"),
    ],
)
def test_next_command_does_not_take_a_placeholder(
    tmp_path: Path, pattern: str, placeholder: str
) -> None:
    """The other file has the values of the real robot; 4 N m may be a correction."""
    shutil.copytree(ROOT / "urdf", tmp_path / "urdf")
    shutil.copytree(ROOT / "mjcf", tmp_path / "mjcf")
    urdf, mjcf = tmp_path / "urdf/pupper_v3.urdf", tmp_path / "mjcf/pupper_v3.xml"
    text, count = re.subn(pattern, rf"\g<1>{placeholder}\g<2>", urdf.read_text())
    assert count
    urdf.write_text(text)
    done = answer("sync", str(urdf), str(mjcf), folder=tmp_path)
    side = "urdf" if placeholder == "4" else "mjcf"
    assert f"--take {side} --dry-run" in done.stdout


def test_next_command_takes_the_file_that_leaves_fewer_differences(tmp_path: Path) -> None:
    """The URDF states no effort of hip1, so that its values cannot replace those of the MJCF."""
    files = write_parts(tmp_path, ROBOT, change_part(ROBOT, "base", mass=7.5))
    text = files.urdf.read_text()
    start = text.index("<limit", text.index('<joint name="hip1"'))
    end = text.index("/>", start)
    limit = re.sub(r' effort="[^"]*"', "", text[start:end])
    files.urdf.write_text(text[:start] + limit + text[end:])
    lines = run(tmp_path).stdout.splitlines()
    assert lines[1].startswith("  --take mjcf removes 2, urdf 1 of 2")
    trial = "sync robot.urdf robot.xml --take mjcf --dry-run"
    assert lines[2] == f"  next: pupper-analysis {trial}"
    assert answer(*trial.split(), folder=tmp_path).returncode == 0


def test_next_command_repairs_the_urdf_if_its_limits_are_exchanged(tmp_path: Path) -> None:
    """The MJCF has no range, and cannot state a lower limit above the upper limit.

    After the printed command, the range of the URDF can be written to the MJCF.
    """
    files = write_parts(tmp_path, ROBOT, ROBOT)
    old = files.urdf.read_text()
    start = old.index("<limit", old.index('<joint name="hip1"'))
    limit = old[start : old.index("/>", start)]
    exchanged = limit.replace("lower", "low").replace("upper", "lower").replace("low=", "upper=")
    files.urdf.write_text(old.replace(limit, exchanged, 1))
    hip = re.search(r'<joint[^>]* name="hip1"[^>]*>', files.mjcf.read_text())
    assert hip is not None
    unlimited = re.sub(r' range="[^"]*"', "", hip[0])
    files.mjcf.write_text(files.mjcf.read_text().replace(hip[0], unlimited))
    following = "  next: pupper-analysis audit robot.urdf --fix"
    for words in ((), ("--take", "urdf", "--dry-run")):
        assert run(tmp_path, *words).stdout.splitlines()[2] == following
    result = answer("crosscheck", "robot.urdf", "robot.xml", folder=tmp_path)
    assert result.stdout.splitlines()[2] == following
    answer("audit", "robot.urdf", "--fix", "--yes", folder=tmp_path)
    assert run(tmp_path, "--take", "urdf").returncode == 0
    agreed = run(tmp_path)
    assert agreed.returncode == 0
    assert agreed.stdout.splitlines()[2] == "  next: pupper-analysis stand robot.urdf robot.xml"


def test_crosscheck_and_sync_agree_on_the_kinds_that_are_not_written() -> None:
    """Otherwise crosscheck proposes sync for differences that sync does not write."""
    assert set(UNWRITTEN_KINDS) == set(_UNWRITTEN_REASONS)
