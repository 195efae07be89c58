"""The rules; importing this package registers them."""

from pupper_analysis.tools.audit.rules import (  # noqa: F401
    actuators,
    files,
    joints,
    mass,
    mirror,
    shapes,
    simulation,
    start,
    values,
)
