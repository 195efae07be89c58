"""Fit of stands at rest: masses, centres of mass, zeros of encoders, stiffness of servos."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.arguments import check_arguments, check_finite
from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.base.errors import ConfigurationError, FitError, MeasurementError
from pupper_analysis.base.results import Result
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import list_position_servos, resolve_servo_gains
from pupper_analysis.tools.fit.estimate import (
    HALF_WIDTH_95,
    LinearisedResiduals,
    Posterior,
    estimate_parameters,
)
from pupper_analysis.tools.fit.measurements.stands import MeasuredStands, estimate_encoder_step
from pupper_analysis.tools.fit.parameters import (
    AXES,
    KINDS,
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

Array = NDArray[np.float64]


@dataclass(frozen=True)
class JointResidual(Result):
    """What is left at one joint in one stand.

    Attributes:
        stand: The stand.
        joint: The joint.
        off: Measured position less the one by which all other readings agree best (rad).
        deviations: The same in standard deviations of what noise, and what is not known, make.
    """

    stand: str
    joint: str
    off: float = field(metadata={"unit": "rad"})
    deviations: float = field(metadata={"unit": "1"})


@dataclass(frozen=True, eq=False)
class StandFit(Fit):
    """A robot's numbers as stands at rest tell them.

    Attributes:
        stands: How many there are.
        total_mass: Of the whole robot (kg).
        com: Its centre of mass in the base's frame, x, y, z, at the file's nominal joint positions
            (m).
        kp_factor: By which kp of all servos is another than stated: their geometric mean; None if
            kp is known, or no servo was commanded.
        weight: What a scale says of the robot (kg); None if it was not weighed.
        residuals: {stand: root mean square of its residuals, in standard deviations}.
        joint_residuals: Of each joint in each stand, the most surprising before.
        noise: Standard deviations of measurements, as they were taken to be or were found.
    """

    stands: int
    total_mass: Estimate = field(metadata={"unit": "kg"})
    com: tuple[Estimate, ...] = field(metadata={"unit": "m"})
    kp_factor: Estimate | None
    weight: float | None = field(metadata={"unit": "kg"})
    residuals: Mapping[str, float] = field(metadata={"unit": "1"})
    joint_residuals: tuple[JointResidual, ...]
    noise: Mapping[str, float] = field(metadata={"unit": "rad or m"})


def _joint_residuals(
    stands: MeasuredStands, equations: StandEquations, known: Posterior
) -> tuple[JointResidual, ...]:
    off, sure = equations.find_contradictions(known)
    found = [
        JointResidual(stand, joint, float(off[row, column]), float((off / sure)[row, column]))
        for row, stand in enumerate(stands.names)
        for column, joint in enumerate(stands.joints)
    ]
    return tuple(sorted(found, key=lambda one: -abs(one.deviations)))


def _total_mass(robot: Robot, posterior: Posterior) -> Estimate:
    line = (posterior.kinds == "mass").astype(float)
    stated = np.array([one.stated for one in posterior.parameters])
    whole = Parameter("mass", robot.name, "", robot.total_mass, 0.0)
    mean = robot.total_mass + float(line @ (posterior.mean - stated))
    return derive_estimate(posterior, whole, mean, line)


def estimate_com(robot: Robot, posterior: Posterior) -> Iterator[Estimate]:
    """Yields x, y, z of the whole robot's com in the base's frame, at nominal joint positions.

    With bodies i of mass m_i, whose frames are R_i, p_i and coms c_i, com = sum m_i x_i / M and
    x_i = R_i c_i + p_i: its derivatives are (x_i - com) / M by m_i, and R_i m_i / M by c_i.
    """
    model = robot.structure.model
    data = model.createData()
    pin.forwardKinematics(
        model, data, robot.structure.convention.unit_q(robot.posed(robot.nominal))
    )
    table, x = ParameterTable(posterior.parameters), posterior.mean
    masses, places, rates, stated = [], [], np.zeros((3, len(x))), np.zeros(3)
    for link, number in list_bodies(robot):
        own, here = model.inertias[number], data.oMi[1].actInv(data.oMi[number])
        mass, com = table.get_inertial(x, link, own)
        masses.append(mass)
        places.append(here.act(com))
        stated += own.mass * here.act(own.lever)
        for axis, column in zip(AXES, here.rotation.T, strict=True):
            if (at := table.find_index("com", link, axis)) is not None:
                rates[:, at] = mass * column
    whole = np.array(masses) @ np.array(places) / sum(masses)
    for (link, _), place in zip(list_bodies(robot), places, strict=True):
        if (at := table.find_index("mass", link)) is not None:
            rates[:, at] = place - whole
    for number, axis in enumerate(AXES):
        one = Parameter("com", robot.name, axis, float(stated[number] / robot.total_mass), 0.0)
        yield derive_estimate(posterior, one, float(whole[number]), rates[number] / sum(masses))


# What a model does not explain of stands: noise, numbers, and what surrounds the robot.


def check_scale(
    robot: Robot, posterior: Posterior, weight: float | None = None, *, level: bool = True
) -> Iterator[Diagnostic]:
    """Yields that all kp, and the whole mass, are further from the file than files are.

    Positions tell the ratio of kp and masses, and a scale alone how large both are: whatever grows
    with the load hides in this factor, and no parameter by itself is far from its file. So these
    are asked together, before any: z of the mean of log kp, of the logarithm of the total mass, and
    of what stands there beyond it, which takes a part.

    Args:
        robot: The robot.
        posterior: What is known of the parameters.
        weight: Of the whole robot by a scale (kg), if it was weighed.
        level: Whether the ground is as it was said to be: on a slope the load is no sign.
    """
    from scipy import stats  # slow to import

    table, kinds = ParameterTable(posterior.parameters), posterior.kinds
    masses, asked = kinds == "mass", level and "added" not in kinds  # then it has its own test
    mass = np.zeros(len(table))
    # The width is that of the stated mass again: ``moved`` is of logarithms.
    mass[masses] = (table.width * table.stated)[masses] / posterior.mean[masses]
    lines = np.array([kinds == "kp", mass / robot.total_mass, asked & (kinds == "load")])
    lines = lines[lines.any(axis=1)]
    if not len(lines):
        return
    signs, freedom, _ = _surprise(posterior, lines)
    if not freedom or stats.chi2.sf(signs, freedom) > _CHANCE:
        return
    stiffer, total = estimate_kp_over_mass(posterior, kp_only=True), _total_mass(robot, posterior)
    yield diagnose(
        "scale-far-from-the-file",
        weight=None if weight is None else Quantity(weight, "kg"),
        kp=None if stiffer is None else stiffer.mean,
        mass=total.mean / robot.total_mass,
    )


def _surprise(posterior: Posterior, lines: Array, sure: float = 1.0) -> tuple[float, int, Array]:
    """Returns how much some combinations of parameters surprise: chi^2, its freedom, and how far.

    Estimates move from what was said by d. If that is so, d has the covariance S by which prior and
    posterior differ, and d^T S^-1 d is distributed as chi^2: several weak signs are one together.
    How far is S^-1 d in the prior's variances, which is not drawn to what was said.

    Args:
        posterior: What is known of the parameters.
        lines: (k, n) the combinations, of parameters in their widths.
        sure: What is no surprise, as a standard deviation in parts of the prior's: of legs' lengths
            less than the prior, so that intervals are of any leg, and a file's leg is expected.
    """
    width = np.array([one.width for one in posterior.parameters])
    before = lines @ np.linalg.inv(posterior.precision) @ lines.T
    sizes = np.sqrt(np.diag(before))
    message = before - lines @ (posterior.covariance / np.outer(width, width)) @ lines.T
    values, vectors = np.linalg.eigh(message / np.outer(sizes, sizes))
    kept = values > _LEAST_DETERMINED
    moved = vectors[:, kept].T @ (lines @ posterior.moved / sizes)
    far = (before / sizes) @ vectors[:, kept] @ (moved / values[kept])
    expected = values[kept] * (1 - (1 - sure**2) * values[kept])
    return float(np.sum(moved**2 / expected)), int(np.count_nonzero(kept)), far


def _findings(posterior: Posterior, stuck: float) -> Iterator[Diagnostic]:
    """Yields what the stands show of servos, and of loads, that no file can state.

    Args:
        posterior: What is known of the parameters.
        stuck: A servo's error that dry friction of one sign takes up (rad): what may be that is
            no dead band.
    """
    loaded = "added" in posterior.kinds
    for place, one in enumerate(posterior.parameters):
        mean, half = float(posterior.mean[place]), float(HALF_WIDTH_95 * posterior.std[place])
        if abs(mean) < half or (one.kind == "load" and not loaded):
            continue
        if one.kind == "deadband" and mean - half > stuck:
            angle, wide = Quantity(mean, "rad"), Quantity(half, "rad")
            yield diagnose("servos-have-a-dead-band", angle=angle, half=wide)
        elif one.kind == "load":
            yield diagnose("more-stands-there", load=100 * mean, half=100 * half)


_CHANCE = 0.0027
"""Of three standard deviations: that a kind is found to be otherwise by chance."""

_LEAST_DETERMINED = 0.02
"""Of a prior's variance: a direction of which no more is told speaks against nothing."""

