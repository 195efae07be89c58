"""Random legged robots as URDF and MJCF: legs, feet, names, actuators, springs and base frames.

``draw_robot``, ``irregular_biped`` and ``ring`` draw a robot from a seed; ``write_robot`` writes
its files.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from tests.support.legged import Pair

Triple = tuple[float, float, float]

NAMES = ("foot", "toe_tip", "Sole", "wheel.cover", "paw-1", "EE", "contact_link")
"""Names for the last links of the legs."""

HIPS = {3: "xyy", 4: "zxyy", 6: "zxyyyx"}
"""{number of joints of a leg: letters of their axes, from the hip on}."""


@dataclass
class Link:
    """Link with the hinge that connects it to its parent: m, rad, kg, N m."""

    name: str
    parent: str
    joint: str
    axis: Triple
    place: Triple
    mass: float
    com: Triple
    limits: tuple[float, float]
    effort: float
    shape: str = ""  # geoms of the MJCF
    stiffness: float = 0.0
    where: str = "both"  # or urdf, mjcf
    home: float = 0.0


@dataclass
class Robot:
    """Choices that define a random robot: m, kg."""

    links: list[Link]
    base_mass: float
    offset: Triple
    prefix: str = ""
    motors: str = "motor"
    gear: float = 1.0
    degrees: bool = False
    floor: bool = False
    base: str = "free"
    keyframe: bool = False
    height: float = 0.5
    armature: float = 0.01
    limited: str = "motors"  # or joints: where the MJCF states what they give
    said: list[str] = field(default_factory=list)


def draw_robot(seed: int) -> Robot:
    """Draw a robot with 2, 3, 4 or 6 legs."""
    random = np.random.default_rng(seed)
    legs, joints = [(4, 3), (4, 3), (4, 4), (6, 3), (2, 6), (4, 6)][int(random.integers(6))]
    other = np.random.default_rng([seed, 1])  # what came later, so that others stay as they were
    if (legs, joints) == (4, 3) and other.integers(3) == 0:
        legs = 3
    flat = joints == 6
    size = float(random.uniform(0.12, 0.4))  # of thigh and shank
    foot = str(random.choice(NAMES))
    robot = Robot(
        links=[],
        base_mass=float(random.uniform(1.0, 15.0)) * (size / 0.2) ** 2,
        offset=(0.0, 0.0, 0.0),
        prefix=str(random.choice(["", "rob_", "my robot/"])),
        motors=str(random.choice(["motor", "position", "none", "general"])),
        gear=float(random.choice([1.0, 6.0, -9.0])),
        degrees=bool(random.integers(2)),
        floor=bool(random.integers(2)),
        base=str(random.choice(["free", "free", "held", "held"])),
        keyframe=bool(random.integers(2)),
    )
    if other.integers(3) == 0:
        robot.limited = "joints"
    if random.integers(3) == 0:
        robot.offset = tuple(random.uniform(-0.05, 0.05, 3).tolist())
    effort = 40 * robot.base_mass * size
    for leg in range(legs):
        side = (
            0 if legs == 3 and leg == 2 else 1 if leg % 2 else -1
        )  # of three the last is in front
        row = leg // 2 - (math.ceil(legs / 2) - 1) / 2
        robot.links += _draw_leg(
            random, leg, row, side, HIPS[joints], size, effort, foot, flat=flat
        )
    if flat and random.integers(2):  # a spring in each ankle's roll, and no motor
        robot.links = [
            replace(link, stiffness=3 * effort, effort=0.0) if link.joint.endswith("_5") else link
            for link in robot.links
        ]
        robot.said.append("springs")
    if random.integers(3) == 0:
        robot.links.append(
            Link(
                "tail", "base", "wag", (0.0, 1.0, 0.0), (-0.3, 0.0, 0.1), 0.05 * robot.base_mass,
                (-0.05, 0.0, 0.02), (-0.5, 0.5), effort, '<geom type="sphere" size="0.02"/>',
                where=str(random.choice(["both", "urdf", "mjcf"])),
            )
        )  # fmt: skip
        if robot.links[-1].where != "both":  # a mass in a single file is reported, and fails
            robot.links[-1].mass = 1e-4 * robot.base_mass
        robot.said.append(f"tail in {robot.links[-1].where}")
    robot.height = 0.02 + 2 * size * math.cos(0.6) + (0.05 if flat else 0.0)
    robot.said += [f"{legs} legs of {joints}", robot.motors, robot.base, foot]
    robot.said.append(f"limits of {robot.limited}")
    return robot


def _draw_leg(
    random: np.random.Generator,
    leg: int,
    row: float,
    side: int,
    axes: str,
    size: float,
    effort: float,
    foot: str,
    *,
    flat: bool,
) -> list[Link]:
    """Draw one leg; the legs of a robot differ only in position, side and foot."""
    fixed = np.random.default_rng(7)  # of all legs alike
    wide = 0.1 + 0.5 * size
    links, parent = [], "base"
    pitched = 0
    knee = 1.0 if flat else -1.0
    for number, letter in enumerate(axes):
        axis = tuple(float(letter == word) for word in "xyz")
        place, length, limits, home = (0.0, 0.0, 0.0), 0.03, (-0.8, 0.8), 0.0
        if number == 0:
            place = (2.2 * size * row, side * wide, 0.0)
        if letter == "y":
            pitched += 1
            if pitched == 1:
                place, length, limits = (0.0, side * 0.03, 0.0), size, (-1.6, 1.6)
                home = -0.6 * knee
            elif pitched == 2:
                place, length, home = (0.0, 0.0, -size), size, 1.2 * knee
                limits = (-2.4, -0.1) if knee < 0 else (0.1, 2.4)
            else:
                place, length, home = (0.0, 0.0, -size), 0.04, -0.6 * knee
                limits = (-1.2, 1.2)
        mass = float(fixed.uniform(0.5, 1.5)) * size
        last = number == len(axes) - 1
        links.append(
            Link(
                f"{foot}_{leg}" if last else f"part_{leg}_{number}", parent, f"j_{leg}_{number}",
                axis, place, mass, (0.0, 0.0, -0.4 * length), limits, effort, home=home,
            )
        )  # fmt: skip
        parent = links[-1].name
    links[-1].shape = _draw_foot(random, size, flat=flat)
    return links


def _draw_foot(random: np.random.Generator, size: float, *, flat: bool) -> str:
    """Draw the geoms of a foot; the legs of a robot may have different ones."""
    if flat:
        return str(
            random.choice([
                f'<geom type="box" size="{0.3 * size} {0.15 * size} 0.01" pos="0.02 0 -0.04"/>',
                "".join(
                    f'<geom size="0.008" pos="{x * size} {y * size} -0.042"/>'
                    for x in (-0.25, 0.3) for y in (-0.14, 0.14)
                ),
                "".join(
                    f'<geom type="capsule" size="0.01" fromto="{-0.25 * size} {y * size} -0.04 '
                    f'{0.3 * size} {y * size} -0.04"/>' for y in (-0.14, 0.14)
                ),
            ])
        )  # fmt: skip
    end = -size
    return str(
        random.choice([
            f'<geom type="sphere" size="0.02" pos="0 0 {end}"/>',
            f'<geom type="capsule" size="0.015" fromto="0 0 {0.2 * end} 0 0 {end}"/>',
            f'<geom type="ellipsoid" size="0.02 0.02 0.02" pos="0 0 {end}"/>',
        ])
    )  # fmt: skip


# ------------------------------------------------------------------------------------- writing


def write_robot(robot: Robot, folder: Path) -> Pair:
    """Write the URDF and the MJCF of a robot."""
    pair = Pair(folder / "robot.urdf", folder / "robot.xml")
    pair.urdf.write_text(_make_urdf(robot))
    pair.mjcf.write_text(_make_mjcf(robot))
    return pair


def _join_numbers(values: tuple[float, ...]) -> str:
    """Return numbers as text with all digits, separated by spaces."""
    return " ".join(repr(float(value)) for value in values)


def _compute_moments(mass: float) -> Triple:
    """Return the principal moments of inertia [kg m^2] of a link by its mass [kg]."""
    return (0.01 * mass, 0.012 * mass, 0.008 * mass)


def _make_inertial(mass: float, com: Triple) -> str:
    """Return the ``inertial`` element of a URDF."""
    xx, yy, zz = _compute_moments(mass)
    return (
        f'<inertial><origin xyz="{_join_numbers(com)}"/><mass value="{mass!r}"/>'
        f'<inertia ixx="{xx!r}" iyy="{yy!r}" izz="{zz!r}" ixy="0" ixz="0" iyz="0"/></inertial>'
    )


def _make_urdf(robot: Robot) -> str:
    """Return the URDF; if the base is offset, its root is an empty link on a fixed joint."""
    lines = ['<robot name="random">']
    if any(robot.offset):
        lines += [
            '<link name="footprint"/><joint name="to_base" type="fixed"><parent link="footprint"/>'
            f'<child link="base"/><origin xyz="{_join_numbers(robot.offset)}"/></joint>'
        ]
    lines += [f'<link name="base">{_make_inertial(robot.base_mass, (0, 0, 0))}</link>']
    for link in robot.links:
        if link.where == "mjcf":
            continue
        low, high = link.limits
        lines += [
            f'<link name="{link.name}">{_make_inertial(link.mass, link.com)}</link>',
            f'<joint name="{link.joint}" type="revolute"><parent link="{link.parent}"/>'
            f'<child link="{link.name}"/><origin xyz="{_join_numbers(link.place)}"/>'
            f'<axis xyz="{_join_numbers(link.axis)}"/>'
            f'<limit lower="{low}" upper="{high}" effort="{link.effort!r}" velocity="9"/></joint>',
        ]
    return "\n".join([*lines, "</robot>"])


def _make_mjcf(robot: Robot) -> str:
    """Return the MJCF with free or fixed base, and with actuators, floor and keyframe as chosen."""
    lines, p = [], robot.prefix
    unit = 180 / math.pi if robot.degrees else 1.0

    def given(link: Link) -> str:
        """Return the torque limit of a joint as an attribute, if the joints state the limits."""
        if robot.limited != "joints" or not link.effort:
            return ""
        return f' actuatorfrcrange="{-link.effort} {link.effort}"'

    def body(name: str) -> str:
        """Return the bodies below a link as text."""
        text = ""
        for link in robot.links:
            if link.parent != name or link.where == "urdf":
                continue
            limits = _join_numbers(tuple(unit * limit for limit in link.limits))
            spring = f'stiffness="{link.stiffness}"' if link.stiffness else ""
            text += (
                f'<body name="{p}{link.name}" pos="{_join_numbers(link.place)}"><inertial '
                f'pos="{_join_numbers(link.com)}" mass="{link.mass!r}" '
                f'diaginertia="{_join_numbers(_compute_moments(link.mass))}"/>'
                f'<joint name="{p}{link.joint}" axis="{_join_numbers(link.axis)}" range="{limits}" '
                f'armature="{robot.armature}" damping="0.2" {spring}{given(link)}/>{link.shape}'
                f"{body(link.name)}</body>"
            )
        return text

    inside = '<geom type="box" size="0.05 0.05 0.03" contype="0" conaffinity="0" mass="0"/>'
    inside += body("base")
    floor = '<geom name="ground" type="plane" size="0 0 1"/>' if robot.floor else ""
    free = "<freejoint/>" if robot.base == "free" else ""
    moments = _join_numbers(_compute_moments(robot.base_mass))
    world = (
        f'{floor}<body name="{p}base" pos="0 0 {robot.height}">{free}<inertial pos="0 0 0" '
        f'mass="{robot.base_mass!r}" diaginertia="{moments}"/>'
        f"{inside}</body>"
    )
    lines.append(f"<worldbody>{world}</worldbody><actuator>")
    joints = [link for link in robot.links if link.where != "urdf"]
    for link in joints:
        limit, gear = link.effort / abs(robot.gear), f'gear="{robot.gear}"'
        ranges = {
            "ctrl": f'ctrlrange="{-limit} {limit}"',
            "force": f'forcerange="{-limit} {limit}"',
        }
        if robot.limited == "joints":
            ranges = dict.fromkeys(ranges, "")
        kp = 30 * link.effort / robot.gear**2
        kinds = {
            "motor": f'<motor joint="{p}{link.joint}" {gear} {ranges["ctrl"]}/>',
            "position": f'<position joint="{p}{link.joint}" {gear} kp="{kp}" kv="{kp / 20}" '
            f"{ranges['force']}/>",
            "general": f'<general joint="{p}{link.joint}" {gear}/>',
        }
        if link.effort and robot.motors in kinds:
            lines.append(kinds[robot.motors])
    key = ""
    if robot.keyframe and robot.base == "free":
        qpos = [
            0.0,
            0.0,
            robot.height,
            1.0,
            0.0,
            0.0,
            0.0,
            *(link.home for link in _sort_links(robot)),
        ]
        key = f'<keyframe><key name="home" qpos="{_join_numbers(tuple(qpos))}"/></keyframe>'
    angle = "degree" if robot.degrees else "radian"
    return (
        f'<mujoco model="random"><compiler angle="{angle}" autolimits="true"/>'
        f'<option integrator="{"implicitfast" if robot.motors == "position" else "Euler"}"/>'
        f"{''.join(lines)}</actuator>{key}</mujoco>"
    )


def _sort_links(robot: Robot) -> list[Link]:
    """Return the links of the MJCF in the order of its bodies: depth first."""

    def below(name: str) -> list[Link]:
        found = []
        for link in robot.links:
            if link.parent == name and link.where != "urdf":
                found += [link, *below(link.name)]
        return found

    return below("base")


def irregular_biped(seed: int) -> Robot:
    """Draw a biped with box soles whose links all differ and whose axes are not aligned."""
    random = np.random.default_rng(seed)
    size = float(random.uniform(0.12, 0.3))
    robot = Robot(
        links=[],
        base_mass=float(random.uniform(2, 12)) * (size / 0.2) ** 2,
        offset=(0.0, 0.0, 0.0),
        motors="position",
        height=0.07 + 2 * size * math.cos(0.6),
        said=["xyyyx"],
    )
    random.choice(4)
    effort = 40 * robot.base_mass * size
    for leg, side in enumerate((-1, 1)):
        robot.links += _irregular_leg(random, leg, side, size, effort)
    return robot


def _irregular_leg(
    random: np.random.Generator, leg: int, side: int, size: float, effort: float
) -> list[Link]:
    """Draw a leg of five hinges with random lengths, axes, offsets and sole."""
    links: list[Link] = []
    axes = "xyyyx"
    lengths = [size * random.uniform(0.9, 1.1) for _ in "ab"]
    pitched = 0
    for number, letter in enumerate(axes):
        axis = np.array([float(letter == word) for word in "xyz"]) + random.normal(0, 0.05, 3)
        place, home, limits = np.zeros(3), 0.0, (-1.0, 1.0)
        if number == 0:
            wide = side * (0.06 + 0.3 * size) * random.uniform(0.8, 1.2)
            place = np.array([random.uniform(-0.02, 0.02), wide, 0.0])
        if letter == "y":
            below = np.array([0.0, 0.0, -lengths[min(pitched, 2) - 1]])
            place = place if pitched == 0 else below
            home, limits = [(-0.6, (-1.8, 1.8)), (1.2, (0.05, 2.5)), (-0.6, (-1.4, 1.4))][pitched]
            pitched += 1
        if number:
            place = place + random.normal(0, 0.05 * size, 3)
        last = number == len(axes) - 1
        links.append(
            Link(
                f"sole_{leg}" if last else f"part_{leg}_{number}",
                links[-1].name if links else "base",
                f"j_{leg}_{number}",
                tuple((axis / np.linalg.norm(axis)).tolist()),
                tuple(place.tolist()),
                float(random.uniform(0.3, 1.5)) * size,
                tuple(random.uniform(-0.02, 0.02, 3).tolist()),
                limits,
                effort,
                home=home,
            )
        )
    long, wide = random.uniform(0.2, 0.4) * size, random.uniform(0.1, 0.2) * size
    place = random.uniform(0, 0.03)
    links[-1].shape = f'<geom type="box" size="{long} {wide} 0.01" pos="{place} 0 -0.04"/>'
    return links


def ring(seed: int, legs: int = 6, strength: float = 2.5) -> Robot:
    """Draw a robot whose legs are arranged in a circle, each in the plane of its direction.

    Args:
        seed: Seed.
        legs: Number of legs, at least 3.
        strength: Motor torque in units of an estimate of what bears the base alone.
    """
    random = np.random.default_rng(seed)
    size = float(random.uniform(0.12, 0.4))
    mass = float(random.uniform(1, 10)) * (size / 0.2) ** 2
    effort = strength * 1.6 * mass * 9.81 / legs * size * math.sin(0.6)
    height = 0.02 + 2 * size * math.cos(0.6)
    robot = Robot(
        [], mass, (0.0, 0.0, 0.0), motors="position", height=height, said=[f"{legs} legs"]
    )
    foot = f'<geom type="sphere" size="0.02" pos="0 0 {-size}"/>'
    for leg in range(legs):
        angle = 2 * math.pi * leg / legs + random.normal(0, 0.05)
        out = (math.cos(angle), math.sin(angle))
        parent = "base"
        for number, name in enumerate(("hip", "thigh", "foot")):
            link = Link(
                f"{name}{leg}",
                parent,
                f"j{leg}_{number}",
                (-out[1], out[0], 0.0) if number else (0.0, 0.0, 1.0),
                ((size * out[0], size * out[1], 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, -size))[number],
                float(random.uniform(0.3, 0.8)) * size,
                (0.0, 0.0, -0.4 * size if number else 0.0),
                ((-1.0, 1.0), (-1.6, 1.6), (-2.4, 2.4))[number],
                effort,
                foot if number == 2 else "",
                home=(0.0, -0.9, 1.2)[number],
            )
            robot.links.append(link)
            parent = link.name
    return robot
