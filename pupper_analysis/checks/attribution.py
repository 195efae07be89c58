"""Which numbers make two models disagree: each difference, its effect, and that none is missing."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, fields, replace
from functools import partial

import mujoco
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.checks.engines import States, random_states
from pupper_analysis.checks.passive import (
    Extra,
    Mimics,
    Reference,
    as_it_is,
    extras,
    split_mimics,
    without,
)
from pupper_analysis.errors import ConfigurationError
from pupper_analysis.models import parameters
from pupper_analysis.models.conversion import joint_damping, pinocchio_from_mujoco
from pupper_analysis.models.parameters import Body, Joint, Parameters
from pupper_analysis.results import Result
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.coordinates import PinocchioConvention
from pupper_analysis.robot.feet import foot_site
from pupper_analysis.robot.robot import Robot

Array = NDArray[np.float64]

_MAIN = ("mass matrix", "gravity", "foot positions", "joint positions")

EXPLAINED = 1e-9
"""What may be left, relative to a quantity's scale, when all differences are taken away.

Two engines of double precision agree to some 1e-13; with a mass matrix whose condition number is
1e6, a hand's fingers on a humanoid, to 1e-10.
"""

_GRAVITY = np.array([0.0, 0.0, -9.81])  # Pinocchio's and MuJoCo's default (m/s^2)


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
        gravity: Of the MJCF's gravity, to the 9.81 m/s^2 downwards that Pinocchio gives a URDF
            (m/s^2). The default passes 9.8 and 9.80665.
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
    gravity: float = 0.02
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
            ``parent``, ``type``, ``gravity``, or ``armature`` (which a URDF cannot state: then it
            differs from that of the joints at the same place of other legs); ``mimic``, that the
            URDF alone has; ``name``, where names count; or what the MJCF alone has, the kinds of
            `extras.Extra`.
        element: The joint, the body (named by the joint that moves it, or the base) or the frame;
            of what the MJCF alone has, its name there, or ``#3``.
        urdf: The URDF's value, in the URDF's frames; None where it has none.
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
            value for every difference, and what the MJCF alone has is taken out of it}.
        complete: Whether nothing is left.
        remains: What acts in MuJoCo when all that was found is taken away, and has no part in a
            tree of joints, by MuJoCo's names, in words.
        armature: What the armature does; both models were given the MJCF's.
    """

    differences: tuple[Difference, ...]
    deviations: dict[str, float]
    left: dict[str, float]
    complete: bool
    remains: tuple[str, ...]
    armature: Armature


# ------------------------------------------------------------------------------------- explanation


def explain(
    robot: Robot,
    *,
    tolerances: Tolerances | None = None,
    reference: Reference | None = None,
    mimics: Mimics | None = None,
) -> Explanation:
    """Finds every number in which a robot's URDF and MJCF differ, and proves that none is missing.

    The parameters of both models are compared body by body, and what the MJCF alone can state is
    found. Each difference is put into the URDF's model alone (or into a MuJoCo model that has
    nothing else that a URDF cannot state), to see its effect. Then all are put into the URDF's
    model in Pinocchio, and it must behave as MuJoCo's model of the MJCF, as it is but for what was
    found that a URDF cannot state.

    Args:
        robot: The robot.
        tolerances: What counts as a difference; for files of 5 to 6 digits by default.
        reference: The MJCF as it is; by default the robot's MuJoCo model.
        mimics: The joints that follow others in the URDF.
    """
    tolerances = tolerances or Tolerances()
    reference = reference or Reference(
        robot.mj_model, robot.mj_model, robot.joint_names, robot.mj_base
    )
    first, raw = _parameters(robot, tolerances)
    second = parameters.aligned(raw, first, partial(_count, tolerances))
    found = extras(reference)
    coupled, uncoupled = split_mimics(found, reference, mimics or {}, tolerances.limit)
    found = [extra for extra in found if extra not in coupled]
    states = random_states(robot, 10, seed=0)
    urdf = _behaviour(robot, first, states)
    mujoco_sees = partial(_mujoco_behaviour, robot, reference, states)
    mjcf = mujoco_sees(without(reference.model, coupled))
    bare = without(reference.model, [*found, *coupled])
    stripped = mujoco_sees(bare)
    judge = _Judge(urdf, mjcf)
    differences = []
    for change in _changes(first, second, tolerances):
        effects = {}
        if change.felt:
            effects = judge.effects(urdf, _behaviour(robot, change.apply(first, second), states))
        differences.append(change.difference(effects))
    differences += _armature_differences(robot, first, states, judge)
    whole = as_it_is(reference.model)
    for extra in found:
        extra.switch(bare, whole)
        effects = judge.effects(stripped, mujoco_sees(bare)) if extra.slots else {}
        extra.switch(bare, None)
        differences.append(_extra(extra, effects))
    differences += [_mimic(name, (mimics or {})[name]) for name in uncoupled]
    patched = _behaviour(robot, _patched(first, second), states)
    left = {name: judge.relative(name, patched[name], stripped[name]) for name in patched}
    differences.sort(key=lambda item: (-item.weight[0], -item.weight[1], _ORDER.index(item.kind)))
    return Explanation(
        differences=tuple(differences),
        deviations={name: judge.relative(name, urdf[name], mjcf[name]) for name in urdf},
        left=left,
        complete=all(value <= EXPLAINED for value in left.values()),
        remains=tuple(_remains(reference, bare, states)),
        armature=_armature(robot, first, states, judge),
    )


