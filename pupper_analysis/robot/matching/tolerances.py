"""How far two files may differ before it is a difference."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace

from pupper_analysis.base.arguments import check_fields
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError


@dataclass(frozen=True)
class Tolerances:
    """How far two files may differ in each kind of number.

    The defaults pass files written with 5 to 6 digits.

    Attributes:
        mass: Relative.
        com: Of the com's position (m).
        inertia: Relative to the tensor's largest element.
        position: Of a joint's or frame's position (m).
        rotation: Angle between the placements of a joint (rad).
        axis: Angle between a joint's axes (rad).
        limit: Of a joint limit (rad).
        effort: Relative.
        velocity: Relative.
        damping: Relative.
        friction: Relative.
        gravity: Of the MJCF's gravity, to the 9.81 m/s^2 downwards that Pinocchio gives a URDF
            (m/s^2). The default passes 9.8 and 9.80665.
        dynamics: Of the quantities of the cross-check, relative to their scale.
    """

    mass: float = 1e-4
    com: float = 1e-5
    inertia: float = 1e-3
    position: float = 1e-5
    rotation: float = 1e-4
    axis: float = 1e-4
    limit: float = 1e-3
    effort: float = 1e-3
    velocity: float = 1e-3
    damping: float = 1e-3
    friction: float = 1e-3
    gravity: float = 0.02
    dynamics: float = 1e-3

    def __post_init__(self) -> None:
        check_fields(self)
        for kind in fields(self):
            value = getattr(self, kind.name)
            if not value > 0:
                message = diagnose("tolerance-not-positive", kind=kind.name, value=value)
                raise ConfigurationError("tolerance", message)

    @staticmethod
    def strict() -> Tolerances:
        """Returns tolerances that pass rounding errors of floating-point numbers alone."""
        return Tolerances(**{kind.name: 1e-9 for kind in fields(Tolerances)})

    @staticmethod
    def fine() -> Tolerances:
        """Returns the same, digit for digit, but for gravity, which a URDF does not state."""
        return replace(Tolerances.strict(), gravity=Tolerances().gravity)

    def changed(self, changes: Mapping[str, float]) -> Tolerances:
        """Returns these tolerances with some changed.

        Raises:
            ConfigurationError: If a kind is unknown (lists the valid ones) or not positive.
        """
        valid = [kind.name for kind in fields(self)]
        for kind in changes:
            if kind not in valid:
                message = diagnose("tolerance-unknown", kind=kind, known=valid)
                raise ConfigurationError("tolerance", message)
        return replace(self, **changes)
