"""Two files, one robot: whose joint, body and frame is whose, in which conventions."""

from pupper_analysis.base.exports import exports_of

__getattr__, __dir__, __all__ = exports_of(__name__, __file__)
