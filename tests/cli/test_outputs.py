"""Check that no output of a command overwrites an input, or a file of another program.

The output path may lead to the input by links. Commands, outputs and input files are read from
click. A test fails for an unknown kind of input.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import re
import resource
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click
import numpy as np
import pytest

from pupper_analysis import cli
from pupper_analysis.base.kinds import Folder
from pupper_analysis.cli.shared import Command, OutputPath
from tests.support import legged
from tests.support.commands import Answer, answer
from tests.support.repository import ROOT

ARGUMENTS = {
    "words": ("robot.urdf", "robot.xml"),
    "sources": ("robot.urdf", "robot.xml"),
    "urdf": ("robot.urdf",),
    "mjcf": ("robot.xml",),
    "source": ("robot.urdf",),
    "old": ("other.urdf",),
    "new": ("robot.urdf",),
    "file": ("robot.urdf",),
    "objective": ("margin",),
    "folder": (),  # the file of --config
}
"""{argument of a command: value in this test}."""

OPTIONS = {
    "stance": "stance.toml",
    "stands": "stands.csv",
    "policy": "policy.json",
    "contract": "policy.toml",
    "fitted": "fit.json",
    "logs": "log.csv",
    "record": "plan.csv",
    "trace": "trace.npz",
    "start": "start.json",
    "config": "pupper-analysis.toml",
}
"""{option whose value is an input file: file}; ``--urdf`` and ``--mjcf`` are not included."""

MORE: dict[str, list[list[str]]] = {
    "path": [["--seconds", "1"]],
    "heat": [["--motor", "dephy-actpack"]],
    "walk": [
        ["--seconds", "3", "--vary", "delay"],
        ["deploy.yaml", "--seconds", "3", "--trace", "trace.npz"],
    ],
    "live": [["--headless", "--drop"]],
    "fit": [
        ["--plan", "4"],
        ["--stands", "stands.csv"],
        ["--log", "log.csv"],
        ["--record", "plan.csv", "--bridge", "typed", "-o", "recorded"],
    ],
    "convert": [["-o", "new.xml"]],
    "study": [["-o", "results", "--workers", "1"]],
    "sync": [["--dry-run"], ["--take", "urdf"]],
    "check": [[], ["--update-baseline"]],
}
"""{command: further words of the command line, for each mode of the command}."""

INSIDE = {
    "robot.xml": ("parts.xml", "feet/foot.stl", "skin.png"),
    "robot.urdf": ("feet/foot.stl",),
    "study.toml": ("robot.urdf", "robot.xml"),
    "pupper-analysis.toml": ("robot.urdf", "robot.xml", "known.txt"),
}
"""{file: files that a command reads with this file}."""

LINKS: dict[str, Callable[[Path, Path], Path]] = {
    "its name": lambda folder, file: file,
    "another way": lambda folder, file: Path("feet/..") / file,
    "a link": lambda folder, file: _link_file(folder, file, os.symlink),
    "a hard link": lambda folder, file: _link_file(folder, file, os.link),
}


def _link_file(folder: Path, file: Path, link: Callable[[Path, Path], None]) -> Path:
    other = folder / "linked"
    other.unlink(missing_ok=True)
    link(folder / file, other)
    return Path("linked")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a file of each kind that commands read."""
    return write_inputs(tmp_path_factory.mktemp("inputs"))