_ALSO = 2.0
"""Standard deviations, where feet sink otherwise: those which do."""

_NOISY = 5.0
"""Times what was expected: noise of which there is so much hides a cause."""

_RUBS = 4.0
"""Likewise, of dry friction: of what is random in it, and what is of one sign. Half as many where
that of a file is not believed: what is allowed for then, nobody has stated."""

_FAR = 4.5
"""Standard deviations: of a hundred numbers that are as was said, none is so far off."""

_SUSPECTED = ("slope", "softness", "length", "load")
"""Of the surroundings: kinds that somebody says something of."""

_NEVER_NOTHING, _NOTHING = ("mass", "kp"), 0.01
"""Kinds of numbers that no robot has none of, and what is none, in parts of the stated value."""

_RESIDUALS_CHANCE = 1e-3
"""Probability of residuals that are larger by chance."""


def check_residuals(
    posterior: Posterior, found: StandNoise, expected: StandNoise, stuck: float
) -> Iterator[Diagnostic]:
    """Yields what the model does not explain of the measurements.

    Args:
        posterior: What is known of the parameters.
        found: The noise that was found.
        expected: The noise that was expected.
        stuck: See ``_findings``.
    """
    from scipy import stats  # slow to import

    if stats.chi2.sf(posterior.chi2, max(posterior.degrees_of_freedom, 1.0)) < _RESIDUALS_CHANCE:
        ratio = posterior.chi2 / max(posterior.degrees_of_freedom, 1.0)
        yield diagnose("residuals-too-large", times=math.sqrt(ratio))
    if found.flatness > _NOISY * expected.flatness:
        yield diagnose("feet-off-the-plane", off=Quantity(found.flatness, "m"))
    kinds, stated = posterior.kinds, ParameterTable(posterior.parameters).stated
    bands = posterior.mean[kinds == "deadband"]
    one_sign = -float(np.minimum(bands, 0.0).sum()) / max(stuck, _NOTHING**2)
    most = _RUBS if expected.friction == 1 else _RUBS / 2
    if (times := found.friction / expected.friction + one_sign) > most:
        yield diagnose("torques-off", times=times)
    # What is known before and after differ in variance by what an estimate is surprised by, if the
    # parameter is as it was said to be: one by poor measurements stays near the stated value, and
    # tells as much by a smaller step.
    surprise = np.sqrt(np.maximum(1 - posterior.variance_ratios, _LEAST_DETERMINED))
    moved = posterior.moved / surprise
    gone = np.isin(kinds, _NEVER_NOTHING) & (posterior.mean < _NOTHING * stated) & (moved < 0)
    off = ~np.isin(kinds, SURROUNDINGS_KINDS) & (gone | (np.abs(moved) > _FAR))
    if len(far := np.flatnonzero(off)):
        names, widths = [posterior.parameters[place].name for place in far], np.abs(moved[far])
        yield diagnose("far-from-the-file", names=names, widths=float(widths.max()))
    flatter = min(1.0, found.flatness / expected.flatness)
    yield from check_surroundings(posterior, flatter)


