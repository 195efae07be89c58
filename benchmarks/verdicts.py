"""Compare verdicts of `stand` on random robots with simulations of the same files in bare MuJoCo.

    python benchmarks/verdicts.py RESULTS.jsonl [--robots 30] [--seed 700000] [--csv FILE.csv]

Each random robot gives ten verdicts: the sound files, four of six options (payload, gains, slope,
height, swing foot, pitch), and five edits, each of which gives one attribute an absent, zero,
negative or otherwise wrong value. Every case is written to RESULTS.jsonl when it ends; a repeated
command continues after the last case.

The independent simulation loads the MJCF with ``mujoco`` alone, and adds the payload, the slope and
the servos of the case. It starts in the stand with the commands of the verdict (``ctrl = q* + tau /
kp``), without a nudge and with six nudges of the base of 0.05 m/s, and lasts for 20 s, or until the
robot falls or is at rest. The worst of the seven runs counts: the robot *falls* if the CoM loses 40
% of the height, the base tilts by 40 deg, or MuJoCo resets the state; it *stands* if the CoM has
lost less than 10 %, the base has tilted by less than 10 deg, the CoM has moved by less than 30 % of
its height, and no speed exceeds 0.02 m/s or rad/s in the last 2 s. All other outcomes are
*between*. The unmodified file is simulated from the keyframe in the same way.

A verdict is a *false HOLDS* if it passes and the robot falls, or if a file with servos falls from
its keyframe (two thirds of the sound files have servos, and all edited files). It is a *false
FAILS* if it is FAILS, the robot stands, the file stands from the keyframe, too, and the first
failure is no property of the file, such as a motor without torque.
"""

from __future__ import annotations

import argparse
import json
import math
import re
import sys
import time
import traceback
from collections import defaultdict
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from tables import write_csv

import pupper_analysis as pa
from pupper_analysis.present.verdict import format_verdict
from pupper_analysis.robot.plane import Contact, Slope
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import model_with_servos
from pupper_analysis.robot.tool import with_payload
from pupper_analysis.simulation.verdict import Verdict
from pupper_analysis.stance.soft_ground import solve_stand_as_simulated
from pupper_analysis.stance.stand import Stand, stand_statics
from pupper_analysis.stance.task import StandTask
from tests.support import random_legged

Array = NDArray[np.float64]
Random = np.random.Generator
Edit = Callable[[str, str, Random], tuple[str, str]]
"""Return the changed texts of URDF and MJCF."""

DURATION = 20.0
"""Simulated time of each run [s]."""

NUDGE_SPEED = 0.05
"""Speed that a nudge adds to the base [m/s]."""

STAND_NUDGE_TIME, KEYFRAME_NUDGE_TIME = 2.0, 8.0
"""Time of the nudge in runs from the stand and from the keyframe [s]."""

RESET_WARNINGS = tuple(
    getattr(mujoco.mjtWarning, f"mjWARN_BAD{name}").value for name in ("QPOS", "QVEL", "QACC")
)
"""Warnings after which MuJoCo resets the state."""

NUM_EDITS, NUM_OPTIONS = 5, 4
"""Number of edits and of options per robot."""

STATED_FAILURES = {"motors-without-torque", "feet-without-friction"}
"""Codes of failures that are properties of the files, and that MuJoCo does not simulate."""

URDF_LIMITS = {"effort, all 1"}
"""Edits that reduce torque limits of the URDF alone. The verdict applies the smallest limit of both
files; bare MuJoCo applies those of the MJCF."""


# ------------------------------------------------------------------------------- files and edits


def change_numbers(
    attribute: str, change: Callable[[float], float], random: Random | None, text: str
) -> str:
    """Change all numbers of an attribute; with ``random``, of a single element."""
    found = list(re.finditer(rf'(?<= {attribute}=")[^"]+(?=")', text))
    if random is not None and found:
        found = [found[int(random.integers(len(found)))]]
    for match in reversed(found):
        values = " ".join(f"{change(float(word)):.9g}" for word in match[0].split())
        text = text[: match.start()] + values + text[match.end() :]
    return text


