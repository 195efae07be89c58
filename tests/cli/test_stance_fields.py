from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import click
import pytest

from pupper_analysis import Ground, StandTask
from pupper_analysis.cli.shared import parse_place
from pupper_analysis.cli.stance_fields import task_of
from pupper_analysis.cli.stance_options import RobotAndTask, robot_and_task
from pupper_analysis.tools.live.export import write_stance_file
from pupper_analysis.tools.live.state import State
from tests.support.commands import check_refusal


def asked(*arguments: str) -> RobotAndTask:
    """What a command of stances is told."""
    messages: list[RobotAndTask] = []

    @click.command()
    @robot_and_task
    def command(asked: RobotAndTask) -> None:
        messages.append(asked)

    command.main(args=list(arguments), standalone_mode=False)
    return messages[0]


def test_a_file_says_what_options_say(tmp_path: Path) -> None:
    file = tmp_path / "crouch.toml"
    file.write_text(
        'height = "11cm"\npitch = 0.05\ncom = [0.01, -0.002]\ncom_margin = "5mm"\nslope = "10deg"\n'
        'swing.FL = "2cm"\nmove = { RL = ["-1cm", 0.02] }\nkp = 20\nkd = { "*_3" = 0.5 }\n'
        "payload = 1\n"
    )
    found = asked("--stance", str(file))
    assert found.task() == StandTask(
        height=0.11,
        pitch=0.05,
        com=(0.01, -0.002),
        com_margin=0.005,
        swing={"FL": 0.02},
        foot_offsets={"RL": (-0.01, 0.02)},
        ground=Ground(slope=math.radians(10)),
    )
    assert (found.kp, found.kd, found.payload) == (("20",), ("*_3=0.5",), 1.0)


def test_what_is_typed_goes_first(tmp_path: Path) -> None:
    file = tmp_path / "crouch.toml"
    file.write_text("height = 0.11\nroll = 0.1\n")
    for arguments in (
        ["--stance", str(file), "--roll", "0.2"],
        ["--roll", "0.2", "--stance", str(file)],
    ):
        assert asked(*arguments).task() == StandTask(height=0.11, roll=0.2)
    assert asked().task() == StandTask()


@pytest.mark.parametrize(
    "values",
    [
        {"height": 120.0, "roll": 5.0, "swing": {"FL": 20.0}},
        {"place": "inside", "heights": {"RR": 4.0}, "slope": 3.0, "uphill": 90.0},
        {"place": "offset", "offset": (4.0, -3.0), "payload": 1.5, "payload_at": (0.0, 0.0, 80.0)},
        {"kp": 20.0, "kd": 0.5},
        {
            "posture": {"*elbow*": -0.5, "neck": 0.0},
            "payload": 1.0,
            "payload_at": ("hand", 0, 0, 5),
        },
    ],
)
def test_the_pages_file_is_the_pages_stance(tmp_path: Path, values: dict[str, Any]) -> None:
    state, file = State(**values), tmp_path / "page.toml"
    file.write_text(write_stance_file(state))
    found = asked("--stance", str(file))
    assert task_of(found.stance) == state.task()
    assert found.payload == state.payload
    if state.payload:
        assert parse_place("payload-at", found.payload_at or "") == state.payload_point()
    gains = [(), ()] if state.kp is None else [("20.0",), ("0.5",)]
    assert [found.kp, found.kd] == gains


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("hight = 3", "it has no option 'hight'"),
        ("height = true", "height: give a number"),
        ("height = '3parsec'", "is no length"),
        ("height = ", "not a TOML file"),
        (None, "there is no such file"),
    ],
)
def test_bad_files_are_one_line_and_exit_status_2(
    capfd: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    text: str | None,
    message: str,
) -> None:
    folder, file = tmp_path / "empty", tmp_path / "bad.toml"
    folder.mkdir()
    monkeypatch.chdir(folder)
    if text is not None:
        file.write_text(text)
    check_refusal(capfd, folder, ["stand", "v3", "--stance", str(file)], message)
