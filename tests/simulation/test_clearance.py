"""Lower bounds of the distance to the ground, compared with MuJoCo's collision detection in
falls.
"""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from pupper_analysis.simulation import monitor
from pupper_analysis.simulation.clearance import ClearanceBounds
from pupper_analysis.simulation.rollout import make_stand_start, simulate_commands
from tests.support.variants import load, stand_of


@pytest.mark.parametrize("name", ["v3", "v3-heavy"])
def test_no_contact_occurs_within_the_bound_during_a_fall(name: str) -> None:
    """Reference: all contacts of all states, from MuJoCo's collision detection."""
    held = make_stand_start(load(name), stand_of(name))
    model, start = held.drive.model, held.start.copy()
    start[1 + model.nq : 1 + model.nq + 2] = 1.0, 0.7
    start[1 + model.nq + 4] = 3.0
    states = simulate_commands(model, start, np.tile(held.ctrl, (400, 1)))[::4]
    clearance, sampler = (
        ClearanceBounds(held.robot, model),
        monitor.ContactSampler(held.robot, model),
    )
    assert clearance.is_available
    touches = np.array([bool(sampler.find_ground_bodies(state)) for state in states])
    distances = np.array([clearance.distance(state) for state in states])
    assert touches.any()
    assert (distances > 0).sum() > 20
    assert not distances[touches].any()
    for state, distance in zip(states, distances, strict=True):
        moved = clearance.displacements(states, state)
        assert (moved[touches] >= distance).all()


def test_displacement_bound_exceeds_the_motion_of_all_geoms() -> None:
    """Reference: forward kinematics of MuJoCo at 200 random pairs of configurations."""
    robot = load("v3")
    model, random = robot.mj_model, np.random.default_rng(0)
    clearance, data = ClearanceBounds(robot, model), mujoco.MjData(model)

    def draw() -> tuple[np.ndarray, np.ndarray]:
        qpos = np.append(random.normal(size=7), random.uniform(-1, 1, model.nq - 7))
        qpos[3:7] /= np.linalg.norm(qpos[3:7])
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        state = np.concatenate([[0.0], qpos, np.zeros(model.nv)])
        corners = data.geom_xpos[model.geom_bodyid > 0]
        return state, corners.copy()

    for _ in range(200):
        (first, before), (second, after) = draw(), draw()
        bound = float(clearance.displacements(second[None], first)[0])
        assert np.linalg.norm(after - before, axis=1).max() <= bound
