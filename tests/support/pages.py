"""What the pages and `--help` tell a reader to run: blocks of shell and Python, and their output.

`python -m tests.support.pages` prints how many there are of each page, and which are not run, why.

A block that cannot run is marked in its page, with the reason: `<!-- not run: REASON -->` on the
line above it; `<!-- not run 'WORDS': REASON -->` means those of its lines that hold these words. A
command whose line ends with `# exits 1` must. The lines of a block of text below are its output:
`...` stands for any, and numbers have the digits that are printed.
"""

from __future__ import annotations

import contextlib
import io
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pupper_analysis as pa
from pupper_analysis import cli
from tests.support import arm
from tests.support.commands import Answer, answer
from tests.support.repository import ROOT

FOLDERS = ("docs/how-to", "docs/tutorials", "docs/zh", "docs/zh/how-to")
"""Of pages whose every block is run, beside the README."""

ARMS = ("panda", "ur5", "arm", "hand")
"""Names of files that are an arm's; all others are Pupper's."""

HELP = {
    "study": "an hour of designs; its page runs a smaller one",
    "live": "it serves until it is ended: tests/tools/live",
    "ur5": "a UR5 of one's own",
    "hand.xml": "a hand of one's own",
    "mjcf:": "two files that differ: tests/tools/sync",
    "contract": "a policy of one's own: tests/tools/contract",
    "analysis walk": "a policy of one's own: tests/tools/walk",
    "--policy": "a policy of one's own: tests/tools/walk",
    "xacro": "xacro is no dependency",
    "g1": "its joints and feet are named: a G1 of one's own",
    "--foot": "feet of other names",
    "--map": "joints of other names",
    "HEAD": "a repository of one's own",
    "v1.0": "a repository of one's own",
    "stands.csv": "measurements of one's own",
    "hanging.csv": "measurements of one's own",
    ".usd": "tests/tools/usd",
    "pupper-analysis check": "a repository of one's own: tests/repository/test_action.py",
}
"""Examples of `--help` that are not run: {words in their line: why}."""


@dataclass
class Block:
    """What a reader runs at once.

    Attributes:
        page: Its name, from the repository's root; of a command's help `NAME --help`.
        line: Of its fence.
        language: `sh` or `python`.
        text: What is in it.
        marks: {words in the lines that are not run (empty: all): reason}.
        output: Text that is shown below it, in order.
    """

    page: str
    line: int
    language: str
    text: str
    marks: dict[str, str] = field(default_factory=dict)
    output: list[str] = field(default_factory=list)

    def reason(self, line: str = "") -> str:
        """Why a line is not run; empty if it is."""
        return next((why for words, why in self.marks.items() if words in line), "")

    def lines(self) -> Iterator[tuple[str, int]]:
        """Yields the commands of a shell block that are run, and their exit status."""
        for line in self.text.replace("\\\n", " ").splitlines():
            command, _, comment = line.partition("  #")
            if command.strip() and not self.reason(line):
                status = re.search(r"exits (\d)", comment)
                yield command.strip(), int(status[1]) if status else 0

    @property
    def left(self) -> dict[str, str]:
        """{line that is not run: why}."""
        lines = self.text.replace("\\\n", " ").splitlines() if self.language == "sh" else ["python"]
        return {line: why for line in lines if line.strip() and (why := self.reason(line))}


def pages() -> list[Path]:
    """The pages whose blocks are run."""
    found = [path for folder in FOLDERS for path in sorted((ROOT / folder).glob("*.md"))]
    return [ROOT / "README.md", *found]


def blocks_of(page: Path) -> list[Block]:
    """The blocks of a page, each with its marks and its output."""
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
    return found


def blocks_of_help(command: str) -> list[Block]:
    """The examples of `pupper-analysis COMMAND --help` that no page has, too."""
    said = cli.find_command(command).help or ""
    elsewhere = {line for page in pages() for block in blocks_of(page) for line, _ in block.lines()}
    lines = [
        re.sub(r"(?<=\S) {3,}(?=[^\\\s]).*", "", line.strip("\b "))
        for line in said.replace("\\\n", " ").splitlines()
        if re.match(r"\W*(xacro .*\| )?pupper-analysis ", line)
    ]
    lines = [line for line in lines if line.strip() not in elsewhere]
    return [Block(f"{command} --help", 0, "sh", "\n".join(lines) + "\n", dict(HELP))] * bool(lines)


