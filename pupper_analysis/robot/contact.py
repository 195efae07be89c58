"""Contacts of feet with the ground in MuJoCo: geoms, positions, forces and effective parameters.

Input is a compiled MuJoCo model with a ground plane. Outputs are the geom, radius and contact
parameters of each contact point. `combine_geoms` combines the parameters of two geoms by MuJoCo's
rule.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ModelError, UnknownNameError
from pupper_analysis.models.description import Description
from pupper_analysis.robot.impedance import effective_solref

MIN_FOOT_FRICTION = 1e-3
"""Sliding friction coefficient [1] below which a foot counts as frictionless, in the audit and in
the message that the added ground provides all friction. Chosen, not tuned."""


@dataclass(frozen=True)
class ContactParameters:
    """Effective parameters of the contact between two geoms in MuJoCo.

    Attributes:
        condim: Friction of the contact: 1 none, 3 sliding, 4 also torsional, 6 also rolling.
        friction: Five coefficients: sliding in two directions [1], torsional [m], rolling about two
            axes [m].
        solref: Time constant [s] and damping ratio [1]; or, if not positive, -stiffness and
            -damping.
        solimp: MuJoCo's dmin, dmax, width [m], midpoint and power.
        margin: Distance [m] at which contact forces begin.
    """

    condim: int
    friction: tuple[float, ...]
    solref: tuple[float, ...]
    solimp: tuple[float, ...]
    margin: float = 0.0

    @property
    def sliding_friction(self) -> float:
        """Friction coefficient of sliding [1]; 0 for a frictionless contact.

        A contact is frictionless if ``condim`` is 1, or if the coefficient is from 0 to ``mjMINMU``
        (1e-5). MuJoCo raises smaller coefficients to this value. A negative coefficient, which is
        an error of the file, is returned unchanged.
        """
        slide = self.friction[0]
        return 0.0 if self.condim == 1 or 0 <= slide <= mujoco.mjMINMU else slide

    @property
    def rolling_friction(self) -> float:
        """Larger rolling friction coefficient of both axes [m]; 0 unless ``condim`` is 6."""
        return max(self.friction[3:]) if self.condim == 6 else 0.0


def combine_geoms(model: mujoco.MjModel, first: int, second: int | None) -> ContactParameters:
    """Compute MuJoCo's contact parameters for two geoms without a ``<pair>``.

    Source of the rules: MuJoCo documentation, "Computation: Contact parameters". The resulting
    solref is replaced by `effective_solref`.

    Args:
        model: MuJoCo model.
        first: Id of a geom.
        second: Id of the other geom; None for a plane with MuJoCo's default parameters.
    """
    geoms = (model, first), (model, second) if second is not None else (_DEFAULT_PLANE_MODEL, 0)
    priority, condims, frictions, weights, solrefs, solimps, margins = (
        np.array([getattr(owner, f"geom_{word}")[geom] for owner, geom in geoms])
        for word in _COMBINED_FIELDS
    )
    if priority[0] != priority[1]:
        winner = int(np.argmax(priority))
        condim, friction = int(condims[winner]), frictions[winner]
        solref, solimp = solrefs[winner], solimps[winner]
    else:
        condim, friction = int(condims.max()), frictions.max(axis=0)
        weight = 0.5 if weights.sum() < mujoco.mjMINVAL else weights[0] / weights.sum()
        solref = weight * solrefs[0] + (1 - weight) * solrefs[1]
        if solrefs[:, 0].min() <= 0:
            solref = solrefs.min(axis=0)
        solimp = weight * solimps[0] + (1 - weight) * solimps[1]
    slide, spin, roll = (float(value) for value in friction)
    return ContactParameters(
        condim=condim,
        friction=(slide, slide, spin, roll, roll),
        solref=effective_solref(solref),
        solimp=tuple(float(value) for value in solimp),
        margin=float(margins.sum()),
    )


_COMBINED_FIELDS = ("priority", "condim", "friction", "solmix", "solref", "solimp", "margin")
"""Parameters of geoms from which MuJoCo computes the parameters of a contact, without the prefix
``geom_`` of their arrays in ``mjModel``."""

_DEFAULT_PLANE_MODEL = mujoco.MjModel.from_xml_string(
    "<mujoco><worldbody><geom type='plane' size='1 1 1'/></worldbody></mujoco>"
)
"""Model with a single plane that has MuJoCo's default contact parameters."""


