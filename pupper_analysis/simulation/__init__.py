"""Does it hold, and what does it survive, in MuJoCo."""

from pupper_analysis.base.exports import exports_of

__getattr__, __dir__, __all__ = exports_of(__name__, __file__)
