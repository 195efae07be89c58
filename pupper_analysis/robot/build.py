"""Builds a robot from its two files."""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.arrays import placement_of
from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.base.errors import ConfigurationError, ModelError, UnknownNameError
from pupper_analysis.base.units import DOWN
from pupper_analysis.models import mjcf as mjcf_description
from pupper_analysis.models.additions import Addition
from pupper_analysis.models.attributes import BY_KIND
from pupper_analysis.models.conversion import (
    acting_gravity,
    joint_armature,
    pinocchio_from_urdf,
)
from pupper_analysis.models.description import Description
from pupper_analysis.models.efforts import EffortLimit, EffortStatement, Motor, placeholder_efforts
from pupper_analysis.models.mjcf import JointKind, free_joints, has_free_joint
from pupper_analysis.models.multibody import joint_placements
from pupper_analysis.models.spec_tree import SpecTree
from pupper_analysis.models.transmission import is_at_one_joint
from pupper_analysis.models.urdf_tree import UrdfTree
from pupper_analysis.models.xml import to_text
from pupper_analysis.robot import contact
from pupper_analysis.robot.contact import foot_geoms, foot_site, stand_height
from pupper_analysis.robot.coordinates import MujocoConvention, PinocchioConvention
from pupper_analysis.robot.floor import floor_of, leave_ground
from pupper_analysis.robot.robot import (
    Robot,
    Touching,
    acts_at_rest,
    effort_notes,
    efforts_of,
    with_friction,
)
from pupper_analysis.robot.tendons import tell_bonds_not_kept, tell_ranges_not_kept

Array = NDArray[np.float64]


def build_robot(
    description: Description, *, fixed_base: bool = False, foot_depth: float | None = None
) -> Robot:
    """Builds the robot of a description.

    Args:
        description: Both files' contents.
        fixed_base: Fix the base in the world, at the pose that the MJCF gives it; if it was free,
            the ground touches nothing then.
        foot_depth: How far below the hips the nominal stand has its feet (m); by default the lowest
            foot of the keyframe ``home`` touches the ground.

    Raises:
        ModelError: If a model cannot be built, or the two do not have the same joints.
        UnknownNameError: If a foot is not in a model.
    """
    mj_model, keyframe, added = _mujoco_model(description, fixed_base)
    floating = has_free_joint(mj_model)
    joint_names = _actuator_order(mj_model, description.mjcf_source)
    mj_base = _base_body(mj_model, floating, joint_names)
    if not floating:
        mj_base = _same_base(mj_model, mj_base, description.urdf)
    mj_convention = MujocoConvention.of(mj_model, joint_names)
    pin_model = _pinocchio_model(description, mj_model, mj_base, joint_names, floating)
    pin_convention = PinocchioConvention.of(pin_model, joint_names)
    notes = [*added, *option_notes(mj_model), *_at_rest(mj_model)]
    notes += tell_ranges_not_kept(mj_model)
    notes += tell_bonds_not_kept(mj_model)
    notes += _take_armature(mj_model, mj_convention, pin_model, pin_convention, joint_names)
    contact_frames = {point: frames[0] for point, frames in description.contact_points.items()}
    for frame in contact_frames.values():
        if not pin_model.existFrame(frame, pin.FrameType.BODY):
            links = [f.name for f in pin_model.frames if f.type == pin.FrameType.BODY]
            raise UnknownNameError(description.urdf_source, "link (for a foot)", frame, links)
    places = {
        point: foot_site(mj_model, frame, description.mjcf_source)
        for point, (_, frame) in description.contact_points.items()
    }
    geoms = foot_geoms(description, mj_model, places)
    radius = {point: size for point, (_, size) in geoms.items()}
    feet: dict[str, tuple[str, ...]] = {point: (point,) for point in description.contact_points}
    for foot, points in description.feet.items():
        feet = {other: own for other, own in feet.items() if other not in points} | {foot: points}
    foot_of = {point: foot for foot, points in feet.items() for point in points}
    # The keyframe may be that of the model with a free base.
    home = keyframe[len(keyframe) - mj_model.nq + mj_convention.qpos_index]
    return Robot(
        name=description.name,
        description=description,
        pin_model=pin_model,
        mj_model=mj_model,
        floating=floating,
        base=_root_link(pin_model),
        mj_base=mj_base,
        joint_names=joint_names,
        contact_points=tuple(description.contact_points),
        contact_frames=MappingProxyType(contact_frames),
        contact_places=MappingProxyType(places),
        foot_geoms=MappingProxyType({geom: foot_of[point] for point, (geom, _) in geoms.items()}),
        contact_radius=MappingProxyType(radius),
        feet=MappingProxyType(feet),
        contacts=contact.ground_contacts(mj_model, geoms),
        home=home,
        nominal=np.array([description.nominal.get(name, 0.0) for name in joint_names]),
        stand_height=stand_height(mj_model, mj_base, places, radius, keyframe, foot_depth),
        imu=_imu(mj_model, pin_model),
        pin_convention=pin_convention,
        mj_convention=mj_convention,
        fingerprint=f"{description.name} {_hash(pin_model, joint_names, contact_frames, radius)}",
        notes=tuple(notes),
    )


