"""Stances in TOML files and options: both give the same task, and invalid entries are refused by
name.
"""

from __future__ import annotations

import math
from pathlib import Path

import click
import pytest

from pupper_analysis import Contact, Ground, Plane, StandTask, Weld
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.base.results import to_json
from pupper_analysis.cli.stance_options import RobotAndTask, robot_and_task
from pupper_analysis.stance.stance_file import format_stance
from tests.support.commands import check_refusal


def parse_options(*arguments: str) -> RobotAndTask:
    """Return the options of a stance that a command line specifies."""
    messages: list[RobotAndTask] = []

    @click.command()
    @robot_and_task
    def command(asked: RobotAndTask) -> None:
        messages.append(asked)

    command.main(args=list(arguments), standalone_mode=False)
    return messages[0]


def test_stance_file_gives_the_task_of_its_entries(tmp_path: Path) -> None:
    file = tmp_path / "crouch.toml"
    file.write_text(
        'height = "11cm"\npitch = 0.05\ncom = [0.01, -0.002]\ncom_margin = "5mm"\nslope = "10deg"\n'
        'swing.FL = "2cm"\nmove = { RL = ["-1cm", 0.02] }\nkp = 20\nkd = { "*_3" = 0.5 }\n'
        "payload = 1\n"
    )
    found = parse_options("--stance", str(file))
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


@pytest.mark.parametrize("given", ['contact = ["FL=wall:1m"]', 'swing = "FL"', "posture = 3"])
def test_list_in_place_of_a_table_is_refused_with_the_valid_form(
    tmp_path: Path, given: str
) -> None:
    file, name = tmp_path / "stance.toml", given.split(" ")[0]
    file.write_text(given)
    with pytest.raises(ConfigurationError, match=rf'is not of the form {name}\."[^"]+" = "'):
        parse_options("--stance", str(file))


def test_options_with_other_units_give_the_same_task() -> None:
    """Reference: 0.1 rad = 18/pi deg, in SI units without a unit."""
    si_units = ("--pitch", "0.1", "--height", "0.14", "--swing", "FL=0.01", "--offset", "0.01,0")
    others = ("--pitch", f"{math.degrees(0.1)}deg", "--height", "14cm", "--swing", "FL=10mm",
              "--offset", "1cm,0")  # fmt: skip
    tasks = [parse_options(*words).task() for words in (si_units, others)]
    expected = {"pitch": 0.1, "height": 0.14, "swing": {"FL": 0.01}, "offset": (0.01, 0.0)}
    for task in tasks:
        for field, value in expected.items():
            assert getattr(task, field) == pytest.approx(value, rel=1e-12), field


