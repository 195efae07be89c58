"""Whole commands on robots that others have published, beside v3: processor time and memory.

The files are found as the tests find them: in the folder of ``PUPPER_ROBOTS``, in ``build/robots``
(``make setup-ci``), or in the site-packages of the environment. Robots that are not installed are
left out.

`make benchmark` includes these commands. `python benchmarks/published.py --tables docs/data` runs
only these commands, and writes the table with the commit of each row. With ``--robot`` or
``--command``, the other rows of the table are kept. Times are processor times (user and system),
which other processes on the machine increase by 10 to 40 %. Simulated steps are the calls of
``mj_step`` and the steps of ``mujoco.rollout``; they do not depend on the machine.
"""

from __future__ import annotations

import csv
import math
import os
import subprocess
import sys
import sysconfig
import tempfile
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import click
import numpy as np
from tables import write_csv

ROOT = Path(__file__).parents[1]
_DATA = "cmeel.prefix/share/example-robot-data/robots"

ROBOTS = {
    "Panda": f"{_DATA}/panda_description/urdf/panda.urdf",
    "Go2": f"{_DATA}/go2_description/urdf/go2.urdf",
    "ANYmal B": f"{_DATA}/anymal_b_simple_description/robots/anymal.urdf",
    "G1 (URDF)": f"{_DATA}/g1_description/urdf/g1_29dof_rev_1_0.urdf",
    "G1 (MJCF)": "mjlab/asset_zoo/robots/unitree_g1/xmls/g1.xml",
    "Talos": f"{_DATA}/talos_data/robots/talos_reduced.urdf",
}
"""{robot: file in the folder of published robots}."""

_ROBOTS_WITHOUT_EFFORTS = ("G1 (MJCF)",)
"""Robots whose files state no effort limits, so that no utilisation exists."""

_COMMANDS_WITH_EFFORTS = ("best utilisation",)
"""Commands of `COMMANDS` that refuse a robot without effort limits."""

_FIXED_ROBOTS = ("Panda",)
"""Robots with a fixed base, which are measured with ``hold``."""

_TABLE = (
    "robot",
    "joints",
    "command",
    "processor time",
    "peak memory",
    "simulated steps",
    "commit",
)
"""Columns of the table of published robots."""

_FILE = "benchmarks-published-robots.csv"
"""Name of the table in the folder of ``--tables``."""

_STANDS = "all", "stand: exponent of the joints"
"""Robot and command of the row that states how the time of ``stand`` grows with the joints."""

COMMANDS: Mapping[str, Sequence[str]] = {
    "stand": ("stand", "{robot}"),
    "payload": ("payload", "{robot}"),
    "push --directions 4": ("push", "{robot}", "--directions", "4"),
    "best utilisation": ("best", "utilisation", "{robot}"),
    "convert": ("convert", "{robot}", "-o", "{output}"),
}
"""{command: arguments}, for legged robots."""

_LOAD = """
import sys, time
import mujoco, pinocchio, pupper_analysis as pa
pa.load_robot
start = time.process_time()
robot = pa.load_robot(sys.argv[1])
robot.pin_model
print(time.process_time() - start, robot.nu)
"""
"""Program that loads a robot with this package, and prints processor time [s] and joints."""

_BARE = """
import sys, time
import mujoco, pinocchio as pin
from pathlib import Path
start = time.process_time()
if sys.argv[1].endswith(".urdf"):
    path = Path(sys.argv[1])
    model = pin.buildModelFromUrdf(str(path), pin.JointModelFreeFlyer())
    folders = [str(folder) for folder in path.parents]
    pin.buildGeomFromUrdf(model, str(path), pin.GeometryType.COLLISION, package_dirs=folders)
else:
    mujoco.MjModel.from_xml_path(sys.argv[1])
print(time.process_time() - start)
"""
"""Program that loads a model with Pinocchio or MuJoCo alone, and prints the processor time [s]."""


@dataclass(frozen=True)
class Use:
    """Use of resources by a process.

    Attributes:
        seconds: Processor time [s].
        megabytes: Peak memory [MB].
        output: Standard output, without blank lines at the end.
    """

    seconds: float
    megabytes: float
    output: str


