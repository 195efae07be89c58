"""Why no contact forces hold a robot: motors, friction, or feet that would have to pull."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.diagnostics import Quantity, diagnose
from pupper_analysis.errors import Infeasibility, StaticsInfeasibleError
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.statics.cone_program import Balance, ForceBounds
from pupper_analysis.statics.contacts import Contacts
from pupper_analysis.statics.support_polygon import com_margin

Array = NDArray[np.float64]

_NO_SLIDING = 1e4
"""A friction coefficient that stands for a foot that cannot slide."""


def explain_bounds(robot: Robot, problem: Balance, carrying: Contacts, bounds: ForceBounds) -> None:
    """Raises if forces exist without these bounds: by the motors', or by a foot's load.

    Raises:
        StaticsInfeasibleError: Then.
    """
    even, feet = carrying.metric, carrying.feet
    free = problem.minimum_tangential(carrying.friction, even)
    if free is None:
        return
    strong = replace(bounds, torques=np.full_like(bounds.torques, math.inf))
    if problem.minimum_tangential(carrying.friction, even, strong) is not None:
        torques = np.abs(problem.torques - problem.joints @ free)
        with np.errstate(divide="ignore", invalid="ignore"):
            worst = int(np.nanargmax(torques / bounds.torques))
        name = robot.joint_names[worst]
        detail = diagnose(
            "motor-too-weak",
            subject=("joint", name),
            torque=Quantity(torques[worst], "N m"),
            limit=Quantity(bounds.torques[worst], "N m"),
        )
        raise StaticsInfeasibleError(Infeasibility.MOTOR, detail, margin=math.nan, feet=())
    loads = problem.normal_forces(free)
    wrong = [
        f
        for f, *row in zip(feet, loads, bounds.least, bounds.most, strict=True)
        if not row[1] <= row[0] <= row[2]
    ]
    detail = diagnose("feet-would-pull", feet=wrong or feet)
    raise StaticsInfeasibleError(Infeasibility.PULL, detail, margin=math.nan, feet=wrong or feet)


def explain_infeasibility(
    config: Configuration,
    point: Array,
    problem: Balance,
    carrying: Contacts,
    tipping: Infeasibility,
) -> StaticsInfeasibleError:
    """Finds out why no forces do; see ``balance_load``."""
    feet, friction = carrying.feet, float(carrying.friction.min())
    points = dict(zip(feet, carrying.points(config), strict=True))
    margin = com_margin(point, points)
    even = carrying.metric
    if problem.minimum_tangential(np.full(len(feet), _NO_SLIDING), even) is not None:
        low, high = 0.0, _NO_SLIDING
        while high - low > 1e-6 * high:
            middle = (low * high) ** 0.5 if low > 0 else high / 2
            if problem.minimum_tangential(np.full(len(feet), middle), even) is None:
                low = middle
            else:
                high = middle
            if high < 1e-6:
                break
        return StaticsInfeasibleError(
            Infeasibility.FRICTION,
            diagnose("friction-too-low", least=friction, needed=high),
            margin=margin,
            friction_needed=high,
            feet=feet,
        )
    bilateral = np.linalg.lstsq(problem.base, problem.weight, rcond=1e-12)[0].reshape(-1, 3)
    pulls = {
        foot: float(force @ normal)
        for foot, force, normal in zip(feet, bilateral, problem.normals, strict=True)
        if force @ normal < 0
    }
    pulling = [
        diagnose("foot-pulls", subject=("foot", foot), force=Quantity(-force, "N"))
        for foot, force in pulls.items()
    ]
    if -math.inf < margin < 0:
        outside = Quantity(-margin, "m")
        detail = diagnose("com-outside-polygon", outside=outside, feet=feet, pulls=pulling)
        return StaticsInfeasibleError(tipping, detail, margin=margin, feet=pulls or feet)
    detail = diagnose("feet-would-pull", feet=pulling or feet)
    return StaticsInfeasibleError(Infeasibility.PULL, detail, margin=margin, feet=pulls or feet)
