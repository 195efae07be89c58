"""``python -m pupper_analysis``, and the console command."""

from __future__ import annotations

import os
import sys


def main() -> None:
    """Runs the command line; Ctrl-C while it is loaded is no traceback either."""
    try:
        from pupper_analysis.cli import main as run
    except KeyboardInterrupt:
        sys.stderr.write("interrupted\n")
        sys.stderr.flush()
        os._exit(130)
    run()


if __name__ == "__main__":
    main()
