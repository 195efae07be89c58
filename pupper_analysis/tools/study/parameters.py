"""Factors on a robot's numbers and offsets of them, by name, in its URDF and its MJCF alike."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase

import mujoco
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import Vector, diagnose
from pupper_analysis.base.errors import ConfigurationError, ModelError, UnknownNameError
from pupper_analysis.models.attributes import BY_KIND, BY_MJCF
from pupper_analysis.models.description import Description, ModelTree
from pupper_analysis.models.mjcf import compile_spec
from pupper_analysis.models.spec_tree import SpecTree
from pupper_analysis.models.urdf_tree import UrdfTree
from pupper_analysis.models.xml import to_text
from pupper_analysis.robot.build import rebuild_robot
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import model_with_servos
from pupper_analysis.stance.fields import FIELDS
from pupper_analysis.tools.study.lengths import stretch_links

Array = NDArray[np.float64]

# Names of factors on a robot's numbers, and the joints and bodies that they mean.

JOINT_STANCE_KINDS = tuple(name for name, field in FIELDS.items() if field.per == "joint")
"""Kinds that are fields of the stance, of each joint."""

LINK_STANCE_KINDS = tuple(name for name, field in FIELDS.items() if field.per == "link")
"""Kinds that are fields of the stance, of what the study's own stance states."""

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
    "kp": "stiffness of servos",
    "kd": "damping of servos",
    **dict.fromkeys(JOINT_STANCE_KINDS, "position of joints that carry no foot (rad, m)"),
    **dict.fromkeys(
        LINK_STANCE_KINDS, "where a contact's plane is, as typed (m), or a slope's angle (rad)"
    ),
}
"""What ``KIND:PATTERN`` may say: factors on what the files say, but for the offsets of coms."""

COM_OFFSET_KINDS = ("com_x", "com_y", "com_z")
"""Kinds that are added, along these axes (m), and are no factors."""

ADDITIVE_KINDS = (*COM_OFFSET_KINDS, *JOINT_STANCE_KINDS, *LINK_STANCE_KINDS)
"""Kinds that are no factors of what the files say, and have no bounds."""

BODY_KINDS = ("mass", "inertia", "length", *COM_OFFSET_KINDS)
SERVO_KINDS = ("kp", "kd")


@dataclass(frozen=True)
class VariablePattern:
    """A factor's name, parsed.

    Attributes:
        kind: One of ``KINDS``.
        pattern: What the names of bodies or joints must match, as file names do: ``*``, ``?``.
    """

    kind: str
    pattern: str

    @staticmethod
    def parse(name: str) -> VariablePattern | None:
        """Takes a name apart; None if it is of another form.

        Raises:
            ConfigurationError: If there is no such kind.
        """
        kind, separator, pattern = name.partition(":")
        if not separator:
            return None
        if kind not in PATTERN_KINDS or not pattern:
            known = [f"{one}:NAME" for one in PATTERN_KINDS]
            finding = diagnose("no-number-of-a-model", kind=kind, known=known)
            raise ConfigurationError(f"vary[{name!r}]", finding)
        return VariablePattern(kind, pattern)


def match_joints(robot: Robot, named: VariablePattern) -> tuple[str, ...]:
    """Returns the joints that a factor is for, or that move its bodies; ``""`` is the base.

    A body is matched by its link's name in the URDF, its body's in the MJCF, or its joint's.

    Raises:
        UnknownNameError: If none match; the message lists the names.
    """
    names = _names(robot, named.kind)
    found = tuple(
        joint for joint, own in names.items() if any(fnmatchcase(one, named.pattern) for one in own)
    )
    if not found:
        kind = "body" if named.kind in BODY_KINDS else "joint"
        raise UnknownNameError(
            robot.name, kind, named.pattern, dict.fromkeys(own[0] for own in names.values())
        )
    return found


