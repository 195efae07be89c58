"""Forces and constraints in an MJCF that a URDF cannot specify: springs, tendons, fluid, loops.

A URDF contains a tree of bodies, and damping and friction of joints. MuJoCo's smooth dynamics have
further terms: passive forces (``qfrc_spring``, ``qfrc_damper``, ``qfrc_gravcomp``, ``qfrc_fluid``),
inertia of tendons and actuators, and equality constraints. Such elements of a compiled model are
listed with the array entries that must be zero to disable an element. The list may be incomplete
(for example without flexes and plugins). `explain_differences` therefore compares a model whose
listed elements are disabled with the URDF.

Source: MuJoCo documentation, "Computation: Passive forces" and "Constraint model: Equality". Array
names are names in ``mjModel``.
"""

from __future__ import annotations

import copy
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from pupper_analysis.base.diagnostics import Quantity, Term, Vector, diagnose
from pupper_analysis.models.mjcf import JointKind, equality_ends, equality_name
from pupper_analysis.models.transmission import (
    actuator_gear,
    is_at_one_joint,
    list_actuator_targets,
)
from pupper_analysis.robot.compare.differences import Stated
from pupper_analysis.robot.matching.trees import Mimic, Mimics, Reference

Slot = tuple[str, int | slice]
"""(name of an array of ``mjModel``, row or slice of rows). The name of an option has the prefix
``opt.``, for example ``opt.density``."""


@dataclass(frozen=True, eq=False)
class MjcfOnlyEffect(Stated):
    """Element of an MJCF that a URDF cannot specify; for the inherited attributes see `Stated`.

    Attributes:
        slots: Entries of ``mjModel`` that must be zero to disable the element. Empty if the element
            does not affect the unconstrained robot, or cannot be disabled.
    """

    slots: tuple[Slot, ...] = ()

    def switch(self, model: mujoco.MjModel, like: mujoco.MjModel | None) -> None:
        """Disable this element of the MJCF in a compiled model, or restore its values, in place.

        Args:
            model: Model from `make_passive_model`; modified.
            like: Model whose values are copied to enable the element; None disables the element.
        """
        for name, rows in self.slots:
            if name.startswith("opt."):
                option = name.removeprefix("opt.")
                setattr(model.opt, option, 0.0 if like is None else getattr(like.opt, option))
            else:
                getattr(model, name)[rows] = 0 if like is None else getattr(like, name)[rows]


def make_passive_model(model: mujoco.MjModel) -> mujoco.MjModel:
    """Return a copy of a model without contacts, limits, dry friction and actuator commands.

    Servos exert no force. Terms of actuators that act without a command are kept: armature,
    damping, gravity compensation, and the back-EMF of DC motors without a controller.

    The integrator is Euler, because the accelerations of MuJoCo's integrator ``discrete`` depend on
    the time step.
    """
    result = copy.copy(model)
    for bit in (DISABLE.mjDSBL_CONTACT, DISABLE.mjDSBL_LIMIT, DISABLE.mjDSBL_FRICTIONLOSS):
        result.opt.disableflags |= bit.value
    result.opt.integrator = mujoco.mjtIntegrator.mjINT_EULER.value
    # By default, MuJoCo moves a CoM within 1e-6 m of the origin of its body to the origin.
    result.body_sameframe[:] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE.value
    # Disabled by groups, because mjDSBL_ACTUATION would also disable actuatorgravcomp.
    passive = [acts_without_command(model, motor) for motor in range(model.nactuator)]
    result.actuator_group[:] = np.where(passive, 1, 0)
    result.opt.disableactuator = 1
    return result


def acts_without_command(model: mujoco.MjModel, motor: int) -> bool:
    """Return True if an actuator is an enabled DC motor without a controller: its back-EMF brakes.

    Args:
        model: MuJoCo model.
        motor: Id of the actuator.
    """
    is_dc_motor = model.actuator_gaintype[motor] == mujoco.mjtGain.mjGAIN_DCMOTOR.value
    # Bits of the inputs: 1 and 2 are setpoints of a controller; 4, 8 and 16 are not.
    controlled = bool(model.actuator_ctrlspec[motor] & 3)
    group = int(model.actuator_group[motor])
    is_disabled = 0 <= group < 31 and bool(model.opt.disableactuator >> group & 1)
    return bool(is_dc_motor) and not controlled and not is_disabled


