"""Disagreements between sources, derived from facts only, independent of the file formats.

Inputs are the facts of all sources, assigned to joints; outputs are `Disagreement` objects, the
most severe first. Numbers agree within a tolerance, or if they are equal after rounding
(`facts_agree`).
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, field, replace
from itertools import product

from pupper_analysis.base.diagnostics import Diagnostic, Quantity, Severity, Term, diagnose
from pupper_analysis.base.results import Result
from pupper_analysis.models.places import Place
from pupper_analysis.models.sides import find_mirror_pairs
from pupper_analysis.robot.matching.tolerances import Tolerances
from pupper_analysis.tools.contract.facts import (
    OBSERVATION_SIZES,
    QUANTITIES,
    Fact,
    JointSource,
    ObservedTerm,
    QuantityKind,
    Role,
    Statement,
    find_quantity_kind,
)
from pupper_analysis.tools.contract.orders import (
    PlacedSource,
    RobotJoints,
    is_mirror_image,
    list_observations,
)

_NUMBER_RTOL = 2e-6
"""Relative difference up to which two numbers count as equal, or a number as the negative of a
second number. The difference may be rounding to single precision, or to seven printed digits. The
quantities in `_KIND_TOLERANCES` have other tolerances.
"""

_KIND_TOLERANCES = {
    kind: getattr(Tolerances(), kind) for kind in ("effort", "velocity", "damping", "friction")
}
"""{quantity: relative tolerance of equal numbers}, as in the comparison of a URDF with an MJCF
(`crosscheck`)."""

_MOTOR_LIMITS = ("effort", "velocity")
"""Limits of motors. An infinite limit counts as not stated."""

_LIMIT_QUANTITIES = ("lower limit", "upper limit")
"""Position limits of joints, which agree within the absolute tolerance of `crosscheck`."""

_MIN_COMPUTED_DECIMALS = 5
"""Smallest number of decimals with which a number counts as computed, not typed: the rounded value
in another source is then no disagreement. Chosen, not tuned.
"""

_MAX_ROUNDING_FRACTION = 0.1
"""Largest relative difference between a computed number and its rounded value in another source,
with which both count as equal. Example: 0.07 for a computed 0.0745. Chosen, not tuned.
"""

_UNIT_FACTORS = {"deg": 180 / math.pi, "rpm": 30 / math.pi, "mm": 1000.0}
"""{unit that a source may use by mistake: number in this unit / number in the SI unit}."""

_UNIT_RTOL = 5e-3
"""Relative tolerance with which the ratio of two sources' numbers must equal a factor in
`_UNIT_FACTORS`, to report a wrong unit as the probable mistake. Chosen, not tuned.
"""


@dataclass(frozen=True, eq=False)
class Disagreement(Result):
    """Difference between two sources, or a contradiction within a source.

    Attributes:
        kind: Quantity, ``order`` or ``observations``; ``unread`` for a source or quantity that was
            not compared.
        probable_mistake: Probable mistake: ``sign``, ``unit``, ``order``, ``mirror``, or "".
        joints: Joints concerned.
        sources: Names of both sources, equal for ``mirror``; the first is the reference. The file
            alone for ``unread``.
        values: Values of the first joint in both sources, for ``mirror`` of both joints; None if
            there is no number. Empty for ``unread``.
        unit: Unit of the values.
        severity: Severity.
        diagnostic: Message without the effects.
        places: ``file:line`` of each value.
        effects: Effects on the robot.
    """

    kind: str
    probable_mistake: str
    joints: tuple[str, ...]
    sources: tuple[str, ...]
    values: tuple[float | None, ...] = field(metadata={"unit": "varies"})
    unit: str
    severity: Severity
    diagnostic: Diagnostic
    places: tuple[str, ...]
    effects: tuple[Diagnostic, ...] = ()

    _reported = ("message",)

    @property
    def message(self) -> str:
        """Message about the disagreement and its effects on the robot, joined by semicolons."""
        return "; ".join(map(str, (self.diagnostic, *self.effects)))


@dataclass(frozen=True, eq=False)
class DefaultPoseStand(Result):
    """Stand of a robot in the default pose of a source.

    Attributes:
        source: Name of the source.
        height: Height of the base above the mean of the feet's lowest points in this pose.
        sag: Loss of base height with the gains of the source; None if not computed.
        utilisation: Largest ratio of motor torque to torque limit. The limits are taken from the
            source if it states all limits, otherwise from another source or the model. None if not
            computed, or without limits.
        stays: Whether the robot keeps standing in simulation with the gains of the source and no
            feed-forward; None if this was not simulated.
        problem: Reason for a missing value; None if there is no error.
    """

    source: str
    height: float = field(metadata={"unit": "m"})
    sag: float | None = field(metadata={"unit": "m"})
    utilisation: float | None = field(metadata={"unit": "1"})
    stays: bool | None
    problem: Diagnostic | None


def find_disagreements(
    placed: Sequence[PlacedSource], model: RobotJoints
) -> tuple[Disagreement, ...]:
    """List the disagreements between sources, and within a source, the worst first.

    Sources are for example a robot model, a motor driver and a policy. A number of a source is
    compared with the first source that states the number, and numbers of left and right joints with
    each other. Some differences are not listed, for example joint damping that represents the kd of
    a servo.

    Args:
        placed: Sources, sorted by precedence: the first that states a number is the reference.
        model: Joints of the robot.
    """
    disagreements = [*_compare_orders(placed), *_compare_motors(placed)]
    disagreements += _compare_observations(placed)
    disagreements += _compare_network_sizes(placed, model)
    quantities = [
        *QUANTITIES,
        *(what for placed_source in placed for what, _ in placed_source.facts),
    ]
    for quantity in dict.fromkeys(quantities):
        kind = find_quantity_kind(quantity)
        if kind.severity is not None:
            joints = ("", *model.order)
            if quantity == "damping":
                servo_joints = {joint for _, joint in _find_servo_damping(placed)}
                joints = tuple(joint for joint in joints if joint not in servo_joints)
            disagreements += _compare_joint_quantity(quantity, kind, placed, joints)
            if kind.mirrored:
                disagreements += _compare_sides(quantity, kind, placed, model)
    disagreements += _find_unlimited_efforts(placed)
    offsets = {finding.joints for finding in disagreements if finding.kind == "default angle"}
    kept = [
        finding
        for finding in disagreements
        if finding.kind != "action offset" or finding.joints not in offsets
    ]
    return tuple(sorted(kept, key=lambda finding: finding.severity.rank))


def _find_servo_damping(placed: Sequence[PlacedSource]) -> list[tuple[PlacedSource, str]]:
    """List the joints of models whose passive damping in the file represents the kd of a servo.

    A source that is no model states the same number as kd.

    Returns:
        (model, joint) pairs.
    """
    return [
        (source, joint)
        for source in placed
        if source.source.role is Role.MODEL
        for (quantity, joint), fact in source.facts.items()
        if quantity == "damping"
        and fact.number > 0
        and ("kd", joint) not in source.facts
        and any(
            facts_agree(fact, replace(kd, quantity="damping"))
            for placed_source in placed
            if placed_source.source.role is not Role.MODEL
            and (kd := placed_source.facts.get(("kd", joint))) is not None
        )
    ]


def note_servo_damping(placed: Sequence[PlacedSource]) -> list[Diagnostic]:
    """Return a note for each model whose joint damping represents the kd of the servos."""
    joints: dict[str, list[str]] = {}
    for source, joint in _find_servo_damping(placed):
        joints.setdefault(source.source.name, []).append(joint)
    return [
        diagnose("contract-damping-is-kd", file=file, joints=tuple(names))
        for file, names in joints.items()
    ]


LIST_CODES = (
    "contract-list-length",
    "contract-motors-length",
    "contract-motors-unread",
    "contract-names-unread",
)
"""Codes of messages about lists that contradict the joint order of their own source, or themselves.
These lists are reported even if no other source states the quantity."""


def find_lost_quantities(placed: Sequence[PlacedSource], model: RobotJoints) -> list[Diagnostic]:
    """List quantities in sources that are lost for the comparison with other sources.

    The reason is, for example, a value that is no number, a list that cannot be assigned to joints,
    or keys that match no joint of the robot.

    Args:
        placed: Sources.
        model: Joints of the robot.

    Returns:
        Messages, each about a quantity in a source.
    """
    lost = list[Diagnostic]()
    for source in placed:
        stated = [
            key
            for placed_source in placed
            if placed_source is not source
            for key, fact in placed_source.facts.items()
            if find_quantity_kind(key[0]).severity is not None and fact.value is not None
        ]
        lost += [
            message
            for quantity, message in source.unread.items()
            if any(key[0] == quantity for key in stated)
            or (message.code in LIST_CODES and find_quantity_kind(quantity).severity is not None)
        ]
        for quantity, keys in source.unplaced.items():
            missing = {
                joint
                for what, joint in stated
                if what == quantity and (quantity, joint) not in source.facts
            }
            if missing and source.source.role is not Role.MODEL:
                message = diagnose(
                    "contract-quantity-lost",
                    file=source.source.name,
                    what=Term(quantity) if quantity in QUANTITIES else quantity,
                    joints=tuple(sorted(missing)),
                    names=keys,
                    sources=source.source.path,
                )
                lost.append(message)
        if source.source.role is not Role.MODEL:
            lost += _find_missing_sides(source, set(stated), model)
    return lost


def find_unmatched_joints(
    placed: Sequence[PlacedSource],
    first: JointSource,
    lost: Sequence[Diagnostic],
    unshared: Mapping[str, Set[str]],
) -> list[Diagnostic]:
    """List the joint names of each source that match no joint of the robot, and missing joints.

    If one name of a source is left, and its quantities lack the number of a single joint of the
    robot, the message contains this joint. The name probably belongs to this joint. Missing joints
    are only reported of models: another source may contain the actuated joints alone.

    Args:
        placed: Sources.
        first: Model that defines the robot's joints.
        lost: Messages of `find_lost_quantities`, whose names are not repeated.
        unshared: {name of a model: joints that other models may lack}.

    Returns:
        Messages about the sources with such names, and about the models that lack joints.
    """
    messages = list[Diagnostic]()
    repeated = set[tuple[str, str]]()
    for message in lost:
        if message.code == "contract-quantity-lost" and isinstance(message.values["names"], tuple):
            repeated |= {
                (str(message.values["file"]), str(name)) for name in message.values["names"]
            }
    for source in placed:
        file = source.source.name
        is_model = source.source.role is Role.MODEL
        ignored = unshared.get(file, ()) if is_model else ()
        names = tuple(
            name for name in source.unknown if (file, name) not in repeated and name not in ignored
        )
        if is_model:
            missing = tuple(
                joint
                for joint in first.order
                if joint not in source.order and joint not in unshared.get(first.name, ())
            )
            if not (len(names) == len(missing) == 1):
                target = first.name if names and missing else ""
                messages += _report_missing_joints(first, source.source, names, target)
                messages += _report_missing_joints(source.source, first, missing, target)
                continue
        if not names:
            continue
        quantities = [quantity for quantity, keys in source.unplaced.items() if names[0] in keys]
        lacking = {
            joint
            for joint in first.order
            if joint not in source.order
            and joint not in unshared.get(first.name, ())
            and all((quantity, joint) not in source.facts for quantity in quantities)
        }
        is_clear = len(names) == 1 and len(lacking) == 1
        messages.append(
            diagnose(
                "contract-names-unknown",
                file=file,
                names=names,
                count=len(names),
                joint=lacking.pop() if is_clear else None,
                sources=source.source.path,
            )
        )
    return messages


def _report_missing_joints(
    lacking: JointSource, having: JointSource, joints: Sequence[str], target: str
) -> Iterator[Diagnostic]:
    """Yield a message if a model lacks ``joints`` of another model.

    If both models lack joints of each other, the joints may only have other names: ``target`` is
    then the name of the model that contains JOINT in ``--map NAME=JOINT``; otherwise "".
    """
    if joints:
        yield diagnose(
            "contract-joints-missing",
            file=lacking.name,
            other=having.name,
            names=tuple(joints),
            count=len(joints),
            target=target or None,
            sources=lacking.path,
        )


def _find_missing_sides(
    source: PlacedSource, stated: Set[tuple[str, str]], model: RobotJoints
) -> Iterator[Diagnostic]:
    """Yield messages for quantities that a source states on one side of the robot only.

    The missing number must be in ``stated``, the (quantity, joint) of all other sources. Nothing is
    reported for many one-sided pairs, because the source may belong to a single arm, or for a
    quantity with other values that were not read.
    """
    pairs = find_mirror_pairs(model.order)
    for quantity in dict.fromkeys(what for what, joint in source.facts if joint):
        missing, complete = list[tuple[str, str]](), 0
        for pair in pairs:
            one_sided = [joint for joint in pair if (quantity, joint) not in source.facts]
            complete += not one_sided
            if len(one_sided) == 1 and (quantity, one_sided[0]) in stated:
                (joint,) = one_sided
                missing.append((joint, pair[1 - pair.index(joint)]))
        reported = quantity in source.unplaced or quantity in source.unread
        if missing and len(missing) < complete and not reported:
            yield diagnose(
                "contract-side-missing",
                file=source.source.name,
                what=Term(quantity) if quantity in QUANTITIES else quantity,
                joints=tuple(joint for joint, _ in missing),
                mirrors=tuple(mirror for _, mirror in missing),
                sources=source.source.path,
            )


def make_unread_finding(message: Diagnostic) -> Disagreement:
    """Return a finding for a source or a quantity that was not compared.

    The severity is error for a source, and warning for a quantity.
    """
    whole = message.code == "contract-unread"
    place = str(message.values["file"] if whole else message.sources[0].file)
    severity = Severity.ERROR if whole else Severity.WARNING
    return Disagreement("unread", "", (), (place,), (), "", severity, message, (place,))


def facts_agree(first: Fact, second: Fact) -> bool:
    """Return True if two stated numbers are equal within a tolerance, or equal after rounding.

    The tolerances of effort, velocity, damping, friction and position limits are the `Tolerances`
    of a comparison of URDF and MJCF. Other quantities have a relative tolerance of 2e-6. Two
    numbers are equal after rounding if one has at least `_MIN_COMPUTED_DECIMALS` decimals, or was
    computed, and the other is its rounded value within `_MAX_ROUNDING_FRACTION`.

    Args:
        first: Number of one source, with its quantity.
        second: Number of another source for the same quantity.
    """
    a, b = first.number, second.number
    if not (math.isfinite(a) and math.isfinite(b)):  # any tolerance of infinity is infinite
        return a == b
    difference = abs(a - b)
    if a == b or difference <= _KIND_TOLERANCES.get(first.quantity, _NUMBER_RTOL) * max(
        abs(a), abs(b)
    ):
        return True
    if first.quantity in _LIMIT_QUANTITIES and difference <= Tolerances().limit:
        return True
    for rounded, computed in ((first, second), (second, first)):
        is_computed = computed.decimals is None or computed.decimals >= _MIN_COMPUTED_DECIMALS
        if rounded.decimals is not None and is_computed:
            step = 0.5 * 10.0**-rounded.decimals * (1 + 1e-9)
            if (
                difference <= min(step, _MAX_ROUNDING_FRACTION * abs(computed.number))
                or difference < 1e-9
            ):
                return True
    return False


def _find_unlimited_efforts(placed: Sequence[PlacedSource]) -> Iterator[Disagreement]:
    """Yield a disagreement for each model that lacks effort limits which another source states.

    MuJoCo simulates motors of unlimited torque for such joints.
    """
    for model in placed:
        limits = dict[str, Fact]()
        for name in model.source.unlimited:
            joint = model.names.get(name, name)
            facts = (
                placed_source.facts.get(("effort", joint))
                for placed_source in placed
                if placed_source is not model
            )
            stated = (fact for fact in facts if fact is not None and fact.value is not None)
            first = next((fact for fact in stated if math.isfinite(fact.number)), None)
            source = next(iter(limits.values()), first)
            if first is not None and source is not None and first.source == source.source:
                limits[name] = first
        if not limits:
            continue
        head, fact = next(iter(limits.items()))
        numbers = [limit.number for limit in limits.values()]
        kind = QUANTITIES["effort"]
        message = diagnose(
            "contract-effort-unlimited",
            joints=tuple(limit.joint for limit in limits.values()),
            low=Quantity(min(numbers), kind.unit),
            high=Quantity(max(numbers), kind.unit) if max(numbers) > min(numbers) else None,
            first=fact.source,
            second=model.source.name,
        )
        yield Disagreement(
            "effort",
            "",
            tuple(limit.joint for limit in limits.values()),
            (fact.source, model.source.name),
            (fact.value, None),
            kind.unit,
            kind.severity or Severity.NOTE,
            message,
            (fact.place, str(model.source.unlimited[head])),
        )


FactPair = tuple[Fact, Fact]
"""Numbers (`Fact`) of two sources, or of two joints, for the same quantity. Of two sources, the
first is the reference."""


def _compare_joint_quantity(
    quantity: str, kind: QuantityKind, placed: Sequence[PlacedSource], joints: tuple[str, ...]
) -> Iterator[Disagreement]:
    """Yield the disagreements of the sources about a quantity of joints, such as gains.

    The joint "" stands for a setting.
    """
    pairs: dict[tuple[Role, Role, str, str], dict[str, FactPair]] = {}
    for joint in joints:
        stated = (
            (placed_source.source, placed_source.facts.get((quantity, joint)))
            for placed_source in placed
        )
        stating = [(source, fact) for source, fact in stated if fact and fact.value is not None]
        for source, fact in stating[1:]:
            (first_source, first_fact), role = stating[0], source.role
            first = first_source.role
            # Several policies of one deployment need not agree.
            if role is first is Role.DEPLOYMENT and source.path == first_source.path:
                continue
            # An infinite limit of a motor is no limit.
            is_stated = quantity not in _MOTOR_LIMITS or math.isfinite(
                max(first_fact.number, fact.number)
            )
            if is_stated and not facts_agree(first_fact, fact):
                key = (first, role, first_fact.source, fact.source)
                pairs.setdefault(key, {})[joint] = (first_fact, fact)
    for (first, second, *_), differing in pairs.items():
        # A source may restrict the range of the model on purpose.
        is_range_difference = (
            (first, second).count(Role.MODEL) == 1
            and quantity in _LIMIT_QUANTITIES
            and not any(
                _has_empty_range(placed, fact) for pair in differing.values() for fact in pair
            )
        )
        yield from _group_by_values(quantity, kind, differing, is_range_difference)


def _has_empty_range(placed: Sequence[PlacedSource], limit: Fact) -> bool:
    """Return True if the source of a joint limit states a lower limit above the upper limit."""
    facts = next(item.facts for item in placed if item.source.name == limit.source)
    low, high = (facts.get((quantity, limit.joint)) for quantity in _LIMIT_QUANTITIES)
    return low is not None and high is not None and low.number > high.number


def _format_first_number(number: float, unit: str) -> str:
    """Format the first of two numbers [``unit``]; without the unit, unless it is an angle."""
    return format(Quantity(number, unit), "stated:.5g" if "rad" in unit.split() else ":.5g")


def _group_by_values(
    quantity: str, kind: QuantityKind, differing: dict[str, FactPair], is_range_difference: bool
) -> Iterator[Disagreement]:
    """Yield the disagreements about a quantity between two sources, grouped by the numbers.

    ``differing`` is {joint: differing facts}. With ``is_range_difference``, one source is a model,
    whose range a configuration may narrow on purpose.
    """
    joints = list(differing)
    first_fact, second_fact = differing[joints[0]]
    swapped = _find_exchange(differing)
    if swapped:
        pairs = tuple(f"{joint} ↔ {whose}" for joint, whose in swapped.items() if joint < whose)
        message = diagnose(
            "contract-exchanged",
            what=Term(quantity),
            joints=tuple(joints),
            pairs=pairs or tuple(f"{a} → {b}" for a, b in swapped.items()),
            file=second_fact.source,
            other=first_fact.source,
        )
        yield _make_disagreement(
            quantity, message, (first_fact, second_fact), kind, joints=joints, mistake="order"
        )
        return
    groups: dict[tuple[float, float], list[str]] = {}
    for joint, (first_fact, second_fact) in differing.items():
        signs = (1 if first_fact.number >= 0 else -1) if quantity in _ANGLE_QUANTITIES else 1
        pair = (round(signs * first_fact.number, 9), round(signs * second_fact.number, 9))
        groups.setdefault(pair, []).append(joint)
    for numbers, members in groups.items():
        facts = differing[members[0]]
        yield _compare_numbers(quantity, kind, facts, numbers, members, is_range_difference)


def _compare_numbers(
    quantity: str,
    kind: QuantityKind,
    facts: FactPair,
    numbers: tuple[float, float],
    members: list[str],
    is_range_difference: bool,
) -> Disagreement:
    """Create the disagreement about a quantity of joints that all have the same two numbers.

    ``facts`` belong to the first joint of ``members``. ``numbers`` are both values, rounded; if the
    first angle is negative, both have the opposite sign. For ``is_range_difference`` see
    `_group_by_values`.
    """
    (first_fact, second_fact), (a, b), head = facts, numbers, members[0]
    lower = -1 if quantity == "lower limit" else 1
    mistake, unit = _classify_mistake(quantity, a, b)
    meant = is_range_difference and lower * a <= lower * b + 1e-6
    near = quantity in _MOTOR_LIMITS and abs(b - a) <= _NEAR_LIMIT_RTOL * max(abs(a), abs(b))
    what = Term(quantity) if quantity in QUANTITIES else quantity
    names = (first_fact.source, second_fact.source)
    short_names = [name.partition(":")[0] for name in names]
    if short_names[0] == short_names[1]:  # two configurations in a file
        short_names = list(names)
    message = diagnose(
        "contract-differs",
        subject=("joint", head) if head else None,
        what=what,
        others=tuple(members[1:]),
        more=len(members) - 1 or None,
        one=Quantity(first_fact.number, kind.unit),
        two=Quantity(second_fact.number, kind.unit),
        shown=_format_first_number(first_fact.number, kind.unit),
        first=first_fact.source,
        second=second_fact.source,
        joint=head or None,
        short_first=short_names[0],
        short_second=short_names[1],
        sign=mistake == "sign" or None,
        unit=unit or None,
    )
    return _make_disagreement(
        quantity,
        message,
        (first_fact, second_fact),
        kind._replace(severity=None) if meant or near else kind,
        joints=members,
        mistake=mistake,
        effects=_describe_effects(quantity, (first_fact.source, second_fact.source), a, b),
    )


_NEAR_LIMIT_RTOL = 0.02
"""Largest relative difference of efforts or velocity limits with which a disagreement has the
severity NOTE, since data sheets round these numbers. Chosen, not tuned.
"""

_ANGLE_QUANTITIES = ("default angle", "action offset")
"""Quantities that are joint angles. Numbers that differ only in the sign, as of left and right
joints, are reported together.
"""


def _find_exchange(differing: dict[str, FactPair]) -> dict[str, str]:
    """Match joints whose numbers the second source has exchanged, as with a wrong joint order.

    Returns:
        {joint a: joint b}: the second source states for joint a the number that the first source
        states for joint b. Empty if an exchange does not explain the differences.
    """
    a, b = (
        Counter(round(mutual[side].number, 6) for mutual in differing.values()) for side in (0, 1)
    )
    # If each number is the negative of the other source's, signs are exchanged, not joints.
    opposite = all(
        abs(first_fact.number + second_fact.number) < 1e-9
        for first_fact, second_fact in differing.values()
    )
    half = len(differing) / 2
    if half < 1 or a != b or any(count > half for count in a.values()) or opposite:
        return {}
    candidates, exchanged = list(differing), {}
    for joint, (first_fact, second_fact) in differing.items():
        matching = [
            joint_name
            for joint_name in candidates
            if joint_name != joint and facts_agree(differing[joint_name][0], second_fact)
        ]
        # Pairs that exchanged values with each other come first.
        mutual = [
            joint_name
            for joint_name in matching
            if facts_agree(differing[joint_name][1], first_fact)
        ]
        if not matching:
            return {}
        exchanged[joint] = (mutual or matching)[0]
        candidates.remove(exchanged[joint])
    return exchanged


def _classify_mistake(quantity: str, a: float, b: float) -> tuple[str, str]:
    """Find the probable mistake that explains two different numbers: sign or unit.

    Returns:
        "sign", "unit" or ""; and for "unit" the wrong unit, such as "deg", otherwise "".
    """
    if a and abs(a + b) <= _NUMBER_RTOL * abs(a):
        return "sign", ""
    ratios = (b / a, a / b) if a and b else ()
    for unit, size in _UNIT_FACTORS.items():
        near = any(abs(ratio / size - 1) < _UNIT_RTOL for ratio in ratios)
        if near and (unit != "mm" or quantity == "action scale"):
            return "unit", unit
    return "", ""


def _describe_effects(
    quantity: str, sources: tuple[str, str], a: float, b: float
) -> tuple[Diagnostic, ...]:
    """Return messages on the effects of a difference on the robot, such as a weaker servo.

    The effects follow from the numbers ``a`` and ``b`` of both ``sources`` alone; may be empty.
    """
    if quantity in _ANGLE_QUANTITIES:
        return (diagnose("contract-effect-angle", angle=Quantity(abs(b - a), "rad")),)
    if not (a and b and math.isfinite(a * b)):
        return ()
    share = Quantity(b / a, "1")
    if quantity == "action scale":
        return (diagnose("contract-effect-scale", share=share),)
    if quantity == "kp" and b > 0:
        return (diagnose("contract-effect-kp", share=Quantity(a / b, "1")),)
    if quantity in ("kd", "effort", "velocity"):
        what = Term("damping" if quantity == "kd" else quantity)
        first, second = sources
        return (
            diagnose("contract-effect-share", share=share, what=what, first=first, second=second),
        )
    return ()


def _make_disagreement(
    kind_name: str,
    message: Diagnostic,
    sides: FactPair,
    kind: QuantityKind,
    *,
    joints: Iterable[str] = (),
    mistake: str = "",
    effects: tuple[Diagnostic, ...] = (),
) -> Disagreement:
    """Create a disagreement with the names, values and places of two facts.

    ``sides`` are the facts of both sources (or of both joints, within a source); ``mistake`` is the
    probable mistake: ``sign``, ``unit``, ``order``, ``mirror``, or "".
    """
    names, values, places = zip(
        *((fact.source, fact.value, fact.place) for fact in sides), strict=True
    )
    return Disagreement(
        kind_name,
        mistake,
        tuple(filter(None, joints)),
        names,
        values,
        kind.unit,
        kind.severity or Severity.NOTE,
        message,
        places,
        effects,
    )


def _compare_sides(
    quantity: str, kind: QuantityKind, placed: Sequence[PlacedSource], model: RobotJoints
) -> Iterator[Disagreement]:
    """Yield a disagreement for each left-right pair of joints whose numbers are not symmetric.

    Numbers of the same source are compared. Pairs of which the file states neither number are
    skipped.
    """
    for source, pair in product(placed, find_mirror_pairs(model.order)):
        facts = [source.facts.get((quantity, joint_name)) for joint_name in pair]
        first, second = (None if fact is None or fact.value is None else fact for fact in facts)
        if first is None or second is None or (first.implied and second.implied):
            continue
        sign = model.mirrored_sign(*pair) if kind.mirrored < 0 else 1
        if not is_mirror_image(first.value, second.value, sign):
            message = diagnose(
                "contract-mirror",
                subject=("joint", pair[0]),
                what=Term(quantity),
                mirror=pair[1],
                one=Quantity(first.number, kind.unit),
                two=Quantity(second.number, kind.unit),
                file=first.source,
                wanted=Quantity(sign * first.number, kind.unit),
            )
            yield _make_disagreement(
                quantity,
                message,
                (first, second),
                kind._replace(severity=Severity.WARNING),
                joints=pair,
                mistake="mirror",
            )


def _compare_orders(placed: Sequence[PlacedSource]) -> Iterator[Disagreement]:
    """Yield disagreements for sources with another joint order than the first source.

    The joint order is that of the policy's arrays. If both sources map joints to motors, each may
    use any order. Sources with other joints are skipped.
    """
    feeding = [
        placed_source
        for placed_source in placed
        if placed_source.source.role is not Role.MODEL
        and placed_source.order
        and placed_source.how != "assumed"
        and (placed_source.facts or placed_source.source.motors)
    ]
    for first, second in ((feeding[0], source) for source in feeding[1:]):
        moved_joints = {
            joint: f"{first.order.index(joint)} → {second.order.index(joint)} ({joint})"
            for joint, second_joint in zip(first.order, second.order, strict=False)
            if joint != second_joint and joint in second.order
        }
        mapped = first.source.motors and second.source.motors
        if moved_joints and not mapped and set(first.order) == set(second.order):
            message = diagnose(
                "contract-order",
                first=first.source.name,
                second=second.source.name,
                count=len(moved_joints),
                moved=tuple(moved_joints.values())[:6],
                more=max(0, len(moved_joints) - 6) or None,
            )
            sides = [
                source.make_fact(Statement("order", None, source.order_place or Place(source.path)))
                for source in (first.source, second.source)
            ]
            yield _make_disagreement(
                "order",
                message,
                (sides[0], sides[1]),
                _LIST_KIND,
                joints=moved_joints,
                mistake="order",
            )


def _compare_motors(placed: Sequence[PlacedSource]) -> Iterator[Disagreement]:
    """Yield a disagreement for each source that assigns joints to other motors than the first.

    Only sources that name the joint of each motor are compared. The joints are sorted by motor
    number, since numbers may start at 1, or belong to several buses.
    """
    mapping = [
        (source.source, dict(zip(source.order, source.source.motors, strict=False)))
        for source in placed
        if source.how == "named" and source.source.motors
    ]
    for (first, numbers), (second, other_numbers) in (
        (mapping[0], source_mapping) for source_mapping in mapping[1:]
    ):
        shared = (numbers.keys() & other_numbers.keys()) - {""}  # names without match
        pairs = zip(
            sorted(shared, key=numbers.__getitem__),
            sorted(shared, key=other_numbers.__getitem__),
            strict=True,
        )
        moved = sorted(
            (first_joint for first_joint, second_joint in pairs if first_joint != second_joint),
            key=numbers.__getitem__,
        )
        if not moved:
            continue
        texts = [f"{numbers[joint]} → {other_numbers[joint]} ({joint})" for joint in moved]
        message = diagnose(
            "contract-motors-differ",
            first=first.name,
            second=second.name,
            count=len(moved),
            moved=tuple(texts[:6]),
            more=max(0, len(texts) - 6) or None,
        )
        sides = [
            source.make_fact(Statement("order", None, source.order_place or Place(source.path)))
            for source in (first, second)
        ]
        yield _make_disagreement(
            "order", message, (sides[0], sides[1]), _LIST_KIND, joints=moved, mistake="order"
        )


def _compare_observations(placed: Sequence[PlacedSource]) -> Iterator[Disagreement]:
    """Yield a disagreement for each source that lists observation terms in another order.

    The order of the terms that both sources list is compared.
    """
    stating = [
        placed_source.source for placed_source in placed if placed_source.source.observations
    ]
    for first, second in ((stating[0], source) for source in stating[1:]):
        first_terms, second_terms = list_observations(first), list_observations(second)
        first_common = tuple(name for name in first_terms if name in second_terms)
        second_common = tuple(name for name in second_terms if name in first_terms)
        if first_common != second_common:
            message = diagnose(
                "contract-observed-order",
                one=first_common,
                two=second_common,
                first=first.name,
                second=second.name,
            )
            sides = [
                source.make_fact(Statement("observations", None, source.observations[0].place))
                for source in (first, second)
            ]
            yield _make_disagreement(
                "observations", message, (sides[0], sides[1]), _LIST_KIND, mistake="order"
            )


def _compare_network_sizes(
    placed: Sequence[PlacedSource], model: RobotJoints
) -> Iterator[Disagreement]:
    """Yield a disagreement for each policy with a wrong number of actions or inputs.

    The number of actions must equal the number of joints in the policy's order; a smaller number is
    a warning. Without an order, it must not exceed the number of moving joints. The number of
    inputs must equal the number of observed values in the same file, times a history that the file
    does not state.
    """
    for placed_source in placed:
        source, fact = placed_source.source, placed_source.facts.get(("actions", ""))
        stated = len(source.order) or len(source.motors)
        joints = stated or len(model.order)
        actions = joints if fact is None or fact.value is None else int(fact.number)
        if fact is not None and (actions > joints or (stated and actions < joints)):
            place = (stated and source.order_place) or Place(source.path)
            reference = source.make_fact(Statement("actions", float(joints), place))
            message = diagnose(
                "contract-actions-joints",
                file=source.name,
                actions=actions,
                joints=joints,
                stated=bool(stated),
            )
            # The order may contain joints without an actuator.
            kind = _LIST_KIND if actions > joints else _FEWER_ACTIONS_KIND
            yield _make_disagreement("actions", message, (reference, fact), kind)
            continue
        inputs = placed_source.facts.get(("observed numbers", ""))
        if inputs is None or inputs.value is None or not source.observations:
            continue
        known, unknown = _count_observed_values(source.observations, joints, actions)
        if _is_number_of_inputs_possible(int(inputs.number), source.observations, known, unknown):
            continue
        place = source.observations[0].place
        reference = source.make_fact(Statement("observed numbers", float(known), place))
        message = diagnose(
            "contract-inputs-observations",
            file=source.name,
            inputs=int(inputs.number),
            values=known,
            unknown=unknown,
        )
        yield _make_disagreement("observed numbers", message, (reference, inputs), _LIST_KIND)


def _count_observed_values(
    terms: Sequence[ObservedTerm], joints: int, actions: int
) -> tuple[int, tuple[str, ...]]:
    """Count the elements of a policy's observation terms, with their stated history.

    Returns:
        Number of elements of the terms of known size; names of the other terms, such as commands.
    """
    known, unknown = 0, list[str]()
    for term in terms:
        size = OBSERVATION_SIZES.get(term.common_name)
        if isinstance(size, str):
            size = {"joints": joints, "actions": actions}[size]
        if size is None and term.scales is not None and len(term.scales) > 1:
            size = len(term.scales)
        if size is None:
            unknown.append(term.name)
        else:
            known += size * max(term.history, 1)
    return known, tuple(unknown)


def _is_number_of_inputs_possible(
    inputs: int, terms: Sequence[ObservedTerm], known: int, unknown: Sequence[str]
) -> bool:
    """Return True if a network with ``inputs`` elements can read the observation terms.

    ``known`` is the number of elements of the terms of known size; each of the other terms,
    ``unknown``, has at least one element. If no term states a history, ``inputs`` may be a multiple
    of ``known``.
    """
    if unknown:
        return inputs >= known + len(unknown)
    if any(term.history for term in terms):
        return inputs == known
    # The history may be stated elsewhere.
    return inputs > 0 and known > 0 and inputs % known == 0


_LIST_KIND = QuantityKind("", Severity.ERROR, 0, is_setting=True)
"""Properties of a disagreement about the order or the number of joints, actions or observations:
without unit, with the severity ERROR, and without a comparison of left and right joints."""


_FEWER_ACTIONS_KIND = _LIST_KIND._replace(severity=Severity.WARNING)
"""Properties of a disagreement about a policy with fewer actions than joints."""


def add_height_effects(
    findings: tuple[Disagreement, ...], poses: tuple[DefaultPoseStand, ...]
) -> tuple[Disagreement, ...]:
    """Add the resulting difference of base heights to disagreements about default angles.

    The effect of different default joint angles is the difference between the base heights [m] in
    the two default poses.

    Args:
        findings: Disagreements between sources.
        poses: Default poses of the sources.
    """
    heights = {pose.source: pose.height for pose in poses}
    done = []
    for finding in findings:
        both = {heights[name] for name in finding.sources if name in heights}
        if finding.kind == "default angle" and len(both) == 2:
            apart = Quantity(max(both) - min(both), "m")
            message = diagnose("contract-effect-height", height=apart)
            finding = replace(finding, effects=(*finding.effects, message))
        done.append(finding)
    return tuple(done)