def change_one_of_list(
    attribute: str, change: Callable[[float], float], random: Random, text: str
) -> str:
    """Change a single number, not zero, in one list of an attribute.

    The third and fourth numbers are kept: base height and first quaternion entry of a ``qpos``.
    """
    found = list(re.finditer(rf'(?<= {attribute}=")[^"]+(?=")', text))
    if not found:
        return text
    match = found[int(random.integers(len(found)))]
    values = [float(word) for word in match[0].split()]
    places = [place for place, value in enumerate(values) if value and place not in (2, 3)]
    if not places:
        return text
    place = int(random.choice(places))
    values[place] = change(values[place])
    return text[: match.start()] + " ".join(f"{v:.9g}" for v in values) + text[match.end() :]


def raise_base(text: str, clearance: float) -> str:
    """Move the base in the keyframe so that the lowest point has a clearance [m]."""
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_kinematics(model, data)
    floor = model.geom("ground").id
    distances = [
        mujoco.mj_geomDistance(model, data, floor, geom, 5.0, None)
        for geom in range(model.ngeom)
        if geom != floor and model.geom_contype[geom]
    ]
    qpos = data.qpos.copy()
    qpos[2] += clearance - min(distances)
    values = " ".join(repr(value) for value in qpos.tolist())
    return re.sub(r'(?<= qpos=")[^"]+', values, text, count=1)


def mjcf_edit(change: Callable[[str, Random], str]) -> Edit:
    """Return an edit of the MJCF."""
    return lambda urdf, mjcf, random: (urdf, change(mjcf, random))


def urdf_edit(change: Callable[[str, Random], str]) -> Edit:
    """Return an edit of the URDF."""
    return lambda urdf, mjcf, random: (change(urdf, random), mjcf)


def mjcf_all(attribute: str, change: Callable[[float], float]) -> Edit:
    """Return an edit of all elements of the MJCF with an attribute."""
    return mjcf_edit(lambda text, _: change_numbers(attribute, change, None, text))


def mjcf_one(attribute: str, change: Callable[[float], float]) -> Edit:
    """Return an edit of one element of the MJCF with an attribute."""
    return mjcf_edit(lambda text, random: change_numbers(attribute, change, random, text))


def mjcf_listed(attribute: str, change: Callable[[float], float]) -> Edit:
    """Return an edit of one number in a list of the MJCF."""
    return mjcf_edit(lambda text, random: change_one_of_list(attribute, change, random, text))


def mjcf_absent(attribute: str) -> Edit:
    """Return an edit that deletes an attribute from all elements of the MJCF."""
    return mjcf_edit(lambda text, _: re.sub(rf' {attribute}="[^"]*"', "", text))


def mjcf_text(old: str, new: str, count: int = 0) -> Edit:
    """Return an edit that replaces a regular expression in the MJCF."""
    return mjcf_edit(lambda text, _: re.sub(old, new, text, count=count))


def urdf_all(attribute: str, change: Callable[[float], float]) -> Edit:
    """Return an edit of all elements of the URDF with an attribute."""
    return urdf_edit(lambda text, _: change_numbers(attribute, change, None, text))


def urdf_one(attribute: str, change: Callable[[float], float]) -> Edit:
    """Return an edit of one element of the URDF with an attribute."""
    return urdf_edit(lambda text, random: change_numbers(attribute, change, random, text))


def zero(_: float) -> float:
    return 0.0


def negated(value: float) -> float:
    return -value


def scaled(factor: float) -> Callable[[float], float]:
    return lambda value: factor * value


GROUND = '<geom name="ground"'
"""Text at which the floor of an MJCF begins."""

