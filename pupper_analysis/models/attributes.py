"""Table of the joint and contact parameters: names in URDF, MJCF, Pinocchio and MuJoCo.

Reading, audit, comparison, `sync` and conversion use this table. `docs/explanation/architecture.md`
describes how to add a row.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

import numpy as np

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.units import HINGE_UNITS, SLIDE_UNITS

if TYPE_CHECKING:
    from mujoco import MjModel


@dataclass(frozen=True)
class JointAttribute:
    """Scalar parameter of a hinge or slide, such as damping, with its names in all formats.

    Attributes:
        kind: Name of the parameter in messages, also of a difference between two files; a term of
            the translation catalogue.
        field: Field of `multibody.TreeJoint` with the value; "" if there is none.
        units: Unit for a hinge, and for a slide.
        tolerance: Field of `Tolerances` with the largest accepted difference of two files.
        relative: Whether the tolerance is relative to the value; otherwise in ``units``.
        felt: Whether the forward dynamics that a comparison evaluates depend on the parameter.
            These dynamics contain neither friction loss nor limits.
        unstated: Default if a file does not specify the parameter.
        urdf: Child element of ``<joint>`` and attribute of this element; None if URDF lacks the
            parameter.
        mjcf: Attributes of a joint or actuator in an MJCF, any of which sets the parameter; the
            main attribute first. Empty if MJCF lacks the parameter.
        pinocchio: Vector (nv,) of Pinocchio's model; "" if there is none.
        mujoco: Array (nv,) of MuJoCo's model; "" if there is none.
        of_joints: Array (njnt,) of MuJoCo's model, for parameters without an array (nv,).
        resists: Whether the parameter resists motion independently of the motor.
        signed: Whether the value may be negative.
    """

    kind: str
    field: str
    units: tuple[str, str]
    tolerance: str
    relative: bool = True
    felt: bool = False
    unstated: float = 0.0
    urdf: tuple[str, str] | None = None
    mjcf: tuple[str, ...] = ()
    pinocchio: str = ""
    mujoco: str = ""
    of_joints: str = ""
    resists: bool = False
    signed: bool = False

    def unit(self, slides: bool) -> str:
        """Return the unit of the parameter for a slide (True) or a hinge (False)."""
        return self.units[slides]

    def read_compiled_value(self, model: MjModel, joint: int) -> float:
        """Read the value of this parameter for a joint of a compiled MuJoCo model.

        The parameter must be in ``COMPILED_ATTRIBUTES``. If MuJoCo stores a polynomial, the value
        is the linear coefficient.

        Args:
            model: Compiled model.
            joint: Id of a hinge or slide.

        Returns:
            Value in ``units``, for example [N m s/rad] for the damping of a hinge.
        """
        if self.mujoco:
            return float(getattr(model, self.mujoco)[model.jnt_dofadr[joint]])
        return float(getattr(model, self.of_joints)[joint])

    @property
    def is_in_both_formats(self) -> bool:
        """Whether both URDF and MJCF can specify the parameter."""
        return self.urdf is not None and bool(self.mjcf)


MIN_UNSTATED_LIMIT = 1e9
"""Value from which a limit in a file counts as unspecified: effort [N m, N], velocity [rad/s, m/s]
or the absolute value of a position [rad, m]. Reason: the ``<limit>`` of a URDF must state finite
numbers. Chosen, not tuned: the strongest motors have 1e4 N m."""


def known_limit(stated: float) -> float:
    """Return an effort or velocity limit of a URDF [N m, N; rad/s, m/s].

    Values from ``MIN_UNSTATED_LIMIT`` up mean "unspecified", and become infinite.
    """
    return math.inf if stated >= MIN_UNSTATED_LIMIT else stated


def known_limits(stated: Array) -> Array:
    """Return limits of positions, velocities or efforts; unspecified limits are infinite.

    Absolute values from ``MIN_UNSTATED_LIMIT`` up mean "unspecified"; the sign is kept.
    """
    return np.where(np.abs(stated) >= MIN_UNSTATED_LIMIT, np.copysign(np.inf, stated), stated)


def _list_units(quantity: str) -> tuple[str, str]:
    """Return the units of a quantity (field of `JointUnits`): of a hinge, and of a slide."""
    return getattr(HINGE_UNITS, quantity), getattr(SLIDE_UNITS, quantity)


JOINT_ATTRIBUTES: Final = (
    JointAttribute(
        "lower limit",
        "lower",
        _list_units("position"),
        "limit",
        relative=False,
        signed=True,
        unstated=-math.inf,
        urdf=("limit", "lower"),
        mjcf=("range",),
    ),
    JointAttribute(
        "upper limit",
        "upper",
        _list_units("position"),
        "limit",
        relative=False,
        signed=True,
        unstated=math.inf,
        urdf=("limit", "upper"),
        mjcf=("range",),
    ),
    JointAttribute(
        "effort",
        "effort",
        _list_units("effort"),
        "effort",
        unstated=math.inf,
        urdf=("limit", "effort"),
        mjcf=("forcerange", "actuatorfrcrange", "ctrlrange"),
        pinocchio="effortLimit",
    ),
    JointAttribute(
        "velocity",
        "velocity",
        _list_units("velocity"),
        "velocity",
        unstated=math.inf,
        urdf=("limit", "velocity"),
        pinocchio="velocityLimit",
    ),
    JointAttribute(
        "damping",
        "damping",
        _list_units("damping"),
        "damping",
        felt=True,
        urdf=("dynamics", "damping"),
        mjcf=("damping", "springdamper"),
        pinocchio="damping",
        mujoco="dof_damping",
        resists=True,
    ),
    JointAttribute(
        "friction",
        "friction",
        _list_units("effort"),
        "friction",
        urdf=("dynamics", "friction"),
        mjcf=("frictionloss",),
        pinocchio="friction",
        mujoco="dof_frictionloss",
        resists=True,
    ),
    JointAttribute(
        "armature",
        "armature",
        _list_units("armature"),
        "inertia",
        felt=True,
        mjcf=("armature",),
        pinocchio="armature",
        mujoco="dof_armature",
        resists=True,
    ),
    JointAttribute(
        "spring",
        "",
        _list_units("stiffness"),
        "dynamics",
        felt=True,
        mjcf=("stiffness", "springdamper"),
        of_joints="jnt_stiffness",
        resists=True,
    ),
)
"""Joint parameters that a URDF or an MJCF can specify."""

BY_KIND: Final[Mapping[str, JointAttribute]] = MappingProxyType(
    {attribute.kind: attribute for attribute in JOINT_ATTRIBUTES}
)
"""{kind, such as ``damping``: parameter of a hinge or slide}."""

BY_MJCF: Final[Mapping[str, JointAttribute]] = MappingProxyType(
    {word: attribute for attribute in JOINT_ATTRIBUTES for word in attribute.mjcf}
)
"""{attribute in an MJCF: parameter}. ``range`` sets two limits and has the upper limit as entry;
``springdamper`` sets stiffness and damping and has the stiffness (``spring``) as entry."""

TREE_ATTRIBUTES: Final = tuple(attribute for attribute in JOINT_ATTRIBUTES if attribute.field)
"""Joint parameters with a field in `multibody.TreeJoint`."""

PASSIVE_ATTRIBUTES: Final = tuple(attribute for attribute in JOINT_ATTRIBUTES if attribute.resists)
"""Joint parameters that resist motion independently of the motor, such as damping."""

COMPILED_ATTRIBUTES: Final = tuple(
    attribute for attribute in JOINT_ATTRIBUTES if attribute.mujoco or attribute.of_joints
)
"""Joint parameters with an array in MuJoCo's model, shape (nv,) or (njnt,): damping, dry friction,
armature and spring stiffness."""


@dataclass(frozen=True)
class ElementAttribute:
    """Parameter of an MJCF element, such as a geom, without counterpart in a URDF.

    Attributes:
        element: Tag or section: ``geom``, ``pair``, ``option``, ``key``, ``joint``, ``actuator``,
            ``tendon`` or ``equality``.
        word: Attribute of the element; also the name of a change of this parameter.
        mujoco: MuJoCo's array with a row per element, or per degree of freedom of a joint
            (``dof_``). For an option, the attribute of ``model.opt``.
        unit: Common unit of the values; "" if there is none.
    """

    element: str
    word: str
    mujoco: str
    unit: str = ""


_CONTACT_WORDS: Final = ("solref", "solimp", "margin", "gap")
"""Four contact parameters that are compared both of geoms and of contact pairs of an MJCF."""

_UNITS_BY_WORD: Final = {"margin": "m", "gap": "m", "timestep": "s"}
"""{compared attribute of a geom, contact pair or option in an MJCF: unit}. The values of other
attributes are reported without unit."""

_GEOM_WORDS: Final = (
    "friction", "condim", *_CONTACT_WORDS, "contype", "conaffinity", "priority", "solmix",
    "adhesion", "surfacevel",
)  # fmt: skip
"""Attributes of a geom that a comparison of two models evaluates."""

_PAIR_WORDS: Final = ("friction", "solreffriction", *_CONTACT_WORDS, "adhesion")
"""Attributes of a contact pair that a comparison of two models evaluates."""

_OPTION_WORDS: Final = (
    "timestep", "integrator", "cone", "solver", "jacobian", "impratio", "iterations", "tolerance",
    "ls_iterations", "ls_tolerance", "noslip_iterations", "noslip_tolerance", "ccd_iterations",
    "ccd_tolerance", "sdf_initpoints", "sdf_iterations", "sleep_tolerance", "magnetic", "o_margin",
    "o_solref", "o_solimp", "o_friction", "disableactuator",
)  # fmt: skip
"""Attributes of MuJoCo's options that a comparison of two models evaluates."""

