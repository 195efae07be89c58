"""Classification of simulated states (fallen, in contact, at rest), on states that are set by
hand.
"""

from __future__ import annotations

import math
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from pupper_analysis.base.arrays import rotation_from_quaternion
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.robot.fall import has_collapsed
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import model_with_servos
from pupper_analysis.simulation import monitor
from pupper_analysis.simulation.rollout import full_state, simulate_commands
from pupper_analysis.simulation.verify import _stands_despite_idle_feet, verify_stand
from tests.support.states import quaternion
from tests.support.variants import load, stand_of

NAME = "original"


def state_at(
    robot: Robot, model: mujoco.MjModel, qpos: np.ndarray, qvel: np.ndarray | None = None
) -> np.ndarray:
    data = mujoco.MjData(model)
    robot.mj_convention.set_state(data, qpos, np.zeros(robot.nv) if qvel is None else qvel)
    return full_state(model, data)


def test_sampler_reports_contacts_of_feet_above_and_in_the_ground() -> None:
    """The stand is moved 10 mm up and 2 mm down."""
    robot, stand = load(NAME), stand_of(NAME)
    drive = model_with_servos(robot)
    watcher = monitor.ContactSampler(robot, drive.model)
    ctrl = drive.command(robot, stand.joint_positions(robot))
    above, in_ground = stand.qpos.copy(), stand.qpos.copy()
    above[2] += 0.01
    in_ground[2] -= 0.002
    seen = watcher.sample(state_at(robot, drive.model, above), ctrl)
    assert seen.forces == {}
    assert seen.bodies == set()
    assert seen.unloaded_feet(robot.contact_points) == list(robot.contact_points)
    for foot, centre in monitor.foot_centres(robot, watcher.data).items():
        expected = stand.foot_targets[foot] + [0, 0, 0.01]
        np.testing.assert_allclose(centre, expected, atol=1e-9)
    seen = watcher.sample(state_at(robot, drive.model, in_ground), ctrl)
    assert set(seen.forces) == set(robot.contact_points)
    assert seen.unloaded_feet(robot.contact_points) == []
    assert watcher.find_ground_bodies(state_at(robot, drive.model, in_ground)) == set()


def test_a_robot_on_its_back_touches_with_its_base_and_has_fallen() -> None:
    """The base is turned by 180 deg about its x axis, 20 mm above the ground."""
    robot = load(NAME)
    drive = model_with_servos(robot)
    qpos = robot.neutral()
    qpos[2] = 0.02
    qpos[3:7] = quaternion(np.array([math.pi, 0.0, 0.0]))
    state = state_at(robot, drive.model, qpos)
    watcher = monitor.ContactSampler(robot, drive.model)
    assert "base_link" in watcher.find_ground_bodies(state)
    assert watcher.sample(state, np.zeros(robot.nu)).bodies == watcher.find_ground_bodies(state)
    assert monitor.base_tilt(robot, np.eye(3), state) == pytest.approx(math.pi)
    assert "tilt 180 deg, height 0.020 m" in str(monitor.describe_fall(math.pi, 0.02))


