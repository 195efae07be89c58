"""What in an MJCF may make it do other than predicted, each to be switched off in a copy."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.models.additions import Ball
from pupper_analysis.models.mjcf_file import MjcfFile
from pupper_analysis.models.transmission import Drive, actuator_gear, drives_of
from pupper_analysis.prepare.bare import (
    FILTERS,
    SETTLES,
    Bare,
    loose_joints,
    other_motors,
)
from pupper_analysis.robot.as_published import Cause
from pupper_analysis.robot.robot import Robot
from pupper_analysis.statics.equilibrium import GravityCompensation

Array = NDArray[np.float64]

_OBJ = mujoco.mjtObj

_FINE = 2e-3
"""A step of the simulation (s) at which servos and contacts are what they are in time."""

_ITERATIONS, _TOLERANCE = 100, 1e-10
"""Of an exact solver of contacts: Newton's converges in ten."""

_LOCKED = 1e6
"""Damping of a joint that is held (N m s/rad, N s/m): under a newton it goes a micrometre."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """Something in an MJCF that may make it differ.

    Attributes:
        code: What it is.
        elements: Its name, or the names of all that are alike.
        switch_off: Takes it away from a copy of the model, in place.
    """

    code: str
    elements: tuple[str, ...]
    switch_off: Callable[[mujoco.MjModel], None]

    def cause(self, remaining: float) -> Cause:
        """Returns it as what makes the file differ, with what is left without it."""
        return Cause(self.code, self.elements, None, remaining)


_SECTIONS = {
    "weld": "equality",
    "connect": "equality",
    "ctrlrange": "actuator",
    "forcerange": "actuator",
    "timeconst": "actuator",
    "bias": "actuator",
    "gain": "actuator",
    "gaintype": "actuator",
    "gear": "actuator",
    "delay": "actuator",
    "motors-elsewhere": "actuator",
    "actuatorfrcrange": "joint",
    "loose-joints": "joint",
    "spring": "joint",
    "damping": "joint",
    "range": "joint",
}


_OPTIONS = {
    "override": ("flag", {"override"}),
    "actuatorgroupdisable": ("option", {"actuatorgroupdisable"}),
    "solver": ("option", {"jacobian"}),
    "timestep": ("option", {"timestep"}),
    "iterations": ("option", {"solver", "iterations", "tolerance"}),
    "gravity": ("option", {"gravity"}),
    "fluid": ("option", {"density", "viscosity", "wind"}),
}
"""The elements of options, and their attributes."""


def with_line(cause: Cause, mjcf: MjcfFile) -> Cause:
    """Returns a cause with the line where its first element stands, where that is known."""
    if cause.code in ("slippery", "soft"):
        cause = replace(cause, elements=_as_stated(cause, mjcf))
    name = cause.elements[0] if cause.elements else ""
    line = None
    if cause.code in _SECTIONS:
        line = mjcf.place(_SECTIONS[cause.code], name).line
    elif cause.code == "exclude" or " and " in name:
        tag = "exclude" if cause.code == "exclude" else "pair"
        ends = set(name.split(" and "))
        line = next(
            (place.line for words, place in mjcf.elements(tag) if ends <= set(words.values())), None
        )
    elif cause.code in _OPTIONS:
        tag, stated = _OPTIONS[cause.code]
        places = (place.line for words, place in mjcf.elements(tag) if stated & words.keys())
        line = next(places, None)
    return replace(cause, line=line)


def _as_stated(cause: Cause, mjcf: MjcfFile) -> tuple[str, ...]:
    """Returns the names of contacts: of a pair where that states what a geom was given of it."""
    model = mjcf.model
    pairs = _pair_names(model, np.flatnonzero(_are_bad(model, "pair", cause.code)))
    found = (
        next((pair for pair in pairs if name in pair.split(" and ")), name)
        for name in cause.elements
    )
    return tuple(dict.fromkeys(found))


def candidate_causes(bare: Bare, robot: Robot) -> list[Candidate]:
    """Returns what in an MJCF may make it differ from what is computed of its robot."""
    model = bare.model
    return [
        *_numerics(model),
        *_excludes(model),
        *_options(model),
        *_equalities(model),
        *_limits(bare, robot),
        *_servos(bare, robot),
        *_motors(bare),
        *_pairs(model),
        *_passive(bare, robot),
        *_shapes(bare, robot),
    ]


def physical_causes(bare: Bare, robot: Robot) -> list[Candidate]:
    """Returns what in an MJCF, though its robot is computed with it, may be what makes it fail."""
    return [*_signs(bare, robot), *_forces(bare, robot), *_contacts(bare)]


def shaking_causes(bare: Bare, robot: Robot) -> list[Candidate]:
    """Returns what of these changes how a stand is simulated, and not which stand it is."""
    model = bare.model
    return [*_numerics(model), *_pairs(model), *_signs(bare, robot), *_contacts(bare)]


def _name(model: mujoco.MjModel, kind: mujoco.mjtObj, number: int) -> str:
    return mujoco.mj_id2name(model, kind, number) or f"#{number}"


def _names(model: mujoco.MjModel, kind: mujoco.mjtObj, numbers: Iterable[int]) -> tuple[str, ...]:
    return tuple(_name(model, kind, int(number)) for number in numbers)


def _motor_names(model: mujoco.MjModel, motors: list[int]) -> tuple[str, ...]:
    """Returns actuators' names, or else their joints'."""
    named = {m: mujoco.mj_id2name(model, _OBJ.mjOBJ_ACTUATOR, m) for m in motors}
    return tuple(
        name or _name(model, _OBJ.mjOBJ_JOINT, int(model.actuator_trnid[m, 0]))
        for m, name in named.items()
    )


LIMITS = ("forcerange", "actuatorfrcrange")
"""The codes of what limits forces."""

NUMERICS = ("timestep", "iterations")
"""The codes of how MuJoCo integrates and solves."""

COMMANDS = ("bias", "gain", "gaintype", "gear")
"""The codes of what makes another target of a command."""


def _numerics(model: mujoco.MjModel) -> Iterator[Candidate]:
    """How MuJoCo integrates, and how exactly it solves for constraint forces."""

    def finer(other: mujoco.MjModel) -> None:
        other.opt.timestep = min(model.opt.timestep / 2, _FINE)
        other.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST.value

    integrator = mujoco.mjtIntegrator(int(model.opt.integrator)).name.removeprefix("mjINT_")
    if not model.actuator_delay.any():  # else its samples would last for less
        yield Candidate("timestep", (f"{model.opt.timestep:g} s ({integrator})",), finer)
    newton = mujoco.mjtSolver.mjSOL_NEWTON.value
    rough = model.opt.iterations < _ITERATIONS or model.opt.tolerance > _TOLERANCE
    if rough or model.opt.solver != newton:

        def exact(other: mujoco.MjModel) -> None:
            other.opt.solver = newton
            other.opt.iterations = max(model.opt.iterations, _ITERATIONS)
            other.opt.tolerance = min(model.opt.tolerance, _TOLERANCE)

        kind = mujoco.mjtSolver(int(model.opt.solver)).name.removeprefix("mjSOL_")
        yield Candidate("iterations", (f"{kind}, {model.opt.iterations} iterations",), exact)


def _set(fields: str, where: Any, value: Any = 0) -> Callable[[mujoco.MjModel], None]:
    """Returns what gives elements of a model's arrays another value: by default none."""

    def switch_off(other: mujoco.MjModel) -> None:
        for field in fields.split():
            attrgetter(field)(other)[where] = value

    return switch_off


