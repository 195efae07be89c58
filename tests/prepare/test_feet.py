"""Fits of contact points."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.base.errors import ModelError
from pupper_analysis.prepare.contact_points import ContactPoint
from pupper_analysis.prepare.feet import Foot, is_ball, measure_point_displacement
from pupper_analysis.stance.stand import stand_statics
from tests.support.legged import Pair, biped, quadruped, rewrite_file


@pytest.mark.parametrize(
    ("name", "geom", "displacement", "measured"),
    [("FL", 3, 0.0, 0.0), ("FL", 3, 1e-5, 1e-5), ("FL", 4, 1e-5, 0.0), ("FR", 3, 1e-5, 0.0)],
)
def test_displacement_of_contact_points_is_that_of_the_same_points(
    name: str, geom: int, displacement: float, measured: float
) -> None:
    """Other feet or geoms are no displacement."""

    def foot(name: str, geom: int, x: float) -> Foot:
        return Foot(name, 2, (ContactPoint(geom, np.array([x, 0.0, 0.0]), 0.02),))

    before, after = [foot("FL", 3, 0.0)], [foot(name, geom, displacement)]
    assert measure_point_displacement(before, after) == measured


def test_floor_without_contacts_is_no_ground_for_feet(tmp_path: Path) -> None:
    """In bare MuJoCo the robot falls through this floor. Loading ended in a ValueError."""
    path = quadruped(tmp_path, floor=True).mjcf
    rewrite_file(path, ('type="plane"', 'type="plane" contype="0" conaffinity="0"'))
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, nstep=1000)
    assert data.subtree_com[1][2] < -5.0
    with pytest.raises(ModelError, match="no feet"):
        pa.load_robot(mjcf=path, visuals=False)


def test_legs_of_different_lengths_all_have_feet(tmp_path: Path) -> None:
    """At zero angles the forelegs end 21 % of the height above the hind legs, as those of SABO.

    The two hind feet alone have no support polygon. Reference: the weight, which four feet share.
    """
    path = quadruped(tmp_path, floor=True, actuators="position", keyframe="").mjcf
    foot, longer = 'size="0.02" pos="0 0 -0.2"', 'size="0.02" pos="0 0 -0.32"'
    fore, hind = path.read_text().split('<body name="RL_hip"')
    path.write_text(f'{fore}<body name="RL_hip"{hind.replace(foot, longer)}')
    robot = pa.load_robot(mjcf=path, visuals=False)
    assert sorted(robot.feet) == ["FL_calf", "FR_calf", "RL_calf", "RR_calf"]
    forces = stand_statics(robot, pa.solve_stand(robot)).contact_forces
    lifts = [force[2] for force in forces.values()]
    assert min(lifts) > 0.1 * sum(lifts)
    assert sum(lifts) == pytest.approx(robot.total_mass * 9.81, rel=1e-6)


@pytest.mark.parametrize(
    ("radius", "ball"), [(0.03, False), (0.02999999999999964, False), (0.02, True)]
)
def test_cylinder_with_the_fitted_radius_is_a_wheel_despite_rounding(
    radius: float, ball: bool
) -> None:
    """The fitted radius of a cylinder on its side deviates by 3.6e-16 m from the file's 0.03 m."""
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><geom type="cylinder" size="0.03 0.01"/></worldbody></mujoco>'
    )
    point: Any = SimpleNamespace(geom=0, radius=radius)
    assert is_ball(model, point) is ball


@pytest.mark.parametrize(
    ("bits", "floor_bits"), [((2, 2), (1, 1)), ((0, 0), (1, 1)), ((1, 1), (4, 2)), ((2, 1), (2, 4))]
)
def test_refusal_names_geoms_whose_contact_bits_exclude_the_floor(
    bits: tuple[int, int], floor_bits: tuple[int, int], tmp_path: Path
) -> None:
    """Reference: MuJoCo finds no contact of the feet 1 cm in the floor."""
    own, floor = (
        f'contype="{first}" conaffinity="{second}"' for first, second in (bits, floor_bits)
    )
    foot = f'<geom name="FOOT" {own} size="0.02" pos="0 0 -0.2"/>'
    pair = quadruped(tmp_path, foot=foot, floor=True)
    text = pair.mjcf.read_text()
    for leg in ("FL", "FR", "RL", "RR"):
        text = text.replace('"FOOT"', f'"{leg}"', 1)
    text = text.replace('<geom type="plane"', f'<geom {floor} type="plane"')
    pair.mjcf.write_text(text.replace('<geom type="box"', f'<geom {own} type="box"'))
    model = mujoco.MjModel.from_xml_path(str(pair.mjcf))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    data.qpos[2] -= 0.05
    mujoco.mj_forward(model, data)
    assert data.ncon == 0
    with pytest.raises(pa.ModelError, match="share no bit with the floor") as caught:
        pa.load_robot(*pair)
    problem = caught.value.cause
    assert problem.values["geoms"] == ("FL", "FR", "RL", "RR")
    assert (problem.values["contype"], problem.values["conaffinity"]) == bits
    line = text[: text.index('name="FL"')].count("\n") + 1
    assert caught.value.source.endswith(f":{line}")


