"""Definition of studies: variables, designs, metrics, and refusals before the run."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pandas as pd
import pytest
import trimesh
from scipy import stats

import pupper_analysis as pa
from pupper_analysis.base.results import to_json
from pupper_analysis.base.runs import ensure_run
from pupper_analysis.models.mjcf import to_xml
from pupper_analysis.models.urdf_tree import UrdfTree
from pupper_analysis.robot.build import rebuild_robot
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.stance.soft_ground import solve_stand_as_simulated
from pupper_analysis.tools.study.design import DesignBuilder
from pupper_analysis.tools.study.document import study_document
from pupper_analysis.tools.study.measures import METRICS
from pupper_analysis.tools.study.outcome import (
    compute_main_effects,
    list_stand_assumptions,
    study_outcome,
)
from pupper_analysis.tools.study.parameters import (
    VariablePattern,
    find_moving_joints,
    scale_robot,
    with_gains,
    with_ground_friction,
    without_visuals,
)
from pupper_analysis.tools.study.requirements import Requirement
from pupper_analysis.tools.study.store import Store
from pupper_analysis.tools.study.study import hash_designs, restore_truth_values
from pupper_analysis.tools.study.variables import BLOCK_SIZE, Sampling, make_variable
from tests.support import slips
from tests.support.arm import MJCF, URDF, load_arm
from tests.support.conversions import write_standing_urdf
from tests.support.legged import rewrite_file
from tests.support.variants import load, stand_of


def study(vary: Mapping[str, Any], *metrics: Any, robot: Any = "v3", **options: Any) -> pa.Study:
    return pa.Study(robot, vary, metrics or ["peak_utilisation"], **options)


# ----------------------------------------------------------------------------- variables


@pytest.mark.parametrize(
    ("given", "known"),
    [
        (pa.study.uniform(0.8, 2.0), stats.uniform(0.8, 1.2)),
        (pa.study.normal(1.0, 0.05), stats.norm(1.0, 0.05)),
        (pa.study.log_uniform(0.1, 10.0), stats.loguniform(0.1, 10.0)),
        (pa.study.values([3.0, 5.0]), stats.randint(0, 2)),
    ],
    ids=["uniform", "normal", "log_uniform", "values"],
)
def test_quantiles_equal_those_of_scipy(given: Any, known: Any) -> None:
    shares = np.linspace(0.003, 0.996, 41)  # not at 1/2: a step of values
    expected = known.ppf(shares)
    if given.levels:
        expected = np.array(given.levels)[expected.astype(int)]
    assert given.at(shares) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(
    ("make", "arguments", "message"),
    [
        (pa.study.linspace, (1.6, 0.8, 5), "range 1.6 to 0.8 is empty"),
        (pa.study.linspace, (0.8, 1.6, 1), "1 values"),
        (pa.study.linspace, (0.8, 1.6, 2.5), "not a whole number|is not a whole"),
        (pa.study.values, ([],), "0 values; give 1 to"),
        (pa.study.values, ([1, 2, 1],), "duplicate value"),
        (pa.study.values, ("12",), "not a sequence"),
        (pa.study.uniform, (1, 1), "is empty"),
        (pa.study.uniform, (0, math.inf), "not finite"),
        (pa.study.log_uniform, (0, 1), "not above 0"),
        (pa.study.normal, (1, 0), "not above 0"),
    ],
)
def test_invalid_variable_is_refused(make: Any, arguments: Any, message: str) -> None:
    with pytest.raises(pa.ConfigurationError, match=message):
        make(*arguments)


def test_variable_from_plain_data_is_equal() -> None:
    for made in (
        pa.study.linspace(1, 2, 3),
        pa.study.values([1, 2]),
        pa.study.uniform(1, 2),
        pa.study.normal(1, 2),
    ):
        assert make_variable("x", made.to_dict()) == made
    assert make_variable("x", [5, 10]) == pa.study.values([5, 10])
    assert make_variable("x", 7) == pa.study.values([7])
    with pytest.raises(pa.ConfigurationError) as refused:  # three values, or a range and a count?
        make_variable("x", {"grid": [0.8, 1.4, 3]})
    for meant in ("{values = [0.8, 1.4, 3]}", "{linspace = [0.8, 1.4, 3]}"):
        assert meant in str(refused.value)
    for wrong in (
        {"gauss": [1, 2]},
        {"linspace": [1, 2]},
        {"linspace": 3},
        {"grid": 3},
        {"motors": {}},
        {"motors": {"a": "x"}},
        {"motors": {"a": math.nan}},
        "5",
        {},
        None,
    ):
        with pytest.raises(pa.ConfigurationError, match="vary"):
            make_variable("x", wrong)
    with pytest.raises(pa.ConfigurationError, match=r"vary\['x'\].*'no'"):  # names the value
        make_variable("x", {"motors": {"a": 0, "b": "no"}})
    assert make_variable("x", {"motors": {"a": 0.0, "b": 1}}).numbers == (0.0, 1.0)


# ----------------------------------------------------------------------------- designs


def all_of(sampling: Sampling) -> np.ndarray:
    return np.concatenate(list(sampling.blocks()))


def test_longer_sample_sequence_extends_the_shorter() -> None:
    variables = {
        "a": pa.study.uniform(0, 1),
        "b": pa.study.normal(0, 1),
        "c": pa.study.values([1, 2]),
    }
    short, long = (all_of(Sampling(variables, n, 3)) for n in (100, BLOCK_SIZE + 500))
    assert len(long) == BLOCK_SIZE + 500
    assert np.array_equal(long[:100], short)
    assert not np.array_equal(all_of(Sampling(variables, 100, 4)), short)


def test_design_hash_depends_on_named_values_only() -> None:
    """The order of columns and the sign of zero have no effect; values of 1e-18 do."""
    block = np.array([[1.0, 2.0], [2.0, 1.0], [-0.0, 3.0], [0.0, 3.0]])
    names = hash_designs("x", ("a", "b"), block)
    assert hash_designs("x", ("b", "a"), block[:, ::-1]) == names
    assert names[2] == names[3]
    assert len(set(names)) == 3
    assert len(set(hash_designs("x", ("a", "b"), 1e-18 * block))) == 3
    assert not set(names) & set(hash_designs("y", ("a", "b"), block))


# ----------------------------------------------------------------------------- refusals


@pytest.mark.parametrize(
    ("vary", "message"),
    [
        ({"leg": [1]}, "unknown parameter; available: leg_scale, torso_mass_scale, height"),
        ({"weight:leg": [1]}, "'weight' is not a parameter of a model; available: mass:NAME"),
        ({"kp": [0, 5]}, "range is 0 to 5, but values must be > 0"),
        ({"leg_scale": pa.study.linspace(-1, 1, 3)}, "range is -1 to 1, but values must be > 0"),
        ({"slope": [2.0]}, "<= 1.569"),
        ({"payload": pa.study.uniform(-1, 1)}, ">= 0"),
        ({"mass:*": [0.0]}, "must be > 0"),
        ({"mass:each:leg_*": [1.0]}, "each:leg_"),
    ],
)
def test_variables_out_of_range_or_unknown_are_refused(vary: dict[str, Any], message: str) -> None:
    with pytest.raises(pa.PupperAnalysisError, match=message):
        study(vary)


def local_function(robot: pa.Robot, stand: pa.Stand, more: float) -> float:
    return more


@pytest.mark.parametrize(
    ("metric", "message"),
    [
        ("sagging", "no metric 'sagging'; did you mean sag\\? study --list-metrics"),
        ("xyz", "no metric 'xyz'; available: total_mass, peak_utilisation"),
        ("nowhere:f", "no metric 'nowhere:f'"),
        (lambda robot, stand: 1.0, "define the function at the top level"),
        (local_function, r"not a function of \(robot, stand\)"),
    ],
)
def test_invalid_metric_is_refused(metric: Any, message: str) -> None:
    with pytest.raises(pa.ConfigurationError, match=message):
        study({"kp": [5]}, metric)


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ("sed = 5\n", "keys of a study: robot, vary"),
        ("stand = { hight = 0.12 }\n", "unknown field of a stance; valid: height, roll"),
        ("robot = ", "not a TOML file"),
        ("minimise = 3\n", "minimise: 3 is not a text or a sequence"),
        ("maximise = [3]\n", r"maximise: \[3\] is not a text or a sequence"),
        ('minimise = "servo_sag"\nmaximise = ["servo_sag"]\n', "name each column once"),
        ("present_motor = 3\n", "present_motor: 3 is not a text"),
    ],
)
def test_files_that_are_no_study_are_refused(more: str, message: str, tmp_path: Path) -> None:
    text = 'robot = "v3"\nmeasure = ["servo_sag"]\nvary = { kp = [5, 10] }\n'
    (tmp_path / "study.toml").write_text(text)
    assert len(pa.Study.read(tmp_path / "study.toml").variables) == 1
    (tmp_path / "study.toml").write_text(text + more)
    with pytest.raises(pa.ConfigurationError, match=message):
        pa.Study.read(tmp_path / "study.toml")


@pytest.mark.parametrize(
    ("robot", "message"),
    [
        ({"urdf": 3}, "urdf: 3 is not a text"),
        ({"mjcf": ["a.xml"]}, "mjcf: .* is not a text"),
        ({"models": "a.xml"}, "models: 'a.xml' is not a sequence"),
        ({"models": [3]}, r"models: \[3\] is not a sequence"),
        ({"mjcf": "a.xml", "packages": 3}, "packages: 3 is not a mapping"),
        ({"mjcf": "a.xml", "packages": {"a": 3}}, r"packages\['a'\]: 3 is not a text"),
    ],
)
def test_robot_tables_with_values_of_another_type_are_refused(
    robot: dict[str, Any], message: str
) -> None:
    with pytest.raises(pa.ConfigurationError, match=message):
        pa.Study(robot, {"kp": [5]}, ["servo_sag"])


# ----------------------------------------------------------------------------- numbers of models


FACTORS = {"mass:leg_front_l_3": 1.3, "inertia:*_2": 1.2, "armature:*_1": 2.0, "damping:*": 0.5,
           "frictionloss:*_3": 3.0, "effort:leg_back_r_2": 0.5}  # fmt: skip


def test_factors_change_both_models_equally() -> None:
    """Reference: both engines' dynamics agree, and the masses have the requested ratio."""
    before = load("v3")
    after = scale_robot(before, FACTORS)
    assert pa.cross_check(after, configurations=3).passed
    names = list(before.joint_names)
    knee = before.mj_model.jnt_bodyid[before.mj_model.joint("leg_front_l_3").id]
    grown = 0.3 * before.mj_model.body_mass[knee]
    assert after.total_mass - before.total_mass == pytest.approx(grown, rel=1e-9)
    for model in (after.mj_model, before.mj_model):
        assert model.nbody == before.mj_model.nbody
    weak = names.index("leg_back_r_2")
    expected = np.where(np.arange(12) == weak, 0.5, 1.0) * before.effort_limits
    assert after.effort_limits == pytest.approx(expected)
    ranges = after.mj_model.actuator_forcerange[after.mj_convention.actuator_index]
    assert ranges[:, 1] == pytest.approx(expected)
    assert after.mj_model.dof_damping[6:] == pytest.approx(0.5 * before.mj_model.dof_damping[6:])
    rubbed = np.array([3.0 if name.endswith("_3") else 1.0 for name in names])
    dofs = after.mj_convention.qvel_index[6:]
    loss = before.mj_model.dof_frictionloss[dofs]
    assert after.mj_model.dof_frictionloss[dofs] == pytest.approx(rubbed * loss)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["v3", "original"])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_coms_move_in_both_files_alike(name: str, axis: int) -> None:
    """Closed form, in a tilted pose: the weight of the link acts at a CoM that is displaced by R d.

    Both engines must have this change of the gravity torques.
    """
    before = load(name)
    shin = before.joint_names[2]
    for joint in ("", shin):
        link = before.base if not joint else shin
        offset = 0.01 * np.eye(3)[axis]
        after = scale_robot(before, {f"com_{'xyz'[axis]}:{link}": 0.01})
        assert pa.cross_check(after, configurations=2).passed
        qpos = before.neutral().copy()
        qpos[3:7] = np.array([0.8, 0.3, -0.4, 0.33]) / np.linalg.norm([0.8, 0.3, -0.4, 0.33])
        qpos[7:] += np.linspace(-0.5, 0.6, before.nu)
        config = Configuration(before, qpos)
        number = before.pin_model.getJointId(joint) if joint else 1
        mass = float(before.pin_model.inertias[number].mass)
        child = UrdfTree.of(before.description.urdf).moved_links.get(joint, before.base)
        moved = config.frame_rotation(child) @ offset
        weight = mass * np.array([0.0, 0.0, -9.81])
        changes = [Configuration(after, qpos).gravity() - config.gravity(),
                   compute_bias(after, qpos) - compute_bias(before, qpos)]  # fmt: skip
        about_base = -config.base_rotation().T @ np.cross(moved, weight)
        for change in changes:
            assert change[:3] == pytest.approx(np.zeros(3), abs=1e-10)
            assert change[3:6] == pytest.approx(about_base, abs=1e-10)
            if joint:
                own = -config.joint_axis(shin) @ np.cross(moved, weight)
                assert change[6 + 2] == pytest.approx(own, abs=1e-10)
                assert abs(change).max() > 1e-4
            else:
                assert change[6:] == pytest.approx(np.zeros(before.nu), abs=1e-10)


