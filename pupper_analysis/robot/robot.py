"""``Robot``: Pinocchio's model of the URDF, MuJoCo's model of the MJCF, and the maps between both.

The module also resolves the effort limit of each joint: in each direction, the tightest bound of
both files counts. A pool (`borrow`) keeps objects that are expensive to create for a robot, such as
MuJoCo data.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from threading import Lock
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, TypeVar

import mujoco
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from pupper_analysis.base.arguments import check_names, check_vector
from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import Diagnostic, Quantity, Term, diagnose
from pupper_analysis.base.errors import (
    MODEL_FAULT_CODES,
    ConfigurationError,
    ModelError,
    UnknownNameError,
)
from pupper_analysis.base.frozen import FrozenDict, freeze_fields
from pupper_analysis.base.runs import is_command_line
from pupper_analysis.base.units import EARTH_GRAVITY
from pupper_analysis.models.attributes import known_limits
from pupper_analysis.models.conversion import UrdfImport, acting_gravity
from pupper_analysis.models.description import Description
from pupper_analysis.models.efforts import (
    EffortLimit,
    EffortStatement,
    resolve_effort_limit,
)
from pupper_analysis.models.mjcf_file import MjcfFile
from pupper_analysis.models.places import source_name
from pupper_analysis.models.transmission import (
    Drive,
    group_actuators_by_joint,
    list_falling_base_joints,
)
from pupper_analysis.robot.closure import Closure, find_closure
from pupper_analysis.robot.contact import ContactParameters, ground_geom
from pupper_analysis.robot.coordinates import MujocoConvention, PinocchioConvention
from pupper_analysis.robot.engine_models import EngineModels
from pupper_analysis.robot.engine_types import MujocoModel, PinocchioModel
from pupper_analysis.robot.shapes import CarriedShape, shapes_of
from pupper_analysis.robot.structure import Structure

_EFFORT_RTOL = 1e-6
"""Relative difference up to which two effort limits count as equal, because files contain rounded
values. Chosen, not tuned."""


_NO_STAND_CODES = ("base-kept-in-the-world", "base-free-without-feet")
"""Codes of the notes that contain the reason why the robot cannot stand, as value ``why``."""


_NO_STATEMENTS: Mapping[str, EffortStatement] = MappingProxyType({})
"""Default of the argument ``null`` of `efforts_of`: no joint has a force range that permits no
force."""


def efforts_of(
    mj_model: mujoco.MjModel,
    pin_model: pin.Model,
    convention: PinocchioConvention,
    joint_names: Sequence[str],
    original_limits: Mapping[str, EffortLimit],
    null: Mapping[str, EffortStatement] = _NO_STATEMENTS,
) -> tuple[EffortLimit, ...]:
    """Return the effort limit of each joint: the tightest bound of URDF and MJCF in each direction.

    Args:
        mj_model: MuJoCo's model of the MJCF.
        pin_model: Pinocchio's model of the URDF.
        convention: Coordinate maps of Pinocchio's model.
        joint_names: Names of the joints, in the order of ``convention`` and of the result.
        original_limits: {joint: limit from another source, for example requested by the user}. Used
            instead of an equal limit of the models, because it names its source.
        null: {joint: force range of the MJCF that permits no force}, such as "0 0". MuJoCo ignores
            such a range.
    """
    urdf, limits = pin_model.effortLimit.take(convention.v_index).tolist(), []
    actuators_by_joint = group_actuators_by_joint(mj_model)
    for name, effort in zip(joint_names, urdf, strict=True):
        joint, original = int(mj_model.joint(name).id), original_limits.get(name)
        drives = actuators_by_joint.get(joint, ())
        limit = resolve_effort_limit(
            mj_model, joint, effort, drives=drives, empty_range=null.get(name)
        )
        is_equal = original is not None and _are_equal_efforts(original.lower, limit.lower)
        is_equal = (
            is_equal and original is not None and _are_equal_efforts(original.upper, limit.upper)
        )
        limits.append(original if is_equal and original is not None else limit)
    return tuple(limits)


def report_efforts(limits: Sequence[EffortLimit]) -> list[Diagnostic]:
    """Return diagnostics of effort limits that are missing or inconsistent.

    Missing limits are not stated by the URDF. Inconsistent limits differ between two files, or
    between the two directions of a joint.
    """
    unstated = [
        limit.joint
        for limit in limits
        if all(statement.file != "URDF" for statement in limit.stated)
    ]
    uneven = [limit.joint for limit in limits if not _are_equal_efforts(-limit.lower, limit.upper)]
    differing = []
    for limit in limits:
        joint, by_file = (
            ("joint", limit.joint),
            sorted(limit.stated, key=lambda statement: statement.symmetric_torque),
        )
        unused = next(
            (statement for statement in by_file[1:] if statement.file != by_file[0].file), None
        )
        if (
            unused
            and limit.origin is not None
            and not _are_equal_efforts(by_file[0].symmetric_torque, unused.symmetric_torque)
        ):
            most = Quantity(unused.symmetric_torque, limit.unit)
            least = Quantity(by_file[0].symmetric_torque, limit.unit)
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


def describe_unstated_efforts(joints: Sequence[str]) -> Diagnostic:
    """Create the message that no file states the torque limit of these joints."""
    return diagnose("torque-limits-unstated", joints=joints, count=len(joints))


def _are_equal_efforts(first: float, second: float) -> bool:
    """Return True if two effort limits are equal up to rounding (`_EFFORT_RTOL`)."""
    return first == second or math.isclose(first, second, rel_tol=_EFFORT_RTOL)


_T = TypeVar("_T")
"""Type of an object that is created for a robot, for example a result of `Robot.compute_once`."""


_LIMIT_FIELDS = ("lowerPositionLimit", "upperPositionLimit", "velocityLimit", "effortLimit")
"""Limits of Pinocchio's model that may be infinite. A pickled robot contains infinite limits
separately, because Pinocchio's serialisation cannot read infinite values."""