def without_effects(model: mujoco.MjModel, effects: Iterable[MjcfOnlyEffect]) -> mujoco.MjModel:
    """Return a passive copy of a model in which given MJCF-only effects are disabled.

    The copy has no contacts, limits, dry friction and commands (`make_passive_model`).

    Args:
        model: MuJoCo model; not changed.
        effects: Effects to disable.
    """
    result = make_passive_model(model)
    for effect in effects:
        effect.switch(result, None)
    return result


DISABLE = mujoco.mjtDisableBit
"""MuJoCo's enumeration of disable flags."""

Numbers = dict[str, float | list[float]]
"""{attribute of an MJCF element, or array of ``mjModel``: one or several values, in MuJoCo's
units}."""

_DISABLING_FLAGS = {
    "stiffness": (DISABLE.mjDSBL_SPRING,),
    "stiffnesspoly": (DISABLE.mjDSBL_SPRING,),
    "damping": (DISABLE.mjDSBL_DAMPER,),
    "dampingpoly": (DISABLE.mjDSBL_DAMPER,),
    "frictionloss": (DISABLE.mjDSBL_FRICTIONLOSS,),
}
"""{attribute of an MJCF element: flags of MuJoCo, each of which disables the attribute}."""


class NamedModel:
    """Queries of names, values and flags of the elements of a compiled MJCF.

    Args:
        reference: Compiled MJCF, and element names.
    """

    def __init__(self, reference: Reference) -> None:
        self.reference, self.model, self.names = reference, reference.model, reference.names
        self.bodies = reference.bodies()
        model, kinds = reference.model, mujoco.mjtObj
        trees = model.body_treeid
        self._trees = set(trees[sorted(self.bodies)].tolist()) - {-1}
        self._trees_of = {
            kinds.mjOBJ_BODY: trees,
            kinds.mjOBJ_JOINT: trees[model.jnt_bodyid],
            kinds.mjOBJ_SITE: trees[model.site_bodyid],
            kinds.mjOBJ_GEOM: trees[model.geom_bodyid],
            kinds.mjOBJ_TENDON: model.tendon_treeid,
            kinds.mjOBJ_FLEX: trees[model.flex_vertbodyid[model.flex_vertadr]],
        }

    def is_disabled(self, bit: mujoco.mjtDisableBit) -> bool:
        """Return True if the MJCF disables a term of the dynamics by the flag ``bit``."""
        return bool(self.model.opt.disableflags & bit.value)

    def is_part_of_robot(self, object_type: mujoco.mjtObj, index: int) -> bool:
        """Return True if an element belongs to a kinematic tree of the robot.

        Args:
            object_type: Type of the element, for example a body or joint.
            index: Id of the element; False is returned for -1.
        """
        return index >= 0 and not self._trees.isdisjoint(
            np.ravel(self._trees_of[object_type][index])
        )

    def name(self, kind: str, index: int) -> str:
        """Return the name of an element of this MJCF; without a name, the id: ``#3``.

        Args:
            kind: Type of the element in lower case, for example ``joint`` or ``tendon``.
            index: Id of the element.
        """
        object_type = getattr(mujoco.mjtObj, f"mjOBJ_{kind.upper()}").value
        return mujoco.mj_id2name(self.names, object_type, index) or f"#{index}"

    def joint_name(self, joint: int) -> str:
        """Return the name of a joint; for a free joint, the name of the base.

        Args:
            joint: Id of the joint.
        """
        if self.model.jnt_type[joint] == JointKind.FREE:
            return self.reference.base
        return self.name("joint", joint)

    def read_nonzero_values(self, prefix: str, index: int | slice, words: Sequence[str]) -> Numbers:
        """Return the nonzero attributes of an element, for example of a tendon.

        An attribute counts as zero if a flag of the MJCF disables it, such as ``damping`` with the
        flag ``damper`` (`_DISABLING_FLAGS`).

        Args:
            prefix: Prefix of the arrays of ``mjModel``, for example ``jnt`` for ``jnt_stiffness``.
            index: Row or rows of the element in the arrays.
            words: Attributes: names of the arrays without prefix.

        Returns:
            {attribute: value or values}.
        """
        nonzero: Numbers = {}
        for word in words:
            values = np.ravel(getattr(self.model, f"{prefix}_{word}")[index])
            if values.any() and not any(
                self.is_disabled(bit) for bit in _DISABLING_FLAGS.get(word, ())
            ):
                nonzero[word] = float(values[0]) if len(values) == 1 else values.tolist()
        return nonzero