def compute_bias(robot: pa.Robot, qpos: np.ndarray) -> np.ndarray:
    """Return MuJoCo's bias forces at rest in public coordinates."""
    data = mujoco.MjData(robot.mj_model)
    robot.mj_convention.set_state(data, qpos)
    mujoco.mj_forward(robot.mj_model, data)
    return np.array(data.qfrc_bias[robot.mj_convention.qvel_index])


def test_predictions_use_changed_gains_and_friction() -> None:
    """Reference: steady state with kp passed as an argument."""
    robot, stand = load("v3"), stand_of("v3")
    other = with_gains(robot, 8.0, 0.3, {"kp:*_3": 1.5})
    kp = np.array([12.0 if name.endswith("_3") else 8.0 for name in robot.joint_names])
    expected = pa.steady_state(robot, stand, kp=kp).base_height
    assert pa.steady_state(other, stand).base_height == expected
    slope = pa.solve_stand(robot, pa.StandTask(ground=pa.Ground(slope=0.1)))  # built anew for it
    expected = pa.steady_state(robot, slope, kp=kp).base_height
    assert pa.steady_state(other, slope).base_height == pytest.approx(expected, rel=1e-12)
    slippery = with_ground_friction(robot, 0.3)
    assert {contact.sliding_friction for contact in slippery.contacts.values()} == {0.3}
    steep = pa.solve_stand(slippery, pa.StandTask(ground=pa.Ground(slope=0.4)))
    with pytest.raises(pa.StaticsInfeasibleError, match="friction too low"):
        pa.stance.stand_statics(slippery, steep)


