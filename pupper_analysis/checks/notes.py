"""What a URDF cannot or does not state, and was given of the MJCF's: in words."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from pupper_analysis.checks.differences import Effect, Explanation
from pupper_analysis.checks.matching import Match

_VALUES = 6
"""Different values that are listed; of more, the least and the greatest."""


def unstated_notes(matched: Match, explanation: Explanation) -> Iterator[str]:
    """Yields what the damping and the dry friction do that the URDF does not state."""
    model = matched.robot.pin_model

    def of_joints(values: Sequence[float], word: str) -> dict[str, float]:
        places = {n: model.joints[model.getJointId(n)].idx_v for n in matched.unstated[word]}
        return {name: float(values[place]) for name, place in places.items()}

    if matched.unstated.get("damping"):
        damping = _by_value(of_joints(model.damping, "damping"))
        forward = explanation.damping.get("forward dynamics", Effect(0.0, 0.0, 0.0)).relative
        yield (
            f"damping ({damping}; N m s/rad) is stated by the MJCF alone, and was given to both. A "
            f"model of the URDF without it has its accelerations off by {forward:.2g} of their "
            "scale: add <dynamics damping=.../>; --strict makes it a difference"
        )
    if matched.unstated.get("friction"):
        friction = of_joints(model.friction, "friction")
        yield (
            f"dry friction ({_by_value(friction)}; N m) is stated by the MJCF alone, and was given "
            "to both. In a model of the URDF without it joints move under less torque than that: "
            "add <dynamics friction=.../>; --strict makes it a difference"
        )


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
