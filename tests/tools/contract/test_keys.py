"""Keys of deployments of other families: small files with the keys of public repositories, for v3.

References: the numbers written into the files.
"""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

from pupper_analysis.base.errors import ModelError
from pupper_analysis.tools.contract import Contract, read_contract
from pupper_analysis.tools.contract.keys import load_key_rules
from tests.tools.contract.sources import ANGLES, JOINTS, MJCF, URDF, format_list, write_all

LEG_PARTS = {"_1": 0.26, "_3": -0.52}

PARTS_TRAINER = """
init_state:
  default_joint_angles: {"r_1": 0.26, "l_1": -0.26, "r_3": -0.52, "l_3": 0.52, "default": 0.0}
control:
  stiffness: {"leg": 5.0}
  damping: {"leg": 0.25}
  action_scale: 0.75
  decimation: 10
sim:
  dt: 0.002
normalization:
  dof_vel: 0.1
"""

SPREAD_DEPLOYMENT = f"""
common:
  dt: 0.002
  stiffness: {format_list([5.0] * 12)}
  damping: {format_list([0.25] * 12)}
  default_qpos: {format_list(ANGLES)}
policy:
  num_actions: 12
  normalization: {{dof_vel: 0.1}}
  control: {{action_scale: 0.75, decimation: 10}}
prepare:
  stiffness: {format_list([350.0] * 12)}
  damping: {format_list([7.5] * 12)}
  default_qpos: {format_list([0.1] * 12)}
"""

LIMITS_BY_NAME = "joint_effort_limit:\n" + "".join(f"  {name}: 3.0\n" for name in JOINTS)

CONTROLLERS = f"""
control_frequecy: 500
joint_list: {format_list(JOINTS)}
controllers:
  pd_stand:
    joint_list: {format_list(JOINTS)}
    init_state: {format_list([0.0] * 12)}
    stiffness: {format_list([300.0] * 12)}
    damping: {format_list([5.0] * 12)}
  rl_walk:
    joint_list: {format_list(JOINTS[::-1])}
    init_state: {format_list(ANGLES[::-1])}
    stiffness: {format_list([5.0] * 12)}
    damping: {format_list([0.25] * 12)}
    walk_step_conf: {{action_scale: 0.75, decimation: 10}}
    onnx_conf: {{policy_file: walk.onnx, actions_size: 12}}
"""

CONSTANTS = f"""
JOINT_NAME = {JOINTS!r}
MOTOR_DIR = {[1, -1] * 6!r}
DEFAULT_ANGLE = {ANGLES!r}
CONTROL_HZ = 50


class control:
    stiffness = {{"leg": 5.0}}
    damping = {{"leg": 0.25}}
    action_scale = 0.75
    decimation = 10
    dt = 0.002
"""

RUNNER = f"""
import numpy as np


class Cfg:
    class sim:
        dt = 0.002
        decimation = 10
        action_scale = 0.75
        num_action = 12


class MujocoRunner:
    def start(self):
        self.default_dof_pos = np.array({ANGLES!r})
"""

GROUPS = f"""
Cfg:
  init_state:
    joint_names: {format_list(JOINTS)}
    default_joint_angle: {{{", ".join(f"{n}: {a}" for n, a in zip(JOINTS, ANGLES, strict=True))}}}
  control:
    hip_gain: 5.0
    knee_gain: 5.0
    action_scale_pos: 0.75
    decimation: 10
"""

NEW_KEYS = """
[[contract.key]]
quantity = "kp"
names = ["hip_gain"]
joints = [".*_1", ".*_2"]
[[contract.key]]
quantity = "kp"
names = ["knee_gain"]
joints = [".*_3"]
"""


def compare(folder: Path, name: str, text: str, *more: Path) -> Contract:
    path = folder / name
    path.write_text(text)
    return read_contract(URDF, *more, path, stand=False)


def values(found: Contract, name: str, quantity: str) -> dict[str, float | None]:
    return {
        fact.joint: fact.value
        for fact in found.facts
        if fact.source.startswith(name) and fact.quantity == quantity
    }


