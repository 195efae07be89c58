"""What is asked of a stand, in both languages."""

from __future__ import annotations

import math
from collections.abc import Iterator

from pupper_analysis.report.document import Name, Text
from pupper_analysis.report.html.words import text
from pupper_analysis.stance.task import StandTask


def task_text(task: StandTask) -> Text:
    """Returns what is asked of a stand: in English as the task itself says it."""
    return Text(str(task), lambda: "，".join(part.zh for part in _parts(task)))  # noqa: RUF001


def _parts(task: StandTask) -> Iterator[Text]:
    """Returns its values in the order of ``str(task)``."""
    if task.height is not None:
        yield text("height {value} m", value=f"{task.height:.4f}")
    for name in ("roll", "pitch", "yaw"):
        value = f"{math.degrees(getattr(task, name)):.1f}"
        yield text("{angle} {value} deg", angle=text(name), value=value)
    if task.offset is not None:
        yield text("base ({place}) mm from the centre", place=_millimetres(task.offset))
    for foot, place in task.feet.items():
        yield text("{foot} at ({place}) mm", foot=Name(foot), place=_millimetres(place))
    for foot, place in task.foot_offsets.items():
        yield text("{foot} moved by ({place}) mm", foot=Name(foot), place=_millimetres(place))
    for foot, height in task.swing.items():
        yield text("{foot} lifted {value} mm", foot=Name(foot), value=f"{1e3 * height:.0f}")
    if task.ground.slope:
        yield text(
            "slope {slope} deg, rising towards {uphill} deg",
            slope=f"{math.degrees(task.ground.slope):.1f}",
            uphill=f"{math.degrees(task.ground.uphill):.0f}",
        )
    for foot, height in task.ground.heights.items():
        yield text("{foot} on {value} mm", foot=Name(foot), value=f"{1e3 * height:.0f}")
    yield from _margins(task)


def _margins(task: StandTask) -> Iterator[Text]:
    if task.com == "inside" or (task.offset is not None and task.com_margin):
        yield text("com inside by {value} mm", value=f"{1e3 * task.com_margin:.0f}")
    elif task.com is not None and not isinstance(task.com, str):
        yield text("com at ({place}) mm", place=_millimetres(task.com))
    if task.joint_margin:
        value = f"{math.degrees(task.joint_margin):.1f}"
        yield text("{value} deg off the joint limits", value=value)
    if task.ground_clearance:
        yield text("{value} mm off the ground", value=f"{1e3 * task.ground_clearance:.0f}")
    if task.self_clearance is not None:
        yield text("links {value} mm apart", value=f"{1e3 * task.self_clearance:.0f}")


def _millimetres(point: tuple[float, float]) -> str:
    return f"{1e3 * point[0]:.0f}, {1e3 * point[1]:.0f}"
