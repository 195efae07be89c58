"""Conversion of models between the engines: MJCF to Pinocchio, URDF to MuJoCo.

Pinocchio's MJCF parser (3.8) ignores masses in default classes, friction loss and force ranges.
Therefore ``pinocchio_from_mujoco`` rebuilds the compiled MuJoCo model joint by joint. By default,
MuJoCo's URDF importer welds the base to the world and drops the mass of the base. Therefore
``UrdfImport`` keeps static bodies. ``MujocoTree`` is a MuJoCo model whose parameters can be changed
in place.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeVar

import mujoco
import numpy as np
import pinocchio as pin
from lxml import etree

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.arrays import (
    make_inertia,
    make_placement,
    quaternion_from_rotation,
    rotation_from_quaternion,
)
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ModelError
from pupper_analysis.models.attributes import JOINT_ATTRIBUTES
from pupper_analysis.models.efforts import find_effort
from pupper_analysis.models.mjcf import JointKind, compile_spec
from pupper_analysis.models.multibody import MultibodyTree, TreeBody, TreeJoint
from pupper_analysis.models.places import one_line
from pupper_analysis.models.transmission import actuator_gear, is_at_one_joint
from pupper_analysis.models.urdf_tree import UrdfTree
from pupper_analysis.models.xml import parse_text, to_text

_T = TypeVar("_T")
"""Type of the values of a mapping."""

_FREE_JOINT_NAME = "__free__"
"""Name of the free joint of a model with a free base."""


class MujocoTree:
    """MuJoCo model of a multibody tree, whose parameters can be changed without compiling.

    The model is compiled for a structure (names, parents and types of joints). The other
    parameters, except velocity limits, are written into the model. Joints have the names of the
    tree; each frame is a site. Gravity, damping and applied forces act; joint limits, friction and
    contacts do not act.

    Attributes:
        model: MuJoCo model.
        base: Name of the base body: the name in the tree, or another name if that is the reserved
            name ``world``.
    """

    def __init__(self, parameters: MultibodyTree) -> None:
        """Compile a model with the structure of a multibody tree, and copy its parameters."""
        self.base = "__world__" if parameters.base == "world" else parameters.base
        self.model = _compile_structure(parameters, self.base)
        self._structure = _make_structure_key(parameters)
        self._base = int(self.model.body(self.base).id)
        self._joints = {name: self.model.joint(name).id for name in parameters.joints}
        self._bodies = {name: int(self.model.jnt_bodyid[j]) for name, j in self._joints.items()}
        self._bodies[parameters.base] = self._base
        self._last_parameters = replace(parameters, bodies={}, joints={})
        self.copy_parameters(parameters)

    def has_structure_of(self, parameters: MultibodyTree) -> bool:
        """Return True if a tree has the structure of this model, as `copy_parameters` requires."""
        return self._structure == _make_structure_key(parameters)

    def copy_parameters(self, parameters: MultibodyTree) -> None:
        """Copy the parameters of a tree, such as masses and axes, into the model, in place.

        Velocity limits are not copied, because MuJoCo's joints have none. Unchanged objects are
        skipped: bodies and joints must not be modified between calls.

        Args:
            parameters: Tree with the same structure (``has_structure_of``).
        """
        model, previous = self.model, self._last_parameters
        bodies = _select_changed(parameters.bodies, previous.bodies)
        if bodies:
            _set_bodies(model, [self._bodies[name] for name in bodies], list(bodies.values()))
        joints = _select_changed(parameters.joints, previous.joints)
        if joints:
            _set_joints(model, [self._joints[name] for name in joints], list(joints.values()))
        self._last_parameters = parameters
        if parameters.floating:
            model.dof_armature[:6] = parameters.base_armature
            model.dof_damping[:6] = parameters.base_damping
        model.opt.gravity = parameters.gravity
        for name, (_, position) in parameters.frames.items():
            site = model.site(name).id
            model.site_pos[site] = position


def _select_changed(values: Mapping[str, _T], previous: Mapping[str, _T]) -> dict[str, _T]:
    """Return the entries of ``values`` that are not the same object (``is``) in ``previous``."""
    return {name: value for name, value in values.items() if value is not previous.get(name)}


def _make_structure_key(parameters: MultibodyTree) -> tuple[object, ...]:
    """Return a comparison key of a tree's structure: names, parents and joint types, no numbers."""
    joints = tuple((name, joint.parent, joint.slides) for name, joint in parameters.joints.items())
    frames = tuple((name, owner) for name, (owner, _) in parameters.frames.items())
    return parameters.base, parameters.floating, joints, tuple(parameters.bodies), frames


