"""Small legged robots as URDF and MJCF, in the form in which others publish robots.

By default the feet have no named frames, the actuators are motors and the MJCF has no floor.
Functions that take a ``Pair`` change its files in place and return it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np


class Pair(NamedTuple):
    """Paths of the URDF and the MJCF of one robot."""

    urdf: Path
    mjcf: Path


def rewrite_file(path: Path, *changes: tuple[str, str], count: int = -1) -> Path:
    """Replace texts in a file, which must occur, at most ``count`` times each (-1: everywhere)."""
    text = path.read_text()
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new, count)
    path.write_text(text)
    return path


def edited_by(path: Path, edit: Callable[[str], str]) -> Path:
    """Apply a function to the text of a file; the text must change."""
    text = path.read_text()
    changed = edit(text)
    assert changed != text
    path.write_text(changed)
    return path


def quadruped_with_slides(folder: Path) -> Path:
    """Write the MJCF of a quadruped whose knees are vertical slides with a range of 0.2 m.

    Position servos: kp 1500 N m/rad or N/m, kv 5, and at most 60 N m or N.
    """
    mjcf = quadruped(folder, floor=True, actuators="position", keyframe="").mjcf
    knee = r'(name="\w+_knee") axis="0 1 0" range="-2.6 -0.4"'
    slide = r'\1 type="slide" axis="0 0 1" range="-0.1 0.1"'
    edited_by(mjcf, lambda text: re.sub(knee, slide, text))
    return rewrite_file(mjcf, ('kp="150"', 'kp="1500" forcerange="-60 60"'))


BOX = '<geom {name} type="box" size="0.08 0.04 0.01" pos="0.02 0 -0.03"/>'
"""Box as an additional geom of a body, a format string with the attribute ``name``."""


def quadruped(
    folder: Path,
    *,
    foot: str = '<geom type="sphere" size="0.02" pos="0 0 -0.2"/>',
    prefix: str = "",
    floor: bool = False,
    free: bool = True,
    actuators: str = "motor",
    keyframe: str = "0 0.6 -1.2",
    head: bool = False,
) -> Pair:
    """Write a quadruped with three hinges per leg: roll, pitch, pitch; both segments are 0.2 m
    long.

    Args:
        folder: Folder of the two files.
        foot: Geoms of each calf in the MJCF.
        prefix: Prefix of the names of bodies and joints in the MJCF.
        floor: Whether the MJCF has a plane.
        free: Whether the trunk has a free joint; without one there is no keyframe.
        actuators: Tag of the actuators, ``motor`` or ``position``.
        keyframe: Joint angles of each leg in the keyframe [rad]; empty for no keyframe.
        head: Whether the MJCF has a head on an actuated joint that the URDF lacks.
    """
    urdf = ['<robot name="quad">', _make_link("trunk", 4.0, (0.02, 0.05, 0.06))]
    bodies, motors = [], []
    for leg in ("FL", "FR", "RL", "RR"):
        x, y = (0.2 if leg[0] == "F" else -0.2), (0.1 if leg[1] == "L" else -0.1)
        out = 0.05 if y > 0 else -0.05
        urdf += [
            _make_link(f"{leg}_hip", 0.4, (4e-4, 4e-4, 4e-4)),
            _make_link(f"{leg}_thigh", 0.5, (2e-3, 2e-3, 3e-4), (0, 0, -0.1)),
            _make_link(f"{leg}_calf", 0.2, (8e-4, 8e-4, 5e-5), (0, 0, -0.1)),
            _make_joint(f"{leg}_roll", "trunk", f"{leg}_hip", (x, y, 0), "1 0 0", (-0.8, 0.8)),
            _make_joint(
                f"{leg}_pitch", f"{leg}_hip", f"{leg}_thigh", (0, out, 0), "0 1 0", (-1.5, 2.5)
            ),
            _make_joint(
                f"{leg}_knee", f"{leg}_thigh", f"{leg}_calf", (0, 0, -0.2), "0 1 0", (-2.6, -0.4)
            ),
        ]
        p = f"{prefix}{leg}"
        bodies.append(f"""
          <body name="{p}_hip" pos="{x} {y} 0">
            <inertial pos="0 0 0" mass="0.4" diaginertia="4e-4 4e-4 4e-4"/>
            <joint name="{p}_roll" axis="1 0 0" range="-0.8 0.8"/>
            <body name="{p}_thigh" pos="0 {out} 0">
              <inertial pos="0 0 -0.1" mass="0.5" diaginertia="2e-3 2e-3 3e-4"/>
              <joint name="{p}_pitch" axis="0 1 0" range="-1.5 2.5"/>
              <body name="{p}_calf" pos="0 0 -0.2">
                <inertial pos="0 0 -0.1" mass="0.2" diaginertia="8e-4 8e-4 5e-5"/>
                <joint name="{p}_knee" axis="0 1 0" range="-2.6 -0.4"/>
                {foot}
              </body>
            </body>
          </body>""")
        motors += [
            f'<{actuators} joint="{p}_{joint}" '
            + ('kp="150" kv="5"/>' if actuators == "position" else 'ctrlrange="-30 30"/>')
            for joint in ("roll", "pitch", "knee")
        ]
    if head:
        bodies.append(f"""
          <body name="{prefix}head" pos="0.3 0 0.1">
            <inertial pos="0 0 0" mass="0.3" diaginertia="1e-4 1e-4 1e-4"/>
            <joint name="{prefix}nod" axis="0 1 0" range="-1 1"/>
            <geom type="sphere" size="0.05"/>
          </body>""")
        motors.append(f'<{actuators} joint="{prefix}nod"/>')
    key = f'<keyframe><key name="home" qpos="0 0 0.35 1 0 0 0 {" ".join([keyframe] * 4)}'
    key += ' 0"/></keyframe>' if head else '"/></keyframe>'
    mjcf = f"""<mujoco model="quad"><compiler angle="radian" autolimits="true"/>
      <worldbody>{'<geom type="plane" size="0 0 1"/>' if floor else ""}
        <body name="{prefix}trunk" pos="0 0 0.35">{"<freejoint/>" if free else ""}
          <inertial pos="0 0 0" mass="4" diaginertia="0.02 0.05 0.06"/>
          <geom type="box" size="0.2 0.1 0.04"/>
          {"".join(bodies)}
        </body></worldbody>
      <actuator>{"".join(motors)}</actuator>
      {key if keyframe and free else ""}</mujoco>"""
    return _write_pair(folder, "\n".join([*urdf, "</robot>"]), mjcf)


def edit_pair(pair: Pair, urdf: dict[str, str], mjcf: dict[str, str], count: int = 0) -> Pair:
    """Replace regular expressions in both files, at most ``count`` times each (0: everywhere)."""
    for path, edits in ((pair.urdf, urdf), (pair.mjcf, mjcf)):
        text = path.read_text()
        for pattern, new in edits.items():
            text = re.sub(pattern, new, text, count=count, flags=re.S)
        path.write_text(text)
    return pair


KEYFRAME = {"<keyframe>.*?</keyframe>": ""}
"""Replacement that deletes the keyframes of an MJCF, for ``edit_pair``."""


def fix_hinges(pair: Pair, *endings: str) -> Pair:
    """Replace the hinges whose names end with ``endings`` by fixed joints in both files.

    The keyframes are deleted.
    """
    name = rf'"[^"]*(?:{"|".join(endings)})"'
    hinge = rf'(<joint name={name} type=)"revolute"((?:(?!</joint>).)*?)<axis [^>]*/><limit [^>]*/>'
    drives = rf"<joint name={name}[^>]*/>|<\w+ joint={name}[^>]*/>"
    return edit_pair(pair, {hinge: r'\1"fixed"\2'}, {drives: "", **KEYFRAME})


ARM = (("yaw", "0 0 1", (0.15, 0.0, 0.04)), ("shoulder", "0 1 0", (0.0, 0.0, 0.05)),
       ("elbow", "0 1 0", (0.22, 0.0, 0.0)))  # fmt: skip
"""(joint, its axis, its position in the parent link [m]) of the arm that ``with_arm`` adds."""


def with_arm(pair: Pair, home: str = "0 -0.9 1.3", on: str = "trunk") -> Pair:
    """Add an arm of three hinges to a link in both files; its hand is a sphere of 25 mm radius.

    Args:
        pair: The two files.
        home: Joint angles of the arm in the keyframe [rad], with position servos; empty for
            motors.
        on: Link that carries the arm.
    """
    urdf, mjcf = ElementTree.parse(pair.urdf).getroot(), ElementTree.parse(pair.mjcf).getroot()
    link, body = on, next(body for body in mjcf.iter("body") if body.get("name") == on)
    motors = mjcf.find("actuator")
    assert motors is not None
    for joint, axis, place in ARM:
        name, com = f"arm_{joint}", (0.0 if joint == "yaw" else 0.11, 0.0, 0.0)
        for text in (
            _make_link(f"{name}_link", 0.4, (2e-4, 1e-3, 1e-3), com),
            _make_joint(name, link, f"{name}_link", place, axis, (-2.5, 2.5)),
        ):
            urdf.append(ElementTree.fromstring(text))
        body = ElementTree.SubElement(body, "body", name=f"{name}_link", pos=_join_numbers(place))
        moments = {"mass": "0.4", "diaginertia": "2e-4 1e-3 1e-3", "pos": _join_numbers(com)}
        ElementTree.SubElement(body, "inertial", moments)
        ElementTree.SubElement(body, "joint", name=name, axis=axis, range="-2.5 2.5")
        if home:
            ElementTree.SubElement(motors, "position", joint=name, kp="150", kv="5")
        else:
            ElementTree.SubElement(motors, "motor", joint=name, ctrlrange="-80 80")
        link = f"{name}_link"
    hand = {"name": "hand", "type": "sphere", "size": "0.025", "pos": "0.22 0 0"}
    ElementTree.SubElement(body, "geom", hand)
    for key in mjcf.iter("key"):
        key.set("qpos", f"{key.get('qpos')} {home}")
    pair.urdf.write_text(ElementTree.tostring(urdf, encoding="unicode"))
    pair.mjcf.write_text(ElementTree.tostring(mjcf, encoding="unicode"))
    return pair


def shift_base_com(pair: Pair, y: float) -> Pair:
    """Set the y coordinate [m] of the base's CoM in both files."""
    new = rf"\g<1> {y} "
    urdf, mjcf = r'(<inertial><origin xyz="\S+) \S+ ', r'(<inertial pos="\S+) \S+ '
    return edit_pair(pair, {urdf: new}, {mjcf: new}, count=1)


