"""Basic functions for MJCFs (``mujoco.MjSpec``) and compiled MuJoCo models.

Contents: joint types, parsing and compiling of specs, checks of the numbers of a model, names of
equalities and elements, suppression of MuJoCo's warnings, lossless conversion of specs to XML and
to picklable data.
"""

from __future__ import annotations

import copyreg
import ctypes
import math
import os
import re
import warnings
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from enum import IntEnum
from pathlib import Path
from threading import Lock
from types import MappingProxyType
from typing import Any, Final, TypeVar

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.errors import ModelError
from pupper_analysis.base.inputs import MAX_FILE_BYTES, read_content, read_input
from pupper_analysis.models.places import one_line, shorten_message
from pupper_analysis.models.xml import MAX_BYTES, MAX_NUMBER, make_unique_name


class JointKind(IntEnum):
    """Type of a joint, with MuJoCo's numbers."""

    FREE = mujoco.mjtJoint.mjJNT_FREE.value
    BALL = mujoco.mjtJoint.mjJNT_BALL.value
    SLIDE = mujoco.mjtJoint.mjJNT_SLIDE.value
    HINGE = mujoco.mjtJoint.mjJNT_HINGE.value


def list_free_joints(model: mujoco.MjModel) -> list[int]:
    """Return the ids of the free joints of a MuJoCo model, ascending."""
    return [int(joint) for joint in np.flatnonzero(model.jnt_type == JointKind.FREE)]


def scalar_joints(model: mujoco.MjModel) -> NDArray[np.intp]:
    """Return the ids of a MuJoCo model's hinges and slides, the joints with a single coordinate."""
    return np.flatnonzero(model.jnt_type >= min(JointKind.SLIDE, JointKind.HINGE))


def has_free_joint(model: mujoco.MjModel | mujoco.MjSpec) -> bool:
    """Return True if a MuJoCo model or spec has a free joint, for the robot or for an object."""
    if isinstance(model, mujoco.MjSpec):
        return any(joint.type == JointKind.FREE for joint in model.joints)
    return bool((model.jnt_type == JointKind.FREE).any())


GEOM_CONTACT_WORDS: Final = (
    *("contype", "conaffinity", "condim", "priority", "friction", "solmix", "solref", "solimp"),
    *("margin", "gap", "adhesion", "group"),
)
"""Attributes that are copied from a geom to another geom: contact parameters, and ``group``
(visibility). ``surfacevel`` is not copied, because the axes of the two geoms may differ."""


def add_geom(body: mujoco.MjsBody, **attributes: Any) -> mujoco.MjsGeom:
    """Add a geom to a body; its pose and shape do not depend on the MJCF's default class.

    Without attributes, the geom is at the origin of the body, with the axes of the body. Other
    attributes, such as contact parameters and colour, are those of the default class.

    Args:
        body: Body.
        **attributes: {attribute of ``MjsGeom``: value}.
    """
    geom, default_geom = body.add_geom(), mujoco.MjSpec().default.geom
    for word in (*_POSE_WORDS, "type", "size", "meshname", "hfieldname", "fitscale"):
        setattr(geom, word, getattr(default_geom, word))
    return _set_attributes(geom, attributes)


def add_site(body: mujoco.MjsBody, **attributes: Any) -> mujoco.MjsSite:
    """Add a site to a body; its pose does not depend on the MJCF's default class.

    Without attributes, the site is at the origin of the body, with the axes of the body.

    Args:
        body: Body.
        **attributes: {attribute of ``MjsSite``: value}.
    """
    site, default_site = body.add_site(), mujoco.MjSpec().default.site
    for word in _POSE_WORDS:
        setattr(site, word, getattr(default_site, word))
    return _set_attributes(site, attributes)


_POSE_WORDS: Final = "pos", "quat", "fromto"
"""Attributes of a geom or site that specify its pose, together with ``alt``: other forms of the
orientation, such as ``euler``, which MuJoCo prefers to ``quat``."""