def check_surroundings(posterior: Posterior, flatter: float = 1.0) -> Iterator[Diagnostic]:
    """Yields what of the surroundings is not as it was said to be, one kind at a time.

    See ``_surprise``: several weak signs of a slope, or of soft soles, are one together.

    Args:
        posterior: What is known of the parameters.
        flatter: What the ground's unevenness is, in parts of the expected one, 1 at most. Feet that
            sink look like that: where ground came out flatter, by few stands, signs of the other
            are worth what they were on the expected one.
    """
    from scipy import stats  # slow to import

    kinds = posterior.kinds
    for kind in _SUSPECTED:
        places = np.flatnonzero(kinds == kind)
        if not len(places) or (kind == "load" and "added" not in kinds):
            continue
        chosen = [posterior.parameters[at] for at in places]
        width = np.array([one.width for one in chosen])
        narrow = kind == "length" and (width == KINDS[kind].width).all()  # unless a prior says
        sure = _SAME_LENGTH / KINDS[kind].width if narrow else 1.0
        signs, freedom, far = _surprise(posterior, np.eye(len(posterior.parameters))[places], sure)
        signs *= flatter**2 if kind == "softness" else 1.0
        if not freedom or stats.chi2.sf(signs, freedom) > _CHANCE:
            continue
        free = width * far
        message = np.maximum(1 - posterior.variance_ratios[places], _LEAST_DETERMINED)
        message *= 1 - (1 - sure**2) * message
        each = np.abs(posterior.moved[places]) / np.sqrt(message)
        if kind == "load":
            yield diagnose("known-mass-contradicts-the-scale", load=100 * float(free[0]))
        elif kind == "slope":
            most = chosen[int(np.abs(free).argmax())]
            slope = Quantity(float(math.hypot(*free)), "rad")
            yield diagnose("ground-slopes", slope=slope, axis=most.component)
        else:
            for number in np.flatnonzero((each >= _ALSO) | (each == each.max())):
                foot, off = ("foot", chosen[number].subject), float(free[number])
                if kind == "length":
                    yield diagnose("leg-is-longer", subject=foot, longer=100 * off)
                else:
                    times = max(0.0, chosen[number].stated + off)
                    yield diagnose("feet-sink-otherwise", subject=foot, times=times)


_SAME_LENGTH = 0.005
"""Of a leg's last link: standard deviation of parts that are printed and glued by the same file."""

SCALE_RTOL = 0.002
"""Of a mass that a scale shows: standard deviation."""

KNOWN_MASS_FRACTION = 0.15
"""Of the robot's: 500 g on Pupper v3. With 200 g kp is known to 12 to 14 % by it alone."""

MIN_STANDS = 3

_FINE_ENCODER = 2e-4
"""rad: where no step shows, a position is taken to be as sure as one of 14 bits that shakes."""