def from_the_ground(pair: Pair, by: float) -> Pair:
    """Lower the frame of a biped's base by ``by`` [m] relative to its links, in both files."""

    def lifted(element: ElementTree.Element | None, word: str) -> None:
        assert element is not None
        x, y, z = (element.get(word) or "0 0 0").split()
        element.set(word, f"{x} {y} {float(z) + by!r}")

    urdf, mjcf = ElementTree.parse(pair.urdf).getroot(), ElementTree.parse(pair.mjcf).getroot()
    lifted(urdf.find("link/inertial/origin"), "xyz")
    for joint in urdf.findall("joint"):
        if joint.find("parent").get("link") == "pelvis":  # type: ignore[union-attr]
            lifted(joint.find("origin"), "xyz")
    base = mjcf.find("worldbody/body")
    assert base is not None
    for child in base:
        if child.tag != "freejoint":
            lifted(child, "pos")
    pair.urdf.write_text(ElementTree.tostring(urdf, encoding="unicode"))
    pair.mjcf.write_text(ElementTree.tostring(mjcf, encoding="unicode"))
    return pair


def planar(pair: Pair) -> Pair:
    """Fix the roll joints of a quadruped, and put the base's CoM at y = 2 µm, as in Solo 8."""
    return shift_base_com(fix_hinges(pair, "_roll"), 2e-6)


