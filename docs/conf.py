"""Configuration of the English site; ``docs/zh`` contains that of the Chinese site."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

from sphinx.domains.python import PyAttribute, PyProperty, PyVariable

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

import pages  # noqa: E402

import pupper_analysis as pa  # noqa: E402

project = "pupper_analysis"
author = "the pupper_analysis maintainers"
copyright = author
release = version = pa.__version__
language = "en"

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
]
exclude_patterns = ["zh"]
templates_path = ["_templates"]
smartquotes = False  # they would turn --base into a dash and base
nitpicky = False  # of the types in signatures most are other packages'

myst_enable_extensions = ["colon_fence"]
myst_heading_anchors = 4
suppress_warnings = ["myst.header"]  # a page may begin below the first level: generated tables do

autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True
autodoc_type_aliases = {"ArrayLike": "ArrayLike", "NDArray": "NDArray"}
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 88
napoleon_numpy_docstring = False
napoleon_use_ivar = True

html_theme = "furo"
html_title = f"pupper_analysis {release}"
html_static_path = [str(HERE / "_static")]
html_css_files = ["site.css"]
html_copy_source = False
html_show_sphinx = False
html_sidebars = {
    "**": [
        "sidebar/brand.html",
        "language.html",
        "sidebar/search.html",
        "sidebar/scroll-start.html",
        "sidebar/navigation.html",
        "sidebar/scroll-end.html",
    ]
}
html_context = {"other_language": ("中文", "zh/index.html")}
copybutton_prompt_text = "$ "


def shorten_member_types(app: Any) -> None:
    """Shorten the types of attributes, properties and data, for which autodoc has no event."""
    for name, directive in (
        ("attribute", PyAttribute),
        ("property", PyProperty),
        ("data", PyVariable),
    ):

        class WithShortType(directive):  # type: ignore[misc, valid-type]
            """The directive with a shortened type."""

            def handle_signature(self, sig: str, signode: Any) -> tuple[str, str]:
                """Shorten the type, and parse the signature."""
                if "type" in self.options:
                    self.options["type"] = pages.shorten_types(self.options["type"])
                return super().handle_signature(sig, signode)  # type: ignore[no-any-return]

        app.add_directive_to_domain("py", name, WithShortType, override=True)


def setup(app: Any) -> None:
    """Write the generated pages, and register the conversion of docstrings and signatures."""
    words = "zh" if app.config.language.startswith("zh") else "en"
    pages.write_pages(Path(str(app.srcdir)), words)
    shorten_member_types(app)
    app.connect("autodoc-process-docstring", pages.escape_docstring)
    app.connect("autodoc-process-signature", pages.shorten_signature)


os.environ.setdefault("PYTHONHASHSEED", "0")
