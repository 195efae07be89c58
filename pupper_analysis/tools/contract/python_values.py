"""What a Python file states, worked out from its syntax: nothing of it is imported or run.

Constants, names, lists, tables, dataclasses, classes of settings with their bases, arithmetic,
loops over what is known, and functions that take nothing that is not known; modules within the
folders that were given. All else is an ``Unknown``, with the expression as it stands.
"""

from __future__ import annotations

import ast
import math
import operator
from collections import ChainMap
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import InputError, ModelError
from pupper_analysis.base.inputs import is_input, read_text
from pupper_analysis.models.places import Place, source_name
from pupper_analysis.tools.contract.facts import MOST, Node
from pupper_analysis.tools.contract.marked import decimals_of

MOST_ROUNDS: Final = 10_000
"""Of a comprehension: each has its own names."""

MOST_STEPS: Final = 500_000
"""Expressions that are worked out: a module of a training library takes some 10,000."""

DEEPEST: Final = 40
"""Calls within calls; Python's own limit is some 200 of ours."""


@dataclass(eq=False)
class Unknown:
    """What is no constant.

    Attributes:
        text: The expression, or a name that is imported from elsewhere.
    """

    text: str

    def __str__(self) -> str:
        return self.text


@dataclass(eq=False)
class Instance:
    """What a call of a class makes.

    Attributes:
        kind: The class's name.
        fields: {name: value}.
        of: The class, if its module was read.
    """

    kind: str
    fields: dict[str, Node] = field(default_factory=dict)
    of: Class | None = None

    def __str__(self) -> str:
        return f"{self.kind}(...)"


@dataclass(eq=False)
class Function:
    """A function."""

    node: ast.FunctionDef | ast.Lambda
    around: Scope
    owner: Class | None = None

    def __str__(self) -> str:
        return getattr(self.node, "name", "lambda")


@dataclass(eq=False)
class Class:
    """A class; ``fields`` are its own and its bases', ``line`` the names of its annotations."""

    name: str
    bases: list[Class]
    fields: dict[str, Node]
    ordered: list[str]

    def __str__(self) -> str:
        return self.name


@dataclass(eq=False)
class Module:
    """A module; ``names`` fills as it is read."""

    path: Path
    lines: list[str]
    names: dict[str, Node] = field(default_factory=dict)
    imported: set[str] = field(default_factory=set)

    def __str__(self) -> str:
        return self.path.stem


class Scope(ChainMap[str, Node]):
    """The names that are known at a place, innermost first, and the module that it is in."""

    def __init__(self, module: Module, *maps: dict[str, Node]) -> None:
        super().__init__(*maps)
        self.module = module

    def inner(self, own: dict[str, Node] | None = None) -> Scope:
        """Returns the scope of a function or a class, whose own names hide those around it."""
        return Scope(self.module, {} if own is None else own, *self.maps)  # type: ignore[arg-type]


class _Return(Exception):  # noqa: N818 - it is no error
    def __init__(self, node: Node) -> None:
        self.node = node


class _Leave(Exception):  # noqa: N818
    """Of a loop, or of a function that raises."""


_BINARY: Final[Mapping[type, Callable[[Any, Any], Any]]] = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul,
    ast.Div: operator.truediv, ast.FloorDiv: operator.floordiv, ast.Mod: operator.mod,
    ast.Pow: operator.pow,
}  # fmt: skip
_COMPARE: Final[Mapping[type, Callable[[Any, Any], Any]]] = {
    ast.Eq: operator.eq, ast.NotEq: operator.ne, ast.Lt: operator.lt, ast.LtE: operator.le,
    ast.Gt: operator.gt, ast.GtE: operator.ge, ast.Is: operator.is_, ast.IsNot: operator.is_not,
    ast.In: lambda a, b: a in b, ast.NotIn: lambda a, b: a not in b,
}  # fmt: skip
_NUMERIC: Final[Mapping[str, Callable[..., Any]]] = {
    **{name: getattr(math, name) for name in ("sqrt", "sin", "cos", "tan", "radians", "degrees",
                                              "exp", "log", "atan2", "floor", "ceil")},
    "deg2rad": math.radians, "rad2deg": math.degrees, "float": float, "int": int, "abs": abs,
    "round": round, "min": min, "max": max, "square": lambda x: x * x,
}  # fmt: skip
_CONSTANTS: Final = {"pi": math.pi, "inf": math.inf, "tau": math.tau}
_NUMERIC_MODULES: Final = ("math", "np", "numpy", "torch", "jp", "jnp")
_AS_IT_IS: Final = ("array", "asarray", "tensor", "list", "tuple", "dict", "sorted", "freeze")
"""Calls that give back the values that they are given."""
_PROJECT: Final = ("setup.py", "pyproject.toml", ".git")
_COPIES: Final = ("copy", "deepcopy", "replace")


