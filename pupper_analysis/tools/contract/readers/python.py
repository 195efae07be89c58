"""Reader of Python trainers: mjlab, Isaac Lab, and configuration classes of legged_gym.

Input is a Python file, evaluated from its syntax tree (`python_values`). Output is a `JointSource`
for each configuration: default angles, gains, limits, action scales and offsets, and observations.
Configurations that are part of another configuration are no sources, unless the request names one.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace

from pupper_analysis.tools.contract import python_values as py
from pupper_analysis.tools.contract import training
from pupper_analysis.tools.contract.facts import (
    JointSource,
    LocatedValue,
    Request,
    Role,
)
from pupper_analysis.tools.contract.readers import tables

FILE_SUFFIXES = (".py",)
"""Suffixes of the files that this reader of training configurations reads."""


def read(request: Request) -> Iterator[JointSource]:
    """Yield a source with joint values (such as gains) for each configuration in a Python file.

    A configuration is an object with a robot, actions or settings of a trainer. If the file has no
    such object, tables ``{key: value}`` with joint values or constants are read instead. No code is
    executed.

    Raises:
        InputError: If the file cannot be read.
        ModelError: If the file cannot be parsed, or needs too many steps, for example.
    """
    evaluator = py.Evaluator(request.folders)
    module = evaluator.load_module(request.path)
    own_names = {
        name: node
        for name, node in module.items()
        if name not in module.imported and request.name in ("", name)
    }
    roots, flat_sources = _read_names(request, evaluator, own_names)
    selected = _select_whole_configurations(request, roots)
    scales = [
        statement
        for name, node in own_names.items()
        if "action_scale" in name.lower()
        for statement in node.make_statements("action scale")
        if not request.name
    ]
    if not selected and not flat_sources:
        flat_sources += _read_constants(request, evaluator, own_names)
    if not selected and not flat_sources:  # a script may define its constants in its main block
        module = evaluator.run_main_block(request.path)
        main_names = {
            name: node
            for name, node in module.items()
            if name not in module.imported and name not in own_names
        }
        flat_sources += _read_constants(request, evaluator, main_names)
    for source in selected or flat_sources:
        stated = {statement.quantity for statement in source.statements}
        added_scales = scales if "action scale" not in stated and "kp" in stated else []
        yield replace(source, statements=(*source.statements, *added_scales))


def _read_names(
    request: Request, evaluator: py.Evaluator, own_names: Mapping[str, LocatedValue]
) -> tuple[list[tuple[LocatedValue, JointSource]], list[JointSource]]:
    """Return the joint numbers (`JointSource`) that top-level names of a Python file define.

    ``own_names`` is {name: value} of the names to be read.

    Returns:
        (configuration, source) for each trainer's configuration, and the sources of tables ``{key:
        value}``.
    """
    roots, flat_sources = list[tuple[LocatedValue, JointSource]](), list[JointSource]()
    for name, node in own_names.items():
        root, shown = _resolve_value(evaluator, node), f"{request.path.name}:{name}"
        if isinstance(root.value, py.InstanceValue):
            found = training.read_configuration(shown, request.path, root)
            roots += [(root, source) for source in found]
        elif isinstance(root.value, dict):
            flat_sources += tables.read_table(request, shown, root, Role.TRAINER)
        elif isinstance(root.value, list):
            for number, item in enumerate(root.value):
                if isinstance(item.value, dict):
                    part = f"{shown}[{number}]"
                    flat_sources += tables.read_table(request, part, item, Role.TRAINER)
    return roots, flat_sources


def _select_whole_configurations(
    request: Request, roots: Sequence[tuple[LocatedValue, JointSource]]
) -> list[JointSource]:
    """Return the sources of configurations that are not part of another configuration.

    ``roots`` are (configuration, source). All sources are returned if the request names a
    configuration.
    """
    parts = {
        training.get_class_name(instance)
        for root, _ in roots
        for instance in training.iterate_instances(root, set())
        if training.get_class_name(instance) != root.value.kind
    }
    return [
        source
        for root, source in roots
        if request.name or not root.value.class_value or root.value.kind not in parts
    ]


def _read_constants(
    request: Request, evaluator: py.Evaluator, own_names: dict[str, LocatedValue]
) -> Iterator[JointSource]:
    """Yield the sources in the constants of a Python file, such as a part of a deployment.

    ``own_names`` is {name: value} of the names to be read.
    """
    table = {
        name.lower(): _make_constant_table(evaluator, node)
        for name, node in own_names.items()
        if not name.startswith("__")
    }
    if table:
        place = next(iter(table.values())).place
        request = replace(request, name="")  # names have already been selected
        yield from tables.read_nested_tables(
            request, LocatedValue(table, replace(place, line=None))
        )


def _make_constant_table(evaluator: py.Evaluator, node: LocatedValue) -> LocatedValue:
    """Return a class as a table {name in lower case: constant or table}; other nodes unchanged.

    The table also contains constants that methods assign to attributes such as ``self.kp``.
    """
    if not isinstance(node.value, py.ClassValue):
        return node
    table = dict[str, LocatedValue]()
    for name, part in node.value.fields.items():
        if isinstance(part.value, py.FunctionValue) and isinstance(
            part.value.node, ast.FunctionDef
        ):
            for statement in ast.walk(part.value.node):
                if isinstance(statement, ast.Assign) and len(statement.targets) == 1:
                    target = statement.targets[0]
                    if isinstance(target, ast.Attribute) and isinstance(target.value, ast.Name):
                        with suppress(py.NotConstantError):
                            value = evaluator.evaluate(statement.value, part.value.enclosing_scope)
                            table.setdefault(target.attr.lower(), value)
        else:
            table[name.lower()] = _make_constant_table(evaluator, part)
    return replace(node, value=table)


def _resolve_value(evaluator: py.Evaluator, node: LocatedValue) -> LocatedValue:
    """Return a value that is an instance, table or list; create it by a call if necessary.

    The arguments of a function are instances of its annotated classes. The result has the value
    None, for example, if the call fails.
    """
    value = node.value
    if not isinstance(value, py.FunctionValue | py.ClassValue):
        is_read = isinstance(value, py.InstanceValue | dict | list)
        return node if is_read else replace(node, value=None)
    arguments: list[LocatedValue] = []
    try:
        if isinstance(value, py.FunctionValue):
            free = value.node.args.args[: -len(value.node.args.defaults) or None]
            arguments = [
                _resolve_value(evaluator, _find_annotated_class(evaluator, argument, value))
                for argument in free
            ]
        result = replace(node, value=evaluator.call(value, arguments, {}).value)
    except py.NotConstantError:
        return replace(node, value=None)
    # A function may modify its argument and return None.
    return arguments[0] if arguments and result.value is None else result


def _find_annotated_class(
    evaluator: py.Evaluator, argument: ast.arg, function: py.FunctionValue
) -> LocatedValue:
    """Return the first class in a function argument's annotation; else raise NotConstantError."""
    for child in [] if argument.annotation is None else ast.walk(argument.annotation):
        node = (
            evaluator.evaluate(child, function.enclosing_scope)
            if isinstance(child, ast.Name)
            else None
        )
        if node is not None and isinstance(node.value, py.ClassValue):
            return node
    raise py.NotConstantError
