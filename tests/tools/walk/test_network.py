"""Networks of policies, compared with plain loops and with onnxruntime."""

from __future__ import annotations

import itertools
import math
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pupper_analysis.base.errors import MissingPackageError, ModelError
from pupper_analysis.tools.contract.readers import read_onnx
from pupper_analysis.tools.walk import policy
from pupper_analysis.tools.walk.network import (
    ACTIVATIONS,
    Network,
    NetworkOperation,
    assemble_network,
    gru,
)
from pupper_analysis.tools.walk.operators import OPERATION_MAKERS
from pupper_analysis.tools.walk.policy import Policy
from tests.tools.walk import made

ALIKE = 1e-6

BY_LOOPS: dict[str, Callable[[float], float]] = {
    "linear": lambda x: x,
    "relu": lambda x: max(x, 0.0),
    "elu": lambda x: x if x > 0 else math.exp(x) - 1,
    "tanh": math.tanh,
    "sigmoid": lambda x: 1 / (1 + math.exp(-x)),
    "swish": lambda x: x / (1 + math.exp(-x)),
}


def product(row: Any, matrix: Any, bias: Any) -> list[float]:
    return [sum(row[k] * matrix[k][j] for k in range(len(row))) + bias[j] for j in range(len(bias))]


def rows(count: int, size: int, seed: int = 0) -> Any:
    return np.random.default_rng(seed).normal(size=(count, size))


def read(layers: list[dict[str, Any]]) -> Network:
    return policy.build_rtneural_network(Path("made.json"), {"layers": layers})


@pytest.mark.parametrize("activation", BY_LOOPS)
def test_dense_layers_equal_plain_loops(activation: str) -> None:
    draw = np.random.default_rng(1)
    sizes, layers = (7, 9, 4), []
    for first, second in itertools.pairwise(sizes):
        weights = [draw.normal(size=(first, second)).tolist(), draw.normal(size=second).tolist()]
        layers.append({"type": "dense", "activation": activation, "weights": weights})
    network, given = read(layers), rows(5, 7)
    found, _ = network.forward(given)
    for row, out in zip(given, found, strict=True):
        for layer in layers:
            row = [BY_LOOPS[activation](x) for x in product(row, *layer["weights"])]
        assert out == pytest.approx(row, abs=ALIKE)


def test_each_activation_has_a_reference_function() -> None:
    assert set(ACTIVATIONS) == set(BY_LOOPS)


@pytest.mark.parametrize("after", [True, False])
def test_gru_equals_plain_loops(after: bool) -> None:
    """Gates z, r and the candidate; the reset acts after the state's product, or on the state."""
    draw, n, u = np.random.default_rng(2), 3, 4
    given, own = draw.normal(size=(n, 3 * u)), draw.normal(size=(u, 3 * u))
    bias = draw.normal(size=(2, 3 * u))
    weights = [given.tolist(), own.tolist(), bias.tolist()]
    network = read([{"type": "gru", "activation": "", "weights": weights}])  # Keras': after
    hidden, memory = [0.0] * u, network.initial_memory(1)
    for row in rows(6, n):
        if after:
            found, memory = network.forward(row[None], memory)
        else:
            state = np.array([[hidden]])
            found = gru(row[None, None], state, given, own, bias, reset_after=False)[:, 0]
        first, second = product(row, given, bias[0]), product(hidden, own, bias[1])
        sig = BY_LOOPS["sigmoid"]
        z = [sig(first[k] + second[k]) for k in range(u)]
        r = [sig(first[u + k] + second[u + k]) for k in range(u)]
        kept = product([r[k] * hidden[k] for k in range(u)], own, bias[1])
        last = [r[k] * second[2 * u + k] if after else kept[2 * u + k] for k in range(u)]
        c = [math.tanh(first[2 * u + k] + last[k]) for k in range(u)]
        hidden = [(1 - z[k]) * c[k] + z[k] * hidden[k] for k in range(u)]
        assert found[0] == pytest.approx(hidden, abs=ALIKE)


