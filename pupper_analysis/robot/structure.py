"""What depends on a robot alone: a model in public coordinates, numbers of frames and joints.

It is worked out once per robot, so that a configuration, of which there may be thousands, looks
up no name, turns no axes, and allocates nothing of Pinocchio's. Who asks for com and feet alone, as
in judging a stand, has them of ``Kinematics``, at one configuration after another.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.arguments import check_vector
from pupper_analysis.robot.coordinates import PinocchioConvention, normalise_quaternion

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

_MOST_SPARE = 32
"""Workspaces that are kept for later (some 10 kB each); those that are in use are not counted."""


class Workspace:
    """A Pinocchio ``Data`` that belongs to its holder alone; another may have it afterwards.

    Attributes:
        data: The data.
    """

    __slots__ = ("_spare", "data")

    def __init__(self, data: pin.Data, spare: list[pin.Data]) -> None:
        self.data, self._spare = data, spare

    def __del__(self) -> None:
        if len(self._spare) < _MOST_SPARE:
            self._spare.append(self.data)


class Structure:
    """What depends on a robot alone.

    Attributes:
        model: The robot's model in public coordinates; see ``in_public_coordinates``.
        nq: Size of the public qpos.
        nv: Size of the public qvel.
        convention: The way from public coordinates to the model's.
        links: {link: number of its frame}.
        joints: {joint: its number}.
        feet: {foot: number of its frame}.
        parents: {foot: number of the joint that carries it}.
        rest: (nv,) a velocity of zero, which nobody can change.
        carried: (nv, nv) whether a coordinate (row) turns with another one (column), as far as
            one carries the other: what is before it does so, and a ball's three do all.
        total_mass: kg.
        fixed: Mass of what does not move, a fixed base's, in parts of the total.
        lever: (3,) its centre (m).
    """

    def __init__(
        self,
        model: pin.Model,
        convention: PinocchioConvention,
        joint_names: Sequence[str],
        contact_frames: Mapping[str, str],
    ) -> None:
        self.model = in_public_coordinates(model, joint_names)
        self._given = model
        self.floating = convention.floating
        self.nv = convention.base_nv + len(joint_names)
        self.nq = self.nv + self.floating
        # Of links of one name Pinocchio's own search finds the first.
        frames = [
            (n, f.name) for n, f in enumerate(self.model.frames) if f.type == pin.FrameType.BODY
        ]
        self.links: dict[str, int] = {name: number for number, name in reversed(frames)}
        self.joints: dict[str, int] = {
            name: int(self.model.getJointId(name)) for name in joint_names
        }
        self.feet = {foot: self.links[frame] for foot, frame in contact_frames.items()}
        self.parents = {
            foot: int(self.model.frames[frame].parentJoint) for foot, frame in self.feet.items()
        }
        self.total_mass = float(sum(inertia.mass for inertia in model.inertias))
        self.fixed = float(model.inertias[0].mass) / self.total_mass if self.total_mass else 0.0
        self.lever = np.array(model.inertias[0].lever)
        # A view of what cannot be written to cannot be made writeable.
        rest = np.zeros(self.nv)
        rest.flags.writeable = False
        self.rest = rest[:]
        self.convention = PinocchioConvention.of(self.model, joint_names)
        self._order = np.arange(self.nv)  # of the given model's coordinates in the own one's
        self._order[self.convention.v_index] = convention.v_index
        columns = np.concatenate([np.arange(convention.base_nv), self.convention.v_index])
        one, other = np.meshgrid(columns, columns, indexing="ij")
        self._upper = np.minimum(one, other) * self.nv + np.maximum(one, other)
        self.carried = columns[:, None] >= columns
        if self.floating:
            self.carried[3:6, 3:6] = True
        in_order = bool((columns == np.arange(self.nv)).all())
        self._columns: IntArray | None = None if in_order else columns
        self._spare: list[pin.Data] = []

    def workspace(self) -> Workspace:
        """Returns a workspace that nobody else holds."""
        try:
            data = self._spare.pop()
        except IndexError:
            data = self.model.createData()
        return Workspace(data, self._spare)

    def loaded(self) -> pin.Model:
        """Returns the model with the armature that the robot's has now: it may be changed."""
        self.model.armature = self._given.armature.take(self._order)
        return self.model

    def state(self, qpos: ArrayLike) -> Array:
        """Returns a public qpos (nq,) of one's own, with its quaternion normalised.

        Raises:
            ConfigurationError: If it has a wrong length, a value is not finite, or the quaternion
                is zero.
        """
        own = check_vector("qpos", qpos, self.nq)
        if self.floating:
            normalise_quaternion(own)
        return own

    def centre(self, moving: Array) -> Array:
        """Returns the com (3,), of that of what moves: Pinocchio leaves out what does not (m)."""
        if not self.fixed:
            return moving
        com: Array = moving + self.fixed * (self.lever - moving)
        return com

    def columns(self, jacobian: Array) -> Array:
        """Returns the model's Jacobian (n, nv) with its columns in public order."""
        if self.nv == 1:  # Pinocchio's is flat
            jacobian = jacobian.reshape(-1, 1)
        return jacobian if self._columns is None else jacobian.take(self._columns, axis=1)

    def dual(self, forces: Array) -> Array:
        """Returns the model's generalised forces, or accelerations, (nv,) in public order."""
        public: Array = forces if self._columns is None else forces.take(self._columns)
        return public.copy()

    def inertia(self, upper: Array) -> Array:
        """Returns a symmetric matrix (nv, nv) of the model, whose upper triangle counts."""
        symmetric: Array = upper.take(self._upper)
        return symmetric

    def square(self, matrix: Array) -> Array:
        """Returns any matrix (nv, nv) of the model in public order."""
        if self._columns is None:
            return matrix.copy()
        return matrix.take(self._columns, axis=0).take(self._columns, axis=1)

    def velocity(self, qvel: Array) -> Array:
        """Returns the model's velocity, or force, (nv,) of a public one."""
        if self._columns is None:
            return qvel
        own = np.empty(self.nv)
        own[self._columns] = qvel
        return own


