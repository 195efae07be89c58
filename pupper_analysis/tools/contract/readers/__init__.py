"""Readers of sources, each a module with ``SUFFIXES`` and ``read``; found by their files."""

from pupper_analysis.base.exports import exports_of

__getattr__, __dir__, __all__ = exports_of(__name__, __file__)
