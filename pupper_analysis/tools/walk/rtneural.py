"""RTNeural's JSON: a chain of dense, recurrent and activation layers."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import orjson
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import InputError, ModelError
from pupper_analysis.base.inputs import MOST_FILE, read_input
from pupper_analysis.models.places import Place, refuse_file, refuse_input
from pupper_analysis.tools.walk.network import (
    ACTIVATIONS,
    MOST_WEIGHTS,
    Network,
    Node,
    checked,
    dense,
    gru,
    lstm,
)

Array = NDArray[np.float64]

_ARRAYS = {"dense": 2, "time-distributed-dense": 2, "gru": 3, "lstm": 3}
"""How many arrays of weights a layer has."""


def read_values(path: Path) -> dict[str, Any]:
    """Returns what RTNeural's JSON holds.

    Raises:
        ModelError: If it cannot be read, or has no list of layers.
    """
    try:
        values = orjson.loads(read_input(path, MOST_FILE))
    except InputError as error:
        raise refuse_input(path, error) from error
    except orjson.JSONDecodeError as error:
        message = diagnose("contract-no-json", problem=error.msg)
        raise refuse_file(Place(path, error.lineno), message) from error
    if not isinstance(values, dict) or not isinstance(values.get("layers"), list):
        raise ModelError(path, diagnose("contract-no-rtneural"))
    return values


def network_of(path: Path, values: Mapping[str, Any]) -> Network:
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
        kind = layer.get("type") if isinstance(layer, dict) else None
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
        elif kind != "activation":
            known = (*_ARRAYS, "activation")
            raise ModelError(path, diagnose("layer-unknown", layer=name, known=known))
        activation = layer.get("activation") or "linear"
        if activation not in ACTIVATIONS:
            problem = diagnose("layer-unknown", layer=f"{name}: {activation}", known=ACTIVATIONS)
            raise ModelError(path, problem)
        if kind not in ("gru", "lstm") and activation != "linear":  # theirs are inside
            shaped = f"{after} {activation}"
            nodes.append(Node(name, ACTIVATIONS[activation], (last,), (shaped,)))
            last = shaped
    return checked(path, nodes, constants, ("observation", last), memory, inputs)


def _weights(path: Path, name: str, layer: dict[str, Any], count: int) -> list[Array]:
    """Returns the arrays of a layer; biases are vectors, or two of them for a GRU."""
    given = layer.get("weights")
    if not isinstance(given, list) or len(given) != count:
        raise ModelError(path, diagnose("layer-weights", layer=name, count=count))
    try:
        arrays = [np.array(one, dtype=np.float64) for one in given]
    except (ValueError, TypeError) as error:
        raise ModelError(path, diagnose("layer-weights", layer=name, count=count)) from error
    fits = all(one.ndim == 2 for one in arrays[:-1])
    if not fits or arrays[-1].ndim not in (1, 2) or sum(one.size for one in arrays) > MOST_WEIGHTS:
        raise ModelError(path, diagnose("layer-weights", layer=name, count=count))
    return arrays
