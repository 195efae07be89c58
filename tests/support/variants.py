"""Variants of Pupper, each loaded once per process."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any
from unittest import mock

import pupper_analysis as pa
from pupper_analysis.pupper import variant_files
from tests.support.repository import ROOT

NAMES = tuple(pa.VARIANTS)
"""Names of all variants."""


SKELETON_NAMES = tuple(name for name in NAMES if not name.startswith("v3"))
"""Names of the variants of the skeleton."""

BASES = {"original": "pupper_skeleton", "v3": "pupper_v3"}
"""{variant without scaling: stem of its model files}."""

BASES_FIRST = (*BASES, *(name for name in NAMES if name not in BASES))
"""Names of all variants, those without scaling first."""


@cache
def load(name: str, fixed_base: bool = False) -> pa.Robot:
    """Return a variant of Pupper."""
    return pa.load_variant(name, fixed_base=fixed_base)


@cache
def stand_of(name: str) -> pa.Stand:
    """Return the nominal stand of a variant."""
    return pa.solve_stand(load(name))


@contextmanager
def share_variants() -> Iterator[None]:
    """Build each named variant once for all commands of this process. Robots are immutable.

    A command that builds a variant again also repeats the simulation of the unmodified file.
    """
    load_anew = pa.load_variant  # the package stores what it imports first: not the substitute
    built: dict[tuple[str, bool], pa.Robot] = {}

    def load_shared(variant: Any, *, fixed_base: Any = False) -> pa.Robot:
        if not isinstance(variant, str):  # each design of a study is another robot
            return load_anew(variant, fixed_base=fixed_base)
        variant_files.describe_variant(variant)  # registers the files as inputs of the run
        if (variant, fixed_base) not in built:
            built[variant, fixed_base] = load_anew(variant, fixed_base=fixed_base)
        return built[variant, fixed_base]

    with mock.patch.object(variant_files, "load_variant", load_shared):
        yield


def write_without_a_mass(folder: Path) -> tuple[Path, Path]:
    """Write the URDF of v3, and a copy in which the link leg_front_r_3 has no inertial."""
    text = (ROOT / "urdf" / "pupper_v3.urdf").read_text()
    start = text.index("<inertial>", text.index('<link name="leg_front_r_3"'))
    stop = text.index("</inertial>", start) + len("</inertial>")
    stated, unstated = folder / "stated.urdf", folder / "unstated.urdf"
    stated.write_text(text)
    unstated.write_text(text[:start] + text[stop:])
    return stated, unstated
