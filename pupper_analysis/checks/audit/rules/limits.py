"""Rules about the limits of joints."""

from __future__ import annotations

import math
from collections.abc import Iterator

import mujoco
import numpy as np

from pupper_analysis.checks.audit.from_mjcf import line_of
from pupper_analysis.checks.audit.from_urdf import number
from pupper_analysis.checks.audit.registry import Found, rule
from pupper_analysis.checks.audit.view import HINGE, MjcfView, UrdfView, View


@rule
def range_empty(view: View) -> Iterator[Found]:
    """Finds lower >= upper, also where both are left out of a URDF, where they count as 0.

    Of an MJCF's ranges that nothing says to be off, also those of actuators: MuJoCo takes an
    inverted one for none, without a word.
    """
    for joint in view.joints.values():
        if joint.moves and joint.lower >= joint.upper:
            limits = f"its lower limit is {joint.lower:g}, its upper {joint.upper:g} {joint.unit}"
            yield Found("joint", joint.name, limits, "limit")
    if isinstance(view, MjcfView) and view.refusal is None:
        yield from _inverted(view)


def _inverted(view: MjcfView) -> Iterator[Found]:
    spec, auto = view.file.spec, mujoco.mjtLimited.mjLIMITED_AUTO
    kinds = (
        ("joint", spec.joints, (("range", "limited"), ("actfrcrange", "actfrclimited"))),
        (
            "actuator",
            spec.actuators,
            (("ctrlrange", "ctrllimited"), ("forcerange", "forcelimited")),
        ),
        ("tendon", spec.tendons, (("range", "limited"),)),
    )
    for tag, elements, pairs in kinds:
        for element in elements:
            for name, switch in pairs:
                low, high = np.array(getattr(element, name)).reshape(-1)[:2]
                if getattr(element, switch) == auto and low > high:
                    around = element.parent.name if tag == "joint" else view.base
                    place = None if element.name else line_of(view.file, element, around)
                    text = f"its {name} is [{low:g}, {high:g}]: MuJoCo takes it for no limit"
                    yield Found(tag, element.name, text, place=place)


@rule
def limit_missing(view: View) -> Iterator[Found]:
    """Finds hinges and slides without a range, but for wheels.

    In a URDF, these are those of type continuous: others without <limit> are refused on reading.
    """
    for joint in view.joints.values():
        if joint.moves and math.isinf(joint.lower) and "wheel" not in joint.name.lower():
            ignored = _limits_without_effect(view, joint.name)
            if ignored:
                yield Found("joint", joint.name, ignored, "limit")
                continue
            text = f"this {joint.kind} turns or slides without end"
            yield Found("joint", joint.name, text)


def _limits_without_effect(view: View, name: str) -> str:
    """Says so if a joint of type continuous states limits all the same."""
    if not isinstance(view, UrdfView):
        return ""
    limit = view.file.root.find(f"joint[@name='{name}']/limit") if "'" not in name else None
    if limit is None or limit.get("lower") is None or limit.get("upper") is None:
        return ""
    lower, upper = number(limit, "lower", 0.0), number(limit, "upper", 0.0)
    if lower >= upper:
        return ""
    return (
        f"it is of type continuous, so that its limits [{lower:g}, {upper:g}] rad have no effect; "
        'say type="revolute" if they are meant, or take them out'
    )


@rule
def limits_in_wrong_unit(view: View) -> Iterator[Found]:
    """Finds integer limits of 12 to 360 rad, and an MJCF in degrees with none above 2 pi.

    Limits of 10 rad are a habit of those who want none.
    """
    hinges = [
        j for j in view.joints.values() if j.kind == HINGE and math.isfinite(j.lower + j.upper)
    ]
    for joint in hinges:
        limits = (joint.lower, joint.upper)
        integers = all(abs(value - round(value)) < 1e-9 for value in limits)
        if integers and 12 <= max(map(abs, limits)) <= 360:
            text = f"[{limits[0]:g}, {limits[1]:g}] rad look like degrees"
            yield Found("joint", joint.name, text, "limit")
    if not isinstance(view, MjcfView) or not view.file.spec.compiler.degree or len(hinges) < 3:
        return
    widest = max(hinges, key=lambda j: max(abs(j.lower), abs(j.upper)))
    low, high = np.rad2deg((widest.lower, widest.upper))
    if max(abs(low), abs(high)) <= 2 * math.pi:
        text = (
            f"the file is in degrees, and the widest range of its {len(hinges)} hinges is "
            f"[{low:.4g}, {high:.4g}] degrees: that looks like radians"
        )
        yield Found("joint", widest.name, text)


@rule
def effort_or_velocity_zero(view: UrdfView) -> Iterator[Found]:
    """Finds <limit effort="0"> and <limit velocity="0"> on joints that move and mimic none."""
    for joint in view.file.root.findall("joint"):
        limit = joint.find("limit")
        if limit is None or joint.get("type") == "fixed" or joint.find("mimic") is not None:
            continue
        zero = [what for what in ("effort", "velocity") if number(limit, what, 1.0) <= 0]
        if zero:
            values = " and ".join(
                f"its {what} limit is {number(limit, what, 0.0):g}" for what in zero
            )
            yield Found("joint", str(joint.get("name")), values, "limit")
