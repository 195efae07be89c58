"""RTNeural's JSON, as Pupper's neural controller reads it: what it states beside its layers."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import orjson

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import InputError, ModelError
from pupper_analysis.base.inputs import MOST_FILE, read_input
from pupper_analysis.models.places import Place, refuse_file, refuse_input
from pupper_analysis.tools.contract.facts import Request, Role, Source, Statement
from pupper_analysis.tools.contract.readers.tables import is_network, of_table, read_documents

SUFFIXES = (".json",)


@dataclass(frozen=True, eq=False)
class RtneuralFile:
    """RTNeural's JSON.

    Attributes:
        values: What it holds, with its layers as they are.
        inputs: How many numbers the network takes; 0 if it does not say.
        outputs: How many it gives.
    """

    values: dict[str, Any]
    inputs: int
    outputs: int


def read_rtneural(path: Path) -> RtneuralFile:
    """Reads RTNeural's JSON.

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
    layers = values.get("layers") if isinstance(values, dict) else None
    if not isinstance(layers, list):
        raise ModelError(path, diagnose("contract-no-rtneural"))
    last = layers[-1] if layers and isinstance(layers[-1], dict) else {}
    return RtneuralFile(values, _last(values.get("in_shape")), _last(last.get("shape")))


def _last(sizes: Any) -> int:
    size = sizes[-1] if isinstance(sizes, list) and sizes else 0
    return size if isinstance(size, int) else 0


def read(request: Request) -> Iterator[Source]:
    """Yields what a policy states beside its layers."""
    for document in read_documents(request):
        if is_network(document):
            file = read_rtneural(request.path)
            sizes = {"actions": file.outputs, "observed numbers": file.inputs}
            more = [Statement(what, float(size), document.place)
                    for what, size in sizes.items() if size]  # fmt: skip
            yield from of_table(request, request.path.name, document, Role.POLICY, more)
