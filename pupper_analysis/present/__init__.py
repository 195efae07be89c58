"""Documents of results, and their output on a terminal, as HTML, Markdown, PNG and for CI."""

from pupper_analysis.base.exports import make_lazy_exports

__getattr__, __dir__, __all__ = make_lazy_exports(__name__, __file__)
