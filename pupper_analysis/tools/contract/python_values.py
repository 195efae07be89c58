"""What a Python file states, worked out from its syntax: nothing of it is imported or run.

Constants, names, lists, tables, dataclasses, classes of settings with their bases, arithmetic,
loops over what is known, and functions that take nothing that is not known; modules within the
folders that were given. All else is an ``Unknown``, with the expression as it stands; and what a
statement would change that depends on such is one, too.
"""

from __future__ import annotations

import ast
import math
import operator
import re
from collections import ChainMap, UserDict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path
from typing import Any, Final, cast

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.inputs import is_input, read_text
from pupper_analysis.models.places import Place, refuse_file
from pupper_analysis.tools.contract.facts import MOST, Node
from pupper_analysis.tools.contract.marked import decimals_of

MOST_BITS: Final = 1_000
"""Of a whole number: others grow without bound where they are multiplied in a loop."""

DEEPEST: Final = 40
"""Calls within calls; Python's own limit is some 200 of ours."""


@dataclass(eq=False)
class Unknown:
    """What is no constant.

    Attributes:
        name: The expression, or a name that is imported from elsewhere.
    """

    name: str

    def __str__(self) -> str:
        return self.name


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
    """A function, with the names that it knows besides its own; a method with whose it is."""

    node: ast.FunctionDef | ast.Lambda
    around: Scope
    own: Node | None = None

    def __str__(self) -> str:
        return getattr(self.node, "name", "lambda")


@dataclass(eq=False)
class Class:
    """A class; ``fields`` are its own and its bases', ``ordered`` the names of its annotations."""

    name: str
    bases: list[Class]
    fields: dict[str, Node]
    ordered: list[str]

    def __str__(self) -> str:
        return self.name


class Module(UserDict[str, Node]):
    """The names of a module, which fill as it is read."""

    def __init__(self, path: Path, lines: list[str]) -> None:
        super().__init__({"__name__": Node(path.stem, Place(path))})
        self.path, self.lines = path, lines
        self.imported: set[str] = set()


Scope = ChainMap[str, Node]
"""The names that are known at a place, innermost first; the last are its module's."""


def module_of(scope: Scope) -> Module:
    """Returns the module that a place is in."""
    return cast(Module, scope.maps[-1])


class Lost(Exception):  # noqa: N818 - none of these is an error
    """What an expression comes to is not known."""


class _Return(Exception):  # noqa: N818
    def __init__(self, node: Node) -> None:
        self.node = node


class _Leave(Exception):  # noqa: N818
    """Of a loop, or of a function that raises."""


class _Next(Exception):  # noqa: N818
    """Round of a loop."""


_OPERATORS: Final[Mapping[type, Callable[[Any, Any], Any]]] = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul,
    ast.Div: operator.truediv, ast.FloorDiv: operator.floordiv, ast.Mod: operator.mod,
    # As floats where whole numbers could grow without bound.
    ast.Pow: lambda a, b: float(a) ** b,
    ast.Eq: operator.eq, ast.NotEq: operator.ne, ast.Lt: operator.lt, ast.LtE: operator.le,
    ast.Gt: operator.gt, ast.GtE: operator.ge, ast.Is: operator.is_, ast.IsNot: operator.is_not,
    ast.In: lambda a, b: a in b, ast.NotIn: lambda a, b: a not in b,
}  # fmt: skip
_PURE: Final[Mapping[str, Callable[..., Any]]] = {
    **{name: getattr(math, name) for name in ("sqrt", "sin", "cos", "tan", "radians", "degrees",
                                              "exp", "log", "atan2", "floor", "ceil")},
    "deg2rad": math.radians, "rad2deg": math.degrees, "float": float, "int": int, "abs": abs,
    "round": round, "min": min, "max": max, "square": lambda x: x * x, "len": len, "range": range,
}  # fmt: skip
"""Functions of plain values."""
_ROWS: Final[Mapping[str, Callable[..., Any]]] = {"zip": zip, "enumerate": enumerate}
"""Functions of lists, whatever these hold."""
_METHODS: Final[Mapping[type, Sequence[str]]] = {
    dict: ("get", "pop", "setdefault", "update", "keys", "values", "items", "copy", "clear"),
    list: ("append", "extend", "insert", "pop", "reverse", "copy", "clear"),
}
_CONSTANTS: Final = {"pi": math.pi, "inf": math.inf, "tau": math.tau}
_NUMERIC_MODULES: Final = ("math", "np", "numpy", "torch", "jp", "jnp")
_AS_IT_IS: Final = ("array", "asarray", "tensor", "list", "tuple", "dict", "sorted", "freeze",
                    "tolist")  # fmt: skip
