"""TorchScript: a program of its own, which torch's interpreter runs (it has no Python).

It is read by ``torch.jit.load`` alone: nothing is unpickled. Rows are evaluated one by one, so that
what a run gives does not depend on how many others are evaluated with it.
"""

from __future__ import annotations

import io
import warnings
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import InputError, MissingPackageError, ModelError
from pupper_analysis.base.inputs import read_input
from pupper_analysis.tools.walk.network import MOST_WEIGHTS, Network, Node, checked

Array = NDArray[np.float64]

SUFFIXES = (".pt", ".pth", ".jit", ".ts")
"""How such files are called."""

_MOST_BYTES = 4 * MOST_WEIGHTS
"""Of a file: as many weights in single precision as any network may have."""


def network_of(path: Path) -> Network:
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
    if count > MOST_WEIGHTS:
        problem = diagnose("too-many-weights", layer="", count=count, most=MOST_WEIGHTS)
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
    network = checked(path, [node], constants, ("observation", "action"), [], size)
    zeros, ones = np.zeros((1, size)), np.ones((1, size))
    before = network.forward(zeros)[0]
    network.forward(ones)
    if not np.array_equal(before, network.forward(zeros)[0], equal_nan=True):
        raise ModelError(path, diagnose("network-keeps-state"))
    return network
