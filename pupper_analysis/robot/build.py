"""Build a ``Robot`` from a ``Description``, and rebuild a robot with changes.

Input: URDF and MJCF. Both models are built, the joints are matched by name, and the armature of the
MJCF is copied to Pinocchio's model. The result contains contact points, nominal stand and notes.
Effort limits can be replaced, and limits that appear to be placeholders are reported.
"""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin

from pupper_analysis.base.arguments import check_arguments, check_type
from pupper_analysis.base.array_types import Array
from pupper_analysis.base.arrays import make_placement
from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.base.errors import ConfigurationError, ModelError, UnknownNameError
from pupper_analysis.base.frozen import freeze
from pupper_analysis.base.units import DOWNWARD_GRAVITY
from pupper_analysis.models import mjcf as mjcf_description
from pupper_analysis.models.additions import Addition
from pupper_analysis.models.attributes import BY_KIND
from pupper_analysis.models.conversion import (
    acting_gravity,
    joint_armature,
    pinocchio_from_urdf,
)
from pupper_analysis.models.description import Description
from pupper_analysis.models.efforts import (
    MIN_EFFORT,
    EffortLimit,
    EffortStatement,
    JointEffort,
    placeholder_efforts,
)
from pupper_analysis.models.inertias import find_placeholder_inertias
from pupper_analysis.models.mjcf import JointKind, has_free_joint, list_free_joints
from pupper_analysis.models.multibody import joint_placements
from pupper_analysis.models.transmission import is_at_one_joint
from pupper_analysis.models.urdf_tree import UrdfTree
from pupper_analysis.models.xml import to_text
from pupper_analysis.robot import contact
from pupper_analysis.robot.contact import foot_geoms, foot_site, stand_height
from pupper_analysis.robot.coordinates import MujocoConvention, PinocchioConvention
from pupper_analysis.robot.joints import find_motor_joints
from pupper_analysis.robot.mujoco_spec import make_mujoco_spec
from pupper_analysis.robot.robot import (
    Robot,
    Touching,
    acts_at_rest,
    describe_unstated_efforts,
    efforts_of,
    report_efforts,
    with_task_friction,
)
from pupper_analysis.robot.tendons import report_ignored_equalities, report_ignored_tendon_ranges


def build_robot(
    description: Description, *, fixed_base: bool = False, foot_depth: float | None = None
) -> Robot:
    """Build a `Robot` with Pinocchio's and MuJoCo's models from its URDF and MJCF.

    Args:
        description: Contents of the URDF and the MJCF, contact points and other data.
        fixed_base: Whether to fix a free base to the world, at the pose in the MJCF. If a free base
            is fixed, contacts with fixed planes and height fields are disabled.
        foot_depth: Distance [m] of the feet (sphere centres) below the hips in the nominal stand
            (the stand of the default `StandTask`). The distance determines the height of the base
            in this stand. By default, the lowest foot touches the ground with the joint positions
            of ``Robot.home``.

    Raises:
        ModelError: If MuJoCo or Pinocchio rejects a file, or the joints of both files differ, for
            example.
        UnknownNameError: If a contact point has no link in the URDF, or no site, body or geom in
            the MJCF.
        KeyError: If ``description.foot_geoms`` names a geom that the MJCF lacks.
    """
    mj_model, keyframe, added = _compile_mujoco_model(description, fixed_base)
    _refuse_flexes(mj_model, description.mjcf_source)
    floating = has_free_joint(mj_model)
    joint_names = _list_joints(mj_model, description.mjcf_source)
    mj_base = _find_base_body(mj_model, floating, joint_names)
    if not floating:
        mj_base = _match_root_link(mj_model, mj_base, description.urdf)
    mj_convention = MujocoConvention.from_model(mj_model, joint_names)
    pin_model = _build_pinocchio_model(description, mj_model, mj_base, joint_names, floating)
    pin_convention = PinocchioConvention.from_model(pin_model, joint_names)
    notes = [*added, *report_options(mj_model), *_check_forces_at_rest(mj_model)]
    notes += report_ignored_tendon_ranges(mj_model)
    notes += report_ignored_equalities(mj_model)
    notes += _copy_armature(
        mj_model,
        mj_convention,
        pin_model,
        pin_convention,
        joint_names,
        description.null_efforts,
    )
    contact_frames = {point: frames[0] for point, frames in description.contact_points.items()}
    _check_contact_links(pin_model, contact_frames, description.urdf_source)
    places = {
        point: foot_site(mj_model, frame, description.mjcf_source)
        for point, (_, frame) in description.contact_points.items()
    }
    places = {point: (body, freeze(centre)) for point, (body, centre) in places.items()}
    geoms = foot_geoms(description, mj_model, places)
    radius = {point: size for point, (_, size) in geoms.items()}
    feet = _group_contact_points(description)
    foot_of = {point: foot for foot, points in feet.items() for point in points}
    # The keyframe may belong to the model with a free base, and then has more elements.
    home = keyframe[len(keyframe) - mj_model.nq + mj_convention.qpos_index]
    properties_hash = _hash_properties(pin_model, joint_names, contact_frames, radius)
    return Robot(
        name=description.name,
        description=description,
        pin_model=pin_model,
        mj_model=mj_model,
        floating=floating,
        base=_find_root_link(pin_model),
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
        imu=_find_imu(mj_model, pin_model),
        pin_convention=pin_convention,
        mj_convention=mj_convention,
        fingerprint=f"{description.name} {properties_hash}",
        notes=tuple(notes),
    )


