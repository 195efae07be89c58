"""Factors on a robot's numbers and offsets of them, by name, in its URDF and its MJCF alike."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError, ModelError
from pupper_analysis.models.attributes import BY_KIND, BY_MJCF
from pupper_analysis.models.description import Description
from pupper_analysis.models.model_tree import ModelTree
from pupper_analysis.models.xml import to_text
from pupper_analysis.robot.build import rebuild_robot
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import model_with_servos
from pupper_analysis.tools.study.com import check_coms, move_coms
from pupper_analysis.tools.study.named import (
    AXES,
    BODIES,
    SERVOS,
    Named,
    bodies_of,
    joints_of,
)

Array = NDArray[np.float64]

_MASS_TOLERANCE = 1e-9
"""Relative: two models that were given the same factors agree to rounding."""


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
        named = Named.of(name)
        assert named is not None
        if named.kind in AXES:
            _add_offsets(offsets, robot, name, named, factor)
            continue
        least = "> 0" if named.kind in (*BODIES, *SERVOS) else ">= 0"
        if not math.isfinite(factor) or factor < 0 or (factor == 0 and least == "> 0"):
            raise ConfigurationError(
                name, diagnose("factor-out-of-range", factor=factor, least=least)
            )
        if named.kind not in SERVOS:
            for joint in joints_of(robot, named):
                own = wanted.setdefault(named.kind, {})
                own[joint] = own.get(joint, 1.0) * factor
    if not wanted and not offsets:
        return robot
    urdf, mjcf = robot.description.trees()
    sides: tuple[tuple[ModelTree, str], ...] = ((urdf, robot.base), (mjcf, robot.mj_base))
    for kind, joints in wanted.items():
        for joint, factor in joints.items():
            for tree, base in sides:
                _scale(tree, tree.moved_by(joint) or base, kind, joint, factor, robot)
    if offsets:
        move_coms(robot, (urdf, mjcf), offsets)
    built = rebuild_robot(robot, urdf=to_text(urdf.root), mjcf=mjcf.spec)
    _check(robot, built, wanted.get("mass", {}))
    if offsets and "mass" not in wanted:  # which move the whole's, too
        check_coms(robot, built, offsets)
    return built


def _add_offsets(
    offsets: dict[str, Array], robot: Robot, name: str, named: Named, offset: float
) -> None:
    if not math.isfinite(offset):
        raise ConfigurationError(name, diagnose("offset-not-finite", offset=offset))
    for joint in joints_of(robot, named):
        if not joint and not robot.floating:
            raise ConfigurationError(name, diagnose("com-of-fixed-base"))
        offsets.setdefault(joint, np.zeros(3))[AXES.index(named.kind)] += offset


def _scale(tree: ModelTree, link: str, kind: str, joint: str, factor: float, robot: Robot) -> None:
    """Scales a number in one of a robot's files; what is fixed to a link scales with it."""
    if kind not in BODIES:
        tree.scale(joint, BY_KIND.get(kind) or BY_MJCF[kind], factor)
        return
    for one in tree.fixed_group(link):
        try:
            (tree.scale_mass if kind == "mass" else tree.scale_inertia)(one, factor)
        except ValueError as error:
            told = diagnose("inertia-follows-geoms", body=one)
            raise ModelError(robot.description.mjcf_source, told) from error


def _check(before: Robot, after: Robot, factors: Mapping[str, float]) -> None:
    """Checks that the masses of both models have become what was asked for."""
    bodies = bodies_of(before)
    for joint, factor in factors.items():
        body = before.mj_model.body(bodies[joint] if joint else before.mj_base).id
        number = before.pin_model.getJointId(joint) if joint else int(before.floating)
        pairs = [
            (_welded_mass(one.mj_model, body), float(one.pin_model.inertias[number].mass))
            for one in (before, after)
        ]
        for old, new in zip(*pairs, strict=True):
            if abs(new - factor * old) > _MASS_TOLERANCE * abs(factor * old) + 1e-15:
                name = bodies.get(joint, before.mj_base)
                problem = diagnose(
                    "mass-became-another", body=name, new=new, old=old, factor=factor
                )
                raise ModelError(before.description.mjcf_source, problem)


def _welded_mass(model: mujoco.MjModel, body: int) -> float:
    return float(model.body_mass[model.body_weldid == model.body_weldid[body]].sum())


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
    spec.compile()  # numbers the geoms
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
        named = Named.of(name)
        if named is not None and named.kind in SERVOS:
            chosen = np.isin(robot.joint_names, joints_of(robot, named))
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
