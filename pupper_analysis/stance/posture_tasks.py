"""Tasks of a whole-body posture: targets of frames, of the CoM and of joints.

Each task has a residual, which is zero if the posture satisfies the task, and adds a corresponding
task or constraint to a PlaCo solver. `WholeBody` provides the poses that a residual needs, so that
residuals can be evaluated with the kinematics of either engine.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple, Protocol

import numpy as np
import placo
from numpy.typing import ArrayLike

from pupper_analysis.base.arguments import (
    MAX_LENGTH,
    check_direction,
    check_fields,
    check_finite,
    real_array,
)
from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError

_ROTATION_TOLERANCE = 1e-6
"""Largest absolute element of R^T R - 1 with which a matrix R is accepted as a rotation matrix.
Chosen: more than the rounding of matrices with seven digits."""


CLEARANCE_WEIGHT = 1e2
"""Weight of the squared violation of the self clearance (distance between links), relative to other
tasks. Measured on Pupper v3: with 1e4, PlaCo's quadratic programs are so badly conditioned that 180
iterations are needed instead of 18."""


class WholeBody(Protocol):
    """Poses of a robot in the world frame, by the kinematics of one engine."""

    def pose(self, frame: str) -> tuple[Array, Array]:
        """Return rotation (3, 3) and position (3,) [m] of a link in the world frame."""

    def com(self) -> Array:
        """Return the position of the CoM in the world frame, shape (3,) [m]."""

    def joint(self, name: str) -> float:
        """Return the position of the joint ``name`` [rad, m]."""

    def self_clearances(self) -> Array:
        """Return the smallest distances [m] of collision shapes on links that are not neighbours.

        Ascending; a pair of links may occur several times.
        """

    def linearise_self_clearances(self) -> tuple[Array, Array]:
        """Return the derivatives of `self_clearances` by the configuration, and the configuration.

        The configuration belongs to PlaCo's robot, which always has a free base. Derivatives by the
        pose of the base are zero.

        Returns:
            Derivatives, shape (n, nq); configuration, shape (nq,).
        """


Update = Callable[[WholeBody], None]
"""Function that changes the target of a PlaCo task before an iteration."""


class PlacoTask(NamedTuple):
    """Task in a PlaCo solver.

    Attributes:
        task: PlaCo's task, or a replacement (`_MeasuredClearance`), with ``update`` and
            ``error_norm``.
        update_target: Function that changes the target of ``task`` before an iteration; None if the
            target is fixed.
    """

    task: Any
    update_target: Update | None = None


class PostureTask(ABC):
    """Requirement of a whole-body posture, for example the position of a link.

    Attributes:
        unit: Unit of the residual.
        required: Whether the residual must be zero, up to a tolerance. A task that is not required
            selects one of the postures that satisfy the required tasks.
    """

    unit: ClassVar[str]
    required = True

    @property
    def frames(self) -> tuple[str, ...]:
        """Names of the links whose poses this posture task requires; none by default."""
        return ()

    @abstractmethod
    def residual(self, body: WholeBody) -> float:
        """Return the distance of a posture from the target of this task, in ``unit`` (m or rad)."""

    @abstractmethod
    def add_to(self, solver: placo.KinematicsSolver, weight: float) -> PlacoTask:
        """Add this task to a PlaCo solver, and return it as a `PlacoTask`."""


@dataclass(frozen=True, eq=False)
class PositionTask(PostureTask):
    """Position of the origin of a link in the world frame.

    Attributes:
        frame: Name of the link.
        position: Target (x, y, z) [m].
        axes: World axes along which the position is required, for example "xy".
    """

    frame: str
    position: ArrayLike
    axes: str = "xyz"
    unit: ClassVar[str] = "m"

    def __post_init__(self) -> None:
        check_fields(self)
        _freeze_array(self, "position", _make_vector("position", self.position))
        _check_axes(self.axes)

    @property
    def frames(self) -> tuple[str, ...]:
        """Names of the links that this posture task refers to."""
        return (self.frame,)

    def residual(self, body: WholeBody) -> float:
        """Return the distance [m] of the link's origin from its world target along ``axes``."""
        gap = body.pose(self.frame)[1] - np.asarray(self.position)
        return float(np.linalg.norm(gap[_select_axes(self.axes)]))

    def add_to(self, solver: placo.KinematicsSolver, weight: float) -> PlacoTask:
        """Add PlaCo's soft task for the world position [m] of the link ``frame`` to a solver."""
        task = solver.add_position_task(self.frame, self.position)
        task.mask.set_axises(self.axes)
        task.configure("position", "soft", weight)
        return PlacoTask(task)


