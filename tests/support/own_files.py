"""Files of the reader that documentation pages name: robots, measurements, policies, a repository.

``write`` creates the files that a block of a page names, so that the block can run. Robots are
Pupper v3 with the joint and frame names that the block uses, or the arm, leg and hopper of other
tests. Measurements are simulated with MuJoCo, with a v3 that is heavier than its files state.
"""

from __future__ import annotations

import csv
import json
import re
import shutil
import subprocess
import tempfile
from functools import cache
from pathlib import Path

import mujoco
import numpy as np

from tests.support import arm
from tests.support.commands import answer
from tests.support.repository import ROOT

LEGS = {"front_r": "FR", "front_l": "FL", "back_r": "RR", "back_l": "RL"}
OTHER_NAMES = {
    "*calf*": (r"leg_(\w+_[rl])_3\b", lambda leg: f"{LEGS[leg[1]]}_calf"),
    "FL_foot": (r"leg_(\w+_[rl])_3_foot_site", lambda leg: f"{LEGS[leg[1]]}_foot"),
    "--keyframe stand": ('key name="home"', 'key name="stand"'),
}
"""{words in a line of a page: (pattern, replacement) that rename elements in the robot's files}."""
MAPPED = "leg_front_l_1"
"""Joint that gets the two names of a line's ``--map``, one in each file of the pair."""
WEIGHT = 3.55
"""Mass of the measured robot [kg]: 0.38 kg more than its files state, all of it in the torso."""


def write(folder: Path, text: str) -> None:
    """Write the files that a block of a page names into a folder, except those that it creates
    itself.
    """
    _write_stances(folder, text)
    made: set[str] = set()  # by a command, before it is read
    for before, path, suffix, xacro in re.findall(
        r"(\S*)[\"'\s=(](?:[\w./]+:)?(?:\./)?((?:\w+/)*[\w.-]+)\.(urdf|xml|usda?)\b(\.xacro)?", text
    ):
        file = folder / f"{path}.{suffix}{xacro}"
        if before in ("-o", ">"):
            made.add(file.name)
        if not (file.exists() or file.name in made or path.startswith("build/")):
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(_make_robot_text(file, text), encoding="utf-8")
    if "env_cfgs.py" in text:
        _write_sources(folder)
    for name in re.findall(r"\bpolicy\w*\.json|\w+\.onnx", text):
        _write_policy(folder / name)
    if "hanging.csv" in text and not (folder / "hanging.csv").exists():
        _write_log(folder / "hanging.csv")
    if "stands.csv" in text and not (folder / "stands.csv").exists():
        _write_measured_stands(folder)
    if "--stands plan.csv" in text:
        measure_stands(folder / "plan.csv")
    if fit := re.search(r"--fit ((\w+/)?fit\.json)", text):
        _write_measured_stands(folder)
        for name, content in _fitted_files().items():
            (folder / "fitted" / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / "fitted" / name).write_bytes(content)
        if not (folder / fit[1]).exists():
            shutil.copy(folder / "fitted/fit.json", folder / fit[1])
    if re.search(r"HEAD:|v1\.\d:|origin/|analysis check", text):
        _commit_revisions(folder, text)


def _write_stances(folder: Path, text: str) -> None:
    """Write the stance files and the files of names that a block names."""
    (folder / "crouch.toml").write_text("height = '12cm'\n")
    if "legs.toml" in text:
        shutil.copy(ROOT / "examples/legs.toml", folder)
    if "robot_description" in text:
        (folder / "robot_description").mkdir(exist_ok=True)
    if "names.toml" in text:
        (folder / "names.toml").write_text('lf_haa = "FL_hip"\n')


# ------------------------------------------------------------------------------------- robots


def _make_robot_text(file: Path, text: str) -> str:
    """Return the text of a robot's file; its stem selects the robot."""
    stem, urdf = file.stem, file.suffix in (".urdf", ".xacro")
    if file.suffix.startswith(".usd"):
        return _make_leg_text(file.suffix)
    if stem == "leg":
        return _make_leg_text(file.suffix)
    if stem == "hopper":
        return (ROOT / f"examples/guarded/hopper{file.suffix}").read_text()
    if stem in ("panda", "arm"):
        return arm.URDF if urdf else arm.MJCF
    if stem == "ur5":
        robot = (arm.URDF if urdf else arm.MJCF).replace('"shoulder"', '"shoulder_lift_joint"')
        robot = re.sub(r'effort="(\d+)', r'effort="\g<1>0', robot).replace('"tip"', '"tool0"')
        inertia = '<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/>'
        inertial = f'<inertial><mass value="4"/>{inertia}</inertial>'
        return robot.replace('<link name="base"/>', f'<link name="base">{inertial}</link>')
    if stem == "hand":
        pose = '<keyframe><key name="open" qpos="0 -0.5 0.5 0.1"/></keyframe></mujoco>'
        return arm.MJCF.replace("</mujoco>", pose).replace('"tip"', '"thumb_tip"')
    return _make_quadruped_text(file, text)


