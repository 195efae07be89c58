"""MuJoCo model of a robot on slopes and steps, and with welds to the world.

Input: a robot with a level floor, the ground of a task (`Ground`), and contact positions.
`build_on_ground` returns a robot with a tilted floor, with a box, plane or cylinder under each foot
on a step, plane or bar, and with equality constraints for welds and grips. Contact bits decide
which foot touches which geom. `close_welds` activates the welds at a configuration in equilibrium.
"""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.arrays import quaternion_from_rotation
from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.errors import ModelError
from pupper_analysis.models.mjcf import GEOM_CONTACT_WORDS, add_geom, compile_spec
from pupper_analysis.models.spec_tree import SpecTree
from pupper_analysis.robot.build import rebuild_robot
from pupper_analysis.robot.contact import ContactParameters, ground_geom, list_contact_bodies
from pupper_analysis.robot.floor import find_floor, is_fixed, merge_planes, rotate_floor
from pupper_analysis.robot.ground import Ground
from pupper_analysis.robot.plane import PLANE_NORMALS, describe_surface
from pupper_analysis.robot.robot import Robot, Touching


def build_on_ground(robot: Robot, ground: Ground, places: Mapping[str, Array]) -> Robot:
    """Add the ground and the welds of a stand task to a robot's MuJoCo model; return a copy.

    The floor is tilted. A box is added for each step or plane, and a cylinder for each bar, with
    the contact parameters of the floor or of the task. Collisions that the task does not intend are
    disabled, for example between a foot on a step and the floor: in a pit, the foot is below the
    floor. A sole collides with a plane on top of its box, because MuJoCo would place the contacts
    with the box at other points.

    Welds to the world are inactive until ``close_welds``. On level ground without welds and grips,
    the result is ``robot`` itself.

    Args:
        robot: Robot. If the ground is not level, a missing floor is added.
        ground: Slope and steps.
        places: {contact point: sphere centre (3,) [m] in the world frame}, computed for rigid
            ground, also for lifted feet. The steps are placed below these points.

    Raises:
        ModelError: If the MJCF has not enough unused bits of ``contype``, or the model cannot be
            built.
    """
    if ground.is_level and not robot.fixed_parts:
        return robot
    spec = robot.description.mjcf.copy()
    if not ground.is_level:
        _add_ground(robot, spec, ground, places)
    _add_welds(robot, spec)
    return replace(rebuild_robot(robot, mjcf=spec), fingerprint=robot.fingerprint)


def _add_welds(robot: Robot, spec: mujoco.MjSpec) -> None:
    """Add inactive welds (``connect`` for grips); exclude contacts of the parts with the world."""
    model, tree = robot.mj_model, SpecTree(spec)
    for name, point in robot.fixed_parts.items():
        body = model.body(robot.mj_base if point is None else robot.contact_places[point][0]).name
        kind = mujoco.mjtEq.mjEQ_CONNECT if name in robot.grips else mujoco.mjtEq.mjEQ_WELD
        weld = spec.add_equality(name=weld_name(name), type=kind, name1=body)
        weld.objtype, weld.active = mujoco.mjtObj.mjOBJ_BODY, False
        weld.solref, weld.solimp[:2] = (2 * float(spec.option.timestep), 1.0), mujoco.mjMAXIMP
        fixed_bodies = {geom.parent.name for geom in spec.geoms if is_fixed(geom.parent)} | {
            "world"
        }
        for welded_body in tree.fixed_group(body):
            for fixed_body in fixed_bodies:
                tree.exclude_contact(welded_body, fixed_body)


def weld_name(name: str) -> str:
    """Return the name of the MuJoCo equality constraint that fixes a robot part to the world."""
    return f"weld_{name}"


def close_welds(
    robot: Robot, model: mujoco.MjModel, qpos: Array, pushes: Mapping[str, Array]
) -> None:
    """Activate the welds and grips of a task in a MuJoCo model at a configuration, in place.

    MuJoCo's constraints are soft. The target pose of each weld or grip is offset by its deflection
    under load, so that the configuration is an equilibrium.

    Args:
        robot: Result of ``build_on_ground``.
        model: Model of the robot, or a copy with servos.
        qpos: Configuration, shape (nq,).
        pushes: {welded or gripping part: generalised force (nv,) [N, N m] that the weld must exert
            on the robot, in the order of qvel}.
    """
    welds = {name: model.equality(weld_name(name)).id for name in robot.fixed_parts}
    if not welds:
        return
    data = mujoco.MjData(model)
    robot.mj_convention.set_state(data, qpos)
    mujoco.mj_kinematics(model, data)
    for name, weld_id in welds.items():
        if name in robot.grips:
            model.eq_data[weld_id, :3] = robot.contact_places[robot.feet[name][0]][1]
        _place_weld(model, data, weld_id, np.zeros(6))
        model.eq_active0[weld_id] = 1
    data = mujoco.MjData(model)
    robot.mj_convention.set_state(data, qpos)
    mujoco.mj_forward(model, data)
    for name, weld_id in welds.items():
        rows = _find_rows(data, weld_id)
        jacobian, selection = np.zeros((len(rows), model.nv)), np.zeros((len(rows), data.nefc))
        selection[np.arange(len(rows)), rows] = 1.0
        for jacobian_row, selected in zip(jacobian, selection, strict=True):
            mujoco.mj_mulJacTVec(model, data, jacobian_row, selected)
        generalised_force = pushes[name]
        forces = np.linalg.lstsq(jacobian[:, robot.mj_convention.qvel_index].T, generalised_force)[
            0
        ]
        stiffness, impedance = data.efc_KBIP[rows, 0], data.efc_KBIP[rows, 2]
        _place_weld(model, data, weld_id, -forces / (data.efc_D[rows] * stiffness * impedance))


