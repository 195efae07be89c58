"""Robot with the contacts of a task: hands, welds, and the friction of planes.

Input: a robot and the contacts {foot or frame: contact}. Output: a robot with contact points for
hands (massless spheres), and with the friction of the planes. A hand is a part that touches a
surface and is not a foot. If the task welds a fixed base, the base of the output is free.
"""

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
from pupper_analysis.models.additions import Addition, Ball, DisabledContacts
from pupper_analysis.models.mjcf import add_site, has_free_joint
from pupper_analysis.models.spec_tree import SpecTree
from pupper_analysis.models.xml import to_text
from pupper_analysis.robot.build import (
    build_robot,
    copy_metadata,
    rebuild_robot,
    with_touching,
)
from pupper_analysis.robot.floor import find_floor
from pupper_analysis.robot.joints import default_positions
from pupper_analysis.robot.plane import Bar, Contact, Weld
from pupper_analysis.robot.robot import Robot, Touching
from pupper_analysis.robot.structure import Kinematics
from pupper_analysis.robot.tool import Tool, find_place, find_tool

_CACHE_SIZE = 8
"""Maximum number of cached robots with contacts. Chosen, not tuned."""


_BASE_ARMATURE_FACTOR = 1e4
"""Armature [kg, kg m^2] of a base that the file fixes and the task welds, divided by the robot's
mass [kg]. Such a base gets a free joint with this armature. The large armature represents the
environment: MuJoCo's welds are soft, and a light base would oscillate. Chosen, not tuned."""


def with_contacts(robot: Robot, contacts: Mapping[str, Contact | Weld]) -> Robot:
    """Prepare a robot for the contacts of a stand task: contact points, friction and welds.

    - A hand (a part that is no foot) gets a contact point: a massless sphere that collides at most
      with its plane. The spheres of welded or gripping hands do not collide.
    - The friction coefficient of a plane, if stated, becomes the coefficient of a contact without
      grip.
    - If a task welds a base that is fixed to the world, the base becomes free, and the weld holds
      it.

    The contacts replace the contacts of an earlier task.

    Args:
        robot: Robot, which may already be the result of this function.
        contacts: {foot, or other link, site, body or geom: contact} of a task.

    Returns:
        Robot with the contacts; ``robot`` itself if no change is required.

    Raises:
        UnknownNameError: If there is no such foot or frame.
        ConfigurationError: If a contact conflicts with the robot or with another contact. For
            example, a foot with several contact points cannot grip or touch a bar; a contact of a
            foot cannot have an ``offset``; the base can only be welded.
        ModelError: If the model with the contacts cannot be built.
    """
    if not contacts and not robot.touching:
        return robot
    own_feet = {foot for foot in robot.feet if foot not in robot.hands}
    properties_by_name = {
        name: _make_touching(name, contact, name in own_feet) for name, contact in contacts.items()
    }
    for name, contact in contacts.items():
        is_round = isinstance(contact.plane, Bar) or properties_by_name[name].grip is not None
        if is_round and name in own_feet and len(robot.feet[name]) > 1:
            raise ConfigurationError("contacts", diagnose("sole-on-a-bar", foot=name))
    properties = FrozenDict(
        {name: contact for name, contact in properties_by_name.items() if contact != Touching()}
    )
    bare = robot if not robot.touching else robot.bare
    for name, contact in contacts.items():
        if isinstance(contact, Weld) and contact.place is not None:
            is_moved = name not in own_feet and bool(_find_frame(bare or robot, name).chain)
            _require_hand(name, is_moved, "place")
    if properties == robot.touching:
        return robot
    if bare is None:
        raise ConfigurationError("contacts", diagnose("made-for-other-contacts", robot=robot.name))
    return _build_with_contacts(bare, properties) if properties else bare


def _make_touching(name: str, contact: Contact | Weld, foot: bool) -> Touching:
    """Convert a contact or weld of a task to the contact settings of a foot or other part."""
    if isinstance(contact, Weld):
        _require_hand(name, not foot or not any(contact.offset), "offset")
        return Touching(offset=None if foot else contact.offset, is_fixed=True)
    _require_hand(
        name, not foot or not (any(contact.offset) or contact.radius is not None), "offset, radius"
    )
    is_grip, friction = contact.grip is not None, contact.plane.friction
    offset = None if foot else contact.offset
    return Touching(
        None if is_grip else friction, offset, contact.radius, contact.force, is_grip, contact.grip
    )


