"""What a robot is called where one types it: a variant's name, or its files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError, VariantError
from pupper_analysis.base.inputs import STANDARD_INPUT, is_input
from pupper_analysis.models.published import SCHEME
from pupper_analysis.pupper.variants import VARIANTS

_ENDINGS: Final = (".urdf", ".xml", ".mjcf", ".xacro")

_MJCF_OF_SCHEME: Final = "_mj_description"
"""How the names of those packages end that are MJCFs."""

_HEAD: Final = 4096
"""Bytes of a file in which its root element begins."""

_BOTH: Final = "+"
"""Between a robot's two files, where several robots are named."""


def split_word(word: str) -> str | tuple[str, ...]:
    """Returns a variant's name, or the files of a robot: one, or two with a plus between them.

    Raises:
        VariantError: If it is neither.
    """
    if word in VARIANTS:
        return word
    files = (word,) if is_input(Path(word)) else tuple(word.split(_BOTH))
    if all(map(_is_file, files)):
        return files
    raise VariantError("name", word, diagnose("known-robots", variants=VARIANTS))


def split_words(words: Sequence[str]) -> list[str | tuple[str, ...]]:
    """Returns the variants and files of the robots that words name, each once.

    A URDF that is followed by an MJCF is one robot with it, in all commands; so are a URDF and an
    MJCF that are all that is named, in any order.

    Raises:
        VariantError: If a word names no robot.
    """
    found: list[str | tuple[str, ...]] = []
    for meant in map(split_word, words):
        last = found[-1] if found else None
        if _format(last) == "urdf" and _format(meant) == "mjcf":
            assert isinstance(last, tuple)
            assert isinstance(meant, tuple)
            found[-1] = (*last, *meant)
        elif meant not in found:
            found.append(meant)
    if [_format(meant) for meant in found] == ["mjcf", "urdf"]:
        return [tuple(str(file) for meant in found for file in meant)]
    return found


def one_of_words(words: Sequence[str]) -> str | tuple[str, ...] | None:
    """Returns the variant or the files of one robot, which may be two words; None without any.

    Raises:
        ConfigurationError: If it is more than one robot.
        VariantError: If it is none.
    """
    found = split_words(words)
    if len(found) > 1:
        raise ConfigurationError("ROBOT", diagnose("one-robot-at-a-time", robots=list(words)))
    return found[0] if found else None


def _format(meant: str | tuple[str, ...] | None) -> str | None:
    """Returns ``"urdf"`` or ``"mjcf"`` of a file alone; None of what else is named."""
    if not isinstance(meant, tuple) or len(meant) != 1:
        return None
    [word] = meant
    if word.startswith(SCHEME):
        return "mjcf" if word.endswith(_MJCF_OF_SCHEME) else "urdf"
    ending = Path(word).suffix.lower()
    if ending == ".xml" and Path(word).is_file():  # which may be either
        with Path(word).open("rb") as file:
            return "urdf" if b"<robot" in file.read(_HEAD) else "mjcf"
    return {".urdf": "urdf", ".xacro": "urdf", ".xml": "mjcf", ".mjcf": "mjcf"}.get(ending)


def _is_file(word: str) -> bool:
    path = Path(word)
    return (
        word.startswith(SCHEME)
        or path == STANDARD_INPUT
        or path.suffix.lower() in _ENDINGS
        or len(path.parts) > 1
        or is_input(path)
    )
