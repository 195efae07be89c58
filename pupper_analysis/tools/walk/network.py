"""Network of a policy: a list of operations on NumPy arrays.

Observations, states and actions have the shape (runs, 1, n) in the graph. The row of each run is
multiplied separately. Therefore the result of a run is bitwise independent of the number of other
runs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ModelError

Operation = Callable[..., Any]
"""Function of arrays that returns an array, or a tuple of arrays."""

MAX_WEIGHTS = 50_000_000
"""Maximum number of weights of a network, and of elements of an observation or state; files with
larger networks are refused. Chosen: networks that walk on the computer of a robot have about 1e6.
"""

MAX_VALUE_SIZE = 1_000_000
"""Maximum number of elements of the result of a layer, unless an input has as many. Otherwise
values that double from layer to layer could exhaust the memory. Chosen, not tuned.
"""


def sigmoid(value: Array) -> Array:
    """Return 1 / (1 + exp(-x)) without overflow, for each element x of an array."""
    halved: Array = 0.5 * (1.0 + np.tanh(0.5 * value))
    return halved


def elu(value: Array, alpha: float = 1.0) -> Array:
    """Return x for positive x, else alpha (exp(x) - 1), for each element x of an array."""
    return np.where(value > 0, value, alpha * np.expm1(np.minimum(value, 0.0)))


ACTIVATIONS: Mapping[str, Operation] = {
    "linear": lambda value: value,
    "relu": lambda value: np.maximum(value, 0.0),
    "elu": elu,
    "tanh": np.tanh,
    "sigmoid": sigmoid,
    "swish": lambda value: value * sigmoid(value),
}
"""Activation functions by Keras names."""


def dense(value: Array, weights: Array, bias: Array) -> Array:
    """Evaluate a dense layer of a policy's network: return x W + b, shape (runs, 1, u).

    Args:
        value: Input x, shape (runs, 1, n).
        weights: W, shape (n, u).
        bias: b, shape (u,).
    """
    product: Array = np.matmul(value, weights) + bias
    return product


def gru(
    value: Array,
    hidden: Array,
    input_weights: Array,
    state_weights: Array,
    biases: Array,
    *,
    reset_after: bool = True,
) -> Array:
    """Return the next hidden state of a gated recurrent unit (Cho et al., 2014).

    Args:
        value: Input, shape (runs, 1, n).
        hidden: Hidden state, shape (runs, 1, u).
        input_weights: Weights of the input, shape (n, 3 u), in the order update, reset, candidate.
        state_weights: Weights of the state, shape (u, 3 u), in the same order.
        biases: Biases of the products with input and state, shape (2, 3 u).
        reset_after: True if the reset gate multiplies the product with the state (Keras, cuDNN),
            False if the reset gate multiplies the state.
    """
    size = hidden.shape[-1]
    input_part, state_part = (
        np.matmul(value, input_weights) + biases[0],
        np.matmul(hidden, state_weights) + biases[1],
    )
    gates = sigmoid(input_part[..., : 2 * size] + state_part[..., : 2 * size])
    update, reset = gates[..., :size], gates[..., size:]
    candidate_part = state_part[..., 2 * size :]
    if reset_after:
        candidate_part = reset * candidate_part
    else:
        candidate_part = (
            np.matmul(reset * hidden, state_weights[:, 2 * size :]) + biases[1, 2 * size :]
        )
    candidate = np.tanh(input_part[..., 2 * size :] + candidate_part)
    next_hidden: Array = (1.0 - update) * candidate + update * hidden
    return next_hidden


def lstm(
    value: Array,
    hidden: Array,
    cell: Array,
    input_weights: Array,
    state_weights: Array,
    bias: Array,
) -> tuple[Array, Array]:
    """Return the next hidden state and cell state of a long short-term memory.

    Source: Hochreiter and Schmidhuber, 1997, with the forget gate of Gers et al., 2000.

    Args:
        value: Input, shape (runs, 1, n).
        hidden: Hidden state, shape (runs, 1, u).
        cell: Cell state, shape (runs, 1, u).
        input_weights: Weights of the input, shape (n, 4 u), in the order input gate, forget gate,
            candidate, output gate.
        state_weights: Weights of the state, shape (u, 4 u), in the same order.
        bias: Biases, shape (4 u,).

    Returns:
        Hidden state, shape (runs, 1, u); cell state, shape (runs, 1, u).
    """
    size = hidden.shape[-1]
    total = np.matmul(value, input_weights) + np.matmul(hidden, state_weights) + bias
    input_gate, forget_gate, candidate, output_gate = (
        total[..., size * k : size * (k + 1)] for k in range(4)
    )
    next_cell = sigmoid(forget_gate) * cell + sigmoid(input_gate) * np.tanh(candidate)
    return sigmoid(output_gate) * np.tanh(next_cell), next_cell


@dataclass(frozen=True)
class NetworkOperation:
    """Operation of a policy's network, with named inputs and outputs.

    Attributes:
        name: Name of the layer, for messages.
        apply: Function of the inputs; returns the output, or a tuple of outputs.
        inputs: Names of the input values.
        outputs: Names of the output values.
    """

    name: str
    apply: Operation
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Network:
    """Network of a policy that maps observations to actions, as operations on NumPy arrays.

    Attributes:
        nodes: Operations in the order of evaluation.
        constants: {name: weights}.
        observation: Name of the observation.
        action: Name of the action.
        memory: For each recurrent state: name of the state, name of the next value, and size.
        inputs: Number of elements of an observation.
        outputs: Number of elements of an action.
        files: Other files from which weights were read.
    """

    nodes: tuple[NetworkOperation, ...]
    constants: Mapping[str, Array]
    observation: str
    action: str
    memory: tuple[tuple[str, str, int], ...]
    inputs: int
    outputs: int
    files: tuple[Path, ...] = ()

    @property
    def num_parameters(self) -> int:
        """Number of weights of the network, including other constants."""
        return sum(constant.size for constant in self.constants.values())

    def initial_memory(self, runs: int) -> tuple[Array, ...]:
        """Return the recurrent states at the start of runs: zeros, shape (runs, 1, size) each."""
        return tuple(np.zeros((runs, 1, size)) for _, _, size in self.memory)

    def forward(
        self, observations: Array, memory: Sequence[Array] = ()
    ) -> tuple[Array, tuple[Array, ...]]:
        """Evaluate the network: return the actions, and the recurrent states for the next call.

        Args:
            observations: Observations, shape (runs, inputs).
            memory: Recurrent states, from `initial_memory` or from the previous call.

        Returns:
            Actions, shape (runs, outputs); recurrent states for the next call.
        """
        values: dict[str, Any] = dict(self.constants)
        values[self.observation] = np.ascontiguousarray(observations)[:, None, :]
        values |= {name: state for (name, _, _), state in zip(self.memory, memory, strict=True)}
        with np.errstate(divide="ignore", invalid="ignore"):
            for node in self.nodes:
                results = node.apply(*(values[name] for name in node.inputs))
                results = results if isinstance(results, tuple) else (results,)
                values |= dict(zip(node.outputs, results, strict=False))
        actions = values[self.action][:, 0, :]
        return actions, tuple(values[name] for _, name, _ in self.memory)


def assemble_network(
    path: Path,
    nodes: Sequence[NetworkOperation],
    constants: Mapping[str, Array],
    ends: tuple[str, str],
    memory: Sequence[tuple[str, str, int]],
    inputs: int,
) -> Network:
    """Build a network from operations, and validate the sizes by an evaluation.

    The network is evaluated with an observation of zeros, for one run and for two runs.

    Args:
        path: The file, for messages.
        nodes: Operations in the order of evaluation.
        constants: {name: weights}.
        ends: Names of the observation and of the action.
        memory: (name, name of the next value, number of elements) of each recurrent state.
        inputs: Number of elements of an observation.

    Raises:
        ModelError: If a weight is not finite, or a size does not fit, for example.
    """
    count = sum(weights.size for weights in constants.values())
    if count > MAX_WEIGHTS:
        problem = diagnose("too-many-weights", layer="", count=count, most=MAX_WEIGHTS)
        raise ModelError(path, problem)
    for name, size in ((ends[0], inputs), *((name, size) for name, _, size in memory)):
        if not 0 < size <= MAX_WEIGHTS:
            raise ModelError(path, diagnose("layer-sizes", layer=name, sizes=str(size)))
    for name, weights in constants.items():
        if not np.isfinite(weights).all():
            count = int((~np.isfinite(weights)).sum())
            raise ModelError(path, diagnose("weights-not-finite", layer=name, count=count))
    for runs in (1, 2):  # two runs: an operation must not mix the values of runs
        values: dict[str, Any] = dict(constants)
        values[ends[0]] = np.zeros((runs, 1, inputs))
        values |= {name: np.zeros((runs, 1, size)) for name, _, size in memory}
        for node in nodes:
            missing = [name for name in node.inputs if name not in values]
            if missing:
                raise ModelError(
                    path, diagnose("layer-input-missing", layer=node.name, name=missing[0])
                )
            try:
                with np.errstate(divide="ignore", invalid="ignore"):
                    results = node.apply(*(values[name] for name in node.inputs))
            except (ValueError, IndexError, TypeError) as error:
                sizes = [tuple(np.shape(values[name])) for name in node.inputs]
                problem = diagnose("layer-sizes", layer=node.name, sizes=str(sizes))
                raise ModelError(path, problem) from error
            results = results if isinstance(results, tuple) else (results,)
            sizes = [tuple(np.shape(value)) for value in results]
            largest = max((np.size(values[name]) for name in node.inputs), default=0)
            if max(map(np.size, results)) > max(MAX_VALUE_SIZE, largest):
                raise ModelError(path, diagnose("layer-sizes", layer=node.name, sizes=str(sizes)))
            values |= dict(zip(node.outputs, results, strict=False))
        if ends[1] not in values:
            raise ModelError(path, diagnose("layer-input-missing", layer="output", name=ends[1]))
        action_shape = np.shape(values[ends[1]])
        if len(action_shape) != 3 or action_shape[:2] != (runs, 1) or not action_shape[2]:
            raise ModelError(path, diagnose("layer-sizes", layer=ends[1], sizes=str(action_shape)))
        for name, following, size in memory:
            if following not in values or np.shape(values[following]) != (runs, 1, size):
                raise ModelError(path, diagnose("layer-sizes", layer=name, sizes=str(size)))
    return Network(tuple(nodes), dict(constants), *ends, tuple(memory), inputs, action_shape[2])