def _compile_structure(parameters: MultibodyTree, base: str) -> mujoco.MjModel:
    """Compile a MuJoCo model with the structure of a multibody tree and placeholder parameters.

    ``base`` is the name of the base body in the model.
    """
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    bodies = {parameters.base: spec.worldbody.add_body(name=base)}
    if parameters.floating:
        bodies[parameters.base].add_freejoint(name=_FREE_JOINT_NAME)
    kinds = {True: JointKind.SLIDE, False: JointKind.HINGE}
    for name in parameters.parents_first():
        joint = parameters.joints[name]
        bodies[name] = bodies[joint.parent].add_body()
        bodies[name].add_joint(name=name, type=kinds[joint.slides], axis=[0.0, 0.0, 1.0])
    for body in bodies.values():
        # Arbitrary values: MuJoCo simplifies the compiled model if values are zero.
        body.explicitinertial = True
        body.mass, body.inertia = 1.0, [1.0, 1.1, 1.2]
        body.ipos, body.iquat = [0.1, 0.2, 0.3], [0.8, 0.2, 0.4, 0.4]
    for name, (owner, _) in parameters.frames.items():
        bodies[owner].add_site(name=name, pos=[0.1, 0.2, 0.3])  # not zero, as above
    spec.option.disableflags = mujoco.mjtDisableBit.mjDSBL_CONSTRAINT.value
    return compile_spec(spec, Path(spec.modelname))


def _set_bodies(model: mujoco.MjModel, ids: Sequence[int], bodies: Sequence[TreeBody]) -> None:
    """Write masses, CoMs and inertias of bodies to a MuJoCo model; inertias may be unphysical."""
    moments, axes = np.linalg.eigh(np.array([body.inertia for body in bodies]))
    axes[..., 0] *= np.sign(np.linalg.det(axes))[:, None]
    model.body_mass[ids] = [body.mass for body in bodies]
    model.body_ipos[ids] = [body.com for body in bodies]
    model.body_inertia[ids] = moments
    model.body_iquat[ids] = [quaternion_from_rotation(rotation) for rotation in axes]
    subtree_mass = np.array(model.body_mass)
    for body in range(model.nbody - 1, 0, -1):  # children have higher ids
        subtree_mass[model.body_parentid[body]] += subtree_mass[body]
    model.body_subtreemass[:] = subtree_mass


def _set_joints(model: mujoco.MjModel, ids: Sequence[int], joints: Sequence[TreeJoint]) -> None:
    """Write poses, axes, limits, damping, friction and armature of joints to a MuJoCo model.

    ``ids`` are the joint ids of the model, in the order of ``joints``.
    """
    bodies, dofs = model.jnt_bodyid[ids], model.jnt_dofadr[ids]
    model.body_pos[bodies] = [joint.position for joint in joints]
    model.body_quat[bodies] = [quaternion_from_rotation(joint.rotation) for joint in joints]
    model.jnt_axis[ids] = [joint.axis for joint in joints]
    limits = np.array([(joint.lower, joint.upper) for joint in joints])
    model.jnt_limited[ids] = np.isfinite(limits).all(axis=1)
    model.jnt_range[ids] = np.where(np.isfinite(limits), limits, 0.0)
    efforts = np.array([joint.effort for joint in joints])
    model.jnt_actfrclimited[ids] = np.isfinite(efforts)
    efforts = np.where(np.isfinite(efforts), efforts, 0.0)
    model.jnt_actfrcrange[ids] = np.stack([-efforts, efforts], axis=1)
    for attribute in JOINT_ATTRIBUTES:
        if attribute.mujoco:
            getattr(model, attribute.mujoco)[dofs] = [
                getattr(joint, attribute.field) for joint in joints
            ]


