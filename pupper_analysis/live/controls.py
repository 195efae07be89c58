"""A page's sliders and buttons, and the state that they say."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

from pupper_analysis.live.sliders import Range, ranges_of
from pupper_analysis.live.state import State
from pupper_analysis.live.viser_parts import mark
from pupper_analysis.report.formats import visible
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.task import StandTask

PLACES = {
    "com over the centre of the feet": "centre",
    "com anywhere in the support polygon": "inside",
    "base at an offset": "offset",
}
NO_FOOT = "none"

LABELS = {
    "height": ("height (mm)", "Of the base, above the mean of the contact points."),
    "roll": ("roll (°)", "About x, forward."),
    "pitch": ("pitch (°)", "About y, left: positive looks down."),
    "yaw": ("yaw (°)", "About z, up, against the feet."),
    "offset_x": ("offset x (mm)", "Of the base from the centre of the feet, forward."),
    "offset_y": ("offset y (mm)", "Of the base from the centre of the feet, to the left."),
    "com_margin": ("com margin (mm)", "How far inside the support polygon the com must be."),
    "move_x": ("move x (mm)", "Of the chosen foot, off its nominal place, forward."),
    "move_y": ("move y (mm)", "Of the chosen foot, off its nominal place, to the left."),
    "lift_height": ("how high (mm)", "Of the lifted foot above the ground."),
    "slope": ("slope (°)", "Of the ground."),
    "uphill": ("uphill (°)", "Where it rises, about z from x."),
    "payload": ("payload (kg)", "A mass welded to the base."),
    "payload_x": ("at x (mm)", "Where the payload is, in the base's frame."),
    "payload_y": ("at y (mm)", "Where the payload is, in the base's frame."),
    "payload_z": ("at z (mm)", "Where the payload is, in the base's frame."),
    "leg_scale": ("leg length", "Factor on the length and the mass of thighs and calves."),
    "torso_mass_scale": ("torso mass", "Factor on the torso's mass."),
    "kp": ("kp (N m/rad)", "Stiffness of all servos."),
    "kd": ("kd (N m s/rad)", "Damping of all servos."),
}

_PAIRS = {"offset_x": ("offset", 0), "offset_y": ("offset", 1)} | {
    f"payload_{axis}": ("payload_at", number) for number, axis in enumerate("xyz")
}
"""{slider: field of the state, and which of its numbers}."""


class Controls:
    """The sliders of one page.

    Args:
        gui: viser's interface of one page.
        robot: The robot as it is on a page just opened.
        scales: {name of a scale that it can be made with: its own}.
        changed: What is told that the state has changed.
    """

    def __init__(
        self,
        gui: Any,
        robot: Robot,
        scales: Mapping[str, float],
        changed: Callable[[], None],
    ) -> None:
        self._gui, self._changed = gui, changed
        self._lock = threading.RLock()
        self._state = State()
        self._ranges = ranges_of(robot, dict(scales))
        self._scales = dict(scales)
        self._feet = {visible(foot): foot for foot in robot.soles}
        self.sliders: dict[str, Any] = {}

    def stance(self) -> None:
        """Adds what says how it stands, where viser adds next."""
        with self._gui.add_folder("Base"):
            self._add("height", "roll", "pitch", "yaw")
        with self._gui.add_folder("Where"):
            self.place = self._gui.add_dropdown("what counts", list(PLACES))
            self._add("offset_x", "offset_y", "com_margin")
        with self._gui.add_folder("Feet"):
            self.foot = self._gui.add_dropdown("foot", list(self._feet))
            self._add("move_x", "move_y")
            self.lift = self._gui.add_dropdown("lift", [NO_FOOT, *self._feet])
            self._add("lift_height")
        with self._gui.add_folder("Ground"):
            self._add("slope", "uphill")
        self.place.on_update(self._when(lambda s: replace(s, place=PLACES[self.place.value])))
        self.lift.on_update(self._when(lambda s: replace(s, lift=self._lifted())))
        self.foot.on_update(self._foot_chosen)

    def body(self) -> None:
        """Adds what says what it carries, and which robot it is."""
        with self._gui.add_folder("Payload"):
            self._add("payload", "payload_x", "payload_y", "payload_z")
        if self._scales:
            with self._gui.add_folder("Legs and torso"):
                self._add(*self._scales)
        with self._gui.add_folder("Servos"):
            self._add("kp", "kd")
            own = self._gui.add_button("The model's own servos")
        own.on_click(lambda _: self.put(replace(self.state, kp=None, kd=None), told=True))

    def _add(self, *names: str) -> None:
        for name in names:
            label, hint = LABELS[name]
            span = self._ranges[name]
            handle = self._gui.add_slider(
                label, span.low, span.high, span.step, _within(span, span.value), hint=hint
            )
            handle.on_update(self._when(partial(self._with, name)))
            self.sliders[name] = handle

    def _when(self, change: Callable[[State], State]) -> Callable[[Any], None]:
        """Returns what a control calls when someone moves it; what a program sets is known."""

        def moved(event: Any) -> None:
            if event.client is None:
                return
            with self._lock:
                before = self._state
                self._state = change(before)
                if self._state.place != before.place:
                    self._show_place()
            self._changed()

        return moved

    def _with(self, name: str, state: State) -> State:
        """Returns a state with a slider's value."""
        value = float(self.sliders[name].value)
        if name in _PAIRS:
            field, number = _PAIRS[name]
            numbers = list(getattr(state, field))
            numbers[number] = value
            changed: dict[str, Any] = {field: tuple(numbers)}
            state = replace(state, **changed)
            return replace(state, place="offset") if field == "offset" else state
        if name in ("move_x", "move_y"):
            move = float(self.sliders["move_x"].value), float(self.sliders["move_y"].value)
            return replace(state, moves={**state.moves, self._feet[self.foot.value]: move})
        plain: dict[str, Any] = {name: value}
        return replace(state, **plain)

    def _lifted(self) -> str:
        return self._feet.get(self.lift.value, "")

    def _foot_chosen(self, _event: Any) -> None:
        """Lets the sliders of moves be those of another foot."""
        with self._lock:
            self._show_move()

    @property
    def state(self) -> State:
        """What the controls say."""
        with self._lock:
            return self._state

    def put(self, state: State, *, told: bool) -> None:
        """Sets all controls.

        Args:
            state: What they shall say.
            told: Whether that is a change to be answered.
        """
        with self._lock:
            self._state = state
            for name in self.sliders:
                if name not in ("move_x", "move_y"):
                    self._slide(name, self._value(state, name))
            self.lift.value = next((n for n, f in self._feet.items() if f == state.lift), NO_FOOT)
            moved = next((n for n, f in self._feet.items() if f in state.moves), None)
            if moved is not None and self._feet[self.foot.value] not in state.moves:
                self.foot.value = moved
            self._show_place()
            self._show_move()
        if told:
            self._changed()

    def _value(self, state: State, name: str) -> float:
        if name in _PAIRS:
            field, number = _PAIRS[name]
            return float(getattr(state, field)[number])
        value = getattr(state, name)
        return self._ranges[name].value if value is None else float(value)

    def _slide(self, name: str, value: float) -> None:
        """Moves a slider; it is made longer if it does not go so far."""
        handle = self.sliders[name]
        if value < handle.min:
            handle.min = value
        if value > handle.max:
            handle.max = value
        handle.value = value

    def _show_place(self) -> None:
        self.place.value = next(n for n, place in PLACES.items() if place == self._state.place)

    def _show_move(self) -> None:
        x, y = self._state.moves.get(self._feet[self.foot.value], (0.0, 0.0))
        self._slide("move_x", x)
        self._slide("move_y", y)

    def follow(self, robot: Robot) -> None:
        """Lets what nobody has set be what is usual for a robot: its height."""
        with self._lock:
            if self._state.height is None:
                self._slide("height", round(1e3 * robot.stand_height, 2))

    def limits(self, ends: Mapping[str, Mapping[str, Any]]) -> None:
        """Marks on the sliders how far they can go.

        Args:
            ends: A refusal's ``limits``: {demand, or demands: {field of a task: its value}}.
        """
        places: dict[str, tuple[float, ...]] = {}
        with self._lock:
            foot = self._feet[self.foot.value]
            for fields in ends.values():
                task = replace(self._state.task(), **fields)
                for name, value in slider_values(self._state, task, fields, foot).items():
                    places[name] = (*places.get(name, ()), value)
        for name, handle in self.sliders.items():
            marked = name in places
            label, _ = LABELS[name]
            found = " or ".join(f"{value:g}" for value in dict.fromkeys(places.get(name, ())))
            handle.label = f"{label} ◆ {found} possible" if marked else label
            mark(handle, places.get(name, ()))


def slider_values(
    state: State, task: StandTask, fields: Mapping[str, Any], foot: str
) -> dict[str, float]:
    """Returns where sliders would be for some fields of a task.

    Args:
        state: What was asked.
        task: With these fields.
        fields: Those of the task that count.
        foot: The foot that the sliders of moves are about.
    """
    there = state.with_task(task)
    found: dict[str, float] = {}
    for name in ("height", "roll", "pitch", "yaw", "com_margin"):
        if name in fields:
            value = 1e3 * (task.height or 0.0) if name == "height" else getattr(there, name)
            found[name] = round(float(value), 6)
    if "offset" in fields:
        found["offset_x"], found["offset_y"] = there.offset
    if "foot_offsets" in fields and foot in there.moves:
        found["move_x"], found["move_y"] = there.moves[foot]
    if "swing" in fields:
        found["lift_height"] = there.lift_height
    if "ground" in fields:
        found["slope"] = there.slope
    return found


def _within(span: Range, value: float) -> float:
    return min(max(round(value, 2), span.low), span.high)