def test_lstm_equals_plain_loops() -> None:
    """Reference: the gates i, f, g, o of an LSTM, written as loops over units."""
    draw, n, u = np.random.default_rng(3), 3, 4
    given, own = draw.normal(size=(n, 4 * u)), draw.normal(size=(u, 4 * u))
    bias = draw.normal(size=4 * u)
    weights = [given.tolist(), own.tolist(), bias.tolist()]
    network = read([{"type": "lstm", "activation": "", "weights": weights}])
    hidden, cell, memory = [0.0] * u, [0.0] * u, network.initial_memory(1)
    sig = BY_LOOPS["sigmoid"]
    for row in rows(6, n):
        found, memory = network.forward(row[None], memory)
        given_part, own_part = product(row, given, bias), product(hidden, own, [0] * 4 * u)
        total = [a + b for a, b in zip(given_part, own_part, strict=True)]
        for k in range(u):
            fresh = sig(total[k]) * math.tanh(total[2 * u + k])
            cell[k] = sig(total[u + k]) * cell[k] + fresh
            hidden[k] = sig(total[3 * u + k]) * math.tanh(cell[k])
        assert found[0] == pytest.approx(hidden, abs=ALIKE)


def read_graph(data: bytes, folder: Path) -> Network:
    path = folder / "made.onnx"
    path.write_bytes(data)
    return policy.build_onnx_network(path, read_onnx(path))


def made_graphs() -> dict[str, bytes]:
    draw = np.random.default_rng(5)
    sizes = ((6, 8), (8, 5))
    # As small as those that are trained: onnxruntime adds up in single precision.
    layers = [(0.3 * draw.normal(size=size), 0.3 * draw.normal(size=size[1])) for size in sizes]
    kinds = ("Relu", "Elu", "Tanh", "Sigmoid", "LeakyRelu")
    graphs = {kind: made.dense_onnx(layers, kind) for kind in kinds}
    u = 4
    for name, kind, gates in (("GRU", "GRU", 3), ("GRU before", "GRU", 3), ("LSTM", "LSTM", 4)):
        tensors = [
            made.tensor("W", draw.normal(size=(1, gates * u, 6))),
            made.tensor("R", draw.normal(size=(1, gates * u, u))),
            made.tensor("B", draw.normal(size=(1, 2 * gates * u))),
            made.tensor("V", draw.normal(size=(u, 2))),
        ]
        states = ["h", "c"][: gates - 2]
        axes = made.field(2, 7) + made.field(1, 1) + made.field(8, "axes")
        tensors += [axes + made.field(9, np.array([0], dtype="<i8").tobytes())]
        ends = ("Y", *(f"{state}n" for state in states))
        given = {"hidden_size": u} | ({"linear_before_reset": 1} if name == "GRU" else {})
        nodes = [
            made.node("Unsqueeze", ("obs", "axes"), ("x",)),
            made.node(kind, ("x", "W", "R", "B", "", *states), ends, **given),
            made.node("Squeeze", ("hn", "axes"), ("s",)),
            made.node("MatMul", ("s", "V"), ("act",)),
        ]
        inputs = [made.value("obs", 1, 6), *(made.value(state, 1, 1, u) for state in states)]
        outputs = [made.value("act", 1, 2), *(made.value(f"{state}n", 1, 1, u) for state in states)]
        graphs[name] = made.onnx(nodes, tensors, inputs, outputs)
    return graphs


@pytest.mark.parametrize("kind", made_graphs())
def test_onnx_graphs_equal_onnxruntime(kind: str, tmp_path: Path) -> None:
    runtime = pytest.importorskip("onnxruntime")
    data = made_graphs()[kind]
    network = read_graph(data, tmp_path)
    session = runtime.InferenceSession(data)
    names = [input.name for input in session.get_inputs()]
    theirs = [np.zeros(input.shape, np.float32) for input in session.get_inputs()[1:]]
    memory = network.initial_memory(1)
    for row in rows(5, 6).astype(np.float32):
        found, memory = network.forward(row[None].astype(float), memory)
        given = dict(zip(names, (row[None], *theirs), strict=True))
        action, *theirs = session.run(None, given)
        assert found == pytest.approx(action, abs=ALIKE)  # theirs is of single precision


