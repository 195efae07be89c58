"""What acts through tendons and motors: springs, damping, inertia."""

from __future__ import annotations

from collections.abc import Iterator

import mujoco
import numpy as np

from pupper_analysis.base.diagnostics import (
    Diagnostic,
    Quantity,
    Term,
    Vector,
    diagnose,
)
from pupper_analysis.models.transmission import actuator_gear, is_at_one_joint
from pupper_analysis.robot.compare.mjcf_only.effect import (
    DISABLE,
    MjcfOnlyEffect,
    NamedModel,
    Slot,
    acts_without_command,
)


def find_tendons(scene: NamedModel) -> Iterator[MjcfOnlyEffect]:
    """Yields the tendons that pull at the robot, as far as they act without command."""
    model = scene.model
    for tendon in range(model.ntendon):
        if not wrapped_bodies(scene, tendon) & scene.bodies:
            continue
        force, length = _tendon_units(scene, tendon)
        value, terms, acts = _tendon_terms(scene, tendon, force, length)
        if not value:
            continue
        name = scene.name("tendon", tendon)
        arrays = ("stiffness", "stiffnesspoly", "damping", "dampingpoly", "armature")
        slots = tuple((f"tendon_{array}", tendon) for array in arrays) if acts else ()
        told = diagnose("tendon-of-the-mjcf-alone", subject=("tendon", name), terms=terms)
        yield MjcfOnlyEffect("tendon", name, value, "", told, slots)


def _tendon_terms(
    scene: NamedModel, tendon: int, force: str, length: str
) -> tuple[dict[str, object], list[Diagnostic], bool]:
    """A tendon's numbers, told too, and whether it acts without limits and friction."""
    model = scene.model
    value: dict[str, object] = {}
    terms = []
    inertia = "kg" if length == "m" else "kg m^2"
    for kind, unit, switch in (
        ("stiffness", f"{force}/{length}", DISABLE.mjDSBL_SPRING),
        ("damping", f"{force} s/{length}", DISABLE.mjDSBL_DAMPER),
        ("armature", inertia, None),
        ("frictionloss", force, None),
    ):
        linear = float(getattr(model, f"tendon_{kind}")[tendon])
        powers = getattr(model, f"tendon_{kind}poly", np.zeros((model.ntendon, 1)))[tendon]
        if not (linear or powers.any()) or (switch is not None and scene.off(switch)):
            continue
        value[kind] = linear if not powers.any() else [linear, *map(float, powers)]
        rest = None
        if kind == "stiffness":
            value["rest"] = [float(each) for each in model.tendon_lengthspring[tendon]]
            rest = Vector(tuple(model.tendon_lengthspring[tendon]), length)
        terms.append(
            diagnose(
                "tendon-term",
                what=Term(kind),
                value=Quantity(linear, unit),
                higher=Vector(tuple(powers), "1") if powers.any() else None,
                rest=rest,
            )
        )
    acts = bool(value.keys() & {"stiffness", "damping", "armature"})
    if model.tendon_limited[tendon]:
        value["range"] = [float(each) for each in model.tendon_range[tendon]]
        kept = Vector(tuple(model.tendon_range[tendon]), length)
        terms.append(diagnose("tendon-range", range=kept))
    return value, terms, acts


def wrapped_bodies(scene: NamedModel, tendon: int) -> set[int]:
    """The bodies that a tendon pulls at."""
    model = scene.model
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


def _tendon_units(scene: NamedModel, tendon: int) -> tuple[str, str]:
    """The units of a tendon's force and length; a fixed one adds up its joints' coordinates."""
    model, first = scene.model, int(scene.model.tendon_adr[tendon])
    if model.wrap_type[first] != mujoco.mjtWrap.mjWRAP_JOINT.value:
        return "N", "m"
    joints = model.wrap_objid[first : first + int(model.tendon_num[tendon])]
    units = {scene.unit(int(joint)) for joint in joints}
    return units.pop() if len(units) == 1 else ("", "unit of its length")


def find_actuators(scene: NamedModel) -> Iterator[MjcfOnlyEffect]:
    """Inertia and damping of motors; at one joint, the linear ones count as the joint's."""
    model = scene.model
    for motor in range(model.nactuator):
        if not _drives(scene, motor) & scene.bodies:
            continue
        at_joint = is_at_one_joint(model, motor)
        armature = 0.0 if at_joint else float(model.actuator_armature[motor])
        damping = 0.0 if at_joint else float(model.actuator_damping[motor])
        higher = model.actuator_dampingpoly[motor]
        if scene.off(DISABLE.mjDSBL_DAMPER):
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
        name = scene.name("actuator", motor)
        if acts_without_command(model, motor) and not scene.off(DISABLE.mjDSBL_ACTUATION):
            told = diagnose("dc-motor-of-the-mjcf-alone", subject=("actuator", name))
            group = ("actuator_group", motor)  # 0 is off in `as_it_is`
            yield MjcfOnlyEffect("actuator", name, "DC motor", "", told, (group,))
        if value:
            told = diagnose(
                "actuator-terms-of-the-mjcf-alone",
                subject=("actuator", name),
                armature=value.get("armature"),
                damping=value.get("damping"),
                higher=Vector(tuple(higher), "1") if higher.any() else None,
                gear=Vector(tuple(actuator_gear(model, motor)), "1"),
            )
            yield MjcfOnlyEffect("actuator", name, value, "", told, tuple(slots))


def _drives(scene: NamedModel, motor: int) -> set[int]:
    """The bodies that a motor acts on."""
    model = scene.model
    kind, (target, other) = int(model.actuator_trntype[motor]), model.actuator_trnid[motor]
    transmission = mujoco.mjtTrn
    if kind in (transmission.mjTRN_JOINT.value, transmission.mjTRN_JOINTINPARENT.value):
        return {int(model.jnt_bodyid[target])}
    if kind == transmission.mjTRN_TENDON.value:
        return wrapped_bodies(scene, int(target))
    if kind == transmission.mjTRN_BODY.value:
        return {int(target)}
    sites = [int(site) for site in (target, other) if 0 <= site < model.nsite]
    return {int(model.site_bodyid[site]) for site in sites}
