"""A robot's MuJoCo model on slopes and steps."""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from dataclasses import replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.arrays import quaternion_from_rotation
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ModelError
from pupper_analysis.models.mjcf import GEOM_CONTACT_WORDS
from pupper_analysis.models.spec_tree import SpecTree
from pupper_analysis.robot.build import rebuild_robot
from pupper_analysis.robot.contact import ContactParameters
from pupper_analysis.robot.floor import floor_of, is_fixed, turn_floor
from pupper_analysis.robot.ground import Ground
from pupper_analysis.robot.robot import Robot, Touching

Array = NDArray[np.float64]


def on_ground(robot: Robot, ground: Ground, places: Mapping[str, Array]) -> Robot:
    """Puts a robot on a slope or on steps, in its MuJoCo model.

    Args:
        robot: The robot; its MJCF has a floor.
        ground: The slope and the steps.
        places: {contact point: (3,) where its centre will be, lifted or not, on rigid ground (m)},
            for the steps.

    Returns:
        The same robot, whose MuJoCo model has the floor turned and a box for each step. The steps
        have the floor's contact parameters. A foot on a step does not touch the floor, into which
        it would sink through a low one, and which covers a step down. A flat foot touches a plane
        on top of its box, which only it does: MuJoCo's contacts of a sole with a plane are other
        than those with a box, and its contact points are those with a plane. What a hand touches
        only its ball does: its own shapes are around it.

        What is welded touches neither, and has a weld to the world, which ``close_welds`` closes.

    Raises:
        ModelError: If the MJCF leaves no bits of ``contype`` for that.
    """
    if ground.level and not robot.welds:
        return robot
    spec = robot.description.mjcf.copy()
    if not ground.level:
        _put_ground(robot, spec, ground, places)
    _put_welds(robot, spec)
    return replace(rebuild_robot(robot, mjcf=spec), fingerprint=robot.fingerprint)


def _put_welds(robot: Robot, spec: mujoco.MjSpec) -> None:
    """Adds welds to the world, which are open, of what touches nothing else of it."""
    model, tree = robot.mj_model, SpecTree(spec)
    for name, point in robot.welds.items():
        body = model.body(robot.mj_base if point is None else robot.contact_places[point][0]).name
        kind = mujoco.mjtEq.mjEQ_CONNECT if name in robot.grips else mujoco.mjtEq.mjEQ_WELD
        weld = spec.add_equality(name=weld_name(name), type=kind, name1=body)
        weld.objtype, weld.active = mujoco.mjtObj.mjOBJ_BODY, False
        weld.solref, weld.solimp[:2] = (2 * float(spec.option.timestep), 1.0), mujoco.mjMAXIMP
        still = {geom.parent.name for geom in spec.geoms if is_fixed(geom.parent)} | {"world"}
        for one in tree.fixed_group(body):
            for other in still:
                tree.exclude_contact(one, other)


def weld_name(name: str) -> str:
    """Returns what the weld of a part is called in MuJoCo."""
    return f"weld_{name}"


def close_welds(
    robot: Robot, model: mujoco.MjModel, qpos: Array, pushes: Mapping[str, Array]
) -> None:
    """Closes the welds of a model, in place, where a configuration has them.

    MuJoCo's constraints are soft: each is put as far off as it gives way, nanometres, so that what
    it holds is exactly there.

    Args:
        robot: The robot, put ``on_ground``.
        model: Its model, or a copy with servos.
        qpos: (nq,) the configuration.
        pushes: {what is welded: (nv,) the generalised force of its weld}.
    """
    welds = {name: model.equality(weld_name(name)).id for name in robot.welds}
    if not welds:
        return
    data = mujoco.MjData(model)
    robot.mj_convention.set_state(data, qpos)
    mujoco.mj_kinematics(model, data)
    for name, number in welds.items():
        if name in robot.grips:
            model.eq_data[number, :3] = robot.contact_places[robot.feet[name][0]][1]
        _place_weld(model, data, number, np.zeros(6))
        model.eq_active0[number] = 1
    data = mujoco.MjData(model)
    robot.mj_convention.set_state(data, qpos)
    mujoco.mj_forward(model, data)
    for name, number in welds.items():
        rows = _rows(data, number)
        moved, chosen = np.zeros((len(rows), model.nv)), np.zeros((len(rows), data.nefc))
        chosen[np.arange(len(rows)), rows] = 1.0
        for row, one in zip(moved, chosen, strict=True):
            mujoco.mj_mulJacTVec(model, data, row, one)
        push = pushes[name]
        forces = np.linalg.lstsq(moved[:, robot.mj_convention.qvel_index].T, push)[0]
        stiff, impedance = data.efc_KBIP[rows, 0], data.efc_KBIP[rows, 2]
        _place_weld(model, data, number, -forces / (data.efc_D[rows] * stiff * impedance))


def weld_forces(robot: Robot, model: mujoco.MjModel, data: mujoco.MjData) -> dict[str, Array]:
    """Returns {what is welded, or grips: (3,) the force of its constraint on it} (N)."""
    welds = {name: model.equality(weld_name(name)).id for name in robot.welds}
    return {name: data.efc_force[_rows(data, number)[:3]] for name, number in welds.items()}


def _rows(data: mujoco.MjData, number: int) -> NDArray[np.int64]:
    """Returns the rows of an equality constraint; ways come before turns."""
    own = data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY.value
    return np.flatnonzero(own & (data.efc_id == number))


