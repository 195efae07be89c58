"""A stand, judged: Pinocchio's errors of a configuration, and how near its parts come."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any
from weakref import ref

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.base.results import Tabular
from pupper_analysis.robot.configuration import UP
from pupper_analysis.robot.ground import Ground
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.touching import touching
from pupper_analysis.stance.clearance import Clearance, ClearanceShapes
from pupper_analysis.stance.constraints import (
    CLEARANCE_TOLERANCE,
    TASK_TOLERANCE,
    evaluate_constraints,
)
from pupper_analysis.stance.problem import Goal, feet_centre, raise_feet
from pupper_analysis.stance.task import StandTask
from pupper_analysis.statics.contacts import gripped_places, stated_forces
from pupper_analysis.statics.equilibrium import GravityCompensation
from pupper_analysis.statics.support_polygon import support_corners

Array = NDArray[np.float64]

_ERRORS = {
    "base-orientation": "orientation_error",
    "base-height": "height_error",
    "com-place": "com_error",
    "base-place": "com_error",
}
"""{constraint: the error of a stand by which it is missed}; by all others it is ``foot_error``."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Stand(Tabular):
    """A solved stand. Its errors are Pinocchio's, computed anew from ``qpos``.

    On no feet it is a posture of a robot whose base is fixed (``held_stand``).

    Attributes:
        task: The task, with its height and com filled in.
        qpos: (nq,) the configuration.
        foot_targets: {foot: (3,)} where the centre of each foot's sphere shall be (m).
        depths: {foot that carries: how deep it has sunk into the ground (m)}; 0 on rigid ground.
        stance_feet: The feet that carry.
        normals: {foot that carries: (3,) direction out of the ground}.
        contact_points: {foot that carries: (3,) where it touches the ground (m)}.
        foot_error: The largest distance of a foot from its target (m), or by how much a closed loop
            or a coupling of joints is open, a joint is beyond its limit less the task's margin, or
            something else is missed that has no error of its own, if that is more (m, rad).
        orientation_error: Angle between the base's orientation and the task's (rad).
        height_error: Of the base frame (m).
        com_error: Horizontal distance of the com from where it shall be (m); with an offset, of the
            base frame. Of a com that may be anywhere inside, zero.
        com_margin: Distance of the com's projection from the support polygon's edge (m); negative
            outside.
        ground_clearance: How high the lowest part other than the feet is above the ground, by the
            shapes that MuJoCo lets touch it, of meshes the convex hulls; None if there are none.
        self_clearance: The least distance between links that are not neighbours; None if it was
            not asked for.
        iterations: Quadratic programmes solved.
        robot: Whose stand it is: the ``fingerprint`` of the robot.
    """

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
        return {name: value for name, value in vars(self).items() if name != "_statics"}

    @cached_property
    def _statics(self) -> list[tuple[ref[Robot], str, GravityCompensation]]:
        return []

    def cached_statics(
        self, robot: Robot, distribution: str, compute: Callable[[], GravityCompensation]
    ) -> GravityCompensation:
        """Return the statics of this stand, computed at the first call for the same arguments.

        Args:
            robot: The robot whose masses and limits count; compared by identity.
            distribution: The criterion that selects the contact forces.
            compute: Computes the statics.
        """
        for whose, criterion, statics in self._statics:
            if whose() is robot and criterion == distribution:
                return statics
        self._statics.append((ref(robot), distribution, compute()))
        return self._statics[-1][2]

    def _columns(self) -> dict[str, Any]:
        """One row per foot: where its sphere's centre shall be (m), if it carries, how deep (m)."""
        feet = list(self.foot_targets)
        places = np.array([self.foot_targets[foot] for foot in feet]).reshape(-1, 3)
        return {
            "foot": feet,
            **{axis: places[:, index] for index, axis in enumerate("xyz")},
            "carries": [foot in self.stance_feet for foot in feet],
            "depth": [self.depths.get(foot, 0.0) for foot in feet],
        }

    def lift_directions(self, robot: Robot) -> dict[str, Array]:
        """Returns {foot, and contact point, that carries: (3,) which way it lifts}.

        Up, but from a plane of its own.
        """
        apart, found = self.task.ground.planes, dict[str, Array]()
        for foot in robot.feet_with(self.stance_feet):
            points = robot.feet[foot]
            out = self.normals[points[0]] if foot in apart else UP
            found |= dict.fromkeys((foot, *points), out)
        return found

    def centre(self, robot: Robot) -> Array:
        """Returns the centre (3,) of the feet that carry, without hands (m)."""
        return feet_centre(robot, self.task.ground, self.contact_points, self.foot_targets)

    def base_drop(self, robot: Robot, drops: Mapping[str, Array]) -> float:
        """Returns by how much feet that are (3,) lower than they should be lower the base (m).

        Those on planes of their own count only if there are no others.
        """
        apart = self.task.ground.planes
        own = [foot for foot in drops if not apart or robot.foot_of(foot) not in apart] or [*drops]
        places = np.array([(1.0, *self.foot_targets[foot][:2]) for foot in own])
        if not own:
            return 0.0
        plane = np.linalg.lstsq(places, np.array([drops[foot][2] for foot in own]))[0]
        return float(plane @ (1.0, self.qpos[0], self.qpos[1]))

    def corners(self, robot: Robot) -> Array:
        """Returns the corners (n, 2) of where its com is in balance, seen from above (m)."""
        points = np.array([*self.contact_points.values()])
        normals = np.array([*self.normals.values()])
        friction = [robot.contacts[one].sliding_friction for one in self.normals if robot.contacts]
        stated = stated_forces(robot, self.stance_feet)
        held = gripped_places(robot, self.foot_targets) if robot.grips else None
        return np.array(support_corners(points, normals, friction, stated, held))

    @property
    def rigid_targets(self) -> Mapping[str, Array]:
        """Where the feet's centres (3,) are on rigid ground (m): over the middle of their steps."""
        return raise_feet(self.task.ground, self.foot_targets, self.depths, self.normals)

    def for_task(self, task: StandTask) -> Stand:
        """Returns the same stand as that of another task, which it satisfies as well."""
        other = replace(
            self, task=task.replace_unchecked(ground=self.task.ground)
        )  # with its planes
        other._statics.extend(self._statics)
        return other

    @property
    def blocked(self) -> tuple[Diagnostic, ...]:
        """What comes nearer to the ground, to another link or to tipping than the task allows."""
        found = []
        if self.com_shortfall > TASK_TOLERANCE:
            found.append(
                diagnose(
                    "com-lies-inside" if self.com_margin >= 0 else "com-lies-outside",
                    distance=Quantity(abs(self.com_margin), "m"),
                )
            )
        for near, least in self._clearances():
            if near.distance < least - CLEARANCE_TOLERANCE:
                found.append(_describe_clearance(near))
        return tuple(found)

    def _clearances(self) -> Iterator[tuple[Clearance, float]]:
        """Yields what is near, and the least distance that is asked (m)."""
        if self.ground_clearance is not None:
            yield self.ground_clearance, self.task.ground_clearance
        if self.self_clearance is not None:
            yield self.self_clearance, self.task.self_clearance or 0.0

    @property
    def com_shortfall(self) -> float:
        """How much nearer than asked the com is to the support polygon's edge (m).

        With an offset and no margin that was asked for the com is a result.
        """
        if self.task.offset is not None and self.task.com_margin == 0.0:
            return 0.0
        return max(0.0, self.task.com_margin - self.com_margin)

    @property
    def constraint_slack(self) -> float:
        """How much nearer than allowed anything is, negative (m)."""
        rooms = (near.distance - least for near, least in self._clearances())
        return min([-self.com_shortfall, *rooms])

    @property
    def solved(self) -> bool:
        """Whether the feet are where they shall be, and nothing is in the way."""
        return self.foot_error < TASK_TOLERANCE and not self.blocked

    def check(self, robot: Robot) -> Robot:
        """Checks that it is a robot's stand, and returns the robot with its task's contacts.

        Raises:
            ConfigurationError: If it is another robot's.
        """
        if self.robot.rpartition(" ")[2] != robot.fingerprint.rpartition(" ")[2]:
            whose = self.robot.rpartition(" ")[0]
            problem = diagnose("stand-of-another-robot", whose=whose, robot=robot.name)
            raise ConfigurationError("stand", problem)
        return touching(robot, self.task.contacts)

    def joint_positions(self, robot: Robot) -> Array:
        """Returns the joints' part (nu,) of ``qpos`` (rad)."""
        return self.qpos[robot.nq - robot.nu :]


