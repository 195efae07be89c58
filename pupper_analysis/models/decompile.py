"""MuJoCo spec of a compiled model, for users who have only an ``MjModel``.

`make_spec_of_model` writes bodies, joints, geoms, sites, meshes, actuators, tendons, equalities,
contact pairs and exclusions, height fields, keyframes and options of the model to a new spec. The
spec is compiled and compared with the model. An error is raised if a compared array
(`_COMPARED_PREFIXES`, `_IGNORED_ARRAYS`), geom or option differs. Cameras, lights, materials,
textures, and sensors other than the sensors of an IMU are left out, because they have no effect on
the dynamics.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Final

import mujoco
import numpy as np

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ModelError
from pupper_analysis.models.mjcf import JointKind, list_free_joints
from pupper_analysis.models.mjcf_file import compile_with_shells, put_shells
from pupper_analysis.models.places import one_line

_UNSUPPORTED_COUNTS: Final = {
    "nflex": "flex",
    "nskin": "skin",
    "nplugin": "plugin",
    "nplastic": "springyield",
}
"""{field of ``mjModel`` with the number of elements: name of the element for messages}. A model
with one of these elements cannot be converted to a spec, and is refused."""

# Fields of the elements of a spec that are copied from the arrays of a model. A tuple contains the
# common name of both; a mapping is {field of the spec: array of the model without the prefix}.

_SPEC_BODY_FIELDS: Final = ("pos", "quat", "ipos", "iquat", "mass", "inertia", "gravcomp")
"""Fields of a body that are copied from the arrays ``body_`` of the model."""

_SPEC_JOINT_FIELDS: Final = {
    **{name: name for name in ("type", "pos", "axis", "range", "margin", "group")},
    **{name: name for name in ("actfrcrange", "actgravcomp", "limited", "actfrclimited")},
    "solref_limit": "solref",
    "solimp_limit": "solimp",
}
"""{field of a joint: suffix of the array ``jnt_`` from which it is copied}."""

_DOF_FIELDS: Final = {
    "armature": "armature",
    "frictionloss": "frictionloss",
    "solref_friction": "solref",
    "solimp_friction": "solimp",
}
"""{field of a joint: suffix of the array ``dof_`` from which it is copied}."""

_GEOM_FIELDS: Final = (
    *("type", "size", "pos", "quat", "contype", "conaffinity", "condim", "priority", "friction"),
    *("solmix", "solref", "solimp", "margin", "gap", "group", "rgba", "surfacevel", "adhesion"),
)
"""Fields of a geom that are copied from the arrays ``geom_`` of the model."""

_SITE_FIELDS: Final = ("type", "size", "pos", "quat", "group", "rgba")
"""Fields of a site that are copied from the arrays ``site_`` of the model."""

_ACTUATOR_FIELDS: Final = (
    *("gaintype", "biastype", "dyntype", "gainprm", "biasprm", "dynprm", "trntype"),
    *("forcerange", "actrange", "forcelimited", "actlimited"),
    *("actearly", "cranklength", "group", "armature", "ctrlspec", "delay"),
)
"""Fields of an actuator that are copied from the arrays ``actuator_`` with a row per actuator."""

_CONTROL_FIELDS: Final = ("ctrlrange", "ctrllimited")
"""Fields of an actuator that are copied from the arrays ``actuator_`` with a row per control."""

_OUTPUT_FIELDS: Final = ("gear", "lengthrange")
"""Fields of an actuator that are copied from the arrays ``actuator_`` with a row per output."""

_TENDON_FIELDS: Final = {
    **{name: name for name in ("range", "limited", "actfrcrange", "actfrclimited", "margin")},
    **{name: name for name in ("frictionloss", "armature", "group", "rgba", "width")},
    "springlength": "lengthspring",
    "solref_limit": "solref_lim",
    "solimp_limit": "solimp_lim",
    "solref_friction": "solref_fri",
    "solimp_friction": "solimp_fri",
}
"""{field of a tendon: suffix of the array ``tendon_`` from which it is copied}."""

_EQUALITY_FIELDS: Final = ("type", "objtype", "data", "solref", "solimp")
"""Fields of an equality constraint that are copied from the arrays ``eq_`` of the model."""

_PAIR_FIELDS: Final = ("solref", "solimp", "solreffriction", "friction", "margin", "gap")
"""Fields of a contact pair that are copied from the arrays ``pair_`` of the model."""

_KEY_FIELDS: Final = ("time", "qpos", "qvel", "act", "ctrl", "mpos", "mquat")
"""Fields of a keyframe that are copied from the arrays ``key_`` of the model."""

_GEOM_WRAPS: Final = (mujoco.mjtWrap.mjWRAP_SPHERE.value, mujoco.mjtWrap.mjWRAP_CYLINDER.value)
"""Wrapping objects of tendons that refer to a geom."""

_IMU_SENSORS: Final = (
    mujoco.mjtSensor.mjSENS_GYRO.value,
    mujoco.mjtSensor.mjSENS_ACCELEROMETER.value,
)
"""MuJoCo types of the sensors of an IMU, which are copied from the model to the spec."""

_COMPARED_PREFIXES: Final = (
    *("body_mass", "body_inertia", "body_ipos", "body_iquat", "body_pos", "body_quat"),
    *("body_parentid", "body_gravcomp", "body_weldid", "jnt_", "dof_armature", "dof_damping"),
    *("dof_frictionloss", "dof_solref", "dof_solimp", "geom_type", "geom_bodyid", "geom_contype"),
    *("geom_conaffinity", "geom_condim", "geom_priority", "geom_friction", "geom_solmix"),
    *("geom_solref", "geom_solimp", "geom_margin", "geom_gap", "geom_surfacevel"),
    *("geom_adhesion", "geom_fluid", "site_pos", "site_quat", "site_bodyid", "actuator_"),
    *("tendon_", "wrap_", "eq_", "pair_", "exclude_", "key_qpos", "key_ctrl", "key_qvel"),
    *("qpos0", "qpos_spring"),
)
"""Prefixes of the names of the arrays in which the compiled new spec must agree with the given
model.
"""

_IGNORED_ARRAYS: Final = frozenset(
    {
        *("jnt_user", "actuator_user", "tendon_user", "tendon_matid", "tendon_rgba"),
        *("jnt_group", "actuator_group", "tendon_group", "tendon_width"),
        *("actuator_plugin", "actuator_history", "actuator_historyadr", "actuator_acc0"),
        "tendon_invweight0",
    }
)
"""Arrays that are not compared, although their names have a prefix of `_COMPARED_PREFIXES`: for
example groups, materials, colours and user data.
"""

_ARRAY_TOLERANCE: Final = 1e-9
"""Absolute tolerance, in the unit of the array, and relative tolerance of compared arrays. Reason:
MuJoCo normalises quaternions and axes again, which changes the last digits. Chosen, not tuned.
"""

_VERTEX_ATOL: Final = 1e-5
"""Absolute tolerance [m] of compared points of a geom (`_list_outline_points`), such as the
vertices of its mesh, which MuJoCo stores with seven digits. Chosen, not tuned.
"""


def make_spec_of_model(model: mujoco.MjModel, source: str) -> mujoco.MjSpec:
    """Reconstruct a spec that compiles to a model with the same dynamics as a given model.

    Bodies, hinges, slides and sites without a name get a name such as ``body_3``. The given model
    is not modified.

    Raises:
        ModelError: If the model has no names or an unsupported element, for example, or the
            compiled spec differs from the model.
    """
    joints = [model.joint(joint).name for joint in range(model.njnt)]
    bodies = [model.body(body).name for body in range(1, model.nbody)]
    if bodies and not any((*joints, *bodies)):
        raise ModelError(source, diagnose("model-without-names"))
    for count, element in _UNSUPPORTED_COUNTS.items():
        if getattr(model, count):
            raise ModelError(source, diagnose("model-not-written", element=element))
    try:
        spec = _SpecWriter(model).build_spec()
        made, shells, _ = compile_with_shells(spec.copy)
        put_shells(spec, shells)
    except (ValueError, RuntimeError, TypeError, KeyError, AttributeError) as error:
        problem = diagnose("model-not-decompiled", message=one_line(error))
        raise ModelError(source, problem) from error
    different = next(_list_differences(model, made), None)
    if different is not None:
        raise ModelError(source, diagnose("model-not-written", element=different))
    return spec


class _SpecWriter:
    """Writer of the elements of a compiled model to a new spec."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self.model, self.spec = model, mujoco.MjSpec()
        self._names: dict[tuple[str, int], str] = {}
        for kind, count in (
            *(("body", model.nbody), ("joint", model.njnt), ("geom", model.ngeom)),
            *(("site", model.nsite), ("tendon", model.ntendon), ("actuator", model.nactuator)),
            *(("mesh", model.nmesh), ("hfield", model.nhfield)),
        ):
            own = {getattr(model, kind)(index).name for index in range(count)}
            for index in range(count):
                name = str(getattr(model, kind)(index).name) or f"{kind}_{index}"
                while name in own and not getattr(model, kind)(index).name:
                    name += "_"
                self._names[kind, index] = name
        named_geoms = {*model.pair_geom1.tolist(), *model.pair_geom2.tolist()}
        named_geoms |= set(model.wrap_objid[np.isin(model.wrap_type, _GEOM_WRAPS)].tolist())
        for geom in set(range(model.ngeom)) - named_geoms:  # a foot is then named after its body
            self._names["geom", geom] = str(model.geom(geom).name)
        for joint in list_free_joints(model):
            self._names["joint", joint] = str(model.joint(joint).name)  # may have none

    def build_spec(self) -> mujoco.MjSpec:
        """Copy options and supported elements of a compiled model to a new spec; return it."""
        self._set_options()
        self._add_assets()
        self._add_bodies()
        self._add_tendons()
        self._add_actuators()
        self._add_constraints()
        for index in np.flatnonzero(np.isin(self.model.sensor_type, _IMU_SENSORS)).tolist():
            sensor = self.spec.add_sensor(name=self.model.sensor(index).name)
            sensor.type = mujoco.mjtSensor(int(self.model.sensor_type[index]))
            sensor.objtype = mujoco.mjtObj.mjOBJ_SITE
            sensor.objname = self._names["site", int(self.model.sensor_objid[index])]
        for index in range(self.model.nkey):
            key = self.spec.add_key(name=self.model.key(index).name)
            for name in _KEY_FIELDS:
                setattr(key, name, getattr(self.model, f"key_{name}")[index])
        return self.spec

    def _set_options(self) -> None:
        """Copy name and options to the spec; disable automatic changes by MuJoCo's compiler."""
        spec, model = self.spec, self.model
        names = bytes(model.names)
        spec.modelname = names[: names.index(b"\0")].decode() or "model"
        compiler = spec.compiler
        compiler.degree, compiler.autolimits, compiler.fusestatic = False, False, False
        compiler.boundmass = compiler.boundinertia = 0.0
        compiler.balanceinertia, compiler.settotalmass, compiler.alignfree = False, -1.0, False
        compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE
        for name in dir(model.opt):
            value = getattr(model.opt, name)
            if not name.startswith("_") and not callable(value):
                setattr(spec.option, name, value)

    def _add_assets(self) -> None:
        """Add meshes (vertices and faces) and height fields of the compiled model to the spec."""
        model = self.model
        for index in range(model.nmesh):
            mesh = self.spec.add_mesh(name=self._names["mesh", index])
            start, count = model.mesh_vertadr[index], model.mesh_vertnum[index]
            mesh.uservert = model.mesh_vert[start : start + count].ravel()
            start, count = model.mesh_faceadr[index], model.mesh_facenum[index]
            mesh.userface = model.mesh_face[start : start + count].ravel()
        for index in range(model.nhfield):
            field = self.spec.add_hfield(name=self._names["hfield", index])
            rows, columns = int(model.hfield_nrow[index]), int(model.hfield_ncol[index])
            start = int(model.hfield_adr[index])
            field.nrow, field.ncol = rows, columns
            field.size = model.hfield_size[index]
            field.userdata = model.hfield_data[start : start + rows * columns]

    def _add_bodies(self) -> None:
        """Add the bodies of the compiled model, with joints, geoms and sites, to the spec."""
        model = self.model
        bodies = [self.spec.worldbody]
        for index in range(1, model.nbody):
            body = bodies[model.body_parentid[index]].add_body(name=self._names["body", index])
            bodies.append(body)
            body.mocap = bool(model.body_mocapid[index] >= 0)
            body.explicitinertial = True
            _copy_fields(body, model, "body", index, {name: name for name in _SPEC_BODY_FIELDS})
        for index in range(model.njnt):
            self._add_joint(bodies[model.jnt_bodyid[index]], index)
        for index in range(model.ngeom):
            geom = bodies[model.geom_bodyid[index]].add_geom(name=self._names["geom", index])
            _copy_fields(geom, model, "geom", index, {name: name for name in _GEOM_FIELDS})
            data, kind = int(model.geom_dataid[index]), int(model.geom_type[index])
            if kind in (mujoco.mjtGeom.mjGEOM_MESH, mujoco.mjtGeom.mjGEOM_SDF):
                geom.meshname = self._names["mesh", data]
            if kind == mujoco.mjtGeom.mjGEOM_HFIELD:
                geom.hfieldname = self._names["hfield", data]
            geom.fluid_ellipsoid = float(model.geom_fluid[index, 0])
            if model.geom_fluid[index, 0]:
                geom.fluid_coefs = model.geom_fluid[index, 1:6]
        for index in range(model.nsite):
            site = bodies[model.site_bodyid[index]].add_site(name=self._names["site", index])
            _copy_fields(site, model, "site", index, {name: name for name in _SITE_FIELDS})

    def _add_joint(self, body: mujoco.MjsBody, index: int) -> None:
        """Add a joint of the compiled model (id ``index``) to a body of the spec."""
        model = self.model
        joint = body.add_joint(name=self._names["joint", index])
        _copy_fields(joint, model, "jnt", index, _SPEC_JOINT_FIELDS)
        dof, address = int(model.jnt_dofadr[index]), int(model.jnt_qposadr[index])
        _copy_fields(joint, model, "dof", dof, _DOF_FIELDS)
        joint.stiffness = _with_polynomial(model.jnt_stiffness, model.jnt_stiffnesspoly, index)
        joint.damping = _with_polynomial(model.dof_damping, model.dof_dampingpoly, dof)
        if int(model.jnt_type[index]) in (JointKind.SLIDE, JointKind.HINGE):
            joint.ref, joint.springref = model.qpos0[address], model.qpos_spring[address]

    def _add_tendons(self) -> None:
        """Add tendons, with the joints, sites, pulleys and geoms of each path, to the spec."""
        model = self.model
        for index in range(model.ntendon):
            tendon = self.spec.add_tendon(name=self._names["tendon", index])
            _copy_fields(tendon, model, "tendon", index, _TENDON_FIELDS)
            tendon.stiffness = _with_polynomial(
                model.tendon_stiffness, model.tendon_stiffnesspoly, index
            )
            tendon.damping = _with_polynomial(model.tendon_damping, model.tendon_dampingpoly, index)
            start = int(model.tendon_adr[index])
            for item in range(start, start + int(model.tendon_num[index])):
                kind, target = int(model.wrap_type[item]), int(model.wrap_objid[item])
                value = float(model.wrap_prm[item])
                if kind == mujoco.mjtWrap.mjWRAP_JOINT:
                    tendon.wrap_joint(self._names["joint", target], value)
                elif kind == mujoco.mjtWrap.mjWRAP_SITE:
                    tendon.wrap_site(self._names["site", target])
                elif kind == mujoco.mjtWrap.mjWRAP_PULLEY:
                    tendon.wrap_pulley(value)
                else:
                    side = "" if value < 0 else self._names["site", round(value)]
                    tendon.wrap_geom(self._names["geom", target], side)

    def _add_actuators(self) -> None:
        """Add the actuators of the compiled model, with transmissions, to the spec."""
        model, kinds = self.model, mujoco.mjtTrn
        targets = {
            kinds.mjTRN_JOINT.value: "joint",
            kinds.mjTRN_JOINTINPARENT.value: "joint",
            kinds.mjTRN_TENDON.value: "tendon",
            kinds.mjTRN_SITE.value: "site",
            kinds.mjTRN_SLIDERCRANK.value: "site",
            kinds.mjTRN_BODY.value: "body",
        }
        for index in range(model.nactuator):
            actuator = self.spec.add_actuator(name=self._names["actuator", index])
            rows = [(index, _ACTUATOR_FIELDS), (int(model.actuator_outadr[index]), _OUTPUT_FIELDS)]
            if model.actuator_ctrlnum[index]:  # the first control and the first output
                rows.append((int(model.actuator_ctrladr[index]), _CONTROL_FIELDS))
            for row, names in rows:
                _copy_fields(actuator, model, "actuator", row, {name: name for name in names})
            actuator.damping = _with_polynomial(
                model.actuator_damping, model.actuator_dampingpoly, index
            )
            kind = int(model.actuator_trntype[index])
            first, second = model.actuator_trnid[index].tolist()
            actuator.target = self._names[targets[kind], first]
            if kind == kinds.mjTRN_SITE and second >= 0:
                actuator.refsite = self._names["site", second]
            if kind == kinds.mjTRN_SLIDERCRANK:
                actuator.slidersite = self._names["site", second]
            actuator.actdim = int(model.actuator_actnum[index])

    def _add_constraints(self) -> None:
        """Add equality constraints, contact pairs and contact exclusions to the spec."""
        model = self.model
        object_kinds = {
            mujoco.mjtObj.mjOBJ_BODY.value: "body",
            mujoco.mjtObj.mjOBJ_SITE.value: "site",
            mujoco.mjtObj.mjOBJ_JOINT.value: "joint",
            mujoco.mjtObj.mjOBJ_TENDON.value: "tendon",
            mujoco.mjtObj.mjOBJ_GEOM.value: "geom",
        }
        for index in range(model.neq):
            equality = self.spec.add_equality(name=model.equality(index).name)
            _copy_fields(equality, model, "eq", index, {name: name for name in _EQUALITY_FIELDS})
            equality.active = bool(model.eq_active0[index])
            kind = int(model.eq_type[index])
            if kind in (mujoco.mjtEq.mjEQ_JOINT, mujoco.mjtEq.mjEQ_TENDON):
                objects = "joint" if kind == mujoco.mjtEq.mjEQ_JOINT else "tendon"
            else:
                objects = object_kinds[int(model.eq_objtype[index])]
            equality.name1 = self._names[objects, int(model.eq_obj1id[index])]
            if model.eq_obj2id[index] >= 0:
                equality.name2 = self._names[objects, int(model.eq_obj2id[index])]
        for index in range(model.npair):
            pair = self.spec.add_pair(name=model.pair(index).name)
            _copy_fields(pair, model, "pair", index, {name: name for name in _PAIR_FIELDS})
            pair.condim = int(model.pair_dim[index])
            pair.geomname1 = self._names["geom", int(model.pair_geom1[index])]
            pair.geomname2 = self._names["geom", int(model.pair_geom2[index])]
        for index, signature in enumerate(model.exclude_signature.tolist()):
            exclude = self.spec.add_exclude(name=model.exclude(index).name)
            exclude.bodyname1 = self._names["body", signature >> 16]
            exclude.bodyname2 = self._names["body", signature & 0xFFFF]


