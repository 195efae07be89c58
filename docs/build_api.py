"""Builds the API reference from the docstrings: a static site. A warning is an error.

    python docs/build_api.py build/docs

What ``pupper_analysis`` names is imported when it is first used; here all of it is imported, for
the first page to show it.
"""

from __future__ import annotations

import pkgutil
import sys
import warnings
from pathlib import Path

import pdoc
import pdoc.render

import pupper_analysis as pa


def build(folder: Path) -> None:
    """Writes the site.

    Args:
        folder: Gets ``index.html``, and a page for each module.
    """
    for name in pa.__all__:
        setattr(pa, name, getattr(pa, name))
    # pdoc walks a package by its __all__, where it has one: ours names no modules.
    parts = [f"{pa.__name__}.{part.name}" for part in pkgutil.iter_modules(pa.__path__)]
    pdoc.render.configure(docformat="google", show_source=False)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        pdoc.pdoc(pa.__name__, *parts, output_directory=folder)
    first = (folder / f"{pa.__name__}.html").read_text(encoding="utf-8")
    missing = [name for name in pa.__all__ if f'id="{name}"' not in first]
    if missing:
        raise SystemExit(f"not on the first page: {', '.join(missing)}")


if __name__ == "__main__":
    build(Path(sys.argv[1]))
