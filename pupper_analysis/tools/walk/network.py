"""The network of a policy: a list of operations on arrays, evaluated by NumPy in double precision.

Every value is (runs, 1, n): each run's row is multiplied by itself, so what a run gives does not
depend, exactly, on how many others are evaluated with it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ModelError

Array = NDArray[np.float64]
Operation = Callable[..., Any]

MAX_WEIGHTS = 50_000_000
"""What a network may have: the largest that walks on a robot's computer has some 1e6."""

MAX_VALUE_SIZE = 1_000_000
"""Most elements of an operation's result, unless an input has as many (chosen, not tuned): refuses
graphs whose values double from layer to layer. The widest layers of walking policies have 1024."""


def sigmoid(value: Array) -> Array:
    """Returns 1 / (1 + exp(-x)), which overflows nowhere."""
    halved: Array = 0.5 * (1.0 + np.tanh(0.5 * value))
    return halved


def elu(value: Array, alpha: float = 1.0) -> Array:
    """Returns x, or alpha (exp(x) - 1) where x is negative."""
    return np.where(value > 0, value, alpha * np.expm1(np.minimum(value, 0.0)))


ACTIVATIONS: Mapping[str, Operation] = {
    "linear": lambda value: value,
    "relu": lambda value: np.maximum(value, 0.0),
    "elu": elu,
    "tanh": np.tanh,
    "sigmoid": sigmoid,
    "swish": lambda value: value * sigmoid(value),
}
"""By the names of Keras."""


def dense(value: Array, weights: Array, bias: Array) -> Array:
    """Returns x W + b."""
    product: Array = np.matmul(value, weights) + bias
    return product


def gru(
    value: Array, hidden: Array, given: Array, own: Array, biases: Array, *, after: bool = True
) -> Array:
    """Returns the next hidden state of a gated recurrent unit (Cho et al., 2014).

    Args:
        value: (runs, 1, n) its input.
        hidden: (runs, 1, u) its state.
        given: (n, 3 u) weights of the input, of the gates z (update), r (reset) and the candidate.
        own: (u, 3 u) those of the state.
        biases: (2, 3 u) beside the input's and the state's products.
        after: Whether the reset acts on the state's product (Keras, cuDNN), or on the state itself.
    """
    size = hidden.shape[-1]
    one, two = np.matmul(value, given) + biases[0], np.matmul(hidden, own) + biases[1]
    gates = sigmoid(one[..., : 2 * size] + two[..., : 2 * size])
    update, reset = gates[..., :size], gates[..., size:]
    last = two[..., 2 * size :]
    if after:
        last = reset * last
    else:
        last = np.matmul(reset * hidden, own[:, 2 * size :]) + biases[1, 2 * size :]
    fresh = np.tanh(one[..., 2 * size :] + last)
    following: Array = (1.0 - update) * fresh + update * hidden
    return following


def lstm(
    value: Array, hidden: Array, cell: Array, given: Array, own: Array, bias: Array
) -> tuple[Array, Array]:
    """Returns the next hidden state and cell of a long short-term memory.

    Args:
        value: (runs, 1, n) its input.
        hidden: (runs, 1, u) its state.
        cell: (runs, 1, u) its cell.
        given: (n, 4 u) weights of the input, of the gates i, f, the candidate, and o.
        own: (u, 4 u) those of the state.
        bias: (4 u,).
    """
    size = hidden.shape[-1]
    total = np.matmul(value, given) + np.matmul(hidden, own) + bias
    enters, stays, fresh, leaves = (total[..., size * k : size * (k + 1)] for k in range(4))
    following = sigmoid(stays) * cell + sigmoid(enters) * np.tanh(fresh)
    return sigmoid(leaves) * np.tanh(following), following


