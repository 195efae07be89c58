"""``python -m pupper_analysis``, and the console command."""

from __future__ import annotations

import os
import sys
import threading


def main(command: str | None = None, *arguments: str) -> None:
    """Runs the command line; Ctrl-C while it is loaded is no traceback either.

    A package that is not installed is one line and exit status 2: mostly the environment is not
    activated.

    Args:
        command: One command by its name; by default the first argument
            names it.
        *arguments: Of that command, before those that are typed.
    """
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
        if isinstance(ended.code, int) and ended.code > SIGNALLED:
            end_without_waiting(ended.code)
        raise


SIGNALLED = 128
"""Exit statuses above are those of signals, by convention of shells."""


def end_without_waiting(status: int) -> None:
    """End a process that a signal has ended, if threads still compute.

    All output is written by now. Python would wait for the threads of pools, for example of the
    page that ``live`` makes for each browser: 5 to 9 s with twelve of them.
    """
    main_thread = threading.main_thread()
    if any(one is not main_thread and not one.daemon for one in threading.enumerate()):
        os._exit(status)


if __name__ == "__main__":
    main()