def _servos(bare: Bare, robot: Robot) -> Iterator[Candidate]:
    """Forces beside the law of position servos: biases, gains that are no stiffness, delays."""
    model = bare.model
    motors = [m for name in robot.joint_names for m in drives_of(model, model.joint(name).id)]
    affine = mujoco.mjtBias.mjBIAS_AFFINE.value
    biased = [
        m
        for m in motors
        if model.actuator_biastype[m] == affine and model.actuator_biasprm[m, 0] != 0
    ]
    if biased:
        yield Candidate("bias", _motor_names(model, biased), _set("actuator_biasprm", (biased, 0)))
    uneven = [
        m
        for m in motors
        if model.actuator_biastype[m] == affine
        and 0 < -model.actuator_biasprm[m, 1] != model.actuator_gainprm[m, 0] > 0
    ]
    if uneven:
        even = _set("actuator_gainprm", (uneven, 0), -model.actuator_biasprm[uneven, 1])
        yield Candidate("gain", _motor_names(model, uneven), even)
    fixed = mujoco.mjtGain.mjGAIN_FIXED.value
    varying = [
        m
        for m in motors
        if model.actuator_biastype[m] == affine and model.actuator_gaintype[m] != fixed
    ]
    if varying:
        steady = _set("actuator_gaintype", varying, fixed)
        yield Candidate("gaintype", _motor_names(model, varying), steady)
    late = [m for m in motors if model.actuator_delay[model.actuator_ctrladr[m]] > 0]
    if late:
        prompt = _set("actuator_delay", model.actuator_ctrladr[late])
        yield Candidate("delay", _motor_names(model, late), prompt)


