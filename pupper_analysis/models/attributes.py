"""The numbers of joints and of what touches: what each is called in the files and in the engines.

Reading, audit, comparison, `sync` and conversion go through this one table;
`docs/explanation/architecture.md` shows how to add a row.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from mujoco import MjModel


@dataclass(frozen=True)
class JointAttribute:
    """A number of a hinge or a slide.

    Attributes:
        kind: What a difference in it is called; a term of the catalogue.
        field: The attribute of `multibody.TreeJoint`; "" of what no tree of joints has.
        units: Its unit for a hinge, and for a slide.
        tolerance: Of `Tolerances`.
        relative: Whether the tolerance is relative.
        felt: Whether forward dynamics depend on it.
        unstated: What it is where a file does not state it.
        urdf: The element below ``<joint>`` and its attribute; None where a URDF has no words.
        mjcf: The attributes of an MJCF's joint, or its actuators, any of which states it, its own
            first; none where an MJCF has no words.
        pinocchio: The vector of Pinocchio's model, one entry per velocity; "" if there is none.
        mujoco: The array of MuJoCo's model, one entry per velocity; "" if there is none.
        of_joints: The one with an entry per joint, of what has none per velocity.
        resists: Whether it resists motion, whatever a motor does.
        signed: Whether it can be negative.
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
        """Returns its unit, of a joint that slides or turns."""
        return self.units[slides]

    def compiled(self, model: MjModel, joint: int) -> float:
        """Returns what MuJoCo makes of it at a joint (its id), which it has an array for."""
        if self.mujoco:
            return float(getattr(model, self.mujoco)[model.jnt_dofadr[joint]])
        return float(getattr(model, self.of_joints)[joint])

    @property
    def in_both(self) -> bool:
        """Whether both formats can state it."""
        return self.urdf is not None and bool(self.mjcf)


_ANGLE, _FORCE = ("rad", "m"), ("N m", "N")

JOINT_ATTRIBUTES: Final = (
    JointAttribute(
        "lower limit",
        "lower",
        _ANGLE,
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
        _ANGLE,
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
        _FORCE,
        "effort",
        unstated=math.inf,
        urdf=("limit", "effort"),
        mjcf=("forcerange", "actuatorfrcrange", "ctrlrange"),
        pinocchio="effortLimit",
    ),
    JointAttribute(
        "velocity",
        "velocity",
        ("rad/s", "m/s"),
        "velocity",
        unstated=math.inf,
        urdf=("limit", "velocity"),
        pinocchio="velocityLimit",
    ),
    JointAttribute(
        "damping",
        "damping",
        ("N m s/rad", "N s/m"),
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
        _FORCE,
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
        ("kg m^2", "kg"),
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
        ("N m/rad", "N/m"),
        "dynamics",
        felt=True,
        mjcf=("stiffness", "springdamper"),
        of_joints="jnt_stiffness",
        resists=True,
    ),
)
"""All of them, in the order in which they are compared."""

BY_KIND: Final[Mapping[str, JointAttribute]] = MappingProxyType(
    {attribute.kind: attribute for attribute in JOINT_ATTRIBUTES}
)
"""{kind: attribute}."""

BY_MJCF: Final[Mapping[str, JointAttribute]] = MappingProxyType(
    {word: attribute for attribute in JOINT_ATTRIBUTES for word in attribute.mjcf}
)
"""{an MJCF's word: the attribute}; both ends of a ``range`` have one word, and the upper counts."""

IN_A_TREE: Final = tuple(attribute for attribute in JOINT_ATTRIBUTES if attribute.field)
"""What a tree of joints has, as `parameters` states it."""

PASSIVE: Final = tuple(attribute for attribute in JOINT_ATTRIBUTES if attribute.resists)
"""What resists a joint's motion, whatever its motor does."""

