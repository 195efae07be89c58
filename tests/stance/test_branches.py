"""IK branches of legs, compared with SciPy's least squares from random initial guesses and with
MuJoCo's kinematics.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from scipy import optimize

import pupper_analysis as pa
from pupper_analysis.robot.build import build_robot
from pupper_analysis.stance.branches import (
    Branch,
    IndependentLimb,
    combine_branches,
    find_branches,
    find_limbs,
    follow_branches,
)
from tests.support.arm import arm
from tests.support.engines import evaluate_mujoco
from tests.support.variants import load

QPOS = {
    name: np.array([0.0, 0.0, height, 1.0, 0.05, -0.1, 0.1, *np.zeros(12)])
    for name, height in (("v3", 0.13), ("original", 0.16))
}


def draw_foot_targets(name: str, seed: int) -> tuple[pa.Robot, np.ndarray, dict[str, np.ndarray]]:
    """Return foot positions at random joint positions, so that all feet are in reach."""
    robot = load(name)
    qpos = QPOS[name].copy()
    qpos[3:7] /= np.linalg.norm(qpos[3:7])
    bent = qpos.copy()
    random = np.random.default_rng(seed)
    bent[7:] = random.uniform(robot.lower_limits, robot.upper_limits)
    return robot, qpos, pa.Configuration(robot, bent).foot_positions()


def mujoco_foot_positions(robot: pa.Robot, qpos: np.ndarray) -> dict[str, np.ndarray]:
    """Return the contact point of each foot [m] in the world frame, by MuJoCo's kinematics."""
    data = evaluate_mujoco(robot, qpos)
    mujoco.mj_kinematics(robot.mj_model, data)
    return {
        foot: data.xpos[body] + data.xmat[body].reshape(3, 3) @ place
        for foot, (body, place) in robot.contact_places.items()
    }


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("name", ["v3", "original"])
def test_ik_branches_reach_their_targets_and_are_complete(name: str, seed: int) -> None:
    """References: MuJoCo's kinematics, and SciPy's least squares from random starts."""
    robot, qpos, targets = draw_foot_targets(name, seed)
    found = find_branches(robot, qpos, targets, robot.lower_limits, robot.upper_limits)
    others = 0
    for limb, branches in found.items():
        (foot,) = limb.feet
        reached = [way for way in branches if way.foot_error < 1e-5]
        assert reached, "it is in reach"
        for way in branches:
            bent = qpos.copy()
            bent[7 + limb.joints] = way.positions
            miss = np.linalg.norm(mujoco_foot_positions(robot, bent)[foot] - targets[foot])
            assert miss == pytest.approx(way.foot_error, abs=1e-9)
        low, high = robot.lower_limits[limb.joints], robot.upper_limits[limb.joints]
        random = np.random.default_rng(100 + seed)
        for _ in range(6):

            def off(joints: np.ndarray, limb: object = limb, foot: str = foot) -> np.ndarray:
                bent = qpos.copy()
                bent[7 + limb.joints] = joints  # type: ignore[attr-defined]
                return np.asarray(mujoco_foot_positions(robot, bent)[foot] - targets[foot])

            other = optimize.least_squares(off, random.uniform(low, high), bounds=(low, high))
            if np.abs(other.fun).max() < 1e-8:
                others += 1
                assert min(np.abs(way.positions - other.x).max() for way in reached) < 0.05
    assert others, "no start led to a way to bend a leg"


def test_whole_turns_are_not_separate_ik_branches() -> None:
    """A leg with unlimited joints has two branches each of knee and hip, and no more."""
    bounded = load("original")
    urdf = bounded.description.urdf.replace('type="revolute"', 'type="continuous"')
    robot = build_robot(replace(bounded.description, urdf=urdf))
    assert np.isinf(robot.upper_limits).all()
    qpos = QPOS["original"].copy()
    qpos[3:7] /= np.linalg.norm(qpos[3:7])
    bent = qpos.copy()
    bent[7:] = np.tile([0.2, 0.7, -1.4], 4)
    targets = pa.Configuration(robot, bent).foot_positions()
    found = find_branches(robot, qpos, targets, robot.lower_limits, robot.upper_limits)
    for limb, branches in found.items():
        reached = [way.positions for way in branches if way.foot_error < 1e-5]
        assert len(reached) == 4
        assert all((np.abs(positions) <= np.pi).all() for positions in reached)
        assert min(np.abs(positions - bent[7 + limb.joints]).max() for positions in reached) < 1e-3
        for first, second in itertools.combinations(reached, 2):
            assert np.abs(np.exp(1j * first) - np.exp(1j * second)).max() > 0.05


BESIDE_A_STEP = pa.StandTask(
    height=0.1080530850699608,
    roll=0.2369110561876388,
    foot_offsets={"RL": (0.016726622926013145, -0.0031684613124968973)},
    swing={"RR": 0.011109525082513838},
    ground=pa.Ground(0.22402126126057564, -1.5789089193633834, {"FR": 0.0151867, "RL": 0.0079027}),
    com="inside",
    com_margin=0.018870068691670343,
)
ON_A_STEEP_SLOPE = pa.StandTask(
    height=0.12886978562632848,
    pitch=0.9830113688699735,
    yaw=-0.1852603102694485,
    foot_offsets={"RL": (-0.008297196379652478, 0.004187460646046973)},
    swing={"RR": 0.008706375168235695},
    ground=pa.Ground(1.0320377889349654, math.pi),
    com="inside",
)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("task", "angle", "values"),
    [
        (BESIDE_A_STEP, "roll", (0.17, 0.1771509, 0.178, 0.1785, 0.18)),
        (ON_A_STEEP_SLOPE, "yaw", (-0.175, -0.1797689, -0.1841322, -0.185, -0.1852)),
    ],
)
def test_stand_uses_another_branch_if_a_thigh_would_be_in_the_ground(
    task: pa.StandTask, angle: str, values: tuple[float, ...]
) -> None:
    """Angles at which only another IK branch, with the CoM displaced by centimetres, has ground
    clearance."""
    robot = load("v3")
    for value in values:  # some of them were found before, and those between them refused
        stand = pa.solve_stand(robot, replace(task, **{angle: value}), explain=False)
        assert stand.ground_clearance is not None
        assert stand.ground_clearance.distance > -1e-6