@pytest.fixture
def trainer(tmp_path: Path) -> Path:
    return write_all(tmp_path)["gym_cfg.py"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "text", "stated"),
    [
        ("T1.yaml", SPREAD_DEPLOYMENT, ("default angle", "kp", "kd", "action scale")),
        ("x1.yaml", CONTROLLERS, ("default angle", "kp", "kd", "action scale")),
        ("parameters.py", CONSTANTS, ("default angle", "kp", "kd", "action scale", "sign")),
        ("sim2sim.py", RUNNER, ("default angle", "action scale")),
        ("real.yaml", LIMITS_BY_NAME, ("effort",)),
    ],
)
def test_keys_of_other_families_are_read_and_agree(
    tmp_path: Path, trainer: Path, name: str, text: str, stated: tuple[str, ...]
) -> None:
    found = compare(tmp_path, name, text, trainer)
    assert [finding.message for finding in found.findings] == []
    assert found.passed
    for quantity in stated:
        assert set(values(found, name, quantity)) == set(JOINTS), quantity
    if "kp" in stated:
        assert set(values(found, name, "kp").values()) == {5.0}
    if "action scale" in stated:
        assert values(found, name, "policy step") == {"": pytest.approx(0.02)}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "text", "old", "new", "kind"),
    [
        ("T1.yaml", SPREAD_DEPLOYMENT, "action_scale: 0.75", "action_scale: 0.5", "action scale"),
        ("T1.yaml", SPREAD_DEPLOYMENT, "decimation: 10", "decimation: 5", "policy step"),
        ("T1.yaml", SPREAD_DEPLOYMENT, "dof_vel: 0.1", "dof_vel: 0.05", "observation dof_vel"),
        ("T1.yaml", SPREAD_DEPLOYMENT, "0.26, 0.0, -0.52", "0.26, 0.0, -0.6", "default angle"),
        ("x1.yaml", CONTROLLERS, "action_scale: 0.75", "action_scale: 0.5", "action scale"),
        ("parameters.py", CONSTANTS, "-0.52", "0.52", "default angle"),
        ("sim2sim.py", RUNNER, "action_scale = 0.75", "action_scale = 0.25", "action scale"),
        ("real.yaml", LIMITS_BY_NAME, "_2: 3.0", "_2: 2.0", "effort"),
    ],
)
def test_slip_in_files_of_other_families_is_found(
    tmp_path: Path, name: str, text: str, old: str, new: str, kind: str
) -> None:
    trainer = tmp_path / "train.yaml"
    trainer.write_text(PARTS_TRAINER)
    assert old in text
    found = compare(tmp_path, name, text.replace(old, new, 1), trainer)
    assert {finding.kind for finding in found.findings if finding.probable_mistake != "mirror"} >= {
        kind
    }
    (place,) = {
        finding.places[0 if kind == "effort" else 1] for finding in found.findings
        if finding.kind == kind and finding.probable_mistake != "mirror"
    }  # fmt: skip
    assert str(tmp_path / name) in place


def test_parts_of_names_select_joints_and_the_rest_has_a_default(tmp_path: Path) -> None:
    """As in booster_gym: the key is a part of the name; "default" is for the other joints."""
    found = compare(tmp_path, "train.yaml", PARTS_TRAINER)
    assert values(found, "train.yaml", "default angle") == dict(zip(JOINTS, ANGLES, strict=True))
    text = PARTS_TRAINER.replace('{"leg": 5.0}', '{"front": 5.0}')
    partly = values(compare(tmp_path, "train.yaml", text), "train.yaml", "default angle")
    # The rest is that of the joints with gains: the middle joints of the hind legs have none.
    assert set(JOINTS) - set(partly) == {"leg_back_r_2", "leg_back_l_2"}


def test_gains_for_standing_are_not_compared(tmp_path: Path, trainer: Path) -> None:
    for name, text in (("T1.yaml", SPREAD_DEPLOYMENT), ("x1.yaml", CONTROLLERS)):
        found = compare(tmp_path, name, text, trainer)
        gains = {fact.value for fact in found.facts if fact.quantity == "kp"}
        assert gains == {5.0}


