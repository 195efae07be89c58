"""Support region: horizontal CoM positions for which friction and motors permit equilibrium.

Bretl and Lall 2008, "Testing static equilibrium for legged robots", define the region with
friction. Torque limits are added as in Orsolino et al. 2020, "Feasible region: an actuation-aware
extension of the support region".
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.base.results import Tabular
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.statics.contacts import Contacts, make_contacts_in
from pupper_analysis.statics.support_polygon import (
    find_extreme_positions,
    margin_of_position,
    support_corners,
)

_COLLINEAR_TOLERANCE = 1e-7
"""Largest distance [m] of a corner from the line between its neighbours with which the corner
counts as inside a side. Chosen, not tuned."""


REGION_TOLERANCE = 1e-5
"""Largest distance [m] between the computed polygon and the support region. Further directions are
tested until this bound is reached: with 48 fixed directions the distance was up to 0.3 mm (Pupper
v3, random slopes of the contacts). Chosen, not tuned."""


@dataclass(frozen=True, eq=False)
class SupportRegion(Tabular):
    """Horizontal CoM positions for which contact forces in equilibrium exist.

    Attributes:
        corners: Corners of the region in the world, counter-clockwise, shape (n, 2) (m). A line has
            two or three corners, a point has one corner. n is 0 if no CoM position permits
            equilibrium.
        area: Area of the region (m^2).
        center_of_mass: Horizontal position of the CoM in the world, shape (2,) (m).
        com_margin: Distance from the CoM to the edge of the region (m): positive inside, negative
            outside, minus infinity for a region without corners.
        torque_limits: Whether the motors also keep within their effort limits.
    """

    _key_fields: ClassVar[tuple[str, ...]] = ("area", "com_margin")
    _units_of_columns: ClassVar[dict[str, str]] = {"x": "m", "y": "m"}

    corners: Array = field(metadata={"unit": "m"})
    area: float = field(metadata={"unit": "m^2"})
    center_of_mass: Array = field(metadata={"unit": "m"})
    com_margin: float = field(metadata={"unit": "m"})
    torque_limits: bool

    def _columns(self) -> dict[str, ArrayLike]:
        """Return {"x", "y": coordinates [m]}, the columns of a table with a row per corner."""
        return dict(zip(("x", "y"), self.corners.T, strict=True))


@check_arguments
def support_region(
    config: Configuration,
    contacts: Iterable[str] | None = None,
    *,
    friction: float | Mapping[str, float] | None = None,
    normals: Mapping[str, ArrayLike] | None = None,
    depths: Mapping[str, float] | None = None,
    torque_limits: bool = True,
) -> SupportRegion:
    """Compute the horizontal CoM positions for which the contacts can carry the robot.

    Joint positions and weight are taken from the configuration. Only the CoM is varied, as if mass
    were moved inside the base. This does not change the loads of the joints. A CoM position belongs
    to the region if forces f in the friction cones of the contact points p satisfy

        sum f = m g e_z,    sum p x f = m g com x e_z,

    and if the sum of the normal forces is at most `MAX_TOTAL_NORMAL_FORCE` weights. If
    ``torque_limits`` is True, the joint torques l - J^T f must also be within the effort limits. l
    is the static load, and J is the Jacobian of the contact points.

    On level ground without torque limits and prescribed forces, the region is the convex hull of
    the contact points. Otherwise the result is a polygon inside the region, up to rounding; its
    edge is within 0.01 mm of the region's edge, if no cone program fails.

    Args:
        config: State of the robot. The velocity is ignored.
        contacts: Contact points that carry load. Default: `Robot.bearing_points`.
        friction: Friction coefficient, for all contact points or per contact point. Default:
            MuJoCo's contact.
        normals: Per contact point, a direction out of the ground, shape (3,), in the world frame.
            Default: upward.
        depths: Per contact point, penetration into the ground [m], which moves the point of
            contact. Default: 0.
        torque_limits: Whether effort limits restrict the region.

    Raises:
        UnknownNameError: If a contact point is unknown.
        ConfigurationError: If a friction coefficient, normal or depth is invalid, the base is
            fixed, or an effort limit that is needed is unknown, for example. Also if contact points
            that carry load by default are not on level ground.
    """
    robot = config.robot
    robot.check_floating()
    robot.check_not_welded("the support region")
    carrying = make_contacts_in(config, contacts, friction, normals, depths)
    if not carrying.feet:
        raise ConfigurationError("contacts", diagnose("region-without-contacts"))
    points = carrying.points(config)
    is_level = carrying.is_level and carrying.stated is None
    if is_level and not torque_limits:
        found = support_corners(points, carrying.normals, ())
    else:
        inequalities = _limit_torques(config, carrying) if torque_limits else None
        found = find_extreme_positions(
            points,
            carrying.normals,
            carrying.friction,
            carrying.stated,
            np.zeros((0, 4)),
            inequalities,
            REGION_TOLERANCE,
        )
    com = config.center_of_mass()[:2]
    corners = _make_polygon(found)
    x, y = np.vstack([corners, corners[:1]]).T
    return SupportRegion(
        corners=corners,
        area=float(x[:-1] @ y[1:] - x[1:] @ y[:-1]) / 2,
        center_of_mass=com,
        com_margin=margin_of_position((float(com[0]), float(com[1])), found) if found else -np.inf,
        torque_limits=torque_limits,
    )


def _limit_torques(config: Configuration, carrying: Contacts) -> tuple[Array, Array]:
    """Return A (m, size), b (m,) with A f <= b for effort limits; forces f in robot weights."""
    robot = config.robot
    limits, first = robot.effort_limits, robot.nv - robot.nu
    motors = np.ones(robot.nu, dtype=bool)
    if robot.closure is not None:
        motors[robot.closure.dependent_joints] = (
            False  # dependent joints have no motor of their own
        )
    unknown = [robot.joint_names[index] for index in np.flatnonzero(motors & np.isinf(limits))]
    if unknown:
        raise ConfigurationError("torque_limits", diagnose("region-limits-unknown", joints=unknown))
    load = config.transfer_to_motors(config.static_load())[first:][motors]
    rows = (
        robot.weight
        * config.transfer_to_motors(carrying.transposed_jacobian(config))[first:][motors]
    )
    kept = limits[motors]
    upper = np.concatenate([kept + load, kept - load])
    # In units of the limits, so that all rows have the same size.
    scale = np.tile(np.where(kept > 0, kept, 1.0), 2)
    return np.concatenate([rows, -rows]) / scale[:, None], upper / scale


def _make_polygon(positions: Iterable[tuple[float, float]]) -> Array:
    """Compute the corners (n, 2) [m] of the convex hull of positions, counter-clockwise."""
    import shapely  # slow to import

    hull = shapely.MultiPoint(list(positions)).convex_hull
    if hull.is_empty:
        return np.zeros((0, 2))
    if hull.geom_type != "Polygon":
        return np.array(hull.coords)
    ring = shapely.get_coordinates(shapely.geometry.polygon.orient(hull).exterior)[:-1]
    corners = list(ring)
    index = 0
    while index < len(corners) and len(corners) > 3:
        previous, following = corners[index - 1], corners[(index + 1) % len(corners)]
        if shapely.Point(corners[index]).distance(shapely.LineString([previous, following])) > (
            _COLLINEAR_TOLERANCE
        ):
            index += 1
        else:
            del corners[index]
    return np.array(corners)
