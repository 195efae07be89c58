"""Operators of ONNX networks as functions of NumPy arrays.

Values that depend on the observation have a leading axis of runs. An ONNX tensor of shape (1, n) is
an array of shape (runs, 1, n), and a tensor of shape (1, c, n) is an array of shape (runs, c, n).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from pupper_analysis.base.array_types import Array
from pupper_analysis.tools.walk.network import ACTIVATIONS, MAX_WEIGHTS, Operation, elu, gru, lstm

Make = Callable[[dict[str, Any], int], Operation | None]
"""Function that creates an operation from ONNX attributes and the number of outputs; returns None
if not supported."""


def _make_gemm(attributes: dict[str, Any], _: int) -> Operation | None:
    """Create the operation x W + b of an ONNX node ``Gemm``; None if not supported."""
    if (
        attributes.get("transA")
        or not attributes.get("alpha", 1.0) == attributes.get("beta", 1.0) == 1.0
    ):
        return None
    is_transposed = bool(attributes.get("transB"))

    def apply(value: Array, weights: Array, bias: Array | float = 0.0) -> Any:
        return np.matmul(value, weights.T if is_transposed else weights) + bias

    return apply


def _is_along_elements(attributes: dict[str, Any]) -> bool:
    """Return True if the ``axis`` of an operator is stated as -1, 1 or 2, not the axis of runs."""
    return attributes.get("axis", 0) in (-1, 1, 2)


def _make_split(attributes: dict[str, Any], count: int) -> Operation | None:
    """Create the ONNX operation Split into ``count`` parts; None for an unsupported axis."""
    if not _is_along_elements(attributes):
        return None

    def apply(value: Array, sizes: Array | None = None) -> tuple[Array, ...]:
        parts = attributes.get("split") if sizes is None else sizes.astype(int).tolist()
        indices = count if parts is None else np.cumsum(parts)[:-1].tolist()
        return tuple(np.split(value, indices, axis=_find_axis(value, attributes["axis"])))

    return apply


def _make_concat(attributes: dict[str, Any], _: int) -> Operation | None:
    """Create the ONNX operation Concat; None for an unsupported axis."""
    if attributes.get("axis") == 0:
        return _concatenate_sizes
    if not _is_along_elements(attributes):
        return None

    def apply(*values: Array) -> Any:
        if attributes["axis"] == 1 and all(v.ndim == 3 and v.shape[1] > 1 for v in values):
            return np.concatenate(values, 1)
        reference = max(values, key=lambda value: (value.ndim, value.shape[:1]))
        lead = reference.shape[:-1]
        parts = [
            np.reshape(value, (*lead, -1))
            if value.ndim == reference.ndim and len(value) == len(reference)
            else np.broadcast_to(value, (*lead, value.shape[-1]))
            for value in values
        ]
        return np.concatenate(parts, -1)

    return apply


def _concatenate_sizes(*values: Array) -> Array:
    """Join lists of array sizes, shape (n,): the ONNX operation Concat along axis 0."""
    if any(np.ndim(value) > 1 for value in values):
        raise ValueError([np.shape(value) for value in values])
    return np.concatenate([np.ravel(value) for value in values])


def _make_clip(attributes: dict[str, Any], _: int) -> Operation:
    """Create the ONNX operation Clip, with bounds from the inputs, otherwise from attributes."""

    def apply(value: Array, low: Any = None, high: Any = None) -> Any:
        low = attributes.get("min", -np.inf) if low is None else low
        return np.clip(value, low, attributes.get("max", np.inf) if high is None else high)

    return apply


def _is_plain_recurrence(attributes: Mapping[str, Any]) -> bool:
    """Return True if a GRU or LSTM runs forward, without options such as other activations."""
    forward = attributes.get("direction", "forward") == "forward"
    changes = ("activations", "clip", "input_forget", "layout")
    return forward and not any(attributes.get(name) for name in changes)


def _make_gru(attributes: dict[str, Any], _: int) -> Operation | None:
    """Create the ONNX operation GRU; None unless `_is_plain_recurrence`."""
    if not _is_plain_recurrence(attributes):
        return None
    reset_after = bool(attributes.get("linear_before_reset", 0))

    def apply(value: Array, w: Array, r: Array, b: Array, hidden: Array) -> Any:
        biases = b[0].reshape(2, -1)
        state = gru(value, hidden, w[0].T, r[0].T, biases, reset_after=reset_after)
        return state, state

    return apply


def _make_lstm(attributes: dict[str, Any], _: int) -> Operation | None:
    """Create the ONNX operation LSTM; None unless `_is_plain_recurrence`."""
    if not _is_plain_recurrence(attributes):
        return None

    def reorder_gates(weights: Array) -> Array:
        input_gate, output_gate, forget_gate, candidate = np.split(weights, 4)  # i, o, f, c in ONNX
        return np.concatenate([input_gate, forget_gate, candidate, output_gate])

    def apply(value: Array, w: Array, r: Array, b: Array, hidden: Array, cell: Array) -> Any:
        bias = reorder_gates(b[0, : len(w[0])]) + reorder_gates(b[0, len(w[0]) :])
        state, cell = lstm(value, hidden, cell, reorder_gates(w[0]).T, reorder_gates(r[0]).T, bias)
        return state, state, cell

    return apply


def softplus(value: Array) -> Array:
    """Return log(1 + exp(x)) without overflow, for each element x of an array."""
    return np.logaddexp(0.0, value)


def _compute_erf(value: Array) -> Array:
    """Return the error function of each element of an array."""
    from scipy.special import erf

    result: Array = erf(value)
    return result


def _make_gelu(attributes: dict[str, Any], _: int) -> Operation:
    """Create the ONNX operation Gelu (Hendrycks and Gimpel, 2016), exact or by tanh."""
    if attributes.get("approximate") == "tanh":
        return lambda x: 0.5 * x * (1 + np.tanh(np.sqrt(2 / np.pi) * (x + 0.044715 * x**3)))
    return lambda x: 0.5 * x * (1 + _compute_erf(x / np.sqrt(2)))


def _make_softmax(attributes: dict[str, Any], _: int) -> Operation | None:
    """Create the ONNX operation Softmax within each run; None for an unsupported axis."""
    stated = attributes.get("axis", -1)
    if stated not in (-1, 1, 2):
        return None

    def apply(value: Array) -> Any:
        axis = _find_axis(value, stated)
        powers: Array = np.exp(value - value.max(axis=axis, keepdims=True))
        return powers / powers.sum(axis=axis, keepdims=True)

    return apply


def _make_layer_normalization(attributes: dict[str, Any], _: int) -> Operation | None:
    """Create the ONNX operation LayerNormalization (Ba et al., 2016) within each run.

    None for an unsupported axis.
    """
    stated = attributes.get("axis", -1)
    if stated not in (-1, 1, 2):
        return None
    epsilon = attributes.get("epsilon", 1e-5)

    def apply(value: Array, scale: Array, bias: Array | float = 0.0) -> Any:
        axes = (1, 2) if stated == 1 and value.ndim == 3 else -1
        centred = value - value.mean(axis=axes, keepdims=True)
        deviation: Array = np.sqrt((centred**2).mean(axis=axes, keepdims=True) + epsilon)
        return centred / deviation * scale + bias

    return apply


def _make_batch_normalization(attributes: dict[str, Any], _: int) -> Operation:
    """Create the ONNX operation BatchNormalization of a vector, with constant mean and variance."""
    epsilon = attributes.get("epsilon", 1e-5)

    def apply(value: Array, scale: Array, bias: Array, mean: Array, variance: Array) -> Any:
        if value.shape[1] != 1:
            raise ValueError(value.shape)
        return (value - mean) / np.sqrt(variance + epsilon) * scale + bias

    return apply


def _make_reduction(function: Callable[..., Any]) -> Make:
    """Return a function that creates a reduction, such as a mean, for ``OPERATION_MAKERS``.

    A reduced axis keeps a single element. The function returns None for unsupported axes.
    """

    def make(attributes: dict[str, Any], _: int) -> Operation | None:
        stated = attributes.get("axes", [-1])
        if len(stated) != 1 or stated[0] not in (-1, 1, 2):
            return None

        def apply(value: Array, axes: Array | None = None) -> Any:
            if axes is None and "axes" not in attributes and value.ndim == 3:  # all of each run
                return function(value, axis=(1, 2), keepdims=True)
            axis = stated[0] if axes is None else int(axes.item())
            return function(value, axis=_find_axis(value, axis), keepdims=True)

        return apply

    return make


def _find_axis(value: Array, axis: int) -> int:
    """Return the axis of ``value`` (first axis: runs) that corresponds to an ONNX axis."""
    if value.ndim <= 1:  # a constant, such as a list of sizes
        return axis
    if axis in (-1, 2) or (axis == 1 and value.shape[1] == 1):
        return -1
    if axis != 1:
        raise ValueError(axis)
    return 1


def _find_slices(
    attributes: Mapping[str, Any], bounds: Sequence[Array | None]
) -> list[tuple[int, int, int, int]]:
    """Return (start, end, axis, step) of each sliced axis of the ONNX operator Slice.

    ``bounds`` are the inputs of the node. Before opset 10, the bounds are attributes.
    """
    names = ("starts", "ends", "axes", "steps")
    stated = {name: attributes[name] for name in names if name in attributes}
    given = dict[str, list[int]]()
    for name, bound in zip(names, bounds, strict=False):
        if bound is not None:  # an end may be the largest integer
            numbers = np.clip(np.ravel(bound), -MAX_WEIGHTS, MAX_WEIGHTS)
            given[name] = numbers.astype(int).tolist()
    parts = {"axes": list(range(len((stated | given)["starts"])))} | stated | given
    steps = parts.get("steps", [1] * len(parts["starts"]))
    return list(zip(parts["starts"], parts["ends"], parts["axes"], steps, strict=True))


def _make_slice(attributes: dict[str, Any], _: int) -> Operation:
    """Create the ONNX operation Slice, with bounds as inputs or, before opset 10, attributes."""

    def apply(value: Array, *bounds: Array | None) -> Any:
        result: Any = value
        slices = _find_slices(attributes, bounds)
        for start, end, axis, step in slices:
            if axis == 0 and value.ndim > 1 and start == 0 and end >= 1 and step == 1:
                continue  # the whole observation
            where = [slice(None)] * value.ndim
            where[_find_axis(value, axis)] = slice(start, end, step)
            result = result[tuple(where)]
        if not result.size:
            raise ValueError(slices)
        return result

    return apply


def _make_gather(attributes: dict[str, Any], _: int) -> Operation:
    """Create the ONNX operation Gather, which selects elements of an axis by constant indices."""
    axis = attributes.get("axis", 0)

    def apply(value: Array, indices: Array) -> Any:
        if np.ndim(indices) > 1:
            raise ValueError(np.shape(indices))
        selected = np.ravel(indices).astype(np.int64)
        return np.take(value, selected, axis=_find_axis(value, axis))

    return apply


def _make_reshape(_: dict[str, Any], __: int) -> Operation:
    """Create the ONNX operation Reshape, for arrays whose first axis is the axis of the runs.

    A stated shape of three axes (any, c, n), without 0 for c and n, becomes (runs, c, n). Any other
    shape becomes (runs, 1, elements). An array with fewer than three axes, such as a list of sizes,
    is returned unchanged.
    """

    def apply(value: Array, sizes: Array | None = None) -> Array:
        shape = [] if sizes is None else np.ravel(sizes).astype(int).tolist()
        if value.ndim < 3:
            return value
        if len(shape) == 3 and 0 not in shape[1:]:
            return value.reshape(len(value), *shape[1:])
        return value.reshape(len(value), 1, -1)

    return apply


def _make_transpose(attributes: dict[str, Any], _: int) -> Operation | None:
    """Create the ONNX operation Transpose; None for an order of axes that is not supported.

    An exchange of the first two axes does not reorder the numbers of a single observation.
    """
    order = attributes.get("perm", [1, 0])
    if order == [0, 2, 1]:
        return lambda value: np.swapaxes(value, 1, 2)

    def apply(value: Array) -> Array:
        if order != list(range(len(order))) and value.shape[1] != 1:
            raise ValueError(value.shape)
        return value

    return apply if order in ([0, 1], [0, 1, 2], [1, 0, 2]) else None


def _make_convolution(attributes: dict[str, Any], _: int) -> Operation | None:
    """Create the ONNX operation Conv along one axis; None if the attributes are not supported."""
    is_plain = attributes.get("group", 1) == 1 and not any(attributes.get("pads", ()))
    is_plain &= attributes.get("auto_pad", "NOTSET") in ("NOTSET", "VALID")
    stride, dilation = attributes.get("strides", [1]), attributes.get("dilations", [1])
    if not is_plain or len(stride) != 1 or dilation != [1]:
        return None

    def apply(value: Array, weights: Array, bias: Array | float = 0.0) -> Array:
        outputs, channels, width = weights.shape
        if value.shape[1] != channels:
            raise ValueError(value.shape)
        windows = np.lib.stride_tricks.sliding_window_view(value, width, axis=2)[:, :, :: stride[0]]
        rows = np.swapaxes(windows, 1, 2).reshape(len(value), -1, channels * width)
        product = np.matmul(np.ascontiguousarray(rows), weights.reshape(outputs, -1).T) + bias
        return np.ascontiguousarray(np.swapaxes(product, 1, 2))

    return apply


def _multiply_matrices(first: Array, second: Array) -> Any:
    """Return the matrix product. A vector counts as a row (left) or column (right) of a matrix."""
    if first.ndim == 1 and second.ndim > 2:
        first = first[None, :]
    if second.ndim == 1 and first.ndim > 2:
        second = second[:, None]
    return np.matmul(first, second)


def _expand_array(value: Array, sizes: Array) -> Array:
    """Broadcast an array to the common shape of the array and ``sizes`` (ONNX operator Expand)."""
    shape: Sequence[int] = np.ravel(sizes).astype(int).tolist()
    return np.broadcast_to(value, np.broadcast_shapes(np.shape(value), tuple(shape)))


def _fold_operation(function: Callable[..., Any]) -> Operation:
    """Return the operation f(f(a, b), c)... of any number of arrays, for a binary function f."""

    def apply(first: Array, *others: Array) -> Any:
        for array in others:
            first = function(first, array)
        return first

    return apply


def skip_missing_inputs(operation: Operation, names: Sequence[str]) -> Operation:
    """Return an operation that accepts only the inputs that an ONNX node names.

    Args:
        operation: Operation with an argument per input of the node.
        names: Names of the node's inputs. The name of an omitted optional input is empty;
            ``operation`` then gets None for this input.
    """
    if all(names):
        return operation

    def apply(*values: Array) -> Any:
        given = iter(values)
        return operation(*(next(given) if name else None for name in names))

    return apply


def _reshape_constant(attributes: dict[str, Any], _: int) -> Operation:
    """Create the ONNX operation Reshape of a constant; a size of 0 keeps the size of the axis."""

    def apply(value: Array, sizes: Array | None = None) -> Array:
        shape = attributes["shape"] if sizes is None else np.ravel(sizes).astype(int).tolist()
        if not attributes.get("allowzero"):
            shape = [size or value.shape[axis] for axis, size in enumerate(shape)]
        return value.reshape(shape)

    return apply


def _flatten_constant(attributes: dict[str, Any], _: int) -> Operation:
    """Create the ONNX operation Flatten of a constant: a matrix, split before an axis."""
    axis = attributes.get("axis", 1)
    return lambda value: value.reshape(int(np.prod(value.shape[:axis])), -1)


def _squeeze_constant(attributes: dict[str, Any], _: int) -> Operation:
    """Create the ONNX operation Squeeze of a constant; without axes, all axes of size 1."""

    def apply(value: Array, axes: Array | None = None) -> Array:
        given = attributes.get("axes") if axes is None else np.ravel(axes).astype(int).tolist()
        return np.squeeze(value, None if given is None else tuple(given))

    return apply


def _unsqueeze_constant(attributes: dict[str, Any], _: int) -> Operation:
    """Create the ONNX operation Unsqueeze of a constant."""

    def apply(value: Array, axes: Array | None = None) -> Array:
        given = attributes["axes"] if axes is None else np.ravel(axes).astype(int).tolist()
        return np.expand_dims(value, tuple(given))

    return apply


def _slice_constant(attributes: dict[str, Any], _: int) -> Operation:
    """Create the ONNX operation Slice of a constant."""

    def apply(value: Array, *bounds: Array | None) -> Array:
        for start, end, axis, step in _find_slices(attributes, bounds):
            where = [slice(None)] * value.ndim
            where[axis] = slice(start, end, step)
            value = value[tuple(where)]
        return value

    return apply


CONSTANT_OPERATION_MAKERS: dict[str, Make] = {
    "Reshape": _reshape_constant,
    "Flatten": _flatten_constant,
    "Squeeze": _squeeze_constant,
    "Unsqueeze": _unsqueeze_constant,
    "Slice": _slice_constant,
    "Transpose": lambda given, _: lambda value: np.transpose(value, given.get("perm")),
    "Concat": lambda given, _: lambda *values: np.concatenate(values, given["axis"]),
    "Gather": lambda given, _: (
        lambda value, indices: np.take(value, indices.astype(int), given.get("axis", 0))
    ),
}
"""{ONNX operator: function that makes the operation for constants, which have no axis of runs}. For
operators that are not listed, the operation of `OPERATION_MAKERS` is used."""


def _ignore_attributes(operation: Operation) -> Make:
    """Return a function for `OPERATION_MAKERS` that returns ``operation`` for any attributes."""
    return lambda _given, _count: operation


IDENTITY_OPERATORS = ("Identity", "Cast", "CastLike", "Dropout", "Squeeze", "Unsqueeze")
"""ONNX operators that are evaluated as identity, except for constants. For a single observation,
these operators change neither the numbers nor the order of the numbers, except some Casts, for
example to integers. Only the first input is used.
"""

OPERATION_MAKERS: dict[str, Make] = {
    "Add": _ignore_attributes(np.add),
    "Sub": _ignore_attributes(np.subtract),
    "Mul": _ignore_attributes(np.multiply),
    "Div": _ignore_attributes(np.divide),
    "MatMul": _ignore_attributes(_multiply_matrices),
    "Neg": _ignore_attributes(np.negative),
    "Exp": _ignore_attributes(np.exp),
    "Sqrt": _ignore_attributes(np.sqrt),
    "Relu": _ignore_attributes(ACTIVATIONS["relu"]),
    "Tanh": _ignore_attributes(np.tanh),
    "Sigmoid": _ignore_attributes(ACTIVATIONS["sigmoid"]),
    "Elu": lambda given, _: lambda value: elu(value, given.get("alpha", 1.0)),
    "LeakyRelu": lambda given, _: (
        lambda value: np.where(value > 0, value, given.get("alpha", 0.01) * value)
    ),
    "Gemm": _make_gemm,
    "Split": _make_split,
    "Concat": _make_concat,
    "Clip": _make_clip,
    "Abs": _ignore_attributes(np.abs),
    "Log": _ignore_attributes(np.log),
    "Pow": _ignore_attributes(np.power),
    "Sin": _ignore_attributes(np.sin),
    "Cos": _ignore_attributes(np.cos),
    "Erf": _ignore_attributes(_compute_erf),
    "Reciprocal": _ignore_attributes(np.reciprocal),
    "Max": _ignore_attributes(_fold_operation(np.maximum)),
    "Min": _ignore_attributes(_fold_operation(np.minimum)),
    "Softplus": _ignore_attributes(softplus),
    "Softsign": _ignore_attributes(lambda value: value / (1 + np.abs(value))),
    "Swish": _ignore_attributes(ACTIVATIONS["swish"]),
    "HardSwish": _ignore_attributes(lambda value: value * np.clip(value / 6 + 0.5, 0, 1)),
    "Mish": _ignore_attributes(lambda value: value * np.tanh(softplus(value))),
    "Selu": lambda given, _: (
        lambda value: (
            given.get("gamma", 1.0507009873554805)
            * elu(value, given.get("alpha", 1.6732632423543772))
        )
    ),
    "HardSigmoid": lambda given, _: (
        lambda value: np.clip(given.get("alpha", 0.2) * value + given.get("beta", 0.5), 0, 1)
    ),
    "Gelu": _make_gelu,
    "Softmax": _make_softmax,
    "LayerNormalization": _make_layer_normalization,
    "BatchNormalization": _make_batch_normalization,
    "ReduceMean": _make_reduction(np.mean),
    "ReduceSum": _make_reduction(np.sum),
    "ReduceMax": _make_reduction(np.max),
    "ReduceL2": _make_reduction(np.linalg.norm),
    "Slice": _make_slice,
    "Gather": _make_gather,
    "Shape": _ignore_attributes(lambda value: np.array(np.shape(value), dtype=np.float64)),
    "Expand": _ignore_attributes(_expand_array),
    "Flatten": _make_reshape,
    "Reshape": _make_reshape,
    "Transpose": _make_transpose,
    "Conv": _make_convolution,
    "GRU": _make_gru,
    "LSTM": _make_lstm,
    **dict.fromkeys(IDENTITY_OPERATORS, _ignore_attributes(ACTIVATIONS["linear"])),
}
"""{ONNX operator: function that makes the operation from attributes and the number of outputs}."""
