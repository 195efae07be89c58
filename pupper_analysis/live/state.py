"""What a page asks for, in the units of its sliders; as a text it is the page's address."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any
from urllib.parse import quote, unquote

from pupper_analysis.arguments import finite
from pupper_analysis.diagnostics import diagnose
from pupper_analysis.errors import ConfigurationError
from pupper_analysis.robot.ground import Ground
from pupper_analysis.stance.fields import FIELDS
from pupper_analysis.stance.task import StandTask

PLACES = ("centre", "inside", "offset")
"""What decides where the base is: com over the centre, com anywhere inside, or an offset."""

_NUMBERS = {
    **{"height": 1, "roll": 1, "pitch": 1, "yaw": 1, "offset": 2, "com_margin": 1},
    **{"joint_margin": 1, "ground_clearance": 1, "self_clearance": 1},
    **{"slope": 1, "uphill": 1, "payload": 1, "payload_at": 3},
    **{"leg_scale": 1, "torso_mass_scale": 1, "kp": 1, "kd": 1},
}
"""How many numbers a field has, where it has nothing else."""

_FEET = {"move": ("moves", 2), "lift": ("lifts", 1), "step": ("steps", 1)}
"""{how a text says it: (the field that has it for some feet, how many numbers each has)}."""

_PAGE = {"length": ("mm", 1e3), "angle": ("°", math.degrees(1.0))}
"""{kind of a field: unit of a page, and how many are an SI unit}."""

_LONGEST = 4000
"""Letters of a state: 50 feet's worth; a longer one is none of ours."""


