"""Evaluation of a Python file from its syntax tree: no code is imported or executed.

Supported are constants, names, lists, tables, dataclasses, configuration classes with bases,
arithmetic, comparisons, loops over known values, and calls of some library functions and of
functions in files below the allowed folders. Every other expression becomes an ``UnknownValue``
with the text. If a statement cannot be evaluated, everything that the statement may change becomes
unknown: names, attributes and items that it assigns, and lists and tables that it changes by
methods.
"""

from __future__ import annotations

import ast
import math
import operator
import re
from collections import ChainMap, UserDict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from copy import deepcopy
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path
from typing import Any, Final, cast

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.inputs import is_input, read_text
from pupper_analysis.models.places import Place, make_file_error
from pupper_analysis.tools.contract.facts import MAX_VALUES, LocatedValue, count_decimals

MAX_INTEGER_BITS: Final = 1_000
"""Largest size [bit] of an integer that an operation or function in the evaluation of a source may
return; a larger result counts as unknown. Chosen, not tuned.
"""

MAX_CALL_DEPTH: Final = 40
"""Largest depth of nested calls in the evaluation of a source; a deeper call counts as unknown.
Chosen, not tuned.
"""


@dataclass(eq=False)
class NamedValue:
    """Value of an evaluated file that is not plain data: function, class or unknown value.

    Deep copies share the same object.
    """

    name: str

    def __str__(self) -> str:
        return self.name

    def __deepcopy__(self, _: object) -> NamedValue:
        return self


class UnknownValue(NamedValue):
    """Expression that is not constant, or a name from a module that was not read."""


class LostItem(UnknownValue):
    """Marker of a list whose elements and length are unknown, since they may have changed.

    The marker is the first element of the list; `Evaluator.evaluate` then returns an
    ``UnknownValue``.
    """


@dataclass(eq=False)
class FunctionValue(NamedValue):
    """Function of an evaluated file.

    Attributes:
        node: Syntax tree of the function.
        enclosing_scope: Scope in which the function was defined.
        bound_object: Object to which a method is bound; None for a function.
    """

    node: ast.FunctionDef | ast.Lambda
    enclosing_scope: Scope
    bound_object: LocatedValue | None = None


@dataclass(eq=False)
class ClassValue(NamedValue):
    """Class of an evaluated file.

    Attributes:
        bases: Base classes.
        fields: {name: value} of attributes and methods, including those of the bases.
        annotated_names: Annotated names, in the order of the arguments of the constructor.
    """

    bases: list[ClassValue]
    fields: dict[str, LocatedValue]
    annotated_names: list[str]


@dataclass(eq=False)
class InstanceValue:
    """Result of calling a class.

    Attributes:
        kind: Name of the class.
        fields: {name: value}.
        class_value: Class; None if the module was not read.
    """

    kind: str
    fields: dict[str, LocatedValue] = field(default_factory=dict)
    class_value: ClassValue | None = None

    def __str__(self) -> str:
        return f"{self.kind}(...)"


class ModuleNames(UserDict[str, LocatedValue]):
    """Names of an evaluated module, {name: value}."""

    def __init__(self, path: Path, lines: list[str]) -> None:
        super().__init__({"__name__": LocatedValue(path.stem, Place(path))})
        self.path, self.lines, self.fields = path, lines, self.data
        self.imported: set[str] = set()


Scope = ChainMap[str, LocatedValue]
"""Visible names, innermost scope first; the last map is the `ModuleNames` of the module."""


def get_module(scope: Scope) -> ModuleNames:
    """Return the names of the Python module that contains a scope: its outermost mapping."""
    return cast(ModuleNames, scope.maps[-1])


class NotConstantError(Exception):
    """The value of an expression is not known."""


class _ReturnSignal(Exception):  # noqa: N818
    """Signal of ``return``: ends the evaluation of a function, with its value."""

    def __init__(self, node: LocatedValue) -> None:
        self.node = node


class _BreakSignal(Exception):  # noqa: N818
    """Signal of ``break``: ends the evaluation of the innermost loop."""


class _RaiseSignal(Exception):  # noqa: N818
    """Signal of ``raise`` in the evaluated file, up to a ``try`` statement with handlers."""


class _ContinueSignal(Exception):  # noqa: N818
    """Signal of ``continue``: ends an iteration of the innermost loop."""


_OPERATOR_FUNCTIONS: Final[Mapping[type, Callable[[Any, Any], Any]]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.FloorDiv: operator.floordiv,
    ast.Mod: operator.mod,
    # Powers are computed as floats, since integers could grow without bound.
    ast.Pow: lambda a, b: float(a) ** b,
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.Is: operator.is_,
    ast.IsNot: operator.is_not,
    ast.In: lambda a, b: a in b,
    ast.NotIn: lambda a, b: a not in b,
}
"""Functions of binary operators and comparisons."""

_PURE_FUNCTIONS: Final[Mapping[str, Callable[..., Any]]] = {
    **{
        name: getattr(math, name)
        for name in (
            "sqrt",
            "sin",
            "cos",
            "tan",
            "radians",
            "degrees",
            "exp",
            "log",
            "atan2",
            "floor",
            "ceil",
        )
    },
    "deg2rad": math.radians,
    "rad2deg": math.degrees,
    "float": float,
    "int": int,
    "abs": abs,
    "round": round,
    "min": min,
    "max": max,
    "square": lambda x: x * x,
    "len": len,
    "range": range,
    "sorted": sorted,
}
"""{name in a configuration: function that its evaluation calls}, if all arguments are known
values."""
_LIST_FUNCTIONS: Final[Mapping[str, Callable[..., Any]]] = {"zip": zip, "enumerate": enumerate}
"""{name in a configuration: function that its evaluation calls}, for lists or tables whose elements
may be unknown."""
_ALLOWED_METHODS: Final[Mapping[type, Sequence[str]]] = {
    dict: ("get", "pop", "setdefault", "update", "keys", "values", "items", "copy", "clear"),
    list: ("append", "extend", "insert", "pop", "reverse", "copy", "clear"),
}
"""{type: names of its methods that the evaluation of a configuration in Python may call}."""

_CHANGING_METHODS: Final[Mapping[type, Sequence[str]]] = {
    dict: ("pop", "popitem", "setdefault", "update", "clear"),
    list: ("append", "extend", "insert", "pop", "remove", "reverse", "sort", "clear"),
}
"""{type: names of the methods that change an object of this type}."""
_ITEM_FUNCTIONS: Final = ("zip", "enumerate", "list", "tuple", "reversed", "sorted")
"""Functions whose result contains the items of the arguments."""

_NAMED_CONSTANTS: Final = {"pi": math.pi, "inf": math.inf, "tau": math.tau}
"""{name: value} of constants that numeric modules may define, such as ``np.pi``."""

_NUMERIC_MODULES: Final = ("math", "np", "numpy", "torch", "jp", "jnp")
"""Names under which configurations import numeric modules, with constants such as pi."""