def test_design_has_the_values_of_its_variables() -> None:
    """References: variant with payload, stand, statics and steady state by the public functions."""
    study_of = study({"leg_scale": [1.2], "torso_mass_scale": [1.5]})
    maker = DesignBuilder(study_of.source, pa.StandTask(roll=0.05), (0.02, 0.0, 0.1))
    numbers = {"leg_scale": 1.2, "torso_mass_scale": 1.5, "payload": 0.7, "kp": 9.0, "pitch": 0.1,
               "slope": 0.05}  # fmt: skip
    design = maker.design(numbers)
    robot = pa.robot.with_payload(
        pa.load_variant(pa.pupper.VariantSpec("v3", 1.2, 1.5)), 0.7, (0.02, 0.0, 0.1)
    )
    task = pa.StandTask(roll=0.05, pitch=0.1, ground=pa.Ground(slope=0.05))
    stand = pa.solve_stand(robot, task)
    assert design.stand.qpos == pytest.approx(stand.qpos, abs=1e-12)
    simulated = solve_stand_as_simulated(robot, stand)
    torques = pa.stance.stand_statics(robot, simulated).joint_torques
    assert METRICS["peak_torque"].function(design) == pytest.approx(np.abs(torques).max())
    rest = pa.steady_state(robot, simulated, kp=9.0)
    assert METRICS["servo_sag"].function(design) == pytest.approx(rest.servo_sag, rel=1e-9)
    assert METRICS["base_height"].function(design) == pytest.approx(rest.base_height, rel=1e-9)


