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
from pupper_analysis.models.transmission import actuator_gear, list_joint_actuators
from pupper_analysis.prepare.published_model import (
    MAX_SETTLED_TIME_CONSTANT,
    PublishedModel,
    list_uncommanded_actuators,
    list_unmatched_joints,
)
from pupper_analysis.robot.as_published import Cause
from pupper_analysis.robot.robot import Robot
from pupper_analysis.simulation.rollout import FILTERS

Array = NDArray[np.float64]

_OBJ = mujoco.mjtObj

_FINE = 2e-3
"""A step of the simulation (s) at which servos and contacts are what they are in time."""

_ITERATIONS, _TOLERANCE = 100, 1e-10
"""Of an exact solver of contacts: Newton's converges in ten."""

_LOCKED = 1e6
"""Damping of a joint that is held (N m s/rad, N s/m): under a newton it goes a micrometre."""


@dataclass(frozen=True, eq=False)
class CauseCandidate:
    """Something in an MJCF that may make it differ.

    Attributes:
        code: What it is.
        elements: Its name, or the names of all that are alike.
        switch_off: Takes it away from a copy of the model, in place.
    """

    code: str
    elements: tuple[str, ...]
    switch_off: Callable[[mujoco.MjModel], None]

    def to_cause(self, remaining: float) -> Cause:
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
    "gear": "actuator",
    "delay": "actuator",
    "motors-elsewhere": "actuator",
    "soft-servos": "actuator",
    "ctrl-absent": "key",
    "angles-to-motors": "key",
    "actuatorfrcrange": "joint",
    "loose-joints": "joint",
    "spring": "joint",
    "range": "joint",
}


def add_line(cause: Cause, mjcf: MjcfFile) -> Cause:
    """Returns a cause with the line where its first element stands, where that has a name."""
    if cause.code not in _SECTIONS or not cause.elements:
        return cause
    return replace(cause, line=mjcf.place(_SECTIONS[cause.code], cause.elements[0]).line)


def list_candidate_causes(published: PublishedModel, robot: Robot) -> list[CauseCandidate]:
    """Returns what in an MJCF may make it differ from what is computed of its robot."""
    model = published.model
    return [
        *_numerics(model),
        *_excludes(model),
        *_options(model),
        *_equalities(model),
        *_limits(published, robot),
        *_servos(published, robot),
        *_motors(published),
        *_passive(published, robot),
        *_shapes(published, robot),
    ]


def list_physical_causes(published: PublishedModel, robot: Robot) -> list[CauseCandidate]:
    """Returns what in an MJCF, though its robot is computed with it, may be what makes it fail."""
    return [*_signs(published, robot), *_forces(published, robot), *_contacts(published)]


def _name(model: mujoco.MjModel, kind: mujoco.mjtObj, number: int) -> str:
    return mujoco.mj_id2name(model, kind, number) or f"#{number}"


def _names(model: mujoco.MjModel, kind: mujoco.mjtObj, numbers: Iterable[int]) -> tuple[str, ...]:
    return tuple(_name(model, kind, int(number)) for number in numbers)


def _motor_names(model: mujoco.MjModel, motors: Iterable[int]) -> tuple[str, ...]:
    """Returns actuators' names, or else their joints'."""
    return tuple(
        mujoco.mj_id2name(model, _OBJ.mjOBJ_ACTUATOR, int(motor))
        or _name(model, _OBJ.mjOBJ_JOINT, int(model.actuator_trnid[motor, 0]))
        for motor in motors
    )


NUMERICS_CODES = ("timestep", "iterations")
"""The codes of how MuJoCo integrates and solves."""

COMMAND_CODES = ("bias", "gain", "gear")
"""The codes of what makes another target of a command."""


def _set(*changes: tuple[str, Any, Any]) -> Callable[[mujoco.MjModel], None]:
    """Returns what gives elements of a model's arrays, or its options, other values.

    Args:
        changes: (fields, which of their elements, the value); of an option's, the element is None.
    """

    def switch_off(other: mujoco.MjModel) -> None:
        for fields, where, value in changes:
            for field in fields.split():
                if where is None:
                    setattr(other.opt, field, value)
                else:
                    attrgetter(field)(other)[where] = value

    return switch_off


def _if_any(
    code: str, elements: tuple[str, ...], fields: str, where: Any, value: Any = 0
) -> Iterator[CauseCandidate]:
    """Yields what gives elements another value, by default none, if there are any."""
    if elements:
        yield CauseCandidate(code, elements, _set((fields, where, value)))


