"""What a robot is given that its files do not have, before it is simulated: entry by entry.

A floor, how contacts hold, balls for round meshes, servos, a start pose. Each entry says why it is
there, and is put into MuJoCo's editable model in memory, or into a new file, by the same verb: what
is simulated is what is written.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from typing import ClassVar, Final

from pupper_analysis.base.diagnostics import Diagnostic
from pupper_analysis.models.attributes import Number

GRIP: Final[Mapping[str, Number]] = {"cone": "elliptic", "impratio": 100.0}
"""How contacts hold: friction a hundred times as stiff as the ground, on a cone that is round. With
MuJoCo's defaults (a pyramid, 1) feet creep: Go2 by 58 mm/s on a slope of 17 degrees, so by 0.35; a
pyramid with an impratio of 10 shakes. The models of MuJoCo Menagerie have the same."""


@dataclass(frozen=True)
class Addition:
    """Something that is added, by a verb that an MJCF has in memory (`SpecTree`) and as a new file.

    Attributes:
        verb: Of its kind: what is called with all that an addition says but for its reason.
        reason: Why, as it is reported.
    """

    verb: ClassVar[str]

    reason: Diagnostic

    def put(self, model: object) -> None:
        """Puts it into a model."""
        getattr(model, self.verb)(*(getattr(self, one.name) for one in fields(self)[1:]))


@dataclass(frozen=True)
class Floor(Addition):
    """A plane at z = 0 with MuJoCo's own contact."""

    verb = "add_floor"


@dataclass(frozen=True)
class Options(Addition):
    """How MuJoCo solves and steps.

    Attributes:
        values: {attribute of ``<option>``: its value}.
    """

    verb = "set_options"

    values: Mapping[str, Number]


@dataclass(frozen=True)
class Ball(Addition):
    """A sphere that touches in a mesh's place.

    Attributes:
        name: The geom's.
        body: What it belongs to.
        radius: m.
        place: (3,) in the body's frame (m).
        like: The geom whose contact parameters it has; None: MuJoCo's own.
    """

    verb = "add_ball"

    name: str
    body: str
    radius: float
    place: tuple[float, ...]
    like: str | None


@dataclass(frozen=True)
class Untouching(Addition):
    """Shapes that are left out of contact.

    Attributes:
        geoms: Their names.
    """

    verb = "turn_off_contact"

    geoms: tuple[str, ...]


@dataclass(frozen=True)
class Apart(Addition):
    """Two bodies that do not touch each other.

    Attributes:
        one: A body.
        two: The other one.
    """

    verb = "exclude_contact"

    one: str
    two: str


@dataclass(frozen=True)
class Servo(Addition):
    """A position servo.

    Attributes:
        joint: What it drives.
        kp: N m/rad, N/m.
        kd: N m s/rad, N s/m.
        limits: The least and the greatest that it can give (N m, N); None: any.
    """

    verb = "add_position_servo"

    joint: str
    kp: float
    kd: float
    limits: tuple[float, float] | None


@dataclass(frozen=True)
class Start(Addition):
    """The pose to start from, as the robot rests in it.

    Attributes:
        qpos: (nq,) of MuJoCo's model (m, rad).
        ctrl: (nu,) what its servos are commanded there, in their order; empty: nothing is.
    """

    verb = "set_home"

    qpos: tuple[float, ...]
    ctrl: tuple[float, ...] = ()


def put_all(added: Iterable[Addition], model: object) -> None:
    """Puts things into a model (`SpecTree`, or a new file), in their order."""
    for each in added:
        each.put(model)
