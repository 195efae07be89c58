"""What a simulation needs besides the robot: ground, servos, a start pose, an IMU."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import mujoco
import numpy as np
from lxml import etree
from numpy.typing import NDArray

from pupper_analysis.convert.from_urdf import FLOOR, UrdfBodies
from pupper_analysis.convert.xml_text import element, words
from pupper_analysis.diagnostics import Diagnostic, diagnose
from pupper_analysis.prepare.contact_points import lowest
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.stand import Stand, stand_statics

Array = NDArray[np.float64]
Gains = Mapping[str, tuple[float, float]]

_KEY_DIGITS = 6
"""Decimals of the keyframe's angles and height: a micrometre, which the servos make up for."""


GRIP: Final = {"cone": "elliptic", "impratio": "100"}
"""How contacts hold: friction a hundred times as stiff as the ground, on a cone that is round. With
MuJoCo's defaults (a pyramid, 1) feet creep: Go2 by 58 mm/s on a slope of 17 degrees, so by 0.35; a
pyramid with an impratio of 10 shakes. The models of MuJoCo Menagerie have the same."""


def add_scene(root: etree._Element) -> None:
    """Adds light, a floor and its look to an MJCF, and contacts that hold."""
    root.insert(1, etree.Element("option", GRIP))
    asset, worldbody = root.find("asset"), root.find("worldbody")
    assert asset is not None
    assert worldbody is not None
    element(
        asset, "texture", name=FLOOR, type="2d", builtin="checker", width="256", height="256",
        rgb1="0.75 0.77 0.8", rgb2="0.85 0.87 0.9",
    )  # fmt: skip
    element(asset, "material", name=FLOOR, texture=FLOOR, texrepeat="4 4", texuniform="true")
    light = etree.Element("light", {"pos": "0 0 3", "dir": "0 0 -1", "directional": "true"})
    floor = {"name": FLOOR, "type": "plane", "size": "0 0 0.05", "material": FLOOR}
    worldbody.insert(0, light)
    worldbody.insert(1, etree.Element("geom", floor))


def add_imu(root: etree._Element, bodies: UrdfBodies) -> Diagnostic:
    """Adds an IMU: on the link that is named after one, otherwise at the base's origin.

    Returns:
        What was added.
    """
    named = sorted((name for name in bodies.frames if "imu" in name.lower()), key=len)
    link = named[0] if named else bodies.root
    site = named[0] if named else "imu"
    if all(node.get("name") != site for node in root.iter("site")):  # merged links are sites
        body = next(node for node in root.iter("body") if node.get("name") == link)
        element(body, "site", name=site)
    sensor = root.find("sensor")
    if sensor is None:
        sensor = element(root, "sensor")
    for tag, name in (("gyro", "gyro"), ("accelerometer", "accelerometer")):
        element(sensor, tag, name=name, site=site)
    element(sensor, "framequat", name="orientation", objtype="site", objname=site)
    return diagnose("imu-added", link=link if named else None)


def add_mimics(root: etree._Element, bodies: UrdfBodies) -> None:
    """Adds the couplings of joints that follow others, as equality constraints."""
    if not bodies.mimics:
        return
    equality = element(root, "equality")
    for joint in bodies.mimics:
        mimic = joint.find("mimic")
        offset, factor = mimic.get("offset") or "0", mimic.get("multiplier") or "1"
        element(
            equality,
            "joint",
            joint1=str(joint.get("name")),
            joint2=str(mimic.get("joint")),
            polycoef=f"{offset} {factor} 0 0 0",
        )


def add_servos(root: etree._Element, bodies: UrdfBodies, gains: Gains) -> None:
    """Adds a position servo for each joint that follows no other.

    Args:
        root: The MJCF.
        bodies: What is known of the URDF.
        gains: {joint: kp (N m/rad), kd (N m s/rad)}, in the servos' order.
    """
    followers = {str(joint.get("name")) for joint in bodies.mimics}
    actuator = element(root, "actuator")
    for name, (stiffness, damping) in gains.items():
        if name in followers:
            continue
        effort = bodies.efforts.get(name)
        element(
            actuator,
            "position",
            name=name,
            joint=name,
            kp=words(stiffness),
            kv=words(damping),
            forcerange=None if effort is None else f"-{effort.removeprefix('+')} {effort}",
        )


