"""What an exported policy says of itself: the metadata that Isaac Lab and mjlab write into ONNX."""

from __future__ import annotations

from collections.abc import Iterator

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import InputError, ModelError
from pupper_analysis.base.inputs import MOST_FILE, read_input
from pupper_analysis.models.places import Place, source_name
from pupper_analysis.tools.contract.facts import Request, Role, Source, Statement
from pupper_analysis.tools.contract.marked import decimals_of

SUFFIXES = (".onnx",)

_METADATA, _KEY, _VALUE = 14, 1, 2
"""Fields of ``ModelProto`` and ``StringStringEntryProto``. Source: onnx.proto3 of ONNX."""

_LISTS = {
    "default_joint_pos": "default angle",
    "joint_stiffness": "kp",
    "joint_damping": "kd",
    "action_scale": "action scale",
}


def read(request: Request) -> Iterator[Source]:
    """Yields what a policy says of itself, if it does."""
    try:
        data = read_input(request.path, MOST_FILE)
        said = dict(_entries(data))
    except InputError as error:
        raise ModelError(source_name(request.path, error.line), error.cause) from error
    except (IndexError, ValueError) as error:
        raise ModelError(request.path, diagnose("contract-no-onnx")) from error
    statements = []
    for key, quantity in _LISTS.items():
        texts = [text.strip() for text in said.get(key, "").split(",") if text]
        place = Place(request.path, element=key)
        for index, text in enumerate(texts):
            try:
                value, digits, shown = float(text), decimals_of(text), ""
            except ValueError:
                value, digits, shown = None, None, text
            statements.append(Statement(quantity, value, place, index=index, count=len(texts),
                                        decimals=digits, expression=shown))  # fmt: skip
    order = tuple(filter(None, said.get("joint_names", "").split(",")))
    seen = Place(request.path, element="observation_names")
    names = filter(None, said.get("observation_names", "").split(","))
    if statements or order:
        yield Source(
            request.path.name,
            request.path,
            Role.POLICY,
            tuple(statements),
            order=order,
            order_place=Place(request.path, element="joint_names"),
            observations=tuple((name, None, seen) for name in names),
        )


def _entries(data: bytes) -> Iterator[tuple[str, str]]:
    for field, value in _fields(data):
        if field == _METADATA and isinstance(value, bytes):
            parts = {number: part for number, part in _fields(value) if isinstance(part, bytes)}
            key, text = (parts.get(which, b"").decode() for which in (_KEY, _VALUE))
            yield key, text


def _fields(data: bytes) -> Iterator[tuple[int, bytes | int]]:
    """Yields (number, content) of a message of Protocol Buffers: its wire format."""
    at = 0
    while at < len(data):
        tag, at = _varint(data, at)
        kind = tag & 7
        if kind == 0:
            value, at = _varint(data, at)
            yield tag >> 3, value
            continue
        if kind not in (1, 2, 5):
            raise ValueError(kind)
        size, at = _varint(data, at) if kind == 2 else ({1: 8, 5: 4}[kind], at)
        if at + size > len(data):
            raise ValueError(size)
        yield tag >> 3, data[at : at + size]
        at += size


def _varint(data: bytes, at: int) -> tuple[int, int]:
    value = 0
    for shift in range(0, 64, 7):
        value |= (data[at] & 0x7F) << shift
        at += 1
        if not data[at - 1] & 0x80:
            return value, at
    raise ValueError(at)
