"""Sliders and buttons of a page, and the state that results from the values.

`make_slider_ranges` derives the range of each slider from the robot, and `Controls` creates the
sliders in viser's interface. Each change of a control results in a new `State`, in the units of the
page; `Controls.set_state` sets all controls to a state.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from pupper_analysis.base.arguments import check_finite
from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import Term, term
from pupper_analysis.base.diagnostics.templates import fill_template
from pupper_analysis.base.errors import PupperAnalysisError
from pupper_analysis.base.units import READ_IN
from pupper_analysis.cli.stance_fields import to_task_value
from pupper_analysis.present.formats import escape_control
from pupper_analysis.robot.joints import (
    find_footless_joints,
    joint_ranges,
    list_position_units,
    named_positions,
)
from pupper_analysis.robot.plane import Contact, Weld
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import list_position_servos
from pupper_analysis.stance.fields import FIELDS, Field, Slider
from pupper_analysis.tools.live.render import Translator
from pupper_analysis.tools.live.state import PAGE_UNITS, SLIDER_FIELDS, State, find_contact_factor

PLACE_LABELS = {"centre": "place-centre", "inside": "place-inside", "offset": "place-offset"}
"""{mode of the horizontal base position (`PLACE_MODES`): key of its label in the catalogue of
texts}."""

LIFT_SLIDER = "lift"
"""Name of the slider of the height of a lifted foot. Moving the slider lifts the foot."""


class Controls:
    """Sliders, fields and buttons of a page, with which the user requests a stance.

    Args:
        gui: viser's interface of the page.
        robot: Robot of the page before any change by the user.
        translator: Translator into the language of the page.
        changed: Function that is called after the user has changed a control, except the choice of
            the foot; also by `set_state` with ``notify``.
    """

    def __init__(
        self,
        gui: Any,
        robot: Robot,
        translator: Translator,
        changed: Callable[[], None],
    ) -> None:
        self._gui, self._translator, self._changed = gui, translator, changed
        self._robot = robot
        self._lock = threading.RLock()
        self._state = State()
        self._ranges = make_slider_ranges(robot)
        self._feet = {escape_control(foot): foot for foot in robot.feet}
        self.sliders: dict[str, Any] = {}

    def add_stance_controls(self) -> None:
        """Add the sliders and fields of a stance to the current container of viser."""
        gui, translator = self._gui, self._translator
        self._name_of_place = {translator(label): name for name, label in PLACE_LABELS.items()}
        for folder in _list_folders(FIELDS):
            with gui.add_folder(term(folder, translator.code)):
                if folder == "Where":
                    self.place = gui.add_dropdown(
                        translator("what-counts"), list(self._name_of_place)
                    )
                if folder == "Feet":
                    self.foot = gui.add_dropdown(
                        translator("foot"), list(self._feet), hint=translator("hint-foot")
                    )
                self._add_folder_sliders(folder, LIFT_SLIDER)
                if folder == "Feet":
                    self.lifted = gui.add_checkbox(
                        translator("lifted"), False, hint=translator("hint-lifted")
                    )
                    self._add_slider(CONTROL_BY_NAME[LIFT_SLIDER])
                    self.contacts = gui.add_text(
                        translator("contacts"), "", multiline=True, hint=translator("hint-contacts")
                    )
        self.place.on_update(
            self._make_callback(
                lambda s: s.with_values(place=self._name_of_place[self.place.value])
            )
        )
        self.lifted.on_update(self._make_callback(self._apply_lift))
        self.foot.on_update(self._on_foot_selected)
        self.contacts.on_update(self._make_callback(self._apply_contacts))

    def add_joint_controls(self) -> None:
        """Add the sliders of the joints that move no foot to the current container of viser."""
        gui, robot = self._gui, self._robot
        free, home = find_footless_joints(robot), robot.home[-robot.nu :]
        with gui.add_folder(term("Posture", self._translator.code), visible=bool(free)):
            self.posture = JointSliders(gui, robot, free, home, self._set_joint)

    def _set_joint(self, joint: str, position: float) -> None:
        """Set the position of a joint in the posture [rad or m], if the position is finite."""
        with self._lock, suppress(PupperAnalysisError):
            self._state = self._state.with_values(posture={**self._state.posture, joint: position})
        self._changed()

    def add_body_controls(self) -> None:
        """Add the sliders of payload and servo gains to the current container of viser."""
        gui, translator = self._gui, self._translator
        for folder in ("Payload", "Servos"):
            with gui.add_folder(term(folder, translator.code)):
                self._add_folder_sliders(folder)

    def _add_folder_sliders(self, folder: str, *excluded: str) -> None:
        """Add the sliders of a folder (group) of the page, except the slider names ``excluded``."""
        for name, control in CONTROL_BY_NAME.items():
            if name not in excluded and _find_folder(control.field) == folder:
                self._add_slider(control)

    def _add_slider(self, control: Control) -> None:
        """Add one slider, which ``control`` describes, to the current container of viser."""
        span, code = self._ranges[control.name], self._translator.code
        handle = self._gui.add_slider(
            control.label(code),
            span.low,
            span.high,
            span.step,
            _clamp_to_range(span, span.value),
            hint=control.hint(code),
        )
        handle.on_update(self._make_callback(partial(self._apply_slider, control)))
        self.sliders[control.name] = handle

    def _make_callback(self, change: Callable[[State], State]) -> Callable[[Any], None]:
        """Return a callback for viser that changes the state when the user moves a control.

        The new state is ``change(state)``.
        """

        def moved(event: Any) -> None:
            if event.client is None:
                return
            with self._lock:
                before = self._state
                with suppress(PupperAnalysisError):  # not a valid number
                    self._state = change(before)
                if self._state.place != before.place:
                    self._show_place()
                if self._state.contacts != before.contacts:
                    self._show_contacts(typed=event.target is self.contacts)
            self._changed()

        return moved

    def _apply_slider(self, control: Control, state: State) -> State:
        """Return ``state`` with the value that the slider of a control has on the page."""
        field = control.field
        value = check_finite(control.name, float(self.sliders[control.name].value))
        # A typed value may exceed the range of the slider and would be clipped later.
        self._move_slider(control.name, value)
        if control.name == LIFT_SLIDER:  # setting the height lifts the foot
            self.lifted.value = True
        field_value = getattr(state, field.name)
        current = field_value.get(self._selected_foot) if field.per else field_value
        if field.kind == "contact":
            if not isinstance(current, Contact):  # the foot is on the ground
                return state
            new_value: Any = current.with_plane_parameter(value / find_contact_factor(current))
        elif control.axis is not None:
            numbers = list(current or (0.0,) * len(field.axes))
            numbers[control.axis - len(field.axes)] = value  # the name of a frame may precede
            new_value = tuple(numbers)
        else:
            new_value = value
        state = state.with_values(
            **{
                field.name: {**field_value, self._selected_foot: new_value}
                if field.per
                else new_value
            }
        )
        return state.with_values(place="offset") if field.name == "offset" else state

    def _apply_lift(self, state: State) -> State:
        """Return the state with the selected foot lifted, or on the ground."""
        swing = {
            foot: height for foot, height in state.swing.items() if foot != self._selected_foot
        }
        if self.lifted.value:
            swing[self._selected_foot] = float(self.sliders[LIFT_SLIDER].value)
        return state.with_values(swing=swing)

    def _apply_contacts(self, state: State) -> State:
        """Return the state with the contacts that the text field of the page contains.

        A line of the text field is ``LINK=CONTACT``.
        """
        lines = filter(str.strip, self.contacts.value.splitlines())
        return state.with_values(contacts=to_task_value(FIELDS["contacts"], [*lines]))

    def _show_contacts(self, *, typed: bool) -> None:
        """Update the list of feet, and the text field of contacts, from the stance.

        The text field is left unchanged if ``typed`` is True, because the user is typing there.
        """
        contacts = self._state.contacts
        if not typed:
            self.contacts.value = "\n".join(
                f"{link}={contact}" for link, contact in contacts.items()
            )
        planes = (link for link, contact in contacts.items() if contact.plane is not None)
        self._feet = {escape_control(foot): foot for foot in (*self._robot.feet, *planes)}
        if [*self.foot.options] != [*self._feet]:
            self.foot.options = [*self._feet]
        self._show_foot()

    @property
    def _selected_foot(self) -> str:
        """Name of the foot, or of another part with a plane, whose sliders are shown."""
        return self._feet[self.foot.value]

    def _on_foot_selected(self, _event: Any) -> None:
        """Show the values of the newly selected foot."""
        with self._lock:
            self._show_foot()

    @property
    def state(self) -> State:
        """State that the user has requested with the controls, in the units of the page."""
        with self._lock:
            return self._state

    def set_state(self, state: State, *, notify: bool) -> None:
        """Set the controls of the page to the values of a state, in the units of the page.

        If ``notify``, the callback for changes of the state is called.
        """
        with self._lock:
            self._state = state
            for name in self.sliders:
                if not CONTROL_BY_NAME[name].field.per:
                    self._move_slider(name, self._slider_value(state, CONTROL_BY_NAME[name]))
            special = {
                foot
                for name, field in FIELDS.items()
                if field.per in ("foot", "link") and field.slider
                for foot in getattr(state, name)
            }
            self._show_contacts(typed=False)
            first = next((name for name, foot in self._feet.items() if foot in special), None)
            if first is not None and self._selected_foot not in special:
                self.foot.value = first
            self._show_place()
            self._show_foot()
            self.posture.show(self._find_posture(state))
        if notify:
            self._changed()

    def _slider_value(self, state: State, control: Control) -> float:
        """Return the value of a slider in a state [page units]; if unset, its initial value."""
        value = getattr(state, control.field.name)
        return self._ranges[control.name].value if value is None else control.extract_number(value)

    def _move_slider(self, name: str, value: float) -> None:
        """Set a slider to a value in the units of the page; extend its range if necessary."""
        handle = self.sliders[name]
        if value < handle.min:
            handle.min = value
        if value > handle.max:
            handle.max = value
        handle.value = value

    def _show_place(self) -> None:
        """Show the mode of the horizontal base position in the dropdown list."""
        self.place.value = self._translator(PLACE_LABELS[self._state.place])

    def _find_posture(self, state: State) -> Mapping[str, float]:
        """Return {joint: position [rad or m]} of the posture of a state.

        Empty if the robot does not accept the posture: the result of the solver has the error.
        """
        try:
            return named_positions(self._robot, state.posture)
        except PupperAnalysisError:  # the result contains the error
            return {}

    def _show_foot(self) -> None:
        """Set the foot controls to the selected foot's values, or the initial values if unset."""
        foot, state = self._selected_foot, self._state
        self.lifted.value = foot in state.swing
        for name in self.sliders:
            control = CONTROL_BY_NAME[name]
            if control.field.per:
                values = getattr(state, control.field.name)
                default = self._ranges[name].value
                self._move_slider(
                    name, control.extract_number(values[foot]) if foot in values else default
                )


