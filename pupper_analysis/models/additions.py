"""Additions to a robot for simulation: floor, options, contacts, spheres, servos, start pose.

Each addition has a reason, and the name and arguments of a method. This method of the editable
MuJoCo spec (`SpecTree`) and the same method of the new MJCF file are called. The simulated model
and the written file therefore agree.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from typing import ClassVar, Final

from pupper_analysis.base.diagnostics import Diagnostic
from pupper_analysis.models.attributes import AttributeValue

STIFF_FRICTION_OPTIONS: Final[Mapping[str, AttributeValue]] = {
    "cone": "elliptic",
    "impratio": 100.0,
}
"""MuJoCo options for contacts with little creep: elliptic cone, friction 100 times as stiff as the
normal direction, as in models of MuJoCo Menagerie. With MuJoCo's defaults (pyramidal cone, impratio
1), feet creep faster: on Go2 on a slope of 17 degrees, 58 mm/s instead of 0.35 mm/s (measured)."""


@dataclass(frozen=True)
class Addition:
    """Element that is added to a model for simulation, such as a floor, with the reason.

    Attributes:
        verb: Name of the method of `SpecTree`, or of a new MJCF file, that adds the element. Its
            arguments are the fields of the addition except the reason.
        reason: Reported reason.
    """

    verb: ClassVar[str]

    reason: Diagnostic

    def apply_to(self, model: object) -> None:
        """Apply this addition: call the method ``verb`` of a model, such as ``add_floor``.

        The arguments are the fields of the addition except ``reason``.

        Args:
            model: `SpecTree`, or a new MJCF file; modified.
        """
        getattr(model, self.verb)(*(getattr(self, argument.name) for argument in fields(self)[1:]))


@dataclass(frozen=True)
class Floor(Addition):
    """Floor: plane (`add_plane`) with MuJoCo's default contact parameters except ``conaffinity``.

    Its contact bits permit collisions with each geom whose ``contype`` is not 0.
    """

    verb = "add_floor"


@dataclass(frozen=True)
class Options(Addition):
    """MuJoCo options that are set in a model.

    Attributes:
        values: {attribute of ``<option>``: value}.
    """

    verb = "set_options"

    values: Mapping[str, AttributeValue]


@dataclass(frozen=True)
class Ball(Addition):
    """Collision sphere of a contact point, for a foot with a mesh or for a hand.

    Attributes:
        name: Name of the geom.
        body: Body of the geom.
        radius: Radius [m].
        place: Centre (3,) [m] in the frame of the body.
        like: Geom whose contact parameters are copied; None for the defaults of the model.
    """

    verb = "add_ball"

    name: str
    body: str
    radius: float
    place: tuple[float, ...]
    like: str | None


@dataclass(frozen=True)
class DisabledContacts(Addition):
    """Contacts of geoms are disabled by zero contact bits.

    Attributes:
        geoms: Names of the geoms.
    """

    verb = "turn_off_contact"

    geoms: tuple[str, ...]


@dataclass(frozen=True)
class ContactExclusion(Addition):
    """Contacts between two bodies are excluded (``<exclude>``).

    Attributes:
        one: First body.
        two: Second body.
    """

    verb = "exclude_contact"

    one: str
    two: str


@dataclass(frozen=True)
class Servo(Addition):
    """Position servo that is added to a joint, or that replaces its actuator.

    Attributes:
        joint: Joint that the servo drives.
        kp: Stiffness [N m/rad, N/m].
        kd: Damping [N m s/rad, N s/m].
        limits: Lower and upper bound of the torque or force at the joint [N m, N]; None to keep the
            force range of the actuator, if any.
    """

    verb = "add_position_servo"

    joint: str
    kp: float
    kd: float
    limits: tuple[float, float] | None


@dataclass(frozen=True)
class StartKeyframe(Addition):
    """Keyframe ``home`` with the start pose at rest; it replaces all other keyframes of the model.

    Attributes:
        qpos: Configuration (nq,) of MuJoCo's model [m, rad].
        ctrl: Controls (nu,) in the order of the actuators; empty if none are commanded.
    """

    verb = "set_home"

    qpos: tuple[float, ...]
    ctrl: tuple[float, ...] = ()


def apply_additions(additions: Iterable[Addition], model: object) -> None:
    """Add elements, such as a floor or servos, to a model for simulation, in the given order.

    The model is a `SpecTree` or a new MJCF file.
    """
    for addition in additions:
        addition.apply_to(model)