def pinocchio_from_urdf(text: str, source: Path, *, floating: bool) -> pin.Model:
    """Build the Pinocchio model of a URDF, with free or fixed base.

    Shapes are removed, because Pinocchio's reader prints warnings about unknown elements. Infinite
    limits become the largest float, as for a free flyer in Pinocchio, because Pinocchio cannot read
    infinite values of a pickled model. Efforts and velocities of at least ``MIN_UNSTATED_LIMIT``
    mean an unknown limit.

    Args:
        text: URDF; must be well-formed XML.
        source: File, for messages.
        floating: Whether the base is free (a free flyer).

    Raises:
        ModelError: If Pinocchio cannot read the URDF.
    """
    tree = UrdfTree.of(text)
    tree.remove_shapes()
    base = (pin.JointModelFreeFlyer(),) if floating else ()
    try:
        model = pin.buildModelFromXML(to_text(tree.root), *base)
    except (ValueError, RuntimeError) as error:
        raise ModelError(source, diagnose("urdf-not-valid", message=one_line(error))) from error
    _correct_inertias(model, tree)
    for name in ("lowerPositionLimit", "upperPositionLimit", "effortLimit", "velocityLimit"):
        setattr(model, name, np.clip(getattr(model, name), -sys.float_info.max, sys.float_info.max))
    return model


def _correct_inertias(model: pin.Model, tree: UrdfTree) -> None:
    """Recompute the inertias of a Pinocchio model in place if a link has a negative mass.

    Pinocchio adds two inertias incorrectly if their total mass is negative: it divides by max(total
    mass, 2e-16 kg), measured with pin 3.8.
    """
    inertias = {name: link.inertia for name, link in tree.links.items()}
    if all(inertia is None or inertia.mass >= 0 for inertia in inertias.values()):
        return
    totals = np.zeros((model.njoints, _NUM_INERTIAL_PARAMETERS))
    for name, inertia in inertias.items():
        if inertia is not None:
            frame = model.frames[model.getFrameId(name, pin.FrameType.BODY)]
            moved = frame.placement.act(inertia)
            totals[frame.parentJoint] += moved.toDynamicParameters()
    for joint, (mass, *rest) in enumerate(totals.tolist()):
        moment, (xx, xy, yy, xz, yz, zz) = np.array(rest[:3]), rest[3:]
        com = moment / mass if mass else np.zeros(3)
        about_origin = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        steiner = mass * (float(com @ com) * np.eye(3) - np.outer(com, com))
        model.inertias[joint] = make_inertia(mass, com, about_origin - steiner)


_NUM_INERTIAL_PARAMETERS = 10
"""Number of inertial parameters of a body: mass, mass times CoM (3), inertia about the origin (6).
For bodies that are fixed to each other, these parameters are added.
"""