@dataclass(frozen=True, eq=False)
class OrientationTask(PostureTask):
    """Orientation of a link in the world frame.

    Attributes:
        frame: Name of the link.
        rotation: Target, rotation matrix (3, 3) from link axes to world axes.
    """

    frame: str
    rotation: ArrayLike
    unit: ClassVar[str] = "rad"

    def __post_init__(self) -> None:
        check_fields(self)
        _freeze_array(self, "rotation", _check_rotation(self.rotation))

    @property
    def frames(self) -> tuple[str, ...]:
        """Names of the links that this posture task refers to."""
        return (self.frame,)

    def residual(self, body: WholeBody) -> float:
        """Return the angle [rad] between the orientation of the link and its target."""
        return _angle_of(np.asarray(self.rotation).T @ body.pose(self.frame)[0])

    def add_to(self, solver: placo.KinematicsSolver, weight: float) -> PlacoTask:
        """Add PlaCo's soft task for the world orientation of the link ``frame`` to a solver."""
        task = solver.add_orientation_task(self.frame, self.rotation)
        task.configure("orientation", "soft", weight)
        return PlacoTask(task)


@dataclass(frozen=True, eq=False)
class RelativePositionTask(PostureTask):
    """Position of the origin of a link in the frame of another link.

    Attributes:
        frame: Name of the reference link, in whose axes ``position`` is expressed.
        target: Name of the link whose position is required.
        position: Required position (x, y, z) [m] in the axes of ``frame``.
    """

    frame: str
    target: str
    position: ArrayLike
    unit: ClassVar[str] = "m"

    def __post_init__(self) -> None:
        check_fields(self)
        _freeze_array(self, "position", _make_vector("position", self.position))

    @property
    def frames(self) -> tuple[str, ...]:
        """Names of the links that this posture task refers to."""
        return (self.frame, self.target)

    def residual(self, body: WholeBody) -> float:
        """Return the distance [m] of ``target`` from its required position in frame ``frame``."""
        (rotation, origin), (_, place) = body.pose(self.frame), body.pose(self.target)
        return float(np.linalg.norm(rotation.T @ (place - origin) - np.asarray(self.position)))

    def add_to(self, solver: placo.KinematicsSolver, weight: float) -> PlacoTask:
        """Add PlaCo's soft task for the position [m] of ``target``, in the frame of ``frame``."""
        task = solver.add_relative_position_task(self.frame, self.target, self.position)
        task.configure("relative position", "soft", weight)
        return PlacoTask(task)


@dataclass(frozen=True, eq=False)
class CoMTask(PostureTask):
    """Position of the CoM in the world frame.

    Attributes:
        position: Target (x, y, z) [m].
        axes: World axes along which the position is required, for example "xy".
    """

    position: ArrayLike
    axes: str = "xyz"
    unit: ClassVar[str] = "m"

    def __post_init__(self) -> None:
        check_fields(self)
        _freeze_array(self, "position", _make_vector("position", self.position))
        _check_axes(self.axes)

    def residual(self, body: WholeBody) -> float:
        """Return the distance [m] of the CoM from its world target along ``axes``."""
        return float(
            np.linalg.norm((body.com() - np.asarray(self.position))[_select_axes(self.axes)])
        )

    def add_to(self, solver: placo.KinematicsSolver, weight: float) -> PlacoTask:
        """Add PlaCo's soft task for the world position [m] of the CoM to a solver."""
        task = solver.add_com_task(self.position)
        task.mask.set_axises(self.axes)
        task.configure("com", "soft", weight)
        return PlacoTask(task)