def weld_forces(robot: Robot, model: mujoco.MjModel, data: mujoco.MjData) -> dict[str, Array]:
    """Return the force of the world on each welded or gripping part of the robot.

    Args:
        robot: Robot with the contacts of the task.
        model: Model with the ground and the active welds of the task (`build_on_ground`,
            `close_welds`).
        data: Data after ``mj_forward`` or a step.

    Returns:
        {foot, link or base: force, shape (3,) [N], in world axes}.
    """
    welds = {name: model.equality(weld_name(name)).id for name in robot.fixed_parts}
    return {name: data.efc_force[_find_rows(data, weld_id)[:3]] for name, weld_id in welds.items()}


def find_touched_surface(
    model: mujoco.MjModel, data: mujoco.MjData, body: str
) -> Diagnostic | None:
    """Name the surface of a task, such as a step, wall or bar, that a body touches, for messages.

    Args:
        model: Model with the ground of a task (`build_on_ground`).
        data: Data after ``mj_collision``.
        body: Name of the body.

    Returns:
        Kind of the surface, with its foot or hand, such as "wall of left_palm". None without such a
        surface, or if the body touches another geom of the world body, such as the floor.
    """
    body_id, surface = model.body(body).id, None
    all_bodies = list_contact_bodies(model, data).tolist()
    for pair, bodies in zip(data.contact.geom.tolist(), all_bodies, strict=True):
        if sorted(bodies) != [0, body_id]:
            continue
        geom = pair[bodies.index(0)]
        prefix, _, foot = model.geom(geom).name.partition("_")
        if prefix not in (_STEP_PREFIX, _TOP_PREFIX):
            return None
        surface = describe_surface(_find_surface_kind(model, geom), foot)
    return surface


def _find_surface_kind(model: mujoco.MjModel, geom: int) -> str:
    """Name the kind of a surface geom: step, bar, wall, table or ceiling; empty for another.

    A surface that is parallel to the ground plane counts as a step.
    """
    if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_CYLINDER.value:
        return "bar"
    normals = np.zeros((2, 3))
    ground = ground_geom(model)
    for normal, of in zip(normals, (geom, geom if ground is None else ground), strict=True):
        mujoco.mju_rotVecQuat(normal, np.array([0.0, 0.0, 1.0]), model.geom_quat[of])
    if np.allclose(normals[0], normals[1], atol=_NORMAL_ATOL):
        return "step"
    kinds = (
        kind
        for kind, out in PLANE_NORMALS.items()
        if np.allclose(normals[0], out, atol=_NORMAL_ATOL)
    )
    return next(kinds, "")


_NORMAL_ATOL = 1e-6
"""Absolute tolerance of the components of two unit normals [1] that count as equal. It exceeds the
rounding errors of quaternions. Chosen, not tuned."""

_STEP_PREFIX, _TOP_PREFIX = "step", "top"
"""Prefix of the geom name of a step, plane or bar, and of the plane on top of a box. An underscore
and the name of the foot follow."""


def _find_rows(data: mujoco.MjData, equality: int) -> NDArray[np.int64]:
    """Return the rows of an equality in MuJoCo's ``efc_`` arrays; translations before rotations."""
    is_equality = data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY.value
    return np.flatnonzero(is_equality & (data.efc_id == equality))


def _place_weld(model: mujoco.MjModel, data: mujoco.MjData, number: int, violation: Array) -> None:
    """Set the target pose of a weld, so that the weld has a given violation at the present pose.

    Args:
        model: Model to modify.
        data: Data with kinematics.
        number: Id of the equality constraint: a weld, or a ``connect`` for a grip.
        violation: Constraint violation (6,): translation [m], then half of the rotation vector
            [rad], as in the vector part of a quaternion; both in world axes. For a grip, the
            translation (3,) is sufficient.
    """
    body, relative_quaternion, inverse_quaternion = (
        int(model.eq_obj1id[number]),
        np.zeros(4),
        np.zeros(4),
    )
    if model.eq_type[number] == mujoco.mjtEq.mjEQ_CONNECT.value:
        anchor = data.xpos[body] + data.xmat[body].reshape(3, 3) @ model.eq_data[number, :3]
        model.eq_data[number, 3:6] = anchor - violation[:3]
        return
    mujoco.mju_negQuat(inverse_quaternion, data.xquat[body])
    mujoco.mju_mulQuat(relative_quaternion, inverse_quaternion, np.array([1.0, *violation[3:]]))
    mujoco.mju_normalize4(relative_quaternion)
    model.eq_data[number, :3] = data.xpos[body] - violation[:3]
    model.eq_data[number, 3:6], model.eq_data[number, 6:10] = 0.0, relative_quaternion
    model.eq_data[number, 10] = 1.0


