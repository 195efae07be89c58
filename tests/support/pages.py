"""Run the shell and Python blocks of documentation pages and of ``--help``, and compare the output.

A block that cannot run is marked in the page: ``<!-- not run: REASON -->`` on the line above the
block. ``<!-- not run 'WORDS': REASON -->`` excludes only the lines with these words. A block of a
Chinese page is skipped if the English page contains the block with the same output. A command must
exit with 1 if the line ends with ``# exits 1``. The text block below a block contains the output:
each line must equal a printed line, with any text for ``...``. ``own_files.py`` writes the files of
the reader.
"""

from __future__ import annotations

import contextlib
import io
import os
import re
import shlex
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from unittest import mock
from urllib.request import urlopen

import mujoco
import mujoco.viewer

import pupper_analysis as pa
from pupper_analysis import cli
from tests.support import own_files
from tests.support.commands import Answer, answer
from tests.support.patience import PATIENCE
from tests.support.repository import ROOT

FOLDERS = ("docs/how-to", "docs/tutorials", "docs/explanation", "docs/zh", "docs/zh/how-to")
"""Folders whose pages are run completely, in addition to the README."""

NEVER = {
    "pip install": "it needs the network",
    "--bridge ros2": "it needs a robot's own computer",
    "tcp://host": "it needs a cluster",
    "dask scheduler": "it runs until it is stopped",
    "deploy.yaml": "it needs the deployment of a robot",
    "g1.xml policy.onnx --init": "it needs the policy of a robot",
}
"""{words: reason} of lines that are run on no page."""

HELP_EXITS = {"longer.urdf": 1, "mjcf:effort": 1, "diff v3 v3-heavy": 1}
"""{words: exit status} of the ``--help`` examples that do not exit with 0."""

POLICY_EXITS = {"--response": 1}
"""{words: exit status} of commands for which the policy of the tests ignores slow commands."""

SPEED = "0.13,0,0"
"""Commanded velocity that the policy of the tests tracks: m/s, m/s, rad/s."""


@dataclass
class Block:
    """Block of shell commands or Python of a page.

    Attributes:
        page: Path of the page from the repository's root; ``NAME --help`` for a command's help.
        line: Line of the opening fence.
        language: ``sh`` or ``python``.
        text: Content.
        marks: {words of the lines that are not run (empty: all): reason}.
        exits: {words of the lines with an exit status other than 0: status}.
        output: Text blocks below this block, in order.
    """

    page: str
    line: int
    language: str
    text: str
    marks: dict[str, str] = field(default_factory=dict)
    exits: dict[str, int] = field(default_factory=dict)
    output: list[str] = field(default_factory=list)

    def reason(self, line: str = "") -> str:
        """Return the reason why a line of this block is not run; empty if the line is run."""
        return next((why for words, why in (NEVER | self.marks).items() if words in line), "")

    def lines(self) -> Iterator[tuple[str, int]]:
        """Yield each command of a shell block that is run, and its expected exit status."""
        for line in self.text.replace("\\\n", " ").splitlines():
            command, _, comment = line.partition("  #")
            if command.strip() and not self.reason(line):
                stated = re.search(r"exits (\d)", comment)
                exits = POLICY_EXITS | self.exits
                other = next((code for words, code in exits.items() if words in line), 0)
                yield command.strip(), int(stated[1]) if stated else other

    @property
    def left(self) -> dict[str, str]:
        """{line of this block that is not run: reason}."""
        lines = self.text.replace("\\\n", " ").splitlines() if self.language == "sh" else ["python"]
        return {line: why for line in lines if line.strip() and (why := self.reason(line))}


def pages() -> list[Path]:
    """Return the pages whose blocks are run."""
    found = [path for folder in FOLDERS for path in sorted((ROOT / folder).glob("*.md"))]
    return [ROOT / "README.md", *found]


def find_english_page(page: Path) -> Path:
    """Return the English page of a Chinese page."""
    if page.name == "tutorial.md":
        return ROOT / "docs/tutorials/pupper.md"
    return ROOT / "docs" / page.relative_to(ROOT / "docs/zh")


