"""Inertials that no body can have: given to what they are fixed to, or repaired if asked for."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.base.arrays import make_inertia
from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.base.errors import ModelError
from pupper_analysis.base.results import Result
from pupper_analysis.models.places import make_file_error
from pupper_analysis.models.urdf_file import UrdfFile
from pupper_analysis.models.urdf_tree import UrdfTree, origin_of, set_origin
from pupper_analysis.models.xml import NUM_DIGITS, parse_text, to_text

Array = NDArray[np.float64]

WORLD_LINK: Final = "world"
"""A root link of this name is the world itself, as in MuJoCo's own importer."""

_TRIANGLE: Final = 1e-12
"""Slack of A + B >= C between principal moments, relative: rounding of the eigenvalues."""

_LEAST_INERTIA: Final = 1e-14
"""Least mass (kg) and principal moment (kg m^2) of a body that moves: ten times MuJoCo's."""

ADDED_MASS: Final = 1e-3
"""Mass that a moved link without any is given (kg): what exporters give helper links."""

_GYRATION: Final = 0.01
"""Radius of gyration of what has a mass and no inertia (m): that of a ball of 16 mm. A smaller one
would be moved by the least torque faster than a time step of 2 ms follows."""

_MARGIN: Final = 1e-6
"""What the repaired moments are inside of A + B >= C, relative: digits that are written."""


@dataclass(frozen=True)
class Repair(Result):
    """An inertial that no body can have, and what was written in its place.

    Attributes:
        link: The link.
        body: The joint that moves it, or the link that is the base.
        mass: What the URDF states (kg).
        moments: Its principal moments (kg m^2).
        new_mass: What was written (kg).
        new_moments: Its principal moments (kg m^2); the axes are the same.
    """

    link: str
    body: str
    mass: float = field(metadata={"unit": "kg"})
    moments: tuple[float, float, float] = field(metadata={"unit": "kg m^2"})
    new_mass: float = field(metadata={"unit": "kg"})
    new_moments: tuple[float, float, float] = field(metadata={"unit": "kg m^2"})

    @property
    def diagnostic(self) -> Diagnostic:
        """What was written, as it is reported."""
        link = "link", self.link
        if not self.mass > 0:
            return diagnose("mass-given", subject=link, mass=Quantity(self.new_mass, "kg"))
        moments, before = self.new_moments, self.moments
        return diagnose("inertia-repaired", subject=link, moments=moments, before=before)


@dataclass(frozen=True, eq=False)
class LinkBodies:
    """The links of a URDF as the bodies of an MJCF.

    Attributes:
        tree: The links, to be changed.
        free: Whether the base is free.
    """

    tree: UrdfTree
    free: bool

    @property
    def names(self) -> list[str]:
        """All bodies, parents first; the world is none."""
        base = self.tree.base.name
        return [name for name in self.tree.subtree(base) if name != base or base != WORLD_LINK]

    def parent(self, body: str) -> str | None:
        """Returns the body that carries one; None for the base, and a child of the world."""
        above = self.tree.parent(body)
        return None if above == self.tree.base.name == WORLD_LINK else above

    def moves(self, body: str) -> bool:
        """Tells whether a body can move against what carries it."""
        joint = self.tree.above.get(body)
        return self.free if joint is None else not joint.is_fixed

    def inertia(self, body: str) -> pin.Inertia | None:
        """Returns what a body states that it weighs, in its own frame; None if nothing."""
        return self.tree.links[body].inertia

    def carried(self, body: str) -> bool:
        """Tells whether a body is fixed to one that carries it."""
        return not self.moves(body) and self.parent(body) is not None

    def fixed_group(self, body: str) -> Iterator[tuple[str, pin.SE3]]:
        """Yields a body and all that are fixed to it, above and below, the nearest first.

        Each with where the first one is in it.
        """
        known, waiting = {body}, [(body, pin.SE3.Identity())]
        while waiting:
            here, placement = waiting.pop(0)
            yield here, placement
            below = [joint for joint in self.tree.below.get(here, ()) if joint.is_fixed]
            near = [(joint.child, joint.origin.inverse()) for joint in below]
            if self.carried(here):
                above = self.tree.above[here]
                near.insert(0, (above.parent, above.origin))
            for other, there in near:
                if other not in known:
                    known.add(other)
                    waiting.append((other, there * placement))


