"""What a URDF cannot or does not state, and was given of the MJCF's."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from pupper_analysis.checks.differences import Effect, Explanation
from pupper_analysis.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.matching.match import Match

_VALUES = 6
"""Different values that are listed; of more, the least and the greatest."""


_NAMED = 3
"""Joints that are named; more are counted."""


def unstated_notes(matched: Match, explanation: Explanation) -> Iterator[Diagnostic]:
    """Yields what the damping and the dry friction do that the URDF does not state."""
    model = matched.robot.pin_model

    def of_joints(values: Sequence[float], word: str) -> dict[str, float]:
        places = {n: model.joints[model.getJointId(n)].idx_v for n in matched.unstated[word]}
        return {name: float(values[place]) for name, place in places.items()}

    if matched.unstated.get("damping"):
        damping = _by_value(of_joints(model.damping, "damping"), "N m s/rad")
        forward = explanation.damping.get("forward dynamics", Effect(0.0, 0.0, 0.0)).relative
        yield diagnose("damping-of-the-mjcf-alone", values_are=damping, forward=forward)
    if matched.unstated.get("friction"):
        friction = _by_value(of_joints(model.friction, "friction"), "N m")
        yield diagnose("friction-of-the-mjcf-alone", values_are=friction)


def armature_notes(explanation: Explanation) -> Iterator[Diagnostic]:
    """Yields what the armature does, which the URDF cannot state, for who builds models of it."""
    effects = explanation.armature
    if any(effects.values.values()):
        yield diagnose(
            "armature-of-the-mjcf-alone",
            values_are=_by_value(effects.values, "kg m^2"),
            mass_matrix=effects.effects.get("mass matrix", Effect(0.0, 0.0, 0.0)).relative,
            forward=effects.effects.get("forward dynamics", Effect(0.0, 0.0, 0.0)).relative,
        )


def _by_value(values: Mapping[str, float], unit: str) -> list[Diagnostic]:
    """Lists the joints of each value; of many values, the least and the greatest."""
    found: dict[str, list[str]] = {}
    for name, value in values.items():
        found.setdefault(f"{value:.6g}", []).append(name)
    if len(found) > _VALUES:
        least, greatest = (Quantity(f(values.values()), unit) for f in (min, max))
        return [diagnose("values-of-joints", least=least, greatest=greatest, count=len(values))]
    return [
        diagnose(
            "value-of-joints",
            value=Quantity(values[names[0]], unit),
            joints=names,
            count=len(names),
            few=len(names) <= _NAMED,
        )
        for names in found.values()
    ]
