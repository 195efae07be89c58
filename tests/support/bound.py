"""Quadrupeds whose knees are driven by remote motors: by a belt, or by the rod of a four-bar
linkage.
"""

from __future__ import annotations

import math
from pathlib import Path
from xml.etree import ElementTree

from tests.support.legged import Pair, _make_joint, _make_link, quadruped

LEGS = ("FL", "FR", "RL", "RR")
ARM = 0.05
"""Length of the crank, and of the lever on the calf [m]."""
CRANK_ANGLE = 1.2
"""Angle of crank and lever at zero joint angles [rad]: perpendicular to the rod at a knee angle of
-1.2."""
ROD = 0.2
"""Length of the rod [m]."""


def belts(
    folder: Path,
    polynomial: tuple[float, ...] = (-0.2, -0.8),
    *,
    words: str = 'solref="0.01 1"',
    in_mjcf: bool = True,
) -> Pair:
    """Write a quadruped whose knees follow motors in the thighs: q_knee = a0 + a1 q_motor + ...

    The URDF contains a ``<mimic>``, the MJCF an equality.
    """
    pair = quadruped(folder)
    urdf, mjcf = ElementTree.parse(pair.urdf).getroot(), ElementTree.parse(pair.mjcf).getroot()
    equality = ElementTree.SubElement(mjcf, "equality")
    for leg in LEGS:
        place = (0.0, 0.02, -0.03)
        _add_element(urdf, _make_link(f"{leg}_pulley", 0.1, (2e-4, 2e-4, 3e-4)))
        names = f"{leg}_motor", f"{leg}_thigh", f"{leg}_pulley"
        _add_element(urdf, _make_joint(*names, place, "0 1 0", (-4, 4)))
        _add_element(
            _find_named(urdf, "joint", f"{leg}_knee"),
            f'<mimic joint="{leg}_motor" multiplier="{polynomial[1]}" offset="{polynomial[0]}"/>',
        )
        _add_element(
            _find_named(mjcf, "body", f"{leg}_thigh"),
            _make_rotating_body(f"{leg}_pulley", f"{leg}_motor", place),
        )
        numbers = " ".join(map(str, polynomial))
        if not in_mjcf:
            continue
        _add_element(
            equality,
            f'<joint joint1="{leg}_knee" joint2="{leg}_motor" polycoef="{numbers}" {words}/>',
        )
    return _write_pair(pair, urdf, mjcf)


def four_bars(
    folder: Path,
    crank: float = ARM,
    *,
    words: str = 'solref="0.005 1"',
    in_urdf: bool = True,
) -> Pair:
    """Write a quadruped whose knees are driven by rods from cranks at the hips.

    The URDF contains the tree without loop closures. A crank as long as the lever makes a
    parallelogram.
    """
    pair = quadruped(folder)
    urdf, mjcf = ElementTree.parse(pair.urdf).getroot(), ElementTree.parse(pair.mjcf).getroot()
    equality = ElementTree.SubElement(mjcf, "equality")
    x, z = -math.cos(CRANK_ANGLE), math.sin(CRANK_ANGLE)
    end = (crank * x, 0.0, crank * z)
    rod = ((ARM - crank) * x, 0.0, -ROD + (ARM - crank) * z)
    half = f"{rod[0] / 2} 0 {rod[2] / 2}"
    for leg in LEGS:
        out = (0.0, 0.05 if leg[1] == "L" else -0.05, 0.0)
        if in_urdf:
            _add_element(urdf, _make_link(f"{leg}_crank", 0.1, (2e-4, 2e-4, 3e-4)))
            names = f"{leg}_motor", f"{leg}_hip", f"{leg}_crank"
            _add_element(urdf, _make_joint(*names, out, "0 1 0", (-3, 3)))
            centre = (rod[0] / 2, 0.0, rod[2] / 2)
            _add_element(urdf, _make_link(f"{leg}_rod", 0.05, (2e-4, 2e-4, 2e-5), centre))
            _add_element(
                urdf, _make_joint(f"{leg}_pin", f"{leg}_crank", f"{leg}_rod", end, "0 1 0", (-3, 3))
            )
        held = f"""<body name="{leg}_rod" pos="{end[0]} 0 {end[2]}">
            <inertial pos="{half}" mass="0.05" diaginertia="2e-4 2e-4 2e-5"/>
            <joint name="{leg}_pin" axis="0 1 0" range="-3 3"/></body>"""
        _add_element(
            _find_named(mjcf, "body", f"{leg}_hip"),
            _make_rotating_body(f"{leg}_crank", f"{leg}_motor", out, held),
        )
        anchor = f'anchor="{rod[0]} 0 {rod[2]}"'
        bodies = f'body1="{leg}_rod" body2="{leg}_calf"'
        _add_element(equality, f"<connect {bodies} {anchor} {words}/>")
    return _write_pair(pair, urdf, mjcf)


def _make_rotating_body(body: str, joint: str, place: tuple[float, ...], within: str = "") -> str:
    """Return the ``<body>`` of an MJCF with a hinge about y."""
    x, y, z = place
    return f"""<body name="{body}" pos="{x} {y} {z}">
        <inertial pos="0 0 0" mass="0.1" diaginertia="2e-4 2e-4 3e-4"/>
        <joint name="{joint}" armature="0.01" axis="0 1 0" range="-4 4"/>{within}</body>"""


def _find_named(root: ElementTree.Element, tag: str, name: str) -> ElementTree.Element:
    """Return the element with a tag and a name."""
    return next(element for element in root.iter(tag) if element.get("name") == name)


def _add_element(parent: ElementTree.Element, text: str) -> None:
    """Add an element, given as XML text, to another."""
    parent.append(ElementTree.fromstring(text))


def _write_pair(pair: Pair, urdf: ElementTree.Element, mjcf: ElementTree.Element) -> Pair:
    """Move the motors of the knees to the driving joints, and write both files."""
    for motor in mjcf.iterfind("actuator/*"):
        motor.set("joint", str(motor.get("joint")).replace("_knee", "_motor"))
    for key in mjcf.findall("keyframe"):
        mjcf.remove(key)
    pair.urdf.write_text(ElementTree.tostring(urdf, encoding="unicode"))
    pair.mjcf.write_text(ElementTree.tostring(mjcf, encoding="unicode"))
    return pair
