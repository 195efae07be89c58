"""Cases of parametrised tests that are run in the longest stage."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest


def some(values: Sequence[Any], every: int, first: int = 1) -> list[Any]:
    """Cases of which the first, and one of ``every``, are run; the others in the longest stage."""
    return [
        value if place < first or place % every == 0 else longest(value)
        for place, value in enumerate(values)
    ]


def longest(value: Any) -> Any:
    case = value if isinstance(value, tuple) else (value,)
    return pytest.param(*case, marks=pytest.mark.longest)
