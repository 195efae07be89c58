"""List elements of a published model that may explain why it behaves unlike the prepared robot.

The published model is the user's file as MuJoCo compiles it. The prepared robot is the model with
which the equilibria of stands are predicted. If a simulation of the published model deviates from
the predicted equilibrium, an element of the file may be the cause. Examples are a servo bias, a
limit and a contact exclusion. This module lists such elements as candidate causes. The effect of
each candidate can be removed from a copy of the model. If the deviation then disappears in a
simulation, the element is the cause (`prepare.self_check`).
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import Diagnostic, Quantity, format_number
from pupper_analysis.models.additions import Ball, ContactExclusion
from pupper_analysis.models.mjcf import JointKind, scalar_joints
from pupper_analysis.models.mjcf_file import MjcfFile
from pupper_analysis.models.transmission import (
    Drive,
    actuator_gear,
    classify_joint_drive,
    is_at_one_joint,
    list_joint_actuators,
    list_tendon_servos,
)
from pupper_analysis.prepare.published_model import (
    MAX_SETTLED_TIME_CONSTANT,
    PublishedModel,
    list_uncommanded_actuators,
    list_unmatched_joints,
)
from pupper_analysis.robot.as_published import Cause
from pupper_analysis.robot.build import SUPPORT_FLAGS, compile_with_visuals
from pupper_analysis.robot.closure import find_closure
from pupper_analysis.robot.robot import Robot
from pupper_analysis.simulation.rollout import FILTER_DYNAMICS

_OBJECT_TYPE = mujoco.mjtObj
"""MuJoCo's enumeration of element types."""


_MAX_FINE_TIMESTEP = 2e-3
"""Upper bound of the time step [s] in a test simulation with a finer integration. The test
simulation shows if the integration of the file causes a deviation from the predicted equilibrium.
The value is MuJoCo's default; chosen, not tuned."""

_MIN_ITERATIONS, _MAX_TOLERANCE = 100, 1e-10
"""Lower bound of the iterations [1] and upper bound of the tolerance [1] with which the constraint
solver Newton counts as accurate. Chosen, not tuned.
"""

_LOCKING_DAMPING = 1e6
"""Damping that locks a joint in a test simulation [N m s/rad, N s/m]. Under 1 N a locked slide
moves by 1 um/s. Chosen, not tuned."""


_LOCKING_BALL_DAMPING = 1e4
"""Damping that locks a ball joint in a test simulation [N m s/rad]. Measured on a quadruped with
ball joints in its ankles (feet of 0.05 kg): from 1e2 to 1e4, the torques agree within 0.1 % with
the torques of locked ankles.
"""


@dataclass(frozen=True, eq=False)
class CauseCandidate:
    """Elements of an MJCF that may explain a deviation, with a function that removes their effect.

    A deviation is a difference between a simulation of the MJCF and the predicted equilibrium, or a
    fall.

    Attributes:
        code: Kind of the cause, for example ``"bias"`` or ``"timestep"``.
        elements: Names of the elements. For MuJoCo options: names or values of the options.
        switch_off: Function that removes the effect of the elements from a MuJoCo model, in place.
            The caller passes a copy of the published model.
    """

    code: str
    elements: tuple[str, ...]
    switch_off: Callable[[mujoco.MjModel], None]

    def make_cause(self, remaining: float) -> Cause:
        """Create the entry of a report that names the elements of this candidate as a cause.

        Args:
            remaining: Deviation that remains if the elements are switched off. The caller defines
                quantity and unit, for example a torque error relative to a torque scale [1].
        """
        return Cause(self.code, self.elements, None, remaining)


_XML_SECTIONS = {
    "weld": "equality",
    "connect": "equality",
    "tendon": "tendon",
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
    "keyframe-tilted": "key",
    "angles-to-motors": "key",
    "actuatorfrcrange": "joint",
    "loose-joints": "joint",
    "ball-joints": "joint",
    "spring": "joint",
    "range": "joint",
}
"""{code of a cause: tag or section of the MJCF} in which `add_line` searches the line of the first
element."""


