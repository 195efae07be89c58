"""Numbers that are all in another unit."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import Diagnostic, Term, diagnose
from pupper_analysis.models.efforts import gear_left_out
from pupper_analysis.models.xml import MAX_NUMBER
from pupper_analysis.robot.compare.patterns.case import Found, PatternCase, PatternFinding

Array = NDArray[np.float64]
_MASS = {
    1e3: ("g", "kg"),
    1e-3: ("kg", "g"),
    2.20462: ("pounds", "kg"),
    0.453592: ("kg", "pounds"),
}
_ANGLE = {math.degrees(1.0): ("degrees", "radians")}
_LENGTH = {1e3: ("mm", "m"), 1e2: ("cm", "m"), 39.3701: ("inches", "m")}
_INERTIA = {
    1e3: ("g m^2", "kg m^2"),
    1e4: ("kg cm^2", "kg m^2"),
    1e6: ("kg mm^2", "kg m^2"),
    1e7: ("g cm^2", "kg m^2"),
    1e9: ("g mm^2", "kg m^2"),
}


def other_units(case: PatternCase) -> Found:
    """Finds masses, lengths or inertias that are all the same multiple of the other file's."""
    first, raw = case.first, case.raw
    bodies = [(one, raw.bodies[name]) for name, one in first.bodies.items() if one.mass]
    masses = _factor([(np.array([a.mass]), np.array([b.mass])) for a, b in bodies])
    inertias = _factor(
        [(a.inertia, case.second.bodies[n].inertia) for n, a in first.bodies.items()]
    )
    places = [(one.position, raw.joints[name].position) for name, one in first.joints.items()]
    lengths = _factor(places)
    hinges = [(one, raw.joints[name]) for name, one in first.joints.items() if not one.slides]
    bounds = [tuple(np.array([j.lower, j.upper]) for j in pair) for pair in hinges]
    limits = _factor((a, b) for a, b in bounds if np.abs([a, b]).max() <= MAX_NUMBER)
    for what, factor, units, kinds in (
        ("limits", limits, _ANGLE, ("lower limit", "upper limit")),
        ("masses", masses, _MASS, ("mass",)),
        ("lengths", lengths, _LENGTH, ("position", "com", "frame")),
        ("inertias", inertias, _INERTIA, ("inertia",)),
    ):
        if factor is None:
            continue
        yield PatternFinding(
            "units",
            diagnose("all-scaled", what=Term(what), factor=factor, guess=_unit(factor, units)),
            {key for key in case.keys if key[0] in kinds},
        )


def _factor(pairs: Iterable[tuple[Array, Array]]) -> float | None:
    """Returns the one factor between all pairs of arrays; None if there is none, or it is 1."""
    ratios = []
    for one, two in pairs:
        size = float(np.linalg.norm(one))
        if size < 1e-12:
            continue
        ratio = float(np.sum(one * two)) / size**2
        if float(np.linalg.norm(two - ratio * one)) > 1e-3 * abs(ratio) * size:
            return None
        ratios.append(ratio)
    if len(ratios) < 2 or min(ratios) <= 0 or max(ratios) > 1.001 * min(ratios):
        return None
    factor = float(np.median(ratios))
    return None if math.isclose(factor, 1.0, rel_tol=1e-2) else factor


def _unit(factor: float, units: Mapping[float, tuple[str, str]]) -> Diagnostic | None:
    for size, (meant, right) in units.items():
        for file, times in (("MJCF", size), ("URDF", 1 / size)):
            if math.isclose(factor, times, rel_tol=2e-3):
                return diagnose("guess-unit", meant=Term(meant), right=Term(right), file=file)
    decimal = math.isclose(abs(math.log10(factor)), 1, abs_tol=1e-3)
    return diagnose("guess-decimal-point") if decimal else None


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