@dataclass(frozen=True, eq=False)
class AxisAlignTask(PostureTask):
    """Direction of an axis of a link: parallel to a vector, or towards a point (gaze).

    Attributes:
        frame: Name of the link.
        axis: Axis (3,) in the axes of the link, for example the optical axis of a camera.
        direction: Required direction (3,) in world axes; None if ``point`` is given.
        point: Point (3,) [m] in the world. The axis must point from the origin of the link to this
            point; None if ``direction`` is given.
    """

    frame: str
    axis: ArrayLike
    direction: ArrayLike | None = None
    point: ArrayLike | None = None
    unit: ClassVar[str] = "rad"

    def __post_init__(self) -> None:
        check_fields(self)
        _freeze_array(self, "axis", check_direction("axis", self.axis))
        if (self.direction is None) == (self.point is None):
            raise ConfigurationError(
                "direction", diagnose("direction-or-point", both=self.point is not None)
            )
        if self.direction is not None:
            _freeze_array(self, "direction", check_direction("direction", self.direction))
        else:
            _freeze_array(self, "point", _make_vector("point", self.point))

    @property
    def frames(self) -> tuple[str, ...]:
        """Names of the links that this posture task refers to."""
        return (self.frame,)

    def _compute_required_direction(self, body: WholeBody) -> Array:
        """Return the required direction of the link's axis, unit vector (3,) in world axes."""
        if self.point is None:
            return np.asarray(self.direction)
        line = np.asarray(self.point) - body.pose(self.frame)[1]
        distance = float(np.linalg.norm(line))
        unit: Array = line / distance if distance else np.array([0.0, 0.0, 1.0])
        return unit

    def residual(self, body: WholeBody) -> float:
        """Return the angle [rad] between the axis of the link and its required direction."""
        axis = body.pose(self.frame)[0] @ np.asarray(self.axis)
        required = self._compute_required_direction(body)
        return float(np.arctan2(np.linalg.norm(np.cross(axis, required)), axis @ required))

    def add_to(self, solver: placo.KinematicsSolver, weight: float) -> PlacoTask:
        """Add PlaCo's soft task for the direction of an axis of ``frame`` to a solver."""
        direction = np.array([1.0, 0.0, 0.0]) if self.direction is None else self.direction
        task = solver.add_axisalign_task(self.frame, self.axis, direction)
        task.configure("axis", "soft", weight)
        if self.point is None:
            return PlacoTask(task)

        def update(body: WholeBody) -> None:
            """Set the target direction of PlaCo's task at the configuration of ``body``."""
            task.targetAxis_world = self._compute_required_direction(body)

        return PlacoTask(task, update)


@dataclass(frozen=True, eq=False)
class JointsTask(PostureTask):
    """Positions of joints: required, or only preferred (regularisation of redundant joints).

    Attributes:
        positions: {joint: target [rad, m]}.
        required: False for preferred positions. These select, among the postures that satisfy the
            required tasks, a posture with small squared distances.
    """

    positions: Mapping[str, float]
    required: bool = True
    unit: ClassVar[str] = "rad or m"

    def __post_init__(self) -> None:
        check_fields(self)
        for joint, position in self.positions.items():
            check_finite(f"positions[{joint}]", position)

    def residual(self, body: WholeBody) -> float:
        """Return the largest distance [rad, m] of a joint position from its target."""
        gaps = [abs(body.joint(name) - target) for name, target in self.positions.items()]
        return max(gaps, default=0.0)

    def add_to(self, solver: placo.KinematicsSolver, weight: float) -> PlacoTask:
        """Add PlaCo's soft task for the target joint positions [rad, m] to a solver."""
        task = solver.add_joints_task()
        task.set_joints(dict(self.positions))
        task.configure("joints", "soft", weight)
        return PlacoTask(task)


