"""Measure thousands of designs.

Many designs: which numbers vary, what is measured, and the engine that loses nothing.
"""

from pupper_analysis.base.exports import make_lazy_exports

HEADING = "Design"

__getattr__, __dir__, __all__ = make_lazy_exports(__name__, __file__)