def test_metrics_equal_the_direct_calls() -> None:
    """Reference: the public function of each metric."""
    robot, stand = load("v3"), pa.solve_stand(load("v3"), pa.StandTask(pitch=0.1))
    design = DesignBuilder(study({"pitch": [0.1]}).source, pa.StandTask(), (0, 0, 0)).design(
        {"pitch": 0.1}
    )
    simulated = solve_stand_as_simulated(robot, stand)  # the stand of the command `stand`
    statics = pa.stance.stand_statics(robot, simulated)
    rest = pa.steady_state(robot, simulated)
    expected = {
        "total_mass": robot.total_mass,
        "peak_utilisation": statics.motor_utilisation.max(),
        "friction_utilisation": max(statics.friction_utilisation.values()),
        "com_margin": stand.com_margin,
        "sag": stand.qpos[2] - rest.base_height,
        "servo_sag": rest.servo_sag,
        "stiffness": rest.stiffness,
        "rest_utilisation": np.abs(rest.joint_torques / robot.effort_limits).max(),
        "stands": True,
    }
    assert len(set(map(float, expected.values()))) > len(expected) - 2  # no two are alike
    for name, value in expected.items():
        found = METRICS[name].function(design)
        assert found == pytest.approx(float(value), rel=1e-9, abs=1e-12), name
    torques = METRICS["torque"].function(design)
    assert isinstance(torques, dict)
    assert list(torques) == list(robot.joint_names)
    assert list(torques.values()) == pytest.approx(statics.joint_torques.tolist())


@pytest.mark.slow
def test_design_fails_if_its_unmodified_file_falls(tmp_path: Path) -> None:
    """Servos of the wrong sign are replaced by added servos, on which the design fails; with
    gains in the study it may pass."""
    pair = slips.standing(tmp_path)
    text = pair.mjcf.read_text()
    for kp, stands in (("150", True), ("-150", False)):
        pair.mjcf.write_text(text.replace('kp="150"', f'kp="{kp}"'))
        files = {"urdf": str(pair.urdf), "mjcf": str(pair.mjcf)}
        study = pa.Study(files, {"kp": [150.0], "kd": [5.0]}, ["stands"])
        maker = DesignBuilder(study.source, study.task, study.point)
        assert study.metrics[0].function(maker.design({"kp": 150.0, "kd": 5.0}))
        assert METRICS["verified"].function(maker.design({"kp": 150.0, "kd": 5.0}))
        assert METRICS["verified"].function(maker.design({})) is stands
        if stands:
            assert study.metrics[0].function(maker.design({}))
        else:
            with pytest.raises(pa.NotStandingError, match="DIVERGES"):
                study.metrics[0].function(maker.design({}))
        message = " ".join(map(str, list_stand_assumptions(study.base)))
        assert ("unmodified MJCF, from keyframe home: DIVERGES" in message) is not stands
        assert "unmodified MJCF, from keyframe home" in message
        assert ("on servos that were added" in message) is not stands


