"""Plausible mistakes in the MJCF of a robot that stands: signs, factors of ten, units, swapped
values.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np

from tests.support import legged

Slip = Callable[[str, np.random.Generator], str]
"""Function that makes a mistake in the text of an MJCF, in a place that a generator chooses."""


def standing(folder: Path, **options: object) -> legged.Pair:
    """Write a quadruped of 8.4 kg that stands on its servos, on a floor; its keyframe has ctrl."""
    pair = legged.quadruped(folder, actuators="position", floor=True, **options)  # type: ignore[arg-type]
    text = pair.mjcf.read_text()
    text = text.replace("<worldbody>", '<option integrator="implicitfast"/><worldbody>', 1)
    text = text.replace('"/></keyframe>', f'" ctrl="{" ".join(["0 0.6 -1.2"] * 4)}"/></keyframe>')
    text = text.replace("/><position", "/>\n<position").replace("<geom ", "\n<geom ")
    pair.mjcf.write_text(text)
    return pair


def _edit_number(attribute: str, change: Callable[[float], float], *, one: bool) -> Slip:
    """Return an edit of an attribute with a single number, in one random place or in all."""

    def slip(text: str, random: np.random.Generator) -> str:
        found = list(re.finditer(rf'(?<=\b{attribute}=")[-+.\de]+(?=")', text))
        chosen = [found[int(random.integers(len(found)))]] if one and found else found
        for match in reversed(chosen):
            value = f"{change(float(match[0])):.9g}"
            text = text[: match.start()] + value + text[match.end() :]
        return text

    return slip


def _edit_list(attribute: str, change: Callable[[list[float], np.random.Generator], None]) -> Slip:
    """Return an edit of an attribute with several numbers, in one random place."""

    def slip(text: str, random: np.random.Generator) -> str:
        found = list(re.finditer(rf'(?<=\b{attribute}=")[^"]+(?=")', text))
        if not found:
            return text
        match = found[int(random.integers(len(found)))]
        values = [float(word) for word in match[0].split()]
        change(values, random)
        return text[: match.start()] + " ".join(f"{v:.9g}" for v in values) + text[match.end() :]

    return slip


def _replace_text(old: str, new: str, *, one: bool = False) -> Slip:
    """Return an edit that replaces a text once or everywhere."""
    return lambda text, _: text.replace(old, new, 1 if one else -1)


def _change_sign(values: list[float], random: np.random.Generator) -> None:
    """Change the sign of one random value."""
    index = int(random.integers(len(values)))
    values[index] = -values[index]


def _swap_values(values: list[float], random: np.random.Generator) -> None:
    """Exchange two random values."""
    first, second = random.choice(len(values), 2, replace=False)
    values[first], values[second] = values[second], values[first]


def _convert_to_degrees(values: list[float], _: np.random.Generator) -> None:
    """Convert values from rad to degrees."""
    values[:] = [math.degrees(value) for value in values]


def _divide_by_ten(values: list[float], random: np.random.Generator) -> None:
    """Divide one random value by ten."""
    values[int(random.integers(len(values)))] /= 10


def _other_joint(text: str, random: np.random.Generator) -> str:
    """Exchange the joints of two random actuators."""
    joints = re.findall(r'<position joint="(\w+)"', text)
    first, second = (str(joint) for joint in random.choice(joints, 2, replace=False))
    text = text.replace(f'<position joint="{first}"', "<position joint=\0")
    text = text.replace(f'<position joint="{second}"', f'<position joint="{first}"')
    return text.replace("<position joint=\0", f'<position joint="{second}"')


SLIPS: dict[str, Slip] = {
    "kp of one has the wrong sign": _edit_number("kp", lambda v: -v, one=True),
    "kp is 0": _edit_number("kp", lambda _: 0.0, one=False),
    "kp is a thousandth": _edit_number("kp", lambda v: v / 1000, one=False),
    "kp is ten times": _edit_number("kp", lambda v: v * 10, one=False),
    "kv has the wrong sign": _edit_number("kv", lambda v: -v, one=False),
    "kv of one has the wrong sign": _edit_number("kv", lambda v: -v, one=True),
    "kv is ten times": _edit_number("kv", lambda v: v * 10, one=False),
    "gear of all is -1": _replace_text('kp="150"', 'gear="-1" kp="150"'),
    "gear is 10": _replace_text('kp="150"', 'gear="10" kp="150"'),
    "timeconst is milliseconds": _replace_text('kp="150"', 'timeconst="20" kp="150"'),
    "forcerange is a tenth": _replace_text('kp="150"', 'forcerange="-0.5 0.5" kp="150"'),
    "actuators have another joint": _other_joint,
    "ctrl of one has the wrong sign": _edit_list("ctrl", _change_sign),
    "ctrl of two is swapped": _edit_list("ctrl", _swap_values),
    "ctrl is in degrees": _edit_list("ctrl", _convert_to_degrees),
    "ctrl of one is a tenth": _edit_list("ctrl", _divide_by_ten),
    "ctrl is of lying down": _replace_text(
        'ctrl="' + " ".join(["0 0.6 -1.2"] * 4), 'ctrl="' + " ".join(["0 1.5 -2.6"] * 4)
    ),
    "qpos of one has the wrong sign": _edit_list("qpos", _change_sign),
    "qpos of two is swapped": _edit_list("qpos", _swap_values),
    "a range is in degrees": _edit_list("range", _convert_to_degrees),
    "an axis has the wrong sign": _edit_list("axis", lambda v, _: v.__setitem__(1, -1.0)),
    "a mass is ten times": _edit_number("mass", lambda v: v * 10, one=True),
    "negative damping": _replace_text('axis="0 1 0"', 'axis="0 1 0" damping="-6"'),
    "damping is a thousand times": _replace_text('axis="0 1 0"', 'axis="0 1 0" damping="500"'),
    "dry friction is in N mm": _replace_text('axis="0 1 0"', 'axis="0 1 0" frictionloss="50"'),
    "contact parameters are overridden": _replace_text(
        "<option ", '<option o_solref="2 1"><flag override="enable"/></option><option '
    ),
    "a foot is excluded": _replace_text(
        "<actuator>", '<contact><exclude body1="world" body2="FL_calf"/></contact><actuator>'
    ),
    "the floor is slippery": _replace_text(
        '<geom type="plane"', '<geom priority="1" friction="0.02" type="plane"'
    ),
}
"""{description: function that makes this mistake in an MJCF, in a place that a generator chooses}.
"""
