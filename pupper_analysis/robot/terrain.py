"""A robot's MuJoCo model on slopes and steps."""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from dataclasses import replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.arrays import quaternion_from_rotation
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ModelError
from pupper_analysis.models.mjcf import CONTACT_OF_GEOM
from pupper_analysis.models.spec_tree import SpecTree
from pupper_analysis.robot.build import rebuild_robot
from pupper_analysis.robot.contact import ContactParameters
from pupper_analysis.robot.floor import floor_of, turn_floor
from pupper_analysis.robot.ground import Ground
from pupper_analysis.robot.robot import Robot, Touching

Array = NDArray[np.float64]


def on_ground(robot: Robot, ground: Ground, places: Mapping[str, Array]) -> Robot:
    """Puts a robot on a slope or on steps, in its MuJoCo model.

    Args:
        robot: The robot; its MJCF has a floor.
        ground: The slope and the steps.
        places: {contact point: (3,) where its centre will be, lifted or not, on rigid ground (m)},
            for the steps.

    Returns:
        The same robot, whose MuJoCo model has the floor turned and a box for each step. The steps
        have the floor's contact parameters. A foot on a step does not touch the floor, into which
        it would sink through a low one, and which covers a step down. A flat foot touches a plane
        on top of its box, which only it does: MuJoCo's contacts of a sole with a plane are other
        than those with a box, and its contact points are those with a plane. What a hand touches
        only its ball does: its own shapes are around it.

    Raises:
        ModelError: If the MJCF leaves no bits of ``contype`` for that.
    """
    if ground.level:
        return robot
    spec = robot.description.mjcf.copy()
    floor = floor_of(spec) or SpecTree(spec).add_floor()
    turn_floor(floor, quaternion_from_rotation(ground.rotation()))
    steps = ground.steps(places, robot.contact_radius)
    soles = [foot for foot in steps if len(robot.feet[foot]) > 1]
    alone = [*soles, *(foot for foot in steps if foot in robot.hands)]
    contype, conaffinity = floor.contype, floor.conaffinity
    free = _leave_floor(robot, spec, floor, steps, alone)
    highest = max(int(geom.priority) for geom in spec.geoms)
    for foot, step in steps.items():
        quat = quaternion_from_rotation(step.rotation)
        box = spec.worldbody.add_geom(
            name=f"step_{foot}",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=step.half,
            pos=step.centre,
            quat=quat,
            contype=contype,
            conaffinity=conaffinity,
            rgba=(0.6, 0.62, 0.66, 1.0),
        )
        _like_floor(box, floor)
        if foot in robot.hands:
            box.contype, box.conaffinity = 0, free[foot]
        if foot in soles:
            box.contype, box.conaffinity = 0, floor.conaffinity
            top = spec.worldbody.add_geom(
                name=f"top_{foot}",
                type=mujoco.mjtGeom.mjGEOM_PLANE,
                size=(*step.half[:2], 0.01),
                pos=step.top,
                quat=quat,
                contype=0,
                conaffinity=free[foot],
                rgba=(0.0, 0.0, 0.0, 0.0),
            )
            _like_floor(top, floor)
            box = top
        if robot.touching.get(foot, Touching()).friction is not None:
            _state_contact(box, robot.contacts[robot.feet[foot][0]], highest + 1)
    return replace(rebuild_robot(robot, mjcf=spec), fingerprint=robot.fingerprint)


def _state_contact(geom: mujoco.MjsGeom, parameters: ContactParameters, priority: int) -> None:
    """Has contacts with a geom be so, whatever the other one states; margins still add up."""
    geom.priority, geom.condim = priority, parameters.condim
    geom.friction = np.take(parameters.friction, (0, 2, 3))
    geom.solref, geom.solimp = parameters.solref, parameters.solimp


def _like_floor(geom: mujoco.MjsGeom, floor: mujoco.MjsGeom) -> None:
    """Gives a geom the floor's contact parameters, but for what it touches."""
    for word in CONTACT_OF_GEOM:
        if word not in ("contype", "conaffinity", "group"):
            setattr(geom, word, getattr(floor, word))


def _leave_floor(
    robot: Robot,
    spec: mujoco.MjSpec,
    floor: mujoco.MjsGeom,
    feet: Container[str],
    alone: Sequence[str],
) -> dict[str, int]:
    """Lets all that touched the floor touch it, except some feet's foot_geoms.

    Returns:
        {foot in ``alone``: the bit of ``contype`` that only its geoms have}.

    Raises:
        ModelError: If the MJCF leaves no bits.
    """
    spec.compile()  # numbers the geoms
    geoms = [geom for geom in spec.geoms if geom.id != floor.id]
    touching = {
        geom.id
        for geom in geoms
        if geom.contype & floor.conaffinity or geom.conaffinity & floor.contype
    }
    taken = floor.contype | floor.conaffinity
    for geom in geoms:
        taken |= geom.contype | geom.conaffinity
    bits = [1 << bit for bit in range(31) if not taken & 1 << bit]
    if len(bits) < 1 + len(alone):
        needed = 1 + len(alone)
        problem = diagnose("bits-used-up", left=len(bits), feet=len(alone), needed=needed)
        raise ModelError(robot.description.mjcf_source, problem)
    own = dict(zip(alone, bits[1:], strict=False))
    floor.contype, floor.conaffinity = 0, bits[0]
    for geom in geoms:
        foot = robot.foot_geoms.get(geom.id)
        if foot in own:  # a hand's touches nothing else
            geom.contype |= own[foot]
        elif foot not in feet and geom.id in touching:
            geom.contype |= bits[0]
    return own