def _check_contact_links(
    pin_model: pin.Model, contact_frames: Mapping[str, str], urdf_source: Path
) -> None:
    """Raise an UnknownNameError if the link of a contact point is not in the URDF."""
    for frame in contact_frames.values():
        if not pin_model.existFrame(frame, pin.FrameType.BODY):
            links = [f.name for f in pin_model.frames if f.type == pin.FrameType.BODY]
            raise UnknownNameError(urdf_source, "link (for a foot)", frame, links)


def _group_contact_points(description: Description) -> dict[str, tuple[str, ...]]:
    """Return the contact points of each foot; a point without a foot is a foot of its own."""
    feet: dict[str, tuple[str, ...]] = {point: (point,) for point in description.contact_points}
    for foot, points in description.feet.items():
        other_feet = {name: own for name, own in feet.items() if name not in points}
        feet = other_feet | {foot: points}
    return feet


def _refuse_flexes(model: mujoco.MjModel, source: Path) -> None:
    """Raise a ModelError if a model has flexible bodies: statics does not support them."""
    if model.nflex:
        kind = mujoco.mjtObj.mjOBJ_FLEX
        names = [mujoco.mj_id2name(model, kind, flex) or f"#{flex}" for flex in range(model.nflex)]
        raise ModelError(source, diagnose("flex-in-robot", flexes=names))


def rebuild_robot(robot: Robot, **changes: Any) -> Robot:
    """Build a robot again from a changed description, and keep the metadata of the original.

    `copy_metadata` lists the kept data.

    Args:
        robot: The original robot.
        changes: New values of fields of ``Description``, for example ``mjcf=spec``.

    Raises:
        ModelError: If MuJoCo rejects the MJCF, or the joints of both files differ, for example.
        UnknownNameError: If a contact point has no link in the URDF, or no site, body or geom in
            the MJCF.
        KeyError: If ``foot_geoms`` of the description names a geom that the MJCF lacks.
    """
    description = replace(robot.description, **changes)
    return copy_metadata(build_robot(description, fixed_base=not robot.floating), robot)


