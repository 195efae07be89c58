"""A policy: a network, and the contract by which it is run."""

from __future__ import annotations

import io
import reprlib
import struct
import warnings
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import orjson
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import InputError, MissingPackageError, ModelError
from pupper_analysis.base.inputs import MAX_FILE_BYTES, is_input, read_input, read_toml
from pupper_analysis.models.places import Place, make_file_error, make_input_error
from pupper_analysis.tools.contract.facts import Request
from pupper_analysis.tools.contract.readers import (
    OnnxFile,
    decode_integers,
    gather_fields,
    get_text,
    onnx,
    read_onnx,
    tables,
)
from pupper_analysis.tools.contract.readers.onnx import ProtobufMessage
from pupper_analysis.tools.walk.contract import (
    Contract,
    convert_source_statements,
    make_contract,
    make_rtneural_values,
)
from pupper_analysis.tools.walk.network import (
    ACTIVATIONS,
    MAX_WEIGHTS,
    Network,
    Node,
    Operation,
    assemble_network,
    dense,
    elu,
    gru,
    lstm,
)


@dataclass(frozen=True, eq=False)
class Policy:
    """A policy that was read.

    Attributes:
        name: The name of its file.
        network: What maps observations to actions.
        contract: What it observes, and what its actions mean.
    """

    name: str
    network: Network
    contract: Contract

    @classmethod
    def load(cls, path: str | Path, contract: str | Path | None = None) -> Policy:
        """Reads a policy; nothing in it is executed, but for TorchScript by torch's interpreter.

        Args:
            path: An ONNX file, RTNeural's JSON, or (with torch installed) TorchScript, as .pt.
            contract: A TOML that states what the file does not, and counts where both do; by
                default the one beside it, of its name with ``.toml``, if there is one.

        Raises:
            MissingPackageError: If it is TorchScript, and torch is not installed.
            ModelError: If it cannot be used; the message names the layer, or the key.
        """
        path = Path(path)
        try:
            # Not with_suffix: "." has no name to give another suffix to.
            beside = Path(contract or path.parent / f"{path.stem}.toml")
            there = contract is not None or is_input(beside)
            toml: dict[str, Any] = read_toml(beside)[1] if there else {}
        except InputError as error:
            raise ModelError(error.path, error.cause) from error
        network, own = _read_policy(path)
        stated = [(str(path), own), *([(str(beside), toml)] if there else [])]
        agreed = make_contract(path, stated, network.inputs, network.outputs)
        return cls(path.name, network, agreed)

    def with_contract(self, **changed: Any) -> Policy:
        """Returns the policy with other fields of its contract."""
        return replace(self, contract=replace(self.contract, **changed))


Array = NDArray[np.float64]


@contextmanager
def refuse_malformed(path: Path) -> Iterator[None]:
    """Turn an error of Python that a malformed policy file causes into a refusal of the file.

    The readers check the values that they use. This is their last resort, the same for all formats:
    a file is never reported as a defect of the package.

    Raises:
        ModelError: If the block raises such an error.
    """
    try:
        yield
    except (
        ArithmeticError,
        AttributeError,
        LookupError,
        MemoryError,
        RecursionError,
        TypeError,
        ValueError,
        struct.error,
    ) as error:
        raise ModelError(path, diagnose("no-network")) from error


def _read_policy(path: Path) -> tuple[Network, dict[str, Any]]:
    """Return the network of a policy file, and the keys of a contract that the file states."""
    with refuse_malformed(path):
        if path.suffix == ".json":
            values = read_rtneural(path)
            network, sources = build_rtneural_network(path, values), [*tables.read(Request(path))]
            own = make_rtneural_values(values, network.inputs, network.outputs)
        elif path.suffix in TORCHSCRIPT_SUFFIXES:  # states its weights only
            network, sources, own = build_torchscript_network(path), [], {}
        else:
            network, sources, own = (
                build_onnx_network(path, read_onnx(path)),
                [*onnx.read(Request(path))],
                {},
            )
        for source in sources:
            own = convert_source_statements(source) | own
    return network, own


_TYPES = {1: "<f4", 6: "<i4", 7: "<i8", 10: "<f2", 11: "<f8"}
"""NumPy's types of TensorProto's."""

_LISTS = {1: 4, 6: 5, 7: 7, 11: 10}
"""The field that holds numbers of a type, where they are not raw."""


def _floats(values: Sequence[Any]) -> list[float]:
    return [one for value in values for (one,) in struct.iter_unpack("<f", bytes(value))]


def _tensor(path: Path, data: int | memoryview) -> tuple[str, Array]:
    """Returns a tensor's name and its numbers."""
    tensor = gather_fields(data)
    name, dims = get_text(tensor, 8), decode_integers(tensor.get(1, ()))
    kind = tensor.get(2, [0])[0]
    count = 1
    for dim in dims:
        count *= dim
    if count > MAX_WEIGHTS or any(dim < 0 for dim in dims):
        problem = diagnose("too-many-weights", layer=name, count=count, most=MAX_WEIGHTS)
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
        found = np.array(decode_integers(tensor.get(_LISTS.get(kind, 5), ())))
    if found.size != count:
        problem = diagnose("layer-sizes", layer=name, sizes=f"{dims}, {found.size}")
        raise ModelError(path, problem)
    return name, found.reshape(dims).astype(np.float64)


