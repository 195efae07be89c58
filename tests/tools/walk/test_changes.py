"""Changes of a robot that a walking policy tolerates, and the joint order of a policy; repeated
runs give equal results.
"""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from pupper_analysis.base.errors import ConfigurationError, ModelError
from pupper_analysis.tools.walk.document import intervals_document
from pupper_analysis.tools.walk.gait import evaluate_tracking
from pupper_analysis.tools.walk.intervals import (
    VARIED_QUANTITIES,
    WARM_UP_SECONDS,
    TrackedIntervals,
    make_changed_case,
    read_measured_intervals,
    tracked_intervals,
)
from pupper_analysis.tools.walk.orders import Orders, group_limbs, rank_orders
from pupper_analysis.tools.walk.policy import Policy
from pupper_analysis.tools.walk.runs import prepare_stage, simulate_cases
from tests.support.variants import load
from tests.tools.walk import made


@pytest.fixture(scope="module")
def still(tmp_path_factory: pytest.TempPathFactory) -> Policy:
    return Policy.load(made.write_standing_policy(tmp_path_factory.mktemp("walk") / "still.json"))


@pytest.mark.slow
def test_interval_of_motor_strength_does_not_depend_on_the_workers(still: Policy) -> None:
    robot = load("v3")
    found = [
        tracked_intervals(
            robot, still, (0, 0, 0), seeds=1, quantities=("strength",), workers=workers
        )
        for workers in (1, 2)
    ]
    one = found[0].intervals[0]
    assert 0.05 < one.least[0] < 1 < one.most[0]
    assert one.below[0] < one.least[0] < 1.2 * one.below[0]
    assert math.isnan(one.above[0])
    assert (found[1].intervals[0].least == one.least).all()


def test_fit_without_a_varied_quantity_is_refused(still: Policy) -> None:
    with pytest.raises(ConfigurationError, match="measured only kp, delay"):
        tracked_intervals(
            load("v3"),
            still,
            (0, 0, 0),
            quantities=("mass",),
            measured={"kp": (0.9, 1.1), "delay": (0.0, 0.01)},
        )


def test_changed_cases_have_the_changed_parameters(still: Policy) -> None:
    """References: masses [kg] of MuJoCo's model, and its height [m] of the lowest foot geom."""
    stage = prepare_stage(load("v3"), still)
    base = stage.model.body("base_link").id
    heavy = make_changed_case(stage, "mass", 2.0, np.zeros(3), 0).model
    assert heavy.body_mass[base] == 2 * stage.model.body_mass[base]
    assert heavy.body_subtreemass[0] > stage.model.body_subtreemass[0]  # constants follow
    long = make_changed_case(stage, "legs", 1.2, np.zeros(3), 0)
    data = mujoco.MjData(long.model)
    stage.robot.mj_convention.set_state(data, stage.default)
    mujoco.mj_kinematics(long.model, data)
    low = data.geom_xpos[list(stage.robot.foot_geoms), 2].min()
    assert long.lift > 0.01
    assert low + long.lift == pytest.approx(0.01995, abs=1e-9)
    loaded = make_changed_case(stage, "payload", 0.5, np.zeros(3), 0).model
    assert loaded.body_mass.sum() == pytest.approx(1.5 * stage.model.body_mass.sum())
    assert make_changed_case(stage, "delay", 0.02, np.zeros(3), 0).delay == 0.02
    late = prepare_stage(load("v3"), still.with_contract(latency=0.01))
    delays = [
        make_changed_case(late, name, 0.02, np.zeros(3), 0).delay for name in ("delay", "com")
    ]
    assert delays == pytest.approx([0.03, 0.01])  # the policy's own latency remains


def test_mass_change_scales_the_inertia_of_the_base(still: Policy) -> None:
    """Reference: of a body of the same shape and twice the density all moments double."""
    stage = prepare_stage(load("v3"), still)
    base = stage.model.body("base_link").id
    heavy = make_changed_case(stage, "mass", 2.0, np.zeros(3), 0).model
    np.testing.assert_allclose(heavy.body_inertia[base], 2 * stage.model.body_inertia[base])
    np.testing.assert_allclose(heavy.body_ipos[base], stage.model.body_ipos[base])