def with_additions(robot: Robot, *additions: Addition) -> Robot:
    """Build a robot with additions to the MJCF, and keep the metadata of the original.

    Additions do not change the URDF: the result has a copy of the Pinocchio model of ``robot``,
    including changes of this model in memory.

    Args:
        robot: The original robot.
        additions: Elements for the MJCF, for example a floor or servos.

    Raises:
        ModelError: If MuJoCo rejects the MJCF with the additions.
        UnknownNameError: If a contact point has no link in the URDF, or no site, body or geom in
            the MJCF.
    """
    description = robot.description.with_additions(*additions)
    built = rebuild_robot(robot, mjcf=description.mjcf, added=description.added)
    return replace(built, pin_model=robot.pin_model.copy())


def copy_metadata(built: Robot, robot: Robot) -> Robot:
    """Copy notes, stand height and published file from the original to a rebuilt robot.

    Contacts of a task (``touching``) are copied as well, and the name, unless the description of
    the rebuilt robot has another name.

    Args:
        built: Rebuilt robot; not changed.
        robot: Original robot.

    Returns:
        Copy of ``built`` with these data.
    """
    same_name = built.description.name == robot.description.name
    result = replace(
        built,
        name=robot.name if same_name else built.name,
        stand_height=robot.stand_height,
        notes=robot.notes,
        published=None if robot.published is None else robot.published.for_modified_copy(robot),
    )
    if not robot.touching:
        return result
    # The posture of an arm on a weld is in no file.
    result = replace(result, home=robot.home) if result.nq == robot.nq else result
    return with_touching(result, robot, robot.touching)


def with_touching(built: Robot, robot: Robot, touching: Mapping[str, Touching]) -> Robot:
    """Add the contact settings of a task (friction, hands, welds) to a rebuilt robot.

    A hand is a part other than a foot with which the robot touches something.

    Args:
        built: Rebuilt robot; its files contain the contact geometry of the task.
        robot: Original robot, whose fingerprint (key for caches) is kept.
        touching: {foot or other part: contact settings of this part}.

    Returns:
        Copy of ``built``, in which hands are the last entries of ``feet``.
    """
    hands = {name for name, properties in touching.items() if properties.offset is not None}
    feet = sorted(built.feet.items(), key=lambda foot: foot[0] in hands)  # hands last
    return replace(
        built,
        feet=MappingProxyType(dict(feet)),
        contacts=with_task_friction(built.contacts, built.feet, touching),
        fingerprint=robot.fingerprint,
        touching=touching,
    )


def _check_forces_at_rest(mj_model: mujoco.MjModel) -> list[Diagnostic]:
    """Report sleep and passive forces; turn gravity compensation into a passive force.

    The model is changed in place: gravity compensation by actuators would be part of motor torques.
    """
    notes: list[Diagnostic] = []
    if mj_model.opt.enableflags & mujoco.mjtEnableBit.mjENBL_SLEEP.value:
        notes.append(diagnose("sleep-not-differentiated"))
    if acts_at_rest(mj_model):
        notes.append(diagnose("springs-are-the-mjcfs"))
    compensated_mass = float(mj_model.body_gravcomp @ mj_model.body_mass)
    if (mj_model.body_gravcomp > 0).any():  # otherwise MuJoCo ignores all values
        total_mass = float(mj_model.body_mass.sum())
        notes.append(
            diagnose(
                "weight-is-compensated",
                mass=Quantity(compensated_mass, "kg"),
                total=Quantity(total_mass, "kg"),
            )
        )
    if mj_model.body_gravcomp.any() and mj_model.jnt_actgravcomp.any():
        names = [
            mj_model.joint(int(joint)).name for joint in np.flatnonzero(mj_model.jnt_actgravcomp)
        ]
        mj_model.jnt_actgravcomp[:] = 0
        notes.append(diagnose("gravity-compensation-passive", joints=names))
    return notes


def _copy_armature(
    mj_model: mujoco.MjModel,
    mj_convention: MujocoConvention,
    pin_model: pin.Model,
    pin_convention: PinocchioConvention,
    joint_names: Sequence[str],
    null: Mapping[str, EffortStatement],
) -> list[Diagnostic]:
    """Copy MuJoCo's armature to Pinocchio's model, in place; return notes, also about efforts."""
    limits = efforts_of(mj_model, pin_model, pin_convention, joint_names, {}, null)
    notes = report_efforts(limits)
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


