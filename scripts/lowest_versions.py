"""Prints the lowest versions that pyproject.toml allows, as constraints for pip."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

PROJECT = Path(__file__).resolve().parents[1] / "pyproject.toml"


def lowest_versions(text: str) -> dict[str, str]:
    """Returns {package: lowest version} of what the project and its tests need.

    Args:
        text: A pyproject.toml.

    Raises:
        ValueError: If a requirement has no lower bound.
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