def add_line(cause: Cause, mjcf: MjcfFile) -> Cause:
    """Return a copy of a cause with the line of its first element in the MJCF, if found."""
    if cause.code not in _XML_SECTIONS or not cause.elements:
        return cause
    section, element = _XML_SECTIONS[cause.code], cause.elements[0]
    line = mjcf.place(section, element).line
    if line is None and section == "equality":
        numbers = (
            number
            for number, equality in enumerate(mjcf.spec.equalities)
            if element == _name_bodies((equality.name1, equality.name2))
        )
        number = next(numbers, None)
        line = None if number is None else mjcf.place_by_number(section, number).line
    return replace(cause, line=line)


def _name_bodies(names: Iterable[str]) -> str:
    """Form a name "A and B" for a constraint without a name, from the names of its two bodies.

    An empty name stands for the world.
    """
    return " and ".join(name or "world" for name in names)


def list_difference_causes(published: PublishedModel, robot: Robot) -> list[CauseCandidate]:
    """List elements of a published MJCF that may make it deviate from the predicted equilibrium.

    Examples are solver settings, contact exclusions, equalities, limits, servo biases and
    obstacles.
    """
    model = published.model
    return [
        *_list_numerics(model),
        *_list_exclude_causes(model),
        *_list_option_causes(model),
        *list_ties(model),
        *_list_limit_causes(published, robot),
        *_list_servo_causes(published, robot),
        *_list_actuator_causes(published),
        *_list_passive_causes(published, robot),
        *_list_shape_causes(published, robot),
        *_list_overlap_causes(published, robot),
    ]


def list_shared_causes(published: PublishedModel, robot: Robot) -> list[CauseCandidate]:
    """List candidate causes in an MJCF that affect both the published model and the prepared robot.

    Examples are actuators with a negative gear, springs, joint limits, and slippery contacts.
    """
    return [
        *_list_flag_causes(published.model),
        *_list_sign_causes(published, robot),
        *_list_force_causes(published, robot),
        *_list_contact_causes(published),
    ]


def _get_element_name(model: mujoco.MjModel, kind: mujoco.mjtObj, number: int) -> str:
    """Return the name of the element with id ``number``; "#3" etc. if the element has no name."""
    return mujoco.mj_id2name(model, kind, number) or f"#{number}"


def _list_element_names(
    model: mujoco.MjModel, kind: mujoco.mjtObj, numbers: Iterable[int]
) -> tuple[str, ...]:
    """Return the names of MuJoCo elements of a kind, such as geoms, from their ids ``numbers``."""
    return tuple(_get_element_name(model, kind, int(number)) for number in numbers)


def _name_actuators(model: mujoco.MjModel, actuators: Iterable[int]) -> tuple[str, ...]:
    """Return the names of actuators; without a name, the name of the joint, else "#3" etc."""

    def find_name(actuator: int) -> str:
        """Return the name of an actuator; without a name, that of its hinge or slide, else "#3"."""
        named = mujoco.mj_id2name(model, _OBJECT_TYPE.mjOBJ_ACTUATOR, actuator)
        if named or not is_at_one_joint(model, actuator):
            return named or f"#{actuator}"
        joint = int(model.actuator_trnid[actuator, 0])
        return _get_element_name(model, _OBJECT_TYPE.mjOBJ_JOINT, joint)

    return tuple(find_name(int(actuator)) for actuator in actuators)


NUMERICS_CODES = ("timestep", "iterations")
"""Codes of the numerical causes of a deviation from the predicted equilibrium: ``timestep`` (time
step and integrator) and ``iterations`` (inaccurate constraint solver). `self_check` tests causes
with these codes first."""

COMMAND_CODES = ("bias", "gain", "gear")
"""Codes of causes that change the joint position that a servo command (ctrl) requests. If a joint
is not held, the search in `self_check` tests no other elements: without them, the robot might stand
by chance.
"""


def _make_switch(*changes: tuple[str, Any, Any]) -> Callable[[mujoco.MjModel], None]:
    """Create a function that removes the effect of elements, by new values in a MuJoCo model.

    Args:
        changes: Triples (names of the fields, joined by spaces; index of the elements; new value).
            The index is None for scalar fields of ``model.opt``.
    """

    def switch_off(model: mujoco.MjModel) -> None:
        """Set the elements in ``changes`` of a model, in place, to remove their effect."""
        for fields, index, value in changes:
            for field in fields.split():
                if index is None:
                    setattr(model.opt, field, value)
                else:
                    attrgetter(field)(model)[index] = value

    return switch_off