@dataclass(frozen=True)
class State:
    """What a page asks for. Lengths are in mm and angles in degrees, as sliders have them.

    Attributes:
        height: Of the base (mm); the robot's ``stand_height`` by default.
        roll: deg.
        pitch: deg.
        yaw: deg.
        place: What decides where the base is: ``centre``, ``inside`` or ``offset``.
        offset: (x, y) of the base from the centre of the feet (mm), for ``offset``.
        com_margin: Of the com, inside the support polygon (mm).
        joint_margin: Of all joints, off their limits (deg).
        ground_clearance: Of all but the feet, above the ground (mm).
        self_clearance: Between links that are not neighbours (mm); 0: they are not looked at.
        moves: {foot: (x, y) off its nominal place (mm)}.
        lifts: {foot that does not carry: how high it is (mm)}.
        steps: {foot: height of the step under it (mm)}.
        slope: Of the ground (deg).
        uphill: Where it rises (deg).
        payload: Mass of a payload (kg).
        payload_at: Where it is, in the base's frame (mm).
        leg_scale: Factor on the legs' length and mass; the robot's own by default.
        torso_mass_scale: Factor on the torso's mass; the robot's own by default.
        kp: Servo stiffness of all joints (N m/rad); the model's own by default.
        kd: Servo damping of all joints (N m s/rad); the model's own by default.
    """

    height: float | None = None
    roll: float = 0.0
    pitch: float = 0.0
    yaw: float = 0.0
    place: str = "centre"
    offset: tuple[float, float] = (0.0, 0.0)
    com_margin: float = 0.0
    joint_margin: float = 0.0
    ground_clearance: float = 0.0
    self_clearance: float = 0.0
    moves: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    lifts: Mapping[str, float] = field(default_factory=dict)
    steps: Mapping[str, float] = field(default_factory=dict)
    slope: float = 0.0
    uphill: float = 0.0
    payload: float = 0.0
    payload_at: tuple[float, float, float] = (0.0, 0.0, 0.0)
    leg_scale: float | None = None
    torso_mass_scale: float | None = None
    kp: float | None = None
    kd: float | None = None

    def __post_init__(self) -> None:
        for name, count in _NUMBERS.items():
            value = getattr(self, name)
            if value is not None:
                numbers = value if count > 1 else (value,)
                checked = tuple(finite(name, number) for number in numbers)
                object.__setattr__(self, name, checked if count > 1 else checked[0])
        if self.place not in PLACES:
            told = diagnose("none-of", value=self.place, known=PLACES)
            raise ConfigurationError("place", told)
        for foot, move in self.moves.items():
            for number in move:
                finite(f"move {foot}", number)
        for name in ("lifts", "steps"):
            heights = getattr(self, name)
            known = {foot: finite(f"{name} {foot}", height) for foot, height in heights.items()}
            object.__setattr__(self, name, known)
        # A foot that is where it is anyway is not moved, and stands on no step.
        moves = {foot: move for foot, move in self.moves.items() if any(move)}
        object.__setattr__(self, "moves", moves)
        object.__setattr__(self, "steps", {foot: h for foot, h in self.steps.items() if h})

    def _check_ranges(self) -> None:
        """Refuses what makes no task, in the units in which it was asked."""
        for name, entry in FIELDS.items():
            value = getattr(self, name, None)
            if isinstance(value, float):
                unit, factor = _PAGE[entry.kind]
                entry.check_range(name, value, unit, factor)
        for foot, height in self.lifts.items():
            FIELDS["swing"].check_range(f"lift {foot}", height, *_PAGE["length"])

    def task(self) -> StandTask:
        """Returns the stand task.

        Raises:
            ConfigurationError: If it is none.
        """
        self._check_ranges()
        offset = None
        if self.place == "offset":
            offset = (metres(self.offset[0]), metres(self.offset[1]))
        return StandTask(
            height=None if self.height is None else metres(self.height),
            roll=radians(self.roll),
            pitch=radians(self.pitch),
            yaw=radians(self.yaw),
            offset=offset,
            com="inside" if self.place == "inside" else None,  # where the robot's usually is
            com_margin=metres(self.com_margin),
            joint_margin=radians(self.joint_margin),
            ground_clearance=metres(self.ground_clearance),
            self_clearance=metres(self.self_clearance) if self.self_clearance else None,
            foot_offsets={foot: (metres(x), metres(y)) for foot, (x, y) in self.moves.items()},
            swing={foot: metres(height) for foot, height in self.lifts.items()},
            ground=Ground(
                slope=radians(self.slope),
                uphill=radians(self.uphill),
                heights={foot: metres(height) for foot, height in self.steps.items()},
            ),
        )

    def scales(self) -> dict[str, float]:
        """Returns the scales that are not the robot's own."""
        found = {name: getattr(self, name) for name in ("leg_scale", "torso_mass_scale")}
        return {name: value for name, value in found.items() if value is not None}

    def payload_point(self) -> tuple[float, float, float]:
        """Returns where the payload is, in the base's frame (m)."""
        x, y, z = self.payload_at
        return metres(x), metres(y), metres(z)

    def with_task(self, task: StandTask) -> State:
        """Returns the state that has another task's numbers, as near as a slider has them.

        Args:
            task: As ``task`` makes them: with the same feet, and the same thing deciding where the
                base is.
        """
        height = self.height if self.height is None or task.height is None else task.height * 1e3
        return replace(
            self,
            height=None if height is None else _short(height),
            roll=_short(math.degrees(task.roll)),
            pitch=_short(math.degrees(task.pitch)),
            yaw=_short(math.degrees(task.yaw)),
            offset=self.offset if task.offset is None else _both(task.offset),
            com_margin=_short(task.com_margin * 1e3),
            joint_margin=_short(math.degrees(task.joint_margin)),
            ground_clearance=_short(task.ground_clearance * 1e3),
            self_clearance=_short((task.self_clearance or 0.0) * 1e3),
            moves={foot: _both(move) for foot, move in task.foot_offsets.items()},
            lifts={foot: _short(height * 1e3) for foot, height in task.swing.items()},
            steps={foot: _short(height * 1e3) for foot, height in task.ground.heights.items()},
            slope=_short(math.degrees(task.ground.slope)),
        )

    def __str__(self) -> str:
        """Returns what differs from a page just opened, as ``parse`` reads it."""
        parts = []
        usual = State()
        for name in _NUMBERS:
            value = getattr(self, name)
            if value != getattr(usual, name):
                numbers = value if isinstance(value, tuple) else (value,)
                parts.append(f"{name}:{','.join(map(plain, numbers))}")
        if self.place != usual.place:
            parts.append(f"place:{self.place}")
        for name, (attribute, count) in _FEET.items():
            for foot, value in sorted(getattr(self, attribute).items()):
                numbers = value if count > 1 else (value,)
                parts.append(f"{name}:{','.join([quote(foot, safe=''), *map(plain, numbers)])}")
        return ";".join(parts)


