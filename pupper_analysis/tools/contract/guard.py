"""Hook of `check`: compares the files listed under a pair's key ``contract`` with the models."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from pupper_analysis.tools.contract.contract import read_contract
from pupper_analysis.tools.contract.findings import Disagreement, make_unread_finding


def guard(
    models: Sequence[Path], sources: Sequence[Path], names: Mapping[str, str]
) -> tuple[Disagreement, ...]:
    """List the disagreements between controller files, and between these files and the robot model.

    This function is called by the command `check`. The sources are files of training, policy,
    deployment or motor drivers.

    Args:
        models: Path of the URDF or MJCF, or of both.
        sources: Paths of files or folders, or ``FILE:NAME`` to select a configuration in a file.
        names: {joint name in a source: joint name in the MJCF, or in the URDF without an MJCF}.

    Returns:
        Sources and quantities that were not compared, then disagreements, the most severe first.

    Raises:
        ModelError: If no model can be read, or no source can be used, for example.
    """
    contract = read_contract(*models, *sources, names=names, stand=False)
    return (*map(make_unread_finding, contract.unread), *contract.findings)