def _yield_if_any(
    code: str, elements: tuple[str, ...], fields: str, index: Any, value: Any = 0
) -> Iterator[CauseCandidate]:
    """Yield a candidate cause, if there are any elements.

    Switching the cause off sets the ``fields`` of a MuJoCo model, joined by spaces, to ``value`` at
    ``index`` (None for fields of ``model.opt``).
    """
    if elements:
        yield CauseCandidate(code, elements, _make_switch((fields, index, value)))


def _list_numerics(model: mujoco.MjModel) -> Iterator[CauseCandidate]:
    """Yield integration and inaccurate constraint solver as causes of a deviation from equilibrium.

    The time step cannot change if an actuator has a delay: its buffer has a fixed number of
    samples.
    """
    option, newton = model.opt, mujoco.mjtSolver.mjSOL_NEWTON.value
    integrator = mujoco.mjtIntegrator(int(option.integrator)).name.removeprefix("mjINT_")
    if not model.actuator_delay.any():
        finer = _make_switch(
            ("timestep", None, min(option.timestep / 2, _MAX_FINE_TIMESTEP)),
            ("integrator", None, mujoco.mjtIntegrator.mjINT_IMPLICITFAST.value),
        )
        yield CauseCandidate("timestep", (f"{option.timestep:g} s ({integrator})",), finer)
    rough = option.iterations < _MIN_ITERATIONS or option.tolerance > _MAX_TOLERANCE
    if rough or option.solver != newton:
        exact = _make_switch(
            ("solver", None, newton),
            ("iterations", None, max(option.iterations, _MIN_ITERATIONS)),
            ("tolerance", None, min(option.tolerance, _MAX_TOLERANCE)),
        )
        kind = mujoco.mjtSolver(int(option.solver)).name.removeprefix("mjSOL_")
        yield CauseCandidate("iterations", (f"{kind}, {option.iterations} iterations",), exact)


def _list_joint_ids(published: PublishedModel, robot: Robot) -> NDArray[np.int64]:
    """Return the ids of the joints in ``robot.joint_names`` in the published model, (nu,)."""
    return np.array([published.model.joint(name).id for name in robot.joint_names])


def _list_actuator_ids(published: PublishedModel, robot: Robot) -> NDArray[np.int64]:
    """Return the ids of the actuators at the robot's joints in the published model, shape (n,).

    The joints are in the order of the robot; a joint may have no actuator, or several.
    """
    joints = _list_joint_ids(published, robot).tolist()
    return np.array(
        [m for joint in joints for m in list_joint_actuators(published.model, joint)],
        dtype=np.int64,
    )


def _list_servo_causes(published: PublishedModel, robot: Robot) -> Iterator[CauseCandidate]:
    """Yield servo biases, gains unequal to the stiffness, and delays as causes of a deviation."""
    model, motors = published.model, _list_actuator_ids(published, robot)
    affine = mujoco.mjtBias.mjBIAS_AFFINE.value
    served = motors[model.actuator_biastype[motors] == affine]
    gain, stiffness = model.actuator_gainprm[served, 0], -model.actuator_biasprm[served, 1]
    biased = served[model.actuator_biasprm[served, 0] != 0]
    uneven = served[(stiffness > 0) & (stiffness != gain) & (gain > 0)]
    delayed = model.actuator_delay[motors] > 0
    named = {code: _name_actuators(model, which) for code, which in (
        ("bias", biased), ("gain", uneven), ("delay", motors[delayed])
    )}  # fmt: skip
    stiffnesses = -model.actuator_biasprm[uneven, 1]
    yield from _yield_if_any("bias", named["bias"], "actuator_biasprm", (biased, 0))
    yield from _yield_if_any("gain", named["gain"], "actuator_gainprm", (uneven, 0), stiffnesses)
    yield from _yield_if_any("delay", named["delay"], "actuator_delay", motors[delayed])


def _list_flag_causes(model: mujoco.MjModel) -> Iterator[CauseCandidate]:
    """Yield the option flags that disable contacts, constraints or motors as a candidate cause."""
    flags = model.opt.disableflags
    named = [(bit.value, word) for bit, word in SUPPORT_FLAGS if flags & bit.value]
    elements = tuple(f'flag {word}="disable"' for _, word in named)
    enabled = flags & ~sum(bit for bit, _ in named)
    yield from _yield_if_any("flag", elements, "disableflags", None, enabled)