def repair_inertials(
    urdf: UrdfFile, bodies: LinkBodies, *, repair: bool
) -> tuple[list[Diagnostic], list[Repair]]:
    """Makes inertials such that MuJoCo takes them.

    One that no body can have is moved to a body that it is fixed to, however many links are between
    them: what moves with them is the same then. Where that does not help, it is repaired.

    Args:
        urdf: What was read.
        bodies: Its bodies.
        repair: Whether to repair: moments become the nearest that a body can have, and what moves
            without any mass is given a gram.

    Returns:
        What was moved, and what was repaired.

    Raises:
        ModelError: If one would have to be repaired, and shall not be.
    """
    moved: list[Diagnostic] = []
    repairs: list[Repair] = []
    for body in bodies.names:
        inertia = bodies.inertia(body)
        if inertia is not None and not (inertia.mass or np.any(inertia.inertia)):
            bodies.tree.links[body].remove("inertial")  # it states nothing
    for body in bodies.names:
        inertia = bodies.inertia(body)
        if inertia is None or is_valid_inertia(inertia):
            continue
        said = _moved(bodies, body, inertia)
        if said is not None:
            moved.append(said)
        elif repair and inertia.mass > 0:
            repairs.append(_repaired(bodies, body))
        elif inertia.mass > 0:
            raise _refusal(urdf, body, inertia)
    for body in bodies.names:
        if bodies.moves(body) and not _weighs(bodies, body):
            if not repair:
                raise _weightless(urdf, body)
            repairs.append(_repaired(bodies, body))
    return moved, repairs


def write_repairs(urdf: UrdfFile, bodies: LinkBodies, repairs: list[Repair]) -> UrdfFile:
    """Returns a URDF with the inertials that were repaired: what the new MJCF is of."""
    if not repairs:
        return urdf
    root = parse_text(urdf.text)
    links = UrdfTree(root).links
    for repair in repairs:
        links[repair.link].set_inertia(bodies.tree.links[repair.link].inertia)
    return replace(urdf, text=to_text(root), root=root)


def is_valid_inertia(inertia: pin.Inertia) -> bool:
    """Says whether a body can have an inertia, as MuJoCo sees it: or nothing, without mass."""
    if inertia.mass <= 0:
        return not np.array(inertia.inertia).any()
    low, middle, high = np.linalg.eigvalsh(np.array(inertia.inertia))
    return bool(low > _LEAST_INERTIA and low + middle >= high * (1 - _TRIANGLE))


def find_nearest_moments(moments: Array, mass: float) -> Array:
    """Returns the principal moments of a body that are nearest to some that no body has.

    The condition is A + B >= C for the greatest C; what is missing is made up in equal parts by
    all three, which is the least change (the projection on a half-space). MuJoCo's own
    ``balanceinertia`` takes the mean of the three instead, which changes more. Where a moment would
    not be positive, it is that of a body with a radius of gyration of 1 cm.

    Args:
        moments: Principal moments (3,), the greatest last (kg m^2).
        mass: Mass (kg).
    """
    result: Array = np.maximum(moments, 0.0)
    if result.max() <= _LEAST_INERTIA:
        return np.full(3, mass * _GYRATION**2)
    missing = float(result[2] * (1 + _MARGIN) - result[0] - result[1])
    if missing > 0:
        result = result + np.array([1.0, 1.0, -1.0]) * missing / 3
    return np.maximum(result, 10 * _LEAST_INERTIA)


def _moved(bodies: LinkBodies, body: str, inertia: pin.Inertia) -> Diagnostic | None:
    """Gives what a body cannot have to one that it is fixed to; says which, or None."""
    moved, mass, moments = ("link", body), Quantity(inertia.mass, "kg"), _moments(inertia)
    links, group = bodies.tree.links, list(bodies.fixed_group(body))
    for other, placement in group[1:]:
        there, total = bodies.inertia(other), placement.act(inertia)
        if there is not None and is_valid_inertia(there + total):
            links[other].set_inertia(there + total, NUM_DIGITS)
            links[body].remove("inertial")
            return diagnose("inertia-moved", subject=moved, mass=mass, moments=moments, to=other)
    return None


