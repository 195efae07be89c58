"""Tables of measured stands: names that begin like a formula are escaped, and read back
unchanged.
"""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np

from pupper_analysis.tools.fit.measurements.stands import MeasuredStands, format_stands, read_stands


def test_names_of_stands_and_feet_are_read_as_they_were_written(tmp_path: Path) -> None:
    names, swing = ("=1+1", "-s", "s3", "-3"), (("@foot",), (), ("+FL", "FR"), ())
    stands = MeasuredStands(
        "plan.csv", names, ("=hip",), np.zeros((4, 1)), np.full((4, 1), -0.1), swing
    )
    path = tmp_path / "stands.csv"
    path.write_text(format_stands(stands))
    rows = list(csv.reader(io.StringIO(path.read_text())))
    assert [row[0] for row in rows[1:]] == ["'=1+1", "'-s", "s3", "-3"]
    found = read_stands(path)
    assert (found.names, found.swing, found.joints) == (names, swing, ("=hip",))
    assert found.position.tolist() == [[-0.1]] * 4