def _add_foot_shapes(pair: Pair, element: str, shape: str) -> Path:
    """Add a shape to the feet of the URDF of a biped, as ``<visual>`` or ``<collision>``."""
    text = pair.urdf.read_text()
    for side in ("left", "right"):
        opened = f'<link name="{side}_tilt_link">'
        added = f'<{element}><origin xyz="0 0 -0.05"/><geometry>{shape}</geometry></{element}>'
        text = text.replace(opened, opened + added)
    pair.urdf.write_text(text)
    return pair.urdf


def test_urdf_whose_feet_have_visual_shapes_only_lacks_collision_shapes(tmp_path: Path) -> None:
    """A URDF has no contype, which the message named."""
    path = _add_foot_shapes(biped(tmp_path), "visual", '<box size="0.18 0.08 0.02"/>')
    robot = pa.load_robot(path)
    with pytest.raises(pa.ConfigurationError, match="no <collision> element") as caught:
        pa.solve_stand(robot)
    assert (why := caught.value.problem.values["why"]).code == "no-feet-as-shapes-are-visual"
    assert why.values["links"] == ("left_tilt_link", "right_tilt_link")


def test_two_round_feet_are_named_with_the_number_of_their_contact_points(tmp_path: Path) -> None:
    """The message was that the robot has no feet, which is false for example for Bolt."""
    path = _add_foot_shapes(biped(tmp_path), "collision", '<sphere radius="0.02"/>')
    robot = pa.load_robot(path)
    with pytest.raises(pa.ConfigurationError, match="at only 2 points") as caught:
        pa.solve_stand(robot)
    why = caught.value.problem.values["why"]
    assert set(why.values["feet"]) == {"left_tilt_link", "right_tilt_link"}


def test_visual_geoms_beside_collision_geoms_are_no_reason_for_missing_feet(tmp_path: Path) -> None:
    """The legs point upward. Their visual geoms have contype 0, as in most files."""
    visual = '<geom type="sphere" size="0.01" contype="0" conaffinity="0"/>'
    with pytest.raises(pa.ModelError, match="the limbs end along") as caught:
        pa.load_robot(mjcf=_turn_legs_up(biped(tmp_path, f"{_SOLE_ABOVE}{visual}").mjcf))
    assert caught.value.cause.code == "limbs-aside"


def test_visual_geoms_of_hands_are_no_reason_for_feet_without_geoms(tmp_path: Path) -> None:
    """H1 with sites instead of geoms at the feet: the message named the hands."""
    hand = (
        '<body name="hand" pos="0 0 0.2"><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
        '<joint name="wrist" range="-1 1"/>'
        '<geom type="sphere" size="0.01" contype="0" conaffinity="0"/></body></body></worldbody>'
    )
    path = biped(tmp_path, '<site pos="0 0 -0.05"/>').mjcf
    rewrite_file(path, ("</body></worldbody>", hand))
    with pytest.raises(pa.ModelError, match="add collision geoms to the feet"):
        pa.load_robot(mjcf=path)


_SOLE_ABOVE = '<geom type="box" size="0.09 0.04 0.01" pos="0.03 0 0.05"/>'
"""Sole of a biped whose legs point upward."""


def _turn_legs_up(path: Path) -> Path:
    """Mirror the legs of the MJCF of a biped at the horizontal plane."""
    return rewrite_file(path, (' -0.3"', ' 0.3"'), (' -0.02"', ' 0.02"'))


def test_advice_for_a_base_that_is_upside_down_leads_to_a_stand(tmp_path: Path) -> None:
    """The advice was to change the URDF of a user who had an MJCF only."""
    path = _turn_legs_up(biped(tmp_path, _SOLE_ABOVE).mjcf)
    with pytest.raises(pa.ModelError, match="in an MJCF, a body with the free joint") as caught:
        pa.load_robot(mjcf=path)
    quat = caught.value.cause.values["quat"]
    outer = f'<body name="frame" pos="0 0 0.8"><freejoint/><body pos="0 0 0" quat="{quat}" '
    rewrite_file(
        path,
        ('<body name="pelvis" pos="0 0 0.8"><freejoint/>', f'{outer}name="pelvis">'),
        ("</worldbody>", "</body></worldbody>"),
    )
    robot = pa.load_robot(mjcf=path)
    forces = stand_statics(robot, pa.solve_stand(robot)).contact_forces
    weight = 9.81 * robot.mj_model.body_mass.sum()
    assert sum(force[2] for force in forces.values()) == pytest.approx(weight)
