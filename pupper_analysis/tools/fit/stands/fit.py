"""Fit of stands at rest: masses, CoM positions, encoder offsets, servo stiffness and leg lengths.

Inputs are commands and positions of the joints in several stands. Outputs are estimates with 95 %
intervals, and failures if the model does not explain the measurements. `StandEquations` computes
the residuals, `estimate_parameters` minimises them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.arguments import check_arguments, check_finite
from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.base.errors import ConfigurationError, FitError, MeasurementError
from pupper_analysis.base.results import Result
from pupper_analysis.base.units import HINGE_UNITS, POSITION_UNIT
from pupper_analysis.robot.joints import joint_unit
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import list_position_servos, resolve_servo_gains
from pupper_analysis.tools.fit.estimate import (
    HALF_WIDTH_95,
    LinearisedResiduals,
    Posterior,
    estimate_parameters,
)
from pupper_analysis.tools.fit.measurements.stands import (
    MIN_STANDS,
    MeasuredStands,
    estimate_encoder_step,
)
from pupper_analysis.tools.fit.parameters import (
    AXES,
    PARAMETER_KINDS,
    SURROUNDINGS_KINDS,
    Parameter,
    ParameterTable,
    Prior,
    apply_priors,
    list_bodies,
    parse_priors,
)
from pupper_analysis.tools.fit.result import (
    Estimate,
    Fit,
    derive_estimate,
    describe_parameters,
    estimate_kp_over_mass,
)
from pupper_analysis.tools.fit.stands.equations import StandEquations, StandNoise
from pupper_analysis.tools.fit.stands.wiring import find_wiring


@dataclass(frozen=True)
class JointResidual(Result):
    """Error of a measured joint position in a stand, to find contradictory readings.

    Attributes:
        stand: Stand name.
        joint: Joint name.
        residual: Measured position minus the position that agrees best with all other readings.
        deviations: ``residual`` divided by the standard deviation, which includes noise and the
            uncertainty of the parameters.
        unit: Unit of ``residual``: rad, or m for a slide.
    """

    stand: str
    joint: str
    residual: float = field(metadata={"unit": POSITION_UNIT})
    deviations: float = field(metadata={"unit": "1"})
    unit: str = HINGE_UNITS.position


@dataclass(frozen=True, eq=False)
class StandFit(Fit):
    """Parameters of a robot, estimated from stands at rest.

    Attributes:
        stands: Number of stands.
        total_mass: Mass of the whole robot.
        com: Centre of mass of the whole robot (x, y, z) in the base frame, at the nominal joint
            positions of the file.
        kp_factor: Geometric mean of estimated kp / stated kp over the joints. None if no kp is
            estimated: kp is known, or no servo was commanded.
        weight: Mass of the whole robot that a scale showed; None if not weighed.
        residuals: RMS residual of each stand, in standard deviations of the noise.
        joint_residuals: Error of each measured joint position in each stand, sorted by the number
            of standard deviations, the largest first.
        noise: Noise levels, assumed or estimated, as standard deviations. Exception: ``friction``
            is the bound of the random dry friction, as a factor on the stated dry friction.
    """

    stands: int
    total_mass: Estimate = field(metadata={"unit": "kg"})
    com: tuple[Estimate, ...] = field(metadata={"unit": "m"})
    kp_factor: Estimate | None
    weight: float | None = field(metadata={"unit": "kg"})
    residuals: Mapping[str, float] = field(metadata={"unit": "1"})
    joint_residuals: tuple[JointResidual, ...]
    noise: Mapping[str, float] = field(metadata={"unit": "rad or m"})


def _list_joint_residuals(
    robot: Robot, stands: MeasuredStands, equations: StandEquations, known: Posterior
) -> tuple[JointResidual, ...]:
    """Return the errors of the measured joint positions [rad, m], most significant first.

    An error is the measured position minus the position that the other measurements predict.
    """
    deviation, std = equations.estimate_position_errors(known)
    units = {joint: joint_unit(robot, joint) for joint in stands.joints}
    residuals = [
        JointResidual(
            stand,
            joint,
            float(deviation[row, column]),
            float((deviation / std)[row, column]),
            units[joint],
        )
        for row, stand in enumerate(stands.names)
        for column, joint in enumerate(stands.joints)
    ]
    return tuple(sorted(residuals, key=lambda residual: -abs(residual.deviations)))


def _estimate_total_mass(robot: Robot, posterior: Posterior) -> Estimate:
    """Return the estimate of the robot's total mass [kg], from the distribution of all masses."""
    gradient = (posterior.kinds == "mass").astype(float)
    stated = np.array([parameter.stated for parameter in posterior.parameters])
    quantity = Parameter("mass", robot.name, "", robot.total_mass, 0.0)
    mean = robot.total_mass + float(gradient @ (posterior.mean - stated))
    return derive_estimate(posterior, quantity, mean, gradient)


def estimate_com(robot: Robot, posterior: Posterior) -> Iterator[Estimate]:
    """Yield the estimates of x, y, z of the robot's CoM [m], in the base frame.

    Joints are at the positions ``robot.nominal``. Body i has mass m_i, CoM c_i in the body frame,
    and pose R_i, p_i in the base frame. With M = sum m_i and x_i = R_i c_i + p_i:

        com = sum m_i x_i / M
        d com / d m_i = (x_i - com) / M
        d com / d c_i = R_i m_i / M
    """
    model = robot.structure.model
    data = model.createData()
    pin.forwardKinematics(
        model, data, robot.structure.convention.unit_q(robot.make_qpos(robot.nominal))
    )
    table, mean = ParameterTable(posterior.parameters), posterior.mean
    masses, body_coms, gradients, stated = [], [], np.zeros((3, len(mean))), np.zeros(3)
    for link, number in list_bodies(robot):
        inertia, base_to_body = model.inertias[number], data.oMi[1].actInv(data.oMi[number])
        mass, com = table.get_inertial(mean, link, inertia)
        masses.append(mass)
        body_coms.append(base_to_body.act(com))
        stated += inertia.mass * base_to_body.act(inertia.lever)
        for axis, column in zip(AXES, base_to_body.rotation.T, strict=True):
            if (index := table.find_index("com", link, axis)) is not None:
                gradients[:, index] = mass * column
    robot_com = np.array(masses) @ np.array(body_coms) / sum(masses)
    for (link, _), body_com in zip(list_bodies(robot), body_coms, strict=True):
        if (index := table.find_index("mass", link)) is not None:
            gradients[:, index] = body_com - robot_com
    for number, axis in enumerate(AXES):
        quantity = Parameter("com", robot.name, axis, float(stated[number] / robot.total_mass), 0.0)
        yield derive_estimate(
            posterior, quantity, float(robot_com[number]), gradients[number] / sum(masses)
        )


# Checks: noise, parameters and surroundings that contradict the model.


