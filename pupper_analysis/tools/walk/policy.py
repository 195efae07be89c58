"""A policy: a network, and the contract by which it is run."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import orjson

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import InputError, ModelError
from pupper_analysis.base.inputs import MOST_FILE, is_input, read_input, read_toml
from pupper_analysis.tools.walk.contract import Contract, contract_of, of_metadata, of_rtneural
from pupper_analysis.tools.walk.network import Network
from pupper_analysis.tools.walk.onnx_file import read_onnx
from pupper_analysis.tools.walk.rtneural import read_rtneural


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
        """Reads a policy; nothing in it is executed.

        Args:
            path: An ONNX file, or RTNeural's JSON.
            contract: A TOML that states what the file does not, and counts where both do; by
                default the one beside it, of its name with ``.toml``, if there is one.

        Raises:
            ModelError: If it cannot be used; the message names the layer, or the key.
        """
        path = Path(path)
        try:
            data = read_input(path, MOST_FILE)
            beside = path.with_suffix(".toml") if contract is None else Path(contract)
            there = contract is not None or is_input(beside)
            toml: dict[str, Any] = read_toml(beside)[1] if there else {}
        except InputError as error:
            raise ModelError(error.path, error.cause) from error
        if data.lstrip()[:1] == b"{":
            try:
                values = orjson.loads(data)
            except orjson.JSONDecodeError as error:
                problem = diagnose("policy-not-json", problem=str(error))
                raise ModelError(path, problem) from error
            network = read_rtneural(path, values)
            own = of_rtneural(values, network.inputs, network.outputs)
        else:
            graph = read_onnx(path, data)
            network, own = graph.network, of_metadata(graph.metadata)
        stated = [(str(path), own), *([(str(beside), toml)] if there else [])]
        agreed = contract_of(path, stated, network.inputs, network.outputs)
        return cls(path.name, network, agreed)

    def with_contract(self, **changed: Any) -> Policy:
        """Returns the policy with other fields of its contract."""
        return replace(self, contract=replace(self.contract, **changed))
