"""The command line as a process: failing output, signals, and unexpected errors."""

from __future__ import annotations

import contextlib
import errno
import io
import json
import os
import shutil
import signal
import subprocess
import sys
import textwrap
from collections.abc import Iterator
from pathlib import Path

import click
import pytest

from pupper_analysis import cli
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.cli.process import ProcessEnded
from tests.support.patience import PATIENCE
from tests.support.repository import ROOT

ENVIRONMENT = {**os.environ, "PYTHONPATH": str(ROOT)}
COMMAND = (sys.executable, "-m", "pupper_analysis")


@pytest.fixture(autouse=True)
def use_python_interrupt_handler() -> Iterator[None]:
    """Handle SIGINT by Python's own handler, however the tests were started."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def start(*command: str, **options: object) -> subprocess.Popen[str]:
    return subprocess.Popen(  # type: ignore[call-overload, no-any-return]
        command,
        **{
            "stdout": subprocess.PIPE,
            "stderr": subprocess.PIPE,
            "env": ENVIRONMENT,
            "text": True,
            # A parent in the background of a shell ignores SIGINT, and its children would, too.
            "preexec_fn": lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
            **options,
        },
    )


def status_of(command: click.Command, arguments: list[str]) -> object:
    """Return the exit status of a command in this process."""
    with pytest.raises(SystemExit) as leaving:
        cli.run(command, arguments)
    return leaving.value.code


class Full(io.RawIOBase):
    """A stream on a full disk."""

    def __init__(self, number: int) -> None:
        super().__init__()
        self.number = number

    def writable(self) -> bool:
        return True

    def write(self, data: object) -> int:
        raise OSError(self.number, os.strerror(self.number))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("number", "status"), [(errno.ENOSPC, 2), (errno.EIO, 2), (errno.EPIPE, 0)]
)
def test_results_are_written_if_standard_output_fails(
    number: int,
    status: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    full = io.TextIOWrapper(io.BufferedWriter(Full(number), buffer_size=16))  # type: ignore[type-var]
    monkeypatch.setattr(sys, "stdout", full)
    assert status_of(cli.group, ["workspace", "v3", "--json", str(tmp_path / "out.json")]) == status
    assert json.loads((tmp_path / "out.json").read_text())
    said = capsys.readouterr().err
    problem = f"error: cannot write standard output: {os.strerror(number)}\n"
    assert said == ("" if status == 0 else problem)
    monkeypatch.undo()


@pytest.mark.slow
def test_results_are_written_if_the_reader_of_standard_output_closes(tmp_path: Path) -> None:
    process = start(
        *COMMAND, "workspace", "v3", "--json", "out.json", "--report", "out.html", cwd=tmp_path
    )
    assert process.stdout is not None
    process.stdout.close()
    assert process.stderr is not None
    with process.stderr:
        assert process.stderr.read() == ""
    assert process.wait(60) == 0
    assert json.loads((tmp_path / "out.json").read_text())
    assert "<html" in (tmp_path / "out.html").read_text()


@pytest.mark.slow
def test_closed_output_streams_are_no_error(tmp_path: Path) -> None:
    code = "import os, sys; os.close(1); os.close(2); os.execv(sys.executable, sys.argv[1:])"
    command = (sys.executable, "-c", code, *COMMAND, "workspace", "v3", "--json", "out.json")
    process = start(*command, cwd=tmp_path)
    assert process.communicate(timeout=PATIENCE) == ("", "")
    assert process.returncode == 0
    assert json.loads((tmp_path / "out.json").read_text())


@pytest.mark.slow
@pytest.mark.parametrize("encoding", ["ascii", "latin-1", "cp1252"])
def test_output_is_written_in_each_terminal_encoding(encoding: str, tmp_path: Path) -> None:
    """A character that the encoding lacks is printed as an escape."""
    environment = {**ENVIRONMENT, "PYTHONIOENCODING": encoding}
    file = shutil.copy(ROOT / "urdf/pupper_skeleton.urdf", tmp_path / "狗.urdf")
    process = start(*COMMAND, "audit", file, env=environment, encoding=encoding)
    out, err = process.communicate(timeout=PATIENCE)
    assert (process.returncode, err) == (0, "")
    assert "\\u72d7.urdf" in out


def test_a_result_for_a_closed_standard_output_is_refused(tmp_path: Path) -> None:
    """The result would be lost; and no file may get the descriptor of the closed stream, with
    the printed text."""
    script = """
        import os, sys
        from pupper_analysis import cli
        from pupper_analysis.cli.process import tolerate_output_errors
        with tolerate_output_errors():
            file = os.open(sys.argv[1], os.O_RDWR | os.O_CREAT)
            assert file > 2, file
        cli.run(cli.group, ["stand", "original", "--json", "-"])
    """
    words = [sys.executable, "-c", textwrap.dedent(script), str(tmp_path / "file")]
    result = subprocess.run(
        ["sh", "-c", 'exec "$@" >&-', "sh", *words],
        stderr=subprocess.PIPE, text=True, env=ENVIRONMENT, check=False,
    )  # fmt: skip
    assert result.returncode == cli.EXIT_BAD_INPUT, result.stderr
    assert result.stderr == (
        "error: cannot write -: standard output is closed; give the name of a file\n"
    )


# ------------------------------------------------------------------------------------- signals


@pytest.mark.slow
@pytest.mark.parametrize("module", ["click", "rich.console", "pupper_analysis.tools.stand.command"])
def test_interrupt_during_import_prints_one_line(module: str) -> None:
    """A signal at a known moment of the start: while a module is imported."""
    code = f"""
        import os, signal, sys
        class At:
            def find_spec(self, name, path=None, target=None):
                if name == {module!r}:
                    os.kill(os.getpid(), signal.SIGINT)
        sys.meta_path.insert(0, At())
        sys.argv = ["pupper-analysis", "stand", "v3"]
        from pupper_analysis.__main__ import main
        main()
    """
    process = start(sys.executable, "-c", textwrap.dedent(code))
    out, err = process.communicate(timeout=PATIENCE)
    assert (process.returncode, out) == (130, "")
    assert err == "interrupted\n"


@pytest.mark.parametrize("made_of_it", [None, ImportError, SystemError, SystemExit])
def test_exit_status_is_that_of_a_signal_if_a_library_swallows_it(
    made_of_it: type[BaseException] | None, capsys: pytest.CaptureFixture[str]
) -> None:
    """Libraries turn KeyboardInterrupt into other exceptions, or into none."""

    @click.command()
    def command() -> None:
        try:
            signal.raise_signal(signal.SIGINT)
        except ProcessEnded:
            if made_of_it is not None:
                raise made_of_it("something") from None

    assert status_of(command, []) == 130
    assert capsys.readouterr().err == "interrupted\n"


def test_no_result_is_written_after_a_signal(tmp_path: Path) -> None:
    from pupper_analysis.cli.shared import write_json

    @click.command()
    def command() -> None:
        with contextlib.suppress(ProcessEnded):
            signal.raise_signal(signal.SIGINT)
        write_json(tmp_path / "out.json", {})

    assert status_of(command, []) == 130
    assert list(tmp_path.iterdir()) == []


BUSY = """
import click, concurrent.futures, sys, time
from pupper_analysis import __main__, cli
@click.command()
def busy():
    pool = concurrent.futures.ThreadPoolExecutor()
    pool.submit(time.sleep, 600)
    print("busy", flush=True)
    time.sleep(600)
