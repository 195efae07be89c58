"""A simulated walk equals that of a bare MuJoCo script; the number of workers changes no bit."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import pupper_analysis as pa
from pupper_analysis.base.diagnostics import Quantity
from pupper_analysis.base.errors import PupperAnalysisError
from pupper_analysis.models.motors.motor import Motor
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.simulation.rollout import full_state
from pupper_analysis.tools.walk.contract import ObservationTerm
from pupper_analysis.tools.walk.document import walk_document
from pupper_analysis.tools.walk.falls import find_fall_tests
from pupper_analysis.tools.walk.gait import (
    _compute_base_deviations,
    check_command,
    describe_run_failure,
    measure_gait,
    sample_ground_support,
    simulate_walk,
)
from pupper_analysis.tools.walk.policy import Policy
from pupper_analysis.tools.walk.runs import Observer, PolicyRun, prepare_stage, simulate_cases
from tests.present.test_printed import print_words
from tests.support.repository import ROOT
from tests.support.variants import load
from tests.tools.walk import made

POSE = np.array([0.26, 0.0, -0.52, -0.26, 0.0, 0.52] * 2)
HIPS = [1, 4, 7, 10]


@pytest.fixture(scope="module")
def still(tmp_path_factory: pytest.TempPathFactory) -> Policy:
    return Policy.load(made.write_standing_policy(tmp_path_factory.mktemp("walk") / "still.json"))


def simulate_bare(robot: pa.Robot, height: float, seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """Return torques and states of the standing policy, simulated by bare MuJoCo."""
    model = mujoco.MjModel.from_xml_path(str(robot.description.mjcf_source))
    data = mujoco.MjData(model)
    model.actuator_gainprm[:, 0], model.actuator_biasprm[:, 1:3] = 5.0, (-5.0, -0.25)
    data.qpos[:] = 0.0
    data.qpos[2], data.qpos[3], data.qpos[7:] = height, 1.0, POSE
    torques, states = [], []
    for step in range(round(seconds / model.opt.timestep)):
        if step % 10 == 0:
            turned = np.zeros(9)
            mujoco.mju_quat2Mat(turned, data.qpos[3:7])
            gravity = turned.reshape(3, 3).T @ [0.0, 0.0, -1.0]
            action = np.zeros(12)
            action[HIPS] = np.tanh(0.2 * gravity[1] + 0.02 * data.qvel[3])
            data.ctrl[:] = POSE + 0.75 * action
        mujoco.mj_step(model, data)
        torques.append(data.actuator_force.copy())
        states.append(np.r_[data.qpos, data.qvel])
    return np.array(torques), np.array(states)


def test_torques_and_motion_of_a_walk_equal_bare_mujoco(still: Policy) -> None:
    """Reference: RMS torques [N m] and last configuration of a script with ``mj_step``; knee
    torques are those of statics within 10 %.
    """
    robot = load("v3")
    stage = prepare_stage(robot, still)
    walk = simulate_walk(robot, still, (0, 0, 0), seconds=3.0, warm_up=1.0)
    torques, states = simulate_bare(robot, float(stage.default[2]), 3.0)
    gait = walk.gaits[0]
    rms = np.sqrt((torques[501:] ** 2).mean(axis=0))
    assert gait.torque_rms == pytest.approx(rms, rel=1e-3, abs=1e-4)
    assert gait.motion[-1] == pytest.approx(states[1500 - 20, :19], abs=2e-3)
    assert gait.tracks
    assert gait.fall is None
    assert walk.passed
    assert 0.8 < gait.margin < 0.95  # it sags
    assert all(share == 1.0 for share in gait.duty.values())
    assert gait.power < 0.01
    assert gait.static is not None  # standing: the torques of the gait are static
    assert gait.static[2::3] == pytest.approx(rms[2::3], rel=0.1)  # knees: feet do not push aside


def test_latency_delays_the_commands_by_its_time(still: Policy) -> None:
    """30 ms are 15 steps of 2 ms."""
    stage = prepare_stage(load("v3"), still.with_contract(latency=0.03))
    moving = prepare_stage(load("v3"), still)
    case = stage.make_case(np.zeros(3), 1)
    late = next(iter(simulate_cases(stage, [case], 0.4, 0.1)))
    now = next(iter(simulate_cases(moving, [moving.make_case(np.zeros(3), 1)], 0.4, 0.1)))
    assert (late.targets[:15] == stage.ctrl).all()
    assert (late.targets[15] == now.targets[0]).all()
    assert (now.targets[0] != moving.ctrl).any()


def test_observations_equal_mujoco_sensors_at_the_base(still: Policy) -> None:
    """References: velocimeter, gyro, and gravity in the frame of a site at the base."""
    spec = mujoco.MjSpec.from_file(str(load("v3").description.mjcf_source))
    spec.body("base_link").add_site(name="eye")
    for kind in ("velocimeter", "gyro"):
        sensor = getattr(mujoco.mjtSensor, f"mjSENS_{kind.upper()}")
        spec.add_sensor(name=kind, type=sensor, objtype=mujoco.mjtObj.mjOBJ_SITE, objname="eye")
    model = spec.compile()
    data, stage = mujoco.MjData(model), prepare_stage(load("v3"), still)
    draw = np.random.default_rng(0)
    qpos = stage.default + 0.1 * draw.normal(size=19)
    qpos[3:7] /= np.linalg.norm(qpos[3:7])
    stage.robot.mj_convention.set_state(data, qpos, draw.normal(size=18))
    mujoco.mj_forward(model, data)
    names = ("linear-velocity", "angular-velocity", "gravity")
    contract = replace(still.contract, terms=tuple(map(ObservationTerm, names)), history=1)
    watching = replace(stage, policy=replace(still, contract=contract))
    observer, state = Observer(watching, np.zeros((1, 3))), full_state(model, data)[None]
    seen = observer.observe(state, np.array([0]), 0)[0]
    down = data.site("eye").xmat.reshape(3, 3).T @ [0.0, 0.0, -1.0]
    sensed = [data.sensor("velocimeter").data, data.sensor("gyro").data, down]
    assert seen == pytest.approx(np.concatenate(sensed), abs=1e-12)


def test_fall_of_a_walk_is_reported(still: Policy) -> None:
    """The default pose of the policy cannot stand."""
    pose = POSE + np.array([0, 1.2, 0] * 4)
    walk = simulate_walk(load("v3"), still.with_contract(default=pose), (0, 0, 0), seconds=4.0)
    gait = walk.gaits[0]
    assert gait.fall is not None
    assert not gait.tracks
    assert not walk.passed
    assert gait.margin == 0
    assert gait.duration < 4.0
    assert math.isfinite(gait.power)


@pytest.mark.slow
def test_tested_change_prevents_a_fall_as_a_walk_with_this_change(still: Policy) -> None:
    """References: a walk whose policy states half the damping, and a pose that cannot stand."""
    stiff = still.with_contract(kd=np.full(12, 10.0))
    walk = simulate_walk(load("v3"), stiff, (0, 0, 0), seconds=4.0)
    found = find_fall_tests(load("v3"), stiff, walk, 4.0)
    tests = {(test.quantity, test.value): test for test in found}
    assert walk.gaits[0].fall is not None
    assert ("command", 0.0) not in tests
    assert not tests["kd", 0.5].falls
    assert tests["kd", 2.0].falls
    halved = still.with_contract(kd=np.full(12, 5.0))
    upright = simulate_walk(load("v3"), halved, (0, 0, 0), seconds=4.0)
    assert upright.gaits[0].fall is None
    assert find_fall_tests(load("v3"), halved, upright, 4.0) == ()
    printed = " ".join(print_words(walk_document(replace(walk, fall_tests=found))))
    assert "cause: the robot does not fall with " in printed
    lying = still.with_contract(default=POSE + np.array([0, 1.2, 0] * 4))
    walk = simulate_walk(load("v3"), lying, (0.2, 0, 0), seconds=4.0)
    found = find_fall_tests(load("v3"), lying, walk, 4.0)
    assert [test.falls for test in found] == [True] * 7


def test_fall_states_height_and_tilt_of_the_last_state(still: Policy) -> None:
    """A base 123 mm high and rolled by 1 rad, without a simulation."""
    stage = prepare_stage(load("v3"), still)
    data = mujoco.MjData(stage.model)
    data.time, data.qpos[2] = 2.0, 0.123
    data.qpos[3:7] = math.cos(0.5), math.sin(0.5), 0.0, 0.0
    run = cast("PolicyRun", SimpleNamespace(states=full_state(stage.model, data)[None]))
    fall = describe_run_failure(stage, run, 2.0)
    assert fall.code == "fell-over"
    found = {name: cast("Quantity", fall.values[name]).value for name in ("height", "tilt", "time")}
    assert found == pytest.approx({"height": 0.123, "tilt": 1.0, "time": 2.0})


def test_gait_of_a_run_with_a_single_state_has_no_torques(still: Policy) -> None:
    """A policy at the rate of the time steps may diverge in its first action."""
    stage = prepare_stage(load("v3"), still)
    [run] = simulate_cases(stage, [stage.make_case(np.zeros(3))], 0.1, 0.0, 1)
    first = replace(run, states=run.states[:1], targets=run.targets[:1], fallen=True)
    gait = measure_gait(stage, first, 1.0)
    assert gait.fall is not None
    assert not gait.tracks
    assert gait.margin == 0
    assert np.isnan([*gait.torque_rms, *gait.torque_peak, *gait.at_limit, gait.power]).all()
    assert len(gait.torques) == len(gait.torque_time) == 0


def test_rate_above_the_rate_of_time_steps_is_refused(still: Policy) -> None:
    """The model has 500 time steps per second. 700 actions would be simulated as 500."""
    assert prepare_stage(load("v3"), still.with_contract(rate=500.0)).substeps == 1
    for rate in (501.0, 700.0, 2000.0):
        with pytest.raises(pa.ConfigurationError, match=f"runs at {rate:g}"):
            prepare_stage(load("v3"), still.with_contract(rate=rate))


@pytest.mark.parametrize(("gain", "text"), [({"kp": None}, "kp"), ({"kd": None}, "kd")])
def test_single_gain_of_a_policy_is_refused(
    still: Policy, gain: dict[str, object], text: str
) -> None:
    with pytest.raises(PupperAnalysisError, match=f"states {text}"):
        prepare_stage(load("v3"), still.with_contract(**gain))


def test_policy_with_unknown_joints_is_refused(still: Policy) -> None:
    named = still.with_contract(joints=(*load("v3").joint_names[:11], "knee"))
    with pytest.raises(PupperAnalysisError, match="knee"):
        prepare_stage(load("v3"), named)
    fewer = still.with_contract(default=np.zeros(11))
    with pytest.raises(PupperAnalysisError, match="commands 11"):
        prepare_stage(load("v3"), fewer)


def test_policy_that_commands_a_coupled_joint_is_refused(still: Policy) -> None:
    """The action of a joint without actuator was written to the last actuator."""
    spec = mujoco.MjSpec.from_file(str(ROOT / "mjcf/pupper_v3.xml"))
    [removed] = [i for i, item in enumerate(spec.actuators) if item.target == "leg_back_l_3"]
    spec.delete(spec.actuators[removed])
    for key in spec.keys:  # without a keyframe, the search of a start pose takes 8 s
        key.ctrl = np.delete(key.ctrl, removed)
    spec.add_equality(
        type=mujoco.mjtEq.mjEQ_JOINT, name1="leg_back_l_3", name2="leg_back_r_3",
        objtype=mujoco.mjtObj.mjOBJ_JOINT, data=[0, -1, *[0] * 10],
    )  # fmt: skip
    robot = pa.load_robot(spec)
    assert (robot.mj_convention.actuator_index < 0).sum() == 1
    with pytest.raises(PupperAnalysisError, match=r"no actuator .*: leg_back_l_3"):
        prepare_stage(robot, still.with_contract(joints=load("v3").joint_names))


def test_stance_torques_equal_the_energy_gradient(tmp_path: Path) -> None:
    """Reference: finite difference of tau = d(m g z - sum n_i z_i)/dq by Pinocchio, on two feet,
    with the weight n_i shared as a lever on the line of the feet.
    """
    robot = load("v3")
    stage = prepare_stage(robot, Policy.load(made.trot(tmp_path / "trot.json")))
    [run] = simulate_cases(stage, [stage.make_case(np.array(made.TROT[0]))], 3.0, 1.0, 1)
    states = run.states[round(1.0 / stage.timestep) :: stage.substeps]
    seen, _ = sample_ground_support(stage, run.case.model, states, statics=True)
    whole = np.sqrt(np.mean([support.static**2 for support in seen], axis=0))
    assert measure_gait(stage, run, 1.0).static == pytest.approx(whole, abs=1e-12)
    weight, pairs, data = robot.total_mass * 9.81, 0, mujoco.MjData(stage.model)
    for state, moment in zip(states, seen, strict=True):
        mujoco.mj_setState(stage.model, data, state, mujoco.mjtState.mjSTATE_FULLPHYSICS)
        mujoco.mj_forward(stage.model, data)
        floor = data.contact.geom[data.contact.dist <= 0]
        down = {robot.foot_geoms.get(int(geom)) for geom in floor.ravel()} - {None}
        assert down == set(moment.feet)
        if len(down) != 2:
            continue
        pairs += 1
        qpos = state[1 + robot.mj_convention.qpos_index]

        def lifted(angles: Any, qpos: Any = qpos, moment: Any = moment) -> Any:
            config = Configuration(robot, np.r_[qpos[:7], angles])
            feet = config.foot_positions()
            return config.center_of_mass(), *(feet[foot] for foot in moment.feet)

        com, one, other = lifted(qpos[7:])
        line = (other - one)[:2]
        part = float(np.clip((com - one)[:2] @ line / (line @ line), 0.0, 1.0))
        torque = []
        for joint in range(12):
            rise = []
            for step in (1e-6, -1e-6):
                angles = qpos[7:].copy()
                angles[joint] += step
                c, a, b = lifted(angles)
                rise.append(weight * (c[2] - (1 - part) * a[2] - part * b[2]))
            torque.append((rise[0] - rise[1]) / 2e-6)
        assert moment.static == pytest.approx(torque, abs=5e-3)
    assert pairs > 10


def test_states_of_a_run_do_not_depend_on_the_workers(still: Policy) -> None:
    """To the last bit; runs with different seeds start in different states."""
    stage = prepare_stage(load("v3"), still)
    cases = [stage.make_case(np.zeros(3), seed) for seed in range(5)]
    one = list(simulate_cases(stage, cases, 0.4, 0.1, workers=1))
    for workers in (2, 5):
        many = list(simulate_cases(stage, cases, 0.4, 0.1, workers=workers))
        assert all((a.states == b.states).all() for a, b in zip(one, many, strict=True))
    alone = list(simulate_cases(stage, cases[3:4], 0.4, 0.1))
    assert (alone[0].states == one[3].states).all()
    assert (one[1].states[0] != one[2].states[0]).any()


@pytest.mark.parametrize(
    ("changed", "text"),
    [
        ({"command": (math.nan, 0, 0)}, "command"),
        ({"command": (1, 0)}, "command"),
        ({"seeds": 0}, "seeds"),
        ({"seconds": math.inf}, "seconds"),
        ({"seconds": 0.1}, "seconds"),
    ],
    ids=str,
)
def test_invalid_arguments_of_a_walk_are_refused(
    still: Policy, changed: dict[str, Any], text: str
) -> None:
    with pytest.raises(PupperAnalysisError, match=text):
        simulate_walk(load("v3"), still, **changed)


@pytest.mark.slow
def test_motors_of_a_walk_are_compared_with_torques_at_their_speeds(still: Policy) -> None:
    """Reference: |torque| / (V - Ke w) Kt N / R of the recorded torques; the robot hardly moves."""
    strong = Motor(
        *("strong", "bench"),
        torque_constant=1.0,
        gear_ratio=1.0,
        gear_efficiency=1.0,
        resistance=1.0,
        supply_voltage=3.0,
    )
    robot = load("v3")
    motors = dict.fromkeys(robot.joint_names, strong)
    arguments = {"seconds": 3.0, "warm_up": 1.0}
    walk = simulate_walk(robot, still, (0, 0, 0), motors=motors, **arguments)
    gait = walk.gaits[0]
    assert walk.passed
    assert gait.region_peak == pytest.approx(gait.torque_peak / 3.0, rel=1e-2, abs=1e-3)
    assert (gait.beyond_region == 0).all()
    weak = dict.fromkeys(robot.joint_names[2::3], replace(strong, supply_voltage=0.1))
    failed = simulate_walk(robot, still, (0, 0, 0), motors=weak, **arguments)
    assert all(gait.tracks for gait in failed.gaits)
    assert not failed.passed
    assert failed.gaits[0].beyond_region[2::3] == pytest.approx(1.0)
    assert np.isnan(failed.gaits[0].beyond_region[0::3]).all()
    document = walk_document(failed)
    assert getattr(document.verdict, "en", "") == "BEYOND THE MOTORS"
    assert "of the available torque of strong at its speed" in document.failures[0].en
    unknown = simulate_walk(robot, still, (0, 0, 0), **arguments)
    assert np.isnan(unknown.gaits[0].region_peak).all()
    assert unknown.passed


def test_deviations_of_the_base_are_those_of_its_roll_pitch_and_height(still: Policy) -> None:
    """Reference: the standard deviation of a sine is its amplitude / sqrt(2). SciPy makes the
    quaternions from the angles.
    """
    stage = prepare_stage(load("v3"), still)
    columns = 1 + stage.robot.mj_convention.qpos_index
    phase = 2 * np.pi * np.arange(100) / 100
    roll, pitch, height = 0.2 * np.sin(phase), 0.05 * np.sin(2 * phase), 0.01 * np.sin(3 * phase)
    angles = np.stack([np.full(100, 0.4), pitch, roll], axis=1)
    states = np.zeros((100, 1 + stage.model.nq + stage.model.nv + stage.model.na))
    states[:, columns[3:7]] = Rotation.from_euler("ZYX", angles).as_quat(scalar_first=True)
    states[:, columns[2]] = 0.13 + height
    found = _compute_base_deviations(stage, states)
    assert found == pytest.approx(np.array([0.2, 0.05, 0.01]) / math.sqrt(2), rel=1e-9)


@pytest.mark.parametrize(
    "command", [(10**400, 0, 0), (math.nan, 0, 0), (1, 2), "fast", (200, 0, 0)]
)
def test_command_that_is_no_velocity_is_refused(command: Any) -> None:
    with pytest.raises(pa.ConfigurationError):
        check_command(command)