def _hash_properties(
    model: pin.Model,
    joint_names: Sequence[str],
    contact_frames: Mapping[str, str],
    contact_radius: Mapping[str, float],
) -> str:
    """Return a hash (16 hex digits) of the kinematic and inertial properties of a robot."""
    parts = [
        repr((joint_names, sorted(contact_frames.items()), sorted(contact_radius.items()))).encode()
    ]
    frames = [
        model.frames[model.getFrameId(frame, pin.FrameType.BODY)]
        for frame in contact_frames.values()
    ]
    for angle in (0.0, 0.3):  # [rad]: two configurations determine positions and axes
        q = pin.integrate(model, pin.neutral(model), np.full(model.nv, angle))
        joints = joint_placements(model, q)
        feet = [joints[frame.parentJoint] * frame.placement for frame in frames]
        places = np.array([placement.homogeneous for placement in (*joints, *feet)])
        # Rounded to a nanometre, because processors differ in the last digit; + 0.0 removes -0.0.
        parts += [place.tobytes() for place in np.round(places, 9) + 0.0]
    parts += [inertia.toDynamicParameters().tobytes() for inertia in model.inertias]
    parts += [model.lowerPositionLimit.tobytes(), model.upperPositionLimit.tobytes()]
    return hashlib.sha256(b"\0".join(parts)).hexdigest()[:16]


def _compile_mujoco_model(
    description: Description, fixed_base: bool
) -> tuple[mujoco.MjModel, Array, list[Diagnostic]]:
    """Compile the MJCF for a free or a fixed base; return model, start qpos, and notes.

    qpos is that of the keyframe, in MuJoCo's order, including the coordinates of a free joint that
    was removed; without a keyframe, the ``qpos0`` of the model.
    """
    spec, keyframe, notes = make_mujoco_spec(description, fixed_base=fixed_base)
    model = mjcf_description.compile_spec(spec, description.mjcf_source)
    return model, keyframe if len(keyframe) else np.array(model.qpos0), notes


def compile_with_visuals(robot: Robot) -> mujoco.MjModel:
    """Return the MuJoCo model of a robot with the visual geoms of its files.

    Sizes of bodies and names of geoms must not depend on the option ``visuals`` of ``load_robot``.
    Bodies, joints and their addresses are the same as in the robot's own model. If the user's MJCF
    discards visual geoms, for example, the result lacks them as well.

    Raises:
        ModelError: If MuJoCo rejects the MJCF.
    """
    published = robot.published
    if published is None or published.is_unchanged:
        return robot.mj_model
    spec = robot.description.mjcf.copy()
    file = published.file
    discards = file is not None and bool(file.spec.compiler.discardvisual)
    if bool(spec.compiler.discardvisual) == discards:
        return robot.mj_model
    spec.compiler.discardvisual = discards
    return _compile_mujoco_model(replace(robot.description, mjcf=spec), not robot.floating)[0]


def _list_joints(model: mujoco.MjModel, source: Path) -> tuple[str, ...]:
    """List the joints of a model in actuator order; joints without direct actuator come last."""
    all_joints: list[str] = []
    for joint in range(model.njnt):
        kind = JointKind(int(model.jnt_type[joint]))
        if kind == JointKind.BALL:
            name = model.joint(joint).name
            raise ModelError(source, diagnose("joint-is-ball", subject=("joint", name)))
        if kind != JointKind.FREE:
            all_joints.append(model.joint(joint).name)
    driven = [
        model.joint(int(model.actuator_trnid[actuator, 0])).name
        for actuator in range(model.nactuator)
        if is_at_one_joint(model, actuator)
    ]
    if not all_joints:
        raise ModelError(source, diagnose("no-joints"))
    return tuple(dict.fromkeys([*driven, *all_joints]))