def _signs(bare: Bare, robot: Robot) -> Iterator[Candidate]:
    """Signs that are seldom meant: of an actuator's gear, of a joint's damping."""
    model = bare.model
    joints = [model.joint(name).id for name in robot.joint_names]
    turned = [
        m for joint in joints for m in drives_of(model, joint) if actuator_gear(model, m)[0] < 0
    ]
    if turned:
        outputs = model.actuator_outadr[turned]
        straight = _set("actuator_gear", (outputs, 0), -model.actuator_gear[outputs, 0])
        yield Candidate("gear", _motor_names(model, turned), straight)
    driving = [joint for joint in joints if model.dof_damping[model.jnt_dofadr[joint]] < 0]
    if driving:
        undamped = _set("dof_damping", model.jnt_dofadr[driving])
        yield Candidate("damping", _names(model, _OBJ.mjOBJ_JOINT, driving), undamped)


def _forces(bare: Bare, robot: Robot) -> Iterator[Candidate]:
    """Forces beside gravity and motors: springs, joints' limits, fluids; and gravity aside."""
    model = bare.model
    sprung = {
        kind: (stiff != 0) | higher.any(axis=1)
        for kind, stiff, higher in (
            (_OBJ.mjOBJ_JOINT, model.jnt_stiffness, model.jnt_stiffnesspoly),
            (_OBJ.mjOBJ_TENDON, model.tendon_stiffness, model.tendon_stiffnesspoly),
        )
    }
    listed = sum((_names(model, kind, np.flatnonzero(of)) for kind, of in sprung.items()), ())
    if listed:
        linear, higher = "jnt_stiffness tendon_stiffness", "jnt_stiffnesspoly tendon_stiffnesspoly"
        yield Candidate("spring", listed, _set(f"{linear} {higher}", slice(None)))
    joints = [model.joint(name).id for name in robot.joint_names]
    limited = [joint for joint in joints if model.jnt_limited[joint]]
    if limited:
        listed = _names(model, _OBJ.mjOBJ_JOINT, limited)
        yield Candidate("range", listed, _set("jnt_limited", limited))
    if model.opt.density or model.opt.viscosity:

        def empty(other: mujoco.MjModel) -> None:
            other.opt.density = other.opt.viscosity = 0.0

        parts = [f"density {model.opt.density:g} kg/m^3", f"viscosity {model.opt.viscosity:g} Pa s"]
        if model.opt.wind.any():
            parts.append(f"wind ({', '.join(f'{speed:g}' for speed in model.opt.wind)}) m/s")
        yield Candidate("fluid", tuple(parts), empty)
    if model.opt.gravity[:2].any():
        down = 0.0, 0.0, -np.linalg.norm(model.opt.gravity)
        upright = _set("opt.gravity", slice(None), down)
        stated = ", ".join(f"{part:g}" for part in model.opt.gravity)
        yield Candidate("gravity", (f"({stated}) m/s^2",), upright)


