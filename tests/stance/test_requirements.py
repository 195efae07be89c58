"""Relaxation of requirements: resets to the nominal stand, limits of refusals, and their
descriptions.
"""

from __future__ import annotations

import math
import pickle
from dataclasses import replace

import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.stance.requirements import (
    RELAXABLE_REQUIREMENTS,
    RequirementVector,
    describe_limit,
    differs_from_nominal,
    relax_further,
    reset_to_nominal,
    round_outward,
)
from tests.support.variants import load

TASK = pa.StandTask(
    height=0.15,
    roll=0.2,
    pitch=-0.4,
    offset=(0.02, -0.04),
    foot_offsets={"FL": (0.02, 0.01)},
    swing={"RR": 0.02},
    ground=pa.Ground(0.1, 0.5, {"FR": 0.02}),
    ground_clearance=0.01,
)


@pytest.mark.parametrize(
    "task",
    [
        TASK,
        replace(TASK, offset=None, com=(0.01, 0.02), com_margin=0.01, self_clearance=0.005),
        pa.StandTask(feet={"FL": (0.1, 0.1)}, roll=0.1, com="inside", joint_margin=0.05),
    ],
)
def test_tasks_without_checks_equal_checked_tasks_in_values_and_types(task: pa.StandTask) -> None:
    """Reference: `make_task`, which checks and converts each value."""
    numbers = RequirementVector(load("v3"), task, RELAXABLE_REQUIREMENTS)
    values = numbers.clip(0.9 * numbers.values)
    checked, unchecked = (numbers.make_task(values, checked=check) for check in (True, False))
    assert checked == unchecked != task
    for name, value in vars(checked).items():
        assert type(vars(unchecked)[name]) is type(value), name


def test_requirement_vector_and_task_convert_into_each_other() -> None:
    """Reference: the task, and the fields that are changed by 10 mm."""
    robot = load("v3")
    numbers = RequirementVector(robot, TASK, RELAXABLE_REQUIREMENTS)
    assert numbers.make_task(numbers.values) == TASK
    np.testing.assert_array_equal(numbers.read_task(TASK), numbers.values)
    numbers = RequirementVector(robot, TASK, ["height", "foot_offsets", "ground"])
    less = numbers.values - 0.01
    moved = numbers.make_task(less)
    assert moved.height == 0.15 - 0.01
    assert moved.foot_offsets == {"FL": (0.02 - 0.01, 0.0)}
    assert moved.ground.heights == {"FR": 0.02 - 0.01}
    np.testing.assert_array_equal(numbers.read_task(moved), less)
    assert not differs_from_nominal(robot, pa.StandTask(yaw=0.3), ["roll", "height", "ground"])
    assert differs_from_nominal(robot, pa.StandTask(yaw=0.3), ["roll", "yaw"])


@pytest.mark.parametrize("requirement", RELAXABLE_REQUIREMENTS)
def test_reset_of_one_requirement_keeps_the_other_requirements(requirement: str) -> None:
    """Reference: nominal values per requirement, by hand; all other fields equal those of the
    task.
    """
    robot = load("v3")
    without = reset_to_nominal(robot, TASK, [requirement])
    for kept in set(RELAXABLE_REQUIREMENTS) - {requirement}:
        assert getattr(without, kept) == getattr(TASK, kept)
    expected = {
        "height": robot.stand_height,
        "roll": 0.0,
        "pitch": 0.0,
        "offset": (0.0, 0.0),
        "foot_offsets": {"FL": (0.0, 0.0)},
        "ground": pa.Ground(0.0, 0.5, {"FR": 0.0}),
        "ground_clearance": 0.0,
    }
    if requirement in expected:
        assert getattr(without, requirement) == expected[requirement]
    elif requirement == "swing":
        assert 0 < without.swing["RR"] < 1e-4  # a foot that is not lifted would carry
    else:
        assert without == TASK


def test_reset_places_are_those_of_the_nominal_stand() -> None:
    """Feet are reset to nominal positions, the CoM to the centre of the loaded feet."""
    robot = load("v3")
    feet = pa.Configuration(robot, robot.neutral()).foot_positions()
    placed = reset_to_nominal(robot, pa.StandTask(feet={"FL": (0.1, 0.1)}), ["feet"])
    np.testing.assert_allclose(placed.feet["FL"], feet["FL"][:2])
    middle = np.mean([feet[foot][:2] for foot in ("FR", "FL", "RR")], axis=0)
    task = pa.StandTask(com=(0.03, 0.01), swing={"RL": 0.01})
    np.testing.assert_allclose(reset_to_nominal(robot, task, ["com"]).com, middle)


