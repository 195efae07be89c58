"""Compute what an arm's motors hold.

Robots whose base is held: postures, what motors hold in them, and in the worst of all.
"""

from pupper_analysis.base.exports import exports_of

HEADING = "Stance"

__getattr__, __dir__, __all__ = exports_of(__name__, __file__)
