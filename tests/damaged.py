"""Check that damaged files of every kind are read, or rejected with a message of one line.

A reader must end with a result or with an error of the package, within ``SECONDS`` of processor
time and with at most ``MEMORY`` more memory than the process had. ::

    python tests/damaged.py 500       # files of each kind (make fuzz does the same)
"""

from __future__ import annotations

import argparse
import random
import resource
import signal
import struct
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from pupper_analysis.base.errors import PupperAnalysisError
from pupper_analysis.base.tools import own_tools
from pupper_analysis.cli.stance_fields import read_stance_file
from pupper_analysis.models.mjcf_file import read_mjcf
from pupper_analysis.models.urdf_file import read_urdf
from pupper_analysis.prepare.convert.meshes import UnreadableError, convert_to_obj, read_mesh_file
from pupper_analysis.tools.check.config import read_config
from pupper_analysis.tools.check.remarks import read_baseline
from pupper_analysis.tools.study.store import Store
from pupper_analysis.tools.study.study import Study
from tests.support.robots import mjcf_text, quadruped, urdf_text

SECONDS = 20
"""Processor time [s] after which a reader counts as hanging."""

MEMORY = 1_500_000_000
"""Memory [bytes] that a reader may take in addition to that of the process."""


@dataclass(frozen=True)
class Kind:
    """Kind of file that the package reads.

    Attributes:
        name: File name.
        sound: Valid content.
        read: Function that reads the file by its path.
    """

    name: str
    sound: bytes
    read: Callable[[Path], Any]


class Hang(BaseException):
    """Raised in a reader that has not ended in time."""


def _make_csv_log(separator: str) -> bytes:
    """Return a log of one joint as CSV with this separator."""
    header = separator.join(["time [ms]", "position.hip [deg]", "command.hip"])
    rows = [separator.join([str(5 * row), f"{0.1 * row}", f"{0.002 * row}"]) for row in range(120)]
    return "\n".join([header, *rows]).encode()


def _make_stl() -> bytes:
    """Return a binary STL of 20 random triangles."""
    corners = np.random.default_rng(0).normal(size=(20, 12)).astype("<f4")
    return bytes(80) + struct.pack("<I", 20) + b"".join(row.tobytes() + b"\0\0" for row in corners)


_OBJ = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\nf 1 3 4\nf 2 3 4\n"
_PLY = b"""ply
format ascii 1.0
element vertex 3
property float x
property float y
property float z
element face 1
property list uchar int vertex_indices
end_header
0 0 0
1 0 0
0 1 0
3 0 1 2
"""
_ONE_MESH = '<mujoco><asset><mesh name="m" file="{name}"/></asset><worldbody><body><joint/>'
"""MJCF with one mesh, a format string with the attribute ``name``."""

_ONE_MESH += '<geom type="mesh" mesh="m"/></body></worldbody></mujoco>'


def _read_mesh(path: Path) -> Any:
    """Read a mesh as a conversion does, and an MJCF that refers to it."""
    readable = path.suffix in (".stl", ".obj")
    try:
        _ = read_mesh_file(path) if readable else convert_to_obj(path)
    except UnreadableError:
        return
    if readable:
        mjcf = path.with_name("one.xml")
        mjcf.write_text(_ONE_MESH.format(name=path.name))
        read_mjcf(mjcf)


def _read_store(path: Path) -> Any:
    """Read the request of the study in the folder of a file."""
    return Store(path.parent).read_request()


_CONFIG = b"""baseline = "known.txt"
[[pair]]
name = "machine"
urdf = "robot.urdf"
mjcf = "robot.xml"
feet = ["foot0"]
[pair.tolerances]
mass = 1e-3
"""
_STUDY = b"""robot = "v3"
measure = ["peak_utilisation", "com_margin"]
samples = 4
[vary]
height = { linspace = [0.14, 0.17, 3] }
kp = { uniform = [20.0, 40.0] }
"""
_STANDS = b"stand,command.hip,position.hip [deg],swing,heading\na,0.1,5.2,FR,0.01\n"
_BASELINE = b"""# known
["crosscheck", "machine", "robot.urdf", "mass", "hip", {"urdf": 0.2, "mjcf": 0.22}]
"""


def list_fit_kinds() -> tuple[Kind, ...]:
    """Return the kinds of files that ``fit`` reads, for a package with that tool."""
    from pupper_analysis.tools.fit.measurements.log import read_log
    from pupper_analysis.tools.fit.measurements.stands import read_stands

    return (
        Kind("log.csv", _make_csv_log(","), read_log),
        Kind("semicolons.csv", _make_csv_log(";"), read_log),
        Kind("stands.csv", _STANDS, read_stands),
    )