def _make_effect(
    kind: str,
    subject: tuple[str, str],
    prefix: str,
    index: int | slice,
    numbers: Numbers,
    beside: Numbers | None = None,
) -> MjcfOnlyEffect:
    """Create the record of an element that only the MJCF has, with the entries that disable it.

    ``prefix`` and the keys of ``numbers`` name arrays of ``mjModel``. Their rows ``index`` are set
    to zero to disable the element, except ``frictionloss``. ``beside`` contains further values for
    the message.
    """
    value = {**numbers, **(beside or {})}
    stated = [
        diagnose(
            "mjcf-number",
            word=word,
            value=Vector(tuple(number), "1") if isinstance(number, list) else Quantity(number, "1"),
        )
        for word, number in value.items()
    ]
    message = diagnose("of-the-mjcf-alone", subject=subject, stated=stated)
    slots = tuple((f"{prefix}_{word}", index) for word in numbers if word != "frictionloss")
    mjcf_value = value if len(value) > 1 else next(iter(value.values()))
    return MjcfOnlyEffect(kind, subject[1], None, mjcf_value, "", message, slots)


def of_joints(scene: NamedModel) -> Iterator[MjcfOnlyEffect]:
    """Yield springs and nonlinear damping of joints, and dry friction of the free joint.

    A URDF cannot specify these terms.

    Args:
        scene: Compiled MJCF, with the names of its elements.
    """
    model = scene.model
    for joint in scene.reference.joints():
        subject, is_free = (
            ("joint", scene.joint_name(joint)),
            model.jnt_type[joint] == JointKind.FREE,
        )
        first = int(model.jnt_dofadr[joint])
        spring = scene.read_nonzero_values("jnt", joint, ("stiffness", "stiffnesspoly"))
        if spring:
            beside = scene.read_nonzero_values("jnt", joint, ("springyield",))
            if not is_free:
                beside["springref"] = float(model.qpos_spring[model.jnt_qposadr[joint]])
            yield _make_effect("spring", subject, "jnt", joint, spring, beside)
        if damping := scene.read_nonzero_values("dof", first, ("dampingpoly",)):
            dofs = slice(first, first + (6 if is_free else 1))
            yield _make_effect("damping polynomial", subject, "dof", dofs, damping)
        if is_free and (friction := scene.read_nonzero_values("dof", first, ("frictionloss",))):
            yield _make_effect("dry friction", subject, "dof", first, friction)


def of_bodies(scene: NamedModel) -> Iterator[MjcfOnlyEffect]:
    """Yield the gravity compensation (``gravcomp``) of moving bodies with mass, unknown in a URDF.

    Args:
        scene: Compiled MJCF, with the names of its elements.
    """
    model = scene.model
    for body in sorted(scene.bodies):
        compensation = scene.read_nonzero_values("body", body, ("gravcomp",))
        if compensation and model.body_mass[body] and model.body_weldid[body]:
            subject = "body", scene.name("body", body)
            yield _make_effect("gravity compensation", subject, "body", body, compensation)


