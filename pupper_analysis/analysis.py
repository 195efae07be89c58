"""One variant from its two model files to a verified stand: all results in one place."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.configuration import Configuration
from pupper_analysis.crosscheck import CrossCheck, cross_check
from pupper_analysis.results import Result
from pupper_analysis.robot import Robot
from pupper_analysis.simulation import GainSweep, StandVerification, sweep_gains, verify_stand
from pupper_analysis.stand import Stand, StandTask, solve_stand
from pupper_analysis.statics import GravityCompensation, gravity_compensation

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class JointSummary(Result):
    """What a joint does, and what it can.

    Attributes:
        name: Its name, in both files.
        motion: ``roll``, ``pitch`` or ``yaw``, as far as the axis is within 1 degree of x, y or z
            of the base at zero angles; otherwise ``oblique``.
        axis: (3,) its axis in the base frame at zero angles.
        lower: rad.
        upper: rad.
        effort: N m.
        velocity: rad/s.
        armature: Of the MJCF (kg m^2).
        damping: N m s/rad.
        friction: N m.
    """

    name: str
    motion: str
    axis: Array
    lower: float
    upper: float
    effort: float
    velocity: float
    armature: float
    damping: float
    friction: float


@dataclass(frozen=True, eq=False)
class FootJacobian(Result):
    """The Jacobian of a foot with respect to the joints of its leg.

    Attributes:
        joints: The leg's joints.
        matrix: (3, n) in world axes: velocity of the foot's centre (m/s) per joint velocity (rad/s).
        singular_values: (3,) (m/rad).
        condition: Their ratio, greatest to least: 1 is isotropic, infinity singular.
    """

    joints: tuple[str, ...]
    matrix: Array
    singular_values: Array
    condition: float


@dataclass(frozen=True, eq=False)
class Analysis(Result):
    """All that is found out about one robot.

    Attributes:
        name: The robot's name.
        nq: Size of qpos.
        nv: Size of qvel.
        nu: Number of motors.
        total_mass: kg.
        link_masses: {body: kg}, fixed links with the body that carries them.
        center_of_mass: (3,) at zero angles in the base frame (m).
        thigh_length: Distance from the knee's parent joint to the knee, first leg (m).
        calf_length: Distance from the knee to the foot in the plane of the leg, first leg (m).
        joints: Per joint, in actuator order.
        notes: What was assumed on loading.
        stand: The solved stand.
        statics: Torques and contact forces of the stand, of least torque.
        hanging_torques: (nu,) what the motors hold in the same pose with the base held (N m).
        foot_jacobians: Per foot.
        verification: The simulated stand, with feed-forward.
        sagging: The simulated stand, without.
        sweep: The gain sweep.
        check: The cross-check of the two models.
        verified: Whether verification and cross-check passed.
        failures: If not, why.
    """

    name: str
    nq: int
    nv: int
    nu: int
    total_mass: float
    link_masses: dict[str, float]
    center_of_mass: Array
    thigh_length: float
    calf_length: float
    joints: tuple[JointSummary, ...]
    notes: tuple[str, ...]
    stand: Stand
    statics: GravityCompensation
    hanging_torques: Array
    foot_jacobians: dict[str, FootJacobian]
    verification: StandVerification
    sagging: StandVerification
    sweep: GainSweep
    check: CrossCheck
    verified: bool
    failures: tuple[str, ...]
