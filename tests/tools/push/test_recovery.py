"""Pushes, compared with a plain MuJoCo loop of the test, with mechanics, and with symmetry."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.models.motors.reading import find_motor
from pupper_analysis.robot.servos import model_with_servos
from pupper_analysis.simulation.rollout import place_on_ground
from pupper_analysis.tools.push import recovery as push
from pupper_analysis.tools.push.bench import make_push_bench
from pupper_analysis.tools.push.document import push_document
from pupper_analysis.tools.push.recovery import PushRecovery, push_recovery, tipping_impulses
from tests.present.test_printed import print_words
from tests.support.engines import change_model, evaluate_mujoco, with_efforts
from tests.support.legged import quadruped
from tests.support.variants import load, stand_of

COARSE = {"directions": 4, "duration": 3.0, "resolution": 0.05}


@cache
def push_variant(name: str) -> PushRecovery:
    return push_recovery(load(name), stand_of(name), **COARSE)  # type: ignore[arg-type]


def plain_push(name: str, angle: float, impulse: float, duration: float) -> bool:
    """Return whether the robot stands after a push [N s], by a plain MuJoCo loop and its last
    state.
    """
    return simulate_plainly(name, stand_of(name), angle, impulse, duration)[0]


def simulate_plainly(
    name: str, stand: pa.Stand, angle: float, impulse: float, duration: float
) -> tuple[bool, np.ndarray, np.ndarray]:
    """Push a robot in a plain MuJoCo loop.

    Return whether the robot stands at the end, and torques and speeds of the joints after each
    step.
    """
    robot = load(name)
    drive, model = model_with_servos(robot), robot.description.mjcf.copy().compile()
    torques = pa.gravity_compensation(
        pa.Configuration(robot, stand.qpos),
        distribution=pa.statics.ForceDistribution.MIN_TANGENTIAL,
    ).joint_torques
    data = mujoco.MjData(model)
    start = place_on_ground(robot, drive, stand, torques)
    mujoco.mj_setState(model, data, start, mujoco.mjtState.mjSTATE_FULLPHYSICS.value)
    data.ctrl[:] = stand.qpos[7:] + torques / drive.kp
    fell, torques, speeds = False, [], []
    while data.time < duration - model.opt.timestep / 2:
        on = data.time < 0.02 - model.opt.timestep / 2
        data.xfrc_applied[1, :2] = (
            on * impulse / 0.02 * np.array([math.cos(angle), math.sin(angle)])
        )
        mujoco.mj_step(model, data)
        mujoco.mj_forward(model, data)
        torques.append(data.qfrc_actuator[6:].copy())
        speeds.append(data.qvel[6:].copy())
        for first, second in data.contact.geom:
            pair = {model.geom(first).type[0], model.geom(second).type[0]}
            fell |= pair not in ({mujoco.mjtGeom.mjGEOM_PLANE, mujoco.mjtGeom.mjGEOM_SPHERE},)
    stands = not fell and data.xmat[1, 8] > 0.9 and float(np.abs(data.qvel[:6]).max()) < 0.05
    return stands, np.array(torques), np.array(speeds)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "index"), [("original", 0), ("original", 1), ("v3", 2)])
def test_push_limit_equals_that_of_a_plain_mujoco_loop(name: str, index: int) -> None:
    """98 % of the impulse [N s] is survived; the impulse plus 1.02 resolutions is not."""
    result = push_variant(name)
    angle, impulse = result.directions[index], result.impulses[index]
    assert plain_push(name, angle, 0.0, 3.0)
    assert plain_push(name, angle, 0.98 * impulse, 3.0)
    assert not plain_push(name, angle, impulse + 1.02 * result.resolution, 3.0)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["original", "v3"])
def test_stiff_robot_on_grippy_floor_tips_as_estimated(name: str) -> None:
    """The limit goes to the closed form of a rigid body that rolls over two feet."""

    def grip(model: mujoco.MjModel) -> None:
        model.geom_friction[:, 0] = 3.0
        model.geom_condim[:] = 3  # no rolling friction

    result = push_recovery(
        with_efforts(change_model(load(name), grip), 500),
        stand_of(name),
        kp=1000,
        kd=10,
        integrator="implicitfast",
        **COARSE,  # type: ignore[arg-type]
    )
    np.testing.assert_allclose(result.impulses / result.tipping_estimate, 1.03, atol=0.05)


@pytest.mark.slow
def test_push_directions_are_relative_to_the_base_and_numbers_follow_from_impulses() -> None:
    """References: axes of a base that is yawed by 0.2 rad; impulse / mass; smallest impulse."""
    robot = load("original")
    stand = pa.solve_stand(robot, pa.StandTask(yaw=0.2))
    found = push_recovery(robot, stand, **{**COARSE, "resolution": 0.3})  # type: ignore[arg-type]
    np.testing.assert_allclose(found.directions, np.radians([0, 90, 180, 270]))
    world = found.directions + 0.2
    axes = np.column_stack([np.cos(world), np.sin(world)])
    estimate = tipping_impulses(pa.Configuration(robot, stand.qpos), found.point, axes)
    np.testing.assert_allclose(found.tipping_estimate, estimate, rtol=1e-9)
    assert (found.impulses > 1.0).all()
    assert (found.bisected_impulses >= found.impulses).all()
    np.testing.assert_allclose(found.velocity_steps, found.impulses / robot.total_mass)
    weakest = int(np.argmin(found.impulses))
    assert found.weakest_impulse == found.impulses[weakest]
    assert found.weakest_direction == found.directions[weakest]
    assert found.weakest_failure == found.failures[weakest]
    assert (found.pulse, found.duration) == pytest.approx((0.02, 3.0))


def test_estimate_has_the_inertia_of_all_bodies_about_the_hinge() -> None:
    """Reference: MuJoCo's bodies and the parallel axis theorem, about the line between two feet."""
    robot, stand = load("heavy"), stand_of("heavy")
    config, data = pa.Configuration(robot, stand.qpos), evaluate_mujoco(robot, stand.qpos)
    com, ground = config.center_of_mass(), config.contact_points()
    (estimate,) = tipping_impulses(config, com, np.array([[1.0, 0.0]]))
    first, second = sorted(ground.values(), key=lambda place: -place[0])[:2]
    hinge = (second - first) / np.linalg.norm(second - first)
    inertia = 0.0
    for body in range(1, robot.mj_model.nbody):
        axes, arm = data.ximat[body].reshape(3, 3), data.xipos[body] - first
        inertia += robot.mj_model.body_inertia[body] @ (axes.T @ hinge) ** 2
        inertia += robot.mj_model.body_mass[body] * float(np.sum(np.cross(hinge, arm) ** 2))
    lever = np.cross(hinge, com - first)
    height, far = com[2] - first[2] - robot.contact_radius["FL"], first[0] - com[0]
    energy = robot.total_mass * 9.81 * (math.hypot(height, far) - height)
    expected = math.sqrt(2 * inertia * energy) / abs(lever[0])
    assert estimate == pytest.approx(expected, rel=1e-6)


