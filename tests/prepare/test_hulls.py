"""Shapes beside soft feet: the contact points are the points that touch in MuJoCo with the
published model.
"""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.prepare.judge import judge_stand
from tests.support.legged import quadruped, rewrite_file

_SHANK = '<geom type="capsule" size="0.01" fromto="0 0 -0.1 0 0 -0.2" solref="{} 1"/>'


def _soft_footed(folder: Path, gap: float, time_constant: float = 0.004) -> pa.Robot:
    """Return a quadruped with soft feet, and shanks that end higher than the feet.

    Args:
        folder: Folder of the files.
        gap: Height of the lower ends of the shanks above those of the feet [m].
        time_constant: Time constant of the contacts of the shanks [s]; small values are stiff.
    """
    foot = f'<geom type="sphere" size="{0.01 + gap}" pos="0 0 -0.2" solimp="0.015 1 0.036"/>'
    pair = quadruped(folder, foot=foot + _SHANK.format(time_constant), floor=True)
    rewrite_file(pair.mjcf, ("<worldbody>", '<option cone="elliptic"/><worldbody>'), count=1)
    return pa.load_robot(pair.mjcf)


def _state_at_rest(robot: pa.Robot, stand: pa.Stand, kp: float, kd: float) -> mujoco.MjData:
    """Return the state in which bare MuJoCo holds a stand on the unmodified shapes."""
    assert robot.published is not None
    assert robot.published.file is not None
    spec = robot.published.file.spec.copy()
    for actuator in list(spec.actuators):
        spec.delete(actuator)
    for name in robot.joint_names:
        servo = spec.add_actuator(target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        servo.gainprm[0], servo.biastype = kp, mujoco.mjtBias.mjBIAS_AFFINE
        servo.biasprm[1], servo.biasprm[2] = -kp, -kd
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.timestep = 5e-4
    model = spec.compile()
    data = mujoco.MjData(model)
    robot.mj_convention.set_state(data, stand.qpos)
    data.ctrl[:] = stand.joint_positions(robot)
    mujoco.mj_step(model, data, nstep=round(4.0 / model.opt.timestep))
    assert np.abs(data.qvel).max() < 1e-3
    return data


@pytest.mark.slow
@pytest.mark.parametrize(("gap", "hull"), [(0.003, True), (0.03, False)])
def test_a_stiff_shank_beside_a_soft_foot_is_the_contact_point(
    tmp_path: Path, gap: float, hull: bool
) -> None:
    """The prediction is compared with bare MuJoCo, on the unmodified shapes and very stiff servos.

    The soft feet alone would sink by more than the gap of 3 mm, and by less than that of 30 mm.
    """
    robot = _soft_footed(tmp_path, gap)
    assert ("hulls-carry-instead-of-feet" in {note.code for note in robot.notes}) is hull
    radii = list(robot.contact_radius.values())
    assert radii == pytest.approx([0.01 if hull else 0.01 + gap] * 4)
    stand = pa.solve_stand(robot)
    held = pa.solve_stand_as_simulated(robot, stand)
    height = _state_at_rest(robot, held, 4000.0, 200.0).qpos[2]
    assert height == pytest.approx(held.qpos[2], abs=5e-4)
    assert judge_stand(robot, stand).passed


@pytest.mark.slow
def test_shanks_and_soft_feet_may_both_be_ellipsoids(tmp_path: Path) -> None:
    """Spheres replace both, with the same name. Loading ended in a KeyError: the contacts of the
    new sphere were disabled. Reference: the lower end of the shank, 3 mm above that of the foot.
    """
    foot = '<geom type="ellipsoid" size=".02 .02 .02" pos="0 0 -0.2" solimp="0.015 1 0.036"/>'
    shank = '<geom type="ellipsoid" size=".01 .01 .117" pos="0 0 -0.1" solref="0.004 1"/>'
    pair = quadruped(tmp_path, foot=foot + shank, floor=True)
    robot = pa.load_robot(pair.mjcf)
    assert "hulls-carry-instead-of-feet" in {note.code for note in robot.notes}
    model = robot.mj_model
    for geom, radius in robot.description.foot_geoms.values():
        assert model.geom(geom).contype[0] or model.geom(geom).conaffinity[0]
        assert model.geom(geom).pos[2] - radius == pytest.approx(-0.217, abs=2e-3)


@pytest.mark.slow
def test_a_soft_foot_stays_the_contact_point_if_it_carries_more_than_its_shank(
    tmp_path: Path,
) -> None:
    """Reference: contact forces of bare MuJoCo at rest, where foot and shank touch the floor."""
    robot = _soft_footed(tmp_path, 0.003, time_constant=0.12)
    assert "hulls-carry-instead-of-feet" not in {note.code for note in robot.notes}
    assert list(robot.contact_radius.values()) == pytest.approx([0.013] * 4)
    data = _state_at_rest(robot, pa.solve_stand(robot), 4000.0, 200.0)
    forces = dict.fromkeys((mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_CAPSULE), 0.0)
    for number, contact in enumerate(data.contact):
        force = np.zeros(6)
        mujoco.mj_contactForce(data.model, data, number, force)
        forces[mujoco.mjtGeom(data.model.geom_type[max(contact.geom)])] += force[0]
    assert 0 < forces[mujoco.mjtGeom.mjGEOM_CAPSULE] < forces[mujoco.mjtGeom.mjGEOM_SPHERE]


@pytest.mark.slow
def test_shank_beside_a_soft_foot_does_not_touch_the_floor(tmp_path: Path) -> None:
    """Reference: MuJoCo reaches the torques and forces that the feet alone give, within 1e-5."""
    robot = _soft_footed(tmp_path, 0.003, time_constant=0.12)
    assert "shapes-beside-feet-do-not-touch" in {note.code for note in robot.notes}
    verification = pa.verify_stand(robot, pa.stance.solve_stand_on_soft_ground(robot))
    assert verification.passed, verification.failures
    assert max(verification.torque_error, verification.force_error) < 1e-5


@pytest.mark.slow
def test_of_two_equal_shanks_beside_a_soft_foot_the_chosen_one_carries_the_load(
    tmp_path: Path,
) -> None:
    """Reference: contact forces of bare MuJoCo at rest, in which all shapes may touch.

    The stand is solved for one of two equal shanks, 60 mm apart, so the leg leans until this shank
    is the lowest. A split of the load would be a deviation of the published file.
    """
    foot = '<geom type="sphere" size="0.013" pos="0 0 -0.2" solimp="0.015 1 0.036"/>'
    shank = '<geom type="capsule" size="0.01" fromto="0 {0} -0.1 0 {0} -0.2" solref="0.004 1"/>'
    shanks = shank.format(-0.03) + shank.format(0.03)
    pair = quadruped(tmp_path, foot=foot + shanks, floor=True)
    rewrite_file(pair.mjcf, ("<worldbody>", '<option cone="elliptic"/><worldbody>'), count=1)
    robot = pa.load_robot(pair.mjcf)
    assert "hulls-carry-instead-of-feet" in {note.code for note in robot.notes}
    stand = pa.solve_stand(robot)
    data = _state_at_rest(robot, pa.solve_stand_as_simulated(robot, stand), 4000.0, 200.0)
    loads, force = dict.fromkeys(robot.contact_points, 0.0), np.zeros(6)
    chosen = {foot: robot.contact_places[foot][1][1] for foot in robot.contact_points}
    for number, contact in enumerate(data.contact):
        geom = data.model.geom(max(contact.geom))
        mujoco.mj_contactForce(data.model, data, number, force)
        if geom.type[0] == mujoco.mjtGeom.mjGEOM_CAPSULE.value:
            body = data.model.body(geom.bodyid[0]).name
            assert geom.pos[1] == pytest.approx(chosen[body])
            loads[body] += force[0]
    assert min(loads.values()) > 0.9 * robot.weight / 4
    verdict = judge_stand(robot, stand)
    assert verdict.passed
    assert verdict.published is not None
    assert not verdict.published.differs
