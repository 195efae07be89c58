"""What stands at rest tell, as numbers with intervals."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.base.errors import PupperAnalysisError
from pupper_analysis.base.results import Result
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.fit.estimate import Posterior
from pupper_analysis.tools.fit.measurements.stands import MeasuredStands
from pupper_analysis.tools.fit.parameters import OF_SURROUNDINGS, Parameter
from pupper_analysis.tools.fit.result import (
    Estimate,
    Fit,
    describe_parameter,
    describe_parameters,
    find_together,
    told_by,
)
from pupper_analysis.tools.fit.stands.equations import StandEquations
from pupper_analysis.tools.fit.stands.rows import StandNoise

Array = NDArray[np.float64]


@dataclass(frozen=True)
class JointResidual(Result):
    """What is left at one joint in one stand.

    Attributes:
        stand: The stand.
        joint: The joint.
        off: Measured position less predicted one (rad).
        deviations: The same in standard deviations of what noise makes.
    """

    stand: str
    joint: str
    off: float
    deviations: float


@dataclass(frozen=True, eq=False)
class StandFit(Fit):
    """A robot's numbers as stands at rest tell them.

    Attributes:
        stands: How many there are.
        total_mass: Of the whole robot (kg).
        residuals: {stand: root mean square of its residuals, in standard deviations}.
        joint_residuals: Of each joint in each stand, the most surprising before.
        chi2: Sum of all squared residuals, in standard deviations.
        freedom: What that is on average, if the model is right.
        noise: Standard deviations of measurements, as they were taken to be or were found.
    """

    stands: int
    total_mass: Estimate
    residuals: Mapping[str, float]
    joint_residuals: tuple[JointResidual, ...]
    chi2: float
    freedom: float
    noise: Mapping[str, float]


def describe_stands(
    robot: Robot,
    stands: MeasuredStands,
    equations: StandEquations,
    posterior: Posterior,
    expected: StandNoise,
    notes: Sequence[Diagnostic],
    weighed: bool,
) -> StandFit:
    """Returns what measurements tell, in numbers with intervals.

    Args:
        robot: The robot.
        stands: Its stands.
        equations: Of these, with the noise that was found.
        posterior: What is known of the parameters.
        expected: The noise that was expected.
        notes: What was found before.
        weighed: Whether the whole robot was put on a scale.
    """
    found = tuple(describe_parameters(posterior))
    more = dict(further_measurements(equations, posterior, weighed=weighed))
    return StandFit(
        name=robot.name,
        source=stands.source,
        stands=len(stands),
        estimates=found,
        total_mass=_total_mass(robot, posterior),
        together=find_together(posterior, more),
        residuals=dict(zip(stands.names, equations.residuals(posterior.mean), strict=True)),
        joint_residuals=_joint_residuals(stands, equations, posterior.mean),
        chi2=posterior.chi2,
        freedom=posterior.freedom,
        noise={
            "encoder": equations.noise.encoder,
            "moment": equations.noise.moment,
            "flatness": equations.noise.flatness,
            "friction": equations.noise.friction,
        },
        failures=tuple(doubt_stands(posterior, equations.noise, expected)),
        diagnostics=tuple(notes),
        posterior=posterior,
    )


def _joint_residuals(
    stands: MeasuredStands, equations: StandEquations, x: Array
) -> tuple[JointResidual, ...]:
    off, noise = equations.joint_residuals(x)
    found = [
        JointResidual(
            stand, joint, float(off[row, column]), float(off[row, column] / noise[row, column])
        )
        for row, stand in enumerate(stands.names)
        for column, joint in enumerate(stands.joints)
        if noise[row, column] > 0
    ]
    return tuple(sorted(found, key=lambda one: -abs(one.deviations)))


def _total_mass(robot: Robot, posterior: Posterior) -> Estimate:
    line = np.array([float(one.kind == "mass") for one in posterior.parameters])
    widths = np.array([one.width for one in posterior.parameters])
    stated = np.array([one.stated for one in posterior.parameters])
    std = math.sqrt(float(line @ posterior.covariance @ line))
    before = np.linalg.inv(posterior.precision)
    width = math.sqrt(float((line * widths) @ before @ (line * widths)))
    whole = Parameter("mass", robot.name, "", robot.total_mass, width)
    mean = robot.total_mass + float(line @ (posterior.mean - stated))
    return describe_parameter(whole, mean, std, told_by((std / width) ** 2 if width else 1.0))


# What a model does not explain of stands: noise, numbers, and what surrounds the robot.


_CHANCE = 0.002
"""Probability that a kind is found to be otherwise by chance: of three, 0.6 % of all fits."""

_LEAST_TOLD = 0.02
"""Of a prior's variance: a direction of which no more is told speaks against nothing."""

