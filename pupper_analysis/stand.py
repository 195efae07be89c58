"""How the robot can stand: a whole-body configuration with planted feet, solved by PlaCo."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from numbers import Real
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import placo
from numpy.typing import NDArray

from pupper_analysis.configuration import UP, Configuration
from pupper_analysis.errors import ConfigurationError, StanceUnreachableError
from pupper_analysis.results import Result
from pupper_analysis.robot import Robot

Array = NDArray[np.float64]

TASK_TOLERANCE = 1e-9
"""Error up to which a task counts as satisfied (m, rad)."""

_STEP_TOLERANCE = 1e-13
_MAX_ITERATIONS = 200
_TRUST_RADIUS = 0.5  # rad per joint and iteration


@dataclass(frozen=True)
class StandTask:
    """How the robot shall stand on level ground at z = 0.

    Every foot's sphere touches the ground where the foot is, seen from above, at zero angles with
    the base at the origin; the com is above the mean of the feet's positions; and the base has the
    orientation Rz(yaw) Ry(pitch) Rx(roll).

    Attributes:
        height: Of the base frame above the ground (m); the robot's ``stand_height`` by default.
        roll: About x, forward (rad).
        pitch: About y, left (rad); positive looks down.
        yaw: About z, up (rad), against the feet.
    """

    height: float | None = None
    roll: float = 0.0
    pitch: float = 0.0
    yaw: float = 0.0

    def __post_init__(self) -> None:
        for name in ("height", "roll", "pitch", "yaw"):
            value = getattr(self, name)
            if value is None and name == "height":
                continue
            if isinstance(value, bool) or not isinstance(value, Real):
                raise ConfigurationError(name, f"{value!r} is not a number")
            value = float(value)
            object.__setattr__(self, name, value)
            if not math.isfinite(value):
                raise ConfigurationError(name, f"{value} is not finite")
            if name == "height" and value <= 0:
                raise ConfigurationError(name, f"{value} m is not above the ground")
            if name != "height" and abs(value) > math.pi:
                raise ConfigurationError(name, f"{value} rad is not between -pi and pi")

    def rotation(self) -> Array:
        """Returns the base's rotation (3, 3) in the world."""
        rotation: Array = pin.rpy.rpyToMatrix(self.roll, self.pitch, self.yaw)
        return rotation

    def __str__(self) -> str:
        """Names the values, with units."""
        height = "" if self.height is None else f"height {self.height:.4f} m, "
        angles = (
            f"{name} {math.degrees(getattr(self, name)):.1f} deg"
            for name in ("roll", "pitch", "yaw")
        )
        return height + ", ".join(angles)


@dataclass(frozen=True, eq=False)
class Stand(Result):
    """A solved stand. Its errors are Pinocchio's, computed anew from ``qpos``.

    Attributes:
        task: The task, with its height filled in.
        qpos: (nq,) the configuration.
        foot_targets: {foot: (3,)} where the centre of each foot's sphere shall be (m).
        foot_error: The largest distance of a foot from its target (m).
        orientation_error: Angle between the base's orientation and the task's (rad).
        height_error: Of the base frame (m).
        com_error: Horizontal distance of the com from the mean of the feet (m).
        iterations: Quadratic programmes solved.
    """

    task: StandTask
    qpos: Array
    foot_targets: dict[str, Array]
    foot_error: float
    orientation_error: float
    height_error: float
    com_error: float
    iterations: int

    def joint_positions(self, robot: Robot) -> Array:
        """Returns the joints' part (nu,) of ``qpos`` (rad)."""
        return self.qpos[robot.nq - robot.nu :]


