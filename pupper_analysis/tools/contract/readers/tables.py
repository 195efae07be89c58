"""Reader of YAML and JSON: deployments, trainers' tables, ROS 2 controllers, MoveIt, RTNeural.

Input is a file; outputs are `JointSource` objects with joint order, motor map, numbers of joints
and observations. ``keys.toml`` contains the keys. Numbers of a policy may be spread over several
nested tables (`_split_document`). Other readers use `read_table` for tables in their formats.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from pupper_analysis.base.diagnostics import Diagnostic, Term, diagnose
from pupper_analysis.base.inputs import read_text
from pupper_analysis.models.places import Place, quote_short
from pupper_analysis.tools.contract import training
from pupper_analysis.tools.contract.facts import (
    FIELD_TABLE,
    KEY_ALIASES,
    OBSERVATION_ALIASES,
    QUANTITIES,
    JointSource,
    LocatedValue,
    ObservedTerm,
    Origin,
    Request,
    Role,
    Statement,
    find_quantity_kind,
    read_yaml_nodes,
)
from pupper_analysis.tools.contract.keys import (
    JOINT_ORDER,
    KeyRule,
    load_key_rules,
    load_order_keys,
    names_joint_quantity,
)

FILE_SUFFIXES = (".yaml", ".yml", ".json")
"""Suffixes of the files that this reader of tables reads."""

_MAX_TABLE_DEPTH = 4
"""Largest depth at which nested tables are searched for numbers. Chosen, not tuned."""


@dataclass(frozen=True)
class _View:
    """Tables of a document that together state one source, such as a controller.

    Attributes:
        key: Keys of the source in the document, joined by ``/``; empty for the document.
        tables: Tables with keys in lower case, in the order in which a key is searched.
        rules: Keys under which the quantities are searched.
    """

    key: str
    tables: tuple[LocatedValue, ...]
    rules: tuple[KeyRule, ...]

    @property
    def place(self) -> Place:
        """File and line of the first table."""
        return self.tables[0].place

    def get(self, *path: str) -> LocatedValue:
        """Return the value of a path of keys in these tables, exact or with letters of any case.

        If the path is missing, the result has the value None.
        """
        exact = (table.get(*path) for table in self.tables)
        similar = (_get_in_any_case(table, path) for table in self.tables)
        found = (node for node in (*exact, *similar) if node.is_present)
        return next(found, LocatedValue(None, self.place))

    def find_first(self, names: str) -> LocatedValue:
        """Return the value in these tables for a concept of `KEY_ALIASES`, such as joint names.

        If the concept is missing, the result has the value None.
        """
        paths = [tuple(alias.split(".")) for alias in KEY_ALIASES[names]]
        if names == "joints":
            paths = [*load_order_keys(self.place.file), *paths]
        found = (self.get(*path) for path in paths)
        return next((node for node in found if node.is_present), LocatedValue(None, self.place))

    @property
    def states_joints(self) -> bool:
        """True if a table states joint names or a quantity of joints, such as a gain."""
        return bool(self.find_first("joints").texts) or self.states_numbers

    @property
    def states_numbers(self) -> bool:
        """True if a table states a quantity of joints, such as a gain."""
        return bool(self._find_joint_values())

    def _find_joint_values(self) -> dict[str, LocatedValue]:
        """Return the values in these tables that state quantities of joints, such as gains.

        Returns:
            {quantity and joint pattern, as one text: value}.
        """
        return {
            f"{rule.quantity} {rule.joints}": node
            for rule in self.rules
            if not find_quantity_kind(rule.quantity).is_setting
            and rule.accepts(node := self.get(*rule.path))
            and any(statement.value is not None for statement in rule.list_statements(node))
        }

    def conflicts_with(self, other: _View) -> bool:
        """Return True if this view and ``other`` both state a quantity per joint, or joint names.

        A value that both views contain because they share a table is no conflict.
        """
        first, second = self._find_joint_values(), other._find_joint_values()
        first["names"], second["names"] = self.find_first("joints"), other.find_first("joints")
        return any(
            first[key].is_present and second[key].is_present and first[key] is not second[key]
            for key in first.keys() & second.keys()
        )


def _get_in_any_case(node: LocatedValue, path: Iterable[str]) -> LocatedValue:
    """Return the value of a path of keys, whose letters may have another case in the table."""
    for key in path:
        names = {str(name).lower(): name for name in node.table}
        node = node.get(names.get(key.lower(), key))
    return node


def _lower_keys(node: LocatedValue) -> LocatedValue:
    """Return a table with keys in lower case; keys in tables without tables or lists are kept."""
    if not isinstance(node.value, dict):
        return node
    # Keys that are names of joints keep their case: numbers have no nested tables.
    lowered = {str(key): _lower_keys(value) for key, value in node.value.items()}
    is_leaf = not any(isinstance(value.value, dict | list) for value in lowered.values())
    names = lowered if is_leaf else {key.lower(): value for key, value in lowered.items()}
    return replace(node, value=names)


def read(request: Request) -> Iterator[JointSource]:
    """Yield a source for each set of joint values in a YAML or JSON file.

    A set belongs, for example, to one of several controllers, to MoveIt's joint limits, or to a
    policy in RTNeural's format. Joint values are, for example, gains.

    Raises:
        InputError: If the file cannot be read.
        ModelError: If the file is not valid YAML or JSON, for example.
    """
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
                if size.number is not None
            ]
            yield from read_table(request, request.path.name, document, Role.POLICY, sizes)
        elif training.is_environment(document):
            if not request.name:  # the file contains one configuration
                yield from training.read_configuration(request.path.name, request.path, document)
        else:
            yield from read_nested_tables(request, document)


def read_nested_tables(
    request: Request, document: LocatedValue, role: Role = Role.DEPLOYMENT
) -> Iterator[JointSource]:
    """Yield the sources of a document with nested tables.

    Nested tables are, for example, robots in files of rl_sar, controllers, and nodes in files of
    ROS 2.

    Args:
        request: Request with the path of the file. With a name, the source with this name is read:
            the key of the table, with or without the keys of the tables that contain it (``a/b``).
        document: Table {key: value or table}.
        role: Role of the sources; `Role.DRIVER` for nodes of ROS 2, ``TRAINER`` for configurations
            of trainers.

    Raises:
        ModelError: If an entry of the user's ``pupper-analysis.toml`` is not valid.
    """
    rate = document.get("controller_manager", "ros__parameters", "update_rate")
    nodes = {key: node.get("ros__parameters") for key, node in document.table.items()}
    for key, parameters in nodes.items():
        if isinstance(parameters.value, dict) and request.name in ("", key):
            extra_keys = {"update_rate": rate} if rate.is_present else {}
            table = LocatedValue({**parameters.value, **extra_keys}, parameters.place)
            yield from read_table(request, f"{request.path.name}:{key}", table, Role.DRIVER)
    other_nodes = {key: node for key, node in document.table.items() if not nodes[key].is_present}
    lowered = _lower_keys(replace(document, value=other_nodes))
    # Tables inside a trainer's settings are not sources.
    is_trainer = training.is_trainer_config(document)
    whole = _View("", (lowered,), load_key_rules("table", request.path))
    for view in [whole] if is_trainer else _split_document(whole, 0):
        if request.name.lower() in ("", view.key, view.key.rpartition("/")[2]):
            name = f"{request.path.name}:{view.key}" if view.key else request.path.name
            yield from _read_view(request, name, view, role, ())


def _split_document(own: _View, depth: int) -> list[_View]:
    """Group a table and its nested tables into sources, and return a view of each source.

    Tables may form one source only if each quantity of joints, and the list of joint names, is
    stated by one table at most.
    """
    (node,) = own.tables
    if depth >= _MAX_TABLE_DEPTH:
        return [own]
    views, separate = list[_View](), list[_View]()
    for name, child in node.table.items():
        if not isinstance(child.value, dict) or name in KEY_ALIASES["unsearched"]:
            continue
        part = _View(f"{own.key}/{name}" if own.key else str(name), (child,), own.rules)
        if training.is_trainer_config(child):
            separate.append(part)
            continue
        children = _split_document(part, depth + 1)
        (separate if name in KEY_ALIASES["starting"] else views).extend(children)
    stating = [view for view in views if view.states_joints]
    settings = [table for view in views if not view.states_joints for table in view.tables]
    pairs = [(a, b) for number, a in enumerate(stating) for b in (own, *stating[:number])]
    if not any(a.conflicts_with(b) for a, b in pairs):
        tables = [table for view in stating for table in view.tables]
        is_single = len(stating) == 1 and not own.states_joints
        key = stating[0].key if is_single else own.key
        return [_View(key, (node, *tables, *settings), own.rules), *separate]
    running = [view for view in stating if view.find_first("policy").is_present]
    kept = running or stating
    if own.states_numbers:
        return [replace(own, tables=(node, *settings)), *kept, *separate]
    direct = {name: child for name, child in node.table.items() if not child.table}
    inherited = replace(node, value=direct)
    return [*(replace(view, tables=(*view.tables, inherited)) for view in kept), *separate]


def read_table(
    request: Request, name: str, table: LocatedValue, role: Role, sizes: Sequence[Statement] = ()
) -> Iterator[JointSource]:
    """Yield a table {key: value} of a file as a source, if it states joint names or joint values.

    With ``sizes``, the table is always yielded. Joint values are, for example, gains or limits.

    Args:
        request: Request with the path of the file.
        name: Name of the source.
        table: Table; its keys are converted to lower case, but not those of nested tables.
        role: Role of the source; ``TRAINER`` instead if the table configures a trainer.
        sizes: Statements from elsewhere, such as the sizes of a network.

    Raises:
        ModelError: If an entry of the user's ``pupper-analysis.toml`` is not valid.
    """
    lowered = LocatedValue(
        {str(key).lower(): node for key, node in table.table.items()}, table.place
    )
    view = _View("", (lowered,), load_key_rules("table", request.path))
    yield from _read_view(request, name, view, role, sizes)


def _read_view(
    request: Request, name: str, view: _View, role: Role, sizes: Sequence[Statement]
) -> Iterator[JointSource]:
    """Yield at most one source: joint order, numbers and observations of the tables of ``view``.

    ``sizes`` are statements from elsewhere, such as the sizes of a network.
    """
    root = view.tables[0]
    joint_names = view.find_first("joints")
    indices, unread_motors = _read_motors(name, view)
    unread = _describe_unread_values(view) | _describe_unread_terms(view) | unread_motors
    if isinstance(joint_names.value, list) and joint_names.value and not joint_names.texts:
        place = joint_names.place
        unread[JOINT_ORDER] = diagnose(
            "contract-names-unread", file=str(place), sources=place.source
        )
    is_standing_table = name.rpartition(":")[2].rpartition("/")[2] in KEY_ALIASES["starting"]
    statements = [
        *sizes,
        *_list_table_statements(view, indices, is_standing_table),
    ]
    statements += _list_reference_angles(view.get("observations", "terms"))
    action_tables = _list_position_tables(view.get("actions"))
    for rule in (KeyRule("action scale", ("scale",)), KeyRule("action offset", ("offset",))):
        for action in action_tables:
            statements += rule.list_statements(action.get(*rule.path))
    # The bounds of relative actions, and of actions relative to limits, are no positions.
    if (clip := view.get("actions", "JointPositionAction", "clip")).is_present:
        statements += training.list_target_bounds(clip)
    statements += training.read_settings(root) if training.is_trainer_config(root) else ()
    if not (
        sizes
        or joint_names.texts
        or any(not find_quantity_kind(statement.quantity).is_setting for statement in statements)
    ):
        return
    statements += _list_command_scales(view)
    observation_names = view.get("observation_names")
    named_terms = (
        ObservedTerm(term.strip(), None, observation_names.place)
        for term in observation_names.texts
    )
    role = Role.TRAINER if training.is_trainer_config(root) else role
    yield JointSource(
        name,
        request.path,
        role,
        tuple(statements),
        order=joint_names.texts,
        order_place=joint_names.place,
        motors=tuple(indices),
        observations=(*named_terms, *_list_view_observations(view)),
        name_lists={} if joint_names.texts else _collect_name_lists(view),
        unread=unread,
        number_lists=_collect_number_lists(view),
    )


def _read_motors(name: str, view: _View) -> tuple[list[int], dict[str, Diagnostic]]:
    """Read the motor number of each joint, in the joint order of the tables.

    Returns:
        Motor numbers, empty if none can be used; {"motors": message} about numbers that cannot be
        used, otherwise empty.
    """
    joint_names, motors = view.find_first("joints"), view.find_first("motors")
    indices = _read_motor_numbers(motors)
    if motors.items and not indices:
        message = diagnose("contract-motors-unread", file=name, sources=motors.place.source)
        return [], {"motors": message}
    if indices and joint_names.texts and len(indices) != len(joint_names.texts):
        message = diagnose(
            "contract-motors-length",
            file=str(motors.place),
            count=len(indices),
            joints=len(joint_names.texts),
            order=str(joint_names.place),
            sources=motors.place.source,
        )
        return [], {"motors": message}
    return indices, {}


def _list_command_scales(view: _View) -> Iterator[Statement]:
    """Yield the scales of the observed command, and the period of the policy [s] from its rate."""
    commands = view.get("cmd_scale")
    if len(commands.items) == len(training.COMMAND_PARTS):
        for part, item in zip(training.COMMAND_PARTS, commands.items, strict=True):
            if item.number is not None:
                yield item.make_statement(f"observation commands {part}")
    rate, repeat = view.get("update_rate"), view.get("repeat_action")
    if rate.number and repeat.number:
        step = repeat.number / rate.number
        yield Statement("policy step", step, repeat.place, origin=Origin.DERIVED)


def _describe_unread_values(view: _View) -> dict[str, Diagnostic]:
    """Return {quantity: message} of the values under known keys that are no numbers.

    Texts that do not look like numbers may be names of parameters, and are left out.
    """
    unread = dict[str, Diagnostic]()
    for rule in view.rules:
        node = view.get(*rule.path)
        if not rule.accepts(node):
            continue
        is_list = isinstance(node.value, list)
        nodes = node.items if is_list else list(node.table.values()) or [node]
        for item in nodes:
            is_missing = is_list and len(nodes) > 1 and not isinstance(item.value, str)
            if item.number is None and (is_missing or _is_like_number(item)):
                value = "[...]" if isinstance(item.value, list | dict) else str(item.value)
                place = item.place if item.is_present else node.place
                unread[rule.quantity] = diagnose(
                    "contract-value-unread",
                    file=str(place),
                    what=Term(rule.quantity) if rule.quantity in QUANTITIES else rule.quantity,
                    value=quote_short(value) if item.is_present else "null",
                    sources=place.source,
                )
                break
    return unread


_NUMBER_START = re.compile(r"[-+]?\.?\d|[-+]?\.?(nan|inf)$", re.IGNORECASE)
"""Pattern of the start of a text that is meant as a number."""


def _is_like_number(node: LocatedValue) -> bool:
    """Return True for a truth value, and for a text that is meant as a number."""
    value = node.value
    return isinstance(value, bool) or (
        isinstance(value, str) and _NUMBER_START.match(value) is not None
    )


def _collect_name_lists(view: _View) -> dict[str, tuple[str, ...]]:
    """Return {key: texts} of the lists of two or more texts, all distinct, in a view's tables."""
    return {
        str(key): node.texts
        for table in view.tables
        for key, node in table.table.items()
        if isinstance(node.value, list) and 2 <= len(node.texts) == len(set(node.texts))
    }


