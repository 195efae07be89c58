"""Print the lowest versions that pyproject.toml permits, as constraints for pip."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

PROJECT = Path(__file__).resolve().parents[1] / "pyproject.toml"
"""Path of pyproject.toml."""


def lowest_versions(text: str) -> dict[str, str]:
    """Return {package: lowest version} of the dependencies of the package and its tests.

    Args:
        text: Text of pyproject.toml.

    Raises:
        ValueError: If a requirement has no lower bound, or another form, such as extras.
    """
    content = tomllib.loads(text)
    versions = {}
    for requirement in content["project"]["dependencies"] + content["dependency-groups"]["test"]:
        bound = re.fullmatch(r"([\w-]+)\s*>=\s*([\w.]+)\s*(,.*)?", requirement)
        if bound is None:
            raise ValueError(f"{requirement!r} has no lower bound")
        versions[bound[1]] = bound[2]
    return versions


if __name__ == "__main__":
    for name, version in lowest_versions(PROJECT.read_text()).items():
        print(f"{name}=={version}")
