"""What acts on a robot in MuJoCo and has no words in a URDF: springs, tendons, fluid, loops.

A URDF states a tree of bodies, and damping and friction of its joints. MuJoCo's smooth dynamics
have more terms: passive forces (``qfrc_spring``, ``qfrc_damper``, ``qfrc_gravcomp``,
``qfrc_fluid``, and those of flexes and plugins), inertia through tendons and motors, and equality
constraints. Here they are found in a compiled model, one by one, each with the numbers that have
to be zero for it to be gone. Nothing rests on the list being complete: who uses it switches all of
it off, and compares what is left with a model that has none of it.

Source: MuJoCo documentation, "Computation: Passive forces" and "Constraint model: Equality"; the
arrays are those of ``mjModel``.
"""

from __future__ import annotations

import copy
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.models.conversion import actuator_gear, is_at_one_joint
from pupper_analysis.robot.coordinates import MujocoConvention

Array = NDArray[np.float64]

Mimics = Mapping[str, tuple[str, float, float]]
"""{joint: (the joint that it follows, multiplier, offset)}: q = multiplier q_other + offset."""

Slot = tuple[str, int | slice]
"""An array of ``mjModel`` (or a number of its ``opt``), and which of its rows."""

_DISABLE = mujoco.mjtDisableBit
_EQUALITY = mujoco.mjtEq


@dataclass(frozen=True, eq=False)
class Reference:
    """A compiled MJCF, and the names by which its elements are called.

    Attributes:
        model: What MuJoCo makes of the file, as it is; it may hold more than the robot.
        names: The same, in which every body and joint has a name.
        joint_names: The robot's joints, by those names.
        base: Its base, likewise.
    """

    model: mujoco.MjModel
    names: mujoco.MjModel
    joint_names: Sequence[str]
    base: str

    def joints(self) -> list[int]:
        """Returns the ids of the robot's joints, and of the free one of its base."""
        free = mujoco.mjtJoint.mjJNT_FREE.value
        base = self.names.body(self.base).id
        first = int(self.model.body_jntadr[base])
        loose = [first] if first >= 0 and self.model.jnt_type[first] == free else []
        return [*loose, *(self.names.joint(name).id for name in self.joint_names)]

    def convention(self) -> MujocoConvention:
        """Returns where the public coordinates are; other objects of a scene may float as well."""
        model, joints = self.model, self.joints()
        free = len(joints) - len(self.joint_names)
        starts = zip(model.jnt_qposadr[joints], model.jnt_dofadr[joints], strict=True)
        qpos: list[int] = []
        qvel: list[int] = []
        for number, (position, velocity) in enumerate(starts):
            qpos += range(position, position + (7 if number < free else 1))
            qvel += range(velocity, velocity + (6 if number < free else 1))
        return MujocoConvention(
            qpos_index=np.array(qpos, dtype=np.int64),
            qvel_index=np.array(qvel, dtype=np.int64),
            actuator_index=np.full(len(self.joint_names), -1),
        )

    def bodies(self) -> set[int]:
        """Returns the ids of the robot's bodies: all on the trees of its base and its joints."""
        model = self.model
        found = {self.names.body(self.base).id}
        found |= {int(model.jnt_bodyid[joint]) for joint in self.joints()}
        roots = {int(model.body_rootid[body]) for body in found} - {0}
        return {body for body in range(model.nbody) if int(model.body_rootid[body]) in roots}


@dataclass(frozen=True, eq=False)
class Extra:
    """An element of an MJCF that a URDF cannot state.

    Attributes:
        kind: ``spring``, ``damping polynomial``, ``gravity compensation``, ``tendon``, ``fluid``,
            ``actuator``, ``equality``, ``flex``, ``plugin`` or ``flag``.
        element: The joint, body, tendon ... by name; ``#3`` where it has none.
        value: Its numbers.
        unit: Of the numbers, where they have one in common.
        message: What it is, in plain words.
        slots: What has to be zero for it to be gone; none if it does not act on the unconstrained
            robot, or cannot be taken away.
    """

    kind: str
    element: str
    value: object
    unit: str
    message: str
    slots: tuple[Slot, ...] = field(default=())

    def switch(self, model: mujoco.MjModel, like: mujoco.MjModel | None) -> None:
        """Takes it away in a model (of `as_it_is`), in place; or takes another's numbers again."""
        for name, where in self.slots:
            if name.startswith("opt."):
                option = name.removeprefix("opt.")
                setattr(model.opt, option, 0.0 if like is None else getattr(like.opt, option))
            else:
                getattr(model, name)[where] = 0 if like is None else getattr(like, name)[where]


