"""One robot, two models: Pinocchio's from the URDF, MuJoCo's from the MJCF."""

from __future__ import annotations

import hashlib
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType

import mujoco
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis import contact
from pupper_analysis.contact import ContactParameters
from pupper_analysis.convention import MujocoConvention, PinocchioConvention
from pupper_analysis.conversion import gravity, joint_armature
from pupper_analysis.description import Description, describe
from pupper_analysis.description import mjcf as mjcf_description
from pupper_analysis.errors import ModelError, UnknownNameError
from pupper_analysis.loading import read_mjcf, read_urdf
from pupper_analysis.task import Ground
from pupper_analysis.variants import BASES, VariantSpec, variant_spec

Array = NDArray[np.float64]

STEP_HALF_WIDTH = 0.03
"""Half the edge of the box that is put under a foot on a step (m)."""


@dataclass(frozen=True, eq=False)
class Robot:
    """A robot given by a URDF and an MJCF, with the maps between the two models.

    Attributes:
        name: The robot's name.
        description: The files' contents.
        pin_model: Pinocchio's model of the URDF. Its armature is the MJCF's.
        mj_model: MuJoCo's model of the MJCF.
        floating: Whether the base is free to move.
        base: The name of the base's link (URDF).
        mj_base: The name of the base's body (MJCF).
        joint_names: In actuator order.
        feet: The names of the feet: the keys of every per-foot dictionary.
        foot_frames: The name of each foot's frame in the URDF.
        foot_places: For each foot, the body that carries it in ``mj_model`` (its id) and the centre
            of its sphere in that body's frame, (3,) (m).
        soles: Which foot's sphere a geom of ``mj_model`` is, {geom id: foot}.
        foot_radius: The radius of each foot's sphere (m).
        contacts: The effective parameters of each foot's contact with the ground.
        home: (nq,) the MJCF's keyframe ``home`` (or its first, or its zero configuration).
        stand_height: Height of the base above the ground in the nominal stand (m).
        imu: The frame that carries gyro and accelerometer, if there is one.
        fingerprint: The name, and a hash of all that a stand depends on: joints, limits, masses and
            feet. Robots with the same hash have the same stands.
        notes: What was assumed or added on loading, in plain words.
    """

    name: str
    description: Description
    pin_model: pin.Model
    mj_model: mujoco.MjModel
    floating: bool
    base: str
    mj_base: str
    joint_names: tuple[str, ...]
    feet: tuple[str, ...]
    foot_frames: Mapping[str, str]
    foot_places: Mapping[str, tuple[int, Array]]
    soles: Mapping[int, str]
    foot_radius: Mapping[str, float]
    contacts: Mapping[str, ContactParameters]
    home: Array
    stand_height: float
    imu: str | None
    pin_convention: PinocchioConvention
    mj_convention: MujocoConvention
    fingerprint: str
    notes: tuple[str, ...] = field(default=())

    @property
    def nq(self) -> int:
        """Size of the public qpos."""
        return len(self.joint_names) + (7 if self.floating else 0)

    @property
    def nv(self) -> int:
        """Size of the public qvel."""
        return len(self.joint_names) + (6 if self.floating else 0)

    @property
    def nu(self) -> int:
        """Number of joints, each with one motor."""
        return len(self.joint_names)

    @property
    def gravity(self) -> Array:
        """(3,) acceleration of gravity in the world (m/s^2)."""
        return gravity(self.mj_model)

    @property
    def total_mass(self) -> float:
        """Mass of the URDF's model (kg)."""
        return float(sum(inertia.mass for inertia in self.pin_model.inertias))

    @property
    def lower_limits(self) -> Array:
        """(nu,) lower joint limits of the URDF (rad); -inf for a continuous joint."""
        return self._positional(self.pin_model.lowerPositionLimit, -np.inf)

    @property
    def upper_limits(self) -> Array:
        """(nu,) upper joint limits of the URDF (rad); inf for a continuous joint."""
        return self._positional(self.pin_model.upperPositionLimit, np.inf)

    @property
    def effort_limits(self) -> Array:
        """(nu,) effort limits of the URDF (N m)."""
        return np.array(self.pin_model.effortLimit[self.pin_convention.v_index])

    @property
    def velocity_limits(self) -> Array:
        """(nu,) velocity limits of the URDF (rad/s)."""
        return np.array(self.pin_model.velocityLimit[self.pin_convention.v_index])

    def _positional(self, values: Array, unbounded: float) -> Array:
        limits = np.array(values[self.pin_convention.q_index])
        limits[self.pin_convention.unbounded] = unbounded
        return limits

    def check_foot(self, foot: str) -> str:
        """Returns the name of a foot, if it is one.

        Raises:
            UnknownNameError: If it is not; the message lists the feet.
        """
        if foot not in self.foot_frames:
            raise UnknownNameError(self.name, "foot", foot, self.feet)
        return foot

    def neutral(self) -> Array:
        """Returns the qpos (nq,) with the base at the origin and every joint at zero."""
        qpos = np.zeros(self.nq)
        if self.floating:
            qpos[3] = 1.0
        return qpos


