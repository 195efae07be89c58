"""Rules about what each engine makes of what a file does not say."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from pupper_analysis.checks.audit.registry import Found, rule
from pupper_analysis.checks.audit.view import Body, Shape, UrdfView

WATER = 1000.0
"""The density that PhysX gives a shape of which none is known (kg/m^3)."""

_NAMED = 4  # links that are told by name


@rule
def link_without_inertial(view: UrdfView) -> Iterator[Found]:
    """Finds links without <inertial>, but for ``world``, which PyBullet leaves without mass."""
    links = [
        body for body in view.bodies.values() if body.inertial is None and body.name != "world"
    ]
    if not links:
        return
    text = (
        f"it has no <inertial>{_others(links)}: in PyBullet the robot weighs "
        f"{view.total_mass + len(links):.6g} kg in place of {view.total_mass:.6g} kg"
    )
    yield Found("link", links[0].name, text)


@rule
def massless_link_collides(view: UrdfView) -> Iterator[Found]:
    """Finds links without mass, stated or not, that have shapes for contacts."""
    links = {
        body: [shape for shape in body.shapes if shape.collides]
        for body in view.bodies.values()
        if body.mass == 0
    }
    links = {body: shapes for body, shapes in links.items() if shapes}
    if not links:
        return
    masses = [_water(shapes) for shapes in links.values()]
    known = [mass for mass in masses if mass is not None]
    first = next(iter(links))
    if len(known) == len(masses):
        text = f"filled with water, they add {sum(known):.4g} kg to {view.total_mass:.6g} kg"
    else:
        text = f"filled with water, their meshes add to {view.total_mass:.6g} kg"
    text = f"it has no mass, and shapes for contacts{_others(list(links))}: {text}"
    yield Found("link", first.name, text, "collision")


def _others(links: Sequence[Body]) -> str:
    """Names the links besides the first."""
    names = [link.name for link in links[1:]]
    listed = ", ".join(names[:_NAMED]) + (" …" if len(names) > _NAMED else "")
    return f" (likewise {listed})" if names else ""


def _water(shapes: Sequence[Shape]) -> float | None:
    """Returns the mass of shapes full of water (kg); None if one is a mesh."""
    total = 0.0
    for shape in shapes:
        match shape.kind, shape.size:
            case "box", (x, y, z):
                total += 8 * x * y * z
            case "sphere", (radius,):
                total += 4 / 3 * math.pi * radius**3
            case "cylinder", (radius, half):
                total += 2 * math.pi * radius**2 * half
            case "capsule", (radius, half):
                total += math.pi * radius**2 * (2 * half + 4 / 3 * radius)
            case _:
                return None
    return WATER * total