MOTOR_GROUPS = """
Tron2Cfg:
  init_state:
    joint_names: [proximal_pitch_L_Joint, proximal_yaw_L_Joint, knee_L_Joint, wheel_L_Joint]
  control:
    leg_joint_stiffness: 159.67
    leg_joint_damping: 10.16
    light_joint_stiffness: 53.22
    light_joint_damping: 3.39
    wheel_joint_damping: 0.6
    action_scale_pos: 0.25
    action_scale_vel: 1.0
    leg_joint_torque_limit: 140.0
    light_joint_torque_limit: 40.0
    wheel_joint_torque_limit: 22.0
"""


def test_numbers_of_motor_groups_are_those_of_their_joints(tmp_path: Path) -> None:
    """As in limx tron2_rl_deploy: legs, light motors (yaw) and wheels, which have a velocity."""
    path, names = tmp_path / "params.yaml", ("pitch", "yaw", "knee", "wheel")
    joints = "".join(
        f'<body><joint name="{"proximal_" * (name in names[:2])}{name}_L_Joint" axis="0 1 0"/>'
        '<geom size="0.1"/></body>' for name in names
    )  # fmt: skip
    mjcf = tmp_path / "robot.xml"
    mjcf.write_text(f"<mujoco><worldbody>{joints}</worldbody></mujoco>")
    path.write_text(MOTOR_GROUPS)
    found = read_contract(mjcf, path, stand=False)
    stated = {
        "kp": (159.67, 53.22, 159.67),
        "kd": (10.16, 3.39, 10.16, 0.6),
        "effort": (140.0, 40.0, 140.0, 22.0),
        "action scale": (0.25, 0.25, 0.25),
    }
    order = ("proximal_pitch_L_Joint", "proximal_yaw_L_Joint", "knee_L_Joint", "wheel_L_Joint")
    for quantity, numbers in stated.items():
        expected = dict(zip(order, numbers, strict=False))  # the wheel has no angle
        assert values(found, "params.yaml", quantity) == expected, quantity


def test_policies_of_one_file_are_compared_with_the_trainer_only(
    tmp_path: Path, trainer: Path
) -> None:
    other = CONTROLLERS.partition("  rl_walk:")[2].replace("5.0", "7.0")
    text = f"{CONTROLLERS}  rl_run:{other}"
    assert compare(tmp_path, "x1.yaml", text).findings == ()
    found = compare(tmp_path, "x1.yaml", text, trainer)
    assert {finding.sources[1] for finding in found.findings} == {"x1.yaml:controllers/rl_run"}


def test_keys_of_a_user_are_read_from_the_configuration(tmp_path: Path, trainer: Path) -> None:
    """Groups of joints, which no built-in entry has; without the entries no gain is read."""
    assert not values(compare(tmp_path, "params.yaml", GROUPS, trainer), "params.yaml", "kp")
    (tmp_path / "pupper-analysis.toml").write_text(NEW_KEYS)
    found = compare(tmp_path, "params.yaml", GROUPS, trainer)
    assert values(found, "params.yaml", "kp") == dict.fromkeys(JOINTS, 5.0)
    assert found.findings == ()
    changed = compare(tmp_path, "params.yaml", GROUPS.replace("knee_gain: 5", "knee_gain: 9"))
    assert {joint for joint, kp in values(changed, "params.yaml", "kp").items() if kp == 9.0} == {
        joint for joint in JOINTS if joint.endswith("_3")
    }


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ('quantity = "stiff"\nnames = ["a"]', "stiff"),
        ('quantity = "kp"\nnames = "a"', "names"),
        ('quantity = "kp"\nnames = ["a"]\nmatch = "all"', "match"),
        ('quantity = "kp"\nnames = ["a"]\ngroup = ["b"]', "group"),
    ],
)
def test_invalid_entry_of_the_configuration_is_refused(
    tmp_path: Path, entry: str, message: str
) -> None:
    (tmp_path / "pupper-analysis.toml").write_text(f"[[contract.key]]\n{entry}\n")
    with pytest.raises(ModelError, match=message):
        compare(tmp_path, "params.yaml", GROUPS)


