"""Feet and ground in MuJoCo: which geoms they are, where, and what MuJoCo makes of a contact."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ModelError, UnknownNameError
from pupper_analysis.models.description import Description
from pupper_analysis.robot.impedance import effective_solref

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ContactParameters:
    """The effective parameters of the contact between two geoms.

    Attributes:
        condim: 1 frictionless, 3 sliding, 4 torsional, 6 rolling friction too.
        friction: (5,) sliding (twice, -), torsional (m), rolling (twice, m).
        solref: (2,) time constant (s) and damping ratio.
        solimp: (5,) dmin, dmax, width (m), midpoint, power.
        margin: Distance from which on they push each other apart (m).
    """

    condim: int
    friction: tuple[float, ...]
    solref: tuple[float, ...]
    solimp: tuple[float, ...]
    margin: float = 0.0

    @property
    def sliding_friction(self) -> float:
        """The coefficient of the friction cone."""
        return self.friction[0] if self.condim > 1 else 0.0


def combine_geoms(model: mujoco.MjModel, first: int, second: int | None) -> ContactParameters:
    """Combines two geoms' parameters as MuJoCo does for a contact without a ``<pair>``.

    The geom of higher priority wins. At equal priority: the greater condim, each greater friction
    coefficient, and the mean of solref and solimp weighted by solmix (the lesser of each solref
    where one is negative, that is, given as stiffness and damping). Margins add up.

    Source: MuJoCo documentation, "Computation: Contact parameters".

    Args:
        model: The model.
        first: A geom's id.
        second: The other geom's id; None: a ground with MuJoCo's own numbers, as scenes have it.
    """
    geoms = (model, first), (model, second) if second is not None else (_PLANE, 0)
    priority, condims, frictions, weights, solrefs, solimps, margins = (
        np.array([getattr(of, f"geom_{word}")[geom] for of, geom in geoms]) for word in _COMBINED
    )
    if priority[0] != priority[1]:
        chosen = int(np.argmax(priority))
        condim, friction = int(condims[chosen]), frictions[chosen]
        solref, solimp = solrefs[chosen], solimps[chosen]
    else:
        condim, friction = int(condims.max()), frictions.max(axis=0)
        share = 0.5 if weights.sum() < mujoco.mjMINVAL else weights[0] / weights.sum()
        solref = share * solrefs[0] + (1 - share) * solrefs[1]
        if solrefs[:, 0].min() <= 0:
            solref = solrefs.min(axis=0)
        solimp = share * solimps[0] + (1 - share) * solimps[1]
    slide, spin, roll = (float(value) for value in friction)
    return ContactParameters(
        condim=condim,
        friction=(slide, slide, spin, roll, roll),
        solref=effective_solref(solref),
        solimp=tuple(float(value) for value in solimp),
        margin=float(margins.sum()),
    )


_COMBINED = ("priority", "condim", "friction", "solmix", "solref", "solimp", "margin")
_PLANE = mujoco.MjModel.from_xml_string(
    "<mujoco><worldbody><geom type='plane' size='1 1 1'/></worldbody></mujoco>"
)


def contact_offset(radius: ArrayLike, normal: Array, depth: ArrayLike) -> Array:
    """Returns the way (..., 3) from a foot's centre to the contact (m).

    MuJoCo has it half way into the penetration.

    Args:
        radius: (...) of the foot's sphere (m).
        normal: (..., 3) out of the ground.
        depth: (...) how deep the foot is in it (m).
    """
    reach = np.asarray(radius) - np.asarray(depth) / 2
    offset: Array = -reach[..., None] * normal
    return offset


def ground_geom(model: mujoco.MjModel) -> int | None:
    """Returns the id of the plane that is fixed to the world, or None."""
    for geom in range(model.ngeom):
        plane = model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE.value
        if plane and model.body_weldid[model.geom_bodyid[geom]] == 0:
            return geom
    return None


def foot_geom(model: mujoco.MjModel, body: int, position: Array) -> int | None:
    """Returns the id of a body's sphere that touches things and is centred at ``position``.

    Args:
        model: The model.
        body: The id of the body that carries the foot.
        position: (3,) of the foot's frame, in the body's frame (m).

    Returns:
        The geom's id, or None if no such sphere is within 1 micrometre.
    """
    for geom in range(model.ngeom):
        if (
            model.geom_bodyid[geom] == body
            and model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_SPHERE.value
            and (model.geom_contype[geom] or model.geom_conaffinity[geom])
            and np.linalg.norm(model.geom_pos[geom] - position) < 1e-6
        ):
            return geom
    return None


def ground_forces(
    model: mujoco.MjModel, data: mujoco.MjData, foot_geoms: Mapping[int, str]
) -> tuple[dict[str, Array], set[str]]:
    """Returns what the ground does to a robot at a state.

    Args:
        model: The model.
        data: After ``mj_forward``.
        foot_geoms: Which geom is which foot's.

    Returns:
        The force on each foot that touches, {foot: (3,)}, in world axes (N); and the names of the
        other bodies that touch.
    """
    forces: dict[str, Array] = {}
    others: set[str] = set()
    pairs = data.contact.geom
    wrenches = np.zeros((len(pairs), 6))
    for number, wrench in enumerate(wrenches):
        mujoco.mj_contactForce(model, data, number, wrench)
    given = (wrenches[:, None, :3] @ data.contact.frame.reshape(-1, 3, 3))[:, 0]
    bodies = model.geom_bodyid[pairs].tolist()
    for pair, (one, other), force in zip(pairs.tolist(), bodies, given, strict=True):
        first = one == 0  # the floor, or a step
        if first == (other == 0):
            continue
        geom = pair[1] if first else pair[0]
        foot = foot_geoms.get(geom)
        if foot is None:
            others.add(model.body(other if first else one).name)
        else:
            forces[foot] = forces.get(foot, 0.0) + (force if first else -force)
    return forces, others


def bodies_on_ground(
    model: mujoco.MjModel, data: mujoco.MjData, foot_geoms: Mapping[int, str]
) -> set[str]:
    """Returns the names of the bodies that touch the ground with other geoms than feet's.

    Args:
        model: The model.
        data: After ``mj_collision``.
        foot_geoms: Which geom is which foot's.
    """
    pairs = data.contact.geom
    still = model.geom_bodyid[pairs] == 0
    geoms = set(pairs[still[:, ::-1] & ~still].tolist())  # of those whose other one is the ground's
    return {model.body(int(model.geom_bodyid[geom])).name for geom in geoms.difference(foot_geoms)}


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
        sphere = foot_geom(model, body, position)
        if sphere is None:
            frame = description.contact_points[foot][1]
            where = {"body": model.body(body).name, "frame": frame}
            problem = diagnose("foot-without-sphere", subject=("foot", foot), **where)
            raise ModelError(description.mjcf_source, problem)
        found[foot] = sphere, float(model.geom_size[sphere, 0])
    return found


def ground_contacts(
    model: mujoco.MjModel, geoms: Mapping[str, tuple[int, float]]
) -> Mapping[str, ContactParameters]:
    """Returns the parameters of contacts with the ground, by their points' ``foot_geoms``."""
    ground = ground_geom(model)
    if ground is None:
        return MappingProxyType({})
    return MappingProxyType(
        {point: combine_geoms(model, geom, ground) for point, (geom, _) in geoms.items()}
    )


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
