"""Measure what a robot really weighs.

Fit: what the robot in front of one really weighs, and what measurements cannot tell.
"""

from pupper_analysis.base.exports import make_lazy_exports

HEADING = "Real robot"

__getattr__, __dir__, __all__ = make_lazy_exports(__name__, __file__)
