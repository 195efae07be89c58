"""Each model in the other engine: the MJCF's model in Pinocchio, the URDF's in MuJoCo.

Pinocchio has an MJCF parser and MuJoCo a URDF importer. The former (3.8) drops masses given in
default classes, friction loss and force ranges, so the compiled MuJoCo model is rebuilt joint by
joint here; the latter, left to itself, welds the base to the world and drops its mass, so static
bodies are kept apart and the base is given a free joint. A tree's parameters in MuJoCo can be
changed in place.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeVar

import mujoco
import numpy as np
import pinocchio as pin
from lxml import etree
from numpy.typing import NDArray

from pupper_analysis.base.arrays import (
    inertia_of,
    placement_of,
    quaternion_from_rotation,
    rotation_from_quaternion,
)
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ModelError
from pupper_analysis.models.attributes import JOINT_ATTRIBUTES
from pupper_analysis.models.efforts import effort_limit
from pupper_analysis.models.mjcf import JointKind
from pupper_analysis.models.multibody import MultibodyTree, TreeBody, TreeJoint
from pupper_analysis.models.places import one_line
from pupper_analysis.models.transmission import actuator_gear, is_at_one_joint
from pupper_analysis.models.urdf_tree import UrdfTree
from pupper_analysis.models.xml import parse_text, to_text

Array = NDArray[np.float64]

_T = TypeVar("_T")

_FREE = "__free__"


class MujocoTree:
    """A MuJoCo model of a robot's parameters.

    It is compiled once per structure (parents and kinds of joints); other numbers are written into
    it. Its joints have the names of the parameters', its base the base's, and each frame is a site.
    Nothing acts but gravity, damping and what is applied: no limits, friction or contacts.

    Attributes:
        model: The model.
        base: The name of its base: the parameters', unless that is ``world``, which MuJoCo has.
    """

    def __init__(self, parameters: MultibodyTree) -> None:
        """Compiles the model, and gives it the numbers."""
        self.base = "__world__" if parameters.base == "world" else parameters.base
        self.model = _compiled(parameters, self.base)
        self._structure = _structure(parameters)
        self._base = int(self.model.body(self.base).id)
        self._joints = {name: self.model.joint(name).id for name in parameters.joints}
        self._bodies = {name: int(self.model.jnt_bodyid[j]) for name, j in self._joints.items()}
        self._bodies[parameters.base] = self._base
        self._taken = replace(parameters, bodies={}, joints={})
        self.take(parameters)

    def fits(self, parameters: MultibodyTree) -> bool:
        """Says whether other parameters have this structure."""
        return self._structure == _structure(parameters)

    def take(self, parameters: MultibodyTree) -> None:
        """Gives the model the numbers of other parameters of its structure."""
        model, before = self.model, self._taken
        bodies = _new(parameters.bodies, before.bodies)
        if bodies:
            _take_bodies(model, [self._bodies[name] for name in bodies], list(bodies.values()))
        joints = _new(parameters.joints, before.joints)
        if joints:
            _take_joints(model, [self._joints[name] for name in joints], list(joints.values()))
        self._taken = parameters
        if parameters.floating:
            model.dof_armature[:6] = parameters.base_armature
            model.dof_damping[:6] = parameters.base_damping
        model.opt.gravity = parameters.gravity
        for name, (_, position) in parameters.frames.items():
            site = model.site(name).id
            model.site_pos[site] = position


def _new(values: Mapping[str, _T], before: Mapping[str, _T]) -> dict[str, _T]:
    """Returns what is another object than before: most trees differ from the last in one number."""
    return {name: value for name, value in values.items() if value is not before.get(name)}


def _structure(parameters: MultibodyTree) -> tuple[object, ...]:
    joints = tuple((name, joint.parent, joint.slides) for name, joint in parameters.joints.items())
    frames = tuple((name, owner) for name, (owner, _) in parameters.frames.items())
    return parameters.base, parameters.floating, joints, tuple(parameters.bodies), frames


def _compiled(parameters: MultibodyTree, base: str) -> mujoco.MjModel:
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    bodies = {parameters.base: spec.worldbody.add_body(name=base)}
    if parameters.floating:
        bodies[parameters.base].add_freejoint(name=_FREE)
    kinds = {True: JointKind.SLIDE, False: JointKind.HINGE}
    for name in parameters.parents_first():
        joint = parameters.joints[name]
        bodies[name] = bodies[joint.parent].add_body()
        bodies[name].add_joint(name=name, type=kinds[joint.slides], axis=[0.0, 0.0, 1.0])
    for body in bodies.values():
        # Of general inertia: MuJoCo leaves out what is zero in the model that it compiles.
        body.explicitinertial = True
        body.mass, body.inertia = 1.0, [1.0, 1.1, 1.2]
        body.ipos, body.iquat = [0.1, 0.2, 0.3], [0.8, 0.2, 0.4, 0.4]
    for name, (owner, position) in parameters.frames.items():
        bodies[owner].add_site(name=name, pos=position + 1.0)  # as above
    spec.option.disableflags = mujoco.mjtDisableBit.mjDSBL_CONSTRAINT.value
    return spec.compile()


def _take_bodies(model: mujoco.MjModel, ids: Sequence[int], bodies: Sequence[TreeBody]) -> None:
    # Of tensors that no body has, too: a file may state them.
    moments, axes = np.linalg.eigh(np.array([body.inertia for body in bodies]))
    axes[..., 0] *= np.sign(np.linalg.det(axes))[:, None]
    model.body_mass[ids] = [body.mass for body in bodies]
    model.body_ipos[ids] = [body.com for body in bodies]
    model.body_inertia[ids] = moments
    model.body_iquat[ids] = [quaternion_from_rotation(rotation) for rotation in axes]
    total = np.array(model.body_mass)
    for body in range(model.nbody - 1, 0, -1):  # children have higher numbers
        total[model.body_parentid[body]] += total[body]
    model.body_subtreemass[:] = total


def _take_joints(model: mujoco.MjModel, ids: Sequence[int], joints: Sequence[TreeJoint]) -> None:
    bodies, dofs = model.jnt_bodyid[ids], model.jnt_dofadr[ids]
    model.body_pos[bodies] = [joint.position for joint in joints]
    model.body_quat[bodies] = [quaternion_from_rotation(joint.rotation) for joint in joints]
    model.jnt_axis[ids] = [joint.axis for joint in joints]
    ends = np.array([(joint.lower, joint.upper) for joint in joints])
    model.jnt_limited[ids] = np.isfinite(ends).all(axis=1)
    model.jnt_range[ids] = np.where(np.isfinite(ends), ends, 0.0)
    efforts = np.array([joint.effort for joint in joints])
    model.jnt_actfrclimited[ids] = np.isfinite(efforts)
    efforts = np.where(np.isfinite(efforts), efforts, 0.0)
    model.jnt_actfrcrange[ids] = np.stack([-efforts, efforts], axis=1)
    for one in JOINT_ATTRIBUTES:
        if one.mujoco:
            getattr(model, one.mujoco)[dofs] = [getattr(joint, one.field) for joint in joints]


def pinocchio_from_urdf(text: str, source: Path, *, floating: bool) -> pin.Model:
    """Builds the model of a URDF's text, its base free or fixed.

    Its shapes have no effect, and are left out: the reader complains of what it does not know.

    Raises:
        ModelError: If Pinocchio cannot read it; the message names the source.
    """
    tree = UrdfTree.of(text)
    tree.remove_shapes()
    base = (pin.JointModelFreeFlyer(),) if floating else ()
    try:
        return pin.buildModelFromXML(to_text(tree.root), *base)
    except (ValueError, RuntimeError) as error:
        raise ModelError(source, diagnose("urdf-not-valid", message=one_line(error))) from error


def pinocchio_from_mujoco(model: mujoco.MjModel) -> pin.Model:
    """Rebuilds a compiled MuJoCo model in Pinocchio.

    Bodies and sites become frames (of type BODY). Gravity, armature and damping as they act (see
    `gravity`, `joint_armature`, `joint_damping`), friction loss, joint limits and the force limits
    of the motors are taken over. What else acts (springs, tendons ...) is not: see `extras`.

    Args:
        model: A model with free, hinge and slide joints.

    Raises:
        ModelError: If it has a ball joint.
    """
    result = pin.Model()
    result.gravity = pin.Motion(acting_gravity(model), np.zeros(3))
    joint_of = {0: 0}  # the joint that moves each body, and the body's placement in its frame
    inside = {0: pin.SE3.Identity()}
    dofs: list[int] = []
    for body in range(1, model.nbody):
        parent = int(model.body_parentid[body])
        joint = joint_of[parent]
        own = placement_of(model.body_quat[body], model.body_pos[body])
        placement = inside[parent] * own
        first = int(model.body_jntadr[body])
        for index in range(first, first + int(model.body_jntnum[body])):
            joint, placement = _add_joint(result, model, index, joint, placement)
            start = int(model.jnt_dofadr[index])
            dofs += range(start, start + result.joints[joint].nv)
        result.appendBodyToJoint(joint, inertia_of_body(model, body), placement)
        joint_of[body], inside[body] = joint, placement
        _add_frame(result, model.body(body).name, joint, placement)
    for site in range(model.nsite):
        body = int(model.site_bodyid[site])
        local = placement_of(model.site_quat[site], model.site_pos[site])
        _add_frame(result, model.site(site).name, joint_of[body], inside[body] * local)
    result.armature = joint_armature(model)[dofs]
    result.damping = joint_damping(model)[dofs]
    result.friction = np.array(model.dof_frictionloss[dofs])
    return result


def inertia_of_body(model: mujoco.MjModel, body: int) -> pin.Inertia:
    """Returns what one of MuJoCo's bodies weighs, in its own frame."""
    axes = rotation_from_quaternion(model.body_iquat[body])
    tensor = axes @ np.diag(model.body_inertia[body]) @ axes.T
    return inertia_of(model.body_mass[body], model.body_ipos[body], tensor)


