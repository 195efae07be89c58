"""Free the base of a robot that is fixed in the MJCF, and place the frame of a free base.

Input is the spec of an MJCF. A robot that the file fixes to the world gets a free base, for
example, if there are two or more limbs. The frame of a free base is usually raised to the height of
the base's CoM if no limb ends below the frame. Reason: height, roll and pitch of a stand refer to
this frame.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import mujoco
import numpy as np

from pupper_analysis.base.arrays import (
    make_placement,
    rotation_from_quaternion,
)
from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.base.errors import ModelError
from pupper_analysis.models.mjcf import JointKind, compile_spec, has_free_joint, list_free_joints
from pupper_analysis.models.spec_tree import join_free_base
from pupper_analysis.models.urdf_file import UrdfFile
from pupper_analysis.prepare.contact_points import compute_lowest_height
from pupper_analysis.robot.contact import limb_ends
from pupper_analysis.robot.matching.match import limbs_on_the_world

_GROUND_ATOL = 1e-6
"""Upper bound of the height [m] of a free base's frame above the lowest point of the limb ends, at
which the frame counts as at ground level. `place_base_frame` raises only such a frame. Chosen, not
tuned."""

_MIN_LEVEL_COSINE = 0.7
"""Lower bound of the cosine of the base tilt at the start [1], about 45 deg, with which
`place_base_frame` may raise the base frame. Chosen, not tuned.
"""


def free_base(
    urdf: UrdfFile, spec: mujoco.MjSpec, source: Path
) -> tuple[mujoco.MjSpec, list[Diagnostic]]:
    """Add a free joint to the base of a legged robot that the MJCF fixes to the world.

    A base without joints usually gets a free joint if it has at least two limbs (subtrees with
    joints), or is free in the URDF. A free joint may also replace slides and hinges that move the
    base (`join_free_base`); the keyframes are then deleted.

    Args:
        urdf: URDF.
        spec: Spec of the MJCF; modified in place.
        source: File of the MJCF, for errors.

    Returns:
        The same spec, and a list with a note about the change; the list is empty if nothing
        changed.

    Raises:
        ModelError: If two or more limbs are attached to the world without a base body.
    """
    stated = set(urdf.tree.joints)
    if has_free_joint(spec):
        return spec, []
    joined = join_free_base(spec, stated=stated)
    if joined is not None:
        return spec, [joined]
    if len(limbs_on_the_world(spec, urdf.root)) >= 2:
        raise ModelError(source, diagnose("limbs-on-the-world"))
    bodies = list(spec.worldbody.bodies)
    size = {body.name: len(body.find_all(mujoco.mjtObj.mjOBJ_JOINT)) for body in bodies}
    base = max(bodies, key=lambda body: size[body.name], default=None)
    if base is None or list(base.joints):
        return spec, []
    if len(list(_yield_limbs(base))) < 2 and not states_free_base(urdf):
        return spec, []
    base.add_freejoint()
    return spec, [diagnose("free-joint-added", subject=("body", base.name))]


def states_free_base(urdf: UrdfFile) -> bool:
    """Return True if a massless root link has a single joint, and this joint is floating.

    For example, a URDF of a ``pin.Model`` with a free flyer.
    """
    joints = urdf.tree.child_joints.get(urdf.tree.base.name, [])
    return not urdf.tree.base.mass and [joint.kind for joint in joints] == ["floating"]


def _yield_limbs(base: mujoco.MjsBody) -> Iterator[mujoco.MjsBody]:
    """Yield the first body with joints of each limb that is attached to the base."""
    for body in base.bodies:
        if list(body.joints):
            yield body
        else:
            yield from _yield_limbs(body)


def remove_free_joint_friction(spec: mujoco.MjSpec) -> list[Diagnostic]:
    """Set the dry friction of the free joints of a spec to 0, in place; return notes on changes.

    Reason: dry friction of a free joint would hold a falling robot in the air.
    """
    notes = []
    for joint in spec.joints:
        if joint.type == JointKind.FREE and joint.frictionloss:
            notes.append(diagnose("free-joint-friction-taken-off", friction=joint.frictionloss))
            joint.frictionloss = 0.0
    return notes


def place_base_frame(
    spec: mujoco.MjSpec,
    file: mujoco.MjModel,
    source: Path,
    *,
    insert_visuals: Callable[[mujoco.MjSpec], object] | None = None,
) -> list[Diagnostic]:
    """Raise the frame of a free base to the base's CoM height, if the frame is at ground level.

    Reason: height, roll and pitch of a stand refer to the base frame, with z up. The frame is at
    ground level if no limb ends below the frame. All parts of the robot keep the same positions in
    the world. The frame is not raised if the base is tilted, for example.

    Args:
        spec: Spec of the MJCF, in which all bodies have names; modified in place.
        file: Compiled model of the published file, before the base was freed.
        source: File of the MJCF, for errors.
        insert_visuals: Function that adds the visual meshes to a copy of the spec, if the meshes
            are not loaded yet. None if all meshes are loaded.

    Returns:
        List with a note about the raised frame or about a large tilt; otherwise empty.

    Raises:
        ModelError: If MuJoCo refuses the spec.
    """
    base = next((joint.parent for joint in spec.joints if joint.type == JointKind.FREE), None)
    if base is None or base.frame is not None:
        return []  # the position is relative to a frame element
    body = mujoco.mj_name2id(file, mujoco.mjtObj.mjOBJ_BODY, base.name)
    if body >= 0 and body in file.jnt_bodyid[list_free_joints(file)]:
        model = file
    else:
        complete = spec.copy()
        complete.compiler.discardvisual = False  # a limb may end in visual geoms
        model = compile_spec(complete, source)
        body = model.body(base.name).id
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    rotation, address = (
        data.xmat[body].reshape(3, 3),
        int(model.jnt_qposadr[model.body_jntadr[body]]),
    )
    # The keyframes of a file with a fixed base have no pose of the base.
    has_base_pose = bool(len(list_free_joints(file)))
    keys = sorted(range(model.nkey), key=lambda key: model.key(key).name != "home")
    # Without keyframes: the initial state.
    start_rotation = (
        rotation_from_quaternion(model.key_qpos[keys[0], address + 3 : address + 7])
        if keys and has_base_pose
        else rotation
    )
    if start_rotation[2, 2] < _MIN_LEVEL_COSINE:
        tilt, subject = Quantity(float(np.arccos(start_rotation[2, 2])), "rad"), ("body", base.name)
        key = keys[0] if keys and has_base_pose else None
        name = None if key is None else model.key(key).name or str(key)
        return [diagnose("base-frame-tilted", subject=subject, tilt=tilt, keyframe=name)]
    ends = [end for end in limb_ends(model) if end != body]
    below = np.isin(model.body_weldid[model.geom_bodyid], ends)
    touching = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    bottom = compute_lowest_height(model, data, np.flatnonzero(below & touching).tolist())
    if data.xpos[body][2] > bottom + _GROUND_ATOL:
        return []
    if insert_visuals is None:
        bottom = compute_lowest_height(model, data, np.flatnonzero(below).tolist())
    else:
        bottom = _compute_visual_bottom(spec, ends, insert_visuals, source)
    if data.xpos[body][2] > bottom + _GROUND_ATOL:
        return []
    fixed = model.body_weldid == model.body_weldid[body]  # a root body may have no mass of its own
    com = model.body_mass[fixed] @ data.xipos[fixed] / model.body_mass[fixed].sum()
    rise = float(com[2] - data.xpos[body][2])
    reach = float(np.linalg.norm(data.xpos[ends] - com, axis=1).max(initial=0.0))
    hangs = bottom < com[2] - min(rise, reach) / 2
    if not hangs or rotation[2, 2] < 1 - 1e-9:
        return []
    _raise_frame(spec, base, address, rise, model)
    return [diagnose("base-frame-lifted", subject=("body", base.name), height=Quantity(rise, "m"))]


def _compute_visual_bottom(
    spec: mujoco.MjSpec,
    ends: Sequence[int],
    insert_visuals: Callable[[mujoco.MjSpec], object],
    source: Path,
) -> float:
    """Compute the world height [m] of the lowest point of bodies ``ends``, with visual meshes."""
    complete = spec.copy()
    complete.compiler.discardvisual = False
    insert_visuals(complete)
    model = compile_spec(complete, source)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    geoms = np.isin(model.body_weldid[model.geom_bodyid], ends)
    return compute_lowest_height(model, data, np.flatnonzero(geoms).tolist())


def _raise_frame(
    spec: mujoco.MjSpec, base: mujoco.MjsBody, place: int, up: float, model: mujoco.MjModel
) -> None:
    """Raise the frame of a free base; all elements of the body keep their positions in the world.

    The frame moves by ``up`` [m] along its z axis. The base poses in the keyframes are changed
    accordingly; ``place`` is the index of the base position in qpos.
    """
    offset = np.array([0.0, 0.0, up])
    elements = (*base.geoms, *base.sites, *base.cameras, *base.lights, *base.bodies, *base.frames)
    frame = base.add_frame(pos=-offset)
    for element in elements:
        if element.frame is None:
            element.set_frame(frame)
    if base.explicitinertial:
        base.ipos = base.ipos - offset
    body = model.body(base.name)
    base.pos = make_placement(body.quat, body.pos).act(offset)
    for key in spec.keys:
        qpos = np.array(key.qpos)
        if len(qpos) >= place + 7:
            quaternion = qpos[place + 3 : place + 7].copy()
            mujoco.mju_normalize4(quaternion)  # zeros become the identity, as in the compiler
            qpos[place : place + 3] = make_placement(quaternion, qpos[place : place + 3]).act(
                offset
            )
            key.qpos = qpos
