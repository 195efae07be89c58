"""Of which links and bodies a number of a difference is made."""

from __future__ import annotations

from pupper_analysis.checks.differences import Difference
from pupper_analysis.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.matching.sources import Sources


def mass_shares(difference: Difference, urdf: Sources, mjcf: Sources) -> tuple[Diagnostic, ...]:
    """Says of which links or bodies a mass, a com or an inertia is made, with their lines."""
    if difference.kind not in ("mass", "com", "inertia"):
        return ()
    told = []
    for file, sources in (("URDF", urdf), ("MJCF", mjcf)):
        heavy = [(name, mass) for name, mass in sources.members(difference.element) if mass]
        if len(heavy) < 2:
            continue
        total = sum(mass for _, mass in heavy)
        heavy.sort(key=lambda member: -member[1])
        members_told = [
            diagnose(
                "share-of-a-body",
                subject=("body", name),
                mass=Quantity(mass, "kg"),
                share=Quantity(mass / total, "1"),
                place=str(sources.weight(difference.kind, name)),
            )
            for name, mass in heavy[:_LISTED]
        ]
        rest = total - sum(mass for _, mass in heavy[:_LISTED])
        told.append(
            diagnose(
                "body-is-made-of",
                file=file,
                members=members_told,
                more=len(heavy[_LISTED:]),
                rest=Quantity(rest, "kg"),
            )
        )
    return tuple(told)


_LISTED = 6
"""Links of a body that are listed, the heaviest first."""
