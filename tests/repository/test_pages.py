"""Each code block of the documentation and each example of `--help` runs and prints the stated
output.
"""

from __future__ import annotations

import pickle
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import pupper_analysis as pa
from pupper_analysis import cli
from tests.support import pages
from tests.support.repository import ROOT
from tests.support.shared_rollouts import share_rollouts
from tests.support.variants import share_variants

BLOCKS = {path.relative_to(ROOT).as_posix(): pages.blocks_of(path) for path in pages.pages()}
BLOCKS |= {f"{name} --help": pages.blocks_of_help(name) for name in cli.COMMAND_NAMES}
BLOCKS = {name: found for name, found in BLOCKS.items() if found}


@pytest.fixture(scope="module", autouse=True)
def simulate_once() -> Iterator[None]:
    """Simulate each rollout once: most pages simulate the nominal stand of Pupper v3."""
    with share_rollouts(), share_variants():
        yield


@pytest.mark.slow
@pytest.mark.parametrize("name", BLOCKS)
def test_blocks_of_a_page_run_and_print_the_stated_output(name: str, tmp_path: Path) -> None:
    if any("| jq" in block.text for block in BLOCKS[name]) and not shutil.which("jq"):
        pytest.skip("jq is not installed")
    pages.run_page(BLOCKS[name], tmp_path)


@pytest.mark.slow
def test_tasks_of_the_table_for_users_of_pinocchio_run(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Pictures are drawn in other tests. Reference of the mass matrix: raw ``pin.crba``."""
    monkeypatch.chdir(ROOT)
    page = (ROOT / "docs/how-to/pinocchio.md").read_text()
    scope: dict[str, Any] = {"pickle": pickle}
    exec(re.findall(r"```python\n(.*?)```", page, re.S)[0], scope)
    rows = re.findall(r"^\| (?!task|---)(.+?) \| (.+) \|$", page, re.M)
    assert len(rows) == 15
    for task, cell in rows:
        for code in re.findall(r"`([^`]+)`", cell):
            if not task.startswith("plot"):
                exec(code, scope)
    robot, mapping = scope["robot"], scope["T"]
    upper = np.triu(pin.crba(robot.pin_model, robot.pin_data(), scope["q"]))
    inertia = upper + np.triu(upper, 1).T
    np.testing.assert_allclose(
        mapping @ scope["config"].mass_matrix() @ mapping.T, inertia, atol=1e-12
    )


@pytest.mark.slow
def test_page_of_the_guide_to_reports_has_a_3d_view(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The page of `stand`: the page of `pa.verify_stand` alone is a table of fields."""
    monkeypatch.chdir(tmp_path)
    page = (ROOT / "docs/how-to/report.md").read_text("utf-8")
    (example,) = re.findall(r"```python\n(.*?)```", page, re.S)
    exec(example, {"pa": pa})
    assert 'class="scene"' in (tmp_path / "stand.html").read_text("utf-8")


def test_blocks_that_are_not_run_need_a_network_or_another_program() -> None:
    left = {line for found in BLOCKS.values() for block in found for line in block.left}
    unreachable = (
        "pip install",
        "make ",
        "source ",
        "robot_descriptions",
        "python",
        "--bridge ros2",
        "g1.xml",
        "tcp://host",
        "dask scheduler",
        "deploy.yaml",
    )
    assert all(any(words in line for words in unreachable) for line in left), left


@pytest.mark.parametrize("pattern", pages.SHORTER_SEARCHES)
def test_each_shorter_search_is_of_a_page(pattern: str) -> None:
    """A pattern that no page contains any more has no effect: its page runs the long search."""
    texts = (block.text for found in BLOCKS.values() for block in found)
    lines = (line for text in texts for line in text.replace("\\\n", " ").splitlines())
    assert any(re.search(pattern, line.partition("  #")[0].strip()) for line in lines)


def test_wrong_output_and_exit_status_of_a_block_are_found(tmp_path: Path) -> None:
    """The example of the pages is checked only if a wrong number and a wrong status fail."""
    block = pages.Block(
        "page", 1, "python", "print('height 0.1315 m')\n", output=["height ... m\n"]
    )
    assert pages.run_page([block], tmp_path) == {"python": 1}
    for wrong in ("height 0.1316 m", "height 0.13", "0.1315 m"):  # the last are parts of the line
        block.output = [f"{wrong}\n"]
        with pytest.raises(AssertionError, match=re.escape(f"does not print ['{wrong}']")):
            pages.run_page([block], tmp_path)
    exits = pages.Block("page", 1, "sh", "pupper-analysis nothing  # exits 2\nfalse\n")
    with pytest.raises(AssertionError, match="exit status 1, not 0"):
        pages.run_page([exits], tmp_path)
