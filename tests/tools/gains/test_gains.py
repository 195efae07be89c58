"""Bounds of gains, against bare MuJoCo, closed forms and symmetry."""

from __future__ import annotations

import math
from dataclasses import fields, replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.base.units import HINGE_UNITS
from pupper_analysis.present.document import (
    MAX_ANSWER_WIDTH,
    NextStep,
    Number,
    Table,
    get_english,
    text,
)
from pupper_analysis.simulation.controlled_stand import ControlledStand
from pupper_analysis.simulation.rollout import make_stand_start
from pupper_analysis.stance.stand import stand_statics
from pupper_analysis.tools.gains.document import (
    _format_range,
    _make_bound_table,
    _make_class_table,
    _make_stable_region,
    gain_plot,
    gains_document,
)
from pupper_analysis.tools.gains.gains import (
    MAX_NOISE_RATIO,
    GainBound,
    GainStudy,
    JointClass,
    _choose_curve_factors,
    _Gains,
    group_joints,
    name_joints,
    study_gains,
)
from tests.base.test_results import assert_numbers_have_units
from tests.prepare.test_self_check import write_slip
from tests.support.every_command import Truth, simulate_truth
from tests.support.legged import quadruped_with_slides
from tests.support.printing import printed
from tests.support.variants import load, stand_of, write_without_a_mass


@pytest.mark.parametrize(
    ("gains", "text"),
    [
        ([5.0, 5.0], "5 N m/rad"),
        ([5.0, 5.0 + 1e-9], "5 N m/rad"),
        ([0.0, 7.5, 5.0], "5 to 7.5 N m/rad"),
        ([0.0], "0 N m/rad"),
    ],
)
def test_range_of_gains_with_equal_digits_is_a_single_number(gains: list[float], text: str) -> None:
    assert _format_range(gains, "N m/rad") == text


@cache
def gains_of(name: str) -> GainStudy:
    return study_gains(load(name), pa.StandTask(), error=0.2, encoder_bits=14)


@pytest.mark.slow
@pytest.mark.parametrize("name", pa.VARIANTS)
def test_bounds_of_variants_equal_the_simulated_bounds(name: str) -> None:
    """Reference: bisection in simulations of the unmodified model.

    v3-heavy has the largest deviation of the damping: its feet lift at 0.2 rad/s.
    """
    study = gains_of(name)
    for bound, tolerance in ((study.least_kp, 0.06), (study.largest_kd, 0.12)):
        assert bound.factor is not None
        assert bound.simulated is not None
        assert bound.simulated == pytest.approx(bound.factor, rel=tolerance)


@pytest.mark.slow
def test_least_stiffness_without_feedforward_is_that_of_the_steady_state() -> None:
    """Reference: `minimum_stiffness`, and the loads: without feed-forward the robot sags first."""
    study = gains_of("v3")
    assert study.least_kp_alone == pytest.approx(2.44, abs=0.03)
    assert study.least_kp.factor is not None
    assert study.least_kp.factor * 5.0 < study.least_kp_alone


@pytest.mark.slow
def test_stand_on_a_step_is_predicted_to_stand_without_feedforward_as_in_simulation() -> None:
    """Reference: a simulation with position commands alone, 12 s."""
    robot, task = load("v3"), pa.StandTask(ground=pa.Ground(heights={"FL": 0.02}))
    study = study_gains(robot, task)
    assert study.sag_failure is None
    assert pa.verify_stand(robot, study.stand, feedforward=False).passed
    assert study.least_kp_alone is not None
    assert study.least_kp_alone < 5.0


@pytest.mark.slow
def test_bounds_of_torque_and_encoder_equal_closed_forms() -> None:
    """Reference: limit / error, and 10 % of the limit per count of 2 pi / 2^14 in 2 ms."""
    study = gains_of("v3")
    assert study.classes
    for bounds in study.classes:
        assert bounds.largest_kp_of_torque == pytest.approx(3.0 / 0.2)
        count = 2 * math.pi / 2**14
        assert bounds.largest_kd_of_encoder == pytest.approx(MAX_NOISE_RATIO * 3.0 * 0.002 / count)


