"""Solved stands satisfy their tasks in both engines; refused stands are out of reach of SciPy's
search as well.
"""

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import pupper_analysis as pa
from tests.support.engines import evaluate_mujoco
from tests.support.legged import quadruped
from tests.support.variants import NAMES, SKELETON_NAMES, load, stand_of

V3_NAMES = tuple(name for name in NAMES if name not in SKELETON_NAMES)


HEIGHTS = {
    "original": 0.158,
    "long-leg": 0.228,
    "heavy": 0.158,
    "v3": 0.13151,
    "v3-long-leg": 0.18729,
    "v3-heavy": 0.13151,
}
"""{variant: height of its nominal stand [m]}."""


def check(robot: pa.Robot, stand: pa.Stand, task: pa.StandTask) -> None:
    """Assert that a stand satisfies its task, by MuJoCo's kinematics and by Pinocchio's."""
    rotation = Rotation.from_euler("ZYX", [task.yaw, task.pitch, task.roll]).as_matrix()
    mj, config = evaluate_mujoco(robot, stand.qpos), pa.Configuration(robot, stand.qpos)
    start = evaluate_mujoco(robot, robot.neutral())
    base = mj.body(robot.mj_base)
    np.testing.assert_allclose(base.xmat.reshape(3, 3), rotation, atol=1e-9)
    assert base.xpos[2] == pytest.approx(task.height, abs=1e-9)
    for foot, frame in robot.contact_frames.items():
        target = [*start.site(frame).xpos[:2], robot.contact_radius[foot]]
        np.testing.assert_allclose(stand.foot_targets[foot], target, atol=1e-12)
        np.testing.assert_allclose(mj.site(frame).xpos, target, atol=1e-9)
        np.testing.assert_allclose(config.foot_positions()[foot], target, atol=1e-9)
    centre = np.mean([target[:2] for target in stand.foot_targets.values()], axis=0)
    np.testing.assert_allclose(base.subtree_com[:2], centre, atol=1e-9)
    np.testing.assert_allclose(config.center_of_mass()[:2], centre, atol=1e-9)
    joints = stand.joint_positions(robot)
    assert (joints >= robot.lower_limits - 1e-9).all()
    assert (joints <= robot.upper_limits + 1e-9).all()
    for error in ("foot_error", "orientation_error", "height_error", "com_error"):
        assert 0 <= getattr(stand, error) < 1e-9


def test_skeletons_stand_by_hand() -> None:
    """Closed form: the law of cosines, with hips 0.14 m above the feet and the CoM above their
    centre.
    """
    robot, stand = load("original"), stand_of("original")
    angles = stand.joint_positions(robot).reshape(4, 3)
    forward = stand.qpos[0]  # horizontal distance of each hip from its foot
    leg = math.hypot(0.14, forward)
    knee = math.acos((0.08**2 + 0.11**2 - leg**2) / (2 * 0.08 * 0.11))
    np.testing.assert_allclose(angles[:, 2], knee - math.pi, atol=1e-9)
    at_hip = math.acos((0.08**2 + leg**2 - 0.11**2) / (2 * 0.08 * leg))
    np.testing.assert_allclose(angles[:, 1], at_hip + math.atan2(forward, 0.14), atol=1e-9)
    np.testing.assert_allclose(angles[:, 0], 0, atol=1e-9)


tasks = st.builds(
    pa.StandTask,
    height=st.floats(0.06, 0.34),
    roll=st.floats(-0.35, 0.35),
    pitch=st.floats(-0.35, 0.35),
    yaw=st.floats(-0.4, 0.4),
)


