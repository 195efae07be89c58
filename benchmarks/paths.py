"""How fast robots squat, sway and lift: `python benchmarks/paths.py` prints a table, as Markdown.

For each variant and demo the least time (`fastest_path`), its lower bound, what binds, and what
MuJoCo makes of the path; of robots of others (a1, go1, anymal, hyq, laikago: URDFs of
example-robot-data, converted) squat and sway. Nothing here is asserted;
`tests/stance/path/test_fastest.py` does so.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import click

import pupper_analysis as pa
from pupper_analysis.pupper.demo import DEMOS, demo_stances
from pupper_analysis.stance.path.fastest import RESERVE

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from tests.support.bases import published

OTHERS = {
    "a1": "a1_description/urdf/a1.urdf",
    "go1": "go1_description/urdf/go1.urdf",
    "anymal": "anymal_c_simple_description/urdf/anymal.urdf",
    "hyq": "hyq_description/robots/hyq_no_sensors.urdf",
    "laikago": "laikago_description/urdf/laikago.urdf",
}
"""{robot of others: its URDF in example-robot-data}."""


def other(name: str) -> pa.Robot:
    """Converts a robot of others, and loads it."""
    with tempfile.TemporaryDirectory() as folder:
        pair = published(OTHERS[name])(Path(folder))
        return pa.load_robot(urdf=pair.urdf, mjcf=pair.mjcf)


def tasks_of(robot: pa.Robot, name: str, demo: str) -> list[pa.StandTask]:
    """Returns the stances of a demo: of others' robots a tenth of the height down, and aside."""
    if name in OTHERS and demo == "sway":
        side = 0.1 * robot.stand_height
        places = [pa.StandTask(offset=(0.0, y)) for y in (side, -side)]
        return [pa.StandTask(), *places, pa.StandTask()]
    # The skeleton's hips come to their limit a seventh down.
    v3 = name not in OTHERS and pa.VARIANTS[name].base == "v3"
    return demo_stances(robot, demo, depth=0.2 if v3 else 0.1)


def row(name: str, robot: pa.Robot, demo: str, reserve: float) -> str:
    tasks = tasks_of(robot, name, demo)
    found = pa.stance.fastest_path(robot, tasks, reserve=reserve)
    binding = found.binding
    tracking = pa.simulation.track_path(robot, found.path)
    cells = [
        name,
        demo,
        f"{found.seconds:.3f}",
        f"{found.lower_bound:.3f}",
        f"{binding.limit.value} ({', '.join(binding.names)}), {binding.progress:.0%} of leg "
        f"{binding.segment}",
        f"{found.path.peak_utilisation:.0%}",
        f"{found.path.peak_speed_utilisation:.0%}",
        f"{found.path.friction_utilisation.max():.0%}",
        "tracked" if tracking.passed else "; ".join(map(str, tracking.failures)),
        f"{tracking.torque_error:.1%}",
        f"{tracking.joint_error:.4f}",
    ]
    return f"| {' | '.join(cells)} |"


@click.command()
@click.argument("names", nargs=-1)
@click.option("--reserve", default=RESERVE, show_default=True, help="Share of limits left unused.")
def main(names: tuple[str, ...], reserve: float) -> None:
    """Find the least times of robots (all six variants by default), and simulate them."""
    titles = ["variant", "demo", "least time (s)", "lower bound (s)", "what binds", "torque"]
    titles += ["speed", "friction", "in MuJoCo", "torque error", "joints (rad)"]
    click.echo(f"| {' | '.join(titles)} |\n|{'---|' * len(titles)}")
    for name in names or pa.VARIANTS:
        robot = other(name) if name in OTHERS else pa.load_variant(name)
        for demo in ("squat", "sway") if name in OTHERS else DEMOS:
            try:
                click.echo(row(name, robot, demo, reserve))
            except pa.PupperAnalysisError as error:
                click.echo(f"| {name} | {demo} | {error} |")


if __name__ == "__main__":
    main()
