"""A policy: a network, and the contract by which it is run."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from pupper_analysis.base.errors import InputError, ModelError
from pupper_analysis.base.inputs import is_input, read_toml
from pupper_analysis.tools.contract.facts import Request
from pupper_analysis.tools.contract.readers import onnx, read_onnx, tables
from pupper_analysis.tools.walk.contract import Contract, contract_of, of_rtneural, of_source
from pupper_analysis.tools.walk.network import Network
from pupper_analysis.tools.walk.network_files import (
    TORCHSCRIPT,
    onnx_network,
    read_rtneural,
    rtneural_network,
    torchscript_network,
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
            beside = path.with_suffix(".toml") if contract is None else Path(contract)
            there = contract is not None or is_input(beside)
            toml: dict[str, Any] = read_toml(beside)[1] if there else {}
        except InputError as error:
            raise ModelError(error.path, error.cause) from error
        if path.suffix == ".json":
            values = read_rtneural(path)
            network, read = rtneural_network(path, values), tables.read
            own = of_rtneural(values, network.inputs, network.outputs)
        elif path.suffix in TORCHSCRIPT:  # states nothing but its weights
            network, read, own = torchscript_network(path), None, {}
        else:
            network, read, own = onnx_network(path, read_onnx(path)), onnx.read, {}
        for source in () if read is None else read(Request(path)):
            own = of_source(source) | own
        stated = [(str(path), own), *([(str(beside), toml)] if there else [])]
        agreed = contract_of(path, stated, network.inputs, network.outputs)
        return cls(path.name, network, agreed)

    def with_contract(self, **changed: Any) -> Policy:
        """Returns the policy with other fields of its contract."""
        return replace(self, contract=replace(self.contract, **changed))
