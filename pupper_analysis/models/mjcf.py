"""Reads MJCFs as ``mujoco.MjSpec``, and writes specs without loss, as XML or as plain data.

With what an MJCF may need on the way: a plane to stand on, names of the kinds of joints, and what
is made up for where MuJoCo, without its scene, would refuse it.
"""

from __future__ import annotations

import copyreg
import re
import warnings
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from enum import IntEnum
from pathlib import Path
from threading import Lock
from types import MappingProxyType
from typing import Any, Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.errors import ModelError
from pupper_analysis.base.inputs import MAX_FILE_BYTES, read_content, read_input
from pupper_analysis.models.places import one_line
from pupper_analysis.models.xml import MAX_BYTES, MAX_NUMBER, free_name

Array = NDArray[np.float64]


class JointKind(IntEnum):
    """What a joint lets move; equal to MuJoCo's numbers."""

    FREE = mujoco.mjtJoint.mjJNT_FREE.value
    BALL = mujoco.mjtJoint.mjJNT_BALL.value
    SLIDE = mujoco.mjtJoint.mjJNT_SLIDE.value
    HINGE = mujoco.mjtJoint.mjJNT_HINGE.value


FREE, BALL, SLIDE, HINGE = JointKind


def free_joints(model: mujoco.MjModel) -> list[int]:
    """Returns the ids of the free joints."""
    return [int(joint) for joint in np.flatnonzero(model.jnt_type == FREE)]


def scalar_joints(model: mujoco.MjModel) -> NDArray[np.intp]:
    """Returns the ids of the hinges and slides, which have one coordinate each."""
    return np.flatnonzero(model.jnt_type >= min(SLIDE, HINGE))


def has_free_joint(model: mujoco.MjModel | mujoco.MjSpec) -> bool:
    """Tells whether anything floats freely."""
    if isinstance(model, mujoco.MjSpec):
        return any(joint.type == FREE for joint in model.joints)
    return bool((model.jnt_type == FREE).any())


CONTACT_OF_GEOM: Final = (
    *("contype", "conaffinity", "condim", "priority", "friction", "solmix", "solref", "solimp"),
    *("margin", "gap", "group"),
)
"""What a geom of an MJCF has that makes its contacts, and in which group it is shown."""


def add_plane(body: mujoco.MjsBody, name: str, bits: int = 1) -> mujoco.MjsGeom:
    """Adds a plane at z = 0 with MuJoCo's own contact: an MJCF's defaults are for its robot.

    Args:
        body: The world, or a body that is fixed to it.
        name: The plane's.
        bits: What it lets touch it (``conaffinity``).
    """
    plane, plain = body.add_geom(name=name), mujoco.MjSpec().default.geom
    for word in CONTACT_OF_GEOM:
        setattr(plane, word, getattr(plain, word))
    plane.type, plane.size, plane.conaffinity = mujoco.mjtGeom.mjGEOM_PLANE, (0, 0, 0.05), bits
    return plane


def start_data(model: mujoco.MjModel) -> mujoco.MjData:
    """Returns MuJoCo's data as the robot begins: at its first keyframe, or else at its qpos0."""
    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    return data


TIMESTEPS = 1e-5, 0.1
"""s: of what is simulated. A stand of 12 s is 1.2 million steps of the first; contacts ring within
10 ms, and in one step of the second a base falls 5 cm."""


def spec_of(path: Path) -> mujoco.MjSpec:
    """Parses an MJCF, whatever its name ends with: MuJoCo reads files ``*.xml`` alone."""
    if path.suffix.lower() == ".xml":
        return mujoco.MjSpec.from_file(str(path))
    included: dict[str, bytes] = {}
    text = read_content(path, MAX_BYTES)
    waiting = [text]
    while waiting:
        for name in _INCLUDED.findall(waiting.pop()):
            file = path.parent / name.decode()
            if name.decode() not in included and file.is_file():
                included[name.decode()] = read_input(file, MAX_BYTES)
                waiting.append(included[name.decode()])
    spec = mujoco.MjSpec.from_string(text.decode("utf-8-sig"), include=included)
    spec.modelfiledir = str(path.parent)
    return spec


_INCLUDED = re.compile(rb'<include\s[^>]*file\s*=\s*["\']([^"\']+)')