def check_scale(
    robot: Robot, posterior: Posterior, weight: float | None = None, *, level: bool = True
) -> Iterator[Diagnostic]:
    """Yield a failure if mean kp, total mass and load are jointly improbable, given the files.

    A wrong weight on the scale changes many parameters a little, so that they are tested together.
    The load is the force on the feet in excess of the weight of the masses.

    Args:
        robot: Robot.
        posterior: Distribution of the parameters.
        weight: Mass of the whole robot on a scale [kg], for the message; None if not weighed.
        level: Whether the ground is level. On a slope, or with a known mass, the load is not
            tested.
    """
    from scipy import stats  # slow to import

    table, kinds = ParameterTable(posterior.parameters), posterior.kinds
    # A known mass tests the load by itself.
    masses, tests_load = (
        kinds == "mass",
        level and "added" not in kinds,
    )
    mass_gradient = np.zeros(len(table))
    # ``moved`` belongs to logarithms: use the prior width at the stated mass.
    mass_gradient[masses] = (table.width * table.stated)[masses] / posterior.mean[masses]
    combinations = np.array(
        [kinds == "kp", mass_gradient / robot.total_mass, tests_load & (kinds == "load")]
    )
    combinations = combinations[combinations.any(axis=1)]
    if not len(combinations):
        return
    surprise, rank, _ = _compute_surprise(posterior, combinations)
    if not rank or stats.chi2.sf(surprise, rank) > _SURPRISE_PROBABILITY:
        return
    kp_factor, total_mass = (
        estimate_kp_over_mass(posterior, kp_only=True),
        _estimate_total_mass(robot, posterior),
    )
    yield diagnose(
        "scale-far-from-the-file",
        weight=None if weight is None else Quantity(weight, "kg"),
        kp=None if kp_factor is None else kp_factor.mean,
        mass=total_mass.mean / robot.total_mass,
    )


def _compute_surprise(
    posterior: Posterior, combinations: Array, expected_ratio: float = 1.0
) -> tuple[float, int, Array]:
    """Test by chi2 whether combinations of parameters changed more than the prior allows.

    Let d be the change from the prior mean, and S = prior covariance minus posterior covariance, in
    the directions that the measurements determine. If the prior is right, d^T S^-1 d follows chi2.

    Args:
        posterior: Distribution of the parameters.
        combinations: Linear combinations, shape (k, n), of the parameters / prior widths.
        expected_ratio: Expected standard deviation of a change / prior standard deviation.

    Returns:
        chi2, its degrees of freedom, and the changes of the combinations without the shrinkage by
        the prior, shape (k,).
    """
    width = np.array([parameter.width for parameter in posterior.parameters])
    prior_covariance = combinations @ np.linalg.inv(posterior.precision) @ combinations.T
    sizes = np.sqrt(np.diag(prior_covariance))
    reduction = (
        prior_covariance
        - combinations @ (posterior.covariance / np.outer(width, width)) @ combinations.T
    )
    eigenvalues, eigenvectors = np.linalg.eigh(reduction / np.outer(sizes, sizes))
    kept = eigenvalues > _MIN_VARIANCE_REDUCTION
    moved = eigenvectors[:, kept].T @ (combinations @ posterior.moved / sizes)
    innovation = (prior_covariance / sizes) @ eigenvectors[:, kept] @ (moved / eigenvalues[kept])
    expected = eigenvalues[kept] * (1 - (1 - expected_ratio**2) * eigenvalues[kept])
    return float(np.sum(moved**2 / expected)), int(np.count_nonzero(kept)), innovation


def _report_unmodelled_effects(posterior: Posterior, friction_error: float) -> Iterator[Diagnostic]:
    """Yield notes on a dead band of the servos and on a load, which no model file can state.

    Dry friction may appear as a dead band up to ``friction_error``: mean dry friction / mean kp
    [rad, m].
    """
    loaded = "added" in posterior.kinds
    for index, parameter in enumerate(posterior.parameters):
        mean, half_width = float(posterior.mean[index]), float(HALF_WIDTH_95 * posterior.std[index])
        if abs(mean) < half_width or (parameter.kind == "load" and not loaded):
            continue
        if parameter.kind == "deadband" and mean - half_width > friction_error:
            angle, interval = Quantity(mean, "rad"), Quantity(half_width, "rad")
            yield diagnose("servos-have-a-dead-band", angle=angle, half=interval)
        elif parameter.kind == "load":
            yield diagnose("more-stands-there", load=100 * mean, half=100 * half_width)


_SURPRISE_PROBABILITY = 0.0027
"""Probability of a chi2 at least as large as the observed value, if the priors are right, below
which a deviation is reported. The value belongs to three standard deviations. Chosen, not tuned.
"""

_MIN_VARIANCE_REDUCTION = 0.02
"""Lower bound of the reduction of a variance by the measurements, relative to the prior variance,
in tests for deviations from the prior. With a smaller reduction, a tiny change of a poorly
determined estimate would count as a large deviation. Chosen, not tuned.
"""

_MIN_NAMED_STDS = 2.0
"""Deviation of a foot's parameter from the prior, in standard deviations, above which the message
names the foot. Chosen, not tuned.
"""

_MAX_FLATNESS_RATIO = 5.0
"""Upper bound of the ratio of estimated to expected unevenness of the ground. With a larger ratio
the fit fails, since noise of this size would hide an error of the model. Chosen, not tuned."""

_MAX_FRICTION_RATIO = 4.0
"""Ratio of estimated to expected dry friction above which a fit fails; half of the ratio if an
implausible expected friction was scaled up. The estimate is the sum of friction of random sign
(noise) and friction of one sign (a negative dead band). Chosen, not tuned.
"""

_MAX_PARAMETER_STDS = 4.5
"""Deviation, for example of a parameter from the stated value, above which the measurements
contradict the model, in standard deviations. Derived: with a probability below 1e-3, any of a
hundred normally distributed numbers exceeds 4.5 standard deviations.
"""

_CHECKED_SURROUNDINGS = ("slope", "softness", "length", "load")
"""Kinds of parameters that ``check_surroundings`` tests: slope and softness of the ground, lengths
of the legs, and the load that the scale did not show."""

_NONZERO_KINDS, _ZERO_RTOL = ("mass", "kp"), 0.01
"""Kinds of parameters that are never zero, and the fraction of the stated value below which an
estimate counts as zero. The fraction and its square also bound divisors. Chosen, not tuned.
"""

_RESIDUALS_PROBABILITY = 1e-3
"""Lower bound of the probability (chi2 test) that noise alone causes residuals of at least the
observed size. With a smaller probability, the fit fails. Chosen, not tuned.
"""