def single_operators() -> dict[str, bytes]:
    """Return {operator that is no layer: graph}, with six observations and the actions."""
    plain = ("Abs", "Sin", "Cos", "Erf", "Reciprocal", "Softplus", "Softsign", "Selu", "Exp", "Neg",
             "HardSigmoid", "HardSwish", "Mish", "Softmax", "Shape", "Gelu")  # fmt: skip
    made_of: dict[str, tuple[list[bytes], list[bytes]]] = {
        kind: ([made.node(kind, ("obs",), ("y",))], []) for kind in plain
    }
    to_row = made.node("Reshape", ("z", "row"), ("y",)), made.integers("row", 1, -1)
    vector = made.tensor("v", np.linspace(0.5, 2.0, 6))
    pair = [vector, made.tensor("w", np.linspace(-1.0, 1.0, 6))]
    for kind in ("Max", "Min", "Add", "Sub", "Mul", "Div"):
        made_of[kind] = [made.node(kind, ("obs", "v"), ("y",))], [vector]
    made_of["Shape"] = (
        [made.node("Shape", ("obs",), ("s",)), made.node("ReduceMean", ("obs",), ("m",), axes=[1]),
         made.node("Expand", ("m", "s"), ("y",))], [])  # fmt: skip
    made_of["Log and Pow"] = (
        [made.node("Abs", ("obs",), ("a",)), made.node("Log", ("a",), ("l",)),
         made.node("Pow", ("a", "v"), ("p",)), made.node("Concat", ("l", "p"), ("y",), axis=1)],
        [vector])  # fmt: skip
    for kind in ("ReduceMean", "ReduceMax", "ReduceL2"):
        made_of[kind] = [made.node(kind, ("obs",), ("y",), axes=[-1])], []
    made_of["ReduceSum"] = (
        [made.node("ReduceSum", ("obs", "axis"), ("y",))], [made.integers("axis", 1)])  # fmt: skip
    made_of["MatMul with a vector"] = (
        [made.node("MatMul", ("obs", "v"), ("p",)), made.node("Add", ("obs", "p"), ("y",))],
        [vector])  # fmt: skip
    made_of["Slice"] = (
        [made.node("Slice", ("obs", "from", "to", "axis", "step"), ("y",))],
        [made.integers("from", -1), made.integers("to", -(2**63)), made.integers("axis", 1),
         made.integers("step", -2)])  # fmt: skip
    made_of["Slice of two axes"] = (
        [made.node("Slice", ("obs", "from", "to"), ("y",))],
        [made.integers("from", 0, 2), made.integers("to", 2**63 - 1, 5)])  # fmt: skip
    made_of["Gather"] = (
        [made.node("Gather", ("obs", "which"), ("y",), axis=1)],
        [made.integers("which", 5, 0, -2)])  # fmt: skip
    made_of["Gelu by tanh"] = [made.node("Gelu", ("obs",), ("y",), approximate="tanh")], []
    made_of["Clip without a minimum"] = (
        [made.node("Clip", ("obs", "", "top"), ("y",))], [made.tensor("top", 0.3)])  # fmt: skip
    made_of["LayerNormalization"] = (
        [made.node("LayerNormalization", ("obs", "v", "w"), ("y",), axis=-1)], pair)  # fmt: skip
    made_of["BatchNormalization"] = (
        [made.node("BatchNormalization", ("obs", "v", "w", "w", "v"), ("y",))], pair)  # fmt: skip
    kernel = made.tensor("k", np.random.default_rng(9).normal(size=(4, 2, 2)))
    made_of["Conv"] = (
        [made.node("Reshape", ("obs", "shape"), ("x",)),
         made.node("Conv", ("x", "k"), ("z",), strides=[1]), to_row[0]],
        [made.integers("shape", -1, 2, 3), kernel, to_row[1]])  # fmt: skip
    made_of["Conv of frames"] = (
        [made.node("Reshape", ("obs", "shape"), ("f",)),
         made.node("Transpose", ("f",), ("x",), perm=[0, 2, 1]),
         made.node("Conv", ("x", "k"), ("c",)), made.node("Flatten", ("c",), ("z",)), to_row[0]],
        [made.integers("shape", 1, 3, 2), kernel, to_row[1]])  # fmt: skip
    made_of["Transpose of a batch"] = (
        [made.node("Unsqueeze", ("obs", "zero"), ("x",)),
         made.node("Transpose", ("x",), ("t",), perm=[1, 0, 2]),
         made.node("Squeeze", ("t", "zero"), ("y",))],
        [made.integers("zero", 0)])  # fmt: skip
    made_of["Concat with a constant"] = (
        [made.node("Concat", ("obs", "c"), ("y",), axis=1)],
        [made.tensor("c", np.array([[0.5, -2.0]]))])  # fmt: skip
    channels = made.node("Reshape", ("obs", "shape"), ("x",))
    tensors = [made.integers("shape", 1, 3, 2), to_row[1]]
    for name, nodes in {
        "Softmax": [made.node("Softmax", ("x",), ("z",), axis=1)],
        "Split": [made.node("Split", ("x",), ("a", "b", "c"), axis=1),
                  made.node("Concat", ("c", "a", "b"), ("z",), axis=1)],
        "Concat": [made.node("Neg", ("x",), ("n",)),
                   made.node("Concat", ("x", "n"), ("z",), axis=1)],
    }.items():  # fmt: skip
        made_of[f"{name} of channels"] = [channels, *nodes, to_row[0]], tensors
    for kind in ("ReduceMean", "ReduceL2"):
        made_of[f"{kind} of all channels"] = (
            [channels, made.node(kind, ("x",), ("m",)), made.node("Sub", ("x", "m"), ("z",)),
             to_row[0]], tensors)  # fmt: skip
    made_of["LayerNormalization of channels"] = (
        [channels, made.node("LayerNormalization", ("x", "g"), ("z",), axis=1), to_row[0]],
        [*tensors, made.tensor("g", np.linspace(0.5, 2.0, 6).reshape(3, 2))])  # fmt: skip
    made_of["sizes"] = (
        [made.node("Shape", ("obs",), ("s",)),
         made.node("Gather", ("s", "zero"), ("b",), axis=0),
         made.node("Concat", ("b", "minus"), ("r",), axis=0),
         made.node("Reshape", ("obs", "r"), ("y",))],
        [made.integers("zero", 0), made.integers("minus", -1)])  # fmt: skip
    return {
        name: made.onnx(nodes, tensors, [made.value("obs", 1, 6)], [made.value("y")],
                        opset={"Mish": 18, "Gelu": 20, "Gelu by tanh": 20}.get(name, 17))
        for name, (nodes, tensors) in made_of.items()
    }  # fmt: skip


