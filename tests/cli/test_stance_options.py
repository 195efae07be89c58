"""Options that all commands of a stance share, and their help texts."""

from __future__ import annotations

from pathlib import Path

import click
import pytest

from pupper_analysis import cli
from pupper_analysis.cli.robots import RobotOptions
from pupper_analysis.cli.stance_fields import OPTION_FIELDS
from pupper_analysis.cli.stance_options import RobotAndTask, match_joint_pattern, parse_efforts
from pupper_analysis.pupper.variants import VariantSpec
from tests.support.arm import MJCF, URDF, load_arm
from tests.support.commands import answer

OURS = sorted({"stand", "workspace", "payload", "best", "path", "push"} & {*cli.COMMAND_NAMES})


def test_commands_share_their_options_of_robot_and_stance() -> None:
    """Name, type, default and help are equal in all commands."""
    own = {*RobotAndTask.__dataclass_fields__, *RobotOptions.__dataclass_fields__}
    names = {*own, *OPTION_FIELDS} - {"stance", "which", "fixed_base"}
    simulated = {
        "kp",
        "kd",
        "integrator",
        "timestep",
        "cone",
        "impratio",
    }  # a workspace is of kinematics
    shared = []
    for command in OURS:
        options = {option.name: option for option in cli.find_command(command).params}
        own_names = names - simulated if command == "workspace" else names
        assert own_names <= set(options), command
        assert command != "workspace" or simulated.isdisjoint(options)
        shared.append({name: options[name].to_info_dict() for name in sorted(own_names)})
    for infos in shared:
        assert all(info == shared[0][name] for name, info in infos.items())
    analyze = {option.name: option for option in cli.find_command("analyze").params}
    common = sorted(names & set(analyze))
    stand = {option.name: option for option in cli.find_command("stand").params}
    base = [
        field for field in OPTION_FIELDS.values() if field.slider and field.slider.folder == "Base"
    ]
    assert len(common) == 15 + len(base)
    for name in common:
        assert analyze[name].to_info_dict() == stand[name].to_info_dict()


@pytest.mark.parametrize("name", sorted(cli.COMMAND_NAMES))
def test_the_help_fits_into_80_columns(name: str) -> None:
    command = cli.find_command(name)
    help_text = command.get_help(click.Context(command, info_name=name, terminal_width=80))
    assert [line for line in help_text.splitlines() if len(line) > 80] == []


def select_variant(*given: object) -> object:
    """Return the variant that --base, --leg-scale and --torso-mass-scale select."""
    names = ("base", "leg_scale", "torso_mass_scale")
    return RobotOptions.pop_from(dict(zip(names, given, strict=True))).select_robot(())


def test_derived_variant_keeps_the_scales_that_are_not_given() -> None:
    for given, legs, torso in (
        (("v3", None, None), 1.0, 1.0),
        (("v3", 1.2, None), 1.2, 1.0),
        (("v3", None, 1.5), 1.0, 1.5),
    ):
        found = select_variant(*given)
        assert isinstance(found, VariantSpec)
        assert (found.base, found.leg_scale, found.torso_mass_scale) == ("v3", legs, torso)
    skeleton = select_variant(None, 1.5, None)
    assert isinstance(skeleton, VariantSpec)
    assert (skeleton.base, skeleton.torso_mass_scale) == ("skeleton", 1.0)
    assert select_variant(None, None, None) is None


def test_package_folder_that_does_not_exist_is_refused(tmp_path: Path) -> None:
    files = ("--urdf", "x.urdf", "--mjcf", "x.xml")
    done = answer("stand", *files, "--package", "p=nowhere", folder=tmp_path)
    assert done.returncode == 2
    assert "p: nowhere is not a folder" in done.stderr


@pytest.mark.parametrize("name", sorted(cli.COMMAND_NAMES))
def test_help_has_examples_and_exit_statuses(name: str) -> None:
    text = cli.find_command(name).help or ""
    examples = [line for line in text.splitlines() if line.strip().startswith("pupper-analysis ")]
    assert len(examples) >= (3 if name in OURS else 1)
    assert "Exit status:" in text


def test_name_of_a_joint_with_brackets_selects_the_joint(tmp_path: Path) -> None:
    urdf, mjcf = (text.replace('"elbow"', '"arm[0]"') for text in (URDF, MJCF))
    robot = load_arm(tmp_path, urdf=urdf, mjcf=mjcf)
    matches = match_joint_pattern("kp", "arm[0]", robot)
    assert [name for name, match in zip(robot.joint_names, matches, strict=True) if match] == [
        "arm[0]"
    ]
    assert parse_efforts(("*=3", "arm[0]=5"), robot)["arm[0]"] == 5
