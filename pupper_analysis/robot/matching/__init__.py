"""Matching of a URDF and an MJCF of the same robot: joints, bodies, frames and conventions."""

from pupper_analysis.base.exports import make_lazy_exports

__getattr__, __dir__, __all__ = make_lazy_exports(__name__, __file__)
