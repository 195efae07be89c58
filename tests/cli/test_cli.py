"""The command line: printed text, written files, and exit status."""

from __future__ import annotations

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
from pupper_analysis.base.tools import HELP_HEADINGS, own_tools
from pupper_analysis.pupper.variants import VARIANTS
from tests.support.commands import answer
from tests.support.patience import PATIENCE
from tests.support.repository import ROOT

SCRIPTS = ROOT / "scripts"


def run_script(
    script: str, *arguments: str, cwd: Path | None = None
) -> subprocess.CompletedProcess[str]:
    """Run a script of the repository, and return the completed process."""
    return subprocess.run(
        [sys.executable, str(SCRIPTS / script), *arguments],
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        cwd=cwd,
        check=False,
    )


@pytest.mark.slow
def test_analyze_writes_figures_json_and_models_of_its_own_variant(tmp_path: Path) -> None:
    """References: requested scales and task; total mass [kg] of the variant in the written MJCF."""
    result = run_script(
        "analyze_variant.py",
        *("--base", "v3", "--leg-scale", "1.2", "--height", "0.15", "--pitch", "-0.05"),
        *("--output", "out", "--json", "all.json", "--write", "models"),
        cwd=tmp_path,
    )
    assert result.returncode == 0, result.stderr + result.stdout
    name = "v3-leg1.2-torso1"
    figures = {path.name for path in (tmp_path / "out").iterdir()}
    common = {"torques.png", "heights.png", "gains.png", "variants.png"}
    assert figures == {f"pose_{name}.png", *common}
    content = json.loads((tmp_path / "all.json").read_text())
    variant = pa.pupper.VariantSpec("v3", 1.2)
    (row,) = content["comparison"]
    assert row["thigh_ratio"] == pytest.approx(1.2)
    mass, base_mass = (pa.load_variant(name).total_mass for name in (variant, "v3"))
    assert row["mass_ratio"] == pytest.approx(mass / base_mass)
    analysed = content["variants"][name]
    assert analysed["verified"] is True
    task = analysed["stand"]["task"]
    assert (task["height"], task["roll"], task["pitch"]) == (0.15, 0.0, -0.05)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / f"models/mjcf/{name}.xml"))
    assert model.body_mass.sum() == pytest.approx(mass)


ANALYZE = ("analyze_variant.py", "--json", "all.json")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "message"),
    [
        ((*ANALYZE, "nobody"), "known: original, long-leg, heavy, v3"),
        ((*ANALYZE, "original", "nobody"), "'nobody'"),
        ((*ANALYZE, "--leg-scale", "nan"), "leg_scale nan"),
        ((*ANALYZE, "--frobnicate"), "No such option"),
        ((*ANALYZE, "v3", "--pitch", "1.2"), "out of reach"),
        (("stand_pupper.py", "--headless", "--seconds", "3"), ""),
        (("view_pupper.py", "--fix"), ""),
    ],
)
def test_invalid_input_of_scripts_is_refused_in_one_line(
    words: tuple[str, ...], message: str, tmp_path: Path
) -> None:
    result = run_script(*words, cwd=tmp_path)
    assert (result.returncode, result.stdout) == (2, "")
    assert message in result.stderr
    assert len(result.stderr.strip().splitlines()) == 1
    assert "Traceback" not in result.stderr
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_exit_status_is_1_if_the_verification_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    """The joint tolerance is set to 1e-12 rad."""
    from click.testing import CliRunner

    from pupper_analysis.simulation import verify as simulation

    monkeypatch.setattr(simulation, "JOINT_TOLERANCE", 1e-12)
    result = CliRunner().invoke(cli.find_command("analyze"), ["original", "--no-figures"])
    assert result.exit_code == 1
    assert "FAILED original: " in result.stdout
    assert "FAILED original: a joint deviates from the prediction by" in result.stdout
    assert "VERIFIED" not in result.stdout


def test_no_color_option_takes_precedence_over_force_color(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("NO_COLOR", "")
    file = str(ROOT / "urdf" / "pupper_v3.urdf")
    colored = answer("audit", file).stdout
    plain = answer("--no-color", "audit", file).stdout
    assert "\x1b[" in colored
    assert "\x1b[3" not in plain
    assert "OK" in plain


def test_version_is_printed() -> None:
    assert pa.__version__ in answer("--version").stdout
    assert answer("-V").stdout == answer("--version").stdout


def test_the_shell_completes() -> None:
    """Reference: click's protocol, an environment variable, as in docs/how-to/output.md."""
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


def test_robots_are_completed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Variants, and the models of the folder; where neither begins so, the shell's own files."""
    monkeypatch.chdir(tmp_path)
    for name in ("v1.urdf", "v2.xml", "v.txt", "folder.xml/v.xml"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    known = {"v": {"v1.urdf", "v2.xml"}, "original": set()}
    for name in own_tools():
        command = cli.find_command(name)
        robots = [param for param in command.params if "[ROBOT]" in str(param.metavar)]
        for robot in robots:
            for begun, files in known.items():
                items = robot.shell_complete(click.Context(command), begun)
                found = {item.value for item in items if item.type == "plain"}
                assert found == files | {name for name in VARIANTS if name.startswith(begun)}
            (item,) = robot.shell_complete(click.Context(command), "folder.xml/")
            assert (item.type, item.value) == ("file", "folder.xml/")
        for param in command.params:
            if isinstance(param, click.Argument) and param not in robots:
                (item, *_) = param.shell_complete(click.Context(command), "")
                assert item.type == "file" or isinstance(param.type, click.Choice), name


def test_help_lists_each_command_under_its_heading(capsys: pytest.CaptureFixture[str]) -> None:
    """Tools of this package have a listed heading; tools of other distributions may omit the
    heading."""
    assert {tool.heading for tool in own_tools().values()} <= set(HELP_HEADINGS[:-1])
    with pytest.raises(SystemExit):
        cli.run(cli.group, ["--help"])
    lines = capsys.readouterr().out.splitlines()
    for name, tool in own_tools().items():
        at = next(i for i, line in enumerate(lines) if line.split()[:1] == [name])
        above = [line for line in lines[:at] if line and line[0] != " "]
        assert above[-1] == f"{tool.heading}:"


@pytest.mark.parametrize(
    ("arguments", "needed"),
    [(["--help"], set()), (["diff", "--help"], {"diff"})],
    ids=["the list of all", "one command"],
)
def test_command_imports_no_other_command(arguments: list[str], needed: set[str]) -> None:
    """Reference: the modules of a new process; the list of commands needs no NumPy."""
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
    assert commands & imported == {f"pupper_analysis.tools.{tool}.command" for tool in needed}
    assert "numpy" not in imported or needed
    for name, tool in own_tools().items():
        assert needed or f"{name} " in done.stdout
        assert needed or tool.question in done.stdout


def test_feet_joints_and_com_are_completed() -> None:
    """References: names of v3's feet and joints, and the words of ``--com``."""
    command = cli.find_command("stand")
    options = {param.name: param for param in command.params}
    context = click.Context(command)
    context.params["words"] = ("v3",)
    for name, begun, expected in (
        ("com", "", {"centre", "inside"}),
        ("swing", "F", {"FL=", "FR="}),
        ("posture", "leg_front_l", {f"leg_front_l_{number}=" for number in (1, 2, 3)}),
    ):
        items = options[name].shell_complete(context, begun)
        assert {item.value for item in items} == expected
    context.params["words"] = ("no-such-file.urdf",)
    assert options["swing"].shell_complete(context, "F") == []