def _set_attributes(element: _Placed, attributes: Mapping[str, Any]) -> _Placed:
    """Set attributes of a geom or site, without another form of the orientation than ``quat``."""
    element.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
    for word, value in attributes.items():
        setattr(element, word, value)
    return element


_Placed = TypeVar("_Placed", mujoco.MjsGeom, mujoco.MjsSite)
"""Type of an element of a body that has a pose."""


def add_plane(body: mujoco.MjsBody, name: str, bits: int = 1) -> mujoco.MjsGeom:
    """Add a plane to a body at its z = 0, with MuJoCo's contact defaults except ``conaffinity``.

    The contact defaults of the MJCF are not used, because they are intended for the robot. The
    material and the colour are the defaults of the MJCF.

    Args:
        body: World, or a body that is fixed to the world.
        name: Name of the plane.
        bits: ``conaffinity`` of the plane.
    """
    plane, default_geom = add_geom(body, name=name), mujoco.MjSpec().default.geom
    for word in (*GEOM_CONTACT_WORDS, "surfacevel"):
        setattr(plane, word, getattr(default_geom, word))
    plane.type, plane.size, plane.conaffinity = mujoco.mjtGeom.mjGEOM_PLANE, (0, 0, 0.05), bits
    return plane


def make_start_data(model: mujoco.MjModel) -> mujoco.MjData:
    """Return MuJoCo data at the start pose, with kinematics and CoM positions.

    The start pose is the first keyframe, or qpos0 without keyframes.
    """
    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    return data


TIMESTEP_RANGE = 1e-5, 0.1
"""Lower and upper bound of the time step that an MJCF states [s]; an MJCF with another time step is
not simulated. Requested time steps may have other bounds. Chosen, not tuned. At the lower bound, a
simulation of 12 s takes 1.2 million steps.
"""


def parse_spec(path: Path) -> mujoco.MjSpec:
    """Parse an MJCF, also with a suffix that `MjSpec` does not read, such as ``.XML``.

    Raises:
        ValueError: If MuJoCo rejects the file.
        InputError: If a file with another suffix than ``.xml`` cannot be read.
        OutputError: If this run of the command line also writes such a file.
    """
    if path.suffix == ".xml":  # MuJoCo distinguishes upper and lower case
        return mujoco.MjSpec.from_file(str(path))
    contents: dict[str, bytes] = {}
    text = read_content(path, MAX_BYTES)
    pending = [text]
    while pending:
        for name in _INCLUDE_ELEMENT.findall(pending.pop()):
            file = path.parent / name.decode()
            if name.decode() not in contents and file.is_file():
                contents[name.decode()] = read_input(file, MAX_BYTES)
                pending.append(contents[name.decode()])
    spec = mujoco.MjSpec.from_string(text.decode("utf-8-sig"), include=contents)
    spec.modelfiledir = str(path.parent)
    return spec


_INCLUDE_ELEMENT = re.compile(rb'<include\s[^>]*file\s*=\s*["\']([^"\']+)')
"""Pattern of an ``<include>`` with its file."""


def lower_boundmass(spec: mujoco.MjSpec) -> float:
    """Decrease the ``boundmass`` of a spec's compiler to the next smaller float, in place.

    In the compiled model, a body with a smaller mass of its own, such as 0, then has exactly the
    returned mass; a body whose stated mass is the original bound has another mass. The compiler
    must not scale all masses (``settotalmass``).

    Returns:
        The decreased bound [kg]; 0 if the spec has no bound.
    """
    bound = float(spec.compiler.boundmass)
    if bound > 0:
        bound = math.nextafter(bound, 0.0)
        spec.compiler.boundmass = bound
    return max(bound, 0.0)


