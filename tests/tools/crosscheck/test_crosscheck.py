"""The cross-check of both engines on both files: equal models agree, and a changed number is
located.
"""

from __future__ import annotations

import copy
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.tools.crosscheck.crosscheck import EDGE_NAMES, EXTRAS_EDGE, cross_check
from tests.support.legged import quadruped, rewrite_file
from tests.support.robots import (
    Frame,
    arm,
    compare_files,
    match_files,
    mjcf_text,
    numbers,
    urdf_text,
    write,
)


@pytest.mark.parametrize("name", pa.VARIANTS)
def test_both_models_of_every_variant_agree_in_both_engines(name: str) -> None:
    """All quantities within a relative 1e-12."""
    check = cross_check(pa.load_variant(name))
    assert check.passed
    assert max(quantity.relative for quantity in check.quantities) < 1e-12


def test_cross_check_compares_all_documented_quantities() -> None:
    """Each quantity has a scale above zero, so that none compares zeros only."""
    quantities = {q.name: q for q in cross_check(pa.load_variant("v3")).quantities}
    assert set(quantities) >= {
        *("body masses", "body coms", "body inertias", "lower joint limits", "upper joint limits"),
        *("effort limits", "foot positions", "foot Jacobians", "com", "com Jacobian"),
        *("mass matrix", "bias forces", "gravity", "forward dynamics", "gyro", "accelerometer"),
    }
    # Every quantity has a scale above zero, and all edges except yourdfpy's.
    every = set(EDGE_NAMES.values())
    for quantity in quantities.values():
        assert quantity.scale > 0, quantity.name
        assert set(quantity.edge_deviations) >= every - {"yourdfpy (URDF)"}
    assert set(quantities["foot positions"].edge_deviations) == every


def _with_urdf(robot: pa.Robot, old: str, new: str) -> pa.Robot:
    """Return the robot with a piece of its URDF replaced, at its first place."""
    assert old in robot.description.urdf
    path = robot.description.urdf_source
    text = robot.description.urdf.replace(old, new, 1)
    description = replace(robot.description, urdf=text, urdf_source=path)
    from pupper_analysis.robot.build import build_robot

    return build_robot(description, fixed_base=False, foot_depth=None)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("old", "new", "quantities", "where"),
    [
        ('<mass value="1.506"/>', '<mass value="1.507"/>', {"body masses", "com"}, "base_link"),
        ('ixx="7.4e-05"', 'ixx="7.5e-05"', {"body inertias", "mass matrix"}, "leg_front_r_1"),
        ('xyz="0 -0.0334 0.05419"', 'xyz="0 -0.0334 0.05519"', {"body coms"}, "leg_front_r_2"),
        ('upper="2.51"', 'upper="2.5"', {"upper joint limits"}, "leg_front_r_1"),
        ('lower="-1.22"', 'lower="-1.2"', {"lower joint limits"}, "leg_front_r_1"),
        ('effort="3"', 'effort="3.5"', {"effort limits"}, "leg_front_r_1"),
        (
            'damping="0.01"',
            'damping="0.02"',
            {"joint damping", "forward dynamics"},
            "leg_front_r_1",
        ),
        ('friction="0.01"', 'friction="0.02"', {"joint friction"}, "leg_front_r_1"),
        ('<axis xyz="0 0 1"/>', '<axis xyz="0 0 -1"/>', {"joint axes"}, "leg_front_r_1"),
        (
            'xyz="0.06231 -0.06216 0.018"/>\n    <parent',
            'xyz="0.0624 -0.06216 0.018"/>\n    <parent',
            {"foot positions"},
            "FR",
        ),
        ('xyz="0.09 0 0.032"', 'xyz="0.09 0.01 0.032"', {"accelerometer"}, "IMU"),
    ],
)
def test_a_changed_number_is_found(old: str, new: str, quantities: set[str], where: str) -> None:
    """Both engines agree on each file within 1e-12; the files differ in the changed quantity, at
    the changed element.
    """
    check = cross_check(_with_urdf(pa.load_variant("v3"), old, new))
    assert not check.passed
    failed = {quantity.name: quantity for quantity in check.quantities if not quantity.passed}
    assert quantities <= set(failed)
    # The models differ, and each engine agrees with the other on each model.
    for quantity in failed.values():
        assert quantity.edge.startswith("models")
        assert quantity.edge_deviations["engines (URDF)"] < 1e-12
        assert quantity.edge_deviations["engines (MJCF)"] < 1e-12
    direct = next(failed[name] for name in failed if name in quantities)
    assert direct.location.startswith(where)