@pytest.mark.slow
def test_simulated_metrics_equal_the_direct_calls() -> None:
    """Reference: the public function of each metric."""
    robot, stand = load("v3"), stand_of("v3")
    held = pa.stance.solve_stand_as_simulated(robot)  # as `push` and `stand` have it
    design = DesignBuilder(study({"kp": [5.0]}).source, pa.StandTask(), (0, 0, 0)).design({})
    reach = pa.stance.base_workspace(robot).intervals
    expected = {
        "payload_limit": pa.payload_limit(robot, stand).mass,
        "minimum_stiffness": pa.stance.minimum_stiffness(robot, stand),
        "height_range": reach["height"].high - reach["height"].low,
        "pitch_range": reach["pitch"].high - reach["pitch"].low,
        "roll_range": reach["roll"].high - reach["roll"].low,
        "verified": pa.judge_stand(robot, stand).passed,
        "push_recovery": pa.push_recovery(robot, held).weakest_impulse,
    }
    for name, value in expected.items():
        assert METRICS[name].function(design) == pytest.approx(float(value), rel=1e-6), name
    simulating = {n for n, one in METRICS.items() if one.simulates and one.of_file is None}
    # The test of `set_down` simulates a drop in bare MuJoCo (test_motors.py).
    assert simulating == {*expected, "set_down"}


@pytest.mark.parametrize("limit", [None, 7.0])
def test_time_limit_of_a_study_is_kept_in_its_data(limit: float | None) -> None:
    made = study({"leg_scale": [1.0, 1.2]}, time_limit=limit)
    assert pa.Study.of(made.to_dict()).time_limit == limit


def test_com_moves_by_the_same_distance_in_files_of_different_mass() -> None:
    """MuJoCo's base is 10 % heavier than the URDF's; its CoM moves by the requested 10 mm."""
    robot = load("v3")
    spec = robot.description.mjcf.copy()
    spec.body(robot.mj_base).mass *= 1.1
    heavier = rebuild_robot(robot, mjcf=spec)
    after = scale_robot(heavier, {f"com_y:{robot.base}": 0.01})
    base = heavier.mj_model.body(heavier.mj_base).id
    moved = after.mj_model.body_ipos[base] - heavier.mj_model.body_ipos[base]
    assert np.linalg.norm(moved) == pytest.approx(0.01)


def test_com_offset_of_a_study_moves_the_base_back() -> None:
    """The CoM stays over the feet: the base moves back by more than half of m / M of the offset."""
    before = load("v3")
    name = f"com_x:{before.base}"
    maker = DesignBuilder(study({name: [0.0, 0.02]}).source, pa.StandTask(), (0.0, 0.0, 0.0))
    still, moved = (maker.design({name: value}) for value in (0.0, 0.02))
    share = float(before.pin_model.inertias[1].mass) / before.total_mass
    back = moved.stand.qpos[0] - still.stand.qpos[0]
    assert -0.03 < back < -0.5 * share * 0.02
    assert moved.stand.com_margin == pytest.approx(still.stand.com_margin, abs=1e-9)
    assert (
        scale_robot(before, {name: 0.01, f"mass:{before.base}": 1.5}).total_mass > before.total_mass
    )
    with pytest.raises(pa.ConfigurationError, match="not a parameter of a model"):
        study({"com_w:base": [0.0]})
    with pytest.raises(pa.ConfigurationError, match="offset nan m is not finite"):
        scale_robot(before, {name: math.nan})


def test_grid_has_both_ends_and_even_steps() -> None:
    assert pa.study.linspace(0.8, 1.6, 5).levels == pytest.approx((0.8, 1.0, 1.2, 1.4, 1.6))


def test_quantiles_of_the_probabilities_0_and_1_are_finite() -> None:
    """Reference: SciPy's quantiles of 2^-33 and 1 - 2^-33."""
    ends = pa.study.normal(0.0, 1.0).at(np.array([0.0, 1.0]))
    assert ends == pytest.approx(stats.norm.ppf([2.0**-33, 1 - 2.0**-33]), rel=1e-9)


