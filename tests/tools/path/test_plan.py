"""Paths through stances: smooth, and in balance at each sample."""

from __future__ import annotations

import csv
import math
from functools import cache
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from scipy.interpolate import make_interp_spline

import pupper_analysis as pa
from pupper_analysis.base.diagnostics import Diagnostic, Quantity
from pupper_analysis.base.errors import NoEquilibriumError
from pupper_analysis.robot.configuration import UP
from pupper_analysis.tools.path import geometry
from pupper_analysis.tools.path.dynamics import joint_resistance
from pupper_analysis.tools.path.geometry import solve_segments
from pupper_analysis.tools.path.plan import StancePath, stance_path
from pupper_analysis.tools.path.tracking import track_path
from tests.support.legged import biped, edit_pair, fix_hinges, quadruped_with_slides
from tests.support.variants import load

Task = pa.StandTask


def circle(angle: float, legs: int = 6) -> list[pa.StandTask]:
    turns = [2 * math.pi * leg / legs for leg in range(legs + 1)]
    return [Task(), *(Task(roll=angle * math.sin(t), pitch=angle * math.cos(t)) for t in turns)]


def lift(name: str, foot: str, height: float = 0.02) -> list[pa.StandTask]:
    """Shift the weight on to three legs, lift the fourth, hold, set it down, shift back."""
    robot = load(name)
    feet = pa.Configuration(robot, robot.neutral()).foot_positions()
    x, y = np.mean([feet[point][:2] for point in robot.contact_points if point != foot], axis=0)
    over, up = Task(com=(x, y)), Task(com=(x, y), swing={foot: height})
    return [Task(), over, up, up, over, Task()]


def stances(name: str, kind: str) -> list[pa.StandTask]:
    low = Task(height=0.9 * load(name).stand_height)
    return {
        "squat": [Task(), low, Task()],
        "sway": [Task(), Task(com=(0.0, 0.015)), Task(com=(0.0, -0.015)), Task()],
        "circle": circle(0.1),
        "lift": lift(name, "FL"),
    }[kind]


SECONDS = {"squat": 2.0, "sway": 3.0, "circle": 5.0, "lift": 6.0}


@cache
def path_of(name: str, kind: str, rolling: bool = True) -> StancePath:
    rate = 50.0 if kind == "circle" else 20.0  # feet that roll in circles add up their samples
    return stance_path(load(name), stances(name, kind), SECONDS[kind], rate=rate, rolling=rolling)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["v3", "original"])
@pytest.mark.parametrize("kind", SECONDS)
@pytest.mark.parametrize("rolling", [False, True])
def test_every_sample_is_a_stand_in_balance(name: str, kind: str, rolling: bool) -> None:
    """References: M qacc + h + friction = J^T f + tau of Pinocchio, loads from the CoM
    acceleration, and single stands at the stances.
    """
    robot, path, tasks = load(name), path_of(name, kind, rolling), stances(name, kind)
    joints = path.joint_positions()
    assert (joints >= robot.lower_limits - 1e-9).all()
    assert (joints <= robot.upper_limits + 1e-9).all()
    assert 0 < path.peak_utilisation < 1
    assert (path.com_margin > 0).all()
    assert (path.loads >= 0).all()
    assert ((path.loads > 0) <= path.stance_feet).all()
    nominal = pa.Configuration(robot, path.qpos[0]).foot_positions()
    for index in range(0, len(path.time), 3):
        config = pa.Configuration(robot, path.qpos[index], path.qvel[index])
        rise = config.com_acceleration(path.qacc[index])[2]
        carried = robot.total_mass * (rise - robot.gravity[2])
        np.testing.assert_allclose(path.loads[index].sum(), carried, rtol=1e-9)
        remainder = config.mass_matrix() @ path.qacc[index] + config.bias_forces()
        remainder += joint_resistance(robot, path.qvel[index], path.qacc[index])
        for column, foot in enumerate(robot.contact_points):
            centre = config.foot_positions()[foot]
            planted = nominal[foot] + (0, 0, path.clearance[index, column])
            np.testing.assert_allclose(centre[2], planted[2], atol=2e-9)
            if not rolling:
                np.testing.assert_allclose(centre, planted, atol=2e-9)
            down = -robot.contact_radius[foot] * UP
            jacobian = config.frame_jacobian(robot.contact_frames[foot], down)
            wrench = [*path.forces[index, column], *path.moments[index, column]]
            remainder -= jacobian.T @ np.array(wrench)
        remainder[6:] -= path.torques[index]
        np.testing.assert_allclose(remainder, 0, atol=1e-8)
    # At the stances, the path equals the requested stands.
    per_leg = (len(path.time) - 1) // (len(tasks) - 1)
    for number, (task, stand) in enumerate(zip(tasks, path.stances, strict=True)):
        there = path.qpos[number * per_leg]
        np.testing.assert_allclose(there[2:7], stand.qpos[2:7], atol=1e-8)
        if not rolling:
            np.testing.assert_allclose(there, stand.qpos, atol=1e-8)
        one = pa.solve_stand(robot, task)
        np.testing.assert_allclose(stand.qpos, one.qpos, atol=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "kind"), [("v3", "circle"), ("original", "lift")])
