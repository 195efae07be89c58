"""Inertials that no body can have: given to what they are fixed to, or repaired if asked for."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import pinocchio as pin
from lxml import etree
from numpy.typing import NDArray

from pupper_analysis.arrays import INERTIA_ENTRIES
from pupper_analysis.convert.inertials import add_to, inertia_of, placement_of, put_inertia
from pupper_analysis.convert.xml_text import element, words
from pupper_analysis.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.errors import ModelError
from pupper_analysis.models.places import refusal
from pupper_analysis.models.urdf_file import UrdfFile
from pupper_analysis.models.urdf_tree import UrdfTree
from pupper_analysis.models.xml import parse_text, to_text
from pupper_analysis.results import Result

Array = NDArray[np.float64]
Group = list[tuple[etree._Element, pin.SE3]]
"""Bodies that are fixed to each other, with the placement of the first in the frame of each."""

_TRIANGLE: Final = 1e-12
"""Slack of A + B >= C between principal moments, relative: rounding of the eigenvalues."""

_LEAST: Final = 1e-14
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
        """What was written, as it is told."""
        link = "link", self.link
        if not self.mass > 0:
            return diagnose("mass-given", subject=link, mass=Quantity(self.new_mass, "kg"))
        moments, before = self.new_moments, self.moments
        return diagnose("inertia-repaired", subject=link, moments=moments, before=before)


def mend_inertials(
    urdf: UrdfFile, worldbody: etree._Element, *, repair: bool
) -> tuple[list[Diagnostic], list[Repair]]:
    """Makes inertials such that MuJoCo takes them.

    One that no body can have is moved to a body that it is fixed to, however many links are between
    them, or those of all bodies that are fixed to each other become one: what moves with them is
    the same then. Where that does not help, it is repaired.

    Args:
        urdf: What was read.
        worldbody: The bodies made of it.
        repair: Whether to repair: moments become the nearest that a body can have, and what moves
            without any mass is given a gram.

    Returns:
        What was moved, and what was repaired.

    Raises:
        ModelError: If one would have to be repaired, and shall not be.
    """
    moved: list[Diagnostic] = []
    repairs: list[Repair] = []
    for body in list(worldbody.iter("body")):
        inertial = body.find("inertial")
        if inertial is None or is_possible(inertia_of(inertial)):
            continue
        said = _moved(body)
        if said is not None:
            moved.append(said)
        elif repair and inertia_of(inertial).mass > 0:
            repairs.append(_repaired(body))
        elif inertia_of(inertial).mass > 0:
            raise _refusal(urdf, body)
    for body in worldbody.iter("body"):
        joints = body.findall("joint") + body.findall("freejoint")
        if joints and not _weighs(body):
            if not repair:
                raise _weightless(urdf, body, joints[-1])
            repairs.append(_repaired(body))
    return moved, repairs


def repaired_urdf(urdf: UrdfFile, worldbody: etree._Element, repairs: list[Repair]) -> UrdfFile:
    """Returns a URDF with the inertials that were repaired: what the new MJCF is of.

    Args:
        urdf: What was read.
        worldbody: The bodies made of it, with their inertials.
        repairs: Which of them were repaired.
    """
    if not repairs:
        return urdf
    root = parse_text(urdf.text)
    links = UrdfTree(root).links
    bodies = {str(body.get("name")): body for body in worldbody.iter("body")}
    for repair in repairs:
        link = links[repair.link]
        link.remove("inertial")
        inertia = inertia_of(bodies[repair.link].find("inertial"))
        inertial = element(link.element, "inertial")
        element(inertial, "origin", xyz=words(inertia.lever))
        element(inertial, "mass", value=words(inertia.mass))
        tensor = np.array(inertia.inertia)
        entries = {name: words(tensor[place]) for name, place in INERTIA_ENTRIES.items()}
        element(inertial, "inertia", **entries)
    return replace(urdf, text=to_text(root), root=root)


def is_possible(inertia: pin.Inertia) -> bool:
    """Says whether a body can have an inertia, as MuJoCo sees it: or nothing, without mass."""
    if inertia.mass <= 0:
        return not np.array(inertia.inertia).any()
    low, middle, high = np.linalg.eigvalsh(np.array(inertia.inertia))
    return bool(low > _LEAST and low + middle >= high * (1 - _TRIANGLE))


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
    if result.max() <= _LEAST:
        return np.full(3, mass * _GYRATION**2)
    missing = float(result[2] * (1 + _MARGIN) - result[0] - result[1])
    if missing > 0:
        result = result + np.array([1.0, 1.0, -1.0]) * missing / 3
    return np.maximum(result, 10 * _LEAST)


def _moved(body: etree._Element) -> Diagnostic | None:
    """Gives what a body cannot have to one that it is fixed to; says which, or None."""
    inertia, name = inertia_of(body.find("inertial")), str(body.get("name"))
    mass, moments = Quantity(inertia.mass, "kg"), _moments(inertia)
    group = list(_fixed_together(body))
    for other, placement in group[1:]:
        there = other.find("inertial")
        total = placement.act(inertia)
        if there is not None and is_possible(inertia_of(there) + total):
            add_to(other, total)
            body.remove(body.find("inertial"))
            carrier = str(other.get("name"))
            return diagnose(
                "inertia-moved", subject=("link", name), mass=mass, moments=moments, to=carrier
            )
    heavy = [(other, placement) for other, placement in group if other.find("inertial") is not None]
    total = pin.Inertia.Zero()
    for other, placement in heavy:
        total += placement.inverse().act(inertia_of(other.find("inertial")))
    if len(heavy) < 2 or not is_possible(total):
        return None
    for other, _ in heavy:
        other.remove(other.find("inertial"))
    put_inertia(body, total)
    names = [str(other.get("name")) for other, _ in heavy[1:]]
    return diagnose(
        "inertias-joined", subject=("link", name), mass=mass, moments=moments, links=names
    )


def _fixed_together(body: etree._Element) -> Iterator[tuple[etree._Element, pin.SE3]]:
    """Yields a body and all that are fixed to it, the nearest first."""
    known = {body}
    waiting = [(body, pin.SE3.Identity())]
    while waiting:
        here, placement = waiting.pop(0)
        yield here, placement
        near = [(child, placement_of(child).inverse()) for child in here.findall("body")]
        near = [(child, there) for child, there in near if not _moves(child)]
        parent = here.getparent()
        if parent.tag == "body" and not _moves(here):
            near.insert(0, (parent, placement_of(here)))
        for other, there in near:
            if other not in known:
                known.add(other)
                waiting.append((other, there * placement))


def _moves(body: etree._Element) -> bool:
    return body.find("joint") is not None or body.find("freejoint") is not None


def _weighs(body: etree._Element) -> bool:
    """Says whether a body, or one that is fixed to it, has a mass."""
    inertials = (other.find("inertial") for other, _ in _fixed_together(body))
    return any(inertial is not None and inertia_of(inertial).mass > 0 for inertial in inertials)


def _repaired(body: etree._Element) -> Repair:
    """Gives a body the nearest inertia that it can have."""
    inertial = body.find("inertial")
    old = pin.Inertia.Zero() if inertial is None else inertia_of(inertial)
    moments, axes = np.linalg.eigh(np.array(old.inertia))
    new = pin.Inertia.Zero()
    new.mass, new.lever = (old.mass if old.mass > 0 else LIGHT), old.lever
    wanted = nearest_moments(moments, new.mass)
    new.inertia = axes @ np.diag(wanted) @ axes.T
    put_inertia(body, new)
    mover = body
    while not _moves(mover) and mover.getparent().tag == "body":
        mover = mover.getparent()
    joint = mover.find("joint")
    name = str((mover if joint is None else joint).get("name"))
    return Repair(
        link=str(body.get("name")),
        body=name,
        mass=float(old.mass),
        moments=_three(moments),
        new_mass=float(new.mass),
        new_moments=_three(wanted),
    )


def _refusal(urdf: UrdfFile, body: etree._Element) -> ModelError:
    name, inertia = str(body.get("name")), inertia_of(body.find("inertial"))
    mass, moments = Quantity(inertia.mass, "kg"), _moments(inertia)
    problem = diagnose("inertia-refused", subject=("link", name), mass=mass, moments=moments)
    return refusal(urdf.place("link", name, "inertial/inertia"), problem)


def _weightless(urdf: UrdfFile, body: etree._Element, joint: etree._Element) -> ModelError:
    link, mover = "link", joint.get("name") if joint.tag == "joint" else None
    problem = diagnose("link-without-mass", subject=(link, str(body.get("name"))), joint=mover)
    return refusal(urdf.place(link, str(body.get("name"))), problem)


def _moments(inertia: pin.Inertia) -> tuple[float, float, float]:
    return _three(np.linalg.eigvalsh(np.array(inertia.inertia)))


def _three(values: Array) -> tuple[float, float, float]:
    one, two, three = (float(value) for value in values)
    return one, two, three
