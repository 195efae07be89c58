"""Names that are the same but for what one file puts before or after all of its own."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection, Mapping, Sequence

_EMPTY = {"joint", "jnt", "link"}
"""Words that say nothing about which joint it is."""


def without_affixes(
    mine: Sequence[str], theirs: Sequence[str], pairs: Mapping[str, str]
) -> dict[str, str]:
    """Matches names that are equal but for prefixes (``panda_``) and suffixes (``_joint``).

    What begins or ends most names of one file is left out, and so are words like ``joint``; upper
    and lower case, and how words are joined, do not count. Each is the only one of its kind.

    Args:
        mine: The names in the URDF.
        theirs: The names in the MJCF.
        pairs: What is matched already.

    Returns:
        {name in the URDF: name in the MJCF}.
    """
    one = _cores([name for name in mine if name not in pairs], mine)
    taken = set(pairs.values())
    two = _cores([name for name in theirs if name not in taken], theirs)
    return {one[core]: two[core] for core in one if core in two}


def _cores(names: Collection[str], every: Sequence[str]) -> dict[tuple[str, ...], str]:
    """Returns {what is left of a name: the name}, where that is one alone."""
    words = {name: _words(name) for name in every}
    usual = [_usual(list(words.values())), _usual([each[::-1] for each in words.values()])]
    cores: dict[tuple[str, ...], list[str]] = {}
    for name in names:
        core = words[name]
        for ends in usual:  # what begins it, and then, backwards, what ends it
            for word in ends:
                if len(core) > 1 and core[0] == word:
                    core = core[1:]
            core = core[::-1]
        kept = tuple(word for word in core if word not in _EMPTY)
        cores.setdefault(kept or core, []).append(name)
    return {core: found[0] for core, found in cores.items() if len(found) == 1}


def _usual(words: Sequence[tuple[str, ...]]) -> list[str]:
    """Returns the words, one after the other, with which most names begin."""
    found: list[str] = []
    while True:
        begun = [each for each in words if list(each[: len(found)]) == found]
        next_ones = Counter(each[len(found)] for each in begun if len(each) > len(found) + 1)
        word, count = next_ones.most_common(1)[0] if next_ones else ("", 0)
        if count < max(2, 0.6 * len(words)):
            return found
        found.append(word)


def _words(name: str) -> tuple[str, ...]:
    return tuple(word for word in re.split(r"[^A-Za-z0-9]+", name.lower()) if word) or (name,)