_KEY_WORDS: Final = ("qpos", "qvel", "act", "ctrl", "mpos", "mquat", "plastic", "time")
"""Attributes of a keyframe that a comparison of two models evaluates."""

_LIMIT_WORDS: Final = ("solreflimit", "solimplimit", "solreffriction", "solimpfriction", "margin")
"""Attributes of a joint or tendon, for limit and friction constraints, that ``diff`` compares."""

_CONSTRAINT_WORDS: Final = {
    "joint": zip(
        (*_LIMIT_WORDS, "actuatorgravcomp"),
        ("jnt_solref", "jnt_solimp", "dof_solref", "dof_solimp", "jnt_margin", "jnt_actgravcomp"),
        strict=True,
    ),
    "tendon": zip(
        (*_LIMIT_WORDS, "actuatorfrcrange"),
        ("tendon_solref_lim", "tendon_solimp_lim", "tendon_solref_fri", "tendon_solimp_fri",
         "tendon_margin", "tendon_actfrcrange"),
        strict=True,
    ),
    "equality": (("solref", "eq_solref"), ("solimp", "eq_solimp")),
    "actuator": (
        (word, f"actuator_{word}")
        for word in ("dyntype", "dynprm", "gaintype", "biastype", "actlimited", "actrange",
                     "actearly", "delay", "history", "cranklength")
    ),
}  # fmt: skip
"""{tag or section: pairs of an attribute that is compared and its array in MuJoCo's model}. The
iterators are read once, for `ELEMENT_ATTRIBUTES`."""

