"""Refused stances: `python benchmarks/refusals.py` prints whether any is in reach after all.

Random tasks that `solve_stand` refuses, a third of them with the com anywhere inside and brought to
within 5 mm of reach. Each is searched for from 200 starts with MuJoCo's kinematics, and every limit
that a refusal states is tried as it is printed, and 2 % beyond.
"""

from __future__ import annotations

import math
import re
import time
from collections import Counter
from dataclasses import dataclass, field, replace
from pathlib import Path

import click
import numpy as np
from rich.console import Console
from rich.table import Table
from stances import OTHERS, Demand, other_robot, random_task

import pupper_analysis as pa
from pupper_analysis.stance.demands import DemandVector

NEAR = 5e-3
"""A refused stance whose feet miss by less is within reach's edge (m)."""

BEYOND = 0.02
"""How far beyond a limit, towards what was asked, in parts of its distance from the nominal."""
REACHED = 1e-8
"""A stance to which a search comes as near is in reach (m); it ends at 1e-9 where it can."""


@dataclass
class Tally:
    refusals: int = 0
    near: int = 0
    wrong: list[str] = field(default_factory=list)
    limits: int = 0
    untrue: list[str] = field(default_factory=list)
    beyond: list[str] = field(default_factory=list)
    unexplained: int = 0
    seconds: list[float] = field(default_factory=list)


def refusal(robot: pa.Robot, task: pa.StandTask) -> pa.StanceUnreachableError | None:
    try:
        pa.solve_stand(robot, task)
    except pa.StanceUnreachableError as error:
        return error
    except pa.ConfigurationError:
        return None
    return None


def brought_near(
    robot: pa.Robot, task: pa.StandTask, error: pa.StanceUnreachableError
) -> pa.StandTask | None:
    """A task just beyond one of the limits that a refusal states; None if it states none."""
    for limits in error.limits.values():
        end = replace(task, **limits)
        for share in (1e-3, 3e-3, 1e-2, 3e-2):
            beyond = between(end, task, list(limits), share)
            try:
                pa.solve_stand(robot, beyond, explain=False)
            except pa.StanceUnreachableError as there:
                if max(there.shortfall.values(), default=0.0) < NEAR:
                    return beyond
                break
            except pa.ConfigurationError:
                break
    return None


def between(end: pa.StandTask, task: pa.StandTask, fields: list[str], share: float) -> pa.StandTask:
    """A task that is a share of the way from a limit to what was asked."""

    def mixed(one: object, two: object) -> object:
        if isinstance(one, float | int):
            return one + share * (two - one)  # type: ignore[operator]
        if isinstance(one, tuple):
            return tuple(mixed(a, b) for a, b in zip(one, two, strict=True))  # type: ignore[call-overload]
        if isinstance(one, pa.Ground):
            assert isinstance(two, pa.Ground)
            return pa.Ground(
                one.slope + share * (two.slope - one.slope),
                one.uphill,
                {foot: mixed(h, two.heights[foot]) for foot, h in one.heights.items()},  # type: ignore[misc]
            )
        return {key: mixed(value, two[key]) for key, value in one.items()}  # type: ignore[attr-defined,index]

    return replace(end, **{name: mixed(getattr(end, name), getattr(task, name)) for name in fields})


def check_limits(
    robot: pa.Robot, task: pa.StandTask, error: pa.StanceUnreachableError, tally: Tally
) -> None:
    """Tries each stated limit as it is, as it is printed, and beyond."""
    for name, limits in error.limits.items():
        tally.limits += 1
        end = replace(task, **limits)
        for asked in (end, as_printed(end, str(error.possible[name]), limits)):
            try:
                pa.solve_stand(robot, asked, explain=False)
            except pa.StanceUnreachableError:
                tally.untrue.append(f"{robot.name}: {error.possible[name]}; {task!r}")
                break
        share = share_beyond(robot, end, task, list(limits))
        if share >= 1.0:  # that is beyond what was asked, which is refused
            continue
        beyond = between(end, task, list(limits), share)
        try:
            pa.solve_stand(robot, beyond, explain=False)
        except (pa.StanceUnreachableError, pa.ConfigurationError):
            continue
        tally.beyond.append(f"{robot.name}: {error.possible[name]}; {task!r}")


