"""No command reports more favourably on a file than bare MuJoCo; see
``tests.support.every_command``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from tests.prepare.test_planted import ODD
from tests.support import arm_features, every_command
from tests.support.every_command import COMMANDS, FILES, Truth
from tests.support.shared_rollouts import share_rollouts

EDITS = dict(every_command.list_edits())

KINDS = (
    "as it is",
    "inertiafromgeom",
    "kp 15",
    "an exclude of a foot",
    "kp -150 at a knee",
    "slip: kp is ten times",
    "motors",
    "a keyframe without ctrl",
    "inertiafromgeom and discardvisual",
)
"""One edit for each pair of outcome in MuJoCo and reason of a verdict that does not pass."""

KINDS_LAST = sorted(EDITS, key=KINDS.__contains__)
"""Names of all edits in the order of the tests: the robots of `KINDS` are used again later."""

SURELY = {
    "as it is": Truth.STANDS,
    "kp -150 at a knee": Truth.FALLS,
    "no actuation": Truth.FALLS,
    "slip: kp is ten times": Truth.SHAKES,
    "a keyframe without ctrl": Truth.UNTOLD,
    "motors": Truth.LIMP,
}


@pytest.fixture(scope="module")
def find_folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[[str], Path]]:
    """Return the folder of an edit. All commands on an edit share its robot and rollouts."""
    folders = {name: tmp_path_factory.mktemp("edit") for name in EDITS}
    with every_command.share_robots(), share_rollouts():
        yield folders.__getitem__


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in KINDS_LAST if name not in ODD])
def test_no_verdict_is_better_than_bare_mujoco(
    name: str, find_folder: Callable[[str], Path]
) -> None:
    """``judge_stand`` forms the verdict of each command; the reference is ``mj_step`` alone.

    tests/prepare/test_planted.py compares the edits in ``ODD`` with the same reference.
    """
    row = every_command.make_row(name, EDITS[name], find_folder(name), ("python",))
    assert row.cells.keys() == {"python"}
    assert not row.wrong, row.cells["python"].word


def test_report_that_is_better_than_the_simulation_has_an_objection() -> None:
    """Control of the comparison: a passing report about each outcome of a simulation."""
    good = every_command.Cell(
        passed=True, refused=False, keyframe_run=True, added=False, word="HOLDS"
    )
    for truth in (Truth.FALLS, Truth.SHAKES, Truth.LIMP, Truth.REFUSED):
        assert good.find_objection(truth), truth
    assert not good.find_objection(Truth.STANDS)
    assert replace(good, passed=False, keyframe_run=False).find_objection(Truth.FALLS)
    assert not replace(good, refused=True).find_objection(Truth.FALLS)


SEARCHES = {"best", "payload", "path"}
"""Commands that need 2 to 6 s of processor per file."""

OUTCOMES = {
    "kp 15",
    "kp -150 at a knee",
    "slip: kp is ten times",
    "motors",
    "a keyframe without ctrl",
}
"""Edits whose robot falls in MuJoCo, one for each outcome and one with weak servos. A search
command that ignored the verdict of the file would accept them.
"""

PAIRS = [(name, command) for name in KINDS for command in COMMANDS
         if command not in SEARCHES or name in OUTCOMES]  # fmt: skip
PAIRS += [("a keyframe's ctrl of zeros", command) for command in sorted(SEARCHES)]
"""With this edit the file falls in MuJoCo, and stands with the commands of the package: a search
that ignores the verdict, but not its own simulations, would pass it."""
PAIRS += [("one iteration", "study")]
"""With this edit the file shakes: the linearised step has growing modes that no simulation
confirms, and a metric that uses the linearised step alone would pass it."""


@pytest.mark.slow
@pytest.mark.parametrize(("name", "command"), PAIRS)
def test_no_command_is_better_than_bare_mujoco(
    name: str, command: str, find_folder: Callable[[str], Path]
) -> None:
    """``tests.explore`` draws pairs of the other edits and commands at random."""
    row = every_command.make_row(name, EDITS[name], find_folder(name), (command,))
    assert not row.wrong, row.cells[command].word


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        "as it is", "discardvisual", "inertiafromgeom", "kp -150 at a knee", "no actuation",
        "joint stiffness", "welded to the world", "kp 15", "timestep 10", "slip: kp is ten times",
    ],
)  # fmt: skip
def test_no_converted_file_is_better_than_bare_mujoco(
    name: str, find_folder: Callable[[str], Path]
) -> None:
    """``convert`` there and back, and a stance on a slope with a payload, which a file states."""
    row = every_command.make_row(name, EDITS[name], find_folder(name), FILES)
    assert row.cells.keys() == FILES.keys()
    assert not row.wrong, {column: row.cells[column].word for column in row.wrong}


@pytest.mark.slow
@pytest.mark.parametrize("name", arm_features.FEATURES)
def test_no_verdict_of_an_arm_is_better_than_bare_mujoco(name: str, tmp_path: Path) -> None:
    """Reference: simulation of the unmodified arm."""
    row = every_command.make_arm_row(name, tmp_path)
    assert row.cells.keys() == every_command.HELD.keys()
    assert not row.wrong, {column: row.cells[column].word for column in row.wrong}


ARMS = {
    "as it is": Truth.STANDS,
    "kp 0 at a joint": Truth.FALLS,
    "a bias of 500": Truth.FALLS,
    "kp a thousandfold": Truth.FALLS,
    "gear 2": Truth.ELSEWHERE,
    "a loose joint": Truth.SHAKES,
    "a keyframe without ctrl": Truth.UNTOLD,
    "motors": Truth.LIMP,
}


@pytest.mark.parametrize("name", ARMS)
def test_expected_outcome_of_an_unmodified_arm_equals_bare_mujoco(
    name: str, tmp_path: Path
) -> None:
    """Control of the reference: outcomes of the edits in ARMS, derived by hand."""
    _, mjcf = arm_features.files(tmp_path, arm_features.FEATURES[name])
    assert every_command.simulate_arm_truth(mjcf) is ARMS[name]


@pytest.mark.slow
def test_state_that_mujoco_resets_in_the_first_step_passes_no_command(tmp_path: Path) -> None:
    """A keyframe's ctrl of 1e9: MuJoCo begins anew at once, commanded nothing, and stands."""
    name = "a keyframe's ctrl 1e9"
    commands = COMMANDS.keys() & {"push", "study", "python"}
    row = every_command.make_row(name, EDITS[name], tmp_path, commands)
    assert row.truth is Truth.FALLS
    assert not row.wrong
    assert not any(cell.passed or cell.refused for cell in row.cells.values())


@pytest.mark.slow
def test_knee_with_a_gain_of_the_wrong_sign_passes_in_no_command(tmp_path: Path) -> None:
    name = "slip: kp of one has the wrong sign"
    row = every_command.make_row(name, EDITS[name], tmp_path, ("stand", "study"))
    assert row.truth is Truth.FALLS
    assert not row.wrong
    assert not any(cell.passed or cell.refused for cell in row.cells.values())


@pytest.mark.parametrize("name", SURELY)
def test_expected_outcome_of_an_unmodified_file_equals_bare_mujoco(
    name: str, tmp_path: Path
) -> None:
    """Control of the reference: outcomes of six edits, derived by hand."""
    assert every_command.make_row(name, EDITS[name], tmp_path, ()).truth is SURELY[name]