def _list_sign_causes(published: PublishedModel, robot: Robot) -> Iterator[CauseCandidate]:
    """Yield the actuators with a negative gear at the robot's joints as a candidate cause."""
    model = published.model
    negative = [
        m for m in _list_actuator_ids(published, robot).tolist() if actuator_gear(model, m)[0] < 0
    ]
    outputs = model.actuator_outadr[negative]
    positive_gears = -model.actuator_gear[outputs, 0]
    named = _name_actuators(model, negative)
    yield from _yield_if_any("gear", named, "actuator_gear", (outputs, 0), positive_gears)


def _list_force_causes(published: PublishedModel, robot: Robot) -> Iterator[CauseCandidate]:
    """Yield springs, joint limits, fluid forces and tilted gravity as candidate causes."""
    model, joints = published.model, _list_joint_ids(published, robot)
    linear, higher = "jnt_stiffness tendon_stiffness", "jnt_stiffnesspoly tendon_stiffnesspoly"
    sprung = [
        _list_element_names(model, kind, np.flatnonzero((stiff != 0) | poly.any(axis=1)))
        for kind, stiff, poly in (
            (_OBJECT_TYPE.mjOBJ_JOINT, model.jnt_stiffness, model.jnt_stiffnesspoly),
            (_OBJECT_TYPE.mjOBJ_TENDON, model.tendon_stiffness, model.tendon_stiffnesspoly),
        )
    ]
    yield from _yield_if_any("spring", (*sprung[0], *sprung[1]), f"{linear} {higher}", slice(None))
    limited = joints[model.jnt_limited[joints] != 0]
    yield from _yield_if_any(
        "range",
        _list_element_names(model, _OBJECT_TYPE.mjOBJ_JOINT, limited),
        "jnt_limited",
        limited,
    )
    if model.opt.density or model.opt.viscosity:
        parts = [f"density {model.opt.density:g} kg/m^3", f"viscosity {model.opt.viscosity:g} Pa s"]
        if model.opt.wind.any():
            parts.append(f"wind ({', '.join(f'{speed:g}' for speed in model.opt.wind)}) m/s")
        yield CauseCandidate("fluid", tuple(parts), _make_switch(("density viscosity", None, 0.0)))
    if model.opt.gravity[:2].any():
        down = 0.0, 0.0, -np.linalg.norm(model.opt.gravity)
        stated = ", ".join(f"{part:g}" for part in model.opt.gravity)
        upright = _make_switch(("opt.gravity", slice(None), down))
        yield CauseCandidate("gravity", (f"({stated}) m/s^2",), upright)


STIFFNESS_FACTOR = 4.0
"""Factor [1] on the stiffness and damping of servos in a test simulation, and in the gains that a
report proposes. If the robot stands with the increased values, servos that are too soft are the
cause of the failure. Chosen, not tuned."""


def list_soft_servos(published: PublishedModel, robot: Robot) -> Iterator[CauseCandidate]:
    """Yield the position servos as a single candidate cause of a fall: servos that are too soft.

    Switching the candidate off multiplies stiffness and damping of the servos by
    `STIFFNESS_FACTOR`.
    """
    model, motors = published.model, _list_actuator_ids(published, robot)
    affine = model.actuator_biastype[motors] == mujoco.mjtBias.mjBIAS_AFFINE.value
    fixed = model.actuator_gaintype[motors] == mujoco.mjtGain.mjGAIN_FIXED.value
    soft = motors[affine & fixed & (model.actuator_biasprm[motors, 1] < 0)]
    if soft.size:
        gain, bias = model.actuator_gainprm[soft, 0], model.actuator_biasprm[soft]
        stiffer = _make_switch(
            ("actuator_gainprm", (soft, 0), STIFFNESS_FACTOR * gain),
            ("actuator_biasprm", soft, STIFFNESS_FACTOR * bias),
        )
        yield CauseCandidate("soft-servos", _name_actuators(model, soft), stiffer)


_MIN_FRICTION = 0.3
"""Lower bound of the sliding friction coefficient [1]. A contact with a lower coefficient is tested
as the cause of a fall, or of a deviation from the predicted equilibrium. The value may be a mistake
of the file. Chosen, not tuned.
"""

_SOUND_FRICTION = 0.8
"""Sliding friction coefficient that replaces the coefficient of slippery contacts in a test
simulation. Chosen, not tuned."""

