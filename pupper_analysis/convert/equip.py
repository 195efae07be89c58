"""What a simulation needs besides the robot: servos, a start pose, an IMU, contacts."""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.convert.from_urdf import UrdfBodies
from pupper_analysis.diagnostics import Diagnostic, diagnose
from pupper_analysis.models.mjcf_xml import MjcfXml
from pupper_analysis.models.xml_text import write_numbers
from pupper_analysis.prepare.contact_points import lowest_point
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.stand import Stand, stand_statics

Array = NDArray[np.float64]
Gains = Mapping[str, tuple[float, float]]

_KEY_DIGITS = 6
"""Decimals of the keyframe's angles and height: a micrometre, which the servos make up for."""


def add_imu(mjcf: MjcfXml, bodies: UrdfBodies) -> Diagnostic:
    """Adds an IMU: on the link that is named after one, otherwise at the base's origin.

    Returns:
        What was added.
    """
    named = sorted(
        (name for name in bodies.frames if "imu" in name.lower()),
        key=lambda name: (len(name), name),
    )
    mjcf.add_imu(named[0] if named else bodies.root, named[0] if named else "imu")
    return diagnose("imu-added", link=named[0] if named else None)


def add_servos(mjcf: MjcfXml, bodies: UrdfBodies, gains: Gains) -> None:
    """Adds a position servo for each joint that follows no other.

    Args:
        mjcf: The MJCF.
        bodies: What is known of the URDF.
        gains: {joint: kp (N m/rad), kd (N m s/rad)}, in the servos' order.
    """
    for name, (stiffness, damping) in gains.items():
        if name not in bodies.mimics:
            effort = bodies.efforts.get(name)
            limits = None if effort is None else (f"-{effort.removeprefix('+')}", effort)
            mjcf.add_position_servo(name, stiffness, damping, limits)


def add_contacts(mjcf: MjcfXml, robot: Robot) -> None:
    """Takes over what was made ready for contact: balls for round meshes, shapes off, pairs apart.

    Args:
        mjcf: The MJCF.
        robot: The robot as ``load_robot`` prepared it, of this MJCF.
    """
    spec = robot.description.mjcf
    own = {str(geom.get("name")) for geom in mjcf.geoms if geom.get("name")}
    for geom in spec.geoms:
        if geom.name not in own and geom.name.endswith(" (ball)"):
            name = geom.name.replace(" (ball)", "_ball")
            mjcf.add_ball(name, geom.parent.name, geom.size[0], geom.pos)
    off = [geom.name for geom in spec.geoms if not (geom.contype or geom.conaffinity)]
    mjcf.turn_off_contact([name for name in off if name in own])
    for exclude in spec.excludes:
        mjcf.exclude_contact(exclude.bodyname1, exclude.bodyname2)


def add_home(mjcf: MjcfXml, bodies: UrdfBodies, robot: Robot, stand: Stand, kp: Array) -> None:
    """Adds the keyframe ``home``: the stand, and the commands with which the servos hold it."""
    rounded = stand.qpos.copy()
    rounded[:2] = 0.0
    rounded[2] = round(float(rounded[2]), _KEY_DIGITS)
    held = stand_statics(robot, stand).joint_torques.tolist()
    data = mujoco.MjData(robot.mj_model)
    rounded[-robot.nu :] = np.round(rounded[-robot.nu :], _KEY_DIGITS)
    robot.mj_convention.set_state(data, rounded)
    torques = _with_followers(bodies, dict(zip(robot.joint_names, held, strict=True)))
    ctrl = [
        round(angle + torques[name] / stiffness, _KEY_DIGITS)
        for name, angle, stiffness in zip(
            robot.joint_names, rounded[-robot.nu :].tolist(), kp.tolist(), strict=True
        )
        if name in torques
    ]
    mjcf.set_home(data.qpos, ctrl)


def lift_base(mjcf: MjcfXml, bodies: UrdfBodies, model: mujoco.MjModel) -> None:
    """Puts the base where nothing is in the ground, with all joints at zero or as it stands.

    A simulation that is begun without the keyframe would throw it up by what is in the ground.

    Args:
        mjcf: The MJCF, with its keyframe if it has one.
        bodies: What is known of the URDF.
        model: What MuJoCo compiles of it, so far.
    """
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    touching = [
        geom
        for geom in range(model.ngeom)
        if model.body_weldid[model.geom_bodyid[geom]]
        and (model.geom_contype[geom] or model.geom_conaffinity[geom])
    ]
    heights = [-lowest_point(model, data, touching)] if touching else []
    home = mjcf.home
    if home is not None:
        heights.append(float(home[2]))
    if heights and max(heights) > 0:
        height = write_numbers([0.0, 0.0, float(f"{max(heights):.{_KEY_DIGITS}f}")])
        mjcf.body(bodies.root).element.set("pos", height)


def _with_followers(bodies: UrdfBodies, torques: dict[str, float]) -> dict[str, float]:
    """Returns the torques of joints that follow no other: with what their followers need.

    By virtual work, the torque of a follower counts by its multiplier.
    """
    total = dict(torques)
    waiting = {name: (mimic[0], float(mimic[1])) for name, mimic in bodies.mimics.items()}
    while waiting:  # a follower that none waits for first
        leaders = {leader for leader, _ in waiting.values()}
        last = next((name for name in waiting if name not in leaders), None)
        if last is None:  # they follow each other in a circle
            break
        leader, factor = waiting.pop(last)
        total[leader] += factor * total[last]
    return {name: torque for name, torque in total.items() if name not in bodies.mimics}