def _describe_clearance(near: Clearance) -> Diagnostic:
    """Tells how near a part is to the ground, or two links are to each other."""
    overlaps, link = near.distance < 0, ("link", near.links[0])
    distance = Quantity(abs(near.distance), "m")
    if len(near.links) == 1:
        return diagnose(
            "part-in-ground" if overlaps else "part-above-ground", subject=link, distance=distance
        )
    return diagnose(
        "links-overlap" if overlaps else "links-too-near",
        subject=link,
        distance=distance,
        other=near.links[1],
    )


def evaluate_stand(shapes: ClearanceShapes, goal: Goal, qpos: ArrayLike, iterations: int) -> Stand:
    """Returns the stand at a configuration, with its errors and clearances.

    Args:
        shapes: The robot with its shapes.
        goal: What is asked of the stand.
        qpos: (nq,) the configuration.
        iterations: Quadratic programmes that it took.

    Raises:
        ConfigurationError: If the task demands a clearance and nothing has one.
    """
    robot, task = shapes.robot, goal.task
    at = shapes.move_to(qpos)
    missed, com_margin, near = evaluate_constraints(shapes, goal, at)
    errors = dict.fromkeys(("foot_error", *_ERRORS.values()), 0.0)
    for constraint, by in missed.items():
        error = _ERRORS.get(constraint, "foot_error")
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
        foot_targets=goal.targets,
        depths=goal.depths,
        stance_feet=goal.stance_feet,
        normals=goal.normals,
        contact_points=goal.contact_by_foot,
        **errors,
        com_margin=com_margin,
        ground_clearance=ground,
        self_clearance=apart,
        iterations=iterations,
        robot=robot.fingerprint,
    )


def is_base_in_ground(shapes: ClearanceShapes, goal: Goal) -> bool:
    """Tells whether a part of the base is too low in every stand: a proof, which costs no search.

    Its turn and height are given; and above ground without slope that is all that counts, as steps
    are put on a plane that stays.
    """
    if goal.task.ground.slope or shapes.robot.welds:
        return False
    qpos = shapes.robot.home.copy()
    qpos[:7] = 0.0, 0.0, goal.height, *goal.base_quaternion
    heights = shapes.part_heights(shapes.move_to(qpos), Ground(), {}, goal.depths)
    own = [one for one, part in zip(heights, shapes.parts, strict=True) if not part.shape.joint]
    return min(own, default=math.inf) < goal.task.ground_clearance - CLEARANCE_TOLERANCE
