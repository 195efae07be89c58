"""Explain an unreachable stance: find requirements to relax, and the smallest change.

`explain_refusal` first relaxes single requirements. If none suffices alone, the search continues
with a small set of requirements that suffices together. The nonlinear program with slacks
(`stance.programme`) computes the relaxation: the smallest change that makes the stance reachable,
as far as local minima permit. The rounded result is solved again, so that a reported value can be
typed as a task.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pupper_analysis.base.arguments import suggest_millimetres
from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.base.errors import ConfigurationError, StanceUnreachableError
from pupper_analysis.robot.closure import Closure
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.joints import joint_unit
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.constraints import TASK_TOLERANCE
from pupper_analysis.stance.fields import FIELDS
from pupper_analysis.stance.judge import Stand
from pupper_analysis.stance.problem import StandTargets, compute_targets
from pupper_analysis.stance.programme import Relaxation, StanceProgram
from pupper_analysis.stance.requirements import (
    RELAXABLE_REQUIREMENTS,
    RequirementVector,
    describe_limit,
    differs_from_nominal,
    relax_further,
    reset_to_nominal,
    round_outward,
)
from pupper_analysis.stance.search import describe_mechanism_limit, search_stand
from pupper_analysis.stance.solver import SearchContext
from pupper_analysis.stance.task import StandTask

_DEAD_POINT_RATIO = 1e-2
"""Ratio [1] (mobility of a foot with closed loops) / (mobility without the loops), below which a
dead point of the loops is reported. A mobility is a singular value of the foot Jacobian. Mobilities
without loops below this fraction of the largest mobility are ignored. At 1 mrad from a dead point
the ratio is about 1e-3. Chosen, not tuned."""

_MIN_FOOT_ERROR = 1e-6
"""Foot error [m] below which a foot is not reported as out of reach at a dead point of closed
loops. Chosen, not tuned."""

_EXTRA_RELAXATIONS = (0.0, 1e-3, 4e-3, 1.6e-2, 6.4e-2)
"""Fractions by which the relaxation of an unreachable task is increased, in this order, until the
relaxed task with rounded values has a stand. At the limit of reach, a search from other initial
guesses may fail. Chosen, not tuned."""

_POSITIVE_REQUIREMENTS = ("swing", "com_margin")
"""Names of relaxable requirements whose values must not become close to zero. A foot with a swing
height of zero would carry load. With a CoM margin of zero, the CoM of a task with an offset may be
outside the support polygon."""

_NEGLIGIBLE_VALUE = 1e-3
"""Smallest permitted value of the requirements in `_POSITIVE_REQUIREMENTS`, relative to the
robot's stand height. A relaxed task with a smaller value is rejected. Chosen, not tuned."""

_REDUCTION_SHARES = (0.03, 0.01)
"""Fractions by which `_relax_one` reduces a computed relaxation, to test if the nonlinear program
ended in a local minimum. Chosen from a measurement with Pupper v3 on a slope: the program left two
local minima, and the relaxation decreased by 6 % and by 1 %."""

_MIN_RELAXATION = 1e-6
"""Relaxation [stand heights, rad] up to which a requirement counts as unchanged and is not
reported. Chosen, not tuned."""


