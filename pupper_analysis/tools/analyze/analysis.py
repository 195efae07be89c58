"""Analysis of a robot: model data, nominal stand, simulation, gain sweep and cross-check.

Input is a robot with a floating base and a stand task; output is an ``Analysis`` with all results.
"""

from __future__ import annotations

import contextlib
import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import Diagnostic, Term, diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.base.results import Result
from pupper_analysis.base.units import (
    ARMATURE_UNIT,
    DAMPING_UNIT,
    EFFORT_UNIT,
    POSITION_UNIT,
    VELOCITY_UNIT,
    JointUnits,
    select_joint_units,
)
from pupper_analysis.models.efforts import EffortStatement
from pupper_analysis.prepare.judge import judge_simulation
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.joints import OBLIQUE_MOTIONS, is_slide, joint_motions, leg_joints
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.stability import HOLD_DURATION
from pupper_analysis.simulation.servo_bounds import ServoBounds, bound_servo_gains
from pupper_analysis.simulation.verdict import Verdict
from pupper_analysis.simulation.verify import StandVerification, verify_stand
from pupper_analysis.stance.soft_ground import solve_stand_as_simulated
from pupper_analysis.stance.stand import Stand, solve_stand, stand_statics
from pupper_analysis.stance.task import StandTask
from pupper_analysis.statics.equilibrium import (
    ForceDistribution,
    GravityCompensation,
    gravity_compensation,
)
from pupper_analysis.tools.analyze.gain_sweep import GainSweep, sweep_gains
from pupper_analysis.tools.crosscheck.crosscheck import CrossCheck, cross_check


@dataclass(frozen=True, eq=False)
class JointSummary(Result):
    """Axis, limits and passive terms of a joint.

    Attributes:
        name: Name of the joint.
        motion: ``roll``, ``pitch`` or ``yaw`` if the axis is within 1 degree of x, y or z of the
            base at zero angles; otherwise ``oblique``. For a sliding joint ``along x``, ``along
            y`` or ``along z``; otherwise ``oblique slide``.
        axis: Joint axis at zero angles, shape (3,), in the base frame.
        lower: Lower position limit (rad or m).
        upper: Upper position limit (rad or m).
        effort: Effort limit (N m or N): the smallest limit that the files state, or a requested
            limit that replaces these limits.
        velocity: Velocity limit (rad/s or m/s).
        armature: Armature of the MJCF (kg m^2 or kg).
        damping: Viscous damping (N m s/rad or N s/m).
        friction: Dry friction (N m or N).
        effort_origin: Origin of ``effort``: statement in a file, or request; None without a limit.
    """

    name: str
    motion: str
    axis: Array = field(metadata={"unit": "1"})
    lower: float = field(metadata={"unit": POSITION_UNIT})
    upper: float = field(metadata={"unit": POSITION_UNIT})
    effort: float = field(metadata={"unit": EFFORT_UNIT})
    velocity: float = field(metadata={"unit": VELOCITY_UNIT})
    armature: float = field(metadata={"unit": ARMATURE_UNIT})
    damping: float = field(metadata={"unit": DAMPING_UNIT})
    friction: float = field(metadata={"unit": EFFORT_UNIT})
    effort_origin: EffortStatement | None

    @property
    def units(self) -> JointUnits:
        """Units of position, effort etc. of the joint: those of a hinge or of a slide."""
        return select_joint_units(slides=self.is_sliding)

    @property
    def is_oblique(self) -> bool:
        """True if the joint axis is not parallel to x, y or z of the base, within 1 degree."""
        return self.motion in OBLIQUE_MOTIONS

    @property
    def is_sliding(self) -> bool:
        """True for a sliding (prismatic) joint, False for a revolute joint."""
        return self.motion.startswith("along ") or self.motion == OBLIQUE_MOTIONS[1]


def summarise_joints(robot: Robot) -> tuple[JointSummary, ...]:
    """Return the axis, limits and passive terms of each joint, in actuator order.

    Axes are those at zero angles, in the base frame, or, for a fixed base, in the world frame.
    Limits are in rad, rad/s and N m, passive terms in kg m^2, N m s/rad and N m; for a sliding
    joint in m, m/s, N, kg, N s/m and N.
    """
    rest = Configuration(robot, robot.neutral())
    model, v = robot.pin_model, robot.pin_convention.v_index
    summaries = []
    for index, (name, motion) in enumerate(joint_motions(robot).items()):
        summaries.append(
            JointSummary(
                name=name,
                motion=motion,
                axis=rest.joint_axis(name),
                lower=float(robot.lower_limits[index]),
                upper=float(robot.upper_limits[index]),
                effort=float(robot.effort_limits[index]),
                velocity=float(robot.velocity_limits[index]),
                armature=float(model.armature[v[index]]),
                damping=float(model.damping[v[index]]),
                friction=float(model.friction[v[index]]),
                effort_origin=robot.efforts[index].origin,
            )
        )
    return tuple(summaries)