def as_it_is(model: mujoco.MjModel) -> mujoco.MjModel:
    """Returns a copy whose ``mj_forward`` gives the accelerations that the motors do not make.

    All that acts is left as it is; but no contact, joint or tendon limit, or dry friction acts, and
    the motors' control does not (their inertia and damping, the gravity compensation that goes
    through them, and what a DC motor does without a command, do). The integrator is set to Euler,
    for ``discrete`` would give accelerations that depend on the timestep.
    """
    result = copy.copy(model)
    for bit in (_DISABLE.mjDSBL_CONTACT, _DISABLE.mjDSBL_LIMIT, _DISABLE.mjDSBL_FRICTIONLOSS):
        result.opt.disableflags |= bit.value
    result.opt.integrator = mujoco.mjtIntegrator.mjINT_EULER.value
    # MuJoCo takes a com within 1e-6 m of its body's frame for the frame itself; not here.
    result.body_sameframe[:] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE.value
    # By groups: mjDSBL_ACTUATION would take away the gravity compensation of actuatorgravcomp, too.
    passive = [acts_without_command(model, motor) for motor in range(model.nactuator)]
    result.actuator_group[:] = np.where(passive, 1, 0)
    result.opt.disableactuator = 1
    return result


def acts_without_command(model: mujoco.MjModel, motor: int) -> bool:
    """Says whether a motor is a DC motor without a controller: its back-EMF brakes all the same."""
    dc = model.actuator_gaintype[motor] == mujoco.mjtGain.mjGAIN_DCMOTOR.value
    # Its inputs are a sum of 1 and 2 (setpoints of a controller), 4, 8 and 16 (none).
    controlled = bool(model.actuator_ctrlspec[motor] & 3)
    group = int(model.actuator_group[motor])
    switched_off = 0 <= group < 31 and bool(model.opt.disableactuator >> group & 1)
    return bool(dc) and not controlled and not switched_off


def without(model: mujoco.MjModel, extras: Iterable[Extra]) -> mujoco.MjModel:
    """Returns ``as_it_is(model)`` with some extras taken away."""
    result = as_it_is(model)
    for extra in extras:
        extra.switch(result, None)
    return result


def extras(reference: Reference) -> list[Extra]:
    """Finds all that acts on the robot and that a URDF cannot state."""
    finder = _Finder(reference)
    return [
        *finder.springs(),
        *finder.damping_polynomials(),
        *finder.gravity_compensation(),
        *finder.tendons(),
        *finder.actuators(),
        *finder.fluid(),
        *finder.equalities(),
        *finder.flexes(),
        *finder.plugins(),
        *finder.flags(),
    ]


