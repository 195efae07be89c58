"""Provenance of a result: command, options, versions, hashes of the input files, and date.

Command, options and input files are taken from the record of the current run (`runs`). JSON results
and pages contain the provenance, so that the computation can be repeated.
"""

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
from pupper_analysis.base.kinds import GENERATOR_NAME
from pupper_analysis.base.results import to_json, to_plain
from pupper_analysis.base.runs import current_run
from pupper_analysis.base.units import units_of

RECORDED_LIBRARIES = ("pupper-analysis", "mujoco", "pin", "placo", "numpy", "clarabel", "scipy")
"""Distributions whose versions are recorded in the provenance, because they affect results."""


_MAX_LISTED_FILES = 12
"""Maximum number of input files listed on a page. A robot with meshes may have a hundred.
Chosen, not tuned."""


@dataclass(frozen=True)
class Provenance:
    """Command, environment and input files of a result.

    Attributes:
        command: Command line, quoted for a shell; empty if the result was computed in Python.
        request: {option: value} of the options on the command line or in a file of options, for
            example ``payload_at``. Numbers are in SI units, texts as typed.
        date: Time of writing (UTC, ISO 8601).
        versions: {library, ``python`` or ``machine``: version or processor type}; ``"unknown"`` for
            a library that is not installed.
        files: {input file: SHA-256 of the content}, without files that cannot be read any more.
    """

    command: str
    request: dict[str, Any]
    date: str
    versions: dict[str, str]
    files: dict[str, str]

    def lines(self) -> tuple[str, ...]:
        """Return the provenance as lines of text for a page, with shortened hashes.

        The lines do not contain ``request``, and at most `_MAX_LISTED_FILES` input files.
        """
        versions = ", ".join(f"{name} {version}" for name, version in self.versions.items())
        files = [f"{name} sha256:{digest[:12]}" for name, digest in self.files.items()]
        num_omitted = len(files) - _MAX_LISTED_FILES
        files[_MAX_LISTED_FILES:] = (
            [f"... {num_omitted} more files: --json has them"] if num_omitted > 0 else []
        )
        return tuple(line for line in (self.command, self.date, versions, *files) if line)


@lru_cache(maxsize=1)
def list_versions() -> dict[str, str]:
    """Return the versions of ``RECORDED_LIBRARIES``, the Python version and the processor type.

    The version of a library that is not installed is ``"unknown"``.
    """
    versions = {"machine": platform.machine(), "python": platform.python_version()}
    for library in RECORDED_LIBRARIES:
        try:
            versions[library] = metadata.version(library)
        except metadata.PackageNotFoundError:
            versions[library] = "unknown"
    return versions


def collect_provenance() -> Provenance:
    """Collect command, options, versions and file hashes of the current run (`runs`).

    Outside of a run, the provenance contains date and versions only.
    """
    run = current_run()
    files = {}
    for name in sorted(run.inputs.values()) if run else ():
        with suppress(OSError), Path(name).open("rb") as file:  # the file may have been deleted
            files[name] = hashlib.file_digest(file, "sha256").hexdigest()
    return Provenance(
        command=shlex.join(run.command) if run else "",
        request=dict(run.request) if run else {},
        date=datetime.now(UTC).isoformat(timespec="seconds"),
        versions=dict(list_versions()),
        files=files,
    )


def to_marked_json(content: object) -> str:
    """Return a result, or a mapping of results, as JSON with generator and provenance.

    The entry ``provenance`` also contains ``units``: {field: unit} of the fields whose class
    specifies a fixed unit (`units_of`).

    Raises:
        ConfigurationError: If a value has no JSON equivalent, such as bytes.
    """
    from pupper_analysis import __version__

    plain = content if isinstance(content, Mapping) else to_plain(content)
    units_by_field: dict[str, set[str]] = {}
    for result_type in set(_iter_result_types(content)):
        for name, unit in units_of(result_type).items():
            units_by_field.setdefault(name, set()).add(unit)
    units = {
        name: " or ".join(sorted(alternatives))
        for name, alternatives in sorted(units_by_field.items())
    }
    origin = {**to_plain(collect_provenance()), "units": units}
    marks = {"generator": f"{GENERATOR_NAME} {__version__}", "provenance": origin}
    return f"{to_json({**marks, **plain})}\n"


def _iter_result_types(content: object) -> Iterator[type]:
    """Yield the classes of the dataclasses in a result or container, without diagnostics."""
    if is_dataclass(content) and not isinstance(content, Diagnostic):
        yield type(content)
        content = to_plain(content)
    items = tuple(content.values()) if isinstance(content, Mapping) else content
    for item in items if isinstance(items, list | tuple) else ():
        yield from _iter_result_types(item)