_CACHED_ATTRIBUTES = (
    "structure", "closure", "efforts", "effort_ranges", "effort_limits", "shapes", "fixed_parts",
    "grips", "collision_model", "_cache",
)  # fmt: skip
"""Cached attributes that a pickled robot does not contain. They are computed again at first use."""


@dataclass(frozen=True, eq=False)
class PublishedFile:
    """Published MJCF or URDF of a robot, without the additions of this package.

    A verdict judges a stand of the robot by simulation, and simulates this file as well.

    Attributes:
        file: Published MJCF. None if there is only a URDF, or if the robot was loaded without
            changes.
        keyframe: Requested keyframe; None if none was requested.
        imported: URDF for MuJoCo's importer, if there is no MJCF; None otherwise.
        options: (name, value) of the requested MuJoCo options, which replace the options of the
            file.
        loaded: Robot as loaded from the file, if the robot was changed after loading; None
            otherwise.
    """

    file: MjcfFile | None
    keyframe: str | None = None
    imported: UrdfImport | None = None
    options: tuple[tuple[str, float], ...] = ()
    loaded: Robot | None = None

    @property
    def is_unchanged(self) -> bool:
        """True if no separate published file is stored, because the robot was loaded unchanged."""
        return self.file is None and self.imported is None

    def for_modified_copy(self, robot: Robot) -> PublishedFile:
        """Return the published file for a modified copy of a robot.

        Args:
            robot: Robot before the modification; becomes ``loaded``, if no earlier robot is stored.
        """
        return self if self.loaded is not None else replace(self, loaded=robot)


@dataclass(frozen=True)
class Touching:
    """Contact settings that a stand task assigns to a foot, a hand or another part of a robot.

    Attributes:
        friction: Friction coefficient; None for the coefficient of the ground.
        offset: Centre (x, y, z) [m] of the contact sphere of a hand, in the frame of the hand; None
            for a foot.
        radius: Radius [m] of the contact sphere. None: the radius of the largest sphere with this
            centre inside a collision shape of the hand, or 1 cm if the centre is outside of all
            shapes.
        force: Prescribed normal force [N]; None if the force follows from balance.
        is_fixed: Whether a weld or grip fixes the part to the world. The part then does not collide
            with fixed bodies.
        grip: Maximum force [N] of a grip; None for a contact or weld. A grip fixes a point and
            permits rotation.
    """

    friction: float | None = None
    offset: tuple[float, float, float] | None = None
    radius: float | None = None
    force: float | None = None
    is_fixed: bool = False
    grip: float | None = None


def with_task_friction(
    contacts: Mapping[str, ContactParameters],
    feet: Mapping[str, Sequence[str]],
    touching: Mapping[str, Touching],
) -> Mapping[str, ContactParameters]:
    """Return contact parameters with the sliding friction that a task specifies for feet and hands.

    Args:
        contacts: {contact point: parameters of its contact with the ground}. Not changed.
        feet: {foot or hand: its contact points}.
        touching: {foot or hand: contact settings of the task}. Without ``friction`` in the
            settings, the friction of the ground remains.

    Returns:
        {contact point: parameters}.
    """
    changed = {
        point: replace(contacts[point], friction=(mu, mu, *contacts[point].friction[2:]))
        for name, properties in touching.items()
        if (mu := properties.friction) is not None and contacts
        for point in feet[name]
    }
    return MappingProxyType({**contacts, **changed}) if changed else contacts


def _make_none() -> None:
    """Return None. Default factory of dataclass fields."""


_DEFERRED_STAGES = "_deferred_stages"
"""Name of the instance attribute for the function that runs the postponed preparation steps
(`defer_stages`)."""

_BEFORE_SERVOS = "_before_servos"
"""Name of the instance attribute for `Robot.before_servos`: the robot, or a function that returns
it."""

_stages_lock = Lock()
"""Lock for the replacement of the fields that the postponed preparation steps compute."""


