"""Shared fixtures, the selection of the quick tests, and the report of skipped tests."""

from __future__ import annotations

import gc
import os
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import tests.support.one_blas_thread  # noqa: F401 - takes effect before NumPy is imported

# isort: split
import hypothesis
import mujoco
import pytest
from hypothesis.internal.conjecture import providers

import pupper_analysis as pa
from tests.support.repository import ROOT
from tests.support.shared_rollouts import share_rollouts
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

# Hypothesis mixes constants of all imported modules of this repository into its draws. The examples
# of a test would then depend on the tests that ran before it in the same process, and a failure
# could not be reproduced by running the test alone.
providers._get_local_constants = lambda: providers._local_constants


os.environ.pop("PUPPER_ANALYSIS_LANGUAGE", None)  # tests expect English answers

NO_SKIPS = os.environ.get("CI") == "true" and sys.platform == "linux"
"""Whether a skipped test counts as failed: CI on Linux has everything that the tests need."""


def pytest_configure(config: pytest.Config) -> None:
    """Select the quick tests if the command line names no file, mark or keyword."""
    named = config.args_source is pytest.Config.ArgsSource.ARGS
    if not (named or config.option.markexpr or config.option.keyword):
        config.option.markexpr = "not slow"


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[Any]:
    """Collect tests without garbage collection, and exclude modules and tests from later ones.

    Collection takes 7 s instead of 12 s of processor, at its end included.
    """
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()
        gc.freeze()


LONG_FILE = ROOT / "tests" / "repository" / "test_pages.py"
"""File with the longest tests, up to 30 s of processor. They run first, in one worker.

At the end of a run, one worker is idle while the other completes its last two tests. Besides, all
pages then share the rollouts and variants of one process."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the tests of ``LONG_FILE`` first; the order of the other tests does not change."""
    items.sort(key=lambda item: item.path != LONG_FILE)


def pytest_report_header(config: pytest.Config) -> str | None:
    """Return the line which reports that only the quick tests run."""
    if config.option.markexpr == "not slow":
        return "quick tests only (-m 'not slow'); make test-all runs all tests"
    return None


def skip_reason(report: pytest.TestReport | pytest.CollectReport) -> str:
    """Return the reason of a skipped test or module on one line."""
    message = report.longrepr[2] if isinstance(report.longrepr, tuple) else report.longrepr
    return " ".join(str(message).removeprefix("Skipped: ").split())


def fail_skipped(report: pytest.TestReport | pytest.CollectReport) -> None:
    """Change the outcome of a skipped test or module to failed if CI runs the tests."""
    if NO_SKIPS and report.skipped and not hasattr(report, "wasxfail"):
        report.longrepr = f"skipped in CI: {skip_reason(report)}; see make setup-ci"
        report.outcome = "failed"


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Iterator[Any]:
    report = yield
    fail_skipped(report)
    return report


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report(collector: pytest.Collector) -> Iterator[Any]:
    report = yield
    fail_skipped(report)
    return report


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """Print the number of skipped tests per reason, and the command that prevents skips."""
    reasons = Counter(map(skip_reason, terminalreporter.stats.get("skipped", [])))
    for reason, count in sorted(reasons.items()):
        terminalreporter.write_line(f"{count} skipped: {reason}", yellow=True)
    if reasons:
        terminalreporter.write_line("make setup-ci installs what these tests need", yellow=True)


@pytest.fixture(scope="session", autouse=True)
def mujoco_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Redirect MuJoCo's log of warnings from the checkout to a temporary folder; return the file.

    Tests that run MuJoCo by themselves as a reference cause such warnings.
    """
    log = tmp_path_factory.mktemp("mujoco") / "MUJOCO_LOG.TXT"
    config = mujoco.MjLogConfig.get()
    config.logfile = str(log)
    mujoco.MjLogConfig.set(config)
    return log


@pytest.fixture(scope="session", params=NAMES)
def variant(request: pytest.FixtureRequest) -> str:
    """Return the name of a variant; the tests run with each variant."""
    return str(request.param)


@pytest.fixture(scope="session")
def robot(variant: str) -> pa.Robot:
    """Robot of each variant in turn."""
    return load(variant)


@pytest.fixture(scope="session")
def stand(variant: str) -> pa.Stand:
    """Nominal stand of each variant in turn."""
    return stand_of(variant)


@pytest.fixture(scope="session")
def tiny_files(tmp_path_factory: pytest.TempPathFactory) -> Files:
    """Files of a robot with a continuous and a sliding joint, which list the joints in different
    orders.
    """
    folder = tmp_path_factory.mktemp("tiny")
    files = Files(folder / "tiny.urdf", folder / "tiny.xml")
    files.urdf.write_text(TINY_URDF)
    files.mjcf.write_text(TINY_MJCF)
    return files


@pytest.fixture(scope="session")
def tiny(tiny_files: Files) -> pa.Robot:
    """Robot of ``tiny_files``."""
    return pa.load_robot(urdf=tiny_files.urdf, mjcf=tiny_files.mjcf, feet=["foot"], as_is=True)


@pytest.fixture
def shared_rollouts() -> Iterator[None]:
    """Simulate rollouts with equal arguments once per process, among the tests with this fixture.

    For tests that compare several results about the same robot. A test that asserts that a
    repeated computation returns the same numbers must not use it.
    """
    with share_rollouts():
        yield