def test_table_of_push_limits_has_each_number_in_its_column() -> None:
    """Fifteen different numbers in five fields of three directions."""
    names = ("directions", "impulses", "velocity_steps", "tipping_estimate", "bisected_impulses")
    fields = dict(zip(names, np.arange(15.0).reshape(5, 3), strict=True))
    table: Any = object.__new__(PushRecovery)
    for name, values in fields.items():
        object.__setattr__(table, name, values)
    object.__setattr__(table, "failures", ("a", "b", "c"))
    frame = table.to_dataframe()
    columns = {"direction", "impulse", "velocity_step", "tipping_estimate"}
    assert set(frame.columns) == columns | {"failure"}
    assert list(frame["failure"]) == ["a", "b", "c"]
    for name, values in fields.items():
        column = name.removesuffix("s")
        if column in columns:
            np.testing.assert_array_equal(frame[column], values)


class Bench:
    """Stub of the simulation: a push is survived if `survives` returns True."""

    def __init__(self, survives: Callable[[int, float], bool]) -> None:
        self.axes = np.zeros((2, 2))
        self.survives = survives

        self.failures_without_push = ()

    def simulate_fully(self, directions: np.ndarray, impulses: np.ndarray) -> list[str | None]:
        return self.simulate_until_decided(directions, impulses)

    def simulate_until_decided(
        self, directions: np.ndarray, impulses: np.ndarray
    ) -> list[str | None]:
        pairs = zip(directions, impulses, strict=True)
        return [None if self.survives(*pair) else f"{pair[1]:.3f}" for pair in pairs]


