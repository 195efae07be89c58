"""Inertials that no body can have: given to what they are fixed to, or repaired if asked for."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.base.arrays import inertia_of
from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.base.errors import ModelError
from pupper_analysis.base.results import Result
from pupper_analysis.models.mjcf_xml import MjcfXml, XmlBody
from pupper_analysis.models.places import refuse_file
from pupper_analysis.models.urdf_file import UrdfFile
from pupper_analysis.models.urdf_tree import UrdfTree
from pupper_analysis.models.xml import parse_text, to_text

Array = NDArray[np.float64]

_TRIANGLE: Final = 1e-12
"""Slack of A + B >= C between principal moments, relative: rounding of the eigenvalues."""

_LEAST_INERTIA: Final = 1e-14
"""Least mass (kg) and principal moment (kg m^2) of a body that moves: ten times MuJoCo's."""

LIGHT: Final = 1e-3
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
    mass: float
    moments: tuple[float, float, float]
    new_mass: float
    new_moments: tuple[float, float, float]

    @property
    def diagnostic(self) -> Diagnostic:
        """What was written, as it is reported."""
        link = "link", self.link
        if not self.mass > 0:
            return diagnose("mass-given", subject=link, mass=Quantity(self.new_mass, "kg"))
        moments, before = self.new_moments, self.moments
        return diagnose("inertia-repaired", subject=link, moments=moments, before=before)


def mend_inertials(
    urdf: UrdfFile, mjcf: MjcfXml, *, repair: bool
) -> tuple[list[Diagnostic], list[Repair]]:
    """Makes inertials such that MuJoCo takes them.

    One that no body can have is moved to a body that it is fixed to, however many links are between
    them, or those of all bodies that are fixed to each other become one: what moves with them is
    the same then. Where that does not help, it is repaired.

    Args:
        urdf: What was read.
        mjcf: What was made of it.
        repair: Whether to repair: moments become the nearest that a body can have, and what moves
            without any mass is given a gram.

    Returns:
        What was moved, and what was repaired.

    Raises:
        ModelError: If one would have to be repaired, and shall not be.
    """
    moved: list[Diagnostic] = []
    repairs: list[Repair] = []
    for body in mjcf.bodies:
        inertia = body.inertia
        if inertia is None or is_possible(inertia):
            continue
        said = _moved(body, inertia)
        if said is not None:
            moved.append(said)
        elif repair and inertia.mass > 0:
            repairs.append(_repaired(body))
        elif inertia.mass > 0:
            raise _refusal(urdf, body.name, inertia)
    for body in mjcf.bodies:
        if body.moves and not _weighs(body):
            if not repair:
                raise _weightless(urdf, body)
            repairs.append(_repaired(body))
    return moved, repairs


def repaired_urdf(urdf: UrdfFile, mjcf: MjcfXml, repairs: list[Repair]) -> UrdfFile:
    """Returns a URDF with the inertials that were repaired: what the new MJCF is of.

    Args:
        urdf: What was read.
        mjcf: What was made of it.
        repairs: Which of them were repaired.
    """
    if not repairs:
        return urdf
    root = parse_text(urdf.text)
    links = UrdfTree(root).links
    for repair in repairs:
        inertia = mjcf.body(repair.link).inertia
        assert inertia is not None
        links[repair.link].set_inertia(inertia)
    return replace(urdf, text=to_text(root), root=root)


def is_possible(inertia: pin.Inertia) -> bool:
    """Says whether a body can have an inertia, as MuJoCo sees it: or nothing, without mass."""
    if inertia.mass <= 0:
        return not np.array(inertia.inertia).any()
    low, middle, high = np.linalg.eigvalsh(np.array(inertia.inertia))
    return bool(low > _LEAST_INERTIA and low + middle >= high * (1 - _TRIANGLE))


def nearest_moments(moments: Array, mass: float) -> Array:
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


