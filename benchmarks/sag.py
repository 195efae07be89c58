"""Compares predicted sag with simulations: `python benchmarks/sag.py lifted`, `limits`."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import click
import mujoco
import mujoco.rollout
import numpy as np
from rich.console import Console
from rich.table import Table

import pupper_analysis as pa
from pupper_analysis.base.errors import PupperAnalysisError
from pupper_analysis.robot import contact
from pupper_analysis.stance.sag.steady_state import RELEASE_MARGIN, SteadyState, steady_state

SECONDS = 12.0
"""A simulation's length (s). Its settled height is the mean of the last second."""

WITHIN = 2e-4
"""A height that is predicted this well is right (m)."""


@click.group()
def main() -> None:
    """Compare predicted sag with MuJoCo's simulation."""


# ------------------------------------------------------------------------------------- grounds


def changed(robot: pa.Robot, change: Callable[[mujoco.MjModel], None]) -> pa.Robot:
    """The robot with another MuJoCo model, and the contacts that it has there."""
    model = copy.copy(robot.mj_model)
    change(model)
    ground = contact.ground_geom(model)
    contacts = {
        foot: contact.combine_geoms(model, geom, ground) for geom, foot in robot.foot_geoms.items()
    }
    return replace(robot, mj_model=model, contacts=contacts)


def gripping(model: mujoco.MjModel) -> None:
    """Dry friction, of feet and joints, that does not creep."""
    model.opt.noslip_iterations = 20


def without_dry_friction(model: mujoco.MjModel) -> None:
    """Neither joints nor rolling or spinning feet rub; creep is as it was."""
    model.geom_condim[:] = 3
    model.dof_frictionloss[:] = 0


# ------------------------------------------------------------------------------------- lifted feet


@dataclass(frozen=True)
class Case:
    """One swing foot, predicted and simulated; heights in mm."""

    foot: str
    lift: float
    kp: float
    pose: SteadyState | None
    run: pa.simulation.StandVerification

    @property
    def problems(self) -> list[str]:
        """Why it is not predicted to stand, but for the swing foot's touching."""
        if self.pose is None:
            return ["no equilibrium"]
        return [str(one) for one in self.pose.failures if one.code != "lifted-foot-presses"]

    @property
    def touches(self) -> bool:
        return self.pose is not None and self.foot in self.pose.stance_feet

    @property
    def error(self) -> float:
        assert self.pose is not None
        return 1e3 * abs(self.pose.base_height - self.run.base_height)

    @property
    def firm(self) -> bool:
        return self.pose is not None and self.pose.release_margin > RELEASE_MARGIN


def stands(robot: pa.Robot, stand: pa.Stand, kp: float) -> bool:
    """Tells whether it stands, on the swing foot as well if that comes down."""
    try:
        pose = steady_state(robot, stand, kp=kp)
    except PupperAnalysisError:
        return False
    return all(one.code == "lifted-foot-presses" for one in pose.failures)


def least_stiffness(does: Callable[[float], bool]) -> float:
    low, high = 0.0, 1.0
    while not does(high):
        low, high = high, 2 * high
    while high - low > 0.02 * high:
        middle = (low + high) / 2
        low, high = (low, middle) if does(middle) else (middle, high)
    return high


def cases(robot: pa.Robot, lifts: tuple[float, ...], times: tuple[float, ...]) -> Iterator[Case]:
    for foot in robot.contact_points:
        for lift in lifts:
            task = pa.StandTask(swing={foot: lift}, com="inside", com_margin=0.01)
            stand = pa.solve_stand(robot, task)
            least = least_stiffness(lambda kp, stand=stand: stands(robot, stand, kp))
            for kp in least * np.array(times):
                run = pa.verify_stand(
                    robot, stand, feedforward=False, kp=kp, duration=SECONDS, nudged=0
                )
                try:
                    pose = steady_state(robot, stand, kp=kp, seconds=SECONDS - 0.5)
                except pa.NoEquilibriumError:
                    pose = None
                yield Case(foot, lift, float(kp), pose, run)


@main.command()
@click.option("--variant", type=click.Choice(list(pa.VARIANTS)), multiple=True)
@click.option("--swing", type=float, multiple=True, default=(0.002, 0.006, 0.02), show_default=True)
@click.option("--times", type=float, multiple=True, default=(1.05, 1.5, 3.0), show_default=True)
@click.option("--verbose", is_flag=True, help="Print every case.")
def lifted(
    variant: tuple[str, ...],
    lift: tuple[float, ...],
    times: tuple[float, ...],
    verbose: bool,
) -> None:
    """Lift each foot, on servos of so many times the minimum stiffness."""
    columns = ("variant", "simulated", "said not to stand", "touch", "firm", "worst (mm)")
    table = Table(*columns, "not firm", "worst (mm)")
    for name in variant or pa.VARIANTS:
        robot = pa.load_variant(name)
        found = []
        for case in cases(robot, lift, times):
            found.append(case)
            if verbose:
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
        f"{' touches' if case.touches else ''} {case.problems} | {case.run.failures}",
        flush=True,
    )


def summary(errors: list[float]) -> tuple[str, str]:
    right = sum(error < 1e3 * WITHIN for error in errors)
    return f"{right} of {len(errors)}", f"{max(errors):.3f}" if errors else "-"


# ------------------------------------------------------------------------------------- limits


@main.command()
def limits() -> None:
    """Let v3 go just above the minimum stiffness, and heavy on motors a little too weak."""
    robot = pa.load_variant("v3")
    stand, table = pa.solve_stand(robot), Table("impratio", "kp / minimum", "lost (mm)", "knees")
    least = pa.stance.minimum_stiffness(robot, stand)
    for impratio in (1.0, 100.0, 1e4):

        def grip(model: mujoco.MjModel, impratio: float = impratio) -> None:
            model.opt.impratio = impratio

        for times in (1.05, 1.1, 1.3):
            run = pa.verify_stand(
                changed(robot, grip),
                stand,
                feedforward=False,
                kp=times * least,
                duration=SECONDS,
                nudged=0,
            )
            down = any(one.code == "body-touches-ground" for one in run.failures)
            knees = "touch the ground" if down else "-"
            lost = f"{1e3 * run.height_loss:.2f}"
            table.add_row(f"{impratio:g}", f"{times:g}", lost, knees)
    Console().print(table)
    robot, table = pa.load_variant("heavy"), Table("torque limit (N m)", "predicted", "let go")
    stand = pa.solve_stand(robot)
    for limit in (0.632, 0.636, 0.64, 0.65, 0.66):

        def weaken(model: mujoco.MjModel, limit: float = limit) -> None:
            model.actuator_forcerange[:] = -limit, limit

        weak = changed(robot, weaken)
        try:
            predicted = f"{1e3 * steady_state(weak, stand).height_loss:.3f} mm"
        except pa.NoEquilibriumError:
            predicted = "no equilibrium"
        run = pa.verify_stand(weak, stand, feedforward=False, duration=SECONDS, nudged=0)
        lost = f"{1e3 * run.height_loss:.3f} mm" if run.passed else "collapses"
        table.add_row(f"{limit:g}", predicted, lost)
    Console().print(table)


if __name__ == "__main__":
    main()