@pytest.mark.parametrize("kind", single_operators())
def test_operators_of_exported_policies_equal_onnxruntime(kind: str, tmp_path: Path) -> None:
    """Reference: onnxruntime. Other runs do not change the outputs of a run in any bit."""
    runtime = pytest.importorskip("onnxruntime")
    data = single_operators()[kind]
    network, session = read_graph(data, tmp_path), runtime.InferenceSession(data)
    given = rows(4, 6, seed=8).astype(np.float32)
    found = network.forward(given.astype(float))[0]
    for number, row in enumerate(given):
        expected = np.reshape(session.run(None, {"obs": row[None]})[0], -1)
        assert found[number] == pytest.approx(expected, rel=1e-5, abs=ALIKE)
        alone = network.forward(given[number : number + 1].astype(float))[0]
        assert np.array_equal(alone[0], found[number])


CONSTANTS: dict[str, tuple[list[bytes], tuple[int, ...]]] = {
    "Reshape": ([made.node("Reshape", ("v", "columns"), ("c",))], (6,)),
    "Reshape of rows": ([made.node("Reshape", ("v", "keep"), ("c",))], (6, 1, 2)),
    "Reshape of a product": (
        [made.node("Neg", ("v",), ("n",)), made.node("Reshape", ("n", "columns"), ("c",))], (12,)),
    "Unsqueeze": ([made.node("Unsqueeze", ("v", "one"), ("c",))], (6,)),
    "Squeeze": ([made.node("Squeeze", ("v", "one"), ("c",))], (6, 1, 3)),
    "Flatten": ([made.node("Flatten", ("v",), ("c",), axis=1)], (6, 2, 2)),
    "Transpose": ([made.node("Transpose", ("v",), ("c",), perm=[1, 0])], (2, 6)),
    "Slice": ([made.node("Slice", ("v", "one", "seven", "zero"), ("c",))], (8, 3)),
    "Concat": ([made.node("Concat", ("v", "v"), ("c",), axis=0)], (3, 2)),
    "Gather": ([made.node("Gather", ("v", "rows"), ("c",), axis=0)], (4, 2)),
}  # fmt: skip
"""{operator: nodes that make a matrix ``c`` (6, n) of a constant ``v``, and the shape of ``v``}."""


