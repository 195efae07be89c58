"""Reader of YAML and JSON: deployments of Unitree robots, ROS 2 controllers, MoveIt, RTNeural.

Input is a file; outputs are `Source` objects with joint order, motor map, numbers of joints and
observations. `fields.toml` contains the keys of each format. Other readers use `read_table` for
tables in their formats.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.inputs import read_text
from pupper_analysis.models.places import Place
from pupper_analysis.tools.contract.facts import (
    FIELD_TABLE,
    FORMAT_KEYS,
    KEY_ALIASES,
    OBSERVATION_ALIASES,
    Node,
    Request,
    Role,
    Source,
    Statement,
    find_quantity_kind,
    read_yaml_nodes,
)

FILE_SUFFIXES = (".yaml", ".yml", ".json")
"""Suffixes of the files that this reader of tables reads."""

_TABLE_KEYS = {
    **FORMAT_KEYS["table"],
    **{f"{name}_scale": f"observation {name}" for name in KEY_ALIASES["scales"]},
}
"""{key in a YAML or JSON table: quantity of the contract}, including scales of observations."""


def read(request: Request) -> Iterator[Source]:
    """Yield a source for each set of joint values in a YAML or JSON file (one per controller)."""
    documents = read_yaml_nodes(request.path, read_text(request.path))
    for document in (document for document in documents if isinstance(document.value, dict)):
        layers = document.get("layers")
        if document.get("joint_limits").is_present:
            yield from _read_limits(request, document.get("joint_limits"))
        elif isinstance(layers.value, list):  # a policy in RTNeural's format
            sizes_by_quantity = {
                "actions": [layer.get("shape") for layer in layers.items[-1:]],
                "observed numbers": [document.get("in_shape")],
            }
            sizes = [
                size.make_statement(what)
                for what, shapes in sizes_by_quantity.items()
                for shape in shapes
                for size in shape.items[-1:]
                if size.number
            ]
            yield from read_table(request, request.path.name, document, Role.POLICY, sizes)
        else:
            yield from _read_document(request, document)


def _read_document(request: Request, document: Node) -> Iterator[Source]:
    """Yield a source for a table, and for each nested table, with joint names or joint values.

    Joint values are, for example, gains or limits. Nested tables are robots in files of rl_sar, and
    nodes in files of ROS 2. If the request has a name, only the table with this name is read.
    """
    rate = document.get("controller_manager", "ros__parameters", "update_rate")
    # Tables inside a trainer's settings are not sources.
    parts = {} if is_trainer_config(document) else document.value
    for key, node in {"": document, **parts}.items():
        parameters = node.get("ros__parameters")
        table, role = (
            (parameters, Role.DRIVER) if parameters.is_present else (node, Role.DEPLOYMENT)
        )
        if isinstance(table.value, dict) and request.name in ("", key):
            extra_keys = {"update_rate": rate} if parameters.is_present and rate.is_present else {}
            name = f"{request.path.name}:{key}" if key else request.path.name
            yield from read_table(
                request, name, Node({**table.value, **extra_keys}, table.place), role
            )


def read_table(
    request: Request, name: str, table: Node, role: Role, sizes: Sequence[Statement] = ()
) -> Iterator[Source]:
    """Yield a table {key: value} of a file as a source, if it states joint names or joint values.

    With ``sizes``, the table is always yielded. Joint values are, for example, gains or limits.

    Args:
        request: Request with the path of the file.
        name: Name of the source.
        table: Table; keys are compared in lower case.
        role: Role of the source; ``TRAINER`` instead if the table configures a trainer.
        sizes: Statements from elsewhere, such as the sizes of a network.
    """
    table = Node({str(key).lower(): node for key, node in table.value.items()}, table.place)
    joint_names, motors = table.find_first("joints"), table.find_first("motors")
    indices = _read_motor_numbers(motors)
    notes = (
        [diagnose("contract-motors-unread", file=name)] if motors.is_present and not indices else []
    )
    is_standing_table = name.rpartition(":")[2].lower() in KEY_ALIASES["starting"]
    statements = [
        *sizes,
        *_list_table_statements(table, joint_names.texts, indices, is_standing_table),
    ]
    for action in _list_position_tables(table.get("actions")):
        statements += _list_flat_statements("action scale", action.get("scale"))
        statements += _list_flat_statements("action offset", action.get("offset"))
    statements += read_settings(table) if is_trainer_config(table) else ()
    if not (
        sizes
        or joint_names.texts
        or any(not find_quantity_kind(statement.quantity).is_setting for statement in statements)
    ):
        return
    rate, repeat = table.get("update_rate"), table.get("repeat_action")
    if rate.number and repeat.number:
        statements.append(Statement("policy step", repeat.number / rate.number, repeat.place))
    observation_names = table.get("observation_names")
    named_terms = ((term, None, observation_names.place) for term in observation_names.texts)
    role = Role.TRAINER if is_trainer_config(table) else role
    yield Source(
        name,
        request.path,
        role,
        tuple(statements),
        order=joint_names.texts,
        order_place=joint_names.place,
        motors=tuple(indices),
        observations=(*named_terms, *list_observation_terms(table.get("observations"))),
        notes=tuple(notes),
    )


def _read_motor_numbers(motors: Node) -> list[int]:
    """Return the indices of motors; empty unless all are distinct integers >= 0."""
    numbers = [motor.number for motor in motors.items]
    whole = [
        int(number)
        for number in numbers
        if number is not None and number.is_integer() and number >= 0
    ]
    return whole if len(set(whole)) == len(numbers) else []


def _list_table_statements(
    table: Node, order: Sequence[str], motors: list[int], is_standing_table: bool
) -> Iterator[Statement]:
    """Yield a statement for each value in a table, such as a joint's gain or default angle.

    Args:
        table: Table with keys in lower case.
        order: Joint names that the table lists; empty if the table lists no names.
        motors: Motor index of each joint; empty if not stated.
        is_standing_table: True if gains, efforts and default angles of the table are for standing
            up, not for the policy. Such values are skipped.
    """
    valid_names = set(order) | {"", ".*"}
    # Listed in the robot's motor order: see unitree_rl_lab, articulation.h, "sdk order".
    is_complete = sorted(motors) == list(range(len(motors)))
    # Source: rl_sar, ReadYaml: the robot's table is for standing up; the policy's table overrides.
    is_for_standing = is_standing_table or (
        table.get("fixed_kp").is_present and not table.get("rl_kp").is_present
    )
    keys = {
        word: quantity
        for word, quantity in _TABLE_KEYS.items()
        if not (is_for_standing and quantity in ("effort", "default angle", "kp", "kd"))
    }
    for word, quantity in keys.items():
        for statement in _list_flat_statements(quantity, table.get(word)):
            if word in ("stiffness", "damping") and is_complete and statement.index in motors:
                statement = replace(statement, index=motors.index(statement.index or 0))
            # A text is the name of a parameter, not a number of a joint.
            if statement.value is not None and (statement.joint in valid_names or not order):
                yield statement


def _list_flat_statements(quantity: str, node: Node) -> Iterable[Statement]:
    """Return the statements (values with their places in the file) of a quantity.

    A list that only contains another list, such as [[1, 2]], is read as the inner list.
    """
    inner = node.items[0] if len(node.items) == 1 else node
    return (inner if isinstance(inner.value, list) else node).make_statements(quantity)


def _list_position_tables(node: Node) -> list[Node]:
    """Return the tables in the table of a policy's actions that are not velocities or efforts."""
    return [
        one
        for key, one in node.table.items()
        if isinstance(one.value, dict) and "Velocity" not in key and "Effort" not in key
    ]