def write_inputs(folder: Path) -> Path:
    """Write a file of each kind that commands read to a folder, and return the folder."""
    pair = legged.quadruped(folder, floor=True, actuators="position")
    urdf, mjcf = pair.urdf.read_text(), pair.mjcf.read_text()
    (folder / "feet").mkdir()
    mesh = ROOT / "mjcf" / "meshes"
    shutil.copy(next(mesh.glob("*.[sS][tT][lL]")), folder / "feet" / "foot.stl")
    shutil.copy(next((ROOT / "docs").rglob("*.png")), folder / "skin.png")
    parts = (
        '<mujocoinclude><asset><mesh name="foot" file="feet/foot.stl"/>'
        '<texture name="skin" type="2d" file="skin.png"/></asset></mujocoinclude>'
    )
    (folder / "parts.xml").write_text(parts)
    at = mjcf.index(">") + 1
    (folder / "robot.xml").write_text(f'{mjcf[:at]}<include file="parts.xml"/>{mjcf[at:]}')
    seen = '<visual><geometry><mesh filename="feet/foot.stl"/></geometry></visual></link>'
    (folder / "robot.urdf").write_text(urdf.replace("</link>", seen, 1))
    (folder / "other.urdf").write_text(urdf)
    for path in (pair.urdf, pair.mjcf):
        if path.name not in ("robot.urdf", "robot.xml"):
            path.unlink()
    (folder / "stance.toml").write_text("height = '30cm'\n")
    (folder / "stands.csv").write_text("command.FL_knee,position.FL_knee\n-1.2,-1.25\n")
    (folder / "log.csv").write_text("time,command.FL_knee,position.FL_knee\n0,-1.2,-1.25\n")
    count = mjcf.count("<position ")
    layer = {"type": "dense", "weights": [[[0] * count] * 3, [0] * count]}
    (folder / "policy.json").write_text(json.dumps({"layers": [layer]}))
    (folder / "policy.toml").write_text(
        f'observation = ["gravity"]\ndefault = {[0] * count}\naction-scale = 1\nrate = 50\n'
    )
    rows = np.zeros((20, 3)), np.zeros((20, count))
    time = np.arange(20.0) / 50
    np.savez(folder / "trace.npz", time=time, observations=rows[0], actions=rows[1])
    joints = re.findall(r'<position [^>]*joint="(\w+)"', mjcf)
    (folder / "deploy.yaml").write_text(f"joint_names: {joints}\nkps: {[200] * count}\n")
    names = [f"{kind}.{joint}" for kind in ("command", "position") for joint in joints]
    home = re.search(r'<key [^>]*qpos="([^"]*)"', mjcf)
    assert home is not None
    commands = ",".join(home[1].split()[7:])
    (folder / "start.json").write_text(f"[{commands}]")
    (folder / "plan.csv").write_text(f"{','.join(names)}\n{commands}{',' * count}\n")
    fitted: dict[str, object] = {"kind": "delay", "subject": "", "component": ""}
    fitted |= {"stated": 0, "low": 0, "high": 0.01}
    (folder / "fit.json").write_text(json.dumps({"estimates": [fitted]}))
    robot = 'urdf = "robot.urdf"\nmjcf = "robot.xml"\n'
    (folder / "study.toml").write_text(
        f'measure = ["servo_sag"]\n[robot]\n{robot}[vary]\nkp = {{ values = [150] }}\n'
    )
    (folder / "pupper-analysis.toml").write_text(
        f'baseline = "known.txt"\n[[pair]]\nname = "robot"\n{robot}'
    )
    (folder / "known.txt").write_text("")
    return folder


def sums(folder: Path) -> dict[Path, str]:
    return {
        path: hashlib.sha256(path.read_bytes()).hexdigest()
        for path in folder.rglob("*")
        if path.is_file() and path.name != "linked"
    }


def reads(command: click.Command, words: list[str]) -> list[str]:
    """Return the files that a command reads with the arguments ``words``, and nested files."""
    named = [
        word
        for word in words
        if word in INSIDE or word.endswith((".csv", ".npz", ".toml", ".urdf", ".json", ".yaml"))
    ]
    if command.name == "check":
        named.append("pupper-analysis.toml")
    inside = [file for name in named for file in INSIDE.get(name, ())]
    inside += [file for name in inside for file in INSIDE.get(name, ())]
    return list(dict.fromkeys([*named, *inside]))


def lines_of(command: click.Command) -> Iterator[list[str]]:
    """Yield a command line per mode of a command, with as many input files as possible."""
    given = [
        word
        for parameter in command.params
        if isinstance(parameter, click.Argument)
        for word in ("study.toml",) * (command.name == "study") or ARGUMENTS[str(parameter.name)]
    ]
    for more in MORE.get(str(command.name), [[]]):
        # A stance excludes a policy, a trace the file of a fit.
        names = {param.name for param in command.params}
        left = {"policy", "contract"} if "stance" in names else set[str]()
        left |= {"fitted"} if "--trace" in more else set()
        inputs = [
            word
            for parameter in command.params
            if isinstance(parameter, click.Option)
            and isinstance(parameter.type, click.Path)
            and not isinstance(parameter.type, OutputPath)
            and parameter.name not in ("urdf", "mjcf", "stands", "logs", "record", "trace", *left)
            for word in (max(parameter.opts, key=len), OPTIONS[str(parameter.name)])
        ]
        yield [str(command.name), *given, *inputs, *more]


def outputs_of(command: Command, line: list[str]) -> Iterator[tuple[click.Parameter, Path | None]]:
    """Yield (output option, file) for each output of a command line.

    For an output folder, the file is a file that the command writes to the folder; otherwise None.
    """
    for option in command.outputs:
        given = dict.fromkeys(str(param.name) for param in command.params)
        given |= {"count": 4 if "--plan" in line else None}
        given |= {"record": "plan.csv" if "--record" in line else None}
        assert isinstance(option.type, OutputPath)
        holds = option.type.get_kind(given)
        if isinstance(holds, Folder):
            for name in list(holds.files)[:1]:
                yield option, Path(name)
        elif holds is not None:
            yield option, None