def _collect_number_lists(view: _View) -> dict[str, int]:
    """Return {key: length} of lists of numbers whose key is unknown, but names a joint quantity.

    A known key is the last key of a rule, for example in another nested table.
    """
    known = {rule.path[-1] for rule in view.rules}
    return {
        str(key): len(node.items)
        for table in view.tables
        for key, node in table.table.items()
        if isinstance(node.value, list)
        and len(node.items) > 1
        and all(item.number is not None for item in node.items)
        and str(key).lower() not in known
        and names_joint_quantity(str(key), view.place.file)
    }


def list_numeric_keys(path: Path) -> tuple[str, ...]:
    """Return the keys of numbers and lists of numbers in a YAML or JSON file, as ``outer.inner``.

    Keys of lists, which more often contain a number per joint, are the first.

    Raises:
        InputError: If the file cannot be read.
        ModelError: If the file is not valid YAML or JSON, for example.
    """
    lists, numbers = list[str](), list[str]()

    def visit(node: LocatedValue, prefix: str, depth: int) -> None:
        """Append the keys of a node and its nested tables to ``lists`` and ``numbers``."""
        for key, child in node.table.items():
            name = f"{prefix}{key}"
            if isinstance(child.value, dict) and depth < _MAX_TABLE_DEPTH:
                visit(child, f"{name}.", depth + 1)
            elif isinstance(child.value, list) and any(
                item.number is not None for item in child.items
            ):
                lists.append(name)
            elif child.number is not None:
                numbers.append(name)

    for document in read_yaml_nodes(path, read_text(path)):
        visit(document, "", 0)
    return tuple(dict.fromkeys((*lists, *numbers)))


