"""One robot, two models: Pinocchio's from the URDF, MuJoCo's from the MJCF.

What its motors can give is the least that both state.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from threading import Lock
from types import MappingProxyType
from typing import Any, TypeVar

import mujoco
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.diagnostics import Diagnostic, Quantity, Term, diagnose
from pupper_analysis.base.errors import ConfigurationError, ModelError, UnknownNameError
from pupper_analysis.base.frozen import FrozenDict
from pupper_analysis.base.units import EARTH
from pupper_analysis.models.conversion import UrdfImport, acting_gravity
from pupper_analysis.models.description import Description
from pupper_analysis.models.efforts import (
    EffortLimit,
    effort_of,
)
from pupper_analysis.models.mjcf_file import MjcfFile
from pupper_analysis.models.transmission import drives_by_joint
from pupper_analysis.robot.closure import Closure, closure_of
from pupper_analysis.robot.contact import ContactParameters
from pupper_analysis.robot.coordinates import MujocoConvention, PinocchioConvention
from pupper_analysis.robot.shapes import CarriedShape, shapes_of
from pupper_analysis.robot.structure import Structure

Array = NDArray[np.float64]

_EFFORT_TOLERANCE = 1e-6
"""Relative: limits that differ by less are one, rounded otherwise."""


def efforts_of(
    mj_model: mujoco.MjModel,
    pin_model: pin.Model,
    convention: PinocchioConvention,
    joint_names: Sequence[str],
    before: Mapping[str, EffortLimit],
) -> tuple[EffortLimit, ...]:
    """Returns what each joint's motor can give, in the order of the names.

    Args:
        mj_model: MuJoCo's model of the MJCF.
        pin_model: Pinocchio's of the URDF.
        convention: Where the joints are in it.
        joint_names: Their names, in both.
        before: {joint: the same}, of motors that a preparation replaced by servos. Where the servo
            has that limit, it is reported with the statements of the file itself.
    """
    urdf, limits = pin_model.effortLimit.take(convention.v_index).tolist(), []
    drives = drives_by_joint(mj_model)
    for name, effort in zip(joint_names, urdf, strict=True):
        joint, first = int(mj_model.joint(name).id), before.get(name)
        limit = effort_of(mj_model, joint, effort, drives=drives.get(joint, ()))
        same = first is not None and _alike(first.lower, limit.lower)
        same = same and first is not None and _alike(first.upper, limit.upper)
        limits.append(first if same and first is not None else limit)
    return tuple(limits)


def effort_notes(limits: Sequence[EffortLimit]) -> list[Diagnostic]:
    """Tells of efforts: which file's count where they differ, and what was made of them."""
    unstated = [
        limit.joint
        for limit in limits
        if all(statement.file != "URDF" for statement in limit.stated)
    ]
    uneven = [one.joint for one in limits if not _alike(-one.lower, one.upper)]
    differing = []
    for limit in limits:
        joint, by_file = ("joint", limit.joint), sorted(limit.stated, key=lambda one: one.least)
        unused = next((one for one in by_file[1:] if one.file != by_file[0].file), None)
        if unused and limit.origin is not None and not _alike(by_file[0].least, unused.least):
            most = Quantity(unused.least, "N m")
            least = Quantity(by_file[0].least, "N m")
            message = diagnose(
                "lesser-effort", subject=joint, file=by_file[0].file, least=least, unused=most
            )
            differing.append(message)
    found = (
        (unstated, diagnose("effort-unstated", joints=unstated)),
        (differing, diagnose("effort-limits-differ", joints=differing)),
        (uneven, diagnose("motors-uneven", joints=uneven)),
    )
    return [message for joints, message in found if joints]


def _alike(one: float, other: float) -> bool:
    return one == other or math.isclose(one, other, rel_tol=_EFFORT_TOLERANCE)


_T = TypeVar("_T")


_LIMITS = ("lowerPositionLimit", "upperPositionLimit", "velocityLimit", "effortLimit")
"""What may be infinite in Pinocchio's model: it writes infinity, and cannot read it again."""

_MADE = (
    "structure", "closure", "efforts", "effort_ranges", "effort_limits", "shapes", "welds",
    "grips", "_kept",
)  # fmt: skip
"""What is worked out again, quicker than it travels."""


