"""The quantities that every backend evaluates, with their labels and units."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.robot.robot import Robot

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class QuantityValues:
    """One quantity's values in one evaluation.

    Attributes:
        values: (n, ...) of the model, or (configurations, n, ...) of states.
        labels: (n,) what each row belongs to.
        unit: The unit.
        per_row: Whether each row is judged on its own scale (masses, inertias) instead of on the
            greatest of all.
        of_state: Whether there is one set of rows per configuration.
    """

    values: Array
    labels: tuple[str, ...]
    unit: str
    per_row: bool = False
    of_state: bool = False


Evaluation = dict[str, QuantityValues]


def model_quantities(
    robot: Robot,
    *,
    masses: Sequence[float],
    coms: Sequence[Array],
    inertias: Sequence[Array],
    anchors: Sequence[Array],
    axes: Sequence[Array],
    lower: Array,
    upper: Array,
    effort: Array,
    armature: Array,
    damping: Array,
    friction: Array,
) -> Evaluation:
    """Collects what does not depend on the configuration, in the base's axes at zero angles."""
    bodies = (robot.base, *robot.joint_names)
    joints = robot.joint_names
    rows: list[tuple[str, object, tuple[str, ...], str, bool]] = [
        ("body masses", masses, bodies, "kg", True),
        ("body coms", coms, bodies, "m", False),
        ("body inertias", inertias, bodies, "kg m^2", True),
        ("joint positions", anchors, joints, "m", False),
        ("joint axes", axes, joints, "", False),
        ("lower joint limits", lower, joints, "rad", False),
        ("upper joint limits", upper, joints, "rad", False),
        ("effort limits", effort, joints, "N m", False),
        ("armature", armature, joints, "kg m^2", False),
        ("joint damping", damping, joints, "N m s/rad", False),
        ("joint friction", friction, joints, "N m", False),
    ]
    return {
        name: QuantityValues(
            np.array(values, dtype=float).reshape(len(labels), -1), labels, unit, each
        )
        for name, values, labels, unit, each in rows
    }


def state_quantities(robot: Robot, rows: Mapping[str, list[Array]]) -> Evaluation:
    """Collects what was computed at each configuration."""
    base = (
        ()
        if not robot.floating
        else ("base x", "base y", "base z", "about x", "about y", "about z")
    )
    dofs = (*base, *robot.joint_names)
    about: dict[str, tuple[tuple[str, ...], str]] = {
        "foot positions": (robot.contact_points, "m"),
        "foot Jacobians": (robot.contact_points, "m, m/rad"),
        "com": (("com",), "m"),
        "com Jacobian": (("com",), "m, m/rad"),
        "mass matrix": (dofs, "kg, kg m, kg m^2"),
        "bias forces": (dofs, "N, N m"),
        "gravity": (dofs, "N, N m"),
        "forward dynamics": (dofs, "m/s^2, rad/s^2"),
        "gyro": (("IMU",), "rad/s"),
        "accelerometer": (("IMU",), "m/s^2"),
    }
    result: Evaluation = {}
    for name, values in rows.items():
        labels, unit = about[name]
        array = np.array(values).reshape(len(values), len(labels), -1)
        result[name] = QuantityValues(array, labels, unit, of_state=True)
    return result