def test_results_as_json_give_the_task_of_their_stand(tmp_path: Path) -> None:
    """Reference: the task that `to_json` has written."""
    task = StandTask(
        height=0.11,
        pitch=0.0123456789,
        com=(0.01, -0.002),
        com_margin=0.005,
        swing={"FL": 0.02},
        foot_offsets={"RL": (-0.01, 0.02)},
        contacts={"FR": Contact(Plane((0.4, 0, 0), (-1, 0, 0), 0.6)), "base": Weld()},
        posture={"*elbow*": 0.3},
        ground=Ground(slope=0.1, heights={"RR": 0.01}),
    )
    file = tmp_path / "best.json"
    stands = {"stand": {"task": task}, "nominal": {"stand": {"task": StandTask(height=1.0)}}}
    file.write_text(to_json({"best": stands}))
    assert parse_options("--stance", str(file)).task() == task
    assert parse_options("--stance", str(file), "--height", "12cm").task().height == 0.12


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ('{"a": 1}', "contains no stance"),
        ('{"a": ', "not valid JSON"),
        ('{"stand": {"task": {"height": 0.1, "feet": {"FL": [0.1, 0.1]}}}}', "'feet', for which"),
        ('{"stand": {"task": {"height": "x"}}}', "height"),
    ],
)
def test_results_without_a_readable_stance_are_refused(
    content: str, message: str, capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    file = tmp_path / "results.json"
    file.write_text(content)
    check_refusal(capfd, tmp_path, ["stand", "v3", "--stance", str(file)], message)


def test_options_take_precedence_over_the_stance_file(tmp_path: Path) -> None:
    file = tmp_path / "crouch.toml"
    file.write_text("height = 0.11\nroll = 0.1\n")
    for arguments in (
        ["--stance", str(file), "--roll", "0.2"],
        ["--roll", "0.2", "--stance", str(file)],
    ):
        assert parse_options(*arguments).task() == StandTask(height=0.11, roll=0.2)
    assert parse_options().task() == StandTask()


@pytest.mark.parametrize(
    ("typed", "message"),
    [
        ("FL=wall", "for example wall:0.4m"),
        ("FL=door:1m", "is not of the form"),
        ("FL=wall:0.4m,mu=-1", "friction: -1.0 is not between 0 and"),
        ("FL=wall:0.4m,mu=slippery", "'slippery' in"),
        ("FL=wall:0.4m,foo=1", "'foo' is unknown; valid: 'mu', 'place', 'offset', 'radius'"),
        ("FL=plane:0,0,0,1", "is not of the form"),
        ("FL=plane:0,0,0,0,0,0", "is not a direction"),
        ("FL=table:1cm,radius=0", "radius: 0 is not more than 0"),
        ("FL=bar:0,0,0,0,1,0,0", "bar.radius: 0 is not more than 0"),
        ("FL=bar:0,0,0,0,0,0,1cm", "bar.direction: "),
        ("FL=bar:0,0,0,0,1,0,1cm,mu=-1", "bar.friction: -1.0 is not between 0 and"),
        ("FL=slope:5deg,mu=-1", "slope.friction: -1.0 is not between 0 and"),
        ("FL=bar:0,0,nan,0,1,0,1cm", "bar.point: element 2 is nan"),
        ("FL=table:1cm,grip=-1N", "grip: -1 is not more than 0"),
        ("FL=table:1cm,grip=", "is not a valid force"),
        ("FL=table:1cm,grip=60lbf", "is not a valid force"),
        ("FL=table:1cm,grip=9N,force=3N", "either a grip or a force"),
        ("FL=weld,grip=9N", "'grip' is unknown; valid: 'place', 'offset'"),
    ],
)
def test_invalid_contact_is_refused_in_one_line(typed: str, message: str) -> None:
    with pytest.raises(ConfigurationError) as refused:
        parse_options("--contact", typed).task()
    assert refused.value.field == "contact"
    assert message in str(refused.value)
    assert "\n" not in str(refused.value)


def test_contacts_are_typed_and_written_into_files(tmp_path: Path) -> None:
    """Reference: the task whose contacts are typed, and written by `format_stance`."""
    task = StandTask(
        contacts={
            "FL": Contact(Plane((0.4, 0, 0), (-1, 0, 0), 0.6)),
            "hand": Contact(Plane((0.1, 0.2, 0.3), (0, 0.6, 0.8)), (0.1, 0.2, 0.4), (0.05, 0, 0)),
        }
    )
    typed = [
        "FL=wall:40cm,mu=0.6",
        "hand=plane:0.1,0.2,30cm,0,3,4,place=0.1/0.2/0.4,offset=5cm/0/0",
    ]
    assert (
        parse_options(*(part for contact in typed for part in ("--contact", contact))).task()
        == task
    )
    file = tmp_path / "lean.toml"
    file.write_text(format_stance(task))
    assert parse_options("--stance", str(file)).task() == task
    with pytest.raises(ConfigurationError, match="two contacts are given for FL"):
        parse_options("--contact", typed[0], "--contact", "FL=table:1cm").task()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("hight = 3", "a stance has no option 'hight'; did you mean height?"),
        ("height = true", "height: give a number"),
        ("height = '3parsec'", "is not a valid length"),
        ("height = ", "not a TOML file"),
        (None, "there is no such file"),
    ],
)
def test_invalid_stance_file_is_refused_in_one_line(
    capfd: pytest.CaptureFixture[str], tmp_path: Path, text: str | None, message: str
) -> None:
    file = tmp_path / "bad.toml"
    if text is not None:
        file.write_text(text)
    check_refusal(capfd, tmp_path, ["stand", "v3", "--stance", str(file)], message)
