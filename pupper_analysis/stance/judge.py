"""Result class `Stand`: a configuration, its errors [m, rad] for a stand task, and clearances [m].

The inputs are numeric targets (`StandTargets`) and a configuration from a solver. The
output is a `Stand`. `evaluate_stand` computes the errors with Pinocchio's kinematics, independent
of the solver that found the configuration. A `Stand` also provides quantities for simulations:
servo commands, support region and lift-off directions.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar, Protocol, runtime_checkable
from weakref import ref

import numpy as np
from numpy.typing import ArrayLike

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.base.results import Pictured, Tabular
from pupper_analysis.robot.configuration import UP
from pupper_analysis.robot.ground import Ground
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.touching import with_contacts
from pupper_analysis.stance.clearance import Clearance, ClearanceShapes
from pupper_analysis.stance.constraints import (
    CLEARANCE_TOLERANCE,
    TASK_TOLERANCE,
    evaluate_constraints,
)
from pupper_analysis.stance.problem import StandTargets, feet_centre, remove_penetration
from pupper_analysis.stance.task import StandTask
from pupper_analysis.statics.contacts import list_grips, prescribed_forces
from pupper_analysis.statics.equilibrium import GravityCompensation
from pupper_analysis.statics.support_polygon import support_corners

_ERROR_BY_CONSTRAINT = {
    "base-orientation": "orientation_error",
    "base-height": "height_error",
    "com-place": "com_error",
    "base-place": "com_error",
}
"""{name of a constraint: attribute of `Stand` that contains its violation}. The violations of other
constraints, except clearances and the CoM margin, are in ``foot_error``."""


_UNPICKLED_ATTRIBUTES = ("_statics", "_robot")
"""Attributes of a stand that are not pickled: a robot is large, and statics are fast to compute."""


@runtime_checkable
class Posed(Protocol):
    """Result that contains a configuration, for example a `Stand` or a ``SolvedPosture``."""

    @property
    def qpos(self) -> Array:
        """Configuration, shape (nq,)."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Stand(Pictured, Tabular):
    """Stand of a task, or the best failure of a search if ``solved`` is False.

    A stand without feet is, for example, a posture of a robot with a fixed base (``held_stand``).

    Attributes:
        task: Task, with height and CoM filled in.
        qpos: Configuration, shape (nq,).
        foot_targets: {contact point: target of the centre of the sphere, shape (3,) (m)}.
        depths: {stance point: penetration of the ground (m)}; 0 on rigid ground.
        stance_feet: Contact points that carry load; a sole has several.
        normals: {stance point: unit normal out of the ground, shape (3,)}.
        contact_points: {stance point: position of the contact, shape (3,) (m)}.
        foot_error: Largest of several errors (m or rad): distances of the contact points from the
            targets, deviations of closed loops and joint couplings, violations of joint limits with
            margin, and violations for which this class has no other attribute.
        orientation_error: Angle between the base's orientation and the task's (rad).
        height_error: Error of the height of the base frame (m).
        com_error: Horizontal error of the CoM (m). If the task has an offset, or the robot is an
            arm and ``com`` is no point, the horizontal error of the base frame (m). Otherwise zero
            if the CoM is free.
        com_margin: Distance of the projected CoM from the edge of the support polygon (m), negative
            outside. Infinite for a welded robot, and for a posture of a robot with a fixed base.
        ground_clearance: Height of the lowest part except the feet above the ground, for MuJoCo's
            collision shapes with convex hulls of meshes. None without such parts or without ground.
        self_clearance: Smallest distance between links that are not neighbours; None if the task
            requires none.
        iterations: Number of solved or attempted quadratic programs.
        robot: ``fingerprint`` of the robot.
    """

    _key_fields: ClassVar[tuple[str, ...]] = (
        "solved",
        "foot_error",
        "height_error",
        "com_error",
        "com_margin",
    )
    _units_of_columns: ClassVar[dict[str, str]] = {"x": "m", "y": "m", "z": "m", "depth": "m"}
    _warnings: ClassVar[tuple[str, ...]] = ("blocked",)

    task: StandTask
    qpos: Array = field(metadata={"unit": "m, 1 (quaternion) and rad"})
    foot_targets: dict[str, Array] = field(default_factory=dict, metadata={"unit": "m"})
    depths: dict[str, float] = field(default_factory=dict, metadata={"unit": "m"})
    stance_feet: tuple[str, ...] = ()
    normals: dict[str, Array] = field(default_factory=dict, metadata={"unit": "1"})
    contact_points: dict[str, Array] = field(default_factory=dict, metadata={"unit": "m"})
    foot_error: float = field(default=0.0, metadata={"unit": "m or rad"})
    orientation_error: float = field(default=0.0, metadata={"unit": "rad"})
    height_error: float = field(default=0.0, metadata={"unit": "m"})
    com_error: float = field(default=0.0, metadata={"unit": "m"})
    com_margin: float = field(default=math.inf, metadata={"unit": "m"})
    ground_clearance: Clearance | None = None
    self_clearance: Clearance | None = None
    iterations: int = 0
    robot: str

    def __getstate__(self) -> dict[str, Any]:
        return {
            name: value for name, value in vars(self).items() if name not in _UNPICKLED_ATTRIBUTES
        }

    @cached_property
    def _statics(self) -> list[tuple[ref[Robot], str, GravityCompensation]]:
        """Cached statics, each a tuple (weak reference to the robot, force criterion, result)."""
        return []

    def cached_statics(
        self, robot: Robot, distribution: str, compute: Callable[[], GravityCompensation]
    ) -> GravityCompensation:
        """Return the static equilibrium of this stand from the cache; compute it if missing.

        Args:
            robot: Robot with the masses and limits; compared by identity.
            distribution: Criterion that selects the contact forces.
            compute: Function that computes the equilibrium.
        """
        for owner, criterion, statics in self._statics:
            if owner() is robot and criterion == distribution:
                return statics
        self._statics.append((ref(robot), distribution, compute()))
        return self._statics[-1][2]

    def _columns(self) -> dict[str, Any]:
        """Return {column: values} of a table with one row per contact point (lengths in m)."""
        feet = list(self.foot_targets)
        places = np.array([self.foot_targets[foot] for foot in feet]).reshape(-1, 3)
        return {
            "foot": feet,
            **{axis: places[:, index] for index, axis in enumerate("xyz")},
            "carries": [foot in self.stance_feet for foot in feet],
            "depth": [self.depths.get(foot, 0.0) for foot in feet],
        }

    def lift_directions(self, robot: Robot) -> dict[str, Array]:
        """Return the direction in which each stance foot and contact point leaves the ground.

        Returns:
            {foot or contact point: unit vector, shape (3,), in the world frame}: upward, or the
            outward normal of a separate plane, such as a wall.
        """
        apart, found = self.task.ground.planes, dict[str, Array]()
        for foot in robot.feet_with(self.stance_feet):
            points = robot.feet[foot]
            out = self.normals[points[0]] if foot in apart else UP
            found |= dict.fromkeys((foot, *points), out)
        return found

    def centre(self, robot: Robot) -> Array:
        """Return the mean position (3,) [m] of the stance feet's contacts in the world frame.

        `StandTargets.centre` and `feet_centre` describe the exceptions, such as hands.
        """
        return feet_centre(robot, self.task.ground, self.contact_points, self.foot_targets)

    def base_drop(self, robot: Robot, drops: Mapping[str, Array]) -> float:
        """Return the height loss of the base [m] that displacements of the stance feet cause.

        A plane is fitted to the vertical displacements, and evaluated at the base. Feet on separate
        planes, such as walls, are left out if possible. A base that is fixed or welded loses no
        height: there the legs follow the displacements of the feet.

        Args:
            robot: Robot.
            drops: {contact point: displacement, shape (3,) [m], in the world frame}. The
                displacement is target minus position: positive z if the point has sunk.
        """
        apart = self.task.ground.planes
        own = [foot for foot in drops if not apart or robot.foot_of(foot) not in apart] or [*drops]
        places = np.array([(1.0, *self.foot_targets[foot][:2]) for foot in own])
        if not own or robot.is_base_fixed:
            return 0.0
        plane = np.linalg.lstsq(places, np.array([drops[foot][2] for foot in own]))[0]
        return float(plane @ (1.0, self.qpos[0], self.qpos[1]))

    def corners(self, robot: Robot) -> Array:
        """Return points (n, 2) [m], world frame, whose convex hull is this stand's support region.

        Welds are ignored. Shape (0,) without points.
        """
        points = np.array([*self.contact_points.values()])
        normals = np.array([*self.normals.values()])
        friction = [
            robot.contacts[foot].sliding_friction for foot in self.normals if robot.contacts
        ]
        stated = prescribed_forces(robot, self.stance_feet)
        held = list_grips(robot, self.foot_targets) if robot.grips else None
        return np.array(support_corners(points, normals, friction, stated, held))

    @property
    def rigid_targets(self) -> Mapping[str, Array]:
        """Targets of the contact points, to place the ground under the feet.

        {contact point: target of the sphere centre, shape (3,) [m], in the world frame}. If feet
        have separate planes, the targets are those without penetration (`remove_penetration`).
        """
        return remove_penetration(self.task.ground, self.foot_targets, self.depths, self.normals)

    @check_arguments
    def for_task(self, task: StandTask) -> Stand:
        """Return a copy of this stand with a new task, without a check that the stand satisfies it.

        The copy keeps the ground of this stand, which includes the planes of the contacts.
        """
        other = replace(
            self, task=task.replace_unchecked(ground=self.task.ground)
        )  # the ground includes planes of feet
        other._statics.extend(self._statics)
        attach_robot(other, vars(self).get("_robot"))
        return other

    @property
    def blocked(self) -> tuple[Diagnostic, ...]:
        """Messages about constraints (CoM margin, clearances) that this stand violates."""
        violations = []
        if self.com_shortfall > TASK_TOLERANCE:
            violations.append(
                diagnose(
                    "com-lies-inside" if self.com_margin >= 0 else "com-lies-outside",
                    distance=Quantity(abs(self.com_margin), "m"),
                )
            )
        for near, least in self._list_clearances():
            if near.distance < least - CLEARANCE_TOLERANCE:
                violations.append(_describe_clearance(near, self.task.ground))
        return tuple(violations)

    def _list_clearances(self) -> Iterator[tuple[Clearance, float]]:
        """Yield (measured clearance, required minimum [m]): to the ground, between links."""
        if self.ground_clearance is not None:
            yield self.ground_clearance, self.task.ground_clearance
        if self.self_clearance is not None:
            yield self.self_clearance, self.task.self_clearance or 0.0

    @property
    def com_shortfall(self) -> float:
        """Required CoM margin minus the actual margin [m], at least 0.

        Also 0 if the task has an ``offset`` of the base and no margin: the task then prescribes the
        position of the base, not of the CoM.
        """
        if self.task.offset is not None and self.task.com_margin == 0.0:
            return 0.0
        return max(0.0, self.task.com_margin - self.com_margin)

    @property
    def constraint_slack(self) -> float:
        """Smallest excess of CoM margin and clearances over required values [m], at most 0."""
        slacks = (near.distance - least for near, least in self._list_clearances())
        return min([-self.com_shortfall, *slacks])

    @property
    def solved(self) -> bool:
        """Whether the stand was found: feet at their targets, loops closed, and joint limits kept.

        Clearances and the CoM margin are kept, too. The errors of base orientation, base height and
        CoM are not tested.
        """
        return self.foot_error < TASK_TOLERANCE and not self.blocked

    def check(self, robot: Robot) -> Robot:
        """Check that this stand belongs to a robot; return the robot with the contacts of the task.

        Raises:
            ConfigurationError: If the stand belongs to another robot, for example.
            UnknownNameError: If the robot lacks the foot or frame of a contact of the task.
            ModelError: If the model with the contacts cannot be built.
        """
        if self.robot.rpartition(" ")[2] != robot.fingerprint.rpartition(" ")[2]:
            owner = self.robot.rpartition(" ")[0]
            problem = diagnose("stand-of-another-robot", whose=owner, robot=robot.name)
            raise ConfigurationError("stand", problem)
        return with_contacts(robot, self.task.contacts)

    def joint_positions(self, robot: Robot) -> Array:
        """Return the joint positions of this stand in actuator order, shape (nu,) [rad, m]."""
        return self.qpos[robot.nq - robot.nu :]

    @check_arguments
    def with_robot(self, robot: Robot) -> Stand:
        """Return a copy of this stand that references a robot, as `ctrl` and `q_pin` require.

        `solve_stand` returns such a stand. A stand from another process references no robot.

        Raises:
            ConfigurationError: If the stand belongs to another robot, for example.
            UnknownNameError: If the robot lacks the foot or frame of a contact of the task.
            ModelError: If the model with the contacts cannot be built.
        """
        self.check(robot)
        copy = replace(self)
        copy._statics.extend(self._statics)
        return attach_robot(copy, robot)

    @property
    def own_robot(self) -> Robot | None:
        """Robot that the stand references; None, for example, for a stand from another process."""
        robot: Robot | None = vars(self).get("_robot")
        return robot

    def _require_robot(self) -> Robot:
        """Return the robot that this stand references, with the contacts of the task."""
        robot = self.own_robot
        if robot is None:
            owner = self.robot.rpartition(" ")[0]
            raise ConfigurationError("stand", diagnose("stand-without-robot", robot=owner))
        return self.check(robot)

    @property
    def q_pin(self) -> Array:
        """Configuration of this stand in Pinocchio's convention, shape (pin_model.nq,).

        Raises:
            ConfigurationError: If the stand references no robot (see `with_robot`), for example.
            UnknownNameError: If the robot lacks the foot or frame of a contact of the task.
            ModelError: If the model with the contacts cannot be built.
        """
        return self._require_robot().to_pinocchio(self.qpos)

    @property
    def ctrl(self) -> Array:
        """Servo commands of ``robot.mj_model`` that hold the stand, shape (mj_model.nu,).

        The command of a position servo at a joint contains the joint torque as feed-forward: gear
        (q* + tau / kp). Other actuators, for example on tendons, are commanded not to exert a force
        (`Servos.command`). MuJoCo clips commands to ``ctrlrange``.

        Raises:
            ConfigurationError: If the stand references no robot (see `with_robot`), or the friction
                of the ground is unknown, for example.
            UnknownNameError: If the robot lacks the foot or frame of a contact of the task.
            ModelError: If a joint has no position servo, for example.
            StaticsInfeasibleError: If no contact forces balance the stand.
        """
        from pupper_analysis.robot.servos import model_with_servos
        from pupper_analysis.stance.stand import stand_statics

        robot = self._require_robot()
        torques = stand_statics(robot, self).joint_torques
        return model_with_servos(robot).command(robot, self.joint_positions(robot), torques)


