"""Factors and offsets of a robot's parameters, applied to both URDF and MJCF.

Inputs are a robot and {variable: number}, for example ``mass:*_1`` with a factor; output is a robot
whose URDF and MJCF have the same factors and offsets. Links on fixed joints are scaled together.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import chain

import mujoco
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from pupper_analysis.base.arguments import match_names
from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import Vector, diagnose
from pupper_analysis.base.errors import ConfigurationError, ModelError, UnknownNameError
from pupper_analysis.models.attributes import BY_KIND, BY_MJCF
from pupper_analysis.models.description import Description, ModelTree
from pupper_analysis.models.mjcf import compile_spec
from pupper_analysis.models.mjcf_file import gives_mass
from pupper_analysis.models.spec_tree import SpecTree
from pupper_analysis.models.urdf_tree import UrdfTree
from pupper_analysis.models.xml import to_text
from pupper_analysis.robot.build import rebuild_robot
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import model_with_servos
from pupper_analysis.stance.fields import FIELDS
from pupper_analysis.tools.study.lengths import evaluate_neutral_poses, stretch_links

# Names of factors and offsets, and the joints and bodies that match.

JOINT_STANCE_KINDS = tuple(name for name, field in FIELDS.items() if field.per == "joint")
"""Kinds of variables ``KIND:PATTERN`` that are fields of the stand task with a value per joint."""

LINK_STANCE_KINDS = tuple(name for name, field in FIELDS.items() if field.per == "link")
"""Kinds of variables ``KIND:PATTERN`` that are fields of the stand task with a value per link. The
pattern is the name of a link. The study's stance must contain a contact of this link with a plane.
"""

PATTERN_KINDS = {
    "mass": "mass and inertia of bodies",
    "inertia": "inertia of bodies about their centres of mass",
    "length": "length of links, to the next joint or the foot; their mass in proportion",
    "com_x": "offset of bodies' centres of mass along x of the URDF's link (m)",
    "com_y": "the same along y (m)",
    "com_z": "the same along z (m)",
    "effort": "effort limits of joints",
    "armature": "armature of joints",
    "damping": "damping of joints",
    "frictionloss": "dry friction of joints",
    "motor": "motor of joints: a name or a file",
    "kp": "stiffness of servos",
    "kd": "damping of servos",
    **dict.fromkeys(JOINT_STANCE_KINDS, "position of joints that carry no foot (rad, m)"),
    **dict.fromkeys(
        LINK_STANCE_KINDS, "where a contact's plane is, as typed (m), or a slope's angle (rad)"
    ),
}
"""{kind of a study variable ``KIND:PATTERN``: meaning}. The values of a variable are factors,
except for `ADDITIVE_KINDS`."""

COM_OFFSET_KINDS = ("com_x", "com_y", "com_z")
"""Kinds of variables ``KIND:PATTERN`` that are offsets of centres of mass [m], along x, y and z of
the URDF's link."""

ADDITIVE_KINDS = (*COM_OFFSET_KINDS, *JOINT_STANCE_KINDS, *LINK_STANCE_KINDS, "motor")
"""Kinds of variables of a study whose values are offsets, positions or motors, not factors on
numbers of the files.
"""

BODY_VARIABLE_KINDS = ("mass", "inertia", "length", *COM_OFFSET_KINDS)
"""Kinds of variables ``KIND:PATTERN`` that change bodies. The pattern may be the name of a link, of
a body, or of the joint that moves the body."""
SERVO_KINDS = ("kp", "kd")
"""Kinds of variables ``KIND:PATTERN`` that are factors on servo gains. Without a pattern, the
values are the gains of all servos."""


@dataclass(frozen=True)
class VariablePattern:
    """Parsed name of a study variable of the form ``KIND:PATTERN``, such as ``mass:*_1``.

    Attributes:
        kind: An element of `PATTERN_KINDS`.
        pattern: Pattern for the names of bodies or joints, with ``*`` and ``?`` as in file names.
    """

    kind: str
    pattern: str

    @staticmethod
    def parse(name: str) -> VariablePattern | None:
        """Parse the name ``KIND:PATTERN`` of a study variable; None for a name without colon.

        Raises:
            ConfigurationError: If the kind is unknown or the pattern is empty.
        """
        kind, separator, pattern = name.partition(":")
        if not separator:
            return None
        if kind not in PATTERN_KINDS or not pattern:
            examples = [f"{known_kind}:NAME" for known_kind in PATTERN_KINDS]
            finding = diagnose("no-number-of-a-model", kind=kind, known=examples)
            raise ConfigurationError(f"vary[{name!r}]", finding)
        return VariablePattern(kind, pattern)