def explain_refusal(
    context: SearchContext, targets: StandTargets, nearest: Stand, *, explain: bool
) -> StanceUnreachableError:
    """Create the error that no stand was found: foot errors [m], joints at limits, relaxations.

    Args:
        context: Search context of the robot.
        targets: Targets and limits of the stand (`StandTargets`), for which no stand was found.
        nearest: Best failure of the search (`search_stand`, `minimise_foot_errors`).
        explain: Whether to compute the requirements to relax, and the smallest relaxation.
    """
    robot = context.robot
    feet = Configuration(robot, nearest.qpos).foot_positions()
    gaps = {foot: float(np.linalg.norm(feet[foot] - targets.foot_targets[foot])) for foot in feet}
    joints = nearest.joint_positions(robot)
    at_limit: dict[str, float] = {}
    placed = targets.lower == targets.upper  # joints of a posture have equal limits
    for limits in (targets.lower, targets.upper):
        for index in np.flatnonzero((np.abs(joints - limits) < 1e-6) & ~placed):
            at_limit[robot.joint_names[index]] = float(limits[index])
    missed = {foot: gap for foot, gap in gaps.items() if gap >= TASK_TOLERANCE}
    blocked = () if missed else nearest.blocked
    if not missed and not blocked:  # feet reach their targets, loops stay open
        blocked = (diagnose("loops-stay-open", most=Quantity(nearest.foot_error, "rad or m")),)
    if not at_limit and _is_dead_point(robot, nearest):
        blocked = (diagnose("motors-at-dead-point"),)
        missed = {foot: gap for foot, gap in missed.items() if gap >= _MIN_FOOT_ERROR}
    basis = _RelaxationSearch(context, targets, nearest).find_relaxations() if explain else []
    named = {" and ".join(relaxation.requirements): relaxation for relaxation in basis}
    least = min(basis, key=lambda relaxation: relaxation.slack, default=None)
    return StanceUnreachableError(
        targets.task.phrase(),
        missed,
        at_limit,
        {
            name: describe_limit(
                robot, targets.task, relaxation.stand.task, relaxation.requirements
            )
            for name, relaxation in named.items()
        },
        None if least is None else least.stand,
        blocked,
        {
            name: {
                requirement: getattr(relaxation.stand.task, requirement)
                for requirement in relaxation.requirements
            }
            for name, relaxation in named.items()
        },
        describe_mechanism_limit(robot, targets)
        or (_describe_different_files(robot) if explain and not named else None),
        {name: joint_unit(robot, name) for name in at_limit},
        _report_millimetres(targets.task),
    )


def _report_millimetres(task: StandTask) -> Iterator[Diagnostic]:
    """Yield a message with the value in m for each length or point that is probably in mm."""
    for field in FIELDS.values():
        if field.unit != "m" or field.kind == "contact":
            continue
        value = getattr(task if field.part == "task" else getattr(task, field.part), field.name)
        for key, number in value.items() if field.per else [("", value)]:
            numbers = number if isinstance(number, tuple) else (number,)
            are_lengths = all(isinstance(part, float | int) for part in numbers)
            if are_lengths and (written := suggest_millimetres(*numbers)):
                name = f"{field.name}[{key}]" if key else field.name
                yield diagnose("field-in-millimetres", field=name, written=written)


def _describe_different_files(robot: Robot) -> Diagnostic | None:
    """Describe the first difference of a robot's two files, a possible reason why no stand exists.

    None without a difference. A foot on the ground by the URDF may be in the ground by the MJCF.
    """
    # Imports forty modules, which few refusals need.
    from pupper_analysis.robot.compare.compare import find_first_difference

    difference = find_first_difference(robot)
    return None if difference is None else diagnose("correct-the-files", difference=difference)


def _is_dead_point(robot: Robot, nearest: Stand) -> bool:
    """Return True if closed loops are at a dead point: joints cannot move a foot in some direction.

    Directions that the loops also block in the home configuration do not count.
    """
    if robot.closure is None:
        return False
    here, at_home = (
        _compute_mobilities(robot, robot.closure, qpos) for qpos in (nearest.qpos, robot.home)
    )
    for foot in nearest.stance_feet:
        free, bound = here[foot]
        usual_free, usual_bound = at_home[foot]
        is_lost = (bound < _DEAD_POINT_RATIO * free) & (free > _DEAD_POINT_RATIO * free[0])
        if (is_lost & (usual_bound >= _DEAD_POINT_RATIO * usual_free)).any():
            return True
    return False