def test_best_combinations_of_many_limbs_need_little_memory() -> None:
    """Reference: the sums of costs of all combinations with at most one limb off its best branch.

    12 limbs with 6 branches have 2e9 combinations, whose costs need 16 GB.
    """
    limbs = [IndependentLimb((f"foot{number}",), np.array([number])) for number in range(12)]
    random = np.random.default_rng(0)
    positions = {limb: 1.0 + np.cumsum(random.uniform(0.01, 1, 6)) for limb in limbs}
    found = {
        limb: tuple(Branch(np.array([place]), 0.0) for place in places)
        for limb, places in positions.items()
    }
    combinations = list(itertools.islice(combine_branches(found, np.zeros(12)), 3))
    np.testing.assert_array_equal(combinations[0], [places[0] for places in positions.values()])
    steps = sorted(
        (places[1] - places[0], number) for number, places in enumerate(positions.values())
    )
    for combination, (step, number) in zip(combinations[1:], steps, strict=False):
        changed = combination - combinations[0]
        assert np.flatnonzero(changed).tolist() == [number]
        assert changed[number] == pytest.approx(step)


@pytest.mark.parametrize("name", ["v3", "original"])
def test_each_leg_is_a_limb(name: str) -> None:
    robot = load(name)
    found = find_limbs(robot)
    assert [limb.feet for limb in found] == [(foot,) for foot in robot.contact_points]
    assert sorted(np.concatenate([limb.joints for limb in found])) == list(range(12))


def test_combinations_start_with_reachable_and_near_branches() -> None:
    """By hand: a branch with a foot error is after all branches without; near ones are first."""
    first, second, *others = find_limbs(load("v3"))
    found = {
        first: (Branch(np.full(3, 1.0), 0.0), Branch(np.full(3, 0.1), 0.0)),
        second: (Branch(np.full(3, 0.2), 0.0), Branch(np.full(3, 0.0), 0.01)),
        **{limb: (Branch(np.zeros(3), 0.0),) for limb in others},
    }
    chosen = list(combine_branches(found, np.zeros(12)))
    pairs = [(row[first.joints[0]], row[second.joints[0]]) for row in chosen]
    assert pairs == [(0.1, 0.2), (1.0, 0.2), (0.1, 0.0), (1.0, 0.0)]
    assert len({row.tobytes() for row in chosen}) == 4


@pytest.mark.parametrize("name", ["original", "long-leg"])
@pytest.mark.parametrize("up", [0.02, 0.05, 0.08])
def test_straight_legs_bend_all_in_one_direction(name: str, up: float) -> None:
    """Both directions are equally near; rounding must not select one for each leg."""
    robot = load(name)
    straight = np.zeros(robot.nu)
    qpos = robot.make_qpos(straight)
    feet = pa.Configuration(robot, qpos).foot_positions()
    raised = {foot: place + np.array((0.0, 0.0, up)) for foot, place in feet.items()}
    ends = np.full(robot.nu, -3.0), np.full(robot.nu, 3.0)
    found = find_branches(robot, qpos, raised, *ends)
    knees = next(iter(combine_branches(found, straight)))[2::3]
    assert abs(knees[0]) > 0.5
    assert knees == pytest.approx(np.full(4, knees[0]), abs=1e-6)


def test_robot_without_feet_has_no_branches() -> None:
    robot = arm()
    limits, moves = (robot.lower_limits, robot.upper_limits), np.zeros((2, 3))
    found = find_branches(robot, robot.home, {}, *limits)
    assert found == follow_branches(robot, robot.home, {}, *limits, found, moves) == {}


def test_foot_on_the_base_has_a_single_branch() -> None:
    """No joint moves the foot; the empty joint positions of two guesses raised a ValueError."""
    description = load("v3").description
    mjcf = description.mjcf.copy()
    mjcf.body("base_link").add_geom(name="belly", size=[0.01, 0, 0], pos=[0, 0, -0.05])
    joint = (
        '<link name="belly"/><joint name="belly_joint" type="fixed"><parent link="base_link"/>'
        '<child link="belly"/><origin xyz="0 0 -0.05"/></joint></robot>'
    )
    points = {**description.contact_points, "belly": ("belly", "belly")}
    robot = build_robot(
        replace(
            description,
            mjcf=mjcf,
            urdf=description.urdf.replace("</robot>", joint),
            contact_points=points,
            foot_geoms={"belly": ("belly", 0.01)},
        )
    )
    qpos = robot.make_qpos(robot.nominal)
    targets = pa.Configuration(robot, qpos).foot_positions()
    found = find_branches(robot, qpos, targets, robot.lower_limits, robot.upper_limits)
    (branch,) = next(found[limb] for limb in found if limb.feet == ("belly",))
    assert branch.positions.size == 0
    assert branch.foot_error < 1e-12
    assert all(found[limb][0].foot_error < 1e-5 for limb in found)