def find_moving_joints(robot: Robot, pattern: VariablePattern) -> tuple[str, ...]:
    """Find the joints that a variable pattern selects, by name or by the body that the joint moves.

    Patterns of `BODY_VARIABLE_KINDS` also match names of links and bodies.

    Returns:
        Joint names; ``""`` for the base.

    Raises:
        UnknownNameError: If nothing matches; the message lists the names.
    """
    names = _list_names(robot, pattern.kind)
    selected = match_names(pattern.pattern, chain.from_iterable(names.values()))
    joints = tuple(joint for joint, aliases in names.items() if not {*aliases}.isdisjoint(selected))
    if not joints:
        kind = "body" if pattern.kind in BODY_VARIABLE_KINDS else "joint"
        raise UnknownNameError(
            robot.name,
            kind,
            pattern.pattern,
            dict.fromkeys(aliases[0] for aliases in names.values()),
        )
    return joints


def _list_names(robot: Robot, kind: str) -> dict[str, tuple[str, ...]]:
    """List the names that a pattern may match for a kind of variable: {joint: names}.

    The joint ``""`` means the base.
    """
    if kind not in BODY_VARIABLE_KINDS:
        return {joint: (joint,) for joint in robot.joint_names}
    links, bodies = UrdfTree.of(robot.description.urdf).moved_links, map_joint_bodies(robot)
    names = {"": (robot.base, robot.mj_base)}
    return names | {joint: (links[joint], bodies[joint], joint) for joint in robot.joint_names}


def map_joint_bodies(robot: Robot) -> dict[str, str]:
    """Find the body of the MJCF that each joint moves: {joint: body}."""
    model = robot.mj_model
    return {
        joint: str(model.body(int(model.jnt_bodyid[model.joint(joint).id])).name)
        for joint in robot.joint_names
    }


_RESULT_RTOL = 1e-9
"""Relative tolerance of masses, and absolute tolerance [m] of centres of mass, in the check of a
changed robot (rounding). Chosen, not tuned.
"""


def scale_robot(robot: Robot, factors: Mapping[str, float]) -> Robot:
    """Return a robot with scaled parameters and moved CoMs, in both URDF and MJCF.

    Links and bodies that are fixed to a matching body are scaled as well. Factors on servo gains
    are ignored: `with_gains` applies the gains.

    Args:
        robot: Robot.
        factors: {``KIND:PATTERN``: value}. A factor is finite and >= 0; factors of
            `BODY_VARIABLE_KINDS` and `SERVO_KINDS` are > 0. The value of ``com_x``, ``com_y`` and
            ``com_z`` is an offset [m] in the axes of the URDF's link.

    Raises:
        ConfigurationError: If a value is out of range, or a link cannot be stretched, for example.
        UnknownNameError: If a pattern matches nothing.
    """
    factors_by_kind: dict[str, dict[str, float]] = {}
    offsets: dict[str, Array] = {}
    for name, factor in factors.items():
        pattern = VariablePattern.parse(name)
        assert pattern is not None
        if pattern.kind in COM_OFFSET_KINDS:
            _add_offsets(offsets, robot, name, pattern, factor)
            continue
        bound = "> 0" if pattern.kind in (*BODY_VARIABLE_KINDS, *SERVO_KINDS) else ">= 0"
        if not math.isfinite(factor) or factor < 0 or (factor == 0 and bound == "> 0"):
            raise ConfigurationError(
                name, diagnose("factor-out-of-range", factor=factor, least=bound)
            )
        if pattern.kind not in SERVO_KINDS:
            for joint in find_moving_joints(robot, pattern):
                joint_factors = factors_by_kind.setdefault(pattern.kind, {})
                joint_factors[joint] = joint_factors.get(joint, 1.0) * factor
    if not factors_by_kind and not offsets:
        return robot
    urdf, mjcf = robot.description.trees()
    sides: tuple[tuple[ModelTree, str], ...] = ((urdf, robot.base), (mjcf, robot.mj_base))
    lengths = factors_by_kind.pop("length", {})
    for kind, joints in factors_by_kind.items():
        for joint, factor in joints.items():
            for tree, base in sides:
                _scale_value(tree, tree.moved_by(joint) or base, kind, joint, factor, robot)
    if offsets:
        move_coms(robot, (urdf, mjcf), offsets)
    height = stretch_links(robot, (urdf, mjcf), lengths) if lengths else robot.stand_height
    built = rebuild_robot(robot, urdf=to_text(urdf.root), mjcf=mjcf.spec)
    built = replace(built, stand_height=height)
    masses = dict(factors_by_kind.get("mass", {}))
    for joint, factor in lengths.items():
        masses[joint] = masses.get(joint, 1.0) * factor
    _check_result(
        robot, built, masses, {} if lengths else offsets
    )  # stretching moves centres of mass as well
    return built