def _find_base_body(model: mujoco.MjModel, floating: bool, joint_names: Sequence[str]) -> str:
    """Return the name of the base body: the free body, or the first joint's fixed ancestor."""
    if floating:
        return str(model.body(int(model.jnt_bodyid[list_free_joints(model)[0]])).name)
    base = int(model.jnt_bodyid[model.joint(joint_names[0]).id])
    while model.body_weldid[base] != 0:
        base = int(model.body_parentid[base])
    return str(model.body(base).name)


def _match_root_link(model: mujoco.MjModel, base: str, urdf: str) -> str:
    """Return ``base``, or its ancestor whose name contains the name of the URDF's root link."""
    root = UrdfTree.of(urdf).base.name
    body, ancestors = model.body(base).id, list[str]()
    while body != 0:
        ancestors.append(str(model.body(body).name))
        body = int(model.body_parentid[body])
    if root in ancestors:
        return root
    name = re.escape(root)
    extended_name = re.compile(rf"(.*[^A-Za-z0-9])?{name}([^A-Za-z0-9].*)?")
    return next((ancestor for ancestor in ancestors if extended_name.fullmatch(ancestor)), base)


def _find_imu(model: mujoco.MjModel, pin_model: pin.Model) -> str | None:
    """Return the name of a site with gyro and accelerometer that is also a URDF link, or None."""
    gyro, accelerometer = mujoco.mjtSensor.mjSENS_GYRO, mujoco.mjtSensor.mjSENS_ACCELEROMETER
    sites = [
        {
            int(model.sensor_objid[sensor])
            for sensor in np.flatnonzero(model.sensor_type == kind.value)
        }
        for kind in (gyro, accelerometer)
    ]
    names = [str(model.site(site).name) for site in sorted(sites[0] & sites[1])]
    return next(
        (name for name in names if name and pin_model.existFrame(name, pin.FrameType.BODY)), None
    )


def _build_pinocchio_model(
    description: Description,
    mj_model: mujoco.MjModel,
    mj_base: str,
    joint_names: Sequence[str],
    floating: bool,
) -> pin.Model:
    """Build Pinocchio's model of the URDF, with gravity and fixed base pose of the MJCF."""
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
    for missing, lacking_file, other_file in (
        (joints - set(joint_names), description.mjcf_source, source),
        (set(joint_names) - joints, source, description.mjcf_source),
    ):
        if missing:
            problem = diagnose(
                "joints-of-other-file-missing", joints=sorted(missing), other=other_file
            )
            raise ModelError(lacking_file, problem)
    if not floating:
        data = mujoco.MjData(mj_model)
        mujoco.mj_kinematics(mj_model, data)
        body = mj_model.body(mj_base).id
        pose = make_placement(data.xquat[body], data.xpos[body])
        model.inertias[0] = pose.act(model.inertias[0])
        for joint in range(1, model.njoints):
            if model.parents[joint] == 0:
                model.jointPlacements[joint] = pose * model.jointPlacements[joint]
        for frame in model.frames:
            if frame.parentJoint == 0 and frame.name != "universe":
                frame.placement = pose * frame.placement
    model.gravity = pin.Motion(acting_gravity(mj_model), np.zeros(3))
    return model


def _find_root_link(model: pin.Model) -> str:
    """Return the name of the URDF's root link."""
    return str(next(frame.name for frame in model.frames if frame.type == pin.FrameType.BODY))


_GRAVITY_ATOL = 0.05
"""Tolerance of the gravity vector of an MJCF [m/s^2]. If the norm of its difference from Earth's
gravity is larger, the gravity is reported. Gravity varies by 0.05 m/s^2 between pole and
equator."""

_DISABLE_BIT = mujoco.mjtDisableBit
"""MuJoCo's enumeration of disable flags."""