class Evaluator:
    """Works out modules.

    Args:
        folders: Where modules are looked for, besides beside the file that imports them.
    """

    def __init__(self, folders: tuple[Path, ...] = ()) -> None:
        self.folders = folders
        self.modules: dict[Path, Module] = {}
        self.shown = Path()
        self.steps, self.depth = 0, 0

    def module(self, path: Path) -> Module:
        """Returns a module; one that is being read is as far as it is: imports may go in circles.

        Raises:
            ModelError: If it cannot be read, or does not parse; the error has the line.
        """
        if not path.is_absolute():  # what is asked for so is shown so, and what it imports
            self.shown = Path.cwd()
            path = path.absolute()
        if path in self.modules:
            return self.modules[path]
        try:
            text = read_text(path)
            tree = ast.parse(text)
        except InputError as error:
            raise ModelError(source_name(path, error.line), error.cause) from error
        except SyntaxError as error:
            message = diagnose("contract-no-python", problem=error.msg)
            raise ModelError(source_name(path, error.lineno), message) from error
        except (RecursionError, MemoryError, ValueError) as error:
            raise ModelError(path, diagnose("contract-too-deep")) from error
        made = self.modules[path] = Module(path, text.splitlines())
        try:
            self.run(tree.body, Scope(made, made.names))
        except (_Leave, _Return):
            pass
        except RecursionError as error:
            raise ModelError(path, diagnose("contract-too-deep")) from error
        return made

    # Statements.

    def run(self, body: list[ast.stmt], scope: Scope) -> None:
        """Works out statements, one after the other."""
        for one in body:
            self._count(one, scope)
            do = getattr(self, f"_do_{type(one).__name__.lower()}", None)
            if do is not None:
                do(one, scope)

    def _count(self, node: ast.AST, scope: Scope) -> None:
        self.steps += 1
        if self.steps > MOST_STEPS:
            line = getattr(node, "lineno", None)
            message = diagnose("contract-too-much", most=MOST_STEPS)
            raise ModelError(source_name(scope.module.path, line), message)

    def _do_assign(self, one: ast.Assign, scope: Scope) -> None:
        value = self.value(one.value, scope)
        for target in one.targets:
            self._put(target, value, scope)

    def _do_annassign(self, one: ast.AnnAssign, scope: Scope) -> None:
        if one.value is not None:
            self._put(one.target, self.value(one.value, scope), scope)

    def _do_augassign(self, one: ast.AugAssign, scope: Scope) -> None:
        read = ast.copy_location(ast.BinOp(one.target, one.op, one.value), one)
        self._put(one.target, self.value(read, scope), scope)

    def _do_expr(self, one: ast.Expr, scope: Scope) -> None:
        self.value(one.value, scope)

    def _do_return(self, one: ast.Return, scope: Scope) -> None:
        made = self.value(one.value or ast.copy_location(ast.Constant(None), one), scope)
        raise _Return(made)

    def _do_raise(self, *_: object) -> None:
        raise _Leave

    _do_break = _do_raise

    def _do_if(self, one: ast.If, scope: Scope) -> None:
        test = self._truth(self.value(one.test, scope))
        if test is not None:
            self.run(one.body if test else one.orelse, scope)
        else:
            self._forget([*one.body, *one.orelse], scope)

    def _do_for(self, one: ast.For, scope: Scope) -> None:
        over = self._listed(self.value(one.iter, scope))
        if over is None:
            self._forget(one.body, scope)
            return
        try:
            for each in over:
                self._put(one.target, each, scope)
                self.run(one.body, scope)
        except _Leave:
            pass

    def _do_while(self, one: ast.While, scope: Scope) -> None:
        self._forget(one.body, scope)

    def _do_with(self, one: ast.With, scope: Scope) -> None:
        self.run(one.body, scope)

    def _do_try(self, one: ast.Try, scope: Scope) -> None:
        self.run([*one.body, *one.orelse], scope)

    def _do_functiondef(self, one: ast.FunctionDef, scope: Scope) -> None:
        scope[one.name] = self._node(Function(one, scope), one, scope)

    def _do_classdef(self, one: ast.ClassDef, scope: Scope) -> None:
        bases = [self.value(base, scope).value for base in one.bases]
        known = [base for base in bases if isinstance(base, Class)]
        ordered = [name for base in known for name in base.ordered]
        made = Class(one.name, known, {}, ordered)
        for base in reversed(known):
            made.fields.update(base.fields)
        # What the body names is first its own, then the module's.
        inside = scope.inner(made.fields)
        self.run(one.body, inside)
        for node in made.fields.values():
            if isinstance(node.value, Function) and node.value.around is inside:
                node.value.owner = made
                node.value.around = scope
        for each in one.body:
            if isinstance(each, ast.AnnAssign) and isinstance(each.target, ast.Name):
                made.ordered.append(each.target.id)
        scope[one.name] = self._node(made, one, scope)

    def _do_import(self, one: ast.Import, scope: Scope) -> None:
        for name in one.names:
            shown = name.asname or name.name.split(".")[0]
            found = self._find(scope.module, name.name if name.asname else shown, 0)
            scope[shown] = self._node(found or Unknown(shown), one, scope)
            scope.module.imported.add(shown)

    def _do_importfrom(self, one: ast.ImportFrom, scope: Scope) -> None:
        home = self._find(scope.module, one.module or "", one.level)
        for name in one.names:
            if name.name == "*":
                scope.update({} if home is None else home.names)
                scope.module.imported.update({} if home is None else home.names)
                continue
            shown = name.asname or name.name
            found = None if home is None else home.names.get(name.name)
            if found is None:
                path = ".".join(part for part in (one.module, name.name) if part)
                below = self._find(scope.module, path, one.level)
                found = self._node(below or Unknown(name.name), one, scope)
            scope[shown] = found
            scope.module.imported.add(shown)

    def _find(self, module: Module, dotted: str, level: int) -> Module | None:
        """Returns an imported module, if it lies in a folder that may be read."""
        parts = [part for part in dotted.split(".") if part]
        above = list(module.path.parents)
        tops = above[level - 1 : level] if level else [*self._tops(module.path), *self.folders]
        for top in tops:
            base = top.joinpath(*parts)
            for file in (base.with_suffix(".py"), base / "__init__.py"):
                if (parts or file.name == "__init__.py") and is_input(file):
                    return self.module(file)
        return None

    def _tops(self, path: Path) -> Iterator[Path]:
        """Yields the folders above a file up to that of its project, or of its package."""
        above = list(path.parents)
        top = [number for number, folder in enumerate(above)
               if any((folder / mark).exists() for mark in _PROJECT)]  # fmt: skip
        for number, folder in enumerate(above):
            yield folder
            within = top and number < top[0]
            if not within and not is_input(folder / "__init__.py") and number:
                return

    def _forget(self, body: list[ast.stmt], scope: Scope) -> None:
        """What may be changed by what may not happen is not known."""
        for one in body:
            for node in ast.walk(one):
                if not isinstance(node, ast.Name | ast.Attribute | ast.Subscript):
                    continue
                if isinstance(node.ctx, ast.Store):
                    said = Unknown(ast.unparse(one)[:80])
                    self._put(node, self._node(said, node, scope), scope)

    def _put(self, to: ast.expr, value: Node, scope: Scope) -> None:
        if isinstance(to, ast.Name):
            scope[to.id] = value
        elif isinstance(to, ast.Tuple | ast.List):
            parts = self._listed(value) or []
            for number, each in enumerate(to.elts):
                lost = self._node(Unknown(ast.unparse(each)), each, scope)
                self._put(each, parts[number] if number < len(parts) else lost, scope)
        elif isinstance(to, ast.Attribute):
            owner = self._owner(to.value, scope)
            if owner is not None:
                owner[to.attr] = value
        elif isinstance(to, ast.Subscript):
            held = self.value(to.value, scope).value
            key = self._plain(self.value(to.slice, scope))
            table = isinstance(held, dict) and isinstance(key, str | int | float | bool)
            listed = isinstance(held, list) and isinstance(key, int)
            if table or (listed and -len(held) <= key < len(held)):
                held[key] = value

    def _owner(self, node: ast.expr, scope: Scope) -> dict[str, Node] | None:
        """Returns the fields that an assignment to an attribute goes to."""
        held = self.value(node, scope).value
        if isinstance(held, Instance | Class):
            return held.fields
        if isinstance(node, ast.Attribute) and isinstance(held, Unknown):
            above = self._owner(node.value, scope)
            if above is not None:  # a field of a base that was not read
                made = Instance("")
                above[node.attr] = self._node(made, node, scope)
                return made.fields
        return None

    # Expressions.

    def value(self, one: ast.expr, scope: Scope) -> Node:
        """Returns what an expression is, at its own place."""
        self._count(one, scope)
        find = getattr(self, f"_of_{type(one).__name__.lower()}", None)
        found = None if find is None else find(one, scope)
        if found is None:
            found = Unknown(ast.unparse(one)[:80])
        if isinstance(found, Node):
            return Node(found.value, self._place(one, scope), found.decimals)
        return self._node(found, one, scope)

    def _node(self, value: Any, one: ast.AST, scope: Scope) -> Node:
        return Node(value, self._place(one, scope))

    def _place(self, one: ast.AST, scope: Scope) -> Place:
        path = scope.module.path
        near = self.shown != Path() and path.is_relative_to(self.shown)
        return Place(path.relative_to(self.shown) if near else path, getattr(one, "lineno", None))

    def _of_constant(self, one: ast.Constant, scope: Scope) -> Any:
        if isinstance(one.value, int | float) and not isinstance(one.value, bool):
            row = scope.module.lines[one.lineno - 1].encode()
            said = row[one.col_offset : one.end_col_offset].decode(errors="replace")
            try:
                digits = decimals_of(said.replace("_", ""))
            except ValueError:  # 0x1f
                digits = 0
            return Node(one.value, self._place(one, scope), digits)
        # Node, as None is what stands there, and not that it is not known.
        return self._node(one.value, one, scope)

    def _of_name(self, one: ast.Name, scope: Scope) -> Any:
        return scope.get(one.id) or scope.module.names.get(one.id) or Unknown(one.id)

    def _of_attribute(self, one: ast.Attribute, scope: Scope) -> Any:
        held = self.value(one.value, scope).value
        if isinstance(held, Instance | Class):
            return held.fields.get(one.attr)
        if isinstance(held, Module):
            return held.names.get(one.attr)
        if isinstance(held, Unknown) and held.text in _NUMERIC_MODULES and one.attr in _CONSTANTS:
            return _CONSTANTS[one.attr]
        return None

    def _of_tuple(self, one: ast.Tuple, scope: Scope) -> Any:
        found: list[Node] = []
        for each in one.elts:
            if isinstance(each, ast.Starred):
                more = self._listed(self.value(each.value, scope))
                if more is None:
                    return None
                found += more
            else:
                found.append(self.value(each, scope))
        return found

    _of_list = _of_set = _of_tuple

    def _of_dict(self, one: ast.Dict, scope: Scope) -> Any:
        found: dict[Any, Node] = {}
        for key, value in zip(one.keys, one.values, strict=True):
            held = self.value(value, scope)
            if key is None:
                if isinstance(held.value, dict):
                    found.update(held.value)
                continue
            name = self._plain(self.value(key, scope))
            if isinstance(name, str | int | float | bool):
                found[name] = held
        return found

    def _of_subscript(self, one: ast.Subscript, scope: Scope) -> Any:
        held = self.value(one.value, scope).value
        if isinstance(one.slice, ast.Slice):
            ends = [
                None if end is None else self._plain(self.value(end, scope))
                for end in (one.slice.lower, one.slice.upper, one.slice.step)
            ]
            plain = all(end is None or isinstance(end, int) for end in ends) and ends[2] != 0
            return held[slice(*ends)] if isinstance(held, list) and plain else None
        key = self._plain(self.value(one.slice, scope))
        if isinstance(held, dict) and isinstance(key, str | int | float | bool):
            return held.get(key)
        if isinstance(held, list) and isinstance(key, int) and -len(held) <= key < len(held):
            return held[key]
        return None

    def _of_binop(self, one: ast.BinOp, scope: Scope) -> Any:
        left, right = (self.value(each, scope).value for each in (one.left, one.right))
        work = _BINARY.get(type(one.op))
        joined = isinstance(one.op, ast.Add) and type(left) is type(right) and _sized(left)
        repeated = isinstance(one.op, ast.Mult) and isinstance(left, list) and _number(right)
        size = len(left) + len(right) if joined else len(left) * right if repeated else 0
        if size > MOST:
            return None
        if work is None or not (joined or repeated or (_number(left) and _number(right))):
            return None
        try:
            # As floats where whole numbers could grow without bound.
            made = work(float(left) if isinstance(one.op, ast.Pow) else left, right)
            return made if _number(made) or _sized(made) else None  # and no complex number
        except (ArithmeticError, ValueError, TypeError):
            return None

    def _of_unaryop(self, one: ast.UnaryOp, scope: Scope) -> Any:
        held = self.value(one.operand, scope)
        if isinstance(one.op, ast.Not):
            test = self._truth(held)
            return None if test is None else not test
        if not _number(held.value):
            return None
        sign = -1 if isinstance(one.op, ast.USub) else 1
        return Node(sign * held.value, held.place, held.decimals)

    def _of_boolop(self, one: ast.BoolOp, scope: Scope) -> Any:
        stops = isinstance(one.op, ast.Or)
        for each in one.values:
            held = self.value(each, scope)
            test = self._truth(held)
            if test is None:
                return None
            if test is stops:
                return held
        return held

    def _of_compare(self, one: ast.Compare, scope: Scope) -> Any:
        left = self._plain(self.value(one.left, scope))
        if len(one.ops) != 1:
            return None
        right = self._plain(self.value(one.comparators[0], scope))
        if isinstance(left, Unknown) or isinstance(right, Unknown):
            return None
        try:
            return bool(_COMPARE[type(one.ops[0])](left, right))
        except (TypeError, KeyError):
            return None

    def _of_ifexp(self, one: ast.IfExp, scope: Scope) -> Any:
        test = self._truth(self.value(one.test, scope))
        return None if test is None else self.value(one.body if test else one.orelse, scope)

    def _of_lambda(self, one: ast.Lambda, scope: Scope) -> Any:
        return Function(one, scope)

    def _of_listcomp(self, one: ast.ListComp, scope: Scope) -> Any:
        rounds = self._rounds(one.generators, scope)
        return None if rounds is None else [self.value(one.elt, each) for each in rounds]

    _of_generatorexp = _of_listcomp

    def _of_dictcomp(self, one: ast.DictComp, scope: Scope) -> Any:
        rounds = self._rounds(one.generators, scope)
        if rounds is None:
            return None
        found = {}
        for each in rounds:
            key = self._plain(self.value(one.key, each))
            if isinstance(key, str | int | float | bool):
                found[key] = self.value(one.value, each)
        return found

    def _rounds(self, loops: list[ast.comprehension], scope: Scope) -> list[Scope] | None:
        found = [scope]
        for loop in loops:
            inner: list[Scope] = []
            for around in found:
                over = self._listed(self.value(loop.iter, around))
                if over is None or len(over) * len(found) > MOST_ROUNDS:
                    return None
                for each in over:
                    here = around.inner()
                    self._put(loop.target, each, here)
                    tests = [self._truth(self.value(test, here)) for test in loop.ifs]
                    if None in tests:
                        return None
                    if all(tests):
                        inner.append(here)
            found = inner
        return found

    # Calls.

    def _of_call(self, one: ast.Call, scope: Scope) -> Any:
        given = [self.value(each, scope) for each in one.args
                 if not isinstance(each, ast.Starred)]  # fmt: skip
        named: dict[str, Node] = {}
        for keyword in one.keywords:
            held = self.value(keyword.value, scope)
            if keyword.arg is not None:
                named[keyword.arg] = Node(held.value, self._place(keyword, scope), held.decimals)
            elif isinstance(held.value, dict):
                named.update({str(key): value for key, value in held.value.items()})
        if isinstance(one.func, ast.Attribute):
            made = self._method(one.func, given, named, scope)
            if made is not None:
                return made
        called = self.value(one.func, scope).value
        if isinstance(called, Function):
            return self.call(called, given, named)
        if isinstance(called, Class):
            return self.make(called, given, named)
        return self._elsewhere(one, given, named)

    def _elsewhere(self, one: ast.Call, given: list[Node], named: dict[str, Node]) -> Any:
        """Returns what a call of a library's comes to."""
        name = ast.unparse(one.func).rpartition(".")[2]
        if name in _NUMERIC and given and all(_number(each.value) for each in given):
            try:
                return _NUMERIC[name](*(each.value for each in given))
            except (ArithmeticError, ValueError, TypeError):
                return None
        if name == "float" and given and str(given[0].value) in ("inf", "-inf"):
            return float(given[0].value)
        if name == "len" and given and isinstance(given[0].value, list | dict | str):
            return len(given[0].value)
        if name == "range" and given and all(isinstance(e.value, int) for e in given):
            numbers = range(*(each.value for each in given))
            return [Node(number, given[0].place) for number in numbers[:MOST]]
        if name in ("zip", "enumerate") and given:
            return self._zipped(name, given)
        if name in _COPIES and given:
            return self._copied(given[0].value, named)
        if name == "dict" and not given:
            return dict(named)
        if name in _AS_IT_IS and given:
            return given[0]
        if name[:1].isupper():
            return Instance(name, {**named, **({"args": Node(given, given[0].place)} if given
                                               else {})})  # fmt: skip
        if name == "field":
            return Instance("field", named)
        return None

    def _zipped(self, name: str, given: list[Node]) -> list[Node] | None:
        lists = [self._listed(each) for each in given]
        if name == "enumerate":
            numbers = range(len(lists[0] or []))
            lists.insert(0, [Node(number, given[0].place) for number in numbers])
        if any(each is None for each in lists):
            return None
        rows = zip(*(each or [] for each in lists), strict=False)
        return [Node(list(row), row[-1].place) for row in rows]

    def _method(
        self, func: ast.Attribute, given: list[Node], named: dict[str, Node], scope: Scope
    ) -> Any:
        """Returns what a call of a known value's method comes to; None if it is no such call."""
        if isinstance(func.value, ast.Call) and ast.unparse(func.value.func) == "super":
            owner, own = scope.get("__class__"), scope.get("self")
            for base in owner.value.bases if owner is not None else []:
                above = base.fields.get(func.attr)
                if above is not None and isinstance(above.value, Function) and own is not None:
                    return self.call(above.value, [own, *given], named)
            return Node(None, self._place(func, scope))
        held = self.value(func.value, scope)
        value, name = held.value, func.attr
        if isinstance(value, Instance | Class):
            method = value.fields.get(name)
            if method is not None and isinstance(method.value, Function):
                return self.call(method.value, [held, *given], named)
            return self._copied(value, named) if name in _COPIES else None
        if isinstance(value, dict):
            first = None if not given else given[0].value
            if name == "get":
                return value.get(first) or (given[1] if len(given) > 1 else None)
            if name == "update":
                value.update(first if isinstance(first, dict) else {})
                value.update(named)
            parts: dict[str, Callable[[], Any]] = {
                "copy": lambda: dict(value),
                "values": lambda: list(value.values()),
                "keys": lambda: [Node(key, node.place) for key, node in value.items()],
                "items": lambda: [
                    Node([Node(key, node.place), node], node.place) for key, node in value.items()
                ],
            }
            return parts[name]() if name in parts else None
        if isinstance(value, list) and given and len(value) < MOST:
            if name == "append":
                value.append(given[0])
            elif name == "extend":
                value.extend(self._listed(given[0]) or [])
        return list(value) if isinstance(value, list) and name in ("copy", "tolist") else None

    def call(self, function: Function, given: list[Node], named: dict[str, Node]) -> Node | None:
        """Returns what a function returns; None if that cannot be worked out."""
        arguments = function.node.args
        names = [each.arg for each in (*arguments.posonlyargs, *arguments.args)]
        if self.depth >= DEEPEST:
            return None
        scope = function.around.inner()
        defaults = arguments.defaults
        pairs = [*zip(names[len(names) - len(defaults) :], defaults, strict=True),
                 *((each.arg, default) for each, default
                   in zip(arguments.kwonlyargs, arguments.kw_defaults, strict=True)
                   if default is not None)]  # fmt: skip
        for name, default in pairs:
            scope[name] = self.value(default, function.around)
        scope.update(zip(names, given, strict=False))
        scope.update(named)
        for each in (*names, *(one.arg for one in arguments.kwonlyargs)):
            if each not in scope:
                scope[each] = self._node(Unknown(each), function.node, scope)
        if function.owner is not None:
            scope["__class__"] = self._node(function.owner, function.node, scope)
        self.depth += 1
        try:
            if isinstance(function.node, ast.Lambda):
                return self.value(function.node.body, scope)
            self.run(function.node.body, scope)
        except _Return as done:
            return done.node
        except _Leave:
            return None
        finally:
            self.depth -= 1
        return self._node(None, function.node, scope)

    def make(self, made: Class, given: list[Node], named: dict[str, Node]) -> Instance:
        """Returns an instance of a class, its fields' defaults made anew."""
        plain = {n: node for n, node in made.fields.items() if not isinstance(node.value, Function)}
        fields = {name: _default(self, copied(node)) for name, node in plain.items()}
        functions = {n: node for n, node in made.fields.items() if n not in plain}
        result = Instance(made.name, {**functions, **fields}, made)
        order = [name for name in dict.fromkeys(made.ordered) if name not in functions]
        result.fields.update(zip(order, given, strict=False))
        result.fields.update(named)
        after = made.fields.get("__post_init__")
        if after is not None and isinstance(after.value, Function):
            self.call(after.value, [Node(result, after.place)], {})
        return result

    def _copied(self, value: Any, named: dict[str, Node]) -> Any:
        fresh = copied(Node(value, Place(Path()))).value
        if isinstance(fresh, Instance):
            fresh.fields.update(named)
        return fresh

    def _truth(self, node: Node) -> bool | None:
        value = node.value
        if value is None or isinstance(value, bool | int | float | str | list | dict):
            return bool(value)
        return True if isinstance(value, Instance) else None

    def _listed(self, node: Node) -> list[Node] | None:
        if isinstance(node.value, dict):
            return [Node(key, value.place) for key, value in node.value.items()]
        return node.value if isinstance(node.value, list) else None

    def _plain(self, node: Node) -> Any:
        value = node.value
        return [self._plain(each) for each in value] if isinstance(value, list) else value


