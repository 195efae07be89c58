"""Whole-body postures against closed forms, SciPy's optimiser, other stands, and MuJoCo."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
from scipy import optimize
from scipy.spatial.transform import Rotation

import pupper_analysis as pa
from pupper_analysis.simulation.verify import mujoco_balance_residual
from pupper_analysis.stance import (
    AxisAlignTask,
    CoMTask,
    JointsTask,
    OrientationTask,
    PositionTask,
    RelativePositionTask,
    SelfClearanceTask,
)
from pupper_analysis.stance.posture_tasks import PostureTask
from tests.support import arm as by_hand
from tests.support.engines import change_model
from tests.support.variants import load, stand_of

ARM_ORDER = ("a_turn", "shoulder", "elbow", "b_slide")
"""Arguments of the arm's closed forms."""


def arm_angles(qpos: np.ndarray) -> np.ndarray:
    """Joint positions in the order of the closed forms."""
    positions = dict(zip(by_hand.ORDER, qpos, strict=True))
    return np.array([positions[name] for name in ARM_ORDER])


def test_arm_reaches_points_that_its_closed_form_confirms() -> None:
    """Reference: closed-form tip position of the arm [m], at ten random points within the joint
    ranges.
    """
    robot, random = by_hand.arm(), np.random.default_rng(0)
    low, high = np.array([by_hand.RANGES[name] for name in ARM_ORDER]).T
    for _ in range(10):
        goal = by_hand.tip_position(*(random.uniform(low, high)))
        posture = pa.solve_posture(robot, [PositionTask("tip", goal)])
        angles = arm_angles(posture.qpos)
        np.testing.assert_allclose(by_hand.tip_position(*angles), goal, atol=1e-6)
        assert (angles >= low - 1e-9).all()
        assert (angles <= high + 1e-9).all()
        assert posture.mujoco_residuals.max() < 1e-6


def test_preferred_joints_select_the_nearest_posture_of_a_redundant_arm() -> None:
    """Reference: SciPy's minimum of the distance, with the closed form of the tip as constraint."""
    robot = by_hand.arm()
    goal = by_hand.tip_position(0.4, -0.9, 1.3, 0.1)
    preferred = {"a_turn": 0.0, "shoulder": -0.7, "elbow": 1.0, "b_slide": 0.05}
    middle = np.array([preferred[name] for name in ARM_ORDER])
    best = optimize.minimize(
        lambda angles: ((angles - middle) ** 2).sum(),
        middle,
        constraints={"type": "eq", "fun": lambda angles: by_hand.tip_position(*angles) - goal},
        bounds=[by_hand.RANGES[name] for name in ARM_ORDER],
        options={"ftol": 1e-14},
    )
    tasks = [PositionTask("tip", goal), JointsTask(preferred, required=False)]
    posture = pa.solve_posture(robot, tasks)
    np.testing.assert_allclose(arm_angles(posture.qpos), best.x, atol=2e-3)
    assert posture.residuals[0] < 1e-9
    assert posture.residuals[1] == pytest.approx(np.abs(best.x - middle).max(), abs=2e-3)


def test_pose_of_the_base_and_feet_gives_the_joints_of_the_stand() -> None:
    """Reference: ``solve_stand``; a leg with three joints has a single posture per IK branch."""
    robot, start = load("v3"), stand_of("v3")
    stand = pa.solve_stand(robot, pa.StandTask(height=0.115, pitch=0.05))
    config = pa.Configuration(robot, stand.qpos)
    tasks: list[PostureTask] = [
        PositionTask(robot.base, stand.qpos[:3]),
        OrientationTask(robot.base, config.base_rotation()),
        *(
            PositionTask(robot.contact_frames[foot], position)
            for foot, position in config.foot_positions().items()
        ),
    ]
    posture = pa.solve_posture(robot, tasks, start=start.qpos, contacts=[])
    np.testing.assert_allclose(posture.qpos, stand.qpos, atol=1e-8)
    assert posture.contacts == ()


