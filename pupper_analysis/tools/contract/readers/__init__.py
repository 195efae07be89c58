"""Readers of source formats: modules of this folder with ``FILE_SUFFIXES`` and ``read``."""

from pupper_analysis.base.exports import make_lazy_exports

__getattr__, __dir__, __all__ = make_lazy_exports(__name__, __file__)