def load_variant(variant: str | VariantSpec, *, fixed_base: bool = False) -> Robot:
    """Loads one of the package's variants, or any other one.

    Args:
        variant: A name from ``VARIANTS``, or a ``VariantSpec``.
        fixed_base: Fix the base in the world, at the height that the MJCF gives it.

    Returns:
        The robot.

    Raises:
        VariantError: If the name is unknown.
        ModelError: If a model file is missing or damaged.
    """
    spec = variant_spec(variant)
    base = BASES[spec.base]
    robot = build_robot(
        describe(spec), fixed_base=fixed_base, foot_depth=base.foot_depth(spec.leg_scale)
    )
    return replace(robot, notes=(*filter(None, [base.remark]), *robot.notes))


def load_robot(
    *,
    urdf: str | Path,
    mjcf: str | Path,
    feet: Sequence[str] | Mapping[str, str],
    fixed_base: bool = False,
    name: str | None = None,
) -> Robot:
    """Loads a robot from a URDF and an MJCF.

    Joints are matched by name. The feet are frames that both files have: a link in the URDF, and a
    site, body or geom in the MJCF, each at the centre of a sphere that touches the ground.

    Args:
        urdf: Path of the URDF.
        mjcf: Path of the MJCF.
        feet: The feet's frames, or a mapping from the feet's names to their frames.
        fixed_base: Fix the base in the world, at the pose that the MJCF gives it.
        name: The robot's name; by default the MJCF's.

    Returns:
        The robot.

    Raises:
        ModelError: If a file cannot be read, or the two do not describe the same joints.
        UnknownNameError: If a foot is not in a file; the message lists what is.
    """
    frames = dict(feet) if isinstance(feet, Mapping) else {foot: foot for foot in feet}
    urdf_file, mjcf_file = read_urdf(urdf), read_mjcf(mjcf)
    description = Description(
        name=name or mjcf_file.spec.modelname,
        urdf=urdf_file.text,
        urdf_source=urdf_file.path,
        mjcf=mjcf_file.spec,
        mjcf_source=mjcf_file.path,
        feet={foot: (frame, frame) for foot, frame in frames.items()},
    )
    robot = build_robot(description, fixed_base=fixed_base)
    return replace(robot, notes=(*urdf_file.notes, *mjcf_file.notes, *robot.notes))