def _list_folders(fields: Mapping[str, Field]) -> list[str]:
    """Return the page folders that contain the sliders of fields, except joint sliders."""
    return list(
        dict.fromkeys(
            field.slider.folder
            for field in fields.values()
            if field.slider and field.per != "joint"
        )
    )


def _find_folder(field: Field) -> str:
    """Return the name of the page folder that contains a field's slider; "" without a slider."""
    return field.slider.folder if field.slider else ""


def _clamp_to_range(span: Range, value: float) -> float:
    """Return a slider value rounded to two decimals, then clipped to the range ``span``."""
    return min(max(round(value, 2), span.low), span.high)


# Sliders of the joints of a posture.


_UNLIMITED_BOUND = {"rad": math.pi, "m": 1.0}
"""{unit of a joint: largest magnitude of the ends of its slider [rad or m]}. Used if the joint has
no limit, or a larger limit. Chosen, not tuned."""

_JOINT_STEP = 0.5
"""Step of a joint slider [deg or mm], unless the joint's range is too small. Chosen, not tuned."""

_SLIDER_DIGITS = 2
"""Number of decimals to which the program rounds the value of a joint slider [deg or mm]. Chosen,
not tuned."""

_POSITION_DIGITS = 6
"""Number of decimals to which a joint position [rad or m] from a slider is rounded. Chosen, not
tuned."""