@pytest.mark.parametrize("bound", ["largest_kp_of_torque", "largest_kd_of_encoder"])
def test_bound_of_zero_is_a_bound(bound: str) -> None:
    """Reference: the limit of limit / error for a torque limit of zero; None means no bound."""
    joints = JointClass(
        name="*",
        joints=("a",),
        kp=5.0,
        kd=0.1,
        reference_kp=5.0,
        reference_kd=0.1,
        least_kp=None,
        largest_kd=None,
        largest_kd_alone=None,
        largest_kp_of_torque=None,
        largest_kd_of_encoder=None,
        recommended_kp=None,
        recommended_kd=None,
    )
    find = GainStudy.exceeded.fget
    assert find is not None
    assert find(SimpleNamespace(classes=(joints,))) == ()
    bounded = replace(joints, **{bound: 0.0})
    assert find(SimpleNamespace(classes=(bounded,))) == (bounded,)


@pytest.mark.slow
def test_recommended_gains_are_stable_with_their_margins() -> None:
    """Reference: the bounds, and `verify_stand` with the recommended gains."""
    study = gains_of("v3-heavy")
    kp, kd = study.classes[0].recommended_kp, study.classes[0].recommended_kd
    assert kp is not None
    assert kd is not None
    assert study.least_kp_alone is not None
    assert kp == pytest.approx(2 * study.least_kp_alone)
    assert kd <= study.classes[0].largest_kd / 2  # type: ignore[operator]
    robot = load("v3-heavy")
    assert pa.verify_stand(robot, pa.solve_stand_as_simulated(robot), kp=kp, kd=kd).passed


@pytest.mark.slow
def test_shaded_region_of_the_plot_is_stable_and_its_outside_is_not() -> None:
    """Reference: eigenvalues of the controlled stand at other gains, with a delay of 10 ms.

    The delay makes small dampings unstable, so that the region has a lower bound.
    """
    robot = load("v3")
    study = study_gains(robot, pa.StandTask(), kp=5.0, kd=0.1, delay=0.01)
    plot = gain_plot(study)
    assert get_english(plot.title) == "Stable gains: explicit PD at 500 Hz, delay 10 ms"
    assert plot.x.logarithmic
    assert plot.y.logarithmic
    series = {get_english(curve.name): curve for curve in plot.series}
    least = series["least kp"]
    assert set(least.x) == {study.least_kp_alone}  # type: ignore[arg-type]
    region = series["stable (linear model)"]
    assert region.shaded
    corners = np.column_stack([region.x, region.y])
    assert corners[:, 0].min() == study.least_kp_alone
    upper, lower = np.split(corners, 2)
    lower = lower[::-1]
    bounded = [index for index, (kp, kd) in enumerate(lower) if kd > lower[:, 1].min()]
    assert bounded  # at large stiffness
    kp, kd = lower[bounded[0]]
    most = upper[bounded[0], 1]
    loop = ControlledStand(make_stand_start(robot, study.stand, kp=5.0, kd=0.1), None, 0.01)
    dampings = (0.8 * kd, 1.2 * kd, 0.8 * most, 1.2 * most)
    stable = [loop.is_stable(np.full(12, kp), np.full(12, damping)) for damping in dampings]
    assert stable == [False, True, True, False]


@pytest.mark.parametrize("least", [0.0, 0.02, 0.1, 0.125, 0.3])
def test_curve_begins_at_the_least_stiffness_or_below(least: float) -> None:
    """Reference: 13 factors from 1/8 to 8. A gap between least kp and curve looked unstable."""
    factors = _choose_curve_factors(least)
    assert (np.diff(factors) > 0).all()
    assert factors[0] == pytest.approx(least if 0 < least < 0.125 else 0.125)
    np.testing.assert_allclose(factors[-13:], np.geomspace(1 / 8, 8, 13))