def test_com_moves_above_kept_feet_and_statics_apply() -> None:
    """The CoM is at its target and the feet keep their places within 1 nm; the contact forces sum
    to the weight [N].
    """
    robot, qpos = load("v3"), stand_of("v3").qpos
    before = pa.Configuration(robot, qpos)
    goal = before.center_of_mass() + np.array([0.015, -0.01, -0.01])
    posture = pa.solve_posture(robot, [CoMTask(goal)], start=qpos)
    after = pa.Configuration(robot, posture.qpos)
    np.testing.assert_allclose(after.center_of_mass(), goal, atol=1e-9)
    for foot, place in before.foot_positions().items():
        np.testing.assert_allclose(after.foot_positions()[foot], place, atol=1e-9)
    assert posture.mujoco_residuals.max() < 1e-9
    assert posture.tasks == ("CoMTask", *(f"contact {foot}" for foot in robot.contact_points))
    total = sum(pa.gravity_compensation(after).contact_forces.values(), np.zeros(3))
    assert total[2] == pytest.approx(robot.weight)


def test_posture_is_the_start_of_stands_and_postures() -> None:
    """Reference: joint positions of the posture, and the nominal stand [m, rad]."""
    robot, stand = load("v3"), stand_of("v3")
    posture = pa.solve_posture(robot, [CoMTask((0, 0, 0.1))], start=stand)
    again = pa.solve_posture(robot, [CoMTask((0, 0, 0.1))], start=posture)
    np.testing.assert_allclose(again.qpos, posture.qpos, atol=1e-9)
    assert again.stand is not None
    for start in (posture, posture.stand, posture.qpos):
        found = pa.solve_stand(robot, start=start)
        np.testing.assert_allclose(found.qpos, stand.qpos, atol=1e-8)
        assert found.task.ik_seed == tuple(posture.qpos[7:])
    with pytest.raises(pa.ConfigurationError, match="qpos"):
        pa.solve_stand(robot, start=posture.qpos[1:])


def test_axis_points_at_a_point_in_mujoco() -> None:
    """Reference: MuJoCo's rotation matrix and position of the base; an axis aligned with a
    direction is compared with the normalised direction.
    """
    robot, qpos = load("v3"), stand_of("v3").qpos
    point = np.array([0.8, 0.15, 0.05])
    posture = pa.solve_posture(
        robot, [AxisAlignTask("base_link", (2, 0, 0), point=point)], start=qpos
    )
    data = robot.compute_kinematics(posture.qpos)
    body = robot.mj_model.body(robot.mj_base).id
    axis, line = data.xmat[body].reshape(3, 3)[:, 0], point - data.xpos[body]
    assert np.linalg.norm(np.cross(axis, line)) < 1e-6
    assert axis @ line > 0
    tilted = (0.1, 0.0, 1.0)
    up = pa.solve_posture(robot, [AxisAlignTask("base_link", (0, 0, 1), tilted)], start=qpos)
    rotation = pa.Configuration(robot, up.qpos).base_rotation()
    np.testing.assert_allclose(rotation[:, 2], tilted / np.linalg.norm(tilted), atol=1e-6)


def test_relative_position_orientation_and_single_axes_hold_in_mujoco() -> None:
    """Reference: MuJoCo's position [m] and rotation matrix of the base, and its position of the
    foot in the base frame.
    """
    robot, qpos = load("v3"), stand_of("v3").qpos
    frames = robot.contact_frames
    turn = Rotation.from_euler("xyz", [0.05, -0.04, 0.1]).as_matrix()
    tasks: list[PostureTask] = [
        OrientationTask("base_link", turn),
        PositionTask("base_link", (9.0, 9.0, 0.12), axes="z"),
        RelativePositionTask("base_link", frames["FR"], (0.08, -0.1, -0.09)),
    ]
    others = [foot for foot in robot.contact_points if foot != "FR"]
    posture = pa.solve_posture(robot, tasks, start=qpos, contacts=others)
    data, model = robot.compute_kinematics(posture.qpos), robot.mj_model
    base = model.body(robot.mj_base).id
    rotation = data.xmat[base].reshape(3, 3)
    np.testing.assert_allclose(rotation, turn, atol=1e-6)
    assert data.xpos[base][2] == pytest.approx(0.12, abs=1e-6)
    body, place = robot.contact_places["FR"]
    foot = data.xpos[body] + data.xmat[body].reshape(3, 3) @ place
    local = rotation.T @ (foot - data.xpos[base])
    np.testing.assert_allclose(local, [0.08, -0.1, -0.09], atol=1e-6)


