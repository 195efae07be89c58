"""How many designs a study has, and about how long it takes: some are timed."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pupper_analysis.base.results import Result
from pupper_analysis.tools.study.store import Store, design_keys
from pupper_analysis.tools.study.study import DesignStudy
from pupper_analysis.tools.study.worker import Chunk, measure_designs

TIMED = 5
"""So many designs are timed, evenly drawn, once the first has loaded what all need."""


@dataclass(frozen=True)
class Estimate(Result):
    """What a study would take.

    Attributes:
        designs: How many it has.
        there: How many of these are there.
        seconds_each: How long a design takes, on average of those that were timed (s).
        slowest: The slowest of these (s).
        failures: Their failures, by kind.
        left_out: Measures that were not timed, as their code would have had to be imported.
    """

    designs: int
    there: int
    seconds_each: float
    slowest: float
    failures: tuple[str, ...]
    left_out: tuple[str, ...]

    def seconds(self, workers: int) -> float:
        """Returns about how long the rest takes on some workers (s)."""
        return (self.designs - self.there) * self.seconds_each / workers


def estimate_study(study: DesignStudy, folder: Path) -> Estimate:
    """Times some designs of a study's first block, in this process; nothing is written."""
    # Without some of its measures it is another study, of which nothing is there.
    begun = (folder / "shards").is_dir() and not study.left_out
    done = Store(folder).designs() if begun else np.zeros(0, np.uint64)
    there, numbers = 0, np.zeros((0, len(study.variables)))
    names: list[str] = []
    for block_names, block in study.designs():
        there += int(np.isin(design_keys(block_names), done).sum())
        if not names:
            names, numbers = block_names, block
        if not len(done):  # nothing is there to be counted
            break
    chosen = np.unique(np.linspace(0, len(names) - 1, TIMED).astype(int))
    work = study.work()
    seconds: list[float] = []
    failures: list[str] = []
    for index in (chosen[0], *chosen):
        chunk = Chunk(work, (names[index],), (tuple(numbers[index].tolist()),))
        found = measure_designs(chunk)
        seconds.append(found.seconds)
        failures += [row["failure"] for row in found.rows if row["failure"] is not None]
    timed = seconds[1:]
    return Estimate(
        designs=len(study),
        there=there,
        seconds_each=float(np.mean(timed)),
        slowest=max(timed),
        failures=tuple(sorted(set(failures))),
        left_out=study.left_out,
    )
