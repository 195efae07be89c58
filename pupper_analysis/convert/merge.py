"""Bodies without joints, merged into the body that carries them."""

from __future__ import annotations

from pupper_analysis.models.mjcf_xml import MjcfXml


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
