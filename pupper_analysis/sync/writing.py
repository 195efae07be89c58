"""Files that are replaced as a whole; and refused where that might lose somebody's work."""

from __future__ import annotations

import difflib
import re
import secrets
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from pupper_analysis.diagnostics import diagnose
from pupper_analysis.errors import OutputError
from pupper_analysis.models.xml_bytes import XmlDocument


def unified_diff(path: Path, before: bytes, after: bytes) -> str:
    """Returns what would change in a file, as ``diff -u`` and ``patch`` have it."""
    one, two = (text.decode("utf-8").split("\n") for text in (before, after))
    lines = difflib.unified_diff(one, two, f"a/{path.name}", f"b/{path.name}", lineterm="")
    return "\n".join(lines) + "\n" if before != after else ""


_TRIAL = re.compile(r"\.([^\s/]+)-[0-9a-f]{8}(?=\.)")


def as_given(text: str) -> str:
    """Returns a text in which files that are tried have the names of those that are meant."""
    return _TRIAL.sub(r"\1", text)


@contextmanager
def stage_files(*groups: Mapping[Path, XmlDocument]) -> Iterator[list[Path]]:
    """Writes changed files beside the old ones, under other names, to be tried.

    Args:
        groups: {file: its document} of a model, with what is to be changed; the main file first,
            and then what it includes.

    Yields:
        Where to read the main file of each: a new file, or the old one if nothing is changed.

    Raises:
        OutputError: If nothing can be written there.
    """
    token = secrets.token_hex(4)
    places: dict[Path, Path] = {}
    for group in groups:
        if any(document.rendered() != document.data for document in group.values()):
            places |= {path: path.with_name(f".{path.stem}-{token}{path.suffix}") for path in group}
    mains = [next(iter(group)) for group in groups]
    try:
        for group, main in zip(groups, mains, strict=True):
            for path, document in group.items():
                if path in places:
                    _write_trial(places[path], _with_includes(document, main, places), path)
        yield [places.get(main, main) for main in mains]
    finally:
        for place in places.values():
            place.unlink(missing_ok=True)


def _write_trial(place: Path, data: bytes, path: Path) -> None:
    """Writes what is tried; an error names the file that is meant, not the hidden one."""
    try:
        place.write_bytes(data)
    except OSError as error:
        told = diagnose("nothing-to-be-tried", problem=error.strerror or str(error))
        raise OutputError(path, told) from error


def _with_includes(document: XmlDocument, main: Path, places: Mapping[Path, Path]) -> bytes:
    """Returns a document's bytes, with the includes of files that are tried put to those."""
    meant = []
    for element in document.elements:
        file = Path(element.attributes.get("file", ""))
        if element.tag == "include":
            found = (folder / file for folder in (main.parent, document.path.parent))
            there = next((path for path in found if path in places), None)
            if there is not None:
                element.set("file", str(file.with_name(places[there].name)))
                meant.append(element)
    try:
        return document.rendered()
    finally:
        for element in meant:
            element.changes.clear()
