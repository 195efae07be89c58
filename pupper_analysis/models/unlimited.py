"""Hinges of a URDF that state no limits: its format has them locked at zero, nobody means that."""

from __future__ import annotations

from lxml import etree

_TOLD = 3  # joints that a note tells


def states_no_limits(joint: etree._Element) -> bool:
    """Tells whether a revolute joint's <limit> says nothing of its range.

    ``lower`` and ``upper`` count as 0 where they are left out, as many exporters do where nothing
    is known, and some write all of 0 there, the effort too. A range of 0 to 0 with an effort stays
    what it says.
    """
    limit = joint.find("limit")
    if joint.get("type") != "revolute" or limit is None:
        return False
    words = [limit.get(name) for name in ("lower", "upper", "effort")]
    if words[:2] == [None, None]:
        return True
    try:
        return not any(float(word or 0.0) for word in words)
    except ValueError:
        return False  # no number: whoever reads it says so


def unlimited(root: etree._Element) -> list[etree._Element]:
    """Returns the joints of a URDF that state no limits; see ``states_no_limits``."""
    return [joint for joint in root.findall("joint") if states_no_limits(joint)]


def note_on_limits(root: etree._Element) -> str | None:
    """Says which joints state no limits, and what they are taken for."""
    names = [str(joint.get("name")) for joint in unlimited(root)]
    if not names:
        return None
    more = f", and {len(names) - _TOLD} more" if len(names) > _TOLD else ""
    return (
        f"joints whose <limit> states no range, or 0 to 0 with an effort of 0, are taken to have "
        f"none: {', '.join(names[:_TOLD])}{more}"
    )
