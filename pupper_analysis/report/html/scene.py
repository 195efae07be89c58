"""What is drawn of a robot in three dimensions: its shapes, where they are, and what acts on it."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from functools import singledispatch
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.analysis.robot import joint_summaries
from pupper_analysis.report.document import Motion, StandScene, Text
from pupper_analysis.report.formats import visible
from pupper_analysis.report.words import text
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.stand import Stand
from pupper_analysis.statics.equilibrium import GravityCompensation
from pupper_analysis.statics.support_polygon import support_polygon

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

SHAPES = {
    int(mujoco.mjtGeom.mjGEOM_SPHERE): "sphere",
    int(mujoco.mjtGeom.mjGEOM_CAPSULE): "capsule",
    int(mujoco.mjtGeom.mjGEOM_ELLIPSOID): "ellipsoid",
    int(mujoco.mjtGeom.mjGEOM_CYLINDER): "cylinder",
    int(mujoco.mjtGeom.mjGEOM_BOX): "box",
    int(mujoco.mjtGeom.mjGEOM_MESH): "mesh",
}

SHOWN_GROUPS = 3
"""MuJoCo's viewer shows the geoms of groups 0 to 2, and keeps the others for collisions."""

MOST_FACES = 12_000
"""Of all meshes of a robot together: some 150 kB of the file, so that six robots fit in 3 MB."""

MOST_FRAMES = 80
"""Configurations of a motion: what a slider of its width can tell apart."""

_COARSEST = 512  # cells along a mesh's longest side at first, when it is made coarser


@singledispatch
def scene_of(scene: object) -> dict[str, Any] | None:
    """Returns a scene as plain lists and numbers: lengths in m, in the world unless said.

    Returns:
        The scene; None where what it is made of has gone.

    Raises:
        TypeError: If nobody has said how such a scene is drawn.
    """
    raise TypeError(f"no view of {type(scene).__name__}")


@scene_of.register
def _stand(scene: StandScene) -> dict[str, Any]:
    robot, stand, statics = scene.robot, scene.stand, scene.statics
    model = robot.mj_model
    data = mujoco.MjData(model)
    points = np.array(list(stand.contact_points.values()))
    robot.mj_convention.set_state(data, stand.qpos)
    mujoco.mj_kinematics(model, data)
    low, high = extent_of(model, data)
    still = Motion(text("the-stand"), np.zeros(1), stand.qpos[None])
    geoms, meshes = geoms_of(model)
    polygon = support_polygon(points) if len(points) > 2 else points[:, :2]
    return {
        "bodies": bodies_of(model),
        "geoms": geoms,
        "meshes": meshes,
        "motions": [_frames(robot, data, motion) for motion in (still, *scene.motions)],
        "joints": _joints(robot, stand, statics),
        "contacts": [
            {
                "name": visible(foot),
                "point": short_numbers(load.centre_of_pressure),
                "force": short_numbers(load.force),
            }
            for foot, load in (statics.foot_loads if statics else {}).items()
        ],
        "polygon": short_numbers(polygon),
        "ground": short_numbers(points.mean(axis=0)),
        "normal": short_numbers(np.mean(list(stand.normals.values()), axis=0)),
        "com": None if statics is None else short_numbers(statics.center_of_mass),
        "middle": short_numbers((low + high) / 2),
        "radius": float(np.linalg.norm(high - low) / 2),
        "layers": [
            *("shapes", "axes", *(["forces"] if statics else []), "support", "masses"),
        ],
        "size": float(np.ptp(points, axis=0).max() + stand.qpos[2]),
    }


def _frames(robot: Robot, data: mujoco.MjData, motion: Motion) -> dict[str, Any]:
    """Returns where the bodies are in some of the configurations."""
    finite = np.isfinite(motion.qpos).all(axis=1)
    most = np.linspace(0, finite.sum() - 1, min(int(finite.sum()), MOST_FRAMES)).round()
    chosen = np.flatnonzero(finite)[np.unique(most.astype(int))]
    poses = []
    for qpos in motion.qpos[chosen]:
        robot.mj_convention.set_state(data, qpos)
        mujoco.mj_kinematics(robot.mj_model, data)
        poses.append(np.concatenate([data.xpos, data.xquat], axis=1)[1:])
    return packed(motion.name, motion.time[chosen], np.array(poses))


