"""What `check` asks for a pair's key ``contract``, which names its sources."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from pupper_analysis.tools.contract.contract import read_contract
from pupper_analysis.tools.contract.findings import Disagreement


def guard(
    models: Sequence[Path], sources: Sequence[Path], names: Mapping[str, str]
) -> tuple[Disagreement, ...]:
    """Returns in what sources differ from each other and from the models; nobody stands.

    Args:
        models: URDF, MJCF, or both.
        sources: Files, or ``FILE:NAME``, or folders.
        names: {a name of a joint: the MJCF's}.
    """
    return read_contract(*models, *sources, names=names, stand=False).findings