def check_residuals(
    posterior: Posterior, estimated: StandNoise, assumed: StandNoise, friction_error: float
) -> Iterator[Diagnostic]:
    """Yield failures if the model does not explain the measurements.

    For example, chi2 of the residuals, the noise levels and the changes of the parameters are
    tested.

    Args:
        posterior: Distribution of the parameters.
        estimated: Noise levels estimated from the measurements.
        assumed: Noise levels that were expected before the fit.
        friction_error: Mean dry friction divided by the mean kp [rad, m].
    """
    from scipy import stats  # slow to import

    if (
        stats.chi2.sf(posterior.chi2, max(posterior.degrees_of_freedom, 1.0))
        < _RESIDUALS_PROBABILITY
    ):
        ratio = posterior.chi2 / max(posterior.degrees_of_freedom, 1.0)
        yield diagnose("residuals-too-large", times=math.sqrt(ratio))
    if estimated.flatness > _MAX_FLATNESS_RATIO * assumed.flatness:
        yield diagnose("feet-off-the-plane", off=Quantity(estimated.flatness, "m"))
    kinds, stated = posterior.kinds, ParameterTable(posterior.parameters).stated
    deadbands = posterior.mean[kinds == "deadband"]
    one_sided_ratio = -float(np.minimum(deadbands, 0.0).sum()) / max(friction_error, _ZERO_RTOL**2)
    max_ratio = _MAX_FRICTION_RATIO if assumed.friction == 1 else _MAX_FRICTION_RATIO / 2
    if (ratio := estimated.friction / assumed.friction + one_sided_ratio) > max_ratio:
        yield diagnose("torques-off", times=ratio)
    # If the prior is right, the variance of a change is prior minus posterior variance: a poorly
    # determined parameter stays near its stated value, and a small change of it is significant.
    change_std = np.sqrt(np.maximum(1 - posterior.variance_ratios, _MIN_VARIANCE_REDUCTION))
    moved = posterior.moved / change_std
    vanished = np.isin(kinds, _NONZERO_KINDS) & (posterior.mean < _ZERO_RTOL * stated) & (moved < 0)
    is_far = ~np.isin(kinds, SURROUNDINGS_KINDS) & (
        vanished | (np.abs(moved) > _MAX_PARAMETER_STDS)
    )
    if len(far_indices := np.flatnonzero(is_far)):
        names, deviations = (
            [posterior.parameters[place].name for place in far_indices],
            np.abs(moved[far_indices]),
        )
        yield diagnose("far-from-the-file", names=names, widths=float(deviations.max()))
    flatness_ratio = min(1.0, estimated.flatness / assumed.flatness)
    yield from check_surroundings(posterior, flatness_ratio)


def check_surroundings(posterior: Posterior, flatness_ratio: float = 1.0) -> Iterator[Diagnostic]:
    """Yield failures if estimates of ground, leg lengths or load are improbable, given the priors.

    The parameters of a kind (`_CHECKED_SURROUNDINGS`) are tested together by chi2. The load can be
    tested if a known mass was added, because only such a mass can contradict the weight on the
    scale.

    Args:
        posterior: Distribution of the parameters.
        flatness_ratio: Estimated / expected unevenness of the ground, at most 1. The square scales
            chi2 of the softness: sinking feet have the same effect as uneven ground.
    """
    from scipy import stats  # slow to import

    kinds = posterior.kinds
    for kind in _CHECKED_SURROUNDINGS:
        indices = np.flatnonzero(kinds == kind)
        if not len(indices) or (kind == "load" and "added" not in kinds):
            continue
        parameters = [posterior.parameters[index] for index in indices]
        width = np.array([parameter.width for parameter in parameters])
        # If the user has changed a prior of the lengths, the priors are the tolerance.
        uses_length_std = kind == "length" and (width == PARAMETER_KINDS[kind].width).all()
        expected_ratio = _LENGTH_STD / PARAMETER_KINDS[kind].width if uses_length_std else 1.0
        surprise, rank, innovation = _compute_surprise(
            posterior, np.eye(len(posterior.parameters))[indices], expected_ratio
        )
        surprise *= flatness_ratio**2 if kind == "softness" else 1.0
        if not rank or stats.chi2.sf(surprise, rank) > _SURPRISE_PROBABILITY:
            continue
        changes = width * innovation
        reduction = np.maximum(1 - posterior.variance_ratios[indices], _MIN_VARIANCE_REDUCTION)
        reduction *= 1 - (1 - expected_ratio**2) * reduction
        deviations = np.abs(posterior.moved[indices]) / np.sqrt(reduction)
        if kind == "load":
            yield diagnose("known-mass-contradicts-the-scale", load=100 * float(changes[0]))
        elif kind == "slope":
            largest = parameters[int(np.abs(changes).argmax())]
            slope = Quantity(float(math.hypot(*changes)), "rad")
            yield diagnose("ground-slopes", slope=slope, axis=largest.component)
        else:
            for number in np.flatnonzero(
                (deviations >= _MIN_NAMED_STDS) | (deviations == deviations.max())
            ):
                foot, change = ("foot", parameters[number].subject), float(changes[number])
                if kind == "length":
                    yield diagnose("leg-is-longer", subject=foot, longer=100 * change)
                else:
                    factor = max(0.0, parameters[number].stated + change)
                    yield diagnose("feet-sink-otherwise", subject=foot, times=factor)


_LENGTH_STD = 0.005
"""Expected standard deviation of the length factor of a leg's last link, in the test for improbable
estimates: 0.5 %, for parts that are made from the same file. The prior of the estimate is wider, so
that the legs of another variant can be fitted. Chosen, not tuned.
"""

SCALE_RTOL = 0.002
"""Standard deviation of a mass on a scale, as a fraction of the mass. Chosen, not tuned."""

KNOWN_MASS_FRACTION = 0.15
"""Default of the known mass that is added to the robot in some stands of a plan, as a fraction of
the robot's mass: 480 g on Pupper v3. Measured in plans of 12 stands of v3: the expected standard
deviation of kp is 8 % with 200 g, and 4 % with 480 g."""

_DEFAULT_ENCODER_STD = 2e-4
"""Standard deviation [rad, m] of a joint position if the readings show no encoder step: the value
of a noisy 14-bit encoder (step 3.8e-4 rad). Chosen, not tuned.
"""


_DEFAULT_FRICTION_RATIO = 5e-3
"""Default dry friction of a joint, divided by weight times height. Files that state plausible
values have, for example, 0.24 % (Pupper v3) and 0.56 % (Go1).
"""

_MIN_FRICTION_RATIO = 2e-3
"""Lower bound of plausible dry friction: mean over the joints, divided by weight times height.
Smaller frictions are scaled up. Chosen above the ratios in files that contain the 0.2 N m of Go1
for larger robots: for example, 0.04 % for HyQReal2 and Pegasus.
"""

_MAX_PULL_RATIO = 0.02
"""Largest pull of a foot on the ground, as a fraction of the weight, for a foot that the
measurements list as carrying load. With a larger computed pull, the foot was probably in the air.
Chosen, not tuned.
"""