def compile_spec(spec: mujoco.MjSpec, source: Path) -> mujoco.MjModel:
    """Compile a spec, and check the numbers of the model.

    Raises:
        ModelError: If MuJoCo rejects the spec (the message is MuJoCo's), or if the model contains
            an invalid number.
    """
    try:
        with silence_mujoco():
            model = spec.compile()
    except (ValueError, RuntimeError) as error:
        message = one_line(error)
        refusal = diagnose("mjcf-not-compiled", message=message, cause=shorten_message(message))
        raise ModelError(source, refusal) from error
    problem = find_invalid_number(model)
    if problem is not None:
        raise ModelError(source, problem)
    return model


_BOUNDED_FIELDS = {
    "body": ("pos", "quat", "ipos", "iquat", "mass", "inertia"),
    "jnt": ("pos", "axis", "stiffness"),
    "dof": ("armature", "damping", "frictionloss"),
    "geom": ("pos", "quat", "size", "friction"),
    "site": ("pos", "quat"),
}
"""{prefix of arrays of ``mjModel``: fields whose absolute values must be at most ``MAX_NUMBER``}.
"""

_NAN_FREE_FIELDS = (
    "qpos0",
    "jnt_range",
    *(f"actuator_{what}" for what in ("gear", "gainprm", "biasprm", "armature", "damping")),
    *(f"tendon_{what}" for what in ("stiffness", "damping", "armature", "frictionloss")),
)
"""Fields of ``mjModel``, such as ranges and gains, that must not contain NaN; infinity is valid."""

_ELEMENT_NAMES = {"jnt": "joint", "dof": "joint"}
"""{key of `_BOUNDED_FIELDS`: tag of the element in an MJCF}, if both differ."""


def find_invalid_number(model: mujoco.MjModel) -> Diagnostic | None:
    """Return a diagnostic of an invalid number of a compiled model; None if none is found.

    MuJoCo compiles models with NaN, with too large numbers, and with zero axes or quaternions.
    """
    for kind, fields in _BOUNDED_FIELDS.items():
        for field in fields:
            values = np.asarray(getattr(model, f"{kind}_{field}"))
            values = values.reshape(len(values), -1) if len(values) else np.zeros((0, 1))
            bad = ~(np.abs(values) <= MAX_NUMBER)
            if bad.any():
                row, column = np.argwhere(bad)[0]
                index = int(model.dof_jntid[row]) if kind == "dof" else int(row)
                element = _ELEMENT_NAMES.get(kind, kind)
                name = getattr(model, element)(index).name or f"#{index}"
                return diagnose(
                    "number-not-usable",
                    subject=(element, name),
                    field=field,
                    value=values[row, column],
                    most=MAX_NUMBER,
                )
    for field in _NAN_FREE_FIELDS:
        if np.isnan(getattr(model, field)).any():
            return diagnose("number-is-nan", field=field)
    lengths = np.linalg.norm(model.jnt_axis, axis=1)
    for joint in np.flatnonzero(~(lengths > 0.5)):  # MuJoCo normalises, except for 1e308
        return diagnose("axis-without-direction", subject=("joint", model.joint(joint).name))
    for kind, field in (("body", "quat"), ("body", "iquat"), ("geom", "quat"), ("site", "quat")):
        lengths = np.linalg.norm(getattr(model, f"{kind}_{field}"), axis=1)
        for row in np.flatnonzero(~(lengths > 0.5)):  # MuJoCo does not normalise tiny quaternions
            name = getattr(model, kind)(row).name or f"#{row}"
            return diagnose("quaternion-without-direction", subject=(kind, name), field=field)
    if not (np.abs(model.opt.gravity) <= MAX_NUMBER).all():
        return diagnose("gravity-not-usable", gravity=model.opt.gravity, most=MAX_NUMBER)
    return None


def equality_ends(model: mujoco.MjModel, index: int) -> list[tuple[mujoco.mjtObj, int]]:
    """Return the two objects, such as joints, that an equality constraint connects.

    Each object is (object type, id). The second id is -1 if there is no second object.
    """
    # eq_objtype is only valid for constraints of bodies or sites.
    object_type = _EQUALITY_OBJECTS.get(int(model.eq_type[index])) or mujoco.mjtObj(
        int(model.eq_objtype[index])
    )
    return [(object_type, int(model.eq_obj1id[index])), (object_type, int(model.eq_obj2id[index]))]


