"""Contacts of a robot with the ground: positions, normals, friction, and Jacobian.

`make_contacts` validates the contacts that a caller requests. `Contacts.transposed_jacobian` and
`Contacts.balance` provide the equations of static equilibrium that `cone_program.Balance` solves.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from numbers import Real

import numpy as np
from numpy.typing import ArrayLike

from pupper_analysis.base.arguments import MAX_LENGTH, check_direction, check_length
from pupper_analysis.base.array_types import Array
from pupper_analysis.base.arrays import cross_matrices
from pupper_analysis.base.diagnostics import Quantity, diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.robot.configuration import UP, Configuration
from pupper_analysis.robot.contact import contact_offset
from pupper_analysis.robot.plane import MAX_FRICTION
from pupper_analysis.robot.robot import Robot
from pupper_analysis.statics.cone_program import BALANCE_TOLERANCE, Balance, TangentialMetric
from pupper_analysis.statics.support_polygon import margin_of_position, support_corners


@dataclass(frozen=True, eq=False)
class Contacts:
    """Contacts of a robot with the ground, with welds and grips, independent of the configuration.

    Attributes:
        nv: Number of degrees of freedom of the robot.
        free: Number of degrees of freedom of the base.
        feet: Names of the n contact points that carry load.
        normals: Shape (n, 3); unit vectors out of the ground, in the world frame.
        friction: Shape (n,); friction coefficients.
        offsets: Shape (n, 3) [m]; vectors from the centre of each contact point's sphere to the
            contact, in the world frame.
        soles: {foot that carries load: names of its contact points in ``feet``}.
        fixed_parts: {welded or gripping part: contact point on the part; None for the base}. The
            last len(``grips``) entries are grips.
        stated: Normal forces that the task prescribes for groups of contacts; None if no force is
            prescribed. The first array, shape (k, n), is 1.0 if a contact belongs to a group, else
            0.0. The second array, shape (k,), contains the total normal force of each group, in
            units of the robot's weight.
        weight: Weight of the robot [N], the unit of ``stated``. May be 0 if no stand task adds
            contacts, since ``stated`` is then None.
        grips: Shape (g,) [N]; upper bound of the force of each grip.
    """

    nv: int
    free: int
    feet: tuple[str, ...]
    normals: Array
    friction: Array
    offsets: Array
    soles: Mapping[str, tuple[str, ...]]
    fixed_parts: Mapping[str, str | None] = field(default_factory=dict)
    stated: tuple[Array, Array] | None = None
    weight: float = 0.0
    grips: Array = field(default_factory=lambda: np.zeros(0))

    @functools.cached_property
    def is_level(self) -> bool:
        """Whether all contact normals point upward (each component within `BALANCE_TOLERANCE`)."""
        return bool(np.abs(self.normals - UP).max(initial=0.0) < BALANCE_TOLERANCE)

    def com_margin(self, place: Array, config: Configuration, points: Array) -> float:
        """Compute the horizontal distance from the CoM to the edge of the support region.

        `support_corners` defines the support region of these contacts.

        Args:
            place: Shape (2,) or (3,) [m]; the CoM or zero-moment point in the world frame.
            config: State of the robot, from which the positions of grips are computed.
            points: Shape (n, 3) [m]; positions of these contacts in the world frame.

        Returns:
            Distance [m]: positive inside, negative outside. Infinity if a part is welded, since a
            weld holds any CoM. Otherwise minus infinity if a horizontal coordinate of ``place`` is
            not finite. NaN if the region has no points.
        """
        if len(self.fixed_parts) > len(self.grips):
            return math.inf
        x, y, *_ = place.tolist()
        grips = None
        if self.fixed_parts:
            grip_points = config.foot_centres([str(point) for point in self.fixed_parts.values()])
            grips = np.column_stack([grip_points, self.grips / self.weight])
        if (
            self.is_level and self.stated is None and grips is None
        ):  # the usual case, without a cache
            corners = tuple([(a, b) for a, b, _ in points.tolist()])
        else:
            friction = self.friction.tolist()
            corners = support_corners(points, self.normals, friction, self.stated, grips)
        return margin_of_position((x, y), corners)

    @functools.cached_property
    def metric(self) -> TangentialMetric:
        """Weights of the norm of forces that `ForceDistribution.MIN_TANGENTIAL` minimises first.

        All contacts have equal weights.
        """
        return TangentialMetric(self.normals)

    @functools.cached_property
    def directions(self) -> dict[str, Array]:
        """``{contact point: unit normal out of the ground, shape (3,)}``."""
        return dict(zip(self.feet, self.normals, strict=True))

    @functools.cached_property
    def coefficients(self) -> dict[str, float]:
        """``{contact point: friction coefficient}``."""
        return dict(zip(self.feet, self.friction.tolist(), strict=True))

    def points(self, config: Configuration) -> Array:
        """Return the positions of the contacts, shape (n, 3) [m], in the world frame."""
        return config.foot_centres(self.feet) + self.offsets

    def transposed_jacobian(self, config: Configuration) -> Array:
        """Compute the transposed Jacobian J^T of n contacts, w welds and g grips.

        Returns:
            Shape (nv, 3 n + 6 w + 3 g). Its product with a vector f is the generalised force dual
            to ``qvel``. f contains contact forces [N], weld wrenches [N, N m] and grip forces [N],
            in this order and in world axes.
        """
        twists = config.foot_twist_jacobians(self.feet).reshape(-1, self.nv)
        contacts = (self._twist_to_velocity @ twists).T
        if not self.fixed_parts:
            return contacts
        return np.hstack([contacts, *self.weld_columns(config).values()])

    def weld_columns(self, config: Configuration) -> dict[str, Array]:
        """Compute {part: transposed Jacobian} of each weld, (nv, 6), and of each grip, (nv, 3).

        Columns of a weld are force [N] and moment [N m], those of a grip the force [N], in world
        axes. The moment is about the origin of the base, or the sphere centre of the contact point
        in ``fixed_parts``.
        """
        base = np.eye(6, self.nv)
        base[3:, 3:6] = config.base_rotation()
        sizes = [6] * (len(self.fixed_parts) - len(self.grips)) + [3] * len(self.grips)
        return {
            name: (base if point is None else config.foot_twist_jacobians((point,))[0]).T[:, :size]
            for (name, point), size in zip(self.fixed_parts.items(), sizes, strict=True)
        }

    @functools.cached_property
    def _twist_to_velocity(self) -> Array:
        """Matrix (3 n, 6 n) from twists at sphere centres to velocities of contacts, world axes."""
        count = len(self.feet)
        matrix = np.zeros((count, 3, count, 6))
        index = np.arange(count)
        matrix[index, :, index, :3] = np.eye(3)
        matrix[index, :, index, 3:] = -cross_matrices(self.offsets)
        return matrix.reshape(3 * count, 6 * count)

    def balance(self, transposed: Array, load: Array) -> Balance:
        """Return the equations of equilibrium of a load with contact forces and motor torques.

        Prescribed normal forces (`stated`) are further equations.

        Args:
            transposed: Transposed Jacobian, shape (nv, 3 n + 6 w + 3 g), from
                ``transposed_jacobian``; possibly after `Configuration.transfer_to_motors`.
            load: Shape (nv,) [N, N m]; generalised force that motors and contacts must produce.
        """
        base, base_load = transposed[: self.free], load[: self.free]
        if self.stated is not None:
            groups, forces = self.stated
            rows = np.zeros((len(forces), transposed.shape[1]))
            normals = groups[:, :, None] * self.normals
            rows[:, : self.normals.size] = normals.reshape(len(rows), -1)
            base = np.vstack([base, rows])
            base_load = np.concatenate([base_load, self.weight * forces])
        return Balance(
            base_rows=base,
            base_load=base_load,
            joint_rows=transposed[self.free :],
            joint_load=load[self.free :],
            normals=self.normals,
            grips=self.grips,
        )


MAX_DEFAULT_INCLINATION = 0.02
"""Upper bound of the height range of contact points that carry load by default on level ground,
relative to their largest horizontal distance. Derived from statics: on a plane with this
inclination, level ground changes the contact forces by about 2 % of the weight. Simulated stands of
eight robots on soft level ground have at most 0.0007."""


def make_contacts_in(
    config: Configuration,
    contacts: Iterable[str] | None,
    friction: float | Mapping[str, float] | None,
    normals: Mapping[str, ArrayLike] | None,
    depths: Mapping[str, float] | None,
) -> Contacts:
    """Create the contacts of a configuration (`make_contacts`), and check that these are level.

    A configuration does not contain the ground. By default the contact points of `make_contacts`
    carry load, with upward normals. The check applies if ``contacts`` is None and a contact point
    has no normal.

    Raises:
        UnknownNameError: If a contact point is unknown.
        ConfigurationError: If contact points that carry load by default are not on level ground
            (`MAX_DEFAULT_INCLINATION`), or as for `make_contacts`.
    """
    carrying = make_contacts(config.robot, contacts, friction, normals, depths)
    have_normals = normals is not None and all(foot in normals for foot in carrying.feet)
    if contacts is None and carrying.feet and not have_normals:
        _check_level_ground(carrying, config)
    return carrying


def _check_level_ground(carrying: Contacts, config: Configuration) -> None:
    """Raise a ConfigurationError if the contact points are not on level ground."""
    points = carrying.points(config)
    heights = points[:, 2].tolist()
    lowest, highest = min(heights), max(heights)
    if highest - lowest <= BALANCE_TOLERANCE:  # saves the distances of most stands
        return
    distances = np.linalg.norm(points[:, None, :2] - points[:, :2], axis=2)
    most = max(BALANCE_TOLERANCE, MAX_DEFAULT_INCLINATION * float(distances.max()))
    if highest - lowest <= most:
        return
    feet = carrying.feet
    low = [foot for foot, height in zip(feet, heights, strict=True) if height <= lowest + most]
    problem = diagnose(
        "contacts-not-level",
        highest=feet[heights.index(highest)],
        height=Quantity(highest - lowest, "m"),
        lowest=feet[heights.index(lowest)],
        carrying=str(low if len(low) >= _MIN_SUPPORTS else list(feet)),
    )
    raise ConfigurationError("contacts", problem)


_MIN_SUPPORTS = 3
"""Number of contact points that a support polygon needs. With fewer points at one height, the
message about default contacts proposes all contact points."""


def make_contacts(
    robot: Robot,
    contacts: Iterable[str] | None,
    friction: float | Mapping[str, float] | None,
    normals: Mapping[str, ArrayLike] | None,
    depths: Mapping[str, float] | None,
) -> Contacts:
    """Validate the contact arguments of `gravity_compensation`, and create the contacts.

    Args:
        robot: Robot.
        contacts: Contact points that carry load. None: `Robot.bearing_points` for a free base, no
            contact points for a fixed base.
        friction: Friction coefficient [1] of all contact points, or {contact point: coefficient}
            for all of ``contacts``. None: the coefficients of MuJoCo's contacts.
        normals: {contact point: direction out of the ground, shape (3,), in the world frame}. The
            default of a contact point is vertical.
        depths: {contact point: penetration into the ground [m]}. The default is 0.

    Raises:
        UnknownNameError: If a contact point is unknown.
        ConfigurationError: If a friction coefficient, normal or depth is invalid, the ground's
            friction is unknown, or a robot with a fixed base has contacts, for example.
    """
    feet = tuple(robot.bearing_points if contacts is None and robot.floating else contacts or ())
    if friction is None and normals is None and depths is None:
        return robot.compute_once(_make_default_contacts, feet)
    return _make_contacts(robot, feet, friction, normals, depths)


def _make_default_contacts(robot: Robot, feet: tuple[str, ...]) -> Contacts:
    """Create contacts on level ground with MuJoCo's friction, and read-only arrays for a cache."""
    contacts = _make_contacts(robot, feet, None, None, None)
    for array in (contacts.normals, contacts.friction, contacts.offsets):
        array.flags.writeable = False
    return contacts