EDITS: dict[str, Edit] = {
    "keyframe ctrl in degrees": mjcf_all("ctrl", math.degrees),
    "keyframe ctrl in degrees, feet on the floor": mjcf_edit(
        lambda text, _: raise_base(change_numbers("ctrl", math.degrees, None, text), 0.0)
    ),
    "keyframe ctrl absent": mjcf_absent("ctrl"),
    "keyframe ctrl zero": mjcf_all("ctrl", zero),
    "keyframe ctrl, one sign": mjcf_listed("ctrl", negated),
    "keyframe qpos, one sign": mjcf_listed("qpos", negated),
    "keyframe 0.1 m above the floor": mjcf_edit(lambda text, _: raise_base(text, 0.1)),
    "keyframe 0.03 m in the floor": mjcf_edit(lambda text, _: raise_base(text, -0.03)),
    "feet on the floor": mjcf_edit(lambda text, _: raise_base(text, 0.0)),
    "effort, all 0": urdf_all("effort", zero),
    "effort, one 0": urdf_one("effort", zero),
    "effort, one negative": urdf_one("effort", negated),
    "effort, all absent": urdf_edit(lambda text, _: re.sub(r' effort="[^"]*"', "", text)),
    "effort, all 1": urdf_all("effort", lambda _: 1.0),
    "velocity, all 0": urdf_all("velocity", zero),
    "URDF range, one 0 to 0": urdf_edit(
        lambda text, _: re.sub(r'lower="[^"]*" upper="[^"]*"', 'lower="0" upper="0"', text, count=1)
    ),
    "URDF axis, one sign": urdf_one("axis xyz", negated),
    "URDF mass, one times 10": urdf_one("mass value", scaled(10)),
    "kp, one 0": mjcf_one("kp", zero),
    "kp, all 0": mjcf_all("kp", zero),
    "kp, one negative": mjcf_one("kp", negated),
    "kp, all a tenth": mjcf_all("kp", scaled(0.1)),
    "kp, all a hundredth": mjcf_all("kp", scaled(0.01)),
    "kp, all times 10": mjcf_all("kp", scaled(10)),
    "kv, all 0": mjcf_all("kv", zero),
    "kv, one negative": mjcf_one("kv", negated),
    "kv, all times 10": mjcf_all("kv", scaled(10)),
    "forcerange, all 0 0": mjcf_all("forcerange", zero),
    "forcerange, one 0 0": mjcf_one("forcerange", zero),
    "forcerange, all a tenth": mjcf_all("forcerange", scaled(0.1)),
    "forcerange, all a hundredth": mjcf_all("forcerange", scaled(0.01)),
    "forcerange absent": mjcf_absent("forcerange"),
    "actuatorfrcrange, all 0 0": mjcf_all("actuatorfrcrange", zero),
    "actuatorfrcrange, one a hundredth": mjcf_one("actuatorfrcrange", scaled(0.01)),
    "ctrlrange, one 0 0": mjcf_text("<position ", '<position ctrlrange="0 0" ', 1),
    "ctrlrange, all -1 1": mjcf_text("<position ", '<position ctrlrange="-1 1" '),
    "gear, one sign": mjcf_one("gear", negated),
    "gear, one times 10": mjcf_one("gear", scaled(10)),
    "floor without friction": mjcf_text(GROUND, f'{GROUND} priority="1" friction="0 0 0"'),
    "floor with friction 0.1": mjcf_text(
        GROUND, f'{GROUND} priority="1" friction="0.1 0.005 1e-4"'
    ),
    "condim 1": mjcf_text(GROUND, f'{GROUND} priority="1" condim="1"'),
    "condim 6": mjcf_text(GROUND, f'{GROUND} priority="1" condim="6"'),
    "one foot without friction": mjcf_text(
        r'<geom (size|type="(?:sphere|capsule|ellipsoid))',
        r'<geom priority="1" friction="0 0 0" \1',
        1,
    ),
    "floor solref 0.2": mjcf_text(GROUND, f'{GROUND} priority="1" solref="0.2 1"'),
    "floor solref 0.1": mjcf_text(GROUND, f'{GROUND} priority="1" solref="0.1 1"'),
    "floor solref damping 0": mjcf_text(GROUND, f'{GROUND} priority="1" solref="-5000 0"'),
    "floor solref, damping ratio 0.1": mjcf_text(
        GROUND, f'{GROUND} priority="1" solref="0.02 0.1"'
    ),
    "contact margin 5 mm": mjcf_text(GROUND, f'{GROUND} margin="0.005"'),
    "mass, one 0": mjcf_one("mass", zero),
    "mass, one times 10": mjcf_one("mass", scaled(10)),
    "axis, one sign": mjcf_one("axis", negated),
    "range, one 0 0": mjcf_one("range", zero),
    "range, one in degrees": mjcf_one("range", math.degrees),
    "armature absent": mjcf_absent("armature"),
    "armature a hundredth": mjcf_all("armature", scaled(0.01)),
    "damping absent": mjcf_absent("damping"),
    "damping, all negative": mjcf_all("damping", negated),
    "damping times 100": mjcf_all("damping", scaled(100)),
    "frictionloss 1": mjcf_text(' damping="0.2"', ' damping="0.2" frictionloss="1"'),
    "frictionloss 0.02, armature absent": mjcf_text(
        ' armature="[^"]*" damping="0.2"', ' damping="0.02" frictionloss="0.02"'
    ),
    "timestep 10 ms": mjcf_text("<option ", '<option timestep="0.01" '),
    "Euler, 5 ms": mjcf_text(
        '<option integrator="implicitfast"', '<option timestep="0.005" integrator="Euler"'
    ),
    "contacts disabled": mjcf_text(
        "<option ", '<option><flag contact="disable"/></option><option '
    ),
    "elliptic cone": mjcf_text("<option ", '<option cone="elliptic" '),
    "elliptic cone, impratio 100": mjcf_text("<option ", '<option cone="elliptic" impratio="100" '),
}
"""{description of a mistake: function that makes it}."""


