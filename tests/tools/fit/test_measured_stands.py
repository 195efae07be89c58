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
    with pytest.raises(MeasurementError, match=f"the reading {limit} of b_slide"):
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


def test_stands_of_one_name_that_differ_get_different_names() -> None:
    """Rows 0 and 4 are repeated readings. The other rows differ from row 0 in the foot in the air,
    the heading or the mass; the file already contains the name ``a #2``.
    """
    count = 6
    loads = np.zeros((count, 4))
    loads[3, 0] = 0.5
    stands = MeasuredStands(
        "plan.csv",
        ("a", "a", "a", "a", "a", "a #2"),
        ("hip",),
        np.zeros((count, 1)),
        np.arange(count)[:, None] * 1e-4,
        swing=((), ("FL",), (), (), (), ()),
        heading=np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0]),
        added={"base": loads},
    ).make_names_unique()
    assert stands.names == ("a", "a #3", "a #4", "a #5", "a", "a #2")
    averaged = stands.average_repeats({"hip": "rad"})
    assert averaged.names == ("a", "a #3", "a #4", "a #5", "a #2")
    assert averaged.position[0, 0] == pytest.approx(2e-4)