def overloading_springs(
    robot: Robot, qpos: Array, statics: GravityCompensation
) -> tuple[Cause, ...]:
    """Returns the springs without which motors that are beyond their limits would be within.

    Args:
        robot: The robot.
        qpos: (nq,) where it is.
        statics: What its motors hold there, springs and all.
    """
    model, data = robot.mj_model, mujoco.MjData(robot.mj_model)
    robot.mj_convention.set_state(data, qpos)
    mujoco.mj_fwdPosition(model, data)
    mujoco.mj_passive(model, data)
    pulled = data.qfrc_spring[robot.mj_convention.qvel_index][-robot.nu :]
    torque, used = statics.joint_torques, statics.motor_utilisation
    beyond = used > 1
    with np.errstate(invalid="ignore", divide="ignore"):
        alone = used * np.abs(torque + pulled) / np.abs(torque)
    loaded = beyond & (pulled != 0)
    if not beyond.any() or not (loaded == beyond).all() or (alone[beyond] > 1).any():
        return ()
    return (Cause("spring", tuple(np.array(robot.joint_names)[loaded].tolist())),)


_SLIPPERY = 0.3
"""Sliding friction of a contact below which it may be a slip of the file: wet steel has more."""

_GRIP = 0.8
"""Sliding friction in its place: of rubber on a floor."""

_SOFT = 0.05
"""The time constant of a contact (s) above which it may be; MuJoCo's own is 0.02."""

_OWN_SOLREF = (0.02, 1.0)


def _contacts(bare: Bare) -> Iterator[Candidate]:
    """Contacts that slip, and contacts that give way."""
    model = bare.model
    touch = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    even = model.pair_friction[:, 0] == model.pair_friction[:, 1]  # else see ``_pairs``
    for code in ("slippery", "soft"):
        found = np.flatnonzero(_are_bad(model, "geom", code) & touch)
        stated = np.flatnonzero(_are_bad(model, "pair", code) & (even | (code == "soft")))
        if not len(found) and not len(stated):
            continue

        def sound(
            other: mujoco.MjModel,
            code: str = code,
            found: NDArray[np.intp] = found,
            stated: NDArray[np.intp] = stated,
        ) -> None:
            if code == "slippery":
                other.geom_friction[found, 0] = _GRIP
                other.pair_friction[stated, :2] = _GRIP
            else:
                other.geom_solref[found] = other.pair_solref[stated] = _OWN_SOLREF

        shapes = dict.fromkeys(_shape(model, geom) for geom in found.tolist())
        yield Candidate(code, (*shapes, *_pair_names(model, stated)), sound)


def _are_bad(model: mujoco.MjModel, of: str, code: str) -> NDArray[np.bool_]:
    """Tells which contacts of geoms (``geom``) or pairs (``pair``) are slippery, or soft."""
    if code == "slippery":
        return np.asarray(getattr(model, f"{of}_friction")[:, 0] < _SLIPPERY)
    return np.asarray(getattr(model, f"{of}_solref")[:, 0] > _SOFT)


def _shape(model: mujoco.MjModel, geom: int) -> str:
    """Returns a geom's name, or else its body's."""
    named = mujoco.mj_id2name(model, _OBJ.mjOBJ_GEOM, geom)
    return named or _name(model, _OBJ.mjOBJ_BODY, int(model.geom_bodyid[geom]))


def _pair_names(model: mujoco.MjModel, pairs: NDArray[np.intp]) -> tuple[str, ...]:
    both = np.column_stack([model.pair_geom1, model.pair_geom2])[pairs]
    return tuple(" and ".join(_names(model, _OBJ.mjOBJ_GEOM, ends)) for ends in both)


def _excludes(model: mujoco.MjModel) -> Iterator[Candidate]:
    """A pair of bodies that do not touch, one of which is the world."""
    for number in range(model.nexclude):
        pair = divmod(int(model.exclude_signature[number]), 1 << 16)
        if 0 not in pair and not set(pair) & _still(model):
            continue
        names = " and ".join(_name(model, _OBJ.mjOBJ_BODY, body) for body in pair)
        yield Candidate("exclude", (names,), _set("exclude_signature", number))  # world and itself


