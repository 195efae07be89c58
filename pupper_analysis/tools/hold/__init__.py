"""Compute what an arm's motors hold.

Statics, simulation, payload and force limits of postures of robots with a fixed base.
"""

from pupper_analysis.base.exports import make_lazy_exports

HELP_HEADING = "Stance"
"""Section of ``--help`` that lists this tool."""

__getattr__, __dir__, __all__ = make_lazy_exports(__name__, __file__)