def _copy_fields(
    element: Any, model: mujoco.MjModel, prefix: str, index: int, names: Mapping[str, str]
) -> None:
    """Copy the values of element ``index`` of a model into a spec element, in place.

    ``names`` is {field of the spec element: suffix of the array}, and ``prefix`` the prefix of the
    arrays, such as ``geom``.
    """
    for name, source in names.items():
        value = getattr(model, f"{prefix}_{source}")[index]
        own = getattr(element, name)
        if isinstance(value, np.ndarray):
            own[: len(value)] = value
        elif isinstance(own, float):
            setattr(element, name, float(value))
        else:  # an enumeration, a number or a flag
            setattr(element, name, type(own)(int(value)))


def _with_polynomial(linear: Array, polynomial: Array, index: int) -> Array:
    """Return linear and further coefficients of a spring or damper, shape (1 + n,), linear first.

    ``linear`` (m,) and ``polynomial`` (m, n) are arrays of ``mjModel``, and ``index`` is the row of
    the element.
    """
    return np.concatenate([[linear[index]], polynomial[index]])


def _list_differences(model: mujoco.MjModel, made: mujoco.MjModel) -> Iterator[str]:
    """Yield the names of compared arrays, geoms and options in which two compiled models differ.

    ``model`` is the original. ``made`` is compiled from the reconstructed spec.
    """
    for name in dir(model):
        if not name.startswith(_COMPARED_PREFIXES) or name in _IGNORED_ARRAYS:
            continue
        first, second = getattr(model, name), getattr(made, name)
        if not isinstance(first, np.ndarray):
            continue
        equal = first.shape == second.shape and (
            not first.size
            or np.allclose(
                first, second, rtol=_ARRAY_TOLERANCE, atol=_ARRAY_TOLERANCE, equal_nan=True
            )
        )
        if not equal:
            yield name
    for geom in range(model.ngeom):
        if not np.allclose(
            _list_outline_points(model, geom), _list_outline_points(made, geom), atol=_VERTEX_ATOL
        ):
            yield f"geom_pos of geom {geom}"
    for name in dir(model.opt):
        value = getattr(model.opt, name)
        if name.startswith("_") or callable(value):
            continue
        if not np.array_equal(value, getattr(made.opt, name)):
            yield f"option {name}"


def _list_outline_points(model: mujoco.MjModel, geom: int) -> Array:
    """Return points that define pose and size of a geom, shape (n, 3) [m], in the body frame.

    For a mesh, the points are the vertices.
    """
    data = int(model.geom_dataid[geom])
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, model.geom_quat[geom])
    points = np.diag(model.geom_size[geom])
    if int(model.geom_type[geom]) == mujoco.mjtGeom.mjGEOM_MESH.value:
        start, count = model.mesh_vertadr[data], model.mesh_vertnum[data]
        points = np.asarray(model.mesh_vert[start : start + count], dtype=float)
    placed: Array = points @ rotation.reshape(3, 3).T + model.geom_pos[geom]
    return placed
