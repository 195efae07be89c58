"""Recording of planned stands on a simulated robot: rows equal the robot's state, and no fault
loses rows.
"""

from __future__ import annotations

import math
import os
import pty
import shutil
import sys
from array import array
from pathlib import Path
from subprocess import PIPE, Popen, run
from types import SimpleNamespace
from typing import Any, NamedTuple

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from pupper_analysis.base.errors import ConfigurationError, MeasurementError, OutputError
from pupper_analysis.pupper.variant_files import load_variant
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import list_position_servos
from pupper_analysis.robot.tool import find_place
from pupper_analysis.stance.stand import solve_stand, stand_statics
from pupper_analysis.stance.task import StandTask
from pupper_analysis.statics.support_polygon import com_margin
from pupper_analysis.tools.fit.measurements.stands import read_stands
from pupper_analysis.tools.fit.record import recorder
from pupper_analysis.tools.fit.record.bridge import open_bridge
from pupper_analysis.tools.fit.record.recorder import (
    MAX_JOINT_SPEED,
    Recording,
    _compute_com_margin,
    _RecordingEndedError,
    _RecordingSession,
    _StandSkippedError,
    record_stands,
)
from pupper_analysis.tools.fit.record.simulated import SimulatedRobot
from pupper_analysis.tools.fit.record.terminal import TypedBridge
from pupper_analysis.tools.fit.stands.plan import PlannedStand, StandPlan, write_plan
from tests.support.arm import arm

Array = NDArray[np.float64]


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_variant("v3")


