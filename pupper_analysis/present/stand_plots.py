"""Plots of stands and of their verification, in figures of ``pyplot``."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.present.documents.standing import height_plot
from pupper_analysis.present.plots import create_figure, draw_result, name_kind
from pupper_analysis.robot.robot import Robot
from pupper_analysis.simulation.verify import StandVerification
from pupper_analysis.stance.judge import Stand
from pupper_analysis.stance.stand import stand_statics

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@draw_result.register(Stand)
def draw_stand(stand: Stand, robot: Robot | None = None) -> tuple[Axes, ...]:
    """Draw skeleton, contact forces, CoM and support polygon of a stand, in two panels.

    The views are oblique and from above.

    Raises:
        ConfigurationError: If the robot is missing, is not the robot of the stand, or stands on no
            foot.
        StaticsInfeasibleError: If no contact forces balance the stand.
    """
    from pupper_analysis.present.figures.pose import make_pose_figure

    robot = robot or stand.own_robot
    if robot is None:
        raise ConfigurationError("robot", diagnose("plot-needs-robot", kind=name_kind(stand)))
    robot = stand.check(robot)
    if not stand.stance_feet:
        raise ConfigurationError("robot", diagnose("plot-without-feet", robot=robot.name))
    statics = stand_statics(robot, stand)
    return tuple(make_pose_figure(robot, stand, statics, create_figure).axes)


@draw_result.register(StandVerification)
def draw_verification(run: StandVerification, _: Robot | None = None) -> tuple[Axes, ...]:
    """Draw the base height [mm] of a simulated stand over time [s], and return the axes."""
    from pupper_analysis.present.figures.drawing import make_plots_figure

    height = run.base_height + run.height_loss
    return tuple(make_plots_figure([height_plot([run], height)], create=create_figure).axes)