def blocks_of(page: Path) -> list[Block]:
    """Return the blocks of a page with their marks and outputs.

    Blocks of a Chinese page are omitted if the English page has the block with the same output.
    """
    found: list[Block] = []
    marks: dict[str, str] = {}
    lines = page.read_text("utf-8").splitlines()
    index = 0
    while index < len(lines):
        line = lines[index]
        mark = re.fullmatch(r"<!-- not run(?: '(.+)')?: (.+) -->", line)
        fence = re.fullmatch(r"```(\w+)", line)
        if mark:
            marks[mark[1] or ""] = mark[2]
        elif fence:
            end = lines.index("```", index)
            text = "\n".join(lines[index + 1 : end]) + "\n"
            if fence[1] in ("sh", "python"):
                name = page.relative_to(ROOT).as_posix()
                found.append(Block(name, index + 1, fence[1], text, marks))
            elif fence[1] == "text" and found and not marks:
                found[-1].output.append(text)
            marks, index = {}, end
        index += 1
    if "zh" in page.parts and (twin := find_english_page(page)).exists():
        theirs = {block.text: "".join(block.output) for block in blocks_of(twin)}
        return [
            block
            for block in found
            if block.text not in theirs
            or find_missing_lines("".join(block.output), theirs[block.text])
        ]
    return found


def blocks_of_help(command: str) -> list[Block]:
    """Return a block with the examples in the ``--help`` of a command that no page contains."""
    message = cli.find_command(command).help or ""
    elsewhere = {line for page in pages() for block in blocks_of(page) for line, _ in block.lines()}
    lines = [
        re.sub(r"(?<=\S) {3,}(?=[^\\\s]).*", "", line.strip("\b "))
        for line in re.sub(r"\\\n\s*", "", message).splitlines()
        if re.match(r"\W*(xacro .*\| )?pupper-analysis ", line)
    ]
    text = "\n".join(line for line in lines if line.strip() not in elsewhere) + "\n"
    block = Block(f"{command} --help", 0, "sh", text, exits=HELP_EXITS)
    return [block] if text.strip() else []


def provide_files(folder: Path, block: Block) -> None:
    """Put the files of a block into a folder: links to the checkout, and files of the reader."""
    if "analysis check" in block.text and "examples/" not in block.text:
        own_files.write_models(folder, block.text)
    else:
        # The mesh paths of the URDF are relative to its folder, which is beside that of the MJCF.
        places = {name: folder / name for name in ("urdf", "mjcf", "examples", "scripts")}
        places |= {"mjcf/": folder.parent / "mjcf", "mjcf/meshes": folder / "meshes"}
        for name, place in places.items():
            if not place.exists():
                place.symlink_to(ROOT / name, target_is_directory=True)
    own_files.write(folder, block.text)


XACRO = """#!/bin/sh
exec cat "$1"
"""
"""Substitute for xacro, which is not a dependency: prints the file, which needs no expansion."""


def look_at(page: Any, *, browser: bool, wait: Any) -> None:
    """Replace the server of the live page: request the page once and close it."""
    del browser, wait
    try:
        with urlopen(page.address, timeout=PATIENCE) as got:
            assert b"<!doctype html" in got.read(200).lower()
    finally:
        page.close()


