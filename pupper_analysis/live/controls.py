"""A page's sliders and buttons, and the state that they say."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

from pupper_analysis.live.language import Language
from pupper_analysis.live.sliders import Range, ranges_of
from pupper_analysis.live.state import State
from pupper_analysis.live.viser_parts import mark
from pupper_analysis.report.formats import visible
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.task import StandTask

PLACES = {
    "centre": "place-centre",
    "inside": "place-inside",
    "offset": "place-offset",
}
"""{what decides where the base is: what it is called}."""

LABELS = {
    "height": ("slider-height", "hint-height"),
    "roll": ("slider-roll", "hint-roll"),
    "pitch": ("slider-pitch", "hint-pitch"),
    "yaw": ("slider-yaw", "hint-yaw"),
    "offset_x": ("slider-offset-x", "hint-offset-x"),
    "offset_y": ("slider-offset-y", "hint-offset-y"),
    "com_margin": ("slider-com-margin", "hint-com-margin"),
    "joint_margin": ("slider-joint-margin", "hint-joint-margin"),
    "ground_clearance": ("slider-ground-clearance", "hint-ground-clearance"),
    "self_clearance": ("slider-self-clearance", "hint-self-clearance"),
    "move_x": ("slider-move-x", "hint-move-x"),
    "move_y": ("slider-move-y", "hint-move-y"),
    "step": ("slider-step", "hint-step"),
    "lift_height": ("slider-lift-height", "hint-lift-height"),
    "slope": ("slider-slope", "hint-slope"),
    "uphill": ("slider-uphill", "hint-uphill"),
    "payload": ("slider-payload", "hint-payload"),
    "payload_x": ("slider-payload-x", "hint-payload-place"),
    "payload_y": ("slider-payload-y", "hint-payload-place"),
    "payload_z": ("slider-payload-z", "hint-payload-place"),
    "leg_scale": ("slider-leg-scale", "hint-leg-scale"),
    "torso_mass_scale": ("slider-torso-mass-scale", "hint-torso-mass-scale"),
    "kp": ("slider-kp", "hint-kp"),
    "kd": ("slider-kd", "hint-kd"),
}
"""{slider: (what it is called, what it is about)}."""

OF_A_FOOT = ("move_x", "move_y", "step", "lift_height")

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
        say: The page's language.
        changed: What is told that the state has changed.
    """

    def __init__(
        self,
        gui: Any,
        robot: Robot,
        scales: Mapping[str, float],
        say: Language,
        changed: Callable[[], None],
    ) -> None:
        self._gui, self._say, self._changed = gui, say, changed
        self._lock = threading.RLock()
        self._state = State()
        self._ranges = ranges_of(robot, dict(scales))
        self._scales = dict(scales)
        self._feet = {visible(foot): foot for foot in robot.soles}
        self.sliders: dict[str, Any] = {}

    def stance(self) -> None:
        """Adds what says how it stands, where viser adds next."""
        gui, say = self._gui, self._say
        self._places = {say(label): name for name, label in PLACES.items()}
        with gui.add_folder(say("base-title")):
            self._add("height", "roll", "pitch", "yaw")
        with gui.add_folder(say("where")):
            self.place = gui.add_dropdown(say("what-counts"), list(self._places))
            self._add("offset_x", "offset_y")
        with gui.add_folder(say("feet")):
            self.foot = gui.add_dropdown(say("foot"), list(self._feet), hint=say("hint-foot"))
            self._add("move_x", "move_y", "step")
            self.lifted = gui.add_checkbox(say("lifted"), False, hint=say("hint-lifted"))
            self._add("lift_height")
        with gui.add_folder(say("ground")):
            self._add("slope", "uphill")
        with gui.add_folder(say("margins")):
            self._add("com_margin", "joint_margin", "ground_clearance", "self_clearance")
        self.place.on_update(self._when(lambda s: replace(s, place=self._places[self.place.value])))
        self.lifted.on_update(self._when(self._with_lift))
        self.foot.on_update(self._foot_chosen)

    def body(self) -> None:
        """Adds what says what it carries, and which robot it is."""
        gui, say = self._gui, self._say
        with gui.add_folder(say("payload-title")):
            self._add("payload", "payload_x", "payload_y", "payload_z")
        if self._scales:
            with gui.add_folder(say("legs-and-torso")):
                self._add(*self._scales)
        with gui.add_folder(say("servos")):
            self._add("kp", "kd")
            own = gui.add_button(say("own-servos"))
        own.on_click(lambda _: self.put(replace(self.state, kp=None, kd=None), told=True))

    def _add(self, *names: str) -> None:
        for name in names:
            label, hint = LABELS[name]
            span = self._ranges[name]
            handle = self._gui.add_slider(
                self._say(label),
                span.low,
                span.high,
                span.step,
                _within(span, span.value),
                hint=self._say(hint),
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
        self._slide(name, value)  # what is typed may lie beyond its end, and would be cut off later
        if name in _PAIRS:
            field, number = _PAIRS[name]
            numbers = list(getattr(state, field))
            numbers[number] = value
            changed: dict[str, Any] = {field: tuple(numbers)}
            state = replace(state, **changed)
            return replace(state, place="offset") if field == "offset" else state
        foot = self._chosen
        if name in ("move_x", "move_y"):
            move = float(self.sliders["move_x"].value), float(self.sliders["move_y"].value)
            return replace(state, moves={**state.moves, foot: move})
        if name == "step":
            return replace(state, steps={**state.steps, foot: value})
        if name == "lift_height":  # who says how high lifts it
            self.lifted.value = True
            return replace(state, lifts={**state.lifts, foot: value})
        plain: dict[str, Any] = {name: value}
        return replace(state, **plain)

    def _with_lift(self, state: State) -> State:
        """Returns a state with the chosen foot lifted, or not."""
        others = {foot: height for foot, height in state.lifts.items() if foot != self._chosen}
        if self.lifted.value:
            others[self._chosen] = float(self.sliders["lift_height"].value)
        return replace(state, lifts=others)

    @property
    def _chosen(self) -> str:
        """The foot that its sliders are about."""
        return self._feet[self.foot.value]

    def _foot_chosen(self, _event: Any) -> None:
        """Lets the sliders of a foot be those of another one."""
        with self._lock:
            self._show_foot()

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
                if name not in OF_A_FOOT:
                    self._slide(name, self._value(state, name))
            special = {*state.moves, *state.lifts, *state.steps}
            first = next((name for name, foot in self._feet.items() if foot in special), None)
            if first is not None and self._chosen not in special:
                self.foot.value = first
            self._show_place()
            self._show_foot()
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
        self.place.value = self._say(PLACES[self._state.place])

    def _show_foot(self) -> None:
        foot, state = self._chosen, self._state
        x, y = state.moves.get(foot, (0.0, 0.0))
        self._slide("move_x", x)
        self._slide("move_y", y)
        self._slide("step", state.steps.get(foot, 0.0))
        self.lifted.value = foot in state.lifts
        self._slide("lift_height", state.lifts.get(foot, self._ranges["lift_height"].value))

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
            foot = self._chosen
            for fields in ends.values():
                task = replace(self._state.task(), **fields)
                for name, value in slider_values(self._state, task, fields, foot).items():
                    places[name] = (*places.get(name, ()), value)
        for name, handle in self.sliders.items():
            marked = name in places
            label = self._say(LABELS[name][0])
            found = self._say.either(f"{value:g}" for value in dict.fromkeys(places.get(name, ())))
            far = self._say("label-values-possible", label=label, values=found)
            handle.label = far if marked else label
            mark(handle, places.get(name, ()))


def slider_values(
    state: State, task: StandTask, fields: Mapping[str, Any], foot: str
) -> dict[str, float]:
    """Returns where sliders would be for some fields of a task.

    Args:
        state: What was asked.
        task: With these fields.
        fields: Those of the task that count.
        foot: The foot that the sliders of a foot are about.
    """
    there = state.with_task(task)
    found: dict[str, float] = {}
    plain = ("joint_margin", "ground_clearance", "self_clearance")
    for name in ("height", "roll", "pitch", "yaw", "com_margin", *plain):
        if name in fields:
            value = 1e3 * (task.height or 0.0) if name == "height" else getattr(there, name)
            found[name] = round(float(value), 6)
    if "offset" in fields:
        found["offset_x"], found["offset_y"] = there.offset
    if "foot_offsets" in fields and foot in there.moves:
        found["move_x"], found["move_y"] = there.moves[foot]
    if "swing" in fields and foot in there.lifts:
        found["lift_height"] = there.lifts[foot]
    if "ground" in fields:
        if there.slope != state.slope or not state.steps:
            found["slope"] = there.slope
        if foot in there.steps:
            found["step"] = there.steps[foot]
    return found


def _within(span: Range, value: float) -> float:
    return min(max(round(value, 2), span.low), span.high)
