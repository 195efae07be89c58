"""A robot as it is in a task that states contacts: with hands, and the friction of its planes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache

import coal  # comes with pin
import numpy as np
import pinocchio as pin

from pupper_analysis.base.diagnostics import Quantity, diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.base.frozen import FrozenDict
from pupper_analysis.models.additions import Addition, Ball, Untouching
from pupper_analysis.models.xml import to_text
from pupper_analysis.robot.build import rebuild_robot, with_touching
from pupper_analysis.robot.plane import Contact
from pupper_analysis.robot.robot import Robot, Touching
from pupper_analysis.robot.structure import Kinematics
from pupper_analysis.robot.tool import Tool, find_tool

_VIEWS = 8
"""Robots with contacts that are kept for later: as many as things that are lent."""


def touching(robot: Robot, contacts: Mapping[str, Contact]) -> Robot:
    """Returns a robot that can make a task's contacts; most often itself.

    A part that is no foot gets a contact point: a ball that weighs nothing, and touches nothing but
    its plane. A plane's friction is that of the contact with it.

    Args:
        robot: The robot, or what this has returned of it.
        contacts: {foot, or another link, site, body or geom: what it touches}, of a task.

    Raises:
        UnknownNameError: If there is no such foot or frame.
        ConfigurationError: If a part is a foot, by another name, or a foot is given a ball; or if
            the robot has other contacts, and was changed since.
    """
    if not contacts and not robot.touching:
        return robot
    own = {foot for foot in robot.feet if foot not in robot.hands}
    for name, one in contacts.items():
        if name in own and (any(one.offset) or one.radius is not None):
            raise ConfigurationError("contacts", diagnose("foot-is-no-hand", foot=name))
    wanted = {
        name: Touching(one.plane.friction)
        if name in own
        else Touching(one.plane.friction, one.offset, one.radius)
        for name, one in contacts.items()
    }
    asked = FrozenDict({name: one for name, one in wanted.items() if one != Touching()})
    if asked == robot.touching:
        return robot
    bare = robot if not robot.touching else robot.bare
    if bare is None:
        raise ConfigurationError("contacts", diagnose("made-for-other-contacts", robot=robot.name))
    return _with_contacts(bare, asked) if asked else bare


@lru_cache(maxsize=_VIEWS)
def _with_contacts(robot: Robot, asked: FrozenDict[str, Touching]) -> Robot:
    hands = {name: one for name, one in asked.items() if one.offset is not None}
    made = _with_hands(robot, hands) if hands else robot
    return replace(with_touching(made, robot, asked), bare=robot)


def _with_hands(robot: Robot, hands: Mapping[str, Touching]) -> Robot:
    """Returns a robot with further contact points in both of its models."""
    (urdf, mjcf), described = robot.description.trees(), robot.description
    model, frames = robot.pin_model.copy(), dict[str, tuple[str, str]]()
    taken = {site.name for site in mjcf.spec.sites} | {geom.name for geom in mjcf.spec.geoms}
    geoms, added = dict(described.foot_geoms), list[Addition]()
    feet = (str(robot.mj_model.geom(geom).name) for geom in robot.foot_geoms)
    like = next(filter(None, feet), None)
    for name, one in hands.items():
        tool = find_tool(robot, name).moved(one.offset or (0.0, 0.0, 0.0))
        _check_no_foot(robot, name, tool)
        frame = f"{name} (contact)"
        while frame in taken or frame in urdf.links:
            frame += "_"
        body, place = tool.in_mjcf(robot)
        urdf.add_link(frame, tool.link, f"to {frame}", tool.offset)
        mjcf.spec.body(body).add_site(name=frame, pos=place)
        carrier = model.frames[model.getFrameId(tool.link, pin.FrameType.BODY)]
        there = carrier.placement * pin.SE3(np.eye(3), tool.offset)
        parent = carrier.parentJoint
        model.addFrame(pin.Frame(frame, parent, 0, there, pin.FrameType.BODY), False)
        radius = one.radius or _room(robot, tool)
        size = Quantity(radius, "m")
        reason = diagnose("hand-touches-by-ball", name=name, radius=size)
        added.append(Ball(reason, frame, body, radius, tuple(place.tolist()), like))
        added.append(Untouching(reason, (frame,)))  # but for its plane; see ``terrain``
        frames[name], geoms[name] = (frame, frame), (frame, radius)
    given = replace(described, mjcf=mjcf.spec).given(*added)
    built = rebuild_robot(
        robot,
        urdf=to_text(urdf.root),
        mjcf=given.mjcf,
        added=given.added,
        contact_points={**described.contact_points, **frames},
        foot_geoms=geoms,
        made_frames=described.made_frames | {frame for frame, _ in frames.values()},
    )
    said = (one.reason for one in added if isinstance(one, Ball))
    # What was changed in Pinocchio's model since it was read, such as a limit, stays.
    return replace(built, pin_model=model, notes=(*built.notes, *said))


_PROBE, _BALL = 1e-4, 1e-2
"""Radius of the ball by which it is measured how deep a point is within shapes, and of that with
which a part touches that has none there (m)."""


def _room(robot: Robot, tool: Tool) -> float:
    """Returns the radius of the largest ball around a point that its link's shapes hold (m)."""
    at, probe = Kinematics(robot.structure), coal.Sphere(_PROBE)
    at.move(robot.neutral())
    turn, place = at.links[tool.link]
    there = coal.Transform3s(np.eye(3), turn @ tool.offset + place)
    depths = [0.0]
    for shape in robot.shapes:
        if shape.joint == (tool.chain or ("",))[-1]:
            (turn, place), pose = at.links[shape.link], shape.form.pose
            own = coal.Transform3s(turn @ pose.rotation, turn @ pose.position + place)
            request, found = coal.DistanceRequest(), coal.DistanceResult()
            coal.distance(shape.form.collision, own, probe, there, request, found)
            depths.append(-found.min_distance - _PROBE)
    return max(depths) if max(depths) > _PROBE else _BALL


def _check_no_foot(robot: Robot, name: str, tool: Tool) -> None:
    """Refuses a hand that is on a foot's link, or on the base, whose place is the task's own.

    Raises:
        ConfigurationError: If it is.
    """
    if not tool.chain:
        raise ConfigurationError("contacts", diagnose("contact-is-on-the-base", name=name))
    structure = robot.structure
    joint = structure.model.frames[structure.links[tool.link]].parentJoint
    for point, number in structure.parents.items():
        if number == joint:
            foot = robot.foot_of(point)
            problem = diagnose("contact-is-on-a-foot", name=name, foot=foot)
            raise ConfigurationError("contacts", problem)
