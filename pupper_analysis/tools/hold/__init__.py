"""Compute torques, payload and forces of a fixed-base robot."""

from pupper_analysis.base.exports import make_lazy_exports

HELP_HEADING = "Stance"
"""Section of ``--help`` that lists this tool."""

__getattr__, __dir__, __all__ = make_lazy_exports(__name__, __file__)
