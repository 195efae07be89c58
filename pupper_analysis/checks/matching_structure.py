"""Matches joints and frames that names do not match, by where they are."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import mujoco
import numpy as np
from lxml import etree

from pupper_analysis.checks.matching_mjcf import mjcf_tree
from pupper_analysis.checks.matching_places import at_zero
from pupper_analysis.checks.matching_urdf import end_link, urdf_tree

_PARALLEL = 0.99  # least |cosine| between the axes of joints that may be one
_NEAR = 0.25  # greatest distance of joints that may be one, relative to the robot's size


def common_frames(
    root: etree._Element, spec: mujoco.MjSpec, names: Mapping[str, str]
) -> dict[str, tuple[str, str]]:
    """Returns the frames of both: links on fixed joints, and sites or bodies without joints."""
    places = {site.name for site in spec.sites if site.name}
    places |= {body.name for body in spec.bodies if body.name and not list(body.joints)}
    frames = {}
    for joint in root.findall("joint"):
        link = end_link(joint, "child")
        place = names.get(link, link)
        if joint.get("type") == "fixed" and place in places:
            frames[place] = (link, place)
    return frames


def guess(
    root: etree._Element,
    spec: mujoco.MjSpec,
    urdf: Path,
    mjcf: Path,
    pairs: Mapping[str, str],
) -> dict[str, str]:
    """Matches joints without a partner by structure.

    Below the same parent, with parallel axes at zero angles, each the nearest to the other.
    """
    one = urdf_tree(root, urdf)
    two = mjcf_tree(spec, mjcf)
    free_one = [name for name in one.joints if name not in pairs]
    free_two = [name for name in two.joints if name not in pairs.values()]
    if not free_one or not free_two:
        return {}
    place_one, place_two = at_zero(one), at_zero(two)
    size = max(float(np.linalg.norm(place[0])) for place in place_one.values())
    partner = {one.base: two.base, **pairs}
    guessed: dict[str, str] = {}

    def likeness(name: str, other: str) -> float:
        (here, axis), (there, other_axis) = place_one[name], place_two[other]
        distance = float(np.linalg.norm(here - there))
        parallel = abs(float(axis @ other_axis)) > _PARALLEL
        return distance if parallel and distance < _NEAR * size else np.inf

    for parent in (one.base, *one.joints):  # parents first
        twin = partner.get(parent)
        mine = [name for name in one.children(parent) if name in free_one]
        theirs = [other for other in two.children(twin or "") if other in free_two]
        if twin is None or not mine or not theirs:
            continue
        table = np.array([[likeness(name, other) for other in theirs] for name in mine])
        for row, name in enumerate(mine):
            column = int(np.argmin(table[row]))
            least = table[row, column]
            rivals = np.concatenate(
                [np.delete(table[row], column), np.delete(table[:, column], row)]
            )
            if np.isfinite(least) and (least < 0.5 * rivals).all():
                guessed[name] = partner[name] = theirs[column]
    return guessed