def test_rolling_feet_have_no_slip_velocity(name: str, kind: str) -> None:
    """The velocity of the foot's material point at the contact, by differences, is zero."""
    robot = load(name)
    path = stance_path(robot, stances(name, kind), 3.0, rate=60.0)
    slow, fast = 0.0, 0.0
    for index in range(len(path.time) - 1):
        first, second = (pa.Configuration(robot, path.qpos[i]) for i in (index, index + 1))
        for column, foot in enumerate(robot.contact_points):
            if not path.stance_feet[index : index + 2, column].all():
                continue
            frame, down = robot.contact_frames[foot], -robot.contact_radius[foot] * UP
            turn = second.frame_rotation(frame) @ first.frame_rotation(frame).T
            half = pin.exp3(pin.log3(turn) / 2)  # the point that is lowest half way between
            moved = second.frame_position(frame) + half @ down
            moved -= first.frame_position(frame) + half.T @ down
            slow = max(slow, float(np.linalg.norm(moved[:2])))
            rolled = second.frame_position(frame) - first.frame_position(frame)
            fast = max(fast, float(np.linalg.norm(rolled)))
    assert slow < 2e-3 * fast


@pytest.mark.slow
@pytest.mark.parametrize("kind", list(SECONDS))
def test_a_path_rests_in_every_stance_and_is_smooth_between(kind: str) -> None:
    """Reference: finite differences of the joint positions [rad/s, rad/s^2]."""
    path = stance_path(load("v3"), stances("v3", kind)[:3], 1.0, rate=140.0)
    joints, step = path.joint_positions(), path.time[1]
    velocity = np.abs(np.gradient(joints, step, axis=0)).max(axis=1)
    acceleration = np.abs(np.diff(joints, 2, axis=0)).max(axis=1) / step**2
    assert velocity.max() > 0.1
    for number in range(3):
        at = number * (len(path.time) - 1) // 2
        assert velocity[at] < 3e-3 * velocity.max()
        near = acceleration[max(at - 2, 0) : at + 1]
        assert near.min() < 0.2 * acceleration.max()


@pytest.mark.slow
def test_torques_are_continuous_if_a_foot_is_unloaded() -> None:
    """Twice the sampling rate reduces the largest change per sample to less than 60 %."""
    jumps = []
    for rate in (60.0, 120.0):
        path = stance_path(load("original"), stances("original", "lift"), 3.0, rate=rate)
        jumps.append(np.abs(np.diff(path.torques, axis=0)).max())
    assert jumps[1] < 0.6 * jumps[0]
    assert jumps[1] < 0.1 * np.ptp(path.torques, axis=0).max()