class _Finder:
    """Walks over one reference."""

    def __init__(self, reference: Reference) -> None:
        self.reference, self.model, self.names = reference, reference.model, reference.names
        self.bodies = reference.bodies()

    def off(self, bit: mujoco.mjtDisableBit) -> bool:
        return bool(self.model.opt.disableflags & bit.value)

    def name(self, kind: str, index: int) -> str:
        what = getattr(mujoco.mjtObj, f"mjOBJ_{kind.upper()}").value
        return mujoco.mj_id2name(self.names, what, index) or f"#{index}"

    def joint_name(self, joint: int) -> str:
        """A joint's name; the base's for its free joint."""
        if self.model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE.value:
            return self.reference.base
        return self.name("joint", joint)

    def unit(self, joint: int) -> tuple[str, str]:
        """The units of a joint's force and coordinate."""
        slides = self.model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE.value
        return ("N", "m") if slides else ("N m", "rad")

    def springs(self) -> Iterator[Extra]:
        model = self.model
        for joint in self.reference.joints() if not self.off(_DISABLE.mjDSBL_SPRING) else ():
            linear, higher = float(model.jnt_stiffness[joint]), model.jnt_stiffnesspoly[joint]
            if not (linear or higher.any()):
                continue
            force, length = self.unit(joint)
            name = self.joint_name(joint)
            value: dict[str, object] = {"stiffness": linear}
            text = f"stiffness {linear:.6g} {force}/{length}"
            if higher.any():
                value["polynomial"] = [float(each) for each in higher]
                text += f" and {_list(higher)} in the next powers"
            if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE.value:
                text += " in all six directions"
            else:
                rest = float(model.qpos_spring[model.jnt_qposadr[joint]])
                value["rest"] = rest
                text += f", at rest at {rest:.6g} {length}"
            if model.jnt_springyield[joint]:
                value["yield"] = float(model.jnt_springyield[joint])
                text += f", yielding at {value['yield']:.6g}"
            yield Extra(
                "spring",
                name,
                value,
                f"{force}/{length}",
                f"joint {name}: no spring in the URDF, one of {text} in the MJCF",
                (("jnt_stiffness", joint), ("jnt_stiffnesspoly", joint)),
            )

    def damping_polynomials(self) -> Iterator[Extra]:
        model = self.model
        for joint in self.reference.joints() if not self.off(_DISABLE.mjDSBL_DAMPER) else ():
            first = int(model.jnt_dofadr[joint])
            free = model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE.value
            dofs = slice(first, first + (6 if free else 1))
            if model.dof_dampingpoly[dofs].any():
                values = [float(each) for each in model.dof_dampingpoly[first]]
                name = self.joint_name(joint)
                text = (
                    f"joint {name}: linear damping in the URDF, and {_list(values)} in the next "
                    "powers of the speed in the MJCF"
                )
                slots = (("dof_dampingpoly", dofs),)
                yield Extra("damping polynomial", name, values, "", text, slots)

    def gravity_compensation(self) -> Iterator[Extra]:
        model = self.model
        for body in sorted(self.bodies):
            share = float(model.body_gravcomp[body])
            if share and model.body_mass[body] and model.body_weldid[body]:
                name = self.name("body", body)
                text = (
                    f"body {name}: no gravity compensation in the URDF, of {100 * share:.6g} % of "
                    "its weight in the MJCF"
                )
                slots = (("body_gravcomp", body),)
                yield Extra("gravity compensation", name, share, "", text, slots)

    # ------------------------------------------------------------------------- tendons, motors

    def tendons(self) -> Iterator[Extra]:
        model = self.model
        for tendon in range(model.ntendon):
            if not self._wraps(tendon) & self.bodies:
                continue
            force, length = self._tendon_units(tendon)
            value, text, acts = self._tendon(tendon, force, length)
            if not value:
                continue
            name = self.name("tendon", tendon)
            arrays = ("stiffness", "stiffnesspoly", "damping", "dampingpoly", "armature")
            slots = tuple((f"tendon_{array}", tendon) for array in arrays) if acts else ()
            message = f"tendon {name}: none in the URDF, in the MJCF with {', '.join(text)}"
            yield Extra("tendon", name, value, "", message, slots)

    def _tendon(
        self, tendon: int, force: str, length: str
    ) -> tuple[dict[str, object], list[str], bool]:
        """A tendon's numbers, in words too, and whether it acts without limits and friction."""
        model = self.model
        value: dict[str, object] = {}
        text = []
        inertia = "kg" if length == "m" else "kg m^2"
        for kind, unit, switch in (
            ("stiffness", f"{force}/{length}", _DISABLE.mjDSBL_SPRING),
            ("damping", f"{force} s/{length}", _DISABLE.mjDSBL_DAMPER),
            ("armature", inertia, None),
            ("frictionloss", force, None),
        ):
            linear = float(getattr(model, f"tendon_{kind}")[tendon])
            powers = getattr(model, f"tendon_{kind}poly", np.zeros((model.ntendon, 1)))[tendon]
            if not (linear or powers.any()) or (switch is not None and self.off(switch)):
                continue
            value[kind] = linear if not powers.any() else [linear, *map(float, powers)]
            text.append(f"{kind} {linear:.6g} {unit}")
            if powers.any():
                text[-1] += f" and {_list(powers)} in the next powers"
            if kind == "stiffness":
                value["rest"] = [float(each) for each in model.tendon_lengthspring[tendon]]
                text[-1] += f" (at rest at {_list(model.tendon_lengthspring[tendon])} {length})"
        acts = bool(value.keys() & {"stiffness", "damping", "armature"})
        if model.tendon_limited[tendon]:
            value["range"] = [float(each) for each in model.tendon_range[tendon]]
            text.append(f"its length kept in {_list(model.tendon_range[tendon])} {length}")
        return value, text, acts

    def _wraps(self, tendon: int) -> set[int]:
        """The bodies that a tendon pulls at."""
        model = self.model
        wrap = mujoco.mjtWrap
        bodies = set()
        first = int(model.tendon_adr[tendon])
        for index in range(first, first + int(model.tendon_num[tendon])):
            kind, other = int(model.wrap_type[index]), int(model.wrap_objid[index])
            if kind == wrap.mjWRAP_JOINT.value:
                bodies.add(int(model.jnt_bodyid[other]))
            elif kind == wrap.mjWRAP_SITE.value:
                bodies.add(int(model.site_bodyid[other]))
            elif kind in (wrap.mjWRAP_SPHERE.value, wrap.mjWRAP_CYLINDER.value):
                bodies.add(int(model.geom_bodyid[other]))
        return bodies

    def _tendon_units(self, tendon: int) -> tuple[str, str]:
        """The units of a tendon's force and length; a fixed one adds up its joints' coordinates."""
        model, first = self.model, int(self.model.tendon_adr[tendon])
        if model.wrap_type[first] != mujoco.mjtWrap.mjWRAP_JOINT.value:
            return "N", "m"
        joints = model.wrap_objid[first : first + int(model.tendon_num[tendon])]
        units = {self.unit(int(joint)) for joint in joints}
        return units.pop() if len(units) == 1 else ("", "unit of its length")

    def actuators(self) -> Iterator[Extra]:
        """Inertia and damping of motors; at one joint, the linear ones count as the joint's."""
        model = self.model
        for motor in range(model.nactuator):
            if not self._drives(motor) & self.bodies:
                continue
            at_joint = is_at_one_joint(model, motor)
            armature = 0.0 if at_joint else float(model.actuator_armature[motor])
            damping = 0.0 if at_joint else float(model.actuator_damping[motor])
            higher = model.actuator_dampingpoly[motor]
            if self.off(_DISABLE.mjDSBL_DAMPER):
                damping, higher = 0.0, np.zeros_like(higher)
            value: dict[str, object] = {}
            slots: list[Slot] = []
            for word, number in (("armature", armature), ("damping", damping)):
                if number:
                    value[word] = number
                    slots.append((f"actuator_{word}", motor))
            if higher.any():
                value["damping polynomial"] = [float(each) for each in higher]
                slots.append(("actuator_dampingpoly", motor))
            name = self.name("actuator", motor)
            if acts_without_command(model, motor) and not self.off(_DISABLE.mjDSBL_ACTUATION):
                message = (
                    f"actuator {name}: nothing in the URDF, in the MJCF it is a DC motor, which "
                    "brakes without a command"
                )
                group = ("actuator_group", motor)  # 0 is off in `as_it_is`
                yield Extra("actuator", name, "DC motor", "", message, (group,))
            if value:
                said = ", ".join(f"{word} {_numbers(number)}" for word, number in value.items())
                gear = _list(actuator_gear(model, motor))
                message = (
                    f"actuator {name}: nothing in the URDF, in the MJCF it has {said} (gear {gear})"
                )
                yield Extra("actuator", name, value, "", message, tuple(slots))

    def _drives(self, motor: int) -> set[int]:
        """The bodies that a motor acts on."""
        model = self.model
        kind, (target, other) = int(model.actuator_trntype[motor]), model.actuator_trnid[motor]
        transmission = mujoco.mjtTrn
        if kind in (transmission.mjTRN_JOINT.value, transmission.mjTRN_JOINTINPARENT.value):
            return {int(model.jnt_bodyid[target])}
        if kind == transmission.mjTRN_TENDON.value:
            return self._wraps(int(target))
        if kind == transmission.mjTRN_BODY.value:
            return {int(target)}
        sites = [int(site) for site in (target, other) if 0 <= site < model.nsite]
        return {int(model.site_bodyid[site]) for site in sites}

    # ------------------------------------------------------------------------- the rest

    def fluid(self) -> Iterator[Extra]:
        option = self.model.opt
        if option.density or option.viscosity:
            wind = [float(each) for each in option.wind]
            value = {"density": option.density, "viscosity": option.viscosity, "wind": wind}
            text = (
                f"fluid: none in the URDF, in the MJCF of density {option.density:.6g} kg/m^3, "
                f"viscosity {option.viscosity:.6g} Pa s, wind {_list(wind)} m/s"
            )
            slots: tuple[Slot, ...] = (("opt.density", 0), ("opt.viscosity", 0))
            yield Extra("fluid", "option", value, "", text, slots)

    def equalities(self) -> Iterator[Extra]:
        model = self.model
        if self.off(_DISABLE.mjDSBL_CONSTRAINT) or self.off(_DISABLE.mjDSBL_EQUALITY):
            return
        for index in range(model.neq):
            if not model.eq_active0[index]:
                continue
            ends = self._ends(index)
            bodies = [self._end_bodies(what, target) for what, target in ends]
            if not any(end is None or end & self.bodies for end in bodies):
                continue  # of other objects of the scene
            name = self.name("equality", index)
            kind = _EQUALITY(int(model.eq_type[index])).name.removeprefix("mjEQ_").lower()
            what = " and ".join(self._end_name(*end) for end in ends)
            yield Extra(
                "equality",
                name,
                [float(each) for each in model.eq_data[index]],
                "",
                f"equality {name}: nothing in the URDF, in the MJCF it is a {kind} of {what}",
                (("eq_active0", index),),
            )

    def _ends(self, index: int) -> list[tuple[mujoco.mjtObj, int]]:
        """The kinds and ids of the two objects of an equality; -1 where it has one only."""
        model = self.model
        what = _ENDS.get(int(model.eq_type[index])) or mujoco.mjtObj(int(model.eq_objtype[index]))
        return [(what, int(model.eq_obj1id[index])), (what, int(model.eq_obj2id[index]))]

    def _end_bodies(self, what: mujoco.mjtObj, target: int) -> set[int] | None:
        """The bodies that an equality holds at one end; None where it is not known."""
        model, kinds = self.model, mujoco.mjtObj
        if target < 0:
            return set()
        if what == kinds.mjOBJ_TENDON:
            return self._wraps(target)
        carrier = {
            kinds.mjOBJ_BODY: np.arange(model.nbody),
            kinds.mjOBJ_JOINT: model.jnt_bodyid,
            kinds.mjOBJ_SITE: model.site_bodyid,
            kinds.mjOBJ_GEOM: model.geom_bodyid,
        }.get(what)
        return None if carrier is None else {int(carrier[target])}

    def _end_name(self, what: mujoco.mjtObj, target: int) -> str:
        if target < 0:
            return "a constant"
        name = mujoco.mj_id2name(self.names, what.value, target)
        return f"{what.name.removeprefix('mjOBJ_').lower()} {name or f'#{target}'}"

    def flexes(self) -> Iterator[Extra]:
        model = self.model
        if not model.nflex:
            return
        touched = {int(body) for body in (*model.flex_vertbodyid, *model.flex_nodebodyid)}
        everything = slice(None)
        arrays = ("stiffness", "bending", "damping", "edgestiffness", "edgedamping")
        filled = [f"flex_{array}" for array in arrays if getattr(model, f"flex_{array}").any()]
        if touched & self.bodies:
            name = self.name("flex", 0)
            message = f"flex {name}: nothing in the URDF, in the MJCF it is fixed to the robot"
            slots = tuple((array, everything) for array in filled)
            yield Extra("flex", name, model.nflex, "", message, slots)

    def plugins(self) -> Iterator[Extra]:
        """Plugins of bodies; they cannot be switched off in a compiled model."""
        for body in sorted(self.bodies):
            if self.model.body_plugin[body] >= 0:
                name = self.name("body", body)
                message = f"body {name}: nothing in the URDF, in the MJCF a plugin acts on it"
                yield Extra("plugin", name, int(self.model.body_plugin[body]), "", message)

    def flags(self) -> Iterator[Extra]:
        """What the file states and switches off again; springs and damping are 0 then."""
        for bit, word, what in _FLAGS:
            if self.off(bit):
                message = f'flag {word}="disable" of the MJCF: {what}, the URDF cannot say so'
                yield Extra("flag", word, "disable", "", message)