_LIST_CONSTRUCTORS: Final = ("array", "asarray", "tensor", "list", "tuple", "tolist")
"""Names of functions that convert a list or table to a list."""
_TABLE_CONSTRUCTORS: Final = ("dict", "freeze", "config_dict.create", "ConfigDict")
"""Calls that merge tables and keyword arguments into one table."""
_COPY_FUNCTIONS: Final = ("copy", "deepcopy", "replace")
"""Functions that return a copy of the first argument."""

_BUILTIN_TYPES: Final = {
    "dict": dict,
    "list": list,
    "tuple": list,
    "str": str,
    "float": float,
    "int": int,
}
"""{name: type} for ``isinstance`` and ``default_factory``."""

_PROJECT_MARKERS: Final = ("setup.py", "pyproject.toml", ".git")
"""Files or folders that mark the top folder of a project."""


_MAIN_TEST = ast.unparse(ast.parse('__name__ == "__main__"'))
"""Condition ``__name__ == "__main__"`` as text, to find the block that `run_main_block`
evaluates."""


class Evaluator:
    """Evaluator of Python modules from their syntax trees, without importing or executing code.

    Args:
        folders: Folders in which imported modules are searched, after the folders above the
            importing file.

    Attributes:
        modules: {absolute path: names of the evaluated file}.
        display_folder: Folder to which the paths in places are relative; empty for absolute paths.
        steps: Number of evaluation steps so far, which is limited.
        depth: Depth of nested calls.
        open_tables: {id: table} of tables that may have further keys, which are not known.
    """

    def __init__(self, folders: tuple[Path, ...] = ()) -> None:
        self.folders = folders
        self.modules: dict[Path, ModuleNames] = {}
        self.display_folder = Path()
        self.steps, self.depth = 0, 0
        self.open_tables: dict[int, dict[Any, LocatedValue]] = {}

    def load_module(self, path: Path) -> ModuleNames:
        """Evaluate a Python file from the syntax tree, and return the names that the file defines.

        Each file is evaluated once. In a circular import, the names defined so far are returned.

        Raises:
            InputError: If the file cannot be read.
            ModelError: If the file cannot be parsed, or needs too many steps, for example.
        """
        if not path.is_absolute():  # show relative paths if the request was relative
            self.display_folder = Path.cwd()
            path = path.absolute()
        if path in self.modules:
            return self.modules[path]
        text = read_text(path)
        try:
            tree = ast.parse(text)
        except SyntaxError as error:
            message = diagnose("contract-no-python", problem=error.msg)
            raise make_file_error(Place(path, error.lineno), message) from error
        except (MemoryError, ValueError) as error:
            raise make_file_error(Place(path), diagnose("contract-too-deep")) from error
        result = self.modules[path] = ModuleNames(path, re.split("\r\n?|\n", text))
        with suppress(_BreakSignal, _ContinueSignal, _RaiseSignal, _ReturnSignal):
            self.run_statements(tree.body, Scope(result))
        return result

    def run_main_block(self, path: Path) -> ModuleNames:
        """Evaluate the block ``if __name__ == "__main__"`` of a file, after the file itself.

        Returns:
            Names of the file, including names that the block defines.

        Raises:
            InputError: If the file cannot be read.
            ModelError: If the file cannot be parsed, or needs too many steps, for example.
        """
        result = self.load_module(path)
        for statement in ast.parse(read_text(path)).body:
            if isinstance(statement, ast.If) and ast.unparse(statement.test) == _MAIN_TEST:
                with suppress(_BreakSignal, _ContinueSignal, _RaiseSignal, _ReturnSignal):
                    self.run_statements(statement.body, Scope(result))
        return result

    # Statements.

    def run_statements(self, body: list[ast.stmt], scope: Scope) -> None:
        """Evaluate statements in order, and store the assigned names in ``scope``.

        If a statement cannot be evaluated, all values that the statement may change become unknown
        (`_invalidate_changed_values`).
        """
        for statement in body:
            self._count_step(statement, scope)
            try:
                getattr(self, f"_run_{type(statement).__name__.lower()}", self._raise_not_constant)(
                    statement, scope
                )
            except NotConstantError:
                self._invalidate_changed_values(statement, scope)

    def _count_step(self, node: ast.AST, scope: Scope) -> None:
        """Count an evaluation step; raise a ModelError above `MAX_VALUES` steps."""
        self.steps += 1
        if self.steps > MAX_VALUES:
            place = self._make_place(node, scope)
            raise make_file_error(place, diagnose("contract-too-much", most=MAX_VALUES))

    def _raise_not_constant(self, *_: object) -> None:
        """Raise the error for a syntax element that is not supported."""
        raise NotConstantError

    def _run_assign(self, statement: ast.Assign | ast.AnnAssign, scope: Scope) -> None:
        """Assign the right-hand side to all targets; an annotation without value has no effect."""
        if statement.value is not None:
            value = self.evaluate(statement.value, scope)
            for target in (
                statement.targets if isinstance(statement, ast.Assign) else [statement.target]
            ):
                self._assign_target(target, value, scope)

    _run_annassign = _run_assign

    def _run_augassign(self, statement: ast.AugAssign, scope: Scope) -> None:
        """Assign the result of an operation such as ``x += 1`` to the target ``x``.

        A list is changed in place: other names of the same list have the new content.
        """
        read = ast.copy_location(
            ast.BinOp(statement.target, statement.op, statement.value), statement
        )
        before, result = self.evaluate(statement.target, scope).value, self.evaluate(read, scope)
        if isinstance(before, list) and isinstance(result.value, list):
            before[:] = result.value
            result = replace(result, value=before)
        elif isinstance(before, list | dict):
            raise NotConstantError
        self._assign_target(statement.target, result, scope)

    def _run_expr(self, statement: ast.Expr, scope: Scope) -> None:
        """Evaluate an expression statement, for example a call.

        Raises:
            NotConstantError: If a call cannot be evaluated: it may have changed values.
        """
        result = self.evaluate(statement.value, scope)
        if isinstance(statement.value, ast.Call) and isinstance(result.value, UnknownValue):
            raise NotConstantError

    def _run_return(self, statement: ast.Return, scope: Scope) -> None:
        """Raise the signal that leaves a function with the returned value."""
        raise _ReturnSignal(
            self.evaluate(
                statement.value or ast.copy_location(ast.Constant(None), statement), scope
            )
        )

    def _run_raise(self, *_: object) -> None:
        """Raise the signal of a ``raise`` statement, which a ``try`` with handlers ends."""
        raise _RaiseSignal

    def _run_break(self, *_: object) -> None:
        """Raise the signal that ends the innermost loop."""
        raise _BreakSignal

    def _run_continue(self, *_: object) -> None:
        """Raise the signal that ends the current iteration of the innermost loop."""
        raise _ContinueSignal

    def _run_if(self, statement: ast.If, scope: Scope) -> None:
        """Run the branch of an ``if`` statement that the condition selects."""
        self.run_statements(
            statement.body
            if self._is_true(self.evaluate(statement.test, scope))
            else statement.orelse,
            scope,
        )

    def _run_for(self, statement: ast.For, scope: Scope) -> None:
        """Run a loop over list items or table keys, and ``else`` if no ``break`` ends the loop."""
        try:
            for item in self._list_items(self.evaluate(statement.iter, scope)):
                self._assign_target(statement.target, item, scope)
                with suppress(_ContinueSignal):
                    self.run_statements(statement.body, scope)
        except _BreakSignal:
            return
        self.run_statements(statement.orelse, scope)

    def _run_try(self, statement: ast.Try | ast.With, scope: Scope) -> None:
        """Evaluate the body of ``try`` or ``with``, then of ``else`` and ``finally``.

        Exception handlers are not evaluated; if the body raises, the values that they assign are
        unknown.
        """
        handlers = getattr(statement, "handlers", ())
        for item in getattr(statement, "items", ()):
            lost = self._make_node(UnknownValue(ast.unparse(item)[:80]), statement, scope)
            for node in ast.walk(item.optional_vars) if item.optional_vars else ():
                if isinstance(node, ast.Name):
                    scope[node.id] = lost
        try:
            self.run_statements([*statement.body, *getattr(statement, "orelse", ())], scope)
        except _RaiseSignal:
            if not handlers:
                raise
            for handler in handlers:
                self._invalidate_changed_values(handler, scope)
        finally:
            self.run_statements(getattr(statement, "finalbody", []), scope)

    _run_with = _run_try

    def _run_functiondef(self, statement: ast.FunctionDef, scope: Scope) -> None:
        """Add a defined function to the scope."""
        # Names in a class body are not visible in its methods.
        of = scope.get("__class__")
        method = of is not None and scope.maps[0] is of.value.fields
        enclosing = scope.parents if method else scope
        scope[statement.name] = self._make_node(
            FunctionValue(statement.name, statement, enclosing), statement, scope
        )

    def _run_classdef(self, statement: ast.ClassDef, scope: Scope) -> None:
        """Run the body of a class, and add the class with inherited fields to the scope."""
        bases = [self.evaluate(base, scope).value for base in statement.bases]
        known = [base for base in bases if isinstance(base, ClassValue)]
        inherited = dict(ChainMap(*(base.fields for base in known)))
        result = ClassValue(
            statement.name,
            known,
            inherited,
            [name for base in known for name in base.annotated_names],
        )
        decorators = "".join(map(ast.unparse, statement.decorator_list))
        if "dataclass" in decorators or "configclass" in decorators:  # have their own ``__init__``
            inherited.pop("__init__", None)
        node = self._make_node(result, statement, scope)
        self.run_statements(
            statement.body, scope.new_child({"__class__": node}).new_child(result.fields)
        )
        for class_statement in statement.body:
            if isinstance(class_statement, ast.AnnAssign) and isinstance(
                class_statement.target, ast.Name
            ):
                result.annotated_names.append(class_statement.target.id)
        scope[statement.name] = node

    def _run_import(self, statement: ast.Import, scope: Scope) -> None:
        """Add imported modules to the scope; a module that is not found is an unknown value."""
        for name in statement.names:
            shown = name.asname or name.name.split(".")[0]
            result = self._find_module(scope, name.name if name.asname else shown, 0)
            self._add_imports(
                {shown: self._make_node(result or UnknownValue(shown), statement, scope)}, scope
            )

    def _run_importfrom(self, statement: ast.ImportFrom, scope: Scope) -> None:
        """Evaluate ``from module import name``; a name that is not found gets an unknown value."""
        home: Mapping[str, LocatedValue] = (
            self._find_module(scope, statement.module or "", statement.level) or {}
        )
        for name in statement.names:
            if name.name == "*":
                self._add_imports(home, scope)
                continue
            below = (
                None
                if name.name in home
                else self._find_module(
                    scope, f"{statement.module or ''}.{name.name}", statement.level
                )
            )
            lost = self._make_node(below or UnknownValue(name.name), statement, scope)
            self._add_imports({name.asname or name.name: home.get(name.name, lost)}, scope)

    def _add_imports(self, names: Mapping[str, LocatedValue], scope: Scope) -> None:
        """Add imported names to a scope, and record in the module that the names are imported."""
        scope.update(names)
        get_module(scope).imported.update(names)

    def _find_module(self, scope: Scope, dotted: str, level: int) -> ModuleNames | None:
        """Load an imported module; None if no search folder contains its file.

        ``dotted`` is the name without leading dots, ``level`` the number of leading dots.
        """
        path = get_module(scope).path
        parts = [part for part in dotted.split(".") if part]
        tops = (
            path.parents[level - 1 : level]
            if level
            else (*_list_search_folders(path), *self.folders)
        )
        for top in tops:
            base = top.joinpath(*parts)
            for file in (base.with_suffix(".py") if parts else base, base / "__init__.py"):
                if is_input(file):
                    return self.load_module(file)
        return None

    def _invalidate_changed_values(
        self, statement: ast.stmt | ast.ExceptHandler, scope: Scope
    ) -> None:
        """Set the values that a statement may change to unknown values.

        Such values are names, attributes and items that the statement assigns, lists and tables
        that called methods or functions change, and names that are defined or imported.
        """
        for content, key, lost in [*self._list_changes([statement], scope, {}, set())]:
            if key is not None:
                with suppress(NotConstantError):
                    self._apply_function(operator.setitem, content, key, lost)
            elif isinstance(content, dict):
                content.update(dict.fromkeys(content, lost))
                self.open_tables[id(content)] = content
            else:
                item = replace(lost, value=LostItem(lost.value.name))
                content[:] = [item] * max(len(content), 1)
        within = (node for node in ast.walk(statement) if isinstance(node, ast.stmt))
        for cause, node in ((inner, node) for inner in within for node in ast.walk(inner)):
            stored = isinstance(node, ast.Name | ast.Attribute | ast.Subscript)
            listed = isinstance(node, ast.Subscript) and self._find_values(node.value, scope, {})
            if not stored or listed:
                continue
            if isinstance(node.ctx, ast.Store | ast.Del):  # type: ignore[attr-defined]
                with suppress(NotConstantError):
                    lost = self._make_unknown(cause, node, scope)
                    self._assign_target(cast(ast.expr, node), lost, scope)
        for node in _walk_block(statement):
            for name in _list_defined_names(node):
                if name in scope and not isinstance(scope[name].value, UnknownValue):
                    scope[name] = self._make_unknown(node, node, scope)

    def _make_unknown(self, cause: ast.AST, node: ast.AST, scope: Scope) -> LocatedValue:
        """Make an unknown value with the first line of ``cause``, usually a statement, as text.

        ``node`` is the syntax element whose place (file and line) the value gets.
        """
        first_line = ast.unparse(cause).partition("\n")[0][:80]
        return self._make_node(UnknownValue(first_line), node, scope)

    def _list_changes(
        self,
        body: Sequence[ast.AST],
        scope: Scope,
        origins: dict[str, list[LocatedValue]],
        seen: set[tuple[object, ...]],
    ) -> Iterator[tuple[Any, Any, LocatedValue]]:
        """Yield the lists, tables and fields that statements may change.

        Args:
            body: Statements.
            scope: Visible names.
            origins: {name: values to which the name may refer while the statements run}; names that
                the statements assign are added.
            seen: Functions that were searched, with the identities of their arguments; called
                functions are added. A recursive call is not searched.

        Yields:
            Content, key and unknown value. The key is None if any item may change.
        """
        nodes = [node for statement in body for node in ast.walk(statement)]
        for node in nodes * 2:  # twice, since a loop may use a name before the name is assigned
            for target, values in self._list_bindings(node, scope, origins):
                for name in ast.walk(target):
                    if isinstance(name, ast.Name):
                        known = origins.setdefault(name.id, [])
                        have = {id(value.value) for value in known}
                        known += [value for value in values if id(value.value) not in have]
        assigned = {
            node.id
            for node in nodes
            if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)
        }
        within = (node for node in nodes if isinstance(node, ast.stmt))
        for cause, node in ((inner, node) for inner in within for node in ast.walk(inner)):
            found: list[tuple[Any, Any]]
            match node:
                case ast.Attribute(ctx=ast.Store() | ast.Del()):
                    found = [
                        (owner.value.fields, node.attr)
                        for owner in self._find_values(node.value, scope, origins)
                        if isinstance(owner.value, InstanceValue | ClassValue)
                    ]
                case ast.Subscript(ctx=ast.Store() | ast.Del()):
                    key = self._find_key(node.slice, scope, {*assigned, *origins})
                    shifts = isinstance(node.ctx, ast.Del)
                    found = [
                        (owner.value, None if shifts and isinstance(owner.value, list) else key)
                        for owner in self._find_values(node.value, scope, origins)
                    ]
                case ast.AugAssign(target=ast.Name()):
                    found = [
                        (owner.value, None)
                        for owner in self._find_values(node.target, scope, origins)
                    ]
                case ast.Call():
                    found = [
                        *self._list_method_changes(node, scope, {*assigned, *origins}, origins)
                    ]
                    yield from self._list_call_changes(node, scope, origins, seen)
                case _:
                    found = []
            for content, key in found:
                if isinstance(content, list | dict):
                    yield content, key, self._make_unknown(cause, node, scope)

    def _list_bindings(
        self, node: ast.AST, scope: Scope, origins: dict[str, list[LocatedValue]]
    ) -> Iterator[tuple[ast.expr, list[LocatedValue]]]:
        """Yield the targets to which a node assigns, with the values that they may get."""
        match node:
            case ast.Assign():
                bound = [(target, node.value) for target in node.targets]
            case ast.AnnAssign(value=ast.expr()) | ast.NamedExpr():
                bound = [(node.target, cast(ast.expr, node.value))]
            case ast.For() | ast.comprehension():
                bound = [(node.target, node.iter)]
            case ast.withitem(optional_vars=ast.expr()):
                bound = [(cast(ast.expr, node.optional_vars), node.context_expr)]
            case _:
                bound = []
        for target, source in bound:
            values = self._find_values(source, scope, origins)
            if not isinstance(target, ast.Name) or not isinstance(node, ast.Assign | ast.AnnAssign):
                values += [item for value in values for item in _list_parts(value)]
                values += [item for value in values for item in _list_parts(value)]
            yield target, values

    def _find_values(
        self, expression: ast.expr, scope: Scope, origins: dict[str, list[LocatedValue]]
    ) -> list[LocatedValue]:
        """Return the known values to which an expression may refer; no function is called."""
        match expression:
            case ast.Name():
                known = [scope[expression.id]] if expression.id in scope else []
                return [*known, *origins.get(expression.id, ())]
            case ast.Attribute():
                owners = self._find_values(expression.value, scope, origins)
                tables = [owner.table for owner in owners] + [
                    cast(dict[Any, LocatedValue], owner.value.data)
                    for owner in owners
                    if isinstance(owner.value, ModuleNames)
                ]
                return [table[expression.attr] for table in tables if expression.attr in table]
            case ast.Subscript():
                key = self._find_key(expression.slice, scope, origins)
                return self._find_items(expression.value, key, scope, origins)
            case ast.Call(func=ast.Attribute(attr="values" | "items")):
                function = cast(ast.Attribute, expression.func)
                items = self._find_items(function.value, None, scope, origins)
                return [LocatedValue(items, Place(Path()))]
            case ast.Call(func=ast.Attribute(attr="get" | "setdefault" | "pop")):
                function = cast(ast.Attribute, expression.func)
                key = (
                    self._find_key(expression.args[0], scope, origins) if expression.args else None
                )
                more = [
                    value
                    for argument in expression.args[1:]
                    for value in self._find_values(argument, scope, origins)
                ]
                return [*self._find_items(function.value, key, scope, origins), *more]
            case ast.Call(func=ast.Name()) if cast(ast.Name, expression.func).id in _ITEM_FUNCTIONS:
                parts = [
                    item
                    for argument in expression.args
                    for value in self._find_values(argument, scope, origins)
                    for item in _list_parts(value)
                ]
                return [LocatedValue(parts, Place(Path()))]
            case ast.Tuple() | ast.List():
                parts = [
                    value
                    for element in expression.elts
                    for value in self._find_values(element, scope, origins)
                ]
                return [LocatedValue(parts, Place(Path()))]
            case ast.IfExp():
                operands = [expression.body, expression.orelse]
            case ast.BoolOp():
                operands = expression.values
            case ast.NamedExpr() | ast.Starred():
                operands = [expression.value]
            case _:
                operands = []
        return [
            value for operand in operands for value in self._find_values(operand, scope, origins)
        ]

    def _find_items(
        self,
        expression: ast.expr,
        key: Any,
        scope: Scope,
        origins: dict[str, list[LocatedValue]],
    ) -> list[LocatedValue]:
        """Return the items with a key or index in the lists and tables of an expression.

        All items if ``key`` is None. No function is called.
        """
        result: list[LocatedValue] = []
        for owner in self._find_values(expression, scope, origins):
            if key is None:
                result += _list_parts(owner)
            elif isinstance(owner.value, list | dict):
                with suppress(NotConstantError):
                    result.append(self._apply_function(operator.getitem, owner.value, key))
        return result

    def _find_key(self, expression: ast.expr, scope: Scope, changing: Iterable[str]) -> Any:
        """Return the value of a key expression; None if the value is unknown or may change.

        The value may change if the expression contains a call or a name of ``changing``. None also
        for a slice.
        """
        changing = {*changing}
        for node in ast.walk(expression):
            if isinstance(node, ast.Call | ast.Slice) or (
                isinstance(node, ast.Name) and node.id in changing
            ):
                return None
        value = self.evaluate(expression, scope).value
        return value if isinstance(value, str | int | float | bool) else None

    def _list_method_changes(
        self,
        call: ast.Call,
        scope: Scope,
        changing: set[str],
        origins: dict[str, list[LocatedValue]],
    ) -> Iterator[tuple[Any, Any]]:
        """Yield the lists and tables that a call of a method may change, each with its key.

        The key is None if any item may change.
        """
        if not isinstance(call.func, ast.Attribute):
            return
        name = call.func.attr
        for owner in self._find_values(call.func.value, scope, origins):
            content = owner.value
            if name not in _CHANGING_METHODS.get(type(content), ()):
                continue
            if isinstance(content, list) or name in ("popitem", "clear"):
                yield content, None
                continue
            keys: list[Any] = [keyword.arg for keyword in call.keywords]
            for argument in call.args[: 1 if name != "update" else None]:
                if name != "update":
                    keys.append(self._find_key(argument, scope, changing))
                elif isinstance(argument, ast.Dict):
                    keys += [key and self._find_key(key, scope, changing) for key in argument.keys]
                else:
                    is_stable = isinstance(argument, ast.Name) and argument.id not in changing
                    update = self.evaluate(argument, scope).value if is_stable else None
                    keys += update if isinstance(update, dict) else [None]
            for key in keys:
                has = key is not None and key in content
                if key is None or name == "update" or has is (name == "pop"):
                    yield content, key

    def _list_call_changes(
        self,
        call: ast.Call,
        scope: Scope,
        origins: dict[str, list[LocatedValue]],
        seen: set[tuple[object, ...]],
    ) -> Iterator[tuple[Any, Any, LocatedValue]]:
        """Yield the contents that a call may change, if the call runs functions of evaluated files.

        Yields:
            Content (list, table or fields), key and unknown value, as `_list_changes`.
        """
        owners: list[LocatedValue | None] = [None]
        if isinstance(call.func, ast.Attribute):
            owners = [*self._find_values(call.func.value, scope, origins)]
        for called in self._find_values(call.func, scope, origins):
            function = called.value
            if not isinstance(function, FunctionValue) or self.depth >= MAX_CALL_DEPTH:
                continue
            node = function.node
            names = [argument.arg for argument in (*node.args.posonlyargs, *node.args.args)]
            bound = [
                owner
                for owner in owners
                if owner is not None and isinstance(owner.value, InstanceValue | ClassValue)
            ]
            inside: dict[str, list[LocatedValue]] = dict(zip(names, [bound], strict=False))
            sources = [(None, argument) for argument in call.args] + [
                (keyword.arg, keyword.value) for keyword in call.keywords
            ]
            for place, (keyword, source) in enumerate(sources, 1 if bound else 0):
                name = keyword or (names[place] if place < len(names) else "")
                inside.setdefault(name, []).extend(self._find_values(source, scope, origins))
            every = [*names, *(argument.arg for argument in node.args.kwonlyargs)]
            key = (
                id(node),
                *((name, frozenset(_list_identities(values))) for name, values in inside.items()),
            )
            if key in seen or (id(node),) in seen:
                continue
            seen |= {key, (id(node),)}
            self._count_step(node, scope)
            lost = {
                name: self._make_node(UnknownValue(name), node, function.enclosing_scope)
                for name in every
            }
            self.depth += 1
            yield from self._list_changes(
                node.body if isinstance(node, ast.FunctionDef) else [ast.Expr(node.body)],
                function.enclosing_scope.new_child(lost),
                inside,
                seen,
            )
            self.depth -= 1
            seen.remove((id(node),))

    def _assign_target(self, target: ast.expr, value: LocatedValue, scope: Scope) -> None:
        """Assign a value to a name, to several names, to an attribute or to an item.

        An item of an object that is neither a list nor a table is ignored.

        Raises:
            NotConstantError: If the value does not fit the target, for example.
        """
        match target:
            case ast.Name():
                scope[target.id] = value
            case ast.Tuple() | ast.List():
                for element, part in self._apply_function(
                    zip, target.elts, self._list_items(value), strict=True
                ):
                    self._assign_target(element, part, scope)
            case ast.Attribute():
                self._get_owner_fields(target.value, scope)[target.attr] = value
            case ast.Subscript():
                content = self.evaluate(target.value, scope).value
                if isinstance(content, list | dict):
                    is_unknown = isinstance(self.evaluate(target.slice, scope).value, UnknownValue)
                    if is_unknown and not isinstance(target.slice, ast.Attribute):  # no enum member
                        raise NotConstantError
                    self._apply_function(
                        operator.setitem, content, self._make_key(target.slice, scope), value
                    )
            case _:
                raise NotConstantError

    def _get_owner_fields(self, node: ast.expr, scope: Scope) -> dict[str, LocatedValue]:
        """Return the fields {name: value} of an object or class, for an assignment to an attribute.

        For values without fields, the result is a new, empty table.
        """
        owner = self.evaluate(node, scope).value
        result = owner if isinstance(owner, InstanceValue | ClassValue) else InstanceValue("")
        if isinstance(node, ast.Attribute) and isinstance(owner, UnknownValue):
            # Field of a base class that was not read.
            self._get_owner_fields(node.value, scope)[node.attr] = self._make_node(
                result, node, scope
            )
        return result.fields

    # Expressions.

    def evaluate(self, expression: ast.expr, scope: Scope) -> LocatedValue:
        """Evaluate an expression, and return the value with the line of the expression.

        The value of an expression that is not constant is an ``UnknownValue`` with the text of the
        expression.

        Raises:
            ModelError: If the evaluation takes too many steps, for example.
        """
        self._count_step(expression, scope)
        try:
            result = getattr(
                self, f"_evaluate_{type(expression).__name__.lower()}", self._raise_not_constant
            )(expression, scope)
        except NotConstantError:
            result = UnknownValue(ast.unparse(expression)[:80])
        node = self._make_node(result, expression, scope)
        first = node.value[0].value if isinstance(node.value, list) and node.value else None
        return (
            replace(node, value=UnknownValue(first.name)) if isinstance(first, LostItem) else node
        )

    def _make_node(self, value: Any, expression: ast.AST, scope: Scope) -> LocatedValue:
        """Make a node of a value and its list items, with the place of an expression."""
        if isinstance(value, list | tuple):
            value = [
                part if isinstance(part, LocatedValue) else self._make_node(part, expression, scope)
                for part in value
            ]
        known = value if isinstance(value, LocatedValue) else LocatedValue(value, Place(Path()))
        return replace(known, place=self._make_place(expression, scope))

    def _make_place(self, expression: ast.AST, scope: Scope) -> Place:
        """Return file and line of an expression."""
        path = get_module(scope).path
        near = self.display_folder != Path() and path.is_relative_to(self.display_folder)
        return Place(
            path.relative_to(self.display_folder) if near else path,
            getattr(expression, "lineno", None),
        )

    def _apply_function(self, work: Callable[..., Any], *arguments: Any, **keywords: Any) -> Any:
        """Call a function of the interpreter, such as ``math.sin``, with known values.

        An iterable result becomes a list.

        Raises:
            NotConstantError: If the function fails, the result or an argument is too large, or the
                result is a complex number.
        """
        try:
            result = work(*arguments, **keywords)
            if isinstance(result, Iterable) and not isinstance(result, str | dict):
                result = list(islice(result, MAX_VALUES + 1))
        except (ArithmeticError, ValueError, TypeError, LookupError) as error:
            raise NotConstantError from error
        sizes = [
            len(value) for value in (result, *arguments) if isinstance(value, str | list | dict)
        ]
        self.steps += sum(sizes)
        large = isinstance(result, int) and result.bit_length() > MAX_INTEGER_BITS
        if large or isinstance(result, complex) or max(sizes, default=0) > MAX_VALUES:
            raise NotConstantError
        return result

    def _is_true(self, node: LocatedValue) -> bool:
        """Return the truth of a value.

        Raises:
            NotConstantError: If the value is unknown, or a function, class or module.
        """
        if isinstance(node.value, NamedValue | ModuleNames):
            raise NotConstantError
        return bool(node.value)

    def _list_items(self, node: LocatedValue) -> list[LocatedValue]:
        """Return the items of a list or the keys of a table; else raise NotConstantError."""
        if isinstance(node.value, dict):
            return [LocatedValue(key, value.place) for key, value in node.value.items()]
        if not isinstance(node.value, list):
            raise NotConstantError
        return node.value

    def _to_plain(self, node: LocatedValue) -> Any:
        """Return the value of a node without source locations, also without those of list items.

        Tables and objects in the value are returned unchanged: their contents keep the locations.

        Raises:
            NotConstantError: If a value is unknown, for example.
        """
        self.steps += 1
        if isinstance(node.value, UnknownValue) or self.steps > MAX_VALUES:
            raise NotConstantError
        many = isinstance(node.value, list)
        return [self._to_plain(item) for item in node.value] if many else node.value

    def _evaluate_items(self, every: list[ast.expr], scope: Scope) -> list[LocatedValue]:
        """Evaluate expressions; a starred expression yields all items."""
        return [
            part
            for expression in every
            for part in (
                self._list_items(self.evaluate(expression.value, scope))
                if isinstance(expression, ast.Starred)
                else [self.evaluate(expression, scope)]
            )
        ]

    def _make_key(self, expression: ast.expr, scope: Scope) -> Any:
        """Return a key of a table; for an unknown value, the text of this value.

        Raises:
            NotConstantError: If the value is no text, number or truth value.
        """
        value = self.evaluate(expression, scope).value
        if not isinstance(value, str | int | float | bool | UnknownValue):
            raise NotConstantError
        return str(value) if isinstance(value, UnknownValue) else value

    def _evaluate_constant(self, expression: ast.Constant, scope: Scope) -> LocatedValue:
        """Return the value of a literal, with the decimals that a number has in the source."""
        digits = None
        if isinstance(expression.value, int | float) and not isinstance(expression.value, bool):
            row = get_module(scope).lines[expression.lineno - 1].encode()
            digits = count_decimals(
                row[expression.col_offset : expression.end_col_offset].decode(errors="replace")
            )
        return LocatedValue(expression.value, self._make_place(expression, scope), digits)

    def _evaluate_name(self, expression: ast.Name, scope: Scope) -> Any:
        """Return the value of a name; an unknown value if the scope lacks the name."""
        return scope.get(expression.id) or UnknownValue(expression.id)

    def _evaluate_attribute(self, expression: ast.Attribute, scope: Scope) -> Any:
        """Return an attribute of an object, table, module or ``super()``.

        A method is bound to its object.

        Raises:
            NotConstantError: If there is no such attribute, for example.
        """
        if isinstance(expression.value, ast.Call) and ast.unparse(expression.value.func) == "super":
            owner, node = scope.get("__class__"), scope.get("self")
            if owner is None or node is None:  # for example in a class method
                raise NotConstantError
            names: Any = ChainMap(*(base.fields for base in owner.value.bases))
        else:
            node = self.evaluate(expression.value, scope)
            names = node.table or (_NAMED_CONSTANTS if str(node.value) in _NUMERIC_MODULES else {})
        result = self._apply_function(operator.getitem, names, expression.attr)
        method = isinstance(result, LocatedValue) and isinstance(result.value, FunctionValue)
        if method and isinstance(node.value, InstanceValue | ClassValue):
            return replace(result.value, bound_object=node)
        return result

    def _evaluate_tuple(self, expression: ast.Tuple, scope: Scope) -> list[LocatedValue]:
        """Return the values of a tuple, list or set, with starred elements expanded."""
        return self._evaluate_items(expression.elts, scope)

    _evaluate_list = _evaluate_set = _evaluate_tuple

    def _evaluate_dict(self, expression: ast.Dict, scope: Scope) -> dict[Any, LocatedValue]:
        """Return {key: value} of a dict literal, with entries of ``**other`` included."""
        result: dict[Any, LocatedValue] = {}
        for key, value in zip(expression.keys, expression.values, strict=True):
            content = self.evaluate(value, scope)
            result |= content.table if key is None else {self._make_key(key, scope): content}
        return result

    def _evaluate_subscript(self, expression: ast.Subscript, scope: Scope) -> Any:
        """Return an element or slice of a list or table.

        Raises:
            NotConstantError: If there is no such element, for example.
        """
        owner = self.evaluate(expression.value, scope).value
        if not isinstance(owner, list | dict):
            raise NotConstantError
        if not isinstance(expression.slice, ast.Slice):
            return self._apply_function(
                operator.getitem, owner, self._make_key(expression.slice, scope)
            )
        ends = (expression.slice.lower, expression.slice.upper, expression.slice.step)
        part = slice(*(end and self._to_plain(self.evaluate(end, scope)) for end in ends))
        return self._apply_function(operator.getitem, owner, part)

    def _evaluate_binop(self, expression: ast.BinOp, scope: Scope) -> Any:
        """Return the result of a binary operation on numbers, lists or texts.

        Raises:
            NotConstantError: If an operand is unknown, for example.
        """
        left, right = (
            self.evaluate(operand, scope).value for operand in (expression.left, expression.right)
        )
        added = isinstance(expression.op, ast.Add) and type(left) is type(right)
        joined = added and isinstance(left, list | str)
        repeated = (
            isinstance(expression.op, ast.Mult) and isinstance(left, list) and _is_number(right)
        )
        numbers = _is_number(left) and _is_number(right)
        if not (numbers or joined or (repeated and len(left) * right <= MAX_VALUES)):
            raise NotConstantError
        return self._apply_function(
            _OPERATOR_FUNCTIONS.get(type(expression.op), self._raise_not_constant), left, right
        )

    def _evaluate_unaryop(self, expression: ast.UnaryOp, scope: Scope) -> Any:
        """Return the result of ``not``, or a number with sign.

        Raises:
            NotConstantError: If the operand is unknown, for example.
        """
        if isinstance(expression.op, ast.Not):
            return not self._is_true(self.evaluate(expression.operand, scope))
        operand = self.evaluate(expression.operand, scope)
        if not _is_number(operand.value) or isinstance(expression.op, ast.Invert):
            raise NotConstantError
        sign = -1 if isinstance(expression.op, ast.USub) else 1
        return LocatedValue(sign * operand.value, operand.place, operand.decimals)

    def _evaluate_boolop(self, expression: ast.BoolOp, scope: Scope) -> LocatedValue:
        """Return the first operand that decides ``and`` or ``or``, otherwise the last operand."""
        for operand in expression.values:
            result = self.evaluate(operand, scope)
            if self._is_true(result) is isinstance(expression.op, ast.Or):
                break
        return result

    def _evaluate_compare(self, expression: ast.Compare, scope: Scope) -> Any:
        """Return the result of a single comparison.

        Raises:
            NotConstantError: If a value is unknown, or several comparisons are chained, for
                example.
        """
        if len(expression.ops) > 1:
            raise NotConstantError
        both = [
            self._to_plain(self.evaluate(operand, scope))
            for operand in (expression.left, *expression.comparators)
        ]
        if isinstance(expression.ops[0], ast.In | ast.NotIn) and self._is_open(both[1], both[0]):
            raise NotConstantError
        return self._apply_function(_OPERATOR_FUNCTIONS[type(expression.ops[0])], *both)

    def _evaluate_ifexp(self, expression: ast.IfExp, scope: Scope) -> LocatedValue:
        """Evaluate ``a if condition else b``: the condition, then only the selected operand."""
        return self.evaluate(
            expression.body
            if self._is_true(self.evaluate(expression.test, scope))
            else expression.orelse,
            scope,
        )

    def _evaluate_lambda(self, expression: ast.Lambda, scope: Scope) -> FunctionValue:
        """Return the function that a lambda expression defines."""
        return FunctionValue("lambda", expression, scope)

    def _evaluate_listcomp(self, expression: ast.ListComp, scope: Scope) -> list[LocatedValue]:
        """Return the list of a comprehension such as ``[x for x in values]``."""
        return [
            self.evaluate(expression.elt, inner)
            for inner in self._iterate_loops(expression.generators, scope)
        ]

    _evaluate_generatorexp = _evaluate_listcomp

    def _evaluate_dictcomp(self, expression: ast.DictComp, scope: Scope) -> dict[Any, LocatedValue]:
        """Return the table {key: value} of a dict comprehension."""
        return {
            self._make_key(expression.key, inner): self.evaluate(expression.value, inner)
            for inner in self._iterate_loops(expression.generators, scope)
        }

    def _iterate_loops(self, loops: list[ast.comprehension], scope: Scope) -> Iterator[Scope]:
        """Yield the scope of each iteration of nested comprehension loops."""
        if not loops:
            yield scope
            return
        for item in self._list_items(self.evaluate(loops[0].iter, scope)):
            here = scope.new_child()
            self._assign_target(loops[0].target, item, here)
            if all(self._is_true(self.evaluate(test, here)) for test in loops[0].ifs):
                yield from self._iterate_loops(loops[1:], here)

    # Calls.

    def _evaluate_call(self, expression: ast.Call, scope: Scope) -> Any:
        """Return the result of a call of a function, class or method."""
        arguments = self._evaluate_items(expression.args, scope)
        keywords: dict[str, LocatedValue] = {}
        for keyword in expression.keywords:
            content = self.evaluate(keyword.value, scope)
            if keyword.arg is not None:
                keywords[keyword.arg] = replace(content, place=self._make_place(keyword, scope))
            else:
                keywords.update({str(key): value for key, value in content.table.items()})
        called = self.evaluate(expression.func, scope).value
        if isinstance(called, FunctionValue | ClassValue):
            return self.call(called, arguments, keywords)
        if isinstance(expression.func, ast.Attribute):
            content, name = self.evaluate(expression.func.value, scope), expression.func.attr
            if name in _ALLOWED_METHODS.get(type(content.value), ()):
                return self._call_method(content.value, name, arguments, keywords)
            if isinstance(content.value, str):  # ``text.replace`` is no copy of its argument
                raise NotConstantError
            if isinstance(content.value, list | InstanceValue) and name.islower():
                arguments.insert(0, content)
        return self._call_library(ast.unparse(expression.func), arguments, keywords)

    def _call_library(
        self, called: str, arguments: list[LocatedValue], keywords: dict[str, LocatedValue]
    ) -> Any:
        """Evaluate the call of a library function, or of a class whose module was not read.

        A name with an initial capital counts as a class. The instance has the keywords as fields,
        and positional arguments in the field ``args``. ``called`` is the text of the called
        expression, such as ``math.radians``.

        Raises:
            NotConstantError: If the function is not supported, or an argument unknown, for example.
        """
        name = called.rpartition(".")[2]
        if name in (*_PURE_FUNCTIONS, *_LIST_FUNCTIONS) and arguments:
            plain: Callable[[LocatedValue], Any] = (
                self._to_plain if name in _PURE_FUNCTIONS else self._list_items
            )
            options = {key: self._to_plain(value) for key, value in keywords.items()}
            return self._apply_function(
                {**_PURE_FUNCTIONS, **_LIST_FUNCTIONS}[name], *map(plain, arguments), **options
            )
        if (
            name == "isinstance"
            and len(arguments) == 2
            and str(arguments[1].value) in _BUILTIN_TYPES
        ):
            return isinstance(self._to_plain(arguments[0]), _BUILTIN_TYPES[str(arguments[1].value)])
        if name in _COPY_FUNCTIONS and arguments:
            return self._copy_value(arguments[0].value, keywords)
        if called in _TABLE_CONSTRUCTORS and all(
            isinstance(argument.value, dict) for argument in arguments
        ):
            return {
                key: content
                for part in (*(argument.value for argument in arguments), keywords)
                for key, content in part.items()
            }
        if name in _LIST_CONSTRUCTORS and arguments:
            many = isinstance(arguments[0].value, list | dict)
            return [*self._list_items(arguments[0])] if many else arguments[0]
        if name == "field":
            return self._make_field_default(keywords)
        if not name[:1].isupper():
            raise NotConstantError
        more = {"args": LocatedValue(arguments, arguments[0].place)} if arguments else {}
        return InstanceValue(name, {**keywords, **more})

    def _make_field_default(self, keywords: dict[str, LocatedValue]) -> Any:
        """Return the default value of a dataclass field, from the keywords of ``field(...)``.

        Raises:
            NotConstantError: If there is no constant default value.
        """
        if "default_factory" not in keywords:
            return self._apply_function(operator.getitem, keywords, "default")
        factory = keywords["default_factory"].value
        if isinstance(factory, FunctionValue | ClassValue):
            return self.call(factory, [], {})
        return (
            _BUILTIN_TYPES[str(factory)]()
            if str(factory) in _BUILTIN_TYPES
            else InstanceValue(str(factory))
        )

    def _call_method(
        self,
        value: Any,
        name: str,
        arguments: list[LocatedValue],
        keywords: dict[str, LocatedValue],
    ) -> Any:
        """Call an allowed method of a table or a list."""
        own: list[Any] = list(arguments)
        if name in ("get", "pop", "setdefault", "insert"):
            own[:1] = map(self._to_plain, arguments[:1])
        elif name == "extend":
            own = [self._list_items(argument) for argument in arguments]
        elif name == "update":
            own = [argument.value for argument in arguments]
        if own and name in ("get", "pop", "setdefault") and self._is_open(value, own[0]):
            raise NotConstantError
        return self._apply_function(getattr(value, name), *own, **keywords)

    def _is_open(self, table: Any, key: Any) -> bool:
        """Return True if a table lacks a key but may contain further, unknown keys."""
        is_key = isinstance(key, str | int | float | bool)
        return is_key and id(table) in self.open_tables and key not in table

    def call(
        self,
        called: FunctionValue | ClassValue,
        arguments: list[LocatedValue],
        keywords: dict[str, LocatedValue],
    ) -> LocatedValue:
        """Evaluate the call of a function or class of an evaluated file.

        Raises:
            NotConstantError: If the function raises, or calls are nested too deep, for example.
        """
        if isinstance(called, ClassValue):
            return self._make_instance(called, arguments, keywords)
        if self.depth >= MAX_CALL_DEPTH:
            raise NotConstantError
        node, enclosing = called.node, called.enclosing_scope
        first = [argument.arg for argument in (*node.args.posonlyargs, *node.args.args)]
        names = [*first, *(argument.arg for argument in node.args.kwonlyargs)]
        scope = enclosing.new_child(
            {name: self._make_node(UnknownValue(name), node, enclosing) for name in names}
        )
        defaults = [*node.args.defaults, *node.args.kw_defaults]
        for name, default in zip(names[len(names) - len(defaults) :], defaults, strict=True):
            if default is not None:
                scope[name] = self.evaluate(default, enclosing)
        arguments = arguments if called.bound_object is None else [called.bound_object, *arguments]
        extra_keywords = {key: keywords[key] for key in keywords if key not in names}
        scope.update(zip(first, arguments, strict=False))
        scope.update({key: keywords[key] for key in keywords if key in names})
        for rest, content in (
            (node.args.vararg, arguments[len(first) :]),
            (node.args.kwarg, extra_keywords),
        ):
            if rest is not None:
                scope[rest.arg] = self._make_node(content, node, enclosing)
        self.depth += 1
        try:
            if isinstance(node, ast.Lambda):
                return self.evaluate(node.body, scope)
            self.run_statements(node.body, scope)
        except _ReturnSignal as done:
            return done.node
        except (_BreakSignal, _ContinueSignal, _RaiseSignal) as error:
            raise NotConstantError from error
        finally:
            self.depth -= 1
        return self._make_node(None, node, scope)

    def _make_instance(
        self,
        class_value: ClassValue,
        arguments: list[LocatedValue],
        keywords: dict[str, LocatedValue],
    ) -> LocatedValue:
        """Make an instance of a class with fresh copies of the default values.

        ``__init__`` is evaluated. On failure, all fields that ``__init__`` assigns are unknown.
        Without ``__init__``, the arguments are assigned to the annotated names, and
        ``__post_init__`` is evaluated, if possible.
        """
        result: InstanceValue = self._copy_value(
            InstanceValue(class_value.name, class_value.fields, class_value), {}
        )
        start = class_value.fields.get("__init__")
        if start is not None and isinstance(start.value, FunctionValue):
            node = LocatedValue(result, start.place)
            try:
                self.call(replace(start.value, bound_object=node), arguments, keywords)
            except NotConstantError:
                for part in ast.walk(start.value.node):
                    if isinstance(part, ast.Attribute) and isinstance(part.ctx, ast.Store):
                        lost = self._make_unknown(part, part, start.value.enclosing_scope)
                        result.fields[part.attr] = lost
            return node
        result.fields.update(
            zip(dict.fromkeys(class_value.annotated_names), arguments, strict=False), **keywords
        )
        own = LocatedValue(result, Place(Path()))
        after = class_value.fields.get("__post_init__")
        if after is not None and isinstance(after.value, FunctionValue):
            with suppress(NotConstantError):
                self.call(after.value, [own], {})
        return own

    def _copy_value(self, value: Any, keywords: dict[str, LocatedValue]) -> Any:
        """Return a deep copy of a value, with changed fields, as ``dataclasses.replace``.

        ``keywords`` is {field: new value}.
        """
        memo: dict[int, Any] = {}
        fresh = deepcopy(value, memo)
        self.steps += len(memo)
        getattr(fresh, "fields", {}).update(keywords)
        return fresh


