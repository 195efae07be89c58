"""Actuators of hinge and slide joints in an MJCF: transmission, force law and type.

Input is a compiled MuJoCo model. The force law of an actuator is F = gain ctrl - stiffness l -
damping dl/dt, with the length l = gear q. `classify_joint_drive` determines the type of a joint's
actuator from these laws, for example servo, motor, velocity servo or no actuator.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from enum import StrEnum

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.units import DAMPING_UNIT, STIFFNESS_UNIT
from pupper_analysis.models.mjcf import JointKind

_JOINT_TRANSMISSIONS = (mujoco.mjtTrn.mjTRN_JOINT.value, mujoco.mjtTrn.mjTRN_JOINTINPARENT.value)
"""MuJoCo's transmission types (``actuator_trntype``) of actuators that act on a single joint."""

_SCALAR_JOINT_KINDS = (int(JointKind.HINGE), int(JointKind.SLIDE))
"""Types of joints with a single coordinate."""


def is_at_one_joint(model: mujoco.MjModel, actuator: int) -> bool:
    """Return True if an actuator acts directly on a single hinge or slide."""
    if model.actuator_trntype[actuator] not in _JOINT_TRANSMISSIONS:
        return False
    return int(model.jnt_type[model.actuator_trnid[actuator, 0]]) in _SCALAR_JOINT_KINDS


def list_actuator_targets(model: mujoco.MjModel, actuator: int) -> tuple[mujoco.mjtObj, list[int]]:
    """Return the object type and the ids of the targets of an actuator.

    Returns:
        Object type, such as mjOBJ_JOINT; two ids of this type. The second id is -1 if the
        transmission has a single target.
    """
    kind = mujoco.mjtTrn(int(model.actuator_trntype[actuator])).name.removeprefix("mjTRN_")
    type_name = {"JOINTINPARENT": "JOINT", "SLIDERCRANK": "SITE", "SO3": "SITE"}.get(kind, kind)
    return getattr(mujoco.mjtObj, f"mjOBJ_{type_name}"), model.actuator_trnid[actuator].tolist()


def actuator_gear(model: mujoco.MjModel, actuator: int) -> Array:
    """Return the gear of an actuator: the transmission ratio of its first output.

    Returns:
        Shape (1,) for an actuator at a single hinge or slide, otherwise (6,).
    """
    gear = np.array(model.actuator_gear[int(model.actuator_outadr[actuator])])
    return gear[:1] if is_at_one_joint(model, actuator) else gear


def read_gears(model: mujoco.MjModel, actuators: NDArray[np.integer]) -> Array:
    """Return the gear of the first output of each actuator, shape (n,).

    ``actuator_gear`` of MuJoCo has a row per output; an actuator may have several outputs.

    Args:
        model: MuJoCo model.
        actuators: Actuator ids, shape (n,), each at a single joint.
    """
    return np.array(model.actuator_gear[model.actuator_outadr[actuators], 0])


def list_joint_actuators(model: mujoco.MjModel, joint: int) -> list[int]:
    """Return the ids of the actuators that act directly on a hinge or slide.

    The ids are rows of the arrays ``actuator_`` with ``model.nactuator`` rows, not indices of
    ``ctrl``, because an actuator may have several controls.
    """
    candidates = np.flatnonzero(model.actuator_trnid[:, 0] == joint).tolist()
    return [actuator for actuator in candidates if is_at_one_joint(model, actuator)]


def group_actuators_by_joint(model: mujoco.MjModel) -> dict[int, list[int]]:
    """Return {joint id: ids of its actuators} for the hinges and slides with a direct actuator."""
    actuators_by_joint: dict[int, list[int]] = {}
    for actuator, joint in enumerate(model.actuator_trnid[:, 0].tolist()):
        if is_at_one_joint(model, actuator):
            actuators_by_joint.setdefault(joint, []).append(actuator)
    return actuators_by_joint


def tendon_actuators(model: mujoco.MjModel, joint: int) -> list[int]:
    """Return the ids of actuators at tendons whose length depends on the position of a joint.

    `list_tendon_joints` determines the dependence.
    """
    return [actuator for actuator, joints in list_tendon_joints(model).items() if joint in joints]


def list_tendon_joints(model: mujoco.MjModel) -> dict[int, set[int]]:
    """Find the joints on whose positions the lengths of tendons with actuators depend.

    The joints of a fixed tendon have a nonzero coefficient; the joints of a spatial tendon move
    some, but not all points of a branch of its path.

    Returns:
        {id of an actuator at a tendon: ids of the joints}. No joints are listed for a gear of zero,
        and for a spatial tendon that depends on a free joint or a ball joint.
    """
    found = {actuator: set(levers) for actuator, levers in fixed_tendon_levers(model).items()}
    for actuator in found:
        if actuator_gear(model, actuator)[0] == 0:
            continue
        for bodies in _list_branches(model, int(model.actuator_trnid[actuator, 0])):
            chains = [_list_ancestors(model, body) for body in bodies]
            shared = chains[0].intersection(*chains[1:])
            between = chains[0].union(*chains[1:]) - shared
            moving = {
                joint for joint in range(model.njnt) if int(model.jnt_bodyid[joint]) in between
            }
            found[actuator] |= moving
        if any(model.jnt_type[joint] not in _SCALAR_JOINT_KINDS for joint in found[actuator]):
            found[actuator] = set()
    return found