"""Calls that give back the values that they are given."""
_TABLES: Final = ("dict", "config_dict.create", "ConfigDict")
"""Calls that give back what they are given by name."""
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
        self.modules: dict[Path, Module] = {}
        self.shown = Path()
        self.steps, self.depth = 0, 0

    def module(self, path: Path) -> Module:
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
            raise refuse_file(Place(path, error.lineno), message) from error
        except (MemoryError, ValueError) as error:
            raise refuse_file(Place(path), diagnose("contract-too-deep")) from error
        made = self.modules[path] = Module(path, re.split("\r\n?|\n", text))
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
            except Lost:
                self._forget(one, scope)

    def _count(self, node: ast.AST, scope: Scope) -> None:
        self.steps += 1
        if self.steps > MOST:
            place = self._place(node, scope)
            raise refuse_file(place, diagnose("contract-too-much", most=MOST))

    def _lose(self, *_: object) -> None:
        raise Lost

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
        raise _Return(self.value(one.value or ast.copy_location(ast.Constant(None), one), scope))

    def _do_raise(self, *_: object) -> None:
        raise _Leave

    _do_break = _do_raise

    def _do_continue(self, *_: object) -> None:
        raise _Next

    def _do_if(self, one: ast.If, scope: Scope) -> None:
        self.run(one.body if self._truth(one.test, scope) else one.orelse, scope)

    def _do_for(self, one: ast.For, scope: Scope) -> None:
        with suppress(_Leave):
            for each in self._listed(self.value(one.iter, scope)):
                self._put(one.target, each, scope)
                with suppress(_Next):
                    self.run(one.body, scope)

    def _do_with(self, one: ast.With, scope: Scope) -> None:
        self.run(one.body, scope)

    def _do_try(self, one: ast.Try, scope: Scope) -> None:
        self.run([*one.body, *one.orelse], scope)

    def _do_functiondef(self, one: ast.FunctionDef, scope: Scope) -> None:
        # What a method names is not its class's.
        of = scope.get("__class__")
        method = of is not None and scope.maps[0] is of.value.fields
        around = scope.parents if method else scope
        scope[one.name] = self._node(Function(one, around), one, scope)

    def _do_classdef(self, one: ast.ClassDef, scope: Scope) -> None:
        bases = [self.value(base, scope).value for base in one.bases]
        known = [base for base in bases if isinstance(base, Class)]
        made = Class(one.name, known, {}, [name for base in known for name in base.ordered])
        for base in reversed(known):
            made.fields.update(base.fields)
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
            self._import({shown: self._node(found or Unknown(shown), one, scope)}, scope)

    def _do_importfrom(self, one: ast.ImportFrom, scope: Scope) -> None:
        home: Mapping[str, Node] = self._find(scope, one.module or "", one.level) or {}
        for name in one.names:
            found = home.get(name.name)
            if found is None:
                dotted = f"{one.module}.{name.name}" if one.module else name.name
                below = None if name.name == "*" else self._find(scope, dotted, one.level)
                found = self._node(below or Unknown(name.name), one, scope)
            known = {name.asname or name.name: found}
            self._import(home if name.name == "*" else known, scope)

    def _import(self, names: Mapping[str, Node], scope: Scope) -> None:
        scope.update(names)
        module_of(scope).imported.update(names)

    def _find(self, scope: Scope, dotted: str, level: int) -> Module | None:
        """Returns an imported module, if it lies in a folder that may be read."""
        path = module_of(scope).path
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
                lost = self._node(Unknown(shown), node, scope)
                with suppress(Lost):
                    self._put(cast(ast.expr, node), lost, scope)

    def _put(self, to: ast.expr, value: Node, scope: Scope) -> None:
        match to:
            case ast.Name():
                scope[to.id] = value
            case ast.Tuple() | ast.List():
                parts = self._listed(value)
                for number, each in enumerate(to.elts):
                    self._put(each, self._apply(operator.getitem, parts, number), scope)
            case ast.Attribute():
                self._owner(to.value, scope)[to.attr] = value
            case ast.Subscript():
                held = self.value(to.value, scope).value
                if isinstance(held, list | dict):
                    self._apply(operator.setitem, held, self._key(to.slice, scope), value)

    def _owner(self, node: ast.expr, scope: Scope) -> dict[str, Node]:
        """Returns the fields that an assignment to an attribute goes to."""
        held = self.value(node, scope).value
        if isinstance(held, Instance | Class):
            return held.fields
        made = Instance("")
        if isinstance(node, ast.Attribute) and isinstance(held, Unknown):
            # A field of a base that was not read.
            self._owner(node.value, scope)[node.attr] = self._node(made, node, scope)
        return made.fields

    # Expressions.

    def value(self, one: ast.expr, scope: Scope) -> Node:
        """Returns what an expression is, at its own place."""
        self._count(one, scope)
        try:
            found = getattr(self, f"_of_{type(one).__name__.lower()}", self._lose)(one, scope)
        except Lost:
            found = Unknown(ast.unparse(one)[:80])
        if isinstance(found, Node):
            return Node(found.value, self._place(one, scope), found.decimals)
        return self._noded(found, one, scope)

    def _node(self, value: Any, one: ast.AST, scope: Scope) -> Node:
        return Node(value, self._place(one, scope))

    def _noded(self, value: Any, one: ast.AST, scope: Scope) -> Node:
        """Returns a value, and what it holds, at the place of what made it."""
        if isinstance(value, Node):
            return value
        if isinstance(value, list | tuple):
            value = [self._noded(each, one, scope) for each in value]
        return self._node(value, one, scope)

    def _place(self, one: ast.AST, scope: Scope) -> Place:
        path = module_of(scope).path
        near = self.shown != Path() and path.is_relative_to(self.shown)
        return Place(path.relative_to(self.shown) if near else path, getattr(one, "lineno", None))

    def _apply(self, work: Callable[..., Any], *given: Any, **named: Any) -> Any:
        """Returns what a function of Python's makes of known values."""
        try:
            made = work(*given, **named)
            if isinstance(made, Iterable) and not isinstance(made, str | dict):
                made = list(islice(made, MOST + 1))
        except (ArithmeticError, ValueError, TypeError, LookupError) as error:
            raise Lost from error
        sizes = [len(one) for one in (made, *given) if isinstance(one, str | list | dict)]
        self.steps += sum(sizes)
        large = isinstance(made, int) and made.bit_length() > MOST_BITS
        if large or isinstance(made, complex) or max(sizes, default=0) > MOST:
            raise Lost
        return made

    def _truth(self, one: ast.expr | Node, scope: Scope) -> bool:
        value = self.value(one, scope).value if isinstance(one, ast.expr) else one.value
        if not isinstance(value, bool | int | float | str | list | dict | Instance | None):
            raise Lost
        return bool(value)

    def _listed(self, node: Node) -> list[Node]:
        if isinstance(node.value, dict):
            return [Node(key, value.place) for key, value in node.value.items()]
        if not isinstance(node.value, list):
            raise Lost
        return node.value

    def _plain(self, node: Node) -> Any:
        """Returns a value with none of its places."""
        self.steps += 1
        if isinstance(node.value, Unknown) or self.steps > MOST:
            raise Lost
        many = isinstance(node.value, list)
        return [self._plain(one) for one in node.value] if many else node.value

    def _key(self, one: ast.expr, scope: Scope) -> Any:
        """Returns a key of a table; of what is not known, what stands there."""
        value = self.value(one, scope).value
        if not isinstance(value, str | int | float | bool | Unknown):
            raise Lost
        return str(value) if isinstance(value, Unknown) else value

    def _of_constant(self, one: ast.Constant, scope: Scope) -> Node:
        digits = None
        if isinstance(one.value, int | float) and not isinstance(one.value, bool):
            row = module_of(scope).lines[one.lineno - 1].encode()
            digits = decimals_of(row[one.col_offset : one.end_col_offset].decode(errors="replace"))
        return Node(one.value, self._place(one, scope), digits)

    def _of_name(self, one: ast.Name, scope: Scope) -> Any:
        return scope.get(one.id) or Unknown(one.id)

    def _of_attribute(self, one: ast.Attribute, scope: Scope) -> Any:
        if isinstance(one.value, ast.Call) and ast.unparse(one.value.func) == "super":
            owner, node = scope["__class__"], scope["self"]
            names: Any = ChainMap(*(base.fields for base in owner.value.bases))
        else:
            node = self.value(one.value, scope)
            held = node.value
            numeric = isinstance(held, Unknown) and held.name in _NUMERIC_MODULES
            other = held if isinstance(held, Module) else _CONSTANTS if numeric else {}
            names = getattr(held, "fields", other)
        found = self._apply(operator.getitem, names, one.attr)
        method = isinstance(found, Node) and isinstance(found.value, Function)
        if method and isinstance(node.value, Instance | Class):
            return replace(found.value, own=node)
        return found

    def _of_tuple(self, one: ast.Tuple, scope: Scope) -> list[Node]:
        found: list[Node] = []
        for each in one.elts:
            starred = isinstance(each, ast.Starred)
            value = self.value(each.value if starred else each, scope)  # type: ignore[attr-defined]
            found += self._listed(value) if starred else [value]
        return found

    _of_list = _of_set = _of_tuple

    def _of_dict(self, one: ast.Dict, scope: Scope) -> dict[Any, Node]:
        found: dict[Any, Node] = {}
        for key, value in zip(one.keys, one.values, strict=True):
            held = self.value(value, scope)
            if key is not None:
                found[self._key(key, scope)] = held
            elif isinstance(held.value, dict):
                found.update(held.value)
        return found

    def _of_subscript(self, one: ast.Subscript, scope: Scope) -> Any:
        held = self.value(one.value, scope).value
        if not isinstance(held, list | dict):
            raise Lost
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
        if not (numbers or joined or (repeated and len(left) * right <= MOST)):
            raise Lost
        return self._apply(_OPERATORS.get(type(one.op), self._lose), left, right)

    def _of_unaryop(self, one: ast.UnaryOp, scope: Scope) -> Any:
        if isinstance(one.op, ast.Not):
            return not self._truth(one.operand, scope)
        held = self.value(one.operand, scope)
        if not _number(held.value) or isinstance(one.op, ast.Invert):
            raise Lost
        sign = -1 if isinstance(one.op, ast.USub) else 1
        return Node(sign * held.value, held.place, held.decimals)

    def _of_boolop(self, one: ast.BoolOp, scope: Scope) -> Node:
        for each in one.values:
            held = self.value(each, scope)
            if self._truth(held, scope) is isinstance(one.op, ast.Or):
                break
        return held

    def _of_compare(self, one: ast.Compare, scope: Scope) -> Any:
        if len(one.ops) > 1:
            raise Lost
        both = (self._plain(self.value(each, scope)) for each in (one.left, *one.comparators))
        return self._apply(_OPERATORS[type(one.ops[0])], *both)

    def _of_ifexp(self, one: ast.IfExp, scope: Scope) -> Node:
        return self.value(one.body if self._truth(one.test, scope) else one.orelse, scope)

    def _of_lambda(self, one: ast.Lambda, scope: Scope) -> Function:
        return Function(one, scope)

    def _of_listcomp(self, one: ast.ListComp, scope: Scope) -> list[Node]:
        return [self.value(one.elt, each) for each in self._rounds(one.generators, scope)]

    _of_generatorexp = _of_listcomp

    def _of_dictcomp(self, one: ast.DictComp, scope: Scope) -> dict[Any, Node]:
        return {self._key(one.key, each): self.value(one.value, each)
                for each in self._rounds(one.generators, scope)}  # fmt: skip

    def _rounds(self, loops: list[ast.comprehension], scope: Scope) -> Iterator[Scope]:
        """Yields the names of each round of loops within loops."""
        if not loops:
            yield scope
            return
        for each in self._listed(self.value(loops[0].iter, scope)):
            here = scope.new_child()
            self._put(loops[0].target, each, here)
            if all(self._truth(test, here) for test in loops[0].ifs):
                yield from self._rounds(loops[1:], here)

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
        called = self.value(one.func, scope).value
        if isinstance(called, Function):
            return self.call(called, given, named)
        if isinstance(called, Class):
            return self.make(called, given, named)
        if isinstance(one.func, ast.Attribute):
            held, name = self.value(one.func.value, scope), one.func.attr
            if name in _METHODS.get(type(held.value), ()):
                return self._method(held.value, name, given, named)
            if isinstance(held.value, list | Instance) and name.islower():
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
        if called in _TABLES and not given:
            return dict(named)
        if name in _AS_IT_IS and given:
            return given[0]
        if name == "field":
            return self._made(named)
        if not name[:1].isupper():
            raise Lost
        more = {"args": Node(given, given[0].place)} if given else {}
        return Instance(name, {**named, **more})

    def _made(self, named: dict[str, Node]) -> Any:
        """Returns what a dataclass's field is by default."""
        factory = named.get("default_factory")
        if factory is None:
            return self._apply(operator.getitem, named, "default")
        if isinstance(factory.value, Class):
            return self.make(factory.value, [], {})
        if isinstance(factory.value, Function):
            return self.call(factory.value, [], {})
        name = str(factory.value)
        return _TYPES[name]() if name in _TYPES else Instance(name)

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

    def call(self, function: Function, given: list[Node], named: dict[str, Node]) -> Node:
        """Returns what a function returns."""
        arguments, around = function.node.args, function.around
        given = given if function.own is None else [function.own, *given]
        first = [*arguments.posonlyargs, *arguments.args]
        names = [each.arg for each in (*first, *arguments.kwonlyargs)]
        if self.depth >= DEEPEST:
            raise Lost
        scope = around.new_child({each: self._node(Unknown(each), function.node, around)
                                  for each in names})  # fmt: skip
        defaults = [*arguments.defaults, *arguments.kw_defaults]
        for name, default in zip(names[len(names) - len(defaults) :], defaults, strict=True):
            if default is not None:
                scope[name] = self.value(default, around)
        scope.update(zip(names[: len(first)], given, strict=False))
        scope.update(named)
        self.depth += 1
        try:
            if isinstance(function.node, ast.Lambda):
                return self.value(function.node.body, scope)
            self.run(function.node.body, scope)
        except _Return as done:
            return done.node
        except (_Leave, _Next) as error:
            raise Lost from error
        finally:
            self.depth -= 1
        return self._node(None, function.node, scope)

    def make(self, made: Class, given: list[Node], named: dict[str, Node]) -> Instance:
        """Returns an instance of a class, its fields' defaults made anew."""
        result: Instance = self._copied(Instance(made.name, made.fields, made), {})
        order = [name for name in dict.fromkeys(made.ordered)
                 if name not in made.fields
                 or not isinstance(made.fields[name].value, Function)]  # fmt: skip
        result.fields.update(zip(order, given, strict=False))
        result.fields.update(named)
        after = made.fields.get("__post_init__")
        if after is not None and isinstance(after.value, Function):
            with suppress(Lost):
                self.call(after.value, [Node(result, after.place)], {})
        return result

    def _copied(self, value: Any, named: dict[str, Node]) -> Any:
        seen: dict[int, Any] = {}
        fresh = copied(Node(value, Place(Path())), seen).value
        self.steps += sum(len(getattr(one, "fields", one)) for one in seen.values())
        if isinstance(fresh, Instance):
            fresh.fields.update(named)
        return fresh


def copied(node: Node, seen: dict[int, Any]) -> Node:
    """Returns a value with what it holds copied, each once."""
    value = node.value
    if id(value) not in seen and isinstance(value, list | dict | Instance):
        made: Any = (
            Instance(value.kind, {}, value.of) if isinstance(value, Instance) else type(value)()
        )
        seen[id(value)] = made
        if isinstance(value, list):
            made += [copied(each, seen) for each in value]
        else:
            held: Any = getattr(value, "fields", value)
            getattr(made, "fields", made).update({k: copied(one, seen) for k, one in held.items()})
    return Node(seen.get(id(value), value), node.place, node.decimals)


def _tops(path: Path) -> Iterator[Path]:
    """Yields the folders above a file up to that of its project, or of its package."""
    project = [folder for folder in path.parents
               if any((folder / mark).exists() for mark in _PROJECT)]  # fmt: skip
    for folder in path.parents:
        yield folder
        within = project and folder != project[0] and folder.is_relative_to(project[0])
        if not within and folder != path.parent and not is_input(folder / "__init__.py"):
            return


def _number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