@pytest.mark.parametrize("kind", CONSTANTS)
def test_operators_of_constants_equal_onnxruntime(kind: str, tmp_path: Path) -> None:
    """References: onnxruntime. A constant has no axis of runs."""
    runtime = pytest.importorskip("onnxruntime")
    nodes, shape = CONSTANTS[kind]
    tensors = [
        made.tensor("v", np.random.default_rng(5).normal(size=shape)),
        *(made.integers("columns", 6, -1), made.integers("keep", 0, -1)),
        *(made.integers("zero", 0), made.integers("one", 1), made.integers("seven", 7)),
        made.integers("rows", 3, 0, 2, 2, 1, 0),
    ]
    ends = [made.node("MatMul", ("obs", "c"), ("p",)),
            made.node("ReduceSum", ("p", "one"), ("s",)),
            made.node("Concat", ("p", "s"), ("y",), axis=1)]  # fmt: skip
    data = made.onnx([*nodes, *ends], tensors, [made.value("obs", 1, 6)], [made.value("y")])
    given = rows(4, 6, seed=8).astype(np.float32)
    session = runtime.InferenceSession(data)
    expected = [session.run(None, {"obs": row[None]})[0][0] for row in given]
    found = read_graph(data, tmp_path).forward(given.astype(float))[0]
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=ALIKE)


@pytest.mark.parametrize(
    ("nodes", "message"),
    [
        ([made.node("ReduceSum", ("obs",), ("y",), axes=[0])], "unknown layer ReduceSum"),
        ([made.node("Gather", ("obs", "i"), ("y",), axis=0)], "sizes do not fit"),
        ([made.node("Concat", ("obs", "obs"), ("y",), axis=0)], "sizes do not fit"),
        ([made.node("Slice", ("obs", "i", "i"), ("y",))], "sizes do not fit"),
        ([made.node("Softmax", ("obs",), ("y",), axis=0)], "unknown layer Softmax"),
        ([made.node("Transpose", ("obs",), ("y",))], "unknown layer Transpose"),
        ([made.node("Conv", ("obs", "i"), ("y",), pads=[1, 1])], "unknown layer Conv"),
    ],
)
def test_operators_across_runs_are_refused(
    nodes: list[bytes], message: str, tmp_path: Path
) -> None:
    """Along the axis of the batch, which is that of the runs."""
    ends = [made.value("obs", 1, 6)], [made.value("y", 1, 6)]
    with pytest.raises(ModelError, match=message):
        read_graph(made.onnx(nodes, [made.integers("i", 0)], *ends), tmp_path)


def test_network_that_mixes_the_values_of_runs_is_refused(tmp_path: Path) -> None:
    """The second axis of the action is 1 for one run, and 2 for two runs."""
    path, weights = tmp_path / "made.onnx", {"v": np.ones(6)}
    product = NetworkOperation("product", np.matmul, ("obs", "v"), ("p",))
    total = NetworkOperation("sum", np.add, ("obs", "p"), ("y",))
    with pytest.raises(ModelError, match=r"y: sizes do not fit: \(2, 2, 6\)"):
        assemble_network(path, [product, total], weights, ("obs", "y"), [], 6)


def test_action_among_several_outputs_is_selected_by_name(tmp_path: Path) -> None:
    """As rl_games exports: mean, deviation and value. Without a known name it is refused."""
    outputs = [made.value(name, 1, 6) for name in ("log_std", "mu", "value")]
    nodes = [made.node(kind, ("obs",), (name,))
             for kind, name in (("Neg", "log_std"), ("Tanh", "mu"), ("Abs", "value"))]  # fmt: skip
    data = made.onnx(nodes, [], [made.value("obs", 1, 6)], outputs)
    row = rows(1, 6)
    assert read_graph(data, tmp_path).forward(row)[0] == pytest.approx(np.tanh(row))
    with pytest.raises(ModelError, match="3 outputs"):
        read_graph(data.replace(b"mu", b"mv"), tmp_path)


def test_onnx_graph_equals_plain_loops(tmp_path: Path) -> None:
    """Also without onnxruntime. Weights are rounded to single precision, as in the file."""
    draw = np.random.default_rng(6)
    layers = [
        (draw.normal(size=(6, 8)), draw.normal(size=8)),
        (draw.normal(size=(8, 5)), np.ones(5)),
    ]
    network, row = read_graph(made.dense_onnx(layers, "Elu"), tmp_path), rows(1, 6)[0]
    first, second = [[part.astype(np.float32).astype(float) for part in layer] for layer in layers]
    hidden = [BY_LOOPS["elu"](x) for x in product(row, *first)]
    found, _ = network.forward(row[None])
    assert found[0] == pytest.approx(product(hidden, *second), abs=ALIKE)


