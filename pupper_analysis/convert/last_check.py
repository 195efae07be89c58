"""The last check of a converted MJCF: the written file, from its own keyframe, in bare MuJoCo."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import mujoco

from pupper_analysis.diagnostics import Diagnostic
from pupper_analysis.results import Result
from pupper_analysis.robot.stability import LASTING, Stability, step_stability
from pupper_analysis.simulation.causes import find_instability
from pupper_analysis.simulation.nudge import Nudge, measure_response, simulate_nudge
from pupper_analysis.simulation.rollout import full_state


@dataclass(frozen=True, eq=False)
class KeyframeRun(Result):
    """What an MJCF does from its own keyframe when it is nudged.

    Attributes:
        keyframe: Its name.
        stability: Of where it settles.
        nudge: What becomes of a nudge that is given at once.
        failures: Why it does not stay there.
    """

    keyframe: str
    stability: Stability
    nudge: Nudge
    failures: tuple[Diagnostic, ...]


def keyframe_run(path: Path, duration: float = LASTING) -> KeyframeRun | None:
    """Simulates a file from its first keyframe, with nothing added and nothing changed.

    Args:
        path: The MJCF, as it was written.
        duration: s.

    Returns:
        What it does; None if it has no keyframe.
    """
    model = mujoco.MjModel.from_xml_path(str(path))
    if not model.nkey:
        return None
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    start = full_state(model, data)
    nudge = measure_response(model, start, simulate_nudge(model, start, data.ctrl.copy(), duration))
    stability = step_stability(model, data)
    failures = tuple(find_instability(stability, nudge))
    return KeyframeRun(model.key(0).name, stability, nudge, failures)