UNKNOWN_KEYS = f"""
motor_order: {format_list(JOINTS[::-1])}
pd: {{p: {format_list([5.0 + k for k in range(12)])}, d: 0.25}}
rest_pose: {format_list(ANGLES[::-1])}
feet: [a, b, c, d]
"""

USER_KEYS = """
[[contract.key]]
quantity = "kp"
names = ["pd.p"]
[[contract.key]]
quantity = "default angle"
names = ["rest_pose"]
"""


@pytest.mark.parametrize("is_stated", [False, True])
def test_lists_have_the_order_of_the_names_in_the_file_whatever_their_key(
    tmp_path: Path, is_stated: bool
) -> None:
    """Reference: the positions in the lists. The order is found, or a key of the user states it."""
    path = tmp_path / "own.yaml"
    path.write_text(UNKNOWN_KEYS)
    order = '[[contract.key]]\nquantity = "joint order"\nnames = ["motor_order"]\n'
    (tmp_path / "pupper-analysis.toml").write_text(USER_KEYS + order * is_stated)
    found = read_contract(MJCF, path, stand=False)
    stated = {
        (fact.quantity, fact.joint): fact for fact in found.facts if fact.source == "own.yaml"
    }
    for number, joint in enumerate(JOINTS[::-1]):
        assert stated["kp", joint].value == 5.0 + number
        assert stated["default angle", joint].value == ANGLES[::-1][number]
        assert stated["kp", joint].origin == "stated"
    codes = {note.code for note in found.notes}
    assert ("contract-order-of-key" in codes) is not is_stated


@pytest.mark.parametrize("name", ["gains.hip", "gains.Hip"])
def test_key_of_the_user_matches_capital_letters_of_a_file(tmp_path: Path, name: str) -> None:
    """The file states kp = 7 N m/rad under `Hip`, the model 5: the number was not compared."""
    path = tmp_path / "own.yaml"
    path.write_text(f"joint_names: {format_list(JOINTS)}\ngains: {{Hip: 7.0}}\n")
    (tmp_path / "pupper-analysis.toml").write_text(
        f'[[contract.key]]\nquantity = "kp"\nnames = ["{name}"]\njoints = [".*"]\n'
    )
    found = read_contract(MJCF, path, stand=False)
    assert set(values(found, "own.yaml", "kp").values()) == {7.0}
    assert not found.passed


def test_two_orders_of_names_under_unknown_keys_are_not_used(tmp_path: Path) -> None:
    """Nothing states which of the orders is that of the lists."""
    path = tmp_path / "own.yaml"
    path.write_text(UNKNOWN_KEYS + f"sim_order: {format_list(JOINTS)}\n")
    (tmp_path / "pupper-analysis.toml").write_text(USER_KEYS)
    with pytest.raises(ModelError, match="joint of each value is not specified"):
        read_contract(MJCF, path, stand=False)


def test_file_of_unknown_keys_is_refused_with_its_keys_and_the_remedy(tmp_path: Path) -> None:
    path = tmp_path / "own.yaml"
    path.write_text(UNKNOWN_KEYS)
    with pytest.raises(ModelError) as caught:
        read_contract(MJCF, path, stand=False)
    text = str(caught.value)
    assert "its keys are pd.p, rest_pose, pd.d" in text
    assert "pupper-analysis.toml" in text
    assert "[[contract.key]]" in text


def test_keys_of_no_joint_are_a_warning_if_another_source_states_the_joints(
    tmp_path: Path, trainer: Path
) -> None:
    """A compared quantity that vanishes is not passed over."""
    angles = "".join(f"  thigh{number}: {angle}\n" for number, angle in enumerate(ANGLES))
    text = f"joint_names: {format_list(JOINTS)}\nkps: {format_list([5.0] * 12)}\n"
    found = compare(tmp_path, "real.yaml", f"{text}torque_limits: {format_list([3.0] * 12)}\n")
    assert found.passed
    limits = "joint_effort_limit:\n" + angles
    lost = compare(tmp_path, "real.yaml", limits + f"kps: {format_list([5.0] * 12)}\n", trainer)
    (warning,) = lost.unread
    assert (warning.code, warning.severity) == ("contract-quantity-lost", "warning")
    assert "thigh0" in str(warning)
    assert not lost.passed


