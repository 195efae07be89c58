"""Legs of two joints, which move in planes and cannot place feet sideways; MuJoCo's simulation is
the reference.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.problem import can_move_com
from tests.support.legged import Pair, edit_pair, planar, quadruped, shift_base_com


def load(pair: Pair) -> Robot:
    return pa.load_robot(urdf=pair.urdf, mjcf=pair.mjcf)


def verify_held_stand(robot: Robot, task: pa.StandTask | None = None) -> pa.Stand:
    """Return the stand on soft ground; assert that MuJoCo holds it with relative torque and force
    errors below 1e-5.
    """
    stand = pa.stance.solve_stand_on_soft_ground(robot, task)
    found = pa.verify_stand(robot, stand)
    assert found.passed, found.failures
    assert max(found.torque_error, found.force_error) < 1e-5
    return stand


@pytest.mark.slow
def test_a_planar_robot_stands_with_the_com_two_micrometres_off_the_centre(tmp_path: Path) -> None:
    """Closed form: 2 um times the trunk's mass fraction of 4 / 8.4.

    A CoM at the centre is out of reach.
    """
    robot = load(planar(quadruped(tmp_path)))
    assert robot.nu == 8
    assert any(note.code == "com-anywhere-inside" for note in robot.notes)
    stand = verify_held_stand(robot)
    assert stand.task.com == "inside"
    com = pa.Configuration(robot, stand.qpos).center_of_mass()
    # The trunk has 4 of the 8.4 kg, and its CoM is 2 um aside; no leg moves sideways.
    middle = np.mean(list(stand.contact_points.values()), axis=0)
    assert com[1] - middle[1] == pytest.approx(2e-6 * 4 / robot.total_mass, rel=1e-6)
    with pytest.raises(pa.StanceUnreachableError):
        pa.solve_stand(robot, pa.StandTask(com="centre"), explain=False)


@pytest.mark.slow
def test_planar_legs_stand_at_both_ends_of_the_reachable_heights(tmp_path: Path) -> None:
    """The solver reaches both ends, and refuses 1 mm above the upper end. Planar legs cannot
    correct a lateral CoM error, not even one of rounding.
    """
    robot = load(planar(quadruped(tmp_path)))
    heights = pa.stance.reachable_heights(robot)
    assert heights.low < 0.8 * robot.stand_height < 1.2 * robot.stand_height < heights.high
    for height in (heights.low, heights.high):
        assert pa.solve_stand(robot, pa.StandTask(height=height), explain=False).solved
    with pytest.raises(pa.StanceUnreachableError):
        pa.solve_stand(robot, pa.StandTask(height=heights.high + 1e-3), explain=False)


@pytest.mark.slow
def test_a_planar_robot_squats_shifts_and_lifts_a_foot(tmp_path: Path) -> None:
    """Reference: MuJoCo's simulation of each stand."""
    robot = load(planar(quadruped(tmp_path)))
    verify_held_stand(robot, pa.StandTask(height=0.9 * robot.stand_height))
    stand = verify_held_stand(robot, pa.StandTask(offset=(0.02, 0.0)))
    assert stand.task.com == "centre"
    verify_held_stand(robot, pa.StandTask(swing={"FL_calf": 0.03}, com_margin=0.005))


@pytest.mark.slow
def test_height_loss_of_a_planar_robot_equals_mujoco(tmp_path: Path) -> None:
    """Reference: simulation.

    The sideways positions of pinned feet are redundant, so the equations are singular.
    """
    robot = load(planar(quadruped(tmp_path)))
    stand = pa.solve_stand(robot)
    sag = pa.steady_state(robot, stand)
    assert not sag.failures
    seen = pa.verify_stand(robot, stand, feedforward=False, duration=8.0, nudged=0)
    assert sag.height_loss == pytest.approx(seen.height_loss, rel=1e-3)  # feet creep by micrometres
    assert sag.height_loss > 1e-3


@pytest.mark.slow
def test_joints_with_more_than_a_turn_of_range_are_not_wound_up(tmp_path: Path) -> None:
    """Ranges of -10 to 10 rad: home angles are within half a turn."""
    pair = planar(quadruped(tmp_path))
    for narrow in ("-2.6 -0.4", "-1.5 2.5"):
        low, high = narrow.split()
        text = pair.urdf.read_text()
        text = text.replace(f'lower="{low}" upper="{high}"', 'lower="-10" upper="10"')
        pair.urdf.write_text(text)
        pair.mjcf.write_text(pair.mjcf.read_text().replace(f'range="{narrow}"', 'range="-10 10"'))
    robot = load(pair)
    assert np.abs(robot.home[7:]).max() < np.pi
    verify_held_stand(robot)


@pytest.mark.slow
def test_creep_on_a_slope_equals_the_friction_law_of_mujoco(tmp_path: Path) -> None:
    """Reference: the drift of height in simulation, the reported creep speed times sin(slope)."""
    robot = load(planar(quadruped(tmp_path)))
    stand = pa.stance.solve_stand_on_soft_ground(robot, pa.StandTask(ground=pa.Ground(slope=0.25)))
    seen = pa.verify_stand(robot, stand)
    assert not seen.passed
    reason = next(failure for failure in seen.failures if failure.code == "foot-creeps")
    speed = reason.values["speed"].value
    assert -seen.height_drift == pytest.approx(speed * np.sin(0.25), rel=1e-3)
    assert "impratio" in str(reason)


@pytest.mark.slow
def test_legs_of_three_joints_can_move_the_com_over_the_feet(tmp_path: Path) -> None:
    robot = load(quadruped(tmp_path))
    assert can_move_com(robot)
    assert pa.solve_stand(robot).task.com == "centre"


@pytest.mark.slow
def test_planar_legs_stand_with_a_com_that_the_head_cannot_centre(tmp_path: Path) -> None:
    """Closed form: 5 mm times the trunk's mass fraction; a turned head shifts the CoM by 0.7 mm.

    The joint of the head does not count as a joint that can centre the CoM (Petoi's Bittle).
    """
    pair = planar(quadruped(tmp_path, head=True, keyframe=""))
    pair = shift_base_com(pair, 5e-3)
    mass = 'mass="0.3" diaginertia='
    edits = {
        f'pos="0 0 0" {mass}': f'pos="0.02 0 0" {mass}',
        'name="nod" axis="0 1 0"': 'name="nod" axis="0 0 1"',
    }
    robot = pa.load_robot(mjcf=edit_pair(pair, {}, edits).mjcf)
    assert not can_move_com(robot)
    stand = verify_held_stand(robot)
    assert stand.task.com == "inside"
    com = pa.Configuration(robot, stand.qpos).center_of_mass()
    middle = np.mean(list(stand.contact_points.values()), axis=0)
    shift = 0.3 * 0.02 * np.sin(stand.joint_positions(robot)[robot.joint_names.index("nod")])
    expected = (5e-3 * 4 + shift) / robot.total_mass
    assert com[1] - middle[1] == pytest.approx(expected, rel=1e-6)


@pytest.mark.slow
def test_a_com_at_the_centre_is_refused_if_planar_legs_cannot_reach_it(tmp_path: Path) -> None:
    robot = load(planar(quadruped(tmp_path)))
    with pytest.raises(pa.StanceUnreachableError):
        pa.solve_stand(robot, pa.StandTask(com="centre"), explain=False)