def acting_gravity(model: mujoco.MjModel) -> Array:
    """Returns the acceleration of gravity (3,) that acts in a model (m/s^2): 0 if switched off."""
    off = model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_GRAVITY.value
    return np.zeros(3) if off else np.array(model.opt.gravity)


def joint_armature(model: mujoco.MjModel) -> Array:
    """Returns the armature (nv,) that acts at each degree of freedom (kg m^2, kg).

    The joint's, and those of the actuators at it, times their gears squared.
    """
    return np.array(model.dof_armature) + _of_actuators(model, model.actuator_armature)


def joint_damping(model: mujoco.MjModel) -> Array:
    """Returns the linear damping (nv,) that acts at each degree of freedom (N m s/rad, N s/m).

    The joint's, and those of the actuators at it, times their gears squared; 0 if switched off.
    """
    if model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_DAMPER.value:
        return np.zeros(model.nv)
    return np.array(model.dof_damping) + _of_actuators(model, model.actuator_damping)


def _of_actuators(model: mujoco.MjModel, values: Array) -> Array:
    total = np.zeros(model.nv)
    for actuator in range(model.nactuator):
        if values[actuator] and is_at_one_joint(model, actuator):
            dof = int(model.jnt_dofadr[model.actuator_trnid[actuator, 0]])
            total[dof] += float(actuator_gear(model, actuator)[0]) ** 2 * float(values[actuator])
    return total