def pinocchio_from_mujoco(model: mujoco.MjModel) -> pin.Model:
    """Build the Pinocchio model of a compiled MuJoCo model.

    Named bodies, except the world, and named sites become frames of type BODY; a site with the name
    of a frame is left out.

    Args:
        model: Model with free, hinge and slide joints.

    Raises:
        ModelError: If the model has a ball joint.
    """
    result = pin.Model()
    result.gravity = pin.Motion(acting_gravity(model), np.zeros(3))
    # {body: joint that moves the body}, {body: placement of the body in the frame of this joint}
    joint_of = {0: 0}
    placements = {0: pin.SE3.Identity()}
    dofs: list[int] = []
    for body in range(1, model.nbody):
        parent = int(model.body_parentid[body])
        joint = joint_of[parent]
        relative = make_placement(model.body_quat[body], model.body_pos[body])
        placement = placements[parent] * relative
        first = int(model.body_jntadr[body])
        for index in range(first, first + int(model.body_jntnum[body])):
            joint, placement = _add_pinocchio_joint(result, model, index, joint, placement)
            start = int(model.jnt_dofadr[index])
            dofs += range(start, start + result.joints[joint].nv)
        result.appendBodyToJoint(joint, inertia_of_body(model, body), placement)
        joint_of[body], placements[body] = joint, placement
        _add_frame(result, model.body(body).name, joint, placement)
    for site in range(model.nsite):
        body = int(model.site_bodyid[site])
        local = make_placement(model.site_quat[site], model.site_pos[site])
        _add_frame(result, model.site(site).name, joint_of[body], placements[body] * local)
    result.armature = joint_armature(model)[dofs]
    result.damping = joint_damping(model)[dofs]
    result.friction = np.array(model.dof_frictionloss[dofs])
    return result


def inertia_of_body(model: mujoco.MjModel, body: int) -> pin.Inertia:
    """Return the spatial inertia of a MuJoCo body, in the frame of the body."""
    axes = rotation_from_quaternion(model.body_iquat[body])
    tensor = axes @ np.diag(model.body_inertia[body]) @ axes.T
    return make_inertia(model.body_mass[body], model.body_ipos[body], tensor)


def acting_gravity(model: mujoco.MjModel) -> Array:
    """Return the gravity (3,) [m/s^2] that acts in a MuJoCo model; zero if it is disabled."""
    is_disabled = model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_GRAVITY.value
    return np.zeros(3) if is_disabled else np.array(model.opt.gravity)


def joint_armature(model: mujoco.MjModel) -> Array:
    """Return the armature of each degree of freedom, shape (nv,) [kg m^2, kg].

    The value is the joint armature. For a hinge or slide, gear^2 times the armature of each
    actuator at this joint is added.
    """
    return np.array(model.dof_armature) + _sum_actuator_values(model, model.actuator_armature)


def joint_damping(model: mujoco.MjModel) -> Array:
    """Return the linear damping of each degree of freedom, shape (nv,) [N m s/rad, N s/m].

    The value is the joint damping. For a hinge or slide, gear^2 times the damping of each actuator
    at this joint is added. Zero if a flag disables damping.
    """
    if model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_DAMPER.value:
        return np.zeros(model.nv)
    return np.array(model.dof_damping) + _sum_actuator_values(model, model.actuator_damping)


def _sum_actuator_values(model: mujoco.MjModel, values: Array) -> Array:
    """Sum gear^2 x value of the actuators at each hinge and slide, shape (nv,).

    ``values`` has an entry per actuator, for example the armature.
    """
    total = np.zeros(model.nv)
    for actuator in range(model.nactuator):
        if values[actuator] and is_at_one_joint(model, actuator):
            dof = int(model.jnt_dofadr[model.actuator_trnid[actuator, 0]])
            total[dof] += float(actuator_gear(model, actuator)[0]) ** 2 * float(values[actuator])
    return total