def sole_mesh(pair: Pair, foot: str, corners: int = 40) -> Pair:
    """Replace the geom of a foot by a mesh: a sole whose outline has round ends and ``corners``
    points.
    """
    angles = 2 * math.pi * (np.arange(corners) + 0.3) / corners
    rim = np.column_stack(
        [0.05 * np.sign(np.cos(angles)) + 0.04 * np.cos(angles) + 0.03, 0.04 * np.sin(angles)]
    )
    points = [(x, y, z) for x, y in rim for z in (-0.06, -0.04)]
    text = " ".join(repr(float(value)) for point in points for value in point)
    mjcf = pair.mjcf.read_text()
    assert foot in mjcf
    mjcf = mjcf.replace(foot, '<geom type="mesh" mesh="shoe"/>')
    asset = f'<asset><mesh name="shoe" vertex="{text}"/></asset>'
    pair.mjcf.write_text(mjcf.replace("<worldbody>", f"{asset}<worldbody>", 1))
    return pair


def fuse_trunk(pair: Pair) -> Pair:
    """Remove the trunk from a quadruped's MJCF: its legs and shapes are attached to the world.

    MuJoCo converts URDFs in this way. The mass of the trunk is lost, and keyframes are deleted.
    """
    trunk = r'<body name="[^"]*trunk"[^>]*>\s*(<freejoint ?/>)?\s*<inertial [^>]*/>'
    return edit_pair(pair, {}, {trunk: "", "</body>(?=\\s*</worldbody>)": "", **KEYFRAME})


BIPED_FEET = {
    "box": '<geom type="box" size="0.09 0.04 0.01" pos="0.03 0 -0.05"/>',
    "four spheres": "".join(
        f'<geom type="sphere" size="0.008" pos="{x} {y} -0.05"/>'
        for x in (-0.06, 0.12)
        for y in (-0.035, 0.035)
    ),
    "two capsules": "".join(
        f'<geom type="capsule" size="0.01" fromto="-0.06 {y} -0.05 0.12 {y} -0.05"/>'
        for y in (-0.035, 0.035)
    ),
    "cylinder": '<geom type="cylinder" size="0.09 0.01" pos="0.03 0 -0.05"/>',
}
"""{name: geoms of a foot} for ``biped``, with soles about 0.18 m long."""


