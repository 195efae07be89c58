"""YAML and JSON of deployments: Unitree's, ROS 2's controllers, MoveIt's limits."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import replace

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import InputError, ModelError
from pupper_analysis.base.inputs import read_text
from pupper_analysis.models.places import Place, source_name
from pupper_analysis.tools.contract.facts import (
    Node,
    Request,
    Role,
    Source,
    Statement,
    per_joint,
    stated,
)
from pupper_analysis.tools.contract.marked import read_marked

SUFFIXES = (".yaml", ".yml", ".json")

_NAMES = ("joint_names", "joints", "dof_names", "joint_name")
_MOTORS = (
    "joint_ids_map",
    "leg_joint2motor_idx",
    "joint2motor_idx",
    "joint2motor",
    "joint_mapping",
)
_LISTS = {
    "default_joint_pos": "default angle", "default_angles": "default angle",
    "default_joint_angles": "default angle", "default_dof_pos": "default angle",
    "default_joint_positions": "default angle", "default_dof_angles": "default angle",
    "stiffness": "kp", "kps": "kp", "kp": "kp", "joint_stiffness": "kp", "joint_kp": "kp",
    "rl_kp": "kp",
    "damping": "kd", "kds": "kd", "kd": "kd", "joint_damping": "kd", "joint_kd": "kd",
    "rl_kd": "kd",
    "action_scale": "action scale", "action_scales": "action scale",
    "torque_limits": "effort", "effort_limits": "effort", "joint_effort_limits": "effort",
    "dof_effort_limit_list": "effort",
    "velocity_limits": "velocity", "dof_vel_limit_list": "velocity",
    "joint_lower_limits": "lower limit", "joint_upper_limits": "upper limit",
    "dof_pos_lower_limit_list": "lower limit", "dof_pos_upper_limit_list": "upper limit",
    "dof_armature_list": "armature",
    "joint_signs": "sign", "motor_signs": "sign", "joint_directions": "sign",
    "init_kps": "start kp", "init_kds": "start kd", "fixed_kp": "start kp", "fixed_kd": "start kd",
}  # fmt: skip
"""{key of a table: quantity}."""

_TIMES = {
    "step_dt": "policy step", "control_dt": "policy step", "policy_dt": "policy step",
    "simulation_dt": "time step", "dt": "time step", "control_decimation": "decimation",
    "decimation": "decimation", "latency": "latency", "num_actions": "actions",
    "num_obs": "observed numbers", "num_observations": "observed numbers",
}  # fmt: skip

_OBSERVED = {"ang_vel_scale": "ang_vel", "dof_pos_scale": "dof_pos", "dof_vel_scale": "dof_vel",
             "lin_vel_scale": "lin_vel"}  # fmt: skip
"""{key of unitree_rl_gym and its kin: what legged_gym calls the scale}."""


def read(request: Request) -> Iterator[Source]:
    """Yields what a YAML or a JSON holds: a configuration, or one for each controller."""
    for document in read_documents(request):
        yield from _of_document(request, document)


def read_documents(request: Request) -> list[Node]:
    """Returns the tables of a YAML or a JSON."""
    try:
        documents = read_marked(request.path, read_text(request.path))
    except InputError as error:
        raise ModelError(source_name(request.path, error.line), error.cause) from error
    return [one for one in documents if isinstance(one.value, dict)]


def _of_document(request: Request, document: Node) -> Iterator[Source]:
    name = request.path.name
    nodes = {key: node for key, node in document.value.items()
             if node.get("ros__parameters") is not None}  # fmt: skip
    if nodes:
        rate = document.get("controller_manager", "ros__parameters", "update_rate")
        for key, node in nodes.items():
            table = node.get("ros__parameters")
            if request.name in ("", key) and table is not None:
                yield from of_table(request, f"{name}:{key}", table, Role.DRIVER, rate)
        return
    if document.get("joint_limits") is not None:
        yield from _of_limits(request, document)
    elif not is_network(document):  # else it is a policy's: readers/rtneural.py
        yield from of_table(request, name, document, Role.DEPLOYMENT)
        # rl_sar and its kin: a robot's name, then its table.
        for key, node in document.value.items():
            if isinstance(node.value, dict) and request.name in ("", key):
                yield from of_table(request, f"{name}:{key}", node, Role.DEPLOYMENT)


def of_table(
    request: Request, name: str, table: Node, role: Role, rate: Node | None = None
) -> Iterator[Source]:
    """Yields what a flat table states of joints, if it states anything."""
    table = Node({key.lower(): node for key, node in table.value.items()}, table.place)
    named = next((found for word in _NAMES if (found := table.get(word))), None)
    order = () if named is None else named.texts
    motors = next((found for word in _MOTORS if (found := table.get(word))), None)
    indices = _numbers(motors)
    unread = [diagnose("contract-motors-unread", file=name)] if motors and not indices else []
    statements = list(_listed(table, order, indices))
    for action in _below(table.get("actions")):
        statements += _flat("action scale", action.get("scale"))
        statements += _flat("action offset", action.get("offset"))
    trainer = list(settings_of(table))
    statements += trainer
    states_joints = bool(statements) or bool(order)
    for word, quantity in _TIMES.items():
        node = table.get(word)
        if node is not None and node.number is not None:
            statements.append(stated(quantity, node))
    for word, scale in _OBSERVED.items():
        node = table.get(word)
        if node is not None and node.number is not None:
            statements.append(stated(f"observation {scale}", node))
    said = {one.quantity: one for one in statements if not one.joint and one.index is None}
    step, many = said.get("time step"), said.get("decimation")
    if "policy step" not in said and step and many and step.value and many.value:
        statements.append(Statement("policy step", step.value * many.value, many.place))
    often = table.get("repeat_action")
    if rate is not None and rate.number and often is not None and often.number is not None:
        statements.append(Statement("policy step", often.number / rate.number, often.place))
    if not states_joints:
        return
    yield Source(
        name,
        request.path,
        Role.TRAINER if trainer else role,
        tuple(statements),
        order=order if all(order) else (),
        order_place=None if named is None else named.place,
        motors=tuple(indices),
        observations=tuple(_observed(table.get("observations"))),
        notes=tuple(unread),
    )


def _numbers(motors: Node | None) -> list[int]:
    """Returns the numbers of motors, each another one from 0 on; none if they are not."""
    numbers = [] if motors is None else [one.number for one in motors.items]
    whole = [int(one) for one in numbers if one is not None and one.is_integer() and one >= 0]
    return whole if len(set(whole)) == len(numbers) else []


def is_network(document: Node) -> bool:
    """Whether a table is a policy's: one with a list of layers."""
    layers = document.get("layers")
    return layers is not None and isinstance(layers.value, list)