def write_robot(seed: int, folder: Path, edit: str | None = None) -> tuple[Path, Path] | None:
    """Write URDF and MJCF of a random robot; None if the edit changes nothing."""
    robot = random_legged.draw_robot(seed)
    robot = replace(robot, base="free", keyframe=True, floor=True)
    if edit or seed % 3:
        robot = replace(robot, motors="position")
    folder.mkdir(exist_ok=True, parents=True)
    pair = random_legged.write_robot(robot, folder)
    urdf, mjcf = pair.urdf.read_text(), pair.mjcf.read_text()
    if robot.motors == "position":
        commands = [
            robot.gear * link.home for link in robot.links if link.where != "urdf" and link.effort
        ]
        ctrl = " ".join(f"{value:.9g}" for value in commands)
        mjcf = mjcf.replace('"/></keyframe>', f'" ctrl="{ctrl}"/></keyframe>')
    if edit is not None:
        changed = EDITS[edit](urdf, mjcf, np.random.default_rng([seed, *edit.encode()]))
        if changed == (urdf, mjcf):
            return None
        urdf, mjcf = changed
    pair.urdf.write_text(urdf)
    pair.mjcf.write_text(mjcf)
    return pair.urdf, pair.mjcf


# ------------------------------------------------------------------------------- bare MuJoCo


def tilt_between(first: Array, second: Array) -> float:
    """Return the relative tilt [deg] of two quaternions; yaw has no effect."""
    rotations = np.zeros((2, 9))
    mujoco.mju_quat2Mat(rotations[0], first)
    mujoco.mju_quat2Mat(rotations[1], second)
    return math.degrees(math.acos(np.clip(rotations[0, 6:] @ rotations[1, 6:], -1, 1)))


def simulate(model: mujoco.MjModel, qpos: Array, ctrl: Array, nudge_time: float) -> dict[str, Any]:
    """Simulate without a nudge and with six nudges; return the worst outcome.

    Args:
        model: MuJoCo model; joint 0 is the free joint of the robot.
        qpos: Initial configuration.
        ctrl: Commands.
        nudge_time: Simulated time of the nudge [s].
    """
    runs = []
    for nudge in range(7):
        runs.append(simulate_once(model, qpos, ctrl, nudge_time, nudge))
        if runs[-1]["outcome"] == "falls":
            break
    order = {"stands": 0, "between": 1, "falls": 2}
    return max(runs, key=lambda run: (order[run["outcome"]], run["drop"] + run["speed"]))