def list_observation_terms(terms: Node) -> Iterator[tuple[str, float | None, Place]]:
    """Yield (name, scale, place) of each observation term that is a table or has a function.

    The name is the name of the term's function if listed in `OBSERVATION_ALIASES`, otherwise the
    key. The scale is 1 for a function without a stated scale, and None if the scale is unknown.
    """
    for name, term in terms.table.items():
        func, scale = term.get("func"), term.get("scale")
        function_name = str(func.value).rpartition(".")[2]
        if func.is_present or isinstance(term.value, dict):
            number = scale.items[0].number if scale.items else 1.0 if func.is_present else None
            yield (
                function_name if function_name in OBSERVATION_ALIASES else name,
                number,
                term.place,
            )


def _read_limits(request: Request, limits: Node) -> Iterator[Source]:
    """Yield a source with MoveIt's joint limits; no source if there are none.

    A limit is ignored if its ``has_..._limits`` is false.
    """
    words = {
        name: row["limits"] for name, row in FIELD_TABLE["quantities"].items() if "limits" in row
    }
    statements = [
        one.get(word).make_statement(quantity, joint)
        for joint, one in limits.table.items()
        for quantity, (word, switch) in words.items()
        if one.get(word).is_present and one.get(switch).value is not False
    ]
    if statements:
        yield Source(request.path.name, request.path, Role.DRIVER, tuple(statements))


def is_trainer_config(root: Node) -> bool:
    """Return True if a table is the training configuration of a policy, as of legged_gym.

    Such a table contains the default joint angles as ``init_state/default_joint_angles``.
    """
    return bool(root.get("init_state", "default_joint_angles").table)


def read_settings(root: Node) -> Iterator[Statement]:
    """Yield the joint values, global settings and observation scales in a legged_gym configuration.

    ``root`` is the top of the configuration.
    """
    for path, quantity in FORMAT_KEYS["settings"].items():
        parts = FIELD_TABLE["quantities"][quantity].get("parts", False)
        for statement in root.get(*path.split(".")).make_statements(quantity):
            if parts and statement.joint != ".*":
                # A gain applies to all joints whose names contain the key.
                yield replace(statement, joint=f".*{re.escape(statement.joint)}.*")
            elif statement.value or quantity != "armature":
                yield statement
            if quantity == "default angle":
                yield replace(statement, quantity="action offset", implied=True)
    scale, hips = (root.get("control", word) for word in ("action_scale", "hip_scale_reduction"))
    if hips.number is not None and scale.number:
        # Source: walk-these-ways, LeggedRobot._compute_torques: first joint of each leg.
        yield Statement("action scale", scale.number * hips.number, hips.place, r".*hip.*")
    for word, node in root.get("normalization", "obs_scales").table.items():
        yield from node.make_statements(f"observation {word}")