def describe_requirements(task: pa.StandTask, *requirements: str) -> str:
    return str(describe_limit(load("v3"), task, task, requirements))


def test_requirements_are_described_with_units() -> None:
    """Reference: texts written by hand."""
    assert describe_requirements(TASK, "height") == "height 150 mm"
    turned = pa.StandTask(roll=math.radians(11.5), pitch=math.radians(-4.25), joint_margin=0.02)
    assert describe_requirements(turned, "roll") == "roll 11.5 deg"
    assert describe_requirements(turned, "pitch") == "pitch -4.25 deg"
    assert describe_requirements(TASK, "offset") == "offset (0.02, -0.04) m"
    slope = pa.StandTask(ground=pa.Ground(math.radians(5.7), 0.5, {"FR": 0.02}))
    assert describe_requirements(slope, "ground") == "ground slope 5.7 deg, steps FR 20 mm"
    assert (
        describe_requirements(TASK, "swing", "ground_clearance")
        == "swing RR 20 mm and ground_clearance 10 mm"
    )
    assert describe_requirements(TASK, "foot_offsets") == "foot_offsets FL (0.02, 0.01) m"
    assert (
        describe_requirements(pa.StandTask(com=(0.0123, -0.004)), "com") == "com (0.0123, -0.004) m"
    )


def test_round_outward_moves_away_from_the_request_by_one_digit() -> None:
    """Reference: values rounded by hand; rounding twice changes nothing."""
    robot = load("v3")  # which stands at 0.1315 m
    requested_task = pa.StandTask(
        height=0.25, roll=0.8, pitch=-0.8, swing={"FL": 0.1}, joint_margin=0.8, com_margin=0.02
    )
    task = replace(
        requested_task, height=0.19247, roll=0.33651, pitch=-0.12345, swing={"FL": 0.00123456},
        joint_margin=0.4003,
    )  # fmt: skip
    requirements = ("height", "roll", "pitch", "swing", "joint_margin", "com_margin")
    near = round_outward(robot, task, requested_task, requirements)
    assert near.height == 0.1924
    low = replace(requested_task, height=0.05)
    assert round_outward(robot, replace(low, height=0.10013), low, ["height"]).height == 0.1002
    assert math.degrees(near.roll) == pytest.approx(19.28)  # 19.2806
    assert math.degrees(near.pitch) == pytest.approx(-7.07)  # -7.0732
    assert near.swing["FL"] == pytest.approx(0.001234)
    assert near.joint_margin <= task.joint_margin
    assert near.com_margin == 0.02  # not relaxed
    assert round_outward(robot, near, requested_task, requirements) == near


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "task"),
    [
        (
            "v3-heavy",
            pa.StandTask(
                height=0.10822022826741418,
                pitch=-0.6822468279746785,
                foot_offsets={"FR": (-0.0068000657982635795, 0.0076523052175465345)},
                swing={"FL": 0.0170867879027447},
                ground=pa.Ground(slope=0.7891893415388722),
            ),
        ),
        (
            "long-leg",
            pa.StandTask(
                height=0.20047667468034105,
                pitch=-0.2372697394099059,
                foot_offsets={"FR": (-0.0005147, 0.0306285), "RL": (-0.0123176, -0.0195083)},
                swing={"FR": 0.019351277718355632},
                ground=pa.Ground(slope=0.6871469943880313),
                com="inside",
                com_margin=0.00577389212896338,
            ),
        ),
        (
            "long-leg",
            pa.StandTask(
                height=0.18864414326309378,
                pitch=-0.07161810094888375,
                yaw=-0.04777819716249121,
                ground=pa.Ground(slope=0.9055428657837088),
                com="inside",
                com_margin=0.011435812887292361,
            ),
        ),
    ],
)
def test_limits_of_a_refusal_are_solvable_as_printed(name: str, task: pa.StandTask) -> None:
    """Also limits of several requirements together, and of stretched legs.

    The limits are found by a continuation from other stands; a direct solution reaches them too.
    """
    robot = load(name)
    with pytest.raises(pa.StanceUnreachableError) as refusal:
        pa.solve_stand(robot, task)
    assert refusal.value.limits
    for limits in refusal.value.limits.values():
        pa.solve_stand(robot, replace(task, **limits), explain=False)