def simulate_once(
    model: mujoco.MjModel, qpos: Array, ctrl: Array, nudge_time: float, nudge: int
) -> dict[str, Any]:
    """Simulate with one nudge (0: none; 1 to 6: along +x, -x, +y, -y, +z, -z)."""
    timestep, base = float(model.opt.timestep), int(model.jnt_bodyid[0])
    data = mujoco.MjData(model)
    data.qpos[:], data.ctrl[:] = qpos, ctrl
    mujoco.mj_forward(model, data)
    start, orientation = data.subtree_com[base].copy(), data.qpos[3:7].copy()
    steps, kick, late = (round(t / timestep) for t in (DURATION, nudge_time, DURATION - 2))
    stride, calm, speed, fallen = max(1, round(0.1 / timestep)), 0, 0.0, False
    for step in range(steps):
        if nudge and step == kick:
            data.qvel[(nudge - 1) // 2] += NUDGE_SPEED if nudge % 2 else -NUDGE_SPEED
        mujoco.mj_step(model, data)
        if step % stride:
            continue
        height, tilt = data.subtree_com[base][2], tilt_between(orientation, data.qpos[3:7])
        resets = any(data.warning[kind].number for kind in RESET_WARNINGS)
        fallen = not height > 0.6 * start[2] or tilt > 40 or resets
        if fallen:
            break
        current = float(np.abs(data.qvel).max())
        speed = max(speed, current) if step > late else speed
        calm = calm + 1 if current < 1e-5 and (step > kick or not nudge) else 0
        if calm >= 20:
            speed = current
            break
    end = data.subtree_com[base]
    drop, tilt = float(1 - end[2] / start[2]), tilt_between(orientation, data.qpos[3:7])
    moved = float(np.hypot(*(end - start)[:2]) / start[2])
    stands = abs(drop) < 0.1 and tilt < 10 and speed < 0.02 and moved < 0.3
    return {
        "outcome": "falls" if fallen else "stands" if stands else "between",
        "drop": drop,
        "tilt": tilt,
        "speed": speed,
        "moved": moved,
        "time": float(data.time),
        "nudge": nudge,
    }


def simulate_from_keyframe(mjcf: Path) -> dict[str, Any]:
    """Simulate the unmodified MJCF from the keyframe; the nudge follows after 8 s."""
    try:
        model = mujoco.MjModel.from_xml_path(str(mjcf))
    except ValueError as error:
        return {"outcome": "refused", "why": str(error)[:100]}
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    return simulate(model, data.qpos.copy(), data.ctrl.copy(), KEYFRAME_NUDGE_TIME)


def simulate_stand(
    robot: Robot,
    stand: Stand,
    verdict: Verdict,
    mjcf: Path,
    *,
    payload: tuple[float, list[float]] | None = None,
    kp: float | None = None,
    slope: tuple[str, float] | None = None,
) -> dict[str, Any]:
    """Simulate a judged stand with the MJCF, the additions of the case and the same commands.

    Args:
        robot: Robot of the verdict.
        stand: Stand of the verdict.
        verdict: Verdict, whose added servos are added here, too.
        mjcf: File.
        payload: Mass [kg] and position (3,) [m] in the frame of the base.
        kp: Stiffness of all servos [N m/rad], with kd = kp / 20.
        slope: Foot, and inclination of the ground below the foot [rad].
    """
    held = solve_stand_as_simulated(robot, stand)
    torques = dict(zip(robot.joint_names, stand_statics(robot, held).joint_torques, strict=True))
    spec, own = mujoco.MjSpec.from_file(str(mjcf)), robot.mj_model
    if payload is not None:
        mass, place = payload
        load = spec.body(own.body(robot.mj_base).name).add_body(name="load", pos=place)
        sphere = mujoco.mjtGeom.mjGEOM_SPHERE
        load.add_geom(type=sphere, size=[1e-3, 0, 0], mass=mass, contype=0, conaffinity=0)
    added = {servo.joint for servo in verdict.servos.made}
    if kp is not None:
        added = set(robot.joint_names)
    if added:
        add_servos(spec, robot, added, kp)
    if slope is not None:
        add_slope(spec, robot, held, *slope)
    model = spec.compile()
    data, placed = mujoco.MjData(model), robot.compute_kinematics(held.qpos)
    for joint in range(model.njnt):
        width = 7 if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE else 1
        match = (
            joint
            if width == 7
            else mujoco.mj_name2id(own, mujoco.mjtObj.mjOBJ_JOINT, model.joint(joint).name)
        )
        if match >= 0:
            ours, theirs = model.jnt_qposadr[joint], own.jnt_qposadr[match]
            data.qpos[ours : ours + width] = placed.qpos[theirs : theirs + width]
    for actuator in range(model.nu):
        joint = int(model.actuator_trnid[actuator, 0])
        torque = float(torques.get(model.joint(joint).name, 0.0))
        gear, gain = model.actuator_gear[actuator, 0], model.actuator_gainprm[actuator, 0]
        lead = torque / (gear * gain) if gear * gain else 0.0
        is_servo = model.actuator_biastype[actuator] == mujoco.mjtBias.mjBIAS_AFFINE
        position = gear * data.qpos[model.jnt_qposadr[joint]] if is_servo else 0.0
        data.ctrl[actuator] = position + lead
    return simulate(model, data.qpos.copy(), data.ctrl.copy(), STAND_NUDGE_TIME)


def add_servos(spec: mujoco.MjSpec, robot: Robot, joints: set[str], kp: float | None) -> None:
    """Replace the actuators of joints by position servos with the gains of the verdict."""
    servos = model_with_servos(robot, kp, None if kp is None else kp / 20)
    for actuator in list(spec.actuators):
        if actuator.target in joints:
            spec.delete(actuator)
    for place, joint in enumerate(robot.joint_names):
        if joint not in joints:
            continue
        servo = spec.add_actuator(
            name=f"servo_{joint}", target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT
        )
        servo.set_to_position(kp=float(servos.kp[place]))
        servo.ctrllimited = mujoco.mjtLimited.mjLIMITED_FALSE
        servo.biasprm[2] = -float(servos.kd[place])
        limit = next((one.upper for one in robot.efforts if one.joint == joint), None)
        if limit and math.isfinite(limit):
            servo.forcelimited, servo.forcerange = True, [-limit, limit]
    spec.option.integrator = int(servos.model.opt.integrator)
    spec.option.timestep = servos.model.opt.timestep


def add_slope(spec: mujoco.MjSpec, robot: Robot, held: Stand, foot: str, angle: float) -> None:
    """Add a box below a foot, inclined about the y axis by an angle [rad]."""
    point = robot.feet[foot][0]
    body, local = robot.contact_places[point][:2]
    data = robot.compute_kinematics(held.qpos)
    mujoco.mj_kinematics(robot.mj_model, data)
    centre = data.xpos[body] + data.xmat[body].reshape(3, 3) @ np.asarray(local)
    normal = np.array([-math.sin(angle), 0, math.cos(angle)])
    top = centre - (robot.contact_radius[point] - held.depths[point]) * normal
    turn = [math.cos(angle / 2), 0, -math.sin(angle / 2), 0]
    slope, floor = (
        spec.worldbody.add_body(name="slope", pos=top - 0.05 * normal, quat=turn),
        spec.geom("ground"),
    )
    names = ("friction", "solref", "solimp", "condim", "priority")
    slope.add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=[0.06, 0.06, 0.05],
        **{name: getattr(floor, name) for name in names},
    )
    spec.add_exclude(bodyname1="world", bodyname2=robot.mj_model.body(body).name)