def build_onnx_network(path: Path, file: OnnxFile) -> Network:
    """Returns the network of an ONNX file.

    Args:
        path: The file, for messages.
        file: What was read of it.

    Raises:
        ModelError: If it has none, or operators that policies do not consist of.
    """
    with refuse_malformed(path):
        return _network(path, file)


def _network(path: Path, file: OnnxFile) -> Network:
    graph = file.graph
    constants = dict(_tensor(path, one) for one in graph.get(5, ()))
    inputs, outputs = list(file.inputs.items()), list(file.outputs)
    nodes = [
        _node(path, gather_fields(one), number, constants) for number, one in enumerate(graph[1], 1)
    ]
    if len(inputs) != len(outputs):
        problem = diagnose("states-unpaired", inputs=len(inputs), outputs=len(outputs))
        raise ModelError(path, problem)
    memory = []
    for (name, dims), following in zip(inputs[1:], outputs[1:], strict=True):
        if not dims or max(dims[:-1], default=1) > 1:
            raise ModelError(path, diagnose("layer-sizes", layer=name, sizes=str(dims)))
        memory.append((name, following, dims[-1]))
    size = inputs[0][1][-1] if inputs[0][1] else 0
    used = {name for node in nodes for name in node.inputs}
    kept = {name: value for name, value in constants.items() if name in used}
    return assemble_network(path, nodes, kept, (inputs[0][0], outputs[0]), memory, size)


def _node(path: Path, node: ProtobufMessage, number: int, constants: dict[str, Array]) -> Node:
    kind = get_text(node, 4)
    name = get_text(node, 3) or f"layer {number} ({kind})"
    inputs = tuple(get_text(node, 1, index) for index in range(len(node.get(1, ()))))
    outputs = tuple(get_text(node, 2, index) for index in range(len(node[2])))
    given: dict[str, Any] = {}
    for one in node.get(5, ()):
        attribute = gather_fields(one)
        key = get_text(attribute, 1)
        if 5 in attribute:
            given[key] = _tensor(path, attribute[5][0])[1]
        elif 3 in attribute:
            given[key] = decode_integers(attribute[3])[0]
        elif 8 in attribute:
            given[key] = decode_integers(attribute[8])
        elif 2 in attribute:
            given[key] = struct.unpack("<f", bytes(attribute[2][0]))[0]
        elif 4 in attribute:
            given[key] = get_text(attribute, 4)
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


_ARRAYS = {"dense": 2, "time-distributed-dense": 2, "gru": 3, "lstm": 3}
"""How many arrays of weights a layer has."""


def read_rtneural(path: Path) -> dict[str, Any]:
    """Returns what RTNeural's JSON holds.

    Raises:
        ModelError: If it cannot be read, or has no list of layers.
    """
    try:
        values = orjson.loads(read_input(path, MAX_FILE_BYTES))
    except InputError as error:
        raise make_input_error(path, error) from error
    except orjson.JSONDecodeError as error:
        message = diagnose("contract-no-json", problem=error.msg)
        raise make_file_error(Place(path, error.lineno), message) from error
    if not isinstance(values, dict) or not isinstance(values.get("layers"), list):
        raise ModelError(path, diagnose("contract-no-rtneural"))
    return values


def build_rtneural_network(path: Path, values: Mapping[str, Any]) -> Network:
    """Returns the network of an RTNeural JSON.

    Args:
        path: The file, for messages.
        values: Its content.

    Raises:
        ModelError: If a layer is of another kind, or sizes do not fit; it names the layer.
    """
    layers = values["layers"]
    if not layers:
        raise ModelError(path, diagnose("no-network"))
    nodes: list[Node] = []
    constants: dict[str, Array] = {}
    memory: list[tuple[str, str, int]] = []
    last = "observation"
    inputs = 0
    for number, layer in enumerate(layers, 1):
        kind = _word_of(path, f"layer {number}", layer, "type", (*_ARRAYS, "activation"))
        name = f"layer {number} ({kind})"
        after = f"value {number}"
        if kind in _ARRAYS:
            arrays = _weights(path, name, layer, _ARRAYS[kind])
            if not inputs:
                inputs = len(arrays[0])
            named = tuple(f"{name}, weights {index}" for index in range(1, len(arrays) + 1))
            constants |= dict(zip(named, arrays, strict=True))
            if kind == "lstm":
                size, state = len(arrays[1]), (f"{name} h", f"{name} c")
                ahead = (after, f"{name} c next")
                nodes.append(Node(name, lstm, (last, *state, *named), ahead))
                memory += zip(state, ahead, (size, size), strict=True)
            elif kind == "gru":
                nodes.append(Node(name, gru, (last, f"{name} h", *named), (after,)))
                memory.append((f"{name} h", after, len(arrays[1])))
            else:
                nodes.append(Node(name, dense, (last, *named), (after,)))
            last = after
        activation = _word_of(path, name, layer, "activation", ACTIVATIONS, usual="linear")
        if kind not in ("gru", "lstm") and activation != "linear":  # theirs are inside
            shaped = f"{after} {activation}"
            nodes.append(Node(name, ACTIVATIONS[activation], (last,), (shaped,)))
            last = shaped
    with refuse_malformed(path):
        return assemble_network(path, nodes, constants, ("observation", last), memory, inputs)


