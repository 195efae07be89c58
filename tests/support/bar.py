"""A bar on a servo as URDF and MJCF, and a log of its motion from an independent integrator."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from pupper_analysis.prepare.convert.load import load_robot
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.fit.measurements.log import Log

TRUE = {"kp": 6.0, "damping": 0.13, "friction": 0.05, "armature": 0.006, "delay": 0.008}
"""True parameters of the simulated servo joint: N m/rad, N m s/rad, N m, kg m^2, s."""

MASS, LEVER, TURNS, OFFSET = 0.5, 0.15, 0.001, 0.02  # kg, m, kg m^2, rad
"""Mass [kg] of the bar, distance [m] of its CoM from the axis, moment of inertia [kg m^2] about
its CoM, and offset [rad] of the encoder's zero."""

QUANTUM = 2 * np.pi / 4096
"""Resolution of the encoder [rad]: 4096 steps per turn."""

INTERVAL, TICKS = 0.005, 50
"""Sampling interval of the log [s], and integration steps per sample."""

URDF = """<robot name="bar"><link name="base"/><link name="bar"><inertial>
<origin xyz="0 0 -0.15"/><mass value="0.5"/>
<inertia ixx="0.001" iyy="0.001" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="turn" type="revolute"><parent link="base"/><child link="bar"/><axis xyz="0 1 0"/>
<limit lower="-2" upper="2" effort="50" velocity="50"/></joint></robot>"""

MJCF = """<mujoco model="bar"><compiler angle="radian"/><worldbody><body name="base">
<body name="bar"><inertial pos="0 0 -0.15" mass="0.5" diaginertia="0.001 0.001 0.001"/>
<joint name="turn" axis="0 1 0" range="-2 2" damping="0.1" armature="0.004" frictionloss="0.03"/>
</body></body></worldbody><actuator><position name="turn" joint="turn" kp="5"/></actuator>
</mujoco>"""


@cache
def bar() -> Robot:
    """Return the robot of the two files: a bar that hangs from a hinge about y."""
    with TemporaryDirectory() as folder:
        files = Path(folder) / "bar.urdf", Path(folder) / "bar.xml"
        for file, text in zip(files, (URDF, MJCF), strict=True):
            file.write_text(text, encoding="utf-8")
        return load_robot(*files)


def swing(command: np.ndarray, damping: float = TRUE["damping"]) -> Iterator[float]:
    """Yield the angle of the bar [rad] at each sample, integrated with steps of 0.1 ms.

    Coulomb friction includes sticking.

    Args:
        command: Commanded angle at each sample [rad].
        damping: Damping of joint and servo [N m s/rad].
    """
    step, late = INTERVAL / TICKS, round(TRUE["delay"] / INTERVAL * TICKS)
    inertia = TURNS + TRUE["armature"] + MASS * LEVER**2
    angle, rate = float(command[0]), 0.0
    for tick in range(TICKS * len(command)):
        if tick % TICKS == 0:
            yield angle
        target = command[max(tick - late, 0) // TICKS]
        pull = TRUE["kp"] * (target - angle - OFFSET) - MASS * 9.81 * LEVER * math.sin(angle)
        free = rate + step * (pull - damping * rate) / inertia
        rate = math.copysign(max(abs(free) - step * TRUE["friction"] / inertia, 0.0), free)
        angle += step * rate


@cache
def log(damping: float = TRUE["damping"]) -> Log:
    """Return a log of 12 s: commanded angles, and angles with offset, noise and rounding.

    ``damping`` is the damping of joint and servo [N m s/rad].
    """
    time = np.arange(0, 12, INTERVAL)
    command = 0.5 * np.sin(3 * time) + 0.3 * np.sin(11 * time + 1)
    command[600:900], command[1500:1700] = 0.6, -0.4
    random = np.random.default_rng(0)
    seen = (
        np.array(list(swing(command, damping)))
        + OFFSET
        + 0.3 * QUANTUM * random.normal(size=len(time))
    )
    position = QUANTUM * np.round(seen / QUANTUM)
    return Log("swing.csv", time, ("turn",), command[:, None], position[:, None])