def _list_parts(node: LocatedValue) -> list[LocatedValue]:
    """Return the items of a list, or the values of a table; of other values, an empty list."""
    content = node.value
    if isinstance(content, dict):
        return [*content.values()]
    return [*content] if isinstance(content, list) else []


def _list_identities(values: list[LocatedValue]) -> Iterator[int]:
    """Yield the Python ids of values, to recognise values that were seen before.

    A list without place is identified by its items.
    """
    for value in values:
        if value.place == Place(Path()) and isinstance(value.value, list):
            yield from _list_identities(value.value)
        else:
            yield id(value.value)


def _walk_block(statement: ast.AST) -> Iterator[ast.AST]:
    """Yield the statements in a block, without the bodies of functions and classes in the block."""
    for child in ast.iter_child_nodes(statement):
        if isinstance(child, ast.stmt):
            yield child
        if not isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef | ast.expr):
            yield from _walk_block(child)


def _list_defined_names(node: ast.AST) -> list[str]:
    """Return the names that a definition of a function or class, or an import, defines."""
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
        return [node.name]
    if isinstance(node, ast.Import | ast.ImportFrom):
        return [alias.asname or alias.name.split(".")[0] for alias in node.names]
    return []


def _list_search_folders(path: Path) -> Iterator[Path]:
    """Yield the folders above a file, in which imported modules are searched, nearest first.

    After the folder of the file, the last folder is the first folder that is neither a package nor
    below the top folder of the project (`_PROJECT_MARKERS`).
    """
    project = [
        folder
        for folder in path.parents
        if any((folder / mark).exists() for mark in _PROJECT_MARKERS)
    ]
    for folder in path.parents:
        yield folder
        within = project and folder != project[0] and folder.is_relative_to(project[0])
        if not within and folder != path.parent and not is_input(folder / "__init__.py"):
            return


def _is_number(value: Any) -> bool:
    """Return True for an int or float; False for a bool."""
    return isinstance(value, int | float) and not isinstance(value, bool)
