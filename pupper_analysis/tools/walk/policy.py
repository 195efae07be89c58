"""Policy files: networks in ONNX, RTNeural's JSON and TorchScript, with contracts.

`Policy.load` reads a network, which maps observations of several runs to actions, and the contract
that the files state. ONNX files are decoded without another package; TorchScript requires torch.
"""

from __future__ import annotations

import io
import re
import reprlib
import struct
import threading
import warnings
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from importlib import import_module
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
import orjson

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.errors import (
    ConfigurationError,
    InputError,
    MissingPackageError,
    ModelError,
)
from pupper_analysis.base.inputs import MAX_FILE_BYTES, is_input, read_input, read_toml
from pupper_analysis.models.places import Place, make_file_error, make_input_error
from pupper_analysis.tools.contract.deployment import SOURCE_SUFFIXES, Deployment
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
from pupper_analysis.tools.contract.readers.onnx import ProtobufMessage, list_action_outputs
from pupper_analysis.tools.walk.contract import (
    PolicyContract,
    Statements,
    convert_deployment,
    convert_source_statements,
    make_contract,
    make_rtneural_values,
)
from pupper_analysis.tools.walk.network import (
    ACTIVATIONS,
    MAX_VALUE_SIZE,
    MAX_WEIGHTS,
    Network,
    NetworkOperation,
    assemble_network,
    dense,
    gru,
    lstm,
)
from pupper_analysis.tools.walk.operators import (
    CONSTANT_OPERATION_MAKERS,
    IDENTITY_OPERATORS,
    OPERATION_MAKERS,
    skip_missing_inputs,
)


@dataclass(frozen=True, eq=False)
class Policy:
    """Walking policy: network, and contract (meaning of observations and actions).

    Attributes:
        name: File name.
        network: Network that maps observations to actions.
        contract: Observation of the policy, and meaning of the actions.
        files: Files that were read: policy, files of weights, definitions of the contract.
        notes: Assumptions about a deployment, and disagreements between the deployment's files.
    """

    name: str
    network: Network
    contract: PolicyContract
    files: tuple[Path, ...] = ()
    notes: tuple[Diagnostic, ...] = ()

    @classmethod
    def load(
        cls,
        path: str | Path,
        contract: str | Path | None = None,
        deployment: Deployment | None = None,
    ) -> Policy:
        """Read a walking policy (network and contract) from files.

        No code of the file is executed, except TorchScript, by torch's interpreter.

        Args:
            path: ONNX file, RTNeural's JSON, or TorchScript (requires torch).
            contract: TOML file with contract keys, which has precedence over the other files; by
                default the file of the same name with the suffix ``.toml``, if that file exists.
            deployment: Facts of a deployment (`read_deployment`), which have precedence over the
                policy file.

        Raises:
            MissingPackageError: If the policy is TorchScript and torch is not installed.
            ModelError: If a file cannot be used.
        """
        path = Path(path)
        try:
            # Not with_suffix, which fails for the path ".".
            toml_path = Path(contract or path.parent / f"{path.stem}.toml")
            has_toml = contract is not None or is_input(toml_path)
            text, toml = read_toml(toml_path) if has_toml else ("", dict[str, Any]())
        except InputError as error:
            raise ModelError(error.path, error.cause) from error
        network, statements = read_statements(path, deployment)
        files = [path, *network.files, *(() if deployment is None else deployment.files)]
        if has_toml:
            lines = {key: _find_toml_line(text, key) for key in toml}
            places = {key: f"{toml_path}:{line}" for key, line in lines.items() if line}
            statements.append(Statements(str(toml_path), toml, places))
            files.append(toml_path)
        merged = make_contract(path, statements, network.inputs, network.outputs)
        notes = () if deployment is None else deployment.notes
        return cls(path.name, network, merged, tuple(dict.fromkeys(files)), notes)

    def with_contract(self, **changed: Any) -> Policy:
        """Return a copy of the policy with changed fields of the `PolicyContract`."""
        return replace(self, contract=replace(self.contract, **changed))