def test_scaled_legs_are_similar_about_their_first_body(still: Policy) -> None:
    """Reference: at equal joint angles, a scaling about the first body of a leg moves every CoM,
    geom and site beyond this body; the first body stays as it is."""
    stage = prepare_stage(load("v3"), still)
    positions = {}
    for factor in (1.0, 1.5):
        model = make_changed_case(stage, "legs", factor, np.zeros(3), 0).model
        data = mujoco.MjData(model)
        stage.robot.mj_convention.set_state(data, stage.default)
        mujoco.mj_kinematics(model, data)
        first = model.body("leg_front_r_1").id
        beyond = [first + 1, first + 2]
        points = [
            data.xipos[beyond],
            data.geom_xpos[np.isin(model.geom_bodyid, beyond)],
            data.site_xpos[np.isin(model.site_bodyid, beyond)],
        ]
        assert all(map(len, points))
        positions[factor] = np.concatenate(points) - data.xpos[first]
        for name in ("body_pos", "body_ipos"):
            values = getattr(model, name), getattr(stage.model, name)
            np.testing.assert_array_equal(values[0][first], values[1][first])
    np.testing.assert_allclose(positions[1.5], 1.5 * positions[1.0], atol=1e-12)


def contact_friction(model: mujoco.MjModel) -> np.ndarray:
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert len(data.contact) == 1
    friction: np.ndarray = data.contact.friction[0].copy()
    return friction


@pytest.mark.parametrize("pair", ["", '<pair geom1="floor" geom2="ball" friction="0.6 0.4"/>'])
def test_sliding_friction_of_geoms_and_of_pairs_is_scaled(pair: str) -> None:
    """Reference: MuJoCo's effective friction of the contact; twisting and rolling stay."""
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><worldbody><geom name="floor" type="plane" size="1 1 1" friction="0.5"/>
        <body pos="0 0 .099"><freejoint/><geom name="ball" size=".1" friction="0.8"/></body>
        </worldbody><contact>{pair}</contact></mujoco>"""
    )
    stated = contact_friction(model)
    change = VARIED_QUANTITIES["friction"].apply
    assert change is not None
    change(None, model, 0.5)  # type: ignore[arg-type]
    np.testing.assert_allclose(contact_friction(model), stated * [0.5, 0.5, 1, 1, 1])


def test_motor_and_com_changes_equal_mujoco_forces(still: Policy) -> None:
    """Reference: forces of position servos, kp (ctrl - q) - kd v, and MuJoCo's subtree CoM."""
    stage = prepare_stage(load("v3"), still)
    robot, motors = stage.robot, stage.robot.mj_convention.actuator_index

    def forces(model: mujoco.MjModel, lead: float, speed: float) -> np.ndarray:
        data = mujoco.MjData(model)
        robot.mj_convention.set_state(data, stage.default)
        data.ctrl[motors] = stage.default[7:] + lead
        data.qvel[robot.mj_convention.qvel_index[6:]] = speed
        mujoco.mj_forward(model, data)
        found: np.ndarray = data.actuator_force[motors].copy()
        return found

    def changed(quantity: str, value: float) -> mujoco.MjModel:
        return make_changed_case(stage, quantity, value, np.zeros(3), 0).model

    stated = stage.model
    for lead in (0.1, -0.1):
        np.testing.assert_allclose(forces(changed("kp", 2.0), lead, 0), 2 * forces(stated, lead, 0))
        np.testing.assert_allclose(forces(changed("kd", 2.0), 0, lead), 2 * forces(stated, 0, lead))
        np.testing.assert_allclose(
            forces(changed("strength", 0.5), 1e3 * lead, 0), 0.5 * forces(stated, 1e3 * lead, 0)
        )
    base = robot.mj_model.body(robot.mj_base).id
    moved = changed("com", 0.02)
    share = stated.body_mass[base] / robot.total_mass
    data, before = mujoco.MjData(moved), mujoco.MjData(stated)
    for one, model in ((data, moved), (before, stated)):
        robot.mj_convention.set_state(one, stage.default)
        mujoco.mj_forward(model, one)
    np.testing.assert_allclose(
        data.subtree_com[0] - before.subtree_com[0], [0.02 * share, 0, 0], atol=1e-12
    )


