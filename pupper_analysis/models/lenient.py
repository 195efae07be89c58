"""What is made up for in an MJCF that MuJoCo of today, or without its scene, would refuse."""

from __future__ import annotations

import re
from typing import Final

import mujoco

_RETIRED: Final = (
    ("flag", "sensornoise"),  # noise on sensors' readings
    ("option", "apirate"),  # of remote calls
    ("option", "mpr_iterations"),  # of the search for contacts of meshes
    ("option", "mpr_tolerance"),
    ("compiler", "convexhull"),  # hulls are made where they are needed
)
"""Attributes that MuJoCo once had, and refuses now: nothing that moves depends on them."""

_GROUND = re.compile("floor|ground|plane|terrain", re.IGNORECASE)


def is_retired(message: str) -> bool:
    """Tells whether MuJoCo's message is about one of the attributes that it once had."""
    return any(
        f"unrecognized attribute: '{attribute}'" in message and f"Element '{tag}'" in message
        for tag, attribute in _RETIRED
    )


def without_retired(text: bytes, notes: list[str]) -> bytes:
    """Blanks the attributes that MuJoCo once had; lines stay where they are.

    Args:
        text: An MJCF's, or a part's.
        notes: To say so in.
    """
    for tag, attribute in _RETIRED:
        pattern = re.compile(
            rb"(<%s\b[^<>]*?\s)(%s\s*=\s*(?:\"[^\"]*\"|'[^']*'))"
            % (tag.encode(), attribute.encode())
        )
        changed = pattern.sub(lambda found: found[1] + re.sub(rb"[^\n]", b" ", found[2]), text)
        has_not = f"which MuJoCo {mujoco.__version__} no longer has"
        said = f"{attribute} of <{tag}>, {has_not}, is passed over"
        if changed != text and said not in notes:
            notes.append(said)
        text = changed
    return text


def put_ground(spec: mujoco.MjSpec) -> list[str]:
    """Adds the ground that pairs of contacts name and the file lacks, as its scene has it.

    Returns:
        A note, if there was one to add.
    """
    known = {geom.name for geom in spec.geoms}
    named = {name for pair in spec.pairs for name in (pair.geomname1, pair.geomname2)}
    gone = sorted(name for name in named - known if name)
    if len(gone) != 1 or not _GROUND.search(gone[0]):
        return []
    plain = mujoco.MjSpec().default.geom  # the MJCF's own defaults are meant for the robot
    floor = spec.worldbody.add_geom(name=gone[0])
    for word in ("contype", "conaffinity", "condim", "friction", "solref", "solimp", "margin"):
        setattr(floor, word, getattr(plain, word))
    floor.type, floor.size = mujoco.mjtGeom.mjGEOM_PLANE, (0, 0, 0.05)
    return [
        f"geom {gone[0]!r}, which pairs of contacts name, is not in the file, but in a scene's, it "
        "seems: a plane at z = 0 was added"
    ]
