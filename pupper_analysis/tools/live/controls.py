"""A page's sliders and buttons, and the state that they say."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import Term, term
from pupper_analysis.base.diagnostics.templates import fill_template
from pupper_analysis.base.errors import PupperAnalysisError
from pupper_analysis.base.units import READ_IN
from pupper_analysis.cli.stance_fields import to_task_value
from pupper_analysis.present.formats import escape_control
from pupper_analysis.robot.joints import free_joints, joint_ranges, named_positions
from pupper_analysis.robot.plane import Contact, Weld
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import list_position_servos
from pupper_analysis.stance.fields import FIELDS, Field, Slider
from pupper_analysis.stance.posture import joint_units
from pupper_analysis.tools.live.render import Language
from pupper_analysis.tools.live.state import PAGE_UNITS, SLIDER_FIELDS, State, find_contact_factor

Array = NDArray[np.float64]

PLACE_LABELS = {"centre": "place-centre", "inside": "place-inside", "offset": "place-offset"}
"""{what decides where the base is: what it is called}."""

LIFT_SLIDER = "lift"
"""The slider of a foot that does not carry: who moves it lifts the foot."""


class Controls:
    """The sliders of one page.

    Args:
        gui: viser's interface of one page.
        robot: The robot as it is on a page just opened.
        say: The page's language.
        changed: What is called when the state has changed.
    """

    def __init__(
        self,
        gui: Any,
        robot: Robot,
        say: Language,
        changed: Callable[[], None],
    ) -> None:
        self._gui, self._say, self._changed = gui, say, changed
        self._robot = robot
        self._lock = threading.RLock()
        self._state = State()
        self._ranges = make_slider_ranges(robot)
        self._feet = {escape_control(foot): foot for foot in robot.feet}
        self.sliders: dict[str, Any] = {}

    def add_stance_controls(self) -> None:
        """Adds what says how it stands, where viser adds next."""
        gui, say = self._gui, self._say
        self._places = {say(label): name for name, label in PLACE_LABELS.items()}
        for folder in _folders(FIELDS):
            with gui.add_folder(term(folder, say.code)):
                if folder == "Where":
                    self.place = gui.add_dropdown(say("what-counts"), list(self._places))
                if folder == "Feet":
                    self.foot = gui.add_dropdown(
                        say("foot"), list(self._feet), hint=say("hint-foot")
                    )
                self._add(folder, LIFT_SLIDER)
                if folder == "Feet":
                    self.lifted = gui.add_checkbox(say("lifted"), False, hint=say("hint-lifted"))
                    self._add_one(CONTROL_BY_NAME[LIFT_SLIDER])
                    self.contacts = gui.add_text(
                        say("contacts"), "", multiline=True, hint=say("hint-contacts")
                    )
        self.place.on_update(self._when(lambda s: s.having(place=self._places[self.place.value])))
        self.lifted.on_update(self._when(self._with_lift))
        self.foot.on_update(self._foot_chosen)
        self.contacts.on_update(self._when(self._with_contacts))

    def add_joint_controls(self) -> None:
        """Adds what says where joints are that carry no foot: of the posture."""
        gui, robot = self._gui, self._robot
        free, home = free_joints(robot), robot.home[-robot.nu :]
        with gui.add_folder(term("Posture", self._say.code), visible=bool(free)):
            self.posture = JointSliders(gui, robot, free, home, self._placed)

    def _placed(self, joint: str, position: float) -> None:
        """Takes a joint's place in the posture."""
        with self._lock:
            self._state = self._state.having(posture={**self._state.posture, joint: position})
        self._changed()

    def add_body_controls(self) -> None:
        """Adds what says what it carries, and which robot it is."""
        gui, say = self._gui, self._say
        for folder in ("Payload", "Servos"):
            with gui.add_folder(term(folder, say.code)):
                self._add(folder)

    def _add(self, folder: str, *but: str) -> None:
        """Adds the sliders under a heading."""
        for name, control in CONTROL_BY_NAME.items():
            if name not in but and _folder(control.field) == folder:
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
                with suppress(PupperAnalysisError):  # no number
                    self._state = change(before)
                if self._state.place != before.place:
                    self._show_place()
                if self._state.contacts != before.contacts:
                    self._show_contacts(typed=event.target is self.contacts)
            self._changed()

        return moved

    def _with(self, control: Control, state: State) -> State:
        """Returns a state with a slider's value."""
        field = control.field
        value = float(self.sliders[control.name].value)
        # What is typed may lie beyond its end, and would be cut off later.
        self._slide(control.name, value)
        if control.name == LIFT_SLIDER:  # who says how high lifts it
            self.lifted.value = True
        whole = getattr(state, field.name)
        own = whole.get(self._chosen) if field.per else whole
        if field.kind == "contact":
            if not isinstance(own, Contact):  # a foot on the ground
                return state
            new: Any = own.at(value / find_contact_factor(own))
        elif control.axis is not None:
            numbers = list(own or (0.0,) * len(field.axes))
            numbers[control.axis - len(field.axes)] = value  # behind a frame
            new = tuple(numbers)
        else:
            new = value
        state = state.having(**{field.name: {**whole, self._chosen: new} if field.per else new})
        return state.having(place="offset") if field.name == "offset" else state

    def _with_lift(self, state: State) -> State:
        others = {foot: height for foot, height in state.swing.items() if foot != self._chosen}
        if self.lifted.value:
            others[self._chosen] = float(self.sliders[LIFT_SLIDER].value)
        return state.having(swing=others)

    def _with_contacts(self, state: State) -> State:
        """Returns a state with the contacts that are typed."""
        lines = filter(str.strip, self.contacts.value.splitlines())
        return state.having(contacts=to_task_value(FIELDS["contacts"], [*lines]))

    def _show_contacts(self, *, typed: bool) -> None:
        """Shows the state's contacts: as text, unless they are from there, and among the feet."""
        contacts = self._state.contacts
        if not typed:
            self.contacts.value = "\n".join(f"{of}={one}" for of, one in contacts.items())
        touching = (of for of, one in contacts.items() if one.plane is not None)
        self._feet = {escape_control(one): one for one in (*self._robot.feet, *touching)}
        if [*self.foot.options] != [*self._feet]:
            self.foot.options = [*self._feet]
        self._show_foot()

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

    def set_state(self, state: State, *, notify: bool) -> None:
        """Sets all controls.

        Args:
            state: What they shall say.
            notify: Whether that is a change to be answered.
        """
        with self._lock:
            self._state = state
            for name in self.sliders:
                if not CONTROL_BY_NAME[name].field.per:
                    self._slide(name, self._value(state, CONTROL_BY_NAME[name]))
            special = {
                foot
                for name, field in FIELDS.items()
                if field.per in ("foot", "link") and field.slider
                for foot in getattr(state, name)
            }
            self._show_contacts(typed=False)
            first = next((name for name, foot in self._feet.items() if foot in special), None)
            if first is not None and self._chosen not in special:
                self.foot.value = first
            self._show_place()
            self._show_foot()
            self.posture.show(self._posture_of(state))
        if notify:
            self._changed()

    def _value(self, state: State, control: Control) -> float:
        value = getattr(state, control.field.name)
        return self._ranges[control.name].value if value is None else control.extract_number(value)

    def _slide(self, name: str, value: float) -> None:
        """Moves a slider; it is made longer if it does not go so far."""
        handle = self.sliders[name]
        if value < handle.min:
            handle.min = value
        if value > handle.max:
            handle.max = value
        handle.value = value

    def _show_place(self) -> None:
        self.place.value = self._say(PLACE_LABELS[self._state.place])

    def _posture_of(self, state: State) -> Mapping[str, float]:
        """Returns where a state puts joints; nowhere, if it names none of the robot."""
        try:
            return named_positions(self._robot, state.posture)
        except PupperAnalysisError:  # the answer says so
            return {}

    def _show_foot(self) -> None:
        foot, state = self._chosen, self._state
        self.lifted.value = foot in state.swing
        for name in self.sliders:
            control = CONTROL_BY_NAME[name]
            if control.field.per:
                values = getattr(state, control.field.name)
                usual = self._ranges[name].value
                self._slide(name, control.extract_number(values[foot]) if foot in values else usual)


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


