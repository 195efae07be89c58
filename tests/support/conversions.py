"""A URDF of a robot that stands, its conversion, and a comparison of both."""

from __future__ import annotations

import math
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin

import pupper_analysis as pa
from pupper_analysis.models.mjcf import silence_mujoco
from tests.support.legged import quadruped as legged

LEGS = ("FL", "FR", "RL", "RR")


def write_standing_urdf(folder: Path) -> Path:
    """Write the URDF of a quadruped with spheres as feet and a box as trunk; return its path."""
    text = legged(folder).urdf.read_text()
    ball = format_shape("collision", '<sphere radius="0.02"/>', "0 0 -0.2")
    for name in LEGS:
        start = text.index(f'<link name="{name}_calf">')
        end = text.index("</link>", start)
        text = text[:end] + ball + text[end:]
    box = format_shape("collision", '<box size="0.4 0.2 0.08"/>', "0 0 0")
    path = folder / "quad.urdf"
    path.write_text(text.replace("</link>", f"{box}</link>", 1))
    return path


def format_shape(kind: str, geometry: str, xyz: str, rpy: str = "0 0 0") -> str:
    """Return a ``<visual>`` or ``<collision>`` of a URDF."""
    origin = f'<origin xyz="{xyz}" rpy="{rpy}"/>'
    return f"<{kind}>{origin}<geometry>{geometry}</geometry></{kind}>"


def compile_file(path: Path) -> mujoco.MjModel:
    """Return the model that MuJoCo compiles from a file."""
    with silence_mujoco():
        return mujoco.MjModel.from_xml_path(str(path))


def compare_dynamics(urdf: Path, mjcf: Path) -> float:
    """Return the largest relative difference of bias forces and mass matrices of two files.

    Each engine reads its own file, and joints are matched by name, with the base fixed: independent
    of the package.
    """
    reference, model = pin.buildModelFromUrdf(str(urdf)), compile_file(mjcf)
    free = model.jnt_type[0] == mujoco.mjtJoint.mjJNT_FREE.value
    ours = list(reference.names)[1:]
    dofs = [int(model.jnt_dofadr[model.joint(name).id]) for name in ours]
    random, worst = np.random.default_rng(0), 0.0
    data = mujoco.MjData(model)
    for _ in range(5):
        angles = dict(zip(ours, random.uniform(-0.5, 0.5, len(ours)), strict=True))
        q, v = pin.neutral(reference), random.uniform(-1, 1, reference.nv)
        for name, value in angles.items():
            joint = reference.joints[reference.getJointId(name)]
            wide = joint.nq == 2  # continuous: cosine and sine
            q[joint.idx_q : joint.idx_q + joint.nq] = (
                (math.cos(value), math.sin(value)) if wide else value
            )
            data.qpos[model.jnt_qposadr[model.joint(name).id]] = value
        if free:
            data.qpos[:7] = (0, 0, 0, 1, 0, 0, 0)
        data.qvel[:] = 0
        data.qvel[dofs] = v
        mujoco.mj_forward(model, data)
        mass = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, mass)
        work = reference.createData()
        bias = pin.rnea(reference, work, q, v, np.zeros(reference.nv))
        inertia = pin.crba(reference, work, q)
        inertia = np.triu(inertia) + np.triu(inertia, 1).T
        worst = max(
            worst,
            float(np.abs(data.qfrc_bias[dofs] - bias).max() / np.abs(bias).max()),
            float(np.abs(mass[np.ix_(dofs, dofs)] - inertia).max() / np.abs(inertia).max()),
        )
    return worst


def convert_file(source: Path, name: str, **options: object) -> tuple[Path, pa.convert.Conversion]:
    """Convert a file to a file in the same folder; return its path and the conversion."""
    output = source.parent / name
    return output, pa.convert_model(source, output, **options)  # type: ignore[arg-type]


def simulate_from_keyframe(model: mujoco.MjModel) -> tuple[mujoco.MjData, np.ndarray]:
    """Return MuJoCo's data 3 s after the keyframe ``home``, and qpos of the keyframe."""
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("home").id)
    start = data.qpos.copy()
    for _ in range(round(3 / model.opt.timestep)):
        mujoco.mj_step(model, data)
    return data, start
