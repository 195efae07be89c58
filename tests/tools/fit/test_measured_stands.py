"""Tables of measured stands: names that begin like a formula are escaped, and read back
unchanged.
"""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np
import pytest

from pupper_analysis.base.diagnostics import Quantity, diagnose
from pupper_analysis.base.errors import MeasurementError
from pupper_analysis.tools.fit.measurements.stands import MeasuredStands, format_stands, read_stands
from tests.support.arm import arm


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


def test_position_of_a_slide_beyond_its_limits_is_reported_in_metres() -> None:
    robot = arm()
    slide = robot.joint_names.index("b_slide")
    positions = (robot.lower_limits + robot.upper_limits)[None] / 2
    positions[0, slide] = robot.upper_limits[slide] + 0.5
    stands = MeasuredStands(
        "plan.csv", ("s1",), robot.joint_names, positions, positions, swing=((),)
    )
    limit = f"{positions[0, slide]:.4g} m"
    with pytest.raises(MeasurementError, match=f"b_slide is read at {limit}"):
        stands.check_limits(robot, positions, 0.1)


@pytest.mark.parametrize(
    ("code", "values"),
    [
        ("reading-contradicted", {"off": 0.0123}),
        ("servo-does-not-follow", {"off": 0.0123}),
        ("motion-not-explained", {"most": 0.0123}),
    ],
)
def test_deviation_of_a_slide_is_reported_in_millimetres(
    code: str, values: dict[str, float]
) -> None:
    others = {name: Quantity(0.01, "rad") for name in ("left", "noise")}
    quantities = {name: Quantity(value, "m") for name, value in values.items()}
    names = {"stand": "s1", "joint": "b_slide", "worst": "b_slide", "times": 5.0}
    assert "12" in (message := str(diagnose(code, **names, **others, **quantities)))
    assert " mm" in message