_MAX_CONTACT_TIME_CONSTANT = 0.05
"""Upper bound of the time constant of a contact (``solref``) [s]. A contact with a longer time
constant is tested as the cause of a fall, or of a deviation from the predicted equilibrium. The
contact may be too soft by mistake. MuJoCo's default is 0.02 s. Chosen, not tuned."""

_DEFAULT_SOLREF = (0.02, 1.0)
"""MuJoCo's default ``solref`` (time constant [s], damping ratio), which replaces the ``solref`` of
soft contacts in a test simulation."""


def _list_contact_causes(published: PublishedModel) -> Iterator[CauseCandidate]:
    """Yield slippery and soft contacts as candidate causes of a failed simulation."""
    model = published.model
    collidable = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    slippery_geoms = np.flatnonzero(_select_bad_contacts(model, "geom", "slippery") & collidable)
    slippery_pairs = np.flatnonzero(_select_bad_contacts(model, "pair", "slippery"))
    soft_geoms = np.flatnonzero(_select_bad_contacts(model, "geom", "soft") & collidable)
    soft_pairs = np.flatnonzero(_select_bad_contacts(model, "pair", "soft"))
    friction = (
        ("geom_friction", (slippery_geoms, 0), _SOUND_FRICTION),
        ("pair_friction", (slippery_pairs, slice(2)), _SOUND_FRICTION),
    )
    stiffness = (
        ("geom_solref", soft_geoms, _DEFAULT_SOLREF),
        ("pair_solref", soft_pairs, _DEFAULT_SOLREF),
    )
    for code, geoms, pairs, sound in (
        ("slippery", slippery_geoms, slippery_pairs, friction),
        ("soft", soft_geoms, soft_pairs, stiffness),
    ):
        if len(geoms) or len(pairs):
            shapes = dict.fromkeys(_name_shape(model, geom) for geom in geoms.tolist())
            yield CauseCandidate(code, (*shapes, *_name_pairs(model, pairs)), _make_switch(*sound))


def _select_bad_contacts(model: mujoco.MjModel, of: str, code: str) -> NDArray[np.bool_]:
    """Return the mask, shape (n,), of the geoms or contact pairs that are slippery or soft.

    ``of`` is ``"geom"`` or ``"pair"``. ``code`` is ``"slippery"`` (sliding friction below
    `_MIN_FRICTION`) or ``"soft"`` (time constant above `_MAX_CONTACT_TIME_CONSTANT`).
    """
    if code == "slippery":
        return np.asarray(getattr(model, f"{of}_friction")[:, 0] < _MIN_FRICTION)
    return np.asarray(getattr(model, f"{of}_solref")[:, 0] > _MAX_CONTACT_TIME_CONSTANT)


def _name_shape(model: mujoco.MjModel, geom: int) -> str:
    """Return the name of a geom; without a name, the name of the body."""
    named = mujoco.mj_id2name(model, _OBJECT_TYPE.mjOBJ_GEOM, geom)
    return named or _get_element_name(model, _OBJECT_TYPE.mjOBJ_BODY, int(model.geom_bodyid[geom]))


def _name_pairs(model: mujoco.MjModel, pairs: NDArray[np.intp]) -> tuple[str, ...]:
    """Return "A and B", with the names of both geoms, for each of the contact ``pairs`` (ids)."""
    both = np.column_stack([model.pair_geom1, model.pair_geom2])[pairs]
    return tuple(
        " and ".join(_list_element_names(model, _OBJECT_TYPE.mjOBJ_GEOM, ends)) for ends in both
    )


def _list_exclude_causes(model: mujoco.MjModel) -> Iterator[CauseCandidate]:
    """Yield the exclusions of contacts with bodies that are fixed to the world, as causes."""
    fixed = {0, *np.flatnonzero(model.body_weldid == 0).tolist()}
    for number in range(model.nexclude):
        pair = divmod(int(model.exclude_signature[number]), 1 << 16)
        if fixed & set(pair):
            names = " and ".join(_list_element_names(model, _OBJECT_TYPE.mjOBJ_BODY, pair))
            yield from _yield_if_any(
                "exclude", (names,), "exclude_signature", number
            )  # signature 0 excludes contacts of the world with itself, which has no effect


def _list_option_causes(model: mujoco.MjModel) -> Iterator[CauseCandidate]:
    """Yield contact flag ``override`` and disabled actuator groups as candidate causes."""
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
        yield from _yield_if_any(code, (element,) if acts else (), field, None, value)


