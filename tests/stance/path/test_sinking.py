"""Paths on soft ground: what the ground gives is what moves the robot, feet that sink included."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import make_interp_spline

import pupper_analysis as pa
from pupper_analysis.robot.compliance import GroundLaw
from pupper_analysis.robot.configuration import UP
from pupper_analysis.robot.contact import ContactParameters
from pupper_analysis.simulation.tracking import TORQUE_TOLERANCE, track_path
from pupper_analysis.stance.path.fastest import RISE, fastest_path, ground_lag
from pupper_analysis.stance.path.pyramid import contact_frame, sink_in_pyramid
from pupper_analysis.stance.path.sinking import find_sunk_motion
from pupper_analysis.stance.path.stance_path import stance_path
from tests.stance.path.test_stance_path import stances
from tests.support.bases import gym
from tests.support.engines import changed
from tests.support.variants import load


def test_ground_forces_accelerate_the_centre_of_mass_of_sunk_legs() -> None:
    """Newton's law, by a spline of the com: the legs' own motion as feet sink is in the forces."""
    robot = soft(load("v3"))
    path = stance_path(robot, stances("v3", "squat")[:2], 0.16, rate=300)
    found = find_sunk_motion(robot, path)
    com = [pa.Configuration(robot, qpos).center_of_mass() for qpos in found.qpos]
    spline = make_interp_spline(path.time, np.array(com), k=5)
    inner = slice(4, -4)
    wanted = robot.total_mass * (spline(path.time[inner], 2) + 9.81 * UP)
    weight = robot.total_mass * 9.81
    np.testing.assert_allclose(found.forces[inner].sum(axis=1), wanted, atol=2e-3 * weight)
    legs = np.abs(path.forces[inner].sum(axis=1) - wanted).max()
    assert legs > 0.02 * weight  # on rigid ground they would be others


@pytest.mark.parametrize("condim", [3, 6])
def test_a_push_sinks_and_moves_a_foot_in_a_pyramidal_cone_as_mujoco_has_it(condim: int) -> None:
    """A ball that turns as it shall is pushed along both edges, up to past them."""
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><option cone="pyramidal" timestep="0.0002"/>
        <worldbody><geom type="plane" size="1 1 1"/><body pos="0 0 0.05">
        <joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/>
        <joint type="slide" axis="0 0 1"/><joint axis="1 2 0" armature="1000"/>
        <geom type="sphere" size="0.05" mass="1" condim="{condim}" friction="1 0.01 0.002"/>
        </body></worldbody></mujoco>"""
    )
    data, seconds = mujoco.MjData(model), 0.4
    time = np.arange(round(seconds / model.opt.timestep)) * model.opt.timestep
    law = GroundLaw(
        stiffness=(0.95 * 0.02) ** -2,
        damping=2 / (0.95 * 0.02),
        solimp=(0.9, 0.95, 0.001, 0.5, 2.0),
        normal=2 * float(model.body_invweight0[1, 0]) / (condim - 1),
        tangential=math.inf,
    )
    contact = ContactParameters(
        condim, (1.0, 1.0, 0.01, 0.002, 0.002), (0.02, 1.0), law.solimp, margin=0.0
    )
    phase = 2 * np.pi * time / seconds
    push = 9.81 * np.column_stack([0.1 * np.sin(2 * phase), 0.4 * (1 - np.cos(phase))])
    turning = 2 * np.sin(phase)
    data.qpos[2] = -law.depth(9.81)
    places, rates = np.empty((2, len(time), 3))
    for index, (one, rate) in enumerate(zip(push, turning, strict=True)):
        places[index], rates[index] = data.qpos[:3], data.qvel[:3]
        data.qfrc_applied[:2], data.qvel[3] = one, rate
        data.qfrc_applied[3] = 1000 * 2 * np.cos(phase[index]) * phase[1] / time[1]
        mujoco.mj_step(model, data)
    frame = contact_frame(UP)
    spin = turning[:, None] * np.array([1.0, 2.0, 0.0]) / math.sqrt(5)
    # What the ball's own inertia takes of the push, the contact does not get.
    left = np.column_stack([push, np.zeros(len(time))]) - np.gradient(rates, time, axis=0)
    given = np.column_stack([-left @ frame.T, spin @ frame.T])
    given[:, 0] = 9.81
    depth, _, along = sink_in_pyramid(law, contact, time, given, np.ones(len(time)))
    arm = -(0.05 + places[:, 2:] / 2) * UP  # MuJoCo has the contact half way down
    slip = cumulative_trapezoid((rates + np.cross(spin, arm))[:, :2], time, axis=0, initial=0.0)
    deep = np.ptp(places[:, 2])
    assert deep > 0.2 * law.depth(9.81)  # a push lifts it, or there would be nothing to tell
    np.testing.assert_allclose(-places[:, 2], depth, atol=0.02 * deep)
    np.testing.assert_allclose(slip, (along @ frame[1:])[:, :2], atol=0.02 * np.ptp(slip[:, 1]))


def soft(robot: pa.Robot) -> pa.Robot:
    """Feet sink by 16 of the 20 mm of their radius, and joints have dampers."""
    solimp = (0.015, 1.0, 0.031, 0.5, 2.0)

    def change(model: mujoco.MjModel) -> None:
        model.geom_solimp[:] = solimp
        model.dof_damping[6:] *= 3

    contacts = {foot: replace(own, solimp=solimp) for foot, own in robot.contacts.items()}
    return replace(changed(robot, change), contacts=contacts)


@pytest.mark.longest
@pytest.mark.parametrize("kind", ["squat", "sway"])
def test_fast_paths_are_tracked_where_feet_sink_deep(kind: str) -> None:
    robot = soft(load("v3"))
    tracking = track_path(robot, fastest_path(robot, stances("v3", kind)).path)
    assert tracking.passed, tracking.failures
    assert tracking.torque_error < 0.6 * TORQUE_TOLERANCE


@pytest.mark.longest
def test_a_fast_sway_on_pyramidal_cones_is_tracked_and_stays_inside_them() -> None:
    def change(model: mujoco.MjModel) -> None:
        model.opt.cone, model.opt.impratio = (
            mujoco.mjtCone.mjCONE_PYRAMIDAL,
            1.0,
        )  # above, it shakes

    robot = changed(load("original"), change)
    path = fastest_path(robot, stances("original", "sway")).path
    edges = np.abs(path.forces @ contact_frame(UP)[1:].T).sum(axis=2)
    mu = np.array([robot.contacts[foot].sliding_friction for foot in path.feet])
    carrying = path.loads > 0
    assert (edges <= 0.8 * mu * path.loads + 1e-6)[carrying].all()
    assert track_path(robot, path).torque_error < 0.6 * TORQUE_TOLERANCE


@pytest.mark.longest
def test_a_fast_squat_keeps_feet_on_the_ground_that_sink_by_half_their_radius(
    tmp_path: Path,
) -> None:
    pair = gym("spot/spot.xml")(tmp_path)
    robot = pa.load_robot(urdf=pair.urdf, mjcf=pair.mjcf)
    tasks = [pa.StandTask(height=share * robot.stand_height) for share in (1.0, 0.9, 1.0)]
    found = fastest_path(robot, tasks)
    assert found.rise > RISE * ground_lag(robot)  # or the feet would slip, and be off by 10 %
    assert track_path(robot, found.path).torque_error < 0.6 * TORQUE_TOLERANCE