def _moved(body: XmlBody, inertia: pin.Inertia) -> Diagnostic | None:
    """Gives what a body cannot have to one that it is fixed to; says which, or None."""
    moved, mass, moments = ("link", body.name), Quantity(inertia.mass, "kg"), _moments(inertia)
    group = list(body.fixed_group())
    for other, placement in group[1:]:
        there, total = other.inertia, placement.act(inertia)
        if there is not None and is_possible(there + total):
            other.set_inertia(there + total)
            body.set_inertia(None)
            return diagnose(
                "inertia-moved", subject=moved, mass=mass, moments=moments, to=other.name
            )
    heavy = [(other, own, place) for other, place in group if (own := other.inertia) is not None]
    total = pin.Inertia.Zero()
    for _, own, placement in heavy:
        total += placement.inverse().act(own)
    if len(heavy) < 2 or not is_possible(total):
        return None
    for other, _, _ in heavy:
        other.set_inertia(None)
    body.set_inertia(total)
    names = [other.name for other, _, _ in heavy[1:]]
    return diagnose("inertias-joined", subject=moved, mass=mass, moments=moments, links=names)


def _weighs(body: XmlBody) -> bool:
    """Says whether a body, or one that is fixed to it, has a mass."""
    inertias = (other.inertia for other, _ in body.fixed_group())
    return any(inertia is not None and inertia.mass > 0 for inertia in inertias)


def _repaired(body: XmlBody) -> Repair:
    """Gives a body the nearest inertia that it can have."""
    stated = body.inertia
    old = pin.Inertia.Zero() if stated is None else stated
    moments, axes = np.linalg.eigh(np.array(old.inertia))
    mass = float(old.mass if old.mass > 0 else LIGHT)
    wanted = nearest_moments(moments, mass)
    body.set_inertia(inertia_of(mass, old.lever, axes @ np.diag(wanted) @ axes.T))
    moved = body
    while not moved.moves and moved.parent is not None:
        moved = moved.parent
    return Repair(
        link=body.name,
        body=moved.mover or moved.name,
        mass=float(old.mass),
        moments=_three(moments),
        new_mass=mass,
        new_moments=_three(wanted),
    )


def _refusal(urdf: UrdfFile, name: str, inertia: pin.Inertia) -> ModelError:
    mass, moments = Quantity(inertia.mass, "kg"), _moments(inertia)
    problem = diagnose("inertia-refused", subject=("link", name), mass=mass, moments=moments)
    return refuse_file(urdf.place("link", name, "inertial/inertia"), problem)


def _weightless(urdf: UrdfFile, body: XmlBody) -> ModelError:
    problem = diagnose("link-without-mass", subject=("link", body.name), joint=body.mover)
    return refuse_file(urdf.place("link", body.name), problem)


def _moments(inertia: pin.Inertia) -> tuple[float, float, float]:
    return _three(np.linalg.eigvalsh(np.array(inertia.inertia)))


def _three(values: Array) -> tuple[float, float, float]:
    one, two, three = (float(value) for value in values)
    return one, two, three


def merge_fixed(mjcf: MjcfXml) -> list[str]:
    """Merges bodies without joints into their parents; a site of its name stays of each.

    Masses, coms and inertias add up, shapes and bodies go along.

    Returns:
        The names of those that were merged.
    """
    merged = []
    # From the ends of the tree, so that a parent takes what its child has taken.
    for body in reversed(mjcf.bodies):
        if not body.moves and body.parent is not None:
            merged.append(body.name)
            body.merge()
    return merged[::-1]


def carry_shapes(mjcf: MjcfXml) -> list[str]:
    """Moves collision shapes of bodies without joint and mass to the body that carries them.

    MuJoCo's ground is the softer under a shape the more lightly the shape's body can be pushed, at
    that body's own frame: a toe's sphere in a massless body of its own, at the end of a foot with
    light ankles, sinks in 25 times as far as in the foot's body. MuJoCo's own importer merges both.

    Returns:
        The names of the bodies whose shapes were moved.
    """
    moved = []
    # From the ends of the tree, so that a parent passes on what its child has passed on.
    for body in reversed(mjcf.bodies):
        bare = not body.moves and body.inertia is None and body.parent is not None
        if bare and body.touching:
            body.give_shapes()
            moved.append(body.name)
    return moved[::-1]