def _add_joint(
    result: pin.Model, model: mujoco.MjModel, index: int, parent: int, placement: pin.SE3
) -> tuple[int, pin.SE3]:
    """Adds a joint; returns it, with the placement of the body's frame in the joint's."""
    name = model.joint(index).name
    kind = JointKind(int(model.jnt_type[index]))
    if kind == JointKind.FREE:
        # qpos holds the body's pose in the world, whatever the body's rest pose.
        return result.addJoint(parent, pin.JointModelFreeFlyer(), pin.SE3.Identity(), name), (
            pin.SE3.Identity()
        )
    if kind == JointKind.BALL:
        raise ModelError(name, diagnose("ball-joint-not-analysed"))
    hinge = kind == JointKind.HINGE
    motion = pin.JointModelRevoluteUnaligned if hinge else pin.JointModelPrismaticUnaligned
    at_zero, within = places_of_joint(model, index)
    limited = bool(model.jnt_limited[index])
    lower, upper = model.jnt_range[index] if limited else (-np.inf, np.inf)
    joint = result.addJoint(
        parent,
        motion(np.array(model.jnt_axis[index])),
        placement * at_zero,
        name,
        np.array([effort_limit(model, index)]),
        np.array([np.inf]),
        np.array([lower]),
        np.array([upper]),
    )
    return joint, within


def places_of_joint(model: mujoco.MjModel, joint: int) -> tuple[pin.SE3, pin.SE3]:
    """Returns where a hinge or slide is in its body's frame, at zero, and that frame in its own."""
    axis, anchor = np.array(model.jnt_axis[joint]), np.array(model.jnt_pos[joint])
    back = -float(model.qpos0[model.jnt_qposadr[joint]]) * axis
    if int(model.jnt_type[joint]) == JointKind.HINGE:
        at_zero = pin.SE3(pin.exp3(back), anchor)
    else:
        at_zero = pin.SE3(np.eye(3), anchor + back)
    return at_zero, pin.SE3(np.eye(3), -anchor)


def _add_frame(result: pin.Model, name: str, joint: int, placement: pin.SE3) -> None:
    if name and not result.existFrame(name, pin.FrameType.BODY):
        result.addFrame(pin.Frame(name, joint, 0, placement, pin.FrameType.BODY), False)


@dataclass(frozen=True)
class UrdfImport:
    """A URDF for MuJoCo's own importer, each link with the mass that it states.

    Attributes:
        path: Where it came from, for messages.
        text: Its XML, whose meshes have absolute paths or are ``assets``.
        assets: {name: content} of meshes.
    """

    path: Path
    text: str = field(repr=False)
    assets: Mapping[str, bytes] = field(default_factory=dict, repr=False)

    def spec(self) -> mujoco.MjSpec:
        """Lets MuJoCo import it; compiled as it is, it has a body for each link.

        Raises:
            ModelError: If MuJoCo refuses it.
        """
        root = parse_text(self.text)
        for own in root.findall("mujoco"):  # MuJoCo takes one such block; its own is for loading
            root.remove(own)
        off = ("fusestatic", "balanceinertia", "discardvisual", "strippath", "inertiafromgeom")
        etree.SubElement(etree.SubElement(root, "mujoco"), "compiler", dict.fromkeys(off, "false"))
        try:
            return mujoco.MjSpec.from_string(to_text(root), assets=dict(self.assets))
        except (ValueError, RuntimeError) as error:
            problem = diagnose("urdf-not-imported", message=one_line(error))
            raise ModelError(self.path, problem) from error
