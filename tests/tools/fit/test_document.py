"""Documents of fits and plans equal golden files; all their numbers are different."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pupper_analysis.base.diagnostics import Quantity, diagnose
from pupper_analysis.present.document import (
    MAX_ANSWER_WIDTH,
    BarPlot,
    Name,
    Text,
    diagnostic_text,
    get_english,
    text,
)
from pupper_analysis.present.documents.registry import build_report, make_document
from pupper_analysis.present.markdown import write_markdown
from pupper_analysis.tools.fit.command import _select_next_step
from pupper_analysis.tools.fit.estimate import Posterior
from pupper_analysis.tools.fit.parameters import PARAMETER_KINDS, SURROUNDINGS_KINDS, Parameter
from pupper_analysis.tools.fit.record.recorder import Recording
from pupper_analysis.tools.fit.result import (
    Determined,
    Estimate,
    MotionFit,
    describe_parameter,
    describe_parameters,
)
from pupper_analysis.tools.fit.stands.fit import JointResidual, StandFit
from pupper_analysis.tools.fit.stands.plan import PlannedStand, StandPlan

GOLDEN = Path(__file__).parent / "golden"

PARAMETERS = (
    Parameter("offset", "knee", "", 0.01, 0.035),
    Parameter("offset", "hip", "", 0.0, 0.035),
    Parameter("com", "base", "x", 0.02, 0.03),
    Parameter("slope", "floor", "y", 0.0, 0.0035),
)
MEAN = np.array([0.03, -0.02, 0.05, 0.001])
STD = np.array([0.004, 0.002, 0.005, 0.0034])


def posterior() -> Posterior:
    """Return a posterior with a correlation of -0.8 between knee and hip, a partly determined CoM,
    and a nearly undetermined slope.
    """
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
    )


FACTOR = Estimate("kp servos", "kp", "servos", "", "1", 1.0, 0.9, 0.01, 0.88, 0.92, Determined.DATA)


def stand_fit() -> StandFit:
    known = posterior()
    return StandFit(
        name="dog",
        source="stands.csv",
        estimates=tuple(describe_parameters(known)),
        failures=(),
        diagnostics=(),
        posterior=known,
        stands=12,
        total_mass=Estimate(
            "mass dog", "mass", "dog", "", "kg", 3.0, 3.5, 0.1, 3.304, 3.696, Determined.DATA
        ),
        com=tuple(
            Estimate(
                f"com.{axis} dog", "com", "dog", axis, "m", 0.01, at, 1e-3, at - 2e-3, at + 2e-3, ""
            )
            for axis, at in (("x", 0.012), ("y", -0.001), ("z", 0.005))
        ),
        kp_factor=FACTOR,
        kp_over_mass=FACTOR,
        weight=3.5,
        residuals={"s1": 0.5, "s2": 1.5},
        joint_residuals=(
            JointResidual("s2", "knee", -0.004, -3.2),
            JointResidual("s1", "hip", 0.001, 0.7),
        ),
        noise={"encoder": 1e-4},
    )


def motion_fit() -> MotionFit:
    known = posterior()
    return MotionFit(
        name="dog",
        source="hang.csv",
        estimates=tuple(describe_parameters(known)),
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
        kp_over_mass=FACTOR,
    )


def stand_plan() -> StandPlan:
    return StandPlan(
        name="dog",
        stands=(
            PlannedStand("s01", (), {"knee": 0.5, "hip": -0.1}, 0.25),
            PlannedStand("s02", ("FL",), {"knee": 0.6, "hip": -0.2}, 0.5),
        ),
        expected=(describe_parameter(PARAMETERS[0], 0.01, 0.02, Determined.PARTLY),),
        candidates=72,
    )


RESULTS = {"stands": stand_fit, "motions": motion_fit, "plan": stand_plan}


@pytest.mark.parametrize("name", RESULTS)
def test_documents_equal_the_golden_files(name: str) -> None:
    """``python -m tests.tools.fit.test_document`` writes them anew: read their diff."""
    assert write_document(name) == (GOLDEN / f"{name}.md").read_text(encoding="utf-8")


def test_plan_counts_the_determined_parameters_by_kind() -> None:
    """Reference: two masses are determined by measurements alone, one in part by the prior."""
    known = describe_parameter(PARAMETERS[0], 0.01, 0.02, Determined.DATA)
    plan = replace(stand_plan(), expected=(known, known, *stand_plan().expected))
    line = getattr(make_document(plan).findings[0], "short", "")
    assert line.startswith("2 stands, 4 angles; 2 of 3 parameters (2 of them ")
    assert line.endswith(f"(2 of them {known.kind}) narrowed to ≤1/3")


def test_plan_states_what_more_stands_determine_and_what_needs_a_known_value() -> None:
    """All candidates determine 4 of 5 parameters; a plan of 2 stands determines 1."""
    known = describe_parameter(PARAMETERS[0], 0.01, 0.02, Determined.DATA)
    unknown = replace(known, determined=Determined.PRIOR)
    plan = replace(
        stand_plan(), expected=(known, *4 * (unknown,)), determined_by_all={known.kind: 4}
    )
    assert plan.more_stands_help
    line = getattr(make_document(plan).findings[1], "short", "")
    expected = f"72 stands would narrow 4; for 1 more ({known.kind}), state measured values"
    assert line == f"{expected} with --prior"
    enough = replace(plan, determined_by_all={known.kind: 1})
    assert not enough.more_stands_help


def write_document(name: str) -> str:
    return write_markdown(build_report([("", RESULTS[name]())]))


@pytest.mark.parametrize(
    "kind",
    [
        parameter_kind
        for parameter_kind in PARAMETER_KINDS
        if parameter_kind not in SURROUNDINGS_KINDS
    ],
)
def test_each_kind_of_number_that_may_be_determined_has_a_table(kind: str) -> None:
    name = Parameter(kind, "servos", "", 1.0, 0.1)
    known = describe_parameter(name, 1.5, 0.01, Determined.DATA)
    fit = replace(motion_fit(), estimates=(known,))
    assert f"{kind} servos" in write_markdown(build_report([("", fit)]))


def test_bars_show_the_residuals() -> None:
    bars = [
        [(bar.value, bar.marker) for block in make_document(fit).blocks
         if isinstance(block, BarPlot) for bar in block.bars]
        for fit in (stand_fit(), motion_fit())
    ]  # fmt: skip
    degrees = [(math.degrees(3e-3), math.degrees(4e-4)), (math.degrees(1e-3), math.degrees(5e-4))]
    assert bars[0] == [(1.5, None), (0.5, None)]
    assert np.array(bars[1]) == pytest.approx(np.array(degrees))


if __name__ == "__main__":
    GOLDEN.mkdir(exist_ok=True)
    for name in RESULTS:
        (GOLDEN / f"{name}.md").write_text(write_document(name), encoding="utf-8")


def test_second_lines_of_a_plan_and_of_a_recording_fit_a_terminal() -> None:
    """Both had more than 150 characters; `MAX_ANSWER_WIDTH` is the limit."""
    place = {"mass": "0.4755", "link": Name("base_link"), "x": "-10.0", "y": "-10.0", "z": "110.8"}
    planned = text("put-it-there", stands=12, **place)
    angle = Quantity(math.radians(0.1516), "rad")
    friction = diagnose("friction-of-joints", joint="leg_front_l_3", angle=angle)
    recorded = diagnostic_text(friction)
    for line, kept in ((planned, "0.4755 kg on base_link"), (recorded, "0.152 deg")):
        assert kept in line.short
        assert len(line.short) < MAX_ANSWER_WIDTH < len(line.en)


def test_counts_of_a_recording_are_those_of_its_stands() -> None:
    """All counts differ, so that an exchange is found; with and without missing stands."""
    recording = Recording(
        name="dog", file="s.csv", recorded_stands=("a", "b"), existing_stands=("c",),
        missing_stands=("d", "e", "f"), friction_angles={}, findings=(),
    )  # fmt: skip
    summary = get_english(make_document(recording).failures[0])
    assert summary.startswith("2 stands recorded, 1 were in s.csv before, 3 missing")
    complete = make_document(replace(recording, missing_stands=()))
    assert get_english(complete.findings[0]).startswith("2 stands recorded, 1 were in s.csv before")


def test_weight_equal_to_the_mass_of_the_file_is_no_confirmation() -> None:
    """The fitted mass repeats the input; with another weight, input and file are both stated."""
    fit = replace(stand_fit(), weight=3.5)
    weighed = get_english(make_document(fit).findings[1])
    assert (
        weighed == "total mass 3.500 ± 0.196 kg (95 %) with --weight 3.5 kg, in the file 3.000 kg"
    )
    repeated = make_document(replace(fit, weight=3.0)).findings[1]
    assert isinstance(repeated, Text)
    assert "repeats --weight 3 kg, the value of the file" in get_english(repeated)
    assert (
        repeated.short
        == "mass 3.500 ± 0.196 kg repeats --weight, the file's value: no confirmation"
    )
    assert len(f"  {repeated.short}") <= MAX_ANSWER_WIDTH


def test_an_unweighed_fit_states_mass_and_kp_first_and_proposes_to_weigh() -> None:
    """Reference: the estimates, and the stated total mass of 3 kg."""
    mass = replace(stand_fit().total_mass, determined=Determined.PARTLY)
    fit = replace(stand_fit(), weight=None, total_mass=mass)
    first, second, *_ = make_document(fit).findings
    assert isinstance(first, Text)
    assert isinstance(second, Text)
    assert first.short == (
        "mass 3.50 ± 0.20 kg (95 %; file 3.00), mean kp 0.900 ± 0.020 times the file's"
    )
    assert second.short.startswith("these stands do not determine the mass: weigh the robot")
    step = _select_next_step(fit, None)
    assert step is not None
    assert step.words == ("--weight", "3kg")
    determined = replace(stand_fit(), weight=None)
    step = _select_next_step(determined, None)
    assert step is not None
    assert "--weight" not in step.words