def test_lists_give_their_product_and_the_last_list_changes_first() -> None:
    sampling = Sampling({"a": pa.study.values([1, 2]), "b": pa.study.values([5, 6, 7])}, None, 0)
    assert all_of(sampling).tolist() == [[1, 5], [1, 6], [1, 7], [2, 5], [2, 6], [2, 7]]
    assert len(sampling) == 6
    assert all_of(Sampling({}, None, 0)).shape == (1, 0)  # the robot as it is


def test_sample_sequence_is_more_even_than_random_numbers() -> None:
    """The mean over n Sobol points errs by 1 / n; over random numbers by 0.29 / sqrt(n) = 9e-3."""
    points = all_of(Sampling({"a": pa.study.uniform(0, 1), "b": pa.study.uniform(0, 1)}, 1024, 1))
    assert np.abs(points.mean(axis=0) - 0.5).max() < 2e-3
    assert abs((points[:, 0] * points[:, 1]).mean() - 0.25) < 4e-3
    assert np.unique(points[:, 0]).size == 1024


@pytest.mark.parametrize(
    ("vary", "metrics", "options", "error", "message"),
    [
        ({"payload": pa.study.uniform(0, 1)}, (), {}, pa.ConfigurationError, "is a distribution"),
        (
            {"payload": [0, 1], "kp": [5, 10, 20]},
            (),
            {"samples": 10},
            pa.ConfigurationError,
            "6 designs",
        ),
        ({"mass:leg_9": [1.1]}, (), {}, pa.UnknownNameError, "no body 'leg_9'"),
        ({"effort:knee": [1.1]}, (), {}, pa.UnknownNameError, "no joint 'knee'"),
        ({"kp": [5]}, ("servo_sag", "servo_sag"), {}, pa.ConfigurationError, "servo_sag"),
        ({"kp": [5]}, (), {"time_limit": 0}, pa.ConfigurationError, "time_limit"),
        ({"kp": [5]}, (), {"robot": 3}, pa.ConfigurationError, "robot"),
        (
            {"kp": [5]},
            (),
            {"robot": {"base": "v3", "legs": 2}},
            pa.ConfigurationError,
            "legs",
        ),
        ({"kp": [5]}, (), {"robot": {"feet": ["a"]}}, pa.ConfigurationError, "urdf"),
        ({"kp": [5]}, (), {"robot": "v4"}, pa.VariantError, "known variants"),
        (
            {"offset_x": [0.0, 0.01]},
            ("com_margin",),
            {"stand": pa.StandTask(com="inside")},
            pa.ConfigurationError,
            "not both",
        ),
    ],
    ids=str,
)
def test_invalid_arguments_of_a_study_are_refused(
    vary: Any, metrics: Any, options: Any, error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        study(vary, *metrics, **options)


def test_base_has_factors_by_the_names_of_both_files() -> None:
    """Reference: mass of the base link in Pinocchio's model [kg]."""
    before = load("original")
    after = scale_robot(before, {f"mass:{before.base}": 1.5})
    torso = float(before.pin_model.inertias[1].mass)
    assert after.total_mass - before.total_mass == pytest.approx(0.5 * torso)
    twice = scale_robot(before, {f"mass:{before.base}": 1.5, f"mass:{before.mj_base}*": 2.0})
    assert twice.total_mass - before.total_mass == pytest.approx(2.0 * torso)


def test_robot_without_visual_meshes_has_the_same_stand() -> None:
    """Equal to the last bit."""
    robot, stand = load("v3"), stand_of("v3")
    bare = rebuild_robot(robot, mjcf=without_visuals(robot.description).mjcf)
    assert bare.mj_model.nmesh == 0 < robot.mj_model.nmesh
    assert np.array_equal(pa.solve_stand(bare).qpos, stand.qpos)


def test_visual_shapes_with_mass_are_kept() -> None:
    """Reference: MuJoCo's masses; a body without an inertial has the mass of its shapes."""
    description = load("original").description
    spec = description.mjcf.copy()
    unseen = {"contype": 0, "conaffinity": 0, "size": [0.01, 0, 0]}
    body = next(body for body in spec.bodies if body.name != "world" and not body.explicitinertial)
    for name, mass in (("heavy", 0.3), ("of_water", math.nan), ("light", 0.0)):
        body.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_SPHERE, mass=mass, **unseen)
    found = without_visuals(replace(description, mjcf=spec)).mjcf
    names = {geom.name for geom in found.geoms}
    assert {"heavy", "of_water"} <= names
    assert "light" not in names
    masses = [compilable.compile().body_mass.sum() for compilable in (spec, found)]
    assert masses[0] == pytest.approx(masses[1], rel=1e-12)