SUPPORT_FLAGS = (
    (_DISABLE_BIT.mjDSBL_CONTACT, "contact"),
    (_DISABLE_BIT.mjDSBL_CONSTRAINT, "constraint"),
    (_DISABLE_BIT.mjDSBL_ACTUATION, "actuation"),
)
"""(flag of MuJoCo, word in the message). Each flag disables forces that support a robot, and is
reported if it is set (`report_options`)."""


def report_options(model: mujoco.MjModel) -> Iterator[Diagnostic]:
    """Yield diagnostics of MuJoCo options that are unusual for a robot on Earth.

    Examples are gravity, disabled contacts, and disabled actuator groups.
    """
    gravity = acting_gravity(model)
    if float(np.linalg.norm(gravity - DOWNWARD_GRAVITY)) > _GRAVITY_ATOL:
        yield diagnose("gravity-not-the-earths", gravity=gravity)
    for bit, word in SUPPORT_FLAGS:
        if model.opt.disableflags & bit.value:
            yield diagnose("flag-disables", flag=word, motors=word == "actuation")
    groups = model.actuator_group
    disabled_actuators = [
        model.actuator(motor).name or f"#{motor}"
        for motor in range(model.nactuator)
        if 0 <= groups[motor] < 31 and int(model.opt.disableactuator) >> int(groups[motor]) & 1
    ]
    if disabled_actuators:
        yield diagnose("actuators-switched-off", actuators=disabled_actuators)


@check_arguments
def with_efforts(robot: Robot, efforts: Mapping[str, float]) -> Robot:
    """Return a copy of the robot with other effort limits of joints, and a note about this change.

    Use this function if the files contain placeholder limits. Simulations of the published file
    still use the limits of the file.

    Args:
        robot: The robot.
        efforts: {joint, or a pattern such as ``*calf*``: largest absolute torque of the motor at
            the joint [N m], or force of a slide [N]}. If several patterns match a joint, the last
            counts. Patterns select motors (`find_motor_joints`).

    Returns:
        The robot with the limits; the robot itself if ``efforts`` is empty.

    Raises:
        UnknownNameError: If the robot lacks a joint of ``efforts``, or a pattern matches no joint.
        ConfigurationError: If an argument has another type, or a limit is below 1e-6 N m or N
            (`MIN_EFFORT`) or not finite.
    """
    old_limits = {limit.joint: limit for limit in robot.efforts}
    efforts = {
        joint: effort
        for name, effort in efforts.items()
        for joint in find_motor_joints(robot, name)
    }
    for name, effort in efforts.items():
        check_type(f"efforts[{name}]", effort, float)
        if isinstance(effort, bool) or not MIN_EFFORT <= effort < math.inf:
            unit = old_limits[name].unit
            stated, least = Quantity(effort, unit), Quantity(MIN_EFFORT, unit)
            problem = diagnose("effort-not-valid", joint=name, effort=stated, least=least)
            raise ConfigurationError("effort", problem)
    if not efforts:
        return robot
    urdf, mjcf = robot.description.trees()
    new_limits, messages = dict(robot.description.efforts), []
    for name, effort in efforts.items():
        urdf.joints[name].set_parameter(BY_KIND["effort"], effort)
        mjcf.limit_effort(name, effort)
        range_ = (-effort, effort)
        origin = EffortStatement.of("", "joint", name, "effort", range_)
        old_limit, unit = old_limits[name].symmetric_torque, old_limits[name].unit
        new_limits[name] = EffortLimit(name, *range_, origin, (origin,), unit)
        messages.append(
            diagnose(
                "effort-in-place-of",
                subject=("joint", name),
                effort=Quantity(effort, unit),
                own=Quantity(old_limit, unit) if old_limit < math.inf else None,
            )
        )
    null = {
        name: empty for name, empty in robot.description.null_efforts.items() if name not in efforts
    }
    changes = {"urdf": to_text(urdf.root), "mjcf": mjcf.spec, "efforts": new_limits}
    built = rebuild_robot(robot, **changes, null_efforts=null)
    model = robot.pin_model.copy()
    for name, effort in efforts.items():
        model.effortLimit[model.joints[model.getJointId(name)].idx_v] = effort
    notes = _without_stated_efforts(robot.notes, efforts)
    notes = (*notes, diagnose("efforts-as-asked", joints=messages))
    return replace(built, pin_model=model, notes=notes)