# Sliders of joints: of a stand's posture.


_ENDS = {"rad": math.pi, "m": 1.0}
"""{unit of a joint: the end of a slider of one without limits}."""

_STEP = 0.5
"""From notch to notch of a slider (deg, mm): half of what one tells apart on the page."""

_FINE = 2
"""Digits of a slider's value (deg, mm) where a program sets it."""

_DIGITS = 6
"""Of a position (rad, m): what is finer than a micrometre or microradian nobody types."""


class JointSliders:
    """A slider for each of some joints, in degrees, or in mm of those that slide.

    Args:
        gui: viser's interface of one page.
        robot: The robot.
        joints: Which.
        start: (nu,) where they are (rad, m).
        moved: Is called with a joint and its position (rad, m) when somebody moves a slider.

    Attributes:
        sliders: {joint: viser's slider}.
    """

    def __init__(
        self,
        gui: Any,
        robot: Robot,
        joints: Iterable[str],
        start: Array,
        moved: Callable[[str, float], None],
    ) -> None:
        self._moved = moved
        self.sliders: dict[str, Any] = {}
        self._scales: dict[str, float] = {}
        ranges, units = joint_ranges(robot), joint_units(robot)
        for name in joints:
            index = robot.joint_names.index(name)
            (scale, unit), end = READ_IN[units[index]], _ENDS[units[index]]
            ends = np.clip(ranges[index], -end, end) * scale
            # Inwards, so that no end of a slider is beyond the joint's.
            low, high = math.ceil(ends[0] / _STEP) * _STEP, math.floor(ends[1] / _STEP) * _STEP
            value = float(np.clip(round(float(start[index]) * scale, _FINE), low, max(high, low)))
            name_and_unit = f"{escape_control(name)} ({unit})"
            slider = gui.add_slider(name_and_unit, low, max(high, low + _STEP), _STEP, value)
            slider.on_update(partial(self._by_hand, name))
            self.sliders[name], self._scales[name] = slider, scale
        self._begin = {name: slider.value for name, slider in self.sliders.items()}

    def _by_hand(self, joint: str, event: Any) -> None:
        if event.client is not None:  # what a program sets is known
            value = float(self.sliders[joint].value) / self._scales[joint]
            self._moved(joint, round(value, _DIGITS) + 0.0)  # never -0

    def show(self, positions: Mapping[str, float]) -> None:
        """Moves sliders to where joints are (rad, m); the others to where they began."""
        for joint, slider in self.sliders.items():
            value = self._begin[joint]
            if joint in positions:
                value = round(positions[joint] * self._scales[joint], _FINE)
            value = min(max(value, slider.min), slider.max)
            if slider.value != value:
                slider.value = value


