"""What an exported policy says of itself: the metadata that Isaac Lab and mjlab write into ONNX."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import InputError, ModelError
from pupper_analysis.base.inputs import MAX_FILE_BYTES, read_input
from pupper_analysis.models.places import Place, make_input_error
from pupper_analysis.tools.contract.facts import (
    Node,
    Request,
    Role,
    Source,
    Statement,
    parse_scalar,
)
from pupper_analysis.tools.contract.readers.tables import read_table

SUFFIXES = (".onnx",)

ProtobufMessage = dict[int, list["int | memoryview"]]
"""A message of Protocol Buffers: {number of a field: its values, in order}."""

# Fields are numbered as in onnx.proto (ONNX 1.16).
_GRAPH, _METADATA = 7, 14
_INPUTS, _OUTPUTS, _CONSTANTS = 11, 12, 5


@dataclass(frozen=True, eq=False)
class OnnxFile:
    """An ONNX file; nothing of it is executed.

    Attributes:
        metadata: {key: text} that its exporter wrote.
        graph: Its graph, a ``GraphProto``; empty if it has none.
        inputs: {input: its sizes, 1 where a size is a symbol}; constants are none.
        outputs: Likewise.
    """

    metadata: dict[str, str]
    graph: ProtobufMessage
    inputs: dict[str, list[int]]
    outputs: dict[str, list[int]]


def read_onnx(path: Path) -> OnnxFile:
    """Reads an ONNX file's metadata and its graph's shape.

    Raises:
        ModelError: If it cannot be read, or is no ONNX file.
    """
    try:
        model = gather_fields(memoryview(read_input(path, MAX_FILE_BYTES)))
        entries = [gather_fields(one) for one in model.get(_METADATA, ())]
        metadata = {get_text(one, 1): get_text(one, 2) for one in entries}
        graph = gather_fields(model[_GRAPH][0]) if _GRAPH in model else {}
        constants = {get_text(gather_fields(one), 8) for one in graph.get(_CONSTANTS, ())}
        ends = [dict(map(_named_sizes, graph.get(which, ()))) for which in (_INPUTS, _OUTPUTS)]
    except InputError as error:
        raise make_input_error(path, error) from error
    except (IndexError, KeyError, ValueError, TypeError) as error:
        raise ModelError(path, diagnose("contract-no-onnx")) from error
    inputs = {name: sizes for name, sizes in ends[0].items() if name not in constants}
    return OnnxFile(metadata, graph, inputs, ends[1])


def read(request: Request) -> Iterator[Source]:
    """Yields what a policy says of itself, if it does."""
    file = read_onnx(request.path)
    table = {
        key: _parts(text, Place(request.path, element=key)) for key, text in file.metadata.items()
    }
    ends = {"actions": file.outputs, "observed numbers": file.inputs}
    sizes = [
        Statement(what, float(size[-1]), Place(request.path, element=name))
        for what, end in ends.items()
        for name, size in list(end.items())[:1]
        if size
    ]
    whole = Node(table, Place(request.path))
    yield from read_table(request, request.path.name, whole, Role.POLICY, sizes)


def _parts(text: str, place: Place) -> Node:
    """Returns what a list in metadata holds, with its brackets and quotes or without."""
    parts = (part for one in text.strip("[]() ").split(",") if (part := one.strip(" \"'")))
    return Node([parse_scalar(part, place) for part in parts], place)


def gather_fields(data: int | memoryview) -> ProtobufMessage:
    """Returns the fields of a message in the wire format of Protocol Buffers.

    Raises:
        ValueError: If it is none.
    """
    if isinstance(data, int):
        raise ValueError(data)
    at, found = 0, ProtobufMessage()
    while at < len(data):
        tag, at = _varint(data, at)
        kind = tag & 7
        value: int | memoryview
        if kind == 0:
            value, at = _varint(data, at)
        else:
            size, at = _varint(data, at) if kind == 2 else ({1: 8, 5: 4}.get(kind, -1), at)
            if size < 0 or at + size > len(data):
                raise ValueError(kind)
            value, at = data[at : at + size], at + size
        found.setdefault(tag >> 3, []).append(value)
    return found


def get_text(message: ProtobufMessage, number: int, index: int = 0) -> str:
    """Returns a field of a message as a text; "" if it is not there."""
    values = message.get(number, ())
    held = values[index] if len(values) > index else b""
    return "" if isinstance(held, int) else bytes(held).decode(errors="replace")


def decode_integers(values: Sequence[int | memoryview]) -> list[int]:
    """Returns signed integers that are packed, or stand one by one."""
    flat: list[int] = []
    for value in values:
        if isinstance(value, int):
            flat.append(value)
            continue
        at = 0
        while at < len(value):
            one, at = _varint(value, at)
            flat.append(one)
    return [value - (1 << 64) if value >> 63 else value for value in flat]


def _named_sizes(data: int | memoryview) -> tuple[str, list[int]]:
    """Returns the name and the sizes of an input or output; 1 where a size is a symbol."""
    value = gather_fields(data)
    kind = gather_fields(gather_fields(value[2][0])[1][0])
    shape = gather_fields(kind[2][0]) if 2 in kind else {}
    dims = [decode_integers(gather_fields(dim).get(1, [1]))[0] for dim in shape.get(1, ())]
    return get_text(value, 1), dims


def _varint(data: memoryview, at: int) -> tuple[int, int]:
    value = 0
    for shift in range(0, 70, 7):  # ten bytes are the longest
        value |= (data[at] & 0x7F) << shift
        at += 1
        if not data[at - 1] & 0x80:
            return value, at
    raise ValueError(at)