def compile_spec(spec: mujoco.MjSpec, source: Path) -> mujoco.MjModel:
    """Compiles a spec.

    Raises:
        ModelError: If MuJoCo refuses it; the message is MuJoCo's.
    """
    try:
        with silence_mujoco():
            model = spec.compile()
    except (ValueError, RuntimeError) as error:
        raise ModelError(source, diagnose("mjcf-not-compiled", message=one_line(error))) from error
    problem = no_number(model)
    if problem is not None:
        raise ModelError(source, problem)
    return model


_RECKONED = {
    "body": ("pos", "quat", "ipos", "iquat", "mass", "inertia"),
    "jnt": ("pos", "axis", "stiffness"),
    "dof": ("armature", "damping", "frictionloss"),
    "geom": ("pos", "quat", "size", "friction"),
    "site": ("pos", "quat"),
}
_NUMBERS = (
    "qpos0",
    "jnt_range",
    *(f"actuator_{what}" for what in ("gear", "gainprm", "biasprm", "armature", "damping")),
    *(f"tendon_{what}" for what in ("stiffness", "damping", "armature", "frictionloss")),
)
"""Of these NaN alone is none: a range or a gain may be without end."""

_NAMED = {"jnt": "joint", "dof": "joint"}


def no_number(model: mujoco.MjModel) -> Diagnostic | None:
    """Tells which number of a model is none, or too large to reckon with; MuJoCo takes them."""
    for kind, fields in _RECKONED.items():
        for field in fields:
            values = np.asarray(getattr(model, f"{kind}_{field}"))
            values = values.reshape(len(values), -1) if len(values) else np.zeros((0, 1))
            bad = ~(np.abs(values) <= MAX_NUMBER)
            if bad.any():
                row, column = np.argwhere(bad)[0]
                at = int(model.dof_jntid[row]) if kind == "dof" else int(row)
                what = _NAMED.get(kind, kind)
                name = getattr(model, what)(at).name or f"#{at}"
                return diagnose(
                    "number-not-usable",
                    subject=(what, name),
                    field=field,
                    value=values[row, column],
                    most=MAX_NUMBER,
                )
    for field in _NUMBERS:
        if np.isnan(getattr(model, field)).any():
            return diagnose("number-is-nan", field=field)
    lengths = np.linalg.norm(model.jnt_axis, axis=1)
    for joint in np.flatnonzero(~(lengths > 0.5)):  # MuJoCo's are unit vectors, of 1e308 none
        return diagnose("axis-without-direction", subject=("joint", model.joint(joint).name))
    for kind, field in (("body", "quat"), ("body", "iquat"), ("geom", "quat"), ("site", "quat")):
        lengths = np.linalg.norm(getattr(model, f"{kind}_{field}"), axis=1)
        for row in np.flatnonzero(~(lengths > 0.5)):  # MuJoCo makes them 1, but not the least
            name = getattr(model, kind)(row).name or f"#{row}"
            return diagnose("quaternion-without-direction", subject=(kind, name), field=field)
    if not (np.abs(model.opt.gravity) <= MAX_NUMBER).all():
        return diagnose("gravity-not-usable", gravity=model.opt.gravity, most=MAX_NUMBER)
    return None


def equality_ends(model: mujoco.MjModel, index: int) -> list[tuple[mujoco.mjtObj, int]]:
    """Returns the kinds and ids of the two objects of an equality; -1 where it has one only."""
    # MuJoCo's eq_objtype is for constraints that take bodies or sites.
    what = _EQUALITY_OBJECTS.get(int(model.eq_type[index])) or mujoco.mjtObj(
        int(model.eq_objtype[index])
    )
    return [(what, int(model.eq_obj1id[index])), (what, int(model.eq_obj2id[index]))]


_EQUALITY_OBJECTS = {
    mujoco.mjtEq.mjEQ_JOINT.value: mujoco.mjtObj.mjOBJ_JOINT,
    mujoco.mjtEq.mjEQ_TENDON.value: mujoco.mjtObj.mjOBJ_TENDON,
    mujoco.mjtEq.mjEQ_FLEX.value: mujoco.mjtObj.mjOBJ_FLEX,
    mujoco.mjtEq.mjEQ_FLEXVERT.value: mujoco.mjtObj.mjOBJ_FLEX,
    mujoco.mjtEq.mjEQ_FLEXSTRAIN.value: mujoco.mjtObj.mjOBJ_FLEX,
}