def search_smallest_error(
    robot: pa.Robot, task: pa.StandTask, targets: dict[str, np.ndarray], tries: int
) -> float:
    """Return the smallest largest distance [m] between feet and targets that an independent search
    finds, with the pose of the base and the horizontal CoM as requested: bounded least squares on
    the joints and the base position, from random starts, on Pinocchio's kinematics.
    """
    random = np.random.default_rng(0)
    lower, upper = robot.lower_limits, robot.upper_limits
    centre = np.mean([target[:2] for target in targets.values()], axis=0)
    turn = Rotation.from_euler("ZYX", [task.yaw, task.pitch, task.roll])
    quat = turn.as_quat(scalar_first=True)

    def misses(x: np.ndarray) -> np.ndarray:
        config = pa.Configuration(robot, [*x[:2], task.height, *quat, *x[2:]])
        feet = config.foot_positions()
        gaps = [feet[foot] - target for foot, target in targets.items()]
        return np.concatenate([*gaps, config.center_of_mass()[:2] - centre])

    def jacobian(x: np.ndarray) -> np.ndarray:
        config = pa.Configuration(robot, [*x[:2], task.height, *quat, *x[2:]])
        columns = [0, 1, *range(6, 18)]
        rows = [*config.foot_jacobians().values(), config.com_jacobian()[:2]]
        return np.vstack([row[:, columns] for row in rows])

    best = math.inf
    for _ in range(tries):
        start = np.concatenate([centre, random.uniform(lower, upper)])
        bounds = (np.r_[centre - 0.5, lower], np.r_[centre + 0.5, upper])
        found = least_squares(misses, start, jacobian, bounds=bounds, xtol=1e-12, max_nfev=150)
        best = min(best, float(np.abs(found.fun).max()))
        if best < 1e-7:
            break
    return best


@pytest.mark.slow
@settings(max_examples=50)
@given(name=st.sampled_from(NAMES), task=tasks)
def test_any_stand_is_solved_or_out_of_reach(name: str, task: pa.StandTask) -> None:
    """References: kinematics of both engines for a solved stand; for a refused stand, six searches
    by an independent method end more than 0.1 um from the targets.
    """
    robot = load(name)
    try:
        stand = pa.solve_stand(robot, task, explain=False)
    except pa.StanceUnreachableError as error:
        refusal = error
    else:
        check(robot, stand, task)
        return
    if refusal.blocked:  # the feet are in place, but another part is in the ground
        assert not refusal.shortfall
        assert all(obstacle.code == "part-in-ground" for obstacle in refusal.blocked)
        return
    assert refusal.shortfall
    assert all(1e-9 <= gap < 1 for gap in refusal.shortfall.values())
    assert set(refusal.shortfall) <= set(robot.contact_points)
    assert set(refusal.at_limit) <= set(robot.joint_names)
    assert search_smallest_error(robot, task, stand_of(name).foot_targets, tries=6) > 1e-7


@pytest.mark.parametrize("other", ["original", "v3-heavy"])
def test_stand_of_another_robot_is_refused(other: str) -> None:
    """Seven functions, with a robot that has as many joints, or even equal legs."""
    stand, robot = stand_of("v3"), load(other)
    for use in (
        pa.stance.stand_statics,
        pa.payload_limit,
        pa.verify_stand,
        pa.simulation.sweep_gains,
        pa.steady_state,
        pa.stance.minimum_stiffness,
        pa.push_recovery,
    ):
        with pytest.raises(
            pa.ConfigurationError, match=f"another model .v3.*solve a stand for {other}"
        ):
            use(robot, stand)


@pytest.mark.slow
@pytest.mark.parametrize("height", [0.22, 0.25, 0.5, 1.0, 3.0])
def test_height_beyond_the_legs_is_refused_by_the_missing_length(height: float) -> None:
    """Reference: the skeleton's foot is at most 0.19 m from its hip, and its radius is 0.018 m."""
    with pytest.raises(pa.StanceUnreachableError) as caught:
        pa.solve_stand(load("original"), pa.StandTask(height))
    missing = height - 0.018 - 0.19
    assert min(caught.value.shortfall.values()) >= missing - 1e-9
    # The com is off the hips by 5 mm, so the legs are not quite upright.
    assert max(caught.value.shortfall.values()) < missing + 0.0004
    assert set(caught.value.shortfall) == {"FL", "FR", "RL", "RR"}
    assert "mm" in str(caught.value)
    assert f"height {1000 * height:.1f} mm" in str(caught.value)


@pytest.mark.slow
def test_limit_of_a_telescopic_leg_in_a_refusal_is_in_metres(tmp_path: Path) -> None:
    """The knees are slides, which extend the legs of 0.4 m by at most 0.02 m."""
    slide = r'\1 type="slide" axis="0 0 1" range="-0.02 0.1"'
    text = quadruped(tmp_path, floor=True, actuators="position", keyframe="").mjcf.read_text()
    text = re.sub(r'(name="\w+_knee") axis="0 1 0" range="-2.6 -0.4"', slide, text)
    robot = pa.load_robot(text)
    with pytest.raises(pa.StanceUnreachableError, match=r"FL_knee \(-20\.0 mm\)") as caught:
        pa.solve_stand(robot, pa.StandTask(height=0.6))
    assert caught.value.at_limit["FL_knee"] == -0.02


