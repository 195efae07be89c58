"""Where com and feet are, at one configuration after another: all that judging a stand needs."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.arguments import check_vector
from pupper_analysis.robot.coordinates import normalise_quaternion
from pupper_analysis.robot.structure import Structure

Array = NDArray[np.float64]
Place = tuple[Array, Array]


class Kinematics:
    """Com, feet's centres and links, as a ``Configuration`` has them, without anything else.

    One belongs to one thread.

    Args:
        structure: The robot's.

    Attributes:
        qpos: (nq,) where it has been moved to; nobody can change it.
        com: (x, y, z) in the world (m).
        feet: {foot: (x, y, z) of its centre} in the world (m).
        links: {link: its rotation (3, 3) and origin (3,) (m)} in the world. They are Pinocchio's
            own memory: after the next ``move`` they are those there, unless it has copied them
            instead; see ``is_pinocchio_memory``.
    """

    qpos: Array
    com: list[float]
    feet: dict[str, list[float]]

    def __init__(self, structure: Structure) -> None:
        self._structure, self._model = structure, structure.model
        self._q = structure.convention.unit_q
        self._data = structure.model.createData()
        self.links: dict[str, Place] = {}
        self._feet: dict[str, Array] = {}
        self._com = np.zeros(0)

    def move(self, qpos: ArrayLike) -> None:
        """Takes com, feet and links to a configuration (nq,), whose quaternion is normalised.

        Raises:
            ConfigurationError: If it has a wrong length, a value is not finite, or the quaternion
                is zero.
        """
        own = check_vector("qpos", qpos, self._structure.nq)
        if self._structure.floating:
            normalise_quaternion(own)
        pin.framesForwardKinematics(self._model, self._data, self._q(own))
        pin.centerOfMass(self._model, self._data, pin.POSITION, False)
        if not is_pinocchio_memory(self._com):
            self._look()
        own.flags.writeable = False
        com = self._structure.centre(self._com) if self._structure.fixed else self._com
        self.qpos, self.com = own, com.tolist()
        self.feet = {foot: place.tolist() for foot, place in self._feet.items()}

    def _look(self) -> None:
        """Takes hold of where Pinocchio writes: to read it there is quicker than to ask for it."""
        places, structure = self._data.oMf, self._structure
        self._com = self._data.com[0]
        self._feet = {foot: places[at].translation for foot, at in structure.feet.items()}
        at = {link: places[number] for link, number in structure.links.items()}
        self.links = {link: (place.rotation, place.translation) for link, place in at.items()}


def is_pinocchio_memory(array: Array) -> bool:
    """Whether an array of Pinocchio's is its memory, which tells what is written there next.

    By default it is; who calls ``pin.sharedMemory(False)`` gets copies.
    """
    return not array.flags.owndata
