"""Efforts of a URDF that are the motors', before their gears."""

from __future__ import annotations

from collections import defaultdict

from pupper_analysis.checks.patterns.case import Case, Finding, Found
from pupper_analysis.models.efforts import gear_left_out

_NAMED = 4  # joints that are told in one line


def before_gears(case: Case) -> Found:
    """Finds efforts that are the MJCF's once they are multiplied by the gears there."""
    model = case.robot.mj_model
    found: dict[tuple[float, float], list[str]] = defaultdict(list)
    for kind, name in case.open:
        if kind == "effort":
            effort = case.first.joints[name].effort
            gear = gear_left_out(model, model.joint(name).id, effort)
            if gear is not None:
                found[effort, gear].append(name)
    if not found:
        return
    said = [
        f"{effort:.6g} times {gear:.6g} is {effort * gear:.6g} on {names[0]}"
        + (f" and {len(names) - 1} more" if len(names) > 1 else "")
        for (effort, gear), names in found.items()
    ]
    listed = ", ".join(said[:_NAMED]) + (" …" if len(said) > _NAMED else "")
    joints = [name for names in found.values() for name in names]
    yield Finding(
        "gears",
        f"the URDF's efforts of {len(joints)} joints are the motors', before their gears, by which "
        f"the MJCF's limits are greater: {listed} (an effort is the joint's: multiply it)",
        {("effort", name) for name in joints},
    )
