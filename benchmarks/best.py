"""Compare ``best_stance`` with differential evolution: `python benchmarks/best.py` prints a table.

Differential evolution evaluates a single number per stance and uses neither gradients nor initial
guesses of `best_stance`. A row takes one to two minutes for 20,000 evaluations.
"""

from __future__ import annotations

import time

import click
import numpy as np
from rich.console import Console
from rich.table import Table
from scipy import optimize

import pupper_analysis as pa
from pupper_analysis.tools.best.search import Objective, StanceSearch, Subspace

REFUSED = 1e3
"""Cost that is higher than that of any permitted stance; the constraint violation is added."""

POPULATION = 15  # per coordinate, as scipy has it
"""Number of candidates per coordinate: the default of scipy."""


def run_evolution(search: StanceSearch, subspace: Subspace, evaluations: int, seed: int) -> int:
    """Run differential evolution on a search, which keeps the best stance; return the evaluations.

    Args:
        search: Search of the best stance; modified.
        subspace: Coordinates, each from 0 to 1.
        evaluations: Approximate number of evaluations.
        seed: Seed of the random numbers.
    """
    count = 0

    def cost(share: np.ndarray) -> float:
        nonlocal count
        count += 1
        search.known.clear()  # of no use here, and it grows
        stance = search.evaluate(subspace.compute_coordinates(share))
        if stance is None:
            return 2 * REFUSED
        if stance.allowed:
            return stance.scaled_objective
        return REFUSED + search.merit(stance)

    size = POPULATION * subspace.size
    optimize.differential_evolution(
        cost,
        [(0.0, 1.0)] * subspace.size,
        popsize=POPULATION,
        maxiter=max(1, evaluations // size - 1),
        tol=0.0,
        atol=0.0,
        polish=False,
        rng=np.random.default_rng(seed),
    )
    return count


@click.command()
@click.argument("names", nargs=-1)
@click.option("--objective", type=click.Choice([kind.value for kind in Objective]), multiple=True)
@click.option("--evaluations", default=20_000, show_default=True, help="Of differential evolution.")
@click.option("--apart", is_flag=True, help="With each coordinate free, not the feet together.")
@click.option("--seed", default=0, show_default=True)
def main(
    names: tuple[str, ...],
    objective: tuple[str, ...],
    evaluations: int,
    apart: bool,
    seed: int,
) -> None:
    """Compare the best stance with the result of differential evolution."""
    table = Table("variant", "objective", "nominal", "best_stance", "stances", "CPU s")
    for column in ("evolution", "stances", "CPU s", "better by"):
        table.add_column(column, justify="right")
    for name in names or pa.VARIANTS:
        robot = pa.load_variant(name)
        for what in objective or Objective:
            ours, theirs = (StanceSearch(robot, Objective(what)) for _ in range(2))
            began = time.process_time()
            ours.run()
            between = time.process_time()
            space = theirs.space
            free = np.eye(len(space.start)) if apart else space.coupled_directions()
            count = run_evolution(theirs, Subspace(space, space.start, free), evaluations, seed)
            ended = time.process_time()
            first, second = -ours.best.scaled_objective, -theirs.best.scaled_objective
            table.add_row(
                name,
                Objective(what).value,
                f"{ours.compute_objective(space.nominal):.5g}",
                f"{ours.scale * abs(first):.5g}",
                f"{ours.evaluations}",
                f"{between - began:.1f}",
                f"{theirs.scale * abs(second):.5g}",
                f"{count}",
                f"{ended - between:.0f}",
                f"{(second - first) / abs(first):+.2%}",  # positive: evolution's is the better one
            )
    Console(width=130).print(table)


if __name__ == "__main__":
    main()