def test_posture_on_the_slope_of_a_stand_is_the_stand_of_its_base_pose() -> None:
    """References: `solve_stand` for the same base pose, and MuJoCo's balance of forces [N, N m]."""
    robot = load("v3")
    task = pa.StandTask(ground=pa.Ground(slope=0.15, uphill=0.4), joint_margin=0.05)
    start = pa.solve_stand(robot, task)
    goal = start.qpos[:3] + np.array([0.01, -0.005, -0.008])
    turn = Rotation.from_euler("xyz", [0.03, 0.06, -0.05])
    tasks: list[PostureTask] = [
        PositionTask(robot.base, goal),
        OrientationTask(robot.base, turn.as_matrix()),
    ]
    posture = pa.solve_posture(robot, tasks, start=start)
    stand = posture.stand
    assert stand is not None
    roll, pitch, yaw = turn.as_euler("xyz")
    requested = pa.StandTask(
        height=goal[2] - start.centre(robot)[2],
        roll=roll,
        pitch=pitch,
        yaw=yaw,
        ground=task.ground,
        offset=tuple(goal[:2] - start.centre(robot)[:2]),
    )
    expected = pa.solve_stand(robot, requested)
    np.testing.assert_allclose(stand.qpos, expected.qpos, atol=1e-8)
    np.testing.assert_allclose(pa.solve_stand(robot, stand.task).qpos, stand.qpos, atol=1e-8)
    assert stand.solved
    assert stand.com_margin == pytest.approx(expected.com_margin, abs=1e-8)
    statics = pa.stance.stand_statics(robot, stand)
    assert mujoco_balance_residual(robot, stand, statics) < 1e-6


def test_lifted_foot_of_a_stand_reaches_its_target() -> None:
    """The stance feet keep their places, and the task of the new stand has the height of the foot
    above the step [m]: a stand solved for this task is the posture.
    """
    robot = load("v3")
    task = pa.StandTask(
        swing={"FR": 0.02}, ground=pa.Ground(heights={"FR": 0.01}), com="inside", com_margin=0.01
    )
    start = pa.solve_stand(robot, task)
    frame, place = robot.contact_frames["FR"], start.foot_targets["FR"]
    goal = place + np.array([0.01, 0.01, 0.02])
    posture = pa.solve_posture(robot, [PositionTask(frame, goal)], start=start)
    stand = posture.stand
    assert stand is not None
    assert posture.contacts == start.stance_feet == stand.stance_feet
    np.testing.assert_allclose(stand.foot_targets["FR"], goal, atol=1e-9)
    assert stand.task.swing["FR"] == pytest.approx(0.04, abs=1e-8)
    np.testing.assert_allclose(pa.solve_stand(robot, stand.task).qpos, posture.qpos, atol=1e-8)
    with pytest.raises(pa.ConfigurationError, match=r"FR is 10.0 mm below the ground"):
        pa.solve_posture(robot, [PositionTask(frame, place - np.array([0, 0, 0.03]))], start=start)


def test_weld_and_wall_of_a_stand_stay_in_place() -> None:
    """Reference: pose of the welded foot and position of the foot on the wall before; the weld
    carries the robot in MuJoCo's balance of forces [N, N m].
    """
    robot = load("v3")
    wall = pa.Slope(angle=0.6, uphill=-np.pi / 2, friction=0.8)
    contacts = {"FL": pa.Weld(), "FR": pa.Contact(wall)}
    start = pa.solve_stand(robot, pa.StandTask(contacts=contacts, com="inside"))
    goal = start.qpos[:3] - np.array([0.0, 0.0, 0.01])
    tasks = [PositionTask(robot.base, goal, axes="z")]
    posture = pa.solve_posture(robot, tasks, start=start)
    assert posture.contacts == ("FR", "RR", "RL", "FL")
    assert posture.tasks[-2:] == ("weld FL", "orientation of weld FL")
    before, after = pa.Configuration(robot, start.qpos), pa.Configuration(robot, posture.qpos)
    frame = robot.contact_frames["FL"]
    np.testing.assert_allclose(after.frame_rotation(frame), before.frame_rotation(frame), atol=1e-9)
    for foot, place in before.foot_positions().items():
        np.testing.assert_allclose(after.foot_positions()[foot], place, atol=1e-9)
    assert posture.stand is not None
    assert posture.stand.solved
    statics = pa.stance.stand_statics(robot, posture.stand)
    residual = mujoco_balance_residual(posture.stand.check(robot), posture.stand, statics)
    assert residual < 1e-6