def _make_leg_text(suffix: str) -> str:
    """Return a leg as URDF or USD, or the MJCF that MuJoCo makes of the URDF."""
    from tests.tools.usd import written

    if suffix == ".xml":
        spec = mujoco.MjSpec.from_string(written.URDF)
        spec.compiler.fusestatic = False
        spec.compile()
        return spec.to_xml()
    return written.URDF if suffix == ".urdf" else written.USD


def _make_quadruped_text(file: Path, text: str) -> str:
    """Return Pupper v3 as URDF or MJCF, with the names and changes that a block of a page needs."""
    urdf = file.suffix in (".urdf", ".xacro")
    lines = text.replace("\\\n", " ").splitlines()
    text = "\n".join(line for line in lines if file.name in line)
    if urdf:
        robot = (ROOT / "urdf/pupper_v3.urdf").read_text()
        robot = robot.replace("../mjcf/meshes", str(ROOT / "mjcf/meshes"))
        if file.suffix == ".xacro":
            start = '<robot xmlns:xacro="http://ros.org/wiki/xacro"\\1>'
            argument = '<xacro:arg name="camera" default="false"/>'
            robot = re.sub(r"<robot(.*?)>", start + argument, robot, count=1)
    else:
        robot = _one_mjcf()
    for words, (old, new) in OTHER_NAMES.items():
        if words in text:
            robot = re.sub(old, new, robot)
    for one, other in re.findall(r"--map (\w+)=(\w+)", text):
        first = file.stem == "old" or (urdf and file.stem != "longer")
        robot = re.sub(rf'"{MAPPED}"', f'"{one if first else other}"', robot)
    if "env_cfgs.py" in text or "config.yaml" in text:
        robot = robot.replace("0 -5 -0.1", "0 -5 -0.25")
    if "sync" in text and not urdf:  # 10 numbers differ
        robot = robot.replace('mass="1.506"', 'mass="1.406"').replace("-3 3", "-2.9 2.9")
        robot = robot.replace('mass="0.186"', 'mass="0.196"').replace('mass="0.05"', 'mass="0.06"')
    if file.stem == "longer":
        robot = robot.replace("0.06231 ", "0.06531 ")
    if file.stem == "g1" and "right_palm" in text:
        robot = robot.replace('<site name="body_imu_site"', f'{PALM}\n<site name="body_imu_site"')
        robot = re.sub(
            r"</actuator>", '<position joint="right_elbow_joint" kp="9"/></actuator>', robot
        )
        robot = re.sub(r"<keyframe>.*</keyframe>", "", robot, flags=re.S)
    return robot


PALM = """<body name="right_forearm" pos="0 0 0.1"><joint name="right_elbow_joint" range="-2 2"/>
<inertial pos="0.05 0 0" mass="0.05" diaginertia="1e-5 5e-5 5e-5"/><body name="right_palm"
pos="0.1 0 0"><inertial pos="0 0 0" mass="0.02" diaginertia="1e-5 1e-5 1e-5"/></body></body>"""
"""Forearm and palm of the robot ``g1`` in lines that name ``right_palm``."""


def _one_mjcf(name: str = "pupper_v3") -> str:
    """Return an MJCF of Pupper as one text without includes, with an absolute ``meshdir``."""

    def included(found: re.Match[str]) -> str:
        text = (ROOT / "mjcf" / found[1]).read_text()
        return re.sub(r"</?mujocoinclude>", "", text)

    text = (ROOT / f"mjcf/{name}.xml").read_text()
    while "<include" in text:
        text = re.sub(r'<include file="(.+?)"/>', included, text)
    return text.replace('meshdir="meshes"', f'meshdir="{ROOT / "mjcf/meshes"}"')