@pytest.mark.parametrize(
    ("smallest", "resolution"),
    [(2.4, 0.02), (0.4, 0.02), (0.399, 0.01), (8.3e-4, 4e-5), (np.inf, 0.02), (1e-9, 1e-6)],
)
def test_default_resolution_suits_small_robots(smallest: float, resolution: float) -> None:
    """Reference: 5 % of the smallest tipping estimate, in one digit, from 1e-6 to 0.02 N s.

    A robot of 3 g tips at 8.3e-4 N s: with 0.02 N s, each limit was 0.
    """
    estimate = np.array([3.0, smallest, np.inf])
    assert push._choose_resolution(estimate) == resolution


def test_smaller_push_that_fails_is_found() -> None:
    """Direction 1 does not survive pushes between 2 and 4 N s, but larger ones again up to 9."""

    def survives(direction: int, impulse: float) -> bool:
        return impulse <= (5.0 if direction == 0 else 9.0) and not (
            direction == 1 and 2.0 < impulse < 4.0
        )

    bench: Any = Bench(survives)
    limits, bisected, failures = push._find_push_limits(bench, np.array([np.inf, 5.0]), 0.01)
    np.testing.assert_allclose(bisected, [5.0, 9.0], atol=0.01)
    np.testing.assert_allclose(limits, [5.0, 2.0], atol=0.01)
    assert (limits <= [5.0, 2.0]).all()
    assert [float(reason) for reason in failures] == pytest.approx([5.0, 2.0], abs=0.011)


@pytest.mark.parametrize(
    ("arguments", "field"),
    [
        ({"directions": 2}, "directions"),
        ({"resolution": 0.0}, "resolution"),
        ({"duration": 1.0}, "duration"),
        ({"kp": 0}, "kp"),
        ({"kd": -1}, "kd"),
        ({"integrator": "magic"}, "integrator"),
    ],
)
def test_bad_requests_are_refused(arguments: dict[str, Any], field: str) -> None:
    with pytest.raises(pa.ConfigurationError, match=field):
        push_recovery(load("v3"), stand_of("v3"), **arguments)
    with pytest.raises(pa.ConfigurationError, match="fixed base"):
        push_recovery(load("v3", fixed_base=True), stand_of("v3"))


@pytest.mark.slow
@pytest.mark.parametrize(
    "task",
    [
        pa.StandTask(swing={"FL": 0.02}, com="inside", com_margin=0.02),
        pa.StandTask(pitch=-0.1, ground=pa.Ground(0.1, 0.0, {"RR": 0.01})),
    ],
)
def test_push_recovery_on_three_legs_slopes_and_steps(task: pa.StandTask) -> None:
    """On three legs the recovered impulse exceeds the tipping impulse: the lifted foot lands."""
    robot = load("original")
    stand = pa.stance.solve_stand_on_soft_ground(robot, task)
    result = push_recovery(robot, stand, directions=8, resolution=0.1)
    assert result.weakest_impulse > 0.2
    if task.swing:
        config = pa.Configuration(robot, stand.qpos)
        axes = np.array([[1.0, 1.0]]) / math.sqrt(2)
        point = np.asarray(result.point)
        three, four = (
            tipping_impulses(config, point, axes, feet)
            for feet in (stand.stance_feet, robot.contact_points)
        )
        assert three < four
        assert result.impulses[1] > three


