"""Check refused stances: `python benchmarks/refusals.py` prints whether any of them is feasible.

Random tasks that `solve_stand` refuses are tested; a third of them have the CoM anywhere inside the
support and are moved to within 5 mm of the reachable tasks. An independent search with MuJoCo's
kinematics starts from 200 initial guesses. Each limit that a refusal states is tried as printed,
and 2 % beyond.
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
from stances import OTHERS, ReferenceTargets, other_robot, random_task

import pupper_analysis as pa
from pupper_analysis.stance.requirements import RequirementVector

NEAR_FOOT_ERROR = 5e-3
"""Foot error [m] below which a refused task counts as nearly reachable. Chosen, not tuned."""

RELATIVE_EXCESS = 0.02
"""Distance beyond a limit, towards the requested value, relative to its distance from the nominal
value. Chosen, not tuned."""
REACHED_FOOT_ERROR = 1e-8
"""Foot error [m] below which a task counts as feasible; a search ends at 1e-9."""


@dataclass
class Tally:
    """Counts and messages of a robot."""

    refusals: int = 0
    near: int = 0
    wrong: list[str] = field(default_factory=list)
    limits: int = 0
    untrue: list[str] = field(default_factory=list)
    beyond: list[str] = field(default_factory=list)
    unexplained: int = 0
    seconds: list[float] = field(default_factory=list)


def find_refusal(robot: pa.Robot, task: pa.StandTask) -> pa.StanceUnreachableError | None:
    """Return the error with which `solve_stand` refuses a task; None if solved or not valid."""
    try:
        pa.solve_stand(robot, task)
    except pa.StanceUnreachableError as error:
        return error
    except pa.ConfigurationError:
        return None
    return None


def move_to_limit(
    robot: pa.Robot, task: pa.StandTask, error: pa.StanceUnreachableError
) -> pa.StandTask | None:
    """Return a task just beyond one of the limits that a refusal states; None if there is none."""
    for limits in error.limits.values():
        end = replace(task, **limits)
        for share in (1e-3, 3e-3, 1e-2, 3e-2):
            beyond = interpolate_task(end, task, list(limits), share)
            try:
                pa.solve_stand(robot, beyond, explain=False)
            except pa.StanceUnreachableError as there:
                if max(there.shortfall.values(), default=0.0) < NEAR_FOOT_ERROR:
                    return beyond
                break
            except pa.ConfigurationError:
                break
    return None


def interpolate_task(
    end: pa.StandTask, task: pa.StandTask, fields: list[str], share: float
) -> pa.StandTask:
    """Return the task at a fraction of the way from a limit to the requested task.

    Args:
        end: Task at the limit.
        task: Requested task.
        fields: Fields to interpolate.
        share: Fraction, from 0 (limit) to 1 (request).
    """

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
    """Try each stated limit as it is, as printed, and beyond; record the wrong ones."""
    for name, limits in error.limits.items():
        tally.limits += 1
        end = replace(task, **limits)
        for asked in (end, read_printed_limit(end, str(error.possible[name]), limits)):
            try:
                pa.solve_stand(robot, asked, explain=False)
            except pa.StanceUnreachableError:
                tally.untrue.append(f"{robot.name}: {error.possible[name]}; {task!r}")
                break
        share = fraction_beyond(robot, end, task, list(limits))
        if share >= 1.0:  # that is beyond what was asked, which is refused
            continue
        beyond = interpolate_task(end, task, list(limits), share)
        try:
            pa.solve_stand(robot, beyond, explain=False)
        except (pa.StanceUnreachableError, pa.ConfigurationError):
            continue
        tally.beyond.append(f"{robot.name}: {error.possible[name]}; {task!r}")


def fraction_beyond(
    robot: pa.Robot, end: pa.StandTask, task: pa.StandTask, fields: list[str]
) -> float:
    """Return the fraction of the way from a limit to the request that is ``RELATIVE_EXCESS`` beyond
    the limit.
    """
    limits, asked = RequirementVector(robot, end, fields), RequirementVector(robot, task, fields)
    size = np.abs(limits.values - limits.nominal).sum()
    return float(RELATIVE_EXCESS * size / np.abs(asked.values - limits.values).sum())


def read_printed_limit(task: pa.StandTask, text: str, limits: dict[str, object]) -> pa.StandTask:
    """Return a task with the numbers of a limit read from its printed text."""
    for part, (name, value) in zip(text.split(" and "), limits.items(), strict=True):
        number = float(re.findall(r"[-+]?\d+\.?\d*", part)[0]) if isinstance(value, float) else None
        if number is None:
            continue
        if part.endswith("deg"):
            task = replace(task, **{name: math.radians(number)})
        else:
            task = replace(task, **{name: number * (1e-3 if part.endswith("mm") else 1.0)})
    return task


def test_refusals(robot: pa.Robot, count: int, seed: int) -> Tally:
    """Test a number of refusals of a robot, and return the counts."""
    random, tally = np.random.default_rng(seed), Tally()
    while tally.refusals < count:
        want_near = tally.near < (tally.refusals + 1) / 3
        task = random_task(robot, random)
        if want_near:
            task = replace(task, com="inside", offset=None)
        began = time.perf_counter()
        error = find_refusal(robot, task)
        if error is None:
            continue
        tally.seconds.append(time.perf_counter() - began)
        if want_near:
            nearer = move_to_limit(robot, task, error)
            if nearer is None:
                continue
            task, tally.near = nearer, tally.near + 1
            error = find_refusal(robot, task)
            if error is None:
                tally.wrong.append(f"{robot.name}: solved when explained; {task!r}")
                continue
        tally.refusals += 1
        tally.unexplained += not error.limits
        off = ReferenceTargets(robot, task).search_smallest_error(random)
        # Other people's URDFs have shapes that their MJCFs, by which it is checked, do not have.
        if off < REACHED_FOOT_ERROR and not (error.blocked and robot.name in OTHERS):
            tally.wrong.append(f"{robot.name}: in reach to {off:.1e} m; {task!r}")
        check_limits(robot, task, error, tally)
    return tally


def load_robots(folder: Path | None, names: tuple[str, ...]) -> list[pa.Robot]:
    """Return the robots of some names, or all: variants, and public robots if their folder is
    given.
    """
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
    """Search for refused stances that are feasible, and for stated limits that are wrong."""
    out = Console(width=150)
    table = Table(
        "robot", "refusals", "near reach", "in reach after all", "no limit stated",
        "limits", "not true as printed", "in reach 2 % beyond", "time (s): median, worst",
    )  # fmt: skip
    everyone = load_robots(robots, only)
    remarks: Counter[str] = Counter()
    for robot in everyone:
        tally = test_refusals(robot, count, seed)
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
