"""Policies with the files of their deployment: the same walk as with a TOML of the same numbers."""

from __future__ import annotations

import json
import math
import tomllib
from collections import deque
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from pupper_analysis.base.errors import ConfigurationError, ModelError
from pupper_analysis.simulation.rollout import full_state
from pupper_analysis.tools.contract.deployment import read_deployment
from pupper_analysis.tools.walk.contract import ObservationTerm, Statements, make_contract
from pupper_analysis.tools.walk.document import make_key_table, walk_document
from pupper_analysis.tools.walk.gait import simulate_walk
from pupper_analysis.tools.walk.policy import Policy, select_policy, split_sources
from pupper_analysis.tools.walk.runs import Observer, prepare_stage, replace_efforts
from pupper_analysis.tools.walk.template import write_template
from tests.support.commands import run_command
from tests.support.legged import rewrite_file
from tests.support.variants import load
from tests.tools.contract.sources import ANGLES, JOINTS, format_list, write_all
from tests.tools.walk import made

TERMS = ["base_ang_vel", "projected_gravity", "velocity_commands", "joint_pos_rel", "last_action"]
SIZES = [3, 3, 3, 12, 12]

TOML = f"""
observation = [
  {{term = "angular-velocity", scale = 0.25}}, "gravity",
  {{term = "command", scale = [2.0, 2.0, 0.25]}}, "joint-positions", "last-action",
]
joints = {json.dumps(JOINTS)}
default = {ANGLES}
action-scale = 0.75
kp = 5.0
kd = 0.25
effort = 2.5
rate = 50
history = 2
"""


def make_deploy(**changed: str) -> str:
    """Write a YAML as unitree_rl_lab exports it: terms by name, each with scale and history."""
    scales = {"base_ang_vel": 0.25, "velocity_commands": None}
    values = {
        "joint_names": format_list(JOINTS),
        "step_dt": "0.02",
        "stiffness": format_list([5.0] * 12),
        "damping": format_list([0.25] * 12),
        "effort_limits": format_list([2.5] * 12),
        "default_joint_pos": format_list(ANGLES),
        "actions": "\n  JointPositionAction:\n    scale: [" + ", ".join(["0.75"] * 12) + "]",
    } | changed
    text = "".join(f"{key}: {value}\n" for key, value in values.items()) + "observations:\n"
    for name, size in zip(TERMS, SIZES, strict=True):
        scale = [2.0, 2.0, 0.25] if name == "velocity_commands" else [scales.get(name, 1.0)] * size
        text += f"  {name}:\n    clip: null\n    scale: {scale}\n    history_length: 2\n"
    return text


def write_policy(folder: Path) -> Path:
    """Write a network with two frames (time steps) per term, without metadata."""
    draw = np.random.default_rng(1)
    weights = 0.02 * draw.normal(size=(2 * sum(SIZES), 12))
    path = folder / "policy.onnx"
    path.write_bytes(made.dense_onnx([(weights, np.zeros(12))], "Tanh"))
    return path


@pytest.mark.slow
def test_deployment_gives_the_same_walk_as_a_toml(tmp_path: Path) -> None:
    """To the last bit: order, gains, pose, scales, terms, history, rate and torque limits."""
    policy, deploy, toml = write_policy(tmp_path), tmp_path / "deploy.yaml", tmp_path / "own.toml"
    deploy.write_text(make_deploy())
    toml.write_text(TOML)
    robot = load("v3")
    found = Policy.load(policy, deployment=read_deployment(robot, [deploy], policy))
    stated = Policy.load(policy, toml)
    walks = [simulate_walk(robot, policy, (0.1, 0, 0), seconds=3.0) for policy in (found, stated)]
    assert (walks[0].gaits[0].motion == walks[1].gaits[0].motion).all()
    assert walks[0].limits == pytest.approx(np.full(12, 2.5))
    assert (walks[0].limits == walks[1].limits).all()
    assert found.files == (policy, deploy)


