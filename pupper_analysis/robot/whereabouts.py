"""Where com and feet are, at one configuration after another: all that judging a stand needs."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.robot.structure import Structure

Array = NDArray[np.float64]


class Whereabouts:
    """Com and feet's centres, as a ``Configuration`` has them, without anything else.

    One belongs to one thread.

    Args:
        structure: The robot's.
    """

    def __init__(self, structure: Structure) -> None:
        self._structure, self._model = structure, structure.model
        self._data = structure.model.createData()
        self._feet: Mapping[str, Array] = {}
        self._com = np.zeros(0)

    def at(self, qpos: Array) -> tuple[list[float], dict[str, list[float]]]:
        """Returns the com (x, y, z) and {foot: (x, y, z) of its centre} in the world (m).

        Args:
            qpos: (nq,) whose quaternion is normalised.
        """
        pin.framesForwardKinematics(self._model, self._data, self._structure.q(qpos))
        pin.centerOfMass(self._model, self._data, pin.POSITION, False)
        if not seen(self._com):
            self._look()
        com = self._structure.centre(self._com).tolist()
        return com, {foot: place.tolist() for foot, place in self._feet.items()}

    def _look(self) -> None:
        """Takes hold of where Pinocchio writes: to read it there is quicker than to ask for it."""
        places = self._data.oMf
        self._com = self._data.com[0]
        self._feet = {foot: places[at].translation for foot, at in self._structure.feet.items()}


def seen(array: Array) -> bool:
    """Whether an array of Pinocchio's shows its memory, and so what is written there next.

    By default it does; who calls ``pin.sharedMemory(False)`` gets copies.
    """
    return not array.flags.owndata
