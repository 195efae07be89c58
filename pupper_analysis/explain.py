"""Which numbers make two models disagree: each difference, its effect, and that none is missing."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields, replace

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis import parameters
from pupper_analysis.configuration import Configuration
from pupper_analysis.convention import PinocchioConvention
from pupper_analysis.conversion import pinocchio_from_mujoco
from pupper_analysis.crosscheck import States, random_states
from pupper_analysis.errors import ConfigurationError
from pupper_analysis.parameters import Body, Joint, Parameters
from pupper_analysis.results import Result
from pupper_analysis.robot import Robot

Array = NDArray[np.float64]

_MAIN = ("mass matrix", "gravity", "foot positions", "joint positions")

EXPLAINED = 1e-9
"""What may be left, relative to a quantity's scale, when all differences are taken away."""


@dataclass(frozen=True)
class Tolerances:
    """How far two files may differ in each kind of number.

    The defaults pass files written with 5 to 6 digits.

    Attributes:
        mass: Relative.
        com: Of the com's position (m).
        inertia: Relative to the tensor's largest element.
        position: Of a joint's or frame's position (m).
        rotation: Angle between the placements of a joint (rad).
        axis: Angle between a joint's axes (rad).
        limit: Of a joint limit (rad).
        effort: Relative.
        velocity: Relative.
        damping: Relative.
        friction: Relative.
        dynamics: Of the quantities of the cross-check, relative to their scale.
    """

    mass: float = 1e-4
    com: float = 1e-5
    inertia: float = 1e-3
    position: float = 1e-5
    rotation: float = 1e-4
    axis: float = 1e-4
    limit: float = 1e-3
    effort: float = 1e-3
    velocity: float = 1e-3
    damping: float = 1e-3
    friction: float = 1e-3
    dynamics: float = 1e-3

    def __post_init__(self) -> None:
        for kind in fields(self):
            value = getattr(self, kind.name)
            if not value > 0:
                raise ConfigurationError("tolerance", f"{kind.name}={value} is not positive")

    @staticmethod
    def strict() -> Tolerances:
        """Returns tolerances that pass rounding errors of floating-point numbers alone."""
        return Tolerances(**{kind.name: 1e-9 for kind in fields(Tolerances)})

    def changed(self, changes: Mapping[str, float]) -> Tolerances:
        """Returns these tolerances with some changed.

        Raises:
            ConfigurationError: If a kind is unknown (lists the valid ones) or not positive.
        """
        valid = [kind.name for kind in fields(self)]
        for kind in changes:
            if kind not in valid:
                raise ConfigurationError(
                    "tolerance", f"no kind {kind!r}; valid: {', '.join(valid)}"
                )
        return replace(self, **changes)


@dataclass(frozen=True)
class Effect(Result):
    """What one difference does to one quantity.

    Attributes:
        deviation: The worst absolute deviation that it causes alone.
        relative: Relative to the quantity's scale.
        share: Relative to the deviation that all differences cause together; may exceed 1 where
            differences cancel.
    """

    deviation: float
    relative: float
    share: float


@dataclass(frozen=True, eq=False)
class Difference(Result):
    """One number, or vector, in which the two files differ.

    Attributes:
        kind: ``mass``, ``com``, ``inertia``, ``position``, ``rotation``, ``axis``, ``lower limit``,
            ``upper limit``, ``effort``, ``velocity``, ``damping``, ``friction``, ``frame``,
            ``parent``, ``type``, or ``armature`` (which a URDF cannot state: then it differs from
            that of the joints at the same place of other legs).
        element: The joint, the body (named by the joint that moves it, or the base) or the frame.
        urdf: The URDF's value, in the URDF's frames.
        mjcf: The MJCF's, in the URDF's frames.
        unit: Of both.
        message: The difference in plain words.
        effects: {quantity: what it does}.
        urdf_place: File and line, where known.
        mjcf_place: File and line, where known.
    """

    kind: str
    element: str
    urdf: object
    mjcf: object
    unit: str
    message: str
    effects: dict[str, Effect]
    urdf_place: str | None = None
    mjcf_place: str | None = None

    @property
    def weight(self) -> tuple[float, float]:
        """What differences are sorted by.

        The greatest relative effect on mass matrix, gravity and positions; then on any quantity.
        Both are 0 for what the dynamics do not feel.
        """
        main = [self.effects[name].relative for name in _MAIN if name in self.effects]
        every = [effect.relative for effect in self.effects.values()]
        return max(main, default=0.0), max(every, default=0.0)