@dataclass(frozen=True, eq=False)
class PublishedFile:
    """A robot's MJCF, or its URDF alone, as it was published: what verdicts simulate beside it.

    Attributes:
        file: The MJCF; None of a URDF alone, and where the robot is as its file has it, with
            nothing made up.
        keyframe: The one that was asked for.
        imported: A URDF that is alone, for MuJoCo's own importer.
        options: MuJoCo's that were asked for in place of the file's: their names and values.
        loaded: The robot that was made of it, where this is of one that was changed since.
    """

    file: MjcfFile | None
    keyframe: str | None = None
    imported: UrdfImport | None = None
    options: tuple[tuple[str, float], ...] = ()
    loaded: Robot | None = None

    @property
    def as_prepared(self) -> bool:
        """Whether the robot is as its file has it."""
        return self.file is None and self.imported is None

    def of_changed(self, robot: Robot) -> PublishedFile:
        """Returns the file of what is made of a robot by changing it."""
        return self if self.loaded is not None else replace(self, loaded=robot)


@dataclass(frozen=True)
class Touching:
    """What a task's contact makes other in a robot.

    Attributes:
        friction: Coefficient; None: that of the ground.
        offset: Of a part that is no foot, (x, y, z) of its ball's centre in its frame (m); None of
            a foot.
        radius: Of that ball (m); None: what its shapes hold.
        force: With which it presses (N), if that is stated.
        welded: Whether it touches nothing, and is fixed in the world.
        grip: Up to which force it is so (N), and may turn about its point; None: any way.
    """

    friction: float | None = None
    offset: tuple[float, float, float] | None = None
    radius: float | None = None
    force: float | None = None
    welded: bool = False
    grip: float | None = None


def with_friction(
    contacts: Mapping[str, ContactParameters],
    feet: Mapping[str, Sequence[str]],
    touching: Mapping[str, Touching],
) -> Mapping[str, ContactParameters]:
    """Returns contact parameters with the friction of planes that feet touch."""
    own = {
        point: replace(contacts[point], friction=(mu, mu, *contacts[point].friction[2:]))
        for name, one in touching.items()
        if (mu := one.friction) is not None and contacts
        for point in feet[name]
    }
    return MappingProxyType({**contacts, **own}) if own else contacts