@pytest.mark.slow
@pytest.mark.parametrize(("name", "kind"), [("v3", "circle"), ("original", "lift")])
def test_velocity_and_acceleration_are_derivatives(name: str, kind: str) -> None:
    """Reference: derivatives of a spline of degree 7 through qpos, one spline per segment,
    since the jerk is not smooth at the stances.
    """
    robot, legs = load(name), len(stances(name, kind)) - 1
    path = stance_path(robot, stances(name, kind), float(legs), rate=40.0, rolling=False)
    inner = slice(5, -5)  # where a spline is good
    for leg in range(legs):
        part = slice(40 * leg, 40 * leg + 41)
        spline = make_interp_spline(path.time[part], path.qpos[part], k=7)
        for order, table in ((1, path.qvel), (2, path.qacc)):
            found, expected = spline(path.time[part], order)[inner], table[part][inner]
            scale = np.abs(table).max()
            np.testing.assert_allclose(expected[:, :3], found[:, :3], atol=1e-6 * scale)
            np.testing.assert_allclose(expected[:, 6:], found[:, 7:], atol=1e-6 * scale)
        # The base's angular velocity in its own axes, from the quaternion's derivative.
        rate = spline(path.time[part], 1)[inner, 3:7]
        for quaternion, change, qvel in zip(
            path.qpos[part][inner, 3:7], rate, path.qvel[part][inner], strict=True
        ):
            w, x, y, z = quaternion
            inverse = pin.Quaternion(w, -x, -y, -z)
            turn = inverse * pin.Quaternion(*change)
            np.testing.assert_allclose(qvel[3:6], 2 * turn.coeffs()[:3], atol=1e-6)


@pytest.mark.slow
def test_path_is_refused_if_contacts_cannot_supply_the_force() -> None:
    robot, tasks = load("v3"), stances("v3", "squat")
    with pytest.raises(pa.StaticsInfeasibleError, match=r"at 0\.\d\d s, between stances") as caught:
        stance_path(robot, tasks, 0.1)
    assert caught.value.reason in (
        pa.errors.Infeasibility.ZMP_OUTSIDE,
        pa.errors.Infeasibility.PULL,
    )
    path = stance_path(robot, tasks, 0.5)
    assert path.peak_joint in robot.joint_names
    sample = round(path.peak_time / path.time[1])
    used = np.abs(path.torques[sample]) / robot.effort_limits
    assert used.max() == pytest.approx(path.peak_utilisation)


@pytest.mark.slow
def test_a_foot_is_unloaded_before_it_lifts() -> None:
    """The load [N] decreases to zero before the clearance of 20 mm begins."""
    path = path_of("v3", "lift")
    foot, leg = path.feet.index("FL"), (len(path.time) - 1) // 5
    loads, clear = path.loads[:, foot], path.clearance[:, foot]
    assert loads[0] > 0.2 * path.loads[0].sum()
    # The robot sets off by pressing on the foot that it leaves, against its own inertia.
    pressed = int(loads[: leg + 1].argmax())
    assert pressed < leg / 3
    assert (np.diff(loads[pressed : leg + 1]) < 1e-9).all()
    assert (loads[leg : 4 * leg + 1] == 0).all()
    assert (clear[: leg + 1] == 0).all()
    np.testing.assert_allclose(clear[2 * leg : 3 * leg + 1], 0.02)
    assert loads[-1] == pytest.approx(loads[0], rel=1e-4)