@dataclass(frozen=True, eq=False)
class Armature(Result):
    """The rotors' inertia, which an MJCF states and a URDF cannot.

    Attributes:
        values: {joint: kg m^2}.
        effects: {quantity: what leaving it out of the URDF's model does}.
    """

    values: dict[str, float]
    effects: dict[str, Effect]


@dataclass(frozen=True, eq=False)
class Explanation(Result):
    """Why two models disagree.

    Attributes:
        differences: Sorted by effect, the greatest first.
        deviations: {quantity: relative deviation between the two models}.
        left: {quantity: relative deviation that is left when the URDF's model is given the MJCF's
            value for every difference}.
        complete: Whether nothing is left.
        armature: What the armature does; both models were given the MJCF's.
    """

    differences: tuple[Difference, ...]
    deviations: dict[str, float]
    left: dict[str, float]
    complete: bool
    armature: Armature


# ------------------------------------------------------------------------------------- explanation


def explain(robot: Robot, *, tolerances: Tolerances | None = None) -> Explanation:
    """Finds every number in which a robot's URDF and MJCF differ, and proves that none is missing.

    The parameters of both models are compared body by body. Each difference is put into the URDF's
    model alone, to see its effect; then all are, and the result must behave as the MJCF's model.

    Args:
        robot: The robot.
        tolerances: What counts as a difference; for files of 5 to 6 digits by default.
    """
    tolerances = tolerances or Tolerances()
    description = robot.description
    frames = {**description.feet, **description.frames}
    first = parameters.from_pinocchio(
        robot.pin_model,
        robot.base,
        robot.joint_names,
        {name: pair[0] for name, pair in frames.items()},
    )
    in_pinocchio = pinocchio_from_mujoco(robot.mj_model)
    raw = parameters.from_pinocchio(
        in_pinocchio,
        robot.base,
        robot.joint_names,
        {name: pair[1] for name, pair in frames.items()},
    )

    def count(one: Parameters, two: Parameters, name: str) -> int:
        carried = {frame for frame, (owner, _) in one.frames.items() if owner == name}
        concerned = {name, *one.children(name), *carried}
        return sum(1 for change in _changes(one, two, tolerances) if change.element in concerned)

    second = parameters.aligned(raw, first, count)
    changes = list(_changes(first, second, tolerances))
    states = random_states(robot, 10, seed=0)
    urdf = _behaviour(robot, first, states)
    mjcf = _behaviour(robot, raw, states)
    scale = {name: max(float(np.abs(values).max()), 1e-300) for name, values in urdf.items()}
    total = {name: float(np.abs(mjcf[name] - urdf[name]).max()) for name in urdf}
    differences = []
    for change in changes:
        effects = {}
        if change.felt:
            alone = _behaviour(robot, change.apply(first, second), states)
            effects = _effects(urdf, alone, scale, total)
        differences.append(change.difference(effects))
    for name, usual in _unusual_armatures(first).items():
        joint = replace(first.joints[name], armature=usual)
        alone = _behaviour(robot, replace(first, joints={**first.joints, name: joint}), states)
        value = first.joints[name].armature
        unit = "kg" if joint.slides else "kg m^2"
        message = (
            f"joint {name}: armature {value:.6g} {unit} in the MJCF, but {usual:.6g} {unit} on the "
            "joints at the same place of the other legs (a URDF cannot state it)"
        )
        effects = _effects(urdf, alone, scale, total)
        differences.append(Difference("armature", name, None, value, unit, message, effects))
    everything = first
    # What is within the tolerance is taken over as well, so that only what was overlooked is left.
    for change in _changes(first, second, _NOTHING):
        everything = change.apply(everything, second)
    patched = _behaviour(robot, everything, states)
    left = {name: float(np.abs(patched[name] - mjcf[name]).max()) / scale[name] for name in patched}
    differences.sort(key=lambda item: (-item.weight[0], -item.weight[1], _ORDER.index(item.kind)))
    return Explanation(
        differences=tuple(differences),
        deviations={name: total[name] / scale[name] for name in total},
        left=left,
        complete=all(value <= EXPLAINED for value in left.values()),
        armature=_armature(robot, first, states, urdf, scale, total),
    )