def rebuild_robot(robot: Robot, **changes: Any) -> Robot:
    """Builds a robot anew with changes of its description; its nominal stand and notes stay.

    So does what is known of its files as they were published.

    Args:
        robot: The robot.
        changes: Fields of ``Description``, such as ``mjcf``.

    Raises:
        ModelError: If a model cannot be built.
    """
    described = replace(robot.description, **changes)
    return with_knowledge_of(build_robot(described, fixed_base=not robot.floating), robot)


def equipped_robot(robot: Robot, *added: Addition) -> Robot:
    """Builds a robot anew whose MJCF is given something; see ``rebuild_robot``."""
    described = robot.description.given(*added)
    return rebuild_robot(robot, mjcf=described.mjcf, added=described.added)


def with_knowledge_of(built: Robot, robot: Robot) -> Robot:
    """Returns a robot that was built anew with what is known of it, and is in no description."""
    known = replace(
        built,
        stand_height=robot.stand_height,
        notes=robot.notes,
        published=None if robot.published is None else robot.published.of_changed(robot),
    )
    return known if not robot.touching else with_touching(known, robot, robot.touching)


def with_touching(built: Robot, robot: Robot, touching: Mapping[str, Touching]) -> Robot:
    """Returns a robot that has a task's contacts, and the stands of the one it was built of."""
    hands = {name for name, one in touching.items() if one.offset is not None}
    feet = sorted(built.feet.items(), key=lambda foot: foot[0] in hands)  # as they are, hands last
    return replace(
        built,
        feet=MappingProxyType(dict(feet)),
        contacts=with_friction(built.contacts, built.feet, touching),
        fingerprint=robot.fingerprint,
        touching=touching,
    )


def _at_rest(mj_model: mujoco.MjModel) -> list[Diagnostic]:
    """Tells what acts at rest; gravity compensation by motors becomes passive, in place.

    MuJoCo counts it as the motors' torque; here it is what they are relieved of.
    """
    notes: list[Diagnostic] = []
    if mj_model.opt.enableflags & mujoco.mjtEnableBit.mjENBL_SLEEP.value:
        notes.append(diagnose("sleep-not-differentiated"))
    if acts_at_rest(mj_model):
        notes.append(diagnose("springs-are-the-mjcfs"))
    if mj_model.body_gravcomp.any() and mj_model.jnt_actgravcomp.any():
        names = [
            mj_model.joint(int(joint)).name for joint in np.flatnonzero(mj_model.jnt_actgravcomp)
        ]
        mj_model.jnt_actgravcomp[:] = 0
        notes.append(diagnose("gravity-compensation-passive", joints=names))
    return notes