_ALSO = 2.0
"""Standard deviations, where feet sink otherwise: those which do."""

_NOISY = 5.0
"""Times what was expected: noise of which there is so much hides a cause."""

_FAR = 4.5
"""Standard deviations: of a hundred numbers that are as was said, none is so far off."""

_DOUBTED = ("slope", "softness", "imu")
"""Of the surroundings: kinds that somebody says something of."""

_NEVER_NOTHING, _NOTHING = ("mass", "kp"), 0.01
"""Kinds of numbers that no robot has none of, and what is none, in parts of the stated value."""

_RESIDUALS_CHANCE = 1e-3
"""Probability of residuals that are larger by chance."""


def doubt_stands(
    posterior: Posterior, found: StandNoise, expected: StandNoise
) -> Iterator[Diagnostic]:
    """Yields what the model does not explain of the measurements.

    Args:
        posterior: What is known of the parameters.
        found: The noise that was found.
        expected: The noise that was expected.
    """
    from scipy import stats  # slow to import

    if stats.chi2.sf(posterior.chi2, max(posterior.freedom, 1.0)) < _RESIDUALS_CHANCE:
        ratio = posterior.chi2 / max(posterior.freedom, 1.0)
        yield diagnose("residuals-too-large", times=math.sqrt(ratio))
    if found.flatness > _NOISY * expected.flatness:
        yield diagnose("feet-off-the-plane", off=Quantity(found.flatness, "m"))
    if found.friction > _NOISY * expected.friction:
        yield diagnose("torques-off", times=found.friction / expected.friction)
    own = [place for place, one in enumerate(posterior.parameters) if _is_own(one)]
    # What is known before and after differ in variance by what an estimate is surprised by, if the
    # parameter is as it was said to be: one by poor measurements stays near the stated value, and
    # tells as much by a smaller step.
    surprise = np.sqrt(np.maximum(1 - posterior.shares, _LEAST_TOLD))
    moved = posterior.moved / surprise
    far = [
        place
        for place in own
        if abs(moved[place]) > _FAR
        or (
            (posterior.parameters[place].kind in _NEVER_NOTHING and moved[place] < 0)
            and posterior.mean[place] < _NOTHING * posterior.parameters[place].stated
        )
    ]
    if far:
        worst = max(far, key=lambda place: abs(moved[place]))
        names = [posterior.parameters[place].name for place in far]
        yield diagnose("far-from-the-file", names=names, widths=abs(float(moved[worst])))
    flatter = min(1.0, found.flatness / expected.flatness)
    yield from doubt_surroundings(posterior, {"softness": flatter**2})


def _is_own(one: Parameter) -> bool:
    return one.kind not in OF_SURROUNDINGS


def doubt_surroundings(
    posterior: Posterior, shares: Mapping[str, float] | None = None
) -> Iterator[Diagnostic]:
    """Yields what of the surroundings is not as it was said to be, one kind at a time.

    Estimates move from what was said by d. If that is so, d has the covariance S by which prior and
    posterior differ, and d^T S^-1 d is distributed as chi^2: several weak signs of a slope, or of
    soft soles, are one together. What is said is S^-1 d in the prior's variances, which is not
    drawn to what was said.

    Args:
        posterior: What is known of the parameters.
        shares: {kind: what its signs are worth, in parts}. Feet that sink and ground that is uneven
            look alike: where ground came out flatter than expected, by few stands, signs of the
            other are worth what they were on the expected one.
    """
    from scipy import stats  # slow to import

    for kind in _DOUBTED:
        places = [at for at, one in enumerate(posterior.parameters) if one.kind == kind]
        if not places:
            continue
        chosen = [posterior.parameters[at] for at in places]
        width = np.array([one.width for one in chosen])
        off = posterior.moved[places]
        before = np.linalg.inv(posterior.precision)[np.ix_(places, places)]
        told = before - posterior.covariance[np.ix_(places, places)] / np.outer(width, width)
        values, vectors = np.linalg.eigh(told)
        kept = values > _LEAST_TOLD
        moved = vectors[:, kept].T @ off
        signs = (shares or {}).get(kind, 1.0) * float(np.sum(moved**2 / values[kept]))
        if not kept.any() or stats.chi2.sf(signs, np.count_nonzero(kept)) > _CHANCE:
            continue
        free = width * (before @ vectors[:, kept] @ (moved / values[kept]))
        each = np.abs(off) / np.sqrt(np.maximum(np.diag(told), _LEAST_TOLD))
        if kind == "slope":
            most = chosen[int(np.abs(free).argmax())]
            slope = Quantity(float(math.hypot(*free)), "rad")
            yield diagnose("ground-slopes", slope=slope, axis=most.component)
            continue
        for number, one in enumerate(chosen):
            if number != each.argmax() and each[number] < _ALSO:
                continue
            if kind == "softness":
                times = max(0.0, one.stated + float(free[number]))
                yield diagnose("feet-sink-otherwise", subject=("foot", one.subject), times=times)
            else:
                angle = Quantity(float(free[number]), "rad")
                yield diagnose("imu-is-turned", angle=angle, axis=one.component)


