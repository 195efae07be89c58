"""Payload of each variant: `python benchmarks/payload.py` prints a table.

For the nominal and the best stance, the table contains the bounds by motors, servos and reach; the
smallest is the payload. MuJoCo then simulates this payload for 12 s, with nudges in all directions.
At most half a minute per variant.
"""

from __future__ import annotations

import math

import click
from rich.console import Console
from rich.table import Table

import pupper_analysis as pa
from pupper_analysis.tools.payload.limit import PayloadTrial


def format_mass(mass: float) -> str:
    """Return a mass [kg] as text, rounded down to 10 g; "-" if infinite."""
    return "-" if math.isinf(mass) else f"{math.floor(100 * mass) / 100:.2f}"


def describe_trial(trial: PayloadTrial | None) -> str:
    """Return the result of a simulated payload as text; "-" without simulation."""
    if trial is None:
        return "-"
    if trial.failure is None:
        return "holds"
    return f"{trial.time:.2f} s: {trial.failure.value} ({trial.failed_nudges} of {trial.nudges})"


@click.command()
@click.argument("names", nargs=-1)
def main(names: tuple[str, ...]) -> None:
    """Compute the payloads of variants, and simulate them."""
    table = Table("variant", "stance", "motors", "servos", "reach", "then", "nudged")
    for name in names or pa.VARIANTS:
        robot = pa.load_variant(name)
        best = pa.best_stance(robot, pa.stance.Objective.PAYLOAD)
        for kind, stand in (("nominal", best.nominal), ("best", best.stand)):
            limit = pa.payload_limit(robot, stand)
            table.add_row(
                name,
                kind,
                *(format_mass(b.mass) for b in (limit.motors, limit.servos, limit.stance)),
                limit.failure.value,
                describe_trial(limit.trial),
            )
    Console(width=170).print(table)


if __name__ == "__main__":
    main()
