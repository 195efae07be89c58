"""Two trees of parameters that differ, and what is left of that if one of them were another."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import Diagnostic
from pupper_analysis.models.multibody import MultibodyTree
from pupper_analysis.robot.compare.changes import changes_between
from pupper_analysis.robot.compare.links import Links
from pupper_analysis.robot.matching.alignment import align_frames
from pupper_analysis.robot.matching.tolerances import Tolerances
from pupper_analysis.robot.robot import Robot

Array = NDArray[np.float64]
Key = tuple[str, str]
"""The kind and the element of a difference."""


@dataclass(frozen=True, eq=False)
class PatternCase:
    """Two trees that differ.

    Attributes:
        robot: The robot.
        first: The URDF's tree.
        raw: The MJCF's, as it is.
        second: The MJCF's, in the URDF's link frames.
        keys: The differences.
        tolerances: What counts as one.
        urdf: The links of which the URDF's bodies are made, in the frames of ``first``.
        mjcf: Those of the MJCF's, in the frames of ``second``.
        taken: Those that a cause explains already.
    """

    robot: Robot
    first: MultibodyTree
    raw: MultibodyTree
    second: MultibodyTree
    keys: Sequence[Key]
    tolerances: Tolerances
    urdf: Links
    mjcf: Links
    taken: Collection[Key] = ()

    @property
    def open(self) -> list[Key]:
        """The differences that no cause explains yet."""
        return [key for key in self.keys if key not in self.taken]

    def left(self, second: MultibodyTree, only: Collection[str] | None = None) -> set[Key]:
        """Returns the differences to another tree in place of the MJCF's.

        Args:
            second: The other tree.
            only: The joints that are compared, with what they carry; by default all and the base.
        """
        first = self.first if only is None else self.first.part(only)
        try:
            both = align_frames(second, first, self.tolerances).values
            found = {(c.kind, c.element) for c in changes_between(first, both, self.tolerances)}
        except (ValueError, KeyError):  # not the same joints any more
            return set(self.keys)
        return found

    def masses_apart(self, exchange: Mapping[str, str]) -> int:
        """Returns how many masses differ where bodies are exchanged; no frame's place matters."""
        pairs = [*exchange.items(), *((two, one) for one, two in exchange.items())]
        masses = [(self.first.bodies[a].mass, self.raw.bodies[b].mass) for a, b in pairs]
        greatest = self.tolerances.mass
        return sum(abs(two - one) > greatest * max(abs(one), abs(two)) for one, two in masses)

    def gone(self, second: MultibodyTree) -> set[Key]:
        """Returns the differences that another tree in place of the MJCF's does not have.

        None if it has others instead, or if most of them are left.
        """
        left = self.left(second)
        gone = set(self.keys) - left
        return gone if not left - set(self.keys) and len(gone) > 1 else set()


@dataclass(frozen=True, eq=False)
class PatternFinding:
    """A slip that explains differences.

    Attributes:
        kind: A cause's.
        diagnostic: What it is, with its numbers.
        explained: The differences.
        undone: What is left to explain when it is undone, for those that look afterwards.
    """

    kind: str
    diagnostic: Diagnostic
    explained: set[Key]
    undone: PatternCase | None = None


Found = Iterator[PatternFinding]