def test_posture_near_a_stand_moves_no_joint_without_need() -> None:
    """Reference: the stand, in which the base is already at its target."""
    robot, stand = load("v3"), stand_of("v3")
    posture = pa.solve_posture(robot, [PositionTask(robot.base, stand.qpos[:3])], start=stand)
    np.testing.assert_allclose(posture.qpos, stand.qpos, atol=1e-9)


@pytest.mark.slow
def test_posture_of_an_arm_is_verified_as_a_stand() -> None:
    """MuJoCo's simulated torques equal Pinocchio's static torques within 1 %."""
    robot = by_hand.arm()
    posture = pa.solve_posture(robot, [PositionTask("tip", by_hand.tip_position(0.4, -0.9, 1, 0))])
    assert posture.stand is not None
    np.testing.assert_array_equal(posture.stand.qpos, posture.qpos)
    verified = pa.verify_stand(robot, posture.stand, kp=500.0, kd=20.0, duration=4.0)
    assert verified.torque_error < 0.01


def test_contacts_beside_a_stand_and_stands_of_other_robots_are_refused() -> None:
    robot, stand = load("v3"), stand_of("v3")
    tasks = [PositionTask("base_link", (0, 0, 0.1))]
    with pytest.raises(pa.ConfigurationError, match="contacts: the start is a stand"):
        pa.solve_posture(robot, tasks, start=stand, contacts=["FR"])
    with pytest.raises(pa.ConfigurationError, match="stand"):
        pa.solve_posture(load("original"), tasks, start=stand)
    assert pa.solve_posture(robot, [PositionTask("base_link", (0, 0, 0.12))]).stand is None


def test_target_out_of_reach_names_task_residual_and_joints_at_limits() -> None:
    """Along a ray from the shoulder, the residual is the distance less the longest reach."""
    robot = by_hand.arm()
    # The elbow bends by 0.2 rad at least, and the slide extends to 0.2 m.
    fore = by_hand.FORE + by_hand.SLIDE + by_hand.RANGES["b_slide"][1]
    reach = np.hypot(by_hand.UPPER + fore * np.cos(0.2), fore * np.sin(0.2))
    with pytest.raises(pa.PostureUnreachableError, match="PositionTask tip") as caught:
        pa.solve_posture(robot, [PositionTask("tip", (2.0, 0.0, 0.5))])
    error = caught.value
    assert error.residual == pytest.approx(2.0 - reach, abs=1e-6)
    assert error.at_limit == error.blocking == {"elbow": 0.2, "b_slide": 0.2}
    assert error.conflicting == ()
    assert "b_slide" in str(error)
    assert "b_slide (0.2 m)" in str(error)
    np.testing.assert_allclose(arm_angles(error.qpos)[2:], 0.2, atol=1e-6)
    with pytest.raises(pa.PostureUnreachableError, match="base_link") as lifted:
        pa.solve_posture(load("v3"), [PositionTask("base_link", (0, 0, 1))])
    assert lifted.value.residuals["contact FR"] < lifted.value.residual


def test_unit_of_an_unreachable_joint_position_is_that_of_the_joint() -> None:
    """A slide with the range up to 0.2 m misses 0.5 m by 0.3 m, a hinge at 0.2 rad by 0.1 rad."""
    robot = by_hand.arm()
    with pytest.raises(pa.PostureUnreachableError) as caught:
        pa.solve_posture(robot, [JointsTask({"a_turn": 0.1, "b_slide": 0.5})])
    assert (caught.value.residual, caught.value.unit) == (pytest.approx(0.3, abs=1e-6), "m")
    with pytest.raises(pa.PostureUnreachableError) as turned:
        pa.solve_posture(robot, [JointsTask({"b_slide": 0.1, "elbow": 0.1})])
    assert (turned.value.residual, turned.value.unit) == (pytest.approx(0.1, abs=1e-6), "rad")
    assert "for degrees" not in str(turned.value)


