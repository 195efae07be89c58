"""Compare predicted sag with simulations: `python benchmarks/sag.py lifted`, `limits`."""

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
"""Simulated time [s]; the height at rest is the mean of the last second."""

HEIGHT_TOLERANCE = 2e-4
"""Largest error of a predicted height [m] that counts as right. Chosen, not tuned."""


@click.group()
def main() -> None:
    """Compare predicted sag with MuJoCo's simulation."""


# ------------------------------------------------------------------------------------- grounds


def change_model(robot: pa.Robot, change: Callable[[mujoco.MjModel], None]) -> pa.Robot:
    """Return the robot with a changed copy of its MuJoCo model, and the resulting contacts."""
    model = copy.copy(robot.mj_model)
    change(model)
    ground = contact.ground_geom(model)
    contacts = {
        foot: contact.combine_geoms(model, geom, ground) for geom, foot in robot.foot_geoms.items()
    }
    return replace(robot, mj_model=model, contacts=contacts)


def disable_creep(model: mujoco.MjModel) -> None:
    """Enable MuJoCo's ``noslip`` iterations, so that dry friction does not creep."""
    model.opt.noslip_iterations = 20


def remove_dry_friction(model: mujoco.MjModel) -> None:
    """Remove friction loss, and torsional and rolling friction; sliding friction still creeps."""
    model.geom_condim[:] = 3
    model.dof_frictionloss[:] = 0


# ------------------------------------------------------------------------------------- lifted feet


@dataclass(frozen=True)
class Case:
    """Stand on three feet with a lifted foot, predicted and simulated.

    Attributes:
        foot: The lifted foot.
        lift: Height of the foot [m].
        kp: Stiffness of the servos [N m/rad].
        pose: Predicted equilibrium; None if there is none.
        run: Simulation.
    """

    foot: str
    lift: float
    kp: float
    pose: SteadyState | None
    run: pa.simulation.StandVerification

    @property
    def problems(self) -> list[str]:
        """Reasons why the prediction fails, except contact of the lifted foot."""
        if self.pose is None:
            return ["no equilibrium"]
        return [str(one) for one in self.pose.failures if one.code != "lifted-foot-presses"]

    @property
    def touches(self) -> bool:
        """Whether the lifted foot touches the ground in the prediction."""
        return self.pose is not None and self.foot in self.pose.stance_feet

    @property
    def error(self) -> float:
        """Difference of predicted and simulated base height [mm]."""
        assert self.pose is not None
        return 1e3 * abs(self.pose.base_height - self.run.base_height)

    @property
    def firm(self) -> bool:
        """Whether the release margin of the prediction is sufficient."""
        return self.pose is not None and self.pose.release_margin > RELEASE_MARGIN


def is_predicted_to_stand(robot: pa.Robot, stand: pa.Stand, kp: float) -> bool:
    """Return True if a robot is predicted to stand, possibly on the lifted foot as well."""
    try:
        pose = steady_state(robot, stand, kp=kp)
    except PupperAnalysisError:
        return False
    return all(one.code == "lifted-foot-presses" for one in pose.failures)


def search_min_stiffness(does: Callable[[float], bool]) -> float:
    """Return the smallest stiffness [N m/rad] for which a function returns True, within 2 %."""
    low, high = 0.0, 1.0
    while not does(high):
        low, high = high, 2 * high
    while high - low > 0.02 * high:
        middle = (low + high) / 2
        low, high = (low, middle) if does(middle) else (middle, high)
    return high


def make_cases(
    robot: pa.Robot, lifts: tuple[float, ...], times: tuple[float, ...]
) -> Iterator[Case]:
    """Yield the cases of a robot.

    Args:
        robot: Robot.
        lifts: Heights of the lifted foot [m].
        times: Factors of the minimum stiffness.
    """
    for foot in robot.contact_points:
        for lift in lifts:
            task = pa.StandTask(swing={foot: lift}, com="inside", com_margin=0.01)
            stand = pa.solve_stand(robot, task)
            least = search_min_stiffness(
                lambda kp, stand=stand: is_predicted_to_stand(robot, stand, kp)
            )
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
@click.option(
    "--swing", "lift", type=float, multiple=True, default=(0.002, 0.006, 0.02), show_default=True
)
@click.option("--times", type=float, multiple=True, default=(1.05, 1.5, 3.0), show_default=True)
@click.option("--verbose", is_flag=True, help="Print every case.")
def lifted(
    variant: tuple[str, ...],
    lift: tuple[float, ...],
    times: tuple[float, ...],
    verbose: bool,
) -> None:
    """Lift each foot, with servos of some multiples of the minimum stiffness."""
    columns = ("variant", "simulated", "said not to stand", "touch", "firm", "worst (mm)")
    table = Table(*columns, "not firm", "worst (mm)")
    for name in variant or pa.VARIANTS:
        robot = pa.load_variant(name)
        found = []
        for case in make_cases(robot, lift, times):
            found.append(case)
            if verbose:
                print_case(name, case)
        standing = [case for case in found if not case.problems]
        firm = [case.error for case in standing if case.firm]
        loose = [case.error for case in standing if not case.firm]
        row = [len(found), len(found) - len(standing), sum(case.touches for case in standing)]
        table.add_row(name, *map(str, row), *summarise_errors(firm), *summarise_errors(loose))
    Console().print(table)


def print_case(name: str, case: Case) -> None:
    """Print a case."""
    what = "-" if case.pose is None else f"{1e3 * case.pose.height_loss:.3f}"
    margin = "-" if case.pose is None else f"{case.pose.release_margin:.3f}"
    error = "-" if case.pose is None else f"{case.error:.3f}"
    print(
        f"{name:12} {case.foot} {1e3 * case.lift:4.0f} mm kp {case.kp:6.2f} predicted {what:>7} "
        f"simulated {1e3 * case.run.height_loss:7.3f} off {error:>6} margin {margin:>6}"
        f"{' touches' if case.touches else ''} {case.problems} | {case.run.failures}",
        flush=True,
    )


def summarise_errors(errors: list[float]) -> tuple[str, str]:
    """Return the number of right predictions, and the largest error [mm], as text."""
    right = sum(error < 1e3 * HEIGHT_TOLERANCE for error in errors)
    return f"{right} of {len(errors)}", f"{max(errors):.3f}" if errors else "-"


# ------------------------------------------------------------------------------------- limits


@main.command()
def limits() -> None:
    """Simulate v3 just above the minimum stiffness, and heavy with slightly too weak motors."""
    robot = pa.load_variant("v3")
    stand, table = pa.solve_stand(robot), Table("impratio", "kp / minimum", "lost (mm)", "knees")
    least = pa.stance.minimum_stiffness(robot, stand)
    for impratio in (1.0, 100.0, 1e4):

        def grip(model: mujoco.MjModel, impratio: float = impratio) -> None:
            model.opt.impratio = impratio

        for times in (1.05, 1.1, 1.3):
            run = pa.verify_stand(
                change_model(robot, grip),
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

        weak = change_model(robot, weaken)
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
