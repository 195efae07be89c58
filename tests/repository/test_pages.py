"""Every block of the pages and every example of `--help` runs, and prints what its page says."""

from __future__ import annotations

from pathlib import Path

import pytest

from pupper_analysis import cli
from tests.support import pages
from tests.support.repository import ROOT

BLOCKS = {path.relative_to(ROOT).as_posix(): pages.blocks_of(path) for path in pages.pages()}
BLOCKS |= {f"{name} --help": pages.blocks_of_help(name) for name in cli.COMMANDS}
BLOCKS = {name: found for name, found in BLOCKS.items() if found}
LATE = [name for name, found in BLOCKS.items() if any(pages.late_lines(block) for block in found)]


@pytest.mark.slow
@pytest.mark.parametrize("name", BLOCKS)
def test_blocks_of_a_page_run_and_print_what_it_says(name: str, tmp_path: Path) -> None:
    pages.run_page(BLOCKS[name], tmp_path)


@pytest.mark.longest
@pytest.mark.parametrize("name", LATE)
def test_blocks_that_take_minutes_run(name: str, tmp_path: Path) -> None:
    pages.run_page(BLOCKS[name], tmp_path, late=True)


def test_few_blocks_are_run_nowhere() -> None:
    left = {line for found in BLOCKS.values() for block in found for line in block.left}
    unreachable = (
        "pip install",
        "make ",
        "source ",
        "robot_descriptions",
        "python",
        "--bridge ros2",
    )
    assert all(any(words in line for words in unreachable) for line in left), left


def test_a_wrong_number_or_status_of_a_page_is_found(tmp_path: Path) -> None:
    block = pages.Block(
        "page", 1, "python", "print('height 0.1315 m')\n", output=["height ... m\n"]
    )
    assert pages.run_page([block], tmp_path) == {"python": 1}
    block.output.append("height 0.1316 m\n")
    with pytest.raises(AssertionError, match=r"0\.1316"):
        pages.run_page([block], tmp_path)
    exits = pages.Block("page", 1, "sh", "pupper-analysis nothing  # exits 2\nfalse\n")
    with pytest.raises(AssertionError, match="exit status 1, not 0"):
        pages.run_page([exits], tmp_path)


def test_what_is_in_a_chinese_page_as_in_the_english_one_runs_once() -> None:
    page = ROOT / "docs/zh/how-to/stand.md"
    assert "pupper-analysis stand v3" in page.read_text()
    assert "pupper-analysis stand v3\n" not in "".join(b.text for b in pages.blocks_of(page))