@dataclass(frozen=True, eq=False)
class Robot(EngineModels):
    """Robot with a URDF and an MJCF, and the maps between the two models.

    Attributes:
        name: Name of the robot.
        description: Contents of the files.
        pin_model: Pinocchio's model of the URDF, with armature and gravity of the MJCF. A fixed
            base has the pose in the MJCF.
        mj_model: MuJoCo's model of the MJCF, with the additions of the preparation.
        floating: Whether the base is free.
        base: Name of the base link (URDF).
        mj_base: Name of the base body (MJCF).
        joint_names: Joints in actuator order; joints without direct actuator come last.
        contact_points: Names of the contact points of feet and hands. A spherical foot has a single
            contact point, with the name of the foot. A flat foot has several.
        feet: {foot or hand: its contact points}, hands last.
        contact_frames: {contact point: frame in the URDF}.
        contact_places: {contact point: (body id in ``mj_model``, centre (3,) [m] of the sphere in
            the frame of the body)}.
        foot_geoms: {geom id of ``mj_model``: foot or hand}.
        contact_radius: {contact point: radius [m] of the contact sphere}; 0 for the corner of a
            sole.
        contacts: {contact point: parameters of the contact with the ground}, as MuJoCo combines
            them from the two geoms. If ``touching`` contains a friction coefficient, it replaces
            the friction of the ground. Empty if the MJCF has no ground plane.
        home: Start configuration, shape (nq,): the keyframe ``home``; else the first keyframe; else
            MuJoCo's qpos0. The preparation may replace it by another keyframe or by a searched
            stand.
        nominal: Joint positions, shape (nu,) [rad, m], with which the default foot positions of
            stands are computed. Joint positions of the nominal stand (the stand of the default
            `StandTask`) may differ.
        stand_height: Height [m] of the base above the ground in the nominal stand. Without feet, it
            is 0; exception: if a task welds a fixed base, it is half the extent of the robot.
        imu: Link of the URDF with the name of an MJCF site with gyro and accelerometer. None
            without such a link.
        pin_convention: Coordinate maps of Pinocchio's model.
        mj_convention: Coordinate maps of MuJoCo's model.
        fingerprint: Text that identifies the robot of a stand: the name and a hash. The hash covers
            the URDF's joint names, kinematics, inertias and position limits, and the contact
            points. A copy with a payload, the ground of a task, or contacts of a task keeps the
            fingerprint.
        notes: Diagnostics of assumptions, additions and errors in the files.
        published: Published file, which verdicts simulate; None if there is none.
        touching: {foot, hand or other part: properties for a contact of a task}; see the module
            ``robot.touching``.
        bare: Robot before it got the contacts in ``touching``. None without such contacts, or if
            the robot was changed afterwards.
    """

    name: str
    description: Description
    pin_model: PinocchioModel
    mj_model: MujocoModel
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
    # Defaults are made by functions, so that the class has no attribute of that name: Python calls
    # `__getattr__` for missing attributes only.
    notes: tuple[Diagnostic, ...] = field(default_factory=tuple)
    published: PublishedFile | None = field(default_factory=_make_none)
    touching: Mapping[str, Touching] = field(default_factory=FrozenDict)
    bare: Robot | None = field(default_factory=_make_none)

    def __post_init__(self) -> None:
        freeze_fields(self, "home", "nominal")

    if not TYPE_CHECKING:  # mypy would accept any attribute name

        def __getattr__(self, name: str) -> Any:
            """Run the postponed preparation steps if a field that they compute is read."""
            if name in _FIELD_NAMES:
                self.complete_stages()
            if name in vars(self):
                return vars(self)[name]
            raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")

    def complete_stages(self) -> None:
        """Run the postponed preparation steps of the robot (`defer_stages`).

        If several threads call this method at the same time, each runs the steps, and the first
        result is used. (Waiting for another thread could block both.)

        Raises:
            ModelError: If MuJoCo rejects the robot with the additions of these steps, for example.
        """
        complete = vars(self).get(_DEFERRED_STAGES)
        if complete is None:
            return
        completed = vars(complete())
        with _stages_lock:
            if vars(self).pop(_DEFERRED_STAGES, None) is not None:
                own = vars(self)
                own.pop(_BEFORE_SERVOS, None)
                own.update({n: completed[n] for n in _FIELD_NAMES if n not in own})

    @property
    def before_servos(self) -> Robot:
        """Robot for kinematics and statics, without the postponed servo tuning and visual meshes.

        The result has the start pose, collision shapes, contacts and effort limits of this robot.
        It is this robot itself if nothing is postponed.
        """
        found: Robot | Callable[[], Robot] | None = vars(self).get(_BEFORE_SERVOS)
        if found is None or isinstance(found, Robot):
            return found or self
        completed, own = vars(found()), vars(self)
        posed = object.__new__(Robot)
        vars(posed).update({name: completed[name] for name in _FIELD_NAMES})
        vars(posed).update({name: own[name] for name in _EARLY_FIELDS})
        with _stages_lock:
            if _BEFORE_SERVOS in own:
                own[_BEFORE_SERVOS] = posed
        return posed

    @property
    def passive_joints(self) -> tuple[str, ...]:
        """Names of the passive joints, which no motor drives (`Description.passive_joints`).

        Dependent joints of loops and couplings are not included.
        """
        return self.before_servos.description.passive_joints

    def __repr__(self) -> str:
        base = "a free base" if self.floating else "a fixed base"
        return (
            f"<Robot {self.name!r}: {self.total_mass:.3f} kg, {base}, {self.nu} joints, "
            f"{len(self.feet)} feet>"
        )

    def _repr_html_(self) -> str:
        """Return an HTML table for notebooks: mass, base, joints, effort limits, feet and notes."""
        from pupper_analysis.base.notebook import format_value, render_table

        rows = [
            ("total_mass", format_value(self.total_mass), "kg"),
            ("floating", format_value(self.floating), ""),
            ("base", format_value(self.base), ""),
            ("joint_names", format_value(self.joint_names), ""),
            ("effort_limits", format_value(self.effort_limits), "N m or N"),
            ("feet", format_value(tuple(self.feet)), ""),
            ("notes", format_value(self.notes), ""),
        ]
        return render_table(f"Robot {self.name}", rows)

    def __getstate__(self) -> dict[str, Any]:
        self.complete_stages()
        state = dict(vars(self))
        for made in _CACHED_ATTRIBUTES:
            state.pop(made, None)
        limits = {name: np.array(getattr(self.pin_model, name)) for name in _LIMIT_FIELDS}
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
        self.__post_init__()

    @property
    def hands(self) -> tuple[str, ...]:
        """Names of the parts in ``feet`` that a task uses as hands.

        A hand touches its plane with a massless contact sphere. The sphere of a welded or gripping
        hand does not collide.
        """
        touching = self.touching.items()
        return tuple(
            name
            for name, properties in touching
            if properties.offset is not None and name in self.feet
        )

    @cached_property
    def fixed_parts(self) -> Mapping[str, str | None]:
        """Parts that a task fixes to the world by a weld or grip, ``{part: first contact point}``.

        A part is a foot, a link or the base. Welded parts precede gripping parts (``grips``). The
        value is None for a part without contact points, such as the base.
        """
        welded = (
            name
            for name, properties in self.touching.items()
            if properties.is_fixed and properties.grip is None
        )
        names = (*welded, *self.grips)
        return FrozenDict({name: next(iter(self.feet.get(name, ())), None) for name in names})

    @cached_property
    def grips(self) -> Mapping[str, float]:
        """Grips of a task: ``{gripping part: maximum norm of the grip force [N]}``.

        A grip fixes the contact point of a part to the world, but permits rotation about this
        point.
        """
        grips_by_name = ((name, properties.grip) for name, properties in self.touching.items())
        return FrozenDict({name: grip for name, grip in grips_by_name if grip is not None})

    @property
    def is_welded(self) -> bool:
        """True if a task welds a part to the world, so that balance permits any CoM position.

        A grip is no weld: a grip permits rotation, and its force is limited.
        """
        return len(self.fixed_parts) > len(self.grips)  # the gripping parts are fixed parts, too

    @property
    def is_base_fixed(self) -> bool:
        """True if the base is fixed to the world, by the model or by a weld of a task."""
        return not self.floating or None in self.fixed_parts.values()

    @cached_property
    def has_floor(self) -> bool:
        """Whether the MJCF has a ground plane whose contact bits are not all zero."""
        model = self.before_servos.mj_model
        floor = ground_geom(model)
        if floor is None:
            return False
        return bool(model.geom_contype[floor] or model.geom_conaffinity[floor])

    @property
    def bearing_points(self) -> tuple[str, ...]:
        """Contact points that can bear contact forces.

        Contact points of welded or gripping parts are excluded. The result is empty for a robot
        with a fixed base.
        """
        if not self.floating:
            return ()
        if not self.touching:
            return self.contact_points
        welded_points = {point for name in self.fixed_parts for point in self.feet.get(name, ())}
        return tuple(point for point in self.contact_points if point not in welded_points)

    @property
    def base_height(self) -> float:
        """Default height [m] of the origin of a free base above the world's origin.

        - With feet: the height in the nominal stand (``stand_height``).
        - Without feet (or with hands only): the height in ``home``.
        - With a fixed base: 0.
        """
        if not self.floating:
            return 0.0
        return self.stand_height if len(self.feet) > len(self.hands) else float(self.home[2])

    @property
    def nq(self) -> int:
        """Size of qpos in the coordinates of this package: 7 for a free base, and 1 per joint."""
        return len(self.joint_names) + (7 if self.floating else 0)

    @property
    def nv(self) -> int:
        """Size of qvel in the coordinates of this package: 6 for a free base, and 1 per joint."""
        return len(self.joint_names) + (6 if self.floating else 0)

    @property
    def nu(self) -> int:
        """Number of joints: the size of all joint vectors. Not the number of MuJoCo's controls."""
        return len(self.joint_names)

    @property
    def gravity(self) -> Array:
        """Gravity (3,) [m/s^2] in the world frame."""
        return acting_gravity(self.before_servos.mj_model)

    @property
    def total_mass(self) -> float:
        """Total mass [kg] of the robot in the URDF's model."""
        return self.structure.total_mass

    @property
    def weight(self) -> float:
        """Weight [N] of the URDF's model in the gravity of the MJCF."""
        return self.total_mass * float(np.linalg.norm(self.gravity))

    @property
    def usual_weight(self) -> float:
        """Weight [N] that scales relative errors: on Earth if the gravity of the MJCF is zero."""
        return self.weight or self.total_mass * EARTH_GRAVITY

    @cached_property
    def structure(self) -> Structure:
        """Pinocchio model with the velocity axes of qvel, and indices of joints, links and feet."""
        return Structure(self.pin_model, self.pin_convention, self.joint_names, self.contact_frames)

    @cached_property
    def acts_at_rest(self) -> bool:
        """Whether the MJCF may exert passive forces at rest, such as spring forces."""
        return acts_at_rest(self.before_servos.mj_model)

    @cached_property
    def closure(self) -> Closure | None:
        """Closed loops and joint couplings of the robot, from the equality constraints of the MJCF.

        None without active constraints, for example (`find_closure`).
        """
        robot = self.before_servos
        return find_closure(robot.mj_model, robot.mj_convention, self.joint_names)

    @cached_property
    def shapes(self) -> tuple[CarriedShape, ...]:
        """Collision shapes of the robot's MuJoCo model, including feet and a fixed base.

        Raises:
            ModelError: If a collision geom has a type without distance computation.
        """
        return shapes_of(
            self.mj_model,
            self.mj_convention,
            self.structure,
            (self.base, self.mj_base),
            self.neutral(),
            self.description.mjcf_source,
        )

    @cached_property
    def _cache(self) -> dict[tuple[Hashable, ...], Any]:
        """Results of ``compute_once``: {(function, further arguments): result}."""
        return {}

    def compute_once(self, make: Callable[..., _T], *given: Hashable) -> _T:
        """Return ``make(robot, *given)``, cached for the lifetime of the robot.

        Args:
            make: Function of the robot and of the arguments ``given``. Its result must not
                reference the robot: a reference cycle would delay the release of memory.
            given: Further arguments of ``make``; hashable. With ``make``, they are the key of the
                cache.
        """
        key = make, *given
        if key not in self._cache:
            self._cache[key] = make(self, *given)
        result: _T = self._cache[key]
        return result

    @property
    def lower_limits(self) -> Array:
        """Lower joint limits (nu,) [rad, m] of ``pin_model``; -inf without a limit.

        These are limits of the URDF. The preparation may narrow them to the range of the joint in
        the MJCF, or add limits to continuous joints.
        """
        return self._select_positions(self.pin_model.lowerPositionLimit, -np.inf)

    @property
    def upper_limits(self) -> Array:
        """Upper joint limits (nu,) [rad, m] of ``pin_model``; inf without a limit.

        Origin: see ``lower_limits``.
        """
        return self._select_positions(self.pin_model.upperPositionLimit, np.inf)

    @property
    def joint_friction(self) -> Array:
        """Dry friction (nu,) [N m, N] of each joint, MuJoCo's ``frictionloss``."""
        friction: Array = self.mj_model.dof_frictionloss[self.mj_convention.qvel_index[-self.nu :]]
        return friction

    @cached_property
    def efforts(self) -> tuple[EffortLimit, ...]:
        """Effort limit of each joint, with its sources, in actuator order.

        In each direction, the tightest bound of both files counts, unless a limit was requested
        (`with_efforts`). If one file was generated from the other, only the limit in the user's
        file is cited, as long as the value is the same.
        """
        robot = self.before_servos
        limits = efforts_of(
            robot.mj_model,
            self.pin_model,
            self.pin_convention,
            self.joint_names,
            robot.description.efforts,
            robot.description.null_efforts,
        )
        generated = robot.description.converted.upper()
        return tuple(limit.without_file(generated) for limit in limits) if generated else limits

    @cached_property
    def effort_ranges(self) -> Array:
        """Minimum and maximum effort of each joint, shape (nu, 2) [N m, N].

        Infinite without a limit. See `efforts` for the source of each limit.
        """
        ranges: Array = np.array([(limit.lower, limit.upper) for limit in self.efforts])
        ranges.flags.writeable = False
        return ranges

    @cached_property
    def effort_limits(self) -> Array:
        """Effort (nu,) [N m, N] that each joint can exert in both directions; inf without a limit.

        The value is min(-lower, upper) of the joint's effort range (`effort_ranges`); values below
        1e-6 (``MIN_EFFORT``) are set to 0.
        """
        limits = np.array([limit.symmetric_torque for limit in self.efforts], dtype=float)
        limits.flags.writeable = False
        return limits

    @property
    def velocity_limits(self) -> Array:
        """Velocity limits (nu,) [rad/s, m/s] of the URDF; inf without a limit.

        The value is 0 if the URDF states 0 or less: the joint may not move.
        """
        limits = known_limits(self.pin_model.velocityLimit[self.pin_convention.v_index])
        found: Array = np.maximum(limits, 0.0)
        return found

    def _select_positions(self, values: Array, unbounded: float) -> Array:
        """Select joint limits (nu,) [rad, m]; ``unbounded`` is the value of continuous joints."""
        limits = np.array(values[self.pin_convention.q_index])
        limits[self.pin_convention.unbounded] = unbounded
        return known_limits(limits)

    def check_not_welded(self, what: str) -> None:
        """Raise an error if a task fixes a part of the robot to the world by a weld or a grip.

        Args:
            what: Name of the analysis that does not support welds, for the message.

        Raises:
            ConfigurationError: If the robot has welds or grips.
        """
        if self.fixed_parts:
            problem = diagnose("robot-is-welded", robot=self.name, what=Term(what))
            raise ConfigurationError("contacts", problem)

    def check_tree(self, what: str) -> None:
        """Raise an error if loops, couplings, welds or grips constrain the robot's kinematic tree.

        Args:
            what: Name of the analysis that requires an unconstrained tree, for the message.

        Raises:
            ConfigurationError: If the robot has loops, couplings, welds or grips.
        """
        self.check_not_welded(what)
        if self.closure is not None:
            bonds = self.closure.constraint_names
            problem = diagnose("robot-has-loops", robot=self.name, bonds=bonds, what=Term(what))
            raise ConfigurationError("robot", problem)

    def check_floating(self, code: str = "base-is-fixed", **values: Any) -> None:
        """Raise an error if the base is fixed: such a robot cannot stand.

        Args:
            code: Code of the diagnostic, with the values ``robot``, ``why`` and ``option``. A tool
                passes its own code, whose text states what the tool accepts.
            **values: Further values of the diagnostic.

        Raises:
            ConfigurationError: If the base is fixed (``code``), or falls (`check_base_is_held`).
            ModelError: If the base is fixed, or the robot has no feet, due to a fault in a model
                file (`MODEL_FAULT_CODES`).
        """
        reasons = (note.values["why"] for note in self.notes if note.code in _NO_STAND_CODES)
        why = next(reasons, None)
        bears = self.floating and (self.contact_points or self.fixed_parts)
        if not bears and isinstance(why, Diagnostic) and why.code in MODEL_FAULT_CODES:
            places = (source_name(Path(place.file), place.line) for place in why.sources)
            raise ModelError(next(places, self.description.urdf_source), why)
        if not self.floating:
            self.check_base_is_held()
            option = is_command_line()
            problem = diagnose(
                code,
                robot=self.name,
                why=why,
                option=option,
                advised=option and why is None,
                plain=why is None,
                **values,
            )
            raise ConfigurationError("robot", problem)

    def check_base_is_held(self) -> None:
        """Raise an error if the base falls along a joint without motor (planar robots).

        Raises:
            ConfigurationError: If the base falls.
        """
        if self.floating:
            return
        model, made = self.before_servos.mj_model, self.before_servos.description.made_servos
        added = {servo.joint for servo in made if servo.instead_of is Drive.NONE}
        falling = list_falling_base_joints(model, added)
        if names := tuple(model.joint(joint).name for joint in falling):
            problem = diagnose("base-moves-on-joints", robot=self.name, joints=names)
            raise ConfigurationError("robot", problem)

    def check_bodies(self) -> None:
        """Raise an error if a moving body has a negative mass or principal moment of inertia.

        A negative moment within rounding is accepted.

        Raises:
            ModelError: If a mass or moment is negative.
        """
        self.compute_once(_check_bodies)

    def describe_masses(self) -> tuple[Quantity, Quantity]:
        """Return the masses of URDF and MJCF [kg]; the same number if equal up to rounding."""
        urdf, mjcf = self.total_mass, float(self.mj_model.body_subtreemass[0])
        return Quantity(urdf, "kg"), Quantity(urdf if math.isclose(urdf, mjcf) else mjcf, "kg")

    def check_total_mass(self, urdf: str | Path) -> None:
        """Raise an error unless the total mass of the URDF's model is positive.

        Args:
            urdf: Path of the URDF, for the error.

        Raises:
            ModelError: If the total mass is zero, negative or not a number. For a negative mass,
                the error names the body if possible (`check_bodies`).
        """
        if self.total_mass < 0:
            self.check_bodies()  # names the body with a negative mass
        if not self.total_mass > 0:
            mass = Quantity(self.total_mass, "kg")
            raise ModelError(urdf, diagnose("robot-without-mass", mass=mass))

    def check_foot(self, foot: str) -> str:
        """Check that a contact point exists, and return its name unchanged.

        Args:
            foot: Name of the contact point.

        Raises:
            UnknownNameError: If there is no such contact point.
        """
        if not isinstance(foot, str) or foot not in self.contact_frames:
            raise UnknownNameError(self.name, "foot", foot, self.contact_points)
        return foot

    def points_of(self, foot: str) -> tuple[str, ...]:
        """Return the names of the contact points of a foot or hand.

        Raises:
            UnknownNameError: If there is no such foot.
        """
        if not isinstance(foot, str) or foot not in self.feet:
            raise UnknownNameError(self.name, "foot", foot, tuple(self.feet))
        return self.feet[foot]

    def foot_of(self, point: str) -> str:
        """Return the name of the foot or hand to which a contact point belongs.

        Raises:
            UnknownNameError: If there is no such contact point.
        """
        for foot, points in self.feet.items():
            if point in points:
                return foot
        raise UnknownNameError(self.name, "foot", point, self.contact_points)

    def feet_with(self, points: Iterable[str]) -> tuple[str, ...]:
        """Return the feet and hands that have at least one of the given contact points.

        Args:
            points: Names of contact points. Other names, such as names of welds, are ignored.

        Raises:
            ConfigurationError: If ``points`` is a text, bytes or no iterable.
        """
        requested = check_names("points", points)  # an element may have no hash
        return tuple(
            foot
            for foot, foot_points in self.feet.items()
            if any(point in requested for point in foot_points)
        )

    def per_foot(self, forces: Mapping[str, Array]) -> dict[str, Array]:
        """Sum the contact forces of each foot over its contact points.

        Args:
            forces: {contact point: force, shape (3,) [N]}, all in the same frame.

        Returns:
            {foot: total force, shape (3,) [N]} for the feet with a contact point in ``forces``.
        """
        return {
            foot: np.sum([forces[point] for point in self.feet[foot] if point in forces], axis=0)
            for foot in self.feet_with(forces)
        }

    def make_qpos(self, joints: Array) -> Array:
        """Return a configuration, shape (nq,), with given joint positions.

        A free base is at the world origin, without rotation.

        Args:
            joints: Joint positions in actuator order, shape (nu,) [rad, m].

        Raises:
            ConfigurationError: If the shape differs, or a position is not a finite number.
        """
        qpos = self.neutral()
        qpos[self.nq - self.nu :] = check_vector("joints", joints, self.nu)
        return qpos

    def compute_kinematics(self, qpos: ArrayLike | None = None) -> mujoco.MjData:
        """Compute body and CoM positions of a configuration with MuJoCo, in new ``MjData``.

        Runs ``mj_kinematics`` and ``mj_comPos``.

        Args:
            qpos: Configuration, shape (nq,); by default ``neutral``.

        Raises:
            ConfigurationError: If the shape differs, or an element is not a finite number.
        """
        state = self.neutral() if qpos is None else check_vector("qpos", qpos, self.nq)
        data = mujoco.MjData(self.mj_model)
        self.mj_convention.set_state(data, state)
        mujoco.mj_kinematics(self.mj_model, data)
        mujoco.mj_comPos(self.mj_model, data)
        return data

    def neutral(self) -> Array:
        """Return the qpos (nq,) with all joints at zero, and a free base at the world origin."""
        qpos = np.zeros(self.nq)
        if self.floating:
            qpos[3] = 1.0
        return qpos