@dataclass(frozen=True, eq=False)
class SelfClearanceTask(PostureTask):
    """Smallest distance between links that are not neighbours, measured on MuJoCo's shapes.

    Links that the MJCF excludes from contact, and links that overlap in the home configuration, may
    overlap. Shapes of a fixed base are checked; the floor is not.

    Attributes:
        distance: Required distance [m], at least 0.
    """

    distance: float = 0.0
    unit: ClassVar[str] = "m"

    def __post_init__(self) -> None:
        check_fields(self)
        if not 0 <= self.distance <= MAX_LENGTH:
            problem = diagnose("clearance-not-a-length", given=repr(self.distance))
            raise ConfigurationError("distance", problem)

    def residual(self, body: WholeBody) -> float:
        """Return the required minus the smallest distance between links [m], at least 0."""
        return self._compute_shortfall(body.self_clearances())

    def _compute_shortfall(self, distances: Array) -> float:
        """Return the required ``distance`` minus the smallest of ascending distances [m], or 0."""
        return max(0.0, self.distance - float(distances[0])) if len(distances) else 0.0

    def add_to(self, solver: placo.KinematicsSolver, weight: float) -> PlacoTask:
        """Add a soft constraint to PlaCo's solver: links keep at least ``distance`` [m].

        The distances are linearised in the joint positions before each iteration.
        """
        constraint = solver.add_joint_space_half_spaces_constraint(np.zeros((0, 1)), np.zeros(0))
        constraint.configure("self clearance", "soft", CLEARANCE_WEIGHT * weight)
        measured = _MeasuredClearance()

        def update(body: WholeBody) -> None:
            """Linearise PlaCo's constraint at the configuration of ``body``."""
            distances = body.self_clearances()
            derivatives, q = body.linearise_self_clearances()
            if not len(distances):  # 0 q <= 1: PlaCo's constraint needs a row
                constraint.A, constraint.b = np.zeros((1, len(q))), np.ones(1)
                return
            # distance + derivative (q' - q) >= required distance
            constraint.A = -derivatives
            constraint.b = distances - self.distance - derivatives @ q
            measured.residual = self._compute_shortfall(distances)

        return PlacoTask(measured, update)


class _MeasuredClearance:
    """Replacement for a PlaCo task, whose error is the violation of the self clearance."""

    residual = 0.0

    def update(self) -> None:
        """Do nothing: `PlacoTask.update_target` sets ``residual``, instead of PlaCo."""

    def error_norm(self) -> float:
        """Return required distance between links minus the smallest distance [m], at least 0."""
        return self.residual


def _freeze_array(task: object, name: str, value: Array) -> None:
    """Set an attribute of a frozen task to an array, and make the array read-only."""
    value.setflags(write=False)
    object.__setattr__(task, name, value)  # the dataclass is frozen


def _make_vector(name: str, value: Any) -> Array:
    """Convert an argument to a new vector (3,) of finite numbers; ``name`` is for the error."""
    vector = real_array(name, value)
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise ConfigurationError(name, diagnose("no-vector-of-three", given=repr(value)))
    return np.array(vector)


def _check_rotation(value: Any) -> Array:
    """Convert an argument to a new rotation matrix (3, 3), after a check."""
    matrix = real_array("rotation", value)
    if matrix.shape != (3, 3) or not np.isfinite(matrix).all():
        raise ConfigurationError("rotation", diagnose("no-rotation", given=repr(value)))
    error = np.abs(matrix.T @ matrix - np.eye(3)).max()
    if error > _ROTATION_TOLERANCE or np.linalg.det(matrix) < 0:
        raise ConfigurationError("rotation", diagnose("no-rotation", given=repr(value)))
    return np.array(matrix)


def _check_axes(axes: str) -> None:
    """Raise ConfigurationError if a text is empty, or contains other letters than x, y and z."""
    if not axes or set(axes) - set("xyz"):
        known = ["x", "y", "z", "xy", "xz", "yz", "xyz"]
        raise ConfigurationError("axes", diagnose("not-one-of", given=axes, known=known))


def _select_axes(axes: str) -> list[int]:
    """Return the sorted indices of axes: ``"zx"`` gives [0, 2]."""
    return ["xyz".index(axis) for axis in sorted(set(axes))]


def _angle_of(rotation: Array) -> float:
    """Return the angle [rad] of a rotation matrix, accurate also for small angles."""
    skew = rotation - rotation.T
    sine = np.linalg.norm([skew[2, 1], skew[0, 2], skew[1, 0]]) / 2
    return float(np.arctan2(sine, (np.trace(rotation) - 1) / 2))
