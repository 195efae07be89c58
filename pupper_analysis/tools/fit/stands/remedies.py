"""What else could be measured of stands, and how much it would tell."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.errors import PupperAnalysisError
from pupper_analysis.tools.fit.estimate import Posterior
from pupper_analysis.tools.fit.stands.equations import StandEquations

Array = NDArray[np.float64]

WEIGHED = 0.002
"""Of a mass that a scale shows: standard deviation."""


def further_measurements(
    equations: StandEquations, posterior: Posterior, *, weighed: bool
) -> Iterator[tuple[str, Array]]:
    """Yields what else could be measured, and its information where priors' widths are the units.

    Args:
        equations: Of the stands.
        posterior: What is known of the parameters.
        weighed: Whether the whole robot was put on a scale.
    """
    robot, table, x = equations.robot, equations.table, posterior.mean
    scaled = np.outer(table.width, table.width)
    if not weighed:
        line = np.array([float(one.kind == "mass") for one in table])
        yield "weigh-the-robot", scaled * np.outer(line, line) / (WEIGHED * robot.total_mass) ** 2
    here = equations.linearise(x, x).information
    for what, read in equations.further_readings(x).items():
        there = equations.reading(read).linearise(x, x).information
        yield what, scaled * (there - here)
    if (both := equations.from_both_sides(x)) is not None:
        yield "come-from-both-sides", _of_first(both, x) - scaled * here
    if (three := on_three_feet(equations, x)) is not None:
        yield "stand-on-three-feet", scaled * three.linearise(x, x).information


def _of_first(equations: StandEquations, x: Array) -> Array:
    """Returns the information about the first parameters (n, n), whatever the others of a table.

    In the priors' widths.
    """
    table, n = equations.table, len(x)
    whole = np.concatenate([x, table.stated[n:]])
    told = np.outer(table.width, table.width) * equations.linearise(whole, whole).information
    others = told[n:, n:] + table.precision[n:, n:]
    found: Array = told[:n, :n] - told[:n, n:] @ np.linalg.solve(others, told[n:, :n])
    return found


def on_three_feet(equations: StandEquations, x: Array) -> StandEquations | None:
    """Returns equations of stands with one foot in the air, each foot once.

    They are the robot's nominal stand, with the base moved over three feet. Servos are commanded
    what holds them there.

    Args:
        equations: Of stands on all feet.
        x: (n,) parameters.

    Returns:
        The equations; None if a foot was in the air already, or the robot stands on no three feet.
    """
    # PlaCo is slow to import, and who reads measurements alone needs none.
    from pupper_analysis.stance.stand import solve_stand, stand_statics
    from pupper_analysis.stance.task import StandTask

    robot = equations.robot
    if len(robot.feet) <= _FEWEST or equations.lifted:
        return None
    size, stands = robot.stand_height, []
    for foot in robot.feet:
        task = StandTask(swing={foot: _LIFTED * size}, com="inside", com_margin=_MARGIN * size)
        try:
            stand = solve_stand(robot, task)
            held = stand_statics(robot, stand)
        except PupperAnalysisError:  # no balance without that foot
            continue
        stands.append((stand.qpos, held.joint_torques, held.contact_forces, (foot,)))
    return equations.of_stands(stands, x) if stands else None


_LIFTED, _MARGIN = 0.15, 0.03
"""Of the height: how high a foot is lifted, and how far the com is within the others' triangle. As
plans have them, but for a com that is as near to the edge as three feet allow."""

_FEWEST = 3
"""Feet that a robot stands on, at least; with one more it may lift one."""
