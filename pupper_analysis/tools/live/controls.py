"""A page's sliders and buttons, and the state that they say."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

from pupper_analysis.base.diagnostics import term
from pupper_analysis.base.errors import PupperAnalysisError
from pupper_analysis.present.formats import escape_control
from pupper_analysis.robot.posture import free_joints, named_positions
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.tool import split_place
from pupper_analysis.stance.fields import FIELDS, Field
from pupper_analysis.stance.stand import Stand
from pupper_analysis.stance.task import StandTask
from pupper_analysis.tools.live.joints import JointSliders, led_joints
from pupper_analysis.tools.live.language import Language
from pupper_analysis.tools.live.sliders import (
    CONTROLS,
    Control,
    Range,
    ranges_of,
)
from pupper_analysis.tools.live.state import State, on_page
from pupper_analysis.tools.live.viser_parts import mark_slider

PLACES = {
    "centre": "place-centre",
    "inside": "place-inside",
    "offset": "place-offset",
}
"""{what decides where the base is: what it is called}."""

LIFTED = "lift"
"""The slider of a foot that does not carry: who moves it lifts the foot."""


class Controls:
    """The sliders of one page.

    Args:
        gui: viser's interface of one page.
        robot: The robot as it is on a page just opened.
        scales: {name of a scale that it can be made with: its own}.
        say: The page's language.
        changed: What is told that the state has changed.
        hang: What is told that a joint of a leg has been moved.
    """

    def __init__(
        self,
        gui: Any,
        robot: Robot,
        scales: Mapping[str, float],
        say: Language,
        changed: Callable[[], None],
        hang: Callable[[], None],
    ) -> None:
        self._gui, self._say, self._changed, self._hang = gui, say, changed, hang
        self._robot = robot
        self._lock = threading.RLock()
        self._state = State()
        self._ranges = ranges_of(robot, scales)
        self._feet = {escape_control(foot): foot for foot in robot.feet}
        self.sliders: dict[str, Any] = {}

    def stance(self) -> None:
        """Adds what says how it stands, where viser adds next."""
        gui, say = self._gui, self._say
        self._places = {say(label): name for name, label in PLACES.items()}
        for folder in _folders(FIELDS):
            with gui.add_folder(term(folder, say.code)):
                if folder == "Where":
                    self.place = gui.add_dropdown(say("what-counts"), list(self._places))
                if folder == "Feet":
                    self.foot = gui.add_dropdown(
                        say("foot"), list(self._feet), hint=say("hint-foot")
                    )
                self._add(folder, LIFTED)
                if folder == "Feet":
                    self.lifted = gui.add_checkbox(say("lifted"), False, hint=say("hint-lifted"))
                    self._add_one(CONTROLS[LIFTED])
        self.place.on_update(self._when(lambda s: s.having(place=self._places[self.place.value])))
        self.lifted.on_update(self._when(self._with_lift))
        self.foot.on_update(self._foot_chosen)

    def joints(self) -> None:
        """Adds what says where joints are: of a posture, and of legs that hang."""
        gui, robot = self._gui, self._robot
        free, home = free_joints(robot), robot.home[-robot.nu :]
        legs = [joint for joint in led_joints(robot) if joint not in free]
        with gui.add_folder(term("Legs", self._say.code)):
            gui.add_markdown(self._say("legs-hang"))
            self.legs = JointSliders(gui, robot, legs, home, lambda _joint, _at: self._hang())
        with gui.add_folder(term("Posture", self._say.code), visible=bool(free)):
            self.posture = JointSliders(gui, robot, free, home, self._placed)

    def _placed(self, joint: str, position: float) -> None:
        """Takes a joint's place in the posture."""
        with self._lock:
            self._state = self._state.having(posture={**self._state.posture, joint: position})
        self._changed()

    @property
    def hanging(self) -> tuple[State, dict[str, float]]:
        """What the controls say, and where the sliders of joints are (rad, m)."""
        return self.state, self.legs.positions() | self.posture.positions()

    def body(self) -> None:
        """Adds what says what it carries, and which robot it is."""
        gui, say = self._gui, self._say
        for folder in ("Payload", "Legs and torso", "Servos"):
            if any(_folder(CONTROLS[name].field) == folder for name in self._ranges):
                with gui.add_folder(term(folder, say.code)):
                    if folder == "Payload":
                        links = {escape_control(link): link for link in self._robot.structure.links}
                        self.on = gui.add_dropdown(say("payload-on"), list(links))
                        self._links = links
                    self._add(folder)
                    if folder == "Servos":
                        own = gui.add_button(say("own-servos"))
        self.on.on_update(self._when(self._with_link))
        own.on_click(lambda _: self.put(self.state.having(kp=None, kd=None), told=True))

    def _add(self, folder: str, *but: str) -> None:
        """Adds the sliders under a heading."""
        for name, control in CONTROLS.items():
            if name in self._ranges and name not in but and _folder(control.field) == folder:
                self._add_one(control)

    def _add_one(self, control: Control) -> None:
        span, code = self._ranges[control.name], self._say.code
        handle = self._gui.add_slider(
            control.label(code),
            span.low,
            span.high,
            span.step,
            _within(span, span.value),
            hint=control.hint(code),
        )
        handle.on_update(self._when(partial(self._with, control)))
        self.sliders[control.name] = handle

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

    def _with(self, control: Control, state: State) -> State:
        """Returns a state with a slider's value."""
        field = control.field
        value = float(self.sliders[control.name].value)
        # What is typed may lie beyond its end, and would be cut off later.
        self._slide(control.name, value)
        if control.name == LIFTED:  # who says how high lifts it
            self.lifted.value = True
        whole = getattr(state, field.name)
        own = whole.get(self._chosen) if field.per else whole
        if control.axis is not None:
            numbers = list(own or (0.0,) * len(field.axes))
            numbers[control.axis - len(field.axes)] = value  # behind a frame
            new: Any = tuple(numbers)
        else:
            new = value
        state = state.having(**{field.name: {**whole, self._chosen: new} if field.per else new})
        return state.having(place="offset") if field.name == "offset" else state

    def _with_link(self, state: State) -> State:
        """Returns a state whose payload is on the chosen link."""
        link, (*_, x, y, z) = self._links[self.on.value], state.payload_at
        return state.having(payload_at=(x, y, z) if link == self._robot.base else (link, x, y, z))

    def _with_lift(self, state: State) -> State:
        """Returns a state with the chosen foot lifted, or not."""
        others = {foot: height for foot, height in state.swing.items() if foot != self._chosen}
        if self.lifted.value:
            others[self._chosen] = float(self.sliders[LIFTED].value)
        return state.having(swing=others)

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
                if not CONTROLS[name].field.per:
                    self._slide(name, self._value(state, CONTROLS[name]))
            special = {
                foot
                for name, field in FIELDS.items()
                if field.per == "foot" and field.slider
                for foot in getattr(state, name)
            }
            first = next((name for name, foot in self._feet.items() if foot in special), None)
            if first is not None and self._chosen not in special:
                self.foot.value = first
            self._show_place()
            self._show_foot()
            self.posture.show(self._posture_of(state))
            self._show_link()
        if told:
            self._changed()

    def _value(self, state: State, control: Control) -> float:
        value = getattr(state, control.field.name)
        return self._ranges[control.name].value if value is None else control.of(value)

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

    def _posture_of(self, state: State) -> dict[str, float]:
        """Returns where a state puts joints; nowhere, if it names none of the robot."""
        try:
            return named_positions(self._robot, state.posture)
        except PupperAnalysisError:  # the answer says so
            return {}

    def _show_link(self) -> None:
        frame, _ = split_place(self._state.payload_at)
        link = escape_control(frame or self._robot.base)
        if link in self._links:  # else it is on a site or a body
            self.on.value = link

    def _show_foot(self) -> None:
        foot, state = self._chosen, self._state
        self.lifted.value = foot in state.swing
        for name in self.sliders:
            control = CONTROLS[name]
            if control.field.per:
                values = getattr(state, control.field.name)
                usual = self._ranges[name].value
                self._slide(name, control.of(values[foot]) if foot in values else usual)

    def follow(self, robot: Robot, stand: Stand | None) -> None:
        """Lets what nobody has set be what is usual for a robot, and legs be where they stand."""
        with self._lock:
            for name, field in FIELDS.items():
                if field.per or field.nominal == "zero" or not field.slider:
                    continue
                if getattr(self._state, name) is None:
                    self._slide(field.address, round(1e3 * getattr(robot, field.nominal), 2))

        if stand is not None:
            joints = stand.joint_positions(robot).tolist()
            self.legs.show(dict(zip(robot.joint_names, joints, strict=True)))

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
            label = CONTROLS[name].label(self._say.code)
            found = self._say.either(f"{value:g}" for value in dict.fromkeys(places.get(name, ())))
            far = self._say("label-values-possible", label=label, values=found)
            handle.label = far if marked else label
            mark_slider(handle, places.get(name, ()))


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
    found: dict[str, float] = {}
    asked = state.task()
    for name, control in CONTROLS.items():
        field = control.field
        if field.name not in FIELDS or field.attribute not in fields:
            continue
        value = task.values()[field.name]
        if field.per:
            value = value.get(foot)
        elif field.part == "ground" and math.isclose(asked.values()[field.name], value):
            continue  # the ground gives way in other numbers
        if value is not None:
            found[name] = control.of(on_page(field, value))
    return found


def _folders(fields: Mapping[str, Field]) -> list[str]:
    """Returns the headings of fields, in the order in which they come, but for those of joints."""
    return list(
        dict.fromkeys(
            field.slider.folder
            for field in fields.values()
            if field.slider and field.per != "joint"
        )
    )


def _folder(field: Field) -> str:
    return field.slider.folder if field.slider else ""


def _within(span: Range, value: float) -> float:
    return min(max(round(value, 2), span.low), span.high)
