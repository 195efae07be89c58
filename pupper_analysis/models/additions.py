"""What a robot is given that its files do not have, before it is simulated: entry by entry.

A floor, how contacts hold, balls for round meshes, servos, a start pose. Each entry says why it is
there, and is put into MuJoCo's editable model in memory, or into a new file, by the same verb: what
is simulated is what is written.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final, Protocol

from pupper_analysis.base.diagnostics import Diagnostic
from pupper_analysis.models.attributes import Number

GRIP: Final[Mapping[str, Number]] = {"cone": "elliptic", "impratio": 100.0}
"""How contacts hold: friction a hundred times as stiff as the ground, on a cone that is round. With
MuJoCo's defaults (a pyramid, 1) feet creep: Go2 by 58 mm/s on a slope of 17 degrees, so by 0.35; a
pyramid with an impratio of 10 shakes. The models of MuJoCo Menagerie have the same."""


class Equipped(Protocol):
    """An MJCF that is given things, in memory (`SpecTree`), or a new file."""

    def add_floor(self) -> object:
        """Adds light and a plane at z = 0."""

    def set_options(self, **values: Number) -> None:
        """States attributes of ``<option>``."""

    def add_ball(
        self, name: str, body: str, radius: float, place: tuple[float, ...], like: str | None
    ) -> None:
        """Adds a sphere that touches and weighs nothing."""

    def turn_off_contact(self, geoms: tuple[str, ...]) -> None:
        """Lets geoms touch nothing."""

    def exclude_contact(self, one: str, two: str) -> None:
        """Lets two bodies not touch each other."""

    def add_position_servo(
        self, joint: str, kp: float, kd: float, limits: tuple[float, float] | None
    ) -> None:
        """Adds a position servo at a joint, of its name."""

    def set_home(self, qpos: tuple[float, ...], ctrl: tuple[float, ...]) -> None:
        """Adds the keyframe to start from."""


@dataclass(frozen=True)
class Addition(ABC):
    """Something that is added.

    Attributes:
        reason: Why, as it is reported.
    """

    reason: Diagnostic

    @abstractmethod
    def put(self, model: Equipped) -> None:
        """Puts it into a model."""


@dataclass(frozen=True)
class Floor(Addition):
    """A plane at z = 0 with MuJoCo's own contact."""

    def put(self, model: Equipped) -> None:
        """Puts it into a model."""
        model.add_floor()


@dataclass(frozen=True)
class Options(Addition):
    """How MuJoCo solves and steps.

    Attributes:
        values: {attribute of ``<option>``: its value}.
    """

    values: Mapping[str, Number]

    def put(self, model: Equipped) -> None:
        """Puts it into a model."""
        model.set_options(**self.values)


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

    name: str
    body: str
    radius: float
    place: tuple[float, ...]
    like: str | None

    def put(self, model: Equipped) -> None:
        """Puts it into a model."""
        model.add_ball(self.name, self.body, self.radius, self.place, self.like)


@dataclass(frozen=True)
class Untouching(Addition):
    """Shapes that are left out of contact.

    Attributes:
        geoms: Their names.
    """

    geoms: tuple[str, ...]

    def put(self, model: Equipped) -> None:
        """Puts it into a model."""
        model.turn_off_contact(self.geoms)


@dataclass(frozen=True)
class Apart(Addition):
    """Two bodies that do not touch each other.

    Attributes:
        one: A body.
        two: The other one.
    """

    one: str
    two: str

    def put(self, model: Equipped) -> None:
        """Puts it into a model."""
        model.exclude_contact(self.one, self.two)


@dataclass(frozen=True)
class Servo(Addition):
    """A position servo.

    Attributes:
        joint: What it drives.
        kp: N m/rad, N/m.
        kd: N m s/rad, N s/m.
        limits: The least and the greatest that it can give (N m, N); None: any.
    """

    joint: str
    kp: float
    kd: float
    limits: tuple[float, float] | None

    def put(self, model: Equipped) -> None:
        """Puts it into a model."""
        model.add_position_servo(self.joint, self.kp, self.kd, self.limits)


@dataclass(frozen=True)
class Start(Addition):
    """The pose to start from, as the robot rests in it.

    Attributes:
        qpos: (nq,) of MuJoCo's model (m, rad).
        ctrl: (nu,) what its servos are commanded there, in their order; empty: nothing is.
    """

    qpos: tuple[float, ...]
    ctrl: tuple[float, ...] = ()

    def put(self, model: Equipped) -> None:
        """Puts it into a model."""
        model.set_home(self.qpos, self.ctrl)


def put_all(added: Iterable[Addition], model: Equipped) -> None:
    """Puts things into a model, in their order."""
    for each in added:
        each.put(model)