def _parameters(robot: Robot, tolerances: Tolerances) -> tuple[Parameters, Parameters]:
    """Returns the parameters of the URDF and of the MJCF."""
    frames = {**robot.description.feet, **robot.description.frames}
    urdf = parameters.from_pinocchio(
        robot.pin_model,
        robot.base,
        robot.joint_names,
        {name: pair[0] for name, pair in frames.items()},
    )
    mjcf = parameters.from_pinocchio(
        pinocchio_from_mujoco(robot.mj_model),
        robot.base,
        robot.joint_names,
        {name: pair[1] for name, pair in frames.items()},
    )
    if float(np.linalg.norm(mjcf.gravity - _GRAVITY)) > tolerances.gravity:
        urdf = replace(urdf, gravity=_GRAVITY)
    return urdf, mjcf


def _count(tolerances: Tolerances, one: Parameters, two: Parameters, name: str) -> int:
    """Counts the differences of a body, its joint, and what it carries."""
    carried = {frame for frame, (owner, _) in one.frames.items() if owner == name}
    concerned = {name, *one.children(name), *carried}
    return sum(1 for change in _changes(one, two, tolerances) if change.element in concerned)


@dataclass(frozen=True, eq=False)
class _Judge:
    """Weighs deviations against the quantities of the URDF's model, and against the whole."""

    urdf: Mapping[str, Array]
    mjcf: Mapping[str, Array]

    def scale(self, name: str) -> float:
        return max(float(np.abs(self.urdf[name]).max()), 1e-300)

    def relative(self, name: str, one: Array, two: Array) -> float:
        deviation = float(np.abs(one - two).max())
        # What is no number differs from everything.
        return deviation / self.scale(name) if math.isfinite(deviation) else math.inf

    def effects(self, before: Mapping[str, Array], after: Mapping[str, Array]) -> dict[str, Effect]:
        found = {}
        for name, values in after.items():
            relative = self.relative(name, values, before[name])
            if relative > 1e-12:  # rounding
                total = self.relative(name, self.urdf[name], self.mjcf[name])
                share = relative / total if 0 < total < math.inf else math.inf
                found[name] = Effect(relative * self.scale(name), relative, share)
        return found


def _patched(first: Parameters, second: Parameters) -> Parameters:
    """Returns the first with the second's value for every difference.

    What is within the tolerance is taken over as well, so that only what was overlooked is left.
    """
    patched = first
    for change in _changes(first, second, _NOTHING):
        patched = change.apply(patched, second)
    return patched


def _extra(extra: Extra, effects: dict[str, Effect]) -> Difference:
    return Difference(
        extra.kind, extra.element, None, extra.value, extra.unit, extra.message, effects
    )


def _mimic(name: str, said: tuple[str, float, float]) -> Difference:
    leader, multiplier, offset = said
    message = (
        f"joint {name}: it mimics {leader} in the URDF (times {multiplier:.6g}, plus "
        f"{offset:.6g}), and no joint equality of the MJCF says so"
    )
    return Difference("mimic", name, said, None, "", message, {})


def _armature_differences(
    robot: Robot, values: Parameters, states: States, judge: _Judge
) -> list[Difference]:
    """Returns armatures unlike those of the other legs, which a URDF cannot state."""
    differences = []
    for name, usual in _unusual_armatures(values).items():
        joint = replace(values.joints[name], armature=usual)
        alone = _behaviour(robot, replace(values, joints={**values.joints, name: joint}), states)
        value = values.joints[name].armature
        unit = "kg" if joint.slides else "kg m^2"
        message = (
            f"joint {name}: armature {value:.6g} {unit} in the MJCF, but {usual:.6g} {unit} on the "
            "joints at the same place of the other legs (a URDF cannot state it)"
        )
        effects = judge.effects(judge.urdf, alone)
        differences.append(Difference("armature", name, None, value, unit, message, effects))
    return differences


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


def _armature(robot: Robot, values: Parameters, states: States, judge: _Judge) -> Armature:
    without_it = {name: replace(joint, armature=0.0) for name, joint in values.joints.items()}
    bare = _behaviour(robot, replace(values, joints=without_it), states)
    armature = {name: values.joints[name].armature for name in robot.joint_names}
    return Armature(armature, judge.effects(judge.urdf, bare))