@pytest.mark.parametrize(
    ("task", "hint"),
    [
        (JointsTask({"leg_front_r_3": -90}), r"deg \(for degrees write math.radians\(-90\)\)"),
        (PositionTask("base_link", (0, 0, 120)), r"by 120 m \(lengths are in m\)"),
    ],
    ids=["degrees", "millimetres"],
)
def test_error_of_a_target_in_another_unit_names_the_unit(
    task: pa.stance.PostureTask, hint: str
) -> None:
    """-90 deg is within the range of the knee, and 120 m is 500 sizes of the robot."""
    with pytest.raises(pa.PostureUnreachableError, match=hint):
        pa.solve_posture(load("v3"), [task], start=stand_of("v3"))


def test_self_clearance_keeps_links_apart_that_touch_without_the_task() -> None:
    """MuJoCo measures the distance of the two feet, with the radii of their spheres."""
    robot, start = load("v3"), stand_of("v3").qpos
    front, back = (robot.contact_frames[foot] for foot in ("FR", "RR"))
    goal = pa.Configuration(robot, start).frame_position(back) + np.array([0.035, 0.0, 0.0])
    tasks = [
        PositionTask(front, goal, axes="xz"),
        JointsTask(dict(zip(robot.joint_names, start[7:], strict=True)), required=False),
    ]
    others = [foot for foot in robot.feet if foot != "FR"]

    def solve(*more: PostureTask) -> tuple[pa.stance.SolvedPosture, float]:
        posture = pa.solve_posture(robot, [*tasks, *more], start=start, contacts=others)
        at = pa.Configuration(robot, posture.qpos)
        gap = np.linalg.norm(at.frame_position(front) - at.frame_position(back))
        return posture, float(gap) - robot.contact_radius["FR"] - robot.contact_radius["RR"]

    assert solve()[1] < 0.002
    posture, gap = solve(SelfClearanceTask(0.01))
    assert 0.01 - 1e-6 <= gap < 0.0101
    assert posture.residuals[0] < 1e-9
    clearance = posture.tasks.index("SelfClearanceTask")
    assert posture.mujoco_residuals[clearance] < 1e-6


@pytest.mark.slow
def test_target_inside_the_robot_is_refused_with_a_self_clearance() -> None:
    """The front foot shall be 30 mm from the hind foot; the error names the position task, and the
    clearance that opposes it at the joints of the leg.
    """
    robot, start = load("v3"), stand_of("v3").qpos
    front, back = (robot.contact_frames[foot] for foot in ("FR", "RR"))
    goal = pa.Configuration(robot, start).frame_position(back) + np.array([0.03, 0.0, 0.0])
    others = [foot for foot in robot.feet if foot != "FR"]
    with pytest.raises(pa.PostureUnreachableError, match=f"PositionTask {front}") as caught:
        pa.solve_posture(
            robot, [PositionTask(front, goal), SelfClearanceTask()], start=start, contacts=others
        )
    assert "SelfClearanceTask" in caught.value.conflicting


def test_joints_of_a_continuous_and_a_sliding_joint_are_reached(tiny: pa.Robot) -> None:
    """A continuous and a sliding joint are at their targets within 1e-6 rad or m; a self-clearance
    is refused for continuous joints.
    """
    goal = dict(zip(tiny.joint_names, np.linspace(0.1, 0.3, tiny.nu), strict=True))
    posture = pa.solve_posture(tiny, [JointsTask(goal)], contacts=[])
    np.testing.assert_allclose(posture.qpos[-tiny.nu :], list(goal.values()), atol=1e-6)
    assert posture.residuals.max() < 1e-6
    with pytest.raises(pa.ConfigurationError, match="these joints are continuous"):
        pa.solve_posture(tiny, [JointsTask(goal), SelfClearanceTask()], contacts=[])