@pytest.mark.slow
@pytest.mark.parametrize(("kd", "stands"), [(5.0, True), (8.0, False)])
def test_push_limit_is_zero_if_the_stand_fails(tmp_path: Path, kd: float, stands: bool) -> None:
    """Reference: ``verify_stand``.

    At 8 N m s/rad the servos oscillate, and the robot falls in the second after a nudge at 5 s.
    """
    robot = pa.load_robot(**quadruped(tmp_path, actuators="position", floor=True)._asdict())
    stand = pa.stance.solve_stand_on_soft_ground(robot)
    alone = pa.verify_stand(robot, stand, kp=150.0, kd=kd)
    assert alone.passed == alone.stays == stands
    found = push_recovery(robot, stand, kp=150.0, kd=kd, directions=3, duration=2.0, resolution=1.0)
    trial = pa.simulation.simulate_push(robot, stand, 0.01, kp=150.0, kd=kd, duration=2.0)
    assert trial.recovered == stands
    assert found.failures_without_push == alone.failures
    assert (found.weakest_impulse > 0) == stands
    if not stands:
        assert found.weakest_failure.values["failures"] == alone.failures
        assert trial.failure == found.weakest_failure


@pytest.mark.slow
@pytest.mark.parametrize("name", ["v3", "v3-long-leg"])
def test_early_termination_does_not_change_the_outcome(name: str) -> None:
    """Around the limits, where robots dwell on two feet; v3-long-leg for seconds."""
    robot, stand, found = load(name), stand_of(name), push_variant(name)
    bench = make_push_bench(
        robot, stand, found.directions, duration=3.0, kp=None, kd=None, feedforward=True,
        integrator=None,
    )  # fmt: skip
    directions = np.repeat(np.arange(4), 3)
    impulses = (found.impulses[:, None] * [0.5, 1.0, 1.05]).ravel()
    early, complete = (
        bench.simulate_until_decided(directions, impulses),
        bench.simulate_fully(directions, impulses),
    )
    assert [failure is None for failure in early] == [one is None for one in complete]
    assert None in complete
    assert any(complete)


@pytest.mark.slow
def test_moving_robot_is_simulated_on_until_it_rests_or_falls() -> None:
    """Compare the outcomes of pushes of 1.0 to 1.59 N s with a simulation of 6 s, in which all are
    decided. After 2 s v3-long-leg still moves in all cases; this was reported as no rest.
    """
    options = {"kp": None, "kd": None, "feedforward": True, "integrator": None}
    robot, stand = load("v3-long-leg"), pa.stance.solve_stand_as_simulated(load("v3-long-leg"))
    known: Any = SimpleNamespace(stays=True, failures=())
    impulses = np.array([1.0, 1.3, 1.45, 1.5, 1.59])
    directions = np.zeros(len(impulses), dtype=np.int64)
    short, complete = (
        make_push_bench(robot, stand, np.zeros(1), duration=duration, verification=known, **options)
        for duration in (2.0, 6.0)
    )
    ends = list(short.simulate_pushes(directions, impulses))
    assert all(
        "not-at-rest" in {end.code for end in short._find_end_failures(states)} for states in ends
    )
    outcomes = complete.simulate_fully(directions, impulses)
    assert [failure is None for failure in outcomes] == [True] * 4 + [False]
    for simulate in (short.simulate_fully, short.simulate_until_decided):
        assert simulate(directions, impulses) == outcomes
    for states, failure in zip(ends, outcomes, strict=True):
        last = short.find_failure(short.extend_until_rest(states))
        assert (last is None) == (failure is None)


def test_push_outcome_depends_on_the_final_state() -> None:
    """Half a second of standing, followed by a tilted or a low last state, is no recovery."""
    options = {"duration": 1.0, "kp": None, "kd": None, "feedforward": True, "integrator": None}
    known = SimpleNamespace(stays=True, failures=())
    robot, stand = load("v3"), stand_of("v3")
    bench = make_push_bench(robot, stand, np.zeros(1), **options, verification=known)  # type: ignore[arg-type]
    place = 1 + robot.mj_convention.qpos_index
    for where, value in (
        (place[3:7], (math.cos(0.5), math.sin(0.5), 0.0, 0.0)),
        (place[2], 0.02),
    ):
        ends = np.tile(bench.start, (200, 1))
        assert bench._find_end_failures(ends) == []
        ends[-1, where] = value
        assert bench._find_end_failures(ends)


