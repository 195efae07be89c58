"""Causes for which a simulation does not come to rest: pulses of the ground force."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.robot.servos import model_with_servos
from pupper_analysis.robot.stability import Stability
from pupper_analysis.simulation.causes import (
    find_chatter,
    find_creep,
    find_instability,
    proves_unrest,
)
from pupper_analysis.simulation.rollout import place_on_ground, simulate_commands
from pupper_analysis.simulation.stability import MAX_RESTING_SPEED, Nudge
from pupper_analysis.stance.stand import stand_statics
from tests.support.legged import quadruped, rewrite_file
from tests.support.variants import load, stand_of


@pytest.mark.slow
@pytest.mark.parametrize(
    ("option", "words"),
    [
        ('<option impratio="10"/>', 'impratio 10 of the MJCF is meant for cone="elliptic"'),
        ('<option impratio="10" cone="elliptic"/>', "a longer solref"),
        ("", "a longer solref"),
    ],
)
def test_ground_that_pushes_in_pulses_is_named_as_a_cause(
    option: str, words: str, tmp_path: Path
) -> None:
    """States whose base height alternates by 2 mm, as in the simulation of a Booster K1 on a
    slope.
    """
    pair = quadruped(tmp_path, actuators="position")
    text = pair.mjcf.read_text()
    pair.mjcf.write_text(text.replace("<worldbody>", f"{option}<worldbody>", 1))
    robot = pa.load_robot(urdf=pair.urdf, mjcf=pair.mjcf)
    stand = pa.stance.solve_stand_on_soft_ground(robot)
    drive = model_with_servos(robot)
    ctrl = drive.command(robot, stand.joint_positions(robot), None)
    start = place_on_ground(
        robot, drive, stand, pa.stance.stand_statics(robot, stand).joint_torques
    )
    states = simulate_commands(drive.model, start, np.tile(ctrl, (200, 1)))
    assert find_chatter(robot, drive, states, ctrl) == []
    states = np.tile(states[-1], (200, 1))
    states[::2, 3] += 2e-3  # the base's height, every other step: it bears all, or nothing
    (message,) = find_chatter(robot, drive, states, ctrl)
    assert message.code == "contacts-rattle"
    assert message.values["share"] == pytest.approx(0.5, abs=1e-3)
    assert words in str(message)


@pytest.mark.slow
def test_share_of_the_pulses_increases_with_the_motion_of_the_ground() -> None:
    """The base height alternates by up to 2 mm; variations below a twentieth are not reported."""
    robot, stand = load("original"), stand_of("original")
    drive = model_with_servos(robot)
    at_rest = pa.stance.solve_stand_on_soft_ground(robot)
    ctrl = drive.command(robot, stand.joint_positions(robot))
    start = place_on_ground(
        robot, drive, at_rest, pa.stance.stand_statics(robot, at_rest).joint_torques
    )
    state = simulate_commands(drive.model, start, np.tile(ctrl, (200, 1)))[-1]
    shares = []
    for way in (0.0, 1e-5, 5e-4, 2e-3):
        states = np.tile(state, (50, 1))
        states[::2, 3] += way
        states[1::2, 3] -= way
        found = find_chatter(robot, drive, states, ctrl)
        shares.append(sum(float(cause.values["share"]) for cause in found))
    assert shares[:2] == [0.0, 0.0]
    assert 0.1 < shares[2] < 0.9
    assert shares[3] > 1.5 * shares[2]


@pytest.mark.parametrize("left", [1e-4, 4e-3, 6e-3, 0.3, np.nan])
@pytest.mark.parametrize("moved", [1e-3, 0.02, np.nan])
@pytest.mark.parametrize("decayed", [False, True])
def test_response_that_proves_unrest_is_a_failure_with_all_excuses(
    left: float, moved: float, decayed: bool
) -> None:
    """Reference: the reports without growing modes, and with a foot that bounces if it is slow."""
    nudge = Nudge(
        speed=0.02,
        time=5.0,
        duration=7.0,
        motion=left,
        left=left,
        moved=moved,
        farthest=moved,
        decayed=decayed,
    )
    stability = Stability(
        timestep=0.002,
        radius=1.0,
        unstable=(),
        least_damped=None,
        speed=0.0,
        uses_noslip_solver=False,
    )
    is_harmless = left < MAX_RESTING_SPEED
    reported = find_instability(stability, nudge, is_harmless=is_harmless)
    assert proves_unrest(nudge) == bool(reported)


@pytest.mark.parametrize(("solref", "creeps"), [("0.02 1", False), ("-5000 0", True)])
def test_only_contacts_with_friction_creep(tmp_path: Path, solref: str, creeps: bool) -> None:
    """Reference: MuJoCo's formula c = b d / ((1 - d) A_t), which is 0 for a foot without friction,
    and for feet whose ``solref`` has no damping (b = 0). Only the latter transmit friction.
    """
    pair = quadruped(tmp_path, floor=True, actuators="position")
    feet = f'<geom solref="{solref}" type="sphere"'
    rewrite_file(pair.mjcf, ('<geom type="sphere"', feet))
    rewrite_file(pair.mjcf, (feet, f'<geom condim="1" priority="1" {feet[6:]}'), count=1)
    robot = pa.load_robot(pair.urdf, pair.mjcf)
    stand = pa.solve_stand(robot)
    statics = stand_statics(robot, stand)
    messages = find_creep(robot, stand, statics)
    slippery = [foot for foot in robot.contacts if robot.contacts[foot].condim == 1]
    assert len(slippery) == 1
    assert [message.code for message in messages] == ["foot-creeps"] * creeps
    assert all(message.subject.name not in slippery for message in messages if message.subject)
