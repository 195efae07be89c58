"""Where a result comes from: the command, the versions, the files that were read, and the date."""

from __future__ import annotations

import hashlib
import platform
import shlex
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, is_dataclass
from datetime import UTC, datetime
from functools import lru_cache
from importlib import metadata
from pathlib import Path
from typing import Any

from pupper_analysis.base.diagnostics import Diagnostic
from pupper_analysis.base.kinds import GENERATOR
from pupper_analysis.base.results import to_json, to_plain
from pupper_analysis.base.runs import current_run
from pupper_analysis.base.units import units_of

LIBRARIES = ("pupper-analysis", "mujoco", "pin", "placo", "numpy", "clarabel", "scipy")
"""Whose versions results depend on."""


_MOST_FILES = 12
"""That are listed on a page: of a robot with meshes there may be a hundred."""


@dataclass(frozen=True)
class Provenance:
    """What a result was made with.

    Attributes:
        command: As it would be typed; empty in Python.
        asked: {option that was given, as in ``payload_at``: its value}: numbers in SI units, texts
            as they were typed. What a file of options gives is there, too.
        date: When it was written (UTC, ISO 8601).
        versions: {library, python, machine: its version, or kind}.
        files: {file that was read: SHA-256 of its content}.
    """

    command: str
    asked: dict[str, Any]
    date: str
    versions: dict[str, str]
    files: dict[str, str]

    def lines(self) -> tuple[str, ...]:
        """Returns it in a few lines: hashes by their first twelve digits, of the first files."""
        versions = ", ".join(f"{name} {version}" for name, version in self.versions.items())
        files = [f"{name} sha256:{digest[:12]}" for name, digest in self.files.items()]
        more = len(files) - _MOST_FILES
        files[_MOST_FILES:] = [f"... {more} more files: --json has them"] if more > 0 else []
        return tuple(line for line in (self.command, self.date, versions, *files) if line)


@lru_cache(maxsize=1)
def list_versions() -> dict[str, str]:
    """Returns the versions of what results depend on; the processor's kind is one of them."""
    found = {"machine": platform.machine(), "python": platform.python_version()}
    for library in LIBRARIES:
        try:
            found[library] = metadata.version(library)
        except metadata.PackageNotFoundError:
            found[library] = "unknown"
    return found


def find_provenance() -> Provenance:
    """Returns where what is written now comes from; outside of a command without files."""
    run = current_run()
    files = {}
    for name in sorted(run.inputs.values()) if run else ():
        with suppress(OSError), Path(name).open("rb") as file:  # it may be gone meanwhile
            files[name] = hashlib.file_digest(file, "sha256").hexdigest()
    return Provenance(
        command=shlex.join(run.command) if run else "",
        asked=dict(run.asked) if run else {},
        date=datetime.now(UTC).isoformat(timespec="seconds"),
        versions=dict(list_versions()),
        files=files,
    )


def marked_json(content: object) -> str:
    """Returns a result, or a mapping of results, as a JSON file that says what has made it.

    Its ``provenance`` has ``units``, too: of each field whose class states one, by its name.

    Raises:
        ConfigurationError: As ``to_json``.
    """
    from pupper_analysis import __version__

    own = content if isinstance(content, Mapping) else to_plain(content)
    stated: dict[str, set[str]] = {}
    for kind in set(_kinds_in(content)):
        for name, unit in units_of(kind).items():
            stated.setdefault(name, set()).add(unit)
    units = {name: " or ".join(sorted(found)) for name, found in sorted(stated.items())}
    origin = {**to_plain(find_provenance()), "units": units}
    marks = {"generator": f"{GENERATOR} {__version__}", "provenance": origin}
    return f"{to_json({**marks, **own})}\n"


def _kinds_in(content: object) -> Iterator[type]:
    """Yields the class of each result in a result, or in a container of results."""
    if is_dataclass(content) and not isinstance(content, Diagnostic):
        yield type(content)
        content = to_plain(content)
    inside = tuple(content.values()) if isinstance(content, Mapping) else content
    for one in inside if isinstance(inside, list | tuple) else ():
        yield from _kinds_in(one)
