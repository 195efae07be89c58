"""What a robot really weighs, by measurements.

Fit: what the robot in front of one really weighs, and what measurements cannot tell.
"""

from pupper_analysis.base.exports import exports_of

__getattr__, __dir__, __all__ = exports_of(__name__, __file__)