def _weighs(bodies: LinkBodies, body: str) -> bool:
    """Says whether a body, or one that is fixed to it, has a mass."""
    inertias = (bodies.inertia(other) for other, _ in bodies.fixed_group(body))
    return any(inertia is not None and inertia.mass > 0 for inertia in inertias)


def _repaired(bodies: LinkBodies, body: str) -> Repair:
    """Gives a body the nearest inertia that it can have."""
    stated = bodies.inertia(body)
    old = pin.Inertia.Zero() if stated is None else stated
    moments, axes = np.linalg.eigh(np.array(old.inertia))
    mass = float(old.mass if old.mass > 0 else ADDED_MASS)
    wanted = find_nearest_moments(moments, mass)
    new = make_inertia(mass, old.lever, axes @ np.diag(wanted) @ axes.T)
    bodies.tree.links[body].set_inertia(new, NUM_DIGITS)
    moved = _carrier(bodies, body)[0]
    joint = bodies.tree.above.get(moved)
    return Repair(
        link=body,
        body=moved if joint is None or joint.is_fixed else joint.name,
        mass=float(old.mass),
        moments=_three(moments),
        new_mass=mass,
        new_moments=_three(wanted),
    )


def _carrier(bodies: LinkBodies, body: str, *, bare: bool = False) -> tuple[str, pin.SE3]:
    """Returns the body that carries a fixed one, itself if none does, and where it is in that.

    Args:
        bodies: The bodies.
        body: The fixed one.
        bare: Whether to stop at a body that states an inertia, too.
    """
    placement = pin.SE3.Identity()
    while bodies.carried(body) and not (bare and bodies.inertia(body) is not None):
        above = bodies.tree.above[body]
        body, placement = above.parent, above.origin * placement
    return body, placement


def _refusal(urdf: UrdfFile, name: str, inertia: pin.Inertia) -> ModelError:
    mass, moments = Quantity(inertia.mass, "kg"), _moments(inertia)
    problem = diagnose("inertia-refused", subject=("link", name), mass=mass, moments=moments)
    return make_file_error(urdf.place("link", name, "inertial/inertia"), problem)


def _weightless(urdf: UrdfFile, body: str) -> ModelError:
    above = urdf.tree.above.get(body)
    joint = None if above is None else above.name
    problem = diagnose("link-without-mass", subject=("link", body), joint=joint)
    return make_file_error(urdf.place("link", body), problem)


def _moments(inertia: pin.Inertia) -> tuple[float, float, float]:
    return _three(np.linalg.eigvalsh(np.array(inertia.inertia)))


def _three(values: Array) -> tuple[float, float, float]:
    one, two, three = (float(value) for value in values)
    return one, two, three


def move_massless_shapes(bodies: LinkBodies) -> list[str]:
    """Moves collision shapes of bodies without joint and mass to the body that carries them.

    MuJoCo's ground is the softer under a shape the more lightly the shape's body can be pushed, at
    that body's own frame: a toe's sphere in a massless body of its own, at the end of a foot with
    light ankles, sinks in 25 times as far as in the foot's body. MuJoCo's own importer merges both.

    Returns:
        The names of the bodies whose shapes were moved.
    """
    touching = {name for name, link in bodies.tree.links.items() if link.touches}
    carriers = {name: _carrier(bodies, name, bare=True) for name in bodies.names}
    moved = [name for name, (to, _) in carriers.items() if to != name and name in touching]
    for name in moved:
        carrier, placement = carriers[name]
        for shape in bodies.tree.links[name].element.findall("collision"):
            set_origin(shape, placement * origin_of(shape), NUM_DIGITS)
            shape.set("name", shape.get("name") or f"{name}_collision")
            bodies.tree.links[carrier].element.append(shape)
    return moved
