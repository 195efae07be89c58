"""A study's table: the hashes of its designs, and its rows in their order."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.arguments import check_type
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError, StudyError
from pupper_analysis.tools.study.design import ENDS
from pupper_analysis.tools.study.sampling import Sampling
from pupper_analysis.tools.study.store import Store, require_library
from pupper_analysis.tools.study.variables import make_variable

if TYPE_CHECKING:
    import pandas as pd

Array = NDArray[np.float64]


def names_of(digest: str, variables: Sequence[str], block: Array) -> list[str]:
    """Returns the hashes of designs (n, variables): of all that their results depend on.

    The order in which a study names its variables does not count.
    """
    order = sorted(range(len(variables)), key=lambda index: variables[index])
    head = "\0".join([digest, *(variables[index] for index in order)]).encode()
    rows = np.ascontiguousarray(block[:, order] + 0.0, dtype="<f8")  # 0.0: -0.0 is the same number
    return [hashlib.sha256(head + row.tobytes()).hexdigest()[:32] for row in rows]


def order_rows(frame: pd.DataFrame, order: Mapping[str, int]) -> pd.DataFrame:
    """Returns the rows of designs, {hash: place}, in their order; empty columns are left out."""
    kept = frame[frame["design"].isin(order.keys())]
    placed = kept.assign(_at=kept["design"].map(order)).sort_values("_at").drop(columns="_at")
    ends = [name for name in ENDS if name in placed]
    front = [name for name in placed.columns if name not in ends]
    return (
        placed[[*front, *ends]]
        .dropna(axis="columns", how="all")
        .reset_index(drop=True)
        .pipe(lambda table: table.assign(**{end: None for end in ENDS if end not in table}))
    )


def read_study(folder: str | Path, *, everything: bool = False) -> pd.DataFrame:
    """Reads the results in a study's folder.

    Args:
        folder: The folder.
        everything: Also the designs of what was asked before, in the order of their hashes.

    Returns:
        One row per design, as ``Study.run`` returns it; those that are there.

    Raises:
        StudyError: If it is no study's folder, or damaged.
    """
    check_type("folder", folder, str | Path)
    require_library("pandas")
    store = Store(Path(folder))
    stored = store.asked()
    if everything:
        return store.table()
    try:
        study, digest = stored["study"], str(stored["digest"])
        variables = {name: make_variable(name, given) for name, given in study["vary"].items()}
        check_type("seed", study["seed"], int)
        sampling = Sampling(variables, study.get("samples"), study["seed"])
    except (AttributeError, KeyError, TypeError, ValueError, ConfigurationError) as error:
        what = getattr(error, "diagnostic", str(error))
        if isinstance(error, KeyError):
            what = diagnose("key-missing", key=str(error))
        raise StudyError(folder, diagnose("study-does-not-say", what=what)) from error
    order: dict[str, int] = {}
    for block in sampling.blocks():
        for name in names_of(digest, tuple(variables), block):
            order.setdefault(name, len(order))
    return order_rows(store.table(), order)
