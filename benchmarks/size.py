"""Growth of time and memory of crosscheck and audit with the number of links.

Each measurement is a separate process, start-up included. The time is the processor time of all
threads, which depends little on other processes. ``--figure`` draws docs/images/size.png::

    python benchmarks/size.py --figure docs/images/size.png
"""

from __future__ import annotations

import argparse
import csv
import json
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

CHAIN, LEGS, HEAVIER, BODIES = (
    "chain",
    "legs of four joints",
    "legs, 20 masses differ",
    "free bodies",
)
"""Kinds of robots."""

SIZES = {
    CHAIN: (12, 60, 120, 190, 245),  # deeper ones are refused
    LEGS: (12, 60, 120, 192, 300, 600, 1200, 1996),
    HEAVIER: (60, 192, 300, 600, 1200, 1996),
    BODIES: (10, 100, 500, 1500),
}
"""{kind: numbers of moving links}."""

TABLE = Path(__file__).resolve().parents[1] / "docs/data/crosscheck-size.csv"
"""CSV file of the measurements of the committed figure."""

_COLUMNS = ("kind", "links", "seconds", "gigabytes")
"""Columns of the CSV file: kind of robot, number of moving links, time [s], peak memory [GB]."""

_MEASURE = """
import json, resource, sys, time
import pupper_analysis as pa
if len(sys.argv) == 3:
    result = pa.compare_models(*map(str, sys.argv[1:]))
    said = dict(found=len(result.differences), complete=result.complete)
else:
    said = dict(found=len(pa.audit_model(sys.argv[1]).findings), complete=True)
taken = time.process_time()
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
print(json.dumps(dict(seconds=taken, gigabytes=peak, **said)))
"""
"""Code that compares two files, or audits one, and prints time and memory as JSON."""


def make_pair(legs: int, joints: int, heavier: int = 0) -> tuple[str, str]:
    """Return the URDF and the MJCF of a base with equal legs.

    Args:
        legs: Number of legs.
        joints: Number of joints per leg.
        heavier: Number of links whose mass is 10 % higher in the MJCF.
    """
    tensor = 'ixx="2e-4" iyy="3e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"'
    urdf = ['<robot name="r"><link name="base"><inertial><mass value="2"/>']
    urdf += ['<inertia ixx=".02" iyy=".03" izz=".04" ixy="0" ixz="0" iyz="0"/></inertial></link>']
    mjcf = ['<mujoco><compiler angle="radian"/><worldbody><body name="base"><freejoint/>']
    mjcf += ['<inertial pos="0 0 0" mass="2" diaginertia=".02 .03 .04"/>']
    for leg in range(legs):
        parent = "base"
        for joint in range(joints):
            name, axis = f"{leg}_{joint}", ("1 0 0", "0 1 0")[joint % 2]
            place = f"{0 if joint else 0.1 * leg:.6g} 0 -0.05"
            mass = 0.11 if leg * joints + joint < heavier else 0.1
            urdf += [
                f'<link name="{name}"><inertial><origin xyz="0 0 -.02"/><mass value="0.1"/>'
                f'<inertia {tensor}/></inertial></link><joint name="j{name}" type="revolute">'
                f'<parent link="{parent}"/><child link="{name}"/><origin xyz="{place}"/>'
                f'<axis xyz="{axis}"/><limit lower="-1" upper="1" effort="3" velocity="9"/></joint>'
            ]
            mjcf += [
                f'<body name="{name}" pos="{place}"><joint name="j{name}" axis="{axis}" '
                f'range="-1 1" actuatorfrcrange="-3 3"/><inertial pos="0 0 -.02" mass="{mass}" '
                'diaginertia="2e-4 3e-4 1e-4"/>'
            ]
            parent = name
        mjcf += ["</body>" * joints]
    return "".join([*urdf, "</robot>"]), "".join([*mjcf, "</body></worldbody></mujoco>"])


def make_free_bodies(count: int) -> str:
    """Return an MJCF with a row of free bodies."""
    each = '<body name="b{0}" pos="{0} 0 1"><freejoint/><geom size=".1"/></body>'
    rows = "".join(each.format(number) for number in range(count))
    return f"<mujoco><worldbody>{rows}</worldbody></mujoco>"