def _unusual_armatures(values: Parameters) -> dict[str, float]:
    """Returns the joints whose armature differs from that of most at the same place of a leg.

    Joints are at the same place if as many joints are above as below them.

    Returns:
        {joint: the usual armature there}.
    """
    places: dict[tuple[int, int], list[str]] = {}
    depth = {values.base: 0}
    below = dict.fromkeys(values.joints, 0)
    for name, joint in values.joints.items():
        depth[name] = depth[joint.parent] + 1
        ancestor = joint.parent
        while ancestor != values.base:
            below[ancestor] += 1
            ancestor = values.joints[ancestor].parent
    for name in values.joints:
        places.setdefault((depth[name], below[name]), []).append(name)
    unusual: dict[str, float] = {}
    for names in places.values():
        found = Counter(values.joints[name].armature for name in names)
        usual, count = found.most_common(1)[0]
        if 2 * count > len(names) >= 3:
            unusual |= {n: usual for n in names if values.joints[n].armature != usual}
    return unusual


def _effects(
    before: Mapping[str, Array],
    after: Mapping[str, Array],
    scale: Mapping[str, float],
    total: Mapping[str, float],
) -> dict[str, Effect]:
    effects = {}
    for name, values in after.items():
        deviation = float(np.abs(values - before[name]).max())
        if deviation > 1e-12 * scale[name]:
            share = deviation / total[name] if total[name] > 0 else math.inf
            effects[name] = Effect(deviation, deviation / scale[name], share)
    return effects


def _armature(
    robot: Robot,
    values: Parameters,
    states: States,
    urdf: Mapping[str, Array],
    scale: Mapping[str, float],
    total: Mapping[str, float],
) -> Armature:
    without = {name: replace(joint, armature=0.0) for name, joint in values.joints.items()}
    bare = _behaviour(robot, replace(values, joints=without), states)
    armature = {name: values.joints[name].armature for name in robot.joint_names}
    return Armature(armature, _effects(urdf, bare, scale, total))


def _behaviour(robot: Robot, values: Parameters, states: States) -> dict[str, Array]:
    """Evaluates the quantities that differences are judged by, at all states."""
    model = parameters.to_pinocchio(values)
    robot = replace(
        robot,
        pin_model=model,
        pin_convention=PinocchioConvention.of(model, robot.joint_names),
        foot_frames={},
    )
    base_rows = robot.nv - robot.nu
    damping = np.full(robot.nv, values.base_damping)
    damping[base_rows:] = [values.joints[name].damping for name in robot.joint_names]
    rows: dict[str, list[Array]] = {}
    for qpos, qvel, torques in zip(states.qpos, states.qvel, states.torques, strict=True):
        config = Configuration(robot, qpos, qvel)
        force = -damping * qvel
        force[base_rows:] += torques
        result = {
            "mass matrix": config.mass_matrix(),
            "gravity": config.gravity(),
            "bias forces": config.bias_forces(),
            "com": config.center_of_mass(),
            "forward dynamics": config.forward_dynamics(force),
            "joint positions": np.array([config.joint_position(n) for n in robot.joint_names]),
        }
        if values.frames:
            positions = [config.frame_position(name) for name in values.frames]
            result["foot positions"] = np.array(positions)
        for name, value in result.items():
            rows.setdefault(name, []).append(value)
    return {name: np.array(values) for name, values in rows.items()}


