"""The rules; importing this package registers them."""

from pupper_analysis.tools.audit.rules import (  # noqa: F401
    actuators,
    files,
    joints,
    legs,
    mass,
    mirror,
    shapes,
    simulation,
    start,
    values,
)