TIE_CODES = ("weld", "connect", "tendon")
"""Codes (`Cause.code`) of elements that tie the robot to the world or to a mocap body."""


def list_ties(model: mujoco.MjModel) -> Iterator[CauseCandidate]:
    """Yield elements of a published model that tie a body to the world or to a mocap body.

    These are initially active welds and connects, and spatial tendons with an active equality or a
    limited length.
    """
    kinds = {mujoco.mjtEq.mjEQ_WELD.value: "weld", mujoco.mjtEq.mjEQ_CONNECT.value: "connect"}
    for number in np.flatnonzero(np.isin(model.eq_type, list(kinds)) & model.eq_active0).tolist():
        ends = [int(model.eq_obj1id[number]), int(model.eq_obj2id[number])]
        if model.eq_objtype[number] == _OBJECT_TYPE.mjOBJ_SITE.value:
            ends = [int(model.site_bodyid[end]) for end in ends]
        if _reach_the_world(model, ends):
            name = mujoco.mj_id2name(model, _OBJECT_TYPE.mjOBJ_EQUALITY, number)
            both = _name_bodies(_list_element_names(model, _OBJECT_TYPE.mjOBJ_BODY, ends))
            kind = kinds[int(model.eq_type[number])]
            yield from _yield_if_any(kind, (name or both,), "eq_active0", number)
    for tendon in range(model.ntendon):
        first = int(model.tendon_adr[tendon])
        path = range(first, first + int(model.tendon_num[tendon]))
        ends = [body for wrap in path for body in _find_wrap_bodies(model, wrap)]
        equalities = np.flatnonzero(
            (model.eq_type == mujoco.mjtEq.mjEQ_TENDON.value)
            & model.eq_active0
            & ((model.eq_obj1id == tendon) | (model.eq_obj2id == tendon))
        )
        if _reach_the_world(model, ends) and (equalities.size or model.tendon_limited[tendon]):
            name = _list_element_names(model, _OBJECT_TYPE.mjOBJ_TENDON, [tendon])
            yield CauseCandidate(
                "tendon",
                tuple(name),
                _make_switch(("eq_active0", equalities, 0), ("tendon_limited", tendon, 0)),
            )


def list_restraining_ties(model: mujoco.MjModel, robot: Robot) -> list[CauseCandidate]:
    """List the ties of a robot with a fixed base (`list_ties`) that restrain driven joints.

    A loop that the base closes, such as a four-bar linkage, is omitted: its constraint determines
    only dependent joints. A tendon that is only limited is omitted, because a limit is no
    constraint of the closure.

    Args:
        model: Published model: the user's file as compiled.
        robot: Prepared robot.
    """
    restraining = {
        tie.elements for tie in list_ties(robot.mj_model) if _restrains_driven_joints(tie, robot)
    }
    return [tie for tie in list_ties(model) if tie.elements in restraining]


def _restrains_driven_joints(tie: CauseCandidate, robot: Robot) -> bool:
    """Return True if driven joints of a robot can move in more ways without a tie."""
    untied = copy.copy(robot.mj_model)
    tie.switch_off(untied)
    remaining = find_closure(untied, robot.mj_convention, robot.joint_names)
    restrained, restrained_untied = (
        0 if closure is None else closure.num_restrained_motions
        for closure in (robot.closure, remaining)
    )
    return restrained > restrained_untied


def _reach_the_world(model: mujoco.MjModel, bodies: list[int]) -> bool:
    """Return True if some, but not all, bodies are fixed to the world or to mocap bodies."""
    roots = model.body_weldid[bodies]
    held = (roots == 0) | (model.body_mocapid[roots] >= 0)
    return bool(held.any() and not held.all())


def _find_wrap_bodies(model: mujoco.MjModel, wrap: int) -> list[int]:
    """Return the body of a site or geom on the path of a spatial tendon; empty for other items."""
    kind, item = int(model.wrap_type[wrap]), int(model.wrap_objid[wrap])
    if kind == mujoco.mjtWrap.mjWRAP_SITE.value:
        return [int(model.site_bodyid[item])]
    geoms = (mujoco.mjtWrap.mjWRAP_SPHERE.value, mujoco.mjtWrap.mjWRAP_CYLINDER.value)
    return [int(model.geom_bodyid[item])] if kind in geoms else []


