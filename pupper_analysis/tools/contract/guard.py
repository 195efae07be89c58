"""Hook of `check`: compares the files listed under a pair's key ``contract`` with the models."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from pupper_analysis.tools.contract.contract import read_contract
from pupper_analysis.tools.contract.findings import Disagreement


def guard(
    models: Sequence[Path], sources: Sequence[Path], names: Mapping[str, str]
) -> tuple[Disagreement, ...]:
    """Compare sources with each other and with the models. No stand is computed.

    Args:
        models: URDF, MJCF, or both.
        sources: Files, ``FILE:NAME``, or folders.
        names: {joint name in a source: joint name in the MJCF, or in the URDF without an MJCF}.

    Returns:
        Disagreements, the most severe first.
    """
    return read_contract(*models, *sources, names=names, stand=False).findings
