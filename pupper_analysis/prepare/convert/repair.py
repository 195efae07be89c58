"""Make the inertials of a URDF valid for MuJoCo: move to fixed neighbours, or repair.

Input is a URDF with inertials that MuJoCo refuses, for example because the principal moments
violate the triangle inequality A + B >= C. An invalid inertial is first added to the inertial of a
link to which fixed joints connect the link. This changes no motion. If no sum is valid, valid
moments may replace the invalid moments (`find_nearest_moments`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Final

import numpy as np
import pinocchio as pin

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.arrays import make_inertia
from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.base.errors import ModelError
from pupper_analysis.base.results import Result
from pupper_analysis.models.places import make_file_error
from pupper_analysis.models.urdf_file import UrdfFile
from pupper_analysis.models.urdf_tree import WORLD_LINK, UrdfTree, origin_of, set_origin
from pupper_analysis.models.xml import NUM_DIGITS, parse_text, to_text

_TRIANGLE_RTOL: Final = 1e-12
"""Relative tolerance [1] with which principal moments A <= B <= C of a valid inertial satisfy
A + B >= C. The tolerance covers rounding of the eigenvalues."""

_MIN_INERTIA: Final = 1e-14
"""Lower bound of the principal moments of inertia [kg m^2] of a valid inertial with mass. Chosen as
ten times MuJoCo's bound."""

_FLAT_MARGIN: Final = 1e-11
"""Margin of A + B >= C, relative to the largest moment C. If rounding may violate the inequality
for a flat body, all moments are enlarged by this part of C. Chosen above the rounding of
eigenvalues (1e-15) and below the tolerance of comparisons (1e-9)."""

ADDED_MASS: Final = 1e-3
"""Mass [kg] of a moving link that has no mass in the URDF, if no link fixed to this link has a
mass. MuJoCo would refuse such a link; helper links of exporters often have no mass. Chosen, not
tuned."""

_GYRATION_RADIUS: Final = 0.01
"""Radius of gyration [m] of a repaired link whose moments of inertia in the URDF are all at most
`_MIN_INERTIA`. Chosen as that of a ball with a radius of 16 mm.
"""

_TRIANGLE_MARGIN: Final = 1e-6
"""Relative margin [1] with which repaired principal moments satisfy A + B >= C. Chosen larger than
the rounding to the written digits."""


@dataclass(frozen=True)
class Repair(Result):
    """Inertial of a URDF that MuJoCo would refuse, with its valid replacement.

    Attributes:
        link: Name of the link.
        body: Joint that moves the link, or the base link.
        mass: Mass in the URDF.
        moments: Principal moments in the URDF.
        new_mass: Written mass.
        new_moments: Written principal moments; the axes are unchanged.
    """

    link: str
    body: str
    mass: float = field(metadata={"unit": "kg"})
    moments: tuple[float, float, float] = field(metadata={"unit": "kg m^2"})
    new_mass: float = field(metadata={"unit": "kg"})
    new_moments: tuple[float, float, float] = field(metadata={"unit": "kg m^2"})

    @property
    def diagnostic(self) -> Diagnostic:
        """Message about the repair of this link's mass or moments of inertia."""
        link = "link", self.link
        if not self.mass > 0:
            return diagnose("mass-given", subject=link, mass=Quantity(self.new_mass, "kg"))
        moments, before = self.new_moments, self.moments
        return diagnose("inertia-repaired", subject=link, moments=moments, before=before)


