"""Each command, and each public function of model files, accepts all names of a robot."""

from __future__ import annotations

import inspect
from pathlib import Path

import click
import mujoco
import pytest

import pupper_analysis as pa
from pupper_analysis import cli
from pupper_analysis.cli.shared import OutputPath
from pupper_analysis.pupper.variants import find_model_folder
from tests.support.commands import Answer, answer

COMMANDS = sorted(cli.group.list_commands(click.Context(cli.group)))
"""All installed commands."""

_OTHER_INPUT = {
    "check": "check requires a folder",
    "study": "study requires a TOML file",
}
"""{command: text of the error about a robot that is not installed}: commands without a robot on the
command line."""

_ROBOT_ARGUMENTS = {"words", "file", "folder", "sources", "source", "urdf", "mjcf", "old", "new"}
"""Names of arguments that specify robots."""


def run_with_robot(command: str, robot: str, folder: Path) -> Answer:
    """Run a command with the name of a robot as each of its robot arguments.

    Other required parameters get the first choice, an output file, or an existing file.
    """
    (folder / "policy.json").write_text("{}")
    words = [command]
    for parameter in cli.find_command(command).params:
        if isinstance(parameter, click.Argument) and parameter.name in _ROBOT_ARGUMENTS:
            words.append(robot)
        elif parameter.required:
            words += [] if isinstance(parameter, click.Argument) else [parameter.opts[-1]]
            if isinstance(parameter.type, click.Choice):
                words.append(str(parameter.type.choices[0]))
            elif isinstance(parameter.type, OutputPath):
                words.append(str(folder / "new.xml"))
            else:
                words.append(str(folder / "policy.json"))
    if command == "fit":
        words += ["--plan", "1", "-o", str(folder / "plan.csv")]
    return answer(*words, folder=folder)


@pytest.mark.slow
@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize(
    ("robot", "expected"),
    [
        ("v3-log", "did you mean v3-long-leg"),
        ("nowhere_mj_description", "robot_descriptions"),
    ],
)
def test_each_command_resolves_the_name_of_a_robot(
    command: str, robot: str, expected: str, tmp_path: Path
) -> None:
    """Unknown names: the error is that of the source of the name, not that of a missing file.

    Reference: the list of installed commands; a new command without names fails.
    """
    done = run_with_robot(command, robot, tmp_path)
    assert done.returncode == 2, done.stderr
    if command in _OTHER_INPUT:
        expected = _OTHER_INPUT[command] if robot != "v3-log" else ""
    assert expected in done.stderr


FUNCTIONS = {
    name: function
    for name in pa.__all__
    if inspect.isfunction(function := getattr(pa, name))
    and any(
        "ModelObject" in str(parameter.annotation)
        for parameter in inspect.signature(function).parameters.values()
    )
}
"""Public functions that accept a robot in memory."""

URDF = (find_model_folder("urdf") / "pupper_v3.urdf").read_text()


def call_with_robot(name: str, robot: object, folder: Path) -> object:
    """Call a public function with a robot as each of its model arguments."""
    if name == "convert_model":
        return pa.convert_model(robot, folder / "new.urdf")
    if name == "compare_models":
        return pa.compare_models(
            URDF if isinstance(robot, mujoco.MjSpec) else robot, robot, configurations=1
        )
    count = 2 if name == "diff_models" else 1
    return FUNCTIONS[name](*[robot] * count)


@pytest.mark.slow
@pytest.mark.parametrize("name", FUNCTIONS)
def test_each_function_of_models_accepts_variants_and_objects(name: str, tmp_path: Path) -> None:
    """Reference: results for the files of the same variant agree."""
    path = find_model_folder("mjcf") / "pupper_v3.xml"
    robots = (
        "v3",
        Path("v3"),
        pa.pupper.VariantSpec("v3", 1.1),
        mujoco.MjSpec.from_file(str(path)),
    )
    for index, robot in enumerate(robots):
        folder = tmp_path / str(index)
        folder.mkdir()
        result = call_with_robot(name, robot, folder)
        for positive in ("passed", "agree", "same"):
            assert getattr(result, positive, True), (robot, result)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_each_function_of_models_suggests_the_similar_variant(name: str, tmp_path: Path) -> None:
    with pytest.raises(pa.VariantError, match="did you mean v3-long-leg"):
        call_with_robot(name, "v3-log", tmp_path)
