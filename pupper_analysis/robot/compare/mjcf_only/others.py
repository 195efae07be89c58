"""What else acts: fluid, equality constraints, flexes, plugins; and what flags switch off."""

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
from pupper_analysis.robot.compare.mjcf_only.effect import (
    DISABLE,
    MjcfOnlyEffect,
    NamedModel,
    Slot,
)
from pupper_analysis.robot.compare.mjcf_only.mimics import EQUALITY
from pupper_analysis.robot.compare.mjcf_only.transmissions import wrapped_bodies


def find_fluid(scene: NamedModel) -> Iterator[MjcfOnlyEffect]:
    """Yields the medium, if it has density or viscosity."""
    option = scene.model.opt
    if option.density or option.viscosity:
        wind = [float(each) for each in option.wind]
        value = {"density": option.density, "viscosity": option.viscosity, "wind": wind}
        told = diagnose(
            "fluid-of-the-mjcf-alone",
            density=Quantity(option.density, "kg/m^3"),
            viscosity=Quantity(option.viscosity, "Pa s"),
            wind=Vector(tuple(wind), "m/s"),
        )
        slots: tuple[Slot, ...] = (("opt.density", 0), ("opt.viscosity", 0))
        yield MjcfOnlyEffect("fluid", "option", value, "", told, slots)


def find_equalities(scene: NamedModel) -> Iterator[MjcfOnlyEffect]:
    """Yields the equality constraints that are on at the start and hold the robot."""
    model = scene.model
    if scene.off(DISABLE.mjDSBL_CONSTRAINT) or scene.off(DISABLE.mjDSBL_EQUALITY):
        return
    for index in range(model.neq):
        if not model.eq_active0[index]:
            continue
        ends = _ends(scene, index)
        bodies = [_end_bodies(scene, what, target) for what, target in ends]
        if not any(end is None or end & scene.bodies for end in bodies):
            continue  # of other objects of the scene
        name = scene.name("equality", index)
        kind = EQUALITY(int(model.eq_type[index])).name.removeprefix("mjEQ_").lower()
        one, two = (_end_name(scene, *end) for end in ends)
        subject = ("equality", name)
        yield MjcfOnlyEffect(
            "equality",
            name,
            [float(each) for each in model.eq_data[index]],
            "",
            diagnose(
                "equality-of-the-mjcf-alone", subject=subject, kind=Term(kind), one=one, two=two
            ),
            (("eq_active0", index),),
        )


def _ends(scene: NamedModel, index: int) -> list[tuple[mujoco.mjtObj, int]]:
    """The kinds and ids of the two objects of an equality; -1 where it has one only."""
    model = scene.model
    what = _EQUALITY_OBJECTS.get(int(model.eq_type[index])) or mujoco.mjtObj(
        int(model.eq_objtype[index])
    )
    return [(what, int(model.eq_obj1id[index])), (what, int(model.eq_obj2id[index]))]


def _end_bodies(scene: NamedModel, what: mujoco.mjtObj, target: int) -> set[int] | None:
    """The bodies that an equality holds at one end; None where it is not known."""
    model, kinds = scene.model, mujoco.mjtObj
    if target < 0:
        return set()
    if what == kinds.mjOBJ_TENDON:
        return wrapped_bodies(scene, target)
    if what == kinds.mjOBJ_FLEX:
        return flex_bodies(model, target)
    carrier = {
        kinds.mjOBJ_BODY: np.arange(model.nbody),
        kinds.mjOBJ_JOINT: model.jnt_bodyid,
        kinds.mjOBJ_SITE: model.site_bodyid,
        kinds.mjOBJ_GEOM: model.geom_bodyid,
    }.get(what)
    return None if carrier is None else {int(carrier[target])}


def _end_name(scene: NamedModel, what: mujoco.mjtObj, target: int) -> Diagnostic | Term:
    """An end's kind and name."""
    if target < 0:
        return Term("a constant")
    name = mujoco.mj_id2name(scene.names, what.value, target) or f"#{target}"
    return diagnose("element", subject=(what.name.removeprefix("mjOBJ_").lower(), name))


def flex_bodies(model: mujoco.MjModel, flex: int) -> set[int]:
    """Returns the bodies that carry a flex."""
    found = set[int]()
    for kind in ("vert", "node"):
        first = int(getattr(model, f"flex_{kind}adr")[flex])
        count = int(getattr(model, f"flex_{kind}num")[flex])
        found |= set(map(int, getattr(model, f"flex_{kind}bodyid")[first : first + count]))
    return found


def find_flexes(scene: NamedModel) -> Iterator[MjcfOnlyEffect]:
    """Yields the deformable bodies, as one, if they are fixed to the robot."""
    model = scene.model
    if not model.nflex:
        return
    touched = {int(body) for body in (*model.flex_vertbodyid, *model.flex_nodebodyid)}
    everything = slice(None)
    arrays = ("stiffness", "bending", "damping", "edgestiffness", "edgedamping")
    filled = [f"flex_{array}" for array in arrays if getattr(model, f"flex_{array}").any()]
    if touched & scene.bodies:
        name = scene.name("flex", 0)
        told = diagnose("flex-of-the-mjcf-alone", subject=("flex", name))
        slots = tuple((array, everything) for array in filled)
        yield MjcfOnlyEffect("flex", name, model.nflex, "", told, slots)


def find_plugins(scene: NamedModel) -> Iterator[MjcfOnlyEffect]:
    """Plugins of bodies; they cannot be switched off in a compiled model."""
    for body in sorted(scene.bodies):
        if scene.model.body_plugin[body] >= 0:
            name = scene.name("body", body)
            told = diagnose("plugin-of-the-mjcf-alone", subject=("body", name))
            yield MjcfOnlyEffect("plugin", name, int(scene.model.body_plugin[body]), "", told)


def find_flags(scene: NamedModel) -> Iterator[MjcfOnlyEffect]:
    """What the file states and switches off again; springs and damping are 0 then."""
    for bit, word, what in _FLAGS:
        if scene.off(bit):
            told = diagnose("flag-of-the-mjcf-alone", subject=("flag", word), what=Term(what))
            yield MjcfOnlyEffect("flag", word, "disable", "", told)


# MuJoCo's eq_objtype is for constraints that take bodies or sites.
_EQUALITY_OBJECTS = {
    EQUALITY.mjEQ_JOINT.value: mujoco.mjtObj.mjOBJ_JOINT,
    EQUALITY.mjEQ_TENDON.value: mujoco.mjtObj.mjOBJ_TENDON,
    EQUALITY.mjEQ_FLEX.value: mujoco.mjtObj.mjOBJ_FLEX,
    EQUALITY.mjEQ_FLEXVERT.value: mujoco.mjtObj.mjOBJ_FLEX,
    EQUALITY.mjEQ_FLEXSTRAIN.value: mujoco.mjtObj.mjOBJ_FLEX,
}

_FLAGS = (
    (DISABLE.mjDSBL_LIMIT, "limit", "no joint limit acts"),
    (DISABLE.mjDSBL_FRICTIONLOSS, "frictionloss", "no dry friction acts"),
    (DISABLE.mjDSBL_CONSTRAINT, "constraint", "no limit, dry friction or contact acts"),
    (DISABLE.mjDSBL_ACTUATION, "actuation", "no motor acts"),
)
