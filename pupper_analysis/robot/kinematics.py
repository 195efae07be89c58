"""Where com and feet are, at one configuration after another: all that judging a stand needs."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.robot.structure import Structure

Array = NDArray[np.float64]
Place = tuple[Array, Array]


class Kinematics:
    """Com, feet's centres and links, as a ``Configuration`` has them, without anything else.

    One belongs to one thread.

    Args:
        structure: The robot's.

    Attributes:
        qpos: (nq,) where it has been moved to.
    """

    qpos: Array

    def __init__(self, structure: Structure) -> None:
        self._structure, self._model = structure, structure.model
        self._data = structure.model.createData()
        self._feet: dict[str, Array] = {}
        self._links: dict[str, Place] = {}
        self._com = np.zeros(0)

    def move(self, qpos: Array) -> None:
        """Takes com, feet and links to a configuration (nq,) whose quaternion is normalised."""
        self.qpos = qpos
        pin.framesForwardKinematics(self._model, self._data, self._structure.q(qpos))
        pin.centerOfMass(self._model, self._data, pin.POSITION, False)
        if not is_pinocchio_memory(self._com):
            self._look()

    def com(self) -> list[float]:
        """Returns the com (x, y, z) in the world (m)."""
        com: list[float] = self._structure.centre(self._com).tolist()
        return com

    def feet(self) -> dict[str, list[float]]:
        """Returns {foot: (x, y, z) of its centre} in the world (m)."""
        return {foot: place.tolist() for foot, place in self._feet.items()}

    def link(self, name: str) -> Place:
        """Returns rotation (3, 3) and origin (3,) (m) of a link in the world.

        They are Pinocchio's own memory: after the next ``move`` they are those there, unless it has
        copied them instead; see ``is_pinocchio_memory``.
        """
        if name not in self._links:
            place = self._data.oMf[self._structure.links[name]]
            self._links[name] = place.rotation, place.translation
        return self._links[name]

    def _look(self) -> None:
        """Takes hold of where Pinocchio writes: to read it there is quicker than to ask for it."""
        places = self._data.oMf
        self._com = self._data.com[0]
        self._feet = {foot: places[at].translation for foot, at in self._structure.feet.items()}
        self._links = {}


def is_pinocchio_memory(array: Array) -> bool:
    """Whether an array of Pinocchio's is its memory, which tells what is written there next.

    By default it is; who calls ``pin.sharedMemory(False)`` gets copies.
    """
    return not array.flags.owndata