def test_numpy_numbers_of_a_task_give_the_stand_of_floats() -> None:
    task = pa.StandTask(height=np.float64(0.15), yaw=np.float64(0.1))
    stand = pa.solve_stand(load("original"), task)
    expected = pa.solve_stand(load("original"), pa.StandTask(height=0.15, yaw=0.1))
    np.testing.assert_array_equal(stand.qpos, expected.qpos)
    assert pa.StandTask(height=np.float32(0.15)).height == pytest.approx(0.15, abs=1e-7)


def test_a_stand_solved_twice_is_equal_to_the_last_bit() -> None:
    task = pa.StandTask(0.14, 0.1, -0.1, 0.2)
    first, second = (pa.solve_stand(load("v3-long-leg"), task) for _ in range(2))
    np.testing.assert_array_equal(first.qpos, second.qpos)
    assert first.iterations == second.iterations


def test_default_stand_of_each_variant_is_symmetric(robot: pa.Robot, variant: str) -> None:
    """Left and right joint angles are mirrored for v3, and equal for the skeleton."""
    stand = stand_of(variant)
    assert stand.qpos[1] == pytest.approx(0, abs=1e-9)
    angles = dict(zip(robot.joint_names, stand.joint_positions(robot), strict=True))
    pairs = 0
    for name, angle in angles.items():
        if "_r_" in name:
            assert angles[name.replace("_r_", "_l_")] == pytest.approx(-angle, abs=1e-8)
            pairs += 1
        elif re.match("[FR]R_[HK]FE", name):
            assert angles[f"{name[0]}L{name[2:]}"] == pytest.approx(angle, abs=1e-8)
            pairs += 1
    assert pairs >= 4


def test_stand_of_a_fixed_base_is_refused() -> None:
    with pytest.raises(pa.ConfigurationError, match="fixed base"):
        pa.solve_stand(load("v3", fixed_base=True))


def test_rotation_of_a_task_is_yaw_pitch_roll() -> None:
    """Reference: SciPy's rotation about z, then y, then x of the rotated frame."""
    task = pa.StandTask(roll=0.3, pitch=-0.2, yaw=0.7)
    expected = Rotation.from_euler("ZYX", [0.7, -0.2, 0.3]).as_matrix()
    np.testing.assert_allclose(task.rotation(), expected, atol=1e-15)


@pytest.mark.parametrize(
    ("field", "value"),
    [("height", 0), ("height", -0.1), ("roll", None), ("roll", 3.2), ("pitch", -4), ("yaw", 90)],
)
def test_value_of_a_task_out_of_range_is_refused_by_field(field: str, value: object) -> None:
    with pytest.raises(pa.ConfigurationError, match=field):
        pa.StandTask(**{field: value})  # type: ignore[arg-type]


def test_refusal_names_the_joints_at_their_limits() -> None:
    """Reference: the joint ranges of the robot."""
    robot = load("original")
    with pytest.raises(pa.StanceUnreachableError) as caught:
        pa.solve_stand(robot, pa.StandTask(roll=1.2))
    assert caught.value.at_limit
    for name, limit in caught.value.at_limit.items():
        index = robot.joint_names.index(name)
        assert limit in (robot.lower_limits[index], robot.upper_limits[index])
        assert name in str(caught.value)


@pytest.mark.slow
def test_two_requirements_that_are_each_too_large_are_refused_together() -> None:
    """Roll or pitch alone is out of reach as well; the stated limits of both are solved."""
    robot, task = load("v3"), pa.StandTask(roll=1.2, pitch=-1.2, height=0.14)
    for single in (replace(task, roll=0.0), replace(task, pitch=0.0)):
        with pytest.raises(pa.StanceUnreachableError):
            pa.solve_stand(robot, single, explain=False)
    with pytest.raises(pa.StanceUnreachableError, match=r"ossible .*: roll .* and pitch") as caught:
        pa.solve_stand(robot, task)
    limits = caught.value.limits["roll and pitch"]
    assert list(caught.value.limits) == ["roll and pitch"]
    assert set(limits) == {"roll", "pitch"}
    assert pa.solve_stand(robot, replace(task, **limits)).solved