def _still(model: mujoco.MjModel) -> set[int]:
    return set(np.flatnonzero(model.body_weldid == 0).tolist())


def _options(model: mujoco.MjModel) -> Iterator[Candidate]:
    override = mujoco.mjtEnableBit.mjENBL_OVERRIDE.value
    if model.opt.enableflags & override:

        def plain(other: mujoco.MjModel) -> None:
            other.opt.enableflags &= ~override

        yield Candidate("override", ("flag override",), plain)
    if model.opt.disableactuator:

        def enabled(other: mujoco.MjModel) -> None:
            other.opt.disableactuator = 0

        yield Candidate("actuatorgroupdisable", ("option actuatorgroupdisable",), enabled)
    if model.opt.jacobian != mujoco.mjtJacobian.mjJAC_DENSE.value and mujoco.mj_isSparse(model):

        def dense(other: mujoco.MjModel) -> None:
            other.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE.value

        yield Candidate("solver", ("option jacobian",), dense)


def _equalities(model: mujoco.MjModel) -> Iterator[Candidate]:
    """Welds and connections of the robot to what stands in the world, or is moved by hand."""
    kinds = (mujoco.mjtEq.mjEQ_WELD.value, mujoco.mjtEq.mjEQ_CONNECT.value)
    for number in np.flatnonzero(np.isin(model.eq_type, kinds)).tolist():
        if not model.eq_active0[number]:
            continue
        ends = [int(model.eq_obj1id[number]), int(model.eq_obj2id[number])]
        if model.eq_objtype[number] == _OBJ.mjOBJ_SITE.value:
            ends = [int(model.site_bodyid[end]) for end in ends]
        if not any(model.body_weldid[end] == 0 or model.body_mocapid[end] >= 0 for end in ends):
            continue
        kind = "weld" if model.eq_type[number] == kinds[0] else "connect"
        name = mujoco.mj_id2name(model, _OBJ.mjOBJ_EQUALITY, number)
        both = " and ".join(_name(model, _OBJ.mjOBJ_BODY, end) for end in ends)
        yield Candidate(kind, (name or both,), _set("eq_active0", number))


def _limits(bare: Bare, robot: Robot) -> Iterator[Candidate]:
    """Limits of commands and forces, one kind for all joints that have it."""
    model = bare.model
    joints = [model.joint(name).id for name in robot.joint_names]
    motors = [motor for joint in joints for motor in drives_of(model, joint)]
    ranged = [m for m in motors if model.actuator_ctrllimited[model.actuator_ctrladr[m]]]
    if ranged:
        any_command = _set("actuator_ctrllimited", model.actuator_ctrladr[ranged])
        yield Candidate("ctrlrange", _motor_names(model, ranged), any_command)
    forced = [motor for motor in motors if model.actuator_forcelimited[motor]]
    if forced:
        any_force = _set("actuator_forcelimited", forced)
        yield Candidate("forcerange", _motor_names(model, forced), any_force)
    clamped = [joint for joint in joints if model.jnt_actfrclimited[joint]]
    if clamped:
        listed = _names(model, _OBJ.mjOBJ_JOINT, clamped)
        yield Candidate("actuatorfrcrange", listed, _set("jnt_actfrclimited", clamped))


def _motors(bare: Bare) -> Iterator[Candidate]:
    """Motors at tendons, sites and bodies: thrusters, servos of tendons, adhesion; slow filters."""
    model = bare.model
    others = other_motors(model)
    if others:
        silent = _set("actuator_gainprm actuator_biasprm", others)
        listed = _names(model, _OBJ.mjOBJ_ACTUATOR, others)
        yield Candidate("motors-elsewhere", listed, silent)

    slow = [
        motor
        for motor in range(model.nactuator if model.na else 0)
        if int(model.actuator_dyntype[motor]) in FILTERS
        and model.actuator_dynprm[motor, 0] > SETTLES
    ]
    if slow:
        quick = _set("actuator_dynprm", (slow, 0), SETTLES)
        yield Candidate("timeconst", _motor_names(model, slow), quick)