def _list_limit_causes(published: PublishedModel, robot: Robot) -> Iterator[CauseCandidate]:
    """Yield limits of servo commands and forces as candidate causes of a failed simulation."""
    model, joints, motors = (
        published.model,
        _list_joint_ids(published, robot),
        _list_actuator_ids(published, robot),
    )
    controls = model.actuator_ctrladr[motors]
    cut = model.actuator_ctrllimited[controls] != 0
    ranged = _name_actuators(model, motors[cut])
    yield from _yield_if_any("ctrlrange", ranged, "actuator_ctrllimited", controls[cut])
    forced = motors[model.actuator_forcelimited[motors] != 0]
    named = _name_actuators(model, forced)
    yield from _yield_if_any("forcerange", named, "actuator_forcelimited", forced)
    clamped = joints[model.jnt_actfrclimited[joints] != 0]
    named = _list_element_names(model, _OBJECT_TYPE.mjOBJ_JOINT, clamped)
    yield from _yield_if_any("actuatorfrcrange", named, "jnt_actfrclimited", clamped)


def _list_actuator_causes(published: PublishedModel) -> Iterator[CauseCandidate]:
    """Yield actuators that act on no single hinge or slide, and slow filters, as candidate causes.

    The first kind excludes servos at tendons that hold joints without actuator.
    """
    model = published.model
    commanded = {
        servo
        for joint in scalar_joints(model).tolist()
        if classify_joint_drive(model, joint) is Drive.TENDON
        for servo in list_tendon_servos(model, joint)
    }
    uncommanded = [
        actuator for actuator in list_uncommanded_actuators(model) if actuator not in commanded
    ]
    named = _list_element_names(model, _OBJECT_TYPE.mjOBJ_ACTUATOR, uncommanded)
    yield from _yield_if_any(
        "motors-elsewhere", named, "actuator_gainprm actuator_biasprm", uncommanded
    )
    filtered = np.isin(model.actuator_dyntype, FILTER_DYNAMICS)
    slow = np.flatnonzero(filtered & (model.actuator_dynprm[:, 0] > MAX_SETTLED_TIME_CONSTANT))
    named = _name_actuators(model, slow)
    yield from _yield_if_any(
        "timeconst", named, "actuator_dynprm", (slow, 0), MAX_SETTLED_TIME_CONSTANT
    )


def _list_passive_causes(published: PublishedModel, robot: Robot) -> Iterator[CauseCandidate]:
    """Yield joints of the file that the prepared robot lacks, as candidate causes of a deviation.

    To test a candidate, its joints are locked by damping.
    """
    model, unmatched = published.model, list_unmatched_joints(published, robot)
    balls = [joint for joint in unmatched if model.jnt_type[joint] == JointKind.BALL]
    loose = [joint for joint in unmatched if joint not in balls]
    for code, joints, size, damping in (
        ("loose-joints", loose, 1, _LOCKING_DAMPING),
        ("ball-joints", balls, 3, _LOCKING_BALL_DAMPING),
    ):
        named = _list_element_names(model, _OBJECT_TYPE.mjOBJ_JOINT, joints)
        dofs = [int(model.jnt_dofadr[joint]) + axis for joint in joints for axis in range(size)]
        yield from _yield_if_any(code, named, "dof_damping", dofs, damping)


def _list_shape_causes(published: PublishedModel, robot: Robot) -> Iterator[CauseCandidate]:
    """Yield shapes with disabled contacts, and obstacles, as candidate causes of a deviation.

    The preparation disabled the contacts. An obstacle is a collidable shape, other than a plane,
    that is fixed to the world or to a mocap body.
    """
    model = published.model
    collidable = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    replaced = {model.body(name).id for name in _list_ball_bodies(robot)}
    # The geoms of a URDF's import differ from the robot's, which include visual geoms.
    has_same_geoms = robot.published is None or robot.published.imported is None
    untouched = _list_disabled_geoms(published, robot) if has_same_geoms else []
    disabled = [geom for geom in untouched if model.geom_bodyid[geom] not in replaced]
    by_hand = model.body_mocapid[model.body_weldid[model.geom_bodyid]] >= 0
    fixed = ((model.body_weldid[model.geom_bodyid] == 0) | by_hand) & collidable
    plane = model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE.value
    obstacles = np.flatnonzero(fixed & ~plane).tolist()
    for code, geoms in (("shapes-beside-feet", disabled), ("obstacles", obstacles)):
        bodies = tuple(dict.fromkeys(_name_shape(model, geom) for geom in geoms))
        yield from _yield_if_any(code, bodies, "geom_contype geom_conaffinity", geoms)


