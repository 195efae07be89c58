"""Growth of the time with the number of variants, configurations, stands and simulations, and of
the processor time with the number of joints and contacts of a robot."""

from __future__ import annotations

import itertools
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
from bare import make_smooth_tasks
from measure import take_turns

import pupper_analysis as pa

COUNTS = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
"""Numbers of repetitions that are measured."""


def measure_growth(variant: str, most: int, seconds: float) -> dict[str, list[tuple[int, float]]]:
    """Return {computation: points (number, elapsed time [s])}.

    Args:
        variant: Name of the robot.
        most: Largest number.
        seconds: Minimum duration of each measurement [s]; the median is returned.
    """
    robot = pa.load_variant(variant)
    stand = pa.solve_stand(robot)
    tasks, new = make_smooth_tasks(robot, 1000), itertools.count()  # a variant is derived but once
    jobs: dict[str, tuple[int, Callable[[int], object]]] = {
        "load_variant, each a new one": (
            50,
            lambda count: [
                pa.load_variant(pa.pupper.VariantSpec("v3", leg_scale=1 + 1e-5 * next(new)))
                for _ in range(count)
            ],
        ),
        "cross_check, by configurations": (
            200,
            lambda count: pa.cross_check(robot, configurations=count),
        ),
        "solve_stands, by stands": (1000, lambda count: pa.solve_stands(robot, tasks[:count])),
        "sweep_gains, by cells of 2 s": (
            20,
            lambda count: pa.simulation.sweep_gains(
                robot, stand, kp=np.linspace(5, 50, count), kd=[0.5], duration=2.0
            ),
        ),
    }
    return {
        name: [
            (count, statistics.median(take_turns([lambda: run(count)], 2, seconds)[0]))  # noqa: B023
            for count in COUNTS
            if count <= min(limit, most)
        ]
        for name, (limit, run) in jobs.items()
    }


LEG_COUNTS = (4, 6, 8, 12, 16, 24)
"""Numbers of legs of generated robots; each leg has three joints and one contact."""

ARM_JOINT_COUNTS = (12, 18, 24, 36, 60, 84)
"""Numbers of joints of generated robots with four legs; joints beyond 12 are those of an arm."""


def measure_robot_growth(seconds: float) -> dict[str, list[tuple[int, float]]]:
    """Return {computation: points (number, processor time [s])} for generated robots.

    The number is that of the contacts of robots with 4 to 24 legs, or that of the joints of robots
    with four legs and an arm.

    Args:
        seconds: Minimum duration of each measurement [s]; the median is returned.
    """
    points: dict[str, list[tuple[int, float]]] = {}
    families = (
        ("by contacts of legs with 3 joints", [(legs, legs, 0) for legs in LEG_COUNTS]),
        ("by joints, 4 contacts", [(count, 4, count - 12) for count in ARM_JOINT_COUNTS]),
    )
    with tempfile.TemporaryDirectory() as folder:
        for family, robots in families:
            for count, legs, arm_joints in robots:
                path = Path(folder) / f"legs-{legs}-arm-{arm_joints}.urdf"
                path.write_text("\n".join(generate_urdf(legs, arm_joints)))
                for name, run in list_robot_jobs(path).items():
                    took = statistics.median(take_turns([run], 2, seconds, time.process_time)[0])
                    points.setdefault(f"{name}, {family}", []).append((count, took))
    return points


def list_robot_jobs(path: Path) -> dict[str, Callable[[], object]]:
    """Return {name: computation} for the robot of a URDF."""
    robot = pa.load_robot(path)
    stand = pa.solve_stand(robot)
    config = pa.Configuration(robot, stand.qpos)
    return {
        "load_robot": lambda: pa.load_robot(path).pin_model,
        "solve_stand": lambda: pa.solve_stand(robot),
        "mass_matrix": config.mass_matrix,
        "gravity_compensation": lambda: pa.gravity_compensation(config),
    }


