"""What each variant carries: `python benchmarks/payload.py` prints a table.

Three limits per stance, nominal and best, of which the least is the payload; and MuJoCo with 0.95
and 1.05 of it on the robot, 12 s, nudged to eight sides. Half a minute or less per variant.
"""

from __future__ import annotations

import math

import click
from rich.console import Console
from rich.table import Table

import pupper_analysis as pa
from pupper_analysis.simulation.payload import PayloadTrial

SHARES = (0.95, 1.05)


def kilograms(mass: float) -> str:
    return "-" if math.isinf(mass) else f"{math.floor(100 * mass) / 100:.2f}"


def happened(trial: PayloadTrial) -> str:
    if trial.failure is None:
        return "holds"
    return f"{trial.time:.2f} s: {trial.failure.value} ({trial.fell} of {trial.nudges})"


@click.command()
@click.argument("names", nargs=-1)
@click.option(
    "--command", type=click.Choice([c.value for c in pa.stance.PayloadCommand]), default="loaded"
)
@click.option("--dry-friction", is_flag=True, help="Simulate with the models' dry friction.")
def main(names: tuple[str, ...], command: str, dry_friction: bool) -> None:
    """Find what variants carry, and simulate it."""
    table = Table("variant", "stance", "motors", "servos", "contacts", "then", "at 0.95", "at 1.05")
    for name in names or pa.VARIANTS:
        robot = pa.load_variant(name)
        best = pa.best_stance(robot, pa.stance.Objective.PAYLOAD)
        for kind, stand in (("nominal", best.nominal), ("best", best.stand)):
            limit = pa.payload_limit(robot, stand, command=pa.stance.PayloadCommand(command))
            trials = [
                pa.simulation.simulate_payload(
                    robot,
                    stand,
                    share * limit.mass,
                    command=pa.stance.PayloadCommand(command),
                    dry_friction=dry_friction,
                )
                for share in SHARES
            ]
            table.add_row(
                name,
                kind,
                *(kilograms(b.mass) for b in (limit.motors, limit.servos, limit.contacts)),
                limit.failure.value,
                *map(happened, trials),
            )
    Console(width=170).print(table)


if __name__ == "__main__":
    main()
