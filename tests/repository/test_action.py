"""GitHub Action and pre-commit hook: their commands are executed as GitHub's runner does."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml
from packaging.requirements import Requirement

from pupper_analysis import cli
from tests.support.repository import ROOT

SAMPLE = ROOT / "examples" / "guarded"
NETWORK = "Could not fetch|No matching distribution|Temporary failure|Network is unreachable"


def read(path: Path) -> Any:
    return yaml.safe_load(path.read_text())


ACTION = read(ROOT / "action.yml")
STEPS = {step["name"]: step for step in ACTION["runs"]["steps"] if "run" in step}


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """Return the sample repository, checked out."""
    shutil.copytree(SAMPLE, tmp_path / "checkout")
    return tmp_path / "checkout"


def environment(checkout: Path, **inputs: str) -> dict[str, str]:
    """Return the environment variables that GitHub sets for a step of a composite action."""
    given = {name: spec["default"] for name, spec in ACTION["inputs"].items()} | inputs
    names = {k: v for k, v in os.environ.items() if not k.startswith(("GITHUB_", "PYTHON", "PIP_"))}
    environment = names | {
        "GITHUB_ACTION_PATH": str(ROOT),
        "GITHUB_WORKSPACE": str(checkout),
        "RUNNER_TEMP": str(checkout.parent / "temp"),
    }
    for name, value in STEPS["Check"]["env"].items():
        found = re.fullmatch(r"\$\{\{ inputs\.([a-z-]+) \}\}", value)
        assert found is not None, value
        environment[name] = given[found[1]]
    return environment


def step(name: str, checkout: Path, **inputs: str) -> subprocess.CompletedProcess[str]:
    """Run a step as GitHub's runner does: ``bash --noprofile --norc -eo pipefail``."""
    assert STEPS[name]["shell"] == "bash"
    script = checkout.parent / "step.sh"
    script.write_text(STEPS[name]["run"])
    return subprocess.run(
        ["bash", "--noprofile", "--norc", "-eo", "pipefail", str(script)],
        cwd=checkout,
        env=environment(checkout, **inputs),
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.fixture
def installed(checkout: Path) -> Path:
    """Return the checkout, where the package of this checkout is installed as the action would."""
    programs = checkout.parent / "temp" / "pupper-analysis" / "bin"
    programs.mkdir(parents=True)
    program = programs / "pupper-analysis"
    code = f"PYTHONPATH={shlex.quote(str(ROOT))} exec {shlex.quote(sys.executable)}"
    program.write_text(f'#!/bin/sh\n{code} -m pupper_analysis "$@"\n')
    program.chmod(0o755)
    return checkout


def test_action_file_is_complete() -> None:
    """No script contains an expression, which would execute the names of branches and files."""
    assert ACTION["runs"]["using"] == "composite"
    assert ACTION["name"]
    assert ACTION["description"]
    assert set(STEPS) == {"Install", "Check"}
    for name, spec in ACTION["inputs"].items():
        assert spec.keys() == {"description", "default"}, name
        used = f"${{{{ inputs.{name} }}}}"
        assert used in (ROOT / "action.yml").read_text(), f"{name} is not used"
    # An expression in a script would be code of whoever names a branch or a file.
    assert not any("${{" in step["run"] for step in STEPS.values())


@pytest.mark.slow
def test_the_action_passes_on_the_sample(installed: Path) -> None:
    result = step("Check", installed)
    assert result.returncode == 0, result.stderr
    assert result.stdout == "passed: 0 to fix, 1 known\n"


@pytest.mark.slow
def test_action_fails_at_the_line_of_a_new_difference(installed: Path) -> None:
    text = (installed / "hopper.urdf").read_text()
    (installed / "hopper.urdf").write_text(text.replace('upper="1.5"', 'upper="1.2"'))
    line = text[: text.index('upper="1.5"')].count("\n") + 1
    result = step("Check", installed)
    assert result.returncode == 1
    assert f"::error file=hopper.urdf,line={line},title=upper limit of hip::" in result.stdout


@pytest.mark.slow
def test_action_uses_its_inputs_with_spaces(installed: Path) -> None:
    """Settings in a folder with spaces, and an output file with spaces."""
    folder = installed / "robots and more"
    folder.mkdir()
    for name in ("hopper.urdf", "hopper.xml", "pupper-analysis.toml"):
        shutil.move(installed / name, folder / name)
    output = installed / "the results.sarif"
    config = "robots and more/pupper-analysis.toml"
    result = step("Check", installed, config=config, format="sarif", output=str(output))
    assert result.returncode == 1, result.stderr  # the baseline is in the old folder
    assert result.stdout == ""
    assert '"uri": "robots%20and%20more/hopper.urdf"' in output.read_text()
    result = step("Check", installed, config="none.toml")
    assert result.returncode == 2
    assert "none.toml" in result.stderr


@pytest.mark.slow
@pytest.mark.parametrize("name", ["since", "config", "format"])
def test_an_input_that_begins_with_a_dash_is_no_option(installed: Path, name: str) -> None:
    """Git would execute ``--upload-pack`` if the remote is a path."""
    made = installed.parent / "made"
    for command in (
        ["init", "--quiet"],
        ["remote", "add", "origin", str(installed)],
    ):
        subprocess.run(["git", *command], cwd=installed, check=True)
    result = step("Check", installed, **{name: f"--upload-pack=touch {made};true"})
    assert result.returncode not in (0, 1)
    assert not made.exists()
    assert "No such option" not in result.stderr
    assert "--upload-pack=touch" in result.stderr


@pytest.mark.slow
def test_action_installs_the_packages_of_check(checkout: Path) -> None:
    """From the package index, as on GitHub; without PlaCo and Matplotlib."""
    result = step("Install", checkout)
    if result.returncode and re.search(NETWORK, result.stderr):
        pytest.skip("no package index is in reach")
    assert result.returncode == 0, result.stderr
    result = step("Check", checkout)
    assert result.returncode == 0, result.stderr
    assert result.stdout == "passed: 0 to fix, 1 known\n"
    names = {path.name for path in (checkout.parent / "temp").rglob("*")}
    assert "mujoco" in names
    assert not {"placo", "matplotlib", "clarabel"} & names


def test_fetched_actions_and_packages_are_pinned_by_hash() -> None:
    """The action runs in other repositories; tags can be moved and files of packages replaced."""
    for file in (ROOT / "action.yml", *(ROOT / ".github/workflows").glob("*.yml")):
        used = re.findall(r"uses: (\S+)", file.read_text())
        assert used, file
        assert all(action == "./" or re.search(r"@[0-9a-f]{40}$", action) for action in used), file
    assert "--require-hashes" in STEPS["Install"]["run"]
    lock = (ROOT / ".github/requirements/check.lock").read_text()
    assert "://" not in lock
    pinned: dict[str, list[str]] = {}
    for entry in re.split(r"\n(?=\S)", lock)[1:]:
        name, version = re.findall(r"^([a-z0-9.-]+)==(\S+)", entry)[0]
        assert "--hash=sha256:" in entry, name
        pinned.setdefault(name, []).append(version)
    asked = (ROOT / ".github/requirements/check.txt").read_text().splitlines()
    building = tomllib.loads((ROOT / "pyproject.toml").read_text())["build-system"]["requires"]
    for line in (*asked, *building):
        if not line.startswith("#"):
            wanted = Requirement(line)
            versions = pinned[wanted.name.lower()]
            assert all(wanted.specifier.contains(version) for version in versions), line


def test_locked_requirements_equal_those_of_the_project() -> None:
    """`python scripts/check_requirements.py` writes them anew."""
    code = "import check_requirements as c; print(c.make_requirements(), end='')"
    result = subprocess.run(
        [sys.executable, "-c", code],
        cwd=ROOT / "scripts",
        capture_output=True,
        text=True,
        check=True,
    )
    (ours, our_pins), (todays, pins) = (
        text.split("# The versions that placo ")
        for text in ((ROOT / ".github/requirements/check.txt").read_text(), result.stdout)
    )
    assert ours == todays
    assert re.search(r"^pin==\d", our_pins, re.M)
    # A newer PlaCo may pin others: the list is what was tried.
    if our_pins.split()[0] == pins.split()[0]:
        assert our_pins == pins
    assert "placo" not in re.sub("#.*", "", ours + our_pins)


BLOCKED = """
import sys
for name in ("placo", "matplotlib", "clarabel", *{more}):
    sys.modules[name] = None
from pupper_analysis.__main__ import main
main()
"""
"""Code of a process in which some packages cannot be imported."""

V3 = [str(ROOT / "urdf" / "pupper_v3.urdf"), str(ROOT / "mjcf" / "pupper_v3.xml")]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "more"),
    [
        (["check"], ()),
        (["check", "--format", "sarif"], ()),
        (["crosscheck", *V3], ()),
        (["audit", V3[0]], ("yourdfpy",)),
        (["audit", V3[1]], ("yourdfpy", "trimesh")),
        (["sync", *V3, "--take", "urdf", "--dry-run"], ()),
        (["diff", V3[0], V3[0]], ("yourdfpy",)),
        (["diff", V3[1], V3[1]], ("yourdfpy", "trimesh")),
    ],
    ids=lambda value: value[0] if isinstance(value, list) else "",
)
def test_commands_run_without_the_packages_that_they_do_not_need(
    arguments: list[str], more: tuple[str, ...]
) -> None:
    result = subprocess.run(
        [sys.executable, "-c", BLOCKED.format(more=more), *arguments],
        cwd=SAMPLE,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 0, result.stderr


# ------------------------------------------------------------------------------------- the sample

HOOKS = {hook["id"]: hook for hook in read(ROOT / ".pre-commit-hooks.yaml")}


def test_hook_file_is_complete() -> None:
    """The pattern matches the models and settings of the sample, and no other file."""
    hook = HOOKS["pupper-analysis-check"]
    assert hook["language"] == "python"
    assert hook["pass_filenames"] is False
    program, command = hook["entry"].split()
    assert program == "pupper-analysis"
    assert command in cli.COMMAND_NAMES
    for path in SAMPLE.iterdir():
        wanted = path.suffix in (".urdf", ".xml", ".toml")
        assert bool(re.search(hook["files"], path.name)) is wanted
    assert re.search(hook["files"], "models/robot.mjcf")


@pytest.mark.slow
@pytest.mark.parametrize("mass", ["0.22", "0.3"])
def test_pre_commit_runs_the_hook(installed: Path, mass: str) -> None:
    """The hook passes on the sample, and fails if the MJCF has another mass [kg]."""
    rewritten = (installed / "hopper.xml").read_text().replace("0.22", mass)
    (installed / "hopper.xml").write_text(rewritten)
    local = {**HOOKS["pupper-analysis-check"], "language": "system"}
    config = {"repos": [{"repo": "local", "hooks": [local]}]}
    (installed / ".pre-commit-config.yaml").write_text(yaml.safe_dump(config))
    programs = installed.parent / "temp" / "pupper-analysis" / "bin"
    given = {
        **environment(installed),
        "PATH": f"{programs}{os.pathsep}{os.environ['PATH']}",
        "PRE_COMMIT_HOME": str(installed.parent / "cache"),
        "GIT_CONFIG_GLOBAL": os.devnull,
    }
    for command in (["git", "init", "--quiet"], ["git", "add", "."]):
        subprocess.run(command, cwd=installed, env=given, check=True)
    result = subprocess.run(
        [sys.executable, "-m", "pre_commit", "run", "--all-files"],
        cwd=installed,
        env=given,
        capture_output=True,
        text=True,
        check=False,
    )
    passes = mass == "0.22"
    assert result.returncode == (0 if passes else 1), result.stdout + result.stderr
    assert ("Passed" if passes else "Failed") in result.stdout
    assert ("0.3 kg in the MJCF" in result.stdout) is not passes


def test_sample_uses_the_action_and_the_hook() -> None:
    workflow = read(SAMPLE / ".github" / "workflows" / "models.yml")
    steps = workflow["jobs"]["check"]["steps"]
    assert [re.sub("@.*", "", job_step["uses"]) for job_step in steps] == [
        "actions/checkout",
        "OWNER/pupper_analysis",
    ]
    (repository,) = read(SAMPLE / ".pre-commit-config.yaml")["repos"]
    assert [hook["id"] for hook in repository["hooks"]] == list(HOOKS)