PLAIN = f"""joint_names: {format_list(JOINTS)}
step_dt: 0.02
stiffness: {format_list([5.0] * 12)}
default_joint_pos: {format_list(ANGLES)}
"""


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("[5.0", "['5.0'", "bad.yaml:3: kp is '5.0', not a finite number, and is ignored"),
        ("[5.0", "[5.0 Nm", "bad.yaml:3: kp is '5.0 Nm'"),
        ("[5.0", "[true", "bad.yaml:3: kp is 'True'"),
        (
            "[5.0",
            "[null",
            "bad.yaml:3: kp is null, .*, and is ignored; write a number without quot",
        ),
        ("[5.0", "[[5.0]", r"bad.yaml:3: kp is '\[...\]'"),
        ("0.26", ".nan", "bad.yaml:4: default angle is '.nan'"),
        ("0.02", "'0.02'", "bad.yaml:2: policy step is '0.02'"),
        ("0.02", "0x1", "bad.yaml:2: policy step is '0x1'"),
    ],
)
def test_value_that_is_no_number_is_a_warning_if_another_source_states_it(
    tmp_path: Path, trainer: Path, old: str, new: str, message: str
) -> None:
    """Such a value vanished without a word, and the files agreed."""
    assert compare(tmp_path, "bad.yaml", PLAIN, trainer).passed
    found = compare(tmp_path, "bad.yaml", PLAIN.replace(old, new, 1), trainer)
    (warning,) = found.unread
    assert re.match(message, str(warning))
    assert not found.passed
    # The name of a parameter is no number, and is meant to be none.
    assert not compare(tmp_path, "bad.yaml", PLAIN.replace("0.02", "dt"), trainer).unread


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "leg_front_r_2",
            "leg_front_r_1",
            "order of the numbers is unknown; list each joint once",
        ),
        ("joint_names: [", "joint_names: [3, ", "the joint names are not a list of names"),
    ],
)
def test_list_of_joints_that_is_not_valid_is_named_with_its_line(
    tmp_path: Path, trainer: Path, old: str, new: str, message: str
) -> None:
    found = compare(tmp_path, "bad.yaml", PLAIN.replace(old, new, 1), trainer)
    (text,) = [str(note) for note in (*found.unread, *found.notes) if message in str(note)]
    assert "bad.yaml:1" in text


def test_unreadable_source_is_named_and_the_others_are_compared(
    tmp_path: Path, trainer: Path
) -> None:
    bad = tmp_path / "notes.yaml"
    bad.write_text("made: today\n")
    found = compare(tmp_path, "T1.yaml", SPREAD_DEPLOYMENT.replace("0.75", "0.5"), trainer, bad)
    assert {finding.kind for finding in found.findings} == {"action scale"}
    (warning,) = found.unread
    assert warning.code == "contract-unread"
    assert "notes.yaml" in str(warning)
    sound = compare(tmp_path, "T1.yaml", SPREAD_DEPLOYMENT, trainer, bad)
    assert (sound.findings, sound.passed) == ((), False)
    with pytest.raises(ModelError, match="contains no number of joints"):
        read_contract(URDF, bad, stand=False)