@pytest.fixture(scope="module")
def plan(robot: Robot, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a plan of four stands on all feet, the last with 200 g on the base."""
    kp = np.array([list_position_servos(robot)[name][0] for name in robot.joint_names])
    stands = []
    for number, (height, roll, pitch) in enumerate(
        [(0.95, 0.0, 0.0), (0.7, 0.1, 0.0), (0.95, 0.0, -0.1), (0.7, -0.1, 0.0)]
    ):
        task = StandTask(height=height * robot.stand_height, roll=roll, pitch=pitch)
        stand = solve_stand(robot, task)
        command = stand.qpos[7:] + stand_statics(robot, stand).joint_torques / kp
        named = dict(zip(robot.joint_names, command.tolist(), strict=True))
        mass = 0.2 if number == 3 else 0.0
        turned = math.pi * (number % 2)
        stands.append(PlannedStand(f"s{number}", (), named, None, turned, mass))
    path = tmp_path_factory.mktemp("plan") / "plan.csv"
    place = find_place(robot, (0.0, 0.0, 0.05))
    write_plan(StandPlan("v3", tuple(stands), (), 4, place), path)
    return path


class SoundRecording(NamedTuple):
    """Recording of a robot without faults, which several tests read and none changes.

    Attributes:
        path: File of the recorded stands.
        simulated: Simulated robot after the recording.
        result: Result of the recording.
    """

    path: Path
    simulated: SimulatedRobot
    result: Recording


@pytest.fixture(scope="module")
def sound(robot: Robot, plan: Path, tmp_path_factory: pytest.TempPathFactory) -> SoundRecording:
    path, one = tmp_path_factory.mktemp("sound") / "stands.csv", SimulatedRobot(robot, 3)
    result = record_stands(robot, plan, path, one, one)
    assert result.complete
    return SoundRecording(path, one, result)


@pytest.mark.slow
def test_recorded_rows_equal_the_statics_of_the_robot_at_rest(
    robot: Robot, plan: Path, sound: SoundRecording, tmp_path: Path
) -> None:
    """Reference: virtual work of the perturbed robot's weight. Commands keep the speed limit."""
    path, one, found = Path(shutil.copy(sound.path, tmp_path)), sound.simulated, sound.result
    assert found.complete
    assert found.recorded_stands == ("s0", "s1", "s2", "s3")
    read, planned = read_stands(path).order_joints(robot), read_stands(plan)
    np.testing.assert_allclose(read.command, planned.command)
    np.testing.assert_allclose(read.heading, planned.heading)
    np.testing.assert_allclose(read.added["base_link"], planned.added["base_link"])
    # Servos carry it: virtual work of all joints, if it is let down on level feet, is its weight's.
    config = Configuration(one.robot, one.robot.make_qpos(read.position[0] - one.offset))
    feet = config.foot_twist_jacobians(tuple(robot.contact_points))[:, :3].reshape(-1, robot.nv)
    rates = np.linalg.lstsq(feet[:, 6:], feet[:, 2])[0]  # of joints, as the base comes down by 1
    torque = one.kp * (read.command - read.position)[0]
    way = np.concatenate([[0.0, 0.0, -1.0, 0.0, 0.0, 0.0], rates])
    assert torque @ rates == pytest.approx(config.gravity() @ way, rel=0.05)
    led = np.abs(np.diff(one.sent, axis=0)).max()
    assert led <= MAX_JOINT_SPEED * 0.02 * (1 + 1e-9)
    # The same command goes on with nothing, and writes nothing.
    before = path.read_bytes()
    again = SimulatedRobot(robot, 3)
    assert record_stands(robot, plan, path, again, again).recorded_stands == ()
    assert path.read_bytes() == before


@pytest.mark.parametrize(("roll", "pitch"), [(0.0, 0.25), (0.0, -0.25), (0.15, 0.1)])
def test_balance_margin_before_a_recording_is_that_of_the_tilted_stand(
    robot: Robot, roll: float, pitch: float
) -> None:
    """Compare the margin [m] by the joint angles alone with that of the solved stand on level
    ground.
    """
    task = StandTask(roll=roll, pitch=pitch, offset=(0.03, 0.01))
    stand = solve_stand(robot, task)
    there = Configuration(robot, stand.qpos)
    places = dict(zip(robot.contact_points, there.foot_centres(robot.contact_points), strict=True))
    expected = com_margin(there.center_of_mass(), places)
    level = Configuration(robot, robot.make_qpos(stand.qpos[7:]))
    assert np.ptp(level.foot_centres(robot.contact_points)[:, 2]) > 0.02  # as the base sees them
    assert _compute_com_margin(robot, stand.qpos[7:], ()) == pytest.approx(expected, abs=1e-9)


class Reversed:
    """Bridge of a robot whose first joint moves against its command; its other joints follow."""

    ramps = True

    def __init__(self, robot: Robot) -> None:
        self._first = robot.joint_names[0]
        self._position = self.command = np.zeros(robot.nu)
        self._time = 0.0
        self.lifted = False

    def read(self) -> tuple[float, Array]:
        return self._time, self._position

    def send(self, command: Array) -> None:
        self.command = command
        self._position = command * np.where(np.arange(len(command)) == 0, -0.7, 1.0)

    def wait(self, seconds: float) -> None:
        self._time += seconds

    def now(self) -> float:
        return self._time

    def close(self) -> None:
        pass


def take_stand_at(robot: Robot, bridge: Reversed, angle: float) -> _RecordingSession:
    """Take a stand with all joints at an angle [rad] from zero, after three recorded stands."""

    def lift(*_: Any) -> bool:
        bridge.lifted = True
        bridge.send(bridge.command)
        return True

    person = SimpleNamespace(stops=lambda: False, prepare=lift, feet_up=lambda *_: ())
    session = _RecordingSession(robot, bridge, person)  # type: ignore[arg-type]
    bridge.send(np.zeros(robot.nu))
    session._command = np.zeros(robot.nu)
    named = dict.fromkeys(robot.joint_names, angle)
    session.take_stand(PlannedStand("s0", (), named, None), {}, [], 3)
    return session


def test_joint_that_moves_against_its_command_ends_the_recording(robot: Robot) -> None:
    """The first joint moves backwards, by 0.7 of its command."""
    with pytest.raises(
        _RecordingEndedError, match=f"{robot.joint_names[0]} deviates by 26.3 deg from its"
    ) as caught:
        take_stand_at(robot, Reversed(robot), 0.27)
    assert math.degrees(1.7 * 0.27) == pytest.approx(26.3, abs=0.05)
    assert caught.value.rows == 0  # no recorded row is reliable


class Planted(Reversed):
    """Bridge of a robot whose first joint is held by its foot on the ground until it is lifted."""

    def send(self, command: Array) -> None:
        self.command = command
        held = np.where(np.arange(len(command)) == 0, 1.0 if self.lifted else 0.1, 1.0)
        self._position = command * held


def test_joint_that_the_ground_holds_counts_as_following_once_it_is_lifted(robot: Robot) -> None:
    session = take_stand_at(robot, Planted(robot), 0.27)
    assert session._last_live_rows.tolist() == [3] * robot.nu


class Sluggish(Planted):
    """Bridge of a robot whose first joint moves by a fraction of its command, even if lifted."""

    ratio = 1.0

    def send(self, command: Array) -> None:
        self.command = command
        self._position = command * np.where(np.arange(len(command)) == 0, self.ratio, 1.0)


@pytest.mark.parametrize(("ratio", "rows"), [(0.2, None), (0.3, 0), (0.55, 0), (0.65, 3)])
def test_servo_follows_from_a_quarter_and_works_from_six_tenths_of_its_command(
    robot: Robot, ratio: float, rows: int | None
) -> None:
    """A servo that certainly worked makes the rows so far reliable; None: the recording ends."""
    bridge = Sluggish(robot)
    bridge.ratio = ratio
    if rows is None:
        with pytest.raises(_RecordingEndedError, match=robot.joint_names[0]):
            take_stand_at(robot, bridge, 0.27)
    else:
        session = take_stand_at(robot, bridge, 0.27)
        assert session._last_live_rows.tolist() == [rows] + [3] * (robot.nu - 1)


def make_session(robot: Robot, bridge: Reversed) -> _RecordingSession:
    """Return a recording at zero angles, with a person who never stops."""
    person = SimpleNamespace(stops=lambda: False)
    session = _RecordingSession(robot, bridge, person)  # type: ignore[arg-type]
    session._command = np.zeros(robot.nu)
    return session


@pytest.mark.parametrize("error", [-0.6, 0.6])
def test_tracking_error_of_either_sign_ends_the_recording(robot: Robot, error: float) -> None:
    bridge = Sluggish(robot)
    bridge.send(np.full(robot.nu, error))
    stand = PlannedStand("s0", (), {}, None)
    with pytest.raises(_RecordingEndedError, match="s0"):
        make_session(robot, bridge)._check_tracking(stand)
    bridge.send(np.full(robot.nu, error / 10))
    make_session(robot, bridge)._check_tracking(stand)


def test_positions_that_are_not_finite_are_lost(robot: Robot) -> None:
    bridge = Sluggish(robot)
    bridge._position = np.full(robot.nu, np.nan)
    with pytest.raises(_RecordingEndedError) as caught:
        make_session(robot, bridge)._read_positions(PlannedStand("s0", (), {}, None))
    assert caught.value.finding.code == "positions-lost"


def test_approaches_of_a_stand_keep_the_joint_limits(robot: Robot) -> None:
    """The plan commands the upper limits; 1.3 times the lead of 0.1 rad would exceed the limits."""
    bridge, sent = Sluggish(robot), list[Array]()
    session = make_session(robot, bridge)
    move = bridge.send
    bridge.send = lambda command: (sent.append(command.copy()), move(command))[1]  # type: ignore[method-assign]
    target = np.full(robot.nu, 0.2)
    limits = SimpleNamespace(
        nu=robot.nu, joint_names=robot.joint_names, lower_limits=-target, upper_limits=target
    )
    session._robot = limits  # type: ignore[assignment]
    stand = PlannedStand("s0", (), {}, None)
    session._average_from_both_sides(stand, target, target - 0.1)
    assert np.max(sent) == pytest.approx(0.2)
    session._average_from_both_sides(stand, -target, 0.1 - target)
    assert np.min(sent) == pytest.approx(-0.2)


def test_commands_are_ramped_at_half_a_radian_per_second(robot: Robot) -> None:
    """By hand: the fastest joint travels 0.3 rad, which takes 0.6 s, or 30 intervals of 20 ms. A
    slow ramp of 2 s takes 100 intervals."""
    bridge, sent = Sluggish(robot), list[Array]()
    session = make_session(robot, bridge)
    move = bridge.send
    bridge.send = lambda command: (sent.append(command.copy()), move(command))[1]  # type: ignore[method-assign]
    target = np.full(robot.nu, 0.1)
    target[2] = -0.3
    stand = PlannedStand("s0", (), {}, None)
    session._move_command(stand, target)
    assert len(sent) == 30
    assert bridge.now() == pytest.approx(0.6)
    expected = np.linspace(1 / 30, 1.0, 30)[:, None] * target
    np.testing.assert_allclose(sent, expected, atol=1e-12)
    session._move_command(stand, np.zeros(robot.nu), 2.0)
    assert len(sent) == 130
    assert bridge.now() == pytest.approx(2.6)


def test_robot_holds_its_last_command_after_a_recording(robot: Robot) -> None:
    bridge, sent = Sluggish(robot), list[Array]()
    bridge.send = sent.append  # type: ignore[method-assign]
    person = SimpleNamespace(stops=lambda: False)
    session = _RecordingSession(robot, bridge, person)  # type: ignore[arg-type]
    session.hold_position()
    assert not sent  # no ramp has begun
    session._command = np.full(robot.nu, 0.3)
    session.hold_position()
    np.testing.assert_array_equal(sent, [session._command])


def test_friction_angle_is_the_median_of_absolute_half_differences(robot: Robot) -> None:
    """By hand: of -3, 1 and 2 mrad the absolute values have the median 2 mrad."""
    session = make_session(robot, Sluggish(robot))
    session._half_differences = [np.full(robot.nu, 1e-3 * value) for value in (-3, 1, 2)]
    assert set(session.compute_friction_angles(3).values()) == {2e-3}


def test_row_is_appended_in_a_new_line_and_withdrawn_to_the_byte(
    plan: Path, tmp_path: Path
) -> None:
    """The last line of the file has no line end, as after an editor."""
    planned, path = read_stands(plan), tmp_path / "stands.csv"
    position = planned.command[0]
    assert recorder._append_row(path, planned, 0, position, ()) == 0
    first = path.read_bytes()
    path.write_bytes(first.rstrip(b"\n"))
    size = recorder._append_row(path, planned, 1, position, ())
    assert size == len(first)
    assert read_stands(path).names == ("s0", "s1")
    recorder._truncate_file(path, size)
    assert path.read_bytes() == first


@pytest.mark.parametrize(("share", "refused"), [(0.019, True), (0.021, False)])
def test_plan_with_a_com_margin_below_two_percent_of_the_height_is_refused(
    robot: Robot, plan: Path, monkeypatch: pytest.MonkeyPatch, share: float, refused: bool
) -> None:
    margin = share * robot.stand_height
    monkeypatch.setattr(recorder, "_compute_com_margin", lambda *_: margin)
    planned = read_stands(plan)
    if refused:
        with pytest.raises(
            MeasurementError, match="s0: no command was sent, because the robot might fall"
        ):
            list(recorder._check_plan(robot, planned))
    else:
        assert list(recorder._check_plan(robot, planned)) == [margin] * 4


class Sticky(Reversed):
    """Bridge of joints that dry friction holds within a band about the positions without friction.

    The positions without friction are those of the command minus a lead of 0.1 rad.
    """

    band = np.linspace(0.001, 0.012, 12)

    def __init__(self, robot: Robot) -> None:
        super().__init__(robot)
        self._position = np.full(robot.nu, 0.2)

    def send(self, command: Array) -> None:
        free = command - 0.1
        self._position = np.clip(self._position, free - self.band, free + self.band)


@pytest.mark.parametrize("start", [0.2, 0.4])
def test_stand_is_approached_from_both_sides_so_that_friction_cancels(
    robot: Robot, start: float
) -> None:
    """Closed form: the mean is the position without friction, half the difference the band.

    A single reading is off by the band, with the sign of the last motion.
    """
    bridge = Sticky(robot)
    person = SimpleNamespace(
        stops=lambda: False, prepare=lambda *_: True, feet_up=lambda _, swing: swing
    )
    session = _RecordingSession(robot, bridge, person)  # type: ignore[arg-type]
    session._command = np.full(robot.nu, start)
    bridge.send(session._command)
    target = np.full(robot.nu, 0.3)
    named = dict(zip(robot.joint_names, target.tolist(), strict=True))
    session._ramp_commands(PlannedStand("s0", (), named, None), target)
    single = bridge.read()[1] - 0.2
    np.testing.assert_allclose(np.abs(single), bridge.band, atol=1e-12)
    position, _ = session.take_stand(PlannedStand("s1", (), named, None), {}, (), 0)
    np.testing.assert_allclose(position, 0.2, atol=1e-12)
    angles = session.compute_friction_angles(1)
    np.testing.assert_allclose(list(angles.values()), bridge.band, atol=1e-12)
    assert session.compute_friction_angles(0) == {}


@pytest.mark.parametrize(
    ("height", "turn", "reason"),
    [
        (1.0, (1, 0, 0, 0), "no foot carries load, but three feet are required"),
        (0.06, (0, 1, 0, 0), "base_link touches the ground"),
        (None, (1, 0, 0, 0), "only FR and FL carry load, but three feet are required"),
    ],
)
def test_skipped_stand_names_the_part_that_touches_or_the_feet_that_carry(
    robot: Robot, height: float | None, turn: tuple[int, ...], reason: str
) -> None:
    """Reference: poses of the base in the air, upside down, and pitched onto the front feet."""
    one = SimulatedRobot(robot, 3)
    qpos = one._data.qpos
    qpos[3:7] = turn
    if height is not None:
        qpos[2] = height
    else:
        qpos[3:7] = math.cos(0.05), 0, math.sin(0.05), 0
        mujoco.mj_kinematics(one._drive.model, one._data)
        front = [geom for geom, foot in one._loaded.foot_geoms.items() if foot in ("FR", "FL")]
        bottoms = one._data.geom_xpos[front, 2] - one._drive.model.geom_size[front, 0]
        qpos[2] -= bottoms.max() + 1e-4
    mujoco.mj_forward(one._drive.model, one._data)
    found = one.feet_up(tuple(robot.feet), ())
    assert str(found) == reason
    bridge = Reversed(robot)
    bridge.ramps = False
    person = SimpleNamespace(prepare=lambda *_: True, feet_up=lambda *_: found)
    session = _RecordingSession(robot, bridge, person)  # type: ignore[arg-type]
    named = dict.fromkeys(robot.joint_names, 0.0)
    with pytest.raises(_StandSkippedError) as caught:
        session.take_stand(PlannedStand("s0", (), named, None), {}, (), 0)
    assert str(caught.value.finding) == f"stand s0 was skipped: {reason}"


def test_foot_that_touches_another_leg_is_no_foot_on_the_ground() -> None:
    """Reference: the bodies of contacts in bare MuJoCo, with the robot 1 m above the ground.

    The normal force of such contacts counted as the ground's load on a foot. (The feet of v3 touch
    no other part, by ``contype``.)
    """
    robot = load_variant("original")
    one, random = SimulatedRobot(robot, 3), np.random.default_rng(0)
    model, data = one._drive.model, one._data
    data.qpos[2] = 1.0
    while not data.ncon:
        data.qpos[one._loaded.mj_convention.qpos_index[7:]] = random.uniform(-2, 2, robot.nu)
        mujoco.mj_forward(model, data)
    bodies = [model.body(model.geom_bodyid[geom]).name for geom in data.contact[0].geom]
    assert any(int(geom) in one._loaded.foot_geoms for geom in data.contact[0].geom)
    found = one.feet_up(tuple(robot.feet), ())
    assert str(found) == f"{bodies[0]} touches {bodies[1]}"


@pytest.mark.parametrize("timestep", [0.002, 0.003, 0.007])
def test_clock_of_a_simulated_robot_is_that_of_the_simulation(
    robot: Robot, timestep: float
) -> None:
    """Reference: MuJoCo's own time. With 3 ms steps, 0.020 s counted for 0.021 s."""
    one = SimulatedRobot(robot, 3)
    one._drive.model.opt.timestep = timestep
    for _ in range(200):
        one.wait(0.02)
        assert one.now() == pytest.approx(one._data.time, abs=timestep / 2 + 1e-9)
    assert one.now() == pytest.approx(4.0)


class Faulty(SimulatedRobot):
    """Simulated robot with faults at given times [s]: a servo that stops following or has no
    torque, lost messages, a push, and a pressed key.
    """

    stuck = off = key = slip = math.inf
    lost = (math.inf, math.inf)
    last: tuple[float, Array] | None = None

    def read(self) -> tuple[float, Array]:
        if self.last is None or not self.lost[0] <= self.now() < self.lost[1]:
            self.last = super().read()
        return self.last

    def send(self, command: Array) -> None:
        obeyed = command.copy()
        if self.sent and self.now() >= self.stuck:
            obeyed[5] = self.sent[-1][5]
        super().send(obeyed)

    def wait(self, seconds: float) -> None:
        before = self.now()
        if before >= self.off:
            at = self._loaded.mj_convention.actuator_index[5]
            self._drive.model.actuator_gainprm[at] = self._drive.model.actuator_biasprm[at] = 0.0
        super().wait(seconds)
        if before < self.slip <= self.now():
            self._data.qvel[self._loaded.mj_convention.qvel_index[0]] += 0.2  # m/s

    def stops(self) -> bool:
        return self.now() >= self.key


STOPPED = ["servo-does-not-follow", "rows-withdrawn"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "codes", "taken"),
    [
        ({"stuck": 4.0}, STOPPED, 0),
        ({"off": 12.0}, STOPPED, 1),
        ({"lost": (21.0, math.inf)}, ["positions-lost"], 2),
        ({"key": 21.0}, ["recording-stopped"], 2),
    ],
)
def test_recording_holds_on_a_fault_and_resumes_later(
    robot: Robot,
    plan: Path,
    sound: SoundRecording,
    tmp_path: Path,
    fault: dict[str, Any],
    codes: list[str],
    taken: int,
) -> None:
    """Rows that are of a servo which may have stopped before it was seen are taken again."""
    path, one = tmp_path / "stands.csv", Faulty(robot, 3)
    vars(one).update(fault)
    found = record_stands(robot, plan, path, one, one)
    assert not found.complete
    assert [finding.code for finding in found.findings] == codes
    assert len(found.recorded_stands) == taken
    rows = path.read_text().splitlines() if path.exists() else []
    assert len(rows) == (1 + taken if taken else 0)
    # What was commanded last is commanded again, and nothing else.
    np.testing.assert_array_equal(one.sent[-1], one.sent[-2])
    sound_robot = SimulatedRobot(robot, 3)
    later = record_stands(robot, plan, path, sound_robot, sound_robot)
    assert later.existing_stands == found.recorded_stands
    assert later.recorded_stands == found.missing_stands
    assert later.complete
    assert path.read_text().splitlines()[: len(rows)] == rows
    read = dict(zip(read_stands(path).names, read_stands(path).position, strict=True))
    undisturbed = read_stands(sound.path).position
    assert max(np.abs(read[f"s{at}"] - undisturbed[at]).max() for at in range(4)) < 0.02