# ------------------------------------------------------------------------------------- differences


@dataclass(frozen=True, eq=False)
class _Change:
    """A difference between two sets of parameters, and how to take it over."""

    kind: str
    element: str
    urdf: object
    mjcf: object
    unit: str
    message: str
    apply: Callable[[Parameters, Parameters], Parameters]
    felt: bool  # by the dynamics

    def difference(self, effects: dict[str, Effect]) -> Difference:
        return Difference(
            self.kind, self.element, self.urdf, self.mjcf, self.unit, self.message, effects
        )


_ORDER = (
    "type",
    "parent",
    "mass",
    "com",
    "inertia",
    "position",
    "rotation",
    "axis",
    "frame",
    "damping",
    "armature",
    "lower limit",
    "upper limit",
    "effort",
    "velocity",
    "friction",
)

_NOTHING = Tolerances(**{kind.name: 1e-300 for kind in fields(Tolerances)})


def _changes(one: Parameters, two: Parameters, tolerances: Tolerances) -> Iterable[_Change]:
    for name, body in one.bodies.items():
        yield from _body_changes(name, body, two.bodies[name], tolerances)
    for name, joint in one.joints.items():
        yield from _joint_changes(name, joint, two.joints[name], tolerances)
    if abs(two.base_damping - one.base_damping) > tolerances.damping * two.base_damping:
        message = (
            f"free joint of {one.base}: damping {one.base_damping:g} in the URDF, "
            f"{two.base_damping:g} N s/m in the MJCF (a default class reaches it; use <freejoint/>)"
        )
        yield _Change(
            "damping",
            one.base,
            one.base_damping,
            two.base_damping,
            "N s/m",
            message,
            lambda first, second: replace(first, base_damping=second.base_damping),
            felt=True,
        )
    for name, (owner, position) in one.frames.items():
        other_owner, other = two.frames[name]
        apart = float(np.linalg.norm(other - position))
        if owner != other_owner or apart > tolerances.position:
            message = f"frame {name} is {_mm(apart)} apart: {_triple(position, other, 'm')}"
            if owner != other_owner:
                message = (
                    f"frame {name} is on the body of {owner} in the URDF, "
                    f"of {other_owner} in the MJCF"
                )
            yield _Change(
                "frame", name, position, other, "m", message, _take_frame(name), felt=True
            )


def _body_changes(name: str, one: Body, two: Body, tolerances: Tolerances) -> Iterable[_Change]:
    greater = max(abs(one.mass), abs(two.mass))
    if abs(two.mass - one.mass) > tolerances.mass * greater:
        message = f"body of {name}: mass {_pair(one.mass, two.mass, 'kg')}"
        message += _ratio(one.mass, two.mass)
        yield _Change(
            "mass", name, one.mass, two.mass, "kg", message, _take_body(name, "mass"), felt=True
        )
    apart = float(np.linalg.norm(two.com - one.com))
    if apart > tolerances.com:
        message = (
            f"body of {name}: com {_mm(apart)} apart: {_triple(one.com, two.com, 'm')}"
            f"{_mirrored(one.com, two.com, tolerances.com)}"
        )
        yield _Change(
            "com", name, one.com, two.com, "m", message, _take_body(name, "com"), felt=True
        )
    size = max(float(np.abs(one.inertia).max()), float(np.abs(two.inertia).max()))
    if float(np.abs(two.inertia - one.inertia).max()) > tolerances.inertia * size:
        entries = []
        for label, place in _ENTRIES.items():
            a, b = float(one.inertia[place]), float(two.inertia[place])
            if abs(b - a) > tolerances.inertia * size:
                entries.append(f"{label} {_pair(a, b, 'kg m^2')}{_ratio(a, b)}")
        message = f"body of {name}: inertia about the com: {'; '.join(entries)}{_turned(one, two)}"
        yield _Change(
            "inertia",
            name,
            one.inertia,
            two.inertia,
            "kg m^2",
            message,
            _take_body(name, "inertia"),
            felt=True,
        )