_EQUALITY_OBJECTS = {
    mujoco.mjtEq.mjEQ_JOINT.value: mujoco.mjtObj.mjOBJ_JOINT,
    mujoco.mjtEq.mjEQ_TENDON.value: mujoco.mjtObj.mjOBJ_TENDON,
    mujoco.mjtEq.mjEQ_FLEX.value: mujoco.mjtObj.mjOBJ_FLEX,
    mujoco.mjtEq.mjEQ_FLEXVERT.value: mujoco.mjtObj.mjOBJ_FLEX,
    mujoco.mjtEq.mjEQ_FLEXSTRAIN.value: mujoco.mjtObj.mjOBJ_FLEX,
}
"""{type of an equality: type of its objects}, for equality types with a single type of object."""


def equality_name(model: mujoco.MjModel, index: int) -> str:
    """Return the name of an equality constraint, or a substitute such as ``#3 (rod = heel)``."""
    objects = [
        str(mujoco.mj_id2name(model, object_type.value, object_id) or f"#{object_id}")
        for object_type, object_id in equality_ends(model, index)
        if object_id >= 0
    ]
    return str(model.equality(index).name) or format_equality_name(index, *objects)


def format_equality_name(index: int, *ends: str) -> str:
    """Return a name for an equality constraint without a name, for example ``#0 (knee = ankle)``.

    Args:
        index: Id of the equality constraint in the model.
        *ends: Names of the joints, bodies or other objects that the constraint connects.
    """
    return f"#{index} ({' = '.join(ends)})"


_IGNORE_MESSAGE: Final = ctypes.CDLL("msvcrt" if os.name == "nt" else None).strlen
"""Warning handler without effect: a function of the C library that only reads the message.

A handler written in Python can end the process (``std::terminate``): one thread simulates and calls
the handler, while another thread removes it. MuJoCo calls a C function directly, without this
problem.
"""


class _WarningSuppressor:
    """Suppression of MuJoCo's warnings in the process, for any number of overlapping users.

    Threads compile and simulate concurrently, and the warning handler is global. The first user
    replaces the handler by `_IGNORE_MESSAGE`, and the last user restores it.
    """

    def __init__(self) -> None:
        self._lock, self._num_users, self._restore = Lock(), 0, ExitStack()

    def begin(self) -> None:
        """Start a suppression of warnings; the first user replaces MuJoCo's warning handler."""
        with self._lock:
            self._num_users += 1
            if self._num_users == 1:
                previous = mujoco.get_mju_user_warning()
                self._restore.callback(mujoco.set_mju_user_warning, previous)
                mujoco.set_mju_user_warning(_IGNORE_MESSAGE)
                self._restore.enter_context(warnings.catch_warnings())
                warnings.simplefilter("ignore")

    def end(self) -> None:
        """End a suppression of warnings; the last user restores MuJoCo's warning handler."""
        with self._lock:
            self._num_users -= 1
            if not self._num_users:
                self._restore.close()


_WARNING_SUPPRESSOR = _WarningSuppressor()
"""The only suppressor of MuJoCo's warnings in the process, shared by all blocks of
`silence_mujoco`."""


@contextmanager
def silence_mujoco() -> Iterator[None]:
    """Context manager: suppress MuJoCo's warnings, the file MUJOCO_LOG.TXT, and Python warnings.

    The suppression applies to all threads of the process.
    """
    _WARNING_SUPPRESSOR.begin()
    try:
        yield
    finally:
        _WARNING_SUPPRESSOR.end()