@dataclass(frozen=True, eq=False)
class FootJacobian(Result):
    """Jacobian of a contact point of a foot with respect to the joints of the leg.

    Attributes:
        foot: Foot with the contact point.
        joints: Joints of the leg.
        matrix: Velocity of the contact sphere's centre per joint velocity, shape (3, n) (m/rad, or
            m/m for a slide), in world axes.
        singular_values: Singular values of the matrix, shape (min(3, n),), in descending order
            (m/rad and m/m mixed).
        condition: Ratio of the largest to the smallest singular value: 1 if the Jacobian is
            isotropic, infinity if it is singular or the leg has no joints.
    """

    foot: str
    joints: tuple[str, ...]
    matrix: Array = field(metadata={"unit": "m/rad"})
    singular_values: Array = field(metadata={"unit": "m/rad"})
    condition: float = field(metadata={"unit": "1"})


@dataclass(frozen=True, eq=False)
class Analysis(Result):
    """Results of the analysis of a robot.

    Attributes:
        name: Name of the robot.
        nq: Size of qpos.
        nv: Size of qvel.
        nu: Number of motors.
        total_mass: Mass of the robot (kg).
        link_masses: {base or joint: mass of the moved body (kg)}, including fixed links.
        center_of_mass: CoM at zero angles, shape (3,) (m), in the base frame.
        thigh_length: Distance between the last two joints of the first leg (m); None if unknown
            (`measure_leg_lengths`).
        calf_length: Distance from the last joint to the foot in the plane of the first leg (m);
            None if unknown.
        joints: Summary of each joint, in actuator order.
        notes: Assumptions on loading.
        stand: Stand on MuJoCo's soft ground, with the penetration of the feet in ``depths``. It is
            the stand on rigid ground, for example, if the stand on soft ground is out of reach.
        statics: Torques and contact forces of the stand, with minimum tangential forces.
        min_max_torque: Torques and contact forces with the smallest peak motor utilisation.
        hanging_torques: Motor torques in the same configuration if the base is held and the feet
            carry no load, shape (nu,) (N m or N).
        foot_jacobians: {contact point: Jacobian with respect to the joints of the leg}. A spherical
            foot has a single contact point, with the name of the foot.
        verification: Simulation of the stand with feed-forward.
        sagging: Simulation of the stand without feed-forward.
        verdict: Verdict on the stand, with the basis of the verdict.
        sweep: Gain sweep; None if it was not requested.
        check: Cross-check of the two models.
        verified: True if the verdict is good, the simulation with feed-forward holds and the models
            agree.
        failures: Failures of the simulation with feed-forward and of the cross-check.
        servos: Present gains of the servos with lower and upper bounds; None if the stand has no
            linear model.
    """

    _key_fields: ClassVar[tuple[str, ...]] = ("verified", "failures")

    name: str
    nq: int
    nv: int
    nu: int
    total_mass: float = field(metadata={"unit": "kg"})
    link_masses: dict[str, float] = field(metadata={"unit": "kg"})
    center_of_mass: Array = field(metadata={"unit": "m"})
    thigh_length: float | None = field(metadata={"unit": "m"})
    calf_length: float | None = field(metadata={"unit": "m"})
    joints: tuple[JointSummary, ...]
    notes: tuple[Diagnostic, ...]
    stand: Stand
    statics: GravityCompensation
    min_max_torque: GravityCompensation
    hanging_torques: Array = field(metadata={"unit": EFFORT_UNIT})
    foot_jacobians: dict[str, FootJacobian]
    verification: StandVerification
    sagging: StandVerification
    verdict: Verdict
    sweep: GainSweep | None
    check: CrossCheck
    verified: bool
    failures: tuple[Diagnostic, ...]
    servos: ServoBounds | None = None