def _numerics(model: mujoco.MjModel) -> Iterator[CauseCandidate]:
    """How MuJoCo integrates, and how exactly it solves for constraint forces."""
    option, newton = model.opt, mujoco.mjtSolver.mjSOL_NEWTON.value
    integrator = mujoco.mjtIntegrator(int(option.integrator)).name.removeprefix("mjINT_")
    if not model.actuator_delay.any():  # else its samples would last for less
        finer = _set(
            ("timestep", None, min(option.timestep / 2, _FINE)),
            ("integrator", None, mujoco.mjtIntegrator.mjINT_IMPLICITFAST.value),
        )
        yield CauseCandidate("timestep", (f"{option.timestep:g} s ({integrator})",), finer)
    rough = option.iterations < _ITERATIONS or option.tolerance > _TOLERANCE
    if rough or option.solver != newton:
        exact = _set(
            ("solver", None, newton),
            ("iterations", None, max(option.iterations, _ITERATIONS)),
            ("tolerance", None, min(option.tolerance, _TOLERANCE)),
        )
        kind = mujoco.mjtSolver(int(option.solver)).name.removeprefix("mjSOL_")
        yield CauseCandidate("iterations", (f"{kind}, {option.iterations} iterations",), exact)


def _joints_of(published: PublishedModel, robot: Robot) -> NDArray[np.int64]:
    """Returns the ids of the robot's joints in a model."""
    return np.array([published.model.joint(name).id for name in robot.joint_names])


def _motors_of(published: PublishedModel, robot: Robot) -> NDArray[np.int64]:
    """Returns the ids of the motors at the robot's joints in a model."""
    joints = _joints_of(published, robot).tolist()
    return np.array(
        [m for joint in joints for m in list_joint_actuators(published.model, joint)],
        dtype=np.int64,
    )


def _servos(published: PublishedModel, robot: Robot) -> Iterator[CauseCandidate]:
    """Forces beside the law of position servos: biases, gains that are no stiffness, delays."""
    model, motors = published.model, _motors_of(published, robot)
    affine = mujoco.mjtBias.mjBIAS_AFFINE.value
    served = motors[model.actuator_biastype[motors] == affine]
    gain, stiffness = model.actuator_gainprm[served, 0], -model.actuator_biasprm[served, 1]
    biased = served[model.actuator_biasprm[served, 0] != 0]
    uneven = served[(stiffness > 0) & (stiffness != gain) & (gain > 0)]
    late = model.actuator_delay[motors] > 0
    named = {code: _motor_names(model, which) for code, which in (
        ("bias", biased), ("gain", uneven), ("delay", motors[late])
    )}  # fmt: skip
    even = -model.actuator_biasprm[uneven, 1]
    yield from _if_any("bias", named["bias"], "actuator_biasprm", (biased, 0))
    yield from _if_any("gain", named["gain"], "actuator_gainprm", (uneven, 0), even)
    yield from _if_any("delay", named["delay"], "actuator_delay", motors[late])


def _signs(published: PublishedModel, robot: Robot) -> Iterator[CauseCandidate]:
    """Gears that turn a motor round, which is seldom meant."""
    model = published.model
    turned = [m for m in _motors_of(published, robot).tolist() if actuator_gear(model, m)[0] < 0]
    outputs = model.actuator_outadr[turned]
    straight = -model.actuator_gear[outputs, 0]
    named = _motor_names(model, turned)
    yield from _if_any("gear", named, "actuator_gear", (outputs, 0), straight)


def _forces(published: PublishedModel, robot: Robot) -> Iterator[CauseCandidate]:
    """Forces beside gravity and motors: springs, joints' limits, fluids; and gravity aside."""
    model, joints = published.model, _joints_of(published, robot)
    linear, higher = "jnt_stiffness tendon_stiffness", "jnt_stiffnesspoly tendon_stiffnesspoly"
    sprung = [
        _names(model, kind, np.flatnonzero((stiff != 0) | poly.any(axis=1)))
        for kind, stiff, poly in (
            (_OBJ.mjOBJ_JOINT, model.jnt_stiffness, model.jnt_stiffnesspoly),
            (_OBJ.mjOBJ_TENDON, model.tendon_stiffness, model.tendon_stiffnesspoly),
        )
    ]
    yield from _if_any("spring", (*sprung[0], *sprung[1]), f"{linear} {higher}", slice(None))
    limited = joints[model.jnt_limited[joints] != 0]
    yield from _if_any("range", _names(model, _OBJ.mjOBJ_JOINT, limited), "jnt_limited", limited)
    if model.opt.density or model.opt.viscosity:
        parts = [f"density {model.opt.density:g} kg/m^3", f"viscosity {model.opt.viscosity:g} Pa s"]
        if model.opt.wind.any():
            parts.append(f"wind ({', '.join(f'{speed:g}' for speed in model.opt.wind)}) m/s")
        yield CauseCandidate("fluid", tuple(parts), _set(("density viscosity", None, 0.0)))
    if model.opt.gravity[:2].any():
        down = 0.0, 0.0, -np.linalg.norm(model.opt.gravity)
        stated = ", ".join(f"{part:g}" for part in model.opt.gravity)
        upright = _set(("opt.gravity", slice(None), down))
        yield CauseCandidate("gravity", (f"({stated}) m/s^2",), upright)