def share_beyond(
    robot: pa.Robot, end: pa.StandTask, task: pa.StandTask, fields: list[str]
) -> float:
    """What share of the way from a limit to what was asked is ``BEYOND`` it."""
    limits, asked = DemandVector(robot, end, fields), DemandVector(robot, task, fields)
    size = np.abs(limits.values - limits.nominal).sum()
    return float(BEYOND * size / np.abs(asked.values - limits.values).sum())


def as_printed(task: pa.StandTask, text: str, limits: dict[str, object]) -> pa.StandTask:
    """The task with single numbers of a limit read back from its words."""
    for part, (name, value) in zip(text.split(" and "), limits.items(), strict=True):
        number = float(re.findall(r"[-+]?\d+\.?\d*", part)[0]) if isinstance(value, float) else None
        if number is None:
            continue
        if part.endswith("deg"):
            task = replace(task, **{name: math.radians(number)})
        else:
            task = replace(task, **{name: number * (1e-3 if part.endswith("mm") else 1.0)})
    return task


def collect(robot: pa.Robot, count: int, seed: int) -> Tally:
    random, tally = np.random.default_rng(seed), Tally()
    while tally.refusals < count:
        want_near = tally.near < (tally.refusals + 1) / 3
        task = random_task(robot, random)
        if want_near:
            task = replace(task, com="inside", offset=None)
        began = time.perf_counter()
        error = refusal(robot, task)
        if error is None:
            continue
        tally.seconds.append(time.perf_counter() - began)
        if want_near:
            nearer = brought_near(robot, task, error)
            if nearer is None:
                continue
            task, tally.near = nearer, tally.near + 1
            error = refusal(robot, task)
            if error is None:
                tally.wrong.append(f"{robot.name}: solved when explained; {task!r}")
                continue
        tally.refusals += 1
        tally.unexplained += not error.limits
        off = Demand(robot, task).nearest(random)
        # Other people's URDFs have shapes that their MJCFs, by which it is checked, do not have.
        if off < REACHED and not (error.blocked and robot.name in OTHERS):
            tally.wrong.append(f"{robot.name}: in reach to {off:.1e} m; {task!r}")
        check_limits(robot, task, error, tally)
    return tally


def chosen(folder: Path | None, names: tuple[str, ...]) -> list[pa.Robot]:
    """The robots of some names, or all: variants, and other people's if their folder is given."""
    known = [*pa.VARIANTS, *(OTHERS if folder else ())]
    for name in names:
        if name not in known:
            hint = ", and with --robots FOLDER: " + ", ".join(OTHERS) if folder is None else ""
            raise click.BadParameter(f"no robot {name!r}; there are: {', '.join(known)}{hint}")
    return [
        other_robot(folder, name) if folder and name in OTHERS else pa.load_variant(name)
        for name in names or known
    ]


@click.command()
@click.option("--count", default=75, show_default=True, help="Refusals per robot.")
@click.option("--seed", default=0, show_default=True)
@click.option("--robots", type=click.Path(path_type=Path), help="Other people's: see stances.py.")
@click.option(
    "--only", multiple=True, help="Names of variants and of other people's; all by default."
)
def main(count: int, seed: int, robots: Path | None, only: tuple[str, ...]) -> None:
    """Looks for refused stances that are in reach, and for limits that are not true."""
    out = Console(width=150)
    table = Table(
        "robot", "refusals", "near reach", "in reach after all", "no limit stated",
        "limits", "not true as printed", "in reach 2 % beyond", "time (s): median, worst",
    )  # fmt: skip
    everyone = chosen(robots, only)
    remarks: Counter[str] = Counter()
    for robot in everyone:
        tally = collect(robot, count, seed)
        table.add_row(
            robot.name, *(str(number) for number in (
                tally.refusals, tally.near, len(tally.wrong), tally.unexplained,
                tally.limits, len(tally.untrue), len(tally.beyond),
            )),
            f"{np.median(tally.seconds):.2f}, {max(tally.seconds):.1f}",
        )  # fmt: skip
        for text in (*tally.wrong, *tally.untrue, *(f"beyond: {b}" for b in tally.beyond)):
            remarks[text] += 1
    out.print(table)
    for text in remarks:
        out.print(text, soft_wrap=True)


if __name__ == "__main__":
    main()
