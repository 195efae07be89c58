"""Removal of unused xacro declarations, such as properties and macros, from a URDF.

Converters and hand-written URDFs keep such declarations, and readers of URDF ignore them: 88 of 674
public URDFs contain xacro elements of this kind only. A file that uses xacro otherwise must be
expanded first.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Final

from lxml import etree

from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.errors import ModelError
from pupper_analysis.models.places import make_element_error
from pupper_analysis.models.xml import XACRO_EXPRESSION, XACRO_PREFIX, parse_xml

_DECLARATIONS: Final = ("property", "arg", "macro")
"""Xacro elements that do not change links or joints by themselves: only a macro call or an
expression that uses their names has an effect."""

_HARMLESS_TAGS: Final = ("material", "transmission", "gazebo", "ros2_control")
"""Children of an included file's root that change neither links nor joints."""

_HARMLESS_NAMES: Final = re.compile(r"materials?|colou?rs?|transmissions?|gazebo|ros2_control")
"""Pattern in the names (lower case) of included files that are assumed to contain neither links nor
joints if they do not exist on this computer.
"""

_FIND: Final = re.compile(r"^\$\(find\s+([\w.-]+)\)/")
"""Pattern of ``$(find NAME)/`` at the start of a path."""

_MAX_INCLUDE_DEPTH: Final = 10
"""Largest depth of a chain of included xacro files; a file with a longer chain is refused. Bounds
the reading time. Chosen, not tuned."""

ResolveMesh = Callable[[str], Path | None]
"""Function that returns the file of a name relative to the URDF, or of ``package://NAME/...``; None
if there is no such file."""


def remove_declarations(path: Path, root: etree._Element, resolve: ResolveMesh) -> list[Diagnostic]:
    """Remove unused xacro declarations and harmless includes from a URDF tree, in place.

    Returns:
        A list with a note on the removed elements; empty if there are none.

    Raises:
        ModelError: If a xacro element must be expanded by xacro, for example a macro call.
    """
    declared = [element for element in root.iter() if element.prefix == XACRO_PREFIX]
    if not declared:
        return []
    names = []
    for element in declared:
        ancestors = (parent.prefix for parent in element.iterancestors())
        if XACRO_PREFIX in ancestors:  # a part of a macro
            continue
        if not _is_harmless(element, resolve, 0):
            raise make_element_error(path, element, diagnose("file-is-xacro"))
        tag = etree.QName(element).localname
        names.append(f"{tag} {element.get('name') or element.get('filename') or ''}".strip())
        _remove_element(element)
    for element in root.iter():
        texts = (*map(str, element.attrib.values()), element.text or "")
        if any(map(XACRO_EXPRESSION.search, texts)):
            raise make_element_error(path, element, diagnose("file-is-xacro"))
    return [diagnose("xacro-ignored", names=names)]


def _remove_element(element: etree._Element) -> None:
    """Remove an element, and keep the text behind the element."""
    parent, before = element.getparent(), element.getprevious()
    if before is None:
        parent.text = (parent.text or "") + (element.tail or "")
    else:
        before.tail = (before.tail or "") + (element.tail or "")
    parent.remove(element)


def _is_harmless(element: etree._Element, resolve: ResolveMesh, depth: int) -> bool:
    """Return True if a xacro element is assumed to change neither links nor joints.

    ``resolve`` finds included files. ``depth`` is the number of nested includes up to this element.
    """
    tag = etree.QName(element).localname
    if tag in _DECLARATIONS:
        return True
    if tag != "include" or depth >= _MAX_INCLUDE_DEPTH:
        return False
    name = element.get("filename") or ""
    file = resolve(_FIND.sub(r"package://\1/", name))
    if file is None:
        return bool(_HARMLESS_NAMES.search(Path(name).name.lower()))
    try:
        _, included = parse_xml(file)
    except ModelError:
        return False
    return included.tag == "robot" and all(
        child.tag in _HARMLESS_TAGS
        if child.prefix != XACRO_PREFIX
        else _is_harmless(child, resolve, depth + 1)
        for child in included
    )