def _listed(table: Node, order: tuple[str, ...], motors: list[int]) -> Iterator[Statement]:
    known = set(order) | {".*"}
    # Source: rl_sar, ReadYaml: a robot's table is for getting up, a policy's counts over it.
    to_start = table.get("fixed_kp") is not None and table.get("rl_kp") is None
    for word, quantity in _LISTS.items():
        node = table.get(word)
        if node is None:
            continue
        if to_start and quantity == "effort":
            continue
        if to_start and quantity == "default angle":
            quantity = "start angle"
        for one in _flat(quantity, node):
            # A text is a name of a parameter, not an expression: nothing is said of joints.
            if one.value is None or (one.joint and one.joint not in known and order):
                continue
            # By motor, in the robot's own order: see unitree_rl_lab's articulation.h, "sdk order".
            whole = sorted(motors) == list(range(len(motors)))
            if word in ("stiffness", "damping") and whole and one.index in motors:
                one = replace(one, index=motors.index(one.index or 0))
            yield one


def _flat(quantity: str, node: Node | None) -> Iterable[Statement]:
    """Returns statements of a list, or of the list that a list of one list is."""
    if node is not None and isinstance(node.value, list) and len(node.value) == 1:
        inner = node.value[0]
        node = inner if isinstance(inner.value, list) else node
    return per_joint(quantity, node)


