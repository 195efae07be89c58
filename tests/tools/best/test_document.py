"""The document of a search for the best stance."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.cli import find_command
from pupper_analysis.cli.stance_fields import OPTION_FIELDS, make_task
from pupper_analysis.present.document import (
    MAX_ANSWER_WIDTH,
    Document,
    NextStep,
    Table,
    Text,
    get_english,
)
from pupper_analysis.tools.best.document import (
    _describe_active_bounds,
    _make_next_step,
    _make_search_line,
    _shorten_coordinates,
    best_document,
)
from pupper_analysis.tools.best.search import Objective
from pupper_analysis.tools.best.space import ActiveBound, BoundKind
from pupper_analysis.tools.stand.document import stance_document
from tests.support.stubs import best, make_payload_result, stance
from tests.support.variants import load


def list_titles(document: Document) -> set[str]:
    """Return the titles of the tables."""
    return {get_english(block.title) for block in document.blocks if isinstance(block, Table)}


def test_best_stance_is_described_as_a_stance_alone() -> None:
    """All tables, findings and details of the document of a stance occur."""
    found, alone = best_document(best()), stance_document(stance())
    assert list_titles(alone)
    assert list_titles(alone) < list_titles(found)
    texts, expected = (
        {get_english(line) for line in (*document.findings, *document.details)}
        for document in (found, alone)
    )
    assert expected <= texts


def test_utilisation_is_stated_with_motor_and_torque() -> None:
    """Reference: torque and joint of the stand's most loaded motor; a long name fits 100 columns.

    ``MAX_ANSWER_WIDTH`` includes the verdict and the name of the robot, 35 characters for Go2.
    """
    study = best()
    study.best.objective = Objective.UTILISATION
    line = best_document(study).findings[0]
    load = get_english(stance_document(study.stance).findings[0])
    assert isinstance(line, Text)
    joint = load.rpartition("(")[2]
    torque = load.removeprefix("largest motor load ").partition(" =")[0]
    assert line.short == f"load {torque} = 4.56 % of the limit ({joint}; was 3.45 %"
    assert line.en.startswith(f"largest motor load {torque} = 4.56 % of the limit ({joint},")
    assert len("HOLDS (URDF only) go2_description: ") + len(line.short) < MAX_ANSWER_WIDTH


def test_next_step_is_gains_if_stand_proposes_gains() -> None:
    """`stand` proposes gains if kd exceeds the bound of an explicit PD controller."""
    study = best()
    study.passed = True
    words = ("--height", "104.4mm", "--roll", "1deg")
    for step, command in ((NextStep("payload"), "path"), (NextStep("gains"), "gains")):
        expected = NextStep(command, stance_found=True, stance_words=words)
        assert _make_next_step(study, step) == expected


@pytest.mark.parametrize(
    ("objective", "line"),
    [("utilisation", "initial stance"), ("margin", "CoM margin 45.6 mm"), ("payload", "payload")],
)
def test_search_without_improvement_states_this_and_proposes_no_repetition(
    objective: str, line: str
) -> None:
    """`best payload` of Go2 printed 68.08 kg twice, and proposed the search again."""
    study = best()
    study.passed, study.best.improved = True, False
    study.best.objective = Objective(objective)
    if objective == "payload":
        study.best.payload = make_payload_result()
    short = _make_search_line(study).short
    assert line in short
    assert short.endswith("no improvement over the initial stance")
    assert not list(_describe_active_bounds(study.best))
    step = _make_next_step(study, NextStep("payload"))
    assert step == NextStep("push" if objective == "payload" else "payload")


def test_margin_names_the_bounds_that_limit_it() -> None:
    """The largest step of a foot is 48 mm; without an active bound the optimum is local."""
    study = best()
    (free,) = _describe_active_bounds(study.best)
    assert free.en == "limit: no bound of the search (a local optimum)"
    study.best.active_bounds = (
        ActiveBound(BoundKind.JOINT, "knee", 0.02),
        ActiveBound(BoundKind.STEP, "FR x", -0.048),
        ActiveBound(BoundKind.STEP, "FL x", 0.047),
    )
    (line,) = _describe_active_bounds(study.best)
    steps = "feet at the search bound (steps of 48 mm)"
    assert line.short == f"limit: knee at the joint limit, {steps}"
    assert line in best_document(study).findings


@pytest.mark.slow
def test_bounds_that_limit_a_margin_are_reached_and_its_options_hold_the_stance() -> None:
    """The largest step is `MAX_OUTWARD_STEP` of the largest height; `solve_stand` is the reference.

    The rounded options of the next command give the margin that `best` prints.
    """
    robot = load("v3")
    found = pa.best_stance(robot, "margin")
    steps = [bound for bound in found.active_bounds if bound.kind is BoundKind.STEP]
    assert len(steps) >= 4
    for bound in steps:
        interval = found.bounds[bound.name]
        assert abs(bound.value) == pytest.approx(max(-interval.low, interval.high), rel=1e-3)
    step = _make_next_step(SimpleNamespace(best=found, passed=True), None)
    params = find_command("stand").make_context("stand", ["v3", *step.stance_words]).params
    stand = pa.solve_stand(robot, make_task({name: params[name] for name in OPTION_FIELDS}))
    assert stand.com_margin == pytest.approx(found.value, abs=3e-4)  # rounded to 0.1 mm


def test_next_step_of_a_failing_stance_searches_again_with_the_gains_that_hold() -> None:
    """Reference: the gains that `stand` proposes; without gains, `stand` states the cause."""
    gains = ("--kp", "leg_*_1=10", "--kd", "leg_*_1=0.2")
    assert _make_next_step(best(), NextStep("stand", gains)) == NextStep("best", ("margin", *gains))
    for step in (None, NextStep("stand", ("--minimum-stiffness",))):
        assert _make_next_step(best(), step) == NextStep("stand")


@pytest.mark.parametrize("compensated", [True, False])
def test_best_payload_states_that_it_needs_gravity_compensation(compensated: bool) -> None:
    """v3: the mass in the best stance, and in the stance as given, each in its place."""
    study = best()
    study.best.objective = Objective.PAYLOAD
    study.best.value, study.best.nominal_value = 20.559, 6.679
    study.best.payload = make_payload_result()
    study.best.payload.depends_on_feedforward = compensated
    line = _make_search_line(study)
    condition = " gravity-compensated" if compensated else ""
    assert line.short == f"payload 20.55 kg{condition}; was 6.67 kg"
    assert ("with gravity compensation" in line.en) is compensated


def test_second_line_states_the_stance_found() -> None:
    """Reference: the coordinates of the search; the base moves by 13 mm, a foot by hypot(3, 4).

    Each coordinate of the base has its axis, also in a long list.
    """
    stand = SimpleNamespace(task=SimpleNamespace(height=0.1806))
    coordinates = {"height": 0.1806, "x": 0.0131, "pitch": np.radians(0.8), "FR x": 3e-3}
    best = SimpleNamespace(stand=stand, coordinates=coordinates | {"FR y": -4e-3, "yaw": 1e-9})
    line = _shorten_coordinates(best)
    assert line.en == "found: base height 180.6 mm, x +13 mm, pitch +1 deg; feet moved ≤5 mm"
    chinese = "机身高度 180.6 mm、x 方向 +13 mm、俯仰 +1 deg；足端移动 ≤5 mm"
    assert line.zh == f"最佳站姿：{chinese}"
    turned = {"x": 0.03, "y": 0.04, "roll": np.radians(-3), "pitch": np.radians(2)}
    best.coordinates |= turned | {"yaw": np.radians(-1)}
    line = _shorten_coordinates(best).en
    axes = "x +30, y +40 mm, roll -3, pitch +2, yaw -1 deg"
    assert line == f"found: base height 180.6 mm, {axes}; feet moved ≤5 mm"
    assert len(f"  {line}") <= MAX_ANSWER_WIDTH
