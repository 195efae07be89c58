"""Reads the model of an MJCF, and its other elements' numbers, from what MuJoCo makes of it."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Final

import mujoco
import numpy as np

from pupper_analysis.base.arrays import inertia_tensor, rotation_from_quaternion
from pupper_analysis.models.attributes import (
    COMPILED_ATTRIBUTES,
    ELEMENT_ATTRIBUTES,
    TREE_ATTRIBUTES,
)
from pupper_analysis.models.conversion import inertia_of_body
from pupper_analysis.models.efforts import effort_limit
from pupper_analysis.models.mjcf import JointKind
from pupper_analysis.models.mjcf_file import MjcfFile
from pupper_analysis.models.places import Place
from pupper_analysis.models.shapes import Pose, Shape, read_shape
from pupper_analysis.models.stated.model import (
    BALL,
    FREE,
    HINGE,
    SLIDE,
    Array,
    Frame,
    Inertial,
    Joint,
    Link,
    MjcfModel,
)
from pupper_analysis.models.stated.urdf import half_digit

KINDS: dict[int, str] = {
    JointKind.FREE: FREE,
    JointKind.BALL: BALL,
    JointKind.SLIDE: SLIDE,
    JointKind.HINGE: HINGE,
}


def read_mjcf_model(file: MjcfFile) -> MjcfModel:
    """Returns the model of an MJCF; empty if MuJoCo refuses it."""
    if file.refusal is not None:
        return MjcfModel("mjcf", "body", "", {}, file.notes, file, None, file.refusal, ())
    spec = file.spec.copy()
    spec.compiler.fusestatic = False  # links are kept apart, as in the file
    model = spec.compile()  # numbers the elements of this spec
    names = body_names(model)
    base = _base(model)
    data = mujoco.MjData(model)
    data.qpos[:] = zero_configuration(model)
    mujoco.mj_kinematics(model, data)
    to_base = Pose.of_body(data, base).inverse()
    stated = {
        copied.id: original
        for original, copied in zip(file.spec.bodies, spec.bodies, strict=True)
        if original.explicitinertial and file.spec.compiler.inertiafromgeom != 1
    }
    written = {
        copied.id: original for original, copied in zip(file.spec.joints, spec.joints, strict=True)
    }
    frames: dict[int, list[Frame]] = {}
    bare = set(file.bare)
    for site in range(model.nsite):
        frame = Frame(model.site(site).name, np.array(model.site_pos[site]))
        frames.setdefault(int(model.site_bodyid[site]), []).append(frame)
    bodies = {}
    for body in range(1, model.nbody):
        parent = int(model.body_parentid[body])
        pose = to_base * Pose.of_body(data, body)
        bodies[names[body]] = Link(
            name=names[body],
            parent=names[parent] if parent else None,
            pose=pose,
            joints=tuple(
                _joint(file, model, data, joint, names, to_base, written.get(joint))
                for joint in _range(model.body_jntadr[body], model.body_jntnum[body])
            ),
            inertial=_inertial(model, body, stated.get(body)),
            shapes=(
                *(
                    read_shape(model, geom)
                    for geom in _range(model.body_geomadr[body], model.body_geomnum[body])
                ),
                *([Shape("", "mesh", Pose(), (), collides=False)] if names[body] in bare else []),
            ),
            frames=tuple(frames.get(body, ())),
        )
    said = file.as_it_is
    return MjcfModel(
        "mjcf", "body", names[base], bodies, file.notes, file, model, said, tuple(names)
    )


def body_names(model: mujoco.MjModel) -> list[str]:
    """Returns the name of each body; one without is called after its place in the order, #3."""
    return [model.body(body).name or f"#{body}" for body in range(model.nbody)]


def joint_name(model: mujoco.MjModel, joint: int) -> str:
    """Returns a joint's name; one without is called after its body: ``(FL_calf)``."""
    body = int(model.jnt_bodyid[joint])
    return str(model.joint(joint).name) or f"({model.body(body).name or f'#{body}'})"


def line_of(file: MjcfFile, element: object, body: str) -> Place:
    """Returns the place of an element without a name: MuJoCo's parser notes lines of the main file.

    Args:
        file: The file.
        element: Of the spec.
        body: A named body around it; its place is returned where there is no such line.
    """
    found = re.search(r"line ([1-9]\d*)", getattr(element, "info", ""))
    around = file.place("body", body)
    return Place(around.file, int(found[1])) if found else around


def zero_configuration(model: mujoco.MjModel) -> Array:
    """Returns the qpos (nq,) in which all angles are zero; free and ball joints as they start."""
    qpos = np.array(model.qpos0)
    for joint in range(model.njnt):
        if KINDS[int(model.jnt_type[joint])] in (HINGE, SLIDE):
            qpos[model.jnt_qposadr[joint]] = 0.0
    return qpos


def _base(model: mujoco.MjModel) -> int:
    """Returns the root of the heaviest tree, one with a free joint first; 0 without any body."""
    best, best_score = 0, (-1, -1.0)
    for body in range(1, model.nbody):
        first = int(model.body_jntadr[body])
        if int(model.body_parentid[body]) != 0:
            continue
        free = first >= 0 and model.jnt_type[first] == JointKind.FREE
        in_tree = int(np.sum((model.body_rootid == body) & (model.body_jntnum > 0)))
        score = (int(bool(free) and in_tree > 1), float(model.body_subtreemass[body]))
        if score > best_score:
            best, best_score = body, score
    return best


