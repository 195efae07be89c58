"""What a Python file states, worked out from its syntax: nothing of it is imported or run.

Constants, names, lists, tables, dataclasses, classes of settings with their bases, arithmetic,
loops over what is known, and functions that take nothing that is not known; modules within the
folders that were given. All else is an ``UnknownValue`` with the text of the
expression, as is each variable that an unsupported statement would change.
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
from pupper_analysis.tools.contract.facts import MAX_VALUES, Node, count_decimals

MAX_INTEGER_BITS: Final = 1_000
"""Of a whole number: others grow without bound where they are multiplied in a loop."""

MAX_CALL_DEPTH: Final = 40
"""Calls within calls; Python's own limit is some 200 of ours."""


@dataclass(eq=False)
class NamedValue:
    """What is no plain value, and has a name: an instance's copy has the same ones."""

    name: str

    def __str__(self) -> str:
        return self.name

    def __deepcopy__(self, _: object) -> NamedValue:
        return self


class UnknownValue(NamedValue):
    """What is no constant: an expression, or a name that is imported from elsewhere."""


@dataclass(eq=False)
class FunctionValue(NamedValue):
    """A function, with the names that it knows besides its own; a method with whose it is."""

    node: ast.FunctionDef | ast.Lambda
    around: Scope
    own: Node | None = None


@dataclass(eq=False)
class ClassValue(NamedValue):
    """A class; ``fields`` are its own and its bases', ``ordered`` the names of its annotations."""

    bases: list[ClassValue]
    fields: dict[str, Node]
    ordered: list[str]


@dataclass(eq=False)
class InstanceValue:
    """What a call of a class makes.

    Attributes:
        kind: The class's name.
        fields: {name: value}.
        of: The class, if its module was read.
    """

    kind: str
    fields: dict[str, Node] = field(default_factory=dict)
    of: ClassValue | None = None

    def __str__(self) -> str:
        return f"{self.kind}(...)"


class ModuleNames(UserDict[str, Node]):
    """The names of a module, which fill as it is read."""

    def __init__(self, path: Path, lines: list[str]) -> None:
        super().__init__({"__name__": Node(path.stem, Place(path))})
        self.path, self.lines, self.fields = path, lines, self.data
        self.imported: set[str] = set()


Scope = ChainMap[str, Node]
"""The names that are known at a place, innermost first; the last are its module's."""


def get_module(scope: Scope) -> ModuleNames:
    """Returns the module that a place is in."""
    return cast(ModuleNames, scope.maps[-1])


class NotConstantError(Exception):
    """What an expression comes to is not known."""


class _Return(Exception):  # noqa: N818
    def __init__(self, node: Node) -> None:
        self.node = node


class _Leave(Exception):  # noqa: N818
    """Of a loop, or of a function that raises."""


class _Next(Exception):  # noqa: N818
    """Round of a loop."""