def generate_urdf(legs: int, arm_joints: int) -> Iterator[str]:
    """Yield the lines of a URDF: a box with legs of three hinges on both sides, and an arm.

    Each leg has an upper and a lower link of 0.2 m and a spherical foot. The arm is a chain of
    hinges on the box.

    Args:
        legs: Number of legs, even.
        arm_joints: Number of hinges of the arm.
    """
    length = 0.15 * legs

    def link(name: str, mass: float, shape: str = "", middle: float = 0.0) -> str:
        """Return a link with the centre of mass at the height ``middle`` [m]."""
        moment = 0.01 * mass
        inertia = " ".join(
            f'{axis}="{moment if axis[1] == axis[2] else 0.0}"'
            for axis in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
        )
        inertial = (
            f'<inertial><origin xyz="0 0 {middle}"/><mass value="{mass}"/>'
            f"<inertia {inertia}/></inertial>"
        )
        collision = f"<collision><geometry>{shape}</geometry></collision>" if shape else ""
        return f'<link name="{name}">{inertial}{collision}</link>'

    def hinge(name: str, parent: str, place: str, axis: str) -> str:
        """Return a revolute joint from a parent to the link with the name of the joint."""
        return (
            f'<joint name="{name}_joint" type="revolute"><parent link="{parent}"/>'
            f'<child link="{name}"/><origin xyz="{place}"/><axis xyz="{axis}"/>'
            f'<limit lower="-2.6" upper="2.6" effort="100" velocity="20"/></joint>'
        )

    yield f'<robot name="legs-{legs}-arm-{arm_joints}">'
    yield link("base", 2.0 * legs, f'<box size="{length} 0.2 0.1"/>')
    for leg in range(legs):
        side = 1 if leg % 2 else -1
        x = length / 2 - 0.3 * (leg // 2) - 0.15
        name = f"leg{leg}"
        yield link(f"{name}_hip", 0.3)
        yield hinge(f"{name}_hip", "base", f"{x} {0.1 * side} 0", "1 0 0")
        yield link(f"{name}_thigh", 0.5, middle=-0.1)
        yield hinge(f"{name}_thigh", f"{name}_hip", f"0 {0.05 * side} 0", "0 1 0")
        yield link(f"{name}_calf", 0.2, middle=-0.1)
        yield hinge(f"{name}_calf", f"{name}_thigh", "0 0 -0.2", "0 1 0")
        yield link(f"{name}_foot", 0.05, '<sphere radius="0.02"/>')
        yield (
            f'<joint name="{name}_foot_joint" type="fixed"><parent link="{name}_calf"/>'
            f'<child link="{name}_foot"/><origin xyz="0 0 -0.2"/></joint>'
        )
    parent, place = "base", "0 0 0.05"
    for joint in range(arm_joints):
        name = f"arm{joint}"
        yield link(name, 0.05)
        yield hinge(name, parent, place, "0 1 0" if joint % 2 else "1 0 0")
        parent, place = name, "0 0 0.02"
    yield "</robot>"


def fit_exponent(points: Sequence[tuple[int, float]]) -> float:
    """Return the exponent p of time ~ count^p, fitted to the last decade of counts."""
    last = [(count, took) for count, took in points if count >= points[-1][0] / 10]
    counts, times = np.log(np.array(last)).T
    return float(np.polyfit(counts, times, 1)[0])


def draw_growth(found: dict[str, list[tuple[int, float]]], path: Path) -> None:
    """Draw time [s] against number, with logarithmic axes.

    One panel has the calls, two the sizes of generated robots.
    """
    from matplotlib.figure import Figure
    from matplotlib.ticker import NullLocator

    from pupper_analysis.present.colours import SERIES_COLOURS

    panels: dict[str, dict[str, list[tuple[int, float]]]] = {
        "number of variants, configurations, stands or cells": {},
        "number of legs, 3 joints each": {},
        "number of joints, 4 legs": {},
    }
    calls, legs, joints = panels.values()
    for name, points in found.items():
        call, _, varied = name.partition(", by ")
        if "contacts of legs" in varied:
            legs[call] = points
        elif varied.startswith("joints"):
            joints[call] = points
        else:
            calls[name] = points
    figure = Figure(figsize=(12.0, 4.2), layout="constrained")
    axes = figure.subplots(1, 3, sharey=True)
    for panel, (label, curves) in zip(axes, panels.items(), strict=True):
        for (name, points), colour, marker in zip(
            curves.items(), SERIES_COLOURS, "os^D", strict=False
        ):
            counts, seconds = zip(*points, strict=True)
            panel.loglog(counts, seconds, color=colour, marker=marker, markersize=4, label=name)
        panel.set_xlabel(label)
        panel.grid(True, which="major", alpha=0.3)
        if curves is calls:
            panel.xaxis.set_major_formatter("{x:g}")
            panel.legend(fontsize="small", loc="lower right")
        else:
            panel.set_xticks(counts, [str(count) for count in counts])
            panel.xaxis.set_minor_locator(NullLocator())
            panel.legend(fontsize="small", loc="center left")
    axes[0].set_ylabel("processor time (s)")
    figure.savefig(path, dpi=120)
