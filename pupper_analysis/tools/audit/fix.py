"""Write the repairs of an audit into the files: a patch, and the changed bytes.

Inputs are audits. Only repairs of findings with a single repair are applied. A repair that
estimates a value (`ValueRepair.is_estimate`) is not applied. Attribute values are replaced, and
missing attributes and elements inserted, in the bytes of the file, so that all other bytes stay.
Files with uncommitted changes in git are written only if forced.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from pupper_analysis.base.files import Writing, write_all
from pupper_analysis.base.kinds import EDITED_KIND
from pupper_analysis.models.git import refuse_uncommitted
from pupper_analysis.models.xml_bytes import (
    XmlDocument,
    XmlElement,
    read_xml_bytes,
)
from pupper_analysis.tools.audit.registry import Audit, ValueRepair


def apply_repairs(audits: Iterable[Audit]) -> tuple[list[XmlDocument], int]:
    """Change the files of audits in memory, by the repairs of `list_unique_repairs`.

    Args:
        audits: Results of audits.

    Returns:
        Changed files, and the number of applied repairs. The files on disk are unchanged.

    Raises:
        InputError: If a file to be repaired cannot be read.
    """
    documents: dict[str, XmlDocument] = {}
    count = 0
    for repair in list_unique_repairs(audits):
        document = documents.setdefault(repair.file, read_xml_bytes(Path(repair.file)))
        count += _change_elements(document, repair)
    return [d for d in documents.values() if d.root.is_changed()], count


def _change_elements(document: XmlDocument, repair: ValueRepair) -> bool:
    """Apply a repair to a file in memory, if the file has the old values; True if applied."""
    if not _has_old_values(document, repair):
        return False
    for change in repair.list_changes():
        element = _find_repaired_element(document, change) or _ensure_element(document, change)
        for word, text in change.new.items():
            element.set(word, text)
    return True


def _has_old_values(document: XmlDocument, repair: ValueRepair) -> bool:
    """Return True if a file has the old values that a repair expects.

    White space between numbers does not count, since readers of URDF remove it.
    """
    for change in repair.list_changes():
        element = _find_repaired_element(document, change)
        if element is None:
            if any(change.old.values()) or _find_owner(document, change) is None:
                return False
        elif any(
            (element.get(word) or "").split() != text.split() for word, text in change.old.items()
        ):
            return False
    return True


def list_computed_repairs(audits: Iterable[Audit]) -> list[ValueRepair]:
    """Return the repairs that cannot be written, because the file lacks the expected old values.

    A xacro macro, for example, computes such values.

    Raises:
        InputError: If a file to be repaired cannot be read.
    """
    repairs = list_unique_repairs(audits)
    documents = {file: read_xml_bytes(Path(file)) for file in {repair.file for repair in repairs}}
    return [repair for repair in repairs if not _has_old_values(documents[repair.file], repair)]


def list_unique_repairs(audits: Iterable[Audit]) -> list[ValueRepair]:
    """Return the repairs that `audit --fix` may write: of findings with exactly one repair.

    Estimates (`ValueRepair.is_estimate`) are left out.
    """
    return [repair for repair in _list_single_repairs(audits) if not repair.is_estimate]


def list_estimates(audits: Iterable[Audit]) -> list[ValueRepair]:
    """Return the repairs that only estimate a value, of findings with exactly one repair."""
    return [repair for repair in _list_single_repairs(audits) if repair.is_estimate]


def _list_single_repairs(audits: Iterable[Audit]) -> list[ValueRepair]:
    """Return the repairs of all findings with exactly one repair; equal repairs once."""
    found = [
        finding.repairs[0]
        for audit in audits
        for finding in audit.findings
        if len(finding.repairs) == 1
    ]
    return [repair for index, repair in enumerate(found) if repair not in found[:index]]


def _find_repaired_element(document: XmlDocument, repair: ValueRepair) -> XmlElement | None:
    """Return the element that a repair changes; None if no or several elements fit the repair."""
    named = _list_owners(document, repair)
    found = [element for element in named if _find_descendant(element, repair.child) is not None]
    return _find_descendant(found[0], repair.child) if len(found) == 1 else None


def _list_owners(document: XmlDocument, repair: ValueRepair) -> list[XmlElement]:
    """Return the elements of a file with the tag and the ``name`` that a repair states."""
    return [
        element
        for element in document.elements
        if element.tag == repair.tag and element.get("name") == repair.name
    ]


def _find_owner(document: XmlDocument, repair: ValueRepair) -> XmlElement | None:
    """Return the child of the XML root with a repair's tag and name; None if none or several."""
    found = [
        element for element in _list_owners(document, repair) if element.parent is document.root
    ]
    return found[0] if len(found) == 1 else None


def _ensure_element(document: XmlDocument, repair: ValueRepair) -> XmlElement:
    """Return the element that a repair changes, and create the missing elements on its path."""
    element = _find_owner(document, repair)
    assert element is not None
    for tag in repair.child.split("/"):
        element = element.ensure(tag)
    return element


def _find_descendant(element: XmlElement, path: str) -> XmlElement | None:
    """Return the element at a path of tags below an element; None if a tag is missing.

    A number from 1 in brackets selects one of several children: ``visual[2]/geometry/mesh``.
    """
    current: XmlElement | None = element
    for step in path.split("/") if path else ():
        tag, _, number = step.rstrip("]").partition("[")
        children = [] if current is None else current.findall(tag)
        index = int(number or 1) - 1
        current = children[index] if index < len(children) else None
    return current


def locate_repair(repair: ValueRepair) -> tuple[tuple[int, int, str], ...]:
    """Return the byte ranges that a repair replaces in the file on disk.

    Returns:
        (start [bytes], length [bytes], new text) of each range. Empty if the repair cannot be
        applied.

    Raises:
        InputError: If the file cannot be read.
    """
    document = read_xml_bytes(Path(repair.file))
    if not _change_elements(document, repair):
        return ()
    splices = sorted(document.list_splices(), key=lambda splice: splice[:2])
    return tuple((start, end - start, text.decode()) for start, end, text in splices)


def write_documents(documents: Iterable[XmlDocument], *, force: bool = False) -> None:
    """Write changed files.

    Args:
        documents: Changed files.
        force: Whether files with uncommitted changes in a git repository are written.

    Raises:
        OutputError: If a file cannot be written, was changed since it was read, or (unless
            ``force``) has uncommitted changes in a git repository.
        InputError: If a file of a git repository cannot be read.
    """
    changed = list(documents)
    if not force:
        for document in changed:
            refuse_uncommitted(document.path)
    write_all([Writing(d.path, d.render(), EDITED_KIND, before=d.data) for d in changed])
