"""Files with given numbers are read by both engines, before they are written."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.errors import ModelError
from pupper_analysis.models.attributes import BY_KIND
from pupper_analysis.models.capsules import for_engines
from pupper_analysis.models.conversion import inertia_of_body
from pupper_analysis.models.mjcf_file import MjcfFile, read_mjcf
from pupper_analysis.models.transmission import drives_of, law_of
from pupper_analysis.models.urdf_file import UrdfFile, read_urdf
from pupper_analysis.tools.sync.frames import Key
from pupper_analysis.tools.sync.wanted import (
    OF_BODIES,
    OF_JOINTS,
    OF_SERVOS,
    NumberChanges,
    refuse_numbers,
)

Array = NDArray[np.float64]

_WRITTEN = 1e-9
"""Relative: what is read of a written file is what was wanted, after rotations and rounding."""


def try_files(
    contents: Mapping[Path, bytes],
    changes: NumberChanges,
    urdf: tuple[UrdfFile, Path | None],
    mjcf: tuple[MjcfFile, Path | None],
) -> None:
    """Writes the files elsewhere, reads them by both engines, and checks what has changed.

    Args:
        contents: {place in a folder: content}.
        changes: What shall have changed.
        urdf: The URDF as it was, and its place; None if it has no file.
        mjcf: Likewise of the MJCF.

    Raises:
        ModelError: If an engine refuses a file, or reads another number than was wanted.
    """
    matched = changes.both.matched
    wrong: dict[Key, Diagnostic] = {}
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        for name, content in contents.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(content)
        try:
            if urdf[1] is not None:
                again = read_urdf(folder / urdf[1], urdf[0].packages)
                wrong |= _odd_in_urdf(changes, urdf[0], again)
            if mjcf[1] is not None:
                wrong |= _odd_in_mjcf(changes, mjcf[0].model, read_mjcf(folder / mjcf[1]).model)
        except ModelError as error:
            told = error.cause.with_names(lambda text: text.replace(f"{folder}/", ""))
            raise ModelError(
                matched.robot.name, diagnose("written-not-read", problem=told)
            ) from error
    if wrong:
        raise refuse_numbers(matched.robot, wrong)


def _odd_in_urdf(
    changes: NumberChanges, before: UrdfFile, after: UrdfFile
) -> dict[Key, Diagnostic]:
    """Returns what Pinocchio reads of a written URDF that is not as wanted."""
    models = [
        pin.buildModelFromXML(for_engines(file.root), pin.JointModelFreeFlyer())
        for file in (before, after)
    ]
    wrong: dict[Key, Diagnostic] = {}
    matched = changes.both.matched
    for mover, link in matched.urdf_link.items():
        one, two = (_of_link(model, link) for model in models)
        wrong |= _odd_body(changes, "urdf", mover, one, two)
    for name, other in matched.urdf_joint.items():
        for kind in ("damping", "friction"):
            values = [
                float(getattr(model, kind)[model.joints[model.getJointId(other)].idx_v])
                for model in models
            ]
            wrong |= _odd_number(changes, (kind, name), *values, motors=True)
    return wrong


def _of_link(model: pin.Model, link: str) -> Array:
    """Returns the ten dynamic parameters of all that moves with a link, in its frame."""
    frame = model.frames[model.getFrameId(link, pin.FrameType.BODY)]
    whole = frame.placement.actInv(model.inertias[frame.parentJoint])
    return np.array(whole.toDynamicParameters())


def _odd_in_mjcf(
    changes: NumberChanges, before: mujoco.MjModel, after: mujoco.MjModel
) -> dict[Key, Diagnostic]:
    """Returns what MuJoCo reads of a written MJCF that is not as wanted."""
    matched, wrong = changes.both.matched, dict[Key, Diagnostic]()
    bodies = {before.body(i).name or f"body_{i}": i for i in range(1, before.nbody)}

    for mover, body in matched.mjcf_body.items():
        if body in bodies:
            one, two = (_of_body(model, bodies[body]) for model in (before, after))
            wrong |= _odd_body(changes, "mjcf", mover, one, two)

    own = matched.robot.mj_model
    for name in matched.robot.joint_names:
        body = str(own.body(int(own.jnt_bodyid[own.joint(name).id])).name)
        joint = mujoco.mj_name2id(before, mujoco.mjtObj.mjOBJ_JOINT, name)
        joint = int(before.body_jntadr[bodies[body]]) if joint < 0 else joint
        dof = int(before.jnt_dofadr[joint])
        for kind in OF_JOINTS:
            array = BY_KIND[kind].mujoco
            values = [float(getattr(model, array)[dof]) for model in (before, after)]
            wrong |= _odd_number(changes, (kind, name), *values)
        drives = drives_of(before, joint)
        if len(drives) == 1:
            for at, kind in enumerate(OF_SERVOS):
                values = [law_of(model, drives[0]).at_joint[at] for model in (before, after)]
                if (kind, name) in changes.wanted or ("kp", name) in changes.wanted:
                    wrong |= _odd_number(changes, (kind, name), *values)
    return wrong


def _of_body(model: mujoco.MjModel, body: int) -> Array:
    """Returns the ten dynamic parameters of all that moves with a body, in its frame."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    here = _pose(data, body)
    whole = np.zeros(10)
    for other in np.flatnonzero(model.body_weldid == model.body_weldid[body]).tolist():
        if other:
            own = (here.inverse() * _pose(data, other)).act(inertia_of_body(model, other))
            whole += own.toDynamicParameters()
    return whole


def _pose(data: mujoco.MjData, body: int) -> pin.SE3:
    return pin.SE3(data.xmat[body].reshape(3, 3), data.xpos[body])


def _odd_body(
    changes: NumberChanges, side: str, mover: str, before: Array, after: Array
) -> Iterator[tuple[Key, Diagnostic]]:
    """Yields a body that has not changed by what was wanted, if it has not."""
    apart = np.abs(after - before - changes.step(side, mover))
    sizes = np.repeat([abs(after[0]), max(abs(after[0]), 1e-3), np.abs(after[4:]).max()], [1, 3, 6])
    if (apart > _WRITTEN * np.maximum(sizes, 1e-300)).any():
        kind = next((k for k in OF_BODIES if (k, mover) in changes.wanted), "mass")
        yield (kind, mover), diagnose("read-otherwise")


def _odd_number(
    changes: NumberChanges, key: Key, before: float, after: float, *, motors: bool = False
) -> Iterator[tuple[Key, Diagnostic]]:
    """Yields a number of a joint that is not what was wanted, or has changed unasked."""
    wanted = before
    if key in changes.wanted:
        wanted = float(changes.wanted[key])
        if motors:
            wanted = float(getattr(changes.tree("urdf").joints[key[1]], BY_KIND[key[0]].field))
    if abs(after - wanted) > _WRITTEN * max(abs(wanted), abs(before)):
        yield key, diagnose("read-otherwise")