def in_public_coordinates(model: pin.Model, joint_names: Sequence[str]) -> pin.Model:
    """Returns the same robot, without armature, in a model whose coordinates are the public ones.

    What moves freely does so by a translation, whose velocity is in the world's axes, and a ball
    joint, whose velocity is in its own: MuJoCo's free joint. Nothing has to be turned then that
    Pinocchio computes. The joints are in actuator order, as far as Pinocchio, which wants each
    with all that it carries behind it, can have them so; and q has the quaternion's w last.

    Args:
        model: The robot, its base on a free flyer.
        joint_names: In actuator order.
    """
    own = pin.Model()
    own.name, own.gravity = model.name, model.gravity
    numbers = {0: 0}
    wanted = [int(model.getJointId(name)) for name in joint_names]
    for joint in _carried_behind(model, wanted):
        kind, parent = model.joints[joint], numbers[model.parents[joint]]
        place, name = model.jointPlacements[joint], model.names[joint]
        if kind.nv == 6:
            parent = own.addJoint(parent, pin.JointModelTranslation(), place, f"{name} moves")
            kind, place = pin.JointModelSpherical(), pin.SE3.Identity()
        numbers[joint] = own.addJoint(parent, kind, place, name)
    for joint, number in numbers.items():
        own.appendBodyToJoint(number, model.inertias[joint], pin.SE3.Identity())
    for frame in list(model.frames)[1:]:
        joint = numbers[frame.parentJoint]
        own.addFrame(pin.Frame(frame.name, joint, 0, frame.placement, frame.type), False)
    return own


def _carried_behind(model: pin.Model, wanted: Sequence[int]) -> Iterator[int]:
    """Yields the joints, what each carries behind it, and in the wanted order among those."""
    place = {joint: index for index, joint in enumerate(wanted)}
    carried: dict[int, list[int]] = {}
    for joint in sorted(range(1, model.njoints), key=lambda joint: -place.get(joint, -1)):
        carried.setdefault(int(model.parents[joint]), []).append(joint)
    ahead = carried.get(0, [])
    while ahead:
        joint = ahead.pop()
        yield joint
        ahead += carried.get(joint, ())


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
