"""Shapes for contact in a URDF and an MJCF: do the feet touch the ground at the same place?

What a foot stands on is part of the robot: a radius that is another one raises it, a shape that
touches nothing lets it fall. What else touches, and a foot of another shape that stands as high (a
ball for a mesh, say), is chosen otherwise in most pairs of files, moves no stand, and is noted.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import (
    Diagnostic,
    Quantity,
    Term,
    diagnose,
)
from pupper_analysis.models.mjcf_file import MjcfFile
from pupper_analysis.models.stated.elements import touching_geoms
from pupper_analysis.models.stated.geometry import DIRECTIONS, describe_shape, support_of
from pupper_analysis.models.stated.mjcf import read_mjcf_model, read_shape
from pupper_analysis.models.stated.model import Pose, RobotModel, Shape
from pupper_analysis.models.stated.urdf import read_urdf_model
from pupper_analysis.models.urdf_file import UrdfFile
from pupper_analysis.robot.compare.differences import FORMATS, Difference, Effect
from pupper_analysis.robot.contact import limb_ends
from pupper_analysis.robot.matching.match import Match

Array = NDArray[np.float64]

SAME_CONTACT = 2e-4
"""m: surfaces that are no further apart are one. (Meshes are cut to a tenth of a millimetre, and
files give radii as 0.02 for 19.95 mm.)"""

_AS_LOW = 0.15
"""Ends of limbs that are no higher than this above the lowest, in parts of the com's height above
it, are feet: hands are higher."""


@dataclass(frozen=True, eq=False)
class _Placed:
    """A shape in MuJoCo's world, as its robot begins.

    Attributes:
        shape: As its file has it.
        world: The same, placed in the world.
    """

    shape: Shape
    world: Shape

    def reach(self, directions: Array) -> Array | None:
        """Returns its support function (n,) in the world (m)."""
        return support_of(self.world, directions)


def compare_collisions(
    matched: Match, urdf: UrdfFile, mjcf: MjcfFile, moved: Collection[str]
) -> tuple[list[Difference], list[Diagnostic]]:
    """Compares what touches, in the pose in which the MJCF's robot begins.

    Args:
        matched: Both as one robot.
        urdf: The URDF.
        mjcf: The MJCF.
        moved: Joints (or the base) that are placed otherwise in the two files: what they carry
            touches elsewhere for that reason, and is not compared.

    Returns:
        Differences of feet, and notes on what else touches.
    """
    meant = matched.conventions
    one, two = read_urdf_model(urdf), read_mjcf_model(mjcf)
    stated = any(shape.collides for shape in _shapes(one)) and any(_shapes(two))
    if two.mj_model is None or not stated:
        return [], []  # one of them is of joints and masses alone
    if meant.base is not None or meant.zeros:
        return [], [diagnose("collisions-not-compared")]
    data = _start(mjcf.model)
    elsewhere = {matched.mjcf_body[name] for name in moved if name in matched.mjcf_body}
    tried = {
        name: _of_limb(name, matched, one, two, data)
        for name, body in matched.mjcf_body.items()
        if body in two.links and elsewhere.isdisjoint((body, *two.ancestors(body)))
    }
    limbs = {name: pair for name, pair in tried.items() if pair is not None}
    feet = _feet(limbs, matched, data) if matched.robot.floating else []
    found = list(_of_feet({name: limbs[name] for name in feet}, matched, urdf, mjcf))
    different = {difference.element for difference in found}
    return (
        found,
        list(_of_others({name: limbs[name] for name in limbs if name not in different})),
    )


def _shapes(robot: RobotModel) -> Iterator[Shape]:
    return (shape for link in robot.links.values() for shape in link.shapes)


def _start(model: mujoco.MjModel) -> mujoco.MjData:
    """Returns MuJoCo's data as the robot begins: at its first keyframe, or else at its qpos0."""
    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    return data


Limb = tuple[tuple[_Placed, ...], tuple[_Placed, ...]]
"""What touches of all that moves with a joint: in the URDF, in the MJCF."""


def _of_limb(
    name: str, matched: Match, one: RobotModel, two: RobotModel, data: mujoco.MjData
) -> Limb | None:
    """Returns what touches of all that moves with a joint; None where its extent is not known."""
    body, link, base = matched.mjcf_body[name], matched.urdf_link[name], matched.robot.base
    ends = matched.mjcf_body.get(base), matched.urdf_link.get(base)
    if not ({body, ends[0]} <= two.links.keys() and {link, ends[1]} <= one.links.keys()):
        return None
    model = data.model
    carrier = model.body(body).id
    # At zero angles, from the base's frame to the body's: in it the URDF's links are placed.
    to_body = (two.links[str(ends[0])].pose.inverse() * two.links[body].pose).inverse()
    to_base = one.links[str(ends[1])].pose.inverse()
    place = _pose(data, carrier) * to_body * to_base
    urdf = tuple(
        _placed(place * part.pose, shape)
        for part in one.fixed_group(link)
        for shape in part.shapes
        if shape.collides
    )
    moving = model.body_weldid[model.geom_bodyid] == model.body_weldid[carrier]
    mjcf = tuple(
        _placed(_pose(data, int(model.geom_bodyid[geom])), read_shape(model, geom))
        for geom in _touching_the_world(model)
        if moving[geom]
    )
    points = any(not any(one.shape.size) and one.shape.kind != "mesh" for one in urdf)
    if points or any(placed.reach(DIRECTIONS[:1]) is None for placed in (*urdf, *mjcf)):
        return None
    return urdf, mjcf


