"""What became of a conversion."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import mujoco

from pupper_analysis.base.diagnostics import Diagnostic
from pupper_analysis.base.results import Result
from pupper_analysis.models.urdf_file import UrdfFile
from pupper_analysis.prepare.convert.repair import Repair
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


@dataclass(frozen=True)
class ConversionDraft:
    """A new model file that is not written yet.

    Attributes:
        text: Its XML, for the folder it is meant for.
        meshes: {file to be written beside it: its content}.
        notes: What was added, or assumed.
        not_converted: What the new format cannot say, or what was left out.
        repairs: Inertials that were repaired.
        urdf: The URDF with them, if the draft is of one: what the new file is proven against.
        stands: Whether it is a robot that shall stand.
        failure: Why it does not, if that is known already.
        lost: What it cannot do without, and lacks.
        on_balls: The joints whose feet touch with balls in the place of their meshes, as is
            reported.
    """

    text: str
    meshes: dict[Path, bytes]
    notes: tuple[Diagnostic, ...]
    not_converted: tuple[Diagnostic, ...]
    repairs: tuple[Repair, ...] = ()
    urdf: UrdfFile | None = None
    stands: bool = False
    failure: Diagnostic | None = None
    lost: tuple[Diagnostic, ...] = ()
    on_balls: frozenset[str] = frozenset()