_UNMODELLED = 5e-3
"""Of the weight times the height: dry friction of joints of which files state none, as far as it
makes torques uncertain. Files that state it have 0.24 % (Pupper v3) to 0.66 % (Go1, B1)."""

_TYPED = 2e-3
"""Likewise: a file that states less has what somebody typed, and nothing is known. The 0.2 N m of
Go1 stand in those of Spot, HyQReal2, and Pegasus before it was identified: 0.03 to 0.09 %."""

_PULLS = 0.02
"""Of the weight: a foot that would pull so hard does not carry."""


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
    """Fits a robot's numbers to stands at rest.

    A soft servo is a torque sensor: tau = kp (command - position). What is estimated are masses
    and coms of all moving bodies, zero offsets of encoders, kp of servos, lengths of the legs' last
    links; and, of the surroundings, the ground's slope and softness. Equations are in
    ``StandEquations``; what is known before are normal distributions about the files' values
    (``parameters.KINDS``). How uneven the ground is, and how much of dry friction is in torques, is
    found by the evidence.

    Args:
        robot: The robot, with a free base and feet.
        stands: The measurements.
        priors: What is known before: ``mass=50%``, ``com:base=5mm``, ``kp=0`` (it is right).
        weight: Mass of the whole robot by a scale (kg), to 0.2 %.
        kp: Stiffness of the servos (N m/rad), one or (nu,); the model's own by default.
        encoder: Standard deviation of a position (rad); from the encoders' step by default.

    A stand whose feet cannot be where they are said to be is left out with a note; up to a quarter.

    Raises:
        MeasurementError: If they are none of this robot's: joints or feet that it has not, too few
            stands, one that is not at rest, feet that would have to pull in many.
        ConfigurationError: If a prior says nothing, a weight is none, or the base is fixed.
        FitError: If it does not converge.
    """
    wanted = parse_priors(priors)
    for name, value in (("weight", weight), ("encoder", encoder)):
        if value is not None and check_finite(name, value) <= 0:
            raise ConfigurationError(name, diagnose("not-positive", value=value))
    robot.check_floating()
    robot.check_tree("fit")
    given = stands.order_joints(robot)

    def fit(given: MeasuredStands) -> StandFit:
        return _Problem.from_stands(robot, given, wanted, weight, kp, encoder).solve()

    def evidence(given: MeasuredStands) -> float:
        return _Problem.from_stands(
            robot, given, wanted, weight, kp, encoder
        ).compute_log_evidence()

    try:
        found = _without_contradictions(fit, given)
    except (MeasurementError, FitError) as error:
        if isinstance(error, FitError) and weight is not None:  # a known mass may tell why
            bare = fit_stands(robot, stands, priors=priors, kp=kp, encoder=encoder)
            load = bare.total_mass.mean / weight - 1
            if abs(load) * weight > _FAR * bare.total_mass.std:
                said = diagnose("known-mass-contradicts-the-scale", load=100 * load)
                return replace(bare, weight=weight, failures=(said, *bare.failures))
        if wiring := find_wiring(robot, given, evidence, fit):
            raise MeasurementError(given.source, wiring.found) from error
        raise
    # Plugs that are exchanged leave residuals, or a stand out; a wrong scale and a slope do not.
    left_out = any(one.code == "stand-left-out" for one in found.diagnostics)
    searched = left_out or any(one.code not in _LEAVE_NONE for one in found.failures)
    wiring = find_wiring(robot, given, evidence, fit) if searched else None
    return replace(found, failures=(wiring.found,)) if wiring else found  # it explains the others


_LEAVE_NONE = ("scale-far-from-the-file", "known-mass-contradicts-the-scale", "ground-slopes")


def _without_contradictions(
    fit: Callable[[MeasuredStands], StandFit], given: MeasuredStands
) -> StandFit:
    """Fits stands, without those whose feet are not where they are said to be, one after the other.

    Raises:
        MeasurementError: If there are many of them: something else is wrong.
        FitError: If it does not converge.
    """
    notes: list[Diagnostic] = []
    first: MeasurementError | None = None
    rest = given
    while True:
        try:
            found = fit(rest)
        except MeasurementError as error:
            if error.cause.code not in _CONTRADICTIONS:
                raise
            first = first or error
            if len(notes) + 1 > _LEFT_OUT * len(given):
                raise first from None
            name = error.cause.values["stand"]
            notes.append(diagnose("stand-left-out", why=error.cause))
            rest = rest.select_rows([row for row, own in enumerate(rest.names) if own != name])
        else:
            return replace(found, diagnostics=(*notes, *found.diagnostics))


_CONTRADICTIONS = ("foot-in-the-air-touches", "foot-would-pull")

_LEFT_OUT = 0.25
"""Of the stands, at most: where more contradict the model, it is no slip of who took them."""


