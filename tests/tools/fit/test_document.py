"""The pages of fits and plans: each number in its own column, in the unit of its header."""

from __future__ import annotations

import math

import numpy as np
import pytest

from pupper_analysis.present import document as doc
from pupper_analysis.present.document import (
    Cell,
    Document,
    Name,
    Number,
    Table,
)
from pupper_analysis.present.documents.registry import document
from pupper_analysis.tools.fit.estimate import Posterior
from pupper_analysis.tools.fit.parameters import Parameter
from pupper_analysis.tools.fit.result import (
    Estimate,
    Expected,
    MotionFit,
    Together,
    Told,
    describe_parameters,
)
from pupper_analysis.tools.fit.stands.plan import PlannedStand, StandPlan
from pupper_analysis.tools.fit.stands.result import JointResidual, StandFit

PARAMETERS = (
    Parameter("offset", "knee", "", 0.01, 0.035),
    Parameter("offset", "hip", "", 0.0, 0.035),
    Parameter("com", "base", "x", 0.02, 0.03),
    Parameter("slope", "floor", "y", 0.0, 0.0035),
)
MEAN = np.array([0.03, -0.02, 0.05, 0.001])
STD = np.array([0.004, 0.002, 0.005, 0.0034])


def posterior() -> Posterior:
    """Knee and hip are off against each other by 0.8; the com is told in part, the slope hardly."""
    correlation = np.eye(4)
    correlation[0, 1] = correlation[1, 0] = -0.8
    return Posterior(
        parameters=PARAMETERS,
        mean=MEAN,
        covariance=correlation * np.outer(STD, STD),
        information=np.eye(4),
        precision=np.eye(4),
        chi2=30.0,
        moved=np.array([1.0, -1.0, 1.0, 0.3]),
        rows=40,
        steps=3,
    )


TOGETHER = (Together(("kp knee", "mass calf"), True, 0.1, {"weigh-the-robot": 12.34}),)


def stand_fit() -> StandFit:
    known = posterior()
    return StandFit(
        name="dog",
        source="stands.csv",
        estimates=tuple(describe_parameters(known)),
        together=TOGETHER,
        failures=(),
        diagnostics=(),
        posterior=known,
        stands=12,
        total_mass=Estimate(
            "mass dog", "mass", "dog", "", "kg", 3.0, 3.5, 0.1, 3.304, 3.696, Told.DATA
        ),
        residuals={"s1": 0.5, "s2": 1.5},
        joint_residuals=(
            JointResidual("s2", "knee", -0.004, -3.2),
            JointResidual("s1", "hip", 0.001, 0.7),
        ),
        chi2=30.0,
        freedom=38.0,
        noise={"encoder": 1e-4},
    )


def tables(page: Document) -> dict[float | str, Table]:
    return {shown(block.title): block for block in page.blocks if isinstance(block, Table)}


def shown(cell: Cell) -> float | str:
    if isinstance(cell, Number):
        return cell.value
    return cell.text if isinstance(cell, Name) else cell.en


def columns(table: Table) -> dict[str, list[float | str]]:
    """{header and unit: what is shown}."""
    return {
        f"{shown(one.name)} {one.unit}".strip(): [shown(row[at]) for row in table.rows]
        for at, one in enumerate(table.columns)
    }


def lines(page: Document) -> str:
    return "\n".join(getattr(line, "en", "") for line in page.told)


def test_stated_fitted_and_intervals_are_each_in_their_column() -> None:
    found = tables(document(stand_fit()))
    offsets = columns(found["Zero offsets of encoders: measured less true"])
    assert offsets["parameter"] == ["offset knee", "offset hip"]
    assert offsets["in the file deg"] == pytest.approx([math.degrees(0.01), 0.0])
    assert offsets["fitted deg"] == pytest.approx(np.degrees(MEAN[:2]).tolist())
    assert offsets["± (95 %) deg"] == pytest.approx((1.96 * np.degrees(STD[:2])).tolist(), rel=1e-3)
    assert offsets["difference deg"] == pytest.approx([math.degrees(0.02), math.degrees(-0.02)])
    assert offsets["told by"] == ["measurements", "measurements"]
    com = columns(found["Centres of mass, in the links' frames"])
    assert com["fitted mm"] == pytest.approx([50.0])
    surroundings = columns(found["Surroundings: ground, feet and IMU"])
    assert surroundings["told by"] == ["prior"]


