"""Modes of commands: what is typed is used, or refused by name; nothing is passed over."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Any

import click
import pytest

from pupper_analysis.base.errors import ConfigurationError, PupperAnalysisError
from pupper_analysis.base.runs import current_run
from pupper_analysis.cli import COMMANDS, find_command
from pupper_analysis.cli.modes import refuse_unused
from pupper_analysis.cli.robots import RobotOptions
from pupper_analysis.cli.shared import Command
from pupper_analysis.cli.stance_fields import TYPED
from tests.support.commands import answer
from tests.support.repository import ROOT

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
            self.noted.append(f"{name}{[_noted(word) for word in words]}{sorted(given.items())}")
            return result

        return call


def _noted(word: object) -> object:
    """What a function learns of an argument: of a context, where what is written goes, and how."""
    if not isinstance(word, click.Context):
        return word
    run, command = current_run(), word.command
    assert run is not None
    assert isinstance(command, Command)
    return run.force, [word.params.get(str(one.name)) for one in command.outputs]


def calls(patch: pytest.MonkeyPatch) -> _Calls:
    """Lets commands call nothing that takes long, and notes what they call."""
    from contextlib import nullcontext
    from types import SimpleNamespace

    noted, robot = _Calls(), SimpleNamespace(name="robot")
    fit, shared = "pupper_analysis.tools.fit.command", "pupper_analysis.cli.shared"
    of_fit = "pupper_analysis.tools.fit"
    for name, result in {
        f"{fit}.robot_from": robot,
        f"{fit}.parse_gain": None,
        f"{fit}.print_notes": None,
        f"{shared}._check_outputs": None,
        f"{shared}.show_results": None,
        f"{shared}.show_progress": nullcontext(),
        f"{shared}.write_page": None,
        f"{shared}.confirm_written": None,
        f"{shared}.finish_command": None,
        f"{of_fit}.fit.fit": "a fit",
        f"{of_fit}.stands.plan.plan_stands": "a plan",
        f"{of_fit}.stands.plan.write_plan": None,
        f"{of_fit}.measurements.stands.read_stands": "stands",
        f"{of_fit}.measurements.log.read_log": "a log",
        "pupper_analysis.tools.analyze.command._print_list": None,
        "pupper_analysis.tools.audit.command._list_rules": None,
        "pupper_analysis.tools.check.command._begin": None,
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
        "fit --stands": {"hold_out", "topics", "joints", "kd", "degrees"},
        "fit --log": {"weight", "encoder", "degrees"},
    }
    assert expected.get(mode, set()) <= set(refused)
    if mode.startswith("fit"):
        assert {"priors", "kp", "output", "json_path", "report_path", "everything"} <= set(used)


def test_the_refusal_names_the_option_and_whose_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    message = typed(("fit", "v3", "--plan", "2", "--weight", "3kg"), monkeypatch)
    assert str(message) == (
        "--weight: it does nothing with --plan, it is of --stands; leave one of the two out"
    )
    message = typed(("fit", "v3", "--plan", "2", "--degrees"), monkeypatch)
    assert "as in -o plan.csv" in str(message)


def test_defaults_are_not_typed_and_new_options_are_refused() -> None:
    @click.command()
    @click.option("--mode", is_flag=True)
    @click.option("--new", default="x")
    def command(mode: bool, new: str) -> None:
        refuse_unused("--mode", {"--mode": {"mode"}})

    command.main(args=["--mode"], standalone_mode=False)
    with pytest.raises(ConfigurationError, match="--new: it does nothing with --mode"):
        command.main(args=["--mode", "--new", "x"], standalone_mode=False)


V3 = (str(ROOT / "urdf/pupper_v3.urdf"), str(ROOT / "mjcf/pupper_v3.xml"))
STUDY = ("study", "study.toml", "-o", "out")
_IDLE: dict[tuple[str, ...], tuple[tuple[str, ...], ...]] = {
    ("analyze", "v3", "--no-figures"): (("-o", "out"),),
    ("analyze", "v3", "--format", "markdown"): (("-q",),),
    ("stand", "v3"): (("--as-is",), ("--payload-at", "0,0,1cm")),
    ("stand", "--leg-scale", "1.1"): (("--as-is",),),
    ("workspace", "v3"): (("--as-is",), ("--payload-at", "0,0,1cm")),
    ("payload", "v3"): (("--as-is",),),
    ("path", "v3"): (("--as-is",), ("--payload-at", "0,0,1cm")),
    ("push", "v3", "v3-heavy"): (("--as-is",), ("--payload-at", "0,0,1cm")),
    ("hold", "v3"): (("--as-is",),),
    ("best", "margin", "v3"): (("--as-is",), ("--payload-at", "0,0,1cm")),
    ("best", "utilisation"): (("--payload-at", "0,0,1cm"),),
    ("sync", *V3): (("--take-absent",), ("--partial",), ("--backup",)),
    ("sync", *V3, "--take", "urdf", "--dry-run"): (("--backup",),),
    ("convert", V3[1], "-o", "new.urdf"): (
        *(("--foot", "FL"), ("--fixed-base",), ("--free-base",), ("--merge-fixed",)),
        *(("--armature", "1"), ("--sag", "1deg"), ("--damping-ratio", "1")),
        *(("--repair-inertia",), ("--copy-meshes",)),
    ),
    (*STUDY, "--dry-run"): (
        *(("--figures",), ("--report", "r.html")),
        *(("--minimise", "servo_sag"), ("--maximise", "servo_sag"), ("--write", "1")),
    ),
    ("walk", "v3", "--policy", "policy.json"): (("--fit", "fit.json"),),
    ("walk", "v3", "--policy", "policy.json", "--orders"): (
        *(("--command", "1,0,0"), ("--seeds", "2"), ("--vary", "mass"), ("--fit", "fit.json")),
    ),
    ("live", "v3", "--drop", "--headless"): (("--port", "1"), ("--fixed-base",)),
    ("live", "v3", "--mujoco", "--headless"): (("--seconds", "3"),),
    ("live", "v3", "--no-browser"): (("--headless",),),
    ("live", "arm.urdf", "--no-browser"): (("--stance", "height:120"),),
    ("check", "--init"): (("--config", "a.toml"),),
}
IDLE = {line: several for line, several in _IDLE.items() if line[0] in COMMANDS}
"""{command line: what does nothing in it}, besides the modes above."""

OUTPUT = {"json_path", "report_path", "figure", "output", "folder", "csv", "npz", "write_folder"}
LOOK = {"style", "everything", "force"}
SERVOS = {"kp", "kd", "integrator", "cone", "impratio"}
POLICY = {"policy", "contract", "asked", "seeds", "seconds"}
ALWAYS = {
    "stand": {"minimum_stiffness", "explain", "effort", "payload", *SERVOS},
    "workspace": {"effort", "payload"},
    "payload": {*POLICY, "payload_at", "continuous", "effort", "payload", *SERVOS},
    "best": {"effort", "payload", *SERVOS},
    "path": {"seconds", "effort", "payload", *SERVOS},
    "push": {*POLICY, "directions", "resolution", "effort", "payload", *SERVOS},
    "hold": {"positions", "tool", "effort", "payload", *SERVOS},
    "crosscheck": {"map_file", "changes", "strict", "any_coordinates", "same_mount"},
    "diff": {"changes"},
    "sync": {"take", "dry_run", "map_file", "fine", "changes"},
    "contract": {"pairs", "unstood", "fail_on"},
    "study": {"dry_run", "workers", "list_metrics"},
    "walk": {"policy", "contract", "asked", "seeds", "seconds", "vary", "orders"},
    "live": {
        "policy",
        "contract",
        "asked",
        "language",
        "host",
        "port",
        "no_browser",
        "viewer",
        "dropped",
    },
}
"""{command: options besides those of the robot, the stance and outputs that always matter}."""


@pytest.mark.parametrize("line", IDLE, ids=lambda line: " ".join(Path(one).name for one in line))
def test_what_does_nothing_is_refused_before_work(line: tuple[str, ...], tmp_path: Path) -> None:
    study = 'robot = "v3"\nmeasure = ["servo_sag"]\n[vary]\nkp = { values = [5] }\n'
    (tmp_path / "study.toml").write_text(study)
    (tmp_path / "arm.urdf").write_text(ARM)
    for more in IDLE[line]:
        given = answer(*line, *more, folder=tmp_path)
        assert (given.returncode, given.stdout) == (2, ""), (line, more, given)
        assert len(given.stderr.strip().splitlines()) == 1
        option = {"-o": "--output", "-q": "--quiet", "--free-base": "--fixed-base"}
        shown = option.get(more[0], more[0])
        assert given.stderr.startswith(f"error: {shown}: "), given
    assert {path.name for path in tmp_path.iterdir()} == {"study.toml", "arm.urdf"}


ARM = """<robot name="arm"><link name="base"/>
<link name="arm"><inertial><origin xyz="0.1 0 0"/><mass value="1"/>
<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="elbow" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1" effort="10" velocity="5"/></joint></robot>"""


def test_of_each_option_it_is_said_in_which_modes_it_does_something() -> None:
    """A new option is refused in each mode, or idle in some, or said to matter always."""
    robot = {one.name for one in fields(RobotOptions)}
    for name in COMMANDS:
        known = ALWAYS.get(name, set()) | OUTPUT | LOOK | robot | set(TYPED)
        for parameter in find_command(name).params:
            if not isinstance(parameter, click.Option) or not parameter.expose_value:
                continue
            by_mode = any(words[0] == name for words in MODES.values())
            idle = any(
                line[0] == name and any(more[0] in parameter.opts for more in several)
                for line, several in IDLE.items()
            )
            assert parameter.name in known or by_mode or idle, (name, parameter.opts)


def test_a_stance_of_a_file_may_say_more_than_a_command_uses(tmp_path: Path) -> None:
    (tmp_path / "stance.toml").write_text("payload-at = '0,0,1cm'\nkp = 20\nheight = '17cm'\n")
    given = answer("workspace", "v3", "--stance", "stance.toml", folder=tmp_path)
    assert given.returncode == 0, given
