"""Audit rules by topic. Importing this package registers all checks."""

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