def test_push_velocity_equals_impulse_by_mass(still: Policy) -> None:
    """Reference: the CoM velocity changes by impulse / mass, minus the impulse of the feet."""
    stage = prepare_stage(load("v3"), still)
    model, data = stage.model, mujoco.MjData(stage.model)
    cases = [
        make_changed_case(stage, "push-left", value, np.zeros(3), 0) for value in (0.0, 0.3, -0.3)
    ]
    speeds = []
    for run in simulate_cases(stage, cases, 2.1, 1.0):
        found = []
        for at in (round(2.0 / stage.timestep) - 1, round(2.02 / stage.timestep) - 1):
            mujoco.mj_setState(model, data, run.states[at], mujoco.mjtState.mjSTATE_FULLPHYSICS)
            mujoco.mj_forward(model, data)
            mujoco.mj_subtreeVel(model, data)
            found.append(data.subtree_linvel[0].copy())
        speeds.append(found[1] - found[0])
    still_step, left, right = (step[1] for step in speeds)
    assert abs(still_step) < 1e-3
    assert 0.1 < left < 0.3
    assert -0.3 < right < -0.1
    alone = next(iter(simulate_cases(stage, cases[:1], 2.1, 1.0)))  # nothing stays of a push
    beside = next(iter(simulate_cases(stage, cases, 2.1, 1.0)))
    assert (alone.states == beside.states).all()


@pytest.fixture(scope="module")
def trot(tmp_path_factory: pytest.TempPathFactory) -> Policy:
    return Policy.load(made.trot(tmp_path_factory.mktemp("walk") / "trot.json"))


@pytest.mark.slow
def test_intervals_are_reproducible_and_their_ends_are_exact(trot: Policy) -> None:
    """Reference: a separate run at each end tracks, and a run beyond does not; repeated bit by
    bit with three workers."""
    robot, command, names = load("v3"), made.TROT[0], ("mass", "kp", "delay", "strength")
    first, second = (
        tracked_intervals(
            robot, trot, command, seeds=2, quantities=names, seconds=3, workers=workers
        )
        for workers in (1, 3)
    )
    assert first.seeds == (0, 1)
    assert first.to_json() == second.to_json()
    stage = prepare_stage(robot, trot)
    ends = 0
    for interval in first.intervals:
        sides = ((interval.least, interval.below), (interval.most, interval.above))
        failures = (interval.ended_below, interval.ended_above)
        assert (interval.upright_least <= interval.least).all()
        assert (interval.upright_most >= interval.most).all()
        for side, (good, bad) in enumerate(sides):
            for seed in first.seeds:
                assert (failures[side][seed] == "") == math.isnan(bad[seed])
                for value, tracks in ((good[seed], True), (bad[seed], False)):
                    if not math.isnan(value):
                        case = make_changed_case(
                            stage, interval.quantity, float(value), np.array(command), seed
                        )
                        run = next(iter(simulate_cases(stage, [case], 3, WARM_UP_SECONDS)))
                        outcome = evaluate_tracking(stage, run, WARM_UP_SECONDS)
                        assert outcome.tracks is tracks, (interval, side)
                        assert outcome.failure == ("" if tracks else failures[side][seed])
                        assert (outcome.failure == "falls") == run.fallen
                        ends += not tracks
    assert ends >= 4


@pytest.mark.parametrize(
    ("quantity", "first", "second", "middle"),
    [
        ("mass", 0.5, 8.0, 2.0),
        ("kp", 0.04, 1.0, 0.2),
        ("delay", 0.0, 60.0, 30.0),
        ("payload", 0.0, 0.5, 0.25),
    ],
)
def test_bisection_of_a_factor_halves_its_logarithm(
    quantity: str, first: float, second: float, middle: float
) -> None:
    """By hand: the geometric mean of factors, the arithmetic mean of other quantities."""
    varied = VARIED_QUANTITIES[quantity]
    assert (varied.unit == "x") is (first > 0)
    assert varied.compute_midpoint(first, second) == pytest.approx(middle)
    assert varied.compute_midpoint(second, first) == pytest.approx(middle)