@pytest.mark.slow
def test_pushed_stand_equals_the_reported_stand() -> None:
    robot, task = load("v3"), pa.StandTask(roll=math.radians(4.0))
    stand = pa.stance.solve_stand_as_simulated(robot, task)
    assert any(stand.depths.values())
    found = push.study_pushes([robot], task, directions=3, resolution=1.0)
    assert found["v3"].stand.qpos == pytest.approx(stand.qpos, abs=1e-12)


def test_the_motion_is_that_of_a_force_on_the_base() -> None:
    """A push of 0.3 N s to the left of a base that is yawed by 0.3 rad moves the base to its left.

    Reference: MuJoCo's position of the body's CoM for the point of the force.
    """
    robot = load("v3")
    stand = pa.solve_stand(robot, pa.StandTask(yaw=0.3))
    trial = pa.simulation.simulate_push(robot, stand, 0.3, math.pi / 2, duration=2.0)
    model = robot.mj_model
    data = mujoco.MjData(model)
    robot.mj_convention.set_state(data, trial.motion[0])
    mujoco.mj_kinematics(model, data)
    body = model.body(robot.mj_base).id
    moved = trial.motion[3, :2] - trial.motion[0, :2]
    left = np.array([-math.sin(0.3), math.cos(0.3)])
    assert moved @ left > 5 * abs(moved @ [left[1], -left[0]])
    # The com of the base's body, where the first sample has it after one step.
    assert data.xipos[body] == pytest.approx(trial.point, abs=6e-3)
    assert trial.pulse == pytest.approx(0.02)
    assert np.diff(trial.motion_time) == pytest.approx(np.full(len(trial.motion) - 1, 0.034))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"impulse": -1.0}, "impulse: -1 N s is not between 0"),
        ({"impulse": math.nan}, "impulse: nan is not finite"),
        (
            {"impulse": 1.0, "direction": 7.0},
            "direction: 401.07 deg is not between -360 and 360 deg",
        ),
        ({"impulse": 1.0, "duration": 1.0}, "duration"),
    ],
)
def test_invalid_push_is_refused(arguments: dict[str, float], message: str) -> None:
    with pytest.raises(pa.ConfigurationError, match=message):
        pa.simulation.simulate_push(load("v3"), stand_of("v3"), **arguments)


@pytest.mark.slow
@pytest.mark.parametrize(("impulse", "recovers"), [(1.35, True), (1.43, False), (1.478, False)])
def test_slow_fall_after_a_push_is_no_recovery(impulse: float, *, recovers: bool) -> None:
    """Reference: a plain MuJoCo loop of 60 s, in which the shanks come to the ground or do not.

    Pushed backwards by 1.43 N s, v3-long-leg moves at 0.1 mm/s after 14 s, with a mode that doubles
    every 10 s, and lies on its shanks after 35 s. By 1.478 N s it was slow at 6 s and fell at 9 s.
    """
    robot, stand = load("v3-long-leg"), pa.stance.solve_stand_as_simulated(load("v3-long-leg"))
    options = {"kp": None, "kd": None, "feedforward": True, "integrator": None}
    bench = make_push_bench(robot, stand, np.array([math.pi]), duration=6.0, **options)
    model = bench.drive.model
    data = mujoco.MjData(model)
    mujoco.mj_setState(model, data, bench.start, mujoco.mjtState.mjSTATE_FULLPHYSICS.value)
    data.ctrl[:] = bench.ctrl
    trunk, touched = model.body(robot.mj_base).id, False
    is_sphere = model.geom_type == mujoco.mjtGeom.mjGEOM_SPHERE
    for step in range(round(60.0 / model.opt.timestep)):
        pushed = step < bench.pulse_steps
        data.xfrc_applied[trunk, 0] = -pushed * impulse / 0.02
        mujoco.mj_step(model, data)
        touched = not is_sphere[data.contact.geom].any(axis=1).all()
        if touched:  # it has fallen
            break
    assert touched != recovers
    for simulate in (bench.simulate_fully, bench.simulate_until_decided):
        (failure,) = simulate(np.zeros(1, dtype=np.int64), np.array([impulse]))
        assert (failure is None) == recovers


