"""Measure what a robot really weighs.

Fit: what the robot in front of one really weighs, and what measurements cannot tell.
"""

from pupper_analysis.base.exports import exports_of

HEADING = "Real robot"

__getattr__, __dir__, __all__ = exports_of(__name__, __file__)