@dataclass(frozen=True, eq=False)
class _Problem:
    """What is estimated of stands, about what the files and somebody say.

    Attributes:
        robot: The robot.
        stands: Its stands, one reading each.
        stiffness: (nu,) stated kp (N m/rad).
        friction: (nu,) dry friction that makes torques uncertain (N m).
        table: The parameters.
        noise: That is expected.
        weight: Of the whole robot by a scale (kg).
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
    ) -> _Problem:
        """Returns that of stands, whose joints are in the robot's order.

        Raises:
            MeasurementError: If they are none of this robot's.
        """
        given = stands.check_readings(robot).average_repeats()
        if len(given) < MIN_STANDS:
            found = diagnose("too-few-stands", stands=len(given), least=MIN_STANDS)
            raise MeasurementError(given.source, found)
        asked = np.isfinite(given.command).sum(axis=0) > 0
        stiffness = get_stated_stiffness(robot, given.source, asked, kp)
        noise, friction = predict_noise(robot, given, encoder)
        table = ParameterTable(apply_priors(list_parameters(robot, given, stiffness), priors))
        return _Problem(robot, given, stiffness, friction, table, noise, weight)

    @property
    def stuck(self) -> float:
        """A servo's error that dry friction of one sign takes up (rad), on average."""
        held = self.stiffness > 0
        taken = self.friction[held].sum() / max(self.stiffness[held].sum(), _NOTHING)
        return self.rubs * float(taken)

    @property
    def rubs(self) -> float:
        """Dry friction that is expected, in parts of what is stated."""
        stated = float(self.friction.mean()) / (self.robot.weight * self.robot.stand_height)
        return 1.0 if stated > _TYPED else _UNMODELLED / stated

    def compute_log_evidence(self) -> float:
        """Returns the logarithm of how likely the stands are, linear about the file's numbers."""
        message = self.equations()[0].linearise(self.table.stated, self.table.stated)
        return message.compute_log_evidence(self.table, np.zeros(len(self.table)))

    def equations(
        self, known: Posterior | None = None
    ) -> tuple[StandEquations, tuple[Diagnostic, ...]]:
        """Returns the equations, and which commands they do not use, by what is known of zeros."""
        robot, table, kp = self.robot, self.table, self.stiffness
        used, notes = _used(robot, self.stands, kp, *_zeros(robot, table, known))
        return StandEquations(robot, used, table, kp, self.friction, self.noise), notes

    def solve(self) -> StandFit:
        """Returns the fit: with the noise that is expected, then with that which is found."""
        robot, stands, table = self.robot, self.stands, self.table
        (equations, _), weighed = self.equations(), _weighed(robot, table, self.weight)
        equations.stuck = sum(one.width for one in table if one.kind == "deadband")
        known = _estimate(robot, stands, equations, weighed, None)
        # With what is known of the encoders now, fewer joints may be at a stop.
        equations, notes = self.equations(known)

        def by(noise: StandNoise) -> tuple[Posterior, float]:
            """Returns what is known with a noise, and the logarithm of how likely stands are."""
            equations.noise, equations.table = noise, scale_common_widths(table, noise, self.noise)
            found = _estimate(robot, stands, equations, weighed, known.mean)
            left = equations.linearise(found.mean, found.mean) + weighed(found.mean)
            return found, left.compute_log_evidence(ParameterTable(found.parameters), found.moved)

        for _ in range(_PASSES):
            equations.set_noise_point(before := known.mean)
            equations.noise, equations.table = self.noise, table
            noise = estimate_noise(equations, known, weighed, self.rubs)
            known, likely = by(noise)
            at = table.find_index("deadband", "servos")
            if at is None or abs(known.mean[at] - before[at]) < known.std[at]:
                break
        _check_feet(robot, stands, equations, known)
        equations.table = ParameterTable(known.parameters)
        x, weight = known.mean, self.weight
        usual = replace(self.noise, friction=self.rubs)
        doubts = tuple(check_residuals(known, noise, usual, self.stuck))
        level = all(one.code != "ground-slopes" for one in doubts)
        scale = check_scale(robot, known, weight, level=level)
        return StandFit(
            name=robot.name,
            source=stands.source,
            stands=len(stands),
            estimates=tuple(describe_parameters(known)),
            total_mass=_total_mass(robot, known),
            com=tuple(estimate_com(robot, known)),
            kp_factor=estimate_kp_over_mass(known, kp_only=True),
            kp_over_mass=estimate_kp_over_mass(known),
            weight=weight,
            residuals=dict(zip(stands.names, equations.compute_rms_residuals(x), strict=True)),
            joint_residuals=_joint_residuals(stands, equations, known),
            noise=dict(vars(noise)),
            failures=(*scale, *doubts, *self._contradicted(equations, noise, likely, by)),
            diagnostics=(*notes, *_findings(known, self.stuck)),
            posterior=known,
        )

    def _contradicted(
        self,
        equations: StandEquations,
        noise: StandNoise,
        likely: float,
        by: Callable[[StandNoise], tuple[Posterior, float]],
    ) -> Iterator[Diagnostic]:
        """Yields the reading that all others contradict, if that explains more than noise does.

        One that is far off makes noise large, and hides in it. So what is asked is whether noise
        that is as large as expected, and one reading off by anything, are more likely together.
        """
        expected = vars(replace(self.noise, friction=self.rubs))
        less = {name: min(own, expected[name]) for name, own in vars(noise).items()}
        try:
            known, with_less = by(StandNoise(**less))
        except (FitError, MeasurementError):  # that noise explains nothing
            return
        one, *others = _joint_residuals(self.stands, equations, known)
        off, times = Quantity(one.off, "rad"), abs(one.deviations)
        wide = math.hypot(1.0, _ELSEWHERE * times / max(abs(one.off), _NOTHING**2))
        gain = times**2 / 2 - math.log((1 + len(others)) * wide)
        if times > _FAR and with_less + gain > likely:
            at, joint = one.stand, one.joint
            yield diagnose("reading-contradicted", stand=at, joint=joint, off=off, times=times)