# The sliders of a page: what each is about, and how far it goes for one robot.

_AXIS_WORDS = {"x": Term("forward"), "y": Term("to the left"), "z": Term("up")}


@dataclass(frozen=True)
class Control:
    """One slider: a field's number, or one of a point's.

    Attributes:
        name: What it is called: ``roll``, ``offset_x``.
        field: What it sets.
        axis: Which number of a point; None for a number.
    """

    name: str
    field: Field
    axis: int | None = None

    def label(self, language: str) -> str:
        """Returns what it is called, with its unit."""
        unit, _ = PAGE_UNITS[self.field.kind]
        axis = "" if self.axis is None else f" {self.field.axes[self.axis]}"
        return f"{self.field.words(language).label}{axis}" + (f" ({unit})" if unit else "")

    def hint(self, language: str) -> str:
        """Returns what it is about."""
        way = {} if self.axis is None else {"axis": _AXIS_WORDS[self.field.axes[self.axis]]}
        return fill_template(self.field.words(language).hint, way, language)

    def extract_number(self, value: float | tuple[str | float, ...] | Contact | Weld) -> float:
        """Returns its number of the field's value."""
        if isinstance(value, Contact | Weld):
            return 0.0 if value.plane is None else find_contact_factor(value) * value.plane.number
        if self.axis is None:
            return float(value)  # type: ignore[arg-type]
        return float(value[self.axis - len(self.field.axes)])  # type: ignore[index]  # behind a frame