def _list_disabled_geoms(published: PublishedModel, robot: Robot) -> list[int]:
    """Return the ids of published geoms that can collide, but whose counterparts cannot.

    The counterpart of a geom has the same index on the body of the same name in the prepared robot.
    """
    model, robot_model = published.model, robot.compute_once(compile_with_visuals)
    geoms = []
    for body in range(1, model.nbody):
        robot_body = mujoco.mj_name2id(
            robot_model,
            _OBJECT_TYPE.mjOBJ_BODY,
            mujoco.mj_id2name(model, _OBJECT_TYPE.mjOBJ_BODY, body) or "",
        )
        if robot_body < 0:
            continue
        first, robot_first = (
            int(model.body_geomadr[body]),
            int(robot_model.body_geomadr[robot_body]),
        )
        count = min(int(model.body_geomnum[body]), int(robot_model.body_geomnum[robot_body]))
        for index in range(count):
            geom, robot_geom = first + index, robot_first + index
            touches = model.geom_contype[geom] or model.geom_conaffinity[geom]
            if touches and not (
                robot_model.geom_contype[robot_geom] or robot_model.geom_conaffinity[robot_geom]
            ):
                geoms.append(geom)
    return geoms


def _list_overlap_causes(published: PublishedModel, robot: Robot) -> Iterator[CauseCandidate]:
    """Yield contacts of bodies that overlap in the start pose, which the preparation excluded.

    Each element is a pair of bodies with its depth, the deepest first. Switching the cause off
    disables all contacts of a body of each pair: not of a body with a foot, which touches the
    ground.
    """
    excluded = [
        addition for addition in robot.description.added if isinstance(addition, ContactExclusion)
    ]
    model, weld = published.model, robot.mj_model.body_weldid
    foot_bodies = {int(weld[body]) for body, _ in robot.contact_places.values()}
    feet = {robot.mj_model.body(body).name for body in foot_bodies}
    depths = {
        bodies: depth
        for exclusion in excluded
        for bodies, depth in _list_overlap_depths(exclusion.reason)
    }
    switched = {second if first in feet else first for first, second in depths} - feet
    bodies = [model.body(name).id for name in sorted(switched & _list_body_names(model))]
    elements = tuple(
        f"{first}/{second} {format_number(1e3 * depth, '.3g')} mm"
        for (first, second), depth in sorted(depths.items(), key=lambda item: -item[1])
    )
    geoms = np.flatnonzero(np.isin(model.geom_bodyid, bodies))
    if geoms.size:
        yield from _yield_if_any("overlaps", elements, "geom_contype geom_conaffinity", geoms)


def _list_overlap_depths(reason: Diagnostic) -> Iterator[tuple[tuple[str, str], float]]:
    """Yield the pairs of bodies, and their depths [m], in the message about overlapping bodies."""
    pairs = reason.values["pairs"]
    for pair in pairs if isinstance(pairs, tuple) else ():
        depth = pair.values["depth"] if isinstance(pair, Diagnostic) else None
        if isinstance(pair, Diagnostic) and isinstance(depth, Quantity):
            yield (str(pair.values["one"]), str(pair.values["two"])), depth.value


def _list_body_names(model: mujoco.MjModel) -> set[str]:
    """Return the names of the bodies of a model."""
    return {model.body(body).name for body in range(model.nbody)}


def _list_ball_bodies(robot: Robot) -> tuple[str, ...]:
    """Return the names of the bodies whose collision shapes the preparation replaced by balls."""
    balls = (addition.body for addition in robot.description.added if isinstance(addition, Ball))
    return tuple(dict.fromkeys(balls))


def list_loading_changes(published: PublishedModel, robot: Robot) -> tuple[Cause, ...]:
    """List changes by the preparation that may explain a deviation from the published model.

    Unlike a `CauseCandidate`, such a change cannot be switched off in the published model. Examples
    are bodies whose collision shapes were replaced by spheres.
    """
    bodies = _list_ball_bodies(robot)
    named = zip(robot.joint_names, published.drives, strict=True)
    joints = tuple(name for name, drive in named if drive.has_other_law)
    return (
        *((Cause("balls", bodies),) if bodies else ()),
        *((Cause("other-drive", joints),) if joints else ()),
    )