def _take_armature(
    mj_model: mujoco.MjModel,
    mj_convention: MujocoConvention,
    pin_model: pin.Model,
    pin_convention: PinocchioConvention,
    joint_names: Sequence[str],
) -> list[Diagnostic]:
    """Gives Pinocchio's model the armature of MuJoCo's, in place; returns notes about it.

    And about efforts, in which the files may differ.
    """
    limits = efforts_of(mj_model, pin_model, pin_convention, joint_names, {})
    notes = effort_notes(limits)
    armature = np.zeros(pin_model.nv)
    dofs = mj_convention.qvel_index[pin_convention.base_nv :]
    armature[pin_convention.v_index] = joint_armature(mj_model)[dofs]
    base = mj_convention.qvel_index[: pin_convention.base_nv]
    armature[: pin_convention.base_nv] = mj_model.dof_armature[base]
    pin_model.armature = armature
    if armature.any():
        notes.append(diagnose("armature-from-mjcf"))
    if armature[: pin_convention.base_nv].any():
        notes.append(diagnose("free-joint-has-armature", armature=Quantity(armature[0], "kg")))
    return notes


def _hash(
    model: pin.Model,
    joint_names: Sequence[str],
    contact_frames: Mapping[str, str],
    contact_radius: Mapping[str, float],
) -> str:
    """Returns a hash of what a stand depends on."""
    parts = [
        repr((joint_names, sorted(contact_frames.items()), sorted(contact_radius.items()))).encode()
    ]
    frames = [
        model.frames[model.getFrameId(frame, pin.FrameType.BODY)]
        for frame in contact_frames.values()
    ]
    for angle in (0.0, 0.3):  # rad: where the joints are, and how they turn
        q = pin.integrate(model, pin.neutral(model), np.full(model.nv, angle))
        joints = joint_placements(model, q)
        feet = [joints[frame.parentJoint] * frame.placement for frame in frames]
        places = np.array([placement.homogeneous for placement in (*joints, *feet)])
        # To a nanometre: processors differ in the last digit. 0.0: -0.0 is the same number.
        parts += [place.tobytes() for place in np.round(places, 9) + 0.0]
    parts += [inertia.toDynamicParameters().tobytes() for inertia in model.inertias]
    parts += [model.lowerPositionLimit.tobytes(), model.upperPositionLimit.tobytes()]
    return hashlib.sha256(b"\0".join(parts)).hexdigest()[:16]


def _mujoco_model(
    description: Description, fixed_base: bool
) -> tuple[mujoco.MjModel, Array, list[Diagnostic]]:
    """Compiles the MJCF; returns it with the qpos of its keyframe ``home``, and what was added."""
    added = []
    spec = description.mjcf.copy()
    keys = sorted(spec.keys, key=lambda key: key.name != "home")
    keyframe = np.array(keys[0].qpos) if keys else np.zeros(0)
    free = [joint for joint in spec.joints if joint.type == JointKind.FREE]
    if fixed_base:
        for element in (*free, *spec.keys):
            spec.delete(element)
        added += leave_ground(spec) if free else []  # which it hangs above, or through
    elif free and not floor_of(spec):
        SpecTree(spec).add_floor()
        added.append(diagnose("ground-added"))
    model = mjcf_description.compile_spec(spec, description.mjcf_source)
    return model, keyframe if len(keyframe) else np.array(model.qpos0), added


def _actuator_order(model: mujoco.MjModel, source: Path) -> tuple[str, ...]:
    """Returns the joints' names in actuator order, then those without actuator in tree order."""
    known: list[str] = []
    for joint in range(model.njnt):
        kind = JointKind(int(model.jnt_type[joint]))
        if kind == JointKind.BALL:
            name = model.joint(joint).name
            raise ModelError(source, diagnose("joint-is-ball", subject=("joint", name)))
        if kind != JointKind.FREE:
            known.append(model.joint(joint).name)
    driven = [
        model.joint(int(model.actuator_trnid[actuator, 0])).name
        for actuator in range(model.nactuator)
        if is_at_one_joint(model, actuator)
    ]
    if not known:
        raise ModelError(source, diagnose("no-joints"))
    return tuple(dict.fromkeys([*driven, *known]))


def _base_body(model: mujoco.MjModel, floating: bool, joint_names: Sequence[str]) -> str:
    """Returns the body with the free joint, or else the one that carries the first moving body."""
    if floating:
        return str(model.body(int(model.jnt_bodyid[free_joints(model)[0]])).name)
    base = int(model.jnt_bodyid[model.joint(joint_names[0]).id])
    while model.body_weldid[base] != 0:
        base = int(model.body_parentid[base])
    return str(model.body(base).name)


