"""Which file's value is taken in which difference."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Final

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.base.inputs import read_text
from pupper_analysis.models.attributes import JOINT_ATTRIBUTES
from pupper_analysis.robot.compare.differences import SERVO_GAINS, Difference

SIDES: Final = ("urdf", "mjcf")

_OF_BODY: Final = ("mass", "com", "inertia")

_OF_JOINT: Final = (
    "position",
    "rotation",
    "axis",
    *(attribute.kind for attribute in JOINT_ATTRIBUTES),
    "zero",
    "type",
    "parent",
    "mimic",
    "name",
    "damping polynomial",
    *SERVO_GAINS,
)


def owner_name(difference: Difference) -> str:
    """Names what a difference is of: ``link FL_hip``, ``joint FL_hip_joint``, ``frame FL_foot``."""
    if difference.kind in _OF_BODY:
        return f"link {link_of(difference)}"
    if difference.kind in _OF_JOINT:
        return f"joint {difference.element}"
    if difference.kind == "frame":
        return f"frame {difference.element}"
    return difference.element


def link_of(difference: Difference) -> str:
    """Returns the link that a difference is of; its element, where it is not of a link."""
    subject = difference.diagnostic.subject
    return subject.name if subject is not None and subject.kind == "link" else difference.element


def difference_label(difference: Difference) -> str:
    """Names a difference: ``link FL_hip: mass``."""
    kind = "position" if difference.kind == "frame" else difference.kind
    return f"{owner_name(difference)}: {kind}"


def choose_files(
    differences: Sequence[Difference], take: str | Iterable[str]
) -> tuple[str | None, ...]:
    """Says whose value is taken, per difference; None where nothing was chosen.

    Args:
        differences: The differences, numbered from 1.
        take: ``"urdf"``, ``"mjcf"``, or either with a colon and what it is taken for: numbers
            (``3``, ``1,4-6``), a kind (``mass``), what it is of (``base``, ``joint FL_hip``), or
            both (``link FL_hip: mass``). What is more particular counts, whatever the order; of
            two that are as particular, the last.

    Raises:
        ConfigurationError: If a choice is not of that form, or meets no difference.
    """
    result: list[str | None] = [None] * len(differences)
    rank = [0] * len(differences)
    for text in [take] if isinstance(take, str) else take:
        side, colon, which = text.partition(":")
        side, which = side.strip().lower(), which.strip().strip("\"'").strip()
        if side not in SIDES or (colon and not which):
            raise ConfigurationError("take", diagnose("take-not-valid", given=text))
        for index, weight in _meant(differences, which):
            if weight >= rank[index]:
                result[index], rank[index] = side, weight
    return tuple(result)


def _meant(differences: Sequence[Difference], which: str) -> Iterator[tuple[int, int]]:
    """Yields the places of the differences that are meant, and how particular that is."""
    if not which:
        yield from ((index, 0) for index in range(len(differences)))
        return
    names = [
        (
            difference_label(difference),
            owner_name(difference),
            link_of(difference),
            difference.element,
            difference.kind,
        )
        for difference in differences
    ]
    ranks = (3, 2, 2, 2, 1)
    if not any(which in of_one for of_one in names) and re.fullmatch(r"[\d,\s-]+", which):
        yield from ((number - 1, 4) for number in _numbers(which, len(differences)))
        return
    found = False
    for index, of_one in enumerate(names):
        if which in of_one:
            found = True
            yield index, ranks[of_one.index(which)]
    if not found:
        known = dict.fromkeys(of_one[0] for of_one in names)
        raise ConfigurationError("take", diagnose("no-such-difference", given=which, known=known))


def _numbers(text: str, most: int) -> Iterator[int]:
    for part in text.split(","):
        found = re.fullmatch(r"\s*(\d+)\s*(?:-\s*(\d+)\s*)?", part)
        if found is None:
            raise ConfigurationError("take", diagnose("no-list-of-numbers", given=text))
        first, last = int(found[1]), int(found[2] or found[1])
        if not 1 <= first <= last <= most:
            told = diagnose("no-such-number", given=part.strip(), most=most)
            raise ConfigurationError("take", told)
        yield from range(first, last + 1)


def line_at(place: str) -> str:
    """Returns the text of a file's line, of a place such as ``robot.urdf:12``."""
    name, _, line = place.rpartition(":")
    if not (name and line.isdigit()):
        return ""
    lines = read_text(Path(name)).split("\n")
    return lines[int(line) - 1].strip() if int(line) <= len(lines) else ""