_ROBOTS = ("payload", "payload_at", "leg_scale", "torso_mass_scale", "kp", "kd")
"""Fields that make another robot, which takes longer than a stance, or no other stance."""


def halfway(one: State, other: State) -> State | None:
    """Returns the state in the middle of two, as a hand passes it that moves a slider.

    None where there is no middle: of two robots, or where something else than a number differs.
    """
    alike = ("place", *_ROBOTS)
    if any(getattr(one, name) != getattr(other, name) for name in alike) or one == other:
        return None
    changed: dict[str, Any] = {}
    for name in _NUMBERS:
        first, second = getattr(one, name), getattr(other, name)
        if first != second:
            if first is None or second is None:
                return None
            changed[name] = _middle(first, second)
    for name, count in _FEET.values():
        first, second = getattr(one, name), getattr(other, name)
        if name == "lifts" and first.keys() != second.keys():
            return None
        none = (0.0, 0.0) if count > 1 else 0.0
        changed[name] = {
            foot: _middle(first.get(foot, none), second.get(foot, none))
            for foot in {**first, **second}
        }
    return replace(other, **changed)


def _middle(one: Any, other: Any) -> Any:
    if isinstance(one, tuple):
        return tuple(_middle(first, second) for first, second in zip(one, other, strict=True))
    return 0.5 * (one + other)


def metres(millimetres: float) -> float:
    """Returns a length in m: the number that is typed with as many digits, not its neighbour."""
    return float(f"{millimetres!r}e-3") if "e" not in repr(millimetres) else millimetres * 1e-3


def radians(degrees: float) -> float:
    """Returns an angle in rad, as the command line reads ``5deg``."""
    return degrees * (math.pi / 180)


def plain(number: float) -> str:
    """Returns a number in as few letters as say it exactly."""
    return repr(number).removesuffix(".0")


def _short(number: float) -> float:
    """Returns a number without the noise of a change of units."""
    return round(number, 9)


def _both(point: tuple[float, float]) -> tuple[float, float]:
    return _short(point[0] * 1e3), _short(point[1] * 1e3)


def parse(text: str) -> State:
    """Returns the state that a text says, as ``str(state)`` writes it.

    ``height:120;roll:5;place:offset;offset:10,0;move:FR,10,0;lift:FL,20``: names and numbers, in mm
    and degrees; ``move``, ``lift`` and ``step`` once per foot.

    Raises:
        ConfigurationError: If it says none.
    """
    if len(text) > _LONGEST:
        raise ConfigurationError("state", diagnose("text-too-long", count=len(text), most=_LONGEST))
    given: dict[str, Any] = {}
    feet: dict[str, Any] = {attribute: {} for attribute, _ in _FEET.values()}
    for part in filter(None, (part.strip() for part in text.split(";"))):
        name, _, value = part.partition(":")
        if name in _FEET:
            attribute, count = _FEET[name]
            foot, *said = _split(name, value, 1 + count)
            numbers = tuple(_number(name, one) for one in said)
            feet[attribute][unquote(foot)] = numbers if count > 1 else numbers[0]
        elif name in given:
            raise ConfigurationError("state", diagnose("said-twice", entry=name))
        elif name == "place":
            given[name] = value
        elif name in _NUMBERS:
            numbers = tuple(_number(name, one) for one in _split(name, value, _NUMBERS[name]))
            given[name] = numbers if len(numbers) > 1 else numbers[0]
        else:
            known = [f.name for f in fields(State) if f.name not in feet]
            told = diagnose("entry-unknown", entry=name, known=[*known, *_FEET])
            raise ConfigurationError("state", told)
    return State(**given, **feet)


def _split(name: str, value: str, count: int) -> list[str]:
    parts = value.split(",")
    if len(parts) != count:
        told = diagnose("values-by-commas", given=f"{name}:{value}", count=count)
        raise ConfigurationError("state", told)
    return parts


def _number(name: str, text: str) -> float:
    try:
        return finite(name, float(text))
    except ValueError:
        told = diagnose("part-is-no-number", part=text, given=name)
        raise ConfigurationError("state", told) from None