def test_joint_damping_of_an_mjcf_that_is_the_kd_is_not_passive_damping(tmp_path: Path) -> None:
    """As in TienKung-Lab: the MJCF has torque motors, and the trainer's kd as joint damping."""
    joints = "".join(
        f'<body><joint name="{name}" axis="0 1 0" damping="2"/><geom size="0.1"/></body>'
        for name in ("hip", "knee")
    )
    motors = "".join(f'<motor joint="{name}"/>' for name in ("hip", "knee"))
    mjcf, urdf = tmp_path / "robot.xml", tmp_path / "robot.urdf"
    mjcf.write_text(
        f"<mujoco><worldbody>{joints}</worldbody><actuator>{motors}</actuator></mujoco>"
    )
    links = "".join(f'<link name="{name}_link"/>' for name in ("base", "hip", "knee"))
    tree = "".join(
        f'<joint name="{name}" type="continuous"><parent link="base_link"/>'
        f'<child link="{name}_link"/><axis xyz="0 1 0"/><dynamics damping="0"/></joint>'
        for name in ("hip", "knee")
    )
    urdf.write_text(f'<robot name="r">{links}{tree}</robot>')
    deploy = tmp_path / "deploy.yaml"
    deploy.write_text("joint_names: [hip, knee]\nkd: [2.0, 2.0]\n")
    found = read_contract(mjcf, urdf, deploy, stand=False)
    assert found.findings == ()
    assert "contract-damping-is-kd" in {note.code for note in found.notes}
    deploy.write_text("joint_names: [hip, knee]\nkd: [2.0, 3.0]\n")
    (finding,) = read_contract(mjcf, urdf, deploy, stand=False).findings
    assert (finding.kind, finding.joints) == ("damping", ("knee",))


def test_origin_of_each_number_is_stated(tmp_path: Path) -> None:
    """Stated, derived, framework's default and assumed order."""
    sources = write_all(tmp_path)
    found = read_contract(
        MJCF, sources["mjlab_cfg.py"], sources["gym_cfg.py"], sources["deploy.yaml"], stand=False
    )
    origins = {(f.source.partition(":")[0], f.quantity, f.joint): f for f in found.facts}
    default = origins["mjlab_cfg.py", "default angle", "leg_front_r_2"]
    assert (default.origin, default.basis) == ("default", "mjlab 1.6")
    assert origins["mjlab_cfg.py", "default angle", "leg_front_r_1"].origin == "stated"
    assert origins["mjlab_cfg.py", "action offset", "leg_front_r_1"].origin == "derived"
    assert origins["gym_cfg.py", "policy step", ""].origin == "derived"
    assert origins["deploy.yaml", "kp", "leg_front_r_1"].origin == "assumed"
    assert found.evidence == "parsed"
    text = sources["mjlab_cfg.py"].read_text()
    sources["mjlab_cfg.py"].write_text(
        text.replace(", scale=0.5)", ")").replace(
            '    cfg.actions["joint_pos"].scale = SCALE\n', ""
        )
    )
    without_scale = read_contract(MJCF, sources["mjlab_cfg.py"], stand=False)
    scales = {f.joint: f for f in without_scale.facts if f.quantity == "action scale"}
    assert {(f.value, f.origin, f.basis) for f in scales.values()} == {
        (1.0, "default", "mjlab 1.6")
    }


def test_slides_and_a_ball_of_the_base_are_no_joints_of_lists(tmp_path: Path) -> None:
    """As in MJCFs of humanoid-gym: three slides and a ball instead of a free joint."""
    base = "".join(
        f'<joint type="slide" axis="{axis}" limited="false"/>'
        for axis in ("1 0 0", "0 1 0", "0 0 1")
    )
    text = MJCF.read_text()
    assert text.count("<freejoint") == 1
    start = text.index("<freejoint")
    end = text.index("/>", start) + 2
    for file in MJCF.parent.glob("*.xml"):
        shutil.copy(file, tmp_path)
    (tmp_path / "meshes").symlink_to(MJCF.parent / "meshes")
    model, path = tmp_path / "own.xml", tmp_path / "own.yaml"
    model.write_text(f'{text[:start]}{base}<joint type="ball" limited="false"/>{text[end:]}')
    path.write_text(f"kps: {format_list([5.0] * 12)}\ndefault_angles: {format_list(ANGLES)}\n")
    found = read_contract(model, path, stand=False)
    angles = {fact.joint: fact.value for fact in found.facts
              if (fact.source, fact.quantity) == ("own.yaml", "default angle")}  # fmt: skip
    assert angles == dict(zip(JOINTS, ANGLES, strict=True))


LEGGED_LAB = """from isaaclab import ArticulationCfg, DCMotorCfg, EnvCfg, RobotCfg, SimCfg

LEGS = ArticulationCfg(
    init_state=ArticulationCfg.InitialStateCfg(joint_pos={".*": 0.0}),
    actuators={"legs": DCMotorCfg(joint_names_expr=[".*"], stiffness=5.0, damping=0.25)},
)
WALK = EnvCfg(
    scene=LEGS,
    robot=RobotCfg(action_scale=0.75),
    sim=SimCfg(dt=0.002, decimation=10),
)
"""