@dataclass(frozen=True, eq=False)
class Robot:
    """A robot given by a URDF and an MJCF, with the maps between the two models.

    Attributes:
        name: The robot's name.
        description: The files' contents.
        pin_model: Pinocchio's model of the URDF. Its armature is the MJCF's.
        mj_model: MuJoCo's model of the MJCF.
        floating: Whether the base is free to move.
        base: The name of the base's link (URDF).
        mj_base: The name of the base's body (MJCF).
        joint_names: In actuator order.
        contact_points: The names of the feet's contact points: the keys of every dictionary of
            contact forces. A foot that is a sphere has one, of its own name.
        feet: {foot: its contact points}; a flat foot has several, on one body.
        contact_frames: {contact point: its frame in the URDF}.
        contact_places: {contact point: the body that carries it in ``mj_model`` (its id), and the
            centre of its sphere in that body's frame, (3,) (m)}.
        foot_geoms: Which foot a geom of ``mj_model`` belongs to, {geom id: key of ``feet``}.
        contact_radius: {contact point: the radius of its sphere (m)}; 0 for the corner of a sole.
        contacts: {contact point: the effective parameters of its contact with the ground}.
        home: (nq,) the MJCF's keyframe ``home`` (or its first, or its zero configuration).
        nominal: (nu,) joint positions at which the feet are, seen from above, where they stand by
            default (rad).
        stand_height: Height of the base above the ground in the nominal stand (m).
        imu: The frame that carries gyro and accelerometer, if there is one.
        fingerprint: The name, and a hash of all that a stand depends on: joints, limits, masses and
            feet. Robots with the same hash have the same stands.
        notes: What was assumed or added on loading, or is wrong in the files.
        published: The file as it was published, which verdicts look at; None where there is none.
        touching: {foot or hand: what a task's contact makes other}; see ``robot.touching``.
        bare: The robot without these; None if there are none, or it was changed since.
    """

    name: str
    description: Description
    pin_model: pin.Model
    mj_model: mujoco.MjModel
    floating: bool
    base: str
    mj_base: str
    joint_names: tuple[str, ...]
    contact_points: tuple[str, ...]
    contact_frames: Mapping[str, str]
    contact_places: Mapping[str, tuple[int, Array]]
    foot_geoms: Mapping[int, str]
    contact_radius: Mapping[str, float]
    feet: Mapping[str, tuple[str, ...]]
    contacts: Mapping[str, ContactParameters]
    home: Array
    nominal: Array
    stand_height: float
    imu: str | None
    pin_convention: PinocchioConvention
    mj_convention: MujocoConvention
    fingerprint: str
    notes: tuple[Diagnostic, ...] = field(default=())
    published: PublishedFile | None = None
    touching: Mapping[str, Touching] = field(default_factory=FrozenDict)
    bare: Robot | None = None

    def __repr__(self) -> str:
        base = "a free base" if self.floating else "a fixed base"
        return (
            f"<Robot {self.name!r}: {self.total_mass:.3f} kg, {base}, {self.nu} joints, "
            f"{len(self.feet)} feet>"
        )

    def __getstate__(self) -> dict[str, Any]:
        state = dict(vars(self))
        for made in _MADE:
            state.pop(made, None)
        limits = {name: np.array(getattr(self.pin_model, name)) for name in _LIMITS}
        if not np.isfinite(np.concatenate([*limits.values()])).all():
            model = self.pin_model.copy()
            for name, values in limits.items():
                setattr(model, name, np.nan_to_num(values))
            state |= {"pin_model": model, "limits": limits}
        return state

    def __setstate__(self, state: dict[str, Any]) -> None:
        for name, values in state.pop("limits", {}).items():
            setattr(state["pin_model"], name, values)
        vars(self).update(state)

    @property
    def hands(self) -> tuple[str, ...]:
        """Those of ``feet`` that are none of its own: parts with which a task has it touch."""
        touching = self.touching.items()
        return tuple(name for name, one in touching if one.offset is not None and name in self.feet)

    @cached_property
    def welds(self) -> Mapping[str, str | None]:
        """{what a task fixes in the world: a contact point on it; None of the base}.

        Those that ``grips`` come last.
        """
        fixed = (name for name, one in self.touching.items() if one.welded and one.grip is None)
        names = (*fixed, *self.grips)
        return FrozenDict({name: next(iter(self.feet.get(name, ())), None) for name in names})

    @cached_property
    def grips(self) -> Mapping[str, float]:
        """{what is held in the world by a point of it alone: up to which force (N)}."""
        given = ((name, one.grip) for name, one in self.touching.items())
        return FrozenDict({name: grip for name, grip in given if grip is not None})

    @property
    def welded(self) -> bool:
        """Whether something is fixed in the world any way, so that any com is in balance."""
        return len(self.welds) > len(self.grips)

    @property
    def bolted(self) -> bool:
        """Whether its base is fixed in the world: by its file, or by a task's weld."""
        return not self.floating or None in self.welds.values()

    @property
    def bearing(self) -> tuple[str, ...]:
        """The contact points by which something may touch: all but those of what is welded."""
        if not self.floating:
            return ()
        if not self.touching:
            return self.contact_points
        held = {point for name in self.welds for point in self.feet.get(name, ())}
        return tuple(point for point in self.contact_points if point not in held)

    @property
    def base_height(self) -> float:
        """Of the base by default (m): in the nominal stand, or where the file of an arm has it."""
        return self.stand_height if len(self.feet) > len(self.hands) else float(self.home[2])

    @property
    def nq(self) -> int:
        """Size of the public qpos."""
        return len(self.joint_names) + (7 if self.floating else 0)

    @property
    def nv(self) -> int:
        """Size of the public qvel."""
        return len(self.joint_names) + (6 if self.floating else 0)

    @property
    def nu(self) -> int:
        """Number of joints, each with one motor."""
        return len(self.joint_names)

    @property
    def gravity(self) -> Array:
        """(3,) acceleration of gravity in the world (m/s^2)."""
        return acting_gravity(self.mj_model)

    @property
    def total_mass(self) -> float:
        """Mass of the URDF's model (kg)."""
        return self.structure.total_mass

    @property
    def weight(self) -> float:
        """Of the URDF's model, in its gravity (N)."""
        return self.total_mass * float(np.linalg.norm(self.gravity))

    @property
    def usual_weight(self) -> float:
        """The same; of what floats in space that on Earth: a scale for what is off (N)."""
        return self.weight or self.total_mass * EARTH

    @cached_property
    def structure(self) -> Structure:
        """What configurations need to know of the robot; worked out once."""
        return Structure(self.pin_model, self.pin_convention, self.joint_names, self.contact_frames)

    @cached_property
    def acts_at_rest(self) -> bool:
        """Whether the MJCF has springs, gravity compensation or wind, which act at rest."""
        return acts_at_rest(self.mj_model)

    @cached_property
    def closure(self) -> Closure | None:
        """The closed loops and couplings of the MJCF's joints; None if there are none."""
        return closure_of(self.mj_model, self.mj_convention, self.joint_names)

    @cached_property
    def shapes(self) -> tuple[CarriedShape, ...]:
        """The shapes with which MuJoCo has it touch, feet included."""
        return shapes_of(
            self.mj_model,
            self.mj_convention,
            self.structure,
            (self.base, self.mj_base),
            self.neutral(),
            self.description.mjcf_source,
        )

    @cached_property
    def _kept(self) -> dict[tuple[Hashable, ...], Any]:
        return {}

    def once(self, make: Callable[..., _T], *given: Hashable) -> _T:
        """Returns what a function makes of the robot alone: made once, and the robot's own.

        It lasts as long as the robot, which does not change. What is made must not hold the robot:
        it would only go when Python looks for circles.

        Args:
            make: Called with the robot, and what is given.
            given: Further arguments, which cannot be changed.
        """
        key = make, *given
        if key not in self._kept:
            self._kept[key] = make(self, *given)
        made: _T = self._kept[key]
        return made

    @property
    def lower_limits(self) -> Array:
        """(nu,) lower joint limits of the URDF (rad); -inf for a continuous joint."""
        return self._positional(self.pin_model.lowerPositionLimit, -np.inf)

    @property
    def upper_limits(self) -> Array:
        """(nu,) upper joint limits of the URDF (rad); inf for a continuous joint."""
        return self._positional(self.pin_model.upperPositionLimit, np.inf)

    @property
    def joint_friction(self) -> Array:
        """(nu,) What dry friction of each joint holds at most, its ``frictionloss`` (N m)."""
        found: Array = self.mj_model.dof_frictionloss[self.mj_convention.qvel_index[-self.nu :]]
        return found

    @cached_property
    def efforts(self) -> tuple[EffortLimit, ...]:
        """What each joint's motor can give, in actuator order, by both files, with its origin."""
        return efforts_of(
            self.mj_model,
            self.pin_model,
            self.pin_convention,
            self.joint_names,
            self.description.efforts,
        )

    @cached_property
    def effort_ranges(self) -> Array:
        """(nu, 2) least and greatest torque of each joint's motor (N m); infinite without limit."""
        ranges: Array = np.array([(limit.lower, limit.upper) for limit in self.efforts])
        ranges.flags.writeable = False
        return ranges

    @cached_property
    def effort_limits(self) -> Array:
        """(nu,) torque that each joint's motor can give either way (N m); inf without a limit.

        The least of all that both files state; see ``efforts``.
        """
        limits = np.array([limit.least for limit in self.efforts], dtype=float)
        limits.flags.writeable = False
        return limits

    @property
    def velocity_limits(self) -> Array:
        """(nu,) velocity limits of the URDF (rad/s); inf where it says 0, as exporters do."""
        limits = np.array(self.pin_model.velocityLimit[self.pin_convention.v_index])
        return np.where(limits == 0, np.inf, limits)

    def _positional(self, values: Array, unbounded: float) -> Array:
        limits = np.array(values[self.pin_convention.q_index])
        limits[self.pin_convention.unbounded] = unbounded
        return limits

    def check_not_welded(self, what: str) -> None:
        """Checks that nothing is fixed in the world; see ``check_tree``."""
        if self.welds:
            problem = diagnose("robot-is-welded", robot=self.name, what=Term(what))
            raise ConfigurationError("contacts", problem)

    def check_tree(self, what: str) -> None:
        """Checks that no loops or couplings bind the robot's joints, and no welds its parts.

        Args:
            what: What is asked for, and is not computed for such a robot.

        Raises:
            ConfigurationError: If there are.
        """
        self.check_not_welded(what)
        if self.closure is not None:
            bonds = self.closure.bonds
            problem = diagnose("robot-has-loops", robot=self.name, bonds=bonds, what=Term(what))
            raise ConfigurationError("robot", problem)

    def check_floating(self) -> None:
        """Checks that the base is free, so that the robot can stand.

        Raises:
            ConfigurationError: If it is fixed.
        """
        if not self.floating:
            kept = (note for note in self.notes if note.code == "base-kept-in-the-world")
            why = next((note.values["why"] for note in kept), None)
            raise ConfigurationError("robot", diagnose("base-is-fixed", robot=self.name, why=why))

    def check_bodies(self) -> None:
        """Checks that what moves with each joint has no negative mass or moment of inertia.

        A robot that has passed is not looked at again: it does not change.

        Raises:
            ModelError: If one has; it names the joint.
        """
        self.once(_check_bodies)

    def check_foot(self, foot: str) -> str:
        """Returns the name of a foot, if it is one.

        Raises:
            UnknownNameError: If it is not; the message lists the feet.
        """
        if foot not in self.contact_frames:
            raise UnknownNameError(self.name, "foot", foot, self.contact_points)
        return foot

    def points_of(self, foot: str) -> tuple[str, ...]:
        """Returns the contact points of a foot.

        Raises:
            UnknownNameError: If there is no such foot; the message lists the feet.
        """
        if foot not in self.feet:
            raise UnknownNameError(self.name, "foot", foot, tuple(self.feet))
        return self.feet[foot]

    def foot_of(self, point: str) -> str:
        """Returns the foot that a contact point belongs to."""
        return next(foot for foot, points in self.feet.items() if point in points)

    def feet_with(self, points: Iterable[str]) -> tuple[str, ...]:
        """Returns the feet that have one of some contact points."""
        wanted = set(points)
        return tuple(foot for foot, own in self.feet.items() if not wanted.isdisjoint(own))

    def per_foot(self, forces: Mapping[str, Array]) -> dict[str, Array]:
        """Adds up forces on contact points, {point: (3,)}, to those on the feet that have them."""
        return {
            foot: np.sum([forces[point] for point in self.feet[foot] if point in forces], axis=0)
            for foot in self.feet_with(forces)
        }

    def posed(self, joints: Array) -> Array:
        """Returns the qpos (nq,) with the base at the origin, and the joints (nu,) as given."""
        qpos = self.neutral()
        qpos[self.nq - self.nu :] = joints
        return qpos

    def placed(self, qpos: ArrayLike | None = None) -> mujoco.MjData:
        """Returns MuJoCo's data with bodies and coms where they are at a qpos; by default zero."""
        data = mujoco.MjData(self.mj_model)
        self.mj_convention.set_state(data, np.asarray(self.neutral() if qpos is None else qpos))
        mujoco.mj_kinematics(self.mj_model, data)
        mujoco.mj_comPos(self.mj_model, data)
        return data

    def neutral(self) -> Array:
        """Returns the qpos (nq,) with the base at the origin and every joint at zero."""
        qpos = np.zeros(self.nq)
        if self.floating:
            qpos[3] = 1.0
        return qpos


