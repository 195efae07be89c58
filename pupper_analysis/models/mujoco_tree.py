"""The parameters of a tree of joints as a MuJoCo model, whose numbers can be changed in place."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TypeVar

import mujoco
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.models.attributes import JOINT_ATTRIBUTES
from pupper_analysis.models.mjcf import JointKind
from pupper_analysis.models.multibody import MultibodyTree, TreeBody, TreeJoint

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
    """

    def __init__(self, parameters: MultibodyTree) -> None:
        """Compiles the model, and gives it the numbers."""
        self.model = _compiled(parameters)
        self._structure = _structure(parameters)
        self._base = int(self.model.body(parameters.base).id)
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


def _compiled(parameters: MultibodyTree) -> mujoco.MjModel:
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    bodies = {parameters.base: spec.worldbody.add_body(name=parameters.base)}
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
    model.body_iquat[ids] = [_quaternion(rotation) for rotation in axes]
    total = np.array(model.body_mass)
    for body in range(model.nbody - 1, 0, -1):  # children have higher numbers
        total[model.body_parentid[body]] += total[body]
    model.body_subtreemass[:] = total


def _take_joints(model: mujoco.MjModel, ids: Sequence[int], joints: Sequence[TreeJoint]) -> None:
    bodies, dofs = model.jnt_bodyid[ids], model.jnt_dofadr[ids]
    model.body_pos[bodies] = [joint.position for joint in joints]
    model.body_quat[bodies] = [_quaternion(joint.rotation) for joint in joints]
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


def _quaternion(rotation: Array) -> Array:
    x, y, z, w = pin.Quaternion(rotation).coeffs()
    return np.array([w, x, y, z])
