"""Stands on soft ground: MuJoCo's simulation reaches the predicted torques and forces to 1 part in
1,000.
"""

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.robot.compliance import GroundLaw
from pupper_analysis.simulation.verify import FORCE_TOLERANCE
from pupper_analysis.stance.soft_ground import (
    _fit_plane,
    _update_relaxation,
    solve_stand_on_soft_ground,
)
from pupper_analysis.stance.stand import stand_statics
from tests.support import random_legged, slips
from tests.support.legged import rewrite_file
from tests.support.variants import NAMES, load

TASKS = {
    "nominal": pa.StandTask(),
    "off the centre": pa.StandTask(offset=(-0.02, 0.025), yaw=0.1),
    "slope": pa.StandTask(pitch=-0.25, ground=pa.Ground(0.3, 0.2), com="inside"),
    "steps": pa.StandTask(com=(0.015, 0.01), ground=pa.Ground(heights={"FR": 0.015, "RL": 0.005})),
    "low step": pa.StandTask(ground=pa.Ground(heights={"RR": 0.0004}), com=(0.01, -0.02)),
    "three legs": pa.StandTask(swing={"FL": 0.025}, com="inside", com_margin=0.01),
}


@pytest.mark.slow
@pytest.mark.parametrize("what", TASKS)
@pytest.mark.parametrize("name", NAMES)
def test_simulation_confirms_the_stand_predicted_on_soft_ground(name: str, what: str) -> None:
    """Reference: simulation with feed-forward: 0.3 of the tolerance of torques and forces."""
    robot = load(name)
    stand = solve_stand_on_soft_ground(robot, TASKS[what])
    assert max(stand.foot_error, stand.height_error, stand.com_error) < 1e-9
    run = pa.verify_stand(robot, stand)
    # v3-long-leg buckles on three legs, and falls 40 s after a nudge.
    buckles = (name, what) == ("v3-long-leg", "three legs")
    assert run.stability.is_stable_for() is not buckles
    assert run.passed is not buckles, run.failures
    assert run.torque_error < 0.3 * FORCE_TOLERANCE
    assert run.force_error < 0.3 * FORCE_TOLERANCE
    if not stand.task.ground.slope:  # on a slope, the robot slides down
        assert abs(run.height_loss) < 5e-6


@pytest.mark.parametrize("what", ["steps", "off the centre", "three legs"])
@pytest.mark.parametrize("name", ["heavy", "v3"])
def test_the_stand_on_soft_ground_is_the_equilibrium_that_feedforward_holds(
    name: str, what: str
) -> None:
    """Reference: `steady_state`, Newton's iteration on the soft ground with the torques of the
    stand.
    """
    robot = load(name)
    stand = solve_stand_on_soft_ground(robot, TASKS[what])
    pose = pa.steady_state(robot, stand, feedforward=True)
    np.testing.assert_allclose(pose.qpos, stand.qpos, atol=1e-6)
    forces = stand_statics(
        robot, stand, distribution=pa.statics.ForceDistribution.MIN_TANGENTIAL
    ).contact_forces
    for foot, force in forces.items():
        np.testing.assert_allclose(pose.contact_forces[foot], force, atol=1e-4)


def test_fitted_plane_of_random_corner_depths_has_the_same_force_and_moments() -> None:
    """Reference: force and moments of the ground law at the four depths, some of which are zero."""
    law, random = GroundLaw.of_contact(load("v3"), "FL"), np.random.default_rng(0)
    corners = np.array([(1.0, 1.0, 0.3), (1.0, 1.0, -0.3), (1.0, -1.0, 0.3), (1.0, -1.0, -0.3)])

    def load_of(depths: np.ndarray) -> np.ndarray:
        return corners.T @ [law.force(max(-law.margin, depth)) for depth in depths.tolist()]

    lifted = 0
    for _ in range(60):
        depths = np.maximum(0.0, random.normal(2e-4, 4e-4, 4))
        if not depths.any():
            continue
        found = _fit_plane(corners, [law] * 4, depths.tolist())
        lifted += bool((found < -law.margin).any())
        np.testing.assert_allclose(load_of(found), load_of(depths), atol=1e-10 * load_of(depths)[0])
    assert lifted > 10