@check_arguments
def fit_stands(
    robot: Robot,
    stands: MeasuredStands,
    *,
    priors: Sequence[Prior | str] = (),
    weight: float | None = None,
    kp: ArrayLike | None = None,
    encoder: float | None = None,
) -> StandFit:
    """Estimate a robot's parameters from stands at rest, in which compliant servos measure torque.

    A servo error implies the torque kp (command - position), if friction and dead band are
    neglected. The estimated parameters are masses, CoM positions, encoder offsets, servo stiffness
    kp, lengths of the legs' last links, and surroundings such as the slope of the ground
    (`list_parameters`). `StandEquations` defines the equations. The priors are normal distributions
    about the stated values; for masses and kp, of the logarithm. Noise levels of ground, foot
    moments and dry friction are also estimated. Stands with contradictory data may be left out,
    with a note.

    Args:
        robot: Robot with a free base and feet.
        stands: Measurements.
        priors: Prior standard deviations: ``mass=50%``, ``com:base=5mm``, ``kp=0`` (kp is exact).
        weight: Mass of the whole robot on a scale [kg], with a standard deviation of 0.2 %. A
            weight that contradicts the stands may be left out, with a failure.
        kp: Stated servo stiffness [N m/rad, N/m], a scalar or shape (nu,); the model's by default.
        encoder: Standard deviation of a joint position [rad, m]; by default derived from the
            encoder step, 2e-4 if no step is found.

    Raises:
        MeasurementError: If the measurements cannot be used or do not belong to this robot.
            Examples are too few stands, a robot that moves, missing positions, or too many
            contradictory stands.
        UnknownNameError: If the measurements name a joint, foot or link that the robot lacks.
        ConfigurationError: If an argument is invalid, the base is fixed, or the robot has closed
            loops, couplings, welds or grips.
        ModelError: If ``kp`` is passed, and a joint has no motor.
        FitError: If no parameters are found; for example, the iteration does not converge.
    """
    prior_list = parse_priors(priors)
    for name, value in (("weight", weight), ("encoder", encoder)):
        if value is not None and check_finite(name, value) <= 0:
            raise ConfigurationError(name, diagnose("not-positive", value=value))
    robot.check_floating()
    robot.check_tree("fit")
    ordered = stands.order_joints(robot).make_names_unique()

    def fit(ordered: MeasuredStands) -> StandFit:
        """Fit the parameters to stands, with the priors and options of the caller."""
        return _StandProblem.from_stands(robot, ordered, prior_list, weight, kp, encoder).solve()

    def evidence(ordered: MeasuredStands) -> float:
        """Return the log evidence of stands, with the priors and options of the caller."""
        return _StandProblem.from_stands(
            robot, ordered, prior_list, weight, kp, encoder
        ).compute_log_evidence()

    try:
        result, doubted = _fit_without_contradictions(fit, ordered)
    except (MeasurementError, FitError) as error:
        if isinstance(error, FitError) and weight is not None:  # the load may be the cause
            unweighed = fit_stands(robot, stands, priors=priors, kp=kp, encoder=encoder)
            load = unweighed.total_mass.mean / weight - 1
            if abs(load) * weight > _MAX_PARAMETER_STDS * unweighed.total_mass.std:
                failure = diagnose("known-mass-contradicts-the-scale", load=100 * load)
                return replace(unweighed, weight=weight, failures=(failure, *unweighed.failures))
        if wiring := find_wiring(robot, ordered, evidence, fit):
            raise MeasurementError(ordered.source, wiring.found) from error
        raise
    # Exchanged plugs cause residuals or excluded stands; a wrong scale and a slope do not.
    wiring = None
    if any(failure.code not in _UNRELATED_TO_WIRING for failure in result.failures):
        wiring = find_wiring(robot, ordered, evidence, fit)
    elif doubted:
        wiring = find_wiring(robot, ordered, evidence, fit, doubted)
    # The wiring explains the other failures.
    return replace(result, failures=(wiring.found,)) if wiring else result


_UNRELATED_TO_WIRING = (
    "scale-far-from-the-file",
    "known-mass-contradicts-the-scale",
    "ground-slopes",
)
"""Codes of failures that wrong wiring (exchanged plugs, or a wrong sign of a joint) does not cause.
"""


def _fit_without_contradictions(
    fit: Callable[[MeasuredStands], StandFit], stands: MeasuredStands
) -> tuple[StandFit, list[int]]:
    """Return the fit of the stands without contradictory foot contacts, and the rows left out.

    For example, the ground would have to pull a foot that is listed as carrying load.
    """
    notes: list[Diagnostic] = []
    first: MeasurementError | None = None
    remaining = stands
    while True:
        try:
            result = fit(remaining)
        except MeasurementError as error:
            if error.cause.code not in _CONTRADICTION_CODES:
                raise
            first = first or error
            if len(notes) + 1 > _MAX_EXCLUDED_FRACTION * len(stands):
                raise first from None
            name = error.cause.values["stand"]
            notes.append(diagnose("stand-left-out", why=error.cause))
            remaining = remaining.select_rows(
                [row for row, stand_name in enumerate(remaining.names) if stand_name != name]
            )
        else:
            left_out = [row for row, name in enumerate(stands.names) if name not in remaining.names]
            return replace(result, diagnostics=(*notes, *result.diagnostics)), left_out


_CONTRADICTION_CODES = ("foot-in-the-air-touches", "foot-would-pull")
"""Codes of the errors of ``_check_foot_loads``. Each error contradicts the row of a single stand.
"""

_MAX_EXCLUDED_FRACTION = 0.25
"""Largest number of stands, relative to the number of rows, that a fit leaves out because of
contradictions: more have a common cause. Chosen, not tuned.
"""


