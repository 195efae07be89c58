"""Sources of Pupper v3 in each format, into which tests plant mistakes."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).parents[3]
URDF, MJCF = ROOT / "urdf/pupper_v3.urdf", ROOT / "mjcf/pupper_v3.xml"

JOINTS = [f"leg_{leg}_{number}" for leg in ("front_r", "front_l", "back_r", "back_l")
          for number in (1, 2, 3)]  # fmt: skip
ANGLES = [0.26, 0.0, -0.52, -0.26, 0.0, 0.52] * 2

MJLAB = """
from robot_library import EntityCfg, EntityArticulationInfoCfg, BuiltinPositionActuatorCfg
from robot_library import JointPositionActionCfg, ManagerBasedRlEnvCfg, ObsTerm
import mdp
from .motors import STIFFNESS, torque

LIMIT = torque(gear=2.0)
LEGS = BuiltinPositionActuatorCfg(
    target_names_expr=("leg_.*",),
    stiffness=STIFFNESS,
    damping=0.25,
    effort_limit=LIMIT,
)
HOME = EntityCfg.InitialStateCfg(
    joint_pos={
        "leg_.*_r_1": 0.26,
        "leg_.*_l_1": -0.26,
        "leg_.*_r_3": -0.52,
        "leg_.*_l_3": 0.52,
    },
)
ROBOT = EntityCfg(init_state=HOME, articulation=EntityArticulationInfoCfg(actuators=(LEGS,)))
SCALE = {}
for motor in ROBOT.articulation.actuators:
    for name in motor.target_names_expr:
        SCALE[name] = 0.5 * motor.effort_limit / motor.stiffness + 0.45


def walking(play: bool = False) -> ManagerBasedRlEnvCfg:
    cfg = ManagerBasedRlEnvCfg(
        scene={"entities": {"robot": ROBOT}},
        actions={"joint_pos": JointPositionActionCfg(actuator_names=(".*",), scale=0.5)},
        observations={"policy": {"terms": {
            "gyro": ObsTerm(func=mdp.base_ang_vel, scale=0.25),
            "angles": ObsTerm(func=mdp.joint_pos_rel),
            "last": ObsTerm(func=mdp.last_action),
        }}},
        sim={"dt": 0.005},
        decimation=4,
    )
    cfg.actions["joint_pos"].scale = SCALE
    if play:
        cfg.decimation = 1
    return cfg
"""

MOTORS = """
STIFFNESS = 10.0 / 2


def torque(gear, amps=1.5):
    return gear * amps
"""

ISAAC = """
from isaaclab.actuators import DCMotorCfg
from isaaclab.assets import ArticulationCfg
PUPPER_CFG = ArticulationCfg(
    init_state=ArticulationCfg.InitialStateCfg(
        joint_pos={
            "leg_.*_r_1": 0.26, "leg_.*_l_1": -0.26, "leg_.*_2": 0.0,
            "leg_.*_r_3": -0.52, "leg_.*_l_3": 0.52,
        },
    ),
    actuators={
        "legs": DCMotorCfg(
            joint_names_expr=["leg_.*"],
            effort_limit=3.0,
            stiffness={"leg_.*": 5.0},
            damping=0.25,
        ),
    },
)
"""

GYM = """
from legged_gym.envs.base.legged_robot_config import LeggedRobotCfg
class BaseCfg(LeggedRobotCfg):
    class control(LeggedRobotCfg.control):
        stiffness = {"leg": 4.0}
        decimation = 4
    class sim:
        dt = 0.005
class PupperCfg(BaseCfg):
    class init_state(BaseCfg.init_state):
        default_joint_angles = {ANGLES}
    class control(BaseCfg.control):
        stiffness = {"leg": 5.0}
        damping = {"leg": 0.25}
        action_scale = 0.75
""".replace(
    "{ANGLES}", "{" + ", ".join(f"'{j}': {a}" for j, a in zip(JOINTS, ANGLES, strict=True)) + "}"
)


def format_list(values: object) -> str:
    return "[" + ", ".join(map(str, values)) + "]"  # type: ignore[call-overload]


DEPLOY = f"""
joint_ids_map: {format_list(range(12))}
step_dt: 0.02
stiffness: {format_list([5.0] * 12)}
damping: {format_list([0.25] * 12)}
default_joint_pos: {format_list(ANGLES)}
actions:
  JointPositionAction:
    scale: {format_list([0.75] * 12)}
    offset: {format_list(ANGLES)}
