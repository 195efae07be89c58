"""Reader of the metadata that Isaac Lab and mjlab write into an exported ONNX policy.

Input is an ONNX file, whose Protocol Buffers messages are decoded without the package onnx; the
network is not executed. Output is a `JointSource` with joint order, gains, scales and observations
from the metadata, and the sizes of input and output.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import InputError, ModelError
from pupper_analysis.base.inputs import MAX_FILE_BYTES, read_input
from pupper_analysis.models.places import Place, make_input_error
from pupper_analysis.tools.contract.facts import (
    JointSource,
    LocatedValue,
    Request,
    Role,
    Statement,
    parse_scalar,
)
from pupper_analysis.tools.contract.readers.tables import read_table

FILE_SUFFIXES = (".onnx",)
"""Suffixes of the files that this reader of exported policies reads."""

ProtobufMessage = dict[int, list["int | memoryview"]]
"""Message of Protocol Buffers: {field number: values, in order}."""

_GRAPH_FIELD, _METADATA_FIELD = 7, 14
"""Numbers of the fields ``graph`` and ``metadata_props`` in a ``ModelProto`` (onnx.proto, 1.16)."""
_INPUTS_FIELD, _OUTPUTS_FIELD, _CONSTANTS_FIELD = 11, 12, 5
"""Numbers of the fields ``input``, ``output`` and ``initializer`` in a ``GraphProto`` (onnx.proto,
1.16)."""


@dataclass(frozen=True, eq=False)
class OnnxFile:
    """Content of an ONNX file. The network is not executed.

    Attributes:
        metadata: {key: text} of the exporter.
        graph: Message ``GraphProto``; empty if the file has none.
        inputs: {input: sizes, 0 for a symbolic size}, without constants.
        outputs: {output: sizes, 0 for a symbolic size}.
    """

    metadata: dict[str, str]
    graph: ProtobufMessage
    inputs: dict[str, list[int]]
    outputs: dict[str, list[int]]


def read_onnx(path: Path) -> OnnxFile:
    """Read the metadata and the tensor shapes of an ONNX file.

    Raises:
        ModelError: If the file cannot be read, or is not an ONNX file.
    """
    try:
        model = gather_fields(memoryview(read_input(path, MAX_FILE_BYTES)))
        entries = [gather_fields(entry) for entry in model.get(_METADATA_FIELD, ())]
        metadata = {get_text(entry, 1): get_text(entry, 2) for entry in entries}
        graph = gather_fields(model[_GRAPH_FIELD][0]) if _GRAPH_FIELD in model else {}
        constants = {
            get_text(gather_fields(constant), 8) for constant in graph.get(_CONSTANTS_FIELD, ())
        }
        shapes = [
            dict(map(_read_tensor_shape, graph.get(field, ())))
            for field in (_INPUTS_FIELD, _OUTPUTS_FIELD)
        ]
    except InputError as error:
        raise make_input_error(path, error) from error
    except (IndexError, KeyError, ValueError, TypeError) as error:
        raise ModelError(path, diagnose("contract-no-onnx")) from error
    inputs = {name: sizes for name, sizes in shapes[0].items() if name not in constants}
    return OnnxFile(metadata, graph, inputs, shapes[1])


_ACTION_NAMES = ("actions", "action", "mu", "mean", "mean_actions", "continuous_actions")
"""Names of the action output in networks of rl_games, skrl and other trainers. The names select the
action if a network without states has several outputs, such as standard deviation and value.
"""


def list_action_outputs(file: OnnxFile) -> list[str]:
    """Return the outputs of a network.

    Of several outputs of a network without states, only those in `_ACTION_NAMES`, if any.
    """
    outputs = list(file.outputs)
    if len(file.inputs) == 1 and len(outputs) > 1:  # rl_games: mean, deviation and value
        outputs = [name for name in outputs if name in _ACTION_NAMES] or outputs
    return outputs


def read(request: Request) -> Iterator[JointSource]:
    """Yield a source with the joint values (such as gains) and tensor sizes of an ONNX policy.

    Joint values are in the metadata. The tensor sizes are the last dimensions of the first input
    and of the action (`list_action_outputs`), unless symbolic. Further inputs must be recurrent
    states, each with an output; of a network with other inputs, the number of inputs is unknown.

    Raises:
        ModelError: If the file cannot be read, or is not an ONNX file, for example.
    """
    file = read_onnx(request.path)
    table = {
        key: _split_list(text, Place(request.path, element=key))
        for key, text in file.metadata.items()
    }
    actions = {name: file.outputs[name] for name in list_action_outputs(file)}
    is_paired = len(file.inputs) in (1, len(actions))
    ends = {"actions": actions, "observed numbers": file.inputs if is_paired else {}}
    sizes = [
        Statement(what, float(size[-1]), Place(request.path, element=name))
        for what, end in ends.items()
        for name, size in list(end.items())[:1]
        if size and size[-1] > 0
    ]
    whole = LocatedValue(table, Place(request.path))
    yield from read_table(request, request.path.name, whole, Role.POLICY, sizes)


def _split_list(text: str, place: Place) -> LocatedValue:
    """Parse a list in the metadata, with or without brackets and quotes."""
    parts = (
        part for part_text in text.strip("[]() ").split(",") if (part := part_text.strip(" \"'"))
    )
    return LocatedValue([parse_scalar(part, place) for part in parts], place)


def gather_fields(data: int | memoryview) -> ProtobufMessage:
    """Decode the fields of a message in the wire format of Protocol Buffers.

    Args:
        data: Bytes of the message. An integer is a field that is not a message, and is refused.

    Returns:
        {field number: values in order}: integers, or bytes of nested messages, texts and numbers of
        fixed size.

    Raises:
        ValueError: If the data is no such message, for example.
        IndexError: If the data ends inside an integer.
    """
    if isinstance(data, int):
        raise ValueError(data)
    position, message = 0, ProtobufMessage()
    while position < len(data):
        tag, position = _decode_varint(data, position)
        wire_type = tag & 7
        value: int | memoryview
        if wire_type == 0:
            value, position = _decode_varint(data, position)
        else:
            size, position = (
                _decode_varint(data, position)
                if wire_type == 2
                else ({1: 8, 5: 4}.get(wire_type, -1), position)
            )
            if size < 0 or position + size > len(data):
                raise ValueError(wire_type)
            value, position = data[position : position + size], position + size
        message.setdefault(tag >> 3, []).append(value)
    return message


def get_text(message: ProtobufMessage, number: int, index: int = 0) -> str:
    """Return a field of a decoded message as text; "" if the field is missing or an integer.

    Args:
        message: Message.
        number: Field number.
        index: Index among the values of a repeated field.
    """
    values = message.get(number, ())
    content = values[index] if len(values) > index else b""
    return "" if isinstance(content, int) else bytes(content).decode(errors="replace")


def decode_integers(values: Sequence[int | memoryview]) -> list[int]:
    """Decode the values of a repeated integer field of Protocol Buffers to signed integers.

    Args:
        values: Single integers, or bytes with packed integers.
    """
    flat: list[int] = []
    for value in values:
        if isinstance(value, int):
            flat.append(value)
            continue
        position = 0
        while position < len(value):
            integer, position = _decode_varint(value, position)
            flat.append(integer)
    return [value - (1 << 64) if value >> 63 else value for value in flat]


def _read_tensor_shape(data: int | memoryview) -> tuple[str, list[int]]:
    """Return the name and the sizes of a tensor; 0 for a symbolic size."""
    value = gather_fields(data)
    kind = gather_fields(gather_fields(value[2][0])[1][0])
    shape = gather_fields(kind[2][0]) if 2 in kind else {}
    dims = [decode_integers(gather_fields(dim).get(1, [0]))[0] for dim in shape.get(1, ())]
    return get_text(value, 1), dims


def _decode_varint(data: memoryview, position: int) -> tuple[int, int]:
    """Return the variable-length integer at a position, and the position after the integer.

    Raises:
        ValueError: If the integer has more than ten bytes.
        IndexError: If the data ends inside the integer.
    """
    value = 0
    for shift in range(0, 70, 7):  # at most ten bytes
        value |= (data[position] & 0x7F) << shift
        position += 1
        if not data[position - 1] & 0x80:
            return value, position
    raise ValueError(position)