@dataclass(frozen=True)
class Node:
    """One operation.

    Attributes:
        name: Of its layer, for messages.
        apply: Called with its inputs; returns its output, or a tuple of them.
        inputs: Names of values.
        outputs: Names of values.
    """

    name: str
    apply: Operation
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Network:
    """What maps observations to actions.

    Attributes:
        nodes: In the order in which they are evaluated.
        constants: {name: its weights}.
        observation: The name of its input.
        action: The name of its output.
        memory: (name of a state, the value that it is next, its size) of each recurrent layer.
        inputs: The size of an observation.
        outputs: The size of an action.
    """

    nodes: tuple[Node, ...]
    constants: Mapping[str, Array]
    observation: str
    action: str
    memory: tuple[tuple[str, str, int], ...]
    inputs: int
    outputs: int

    @property
    def num_parameters(self) -> int:
        """How many numbers it has."""
        return sum(constant.size for constant in self.constants.values())

    def initial_memory(self, runs: int) -> tuple[Array, ...]:
        """Returns the state of its recurrent layers at the beginning of some runs."""
        return tuple(np.zeros((runs, 1, size)) for _, _, size in self.memory)

    def forward(
        self, observations: Array, memory: Sequence[Array] = ()
    ) -> tuple[Array, tuple[Array, ...]]:
        """Returns the actions (runs, outputs) of observations (runs, inputs), and the next state.

        Args:
            observations: One row for each run.
            memory: Of its recurrent layers, by ``initial_memory`` or from the step before.
        """
        values: dict[str, Any] = dict(self.constants)
        values[self.observation] = np.ascontiguousarray(observations)[:, None, :]
        values |= {name: state for (name, _, _), state in zip(self.memory, memory, strict=True)}
        for node in self.nodes:
            made = node.apply(*(values[name] for name in node.inputs))
            made = made if isinstance(made, tuple) else (made,)
            values |= dict(zip(node.outputs, made, strict=False))
        actions = values[self.action][:, 0, :]
        return actions, tuple(values[name] for _, name, _ in self.memory)


def assemble_network(
    path: Path,
    nodes: Sequence[Node],
    constants: Mapping[str, Array],
    ends: tuple[str, str],
    memory: Sequence[tuple[str, str, int]],
    inputs: int,
) -> Network:
    """Build a network of any format, and evaluate it once with an observation of zeros.

    All formats are validated here: finite weights, their number, the sizes of the observation, of
    recurrent states, of each operation's values and of the action.

    Args:
        path: The file, for messages.
        nodes: Operations in the order of evaluation.
        constants: {name: weights}.
        ends: Names of the observation and of the action.
        memory: As ``Network.memory``.
        inputs: Number of elements of an observation.

    Raises:
        ModelError: If a weight is not finite, or a size does not fit; it names the layer.
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
    values: dict[str, Any] = dict(constants)
    values[ends[0]] = np.zeros((1, 1, inputs))
    values |= {name: np.zeros((1, 1, size)) for name, _, size in memory}
    for node in nodes:
        missing = [name for name in node.inputs if name not in values]
        if missing:
            raise ModelError(
                path, diagnose("layer-input-missing", layer=node.name, name=missing[0])
            )
        try:
            made = node.apply(*(values[name] for name in node.inputs))
        except (ValueError, IndexError, TypeError) as error:
            sizes = [tuple(np.shape(values[name])) for name in node.inputs]
            problem = diagnose("layer-sizes", layer=node.name, sizes=str(sizes))
            raise ModelError(path, problem) from error
        made = made if isinstance(made, tuple) else (made,)
        sizes = [tuple(np.shape(value)) for value in made]
        largest = max((np.size(values[name]) for name in node.inputs), default=0)
        if max(map(np.size, made)) > max(MAX_VALUE_SIZE, largest):
            raise ModelError(path, diagnose("layer-sizes", layer=node.name, sizes=str(sizes)))
        values |= dict(zip(node.outputs, made, strict=False))
    if ends[1] not in values:
        raise ModelError(path, diagnose("layer-input-missing", layer="output", name=ends[1]))
    end = np.shape(values[ends[1]])
    if len(end) != 3 or end[:2] != (1, 1) or not end[2]:
        raise ModelError(path, diagnose("layer-sizes", layer=ends[1], sizes=str(end)))
    for name, following, size in memory:
        if following not in values or np.shape(values[following]) != (1, 1, size):
            raise ModelError(path, diagnose("layer-sizes", layer=name, sizes=str(size)))
    return Network(tuple(nodes), dict(constants), *ends, tuple(memory), inputs, end[2])
