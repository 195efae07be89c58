"""The README is true: its snippets run, its commands exist, its numbers are the program's."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import pytest

import pupper_analysis as pa
from pupper_analysis import cli
from tests.support.commands import answer
from tests.support.repository import ROOT

README = (ROOT / "README.md").read_text()
PAGES = [*ROOT.glob("[!C]*.md"), *(ROOT / "docs").glob("*.md"), *(ROOT / "examples").glob("*.md")]
SNIPPETS = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)


@pytest.mark.slow
@pytest.mark.parametrize("snippet", SNIPPETS, ids=range(len(SNIPPETS)))
def test_snippet_runs(snippet: str, tmp_path: Path) -> None:
    result = subprocess.run(
        [sys.executable, "-c", snippet],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        timeout=120,
        check=False,
    )
    assert result.returncode == 0, result.stderr


def test_there_are_snippets() -> None:
    assert len(SNIPPETS) >= 2


def test_links_and_scripts_exist() -> None:
    named = set(re.findall(r"\]\(((?!http)[^)#]+)\)", README))
    named |= set(re.findall(r"(scripts/\w+\.py)", README))
    for path in named:
        assert (ROOT / path).is_file(), path


def test_the_two_commands_are_targets() -> None:
    commands = re.findall(r"^    make (\w+)$", README, flags=re.MULTILINE)
    assert commands == ["analyze", "test"]
    makefile = (ROOT / "Makefile").read_text()
    for target in commands:
        assert re.search(rf"^{target}:", makefile, flags=re.MULTILINE)


def test_the_table_of_variants_is_true() -> None:
    rows = re.findall(r"^\| ([\w-]+) \| ([\d.]+) \| ([\d.]+) \| ([\d.]+) \| (.*) \|$", README, re.M)
    assert [row[0] for row in rows] == list(pa.VARIANTS)
    for name, mass, mass_ratio, thigh_ratio, rest in rows:
        robot = pa.load_variant(name)
        base = pa.load_variant(pa.VariantSpec(base=pa.VARIANTS[name].base))
        stand = pa.held_stand(robot)
        statics = pa.gravity_compensation(pa.Configuration(robot, stand.qpos))
        peak, utilisation = rest.split(" | ")[:2]
        assert float(mass) == pytest.approx(robot.total_mass, abs=5e-4)
        assert float(mass_ratio) == pytest.approx(robot.total_mass / base.total_mass, abs=5e-4)
        assert float(thigh_ratio) == pa.VARIANTS[name].leg_scale
        assert float(peak) == pytest.approx(abs(statics.joint_torques).max(), abs=5e-4)
        assert float(utilisation.split()[0]) == pytest.approx(
            100 * statics.motor_utilisation.max(), abs=0.05
        )


def commands(text: str) -> list[str]:
    """The commands that a page names: between backticks, or in a block of code."""
    spans = re.findall(r"`(pupper-analysis [a-z][^`]*)`", text)
    joined = text.replace("\\\n", " ")
    lines = re.findall(r"^(?: {4}|\$ |- run: )?(pupper-analysis .*)$", joined, re.M)
    return sorted({re.split(r"\s+[#>]", command)[0].strip() for command in [*spans, *lines]})


README_COMMANDS = [
    pytest.param(command, marks=pytest.mark.slow if command.split()[1] in ("best", "push") else ())
    for command in commands(README)
    # The first two are run by test_cli; a page is served until it is ended: by test_live_browser.
    if "mini_cheetah" not in command and command.split()[1] not in ("analyze", "live")
]


@pytest.mark.slow
@pytest.mark.parametrize("command", README_COMMANDS)
def test_a_command_runs(command: str, tmp_path: Path) -> None:
    urdf, mjcf = pa.write_variant("heavy", tmp_path / "written")
    (tmp_path / "robot.urdf").write_bytes(urdf.read_bytes())
    (tmp_path / "robot.xml").write_bytes(mjcf.read_bytes())
    pair = '[[pair]]\nname = "robot"\nurdf = "robot.urdf"\nmjcf = "robot.xml"\n'
    (tmp_path / "pupper-analysis.toml").write_text(pair)
    for example in (ROOT / "examples").glob("*.toml"):
        (tmp_path / example.name).write_bytes(example.read_bytes())
    arguments = shlex.split(command.replace("FILE", "robot.urdf"))[1:]
    if "HEAD:" in command:
        who = ["-c", "user.name=a", "-c", "user.email=a@example.com"]
        for git in (["init"], ["add", "robot.urdf"], [*who, "commit", "--message=robot"]):
            subprocess.run(["git", *git], cwd=tmp_path, check=True)
    result = answer(*arguments, folder=tmp_path)
    assert result.returncode == 0, result.stderr + result.stdout
    for option, file in pairwise(arguments):
        if option in ("--figure", "--csv"):
            assert (tmp_path / file).is_file()


def test_all_commands_about_stances_are_in_the_readme() -> None:
    named = {command.split()[1] for command in commands(README)}
    assert named | {"view", "drop"} == set(cli.group.commands)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_commands_have_the_options_that_pages_name(page: Path) -> None:
    for command in commands(page.read_text()):
        name, *arguments = shlex.split(command)[1:]
        assert name in cli.group.commands, command
        if arguments:
            cli.group.commands[name].make_context(name, arguments)
