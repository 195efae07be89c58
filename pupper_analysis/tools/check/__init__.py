"""Check all models of a repository, as in CI.

Compares and audits the models listed in a configuration; findings in a baseline are accepted.
"""

from pupper_analysis.base.exports import make_lazy_exports

HELP_HEADING = "Files"
"""Section of ``--help`` that lists this tool."""

__getattr__, __dir__, __all__ = make_lazy_exports(__name__, __file__)