def packed(name: Text, time: Array, poses: Array) -> dict[str, Any]:
    """Returns poses in few letters.

    Args:
        name: What moves.
        time: (n,) when (s).
        poses: (n, bodies, 7) x, y, z (m) and quaternion w, x, y, z.

    Returns:
        ``frames`` are whole numbers of 16 bits: x, y, z in parts of ``reach`` / 32767, then the
        quaternion in parts of 1 / 32767.
    """
    values = poses.copy()
    reach = max(float(np.abs(values[..., :3]).max()), 1e-3)
    values[..., :3] /= reach
    return {
        "en": name.en,
        "zh": name.zh,
        "time": short_numbers(time),
        "reach": reach,
        "frames": base64.b64encode(np.round(32767 * values).astype("<i2").tobytes()).decode(),
    }


def short_numbers(values: Array) -> list[Any]:
    """Returns numbers to a hundredth of a millimetre: a view shows no more."""
    return np.round(values, 5).tolist()  # type: ignore[no-any-return]


def extent_of(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[Array, Array]:
    """Returns the least and the greatest x, y, z (3,) of the robot's shapes, by their boxes (m)."""
    own = shown_geoms(model)
    turns = np.abs(data.geom_xmat[own].reshape(-1, 3, 3))
    centres, halves = model.geom_aabb[own, :3], model.geom_aabb[own, 3:]
    turned = np.einsum("nij,nj->ni", data.geom_xmat[own].reshape(-1, 3, 3), centres)
    middle, reach = data.geom_xpos[own] + turned, np.einsum("nij,nj->ni", turns, halves)
    frames = data.xpos[1:]
    ends = np.concatenate([middle - reach, middle + reach, frames])
    return ends.min(axis=0), ends.max(axis=0)


def shown_geoms(model: mujoco.MjModel) -> list[int]:
    """Returns the robot's shapes that are shown: those that MuJoCo's viewer shows, or else all."""
    own = [
        geom
        for geom in range(model.ngeom)
        if model.geom_bodyid[geom] and int(model.geom_type[geom]) in SHAPES
    ]
    return [geom for geom in own if model.geom_group[geom] < SHOWN_GROUPS] or own


def bodies_of(model: mujoco.MjModel) -> list[dict[str, Any]]:
    """Returns the bodies but the world: names, masses (kg) and coms in their own frames (m)."""
    return [
        {
            "name": visible(str(model.body(body).name)),
            "mass": round(float(model.body_mass[body]), 6),
            "com": short_numbers(model.body_ipos[body]),
        }
        for body in range(1, model.nbody)
    ]


def _joints(
    robot: Robot, stand: Stand, statics: GravityCompensation | None
) -> list[dict[str, Any]]:
    """Returns each joint's axis, what it does, where it is and what its motor holds."""
    model = robot.mj_model
    positions = stand.joint_positions(robot)
    listed = []
    for index, (summary, limit) in enumerate(
        zip(joint_summaries(robot), robot.effort_limits, strict=True)
    ):
        joint = model.joint(summary.name).id
        listed.append(
            {
                "name": visible(summary.name),
                "body": int(model.jnt_bodyid[joint]) - 1,
                "anchor": short_numbers(model.jnt_pos[joint]),
                "axis": short_numbers(model.jnt_axis[joint]),
                "motion": summary.motion,
                "position": round(float(positions[index]), 4),
                "torque": None
                if statics is None
                else round(float(statics.joint_torques[index]), 4),
                "limit": round(float(limit), 4) if np.isfinite(limit) else None,
            }
        )
    return listed


def geoms_of(model: mujoco.MjModel) -> tuple[list[dict[str, Any]], dict[str, dict[str, Any]]]:
    """Returns the robot's shapes, and the meshes that they have."""
    seen = shown_geoms(model)
    ids = {
        int(model.geom_dataid[geom])
        for geom in seen
        if int(model.geom_type[geom]) == int(mujoco.mjtGeom.mjGEOM_MESH)
    }
    total = sum(int(model.mesh_facenum[mesh]) for mesh in ids)
    share = min(1.0, MOST_FACES / max(total, 1))
    meshes = {str(mesh): _mesh(model, mesh, share) for mesh in sorted(ids)}
    geoms = []
    for geom in seen:
        shape = SHAPES[int(model.geom_type[geom])]
        material = int(model.geom_matid[geom])
        colour = model.mat_rgba[material] if material >= 0 else model.geom_rgba[geom]
        entry: dict[str, Any] = {
            "shape": shape,
            "body": int(model.geom_bodyid[geom]) - 1,
            "size": short_numbers(model.geom_size[geom]),
            "pos": short_numbers(model.geom_pos[geom]),
            "quat": short_numbers(model.geom_quat[geom]),
            "colour": np.round(colour, 3).tolist(),
        }
        if shape == "mesh":
            entry["mesh"] = str(int(model.geom_dataid[geom]))
        geoms.append(entry)
    return geoms, meshes


def _mesh(model: mujoco.MjModel, mesh: int, share: float) -> dict[str, Any]:
    """Returns a mesh with about ``share`` of its faces, in whole steps of its box's sides."""
    first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
    start, faces = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
    vertices = np.asarray(model.mesh_vert[first : first + count], dtype=float)
    triangles = np.asarray(model.mesh_face[start : start + faces], dtype=np.int64)
    wanted = max(int(share * faces), 100)
    cells = _COARSEST
    while len(triangles) > wanted and cells > 4:
        vertices, triangles = coarser(vertices, triangles, cells)
        cells = int(0.75 * cells)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    span = np.where(high > low, high - low, 1.0)
    steps = np.round((vertices - low) / span * 65535).astype("<u2")
    return {
        "low": short_numbers(low),
        "span": short_numbers(span),
        "vertices": base64.b64encode(steps.tobytes()).decode(),
        "faces": base64.b64encode(triangles.astype("<u4").tobytes()).decode()
        if len(vertices) > 65535
        else base64.b64encode(triangles.astype("<u2").tobytes()).decode(),
        "wide": len(vertices) > 65535,
    }


def coarser(vertices: Array, triangles: Integers, cells: int) -> tuple[Array, Integers]:
    """Returns a mesh whose vertices within a cell of a grid are one.

    Args:
        vertices: (n, 3) (m).
        triangles: (m, 3) their vertices.
        cells: How many of them the longest side of the mesh's box has.

    Returns:
        Vertices, each the mean of those in a cell, and the triangles that have not collapsed.

    Source: Rossignac and Borrel, "Multi-resolution 3D approximations for rendering complex scenes",
    1993: vertex clustering.
    """
    low = vertices.min(axis=0)
    size = float(np.ptp(vertices, axis=0).max()) / cells
    keys = np.floor((vertices - low) / size).astype(np.int64)
    _, cell = np.unique(keys, axis=0, return_inverse=True)
    cell = cell.ravel()
    count = np.bincount(cell)
    merged = np.column_stack([np.bincount(cell, vertices[:, axis]) / count for axis in range(3)])
    moved = cell[triangles]
    whole = (
        (moved[:, 0] != moved[:, 1]) & (moved[:, 1] != moved[:, 2]) & (moved[:, 2] != moved[:, 0])
    )
    return merged, moved[whole]


def shared(scenes: Sequence[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Takes meshes out of scenes, where several robots have the same, and returns each once.

    The scenes' own are replaced by the names under which they are returned.
    """
    found: dict[tuple[str, str, str], str] = {}
    meshes: dict[str, dict[str, Any]] = {}
    for scene in scenes:
        names = {}
        for name, mesh in scene.pop("meshes").items():
            key = (mesh["vertices"], mesh["faces"], str(mesh["low"]) + str(mesh["span"]))
            if key not in found:
                found[key] = f"m{len(found)}"
                meshes[found[key]] = mesh
            names[name] = found[key]
        for geom in scene["geoms"]:
            if "mesh" in geom:
                geom["mesh"] = names[geom["mesh"]]
    return meshes