def furnish(folder: Path, block: Block) -> None:
    """Puts the files of one's own that a block names into a folder: copies of Pupper's."""
    places = {name: folder / name for name in ("urdf", "mjcf", "examples", "scripts")}
    # The URDF names its meshes from its own folder, beside that of the MJCF.
    places |= {"mjcf/": folder.parent / "mjcf", "mjcf/meshes": folder / "meshes"}
    for name, place in places.items():
        if not place.exists():
            place.symlink_to(ROOT / name, target_is_directory=True)
    (folder / "crouch.toml").write_text("height = '12cm'\n")
    if "legs.toml" in block.text:
        shutil.copy(ROOT / "examples/legs.toml", folder)
    made: set[str] = set()  # by a command, before it is read
    for before, name, suffix in re.findall(
        r"(\S*)[\"' ]((?:\w+/)?[\w.]+)\.(urdf|xml)\b", block.text
    ):
        file = folder / f"{name}.{suffix}"
        if before in ("-o", ">"):
            made.add(file.name)
        if file.exists() or file.name in made or name.startswith("build/"):
            continue
        file.parent.mkdir(exist_ok=True)
        if name in ARMS:
            file.write_text(arm.URDF if suffix == "urdf" else arm.MJCF)
        elif suffix == "urdf":
            shutil.copy(ROOT / "urdf/pupper_v3.urdf", file)
        else:
            shutil.copy(ROOT / "mjcf/pupper_v3.xml", file)
            for part in ("shared", "body"):
                shutil.copy(ROOT / f"mjcf/pupper_v3_{part}.xml", file.parent)


def run_shell(command: str, folder: Path) -> Answer:
    """Runs a line as a shell does; one that only starts the command, in this process."""
    words = shlex.split(command)
    file = words[words.index(">") + 1] if ">" in words else None
    if words[0] != "pupper-analysis" or "|" in words:
        programs = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
        env = {**os.environ, "PYTHONPATH": str(ROOT), "PATH": programs}
        done = subprocess.run(
            ["bash", "-euo", "pipefail", "-c", command],
            cwd=folder, env=env, capture_output=True, text=True, check=False,
        )  # fmt: skip
        return Answer(done.returncode, done.stdout, done.stderr)
    if file is not None:
        words = words[: words.index(">")]
    done = answer(*words[1:], folder=folder)
    if file is not None:
        (folder / file).write_text(done.stdout)
    return done


def run_python(block: Block, folder: Path, names: dict[str, Any]) -> str:
    """Runs a block of Python in the names of its page; returns what it prints."""
    out = io.StringIO()
    code = compile(block.text, f"{block.page}:{block.line}", "exec")
    with contextlib.chdir(folder), contextlib.redirect_stdout(out):
        exec(code, names)
    return out.getvalue()


def misses(shown: str, printed: str) -> list[str]:
    """The parts of lines of a page that are not in what was printed; white space may differ."""
    flat = " ".join(printed.split())
    parts = [part for line in shown.splitlines() for part in line.split("...")]
    return [part for part in parts if " ".join(part.split()) not in flat]


def run_page(blocks: list[Block], folder: Path) -> Counter[str]:
    """Runs the blocks of a page one after the other, in one folder, and compares what they print.

    Returns:
        How many commands and blocks of Python were run.

    Raises:
        AssertionError: If one ends otherwise than the page says, or prints something else.
    """
    folder = folder / "here"
    folder.mkdir(exist_ok=True)
    names: dict[str, Any] = {"pa": pa, "__name__": "__main__"}
    count: Counter[str] = Counter()
    for block in blocks:
        where = f"{block.page}:{block.line}"
        furnish(folder, block)
        printed = ""
        if block.language == "python" and not block.reason():
            printed = run_python(block, folder, names)
            count["python"] += 1
        for command, status in block.lines() if block.language == "sh" else ():
            done = run_shell(command, folder)
            printed += done.stdout + done.stderr
            said = f"{where}: {command}\n{done.stdout[-2000:]}{done.stderr[-2000:]}"
            assert done.returncode == status, f"exit status {done.returncode}, not {status}\n{said}"
            count["command"] += 1
        for shown in block.output if printed else ():
            missing = misses(shown, printed)
            assert not missing, f"{where} does not print {missing}, but:\n{printed}"
    return count


def main() -> None:
    """Prints how many blocks there are, and which are not run."""
    whole = {page.relative_to(ROOT).as_posix(): blocks_of(page) for page in pages()}
    whole |= {f"{name} --help": blocks_of_help(name) for name in cli.COMMANDS}
    commands = python = left = 0
    for name, blocks in whole.items():
        run = sum(len(list(block.lines())) for block in blocks if block.language == "sh")
        codes = sum(block.language == "python" and not block.reason() for block in blocks)
        unrun = {line: why for block in blocks for line, why in block.left.items()}
        commands, python, left = commands + run, python + codes, left + len(unrun)
        print(f"{name}: {run} commands, {codes} blocks of Python")
        for line, why in unrun.items():
            print(f"    not run: {' '.join(line.split())} ({why})")
    print(f"{commands} commands and {python} blocks of Python are run, {left} are not")


if __name__ == "__main__":
    main()
