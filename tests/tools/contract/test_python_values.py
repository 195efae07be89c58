"""Values of Python sources by their syntax, without execution: statements that change a value
count, and unknown values stay unknown.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from pupper_analysis.tools.contract.facts import LocatedValue
from pupper_analysis.tools.contract.python_values import Evaluator


def evaluate_x(tmp_path: Path, text: str) -> LocatedValue:
    """Return the evaluated name ``x`` of a module."""
    path = tmp_path / "settings.py"
    path.write_text(text)
    return Evaluator().load_module(path)["x"]


def to_plain(node: LocatedValue) -> object:
    """Return a value without its places; of an unknown value, its text in brackets."""
    value = node.value
    if isinstance(value, list):
        return [to_plain(item) for item in value]
    if isinstance(value, dict):
        return {key: to_plain(one) for key, one in value.items()}
    return value if value is None or isinstance(value, bool | int | float | str) else f"<{value}>"


KNOWN = {
    "starred expression outside of a list": ("a = [1]\nx = *a\n", "<*a>"),
    "continue": ("x = {}\nfor n in 'a', 'b':\n    if n == 'a':\n        continue\n    x[n] = 1\n",
                 {"b": 1}),
    "break": ("x = []\nfor n in range(5):\n    if n:\n        break\n    x.append(n)\n", [0]),
    "else of a loop": ("x = 1\nfor n in 1, 2:\n    pass\nelse:\n    x = 2\n", 2),
    "else of a loop with break": (
        "x = 1\nfor n in 1, 2:\n    break\nelse:\n    x = 2\n", 1),
    "break in the else of a loop": (
        "x = []\nfor n in 1, 2:\n    x.append(n)\n    for m in 3, 4:\n        pass\n"
        "    else:\n        break\n", [1]),
    "raise leaves all loops of a try": (
        "x = []\ntry:\n    for n in 1, 2:\n        for m in 3, 4:\n            x.append(n * m)\n"
        "            raise ValueError\n    x.append(0)\nexcept ValueError:\n    pass\n", [3]),
    "raise within a called loop": (
        "def f():\n    for n in 1, 2:\n        raise ValueError\n    return n\nx = 7\nx = f()\n",
        "<f()>"),
    "raise ends a module": ("x = 1\nfor n in 1, 2:\n    raise ValueError\nx = 2\n", 1),
    "at last after a raise": (
        "x = [1]\ntry:\n    raise ValueError\nexcept ValueError:\n    pass\nfinally:\n"
        "    x.append(2)\n", [1, 2]),
    "pop": ("x = {'a': 1, 'b': 2}\nx.pop('a')\n", {"b": 2}),
    "insert and extend": ("x = [2]\nx.insert(0, 1)\nx.extend([3, 4])\n", [1, 2, 3, 4]),
    "setdefault": ("x = {}\nx.setdefault('a', 3)\nx.setdefault('a', 4)\n", {"a": 3}),
    "enumerate from": ("x = [n for n, _ in enumerate('ab', start=2)]\nx = [[n, v] for n, v in "
                       "enumerate([7, 8], start=2)]\n", [[2, 7], [3, 8]]),
    "a type": ("e = 3.0\nif not isinstance(e, dict):\n    e = {'a': e}\nx = e\n", {"a": 3.0}),
    "a method's own names": ("scale = 2\nclass A:\n    scale = 3\n    def f(self):\n"
                             "        return scale * self.scale\nx = A().f()\n", 6),
    "a base's method": ("class A:\n    def __post_init__(self):\n        self.kp = 5\n"
                        "class B(A):\n    def __post_init__(self):\n"
                        "        super().__post_init__()\n        self.kd = self.kp / 10\n"
                        "x = B().kd\n", 0.5),
    "each instance's own": ("from dataclasses import dataclass, field\n@dataclass\nclass A:\n"
                            "    of: list = field(default_factory=lambda: [1])\n"
                            "a = A()\na.of.append(2)\nx = A().of\n", [1]),
    "a class's own start": (
        "class A:\n    kd = 1\n    def __init__(self, kp, gain=2):\n"
        "        self.kp = gain * kp\nclass B(A):\n    def __init__(self, kp):\n"
        "        super().__init__(kp, gain=3)\n        self.kd = self.kp / 10\n"
        "a, b = A(kp=10), B(10)\nx = [a.kp, a.kd, b.kp, b.kd]\n", [20, 1, 30, 3.0]),
    "a dataclass's own start": (
        "class A:\n    def __init__(self, kp):\n        self.kp = 2 * kp\n@dataclass\n"
        "class B(A):\n    kp: float = 1.0\nx = [B().kp, B(3).kp]\n", [1.0, 3]),
    "the module's name": ("x = 1\nif __name__ == '__main__':\n    x = 2\n", 1),
    "digits": ("x = 2.50\n", 2.5),
    "a table and more": ("a = {'kp': 1, 'kd': 2}\nx = dict(a, kp=3)\ny = a\n", {"kp": 3, "kd": 2}),
    "another list": ("a = [2, 1]\nb = list(a)\nb.append(3)\nx = a + sorted(b)\n", [2, 1, 1, 2, 3]),
    "starred": ("def f(a, b):\n    return b\nx = f(*[1, 2])\n", 2),
    "handed on": ("def term(of, *args, **kwargs):\n    return lambda: of(*args, **kwargs)\n"
                  "def f(a, scale):\n    return [a, scale]\nscale = 7\n"
                  "def g(**kwargs):\n    return scale\n"
                  "x = [term(f, 1, scale=2)(), g(scale=3)]\n", [[1, 2], 7]),
    "at last": ("x = 1\ntry:\n    x = 2\nfinally:\n    x = 3\n", 3),
}  # fmt: skip


@pytest.mark.parametrize("case", KNOWN)
def test_python_expressions_evaluate_to_the_values_of_python(tmp_path: Path, case: str) -> None:
    text, expected = KNOWN[case]
    assert to_plain(evaluate_x(tmp_path, text)) == expected


LOST = {
    "deleted": ("x = {'a': 1, 'b': 2}\ndel x['a']\n", {"a": "<del x['a']>", "b": 2}),
    "a loop without end": ("x = 0\nwhile True:\n    x = x + 1\n", "<x = x + 1>"),
    "what may not happen": ("x = 1\nif unknown():\n    x = 2\n", "<x = 2>"),
    "what may be updated": (
        "x = {'a': 1, 'b': 2}\nif unknown():\n    x.update({'a': 5}, c=7)\n",
        {"a": "<x.update({'a': 5}, c=7)>", "b": 2, "c": "<x.update({'a': 5}, c=7)>"}),
    "what may be updated with unknown keys": (
        "d = {'a': 1}\nif unknown():\n    d.update(load())\n"
        "x = [d, d.get('b', 3), 4 if 'c' in d else 5]\n",
        [{"a": "<d.update(load())>"}, "<d.get('b', 3)>", "<4 if 'c' in d else 5>"]),
    "what may be popped": (
        "x = {'a': 1, 'b': 2}\nif unknown():\n    x.pop('a')\n    x.pop('c', 0)\n"
        "    x.setdefault('b', 3)\n", {"a": "<x.pop('a')>", "b": 2}),
    "what may be appended": (
        "a = [1, 2]\nb = a\nif unknown():\n    a.append(3)\nx = [b, len(b), b[0]]\n",
        ["<a.append(3)>", "<len(b)>", "<b[0]>"]),
    "what may be deleted": (
        "x = [1, 2]\nif unknown():\n    del x[0]\n", ["<del x[0]>", "<del x[0]>"]),
    "an item that may be set": ("x = [1, 2]\nif unknown():\n    x[1] = 3\n", [1, "<x[1] = 3>"]),
    "any item that may be set": (
        "x = {'a': 1, 'b': 2}\nif unknown():\n    for n in 'a', 'b':\n        x[n] = 3\n",
        {"a": "<x[n] = 3>", "b": "<x[n] = 3>"}),
    "by another name": (
        "x = {'a': {'kp': 1, 'kd': 2}, 'b': 3}\nif unknown():\n    d = x['a']\n"
        "    d['kp'] = 4\n", {"a": {"kp": "<d['kp'] = 4>", "kd": 2}, "b": 3}),
    "in a loop over tables": (
        "x = {'a': {'kp': 1}, 'b': {'kp': 2}}\nif unknown():\n"
        "    for name, d in x.items():\n        d.update(kp=4)\n",
        {"a": {"kp": "<d.update(kp=4)>"}, "b": {"kp": "<d.update(kp=4)>"}}),
    "in a called function": (
        "def f(d, v):\n    d['a'] = v\nx = {'a': 1, 'b': 2}\nif unknown():\n    f(x, 3)\n",
        {"a": "<d['a'] = v>", "b": 2}),
    "in a called method": (
        "class A:\n    kp, kd = 1, 2\n    def f(self):\n        self.kp = 3\na = A()\n"
        "if unknown():\n    a.f()\nx = [a.kp, a.kd]\n", ["<self.kp = 3>", 2]),
    "what may be defined again": (
        "def f():\n    return 1\ndef g():\n    return 1\nif unknown():\n    def f():\n"
        "        return 2\n    class B:\n        def g(self):\n            return 3\n"
        "x = [f(), g()]\n", ["<f()>", 1]),
    "over what is not known": ("x = 1\nfor x in unknown:\n    pass\n", "<for x in unknown:>"),
    "what may match": ("x = 1\nmatch unknown:\n    case 1:\n        x = 2\n", "<x = 2>"),
    "too large": ("x = 10\nfor n in range(99):\n    x = x * x\n", "<x * x>"),
    "too many": ("x = [0] * 10**12\n", "<[0] * 10 ** 12>"),
    "too few": ("x, y, z = 1, 1, 1\nx, y, z = [2, 3]\n", "<x, y, z = [2, 3]>"),
    "the rest": ("x = 1\ny, *x = unknown\n", "<y, *x = unknown>"),
    "that raises": ("def f():\n    raise ValueError\nx = f()\n", "<f()>"),
    "a method of a text": (
        "x = ['FL_hip']\nx = [n.replace('FL', 'FR') for n in x]\n", ["<n.replace('FL', 'FR')>"]),
    "a start that raises": (
        "class A:\n    kp, kd = 1, 2\n    def __init__(self, kp):\n        raise ValueError\n"
        "        self.kp = kp\na = A(kp=3)\nx = [a.kp, a.kd]\n", ["<self.kp>", 2]),
    "super in a class method": (
        "class A:\n    pass\nclass B(A):\n    def f(cls):\n        return super().f()\n"
        "x = B.f()\n", "<super().f()>"),
    "super outside a class": ("x = super().y\n", "<super().y>"),
    "as in with": ("x = 1\nwith open('f') as x:\n    pass\n", "<open('f') as x>"),
    "a type without value": ("x = isinstance()\n", "<isinstance()>"),
    "a text's pattern": ("x = '%1000000000d' % 1\n", "<'%1000000000d' % 1>"),
}  # fmt: skip


@pytest.mark.parametrize("case", LOST)
def test_unsupported_python_expressions_are_kept_as_text(tmp_path: Path, case: str) -> None:
    text, expected = LOST[case]
    assert to_plain(evaluate_x(tmp_path, text)) == expected


def test_number_of_decimals_equals_the_source_text(tmp_path: Path) -> None:
    """A form feed is no end of a line, as Python counts them."""
    assert evaluate_x(tmp_path, "y = 1\n\x0c\nx = 2.50\n").decimals == 2
    assert evaluate_x(tmp_path, "x = 0xef\n").decimals == 0
    assert evaluate_x(tmp_path, "x = 1_0.25e1\n").decimals == 1


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("x = {'kp': 1.0}\nx.update(load())\n", {"kp": "<x.update(load())>"}),
        ("x = [1.0]\nx.extend(load())\n", ["<x.extend(load())>"]),
        ("x = [1.0]\nx.append(load())\n", [1.0, "<load()>"]),
        ("x = {'kp': 1.0}\nx[load()] = 2.0\n", {"kp": "<x[load()] = 2.0>"}),
        ("x = {'kp': 1.0}\nx[Joint.KNEE] = 2.0\n", {"kp": 1.0, "Joint.KNEE": 2.0}),
        ("def f(d):\n    d.update(load())\nx = {'kp': 1.0}\nf(x)\n", {"kp": "<d.update(load())>"}),
        ("x = [1.0]\ny = x\ny += [2.0]\n", [1.0, 2.0]),
        ("x = {'kp': 1.0}\ny = x\ny |= {'kp': 3.0}\n", {"kp": "<y |= {'kp': 3.0}>"}),
        ("x = [1.0]\nlog.info(x)\nprint(x)\n", [1.0]),
    ],
)
def test_changes_by_unknown_values_leave_no_old_number(
    tmp_path: Path, text: str, expected: object
) -> None:
    """Reference: the meaning of the statements in Python; `load` and `Joint` are not known."""
    assert to_plain(evaluate_x(tmp_path, text)) == expected