def look_into(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Replace MuJoCo's viewer: simulate ten steps."""
    mujoco.mj_step(model, data, 10)


SHORTER_SEARCHES = {
    r"(pupper-analysis analyze)$": r"\1 original v3-long-leg",
    r"(pupper-analysis analyze) (--report \S+)$": r"\1 v3 v3-long-leg \2",
    r"pupper-analysis best payload v3 .*": "pupper-analysis best utilisation v3",
    r"(pupper-analysis push (?!.*--directions).*)": r"\1 --directions 3 --resolution 0.2",
    r"(pupper-analysis walk .*--seeds) 20\b": r"\1 2",
    r"(pupper-analysis walk .*--(?:vary|orders|response)\b.*)": r"\1 --seconds 3",
    r"(pupper-analysis walk .*)--seeds 5\b": r"\1--seeds 1",
    r"seeds=5\)": "seeds=1, seconds=3)",
    r"map_response\(robot, policy\)": "map_response(robot, policy, seconds=3)",
    r"rank_orders\(robot, policy\)": f"rank_orders(robot, policy, commands=[({SPEED})], seconds=3)",
}
"""{pattern of a command or function call: faster replacement}.

The replacements shorten runs, and reduce initial states or directions of searches over a walk or a
push. The page of ``best`` runs the longest search of the best stance, so other pages run a shorter
search. Two variants, one of which fails, replace all six, which tests/cli/test_cli.py runs. The
pages state no numbers of these commands. The numbers are asserted by
tests/tools/walk/test_changes.py, tests/tools/walk/test_response.py and
tests/tools/push/test_recovery.py."""


def shorten_block(text: str) -> str:
    """Return the text of a block with the speed of the tests' policy, and with shorter searches."""
    text = text.replace("0.5,0,0", SPEED).replace("(0.5, 0, 0)", f"({SPEED})")
    walks = r"(pupper-analysis walk (?!.*(?:--command|--orders)).*)"
    text = re.sub(walks, rf"\1 --command {SPEED}", text)
    for pattern, shorter in SHORTER_SEARCHES.items():
        text = re.sub(pattern, shorter, text)
    return text


def run_shell(command: str, folder: Path) -> Answer:
    """Run a shell line; a line that only calls ``pupper-analysis`` runs in this process."""
    command = shorten_block(command)
    words = shlex.split(command)
    if words[0] == "xacro":
        (folder / "xacro").write_text(XACRO)
        (folder / "xacro").chmod(0o755)
    file = words[words.index(">") + 1] if ">" in words else None
    if words[0] != "pupper-analysis" or "|" in words:
        found = (str(Path(sys.executable).parent), str(folder), os.environ["PATH"])
        programs = os.pathsep.join(found)
        env = {**os.environ, "PYTHONPATH": str(ROOT), "PATH": programs}
        done = subprocess.run(
            ["bash", "-euo", "pipefail", "-c", command],
            cwd=folder, env=env, capture_output=True, text=True, check=False,
        )  # fmt: skip
        return Answer(done.returncode, done.stdout, done.stderr)
    if file is not None:
        words = words[: words.index(">")]
    with (
        mock.patch("pupper_analysis.tools.live.server.serve", look_at),
        mock.patch("pupper_analysis.present.display.check_display"),
        mock.patch("mujoco.viewer.launch", look_into),
    ):
        done = answer(*words[1:], folder=folder)
    if file is not None:
        (folder / file).write_text(done.stdout)
    return done


def run_python(block: Block, folder: Path, names: dict[str, Any]) -> str:
    """Run a Python block with the variables of its page; return what it prints."""
    out = io.StringIO()
    code = compile(shorten_block(block.text), f"{block.page}:{block.line}", "exec")
    with contextlib.chdir(folder), contextlib.redirect_stdout(out):
        exec(code, names)
    return out.getvalue()


def find_missing_lines(shown: str, printed: str) -> list[str]:
    """Return the shown lines that equal no printed line; ``...`` is any text of a line."""
    lines = [" ".join(line.split()) for line in printed.splitlines()]

    def is_printed(line: str) -> bool:
        parts = [re.escape(" ".join(part.split())) for part in line.split("...")]
        pattern = r"\s*.*?\s*".join(parts)
        return any(re.fullmatch(pattern, line) for line in lines)

    wanted = [line for line in shown.splitlines() if line.strip(" ─")]
    return [line for line in wanted if not is_printed(line)]


def run_page(blocks: list[Block], folder: Path) -> Counter[str]:
    """Run the blocks of a page in order in one folder, and compare what they print.

    Args:
        blocks: Blocks of one page.
        folder: Empty folder; the blocks run in a folder inside it.

    Returns:
        {"command" or "python": how many were run}.

    Raises:
        AssertionError: If an exit status or an output differs from the page.
    """
    folder = folder / "here"
    folder.mkdir(exist_ok=True)
    names: dict[str, Any] = {"pa": pa, "__name__": "__main__"}
    count: Counter[str] = Counter()
    for block in blocks:
        where = f"{block.page}:{block.line}"
        provide_files(folder, block)
        printed = ""
        if block.language == "python" and not block.reason():
            printed = run_python(block, folder, names)
            count["python"] += 1
        for command, status in block.lines() if block.language == "sh" else ():
            done = run_shell(command, folder)
            printed += done.stdout + done.stderr
            message = f"{where}: {command}\n{done.stdout[-2000:]}{done.stderr[-2000:]}"
            assert done.returncode == status, (
                f"exit status {done.returncode}, not {status}\n{message}"
            )
            count["command"] += 1
        for shown in block.output if printed else ():
            missing = find_missing_lines(shown, printed)
            assert not missing, f"{where} does not print {missing}, but:\n{printed}"
    return count