@dataclass(frozen=True, eq=False)
class _StandProblem:
    """Robot, measured stands, parameters and expected noise, from which parameters are fitted.

    Attributes:
        robot: Robot.
        stands: Stands, with the mean of repeated readings.
        stiffness: Stated kp, shape (nu,) [N m/rad, N/m].
        friction: Dry friction, shape (nu,) [N m, N], with a default for joints without a stated
            value.
        table: Parameters.
        noise: Expected noise.
        weight: Mass of the whole robot on a scale [kg]; None if not weighed.
    """

    robot: Robot
    stands: MeasuredStands
    stiffness: Array
    friction: Array
    table: ParameterTable
    noise: StandNoise
    weight: float | None

    @staticmethod
    def from_stands(
        robot: Robot,
        stands: MeasuredStands,
        priors: Sequence[Prior],
        weight: float | None,
        kp: ArrayLike | None,
        encoder: float | None,
    ) -> _StandProblem:
        """Prepare the fit of measured stands: check the stands, list parameters and expected noise.

        Args:
            robot: Robot with a free base and feet.
            stands: Measurements, joints in actuator order.
            priors: Priors that replace the defaults.
            weight: Mass of the whole robot on a scale [kg]; None if not weighed.
            kp: Stated servo stiffness [N m/rad, N/m]; the model's if None.
            encoder: Standard deviation of a joint position [rad, m]; None if unknown.

        Raises:
            MeasurementError: If the stands cannot be used; for example, too few stands.
        """
        units = {joint: joint_unit(robot, joint) for joint in stands.joints}
        averaged = stands.check_readings(robot).average_repeats(units)
        if len(averaged) < MIN_STANDS:
            finding = diagnose("too-few-stands", stands=len(averaged), least=MIN_STANDS)
            raise MeasurementError(averaged.source, finding)
        has_command = np.isfinite(averaged.command).sum(axis=0) > 0
        stiffness = get_stated_stiffness(robot, averaged.source, has_command, kp)
        noise, friction = predict_noise(robot, averaged, encoder)
        table = ParameterTable(apply_priors(list_parameters(robot, averaged, stiffness), priors))
        return _StandProblem(robot, averaged, stiffness, friction, table, noise, weight)

    @property
    def friction_error(self) -> float:
        """Expected mean dry friction / mean kp [rad, m], over the joints with a servo."""
        has_servo = self.stiffness > 0
        mean_error = self.friction[has_servo].sum() / max(
            self.stiffness[has_servo].sum(), _ZERO_RTOL
        )
        return self.friction_ratio * float(mean_error)

    @property
    def friction_ratio(self) -> float:
        """Factor that raises an implausibly small mean dry friction to a default; otherwise 1."""
        ratio = float(self.friction.mean()) / (self.robot.weight * self.robot.stand_height)
        return 1.0 if ratio > _MIN_FRICTION_RATIO else _DEFAULT_FRICTION_RATIO / ratio

    def compute_log_evidence(self) -> float:
        """Return the log marginal likelihood (evidence) of the measured stands.

        The equations are linearised about the stated parameter values.
        """
        linearised = self.make_equations()[0].linearise(self.table.stated, self.table.stated)
        return linearised.compute_log_evidence(self.table, np.zeros(len(self.table)))

    def make_equations(
        self, posterior: Posterior | None = None
    ) -> tuple[StandEquations, tuple[Diagnostic, ...]]:
        """Create the residual equations of the stands, and notes on missing or unused commands.

        ``posterior`` is the distribution of the encoder offsets; the prior by default.
        """
        robot, table, kp = self.robot, self.table, self.stiffness
        used_stands, notes = _drop_uninformative_commands(
            robot, self.stands, kp, *_get_encoder_offsets(robot, table, posterior)
        )
        return StandEquations(robot, used_stands, table, kp, self.friction, self.noise), notes

    def solve(self) -> StandFit:
        """Estimate the parameters with the expected noise, then with the noise of the residuals.

        The second fit is repeated if the dead band, on which the noise depends, has changed.

        Raises:
            FitError: If no minimum is found.
            MeasurementError: If a foot contradicts the data of a stand.
        """
        robot, stands, table = self.robot, self.stands, self.table
        (equations, _), scale_residual = (
            self.make_equations(),
            _make_scale_residual(robot, table, self.weight),
        )
        equations.noise_deadband = sum(
            parameter.width for parameter in table if parameter.kind == "deadband"
        )
        posterior = _estimate_from_stands(robot, stands, equations, scale_residual, None)
        # With estimated encoder offsets, fewer joints may be near a stop.
        equations, notes = self.make_equations(posterior)

        def fit_with_noise(noise: StandNoise) -> tuple[Posterior, float]:
            """Return the fitted parameters (posterior) for given noise, and the log evidence."""
            equations.noise, equations.table = noise, scale_common_widths(table, noise, self.noise)
            fitted = _estimate_from_stands(robot, stands, equations, scale_residual, posterior.mean)
            linearised = equations.linearise(fitted.mean, fitted.mean) + scale_residual(fitted.mean)
            return fitted, linearised.compute_log_evidence(
                ParameterTable(fitted.parameters), fitted.moved
            )

        for _ in range(_MAX_FRICTION_PASSES):
            equations.set_noise_point(previous := posterior.mean)
            equations.noise, equations.table = self.noise, table
            noise = estimate_noise(equations, posterior, scale_residual, self.friction_ratio)
            posterior, log_evidence = fit_with_noise(noise)
            index = table.find_index("deadband", "servos")
            if index is None or abs(posterior.mean[index] - previous[index]) < posterior.std[index]:
                break
        _check_foot_loads(robot, stands, equations, posterior)
        equations.table = ParameterTable(posterior.parameters)
        mean, weight = posterior.mean, self.weight
        expected_noise = replace(self.noise, friction=self.friction_ratio)
        failures = tuple(check_residuals(posterior, noise, expected_noise, self.friction_error))
        level = all(note.code != "ground-slopes" for note in failures)
        scale_failures = check_scale(robot, posterior, weight, level=level)
        return StandFit(
            name=robot.name,
            source=stands.source,
            stands=len(stands),
            estimates=tuple(describe_parameters(posterior)),
            total_mass=_estimate_total_mass(robot, posterior),
            com=tuple(estimate_com(robot, posterior)),
            kp_factor=estimate_kp_over_mass(posterior, kp_only=True),
            kp_over_mass=estimate_kp_over_mass(posterior),
            weight=weight,
            residuals=dict(zip(stands.names, equations.compute_rms_residuals(mean), strict=True)),
            joint_residuals=_list_joint_residuals(self.robot, stands, equations, posterior),
            noise=dict(vars(noise)),
            failures=(
                *scale_failures,
                *failures,
                *self._find_contradicted_reading(equations, noise, log_evidence, fit_with_noise),
            ),
            diagnostics=(*notes, *_report_unmodelled_effects(posterior, self.friction_error)),
            posterior=posterior,
        )

    def _find_contradicted_reading(
        self,
        equations: StandEquations,
        noise: StandNoise,
        log_evidence: float,
        fit_with_noise: Callable[[StandNoise], tuple[Posterior, float]],
    ) -> Iterator[Diagnostic]:
        """Yield a failure if one wrong reading is more probable than the estimated noise.

        A wrong reading increases the estimated noise, and large noise hides the reading. Therefore
        both explanations are compared by the evidence. The noise and parameters of ``equations``
        change.
        """
        expected = vars(replace(self.noise, friction=self.friction_ratio))
        smaller_levels = {name: min(level, expected[name]) for name, level in vars(noise).items()}
        try:
            posterior, smaller_evidence = fit_with_noise(StandNoise(**smaller_levels))
        except (FitError, MeasurementError):  # no fit with this noise
            return
        worst, *other_residuals = _list_joint_residuals(
            self.robot, self.stands, equations, posterior
        )
        off, deviations = Quantity(worst.residual, worst.unit), abs(worst.deviations)
        width_ratio = math.hypot(
            1.0, _OUTLIER_STD * deviations / max(abs(worst.residual), _ZERO_RTOL**2)
        )
        gain = deviations**2 / 2 - math.log((1 + len(other_residuals)) * width_ratio)
        if deviations > _MAX_PARAMETER_STDS and smaller_evidence + gain > log_evidence:
            stand, joint = worst.stand, worst.joint
            yield diagnose(
                "reading-contradicted", stand=stand, joint=joint, off=off, times=deviations
            )


_OUTLIER_STD = 0.3
"""Prior standard deviation [rad, m] of the error of a wrong reading, for example of a blocked
servo. Chosen, not tuned."""

_MAX_FRICTION_PASSES = 5
"""Upper bound of the number of repeated fits, in which the noise of friction follows from the dead
band of the previous fit. Chosen, not tuned.
"""