_OPERATORS: Final[Mapping[type, Callable[[Any, Any], Any]]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.FloorDiv: operator.floordiv,
    ast.Mod: operator.mod,
    # As floats where whole numbers could grow without bound.
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
_PURE: Final[Mapping[str, Callable[..., Any]]] = {
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
"""Functions of plain values."""
_ROWS: Final[Mapping[str, Callable[..., Any]]] = {"zip": zip, "enumerate": enumerate}
"""Functions of lists, whatever these hold."""
_METHODS: Final[Mapping[type, Sequence[str]]] = {
    dict: ("get", "pop", "setdefault", "update", "keys", "values", "items", "copy", "clear"),
    list: ("append", "extend", "insert", "pop", "reverse", "copy", "clear"),
}
_CONSTANTS: Final = {"pi": math.pi, "inf": math.inf, "tau": math.tau}
_NUMERIC_MODULES: Final = ("math", "np", "numpy", "torch", "jp", "jnp")
_LISTS: Final = ("array", "asarray", "tensor", "list", "tuple", "tolist")
"""Calls that give back the values that they are given, in another list."""
_TABLES: Final = ("dict", "freeze", "config_dict.create", "ConfigDict")
"""Calls that give back the tables that they are given, and what they are given by name."""
_COPIES: Final = ("copy", "deepcopy", "replace")
_TYPES: Final = {"dict": dict, "list": list, "tuple": list, "str": str, "float": float, "int": int}
_PROJECT: Final = ("setup.py", "pyproject.toml", ".git")


class Evaluator:
    """Works out modules.

    Args:
        folders: Where modules are looked for, besides beside the file that imports them.
    """

    def __init__(self, folders: tuple[Path, ...] = ()) -> None:
        self.folders = folders
        self.modules: dict[Path, ModuleNames] = {}
        self.shown = Path()
        self.steps, self.depth = 0, 0

    def module(self, path: Path) -> ModuleNames:
        """Returns a module; one that is being read is as far as it is: imports may go in circles.

        Raises:
            InputError: If it cannot be read.
            ModelError: If it does not parse; the error has the line.
        """
        if not path.is_absolute():  # what is asked for so is shown so, and what it imports
            self.shown = Path.cwd()
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
        made = self.modules[path] = ModuleNames(path, re.split("\r\n?|\n", text))
        with suppress(_Leave, _Next, _Return):
            self.run(tree.body, Scope(made))
        return made

    # Statements.

    def run(self, body: list[ast.stmt], scope: Scope) -> None:
        """Works out statements, one after the other; what one changes that is not known is lost."""
        for one in body:
            self._count(one, scope)
            try:
                getattr(self, f"_do_{type(one).__name__.lower()}", self._lose)(one, scope)
            except NotConstantError:
                self._forget(one, scope)

    def _count(self, node: ast.AST, scope: Scope) -> None:
        self.steps += 1
        if self.steps > MAX_VALUES:
            place = self._place(node, scope)
            raise make_file_error(place, diagnose("contract-too-much", most=MAX_VALUES))

    def _lose(self, *_: object) -> None:
        raise NotConstantError

    def _do_assign(self, one: ast.Assign | ast.AnnAssign, scope: Scope) -> None:
        if one.value is not None:
            value = self.value(one.value, scope)
            for target in one.targets if isinstance(one, ast.Assign) else [one.target]:
                self._put(target, value, scope)

    _do_annassign = _do_assign

    def _do_augassign(self, one: ast.AugAssign, scope: Scope) -> None:
        read = ast.copy_location(ast.BinOp(one.target, one.op, one.value), one)
        self._put(one.target, self.value(read, scope), scope)

    def _do_expr(self, one: ast.Expr, scope: Scope) -> None:
        self.value(one.value, scope)

    def _do_return(self, one: ast.Return, scope: Scope) -> None:
        raise _Return(self.value(one.value or ast.copy_location(ast.Constant(None), one), scope))

    def _do_raise(self, *_: object) -> None:
        raise _Leave

    _do_break = _do_raise

    def _do_continue(self, *_: object) -> None:
        raise _Next

    def _do_if(self, one: ast.If, scope: Scope) -> None:
        self.run(one.body if self._truth(self.value(one.test, scope)) else one.orelse, scope)

    def _do_for(self, one: ast.For, scope: Scope) -> None:
        with suppress(_Leave):
            for each in self._listed(self.value(one.iter, scope)):
                self._put(one.target, each, scope)
                with suppress(_Next):
                    self.run(one.body, scope)

    def _do_try(self, one: ast.Try | ast.With, scope: Scope) -> None:
        self.run([*one.body, *getattr(one, "orelse", ()), *getattr(one, "finalbody", ())], scope)

    _do_with = _do_try

    def _do_functiondef(self, one: ast.FunctionDef, scope: Scope) -> None:
        # What a method names is not its class's.
        of = scope.get("__class__")
        method = of is not None and scope.maps[0] is of.value.fields
        around = scope.parents if method else scope
        scope[one.name] = self._node(FunctionValue(one.name, one, around), one, scope)

    def _do_classdef(self, one: ast.ClassDef, scope: Scope) -> None:
        bases = [self.value(base, scope).value for base in one.bases]
        known = [base for base in bases if isinstance(base, ClassValue)]
        theirs = dict(ChainMap(*(base.fields for base in known)))
        made = ClassValue(
            one.name, known, theirs, [name for base in known for name in base.ordered]
        )
        node = self._node(made, one, scope)
        self.run(one.body, scope.new_child({"__class__": node}).new_child(made.fields))
        for each in one.body:
            if isinstance(each, ast.AnnAssign) and isinstance(each.target, ast.Name):
                made.ordered.append(each.target.id)
        scope[one.name] = node

    def _do_import(self, one: ast.Import, scope: Scope) -> None:
        for name in one.names:
            shown = name.asname or name.name.split(".")[0]
            found = self._find(scope, name.name if name.asname else shown, 0)
            self._import({shown: self._node(found or UnknownValue(shown), one, scope)}, scope)

    def _do_importfrom(self, one: ast.ImportFrom, scope: Scope) -> None:
        home: Mapping[str, Node] = self._find(scope, one.module or "", one.level) or {}
        for name in one.names:
            if name.name == "*":
                self._import(home, scope)
                continue
            below = (
                None
                if name.name in home
                else self._find(scope, f"{one.module or ''}.{name.name}", one.level)
            )
            lost = self._node(below or UnknownValue(name.name), one, scope)
            self._import({name.asname or name.name: home.get(name.name, lost)}, scope)

    def _import(self, names: Mapping[str, Node], scope: Scope) -> None:
        scope.update(names)
        get_module(scope).imported.update(names)

    def _find(self, scope: Scope, dotted: str, level: int) -> ModuleNames | None:
        """Returns an imported module, if it lies in a folder that may be read."""
        path = get_module(scope).path
        parts = [part for part in dotted.split(".") if part]
        tops = path.parents[level - 1 : level] if level else (*_tops(path), *self.folders)
        for top in tops:
            base = top.joinpath(*parts)
            for file in (base.with_suffix(".py") if parts else base, base / "__init__.py"):
                if is_input(file):
                    return self.module(file)
        return None

    def _forget(self, one: ast.stmt, scope: Scope) -> None:
        """What may be changed by what may not happen is not known."""
        within = (each for each in ast.walk(one) if isinstance(each, ast.stmt))
        for said, node in ((each, node) for each in within for node in ast.walk(each)):
            stored = isinstance(node, ast.Name | ast.Attribute | ast.Subscript)
            if stored and isinstance(node.ctx, ast.Store | ast.Del):  # type: ignore[attr-defined]
                shown = ast.unparse(said).partition("\n")[0][:80]
                lost = self._node(UnknownValue(shown), node, scope)
                with suppress(NotConstantError):
                    self._put(cast(ast.expr, node), lost, scope)

    def _put(self, to: ast.expr, value: Node, scope: Scope) -> None:
        match to:
            case ast.Name():
                scope[to.id] = value
            case ast.Tuple() | ast.List():
                for each, part in self._apply(zip, to.elts, self._listed(value), strict=True):
                    self._put(each, part, scope)
            case ast.Attribute():
                self._owner(to.value, scope)[to.attr] = value
            case ast.Subscript():
                held = self.value(to.value, scope).value
                if isinstance(held, list | dict):
                    self._apply(operator.setitem, held, self._key(to.slice, scope), value)
            case _:
                raise NotConstantError

    def _owner(self, node: ast.expr, scope: Scope) -> dict[str, Node]:
        """Returns the fields that an assignment to an attribute goes to."""
        held = self.value(node, scope).value
        made = held if isinstance(held, InstanceValue | ClassValue) else InstanceValue("")
        if isinstance(node, ast.Attribute) and isinstance(held, UnknownValue):
            # A field of a base that was not read.
            self._owner(node.value, scope)[node.attr] = self._node(made, node, scope)
        return made.fields

    # Expressions.

    def value(self, one: ast.expr, scope: Scope) -> Node:
        """Returns what an expression is, at its own place."""
        self._count(one, scope)
        try:
            found = getattr(self, f"_of_{type(one).__name__.lower()}", self._lose)(one, scope)
        except NotConstantError:
            found = UnknownValue(ast.unparse(one)[:80])
        return self._node(found, one, scope)

    def _node(self, value: Any, one: ast.AST, scope: Scope) -> Node:
        """Returns a value at a place; what it holds is there too, if it has none of its own."""
        if isinstance(value, list | tuple):
            value = [
                part if isinstance(part, Node) else self._node(part, one, scope) for part in value
            ]
        known = value if isinstance(value, Node) else Node(value, Place(Path()))
        return replace(known, place=self._place(one, scope))

    def _place(self, one: ast.AST, scope: Scope) -> Place:
        path = get_module(scope).path
        near = self.shown != Path() and path.is_relative_to(self.shown)
        return Place(path.relative_to(self.shown) if near else path, getattr(one, "lineno", None))

    def _apply(self, work: Callable[..., Any], *given: Any, **named: Any) -> Any:
        """Returns what a function of Python's makes of known values."""
        try:
            made = work(*given, **named)
            if isinstance(made, Iterable) and not isinstance(made, str | dict):
                made = list(islice(made, MAX_VALUES + 1))
        except (ArithmeticError, ValueError, TypeError, LookupError) as error:
            raise NotConstantError from error
        sizes = [len(one) for one in (made, *given) if isinstance(one, str | list | dict)]
        self.steps += sum(sizes)
        large = isinstance(made, int) and made.bit_length() > MAX_INTEGER_BITS
        if large or isinstance(made, complex) or max(sizes, default=0) > MAX_VALUES:
            raise NotConstantError
        return made

    def _truth(self, node: Node) -> bool:
        if isinstance(node.value, NamedValue | ModuleNames):
            raise NotConstantError
        return bool(node.value)

    def _listed(self, node: Node) -> list[Node]:
        if isinstance(node.value, dict):
            return [Node(key, value.place) for key, value in node.value.items()]
        if not isinstance(node.value, list):
            raise NotConstantError
        return node.value

    def _plain(self, node: Node) -> Any:
        """Returns a value with none of its places."""
        self.steps += 1
        if isinstance(node.value, UnknownValue) or self.steps > MAX_VALUES:
            raise NotConstantError
        many = isinstance(node.value, list)
        return [self._plain(one) for one in node.value] if many else node.value

    def _several(self, every: list[ast.expr], scope: Scope) -> list[Node]:
        """Returns what some expressions are, of which a starred one is as many as it holds."""
        return [
            part
            for one in every
            for part in (
                self._listed(self.value(one.value, scope))
                if isinstance(one, ast.Starred)
                else [self.value(one, scope)]
            )
        ]

    def _key(self, one: ast.expr, scope: Scope) -> Any:
        """Returns a key of a table; of what is not known, what stands there."""
        value = self.value(one, scope).value
        if not isinstance(value, str | int | float | bool | UnknownValue):
            raise NotConstantError
        return str(value) if isinstance(value, UnknownValue) else value

    def _of_constant(self, one: ast.Constant, scope: Scope) -> Node:
        digits = None
        if isinstance(one.value, int | float) and not isinstance(one.value, bool):
            row = get_module(scope).lines[one.lineno - 1].encode()
            digits = count_decimals(
                row[one.col_offset : one.end_col_offset].decode(errors="replace")
            )
        return Node(one.value, self._place(one, scope), digits)

    def _of_name(self, one: ast.Name, scope: Scope) -> Any:
        return scope.get(one.id) or UnknownValue(one.id)

    def _of_attribute(self, one: ast.Attribute, scope: Scope) -> Any:
        if isinstance(one.value, ast.Call) and ast.unparse(one.value.func) == "super":
            owner, node = scope["__class__"], scope["self"]
            names: Any = ChainMap(*(base.fields for base in owner.value.bases))
        else:
            node = self.value(one.value, scope)
            names = node.table or (_CONSTANTS if str(node.value) in _NUMERIC_MODULES else {})
        found = self._apply(operator.getitem, names, one.attr)
        method = isinstance(found, Node) and isinstance(found.value, FunctionValue)
        if method and isinstance(node.value, InstanceValue | ClassValue):
            return replace(found.value, own=node)
        return found

    def _of_tuple(self, one: ast.Tuple, scope: Scope) -> list[Node]:
        return self._several(one.elts, scope)

    _of_list = _of_set = _of_tuple

    def _of_dict(self, one: ast.Dict, scope: Scope) -> dict[Any, Node]:
        found: dict[Any, Node] = {}
        for key, value in zip(one.keys, one.values, strict=True):
            held = self.value(value, scope)
            found |= held.table if key is None else {self._key(key, scope): held}
        return found

    def _of_subscript(self, one: ast.Subscript, scope: Scope) -> Any:
        held = self.value(one.value, scope).value
        if not isinstance(held, list | dict):
            raise NotConstantError
        if not isinstance(one.slice, ast.Slice):
            return self._apply(operator.getitem, held, self._key(one.slice, scope))
        ends = (one.slice.lower, one.slice.upper, one.slice.step)
        part = slice(*(end and self._plain(self.value(end, scope)) for end in ends))
        return self._apply(operator.getitem, held, part)

    def _of_binop(self, one: ast.BinOp, scope: Scope) -> Any:
        left, right = (self.value(each, scope).value for each in (one.left, one.right))
        added = isinstance(one.op, ast.Add) and type(left) is type(right)
        joined = added and isinstance(left, list | str)
        repeated = isinstance(one.op, ast.Mult) and isinstance(left, list) and _number(right)
        numbers = _number(left) and _number(right)
        if not (numbers or joined or (repeated and len(left) * right <= MAX_VALUES)):
            raise NotConstantError
        return self._apply(_OPERATORS.get(type(one.op), self._lose), left, right)

    def _of_unaryop(self, one: ast.UnaryOp, scope: Scope) -> Any:
        if isinstance(one.op, ast.Not):
            return not self._truth(self.value(one.operand, scope))
        held = self.value(one.operand, scope)
        if not _number(held.value) or isinstance(one.op, ast.Invert):
            raise NotConstantError
        sign = -1 if isinstance(one.op, ast.USub) else 1
        return Node(sign * held.value, held.place, held.decimals)

    def _of_boolop(self, one: ast.BoolOp, scope: Scope) -> Node:
        for each in one.values:
            held = self.value(each, scope)
            if self._truth(held) is isinstance(one.op, ast.Or):
                break
        return held

    def _of_compare(self, one: ast.Compare, scope: Scope) -> Any:
        if len(one.ops) > 1:
            raise NotConstantError
        both = (self._plain(self.value(each, scope)) for each in (one.left, *one.comparators))
        return self._apply(_OPERATORS[type(one.ops[0])], *both)

    def _of_ifexp(self, one: ast.IfExp, scope: Scope) -> Node:
        return self.value(
            one.body if self._truth(self.value(one.test, scope)) else one.orelse, scope
        )

    def _of_lambda(self, one: ast.Lambda, scope: Scope) -> FunctionValue:
        return FunctionValue("lambda", one, scope)

    def _of_listcomp(self, one: ast.ListComp, scope: Scope) -> list[Node]:
        return [self.value(one.elt, each) for each in self._rounds(one.generators, scope)]

    _of_generatorexp = _of_listcomp

    def _of_dictcomp(self, one: ast.DictComp, scope: Scope) -> dict[Any, Node]:
        return {
            self._key(one.key, each): self.value(one.value, each)
            for each in self._rounds(one.generators, scope)
        }

    def _rounds(self, loops: list[ast.comprehension], scope: Scope) -> Iterator[Scope]:
        """Yields the names of each round of loops within loops."""
        if not loops:
            yield scope
            return
        for each in self._listed(self.value(loops[0].iter, scope)):
            here = scope.new_child()
            self._put(loops[0].target, each, here)
            if all(self._truth(self.value(test, here)) for test in loops[0].ifs):
                yield from self._rounds(loops[1:], here)

    # Calls.

    def _of_call(self, one: ast.Call, scope: Scope) -> Any:
        given = self._several(one.args, scope)
        named: dict[str, Node] = {}
        for keyword in one.keywords:
            held = self.value(keyword.value, scope)
            if keyword.arg is not None:
                named[keyword.arg] = replace(held, place=self._place(keyword, scope))
            else:
                named.update({str(key): value for key, value in held.table.items()})
        called = self.value(one.func, scope).value
        if isinstance(called, FunctionValue | ClassValue):
            return self.call(called, given, named)
        if isinstance(one.func, ast.Attribute):
            held, name = self.value(one.func.value, scope), one.func.attr
            if name in _METHODS.get(type(held.value), ()):
                return self._method(held.value, name, given, named)
            if isinstance(held.value, list | InstanceValue) and name.islower():
                given.insert(0, held)
        return self._elsewhere(ast.unparse(one.func), given, named)

    def _elsewhere(self, called: str, given: list[Node], named: dict[str, Node]) -> Any:
        """Returns what a call of a library's comes to."""
        name = called.rpartition(".")[2]
        if name in (*_PURE, *_ROWS) and given:
            plain: Callable[[Node], Any] = self._plain if name in _PURE else self._listed
            said = {key: self._plain(value) for key, value in named.items()}
            return self._apply({**_PURE, **_ROWS}[name], *map(plain, given), **said)
        if name == "isinstance" and str(given[-1].value) in _TYPES:
            return isinstance(self._plain(given[0]), _TYPES[str(given[-1].value)])
        if name in _COPIES and given:
            return self._copied(given[0].value, named)
        if called in _TABLES and all(isinstance(one.value, dict) for one in given):
            return {
                key: held
                for part in (*(one.value for one in given), named)
                for key, held in part.items()
            }
        if name in _LISTS and given:
            many = isinstance(given[0].value, list | dict)
            return [*self._listed(given[0])] if many else given[0]
        if name == "field":
            return self._made(named)
        if not name[:1].isupper():
            raise NotConstantError
        more = {"args": Node(given, given[0].place)} if given else {}
        return InstanceValue(name, {**named, **more})

    def _made(self, named: dict[str, Node]) -> Any:
        """Returns what a dataclass's field is by default."""
        if "default_factory" not in named:
            return self._apply(operator.getitem, named, "default")
        factory = named["default_factory"].value
        if isinstance(factory, FunctionValue | ClassValue):
            return self.call(factory, [], {})
        return _TYPES[str(factory)]() if str(factory) in _TYPES else InstanceValue(str(factory))

    def _method(self, value: Any, name: str, given: list[Node], named: dict[str, Node]) -> Any:
        """Returns what a call of a table's or a list's method comes to."""
        own: list[Any] = list(given)
        if name in ("get", "pop", "setdefault", "insert"):
            own[:1] = map(self._plain, given[:1])
        elif name == "extend":
            own = [self._listed(one) for one in given]
        elif name == "update":
            own = [one.value for one in given]
        return self._apply(getattr(value, name), *own, **named)

    def call(
        self, called: FunctionValue | ClassValue, given: list[Node], named: dict[str, Node]
    ) -> Node:
        """Returns what a function returns, or an instance of a class."""
        if isinstance(called, ClassValue):
            return self._instance(called, given, named)
        if self.depth >= MAX_CALL_DEPTH:
            raise NotConstantError
        node, around = called.node, called.around
        first = [each.arg for each in (*node.args.posonlyargs, *node.args.args)]
        names = [*first, *(each.arg for each in node.args.kwonlyargs)]
        scope = around.new_child(
            {name: self._node(UnknownValue(name), node, around) for name in names}
        )
        defaults = [*node.args.defaults, *node.args.kw_defaults]
        for name, default in zip(names[len(names) - len(defaults) :], defaults, strict=True):
            if default is not None:
                scope[name] = self.value(default, around)
        given = given if called.own is None else [called.own, *given]
        others = {key: named[key] for key in named if key not in names}
        scope.update(zip(first, given, strict=False))
        scope.update({key: named[key] for key in named if key in names})
        for rest, held in ((node.args.vararg, given[len(first) :]), (node.args.kwarg, others)):
            if rest is not None:
                scope[rest.arg] = self._node(held, node, around)
        self.depth += 1
        try:
            if isinstance(node, ast.Lambda):
                return self.value(node.body, scope)
            self.run(node.body, scope)
        except _Return as done:
            return done.node
        except (_Leave, _Next) as error:
            raise NotConstantError from error
        finally:
            self.depth -= 1
        return self._node(None, node, scope)

    def _instance(self, of: ClassValue, given: list[Node], named: dict[str, Node]) -> Node:
        """Returns an instance of a class, its fields' defaults made anew."""
        made: InstanceValue = self._copied(InstanceValue(of.name, of.fields, of), {})
        made.fields.update(zip(dict.fromkeys(of.ordered), given, strict=False), **named)
        own = Node(made, Place(Path()))
        after = of.fields.get("__post_init__")
        if after is not None and isinstance(after.value, FunctionValue):
            with suppress(NotConstantError):
                self.call(after.value, [own], {})
        return own

    def _copied(self, value: Any, named: dict[str, Node]) -> Any:
        memo: dict[int, Any] = {}
        fresh = deepcopy(value, memo)
        self.steps += len(memo)
        getattr(fresh, "fields", {}).update(named)
        return fresh


def _tops(path: Path) -> Iterator[Path]:
    """Yields the folders above a file up to that of its project, or of its package."""
    project = [
        folder for folder in path.parents if any((folder / mark).exists() for mark in _PROJECT)
    ]
    for folder in path.parents:
        yield folder
        within = project and folder != project[0] and folder.is_relative_to(project[0])
        if not within and folder != path.parent and not is_input(folder / "__init__.py"):
            return


def _number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