def name_elements(spec: mujoco.MjSpec, taken: set[str]) -> list[Diagnostic]:
    """Give generated names to unnamed bodies and joints, except free joints, in place.

    Args:
        spec: The spec.
        taken: Names that joints must not get.

    Returns:
        A diagnostic of each joint that got a name.
    """
    bodies = {body.name for body in spec.bodies}
    for number, body in enumerate(spec.bodies):
        if not body.name:
            body.name = make_unique_name(f"body_{number}", bodies)
    joints, notes = {joint.name for joint in spec.joints} | taken, []
    for joint in spec.joints:
        if not joint.name and joint.type != JointKind.FREE:
            joint.name = make_unique_name(f"{joint.parent.name}_joint", joints)
            notes.append(diagnose("joint-named", subject=("joint", joint.name)))
    return notes


def to_xml(spec: mujoco.MjSpec) -> str:
    """Return the XML of a spec, with all digits and default classes.

    By default, MuJoCo writes six digits.
    """
    spec = spec.copy()
    spec.compiler.savecompiled = False
    return str(spec.to_xml())


# Pickling of specs and of read-only mappings, which Python does not support.


def spec_to_data(spec: mujoco.MjSpec) -> dict[str, Any]:
    """Convert a spec to picklable data, from which `spec_from_data` restores the spec.

    Returns:
        ``xml`` (text), ``folder`` (of the model's files) and ``assets`` ({name: content}).
    """
    assets = {**_read_assets(spec), **spec.assets}
    return {"xml": to_xml(spec), "folder": spec.modelfiledir, "assets": assets}


def spec_from_data(state: dict[str, Any]) -> mujoco.MjSpec:
    """Restore a spec from the picklable data of ``spec_to_data``; no files are read."""
    with silence_mujoco():
        spec = mujoco.MjSpec.from_string(state["xml"], assets=state["assets"])
    spec.modelfiledir = state["folder"]
    return spec


def _read_assets(spec: mujoco.MjSpec) -> dict[str, bytes]:
    """Return {name: content} of the existing files of meshes, height fields, skins and textures."""
    files_and_folders = [
        (element.file, element.compiler.meshdir)
        for element in (*spec.meshes, *spec.hfields, *spec.skins)
    ]
    for texture in spec.textures:
        files = (texture.file, *texture.cubefiles)
        files_and_folders += [(file, texture.compiler.texturedir) for file in files]
    contents = {}
    for file, folder in files_and_folders:
        name = Path(file).name if spec.strippath else file
        path = Path(spec.modelfiledir) / folder / name
        if file and path.is_file():
            contents[name] = read_input(path, MAX_FILE_BYTES)
    return contents


def embed_meshes(spec: mujoco.MjSpec) -> None:
    """Read the mesh files of a spec into its assets, in place; no effect on a spec without assets.

    Reason: if a spec with assets is attached to another spec, MuJoCo adds a prefix to the names of
    all its mesh files. Files that are not among the assets are then not found.

    Raises:
        InputError: If a mesh file cannot be read.
        OutputError: If this run of the command line also writes a mesh file.
    """
    if not spec.assets:
        return
    assets = dict(spec.assets)
    for mesh in spec.meshes:
        folder = Path(spec.modelfiledir) / mesh.compiler.meshdir
        path = folder / (Path(mesh.file).name if spec.strippath else mesh.file)
        if not mesh.file or mesh.file in assets or not path.is_file():
            continue
        name = make_unique_name(path.stem, {Path(asset).stem for asset in assets})
        mesh.file = name + path.suffix
        assets[mesh.file] = read_input(path, MAX_FILE_BYTES)
    spec.assets = assets


def fixed_mapping(content: dict[Any, Any]) -> MappingProxyType[Any, Any]:
    """Return a read-only view of a dictionary."""
    return MappingProxyType(content)


copyreg.pickle(mujoco.MjSpec, lambda spec: (spec_from_data, (spec_to_data(spec),)))
copyreg.pickle(MappingProxyType, lambda fixed: (fixed_mapping, (dict(fixed),)))