@pytest.mark.slow
def test_stand_is_rigid_if_the_legs_are_too_short_for_soft_ground() -> None:
    """Legs that are straight on rigid ground do not reach down by the depth of the feet."""
    robot = load("v3")
    task = pa.StandTask(height=pa.stance.reachable_heights(robot).high - 1e-5)
    stand = pa.solve_stand_as_simulated(robot, task)
    assert set(stand.depths.values()) <= {0.0}
    np.testing.assert_array_equal(stand.qpos, pa.solve_stand(robot, task).qpos)
    with pytest.raises(pa.StanceUnreachableError):
        solve_stand_on_soft_ground(robot, task, explain=False)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "what"), [("long-leg", "off the centre"), ("v3", "off the centre"), ("v3", "slope")]
)
def test_rigid_stand_does_not_hold_its_loads_on_soft_ground(name: str, what: str) -> None:
    """The failure proposes the stand on soft ground, which the test above confirms."""
    run = pa.verify_stand(load(name), pa.solve_stand(load(name), TASKS[what]))
    assert not run.passed
    assert "solve_stand_as_simulated" in str(run.failures[-1])


def test_relaxed_steps_converge_if_the_plain_steps_alternate() -> None:
    """Closed form: x' = b - s x with s > 1 diverges; the factor 1 / (1 + s) solves it at once."""
    slope, offset = 2.3, np.array([1.0, -0.5])
    place, factor, before = np.zeros(2), 1.0, offset
    for _ in range(2):
        place = place + factor * (offset - (1 + slope) * place)
        residual = offset - (1 + slope) * place
        factor, before = _update_relaxation(factor, before, residual), residual
    assert factor == pytest.approx(1 / (1 + slope))
    assert place == pytest.approx(offset / (1 + slope))
    assert _update_relaxation(0.5, before, before) == 0.5  # no change: no information


@pytest.mark.slow
def test_soles_on_springs_settle_in_the_equilibrium_of_a_simulation(tmp_path: Path) -> None:
    """Reference: MuJoCo's simulation. The plain iteration alternates between edges of the soles."""
    drawn = random_legged.draw_robot(720024)
    drawn = replace(drawn, base="free", keyframe=True, floor=True, motors="position")
    pair = random_legged.write_robot(drawn, tmp_path)
    robot = pa.load_robot(pair.urdf, pair.mjcf)
    assert robot.description.passive_joints
    loaded = pa.robot.with_payload(robot, robot.total_mass, (0.032, -0.002, -0.027))
    run = pa.verify_stand(loaded, solve_stand_on_soft_ground(loaded))
    assert run.passed, run.failures
    assert run.torque_error < 1e-4
    assert run.force_error is not None
    assert run.force_error < 1e-4


@pytest.mark.parametrize("name", ["original", "v3"])
def test_foot_depths_follow_from_their_loads(name: str) -> None:
    """References: the ground law at the load of each foot, and Pinocchio's foot positions."""
    robot, task = load(name), TASKS["slope"]
    rigid, stand = pa.solve_stand(robot, task), solve_stand_on_soft_ground(robot, task)
    assert stand.task == rigid.task
    np.testing.assert_allclose(stand.qpos[:7], rigid.qpos[:7], atol=1e-3)
    forces = stand_statics(
        robot, stand, distribution=pa.statics.ForceDistribution.MIN_TANGENTIAL
    ).contact_forces
    feet = pa.Configuration(robot, stand.qpos).foot_positions()
    for foot, depth in stand.depths.items():
        law, normal = GroundLaw.of_contact(robot, foot), stand.normals[foot]
        assert law.force(depth) == pytest.approx(float(forces[foot] @ normal), rel=1e-5)
        drop = rigid.foot_targets[foot] - feet[foot]
        np.testing.assert_allclose(drop, depth * normal, atol=1e-9)
        assert 1e-4 < depth < 8e-3


def test_contact_without_stiffness_is_refused(tmp_path: Path) -> None:
    """Reference: MuJoCo, in whose simulation the feet sink by more than their radius."""
    pair = slips.standing(tmp_path)
    rewrite_file(pair.mjcf, ('<geom type="sphere"', '<geom solref="0 0" type="sphere"'))
    model = mujoco.MjModel.from_xml_path(str(pair.mjcf))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_step(model, data, 1000)
    balls = model.geom_type == mujoco.mjtGeom.mjGEOM_SPHERE
    assert (data.geom_xpos[balls, 2] < 0).all()

    robot = pa.load_robot(urdf=pair.urdf, mjcf=pair.mjcf)
    with pytest.raises(pa.NotSettlingError) as refusal:
        solve_stand_on_soft_ground(robot)
    problem = refusal.value.diagnostic.values["problem"]
    assert problem.code == "ground-without-force"
    assert sorted(problem.values["feet"]) == sorted(robot.contact_points)