@check_arguments
def analyze_variant(
    robot: Robot, task: StandTask | None = None, *, sweep: bool = True, progress: bool = False
) -> Analysis:
    """Analyse a robot: statics, simulation and gain sweep of a stand; cross-check of the models.

    Args:
        robot: Robot with a floating base.
        task: Task of the stand. Default: the nominal stand.
        sweep: Whether to compute the gain sweep, which takes half of the time.
        progress: Show a progress bar during the gain sweep.

    Returns:
        All results.

    Raises:
        StanceUnreachableError: If the stand is out of reach.
        StaticsInfeasibleError: If no contact forces balance the stand.
        NotSettlingError: If the penetration depths of a robot without loops and couplings do not
            converge.
        ConfigurationError: If the base is fixed, or the task is invalid for the robot.
        UnknownNameError: If the task contains an unknown foot, joint or contact.
        ModelError: If a joint has no position servo, or the ground cannot be added, for example.
    """
    rigid_stand = solve_stand(robot, task)
    stand = solve_stand_as_simulated(robot, rigid_stand)
    robot = stand.check(robot)
    config = Configuration(robot, stand.qpos)
    rest = Configuration(robot, robot.neutral())
    # In parallel threads: MuJoCo releases Python's interpreter lock while it steps.
    with ThreadPoolExecutor() as pool:
        holding = pool.submit(verify_stand, robot, stand, duration=HOLD_DURATION)
        checking = pool.submit(cross_check, robot)
        sinking = pool.submit(verify_stand, robot, stand, feedforward=False, duration=HOLD_DURATION)
        sweeping = (
            pool.submit(sweep_gains, robot, stand, amplitude=0.0, progress=progress)
            if sweep
            else None
        )
        verification, check = holding.result(), checking.result()
        sagging = sinking.result()
        gain_sweep = None if sweeping is None else sweeping.result()
    failures = [*verification.failures, *_report_deviations(check)]
    thigh, calf = measure_leg_lengths(robot)
    statics = stand_statics(robot, stand)
    verdict = judge_simulation(robot, rigid_stand, verification, sagging, statics=statics)
    servos = None
    with contextlib.suppress(ConfigurationError):  # a diverging step has no linear model
        servos = bound_servo_gains(robot, stand, stands=sagging.stays)
    return Analysis(
        name=robot.name,
        nq=robot.nq,
        nv=robot.nv,
        nu=robot.nu,
        total_mass=robot.total_mass,
        link_masses=_list_link_masses(robot),
        center_of_mass=rest.center_of_mass(),
        thigh_length=thigh,
        calf_length=calf,
        joints=summarise_joints(robot),
        notes=robot.notes,
        stand=stand,
        statics=statics,
        min_max_torque=stand_statics(robot, stand, distribution=ForceDistribution.MIN_MAX_TORQUE),
        hanging_torques=gravity_compensation(config, contacts=[]).joint_torques,
        foot_jacobians=compute_leg_jacobians(config),
        verification=verification,
        sagging=sagging,
        verdict=verdict,
        sweep=gain_sweep,
        check=check,
        verified=verdict.passed and not failures,
        failures=tuple(failures),
        servos=servos,
    )


def _report_deviations(check: CrossCheck) -> list[Diagnostic]:
    """Report the quantities of a cross-check whose deviation exceeds the tolerance."""
    return [
        diagnose(
            "models-deviate",
            quantity=Term(quantity.name),
            relative=quantity.relative,
            whose=Term(quantity.edge),
            where=quantity.location,
        )
        for quantity in check.quantities
        if not quantity.passed
    ]


def compute_leg_jacobians(config: Configuration) -> dict[str, FootJacobian]:
    """Compute the Jacobian of each contact point with respect to the joints of its leg.

    Returns:
        {contact point: Jacobian, shape (3, n) [m/rad, m/m], singular values and condition number}.
        The Jacobian maps joint velocities to the velocity of the contact sphere's centre, in world
        axes.
    """
    robot = config.robot
    jacobians = {}
    for point, full in config.foot_jacobians().items():
        joints = leg_joints(robot, point)
        columns = [robot.nv - robot.nu + robot.joint_names.index(name) for name in joints]
        values = np.asarray(np.linalg.svd(full[:, columns], compute_uv=False), float)
        jacobians[point] = FootJacobian(
            foot=robot.foot_of(point),
            joints=joints,
            matrix=full[:, columns],
            singular_values=values,
            condition=float(values[0] / values[-1]) if values.size and values[-1] > 0 else math.inf,
        )
    return jacobians


def _list_link_masses(robot: Robot) -> dict[str, float]:
    """Return {name: mass [kg]} of the base, and of the body that each joint moves.

    A body has the name of its joint. Links that are fixed to a body belong to the body.
    """
    model = robot.pin_model
    root = 1 if robot.floating else 0
    masses = {robot.base: float(model.inertias[root].mass)}
    for name in robot.joint_names:
        masses[name] = float(model.inertias[model.getJointId(name)].mass)
    return masses


_MAX_LEG_JOINTS = 3
"""Largest number of joints of a leg whose last joint counts as the knee. Chosen, not tuned: longer
legs may have ankles."""


def measure_leg_lengths(robot: Robot) -> tuple[float | None, float | None]:
    """Compute the lengths of the first leg's thigh and calf at zero angles.

    The knee is the last joint of the leg. The thigh reaches from the preceding joint to the knee.
    The calf reaches from the knee to the foot, without the component along the knee axis.

    Returns:
        Thigh and calf length [m]; None if unknown, for example for a leg with more than
        `_MAX_LEG_JOINTS` joints.
    """
    foot = robot.contact_points[0]
    joints = leg_joints(robot, foot)
    if not 0 < len(joints) <= _MAX_LEG_JOINTS or is_slide(robot, joints[-1]):
        return None, None
    rest, knee = Configuration(robot, robot.neutral()), joints[-1]
    calf = rest.foot_positions()[foot] - rest.joint_position(knee)
    axis = rest.joint_axis(knee)
    calf_length = float(np.linalg.norm(calf - (calf @ axis) * axis))
    if len(joints) == 1 or is_slide(robot, joints[-2]):
        return None, calf_length
    thigh = rest.joint_position(knee) - rest.joint_position(joints[-2])
    return float(np.linalg.norm(thigh)), calf_length