def _add_offsets(
    offsets: dict[str, Array], robot: Robot, name: str, pattern: VariablePattern, offset: float
) -> None:
    """Add an offset [m] along an axis to the CoM offsets of all bodies that match a variable.

    ``offsets`` is {joint that moves the body, "" for the base: offset of the body's CoM, (3,) [m]},
    and changed in place.
    """
    if not math.isfinite(offset):
        raise ConfigurationError(name, diagnose("offset-not-finite", offset=offset))
    for joint in find_moving_joints(robot, pattern):
        if not joint and not robot.floating:
            raise ConfigurationError(name, diagnose("com-of-fixed-base"))
        offsets.setdefault(joint, np.zeros(3))[COM_OFFSET_KINDS.index(pattern.kind)] += offset


def _scale_value(
    tree: ModelTree, link: str, kind: str, joint: str, factor: float, robot: Robot
) -> None:
    """Scale a mass, inertia or joint parameter in the URDF or MJCF ``tree``, in place.

    The value belongs to ``link`` (with fixed links) for the kinds ``mass`` and ``inertia``, else to
    ``joint``.
    """
    if kind not in BODY_VARIABLE_KINDS:
        tree.scale(joint, BY_KIND.get(kind) or BY_MJCF[kind], factor)
        return
    for member in tree.fixed_group(link):
        try:
            (tree.scale_mass if kind == "mass" else tree.scale_inertia)(member, factor)
        except ValueError as error:
            finding = diagnose("inertia-follows-geoms", body=member)
            raise ModelError(robot.description.mjcf_source, finding) from error


def _check_result(
    before: Robot, after: Robot, masses: Mapping[str, float], offsets: Mapping[str, Array]
) -> None:
    """Check that a changed robot has the requested masses and CoMs, in both engines.

    ``masses`` is {joint: factor on the mass of the moved body}, ``offsets`` is {joint: CoM offset,
    (3,) [m], in the axes of the URDF's link}; ``""`` is the base.
    """
    config, bodies = Configuration(before, before.neutral()), map_joint_bodies(before)
    links = UrdfTree.of(before.description.urdf).moved_links
    for joint in {**masses, **offsets}:
        body, link = bodies.get(joint, before.mj_base), links.get(joint, before.base)
        factor = masses.get(joint, 1.0)
        expected = config.frame_rotation(link) @ offsets.get(joint, np.zeros(3))
        pairs = zip(
            _measure_bodies(before, joint, body), _measure_bodies(after, joint, body), strict=True
        )
        for (old, old_com), (new, com) in pairs:
            if abs(new - factor * old) > _RESULT_RTOL * abs(factor * old) + 1e-15:
                problem = diagnose(
                    "mass-became-another", body=body, new=new, old=old, factor=factor
                )
            elif joint in offsets and np.abs(com - old_com - expected).max() > _RESULT_RTOL:
                moved = Vector(tuple(com - old_com), "m")
                problem = diagnose(
                    "com-moved-otherwise",
                    body=body,
                    moved=moved,
                    asked=Vector(tuple(expected), "m"),
                )
            else:
                continue
            raise ModelError(before.description.mjcf_source, problem)


def _measure_bodies(robot: Robot, joint: str, body: str) -> Iterator[tuple[float, Array]]:
    """Yield mass [kg] and CoM (3,) [m] of a body with all fixed bodies, from each engine.

    The CoM is expressed in the world frame, with all joints at zero.
    """
    number = robot.pin_model.getJointId(joint) if joint else int(robot.floating)
    inertia, data = robot.pin_model.inertias[number], robot.pin_model.createData()
    pin.forwardKinematics(robot.pin_model, data, robot.pin_convention.q(robot.neutral()))
    yield float(inertia.mass), data.oMi[number].act(inertia.lever)
    model, data = robot.mj_model, robot.compute_kinematics()
    welded = model.body_weldid == model.body_weldid[model.body(body).id]
    mass = model.body_mass[welded]
    yield float(mass.sum()), mass @ data.xipos[welded] / mass.sum()


def with_ground_friction(robot: Robot, friction: float) -> Robot:
    """Return a robot with a given coefficient of sliding friction of feet and ground.

    All geoms of the feet and of the world body get the coefficient. MuJoCo uses the larger value of
    both geoms, or the value of the geom with higher priority.

    Raises:
        ConfigurationError: If the coefficient is negative or not finite, or a contact of a foot has
            no friction.
    """
    if not 0 <= friction < math.inf:
        raise ConfigurationError("friction", diagnose("friction-not-valid", friction=friction))
    frictionless = [foot for foot, contact in robot.contacts.items() if contact.condim == 1]
    if frictionless:
        problem = diagnose("contacts-frictionless", feet=frictionless)
        raise ConfigurationError("friction", problem)
    spec = robot.description.mjcf.copy()
    compile_spec(spec, robot.description.mjcf_source)  # assigns the ids of the geoms
    feet = set(robot.foot_geoms)
    for geom in spec.geoms:
        if geom.id in feet or geom.parent.name == "world":
            sliding = np.array(geom.friction)
            sliding[0] = friction
            geom.friction = sliding
    return rebuild_robot(robot, mjcf=spec)