def solve_stand(robot: Robot, task: StandTask | None = None) -> Stand:
    """Finds the configuration that satisfies a stand task, within the joint limits.

    PlaCo solves a sequence of quadratic programmes on the floating base: the base's orientation
    and height and the com's place are hard constraints, which the free base can always satisfy;
    the feet are the objective, which vanishes if the stance is in reach.

    Args:
        robot: A robot with a floating base.
        task: How to stand; the nominal stand by default.

    Returns:
        The stand; every error is under 1e-9 m or rad.

    Raises:
        ConfigurationError: If the robot's base is fixed.
        StanceUnreachableError: If it is out of reach; names the feet and how far they miss.
    """
    if not robot.floating:
        raise ConfigurationError("robot", f"{robot.name} has a fixed base and cannot stand")
    if not robot.feet:
        raise ConfigurationError("robot", f"{robot.name} was loaded without feet and cannot stand")
    task = task or StandTask()
    if task.height is None:
        task = replace(task, height=robot.stand_height)
    assert task.height is not None
    targets = {
        foot: np.array([position[0], position[1], robot.foot_radius[foot]])
        for foot, position in Configuration(robot, robot.neutral()).foot_positions().items()
    }
    wrapper = placo.RobotWrapper("", placo.Flags.ignore_collisions, _bare_urdf(robot))
    best: Stand | None = None
    for start in _starts(robot):
        stand = _solve_from(robot, wrapper, task, targets, start)
        if stand.foot_error < TASK_TOLERANCE:
            return stand
        if best is None or stand.foot_error < best.foot_error:
            best = stand
    assert best is not None
    raise _unreachable(robot, _nearest(robot, best))


def _solve_from(
    robot: Robot,
    wrapper: placo.RobotWrapper,
    task: StandTask,
    targets: dict[str, Array],
    joints: Array,
) -> Stand:
    assert task.height is not None
    convention = robot.pin_convention
    centre = np.mean([target[:2] for target in targets.values()], axis=0)
    qpos = robot.neutral()
    qpos[:3] = (*centre, task.height)
    x, y, z, w = pin.Quaternion(task.rotation()).coeffs()
    qpos[3:7] = w, x, y, z
    qpos[7:] = joints
    wrapper.state.q = convention.q(qpos)
    wrapper.update_kinematics()

    solver = placo.KinematicsSolver(wrapper)
    solver.enable_joint_limits(True)
    wrapper.set_velocity_limits(1.0)
    solver.enable_velocity_limits(True)
    feet = []
    for foot, target in targets.items():
        feet.append(solver.add_position_task(robot.foot_frames[foot], target))
        feet[-1].configure(foot, "soft", 1.0)
    orientation = solver.add_orientation_task(robot.base, task.rotation())
    orientation.configure("orientation", "hard")
    height = solver.add_position_task(robot.base, task.height * UP)
    height.mask.set_axises("z")
    height.configure("height", "hard")
    com = solver.add_com_task(np.array([*centre, 0.0]))
    com.mask.set_axises("xy")
    com.configure("com", "hard")
    # Decides between configurations that place the feet equally well; too small to move a foot.
    solver.add_regularization_task(1e-9)

    # A trust region: where a step makes things worse it is undone, and the next one is shorter.
    radius, iterations = _TRUST_RADIUS, 0
    q = np.array(wrapper.state.q)
    error = math.inf
    while iterations < _MAX_ITERATIONS and radius > _STEP_TOLERANCE:
        iterations += 1
        solver.dt = radius
        step = solver.solve(True)
        wrapper.update_kinematics()
        new_error = sum(foot.error_norm() ** 2 for foot in feet) + com.error_norm() ** 2
        if new_error > error and new_error > TASK_TOLERANCE**2:
            radius /= 4
            wrapper.state.q = q
            wrapper.update_kinematics()
            continue
        error, q = new_error, np.array(wrapper.state.q)
        if np.abs(step).max() < _STEP_TOLERANCE:
            break
    return _measure(robot, task, convention.qpos(np.array(wrapper.state.q)), targets, iterations)


