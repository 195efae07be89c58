"""Tolerances for the comparison of two files: one number per kind of value.

The defaults of `Tolerances` are for files with 5 to 6 digits. ``strict`` and ``fine`` accept only
rounding errors. ``with_values`` replaces single tolerances.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace

from pupper_analysis.base.arguments import check_fields
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError


@dataclass(frozen=True)
class Tolerances:
    """Largest accepted differences between two files of a robot, one number per kind of value.

    The defaults accept files written with 5 to 6 digits. Each tolerance is positive and finite.

    Attributes:
        mass: Mass, relative.
        com: Position of the CoM (m).
        inertia: Inertia tensor, relative to the largest element; also armature, relative.
        position: Position of a joint or frame (m).
        rotation: Angle between the placements of a joint (rad).
        axis: Angle between the axes of a joint (rad).
        limit: Joint limit (rad or m); also offset and multiplier of a joint coupling.
        effort: Effort limit, relative.
        velocity: Velocity limit, relative.
        damping: Damping, and stiffness and damping of servos, relative.
        friction: Friction loss, relative.
        gravity: Norm of the difference between gravity in the MJCF and 9.81 m/s^2 downwards
            (m/s^2). Pinocchio uses 9.81 for a URDF. The default accepts 9.8 and 9.80665.
        dynamics: Quantities of the cross-check, relative to the scale of each quantity.
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
            if not 0 < value < math.inf:
                message = diagnose("tolerance-not-positive", kind=kind.name, value=value)
                raise ConfigurationError("tolerance", message)

    @staticmethod
    def strict() -> Tolerances:
        """Return tolerances for rounding errors only: 1e-9 for each kind of value."""
        return Tolerances(**{kind.name: 1e-9 for kind in fields(Tolerances)})

    @staticmethod
    def fine() -> Tolerances:
        """Return tolerances for rounding errors (1e-9), but the default tolerance for gravity.

        Reason: a URDF does not specify gravity.
        """
        return replace(Tolerances.strict(), gravity=Tolerances().gravity)

    def with_values(self, changes: Mapping[str, float]) -> Tolerances:
        """Return a copy with changed tolerances.

        Args:
            changes: {kind (attribute of this class): tolerance in the unit of the attribute}.

        Raises:
            ConfigurationError: If a kind is unknown (the message lists the valid kinds), or a value
                is no positive finite number.
        """
        valid = [kind.name for kind in fields(self)]
        for kind in changes:
            if kind not in valid:
                message = diagnose("tolerance-unknown", kind=kind, known=valid)
                raise ConfigurationError("tolerance", message)
        return replace(self, **changes)
