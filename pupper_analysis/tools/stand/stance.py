"""Evaluate a stance: statics, sag, presses, simulation and verdict.

`study_stance` solves a stand task, computes torques and contact forces, predicts the equilibrium
without feed-forward, and verifies both in MuJoCo. `simulate_stance` omits the bounds of the servo
gains. `largest_presses` computes the largest force of each hand; `explain_loading` prepares a robot
and lists the steps.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.csv_text import csv_text
from pupper_analysis.base.diagnostics import Diagnostic
from pupper_analysis.base.errors import ConfigurationError, NoEquilibriumError, NoStiffnessError
from pupper_analysis.base.files import write_atomically
from pupper_analysis.base.kinds import STAND_TABLE
from pupper_analysis.base.progress import report_progress
from pupper_analysis.base.results import Result, Tabular
from pupper_analysis.base.units import (
    EFFORT_UNIT,
    POSITION_UNIT,
    STIFFNESS_UNIT,
)
from pupper_analysis.models.efforts import EffortStatement
from pupper_analysis.models.mjcf_file import MjcfFile
from pupper_analysis.models.urdf_file import UrdfFile
from pupper_analysis.prepare.judge import judge_simulation
from pupper_analysis.prepare.passes import LoadRequest, PassRun, prepare_robot
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.joints import list_position_units
from pupper_analysis.robot.robot import Robot, compute_added_mass
from pupper_analysis.simulation.servo_bounds import (
    ServoBounds,
    SoftServos,
    bound_servo_gains,
    find_soft_servos,
)
from pupper_analysis.simulation.verdict import Verdict
from pupper_analysis.simulation.verify import StandVerification, verify_stand
from pupper_analysis.stance.sag.steady_state import SteadyState, steady_state
from pupper_analysis.stance.sag.stiffness import minimum_stiffness
from pupper_analysis.stance.soft_ground import solve_stand_as_simulated
from pupper_analysis.stance.stand import Stand, resolve_stance, stand_contacts, stand_statics
from pupper_analysis.stance.task import StandTask
from pupper_analysis.statics.equilibrium import ForceDistribution, GravityCompensation


@dataclass(frozen=True, eq=False)
class Stance(Tabular):
    """Stance of a robot with the statics, simulations and verdict.

    Attributes:
        name: Name of the robot.
        joint_positions: (nu,) joint positions of ``stand``, in actuator order (rad, m).
        units: (nu,) units of the joint positions: rad, or m for a slide, whose motor force is in N
            in place of N m.
        limits: (nu,) effort limits, from the files or requested (N m, or N for a slide); infinite
            without a limit.
        limit_origins: (nu,) origin of each limit: statement in a file, or request; None without a
            limit.
        stand: Stand to which all other results refer, on MuJoCo's soft ground. The ground is rigid,
            with ``depths`` of 0, for example, if the legs are too short for soft ground.
        statics: Motor torques and contact forces with minimum tangential forces.
        min_max_torque: Motor torques and contact forces with the smallest peak motor utilisation.
        verification: Simulation with feed-forward.
        sagging: Simulation without feed-forward.
        verdict: Verdict on the stance, with the assumptions of the verdict.
        settled: Predicted equilibrium without feed-forward; None if there is no equilibrium.
        unsettled: Reason why ``settled`` is None; None if there is an equilibrium.
        presses: Largest force with which each hand can press. Empty if there are no hands, or if
            the task fixes a part of the robot to the world. A hand is omitted if the force is
            unlimited, or if no forces balance the stance within the effort limits.
        minimum_stiffness: Smallest uniform kp with which the robot stands without feed-forward
            (N m/rad or N/m); None if not requested, or if no tested kp suffices.
        no_stiffness: Reason for which no tested kp suffices; None if not requested, or if a kp
            suffices.
        servos: Present gains of the servos with lower and upper bounds; None if the stand has no
            linear model.
        soft_servos: Servos whose low stiffness alone makes the stand with feed-forward fail. None
            without such servos, or if the stand has no linear model.
        added_mass: Mass of the robot in addition to the mass in its files, for example of a payload
            (kg).
    """

    _key_fields: ClassVar[tuple[str, ...]] = ("verdict", "name")
    _units_of_columns: ClassVar[dict[str, str]] = {
        "position": POSITION_UNIT,
        "torque": EFFORT_UNIT,
        "limit": EFFORT_UNIT,
        "utilisation": "1",
        "simulated_torque": EFFORT_UNIT,
    }

    name: str
    joint_positions: Array = field(metadata={"unit": POSITION_UNIT})
    units: tuple[str, ...]
    limits: Array = field(metadata={"unit": EFFORT_UNIT})
    limit_origins: tuple[EffortStatement | None, ...]
    stand: Stand
    statics: GravityCompensation
    min_max_torque: GravityCompensation
    verification: StandVerification
    sagging: StandVerification
    verdict: Verdict
    settled: SteadyState | None
    unsettled: Diagnostic | None
    presses: tuple[LargestPress, ...]
    minimum_stiffness: float | None = field(metadata={"unit": STIFFNESS_UNIT})
    no_stiffness: Diagnostic | None
    servos: ServoBounds | None
    soft_servos: SoftServos | None = None
    added_mass: float = field(default=0.0, metadata={"unit": "kg"})

    def _columns(self) -> dict[str, ArrayLike]:
        """Return the columns of the table of joints, shape (nu,) each, in SI units.

        ``simulated_torque`` is the torque in the simulation with feed-forward.
        """
        return {
            "joint": self.statics.joint_names,
            "position": self.joint_positions,
            "torque": self.statics.joint_torques,
            "limit": self.limits,
            "utilisation": self.statics.motor_utilisation,
            "simulated_torque": self.verification.joint_torques,
        }

    def to_csv(self, path: str | Path, *, force: bool = False) -> None:
        """Write the table of joints as CSV, with a header line that names the units.

        Args:
            path: File to write.
            force: Replace an existing file even if the file is not such a table. An input file of
                the running command is never replaced.

        Raises:
            OutputError: If the file cannot be written, or would replace other content.
        """
        has_slides = "m" in self.units
        position, torque = " (rad)", " (N m)"
        if has_slides:
            position, torque = f" ({POSITION_UNIT})", f" ({EFFORT_UNIT})"
        units = ("", position, torque, torque, "", torque)
        columns = self._columns()
        header = [name + unit for name, unit in zip(columns, units, strict=True)]
        rows = zip(*(np.asarray(column).tolist() for column in columns.values()), strict=True)
        with write_atomically(Path(path), STAND_TABLE, force=force) as file:
            file.write(csv_text([header, *rows]).encode())

    @property
    def overloaded_motors(self) -> tuple[str, ...]:
        """Names of joints with positive effort limits that do not permit the static torques."""
        return self.verdict.overloaded_motors

    @property
    def passed(self) -> bool:
        """Whether the verdict on the stance passes."""
        return self.verdict.passed


_NUM_SIMULATIONS = 3
"""Number of simulations of `study_stance` for the estimate of the remaining time: with
feed-forward, with position commands alone, and of the published file.
"""


def study_stance(
    robot: Robot,
    stance: StandTask | Stand,
    *,
    kp: ArrayLike | None = None,
    kd: ArrayLike | None = None,
    stiffness: bool = False,
) -> Stance:
    """Solve a stance, compute torques and contact forces, and verify the stance by simulation.

    Args:
        robot: The robot.
        stance: Stand task, or a stand that satisfies a task on rigid ground.
        kp: Servo stiffness [N m/rad, N/m], scalar or shape (nu,); default: values of the model.
        kd: Servo damping [N m s/rad, N s/m], scalar or shape (nu,); default: values of the model.
        stiffness: Also compute the minimum stiffness of the servos.

    Raises:
        StanceUnreachableError: If the stance is out of reach.
        StaticsInfeasibleError: If no contact forces balance the stance: the robot slides or tips.
    """
    return simulate_stance(robot, stance, kp=kp, kd=kd).complete(stiffness=stiffness)


@dataclass(frozen=True, eq=False)
class SimulatedStance:
    """Stance with simulations and verdict, without bounds of the servo gains.

    Attributes:
        robot: Robot, with the contacts of the stand.
        held: Stand on MuJoCo's soft ground if possible, otherwise on rigid ground.
        kp: Servo stiffness as given [N m/rad, N/m]; None for the model's.
        kd: Servo damping as given [N m s/rad, N s/m]; None for the model's.
        statics: Motor torques and contact forces with minimum tangential forces.
        fed: Simulation with feed-forward.
        alone: Simulation without feed-forward.
        verdict: Verdict on the stance.
        settled: Predicted equilibrium without feed-forward; None if there is no equilibrium.
        unsettled: Reason why ``settled`` is None; None if there is an equilibrium.
    """

    robot: Robot
    held: Stand
    kp: ArrayLike | None
    kd: ArrayLike | None
    statics: GravityCompensation
    fed: StandVerification
    alone: StandVerification
    verdict: Verdict
    settled: SteadyState | None
    unsettled: Diagnostic | None

    @property
    def passed(self) -> bool:
        """Whether the verdict on the stance passes."""
        return self.verdict.passed

    def complete(self, *, stiffness: bool = False) -> Stance:
        """Create the complete result: add, for example, bounds of servo gains and forces of hands.

        ``stiffness`` adds the minimum stiffness of the servos.

        Raises:
            StaticsInfeasibleError: If no contact forces balance the stance.
        """
        robot, held, kp, kd = self.robot, self.held, self.kp, self.kd
        min_kp, no_stiffness, servos, soft = None, None, None, None
        if stiffness:
            try:
                min_kp = minimum_stiffness(robot, held)
            except NoStiffnessError as error:
                no_stiffness = error.diagnostic
        with contextlib.suppress(ConfigurationError):  # a diverging step has no linear model
            servos = bound_servo_gains(robot, held, kp=kp, kd=kd, stands=self.alone.stays)
            soft = find_soft_servos(robot, held, self.fed, kp=kp, kd=kd)
        return Stance(
            name=robot.name,
            joint_positions=held.joint_positions(robot),
            units=list_position_units(robot),
            limits=robot.effort_limits,
            limit_origins=tuple(limit.origin for limit in robot.efforts),
            stand=held,
            statics=self.statics,
            min_max_torque=stand_statics(
                robot, held, distribution=ForceDistribution.MIN_MAX_TORQUE
            ),
            verification=self.fed,
            sagging=self.alone,
            verdict=self.verdict,
            settled=self.settled,
            unsettled=self.unsettled,
            presses=largest_presses(robot, held),
            minimum_stiffness=min_kp,
            no_stiffness=no_stiffness,
            servos=servos,
            soft_servos=soft,
            added_mass=compute_added_mass(robot),
        )


def simulate_stance(
    robot: Robot,
    stance: StandTask | Stand,
    *,
    kp: ArrayLike | None = None,
    kd: ArrayLike | None = None,
) -> SimulatedStance:
    """Solve a stance, and judge the stance by simulation. Arguments and errors: `study_stance`."""
    robot, stand = resolve_stance(robot, stance)
    settled, unsettled = None, None
    held = solve_stand_as_simulated(robot, stand)
    try:
        settled = steady_state(robot, held, kp=kp)
    except NoEquilibriumError as error:
        unsettled = error.diagnostic
    statics = stand_statics(robot, held)
    report_progress("simulations", 0, _NUM_SIMULATIONS)
    fed = verify_stand(robot, held, kp=kp, kd=kd)
    report_progress("simulations", 1, _NUM_SIMULATIONS)
    alone = verify_stand(robot, held, kp=kp, kd=kd, feedforward=False, settled=settled)
    report_progress("simulations", 2, _NUM_SIMULATIONS)
    verdict = judge_simulation(robot, stand, fed, alone, statics=statics, kp=kp, kd=kd)
    return SimulatedStance(robot, held, kp, kd, statics, fed, alone, verdict, settled, unsettled)


@dataclass(frozen=True, eq=False)
class LargestPress(Result):
    """Largest force with which a hand of a stance can press against a plane.

    Attributes:
        hand: Name of the hand.
        force: Largest force along the normal of the plane with which the robot stays in balance,
            within friction cones and effort limits (N).
    """

    hand: str
    force: float = field(metadata={"unit": "N"})


def largest_presses(robot: Robot, stand: Stand) -> tuple[LargestPress, ...]:
    """Compute the largest force of each hand against its plane in a stand, by a cone program.

    Hand forces of the task are ignored.

    Args:
        robot: The robot.
        stand: The stand.

    Returns:
        Largest press of each hand; a hand without a finite largest press is omitted. Empty if the
        task welds or grips a part of the robot, since this constraint limits the force.

    Raises:
        ConfigurationError: If the stand belongs to another robot.
    """
    robot = stand.check(robot)
    carrying = replace(stand_contacts(robot, stand), stated=None)
    if robot.fixed_parts:
        return ()
    config, limits = Configuration(robot, stand.qpos), robot.effort_limits
    load, transposed = map(
        config.transfer_to_motors, (config.static_load(), carrying.transposed_jacobian(config))
    )
    problem, rated = carrying.balance(transposed, load), np.isfinite(limits)
    joints, torques = problem.joint_rows[rated], problem.joint_load[rated]
    upper = np.concatenate([limits[rated] + torques, limits[rated] - torques])
    presses = []
    for hand in robot.hands:
        own = np.array([[point in robot.feet[hand]] for point in carrying.feet])
        linear = (own * problem.normals).ravel()
        rows = np.concatenate([joints, -joints])
        forces = problem.maximize(linear, carrying.friction, rows, upper)
        if forces is not None:
            presses.append(LargestPress(hand, float(linear @ forces)))
    return tuple(presses)


@dataclass(frozen=True)
class Preparation(Result):
    """Report of the preparation of a robot from the files: passes, and changes of each pass.

    Attributes:
        name: Name of the robot.
        mass: Total mass (kg).
        floating: Whether the base is free.
        joints: Names of the joints, in actuator order.
        feet: Names of the feet.
        passes: Preparation passes that were run. Empty if no pass was needed.
        notes: Findings in the files, and defaults that were added.
    """

    name: str
    mass: float = field(metadata={"unit": "kg"})
    floating: bool
    joints: tuple[str, ...]
    feet: tuple[str, ...]
    passes: tuple[PassRun, ...]
    notes: tuple[Diagnostic, ...]


def explain_loading(
    urdf: UrdfFile, mjcf: MjcfFile, request: LoadRequest
) -> tuple[Preparation, Robot]:
    """Prepare a robot from two files, and list the preparation steps that were run.

    All steps that the robot needs are run, including the steps that `make_robot` postpones.

    Raises:
        ModelError: If no robot can be made from the files.
        UnknownNameError: If a foot, joint or keyframe of the request does not exist.
    """
    robot, runs = prepare_robot(urdf, mjcf, request)
    preparation = Preparation(
        name=robot.name,
        mass=robot.total_mass,
        floating=robot.floating,
        joints=tuple(robot.joint_names),
        feet=tuple(robot.feet),
        passes=tuple(runs),
        notes=robot.notes,
    )
    return preparation, robot
