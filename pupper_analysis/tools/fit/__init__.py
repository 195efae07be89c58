"""Estimate masses, offsets and gains of a real robot.

`fit` estimates parameters of a robot, with intervals, from stands at rest or from logs of motions,
and reports the parameters that the measurements do not determine. The package also plans stands,
and records stands and policies on a robot.
"""

from pupper_analysis.base.exports import make_lazy_exports

HELP_HEADING = "Real robot"
"""Section of ``--help`` that lists this tool."""

__getattr__, __dir__, __all__ = make_lazy_exports(__name__, __file__)
