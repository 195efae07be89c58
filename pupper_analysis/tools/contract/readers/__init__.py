"""Readers of source formats. A module in this folder with ``SUFFIXES`` and ``read`` is a reader."""

from pupper_analysis.base.exports import make_lazy_exports

__getattr__, __dir__, __all__ = make_lazy_exports(__name__, __file__)
