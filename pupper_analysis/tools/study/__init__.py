"""Measure thousands of designs.

Many designs: which numbers vary, what is measured, and the engine that loses nothing.
"""

from pupper_analysis.base.exports import exports_of

HEADING = "Design"

__getattr__, __dir__, __all__ = exports_of(__name__, __file__)