class JointSliders:
    """Sliders of joints, in degrees, or in mm for prismatic joints.

    Args:
        gui: viser's interface of the page.
        robot: Robot.
        joints: Names of the joints.
        start: Initial joint positions, shape (nu,) [rad or m].
        moved: Function that is called with a joint and the position [rad or m] after a change by
            the user.

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
        ranges, units = joint_ranges(robot), list_position_units(robot)
        for name in joints:
            index = robot.joint_names.index(name)
            (scale, unit), unlimited_bound = READ_IN[units[index]], _UNLIMITED_BOUND[units[index]]
            limits = np.clip(ranges[index], -unlimited_bound, unlimited_bound) * scale
            # Rounded inwards, so that a slider does not exceed the limits of its joint. A range
            # with fewer than two multiples of the step is not rounded.
            low, high = (
                math.ceil(limits[0] / _JOINT_STEP) * _JOINT_STEP,
                math.floor(limits[1] / _JOINT_STEP) * _JOINT_STEP,
            )
            step = _JOINT_STEP
            if high <= low:
                low, high = map(float, limits)
                step = high - low or _JOINT_STEP  # a joint without range keeps a slider
            value = float(np.clip(round(float(start[index]) * scale, _SLIDER_DIGITS), low, high))
            name_and_unit = f"{escape_control(name)} ({unit})"
            slider = gui.add_slider(name_and_unit, low, max(high, low + step), step, value)
            slider.on_update(partial(self._on_moved, name))
            self.sliders[name], self._scales[name] = slider, scale
        self._initial_values = {name: slider.value for name, slider in self.sliders.items()}

    def _on_moved(self, joint: str, event: Any) -> None:
        """Pass a joint and the position [rad or m] that the user has set to the page's callback."""
        if event.client is not None:  # not a change by the program
            value = float(self.sliders[joint].value) / self._scales[joint]
            self._moved(joint, round(value, _POSITION_DIGITS) + 0.0)  # never -0

    def show(self, positions: Mapping[str, float]) -> None:
        """Set sliders to given joint positions [rad or m], other sliders to the initial value.

        Values beyond the range of a slider are clipped.
        """
        for joint, slider in self.sliders.items():
            value = self._initial_values[joint]
            if joint in positions:
                value = round(positions[joint] * self._scales[joint], _SLIDER_DIGITS)
            value = min(max(value, slider.min), slider.max)
            if slider.value != value:
                slider.value = value