def test_engine_deviation_is_distinguished_from_model_deviation() -> None:
    """0.1 kg more in Pinocchio's model of the URDF alone."""
    robot = pa.load_variant("original")
    pin_model = robot.pin_model.copy()
    pin_model.inertias[1].mass += 0.1  # in Pinocchio's copy of the URDF alone
    check = cross_check(replace(robot, pin_model=pin_model))
    masses = next(quantity for quantity in check.quantities if quantity.name == "body masses")
    assert not masses.passed
    assert masses.edge_deviations["engines (URDF)"] > 1e-3
    assert masses.edge_deviations["models (MuJoCo)"] == 0
    assert masses.edge_deviations["engines (MJCF)"] == 0


def test_mass_deviation_is_the_difference_of_both_files() -> None:
    """Reference: base masses of 1.506 and 1.509 kg in the MJCF and the changed URDF."""
    check = cross_check(_with_urdf(pa.load_variant("v3"), 'value="1.506"', 'value="1.509"'))
    masses = next(quantity for quantity in check.quantities if quantity.name == "body masses")
    assert masses.deviation == pytest.approx(0.003, rel=1e-9)
    assert masses.relative == pytest.approx(0.003 / 1.509, rel=1e-9)


@pytest.mark.parametrize("name", ["original", "v3"])
def test_variant_with_a_fixed_base_passes(name: str) -> None:
    """References: the other engine and the other file."""
    assert cross_check(pa.load_variant(name, fixed_base=True)).passed


def test_inertia_deviation_is_relative_to_its_own_link() -> None:
    """Reference: the largest moment of the changed link, a hundredth of that of the base."""
    robot = _with_urdf(pa.load_variant("v3"), 'ixx="7.4e-05"', 'ixx="7.5e-05"')
    check = cross_check(robot)
    found = next(quantity for quantity in check.quantities if quantity.name == "body inertias")
    joint = robot.pin_model.getJointId("leg_front_r_1")
    scale = np.abs(robot.pin_model.inertias[joint].inertia).max()
    assert scale < 1e-2 * np.abs(robot.pin_model.inertias[1].inertia).max()
    assert found.scale == pytest.approx(scale, rel=1e-9)
    assert found.relative == pytest.approx(found.deviation / found.scale, rel=1e-12)
    assert found.relative > 0.3e-6 / scale


def test_cross_check_passes_within_the_given_tolerance() -> None:
    """A mass that differs by 7e-8 relative: above the default of rounding errors, below 1e-3."""
    robot = _with_urdf(pa.load_variant("v3"), 'value="1.506"', 'value="1.5060001"')
    assert not cross_check(robot).passed
    assert cross_check(robot, tolerance=1e-3).passed


def test_cross_check_is_deterministic_and_depends_on_the_seed() -> None:
    robot = pa.load_variant("v3")
    one, same, other = (cross_check(robot, seed=seed, configurations=3) for seed in (1, 1, 2))
    assert one.to_json() == same.to_json()
    assert one.to_json() != other.to_json()


@pytest.mark.parametrize("options", [{"configurations": 0}, {"tolerance": 0.0}, {"tolerance": -1}])
def test_cross_check_refuses_bad_arguments(options: dict[str, float]) -> None:
    with pytest.raises(pa.ConfigurationError, match=next(iter(options))):
        cross_check(pa.load_variant("v3"), **options)  # type: ignore[arg-type]