def test_narrow_margin_is_reported_if_seeds_differ_by_more(trot: Policy) -> None:
    """By hand: margins 0.1 and 0.5 differ by 0.4, more than 0.1; 0.5 and 0.6 do not."""
    empty = TrackedIntervals(
        name="v3",
        mass=1.0,
        policy="p",
        command=np.zeros(3),
        requested_seeds=3,
        seeds=(0, 2),
        speed_margins=np.array([0.5, -9.0, 0.6]),
        turning_margins=np.array([0.1, 0.9, 0.5]),
        intervals=(),
        rollouts=3,
        seconds=3.0,
        remarks=(),
    )
    assert empty.narrow == ("turning",)
    assert replace(empty, turning_margins=empty.speed_margins).narrow == ()
    assert replace(empty, seeds=(0,)).narrow == ()
    shown = intervals_document(empty)
    assert any(
        "margin of the unchanged robot (turning) 10 %" in str(finding) for finding in shown.findings
    )


@pytest.mark.slow
def test_payload_ends_by_speed_before_a_fall(trot: Policy) -> None:
    """References: runs with the printed payloads, and the mean speed of the last one."""
    robot, command = load("v3"), made.TROT[0]
    found = tracked_intervals(robot, trot, command, seeds=1, quantities=("payload",), seconds=3)
    (interval,) = found.intervals
    assert interval.upright[1] >= interval.common[1]
    stage = prepare_stage(robot, trot)
    case = make_changed_case(stage, "payload", interval.upright[1], np.array(command), 0)
    run = next(iter(simulate_cases(stage, [case], 3, WARM_UP_SECONDS)))
    assert not run.fallen
    if not math.isnan(interval.above[0]):
        case = make_changed_case(stage, "payload", float(interval.above[0]), np.array(command), 0)
        run = next(iter(simulate_cases(stage, [case], 3, WARM_UP_SECONDS)))
        outcome = evaluate_tracking(stage, run, WARM_UP_SECONDS)
        speed = np.linalg.norm(outcome.velocity - np.array(command[:2]))
        if interval.ended_above == ("speed",):
            assert speed > 0.5 * command[0]
            assert outcome.speed_margin < 0


def fit_file(folder: Path, *rows: dict[str, object]) -> Path:
    path = folder / "fit.json"
    path.write_text(json.dumps({"estimates": rows}), encoding="utf-8")
    return path


def row(
    kind: str, subject: str, stated: float, low: float, high: float, part: str = ""
) -> dict[str, object]:
    values = {"stated": stated, "low": low, "high": high}
    return {"kind": kind, "subject": subject, "component": part, **values}


def test_measured_intervals_are_read_from_a_fit(tmp_path: Path) -> None:
    """Reference by hand: the widest interval of all links, as a ratio to the nominal value, or as a
    difference for CoM [m] and delay [s].
    """
    robot = load("v3")
    path = fit_file(
        tmp_path,
        row("mass", "base_link", 2.0, 1.8, 2.4),
        row("mass", "leg_front_r_1", 1.0, 0.1, 9.0),
        row("com", "base_link", 0.01, 0.0, 0.03, "x"),
        row("com", "base_link", 0.01, -1.0, 1.0, "y"),
        row("kp", "leg_front_r_1", 5.0, 4.5, 5.5),
        row("kp", "leg_front_r_2", 5.0, 4.0, 5.0),
        row("friction", "leg_front_r_1", 0.1, 0.0, 9.0),
        row("delay", "servos", 0.0, 0.01, 0.03),
    )
    found = read_measured_intervals(path, robot, latency=0.02)
    assert found["mass"] == pytest.approx((0.9, 1.2))
    assert found["com"] == pytest.approx((-0.01, 0.02))
    assert found["kp"] == pytest.approx((0.8, 1.1))
    assert found["delay"] == pytest.approx((0.0, 0.01))
    assert set(found) == {"mass", "com", "kp", "delay"}


@pytest.mark.slow
def test_interval_of_a_fit_is_compared_with_the_tracked_interval(still: Policy) -> None:
    robot = load("v3")
    weak = {"strength": (0.01, 1.0), "delay": (0.0, 0.01)}
    held = tracked_intervals(
        robot, still, (0, 0, 0), seeds=1, quantities=tuple(weak), seconds=3, measured=weak
    )
    assert [interval.inside for interval in held.intervals] == [False, True]
    assert not held.passed


