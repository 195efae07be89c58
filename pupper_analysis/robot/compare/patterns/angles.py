"""Angles that one file reads in another unit, or Euler angles in another sequence."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import mujoco

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.robot.compare.patterns.case import (
    Found,
    Key,
    PatternCase,
    PatternFinding,
)
from pupper_analysis.robot.matching.trees import kinematic_trees

_SEQUENCES = ("xyz", "xzy", "yxz", "yzx", "zxy", "zyx")


def other_angles(case: PatternCase) -> Found:
    """Finds another eulerseq, or degrees for radians, that ends differences."""
    if not {"rotation", "axis", "lower limit", "upper limit", "zero", "base frame"} & {
        kind for kind, _ in case.keys
    }:
        return
    spec = case.robot.description.mjcf
    said = "".join(
        chr(letter) if isinstance(letter, int) else letter for letter in (spec.compiler.eulerseq)
    )
    tries: list[tuple[tuple[str, str, str], Callable[[mujoco.MjSpec], None]]] = []
    if _has_euler(spec):
        for order in (*_SEQUENCES, *(sequence.upper() for sequence in _SEQUENCES)):
            if order != said:
                tries.append((("eulerseq", order, said), partial(_set_sequence, order=order)))
    degree = bool(spec.compiler.degree)
    unit, other_unit = ("degree", "radian") if degree else ("radian", "degree")
    if _has_euler(spec) or {"lower limit", "upper limit"} & {kind for kind, _ in case.keys}:
        tries.append((("angle", other_unit, unit), partial(_set_degree, degree=not degree)))
    best: tuple[tuple[str, str, str], set[Key]] = (("", "", ""), set())
    for setting, change in tries:
        other = spec.copy()
        change(other)
        try:
            model = other.compile()
        except (ValueError, RuntimeError):
            continue
        tree = kinematic_trees(replace(case.robot, mj_model=model))[1]
        gone = case.gone(replace(tree, gravity=case.first.gravity))
        if len(gone) > len(best[1]):
            best = (setting, gone)
    (attribute, value, stated), gone = best
    turned = [key for key in case.keys if key[0] in ("rotation", "axis")]
    limits = [key for key in case.keys if key[0] in ("lower limit", "upper limit")]
    concerned = turned or limits
    if concerned and sum(key in gone for key in concerned) >= 0.6 * len(concerned):
        yield PatternFinding(
            "angles",
            diagnose(
                "angles-meant-otherwise",
                attribute=attribute,
                value=value,
                stated=stated,
                count=len(gone),
                total=len(case.keys),
            ),
            gone,
        )


def _has_euler(spec: mujoco.MjSpec) -> bool:
    kind = mujoco.mjtOrientation.mjORIENTATION_EULER
    return any(body.alt.type == kind or body.ialt.type == kind for body in spec.bodies)


def _set_sequence(spec: mujoco.MjSpec, order: str) -> None:
    spec.compiler.eulerseq = list(order)


def _set_degree(spec: mujoco.MjSpec, degree: bool) -> None:
    spec.compiler.degree = degree
