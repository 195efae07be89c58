"""Rules about what each engine makes of what a file does not say."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from pupper_analysis.base.diagnostics import Quantity, diagnose
from pupper_analysis.models.stated.geometry import solid_of
from pupper_analysis.models.stated.model import Shape, UrdfModel
from pupper_analysis.tools.audit.registry import Found, rule

WATER = 1000.0
"""The density that PhysX gives a shape of which none is known (kg/m^3)."""


@rule
def link_without_inertial(robot: UrdfModel) -> Iterator[Found]:
    """Finds links without <inertial>, but for ``world``, which PyBullet leaves without mass."""
    links = [
        body for body in robot.links.values() if body.inertial is None and body.name != "world"
    ]
    if not links:
        return
    told = diagnose(
        "link-without-inertial",
        others=[link.name for link in links[1:]],
        weighs=Quantity(robot.total_mass + len(links), "kg"),
        mass=Quantity(robot.total_mass, "kg"),
    )
    yield Found("link", links[0].name, told)


@rule
def massless_link_collides(robot: UrdfModel) -> Iterator[Found]:
    """Finds links without mass, stated or not, that have shapes for contacts."""
    links = {
        body: [shape for shape in body.shapes if shape.collides]
        for body in robot.links.values()
        if body.mass == 0
    }
    links = {body: shapes for body, shapes in links.items() if shapes}
    if not links:
        return
    masses = [_water(shapes) for shapes in links.values()]
    known = [mass for mass in masses if mass is not None]
    first, *others = (link.name for link in links)
    told = diagnose(
        "massless-link-collides",
        others=others,
        water=Quantity(sum(known), "kg") if len(known) == len(masses) else None,
        mass=Quantity(robot.total_mass, "kg"),
    )
    yield Found("link", first, told, "collision")


def _water(shapes: Sequence[Shape]) -> float | None:
    """Returns the mass of shapes full of water (kg); None if one is a mesh."""
    solids = [solid_of(shape.kind, shape.size) for shape in shapes]
    known = [solid.volume for solid in solids if solid is not None]
    return WATER * sum(known) if len(known) == len(solids) else None