def _word_of(
    path: Path, name: str, layer: object, key: str, known: Collection[str], usual: str = ""
) -> str:
    """Return the word that a layer has for a key.

    Args:
        path: The file, for messages.
        name: The layer's name, for messages.
        layer: The layer as it was read.
        key: The key.
        known: The valid words.
        usual: The word of a layer that states none: no such key, null, or an empty text.

    Raises:
        ModelError: If the layer is not an object, or the value is not one of the words.
    """
    value = layer.get(key) if isinstance(layer, dict) else layer
    if isinstance(layer, dict) and usual and (value is None or value == ""):
        return usual
    if isinstance(layer, dict) and isinstance(value, str) and value in known:
        return value
    shown = f" ({value})" if isinstance(value, str) else f" ({reprlib.repr(value)})"
    shown = f": {value}" if usual and isinstance(value, str) else shown
    raise ModelError(path, diagnose("layer-unknown", layer=f"{name}{shown}", known=tuple(known)))


def _weights(path: Path, name: str, layer: dict[str, Any], count: int) -> list[Array]:
    """Returns the arrays of a layer; biases are vectors, or two of them for a GRU."""
    given = layer.get("weights")
    problem = ModelError(path, diagnose("layer-weights", layer=name, count=count))
    if not isinstance(given, list) or len(given) != count:
        raise problem
    try:
        read = [np.array(one) for one in given]
        arrays = [one.astype(np.float64) for one in read]
    except (ValueError, TypeError, OverflowError) as error:
        raise problem from error
    # NumPy makes numbers of texts and truth values. An array with null is one of objects.
    if any(one.dtype.kind not in "iufO" for one in read if one.size):
        raise problem
    fits = all(one.ndim == 2 for one in arrays[:-1])
    if not fits or arrays[-1].ndim not in (1, 2) or sum(one.size for one in arrays) > MAX_WEIGHTS:
        raise problem
    return arrays


TORCHSCRIPT_SUFFIXES = (".pt", ".pth", ".jit", ".ts")
"""How files of TorchScript are called."""

_MOST_BYTES = 4 * MAX_WEIGHTS
"""Of a file of TorchScript: as many weights in single precision as any network may have."""


def build_torchscript_network(path: Path) -> Network:
    """Returns the network of a TorchScript file.

    Raises:
        MissingPackageError: If torch is not installed.
        ModelError: If it is none, or keeps a state of its own from one observation to the next.
    """
    try:
        data = read_input(path, _MOST_BYTES)
    except InputError as error:
        raise ModelError(error.path, error.cause) from error
    try:
        torch = import_module("torch")
    except ImportError as error:
        raise MissingPackageError("torch", "torch") from error
    try:
        with warnings.catch_warnings():  # torch has had successors of this format since 2.9
            warnings.simplefilter("ignore")
            module = torch.jit.load(io.BytesIO(data), map_location="cpu").eval()
    except Exception as error:  # torch's reader raises whatever its C++ throws
        raise ModelError(path, diagnose("no-network")) from error
    weights = dict(module.named_parameters())
    count = sum(int(one.numel()) for one in weights.values())
    if count > MAX_WEIGHTS:
        problem = diagnose("too-many-weights", layer="", count=count, most=MAX_WEIGHTS)
        raise ModelError(path, problem)
    first = next((one for one in weights.values() if one.ndim == 2), None)
    if first is None:
        raise ModelError(path, diagnose("no-network"))
    kind, size = first.dtype, int(first.shape[1])

    def apply(value: Array) -> Any:
        with torch.no_grad():
            try:
                made = [module(torch.tensor(row, dtype=kind)).double().numpy() for row in value]
            except (RuntimeError, AttributeError) as error:  # sizes; a tuple where one is due
                raise ValueError(str(error)) from error
        return np.stack(made)

    constants = {name: one.detach().double().numpy() for name, one in weights.items()}
    node = Node("TorchScript", apply, ("observation",), ("action",))
    network = assemble_network(path, [node], constants, ("observation", "action"), [], size)
    zeros, ones = np.zeros((1, size)), np.ones((1, size))
    before = network.forward(zeros)[0]
    network.forward(ones)
    if not np.array_equal(before, network.forward(zeros)[0], equal_nan=True):
        raise ModelError(path, diagnose("network-keeps-state"))
    return network
