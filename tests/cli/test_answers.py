"""Answers of all commands for robots of others: short lines, and next commands that run.

Line 1 is the verdict with the requested number, line 2 the limit or cause, line 3 the next command.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import pytest

from pupper_analysis import cli
from pupper_analysis.present.document import MAX_ANSWER_WIDTH
from tests.robots.test_real_robots import LAB, URDF, file
from tests.support.commands import Answer, answer
from tests.support.every_command import share_robots
from tests.support.shared_rollouts import share_rollouts

ROBOTS = {
    "v3": None,
    "go2": (URDF, "go2_description/urdf/go2.urdf"),
    "panda": (URDF, "panda_description/urdf/panda.urdf"),
    "yam": (LAB, "i2rt_yam/xmls/yam.xml"),
}
"""{name: package and file of a robot}: a variant, a URDF without servos, an arm as URDF, and an arm
as MJCF without motor limits."""

COMMANDS = [
    "audit {robot}", "convert {robot} -o {new}", "crosscheck {pair}", "sync {pair}",
    "diff {robot} {edited}", "check --init", "check", "contract {pair} --no-stand",
    "stand {robot}", "hold {robot}", "workspace {robot}", "payload {robot}",
    "push {robot} --directions 4 --resolution 1", "best utilisation {robot}", "path {robot}",
    "gains {robot}", "heat {robot} --motor mit-mini-cheetah", "analyze {robot} --no-figures",
    "study study.toml -o study", "fit {robot} --plan 3 -o plan.csv",
    "fit {robot} --record plan.csv --bridge mujoco:2 -o stands.csv",
    "fit {robot} --stands stands.csv", "walk {robot} --policy policy.json",
]  # fmt: skip
"""Command lines, in an order in which later lines read files of earlier lines."""

NOT_RUN = {"live", "study", "--bridge"}
"""Words of next commands that only click parses: live does not end, --bridge asks for readings, and
a study with further options computes the same designs."""

_FOLDER_PATTERN = re.compile(r"(?<![\w.])(?:\.\.)?/(?:[^/\s:;,']+/)+")
"""Folders of a path in a line."""


@pytest.fixture(autouse=True)
def simulate_once() -> Iterator[None]:
    """Prepare each robot and simulate each rollout once for all commands."""
    with share_robots(), share_rollouts():
        yield


def list_lines(found: Answer) -> list[str]:
    """Return the first three lines of an answer, without the folders of paths."""
    refused = [line for line in found.stderr.splitlines() if line.startswith(("error:", "  next:"))]
    printed = [line for line in found.stdout.splitlines() if line.strip()]
    return [_FOLDER_PATTERN.sub("", line) for line in (printed or refused)[:3]]


@pytest.mark.slow
@pytest.mark.parametrize("name", ROBOTS)
def test_answers_are_short_and_their_next_commands_are_accepted(name: str, tmp_path: Path) -> None:
    """References: the width of the terminal output, and the exit status of the next command."""
    place = ROBOTS[name]
    model = "v3" if place is None else str(file(*place))
    suffix = ".urdf" if place is None else Path(model).suffix
    words = {
        "robot": shlex.quote(model),
        "new": "new.xml" if suffix == ".urdf" else "new.urdf",
        "edited": "v3-heavy" if place is None else f"edited{suffix}",
    }
    words["pair"] = "v3" if place is None else f"{words['robot']} {words['new']}"
    if place is not None:
        text = Path(model).read_text()
        edited = re.sub(r'(mass(?: value)?=")([\d.]+)', r"\g<1>9\2", text, count=1)
        (tmp_path / words["edited"]).write_text(edited)
    (tmp_path / "study.toml").write_text(
        f'robot = "{model}"\nmeasure = ["peak_utilisation"]\n[vary]\npayload = [0.0, 0.1]\n'
    )
    answers: dict[str, Answer] = {}
    steps: dict[str, str] = {}
    for line in COMMANDS:
        typed = line.format(**words)
        found = answers[typed] = answer(*shlex.split(typed), folder=tmp_path)
        assert found.returncode in (0, 1) or found.stderr.startswith("error: "), (typed, found)
        for printed in list_lines(found):
            is_command = printed.startswith("  next:")
            assert is_command or len(printed) <= MAX_ANSWER_WIDTH, (typed, printed)
        proposed = re.findall(r"^ *next: pupper-analysis (.+)$", found.stdout + found.stderr, re.M)
        assert len(proposed) <= 1, (typed, proposed)
        if "policy.json" not in typed and "edited" not in typed:
            assert proposed, (typed, found)
        steps |= dict.fromkeys(proposed, typed)
    for step, typed in steps.items():
        command, *options = shlex.split(step)
        if step in answers or "motion.csv" in options:  # the file of a log is an example
            continue
        if NOT_RUN & {command, *options}:
            cli.find_command(command).make_context(command, options).close()
            continue
        found = answer(command, *options, folder=tmp_path)
        assert found.returncode in (0, 1), (typed, step, found.stderr)
