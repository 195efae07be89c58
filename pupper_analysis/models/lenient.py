"""What is made up for in an MJCF that MuJoCo of today, or without its scene, would refuse."""

from __future__ import annotations

import re
from typing import Final

import mujoco

from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.models.ground_plane import add_plane

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


def without_retired(text: bytes) -> tuple[bytes, list[Diagnostic]]:
    """Blanks the attributes that MuJoCo once had, in an MJCF's text or a part's.

    Lines stay where they are.

    Returns:
        The text, and what was passed over.
    """
    found = []
    for tag, attribute in _RETIRED:
        pattern = re.compile(
            rb"(<%s\b[^<>]*?\s)(%s\s*=\s*(?:\"[^\"]*\"|'[^']*'))"
            % (tag.encode(), attribute.encode())
        )
        changed = pattern.sub(lambda part: part[1] + re.sub(rb"[^\n]", b" ", part[2]), text)
        if changed != text:
            version = mujoco.__version__
            found.append(
                diagnose("attribute-retired", tag=tag, attribute=attribute, version=version)
            )
        text = changed
    return text, found


def put_ground(spec: mujoco.MjSpec) -> list[Diagnostic]:
    """Adds the ground that pairs of contacts name and the file lacks, as its scene has it.

    Returns:
        That it was added, if there was one to add.
    """
    known = {geom.name for geom in spec.geoms}
    named = {name for pair in spec.pairs for name in (pair.geomname1, pair.geomname2)}
    gone = sorted(name for name in named - known if name)
    if len(gone) != 1 or not _GROUND.search(gone[0]):
        return []
    add_plane(spec, gone[0])
    return [diagnose("ground-of-pairs-added", subject=("geom", gone[0]))]
