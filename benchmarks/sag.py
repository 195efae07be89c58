"""Compares predicted sag with simulations: `python benchmarks/sag.py lifted|band|words`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import click
import numpy as np
from rich.console import Console
from rich.table import Table

import pupper_analysis as pa
from pupper_analysis.errors import PupperAnalysisError
from pupper_analysis.settle import RELEASE_MARGIN, SettledPose, settled_pose

SECONDS = 12.0
"""A simulation's length (s). Its settled height is the mean of the last second."""

WITHIN = 2e-4
"""A height that is predicted this well is right (m)."""


@dataclass(frozen=True)
class Case:
    """One lifted foot, predicted and simulated; heights in mm."""

    foot: str
    lift: float
    kp: float
    pose: SettledPose | None
    run: pa.StandVerification

    @property
    def problems(self) -> list[str]:
        """Why it is not predicted to stand, but for the lifted foot's touching."""
        if self.pose is None:
            return ["no equilibrium"]
        return [text for text in self.pose.failures if ", lifted," not in text]

    @property
    def touches(self) -> bool:
        return self.pose is not None and self.foot in self.pose.carrying

    @property
    def error(self) -> float:
        assert self.pose is not None
        return 1e3 * abs(self.pose.base_height - self.run.base_height)

    @property
    def firm(self) -> bool:
        return self.pose is not None and self.pose.release_margin > RELEASE_MARGIN


def stands(robot: pa.Robot, stand: pa.Stand, kp: float) -> bool:
    """Tells whether it stands, on the lifted foot as well if that comes down."""
    try:
        pose = settled_pose(robot, stand, kp=kp)
    except PupperAnalysisError:
        return False
    return not [text for text in pose.failures if ", lifted," not in text]


def softest(does: Callable[[float], bool]) -> float:
    low, high = 0.0, 1.0
    while not does(high):
        low, high = high, 2 * high
    while high - low > 0.02 * high:
        middle = (low + high) / 2
        low, high = (low, middle) if does(middle) else (middle, high)
    return high


def cases(robot: pa.Robot, lifts: tuple[float, ...], times: tuple[float, ...]) -> Iterator[Case]:
    for foot in robot.feet:
        for lift in lifts:
            task = pa.StandTask(lifted={foot: lift}, com="inside", com_margin=0.01)
            stand = pa.solve_stand(robot, task)
            least = softest(lambda kp, stand=stand: stands(robot, stand, kp))
            for kp in least * np.array(times):
                run = pa.verify_stand(robot, stand, feedforward=False, kp=kp, duration=SECONDS)
                try:
                    pose = settled_pose(robot, stand, kp=kp, seconds=SECONDS - 0.5)
                except pa.NoEquilibriumError:
                    pose = None
                yield Case(foot, lift, float(kp), pose, run)


@click.group()
def main() -> None:
    """Compare predicted sag with MuJoCo's simulation."""


@main.command()
@click.option("--variant", type=click.Choice(list(pa.VARIANTS)), multiple=True)
@click.option("--lift", type=float, multiple=True, default=(0.002, 0.006, 0.02), show_default=True)
@click.option("--times", type=float, multiple=True, default=(1.05, 1.5, 3.0), show_default=True)
@click.option("--verbose", is_flag=True, help="Print every case.")
def lifted(
    variant: tuple[str, ...], lift: tuple[float, ...], times: tuple[float, ...], verbose: bool
) -> None:
    """Lift each foot, on servos of so many times the softest that carry the robot."""
    columns = ("variant", "simulated", "said not to stand", "touch", "firm", "worst (mm)")
    table = Table(*columns, "not firm", "worst (mm)", f"{SECONDS:g} s, without feed-forward")
    for name in variant or pa.VARIANTS:
        robot = pa.load_variant(name)
        found = list(cases(robot, lift, times))
        if verbose:
            for case in found:
                show(name, case)
        standing = [case for case in found if not case.problems]
        firm = [case.error for case in standing if case.firm]
        loose = [case.error for case in standing if not case.firm]
        row = [len(found), len(found) - len(standing), sum(case.touches for case in standing)]
        table.add_row(name, *map(str, row), *summary(firm), *summary(loose))
    Console().print(table)


def show(name: str, case: Case) -> None:
    what = "-" if case.pose is None else f"{1e3 * case.pose.height_loss:.3f}"
    margin = "-" if case.pose is None else f"{case.pose.release_margin:.3f}"
    error = "-" if case.pose is None else f"{case.error:.3f}"
    print(
        f"{name:12} {case.foot} {1e3 * case.lift:4.0f} mm kp {case.kp:6.2f} predicted {what:>7} "
        f"simulated {1e3 * case.run.height_loss:7.3f} off {error:>6} margin {margin:>6}"
        f"{' touches' if case.touches else ''} {case.problems} | {case.run.failures}", flush=True
    )


def summary(errors: list[float]) -> tuple[str, str]:
    right = sum(error < 1e3 * WITHIN for error in errors)
    return f"{right} of {len(errors)}", f"{max(errors):.3f}" if errors else "-"


if __name__ == "__main__":
    main()