def test_what_is_left_and_what_is_off_together_is_told_with_its_sign() -> None:
    page = document(stand_fit())
    found = tables(page)
    left = columns(found["Joints that are explained worst"])
    assert left["stand"] == ["s2", "s1"]
    assert left["joint"] == ["knee", "hip"]
    assert left["measured less predicted mrad"] == pytest.approx([-4.0, 1.0])
    assert left["in standard deviations 1"] == pytest.approx([-3.2, 0.7])
    off = columns(found["Parameters that are off together"])
    assert (off["parameter"], off["other parameter"]) == (["offset knee"], ["offset hip"])
    assert off["correlation 1"] == pytest.approx([-0.8])
    told = lines(page)
    assert "3.500 ± 0.196 kg (95 %); the file says 3.000 kg" in told
    assert "knee in stand s2, -4.00 mrad" in told
    assert "3.2 times" in told
    assert "only the ratio is told of kp knee, mass calf" in told.lower()
    assert "weigh the robot (--weight) (12.3 times narrower)" in told
    (bars,) = (one for one in page.blocks if isinstance(one, doc.BarPlot))
    assert [bar.value for bar in bars.bars] == [1.5, 0.5]


def test_the_held_out_error_is_told_first() -> None:
    known = posterior()
    fit = MotionFit(
        name="dog",
        source="hang.csv",
        estimates=tuple(describe_parameters(known)),
        together=(),
        failures=(),
        diagnostics=(),
        posterior=known,
        seconds=12.5,
        held_out=0.002,
        held_out_before=0.007,
        fitted=0.001,
        fitted_before=0.006,
        repeatability=0.0015,
        by_joint={"knee": 0.003, "hip": 0.001},
        encoder_noise={"knee": 0.0004, "hip": 0.0005},
        steps=2,
    )
    page = document(fit)
    first, second, third, *_ = lines(page).splitlines()
    assert "predicted to 2.00 mrad" in first
    assert "to 7.00 mrad" in first
    assert "1.50 mrad" in second
    assert "12.5 s of" in third
    (bars,) = (one for one in page.blocks if isinstance(one, doc.BarPlot))
    assert [(bar.value, bar.other) for bar in bars.bars] == [(3.0, 0.4), (1.0, 0.5)]


def test_a_plan_shows_commands_in_degrees_and_intervals_before_and_after() -> None:
    plan = StandPlan(
        name="dog",
        stands=(
            PlannedStand("s01", (), "above", {"knee": 0.5, "hip": -0.1}, 0.25),
            PlannedStand("s02", ("FL",), "below", {"knee": 0.6, "hip": -0.2}, 0.5),
        ),
        expected=(Expected("offset knee", "rad", 0.0, 0.07, 0.01, Told.PARTLY),),
        candidates=72,
        gain=10.0,
    )
    found = tables(document(plan))
    stands = columns(found["Stands to take"])
    assert stands["feet in the air"] == ["", "FL"]
    assert stands["come from"] == ["above", "below"]
    assert stands["utilisation %"] == pytest.approx([25.0, 50.0])
    assert stands["knee deg"] == pytest.approx(np.degrees([0.5, 0.6]).tolist())
    assert stands["hip deg"] == pytest.approx(np.degrees([-0.1, -0.2]).tolist())
    expected = columns(found["What they will tell"])
    assert expected["± before (95 %)"] == pytest.approx([math.degrees(0.07)])
    assert expected["± after (95 %)"] == pytest.approx([math.degrees(0.01)])
    assert expected["unit"] == ["deg"]