@pytest.mark.parametrize("least", [0.0, 2.0, 4.0, 9.0])
def test_stable_region_begins_at_the_least_stiffness(least: float) -> None:
    """Reference: the line kd = kp from 1 to 8, above a kd of 0.5."""
    kp = np.array([1.0, 2.0, 4.0, 8.0])
    region = _make_stable_region(kp, np.full(4, 0.5), kp, least)
    if least >= 8.0:
        assert not len(region)
        return
    start = max(least, 1.0)
    assert region[0] == pytest.approx((start, start))
    assert region[-1] == pytest.approx((start, 0.5))
    assert region[:, 0].max() == 8.0
    assert (np.diff(region[: len(region) // 2, 0]) > 0).all()


@pytest.mark.slow
def test_gains_beyond_the_bounds_do_not_pass() -> None:
    """Reference: the largest damping of v3 of 2.6 N m s/rad at 500 Hz."""
    robot, stand = load("v3"), stand_of("v3")
    assert study_gains(robot, stand, kp=5.0, kd=2.4).passed
    study = study_gains(robot, stand, kp=5.0, kd=2.9)
    assert not study.passed
    assert not study.worst.stable
    assert study.worst.frequency == pytest.approx(250.0)
    assert study.largest_kd.factor == pytest.approx(2.605 / 2.9, rel=0.02)


@pytest.mark.slow
def test_damping_of_zero_has_no_upper_bound_and_no_oscillating_joint() -> None:
    """Reference: multiples of zero. The joints of v3 have damping of their own: bare MuJoCo decays
    from 0.04 to 6e-6 rad/s within 6 s with kp 5 and kd 0."""
    study = study_gains(load("v3"), stand_of("v3"), kp=5.0, kd=0.0)
    assert study.passed
    assert study.largest_kd.factor is None
    words = " ".join(get_english(line) for line in gains_document(study).findings)
    assert "no upper bound" in words
    assert "oscillates" not in words
    assert "controller" in words


@pytest.mark.slow
def test_scaled_start_gains_give_equal_bounds() -> None:
    """Reference: the bounds [N m s/rad] do not depend on the present gains."""
    robot, stand = load("original"), stand_of("original")
    bounds = [
        study_gains(robot, stand, kp=60.0, kd=kd).classes[0].largest_kd for kd in (0.5, 1.0, 1.4)
    ]
    assert bounds == pytest.approx([bounds[0]] * 3, rel=0.01)


@pytest.mark.slow
def test_columns_of_the_table_are_the_fields_of_the_classes() -> None:
    """Reference: the fields, by the English heading and the unit of each column."""
    study = gains_of("v3")
    table = gains_document(study).blocks[0]
    assert isinstance(table, Table)
    headings = [(get_english(column.name), column.unit) for column in table.columns]
    assert headings[1:5] == [
        ("kp", "N m/rad"),
        ("least", "N m/rad"),
        ("torque limit", "N m/rad"),
        ("recommended", "N m/rad"),
    ]
    assert [name for name, _ in headings[5:]] == [
        *("kd", "largest", "largest, alone", "encoder", "recommended"),
    ]
    assert {unit for _, unit in headings[5:]} == {"N m s/rad"}
    for row, one in zip(table.rows, study.classes, strict=True):
        values = [cell.value for cell in row[1:] if isinstance(cell, Number)]
        assert values == [
            *(one.kp, one.least_kp, one.largest_kp_of_torque, one.recommended_kp),
            *(one.kd, one.largest_kd, one.largest_kd_alone, one.largest_kd_of_encoder),
            one.recommended_kd,
        ]


def test_welded_base_requires_no_gains_without_feedforward() -> None:
    """Feet that slide without feed-forward were OUT OF BOUNDS, although `stand` printed HOLDS.

    Reference: the verdict of `stand`. The present kd has a damping ratio above 0.5, and is
    recommended: the smallest such kd was, 0.03 of the present kd.
    """
    robot, task = load("v3"), pa.StandTask(contacts={"base": pa.Weld()})
    study = study_gains(robot, task)
    assert study.sag_failure is None
    assert study.least_kp_alone is None
    assert study.passed
    assert study.recommended_kd_factor == 1.0


@pytest.mark.slow
def test_gains_in_proportion_to_inertia_are_found_if_no_multiples_are_stable() -> None:
    """No common factor suits the gains of one joint and those of the others.

    References: the simulated bounds, and `verify_stand` with the recommended gains.
    """
    robot, stiffness = load("v3"), np.full(12, 5.0)
    stiffness[0] *= 1e6
    study = study_gains(robot, pa.StandTask(), kp=stiffness, kd=0.02 * stiffness, delay=0.004)
    assert study.by_inertia
    assert not study.passed
    for bound in (study.least_kp, study.largest_kd):
        assert bound.factor is not None
        assert bound.simulated == pytest.approx(bound.factor, rel=0.12)
    kp, kd = np.zeros(12), np.zeros(12)
    for bounds in study.classes:
        indices = [robot.joint_names.index(joint) for joint in bounds.joints]
        kp[indices], kd[indices] = bounds.recommended_kp, bounds.recommended_kd
        assert bounds.kp == stiffness[indices[0]]
    assert pa.verify_stand(robot, pa.solve_stand_as_simulated(robot), kp=kp, kd=kd).passed
    document = gains_document(study)
    assert "in proportion to joint inertia are stable: kp" in printed(document)
    first = study.worst.joints[0]
    present = "kp 5 to 5000000, kd 0.1 to 100000"
    short = printed(document, width=200, everything=False).splitlines()[0]
    assert short.startswith(f"UNSTABLE {study.name}: {present}: {first} oscillates (PD at ")
    # The recommended gains differ between joints: `stand` would repeat the present gains.
    assert document.next_step == NextStep("gains", ("-v",))
    table = document.blocks[0]
    assert isinstance(table, Table)
    column = [get_english(column.name) for column in table.columns].index("reference")
    shown = [row[column].value for row in table.rows if isinstance(row[column], Number)]
    assert shown == [bounds.reference_kp for bounds in study.classes]
    equal = [replace(bounds, reference_kp=2.0, reference_kd=0.1) for bounds in study.classes]
    marked = gain_plot(replace(study, classes=tuple(equal))).series[1]
    assert (list(marked.x), list(marked.y)) == ([2.0], [0.1])  # not the present gains


def test_joints_of_similar_limbs_form_a_class() -> None:
    """Reference: the three joints of v3's legs, by name."""
    robot = load("v3")
    groups = group_joints(robot, np.full(12, 5.0), np.full(12, 0.1))
    names = [name_joints([robot.joint_names[joint] for joint in group]) for group in groups]
    assert names == ["leg_*_1", "leg_*_2", "leg_*_3"]
    assert sorted(joint for group in groups for joint in group) == list(range(12))


def test_joints_with_other_gains_form_a_class_of_their_own() -> None:
    stiffness = np.full(12, 5.0)
    stiffness[4] = 6.0
    groups = group_joints(load("v3"), stiffness, np.full(12, 0.1))
    assert [4] in groups
    assert len(groups) == 4


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        ([], ""),
        (["left_knee"], "left_knee"),
        (["left_knee", "right_knee"], "*_knee"),
        (["leg_front_r_1", "leg_back_l_1"], "leg_*_1"),
        (["FL_hip_joint", "FR_hip_joint"], "*_hip_joint"),
        (["a", "b", "c"], "a, b +1"),
    ],
)
def test_classes_are_named_by_common_parts(names: list[str], expected: str) -> None:
    assert name_joints(names) == expected


def test_motors_too_weak_for_the_stand_are_named_in_the_error() -> None:
    """Reference: the torque that statics predicts with minimum tangential forces, over 0.1 N m."""
    robot, knee = load("v3"), "leg_front_r_3"
    weak = pa.robot.with_efforts(robot, {knee: 0.1})
    stand = pa.solve_stand_as_simulated(weak)
    torques = stand_statics(weak, stand).joint_torques
    needed = abs(torques[weak.joint_names.index(knee)])
    assert needed > 0.1
    with pytest.raises(pa.ModelError) as caught:
        study_gains(weak, pa.StandTask())
    words = f"{knee} must exert {needed:.3g} N m, but its limit is 0.1 N m"
    assert words in str(caught.value)


@pytest.mark.parametrize(
    ("options", "field"),
    [
        ({"error": 0.0}, "error"),
        ({"error": math.inf}, "error"),
        ({"error": -0.1}, "error"),
        ({"encoder_bits": 3}, "encoder_bits"),
        ({"encoder_bits": 99}, "encoder_bits"),
        ({"rate": -1.0}, "rate"),
        ({"delay": math.nan}, "delay"),
    ],
)
def test_invalid_requests_are_refused(options: dict[str, float], field: str) -> None:
    with pytest.raises(pa.ConfigurationError) as caught:
        study_gains(load("original"), stand_of("original"), **options)  # type: ignore[arg-type]
    assert caught.value.field == field


@pytest.mark.slow
def test_gains_of_slides_have_units_of_their_own(tmp_path: Path) -> None:
    """The knees are slides: an angle and counts per turn bound no gain there."""
    robot = pa.load_robot(quadruped_with_slides(tmp_path))
    study = study_gains(robot, pa.StandTask(), error=0.2, encoder_bits=14)
    units = {bounds.name: bounds.units.stiffness for bounds in study.classes}
    assert units == {"*_roll": "N m/rad", "*_pitch": "N m/rad", "*_knee": "N/m"}
    for bounds in study.classes:
        torque, encoder = bounds.largest_kp_of_torque, bounds.largest_kd_of_encoder
        assert (torque is None, encoder is None) == (bounds.are_slides, bounds.are_slides)
        assert torque is None or torque == pytest.approx(60 / 0.2)
    document = printed(gains_document(study))
    assert "kp 1500 N m/rad or N/m (at least" in document
    assert "kd 5 N m s/rad or N s/m" in document
    servos = study.servos
    assert (servos.stiffness_unit, servos.damping_unit) == (
        "N m/rad or N/m", "N m s/rad or N s/m",
    )  # fmt: skip


@pytest.mark.slow
def test_large_and_near_gains_are_readable() -> None:
    """HyQ: the answer stated a kp of 1.3e+03. Solo12: kd was 1.7, and so was its exceeded bound.

    References: factors on the gains of the study.
    """
    study = gains_of("v3")
    classes = tuple(
        replace(joint_class, kp=1304.0, kd=1.7, recommended_kp=1304.0, recommended_kd=65.2)
        for joint_class in study.classes
    )
    most = replace(study.largest_kd, factor=0.9994)
    document = gains_document(replace(study, classes=classes, largest_kd=most))
    assert document.next_step is not None
    assert document.next_step.words == ("--kp", "1300", "--kd", "65.2")
    text = " ".join(get_english(line) for line in (*document.failures, *document.findings))
    assert "kp 1300 N m/rad (at least " in text
    assert "kd 1.7 N m s/rad (at most 1.69)" in text  # 1.699, rounded down to three digits


def test_bound_of_the_damping_keeps_the_present_stiffness() -> None:
    """Solo12: kd 1.7 was UNSTABLE below a stated bound of 1.705, which held for half the kp.

    Reference: a loop that is stable up to kd = 1.69 with kp = 34, and up to 1.8 with kp = 17.
    """
    loop: Any = SimpleNamespace(
        is_stable=lambda kp, kd: kd[0] <= 1.69 + 0.11 * (34.0 - kp[0]) / 17.0
    )
    gains = _Gains(loop, np.array([34.0]), np.array([1.7]))
    assert gains.find_stable_pair() == (1.0, 0.5)


def test_each_gain_is_in_its_column() -> None:
    """References: the fields of the classes and bounds, which all differ."""
    numbers = iter(np.arange(1.1, 20.0, 0.7))
    floats = {
        entry.name: float(next(numbers))
        for entry in fields(JointClass)
        if entry.name.startswith(("k", "least", "largest", "re"))
    }
    one = JointClass(name="hip_*", joints=("hip_l", "hip_r"), **floats)
    bounds = [
        GainBound(
            factor=1.5 + place, simulated=2.25 + place, frequency=30.0 + place, joints=("hip",)
        )
        for place in range(3)
    ]
    study: Any = SimpleNamespace(
        classes=(one,), units=HINGE_UNITS, by_inertia=False, error=None, encoder_bits=None,
        least_kp=bounds[0], largest_kp=bounds[1], largest_kd=bounds[2], least_kp_alone=None,
    )  # fmt: skip
    (row,) = _make_class_table(study).rows
    assert [cell.value for cell in row if isinstance(cell, Number)] == [
        *(one.kp, one.least_kp, one.largest_kp_of_torque, one.recommended_kp),
        *(one.kd, one.largest_kd, one.largest_kd_alone, one.largest_kd_of_encoder),
        one.recommended_kd,
    ]
    rows = _make_bound_table(study).rows
    assert [[cell.value for cell in row if isinstance(cell, Number)] for row in rows] == [
        [bound.factor, bound.simulated, bound.frequency] for bound in bounds
    ]


@pytest.mark.slow
def test_damping_alone_does_not_excuse_servos_that_push_away_from_the_command(
    tmp_path: Path,
) -> None:
    """In bare MuJoCo the unmodified file does not stand: a servo's stiffness has the wrong sign."""
    pair = write_slip(tmp_path, "kp of one has the wrong sign", seed=3)
    assert simulate_truth(pair.mjcf, pair.mjcf) is not Truth.STANDS
    robot = pa.load_robot(*pair)
    assert not study_gains(robot, pa.solve_stand(robot), kd=4).passed


@pytest.mark.slow
def test_gains_of_a_robot_with_an_assumed_mass_do_not_pass(tmp_path: Path) -> None:
    """Without a mass, the torques of v3 are lower bounds, and stable gains are no proof."""
    stated, unstated = write_without_a_mass(tmp_path)
    for path, passes in ((stated, True), (unstated, False)):
        gains = study_gains(pa.load_robot(path), pa.StandTask())
        assert (gains.missing_masses is None) is passes
    assert gains.stands_stably
    assert not gains.passed
    assert printed(gains).startswith("UNKNOWN")


@pytest.mark.slow
def test_dataframe_contains_the_curve_and_the_table_counts_missing_values() -> None:
    """Reference: the factors of the result."""
    gains = study_gains(load("v3"), stand_of("v3"))
    assert_numbers_have_units(gains)
    np.testing.assert_array_equal(gains.to_dataframe()["largest_kd_factor"], gains.curve_dampings)
    missing = int(np.isnan(gains.curve_dampings).sum())
    assert f"{missing} nan" in gains._repr_html_() or not missing


def test_verdict_on_gains_that_differ_states_values_and_factors() -> None:
    """Reference: the smallest and the largest positive gain, and the factors of the bounds."""
    stiffnesses = _format_range((53.3, 2660.0, 0.0), "N m/rad", between="..")
    values = {"added": True, "kp": "", "kd": "", "stiffnesses": stiffnesses}
    line = text("gains-factors", **values, least="0.0135", most="1.93").short
    assert line == (
        "added kp 53.3..2660 N m/rad can be scaled by 0.0135 or more, kd by 1.93 or less"
    )
    assert len(f"STABLE panda.urdf: {line}") <= MAX_ANSWER_WIDTH


def test_chinese_short_answer_names_one_joint_and_the_frequency() -> None:
    """The Chinese line listed all joints, and was cut before the recommended gains."""
    values = {"rate": "500", "delay": "0", "frequency": "250", "time": "8", "first": "hip"}
    joints = ("FR_hip", "FL_hip", "RR_hip")
    line = text("gains-oscillate", **values, joints=joints, present="", delayed=False)
    assert line.short_zh == "500 Hz PD：振荡关节 FR_hip，另有 2 个（250 Hz）"
