"""Two links that hang in a plane, as files have them and as they are, with torques by hand."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.convert.load import load_robot
from pupper_analysis.identification.measurements.log import Log
from pupper_analysis.robot.robot import Robot

Array = NDArray[np.float64]

G, LENGTH = 9.81, 0.4  # m/s^2, m
MASS = (2.0, 1.2)  # kg
FILE_LEVER, FILE_TURNS = (0.18, 0.13), (0.02, 0.006)  # m, kg m^2


class Truth(NamedTuple):
    """What is planted, of hip and knee."""

    lever: tuple[float, float] = (0.18, 0.15)
    turns: tuple[float, float] = (0.02, 0.008)
    friction: tuple[float, float] = (0.6, 0.25)
    damping: tuple[float, float] = (0.3, 0.1)
    armature: tuple[float, float] = (0.05, 0.02)
    bias: tuple[float, float] = (0.2, -0.1)


TRUE = Truth()
JOINTS = ("hip", "knee")
RATE, QUANTUM, NOISE = 250.0, 2 * np.pi / 2**16, (0.15, 0.05)


def _link(name: str, mass: float, lever: float, turns: float) -> str:
    return (
        f'<link name="{name}"><inertial><origin xyz="0 0 {-lever}"/><mass value="{mass}"/><inertia '
        f'ixx="{turns}" iyy="{turns}" izz="{turns}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    )


def _joint(name: str, parent: str, child: str, drop: float) -> str:
    return (
        f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="0 0 {-drop}"/><axis xyz="0 1 0"/>'
        '<limit lower="-3" upper="3" effort="100" velocity="50"/></joint>'
    )


URDF = f"""<robot name="leg"><link name="base"/>
{_link("thigh", MASS[0], FILE_LEVER[0], FILE_TURNS[0])}
{_link("shank", MASS[1], FILE_LEVER[1], FILE_TURNS[1])}{_joint("hip", "base", "thigh", 0)}
{_joint("knee", "thigh", "shank", LENGTH)}</robot>"""


def _body(name: str, joint: str, numbers: tuple[float, float, float], inner: str = "") -> str:
    mass, lever, turns = numbers
    drop = LENGTH if name == "shank" else 0
    return (
        f'<body name="{name}" pos="0 0 {-drop}"><inertial pos="0 0 {-lever}" mass="{mass}" '
        f'diaginertia="{turns} {turns} {turns}"/><joint name="{joint}" axis="0 1 0" range="-3 3"/>'
        f"{inner}</body>"
    )


_SHANK = _body("shank", "knee", (MASS[1], FILE_LEVER[1], FILE_TURNS[1]))
_THIGH = _body("thigh", "hip", (MASS[0], FILE_LEVER[0], FILE_TURNS[0]), _SHANK)
MJCF = (
    '<mujoco model="leg"><compiler angle="radian"/><worldbody><body name="base">'
    f'{_THIGH}</body></worldbody><actuator><position joint="hip" kp="50"/>'
    '<position joint="knee" kp="30"/></actuator></mujoco>'
)


@cache
def leg(base: str = "") -> Robot:
    """Two links that hang from a base, which the MJCF may turn."""
    with TemporaryDirectory() as folder:
        files = Path(folder) / "leg.urdf", Path(folder) / "leg.xml"
        mjcf = MJCF.replace('name="base"', f'name="base" {base}')
        for file, text in zip(files, (URDF, mjcf), strict=True):
            file.write_text(text, encoding="utf-8")
        return load_robot(*files)


def motion(time: Array) -> tuple[Array, Array, Array]:
    """Angles of hip and knee, and their derivatives."""
    sizes = np.array([[0.5, 0.35, 0.2], [0.6, 0.3, 0.25]])
    rates = np.array([[1.3, 3.1, 5.3], [1.9, 2.7, 6.1]])
    phases = np.array([[0.0, 1.0, 2.0], [0.5, 2.5, 1.5]])
    angle = rates * time[:, None, None] + phases
    return (
        (sizes * np.sin(angle)).sum(axis=2),
        (sizes * rates * np.cos(angle)).sum(axis=2),
        -(sizes * rates**2 * np.sin(angle)).sum(axis=2),
    )


def torques(
    position: Array,
    velocity: Array,
    acceleration: Array,
    gravity: float = G,
    true: Truth = TRUE,
    tilt: float = 0.0,
) -> Array:
    """What motors give, by Lagrange's equations of a double pendulum on a base that is tilted."""
    (a, b), (da, db), (dda, ddb) = position.T, velocity.T, acceleration.T
    (m, n), (c, d), (i, j) = MASS, true.lever, true.turns
    both = j + n * (d**2 + LENGTH * d * np.cos(b))
    whole = i + m * c**2 + j + n * (LENGTH**2 + d**2 + 2 * LENGTH * d * np.cos(b))
    pull = n * LENGTH * d * np.sin(b)
    hip = whole * dda + both * ddb - pull * (2 * da * db + db**2)
    hip += gravity * ((m * c + n * LENGTH) * np.sin(a + tilt) + n * d * np.sin(a + b + tilt))
    knee = both * dda + (j + n * d**2) * ddb + pull * da**2
    knee += gravity * n * d * np.sin(a + b + tilt)
    found: Array = np.column_stack([hip, knee]) + np.array(true.friction) * np.sign(velocity)
    found += np.array(true.damping) * velocity + np.array(true.armature) * acceleration
    return found + np.array(true.bias)


def measured(
    seconds: float = 30.0,
    gravity: float = G,
    true: Truth = TRUE,
    seed: int = 0,
    tilt: float = 0.0,
) -> Log:
    """A log of the motion, with an encoder's steps and noise of torques."""
    time = np.arange(0, seconds, 1 / RATE)
    position, velocity, acceleration = motion(time)
    torque = torques(position, velocity, acceleration, gravity, true, tilt)
    return sensed(time, position, torque, seed)


def sensed(time: Array, position: Array, torque: Array, seed: int = 0) -> Log:
    """The log of a motion, with an encoder's steps and noise of torques."""
    random = np.random.default_rng(seed)
    torque = torque + np.array(NOISE) * random.normal(size=torque.shape)
    position = QUANTUM * np.round(position / QUANTUM + 0.3 * random.normal(size=torque.shape))
    blank = np.full(position.shape, np.nan)
    return Log("leg.csv", time, JOINTS, blank, position, None, torque)