def test_each_key_has_its_line_and_origin(tmp_path: Path) -> None:
    """Stated lines of the YAML; a key that no file states is assumed or unknown."""
    policy, deploy = write_policy(tmp_path), tmp_path / "deploy.yaml"
    text = make_deploy().replace(f"joint_names: {format_list(JOINTS)}\n", "")
    deploy.write_text(text.replace(f"effort_limits: {format_list([2.5] * 12)}\n", ""))
    contract = Policy.load(
        policy, deployment=read_deployment(load("v3"), [deploy], policy)
    ).contract
    lines = deploy.read_text().splitlines()
    for key, word in {"kp": "stiffness", "rate": "step_dt", "default": "default_joint_pos"}.items():
        line = int(contract.sources[key].rpartition(":")[2])
        assert lines[line - 1].startswith(word)
    origins = {key: contract.origins[key] for key in ("rate", "kp", "joints", "latency", "effort")}
    assert origins == {
        "rate": "stated", "kp": "assumed", "joints": "assumed", "latency": "assumed",
        "effort": "unknown",
    }  # fmt: skip
    rows = {row[0].text: row[2].en for row in make_key_table(contract).rows}  # type: ignore[union-attr]
    assert rows["effort"] == "unknown"
    assert rows["rate"] == "stated"


def test_lists_by_depth_are_assigned_as_in_isaac_lab(tmp_path: Path) -> None:
    """The network's arrays are in this order, too."""
    order = [JOINTS[3 * leg + part] for part in range(3) for leg in range(4)]
    angles = [ANGLES[JOINTS.index(name)] for name in order]
    policy, deploy = write_policy(tmp_path), tmp_path / "deploy.yaml"
    text = make_deploy(default_joint_pos=format_list(angles))
    deploy.write_text(text.replace(f"joint_names: {format_list(JOINTS)}\n", ""))
    deployment = read_deployment(load("v3"), [deploy], policy)
    assert [name[-1] for name in deployment.joints] == ["1"] * 4 + ["2"] * 4 + ["3"] * 4
    assert "contract-order-by-depth" in {note.code for note in deployment.notes}


def test_torque_limit_of_a_deployment_only_lowers_the_limit_of_the_files(tmp_path: Path) -> None:
    """A motor obeys both limits; a TOML, and the user, replace them. v3's files state 3 N m."""
    policy, deploy, robot = write_policy(tmp_path), tmp_path / "deploy.yaml", load("v3")
    deploy.write_text(make_deploy(effort_limits=format_list([2.5] * 6 + [9.0] * 6)))
    found = Policy.load(policy, deployment=read_deployment(robot, [deploy], policy))
    stage = prepare_stage(robot, found)
    own = robot.effort_limits
    assert stage.robot.effort_limits == pytest.approx(np.minimum(own, [2.5] * 6 + [9.0] * 6))
    assert stage.model.actuator_forcerange[:, 1].max() == pytest.approx(own.max())
    typed, policy_left = replace_efforts(robot, found, {JOINTS[0]: 7.0})
    limits = prepare_stage(typed, policy_left).robot.effort_limits
    assert limits[0] == pytest.approx(7.0)
    assert limits[1] == pytest.approx(2.5)
    toml = tmp_path / "own.toml"
    toml.write_text(TOML.replace("effort = 2.5", "effort = 9.0"))
    stated = Policy.load(policy, toml)
    assert prepare_stage(robot, stated).robot.effort_limits == pytest.approx(np.full(12, 9.0))


def test_invalid_effort_is_refused(tmp_path: Path) -> None:
    policy, toml = write_policy(tmp_path), tmp_path / "policy.toml"
    for value in ("0.0", "-1.0", '"much"', "[1.0, 2.0]"):
        toml.write_text(TOML.replace("effort = 2.5", f"effort = {value}"))
        with pytest.raises(ModelError, match="effort"):
            Policy.load(policy)