def _estimate_from_stands(
    robot: Robot,
    stands: MeasuredStands,
    equations: StandEquations,
    scale_residual: Callable[[Array], LinearisedResiduals],
    start: Array | None,
) -> Posterior:
    """Return the distribution of the parameters, given measured stands at rest.

    ``start`` contains the initial parameters, shape (n,); the stated parameters if None.
    """
    table = equations.table
    logarithms = LogCoordinates(table)

    def linearise(y: Array, noise_coordinates: Array) -> LinearisedResiduals:
        """Return the linearised residuals at the log coordinates ``y`` of the parameters.

        ``chi2`` is infinite beyond `_MAX_LOG_FACTOR`.
        """
        if logarithms.compute_largest_exponent(y) > _MAX_LOG_FACTOR:
            return replace(LinearisedResiduals.empty(len(y)), chi2=math.inf)
        x = logarithms.to_parameters(y)
        noise_point = x if y is noise_coordinates else logarithms.to_parameters(noise_coordinates)
        return logarithms.transform_linearised(
            equations.linearise(x, noise_point) + scale_residual(x), y
        )

    initial = logarithms.from_parameters(table.stated if start is None else start)
    try:
        posterior = estimate_parameters(
            table,
            linearise,
            initial,
            lower_bounds=logarithms.lower_bounds,
            min_decrease=_MIN_DECREASE,
        )
    except FitError:
        _check_foot_loads(robot, stands, equations)  # may raise the cause
        raise
    return logarithms.transform_posterior(posterior)


_MAX_LOG_FACTOR = 20.0
"""Largest natural logarithm of (mass or kp / stated value) at which the equations of stands are
evaluated: with a larger value, the equations overflow. Chosen, not tuned: a factor of 5e8 belongs
to no robot.
"""

_MIN_DECREASE = 2e-3
"""Predicted decrease of the cost below which the iteration has converged. The value corresponds to
a step of sqrt(2e-3), about a twentieth of a standard deviation. Smaller predicted decreases are not
realised, because the weak dependence of the noise on contact forces is not differentiated.
"""


def predict_noise(
    robot: Robot, stands: MeasuredStands, encoder: float | None
) -> tuple[StandNoise, Array]:
    """Return the expected noise of stands, and the dry friction of the joints.

    A joint without dry friction in the model gets a default, a fraction of weight times height.

    Args:
        robot: Robot.
        stands: Stands, from whose positions the encoder step is estimated.
        encoder: Standard deviation of a joint position [rad, m]. If None, derived from the encoder
            step; a default if no step is found.

    Returns:
        Expected noise; dry friction of the joints, shape (nu,) [N m, N].
    """
    torque_scale = robot.weight * robot.stand_height
    if encoder is None:
        encoder_step = estimate_encoder_step(stands)
        encoder = encoder_step / math.sqrt(12.0) if encoder_step else _DEFAULT_ENCODER_STD
    friction = robot.joint_friction
    return StandNoise(encoder), np.where(
        friction > 0, friction, _DEFAULT_FRICTION_RATIO * torque_scale
    )


def list_parameters(
    robot: Robot, stands: MeasuredStands, kp: Array
) -> Iterator[tuple[str, str, str, float]]:
    """Yield the parameters that stands can estimate: kind, subject, component and stated value.

    Stated values are in SI units, ``kp`` has the shape (nu,) [N m/rad, N/m]. The subject is that of
    a `Parameter`, for example the name of a link, joint or foot.
    """
    yield from list_inertials(robot)
    for joint, name in enumerate(robot.joint_names):
        yield "offset", name, "", 0.0
        if np.isfinite(stands.command[:, joint]).any():
            yield "kp", name, "", float(kp[joint])
    for axis in "xy":
        yield "slope", "floor", axis, 0.0
    for foot in robot.feet:
        yield "softness", foot, "", 1.0
        yield "length", foot, "", 1.0
        for axis in AXES:
            yield "moment", foot, axis, 0.0
    if np.isfinite(stands.command).any():
        yield "deadband", "servos", "", 0.0
    yield "load", "scale", "", 0.0
    for link, loads in stands.added.items():
        if loads[:, 0].any():
            yield "settling", link, "", 0.0
            yield "added", link, "", 1.0
            for axis in AXES:
                yield "place", link, axis, 0.0


def list_inertials(robot: Robot) -> Iterator[tuple[str, str, str, float]]:
    """Yield masses [kg] and CoM coordinates [m] of bodies: kind, link, axis and stated value.

    A body consists of all links that fixed joints connect (`list_bodies`). CoM coordinates are in
    the frame of the Pinocchio joint. The axis of a mass is an empty text.
    """
    for link, number in list_bodies(robot):
        inertia = robot.structure.model.inertias[number]
        yield "mass", link, "", float(inertia.mass)
        for axis, value in zip(AXES, inertia.lever, strict=True):
            yield "com", link, axis, float(value)


def get_stated_stiffness(
    robot: Robot, source: str, commanded: NDArray[np.bool_], kp: ArrayLike | None
) -> Array:
    """Return the stated servo stiffness kp, shape (nu,) [N m/rad, N/m]; 0 without a servo.

    Args:
        robot: Robot.
        source: Source of the commands, for error messages.
        commanded: Whether a joint has commands, shape (nu,).
        kp: Stiffness that replaces the values of the model files [N m/rad, N/m]; None for the
            model.

    Raises:
        MeasurementError: If ``kp`` is None, and no model file states the kp of a joint with
            commands.
        ConfigurationError: If ``kp`` is invalid.
        ModelError: If ``kp`` is passed, and a joint has no motor.
    """
    if kp is None:
        gains, without_kp = list_position_servos(robot), list_joints_without_kp(robot)
        count = sum(
            has_command and name in without_kp
            for name, has_command in zip(robot.joint_names, commanded, strict=True)
        )
        if count:
            raise MeasurementError(
                source, diagnose("command-without-kp", count=count, default_kp=None)
            )
        return np.array([gains.get(name, (0.0, 0.0))[0] for name in robot.joint_names])
    return resolve_servo_gains(robot, kp, 0.0).kp


def list_joints_without_kp(robot: Robot) -> list[str]:
    """Return the joints for which no model file states the kp of a servo."""
    gains = list_position_servos(robot)
    added_servos = {servo.joint for servo in robot.description.made_servos}
    return [name for name in robot.joint_names if name not in gains or name in added_servos]


_STOP_MARGIN = 2e-3
"""Distance [rad, m] from a joint limit, in addition to `LIMIT_MARGIN_STDS`, below which a
mechanical stop may carry load. The difference of command and position then does not determine the
joint torque, and the command is not used. Chosen, not tuned."""

LIMIT_MARGIN_STDS = 3.0
"""Distance of a joint from a position limit at which no mechanical stop is expected to carry load,
in standard deviations of the encoder offset. Chosen, not tuned.
"""


