"""Writes what checking models needs, without what only stands need: a list, and what it locks.

pip knows extras that add, and none that take away: ``pip install pupper-analysis`` is all, so that
stands work. Where checking is all that is wanted, as in CI, this list is installed instead, and the
package with ``--no-deps``. The GitHub Action runs in repositories of others, on a machine that
holds their secrets: it installs the locked list, in which every package's files have hashes.

    python scripts/check_requirements.py
"""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from importlib.metadata import requires, version
from pathlib import Path

ROOT = Path(__file__).parents[1]
FILE = ROOT / "requirements-check.txt"
LOCK = ROOT / "requirements-check.lock"

NOT_NEEDED = ("placo", "matplotlib", "clarabel")
"""Of the dependencies: by `check`, `crosscheck`, `audit`, `sync` and `diff`; a test blocks them."""

HEADER = f"""\
# What `check`, `crosscheck`, `audit`, `sync` and `diff` need: the dependencies of pyproject.toml
# without {", ".join(NOT_NEEDED)}. Then: pip install --no-deps pupper-analysis
# Written by scripts/check_requirements.py.
"""

PINS = """\
# The versions that placo {} pins, without which pip finds a Pinocchio and a urdfdom that do not
# load together:
"""


def name_of(requirement: str) -> str:
    """Returns the name of the package."""
    found = re.match(r"[A-Za-z0-9._-]+", requirement)
    assert found is not None, requirement
    return found[0].lower()


def requirements() -> str:
    """Returns the file's content."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    needed = {name_of(line): line for line in project["dependencies"]}
    for name in NOT_NEEDED:
        del needed[name]
    # Pins of placo alone: what it depends on without one is its own, not Pinocchio's.
    pinned = [line for line in requires("placo") or () if "==" in line and ";" not in line]
    for line in pinned:
        needed.pop(name_of(line), None)
    lines = (HEADER, *needed.values(), PINS.format(version("placo")).rstrip(), *pinned)
    return "\n".join(line.rstrip() for line in lines) + "\n"


def locked() -> str:
    """Returns the versions of all that is needed, and to build the package, for any machine."""
    building = tomllib.loads((ROOT / "pyproject.toml").read_text())["build-system"]["requires"]
    command = [
        *(sys.executable, "-m", "uv", "pip", "compile", "--quiet", "-"),
        *("--universal", "--generate-hashes", "--no-header", "--no-annotate"),
        *("--python-version", "3.11", "--no-emit-index-url", "--no-emit-find-links"),
    ]
    asked = "\n".join([requirements(), *building])
    made = subprocess.run(command, input=asked, capture_output=True, text=True, check=True)
    return (
        f"# Written by scripts/check_requirements.py; pip install --require-hashes.\n{made.stdout}"
    )


if __name__ == "__main__":
    FILE.write_text(requirements())
    LOCK.write_text(locked())
    print(f"{FILE.name} and {LOCK.name} are written")