@dataclass(frozen=True, eq=False)
class LinkBodies:
    """Links of a URDF as bodies of the converted MJCF, with methods to find fixed neighbours.

    Attributes:
        tree: Links and joints of the URDF, changed in place.
        free: True if the base is free in the MJCF.
    """

    tree: UrdfTree
    free: bool

    @property
    def names(self) -> list[str]:
        """Names of the links that become MJCF bodies, parents first, without the world link."""
        base = self.tree.base.name
        return [name for name in self.tree.subtree(base) if name != base or base != WORLD_LINK]

    def parent(self, body: str) -> str | None:
        """Return the name of the parent body.

        None for the base. None also for a child of a root link ``world``.
        """
        above = self.tree.parent(body)
        return None if above == self.tree.base.name == WORLD_LINK else above

    def can_move(self, body: str) -> bool:
        """Return True if a body can move relative to the parent body, or is a free base."""
        joint = self.tree.parent_joints.get(body)
        return self.free if joint is None else not joint.is_fixed

    def inertia(self, body: str) -> pin.Inertia | None:
        """Return the spatial inertia of a body, or None if the URDF link has no ``<inertial>``.

        The spatial inertia [kg, m, kg m^2] is expressed in the frame of the link.
        """
        return self.tree.links[body].inertia

    def is_carried(self, body: str) -> bool:
        """Return True if a body is fixed to its parent body, and the parent is not the world."""
        return not self.can_move(body) and self.parent(body) is not None

    def fixed_group(self, body: str) -> Iterator[tuple[str, pin.SE3]]:
        """Yield (name, pose) for a body, and for all bodies fixed to this body, nearest first.

        The pose is that of the frame of ``body``, expressed in the frame of the yielded body. The
        nearest body is that with the fewest fixed joints in between.
        """
        known, waiting = {body}, [(body, pin.SE3.Identity())]
        while waiting:
            current, placement = waiting.pop(0)
            yield current, placement
            below = [joint for joint in self.tree.child_joints.get(current, ()) if joint.is_fixed]
            neighbours = [(joint.child, joint.origin.inverse()) for joint in below]
            if self.is_carried(current):
                joint = self.tree.parent_joints[current]
                neighbours.insert(0, (joint.parent, joint.origin))
            for neighbour, offset in neighbours:
                if neighbour not in known:
                    known.add(neighbour)
                    waiting.append((neighbour, offset * placement))


def repair_inertials(
    urdf: UrdfFile, bodies: LinkBodies, *, repair: bool
) -> tuple[list[Diagnostic], list[Repair]]:
    """Move or repair the inertials of a URDF that MuJoCo would refuse, in place.

    An invalid inertial is added to the inertial of a link to which fixed joints connect the link:
    this changes no motion. If no such sum is valid, `find_nearest_moments` may give new moments. A
    moving body gets `ADDED_MASS` if neither this body nor a body fixed to it has a mass.

    Args:
        urdf: URDF as read.
        bodies: Bodies of the URDF.
        repair: True to change invalid moments and masses; False to raise an error instead.

    Returns:
        Notes on moved inertials, and repairs.

    Raises:
        ModelError: If a repair is necessary, and ``repair`` is False.
    """
    moved: list[Diagnostic] = []
    repairs: list[Repair] = []
    for body in bodies.names:
        inertia = bodies.inertia(body)
        if inertia is not None and not (inertia.mass or np.any(inertia.inertia)):
            bodies.tree.links[body].remove("inertial")  # all values are zero
    for body in bodies.names:
        inertia = bodies.inertia(body)
        if inertia is None or is_valid_inertia(inertia):
            continue
        note = _move_inertia(bodies, body, inertia)
        if note is not None:
            moved.append(note)
        elif repair and inertia.mass > 0:
            repairs.append(_repair_inertia(bodies, body))
        elif inertia.mass > 0:
            raise _make_inertia_error(urdf, body, inertia)
    for body in bodies.names:
        if bodies.can_move(body) and not _has_group_mass(bodies, body):
            if not repair:
                raise _make_mass_error(urdf, body)
            repairs.append(_repair_inertia(bodies, body))
    for body in bodies.names:
        _widen_flat_inertia(bodies, body)
    return moved, repairs


def write_repairs(urdf: UrdfFile, bodies: LinkBodies, repairs: list[Repair]) -> UrdfFile:
    """Return a copy of a URDF that contains the repaired and the moved inertials.

    A repaired link may also carry the mass of a fixed link, which has lost its own inertial.

    Args:
        urdf: URDF as read.
        bodies: Bodies with the repaired and moved inertials.
        repairs: Repairs; without repairs, ``urdf`` itself is returned.
    """
    if not repairs:
        return urdf
    root = parse_text(urdf.text)
    links = UrdfTree(root).links
    for name in bodies.names:
        inertia = bodies.inertia(name)
        if inertia is None:
            links[name].remove("inertial")
        elif inertia != links[name].inertia:
            links[name].set_inertia(inertia)
    return replace(urdf, text=to_text(root), root=root)