def copied(node: Node, seen: dict[int, Any] | None = None) -> Node:
    """Returns a value with what it holds copied, each once."""
    seen = {} if seen is None else seen
    value = node.value
    if id(value) in seen:
        return Node(seen[id(value)], node.place, node.decimals)
    made: Any = value
    if isinstance(value, list):
        made = seen[id(value)] = []
        made += [copied(each, seen) for each in value]
    elif isinstance(value, dict):
        made = seen[id(value)] = {}
        made.update({key: copied(each, seen) for key, each in value.items()})
    elif isinstance(value, Instance):
        made = seen[id(value)] = Instance(value.kind, {}, value.of)
        made.fields.update({key: copied(each, seen) for key, each in value.fields.items()})
    return Node(made, node.place, node.decimals)


def _default(evaluator: Evaluator, node: Node) -> Node:
    """Returns a dataclass's default: that of a ``field`` is what its factory makes."""
    held = node.value
    if not isinstance(held, Instance) or held.kind != "field":
        return node
    factory, default = held.fields.get("default_factory"), held.fields.get("default")
    if factory is None:
        return default or Node(Unknown("field()"), node.place)
    made = factory.value
    if isinstance(made, Class):
        return Node(evaluator.make(made, [], {}), node.place)
    if isinstance(made, Function):
        return evaluator.call(made, [], {}) or Node(Unknown(str(made)), node.place)
    plain = {"dict": dict, "list": list, "tuple": list}.get(str(made))
    return Node(plain() if plain else Instance(str(made)), node.place)


def _number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _sized(value: Any) -> bool:
    return isinstance(value, list | str)