# ------------------------------------------------------------------------------ measurements


FIT = ("fit", "v3", "--stands", "stands.csv", "--weight", f"{WEIGHT}kg")
"""Arguments of ``pupper-analysis fit`` on the measured stands."""


def _write_measured_stands(folder: Path) -> None:
    """Write `stands.csv`: a plan of 12 stands with measured positions."""
    (folder / "stands.csv").write_text(_measured_plan())


@cache
def _measured_plan() -> str:
    """Return a plan of 12 stands with measured positions, as CSV."""
    with tempfile.TemporaryDirectory() as folder:
        plan = Path(folder) / "stands.csv"
        answer("fit", "v3", "--plan", "12", "-o", plan.name, folder=plan.parent)
        measure_stands(plan)
        return plan.read_text()


@cache
def _fitted_files() -> dict[str, bytes]:
    """Return {path: content} of the files that ``fit`` writes for the measured stands."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        _write_measured_stands(folder)
        found = answer(*FIT, "-o", "fitted/", folder=folder)
        assert found.returncode == 0, found.stderr
        fitted = folder / "fitted"
        files = [path for path in fitted.rglob("*") if path.is_file()]
        return {str(path.relative_to(fitted)): path.read_bytes() for path in files}


def _make_measured_robot(name: str) -> tuple[mujoco.MjModel, mujoco.MjData, list[str]]:
    """Return the model of the measured robot, its data, and the joints in the order of the
    actuators.
    """
    model = mujoco.MjModel.from_xml_string(_one_mjcf(name))
    base = model.body("leg_front_r_1").parentid[0]
    if name == "pupper_v3":
        model.body_mass[base] += WEIGHT - model.body_subtreemass[0]
    mujoco.mj_setConst(model, mujoco.MjData(model))
    names = [model.joint(model.actuator(k).trnid[0]).name for k in range(model.nu)]
    return model, mujoco.MjData(model), names


def measure_stands(plan: Path) -> None:
    """Write measured joint positions into the CSV file of a plan.

    Each stand is simulated for 12 s from contact with the floor. The column ``swing`` is set to the
    feet without contact.
    """
    with plan.open(newline="") as file:
        rows = list(csv.DictReader(file))
    model, data, names = _make_measured_robot("pupper_v3")
    sphere = model.geom_type == mujoco.mjtGeom.mjGEOM_SPHERE
    feet = np.flatnonzero(sphere & (model.geom_contype + model.geom_conaffinity > 0))
    base = model.body("leg_front_r_1").parentid[0]
    bare, own = model.body_mass[base], model.body_ipos[base].copy()
    for row in rows:
        on, *place = (
            float(row.get(f"added{axis}.base_link") or 0) for axis in ("", "_x", "_y", "_z")
        )
        model.body_mass[base] = bare + on
        model.body_ipos[base] = (bare * own + on * np.array(place)) / (bare + on)
        mujoco.mj_setConst(model, mujoco.MjData(model))
        mujoco.mj_resetData(model, data)
        data.ctrl[:] = [float(row[f"command.{name}"]) for name in names]
        for name, angle in zip(names, data.ctrl, strict=True):
            data.joint(name).qpos = angle
        mujoco.mj_kinematics(model, data)
        level(data, [k for k in feet if _name_foot(data.geom_xpos[k]) not in row["swing"].split()])
        mujoco.mj_kinematics(model, data)
        data.qpos[2] -= min(data.geom_xpos[k][2] - model.geom_size[k][0] for k in feet)
        while data.time < 12:
            mujoco.mj_step(model, data)
        for name in names:
            row[f"position.{name}"] = f"{data.joint(name).qpos[0]:.9f}"
        carry = {k for pair in data.contact.geom for k in pair}
        row["swing"] = " ".join(_name_foot(data.geom_xpos[k]) for k in feet if k not in carry)
    with plan.open("w", newline="") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(rows)


def level(data: mujoco.MjData, feet: list[int]) -> None:
    """Rotate the base so that the given foot geoms are at one height and land together."""
    places = data.geom_xpos[feet]
    normal = np.linalg.svd(places - places.mean(0))[2][-1]
    normal *= np.sign(normal[2])
    about = np.cross(normal, (0, 0, 1))
    angle = np.arctan2(np.linalg.norm(about), normal[2])
    mujoco.mju_axisAngle2Quat(data.qpos[3:7], about / max(np.linalg.norm(about), 1e-12), angle)


def _name_foot(place: np.ndarray) -> str:
    """Return the leg of a foot by its position in the world: FR, FL, RR or RL."""
    return ("F" if place[0] > 0 else "R") + ("L" if place[1] > 0 else "R")


def _write_log(path: Path, seconds: float = 4.0) -> None:
    """Write a log of the robot on a fixed base; each joint follows a sine about its home angle."""
    model, data, names = _make_measured_robot("pupper_v3_fixed")
    mujoco.mj_resetDataKeyframe(model, data, 0)
    home, tones = data.ctrl.copy(), 1.0 + 0.37 * np.arange(model.nu)
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        kinds = ("position", "command")
        writer.writerow(["time", *(f"{kind}.{name}" for kind in kinds for name in names)])
        for k in range(round(seconds / model.opt.timestep)):
            data.ctrl[:] = home + 0.2 * np.sin(2 * np.pi * tones * data.time)
            if k % 5 == 0:
                angles = [data.joint(name).qpos[0] for name in names]
                writer.writerow([f"{data.time:.6f}", *angles, *data.ctrl])
            mujoco.mj_step(model, data)


# --------------------------------------------------------------------- policies, repositories


def _write_policy(path: Path) -> None:
    """Write a policy for trotting as JSON, or as ONNX with its TOML file."""
    from tests.tools.walk import made

    if path.exists():
        return
    network = made.trot(path.with_suffix(".json"))
    if path.suffix == ".onnx":
        layers = json.loads(network.read_text())["layers"]
        path.write_bytes(made.dense_onnx([layer["weights"] for layer in layers], "Relu"))
        with path.with_suffix(".toml").open("a") as contract:
            for key in ("action_scale", "kp", "kd"):
                contract.write(
                    f"{key.replace('_', '-')} = {json.loads(network.read_text())[key]}\n"
                )
            contract.write(f"default = {json.loads(network.read_text())['default_joint_pos']}\n")
        network.unlink()


def _write_sources(folder: Path) -> None:
    """Write the training and deployment configurations of Pupper under the names of a page."""
    from tests.tools.contract import sources

    written = sources.write_all(folder)
    (folder / "motors.py").write_text(written["motors.py"].read_text())
    (folder / "env_cfgs.py").write_text(
        written["mjlab_cfg.py"].read_text().replace("from .", "from ")
    )
    isaac = written["isaac_cfg.py"].read_text()
    again = isaac.replace("PUPPER_CFG", "OTHER_CFG").replace("3.0", "2.0")
    (folder / "unitree.py").write_text(isaac.replace("PUPPER_CFG", "UNITREE_GO2_CFG") + again)


def _commit_revisions(folder: Path, text: str) -> None:
    """Make a Git repository of a folder, with the revisions that pages name; then change its
    hopper.
    """

    def git(*words: str) -> None:
        who = ("-c", "user.name=a", "-c", "user.email=a@example.org")
        subprocess.run(["git", *who, *words], cwd=folder, check=True, capture_output=True)

    if not (folder / ".git").exists():
        git("init", "-q", "-b", "main")
        git("add", "-A")
        git("commit", "-qm", "first")
        for tag in ("v1.0", "v1.2"):
            git("tag", tag)
        git("update-ref", "refs/remotes/origin/main", "HEAD")
    if "hopper" in text:
        new = (folder / "hopper.xml").read_text().replace('mass="0.4"', 'mass="0.5"')
        new = new.replace('<geom name="sole"', '<geom name="sole" contype="0" conaffinity="0"')
        (folder / "hopper.xml").write_text(new)


def write_models(folder: Path, text: str) -> None:
    """Write models with a configuration beside them, and one at the root unless ``--init`` is in
    the text.
    """
    pair = '[[pair]]\nname = "v3"\nurdf = "{}v3.urdf"\nmjcf = "{}v3.xml"\n'
    (folder / "robots").mkdir(exist_ok=True)
    for suffix in (".urdf", ".xml"):
        file = folder / f"robots/v3{suffix}"
        file.write_text(_make_quadruped_text(file, ""), encoding="utf-8")
    (folder / "robots/pupper-analysis.toml").write_text(pair.replace("{}", ""))
    if "--init" not in text and not (folder / "pupper-analysis.toml").exists():
        (folder / "pupper-analysis.toml").write_text(pair.replace("{}", "robots/"))
