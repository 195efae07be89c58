"""What one stance costs, and whether it holds."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.csv_text import csv_text
from pupper_analysis.base.diagnostics import Diagnostic
from pupper_analysis.base.errors import NoEquilibriumError, NoStiffnessError
from pupper_analysis.base.files import write_atomically
from pupper_analysis.base.kinds import STAND_TABLE
from pupper_analysis.base.results import Result, Tabular
from pupper_analysis.models.efforts import EffortStatement
from pupper_analysis.models.mjcf_file import MjcfFile
from pupper_analysis.models.urdf_file import UrdfFile
from pupper_analysis.prepare.judge import judge_simulation
from pupper_analysis.prepare.passes import LoadRequest, PassRun, prepare_robot
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.simulation.verdict import Verdict
from pupper_analysis.simulation.verify import StandVerification, verify_stand
from pupper_analysis.stance.sag.steady_state import SteadyState, minimum_stiffness, steady_state
from pupper_analysis.stance.soft_ground import solve_stand_as_simulated
from pupper_analysis.stance.stand import Stand, solve_stand, stand_contacts, stand_statics
from pupper_analysis.stance.task import StandTask
from pupper_analysis.statics.equilibrium import ForceDistribution, GravityCompensation

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Stance(Tabular):
    """A stance, what it costs, and whether it holds.

    Attributes:
        name: The robot's name.
        joint_positions: (nu,) of ``stand``, in actuator order (rad).
        limits: (nu,) of the motors' torques, the least that both files state (N m).
        limit_origins: (nu,) which statement of which file each is; None without a limit.
        stand: How it stands, its feet sunk into MuJoCo's ground, which all that is shown is of; on
            rigid ground, without ``depths``, where that is out of reach.
        statics: Torques and contact forces: those that last.
        min_max_torque: The same of least peak motor utilisation.
        verification: The simulation, with feed-forward.
        sagging: The simulation without.
        verdict: Whether it holds, and what that rests on.
        settled: Where it settles without feed-forward; None where that is not predicted.
        unsettled: Why ``settled`` is None; None where it is not.
        presses: How hard each hand can press in it; none if it has no hands.
        minimum_stiffness: Below which no equilibrium is left without feed-forward (N m/rad), if it
            is asked for; None also where there is none at all.
    """

    name: str
    joint_positions: Array = field(metadata={"unit": "rad"})
    limits: Array = field(metadata={"unit": "N m"})
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
    minimum_stiffness: float | None = field(metadata={"unit": "N m/rad"})

    def _columns(self) -> dict[str, ArrayLike]:
        return {
            "joint": self.statics.joint_names,
            "position": self.joint_positions,
            "torque": self.statics.joint_torques,
            "limit": self.limits,
            "utilisation": self.statics.motor_utilisation,
            "simulated_torque": self.verification.joint_torques,
        }

    def to_csv(self, path: str | Path, *, force: bool = False) -> None:
        """Write positions, torques and limits of the joints as CSV, with units in the header.

        Args:
            path: Output file.
            force: Also replace an existing file that is not such a table.

        Raises:
            OutputError: If the file cannot be written, or must not be replaced.
        """
        units = ("", " (rad)", " (N m)", " (N m)", "", " (N m)")
        columns = self._columns()
        header = [name + unit for name, unit in zip(columns, units, strict=True)]
        rows = zip(*(np.asarray(one).tolist() for one in columns.values()), strict=True)
        with write_atomically(Path(path), STAND_TABLE, force=force) as file:
            file.write(csv_text([header, *rows]).encode())

    @property
    def overloaded(self) -> tuple[str, ...]:
        """Motors above their limits, with minimum tangential contact forces."""
        return self.verdict.overloaded

    @property
    def passed(self) -> bool:
        """Whether the verdict on the stance is positive."""
        return self.verdict.passed


def study_stance(
    robot: Robot,
    stance: StandTask | Stand,
    *,
    kp: ArrayLike | None = None,
    kd: ArrayLike | None = None,
    stiffness: bool = False,
) -> Stance:
    """Solve a stance, compute its torques and contact forces, and simulate whether it holds.

    Args:
        robot: Robot.
        stance: Stance to be solved, or a stand that is already solved.
        kp: Servo stiffness [N m/rad], scalar or shape (nu,). Default: the model's.
        kd: Servo damping [N m s/rad], scalar or shape (nu,). Default: the model's.
        stiffness: Also search the minimum stiffness of the servos (a second or two).

    Raises:
        StanceUnreachableError: If the stance is out of reach.
        StaticsInfeasibleError: If the stance is reachable, but slides or tips.
        ConfigurationError: If the task, or another argument, is invalid for the robot.
        ModelError: If the robot has no position servos, and kp and kd are not both given.
    """
    stand = stance if isinstance(stance, Stand) else solve_stand(robot, stance)
    settled, unsettled, least = None, None, None
    robot = stand.check(robot)
    held = solve_stand_as_simulated(robot, stand)
    try:
        settled = steady_state(robot, held, kp=kp)
    except NoEquilibriumError as error:
        unsettled = error.diagnostic
    if stiffness:
        with contextlib.suppress(NoStiffnessError):
            least = minimum_stiffness(robot, held)
    statics = stand_statics(robot, held)
    fed = verify_stand(robot, held, kp=kp, kd=kd)
    alone = verify_stand(robot, held, kp=kp, kd=kd, feedforward=False, settled=settled)
    return Stance(
        name=robot.name,
        joint_positions=held.joint_positions(robot),
        limits=robot.effort_limits,
        limit_origins=tuple(limit.origin for limit in robot.efforts),
        stand=held,
        statics=statics,
        min_max_torque=stand_statics(robot, held, distribution=ForceDistribution.MIN_MAX_TORQUE),
        verification=fed,
        sagging=alone,
        verdict=judge_simulation(robot, stand, fed, alone, statics=statics, kp=kp, kd=kd),
        settled=settled,
        unsettled=unsettled,
        presses=largest_presses(robot, held),
        minimum_stiffness=least,
    )


@dataclass(frozen=True, eq=False)
class LargestPress(Result):
    """How hard a hand can press against its plane in a stance, whatever else that takes.

    Attributes:
        hand: What presses.
        force: The largest force along the plane's normal, of which balance is left (N).
    """

    hand: str
    force: float = field(metadata={"unit": "N"})


def largest_presses(robot: Robot, stand: Stand) -> tuple[LargestPress, ...]:
    """Compute the largest normal force with which each hand can press in a stand.

    One cone program per hand maximises the force under balance, friction cones and effort limits. A
    force that the task states is ignored. A hand is left out if its force is unlimited, or if the
    motors are too weak to stand.

    Args:
        robot: Robot.
        stand: Stand.

    Returns:
        Result of each hand; empty if a part of the robot is welded.
    """
    robot = stand.check(robot)
    carrying = replace(stand_contacts(robot, stand), stated=None)
    if robot.welds:
        return ()
    config, limits = Configuration(robot, stand.qpos), robot.effort_limits
    load, transposed = (config.by_motors(one) for one in (config.load(), carrying.jacobian(config)))
    problem, rated = carrying.balance(transposed, load), np.isfinite(limits)
    joints, torques = problem.joint_rows[rated], problem.joint_load[rated]
    most = np.concatenate([limits[rated] + torques, limits[rated] - torques])
    found = []
    for hand in robot.hands:
        own = np.array([[point in robot.feet[hand]] for point in carrying.feet])
        linear = (own * problem.normals).ravel()
        rows = np.concatenate([joints, -joints])
        forces = problem.maximize(linear, carrying.friction, rows, most)
        if forces is not None:
            found.append(LargestPress(hand, float(linear @ forces)))
    return tuple(found)


@dataclass(frozen=True)
class Preparation(Result):
    """How two files became a robot.

    Attributes:
        name: The robot's name.
        mass: What it weighs (kg).
        floating: Whether its base is free.
        joints: Its joints, in the order of its coordinates.
        feet: Its feet.
        passes: What was run to make it ready, in this order; none if the files were ready.
        notes: What was found, and which defaults were added.
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
    """Build a robot from a URDF and an MJCF, and report the preparation passes.

    Args:
        urdf: URDF.
        mjcf: MJCF of the same robot.
        request: Options of the user.

    Returns:
        Report of the passes, and the robot.

    Raises:
        ModelError: If no robot can be built from the files.
        UnknownNameError: If a requested foot, joint or keyframe does not exist.
    """
    robot, runs = prepare_robot(urdf, mjcf, request)
    message = Preparation(
        name=robot.name,
        mass=robot.total_mass,
        floating=robot.floating,
        joints=tuple(robot.joint_names),
        feet=tuple(robot.feet),
        passes=tuple(runs),
        notes=robot.notes,
    )
    return message, robot
