"""The command line: what it prints, what it writes, and its exit status."""

from __future__ import annotations

import ast
import json
import os
import subprocess
import sys
from pathlib import Path

import click
import mujoco
import pytest

import pupper_analysis as pa
from pupper_analysis import cli
from pupper_analysis.base.tools import HEADINGS, OWN, own_tools
from pupper_analysis.pupper.variants import VARIANTS
from tests.support.commands import answer
from tests.support.repository import ROOT

SCRIPTS = ROOT / "scripts"


def run(script: str, *arguments: str, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, str(SCRIPTS / script), *arguments],
        capture_output=True,
        text=True,
        timeout=120,
        cwd=cwd,
        check=False,
    )


def test_analyze_prints_every_part_and_writes_figures_and_json(tmp_path: Path) -> None:
    result = run(
        "analyze_variant.py",
        "long-leg",
        "v3-heavy",
        "--output",
        str(tmp_path / "out"),
        "--json",
        str(tmp_path / "all.json"),
        "-v",
    )
    assert result.returncode == 0, result.stderr
    for part in (
        "long-leg",
        "v3-heavy",
        "Joints",
        "com at zero angles",
        "Errors of the solved stand (PlaCo",
        "Foot Jacobians",
        "Motor torques",
        "Contact forces",
        "feed-forward",
        "Height deviation",
        "Cross-check",
        "Comparison",
        "1.475",
        "1.500",
        "2 of 2 verified",
    ):
        assert part in result.stdout, part
    figures = {path.name for path in (tmp_path / "out").iterdir()}
    assert figures == {
        "pose_long-leg.png",
        "pose_v3-heavy.png",
        "torques.png",
        "heights.png",
        "gains.png",
        "variants.png",
    }
    content = json.loads((tmp_path / "all.json").read_text())
    assert set(content["variants"]) == {"long-leg", "v3-heavy"}
    ratios = {row["name"]: row for row in content["comparison"]}
    assert ratios["long-leg"]["thigh_ratio"] == pytest.approx(1.5)
    assert ratios["long-leg"]["thigh_shape_ratio"] == pytest.approx(1.5)
    assert ratios["v3-heavy"]["mass_ratio"] == pytest.approx(4.676 / 3.170)
    assert content["variants"]["v3-heavy"]["verified"] is True


def test_a_page_by_default_and_a_line_if_quiet(tmp_path: Path) -> None:
    page = answer("analyze", "v3", "v3-long-leg", "--no-figures", folder=tmp_path)
    assert page.returncode == 0
    lines = page.stdout.splitlines()
    robot = pa.load_variant("v3")
    held = pa.stance.stand_statics(robot, pa.stance.solve_stand_as_simulated(robot))
    peak = f"{held.motor_utilisation.max():.1%} of its limit"
    assert lines[0].startswith("VERIFIED v3: 3.170 kg; on the simulated ground the peak torque is ")
    assert lines[0].endswith(peak)
    assert "stands 131.5 mm high, in MuJoCo 131.5 mm" in lines[1]
    assert "commanded to the same joints without feed-forward 124.1 mm" in lines[1]
    assert "leg_back_l_2 touches the ground" in page.stdout
    assert "on what was assumed: -v" in page.stdout
    assert lines[-2:] == ["2 of 2 verified", lines[-1]]
    assert lines[-1].startswith("every table: -v; every number: --json FILE")
    quiet = answer("analyze", "original", "--no-figures", "-q", folder=tmp_path)
    assert quiet.stdout == "1 of 1 verified\n"
    both = answer("analyze", "-q", "-v", folder=tmp_path)
    assert both.returncode == 2
    assert both.stderr == "error: -v, -q: give one of them, or none\n"


def test_analyze_own_variant_in_another_stance(tmp_path: Path) -> None:
    result = run(
        "analyze_variant.py",
        *("--base", "v3", "--leg-scale", "1.2", "--torso-mass-scale", "1.3"),
        *("--height", "0.15", "--roll", "0.05", "--pitch", "-0.05", "--yaw", "0.1"),
        "--no-figures",
        "--verbose",
        cwd=tmp_path,
    )
    assert result.returncode == 0, result.stderr + result.stdout
    assert "v3-leg1.2-torso1.3" in result.stdout
    assert "height 150.0 mm, roll 2.9 deg, pitch -2.9 deg, yaw 5.7 deg" in result.stdout
    assert list(tmp_path.iterdir()) == []