def _make_contacts(
    robot: Robot,
    feet: tuple[str, ...],
    friction: float | Mapping[str, float] | None,
    normals: Mapping[str, ArrayLike] | None,
    depths: Mapping[str, float] | None,
) -> Contacts:
    """Create the contacts of named contact points; see `make_contacts` for the arguments."""
    for foot in feet:
        robot.check_foot(foot)
    if len(set(feet)) != len(feet):
        raise ConfigurationError("contacts", diagnose("foot-named-twice", feet=feet))
    if feet and not robot.floating:
        problem = diagnose("fixed-base-carries", robot=robot.name)
        raise ConfigurationError("contacts", problem)
    grips = np.array([*robot.grips.values()])
    if not feet:
        empty = np.zeros((0, 3))
        free, no_friction = robot.nv - robot.nu, np.zeros(0)
        contacts = Contacts(robot.nv, free, feet, empty, no_friction, empty, {}, robot.fixed_parts)
        return replace(contacts, weight=robot.weight, grips=grips)
    for values in (normals, depths, friction):
        for foot in values if isinstance(values, Mapping) else ():
            robot.check_foot(foot)
    unit_normals = np.array(
        [
            UP
            if normals is None or foot not in normals
            else check_direction(f"normals[{foot}]", normals[foot])
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
        normals=unit_normals,
        friction=np.array([_friction_of(robot, foot, friction) for foot in feet]),
        offsets=contact_offset(radii, unit_normals, _list_depths(feet, depths)),
        soles={foot: names for foot, names in soles.items() if names},
        fixed_parts=robot.fixed_parts,
        stated=prescribed_forces(robot, feet),
        weight=robot.weight if robot.touching else 0.0,
        grips=grips,
    )


def _list_depths(feet: tuple[str, ...], depths: Mapping[str, float] | None) -> list[float]:
    """Return the penetration [m] of each contact point (default 0), after a check of the values."""
    listed = [(depths or {}).get(foot, 0.0) for foot in feet]
    try:
        if math.hypot(*listed) <= MAX_LENGTH:  # faster than a check of each; False for NaN
            return listed
    except (TypeError, ValueError, OverflowError):
        pass
    return [
        check_length(f"depths[{foot}]", value) for foot, value in zip(feet, listed, strict=True)
    ]


def prescribed_forces(robot: Robot, feet: Sequence[str]) -> tuple[Array, Array] | None:
    """Return the normal forces that the stand task prescribes for feet, as groups and totals.

    Args:
        robot: Robot with the contacts of a task.
        feet: Names of the n contact points that carry load.

    Returns:
        Groups, shape (k, n), and total normal forces of the groups, shape (k,), in units of the
        robot's weight. Element (i, j) of the groups is 1.0 if contact point j belongs to the foot
        with prescribed force i, else 0.0. None if no force of these feet is prescribed.
    """
    forces = {
        name: contact.force for name, contact in robot.touching.items() if contact.force is not None
    }
    rows = {name: [float(point in robot.feet[name]) for point in feet] for name in forces}
    names = [name for name in forces if any(rows[name])]
    if not names:
        return None
    newtons = np.array([forces[name] for name in names])
    return np.array([rows[name] for name in names]), newtons / robot.weight


def list_grips(robot: Robot, places: Mapping[str, Array]) -> Array | None:
    """Return position [m] and force limit of each grip; None if the robot has no grips.

    A grip is a foot or hand that holds on to its contact point: it can pull as well as push.

    Args:
        robot: Robot.
        places: {contact point: position, shape (3,) [m], in the world frame}.

    Returns:
        Shape (g, 4), a row per gripping foot: position [m] of the first contact point in the world
        frame, and maximum force in units of the robot's weight.
    """
    rows = [
        (*places[robot.feet[foot][0]], limit / robot.weight) for foot, limit in robot.grips.items()
    ]
    return np.array(rows) if rows else None


def _friction_of(robot: Robot, foot: str, friction: float | Mapping[str, float] | None) -> float:
    """Check and return the friction coefficient of a contact point; default: MuJoCo's value."""
    if friction is None:
        if foot not in robot.contacts:
            raise ConfigurationError("friction", diagnose("ground-missing", robot=robot.name))
        return robot.contacts[foot].sliding_friction
    value: object = friction.get(foot) if isinstance(friction, Mapping) else friction
    if not isinstance(value, Real) or not 0 <= float(value) <= MAX_FRICTION:
        problem = diagnose(
            "friction-not-a-coefficient",
            subject=("foot", foot),
            given=str(value),
            most=MAX_FRICTION,
        )
        raise ConfigurationError("friction", problem)
    return float(value)
