"""What acts on a robot in MuJoCo and has no words in a URDF: springs, tendons, fluid, loops.

A URDF states a tree of bodies, and damping and friction of its joints. MuJoCo's smooth dynamics
have more terms: passive forces (``qfrc_spring``, ``qfrc_damper``, ``qfrc_gravcomp``,
``qfrc_fluid``), inertia through tendons and motors, and equality constraints. Here they are found
in a compiled model, one by one, each with the numbers that have to be zero for it to be gone.
Nothing rests on the list being complete: who uses it switches all of it off, and compares what is
left (flexes, plugins) with a model that has none of it.

Source: MuJoCo documentation, "Computation: Passive forces" and "Constraint model: Equality"; the
arrays are those of ``mjModel``.
"""

from __future__ import annotations

import copy
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from pupper_analysis.base.diagnostics import Quantity, Term, Vector, diagnose
from pupper_analysis.models.mjcf import JointKind, equality_ends, equality_name
from pupper_analysis.models.transmission import actuator_gear, is_at_one_joint, motor_targets
from pupper_analysis.robot.compare.differences import Stated
from pupper_analysis.robot.matching.trees import Mimics, Reference

Slot = tuple[str, int | slice]
"""An array of ``mjModel`` (or a number of its ``opt``), and which of its rows."""


@dataclass(frozen=True, eq=False)
class MjcfOnlyEffect(Stated):
    """An element of an MJCF that a URDF cannot state; its first attributes are `Stated`'s.

    Attributes:
        slots: What has to be zero for it to be gone; none if it does not act on the unconstrained
            robot, or cannot be taken away.
    """

    slots: tuple[Slot, ...] = ()

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
    for bit in (DISABLE.mjDSBL_CONTACT, DISABLE.mjDSBL_LIMIT, DISABLE.mjDSBL_FRICTIONLOSS):
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


def without_effects(model: mujoco.MjModel, effects: Iterable[MjcfOnlyEffect]) -> mujoco.MjModel:
    """Returns ``as_it_is(model)`` with some effects taken away."""
    result = as_it_is(model)
    for effect in effects:
        effect.switch(result, None)
    return result


DISABLE = mujoco.mjtDisableBit

Numbers = dict[str, float | list[float]]

_SWITCHED = {
    "stiffness": (DISABLE.mjDSBL_SPRING,),
    "stiffnesspoly": (DISABLE.mjDSBL_SPRING,),
    "damping": (DISABLE.mjDSBL_DAMPER,),
    "dampingpoly": (DISABLE.mjDSBL_DAMPER,),
    "frictionloss": (DISABLE.mjDSBL_FRICTIONLOSS,),
}
"""{attribute: the flags that switch it off}."""


class NamedModel:
    """One reference, and what asking it takes: its names, numbers and switches."""

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

    def off(self, bit: mujoco.mjtDisableBit) -> bool:
        """Says whether the file switches a term of the dynamics off."""
        return bool(self.model.opt.disableflags & bit.value)

    def holds(self, what: mujoco.mjtObj, index: int) -> bool:
        """Says whether an element is on what moves with the robot; none (-1) is not."""
        return index >= 0 and not self._trees.isdisjoint(np.ravel(self._trees_of[what][index]))

    def name(self, kind: str, index: int) -> str:
        """An element's name, or its number: ``#3``."""
        what = getattr(mujoco.mjtObj, f"mjOBJ_{kind.upper()}").value
        return mujoco.mj_id2name(self.names, what, index) or f"#{index}"

    def joint_name(self, joint: int) -> str:
        """A joint's name; the base's for its free joint."""
        if self.model.jnt_type[joint] == JointKind.FREE:
            return self.reference.base
        return self.name("joint", joint)

    def numbers(self, prefix: str, index: int | slice, words: Sequence[str]) -> Numbers:
        """The numbers of an element that are not zero, {attribute: one, or several}.

        Those that a flag switches off count as zero.
        """
        found: Numbers = {}
        for word in words:
            values = np.ravel(getattr(self.model, f"{prefix}_{word}")[index])
            if values.any() and not any(self.off(bit) for bit in _SWITCHED.get(word, ())):
                found[word] = float(values[0]) if len(values) == 1 else values.tolist()
        return found


