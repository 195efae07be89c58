"""Measure thousands of designs.

Variables of the robot and stance are varied, and metrics are evaluated for each design. Results are
stored, so that an interrupted run can be continued.
"""

from pupper_analysis.base.exports import make_lazy_exports

HELP_HEADING = "Design"
"""Section of ``--help`` that lists this tool."""

__getattr__, __dir__, __all__ = make_lazy_exports(__name__, __file__)