_ELSEWHERE = 0.3
"""rad: standard deviation of a reading that is of no such stand: of a servo that is stuck."""

_PASSES = 5
"""In which friction that holds joints is noise by the last one's: two to four are enough."""


def _estimate(
    robot: Robot,
    stands: MeasuredStands,
    equations: StandEquations,
    weighed: Callable[[Array], LinearisedResiduals],
    start: Array | None,
) -> Posterior:
    """Returns the parameters that stands and priors make most probable."""
    table = equations.table
    logarithms = LogCoordinates(table)

    def linearise(y: Array, about: Array) -> LinearisedResiduals:
        x = logarithms.to_parameters(y)
        other = x if y is about else logarithms.to_parameters(about)
        return logarithms.transform_linearised(equations.linearise(x, other) + weighed(x), y)

    begin = logarithms.from_parameters(table.stated if start is None else start)
    try:
        found = estimate_parameters(table, linearise, begin, least=logarithms.least, enough=_ENOUGH)
    except FitError:
        _check_feet(robot, stands, equations)  # which may tell why
        raise
    return logarithms.transform_posterior(found)


_ENOUGH = 2e-3
"""Of the cost: a step that promises no more is one of a twentieth of a standard deviation. What
noise does depends a little on contact forces, of which no derivative is taken: less is not kept."""


def predict_noise(
    robot: Robot, stands: MeasuredStands, encoder: float | None
) -> tuple[StandNoise, Array]:
    """Returns the noise that is expected, and the dry friction (nu,) that makes torques uncertain.

    Args:
        robot: The robot.
        stands: Its stands, whose positions may show the encoders' step.
        encoder: Standard deviation of a position, if it is known (rad).
    """
    scale = robot.weight * robot.stand_height
    if encoder is None:
        step = estimate_encoder_step(stands)
        encoder = step / math.sqrt(12.0) if step else _FINE_ENCODER
    rubbing = robot.joint_friction
    return StandNoise(encoder), np.where(rubbing > 0, rubbing, _UNMODELLED * scale)


def list_parameters(
    robot: Robot, stands: MeasuredStands, kp: Array
) -> Iterator[tuple[str, str, str, float]]:
    """Yields kind, subject, component and stated value of what stands may tell.

    Args:
        robot: The robot.
        stands: Its stands.
        kp: (nu,) stated stiffness (N m/rad).
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
    """Yields kind, subject, component and stated value of masses and coms."""
    for link, number in list_bodies(robot):
        inertia = robot.structure.model.inertias[number]
        yield "mass", link, "", float(inertia.mass)
        for axis, value in zip(AXES, inertia.lever, strict=True):
            yield "com", link, axis, float(value)


def get_stated_stiffness(
    robot: Robot, source: str, commanded: NDArray[np.bool_], kp: ArrayLike | None
) -> Array:
    """Returns the servos' stated stiffness (nu,) (N m/rad); 0 without a servo.

    Args:
        robot: The robot.
        source: From where the commands are.
        commanded: (nu,) which joints have commands.
        kp: What a caller says (N m/rad).

    Raises:
        MeasurementError: If a joint has commands, and no file states its servo's kp.
    """
    if kp is None:
        own = list_position_servos(robot)
        made = {servo.joint for servo in robot.description.made_servos}
        lacking = [
            name
            for name, asked in zip(robot.joint_names, commanded, strict=True)
            if asked and (name not in own or name in made)
        ]
        if lacking:
            raise MeasurementError(source, diagnose("command-without-kp", joints=lacking))
        return np.array([own.get(name, (0.0, 0.0))[0] for name in robot.joint_names])
    return resolve_servo_gains(robot, kp, 0.0).kp


_AT_STOP = 2e-3
"""rad: as near as that to a limit, a stop may carry, and no servo tells what."""

LIMIT_MARGIN_STDS = 3.0
"""Standard deviations of an encoder's zero: a joint that is so far from a limit is not at it."""


def _zeros(robot: Robot, table: ParameterTable, known: Posterior | None) -> tuple[Array, Array]:
    """Returns the zeros of encoders (nu,), and how sure: before measurements, or after (rad)."""
    mean, std = (table.stated, table.width) if known is None else (known.mean, known.std)
    places = [table.find_index("offset", name) for name in robot.joint_names]
    found = [(0.0, 0.0) if place is None else (mean[place], std[place]) for place in places]
    return np.array(found)[:, 0], np.array(found)[:, 1]