def _require_hand(name: str, is_hand: bool, arguments: str) -> None:
    """Raise a ConfigurationError if a part is no hand: only hands accept ``arguments``."""
    if not is_hand:
        raise ConfigurationError(
            "contacts", diagnose("foot-is-no-hand", foot=name, given=arguments)
        )


@lru_cache(maxsize=_CACHE_SIZE)
def _build_with_contacts(robot: Robot, properties: FrozenDict[str, Touching]) -> Robot:
    """Build a robot with the hands, welds and grips of a task (cached)."""
    tools = {
        name: _find_frame(robot, name)
        for name, touching in properties.items()
        if touching.offset is not None
    }
    fixed = [name for name, tool in tools.items() if properties[name].is_fixed and not tool.chain]
    for name in fixed:
        if properties[name].grip is not None:
            raise ConfigurationError("contacts", diagnose("contact-is-on-the-base", name=name))
    hands = {
        name: touching
        for name, touching in properties.items()
        if name in tools and name not in fixed
    }
    last_joints = {name: tools[name].chain[-1:] for name in tools}
    for name, joint in last_joints.items():
        other_geoms = (
            touching
            for touching in last_joints
            if last_joints[touching] == joint and touching != name and properties[touching].is_fixed
        )
        for other_name in other_geoms:
            raise ConfigurationError(
                "contacts", diagnose("welded-twice", name=name, other=other_name)
            )
    if any(any(properties[name].offset or ()) for name in fixed):
        _require_hand(fixed[0], False, "offset")
    built = _make_base_free(robot) if fixed and not robot.floating else robot
    built = _add_hands(built, hands) if hands else built
    return replace(with_touching(built, robot, properties), bare=robot)


def _find_frame(robot: Robot, name: str) -> Tool:
    """Find a frame of the robot by name; ``base`` is the base if no frame has this name."""
    try:
        return find_tool(robot, name)
    except UnknownNameError as error:
        if name == "base":
            return find_tool(robot, robot.base)
        known = dict.fromkeys((*robot.feet, "base", *error.known))
        raise UnknownNameError(
            error.source, "foot or frame", name, known, base=robot.base
        ) from None


def _make_base_free(robot: Robot) -> Robot:
    """Replace the fixed base of a robot by a free base, which a weld can hold; return a copy."""
    description, model = robot.description, robot.mj_model
    spec, base = description.mjcf.copy(), model.body(robot.mj_base).id
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
        for body_id in chain:  # the bodies between world and base have no geoms
            body = spec.body(model.body(body_id).name)
            body.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
            body.pos, body.quat = (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)
        body.pos, body.quat = pose[:3], pose[3:]
        body.add_freejoint().armature = _BASE_ARMATURE_FACTOR * robot.total_mass
        for key in spec.keys:
            key.qpos = np.insert(key.qpos, robot.mj_convention.qpos_index.min(), pose)
    if find_floor(spec) is None:  # an added floor must not collide
        floor = SpecTree(spec).add_floor()
        floor.contype = floor.conaffinity = 0
    built = copy_metadata(build_robot(replace(description, mjcf=spec)), robot)
    for name in ("lowerPositionLimit", "upperPositionLimit", "effortLimit", "velocityLimit"):
        values = getattr(robot.pin_model, name)  # keep changes since the file was read
        getattr(built.pin_model, name)[-len(values) :] = values
    half_extent = float(np.linalg.norm(data.xpos - data.xpos[base], axis=1).max()) / 2  # size [m]
    if not robot.contact_points:
        joints, _ = default_positions(robot)
        if robot.closure is not None:
            closed = robot.closure.close_loops(joints, np.ones(robot.nu))
            joints = joints if closed is None else closed
        built = replace(built, home=np.concatenate([built.home[:7], joints]))
    return built if robot.stand_height else replace(built, stand_height=half_extent)


