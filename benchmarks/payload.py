"""What each variant carries: `python benchmarks/payload.py` prints a table.

The bounds per stance, nominal and best, of which the least is the payload; and MuJoCo with 0.97 and
1.05 of it on the robot, 12 s, nudged to all sides. Half a minute or less per variant.
"""

from __future__ import annotations

import math

import click
from rich.console import Console
from rich.table import Table

import pupper_analysis as pa
from pupper_analysis.tools.payload.limit import PayloadTrial


def kilograms(mass: float) -> str:
    return "-" if math.isinf(mass) else f"{math.floor(100 * mass) / 100:.2f}"


def happened(trial: PayloadTrial | None) -> str:
    if trial is None:
        return "-"
    if trial.failure is None:
        return "holds"
    return f"{trial.time:.2f} s: {trial.failure.value} ({trial.failed_nudges} of {trial.nudges})"


@click.command()
@click.argument("names", nargs=-1)
def main(names: tuple[str, ...]) -> None:
    """Find what variants carry, and simulate it."""
    table = Table("variant", "stance", "motors", "servos", "reach", "then", "at 0.97", "at 1.05")
    for name in names or pa.VARIANTS:
        robot = pa.load_variant(name)
        best = pa.best_stance(robot, pa.stance.Objective.PAYLOAD)
        for kind, stand in (("nominal", best.nominal), ("best", best.stand)):
            limit = pa.payload_limit(robot, stand)
            table.add_row(
                name,
                kind,
                *(kilograms(b.mass) for b in (limit.motors, limit.servos, limit.stance)),
                limit.failure.value,
                happened(limit.trial),
                happened(limit.beyond),
            )
    Console(width=170).print(table)


if __name__ == "__main__":
    main()
