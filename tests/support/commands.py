"""Run commands in this process."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import pytest

from pupper_analysis import cli


def run_command(capfd: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    """Run ``pupper-analysis`` in this process, which saves the start-up time.

    Returns:
        Exit status, standard output and standard error, including the output of C++ libraries.
    """
    with pytest.raises(SystemExit) as leaving:
        cli.run(cli.group, list(arguments))
    out, err = capfd.readouterr()
    return int(leaving.value.code or 0), out, err


def check_refusal(
    capfd: pytest.CaptureFixture[str], folder: Path, arguments: Sequence[str], message: str
) -> None:
    """Check that a command with bad input prints one error, exits with 2, and writes no file.

    The error has one line. The next command may follow in a second line.
    """
    here = folder / "empty"
    here.mkdir(exist_ok=True)
    with contextlib.chdir(here):
        status, out, err = run_command(capfd, *arguments)
    assert status == 2
    assert message in err
    assert err.startswith("error: ")
    _, *more = err.strip().splitlines()
    assert all(line.startswith("  next: pupper-analysis ") for line in more[:1])
    assert len(more) <= 1
    assert out == ""
    assert list(here.iterdir()) == []


class Answer(NamedTuple):
    """Exit status and output of a command, without the output of C++ libraries."""

    returncode: int
    stdout: str
    stderr: str


def answer(*arguments: str, folder: Path | None = None) -> Answer:
    """Run a command in this process, in a folder, and return its exit status and output."""
    out, err = io.StringIO(), io.StringIO()
    with (
        contextlib.chdir(folder or "."),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
        pytest.raises(SystemExit) as leaving,
    ):
        cli.run(cli.group, list(arguments))
    return Answer(int(leaving.value.code or 0), out.getvalue(), err.getvalue())