@pytest.mark.slow
def test_pushes_are_deterministic() -> None:
    options = {"directions": 3, "duration": 3.0, "resolution": 0.5}
    first, second = (push_recovery(load("v3"), stand_of("v3"), **options) for _ in range(2))  # type: ignore[arg-type]
    assert first.to_json() == second.to_json()


def test_stand_without_a_push_does_not_move() -> None:
    trial = pa.simulation.simulate_push(load("v3"), stand_of("v3"), 0.0, duration=2.0)
    assert trial.recovered
    assert np.ptp(trial.motion, axis=0).max() < 2e-3


@pytest.mark.slow
@pytest.mark.parametrize("feedforward", [True, False])
def test_push_result_states_gains_and_settings(*, feedforward: bool) -> None:
    trial = pa.simulation.simulate_push(
        load("v3"), stand_of("v3"), 0.1, duration=2.0, kp=8.0, kd=0.3, feedforward=feedforward,
        integrator="implicitfast",
    )  # fmt: skip
    assert trial.feedforward is feedforward
    assert trial.integrator == "implicitfast"
    assert (trial.timestep, trial.duration, trial.pulse) == (0.002, 2.0, 0.02)
    np.testing.assert_array_equal(trial.kp, np.full(12, 8.0))
    np.testing.assert_array_equal(trial.kd, np.full(12, 0.3))


@pytest.mark.slow
def test_single_push_at_the_limit_recovers_and_a_larger_push_fails() -> None:
    """Reference: limits of `push_recovery` with a resolution of 0.1 N s."""
    robot, stand = load("original"), stand_of("original")
    found = pa.push_recovery(robot, stand, directions=3, duration=2.0, resolution=0.1)
    for direction, impulse in zip(found.directions, found.impulses, strict=True):
        good, bad = (
            pa.simulation.simulate_push(robot, stand, size, float(direction), duration=2.0)
            for size in (float(impulse), float(impulse) + 0.1)
        )
        assert good.recovered
        assert good.failure is None
        assert not bad.recovered
        assert bad.failure
        assert good.velocity_step == pytest.approx(good.impulse / robot.total_mass)


MOTOR = """name = "weak"
source = "bench"
output_torque_constant = "0.4 N m/A"
resistance = "2 ohm"
supply_voltage = "{volt} V"
no_load_speed = "{speed} rad/s"
"""


@pytest.mark.slow
@pytest.mark.parametrize(("volt", "passes"), [(3.0, False), (48.0, True)])
def test_motors_of_a_push_are_compared_with_torques_at_their_speeds(
    volt: float, passes: bool, tmp_path: Path
) -> None:
    """References: torques and speeds of a plain MuJoCo loop; at the speed w of the output, a motor
    exerts (V - K w) K / R, with K = 0.4 N m/A.
    """
    path = tmp_path / "weak.toml"
    path.write_text(MOTOR.format(volt=volt, speed=volt / 0.4))
    robot, motor = load("v3"), find_motor(str(path))
    motors = {robot.name: dict.fromkeys(robot.joint_names, motor)}
    task = pa.StandTask()
    found = push.study_pushes([robot], task, directions=3, resolution=0.5, motors=motors)
    pushed = found[robot.name]
    assert pushed.region_peaks is not None
    assert pushed.beyond_times is not None
    recovery = pushed.recovery
    _, torques, speeds = simulate_plainly(
        "v3",
        pushed.stand,
        recovery.weakest_direction,
        recovery.weakest_impulse,
        recovery.duration,
    )
    driving = np.where(torques < 0, -speeds, speeds)
    available = (volt - 0.4 * driving) * 0.4 / 2
    shares = np.abs(torques) / available
    assert pushed.region_peaks == pytest.approx(shares.max(axis=0), rel=1e-3)
    times = robot.mj_model.opt.timestep * (shares > 1).sum(axis=0)
    assert pushed.beyond_times == pytest.approx(times, abs=0.004)
    assert (pushed.within_region, pushed.passed) == (passes, passes)
    text = " ".join(print_words(push_document(pushed)))
    assert ("BEYOND THE MOTORS" in text) is not passes
    assert "of the available torque of weak at its speed" in text
