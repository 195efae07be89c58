"""Which body of an MJCF is the robot's, where there is more in it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import replace

import mujoco
import numpy as np

from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.errors import ModelError, UnknownNameError
from pupper_analysis.models.mjcf import JointKind, compile_spec
from pupper_analysis.models.mjcf_file import MjcfFile


def find_root(file: MjcfFile, model: mujoco.MjModel) -> int:
    """Returns the id of the body that is the robot's base, or carries all its joints.

    A body that only floats is a ball or a box to play with, if there is anything else; and one
    robot on a free base goes before what else moves in the world: doors, drawers.

    Raises:
        ModelError: If there are several robots, or none.
    """
    joints = Counter(int(model.body_rootid[body]) for body in model.jnt_bodyid)
    floating = model.jnt_bodyid[model.jnt_type == JointKind.FREE]
    free = Counter(int(model.body_rootid[body]) for body in floating)
    robots = {root: count - free[root] for root, count in joints.items() if count > free[root]}
    walking = {root: count for root, count in robots.items() if free[root]}
    found = sorted(walking if len(walking) == 1 else robots or free)
    if not found:
        raise ModelError(file.path, diagnose("no-joints"))
    if not robots and len(found) > 1:
        raise ModelError(file.path, diagnose("several-free-bodies"))
    if len(found) > 1:
        some = [
            diagnose(
                "robot-of-several", subject=("body", model.body(root).name), joints=robots[root]
            )
            for root in found
        ]
        raise ModelError(file.path, diagnose("several-robots", robots=some))
    [root] = found
    carried = [int(body) for body in floating if model.body_rootid[body] == root]
    return carried[0] if carried else root


def with_one_robot(file: MjcfFile, body: str | None = None) -> MjcfFile:
    """Returns an MJCF in which nothing moves but one robot.

    What is left out goes with its joints, actuators, sensors and couplings, and out of the
    keyframes; what stands fast in the world stays.

    Args:
        file: The MJCF, not changed.
        body: The robot's root, or any body of it; None: it is found, see ``find_root``.

    Raises:
        ModelError: If there are several robots, or none.
        UnknownNameError: If there is no such body.
    """
    model = file.model
    if body is None:
        root = int(model.body_rootid[find_root(file, model)])
    else:
        names = [model.body(index).name for index in range(1, model.nbody)]
        if body not in names:
            raise UnknownNameError(str(file.path), "body", body, names)
        root = int(model.body_rootid[model.body(body).id])
        own = model.body_rootid[model.jnt_bodyid[model.jnt_type != JointKind.FREE]]
        if root not in own:
            raise ModelError(file.path, diagnose("body-without-joints", subject=("body", body)))
    moving = {int(model.body_rootid[index]) for index in model.jnt_bodyid}
    others = sorted(moving - {root})
    if not others:
        return file
    spec = file.spec.copy()
    for number, actuator in enumerate(spec.actuators):
        actuator.name = actuator.name or f"actuator {number}"
    tops = {index: top for index, top in _tops(spec, model).items() if index in others}
    gone = {body.name for body in _below(tops.values())}
    for seeing in (*spec.cameras, *spec.lights):
        if seeing.targetbody in gone:  # MuJoCo takes away what else refers to a body
            spec.delete(seeing)
    for top in tops.values():
        spec.delete(top)
    kept = {actuator.name for actuator in spec.actuators}
    actuators = [index for index in range(model.nu) if _name(model, index) in kept]
    places = _places(model, root)
    keys = [model.key(index) for index in range(model.nkey)]
    for key in list(spec.keys):
        spec.delete(key)
    for key in keys:
        spec.add_key(name=key.name, qpos=key.qpos[places], ctrl=key.ctrl[actuators])
    message = diagnose("others-left-out", bodies=[model.body(index).name for index in others])
    notes: tuple[Diagnostic, ...] = (*file.notes, message)
    return replace(file, spec=spec, notes=notes, _model=compile_spec(spec.copy(), file.path))


def _name(model: mujoco.MjModel, actuator: int) -> str:
    return model.actuator(actuator).name or f"actuator {actuator}"


def _below(bodies: Iterable[mujoco.MjsBody]) -> Iterator[mujoco.MjsBody]:
    for body in bodies:
        yield body
        yield from _below(body.bodies)


def _tops(spec: mujoco.MjSpec, model: mujoco.MjModel) -> dict[int, mujoco.MjsBody]:
    """Returns {id: body} of those that stand in the world, in the order in which both have them."""
    ids = np.flatnonzero(model.body_parentid[1:] == 0) + 1
    return dict(zip(map(int, ids), spec.worldbody.bodies, strict=True))


def _places(model: mujoco.MjModel, root: int) -> list[int]:
    """Returns the places in qpos of the joints of what a body carries."""
    sizes = {JointKind.FREE: 7, JointKind.BALL: 4}
    return [
        int(model.jnt_qposadr[joint]) + offset
        for joint in range(model.njnt)
        if model.body_rootid[model.jnt_bodyid[joint]] == root
        for offset in range(sizes.get(JointKind(int(model.jnt_type[joint])), 1))
    ]
