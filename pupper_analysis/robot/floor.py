"""Ground plane of an MJCF: search, levelling, and disabling of its contacts.

Changes of a spec are made in place. Prepared robots have a level floor at z = 0: a tilted or
raised floor is replaced, and a missing floor is added. For exceptions see `level_ground`.
"""

from __future__ import annotations

import mujoco
import numpy as np

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import (
    Diagnostic,
    Quantity,
    Term,
    diagnose,
)
from pupper_analysis.models.mjcf import GEOM_CONTACT_WORDS, add_geom, silence_mujoco
from pupper_analysis.models.spec_tree import SpecTree

_LEVEL_ATOL = 1e-9
"""Tolerance with which a floor counts as level at z = 0, and is not changed. It applies to the
height [m], and to the x and y components of the quaternion, or to 1 - cos(tilt). Chosen, not tuned.
"""


def find_floor(spec: mujoco.MjSpec) -> mujoco.MjsGeom | None:
    """Return the floor of an MJCF: a plane geom of the world body; None without such a plane.

    Of several planes, the first plane with enabled contacts is preferred.
    """
    plane = mujoco.mjtGeom.mjGEOM_PLANE
    planes = [geom for geom in spec.worldbody.geoms if geom.type == plane]
    touching = (geom for geom in planes if geom.contype or geom.conaffinity)
    return next(touching, next(iter(planes), None))


def merge_planes(spec: mujoco.MjSpec, floor: mujoco.MjsGeom) -> None:
    """Move the contact bits of the other level planes of the world body to the floor, in place.

    The planes may have any height. Planes in a ``<frame>``, or without a quaternion, are not
    changed.

    Args:
        spec: MJCF to modify.
        floor: Plane of the world body.
    """
    for geom in spec.worldbody.geoms:
        if geom.type == mujoco.mjtGeom.mjGEOM_PLANE and geom != floor and _is_level(geom):
            floor.contype |= geom.contype
            floor.conaffinity |= geom.conaffinity
            geom.contype = geom.conaffinity = 0


def disable_ground(spec: mujoco.MjSpec) -> list[Diagnostic]:
    """Disable the contacts of the ground: fixed planes and height fields, in place.

    Returns:
        Diagnostic of the change; empty if there is no ground.
    """
    ground_types = mujoco.mjtGeom.mjGEOM_PLANE, mujoco.mjtGeom.mjGEOM_HFIELD
    ground_geoms = [
        geom for geom in spec.geoms if geom.type in ground_types and is_fixed(geom.parent)
    ]
    for geom in ground_geoms:
        _disable_contacts(spec, geom)
    return [diagnose("ground-touches-nothing")] if ground_geoms else []


def _disable_contacts(spec: mujoco.MjSpec, geom: mujoco.MjsGeom) -> None:
    """Disable all contacts of a geom, in place: by contact masks, and by ``<pair>`` elements."""
    geom.contype = geom.conaffinity = 0
    for pair in list(spec.pairs):
        if geom.name and geom.name in (pair.geomname1, pair.geomname2):
            spec.delete(pair)


def rotate_floor(floor: mujoco.MjsGeom, quat: Array) -> None:
    """Set the orientation of a floor to a quaternion (w, x, y, z), in place.

    The quaternion replaces other representations in the spec, such as Euler angles.
    """
    floor.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
    floor.quat = quat


def level_ground(spec: mujoco.MjSpec) -> list[Diagnostic]:
    """Make the ground of an MJCF a level plane at z = 0 in the world, in place.

    - A tilted, higher or lower floor is replaced by a level floor at z = 0. A missing floor is
      added.
    - If no plane can collide, a plane of the world body is the floor, and is not changed.
    - Contacts of scenery (stairs, tables, walls) are disabled, because slopes and steps are part of
      the task.
    - Contact parameters of a ``<pair>`` with the floor are moved to the other geom.

    Returns:
        Diagnostics of the changes.
    """
    paired_names = {
        name for pair in spec.pairs for name in (pair.geomname1, pair.geomname2) if name
    }
    collidable_geoms = [
        geom
        for geom in spec.geoms
        if (geom.contype or geom.conaffinity or geom.name in paired_names) and is_fixed(geom.parent)
    ]
    floors = [geom for geom in collidable_geoms if geom.type == mujoco.mjtGeom.mjGEOM_PLANE]
    other_geoms = [geom for geom in collidable_geoms if geom not in floors]
    notes: list[Diagnostic] = []
    if floors:
        floor, notes = _level_floor(spec, floors)
    else:
        existing = find_floor(spec)
        floor = existing or SpecTree(spec).add_floor()
        notes = [] if existing else [diagnose("ground-added")]
    notes += _replace_pairs(spec, floor)
    scenery = [*other_geoms, *(geom for geom in floors[1:] if not _is_level_at_zero(geom))]
    return notes + _disable_geoms(spec, scenery)


def is_fixed(body: mujoco.MjsBody | None) -> bool:
    """Return True if a body is fixed to the world.

    Neither the body nor any ancestor has joints or is a mocap body.
    """
    while body is not None and body.name != "world":
        if body.joints or body.mocap:
            return False
        body = body.parent
    return True