def with_gains(
    robot: Robot, kp: ArrayLike | None, kd: ArrayLike | None, factors: Mapping[str, float]
) -> Robot:
    """Return a robot with other servo gains, in both the MJCF and the MuJoCo model.

    Args:
        robot: Robot.
        kp: Stiffness [N m/rad, N/m], scalar or shape (nu,); None for the value of the model.
        kd: Damping [N m s/rad, N s/m], scalar or shape (nu,); None for the value of the model.
        factors: {``kp:PATTERN`` or ``kd:PATTERN``: factor on the gain}.

    Raises:
        UnknownNameError: If a pattern matches nothing.
        ModelError: If a joint has no motor, or no servo while kp and kd are not both given.
    """
    servos = model_with_servos(robot, kp, kd)
    gains = {"kp": servos.kp.copy(), "kd": servos.kd.copy()}
    for name, factor in factors.items():
        pattern = VariablePattern.parse(name)
        if pattern is not None and pattern.kind in SERVO_KINDS:
            selected = np.isin(robot.joint_names, find_moving_joints(robot, pattern))
            gains[pattern.kind][selected] *= factor
    model = model_with_servos(robot, gains["kp"], gains["kd"]).model
    spec = robot.description.mjcf.copy()
    for index, actuator in enumerate(spec.actuators):
        actuator.gaintype = mujoco.mjtGain(int(model.actuator_gaintype[index]))
        actuator.biastype = mujoco.mjtBias(int(model.actuator_biastype[index]))
        actuator.dyntype = mujoco.mjtDyn(int(model.actuator_dyntype[index]))
        actuator.gainprm = model.actuator_gainprm[index]
        actuator.biasprm = model.actuator_biasprm[index]
        actuator.ctrllimited = int(model.actuator_ctrllimited[model.actuator_ctrladr[index]])
    return replace(robot, description=replace(robot.description, mjcf=spec), mj_model=model)


def without_visuals(description: Description) -> Description:
    """Return a copy of a description without unneeded visual geoms, unused meshes and textures.

    Geoms with mass, with fluid forces, or on the path of a tendon are kept. Models with many meshes
    compile faster.
    """
    spec = description.mjcf.copy()
    kept_names = {geom for geom, _ in description.foot_geoms.values()}
    kept_names |= {frame for _, frame in description.contact_points.values()}
    kept_names |= {
        wrap.target.name
        for tendon in spec.tendons
        for wrap in tendon.path
        if wrap.type in (mujoco.mjtWrap.mjWRAP_SPHERE, mujoco.mjtWrap.mjWRAP_CYLINDER)
    }
    for geom in list(spec.geoms):
        collides = geom.contype or geom.conaffinity
        in_pair = any(geom.name in (pair.geomname1, pair.geomname2) for pair in spec.pairs)
        if (
            not collides
            and not in_pair
            and geom.name not in kept_names
            and not geom.fluid_ellipsoid
            and not gives_mass(spec, geom)
        ):
            spec.delete(geom)
    used = {geom.meshname for geom in spec.geoms}
    for mesh in list(spec.meshes):
        if mesh.name not in used:
            spec.delete(mesh)
    for material in spec.materials:  # default classes may reference materials, which therefore stay
        material.textures = [""] * len(material.textures)
    for texture in list(spec.textures):
        spec.delete(texture)
    return replace(description, mjcf=spec)


# Offsets of centres of mass, in the URDF and in the MJCF.


def move_coms(robot: Robot, trees: tuple[UrdfTree, SpecTree], offsets: Mapping[str, Array]) -> None:
    """Move centres of mass in both files by offsets, in place.

    An offset moves the CoM of the link that a joint moves, and the CoMs of all links fixed to this
    link. Inertias about the centres of mass are not changed.

    Args:
        robot: Robot of the files. Link axes are compared in the pose with all joints at zero.
        trees: Trees of the URDF and of the MJCF.
        offsets: {joint: offset, shape (3,) [m], in the axes of the URDF's link that the joint
            moves}; ``""`` is the base.
    """
    config, data = evaluate_neutral_poses(robot)
    urdf, mjcf = trees
    for joint, offset in offsets.items():
        link = urdf.moved_by(joint) or robot.base
        offset_in_world = config.frame_rotation(link) @ offset
        for member in urdf.fixed_group(link):
            urdf.move_com(member, config.frame_rotation(member).T @ offset_in_world)
        for member in mjcf.fixed_group(mjcf.moved_by(joint) or robot.mj_base):
            mjcf.move_com(member, data.body(member).xmat.reshape(3, 3).T @ offset_in_world)