# Sliders of a page, and their ranges for a robot.

_AXIS_TERMS = {"x": Term("forward"), "y": Term("to the left"), "z": Term("up")}
"""{axis of a point: term for its positive direction}, for the labels of sliders."""


@dataclass(frozen=True)
class Control:
    """Description of a slider of the page: a field of the state, or a coordinate of a point.

    Attributes:
        name: Name, for example ``roll`` or ``offset_x``.
        field: Field of the state.
        axis: Index of the coordinate of a point; None for a number.
    """

    name: str
    field: Field
    axis: int | None = None

    def label(self, language: str) -> str:
        """Return the label of the slider with its unit, in the language ``en`` or ``zh``."""
        unit, _ = PAGE_UNITS[self.field.kind]
        axis = "" if self.axis is None else f" {self.field.axes[self.axis]}"
        return f"{self.field.words(language).label}{axis}" + (f" ({unit})" if unit else "")

    def hint(self, language: str) -> str:
        """Return the help text of the slider, in the language ``en`` or ``zh``."""
        arguments = {} if self.axis is None else {"axis": _AXIS_TERMS[self.field.axes[self.axis]]}
        return fill_template(self.field.words(language).hint, arguments, language)

    def extract_number(self, value: float | tuple[str | float, ...] | Contact | Weld) -> float:
        """Return the number that this slider shows for a value of its field.

        Args:
            value: Number or point in the units of the web page (`PAGE_UNITS`, for example mm and
                degrees), or a contact or weld in SI units.

        Returns:
            Number in the units of the page. For a contact it is ``plane.parameter`` [mm, or degrees
            for a slope]; 0 for a contact without a plane, and for a weld.
        """
        if isinstance(value, Contact | Weld):
            return (
                0.0 if value.plane is None else find_contact_factor(value) * value.plane.parameter
            )
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
"""{name of a slider: slider}, without the sliders of joints. The name is `Field.address`, followed
by the axis for an element of a point."""


