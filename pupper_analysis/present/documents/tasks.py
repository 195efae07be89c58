"""What is asked of a stand, in both languages."""

from __future__ import annotations

from pupper_analysis.present.document import Text
from pupper_analysis.stance.task import StandTask


def task_text(task: StandTask) -> Text:
    """Returns what is asked of a stand, as the task itself says it."""
    return Text(str(task), lambda: task.said("zh"))