def _names(robot: Robot, kind: str) -> dict[str, tuple[str, ...]]:
    """Returns {joint: by which names a factor may mean it, or what it moves}."""
    if kind not in BODY_KINDS:
        return {joint: (joint,) for joint in robot.joint_names}
    links, bodies = UrdfTree.of(robot.description.urdf).moved_links, map_joint_bodies(robot)
    names = {"": (robot.base, robot.mj_base)}
    return names | {joint: (links[joint], bodies[joint], joint) for joint in robot.joint_names}


def map_joint_bodies(robot: Robot) -> dict[str, str]:
    """Returns {joint: the body that it moves in the MJCF}."""
    model = robot.mj_model
    return {
        joint: str(model.body(int(model.jnt_bodyid[model.joint(joint).id])).name)
        for joint in robot.joint_names
    }


_TOLERANCE = 1e-9
"""Relative, and m: two models that were given the same numbers agree to rounding."""


def scale_robot(robot: Robot, factors: Mapping[str, float]) -> Robot:
    """Returns a robot with factors on its numbers, in both of its models.

    Fixed links and bodies count to the body that carries them. Servos' gains are not changed here:
    ``with_gains`` does it.

    Args:
        robot: The robot.
        factors: {``KIND:PATTERN``: factor, finite and >= 0, a mass's and an inertia's > 0; of
            ``com_x`` and the like an offset (m), in the axes of the URDF's link}.

    Raises:
        ConfigurationError: If a factor is none.
        UnknownNameError: If a pattern matches nothing.
        ModelError: If a model cannot be built.
    """
    wanted: dict[str, dict[str, float]] = {}
    offsets: dict[str, Array] = {}
    for name, factor in factors.items():
        named = VariablePattern.parse(name)
        assert named is not None
        if named.kind in COM_OFFSET_KINDS:
            _add_offsets(offsets, robot, name, named, factor)
            continue
        least = "> 0" if named.kind in (*BODY_KINDS, *SERVO_KINDS) else ">= 0"
        if not math.isfinite(factor) or factor < 0 or (factor == 0 and least == "> 0"):
            raise ConfigurationError(
                name, diagnose("factor-out-of-range", factor=factor, least=least)
            )
        if named.kind not in SERVO_KINDS:
            for joint in match_joints(robot, named):
                own = wanted.setdefault(named.kind, {})
                own[joint] = own.get(joint, 1.0) * factor
    if not wanted and not offsets:
        return robot
    urdf, mjcf = robot.description.trees()
    sides: tuple[tuple[ModelTree, str], ...] = ((urdf, robot.base), (mjcf, robot.mj_base))
    lengths = wanted.pop("length", {})
    for kind, joints in wanted.items():
        for joint, factor in joints.items():
            for tree, base in sides:
                _scale(tree, tree.moved_by(joint) or base, kind, joint, factor, robot)
    if offsets:
        move_coms(robot, (urdf, mjcf), offsets)
    height = stretch_links(robot, (urdf, mjcf), lengths) if lengths else robot.stand_height
    built = rebuild_robot(robot, urdf=to_text(urdf.root), mjcf=mjcf.spec)
    built = replace(built, stand_height=height)
    masses = dict(wanted.get("mass", {}))
    for joint, factor in lengths.items():
        masses[joint] = masses.get(joint, 1.0) * factor
    _check(robot, built, masses, {} if lengths else offsets)  # which move coms, too
    return built


def _add_offsets(
    offsets: dict[str, Array], robot: Robot, name: str, named: VariablePattern, offset: float
) -> None:
    if not math.isfinite(offset):
        raise ConfigurationError(name, diagnose("offset-not-finite", offset=offset))
    for joint in match_joints(robot, named):
        if not joint and not robot.floating:
            raise ConfigurationError(name, diagnose("com-of-fixed-base"))
        offsets.setdefault(joint, np.zeros(3))[COM_OFFSET_KINDS.index(named.kind)] += offset


