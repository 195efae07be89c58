"""Write the requirements of the commands that check models, as a list and as a lock file.

Extras of a package can only add dependencies, and ``pip install pupper-analysis`` also installs the
dependencies that only stands need. To check models only, as in CI, this list is installed, and then
the package with ``--no-deps``. The GitHub Action runs in other repositories, on a machine with
their secrets, so it installs the lock file, which contains a hash of each file.

    python scripts/check_requirements.py
"""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from importlib.metadata import requires, version
from pathlib import Path

PROJECT_FOLDER = Path(__file__).parents[1]
"""Root folder of this project."""

FILE = PROJECT_FOLDER / ".github/requirements/check.txt"
"""Path of the list of the requirements."""

LOCK = PROJECT_FOLDER / ".github/requirements/check.lock"
"""Path of the lock file of the requirements."""

NOT_NEEDED = ("placo", "matplotlib", "clarabel")
"""Dependencies that `check`, `crosscheck`, `audit`, `sync` and `diff` do not need; a test blocks
them."""

HEADER = f"""\
# What `check`, `crosscheck`, `audit`, `sync` and `diff` need: the dependencies of pyproject.toml
# without {", ".join(NOT_NEEDED)}. Then: pip install --no-deps pupper-analysis
# Written by scripts/check_requirements.py.
"""
"""First lines of the list."""

PINS = """\
# The versions that placo {} pins, without which pip finds a Pinocchio and a urdfdom that do not
# load together:
"""
"""Comment in the list above the pinned versions."""


def requirement_name(requirement: str) -> str:
    """Return the name of the package of a requirement, in lower case."""
    found = re.match(r"[A-Za-z0-9._-]+", requirement)
    assert found is not None, requirement
    return found[0].lower()


def make_requirements() -> str:
    """Return the content of the list of requirements (`FILE`)."""
    project = tomllib.loads((PROJECT_FOLDER / "pyproject.toml").read_text())["project"]
    needed = {requirement_name(line): line for line in project["dependencies"]}
    for name in NOT_NEEDED:
        del needed[name]
    # Of placo's dependencies only the pinned ones, which Pinocchio shares.
    pinned = [line for line in requires("placo") or () if "==" in line and ";" not in line]
    for line in pinned:
        needed.pop(requirement_name(line), None)
    lines = (HEADER, *needed.values(), PINS.format(version("placo")).rstrip(), *pinned)
    return "\n".join(line.rstrip() for line in lines) + "\n"


def make_lock() -> str:
    """Return the content of the lock file: versions for use and for building, for any machine."""
    building = tomllib.loads((PROJECT_FOLDER / "pyproject.toml").read_text())["build-system"][
        "requires"
    ]
    command = [
        *(sys.executable, "-m", "uv", "pip", "compile", "--quiet", "-"),
        *("--universal", "--generate-hashes", "--no-header", "--no-annotate"),
        *("--python-version", "3.11", "--no-emit-index-url", "--no-emit-find-links"),
    ]
    asked = "\n".join([make_requirements(), *building])
    made = subprocess.run(command, input=asked, capture_output=True, text=True, check=True)
    return (
        f"# Written by scripts/check_requirements.py; pip install --require-hashes.\n{made.stdout}"
    )


if __name__ == "__main__":
    FILE.write_text(make_requirements())
    LOCK.write_text(make_lock())
    print(f"{FILE.name} and {LOCK.name} are written")
