"""The feet in a MuJoCo model: where they are, and which geoms."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ModelError, UnknownNameError
from pupper_analysis.models.description import Description
from pupper_analysis.robot import contact

Array = NDArray[np.float64]


def foot_site(model: mujoco.MjModel, frame: str, source: str | Path) -> tuple[int, Array]:
    """Finds a foot's frame in a MuJoCo model: a site, body or geom of that name.

    Returns:
        The id of the body that carries it, and its position (3,) in that body's frame (m).

    Raises:
        UnknownNameError: If there is none; the message lists the sites.
    """
    site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, frame)
    if site >= 0:
        return int(model.site_bodyid[site]), np.array(model.site_pos[site])
    body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, frame)
    if body >= 0:
        return body, np.zeros(3)
    geom = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_GEOM, frame)
    if geom >= 0:
        return int(model.geom_bodyid[geom]), np.array(model.geom_pos[geom])
    sites = [model.site(index).name for index in range(model.nsite)]
    raise UnknownNameError(source, "site, body or geom (for a foot)", frame, sites)


def foot_geoms(
    description: Description, model: mujoco.MjModel, places: Mapping[str, tuple[int, Array]]
) -> dict[str, tuple[int, float]]:
    """Finds the geom that touches the ground at each contact point, and its radius there (m).

    Raises:
        ModelError: If there is none.
    """
    found: dict[str, tuple[int, float]] = {}
    for foot, (body, position) in places.items():
        if foot in description.foot_geoms:
            name, radius = description.foot_geoms[foot]
            found[foot] = int(model.geom(name).id), radius
            continue
        sphere = contact.foot_geom(model, body, position)
        if sphere is None:
            frame = description.contact_points[foot][1]
            where = {"body": model.body(body).name, "frame": frame}
            problem = diagnose("foot-without-sphere", subject=("foot", foot), **where)
            raise ModelError(description.mjcf_source, problem)
        found[foot] = sphere, float(model.geom_size[sphere, 0])
    return found


def stand_height(
    model: mujoco.MjModel,
    base: str,
    places: Mapping[str, tuple[int, Array]],
    radius: Mapping[str, float],
    keyframe: Array,
    foot_depth: float | None,
) -> float:
    """Returns the base's height (m) in the nominal stand.

    With ``foot_depth``, the feet's centres are that far below the hips (the legs' first bodies);
    otherwise the lowest foot touches the ground with the keyframe's joint positions.
    """
    data = mujoco.MjData(model)
    if foot_depth is None:
        data.qpos[:] = keyframe[len(keyframe) - model.nq :]
    mujoco.mj_kinematics(model, data)
    base_id = model.body(base).id
    rotation = data.xmat[base_id].reshape(3, 3)
    below: list[float] = []
    for foot, (body, position) in places.items():
        if foot_depth is None:
            at = data.xpos[body] + data.xmat[body].reshape(3, 3) @ position
        else:
            while model.body_parentid[body] not in (base_id, 0):
                body = int(model.body_parentid[body])
            at = data.xpos[body] - foot_depth * rotation[:, 2]
        below.append(float(rotation[:, 2] @ (data.xpos[base_id] - at)) + radius[foot])
    return max(below, default=0.0)


def limb_ends(model: mujoco.MjModel) -> list[int]:
    """Returns the ids of the bodies with joints that carry no others with joints."""
    moving = [b for b in range(1, model.nbody) if int(model.body_weldid[b]) == b]
    carrying = {int(model.body_weldid[model.body_parentid[body]]) for body in moving}
    return [body for body in moving if body not in carrying and model.body_jntnum[body]]