def test_visual_shapes_with_fluid_forces_and_tendons_are_kept() -> None:
    """Reference: MuJoCo's passive forces in water, and its number of tendons."""
    description = load("original").description
    spec = description.mjcf.copy()
    spec.option.density = 1000.0
    body = next(body for body in spec.bodies if body.name != "world")
    unseen = {"contype": 0, "conaffinity": 0, "mass": 0.0}
    box = body.add_geom(
        name="hull", type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.1, 0.1, 0.02], **unseen
    )
    box.fluid_ellipsoid = 1
    body.add_geom(name="pulley", type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.02, 0, 0], **unseen)
    body.add_site(name="eye", pos=[0.1, 0, 0])
    spec.worldbody.add_site(name="hook", pos=[0, 0, 1])
    tendon = spec.add_tendon(name="rope", stiffness=10.0)
    tendon.wrap_site("hook")
    tendon.wrap_geom("pulley", "")
    tendon.wrap_site("eye")
    found = without_visuals(replace(description, mjcf=spec)).mjcf
    forces = []
    for model in (spec.compile(), found.compile()):
        data = mujoco.MjData(model)
        data.qvel[2] = 1.0
        mujoco.mj_forward(model, data)
        forces.append(data.qfrc_passive.copy())
        assert model.ntendon == 1
    np.testing.assert_allclose(forces[0], forces[1], rtol=1e-12)
    assert abs(forces[0][2]) > 1.0


def test_com_with_the_payload_of_a_design_is_over_the_feet() -> None:
    """The base moves backwards below a payload in front."""
    builder = DesignBuilder(study({"payload": [1.0]}).source, pa.StandTask(), (0.05, 0.0, 0.0))
    design = builder.design({"payload": 1.0})
    com = pa.Configuration(design.robot, design.stand.qpos).center_of_mass()
    centre = np.mean(list(design.stand.contact_points.values()), axis=0)
    assert com[:2] == pytest.approx(centre[:2], abs=1e-9)
    assert design.stand.qpos[0] < stand_of("v3").qpos[0] - 0.005
    assert design.robot.total_mass == pytest.approx(load("v3").total_mass + 1.0)


@pytest.mark.parametrize("fixed", [None, (0.01, 0.0)])
def test_offset_of_a_design_is_forward_and_to_the_left(fixed: tuple[float, float] | None) -> None:
    """Reference: margin of the stand with the same offset; v3 is longer than wide."""
    x, y = 0.01, 0.02
    vary = {"offset_y": [y]} if fixed else {"offset_x": [x], "offset_y": [y]}
    one = study(vary, "com_margin", stand=pa.StandTask(offset=fixed) if fixed else pa.StandTask())
    builder = DesignBuilder(one.source, one.task, one.point)
    design = builder.design({name: values[0] for name, values in vary.items()})
    stand = pa.solve_stand(load("v3"), pa.StandTask(offset=(x, y)))
    assert METRICS["com_margin"].function(design) == pytest.approx(stand.com_margin, abs=1e-9)
    other = pa.solve_stand(load("v3"), pa.StandTask(offset=(y, x)))
    assert other.com_margin != pytest.approx(stand.com_margin, abs=1e-3)


@pytest.mark.parametrize("kind", ["kp", "mass"])
def test_variable_of_a_joint_with_brackets_selects_the_joint(kind: str, tmp_path: Path) -> None:
    urdf, mjcf = (text.replace('"elbow"', '"arm[0]"') for text in (URDF, MJCF))
    robot = load_arm(tmp_path, urdf=urdf, mjcf=mjcf)
    assert find_moving_joints(robot, VariablePattern(kind, "arm[0]")) == ("arm[0]",)


def test_visual_geoms_that_give_mass_are_kept_without_visuals(tmp_path: Path) -> None:
    """MuJoCo ignores stated inertials with ``inertiafromgeom="true"``: the sphere weighs 5 kg."""
    path = tmp_path / "arm.xml"
    path.write_text(
        '<mujoco><compiler inertiafromgeom="true"/><worldbody><body name="arm" pos="0 0 1">'
        '<inertial pos="0 0 0" mass="1" diaginertia="0.1 0.1 0.1"/><joint name="hinge"/>'
        '<geom size="0.1" mass="5" pos="0.2 0 0" contype="0" conaffinity="0"/></body></worldbody>'
        '<actuator><position joint="hinge" kp="100"/></actuator></mujoco>'
    )
    description = pa.load_robot(path).description
    assert without_visuals(description).mjcf.compile().body_mass[1] == 5.0