def _same_base(model: mujoco.MjModel, base: str, urdf: str) -> str:
    """Returns the static body that is named like the URDF's root link, if it carries the base.

    Where one file puts something before or after all of its names (``right_``, ``robot/``), the one
    whose name begins or ends with the root link's.
    """
    root = UrdfTree.of(urdf).base.name
    body, carrying = model.body(base).id, list[str]()
    while body != 0:
        carrying.append(str(model.body(body).name))
        body = int(model.body_parentid[body])
    if root in carrying:
        return root
    name = re.escape(root)
    longer = re.compile(rf"(.*[^A-Za-z0-9])?{name}([^A-Za-z0-9].*)?")
    return next((each for each in carrying if longer.fullmatch(each)), base)


def _imu(model: mujoco.MjModel, pin_model: pin.Model) -> str | None:
    """Returns the site with a gyro and an accelerometer that is a frame of the URDF as well."""
    gyro, accelerometer = mujoco.mjtSensor.mjSENS_GYRO, mujoco.mjtSensor.mjSENS_ACCELEROMETER
    sites = [
        {int(model.sensor_objid[i]) for i in np.flatnonzero(model.sensor_type == kind.value)}
        for kind in (gyro, accelerometer)
    ]
    names = [str(model.site(site).name) for site in sorted(sites[0] & sites[1])]
    return next(
        (name for name in names if name and pin_model.existFrame(name, pin.FrameType.BODY)), None
    )


def _pinocchio_model(
    description: Description,
    mj_model: mujoco.MjModel,
    mj_base: str,
    joint_names: Sequence[str],
    floating: bool,
) -> pin.Model:
    """Builds the URDF's model, its base free or fixed where the MJCF has it."""
    source = description.urdf_source
    model = pinocchio_from_urdf(description.urdf, source, floating=floating)
    for joint in list(model.joints)[2 if floating else 1 :]:
        if joint.nv != 1:
            subject = "joint", model.names[joint.id]
            raise ModelError(source, diagnose("joint-is-planar-or-floating", subject=subject))
        if not 0.5 < np.linalg.norm(joint.createData().S) < 2:
            subject = "joint", model.names[joint.id]
            raise ModelError(source, diagnose("axis-without-direction", subject=subject))
    joints = set(list(model.names)[2 if floating else 1 :])
    for missing, where, there in (
        (joints - set(joint_names), description.mjcf_source, source),
        (set(joint_names) - joints, source, description.mjcf_source),
    ):
        if missing:
            problem = diagnose("joints-of-other-file-missing", joints=sorted(missing), other=there)
            raise ModelError(where, problem)
    if not floating:
        data = mujoco.MjData(mj_model)
        mujoco.mj_kinematics(mj_model, data)
        body = mj_model.body(mj_base).id
        pose = placement_of(data.xquat[body], data.xpos[body])
        model.inertias[0] = pose.act(model.inertias[0])
        for joint in range(1, model.njoints):
            if model.parents[joint] == 0:
                model.jointPlacements[joint] = pose * model.jointPlacements[joint]
        for frame in model.frames:
            if frame.parentJoint == 0 and frame.name != "universe":
                frame.placement = pose * frame.placement
    model.gravity = pin.Motion(acting_gravity(mj_model), np.zeros(3))
    return model


def _root_link(model: pin.Model) -> str:
    """Returns the name of the URDF's root link."""
    return str(next(frame.name for frame in model.frames if frame.type == pin.FrameType.BODY))


_GRAVITY_TOLERANCE = 0.05
"""Gravity that differs from 9.81 m/s^2 downwards by more is not the Earth's, or not upright: from
pole to equator it changes by 0.05."""

_DISABLE = mujoco.mjtDisableBit

_FLAGS = (
    (_DISABLE.mjDSBL_CONTACT, "contact"),
    (_DISABLE.mjDSBL_CONSTRAINT, "constraint"),
    (_DISABLE.mjDSBL_ACTUATION, "actuation"),
)
"""What holds a robot."""