# ------------------------------------------------------------------------------- cases


def draw_options(robot: Robot, random: Random, strongest: float) -> dict[str, dict[str, Any]]:
    """Draw the options of a robot: {name: robot, task, gains, additions of bare MuJoCo}."""
    mass, height = robot.total_mass, robot.base_height
    single = [foot for foot in robot.feet if len(robot.feet[foot]) == 1]
    place = (height * random.uniform(-0.15, 0.15, 3)).tolist()
    load = float(mass * random.choice([0.1, 0.3, 0.6, 1.0, 2.0, 4.0]))
    kp = 30 * strongest * float(random.choice([0.02, 0.05, 0.1, 0.3, 2.0]))
    options = {
        f"payload {load:.3g} kg": {"robot": (load, place), "bare": {"payload": (load, place)}},
        f"gains {kp:.3g}": {"gains": {"kp": kp, "kd": kp / 20}, "bare": {"kp": kp}},
    }
    factor = float(random.choice([0.7, 0.85, 0.95, 1.05, 1.1]))
    options[f"height {factor:g}"] = {"task": StandTask(height=factor * height)}
    pitch = float(random.choice([-0.2, -0.05, 0.05, 0.2]))
    options[f"pitch {pitch:g}"] = {"task": StandTask(pitch=pitch)}
    if single:
        foot, angle = str(random.choice(single)), float(random.choice([3, 8, 15, 25]))
        radians = math.radians(angle)
        options[f"slope {angle:g} deg"] = {
            "task": StandTask(contacts={foot: Contact(Slope(radians))}),
            "bare": {"slope": (foot, radians)},
        }
    if len(robot.feet) > 3:
        swing = {str(random.choice(list(robot.feet))): 0.02}
        options["swing foot"] = {"task": StandTask(swing=swing, com="inside", com_margin=0.01)}
    chosen = random.permutation(list(options))[:NUM_OPTIONS].tolist()
    return {name: options[name] for name in chosen}