def _effect(
    kind: str,
    subject: tuple[str, str],
    prefix: str,
    index: int | slice,
    numbers: Numbers,
    beside: Numbers | None = None,
) -> MjcfOnlyEffect:
    """Returns an effect of an element's numbers, all of which act, and others that stand beside."""
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
    given = value if len(value) > 1 else next(iter(value.values()))
    return MjcfOnlyEffect(kind, subject[1], None, given, "", message, slots)


def of_joints(scene: NamedModel) -> Iterator[MjcfOnlyEffect]:
    """Yields springs, damping in higher powers of the speed, and dry friction of the free joint."""
    model = scene.model
    for joint in scene.reference.joints():
        subject, free = ("joint", scene.joint_name(joint)), model.jnt_type[joint] == JointKind.FREE
        first = int(model.jnt_dofadr[joint])
        spring = scene.numbers("jnt", joint, ("stiffness", "stiffnesspoly"))
        if spring:
            beside = scene.numbers("jnt", joint, ("springyield",))
            if not free:
                beside["springref"] = float(model.qpos_spring[model.jnt_qposadr[joint]])
            yield _effect("spring", subject, "jnt", joint, spring, beside)
        if damping := scene.numbers("dof", first, ("dampingpoly",)):
            dofs = slice(first, first + (6 if free else 1))
            yield _effect("damping polynomial", subject, "dof", dofs, damping)
        if free and (friction := scene.numbers("dof", first, ("frictionloss",))):
            yield _effect("dry friction", subject, "dof", first, friction)


def of_bodies(scene: NamedModel) -> Iterator[MjcfOnlyEffect]:
    """Yields the bodies whose weight is (partly) carried by nothing."""
    model = scene.model
    for body in sorted(scene.bodies):
        lifted = scene.numbers("body", body, ("gravcomp",))
        if lifted and model.body_mass[body] and model.body_weldid[body]:
            subject = "body", scene.name("body", body)
            yield _effect("gravity compensation", subject, "body", body, lifted)


def of_tendons(scene: NamedModel) -> Iterator[MjcfOnlyEffect]:
    """Yields the tendons that pull at the robot, as far as they act without command."""
    model = scene.model
    words = ("stiffness", "stiffnesspoly", "damping", "dampingpoly", "armature", "frictionloss")
    for tendon in range(model.ntendon):
        if not scene.holds(mujoco.mjtObj.mjOBJ_TENDON, tendon):
            continue
        found, beside = scene.numbers("tendon", tendon, words), dict[str, float | list[float]]()
        if found.keys() & {"stiffness", "stiffnesspoly"}:
            beside["springlength"] = model.tendon_lengthspring[tendon].tolist()
        if model.tendon_limited[tendon]:
            beside["range"] = model.tendon_range[tendon].tolist()
        if found or beside:
            subject = "tendon", scene.name("tendon", tendon)
            yield _effect("tendon", subject, "tendon", tendon, found, beside)


def of_actuators(scene: NamedModel) -> Iterator[MjcfOnlyEffect]:
    """Inertia and damping of motors; at one joint, the linear ones count as the joint's."""
    model = scene.model
    for motor in range(model.nactuator):
        what, targets = motor_targets(model, motor)
        if not any(scene.holds(what, target) for target in targets):
            continue
        subject = "actuator", scene.name("actuator", motor)
        linear = () if is_at_one_joint(model, motor) else ("armature", "damping")
        found = scene.numbers("actuator", motor, (*linear, "dampingpoly"))
        if acts_without_command(model, motor) and not scene.off(DISABLE.mjDSBL_ACTUATION):
            message = diagnose("dc-motor-of-the-mjcf-alone", subject=subject)
            group = ("actuator_group", motor)  # 0 is off in `as_it_is`
            yield MjcfOnlyEffect("actuator", subject[1], None, "DC motor", "", message, (group,))
        if found:
            gear: Numbers = {"gear": list(map(float, actuator_gear(model, motor)))}
            yield _effect("actuator", subject, "actuator", motor, found, gear)