def build_robot(
    description: Description, *, fixed_base: bool = False, foot_depth: float | None = None
) -> Robot:
    """Builds the robot of a description.

    Args:
        description: Both files' contents.
        fixed_base: Fix the base in the world, at the pose that the MJCF gives it.
        foot_depth: How far below the hips the nominal stand has its feet (m); by default the lowest
            foot of the keyframe ``home`` touches the ground.

    Raises:
        ModelError: If a model cannot be built, or the two do not have the same joints.
        UnknownNameError: If a foot is not in a model.
    """
    notes: list[str] = []
    mj_model, keyframe = _mujoco_model(description, fixed_base, notes)
    floating = bool((mj_model.jnt_type == mujoco.mjtJoint.mjJNT_FREE.value).any())
    joint_names = _actuator_order(mj_model, description.mjcf_source)
    mj_base = _base_body(mj_model, floating, joint_names)
    if not floating:
        mj_base = _same_base(mj_model, mj_base, description.urdf)
    mj_convention = MujocoConvention.of(mj_model, joint_names)
    pin_model = _pinocchio_model(description, mj_model, mj_base, joint_names, floating)
    pin_convention = PinocchioConvention.of(pin_model, joint_names)
    armature = np.zeros(pin_model.nv)
    dofs = mj_convention.qvel_index[pin_convention.base_nv :]
    armature[pin_convention.v_index] = joint_armature(mj_model)[dofs]
    base = mj_convention.qvel_index[: pin_convention.base_nv]
    armature[: pin_convention.base_nv] = mj_model.dof_armature[base]
    pin_model.armature = armature
    if armature.any():
        notes.append("armature is the MJCF's: URDF cannot carry it")
    if armature[: pin_convention.base_nv].any():
        notes.append(
            f"the MJCF's free joint has an armature of {armature[0]:g}, as if the base were "
            "heavier: a default class meant for the joints reaches it; use <freejoint/>"
        )
    foot_frames = {foot: frames[0] for foot, frames in description.feet.items()}
    for frame in foot_frames.values():
        if not pin_model.existFrame(frame, pin.FrameType.BODY):
            links = [f.name for f in pin_model.frames if f.type == pin.FrameType.BODY]
            raise UnknownNameError(description.urdf_source, "link (for a foot)", frame, links)
    places = {
        foot: foot_site(mj_model, frame, description.mjcf_source)
        for foot, (_, frame) in description.feet.items()
    }
    soles = _soles(description, mj_model, places)
    radius = {foot: float(mj_model.geom_size[sole, 0]) for sole, foot in soles.items()}
    ground = contact.ground_geom(mj_model)
    contacts = {
        foot: contact.combine(mj_model, sole, ground)
        for sole, foot in soles.items()
        if ground is not None
    }
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
        feet=tuple(description.feet),
        foot_frames=MappingProxyType(foot_frames),
        foot_places=MappingProxyType(places),
        soles=MappingProxyType(soles),
        foot_radius=MappingProxyType(radius),
        contacts=MappingProxyType(contacts),
        home=home,
        stand_height=_stand_height(mj_model, mj_base, places, radius, keyframe, foot_depth),
        imu=_imu(mj_model, pin_model),
        pin_convention=pin_convention,
        mj_convention=mj_convention,
        fingerprint=f"{description.name} {_hash(pin_model, joint_names, foot_frames, radius)}",
        notes=tuple(notes),
    )


def _hash(
    model: pin.Model,
    joint_names: Sequence[str],
    foot_frames: Mapping[str, str],
    foot_radius: Mapping[str, float],
) -> str:
    """Returns a hash of what a stand depends on."""
    parts = [repr((joint_names, sorted(foot_frames.items()), sorted(foot_radius.items()))).encode()]
    data = model.createData()
    for angle in (0.0, 0.3):  # rad: where the joints are, and how they turn
        pin.framesForwardKinematics(
            model, data, pin.integrate(model, pin.neutral(model), np.full(model.nv, angle))
        )
        frames = [model.getFrameId(frame, pin.FrameType.BODY) for frame in foot_frames.values()]
        for placement in (*data.oMi, *(data.oMf[frame] for frame in frames)):
            # To a nanometre: processors differ in the last digit. 0.0: -0.0 is the same number.
            parts.append((np.round(placement.homogeneous, 9) + 0.0).tobytes())
    parts += [inertia.toDynamicParameters().tobytes() for inertia in model.inertias]
    parts += [model.lowerPositionLimit.tobytes(), model.upperPositionLimit.tobytes()]
    return hashlib.sha256(b"\0".join(parts)).hexdigest()[:16]