def _list_branches(model: mujoco.MjModel, tendon: int) -> list[list[int]]:
    """Return the body ids along each branch of a spatial tendon; a pulley starts a new branch."""
    branches: list[list[int]] = [[]]
    first = int(model.tendon_adr[tendon])
    for wrap in range(first, first + int(model.tendon_num[tendon])):
        kind, target = int(model.wrap_type[wrap]), int(model.wrap_objid[wrap])
        if kind == mujoco.mjtWrap.mjWRAP_PULLEY:
            branches.append([])
        elif kind == mujoco.mjtWrap.mjWRAP_SITE:
            branches[-1].append(int(model.site_bodyid[target]))
        elif kind != _WRAPS_JOINT:
            branches[-1].append(int(model.geom_bodyid[target]))
    return [bodies for bodies in branches if bodies]


def _list_ancestors(model: mujoco.MjModel, body: int) -> set[int]:
    """Return the ids of a body and its ancestors, without the world."""
    found = set()
    while body:
        found.add(body)
        body = int(model.body_parentid[body])
    return found


def measure_actuator_levers(
    model: mujoco.MjModel, qpos: Array, actuators: Sequence[int]
) -> tuple[Array, Array]:
    """Compute the lengths and lever arms of actuators, for example at tendons, at a configuration.

    The torque at a joint is the force of the actuator times the lever arm d(length)/d(position).

    Args:
        model: MuJoCo model.
        qpos: Configuration, shape (model.nq,).
        actuators: Ids of n actuators.

    Returns:
        Lengths, shape (n,); lever arms at all degrees of freedom, shape (n, model.nv). Both contain
        the gear.
    """
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    for step in (
        mujoco.mj_kinematics,
        mujoco.mj_comPos,
        mujoco.mj_tendon,
        mujoco.mj_transmission,
    ):
        step(model, data)
    levers = np.zeros((model.nout, model.nv))
    mujoco.mju_sparse2dense(
        levers, data.actuator_moment, data.moment_rownnz, data.moment_rowadr, data.moment_colind
    )
    outputs = model.actuator_outadr[list(actuators)]
    return data.actuator_length[outputs], levers[outputs]


def fixed_tendon_levers(model: mujoco.MjModel) -> dict[int, dict[int, float]]:
    """Return the lever arms of the actuators at fixed tendons: gear x coefficient of the joint.

    The torque at a joint is the force of the actuator times the lever arm.

    Returns:
        {actuator id: {joint id: lever arm that is not 0}} of all actuators at tendons. For an
        actuator at a spatial tendon, the inner dictionary is empty.
    """
    levers = {}
    at_tendons = np.flatnonzero(model.actuator_trntype == mujoco.mjtTrn.mjTRN_TENDON.value)
    for actuator in at_tendons.tolist():
        tendon, gear = (
            int(model.actuator_trnid[actuator, 0]),
            float(actuator_gear(model, actuator)[0]),
        )
        first = int(model.tendon_adr[tendon])
        wraps = range(first, first + int(model.tendon_num[tendon]))
        parts = [wrap for wrap in wraps if model.wrap_type[wrap] == _WRAPS_JOINT]
        levers[actuator] = {
            int(model.wrap_objid[wrap]): gear * float(model.wrap_prm[wrap])
            for wrap in parts
            if gear * model.wrap_prm[wrap] != 0
        }
    return levers


_WRAPS_JOINT = mujoco.mjtWrap.mjWRAP_JOINT.value
"""MuJoCo's type (``wrap_type``) of the elements of a fixed tendon, which are joints."""


def list_tendon_servos(model: mujoco.MjModel, joint: int) -> list[int]:
    """Return the ids of position servos at tendons whose length depends on a joint's position."""
    return [
        actuator
        for actuator in tendon_actuators(model, joint)
        if _classify_actuator(model, actuator) is Drive.SERVO
    ]