def test_write_makes_files_that_load(tmp_path: Path) -> None:
    folder = tmp_path / "models"
    result = run("analyze_variant.py", "v3-long-leg", "--no-figures", "--write", str(folder))
    assert result.returncode == 0, result.stderr
    assert (folder / "urdf" / "v3-long-leg.urdf").is_file()
    model = mujoco.MjModel.from_xml_path(str(folder / "mjcf" / "v3-long-leg.xml"))
    assert model.body_mass.sum() == pytest.approx(3.642)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nobody"], "known variants: original, long-leg, heavy, v3"),
        (["original", "nobody"], "'nobody'"),
        (["--base", "v4"], "valid: skeleton, v3"),
        (["--leg-scale", "0"], "greater than 0"),
        (["--leg-scale", "-1"], "greater than 0"),
        (["--leg-scale", "nan"], "leg_scale nan"),
        (["--torso-mass-scale", "inf"], "torso_mass_scale inf"),
        (["--leg-scale", "long"], "'long' is not a valid float"),
        (["--frobnicate"], "No such option"),
        (["original", "--height", "0.5"], "FL by 292 mm"),
        (["original", "--height", "-0.1"], "not above the ground"),
        (["v3", "--roll", "nan"], "roll"),
        (["v3", "--pitch", "1.2"], "out of reach"),
    ],
)
def test_bad_input_is_one_line_and_exit_status_2(
    arguments: list[str], message: str, tmp_path: Path
) -> None:
    result = run("analyze_variant.py", *arguments, "--json", "all.json", cwd=tmp_path)
    assert result.returncode == 2
    assert message in result.stderr
    assert len(result.stderr.strip().splitlines()) == 1
    assert "Traceback" not in result.stderr
    assert result.stdout == ""
    assert list(tmp_path.iterdir()) == []


def test_a_failed_verification_is_exit_status_1(monkeypatch: pytest.MonkeyPatch) -> None:
    from click.testing import CliRunner

    from pupper_analysis import cli
    from pupper_analysis.simulation import verify as simulation

    monkeypatch.setattr(simulation, "JOINT_TOLERANCE", 1e-12)
    result = CliRunner().invoke(cli.find_command("analyze"), ["original", "--no-figures"])
    assert result.exit_code == 1
    assert "FAILED original: " in result.stdout
    assert "FAILED original: a joint is off by" in result.stdout
    assert "0 of 1 verified" in result.stdout


@pytest.mark.parametrize(
    ("script", "arguments"),
    [("stand_pupper.py", ["--headless", "--seconds", "nan"]), ("view_pupper.py", ["--fix"])],
)
def test_bad_input_of_the_other_scripts(script: str, arguments: list[str]) -> None:
    result = run(script, *arguments)
    assert result.returncode == 2
    assert len(result.stderr.strip().splitlines()) == 1
    assert "Traceback" not in result.stderr


def test_version_and_colors() -> None:
    assert answer("-V").stdout == answer("--version").stdout
    assert pa.__version__ in answer("-V").stdout