def test_states_after_a_divergence_are_evaluated_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """MuJoCo repeats the state of a divergence. Reference: a new sampler for each state."""
    robot, stand = load(NAME), stand_of(NAME)
    drive = model_with_servos(robot)
    ctrl = drive.command(robot, stand.joint_positions(robot))
    start = state_at(robot, drive.model, stand.qpos, np.full(robot.nv, 1e300))
    states = simulate_commands(drive.model, start, np.tile(ctrl, (20, 1)))
    assert monitor.has_diverged(states, float(drive.model.opt.timestep))
    assert len({state.tobytes() for state in states[-10:]}) == 1
    expected = monitor.ContactSampler(robot, drive.model).sample(states[-1], ctrl)
    evaluated: list[float] = []
    forward = mujoco.mj_forward

    def count(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        evaluated.append(data.time)
        forward(model, data)

    monkeypatch.setattr(mujoco, "mj_forward", count)
    sampler = monitor.ContactSampler(robot, drive.model)
    samples = [sampler.sample(state, ctrl) for state in states[-10:]]
    assert len(evaluated) == 1
    for sample in samples:
        assert sample.bodies == expected.bodies
        assert sample.forces.keys() == expected.forces.keys()
        for foot, force in expected.forces.items():
            np.testing.assert_array_equal(sample.forces[foot], force)


def test_sampler_evaluates_a_state_again_if_command_or_data_have_changed() -> None:
    """Reference: a new sampler. The torques follow the command, kp (ctrl - q)."""
    robot, stand = load(NAME), stand_of(NAME)
    drive = model_with_servos(robot)
    ctrl = drive.command(robot, stand.joint_positions(robot))
    state = state_at(robot, drive.model, stand.qpos)
    sampler = monitor.ContactSampler(robot, drive.model)
    dofs = robot.mj_convention.qvel_index[-robot.nu :]
    for command in (ctrl, ctrl + 0.01):
        sampler.sample(state, command)
        fresh = monitor.ContactSampler(robot, drive.model)
        fresh.sample(state, command)
        torques = sampler.data.qfrc_actuator[dofs]
        np.testing.assert_allclose(torques, fresh.data.qfrc_actuator[dofs])
    above = stand.qpos.copy()
    above[2] += 0.5
    sampler.find_ground_bodies(state_at(robot, drive.model, above))
    sampler.sample(state, ctrl + 0.01)
    assert sampler.data.qpos[2] == pytest.approx(state[3])


@pytest.mark.parametrize(
    ("leaning", "lost", "fallen"),
    [(0.0, 0.0, False), (0.49, 0.0, False), (0.51, 0.0, True), (0.0, 0.51, True), (0, 0.4, False)],
)
@pytest.mark.parametrize("under", [0.0, 0.3])
def test_fallen_is_leaning_too_far_or_too_low(
    leaning: float, lost: float, fallen: bool, under: float
) -> None:
    """Reference: tilt and height loss are set. `under` moves the stand and the state down alike, as
    for a base frame below the ground.
    """
    robot, stand = load(NAME), stand_of(NAME)
    there = stand.qpos.copy()
    upright = monitor.StandReference.from_configuration(robot, there)
    assert upright.com_height == pytest.approx(stand.qpos[2], rel=0.3)
    there[2] -= lost * upright.com_height
    there[3:7] = quaternion(np.array([leaning, 0.0, 0.0]))
    turned = rotation_from_quaternion(there[3:7])
    there[:3] += upright.com_offset - turned @ upright.com_offset  # about its centre of mass
    lowered = replace(upright, com_position=upright.com_position - [0, 0, under])
    there[2] -= under
    assert lowered.has_fallen(state_at(robot, robot.mj_model, there)) is fallen


@pytest.mark.parametrize(
    ("tilt", "lost", "touching", "stands"),
    [
        (0.0, 0.0, (), True),
        (0.17, 0.0, (), True),
        (0.18, 0.0, (), False),  # more than 10 deg
        (0.0, 0.29, (), True),
        (0.0, 0.31, (), False),  # more than ``MAX_HEIGHT_LOSS_RATIO`` of its height
        (0.0, -0.31, (), False),
        (0.0, 0.0, ("shank",), False),
    ],
)
def test_a_robot_stands_if_it_is_upright_at_its_height_and_only_its_feet_touch(
    tilt: float, lost: float, touching: tuple[str, ...], stands: bool
) -> None:
    """Reference: tilt and height are set, with the CoM above its place."""
    robot, stand = load(NAME), stand_of(NAME)
    upright, there = monitor.StandReference.from_configuration(robot, stand.qpos), stand.qpos.copy()
    there[2] -= lost * upright.com_height
    there[3:7] = quaternion(np.array([tilt, 0.0, 0.0]))
    turned = rotation_from_quaternion(there[3:7])
    there[:3] += upright.com_offset - turned @ upright.com_offset
    found = upright.check_stand(state_at(robot, robot.mj_model, there), touching)
    assert found.tilt == pytest.approx(tilt, abs=1e-7)
    assert found.height == pytest.approx((1 - lost) * found.expected_height)
    assert found.stands is stands


def test_tilt_excludes_yaw_and_rotation_angle_includes_it() -> None:
    """Reference: the angle of each rotation vector."""
    robot = load(NAME)
    qpos = robot.neutral()
    for vector, lean in (((0, 0, 0.7), 0.0), ((0.3, 0, 0), 0.3), ((0, -0.2, 0), 0.2)):
        qpos[3:7] = quaternion(np.array(vector, dtype=float))
        state = state_at(robot, robot.mj_model, qpos)
        assert monitor.base_tilt(robot, np.eye(3), state) == pytest.approx(lean, abs=1e-7)
        turn = float(np.linalg.norm(vector))
        assert monitor.rotation_angle(robot, np.eye(3), state) == pytest.approx(turn, abs=1e-9)


def test_diverged_rollout_is_detected() -> None:
    """A diverged rollout has a reset of the time, or a value that is not a number."""
    robot, stand = load(NAME), stand_of(NAME)
    drive = model_with_servos(robot)
    timestep = float(drive.model.opt.timestep)
    ctrl = np.tile(drive.command(robot, stand.joint_positions(robot)), (50, 1))
    states = simulate_commands(drive.model, state_at(robot, drive.model, stand.qpos), ctrl)
    assert not monitor.has_diverged(states, timestep)
    states[30:, 0] -= states[30, 0]  # MuJoCo resets the time
    assert monitor.has_diverged(states, timestep)
    states[30, 5] = np.nan
    assert monitor.has_diverged(states, timestep)


@pytest.mark.parametrize(
    ("leaning", "end", "away", "collapsed"),
    [
        (0.0, 0.2, 0.0, False),
        (0.45, 0.15, 0.19, False),
        (0.0, 0.139, 0.0, True),  # it lies on its shanks
        (0.0, 0.261, 0.0, True),  # it was thrown up
        (0.0, 0.2, 0.21, True),  # it slid away, or gravity is sideways
        (0.51, 0.2, 0.0, True),
        (math.nan, 0.2, 0.0, True),
        (0.0, math.nan, 0.0, True),
        (0.0, 0.2, math.nan, True),
    ],
)
def test_collapse_depends_on_tilt_height_and_displacement(
    leaning: float, end: float, away: float, collapsed: bool
) -> None:
    """Values on both sides of each limit, and values that are not numbers."""
    assert has_collapsed(leaning, 0.2 - end, away, 0.2) is collapsed


def test_contact_record_of_a_resting_robot_equals_the_record_of_every_state(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Contacts of equal states are computed once. The reference computes all of them.

    The robot rests for 6 s; for 40 ms before the last second, it is 10 mm above the ground. These
    feet carry load again in time, so a stand is not failed by them alone.
    """
    robot, stand = load(NAME), stand_of(NAME)
    drive = model_with_servos(robot)
    ctrl = drive.command(robot, stand.joint_positions(robot))
    timestep = float(drive.model.opt.timestep)
    qpos = stand.qpos.copy()
    qpos[2] -= 1e-3
    states = np.tile(state_at(robot, drive.model, qpos), (round(6 / timestep), 1))
    states[:, 0] = timestep * np.arange(1, len(states) + 1)
    lifted = (states[:, 0] > 3.0) & (states[:, 0] <= 3.04)
    states[lifted, 1 + robot.mj_convention.qpos_index[2]] += 0.01
    settling = round(5 / timestep)
    calls: list[float] = []
    sample = monitor.ContactSampler.sample

    def count(sampler: monitor.ContactSampler, state: np.ndarray, ctrl: np.ndarray) -> object:
        calls.append(float(state[0]))
        return sample(sampler, state, ctrl)

    monkeypatch.setattr(monitor.ContactSampler, "sample", count)
    loaded = set(robot.feet)
    record = monitor.record_contacts(robot, drive.model, stand, states, ctrl, settling, loaded)
    few = len(calls)
    monkeypatch.setattr(monitor, "_EQUAL_POSITION_ATOL", -1.0)
    every = monitor.record_contacts(robot, drive.model, stand, states, ctrl, settling, loaded)
    assert few < 60 < 290 < len(calls) - few
    assert [str(failure) for failure in record.failures] == [
        str(failure) for failure in every.failures
    ]
    assert {failure.code for failure in record.failures} == {"foot-idle"}
    for failure in record.failures:
        assert 3.0 < failure.values["time"].value <= 3.0 + 0.02 + timestep
    np.testing.assert_array_equal(record.torques, every.torques)
    for foot, force in every.forces.items():
        np.testing.assert_array_equal(record.forces[foot], force)
    # Servos without feed-forward release the robot, which may bounce before the last second.
    for shift, codes in ((0.0, set()), (1.5, {"foot-idle"})):
        moved = np.roll(states[:, 1:], round(shift / timestep), axis=0)
        released = monitor.record_contacts(
            robot,
            drive.model,
            stand,
            np.column_stack([states[:, 0], moved]),
            ctrl,
            settling,
            loaded,
            is_released=True,
        )
        assert {failure.code for failure in released.failures} == codes
    result = verify_stand(robot, stand, duration=2.0)
    assert result.passed
    for idle_late, stays in ((record.idle_late, True), (frozenset({next(iter(loaded))}), False)):
        late = replace(record, idle_late=idle_late)
        assert _stands_despite_idle_feet(robot, late, result, record.failures) is stays
    fallen = diagnose("fell-over", tilt=None, height=None, time=None)
    failures = (*record.failures, fallen)
    assert not _stands_despite_idle_feet(robot, record, result, failures)
    states[lifted, 1 + robot.mj_convention.qpos_index[2]] -= 0.01
    lifted = (states[:, 0] > 4.5) & (states[:, 0] <= 4.54)
    states[lifted, 1 + robot.mj_convention.qpos_index[2]] += 0.01
    record = monitor.record_contacts(robot, drive.model, stand, states, ctrl, settling, loaded)
    assert (every.idle_late, record.idle_late) == (frozenset(), frozenset(robot.feet))
