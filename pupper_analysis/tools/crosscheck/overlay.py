"""Both files over each other, with what differs marked: the scene of a comparison's page."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import Diagnostic
from pupper_analysis.base.errors import PupperAnalysisError
from pupper_analysis.models.conversion import pinocchio_from_urdf
from pupper_analysis.models.mjcf_file import read_mjcf
from pupper_analysis.models.urdf_file import read_urdf
from pupper_analysis.present.document import text
from pupper_analysis.present.formats import escape_control
from pupper_analysis.present.html.write import (
    bodies_of,
    extent_of,
    geoms_of,
    pack_poses,
    short_numbers,
)
from pupper_analysis.tools.crosscheck.crosscheck import Comparison

Array = NDArray[np.float64]


def draw_overlay(comparison: Comparison) -> dict[str, Any] | None:
    """Returns both files at zero angles, in the world of the MJCF, their roots at one place.

    Bodies with differences are marked, and say which. None where a file has gone, or has no bodies.
    """
    try:
        model = read_mjcf(comparison.mjcf).model
        lines = _urdf_lines(comparison.urdf)
    except (PupperAnalysisError, OSError, ValueError, RuntimeError):
        return None  # the lines of both are quoted all the same
    if model.nbody < 2:
        return None
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    message = _differences_by_body(comparison, model)
    bodies, (geoms, meshes) = bodies_of(model), geoms_of(model)
    for body, differences in message.items():
        bodies[body - 1]["differences"] = _in_both(differences)
    for geom in geoms:
        geom["marked"] = geom["body"] + 1 in message
    root = _root(comparison, model)
    turn = data.xmat[root].reshape(3, 3)
    placed = [data.xpos[root] + line @ turn.T for line in lines]
    ends = np.concatenate([extent_of(model, data), *placed])
    low, high = ends.min(axis=0), ends.max(axis=0)
    radius = max(float(np.linalg.norm(high - low) / 2), 1e-3)
    poses = np.concatenate([data.xpos, data.xquat], axis=1)[None, 1:]
    middle = (low + high) / 2
    return {
        "bodies": bodies,
        "geoms": geoms,
        "meshes": meshes,
        "motions": [pack_poses(text("zero-angles"), np.zeros(1), poses)],
        "joints": _joints(comparison, model),
        "contacts": [],
        "lines": [short_numbers(line) for line in placed],
        "polygon": [],
        "steps": [],
        "ground": short_numbers(np.array([middle[0], middle[1], low[2]])),
        "normal": [0.0, 0.0, 1.0],
        "com": None,
        "below": None,
        "middle": short_numbers(middle),
        "radius": radius,
        "size": 1.3 * radius,
        "layers": ["shapes", "axes", "other", "masses"],
    }


def _urdf_lines(path: str) -> list[Array]:
    """Returns lines (2, 3) to each joint from its parent, at zero angles, from the root (m)."""
    file = read_urdf(path)
    model = pinocchio_from_urdf(file.text, file.path, floating=False)
    data = model.createData()
    pin.forwardKinematics(model, data, pin.neutral(model))
    places = [data.oMi[joint].translation.copy() for joint in range(model.njoints)]
    return [
        np.array([places[model.parents[joint]], places[joint]]) for joint in range(1, model.njoints)
    ]


def _root(comparison: Comparison, model: mujoco.MjModel) -> int:
    """Returns the body that carries the joints that both files have."""
    for joint in comparison.joints:
        found = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, joint)
        if found >= 0:
            return int(model.body_rootid[model.jnt_bodyid[found]])
    return 1


def _differences_by_body(
    comparison: Comparison, model: mujoco.MjModel
) -> dict[int, list[Diagnostic]]:
    """Returns {body: what differs of it, or of the joint that moves it}."""
    values: dict[int, list[Diagnostic]] = {}
    for difference in comparison.differences:
        joint = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, difference.element)
        if joint >= 0:
            body = int(model.jnt_bodyid[joint])
        elif difference.element == comparison.base:
            body = _root(comparison, model)
        else:
            continue
        values.setdefault(body, []).append(difference.diagnostic)
    return values


def _joints(comparison: Comparison, model: mujoco.MjModel) -> list[dict[str, Any]]:
    listed = []
    for name in comparison.joints:
        joint = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name)
        if joint < 0:
            continue
        found = [one.diagnostic for one in comparison.differences if one.element == name]
        listed.append(
            {
                "name": escape_control(name),
                "body": int(model.jnt_bodyid[joint]) - 1,
                "anchor": short_numbers(model.jnt_pos[joint]),
                "axis": short_numbers(model.jnt_axis[joint]),
                "differences": _in_both(found),
            }
        )
    return listed


def _in_both(found: Iterable[Diagnostic]) -> dict[str, str]:
    """Returns {language: sentences}, empty texts where there is none."""
    messages = tuple(found)
    between = {"en": "; ", "zh": "；"}  # noqa: RUF001 (Chinese)
    return {
        language: escape_control(comma.join(one.text(language) for one in messages))
        for language, comma in between.items()
    }
