"""Convert a URDF to an MJCF, or back."""

from pupper_analysis.base.exports import exports_of

HEADING = "Files"

__getattr__, __dir__, __all__ = exports_of(__name__, __file__)
