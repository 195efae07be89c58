"""Disable the contacts that the statics do not assume: a robot stands only on its feet.

Input is a robot with a start pose. Two kinds of contacts are disabled: contacts of shapes near the
ground that belong to a foot's body without being foot geoms, and contacts between bodies that
overlap in the start pose.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Sequence

import mujoco
import numpy as np

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.base.errors import PupperAnalysisError
from pupper_analysis.models.additions import ContactExclusion, DisabledContacts
from pupper_analysis.prepare import notes, start
from pupper_analysis.prepare.contact_points import compute_lowest_height, find_contact_points
from pupper_analysis.prepare.feet import (
    Foot,
    add_contact_frames,
    count_joints_to_base,
    list_ground_geoms,
)
from pupper_analysis.robot.build import build_robot, with_additions
from pupper_analysis.robot.compliance import GroundLaw
from pupper_analysis.robot.contact import list_contact_bodies
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.posture import find_posture
from pupper_analysis.stance.soft_ground import solve_stand_on_soft_ground


def discard_visuals(spec: mujoco.MjSpec) -> None:
    """Set the compiler option ``discardvisual`` of a spec, in place, to compile no visual geoms.

    Compilation removes the visual geoms from the spec itself; compile a copy to keep the geoms. The
    option is not set if visual geoms may change the dynamics, for example by fluid forces.
    """
    weighed = spec.compiler.inertiafromgeom == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE
    if not (weighed or spec.option.density or spec.option.viscosity):
        spec.compiler.discardvisual = True


def copy_visual_option(spec: mujoco.MjSpec, original: mujoco.MjSpec) -> bool:
    """Copy the compiler option ``discardvisual`` of an original spec to a spec, in place.

    Returns:
        True if the option of ``spec`` changed.
    """
    before = spec.compiler.discardvisual
    spec.compiler.discardvisual = original.compiler.discardvisual
    return bool(before != spec.compiler.discardvisual)


_MAX_FOOT_SHARE = 0.5
"""Upper bound of the mean fraction [1] of the load on the contact shapes of soft feet. With a
smaller fraction, other shapes of the same bodies become the contact shapes. Chosen, not tuned.
"""


def find_carrying_hulls(
    footless: Robot, robot: Robot, feet: Sequence[Foot]
) -> tuple[tuple[Foot, ...], Diagnostic] | None:
    """Find soft feet whose load is mainly carried by another shape of the foot's body.

    A soft foot may penetrate the ground so far that a stiffer shape of the foot's body also
    touches, such as the convex hull of the shank. The contact point of the foot must then be on
    this shape. The fraction of the load that the foot itself carries is averaged over the affected
    feet, so that all legs are treated equally.

    Args:
        footless: Robot before feet were added.
        robot: Robot with the feet, and a start pose.
        feet: Feet, each with contact points.

    Returns:
        All feet, and a note. In the affected feet, the other shape is the contact shape. None if
        there are no such feet, or no stand on soft ground.
    """
    try:
        stand = solve_stand_on_soft_ground(start.with_foot_contacts_only(robot), explain=False)
    except PupperAnalysisError:
        return None
    model = footless.mj_model
    data = footless.compute_kinematics(footless.make_qpos(stand.joint_positions(robot)))
    changed: dict[str, Foot] = {}
    gaps, depths = dict[str, float](), dict[str, float]()
    for foot in feet:
        if len(foot.points) != 1 or foot.name not in stand.depths:
            continue  # other shapes are above a flat sole
        own, depth = foot.points[0].geom, stand.depths[foot.name]
        other_geoms = [geom for geom in list_ground_geoms(model, foot.body) if geom != own]
        bottom = compute_lowest_height(model, data, [own])
        hull = min(
            other_geoms, key=lambda geom: compute_lowest_height(model, data, [geom]), default=None
        )
        gap = math.inf if hull is None else compute_lowest_height(model, data, [hull]) - bottom
        if hull is None or not gap < depth:
            continue
        points = find_contact_points(
            model, data, foot.body, [hull], count_joints_to_base(footless, foot.body)
        )
        if len(points) == 1:
            changed[foot.name] = Foot(foot.name, foot.body, points)
            gaps[foot.name], depths[foot.name] = gap, depth
    if not changed:
        return None
    new = tuple(changed.get(foot.name, foot) for foot in feet)
    hulled = build_robot(add_contact_frames(footless, new, notes.report_balls(footless, new)))
    shares = []
    for name, gap in gaps.items():
        soft = GroundLaw.of_contact(robot, name)
        load = soft.force(depths[name])
        shares.append(soft.force(gap + GroundLaw.of_contact(hulled, name).depth(load)) / load)
    if np.mean(shares) > _MAX_FOOT_SHARE:  # one decision for all feet, so that legs remain equal
        return None
    message = diagnose(
        "hulls-carry-instead-of-feet",
        feet=list(changed),
        bodies=sorted({str(model.body(foot.body).name) for foot in changed.values()}),
        gap=Quantity(max(gaps.values()), "m"),
        depth=Quantity(max(depths.values()), "m"),
    )
    return new, message


_MAX_SHAPE_CLEARANCE = 5e-3
"""Upper bound of the height above the ground [m] at which contacts of a shape are disabled, in the
stand on soft ground. This concerns shapes on a foot's body that are not contact shapes of a foot.
Chosen, not tuned."""


def disable_shapes_beside_feet(robot: Robot) -> tuple[Robot, list[Diagnostic]]:
    """Disable the contacts of shapes on a foot's body that are near the ground in a stand.

    Reason: the statics assume that only the feet touch the ground. The contacts of the foot geoms
    themselves are kept. The stand is the nominal stand (default `StandTask`) on soft ground.

    Returns:
        Robot, and a list with a note about the bodies; the list is empty if nothing is changed.
    """
    try:
        stand = solve_stand_on_soft_ground(start.with_foot_contacts_only(robot), explain=False)
    except PupperAnalysisError:
        return robot, []
    model, foot_bodies = robot.mj_model, start.list_foot_bodies(robot)
    beside = {
        geom
        for geom in start.find_non_foot_contacts(robot, stand, _MAX_SHAPE_CLEARANCE)
        if int(model.body_weldid[model.geom_bodyid[geom]]) in foot_bodies
    }
    if not beside:
        return robot, []
    geoms = tuple(model.geom(geom).name for geom in sorted(beside))
    bodies = sorted({model.body(int(model.geom_bodyid[geom])).name for geom in beside})
    depth = Quantity(max(stand.depths.values()), "m")
    message = diagnose("shapes-beside-feet-do-not-touch", bodies=bodies, depth=depth)
    return with_additions(robot, DisabledContacts(message, geoms)), [message]


def exclude_overlaps(robot: Robot) -> tuple[Robot, list[Diagnostic]]:
    """Add contact exclusions for the pairs of bodies that overlap in the start pose.

    Reason: the statics assume that no bodies of the robot touch each other. The start pose is the
    nominal stand (default `StandTask`), or the default posture of a fixed base (`find_posture`).

    Returns:
        Robot, and a list with a note about the pairs; the list is empty if nothing is changed.
    """
    pose = _find_start_configuration(robot)
    if pose is None:
        return robot, []
    model, data = robot.mj_model, mujoco.MjData(robot.mj_model)
    robot.mj_convention.set_state(data, pose)
    mujoco.mj_forward(model, data)
    depths: dict[tuple[str, str], float] = {}
    for touch, bodies in zip(data.contact, list_contact_bodies(model, data), strict=True):
        if 0 not in bodies and touch.dist < 0:
            first, second = sorted(str(model.body(int(body)).name) for body in bodies)
            depths[first, second] = max(depths.get((first, second), 0.0), -float(touch.dist))
    if not depths:
        return robot, []
    pairs = [
        diagnose("bodies-overlap", one=first, two=second, depth=Quantity(depth, "m"))
        for (first, second), depth in depths.items()
    ]
    message = diagnose("overlapping-bodies-do-not-touch", pairs=pairs)
    return with_additions(robot, *(ContactExclusion(message, *both) for both in depths)), [message]


def _find_start_configuration(robot: Robot) -> Array | None:
    """Compute the configuration, shape (nq,) [m, rad], in which overlaps of bodies are tested.

    None if the nominal stand, or the default posture of a fixed base, cannot be solved.
    """
    if robot.floating:
        stand = start.solve_nominal_stand(robot)
        return None if stand is None else stand.qpos
    with contextlib.suppress(PupperAnalysisError):  # open loops are reported by other passes
        return find_posture(robot).qpos
    return None
