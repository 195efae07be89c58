"""What a robot is called where one types it: a variant's name, or its files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from pupper_analysis.diagnostics import diagnose
from pupper_analysis.errors import ConfigurationError, VariantError
from pupper_analysis.inputs import is_input
from pupper_analysis.models.published import SCHEME
from pupper_analysis.models.standard_input import NAME as STANDARD_INPUT
from pupper_analysis.pupper.variants import VARIANTS

_ENDINGS: Final = (".urdf", ".xml", ".mjcf", ".xacro")

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
    """Returns the variants and files of several robots, each once."""
    return [split_word(word) for word in dict.fromkeys(words)]


def one_of_words(words: Sequence[str]) -> str | tuple[str, ...] | None:
    """Returns the variant or the files of one robot, which may be two words; None without any.

    Raises:
        ConfigurationError: If it is more than one robot.
        VariantError: If it is none.
    """
    found = split_words(words)
    if len(found) == 2:
        one, other = found
        if len(one) == len(other) == 1 and isinstance(one, tuple) and isinstance(other, tuple):
            return (*one, *other)
    if len(found) > 1:
        raise ConfigurationError("ROBOT", diagnose("one-robot-at-a-time", robots=list(words)))
    return found[0] if found else None


def _is_file(word: str) -> bool:
    path = Path(word)
    return (
        word.startswith(SCHEME)
        or path == STANDARD_INPUT
        or path.suffix.lower() in _ENDINGS
        or len(path.parts) > 1
        or is_input(path)
    )
