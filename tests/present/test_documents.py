"""Results are shown as golden documents have it, and each cell is the same wherever it is shown.

``golden/*.md`` are documents of results whose numbers are all different (``stubs``), as Markdown:
what a change of a builder changes is read in their diff.
``python -m tests.present.test_documents`` writes them anew.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from functools import cache

import pytest

from pupper_analysis.present.document import (
    Cell,
    Column,
    Number,
    Report,
    Table,
    in_english,
)
from pupper_analysis.present.html.write import render_page
from pupper_analysis.present.markdown import write_markdown
from tests.support import printing
from tests.support.html_page import Page
from tests.support.repository import ROOT
from tests.support.stubs import (
    ANALYSIS,
    REPORTS,
    STAND,
    files,
    loaded,
    pushed,
    row,
    stance,
    there,
    workspace,
)

GOLDEN = ROOT / "tests" / "golden"

BARS = dict.fromkeys(map(ord, "█▏▎▍▌▋▊▉"))
"""What draws shares of a whole on a terminal."""

Rows = list[dict[str, str]]


@cache
def report(name: str) -> Report:
    return REPORTS[name]()


def tables(shown: Report) -> list[Table]:
    blocks = [*shown.overview, *(block for one in shown.documents for block in one.blocks)]
    return [block for block in blocks if isinstance(block, Table)]


def header(column: Column) -> str:
    unit = {"": "", "1": " (–)"}.get(column.unit, f" ({column.unit})")
    return f"{in_english(column.name)}{unit}"


def plain(cell: Cell) -> str:
    return cell.text if isinstance(cell, Number) else in_english(cell)


def said(table: Table) -> Rows:
    """{header with unit: cell} of each row, as the document has it."""
    heads = [header(column) for column in table.columns]
    return [dict(zip(heads, map(plain, row), strict=True)) for row in table.rows]


def in_markdown(text: str) -> list[Rows]:
    """The tables of a Markdown text."""
    found, joiner = [], "\u2060"
    for lines in re.findall(r"(?m)(?:^\|.*\|\n)+", text.replace(joiner, "")):
        split = [re.split(r"(?<!\\)\|", line)[1:-1] for line in lines.splitlines()]
        cells = [[re.sub(r"\\(.)", r"\1", one).strip().strip("*") for one in row] for row in split]
        found.append([dict(zip(cells[0], row, strict=True)) for row in cells[2:]])
    return found


def on_a_terminal(table: Table, text: str) -> Rows:
    """The rows of a table as a wide terminal shows it: columns have two blanks between them."""
    lines = text[text.index(f"\n{in_english(table.title)}\n") :].splitlines()[2:]
    rule = next(number for number, line in enumerate(lines) if line.startswith("─"))
    shown = lines[:rule] + lines[rule + 1 : rule + 1 + len(table.rows)]
    wide = max(map(len, shown))
    blank = "".join(
        " " if all(line.ljust(wide)[at] == " " for line in shown) else "x" for at in range(wide)
    )
    places = [found.span() for found in re.finditer(r"x+( x+)*", blank)]
    split = [[" ".join(line[a:b].translate(BARS).split()) for a, b in places] for line in shown]
    heads = [" ".join(filter(None, parts)) for parts in zip(*split[:rule], strict=True)]
    return [dict(zip(heads, row, strict=True)) for row in split[rule:]]


def without_lines(rows: Rows) -> list[list[str]]:
    """What is in each row: headers and cells without what is broken into lines."""
    return [[" ".join(one.split()).replace(" (–)", "") for one in (*row, *row.values())]
            for row in rows]  # fmt: skip


@pytest.mark.parametrize("name", REPORTS)
def test_documents_are_the_golden_ones(name: str) -> None:
    assert write_markdown(report(name)) == (GOLDEN / f"{name}.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("name", REPORTS)
def test_cells_are_the_same_wherever_they_are_shown(name: str) -> None:
    """On a terminal, on a page and in Markdown: each in its column, under its name and unit."""
    shown = report(name)
    expected = [without_lines(said(table)) for table in tables(shown)]
    assert expected
    commented = [without_lines(rows) for rows in in_markdown(write_markdown(shown))]
    # Where something compares documents, a comment has that alone.
    assert commented == expected[: sum(isinstance(one, Table) for one in shown.overview) or None]
    read = [without_lines(rows) for rows in Page(render_page(shown)).every_table()]
    assert read == expected
    for document in shown.documents:
        text = printing.printed(document, width=600)
        for table in (block for block in document.blocks if isinstance(block, Table)):
            assert without_lines(on_a_terminal(table, text)) == without_lines(said(table))


STANCE, RUN, PATH = stance(), ANALYSIS.verification, there().path
FIELDS: tuple[tuple[str, str, str, str, float | str, float], ...] = (
    # report, table, row, column, the field's value in SI units, what it is scaled by
    ("stance", "Motor torques", "hip", "torque (N m)", STANCE.statics.joint_torques[0], 1),
    ("stance", "Motor torques", "knee", "torque (N m)", STANCE.statics.joint_torques[1], 1),
    ("stance", "Motor torques", "hip", "limit (N m)", STANCE.limits[0], 1),
    ("stance", "Motor torques", "hip", "utilisation (%)", STANCE.statics.motor_utilisation[0], 100),
    ("stance", "Motor torques", "hip", "simulated (N m)", RUN.joint_torques[0], 1),
    ("stance", "Motor torques", "knee", "min-max (N m)",
     STANCE.min_max_torque.joint_torques[1], 1),
    ("stance", "Motor torques", "knee", "position (°)",
     math.degrees(STANCE.joint_positions[1]), 1),
    *(("stance", "Contact forces on the feet, in world axes", foot, f"force {axis} (N)",
       STANCE.statics.foot_loads[foot].force[number], 1)
      for foot in ("FR", "RL") for number, axis in enumerate("xyz")),
    *(("stance", "Contact forces on the feet, in world axes", foot, f"simulated {axis} (N)",
       RUN.foot_forces[foot][number], 1) for foot in ("FR", "RL")
      for number, axis in enumerate("xyz")),
    ("stance", "Contact forces on the feet, in world axes", "RL", "friction used (%)",
     STANCE.statics.foot_loads["RL"].friction_utilisation, 100),
    ("stance", "Stance", "height of the base", "value", STAND.task.height, 1e3),
    ("stance", "Stance", "com margin", "value", STAND.com_margin, 1e3),
    ("stance", "Stance", "ground clearance", "value", STAND.ground_clearance.distance, 1e3),
    ("stance", "Stance", "distance between links", "value", STAND.self_clearance.distance, 1e3),
    *(("analysis", "MuJoCo, 12 s on the floating base (Euler, 2 ms; kp 5 … 6 N m/rad, kd 0.1 "
       "N m s/rad)", name, column, value, scale)
      for column, one in (("with feed-forward", RUN), ("without", ANALYSIS.sagging))
      for name, value, scale in (
          ("base height", one.base_height, 1e3),
          ("loss of height", one.height_loss, 1e3),
          ("of it joint deflection", one.servo_sag, 1e3),
          ("of it change of contact penetration", one.contact_sag, 1e3),
          ("drift of height, last second", one.height_drift, 1e3),
          ("tilt against the task", math.degrees(one.tilt), 1),
          ("foot slip", one.foot_slip["RL"], 1e3),
          ("joint error", math.degrees(one.joint_error), 1),
          ("torque off prediction, of the largest", one.torque_error, 100),
          ("vertical foot force off prediction", one.force_error, 100))),
    *(("analysis", "Joints, in actuator order", joint.name, column, math.degrees(limit), 1)
      for joint in ANALYSIS.joints for limit, column in (
          (joint.lower, "lower limit (°)"), (joint.upper, "upper limit (°)"))),
    *(("analysis", "Joints, in actuator order", joint.name, column, getattr(joint, field), 1)
      for joint in ANALYSIS.joints for field, column in (
          ("effort", "effort (N m)"), ("velocity", "velocity (rad/s)"),
          ("armature", "armature (kg m²)"), ("damping", "damping (N m s/rad)"),
          ("friction", "friction (N m)"))),
    ("analysis", "Errors of the solved stand (PlaCo, 7 iterations)", "com", "value",
     ANALYSIS.stand.com_error, 1e3),
    *(("variants", "Comparison (ratios to the unscaled base model)", "one", column,
       getattr(row("one", 0.0), field), scale) for field, column, scale in (
        ("total_mass", "mass (kg)", 1), ("mass_ratio", "mass ratio (–)", 1),
        ("peak_torque", "peak torque (N m)", 1), ("servo_sag", "joint deflection (mm)", 1e3),
        ("contact_sag", "contact penetration (mm)", 1e3))),
    *(("pushes", "Largest push that the stand survives", "120", column,
       getattr(pushed("one", 0.0, 0.0).recovery, field)[1], 1) for field, column in (
        ("impulses", "impulse (N s)"), ("velocity_steps", "step of velocity (m/s)"),
        ("tipping_estimate", "a rigid robot tips at (N s)"))),
    ("payload", "What bounds the payload", "motors", "payload", loaded().bounds["motors"].mass, 1),
    ("payload", "What bounds the payload", "servos' stiffness", "payload",
     loaded().bounds["servos"].mass, 1),
    ("workspace", "Range of the base in each direction, each alone", "height", "from",
     workspace().intervals["height"].low, 1e3),
    ("workspace", "Range of the base in each direction, each alone", "roll", "to",
     math.degrees(workspace().intervals["roll"].high), 1),
    ("path", "The path", "least com margin", "value", PATH.com_margin[1], 1e3),
    ("path", "How MuJoCo follows it", "joint error", "value",
     math.degrees(there().tracking.joint_error), 1),
    ("path", "How MuJoCo follows it", "joint error, rms", "value",
     math.degrees(there().tracking.joint_error_rms), 1),
    ("files", "All differences, the most important first", "1", "in the URDF",
     files().differences[0].urdf, 1),
    ("files", "All differences, the most important first", "1", "in the MJCF",
     files().differences[0].mjcf, 1),
)  # fmt: skip


@pytest.mark.parametrize(("name", "title", "first", "column", "value", "scale"), FIELDS)
def test_a_field_is_in_its_cell(
    name: str, title: str, first: str, column: str, value: float, scale: float
) -> None:
    """What is shown is the field, in the unit that is shown, to the digits that are shown."""
    found = [
        (row, cells)
        for table in tables(report(name))
        if in_english(table.title) == title and column in map(header, table.columns)
        for row, cells in zip(said(table), table.rows, strict=True)
        if plain(cells[0]) == first
    ]
    shown = found[0][0][column].removesuffix(" kg")
    digits = len(shown.rpartition(".")[2].split("e")[0]) if "." in shown else 0
    power = int(shown.partition("e")[2] or 0)
    room = 1.0 if name == "payload" else 0.51  # a payload is rounded down
    assert float(shown) == pytest.approx(scale * value, abs=room * 10.0 ** (power - digits))
    assert value  # a zero would be seen in any unit


def test_numbers_are_told_apart() -> None:
    """No two fields of a table have the same number: what is swapped is seen."""
    seen: dict[tuple[str, str], list[float]] = {}
    for name, title, _, _, value, scale in FIELDS:
        seen.setdefault((name, title), []).append(abs(float(value) * scale))
    for place, values in seen.items():
        assert len(set(values)) == len(values), place


def write(names: Iterable[str]) -> None:
    """Writes the golden documents anew."""
    for name in names:
        (GOLDEN / f"{name}.md").write_text(write_markdown(report(name)), encoding="utf-8")


if __name__ == "__main__":
    GOLDEN.mkdir(exist_ok=True)
    write(REPORTS)