def _range(first: int, count: int) -> range:
    return range(int(first), int(first) + int(count))


def _joint(
    file: MjcfFile,
    model: mujoco.MjModel,
    data: mujoco.MjData,
    joint: int,
    names: list[str],
    to_base: Pose,
    written: mujoco.MjsJoint | None,
) -> Joint:
    body = int(model.jnt_bodyid[joint])
    kind = KINDS[int(model.jnt_type[joint])]
    limited = bool(model.jnt_limited[joint]) and kind in (HINGE, SLIDE)
    lower, upper = model.jnt_range[joint] if limited else (-math.inf, math.inf)
    limits = {"lower": float(lower), "upper": float(upper), "effort": effort_limit(model, joint)}
    return Joint(
        name=joint_name(model, joint),
        kind=kind,
        parent=names[int(model.body_parentid[body])],
        child=names[body],
        position=to_base.point(data.xanchor[joint]),
        axis=to_base.rotation @ data.xaxis[joint] if kind in (HINGE, SLIDE) else np.zeros(3),
        raw_axis=np.array(model.jnt_axis[joint] if written is None else written.axis),
        stated=_stated(file, model, joint, names[body], written, limits),
        **limits,
    )


def _stated(
    file: MjcfFile,
    model: mujoco.MjModel,
    joint: int,
    body: str,
    written: mujoco.MjsJoint | None,
    limits: Mapping[str, float],
) -> dict[str, float]:
    """Returns what a file states of a joint; zero is stated where an element or a class says so."""
    found = {one.kind: limits[one.field] for one in TREE_ATTRIBUTES if one.field in limits}
    found = {kind: value for kind, value in found.items() if math.isfinite(value)}
    if written is None:
        return found
    for one in COMPILED_ATTRIBUTES:
        own, *others = one.mjcf
        value = float(np.atleast_1d(getattr(written, own))[0])
        if any(np.any(getattr(written, other)) for other in others):  # it goes before its own
            value = one.compiled(model, joint)
        if value or file.stated("joint", written.name or body, one.mjcf) is not None:
            found[one.kind] = value
    return found


def _inertial(model: mujoco.MjModel, body: int, stated: mujoco.MjsBody | None) -> Inertial | None:
    axes = rotation_from_quaternion(model.body_iquat[body])
    if stated is not None:
        written = np.array(stated.fullinertia)
        tensor = inertia_tensor(written)
        if math.isnan(written[0]):
            written = np.array(stated.inertia)
            tensor = axes @ np.diag(written) @ axes.T
        rounding = max(half_digit(repr(float(value))) for value in written)
        return Inertial(float(stated.mass), np.array(stated.ipos), tensor, True, rounding)
    if model.body_mass[body] == 0:
        return None
    return Inertial.of(inertia_of_body(model, body), stated=False)


# Numbers of an MJCF besides bodies and joints: of geoms, contact pairs, options, keyframes.


Value = tuple[float, ...]


def place_of_geom(file: MjcfFile, geom: int, word: str) -> Place:
    """Finds where a geom's attribute is stated, in itself or a default class.

    Args:
        file: What it is of.
        geom: Its row in MuJoCo's arrays.
        word: The attribute; ``"shape"`` is any that a shape has, ``"touches"`` any that says what
            it touches, ``""`` is the geom itself.
    """
    model = file.model
    name, body = model.geom(geom).name, model.geom_bodyid[geom]
    words = _WORDS_OF.get(word, (word,))
    if not name:
        number = geom - int(model.body_geomadr[body])
        return file.nth(model.body(body).name, "geom", number, words)
    return (file.stated("geom", name, words) if words else None) or file.place("geom", name)


_WORDS_OF: Final = {
    "shape": ("size", "fromto", "type", "pos", "quat", "mesh"),
    "touches": ("contype", "conaffinity"),
    "": (),
}


def touching_geoms(model: mujoco.MjModel) -> set[int]:
    """Returns the geoms that can touch anything, by their bits or in a pair; others are seen."""
    if model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_CONTACT:
        return set()
    bits = np.flatnonzero((model.geom_contype != 0) | (model.geom_conaffinity != 0))
    return {*bits.tolist(), *model.pair_geom1.tolist(), *model.pair_geom2.tolist()}


def element_values(model: mujoco.MjModel, element: str, row: int) -> dict[str, Value]:
    """Returns an element's numbers, those of a table's rows that it has."""
    rows = [one for one in ELEMENT_ATTRIBUTES if one.element == element]
    if element == "option":
        return {one.word: _numbers(getattr(model.opt, one.mujoco)) for one in rows}
    return {
        one.word: _numbers(getattr(model, one.mujoco)[rows_of(model, one.mujoco, row)])
        for one in rows
    }


def rows_of(model: mujoco.MjModel, array: str, row: int) -> int | slice:
    """Returns an element's row in one of MuJoCo's arrays; of velocities, all of its joint."""
    if not array.startswith("dof_"):
        return row
    later = model.jnt_dofadr[row + 1] if row + 1 < model.njnt else model.nv
    return slice(int(model.jnt_dofadr[row]), int(later))


def _numbers(value: object) -> Value:
    return tuple(np.asarray(value, dtype=float).ravel().tolist())