HELD = """import os, signal, sys
from pathlib import Path
from pupper_analysis.base.locks import lock_file
with lock_file(Path(sys.argv[1]), temporary=True) as locked:
    print(locked, flush=True)
    sys.argv[2:] and os.kill(os.getpid(), signal.SIGKILL)
    sys.stdin.read()"""


@pytest.mark.slow
def test_second_recording_into_one_file_is_refused_before_motion(
    robot: Robot, plan: Path, tmp_path: Path
) -> None:
    """In this process, and while another process holds the lock; not after that is killed."""
    path, link = tmp_path / "new" / "stands.csv", tmp_path / "link.csv"
    link.symlink_to(path)
    refusals: list[str] = []

    class Second(SimulatedRobot):
        def prepare(self, *given: Any) -> bool:
            other = SimulatedRobot(robot, 3)
            sent = len(other.sent)
            with pytest.raises(OutputError, match="another recording") as caught:
                record_stands(robot, plan, link, other, other)
            assert len(other.sent) == sent
            refusals.append(str(caught.value))
            return super().prepare(*given)

    one = Second(robot, 3)
    assert record_stands(robot, plan, path, one, one).complete
    assert len(refusals) == 4
    assert read_stands(path).names == ("s0", "s1", "s2", "s3")
    assert [file.name for file in path.parent.iterdir()] == [path.name]

    lock = path.parent / f".{path.name}.lock"
    with Popen([sys.executable, "-c", HELD, str(lock)], stdin=PIPE, stdout=PIPE, text=True) as held:
        assert held.stdout is not None
        assert held.stdout.readline() == "True\n"
        with pytest.raises(OutputError, match="another recording"):
            record_stands(robot, plan, path, one, one)
        held.communicate("")
    assert not lock.exists()
    run([sys.executable, "-c", HELD, str(lock), "kill"], check=False)
    assert lock.exists()
    assert len(record_stands(robot, plan, path, one, one).existing_stands) == 4
    assert not lock.exists()