def _used(
    robot: Robot, stands: MeasuredStands, kp: Array, zeros: Array, sure: Array
) -> tuple[MeasuredStands, tuple[Diagnostic, ...]]:
    """Returns stands without the commands that tell no torque, and which these are.

    At a stop it may carry, as far as encoders' zeros are known (nu,); of a motor that gives all it
    can, nobody knows by how much a command leads.
    """
    commanded, position = np.isfinite(stands.command), stands.position - zeros
    lead, margin = (
        np.nan_to_num(stands.command - stands.position),
        _AT_STOP + LIMIT_MARGIN_STDS * sure,
    )
    stopped = (position < robot.lower_limits + margin) | (position > robot.upper_limits - margin)
    full = (np.abs(kp * lead) > _FULL * robot.effort_limits) & ~stopped
    notes = [] if commanded.any() else [diagnose("stands-without-commands")]
    for at_stop, found in ((True, stopped & commanded), (False, full)):
        if found.any():
            rows, joints = np.nonzero(found)
            where = [stands.names[row] for row in np.unique(rows)]
            names = [robot.joint_names[joint] for joint in np.unique(joints)]
            notes.append(diagnose(_TELLS_NO_TORQUE[at_stop], stands=where, joints=names))
    return replace(stands, command=np.where(stopped | full, np.nan, stands.command)), tuple(notes)


_TELLS_NO_TORQUE = {True: "stands-at-stops", False: "stands-with-full-torque"}
"""{whether a joint is at a stop, or its motor gives all it can: the note}."""

_FULL = 0.98
"""Of a motor's limit: what it gives then is cut off."""


def _weighed(
    robot: Robot, table: ParameterTable, weight: float | None
) -> Callable[[Array], LinearisedResiduals]:
    """Returns what a scale says of the masses: one residual, or none."""
    line = np.array([float(one.kind == "mass") for one in table])
    rest = robot.total_mass - float(line @ table.stated)  # of what is no parameter

    def residuals(x: Array) -> LinearisedResiduals:
        if weight is None:
            return LinearisedResiduals.empty(len(table))
        sure = SCALE_RTOL * weight
        return LinearisedResiduals.from_residuals(
            np.array([(line @ x + rest - weight) / sure]), line[None] / sure
        )

    return residuals


_TOUCHES = 1.0
"""Standard deviations below the ground: a foot there is hardly in the air. Those of v3 that sag to
within a millimetre of it may come out a little below."""


def _check_feet(
    robot: Robot,
    stands: MeasuredStands,
    equations: StandEquations,
    posterior: Posterior | None = None,
) -> None:
    """Checks that no foot that is said to carry has to pull, and none in the air touches.

    As far as encoders' zeros are known: by measurements, or before.
    """
    table = equations.table
    x = table.stated if posterior is None else posterior.mean
    _, offsets = _zeros(robot, table, posterior)
    weight = robot.weight
    found: list[tuple[float, Diagnostic]] = []
    for row, name in enumerate(stands.names):
        for foot, (height, off) in equations.compute_swing_heights(row, x, offsets).items():
            if height < -_TOUCHES * off:
                at, high = ("foot", foot), Quantity(height, "m")
                one = diagnose("foot-in-the-air-touches", subject=at, stand=name, height=high)
                found.append((-height / off, one))
        for foot, force in equations.sum_normal_forces(row).items():
            if force < -_PULLS * weight:
                at, pull, up = ("foot", foot), Quantity(-force, "N"), list(stands.swing[row])
                one = diagnose("foot-would-pull", subject=at, stand=name, force=pull, swing=up)
                found.append((-force / (_PULLS * weight), one))
    if found:  # the worst one: it may have drawn others; of joints first, which no servo draws
        worst = max(found, key=lambda one: (one[1].code == _CONTRADICTIONS[0], one[0]))
        raise MeasurementError(stands.source, worst[1])


# Coordinates of parameters in which what is known before is normal: logarithms of what scales.


