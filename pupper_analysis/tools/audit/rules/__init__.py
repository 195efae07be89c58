"""The rules; importing this package registers them, in the order of the documentation."""

from pupper_analysis.tools.audit.rules import (  # noqa: F401, I001  (the order is that of the table)
    mass,
    engines,
    inertia,
    scale,
    shapes,
    mirror,
    joints,
    limits,
    legs,
    values,
    numbers,
    files,
    actuators,
    start,
    simulation,
    usd,
)