def _scale(tree: ModelTree, link: str, kind: str, joint: str, factor: float, robot: Robot) -> None:
    """Scales a number in one of a robot's files; what is fixed to a link scales with it."""
    if kind not in BODY_KINDS:
        tree.scale(joint, BY_KIND.get(kind) or BY_MJCF[kind], factor)
        return
    for one in tree.fixed_group(link):
        try:
            (tree.scale_mass if kind == "mass" else tree.scale_inertia)(one, factor)
        except ValueError as error:
            finding = diagnose("inertia-follows-geoms", body=one)
            raise ModelError(robot.description.mjcf_source, finding) from error


def _check(
    before: Robot, after: Robot, masses: Mapping[str, float], offsets: Mapping[str, Array]
) -> None:
    """Checks that bodies weigh, in both models, what was asked for, and where.

    Args:
        before: The robot of before.
        after: The changed one.
        masses: {joint: factor on the mass of the body that it moves}; ``""``: the base.
        offsets: {joint: (3,) of its centre of mass, in the axes of the URDF's link (m)}.

    Raises:
        ModelError: If not.
    """
    config, bodies = Configuration(before, before.neutral()), map_joint_bodies(before)
    links = UrdfTree.of(before.description.urdf).moved_links
    for joint in {**masses, **offsets}:
        body, link = bodies.get(joint, before.mj_base), links.get(joint, before.base)
        factor = masses.get(joint, 1.0)
        asked = config.frame_rotation(link) @ offsets.get(joint, np.zeros(3))
        pairs = zip(_weights(before, joint, body), _weights(after, joint, body), strict=True)
        for (old, old_com), (new, com) in pairs:
            if abs(new - factor * old) > _TOLERANCE * abs(factor * old) + 1e-15:
                problem = diagnose(
                    "mass-became-another", body=body, new=new, old=old, factor=factor
                )
            elif joint in offsets and np.abs(com - old_com - asked).max() > _TOLERANCE:
                moved = Vector(tuple(com - old_com), "m")
                problem = diagnose(
                    "com-moved-otherwise", body=body, moved=moved, asked=Vector(tuple(asked), "m")
                )
            else:
                continue
            raise ModelError(before.description.mjcf_source, problem)


def _weights(robot: Robot, joint: str, body: str) -> Iterator[tuple[float, Array]]:
    """Yields what a body weighs with all that is fixed to it (kg), and its com (m), by each engine.

    The com is in the world, in the pose of zeros.
    """
    number = robot.pin_model.getJointId(joint) if joint else int(robot.floating)
    own, data = robot.pin_model.inertias[number], robot.pin_model.createData()
    pin.forwardKinematics(robot.pin_model, data, robot.pin_convention.q(robot.neutral()))
    yield float(own.mass), data.oMi[number].act(own.lever)
    model, data = robot.mj_model, robot.placed()
    welded = model.body_weldid == model.body_weldid[model.body(body).id]
    mass = model.body_mass[welded]
    yield float(mass.sum()), mass @ data.xipos[welded] / mass.sum()


def with_friction(robot: Robot, friction: float) -> Robot:
    """Returns a robot whose feet have a coefficient of sliding friction on the ground.

    Floor and feet get the same, so that the greater of the two, or that of the higher priority, is
    it.

    Raises:
        ConfigurationError: If the coefficient is negative, or a foot's contact has no friction.
    """
    if not 0 <= friction < math.inf:
        raise ConfigurationError("friction", diagnose("friction-not-valid", friction=friction))
    bare = [foot for foot, one in robot.contacts.items() if one.condim == 1]
    if bare:
        problem = diagnose("contacts-frictionless", feet=bare)
        raise ConfigurationError("friction", problem)
    spec = robot.description.mjcf.copy()
    compile_spec(spec, robot.description.mjcf_source)  # numbers the geoms
    feet = set(robot.foot_geoms)
    for geom in spec.geoms:
        if geom.id in feet or geom.parent.name == "world":
            sliding = np.array(geom.friction)
            sliding[0] = friction
            geom.friction = sliding
    return rebuild_robot(robot, mjcf=spec)