def test_observation_of_legged_gym_is_a_framework_default(tmp_path: Path) -> None:
    """unitree_rl_gym states scales only; its deploy_mujoco.py defines the terms: 47 numbers."""
    path, deploy = tmp_path / "motion.onnx", tmp_path / "g1.yaml"
    path.write_bytes(made.dense_onnx([(np.zeros((47, 12)), np.zeros(12))], "Tanh"))
    deploy.write_text(
        "simulation_dt: 0.005\ncontrol_decimation: 4\n"
        f"kps: {format_list([5.0] * 12)}\nkds: {format_list([0.25] * 12)}\n"
        f"default_angles: {format_list(ANGLES)}\naction_scale: 0.75\n"
        "ang_vel_scale: 0.25\ndof_pos_scale: 1.0\ndof_vel_scale: 0.05\n"
        "cmd_scale: [2.0, 2.0, 0.25]\nnum_actions: 12\nnum_obs: 47\n"
    )
    contract = Policy.load(path, deployment=read_deployment(load("v3"), [deploy], path)).contract
    assert [term.name for term in contract.terms][-2:] == ["phase-sine", "phase-cosine"]
    assert contract.terms[0].scale == 0.25
    assert np.asarray(contract.terms[2].scale).tolist() == [2.0, 2.0, 0.25]
    assert (contract.phase_rate, contract.rate) == (1.25, pytest.approx(50.0))
    assert contract.origins["observation"] == "default"
    assert "unitree_rl_gym" in contract.sources["observation"]


@pytest.mark.parametrize(
    ("names", "inputs"), [(("mjlab_cfg.py",), 27), (("gym_cfg.py", "config.yaml"), 0)]
)
def test_files_of_trainers_and_controllers_are_read(
    tmp_path: Path, names: tuple[str, ...], inputs: int
) -> None:
    """mjlab states the terms; legged_gym and Pupper's controller need a TOML for them."""
    sources = write_all(tmp_path)
    path, robot = tmp_path / "own.onnx", load("v3")
    path.write_bytes(made.dense_onnx([(np.zeros((inputs or 36, 12)), np.zeros(12))], "Tanh"))
    if not inputs:
        path.with_suffix(".toml").write_text(
            'observation = ["angular-velocity", "gravity", "command", "up-command",'
            ' "joint-positions", "last-action"]\n'
        )
    deployment = read_deployment(robot, [sources[name] for name in names], path)
    contract = Policy.load(path, deployment=deployment).contract
    assert contract.joints == tuple(JOINTS)
    assert contract.default == pytest.approx(ANGLES)
    assert contract.action_scale == pytest.approx(np.full(12, 0.75))
    assert contract.kp == pytest.approx(np.full(12, 5.0))
    assert contract.rate == pytest.approx(50.0)
    if inputs:
        terms = ["angular-velocity", "joint-positions", "last-action"]
        assert [term.name for term in contract.terms] == terms
        assert contract.terms[0].scale == 0.25


@pytest.mark.parametrize(("joints", "is_read"), [('[".*"]', True), ('[".*_1"]', False)])
def test_observation_of_some_joints_is_refused(tmp_path: Path, joints: str, is_read: bool) -> None:
    """Isaac Lab observes only the joints of ``asset_cfg``: 4 numbers, not 12."""
    source, path, robot = write_all(tmp_path)["mjlab_cfg.py"], tmp_path / "own.onnx", load("v3")
    path.write_bytes(made.dense_onnx([(np.zeros((27, 12)), np.zeros(12))], "Tanh"))
    selected = f'params={{"asset_cfg": SceneEntityCfg("robot", joint_names={joints})}}'
    rewrite_file(source, ("mdp.joint_pos_rel)", f"mdp.joint_pos_rel, {selected})"))
    if is_read:
        deployment = read_deployment(robot, [source], path)
        assert [term.name for term in deployment.observations][1] == "joint_pos_rel"
    else:
        with pytest.raises(ModelError, match="joint_names of the observation term angles"):
            read_deployment(robot, [source], path)


STACKED = """
policy:
  policy_dt: 0.02
  joint_ids_map: [6, 7, 8, 9, 10, 11, 0, 1, 2, 3, 4, 5]
  stiffness: {kp}
  damping: {kd}
  actions:
    JointPositionAction: {{process_order: [scale, offset], scale: 0.75, offset: {angles}}}
  observations:
    stack: {{length: 2, order: {order}_first}}
    terms:
      base_ang_vel_B: {{process_order: [scale, clip], scale: 0.25, min: -2.0, max: 2.0}}
      projected_gravity:
      velocity_commands: {{process_order: [clip, scale], min: -1, max: 1, scale: [2.0, 2.0, 0.25]}}
      joint_pos: {{process_order: [offset], offset: {reference}}}
      last_action:
"""


