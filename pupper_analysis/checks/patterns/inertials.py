"""Inertials of which nothing is the other file's: of another body, or another version."""

from __future__ import annotations

import math

import numpy as np

from pupper_analysis.checks.patterns.case import Case, Finding, Found

_MANY = 4  # bodies that are told in one line

_OTHER = 0.1
"""How far a mass is off, at least, that is taken for another body's: not a screw more or less."""

_PLACEHOLDER = 1e-3
"""Share of the other's mass below which a body is there for the sake of the joint alone."""


def other_inertials(case: Case) -> Found:
    """Finds bodies of which nothing is the other file's."""
    kinds = ("mass", "com", "inertia")
    others = []
    for name, one in case.first.bodies.items():
        two = case.second.bodies[name]
        if not {(kind, name) for kind in kinds} <= set(case.open):
            continue
        if one.mass and two.mass and abs(two.mass - one.mass) >= _OTHER * one.mass:
            others.append(name)
    if len(others) >= _MANY:
        listed = ", ".join(others[:_MANY]) + (" …" if len(others) > _MANY else "")
        yield Finding(
            "inertial",
            f"the inertials of {len(others)} bodies differ in mass, com and inertia, and no single "
            f"link of theirs explains it: {listed} (another version of the robot?)",
            {(kind, name) for kind in kinds for name in others},
        )
        return
    for name in others:
        one, two = case.first.bodies[name], case.second.bodies[name]
        twin = next(
            (
                other
                for other, body in case.first.bodies.items()
                if other != name
                and math.isclose(body.mass, two.mass, rel_tol=case.tolerances.mass)
                and np.allclose(body.com, two.com, atol=case.tolerances.com)
            ),
            None,
        )
        whose = f"it is that of {twin} in the URDF" if twin else "another body's, or version's?"
        if min(one.mass, two.mass) < _PLACEHOLDER * max(one.mass, two.mass):
            whose = "one weighs next to nothing: a placeholder?"
        yield Finding(
            "inertial",
            f"body of {name}: nothing of its inertial is the same: mass {one.mass:.6g} kg in the "
            f"URDF, {two.mass:.6g} kg in the MJCF, and another com and inertia ({whose})",
            {(kind, name) for kind in kinds},
        )