@cache
def kinds() -> tuple[Kind, ...]:
    """Return all kinds of files."""
    return (
        *(list_fit_kinds() if "fit" in own_tools() else ()),
        Kind(
            "stance.toml", b"height = '12cm'\nroll = 0.1\n[swing]\nFL = '2cm'\n", read_stance_file
        ),
        Kind("study.toml", _STUDY, Study.read),
        Kind("study.json", b'{"format": 1, "study": {"robot": "v3", "seed": 1}}\n', _read_store),
        Kind("pupper-analysis.toml", _CONFIG, read_config),
        Kind("baseline.txt", _BASELINE, read_baseline),
        Kind("robot.urdf", urdf_text(quadruped()).encode(), read_urdf),
        Kind("robot.xml", mjcf_text(quadruped()).encode(), read_mjcf),
        Kind("mesh.stl", _make_stl(), _read_mesh),
        Kind("mesh.obj", _OBJ, _read_mesh),
        Kind("mesh.ply", _PLY, _read_mesh),
    )


def damage(chance: random.Random, data: bytes) -> bytes:
    """Return the content with one or more random damages, as by disks, editors or attackers."""
    for _ in range(chance.choice([1, 1, 1, 2, 5])):
        at, to = sorted(chance.randrange(len(data) + 1) for _ in range(2))
        some = bytes(chance.randrange(256) for _ in range(chance.choice([1, 4, 8])))
        big = chance.choice([b"\xff" * 8, b"\x7f" + b"\xff" * 3, b"9" * 400, b"\0" * 8, b"-1"])
        data = chance.choice(
            [
                lambda d, a, _b: d[:a],
                lambda d, a, b: d[:a] + d[b:],
                lambda d, a, b: d[:b] + d[a:],
                lambda d, a, _b, s=some: d[:a] + s + d[a + len(s) :],
                lambda d, a, _b, s=some: d[:a] + s + d[a + len(s) :],
                lambda d, a, _b, s=big: d[:a] + s + d[a + len(s) :],
                lambda d, a, _b, s=big: d[:a] + s + d[a:],
                lambda d, a, _b: d[:a] + chance.choice(_WORDS) + d[a:],
                lambda d, *_: d.replace(b",", b";"),
                lambda d, *_: chance.choice([b"\xef\xbb\xbf", b"\xff\xfe", b"PK\3\4", b""]) + d,
                lambda d, *_: d.decode("latin-1").encode(chance.choice(["utf-16", "utf-8"])),
                lambda d, a, _b: d[:a] + d[a : a + 1] * 200_000 + d[a:],
            ]
        )(data, at, to)
    return data


_WORDS = (b"nan", b"1e999", b'"', b"[", b"{" * 3000, b"\n", b"\0", b"\xe4", b"::error::x", b"<a>")
"""Texts that a damage inserts."""


@contextmanager
def _limit_process() -> Iterator[None]:
    """Limit the processor time and the memory of a reader."""

    def hang(_number: int, _frame: FrameType | None) -> None:
        raise Hang

    before = signal.signal(signal.SIGPROF, hang)
    signal.setitimer(signal.ITIMER_PROF, SECONDS)
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    here = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (here + MEMORY, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)


def problem_of(kind: Kind, data: bytes, folder: Path) -> str | None:
    """Return the defect in the handling of a damaged file; None if the file is read, or refused in
    one line with its name.
    """
    path = folder / kind.name
    path.write_bytes(data)
    try:
        with _limit_process():
            kind.read(path)
    except PupperAnalysisError as error:
        message = str(error)
        if "\n" in message:
            return f"its error is no line: {message[:300]!r}"
        if kind.name.partition(".")[0] not in message and folder.name not in message:
            return f"its error names no file: {message[:300]!r}"
    except Hang:
        return f"no end within {SECONDS} s"
    except BaseException as error:
        return f"{type(error).__name__}: {error}"
    return None


def problems_of(kind: Kind, count: int, seed: int, folder: Path) -> list[str]:
    """Read a valid file and ``count`` damaged ones; return each problem after kind and number."""
    for beside in kinds():  # which some name
        (folder / beside.name).write_bytes(beside.sound)
    kind.read(folder / kind.name)
    found = []
    for number in range(count):
        data = damage(random.Random(f"{kind.name} {seed} {number}"), kind.sound)
        problem = problem_of(kind, data, folder)
        if problem:
            found.append(f"{kind.name} {number}: {problem}")
    return found


def main() -> None:
    """Read damaged files of all kinds, and print each that is not rejected properly."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("count", nargs="?", type=int, default=500)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    failed = 0
    for kind in kinds():
        with tempfile.TemporaryDirectory() as folder:
            found = problems_of(kind, given.count, given.seed, Path(folder))
        failed += len(found)
        print(f"{kind.name}: {given.count} damaged files, {len(found)} failed", flush=True)
        for problem in found:
            print(f"    {problem[:300]}")
    sys.exit(bool(failed))


if __name__ == "__main__":
    main()