def of_tendons(scene: NamedModel) -> Iterator[MjcfOnlyEffect]:
    """Yield the tendons with stiffness, damping, armature, friction or a limit, unknown in a URDF.

    Args:
        scene: Compiled MJCF, with the names of its elements.
    """
    model = scene.model
    words = ("stiffness", "stiffnesspoly", "damping", "dampingpoly", "armature", "frictionloss")
    for tendon in range(model.ntendon):
        if not scene.is_part_of_robot(mujoco.mjtObj.mjOBJ_TENDON, tendon):
            continue
        nonzero, beside = (
            scene.read_nonzero_values("tendon", tendon, words),
            dict[str, float | list[float]](),
        )
        if nonzero.keys() & {"stiffness", "stiffnesspoly"}:
            beside["springlength"] = model.tendon_lengthspring[tendon].tolist()
        if model.tendon_limited[tendon]:
            beside["range"] = model.tendon_range[tendon].tolist()
        if nonzero or beside:
            subject = "tendon", scene.name("tendon", tendon)
            yield _make_effect("tendon", subject, "tendon", tendon, nonzero, beside)


def of_actuators(scene: NamedModel) -> Iterator[MjcfOnlyEffect]:
    """Yield actuators with armature, damping or back-EMF, which a URDF cannot specify.

    Armature and linear damping of an actuator at a single joint are omitted, because they count as
    armature and damping of the joint.

    Args:
        scene: Compiled MJCF, with the names of its elements.
    """
    model = scene.model
    for motor in range(model.nactuator):
        object_type, targets = list_actuator_targets(model, motor)
        if not any(scene.is_part_of_robot(object_type, target) for target in targets):
            continue
        subject = "actuator", scene.name("actuator", motor)
        linear = () if is_at_one_joint(model, motor) else ("armature", "damping")
        nonzero = scene.read_nonzero_values("actuator", motor, (*linear, "dampingpoly"))
        if acts_without_command(model, motor) and not scene.is_disabled(DISABLE.mjDSBL_ACTUATION):
            message = diagnose("dc-motor-of-the-mjcf-alone", subject=subject)
            group = ("actuator_group", motor)  # `make_passive_model` disables group 0
            yield MjcfOnlyEffect("actuator", subject[1], None, "DC motor", "", message, (group,))
        if nonzero:
            gear: Numbers = {"gear": list(map(float, actuator_gear(model, motor)))}
            yield _make_effect("actuator", subject, "actuator", motor, nonzero, gear)


EQUALITY = mujoco.mjtEq
"""MuJoCo's enumeration of equality constraints."""


def split_mimics(
    found: Sequence[MjcfOnlyEffect], reference: Reference, mimics: Mimics, tolerance: float
) -> tuple[list[MjcfOnlyEffect], list[str]]:
    """Separate the joint equalities of an MJCF that are equivalent to a ``<mimic>`` of the URDF.

    Args:
        found: Elements that only the MJCF can specify (`mjcf_only_effects`).
        reference: The MJCF.
        mimics: Mimic joints of the URDF, with the joint names of the MJCF.
        tolerance: Tolerance of offsets [rad, m], and of multipliers [1]. The tolerance of a
            multiplier above 1 is relative.

    Returns:
        Equalities that are equivalent to a mimic; joints whose mimic has no equivalent equality.
    """
    equivalent: list[MjcfOnlyEffect] = []
    unmatched = dict(mimics)
    for effect in found:
        for joint, (other_leader, multiplier, constant) in list_couplings(
            effect, reference
        ).items():
            leader, expected, shift = unmatched.get(joint, ("", 0.0, 0.0))
            is_equal = abs(multiplier - expected) <= tolerance * max(1.0, abs(expected))
            if leader == other_leader and is_equal and abs(constant - shift) <= tolerance:
                equivalent.append(effect)
                del unmatched[joint]
                break
    return equivalent, list(unmatched)


