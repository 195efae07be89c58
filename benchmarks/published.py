"""Whole commands on robots that others have published, beside v3: processor time and memory.

The files are found as the tests find them: in the folder of ``PUPPER_ROBOTS``, in ``build/robots``
(``make setup-ci``), or in the site-packages of the environment. Robots that are not installed are
left out.
"""

from __future__ import annotations

import os
import subprocess
import sys
import sysconfig
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[1]
_DATA = "cmeel.prefix/share/example-robot-data/robots"

ROBOTS = {
    "Panda": f"{_DATA}/panda_description/urdf/panda.urdf",
    "Go2": f"{_DATA}/go2_description/urdf/go2.urdf",
    "ANYmal B": f"{_DATA}/anymal_b_simple_description/robots/anymal.urdf",
    "G1": "mjlab/asset_zoo/robots/unitree_g1/xmls/g1.xml",
}
"""{robot: file in the folder of published robots}."""

COMMANDS: Mapping[str, Sequence[str]] = {
    "stand": ("stand", "{robot}"),
    "payload": ("payload", "{robot}"),
    "push --directions 4": ("push", "{robot}", "--directions", "4"),
    "best utilisation": ("best", "utilisation", "{robot}"),
    "convert": ("convert", "{robot}", "-o", "{output}"),
}
"""{command: arguments}, for legged robots."""

_LOAD = """
import sys, pupper_analysis as pa
robot = pa.load_robot(sys.argv[1])
print(robot.pin_model.nv, robot.nu)
"""
"""Program that loads a robot with this package."""

_BARE = """
import sys
if sys.argv[1].endswith(".urdf"):
    import pinocchio as pin
    from pathlib import Path
    path = Path(sys.argv[1])
    model = pin.buildModelFromUrdf(str(path), pin.JointModelFreeFlyer())
    folders = [str(folder) for folder in path.parents]
    pin.buildGeomFromUrdf(model, str(path), pin.GeometryType.COLLISION, package_dirs=folders)
else:
    import mujoco
    mujoco.MjModel.from_xml_path(sys.argv[1])
"""
"""Program that loads a model with Pinocchio or MuJoCo alone."""


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

_RUN_COMMAND = """
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


def measure_robots(repeats: int = 3) -> list[tuple[str, ...]]:
    """Measure all commands by turns; return a table with header.

    Each value is the least of the repeats. Panda has a fixed base, and is measured with ``hold``.
    """
    robots = find_robots()
    best: dict[tuple[str, str], Use] = {}
    with tempfile.TemporaryDirectory() as folder:
        for _ in range(repeats):
            for name, robot in robots.items():
                for command, arguments in _list_processes(name, robot, Path(folder)).items():
                    used, known = measure_process(*arguments), best.get((name, command))
                    if known is None or used.seconds < known.seconds:
                        best[name, command] = used
    joints = {name: int(best[name, "load"].output.split()[1]) for name in robots}
    rows = [
        (name, str(joints[name]), command, f"{used.seconds:.2f} s", f"{used.megabytes:.0f} MB")
        for (name, command), used in best.items()
    ]
    stands = [(joints[name], best[name, "stand"].seconds) for name in robots if name != "Panda"]
    if len(stands) > 1:
        exponent = np.polyfit(*np.log(np.array(stands)).T, 1)[0]
        rows.append(("all", "", "stand: exponent of the joints", f"{exponent:.2f}", ""))
    return [("robot", "joints", "command", "processor time", "peak memory"), *rows]


def _list_processes(name: str, robot: str, folder: Path) -> dict[str, list[str]]:
    """Return {command: code and arguments of a process} for a robot."""
    processes = {"load": [_LOAD, robot]}
    if name != "v3":
        processes["load, bare engine"] = [_BARE, robot]
    commands = {"hold": ("hold", "{robot}")} if name == "Panda" else COMMANDS
    for command, words in commands.items():
        if command == "convert" and not robot.endswith(".urdf"):
            continue
        output = folder / f"{name.replace(' ', '-')}.xml"
        values = {"robot": robot, "output": str(output)}
        forced = ["--force"] if command == "convert" else []
        arguments = [word.format(**values) for word in words]
        processes[command] = [_RUN_COMMAND, *arguments, *forced]
    return processes
