"""Plots of stands, of their statics and of their verification, in figures of ``pyplot``."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.present.colours import BLUE_COLOUR
from pupper_analysis.present.document import Name, get_english
from pupper_analysis.present.documents.standing import height_plot
from pupper_analysis.present.plots import Canvas, draw_plots, draw_result, make_panels
from pupper_analysis.robot.robot import Robot
from pupper_analysis.simulation.verify import StandVerification
from pupper_analysis.stance.judge import Stand
from pupper_analysis.stance.stand import stand_statics
from pupper_analysis.stance.whole_body import SolvedPosture
from pupper_analysis.statics.equilibrium import Equilibrium

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_ROW_HEIGHT = 0.22
"""Height of the row of a joint in the plot of motor torques [inch]. Chosen, not tuned."""


@draw_result.register(Stand)
def draw_stand(stand: Stand, robot: Robot | None, canvas: Canvas) -> tuple[Axes, ...]:
    """Draw skeleton, contact forces, CoM and support polygon of a stand, in two panels.

    The views are oblique and from above. If no foot carries load, the joints and links are drawn
    without forces.

    Raises:
        ConfigurationError: If the robot is missing, or is not the robot of the stand.
        StaticsInfeasibleError: If no contact forces balance the stand.
    """
    from pupper_analysis.present.figures.pose import make_pose_figure, make_skeleton_figure

    robot = robot or stand.own_robot
    if robot is None:
        raise ConfigurationError("robot", diagnose("plot-needs-robot", kind=type(stand).__name__))
    robot = stand.check(robot)
    if not stand.stance_feet:
        return tuple(make_skeleton_figure(robot, stand.qpos, canvas.create_figure).axes)
    statics = stand_statics(robot, stand)
    return tuple(make_pose_figure(robot, stand, statics, canvas.create_figure).axes)


@draw_result.register(SolvedPosture)
def draw_posture(posture: SolvedPosture, robot: Robot | None, canvas: Canvas) -> tuple[Axes, ...]:
    """Draw a posture in two panels: as a stand with contact forces, or as joints and links.

    Raises:
        ConfigurationError: If the robot is missing, or is not the robot of the posture's stand.
        StaticsInfeasibleError: If the posture belongs to a stand, and no contact forces balance the
            stand.
    """
    from pupper_analysis.present.figures.pose import make_skeleton_figure

    robot = robot or posture.robot
    if robot is None:
        raise ConfigurationError("robot", diagnose("plot-needs-robot", kind=type(posture).__name__))
    if posture.stand is not None and posture.stand.stance_feet:
        return draw_stand(posture.stand, robot, canvas)
    return tuple(make_skeleton_figure(robot, posture.qpos, canvas.create_figure).axes)


@draw_result.register(StandVerification)
def draw_verification(run: StandVerification, _: Robot | None, canvas: Canvas) -> tuple[Axes, ...]:
    """Draw the base height [mm] of a simulated stand over time [s], and return the axes."""
    height = run.base_height + run.height_loss
    robot = None if run.stand is None else run.stand.own_robot
    plot = height_plot([run], height)
    verdict = "HOLDS" if run.passed else "FAILS"
    name = f"{verdict} {robot.name}" if robot is not None else verdict
    title = Name(f"{name}: {get_english(plot.title)}")
    return draw_plots([plot], title, canvas, named=False)


@draw_result.register(Equilibrium)
def draw_equilibrium(statics: Equilibrium, robot: Robot | None, canvas: Canvas) -> tuple[Axes, ...]:
    """Draw the motor torques [N m, N] as bars, one row per joint, and return the single axes.

    Known utilisations are beside the bars. The title contains the name of ``robot``, if given.
    """
    title = "Static motor torques" if robot is None else f"{robot.name}: static motor torques"
    (axes,) = make_panels(title, 1.1 + _ROW_HEIGHT * len(statics.joint_names), canvas)
    torques = statics.joint_torques.tolist()
    bars = axes.barh(statics.joint_names, torques, color=BLUE_COLOUR)
    shares = statics.motor_utilisation.tolist()
    labels = ["" if math.isnan(share) else f"{100 * share:.0f} %" for share in shares]
    axes.bar_label(bars, labels, padding=3)
    axes.axvline(0.0, color="black", linewidth=0.8)
    axes.margins(x=0.15)
    axes.invert_yaxis()  # the first joint is at the top
    unknown = sum(map(math.isnan, shares))
    if unknown == len(shares):
        meaning = "no torque limit is known"
    elif unknown:
        meaning = "with the utilisation of each known torque limit"
    else:
        meaning = "with the utilisation of the torque limit"
    axes.set_xlabel(f"torque (N m; slides: N)\n{meaning}")
    return (axes,)
