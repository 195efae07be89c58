"""The lowest versions in the tests equal the lower bounds of pyproject.toml."""

from __future__ import annotations

import runpy
from collections.abc import Callable
from importlib.metadata import version

import pytest

from tests.support.repository import ROOT

PROJECT = (ROOT / "pyproject.toml").read_text()
lowest: Callable[[str], dict[str, str]] = runpy.run_path(
    str(ROOT / "scripts" / "lowest_versions.py")
)["lowest_versions"]


def numbers(text: str) -> list[int]:
    return [int(part) for part in text.split(".") if part.isdigit()]


def test_each_requirement_has_a_lowest_version_below_the_installed_one() -> None:
    found = lowest(PROJECT)
    assert {"mujoco", "pin", "placo", "numpy", "pytest"} <= set(found)
    for name, bound in found.items():
        assert f'"{name}>={bound}' in PROJECT
        assert numbers(version(name)) >= numbers(bound), name


@pytest.mark.parametrize("requirement", ["numpy", "numpy==2.3", "numpy<3"])
def test_requirement_without_a_lowest_version_is_refused(requirement: str) -> None:
    text = f"""
    [project]
    dependencies = ["{requirement}"]
    [dependency-groups]
    test = []
    """
    with pytest.raises(ValueError, match="no lower bound"):
        lowest(text)