@dataclass(frozen=True)
class ActuatorLaw:
    """Force law of an actuator: F = gain ctrl - stiffness l - damping dl/dt.

    The length l is the gear times the position of the joint, or times the length of the tendon, at
    which the actuator acts. The joint torque, or tendon force, is F times the gear. A constant bias
    is left out.

    Attributes:
        gain: Force per unit of ctrl, before the gear: kp (N m/rad or N/m) of a position servo,
            torque or force (N m or N) of a motor at ctrl = 1.
        stiffness: Stiffness (N m/rad or N/m); 0 for a motor.
        damping: Damping (N m s/rad or N s/m).
        gear: Gear ratio.
    """

    gain: float
    stiffness: float
    damping: float
    gear: float

    @property
    def joint_gains(self) -> tuple[float, float]:
        """Stiffness and damping of the actuator at its joint or tendon: both times gear^2.

        Units: N m/rad and N m s/rad for a hinge, N/m and N s/m for a slide.
        """
        return self.stiffness * self.gear**2, self.damping * self.gear**2


def read_actuator_law(model: mujoco.MjModel, actuator: int) -> ActuatorLaw:
    """Read the force law of an actuator with fixed gain.

    Without affine bias, stiffness and damping are 0.
    """
    gain = float(model.actuator_gainprm[actuator, 0])
    affine = model.actuator_biastype[actuator] == mujoco.mjtBias.mjBIAS_AFFINE.value
    stiffness, damping = -model.actuator_biasprm[actuator, 1:3] if affine else (0.0, 0.0)
    gear = float(actuator_gear(model, actuator)[0])
    return ActuatorLaw(gain, float(stiffness), float(damping), gear)


_GAIN_RTOL = 1e-5
"""Relative tolerance with which a position servo has equal gain and stiffness, and a velocity servo
equal gain and damping [1]. The default of ``numpy.isclose``."""


class Drive(StrEnum):
    """Type of the actuator of a joint in the published MJCF."""

    SERVO = "position servo"
    MOTOR = "torque motor"
    NONE = "no actuator"
    WRONG_SIGN = "a servo whose stiffness is negative"
    NO_STIFFNESS = "a servo without stiffness"
    NO_GEAR = "an actuator with gear 0"
    VELOCITY = "velocity servo"
    TENDON = "an actuator at a tendon"
    FORCE = "an actuator that holds no position"
    OTHER = "an actuator with another control law"

    @property
    def has_invalid_stiffness(self) -> bool:
        """Whether gain and stiffness, or the gear, are zero, or the sign of one is wrong."""
        return self in (Drive.WRONG_SIGN, Drive.NO_STIFFNESS, Drive.NO_GEAR)

    @property
    def has_other_law(self) -> bool:
        """Whether the type of the actuator is ``FORCE`` or ``OTHER``.

        The force of a ``FORCE`` actuator does not depend on the joint position (for example a DC
        motor without a position gain).
        """
        return self in (Drive.FORCE, Drive.OTHER)


@dataclass(frozen=True)
class MadeServo:
    """Servo that this package adds to a joint, because the MJCF has no such servo.

    Attributes:
        joint: Joint of the servo.
        kp: Stiffness (N m/rad or N/m).
        kd: Damping (N m s/rad or N s/m).
        instead_of: Type of the actuator of the joint in the MJCF.
    """

    joint: str
    kp: float = field(metadata={"unit": STIFFNESS_UNIT})
    kd: float = field(metadata={"unit": DAMPING_UNIT})
    instead_of: Drive


def classify_joint_drive(model: mujoco.MjModel, joint: int) -> Drive:
    """Return the type of the actuator at a hinge or slide.

    Several actuators have the type that is first in ``_TYPE_PRIORITY``; if an actuator is
    ``WRONG_SIGN``, the sign of the summed stiffness decides. Without an actuator, the type is
    ``TENDON`` or ``NONE``.

    Args:
        model: Unmodified model of the MJCF.
        joint: Id of the joint.
    """
    motors = list_joint_actuators(model, joint)
    if not motors:
        return Drive.TENDON if tendon_actuators(model, joint) else Drive.NONE
    kinds = [_classify_actuator(model, motor) for motor in motors]
    if len(motors) == 1:
        return kinds[0]
    if Drive.WRONG_SIGN in kinds:
        stiffness = sum(read_actuator_law(model, motor).joint_gains[0] for motor in motors)
        return Drive.SERVO if stiffness > 0 else Drive.WRONG_SIGN
    return next((kind for kind in _TYPE_PRIORITY if kind in kinds), Drive.OTHER)


def list_play_joints(model: mujoco.MjModel) -> list[int]:
    """Return the ids of the hinges that model the play (backlash) of a gear.

    Such a hinge has no actuator, and the axis and position of a driven hinge on the same body.
    """
    hinges = np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE).tolist()
    is_driven = {hinge: classify_joint_drive(model, hinge) is not Drive.NONE for hinge in hinges}

    def is_coaxial(first: int, second: int) -> bool:
        return bool(
            model.jnt_bodyid[first] == model.jnt_bodyid[second]
            and np.allclose(model.jnt_pos[first], model.jnt_pos[second])
            and np.allclose(np.cross(model.jnt_axis[first], model.jnt_axis[second]), 0.0)
        )

    return [
        hinge
        for hinge in hinges
        if not is_driven[hinge]
        and any(
            is_driven[driven_hinge] and is_coaxial(hinge, driven_hinge) for driven_hinge in hinges
        )
    ]


