"""YAML and JSON with the line of each value; nothing but plain values is made of them."""

from __future__ import annotations

import re
from pathlib import Path

import yaml

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ModelError
from pupper_analysis.models.places import Place, one_line, refuse_file
from pupper_analysis.tools.contract.facts import MOST, Node

_FLOAT = re.compile(r"[-+]?(\d[\d_]*\.?\d*|\.\d+)([eE][-+]?\d+)?$")
"""Numbers as people write them: YAML 1.1 has ``1e-3`` as a text, its readers in C++ as a number."""

_WRITTEN = re.compile(r"[-+]?\d*\.?(\d*)(?:[eE]([-+]?\d{1,9}))?")


def read_marked(path: Path, text: str) -> list[Node]:
    """Returns the documents of a YAML, of which JSON is a part.

    Tags are no types: a list of whatever tag is a list. An alias is what it stands for. Weights of
    networks are left out.

    Raises:
        ModelError: If it is none, or holds too much; it tells the line.
    """
    try:
        loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
        documents = list(yaml.compose_all(text, Loader=loader))
        left = [MOST]
        return [_node(path, one, left) for one in documents if one is not None]
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        problem = one_line(error.problem or error.context or "")
        message = diagnose("contract-no-yaml", problem=problem)
        raise refuse_file(Place(path, mark.line + 1 if mark else None), message) from error
    except yaml.YAMLError as error:
        raise ModelError(path, diagnose("contract-no-yaml", problem=one_line(error))) from error


def _node(path: Path, node: yaml.Node, left: list[int]) -> Node:
    place = Place(path, node.start_mark.line + 1)
    left[0] -= 1
    if left[0] < 0:
        raise refuse_file(place, diagnose("contract-too-much", most=MOST))
    if isinstance(node, yaml.MappingNode):
        found, merged = dict[str, Node](), dict[str, Node]()
        for key, value in node.value:
            plain = isinstance(key, yaml.ScalarNode)
            name = str(key.value) if plain else f"? {key.start_mark.index}"
            made = Node([], place) if name == "weights" else _node(path, value, left)
            if key.tag.endswith(":merge"):
                for part in reversed(made.items):
                    merged |= part.value if isinstance(part.value, dict) else {}
            elif name in found:
                place = Place(path, key.start_mark.line + 1)
                raise refuse_file(place, diagnose("contract-twice", key=name))
            else:
                found[name] = made
        return Node(merged | found, place)
    if isinstance(node, yaml.SequenceNode):
        return Node([_node(path, one, left) for one in node.value], place)
    quoted = node.style in ("'", '"', "|", ">")
    return Node(str(node.value), place) if quoted else scalar(str(node.value), place)


def scalar(said: str, place: Place) -> Node:
    """Returns what a text without quotes is: nothing, a truth, a number, or a text."""
    if said.lower() in ("", "~", "null"):
        return Node(None, place)
    if said.lower() in ("true", "false"):
        return Node(said.lower() == "true", place)
    if len(said) <= 64 and _FLOAT.match(said):
        plain = said.replace("_", "")
        return Node(float(plain), place, decimals_of(plain))
    if said.lower() in (".inf", "-.inf", "inf", "-inf"):
        return Node(float(said.replace(".", "")), place, 0)
    return Node(said, place)


def decimals_of(text: str) -> int:
    """Returns the digits after the point of a number as it is written; with its exponent."""
    found = _WRITTEN.fullmatch(text.replace("_", ""))
    return 0 if found is None else max(0, len(found[1]) - int(found[2] or 0))