def _below(node: Node | None) -> list[Node]:
    """Returns the tables in a table that are of joint positions."""
    if node is None or not isinstance(node.value, dict):
        return []
    parts = {key: one for key, one in node.value.items() if isinstance(one.value, dict)}
    return [one for key, one in parts.items() if "Velocity" not in key and "Effort" not in key]


def _observed(node: Node | None) -> Iterator[tuple[str, float | None, Place]]:
    if node is None or not isinstance(node.value, dict):
        return
    for name, term in node.value.items():
        scale = term.get("scale")
        if isinstance(term.value, dict):
            yield name, None if scale is None else scale.items[0].number, term.place


def _of_limits(request: Request, document: Node) -> Iterator[Source]:
    """Yields MoveIt's limits, each with the switch that says whether it counts."""
    words = (("velocity", "max_velocity", "has_velocity_limits"),
             ("effort", "max_effort", "has_effort_limits"),
             ("lower limit", "min_position", "has_position_limits"),
             ("upper limit", "max_position", "has_position_limits"))  # fmt: skip
    held = document.value["joint_limits"].value
    found = []
    for joint, limits in held.items() if isinstance(held, dict) else ():
        for quantity, word, switch in words:
            node, counts = limits.get(word), limits.get(switch)
            if node is not None and (counts is None or counts.value is not False):
                found.append(stated(quantity, node, joint))
    if found:
        yield Source(request.path.name, request.path, Role.DRIVER, tuple(found))


def steps_of(root: Node) -> Iterator[Statement]:
    """Yields the steps of a trainer and of its policy."""
    step = root.get("sim", "dt") or root.get("sim", "mujoco", "timestep")
    often = root.get("decimation") or root.get("control", "decimation")
    if step is not None and step.number is not None:
        yield stated("time step", step)
    if often is not None and often.number is not None:
        yield stated("decimation", often)
        if step is not None and step.number is not None:
            yield Statement("policy step", step.number * often.number, often.place)


def settings_of(root: Node) -> Iterator[Statement]:
    """Yields what legged_gym's settings state, and those of its kin: classes, or tables."""
    angles = root.get("init_state", "default_joint_angles")
    if angles is None or not isinstance(angles.value, dict):
        return
    for one in per_joint("default angle", angles):
        yield one
        yield replace(one, quantity="action offset", implied=True)
    for word, quantity in (("stiffness", "kp"), ("damping", "kd")):
        table = root.get("control", word)
        if table is not None and isinstance(table.value, dict):
            # A gain is of all joints whose names have its key in them.
            for key, node in table.value.items():
                yield stated(quantity, node, f".*{re.escape(str(key))}.*")
    scale = root.get("control", "action_scale")
    yield from per_joint("action scale", scale)
    hips = root.get("control", "hip_scale_reduction")
    if hips is not None and hips.number is not None and scale is not None and scale.number:
        # Source: walk-these-ways, LeggedRobot._compute_torques: of each leg's first joint.
        yield Statement("action scale", scale.number * hips.number, hips.place, r".*hip.*")
    armature = root.get("asset", "armature")
    if armature is not None and armature.number:
        yield from per_joint("armature", armature)
    yield from steps_of(root)
    for word, what in (("num_actions", "actions"), ("num_observations", "observed numbers")):
        count = root.get("env", word)
        if count is not None and count.number:
            yield stated(what, count)
    scales = root.get("normalization", "obs_scales")
    held = {} if scales is None else getattr(scales.value, "fields", scales.value)
    for word, node in held.items() if isinstance(held, dict) else ():
        if node.number is not None:
            yield stated(f"observation {word}", node)