def contact_offset(radius: ArrayLike, normal: Array, depth: ArrayLike) -> Array:
    """Compute the vector from the centre of a foot's sphere to MuJoCo's contact point.

    MuJoCo places the contact in the middle between the two penetrating surfaces: the offset is
    -(radius - depth / 2) normal.

    Args:
        radius: Radius (...) [m] of the foot's sphere.
        normal: Unit normal (..., 3) out of the ground.
        depth: Penetration (...) [m].

    Returns:
        Vector (..., 3) [m], expressed in the frame of ``normal``.
    """
    distance = np.asarray(radius) - np.asarray(depth) / 2
    offset: Array = -distance[..., None] * normal
    return offset


def ground_geom(model: mujoco.MjModel) -> int | None:
    """Return the id of the ground plane, a plane geom fixed to the world; None without one.

    Of several planes, the first plane with enabled contacts is preferred.
    """
    fixed = model.body_weldid[model.geom_bodyid] == 0
    planes = np.flatnonzero(fixed & (model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE.value))
    touching = planes[(model.geom_contype[planes] | model.geom_conaffinity[planes]) != 0]
    return next(iter([*touching.tolist(), *planes.tolist()]), None)


def foot_geom(model: mujoco.MjModel, body: int, position: Array) -> int | None:
    """Find the collision sphere of a body whose centre is at a given position.

    Args:
        model: MuJoCo model.
        body: Id of the body.
        position: Position (3,) [m] in the frame of the body.

    Returns:
        Id of the geom; None if no sphere with enabled contacts is within 1 micrometre.
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


def find_acting_contacts(data: mujoco.MjData) -> NDArray[np.bool_]:
    """Return a mask, shape (ncon,), of the contacts that can exert a force.

    These are the contacts that MuJoCo does not exclude from its constraints. Excluded are, for
    example, contacts in the ``gap`` beyond the margin.

    Args:
        data: Data after ``mj_collision``.
    """
    mask: NDArray[np.bool_] = np.asarray(data.contact.exclude) == 0
    return mask


def list_contact_bodies(model: mujoco.MjModel, data: mujoco.MjData) -> NDArray[np.int64]:
    """Return the ids of the two bodies of each of n contacts, shape (n, 2).

    A flexible body (``flex``) has no geom; its id is the body of a vertex or node.

    Args:
        model: MuJoCo model.
        data: Data after ``mj_collision``.
    """
    pairs = np.asarray(data.contact.geom, dtype=np.int64).reshape(-1, 2)
    if not model.nflex:
        return np.asarray(model.geom_bodyid[pairs], dtype=np.int64)
    bodies = np.zeros_like(pairs)
    bodies[pairs >= 0] = model.geom_bodyid[pairs[pairs >= 0]]
    for number, side in np.argwhere(pairs < 0).tolist():
        bodies[number, side] = _find_flex_body(model, data.contact[number], side)
    return bodies


def _find_flex_body(model: mujoco.MjModel, touch: mujoco.MjContact, side: int) -> int:
    """Return a body id of the flex on a side (0 or 1) of a contact: of the vertex, if possible."""
    flex, vertex, element = (int(ids[side]) for ids in (touch.flex, touch.vert, touch.elem))
    if vertex < 0:  # the first vertex of the touched element
        size = int(model.flex_dim[flex]) + 1
        vertex = int(model.flex_elem[int(model.flex_elemdataadr[flex]) + element * size])
    body = int(model.flex_vertbodyid[int(model.flex_vertadr[flex]) + vertex])
    # Vertices of a flex that is interpolated between nodes have no body.
    return body if body >= 0 else int(model.flex_nodebodyid[int(model.flex_nodeadr[flex])])


def ground_forces(
    model: mujoco.MjModel, data: mujoco.MjData, foot_geoms: Mapping[int, str]
) -> tuple[dict[str, Array], set[str]]:
    """Sum the contact forces between the ground and each foot at a state.

    The ground consists of all geoms of MuJoCo's world body (floor, steps). Contacts in the gap
    beyond the margin are ignored.

    Args:
        model: MuJoCo model.
        data: Data after ``mj_forward``.
        foot_geoms: {geom id: foot}.

    Returns:
        {foot: force (3,) [N] of the ground on the foot, in world axes}, for feet in contact; and
        the names of bodies that touch the ground with a geom that is not in ``foot_geoms``.
    """
    forces: dict[str, Array] = {}
    other_bodies: set[str] = set()
    contacts, wrench = data.contact, np.zeros(6)
    frames = contacts.frame.reshape(-1, 3, 3)
    bodies = list_contact_bodies(model, data).tolist()
    acting = find_acting_contacts(data).tolist()
    for number, (acts, pair, (body1, body2)) in enumerate(
        zip(acting, contacts.geom.tolist(), bodies, strict=True)
    ):
        is_first_ground = body1 == 0  # floor or step
        if not acts or is_first_ground == (body2 == 0):
            continue
        foot = foot_geoms.get(pair[1] if is_first_ground else pair[0])
        if foot is None:
            other_bodies.add(model.body(body2 if is_first_ground else body1).name)
            continue
        mujoco.mj_contactForce(model, data, number, wrench)
        force = wrench[:3] @ frames[number]
        forces[foot] = forces.get(foot, 0.0) + (force if is_first_ground else -force)
    return forces, other_bodies


def find_ground_contacts(
    model: mujoco.MjModel, data: mujoco.MjData, foot_geoms: Mapping[int, str]
) -> tuple[set[str], set[str]]:
    """Find the feet and the other bodies that touch the ground, without computing forces.

    The ground consists of all geoms of MuJoCo's world body. Contacts in the gap beyond the margin
    are ignored.

    Args:
        model: MuJoCo model.
        data: Data after ``mj_collision``.
        foot_geoms: {geom id: foot}.

    Returns:
        Names of the feet in contact; names of the bodies that touch the ground with a geom that is
        not in ``foot_geoms``.
    """
    acting = find_acting_contacts(data)
    pairs, bodies = data.contact.geom[acting], list_contact_bodies(model, data)[acting]
    is_fixed = bodies == 0
    # Sides on moving bodies whose contact partner is fixed.
    sides = is_fixed[:, ::-1] & ~is_fixed
    touching = set(zip(pairs[sides].tolist(), bodies[sides].tolist(), strict=True))
    return (
        {foot_geoms[geom] for geom, _ in touching if geom in foot_geoms},
        {model.body(body).name for geom, body in touching if geom not in foot_geoms},
    )


def bodies_on_ground(
    model: mujoco.MjModel, data: mujoco.MjData, foot_geoms: Mapping[int, str]
) -> set[str]:
    """Return the names of bodies that touch the ground with a geom that belongs to no foot.

    The ground consists of all geoms of MuJoCo's world body. Contacts in the gap beyond the margin
    are ignored.

    Args:
        model: MuJoCo model.
        data: Data after ``mj_collision``.
        foot_geoms: {geom id: foot}.
    """
    return find_ground_contacts(model, data, foot_geoms)[1]


def foot_site(model: mujoco.MjModel, frame: str, source: str | Path) -> tuple[int, Array]:
    """Find the body and position of a foot's frame in a MuJoCo model: a site, body or geom.

    Args:
        model: MuJoCo model.
        frame: Name of the site, body or geom.
        source: File of the model, for messages.

    Returns:
        Id of the body, and position (3,) [m] of the frame in the body.

    Raises:
        UnknownNameError: If there is no such frame.
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
    description: Description, model: mujoco.MjModel, centres: Mapping[str, tuple[int, Array]]
) -> dict[str, tuple[int, float]]:
    """Find the collision geom and the contact radius of each contact point in a MuJoCo model.

    The geom is the entry in ``description.foot_geoms``. Without an entry, the geom is a collision
    sphere of the contact point's body, with its centre at the contact point (`foot_geom`).

    Args:
        description: Description of the robot.
        model: MuJoCo model of the robot.
        centres: {contact point: (body id in ``model``, position (3,) [m] in the body frame)}.

    Returns:
        {contact point: (geom id, radius [m])}.

    Raises:
        ModelError: If a contact point has no entry and no such sphere.
        KeyError: If the MJCF lacks the geom of an entry.
    """
    geoms: dict[str, tuple[int, float]] = {}
    for foot, (body, position) in centres.items():
        if foot in description.foot_geoms:
            name, radius = description.foot_geoms[foot]
            geoms[foot] = int(model.geom(name).id), radius
            continue
        sphere = foot_geom(model, body, position)
        if sphere is None:
            frame = description.contact_points[foot][1]
            details = {"body": model.body(body).name, "frame": frame}
            problem = diagnose("foot-without-sphere", subject=("foot", foot), **details)
            raise ModelError(description.mjcf_source, problem)
        geoms[foot] = sphere, float(model.geom_size[sphere, 0])
    return geoms