def make_external_graph(location: str, numbers: np.ndarray, **entries: int) -> bytes:
    """y = obs W, with W in another file behind 8 other bytes."""
    given = {"offset": 8, "length": 4 * numbers.size} | entries
    tensors = [made.external_tensor("W", numbers, location, **given)]
    ends = [made.value("obs", 1, 6)], [made.value("y", 1, 5)]
    return made.onnx([made.node("MatMul", ("obs", "W"), ("y",))], tensors, *ends)


def test_weights_in_a_file_beside_the_onnx_file_equal_onnxruntime(tmp_path: Path) -> None:
    runtime = pytest.importorskip("onnxruntime")
    numbers = np.random.default_rng(7).normal(size=(6, 5)).astype("<f4")
    (tmp_path / "made.onnx.data").write_bytes(b"\xff" * 8 + numbers.tobytes())
    network = read_graph(make_external_graph("made.onnx.data", numbers), tmp_path)
    assert network.files == (tmp_path / "made.onnx.data",)
    session, row = runtime.InferenceSession(tmp_path / "made.onnx"), rows(1, 6).astype(np.float32)
    assert network.forward(row.astype(float))[0] == pytest.approx(
        session.run(None, {"obs": row})[0], abs=ALIKE
    )


@pytest.mark.parametrize(
    ("location", "entries", "message"),
    [
        ("other.data", {}, "copy this file from the export"),
        ("../made.onnx.data", {}, "below the folder of the policy"),
        ("/etc/hostname", {}, "below the folder of the policy"),
        ("made.onnx.data", {"offset": 12}, "has 128 bytes, but 132 are required"),
        ("made.onnx.data", {"length": 116}, "sizes do not fit"),
        ("made.onnx.data", {"offset": -8}, "below the folder of the policy"),
    ],
)
def test_file_of_weights_that_does_not_fit_is_refused(
    location: str, entries: dict[str, int], message: str, tmp_path: Path
) -> None:
    numbers = np.ones((6, 5), "<f4")
    (tmp_path / "made.onnx.data").write_bytes(b"\xff" * 8 + numbers.tobytes())
    with pytest.raises(ModelError, match=message):
        read_graph(make_external_graph(location, numbers, **entries), tmp_path)


def get_refusal(layers: list[dict[str, Any]]) -> str:
    with pytest.raises(ModelError) as caught:
        read(layers)
    text = str(caught.value)
    assert "\n" not in text
    return text


def make_dense_layer(matrix: Any, bias: Any, **more: Any) -> dict[str, Any]:
    return {"type": "dense", "activation": "tanh", "weights": [matrix, bias], **more}


def test_layer_size_mismatch_names_its_layer() -> None:
    good = make_dense_layer([[1.0, 2.0]], [0.0, 0.0])
    assert "layer 2 (dense)" in get_refusal([good, make_dense_layer([[1.0]], [0.0])])
    assert "layer 2 (dense), weights 1" in get_refusal(
        [good, make_dense_layer([[1.0], [float("nan")]], [0.0])]
    )
    assert "layer 1 (conv1d)" in get_refusal([{"type": "conv1d"}])
    assert "layer 1 (dense): gelu" in get_refusal(
        [make_dense_layer([[1.0]], [0.0], activation="gelu")]
    )
    assert "layer 1 (dense)" in get_refusal([make_dense_layer([[1.0], [2.0, 3.0]], [0.0])])
    assert "RTNeural" in get_refusal([])


def test_torchscript_without_torch_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "torch", None)  # importing it fails, installed or not
    path = tmp_path / "policy.pt"
    path.write_bytes(b"PK")
    with pytest.raises(MissingPackageError, match="torch"):
        Policy.load(path)


@pytest.fixture
def torch() -> Any:
    return pytest.importorskip("torch", reason="torch is not installed")


def _save_onnx(torch: Any, module: Any, path: Path) -> Path:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        torch.jit.save(torch.jit.script(module), str(path))
    return path


