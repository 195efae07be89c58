"""Hidden files as killed processes leave them."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from pupper_analysis.base import files


def leave_hidden_file(folder: Path, *, alive: bool = False) -> Path:
    """Write a hidden temporary file of a killed process, or of this process if ``alive``."""
    token = files.hidden_token()
    if not alive:
        with subprocess.Popen([sys.executable, "-c", ""]) as dead:
            token = token.replace(f"-{os.getpid():x}-", f"-{dead.pid:x}-")
    path = folder / f".{token}.tmp"
    path.write_bytes(b"half")
    files._cleaned_folders.clear()
    return path