# What else could be measured of stands, and how much it would tell.


WEIGHED = 0.002
"""Of a mass that a scale shows: standard deviation."""


def further_measurements(
    equations: StandEquations, posterior: Posterior, *, weighed: bool
) -> Iterator[tuple[str, Array]]:
    """Yields what else could be measured, and its information where priors' widths are the units.

    Args:
        equations: Of the stands.
        posterior: What is known of the parameters.
        weighed: Whether the whole robot was put on a scale.
    """
    robot, table, x = equations.robot, equations.table, posterior.mean
    scaled = np.outer(table.width, table.width)
    if not weighed:
        line = np.array([float(one.kind == "mass") for one in table])
        yield "weigh-the-robot", scaled * np.outer(line, line) / (WEIGHED * robot.total_mass) ** 2
    here = equations.linearise(x, x).information
    for what, read in equations.further_readings(x).items():
        there = equations.reading(read).linearise(x, x).information
        yield what, scaled * (there - here)
    if (both := equations.from_both_sides(x)) is not None:
        yield "come-from-both-sides", _of_first(both, x) - scaled * here
    if (three := on_three_feet(equations, x)) is not None:
        yield "stand-on-three-feet", scaled * three.linearise(x, x).information


def _of_first(equations: StandEquations, x: Array) -> Array:
    """Returns the information about the first parameters (n, n), whatever the others of a table.

    In the priors' widths.
    """
    table, n = equations.table, len(x)
    whole = np.concatenate([x, table.stated[n:]])
    told = np.outer(table.width, table.width) * equations.linearise(whole, whole).information
    others = told[n:, n:] + table.precision[n:, n:]
    found: Array = told[:n, :n] - told[:n, n:] @ np.linalg.solve(others, told[n:, :n])
    return found


def on_three_feet(equations: StandEquations, x: Array) -> StandEquations | None:
    """Returns equations of stands with one foot in the air, each foot once.

    They are the robot's nominal stand, with the base moved over three feet. Servos are commanded
    what holds them there.

    Args:
        equations: Of stands on all feet.
        x: (n,) parameters.

    Returns:
        The equations; None if a foot was in the air already, or the robot stands on no three feet.
    """
    # PlaCo is slow to import, and who reads measurements alone needs none.
    from pupper_analysis.stance.stand import solve_stand, stand_statics
    from pupper_analysis.stance.task import StandTask

    robot = equations.robot
    if len(robot.feet) <= _FEWEST or equations.lifted:
        return None
    size, stands = robot.stand_height, []
    for foot in robot.feet:
        task = StandTask(swing={foot: _LIFTED * size}, com="inside", com_margin=_MARGIN * size)
        try:
            stand = solve_stand(robot, task)
            held = stand_statics(robot, stand)
        except PupperAnalysisError:  # no balance without that foot
            continue
        stands.append((stand.qpos, held.joint_torques, held.contact_forces, (foot,)))
    return equations.of_stands(stands, x) if stands else None


_LIFTED, _MARGIN = 0.15, 0.03
"""Of the height: how high a foot is lifted, and how far the com is within the others' triangle. As
plans have them, but for a com that is as near to the edge as three feet allow."""

_FEWEST = 3
"""Feet that a robot stands on, at least; with one more it may lift one."""
