"""``python -m pupper_analysis``, and the console command."""

from __future__ import annotations

import os
import sys
import threading

from pupper_analysis.base.drivers import use_one_blas_thread


def main(command: str | None = None, *arguments: str) -> None:
    """Run the command line, and exit with the status of the command.

    While the command line is imported, Ctrl-C prints a line instead of a traceback, and a missing
    package of another project prints a line and exits with status 2.

    ``command`` is the name of the command; by default the first command-line argument.
    ``arguments`` are arguments of ``command``, placed before the command-line arguments.
    """
    use_one_blas_thread()
    try:
        from pupper_analysis import cli
    except KeyboardInterrupt:
        sys.stderr.write("interrupted\n")
        sys.stderr.flush()
        os._exit(130)
    except ModuleNotFoundError as missing:
        if (missing.name or "").startswith(__package__ or "pupper_analysis"):
            raise
        sys.stderr.write(
            f"error: {sys.executable} has no package {missing.name}. In a checkout: `make setup`, "
            "then `source .venv/bin/activate`; else `pip install` the package anew.\n"
        )
        sys.exit(2)
    try:
        if command is None:
            cli.main()
        else:
            cli.run(cli.find_command(command), [*arguments, *sys.argv[1:]])
    except SystemExit as ended:
        if isinstance(ended.code, int) and ended.code > MAX_UNSIGNALLED_STATUS:
            end_without_waiting(ended.code)
        raise


MAX_UNSIGNALLED_STATUS = 128
"""Largest exit status that denotes no signal, by convention of Unix shells."""


def end_without_waiting(status: int) -> None:
    """End the process at once, with an exit status, if other non-daemon threads are running.

    A normal exit would wait for the threads, for example the threads of browser sessions of
    ``live``. Output must be flushed before.
    """
    main_thread = threading.main_thread()
    if any(thread is not main_thread and not thread.daemon for thread in threading.enumerate()):
        os._exit(status)


if __name__ == "__main__":
    main()