def list_cases(
    command: Command,
) -> Iterator[tuple[list[str], str, str, click.Parameter, Path | None]]:
    """Yield (command line, input, kind of link, output option, file in the output folder)."""
    for line in lines_of(command):
        named = reads(command, line)
        for option, inside in outputs_of(command, line):
            for number, file in enumerate(named):
                # A file that is not on the command line: a single kind of link, in turns.
                links = list(LINKS) if file in line else [list(LINKS)[number % len(LINKS)]]
                for link in links:
                    yield line, file, link, option, inside


def aim_output_at_input(
    folder: Path,
    line: list[str],
    file: str,
    link: str,
    option: click.Parameter,
    inside: Path | None,
) -> list[str]:
    """Return a command line whose output ``option`` is the input ``file``, by a kind of link."""
    if inside is not None:
        shutil.rmtree(folder / "into", ignore_errors=True)
        (folder / "into").mkdir()
        make = os.link if link == "a hard link" else os.symlink
        make(folder / file, folder / "into" / inside)
        target = Path("into")
    else:
        target = LINKS[link](folder, Path(file))
    words = list(line)
    for name in option.opts:
        if name in words:
            at = words.index(name)
            del words[at : at + 2]
    return [*words, option.opts[0], str(target)]


ALL = [cli.find_command(name) for name in cli.COMMAND_NAMES]
WRITING = [command for command in ALL if isinstance(command, Command) and command.outputs]


def one_line(result: Answer) -> bool:
    return result.stderr.startswith("error: ") and len(result.stderr.strip().splitlines()) == 1


@pytest.mark.slow
@pytest.mark.parametrize("command", WRITING, ids=lambda command: str(command.name))
def test_output_that_is_an_input_is_refused(command: Command, folder: Path) -> None:
    """All files keep their SHA-256, also with ``--force``.

    Each output is aimed at each input on the command line by four paths, two of which are a
    symbolic and a hard link, and at each nested input by one path.
    """
    before, count = sums(folder), 0
    for case in list_cases(command):
        words = aim_output_at_input(folder, *case)
        for force in ([], ["--force"]):
            result = answer(*words, *force, folder=folder)
            messages = (*words, *force, result)
            assert result.returncode == 2, messages
            fault, *steps = result.stderr.splitlines()
            if "the file exists" in fault and not force:  # the inputs of the run are not known yet
                assert [step.split()[-1] for step in steps] in ([], ["--force"]), messages
            else:
                assert one_line(result), messages
            refusals = ("an input of this run", "this file is the plan", "unknown output format")
            assert not force or any(text in result.stderr for text in refusals), messages
            count += 1
        shutil.rmtree(folder / "into", ignore_errors=True)
    (folder / "linked").unlink(missing_ok=True)
    assert sums(folder) == before
    assert count >= 16, f"only {count} cases are tested"


def test_every_command_with_a_path_is_swept() -> None:
    """Each option with a path is a known input of this test, or an output."""
    for command in ALL:
        assert isinstance(command, Command), command.name
        for option in command.params:
            if isinstance(option.type, click.Path) and not isinstance(option.type, OutputPath):
                known = {**ARGUMENTS, **OPTIONS}
                assert option.name in known, (command.name, option.name)
        writes = [o for o in command.params if isinstance(o, click.Option) and o.help]
        for option in writes:
            # An option with a number selects the content; another option contains the path.
            counts = isinstance(option.type, click.IntRange)
            if option.help.startswith(("Write ", "Draw ")) and not (option.is_flag or counts):
                assert isinstance(option.type, OutputPath), (command.name, option.name)


def tiny(command: click.Command) -> list[str]:
    """Return a command line of a short run, without outputs."""
    line = next(lines_of(command))
    for name in ("-o", "--stance"):  # the stance belongs to another robot
        if name in line:
            del line[line.index(name) : line.index(name) + 2]
    return line


def all_outputs(command: Command) -> list[str]:
    """Return the options of all outputs of a command, each output in a new folder."""
    model = "new.xml" if command.name == "convert" else "result"
    return [
        word
        for option in command.outputs
        for word in (
            option.opts[0],
            f"new/{option.name}/{model if '-o' in option.opts else 'result'}",
        )
        if (command.name, option.name) != ("analyze", "write_folder")
    ]