def test_stand_does_not_depend_on_earlier_stands() -> None:
    """Equal to the last bit in the other order, and for the same robot loaded again."""
    robot = load("v3")
    tasks = [
        pa.StandTask(),
        pa.StandTask(joint_margin=0.1, roll=0.1),
        pa.StandTask(self_clearance=0.005, swing={"RL": 0.01}, com="inside"),
        pa.StandTask(height=0.1, ground=pa.Ground(0.1)),
    ]
    expected = [pa.solve_stand(robot, task).qpos for task in tasks]
    reverse = [pa.solve_stand(robot, task).qpos for task in reversed(tasks)]
    np.testing.assert_array_equal(expected, reverse[::-1])
    other = pa.load_variant("v3")
    np.testing.assert_array_equal(expected, [pa.solve_stand(other, task).qpos for task in tasks])


def test_nominal_stand_of_each_variant_has_its_height(
    variant: str, robot: pa.Robot, stand: pa.Stand
) -> None:
    """References: recorded heights, and the kinematics of both engines."""
    assert stand.task.height == pytest.approx(HEIGHTS[variant], abs=1e-12)
    assert robot.stand_height == pytest.approx(HEIGHTS[variant], abs=1e-12)
    check(robot, stand, pa.StandTask(height=HEIGHTS[variant]))
    assert stand.iterations < 20


@pytest.mark.parametrize(
    ("name", "scale"),
    [("original", 1.05), *((name, scale) for name in V3_NAMES for scale in (0.75, 1.1))],
)
@pytest.mark.parametrize(
    ("roll", "pitch", "yaw"), [(0, 0, 0), (0.1, -0.08, 0.15), (-0.1, 0.08, -0.2)]
)
def test_stands_of_moderate_height_and_tilt_are_reached(
    name: str, scale: float, roll: float, pitch: float, yaw: float
) -> None:
    """Reference: the kinematics of both engines."""
    task = pa.StandTask(scale * HEIGHTS[name], roll, pitch, yaw)
    check(load(name), pa.solve_stand(load(name), task), task)


@pytest.mark.parametrize("field", ["height", "roll", "pitch", "yaw"])
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, "0.1", True, [0.1], 1j])
def test_value_of_a_task_that_is_no_finite_number_is_refused(field: str, value: object) -> None:
    """The error names the field."""
    with pytest.raises(pa.ConfigurationError, match=field) as caught:
        pa.StandTask(**{field: value})  # type: ignore[arg-type]
    assert caught.value.field == field


def test_stand_is_accepted_by_the_same_robot_loaded_again() -> None:
    """Reference: the torques of the robot that the stand was solved for."""
    robot, stand = pa.load_variant("v3"), stand_of("v3")
    assert robot.fingerprint == load("v3").fingerprint
    torques = pa.stance.stand_statics(robot, stand).joint_torques
    assert torques.shape == (12,)
    expected = pa.stance.stand_statics(load("v3"), stand).joint_torques
    np.testing.assert_array_equal(torques, expected)


def test_refusal_names_the_difference_of_two_files(tmp_path: Path) -> None:
    """The MJCF has a thigh 50 mm behind that of the URDF, so that the calf is in the ground.

    Reference: the pair without this displacement, which stands.
    """
    shapes = '<geom size="0.02" pos="0 0 -0.2"/><geom type="box" size=".01 .01 .1" pos="0 0 -.1"/>'
    pair = quadruped(tmp_path, foot=shapes, floor=True, actuators="position")
    text = pair.mjcf.read_text()
    start = text.index('name="FL_thigh"')
    moved = text[start:].replace('pos="0 0.05 0"', 'pos="-0.05 0.05 0"', 1)
    pair.mjcf.write_text(text[:start] + moved)
    robot = pa.load_robot(*pair, visuals=False)
    with pytest.raises(
        pa.StanceUnreachableError,
        match=r"FL_calf penetrates.*The files describe.*FL_pitch: 50 mm apart",
    ) as refused:
        pa.solve_stand(robot)
    assert "another height" not in str(refused.value)
    pair.mjcf.write_text(text)
    pa.solve_stand(pa.load_robot(*pair, visuals=False))
