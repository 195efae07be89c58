"""Check all models of a repository, as in CI.

Keeps the models of a repository right: what is checked, and what is known already.
"""

from pupper_analysis.base.exports import exports_of

HEADING = "Files"

__getattr__, __dir__, __all__ = exports_of(__name__, __file__)