_STIFFER = 4.0
"""Factor by which servos are made stiffer to test whether their stiffness is too low. Chosen."""


def list_soft_servos(published: PublishedModel, robot: Robot) -> Iterator[CauseCandidate]:
    """Position servos that may be too soft. The damping grows with the stiffness."""
    model, motors = published.model, _motors_of(published, robot)
    affine = model.actuator_biastype[motors] == mujoco.mjtBias.mjBIAS_AFFINE.value
    fixed = model.actuator_gaintype[motors] == mujoco.mjtGain.mjGAIN_FIXED.value
    soft = motors[affine & fixed & (model.actuator_biasprm[motors, 1] < 0)]
    if soft.size:
        gain, bias = model.actuator_gainprm[soft, 0], model.actuator_biasprm[soft]
        stiffer = _set(
            ("actuator_gainprm", (soft, 0), _STIFFER * gain),
            ("actuator_biasprm", soft, _STIFFER * bias),
        )
        yield CauseCandidate("soft-servos", _motor_names(model, soft), stiffer)


_SLIPPERY = 0.3
"""Sliding friction of a contact below which it may be a slip of the file: wet steel has more."""

_GRIP = 0.8
"""Sliding friction in its place: of rubber on a floor."""

_SOFT = 0.05
"""The time constant of a contact (s) above which it may be; MuJoCo's own is 0.02."""

_OWN_SOLREF = (0.02, 1.0)


def _contacts(published: PublishedModel) -> Iterator[CauseCandidate]:
    """Contacts that slip, and contacts that give way."""
    model = published.model
    touch = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    slips = np.flatnonzero(_are_bad(model, "geom", "slippery") & touch)
    paired = np.flatnonzero(_are_bad(model, "pair", "slippery"))
    gives = np.flatnonzero(_are_bad(model, "geom", "soft") & touch)
    both = np.flatnonzero(_are_bad(model, "pair", "soft"))
    for code, geoms, pairs, sound in (
        ("slippery", slips, paired, (("geom_friction", (slips, 0), _GRIP),
                                     ("pair_friction", (paired, slice(2)), _GRIP))),
        ("soft", gives, both, (("geom_solref", gives, _OWN_SOLREF),
                               ("pair_solref", both, _OWN_SOLREF))),
    ):  # fmt: skip
        if len(geoms) or len(pairs):
            shapes = dict.fromkeys(_shape(model, geom) for geom in geoms.tolist())
            yield CauseCandidate(code, (*shapes, *_pair_names(model, pairs)), _set(*sound))


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


def _excludes(model: mujoco.MjModel) -> Iterator[CauseCandidate]:
    """A pair of bodies that do not touch, one of which is the world, or is fixed to it."""
    still = {0, *np.flatnonzero(model.body_weldid == 0).tolist()}
    for number in range(model.nexclude):
        pair = divmod(int(model.exclude_signature[number]), 1 << 16)
        if still & set(pair):
            names = " and ".join(_names(model, _OBJ.mjOBJ_BODY, pair))
            yield from _if_any("exclude", (names,), "exclude_signature", number)  # world and itself


def _options(model: mujoco.MjModel) -> Iterator[CauseCandidate]:
    flags, override = model.opt.enableflags, mujoco.mjtEnableBit.mjENBL_OVERRIDE.value
    for acts, code, element, field, value in (
        (flags & override, "override", "flag override", "enableflags", flags & ~override),
        (
            model.opt.disableactuator,
            "actuatorgroupdisable",
            "option actuatorgroupdisable",
            "disableactuator",
            0,
        ),
    ):
        yield from _if_any(code, (element,) if acts else (), field, None, value)


