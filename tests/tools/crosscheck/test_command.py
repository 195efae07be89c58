"""``pupper-analysis crosscheck``: exit status, options, output for machines, and bad input."""

from __future__ import annotations

from pathlib import Path

import pytest

from pupper_analysis import cli
from tests.support.commands import Answer, answer
from tests.support.robots import all_changed, changed, mjcf_text, quadruped, urdf_text, write_parts


def run(folder: Path, *arguments: str) -> Answer:
    return answer("crosscheck", *arguments, folder=folder)


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a URDF, an MJCF that agrees, one that differs, and one with other names."""
    folder = tmp_path_factory.mktemp("models")
    robot = quadruped()
    write_parts(folder, robot, robot)
    heavier = changed(all_changed(robot, damping=0.3), "base", mass=7.5)
    (folder / "heavier.xml").write_text(mjcf_text(heavier))
    (folder / "slightly.xml").write_text(mjcf_text(changed(robot, "base", mass=6.0001)))
    (folder / "renamed.urdf").write_text(urdf_text(changed(robot, "shank1", joint="lf kfe")))
    (folder / "folder").mkdir()
    (folder / "names.toml").write_text('"lf kfe" = "knee1"\n')
    (folder / "noise.toml").write_text("= = =\n")
    (folder / "text.urdf").write_text("a robot\n")
    (folder / "cut.xml").write_text(mjcf_text(robot)[:400])
    return folder


def test_strict_minds_names(models: Path, tmp_path: Path) -> None:
    """A name that was guessed is a note, an error under --strict, and none once it is given."""
    text = (models / "robot.urdf").read_text().replace('"knee2"', '"lh_kfe"')
    (tmp_path / "robot.urdf").write_text(text)
    pair = ("robot.urdf", str(models / "robot.xml"))
    loose = run(tmp_path, *pair)
    assert loose.returncode == 0
    assert "by part of the name (confirm with --map): lh_kfe=knee2" in loose.stdout
    strict = run(tmp_path, *pair, "--strict")
    assert strict.returncode == 1
    assert ": joint knee2: it is called lh_kfe in the URDF, knee2 in the" in strict.stdout
    assert run(tmp_path, *pair, "--strict", "--map", "lh_kfe=knee2").returncode == 0


BAD: dict[str, tuple[list[str], str]] = {
    "missing URDF": (["nobody.urdf", "robot.xml"], "nobody.urdf: there is no such file"),
    "a folder": (["folder", "robot.xml"], "folder: it is a folder"),
    "no XML": (["text.urdf", "robot.xml"], "text.urdf:1: not well-formed XML"),
    "swapped": (["robot.xml", "robot.urdf"], "robot.xml:1: a URDF's root element is <robot>"),
    "one file": (["robot.urdf"], "Missing argument 'MJCF'"),
    "map without =": (["robot.urdf", "robot.xml", "--map", "hip0"], "map: 'hip0' is not of the"),
    "map of an unknown name": (
        ["robot.urdf", "robot.xml", "--map", "hop=hip0"],
        "'hop'; there are: hip0, knee0,",
    ),
    "map of two to one": (
        ["robot.urdf", "robot.xml", "--map", "hip0=hip1", "--map", "hip1=hip1"],
        "hip1",
    ),
    "tolerance of nothing": (
        ["robot.urdf", "robot.xml", "--tolerance", "weight=1"],
        "no kind 'weight'; valid: mass, com,",
    ),
    "tolerance nan": (["robot.urdf", "robot.xml", "--tolerance", "mass=nan"], "is not positive"),
    "package nowhere": (["robot.urdf", "robot.xml", "--package", "parts=nowhere"], "nowhere"),
    "JSON in a folder": (["robot.urdf", "robot.xml", "--json", "folder"], "it is a folder"),
    "JSON below a file": (["robot.urdf", "robot.xml", "--json", "robot.xml/x"], "not a folder"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_one_line_and_exit_status_2(
    models: Path,
    tmp_path: Path,
    case: str,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    """In this process, to save the time of its start; what C++ prints is captured as well."""
    arguments, message = BAD[case]
    before = {path: path.stat().st_mtime_ns for path in models.rglob("*")}
    output = [] if "--json" in arguments else ["--json", str(tmp_path / "all.json")]
    monkeypatch.chdir(models)
    with pytest.raises(SystemExit) as leaving:
        cli.run(cli.group, ["crosscheck", *arguments, *output])
    out, err = capfd.readouterr()
    assert leaving.value.code == 2
    assert message in err
    assert err.startswith("error: ")
    assert len(err.strip().splitlines()) == 1
    assert out == ""
    assert list(tmp_path.iterdir()) == []
    assert {path: path.stat().st_mtime_ns for path in models.rglob("*")} == before