def _get_encoder_offsets(
    robot: Robot, table: ParameterTable, posterior: Posterior | None
) -> tuple[Array, Array]:
    """Return mean and standard deviation of the encoder offsets, shape (nu,) [rad, m] each.

    They are those of the prior if ``posterior`` is None, and 0 for an offset that is not estimated.
    """
    mean, std = (
        (table.stated, table.width) if posterior is None else (posterior.mean, posterior.std)
    )
    indices = [table.find_index("offset", name) for name in robot.joint_names]
    offsets = [(0.0, 0.0) if index is None else (mean[index], std[index]) for index in indices]
    return np.array(offsets)[:, 0], np.array(offsets)[:, 1]


def _drop_uninformative_commands(
    robot: Robot, stands: MeasuredStands, kp: Array, offsets: Array, offset_std: Array
) -> tuple[MeasuredStands, tuple[Diagnostic, ...]]:
    """Return the stands with NaN for commands that determine no torque, and notes.

    Examples are commands of joints near a limit and of motors at the torque limit. The arrays have
    the shape (nu,), ``kp`` in [N m/rad, N/m], ``offsets`` and ``offset_std`` in [rad, m].
    """
    commanded, position = np.isfinite(stands.command), stands.position - offsets
    servo_error, margin = (
        np.nan_to_num(stands.command - stands.position),
        _STOP_MARGIN + LIMIT_MARGIN_STDS * offset_std,
    )
    at_stop = (position < robot.lower_limits + margin) | (position > robot.upper_limits - margin)
    at_full_torque = (
        np.abs(kp * servo_error) > _FULL_TORQUE_RATIO * robot.effort_limits
    ) & ~at_stop
    notes = [] if commanded.any() else [diagnose("stands-without-commands")]
    for is_stop, dropped in ((True, at_stop & commanded), (False, at_full_torque)):
        if dropped.any():
            rows, joints = np.nonzero(dropped)
            stand_names = [stands.names[row] for row in np.unique(rows)]
            joint_names = [robot.joint_names[joint] for joint in np.unique(joints)]
            notes.append(diagnose(_COMMAND_NOTES[is_stop], stands=stand_names, joints=joint_names))
    return replace(
        stands, command=np.where(at_stop | at_full_torque, np.nan, stands.command)
    ), tuple(notes)


_COMMAND_NOTES = {True: "stands-at-stops", False: "stands-with-full-torque"}
"""{reason for which commands are not used: code of the note}. True: the joint is at a stop; False:
the motor is at the torque limit."""

_FULL_TORQUE_RATIO = 0.98
"""Upper bound of (torque / torque limit) of a motor whose command is used. Above the bound, the
motor counts as saturated. Chosen, not tuned.
"""


def _make_scale_residual(
    robot: Robot, table: ParameterTable, weight: float | None
) -> Callable[[Array], LinearisedResiduals]:
    """Return a function of parameters (n,) that linearises (mass - ``weight`` [kg]) / std.

    The whole robot has this mass. Without a weight, the function returns no residual.
    """
    mass_gradient = np.array([float(parameter.kind == "mass") for parameter in table])
    # Mass of bodies that are not estimated.
    constant_mass = robot.total_mass - float(mass_gradient @ table.stated)

    def residuals(x: Array) -> LinearisedResiduals:
        """Return the residual of the robot's mass at parameters ``x``; empty without a weight."""
        if weight is None:
            return LinearisedResiduals.empty(len(table))
        std = SCALE_RTOL * weight
        return LinearisedResiduals.from_residuals(
            np.array([(mass_gradient @ x + constant_mass - weight) / std]),
            mass_gradient[None] / std,
        )

    return residuals


_MAX_DEPTH_STDS = 1.0
"""Largest depth below the ground of a foot that the measurements list as in the air, in standard
deviations of the foot's height. The bound is not 0, because a foot of v3 in the air may sag to
within a millimetre of the ground. Chosen, not tuned.
"""


def _check_foot_loads(
    robot: Robot,
    stands: MeasuredStands,
    equations: StandEquations,
    posterior: Posterior | None = None,
) -> None:
    """Check that no carrying foot has to pull, and no foot in the air is below the ground.

    The tolerances are `_MAX_PULL_RATIO` and `_MAX_DEPTH_STDS`. If ``posterior`` is None, the stated
    parameters are used. The contact forces are the forces that ``equations`` has stored.

    Raises:
        MeasurementError: For one contradiction.
    """
    table = equations.table
    mean = table.stated if posterior is None else posterior.mean
    _, offsets = _get_encoder_offsets(robot, table, posterior)
    weight = robot.weight
    contradictions: list[tuple[float, Diagnostic]] = []
    for row, name in enumerate(stands.names):
        for foot, (height, std) in equations.compute_swing_heights(row, mean, offsets).items():
            if height < -_MAX_DEPTH_STDS * std:
                subject, height_value = ("foot", foot), Quantity(height, "m")
                item = diagnose(
                    "foot-in-the-air-touches", subject=subject, stand=name, height=height_value
                )
                contradictions.append((-height / std, item))
        for foot, force in equations.sum_normal_forces(row).items():
            if force < -_MAX_PULL_RATIO * weight:
                subject, pull_force, swing = (
                    ("foot", foot),
                    Quantity(-force, "N"),
                    list(stands.swing[row]),
                )
                item = diagnose(
                    "foot-would-pull", subject=subject, stand=name, force=pull_force, swing=swing
                )
                contradictions.append((-force / (_MAX_PULL_RATIO * weight), item))
    # Feet in the air first: no servo pulls them to the ground.
    if contradictions:
        worst = max(
            contradictions,
            key=lambda finding: (finding[1].code == _CONTRADICTION_CODES[0], finding[0]),
        )
        raise MeasurementError(stands.source, worst[1])


# Coordinates in which all priors are normal.