def _without_stated_efforts(
    notes: Iterable[Diagnostic], stated: Container[str]
) -> tuple[Diagnostic, ...]:
    """Remove joints from the note about unstated torque limits; omit the note without joints."""
    kept: list[Diagnostic] = []
    for note in notes:
        joints = note.values.get("joints")
        if note.code != "torque-limits-unstated" or not isinstance(joints, tuple):
            kept.append(note)
        elif left := [str(joint) for joint in joints if joint not in stated]:
            kept.append(describe_unstated_efforts(left))
    return tuple(kept)


def report_placeholder_efforts(robot: Robot) -> tuple[Diagnostic, ...]:
    """Report the effort limits of the files that appear to be placeholders, in one diagnostic.

    A placeholder is a number that nobody determined, such as 100 N m at every joint. Limits of
    slides, and limits that the caller passed (`with_efforts`), are not examined.
    """
    efforts = {
        limit.joint: max(-limit.lower, limit.upper)
        for limit in robot.efforts
        if limit.origin is None or limit.origin.file
    }
    joints = list(find_placeholder_efforts(robot, efforts))
    if not joints:
        return ()
    return (diagnose("rests-on-placeholder-efforts", joints=joints, count=len(joints)),)


_NEGLIGIBLE_MASS_RATIO = 1e-4
"""Mass of a link, relative to the robot, below which `report_placeholder_inertias` ignores the
link. Equal to the ratio of the audit (`RobotModel.is_negligible`)."""


def report_placeholder_inertias(robot: Robot) -> tuple[Diagnostic, ...]:
    """Report the link inertias that appear to be placeholders, one diagnostic for each inertia.

    A placeholder is an inertia that at least two links share, for example 1 kg m^2 about every
    axis. The largest stable damping is proportional to the inertias, and the growth of deviations
    depends on them.
    """
    model = robot.mj_model
    least = _NEGLIGIBLE_MASS_RATIO * robot.total_mass
    moving = (model.body_weldid > 0) & (model.body_mass >= least)
    bodies = np.flatnonzero(moving).tolist()
    inertias = ((model.body(body).name, np.diag(model.body_inertia[body])) for body in bodies)
    return tuple(
        diagnose(
            "rests-on-placeholder-inertias",
            links=names,
            count=len(names),
            moment=Quantity(moment, "kg m^2"),
        )
        for moment, names in find_placeholder_inertias(inertias).items()
    )


def find_placeholder_efforts(robot: Robot, efforts: Mapping[str, float]) -> dict[str, Diagnostic]:
    """Return {joint: reason} for each joint whose effort limit appears to be a placeholder.

    A placeholder is a number that nobody determined, such as 100 N m at every joint. For the
    criteria see ``placeholder_efforts``.

    Args:
        robot: Robot, whose masses and armatures are compared with the efforts.
        efforts: {joint: effort limit [N m]}. Slides are not examined.
    """
    model = robot.mj_model
    body_masses, motors = np.bincount(model.body_weldid, model.body_mass, model.nbody), []
    for name, effort in efforts.items():
        joint = model.joint(name).id
        if model.jnt_type[joint] != JointKind.HINGE:
            continue
        link = int(model.body_weldid[model.jnt_bodyid[joint]])
        parent = int(model.body_weldid[model.body_parentid[link]])
        mass = float(body_masses[link] + body_masses[parent])
        motors.append(
            JointEffort(name, effort, mass, float(model.dof_armature[model.jnt_dofadr[joint]]))
        )
    findings = placeholder_efforts(motors, robot.total_mass)
    return {joint: reason for joints, reason in findings for joint in joints}