_FIELD_NAMES = frozenset(field.name for field in fields(Robot))
"""Names of the fields of `Robot`."""

_EARLY_FIELDS = (
    *("name", "pin_model", "floating", "base", "mj_base", "joint_names", "pin_convention"),
    *("contact_points", "contact_frames", "contact_radius", "contacts", "feet", "nominal"),
    "stand_height",
    *("imu", "fingerprint", "touching", "bare"),
)
"""Fields of a robot that the postponed preparation steps (`defer_stages`) do not change."""


def defer_stages(
    robot: Robot, complete: Callable[[], Robot], pose: Callable[[], Robot] | None = None
) -> Robot:
    """Return a robot whose remaining preparation steps run at the first use of their results.

    The steps are servo tuning, rest pose and visual meshes. The fields `_EARLY_FIELDS` are taken
    from ``robot``. The first access to another field runs ``complete``.

    Args:
        robot: Robot before the remaining steps.
        complete: Function that runs the remaining steps, and returns the completed robot.
        pose: Function that returns the robot in its start pose, without the postponed steps, for
            stands and statics (`Robot.before_servos`). If None, stands and statics run all steps
            first.
    """
    deferred = object.__new__(Robot)
    vars(deferred).update({name: vars(robot)[name] for name in _EARLY_FIELDS})
    # A copy, because the caller may change the model before the remaining steps use the original.
    vars(deferred)["pin_model"] = robot.pin_model.copy()
    vars(deferred)[_DEFERRED_STAGES] = complete
    if pose is not None:
        vars(deferred)[_BEFORE_SERVOS] = pose
    return deferred