cli.find_command = lambda name: busy
__main__.main("busy")
"""


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_a_command_whose_threads_compute(number: signal.Signals) -> None:
    """Python waits for the threads of its pools, here for ten minutes."""
    process = start(sys.executable, "-c", BUSY)
    assert process.stdout is not None
    assert process.stdout.readline() == "busy\n"
    process.send_signal(number)
    _, err = process.communicate(timeout=PATIENCE)
    assert process.returncode == 128 + number
    assert err == {15: "terminated\n", 2: "interrupted\n"}[int(number)]


# ------------------------------------------------------------------------------------- errors


@click.command()
def raise_error() -> None:
    raise ZeroDivisionError("of\nsomething")


def test_an_unexpected_error_is_one_line_and_exit_status_3(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert status_of(raise_error, []) == 3
    err = capsys.readouterr().err
    assert err.startswith("error: unexpected: ZeroDivisionError: of\\nsomething.")
    assert err.count("\n") == 1
    assert "--debug" in err


def test_operating_system_errors_are_not_reported_as_bugs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    @click.command()
    def many() -> None:
        raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))

    @click.command()
    def leave_removed_folder() -> None:
        tmp_path.joinpath("gone").mkdir()
        monkeypatch.chdir(tmp_path / "gone")
        tmp_path.joinpath("gone").rmdir()
        Path.cwd()

    for command, said in (
        (many, "Too many open files"),
        (leave_removed_folder, "the current folder is gone"),
    ):
        assert status_of(command, []) == cli.EXIT_BAD_INPUT
        assert said in capsys.readouterr().err


@pytest.mark.slow
def test_commands_accept_file_names_that_are_not_utf8_and_invalid_window_settings(
    tmp_path: Path,
) -> None:
    """On Linux a file name is bytes, and the environment may request any window system."""
    odd = tmp_path / os.fsdecode(b"\xff.urdf")
    odd.write_bytes((ROOT / "urdf" / "pupper_skeleton.urdf").read_bytes())
    for words in (
        ["audit", "--format", "sarif", odd],
        ["convert", odd, "-o", tmp_path / "made.xml"],
        ["stand", "original", "--figure", tmp_path / "a.png"],
    ):
        result = subprocess.run(
            [*COMMAND, *words],
            capture_output=True, env=ENVIRONMENT | {"MPLBACKEND": "nonsense"}, check=False,
        )  # fmt: skip
        assert result.returncode in (0, 1), result.stderr
        assert b"bug" not in result.stderr


def test_debug_shows_the_traceback(capsys: pytest.CaptureFixture[str]) -> None:
    assert status_of(raise_error, ["--debug"]) == 3
    err = capsys.readouterr().err
    assert "Traceback" in err
    assert 'raise ZeroDivisionError("of' in err


@pytest.mark.slow
def test_a_signal_that_a_library_suppresses_is_raised_again() -> None:
    """The exception is suppressed once; clean-up code and later code are not interrupted."""
    code = """
        import os, signal, time
        from pupper_analysis.cli.process import ProcessEnded, catch_ending_signals

        swallowed = 0
        with catch_ending_signals() as ending:
            try:
                os.kill(os.getpid(), signal.SIGINT)
            except BaseException:
                swallowed += 1
            try:
                try:
                    time.sleep(30)
                finally:
                    time.sleep(1)  # the cleanup is not interrupted
                    swallowed += 1
            except ProcessEnded:
                ending.caught = True
                swallowed += 1
        time.sleep(1)  # nor what comes after
        print(swallowed)
    """
    process = start(sys.executable, "-c", textwrap.dedent(code))
    assert process.communicate(timeout=PATIENCE) == ("3\n", "")
    assert process.returncode == 0


def test_control_characters_of_an_error_are_escaped(capsys: pytest.CaptureFixture[str]) -> None:
    """A name with a line break could start a command of a CI workflow."""

    @click.command()
    def named() -> None:
        raise ConfigurationError("x", "\n::error::forged\x1b[31m\u009b\u202e")

    with pytest.raises(SystemExit):
        cli.run(named, [])
    err = capsys.readouterr().err
    assert err == "error: x: \\n::error::forged\\x1b[31m\\x9b\\u202e\n"


@pytest.mark.parametrize(
    ("code", "status", "message"),
    [(None, 0, ""), (0, 0, ""), (3, 3, ""), ("no licence", 1, "error: no licence\n")],
)
def test_text_of_a_system_exit_is_an_error(
    code: str | int | None, status: int, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Python prints the text on standard error, and exits with status 1."""

    @click.command()
    def command() -> None:
        sys.exit(code)

    assert status_of(command, []) == status
    assert capsys.readouterr() == ("", message)