def _compute_mobilities(
    robot: Robot, closure: Closure, qpos: Array
) -> dict[str, tuple[Array, Array]]:
    """Compute the mobilities of each contact point: singular values of its Jacobian [m/rad, m/m].

    Returns:
        {contact point: (mobilities without closed loops, with closed loops), shape (3,) each,
        descending}.
    """
    basis = closure.null_space(qpos)

    def compute_values(matrix: Array) -> Array:
        values = np.linalg.svd(matrix, compute_uv=False)
        return np.pad(values, (0, 3 - len(values)))

    return {
        foot: (compute_values(joints), compute_values(joints @ basis))
        for foot, jacobian in Configuration(robot, qpos).foot_jacobians().items()
        for joints in [jacobian[:3, robot.nv - robot.nu :]]
    }


@dataclass(frozen=True, eq=False)
class _StatedRelaxation:
    """Relaxation for a report: relaxed requirements, and a stand for the rounded relaxed values.

    Attributes:
        requirements: Names of the relaxed requirements, from `RELAXABLE_REQUIREMENTS`.
        slack: Sum of the relaxations before rounding [stand heights and rad mixed].
        stand: Stand of the relaxed task with rounded values.
    """

    requirements: tuple[str, ...]
    slack: float
    stand: Stand


class _RelaxationSearch:
    """Search for small changes (relaxations) of an unreachable stand task that make it reachable.

    Args:
        context: Search context of the robot.
        targets: Targets and limits of the unreachable stand (`StandTargets`).
        nearest: Best failure of the search. The nonlinear program starts from this stand, and from
            the home configuration.
    """

    def __init__(self, context: SearchContext, targets: StandTargets, nearest: Stand) -> None:
        self.context, self.targets = context, targets
        home = context.robot.home.copy()
        home[:2] = targets.centre[:2]
        self.starts = [nearest.qpos, home]

    def find_relaxations(self) -> list[_StatedRelaxation]:
        """Find relaxations of single requirements that make the task reachable, with stands.

        If no single requirement suffices, a relaxation of a small set of requirements. Empty on
        failure.
        """
        robot, task = self.context.robot, self.targets.task
        differing = [
            requirement
            for requirement in RELAXABLE_REQUIREMENTS
            if differs_from_nominal(robot, task, [requirement])
        ]
        alone = [self._solve_rounded(self._relax_one(requirement)) for requirement in differing]
        if stated := [relaxation for relaxation in alone if relaxation is not None]:
            return stated
        least = self._find_smallest(differing, self.starts)
        fewest = self._solve_rounded(self._reduce_requirements(least)) or self._solve_rounded(least)
        return [] if fewest is None else [fewest]

    def _find_smallest(
        self, requirements: Sequence[str], starts: Iterable[Array]
    ) -> Relaxation | None:
        """Find the smallest feasible relaxation of some requirements; None if none is found.

        The program starts from configurations (nq,), and from the stand with nominal values of
        these requirements. Measured with several relaxed requirements: this stand gave the best
        result in 27 of 28 refusals.
        """
        elastic = StanceProgram(self.context.shapes, self.targets, requirements)
        basis = [elastic.solve(start) for start in starts]
        without = reset_to_nominal(self.context.robot, self.targets.task, requirements)
        stand = search_stand(
            self.context, self._compute_targets(without), default_guesses_only=True
        )
        if stand.solved:
            basis.append(elastic.solve(stand.qpos, without))
        return min(
            (relaxation for relaxation in basis if relaxation.is_met),
            key=lambda relaxation: relaxation.slack,
            default=None,
        )

    def _relax_one(self, requirement: str) -> Relaxation | None:
        """Find the smallest relaxation of one requirement; None without a feasible relaxation.

        Stands with less relaxation are searched, since the nonlinear program may end in a local
        minimum.
        """
        relaxation = self._find_smallest([requirement], self.starts)
        shares = list(_REDUCTION_SHARES)
        while relaxation is not None and shares:
            less = relax_further(
                self.context.robot, relaxation.task, self.targets.task, [requirement], -shares[0]
            )
            stand = search_stand(self.context, self._compute_targets(less), com_at_centre_only=True)
            if not stand.solved:
                shares.pop(0)
                continue
            better = StanceProgram(self.context.shapes, self.targets, [requirement]).solve(
                stand.qpos, less
            )
            if not better.is_met or better.slack > (1 - shares[0] / 2) * relaxation.slack:
                break
            relaxation = better
        return relaxation

    def _reduce_requirements(self, relaxation: Relaxation | None) -> Relaxation | None:
        """Reduce the number of relaxed requirements, while the nonlinear program stays feasible."""
        if relaxation is None:
            return None
        given = {
            requirement: slack
            for requirement, slack in relaxation.relaxations.items()
            if slack > _MIN_RELAXATION
        }
        for requirement in sorted(given, key=given.__getitem__):
            rest = [
                name
                for name in given
                if name != requirement and relaxation.relaxations.get(name, 0.0) > _MIN_RELAXATION
            ]
            if relaxation.relaxations.get(requirement, 0.0) > _MIN_RELAXATION and len(rest) > 1:
                relaxation = self._find_smallest(rest, (relaxation.qpos,)) or relaxation
        return relaxation

    def _solve_rounded(self, relaxation: Relaxation | None) -> _StatedRelaxation | None:
        """Round a relaxation, increase it if necessary, and solve its stand; None on failure."""
        if relaxation is None:
            return None
        robot = self.context.robot
        requirements = tuple(
            requirement
            for requirement, slack in relaxation.relaxations.items()
            if slack > _MIN_RELAXATION
        )
        if not requirements:
            return None
        for share in _EXTRA_RELAXATIONS:
            task = self._round_task(relaxation, requirements, share)
            if task is None or any(
                _is_degenerate(robot, task, requirement) for requirement in requirements
            ):
                continue
            if (stand := self._solve_task(task)) is not None:
                return _StatedRelaxation(requirements, relaxation.slack, stand)
        return None

    def _round_task(
        self, relaxation: Relaxation, requirements: Sequence[str], share: float
    ) -> StandTask | None:
        """Round relaxed values, increased by ``share``; None if the task becomes infeasible.

        After each rounding, the relaxation of the remaining requirements is computed again.
        """
        robot, left = self.context.robot, [*requirements]
        requested = task = self.targets.task
        while relaxation.is_met:
            requirement = max(left, key=relaxation.relaxations.__getitem__)
            left.remove(requirement)
            there = relax_further(robot, relaxation.task, requested, [requirement], share)
            end = round_outward(robot, there, requested, [requirement])
            task = replace(task, **{requirement: getattr(end, requirement)})
            if not left:
                return task
            elastic = StanceProgram(self.context.shapes, self._compute_targets(task), left)
            relaxation = elastic.solve(relaxation.qpos, relaxation.task)
        return None

    def _solve_task(self, task: StandTask) -> Stand | None:
        """Return the stand of a task by `search_stand`; None if rejected or without stand."""
        try:
            targets = self._compute_targets(task, checked=True)
        except ConfigurationError:
            return None
        stand = search_stand(self.context, targets)
        return stand if stand.solved else None

    def _compute_targets(self, task: StandTask, *, checked: bool = False) -> StandTargets:
        """Convert a task to targets, with the static deflections of the unreachable targets.

        Deflections are the penetrations of the feet into soft ground, and the openings of loops.
        """
        targets = compute_targets(self.context.robot, task, self.targets.depths, checked=checked)
        return replace(targets, loop_opening=self.targets.loop_opening)


def _is_degenerate(robot: Robot, task: StandTask, requirement: str) -> bool:
    """Return True if a value of a requirement in `_POSITIVE_REQUIREMENTS` is too small."""
    least = _NEGLIGIBLE_VALUE * robot.stand_height
    return requirement in _POSITIVE_REQUIREMENTS and bool(
        (RequirementVector(robot, task, [requirement]).values < least).any()
    )