def _place_weld(model: mujoco.MjModel, data: mujoco.MjData, number: int, opened: Array) -> None:
    """Puts a weld where its body is, but for what it is open by (6,), way and half of the turn.

    Of a grip, where the point of its body is: by a way (3,).
    """
    body, turn, own = int(model.eq_obj1id[number]), np.zeros(4), np.zeros(4)
    if model.eq_type[number] == mujoco.mjtEq.mjEQ_CONNECT.value:
        place = data.xpos[body] + data.xmat[body].reshape(3, 3) @ model.eq_data[number, :3]
        model.eq_data[number, 3:6] = place - opened[:3]
        return
    mujoco.mju_negQuat(own, data.xquat[body])
    mujoco.mju_mulQuat(turn, own, np.array([1.0, *opened[3:]]))
    mujoco.mju_normalize4(turn)
    model.eq_data[number, :3] = data.xpos[body] - opened[:3]
    model.eq_data[number, 3:6], model.eq_data[number, 6:10] = 0.0, turn
    model.eq_data[number, 10] = 1.0


def _put_ground(
    robot: Robot, spec: mujoco.MjSpec, ground: Ground, places: Mapping[str, Array]
) -> None:
    """Turns the floor, and puts steps and planes into a model; see ``on_ground``."""
    floor = floor_of(spec) or SpecTree(spec).add_floor()
    turn_floor(floor, quaternion_from_rotation(ground.rotation()))
    steps = ground.steps(places)
    soles = [foot for foot in steps if len(robot.feet[foot]) > 1]
    alone = [*soles, *(foot for foot in steps if foot in robot.hands and foot not in robot.grips)]
    contype, conaffinity = floor.contype, floor.conaffinity
    free = _leave_floor(robot, spec, floor, steps, alone)
    highest = max(int(geom.priority) for geom in spec.geoms)
    for foot, step in steps.items():
        box = spec.worldbody.add_geom(
            name=f"step_{foot}",
            type=mujoco.mjtGeom.mjGEOM_CYLINDER if step.round else mujoco.mjtGeom.mjGEOM_BOX,
            size=np.take(step.half, (0, 2, 2)) if step.round else step.half,
            pos=step.centre,
            quat=step.turn,
            contype=contype,
            conaffinity=conaffinity,
            rgba=(0.6, 0.62, 0.66, 1.0),
        )
        _like_floor(box, floor)
        if foot in robot.hands or foot in robot.grips:
            box.contype, box.conaffinity = 0, free.get(foot, 0)
        if foot in soles:
            box.contype, box.conaffinity = 0, floor.conaffinity
            top = spec.worldbody.add_geom(
                name=f"top_{foot}",
                type=mujoco.mjtGeom.mjGEOM_PLANE,
                size=(*step.half[:2], 0.01),
                pos=step.top,
                quat=step.turn,
                contype=0,
                conaffinity=free[foot],
                rgba=(0.0, 0.0, 0.0, 0.0),
            )
            _like_floor(top, floor)
            box = top
        if robot.touching.get(foot, Touching()).friction is not None:
            _state_contact(box, robot.contacts[robot.feet[foot][0]], highest + 1)


def _state_contact(geom: mujoco.MjsGeom, parameters: ContactParameters, priority: int) -> None:
    """Has contacts with a geom be so, whatever the other one states; margins still add up."""
    geom.priority, geom.condim = priority, parameters.condim
    geom.friction = np.take(parameters.friction, (0, 2, 3))
    geom.solref, geom.solimp = parameters.solref, parameters.solimp


def _like_floor(geom: mujoco.MjsGeom, floor: mujoco.MjsGeom) -> None:
    """Gives a geom the floor's contact parameters, but for what it touches."""
    for word in GEOM_CONTACT_WORDS:
        if word not in ("contype", "conaffinity", "group"):
            setattr(geom, word, getattr(floor, word))


def _leave_floor(
    robot: Robot,
    spec: mujoco.MjSpec,
    floor: mujoco.MjsGeom,
    feet: Container[str],
    alone: Sequence[str],
) -> dict[str, int]:
    """Lets all that touched the floor touch it, except some feet's foot_geoms.

    Returns:
        {foot in ``alone``: the bit of ``contype`` that only its geoms have}.

    Raises:
        ModelError: If the MJCF leaves no bits.
    """
    spec.compile()  # numbers the geoms
    geoms = [geom for geom in spec.geoms if geom.id != floor.id]
    touching = {
        geom.id
        for geom in geoms
        if geom.contype & floor.conaffinity or geom.conaffinity & floor.contype
    }
    taken = floor.contype | floor.conaffinity
    for geom in geoms:
        taken |= geom.contype | geom.conaffinity
    bits = [1 << bit for bit in range(31) if not taken & 1 << bit]
    if len(bits) < 1 + len(alone):
        needed = 1 + len(alone)
        problem = diagnose("bits-used-up", left=len(bits), feet=len(alone), needed=needed)
        raise ModelError(robot.description.mjcf_source, problem)
    own = dict(zip(alone, bits[1:], strict=False))
    floor.contype, floor.conaffinity = 0, bits[0]
    for geom in geoms:
        foot = robot.foot_geoms.get(geom.id)
        if foot in own:  # a hand's touches nothing else
            geom.contype |= own[foot]
        elif foot not in feet and geom.id in touching:
            geom.contype |= bits[0]
    return own