def judge(row: dict[str, Any], robot: Robot, mjcf: Path, option: dict[str, Any]) -> None:
    """Add the verdict of a case and the outcome in bare MuJoCo to a row."""
    loaded = with_payload(robot, *option["robot"]) if "robot" in option else robot
    stand = pa.solve_stand(loaded, option.get("task"))
    began = time.process_time()
    verdict = pa.judge_stand(loaded, stand, **option.get("gains", {}))
    row["processor time"] = round(time.process_time() - began, 2)
    row |= {
        "passed": verdict.passed,
        "code": verdict.code.name,
        "failures": [failure.code for failure in verdict.failures],
        "message": format_verdict(verdict)[:1200],
    }
    row["stand"] = simulate_stand(loaded, stand, verdict, mjcf, **option.get("bare", {}))


def run_case(results: Path, row: dict[str, Any], work: Callable[[dict[str, Any]], None]) -> None:
    """Run a case, and append the row to the results; errors are part of the row."""
    try:
        work(row)
    except pa.PupperAnalysisError as error:
        row["refused"] = f"{type(error).__name__}: {error}"[:400]
    except Exception:
        row["crashed"] = traceback.format_exc()[-900:]
    with results.open("a", encoding="utf-8") as file:
        file.write(json.dumps(row, default=str) + "\n")


def judge_robot(seed: int, results: Path, folder: Path, done: set[tuple[int, str]]) -> None:
    """Judge the ten cases of a random robot that are not done."""
    random, home = np.random.default_rng([seed, 2]), folder / f"{seed}"
    files = write_robot(seed, home)
    assert files is not None
    keyframe: dict[str, Any] = {}
    try:
        robot = pa.load_robot(*files)
        strongest = max(link.effort for link in random_legged.draw_robot(seed).links)
        cases: dict[str, dict[str, Any]] = {"sound": {}}
        cases |= draw_options(robot, random, strongest)
    except pa.PupperAnalysisError as error:
        run_case(
            results, {"seed": seed, "case": "sound", "refused": str(error)[:400]}, lambda _: None
        )
        return
    for case, option in cases.items():
        if (seed, case) in done:
            continue
        keyframe = keyframe or simulate_from_keyframe(files[1])
        run_case(
            results,
            {"seed": seed, "case": case, "keyframe": keyframe},
            lambda row: judge(row, robot, files[1], option),  # noqa: B023
        )
    chosen = 0
    for edit in random.permutation(list(EDITS)).tolist():
        edited = write_robot(seed, folder / f"{seed}-{list(EDITS).index(edit)}", edit)
        if edited is None:
            continue
        chosen += 1
        if (seed, edit) not in done:
            run_case(
                results,
                {"seed": seed, "case": edit, "keyframe": simulate_from_keyframe(edited[1])},
                lambda row: judge(row, pa.load_robot(*edited), edited[1], {}),  # noqa: B023
            )
        if chosen == NUM_EDITS:
            break


