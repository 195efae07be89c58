"""Documents of results, and their output on a terminal, as HTML, Markdown, PNG and for CI services.

Documents are built from finished results. Two modules compute more: ``stand_plots`` computes the
contact forces of a stand that is drawn, and MuJoCo's viewer (``display``) simulates.
"""

from pupper_analysis.base.exports import make_lazy_exports

__getattr__, __dir__, __all__ = make_lazy_exports(__name__, __file__)