def with_gains(
    robot: Robot, kp: float | None, kd: float | None, factors: Mapping[str, float]
) -> Robot:
    """Returns a robot with other gains of its servos, in its MJCF and its MuJoCo model.

    Args:
        robot: The robot.
        kp: Stiffness (N m/rad); the model's own if None.
        kd: Damping (N m s/rad); the model's own if None.
        factors: {``kp:PATTERN`` or ``kd:PATTERN``: factor} on these.

    Raises:
        ConfigurationError: If a gain is out of its range.
        UnknownNameError: If a pattern matches nothing.
        ModelError: If a joint has no servo, and kp and kd are not both given.
    """
    drive = model_with_servos(robot, kp, kd)
    gains = {"kp": drive.kp.copy(), "kd": drive.kd.copy()}
    for name, factor in factors.items():
        named = VariablePattern.parse(name)
        if named is not None and named.kind in SERVO_KINDS:
            chosen = np.isin(robot.joint_names, match_joints(robot, named))
            gains[named.kind][chosen] *= factor
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
    """Returns a description without what is only looked at: it moves and touches alike.

    Shapes that touch nothing go, where the body's mass is not theirs; and so do meshes that
    nothing uses then, and textures. Models of many meshes compile several times as fast.
    """
    spec = description.mjcf.copy()
    kept = {geom for geom, _ in description.foot_geoms.values()}
    kept |= {frame for _, frame in description.contact_points.values()}
    for geom in list(spec.geoms):
        touches = geom.contype or geom.conaffinity
        pairs = any(geom.name in (pair.geomname1, pair.geomname2) for pair in spec.pairs)
        if not touches and not pairs and geom.name not in kept and _weightless(geom):
            spec.delete(geom)
    used = {geom.meshname for geom in spec.geoms}
    for mesh in list(spec.meshes):
        if mesh.name not in used:
            spec.delete(mesh)
    for material in spec.materials:  # which default classes may name: they stay
        material.textures = [""] * len(material.textures)
    for texture in list(spec.textures):
        spec.delete(texture)
    return replace(description, mjcf=spec)


def _weightless(geom: mujoco.MjsGeom) -> bool:
    return bool(geom.parent.name == "world" or geom.parent.explicitinertial or geom.mass == 0)


# Bodies whose centres of mass are elsewhere, in a robot's URDF and its MJCF alike.


def move_coms(robot: Robot, trees: tuple[UrdfTree, SpecTree], offsets: Mapping[str, Array]) -> None:
    """Moves centres of mass in both files, in place.

    What is fixed to a link moves with it, each part by the same offset in the world, so that the
    whole's centre moves by it, and no inertia about a centre of mass changes.

    Args:
        robot: The robot of which the files are: its links are turned as its pose of zeros has them.
        trees: Of the URDF and of the MJCF.
        offsets: {joint: (3,) m, in the axes of the URDF's link that it moves}; ``""``: the base.
    """
    config, data = Configuration(robot, robot.neutral()), mujoco.MjData(robot.mj_model)
    robot.mj_convention.set_state(data, robot.neutral())
    mujoco.mj_kinematics(robot.mj_model, data)
    urdf, mjcf = trees
    for joint, offset in offsets.items():
        link = urdf.moved_by(joint) or robot.base
        moved = config.frame_rotation(link) @ offset
        for one in urdf.fixed_group(link):
            urdf.move_com(one, config.frame_rotation(one).T @ moved)
        for one in mjcf.fixed_group(mjcf.moved_by(joint) or robot.mj_base):
            mjcf.move_com(one, data.body(one).xmat.reshape(3, 3).T @ moved)
