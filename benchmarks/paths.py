"""How fast robots squat, sway and lift: `python benchmarks/paths.py` prints a table, as Markdown.

For each variant and demo the least time (`fastest_path`), its lower bound, what binds, and what
MuJoCo makes of the path. Nothing here is asserted; `tests/test_fastest.py` does so.
"""

from __future__ import annotations

import click

import pupper_analysis as pa
from pupper_analysis.pupper.demo import DEMOS, demo_stances
from pupper_analysis.stance.path.fastest import RESERVE


def row(name: str, demo: str, reserve: float) -> str:
    robot = pa.load_variant(name)
    # The skeleton's hips come to their limit a seventh down.
    tasks = demo_stances(robot, demo, depth=0.2 if pa.VARIANTS[name].base == "v3" else 0.1)
    found = pa.fastest_path(robot, tasks, reserve=reserve)
    binding = found.binding
    tracking = pa.track_path(robot, found.path)
    cells = [
        name,
        demo,
        f"{found.seconds:.3f}",
        f"{found.lower_bound:.3f}",
        f"{binding.limit.value} ({', '.join(binding.names)}), {binding.progress:.0%} of leg "
        f"{binding.leg}",
        f"{found.path.peak_utilisation:.0%}",
        f"{found.path.peak_speed_utilisation:.0%}",
        f"{found.path.friction_utilisation.max():.0%}",
        "tracked" if tracking.passed else "; ".join(tracking.failures),
        f"{tracking.torque_error:.1%}",
        f"{tracking.joint_error:.4f}",
    ]
    return f"| {' | '.join(cells)} |"


@click.command()
@click.argument("names", nargs=-1)
@click.option("--reserve", default=RESERVE, show_default=True, help="Share of limits left unused.")
def main(names: tuple[str, ...], reserve: float) -> None:
    """Find the least times of variants (all six by default), and simulate them."""
    titles = ["variant", "demo", "least time (s)", "lower bound (s)", "what binds", "torque"]
    titles += ["speed", "friction", "in MuJoCo", "torque error", "joints (rad)"]
    click.echo(f"| {' | '.join(titles)} |\n|{'---|' * len(titles)}")
    for name in names or pa.VARIANTS:
        for demo in DEMOS:
            try:
                click.echo(row(name, demo, reserve))
            except pa.PupperAnalysisError as error:
                click.echo(f"| {name} | {demo} | {error} |")


if __name__ == "__main__":
    main()