def _pose(data: mujoco.MjData, body: int) -> Pose:
    return Pose(data.xpos[body].copy(), data.xmat[body].reshape(3, 3).copy())


def _placed(pose: Pose, shape: Shape) -> _Placed:
    return _Placed(shape, replace(shape, pose=pose * shape.pose))


def _touching_the_world(model: mujoco.MjModel) -> list[int]:
    """Returns the geoms that can touch what stands in the world; of a world that is empty, all."""
    ids = sorted(touching_geoms(model))
    world = [geom for geom in ids if model.body_weldid[model.geom_bodyid[geom]] == 0]
    if not world:
        return ids
    ends = (model.pair_geom1.tolist(), model.pair_geom2.tolist())
    paired = {frozenset(pair) for pair in zip(*ends, strict=True)}
    kinds, kin = model.geom_contype, model.geom_conaffinity
    return [
        geom
        for geom in ids
        if any(
            kinds[geom] & kin[other] or kinds[other] & kin[geom] or {geom, other} in paired
            for other in world
        )
    ]


def _feet(limbs: Mapping[str, Limb], matched: Match, data: mujoco.MjData) -> list[str]:
    """Returns the joints that move the feet: the ends of limbs that are as low as the lowest."""
    model = data.model
    last = limb_ends(model)
    ends = {
        name: min(float(-one.reach(_DOWN)[0]) for one in (*urdf, *mjcf))  # type: ignore[index]
        for name, (urdf, mjcf) in limbs.items()
        if model.body_weldid[model.body(matched.mjcf_body[name]).id] in last and (urdf or mjcf)
    }
    if not ends:
        return []
    lowest = min(ends.values())
    base = model.body(matched.mjcf_body[matched.robot.base]).id
    above = float(data.subtree_com[base][2]) - lowest
    return [name for name, height in ends.items() if height - lowest <= _AS_LOW * above]


_DOWN = np.array([[0.0, 0.0, -1.0]])


def _of_feet(
    feet: Mapping[str, Limb], matched: Match, urdf: UrdfFile, mjcf: MjcfFile
) -> Iterator[Difference]:
    for name, (one, two) in feet.items():
        subject, sides = ("joint", name), (_lowest(one), _lowest(two))
        at = (
            urdf.place("link", matched.urdf_link[name], "collision").path,
            mjcf.place("body", matched.mjcf_body[name], "geom").path,
        )
        both = {"one": sides[0][1], "two": sides[1][1], **FORMATS.named}
        if not (one and two):
            told = diagnose("foot-touches-in-one-file", subject=subject, **both)
            found = [None if not side else "there" for side in (one, two)]
            yield Difference("collision", name, found[0], found[1], "", told, {}, *at)
            continue
        lower = sides[0][0] - sides[1][0]  # of the MJCF's
        if abs(lower) > SAME_CONTACT:
            told = diagnose(
                "foot-surface-differs",
                subject=subject,
                lower=Quantity(lower, "m") if lower > 0 else None,
                higher=Quantity(-lower, "m") if lower < 0 else None,
                **both,
            )
            effects = {"contact surface": Effect(abs(lower), abs(lower), math.inf)}
            yield Difference("collision", name, sides[0][0], sides[1][0], "m", told, effects, *at)


def _reach(shapes: Sequence[_Placed], directions: Array) -> Array:
    """Returns the support function of several shapes together."""
    reaches = [reach for shape in shapes if (reach := shape.reach(directions)) is not None]
    return np.asarray(np.max(reaches, axis=0))


def _lowest(shapes: Sequence[_Placed]) -> tuple[float, Diagnostic | Term]:
    """Returns the height (m) of the lowest point of shapes, and the shape that has it."""
    if not shapes:
        return math.nan, Term("none")
    heights = [float(-_reach([shape], _DOWN)[0]) for shape in shapes]
    first = int(np.argmin(heights))
    return heights[first], describe_shape(shapes[first].shape)


def _of_others(limbs: Mapping[str, Limb]) -> Iterator[Diagnostic]:
    """Notes by how much what else touches differs."""
    off = {
        name: float(np.abs(_reach(one, DIRECTIONS) - _reach(two, DIRECTIONS)).max())
        for name, (one, two) in limbs.items()
        if one and two
    }
    apart = {name: value for name, value in off.items() if value > SAME_CONTACT}
    lone = [name for name, (one, two) in limbs.items() if bool(one) != bool(two)]
    if apart:
        worst = max(apart, key=apart.__getitem__)
        far = Quantity(apart[worst], "m")
        yield diagnose("collisions-differ", worst=worst, off=far, names=tuple(apart))
    if lone:
        yield diagnose("collisions-in-one-file", names=tuple(lone))
