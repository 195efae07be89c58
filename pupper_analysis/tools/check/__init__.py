"""Check all models of a repository, as in CI.

Keeps the models of a repository right: what is checked, and what is known already.
"""

from pupper_analysis.base.exports import make_lazy_exports

HEADING = "Files"

__getattr__, __dir__, __all__ = make_lazy_exports(__name__, __file__)
