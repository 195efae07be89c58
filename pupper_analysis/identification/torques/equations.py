"""What torques are linear in: numbers of bodies and joints, and how parameters make these."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.arrays import INERTIA_ENTRIES, inertia_entries, inertia_tensor
from pupper_analysis.identification.links import AXES, link_of
from pupper_analysis.identification.parameters import ParameterTable
from pupper_analysis.identification.torques.blocks import Blocks
from pupper_analysis.identification.torques.couplings import Coupling, coupling_rows
from pupper_analysis.robot.robot import Robot

Array = NDArray[np.float64]

OF_DRIVES = ("friction", "damping", "armature")
"""Kinds of numbers of what turns, a joint or a motor that turns with several: what each is
multiplied by is its velocity's sign, its velocity and its acceleration."""

OF_JOINTS = (*OF_DRIVES, "bias")
"""Kinds of numbers of a joint; its bias is a torque."""

ENTRIES = tuple(name[1:] for name in INERTIA_ENTRIES)
"""Components of an inertia."""

_PER_BODY = 10
"""m, m c, and Ixx, Ixy, Iyy, Ixz, Iyz, Izz about the joint's frame: Pinocchio's order."""

_PINOCCHIO = ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))
"""Its order of an inertia's entries."""


class TorqueEquations:
    """tau = Y(q, q', q'') pi + friction sign(q') + damping q' + armature q'' + bias.

    Y is Pinocchio's joint-torque regressor (Atkeson, An, Hollerbach, "Estimation of inertial
    parameters of manipulator loads and links", 1986), and pi ten numbers of each body, in which
    torques are linear. Masses, coms and inertias about these are the parameters, as files state
    them; bodies whose numbers are none of the parameters are as the file has them.

    A motor that turns with several joints, by c q', gives them c^T (friction sign(c q') + damping
    c q' + armature c q''), as virtual work has it.

    Args:
        robot: A robot whose base is held.
        joints: The numbers of those whose torques are told.
        couplings: Motors that turn with several of them.

    Attributes:
        drives: {joint or motor: (joints,) how far it turns for a turn of each}.
        links: {number of a joint: the link its body is named by}, of those that are told.
        mass: {link: kg}, as the URDF has them.
        com: {link: (3,) in the link's frame (m)}.
        inertia: {link: (3, 3) about the com (kg m^2)}.
    """

    def __init__(self, robot: Robot, joints: list[int], couplings: Sequence[Coupling] = ()) -> None:
        self.robot, self.joints = robot, joints
        names = [robot.joint_names[joint] for joint in joints]
        rows = [*np.eye(len(joints)), *coupling_rows(robot, couplings, names)[:, joints]]
        drives = (*names, *(one.name for one in couplings))
        self.drives: dict[str, Array] = dict(zip(drives, rows, strict=True))
        self._model = robot.pin_model.copy()
        self._model.gravity.linear = robot.gravity
        self._data = self._model.createData()
        self.links: dict[int, str] = {}
        self._bodies: list[int] = []
        for joint in joints:
            number = self._model.getJointId(robot.joint_names[joint])
            if self._model.inertias[number].mass > 0:
                self.links[joint] = link_of(self._model, number)
                self._bodies.append(number)
        inertias = [self._model.inertias[number] for number in self._bodies]
        names = list(self.links.values())
        self.mass = {name: float(own.mass) for name, own in zip(names, inertias, strict=True)}
        self.com = {name: np.array(own.lever) for name, own in zip(names, inertias, strict=True)}
        self.inertia = {
            name: np.array(own.inertia) for name, own in zip(names, inertias, strict=True)
        }

    def regressor(self, blocks: Blocks) -> tuple[Array, Array]:
        """Returns what torques are linear in.

        Args:
            blocks: Of a run.

        Returns:
            The matrix (blocks, joints, numbers) of means over blocks, and how it changes in them
            (1/s). The last column is the torque of bodies whose numbers are none of the parameters.
        """
        count, points, _ = blocks.position.shape
        own = np.concatenate(
            [_PER_BODY * (number - 1) + np.arange(_PER_BODY) for number in self._bodies]
            or [np.zeros(0, dtype=int)]
        ).astype(int)
        known = np.concatenate([one.toDynamicParameters() for one in self._model.inertias[1:]])
        known[own] = 0.0
        rows = self.robot.pin_convention.v_index[self.joints]
        found = np.zeros((2, count, len(self.joints), len(own)))
        rest = np.zeros((2, count, len(self.joints), 1))
        for block in range(count):
            for point in range(points):
                whole = self._whole(
                    blocks.position[block, point],
                    blocks.velocity[block, point],
                    blocks.acceleration[block, point],
                )[rows]
                part = blocks.weights[:, point, None, None]
                found[:, block] += part * whole[:, own]
                rest[:, block] += part * (whole @ known)[:, None]
        drives = np.array(list(self.drives.values()))
        speed = blocks.velocity[:, :, self.joints] @ drives.T
        gain = blocks.acceleration[:, :, self.joints] @ drives.T
        by_kind = np.stack([np.sign(speed), speed, gain], axis=3)
        by_kind = np.einsum("wp,bpdk->wbdk", blocks.weights, by_kind)
        columns = drives.T[:, :, None] * by_kind[:, :, None]
        bias = np.zeros((*rest.shape[:3], len(self.joints)))
        bias[0] = np.eye(len(self.joints))
        columns = columns.reshape(*rest.shape[:3], -1)
        matrix, rate = np.concatenate([found, columns, bias, rest], axis=3)
        return matrix, rate

    def _whole(self, position: Array, velocity: Array, acceleration: Array) -> Array:
        convention = self.robot.pin_convention
        v, a = np.zeros(self._model.nv), np.zeros(self._model.nv)
        v[convention.v_index], a[convention.v_index] = velocity, acceleration
        found: Array = pin.computeJointTorqueRegressor(
            self._model, self._data, convention.q(position), v, a
        )
        return found

    def numbers(self, table: ParameterTable, x: Array) -> tuple[Array, Array]:
        """Returns the numbers (n,) that torques are linear in, and how parameters change them.

        The last is 1, of what is known. The inertia about a joint's frame is I + m (c.c 1 - c c^T),
        with I that about the com c.

        Args:
            table: The parameters.
            x: (parameters,) their values.
        """
        size = len(self._bodies) * _PER_BODY
        own = self._own_kinds()
        found = np.append(np.zeros(size + len(own)), 1.0)
        slopes = np.zeros((len(found), len(table)))
        for number, link in enumerate(self.links.values()):
            first = _PER_BODY * number
            for place, value, slope in self._of_body(table, x, link):
                found[first : first + _PER_BODY] = value
                if place is not None:
                    slopes[first : first + _PER_BODY, place] = slope
        for row, (kind, subject) in enumerate(own, size):
            found[row] = table.value(x, kind, subject, "", self.stated(subject)[kind])
            place = table.place(kind, subject)
            if place is not None:
                slopes[row, place] = 1.0
        return found, slopes

    def _own_kinds(self) -> list[tuple[str, str]]:
        """Returns kind and subject of the numbers that are of no body."""
        biased = list(self.drives)[: len(self.joints)]
        return [(kind, name) for name in self.drives for kind in OF_DRIVES] + [
            ("bias", name) for name in biased
        ]

    def _of_body(
        self, table: ParameterTable, x: Array, link: str
    ) -> Iterator[tuple[int | None, Array, Array]]:
        """Yields each parameter's place, the body's ten numbers, and their derivative by it."""
        com = np.array(
            [
                table.value(x, "com", link, axis, own)
                for axis, own in zip(AXES, self.com[link], strict=True)
            ]
        )
        about_com = inertia_tensor(
            table.value(x, "inertia", link, entry, own)
            for entry, own in zip(ENTRIES, inertia_entries(self.inertia[link]), strict=True)
        )
        mass = table.value(x, "mass", link, "", self.mass[link])
        moved = _about_origin(com, com)
        value = _ten(mass, mass * com, about_com + mass * moved)
        yield table.place("mass", link), value, _ten(1.0, com, moved)
        for axis, unit in zip(AXES, np.eye(3), strict=True):
            both = mass * (_about_origin(com, unit) + _about_origin(unit, com))
            yield table.place("com", link, axis), value, _ten(0.0, mass * unit, both)
        for entry, unit in zip(ENTRIES, np.eye(6), strict=True):
            place = table.place("inertia", link, entry)
            yield place, value, _ten(0.0, np.zeros(3), inertia_tensor(unit))

    def stated(self, subject: str) -> dict[str, float]:
        """Returns what the file says of a joint, by kind; of a motor of several, nothing."""
        if subject not in self.robot.joint_names:
            return dict.fromkeys(OF_DRIVES, 0.0)
        joint = self.robot.joint_names.index(subject)
        model, dof = self.robot.mj_model, self.robot.mj_convention.qvel_index[joint]
        return {
            "friction": float(model.dof_frictionloss[dof]),
            "damping": float(model.dof_damping[dof]),
            "armature": float(model.dof_armature[dof]),
            "bias": 0.0,
        }


def _about_origin(one: Array, other: Array) -> Array:
    """Returns a.b 1 - a b^T, symmetrical where it is added to its transpose."""
    found: Array = (one @ other) * np.eye(3) - np.outer(one, other)
    return found


def _ten(mass: float, first: Array, second: Array) -> Array:
    """Returns a body's ten numbers in Pinocchio's order."""
    return np.array([mass, *first, *(second[place] for place in _PINOCCHIO)])
