"""Matching of a URDF and an MJCF of one robot: joints, bodies, frames and conventions."""

from pupper_analysis.base.exports import exports_of

__getattr__, __dir__, __all__ = exports_of(__name__, __file__)