def test_colors_are_switched_off(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("NO_COLOR", "")
    file = str(ROOT / "urdf" / "pupper_v3.urdf")
    colored = answer("audit", file).stdout
    plain = answer("--no-color", "audit", file).stdout
    assert "\x1b[" in colored
    assert "\x1b[3" not in plain
    assert "OK" in plain


def test_the_shell_completes() -> None:
    """As docs/how-to/output.md says: click answers to this variable, whatever the shell."""
    done = subprocess.run(
        [str(Path(sys.executable).with_name("pupper-analysis"))],
        env={
            **os.environ,
            "_PUPPER_ANALYSIS_COMPLETE": "bash_complete",
            "COMP_WORDS": "pupper-analysis cross",
            "COMP_CWORD": "1",
        },
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout == "plain,crosscheck\n"


def test_every_command_that_reads_a_urdf_takes_packages() -> None:
    """By the same option; `check` and `study` read files in which it is said."""
    from pupper_analysis.cli import group

    context = click.Context(group)
    reading = {"urdf", "source", "file", "old"}
    found = set()
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        assert command is not None
        names = {str(parameter.name) for parameter in command.params}
        if names & reading and name not in ("study", "check"):
            found.add(name)
            assert "packages" in names, name
    assert len(found) >= 5, found  # whichever tools are there


def test_robots_are_completed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Variants, and the models of the folder; where neither begins so, the shell's own files."""
    monkeypatch.chdir(tmp_path)
    for name in ("v1.urdf", "v2.xml", "v.txt", "folder.xml/v.xml"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    known = {"v": {"v1.urdf", "v2.xml"}, "original": set()}
    for name in own_tools():
        command = cli.find_command(name)
        robots = [one for one in command.params if "[ROBOT]" in str(one.metavar)]
        for robot in robots:
            for begun, files in known.items():
                items = robot.shell_complete(click.Context(command), begun)
                found = {one.value for one in items if one.type == "plain"}
                assert found == files | {one for one in VARIANTS if one.startswith(begun)}
            (item,) = robot.shell_complete(click.Context(command), "folder.xml/")
            assert (item.type, item.value) == ("file", "folder.xml/")
        for other in command.params:
            if isinstance(other, click.Argument) and other not in robots:
                (item, *_) = other.shell_complete(click.Context(command), "")
                assert item.type == "file" or isinstance(other.type, click.Choice), name


def test_commands_stand_under_headings(capsys: pytest.CaptureFixture[str]) -> None:
    """Each of ours under one that is there; of others what states none, under the last."""
    assert {one.heading for one in own_tools().values()} <= set(HEADINGS[:-1])
    with pytest.raises(SystemExit):
        cli.run(cli.group, ["--help"])
    lines = capsys.readouterr().out.splitlines()
    for name, tool in own_tools().items():
        at = next(i for i, line in enumerate(lines) if line.split()[:1] == [name])
        above = [line for line in lines[:at] if line and line[0] != " "]
        assert above[-1] == f"{tool.heading}:"


@pytest.mark.parametrize("name", own_tools())
def test_a_tool_says_in_a_line_what_its_command_does(name: str) -> None:
    assert cli.find_command(name).name == name
    question = own_tools()[name].question
    assert 15 < len(question) < 60
    assert question[-1] in ".?"


def test_commands_are_written_in_tools_alone() -> None:
    written = {
        file.relative_to(OWN.parent).as_posix()
        for file in OWN.parent.rglob("*.py")
        for node in ast.parse(file.read_text("utf-8")).body
        if isinstance(node, ast.FunctionDef)
        and any("shared.command(" in ast.unparse(one) for one in node.decorator_list)
    }
    assert written == {f"tools/{name}/command.py" for name in own_tools()}
    # A folder has a command, or reads a format.
    asked = {path.name for path in OWN.iterdir() if (path / "__init__.py").exists()}
    assert asked - {path.parent.name for path in OWN.glob("*/format.toml")} == set(own_tools())


@pytest.mark.parametrize(
    ("arguments", "needed"),
    [(["--help"], set()), (["diff", "--help"], {"diff"})],
    ids=["the list of all", "one command"],
)
def test_a_command_imports_no_other(arguments: list[str], needed: set[str]) -> None:
    code = f"""
import sys
from pupper_analysis import cli
try:
    cli.run(cli.group, {arguments})
finally:
    print("imported", *sys.modules)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    imported = set(done.stdout.rpartition("imported ")[2].split())
    commands = {f"{tool.package}.command" for tool in own_tools().values()}
    assert commands & imported == {f"pupper_analysis.tools.{one}.command" for one in needed}
    assert "numpy" not in imported or needed
    for name, tool in own_tools().items():
        assert needed or f"{name} " in done.stdout
        assert needed or tool.question in done.stdout