def _mujoco_behaviour(
    robot: Robot, reference: Reference, states: States, model: mujoco.MjModel
) -> dict[str, Array]:
    """Evaluates the same quantities as `_behaviour` in MuJoCo, at all states.

    Args:
        robot: The robot.
        reference: Names the elements of the model.
        states: The states.
        model: One with the elements of the reference.
    """
    names, data = reference.names, mujoco.MjData(model)
    convention = reference.convention()
    joints = [names.joint(name).id for name in robot.joint_names]
    dofs = convention.qvel_index[robot.nv - robot.nu :]
    slides = model.jnt_type[joints] == mujoco.mjtJoint.mjJNT_SLIDE.value
    coordinates = model.jnt_qposadr[joints]
    frames = {**robot.description.feet, **robot.description.frames}
    places = [foot_site(names, frame, robot.name) for _, frame in frames.values()]
    public = convention.qvel_index
    weights = _weights(robot, reference)
    full = np.zeros((model.nv, model.nv))
    rows: dict[str, list[Array]] = {}
    for qpos, qvel, torques in zip(states.qpos, states.qvel, states.torques, strict=True):
        convention.set_state(data, qpos)
        data.qfrc_applied[:] = 0.0
        mujoco.mj_forward(model, data)
        gravity = data.qfrc_bias[public].copy()
        convention.set_state(data, qpos, qvel)
        data.qfrc_applied[dofs] = torques
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, full)
        # MuJoCo's anchor of a slide is where it is at rest.
        slid = np.where(slides, data.qpos[coordinates] - model.qpos0[coordinates], 0.0)
        result = {
            "mass matrix": full[np.ix_(public, public)],
            "gravity": gravity,
            "bias forces": data.qfrc_bias[public].copy(),
            "com": weights @ data.xipos / max(weights.sum(), 1e-300),
            "forward dynamics": data.qacc[public].copy(),
            "joint positions": data.xanchor[joints] + slid[:, None] * data.xaxis[joints],
        }
        if places:
            result["foot positions"] = np.array(
                [data.xpos[b] + data.xmat[b].reshape(3, 3) @ local for b, local in places]
            )
        for name, value in result.items():
            rows.setdefault(name, []).append(value)
    return {name: np.array(values) for name, values in rows.items()}


def _weights(robot: Robot, reference: Reference) -> Array:
    """Returns the mass (nbody,) of each body of the reference that is the robot's, else 0 (kg).

    On a fixed base all that is static counts, as in `pinocchio_from_mujoco`.
    """
    model, moving = reference.model, reference.bodies()
    kept = {robot.mj_model.body(body).name for body in range(robot.mj_model.nbody)}
    members = [
        (body in moving or not (robot.floating or model.body_weldid[body]))
        and reference.names.body(body).name in kept
        for body in range(model.nbody)
    ]
    return np.where(members, model.body_mass, 0.0)


_FORCES = ("spring", "damper", "gravcomp", "fluid", "adhesion", "actuator", "constraint")


def _remains(reference: Reference, model: mujoco.MjModel, states: States) -> Iterator[str]:
    """Yields the forces that still act, besides linear damping, of which a tree of joints has none.

    Args:
        reference: The MJCF.
        model: The reference's, without what was found that a URDF cannot state.
        states: The states.
    """
    data = mujoco.MjData(model)
    convention = reference.convention()
    damping = joint_damping(model)
    worst = dict.fromkeys(_FORCES, 0.0)
    scale = 0.0
    for qpos, qvel in zip(states.qpos, states.qvel, strict=True):
        convention.set_state(data, qpos, qvel)
        mujoco.mj_forward(model, data)
        scale = max(scale, float(np.abs(data.qfrc_bias).max()))
        for name in worst:
            force = np.array(getattr(data, f"qfrc_{name}"))
            if name == "damper":
                force += damping * data.qvel
            worst[name] = max(worst[name], float(np.abs(force[convention.qvel_index]).max()))
    for name, greatest in worst.items():
        if greatest > 1e-12 * scale:  # rounding
            yield f"MuJoCo's qfrc_{name} is up to {greatest:.2g} N or N m"


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
    "name",
    "type",
    "parent",
    "gravity",
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
    "mimic",
    "spring",
    "damping polynomial",
    "gravity compensation",
    "tendon",
    "actuator",
    "fluid",
    "equality",
    "flex",
    "plugin",
    "flag",
)

_NOTHING = Tolerances(**{kind.name: 1e-300 for kind in fields(Tolerances)})


def _changes(one: Parameters, two: Parameters, tolerances: Tolerances) -> Iterable[_Change]:
    for name, body in one.bodies.items():
        yield from _body_changes(name, body, two.bodies[name], tolerances)
    for name, joint in one.joints.items():
        yield from _joint_changes(name, joint, two.joints[name], tolerances)
    if float(np.linalg.norm(two.gravity - one.gravity)) > tolerances.gravity:
        message = (
            f"gravity: {_vector(one.gravity)} m/s^2, which Pinocchio gives a URDF, "
            f"{_vector(two.gravity)} m/s^2 in the MJCF"
        )
        yield _Change(
            "gravity",
            "option",
            one.gravity,
            two.gravity,
            "m/s^2",
            message,
            lambda first, second: replace(first, gravity=second.gravity),
            felt=True,
        )
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