def biped(folder: Path, foot: str = BIPED_FEET["box"], *, damping: float = 0.5) -> Pair:
    """Write a biped with six hinges per leg and flat feet; its MJCF has motors and no keyframe.

    Args:
        folder: Folder of the two files.
        foot: Geoms of each foot in the MJCF.
        damping: Joint damping in the MJCF [N m s/rad].
    """
    chain = [
        ("yaw", "0 0 1", (0.0, 0.0, 0.0), 0.3, (-0.7, 0.7)),
        ("roll", "1 0 0", (0.0, 0.0, -0.02), 0.3, (-0.6, 0.6)),
        ("pitch", "0 1 0", (0.0, 0.0, -0.02), 1.5, (-1.5, 1.0)),
        ("knee", "0 1 0", (0.0, 0.0, -0.3), 1.0, (0.0, 2.4)),
        ("ankle", "0 1 0", (0.0, 0.0, -0.3), 0.3, (-1.2, 0.9)),
        ("tilt", "1 0 0", (0.0, 0.0, -0.02), 0.6, (-0.5, 0.5)),
    ]
    urdf = ['<robot name="walker">', _make_link("pelvis", 8.0, (0.1, 0.08, 0.08), (0, 0, 0.1))]
    bodies, motors = [], []
    for side, y in (("left", 0.1), ("right", -0.1)):
        parent, opened = "pelvis", []
        for name, axis, place, mass, limits in chain:
            x, _, z = place
            at = (x, y if name == "yaw" else 0.0, z)
            inertia = (4e-3 * mass, 4e-3 * mass, 1e-3 * mass)
            com = (0.02, 0.0, -0.03) if name == "tilt" else (0.0, 0.0, -0.1 if mass >= 1 else 0.0)
            link = f"{side}_{name}_link"
            urdf += [
                _make_link(link, mass, inertia, com),
                _make_joint(f"{side}_{name}", parent, link, at, axis, limits),
            ]
            moments = _join_numbers(inertia)
            opened.append(f"""<body name="{link}" pos="{_join_numbers(at)}">
              <inertial pos="{_join_numbers(com)}" mass="{mass}" diaginertia="{moments}"/>
              <joint name="{side}_{name}" axis="{axis}" range="{_join_numbers(limits)}"
                     armature="0.01" damping="{damping}"/>""")
            motors.append(f'<motor joint="{side}_{name}" ctrlrange="-80 80"/>')
            parent = link
        bodies.append("".join(opened) + foot + "</body>" * len(chain))
    mjcf = f"""<mujoco model="walker"><compiler angle="radian" autolimits="true"/>
      <worldbody><body name="pelvis" pos="0 0 0.8"><freejoint/>
        <inertial pos="0 0 0.1" mass="8" diaginertia="0.1 0.08 0.08"/>
        <geom type="box" size="0.08 0.12 0.1" pos="0 0 0.1"/>
        {"".join(bodies)}</body></worldbody>
      <actuator>{"".join(motors)}</actuator></mujoco>"""
    return _write_pair(folder, "\n".join([*urdf, "</robot>"]), mjcf)


def _join_numbers(values: tuple[float, ...]) -> str:
    return " ".join(repr(float(value)) for value in values)


def _make_link(
    name: str,
    mass: float,
    inertia: tuple[float, float, float],
    com: tuple[float, float, float] = (0, 0, 0),
) -> str:
    xx, yy, zz = inertia
    return (
        f'<link name="{name}"><inertial><origin xyz="{_join_numbers(com)}"/><mass value="{mass}"/>'
        f'<inertia ixx="{xx}" iyy="{yy}" izz="{zz}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    )


def _make_joint(
    name: str,
    parent: str,
    child: str,
    place: tuple[float, float, float],
    axis: str,
    limits: tuple[float, float],
) -> str:
    return (
        f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{_join_numbers(place)}"/><axis xyz="{axis}"/>'
        f'<limit lower="{limits[0]}" upper="{limits[1]}" effort="80" velocity="20"/></joint>'
    )


def _write_pair(folder: Path, urdf: str, mjcf: str) -> Pair:
    """Write URDF and MJCF."""
    pair = Pair(folder / "robot.urdf", folder / "robot.xml")
    pair.urdf.write_text(urdf)
    pair.mjcf.write_text(mjcf)
    return pair