def _read_motor_numbers(motors: LocatedValue) -> list[int]:
    """Return the indices of motors; empty unless all are distinct integers >= 0."""
    numbers = [motor.number for motor in motors.items]
    whole = [
        int(number)
        for number in numbers
        if number is not None and number.is_integer() and number >= 0
    ]
    return whole if len(set(whole)) == len(numbers) else []


def _list_table_statements(
    view: _View, motors: list[int], is_standing_table: bool
) -> Iterator[Statement]:
    """Yield statements for the numbers under known keys, such as a joint's gain.

    ``motors`` are the motor indices of the joints. With ``is_standing_table``, gains, efforts and
    default angles are for standing up, and are skipped.
    """
    # Listed in the robot's motor order: see unitree_rl_lab, articulation.h, "sdk order".
    # legged_rl_deploy, whose terms are in a table ``terms``, lists gains in the policy's order.
    in_motor_order = bool(motors) and not view.get("observations", "terms").table
    is_permutation = sorted(motors) == list(range(len(motors)))
    # Source: rl_sar, ReadYaml: the robot's table is for standing up; the policy's table overrides.
    is_for_standing = is_standing_table or (
        view.get("fixed_kp").is_present and not view.get("rl_kp").is_present
    )
    for rule in view.rules:
        if is_for_standing and rule.quantity in ("effort", "default angle", "kp", "kd"):
            continue
        node = view.get(*rule.path)
        for statement in rule.list_statements(node) if rule.accepts(node) else ():
            # If motors are left out, a list may have a number for each of all motors.
            is_per_motor = not is_permutation and max(motors, default=0) < statement.count
            if (
                rule.path[-1] in ("stiffness", "damping")
                and in_motor_order
                and statement.index is not None
                and (is_permutation or is_per_motor)
            ):
                if statement.index in motors:
                    index = motors.index(statement.index)
                    count = len(motors) if is_per_motor else statement.count
                    statement = replace(statement, index=index, count=count)
                elif is_per_motor:
                    continue
            # A text is the name of a parameter, not a number of a joint.
            if statement.value is not None:
                yield statement