def rename_robot(robot: Robot, name: str) -> Robot:
    """Return a copy of a robot with another name; postponed preparation steps remain postponed.

    The description of the files keeps its name, which written files get.
    """
    renamed = object.__new__(Robot)
    kept = {key: value for key, value in vars(robot).items() if key not in _CACHED_ATTRIBUTES}
    posed = kept.get(_BEFORE_SERVOS)
    if isinstance(posed, Robot):
        kept[_BEFORE_SERVOS] = rename_robot(posed, name)
    vars(renamed).update({**kept, "name": name})
    return renamed


def acts_at_rest(model: mujoco.MjModel) -> bool:
    """Return True if a MuJoCo model may exert passive forces, such as springs, at zero velocity."""
    arrays = ("jnt_stiffness", "jnt_stiffnesspoly", "tendon_stiffness", "tendon_stiffnesspoly")
    return (
        any(getattr(model, name).any() for name in (*arrays, "body_gravcomp"))
        or bool(np.any(model.opt.wind) and (model.opt.density or model.opt.viscosity))
        or model.nflex > 0
        or bool((model.body_plugin >= 0).any())
    )


_NEGATIVE_MOMENT_RTOL = 1e-6
"""Upper bound of the magnitude of a negative moment of inertia that counts as rounding, relative to
the largest moment of the body [1] (`_check_bodies`). Chosen, not tuned."""


