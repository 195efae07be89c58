"""Rules about how rotations are written."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from pupper_analysis.base.diagnostics import Quantity, Vector, diagnose
from pupper_analysis.models.joint_kinds import JointKind
from pupper_analysis.models.places import Place
from pupper_analysis.models.stated.mjcf import line_of
from pupper_analysis.models.stated.model import MjcfModel, UrdfModel
from pupper_analysis.models.xml import parse_numbers
from pupper_analysis.tools.audit.registry import Found, rule

FULL_TURN = 2 * math.pi + 1e-3


@rule
def rpy_in_degrees(robot: UrdfModel | MjcfModel) -> Iterator[Found]:
    """Finds angles above 2 pi in magnitude in ``rpy`` and, in a file in radians, in ``euler``."""
    if isinstance(robot, UrdfModel):
        for element in robot.file.root.iter("origin"):
            rpy = parse_numbers(element.get("rpy"), "0 0 0")
            if np.abs(rpy).max() > FULL_TURN:
                owner = element.getparent()
                while owner.tag not in ("link", "joint") and owner.getparent() is not None:
                    owner = owner.getparent()
                line = Place(robot.file.path, element.sourceline)
                told = diagnose("rpy-in-degrees", attribute="rpy", angles=Vector(tuple(rpy), "rad"))
                yield Found(str(owner.tag), str(owner.get("name")), told, place=line)
        return
    if robot.file.spec.compiler.degree:
        return
    for tag, name, element, place in _posed(robot):
        euler = np.array(element.alt.euler)  # type: ignore[attr-defined]
        if np.isfinite(euler).all() and np.abs(euler).max() > FULL_TURN:
            told = diagnose("rpy-in-degrees", attribute="euler", angles=Vector(tuple(euler), "rad"))
            yield Found(tag, name, told, place=place)


@rule
def quaternion_not_unit(robot: MjcfModel) -> Iterator[Found]:
    """Finds lengths off 1 by more than 1e-3, but for (1, 0, 0, 1) and the like."""
    for tag, name, element, place in _posed(robot):
        quaternion = np.array(element.quat)  # type: ignore[attr-defined]
        length = float(np.linalg.norm(quaternion))
        parts = np.abs(quaternion[quaternion != 0])
        on_purpose = length > 0.5 and np.ptp(parts) < 1e-9 * parts.max()
        if abs(length - 1.0) > 1e-3 and not on_purpose:
            told = diagnose(
                "quaternion-not-unit",
                quaternion=Vector(tuple(quaternion), "1"),
                length=Quantity(length, "1"),
            )
            yield Found(tag, name, told, place=place)


@rule
def keyframe_quaternion(robot: MjcfModel) -> Iterator[Found]:
    """Finds lengths off 1 by more than 1e-3, of free and ball joints in keyframes."""
    if robot.mj_model is None:
        return
    model = robot.mj_model
    for joint in range(model.njnt):
        kind = JointKind(int(model.jnt_type[joint]))
        if kind not in (JointKind.FREE, JointKind.BALL):
            continue
        start = int(model.jnt_qposadr[joint]) + (3 if kind == JointKind.FREE else 0)
        for key in robot.file.spec.keys:
            quaternion = np.array(key.qpos)[start : start + 4]
            length = float(np.linalg.norm(quaternion))
            if len(quaternion) == 4 and abs(length - 1.0) > 1e-3:
                told = diagnose(
                    "keyframe-quaternion",
                    quaternion=Vector(tuple(quaternion), "1"),
                    length=Quantity(length, "1"),
                )
                yield Found("key", key.name, told)


def _posed(robot: MjcfModel) -> Iterator[tuple[str, str, object, Place | None]]:
    """Yields all bodies, geoms and sites: tag, name, element, and place if it has no name."""
    around = ""
    for body in robot.file.spec.bodies:
        around = body.name or around
        for tag, elements in (("body", [body]), ("geom", body.geoms), ("site", body.sites)):
            for element in elements:
                place = None if element.name else line_of(robot.file, element, around)
                yield tag, element.name, element, place