def _list_position_tables(node: LocatedValue) -> list[LocatedValue]:
    """Return the position actions of a policy's actions, {name of an action: table}."""
    return [
        action
        for key, action in node.table.items()
        if isinstance(action.value, dict)
        and "Velocity" not in str(key)
        and "Effort" not in str(key)
    ]


def _list_view_observations(view: _View) -> Iterator[ObservedTerm]:
    """Yield the observation terms of a deployment.

    In files of legged_rl_deploy, ``terms`` contains the terms, and ``stack`` the number and order
    of the frames; operations in ``process_order`` are applied (``Processor::TryLoad``).
    """
    terms, stack = view.get("observations", "terms"), view.get("observations", "stack")
    if not terms.table or terms.get("func").is_present:
        yield from training.list_observation_terms(view.get("observations"))
        return
    frames, order = stack.get("length").number, str(stack.get("order").value)
    for name, term in terms.table.items():
        is_read = _find_unread_operation(str(name), term) is None
        yield ObservedTerm(
            str(name),
            _read_scales(term) if is_read else None,
            term.place,
            int(frames or 0),
            _read_bounds(term) if is_read else None,
            order.replace("_", " ") if stack.table else "",
        )


def _describe_unread_terms(view: _View) -> dict[str, Diagnostic]:
    """Return {quantity: message} of the terms with an operation that is not read."""
    unread = dict[str, Diagnostic]()
    for name, term in view.get("observations", "terms").table.items():
        operation = _find_unread_operation(str(name), term)
        if operation is not None:
            quantity = f"observation {ObservedTerm(str(name), None, term.place).common_name}"
            place = term.get("process_order").place
            unread[quantity] = diagnose(
                "contract-term-unread",
                file=str(place),
                term=str(name),
                operation=operation,
                sources=place.source,
            )
    return unread