@pytest.mark.slow
def test_a_lifted_foot_may_land_elsewhere_and_on_a_slope() -> None:
    """References: the requested offset of 10 mm, and tracking in MuJoCo."""
    robot, ground = load("v3"), pa.Ground(slope=0.05, uphill=0.5)
    moved = [
        pa.StandTask(com=t.com, swing=t.swing, ground=ground, foot_offsets={"FL": (place, 0.0)})
        for t, place in zip(lift("v3", "FL")[1:5], (0, 0, 0.01, 0.01), strict=True)
    ]
    path = stance_path(robot, moved, 4.0, rate=20.0, rolling=False)
    first, last = (pa.Configuration(robot, path.qpos[i]).foot_positions() for i in (0, -1))
    np.testing.assert_allclose(last["FL"][:2] - first["FL"][:2], (0.01, 0), atol=1e-8)
    tracking = track_path(robot, path)
    assert tracking.passed, tracking.failures


@pytest.mark.slow
def test_loads_of_a_path_on_a_slope_are_vertical() -> None:
    """By hand, at rest: loads sum up to W [N]; forces along the normal sum up to W cos(slope)."""
    robot, slope = load("v3"), 0.3
    task = pa.StandTask(ground=pa.Ground(slope, 0.4), pitch=-0.25)
    low = pa.StandTask(ground=task.ground, pitch=-0.25, height=0.125)
    path = stance_path(robot, [task, low], 4.0, rate=20.0)
    weight = robot.total_mass * np.linalg.norm(robot.gravity)
    assert path.loads[0].sum() == pytest.approx(weight, rel=1e-6)
    normal = task.ground.normal()
    assert (path.forces[0] @ normal).sum() == pytest.approx(weight * math.cos(slope), rel=1e-6)


@pytest.mark.slow
def test_csv_contains_time_positions_and_torques_of_a_path(tmp_path: Path) -> None:
    path = path_of("v3", "lift")
    path.to_csv(tmp_path / "new" / "path.csv")
    with (tmp_path / "new" / "path.csv").open() as file:
        header, *rows = csv.reader(file)
    names = load("v3").joint_names
    units = [f"q {name} (rad)" for name in names] + [f"tau {name} (N m)" for name in names]
    assert header == ["time (s)", *units]
    table = np.array(rows, dtype=float)
    expected = np.column_stack([path.time, path.joint_positions(), path.torques])
    np.testing.assert_array_equal(table, expected)
    with pytest.raises(pa.OutputError):
        path.to_csv(tmp_path / "new" / "path.csv" / "path.csv")


def test_units_of_slides_are_metres_and_newtons(tmp_path: Path) -> None:
    """The knees are slides, the hips (roll, pitch) are hinges."""
    robot = pa.load_robot(quadruped_with_slides(tmp_path))
    task = pa.StandTask(height=robot.stand_height)
    path = stance_path(robot, [task, task], 1.0, rate=20.0)
    path.to_csv(tmp_path / "path.csv")
    header = (tmp_path / "path.csv").read_text().splitlines()[0]
    assert "q FL_knee (m)" in header
    assert "tau FL_knee (N)" in header
    assert "q FL_roll (rad)" in header
    assert "tau FL_roll (N m)" in header
    path.to_csv(tmp_path / "path.csv")  # the file is recognised as an earlier table


WALL = pa.Contact(pa.Plane((0.1, 0.0, 0.0), (-1.0, 0.0, 0.0)))
FL, FR, RL = ({foot: 0.02} for foot in ("FL", "FR", "RL"))


