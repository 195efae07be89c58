"""Physics at which planted faults once survived all tests: each test fails with one of these
faults.
"""

from __future__ import annotations

import math
from pathlib import Path

import mujoco
import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.prepare.servo_tuning import DEFAULT_SAG, suggest_fixed_base_gains
from pupper_analysis.pupper.derive import derive_mjcf
from pupper_analysis.robot.build import rebuild_robot
from pupper_analysis.robot.floor import find_floor, level_ground
from pupper_analysis.robot.terrain import build_on_ground
from pupper_analysis.stance.branches import _remove_turns
from tests.support.engines import change_model, evaluate_mujoco
from tests.support.legged import quadruped
from tests.support.repository import ROOT
from tests.support.variants import BASES, load, stand_of

GRAVITY = 9.81


# --------------------------------------------------------------------------------- held servos


def rods(timestep: float) -> mujoco.MjModel:
    """Two rods of 2 kg at 0.1 m that stay level, on hinges of opposite senses."""
    bodies = "".join(
        f'<body pos="0 {y} 1"><joint axis="0 {sense} 0" range="-0.001 0.001"/>'
        '<inertial pos="0.1 0 0" mass="2" diaginertia="1e-9 1e-9 1e-9"/></body>'
        for y, sense in ((0, 1), (1, -1))
    )
    return mujoco.MjModel.from_xml_string(
        f'<mujoco><compiler angle="radian" autolimits="true"/><option timestep="{timestep}"/>'
        f"<worldbody>{bodies}</worldbody></mujoco>"
    )


def test_suggested_gain_of_a_held_joint_gives_the_default_sag() -> None:
    """Reference: the gravity torque m g l of the rod, which the servo holds at the default sag."""
    kp, _ = suggest_fixed_base_gains(rods(1e-3))
    np.testing.assert_allclose(kp * DEFAULT_SAG, 2 * GRAVITY * 0.1, rtol=1e-2)


def test_a_held_joint_is_no_stiffer_than_the_time_step_allows() -> None:
    """The step is half a radian of the servo's own motion: h sqrt(kp / I)."""
    kp, _ = suggest_fixed_base_gains(rods(1e-2))
    np.testing.assert_allclose(1e-2 * np.sqrt(kp / (2 * 0.1**2)), 0.5, rtol=1e-2)


# --------------------------------------------------------------------------------------- models


def test_a_sphere_beside_a_foots_site_is_not_the_foot(tmp_path: Path) -> None:
    """A ball 3 cm above the site is the shin's; the foot is the box at it."""
    shapes = (
        '<geom type="sphere" size="0.015" pos="0 0 -0.17"/>'
        '<geom type="box" size="0.02 0.02 0.01" pos="0 0 -0.2"/><site name="TIP" pos="0 0 -0.2"/>'
    )
    pair = quadruped(tmp_path, foot=shapes, floor=True, actuators="position")
    first, *rest = pair.mjcf.read_text().split("TIP")
    names = [f"{leg}_tip" for leg in ("FL", "FR", "RL", "RR")]
    text = first + "".join(name + part for name, part in zip(names, rest, strict=True))
    pair.mjcf.write_text(text)
    robot = pa.load_robot(urdf=pair.urdf, mjcf=pair.mjcf, feet=names)
    boxes = {int(robot.mj_model.geom_type[geom]) for geom in robot.foot_geoms}
    assert boxes == {mujoco.mjtGeom.mjGEOM_BOX.value}