EQUALITY = mujoco.mjtEq


def split_mimics(
    found: Sequence[MjcfOnlyEffect], reference: Reference, mimics: Mimics, tolerance: float
) -> tuple[list[MjcfOnlyEffect], list[str]]:
    """Tells which joint equalities say the same as a URDF's ``<mimic>``, and are no effects.

    Both state q = m q_other + c. MuJoCo's polynomial is of the coordinates less their ``qpos0``:
    q - q0 = a0 + a1 (q_other - q0_other), so that m = a1 and c = a0 + q0 - a1 q0_other.

    Args:
        found: The effects of the reference.
        reference: The MJCF.
        mimics: The URDF's, by the reference's names.
        tolerance: How far offsets (rad or m), and multipliers relative to 1, may differ.

    Returns:
        The effects that are the URDF's, too; and the joints whose mimic no equality states.
    """
    model = reference.model
    same: list[MjcfOnlyEffect] = []
    left = dict(mimics)
    for effect in found:
        if effect.kind != "equality":
            continue
        index = int(effect.slots[0][1])  # type: ignore[arg-type]
        data, ids = model.eq_data[index], (model.eq_obj1id[index], model.eq_obj2id[index])
        if model.eq_type[index] != EQUALITY.mjEQ_JOINT.value or min(ids) < 0 or data[2:5].any():
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
                same.append(effect)
                del left[joint]
                break
    return same, list(left)


def find_fluid(scene: NamedModel) -> Iterator[MjcfOnlyEffect]:
    """Yields the medium, if it has density or viscosity."""
    option = scene.model.opt
    if option.density or option.viscosity:
        value: Numbers = {"density": option.density, "viscosity": option.viscosity}
        wind: Numbers = {"wind": option.wind.tolist()}
        effect = _effect("fluid", ("fluid", "option"), "opt", 0, value, wind)
        slots: tuple[Slot, ...] = (("opt.density", 0), ("opt.viscosity", 0))
        yield replace(effect, slots=slots)


def find_equalities(scene: NamedModel) -> Iterator[MjcfOnlyEffect]:
    """Yields the equality constraints that are on at the start and hold the robot."""
    model = scene.model
    if scene.off(DISABLE.mjDSBL_CONSTRAINT) or scene.off(DISABLE.mjDSBL_EQUALITY):
        return
    for index in range(model.neq):
        if not model.eq_active0[index]:
            continue
        ends = equality_ends(model, index)
        if not any(scene.holds(*end) for end in ends):
            continue  # of other objects of the scene
        name = equality_name(scene.names, index)
        kind = EQUALITY(int(model.eq_type[index])).name.removeprefix("mjEQ_").lower()
        subject, data = ("equality", name), [float(each) for each in model.eq_data[index]]
        message = diagnose("of-the-mjcf-alone", subject=subject, stated=Term(kind))
        slot = ("eq_active0", index)
        yield MjcfOnlyEffect("equality", name, None, data, "", message, (slot,))


def find_flags(scene: NamedModel) -> Iterator[MjcfOnlyEffect]:
    """What the file states and switches off again; springs and damping are 0 then."""
    for word in ("limit", "frictionloss", "constraint", "actuation"):
        if scene.off(getattr(DISABLE, f"mjDSBL_{word.upper()}")):
            message = diagnose("of-the-mjcf-alone", subject=("flag", word), stated="disable")
            yield MjcfOnlyEffect("flag", word, None, "disable", "", message)


def mjcf_only_effects(reference: Reference) -> list[MjcfOnlyEffect]:
    """Finds all that acts on the robot and that a URDF cannot state."""
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
