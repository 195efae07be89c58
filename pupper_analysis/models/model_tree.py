"""What can be asked of the links and joints of a model file, and changed in them, in either format.

Who changes both files of a robot writes the change once, and does it to each tree in turn.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final, Protocol

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.models.attributes import JointAttribute

Array = NDArray[np.float64]
Number = float | str
"""A number, or as it is written in another file."""

FLOOR: Final = "floor"
"""What a floor that is added, and its material, are called."""

HOME: Final = "home"
"""What the keyframe to start from is called."""

COUPLING_TIME: Final = 5e-3
"""Time constant of couplings (s): MuJoCo's own, 20 ms, lets fingers of grammes open far."""

IMU_SENSORS: Final = ("gyro", "accelerometer")
"""The sensors of an IMU: their elements in an MJCF, and what they are called."""


class ModelTree(Protocol):
    """The links and joints of a URDF, or the bodies and joints of an MJCF."""

    @property
    def names(self) -> tuple[str, ...]:
        """The links, in the file's order; the world is none."""

    def parent(self, link: str) -> str | None:
        """Returns what carries a link; None for a root."""

    def movers(self, link: str) -> tuple[str, ...]:
        """Returns the joints that move a link against what carries it; a free one is none."""

    def moved_by(self, joint: str) -> str | None:
        """Returns the link that a joint moves; None if there is no such joint."""

    def fixed_group(self, link: str) -> list[str]:
        """Returns a link, and all that is fixed to it and carried by it."""

    def subtree(self, link: str) -> Iterator[str]:
        """Yields a link and all that it carries."""

    def weight(self, link: str) -> float:
        """Returns the mass of a link (kg); 0 where none is stated."""

    def remove_subtree(self, link: str) -> None:
        """Takes a link out, with all that it carries and the joints that hold it."""

    def add_link(
        self, name: str, parent: str, joint: str, place: Array, inertia: pin.Inertia | None = None
    ) -> None:
        """Adds a link that is fixed to another, with its axes.

        Args:
            name: The link's.
            parent: What it is fixed to.
            joint: The name of the joint between them, where the format has one.
            place: (3,) of its frame in the parent's (m).
            inertia: What it weighs, in its own frame; None: nothing is stated.
        """

    def scale_mass(self, link: str, factor: float) -> None:
        """Multiplies the mass of one link, and its inertia with it."""

    def scale_inertia(self, link: str, factor: float) -> None:
        """Multiplies the inertia of one link about its com.

        Raises:
            ValueError: If it is not stated, but follows from shapes.
        """

    def move_com(self, link: str, offset: Array) -> None:
        """Moves the com of one link by an offset (3,) in its own axes (m)."""

    def scale(self, joint: str, attribute: JointAttribute, factor: float) -> None:
        """Multiplies a number of a joint; what is not stated, or has no words, stays so."""