def test_bar_across_a_scaled_link_is_stretched_along_the_link_only() -> None:
    """A bar at 45 degrees to the thigh is moved and rotated; only its component along the thigh
    is stretched."""
    spec = mujoco.MjSpec.from_file(str(ROOT / "mjcf" / f"{BASES['original']}.xml"))
    variant = pa.pupper.VariantSpec(base="skeleton", leg_scale=1.5)
    robot = load("original")
    thigh = spec.site(robot.description.contact_points[robot.contact_points[0]][1]).parent.parent
    calf = next(iter(thigh.bodies))
    knee = np.array(calf.pos)
    across = np.array([-knee[2], 0.0, knee[0]])
    ends = np.concatenate([np.zeros(3), knee + across])
    thigh.add_geom(
        name="bar", type=mujoco.mjtGeom.mjGEOM_CAPSULE, fromto=ends, size=(0.005, 0, 0), mass=0.07
    )
    derive_mjcf(spec, variant)
    assert spec.geom("bar").mass == 0.07


@pytest.mark.parametrize(("foot", "floor"), [((0, 1), (1, 0)), ((2, 0), (0, 2))])
def test_feet_with_one_matching_contact_mask_touch_the_step(
    foot: tuple[int, int], floor: tuple[int, int]
) -> None:
    """Reference: MuJoCo's rule, contype of one geom and conaffinity of the other, in either
    order."""
    robot, spec = load("original"), load("original").description.mjcf.copy()
    spec.compile()
    for geom in spec.geoms:
        geom.contype, geom.conaffinity = foot if geom.id in robot.foot_geoms else (0, 0)
    ground = find_floor(spec)
    assert ground is not None
    ground.contype, ground.conaffinity = floor
    stand = stand_of("original")
    step = pa.Ground(heights={robot.contact_points[0]: 0.01})
    there = build_on_ground(rebuild_robot(robot, mjcf=spec), step, stand.foot_targets)
    sunk = stand.qpos.copy()
    sunk[2] -= 2e-3
    data = evaluate_mujoco(there, sunk)
    name, touched = there.mj_model.geom, []
    for pair in data.contact.geom:
        ours = next(int(geom) for geom in pair if int(geom) in there.foot_geoms)
        other = next(int(geom) for geom in pair if int(geom) != ours)
        touched.append((there.foot_geoms[ours], name(other).name.startswith("step_")))
    expected = {(point, point == robot.contact_points[0]) for point in robot.contact_points}
    assert set(touched) == expected


# -------------------------------------------------------------------------- stances and statics


def test_angles_are_unwound_by_whole_turns() -> None:
    """Each angle keeps its direction, and is at most half a turn from home."""
    robot = load("original")
    home = robot.home[7:]
    wide = np.full(robot.nu, 20.0)
    away = np.linspace(-9.0, 9.0, robot.nu)
    found = _remove_turns(robot, home + away, -wide, wide)
    np.testing.assert_allclose(np.exp(1j * found), np.exp(1j * (home + away)), atol=1e-12)
    assert np.abs(found - home).max() <= math.pi + 1e-12


def test_scenery_is_named_by_its_geom_or_body() -> None:
    """Reference: the names of the geoms and bodies in the text of the file."""
    spec = mujoco.MjSpec.from_string(
        '<mujoco><worldbody><geom type="plane" size="0 0 1"/><geom type="box" size="1 1 1"/>'
        '<body name="table"><geom type="box" size="1 1 1"/><geom name="leg" size="1"/></body>'
        "</worldbody></mujoco>"
    )
    (left_out,) = level_ground(spec)
    nameless, *names = left_out.values["names"]
    assert nameless.code == "geom-without-name"
    assert names == ["table", "leg"]


# ----------------------------------------------------------------------------------- simulation


def test_joints_that_miss_their_prediction_by_milliradians_do_not_verify_it() -> None:
    """Servos so soft that half a percent of torque is some mrad: torques and forces agree."""
    robot = load("v3")
    heavier = change_model(
        robot, lambda model: np.multiply(model.body_mass, 1.006, model.body_mass)
    )
    found = pa.verify_stand(heavier, stand_of("v3"), kp=2.0, kd=0.1)
    assert found.torque_error < 0.01
    assert found.force_error < 0.01
    assert 1e-3 < found.joint_error < 1e-2
    assert not found.passed
