"""Columns of a CSV file: separators, units and decimal commas, and refusals of other files."""

from __future__ import annotations

from pathlib import Path

import pytest

from pupper_analysis.base.errors import MeasurementError
from pupper_analysis.tools.fit.measurements.columns import MeasurementColumn, read_columns

KNOWN = (
    MeasurementColumn("time", "time"),
    MeasurementColumn("position.*", "position"),
    MeasurementColumn("stand", ""),
)


@pytest.mark.parametrize("separator", [",", ";", "\t"])
def test_columns_may_be_separated_by_semicolons_or_tabs(tmp_path: Path, separator: str) -> None:
    """Times in ms become s; semicolon files may have decimal commas."""
    file = tmp_path / "a.csv"
    name = "ab" if separator == "," else "a,b"
    lines = [["stand", "time [ms]", "position.a"], [name, "5", "0.25"]]
    if separator == ";":
        lines.append(["c", "7,5", "-1,5e-1"])
    file.write_text("\ufeff" + "\r\n".join(map(separator.join, lines)), encoding="utf-8")
    found = read_columns(file, KNOWN)
    assert found.words["stand"][0] == name
    assert found.numbers["time"][0] == pytest.approx(0.005)
    if separator == ";":
        assert found.numbers["time"][1] == pytest.approx(0.0075)
        assert found.numbers["position.a"][1] == pytest.approx(-0.15)


@pytest.mark.parametrize("blank", ["  \n", "\r\n", ";;\n"])
def test_separator_is_that_of_the_header_below_empty_lines(tmp_path: Path, blank: str) -> None:
    file = tmp_path / "a.csv"
    file.write_text(blank + "time;position.a\n1,5;2\n")
    found = read_columns(file, KNOWN)
    assert found.numbers["time"].tolist() == [1.5]
    assert found.numbers["position.a"].tolist() == [2.0]


@pytest.mark.parametrize(
    ("data", "code", "text"),
    [
        ("time\n1".encode("utf-16"), "encoded-in-utf-16", "UTF-8"),
        (b"time\n1\0", "file-is-binary", "a.csv:2"),
        (b"time\n\xe4", "not-utf-8", "a.csv:2"),
        (b"time\n" + b"1" * 200_000, "no-csv", "field"),
        (b"x" * 100_000 + b"\n1", "measurement-unknown", "..."),
        (b"time\n" + b"x" * 100_000, "cell-no-number", "line 2"),
    ],
)
def test_invalid_csv_is_refused_in_one_line(
    tmp_path: Path, data: bytes, code: str, text: str
) -> None:
    (tmp_path / "a.csv").write_bytes(data)
    with pytest.raises(MeasurementError) as refused:
        read_columns(tmp_path / "a.csv", KNOWN)
    assert refused.value.cause.code == code
    assert text in str(refused.value)
    assert len(str(refused.value)) < 400 + len(str(tmp_path))