def make_stacked(order: str = "oldest") -> str:
    """Return a file of legged_rl_deploy with gains that differ by joint."""
    kp = [5.0, 6.0, 7.0] * 2 + [8.0, 9.0, 10.0] * 2
    reference = [-angle / 2 for angle in ANGLES]
    return STACKED.format(kp=kp, kd=[0.25] * 12, angles=ANGLES, reference=reference, order=order)


@pytest.mark.parametrize("order", ["oldest", "newest"])
def test_terms_in_frames_are_read_as_legged_rl_deploy_reads_them(
    tmp_path: Path, order: str
) -> None:
    """References: ``Processor::process`` and ``PolicySlot``: the offset is added, a term without a
    table is unchanged, gains are in the policy's order, and the bounds follow the scale.
    """
    policy, deploy = write_policy(tmp_path), tmp_path / "config.yaml"
    kp = [5.0, 6.0, 7.0] * 2 + [8.0, 9.0, 10.0] * 2
    deploy.write_text(make_stacked(order))
    contract = Policy.load(
        policy, deployment=read_deployment(load("v3"), [deploy], policy)
    ).contract
    assert [term.name for term in contract.terms] == [
        "angular-velocity", "gravity", "command", "joint-positions", "last-action"
    ]  # fmt: skip
    assert contract.terms[0].scale == 0.25
    assert [term.clip for term in contract.terms[:3]] == [
        (-8.0, 8.0), (-math.inf, math.inf), (-1.0, 1.0)
    ]  # fmt: skip
    assert (contract.history, contract.layout) == (2, "by-frame")
    assert contract.newest_first is (order == "newest")
    assert contract.default == pytest.approx(np.divide(ANGLES, 2))
    assert contract.offset == pytest.approx(ANGLES)
    assert contract.kp == pytest.approx(kp)
    assert contract.rate == pytest.approx(50.0)


ANGULAR = "base_ang_vel_B: {process_order: [scale, clip], "
COMMANDS = "process_order: [clip, scale], min: -1, max: 1"


