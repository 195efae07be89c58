"""Make a URDF and an MJCF agree.

Numbers of a file are written into the other file, in place.
"""

from pupper_analysis.base.exports import make_lazy_exports

HELP_HEADING = "Files"
"""Section of ``--help`` that lists this tool."""

__getattr__, __dir__, __all__ = make_lazy_exports(__name__, __file__)
