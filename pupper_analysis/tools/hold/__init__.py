"""Compute what an arm's motors hold.

Robots whose base is held: postures, what motors hold in them, and in the worst of all.
"""

from pupper_analysis.base.exports import make_lazy_exports

HEADING = "Stance"

__getattr__, __dir__, __all__ = make_lazy_exports(__name__, __file__)