MADE: dict[str, Callable[[int], tuple[str, ...]]] = {
    CHAIN: lambda count: make_pair(1, count),
    LEGS: lambda count: make_pair(count // 4, 4),
    HEAVIER: lambda count: make_pair(count // 4, 4, heavier=20),
    BODIES: lambda count: (make_free_bodies(count),),
}
"""{kind: function that returns the texts of its files}."""


def measure_files(texts: tuple[str, ...]) -> dict[str, float]:
    """Compare two files, or audit one, in a separate process; return time [s] and memory [GB]."""
    with tempfile.TemporaryDirectory() as folder:
        paths = [Path(folder) / f"robot.{end}" for end in ("urdf", "xml")[-len(texts) :]]
        for path, text in zip(paths, texts, strict=True):
            path.write_text(text)
        command = [sys.executable, "-c", _MEASURE, *map(str, paths)]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
    result: dict[str, float] = json.loads(done.stdout)
    return result


def measure_sizes(most: int) -> Iterator[dict[str, Any]]:
    """Yield and print the measurement of each size."""
    for kind, sizes in SIZES.items():
        for size in sizes:
            if size <= most:
                row = {"kind": kind, "links": size, **measure_files(MADE[kind](size))}
                print(
                    f"{kind:24} {size:5}  {row['seconds']:6.2f} s  {row['gigabytes']:.2f} GB  "
                    f"{row['found']} found, complete: {row['complete']}",
                    flush=True,
                )
                yield row


def draw_sizes(table: list[dict[str, Any]], path: Path) -> None:
    """Draw time and memory over the number of links."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    from pupper_analysis.present.colours import GREY_COLOUR, SERIES_COLOURS

    figure, axes = plt.subplots(1, 2, figsize=(11, 4.5), layout="constrained")
    styles = list(zip(SERIES_COLOURS, "os^D", ("-", "--", ":", "-"), strict=False))
    for axis, what, label, goal in zip(
        axes,
        ("seconds", "gigabytes"),
        ("processor time (s)", "peak memory (GB)"),
        (20, 2),
        strict=True,
    ):
        for kind, (colour, marker, dashes) in zip(SIZES, styles, strict=False):
            of_kind = [row for row in table if row["kind"] == kind]
            axis.loglog(
                [row["links"] for row in of_kind],
                [row[what] for row in of_kind],
                color=colour,
                marker=marker,
                markersize=5,
                linestyle=dashes,
                label=f"{'audit' if kind == BODIES else 'crosscheck'}: {kind}",
            )
        axis.axhline(goal, color=GREY_COLOUR, linestyle=":")
        unit = label[label.index("(") + 1 : -1]
        said = f"goal for 2000 links: {goal} {unit}"
        axis.text(10, goal * 0.93, said, va="top", color=GREY_COLOUR)
        axis.axvline(194, color="0.8", zorder=0)
        axis.set(xlabel="number of moving links", ylabel=label)
        axis.xaxis.set_major_formatter("{x:g}")
        axis.yaxis.set_major_formatter("{x:g}")
        axis.grid(True, which="major", alpha=0.3)
    axes[1].text(210, 0.1, "MuJoCo only", color=GREY_COLOUR)
    axes[1].text(178, 0.1, "both engines", color=GREY_COLOUR, ha="right")
    axes[0].set_ylim(0.3, 30)
    axes[1].set_ylim(0.08, 3)
    axes[0].legend(loc="upper left", bbox_to_anchor=(0.0, 0.86), fontsize=8)
    figure.suptitle("crosscheck and audit: time and memory by the number of moving links")
    figure.savefig(path, dpi=130)


def write_sizes(table: Iterable[dict[str, Any]], path: Path) -> None:
    """Write measurements as CSV, with two decimals."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, _COLUMNS, extrasaction="ignore", lineterminator="\n")
        writer.writeheader()
        for row in table:
            writer.writerow({**row, **{name: f"{row[name]:.2f}" for name in _COLUMNS[2:]}})


def read_sizes(path: Path) -> list[dict[str, Any]]:
    """Read measurements from CSV."""
    with path.open(encoding="utf-8", newline="") as file:
        return [
            {"kind": row["kind"], **{name: float(row[name]) for name in _COLUMNS[1:]}}
            for row in csv.DictReader(file)
        ]


def main() -> None:
    """Measure all sizes, or draw the figure from the stored measurements."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--measure", action="store_true", help="measure, and store the table")
    parser.add_argument("--most", type=int, default=2000, help="links of the largest robot")
    parser.add_argument("--table", type=Path, default=TABLE, help="CSV file of the measurements")
    parser.add_argument("--figure", type=Path, help="draw to this file")
    arguments = parser.parse_args()
    if arguments.measure:
        write_sizes(measure_sizes(arguments.most), arguments.table)
    if arguments.figure:
        draw_sizes(read_sizes(arguments.table), arguments.figure)


if __name__ == "__main__":
    main()
