"""ONNX: the graph of a feed-forward or recurrent policy, read from its protocol buffers.

Only what policies consist of is known; what is not is refused by its operator's name. Nothing is
executed but the operations of ``network``. Fields are numbered as in onnx.proto (ONNX 1.16).
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ModelError
from pupper_analysis.tools.walk.network import (
    ACTIVATIONS,
    MOST_WEIGHTS,
    Network,
    Node,
    Operation,
    checked,
    elu,
    gru,
    lstm,
)

Array = NDArray[np.float64]

_TYPES = {1: "<f4", 6: "<i4", 7: "<i8", 10: "<f2", 11: "<f8"}
"""NumPy's types of TensorProto's."""

_LISTS = {1: 4, 6: 5, 7: 7, 11: 10}
"""The field that holds numbers of a type, where they are not raw."""


class _NoMessageError(ValueError):
    """Bytes are no protocol buffer."""


def _fields(data: memoryview) -> Iterator[tuple[int, Any]]:
    """Yields (number, value) of a message: integers, or bytes, as they come."""
    at, end = 0, len(data)

    def varint() -> int:
        nonlocal at
        value = shift = 0
        while True:
            if at >= end or shift > 63:
                raise _NoMessageError
            byte = data[at]
            at += 1
            value |= (byte & 127) << shift
            if byte < 128:
                return value
            shift += 7

    while at < end:
        key = varint()
        kind = key & 7
        if kind == 0:
            yield key >> 3, varint()
            continue
        size = varint() if kind == 2 else {1: 8, 5: 4}.get(kind, -1)
        if size < 0 or at + size > end:
            raise _NoMessageError
        yield key >> 3, data[at : at + size]
        at += size


def _gathered(data: memoryview) -> dict[int, list[Any]]:
    found: dict[int, list[Any]] = {}
    for number, value in _fields(data):
        found.setdefault(number, []).append(value)
    return found


def _text(values: Sequence[Any], index: int = 0) -> str:
    return bytes(values[index]).decode(errors="replace") if len(values) > index else ""


def _integers(values: Sequence[Any]) -> list[int]:
    """Returns signed integers, packed or one by one."""
    flat: list[int] = []
    for value in values:
        if isinstance(value, int):
            flat.append(value)
        else:  # packed: each as the key of a message without a value
            flat += _packed(value)
    return [value - (1 << 64) if value >> 63 else value for value in flat]


def _packed(data: memoryview) -> list[int]:
    values, value, shift = [], 0, 0
    for byte in data:
        value |= (byte & 127) << shift
        shift += 7
        if byte < 128:
            values.append(value)
            value = shift = 0
    return values


def _floats(values: Sequence[Any]) -> list[float]:
    return [one for value in values for (one,) in struct.iter_unpack("<f", bytes(value))]


def _tensor(path: Path, data: memoryview) -> tuple[str, Array]:
    """Returns a tensor's name and its numbers."""
    tensor = _gathered(data)
    name, dims = _text(tensor.get(8, ())), _integers(tensor.get(1, ()))
    kind = tensor.get(2, [0])[0]
    count = 1
    for dim in dims:
        count *= dim
    if count > MOST_WEIGHTS or any(dim < 0 for dim in dims):
        problem = diagnose("too-many-weights", layer=name, count=count, most=MOST_WEIGHTS)
        raise ModelError(path, problem)
    if kind not in _TYPES or tensor.get(14, [0])[0]:
        raise ModelError(path, diagnose("weights-elsewhere", layer=name))
    if 9 in tensor:
        raw = bytes(tensor[9][0])
        size = np.dtype(_TYPES[kind]).itemsize
        found = np.frombuffer(raw[: len(raw) // size * size], dtype=_TYPES[kind])
    elif kind in (1, 11):
        form = "<f4" if kind == 1 else "<f8"
        found = np.frombuffer(b"".join(map(bytes, tensor.get(_LISTS[kind], ()))), dtype=form)
    else:
        found = np.array(_integers(tensor.get(_LISTS.get(kind, 5), ())))
    if found.size != count:
        problem = diagnose("layer-sizes", layer=name, sizes=f"{dims}, {found.size}")
        raise ModelError(path, problem)
    return name, found.reshape(dims).astype(np.float64)


@dataclass(frozen=True)
class Graph:
    """An ONNX file.

    Attributes:
        network: What it computes.
        metadata: {key: text} that its exporter wrote.
    """

    network: Network
    metadata: dict[str, str]


def read_onnx(path: Path, data: bytes) -> Graph:
    """Returns the network and the metadata of an ONNX file.

    Args:
        path: The file, for messages.
        data: Its content.

    Raises:
        ModelError: If it is none, or has operators that policies do not consist of.
    """
    try:
        model = _gathered(memoryview(data))
        graph = _gathered(model[7][0])
        metadata = {}
        for entry in model.get(14, ()):
            pair = _gathered(entry)
            metadata[_text(pair.get(1, ()))] = _text(pair.get(2, ()))
        return Graph(_network(path, graph), metadata)
    except (_NoMessageError, KeyError, IndexError, TypeError, struct.error) as error:
        raise ModelError(path, diagnose("no-network")) from error


def _network(path: Path, graph: dict[int, list[Any]]) -> Network:
    constants = dict(_tensor(path, one) for one in graph.get(5, ()))
    if sum(one.size for one in constants.values()) > MOST_WEIGHTS:
        count = sum(one.size for one in constants.values())
        problem = diagnose("too-many-weights", layer="", count=count, most=MOST_WEIGHTS)
        raise ModelError(path, problem)
    inputs = [_value(one) for one in graph[11]]
    inputs = [(name, dims) for name, dims in inputs if name not in constants]
    outputs = [_value(one) for one in graph[12]]
    nodes = [
        _node(path, _gathered(one), number, constants) for number, one in enumerate(graph[1], 1)
    ]
    if len(inputs) != len(outputs):
        raise ModelError(
            path, diagnose("states-unpaired", inputs=len(inputs), outputs=len(outputs))
        )
    memory = []
    for (name, dims), (following, _) in zip(inputs[1:], outputs[1:], strict=True):
        if not dims or max(dims[:-1], default=1) > 1:
            raise ModelError(path, diagnose("layer-sizes", layer=name, sizes=str(dims)))
        memory.append((name, following, dims[-1]))
    size = inputs[0][1][-1] if inputs[0][1] else 0
    if not 0 < size <= MOST_WEIGHTS:
        raise ModelError(path, diagnose("layer-sizes", layer=inputs[0][0], sizes=str(inputs[0][1])))
    used = {name for node in nodes for name in node.inputs}
    kept = {name: value for name, value in constants.items() if name in used}
    return checked(path, nodes, kept, (inputs[0][0], outputs[0][0]), memory, size)


def _value(data: memoryview) -> tuple[str, list[int]]:
    """Returns the name and the sizes of an input or output; 1 where a size is a symbol."""
    value = _gathered(data)
    kind = _gathered(_gathered(value[2][0])[1][0])
    shape = _gathered(kind[2][0]) if 2 in kind else {}
    dims = [_gathered(dim).get(1, [1])[0] for dim in shape.get(1, ())]
    return _text(value[1]), dims


def _node(path: Path, node: dict[int, list[Any]], number: int, constants: dict[str, Array]) -> Node:
    kind = _text(node.get(4, ()))
    name = _text(node.get(3, ())) or f"layer {number} ({kind})"
    inputs = tuple(_text(node[1], index) for index in range(len(node.get(1, ()))))
    outputs = tuple(_text(node[2], index) for index in range(len(node[2])))
    given: dict[str, Any] = {}
    for one in node.get(5, ()):
        attribute = _gathered(one)
        key = _text(attribute[1])
        if 5 in attribute:
            given[key] = _tensor(path, attribute[5][0])[1]
        elif 3 in attribute:
            given[key] = _integers(attribute[3])[0]
        elif 8 in attribute:
            given[key] = _integers(attribute[8])
        elif 2 in attribute:
            given[key] = struct.unpack("<f", bytes(attribute[2][0]))[0]
        elif 4 in attribute:
            given[key] = _text(attribute[4])
    if kind == "Constant" and "value" in given:
        constants[outputs[0]] = given["value"]
        return Node(name, lambda value: value, (outputs[0],), outputs)
    make = _OPERATORS.get(kind)
    operation = None if make is None else make(given, len(outputs))
    if operation is None:
        problem = diagnose("layer-unknown", layer=f"{name}: {kind}", known=sorted(_OPERATORS))
        raise ModelError(path, problem)
    if kind in _IGNORED:
        return Node(name, operation, inputs[:1], outputs[:1])
    if kind in ("GRU", "LSTM"):  # the fifth input is the lengths of sequences
        inputs = tuple(one for index, one in enumerate(inputs) if index != 4)
    return Node(name, operation, inputs, outputs)


Make = Callable[[dict[str, Any], int], Operation | None]


def _gemm(given: dict[str, Any], _: int) -> Operation | None:
    if given.get("transA") or not given.get("alpha", 1.0) == given.get("beta", 1.0) == 1.0:
        return None
    turned = bool(given.get("transB"))

    def apply(value: Array, weights: Array, bias: Array | float = 0.0) -> Any:
        return np.matmul(value, weights.T if turned else weights) + bias

    return apply


def _last_axis(given: dict[str, Any]) -> bool:
    """Tells whether an operator acts along an observation; else batches would be mixed."""
    return given.get("axis", 0) in (-1, 1, 2)


def _split(given: dict[str, Any], count: int) -> Operation | None:
    if not _last_axis(given):
        return None

    def apply(value: Array, sizes: Array | None = None) -> tuple[Array, ...]:
        parts = given.get("split") if sizes is None else sizes.astype(int).tolist()
        places = count if parts is None else np.cumsum(parts)[:-1].tolist()
        return tuple(np.split(value, places, axis=-1))

    return apply


def _concat(given: dict[str, Any], _: int) -> Operation | None:
    if not _last_axis(given):
        return None

    def apply(*values: Array) -> Any:
        return np.concatenate([np.reshape(one, (*values[0].shape[:-1], -1)) for one in values], -1)

    return apply


def _clip(given: dict[str, Any], _: int) -> Operation:
    def apply(value: Array, low: Any = None, high: Any = None) -> Any:
        low = given.get("min", -np.inf) if low is None else low
        return np.clip(value, low, given.get("max", np.inf) if high is None else high)

    return apply


def _gru(given: dict[str, Any], _: int) -> Operation | None:
    if given.get("direction", "forward") != "forward" or given.get("activations"):
        return None
    after = bool(given.get("linear_before_reset", 0))

    def apply(value: Array, w: Array, r: Array, b: Array, hidden: Array) -> Any:
        biases = b[0].reshape(2, -1)
        state = gru(value, hidden, w[0].T, r[0].T, biases, after=after)
        return state, state

    return apply


def _lstm(given: dict[str, Any], _: int) -> Operation | None:
    if given.get("direction", "forward") != "forward" or given.get("activations"):
        return None

    def turned(weights: Array) -> Array:
        one, out, stay, fresh = np.split(weights, 4)  # i, o, f, c in ONNX
        return np.concatenate([one, stay, fresh, out])

    def apply(value: Array, w: Array, r: Array, b: Array, hidden: Array, cell: Array) -> Any:
        bias = turned(b[0, : len(w[0])]) + turned(b[0, len(w[0]) :])
        state, cell = lstm(value, hidden, cell, turned(w[0]).T, turned(r[0]).T, bias)
        return state, state, cell

    return apply


def _plain(operation: Operation) -> Make:
    return lambda _given, _count: operation


_IGNORED = ("Identity", "Cast", "Dropout", "Flatten", "Reshape", "Squeeze", "Unsqueeze")
"""What leaves an observation's numbers in their order."""

_OPERATORS: dict[str, Make] = {
    "Add": _plain(np.add),
    "Sub": _plain(np.subtract),
    "Mul": _plain(np.multiply),
    "Div": _plain(np.divide),
    "MatMul": _plain(np.matmul),
    "Neg": _plain(np.negative),
    "Exp": _plain(np.exp),
    "Sqrt": _plain(np.sqrt),
    "Relu": _plain(ACTIVATIONS["relu"]),
    "Tanh": _plain(np.tanh),
    "Sigmoid": _plain(ACTIVATIONS["sigmoid"]),
    "Softsign": _plain(ACTIVATIONS["softsign"]),
    "Softplus": _plain(ACTIVATIONS["softplus"]),
    "Selu": _plain(ACTIVATIONS["selu"]),
    "Elu": lambda given, _: lambda value: elu(value, given.get("alpha", 1.0)),
    "LeakyRelu": lambda given, _: (
        lambda value: np.where(value > 0, value, given.get("alpha", 0.01) * value)
    ),
    "Gemm": _gemm,
    "Split": _split,
    "Concat": _concat,
    "Clip": _clip,
    "GRU": _gru,
    "LSTM": _lstm,
    **dict.fromkeys(_IGNORED, _plain(ACTIVATIONS["linear"])),
}