def on_ground(robot: Robot, ground: Ground, places: Mapping[str, Array]) -> Robot:
    """Puts a robot on a slope or on steps, in its MuJoCo model.

    Args:
        robot: The robot; its MJCF has a floor.
        ground: The slope and the steps.
        places: {foot: (3,) where its centre will be, lifted or not (m)}, for the steps.

    Returns:
        The same robot, whose MuJoCo model has the floor turned and a box for each step. The steps
        have the floor's contact parameters. A foot on a step does not touch the floor, into which
        it would sink through a low one.
    """
    if ground.level:
        return robot
    spec = robot.description.mjcf.copy()
    floor = _floor(spec) or _add_floor(spec)
    quat = pin.Quaternion(ground.rotation()).coeffs()[[3, 0, 1, 2]]
    floor.quat = quat
    steps = [foot for foot, height in ground.heights.items() if height > 0]
    contype, conaffinity = floor.contype, floor.conaffinity
    _leave_floor(robot, spec, floor, steps)
    for foot in steps:
        centre, half = ground.step(foot, places[foot], STEP_HALF_WIDTH)
        spec.worldbody.add_geom(
            name=f"step_{foot}",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=half,
            pos=centre,
            quat=quat,
            condim=floor.condim,
            contype=contype,
            conaffinity=conaffinity,
            friction=floor.friction,
            solref=floor.solref,
            solimp=floor.solimp,
            solmix=floor.solmix,
            priority=floor.priority,
            rgba=(0.6, 0.62, 0.66, 1.0),
        )
    built = build_robot(replace(robot.description, mjcf=spec))
    return replace(
        built,
        stand_height=robot.stand_height,
        fingerprint=robot.fingerprint,
        notes=robot.notes,
    )


def _floor(spec: mujoco.MjSpec) -> mujoco.MjsGeom | None:
    """Returns the plane that is fixed to the world."""
    plane = mujoco.mjtGeom.mjGEOM_PLANE
    return next((geom for geom in spec.worldbody.geoms if geom.type == plane), None)


def _add_floor(spec: mujoco.MjSpec) -> mujoco.MjsGeom:
    plane = mujoco.mjtGeom.mjGEOM_PLANE
    return spec.worldbody.add_geom(name="floor", type=plane, size=(0, 0, 0.05))


def _leave_floor(
    robot: Robot, spec: mujoco.MjSpec, floor: mujoco.MjsGeom, feet: Container[str]
) -> None:
    """Lets all that touched the floor touch it, except some feet's soles."""
    spec.compile()  # numbers the geoms
    geoms = [geom for geom in spec.geoms if geom.id != floor.id]
    touching = [
        geom
        for geom in geoms
        if geom.contype & floor.conaffinity or geom.conaffinity & floor.contype
    ]
    taken = floor.contype | floor.conaffinity
    for geom in geoms:
        taken |= geom.contype | geom.conaffinity
    free = next(1 << bit for bit in range(31) if not taken & 1 << bit)
    floor.contype, floor.conaffinity = 0, free
    for geom in touching:
        if robot.soles.get(geom.id) not in feet:
            geom.contype |= free


# ------------------------------------------------------------------------------------- MuJoCo


def _mujoco_model(
    description: Description, fixed_base: bool, notes: list[str]
) -> tuple[mujoco.MjModel, Array]:
    """Compiles the MJCF, and returns it with the qpos of its keyframe ``home``."""
    spec = description.mjcf.copy()
    keys = sorted(spec.keys, key=lambda key: key.name != "home")
    keyframe = np.array(keys[0].qpos) if keys else np.zeros(0)
    free = [joint for joint in spec.joints if joint.type == mujoco.mjtJoint.mjJNT_FREE]
    if fixed_base:
        for element in (*free, *spec.keys):
            spec.delete(element)
    elif free and not _floor(spec):
        _add_floor(spec)
        notes.append("the MJCF has no ground: a plane with MuJoCo's default contact was added")
    model = mjcf_description.compile_spec(spec, description.mjcf_source)
    return model, keyframe if len(keyframe) else np.array(model.qpos0)


