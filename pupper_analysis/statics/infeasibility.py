"""Why no contact forces hold a robot: motors, friction, or feet that would have to pull."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import Quantity, diagnose
from pupper_analysis.base.errors import Infeasibility, StaticsInfeasibleError
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.statics.cone_program import Balance
from pupper_analysis.statics.contacts import Contacts
from pupper_analysis.statics.support_polygon import com_margin

Array = NDArray[np.float64]

_NO_SLIDING = 1e4
"""A friction coefficient that stands for a foot that cannot slide."""


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