def _find_unread_operation(name: str, term: LocatedValue) -> str | None:
    """Return an operation of an observation term that `ObservedTerm` cannot contain; None without.

    The offset of joint positions as first operation is a default angle, and can be read.
    """
    operations = term.get("process_order").texts
    is_angle = _is_position(name) and operations[:1] == ("offset",)
    offsets = [item.number for item in term.get("offset").items]
    bounds = (term.get("min"), term.get("max"))
    if "scale" in operations and any(item.number is None for item in term.get("scale").items):
        return "scale"
    if "offset" in operations and not is_angle and any(offset != 0 for offset in offsets):
        return "offset"
    is_bounded = "clip" in operations and any(bound.is_present for bound in bounds)
    return "clip" if is_bounded and _read_bounds(term) is None else None


def _read_scales(term: LocatedValue) -> tuple[float, ...]:
    """Return the factors of an observation term; 1 if no factor is applied."""
    if "scale" not in term.get("process_order").texts:
        return (1.0,)
    numbers = (item.number for item in term.get("scale").items)
    return tuple(number for number in numbers if number is not None) or (1.0,)


def _read_bounds(term: LocatedValue) -> tuple[float, float] | None:
    """Return the bounds ``min`` and ``max`` of a term before scaling; None without known bounds."""
    operations, scales = term.get("process_order").texts, set(_read_scales(term))
    lows, highs = ({item.number for item in term.get(key).items} for key in ("min", "max"))
    if "clip" not in operations or len(lows) != 1 or len(highs) != 1:
        return None
    low, high = lows.pop(), highs.pop()
    is_scaled = "scale" in operations[: operations.index("clip")]
    factor = 1.0 if not is_scaled else min(scales) if len(scales) == 1 else 0.0
    return None if low is None or high is None or factor <= 0 else (low / factor, high / factor)


