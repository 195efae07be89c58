"""Collision shapes of a robot, in the frames of the URDF's links.

The shapes come from MuJoCo's compiled model: primitives and convex hulls of meshes. Clearances
that are computed before a simulation therefore agree with MuJoCo's collisions.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import pinocchio as pin

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import Term, diagnose
from pupper_analysis.base.errors import ModelError
from pupper_analysis.models.shapes import NUM_SIZES, Pose, Shape, read_shape
from pupper_analysis.robot import contact
from pupper_analysis.robot.coordinates import MujocoConvention
from pupper_analysis.robot.structure import Structure


@dataclass(frozen=True, eq=False)
class CarriedShape:
    """Collision geom of the robot, expressed in the frame of the URDF link with which it moves.

    Attributes:
        geom: Id of the geom in ``mj_model``.
        body: Id of the body of the geom.
        link: Link of the URDF that moves with the geom.
        joint: Joint that moves the geom; "" for the base.
        form: Shape in the frame of the link.
        on_ground: Whether MuJoCo detects contacts of the geom with the ground; False if the geom is
            fixed in the world, or the model has no ground plane.
    """

    geom: int
    body: int
    link: str
    joint: str
    form: Shape
    on_ground: bool


def shapes_of(
    model: mujoco.MjModel,
    convention: MujocoConvention,
    structure: Structure,
    bases: tuple[str, str],
    neutral: Array,
    source: Path,
) -> tuple[CarriedShape, ...]:
    """Return the collision shapes of the robot's bodies, in the frames of the URDF's links.

    The order is the order of the geom ids. Feet and the shapes of a fixed base are included. The
    pose of a shape in its link is computed with all joint positions zero, because both models then
    have the same link poses.

    Args:
        model: MuJoCo's model of the MJCF.
        convention: Coordinate maps of the model.
        structure: Structure of the URDF's model.
        bases: Name of the base link (URDF), and name of the base body (MJCF).
        neutral: Configuration, shape (nq,), with all joints at zero.
        source: File of the MJCF, for messages.

    Raises:
        ModelError: If a collision geom is of a type without distance computation, such as a signed
            distance field.
    """
    data = mujoco.MjData(model)
    convention.set_state(data, neutral)
    mujoco.mj_kinematics(model, data)
    ground = contact.ground_geom(model)
    carriers = _LinkFinder(model, structure, bases, neutral)
    paired = {int(geom) for pair in (model.pair_geom1, model.pair_geom2) for geom in pair}
    shapes = []
    for geom in range(model.ngeom):
        body = int(model.geom_bodyid[geom])
        collides = model.geom_contype[geom] or model.geom_conaffinity[geom] or geom in paired
        moving_body = int(model.body_weldid[body])
        if not collides or moving_body not in carriers.joints:
            continue
        is_static = moving_body == 0
        if is_static and not _is_part_of_base(model, geom, int(model.body(bases[1]).id)):
            continue
        shape = read_shape(model, geom, data)
        if shape.kind not in NUM_SIZES:
            problem = diagnose(
                "geom-without-distances",
                geom=shape.name,
                body=model.body(body).name,
                kind=Term(shape.kind),
            )
            raise ModelError(source, problem)
        link, place = carriers.link(model.body(body).name, moving_body)
        shapes.append(
            CarriedShape(
                geom=geom,
                body=body,
                link=link,
                joint=carriers.joints[moving_body],
                form=replace(shape, pose=Pose.of(place.actInv(shape.pose.placement))),
                on_ground=ground is not None and not is_static and may_touch(model, geom, ground),
            )
        )
    return tuple(shapes)


def _is_part_of_base(model: mujoco.MjModel, geom: int, base: int) -> bool:
    """Return True if a static geom is part of the fixed base, not terrain of the world body."""
    body = int(model.geom_bodyid[geom])
    while body not in (base, 0):
        body = int(model.body_parentid[body])
    terrain = mujoco.mjtGeom.mjGEOM_PLANE.value, mujoco.mjtGeom.mjGEOM_HFIELD.value
    return body == base and (base != 0 or int(model.geom_type[geom]) not in terrain)


class _LinkFinder:
    """Finder of the URDF link that corresponds to each MuJoCo body of a robot.

    Args:
        model: MuJoCo model.
        structure: Pinocchio model with the indices of joints and links.
        bases: Names of the base link and of the base body.
        neutral: Configuration with all joints at zero, shape (nq,).

    Attributes:
        joints: {id of a moving body: joint that moves the body}. The joint of the base is "". A
            fixed base has the id of the world body, 0.
    """

    def __init__(
        self, model: mujoco.MjModel, structure: Structure, bases: tuple[str, str], neutral: Array
    ) -> None:
        base, mj_base = bases
        self._links, self._frames = structure.links, structure.model.frames
        self._data = structure.model.createData()
        pin.framesForwardKinematics(
            structure.model, self._data, structure.convention.unit_q(neutral)
        )
        joint_by_body = {
            int(model.jnt_bodyid[model.joint(name).id]): name for name in structure.joints
        }
        self.joints = {int(model.body_weldid[model.body(mj_base).id]): ""} | joint_by_body
        self._first_link_by_joint = {"": base}
        joint_names = {index: name for name, index in structure.joints.items()}
        for name, index in sorted(structure.links.items(), key=lambda link: link[1]):
            joint = joint_names.get(int(self._frames[index].parentJoint))
            if joint is not None:
                self._first_link_by_joint.setdefault(joint, name)

    def link(self, body: str, moving: int) -> tuple[str, pin.SE3]:
        """Return the URDF link of a body, and its world pose at zero joint positions.

        The link moves with ``moving``, the id of the moving body to which the body is fixed, and
        has the name of the body if possible.
        """
        first_link = self._first_link_by_joint[self.joints[moving]]
        joint = self._frames[self._links[first_link]].parentJoint
        has_own_link = body in self._links and self._frames[self._links[body]].parentJoint == joint
        link = body if has_own_link else first_link
        return link, self._data.oMf[self._links[link]]


def may_touch(model: mujoco.MjModel, geom: int, ground: int | None) -> bool:
    """Return True if contact bits, pairs and exclusions let MuJoCo check two geoms for contact.

    MuJoCo's filter of parent and child bodies is ignored.

    Args:
        model: MuJoCo model.
        geom: Id of a geom.
        ground: Id of the other geom, for example the floor; None for a plane of the world with
            MuJoCo's default bits.
    """
    if ground is None:
        do_bits_match = bool((model.geom_contype[geom] | model.geom_conaffinity[geom]) & 1)
        return do_bits_match and frozenset((int(model.geom_bodyid[geom]), 0)) not in excluded_pairs(
            model
        )
    for first, second in zip(model.pair_geom1.tolist(), model.pair_geom2.tolist(), strict=True):
        if {first, second} == {geom, ground}:
            return True
    contype, conaffinity = model.geom_contype, model.geom_conaffinity
    do_bits_match = (contype[geom] & conaffinity[ground]) or (contype[ground] & conaffinity[geom])
    bodies = frozenset(model.geom_bodyid[[geom, ground]].tolist())
    return bool(do_bits_match) and bodies not in excluded_pairs(model)


def excluded_pairs(model: mujoco.MjModel) -> set[frozenset[int]]:
    """Return the pairs of body ids whose contacts an ``<exclude>`` of the MJCF disables."""
    return {
        frozenset((int(signature) >> 16, int(signature) & 0xFFFF))
        for signature in model.exclude_signature
    }
