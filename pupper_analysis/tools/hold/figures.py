"""The figure of a posture that is held: torques, the tool's reach, and forces on the tool."""

from __future__ import annotations

from pathlib import Path

from pupper_analysis.present.documents.loads import torque_plot
from pupper_analysis.present.figures import style
from pupper_analysis.present.figures.drawing import draw_plot
from pupper_analysis.tools.hold.document import force_plot, reach_plot
from pupper_analysis.tools.hold.hold import Hold


def hold_figure(hold: Hold, path: str | Path) -> None:
    """Draws what a posture asks of the motors, over the tool's reach, and which forces they bear.

    Args:
        hold: What is drawn.
        path: The PNG to write.

    Raises:
        OutputError: If the file cannot be written.
    """
    simulated, limits = hold.verification.joint_torques.tolist(), hold.limits.tolist()
    drawn = {
        "Motor torques": torque_plot(hold.statics, simulated, limits),
        "Utilisation over the reach": reach_plot(hold.reach),
        "Forces on the tool": force_plot(hold.force),
    }
    height = max(3.0, 0.16 * len(limits) + 0.9)
    title = f"{hold.name}: a posture that is held, and its tool ({hold.tool.name})"
    figure = style.page_figure(title, height + 0.5, layout="constrained")
    for index, (name, plot) in enumerate(drawn.items()):
        axes = figure.add_subplot(1, len(drawn), index + 1)
        handles = draw_plot(plot, axes)
        style.title_panel(axes, name)
        if index:
            axes.legend(handles=handles, fontsize=style.FONT - 1, frameon=False, loc="best")
    style.save_figure(figure, path)
