"""Measure thousands of designs.

Variables of the robot and stance are varied, metrics are evaluated for each design, and results are
stored so that an interrupted run resumes.
"""

from pupper_analysis.base.exports import make_lazy_exports

HELP_HEADING = "Design"
"""Section of ``--help`` that lists this tool."""

__getattr__, __dir__, __all__ = make_lazy_exports(__name__, __file__)