def split_sources(words: Sequence[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Separate the words of a command line into words that name a robot, and files of a policy.

    Files of a policy, deployment or trainer are recognised by the suffix, also in ``FILE:NAME``,
    which selects a configuration.

    Returns:
        Words that name a robot; the other words.
    """
    suffixes = (*SOURCE_SUFFIXES, ".onnx", ".json", *TORCHSCRIPT_SUFFIXES)
    is_source = [Path(word.rpartition(":")[0] or word).suffix in suffixes or
                 Path(word).suffix in suffixes for word in words]  # fmt: skip
    pairs = list(zip(words, is_source, strict=True))
    robots, sources = ([word for word, flag in pairs if flag is side] for side in (False, True))
    return tuple(robots), tuple(sources)


def select_policy(policy: Path | None, sources: Sequence[str]) -> tuple[Path, tuple[str, ...]]:
    """Select the policy among the typed files; return the policy file and the other sources.

    If no file is typed as the policy, ONNX files near the first source are considered.

    Args:
        policy: File of the option ``--policy``; None without.
        sources: Files of a policy, deployment or trainer.

    Raises:
        ConfigurationError: If there are several policies, or no policy.
    """
    policies = [Path(word) for word in sources if Path(word).suffix not in SOURCE_SUFFIXES
                and ":" not in Path(word).name]  # fmt: skip
    policies += [] if policy is None else [policy]
    others = tuple(word for word in sources if Path(word) not in policies)
    if not policies and others:
        folder = Path(others[0].rpartition(":")[0] or others[0]).parent
        folders = (folder, folder.parent / "exported")
        policies = sorted({path for part in folders for path in part.glob("*.onnx")})
    if len(policies) != 1:
        names = tuple(map(str, policies))
        problem = diagnose("one-policy-needed", names=names, example=None)
        raise ConfigurationError("policy", problem)
    return policies[0], others


def read_statements(
    path: Path, deployment: Deployment | None = None
) -> tuple[Network, list[Statements]]:
    """Read the network of a policy, and the contract keys that the files state.

    Returns:
        Network; contract keys and values of the policy file and, if any, of the deployment.

    Raises:
        MissingPackageError: If the policy is TorchScript and torch is not installed.
        ModelError: If the policy cannot be read.
    """
    network, values = _read_policy(path)
    statements = [Statements(str(path), values)]
    if deployment is not None:
        statements.append(convert_deployment(deployment, network.inputs, network.outputs))
    return network, statements


def _find_toml_line(text: str, key: str) -> int:
    """Return the number, from 1, of the line that states a key of a flat TOML file, or 0."""
    match = re.search(rf"^[ \t]*[\"']?{re.escape(key)}[\"']?[ \t]*=", text, re.MULTILINE)
    return 0 if match is None else text.count("\n", 0, match.end()) + 1


@contextmanager
def refuse_malformed(path: Path) -> Iterator[None]:
    """Context manager that converts Python errors of a malformed policy file into a ModelError.

    Therefore such a file is not reported as a defect of the package.

    Raises:
        ModelError: If the block raises a Python error that a malformed file may cause, such as
            ValueError.
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
    """Return the network of a policy file, and {contract key: value} that the file states."""
    with refuse_malformed(path):
        if path.suffix == ".json":
            values = read_rtneural(path)
            network, sources = build_rtneural_network(path, values), [*tables.read(Request(path))]
            contract_values = make_rtneural_values(values, network.inputs, network.outputs)
        elif path.suffix in TORCHSCRIPT_SUFFIXES:  # states no contract key
            network, sources, contract_values = build_torchscript_network(path), [], {}
        else:
            network, sources, contract_values = (
                build_onnx_network(path, read_onnx(path)),
                [*onnx.read(Request(path))],
                {},
            )
        for source in sources:
            contract_values = convert_source_statements(source) | contract_values
    return network, contract_values


_NUMPY_TYPES = {1: "<f4", 6: "<i4", 7: "<i8", 10: "<f2", 11: "<f8"}
"""{data type of an ONNX tensor (TensorProto.DataType): NumPy type of the raw bytes}. Tensors of
other types are refused.
"""

_FLOAT16 = 10
"""TensorProto data type of half precision. Numbers that are not stored as raw bytes are stored as
integers with the same 16 bits (onnx.proto3, ``int32_data``).
"""

_FIELD_OF_TYPE = {1: 4, 6: 5, 7: 7, 11: 10}
"""{data type of an ONNX tensor: number of the TensorProto field with the values}. The field
contains values that are not stored as raw bytes (onnx.proto3).
"""


_EXTERNAL_DATA_FIELD, _DATA_LOCATION_FIELD = 13, 14
"""TensorProto field numbers for weights in another file (onnx.proto3). The first field contains the
entries ``location``, ``offset`` and ``length``. The second field is 1 if the weights are in another
file.
"""


class _WeightFiles:
    """Files below the folder of an ONNX file that contain weights; each file is read once.

    Args:
        path: ONNX file.
    """

    def __init__(self, path: Path) -> None:
        self._path, self._contents = path, dict[Path, memoryview]()

    @property
    def files(self) -> tuple[Path, ...]:
        """Files that were read."""
        return tuple(self._contents)

    def read_weights(self, tensor: ProtobufMessage, layer: str) -> memoryview:
        """Return the bytes of a tensor's weights in another file.

        Raises:
            ModelError: If the file is missing or too short, for example.
            ValueError: If ``offset`` or ``length`` is not a whole number.
        """
        entries = [gather_fields(entry) for entry in tensor.get(_EXTERNAL_DATA_FIELD, ())]
        stated = {get_text(entry, 1): get_text(entry, 2) for entry in entries}
        location, offset = stated.get("location", ""), int(stated.get("offset") or 0)
        name = PurePosixPath(location)
        if not location or name.is_absolute() or ".." in name.parts or offset < 0:
            raise ModelError(
                self._path, diagnose("weights-outside", layer=layer, location=location)
            )
        file = self._path.parent / name
        if file not in self._contents:
            if not is_input(file):
                problem = diagnose("weights-file-missing", layer=layer, location=location)
                raise ModelError(self._path, problem)
            try:
                self._contents[file] = memoryview(read_input(file, MAX_FILE_BYTES))
            except InputError as error:
                raise make_input_error(file, error) from error
        content = self._contents[file]
        length = int(stated.get("length") or max(0, len(content) - offset))
        if length < 0 or offset + length > len(content):
            problem = diagnose(
                "weights-file-short", layer=layer, needed=offset + length, found=len(content)
            )
            raise ModelError(file, problem)
        return content[offset : offset + length]


def _read_tensor(
    path: Path, data: int | memoryview, weight_files: _WeightFiles | None = None
) -> tuple[str, Array]:
    """Return the name and the numbers of an ONNX tensor (protobuf message), shape as stated."""
    tensor = gather_fields(data)
    name, dims = get_text(tensor, 8), decode_integers(tensor.get(1, ()))
    kind = tensor.get(2, [0])[0]
    count = 1
    for dim in dims:
        count *= dim
    if count > MAX_WEIGHTS or any(dim < 0 for dim in dims):
        problem = diagnose("too-many-weights", layer=name, count=count, most=MAX_WEIGHTS)
        raise ModelError(path, problem)
    if kind not in _NUMPY_TYPES:
        raise ModelError(path, diagnose("weights-of-no-type", layer=name))
    is_external = bool(tensor.get(_DATA_LOCATION_FIELD, [0])[0])
    if is_external or 9 in tensor:
        raw = bytes(
            (weight_files or _WeightFiles(path)).read_weights(tensor, name)
            if is_external
            else tensor[9][0]
        )
        size = np.dtype(_NUMPY_TYPES[kind]).itemsize
        numbers = np.frombuffer(raw[: len(raw) // size * size], dtype=_NUMPY_TYPES[kind])
    elif kind in (1, 11):
        form = "<f4" if kind == 1 else "<f8"
        numbers = np.frombuffer(
            b"".join(map(bytes, tensor.get(_FIELD_OF_TYPE[kind], ()))), dtype=form
        )
    else:
        numbers = np.array(decode_integers(tensor.get(_FIELD_OF_TYPE.get(kind, 5), ())))
        if kind == _FLOAT16:
            numbers = numbers.astype("<u2").view("<f2")
    if numbers.size != count:
        problem = diagnose("layer-sizes", layer=name, sizes=f"{dims}, {numbers.size}")
        raise ModelError(path, problem)
    return name, numbers.reshape(dims).astype(np.float64)


def build_onnx_network(path: Path, file: OnnxFile) -> Network:
    """Build the network of an ONNX file. Weights may be in files below the folder of the file.

    Raises:
        ModelError: If the file contains no network or an operator that is not supported, for
            example.
    """
    weight_files = _WeightFiles(path)
    with refuse_malformed(path):
        network = _build_onnx_network(path, file, weight_files)
        return replace(network, files=weight_files.files)


def _build_onnx_network(path: Path, file: OnnxFile, weight_files: _WeightFiles) -> Network:
    """Build the network of an ONNX graph: observation and states to action and states."""
    graph = file.graph
    constants = dict(_read_tensor(path, message, weight_files) for message in graph.get(5, ()))
    inputs, outputs = list(file.inputs.items()), list_action_outputs(file)
    nodes = [
        _build_node(path, gather_fields(message), number, constants, weight_files)
        for number, message in enumerate(graph[1], 1)
    ]
    if len(inputs) != len(outputs):
        problem = diagnose("states-unpaired", inputs=len(inputs), outputs=len(outputs))
        raise ModelError(path, problem)
    memory = []
    for (name, dims), next_name in zip(inputs[1:], outputs[1:], strict=True):
        if not dims or max(dims[:-1], default=1) > 1:
            raise ModelError(path, diagnose("layer-sizes", layer=name, sizes=str(dims)))
        memory.append((name, next_name, dims[-1]))
    size = inputs[0][1][-1] if inputs[0][1] else 0
    used = {name for node in nodes for name in node.inputs}
    used_constants = {name: value for name, value in constants.items() if name in used}
    return assemble_network(path, nodes, used_constants, (inputs[0][0], outputs[0]), memory, size)


_CONSTANT_ATTRIBUTES = ("value", "value_float", "value_int", "value_floats", "value_ints")
"""Attributes of an ONNX node ``Constant`` that contain the value."""


def _build_node(
    path: Path,
    node: ProtobufMessage,
    number: int,
    constants: dict[str, Array],
    weight_files: _WeightFiles,
) -> NetworkOperation:
    """Return a node of an ONNX graph as an operation with named inputs and outputs.

    The value of a Constant is added to ``constants``. ``number`` names a node without a name.
    """
    kind = get_text(node, 4)
    name = get_text(node, 3) or f"layer {number} ({kind})"
    inputs = tuple(get_text(node, 1, index) for index in range(len(node.get(1, ()))))
    outputs = tuple(get_text(node, 2, index) for index in range(len(node[2])))
    attributes: dict[str, Any] = {}
    for message in node.get(5, ()):
        attribute = gather_fields(message)
        key = get_text(attribute, 1)
        if 5 in attribute:
            attributes[key] = _read_tensor(path, attribute[5][0], weight_files)[1]
        elif 3 in attribute:
            attributes[key] = decode_integers(attribute[3])[0]
        elif 8 in attribute:
            attributes[key] = decode_integers(attribute[8])
        elif 7 in attribute:
            numbers = b"".join(bytes(part) for part in attribute[7] if not isinstance(part, int))
            attributes[key] = np.frombuffer(numbers, dtype="<f4").astype(np.float64)
        elif 2 in attribute:
            attributes[key] = struct.unpack("<f", bytes(attribute[2][0]))[0]
        elif 4 in attribute:
            attributes[key] = get_text(attribute, 4)
    value = next((attributes[key] for key in _CONSTANT_ATTRIBUTES if key in attributes), None)
    if kind == "Constant" and value is not None:
        constants[outputs[0]] = np.asarray(value, dtype=np.float64)
        return NetworkOperation(name, lambda value: value, (outputs[0],), outputs)
    is_constant = all(message in constants for message in inputs if message)
    make_constant = CONSTANT_OPERATION_MAKERS.get(kind) if is_constant else None
    make_operation = make_constant or OPERATION_MAKERS.get(kind)
    operation = None if make_operation is None else make_operation(attributes, len(outputs))
    if operation is None:
        problem = diagnose("layer-unknown", layer=f"{name}: {kind}", known=sorted(OPERATION_MAKERS))
        raise ModelError(path, problem)
    if kind in IDENTITY_OPERATORS and make_constant is None:
        inputs, outputs = inputs[:1], outputs[:1]
    elif kind in ("GRU", "LSTM"):  # the fifth input is the lengths of sequences
        inputs = tuple(message for index, message in enumerate(inputs) if index != 4)
    else:
        operation = skip_missing_inputs(operation, inputs)
        inputs = tuple(filter(None, inputs))
    built = NetworkOperation(name, operation, inputs, outputs)
    return _fold_constants(built, constants) if is_constant else built


def _fold_constants(built: NetworkOperation, constants: dict[str, Array]) -> NetworkOperation:
    """Evaluate an operation of constants, and add the results to ``constants``, in place.

    Returns an operation that returns the results. An operation that fails, or whose result is too
    large or not finite, is returned unchanged: `assemble_network` refuses the first two.
    """
    values = [constants[name] for name in built.inputs]
    try:
        with np.errstate(all="ignore"):
            results = built.apply(*values)
    except (ValueError, IndexError, TypeError):
        return built
    results = results if isinstance(results, tuple) else (results,)
    largest = max([MAX_VALUE_SIZE, *(value.size for value in values)])
    if any(np.size(result) > largest or not np.isfinite(result).all() for result in results):
        return built
    constants |= {
        name: np.asarray(result, dtype=np.float64)
        for name, result in zip(built.outputs, results, strict=False)
    }
    outputs = built.outputs[: len(results)]
    return NetworkOperation(built.name, lambda *values: values, outputs, outputs)


_NUM_WEIGHT_ARRAYS = {"dense": 2, "time-distributed-dense": 2, "gru": 3, "lstm": 3}
"""Number of weight arrays of each supported RTNeural layer type, except activations."""


def read_rtneural(path: Path) -> dict[str, Any]:
    """Return the content of a network in RTNeural's JSON as {key: value}, with a list of layers.

    Raises:
        ModelError: If the file cannot be read, or contains no list of layers.
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
    """Build the network of an RTNeural JSON with the content ``values``.

    Raises:
        ModelError: If a layer has an unknown type or unsuitable weights, for example.
    """
    layers = values["layers"]
    if not layers:
        raise ModelError(path, diagnose("no-network"))
    nodes: list[NetworkOperation] = []
    constants: dict[str, Array] = {}
    memory: list[tuple[str, str, int]] = []
    value_name = "observation"
    inputs = 0
    for number, layer in enumerate(layers, 1):
        kind = _read_word(
            path, f"layer {number}", layer, "type", (*_NUM_WEIGHT_ARRAYS, "activation")
        )
        name = f"layer {number} ({kind})"
        output_name = f"value {number}"
        if kind in _NUM_WEIGHT_ARRAYS:
            arrays = _read_weights(path, name, layer, _NUM_WEIGHT_ARRAYS[kind])
            if not inputs:
                inputs = len(arrays[0])
            weight_names = tuple(f"{name}, weights {index}" for index in range(1, len(arrays) + 1))
            constants |= dict(zip(weight_names, arrays, strict=True))
            if kind == "lstm":
                size, state = len(arrays[1]), (f"{name} h", f"{name} c")
                next_states = (output_name, f"{name} c next")
                nodes.append(
                    NetworkOperation(name, lstm, (value_name, *state, *weight_names), next_states)
                )
                memory += zip(state, next_states, (size, size), strict=True)
            elif kind == "gru":
                nodes.append(
                    NetworkOperation(
                        name, gru, (value_name, f"{name} h", *weight_names), (output_name,)
                    )
                )
                memory.append((f"{name} h", output_name, len(arrays[1])))
            else:
                nodes.append(
                    NetworkOperation(name, dense, (value_name, *weight_names), (output_name,))
                )
            value_name = output_name
        activation = _read_word(path, name, layer, "activation", ACTIVATIONS, default="linear")
        if (
            kind not in ("gru", "lstm") and activation != "linear"
        ):  # recurrent layers contain theirs
            activated = f"{output_name} {activation}"
            nodes.append(
                NetworkOperation(name, ACTIVATIONS[activation], (value_name,), (activated,))
            )
            value_name = activated
    with refuse_malformed(path):
        return assemble_network(path, nodes, constants, ("observation", value_name), memory, inputs)


def _read_word(
    path: Path, name: str, layer: object, key: str, valid_words: Collection[str], default: str = ""
) -> str:
    """Return the text that a layer of a policy file states for a key, such as an activation.

    ``default`` is the word for a missing key; "" if the key is required.
    """
    value = layer.get(key) if isinstance(layer, dict) else layer
    if isinstance(layer, dict) and default and (value is None or value == ""):
        return default
    if isinstance(layer, dict) and isinstance(value, str) and value in valid_words:
        return value
    shown = f" ({value})" if isinstance(value, str) else f" ({reprlib.repr(value)})"
    shown = f": {value}" if default and isinstance(value, str) else shown
    raise ModelError(
        path, diagnose("layer-unknown", layer=f"{name}{shown}", known=tuple(valid_words))
    )


def _read_weights(path: Path, name: str, layer: dict[str, Any], count: int) -> list[Array]:
    """Return the ``count`` weight arrays of a layer: matrices, and at last the biases."""
    stated = layer.get("weights")
    problem = ModelError(path, diagnose("layer-weights", layer=name, count=count))
    if not isinstance(stated, list) or len(stated) != count:
        raise problem
    try:
        raw_arrays = [np.array(array) for array in stated]
        arrays = [array.astype(np.float64) for array in raw_arrays]
    except (ValueError, TypeError, OverflowError) as error:
        raise problem from error
    # NumPy converts texts and truth values to numbers. An array with null has the type object.
    if any(array.dtype.kind not in "iufO" for array in raw_arrays if array.size):
        raise problem
    fits = all(array.ndim == 2 for array in arrays[:-1])
    if (
        not fits
        or arrays[-1].ndim not in (1, 2)
        or sum(array.size for array in arrays) > MAX_WEIGHTS
    ):
        raise problem
    return arrays


TORCHSCRIPT_SUFFIXES = (".pt", ".pth", ".jit", ".ts")
"""File name suffixes of TorchScript."""

_MAX_TORCHSCRIPT_BYTES = 4 * MAX_WEIGHTS
"""Maximum size of a TorchScript file [bytes], derived from `MAX_WEIGHTS` in single precision.
Larger files are refused."""


def _list_tensor_attributes(module: Any) -> list[str]:
    """List the buffers and tensor attributes of a TorchScript module by path, without parameters.

    TorchScript lists only buffers by itself; attributes are found in the graph of ``forward``.
    """

    def find_path(value: Any) -> str:
        """Return the path of the submodule that is a value of the graph; empty for the module."""
        node = value.node()
        if node.kind() != "prim::GetAttr":
            return ""
        return f"{find_path(node.inputsAt(0))}{node.s('name')}."

    parameters = {name for name, _ in module.named_parameters()}
    names = {name: None for name, _ in module.named_buffers()}  # in order, each once
    graph = module.inlined_graph  # a node is valid as long as its graph
    for kind in ("prim::GetAttr", "prim::SetAttr"):
        for node in graph.findAllNodes(kind, True):
            tensor = node.output() if kind == "prim::GetAttr" else node.inputsAt(1)
            if tensor.type().kind() == "TensorType":
                names[find_path(node.inputsAt(0)) + node.s("name")] = None
    return [name for name in names if name not in parameters]


class _ScriptedModule:
    """TorchScript module whose states (for example of an LSTM) are set before each evaluation.

    Args:
        torch: Module ``torch``.
        module: TorchScript module.
        kind: Type of the numbers.
    """

    def __init__(self, torch: Any, module: Any, kind: Any) -> None:
        self._torch, self._module, self._kind = torch, module, kind
        owners = dict(module.named_modules())
        self._tensors = {
            name: (owners[name.rpartition(".")[0]], name.rpartition(".")[2])
            for name in _list_tensor_attributes(module)
        }
        self._start = {name: self._read_tensor(name).clone() for name in self._tensors}
        self._lock = threading.Lock()  # threads share the states of the module

    def _read_tensor(self, name: str) -> Any:
        """Return the present value of a tensor of the module."""
        owner, attribute = self._tensors[name]
        return getattr(owner, attribute)

    def _write_tensor(self, name: str, value: Any) -> None:
        """Replace the value of a tensor of the module."""
        owner, attribute = self._tensors[name]
        setattr(owner, attribute, value)

    def list_state_sizes(self) -> tuple[int, ...]:
        """Return the last dimension of each non-scalar tensor that is initially zero.

        These are candidates for the size of an observation: if a network stores previous
        observations, no dimension of the weights is the size of one observation.
        """
        return tuple(
            int(start.shape[-1]) for start in self._start.values() if start.ndim and not start.any()
        )

    def find_states(self, size: int) -> dict[str, int]:
        """Find the recurrent states of the module: {tensor: number of elements}.

        A state is a tensor that starts with zeros, is no parameter, and changes in an evaluation of
        an observation with ``size`` elements.

        Raises:
            ValueError: If the module cannot be evaluated for this size.
        """
        for name, start in self._start.items():  # a previous size may have changed some of them
            self._write_tensor(name, start.clone())
        self.evaluate({}, np.ones((1, 1, size)))
        return {
            name: int(start.numel())
            for name, start in self._start.items()
            if not start.any() and not self._torch.equal(self._read_tensor(name), start)
        }

    def evaluate(self, states: Mapping[str, int], value: Array, *values: Array) -> Any:
        """Return the actions of several runs, shape (runs, 1, outputs).

        With states, return a tuple of the actions and of the next values of each state.

        Args:
            states: {state: number of elements}.
            value: Observations, shape (runs, 1, n).
            *values: States, shape (runs, 1, number of elements) each.

        Raises:
            ValueError: If the module cannot be evaluated.
        """
        torch, actions = self._torch, []
        following: list[list[Array]] = [[] for _ in states]
        with torch.no_grad(), self._lock:
            for run, row in enumerate(value):
                for name, state in zip(states, values, strict=True):
                    start = self._start[name]
                    state_of_run = torch.tensor(state[run], dtype=start.dtype)
                    self._write_tensor(name, state_of_run.reshape(start.shape))
                try:
                    action = self._module(torch.tensor(row, dtype=self._kind))
                    actions.append(action.double().numpy())
                except Exception as error:  # torch's interpreter raises whatever its C++ throws
                    raise ValueError(str(error)) from error
                for name, rows in zip(states, following, strict=True):
                    rows.append(self._read_tensor(name).double().numpy().reshape(1, -1).copy())
        return (np.stack(actions), *map(np.stack, following)) if states else np.stack(actions)


def build_torchscript_network(path: Path) -> Network:
    """Build the network of a TorchScript file, evaluated by torch.

    Raises:
        MissingPackageError: If torch is not installed.
        ModelError: If the file cannot be read, or the network cannot be evaluated, for example.
    """
    torch, module = _load_torchscript(path)
    weights = dict(module.named_parameters())
    count = sum(int(weights_of_layer.numel()) for weights_of_layer in weights.values())
    if count > MAX_WEIGHTS:
        problem = diagnose("too-many-weights", layer="", count=count, most=MAX_WEIGHTS)
        raise ModelError(path, problem)
    matrices = [matrix for matrix in weights.values() if matrix.ndim == 2]
    if not matrices:
        raise ModelError(path, diagnose("no-network"))
    # The first layer of the file need not be the first that is evaluated. A traced LSTM accepts
    # observations of any size, so that its size is tried first.
    recurrent = [matrix for name, matrix in weights.items() if name.endswith("weight_ih_l0")]
    scripted = _ScriptedModule(torch, module, matrices[0].dtype)
    widths = [int(matrix.shape[1]) for matrix in (*recurrent, *matrices)]
    sizes = tuple(dict.fromkeys((*widths, *scripted.list_state_sizes())))
    constants = {name: matrix.detach().double().numpy() for name, matrix in weights.items()}
    problems: list[ModelError] = []
    for size in sizes:
        try:
            network = _assemble_torchscript(path, scripted, constants, size)
        except ModelError as error:  # e.g. a weight that is not finite
            problems.insert(0, error)
        except ValueError as error:
            cause = (str(error).strip().splitlines() or [""])[-1]
            problem = diagnose("torchscript-not-evaluated", sizes=sizes, cause=cause)
            problems.append(ModelError(path, problem))
        else:
            _check_memory(path, network, size)
            return network
    raise problems[0]


def _load_torchscript(path: Path) -> tuple[Any, Any]:
    """Load a TorchScript file; return the module ``torch``, and the network in evaluation mode."""
    try:
        data = read_input(path, _MAX_TORCHSCRIPT_BYTES)
    except InputError as error:
        raise ModelError(error.path, error.cause) from error
    try:
        torch = import_module("torch")
    except ImportError as error:
        raise MissingPackageError("torch", "torch") from error
    try:
        with warnings.catch_warnings():  # torch has had successors of this format since 2.9
            warnings.simplefilter("ignore")
            return torch, torch.jit.load(io.BytesIO(data), map_location="cpu").eval()
    except Exception as error:  # torch's reader raises whatever its C++ throws
        raise ModelError(path, diagnose("no-network")) from error


def _assemble_torchscript(
    path: Path, scripted: _ScriptedModule, constants: Mapping[str, Array], size: int
) -> Network:
    """Assemble the network of a scripted module for observations with ``size`` elements."""
    states = scripted.find_states(size)
    names = tuple(f"{name} next" for name in states)
    node = NetworkOperation(
        "TorchScript",
        partial(scripted.evaluate, states),
        ("observation", *states),
        ("action", *names),
    )
    memory = [
        (name, following, count)
        for (name, count), following in zip(states.items(), names, strict=True)
    ]
    return assemble_network(path, [node], constants, ("observation", "action"), memory, size)


def _check_memory(path: Path, network: Network, size: int) -> None:
    """Check that a network keeps no state besides its memory, else raise a ModelError."""
    zeros, ones = np.zeros((1, size)), np.ones((1, size))
    start = network.initial_memory(1)
    before = network.forward(zeros, start)[0]
    network.forward(ones, start)
    if not np.array_equal(before, network.forward(zeros, start)[0], equal_nan=True):
        raise ModelError(path, diagnose("network-keeps-state"))