def _check_bodies(robot: Robot) -> None:
    """Raise a ModelError if a moving body has a negative mass or moment of inertia."""
    model = robot.pin_model
    for name, inertia in zip(list(model.names)[1:], list(model.inertias)[1:], strict=True):
        moments = np.linalg.eigvalsh(inertia.inertia)
        if inertia.mass < 0 or moments[0] < -_NEGATIVE_MOMENT_RTOL * np.abs(moments).max():
            problem = diagnose(
                "inertial-of-no-body",
                subject=None if name == "root_joint" else ("joint", name),
                joint=None if name == "root_joint" else name,
                mass=Quantity(inertia.mass, "kg"),
                moment=Quantity(moments[0], "kg m^2"),
            )
            raise ModelError(robot.description.urdf_source, problem)


def get_loaded_robot(robot: Robot) -> Robot:
    """Return the robot as it was loaded from files, without later changes such as a payload.

    Changed MuJoCo options remain, for example (`with_options`).
    """
    published = robot.published
    loaded = robot if published is None or published.loaded is None else published.loaded
    return loaded if loaded.bare is None else loaded.bare


def compute_added_mass(robot: Robot) -> float:
    """Return the mass that the robot has in addition to its files, for example a payload [kg]."""
    loaded = get_loaded_robot(robot).total_mass
    return robot.total_mass - loaded if robot.total_mass > loaded * (1 + _MASS_RTOL) else 0.0


