"""Policies made for tests: files of random networks, and a stand that balances by its gains."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np

from tests.tools.contract.sources import field, value, varint


def tensor(name: str, values: Any, dims: tuple[int, ...] | None = None) -> bytes:
    array = np.asarray(values, dtype="<f4")
    sizes = b"".join(field(1, size) for size in (array.shape if dims is None else dims))
    return sizes + field(2, 1) + field(8, name) + field(9, array.tobytes())


def integers(name: str, *numbers: int) -> bytes:
    """Return a constant list of integers."""
    data = np.array(numbers, dtype="<i8").tobytes()
    return field(2, 7) + field(1, len(numbers)) + field(8, name) + field(9, data)


def external_tensor(name: str, values: Any, location: str, **entries: int) -> bytes:
    """Return a tensor whose numbers are in another file: ``offset`` and ``length`` in bytes."""
    array = np.asarray(values, dtype="<f4")
    data = b"".join(field(1, size) for size in array.shape) + field(2, 1) + field(8, name)
    for key, text in {"location": location, **entries}.items():
        data += field(13, field(1, key) + field(2, str(text)))
    return data + field(14, 1)


def node(kind: str, inputs: tuple[str, ...], outputs: tuple[str, ...], **given: Any) -> bytes:
    data = b"".join(field(1, name) for name in inputs) + b"".join(
        field(2, output) for output in outputs
    )
    data += field(3, f"{kind}-{outputs[0]}") + field(4, kind)
    for name, number in given.items():
        encoded = field(1, name)
        if isinstance(number, float):
            encoded += varint(2 << 3 | 5) + struct.pack("<f", number) + field(20, 1)
        elif isinstance(number, list):
            encoded += b"".join(field(8, integer % 2**64) for integer in number) + field(20, 7)
        elif isinstance(number, str):
            encoded += field(4, number) + field(20, 3)
        else:
            encoded += field(3, number % 2**64) + field(20, 2)
        data += field(5, encoded)
    return data


def onnx(
    nodes: list[bytes],
    tensors: list[bytes],
    inputs: list[bytes],
    outputs: list[bytes],
    metadata: dict[str, str] | None = None,
    opset: int = 13,
) -> bytes:
    graph = b"".join(field(1, encoded) for encoded in nodes) + field(2, "graph")
    graph += b"".join(field(5, encoded) for encoded in tensors)
    graph += b"".join(field(11, name) for name in inputs)
    graph += b"".join(field(12, output) for output in outputs)
    data = field(1, 8) + field(7, graph) + field(8, field(1, "") + field(2, opset))
    for key, text in (metadata or {}).items():
        data += field(14, field(1, key) + field(2, text))
    return data


def dense_onnx(
    weights: list[tuple[Any, Any]], activation: str, metadata: dict[str, str] | None = None
) -> bytes:
    """Layers of weights (n, m) and biases (m,), with an activation between them."""
    nodes, tensors, last = [], [], "obs"
    for number, (matrix, bias) in enumerate(weights):
        tensors += [tensor(f"W{number}", matrix), tensor(f"b{number}", bias)]
        nodes.append(node("Gemm", (last, f"W{number}", f"b{number}"), (f"y{number}",)))
        last = f"y{number}"
        if number + 1 < len(weights):
            nodes.append(node(activation, (last,), (f"a{number}",)))
            last = f"a{number}"
    ends = [value("obs", 1, len(weights[0][0]))], [value(last, 1, len(weights[-1][1]))]
    return onnx(nodes, tensors, *ends, metadata)


FRAME = 36


def write_standing_policy(path: Path, **changed: Any) -> Path:
    """Write a policy that keeps Pupper's default pose and counters tilt with the hips."""
    weights = np.zeros((FRAME, 12))
    weights[4, [1, 4, 7, 10]] = 0.2  # leans to the side are met by the hips
    weights[0, [1, 4, 7, 10]] = 0.02  # and damped
    values: dict[str, Any] = {
        "observation_history": 1,
        "action_scale": 0.75,
        "kp": 5.0,
        "kd": 0.25,
        "default_joint_pos": [0.26, 0.0, -0.52, -0.26, 0.0, 0.52] * 2,
        "in_shape": [None, FRAME],
        "layers": [
            {
                "type": "dense",
                "activation": "tanh",
                "shape": [None, 12],
                "weights": [weights.tolist(), [0.0] * 12],
            }
        ],
    }
    values |= changed
    path.write_text(json.dumps(values), encoding="utf-8")
    return path