def _is_position(name: str) -> bool:
    """Return True for the name of an observation term of joint positions."""
    return OBSERVATION_ALIASES.get(name, name) == "joint_pos"


def _list_reference_angles(terms: LocatedValue) -> Iterator[Statement]:
    """Yield the default angles that an observation term subtracts from the joint positions.

    In files of legged_rl_deploy, the offset is added, so a default angle is the negative offset.
    """
    for name, term in terms.table.items():
        # An offset that is added after the scale is no angle.
        if _is_position(str(name)) and term.get("process_order").texts[:1] == ("offset",):
            for statement in term.get("offset").make_statements("default angle", ()):
                if statement.value is not None:
                    value = -statement.value
                    yield replace(statement, value=value, origin=Origin.DERIVED)


def _read_limits(request: Request, limits: LocatedValue) -> Iterator[JointSource]:
    """Yield at most one source, with MoveIt's joint limits.

    A limit is ignored if its ``has_..._limits`` is false.
    """
    words = {
        name: row["limits"] for name, row in FIELD_TABLE["quantities"].items() if "limits" in row
    }
    statements = [
        limit.get(word).make_statement(quantity, joint)
        for joint, limit in limits.table.items()
        for quantity, (word, switch) in words.items()
        if limit.get(word).is_present and limit.get(switch).value is not False
    ]
    if statements:
        yield JointSource(request.path.name, request.path, Role.DRIVER, tuple(statements))