def test_another_armature_changes_the_mass_matrix_and_not_gravity() -> None:
    """Twice the armature in MuJoCo's model alone."""
    robot = pa.load_variant("v3")
    model = copy.copy(robot.mj_model)
    model.dof_armature[6:] *= 2
    mujoco.mj_setConst(model, mujoco.MjData(model))
    check = cross_check(replace(robot, mj_model=model))
    failed = {quantity.name for quantity in check.quantities if not quantity.passed}
    assert {"armature", "mass matrix", "forward dynamics"} <= failed
    assert "gravity" not in failed
    assert np.isfinite([quantity.relative for quantity in check.quantities]).all()


def test_spring_that_only_the_mjcf_has_is_a_difference_of_the_files() -> None:
    """A stiffness of 2 N m/rad in MuJoCo's model alone; a URDF cannot state springs."""
    robot = pa.load_variant("v3")
    model = copy.copy(robot.mj_model)
    model.jnt_stiffness[3] = 2.0
    check = cross_check(replace(robot, mj_model=model), configurations=3)
    assert not check.passed
    failed = {quantity.name: quantity for quantity in check.quantities if not quantity.passed}
    assert {quantity.edge for quantity in failed.values()} == {EXTRAS_EDGE}
    assert "forward dynamics" in failed


def test_spring_of_an_mjcf_alone_is_no_difference_of_files(tmp_path: Path) -> None:
    """There is no URDF that could disagree with the spring."""
    path = quadruped(tmp_path).mjcf
    rewrite_file(path, ('name="FL_knee"', 'name="FL_knee" stiffness="2"'))
    robot = pa.load_robot(mjcf=path)
    assert robot.mj_model.jnt_stiffness[robot.mj_model.joint("FL_knee").id] == 2.0
    check = cross_check(robot, configurations=3)
    assert check.passed
    assert all(EXTRAS_EDGE not in quantity.edge_deviations for quantity in check.quantities)


def test_length_of_a_joint_axis_is_ignored(tmp_path: Path) -> None:
    """Both engines normalise the axis; yourdfpy would scale the motion of a slide."""
    tip = (Frame("tip", "rod", (0.1, 0.0, 0.0)),)
    text = urdf_text(arm(), tip)
    first, second = (f'<axis xyz="{numbers((length, 0.0, 0.0))}"/>' for length in (1.0, 2.5))
    assert first in text
    text = text.replace(first, second)
    assert text.count(second) == 1
    files = write(tmp_path, text, mjcf_text(arm(), tip, free=False))
    comparison = compare_files(files)
    assert comparison.agree
    assert comparison.engines == ()


def test_different_mass_lists_the_fixed_links_of_the_body(tmp_path: Path) -> None:
    pack = """<link name="pack"><inertial><mass value="3"/>
    <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
    <joint name="bolted" type="fixed"><parent link="rod"/><child link="pack"/></joint></robot>"""
    parts = {**arm(), "rod": replace(arm()["rod"], mass=1.0)}
    urdf = urdf_text(parts, ()).replace("</robot>", pack)
    differences = compare_files(write(tmp_path, urdf, mjcf_text(parts, (), free=False))).differences
    (mass,) = [difference for difference in differences if difference.kind == "mass"]
    assert [str(message) for message in mass.made_of] == [
        "in the URDF 4 kg: pack 3 kg, rod 1 kg",
        "in the MJCF 1 kg",
    ]


@pytest.mark.parametrize("loaded", [False, True])
def test_mimic_agrees_with_an_equal_joint_equality(tmp_path: Path, loaded: bool) -> None:
    """Another factor of the equality is a deviation of the forward dynamics."""
    lift = '<joint name="lift" type="revolute">'
    mimic = '<mimic joint="turn" multiplier="-1.5" offset="0.1"/>'
    urdf = urdf_text(arm()).replace(lift, lift + mimic)
    for factor, passes in ((-1.5, True), (-1.0, False)):
        equality = f'<joint joint1="lift" joint2="turn" polycoef="0.1 {factor} 0 0 0"/>'
        mjcf = mjcf_text(arm(), free=False, extra=f"<equality>{equality}</equality>")
        files = write(tmp_path, urdf, mjcf)
        robot = pa.load_robot(files.urdf, files.mjcf) if loaded else match_files(files).robot
        check = cross_check(robot, configurations=3)
        assert check.passed == passes
        assert passes or check.worst == "forward dynamics"