def list_falling_base_joints(model: mujoco.MjModel, added: Collection[str] = ()) -> list[int]:
    """Return the ids of the undriven joints of a base that falls along one of these joints.

    Planar robots, such as a hopper, have slides and a hinge between the world and the torso. The
    base falls along a slide without actuator, range and spring, whose axis at ``qpos0`` is not
    perpendicular to gravity. The first body in the world with such a slide is the base. The result
    is empty without such a body, or if no joint has an actuator in the file.

    Args:
        model: Model.
        added: Names of the joints whose actuators are not in the file.
    """

    def is_driven(joint: int) -> bool:
        name = model.joint(joint).name
        return name not in added and classify_joint_drive(model, joint) is not Drive.NONE

    if not any(map(is_driven, range(model.njnt))):
        return []
    for body in np.flatnonzero(model.body_parentid == 0)[1:].tolist():
        first = int(model.body_jntadr[body])
        joints = [*range(first, first + int(model.body_jntnum[body]))]
        for joint in joints:
            axis = np.zeros(3)
            mujoco.mju_rotVecQuat(axis, model.jnt_axis[joint], model.body_quat[body])
            if (
                model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE
                and not (model.jnt_limited[joint] or np.any(model.jnt_stiffness[joint]))
                and abs(axis @ model.opt.gravity) > _MIN_GRAVITY
                and not is_driven(joint)
            ):
                return [joint for joint in joints if not is_driven(joint)]
    return []


_MIN_GRAVITY = 1e-6
"""Bound of the acceleration of gravity along a slide [m/s^2], above which a base falls. Chosen, not
tuned: above rounding of an inclined axis."""

_TYPE_PRIORITY = (
    Drive.SERVO, Drive.MOTOR, Drive.VELOCITY, Drive.OTHER, Drive.FORCE, Drive.NO_STIFFNESS,
    Drive.NO_GEAR,
)  # fmt: skip
"""Types of actuators by descending priority, for a joint with actuators of different types."""


def _classify_actuator(model: mujoco.MjModel, motor: int) -> Drive:
    """Return the type of an actuator at a hinge, slide or tendon, from its force law."""
    if model.actuator_biastype[motor] == mujoco.mjtBias.mjBIAS_DCMOTOR.value:
        at_joint = is_at_one_joint(model, motor)
        return Drive.FORCE if at_joint and not _depends_on_position(model, motor) else Drive.OTHER
    if model.actuator_gaintype[motor] != mujoco.mjtGain.mjGAIN_FIXED.value:
        return Drive.OTHER
    if model.actuator_biastype[motor] not in (
        mujoco.mjtBias.mjBIAS_NONE.value,
        mujoco.mjtBias.mjBIAS_AFFINE.value,
    ):
        return Drive.OTHER
    law = read_actuator_law(model, motor)
    if law.gear == 0:
        return Drive.NO_GEAR
    stiffness, gain = law.joint_gains[0], law.gain * law.gear**2
    if stiffness < 0 or (stiffness > 0 and gain < 0):
        return Drive.WRONG_SIGN
    if stiffness > 0:
        is_equal = abs(gain - stiffness) <= _GAIN_RTOL * stiffness
        return Drive.SERVO if is_equal else Drive.OTHER
    if gain == 0:
        return Drive.NO_STIFFNESS
    if law.damping > 0 and abs(law.gain - law.damping) <= _GAIN_RTOL * law.damping:
        return Drive.VELOCITY
    # An actuator with affine bias is no motor, even if all numbers of the bias are zero.
    affine = model.actuator_biastype[motor] == mujoco.mjtBias.mjBIAS_AFFINE.value
    return Drive.OTHER if affine or model.actuator_biasprm[motor, :3].any() else Drive.MOTOR


_POSITION_STEP = 0.1
"""Change of the joint position [rad, m] by which ``_depends_on_position`` compares forces. Chosen,
not tuned: a position gain of any use gives a force at this step that rounding does not hide."""


def _depends_on_position(model: mujoco.MjModel, motor: int) -> bool:
    """Return True if an actuator's force at zero control differs between two joint positions."""
    data = mujoco.MjData(model)
    address = int(model.jnt_qposadr[model.actuator_trnid[motor, 0]])
    start, forces = float(data.qpos[address]), []
    for position in (start, start + _POSITION_STEP):
        data.qpos[address] = position
        mujoco.mj_forward(model, data)
        forces.append(float(data.actuator_force[model.actuator_outadr[motor]]))
    return forces[0] != forces[1]
