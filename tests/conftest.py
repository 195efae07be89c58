"""Fixtures that all tests share, and which tests are run when."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import hypothesis
import pytest

import pupper_analysis as pa
from tests.support.durations import Limit, Recorder, mark, sample
from tests.support.ran import Ran, summary_lines
from tests.support.rooms import trees
from tests.support.tiny import TINY_MJCF, TINY_URDF, Files
from tests.support.variants import NAMES, load, stand_of

hypothesis.settings.register_profile(
    "suite",
    deadline=None,
    max_examples=20,
    derandomize=True,
    database=None,
    suppress_health_check=[hypothesis.HealthCheck.too_slow],
)


hypothesis.settings.load_profile("suite")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--record-durations", action="store_true", help="write tests/durations.json anew"
    )
    parser.addoption(
        "--ran", type=Path, metavar="FILE", help="add to a file what ran: tests/support/ran.py"
    )


def pytest_configure(config: pytest.Config) -> None:
    everything = config.args_source is not pytest.Config.ArgsSource.ARGS
    quick = everything and not (config.option.markexpr or config.option.keyword)
    if quick:
        config.option.markexpr = "not slow"  # who names files, words or marks gets what was named
    if config.getoption("--record-durations"):
        for name in NAMES:  # what is loaded once is no test's own
            stand_of(name)
        config.pluginmanager.register(Recorder())
    elif quick:
        config.pluginmanager.register(Limit())
    if file := config.getoption("--ran"):
        config.pluginmanager.register(Ran(file.resolve(), config, everything), "ran")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Marks what is slow, before any are chosen by their marks."""
    if config.getoption("--record-durations"):
        sample(items)
        return
    mark(items)
    if ran := config.pluginmanager.get_plugin("ran"):
        ran.collected(items)


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """Says what was skipped, and how to have it."""
    for line in summary_lines(terminalreporter.stats.get("skipped", [])):
        terminalreporter.write_line(line, yellow=True)


@pytest.fixture(scope="session")
def syntax() -> None:
    """Parses the whole package, which takes seconds: no test's own time."""
    trees()


@pytest.fixture(scope="session", params=NAMES)
def variant(request: pytest.FixtureRequest) -> str:
    """The name of each variant in turn."""
    return str(request.param)


@pytest.fixture(scope="session")
def robot(variant: str) -> pa.Robot:
    return load(variant)


@pytest.fixture(scope="session")
def stand(variant: str) -> pa.Stand:
    return stand_of(variant)


@pytest.fixture(scope="session")
def tiny_files(tmp_path_factory: pytest.TempPathFactory) -> Files:
    """A robot with a continuous and a sliding joint; each file has the joints in another order."""
    folder = tmp_path_factory.mktemp("tiny")
    files = Files(folder / "tiny.urdf", folder / "tiny.xml")
    files.urdf.write_text(TINY_URDF)
    files.mjcf.write_text(TINY_MJCF)
    return files


@pytest.fixture(scope="session")
def tiny(tiny_files: Files) -> pa.Robot:
    return pa.load_robot(urdf=tiny_files.urdf, mjcf=tiny_files.mjcf, feet=["foot"], as_is=True)
