"""Bounds of the servo gains of a stand: the minimum stiffness, and the maximum damping.

`bound_servo_gains` scales the present gains of all joints by common factors. The minimum stiffness
is computed without feed-forward (``stance/sag/stiffness.py``). The maximum damping is computed for
an explicit PD controller with a command per time step (`ControlledStand`). `find_soft_servos`
scales the gains of up to three classes of joints. It finds the classes whose low stiffness makes a
stand fail.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.errors import NoStiffnessError
from pupper_analysis.base.results import Result
from pupper_analysis.base.units import (
    DAMPING_UNIT,
    STIFFNESS_UNIT,
    JointUnits,
    combine_joint_units,
    select_joint_units,
)
from pupper_analysis.robot.alike import group_joints, name_joints
from pupper_analysis.robot.joints import is_slide
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import Servos
from pupper_analysis.simulation.controlled_stand import (
    ControlledStand,
    find_largest_damping_factor,
)
from pupper_analysis.simulation.rollout import make_stand_start
from pupper_analysis.simulation.verify import StandVerification, verify_stand
from pupper_analysis.stance.sag.stiffness import estimate_minimum_stiffness, minimum_stiffness
from pupper_analysis.stance.stand import Stand

_TRIED_RATIOS = (1.02, 1.1, 1.25, 1.5, 2.0)
"""Ratios [1] of the simulated stiffness to the minimum stiffness (`minimum_stiffness`), in the
order of simulation. The simulations end at the first ratio with which the robot stands. Chosen, not
tuned."""

_STABLE_RATIO = 1.1
"""Lower bound [1] of the stiffness, divided by the minimum stiffness of the stand, with which the
maximum damping is computed. Softer servos get this stiffness. Chosen, not tuned."""


@dataclass(frozen=True)
class ServoClass(Result):
    """Class of corresponding joints of similar limbs, with equal gains and effort limits.

    The class has bounds of its gains.

    Attributes:
        name: Common part of the joints' names, with * for the rest.
        joints: Joints.
        kp: Present stiffness (N m/rad or N/m).
        least_kp: Least stiffness without feed-forward, if the stiffness of all joints is scaled
            together (N m/rad or N/m); None if ``ServoBounds.least_kp_factor`` is None.
        kd: Present damping (N m s/rad or N s/m).
        largest_kd: Largest damping of an explicit controller, if the damping of all joints is
            scaled together (N m s/rad or N s/m); None if unknown, without a bound, or if ``kd`` is
            0.
        are_slides: Whether the joints are slides.
    """

    name: str
    joints: tuple[str, ...]
    kp: float = field(metadata={"unit": STIFFNESS_UNIT})
    least_kp: float | None = field(metadata={"unit": STIFFNESS_UNIT})
    kd: float = field(metadata={"unit": DAMPING_UNIT})
    largest_kd: float | None = field(metadata={"unit": DAMPING_UNIT})
    are_slides: bool = False

    @property
    def units(self) -> JointUnits:
        """Units of gains and positions of the joints of this class (hinges or slides)."""
        return select_joint_units(slides=self.are_slides)


@dataclass(frozen=True)
class SoftServos(Result):
    """Servos whose low gains alone make a stand fail, as simulations show.

    Attributes:
        name: Common part of the joints' names, with * for the rest; several are joined by commas.
        joints: Joints.
        kp: Lowest present stiffness of these joints (N m/rad or N/m).
        factor: Smallest simulated factor on the gains of these joints with which the robot stands
            with feed-forward, while all other gains are unchanged (1).
        are_slides: Whether the joint with the lowest stiffness is a slide.
    """

    name: str
    joints: tuple[str, ...]
    kp: float = field(metadata={"unit": STIFFNESS_UNIT})
    factor: float = field(metadata={"unit": "1"})
    are_slides: bool = False

    @property
    def units(self) -> JointUnits:
        """Units of ``kp``: hinge or slide, as the joint with the lowest stiffness of this class."""
        return select_joint_units(slides=self.are_slides)


@dataclass(frozen=True)
class ServoBounds(Result):
    """Bounds of the servo gains of a stand, as common factors on the present gains of all joints.

    Attributes:
        classes: Joints with equal gains, with the bounds of these gains.
        least_kp_factor: Smallest factor on the stiffness with which the robot is predicted to stand
            without feed-forward (1). It is an estimate, at most 1, if the robot stands with the
            present stiffness. None if there is none, the base is fixed, or a part is fixed by a
            weld or grip.
        holding_kp_factor: Smallest simulated factor on the stiffness with which the robot stands
            without feed-forward (1); None if the robot stands with the present stiffness, or with
            no simulated factor, or if ``least_kp_factor`` is None.
        largest_kd_factor: Largest factor on the damping with which an explicit PD controller is
            stable (1); infinite if stable up to 4096; None without damping, or if no tried factor
            is stable.
        timestep: Time step of the model, and period of this controller (s).
        integrator: MuJoCo integrator of the model. With an implicit integrator, the damping of the
            model's own servos has no bound.
    """

    classes: tuple[ServoClass, ...]
    least_kp_factor: float | None = field(metadata={"unit": "1"})
    holding_kp_factor: float | None = field(metadata={"unit": "1"})
    largest_kd_factor: float | None = field(metadata={"unit": "1"})
    timestep: float = field(metadata={"unit": "s"})
    integrator: str

    @property
    def units(self) -> JointUnits:
        """Units for a table of the gains of all joints: common or mixed units."""
        return combine_joint_units(bounds.units for bounds in self.classes)

    @property
    def uniform(self) -> bool:
        """Whether the servos of all driven joints have equal stiffness kp and equal damping kd."""
        return len({(bounds.kp, bounds.kd) for bounds in self.classes}) == 1


def bound_servo_gains(
    robot: Robot,
    stand: Stand,
    *,
    kp: ArrayLike | None = None,
    kd: ArrayLike | None = None,
    stands: bool = True,
) -> ServoBounds:
    """Compute bounds of the servo gains of a stand: minimum stiffness, and maximum damping.

    Both bounds are common factors on the present gains of all joints.

    - Minimum stiffness, without feed-forward: predicted (`minimum_stiffness`); if the robot does
      not stand, larger values are also simulated. None for a fixed base, for example.
    - Maximum damping: stability limit of an explicit PD controller with a command per time step.
      Stiffness below about the minimum is raised before.

    Args:
        robot: Robot, with the contacts of the stand.
        stand: Stand on MuJoCo's soft ground.
        kp: Present stiffness [N m/rad, N/m], scalar or shape (nu,); default: the model's.
        kd: Present damping [N m s/rad, N s/m], scalar or shape (nu,); default: the model's.
        stands: Whether the robot is known to stand with the present stiffness without feed-forward.

    Raises:
        ConfigurationError: If an argument is out of range, or the stand belongs to another robot,
            for example.
        ModelError: If the servo gains of a joint are unknown, for example.
        StaticsInfeasibleError: If no contact forces balance the stand.
    """
    held = make_stand_start(robot, stand, kp=kp, kd=kd)
    drive = held.drive
    stiffness, damping = np.array(drive.kp), np.array(drive.kd)
    least, holding = _find_least_factor(robot, stand, stiffness, stands=stands), None
    if least is not None and not stands:
        holding = _find_holding_factor(robot, stand, drive, least)
    most = _bound_damping(ControlledStand(held), stiffness, damping, least)
    classes = []
    for members in group_joints(robot, stiffness, damping):
        first_kp, first_kd = float(stiffness[members[0]]), float(damping[members[0]])
        bounded = most is not None and math.isfinite(most) and first_kd > 0
        classes.append(
            ServoClass(
                name=name_joints([robot.joint_names[joint] for joint in members]),
                joints=tuple(robot.joint_names[joint] for joint in members),
                kp=first_kp,
                least_kp=None if least is None else least * first_kp,
                kd=first_kd,
                largest_kd=most * first_kd if most is not None and bounded else None,
                are_slides=is_slide(robot, robot.joint_names[members[0]]),
            )
        )
    return ServoBounds(
        classes=tuple(classes),
        least_kp_factor=least,
        holding_kp_factor=holding,
        largest_kd_factor=most,
        timestep=float(drive.model.opt.timestep),
        integrator=drive.integrator,
    )


def bound_explicit_damping(
    robot: Robot, stand: Stand, *, kp: ArrayLike | None = None, kd: ArrayLike | None = None
) -> float | None:
    """Compute the largest factor on the damping with which an explicit PD controller is stable.

    The result is `ServoBounds.largest_kd_factor` of a robot that stands with the present stiffness
    (`bound_servo_gains`, also for arguments and errors), without the other bounds.
    """
    held = make_stand_start(robot, stand, kp=kp, kd=kd)
    stiffness, damping = np.array(held.drive.kp), np.array(held.drive.kd)
    least = _find_least_factor(robot, stand, stiffness, stands=True)
    return _bound_damping(ControlledStand(held), stiffness, damping, least)


def _find_least_factor(
    robot: Robot, stand: Stand, stiffness: Array, *, stands: bool
) -> float | None:
    """Find the smallest factor on the stiffness (nu,) with which a robot is predicted to stand.

    The servos have no feed-forward. If the robot ``stands`` with the present stiffness, the factor
    is an estimate, at most 1. None if there is none, or for a fixed base, a weld or a grip.
    """
    if not robot.floating or robot.fixed_parts:
        return None
    largest, used = float(stiffness.max()), stiffness[stiffness > 0]
    ratios = None if np.ptp(used) == 0 else stiffness / largest
    try:
        find = estimate_minimum_stiffness if stands else minimum_stiffness
        least = find(robot, stand, ratios=ratios) / largest
    except NoStiffnessError:
        return None
    # The estimate is up to 5 % too large, and the simulation proves that 1 suffices.
    return min(least, 1.0) if stands else least


def _find_holding_factor(robot: Robot, stand: Stand, drive: Servos, least: float) -> float | None:
    """Find by simulation a stiffness factor with which the robot stands without feed-forward.

    ``least`` is the factor that `minimum_stiffness` predicts. The damping is scaled by the same
    factor, if above 1. None if the robot stands with no tried factor.
    """
    for ratio in _TRIED_RATIOS:
        factor = ratio * least
        run = verify_stand(
            robot,
            stand,
            kp=factor * drive.kp,
            kd=max(1.0, factor) * drive.kd,
            feedforward=False,
            until_failure=True,
        )
        if run.stays:
            return factor
    return None


_SINGLE_FACTORS = (2.0, 4.0, 8.0, 16.0)
"""Factors [1] with which `find_soft_servos` multiplies the gains of a class of servos, in the order
of the simulations. Chosen, not tuned: with 8 times the stiffness of its ankles TienKung falls, with
10 times it stands."""

_MAX_SUSPECTS = 3
"""Upper bound of the number of classes of servos that `find_soft_servos` simulates, which limits
the time. Chosen, not tuned.
"""

_MODE_CODES = ("mode-buckles", "mode-shakes")
"""Codes of the messages about an unstable mode; such a message names the joints of the mode."""


def find_soft_servos(
    robot: Robot,
    stand: Stand,
    run: StandVerification,
    *,
    kp: ArrayLike | None = None,
    kd: ArrayLike | None = None,
) -> SoftServos | None:
    """Find the servos whose low gains alone make a stand with feed-forward fail.

    The failures of ``run`` contain the joints of unstable modes. A class consists of corresponding
    joints of similar limbs, with equal gains. The gains of at most three classes with such joints
    are multiplied by increasing factors until the robot stands: class by class, then all together.

    Args:
        robot: Robot, with the contacts of the stand.
        stand: Stand on MuJoCo's soft ground.
        run: Simulation of the stand with feed-forward and the present gains.
        kp: Present stiffness [N m/rad, N/m], scalar or shape (nu,); default: the model's.
        kd: Present damping [N m s/rad, N s/m], scalar or shape (nu,); default: the model's.

    Returns:
        Servos of a class, or of all tried classes, with the first factor with which the robot
        stands. None, for example, if the robot stands with no tried factor.

    Raises:
        ConfigurationError: If an argument is out of range, or the stand belongs to another robot,
            for example.
        ModelError: If the servo gains of a joint are unknown, for example.
        StaticsInfeasibleError: If no contact forces balance the stand.
    """
    named: list[object] = []
    for failure in run.failures:
        joints_of_mode = failure.values.get("joints") if failure.code in _MODE_CODES else None
        named += joints_of_mode if isinstance(joints_of_mode, tuple) else ()
    if run.stays or not named or not robot.floating:
        return None
    drive = make_stand_start(robot, stand, kp=kp, kd=kd).drive
    stiffness, damping = np.array(drive.kp), np.array(drive.kd)
    classes = [
        members
        for members in group_joints(robot, stiffness, damping)
        if stiffness[members[0]] > 0 and any(robot.joint_names[joint] in named for joint in members)
    ][:_MAX_SUSPECTS]
    groups = [[members] for members in classes]
    for group in [*groups, classes] if len(classes) > 1 else groups:
        joints = [joint for members in group for joint in members]
        for factor in _SINGLE_FACTORS:
            gains = stiffness.copy(), damping.copy()
            for values in gains:
                values[joints] *= factor
            run = verify_stand(robot, stand, kp=gains[0], kd=gains[1], until_failure=True)
            if run.stays:
                names = [[robot.joint_names[joint] for joint in members] for members in group]
                softest = min(joints, key=lambda joint: float(stiffness[joint]))
                return SoftServos(
                    name=", ".join(map(name_joints, names)),
                    joints=tuple(robot.joint_names[joint] for joint in joints),
                    kp=float(stiffness[softest]),
                    factor=factor,
                    are_slides=is_slide(robot, robot.joint_names[softest]),
                )
    return None


def _bound_damping(
    loop: ControlledStand, kp: Array, kd: Array, least: float | None
) -> float | None:
    """Find the largest factor on the damping gains with which a stand is stable.

    ``least`` is the smallest factor on the stiffness with which the stand does not buckle. The
    result is infinite if the stand is stable up to `MAX_FACTOR`, and None without damping or if no
    tried factor is stable.
    """
    if not kd.any():
        return None
    factor = 1.0 if least is None else max(1.0, _STABLE_RATIO * least)
    most = find_largest_damping_factor(loop, factor * kp, kd)
    return None if math.isnan(most) else most