def attach_robot(stand: Stand, robot: Robot | None) -> Stand:
    """Set the robot to which a new stand refers (None: no robot) in place; return the stand."""
    vars(stand)["_robot"] = robot
    return stand


def _describe_clearance(near: Clearance, ground: Ground) -> Diagnostic:
    """Create the message about a violated clearance; ``ground`` is the ground of the task."""
    overlaps, link = near.distance < 0, ("link", near.links[0])
    distance = Quantity(abs(near.distance), "m")
    if len(near.links) == 1:
        return diagnose(
            "part-in-ground" if overlaps else "part-above-ground",
            subject=link,
            distance=distance,
            surface=ground.describe_surface(near.surface),
        )
    return diagnose(
        "links-overlap" if overlaps else "links-too-near",
        subject=link,
        distance=distance,
        other=near.links[1],
    )


def evaluate_stand(
    shapes: ClearanceShapes, targets: StandTargets, qpos: ArrayLike, iterations: int
) -> Stand:
    """Create the `Stand` of a configuration: compute errors [m, rad] for a task, and clearances.

    Args:
        shapes: Robot with collision shapes.
        targets: Targets and limits of the stand (`StandTargets`).
        qpos: Configuration, shape (nq,).
        iterations: Number of solved or attempted quadratic programs.

    Raises:
        ConfigurationError: If the task requires a clearance that does not exist, for example
            because the model has no ground.
    """
    robot, task = shapes.robot, targets.task
    at = shapes.move_to(qpos)
    missed, com_margin, near = evaluate_constraints(shapes, targets, at)
    errors = dict.fromkeys(("foot_error", *_ERROR_BY_CONSTRAINT.values()), 0.0)
    for constraint, by in missed.items():
        error = _ERROR_BY_CONSTRAINT.get(constraint, "foot_error")
        errors[error] = max(errors[error], by)
    ground, apart = near["ground-clearance"], near.get("self-clearance")
    if ground is None and task.ground_clearance > 0.0:
        raise ConfigurationError(
            "ground_clearance", diagnose("nothing-above-ground", robot=robot.name)
        )
    if apart is None and task.self_clearance is not None:
        raise ConfigurationError("self_clearance", diagnose("no-links-apart", robot=robot.name))
    return Stand(
        task=task,
        qpos=at.qpos,
        foot_targets=targets.foot_targets,
        depths=targets.depths,
        stance_feet=targets.stance_feet,
        normals=targets.normals,
        contact_points=targets.contact_by_foot,
        **errors,
        com_margin=com_margin,
        ground_clearance=ground,
        self_clearance=apart,
        iterations=iterations,
        robot=robot.fingerprint,
    )


def is_base_in_ground(shapes: ClearanceShapes, targets: StandTargets) -> bool:
    """Return True if the required base height and orientation violate the ground clearance.

    Shapes of the base link, and of links that are fixed to the base, are tested on level ground.
    False on slopes, and for robots with a weld or grip.
    """
    if targets.task.ground.slope or shapes.robot.fixed_parts:
        return False
    qpos = shapes.robot.home.copy()
    qpos[:7] = 0.0, 0.0, targets.height, *targets.base_quaternion
    heights = shapes.measure_part_heights(shapes.move_to(qpos), Ground(), {}, targets.depths)
    parts = zip(heights, shapes.parts, strict=True)
    own = [height for height, part in parts if not part.shape.joint]
    return min(own, default=math.inf) < targets.task.ground_clearance - CLEARANCE_TOLERANCE
