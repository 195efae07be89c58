"""Bounds of the stiffness and damping of a standing robot's servos.

`study_gains` scales the gains of all joints together, and finds the factors between which the robot
is stable under a sampled PD controller with a delay (`ControlledStand`). The scaled gains are the
present gains. If no tried factors on these are stable, the scaled gains are proportional to the
inertia that each motor accelerates. The bounds for all joints together are repeated by bisection in
simulations with all friction. Torque limits and encoders bound the gains of each joint separately.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import product
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import Diagnostic, Quantity, contains_error, diagnose
from pupper_analysis.base.errors import ConfigurationError, ModelError, NoStiffnessError
from pupper_analysis.base.progress import report_progress
from pupper_analysis.base.results import Result, Tabular
from pupper_analysis.base.units import (
    DAMPING_UNIT,
    STIFFNESS_UNIT,
    JointUnits,
    combine_joint_units,
    select_joint_units,
)
from pupper_analysis.prepare.judge import describe_ties
from pupper_analysis.prepare.limits import (
    describe_zero_torque_limits,
    loads_motor_without_torque,
)
from pupper_analysis.robot.alike import group_joints, name_joints
from pupper_analysis.robot.as_published import ServosUsed
from pupper_analysis.robot.build import report_placeholder_inertias
from pupper_analysis.robot.joints import (
    force_unit,
    is_slide,
)
from pupper_analysis.robot.masses import describe_missing_masses
from pupper_analysis.robot.robot import Robot, get_loaded_robot
from pupper_analysis.robot.servos import find_servos_used
from pupper_analysis.robot.stability import HOLD_DURATION
from pupper_analysis.simulation.controlled_stand import (
    FACTOR_TOLERANCE,
    MAX_FACTOR,
    MAX_POWER,
    ControlledStand,
    WorstMode,
    bisect_factor,
    find_largest_damping_factor,
)
from pupper_analysis.simulation.rollout import StandStart, make_stand_start
from pupper_analysis.simulation.verdict import find_overloaded_motors
from pupper_analysis.simulation.verify import verify_stand
from pupper_analysis.stance.sag.steady_state import find_sag_failure
from pupper_analysis.stance.sag.stiffness import minimum_stiffness
from pupper_analysis.stance.soft_ground import solve_stand_as_simulated
from pupper_analysis.stance.stand import Stand, resolve_stance
from pupper_analysis.stance.task import StandTask

_SIMULATED_TOLERANCE = 0.02
"""Relative tolerance [1] of the bisection of gains between simulated stands that hold and fail.
Larger than `FACTOR_TOLERANCE`, the tolerance for the linear model, since a simulation takes longer.
Chosen, not tuned.
"""

_SIMULATED_RANGE = 2.0
"""Ratio of the ends of the bisection in simulation to the bound of the linear model: the simulated
bound is searched between 1/2 and 2 times the predicted bound. Chosen, not tuned."""

_SHAKE_DURATION = 3.0
"""Duration [s] of a simulated stand in the search for the upper bound of stiffness or damping.
Chosen, not tuned."""

GAIN_MARGIN = 2.0
"""Smallest factor between the recommended stiffness and the bounds on both sides, and between the
recommended damping and the upper bound: the usual gain margin of 6 dB (Åström and Murray 2008)."""

MIN_DAMPING_RATIO = 0.5
"""Required damping ratio [1] of lasting oscillations with the recommended damping. Of the tried
dampings that reach this ratio, the one next to the reference damping is recommended. If no tried
damping within the stability margins reaches this ratio, the tried damping with the largest ratio is
recommended. Chosen, not tuned.
"""

MAX_NOISE_RATIO = 0.1
"""Upper bound of the torque that kd causes if the position reading changes by one encoder count
within a control period, divided by the torque limit [1]. This bound limits kd:
``JointClass.largest_kd_of_encoder``. Chosen, not tuned.
"""

MIN_ENCODER_BITS, MAX_ENCODER_BITS = 6, 32
"""Bounds of the accepted resolution of a joint encoder [bits per turn]. Chosen, not tuned."""

_REFERENCE_FREQUENCY = 50.0
"""Natural frequency sqrt(kp / inertia) [rad/s] of each joint with the first gains of a search for
gains that are proportional to joint inertia. Chosen, not tuned.
"""

_NEAR_POWER = 6
"""Largest sum of the magnitudes of two exponents (of 2, for factors on kp and kd) up to which all
pairs are tried [1]. Chosen, not tuned: it bounds the computing time."""

_SAG_RATIO = 2.0**0.5
"""Ratio of successive factors on the stiffness in the search for a stand without feed-forward.
Chosen, not tuned."""

_CURVE_RATIO = 2.0**0.5
"""Ratio of successive stiffnesses in the plot of the largest stable damping over the stiffness.
Chosen, not tuned."""

_CURVE_HALF_LENGTH = 6
"""Number of points on each side of the reference stiffness in the plot of the largest stable
damping over the stiffness. Chosen, not tuned."""

_NUM_LOWER_POINTS = 3
"""Number of additional points of the plot, from the least stable stiffness up to the lowest of the
other points. Chosen, not tuned."""

_MAX_LOWER_RATIO = 2.0**-0.005
"""Least stable stiffness, divided by the lowest point of the plot [1], below which the plot gets
additional points. Chosen, not tuned: just below 1, so that additional points do not coincide."""


@dataclass(frozen=True)
class GainBound(Result):
    """Factor on the gains of all joints at which a standing robot becomes unstable.

    Attributes:
        factor: Factor on the reference gains (``JointClass.reference_kp``), in the linear model
            without dry friction; None if the robot is stable up to ``MAX_FACTOR``, or down to its
            inverse.
        simulated: Factor found by simulation of the controlled stand, with all friction. None if
            ``factor`` is None, or if no bound was found between 1/2 and 2 times ``factor``.
        frequency: Frequency of the mode that grows beyond the bound (Hz); 0 without oscillation.
        joints: Joints that move most in this mode, largest first.
    """

    factor: float | None = field(metadata={"unit": "1"})
    simulated: float | None = field(metadata={"unit": "1"})
    frequency: float = field(metadata={"unit": "Hz"})
    joints: tuple[str, ...]


@dataclass(frozen=True)
class JointClass(Result):
    """Joints with equal gains at the same place in similar limbs, and the bounds of their gains.

    Attributes:
        name: Common part of the joints' names, with * for the rest.
        joints: Joints.
        kp: Present stiffness (N m/rad or N/m).
        kd: Present damping (N m s/rad or N s/m).
        reference_kp: Stiffness that the factors of a study multiply (N m/rad or N/m): ``kp``,
            unless ``GainStudy.by_inertia``.
        reference_kd: Damping that the factors of a study multiply (N m s/rad or N s/m): ``kd``,
            unless ``GainStudy.by_inertia``.
        least_kp: Smallest stable stiffness, if the stiffness of all joints is scaled together
            (N m/rad or N/m); None without a bound.
        largest_kd: Largest stable damping, if the damping of all joints is scaled together
            (N m s/rad or N s/m); None without a bound.
        largest_kd_alone: Largest stable damping, if only the damping of this class changes
            (N m s/rad or N s/m); None without a bound, or if ``reference_kd`` is 0.
        largest_kp_of_torque: Stiffness with which the requested position error reaches the torque
            limit (N m/rad or N/m). None if no error was requested, if there is no finite positive
            limit, and for slides.
        largest_kd_of_encoder: Damping with which one encoder count per control period causes a
            torque of ``MAX_NOISE_RATIO`` times the torque limit (N m s/rad or N s/m). None if no
            encoder was stated, if there is no finite positive limit, and for slides.
        recommended_kp: Recommended stiffness (N m/rad or N/m); None without a recommendation.
        recommended_kd: Recommended damping (N m s/rad or N s/m); None without a recommendation.
        are_slides: Whether the joints are slides.
    """

    name: str
    joints: tuple[str, ...]
    kp: float = field(metadata={"unit": STIFFNESS_UNIT})
    kd: float = field(metadata={"unit": DAMPING_UNIT})
    reference_kp: float = field(metadata={"unit": STIFFNESS_UNIT})
    reference_kd: float = field(metadata={"unit": DAMPING_UNIT})
    least_kp: float | None = field(metadata={"unit": STIFFNESS_UNIT})
    largest_kd: float | None = field(metadata={"unit": DAMPING_UNIT})
    largest_kd_alone: float | None = field(metadata={"unit": DAMPING_UNIT})
    largest_kp_of_torque: float | None = field(metadata={"unit": STIFFNESS_UNIT})
    largest_kd_of_encoder: float | None = field(metadata={"unit": DAMPING_UNIT})
    recommended_kp: float | None = field(metadata={"unit": STIFFNESS_UNIT})
    recommended_kd: float | None = field(metadata={"unit": DAMPING_UNIT})
    are_slides: bool = False

    @property
    def units(self) -> JointUnits:
        """Units of the gains of this class: those of hinges or of slides."""
        return select_joint_units(slides=self.are_slides)


@dataclass(frozen=True, eq=False)
class GainStudy(Tabular):
    """Stable gains of a standing robot under a sampled PD controller.

    Attributes:
        name: Name of the robot.
        stand: Stand on MuJoCo's soft ground if possible, otherwise on rigid ground; posture of a
            robot with a fixed base.
        servos: Origin and range of the present gains.
        integrator: MuJoCo integrator of the model.
        timestep: Time step of the model (s).
        period: Control period (s).
        delay: Delay between measurement and effect of a command, rounded to time steps (s).
        error: Position error at which the servo torque of hinges must not exceed the torque limit
            (rad); None if not requested.
        encoder_bits: Number of bits of the encoders: 2^bits counts per turn; None: not
            requested.
        classes: Joint classes with their bounds.
        by_inertia: Whether the reference gains are proportional to the inertia that each motor
            accelerates, because no tried factors on the present gains are stable.
        least_kp: Lower bound of the stiffness, with the torques of the stand as feed-forward.
        largest_kp: Upper bound of the stiffness.
        largest_kd: Upper bound of the damping.
        least_kp_alone: Smallest stiffness, equal at all joints, with which the robot stands without
            feed-forward (N m/rad or N/m). None if there is none, or the base is fixed.
        sag_failure: Reason why the robot does not stand with the present stiffness if there is no
            feed-forward. None if the robot stands, or if the base is fixed.
        worst: Mode with the largest growth rate at the present gains, without dry friction.
        holds_with_friction: Whether the stand with feed-forward holds in a simulation with dry
            friction (``verify_stand``), although the mode ``worst`` grows. None if not simulated:
            ``worst`` is stable or oscillates.
        damping_ratio: Smallest damping ratio of the lasting oscillations at the present gains; 1
            without oscillation, negative if an oscillation grows.
        curve_factors: Factors on the stiffness of the curve, shape (n,).
        curve_dampings: Largest stable factor on the damping for each of ``curve_factors``, shape
            (n,); infinite without a bound, not a number if no tried damping is stable.
        curve_least_dampings: Smallest stable factor on the damping for each of ``curve_factors``,
            shape (n,); 0 without a bound, not a number if no tried damping is stable.
        recommended_kp_factor: Recommended factor on the stiffness; None without a recommendation.
        recommended_kd_factor: Recommended factor on the damping; None without a recommendation.
        missing_masses: Message about links with assumed masses; None if the files state all.
        ties: Messages about constraints of the file that tie the robot to the world.
        placeholder_inertias: Messages about link inertias that appear to be placeholders, on which
            the bounds of the damping rest.
    """

    _key_fields: ClassVar[tuple[str, ...]] = ("passed", "least_kp", "largest_kp", "largest_kd")
    _units_of_columns: ClassVar[dict[str, str]] = {
        "kp_factor": "1",
        "least_kd_factor": "1",
        "largest_kd_factor": "1",
    }

    name: str
    stand: Stand
    servos: ServosUsed
    integrator: str
    timestep: float = field(metadata={"unit": "s"})
    period: float = field(metadata={"unit": "s"})
    delay: float = field(metadata={"unit": "s"})
    error: float | None = field(metadata={"unit": "rad"})
    encoder_bits: int | None = field(metadata={"unit": "1"})
    classes: tuple[JointClass, ...]
    by_inertia: bool
    least_kp: GainBound
    largest_kp: GainBound
    largest_kd: GainBound
    least_kp_alone: float | None = field(metadata={"unit": STIFFNESS_UNIT})
    sag_failure: Diagnostic | None
    worst: WorstMode
    damping_ratio: float = field(metadata={"unit": "1"})
    curve_factors: Array = field(metadata={"unit": "1"})
    curve_dampings: Array = field(metadata={"unit": "1"})
    curve_least_dampings: Array = field(metadata={"unit": "1"})
    recommended_kp_factor: float | None = field(metadata={"unit": "1"})
    recommended_kd_factor: float | None = field(metadata={"unit": "1"})
    holds_with_friction: bool | None = None
    missing_masses: Diagnostic | None = None
    ties: tuple[Diagnostic, ...] = ()
    placeholder_inertias: tuple[Diagnostic, ...] = ()

    def _columns(self) -> dict[str, Array]:
        """Return {column: values, shape (n,)} of the curve: factors on stiffness and damping."""
        return {
            "kp_factor": self.curve_factors,
            "least_kd_factor": self.curve_least_dampings,
            "largest_kd_factor": self.curve_dampings,
        }

    @property
    def passed(self) -> bool:
        """Whether the robot stands stably with the present gains, within torque and encoder bounds.

        False also if the robot is predicted not to stand without feed-forward, if an invalid servo
        of the file was replaced, if the mass of a link was assumed, or if `ties` contains an error.
        """
        return self.stands_stably and self.missing_masses is None and not contains_error(self.ties)

    @property
    def stands_stably(self) -> bool:
        """Whether `passed` is True apart from assumed masses and ties."""
        replaced = self.servos.replacement_servos
        stable = self.worst.stable and self.sag_failure is None
        return stable and not self.exceeded and not replaced

    @property
    def uniform(self) -> bool:
        """Whether all joints have the same reference stiffness and the same reference damping."""
        return (
            len(
                {
                    (joint_class.reference_kp, joint_class.reference_kd)
                    for joint_class in self.classes
                }
            )
            == 1
        )

    @property
    def units(self) -> JointUnits:
        """Units of the gains of all joints; mixed units if there are hinges and slides."""
        return combine_joint_units(joint_class.units for joint_class in self.classes)

    @property
    def exceeded(self) -> tuple[JointClass, ...]:
        """Joint classes whose kp exceeds the bound of a torque limit, or kd that of the encoder."""
        return tuple(
            joint_class
            for joint_class in self.classes
            if (
                joint_class.largest_kp_of_torque is not None
                and joint_class.kp > joint_class.largest_kp_of_torque
            )
            or (
                joint_class.largest_kd_of_encoder is not None
                and joint_class.kd > joint_class.largest_kd_of_encoder
            )
        )


_STAGE = "bounds of gains"
"""Name that progress reports show while `study_gains` searches for bounds."""

_NUM_BOUNDS = 3
"""Number of bounds for all joints together that `study_gains` searches first: smallest and largest
stiffness, largest damping. Counted as parts in reports of progress."""


@check_arguments
def study_gains(
    robot: Robot,
    stance: StandTask | Stand,
    *,
    kp: ArrayLike | None = None,
    kd: ArrayLike | None = None,
    rate: float | None = None,
    delay: float = 0.0,
    error: float | None = None,
    encoder_bits: int | None = None,
) -> GainStudy:
    """Find the gains with which a robot stands stably under a sampled PD controller.

    Args:
        robot: Robot.
        stance: Stand task, or a stand that satisfies a task on rigid ground.
        kp: Present stiffness [N m/rad, N/m], scalar or shape (nu,); default: kp of the model.
        kd: Present damping [N m s/rad, N s/m], scalar or shape (nu,); default: kd of the model.
        rate: Control rate [Hz]; default: one command per time step of the model.
        delay: Time between measurement and effect of a command [s].
        error: Position error [rad] at which the servo torque of hinges must not exceed the torque
            limit, which bounds kp. Default: no such bound.
        encoder_bits: Resolution of the encoders of hinges [bits per turn], which bounds kd:
            velocities are computed from differences of the readings. Default: no such bound.

    Raises:
        ConfigurationError: If an argument is out of range or invalid for the robot, or no tried
            gains are stable.
        ModelError: If a joint has no position servo while kp and kd are not both given, or the
            torque limit of a motor is smaller than the torque of the stand, for example.
    """
    _check_resolution(error, encoder_bits)
    robot, stand = resolve_stance(robot, stance)
    settled = solve_stand_as_simulated(robot, stand)
    held = make_stand_start(robot, settled, kp=kp, kd=kd)
    _check_motor_torques(held)
    loop = ControlledStand(held, rate, delay)
    present = np.array(held.drive.kp), np.array(held.drive.kd)
    groups = group_joints(robot, *present)
    num_parts = _NUM_BOUNDS + len(groups) + 2 * _CURVE_HALF_LENGTH + 1 + _NUM_LOWER_POINTS
    gains, stable_pair, by_inertia = _select_reference(loop, present, groups)
    stable, least_kp, largest_kp, largest_kd = _find_common_bounds(gains, stable_pair, num_parts)
    failure, alone = _evaluate_present_sag(robot, settled, present[0])
    if by_inertia and not robot.is_base_fixed:
        least_alone = gains.find_factor_without_sag(robot, settled)
    else:
        least_alone = gains.find_smallest_factor(alone or 0.0)
    recommended = gains.recommend_factors(stable, least_alone)
    classes = []
    for count, members in enumerate(groups):
        report_progress(_STAGE, _NUM_BOUNDS + count, num_parts)
        classes.append(
            gains.describe_class(
                robot,
                members,
                present,
                least_kp,
                largest_kd,
                stable_pair,
                recommended,
                error,
                encoder_bits,
            )
        )
    least = least_kp.factor or 0.0
    curve, dampings, least_dampings = _compute_damping_curves(gains, least, num_parts)
    worst = loop.find_worst_mode(*present)
    return GainStudy(
        name=robot.name,
        stand=settled,
        servos=find_servos_used(robot, kp, kd),
        integrator=held.drive.integrator,
        timestep=float(held.drive.model.opt.timestep),
        period=loop.period,
        delay=loop.delay,
        error=error,
        encoder_bits=encoder_bits,
        classes=tuple(classes),
        by_inertia=by_inertia,
        least_kp=least_kp,
        largest_kp=largest_kp,
        largest_kd=largest_kd,
        least_kp_alone=alone,
        sag_failure=failure,
        worst=worst,
        holds_with_friction=_simulate_with_friction(robot, settled, present, worst),
        damping_ratio=loop.find_smallest_damping_ratio(*present),
        curve_factors=curve,
        curve_dampings=dampings,
        curve_least_dampings=least_dampings,
        recommended_kp_factor=recommended[0],
        recommended_kd_factor=recommended[1],
        missing_masses=describe_missing_masses(robot),
        ties=describe_ties(robot, stand),
        placeholder_inertias=report_placeholder_inertias(get_loaded_robot(robot)),
    )


def _select_reference(
    loop: ControlledStand, present: _Pair, groups: Sequence[Sequence[int]]
) -> tuple[_Gains, tuple[float, float], bool]:
    """Select the reference gains: the present gains, or gains proportional to inertia.

    Returns:
        Reference gains; factors on kp and kd with which the stand is stable; whether the gains are
        proportional to the inertia that each motor accelerates.

    Raises:
        ConfigurationError: If no tried gains are stable.
    """
    gains = _Gains(loop, *present)
    stable_pair = gains.find_stable_pair()
    if stable_pair is not None:
        return gains, stable_pair, False
    # For example, a humanoid with equal gains at ankles and wrists: the weight requires a stiff
    # ankle, and a wrist with this kd oscillates.
    inertias = loop.compute_joint_inertias()
    for members in groups:
        inertias[list(members)] = np.exp(np.log(inertias[list(members)]).mean())
    driven = np.isfinite(inertias)
    shape = np.where(driven, inertias, 0.0)
    if driven.any():
        kp, kd = shape * _REFERENCE_FREQUENCY**2, shape * _REFERENCE_FREQUENCY
        stable_pair = _Gains(loop, kp, kd).find_stable_pair()
        if stable_pair is not None:
            return _Gains(loop, stable_pair[0] * kp, stable_pair[1] * kd), (1.0, 1.0), True
    raise ConfigurationError("kp", diagnose("no-stable-gains", most=MAX_FACTOR))


def _find_common_bounds(
    gains: _Gains, stable_pair: tuple[float, float], num_parts: int
) -> tuple[tuple[float | None, float | None], GainBound, GainBound, GainBound]:
    """Find the bounds of stiffness and damping if the gains of all joints are scaled together.

    Returns:
        (smallest, largest) stable factor on kp, None without a bound; bound of the smallest kp;
        bound of the largest kp; bound of the largest kd.
    """
    stiffness, damping = stable_pair

    def with_stiffness(factor: float) -> _Pair:
        """Return kp = ``factor`` times the reference kp, and the kd of ``stable_pair``."""
        return gains.scale_gains(factor, damping)

    def with_damping(factor: float) -> _Pair:
        """Return the kp of ``stable_pair``, and kd = ``factor`` times the reference kd."""
        return gains.scale_gains(stiffness, factor)

    report_progress(_STAGE, 0, num_parts)
    least, largest = gains.find_stable_factors(with_stiffness, stiffness)
    least_kp = gains.make_bound(least, with_stiffness, below=True)
    report_progress(_STAGE, 1, num_parts)
    largest_kp = gains.make_bound(largest, with_stiffness, below=False)
    report_progress(_STAGE, 2, num_parts)
    _, end = gains.find_stable_factors(with_damping, damping)
    largest_kd = gains.make_bound(end, with_damping, below=False)
    report_progress(_STAGE, _NUM_BOUNDS, num_parts)
    return (least, largest), least_kp, largest_kp, largest_kd


def _evaluate_present_sag(
    robot: Robot, settled: Stand, kp: Array
) -> tuple[Diagnostic | None, float | None]:
    """Predict a free-base stand without feed-forward: failure at present kp, and smallest kp.

    A fixed or welded base cannot fall.

    Returns:
        Reason why the robot does not stand with the present stiffness, or None; smallest common
        stiffness of all joints with which the robot stands [N m/rad, N/m], or None.
    """
    if robot.is_base_fixed:
        return None, None
    failure = find_sag_failure(robot, settled, kp=kp)
    alone = None
    with contextlib.suppress(NoStiffnessError):
        alone = minimum_stiffness(robot, settled)
    return failure, alone


def _simulate_with_friction(
    robot: Robot, settled: Stand, gains: _Pair, worst: WorstMode
) -> bool | None:
    """Return True if a stand with a growing mode holds in simulation, with feed-forward.

    None if ``worst`` is stable, or oscillates: the simulated servos are no sampled PD controller.
    """
    if worst.stable or worst.frequency:
        return None
    kp, kd = gains
    return verify_stand(robot, settled, kp=kp, kd=kd, until_failure=True).stays


def _choose_curve_factors(least: float) -> Array:
    """Return the factors on kp of the damping curves, shape (n,), ascending.

    The factors are around 1. If ``least``, the smallest stable factor on kp, is below these
    factors, further factors down to ``least`` are added: the stable region has no gap.
    """
    powers = np.arange(-_CURVE_HALF_LENGTH, _CURVE_HALF_LENGTH + 1, dtype=float)
    curve: Array = _CURVE_RATIO**powers
    if 0 < least < _MAX_LOWER_RATIO * curve[0]:
        lower = np.geomspace(least, curve[0], _NUM_LOWER_POINTS + 1)[:-1]
        curve = np.concatenate([lower, curve])
    return curve


def _compute_damping_curves(
    gains: _Gains, least: float, num_parts: int
) -> tuple[Array, Array, Array]:
    """Compute the bounds of the stable factors on kd for each factor on kp of the curve.

    Returns:
        Factors on kp; largest factors on kd, which may be infinite or NaN; smallest factors on kd,
        which may be 0 or NaN; shape (n,) each.
    """
    curve = _choose_curve_factors(least)
    dampings, least_dampings = [], []
    for count, factor in enumerate(curve.tolist()):
        report_progress(_STAGE, num_parts - len(curve) + count, num_parts)
        dampings.append(gains.find_largest_damping(factor))
        least_dampings.append(gains.find_smallest_damping(factor, dampings[-1]))
    return curve, np.array(dampings), np.array(least_dampings)


def _check_resolution(error: float | None, encoder_bits: int | None) -> None:
    """Raise a ConfigurationError if position error [rad] or encoder resolution is out of range."""
    if error is not None and not 0 < error < math.inf:
        raise ConfigurationError("error", diagnose("error-not-valid", given=error))
    if encoder_bits is not None and not MIN_ENCODER_BITS <= encoder_bits <= MAX_ENCODER_BITS:
        raise ConfigurationError(
            "encoder_bits",
            diagnose(
                "encoder-not-valid", given=encoder_bits, low=MIN_ENCODER_BITS, high=MAX_ENCODER_BITS
            ),
        )


def _check_motor_torques(held: StandStart) -> None:
    """Raise a ModelError if the torque limit of a motor is smaller than the torque of the stand.

    No gains can prevent this failure.
    """
    robot, statics = held.robot, held.prediction
    null = describe_zero_torque_limits(robot)
    if null is not None and loads_motor_without_torque(robot, statics):
        raise ModelError(robot.name, null)
    overloaded = find_overloaded_motors(statics)
    if not overloaded:
        return
    hardest = int(np.argmax(statics.motor_utilisation))
    joint = statics.joint_names[hardest]
    unit = force_unit(robot, joint)
    raise ModelError(
        robot.name,
        diagnose(
            "stand-overloads-motors",
            joint=joint,
            torque=Quantity(abs(float(statics.joint_torques[hardest])), unit),
            limit=Quantity(float(robot.effort_limits[hardest]), unit),
            more=[name for name in overloaded if name != joint],
        ),
    )


_Pair = tuple[Array, Array]
"""Stiffness kp [N m/rad, N/m] and damping kd [N m s/rad, N s/m] of all joints, shape (nu,) each."""


class _Gains:
    """Reference gains of a standing robot, and searches for the bounds of stability.

    Args:
        loop: The controlled stand.
        kp: Reference stiffness, which the factors multiply, shape (nu,) [N m/rad, N/m].
        kd: Reference damping, which the factors multiply, shape (nu,) [N m s/rad, N s/m].
    """

    def __init__(self, loop: ControlledStand, kp: Array, kd: Array) -> None:
        self.loop, self.kp, self.kd = loop, kp, kd

    def scale_gains(self, stiffness: float, damping: float) -> _Pair:
        """Return the reference kp times ``stiffness``, and the reference kd times ``damping``."""
        return stiffness * self.kp, damping * self.kd

    def find_stable_pair(self) -> tuple[float, float] | None:
        """Find a stable pair of factors on kp and kd: powers of two, tried from 1 outwards.

        None if no tried pair is stable.
        """
        powers = range(-MAX_POWER, MAX_POWER + 1)
        # At equal distance, prefer the reference kp: the bound of kd then applies to this kp.
        pairs = sorted(
            product(powers, powers), key=lambda pair: (abs(pair[0]) + abs(pair[1]), abs(pair[0]))
        )
        for stiffness, damping in pairs:
            is_near = abs(stiffness) + abs(damping) <= _NEAR_POWER
            if not is_near and (stiffness % 2 or damping % 2):
                continue
            if self._is_stable(self.scale_gains(2.0**stiffness, 2.0**damping)):
                return 2.0**stiffness, 2.0**damping
        return None

    def find_smallest_factor(self, stiffness: float) -> float:
        """Return the factor with which the smallest positive reference kp equals ``stiffness``."""
        return stiffness / float(self.kp[self.kp > 0].min(initial=math.inf))

    def find_factor_without_sag(self, robot: Robot, stand: Stand) -> float:
        """Find the smallest tried factor on the stiffness that holds a stand without feed-forward.

        Infinite if no tried factor suffices.
        """
        count = round(math.log(MAX_FACTOR) / math.log(_SAG_RATIO))
        factors = [_SAG_RATIO**power for power in range(-count, count + 1)]
        smallest = math.inf
        low, high = 0, len(factors)
        while low < high:  # a stiffer robot sags less
            middle = (low + high) // 2
            if find_sag_failure(robot, stand, kp=factors[middle] * self.kp) is None:
                smallest, high = factors[middle], middle
            else:
                low = middle + 1
        return smallest

    def find_stable_factors(
        self, gains: Callable[[float], _Pair], inside: float
    ) -> tuple[float | None, float | None]:
        """Find the interval of gain factors, around a stable factor, in which the stand is stable.

        ``gains`` returns kp and kd of all joints, shape (nu,) each, for a factor; ``inside`` is
        stable.

        Returns:
            Lower and upper end of the interval; None for an end at which no tried factor is
            unstable.
        """
        return self._find_end(gains, inside, 0.5), self._find_end(gains, inside, 2.0)

    def _is_stable(self, pair: _Pair) -> bool:
        """Return True if the controlled stand is stable with these kp and kd, shape (nu,) each."""
        return self.loop.is_stable(*pair)

    def _find_end(
        self, gains: Callable[[float], _Pair], inside: float, ratio: float
    ) -> float | None:
        """Return the last stable factor on the gains, searched from the stable factor ``inside``.

        ``ratio`` is the ratio of successive factors: above 1, the upper end of the stable interval
        is searched. None if no tried factor is unstable.
        """
        stable = inside
        while 1 / MAX_FACTOR <= stable * ratio <= MAX_FACTOR:
            unstable = stable * ratio
            if not self._is_stable(gains(unstable)):
                return bisect_factor(
                    lambda factor: self._is_stable(gains(factor)),
                    stable,
                    unstable,
                    FACTOR_TOLERANCE,
                )
            stable = unstable
        return None

    def make_bound(
        self, factor: float | None, gains: Callable[[float], _Pair], *, below: bool
    ) -> GainBound:
        """Confirm a stability bound of the gains, found by the linear model, in simulations.

        ``factor`` is the bound of the linear model on the reference gains, None without a bound.
        ``gains`` returns kp and kd of all joints for a factor. ``below``: smaller factors are
        unstable.
        """
        if factor is None:
            return GainBound(None, None, 0.0, ())
        beyond = factor * (1 - 0.05 if below else 1 + 0.05)
        mode = self.loop.find_worst_mode(*gains(beyond))
        duration = HOLD_DURATION if below else _SHAKE_DURATION

        def survives_simulation(factor: float) -> bool:
            """Return True if the robot keeps the stand in a simulation with ``gains(factor)``."""
            return self.loop.survives_simulation(*gains(factor), duration=duration, mode=mode)

        ratio = 1 / _SIMULATED_RANGE if below else _SIMULATED_RANGE
        simulated = None
        if survives_simulation(factor / ratio) and not survives_simulation(factor * ratio):
            simulated = bisect_factor(
                survives_simulation, factor / ratio, factor * ratio, _SIMULATED_TOLERANCE
            )
        return GainBound(factor, simulated, mode.frequency, mode.joints)

    def find_largest_damping(self, stiffness: float) -> float:
        """Return the largest stable factor on kd if kp is multiplied by the factor ``stiffness``.

        Infinite if no upper bound is found; NaN if no tried factor is stable.
        """
        kp, _ = self.scale_gains(stiffness, 1.0)
        return find_largest_damping_factor(self.loop, kp, self.kd)

    def find_smallest_damping(self, stiffness: float, largest: float) -> float:
        """Return the smallest stable factor on kd, below the factor ``largest``.

        ``stiffness`` is the factor on kp, and ``largest`` the result of `find_largest_damping`.
        0 if no tried factor is unstable; NaN if ``largest`` is NaN.
        """
        if math.isnan(largest):
            return math.nan
        inside = min(largest, MAX_FACTOR)
        least = self._find_end(lambda factor: self.scale_gains(stiffness, factor), inside, 0.5)
        return 0.0 if least is None else least

    def recommend_factors(
        self, stiffness: tuple[float | None, float | None], least_alone: float
    ) -> tuple[float | None, float | None]:
        """Recommend factors on all stiffnesses and dampings, away from the bounds of stability.

        Args:
            stiffness: Lower and upper bound of the factor on the stiffness; None without a bound.
            least_alone: Lower bound of the factor on the stiffness with which the robot stands
                without feed-forward; 0 without a bound.

        Returns:
            Factors on stiffness and damping; (None, None) without a recommendation.
        """
        low, high = stiffness
        if not self.kd.any():
            return None, None
        least = max(low or 0.0, least_alone)
        least, most = least * GAIN_MARGIN, (math.inf if high is None else high / GAIN_MARGIN)
        if least > most or math.isinf(least):
            return None, None
        factor = float(np.clip(1.0, least, most))
        end = self.find_largest_damping(factor) / GAIN_MARGIN
        if math.isnan(end):
            return None, None
        tried = [2.0 ** (power / 2) for power in range(-20, 21) if 2.0 ** (power / 2) <= end]
        ratios = {
            damping: self.loop.find_smallest_damping_ratio(*self.scale_gains(factor, damping))
            for damping in tried
            if self._is_stable(self.scale_gains(factor, damping))
        }
        if not ratios:
            return None, None
        enough = [damping for damping, ratio in ratios.items() if ratio >= MIN_DAMPING_RATIO]
        if enough:  # the tried damping that changes the reference least
            return factor, min(enough, key=lambda damping: abs(math.log(damping)))
        return factor, max(ratios, key=ratios.__getitem__)

    def describe_class(
        self,
        robot: Robot,
        members: Sequence[int],
        present: _Pair,
        least_kp: GainBound,
        largest_kd: GainBound,
        stable_pair: tuple[float, float],
        recommended: tuple[float | None, float | None],
        error: float | None,
        encoder_bits: int | None,
    ) -> JointClass:
        """Create the result of a joint class: present gains, bounds and recommended gains.

        ``members`` contains joint indices, ``recommended`` factors on kp and kd, and
        ``stable_pair`` factors with which the stand is stable. ``error`` is in rad,
        ``encoder_bits`` in bits per turn.
        """
        kp, kd = (float(gain[members[0]]) for gain in (self.kp, self.kd))
        limit = float(robot.effort_limits[list(members)].min())
        limited = math.isfinite(limit) and limit > 0

        def scale_class_damping(factor: float) -> _Pair:
            """Return kp and kd of ``stable_pair``, (nu,) each, with the kd of this class scaled."""
            stiffness, damping = self.scale_gains(*stable_pair)
            damping[list(members)] *= factor
            return stiffness, damping

        alone = self._find_end(scale_class_damping, 1.0, 2.0) if kd else None
        are_slides = is_slide(robot, robot.joint_names[members[0]])
        if are_slides:  # an angle, and counts per turn, are no positions of slides
            error = encoder_bits = None
        count = 2 * math.pi / 2**encoder_bits if encoder_bits is not None else 0.0
        return JointClass(
            name=name_joints([robot.joint_names[joint] for joint in members]),
            joints=tuple(robot.joint_names[joint] for joint in members),
            kp=float(present[0][members[0]]),
            kd=float(present[1][members[0]]),
            reference_kp=kp,
            reference_kd=kd,
            least_kp=_scale_gain(kp, least_kp.factor),
            largest_kd=_scale_gain(kd, largest_kd.factor),
            largest_kd_alone=_scale_gain(kd * stable_pair[1], alone),
            largest_kp_of_torque=limit / error if limited and error is not None else None,
            largest_kd_of_encoder=(
                MAX_NOISE_RATIO * limit * self.loop.period / count if limited and count else None
            ),
            recommended_kp=_scale_gain(kp, recommended[0]),
            recommended_kd=_scale_gain(kd, recommended[1]),
            are_slides=are_slides,
        )


def _scale_gain(gain: float, factor: float | None) -> float | None:
    """Return a gain (kp or kd) times a factor, in the unit of the gain; None if factor is None."""
    return None if factor is None else gain * factor