TROT = ((0.13, 0.0, 0.0), (0.0, 0.1, 0.0), (0.0, 0.0, 0.8))
"""Commands of ``trot``: forward [m/s], to the left [m/s], and turning [rad/s]."""

_ROLL, _PITCH_RATE = 0.2, 0.02


def trot(path: Path, **changed: Any) -> Path:
    """Write a policy for Pupper that trots: diagonal legs by a phase, each command by a gate.
    relu(cos + g (c / c0 - 1)) is relu(cos) for the command c = c0, and 0 for c = 0: two layers
    swing the legs forward, sideways or about the vertical, and lift them by the sine.
    """
    angular, gravity, command, phase = 0, 3, 6, 21  # where they begin; 12 joint positions between
    units: list[tuple[dict[int, float], float]] = []
    out: list[dict[int, float]] = []

    def unit(given: dict[int, float], bias: float, legs: dict[int, float]) -> None:
        units.append((given, bias))
        out.append(legs)

    names = ("front_r", "front_l", "back_r", "back_l")
    group = {"front_r": 1, "back_l": 1, "front_l": -1, "back_r": -1}
    right = {name: 1 if name.endswith("r") else -1 for name in names}
    ahead = {name: 1 if name.startswith("front") else -1 for name in names}
    swing = {
        0: {3 * i: 0.2 * group[name] * right[name] for i, name in enumerate(names)},
        1: {3 * i + 1: -0.15 * group[name] for i, name in enumerate(names)},
        2: {3 * i + 1: -0.19 * group[name] * ahead[name] for i, name in enumerate(names)},
    }
    gate = 4.0
    for axis, legs in swing.items():
        for sign in (1, -1):
            given = {phase: float(sign), command + axis: gate / TROT[axis][axis]}
            unit(given, -gate, {leg: sign * size for leg, size in legs.items()})
    for sign in (1, -1):
        lifted = {i: right[name] for i, name in enumerate(names) if group[name] == sign}
        legs = {3 * i + 2: -0.5 * side for i, side in lifted.items()}
        legs |= {3 * i: 0.25 * side for i, side in lifted.items()}
        unit({phase + 1: float(sign)}, 0.0, legs)
        hips = {3 * i + 1: float(sign) for i in range(4)}
        unit({gravity + 1: float(sign)}, 0.0, {leg: _ROLL * s for leg, s in hips.items()})
        unit({angular: float(sign)}, 0.0, {leg: _PITCH_RATE * s for leg, s in hips.items()})
    first, second = np.zeros((23, len(units))), np.zeros((len(units), 12))
    for number, ((given, _), legs) in enumerate(zip(units, out, strict=True)):
        first[list(given), number] = list(given.values())
        second[number, list(legs)] = list(legs.values())
    layers: list[dict[str, Any]] = [
        {"type": "dense", "activation": "relu", "weights": [first.tolist(), [b for _, b in units]]},
        {"type": "dense", "activation": "", "weights": [second.tolist(), [0.0] * 12]},
    ]
    values: dict[str, Any] = {
        **{"action_scale": 1.0, "kp": 5.0, "kd": 0.25, "layers": layers},
        "default_joint_pos": [0.26, 0.0, -0.52, -0.26, 0.0, 0.52] * 2,
    }
    frames = changed.pop("history", 1)  # the newest last; the others have no weights
    if frames > 1:
        before = np.zeros(((frames - 1) * 23, len(units)))
        layers[0]["weights"][0] = np.vstack([before, first]).tolist()
    path.write_text(json.dumps(values | changed), encoding="utf-8")
    terms = ["angular-velocity", "gravity", "command", "joint-positions", "phase"]
    toml = f"observation = {json.dumps(terms)}\nrate = 50\nphase-rate = 3\nphase-offsets = [0.0]\n"
    toml += f'history = {frames}\nlayout = "by-frame"\n'
    path.with_suffix(".toml").write_text(toml, encoding="utf-8")
    return path