def find_robots() -> dict[str, str]:
    """Return {robot: variant or file} of v3 and the published robots that are installed."""
    found = {"v3": "v3"}
    for name, file in ROBOTS.items():
        path = next(
            (folder / file for folder in _yield_folders() if (folder / file).is_file()), None
        )
        if path is not None:
            found[name] = str(path)
    return found


def _yield_folders() -> Iterator[Path]:
    """Yield the folders in which published robots may be installed."""
    if "PUPPER_ROBOTS" in os.environ:
        yield Path(os.environ["PUPPER_ROBOTS"])
    yield ROOT / "build" / "robots"
    yield from (Path(sysconfig.get_path(name)) for name in ("purelib", "platlib"))


_REPORT_MEMORY = """
import atexit, re
@atexit.register
def report():
    with open("/proc/self/status") as status:
        peak = re.search(r"VmHWM:\\s+(\\d+) kB", status.read())
    print(f"\\n{peak[1] if peak else 0}", flush=True)
"""
"""Code that prints the peak memory [kB] at the end of a process. The memory in the resource usage
of a child process includes the memory of its parent before the program was replaced."""

_COUNT_STEPS = """
import mujoco, mujoco.rollout
steps, step, rollout = 0, mujoco.mj_step, mujoco.rollout.Rollout.rollout
def count_step(model, data, nstep=1):
    global steps
    steps += nstep
    step(model, data, nstep=nstep)
def count_rollout(*arguments, **options):
    global steps
    states, *others = rollout(*arguments, **options)
    steps += states.shape[0] * states.shape[1]
    return states, *others
mujoco.mj_step, mujoco.rollout.Rollout.rollout = count_step, count_rollout
@atexit.register
def report_steps():
    print(f"\\n{steps}", flush=True)
"""
"""Code that prints the number of simulated steps at the end of a process, before the memory."""

_RUN_COMMAND = f"""{_COUNT_STEPS}
import runpy, sys
sys.argv[0] = "pupper-analysis"
runpy.run_module("pupper_analysis", run_name="__main__")
"""
"""Program that runs a command of this package."""


def measure_process(code: str, *arguments: str) -> Use:
    """Run Python code with arguments, and measure processor time and peak memory.

    Raises:
        RuntimeError: If the process ends with a status above 1: bad input, or a crash.
    """
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    with tempfile.TemporaryFile("w+") as output:
        process = subprocess.Popen(
            [sys.executable, "-c", f"{_REPORT_MEMORY}{code}", *arguments],
            stdout=output,
            stderr=subprocess.DEVNULL,
            env=environment,
        )
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode not in (0, 1):
            raise RuntimeError(arguments)
        output.seek(0)
        *lines, peak = output.read().splitlines()
        return Use(used.ru_utime + used.ru_stime, int(peak) / 1000, "\n".join(lines).strip())


def measure_robots(
    repeats: int = 3,
    names: Collection[str] | None = None,
    commands: Collection[str] | None = None,
) -> list[tuple[str, ...]]:
    """Measure commands by turns; return a table with header.

    Time and memory are the smallest of the repeats. The time of a load does not contain the
    imports; the time of a command does. Steps are empty for a load.

    Args:
        repeats: Number of runs of each command.
        names: Names of the robots; all that are installed by default.
        commands: Commands besides the loads, which are always measured; all by default.
    """
    robots = {
        name: robot for name, robot in find_robots().items() if names is None or name in names
    }
    best: dict[tuple[str, str], tuple[float, float]] = {}
    joints: dict[str, int] = {}
    steps: dict[tuple[str, str], str] = {}
    with tempfile.TemporaryDirectory() as folder:
        for _ in range(repeats):
            for name, robot in robots.items():
                for command, arguments in _list_processes(name, robot, Path(folder)).items():
                    is_load = command.startswith("load")
                    if not (is_load or commands is None or command in commands):
                        continue
                    click.echo(f"{name}: {command} ...", err=True)
                    used = measure_process(*arguments)
                    seconds = used.seconds
                    if is_load:
                        printed = used.output.split()
                        seconds = float(printed[0])
                        joints |= {name: int(printed[1])} if len(printed) > 1 else {}
                    else:
                        steps[name, command] = used.output.rsplit("\n", 1)[-1]
                    known = best.get((name, command), (math.inf, math.inf))
                    best[name, command] = (
                        min(seconds, known[0]),
                        min(used.megabytes, known[1]),
                    )
    commit = find_commit()
    rows = [
        (
            name,
            str(joints[name]),
            command,
            f"{took:.3g} s",
            f"{memory:.0f} MB",
            steps.get((name, command), ""),
            commit,
        )
        for (name, command), (took, memory) in best.items()
    ]
    return [_TABLE, *rows, *_fit_growth(rows, commit)]