def _add_pinocchio_joint(
    result: pin.Model, model: mujoco.MjModel, index: int, parent: int, placement: pin.SE3
) -> tuple[int, pin.SE3]:
    """Return the index of a new Pinocchio joint, and the pose of the moved body in its frame.

    ``index`` is the id of MuJoCo's free, hinge or slide joint. ``placement`` is the pose of the
    moved body in the frame of the joint ``parent``, at ``qpos0``. ``result`` is modified.
    """
    name = model.joint(index).name
    kind = JointKind(int(model.jnt_type[index]))
    if kind == JointKind.FREE:
        # qpos contains the world pose of the body, independent of the initial pose.
        return result.addJoint(parent, pin.JointModelFreeFlyer(), pin.SE3.Identity(), name), (
            pin.SE3.Identity()
        )
    if kind == JointKind.BALL:
        raise ModelError(name, diagnose("ball-joint-not-analysed"))
    hinge = kind == JointKind.HINGE
    joint_model = pin.JointModelRevoluteUnaligned if hinge else pin.JointModelPrismaticUnaligned
    at_zero, within = split_joint_placement(model, index)
    limited = bool(model.jnt_limited[index])
    lower, upper = model.jnt_range[index] if limited else (-np.inf, np.inf)
    joint = result.addJoint(
        parent,
        joint_model(np.array(model.jnt_axis[index])),
        placement * at_zero,
        name,
        np.array([find_effort(model, index)]),
        np.array([np.inf]),
        np.array([lower]),
        np.array([upper]),
    )
    return joint, within


def split_joint_placement(model: mujoco.MjModel, joint: int) -> tuple[pin.SE3, pin.SE3]:
    """Return the constant placements before and after the motion of a MuJoCo hinge or slide.

    B is the frame of the moved body, and B0 this frame at the joint position ``qpos0``. J is the
    joint frame, fixed to the body, with its origin at ``jnt_pos``. At the joint position q, the
    pose of B in B0 is ``before * M(q) * after``. M(q) is the rotation about, or the translation
    along, ``jnt_axis`` by q.

    Returns:
        Placement of J in B0 at a joint position of zero; placement of B in J at any joint position.
    """
    axis, anchor = np.array(model.jnt_axis[joint]), np.array(model.jnt_pos[joint])
    displacement = -float(model.qpos0[model.jnt_qposadr[joint]]) * axis
    if int(model.jnt_type[joint]) == JointKind.HINGE:
        at_zero = pin.SE3(pin.exp3(displacement), anchor)
    else:
        at_zero = pin.SE3(np.eye(3), anchor + displacement)
    return at_zero, pin.SE3(np.eye(3), -anchor)


def _add_frame(result: pin.Model, name: str, joint: int, placement: pin.SE3) -> None:
    """Add a frame of type BODY, placed in the joint frame; ignore empty and existing names."""
    if name and not result.existFrame(name, pin.FrameType.BODY):
        result.addFrame(pin.Frame(name, joint, 0, placement, pin.FrameType.BODY), False)


@dataclass(frozen=True)
class UrdfImport:
    """URDF for MuJoCo's own importer, with settings that keep each link and its mass.

    Attributes:
        path: Source file, for messages.
        text: XML, in which meshes have absolute paths or are ``assets``.
        assets: {name: content} of meshes.
    """

    path: Path
    text: str = field(repr=False)
    assets: Mapping[str, bytes] = field(default_factory=dict, repr=False)

    def spec(self) -> mujoco.MjSpec:
        """Import this URDF with MuJoCo's own importer, and return the spec.

        The compiled model has a body for each link; a root link ``world`` is the world body.
        Elements ``<mujoco>`` of the URDF are ignored.

        Raises:
            ModelError: If MuJoCo rejects the URDF.
        """
        root = parse_text(self.text)
        for block in root.findall("mujoco"):  # MuJoCo reads a single block; replace it
            root.remove(block)
        disabled_options = (
            "fusestatic",
            "balanceinertia",
            "discardvisual",
            "strippath",
            "inertiafromgeom",
        )
        etree.SubElement(
            etree.SubElement(root, "mujoco"), "compiler", dict.fromkeys(disabled_options, "false")
        )
        try:
            return mujoco.MjSpec.from_string(to_text(root), assets=dict(self.assets))
        except (ValueError, RuntimeError) as error:
            problem = diagnose("urdf-not-imported", message=one_line(error))
            raise ModelError(self.path, problem) from error