def equality_name(model: mujoco.MjModel, index: int) -> str:
    """Returns the name of an equality; of one without, its number and what it binds.

    Equalities mostly have no name; what they bind always has one in the file: ``#3 (rod = heel)``.
    """
    ends = [
        str(mujoco.mj_id2name(model, what.value, target) or f"#{target}")
        for what, target in equality_ends(model, index)
        if target >= 0
    ]
    return str(model.equality(index).name) or numbered(index, *ends)


def numbered(index: int, *ends: str) -> str:
    """Returns what an equality without a name is called, by what it binds."""
    return f"#{index} ({' = '.join(ends)})"


class _Silence:
    """MuJoCo's warnings are the process's: the first who wants silence begins it, the last ends it.

    In between, what was before must not be taken for what shall be afterwards: threads compile and
    simulate at once.
    """

    def __init__(self) -> None:
        self._lock, self._wanted, self._undo = Lock(), 0, ExitStack()

    def begin(self) -> None:
        with self._lock:
            self._wanted += 1
            if self._wanted == 1:
                before = mujoco.get_mju_user_warning()
                self._undo.callback(mujoco.set_mju_user_warning, before)
                mujoco.set_mju_user_warning(lambda _: None)
                self._undo.enter_context(warnings.catch_warnings())
                warnings.simplefilter("ignore")

    def end(self) -> None:
        with self._lock:
            self._wanted -= 1
            if not self._wanted:
                self._undo.close()


_SILENCE = _Silence()


@contextmanager
def silence_mujoco() -> Iterator[None]:
    """Keeps MuJoCo from writing its warnings to a file MUJOCO_LOG.TXT, and from issuing them."""
    _SILENCE.begin()
    try:
        yield
    finally:
        _SILENCE.end()


def name_all(spec: mujoco.MjSpec, taken: set[str]) -> list[Diagnostic]:
    """Names the bodies and joints that have no name, by names that are not taken.

    Returns:
        The names that joints were given.
    """
    bodies = {body.name for body in spec.bodies}
    for number, body in enumerate(spec.bodies):
        if not body.name:
            body.name = free_name(f"body_{number}", bodies)
    joints, notes = {joint.name for joint in spec.joints} | taken, []
    for joint in spec.joints:
        if not joint.name and joint.type != JointKind.FREE:
            joint.name = free_name(f"{joint.parent.name}_joint", joints)
            notes.append(diagnose("joint-named", subject=("joint", joint.name)))
    return notes


def to_xml(spec: mujoco.MjSpec) -> str:
    """Writes a spec as it is written, with all its digits and classes: it is read back the same.

    What compilation makes of it, which MuJoCo writes otherwise, has six digits.
    """
    spec = spec.copy()
    spec.compiler.savecompiled = False
    return str(spec.to_xml())


# Specs as data: MuJoCo's cannot be pickled of themselves, nor can mappings that nobody may change.


def state_of(spec: mujoco.MjSpec) -> dict[str, Any]:
    """Returns a spec as plain data: its XML, and the files it needs."""
    assets = {**_files(spec), **spec.assets}
    return {"xml": to_xml(spec), "folder": spec.modelfiledir, "assets": assets}


def spec_from(state: dict[str, Any]) -> mujoco.MjSpec:
    """Returns the spec of such data; it needs no files."""
    with silence_mujoco():
        spec = mujoco.MjSpec.from_string(state["xml"], assets=state["assets"])
    spec.modelfiledir = state["folder"]
    return spec


def _files(spec: mujoco.MjSpec) -> dict[str, bytes]:
    """Returns the contents of the files that meshes, height fields and textures are read from."""
    named = [(one.file, one.compiler.meshdir) for one in (*spec.meshes, *spec.hfields, *spec.skins)]
    for texture in spec.textures:
        files = (texture.file, *texture.cubefiles)
        named += [(file, texture.compiler.texturedir) for file in files]
    contents = {}
    for file, folder in named:
        name = Path(file).name if spec.strippath else file
        place = Path(spec.modelfiledir) / folder / name
        if file and place.is_file():
            contents[name] = read_input(place, MAX_FILE_BYTES)
    return contents


def fixed_mapping(content: dict[Any, Any]) -> MappingProxyType[Any, Any]:
    """Returns a mapping that cannot be changed."""
    return MappingProxyType(content)


copyreg.pickle(mujoco.MjSpec, lambda spec: (spec_from, (state_of(spec),)))
copyreg.pickle(MappingProxyType, lambda fixed: (fixed_mapping, (dict(fixed),)))