def _measure(
    robot: Robot, task: StandTask, qpos: Array, targets: dict[str, Array], iterations: int
) -> Stand:
    assert task.height is not None
    config = Configuration(robot, qpos)
    feet = config.foot_positions()
    centre = np.mean([target[:2] for target in targets.values()], axis=0)
    turn = task.rotation().T @ config.base_rotation()
    return Stand(
        task=task,
        qpos=config.qpos.copy(),
        foot_targets=targets,
        foot_error=max(float(np.linalg.norm(feet[foot] - targets[foot])) for foot in feet),
        orientation_error=float(np.linalg.norm(pin.log3(turn))),
        height_error=abs(float(config.qpos[2]) - task.height),
        com_error=float(np.linalg.norm(config.center_of_mass()[:2] - centre)),
        iterations=iterations,
    )


def _nearest(robot: Robot, best: Stand) -> Stand:
    """Finds how near the feet can come to targets that are out of reach.

    The sum of the squared distances is minimised over the base's place and the joints, inside their
    limits, with the base's orientation and height and the com's place as the task has them. PlaCo's
    Gauss-Newton steps, made for errors that vanish, stop short of that minimum.
    """
    from scipy import optimize  # slow to import

    centre = np.mean([target[:2] for target in best.foot_targets.values()], axis=0)
    free = [0, 1, *range(7, robot.nq)]
    columns = [0, 1, *range(6, robot.nv)]

    def at(values: Array) -> Configuration:
        qpos = best.qpos.copy()
        qpos[free] = values
        return Configuration(robot, qpos)

    def distances(values: Array) -> tuple[float, Array]:
        config = at(values)
        positions, jacobians = config.foot_positions(), config.foot_jacobians()
        total, gradient = 0.0, np.zeros(len(free))
        for foot, target in best.foot_targets.items():
            error = positions[foot] - target
            total += float(error @ error)
            gradient += 2 * error @ jacobians[foot][:, columns]
        return total, gradient

    limits = zip(robot.lower_limits, robot.upper_limits, strict=True)
    outcome = optimize.minimize(
        distances,
        best.qpos[free],
        jac=True,
        method="SLSQP",
        bounds=[(None, None), (None, None), *limits],
        constraints={
            "type": "eq",
            "fun": lambda values: at(values).center_of_mass()[:2] - centre,
            "jac": lambda values: at(values).com_jacobian()[:2, columns],
        },
        options={"ftol": 1e-14, "maxiter": 200},
    )
    stand = _measure(robot, best.task, at(outcome.x).qpos, best.foot_targets, best.iterations)
    return stand if stand.com_error < 1e-6 else best


def _starts(robot: Robot) -> Iterator[Array]:
    """Yields joint positions to start from: the home keyframe, then the middle of the limits."""
    lower, upper = robot.lower_limits, robot.upper_limits
    yield np.clip(robot.home[7:], lower, upper)
    bounded = np.isfinite(lower) & np.isfinite(upper)
    yield np.where(bounded, (np.where(bounded, lower, 0) + np.where(bounded, upper, 0)) / 2, 0.0)


def _unreachable(robot: Robot, best: Stand) -> StanceUnreachableError:
    feet = Configuration(robot, best.qpos).foot_positions()
    gaps = {foot: float(np.linalg.norm(feet[foot] - best.foot_targets[foot])) for foot in feet}
    joints = best.joint_positions(robot)
    at_limit: dict[str, float] = {}
    for limits in (robot.lower_limits, robot.upper_limits):
        for index in np.flatnonzero(np.abs(joints - limits) < 1e-6):
            at_limit[robot.joint_names[index]] = float(limits[index])
    missed = {foot: gap for foot, gap in gaps.items() if gap >= TASK_TOLERANCE}
    return StanceUnreachableError(str(best.task), missed, at_limit)


def _bare_urdf(robot: Robot) -> str:
    """Returns the URDF without its shapes, so that no mesh file is needed."""
    root = ElementTree.fromstring(robot.description.urdf)
    for link in root.iter("link"):
        for tag in ("visual", "collision"):
            for shape in link.findall(tag):
                link.remove(shape)
    return ElementTree.tostring(root, encoding="unicode")