def is_valid_inertia(inertia: pin.Inertia) -> bool:
    """Return True if a spatial inertia is valid for MuJoCo, or zero.

    The principal moments of a mass must exceed `_MIN_INERTIA` and satisfy A + B >= C.
    """
    if inertia.mass <= 0:
        return inertia.mass == 0 and not np.array(inertia.inertia).any()
    low, middle, high = np.linalg.eigvalsh(np.array(inertia.inertia))
    return bool(low > _MIN_INERTIA and low + middle >= high * (1 - _TRIANGLE_RTOL))


def find_nearest_moments(moments: Array, mass: float) -> Array:
    """Compute the valid principal moments, shape (3,) [kg m^2], nearest to invalid moments.

    Negative moments count as zero. The moments are projected on those that satisfy A + B >= C
    (`_project_moments`). If no moment exceeds `_MIN_INERTIA`, all moments become m r^2, with the
    radius of gyration r, `_GYRATION_RADIUS`.

    Args:
        moments: Principal moments, shape (3,) [kg m^2].
        mass: Mass [kg].
    """
    result: Array = np.maximum(moments, 0.0)
    if result.max() <= _MIN_INERTIA:
        return np.full(3, mass * _GYRATION_RADIUS**2)
    return np.maximum(_project_moments(result), 10 * _MIN_INERTIA)


def _project_moments(moments: Array) -> Array:
    """Project principal moments on the moments of bodies, shape (3,) [kg m^2].

    With the second moments s, I = N s: the integrals of the squared distances from the three
    principal planes. A body requires s >= margin for each. A tensor of a rod violates two of these
    bounds, so all sets of active bounds are tried.
    """
    matrix = np.ones((3, 3)) - np.eye(3)
    stated = np.linalg.solve(matrix, moments)
    least = _TRIANGLE_MARGIN / 2 * float(moments.max())
    metric, results = matrix @ matrix, []
    for flags in product((False, True), repeat=3):
        active = np.array(flags)
        change = np.where(active, least - stated, 0.0)
        if not active.all():
            free = ~active
            change[free] = -np.linalg.solve(
                metric[np.ix_(free, free)], metric[np.ix_(free, active)] @ change[active]
            )
        second = np.where(active, least, stated + change)
        if (second >= least).all():
            results.append((float(change @ metric @ change), matrix @ second))
    nearest: Array = min(results, key=lambda result: result[0])[1]
    return nearest


def _widen_flat_inertia(bodies: LinkBodies, body: str) -> None:
    """Enlarge the moments of a flat body so that rounding does not violate A + B >= C, in place.

    A plate or a planar mesh without thickness has A + B = C. MuJoCo compares the moments after its
    own rounding, without tolerance.
    """
    inertia = bodies.inertia(body)
    if inertia is None or not inertia.mass > 0 or not is_valid_inertia(inertia):
        return
    tensor = np.array(inertia.inertia)
    low, middle, high = np.linalg.eigvalsh(tensor)
    if np.array_equal(tensor, np.diag(np.diag(tensor))):
        low, middle, high = np.sort(np.diag(tensor))
        is_safe = bool(low + middle >= high)
    else:
        is_safe = bool(low + middle >= high * (1 + _FLAT_MARGIN))
    if not is_safe:
        wider = tensor + _FLAT_MARGIN * high * np.eye(3)
        bodies.tree.links[body].set_inertia(make_inertia(inertia.mass, inertia.lever, wider))


def _move_inertia(bodies: LinkBodies, body: str, inertia: pin.Inertia) -> Diagnostic | None:
    """Move an invalid inertia to a body fixed to its body, if the sum is valid; return a note."""
    moved, mass, moments = ("link", body), Quantity(inertia.mass, "kg"), _compute_moments(inertia)
    links, group = bodies.tree.links, list(bodies.fixed_group(body))
    for neighbour, placement in group[1:]:
        own_inertia, total = bodies.inertia(neighbour), placement.act(inertia)
        if own_inertia is not None and is_valid_inertia(own_inertia + total):
            links[neighbour].set_inertia(own_inertia + total, NUM_DIGITS)
            links[body].remove("inertial")
            return diagnose(
                "inertia-moved", subject=moved, mass=mass, moments=moments, to=neighbour
            )
    return None


