"""Reading of a robot model as stated by an MJCF (`stated.model`), and of other parameters.

`read_mjcf_model` returns the links and joints of an MJCF, expressed in the base frame at zero joint
positions. Poses come from the compiled model. Specified values come from the spec, because the
compiler replaces missing values by defaults. The other functions return names of elements,
parameters of geoms, contact pairs, options and keyframes, and locations in the file.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Final

import mujoco
import numpy as np

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.arrays import inertia_tensor, rotation_from_quaternion
from pupper_analysis.models.attributes import (
    COMPILED_ATTRIBUTES,
    ELEMENT_ATTRIBUTES,
    TREE_ATTRIBUTES,
)
from pupper_analysis.models.conversion import inertia_of_body
from pupper_analysis.models.efforts import EffortStatement, find_null_efforts, resolve_effort_limit
from pupper_analysis.models.mjcf import JointKind, lower_boundmass
from pupper_analysis.models.mjcf_file import MjcfFile, name_unnamed_joint
from pupper_analysis.models.places import Place
from pupper_analysis.models.shapes import Pose, Shape, read_shape
from pupper_analysis.models.stated.model import (
    BALL_JOINT,
    FREE_JOINT,
    HINGE_JOINT,
    SLIDE_JOINT,
    Frame,
    Inertial,
    Joint,
    Link,
    MjcfModel,
)
from pupper_analysis.models.stated.urdf import half_digit

JOINT_KIND_NAMES: dict[int, str] = {
    JointKind.FREE: FREE_JOINT,
    JointKind.BALL: BALL_JOINT,
    JointKind.SLIDE: SLIDE_JOINT,
    JointKind.HINGE: HINGE_JOINT,
}
"""{joint type of MuJoCo: joint kind of `stated.model`}."""


def read_mjcf_model(file: MjcfFile) -> MjcfModel:
    """Read the links and joints of an MJCF with the values that the file specifies.

    The base is the root of the heaviest tree; articulated trees with a free joint have priority. If
    MuJoCo does not compile the file, the model has no links.
    """
    if file.refusal is not None:
        return MjcfModel("mjcf", "body", "", {}, file.notes, file, None, file.refusal, ())
    spec = file.spec.copy()
    spec.compiler.fusestatic = False  # links are kept apart, as in the file
    bound = lower_boundmass(spec)
    model = spec.compile()  # sets the ids of the elements of this spec
    names = body_names(model)
    base = _find_heaviest_root(model)
    data = mujoco.MjData(model)
    data.qpos[:] = zero_configuration(model)
    mujoco.mj_kinematics(model, data)
    to_base = Pose.of_body(data, base).inverse()
    explicit_inertials = {
        copied.id: original
        for original, copied in zip(file.spec.bodies, spec.bodies, strict=True)
        if original.explicitinertial and file.spec.compiler.inertiafromgeom != 1
    }
    empty_ranges = find_null_efforts(file)
    spec_joints = {
        copied.id: original for original, copied in zip(file.spec.joints, spec.joints, strict=True)
    }
    frames = _list_sites(model)
    bodies_without_meshes = set(file.bodies_with_missing_meshes)
    bodies = {}
    for body in range(1, model.nbody):
        parent = int(model.body_parentid[body])
        pose = to_base * Pose.of_body(data, body)
        bodies[names[body]] = Link(
            name=names[body],
            parent=names[parent] if parent else None,
            pose=pose,
            joints=tuple(
                _make_joint(
                    file,
                    model,
                    data,
                    joint,
                    names,
                    to_base,
                    spec_joints.get(joint),
                    empty_ranges.get(str(model.joint(joint).name)),
                )
                for joint in _make_id_range(model.body_jntadr[body], model.body_jntnum[body])
            ),
            inertial=_make_inertial(model, body, explicit_inertials.get(body), bound),
            shapes=_list_shapes(model, body, lacks_mesh=names[body] in bodies_without_meshes),
            frames=tuple(frames.get(body, ())),
        )
    notes, refusal = file.notes, file.as_it_is
    return MjcfModel("mjcf", "body", names[base], bodies, notes, file, model, refusal, tuple(names))


def _list_shapes(model: mujoco.MjModel, body: int, *, lacks_mesh: bool) -> tuple[Shape, ...]:
    """Return the shapes of a body: geoms, and an empty mesh if the file of a mesh is missing."""
    geoms = _make_id_range(model.body_geomadr[body], model.body_geomnum[body])
    missing = [Shape("", "mesh", Pose(), (), collides=False)] if lacks_mesh else []
    return *(read_shape(model, geom) for geom in geoms), *missing


def _list_sites(model: mujoco.MjModel) -> dict[int, list[Frame]]:
    """Return the sites of each body as frames; positions [m] are expressed in the body frame."""
    frames: dict[int, list[Frame]] = {}
    for site in range(model.nsite):
        frame = Frame(model.site(site).name, np.array(model.site_pos[site]))
        frames.setdefault(int(model.site_bodyid[site]), []).append(frame)
    return frames


def body_names(model: mujoco.MjModel) -> list[str]:
    """Return the names of all bodies, indexed by body id; "#3" for body 3 without a name."""
    return [model.body(body).name or f"#{body}" for body in range(model.nbody)]


def joint_name(model: mujoco.MjModel, joint: int) -> str:
    """Return the name of a joint; without a name, the substitute of `name_unnamed_joint`.

    The substitute is for example "(BODY)". A body without a name is written as "#3", with its id.
    """
    if name := str(model.joint(joint).name):
        return name
    body = int(model.jnt_bodyid[joint])
    earlier = range(int(model.body_jntadr[body]), joint)
    number = 1 + sum(not model.joint(index).name for index in earlier)
    return name_unnamed_joint(model.body(body).name or f"#{body}", number)


def find_element_place(file: MjcfFile, element: object, body: str) -> Place:
    """Return the location of an element without a name, from the line that MuJoCo's parser records.

    Returns:
        The location of the element; the location of the body if no line is recorded, or if the
        file attaches models, to which the line may belong.
    """
    match = re.search(r"line ([1-9]\d*)", getattr(element, "info", ""))
    body_place = file.place("body", body)
    if file.attaches_models:
        return body_place
    return Place(body_place.file, int(match[1])) if match else body_place


def zero_configuration(model: mujoco.MjModel) -> Array:
    """Return the configuration qpos (nq,) with hinges and slides at zero, else as in ``qpos0``."""
    qpos = np.array(model.qpos0)
    for joint in range(model.njnt):
        if JOINT_KIND_NAMES[int(model.jnt_type[joint])] in (HINGE_JOINT, SLIDE_JOINT):
            qpos[model.jnt_qposadr[joint]] = 0.0
    return qpos


def _find_heaviest_root(model: mujoco.MjModel) -> int:
    """Return the id of the root body of the heaviest kinematic tree; 0 if there is no body.

    Articulated trees with a free joint have priority.
    """
    best, best_score = 0, (-1, -1.0)
    for body in range(1, model.nbody):
        first = int(model.body_jntadr[body])
        if int(model.body_parentid[body]) != 0:
            continue
        is_free = first >= 0 and model.jnt_type[first] == JointKind.FREE
        num_jointed_bodies = int(np.sum((model.body_rootid == body) & (model.body_jntnum > 0)))
        score = (int(bool(is_free) and num_jointed_bodies > 1), float(model.body_subtreemass[body]))
        if score > best_score:
            best, best_score = body, score
    return best


def _make_id_range(first: int, count: int) -> range:
    """Return the ids ``first`` to ``first + count - 1``, given as NumPy integers."""
    return range(int(first), int(first) + int(count))


def _make_joint(
    file: MjcfFile,
    model: mujoco.MjModel,
    data: mujoco.MjData,
    joint: int,
    names: list[str],
    to_base: Pose,
    spec_joint: mujoco.MjsJoint | None,
    empty_range: EffortStatement | None,
) -> Joint:
    """Convert a joint of an MJCF; the result is expressed in the base frame.

    ``data`` is at zero joint positions, and ``to_base`` is the pose of the world in the base frame.
    ``spec_joint`` is the joint in the file's spec, if any.
    """
    body = int(model.jnt_bodyid[joint])
    kind = JOINT_KIND_NAMES[int(model.jnt_type[joint])]
    limited = bool(model.jnt_limited[joint]) and kind in (HINGE_JOINT, SLIDE_JOINT)
    lower, upper = model.jnt_range[joint] if limited else (-math.inf, math.inf)
    limit = resolve_effort_limit(model, joint, empty_range=empty_range)
    effort = max(abs(limit.lower), abs(limit.upper))
    limits = {"lower": float(lower), "upper": float(upper), "effort": effort}
    return Joint(
        name=joint_name(model, joint),
        kind=kind,
        parent=names[int(model.body_parentid[body])],
        child=names[body],
        position=to_base.point(data.xanchor[joint]),
        axis=to_base.rotation @ data.xaxis[joint]
        if kind in (HINGE_JOINT, SLIDE_JOINT)
        else np.zeros(3),
        raw_axis=np.array(model.jnt_axis[joint] if spec_joint is None else spec_joint.axis),
        stated=_stated_values(file, model, joint, spec_joint, limits),
        **limits,
    )


def _stated_values(
    file: MjcfFile,
    model: mujoco.MjModel,
    joint: int,
    spec_joint: mujoco.MjsJoint | None,
    limits: Mapping[str, float],
) -> dict[str, float]:
    """Return {kind, such as ``damping``: value} of the joint parameters that the file specifies.

    ``joint`` is the id of the joint in the compiled model, ``spec_joint`` the joint in the file's
    spec, and ``limits`` is {field of `TreeJoint`: limit}.
    """
    values = {
        attribute.kind: limits[attribute.field]
        for attribute in TREE_ATTRIBUTES
        if attribute.field in limits
    }
    values = {kind: value for kind, value in values.items() if math.isfinite(value)}
    if spec_joint is None:
        return values
    name = joint_name(model, joint)
    for attribute in COMPILED_ATTRIBUTES:
        main_word, *other_words = attribute.mjcf
        value = float(np.atleast_1d(getattr(spec_joint, main_word))[0])
        # springdamper has priority over stiffness and damping
        if any(np.any(getattr(spec_joint, word)) for word in other_words):
            value = attribute.read_compiled_value(model, joint)
        if value or file.find_attribute("joint", name, attribute.mjcf) is not None:
            values[attribute.kind] = value
    return values


def _make_inertial(
    model: mujoco.MjModel, body: int, spec_body: mujoco.MjsBody | None, bound: float
) -> Inertial | None:
    """Return the inertia of a body, from ``spec_body`` if given, else from the compiled model.

    ``spec_body`` is the body of the spec, if its inertia is explicit. Without it, None for a mass
    of 0, and for the mass ``bound`` [kg] that `lower_boundmass` returns.
    """
    axes = rotation_from_quaternion(model.body_iquat[body])
    if spec_body is not None:
        entries = np.array(spec_body.fullinertia)
        tensor = inertia_tensor(entries)
        if math.isnan(entries[0]):
            entries = np.array(spec_body.inertia)
            tensor = axes @ np.diag(entries) @ axes.T
        rounding = max(half_digit(repr(float(value))) for value in entries)
        return Inertial(float(spec_body.mass), np.array(spec_body.ipos), tensor, True, rounding)
    if model.body_mass[body] in (0.0, bound):
        return None
    return Inertial.of(inertia_of_body(model, body), stated=False)


# Parameters of other elements of an MJCF: geoms, contact pairs, options, keyframes.


ParameterValues = tuple[float, ...]
"""Values of a parameter, as a flat tuple."""


def place_of_geom(file: MjcfFile, geom: int, word: str) -> Place:
    """Return the location of an attribute of a geom: in the geom itself, or in a default class.

    If the attribute is not set, the result is the location of the geom. If a geom without a name
    cannot be assigned to an element of the file, the result is the location of its body.

    Args:
        file: The file.
        geom: Id of the geom.
        word: Name of the attribute; or ``"shape"`` or ``"touches"`` for any one of several
            attributes, or ``""`` for the geom itself.
    """
    model = file.model
    name, body = model.geom(geom).name, int(model.geom_bodyid[geom])
    words = _WORD_GROUPS.get(word, (word,))
    if not name:
        number, count = geom - int(model.body_geomadr[body]), int(model.body_geomnum[body])
        return file.place_of_nth_geom(model.body(body).name, number, count, words)
    return (file.find_attribute("geom", name, words) if words else None) or file.place("geom", name)


_WORD_GROUPS: Final = {
    "shape": ("size", "fromto", "type", "pos", "quat", "mesh"),
    "touches": ("contype", "conaffinity"),
    "": (),
}
"""{name of a group of geom attributes: attributes}. The location of a group is the location of a
set attribute. The empty name represents the geom itself.
"""


def find_collidable_geoms(model: mujoco.MjModel) -> set[int]:
    """Return the ids of the geoms that may collide: with a contact bit, or in a contact pair.

    Empty if the MJCF disables contacts.
    """
    if model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_CONTACT:
        return set()
    bits = np.flatnonzero((model.geom_contype != 0) | (model.geom_conaffinity != 0))
    return {*bits.tolist(), *model.pair_geom1.tolist(), *model.pair_geom2.tolist()}


def element_values(model: mujoco.MjModel, element: str, row: int) -> dict[str, ParameterValues]:
    """Return the compiled values of the compared attributes (``ELEMENT_ATTRIBUTES``) of an element.

    Args:
        model: Compiled model.
        element: Tag, such as "joint" or "geom"; "option" for the global options.
        row: Id of the element; ignored for "option".

    Returns:
        {MJCF attribute: values in MuJoCo's units (SI, rad)}.
    """
    attributes = [attribute for attribute in ELEMENT_ATTRIBUTES if attribute.element == element]
    if element == "option":
        return {
            attribute.word: _to_tuple(getattr(model.opt, attribute.mujoco))
            for attribute in attributes
        }
    return {
        attribute.word: _to_tuple(
            getattr(model, attribute.mujoco)[select_rows(model, attribute.mujoco, row)]
        )
        for attribute in attributes
    }


def select_rows(model: mujoco.MjModel, array: str, row: int) -> int | slice:
    """Return the row or rows of an element in an array of MjModel, to read or write its values.

    Args:
        model: Compiled model.
        array: Name of the array, such as "jnt_range" or "dof_damping".
        row: Id of the element.

    Returns:
        ``row``; for a ``dof_`` array, the slice of the degrees of freedom of joint ``row``.
    """
    if not array.startswith("dof_"):
        return row
    next_address = model.jnt_dofadr[row + 1] if row + 1 < model.njnt else model.nv
    return slice(int(model.jnt_dofadr[row]), int(next_address))


def _to_tuple(value: object) -> ParameterValues:
    """Return a number or an array as a flat tuple of floats."""
    return tuple(np.asarray(value, dtype=float).ravel().tolist())
