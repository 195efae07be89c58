"""Scripts of continuous integration."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.repository import ROOT


def run_uv_settings(config: Path, **settings: str) -> subprocess.CompletedProcess[str]:
    """Run `.ci/uv-settings` with pip's settings of a file, and of variables."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PIP_")}
    environment |= {"PIP_CONFIG_FILE": str(config)} | settings
    return subprocess.run(
        [sys.executable, str(ROOT / ".ci" / "uv-settings")],
        env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip


@pytest.mark.slow
def test_uv_gets_the_indexes_links_and_constraints_of_pip(tmp_path: Path) -> None:
    """Variables of pip take precedence over its file; several values become one list."""
    config = tmp_path / "pip.conf"
    config.write_text(
        "[global]\nextra-index-url = https://a.example/simple\n    file:///b/simple\n"
        "find-links = /from-file\n[install]\nconstraint = /c.txt\nno-index = false\n"
    )
    done = run_uv_settings(config, PIP_FIND_LINKS="/e /f")
    assert done.returncode == 0, done.stderr
    shell = subprocess.run(
        ["bash", "-c", f"{done.stdout}\nenv"], env={}, capture_output=True, text=True, check=True
    )
    exported = dict(line.partition("=")[::2] for line in shell.stdout.splitlines())
    assert exported["UV_INDEX"] == "https://a.example/simple file:///b/simple"
    assert exported["UV_CONSTRAINT"] == "/c.txt"
    assert exported["UV_FIND_LINKS"] == "/e,/f"
    assert exported["UV_INDEX_STRATEGY"] == "unsafe-best-match"


@pytest.mark.slow
def test_uv_is_not_used_if_pip_must_not_use_an_index(tmp_path: Path) -> None:
    config = tmp_path / "pip.conf"
    config.write_text("[global]\nno-index = true\n")
    done = run_uv_settings(config)
    assert done.returncode == 1
    assert done.stdout == ""