_ENTRIES = {
    "ixx": (0, 0),
    "iyy": (1, 1),
    "izz": (2, 2),
    "ixy": (0, 1),
    "ixz": (0, 2),
    "iyz": (1, 2),
}


def _turned(one: Body, two: Body) -> str:
    """Says so if two tensors have the same principal moments."""
    moments = np.linalg.eigvalsh(one.inertia), np.linalg.eigvalsh(two.inertia)
    off = np.abs(one.inertia - np.diag(np.diag(one.inertia))).max()
    if np.allclose(np.diag(one.inertia), np.diag(two.inertia), rtol=1e-3) and off > 0:
        return " (the products of inertia differ, perhaps in sign)"
    if np.allclose(*moments, rtol=1e-3, atol=1e-3 * abs(moments[0]).max()):
        return " (the same principal moments: one of the tensors is in turned axes)"
    return ""


def _joint_changes(name: str, one: Joint, two: Joint, tolerances: Tolerances) -> Iterable[_Change]:
    if one.parent != two.parent:
        message = f"joint {name}: its parent is {one.parent} in the URDF, {two.parent} in the MJCF"
        yield _Change(
            "parent",
            name,
            one.parent,
            two.parent,
            "",
            message,
            _take_joint(name, "parent"),
            felt=True,
        )
    if one.slides != two.slides:
        kinds = ["prismatic" if joint.slides else "revolute" for joint in (one, two)]
        message = f"joint {name}: {kinds[0]} in the URDF, {kinds[1]} in the MJCF"
        yield _Change(
            "type", name, kinds[0], kinds[1], "", message, _take_joint(name, "slides"), felt=True
        )
    apart = float(np.linalg.norm(two.position - one.position))
    if apart > tolerances.position:
        message = (
            f"joint {name}: {_mm(apart)} apart, from its parent's frame: "
            f"{_triple(one.position, two.position, 'm')}"
            f"{_mirrored(one.position, two.position, tolerances.position)}"
        )
        yield _Change(
            "position",
            name,
            one.position,
            two.position,
            "m",
            message,
            _take_joint(name, "position"),
            felt=True,
        )
    turn = pin.log3(one.rotation.T @ two.rotation)
    angle = float(np.linalg.norm(turn))
    if angle > tolerances.rotation:
        about = abs(float(turn @ one.axis)) > (1 - 1e-6) * angle
        message = (
            f"joint {name}: its frame is turned by {math.degrees(angle):.4g} deg about "
            f"{_vector(turn / angle)}"
            + (" (its own axis: the files' zero angles differ)" if about else "")
            + _quaternion_order(one.rotation, two.rotation)
        )
        yield _Change(
            "rotation",
            name,
            one.rotation,
            two.rotation,
            "1",
            message,
            _take_joint(name, "rotation"),
            felt=True,
        )
    between = math.acos(min(1.0, max(-1.0, float(one.axis @ two.axis))))
    if float(np.linalg.norm(np.cross(one.axis, two.axis))) > tolerances.axis or between > 1.0:
        reversed_axis = between > math.pi - tolerances.axis
        how = "reversed" if reversed_axis else f"turned by {math.degrees(between):.4g} deg"
        message = f"joint {name}: axis {how}: {_triple(one.axis, two.axis, '')}"
        yield _Change(
            "axis", name, one.axis, two.axis, "1", message, _take_joint(name, "axis"), felt=True
        )
    for kind, field, unit, tolerance, relative in (
        ("lower limit", "lower", "rad", tolerances.limit, False),
        ("upper limit", "upper", "rad", tolerances.limit, False),
        ("effort", "effort", "N m", tolerances.effort, True),
        ("velocity", "velocity", "rad/s", tolerances.velocity, True),
        ("damping", "damping", "N m s/rad", tolerances.damping, True),
        ("friction", "friction", "N m", tolerances.friction, True),
    ):
        a, b = float(getattr(one, field)), float(getattr(two, field))
        if field == "velocity" and not (math.isfinite(a) and math.isfinite(b)):
            continue  # an MJCF cannot state it
        if a == b or (
            math.isfinite(a)
            and math.isfinite(b)
            and abs(b - a) <= tolerance * (max(abs(a), abs(b)) if relative else 1.0)
        ):
            continue
        unit = unit.replace("N m", "N").replace("rad", "m") if one.slides else unit
        message = f"joint {name}: {kind} {_pair(a, b, unit)}{_degrees(a, b)}"
        yield _Change(
            kind, name, a, b, unit, message, _take_joint(name, field), felt=field == "damping"
        )


