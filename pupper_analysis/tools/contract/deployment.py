"""Numbers with which a policy runs on a robot, merged from the files of its deployment.

`read_deployment` reads the same files as `contract`. If several files state a number, a deployment
precedes a driver, a policy file and a trainer. Disagreements of severity ERROR between the files
are summarised in a note.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path

from pupper_analysis.base.diagnostics import Diagnostic, Severity, diagnose
from pupper_analysis.base.errors import ModelError
from pupper_analysis.models.places import Place, make_file_error
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.contract.facts import (
    Fact,
    JointSource,
    ObservedTerm,
    Role,
    find_quantity_kind,
)
from pupper_analysis.tools.contract.findings import (
    LIST_CODES,
    find_disagreements,
    find_lost_quantities,
)
from pupper_analysis.tools.contract.orders import PlacedSource, RobotJoints, assign_joints
from pupper_analysis.tools.contract.reading import (
    check_source,
    make_names_distinct,
    read_sources,
    split_arguments,
)

SOURCE_SUFFIXES = (".yaml", ".yml", ".py")
"""Suffixes of files of a deployment or trainer that both `walk` and `contract` read."""

_PRECEDENCE = (Role.DEPLOYMENT, Role.DRIVER, Role.POLICY, Role.TRAINER)
"""Roles of source files in order of precedence. If several files state a number, the number of the
file with the earliest role is used.
"""


@dataclass(frozen=True)
class Deployment:
    """Numbers with which a policy runs on a robot.

    Attributes:
        joints: Joints of the robot in the order of the policy; empty if no file states an order,
            and none is assumed.
        order_place: File of the joint order, with the line if known; empty without.
        is_order_assumed: Whether the joint order of lists is assumed.
        facts: {(quantity, joint): number}; the joint is "" for a setting.
        observations: Terms of an observation, in order; empty if no file states them.
        files: Files that were read.
        notes: Assumptions, and disagreements between the files.
    """

    joints: tuple[str, ...]
    order_place: str
    is_order_assumed: bool
    facts: Mapping[tuple[str, str], Fact]
    observations: tuple[ObservedTerm, ...]
    files: tuple[Path, ...]
    notes: tuple[Diagnostic, ...]

    def get_numbers(self, quantity: str, joints: Sequence[str]) -> list[Fact] | None:
        """Return the numbers (`Fact`) of a quantity for joints, in the order of ``joints``.

        None if a joint lacks the quantity or its value is not a constant number, or if ``joints``
        is empty.
        """
        facts = [self.facts.get((quantity, joint)) for joint in joints]
        known = [fact for fact in facts if fact is not None and fact.value is not None]
        return known if joints and len(known) == len(joints) else None


def read_deployment(
    robot: Robot,
    sources: Sequence[str | Path],
    policy: Path | None = None,
    names: Mapping[str, str] | None = None,
) -> Deployment:
    """Read the files of a deployment, for the joints of a robot.

    Args:
        robot: Robot.
        sources: Files of deployment, drivers and trainer, or ``FILE:NAME``.
        policy: File of the policy, whose metadata may state numbers. Ignored if it cannot be read.
        names: {joint name in a source: joint of the robot} of joints that are not matched.

    Raises:
        ModelError: If a file of ``sources`` cannot be read, states nothing about the robot, or
            contains several configurations, for example.
    """
    requests, folders = split_arguments(sources)
    if folders:
        raise ModelError(folders[0], diagnose("file-is-folder"))
    read, errors = read_sources(requests)
    if errors:
        raise errors[0]
    for source in read:
        if source.role not in _PRECEDENCE:
            raise ModelError(source.path, diagnose("deployment-is-model", robot=robot.name))
        _check_numbers(source)
        peers = [peer.name for peer in read if (peer.path, peer.role) == (source.path, source.role)]
        if len(peers) > 1:
            named = [name.rpartition(":")[2].rpartition("/")[2] for name in peers]
            message = diagnose("contract-several", names=named, file=source.path.name)
            raise ModelError(source.path, message)
    if policy is not None and policy.suffix.lower() in (".onnx", ".json"):
        extra, _ = split_arguments([policy])
        with suppress(ModelError):  # the reader of the network reports why it cannot be read
            read += read_sources(extra)[0]
    read = make_names_distinct(read)
    joints = RobotJoints.from_robot(robot, names)
    placed = [
        assign_joints(source, joints, [s for s in read if s is not source]) for source in read
    ]
    notes = list[Diagnostic]()
    for placed_source in placed:
        if placed_source.source.role is not Role.POLICY:
            robot_source = replace(placed_source.source, name=robot.name, order=joints.order)
            notes += check_source(placed_source, robot_source)
    notes += [note for note in find_lost_quantities(placed, joints) if note not in notes]
    placed.sort(key=lambda placed_source: _PRECEDENCE.index(placed_source.source.role))
    findings = find_disagreements(placed, joints)
    differing = [finding for finding in findings if finding.severity is Severity.ERROR]
    if differing:
        first = differing[0].diagnostic
        notes.append(diagnose("deployment-differs", count=len(differing), first=first))
    facts: dict[tuple[str, str], Fact] = {}
    for placed_source in placed:
        for key, fact in placed_source.facts.items():
            facts.setdefault(key, fact)
    _check_lengths(placed, facts)
    _check_order_is_unique(placed)
    ordered = _find_order_source(placed) or _assume_order(placed, joints)
    stating = (
        placed_source.source.observations
        for placed_source in placed
        if placed_source.source.observations
    )
    return Deployment(
        joints=() if ordered is None else tuple(filter(None, ordered.order)),
        order_place="" if ordered is None else _describe_order_place(ordered),
        is_order_assumed=ordered is not None and ordered.how == "assumed",
        facts=facts,
        observations=next(stating, ()),
        files=tuple(dict.fromkeys(source.path for source in read)),
        notes=tuple(notes),
    )


def _find_order_source(placed: Sequence[PlacedSource]) -> PlacedSource | None:
    """Find the source file that defines the joint order of the policy's arrays; None without.

    A policy file with joint names has precedence; an assumed order comes last.
    """
    ranks = {"named": 0, "motors": 1, "policy": 1, "assumed": 2}
    known = [source for source in placed if source.order]
    return min(
        known,
        key=lambda source: (
            not (source.source.role is Role.POLICY and source.how == "named"),
            ranks[source.how],
        ),
        default=None,
    )


def _assume_order(placed: Sequence[PlacedSource], joints: RobotJoints) -> PlacedSource | None:
    """Assume that the policy's joint order is the order of the trainer's framework.

    Isaac Lab orders joints by depth in the tree; mjlab and Isaac Gym order joints limb by limb.

    Returns:
        A trainer with the assumed order; None without a suitable trainer.
    """
    for source in placed:
        if source.source.role is not Role.TRAINER:
            continue
        order = joints.joints_by_depth if source.source.breadth_first else joints.order
        for quantity in ("kp", "action scale"):
            stated = tuple(joint for joint in order if (quantity, joint) in source.facts)
            if stated:
                return replace(source, order=stated, how="assumed")
    return None


def _describe_order_place(placed_source: PlacedSource) -> str:
    """Return ``file:line`` of a joint order, or the file if no line states the order."""
    place = placed_source.source.order_place
    return str(placed_source.source.path) if place is None else place.path


def _check_lengths(placed: Sequence[PlacedSource], facts: Mapping[tuple[str, str], Fact]) -> None:
    """Raise a ModelError, with the line, if the only list of a compared quantity was not read.

    Such a list has another length than the joint order of the source.
    """
    known = {quantity for quantity, _ in facts}
    for placed_source in placed:
        for quantity, message in placed_source.unread.items():
            if (
                message.code in LIST_CODES
                and quantity not in known
                and find_quantity_kind(quantity).severity is not None
            ):
                raise _make_unread_error(placed_source.source.path, message)


def _check_order_is_unique(placed: Sequence[PlacedSource]) -> None:
    """Raise a ModelError if two deployments list joint names in different orders.

    A deployment with motor indices is compared only with others that have motor indices. A policy
    file with joint names decides the order. Drivers and trainers may have orders of their own.
    """
    named = [source for source in placed if source.how == "named"]
    if any(source.source.role is Role.POLICY for source in named):
        return
    deployments = [source for source in named if source.source.role is Role.DEPLOYMENT]
    for first, second in combinations(deployments, 2):
        has_same_kind = bool(first.source.motors) == bool(second.source.motors)
        if has_same_kind and first.order != second.order:
            message = diagnose("deployments-differ-in-order", other=_describe_order_place(first))
            raise make_file_error(second.source.order_place or Place(second.source.path), message)


def _check_numbers(source: JointSource) -> None:
    """Raise a ModelError, with the line, if a value that `contract` compares is no number.

    Without the error, a policy would run with the number of another file.
    """
    for quantity, message in source.unread.items():
        if find_quantity_kind(quantity).severity is not None:
            raise _make_unread_error(source.path, message)


def _make_unread_error(path: Path, message: Diagnostic) -> ModelError:
    """Make an error, with file and line, of a message about values that were not read."""
    place = Place(path, message.sources[0].line)
    return make_file_error(place, replace(message, values={**message.values, "file": None}))
