"""Says whether a tag may be released: it is the version that package, citation and changelog have.

python scripts/check_release.py v0.2.0
"""

from __future__ import annotations

import re
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def stated(root: Path = ROOT) -> dict[str, str]:
    """Returns {file: the version that it states}; of the changelog, its newest release."""
    text = {
        name: (root / name).read_text(encoding="utf-8")
        for name in (
            "pyproject.toml",
            "pupper_analysis/__init__.py",
            "CITATION.cff",
            "CHANGELOG.md",
        )
    }
    patterns = {
        "pupper_analysis/__init__.py": r'^__version__ = "(.+)"$',
        "CITATION.cff": r"^version: (.+)$",
        "CHANGELOG.md": r"^## \[(\d+\.\d+\.\d+)\] - \d{4}-\d\d-\d\d$",
    }
    versions = {"pyproject.toml": str(tomllib.loads(text["pyproject.toml"])["project"]["version"])}
    for name, pattern in patterns.items():
        found = re.search(pattern, text[name], re.MULTILINE)
        versions[name] = found[1] if found else "none"
    return versions


def main(tag: str, root: Path = ROOT) -> None:
    """Ends with status 1, and what differs, unless all files state the tag's version."""
    other = {name: version for name, version in stated(root).items() if f"v{version}" != tag}
    if other:
        told = ", ".join(f"{name} has {version}" for name, version in other.items())
        raise SystemExit(f"{tag}: {told}")
    print(f"{tag} may be released")


if __name__ == "__main__":
    main(sys.argv[1])