def _has_group_mass(bodies: LinkBodies, body: str) -> bool:
    """Return True if a body, or a body that fixed joints connect to this body, has a mass."""
    inertias = (bodies.inertia(member) for member, _ in bodies.fixed_group(body))
    return any(inertia is not None and inertia.mass > 0 for inertia in inertias)


def _repair_inertia(bodies: LinkBodies, body: str) -> Repair:
    """Replace the inertia of a body by a valid inertia, in place (`find_nearest_moments`).

    The principal axes are kept. A mass of zero or below becomes `ADDED_MASS`.
    """
    stated = bodies.inertia(body)
    old = pin.Inertia.Zero() if stated is None else stated
    moments, axes = np.linalg.eigh(np.array(old.inertia))
    mass = float(old.mass if old.mass > 0 else ADDED_MASS)
    new_moments = find_nearest_moments(moments, mass)
    new = make_inertia(mass, old.lever, axes @ np.diag(new_moments) @ axes.T)
    bodies.tree.links[body].set_inertia(new, NUM_DIGITS)
    moved = _find_carrier(bodies, body)[0]
    joint = bodies.tree.parent_joints.get(moved)
    return Repair(
        link=body,
        body=moved if joint is None or joint.is_fixed else joint.name,
        mass=float(old.mass),
        moments=_to_triple(moments),
        new_mass=mass,
        new_moments=_to_triple(new_moments),
    )


def _find_carrier(bodies: LinkBodies, body: str, *, bare: bool = False) -> tuple[str, pin.SE3]:
    """Find the nearest ancestor of a body that moves relative to its parent, or is the base.

    The ancestor may be the body itself. ``bare``: the search also ends at a body with an inertial.

    Returns:
        Name of the ancestor; pose of ``body`` in the frame of the ancestor.
    """
    placement = pin.SE3.Identity()
    while bodies.is_carried(body) and not (bare and bodies.inertia(body) is not None):
        above = bodies.tree.parent_joints[body]
        body, placement = above.parent, above.origin * placement
    return body, placement


def _make_inertia_error(urdf: UrdfFile, name: str, inertia: pin.Inertia) -> ModelError:
    """Create the error, with file and line, that MuJoCo would refuse the inertia of a link."""
    mass, moments = Quantity(inertia.mass, "kg"), _compute_moments(inertia)
    problem = diagnose("inertia-refused", subject=("link", name), mass=mass, moments=moments)
    return make_file_error(urdf.place("link", name, "inertial/inertia"), problem)


def _make_mass_error(urdf: UrdfFile, body: str) -> ModelError:
    """Create the error, with file and line, that a moving link has no mass."""
    above = urdf.tree.parent_joints.get(body)
    joint = None if above is None else above.name
    problem = diagnose("link-without-mass", subject=("link", body), joint=joint)
    return make_file_error(urdf.place("link", body), problem)


def _compute_moments(inertia: pin.Inertia) -> tuple[float, float, float]:
    """Return the principal moments of an inertia [kg m^2], the largest last."""
    return _to_triple(np.linalg.eigvalsh(np.array(inertia.inertia)))


def _to_triple(values: Array) -> tuple[float, float, float]:
    """Return three values as a tuple."""
    first, second, third = (float(value) for value in values)
    return first, second, third


def move_massless_shapes(bodies: LinkBodies) -> list[str]:
    """Move the collision shapes of fixed bodies without inertial to an ancestor body, in place.

    The ancestor is the nearest body above that has an inertial, moves, or is the base. Reason: the
    compliance of MuJoCo's ground depends on the inertia of a shape's body.

    Returns:
        Names of the bodies whose shapes were moved.
    """
    touching = {name for name, link in bodies.tree.links.items() if link.has_collision_shape}
    carriers = {name: _find_carrier(bodies, name, bare=True) for name in bodies.names}
    moved = [name for name, (to, _) in carriers.items() if to != name and name in touching]
    for name in moved:
        carrier, placement = carriers[name]
        for shape in bodies.tree.links[name].element.findall("collision"):
            set_origin(shape, placement * origin_of(shape), NUM_DIGITS)
            shape.set("name", shape.get("name") or f"{name}_collision")
            bodies.tree.links[carrier].element.append(shape)
    return moved