def _pairs(model: mujoco.MjModel) -> Iterator[Candidate]:
    """Friction of a pair of geoms that is not the same along both of its axes."""
    uneven = np.flatnonzero(model.pair_friction[:, 0] != model.pair_friction[:, 1])
    if len(uneven):
        most = model.pair_friction[uneven][:, :2].max(axis=1)
        even = _set("pair_friction", (uneven, slice(2)), most[:, None])
        yield Candidate("pair-friction", _pair_names(model, uneven), even)


def _passive(bare: Bare, robot: Robot) -> Iterator[Candidate]:
    """Joints that are held at zero in what is computed, and move in the file; soft bodies."""
    model = bare.model
    loose = loose_joints(bare, robot)
    if loose:
        locked = _set("dof_damping", model.jnt_dofadr[loose], _LOCKED)
        yield Candidate("loose-joints", _names(model, _OBJ.mjOBJ_JOINT, loose), locked)
    if model.nflex:
        untouched = _set("flex_contype flex_conaffinity", slice(None))
        listed = _names(model, _OBJ.mjOBJ_FLEX, range(model.nflex))
        yield Candidate("flex", listed, untouched)


def _shapes(bare: Bare, robot: Robot) -> Iterator[Candidate]:
    """Shapes of the robot that were kept from touching, and what else stands in the world."""
    model = bare.model
    touch = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    replaced = {model.body(name).id for name in _on_balls(robot)}
    # Of a URDF's import the geoms are others than the robot's, which has what is seen, too.
    alike = robot.published is None or robot.published.imported is None
    untouched = _untouched(bare, robot) if alike else []
    kept = [geom for geom in untouched if model.geom_bodyid[geom] not in replaced]
    by_hand = model.body_mocapid[model.body_weldid[model.geom_bodyid]] >= 0
    still = ((model.body_weldid[model.geom_bodyid] == 0) | by_hand) & touch
    plane = model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE.value
    for code, geoms in (
        ("shapes-beside-feet", kept),
        ("obstacles", np.flatnonzero(still & ~plane).tolist()),
    ):
        if geoms:
            bodies = dict.fromkeys(_shape(model, geom) for geom in geoms)
            off = _set("geom_contype geom_conaffinity", geoms)
            yield Candidate(code, tuple(bodies), off)


def _untouched(bare: Bare, robot: Robot) -> list[int]:
    """Returns the published geoms that touch, and whose counterparts in the robot do not."""
    model, other = bare.model, robot.mj_model
    found = []
    for body in range(1, model.nbody):
        same = mujoco.mj_name2id(
            other, _OBJ.mjOBJ_BODY, mujoco.mj_id2name(model, _OBJ.mjOBJ_BODY, body) or ""
        )
        if same < 0:
            continue
        first, there = int(model.body_geomadr[body]), int(other.body_geomadr[same])
        count = min(int(model.body_geomnum[body]), int(other.body_geomnum[same]))
        for index in range(count):
            one, two = first + index, there + index
            touches = model.geom_contype[one] or model.geom_conaffinity[one]
            if touches and not (other.geom_contype[two] or other.geom_conaffinity[two]):
                found.append(one)
    return found


def _on_balls(robot: Robot) -> tuple[str, ...]:
    """Returns the bodies of which balls took the place of shapes."""
    balls = (one.body for one in robot.description.added if isinstance(one, Ball))
    return tuple(dict.fromkeys(balls))


def altered_on_loading(bare: Bare, robot: Robot) -> tuple[Cause, ...]:
    """Returns what was changed on loading, and cannot be switched off in the file.

    Bodies whose own shapes were replaced by balls, and joints whose actuator, neither a servo nor a
    torque motor, was replaced by a servo.
    """
    bodies = _on_balls(robot)
    named = zip(robot.joint_names, bare.drives, strict=True)
    joints = tuple(name for name, drive in named if drive is Drive.OTHER)
    return (
        *((Cause("balls", bodies),) if bodies else ()),
        *((Cause("other-drive", joints),) if joints else ()),
    )
