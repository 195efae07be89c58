"""Small robots that are written as URDF and MJCF from one list of parts, to be changed in one file.

The text is written without the package: one element per line, numbers with all digits. The second
half calls the package with such files.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

import pupper_analysis as pa
from pupper_analysis.models.mjcf_file import read_mjcf
from pupper_analysis.models.urdf_file import read_urdf
from pupper_analysis.robot.compare import compare
from pupper_analysis.robot.compare.attribution import explain_differences
from pupper_analysis.robot.compare.compare import FilesCompared
from pupper_analysis.robot.compare.differences import Explanation
from pupper_analysis.robot.matching.match import Match, match_models
from pupper_analysis.robot.matching.tolerances import Tolerances
from pupper_analysis.robot.robot import Robot

if TYPE_CHECKING:
    from pupper_analysis.tools.crosscheck.crosscheck import Comparison

NOTHING = (0.0, 0.0, 0.0)
"""Zero vector."""

STRAIGHT = (1.0, 0.0, 0.0, 0.0)
"""Quaternion (w, x, y, z) without rotation."""


@dataclass(frozen=True)
class Part:
    """Link with the joint that connects it to its parent, none for the base: m, kg, kg m^2, rad, N
    m.
    """

    link: str
    parent: str = ""
    joint: str = ""
    kind: str = "revolute"
    position: Sequence[float] = NOTHING
    quaternion: Sequence[float] = STRAIGHT  # (w, x, y, z)
    axis: Sequence[float] = (1.0, 0.0, 0.0)
    mass: float = 1.0
    com: Sequence[float] = NOTHING
    inertia: Sequence[float] = (0.01, 0.01, 0.01, 0.0, 0.0, 0.0)  # xx yy zz xy xz yz
    lower: float = -1.0
    upper: float = 1.0
    effort: float = 5.0
    damping: float = 0.1
    friction: float = 0.2
    armature: float = 0.01


class Frame(NamedTuple):
    """Named point fixed to a link: a link of the URDF, a site of the MJCF; position [m]."""

    name: str
    link: str
    position: Sequence[float]


class Files(NamedTuple):
    """Paths of the URDF and the MJCF of one robot."""

    urdf: Path
    mjcf: Path


Parts = dict[str, Part]

FEET = [Frame(f"foot{leg}", f"shank{leg}", (0.002, 0.0, -0.2)) for leg in range(4)]
"""Frames at the four feet of ``quadruped``."""


def quadruped() -> Parts:
    """Return a base with four legs of two hinges; bodies and frames all differ."""
    parts = [
        Part(
            "base",
            mass=6.0,
            com=(0.01, 0.002, -0.005),
            inertia=(0.03, 0.09, 0.1, 2e-4, 1e-3, -4e-5),
        )
    ]
    for leg in range(4):
        x, y = (0.2 if leg < 2 else -0.2), (0.1 if leg % 2 else -0.1)
        more = 1 + 0.05 * leg
        parts += [
            Part(
                f"thigh{leg}", "base", f"hip{leg}", position=(x, y, 0.01),
                quaternion=_make_unit(1.0, 0.1 * leg, 0.05, -0.1), axis=(1.0, 0.0, 0.0),
                mass=1.0 * more, com=(0.01, 0.02 * more, -0.03),
                inertia=(0.005, 0.005 * more, 0.0022, 1e-4, -3e-4, 8e-4),
                lower=-1.0 - 0.01 * leg, upper=0.9, effort=20.0 + leg,
            ),
            Part(
                f"shank{leg}", f"thigh{leg}", f"knee{leg}", position=(0.0, 0.08, -0.2),
                quaternion=_make_unit(1.0, 0.0, 0.2, 0.03 * leg), axis=(0.0, 1.0, 0.0),
                mass=0.2 * more, com=(0.004, 0.001, -0.12),
                inertia=(0.0015, 0.0014 * more, 3e-4, 1e-6, 2e-5, 3e-6),
                lower=-2.5, upper=-0.5 - 0.01 * leg, effort=35.0 + leg, armature=0.02,
            ),
        ]  # fmt: skip
    return {part.link: part for part in parts}


def arm() -> Parts:
    """Return a fixed base with a continuous joint, a hinge and a slide in series."""
    parts = [
        Part("base", mass=3.0, com=(0.0, 0.01, 0.02)),
        Part("column", "base", "turn", "continuous", (0.0, 0.0, 0.1), axis=(0.0, 0.0, 1.0)),
        Part(
            "boom", "column", "lift", "revolute", (0.05, 0.0, 0.2), _make_unit(1.0, 0.1, 0.0, 0.3),
            axis=(0.0, 1.0, 0.0), com=(0.2, 0.0, 0.0), inertia=(0.02, 0.04, 0.05, 1e-3, 0.0, 0.0),
        ),
        Part(
            "rod", "boom", "push", "prismatic", (0.4, 0.0, 0.0), axis=(1.0, 0.0, 0.0), mass=0.5,
            com=(0.1, 0.0, 0.01), lower=0.0, upper=0.3,
        ),
    ]  # fmt: skip
    return {part.link: part for part in parts}


def pendulum(**values: Any) -> Parts:
    """Return a body 0.5 m below a hinge of a fixed base: its motion is known in closed form."""
    bob = Part("bob", "base", "swing", "revolute", (0.0, 0.0, 1.0), axis=(0.0, 1.0, 0.0))
    bob = replace(bob, mass=2.0, com=(0.0, 0.0, -0.5), inertia=(1e-3, 1e-3, 1e-3, 0, 0, 0))
    return {"base": Part("base", mass=1.0), "bob": replace(bob, **values)}


def _make_unit(*quaternion: float) -> tuple[float, ...]:
    """Return a quaternion divided by its norm."""
    return tuple(np.array(quaternion) / np.linalg.norm(quaternion))


def change_part(parts: Parts, link: str, **values: Any) -> Parts:
    """Return the parts with other values in one of them."""
    return {**parts, link: replace(parts[link], **values)}


def all_changed(parts: Parts, **values: Any) -> Parts:
    """Return the parts with the same other values in all of them."""
    return {name: replace(part, **values) for name, part in parts.items()}


def turned_about(part: Part, axis: Sequence[float], angle: float) -> tuple[float, ...]:
    """Return the quaternion of a part rotated by an angle [rad] about an axis in its own frame."""
    turn = Rotation.from_rotvec(angle * np.array(axis))
    rotation = Rotation.from_quat(part.quaternion, scalar_first=True) * turn
    return tuple(rotation.as_quat(scalar_first=True))


# ------------------------------------------------------------------------------------- writing


def numbers(values: Iterable[float]) -> str:
    """Return numbers as text with all digits, separated by spaces."""
    return " ".join(repr(float(value)) for value in values)


def urdf_text(parts: Parts, frames: Iterable[Frame] = FEET, name: str = "machine") -> str:
    """Return the URDF of the parts, with a fixed link per frame."""
    lines = [f'<robot name="{name}">']
    for part in parts.values():
        xx, yy, zz, xy, xz, yz = (repr(float(value)) for value in part.inertia)
        lines += [f'<link name="{part.link}">']
        if part.mass:
            lines += [
                "<inertial>",
                f'<origin xyz="{numbers(part.com)}"/>',
                f'<mass value="{part.mass!r}"/>',
                f'<inertia ixx="{xx}" iyy="{yy}" izz="{zz}" ixy="{xy}" ixz="{xz}" iyz="{yz}"/>',
                "</inertial>",
            ]
        lines += ["</link>"]
        if not part.parent:
            continue
        rotation = Rotation.from_quat(part.quaternion, scalar_first=True)
        lines += [
            f'<joint name="{part.joint}" type="{part.kind}">',
            f'<origin xyz="{numbers(part.position)}" rpy="{numbers(rotation.as_euler("xyz"))}"/>',
            f'<parent link="{part.parent}"/>',
            f'<child link="{part.link}"/>',
        ]
        if part.kind != "fixed":
            limits = f'lower="{part.lower!r}" upper="{part.upper!r}" '
            limits = "" if part.kind == "continuous" else limits
            lines += [
                f'<axis xyz="{numbers(part.axis)}"/>',
                f'<limit {limits}effort="{part.effort!r}" velocity="10"/>',
                f'<dynamics damping="{part.damping!r}" friction="{part.friction!r}"/>',
            ]
        lines += ["</joint>"]
    for frame in frames:
        if frame.link in parts:
            lines += [
                f'<link name="{frame.name}"/>',
                f'<joint name="to_{frame.name}" type="fixed">',
                f'<origin xyz="{numbers(frame.position)}"/>',
                f'<parent link="{frame.link}"/>',
                f'<child link="{frame.name}"/>',
                "</joint>",
            ]
    return "\n".join([*lines, "</robot>"]) + "\n"


def mjcf_text(
    parts: Parts,
    frames: Iterable[Frame] = FEET,
    *,
    free: bool = True,
    base_position: Sequence[float] = NOTHING,
    backwards: bool = False,
    extra: str = "",
    scene: str = "",
) -> str:
    """Return the MJCF of the parts, with a site per frame.

    Args:
        parts: Parts by link.
        frames: Frames; those of other links are ignored.
        free: Whether the base has a free joint.
        base_position: Position of the base in the world [m].
        backwards: Whether bodies and actuators are in reverse order.
        extra: Sections after the actuators.
        scene: Elements at the start of the world body.
    """
    frames = list(frames)
    lines = ['<mujoco model="machine">', '<compiler angle="radian"/>', "<worldbody>", scene]

    def body(part: Part) -> None:
        place = numbers(part.position if part.parent else base_position)
        xx, yy, zz, xy, xz, yz = part.inertia
        lines.append(f'<body name="{part.link}" pos="{place}" quat="{numbers(part.quaternion)}">')
        if not part.parent:
            lines.extend(["<freejoint/>"] if free else [])
        elif part.kind != "fixed":
            limits = "" if part.kind == "continuous" else f'range="{part.lower!r} {part.upper!r}" '
            kind = "slide" if part.kind == "prismatic" else "hinge"
            lines.append(
                f'<joint name="{part.joint}" type="{kind}" axis="{numbers(part.axis)}" {limits}'
                f'damping="{part.damping!r}" frictionloss="{part.friction!r}" '
                f'armature="{part.armature!r}"/>'
            )
        if part.mass:
            lines.append(
                f'<inertial pos="{numbers(part.com)}" mass="{part.mass!r}" '
                f'fullinertia="{numbers((xx, yy, zz, xy, xz, yz))}"/>'
            )
        for frame in frames:
            if frame.link == part.link:
                lines.append(f'<site name="{frame.name}" pos="{numbers(frame.position)}"/>')
        children = [child for child in parts.values() if child.parent == part.link]
        for child in reversed(children) if backwards else children:
            body(child)
        lines.append("</body>")

    body(next(part for part in parts.values() if not part.parent))
    lines += ["</worldbody>", "<actuator>"]
    moving = [part for part in parts.values() if part.parent and part.kind != "fixed"]
    for part in reversed(moving) if backwards else moving:
        control = f'ctrlrange="{-part.effort!r} {part.effort!r}"'
        lines.append(f'<motor name="m_{part.joint}" joint="{part.joint}" {control}/>')
    return "\n".join([*lines, "</actuator>", extra, "</mujoco>"]) + "\n"


def without_base(text: str) -> str:
    """Return the MJCF without its base: the children are bodies of the world, as MuJoCo converts
    URDFs.
    """
    lines = text.splitlines()
    start = next(row for row, line in enumerate(lines) if '<body name="base"' in line)
    end = lines.index("</worldbody>")
    assert "<inertial" in lines[start + 1]
    assert lines[end - 1] == "</body>"
    return "\n".join([*lines[:start], *lines[start + 2 : end - 1], *lines[end:]])


def turned_frames(parts: Parts, seed: int) -> str:
    """Return an MJCF of the same robot in which all body frames but the base's are rotated at
    random.

    Poses, inertials, joint axes and sites are expressed in the rotated frames.
    """
    random = np.random.default_rng(seed)
    still = Rotation.identity()
    turns = {name: Rotation.random(rng=random) if part.parent else still
             for name, part in parts.items()}  # fmt: skip

    def turned(part: Part) -> Part:
        above, own = turns.get(part.parent, still), turns[part.link]
        pose = above.inv() * Rotation.from_quat(part.quaternion, scalar_first=True) * own
        xx, yy, zz, xy, xz, yz = part.inertia
        axes = own.as_matrix()
        tensor = axes.T @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ axes
        return replace(
            part,
            position=above.inv().apply(part.position),
            quaternion=pose.as_quat(scalar_first=True),
            axis=own.inv().apply(part.axis),
            com=own.inv().apply(part.com),
            inertia=(*np.diag(tensor), tensor[0, 1], tensor[0, 2], tensor[1, 2]),
        )

    frames = [
        frame._replace(position=turns[frame.link].inv().apply(frame.position))
        for frame in FEET if frame.link in parts
    ]  # fmt: skip
    return mjcf_text({name: turned(part) for name, part in parts.items()}, frames)


def write(folder: Path, urdf: str, mjcf: str, stem: str = "robot") -> Files:
    """Write the two texts to ``STEM.urdf`` and ``STEM.xml``."""
    files = Files(folder / f"{stem}.urdf", folder / f"{stem}.xml")
    files.urdf.write_text(urdf)
    files.mjcf.write_text(mjcf)
    return files


def write_parts(folder: Path, urdf: Parts, mjcf: Parts, **options: Any) -> Files:
    """Write one list of parts as URDF and another as MJCF."""
    return write(folder, urdf_text(urdf), mjcf_text(mjcf, **options))


# ------------------------------------------------------------------------------------- using


def match_files(files: Files, **options: Any) -> Match:
    """Return the match of two files; options are those of ``match_models``."""
    return match_models(read_urdf(files.urdf), read_mjcf(files.mjcf), **options)


def robot_of(folder: Path, urdf: Parts, mjcf: Parts, **options: Any) -> Robot:
    """Return the robot that two lists of parts give as URDF and MJCF."""
    return match_files(write_parts(folder, urdf, mjcf, **options)).robot


def explain_parts(
    folder: Path, urdf: Parts, mjcf: Parts, tolerances: Tolerances | None = None, **options: Any
) -> Explanation:
    """Return the explanation of the differences between two lists of parts as URDF and MJCF."""
    return explain_differences(robot_of(folder, urdf, mjcf, **options), tolerances=tolerances)


def compare_files(files: Files, **options: Any) -> Comparison:
    """Compare two files at two configurations."""
    return pa.compare_models(files.urdf, files.mjcf, **{"configurations": 2, **options})


def files_agree(files: Files) -> bool:
    """Return whether two files have the same numbers, and the same dynamics up to rounding."""
    compared = compare.compare_files(
        files.urdf, files.mjcf, tolerances=pa.matching.Tolerances.strict()
    ).result
    return compared.agree and max(compared.deviations.values()) < 1e-9


def list_differences(result: Explanation | FilesCompared) -> list[tuple[str, str]]:
    """Return kind and element of each difference, in their order."""
    return [(difference.kind, difference.element) for difference in result.differences]


def line_at(place: str | None, files: Mapping[str, Path]) -> str:
    """Return the line of text at a location ``file:line``."""
    assert place is not None
    name, _, line = place.rpartition(":")
    assert line.isdigit(), f"no line: {place}"
    path = next(path for key, path in files.items() if name.endswith(key))
    return path.read_text().splitlines()[int(line) - 1]


def format_headline(comparison: FilesCompared) -> str:
    """Return whether the files of a comparison agree, and the problem to solve first."""
    agree = "SAME ROBOT, DIFFERENT CONVENTIONS" if comparison.same_robot else "DISAGREE"
    return f"{'AGREE' if comparison.agree else agree}: {comparison.main_problem}"