def _fit_growth(rows: Sequence[Sequence[str]], commit: str) -> list[tuple[str, ...]]:
    """Return a row with the exponent of the time of ``stand`` over the number of joints.

    No row if the rows contain ``stand`` of fewer than two numbers of joints.
    """
    stands = [(int(row[1]), float(row[3].split()[0])) for row in rows if row[2] == "stand"]
    if len({number for number, _ in stands}) < 2:
        return []
    exponent = np.polyfit(*np.log(np.array(stands)).T, 1)[0]
    robot, command = _STANDS
    return [(robot, "", command, f"{exponent:.2f}", "", "", commit)]


def merge_rows(
    known: Iterable[Sequence[str]], measured: Sequence[Sequence[str]], commit: str
) -> list[tuple[str, ...]]:
    """Replace the rows of measured commands in a table; return the rows, without a header.

    Robots keep their order; new commands of a robot follow its other rows. The exponent of
    ``stand`` is computed again from all rows.

    Args:
        known: Rows of the table.
        measured: New rows.
        commit: Commit of the measurement.
    """
    merged: dict[str, dict[str, tuple[str, ...]]] = {}
    for row in (*known, *measured):
        if row[0] != _STANDS[0]:
            merged.setdefault(row[0], {})[row[2]] = tuple(row)
    rows = [row for commands in merged.values() for row in commands.values()]
    return [*rows, *_fit_growth(rows, commit)]


def find_commit() -> str:
    """Return the commit of the checkout, with ``+`` if files differ from it; empty without git."""
    words = ["git", "describe", "--always", "--abbrev=8", "--exclude=*", "--dirty=+"]
    try:
        done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return ""
    return done.stdout.strip()


def _list_processes(name: str, robot: str, folder: Path) -> dict[str, list[str]]:
    """Return {command: code and arguments of a process} for a robot."""
    processes = {"load": [_LOAD, robot]}
    if name != "v3":
        processes["load, bare engine"] = [_BARE, robot]
    commands = {"hold": ("hold", "{robot}")} if name in _FIXED_ROBOTS else COMMANDS
    for command, words in commands.items():
        if command == "convert" and not robot.endswith(".urdf"):
            continue
        if command in _COMMANDS_WITH_EFFORTS and name in _ROBOTS_WITHOUT_EFFORTS:
            continue
        output = folder / f"{name.replace(' ', '-')}.xml"
        values = {"robot": robot, "output": str(output)}
        forced = ["--force"] if command == "convert" else []
        arguments = [word.format(**values) for word in words]
        processes[command] = [_RUN_COMMAND, *arguments, *forced]
    return processes


@click.command()
@click.option("--repeats", default=3, show_default=True, help="Number of runs of each command.")
@click.option("--robot", "names", multiple=True, help="Measure only this robot. Repeatable.")
@click.option("--command", "commands", multiple=True, help="Measure only this one. Repeatable.")
@click.option("--tables", type=click.Path(path_type=Path), help="Write rows of a CSV file here.")
def main(
    repeats: int, names: tuple[str, ...], commands: tuple[str, ...], tables: Path | None
) -> None:
    """Measure commands on published robots."""
    header, *rows = measure_robots(repeats, names or None, commands or None)
    for row in (header, *rows):
        click.echo("  ".join(row))
    if tables is not None:
        path = tables / _FILE
        known: list[list[str]] = []
        if path.exists() and (names or commands):
            with path.open(encoding="utf-8", newline="") as file:
                columns, *known = csv.reader(file)
            if tuple(columns) != header:
                raise click.ClickException(f"the columns of {path} are {columns}, not {header}")
        write_csv(path, header, merge_rows(known, rows, find_commit()))


if __name__ == "__main__":
    main()