CONTROL_BY_NAME = {
    control.name: control
    for field in SLIDER_FIELDS.values()
    if field.per != "joint"
    for control in (
        [Control(f"{field.address}_{axis}", field, at) for at, axis in enumerate(field.axes)]
        or [Control(field.address, field)]
    )
}
"""{name: slider} of all there are, by the names that the page's address has for them; those of
joints are the robot's (``live.joints``)."""


@dataclass(frozen=True)
class Range:
    """How a slider goes.

    Attributes:
        low: Where it begins.
        high: Where it ends.
        step: From notch to notch.
        value: Where it is on a page just opened.
    """

    low: float
    high: float
    step: float
    value: float


def make_slider_ranges(robot: Robot) -> dict[str, Range]:
    """Returns the range of each slider: in mm, degrees, kg and N m/rad.

    Lengths are parts of the height of the nominal stand, so that they suit a robot of any size.
    """
    found = {}
    for name, control in CONTROL_BY_NAME.items():
        field, slider = control.field, control.field.slider
        assert slider is not None  # or the page would not show it
        if field.kind in ("stiffness", "damping"):
            found[name] = _gain(field, slider, robot)
        elif field.kind == "angle":
            found[name] = Range(slider.low, slider.high, slider.step or 0.1, 0.0)
        else:
            found[name] = _span(field, slider, robot)
    return found


def _span(field: Field, slider: Slider, robot: Robot) -> Range:
    """Returns how a length goes, in parts of the robot's height; a mass, of its mass."""
    whole = robot.total_mass if field.kind == "mass" else 1e3 * robot.stand_height
    low, high = (math.copysign(round_up_slider_end(abs(end) * whole), end) if end else 0.0
                 for end in (slider.low, slider.high))  # fmt: skip
    step = choose_slider_step((slider.high - max(slider.low, 0.0)) * whole)
    value = 0.0 if field.nominal == "zero" else 1e3 * getattr(robot, field.nominal)
    if slider.start is not None:
        value = min(1e3 * slider.start, high)
    return Range(step if field.open and low == 0.0 else low, high, step, value)


def _gain(field: Field, slider: Slider, robot: Robot) -> Range:
    """Returns the range of a gain, around the model's own; 0 is no stiffness."""
    own = list_position_servos(robot)
    values = [gains[("kp", "kd").index(field.name)] for gains in own.values()]
    middle = float(np.median(values)) if values else 0.0
    middle = middle or slider.start or 1.0
    high = round_up_slider_end(8 * middle)
    low = choose_slider_step(high) if field.kind == "stiffness" else 0.0
    return Range(low, high, choose_slider_step(high), middle)


def choose_slider_step(span: float) -> float:
    """Returns a step of which a span has some hundreds: 1, 2 or 5 times a power of ten."""
    power = 10.0 ** math.floor(math.log10(span / 200))
    return next(factor * power for factor in (1.0, 2.0, 5.0, 10.0) if factor * power >= span / 400)


def round_up_slider_end(value: float) -> float:
    """Returns the next number of one digit, or of one and a half."""
    power = 10.0 ** math.floor(math.log10(value))
    factors = (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)
    return next(round(f * power, 9) for f in factors if f * power >= value * (1 - 1e-9))
