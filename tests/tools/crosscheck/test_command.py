"""The command ``crosscheck``: exit status, options, output for machines, and refusals."""

from __future__ import annotations

import contextlib
import json
from pathlib import Path
from xml.etree import ElementTree

import pytest

from tests.support.commands import Answer, answer, run_command
from tests.support.robots import change_part, mjcf_text, quadruped, write_parts


def run(folder: Path, *arguments: str) -> Answer:
    return answer("crosscheck", *arguments, folder=folder)


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a folder with a URDF, an equal MJCF, an MJCF with a heavier base, and a text that is no
    model.
    """
    folder = tmp_path_factory.mktemp("models")
    robot = quadruped()
    write_parts(folder, robot, robot)
    heavier = mjcf_text(change_part(robot, "base", mass=7.5))
    (folder / "heavier.xml").write_text(heavier)
    (folder / "folder").mkdir()
    (folder / "text.urdf").write_text("a robot\n")
    return folder


def test_guessed_name_is_an_error_with_strict(models: Path, tmp_path: Path) -> None:
    """A guessed pair of names is a note, an error with --strict, and neither with --map."""
    text = (models / "robot.urdf").read_text().replace('"knee2"', '"lh_kfe"')
    (tmp_path / "robot.urdf").write_text(text)
    pair = ("robot.urdf", str(models / "robot.xml"))
    loose = run(tmp_path, *pair)
    assert loose.returncode == 0
    assert "by part of the name (confirm with --map): lh_kfe=knee2" in loose.stdout
    strict = run(tmp_path, *pair, "--strict")
    assert strict.returncode == 1
    assert ": joint knee2: named lh_kfe in the URDF, knee2 in the" in strict.stdout
    assert run(tmp_path, *pair, "--strict", "--map", "lh_kfe=knee2").returncode == 0


def test_equal_models_agree_with_exit_status_0(models: Path) -> None:
    result = run(models, "robot.urdf", "robot.xml")
    assert (result.returncode, result.stderr) == (0, "")
    assert result.stdout.startswith("AGREE robot.urdf and robot.xml: ")


def test_different_models_have_exit_status_1_and_the_first_difference(
    models: Path, tmp_path: Path
) -> None:
    output = tmp_path / "all.json"
    result = run(models, "robot.urdf", "heavier.xml", "--json", str(output))
    assert (result.returncode, result.stderr) == (1, "")
    verdict = "DISAGREE robot.urdf and heavier.xml: base: mass 6 kg / 7.5 kg (+25 %)"
    assert result.stdout.startswith(verdict)
    content = json.loads(output.read_text())
    assert (content["agree"], content["complete"]) == (False, True)
    assert [difference["kind"] for difference in content["differences"]] == ["mass"]


def test_tolerance_options_permit_a_difference_and_strict_finds_it(models: Path) -> None:
    """The base has 6 and 7.5 kg."""
    pair = ("robot.urdf", "heavier.xml")
    assert run(models, *pair, "--tolerance", "mass=0.5").returncode == 0
    assert run(models, *pair, "--strict").returncode == 1
    options = ("--strict", "--tolerance", "mass=0.5", "--tolerance", "damping=0.9")
    assert run(models, *pair, *options).returncode == 0
    assert run(models, *pair, "--tolerance", "mass=0.1").returncode == 1


def test_findings_are_annotations_of_github(models: Path) -> None:
    """The line of the mass in the URDF; a pair that agrees has no annotation."""
    result = run(models, "robot.urdf", "heavier.xml", "--format", "github")
    assert result.returncode == 1
    (command, *_) = result.stdout.splitlines()
    assert command.startswith("::error file=robot.urdf,line=5,title=mass of base::link base")
    assert "(+25 %25)" in command
    equal = run(models, "robot.urdf", "robot.xml", "--format", "github")
    assert (equal.returncode, equal.stdout.strip()) == (0, "")


def test_findings_are_failed_cases_of_junit(models: Path) -> None:
    """References: the counts of the suite, and the element with the other mass."""
    result = run(models, "robot.urdf", "heavier.xml", "--format", "junit")
    assert result.returncode == 1
    root = ElementTree.fromstring(result.stdout.encode())
    failures = list(root.iter("failure"))
    assert int(root.get("tests", "0")) == len(list(root.iter("testcase")))
    assert int(root.get("failures", "0")) == len(failures) >= 1
    assert any("6 kg in the URDF, 7.5 kg" in (failure.get("message") or "") for failure in failures)


BAD: dict[str, tuple[list[str], str]] = {
    "missing URDF": (["nobody.urdf", "robot.xml"], "nobody.urdf: there is no such file"),
    "a folder": (["folder", "robot.xml"], "folder: the path is a folder"),
    "no XML": (["text.urdf", "robot.xml"], "text.urdf:1: not well-formed XML"),
    "two URDFs": (["robot.urdf", "robot.urdf"], "robot.urdf"),
    "map without =": (["robot.urdf", "robot.xml", "--map", "hip0"], "map: 'hip0' is not of the"),
    "map of an unknown name": (
        ["robot.urdf", "robot.xml", "--map", "hop=hip0"],
        "'hop'; most similar: hip0, ",
    ),
    "map of two to one": (
        ["robot.urdf", "robot.xml", "--map", "hip0=hip1", "--map", "hip1=hip1"],
        "hip1",
    ),
    "tolerance of nothing": (
        ["robot.urdf", "robot.xml", "--tolerance", "weight=1"],
        "unknown kind 'weight'; valid: mass, com,",
    ),
    "package nowhere": (["robot.urdf", "robot.xml", "--package", "parts=nowhere"], "nowhere"),
    "JSON in a folder": (["robot.urdf", "robot.xml", "--json", "folder"], "the path is a folder"),
}


@pytest.mark.parametrize("case", BAD)
def test_invalid_input_is_refused_in_one_line(
    models: Path, tmp_path: Path, case: str, capfd: pytest.CaptureFixture[str]
) -> None:
    """Output of C++ libraries is captured as well; no file is written or changed."""
    arguments, message = BAD[case]
    before = {path: path.stat().st_mtime_ns for path in models.rglob("*")}
    output = [] if "--json" in arguments else ["--json", str(tmp_path / "all.json")]
    with contextlib.chdir(models):
        status, out, err = run_command(capfd, "crosscheck", *arguments, *output)
    assert (status, out) == (2, "")
    assert message in err
    assert err.startswith("error: ")
    _, *steps = err.strip().splitlines()  # the next command may follow
    assert [step.partition(":")[0] for step in steps] in ([], ["  next"])
    assert list(tmp_path.iterdir()) == []
    assert {path: path.stat().st_mtime_ns for path in models.rglob("*")} == before


def test_verbose_prints_more(models: Path) -> None:
    short, full = (run(models, "robot.urdf", "heavier.xml", *more) for more in ((), ("-v",)))
    assert short.returncode == full.returncode == 1
    assert len(full.stdout) > len(short.stdout)


def test_folder_of_a_package_may_be_given(models: Path) -> None:
    result = run(models, "robot.urdf", "robot.xml", "--package", "parts=folder")
    assert result.returncode == 0, result.stderr


def test_help_describes_options_exit_status_and_examples(models: Path) -> None:
    result = run(models, "--help")
    assert result.returncode == 0
    for word in ("--map", "--tolerance", "--format", "Exit status: 0", "Examples:"):
        assert word in result.stdout


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"hip1" type="revolute"', '"hip1" type="floating"', "and was fixed at rest"),
        ('"hip1" type="revolute"', '"hip1" type="planar"', "and was fixed at rest"),
        ('upper="-0.5"', 'upper="-28.65"', "(degrees for radians?)"),
    ],
)
def test_unusual_joint_of_a_urdf_is_compared(
    models: Path, tmp_path: Path, old: str, new: str, message: str
) -> None:
    text = (models / "robot.urdf").read_text()
    assert old in text
    (tmp_path / "robot.urdf").write_text(text.replace(old, new))
    result = run(tmp_path, "robot.urdf", str(models / "robot.xml"))
    assert result.returncode == 1
    assert message in result.stdout