def test_scale_and_decimation_of_legged_lab_are_read(tmp_path: Path) -> None:
    """As in atom01_train and TienKung-Lab, whose actions are no terms of Isaac Lab."""
    path = tmp_path / "walk_cfg.py"
    path.write_text(LEGGED_LAB)
    found = read_contract(MJCF, f"{path}:WALK", stand=False)
    stated = {(fact.quantity, fact.joint): fact.value for fact in found.facts
              if fact.source.startswith("walk_cfg.py")}  # fmt: skip
    assert {stated["action scale", joint] for joint in JOINTS} == {0.75}
    assert stated["policy step", ""] == 0.02


def test_error_of_the_only_model_is_raised_if_other_sources_are_read(tmp_path: Path) -> None:
    """Not that there is no model."""
    model, path = tmp_path / "own.xml", tmp_path / "own.yaml"
    model.write_text("<mujoco>\n<worldbody></mujoco>")
    path.write_text(f"joint_names: {format_list(JOINTS)}\nkps: {format_list([5.0] * 12)}\n")
    with pytest.raises(ModelError, match=r"own\.xml:2: not well-formed"):
        read_contract(model, path, stand=False)


MAIN_BLOCK = f"""
import argparse

def run(cfg):
    return cfg

if __name__ == "__main__":
    args = argparse.ArgumentParser().parse_args()
    class Sim2simCfg:
        class sim_config:
            path = f"{{args.folder}}/robot.xml" if args.terrain else "robot.xml"
            dt = 0.002
            decimation = 10
        class robot_config:
            kps = np.array({[5.0] * 12}, dtype=np.double)
            default_pos = np.array({ANGLES}, dtype=np.double)
            tau_limit = 2.0
    run(Sim2simCfg())
"""


def test_constants_in_the_main_block_of_a_script_are_read(tmp_path: Path) -> None:
    """As in sim2sim scripts of humanoid-gym and atom01_train. Reference: the numbers above."""
    path = tmp_path / "sim2sim.py"
    path.write_text(MAIN_BLOCK)
    found = read_contract(MJCF, path, stand=False)
    stated = {(fact.quantity, fact.joint): fact.value for fact in found.facts
              if fact.source.startswith("sim2sim.py")}  # fmt: skip
    for joint, angle in zip(JOINTS, ANGLES, strict=True):
        assert stated["kp", joint] == 5.0
        assert stated["default angle", joint] == angle
        assert stated["effort", joint] == 2.0
    assert stated["policy step", ""] == 0.02
    imported = tmp_path / "other.py"
    imported.write_text("import sim2sim\nkps = sim2sim.Sim2simCfg.robot_config.kps\n")
    with pytest.raises(ModelError, match="no number of joints"):
        read_contract(MJCF, imported, stand=False)


def test_order_of_the_network_is_read_beside_that_of_the_simulator(tmp_path: Path) -> None:
    """As in go2_rl_gym, whose lists have the order of ``model_joint_names``."""
    text = f"mujoco_joint_names: {format_list(JOINTS)}\n"
    text += f"model_joint_names: {format_list(JOINTS[::-1])}\n"
    found = compare(tmp_path, "deploy.yaml", f"{text}default_angles: {format_list(ANGLES[::-1])}\n")
    stated = values(found, "deploy.yaml", "default angle")
    assert stated == pytest.approx(dict(zip(JOINTS, ANGLES, strict=True)))


@pytest.mark.parametrize("text", ["contract = 3\n", "contract = []\n", "[contract.key]\n"])
def test_a_contract_that_is_no_list_of_keys_is_refused(tmp_path: Path, text: str) -> None:
    """Without the error, the keys of the user would be missing silently."""
    (tmp_path / "pupper-analysis.toml").write_text(text)
    with pytest.raises(ModelError, match=re.escape("[[contract.key]]")):
        load_key_rules("table", tmp_path / "deploy.yaml")
