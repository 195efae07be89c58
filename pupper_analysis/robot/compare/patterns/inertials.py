"""Inertials of which nothing is the other file's: of another body, or another version."""

from __future__ import annotations

import math

import numpy as np

from pupper_analysis.base.diagnostics import Quantity, diagnose
from pupper_analysis.robot.compare.patterns.case import Found, PatternCase, PatternFinding

_LEAST_INERTIALS = 4  # bodies that are told in one line

_OTHER_BODYS_MASS = 0.1
"""How far a mass is off, at least, that is taken for another body's: not a screw more or less."""

_PLACEHOLDER = 1e-3
"""Share of the other's mass below which a body is there for the sake of the joint alone."""


def other_inertials(case: PatternCase) -> Found:
    """Finds bodies of which nothing is the other file's."""
    kinds = ("mass", "com", "inertia")
    others = []
    for name, one in case.first.bodies.items():
        two = case.second.bodies[name]
        if not {(kind, name) for kind in kinds} <= set(case.open):
            continue
        if one.mass and two.mass and abs(two.mass - one.mass) >= _OTHER_BODYS_MASS * one.mass:
            others.append(name)
    if len(others) >= _LEAST_INERTIALS:
        yield PatternFinding(
            "inertial",
            diagnose("inertials-of-another-robot", count=len(others), bodies=others),
            {(kind, name) for kind in kinds for name in others},
        )
        return
    for name in others:
        one, two = case.first.bodies[name], case.second.bodies[name]
        twin = next(
            (
                body.link or other
                for other, body in case.first.bodies.items()
                if other != name
                and math.isclose(body.mass, two.mass, rel_tol=case.tolerances.mass)
                and np.allclose(body.com, two.com, atol=case.tolerances.com)
            ),
            None,
        )
        if min(one.mass, two.mass) < _PLACEHOLDER * max(one.mass, two.mass):
            guess = diagnose("guess-placeholder")
        elif twin:
            guess = diagnose("guess-inertial-of-another-body", body=twin)
        else:
            guess = diagnose("guess-another-version")
        yield PatternFinding(
            "inertial",
            diagnose(
                "inertial-of-another",
                subject=("link", one.link or name),
                urdf=Quantity(one.mass, "kg"),
                mjcf=Quantity(two.mass, "kg"),
                guess=guess,
            ),
            {(kind, name) for kind in kinds},
        )