def _add_ground(
    robot: Robot, spec: mujoco.MjSpec, ground: Ground, places: Mapping[str, Array]
) -> None:
    """Tilt the floor, and add the box or cylinder under each foot (`Ground.steps`), in place."""
    floor = find_floor(spec) or SpecTree(spec).add_floor()
    merge_planes(spec, floor)
    rotate_floor(floor, quaternion_from_rotation(ground.rotation()))
    steps = ground.steps(places)
    soles = [foot for foot in steps if len(robot.feet[foot]) > 1]
    exclusive_feet = [
        *soles,
        *(foot for foot in steps if foot in robot.hands and foot not in robot.grips),
    ]
    contype, conaffinity = floor.contype, floor.conaffinity
    exclusive_bits = _separate_from_floor(robot, spec, floor, steps, exclusive_feet)
    max_priority = max(int(geom.priority) for geom in spec.geoms)
    for foot, step in steps.items():
        box = add_geom(
            spec.worldbody,
            name=f"{_STEP_PREFIX}_{foot}",
            type=mujoco.mjtGeom.mjGEOM_CYLINDER if step.round else mujoco.mjtGeom.mjGEOM_BOX,
            size=np.take(step.half, (0, 2, 2)) if step.round else step.half,
            pos=step.centre,
            quat=step.quaternion,
            contype=contype,
            conaffinity=conaffinity,
            rgba=(0.6, 0.62, 0.66, 1.0),
        )
        _copy_floor_contact(box, floor)
        if foot in robot.hands or foot in robot.grips:
            box.contype, box.conaffinity = 0, exclusive_bits.get(foot, 0)
        if foot in soles:
            box.contype, box.conaffinity = 0, floor.conaffinity
            top = add_geom(
                spec.worldbody,
                name=f"{_TOP_PREFIX}_{foot}",
                type=mujoco.mjtGeom.mjGEOM_PLANE,
                size=(*step.half[:2], 0.01),
                pos=step.top,
                quat=step.quaternion,
                contype=0,
                conaffinity=exclusive_bits[foot],
                rgba=(0.0, 0.0, 0.0, 0.0),
            )
            _copy_floor_contact(top, floor)
            box = top
        if robot.touching.get(foot, Touching()).friction is not None:
            _set_contact(box, robot.contacts[robot.feet[foot][0]], max_priority + 1)


def _set_contact(geom: mujoco.MjsGeom, parameters: ContactParameters, priority: int) -> None:
    """Set the priority and the contact parameters of a geom, without the margin, in place."""
    geom.priority, geom.condim = priority, parameters.condim
    geom.friction = np.take(parameters.friction, (0, 2, 3))
    geom.solref, geom.solimp = parameters.solref, parameters.solimp


def _copy_floor_contact(geom: mujoco.MjsGeom, floor: mujoco.MjsGeom) -> None:
    """Copy friction, solref, margin etc. of the floor to a geom, but no contact bits and group."""
    for word in GEOM_CONTACT_WORDS:
        if word not in ("contype", "conaffinity", "group"):
            setattr(geom, word, getattr(floor, word))


def _separate_from_floor(
    robot: Robot,
    spec: mujoco.MjSpec,
    floor: mujoco.MjsGeom,
    feet: Container[str],
    alone: Sequence[str],
) -> dict[str, int]:
    """Disable contacts between the floor and ``feet``, by new contact bits, in place.

    Returns {foot in ``alone``: bit of ``contype`` that only geoms of this foot have}. A ModelError
    is raised if the MJCF has not enough unused bits.
    """
    compile_spec(spec, Path(spec.modelname))  # sets the ids of the geoms
    geoms = [geom for geom in spec.geoms if geom.id != floor.id]
    floor_contacts = {
        geom.id
        for geom in geoms
        if geom.contype & floor.conaffinity or geom.conaffinity & floor.contype
    }
    used_bits = floor.contype | floor.conaffinity
    for geom in geoms:
        used_bits |= geom.contype | geom.conaffinity
    free_bits = [1 << bit for bit in range(31) if not used_bits & 1 << bit]
    if len(free_bits) < 1 + len(alone):
        needed = 1 + len(alone)
        problem = diagnose("bits-used-up", left=len(free_bits), feet=len(alone), needed=needed)
        raise ModelError(robot.description.mjcf_source, problem)
    bit_by_foot = dict(zip(alone, free_bits[1:], strict=False))
    floor.contype, floor.conaffinity = 0, free_bits[0]
    for geom in geoms:
        foot = robot.foot_geoms.get(geom.id)
        if foot in bit_by_foot:  # geoms of hands collide with nothing else
            geom.contype |= bit_by_foot[foot]
        elif foot not in feet and geom.id in floor_contacts:
            geom.contype |= free_bits[0]
    return bit_by_foot