def list_couplings(effect: MjcfOnlyEffect, reference: Reference) -> dict[str, Mimic]:
    """List the mimic couplings that are equivalent to a linear joint equality of an MJCF.

    A mimic is q = m q_leader + c. MuJoCo's polynomial uses coordinates relative to ``qpos0``: q -
    q0 = a0 + a1 (q_leader - q0_leader). Therefore m = a1 and c = a0 + q0 - a1 q0_leader. If a1 is
    not zero, either joint may be the leader.

    Args:
        effect: Element that only the MJCF can specify.
        reference: The MJCF.

    Returns:
        {joint: coupling}; empty if the element is no linear equality of two joints.
    """
    model = reference.model
    if effect.kind != "equality":
        return {}
    index = int(effect.slots[0][1])  # type: ignore[arg-type]
    data, ids = model.eq_data[index], (model.eq_obj1id[index], model.eq_obj2id[index])
    if model.eq_type[index] != EQUALITY.mjEQ_JOINT.value or min(ids) < 0 or data[2:5].any():
        return {}
    first, second = (reference.names.joint(int(joint)).name for joint in ids)
    rest_positions = [float(model.qpos0[model.jnt_qposadr[joint]]) for joint in ids]
    slope = float(data[1])
    offset = float(data[0]) + rest_positions[0] - slope * rest_positions[1]
    couplings: dict[str, Mimic] = {first: (second, slope, offset)}
    if slope:
        couplings[second] = (first, 1 / slope, -offset / slope)
    return couplings


def find_fluid(scene: NamedModel) -> Iterator[MjcfOnlyEffect]:
    """Yield the fluid around the robot, if the MJCF states its density or viscosity.

    Args:
        scene: Compiled MJCF, with the names of its elements.
    """
    option = scene.model.opt
    if option.density or option.viscosity:
        value: Numbers = {"density": option.density, "viscosity": option.viscosity}
        wind: Numbers = {"wind": option.wind.tolist()}
        effect = _make_effect("fluid", ("fluid", "option"), "opt", 0, value, wind)
        slots: tuple[Slot, ...] = (("opt.density", 0), ("opt.viscosity", 0))
        yield replace(effect, slots=slots)


def find_equalities(scene: NamedModel) -> Iterator[MjcfOnlyEffect]:
    """Yield the initially active equality constraints on the robot, unless a flag disables them.

    Args:
        scene: Compiled MJCF, with the names of its elements.
    """
    model = scene.model
    if scene.is_disabled(DISABLE.mjDSBL_CONSTRAINT) or scene.is_disabled(DISABLE.mjDSBL_EQUALITY):
        return
    for index in range(model.neq):
        if not model.eq_active0[index]:
            continue
        objects = equality_ends(model, index)
        if not any(scene.is_part_of_robot(*end) for end in objects):
            continue  # constraint between other objects of the scene
        name = equality_name(scene.names, index)
        kind = EQUALITY(int(model.eq_type[index])).name.removeprefix("mjEQ_").lower()
        subject, data = ("equality", name), [float(value) for value in model.eq_data[index]]
        message = diagnose("of-the-mjcf-alone", subject=subject, stated=Term(kind))
        slot = ("eq_active0", index)
        yield MjcfOnlyEffect("equality", name, None, data, "", message, (slot,))


def find_flags(scene: NamedModel) -> Iterator[MjcfOnlyEffect]:
    """Yield the flags that disable limits, dry friction, all constraints, or actuation.

    Args:
        scene: Compiled MJCF, with the names of its elements.
    """
    for word in ("limit", "frictionloss", "constraint", "actuation"):
        if scene.is_disabled(getattr(DISABLE, f"mjDSBL_{word.upper()}")):
            message = diagnose("of-the-mjcf-alone", subject=("flag", word), stated="disable")
            yield MjcfOnlyEffect("flag", word, None, "disable", "", message)


def mjcf_only_effects(reference: Reference) -> list[MjcfOnlyEffect]:
    """List the elements of an MJCF that act on the robot, and that a URDF cannot specify.

    Examples are springs, tendons, a fluid and closed loops.

    Args:
        reference: Compiled MJCF, and element names.
    """
    scene = NamedModel(reference)
    return [
        *of_joints(scene),
        *of_bodies(scene),
        *of_tendons(scene),
        *of_actuators(scene),
        *find_fluid(scene),
        *find_equalities(scene),
        *find_flags(scene),
    ]