@pytest.mark.slow
def test_limit_with_the_com_in_a_corner_of_its_margin_is_exact() -> None:
    """Reference: the search of `benchmarks/stances.py`, whose foot error grows linearly from 0.928
    of the requested offset.

    Two sides of the polygon and a joint limit leave the CoM a region of micrometres. A foot error
    of 1.1e-9 m in this region must not lead to a refusal at 20.2 mm.
    """
    robot = load("long-leg")
    requested_task = (-0.004224475907640465, 0.023015633521621552)
    task = pa.StandTask(
        height=0.18910681117390918,
        roll=-0.28802833981860326,
        pitch=-0.12839206449277496,
        foot_offsets={"RL": requested_task},
        ground=pa.Ground(slope=0.2940132075147636, uphill=1.8174623854748546),
        com="inside",
        com_margin=0.02045218504679281,
    )
    with pytest.raises(pa.StanceUnreachableError) as refusal:
        pa.solve_stand(robot, task)
    limit = refusal.value.limits["foot_offsets"]["foot_offsets"]["RL"]
    relaxed = np.abs(np.subtract(limit, requested_task)).sum()
    straight = (1 - 0.928) * np.abs(requested_task).sum()  # in x and y by the same share
    assert straight / 2 < relaxed < straight + 2e-4  # x and y are rounded by up to 0.1 mm
    reached = 0
    for share in np.linspace(0.86, 0.926, 12):
        place = {"RL": (share * requested_task[0], share * requested_task[1])}
        reached += pa.solve_stand(robot, replace(task, foot_offsets=place), explain=False).solved
    assert reached == 12


def test_refusal_states_the_request_in_both_languages() -> None:
    """The refusal is pickled first, as between processes."""
    with pytest.raises(pa.StanceUnreachableError) as refused:
        pa.solve_stand(pa.load_variant("v3"), pa.StandTask(height=0.4, swing={"FL": 0.02}))
    message = pickle.loads(pickle.dumps(refused.value)).diagnostic
    assert "height 400.0 mm" in message.text("en")
    chinese = message.text("zh")
    assert "高度 400.0 mm" in chinese
    assert "FL 抬起 20 mm" in chinese
    assert "height" not in chinese


def test_relax_further_extends_the_relaxation_by_a_share_of_it() -> None:
    """Reference: value + share (value - requested value), per requirement."""
    requested = pa.StandTask(height=0.16, roll=0.4, pitch=0.1)
    task = replace(requested, height=0.15, roll=0.3)
    further = relax_further(load("v3"), task, requested, ["height", "roll"], 0.5)
    assert further.height == pytest.approx(0.145)
    assert further.roll == pytest.approx(0.25)
    assert further.pitch == 0.1


def test_bounds_of_an_offset_grow_with_the_stand_height() -> None:
    """Bounds are centred at the value; their width is proportional to the height of the stand."""
    widths, heights = [], []
    for name in ("original", "long-leg"):
        robot = load(name)
        numbers = RequirementVector(robot, pa.StandTask(offset=(0.01, 0.0)), ["offset"])
        low, high = numbers.clip(np.full(2, -1e3))[0], numbers.clip(np.full(2, 1e3))[0]
        assert (low + high) / 2 == pytest.approx(0.01)
        widths.append(high - low)
        heights.append(robot.stand_height)
    assert heights[1] > 1.1 * heights[0]
    assert widths[1] / widths[0] == pytest.approx(heights[1] / heights[0])
    assert widths[0] > 2 * heights[0]


def test_bounds_of_a_negative_height_contain_the_height() -> None:
    """A task with contacts may require a height below the feet; a refusal raised a ValueError."""
    robot, table = load("v3"), pa.Contact(pa.Plane((0, 0, 0.3), (0, 0, 1)))
    task = pa.StandTask(height=-0.1, contacts={"FR": table})
    numbers = RequirementVector(robot, task, ["height"])
    far = 3 * robot.stand_height
    assert (numbers.low[0], numbers.high[0]) == pytest.approx((-0.1 - far, -0.1 + far))
    positive = RequirementVector(robot, replace(task, height=0.1), ["height"])
    assert positive.low[0] == pytest.approx(1e-4)


def test_round_outward_removes_rounding_errors_at_the_nominal_value() -> None:
    """A table that is lowered to the ground is reported at 0, and not at -1e-12 mm."""
    requested, relaxed = (
        pa.StandTask(contacts={"FR": pa.Contact(pa.Plane((0, 0, height), (0, 0, 1)))})
        for height in (0.3, -1e-15)
    )
    rounded = round_outward(load("v3"), relaxed, requested, ["contacts"])
    assert rounded.contacts["FR"].parameters == (0.0,)