@pytest.mark.slow
def test_study_of_a_urdf_with_a_mesh_is_the_same_in_another_folder(tmp_path: Path) -> None:
    """MuJoCo reads the mesh by its absolute path; another mesh makes another study."""
    digests = []
    for name, height in (("one", 0.05), ("two", 0.05), ("three", 0.06)):
        (folder := tmp_path / name).mkdir()
        urdf = write_standing_urdf(folder)
        trimesh.creation.box((0.4, 0.2, height)).export(folder / "base.stl")
        rewrite_file(urdf, ('<box size="0.4 0.2 0.08"/>', '<mesh filename="base.stl"/>'))
        study = pa.Study(str(urdf), {"kp": [10.0]}, ["total_mass"])
        assert str(folder) in to_xml(study.base.description.mjcf)
        digests.append(study.digest)
    assert digests[0] == digests[1] != digests[2]


def test_repr_and_table_of_a_study_state_robot_designs_variables_and_metrics() -> None:
    made = pa.Study("v3", {"leg_scale": [1.0, 1.1]}, ["stands", "com_margin"])
    assert repr(made) == ("<Study of 'v3': 2 designs, vary leg_scale, measure stands, com_margin>")
    shown = made._repr_html_()
    assert "leg_scale: values [1.0, 1.1]" in shown
    assert "com_margin" in shown
    names = [name for name, metric in METRICS.items() if metric.of_file is None]
    many = pa.Study("v3", {"slope": [0.0]}, names)
    assert len(repr(many)) <= 200


def test_truth_values_of_a_table_are_restored() -> None:
    """Reference: the stored 1, 0 and missing values."""
    whole = restore_truth_values(pd.DataFrame({"stands": [1.0, 0.0], "servo_sag": [1.0, 0.0]}))
    assert whole["stands"].tolist() == [True, False]
    assert (whole["stands"].dtype, whole["servo_sag"].dtype) == (bool, float)
    partial = restore_truth_values(pd.DataFrame({"stands": [1.0, np.nan, 0.0]}))["stands"]
    assert partial.isna().tolist() == [False, True, False]
    assert partial.dropna().tolist() == [True, False]


def test_pareto_front_main_effects_and_requirements_accept_truth_values() -> None:
    """Reference: closed form, and the same table with the stored 1, 0 and missing values."""
    stored = pd.DataFrame({"mass": [1.0, 1.0, 2.0, 2.0], "stands": [1.0, 0.0, np.nan, 0.0]})
    table, objectives = restore_truth_values(stored), {"stands": "max", "mass": "max"}
    front = pa.study.pareto_front(table, objectives)
    assert front["mass"].tolist() == pa.study.pareto_front(stored, objectives)["mass"].tolist()
    assert front["stands"].tolist() == [True, False]
    effects = compute_main_effects(table, ["mass"], "stands", sampled=False)
    assert effects == {"mass": pytest.approx(1 - 0.5 / (2 / 3))}  # squares within and in total
    assert Requirement.parse("stands", text=True).is_met(table).tolist() == [True, *[False] * 3]


def test_table_of_an_outcome_has_truth_values_where_a_metric_is_missing(tmp_path: Path) -> None:
    """The table is that of the study; the report prints 1, 0 and "-". Reference: stored rows."""
    study = pa.Study("v3", {"slope": [0.0, 0.1, 0.2]}, ["stands"], minimise=["stands"])
    hashes = [name for names, _ in study.designs() for name in names]
    missing = {"failure": "unreachable", "failed_metric": "stands", "reason": "no stand"}
    rows = [{"stands": 1.0}, {"stands": 0.0}, missing]
    store = Store(tmp_path)
    with store.locked():
        request = {"study": study.to_dict(), "digest": study.digest, "versions": {}}
        store.write_request(request)
        store.write(
            [
                {"design": name, "slope": 0.1 * number, **row}
                for number, (name, row) in enumerate(zip(hashes, rows, strict=True))
            ]
        )
    outcome = study_outcome(study, tmp_path)
    pd.testing.assert_frame_equal(outcome.table, study.table(tmp_path))
    assert outcome.table["stands"].dtype == "boolean"
    written = json.loads(to_json(outcome.table.to_dict(orient="list")))
    assert written["stands"] == [True, False, None]
    assert outcome.front["stands"].tolist() == [True]
    table = study_document(outcome).blocks[-1]
    assert [cell.text for cell in (row[2] for row in table.rows)] == ["1", "0", "-"]


def test_a_damaged_definition_is_replaced_with_force_only(tmp_path: Path) -> None:
    """The message about the file proposes --force, which must then work."""
    store = Store(tmp_path)
    (tmp_path / "study.json").write_text("{\n")
    with ensure_run() as run:
        with pytest.raises(pa.OutputError, match="force"):
            store.write_request({"digest": "x"})
        assert (tmp_path / "study.json").read_text() == "{\n"
        run.force = True
        store.write_request({"digest": "x"})
        (tmp_path / "study.json").write_text('{"format": 0}')
        with pytest.raises(pa.StudyError, match="format"):
            store.write_request({"digest": "x"})