@pytest.mark.parametrize("command", WRITING, ids=lambda command: str(command.name))
def test_folder_without_write_permission_is_refused_before_the_work(
    command: Command, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # `os.access` is replaced, because the tests may run as root, with all permissions.
    monkeypatch.setattr(os, "access", lambda path, how: not how & os.W_OK)
    words, before, outputs = tiny(command), sums(folder), all_outputs(command)
    needed = [word for at, word in enumerate(outputs) if "-o" in (word, outputs[at - 1])]
    for place in range(0, len(outputs), 2):
        out = outputs[place : place + 2]
        given = answer(*words, *needed, *out, folder=folder)
        assert (given.returncode, given.stdout) == (2, ""), (words, given)
        assert "no permission to create a file" in given.stderr
        assert one_line(given)
    assert sums(folder) == before
    assert not (folder / "new").exists()


def test_two_outputs_to_one_linked_file_are_refused(folder: Path) -> None:
    (folder / "one.json").touch()
    (folder / "two.html").symlink_to("one.json")
    outputs = ("--json", "one.json", "--report", "two.html")
    given = answer("audit", "robot.urdf", *outputs, folder=folder)
    assert given.returncode == 2
    assert "two results" in given.stderr
    for name in ("one.json", "two.html"):
        (folder / name).unlink()


def test_two_results_on_standard_output_are_refused(folder: Path) -> None:
    given = answer("audit", "robot.urdf", "--json", "-", "--report", "-", folder=folder)
    assert (given.returncode, given.stdout) == (2, "")
    assert "two results" in given.stderr


def test_file_of_the_user_is_replaced_only_with_force(folder: Path) -> None:
    """Afterwards the file is a result, which the next result may replace."""
    path = folder / "notes.json"
    path.write_text('{"mine": true}\n')
    given = answer("audit", "robot.urdf", "--json", "notes.json", folder=folder)
    assert given.returncode == 2
    assert "give another name, or add --force" in given.stderr
    assert path.read_text() == '{"mine": true}\n'
    for more in (["--force"], []):
        given = answer("audit", "robot.urdf", "--json", "notes.json", *more, folder=folder)
        assert given.returncode < 2, given
        assert path.read_text().startswith('{\n  "generator": "pupper-analysis ')
    path.unlink()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["audit", "convert", "fit", "stand", "study", "sync"])
def test_full_disk_is_one_error_of_each_kind_of_command(
    name: str, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    command = cli.find_command(name)
    assert isinstance(command, Command)

    def fail(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    before = sums(folder)
    monkeypatch.setattr("pupper_analysis.base.files.write_new", fail)
    given = answer(*tiny(command), *all_outputs(command), folder=folder)
    errors = [line for line in given.stderr.splitlines() if line.startswith("error")]
    assert given.returncode == 2, given
    assert len(errors) == 1, given
    assert "No space left on device" in errors[0]
    left = sums(folder).keys() - before.keys()
    assert {path for path in left if path.name != ".lock"} == set()
    shutil.rmtree(folder / "new", ignore_errors=True)


@pytest.mark.parametrize("taken", [False, True])
def test_removed_output_folder_is_made_again_unless_a_file_has_its_name(
    taken: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The folder is removed during the run."""
    from pupper_analysis.tools.audit import audit

    place, audit_model = write_inputs(tmp_path) / "into", audit.audit_model
    place.mkdir()

    def remove_folder(*words: Any, **given: Any) -> Any:
        place.rmdir()
        if taken:
            place.write_text("mine")
        return audit_model(*words, **given)

    monkeypatch.setattr(audit, "audit_model", remove_folder)
    given = answer("audit", "robot.urdf", "--json", "into/a.json", folder=tmp_path)
    if taken:
        assert given.returncode == 2, given
        assert len([line for line in given.stderr.splitlines() if "error" in line]) == 1
        assert place.read_text() == "mine"
    else:
        assert given.returncode < 2, given
        assert (place / "a.json").is_file()


@contextmanager
def limit_file_size(size: int) -> Iterator[None]:
    """Let the system refuse all writes of this process beyond a file size [bytes]."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.slow
@pytest.mark.parametrize(
    "words",
    [
        ("audit", "robot.urdf", "--json", "out/a.json"),
        ("audit", "robot.urdf", "--report", "out/a.html"),
        ("convert", "robot.xml", "-o", "out/a.urdf"),
        ("sync", "out/robot.urdf", "robot.xml", "--take", "mjcf"),
    ],
    ids=lambda words: " ".join(words[:1] + words[-2:]),
)
def test_write_that_the_system_refuses_keeps_all_files(
    words: tuple[str, ...], tmp_path: Path
) -> None:
    """Reference: the limit of file sizes of the operating system, below the size of each result."""
    folder = write_inputs(tmp_path)
    place = folder / "out"
    place.mkdir()
    text = re.sub("<visual>.*?</visual>", "", (folder / "robot.urdf").read_text())
    (place / "robot.urdf").write_text(text.replace('mass value="', 'mass value="1', 1))
    before = sums(folder)
    with limit_file_size(256):
        given = answer(*words, folder=folder)
    errors = [line for line in given.stderr.splitlines() if line.startswith("error")]
    assert given.returncode == 2, given
    assert len(errors) == 1, given
    assert os.strerror(errno.EFBIG) in errors[0]
    assert sums(folder) == before