@pytest.mark.parametrize(
    ("old", "new", "term", "scale", "clip"),
    [
        (ANGULAR, "base_ang_vel_B: {process_order: [clip], ", 0, 1.0, (-2.0, 2.0)),
        (ANGULAR, "base_ang_vel_B: {", 0, 1.0, (-math.inf, math.inf)),
        (COMMANDS, COMMANDS.replace("-1", "[-1, -1, -1]"), 2, [2.0, 2.0, 0.25], (-1.0, 1.0)),
        (COMMANDS, f"offset: 0.3, {COMMANDS}", 2, [2.0, 2.0, 0.25], (-1.0, 1.0)),
        (COMMANDS, COMMANDS.replace("[clip", "[offset, clip"), 2, [2.0, 2.0, 0.25], (-1.0, 1.0)),
    ],
)
def test_only_operations_of_the_process_order_are_applied(
    tmp_path: Path, old: str, new: str, term: int, scale: float, clip: tuple[float, float]
) -> None:
    """Reference: ``Processor::TryLoad`` of legged_rl_deploy."""
    policy, deploy = write_policy(tmp_path), tmp_path / "config.yaml"
    deploy.write_text(make_stacked().replace(old, new))
    contract = Policy.load(
        policy, deployment=read_deployment(load("v3"), [deploy], policy)
    ).contract
    assert np.array_equal(contract.terms[term].scale, scale)
    assert contract.terms[term].clip == clip


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            COMMANDS,
            f"offset: 0.3, {COMMANDS.replace('[clip', '[offset, clip')}",
            "offset of .*velo",
        ),
        (COMMANDS, COMMANDS.replace("-1", "[-1, -1, -2]"), "clip of .*velocity_commands"),
        ("[scale, clip], scale: 0.25", "[scale, clip], scale: [1, 2, 3]", "clip of .*base_ang_vel"),
        ("[scale, clip], scale: 0.25", "[scale, clip], scale: '0.25'", "scale of .*base_ang_vel"),
        ("pos: {process_order: [", "pos: {process_order: [clip, ", "offset of .*joint_pos"),
    ],
)
def test_operation_that_a_contract_cannot_contain_is_refused(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    deploy = tmp_path / "config.yaml"
    text = make_stacked()
    assert old in text
    deploy.write_text(text.replace(old, new))
    with pytest.raises(ModelError, match=rf"config.yaml:\d+: {message}"):
        read_deployment(load("v3"), [deploy])


def test_histories_that_do_not_fit_the_network_are_refused(tmp_path: Path) -> None:
    policy, deploy = write_policy(tmp_path), tmp_path / "deploy.yaml"
    deploy.write_text(make_deploy().replace("history_length: 2", "history_length: 3", 1))
    with pytest.raises(ModelError, match=r"angular-velocity 3 x 3, .* has 69 numbers"):
        Policy.load(policy, deployment=read_deployment(load("v3"), [deploy], policy))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "5.0,",
            "'5.0',",
            "deploy.yaml:3: kp is '5.0', not a finite number; write a .* and unit$",
        ),
        ("'0.02'", "0.02 s", "deploy.yaml:2: policy step is '0.02 s'"),
        ("leg_front_r_2", "leg_front_r_1", "deploy.yaml:1: duplicate names leg_front_r_1"),
    ],
)
def test_deployment_with_a_value_that_is_no_number_is_refused(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    """The walk used the number of the policy file or of the robot instead."""
    deploy = tmp_path / "deploy.yaml"
    deploy.write_text(make_deploy(step_dt="'0.02'").replace(old, new, 1).replace("'0.02'", "0.02"))
    with pytest.raises(ModelError, match=message):
        read_deployment(load("v3"), [deploy])


def test_disagreement_of_deployment_and_policy_is_a_remark(tmp_path: Path) -> None:
    """The number of the deployment is simulated."""
    policy, deploy = tmp_path / "policy.onnx", tmp_path / "deploy.yaml"
    metadata = {"joint_names": ",".join(JOINTS), "joint_stiffness": ",".join(["9.0"] * 12)}
    layers = [(np.zeros((2 * sum(SIZES), 12)), np.zeros(12))]
    policy.write_bytes(made.dense_onnx(layers, "Tanh", metadata))
    deploy.write_text(make_deploy())
    found = Policy.load(policy, deployment=read_deployment(load("v3"), [deploy], policy))
    assert found.contract.kp == pytest.approx(np.full(12, 5.0))
    assert "deployment-differs" in {note.code for note in found.notes}


def test_accelerometer_and_contacts_equal_mujoco_sensors() -> None:
    """References: accelerometer of a site at the base, and touch sensors of the feet."""
    robot = load("v3")
    spec = mujoco.MjSpec.from_file(str(robot.description.mjcf_source))
    spec.body("base_link").add_site(name="eye")
    kind = mujoco.mjtSensor.mjSENS_ACCELEROMETER
    spec.add_sensor(name="imu", type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname="eye")
    policy = make_term_policy(("accelerometer", "contacts", "phase-sine", "phase-cosine"), feet=4)
    stage = prepare_stage(robot, policy)
    model = spec.compile()
    model.actuator_gainprm[:], model.actuator_biasprm[:] = (
        stage.model.actuator_gainprm, stage.model.actuator_biasprm
    )  # fmt: skip
    model.actuator_forcerange[:] = stage.model.actuator_forcerange
    data, qpos = mujoco.MjData(model), stage.default.copy()
    qpos[2] -= 0.002
    qpos[3:7] = np.array([1.0, 0.02, 0.0, 0.3]) / np.linalg.norm([1.0, 0.02, 0.0, 0.3])
    robot.mj_convention.set_state(data, qpos, 0.2 * np.ones(18))
    data.ctrl[:] = stage.ctrl
    mujoco.mj_forward(model, data)
    observer = Observer(stage, np.zeros((1, 3)))
    seen = observer.observe(full_state(model, data)[None], np.array([0]), 0)[0]
    assert seen[:3] == pytest.approx(data.sensor("imu").data, abs=1e-6)
    touching = {
        int(geom) for contact in data.contact[: data.ncon] for geom in contact.geom
    } & robot.foot_geoms.keys()
    feet = {robot.foot_geoms[geom] for geom in touching}
    assert seen[3:7].tolist() == [float(foot in feet) for foot in robot.feet]
    assert 0 < len(feet) < 4
    assert seen[7:] == pytest.approx([0.0, 1.0])  # the phase at the start: sine, cosine


def make_term_policy(names: tuple[str, ...], feet: int = 0) -> Policy:
    """Return the standing policy with other terms; its network is not evaluated."""
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        policy = Policy.load(made.write_standing_policy(Path(folder) / "still.json"))
    contract = replace(
        policy.contract, terms=tuple(map(ObservationTerm, names)), history=1, feet=feet
    )
    return replace(policy, contract=contract)


def test_parts_of_terms_equal_the_terms() -> None:
    """Command and phase in parts; the action before the last."""
    stage = prepare_stage(load("v3"), make_term_policy(("command", "phase", "last-action")))
    names = ("command-velocity", "command-turning", "phase-cosine", "phase-sine",
             "second-last-action")  # fmt: skip
    parts = replace(stage, policy=make_term_policy(names))
    state = np.zeros((1, 1 + stage.model.nq + stage.model.nv))
    state[0, 4] = 1.0
    commands = np.array([[0.1, 0.2, 0.3]])
    whole, split = Observer(stage, commands), Observer(parts, commands)
    split.second_last[0] = np.arange(12)
    whole.last[0] = np.arange(12)
    active = np.array([0])
    assert (whole.observe(state, active, 3) == split.observe(state, active, 3)).all()


@pytest.mark.parametrize("newest_first", [False, True])
def test_terms_with_different_histories_are_as_in_isaac_lab(
    tmp_path: Path, newest_first: bool
) -> None:
    """Reference: a queue per term, filled with its first value, as Isaac Lab's CircularBuffer."""
    lengths, policy, deploy = [3, 1, 2, 4, 1], tmp_path / "policy.onnx", tmp_path / "deploy.yaml"
    inputs = sum(size * length for size, length in zip(SIZES, lengths, strict=True))
    policy.write_bytes(made.dense_onnx([(np.zeros((inputs, 12)), np.zeros(12))], "Tanh"))
    parts = make_deploy().split("history_length: 2")
    stated = [f"{part}history_length: {n}" for part, n in zip(parts, lengths, strict=False)]
    deploy.write_text("".join(stated) + parts[-1])
    robot = load("v3")
    found = Policy.load(policy, deployment=read_deployment(robot, [deploy], policy))
    assert [found.contract.count_frames(term) for term in found.contract.terms] == lengths
    found = found.with_contract(newest_first=newest_first)
    stage = prepare_stage(robot, found)
    terms = tuple(replace(term, history=0) for term in found.contract.terms)
    frames = replace(stage, policy=found.with_contract(terms=terms, history=1))
    commands = np.zeros((1, 3))
    whole, single = Observer(stage, commands), Observer(frames, commands)
    queues: list[deque[list[float]]] = [deque(maxlen=length) for length in lengths]
    rng, size = np.random.default_rng(2), 1 + stage.model.nq + stage.model.nv
    for tick in range(6):
        state = rng.normal(size=(1, size))
        state[0, 4:8] /= np.linalg.norm(state[0, 4:8])
        commands[:], whole.last[:] = rng.normal(size=(1, 3)), rng.normal(size=(1, 12))
        single.last[:] = whole.last
        frame = single.observe(state, np.array([0]), tick)[0]
        for queue, part in zip(queues, np.split(frame, np.cumsum(SIZES)[:-1]), strict=True):
            queue.extend([part.tolist()] * (1 if queue else queue.maxlen or 1))
        expected = [
            value
            for queue in queues
            for row in (reversed(queue) if newest_first else queue)
            for value in row
        ]
        assert whole.observe(state, np.array([0]), tick)[0].tolist() == expected


def test_layout_by_frame_with_different_histories_is_refused(tmp_path: Path) -> None:
    policy, toml = write_policy(tmp_path), tmp_path / "own.toml"
    toml.write_text(TOML.replace('"joint-positions",', '{term = "joint-positions", history = 3},')
                    + 'layout = "by-frame"\n')  # fmt: skip
    with pytest.raises(ModelError, match="by-frame requires one length"):
        Policy.load(policy, toml)
    toml.write_text(
        TOML.replace('"joint-positions",', '{term = "joint-positions", history = 1.5},')
    )
    with pytest.raises(ModelError, match=r"1\.5"):
        Policy.load(policy, toml)


def test_template_states_known_keys_and_lists_missing_keys(tmp_path: Path) -> None:
    """Without the comment signs of known keys, the template equals the files."""
    policy, deploy, robot = write_policy(tmp_path), tmp_path / "deploy.yaml", load("v3")
    path, missing = write_template(policy, robot)
    assert path == tmp_path / "policy.toml"
    assert missing == ("observation", "default", "action-scale", "rate")
    assert tomllib.loads(path.read_text()) == {}
    text = path.read_text()
    assert "# rate =   # unknown: complete this line" in text
    path.unlink()
    deploy.write_text(make_deploy())
    path, missing = write_template(policy, robot, read_deployment(robot, [deploy], policy))
    assert missing == ()
    lines = [line.removeprefix("# ") for line in path.read_text().splitlines()
             if " = " in line and "stated: " in line]  # fmt: skip
    path.write_text("\n".join(lines))
    stated = Policy.load(policy).contract
    path.unlink()
    found = Policy.load(policy, deployment=read_deployment(robot, [deploy], policy)).contract
    for key in ("default", "action_scale", "kp", "kd", "effort", "rate", "history", "joints"):
        assert np.array_equal(getattr(stated, key), getattr(found, key)), key
    assert [term.name for term in stated.terms] == [term.name for term in found.terms]


def test_words_are_separated_into_robot_policy_and_deployment(tmp_path: Path) -> None:
    words = ("v3", "deploy.yaml", "env.py:ROBOT", "policy.onnx")
    assert split_sources(words) == (("v3",), words[1:])
    assert select_policy(None, words[1:]) == (Path("policy.onnx"), words[1:3])
    folder = tmp_path / "params"
    folder.mkdir()
    (tmp_path / "exported").mkdir()
    beside = tmp_path / "exported/policy.onnx"
    beside.write_bytes(b"")
    deploy = str(folder / "deploy.yaml")
    assert select_policy(None, (deploy,)) == (folder.parent / "exported/policy.onnx", (deploy,))
    (folder / "other.onnx").write_bytes(b"")
    with pytest.raises(ConfigurationError, match="exactly one policy"):
        select_policy(None, (deploy,))
    with pytest.raises(ConfigurationError, match="exactly one policy"):
        select_policy(Path("a.onnx"), ("b.onnx",))


@pytest.mark.slow
def test_command_reads_a_deployment_and_prints_sources(
    capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    policy, deploy = write_policy(tmp_path), tmp_path / "deploy.yaml"
    deploy.write_text(make_deploy())
    words = ("walk", "v3", str(deploy), "--command", "0,0,0", "--seconds", "3", "-v")
    _, out, err = run_command(capfd, *words, "--effort", "2")
    assert "by policy.onnx" in out, err
    assert "deploy.yaml:3" in out
    assert "--effort" in out
    assert "evidence: run in simulation" in out
    status, out, err = run_command(capfd, "walk", "v3", str(policy), "--init")
    assert (status, err) == (0, "")
    assert "complete the lines of observation, default" in out
    (tmp_path / "policy.toml").write_text("rate = 50\n")
    status, _, err = run_command(capfd, "walk", "v3", str(policy), "--init")
    assert status == 2, err
    assert (tmp_path / "policy.toml").read_text() == "rate = 50\n"


@pytest.mark.slow
def test_unlimited_motor_is_not_at_its_limit(tmp_path: Path) -> None:
    """No limit is stated, so no fraction of the time is printed."""
    policy, toml, robot = write_policy(tmp_path), tmp_path / "policy.toml", load("v3")
    toml.write_text(TOML)
    walk = simulate_walk(robot, Policy.load(policy), (0, 0, 0), seconds=3.0)
    gait = replace(walk.gaits[0], at_limit=np.full(12, np.nan))
    unlimited = replace(walk, limits=np.full(12, np.inf), gaits=(gait,))
    shown = str(walk_document(unlimited, robot).findings)
    assert "N m peak, no limit stated" in shown


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("stiffness", [20.0] * 11, "kp has 11 values, but the joint order in .*:1 has 12 joints"),
        ("joint_ids_map", list(range(11)), "11 motor numbers, but the joint order in .*:1 has 12"),
    ],
)
def test_list_of_another_length_than_the_joint_order_is_refused(
    tmp_path: Path, key: str, value: list[float], message: str
) -> None:
    """The message named a missing kp; motor numbers were ignored without a message."""
    deploy = tmp_path / "deploy.yaml"
    text = make_deploy(**{key: str(value)})
    deploy.write_text(text)
    line = 1 + next(i for i, row in enumerate(text.splitlines()) if row.startswith(key))
    with pytest.raises(ModelError, match=rf"deploy\.yaml:{line}: {message}"):
        read_deployment(load("v3"), [deploy])


