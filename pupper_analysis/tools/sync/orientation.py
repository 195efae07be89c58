"""Orientations in the forms that the files have: rpy, quaternions, Euler angles, axes."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Final

import mujoco
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.base.arrays import rotation_from_quaternion
from pupper_analysis.models.urdf_tree import origin_of
from pupper_analysis.models.xml import parse_numbers
from pupper_analysis.tools.sync.digits import Digits
from pupper_analysis.tools.sync.xml_bytes import Element

Array = NDArray[np.float64]

FORMS: Final = ("quat", "axisangle", "euler", "xyaxes", "zaxis")
"""The attributes of an MJCF that state an orientation."""


@dataclass(frozen=True)
class AngleUnits:
    """What an MJCF's compiler says of angles.

    Attributes:
        degrees: Whether angles are degrees.
        eulerseq: The order of Euler angles, small letters for axes that turn along.
    """

    degrees: bool
    eulerseq: str

    @property
    def factor(self) -> float:
        """Of a number in the file to radians."""
        return float(np.pi / 180) if self.degrees else 1.0


def origin_changes(owner: Element | None, pose: pin.SE3, digits: Digits) -> dict[str, str]:
    """Returns the attributes of a URDF's <origin> that must change for it to state a pose.

    Args:
        owner: The element that it is in, or is to be put into.
        pose: The pose.
        digits: Writes the numbers.
    """
    changes = {}
    element = None if owner is None else owner.find("origin")
    xyz = None if element is None else element.get("xyz")
    text = digits.words((xyz or "0 0 0").split(), np.array(pose.translation), 1.0)
    if text is not None:
        changes["xyz"] = text
    rotation = np.array(pose.rotation)
    if float(np.abs(np.array(origin_of(owner).rotation) - rotation).max()) > 1e-12:
        rpy = None if element is None else element.get("rpy")
        near = parse_numbers(rpy, "0 0 0")
        text = digits.words((rpy or "0 0 0").split(), _angles("XYZ", rotation, near), 1.0)
        if text is not None:
            changes["rpy"] = text
    return changes


def stated_rotation(element: Element, units: AngleUnits) -> Array:
    """Returns the orientation that an MJCF's element states, by MuJoCo's own reading."""
    form = stated_orientation(element)
    if form is None:
        return np.eye(3)
    angle = "degree" if units.degrees else "radian"
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><compiler angle="{angle}" eulerseq="{units.eulerseq}"/>'
        f'<worldbody><site {form}="{element.get(form)}"/></worldbody></mujoco>'
    )
    return rotation_from_quaternion(model.site_quat[0])


def stated_orientation(element: Element) -> str | None:
    """Returns the attribute by which an MJCF's element states its orientation itself."""
    return next((form for form in FORMS if element.get(form) is not None), None)


def orientation_change(
    element: Element, now: Array, wanted: Array, units: AngleUnits, digits: Digits
) -> dict[str, str]:
    """Returns what must change for an element of an MJCF to have another orientation.

    Args:
        element: The element.
        now: (3, 3) what it has.
        wanted: (3, 3) what it shall have.
        units: Of the file.
        digits: Writes the numbers.
    """
    if float(np.abs(now - wanted).max()) <= 1e-12:
        return {}
    form = stated_orientation(element) or "quat"
    old = parse_numbers(element.get(form), "1 0 0 0" if form == "quat" else "")
    if form == "axisangle":
        vector = pin.log3(wanted)
        angle = float(np.linalg.norm(vector))
        axis = vector / angle if angle else np.array([0.0, 0.0, 1.0])
        if float(axis @ old[:3]) < 0:
            axis, angle = -axis, -angle
        values = np.array([*axis, angle / units.factor])
    elif form == "euler":
        values = _angles(units.eulerseq, wanted, old * units.factor) / units.factor
    elif form == "xyaxes":
        values = wanted.T[:2].flatten()
    else:
        x, y, z, w = pin.Quaternion(wanted).coeffs()
        values = np.array([w, x, y, z])
        if form == "quat" and float(values @ old) < 0:
            values = -values
    text = digits.words((element.get(form) or "").split() if form != "zaxis" else [], values, 1.0)
    # A direction of z leaves the turn about it open, so that a quaternion takes its place.
    return {} if text is None else {"quat" if form == "zaxis" else form: text}


def _composed(sequence: str, angles: Array) -> Array:
    """Returns the rotation of MuJoCo's Euler angles: small letters turn along, great ones not."""
    result = np.eye(3)
    for letter, angle in zip(sequence, angles, strict=True):
        turn = pin.exp3(float(angle) * np.eye(3)["xyz".index(letter.lower())])
        result = result @ turn if letter.islower() else turn @ result
    return result


def _angles(sequence: str, rotation: Array, near: Array) -> Array:
    """Returns Euler angles of a rotation, near others; also where they are not unique.

    Newton's method with the least step: where the first and the last axis are one, it changes
    what it must. It begins at the others, and then at quarter turns.
    """
    quarters = (np.pi / 2) * np.array(list(itertools.product((0, 1, -1, 2), repeat=3)), dtype=float)
    best, least = near, np.inf
    for start in (near, *quarters):
        angles = np.array(start)
        for _ in range(30):
            made = _composed(sequence, angles)
            error = pin.log3(made.T @ rotation)
            size = float(np.linalg.norm(error))
            if size < least:
                best, least = np.array(angles), size
            if size < 1e-15:
                break
            columns = [
                pin.log3(made.T @ _composed(sequence, angles + 1e-6 * unit)) / 1e-6
                for unit in np.eye(3)
            ]
            angles = angles + np.linalg.lstsq(np.array(columns).T, error, rcond=1e-5)[0]
        if least < 1e-13:
            break
    return best + 2 * np.pi * np.round((near - best) / (2 * np.pi))