@pytest.mark.slow
def test_recording_waits_for_a_late_message(robot: Robot, plan: Path, tmp_path: Path) -> None:
    one = Faulty(robot, 3)
    one.lost = 8.0, 8.2
    assert record_stands(robot, plan, tmp_path / "stands.csv", one, one).complete


@pytest.mark.slow
def test_recording_waits_for_rest_after_a_slip(
    robot: Robot, plan: Path, sound: SoundRecording, tmp_path: Path
) -> None:
    """A push of 4 cm/s during averaging would displace joints by 10 mrad after 0.2 s."""
    one = Faulty(robot, 3)
    one.slip = 1.6
    assert record_stands(robot, plan, tmp_path / "slips", one, one).complete
    assert one.now() > sound.simulated.now() + 0.5  # it was waited for
    difference = read_stands(tmp_path / "slips").position - read_stands(sound.path).position
    assert np.abs(difference).max() < 0.02


def test_a_person_at_a_terminal_types_positions_and_any_key_stops(
    robot: Robot, plan: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Through a pseudo-terminal: three stands are typed, the second is left out."""
    ours, theirs = pty.openpty()
    terminal = os.fdopen(theirs, "r")
    monkeypatch.setattr(sys, "stdin", terminal)
    typed = [f"{0.5 * joint:.2f}" for joint in range(robot.nu)]
    lines = ["", *typed, "FR", "s", "", *typed, "nose", "none", "", *typed, "s"]
    os.write(ours, ("\n".join(lines) + "\n").encode())
    bridge, person = open_bridge("typed", robot)
    found = record_stands(robot, plan, tmp_path / "stands.csv", bridge, person)
    assert found.recorded_stands == ("s0", "s2")
    assert [str(finding) for finding in found.findings] == [
        "stand s1 was skipped by the operator",
        "stand s3 was skipped by the operator",
    ]
    read = read_stands(tmp_path / "stands.csv").order_joints(robot)
    np.testing.assert_allclose(
        read.position, np.radians([[0.5 * n for n in range(12)]] * 2), atol=1e-6
    )
    assert read.swing == (("FR",), ())
    assert not person.stops()
    os.write(ours, b"x")  # no Enter
    assert person.stops()
    assert not person.stops()
    terminal.close()
    os.close(ours)


def test_positions_of_a_slide_are_typed_and_printed_in_millimetres(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The arm has a slide, b_slide; all typed values are 90, in degrees for the hinges."""
    prompts: list[str] = []

    def answer(prompt: str, **_: object) -> float:
        prompts.append(prompt)
        return 90.0

    monkeypatch.setattr("click.prompt", answer)
    robot = arm()
    bridge = TypedBridge(robot)
    _, positions = bridge.read()
    is_slide = np.array([name == "b_slide" for name in robot.joint_names])
    np.testing.assert_allclose(positions, np.where(is_slide, 0.09, math.pi / 2))
    assert [("(mm)" in prompt) for prompt in prompts] == is_slide.tolist()
    bridge.send(positions)
    assert "command b_slide 90.000 mm" in capsys.readouterr().err


def test_invalid_plan_is_refused_before_any_command(
    robot: Robot, plan: Path, tmp_path: Path
) -> None:
    one = SimulatedRobot(robot, 3)
    sent, text, other = len(one.sent), plan.read_text(), tmp_path / "other.csv"
    header, first, *rest = text.splitlines()
    at = header.split(",").index("command.leg_front_r_1")
    cells = first.split(",")
    cells[at] = "3.5"
    other.write_text("\n".join([header, ",".join(cells), *rest]) + "\n")
    with pytest.raises(MeasurementError, match=r"s0: the reading .* of leg_front_r_1"):
        record_stands(robot, other, tmp_path / "stands.csv", one, one)
    cells[at] = ""
    other.write_text("\n".join([header, ",".join(cells), *rest]) + "\n")
    with pytest.raises(MeasurementError, match=r"s0: the reading .* of leg_front_r_1"):
        record_stands(robot, other, tmp_path / "stands.csv", one, one)
    cells = first.split(",")
    cells[1] = "FR FL"  # on two feet
    other.write_text("\n".join([header, ",".join(cells), *rest]) + "\n")
    with pytest.raises(
        MeasurementError, match="s0: no command was sent, because the robot might fall"
    ):
        record_stands(robot, other, tmp_path / "stands.csv", one, one)
    with pytest.raises(ConfigurationError, match="another file"):
        record_stands(robot, plan, plan, one, one)
    other.write_text(text.replace("s1,", "t1,").replace("position", "position"))
    with pytest.raises(MeasurementError, match="stand t1"):
        record_stands(robot, plan, other, one, one)
    closed: list[str] = []
    one.close = lambda: closed.append("closed")  # type: ignore[method-assign]
    with pytest.raises(MeasurementError, match="absent"):
        record_stands(robot, tmp_path / "absent.csv", other, one, one)
    assert closed == ["closed"]
    assert len(one.sent) == sent


def test_bridge_is_selected_by_its_name_and_options(robot: Robot) -> None:
    bridge, person = open_bridge("mujoco:5;kp=7", robot)
    assert bridge is person
    # Relative to the given kp (not the 5 N m/rad of the file): 7 % deviation, and 7 % in common.
    assert isinstance(bridge, SimulatedRobot)
    assert np.exp(np.log(bridge.kp).mean()) == pytest.approx(7.0, rel=0.2)
    with pytest.raises(ConfigurationError, match="available: mujoco, ros2, typed"):
        open_bridge("smoke", robot)
    with pytest.raises(ConfigurationError, match="SEED"):
        open_bridge("mujoco:five", robot)
    with pytest.raises(ConfigurationError, match="kp=five"):
        open_bridge("mujoco:5;kp=five", robot)
    # The bridge's argument is valid: the refusal names the fixed base.
    with pytest.raises(ConfigurationError, match="fixed base and cannot stand"):
        open_bridge("mujoco:5", load_variant("v3", fixed_base=True))


# ------------------------------- ROS 2: a stub whose messages have the fields of the real ones


class JointState(SimpleNamespace):
    """``sensor_msgs/JointState``: effort and velocity, which may be empty, are not read."""


class Float64MultiArray:
    """``std_msgs/Float64MultiArray``: as in rclpy, its data accept only floats."""

    __slots__ = ("_data", "layout")

    @property
    def data(self) -> array[float]:
        return self._data

    @data.setter
    def data(self, values: list[float]) -> None:
        assert all(isinstance(value, float) for value in values)
        self._data = array("d", values)


class Stub:
    """Replacement of ``rclpy``: a node with one subscription and one publisher, whose messages the
    test delivers.
    """

    def __init__(self) -> None:
        self.waiting: list[Any] = []
        self.published: list[tuple[str, list[float]]] = []
        self.topic, self.hear, self.begun, self.listeners = "", lambda _: None, False, 1

    qos = SimpleNamespace(qos_profile_sensor_data="best effort")
    signals = SimpleNamespace(SignalHandlerOptions=SimpleNamespace(NO="none"))

    def ok(self) -> bool:
        return self.begun

    def init(self, signal_handler_options: str) -> None:
        assert signal_handler_options == "none"  # Ctrl-C is ours, and the robot is held after it
        self.begun = True

    def create_node(self, _: str) -> Stub:
        return self

    def create_subscription(self, kind: type, topic: str, hear: Any, quality: str) -> None:
        assert quality == "best effort"
        self.topic, self.hear = topic, hear

    def create_publisher(self, kind: type, topic: str, depth: int) -> Any:
        return SimpleNamespace(
            publish=lambda message: self.published.append((topic, list(message.data))),
            get_subscription_count=lambda: self.listeners,
        )

    def spin_once(self, node: Any, timeout_sec: float) -> None:
        if self.waiting:
            self.hear(self.waiting.pop(0))

    def destroy_node(self) -> None:
        self.begun = False


def test_topics_have_joints_by_name_and_commands_in_the_controllers_order(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A stub of `rclpy` with hand-made messages; joint states arrive in two parts with an unknown
    joint.
    """
    ros, names = Stub(), robot.joint_names
    monkeypatch.setattr("pupper_analysis.tools.fit.record.ros._DISCOVERY_TIMEOUT", 1.0)
    for name, module in (
        ("rclpy", ros),
        ("rclpy.qos", ros.qos),
        ("rclpy.signals", ros.signals),
        ("sensor_msgs.msg", SimpleNamespace(JointState=JointState)),
        ("std_msgs.msg", SimpleNamespace(Float64MultiArray=Float64MultiArray)),
    ):
        monkeypatch.setitem(sys.modules, name, module)
    order = ",".join(reversed(names))
    words, half = f"ros2:state=/state;command=/command;order={order}", len(names) // 2
    parts = []
    for part in (names[half:], names[:half]):  # a joint that is of no interest among them
        values = array("d", [9.0, *(0.1 * names.index(name) for name in part)])
        parts.append(JointState(name=["gripper", *part], position=values))
    ros.waiting = parts[:1]
    with pytest.raises(ConfigurationError, match=f"no positions of {names[0]}, .* on /state"):
        open_bridge(words, robot)
    ros.waiting, ros.listeners = parts[:], 0
    with pytest.raises(ConfigurationError, match="no node subscribes to /command"):
        open_bridge(words, robot)
    ros.waiting, ros.listeners = parts[:], 1
    one, _ = open_bridge(words, robot)
    assert ros.topic == "/state"
    at, read = one.read()
    np.testing.assert_allclose(read, 0.1 * np.arange(len(names)))
    assert one.now() - at < 5.0
    one.send(np.arange(len(names), dtype=float))
    assert ros.published == [("/command", [float(n) for n in reversed(range(len(names)))])]
    one.close()
    with pytest.raises(ConfigurationError, match="elbow"):
        open_bridge(f"ros2:order=elbow,{','.join(names[1:])}", robot)
    with pytest.raises(ConfigurationError, match=f"robot differ: {names[0]}$"):
        open_bridge(f"ros2:order={names[0]},{','.join(names)}", robot)
    with pytest.raises(ConfigurationError, match="topic=/x"):
        open_bridge("ros2:topic=/x", robot)
