"""Writes the gains of position servos into an MJCF, in the words in which it states them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.models.transmission import actuator_gear, drives_of
from pupper_analysis.models.xml_bytes import Element
from pupper_analysis.robot.servos import own_servos
from pupper_analysis.tools.sync.frames import Key

if TYPE_CHECKING:
    from pupper_analysis.tools.sync.mjcf_side import MjcfSide


def write_gains(side: MjcfSide, name: str, wanted: dict[Key, float]) -> None:
    """Notes the changes that give the servo of a joint other gains.

    Args:
        side: The MJCF.
        name: The joint.
        wanted: {("kp", joint): stiffness at the joint (N m/rad), ("kd", joint): damping there}.
    """
    model = side.model
    drives = drives_of(model, model.joint(name).id)
    elements = side.elements.drives(name)
    now = own_servos(side.robot).get(name)
    if now is None or len(drives) != 1:
        side.left.update(dict.fromkeys(wanted, diagnose("joint-without-one-servo")))
        return
    if len(elements) != 1:
        side.left.update(dict.fromkeys(wanted, diagnose("actuators-are-copies")))
        return
    squared = float(actuator_gear(model, drives[0])[0]) ** 2
    stiffness = wanted.get(("kp", name), now[0]) / squared
    damping = wanted.get(("kd", name), now[1]) / squared
    (element,) = elements
    if element.tag == "position":
        _position(side, element, name, wanted, stiffness, damping)
    elif element.tag == "general":
        key = next(iter(wanted))
        gain = _padded(element, "gainprm", [stiffness])
        side.write(key, element, "gainprm", gain)
        side.write(key, element, "biasprm", _padded(element, "biasprm", [0, -stiffness, -damping]))
    else:
        told = diagnose("servo-without-words", tag=element.tag)
        side.left.update(dict.fromkeys(wanted, told))


def _position(
    side: MjcfSide,
    element: Element,
    name: str,
    wanted: dict[Key, float],
    stiffness: float,
    damping: float,
) -> None:
    if ("kp", name) in wanted:
        side.write(("kp", name), element, "kp", stiffness)
    if ("kd", name) in wanted:
        text = side.digits.words((element.get("kv") or "").split(), np.array([damping]))
        if text is not None:  # a ratio of damping gives way to a damping
            element.rename_or_set("dampratio", "kv", text)


def _padded(element: Element, attribute: str, values: list[float]) -> list[float]:
    """Returns the parameters of an actuator with those behind them that the file states."""
    stated = [float(word) for word in (element.get(attribute) or "").split()]
    return [*values, *stated[len(values) :]]