def test_two_deployments_with_different_joint_orders_are_refused(tmp_path: Path) -> None:
    """The walk used the order of the first file on the command line."""
    first, second = tmp_path / "first.yaml", tmp_path / "second.yaml"
    first.write_text(make_deploy())
    order = [*JOINTS[3:6], *JOINTS[:3], *JOINTS[6:]]
    second.write_text(make_deploy().replace(format_list(JOINTS), format_list(order)))
    for files in ((first, second), (second, first)):
        with pytest.raises(ModelError, match=rf"{files[1].name}:1: .*{files[0].name}:1"):
            read_deployment(load("v3"), files)
    motors = tmp_path / "motors.yaml"  # stands between the two on the command line
    motors.write_text(make_deploy(joint_ids_map=str(list(range(12)))))
    with pytest.raises(ModelError, match=r"second\.yaml:1: .*first\.yaml:1"):
        read_deployment(load("v3"), [first, motors, second])
    second.write_text(make_deploy())
    assert read_deployment(load("v3"), [first, second]).joints == tuple(JOINTS)


def test_model_among_the_files_of_a_deployment_is_refused(tmp_path: Path) -> None:
    """It ended in a ValueError of Python."""
    model = tmp_path / "model.xml"
    model.write_text(
        '<mujoco><worldbody><body><joint name="leg_front_r_1"/><geom size="1"/></body></worldbody>'
        "</mujoco>"
    )
    with pytest.raises(ModelError, match=r"model\.xml: the file is a robot model, and v3 is"):
        read_deployment(load("v3"), [model])


@pytest.mark.parametrize("content", ['{"layers": []}', "{", None])
def test_deployment_is_read_if_the_policy_states_nothing(
    tmp_path: Path, content: str | None
) -> None:
    """The reader of the network reports its error; the deployment does not depend on it."""
    deploy, policy = tmp_path / "deploy.yaml", tmp_path / "policy.json"
    deploy.write_text(make_deploy())
    if content is not None:
        policy.write_text(content)
    assert read_deployment(load("v3"), [deploy], policy).joints == tuple(JOINTS)


def test_missing_key_names_the_policy_file(tmp_path: Path) -> None:
    """The message began with a colon, since a key without a place named no file."""
    stated = {"observation": ["joint-positions"], "default": 0.0, "action-scale": 0.5}
    with pytest.raises(ModelError, match=r"^p\.onnx: .*rate"):
        make_contract(Path("p.onnx"), [Statements("x.toml", stated)], 12, 12)
