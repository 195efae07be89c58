"""The side of an MJCF in matching: names, what is not the robot, joints that go."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from pathlib import Path

import mujoco
import numpy as np
from lxml import etree

from pupper_analysis.base.arrays import placement_of
from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.errors import ModelError
from pupper_analysis.models import multibody
from pupper_analysis.models.conversion import pinocchio_from_mujoco
from pupper_analysis.models.free_base import delete_joint
from pupper_analysis.models.mjcf import JointKind, compile_spec, numbered
from pupper_analysis.models.urdf_tree import UrdfTree
from pupper_analysis.robot.matching.alignment import with_base
from pupper_analysis.robot.matching.pairs import without_affixes
from pupper_analysis.robot.robot import Robot


def list_hinges(spec: mujoco.MjSpec, source: Path) -> tuple[list[str], list[str], list[Diagnostic]]:
    """Returns the names of the hinges and slides, and of the ball joints, which are taken out.

    A URDF has no ball joints: what they carry is compared as it is at rest. The third says so.
    """
    names, balls = [], []
    for joint in list(spec.joints):
        if joint.type == JointKind.BALL:
            balls.append(joint.name)
            delete_joint(spec, joint)
        elif joint.type != JointKind.FREE:
            names.append(joint.name)
    if balls and not names:
        raise ModelError(source, diagnose("ball-joints-alone"))
    if not balls:
        return names, balls, []
    for key in list(spec.keys):
        spec.delete(key)  # its size no longer fits
    return names, balls, [diagnose("ball-joints-fixed", joints=balls)]


def drop_other_objects(
    spec: mujoco.MjSpec, source: Path, urdf: etree._Element | None
) -> list[Diagnostic]:
    """Keeps the largest tree of joints: a scene may have loose objects besides the robot.

    Beside a robot on a fixed base, a table or a wall would count as part of that base, unless it
    has the name of one of the URDF's links; beside a free one, as part of its com. Limbs that stand
    in the world itself, because the base was fused with it, are the robot's. (Without a URDF, of
    two versions of an MJCF, neither is known.)

    Returns:
        What was left out.
    """
    kinds = mujoco.mjtObj
    links, limbs = set[str](), set[str]()
    if urdf is not None:
        links = set(UrdfTree(urdf).links)
        limbs = {body.name for body in limbs_on_the_world(spec, urdf)}
    size = {body.name: len(body.find_all(kinds.mjOBJ_JOINT)) for body in spec.worldbody.bodies}
    if not any(size.values()):
        raise ModelError(source, diagnose("no-joints"))
    robot = max(spec.worldbody.bodies, key=lambda body: size[body.name])
    fixed = not any(joint.type == JointKind.FREE for joint in robot.joints)
    notes = []
    for body in list(spec.worldbody.bodies):
        names = {body.name, *(below.name for below in body.find_all(kinds.mjOBJ_BODY))}
        # Beside a free robot nothing that stands in the world is of it, but for its ground.
        scenery = not body.mocap and not (names & links if fixed else _has_plane(body))
        if body.name in limbs and robot.name in limbs:
            continue
        if body.mocap:
            _weightless(body)
        if body.name != robot.name and (size[body.name] or scenery):
            left = "body", body.name
            notes.append(diagnose("body-left-out", subject=left, file=source.name, sources=source))
            for eye in (*spec.cameras, *spec.lights):  # MuJoCo refuses those that follow nothing
                if eye.targetbody in names:
                    spec.delete(eye)
            spec.delete(body)
    return notes


def _weightless(body: mujoco.MjsBody) -> None:
    """Takes the mass off a body that is moved by hand: a fixed base would count it as its own."""
    for below in [body, *body.find_all(mujoco.mjtObj.mjOBJ_BODY)]:
        below.mass, below.inertia = 0.0, np.zeros(3)
        for geom in below.geoms:
            geom.mass = geom.density = 0.0


def _has_plane(body: mujoco.MjsBody) -> bool:
    geoms = body.find_all(mujoco.mjtObj.mjOBJ_GEOM)
    return any(geom.type == mujoco.mjtGeom.mjGEOM_PLANE for geom in geoms)


def limbs_on_the_world(spec: mujoco.MjSpec, urdf: etree._Element) -> list[mujoco.MjsBody]:
    """Returns the bodies of the world that move by the joints of a URDF: limbs without a base.

    MuJoCo makes that of a URDF: it fuses what does not move with the world. The joints are known
    by their names, or their names without prefixes and suffixes.
    """
    mine = [joint.name for joint in UrdfTree(urdf).joints.values() if not joint.is_fixed]
    theirs = [joint.name for joint in spec.joints]
    known = {*mine, *without_affixes(mine, theirs, {}).values()}
    return [
        body
        for body in spec.worldbody.bodies
        if any(joint.name in known for joint in body.joints)
        and all(joint.type != JointKind.FREE for joint in body.joints)
    ]


def is_fused(spec: mujoco.MjSpec, joints: Collection[str]) -> bool:
    """Tells whether the world is the base: whether one of some joints is between it and a body."""
    there = (joint for body in spec.worldbody.bodies for joint in body.joints)
    return any(j.name in joints and j.type != JointKind.FREE for j in there)


def bodies_of(robot: Robot) -> dict[str, str]:
    """Returns {base or joint: the body that it moves}."""
    model = robot.mj_model
    bodies = {robot.base: robot.mj_base}
    for name in robot.joint_names:
        bodies[name] = str(model.body(int(model.jnt_bodyid[model.joint(name).id])).name)
    return bodies


def mjcf_tree(
    spec: mujoco.MjSpec, source: Path, base: str = "", frames: Iterable[str] = ()
) -> multibody.MultibodyTree:
    """Returns the parameters of an MJCF's joints and bodies, in the frame of its base.

    Args:
        spec: The MJCF; all its joints but a free one are named hinges or slides.
        source: Where it came from, for messages.
        base: What its base is called.
        frames: Bodies and sites whose places count.

    Raises:
        ModelError: If MuJoCo cannot compile it.
    """
    compiled = compile_spec(spec.copy(), source)
    model = pinocchio_from_mujoco(compiled)
    names = [joint.name for joint in spec.joints if joint.type != JointKind.FREE]
    tree = multibody.from_pinocchio(model, base, names, {name: name for name in frames})
    if tree.floating or not names:
        return tree
    body = int(compiled.jnt_bodyid[compiled.joint(names[0]).id])
    while compiled.body_weldid[body] != 0:
        body = int(compiled.body_parentid[body])
    data = mujoco.MjData(compiled)
    mujoco.mj_kinematics(compiled, data)
    return with_base(tree, placement_of(data.xquat[body], data.xpos[body]).inverse())


_BODIES = (mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD)


def ball_joints(spec: mujoco.MjSpec) -> dict[str, list[str]]:
    """Returns {body: its ball joints}, before these are taken out."""
    found: dict[str, list[str]] = {}
    for joint in spec.joints:
        if joint.type == JointKind.BALL:
            found.setdefault(joint.parent.name, []).append(joint.name)
    return found


def open_loops(
    spec: mujoco.MjSpec, balls: dict[str, list[str]], gone: Collection[str]
) -> tuple[tuple[str, ...], list[Diagnostic]]:
    """Takes out what would bind joints through others that are about to be held, in place.

    A rod that is held at zero would hold the ankle that it turns. Opened, the tree of the URDF is
    left: its joints are driven by themselves, and their torques are theirs, not those of motors
    behind the rods.

    Args:
        spec: The MJCF, without its ball joints.
        balls: {body: the ball joints that it had}.
        gone: The joints that only the MJCF has.

    Returns:
        Those of the joints that are gone by which the loops led, and what was opened.
    """
    driven = {actuator.target for actuator in spec.actuators}
    opened, freed, through = [], dict[str, None](), dict[str, None]()
    for index, equality in enumerate(list(spec.equalities)):
        joints = _joints_between(spec, equality, balls)
        if equality.active and not joints.isdisjoint(gone):
            kind = mujoco.mjtEq(equality.type).name.removeprefix("mjEQ_").lower()
            ends = [equality.name1, equality.name2 or "world"]
            opened.append(f"{kind} {equality.name or numbered(index, *ends)}")
            through |= dict.fromkeys(name for name in gone if name in joints)
            freed |= dict.fromkeys(sorted(joints - set(gone) - driven))
            spec.delete(equality)
    messages = [diagnose("loops-opened", constraints=opened, freed=freed)] if opened else []
    return tuple(through), messages


def _joints_between(
    spec: mujoco.MjSpec, equality: mujoco.MjsEquality, balls: dict[str, list[str]]
) -> set[str]:
    """Returns the joints on the way between what an equality constraint binds."""
    if equality.type == mujoco.mjtEq.mjEQ_JOINT:
        return {name for name in (equality.name1, equality.name2) if name}
    if equality.type not in _BODIES:
        return set()
    directions = []
    for name in (equality.name1, equality.name2):
        site = equality.objtype == mujoco.mjtObj.mjOBJ_SITE
        body = spec.site(name).parent if site and name else spec.body(name) if name else None
        way: set[str] = set()
        while body is not None and body.name != "world":
            way |= {joint.name for joint in body.joints} | set(balls.get(body.name, ()))
            body = body.parent
        directions.append(way)
    return directions[0] ^ directions[1]