def _is_level(plane: mujoco.MjsGeom) -> bool:
    """Return True if a world plane, with quaternion and without frame, is horizontal."""
    return bool(
        plane.parent.name == "world"
        and plane.frame is None
        and plane.alt.type == mujoco.mjtOrientation.mjORIENTATION_QUAT
        and np.abs(plane.quat[1:3]).max() < _LEVEL_ATOL
    )


def _is_level_at_zero(plane: mujoco.MjsGeom) -> bool:
    """Return True if a plane of the world body is horizontal (`_is_level`) at z = 0."""
    return _is_level(plane) and abs(plane.pos[2]) < _LEVEL_ATOL


def _level_floor(
    spec: mujoco.MjSpec, floors: list[mujoco.MjsGeom]
) -> tuple[mujoco.MjsGeom, list[Diagnostic]]:
    """Select the floor from planes; if none is level at z = 0, replace one by a level plane.

    The list ``floors`` is reordered, so that the floor is its first element. Returns the floor, and
    a diagnostic if a tilted or raised plane was replaced.
    """
    level_index = next((i for i, floor in enumerate(floors) if _is_level_at_zero(floor)), None)
    if level_index is not None:
        floors.insert(0, floors.pop(level_index))
        return floors[0], []
    cosines, heights = _list_compiled_planes(spec, floors)
    level = [1 - cosine < _LEVEL_ATOL for cosine in cosines]
    chosen = level.index(True) if any(level) else 0
    floors.insert(0, floors.pop(chosen))
    tilted, raised = not level[chosen], abs(heights[chosen]) >= _LEVEL_ATOL
    tilt = float(np.arccos(np.clip(cosines[chosen], -1.0, 1.0)))
    height = Quantity(heights[chosen], "m") if raised else None
    if tilted:
        note = diagnose("tilted-floor-laid-level", tilt=Quantity(tilt, "rad"), height=height)
    else:
        note = diagnose("floor-laid-level", height=height)
    old, new = floors[0], add_geom(spec.worldbody)
    for word in (*GEOM_CONTACT_WORDS, "type", "size", "material", "rgba"):
        setattr(new, word, getattr(old, word))
    name = old.name
    spec.delete(old)
    new.name = name
    floors[0] = new
    return new, [note] if tilted or raised else []


def _list_compiled_planes(
    spec: mujoco.MjSpec, planes: list[mujoco.MjsGeom]
) -> tuple[list[float], list[float]]:
    """Return the cosines of the tilts, and the heights [m], of planes in the compiled model."""
    numbers = [next(i for i, geom in enumerate(spec.geoms) if geom == plane) for plane in planes]
    copied = spec.copy()
    copied.compiler.discardvisual = False  # removing geoms would change their order
    with silence_mujoco():
        model = copied.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    geoms = [copied.geoms[number].id for number in numbers]
    return data.geom_xmat[geoms, 8].tolist(), data.geom_xpos[geoms, 2].tolist()


def _disable_geoms(spec: mujoco.MjSpec, geoms: list[mujoco.MjsGeom]) -> list[Diagnostic]:
    """Disable the contacts of geoms, in place, and report the geoms in a diagnostic."""
    names: list[str | Diagnostic] = []
    for geom in geoms:
        _disable_contacts(spec, geom)
        name = geom.name or (geom.parent.name if geom.parent.name != "world" else "")
        kind = Term(geom.type.name.removeprefix("mjGEOM_").lower())
        names.append(name or diagnose("geom-without-name", kind=kind))
    return [diagnose("scenery-left-out", names=dict.fromkeys(names))] if names else []


def _replace_pairs(spec: mujoco.MjSpec, floor: mujoco.MjsGeom) -> list[Diagnostic]:
    """Replace each ``<pair>`` with the floor by contact parameters of the other geom, in place."""
    geoms = {geom.name: geom for geom in spec.geoms if geom.name}
    used_bits = floor.contype | floor.conaffinity
    for geom in spec.geoms:
        used_bits |= geom.contype | geom.conaffinity
    free_bit = next((1 << n for n in range(31) if not used_bits & 1 << n), 1)
    replaced, notes = [], []
    for pair in list(spec.pairs):
        pair_names = (pair.geomname1, pair.geomname2)
        other_name = next((name for name in pair_names if name != floor.name), "")
        if not floor.name or floor.name not in pair_names or other_name not in geoms:
            continue
        geom = geoms[other_name]
        geom.contype |= free_bit
        floor.conaffinity |= free_bit
        geom.priority = floor.priority + 1  # the floor's parameters are ignored, as in the pair
        geom.condim, geom.solref, geom.solimp = pair.condim, pair.solref, pair.solimp
        # A geom has one coefficient for both directions; the smaller is conservative.
        geom.friction = np.minimum(pair.friction[[0, 2, 3]], pair.friction[[1, 2, 4]])
        geom.margin, geom.gap = pair.margin - floor.margin, pair.gap - floor.gap
        if pair.friction[0] != pair.friction[1] or pair.friction[3] != pair.friction[4]:
            notes.append(diagnose("friction-sideways-dropped", subject=("geom", other_name)))
        if np.any(pair.solreffriction):  # not available for geoms
            notes.append(diagnose("friction-softness-dropped", subject=("geom", other_name)))
        spec.delete(pair)
        replaced.append(other_name)
    return [*notes, diagnose("pairs-became-geoms", geoms=replaced)] if replaced else notes
