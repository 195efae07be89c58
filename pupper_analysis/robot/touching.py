"""A robot as it is in a task that states contacts: with hands, and the friction of its planes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache

import coal  # comes with pin
import mujoco
import numpy as np
import pinocchio as pin

from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.base.errors import ConfigurationError, UnknownNameError
from pupper_analysis.base.frozen import FrozenDict
from pupper_analysis.models.additions import Addition, Ball, Untouching
from pupper_analysis.models.mjcf import has_free_joint
from pupper_analysis.models.xml import to_text
from pupper_analysis.robot.build import (
    build_robot,
    rebuild_robot,
    with_knowledge_of,
    with_touching,
)
from pupper_analysis.robot.plane import Bar, Contact, Weld
from pupper_analysis.robot.robot import Robot, Touching
from pupper_analysis.robot.structure import Kinematics
from pupper_analysis.robot.tool import Tool, find_tool

_VIEWS = 8
"""Robots with contacts that are kept for later: as many as things that are lent."""


_BOLTED = 1e4
"""Masses of a robot by which a base that its file fixes is heavier when it is freed, and welded: as
heavy as what it is bolted to. MuJoCo's welds are soft, and a light base shakes on one."""


def touching(robot: Robot, contacts: Mapping[str, Contact | Weld]) -> Robot:
    """Returns a robot that can make a task's contacts; most often itself.

    A part that is no foot gets a contact point: a ball that weighs nothing, and touches nothing but
    its plane. A plane's friction is that of the contact with it. What is welded touches nothing; of
    a robot whose base its file fixes in the world it is free, and held by its weld.

    Args:
        robot: The robot, or what this has returned of it.
        contacts: {foot, or another link, site, body or geom: what it touches}, of a task.

    Raises:
        UnknownNameError: If there is no such foot or frame.
        ConfigurationError: If a part is a foot, by another name, or a foot is given a ball; if two
            are welded that move as one; or if the robot has other contacts, and was changed since.
    """
    if not contacts and not robot.touching:
        return robot
    own = {foot for foot in robot.feet if foot not in robot.hands}
    wanted = {name: _touching(name, one, name in own) for name, one in contacts.items()}
    for name, one in contacts.items():
        round_ = isinstance(one.plane, Bar) or wanted[name].grip is not None
        if round_ and name in own and len(robot.feet[name]) > 1:
            raise ConfigurationError("contacts", diagnose("sole-on-a-bar", foot=name))
    asked = FrozenDict({name: one for name, one in wanted.items() if one != Touching()})
    if asked == robot.touching:
        return robot
    bare = robot if not robot.touching else robot.bare
    if bare is None:
        raise ConfigurationError("contacts", diagnose("made-for-other-contacts", robot=robot.name))
    for name, one in contacts.items():
        if isinstance(one, Weld) and one.place is not None:
            _check_hand(name, name not in own and bool(_tool(bare, name).chain), "place")
    return _with_contacts(bare, asked) if asked else bare


def _touching(name: str, one: Contact | Weld, foot: bool) -> Touching:
    if isinstance(one, Weld):
        _check_hand(name, not foot or not any(one.offset), "offset")
        return Touching(offset=None if foot else one.offset, welded=True)
    _check_hand(name, not foot or not (any(one.offset) or one.radius is not None), "offset, radius")
    held, friction = one.grip is not None, one.plane.friction
    offset = None if foot else one.offset
    return Touching(None if held else friction, offset, one.radius, one.force, held, one.grip)


def _check_hand(name: str, is_one: bool, given: str) -> None:
    if not is_one:
        raise ConfigurationError("contacts", diagnose("foot-is-no-hand", foot=name, given=given))


@lru_cache(maxsize=_VIEWS)
def _with_contacts(robot: Robot, asked: FrozenDict[str, Touching]) -> Robot:
    tools = {name: _tool(robot, name) for name, one in asked.items() if one.offset is not None}
    fixed = [name for name, tool in tools.items() if asked[name].welded and not tool.chain]
    hands = {name: one for name, one in asked.items() if name in tools and name not in fixed}
    ends = {name: tools[name].chain[-1:] for name in tools}
    for name, end in ends.items():
        twins = (one for one in ends if ends[one] == end and one != name and asked[one].welded)
        for other in twins:
            raise ConfigurationError("contacts", diagnose("welded-twice", name=name, other=other))
    if any(any(asked[name].offset or ()) for name in fixed):
        _check_hand(fixed[0], False, "offset")
    made = _freed(robot) if fixed and not robot.floating else robot
    made = _with_hands(made, hands) if hands else made
    return replace(with_touching(made, robot, asked), bare=robot)


def _tool(robot: Robot, name: str) -> Tool:
    """Returns the frame of a name; ``base`` is that of the base, if no other is called so."""
    try:
        return find_tool(robot, name)
    except UnknownNameError as error:
        if name == "base":
            return find_tool(robot, robot.base)
        known = dict.fromkeys((*robot.feet, "base", *error.known))
        raise UnknownNameError(error.source, "foot or frame", name, known) from None


def _freed(robot: Robot) -> Robot:
    """Returns a robot with a free base where its file, or whoever loaded it, has it fixed."""
    described, model = robot.description, robot.mj_model
    spec, base = described.mjcf.copy(), model.body(robot.mj_base).id
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    if not has_free_joint(spec):
        chain = [base]
        while model.body_parentid[chain[-1]]:
            chain.append(int(model.body_parentid[chain[-1]]))
        if not base or model.body_geomnum[chain[1:]].any():
            problem = diagnose("no-base-to-weld", robot=robot.name, base=robot.mj_base)
            raise ConfigurationError("contacts", problem)
        if min(model.body_mass[base], *model.body_inertia[base]) < mujoco.mjMINVAL:
            problem = diagnose("base-without-mass", robot=robot.name, base=robot.mj_base)
            raise ConfigurationError("contacts", problem)
        pose = (*data.xpos[base], *data.xquat[base])
        for one in chain:  # but for these the base may be in bodies that are empty
            body = spec.body(model.body(one).name)
            body.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
            body.pos, body.quat = (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)
        body.pos, body.quat = pose[:3], pose[3:]
        body.add_freejoint().armature = _BOLTED * robot.total_mass
        for key in spec.keys:
            key.qpos = np.insert(key.qpos, robot.mj_convention.qpos_index.min(), pose)
    built = with_knowledge_of(build_robot(replace(described, mjcf=spec)), robot)
    for name in ("lowerPositionLimit", "upperPositionLimit", "effortLimit", "velocityLimit"):
        own = getattr(robot.pin_model, name)  # what was changed since it was read stays
        getattr(built.pin_model, name)[-len(own) :] = own
    size = float(np.linalg.norm(data.xpos - data.xpos[base], axis=1).max()) / 2  # a scale
    return built if robot.stand_height else replace(built, stand_height=size)


def _with_hands(robot: Robot, hands: Mapping[str, Touching]) -> Robot:
    """Returns a robot with further contact points in both of its models."""
    (urdf, mjcf), described = robot.description.trees(), robot.description
    model, frames = robot.pin_model.copy(), dict[str, tuple[str, str]]()
    taken = {site.name for site in mjcf.spec.sites} | {geom.name for geom in mjcf.spec.geoms}
    geoms, added, said = dict(described.foot_geoms), list[Addition](), list[Diagnostic]()
    feet = (str(robot.mj_model.geom(geom).name) for geom in robot.foot_geoms)
    like = next(filter(None, feet), None)
    for name, one in hands.items():
        tool = _tool(robot, name).moved(one.offset or (0.0, 0.0, 0.0))
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
        said += [] if one.welded else [reason]
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