COMPILED: Final = tuple(one for one in JOINT_ATTRIBUTES if one.mujoco or one.of_joints)
"""What MuJoCo has an array for: an MJCF's joint states it by a word of that attribute."""


@dataclass(frozen=True)
class ElementAttribute:
    """A number of an MJCF that a URDF has none of, and no tree of joints.

    Attributes:
        element: Its element's tag, or section: ``geom``, ``pair``, ``option``, ``key``, ``joint``,
            ``actuator``, ``tendon`` or ``equality``.
        word: The element's attribute; a change is called so, too.
        mujoco: MuJoCo's array, with a row for each element, or for each velocity of a joint
            (``dof_``); of an option the attribute of ``opt``.
        unit: Of its numbers, where they have one in common.
    """

    element: str
    word: str
    mujoco: str
    unit: str = ""


_CONTACT: Final = ("solref", "solimp", "margin", "gap")
_UNITS: Final = {"margin": "m", "gap": "m", "timestep": "s", "gravity": "m/s^2"}
_OF_GEOMS: Final = (
    "friction", "condim", *_CONTACT, "contype", "conaffinity", "priority", "solmix", "adhesion",
    "surfacevel",
)  # fmt: skip
_OF_PAIRS: Final = ("friction", "solreffriction", *_CONTACT, "adhesion")
_OF_OPTIONS: Final = (
    "timestep", "integrator", "cone", "solver", "jacobian", "impratio", "iterations", "tolerance",
    "ls_iterations", "ls_tolerance", "noslip_iterations", "noslip_tolerance", "ccd_iterations",
    "ccd_tolerance", "sdf_initpoints", "sdf_iterations", "sleep_tolerance", "magnetic", "o_margin",
    "o_solref", "o_solimp", "o_friction", "disableactuator",
)  # fmt: skip
_OF_KEYS: Final = ("qpos", "qvel", "act", "ctrl", "mpos", "mquat", "plastic", "time")

_LIMITS: Final = ("solreflimit", "solimplimit", "solreffriction", "solimpfriction", "margin")
_OF_CONSTRAINTS: Final = {
    "joint": zip(
        (*_LIMITS, "actuatorgravcomp"),
        ("jnt_solref", "jnt_solimp", "dof_solref", "dof_solimp", "jnt_margin", "jnt_actgravcomp"),
        strict=True,
    ),
    "tendon": zip(
        (*_LIMITS, "actuatorfrcrange"),
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

ELEMENT_ATTRIBUTES: Final = (
    *(ElementAttribute("geom", word, f"geom_{word}", _UNITS.get(word, "")) for word in _OF_GEOMS),
    ElementAttribute("pair", "condim", "pair_dim"),
    *(ElementAttribute("pair", word, f"pair_{word}", _UNITS.get(word, "")) for word in _OF_PAIRS),
    *(ElementAttribute("option", word, word, _UNITS.get(word, "")) for word in _OF_OPTIONS),
    *(ElementAttribute("key", word, f"key_{word}") for word in _OF_KEYS),
    *(ElementAttribute(kind, *both) for kind, rows in _OF_CONSTRAINTS.items() for both in rows),
)
"""What decides how a robot touches the world, how MuJoCo steps, where it begins, how stiff limits
and loops are, and what motors do between command and force.

Gravity and the medium are compared with what acts on the robot; shapes and flags are described by
`robot_model.elements`."""

# Names and numbers of what an MJCF is given, in memory or in a new file.

Number = float | str
"""A number, or as it is written in another file."""

FLOOR: Final = "floor"
"""What a floor that is added, and its material, are called."""

HOME: Final = "home"
"""What the keyframe to start from is called."""

COUPLING_TIME: Final = 5e-3
"""Time constant of couplings (s): MuJoCo's own, 20 ms, lets fingers of grammes open far."""

IMU_SENSORS: Final = ("gyro", "accelerometer")
"""The sensors of an IMU: their elements in an MJCF, and what they are called."""
