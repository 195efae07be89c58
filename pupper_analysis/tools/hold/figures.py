"""Figure of a posture of a robot with a fixed base: torques, reach, and forces on the tool."""

from __future__ import annotations

from pathlib import Path

from pupper_analysis.present.document import Name
from pupper_analysis.present.documents.loads import torque_plot
from pupper_analysis.present.figures.drawing import write_plots
from pupper_analysis.tools.hold.document import force_plot, reach_plot
from pupper_analysis.tools.hold.hold import Hold


def hold_figure(hold: Hold, path: str | Path) -> None:
    """Draw motor torques, utilisation over the reach, and forces on the tool as a PNG file.

    Raises:
        OutputError: If the file cannot be written.
    """
    simulated, limits = hold.verification.joint_torques.tolist(), hold.limits.tolist()
    plots = {
        "Motor torques": torque_plot(hold.statics, simulated, limits),
        "Utilisation over the reach": reach_plot(hold.reach),
        "Forces on the tool": force_plot(hold.force),
    }
    title = Name(f"{hold.name}: hold, tool {hold.tool.name}")
    write_plots(list(plots.values()), path, title=title, names=list(plots))