def _take_body(name: str, field: str) -> Callable[[Parameters, Parameters], Parameters]:
    def apply(one: Parameters, two: Parameters) -> Parameters:
        body = replace(one.bodies[name], **{field: getattr(two.bodies[name], field)})
        return replace(one, bodies={**one.bodies, name: body})

    return apply


def _take_joint(name: str, field: str) -> Callable[[Parameters, Parameters], Parameters]:
    def apply(one: Parameters, two: Parameters) -> Parameters:
        joint = replace(one.joints[name], **{field: getattr(two.joints[name], field)})
        return replace(one, joints={**one.joints, name: joint})

    return apply


def _take_frame(name: str) -> Callable[[Parameters, Parameters], Parameters]:
    def apply(one: Parameters, two: Parameters) -> Parameters:
        return replace(one, frames={**one.frames, name: two.frames[name]})

    return apply


# ------------------------------------------------------------------------------------- words


def _pair(urdf: float, mjcf: float, unit: str) -> str:
    one, two = (
        f"{value:.6g} {unit}" if math.isfinite(value) else "unlimited" for value in (urdf, mjcf)
    )
    return f"{one} in the URDF, {two} in the MJCF"


def _triple(urdf: Array, mjcf: Array, unit: str) -> str:
    text = f"{_vector(urdf)} {unit} in the URDF, {_vector(mjcf)} {unit} in the MJCF"
    return text.replace("  ", " ")


def _vector(values: Array) -> str:
    return "(" + ", ".join(f"{value + 0.0:.6g}" for value in np.round(values, 9)) + ")"


def _mm(length: float) -> str:
    return f"{1e3 * length:.4g} mm"


def _ratio(urdf: float, mjcf: float) -> str:
    """Gives the difference, and the ratio where it is telling."""
    if urdf == 0 or mjcf == 0:
        return ""
    ratio = mjcf / urdf
    for factor, meaning in ((1e3, "g for kg?"), (1e-3, "g for kg?"), (-1.0, "the other sign")):
        if math.isclose(ratio, factor, rel_tol=1e-3):
            return f" ({meaning})"
    return f" ({100 * (ratio - 1):+.3g} %)"


def _degrees(urdf: float, mjcf: float) -> str:
    if urdf == 0 or not math.isfinite(urdf) or not math.isfinite(mjcf):
        return ""
    ratio = mjcf / urdf
    if any(math.isclose(ratio, math.degrees(1.0) ** sign, rel_tol=1e-2) for sign in (1, -1)):
        return " (degrees for radians?)"
    return ""


def _mirrored(urdf: Array, mjcf: Array, tolerance: float) -> str:
    """Names the coordinate that has the other sign, if that is the whole difference."""
    for index, name in enumerate("xyz"):
        flipped = urdf.copy()
        flipped[index] *= -1
        if np.linalg.norm(flipped - mjcf) <= tolerance:
            return f" ({name} has the other sign)"
    return ""


def _quaternion_order(urdf: Array, mjcf: Array) -> str:
    """Tells whether reading the MJCF's quaternion as (x, y, z, w) would end the difference."""
    x, y, z, w = pin.Quaternion(mjcf).coeffs()
    # The file's four numbers were taken for (w, x, y, z); in another order they are (x, y, z, w).
    quaternion = pin.Quaternion(np.array([w, x, y, z]))
    if np.allclose(quaternion.toRotationMatrix(), urdf, atol=1e-4):
        return " (a quaternion in another order: MJCF has (w, x, y, z)?)"
    return ""
