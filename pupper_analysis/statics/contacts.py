"""The contacts that carry: which feet, where they touch, which way the ground is, its friction."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from numbers import Real

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.arguments import real_array
from pupper_analysis.base.arrays import cross_matrices
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.robot.configuration import UP, Configuration
from pupper_analysis.robot.contact import contact_offset
from pupper_analysis.robot.plane import MOST_FRICTION
from pupper_analysis.robot.robot import Robot
from pupper_analysis.statics.cone_program import BALANCE_TOLERANCE, Balance, TangentialMetric
from pupper_analysis.statics.support_polygon import margin_of_place, support_corners

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Contacts:
    """Contacts of a robot with the ground, wherever the robot is.

    Attributes:
        nv: The robot's degrees of freedom.
        free: Those of its base.
        feet: The n feet that carry.
        normals: (n, 3) out of the ground, unit vectors in the world.
        friction: (n,) coefficients.
        offsets: (n, 3) from each foot's centre to its contact, in the world (m).
        soles: {foot of the robot: which of ``feet``, its contact points, carry}.
        welds: {what is fixed in the world: a contact point on it; None of the base}.
        stated: (k, n) which contacts press together with a force that is stated, and (k,) these
            forces, in weights; None if none is.
        weight: The robot's, with which these count (N).
        grips: (g,) what the last of ``welds`` hold at most (N), by a force alone.
    """

    nv: int
    free: int
    feet: tuple[str, ...]
    normals: Array
    friction: Array
    offsets: Array
    soles: Mapping[str, tuple[str, ...]]
    welds: Mapping[str, str | None] = field(default_factory=dict)
    stated: tuple[Array, Array] | None = None
    weight: float = 0.0
    grips: Array = field(default_factory=lambda: np.zeros(0))

    @functools.cached_property
    def level(self) -> bool:
        """Whether the ground is level under all feet."""
        return bool(np.abs(self.normals - UP).max(initial=0.0) < BALANCE_TOLERANCE)

    def com_margin(self, place: Array, config: Configuration, points: Array) -> float:
        """Returns the distance (m) of a place from the edge of where a com is in balance.

        Args:
            place: (2,) or (3,), seen from above (m).
            config: Where the robot is.
            points: (n, 3) where the contacts are (m).

        Returns:
            The distance; positive inside; minus infinity if the place is not a number; infinite
            with a weld, which holds any.
        """
        if len(self.welds) > len(self.grips):
            return math.inf
        x, y, *_ = place.tolist()
        grips = None
        if self.welds:
            at = config.foot_places([str(point) for point in self.welds.values()])
            grips = np.column_stack([at, self.grips / self.weight])
        if self.level and self.stated is None and grips is None:  # as a rule: nothing else is asked
            corners = tuple([(a, b) for a, b, _ in points.tolist()])
        else:
            friction = self.friction.tolist()
            corners = support_corners(points, self.normals, friction, self.stated, grips)
        return margin_of_place((x, y), corners)

    @functools.cached_property
    def metric(self) -> TangentialMetric:
        """What forces are least by where all feet are as viscous."""
        return TangentialMetric(self.normals)

    @functools.cached_property
    def directions(self) -> dict[str, Array]:
        """{foot: its row of ``normals``}."""
        return dict(zip(self.feet, self.normals, strict=True))

    @functools.cached_property
    def coefficients(self) -> dict[str, float]:
        """{foot: its coefficient of friction}."""
        return dict(zip(self.feet, self.friction.tolist(), strict=True))

    def points(self, config: Configuration) -> Array:
        """Returns where they are (n, 3) in a configuration, in the world (m)."""
        return config.foot_places(self.feet) + self.offsets

    def jacobian(self, config: Configuration) -> Array:
        """Returns J^T (nv, 3 n + 6 w): what generalised force their forces make.

        And the wrenches of welds, force and moment in world axes.
        """
        pushed = (self._moved @ config.foot_twists(self.feet).reshape(-1, self.nv)).T
        return np.hstack([pushed, *self.weld_columns(config).values()]) if self.welds else pushed

    def weld_columns(self, config: Configuration) -> dict[str, Array]:
        """Returns {what is welded: (nv, 6) what its wrench makes; of a grip (nv, 3)}."""
        base = np.eye(6, self.nv)
        base[3:, 3:6] = config.base_rotation()
        sizes = [6] * (len(self.welds) - len(self.grips)) + [3] * len(self.grips)
        return {
            name: (base if point is None else config.foot_twists((point,))[0]).T[:, :size]
            for (name, point), size in zip(self.welds.items(), sizes, strict=True)
        }

    @functools.cached_property
    def _moved(self) -> Array:
        """The matrix (3 n, 6 n) from the twists of feet to the velocities of their contacts."""
        count = len(self.feet)
        moved = np.zeros((count, 3, count, 6))
        each = np.arange(count)
        moved[each, :, each, :3] = np.eye(3)
        moved[each, :, each, 3:] = -cross_matrices(self.offsets)
        return moved.reshape(3 * count, 6 * count)

    def balance(self, transposed: Array, load: Array) -> Balance:
        """Returns the equations of balance.

        Args:
            transposed: (nv, 3 n) see ``jacobian``.
            load: (nv,) what motors and contacts must add up to (N, N m).
        """
        base, weight = transposed[: self.free], load[: self.free]
        if self.stated is not None:
            together, shares = self.stated
            rows = np.zeros((len(shares), transposed.shape[1]))
            along = together[:, :, None] * self.normals
            rows[:, : self.normals.size] = along.reshape(len(rows), -1)
            base, weight = np.vstack([base, rows]), np.concatenate([weight, self.weight * shares])
        return Balance(
            base=base,
            weight=weight,
            joints=transposed[self.free :],
            torques=load[self.free :],
            normals=self.normals,
            grips=self.grips,
        )


def make_contacts(
    robot: Robot,
    contacts: Iterable[str] | None,
    friction: float | Mapping[str, float] | None,
    normals: Mapping[str, ArrayLike] | None,
    depths: Mapping[str, float] | None,
) -> Contacts:
    """Checks what ``gravity_compensation`` is given of contacts; its docstring tells what that is.

    Raises:
        UnknownNameError: If a foot is unknown.
        ConfigurationError: If a friction coefficient or a normal is no such thing, a foot is named
            twice, or a robot with a fixed base is given contacts.
    """
    feet = tuple(robot.bearing if contacts is None and robot.floating else contacts or ())
    if friction is None and normals is None and depths is None:
        return robot.once(_usual, feet)
    return _contacts(robot, feet, friction, normals, depths)


def _usual(robot: Robot, feet: tuple[str, ...]) -> Contacts:
    """Returns the contacts of feet on level ground, which depend on the robot alone."""
    made = _contacts(robot, feet, None, None, None)
    for array in (made.normals, made.friction, made.offsets):
        array.flags.writeable = False
    return made


def _contacts(
    robot: Robot,
    feet: tuple[str, ...],
    friction: float | Mapping[str, float] | None,
    normals: Mapping[str, ArrayLike] | None,
    depths: Mapping[str, float] | None,
) -> Contacts:
    for foot in feet:
        robot.check_foot(foot)
    if len(set(feet)) != len(feet):
        raise ConfigurationError("contacts", diagnose("foot-named-twice", feet=feet))
    if feet and not robot.floating:
        problem = diagnose("fixed-base-carries", robot=robot.name)
        raise ConfigurationError("contacts", problem)
    grips = np.array([*robot.grips.values()])
    if not feet:
        nothing = np.zeros((0, 3))
        free, none = robot.nv - robot.nu, np.zeros(0)
        bare = Contacts(robot.nv, free, feet, nothing, none, nothing, {}, robot.welds)
        return replace(bare, weight=robot.weight, grips=grips)
    for given in (normals, depths, friction):
        for foot in given if isinstance(given, Mapping) else ():
            robot.check_foot(foot)
    out = np.array(
        [
            UP if normals is None or foot not in normals else _normal(foot, normals[foot])
            for foot in feet
        ]
    )
    radii = [robot.contact_radius[foot] for foot in feet]
    soles = {
        foot: tuple(name for name in names if name in feet) for foot, names in robot.feet.items()
    }
    return Contacts(
        nv=robot.nv,
        free=robot.nv - robot.nu,
        feet=feet,
        normals=out,
        friction=np.array([_friction(robot, foot, friction) for foot in feet]),
        offsets=contact_offset(radii, out, [(depths or {}).get(foot, 0.0) for foot in feet]),
        soles={foot: own for foot, own in soles.items() if own},
        welds=robot.welds,
        stated=stated_forces(robot, feet),
        weight=robot.weight if robot.touching else 0.0,
        grips=grips,
    )


def stated_forces(robot: Robot, feet: Sequence[str]) -> tuple[Array, Array] | None:
    """Returns the forces that contacts are to press with, if some are stated; see ``Contacts``."""
    forces = {name: one.force for name, one in robot.touching.items() if one.force is not None}
    rows = {name: [float(point in robot.feet[name]) for point in feet] for name in forces}
    pressing = [name for name in forces if any(rows[name])]
    if not pressing:
        return None
    given = np.array([forces[name] for name in pressing])
    return np.array([rows[name] for name in pressing]), given / robot.weight


def gripped_places(robot: Robot, places: Mapping[str, Array]) -> Array | None:
    """Returns where grips are and what they hold (g, 4) (m, weights), of {point: (3,)}; or None."""
    held = [(*places[robot.feet[of][0]], grip / robot.weight) for of, grip in robot.grips.items()]
    return np.array(held) if held else None


def _normal(foot: str, normal: ArrayLike) -> Array:
    vector = real_array("normals", normal)
    if vector.shape != (3,) or not np.isfinite(vector).all() or not vector.any():
        problem = diagnose("normal-not-a-direction", subject=("foot", foot), given=repr(normal))
        raise ConfigurationError("normals", problem)
    unit: Array = vector / np.linalg.norm(vector)
    return unit


def _friction(robot: Robot, foot: str, friction: float | Mapping[str, float] | None) -> float:
    if friction is None:
        if foot not in robot.contacts:
            raise ConfigurationError("friction", diagnose("ground-missing", robot=robot.name))
        return robot.contacts[foot].sliding_friction
    value: object = friction.get(foot) if isinstance(friction, Mapping) else friction
    if not isinstance(value, Real) or not 0 <= float(value) <= MOST_FRICTION:
        problem = diagnose(
            "friction-not-a-coefficient",
            subject=("foot", foot),
            given=str(value),
            most=MOST_FRICTION,
        )
        raise ConfigurationError("friction", problem)
    return float(value)