def add_contacts(root: etree._Element, robot: Robot) -> None:
    """Takes over what was made ready for contact: balls for round meshes, shapes off, pairs apart.

    Args:
        root: The MJCF.
        robot: The robot as ``load_robot`` prepared it, of this MJCF.
    """
    spec = robot.description.mjcf
    geoms = {str(node.get("name")): node for node in root.iter("geom") if node.get("name")}
    bodies = {str(node.get("name")): node for node in root.iter("body")}
    for geom in spec.geoms:
        node = geoms.get(geom.name)
        if node is None and geom.name.endswith(" (ball)"):
            element(
                bodies[geom.parent.name],
                "geom",
                name=geom.name.replace(" (ball)", "_ball"),
                class_="collision",
                type="sphere",
                size=words(geom.size[0]),
                pos=words(geom.pos),
            )
        elif node is not None and not (geom.contype or geom.conaffinity):
            node.set("contype", "0")
            node.set("conaffinity", "0")
    if len(spec.excludes):
        contact = element(root, "contact")
        for exclude in spec.excludes:
            element(contact, "exclude", body1=exclude.bodyname1, body2=exclude.bodyname2)


def add_home(
    root: etree._Element, bodies: UrdfBodies, robot: Robot, stand: Stand, kp: Array
) -> None:
    """Adds the keyframe ``home``: the stand, and the commands with which the servos hold it."""
    rounded = stand.qpos.copy()
    rounded[:2] = 0.0
    rounded[2] = round(float(rounded[2]), _KEY_DIGITS)
    held = stand_statics(robot, stand).joint_torques.tolist()
    data = mujoco.MjData(robot.mj_model)
    rounded[-robot.nu :] = np.round(rounded[-robot.nu :], _KEY_DIGITS)
    robot.mj_convention.set_state(data, rounded)
    torques = _with_followers(bodies, dict(zip(robot.joint_names, held, strict=True)))
    ctrl = {
        name: round(angle + torques[name] / stiffness, _KEY_DIGITS)
        for name, angle, stiffness in zip(
            robot.joint_names, rounded[-robot.nu :].tolist(), kp.tolist(), strict=True
        )
        if name in torques
    }
    key = element(element(root, "keyframe"), "key", name="home", qpos=words(data.qpos))
    key.set("ctrl", words(list(ctrl.values())))


def lift_base(root: etree._Element, bodies: UrdfBodies, model: mujoco.MjModel) -> None:
    """Puts the base where nothing is in the ground, with all joints at zero or as it stands.

    A simulation that is begun without the keyframe would throw it up by what is in the ground.

    Args:
        root: The MJCF, with its keyframe if it has one.
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
    base = next(node for node in root.iter("body") if node.get("name") == bodies.root)
    heights = [-lowest(model, data, touching)] if touching else []
    key = root.find("keyframe/key")
    if key is not None:
        heights.append(float(str(key.get("qpos")).split()[2]))
    if heights and max(heights) > 0:
        base.set("pos", words([0.0, 0.0, float(f"{max(heights):.{_KEY_DIGITS}f}")]))


def _with_followers(bodies: UrdfBodies, torques: dict[str, float]) -> dict[str, float]:
    """Returns the torques of joints that follow no other: with what their followers need.

    By virtual work, the torque of a follower counts by its multiplier.
    """
    total = dict(torques)
    waiting = {
        str(joint.get("name")): (
            str(joint.find("mimic").get("joint")),
            float(joint.find("mimic").get("multiplier") or 1),
        )
        for joint in bodies.mimics
    }
    while waiting:  # a follower that none waits for first
        leaders = {leader for leader, _ in waiting.values()}
        last = next((name for name in waiting if name not in leaders), None)
        if last is None:  # they follow each other in a circle
            break
        leader, factor = waiting.pop(last)
        total[leader] += factor * total[last]
    followers = {str(joint.get("name")) for joint in bodies.mimics}
    return {name: torque for name, torque in total.items() if name not in followers}