class LogCoordinates:
    """Coordinates in which masses and kp are logarithms, so that the priors are normal.

    Stands determine the ratio of kp to mass. With logarithms, a factor on all kp and masses and the
    inverse factor are equally probable. With normal priors, a robot with too small kp and masses
    would be more probable than a robot with too large kp and masses. The reason: if twelve kp that
    differ by a tenth are halved, the differences are halved as well.

    The coordinate is y = x0 + x0 log(x / x0), with the stated value x0. The coordinate has the
    parameter's unit, and agrees with x to first order about x0, so that the prior width is
    unchanged. For other kinds of parameters, y = x.

    Args:
        table: Parameters.

    Attributes:
        lower_bounds: Lower bounds of the coordinates, shape (n,): 0 for positive parameters that
            are not logarithms, otherwise minus infinity.
    """

    def __init__(self, table: ParameterTable) -> None:
        kinds = [PARAMETER_KINDS[parameter.kind] for parameter in table]
        self._factors = np.array([kind.factor for kind in kinds], dtype=bool)
        self._stated = table.stated
        is_bounded = np.array([kind.positive for kind in kinds], dtype=bool) & ~self._factors
        self.lower_bounds: Array = np.where(is_bounded, 0.0, -np.inf)

    def to_parameters(self, coordinates: Array) -> Array:
        """Convert coordinates y of the fit, shape (n,), to physical parameters x, shape (n,).

        Masses and kp with the stated value x0: x = x0 exp(y / x0 - 1). Other parameters: x = y.
        """
        return np.where(self._factors, self._stated * self.compute_rates(coordinates), coordinates)

    def from_parameters(self, vector: Array) -> Array:
        """Convert physical parameters x, shape (n,), to the coordinates y of the fit, shape (n,).

        Masses and kp with the stated value x0: y = x0 (1 + log(x / x0)). Other parameters: y = x.
        """
        coordinates, stated = vector.copy(), self._stated[self._factors]
        coordinates[self._factors] = stated * (1 + np.log(vector[self._factors] / stated))
        return coordinates

    def compute_largest_exponent(self, coordinates: Array) -> float:
        """Return the largest log(x / x0) of the masses and kp for coordinates, shape (n,).

        x is the value of the parameter and x0 the stated value. Minus infinity without masses and
        kp.
        """
        ratios = coordinates[self._factors] / self._stated[self._factors]
        return float(np.max(ratios - 1, initial=-np.inf))

    def compute_rates(self, coordinates: Array) -> Array:
        """Return the derivatives dx/dy of the parameters x by the coordinates y, shape (n,).

        The derivative is x / x0 for a mass or kp with the stated value x0, and 1 for other
        parameters (see `to_parameters`).
        """
        rates = np.ones(len(coordinates))
        stated = self._stated[self._factors]
        rates[self._factors] = np.exp(coordinates[self._factors] / stated - 1)
        return rates

    def transform_linearised(
        self, linearised: LinearisedResiduals, coordinates: Array
    ) -> LinearisedResiduals:
        """Convert residuals, linearised by the parameters x, to the coordinates y of the fit.

        ``coordinates`` is the point y of the linearisation, shape (n,).
        """
        rates = self.compute_rates(coordinates)
        information = rates[:, None] * linearised.information * rates
        return replace(linearised, information=information, gradient=rates * linearised.gradient)

    def transform_posterior(self, posterior: Posterior) -> Posterior:
        """Convert a distribution of the fit's coordinates y to a distribution of the parameters x.

        `to_parameters` converts y to x. Covariance and prior widths are scaled by dx/dy at the
        mean. For example, an estimated mass of twice the stated mass gets twice the prior width.
        """
        rates = self.compute_rates(posterior.mean)
        return replace(
            posterior,
            parameters=tuple(
                replace(parameter, width=float(rate) * parameter.width)
                for parameter, rate in zip(posterior.parameters, rates, strict=True)
            ),
            mean=self.to_parameters(posterior.mean),
            covariance=rates[:, None] * posterior.covariance * rates,
        )


# Noise levels, estimated by maximum evidence.


_LEVEL_LOG_STD = 1.5
"""Prior standard deviation of the natural logarithm of each noise level (foot moments, flatness of
the ground, friction) relative to the expected level: a factor of 4.5 up or down. Chosen, not
tuned."""

_MIN_FLATNESS = 1e-4
"""Lower bound [m] of the estimated unevenness of the ground. Simulated ground is flatter, but the
accuracy of the penetration model of the feet has about this size. Chosen, not tuned.
"""

_MIN_MOMENT = 1e-4
"""Lower bound [m] of the estimated noise of foot moments: moment on a contact point, divided by the
normal force. Without a bound the estimate is too small, because the fit attributes moments that are
equal in similar stands to encoder offsets. Measured: feet of v3 in MuJoCo keep 2e-5 to 1e-3 after
12 s."""

_MIN_FRICTION_LEVEL = 0.5
"""Lower bound of the estimated random dry friction, divided by the expected friction. The fit
attributes friction that is equal in all stands to parameters, which makes the estimate too small.
Measured on MEVIUS without the bound: the ratio was a fifth, and only 88 % of the intervals
contained the truth."""

_MAX_EVALUATIONS = 40
"""Upper bound of the evaluations of the log evidence in the search for the three noise levels (foot
moments, flatness of the ground, friction). An accuracy of about 10 % is sufficient. Chosen, not
tuned."""


def scale_common_widths(
    table: ParameterTable, noise: StandNoise, expected: StandNoise
) -> ParameterTable:
    """Scale the prior widths of foot moments and of one-sided joint friction with the noise levels.

    The common part of the foot moments (``moment``) and the one-sided part of the dry friction
    (``settling``) scale with the ratio of estimated (``noise``) to expected random noise;
    ``settling`` at least by 1, because low random noise does not imply low one-sided friction.
    """
    moments = table.with_scaled_widths("moment", noise.moment / expected.moment)
    return moments.with_scaled_widths("settling", max(1.0, noise.friction / expected.friction))


def estimate_noise(
    equations: StandEquations,
    posterior: Posterior,
    scale_residual: Callable[[Array], LinearisedResiduals],
    friction_ratio: float,
) -> StandNoise:
    """Estimate the noise of measured stands: contact moments, uneven ground and dry friction.

    The noise levels approximately maximise, above lower bounds, the evidence (probability of the
    measurements, with the parameters integrated out) times a log-normal prior about the expected
    levels. The search is a Nelder-Mead simplex. The encoder noise is not estimated.

    Args:
        equations: Equations of the stands, with the expected noise.
        posterior: Distribution with the expected noise; the residuals are linearised at the mean.
        scale_residual: Function of the parameters, shape (n,), that returns the residual of the
            robot's mass from the weighed mass.
        friction_ratio: Expected factor on the stated dry friction.
    """
    from scipy import optimize  # slow to import

    expected, mean, table = equations.noise, posterior.mean, ParameterTable(posterior.parameters)
    equations.linearise(mean, mean)  # updates the stands' own unknowns
    stands, other_residuals = equations.evaluate_rows(mean), scale_residual(mean)

    def make_noise(log_levels: Array) -> StandNoise:
        """Scale the expected moment, flatness and friction noise by exp(log_levels), shape (3,)."""
        moment, flatness, friction = np.exp(log_levels)
        return replace(
            expected,
            moment=max(_MIN_MOMENT, expected.moment * moment),
            flatness=max(_MIN_FLATNESS, expected.flatness * flatness),
            friction=expected.friction * friction_ratio * max(_MIN_FRICTION_LEVEL, friction),
        )

    def compute_cost(log_levels: Array) -> float:
        """Return the negative log evidence minus the log prior of the noise levels, shape (3,)."""
        noise, linearised = make_noise(log_levels), other_residuals
        for stand in stands:
            stand.set_noise(noise)
            linearised += stand.eliminate_own_unknowns()[0]
        evidence = linearised.compute_log_evidence(
            scale_common_widths(table, noise, expected), posterior.moved
        )
        return float(log_levels @ log_levels) / (2 * _LEVEL_LOG_STD**2) - evidence

    simplex = np.vstack([np.zeros(3), -np.eye(3)])
    options = {"initial_simplex": simplex, "maxfev": _MAX_EVALUATIONS, "xatol": 0.05, "fatol": 0.02}
    optimum = optimize.minimize(compute_cost, np.zeros(3), method="Nelder-Mead", options=options)
    return make_noise(optimum.x)
