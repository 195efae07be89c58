"""Efforts of a URDF that are the motors', before their gears."""

from __future__ import annotations

from collections import defaultdict

from pupper_analysis.checks.patterns.case import Found, PatternCase, PatternFinding
from pupper_analysis.diagnostics import diagnose
from pupper_analysis.models.efforts import gear_left_out


def before_gears(case: PatternCase) -> Found:
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
    efforts = [
        diagnose("effort-times-gear", effort=effort, gear=gear, product=effort * gear, joints=names)
        for (effort, gear), names in found.items()
    ]
    joints = [name for names in found.values() for name in names]
    yield PatternFinding(
        "gears",
        diagnose("efforts-before-gears", count=len(joints), efforts=efforts),
        {("effort", name) for name in joints},
    )