def _add_hands(robot: Robot, hands: Mapping[str, Touching]) -> Robot:
    """Add a contact point for each hand to URDF and MJCF of a robot; return a copy."""
    (urdf, mjcf), description = robot.description.trees(), robot.description
    model, frames = robot.pin_model.copy(), dict[str, tuple[str, str]]()
    used_names = {site.name for site in mjcf.spec.sites} | {geom.name for geom in mjcf.spec.geoms}
    geoms, added, notes = dict(description.foot_geoms), list[Addition](), list[Diagnostic]()
    geom_names = (str(robot.mj_model.geom(geom).name) for geom in robot.foot_geoms)
    model_geom = next(filter(None, geom_names), None)
    for name, touching in hands.items():
        offset = touching.offset or (0.0, 0.0, 0.0)
        tool = find_place(robot, (_find_frame(robot, name).name, *offset))
        _refuse_foot_link(robot, name, tool)
        frame = f"{name} (contact)"
        while frame in used_names or frame in urdf.links:
            frame += "_"
        body, place = tool.locate_in_mjcf(robot)
        urdf.add_link(frame, tool.link, f"to {frame}", tool.offset)
        add_site(mjcf.spec.body(body), name=frame, pos=place)
        carrier = model.frames[model.getFrameId(tool.link, pin.FrameType.BODY)]
        placement = carrier.placement * pin.SE3(np.eye(3), tool.offset)
        parent = carrier.parentJoint
        model.addFrame(pin.Frame(frame, parent, 0, placement, pin.FrameType.BODY), False)
        radius = touching.radius or _measure_inscribed_radius(robot, tool)
        size = Quantity(radius, "m")
        reason = diagnose("hand-touches-by-ball", name=name, radius=size)
        notes += [] if touching.is_fixed else [reason]
        added.append(Ball(reason, frame, body, radius, tuple(place.tolist()), model_geom))
        added.append(
            DisabledContacts(reason, (frame,))
        )  # ``terrain`` enables contact with the plane
        frames[name], geoms[name] = (frame, frame), (frame, radius)
    # The balls collide with no geom of the model, so that MuJoCo would discard the balls as well.
    mjcf.spec.compiler.discardvisual = False
    given = replace(description, mjcf=mjcf.spec).with_additions(*added)
    built = rebuild_robot(
        robot,
        urdf=to_text(urdf.root),
        mjcf=given.mjcf,
        added=given.added,
        contact_points={**description.contact_points, **frames},
        foot_geoms=geoms,
        made_frames=description.made_frames | {frame for frame, _ in frames.values()},
    )
    # Keep changes of Pinocchio's model since the files were read, such as limits.
    return replace(built, pin_model=model, notes=(*built.notes, *notes))


_PROBE_RADIUS = 1e-4
"""Radius [m] of a small sphere with which the depth of a hand's contact point inside the collision
shapes is computed. The collision library (coal) requires a body with a volume. A point at most this
deep counts as outside. Chosen, not tuned."""

_DEFAULT_BALL_RADIUS = 1e-2
"""Radius [m] of the contact sphere of a hand whose centre is outside of the collision shapes of the
hand. Chosen, not tuned."""


def _measure_inscribed_radius(robot: Robot, tool: Tool) -> float:
    """Return the radius [m] of the largest sphere around a point that fits into a collision shape.

    Shapes of the links that move with the point are examined. If the point is not deeper than
    `_PROBE_RADIUS` inside such a shape, the result is `_DEFAULT_BALL_RADIUS`.
    """
    kinematics, probe = Kinematics(robot.structure), coal.Sphere(_PROBE_RADIUS)
    kinematics.update(robot.neutral())
    rotation, position = kinematics.links[tool.link]
    probe_pose = coal.Transform3s(np.eye(3), rotation @ tool.offset + position)
    depths = [0.0]
    for shape in robot.shapes:
        if shape.joint == (tool.chain or ("",))[-1]:
            (rotation, position), pose = kinematics.links[shape.link], shape.form.pose
            shape_pose = coal.Transform3s(
                rotation @ pose.rotation, rotation @ pose.position + position
            )
            request, result = coal.DistanceRequest(), coal.DistanceResult()
            coal.distance(shape.form.collision, shape_pose, probe, probe_pose, request, result)
            depths.append(-result.min_distance - _PROBE_RADIUS)
    return max(depths) if max(depths) > _PROBE_RADIUS else _DEFAULT_BALL_RADIUS


def _refuse_foot_link(robot: Robot, name: str, tool: Tool) -> None:
    """Raise a ConfigurationError if a hand moves with a foot, or with the base."""
    if not tool.chain:
        raise ConfigurationError("contacts", diagnose("contact-is-on-the-base", name=name))
    structure = robot.structure
    joint = structure.model.frames[structure.links[tool.link]].parentJoint
    for point, foot_joint in structure.parents.items():
        if foot_joint == joint:
            foot = robot.foot_of(point)
            problem = diagnose("contact-is-on-a-foot", name=name, foot=foot)
            raise ConfigurationError("contacts", problem)