ELEMENT_ATTRIBUTES: Final = (
    *(
        ElementAttribute("geom", word, f"geom_{word}", _UNITS_BY_WORD.get(word, ""))
        for word in _GEOM_WORDS
    ),
    ElementAttribute("pair", "condim", "pair_dim"),
    *(
        ElementAttribute("pair", word, f"pair_{word}", _UNITS_BY_WORD.get(word, ""))
        for word in _PAIR_WORDS
    ),
    *(
        ElementAttribute("option", word, word, _UNITS_BY_WORD.get(word, ""))
        for word in _OPTION_WORDS
    ),
    *(ElementAttribute("key", word, f"key_{word}") for word in _KEY_WORDS),
    *(ElementAttribute(kind, *both) for kind, rows in _CONSTRAINT_WORDS.items() for both in rows),
)
"""MJCF attributes that a comparison of two models evaluates: for contacts, integration, solver,
keyframes, limits, loops and actuator dynamics.

Not included are attributes that are compared elsewhere: gravity and medium (with the external
forces), shapes and flags (`robot.compare.mjcf_only`).
"""

# Names and values of additions to an MJCF, in memory or in a new file.

AttributeValue = float | str
"""Number, or text of a value as in an MJCF, such as ``elliptic``."""

FLOOR_NAME: Final = "floor"
"""Name of an added floor, and of its material and texture in a new file. A number is appended if a
geom has this name."""

HOME_KEYFRAME: Final = "home"
"""Name of the keyframe of the initial pose."""

COUPLING_TIME_CONSTANT: Final = 5e-3
"""Time constant of joint couplings in MuJoCo (``solref``) that are added or made stiff [s]; larger
if the time step requires it (`SpecTree.add_coupling`). Chosen, not tuned: with MuJoCo's default, 20
ms, fingers with a mass of grams open far."""

IMU_SENSORS: Final = ("gyro", "accelerometer")
"""Sensors of an IMU: elements in an MJCF, also used as names."""
