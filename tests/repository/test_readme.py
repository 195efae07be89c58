"""README and pages: snippets run, commands and options exist, and the numbers equal the
program's.
"""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from pathlib import Path

import mujoco
import pytest

import pupper_analysis as pa
from pupper_analysis import cli
from pupper_analysis.stance.sag.steady_state import steady_state
from tests.support.repository import ROOT

README = (ROOT / "README.md").read_text()
PAGES = [
    page
    for page in [
        *ROOT.glob("[!C]*.md"),
        *(ROOT / "docs").rglob("*.md"),
        *ROOT.glob("examples/*.md"),
    ]
    if "generated" not in page.parts
]


def test_table_of_variants_equals_the_computed_values() -> None:
    """Mass [kg], ratios, peak torque [N m] and utilisation [%], within half of the last printed
    digit.
    """
    rows = re.findall(r"^\| ([\w-]+) \| ([\d.]+) \| ([\d.]+) \| ([\d.]+) \| (.*) \|$", README, re.M)
    assert [row[0] for row in rows] == list(pa.VARIANTS)
    for name, mass, mass_ratio, thigh_ratio, rest in rows:
        robot = pa.load_variant(name)
        base = pa.load_variant(pa.pupper.VariantSpec(base=pa.VARIANTS[name].base))
        stand = pa.stance.solve_stand_as_simulated(robot)
        statics = pa.gravity_compensation(pa.Configuration(robot, stand.qpos))
        peak, utilisation = rest.split(" | ")[:2]
        assert float(mass) == pytest.approx(robot.total_mass, abs=5e-4)
        assert float(mass_ratio) == pytest.approx(robot.total_mass / base.total_mass, abs=5e-4)
        assert float(thigh_ratio) == pa.VARIANTS[name].leg_scale
        assert float(peak) == pytest.approx(abs(statics.joint_torques).max(), abs=5e-4)
        assert float(utilisation.split()[0]) == pytest.approx(
            100 * statics.motor_utilisation.max(), abs=0.05
        )


@pytest.mark.slow
def test_simulated_sags_are_those_of_a_plain_mujoco_simulation() -> None:
    """Reference: MuJoCo alone for 12 s, from the stand, commanded to its joint angles.

    The sags without sliding are those that `stand` predicts.
    """
    (stated,) = re.findall(
        r"After 12 s, v3 is ([\d.]+) mm lower than commanded, and v3-heavy ([\d.]+) mm", README
    )
    for name, sag in zip(("v3", "v3-heavy"), map(float, stated), strict=True):
        robot = pa.load_variant(name)
        model, stand = robot.mj_model, pa.stance.solve_stand_as_simulated(robot)
        data = mujoco.MjData(model)
        data.qpos[:], data.ctrl[:] = stand.qpos, stand.qpos[7:]
        mujoco.mj_step(model, data, nstep=round(12 / model.opt.timestep))
        assert sag == pytest.approx(1e3 * (stand.qpos[2] - data.qpos[2]), abs=0.05)
        (predicted,) = re.findall(rf"\| {name} \|.*\| sags by ([\d.]+) mm \|", README)
        settled = steady_state(robot, stand)
        assert float(predicted) == pytest.approx(1e3 * settled.height_loss, abs=0.05)


def commands(text: str) -> list[str]:
    """Return the commands that a page names: between backticks, or in a block of code."""
    spans = re.findall(r"`(pupper-analysis [a-z][^`]*)`", text)
    joined = text.replace("\\\n", " ")
    lines = re.findall(r"^(?: {4}|\$ |- run: )?(pupper-analysis .*)$", joined, re.M)
    return sorted(
        {re.split(r"\s+(?:[#>]|\|\s)", command)[0].strip() for command in [*spans, *lines]}
    )


@pytest.mark.parametrize("name", sorted(page.name for page in ROOT.glob("docs/zh/how-to/*.md")))
def test_chinese_guides_have_the_code_and_numbers_of_the_english(name: str) -> None:
    """Blocks of code are the same, in order, except the language of the answer; and so are all
    numbers with a unit.
    """
    english, chinese = (
        (ROOT / folder / name).read_text().replace(" --language zh", "")
        for folder in ("docs/how-to", "docs/zh/how-to")
    )
    blocks, theirs = (
        re.findall(r"```(?:sh|python)\n.*?```", text, re.S) for text in (english, chinese)
    )
    assert theirs == blocks[: len(theirs)]
    assert theirs
    numbers = set(
        re.findall(r"\d[\d.]*(?= (?:s|mm|%)\b)", re.sub(r"```.*?```", "", chinese, flags=re.S))
    )
    assert numbers <= set(re.findall(r"\d[\d.]*", english))


@pytest.mark.parametrize(
    "what", [f"scripts/{name}.py" for name in ("analyze_variant", "stand_pupper", "view_pupper")]
)
def test_script_outside_the_environment_prints_setup_instructions(what: str) -> None:
    """As with the machine's own Python: without site-packages."""
    without_the_environment(str(ROOT / what))


def test_package_outside_the_environment_prints_setup_instructions() -> None:
    without_the_environment("-m", "pupper_analysis")


def without_the_environment(*arguments: str) -> None:
    result = subprocess.run(
        [sys.executable, "-S", *arguments, "--help"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 2
    assert result.stderr.startswith("error: ")
    assert "source .venv/bin/activate" in result.stderr
    assert result.stderr.count("\n") == 1


def test_commands_have_the_options_that_pages_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    # The files of --stance are read at once.
    (tmp_path / "crouch.toml").write_text("height = '12cm'\n")
    (tmp_path / "best.json").write_text('{"stand": {"task": {"height": 0.12}}}')
    named = {command for page in PAGES for command in commands(page.read_text())}
    assert named
    for command in named:
        name, *arguments = shlex.split(command)[1:]
        if name == "inertia":  # of test_write_a_tool.py
            continue
        assert name.startswith("-") or name in cli.COMMAND_NAMES, command
        if arguments:
            cli.find_command(name).make_context(name, arguments)


def test_chinese_tutorial_has_the_commands_of_the_english() -> None:
    english, chinese = (
        re.findall(r"^(pupper-analysis .*?)(?:  #.*)?$", (ROOT / page).read_text("utf-8"), re.M)
        for page in ("docs/tutorials/pupper.md", "docs/zh/tutorial.md")
    )
    assert len(english) > 2
    translated = [line for line in chinese if line.endswith(" --language zh")]
    assert len(translated) == 1
    assert english == [line for line in chinese if line not in translated]
