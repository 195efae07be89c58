"""Build the site in English, and in Chinese in its folder ``zh``. A warning is an error.

    python docs/build.py build/docs

Each build reads and writes all pages, and a former site in the folder is deleted: Sphinx does not
know all files on which a page depends, such as ``pages.py`` and the code of the package. Links
within the site are checked during the build; ``--links`` also checks links to other sites.
``check_names.py`` then checks the printed names of the package in a new process.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from sphinx.cmd.build import main

DOCS = Path(__file__).resolve().parent
"""Folder of this file."""


def build(folder: Path, *, links: bool = False) -> int:
    """Write the site, and return the exit status: 0 without a warning and a private name.

    Args:
        folder: Output folder, for ``index.html`` and ``zh/index.html``.
        links: Whether to check all addresses outside the site.
    """
    strict = ["--fail-on-warning", "--keep-going", "--quiet", "--jobs", "2"]
    if (folder / ".buildinfo").exists():  # Sphinx has written the folder
        shutil.rmtree(folder)
    status = 0
    for site, target in ((DOCS, folder), (DOCS / "zh", folder / "zh")):
        with TemporaryDirectory() as cache:
            trees = ["-d", cache]
            status |= main([*strict, "-b", "html", *trees, str(site), str(target)])
            if links:
                found = str(Path(cache) / "links")
                status |= main([*strict, "-b", "linkcheck", *trees, str(site), found])
    check = [sys.executable, str(DOCS / "check_names.py"), str(folder)]
    status |= subprocess.run(check, check=False).returncode
    return status


if __name__ == "__main__":
    targets = [argument for argument in sys.argv[1:] if argument != "--links"]
    sys.exit(build(Path(targets[0]), links="--links" in sys.argv))
