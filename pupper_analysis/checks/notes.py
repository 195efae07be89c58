"""What a URDF cannot or does not state, and was given of the MJCF's: in words."""

from __future__ import annotations

from collections.abc import Mapping

from pupper_analysis.checks.differences import Effect, Explanation
from pupper_analysis.checks.matching import Match

_VALUES = 6
"""Different values that are listed; of more, the least and the greatest."""


def damping_notes(matched: Match, explanation: Explanation) -> list[str]:
    """Says what the damping does that the URDF does not state."""
    if not matched.undamped:
        return []
    model = matched.robot.pin_model
    damping = {
        name: float(model.damping[model.joints[model.getJointId(name)].idx_v])
        for name in matched.undamped
    }
    forward = explanation.damping.get("forward dynamics", Effect(0.0, 0.0, 0.0)).relative
    return [
        f"damping ({_by_value(damping)}; N m s/rad) is stated by the MJCF alone, and was given to "
        "both. A model of the URDF without it has its accelerations off by "
        f"{forward:.2g} of their scale: add <dynamics damping=.../>; --strict makes it a difference"
    ]


def _by_value(values: Mapping[str, float]) -> str:
    """Lists the joints of each value; of many, their number."""
    found: dict[str, list[str]] = {}
    for name, value in values.items():
        found.setdefault(f"{value:.6g}", []).append(name)
    if len(found) > _VALUES:
        return f"{min(values.values()):.6g} to {max(values.values()):.6g} on {len(values)} joints"
    return ", ".join(
        f"{value} on {len(names)} joints" if len(names) > 3 else f"{value} on {' '.join(names)}"
        for value, names in found.items()
    )


def armature_notes(explanation: Explanation) -> list[str]:
    """Says what the armature does, which the URDF cannot state, for who builds models from it."""
    effects = explanation.armature
    if not any(effects.values.values()):
        return []
    off = effects.effects.get("mass matrix", Effect(0.0, 0.0, 0.0)).relative
    forward = effects.effects.get("forward dynamics", Effect(0.0, 0.0, 0.0)).relative
    return [
        f"armature ({_by_value(effects.values)}; kg m^2) is in the MJCF alone, and was given to "
        f"both. A model of the URDF without it has its mass matrix off by {off:.2g}, and its "
        "accelerations by "
        f"{forward:.2g}, of their scale: set pin.Model.armature"
    ]