def _actuator_order(model: mujoco.MjModel, source: Path) -> tuple[str, ...]:
    """Returns the joints' names in actuator order, then those without actuator in tree order."""
    known: list[str] = []
    for joint in range(model.njnt):
        kind = mujoco.mjtJoint(int(model.jnt_type[joint]))
        if kind == mujoco.mjtJoint.mjJNT_BALL:
            raise ModelError(
                source,
                f"joint {model.joint(joint).name!r} is a ball joint; hinge and "
                "slide joints, and one free joint at the base, can be analysed",
            )
        if kind != mujoco.mjtJoint.mjJNT_FREE:
            known.append(model.joint(joint).name)
    driven = [
        model.joint(int(model.actuator_trnid[actuator, 0])).name
        for actuator in range(model.nu)
        if model.actuator_trntype[actuator] == mujoco.mjtTrn.mjTRN_JOINT.value
    ]
    if not known:
        raise ModelError(source, "it has no joints; give a robot with hinge or slide joints")
    return tuple(dict.fromkeys([*driven, *known]))


def _base_body(model: mujoco.MjModel, floating: bool, joint_names: Sequence[str]) -> str:
    """Returns the body with the free joint, or else the one that carries the first moving body."""
    if floating:
        free = int(np.argmax(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE.value))
        return str(model.body(int(model.jnt_bodyid[free])).name)
    base = int(model.jnt_bodyid[model.joint(joint_names[0]).id])
    while model.body_weldid[base] != 0:
        base = int(model.body_parentid[base])
    return str(model.body(base).name)


def _same_base(model: mujoco.MjModel, base: str, urdf: str) -> str:
    """Returns the static body that is named like the URDF's root link, if it carries the base."""
    root = _root_link(pin.buildModelFromXML(urdf))
    body = model.body(base).id
    while body != 0:
        if model.body(body).name == root:
            return root
        body = int(model.body_parentid[body])
    return base


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


def _soles(
    description: Description, model: mujoco.MjModel, places: Mapping[str, tuple[int, Array]]
) -> dict[int, str]:
    """Finds the feet's spheres."""
    soles: dict[int, str] = {}
    for foot, (body, position) in places.items():
        sphere = contact.foot_geom(model, body, position)
        if sphere is None:
            frame = description.feet[foot][1]
            raise ModelError(
                description.mjcf_source,
                f"foot {foot!r}: body {model.body(body).name!r} has no sphere for contact centred "
                f"at {frame!r}; name a frame at the centre of the foot's sphere",
            )
        soles[sphere] = foot
    return soles


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


def _stand_height(
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


# ------------------------------------------------------------------------------------- Pinocchio


def _pinocchio_model(
    description: Description,
    mj_model: mujoco.MjModel,
    mj_base: str,
    joint_names: Sequence[str],
    floating: bool,
) -> pin.Model:
    """Builds the URDF's model, its base free or fixed where the MJCF has it."""
    source = description.urdf_source
    try:
        if floating:
            model = pin.buildModelFromXML(description.urdf, pin.JointModelFreeFlyer())
        else:
            model = pin.buildModelFromXML(description.urdf)
    except (ValueError, RuntimeError) as error:
        raise ModelError(source, f"not a valid URDF: {' '.join(str(error).split())}") from error
    joints = set(list(model.names)[2 if floating else 1 :])
    for missing, where, there in (
        (joints - set(joint_names), description.mjcf_source, source),
        (set(joint_names) - joints, source, description.mjcf_source),
    ):
        if missing:
            raise ModelError(where, f"no joint {', '.join(sorted(missing))}, which {there} has")
    if not floating:
        data = mujoco.MjData(mj_model)
        mujoco.mj_kinematics(mj_model, data)
        body = mj_model.body(mj_base).id
        pose = pin.SE3(data.xmat[body].reshape(3, 3), np.array(data.xpos[body]))
        model.inertias[0] = pose.act(model.inertias[0])
        for joint in range(1, model.njoints):
            if model.parents[joint] == 0:
                model.jointPlacements[joint] = pose * model.jointPlacements[joint]
        for frame in model.frames:
            if frame.parentJoint == 0 and frame.name != "universe":
                frame.placement = pose * frame.placement
    model.gravity = pin.Motion(gravity(mj_model), np.zeros(3))
    return model


def _root_link(model: pin.Model) -> str:
    """Returns the name of the URDF's root link."""
    return str(next(frame.name for frame in model.frames if frame.type == pin.FrameType.BODY))
