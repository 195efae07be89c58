"""The ground of an MJCF: the plane on which its robot stands."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import (
    Diagnostic,
    Term,
    diagnose,
)
from pupper_analysis.models.mjcf import GEOM_CONTACT_WORDS
from pupper_analysis.models.spec_tree import SpecTree

Array = NDArray[np.float64]

_LEVEL = 1e-9
"""A floor that is no further from z = 0 (m), nor tilted by more (1 - cosine), is there already."""


def floor_of(spec: mujoco.MjSpec) -> mujoco.MjsGeom | None:
    """Returns the plane that is fixed to the world."""
    plane = mujoco.mjtGeom.mjGEOM_PLANE
    return next((geom for geom in spec.worldbody.geoms if geom.type == plane), None)


def leave_ground(spec: mujoco.MjSpec) -> list[Diagnostic]:
    """Lets planes and height fields of the world touch nothing, in place: a robot hangs there.

    Returns:
        What was done.
    """
    ground = mujoco.mjtGeom.mjGEOM_PLANE, mujoco.mjtGeom.mjGEOM_HFIELD
    left = [geom for geom in spec.worldbody.geoms if geom.type in ground]
    for geom in left:
        geom.contype = geom.conaffinity = 0
        for pair in [one for one in spec.pairs if geom.name in (one.geomname1, one.geomname2)]:
            spec.delete(pair)
    return [diagnose("ground-touches-nothing")] if left else []


def turn_floor(floor: mujoco.MjsGeom, quat: Array) -> None:
    """Gives a floor an orientation (w, x, y, z), in place of the Euler angles, say, that it has."""
    floor.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
    floor.quat = quat


def level_ground(spec: mujoco.MjSpec) -> list[Diagnostic]:
    """Makes the ground of an MJCF a level plane at z = 0 in the world, in place.

    A floor that belongs to a body is put into the world; one that is tilted, or higher, is laid
    down. What else stands in the world, stairs, tables and walls, is kept from touching: a robot
    stands on its ground alone, and slopes and steps are asked for. What a ``<pair>`` says of a
    contact with the floor becomes that of the geom.

    Returns:
        What was done.
    """
    paired = {name for pair in spec.pairs for name in (pair.geomname1, pair.geomname2) if name}
    solid = [
        geom
        for geom in spec.geoms
        if (geom.contype or geom.conaffinity or geom.name in paired) and is_fixed(geom.parent)
    ]
    floors = [geom for geom in solid if geom.type == mujoco.mjtGeom.mjGEOM_PLANE]
    others = [geom for geom in solid if geom not in floors]
    done: list[Diagnostic] = []
    if floors:
        floor, done = _laid(spec, floors)
    else:
        known = floor_of(spec)
        floor = known or SpecTree(spec).add_floor()
        done = [] if known else [diagnose("ground-added")]
    done += _take_pairs(spec, floor)
    scenery = [*others, *(geom for geom in floors[1:] if not _is_at_home(geom))]
    return done + _leave_out(scenery)


def is_fixed(body: mujoco.MjsBody | None) -> bool:
    """Tells whether a body stands in the world: no joint is between."""
    while body is not None and body.name != "world":
        if body.joints or body.mocap:
            return False
        body = body.parent
    return True


def _is_at_home(floor: mujoco.MjsGeom) -> bool:
    """Tells whether a plane is level at z = 0 by what is written, in the world's own axes."""
    return bool(
        floor.parent.name == "world"
        and floor.frame is None
        and floor.alt.type == mujoco.mjtOrientation.mjORIENTATION_QUAT
        and abs(floor.pos[2]) < _LEVEL
        and np.abs(floor.quat[1:3]).max() < _LEVEL
    )


def _laid(
    spec: mujoco.MjSpec, floors: list[mujoco.MjsGeom]
) -> tuple[mujoco.MjsGeom, list[Diagnostic]]:
    """Returns the floor, which it lays down if need be, in the place of the one that there was.

    Of several planes it is one that is at home; ``floors`` begins with it afterwards.
    """
    best = next((i for i, floor in enumerate(floors) if _is_at_home(floor)), None)
    floors.insert(0, floors.pop(best or 0))
    if best is not None:
        return floors[0], []
    old, new = floors[0], spec.worldbody.add_geom()
    for word in (*GEOM_CONTACT_WORDS, "type", "size", "material", "rgba"):
        setattr(new, word, getattr(old, word))
    name = old.name
    spec.delete(old)
    new.name = name
    floors[0] = new
    return new, [diagnose("floor-laid-level")]


def _leave_out(geoms: list[mujoco.MjsGeom]) -> list[Diagnostic]:
    """Keeps geoms from touching, and names the bodies or geoms that they are."""
    names: list[str | Diagnostic] = []
    for geom in geoms:
        geom.contype = geom.conaffinity = 0
        own = geom.name or (geom.parent.name if geom.parent.name != "world" else "")
        kind = Term(geom.type.name.removeprefix("mjGEOM_").lower())
        names.append(own or diagnose("geom-without-name", kind=kind))
    return [diagnose("scenery-left-out", names=dict.fromkeys(names))] if names else []


def _take_pairs(spec: mujoco.MjSpec, floor: mujoco.MjsGeom) -> list[Diagnostic]:
    """Gives geoms that touch the floor by a ``<pair>`` the contact parameters of the pair."""
    geoms = {geom.name: geom for geom in spec.geoms if geom.name}
    taken = floor.contype | floor.conaffinity
    for geom in spec.geoms:
        taken |= geom.contype | geom.conaffinity
    bit = next((1 << n for n in range(31) if not taken & 1 << n), 1)
    named, done = [], []
    for pair in list(spec.pairs):
        both = (pair.geomname1, pair.geomname2)
        other = next((name for name in both if name != floor.name), "")
        if not floor.name or floor.name not in both or other not in geoms:
            continue
        geom = geoms[other]
        geom.contype |= bit
        floor.conaffinity |= bit
        geom.priority = floor.priority + 1  # its parameters count alone, as those of the pair did
        geom.condim, geom.solref, geom.solimp = pair.condim, pair.solref, pair.solimp
        # A geom has one along both axes: what holds by the lesser holds by both.
        geom.friction = np.minimum(pair.friction[[0, 2, 3]], pair.friction[[1, 2, 4]])
        geom.margin, geom.gap = pair.margin - floor.margin, pair.gap - floor.gap
        if pair.friction[0] != pair.friction[1] or pair.friction[3] != pair.friction[4]:
            done.append(diagnose("friction-sideways-dropped", subject=("geom", other)))
        if np.any(pair.solreffriction):  # which no geom has
            done.append(diagnose("friction-softness-dropped", subject=("geom", other)))
        spec.delete(pair)
        named.append(other)
    return [*done, diagnose("pairs-became-geoms", geoms=named)] if named else done
