"""Every block of the pages and every example of `--help` runs, and prints what its page says."""

from __future__ import annotations

from pathlib import Path

import pytest

from pupper_analysis import cli
from tests.support import pages
from tests.support.repository import ROOT

PAGES = {path.relative_to(ROOT).as_posix(): path for path in pages.pages() if pages.blocks_of(path)}
EXAMPLES = [name for name in cli.COMMANDS if pages.blocks_of_help(name)]


@pytest.mark.slow
@pytest.mark.parametrize("name", PAGES)
def test_blocks_of_a_page_run_and_print_what_it_says(name: str, tmp_path: Path) -> None:
    pages.run_page(pages.blocks_of(PAGES[name]), tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("name", EXAMPLES)
def test_examples_of_help_run(name: str, tmp_path: Path) -> None:
    pages.run_page(pages.blocks_of_help(name), tmp_path)


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


def test_a_block_that_is_not_run_says_why(tmp_path: Path) -> None:
    page = ROOT / "docs/how-to/live.md"
    (block,) = [one for one in pages.blocks_of(page) if one.language == "sh"][:1]
    assert all(block.left.values())