def ground_contacts(
    model: mujoco.MjModel, geoms: Mapping[str, tuple[int, float]]
) -> Mapping[str, ContactParameters]:
    """Return MuJoCo's contact parameters between each contact point and the ground.

    ``<pair>`` elements and the flag ``override`` of the MJCF are not considered.

    Args:
        model: MuJoCo model.
        geoms: {contact point: (id of the geom, radius [m])}.

    Returns:
        {contact point: parameters}; empty if the model has no ground.
    """
    ground = ground_geom(model)
    if ground is None:
        return MappingProxyType({})
    return MappingProxyType(
        {point: combine_geoms(model, geom, ground) for point, (geom, _) in geoms.items()}
    )


def stand_height(
    model: mujoco.MjModel,
    base: str,
    centres: Mapping[str, tuple[int, Array]],
    radius: Mapping[str, float],
    keyframe: Array,
    foot_depth: float | None,
) -> float:
    """Compute the height [m] of the base above the ground in the stand of the default `StandTask`.

    In this stand, the lowest foot touches the ground. Distances are measured along the z axis of
    the base. The height is 0 without feet.

    Args:
        model: MuJoCo model.
        base: Name of the base body.
        centres: {contact point: (body id, position (3,) [m] in the body)}.
        radius: {contact point: radius [m]}.
        keyframe: Configuration in MuJoCo's order, used without ``foot_depth``. It may contain a
            free base that the model has fixed.
        foot_depth: Distance [m] of the centres of the feet below the hips (the first bodies of the
            legs), or None.
    """
    data = mujoco.MjData(model)
    if foot_depth is None:
        data.qpos[:] = keyframe[len(keyframe) - model.nq :]
    mujoco.mj_kinematics(model, data)
    base_id = model.body(base).id
    rotation = data.xmat[base_id].reshape(3, 3)
    heights: list[float] = []
    for foot, (body, position) in centres.items():
        if foot_depth is None:
            foot_position = data.xpos[body] + data.xmat[body].reshape(3, 3) @ position
        else:
            while model.body_parentid[body] not in (base_id, 0):
                body = int(model.body_parentid[body])
            foot_position = data.xpos[body] - foot_depth * rotation[:, 2]
        heights.append(float(rotation[:, 2] @ (data.xpos[base_id] - foot_position)) + radius[foot])
    return max(heights, default=0.0)


def limb_ends(model: mujoco.MjModel) -> list[int]:
    """Return the body ids of the limb ends: bodies with joints, without moving descendants."""
    moving_bodies = [body for body in range(1, model.nbody) if int(model.body_weldid[body]) == body]
    parents = {int(model.body_weldid[model.body_parentid[body]]) for body in moving_bodies}
    return [body for body in moving_bodies if body not in parents and model.body_jntnum[body]]