observations:
  base_ang_vel:
    scale: [0.25, 0.25, 0.25]
  joint_pos_rel:
    scale: [1.0]
  last_action:
    scale: [1.0]
"""

ROS = f"""
controller_manager:
  ros__parameters:
    update_rate: 500
walker:
  ros__parameters:
    repeat_action: 10
    joint_names: {format_list(JOINTS)}
    default_joint_pos: {format_list(ANGLES)}
    init_kps: {format_list([7.5] * 12)}
    kps: {format_list([5.0] * 12)}
    kds: {format_list([0.25] * 12)}
"""

RTNEURAL = f"""{{
"kp": 5.0, "kd": 0.25, "action_scale": 0.75,
"default_joint_pos": {format_list(ANGLES)},
"in_shape": [null, 36], "layers": []
}}
"""

MOVEIT = """
joint_limits:
  leg_front_r_1: {has_effort_limits: true, max_effort: 3.0, has_velocity_limits: false,
    max_velocity: 1.0}
  leg_front_r_2: {has_effort_limits: true, max_effort: 3.0}
"""


UNITREE_GYM = f"""policy_path: "{{DIR}}/policy.pt"
simulation_dt: 0.005
control_decimation: 4
kps: {format_list([5] * 12)}
kds: {format_list([0.25] * 12)}
default_angles: {format_list(ANGLES)}
ang_vel_scale: 0.25
action_scale: 0.75
cmd_scale: [2.0, 2.0, 0.25]
num_actions: 12
"""


def varint(value: int) -> bytes:
    """Return an integer as Protocol Buffers write it: seven bits a byte, the least first."""
    value &= (1 << 64) - 1
    out = bytearray()
    while value > 127:
        out.append(value & 127 | 128)
        value >>= 7
    out.append(value)
    return bytes(out)


def field(number: int, value: int | bytes | str) -> bytes:
    """Return a field of a message: an integer, or bytes with their length."""
    if isinstance(value, int):
        return varint(number << 3) + varint(value)
    data = value.encode() if isinstance(value, str) else value
    return varint(number << 3 | 2) + varint(len(data)) + data


def value(name: str, *sizes: int) -> bytes:
    """Return a ValueInfoProto: name (1), type (2: tensor 1: shape 2: dim 1: value 1)."""
    dims = b"".join(field(1, field(1, size) if size else field(2, b"batch")) for size in sizes)
    return field(1, name) + field(2, field(1, field(1, 1) + field(2, dims)))


def onnx(**metadata: str) -> bytes:
    """Return a model of Protocol Buffers with an opset and metadata, as ONNX has them."""
    model = b"\x08\x07"  # ir_version, a varint
    for key, text in metadata.items():
        model += field(14, field(1, key) + field(2, text))
    return model


ONNX = {
    "joint_names": ",".join(JOINTS),
    "default_joint_pos": ",".join(map(str, ANGLES)),
    "joint_stiffness": ",".join(["5.0"] * 12),
    "joint_damping": ",".join(["0.25"] * 12),
    "action_scale": ",".join(["0.75"] * 12),
    "observation_names": "base_ang_vel,joint_pos,actions",
}


def write_all(folder: Path) -> dict[str, Path]:
    """Write all sources, which agree with each other, and except for kd with v3."""
    package = folder / "training"
    package.mkdir(exist_ok=True)
    texts = {"training/__init__.py": "", "training/motors.py": MOTORS,
             "training/mjlab_cfg.py": MJLAB,
             "isaac_cfg.py": ISAAC, "gym_cfg.py": GYM, "deploy.yaml": DEPLOY,
             "config.yaml": ROS, "policy.json": RTNEURAL, "joint_limits.yaml": MOVEIT}  # fmt: skip
    for name, text in texts.items():
        (folder / name).write_text(text)
    (folder / "policy.onnx").write_bytes(onnx(**ONNX))
    names = [*texts, "policy.onnx"]
    return {Path(name).name: folder / name for name in names}
