"""Modes of commands: what is typed is used, or refused by name; nothing is passed over."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
import pytest

from pupper_analysis.cli import find_command
from pupper_analysis.cli.modes import refuse_unused
from pupper_analysis.errors import ConfigurationError, PupperAnalysisError

VALUES = {
    **{"topics": "state=/a", "priors": "mass=0", "weight": "3kg", "encoder": "0.1deg"},
    **{"hold_out": "0.3", "joints": "a,b", "kp": "5", "kd": "1", "packages": "x=.", "take": "urdf"},
    **{"pairs": "a=b", "leg_scale": "1.2", "torso_mass_scale": "1.2", "style": "markdown"},
    **{"fail_on": "warning", "stands": "other.csv", "logs": "other.csv", "count": "3"},
}
"""{parameter: what is typed}; a word that is a file's name of others."""

MODES = {
    "fit --plan": ("fit", "robot.xml", "--plan", "2"),
    "fit --stands": ("fit", "robot.xml", "--stands", "stands.csv"),
    "fit --log": ("fit", "robot.xml", "--log", "log.csv"),
    "analyze --list": ("analyze", "--list"),
    "audit --list-rules": ("audit", "--list-rules"),
    "check --init": ("check", "--init"),
}


class _Calls:
    """Takes the place of functions, and notes what they are called with."""

    def __init__(self) -> None:
        self.noted: list[str] = []

    def of(self, name: str, result: Any = None) -> Any:
        def call(*words: Any, **given: Any) -> Any:
            self.noted.append(f"{name}{words}{sorted(given.items())}")
            return result

        return call


def calls(patch: pytest.MonkeyPatch) -> _Calls:
    """Lets commands call nothing that takes long, and notes what they call."""
    from contextlib import nullcontext
    from types import SimpleNamespace

    noted, robot = _Calls(), SimpleNamespace(name="robot")
    fit, shared = "pupper_analysis.cli.fit", "pupper_analysis.cli.shared"
    of_fit = "pupper_analysis.identification"
    for name, result in {
        f"{fit}.robot_from": robot,
        f"{fit}.parse_gain": None,
        f"{fit}.print_notes": None,
        f"{shared}.check_outputs": None,
        f"{shared}.show_results": None,
        f"{shared}.show_progress": nullcontext(),
        f"{shared}.write_page": None,
        f"{shared}.confirm_written": None,
        f"{shared}.finish_command": None,
        f"{of_fit}.fit.fit": "a fit",
        f"{of_fit}.stands.plan.plan_stands": "a plan",
        f"{of_fit}.stands.plan.write_plan": None,
        f"{of_fit}.measurements.stands.read_stands": "stands",
        f"{of_fit}.measurements.log_files.read_log": "a log",
        "pupper_analysis.cli.variants._print_list": None,
        "pupper_analysis.cli.models._list_rules": None,
        "pupper_analysis.cli.guard._begin": None,
    }.items():
        patch.setattr(name, noted.of(name, result))
    return noted


def typed(words: tuple[str, ...], patch: pytest.MonkeyPatch) -> list[str] | PupperAnalysisError:
    """What a command calls, or how it refuses."""
    noted = calls(patch)
    command = find_command(words[0])
    try:
        command.main(args=list(words[1:]), standalone_mode=False)
    except PupperAnalysisError as error:
        return error
    except click.exceptions.Exit:
        pass
    return noted.noted


@pytest.mark.parametrize("mode", MODES)
def test_each_option_reaches_what_a_mode_calls_or_is_refused(
    mode: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "robot.xml").write_text("<mujoco/>")
    words = MODES[mode]
    with monkeypatch.context() as patch:
        before = typed(words, patch)
    assert isinstance(before, list), before
    assert before
    refused, used = [], []
    for parameter in find_command(words[0]).params:
        if not isinstance(parameter, click.Option) or not parameter.expose_value:
            continue
        name, option = str(parameter.name), max(parameter.opts, key=len)
        if option in words and not parameter.multiple:
            continue  # it is the mode
        value = VALUES.get(name, "1" if "path" not in name else "a.out")
        more = [option] if parameter.is_flag else [option, value]
        with monkeypatch.context() as patch:
            after = typed((*words, *more), patch)
        if isinstance(after, list):
            assert after != before, f"{mode} passes over {option}"
            used.append(name)
        else:
            assert "\n" not in str(after)
            refused.append(name)
    expected = {
        "fit --plan": {"weight", "encoder", "hold_out", "topics", "joints", "kd"},
        "fit --stands": {"hold_out", "topics", "joints", "kd", "degrees", "both_sides"},
        "fit --log": {"weight", "encoder", "degrees", "both_sides"},
    }
    assert expected.get(mode, set()) <= set(refused)
    if mode.startswith("fit"):
        assert {"priors", "kp", "output", "json_path", "report_path", "everything"} <= set(used)


def test_the_refusal_names_the_option_and_whose_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    told = typed(("fit", "v3", "--plan", "2", "--weight", "3kg"), monkeypatch)
    assert str(told) == (
        "--weight: it does nothing with --plan, it is of --stands; leave one of the two out"
    )
    told = typed(("fit", "v3", "--plan", "2", "--degrees"), monkeypatch)
    assert "as in -o plan.csv" in str(told)


def test_defaults_are_not_typed_and_new_options_are_refused() -> None:
    @click.command()
    @click.option("--mode", is_flag=True)
    @click.option("--new", default="x")
    def command(mode: bool, new: str) -> None:
        refuse_unused("--mode", {"--mode": {"mode"}})

    command.main(args=["--mode"], standalone_mode=False)
    with pytest.raises(ConfigurationError, match="--new: it does nothing with --mode"):
        command.main(args=["--mode", "--new", "x"], standalone_mode=False)
