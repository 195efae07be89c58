"""Closed loops of an MJCF that lead through joints that a URDF lacks: rods, cranks, ball joints."""

from __future__ import annotations

from collections.abc import Collection

import mujoco

from pupper_analysis.diagnostics import Diagnostic, diagnose
from pupper_analysis.models.joint_kinds import JointKind

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
            opened.append(f"{kind} {equality.name or f'#{index}'}")
            through |= dict.fromkeys(name for name in gone if name in joints)
            freed |= dict.fromkeys(sorted(joints - set(gone) - driven))
            spec.delete(equality)
    told = [diagnose("loops-opened", constraints=opened, freed=freed)] if opened else []
    return tuple(through), told


def _joints_between(
    spec: mujoco.MjSpec, equality: mujoco.MjsEquality, balls: dict[str, list[str]]
) -> set[str]:
    """Returns the joints on the way between what an equality constraint binds."""
    if equality.type == mujoco.mjtEq.mjEQ_JOINT:
        return {name for name in (equality.name1, equality.name2) if name}
    if equality.type not in _BODIES:
        return set()
    ways = []
    for name in (equality.name1, equality.name2):
        site = equality.objtype == mujoco.mjtObj.mjOBJ_SITE
        body = spec.site(name).parent if site and name else spec.body(name) if name else None
        way: set[str] = set()
        while body is not None and body.name != "world":
            way |= {joint.name for joint in body.joints} | set(balls.get(body.name, ()))
            body = body.parent
        ways.append(way)
    return ways[0] ^ ways[1]