_VALID_ROW = row("mass", "base_link", 2.0, 1.8, 2.4)


@pytest.mark.parametrize(
    "text",
    [
        *("{}", "[", '{"estimates": [1]}', '{"parameters": [{}]}'),
        *(
            json.dumps({"estimates": [_VALID_ROW, _VALID_ROW | change]})
            for change in (
                {"kind": ["mass"]},
                {"subject": ["base_link"]},
                {"component": []},
                {"low": 2.4, "high": 1.8},
            )
        ),
    ],
)
def test_invalid_fit_file_is_refused_in_one_line(text: str, tmp_path: Path) -> None:
    path = tmp_path / "fit.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ModelError) as caught:
        read_measured_intervals(path, load("v3"))
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_measured_interval_with_exchanged_ends_is_refused(still: Policy) -> None:
    """Otherwise (1.5, 0.5) would be inside a tracked interval from 0.9 to 1.6."""
    with pytest.raises(ConfigurationError, match=r"lower end 1\.5 is above the upper end 0\.5"):
        tracked_intervals(load("v3"), still, quantities=("kp",), measured={"kp": (1.5, 0.5)})


def rank_trot_orders(policy: Policy) -> Orders:
    """Return the ranked joint orders of a policy for the three commands of the trot."""
    return rank_orders(load("v3"), policy, commands=made.TROT, seconds=3)


@pytest.fixture(scope="module")
def own(trot: Policy) -> Orders:
    return rank_trot_orders(trot)


@pytest.mark.slow
def test_stated_order_is_ranked_first_for_any_number_of_workers(own: Orders, trot: Policy) -> None:
    assert own.passed
    assert own.determined
    assert own.stated == 0
    assert own.candidates[0].tracked == 3
    first, second = (
        rank_orders(load("v3"), trot, commands=made.TROT[:1], seconds=3, workers=workers)
        for workers in (1, 3)
    )
    assert first.to_json() == second.to_json()  # to the last bit


@pytest.mark.slow
def test_exchanged_front_legs_are_found_by_walking(trot: Policy) -> None:
    """The best interpretation of a policy with exchanged front legs exchanges them back."""
    names = load("v3").joint_names
    order = [3, 4, 5, 0, 1, 2, *range(6, 12)]
    wrong = trot.with_contract(joints=names).contract.reorder_joints(order)
    found = rank_trot_orders(replace(trot, contract=wrong))
    assert not found.passed
    assert found.candidates[0].change == "limbs"
    assert found.candidates[0].joints == names


@pytest.mark.slow
def test_a_planted_sign_and_a_planted_scale_are_found(trot: Policy) -> None:
    signs = np.where(np.arange(12) == 4, -1.0, 1.0)
    turned = rank_trot_orders(trot.with_contract(signs=signs))
    half = rank_trot_orders(trot.with_contract(action_scale=0.5 * trot.contract.action_scale))
    assert not turned.passed
    assert not half.passed
    assert turned.candidates[0].flipped == ("leg_front_l_2",)
    assert (half.candidates[0].change, half.candidates[0].detail) == ("scale", "x 2")


@pytest.mark.slow
def test_candidates_that_walk_equally_are_not_determined(tmp_path: Path) -> None:
    """A history in the reverse order delays the observations by a frame, and the robot walks as
    well."""
    policy = Policy.load(made.trot(tmp_path / "trot.json", history=2))
    found = rank_trot_orders(policy.with_contract(newest_first=True))
    assert found.passed
    assert not found.determined
    alike = {
        (found.candidates[index].change, found.candidates[index].detail) for index in found.alike
    }
    assert ("history", "oldest first") in alike


def test_joints_are_grouped_by_limb_in_any_order() -> None:
    robot = load("v3")
    names = robot.joint_names
    assert group_limbs(robot, names) == [[0, 1, 2], [3, 4, 5], [6, 7, 8], [9, 10, 11]]
    assert group_limbs(robot, names[::3] + names[1::3] + names[2::3])[0] == [0, 4, 8]