def _equalities(model: mujoco.MjModel) -> Iterator[CauseCandidate]:
    """Welds and connections of the robot to what stands in the world, or is moved by hand."""
    kinds = {mujoco.mjtEq.mjEQ_WELD.value: "weld", mujoco.mjtEq.mjEQ_CONNECT.value: "connect"}
    for number in np.flatnonzero(np.isin(model.eq_type, list(kinds)) & model.eq_active0).tolist():
        ends = [int(model.eq_obj1id[number]), int(model.eq_obj2id[number])]
        if model.eq_objtype[number] == _OBJ.mjOBJ_SITE.value:
            ends = [int(model.site_bodyid[end]) for end in ends]
        if any(model.body_weldid[end] == 0 or model.body_mocapid[end] >= 0 for end in ends):
            name = mujoco.mj_id2name(model, _OBJ.mjOBJ_EQUALITY, number)
            both = " and ".join(_names(model, _OBJ.mjOBJ_BODY, ends))
            kind = kinds[int(model.eq_type[number])]
            yield from _if_any(kind, (name or both,), "eq_active0", number)


def _limits(published: PublishedModel, robot: Robot) -> Iterator[CauseCandidate]:
    """Limits of commands and forces, one kind for all joints that have it."""
    model, joints, motors = (
        published.model,
        _joints_of(published, robot),
        _motors_of(published, robot),
    )
    controls = model.actuator_ctrladr[motors]
    cut = model.actuator_ctrllimited[controls] != 0
    ranged = _motor_names(model, motors[cut])
    yield from _if_any("ctrlrange", ranged, "actuator_ctrllimited", controls[cut])
    forced = motors[model.actuator_forcelimited[motors] != 0]
    named = _motor_names(model, forced)
    yield from _if_any("forcerange", named, "actuator_forcelimited", forced)
    clamped = joints[model.jnt_actfrclimited[joints] != 0]
    named = _names(model, _OBJ.mjOBJ_JOINT, clamped)
    yield from _if_any("actuatorfrcrange", named, "jnt_actfrclimited", clamped)


def _motors(published: PublishedModel) -> Iterator[CauseCandidate]:
    """Motors at tendons, sites and bodies: thrusters, servos of tendons, adhesion; slow filters."""
    model, others = published.model, list_uncommanded_actuators(published.model)
    named = _names(model, _OBJ.mjOBJ_ACTUATOR, others)
    yield from _if_any("motors-elsewhere", named, "actuator_gainprm actuator_biasprm", others)
    filtered = np.isin(model.actuator_dyntype, FILTERS)
    slow = np.flatnonzero(filtered & (model.actuator_dynprm[:, 0] > MAX_SETTLED_TIME_CONSTANT))
    named = _motor_names(model, slow)
    yield from _if_any("timeconst", named, "actuator_dynprm", (slow, 0), MAX_SETTLED_TIME_CONSTANT)


def _passive(published: PublishedModel, robot: Robot) -> Iterator[CauseCandidate]:
    """Joints that are held at zero in what is computed, and move in the file."""
    model, loose = published.model, list_unmatched_joints(published, robot)
    named = _names(model, _OBJ.mjOBJ_JOINT, loose)
    yield from _if_any("loose-joints", named, "dof_damping", model.jnt_dofadr[loose], _LOCKED)


def _shapes(published: PublishedModel, robot: Robot) -> Iterator[CauseCandidate]:
    """Shapes of the robot that were kept from touching, and what else stands in the world."""
    model = published.model
    touch = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    replaced = {model.body(name).id for name in _on_balls(robot)}
    # Of a URDF's import the geoms are others than the robot's, which has what is seen, too.
    alike = robot.published is None or robot.published.imported is None
    untouched = _untouched(published, robot) if alike else []
    kept = [geom for geom in untouched if model.geom_bodyid[geom] not in replaced]
    by_hand = model.body_mocapid[model.body_weldid[model.geom_bodyid]] >= 0
    still = ((model.body_weldid[model.geom_bodyid] == 0) | by_hand) & touch
    plane = model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE.value
    obstacles = np.flatnonzero(still & ~plane).tolist()
    for code, geoms in (("shapes-beside-feet", kept), ("obstacles", obstacles)):
        bodies = tuple(dict.fromkeys(_shape(model, geom) for geom in geoms))
        yield from _if_any(code, bodies, "geom_contype geom_conaffinity", geoms)


def _untouched(published: PublishedModel, robot: Robot) -> list[int]:
    """Returns the published geoms that touch, and whose counterparts in the robot do not."""
    model, other = published.model, robot.mj_model
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


def list_loading_changes(published: PublishedModel, robot: Robot) -> tuple[Cause, ...]:
    """Returns what was changed on loading, and cannot be switched off in the file.

    Bodies whose own shapes were replaced by balls, and joints whose actuator, neither a servo nor a
    torque motor, was replaced by a servo.
    """
    bodies = _on_balls(robot)
    named = zip(robot.joint_names, published.drives, strict=True)
    joints = tuple(name for name, drive in named if drive.has_other_law)
    return (
        *((Cause("balls", bodies),) if bodies else ()),
        *((Cause("other-drive", joints),) if joints else ()),
    )
