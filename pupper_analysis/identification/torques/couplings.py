"""Motors that turn with several joints: behind a wrist's gears, a belt along a link."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.arguments import check_type
from pupper_analysis.diagnostics import diagnose
from pupper_analysis.errors import ConfigurationError, UnknownNameError
from pupper_analysis.robot.robot import Robot

_TERM = re.compile(
    r"(?P<sign>[+-]?)\s*(?:(?P<factor>\d+(?:\.\d*)?|\.\d+)\s*\*\s*)?(?P<joint>[^\s+*]+)"
)
"""A joint and its factor; a minus within its name is part of it."""


@dataclass(frozen=True)
class Coupling:
    """What turns with several joints, with friction and inertia of its own.

    Attributes:
        name: Of the motor.
        factors: {joint: how far it turns for a turn of the joint}, after its gear.
    """

    name: str
    factors: Mapping[str, float]


def parse_coupling(text: str) -> Coupling:
    """Reads ``NAME=JOINT+JOINT``, as ``motor_6=joint_5+joint_6`` or ``belt=hip + -0.5*knee``.

    Raises:
        ConfigurationError: If it says nothing.
    """
    check_type("text", text, str)
    name, _, joints = (part.strip() for part in text.partition("="))
    terms = [_TERM.fullmatch(term.strip()) for term in joints.split("+")]
    factors = {
        term["joint"]: float(term["factor"] or 1) * (-1 if term["sign"] == "-" else 1)
        for term in terms
        if term
    }
    if not name or len(factors) < 2 or len(factors) != len(terms):
        raise ConfigurationError("coupling", diagnose("no-coupling", text=text))
    return Coupling(name, factors)


def coupling_rows(
    robot: Robot, couplings: Sequence[Coupling], told: Sequence[str]
) -> NDArray[np.float64]:
    """Returns how far motors turn for a turn of each of a robot's joints (couplings, nu).

    Raises:
        ConfigurationError: If a motor has the name of a joint.
        UnknownNameError: If a joint is none of those that are told.
    """
    rows = np.zeros((len(couplings), robot.nu))
    for row, coupling in zip(rows, couplings, strict=True):
        if coupling.name in robot.joint_names:
            told_twice = diagnose("coupling-named-as-joint", name=coupling.name)
            raise ConfigurationError("coupling", told_twice)
        for joint, factor in coupling.factors.items():
            if joint not in told:
                raise UnknownNameError(robot.name, "joint", joint, tuple(told))
            row[robot.joint_names.index(joint)] = factor
    return rows