# MuJoCo's eq_objtype is for constraints that take bodies or sites.
_ENDS = {
    _EQUALITY.mjEQ_JOINT.value: mujoco.mjtObj.mjOBJ_JOINT,
    _EQUALITY.mjEQ_TENDON.value: mujoco.mjtObj.mjOBJ_TENDON,
    _EQUALITY.mjEQ_FLEX.value: mujoco.mjtObj.mjOBJ_FLEX,
    _EQUALITY.mjEQ_FLEXVERT.value: mujoco.mjtObj.mjOBJ_FLEX,
    _EQUALITY.mjEQ_FLEXSTRAIN.value: mujoco.mjtObj.mjOBJ_FLEX,
}

_FLAGS = (
    (_DISABLE.mjDSBL_LIMIT, "limit", "no joint limit acts"),
    (_DISABLE.mjDSBL_FRICTIONLOSS, "frictionloss", "no dry friction acts"),
    (_DISABLE.mjDSBL_CONSTRAINT, "constraint", "no limit, dry friction or contact acts"),
    (_DISABLE.mjDSBL_ACTUATION, "actuation", "no motor acts"),
)


def urdf_mimics(root: Any) -> dict[str, tuple[str, float, float]]:
    """Returns the joints of a parsed URDF that follow others: their ``<mimic>``."""
    found = {}
    for joint in root.findall("joint"):
        mimic = joint.find("mimic")
        if mimic is not None and joint.get("type") != "fixed":
            numbers = (float(mimic.get("multiplier", 1)), float(mimic.get("offset", 0)))
            found[str(joint.get("name"))] = (str(mimic.get("joint")), *numbers)
    return found