@pytest.mark.parametrize(
    ("tasks", "seconds", "rate", "named"),
    [
        ([], 1.0, 50.0, "stances: .* at least 2"),
        (Task(), 1.0, 50.0, "stances: .* not a sequence"),
        ([Task(), None], 1.0, 50.0, "stances: .*, None. is not"),
        ([Task(), Task()], 0.0, 50.0, "seconds"),
        ([Task(), Task()], 1.0, 0.0, "rate"),
        ([Task(), Task()], 1e6, 50.0, "samples"),
        ([Task(), Task(ground=pa.Ground(slope=0.1))], 1.0, 50.0, "different grounds"),
        ([Task(com="inside"), Task(com=(0.0, 0.0))], 1.0, 50.0, "inside"),
        ([Task(), Task(offset=(0.0, 0.0))], 1.0, 50.0, "offset: a path moves the CoM"),
        ([Task(), Task(contacts={"FL": WALL})], 1.0, 50.0, "contacts: a path supports only feet"),
        ([Task(), Task(foot_offsets={"FL": (0.01, 0.0)})], 1.0, 50.0, "FL carries load between"),
        (
            [Task(swing=FL), Task(swing=FR)],
            1.0,
            50.0,
            "only 2 feet carry load between stances 1 and",
        ),
        ([Task(swing=FL), Task(), Task(swing=FR)], 1.0, 50.0, "lands and another foot lifts"),
        ([Task(), Task(yaw=0.3), Task(yaw=-0.3)], 1.0, 0.1, "jumps"),
    ],
)
def test_a_path_refuses_bad_arguments(
    tasks: list[Task], seconds: float, rate: float, named: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    if named == "jumps":
        tasks = [Task(height=0.15), Task(height=0.08)]
        monkeypatch.setattr("pupper_analysis.tools.path.plan.MIN_SAMPLES_PER_SEGMENT", 2)
    with pytest.raises(pa.ConfigurationError, match=named) as caught:
        stance_path(load("v3"), tasks, seconds, rate=rate)
    assert "\n" not in str(caught.value)


def test_sole_on_a_short_leg_that_cannot_stay_in_place_is_named(tmp_path: Path) -> None:
    """Legs without a yaw joint rotate their soles with the base. Reference: the number of joints
    of a leg, and the yaw times the distance of a corner of the sole from the middle of both feet.
    """
    key = f'<keyframe><key name="home" qpos="0 0 0.6932 1 0 0 0 {"0 -0.3 0.6 -0.3 0 " * 2}"/>'
    pair = fix_hinges(biped(tmp_path), "_yaw")
    robot = pa.load_robot(*edit_pair(pair, {}, {"</mujoco>": f"{key}</keyframe></mujoco>"}))
    with pytest.raises(pa.ConfigurationError, match="a leg with 5 joints") as refused:
        solve_segments(robot, [Task(), Task(yaw=2e-4)])
    problem = refused.value.problem
    assert isinstance(problem, Diagnostic)
    assert problem.code == "short-leg-moves-sole"
    moved = problem.values["moved"]
    assert isinstance(moved, Quantity)
    assert 1e-9 < moved.value < 2e-4 * math.hypot(0.12, 0.14)


def test_refusals_name_the_moment() -> None:
    """An error in a sample states time and stances; other errors state the stance or argument."""
    robot = load("v3")
    with pytest.raises(
        pa.StaticsInfeasibleError, match=r"at 0\.00 s, between stances 1 and 2: .*insert"
    ):
        stance_path(robot, [Task(), Task(swing=FL)], 1.0)
    over = lift("v3", "FL")
    with pytest.raises(pa.StaticsInfeasibleError, match=r"at 1.00 s, between .* 1 and 2") as caught:
        stance_path(robot, [over[1], Task(), over[2]], 2.0, rolling=False)
    assert caught.value.reason is pa.errors.Infeasibility.COM_OUTSIDE
    assert "\n" not in str(caught.value)
    with pytest.raises(pa.ConfigurationError, match="outside the support polygon"):
        stance_path(robot, [Task(), Task(com=(0.14, 0.0), height=0.1)], 1.0)
    with pytest.raises(pa.StanceUnreachableError, match="stance 2: ") as missed:
        stance_path(robot, [Task(), Task(height=0.4)], 1.0)
    assert missed.value.shortfall
    with pytest.raises(pa.UnknownNameError):
        stance_path(robot, [Task(), Task(swing={"XX": 0.01})], 1.0)


@pytest.mark.slow
def test_path_below_a_required_clearance_is_refused() -> None:
    """The lowest stance is 1 mm below the required clearance; with a smaller required clearance
    the path is planned."""
    robot = load("v3")
    low = 0.08
    stance_path(robot, [Task(), Task(height=low)], 1.0, rate=20.0)
    near = pa.solve_stand(robot, Task(height=low)).ground_clearance
    assert near is not None
    least = near.distance + 1e-3
    with pytest.raises(pa.StanceUnreachableError, match=r"stance 2: .* above the ground"):
        stance_path(robot, [Task(), Task(height=low, ground_clearance=least)], 1.0, rate=20.0)
    path = stance_path(
        robot, [Task(ground_clearance=0.04), Task(height=0.1, ground_clearance=0.02)], 1.0
    )
    assert path.peak_utilisation < 1


def test_paths_keep_the_margin_of_the_com() -> None:
    robot = load("original")
    stances = [Task(com=(x, 0.0), com_margin=margin) for x, margin in ((0.0, 0.0), (0.03, 0.04))]
    path = pa.stance.stance_path(robot, stances, 2.0, rate=10.0)
    assert path.com_margin[-1] >= 0.04 - 1e-9


def test_feet_of_a_squat_roll_by_radius_times_angle() -> None:
    """Closed form: displacement of the centre [m] = radius times rotation of the foot [rad]."""
    robot, path = load("original"), path_of("original", "squat")
    top, low = (pa.Configuration(robot, path.qpos[i]) for i in (0, (len(path.time) - 1) // 2))
    for foot, frame in robot.contact_frames.items():
        turn = pin.log3(low.frame_rotation(frame) @ top.frame_rotation(frame).T)
        rolled = low.foot_positions()[foot] - top.foot_positions()[foot]
        assert abs(turn[1]) > 0.05
        assert rolled[0] == pytest.approx(robot.contact_radius[foot] * turn[1], rel=1e-3)


@pytest.mark.slow
def test_feet_whose_rolling_does_not_converge_state_no_share_of_feedforward(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """No feed-forward is removed on a path: 0.0 would mean that none of it could be removed."""
    monkeypatch.setattr(geometry, "_ROLL_TOLERANCE", -1.0)
    robot = load("v3")
    with pytest.raises(NoEquilibriumError, match="roll") as caught:
        geometry.path_geometry(robot, [Task(), Task(roll=0.1)], 2, 1.0)
    assert caught.value.share is None


def test_velocity_and_acceleration_at_a_stance_vanish_with_the_step() -> None:
    """Differences of joint positions: the velocity shrinks as step^2, the acceleration as step."""
    rates = []
    for rate in (30.0, 60.0):
        path = stance_path(load("v3"), stances("v3", "squat"), 2.0, rate=rate)
        joints, step, at = path.joint_positions(), path.time[1], len(path.time) // 2
        ahead, further = joints[at + 1] - joints[at], joints[at + 2] - joints[at]
        rates.append((np.abs(ahead).max() / step, np.abs(further - 2 * ahead).max() / step**2))
    assert rates[1][0] == pytest.approx(rates[0][0] / 4, rel=0.15)
    assert rates[1][1] == pytest.approx(rates[0][1] / 2, rel=0.15)


@pytest.mark.slow
def test_inertial_torques_grow_with_the_square_of_the_speed() -> None:
    """Without damping and dry friction; at rest the torques are those of gravity."""
    robot, torques = load("original"), []
    for seconds in (1e4, 1.0, 0.5):
        path = stance_path(robot, stances("original", "squat"), seconds, rate=32 / seconds)
        motion = zip(path.qvel, path.qacc, strict=True)
        resistance = np.array([joint_resistance(robot, *row)[6:] for row in motion])
        torques.append(path.torques - resistance)
    slow, fast = np.abs(torques[1] - torques[0]).max(), np.abs(torques[2] - torques[0]).max()
    assert fast > 0.05
    assert fast == pytest.approx(4 * slow, rel=1e-3)
