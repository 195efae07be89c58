"""A robot's MuJoCo model on slopes and steps."""

from __future__ import annotations

from collections.abc import Container, Mapping
from dataclasses import replace

import mujoco
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.robot.build import add_floor, floor_of, rebuilt
from pupper_analysis.robot.ground import STEP_HALF_WIDTH, Ground
from pupper_analysis.robot.robot import Robot

Array = NDArray[np.float64]


def on_ground(robot: Robot, ground: Ground, places: Mapping[str, Array]) -> Robot:
    """Puts a robot on a slope or on steps, in its MuJoCo model.

    Args:
        robot: The robot; its MJCF has a floor.
        ground: The slope and the steps.
        places: {foot: (3,) where its centre will be, lifted or not (m)}, for the steps.

    Returns:
        The same robot, whose MuJoCo model has the floor turned and a box for each step. The steps
        have the floor's contact parameters. A foot on a step does not touch the floor, into which
        it would sink through a low one.
    """
    if ground.level:
        return robot
    spec = robot.description.mjcf.copy()
    floor = floor_of(spec) or add_floor(spec)
    quat = pin.Quaternion(ground.rotation()).coeffs()[[3, 0, 1, 2]]
    floor.quat = quat
    steps = [foot for foot, height in ground.heights.items() if height > 0]
    contype, conaffinity = floor.contype, floor.conaffinity
    _leave_floor(robot, spec, floor, steps)
    for foot in steps:
        centre, half = ground.step(foot, places[foot], STEP_HALF_WIDTH)
        spec.worldbody.add_geom(
            name=f"step_{foot}",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=half,
            pos=centre,
            quat=quat,
            condim=floor.condim,
            contype=contype,
            conaffinity=conaffinity,
            friction=floor.friction,
            solref=floor.solref,
            solimp=floor.solimp,
            solmix=floor.solmix,
            priority=floor.priority,
            rgba=(0.6, 0.62, 0.66, 1.0),
        )
    return replace(rebuilt(robot, mjcf=spec), fingerprint=robot.fingerprint)


def _leave_floor(
    robot: Robot, spec: mujoco.MjSpec, floor: mujoco.MjsGeom, feet: Container[str]
) -> None:
    """Lets all that touched the floor touch it, except some feet's foot_geoms."""
    spec.compile()  # numbers the geoms
    geoms = [geom for geom in spec.geoms if geom.id != floor.id]
    touching = [
        geom
        for geom in geoms
        if geom.contype & floor.conaffinity or geom.conaffinity & floor.contype
    ]
    taken = floor.contype | floor.conaffinity
    for geom in geoms:
        taken |= geom.contype | geom.conaffinity
    free = next(1 << bit for bit in range(31) if not taken & 1 << bit)
    floor.contype, floor.conaffinity = 0, free
    for geom in touching:
        if robot.foot_geoms.get(geom.id) not in feet:
            geom.contype |= free