def split_mimics(
    found: Sequence[Extra], reference: Reference, mimics: Mimics, tolerance: float
) -> tuple[list[Extra], list[str]]:
    """Tells which joint equalities say the same as a URDF's ``<mimic>``, and are no extras.

    Both state q = m q_other + c. MuJoCo's polynomial is of the coordinates less their ``qpos0``:
    q - q0 = a0 + a1 (q_other - q0_other), so that m = a1 and c = a0 + q0 - a1 q0_other.

    Args:
        found: The extras of the reference.
        reference: The MJCF.
        mimics: The URDF's, by the reference's names.
        tolerance: How far offsets (rad or m), and multipliers relative to 1, may differ.

    Returns:
        The extras that are the URDF's, too; and the joints whose mimic no equality states.
    """
    model = reference.model
    same: list[Extra] = []
    left = dict(mimics)
    for extra in found:
        if extra.kind != "equality":
            continue
        index = int(extra.slots[0][1])  # type: ignore[arg-type]
        data, ids = model.eq_data[index], (model.eq_obj1id[index], model.eq_obj2id[index])
        if model.eq_type[index] != _EQUALITY.mjEQ_JOINT.value or min(ids) < 0 or data[2:5].any():
            continue
        one, two = (reference.names.joint(int(joint)).name for joint in ids)
        rest = [float(model.qpos0[model.jnt_qposadr[joint]]) for joint in ids]
        slope = float(data[1])
        offset = float(data[0]) + rest[0] - slope * rest[1]
        said = [(one, (two, slope, offset))]
        if slope:
            said.append((two, (one, 1 / slope, -offset / slope)))  # the same, read backwards
        for joint, (other, multiplier, constant) in said:
            leader, wanted, shift = left.get(joint, ("", 0.0, 0.0))
            near = abs(multiplier - wanted) <= tolerance * max(1.0, abs(wanted))
            if leader == other and near and abs(constant - shift) <= tolerance:
                same.append(extra)
                del left[joint]
                break
    return same, list(left)


def _list(values: Iterable[float]) -> str:
    return "(" + ", ".join(f"{float(value) + 0.0:.6g}" for value in values) + ")"


def _numbers(value: object) -> str:
    return f"{value:.6g}" if isinstance(value, float) else _list(value)  # type: ignore[arg-type]