@pytest.mark.slow
def test_torchscript_equals_plain_loops(torch: Any, tmp_path: Path) -> None:
    layers = torch.nn.Linear(7, 9), torch.nn.ELU(), torch.nn.Linear(9, 4)
    path = _save_onnx(torch, torch.nn.Sequential(*layers), tmp_path / "plain.pt")
    network, given = policy.build_torchscript_network(path), rows(5, 7)
    found, _ = network.forward(given)
    assert (network.inputs, network.outputs) == (7, 4)
    for row, out in zip(given, found, strict=True):
        for layer in (layers[0], layers[2]):
            matrix, bias = layer.weight.detach().double().numpy().T, layer.bias.detach().numpy()
            row = product(row, matrix, bias)
            row = [BY_LOOPS["elu"](x) for x in row] if layer is layers[0] else row
        assert out == pytest.approx(row, abs=ALIKE)
    alone = network.forward(given[2:3])[0]
    assert np.array_equal(alone[0], found[2])


def save_traced(torch: Any, module: Any, path: Path, inputs: int) -> Path:
    """Trace a module that changes its buffers, and save it."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        start = {name: buffer.clone() for name, buffer in module.named_buffers()}
        traced = torch.jit.trace(module, torch.zeros(1, inputs), check_trace=False)
        for name, buffer in traced.named_buffers():  # tracing evaluates the module
            buffer.copy_(start[name])
        torch.jit.save(traced, str(path))
    return path


@pytest.mark.slow
def test_torchscript_with_an_lstm_equals_torch(torch: Any, tmp_path: Path) -> None:
    """As legged_gym exports it: the actor is stored before the memory that is evaluated first.

    Reference: `torch.nn.LSTM` over the sequence of each run. Runs have states of their own.
    """

    class Recurrent(torch.nn.Module):  # type: ignore[misc]
        def __init__(self) -> None:
            super().__init__()
            self.actor = torch.nn.Linear(4, 2)
            self.memory = torch.nn.LSTM(3, 4)
            self.register_buffer("hidden_state", torch.zeros(1, 1, 4))
            self.register_buffer("cell_state", torch.zeros(1, 1, 4))

        def forward(self, x: Any) -> Any:
            out, (h, c) = self.memory(x.unsqueeze(0), (self.hidden_state, self.cell_state))
            self.hidden_state[:], self.cell_state[:] = h, c
            return self.actor(out.squeeze(0))

    torch.manual_seed(3)
    made_of = Recurrent()
    network = policy.build_torchscript_network(save_traced(torch, made_of, tmp_path / "lstm.pt", 3))
    assert (network.inputs, network.outputs, len(network.memory)) == (3, 2, 2)
    runs = np.stack([rows(6, 3, seed=1), rows(6, 3, seed=2)])
    memory = network.initial_memory(2)
    with torch.no_grad():
        out, _ = made_of.memory(torch.tensor(runs, dtype=torch.float32).transpose(0, 1))
        expected = made_of.actor(out).numpy()
    for step in range(6):
        found, memory = network.forward(runs[:, step], memory)
        assert found == pytest.approx(expected[step], abs=ALIKE)


@pytest.mark.slow
def test_torchscript_that_stores_observations_in_an_attribute_equals_torch(
    torch: Any, tmp_path: Path
) -> None:
    """The attribute is no buffer, and the size of an observation is no dimension of the weights.

    Reference: the network's own layer, applied to the last three observations of each run.
    """

    class Memory(torch.nn.Module):  # type: ignore[misc]
        def __init__(self) -> None:
            super().__init__()
            self.history = torch.zeros(1, 3, 5)

        def forward(self, x):  # type: ignore[no-untyped-def]
            self.history = torch.cat([self.history[:, 1:], x.unsqueeze(1)], dim=1)
            return self.history

    class Encoder(torch.nn.Module):  # type: ignore[misc]
        def __init__(self) -> None:
            super().__init__()
            self.memory, self.out = Memory(), torch.nn.Linear(15, 2)

        def forward(self, x):  # type: ignore[no-untyped-def]
            return self.out(self.memory(x).flatten(1))

    made_of = Encoder()
    path = _save_onnx(torch, made_of, tmp_path / "history.pt")
    network = policy.build_torchscript_network(path)
    assert (network.inputs, network.outputs) == (5, 2)
    assert [size for _, _, size in network.memory] == [15]
    runs, memory = np.stack([rows(6, 5, seed=1), rows(6, 5, seed=2)]), network.initial_memory(2)
    padded = np.concatenate([np.zeros((2, 2, 5)), runs], axis=1)
    matrix, bias = (made_of.out.weight.detach().numpy(), made_of.out.bias.detach().numpy())
    for step in range(6):
        found, memory = network.forward(runs[:, step], memory)
        expected = padded[:, step : step + 3].reshape(2, 15) @ matrix.T + bias
        assert found == pytest.approx(expected, abs=ALIKE)


@pytest.mark.slow
def test_torchscript_with_another_state_or_without_a_network_is_refused(
    torch: Any, tmp_path: Path
) -> None:
    """A state that starts with ones; a file of weights alone; a weight that is no number; an
    observation with another number of dimensions.
    """

    class Counting(torch.nn.Module):  # type: ignore[misc]
        def __init__(self) -> None:
            super().__init__()
            self.out = torch.nn.Linear(3, 2)
            self.register_buffer("h", torch.ones(1))

        def forward(self, x: Any) -> Any:
            self.h.add_(1.0)
            return self.out(x) + self.h

    path = save_traced(torch, Counting(), tmp_path / "counts.pt", 3)
    with pytest.raises(ModelError, match="keeps an internal state"):
        policy.build_torchscript_network(path)
    weights = tmp_path / "weights.pt"
    torch.save(torch.nn.Linear(3, 2).state_dict(), str(weights))
    with pytest.raises(ModelError, match="no readable network"):
        policy.build_torchscript_network(weights)
    bad = torch.nn.Linear(3, 2)
    bad.weight.data[0, 0] = math.nan
    with pytest.raises(ModelError, match="weight"):
        policy.build_torchscript_network(_save_onnx(torch, bad, tmp_path / "nan.pt"))
    image = torch.nn.Sequential(torch.nn.Conv2d(1, 2, 2), torch.nn.Flatten(), torch.nn.Linear(8, 2))
    with pytest.raises(ModelError, match=r"of 8 numbers.*input"):
        policy.build_torchscript_network(_save_onnx(torch, image, tmp_path / "image.pt"))


def test_output_of_a_row_does_not_depend_on_other_rows() -> None:
    """To the last bit."""
    draw = np.random.default_rng(4)
    weights = [draw.normal(size=(144, 256)).tolist(), draw.normal(size=256).tolist()]
    network = read([{"type": "dense", "activation": "elu", "weights": weights}])
    given = rows(33, 144)
    whole, _ = network.forward(given)
    for start, end in ((0, 1), (5, 22), (32, 33)):
        assert (network.forward(given[start:end])[0] == whole[start:end]).all()


def test_onnx_that_cannot_be_read_or_is_too_large_is_refused(tmp_path: Path) -> None:
    def refusal(data: bytes) -> str:
        with pytest.raises(ModelError) as caught:
            read_graph(data, tmp_path)
        return str(caught.value)

    def multiply(operator: str, weights: bytes) -> bytes:
        ends = [made.value("obs", 1, 2)], [made.value("y", 1, 3)]
        return made.onnx([made.node(operator, ("obs", "W"), ("y",))], [weights], *ends)

    assert "no readable network" in refusal(b"")
    assert "not a readable ONNX model" in refusal(b"\xff" * 40)
    whole = made.dense_onnx([(np.ones((2, 3)), np.ones(3))], "Relu")
    assert "not a readable ONNX model" in refusal(whole[:-20])
    large = made.tensor("W", [1.0], dims=(40_000, 25_000))
    assert "W has 1000000000 weights" in refusal(multiply("MatMul", large))
    spoilt = np.ones((2, 3))
    assert "Einsum" in refusal(multiply("Einsum", made.tensor("W", spoilt)))
    spoilt[1, 1] = np.inf
    assert "W: 1 of the weights" in refusal(multiply("MatMul", made.tensor("W", spoilt)))


@pytest.mark.parametrize(
    "attributes",
    [{"clip": 3.0}, {"layout": 1}, {"activations": ["Relu"]}, {"direction": "reverse"}],
)
@pytest.mark.parametrize("kind", ["GRU", "LSTM"])
def test_recurrence_with_an_attribute_that_is_not_evaluated_is_refused(
    kind: str, attributes: dict[str, Any]
) -> None:
    """ONNX defines the attributes; without the attribute the operation is made."""
    assert OPERATION_MAKERS[kind](attributes, 14) is None
    assert OPERATION_MAKERS[kind]({}, 14) is not None
