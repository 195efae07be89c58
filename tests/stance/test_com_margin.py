"""CoM margin of stands whose base has an offset: MuJoCo's CoM and SciPy's convex hull are the
references.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import ConvexHull

import pupper_analysis as pa
from pupper_analysis.stance.problem import compute_targets
from pupper_analysis.stance.search import minimise_foot_errors, search_stand
from pupper_analysis.stance.soft_ground import solve_loaded_stand
from pupper_analysis.stance.solver import SearchContext
from tests.support.engines import evaluate_mujoco
from tests.support.variants import NAMES, load


def margin_of(robot: pa.Robot, stand: pa.Stand) -> float:
    """Return the CoM margin [m] by MuJoCo's CoM and SciPy's convex hull, whose sides (a, b, c) are
    negative inside.
    """
    com = evaluate_mujoco(robot, stand.qpos).body(robot.mj_base).subtree_com
    sides = ConvexHull([point[:2] for point in stand.contact_points.values()]).equations
    return -float((sides @ [*com[:2], 1.0]).max())


def get_refusal(robot: pa.Robot, task: pa.StandTask) -> pa.StanceUnreachableError:
    with pytest.raises(pa.StanceUnreachableError) as caught:
        pa.solve_stand(robot, task)
    return caught.value


def test_refusal_of_a_com_margin_states_its_limit() -> None:
    """References: stands at the stated limits are solved, and 2 % beyond are refused."""
    robot = load("v3")
    task = pa.StandTask(offset=(0.05, 0.0), com_margin=0.04)
    error = get_refusal(robot, task)
    assert error.shortfall == {}
    assert [str(obstacle) for obstacle in error.blocked] == [
        "the CoM is 31.3 mm inside the support polygon"
    ]
    assert "CoM in the support polygon (margin >= 40 mm)" in str(error)
    assert set(error.limits) == {"offset", "com_margin"}
    for name, limit in error.limits.items():
        assert pa.solve_stand(robot, replace(task, **limit)).solved, name
    least = error.limits["com_margin"]["com_margin"]
    assert "com_margin 31.2 mm" in str(error)
    with pytest.raises(pa.StanceUnreachableError):
        pa.solve_stand(robot, replace(task, com_margin=1.02 * least), explain=False)
    x, y = error.limits["offset"]["offset"]
    with pytest.raises(pa.StanceUnreachableError):
        pa.solve_stand(robot, replace(task, offset=(1.02 * x, y)), explain=False)
    assert margin_of(robot, error.nearest) >= error.nearest.task.com_margin - 1e-9


def test_com_without_required_margin_may_be_outside_of_the_feet() -> None:
    """The stand is solved; its statics are infeasible."""
    robot = load("v3")
    stand = pa.solve_stand(robot, pa.StandTask(offset=(0.11, 0.0), height=0.12))
    assert stand.com_margin < 0
    with pytest.raises(pa.StaticsInfeasibleError):
        pa.stance.stand_statics(robot, stand)


def test_foot_error_out_of_reach_grows_with_the_com_margin() -> None:
    """Three legs at a height that they do not reach; the margin of the nearest configuration is
    that of MuJoCo's CoM and SciPy's convex hull."""
    robot, errors = load("v3"), []
    for margin in (0.0, 0.02, 0.025):
        task = pa.StandTask(com="inside", com_margin=margin, height=0.22, swing={"FR": 0.02})
        targets, context = compute_targets(robot, task, {}), SearchContext(robot)
        nearest = minimise_foot_errors(context, targets, search_stand(context, targets).qpos)
        com = evaluate_mujoco(robot, nearest.qpos).body(robot.mj_base).subtree_com
        sides = ConvexHull(targets.contacts[:, :2]).equations
        assert -float((sides @ [*com[:2], 1.0]).max()) >= margin - 1e-7
        errors.append(nearest.foot_error)
    assert errors[0] <= errors[1] < errors[2]


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_required_com_margin_is_met_up_to_the_margin_of_the_stand(name: str) -> None:
    """References: MuJoCo's CoM and SciPy's convex hull, 10 nm below and above the margin."""
    robot = load(name)
    task = pa.StandTask(offset=(0.03, -0.01), yaw=0.1)
    free = pa.solve_stand(robot, task)
    margin = margin_of(robot, free)
    assert free.com_margin == pytest.approx(margin, abs=1e-9)
    held = pa.solve_stand(robot, replace(task, com_margin=margin - 1e-8))
    np.testing.assert_allclose(held.qpos, free.qpos, atol=1e-9)
    with pytest.raises(pa.StanceUnreachableError):
        pa.solve_stand(robot, replace(task, com_margin=margin + 1e-8), explain=False)


@pytest.mark.slow
def test_refusal_of_a_com_outside_of_the_feet_limits_the_offset_alone() -> None:
    """No margin of at least zero is met: the refusal states no limit of the CoM margin."""
    task = pa.StandTask(offset=(0.11, 0.0), com_margin=0.01, height=0.12)
    error = get_refusal(load("v3"), task)
    assert [str(obstacle) for obstacle in error.blocked] == [
        "the CoM is 25.9 mm outside the support polygon"
    ]
    assert set(error.limits) == {"offset"}


def test_required_com_margin_is_met_in_another_ik_branch() -> None:
    """A front leg of v3 in another branch moves the CoM by millimetres; the reference is MuJoCo's
    CoM.
    """
    robot = load("v3")
    task = pa.StandTask(height=0.15, yaw=-0.48, offset=(-0.017, 0.0))
    usual = pa.solve_stand(robot, task)
    requested = replace(task, com_margin=usual.com_margin + 2e-3)
    other = pa.solve_stand(robot, requested)
    assert margin_of(robot, other) >= requested.com_margin - 1e-9
    assert np.abs(other.qpos[7:] - usual.qpos[7:]).max() > 0.5


def test_required_com_margin_is_met_on_soft_ground_and_with_a_payload() -> None:
    """Penetrations shift the CoM, and a payload shifts it more; the reference is MuJoCo's CoM.

    The margin is required of the loaded robot: 1 kg 50 mm in front reduces it too far.
    """
    robot = load("original")
    task = pa.StandTask(offset=(0.03, 0.0), com_margin=0.03)
    soft = pa.stance.solve_stand_on_soft_ground(robot, task)
    assert soft.task.com_margin == 0.03
    assert margin_of(robot, soft) >= 0.03 - 1e-9
    edge = replace(task, com_margin=pa.solve_stand(robot, task).com_margin)
    loaded, stand = solve_loaded_stand(robot, task, 0.1, (0.05, 0.0, 0.0))
    assert 0.03 < margin_of(loaded, stand) < edge.com_margin
    with pytest.raises(pa.StanceUnreachableError):
        solve_loaded_stand(robot, edge, 1.0, (0.05, 0.0, 0.0))
