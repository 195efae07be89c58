"""Write sources of a robot in eight formats, with one number per line and a random mistake."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from tests.support import legged
from tests.tools.contract.sources import ANGLES, JOINTS, URDF, onnx

Lines = dict[tuple[str, str], int]
"""{(quantity, joint): line of the number}; the joint of ``order`` is empty."""

LISTS = {"default angle": "default_joint_pos", "kp": "kps", "kd": "kds",
         "action scale": "action_scale", "effort": "torque_limits",
         "lower limit": "joint_lower_limits", "upper limit": "joint_upper_limits"}  # fmt: skip


@dataclass(frozen=True)
class Robot:
    """Numbers of a robot that sources state.

    Attributes:
        urdf: URDF of the robot.
        order: Names of the joints, in the order of all lists.
        numbers: {quantity: {joint: number}}.
    """

    urdf: Path
    order: tuple[str, ...]
    numbers: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    def with_numbers(self, quantity: str, **changed: float) -> Robot:
        """Return the robot with other numbers of some joints."""
        mine = {**self.numbers[quantity], **changed}
        return replace(self, numbers={**self.numbers, quantity: mine})


def robot_of(name: str, folder: Path) -> Robot:
    """Return Pupper v3, or a quadruped of 8.4 kg with other names, axes and gains."""
    if name == "v3":
        urdf, order, angles, gains, scale = URDF, JOINTS, ANGLES, (5.0, 0.25), 0.75
    else:
        urdf = legged.quadruped(folder).urdf
        order = [f"{leg}_{part}" for leg in ("FL", "FR", "RL", "RR")
                 for part in ("roll", "pitch", "knee")]  # fmt: skip
        angles, gains, scale = [0.1, 0.6, -1.2, -0.1, 0.6, -1.2] * 2, (60.0, 2.0), 0.25
    limits = {str(joint.get("name")): joint.find("limit")
              for joint in ElementTree.parse(urdf).getroot().iter("joint")}  # fmt: skip
    numbers = {
        "default angle": dict(zip(order, angles, strict=True)),
        "kp": dict.fromkeys(order, gains[0]),
        "kd": dict.fromkeys(order, gains[1]),
        "action scale": dict.fromkeys(order, scale),
    }
    for quantity, word in (("effort", "effort"), ("lower limit", "lower"),
                           ("upper limit", "upper")):  # fmt: skip
        numbers[quantity] = {joint: float(limits[joint].get(word)) for joint in order}  # type: ignore[union-attr, arg-type]
    return Robot(urdf, tuple(order), numbers)


class _Text:
    """Text that records the line of each number."""

    def __init__(self) -> None:
        self.rows: list[str] = []
        self.lines: Lines = {}

    def add(self, row: str, quantity: str = "", joint: str = "") -> None:
        self.rows.append(row)
        if quantity:
            self.lines[quantity, joint] = len(self.rows)

    def table(self, robot: Robot, quantity: str, form: str) -> None:
        for joint in robot.order:
            number = robot.numbers[quantity][joint]
            self.add(form.format(joint=joint, number=number), quantity, joint)

    def write(self, path: Path) -> Lines:
        path.write_text("\n".join(self.rows) + "\n")
        return self.lines


def _write_mjlab(robot: Robot, path: Path) -> Lines:
    text = _Text()
    text.add("from library import ActuatorCfg, ArticulationCfg, EntityCfg, EnvCfg, mdp")
    text.add("ACTUATORS = (")
    for joint in robot.order:
        text.add(f"    ActuatorCfg(target_names_expr=('{joint}',),")
        for quantity, word in (("kp", "stiffness"), ("kd", "damping"), ("effort", "effort_limit")):
            text.add(f"        {word}={robot.numbers[quantity][joint]},", quantity, joint)
        text.add("    ),")
    text.add(")")
    text.add("START = EntityCfg.InitialStateCfg(joint_pos={")
    text.table(robot, "default angle", "    '{joint}': {number},")
    text.add("})")
    text.add("ROBOT = EntityCfg(init_state=START, articulation=ArticulationCfg(ACTUATORS))")
    text.rows[-1] = text.rows[-1].replace("(ACTUATORS)", "(actuators=ACTUATORS)")
    text.add("SCALES = {")
    text.table(robot, "action scale", "    '{joint}': {number},")
    text.add("}")
    text.add("def walking():")
    text.add("    action = mdp.JointPositionActionCfg(actuator_names=('.*',), scale=SCALES)")
    text.add("    return EnvCfg(scene={'entities': {'robot': ROBOT}}, actions={'all': action})")
    return text.write(path)


def _write_isaac_table(robot: Robot, path: Path) -> Lines:
    """Write ``params/env.yaml`` as Isaac Lab writes it: classes are texts under ``class_type``."""
    text = _Text()
    for row in (
        "sim:", "  dt: 0.005", "decimation: 4", "scene:", "  num_envs: 4096", "  robot:",
        "    class_type: isaaclab.assets.articulation.articulation:Articulation",
        "    init_state:", "      pos: !!python/tuple", "      - 0.0", "      joint_pos:",
    ):  # fmt: skip
        text.add(row)
    text.table(robot, "default angle", "        {joint}: {number}")
    text.add("      joint_vel:")
    text.add("        .*: 0.0")
    text.add("    actuators:")
    for joint in robot.order:
        text.add(f"      drive_{joint}:")
        text.add("        class_type: isaaclab.actuators.actuator_pd:DCMotor")
        text.add("        joint_names_expr:")
        text.add(f"        - {joint}")
        for quantity, word in (("kp", "stiffness"), ("kd", "damping"), ("effort", "effort_limit")):
            text.add(f"        {word}: {robot.numbers[quantity][joint]}", quantity, joint)
        text.add("        effort_limit_sim: null")
    for row in (
        "observations:", "  policy:", "    history_length: null", "    base_ang_vel:",
        "      func: isaaclab.envs.mdp.observations:base_ang_vel", "      scale: 0.25",
        "actions:", "  joint_pos:",
        "    class_type: isaaclab.envs.mdp.actions.joint_actions:JointPositionAction",
        "    joint_names:", "    - .*", "    offset: 0.0", "    use_default_offset: true",
        "    scale:",
    ):  # fmt: skip
        text.add(row)
    text.table(robot, "action scale", "      {joint}: {number}")
    for row in (
        "events:", "  reset_robot_joints:", "    params:", "      asset_cfg:",
        "        name: robot", "        joint_names: &id001", f"        - {robot.order[-1]}",
        f"        - {robot.order[0]}",
    ):  # fmt: skip
        text.add(row)
    return text.write(path)


def _write_mjlab_table(robot: Robot, path: Path) -> Lines:
    """Write ``params/env.yaml`` as mjlab writes it: classes and functions are tags of YAML."""
    text, tag = _Text(), "!!python/object:mjlab"
    text.add(f"{tag}.envs.manager_based_rl_env.ManagerBasedRlEnvCfg")
    for row in (
        "decimation: 4", f"scene: {tag}.scene.scene.SceneCfg", "  entities:",
        f"    robot: {tag}.entity.entity.EntityCfg",
        f"      init_state: {tag}.entity.entity.InitialStateCfg", "        joint_pos:",
    ):  # fmt: skip
        text.add(row)
    text.table(robot, "default angle", "          {joint}: {number}")
    text.add("      spec_fn: !!python/name:our_robot.constants.get_spec ''")
    text.add(f"      articulation: {tag}.entity.entity.EntityArticulationInfoCfg")
    text.add("        actuators: !!python/tuple")
    for joint in robot.order:
        text.add(f"        - {tag}.actuator.builtin_actuator.BuiltinPositionActuatorCfg")
        text.add("          target_names_expr: !!python/tuple")
        text.add(f"          - {joint}")
        for quantity, word in (("kp", "stiffness"), ("kd", "damping"), ("effort", "effort_limit")):
            text.add(f"          {word}: {robot.numbers[quantity][joint]}", quantity, joint)
        text.add("          frictionloss: null")
    for row in (
        "observations:", f"  actor: {tag}.managers.observation_manager.ObservationGroupCfg",
        "    terms:",
        f"      base_ang_vel: {tag}.managers.observation_manager.ObservationTermCfg",
        "        func: !!python/name:mjlab.envs.mdp.observations.builtin_sensor ''",
        "        scale: 0.25", "    history_length: null", "actions:",
        f"  joint_pos: {tag}.envs.mdp.actions.actions.JointPositionActionCfg",
        "    actuator_names: !!python/tuple", "    - .*", "    offset: 0.0",
        "    use_default_offset: true", "    scale:",
    ):  # fmt: skip
        text.add(row)
    text.table(robot, "action scale", "      {joint}: {number}")
    for row in (
        "events:", f"  reset: {tag}.managers.event_manager.EventTermCfg", "    params:",
        f"      asset_cfg: {tag}.managers.scene_entity_config.SceneEntityCfg",
        "        joint_names: !!python/tuple", f"        - {robot.order[-1]}",
        f"        - {robot.order[0]}", f"sim: {tag}.sim.sim.SimulationCfg",
        f"  mujoco: {tag}.sim.sim.MujocoCfg", "    timestep: 0.005",
    ):  # fmt: skip
        text.add(row)
    return text.write(path)


def _write_gym(robot: Robot, path: Path) -> Lines:
    text = _Text()
    text.add("class RobotCfg:")
    text.add("    class init_state:")
    text.add("        default_joint_angles = {")
    text.table(robot, "default angle", "            '{joint}': {number},")
    text.add("        }")
    text.add("    class control:")
    for quantity, word in (("kp", "stiffness"), ("kd", "damping")):
        text.add(f"        {word} = {{")
        text.table(robot, quantity, "            '{joint}': {number},")
        text.add("        }")
    scales = robot.numbers["action scale"]
    # legged_gym has one scale for all joints: the rarest scale, which is a planted mistake if any.
    odd = min(scales, key=lambda joint: list(scales.values()).count(scales[joint]))
    text.add(f"        action_scale = {scales[odd]}", "action scale", "")
    text.lines |= {("action scale", joint): len(text.rows) for joint in robot.order}
    return text.write(path)


def _add_lists(text: _Text, robot: Robot, left: str, more: str = "") -> None:
    for quantity, word in LISTS.items():
        if quantity not in more:
            text.add(f"{left}{word}:")
            text.table(robot, quantity, f"{left}  - {{number}}")


def _write_deploy(robot: Robot, path: Path) -> Lines:
    text = _Text()
    text.add(f"joint_ids_map: {list(range(len(robot.order)))}")
    _add_lists(text, robot, "")
    return text.write(path)


def _write_ros(robot: Robot, path: Path) -> Lines:
    text = _Text()
    text.add("walker:")
    text.add("  ros__parameters:")
    text.add(f"    joint_names: [{', '.join(robot.order)}]", "order")
    _add_lists(text, robot, "    ")
    return text.write(path)


def _write_rtneural(robot: Robot, path: Path) -> Lines:
    text = _Text()
    text.add('{"in_shape": [null, 36], "layers": [],')
    for quantity, word in LISTS.items():
        text.add(f'"{word}": [')
        text.table(robot, quantity, "{number},")
        text.rows[-1] = text.rows[-1].rstrip(",") + "],"
    text.rows[-1] = text.rows[-1].rstrip(",") + "}"
    lines = text.write(path)
    json.loads(path.read_text())
    return lines


_METADATA = {"default angle": "default_joint_pos", "kp": "joint_stiffness",
             "kd": "joint_damping", "action scale": "action_scale"}  # fmt: skip


def _write_onnx(robot: Robot, path: Path) -> Lines:
    metadata = {word: ",".join(str(robot.numbers[quantity][joint]) for joint in robot.order)
            for quantity, word in _METADATA.items()}  # fmt: skip
    path.write_bytes(onnx(joint_names=",".join(robot.order), **metadata))
    return {}


KINDS: dict[str, tuple[str, Callable[[Robot, Path], Lines]]] = {
    "mjlab": ("env_cfg.py", _write_mjlab),
    "legged_gym": ("robot_config.py", _write_gym),
    "deploy": ("deploy.yaml", _write_deploy),
    "ros2": ("controllers.yaml", _write_ros),
    "RTNeural": ("policy.json", _write_rtneural),
    "ONNX": ("policy.onnx", _write_onnx),
    "Isaac Lab's env.yaml": ("env.yaml", _write_isaac_table),
    "mjlab's env.yaml": ("env.yaml", _write_mjlab_table),
}
"""{kind of source: (file name, function that writes it)}."""

COMPARED_KINDS = {"mjlab": "deploy", "legged_gym": "ros2", "deploy": "legged_gym", "ros2": "ONNX",
          "RTNeural": "mjlab", "ONNX": "ros2", "Isaac Lab's env.yaml": "deploy",
          "mjlab's env.yaml": "deploy"}  # fmt: skip
"""{kind of source: kind of the second source of the comparison}."""

SLIPS = ("order", "sign", "scale", "default", "kp", "limit", "unit")
LIMITS = {"mjlab": "effort", "deploy": "effort", "ros2": "lower limit", "RTNeural": "upper limit",
          "Isaac Lab's env.yaml": "effort", "mjlab's env.yaml": "effort"}  # fmt: skip
TWICE_LIMITED_KINDS = [kind for kind, beside in COMPARED_KINDS.items()
                 if beside == "deploy" and LIMITS.get(kind) == "effort"]  # fmt: skip
"""Kinds of sources whose torque limits are compared with a deployment and with the URDF."""
CASES = [(robot, kind, slip) for robot in ("v3", "quadruped") for kind in KINDS for slip in SLIPS
         if slip != "limit" or kind in LIMITS]  # fmt: skip


def plant(robot: Robot, kind: str, slip: str, seed: int) -> tuple[Robot, str, str]:
    """Plant a mistake; return the changed robot, the quantity, and a joint with a changed number.

    The joint is empty if the names of two legs are exchanged.
    """
    at = np.random.default_rng(seed)
    angles = robot.numbers["default angle"]
    joint = str(at.choice(robot.order))
    bent = str(at.choice([joint for joint in robot.order if angles[joint]]))
    leg = 3 * int(at.integers(4))
    if slip == "order" and kind in ("ros2", "ONNX"):  # exchange the names of two legs
        other = (leg + 3 * int(at.integers(1, 4))) % 12
        names = list(robot.order)
        names[leg : leg + 3], names[other : other + 3] = (
            names[other : other + 3], names[leg : leg + 3])  # fmt: skip
        here = {quantity: {new: held[old] for old, new in zip(robot.order, names, strict=True)}
                for quantity, held in robot.numbers.items()}  # fmt: skip
        return replace(robot, order=tuple(names), numbers=here), "order", ""
    if slip == "order":
        mine = robot.order[leg : leg + 3]
        moved = {
            first: angles[second] for first, second in zip(mine, (*mine[1:], mine[0]), strict=True)
        }
        return robot.with_numbers("default angle", **moved), "default angle", mine[0]
    if slip == "unit":
        there = {one: round(math.degrees(angle), 2) for one, angle in angles.items()}
        return robot.with_numbers("default angle", **there), "default angle", bent
    limit = LIMITS.get(kind, "")
    wider = {"effort": lambda x: 0.6 * x, "lower limit": lambda x: x - 0.4}
    change: dict[str, tuple[str, str, Callable[[float], float]]] = {
        "sign": ("default angle", bent, lambda x: -x),
        "scale": ("action scale", joint, lambda x: round(x * at.uniform(0.3, 0.8), 3)),
        "default": ("default angle", joint, lambda x: round(x + at.uniform(0.03, 0.2), 3)),
        "kp": ("kp", joint, lambda x: round(x * at.uniform(1.1, 2.0), 1)),
        "limit": (limit, joint, lambda x: round(wider.get(limit, lambda y: y + 0.4)(x), 2)),
    }  # fmt: skip
    quantity, whose, work = change[slip]
    changed = work(robot.numbers[quantity][whose])
    return robot.with_numbers(quantity, **{whose: changed}), quantity, whose


def write(robot: Robot, kind: str, folder: Path) -> tuple[Path, Lines]:
    """Write a source; return its path and the lines of its numbers."""
    name, writer = KINDS[kind]
    return folder / name, writer(robot, folder / name)


def place_of(path: Path, lines: Lines, quantity: str, joint: str) -> str:
    """Return the place of a number: file and line, or file and key of a policy's metadata."""
    if path.suffix == ".onnx":
        return f"{path}:<{_METADATA.get(quantity, 'joint_names')}>"
    return f"{path}:{lines[quantity, joint]}"


def limit_line(urdf: Path, joint: str) -> int:
    """Return the line of a joint's limits in a URDF."""
    text = urdf.read_text()
    return text[: text.index("<limit", text.index(f'<joint name="{joint}"'))].count("\n") + 1