class LogCoordinates:
    """A vector of parameters by logarithms of masses and stiffness, and back.

    Stands tell kp and masses by their ratio. Were each normal, all smaller together would be more
    probable than all larger: twelve kp that differ by a tenth differ by less if all are halved, and
    the most probable robot was 13 % too light. Factors are as probable either way.

    In place of x there stands x0 + x0 log(x / x0), x0 being the stated value: in the parameter's
    unit, the same near x0, and with the same width before.

    Args:
        table: The parameters.

    Attributes:
        least: (n,) below which coordinates mean nothing.
    """

    def __init__(self, table: ParameterTable) -> None:
        kinds = [KINDS[one.kind] for one in table]
        self._factors = np.array([kind.factor for kind in kinds], dtype=bool)
        self._stated = table.stated
        above = np.array([kind.positive for kind in kinds], dtype=bool) & ~self._factors
        self.least: Array = np.where(above, 0.0, -np.inf)

    def to_parameters(self, logarithms: Array) -> Array:
        """Returns parameters (n,) of coordinates (n,)."""
        return np.where(self._factors, self._stated * self.compute_rates(logarithms), logarithms)

    def from_parameters(self, vector: Array) -> Array:
        """Returns coordinates (n,) of parameters (n,)."""
        found, stated = vector.copy(), self._stated[self._factors]
        found[self._factors] = stated * (1 + np.log(vector[self._factors] / stated))
        return found

    def compute_rates(self, logarithms: Array) -> Array:
        """Returns how fast parameters change with coordinates (n,): x / x0 of what scales."""
        found = np.ones(len(logarithms))
        stated = self._stated[self._factors]
        found[self._factors] = np.exp(logarithms[self._factors] / stated - 1)
        return found

    def transform_linearised(
        self, linearised: LinearisedResiduals, logarithms: Array
    ) -> LinearisedResiduals:
        """Returns measurements about coordinates, of those about the parameters that they are."""
        rates = self.compute_rates(logarithms)
        information = rates[:, None] * linearised.information * rates
        return replace(linearised, information=information, gradient=rates * linearised.gradient)

    def transform_posterior(self, posterior: Posterior) -> Posterior:
        """Returns what is known of parameters, as it is of coordinates, linear about the best.

        What was known before is as wide as it is there: of a robot twice as heavy, twice as wide.
        """
        rates = self.compute_rates(posterior.mean)
        return replace(
            posterior,
            parameters=tuple(
                replace(one, width=float(rate) * one.width)
                for one, rate in zip(posterior.parameters, rates, strict=True)
            ),
            mean=self.to_parameters(posterior.mean),
            covariance=rates[:, None] * posterior.covariance * rates,
        )


# How large noise is that nobody states: what the measurements themselves make most likely.


_SPREAD = 1.5
"""Standard deviation of a level's logarithm before: a factor of 4.5 either way."""

_FLATTEST = 1e-4
"""m: links and floors are no better; simulated ones are, but feet sink by more than is modelled."""

_LEAST_MOMENT = 1e-4
"""m: what feet keep alike in all stands, which are come to alike, hides in the zeros of encoders.
No evidence tells of it. Feet of v3 in MuJoCo keep 2e-5 to 1e-3 after 12 s."""

_ALIKE = 0.5
"""Of friction as files state it, at least: what stands keep alike parameters take up, and little is
left to be found: a fifth on MEVIUS, which sinks without a bounce, and 88 % of intervals held."""

_SETTLES = 4
"""Steps after which stands' own unknowns change no evidence that is told."""

_EVALUATIONS = 40
"""Of the evidence, in search of three levels: they are wanted to some ten per cent."""


def scale_common_widths(
    table: ParameterTable, noise: StandNoise, expected: StandNoise
) -> ParameterTable:
    """Returns parameters with what stands keep alike as large as what each keeps by itself.

    Friction of one sign no evidence shows: it is what the files state at least.
    """
    moments = table.with_scaled_widths("moment", noise.moment / expected.moment)
    return moments.with_scaled_widths("settling", max(1.0, noise.friction / expected.friction))


def estimate_noise(
    equations: StandEquations,
    known: Posterior,
    more: Callable[[Array], LinearisedResiduals],
    rubs: float,
) -> StandNoise:
    """Returns the noise with moments on feet, flatness and joints' friction that are most likely.

    The greatest evidence: probability of the measurements, whatever the parameters are, times that
    of the levels, which are log-normal about those that are expected.

    Args:
        equations: Of the stands, with the noise that is expected.
        known: With that noise; about its parameters residuals are taken.
        more: Returns further residuals.
        rubs: Factor on the stated friction that is expected.
    """
    from scipy import optimize  # slow to import

    expected, x, table = equations.noise, known.mean, ParameterTable(known.parameters)
    equations.linearise(x, x, _SETTLES)  # finds stands' own unknowns
    stands, others = equations.evaluate_rows(x), more(x)

    def at(levels: Array) -> StandNoise:
        moment, flatness, friction = np.exp(levels)
        return replace(
            expected,
            moment=max(_LEAST_MOMENT, expected.moment * moment),
            flatness=max(_FLATTEST, expected.flatness * flatness),
            friction=expected.friction * rubs * max(_ALIKE, friction),
        )

    def unlikely(levels: Array) -> float:
        noise, finding = at(levels), others
        for stand in stands:
            stand.set_noise(noise)
            finding += stand.eliminate_own_unknowns()[0]
        evidence = finding.compute_log_evidence(
            scale_common_widths(table, noise, expected), known.moved
        )
        return float(levels @ levels) / (2 * _SPREAD**2) - evidence

    simplex = np.vstack([np.zeros(3), -np.eye(3)])
    options = {"initial_simplex": simplex, "maxfev": _EVALUATIONS, "xatol": 0.05, "fatol": 0.02}
    found = optimize.minimize(unlikely, np.zeros(3), method="Nelder-Mead", options=options)
    return at(found.x)