def acts_at_rest(model: mujoco.MjModel) -> bool:
    """Tells whether a model has anything that pushes at rest, and is no weight and no motor."""
    arrays = ("jnt_stiffness", "jnt_stiffnesspoly", "tendon_stiffness", "tendon_stiffnesspoly")
    return (
        any(getattr(model, name).any() for name in (*arrays, "body_gravcomp"))
        or bool(np.any(model.opt.wind) and (model.opt.density or model.opt.viscosity))
        or model.nflex > 0
        or bool((model.body_plugin >= 0).any())
    )


_ROUNDING = 1e-6
"""Of a body's largest moment of inertia: so much less than nothing is rounding, also a file's."""


def _check_bodies(robot: Robot) -> None:
    model = robot.pin_model
    for name, inertia in zip(list(model.names)[1:], list(model.inertias)[1:], strict=True):
        moments = np.linalg.eigvalsh(inertia.inertia)
        if inertia.mass < 0 or moments[0] < -_ROUNDING * np.abs(moments).max():
            problem = diagnose(
                "inertial-of-no-body",
                subject=None if name == "root_joint" else ("joint", name),
                joint=None if name == "root_joint" else name,
                mass=Quantity(inertia.mass, "kg"),
                moment=Quantity(moments[0], "kg m^2"),
            )
            raise ModelError(robot.description.urdf_source, problem)


_MOST_SPARE = 8
"""Things made of robots that are kept for later, of those that were asked last."""

_spare: list[tuple[Robot, object, Any]] = []
"""(robot, what made it, the thing). No robot keeps its own: that would be a circle, in which
memory stays for long."""

_lock = Lock()


@contextmanager
def lend(robot: Robot, make: Callable[[Robot], _T]) -> Iterator[_T]:
    """Lends something that is made of a robot to one user at a time, in whatever thread.

    What was given back is lent again, as long as the robot is one of those that were asked last.

    Args:
        robot: The robot.
        make: Makes one more, where all are in use.
    """
    own = None
    with _lock:
        for number, (whose, maker, spare) in enumerate(_spare):
            if whose is robot and maker == make:  # a bound method is another object each time
                own = spare
                del _spare[number]
                break
    if own is None:
        own = make(robot)
    try:
        yield own
    finally:
        with _lock:
            _spare.insert(0, (robot, make, own))
            del _spare[_MOST_SPARE:]
