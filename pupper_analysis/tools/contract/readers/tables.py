"""YAML and JSON of deployments: Unitree's, ROS 2's controllers, MoveIt's limits."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import replace

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.inputs import read_text
from pupper_analysis.models.places import Place
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

_WHOLE = {
    "step_dt": "policy step", "control_dt": "policy step", "policy_dt": "policy step",
    "ctrl_dt": "policy step", "simulation_dt": "time step", "sim_dt": "time step",
    "dt": "time step", "control_decimation": "decimation", "decimation": "decimation",
    "latency": "latency", "num_actions": "actions", "num_obs": "observed numbers",
    "num_observations": "observed numbers", "ang_vel_scale": "observation ang_vel",
    "dof_pos_scale": "observation dof_pos", "dof_vel_scale": "observation dof_vel",
    "lin_vel_scale": "observation lin_vel",
}  # fmt: skip
"""{key of a table: what it states of the whole}; scales as legged_gym calls them."""

_SETTINGS = {
    "sim.dt": "time step", "sim.mujoco.timestep": "time step", "decimation": "decimation",
    "control.decimation": "decimation", "env.num_actions": "actions",
    "env.num_observations": "observed numbers",
}  # fmt: skip
"""{where it stands in a trainer's settings: what it states of the whole}."""


def read(request: Request) -> Iterator[Source]:
    """Yields what a YAML or a JSON holds: a configuration, or one for each controller or robot."""
    for document in read_documents(request):
        if document.get("joint_limits") is not None:
            yield from _of_limits(request, document)
        elif not is_network(document):  # else it is a policy's: readers/rtneural.py
            yield from _of_document(request, document)


def read_documents(request: Request) -> list[Node]:
    """Returns the tables of a YAML or a JSON."""
    documents = read_marked(request.path, read_text(request.path))
    return [one for one in documents if isinstance(one.value, dict)]


def _of_document(request: Request, document: Node) -> Iterator[Source]:
    """Yields what a table states, and the tables in it: rl_sar's of a robot, ROS 2's of a node."""
    rate = document.get("controller_manager", "ros__parameters", "update_rate")
    for key, node in {"": document, **document.value}.items():
        own = node.get("ros__parameters")
        table = own or node
        if isinstance(table.value, dict) and request.name in ("", key):
            more = {} if own is None or rate is None else {"update_rate": rate}
            name = f"{request.path.name}:{key}" if key else request.path.name
            role = Role.DEPLOYMENT if own is None else Role.DRIVER
            yield from of_table(request, name, Node({**table.value, **more}, table.place), role)


def of_table(
    request: Request, name: str, table: Node, role: Role, more: Iterable[Statement] = ()
) -> Iterator[Source]:
    """Yields what a flat table states of joints, and what else is known, if that is anything."""
    table = Node({str(key).lower(): node for key, node in table.value.items()}, table.place)
    named = next((found for word in _NAMES if (found := table.get(word))), None)
    order = () if named is None else named.texts
    motors = next((found for word in _MOTORS if (found := table.get(word))), None)
    indices = _numbers(motors)
    unread = [diagnose("contract-motors-unread", file=name)] if motors and not indices else []
    statements = [*more, *_listed(table, order, indices)]
    for action in _below(table.get("actions")):
        statements += _flat("action scale", action.get("scale"))
        statements += _flat("action offset", action.get("offset"))
    trainer = list(settings_of(table))
    statements += trainer
    if not statements and not order:
        return
    statements += [stated(quantity, node) for word, quantity in _WHOLE.items()
                   if (node := table.get(word)) and node.number is not None]  # fmt: skip
    rate, often = table.get("update_rate"), table.get("repeat_action")
    if rate is not None and often is not None and rate.number and often.number:
        statements.append(Statement("policy step", often.number / rate.number, often.place))
    seen = table.get("observation_names")
    names = () if seen is None else ((one, None, seen.place) for one in seen.texts)
    yield Source(
        name,
        request.path,
        Role.TRAINER if trainer else role,
        tuple(statements),
        order=order,
        order_place=None if named is None else named.place,
        motors=tuple(indices),
        observations=(*names, *observed_in(table.get("observations"))),
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


def observed_in(terms: Node | None) -> Iterator[tuple[str, float | None, Place]]:
    """Yields the terms of an observation, in order, by their functions' names where these tell."""
    held = {} if terms is None else getattr(terms.value, "fields", terms.value)
    for name, term in held.items() if isinstance(held, dict) else ():
        func, scale = term.get("func"), term.get("scale")
        called = "" if func is None else str(func.value).rpartition(".")[2]
        if func is not None or isinstance(term.value, dict):
            implied = None if func is None else 1.0
            number = implied if scale is None else scale.items[0].number
            yield called if called in _KNOWN else name, number, term.place


_KNOWN = ("base_ang_vel", "projected_gravity", "generated_commands", "joint_pos_rel",
          "joint_vel_rel", "last_action", "velocity_commands", "base_lin_vel")  # fmt: skip


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


def stated_of_all(root: Node) -> Iterator[Statement]:
    """Yields what a trainer's settings state of the whole."""
    for path, quantity in _SETTINGS.items():
        node = root.get(*path.split("."))
        if node is not None and node.number:
            yield stated(quantity, node)


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
    yield from stated_of_all(root)
    scales = root.get("normalization", "obs_scales")
    held = {} if scales is None else getattr(scales.value, "fields", scales.value)
    for word, node in held.items() if isinstance(held, dict) else ():
        if node.number is not None:
            yield stated(f"observation {word}", node)
