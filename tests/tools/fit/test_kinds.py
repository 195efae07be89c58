"""Result files are recognised by their content, and files that people edited are kept."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from matplotlib.figure import Figure

from pupper_analysis.base.errors import OutputError
from pupper_analysis.present.figures.drawing import save_figure
from pupper_analysis.present.html.write import write_report
from pupper_analysis.tools.fit.stands.plan import PlannedStand, StandPlan, write_plan

STAND = PlannedStand("s01", ("FL",), {"hip": 0.5, "knee": -1.0}, 0.2)
PLAN = StandPlan("robot", (STAND,), (), 1)

WRITERS: dict[str, Callable[..., object]] = {
    "report.html": lambda path, **how: write_report(PLAN, path, **how),
    "figure.png": lambda path, **how: save_figure(Figure(), path, **how),
    "plan.csv": lambda path, **how: write_plan(PLAN, path, **how),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", WRITERS)
def test_result_files_are_recognised_and_other_files_are_not(name: str, tmp_path: Path) -> None:
    path, write = tmp_path / name, WRITERS[name]
    write(path)
    write(path)
    others = [b"name,mass\nbase,1\n", b"\x89PNG\r\n\x1a\n", b"<!DOCTYPE html><html></html>", b"# x"]
    for other in [*others, *_list_other_results(tmp_path, without=name)]:
        path.write_bytes(other)
        with pytest.raises(OutputError, match="of this package"):
            write(path)
        assert path.read_bytes() == other
    write(path, force=True)
    write(path)


def _list_other_results(folder: Path, without: str) -> list[bytes]:
    made = []
    for name, write in WRITERS.items():
        if name == without:
            continue
        other = folder / "others" / name
        write(other)
        made.append(other.read_bytes())
    return made


@pytest.mark.parametrize(
    ("typed", "where"),
    [("0.51", 5), ("0", 6), ("nan", 6), ("2.5", 7)],
)
def test_a_plan_with_readings_is_never_replaced(typed: str, where: int, tmp_path: Path) -> None:
    path = tmp_path / "plan.csv"
    write_plan(PLAN, path)
    header, row = (line.split(",") for line in path.read_text().splitlines())
    if where == len(row):
        header, row = [*header, "roll"], [*row, ""]
    row[where] = typed
    for comment in ("", "\ufeff"):  # as spreadsheets write it
        filled = f"{comment}{','.join(header)}\r\n{','.join(row)}\r\n"
        path.write_text(filled, newline="")
        for force in (False, True):
            with pytest.raises(OutputError, match="which are never replaced"):
                write_plan(PLAN, path, force=force)
        assert path.read_bytes() == filled.encode()


def test_a_png_of_another_program_is_not_replaced(tmp_path: Path) -> None:
    path = tmp_path / "x.png"
    Figure().savefig(path)
    with pytest.raises(OutputError, match="not a figure of this package"):
        save_figure(Figure(), path)