@dataclass(frozen=True)
class Range:
    """Range, step and initial value of a slider, in the units of the page.

    Attributes:
        low: Lower bound.
        high: Upper bound.
        step: Step.
        value: Initial value.
    """

    low: float
    high: float
    step: float
    value: float


def make_slider_ranges(robot: Robot) -> dict[str, Range]:
    """Return {name of a slider: range}, in the units of the page.

    Most ends are proportional to size, mass or gains of the robot, and rounded up. Sliders of
    joints are not included.
    """
    ranges = {}
    for name, control in CONTROL_BY_NAME.items():
        field, slider = control.field, control.field.slider
        assert slider is not None  # fields on the page have a slider
        if field.kind in ("stiffness", "damping"):
            ranges[name] = _make_gain_range(field, slider, robot)
        elif field.kind == "angle":
            ranges[name] = Range(slider.low, slider.high, slider.step or 0.1, 0.0)
        else:
            ranges[name] = _make_length_range(field, slider, robot)
    return ranges


def _make_length_range(field: Field, slider: Slider, robot: Robot) -> Range:
    """Return the slider range of a length [mm] or mass [kg], proportional to the robot.

    ``slider`` states the ends relative to the robot's stand height or mass.
    """
    scale = robot.total_mass if field.kind == "mass" else 1e3 * robot.stand_height
    low, high = (math.copysign(round_up_slider_end(abs(bound) * scale), bound) if bound else 0.0
                 for bound in (slider.low, slider.high))  # fmt: skip
    step = choose_slider_step((slider.high - max(slider.low, 0.0)) * scale)
    value = 0.0 if field.nominal == "zero" else 1e3 * getattr(robot, field.nominal)
    if slider.start is not None:
        value = min(1e3 * slider.start, high)
    return Range(step if field.open and low == 0.0 else low, high, step, value)


def _make_gain_range(field: Field, slider: Slider, robot: Robot) -> Range:
    """Return the slider range of a servo gain, up to about 8 times the median of the model's gains.

    Without a positive median, a fixed value replaces the median.
    """
    servos = list_position_servos(robot)
    values = [gains[("kp", "kd").index(field.name)] for gains in servos.values()]
    median = float(np.median(values)) if values else 0.0
    median = median or slider.start or 1.0
    high = round_up_slider_end(8 * median)
    low = choose_slider_step(high) if field.kind == "stiffness" else 0.0
    return Range(low, high, choose_slider_step(high), median)


def choose_slider_step(span: float) -> float:
    """Return the step of a slider, 1, 2 or 5 x 10^k, that divides its range into 160 to 400 steps.

    ``span`` is the length of the range, in the unit of the slider.
    """
    power = 10.0 ** math.floor(math.log10(span / 200))
    return next(factor * power for factor in (1.0, 2.0, 5.0, 10.0) if factor * power >= span / 400)


def round_up_slider_end(value: float) -> float:
    """Return the smallest number 1, 1.5, 2, 3, 4, 5, 6 or 8 x 10^k of at least ``value``."""
    power = 10.0 ** math.floor(math.log10(value))
    factors = (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)
    return next(round(f * power, 9) for f in factors if f * power >= value * (1 - 1e-9))