_MASS_RTOL = 1e-9
"""Lower bound [1] of the relative increase of the robot's mass since loading, with which the
increase counts as a payload. Smaller increases are rounding errors. Chosen, not tuned."""

_MAX_POOL_SIZE = 8
"""Maximum number of unused objects (for example MuJoCo data) in the pool of all robots (`borrow`).
Chosen, not tuned."""

_pool: list[tuple[Robot, object, Any]] = []
"""(robot, function that created the object, unused object), for all robots (`borrow`). No attribute
of the robot: a reference cycle would delay the release of memory."""

_pool_lock = Lock()
"""Lock of the pools: a single thread at a time may take or return objects."""

_PooledObjects = list[tuple["Robot", object, Any]]

_temporary_pool: ContextVar[_PooledObjects | None] = ContextVar("_temporary_pool", default=None)
"""Pool of `release_borrowed_objects`, which replaces `_pool` in its context; None outside."""


@contextmanager
def release_borrowed_objects() -> Iterator[None]:
    """Context manager: give `borrow` a temporary pool, whose objects are released at the end.

    Use it around code that creates robots for intermediate steps: each object refers to its robot,
    and a compiled model with many meshes may need hundreds of MB.
    """
    token = _temporary_pool.set([])
    try:
        yield
    finally:
        _temporary_pool.reset(token)


@contextmanager
def borrow(robot: Robot, make: Callable[[Robot], _T]) -> Iterator[_T]:
    """Context manager: borrow an object of a robot from a pool, for exclusive use. Thread-safe.

    Use it for objects that are expensive to create, such as MuJoCo data. At the end of the context,
    the object returns to the pool, which keeps a few recently used objects of all robots.

    Args:
        robot: The robot.
        make: Function that creates an object for the robot, for example a class. Together with the
            robot, it is the key of the pool.
    """
    temporary = _temporary_pool.get()
    pool = _pool if temporary is None else temporary
    borrowed = None
    with _pool_lock:
        for index, (owner, maker, candidate) in enumerate(pool):
            if owner is robot and maker == make:  # ==, because bound methods are new objects
                borrowed = candidate
                del pool[index]
                break
    if borrowed is None:
        borrowed = make(robot)
    try:
        yield borrowed
    finally:
        with _pool_lock:
            pool.insert(0, (robot, make, borrowed))
            del pool[_MAX_POOL_SIZE:]