def option_notes(model: mujoco.MjModel) -> Iterator[Diagnostic]:
    """Yields what a model's options make other than a robot on the Earth expects."""
    acts = acting_gravity(model)
    if float(np.linalg.norm(acts - DOWN)) > _GRAVITY_TOLERANCE:
        yield diagnose("gravity-not-the-earths", gravity=acts)
    for bit, word in _FLAGS:
        if model.opt.disableflags & bit.value:
            yield diagnose("flag-disables", flag=word, motors=word == "actuation")
    groups = model.actuator_group
    off = [
        model.actuator(motor).name or f"#{motor}"
        for motor in range(model.nactuator)
        if 0 <= groups[motor] < 31 and int(model.opt.disableactuator) >> int(groups[motor]) & 1
    ]
    if off:
        yield diagnose("actuators-switched-off", actuators=off)


@check_arguments
def with_efforts(robot: Robot, efforts: Mapping[str, float]) -> Robot:
    """Returns the robot with other limits of its motors, said in its notes.

    For files with placeholders. They bound what is computed and what is simulated of the robot; its
    file as it was published is simulated with its own.

    Args:
        robot: The robot.
        efforts: {joint: what its motor can give either way, at the joint (N m; N of a slide)}.

    Returns:
        The robot; itself, if nothing is asked.

    Raises:
        UnknownNameError: If it has no such joint.
        ConfigurationError: If one is not positive and finite.
    """
    for name, effort in efforts.items():
        if name not in robot.joint_names:
            raise UnknownNameError(robot.name, "joint", name, robot.joint_names)
        if isinstance(effort, bool) or not 0 < effort < math.inf:
            problem = diagnose("effort-not-valid", joint=name, effort=effort)
            raise ConfigurationError("effort", problem)
    if not efforts:
        return robot
    urdf, mjcf = robot.description.trees()
    stated, messages = dict(robot.description.efforts), []
    before = {limit.joint: limit for limit in robot.efforts}
    for name, effort in efforts.items():
        urdf.joints[name].state(BY_KIND["effort"], effort)
        mjcf.limit_effort(name, effort)
        range_ = (-effort, effort)
        origin = EffortStatement.of("", "joint", name, "effort", range_)
        stated[name] = EffortLimit(name, *range_, origin, (origin,))
        own = before[name].least
        messages.append(
            diagnose(
                "effort-in-place-of",
                subject=("joint", name),
                effort=Quantity(effort, "N m"),
                own=Quantity(own, "N m") if own < math.inf else None,
            )
        )
    built = rebuild_robot(robot, urdf=to_text(urdf.root), mjcf=mjcf.spec, efforts=stated)
    return replace(built, notes=(*robot.notes, diagnose("efforts-as-asked", joints=messages)))


def efforts_nobody_meant(robot: Robot) -> tuple[Diagnostic, ...]:
    """Tells whether a verdict rests on efforts that look like placeholders; not on asked ones."""
    stated = {
        limit.joint: max(-limit.lower, limit.upper)
        for limit in robot.efforts
        if limit.origin is None or limit.origin.file
    }
    joints = list(placeholders_among(robot, stated))
    if not joints:
        return ()
    return (diagnose("rests-on-placeholder-efforts", joints=joints, count=len(joints)),)


def placeholders_among(robot: Robot, efforts: Mapping[str, float]) -> dict[str, Diagnostic]:
    """Returns which efforts look like placeholders, and why; see ``placeholder_efforts``.

    Args:
        robot: The robot, whose masses and armatures they are held against.
        efforts: {joint: effort (N m)}; those of slides are left out.
    """
    model = robot.mj_model
    weights, motors = np.bincount(model.body_weldid, model.body_mass, model.nbody), []
    for name, effort in efforts.items():
        joint = model.joint(name).id
        if model.jnt_type[joint] != JointKind.HINGE:
            continue
        link = int(model.body_weldid[model.jnt_bodyid[joint]])
        carrier = int(model.body_weldid[model.body_parentid[link]])
        mass = float(weights[link] + weights[carrier])
        motors.append(Motor(name, effort, mass, float(model.dof_armature[model.jnt_dofadr[joint]])))
    found = placeholder_efforts(motors, robot.total_mass)
    return {joint: why for joints, why in found for joint in joints}