# ------------------------------------------------------------------------------- results


AGREEING = (
    "HOLDS, stands",
    "does not pass, nor stands",
    "FAILS as stated, stands",
    "refused",
)
"""Columns of verdicts that agree with bare MuJoCo; all other rows are printed."""

WRONG = ("false HOLDS", "false HOLDS of the file's keyframe", "HOLDS, between", "false FAILS")
"""Columns of verdicts that are wrong, or may be."""


def classify(row: dict[str, Any]) -> str:
    """Return the column of a row in the table."""
    if "crashed" in row:
        return "crashed"
    if "refused" in row:
        return "refused"
    outcome = row["stand"]["outcome"]
    has_servos = kind_of(row["case"]) == "edited files" or row["seed"] % 3
    if row["passed"] and has_servos and row["keyframe"]["outcome"] == "falls":
        return "false HOLDS of the file's keyframe"
    if row["passed"]:
        return {"stands": "HOLDS, stands", "falls": "false HOLDS"}.get(outcome, "HOLDS, between")
    if outcome != "stands" or row["keyframe"]["outcome"] != "stands":
        return "does not pass, nor stands"
    if row["code"] != "FAILS":
        return f"{row['code']}, stands"
    is_stated = row["failures"][0] in STATED_FAILURES or row["case"] in URDF_LIMITS
    return "FAILS as stated, stands" if is_stated else "false FAILS"


def kind_of(case: str) -> str:
    """Return the row of the table for a case."""
    word = case.split()[0]
    options = ("sound", "payload", "gains", "slope", "height", "swing", "pitch")
    return word if word in options else "edited files"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("results", type=Path, help="file of the results, one JSON object per line")
    parser.add_argument("--robots", type=int, default=30, help="number of robots")
    parser.add_argument("--seed", type=int, default=700000, help="seed of the first robot")
    parser.add_argument("--csv", type=Path, help="table to be written")
    given = parser.parse_args()
    rows = (
        [json.loads(line) for line in given.results.read_text().splitlines()]
        if given.results.exists()
        else []
    )
    done = {(row["seed"], row["case"]) for row in rows}
    for seed in range(given.seed, given.seed + given.robots):
        judge_robot(seed, given.results, given.results.with_suffix(".files"), done)
    rows = [json.loads(line) for line in given.results.read_text().splitlines()]
    counts: dict[str, dict[str, int]] = defaultdict(lambda: defaultdict(int))
    for row in rows:
        column = classify(row)
        counts[kind_of(row["case"])][column] += 1
        counts["all"][column] += 1
        if column not in AGREEING:
            print(
                f"{column}: {row['seed']} {row['case']}: {row.get('message', row.get('crashed'))}"
            )
            print(f"    stand {row.get('stand')}\n    keyframe {row.get('keyframe')}")
    columns = [*AGREEING, *WRONG, *sorted(set(counts["all"]).difference(AGREEING, WRONG))]
    table = [
        (kind, sum(by_column.values()), *(by_column[column] for column in columns))
        for kind, by_column in sorted(counts.items(), key=lambda item: item[0] == "all")
    ]
    for line in (("case", "verdicts", *columns), *table):
        print(*line, sep=" | ")
    if given.csv:
        write_csv(given.csv, ("case", "verdicts", *columns), table)


if __name__ == "__main__":
    main()
