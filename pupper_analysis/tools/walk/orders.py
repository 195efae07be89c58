"""Ranking of readings of a policy: joint orders, signs, scales and histories.

A reading (interpretation) is an order of joints, signs, scale and history. Inputs are a robot, a
policy and commands; output is an `Orders`. The stated reading, and readings that differ in a single
respect, are simulated. Readings are ranked by the number of tracked commands; equal numbers are
ranked by torque and tracking error (`Candidate.cost`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import permutations
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import Diagnostic
from pupper_analysis.base.results import Result
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.walk.contract import BY_FRAME, BY_TERM, PolicyContract
from pupper_analysis.tools.walk.gait import (
    SPEED_ATOL,
    check_command,
    check_runs,
    evaluate_tracking,
    has_unknown_masses,
    joint_torques,
    list_walk_remarks,
)
from pupper_analysis.tools.walk.intervals import DEFAULT_SECONDS, WARM_UP_SECONDS
from pupper_analysis.tools.walk.policy import Policy
from pupper_analysis.tools.walk.runs import find_joint_indices, prepare_stage, simulate_cases

DEFAULT_COMMANDS = ((0.5, 0.0, 0.0), (0.0, 0.3, 0.0), (0.0, 0.0, 0.8))
"""Default commands [m/s, m/s, rad/s]: forward, to the left, turning. A single command may also be
tracked with a wrong sign of a joint.
"""

MIN_COST_RATIO = 1.1
"""Ratio of the costs (`Candidate.cost`) of the second-best and the best interpretation of a policy
(joint order, signs, scale, history) above which the best is clearly better. Chosen: for Pupper's
own policy on the model v3 the ratio is 1.2.
"""

SCALE_FACTORS = (0.5, 2.0)
"""Factors on the stated action scale that are tried as other interpretations of a policy. Chosen,
not tuned: with smaller deviations a policy may still walk."""

_MAX_PERMUTED_LIMBS = 4
"""Maximum number of limbs with equally many joints for which all orders are tried. If there are
more limbs, only pairs are exchanged. Chosen, not tuned.
"""


@dataclass(frozen=True, eq=False)
class Candidate(Result):
    """Interpretation of a policy's inputs and outputs, with the result of simulated walking.

    Attributes:
        change: Difference from the stated contract: ``stated``, ``limbs``, ``by-kind``, ``sign``,
            ``scale`` or ``history``.
        detail: Changed scale or history; exchanged limbs, named by the first joints; empty
            otherwise.
        joints: Joints of the robot in the order of the policy.
        flipped: Joints with the opposite of the stated sign.
        tracked: Number of tracked commands.
        fallen: Number of commands with a fall.
        torque: Root mean square of all motor torques in all runs. All runs have equal weights.
        error: Mean over the commands: norm of the errors of velocity and turning rate (m/s and
            rad/s mixed) / norm of the command, at least 0.05; 1 for a fall.
        cost: Ranking value of candidates with equally many tracked commands: torque (1 + error) (N
            m).
    """

    change: str
    detail: str
    joints: tuple[str, ...]
    flipped: tuple[str, ...]
    tracked: int
    fallen: int
    torque: float = field(metadata={"unit": "N m"})
    error: float = field(metadata={"unit": "1"})
    cost: float = field(metadata={"unit": "N m"})


@dataclass(frozen=True, eq=False)
class Orders(Result):
    """Ranked interpretations of a policy: orders and signs of joints, scales, histories.

    Offsets of joint zeros are not tried.

    Attributes:
        name: Name of the robot.
        policy: File name of the policy.
        commands: Tried commands, shape (n, 3): forward, left, yaw rate (m/s or rad/s).
        candidates: Interpretations, the best first: most tracked commands, then the smallest cost.
        stated: Index of the stated interpretation in `candidates`.
        lead: Cost of the second candidate / cost of the first, if both track as many commands; else
            None.
        seconds: Duration of each run.
        remarks: Errors and assumptions of the robot's files behind the result.
    """

    _key_fields: ClassVar[tuple[str, ...]] = ("passed", "determined")

    name: str
    policy: str
    commands: Array = field(metadata={"unit": "m/s or rad/s"})
    candidates: tuple[Candidate, ...]
    stated: int
    lead: float | None = field(metadata={"unit": "1"})
    seconds: float = field(metadata={"unit": "s"})
    remarks: tuple[Diagnostic, ...] = ()
    _reported: ClassVar[tuple[str, ...]] = ("passed", "determined", "alike")

    @property
    def determined(self) -> bool:
        """Whether the best interpretation of a policy is clearly better than the second.

        The best must track a command, and either track more commands than the second or have a
        clearly smaller cost (`MIN_COST_RATIO`).
        """
        return bool(self.candidates[0].tracked) and (
            self.lead is None or self.lead > MIN_COST_RATIO
        )

    @property
    def alike(self) -> tuple[int, ...]:
        """Indices of the best interpretation (0), and of interpretations that are about as good.

        They track as many commands, at a cost of at most `MIN_COST_RATIO` times the cost of the
        best. Empty if no interpretation tracks a command.
        """
        best = self.candidates[0]
        return tuple(
            place
            for place, candidate in enumerate(self.candidates)
            if best.tracked
            and candidate.tracked == best.tracked
            and candidate.cost <= MIN_COST_RATIO * best.cost
        )

    @property
    def passed(self) -> bool:
        """True if the policy's stated interpretation is about as good as the best (``alike``).

        No link mass may be unknown.
        """
        return self.stated in self.alike and not has_unknown_masses(self.remarks)


@check_arguments
def rank_orders(
    robot: Robot,
    policy: Policy,
    *,
    commands: ArrayLike = DEFAULT_COMMANDS,
    seconds: float = DEFAULT_SECONDS,
    workers: int | None = None,
) -> Orders:
    """Rank interpretations of a policy's inputs and outputs by simulated walking.

    The stated joint order, signs, scale or history of a policy may be wrong. Candidates are ranked
    by the number of tracked commands. Equal numbers are ranked by `Candidate.cost`. The candidates
    are the stated interpretation, and these changes:

    - Orders of limbs with equally many joints: all orders of up to four limbs, and exchanges of two
      limbs if there are more. Each order is also tried with the joints grouped by kind instead of
      by limb, or by limb if currently grouped by kind.
    - The opposite sign of each joint, and of all joints of the same kind.
    - Half and twice the action scale.
    - With a history of several steps: the reversed history, and a history ordered by term instead
      of by time step, or the reverse, if possible.

    Args:
        robot: Robot.
        policy: Policy with the stated interpretation.
        commands: Commands of the base, shape (n, 3): forward and leftward speed, turning rate about
            the vertical [m/s, m/s, rad/s].
        seconds: Duration of each run [s], 3 to 600.
        workers: Number of threads; by default the number of cores.

    Raises:
        ConfigurationError: If an argument is out of range, the base is fixed, or the robot has no
            feet, for example.
        ModelError: If the policy does not fit the robot, for example.
    """
    checked_commands = np.array([check_command(command) for command in np.atleast_2d(commands)])
    check_runs(1, seconds, WARM_UP_SECONDS)
    contract = policy.contract
    joints = tuple(robot.joint_names[index] for index in find_joint_indices(robot, policy))
    contract = replace(contract, joints=joints)
    candidates = [
        _evaluate_interpretation(
            robot,
            replace(policy, contract=changed_contract),
            checked_commands,
            seconds,
            change,
            workers,
        )
        for change, changed_contract in _list_interpretations(robot, contract)
    ]
    stated_candidate = candidates[0]
    ranked = sorted(candidates, key=lambda candidate: (-candidate.tracked, candidate.cost))
    lead = None
    if len(ranked) > 1 and ranked[1].tracked == ranked[0].tracked:
        lead = ranked[1].cost / ranked[0].cost
    return Orders(
        name=robot.name,
        policy=policy.name,
        commands=checked_commands,
        candidates=tuple(ranked),
        stated=ranked.index(stated_candidate),
        lead=lead,
        seconds=float(seconds),
        remarks=list_walk_remarks(robot),
    )


def group_limbs(robot: Robot, joints: Sequence[str]) -> list[list[int]]:
    """Group joints by limb, to permute the limbs of a policy's joint order.

    A limb is a child body of the base, with all bodies below this child.

    Returns:
        For each limb, the indices into ``joints`` of the joints of the limb.
    """
    model = robot.mj_model
    base = model.body(robot.mj_base).id
    limbs: dict[int, list[int]] = {}
    for place, name in enumerate(joints):
        body = int(model.jnt_bodyid[model.joint(name).id])
        while int(model.body_parentid[body]) not in (0, base):
            body = int(model.body_parentid[body])
        limbs.setdefault(body, []).append(place)
    return list(limbs.values())


ContractChange = tuple[str, str, tuple[str, ...]]
"""Difference of an interpretation from the stated contract: kind of the change, detail as text, and
joints with the opposite sign."""


def _list_interpretations(
    robot: Robot, contract: PolicyContract
) -> Iterator[tuple[ContractChange, PolicyContract]]:
    """Yield interpretations of a policy as (change, changed contract), first the stated one."""
    stated_joints = contract.joints
    limbs = group_limbs(robot, stated_joints)
    yield ("stated", "", ()), contract
    for change, detail, joints in _permute_joints(stated_joints, limbs):
        yield (change, detail, ()), replace(contract, joints=joints)
    kinds = max(len(limb) for limb in limbs)
    flips = [(place,) for place in range(len(stated_joints))]
    places_by_kind = [
        tuple(limb[kind] for limb in limbs if len(limb) > kind) for kind in range(kinds)
    ]
    for places in (*flips, *(places for places in places_by_kind if len(places) > 1)):
        signs = contract.signs.copy()
        signs[list(places)] *= -1.0
        names = tuple(stated_joints[place] for place in places)
        yield ("sign", "", names), replace(contract, signs=signs)
    for scale in SCALE_FACTORS:
        changed = replace(contract, action_scale=scale * contract.action_scale)
        yield ("scale", f"x {scale:g}", ()), changed
    if contract.max_history > 1:
        newest_first = not contract.newest_first
        other_layout = BY_TERM if contract.layout == BY_FRAME else BY_FRAME
        description = "newest first" if newest_first else "oldest first"
        yield ("history", description, ()), replace(contract, newest_first=newest_first)
        if contract.has_one_history:
            yield ("history", other_layout, ()), replace(contract, layout=other_layout)


def _permute_joints(
    stated_joints: tuple[str, ...], limbs: Sequence[Sequence[int]]
) -> Iterator[tuple[str, str, tuple[str, ...]]]:
    """Yield distinct joint orders with exchanged limbs or with the other grouping of the joints.

    Yields:
        "limbs", or "by-kind" for a changed grouping; exchanges as text, ``old > new`` with the
        first joint of each exchanged limb; joints in the new order.
    """
    yielded = {stated_joints}
    for size, count in Counter(len(limb) for limb in limbs).items():
        equal_limbs = [limb for limb in limbs if len(limb) == size]
        for order in _list_limb_orders(count):
            joints = list(stated_joints)
            for limb, source_limb in zip(equal_limbs, order, strict=True):
                for place, from_place in zip(limb, equal_limbs[source_limb], strict=True):
                    joints[place] = stated_joints[from_place]
            pairs = [(stated_joints[limb[0]], joints[limb[0]]) for limb in equal_limbs]
            detail = ", ".join(f"{old} > {new}" for old, new in pairs if old != new)
            by_kind = _group_by_kind(joints, equal_limbs)
            for change, permuted in (("limbs", tuple(joints)), ("by-kind", by_kind)):
                if permuted not in yielded:
                    yielded.add(permuted)
                    yield change, detail, permuted


def _list_limb_orders(count: int) -> Iterator[tuple[int, ...]]:
    """Yield all orders of up to `_MAX_PERMUTED_LIMBS` limbs; of more, exchanges of two limbs."""
    if count <= _MAX_PERMUTED_LIMBS:
        yield from permutations(range(count))
        return
    for first in range(count):
        for second in range(first):
            order = list(range(count))
            order[first], order[second] = second, first
            yield tuple(order)


def _group_by_kind(joints: Sequence[str], limbs: Sequence[Sequence[int]]) -> tuple[str, ...]:
    """Return the joints in the other grouping: by kind if currently by limb, otherwise by limb.

    By kind, the first joints of all limbs come first, then the second joints, and so on.
    """
    places = sorted(place for limb in limbs for place in limb)
    grouped = [place for limb in limbs for place in limb]
    if grouped == places:  # by limb
        grouped = [place for kind in zip(*limbs, strict=True) for place in kind]
    ordered = list(joints)
    for place, from_place in zip(places, grouped, strict=True):
        ordered[place] = joints[from_place]
    return tuple(ordered)


def _evaluate_interpretation(
    robot: Robot,
    policy: Policy,
    commands: Array,
    seconds: float,
    change: ContractChange,
    workers: int | None,
) -> Candidate:
    """Simulate an interpretation of a policy with all commands, and return the result.

    ``commands`` have the shape (n, 3) [m/s, m/s, rad/s]; ``change`` is the difference from the
    stated contract.
    """
    stage = prepare_stage(robot, policy)
    cases = [stage.make_case(command) for command in commands]
    tracked = fallen = 0
    squares, errors = [], []
    for run in simulate_cases(stage, cases, seconds, WARM_UP_SECONDS, workers):
        tracking, command = evaluate_tracking(stage, run, WARM_UP_SECONDS), run.case.command
        tracked += tracking.tracks
        fallen += run.fallen
        squares.append(np.nan_to_num(joint_torques(stage, run)) ** 2)
        difference = np.array([*(tracking.velocity - command[:2]), tracking.turning - command[2]])
        magnitude = max(float(np.linalg.norm(command)), SPEED_ATOL)  # a stand is commanded 0
        errors.append(1.0 if run.fallen else float(np.linalg.norm(difference)) / magnitude)
    torque = float(np.sqrt(np.mean([square.mean() for square in squares])))
    error = float(np.mean(errors))
    kind, detail, flipped = change
    return Candidate(
        change=kind,
        detail=detail,
        joints=policy.contract.joints,
        flipped=flipped,
        tracked=tracked,
        fallen=fallen,
        torque=torque,
        error=error,
        cost=torque * (1 + error),
    )