def test_invalid_tasks_are_refused() -> None:
    robot = load("v3")
    with pytest.raises(pa.ConfigurationError, match="at least one task"):
        pa.solve_posture(robot, [])
    with pytest.raises(pa.UnknownNameError, match="base_link"):
        pa.solve_posture(robot, [PositionTask("tail", (0, 0, 0))])
    with pytest.raises(pa.UnknownNameError, match="leg_front_r_1"):
        pa.solve_posture(robot, [JointsTask({"tail": 0.0})])
    with pytest.raises(pa.UnknownNameError):
        pa.solve_posture(robot, [PositionTask("base_link", (0, 0, 0.1))], contacts=["tail"])
    with pytest.raises(pa.ConfigurationError, match="rotation matrix"):
        OrientationTask("base_link", 2 * np.eye(3))
    with pytest.raises(pa.ConfigurationError, match="three finite numbers"):
        PositionTask("base_link", (0, 0))
    with pytest.raises(pa.ConfigurationError, match="both are given"):
        AxisAlignTask("base_link", (1, 0, 0), (1, 0, 0), (1, 0, 0))
    with pytest.raises(pa.ConfigurationError, match="xz"):
        CoMTask((0, 0, 0), axes="ab")
    with pytest.raises(pa.ConfigurationError, match="0 or more"):
        SelfClearanceTask(-0.01)
    with pytest.raises(pa.ConfigurationError, match="0 or more"):
        SelfClearanceTask(1e300)
    with pytest.raises(pa.ConfigurationError, match="fixed base"):
        pa.solve_posture(by_hand.arm(), [PositionTask("tip", (0, 0, 0))], contacts=["tip"])
    with pytest.raises(pa.ConfigurationError, match="tasks"):
        pa.solve_posture(robot, ["reach"])  # type: ignore[list-item]


def test_fields_of_tasks_with_another_type_are_refused_by_name() -> None:
    """They failed in the solver, for example with AttributeError or IndexError."""
    for wrong in (None, 1.5, [], object(), np.ones((2, 2))):
        for field, make in (
            ("frame", lambda value: PositionTask(value, (0, 0, 0))),
            ("axes", lambda value: PositionTask("base_link", (0, 0, 0), axes=value)),
            ("axes", lambda value: CoMTask((0, 0, 0), axes=value)),
            ("frame", lambda value: OrientationTask(value, np.eye(3))),
            ("frame", lambda value: AxisAlignTask(value, (1, 0, 0), (1, 0, 0))),
            ("positions", JointsTask),
            ("required", lambda value: JointsTask({}, required=value)),
            ("leg_front_r_1", lambda value: JointsTask({"leg_front_r_1": value})),
            ("distance", lambda value: SelfClearanceTask([value])),
        ):
            if field == "leg_front_r_1" and isinstance(wrong, float):
                continue
            with pytest.raises(pa.ConfigurationError, match=field):
                make(wrong)  # type: ignore[no-untyped-call]
    with pytest.raises(pa.ConfigurationError, match="leg_front_r_1"):
        JointsTask({"leg_front_r_1": np.nan})


def test_residuals_of_mujoco_show_that_the_mjcf_differs() -> None:
    """The first link of a leg is displaced by 1 cm in the MJCF only."""
    robot, qpos = load("v3"), stand_of("v3").qpos

    def displace(model: mujoco.MjModel) -> None:
        model.body_pos[model.jnt_bodyid[model.joint(robot.joint_names[1]).id]] += 0.01

    posture = pa.solve_posture(
        change_model(robot, displace), [PositionTask("base_link", qpos[:3])], start=qpos
    )
    assert posture.residuals.max() < 1e-9
    assert posture.mujoco_residuals.max() > 1e-5


def test_clearance_of_a_robot_without_collision_shapes_is_no_task(tmp_path: Path) -> None:
    """Reference: the position of the link after two joints, closed form 0.3 sin(angle)."""
    links = "".join(
        f'<link name="{name}"><inertial><origin xyz="0 0 0.1"/><mass value="1"/><inertia ixx="0.1" '
        'iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        for name in ("plinth", "upper", "tip")
    )
    joints = "".join(
        f'<joint name="{child}" type="revolute"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="0 0 {height}"/><axis xyz="0 1 0"/>'
        '<limit lower="-1" upper="1" effort="10" velocity="1"/></joint>'
        for parent, child, height in (("plinth", "upper", 0.0), ("upper", "tip", 0.3))
    )
    file = tmp_path / "arm.urdf"
    file.write_text(f'<robot name="arm">{links}{joints}</robot>')
    arm = pa.load_robot(file)
    tasks = [PositionTask("tip", (0.1, 0.0, 0.0), axes="x"), SelfClearanceTask(0.01)]
    posture = pa.solve_posture(arm, tasks)
    assert 0.3 * np.sin(posture.qpos[0]) == pytest.approx(0.1, abs=1e-6)
