"""Solve stands: configurations of a robot on planted feet, by inverse kinematics."""

from pupper_analysis.base.exports import make_lazy_exports

__getattr__, __dir__, __all__ = make_lazy_exports(__name__, __file__)
