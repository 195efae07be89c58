"""Which number matters most: Sobol's indices from samples, and shares from derivatives."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.base.arguments import check_type
from pupper_analysis.base.diagnostics import Term, diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.base.results import Result
from pupper_analysis.robot.configuration import UP, Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.tool import Place, find_place
from pupper_analysis.stance.sag.equilibrium import SagEquilibrium
from pupper_analysis.stance.sag.steady_state import steady_state
from pupper_analysis.stance.stand import Stand, stand_statics
from pupper_analysis.statics.support_polygon import interpolate_drop
from pupper_analysis.tools.study.design import Maker
from pupper_analysis.tools.study.parameters import AXES, Named, joints_of
from pupper_analysis.tools.study.running import Progress
from pupper_analysis.tools.study.store import require_library
from pupper_analysis.tools.study.study import DesignStudy
from pupper_analysis.tools.study.variables import Normal, Variable, at_shares

Array = NDArray[np.float64]

AT_REST = ("base_height", "sag", "servo_sag", "contact_sag")
"""Measures of where it rests that have derivatives; ``torque.JOINT`` are the others."""


@dataclass(frozen=True)
class SobolIndices(Result):
    """Whose variance is whose, of one metric.

    Attributes:
        metric: Its column.
        first: {variable: share of the variance that it makes alone}.
        total: {variable: the same with all that it makes together with others}.
        uncertainty: {variable: half of the 95 % confidence interval of ``total``}.
        designs: How many were measured.
    """

    metric: str
    first: dict[str, float]
    total: dict[str, float]
    uncertainty: dict[str, float]
    designs: int


@dataclass(frozen=True)
class LinearShares(Result):
    """The same from derivatives, for small spreads.

    Attributes:
        metric: Its column.
        derivatives: {variable: change of the metric per unit of it}.
        shares: {variable: share of the variance}.
        deviation: Standard deviation of the metric.
    """

    metric: str
    derivatives: dict[str, float]
    shares: dict[str, float]
    deviation: float


def sobol_indices(
    study: DesignStudy,
    folder: str | Path,
    metrics: Sequence[str],
    *,
    samples: int = 128,
    executor: Executor | None = None,
    workers: int | None = None,
    progress: Callable[[Progress], None] | None = None,
) -> dict[str, SobolIndices]:
    """Measures designs by Saltelli's scheme, and takes the variance of metrics apart.

    Designs are kept in the study's folder, as those of ``Study.run``, and go on there.

    Source: Saltelli et al., "Variance based sensitivity analysis of model output", 2010; SALib.

    Args:
        study: Its variables' distributions count, not its samples.
        folder: Where results are kept.
        metrics: Columns of its table.
        samples: A power of 2; designs are this times the number of variables and two.
        executor: As in ``Study.run``.
        workers: Likewise.
        progress: Likewise.

    Returns:
        {metric: its indices}.

    Raises:
        ConfigurationError: If a column is not there, a design failed (indices need them all), or
            an argument makes no sense.
        StudyError: As ``Study.run``.
    """
    check_type("study", study, DesignStudy)
    check_type("metrics", metrics, Sequence[str])
    check_type("samples", samples, int)
    if samples < 2 or samples & (samples - 1):
        raise ConfigurationError("samples", diagnose("no-power-of-2", count=samples))
    if not study.variables:
        raise ConfigurationError("vary", diagnose("nothing-varies"))
    require_library("SALib")
    from SALib.analyze import sobol as analysis
    from SALib.sample import sobol as scheme

    names = list(study.variables)
    problem = {"num_vars": len(names), "names": names, "bounds": [[0.0, 1.0]] * len(names)}
    seed = study.sampling.seed % 2**31 + 1  # SALib takes 0 for none
    shares = scheme.sample(problem, samples, calc_second_order=False, seed=seed)
    points = at_shares(study.variables, np.asarray(shares, dtype=float))
    chosen = study.at(points)
    table = chosen.run(folder, executor=executor, workers=workers, progress=progress)
    place = {name: index for index, name in enumerate(table["design"])}
    order = [place[name] for block, _ in chosen.designs() for name in block]
    found = {}
    for metric in metrics:
        if metric not in table:
            told = diagnose("none-of", value=metric, known=table.columns)
            raise ConfigurationError("metrics", told)
        values = table[metric].to_numpy(float)[order]
        lost = int((~np.isfinite(values)).sum())
        if lost:
            told = diagnose(
                "designs-without-metric",
                lost=lost,
                designs=len(values),
                metric=metric,
                reasons=[Term(str(kind)) for kind in table["failure"].dropna().unique()],
            )
            raise ConfigurationError("vary", told)
        index = analysis.analyze(problem, values, calc_second_order=False, seed=seed)
        found[metric] = SobolIndices(
            metric,
            dict(zip(names, index["S1"].tolist(), strict=True)),
            dict(zip(names, index["ST"].tolist(), strict=True)),
            dict(zip(names, index["ST_conf"].tolist(), strict=True)),
            len(values),
        )
    return found


def linear_shares(study: DesignStudy, metrics: Sequence[str]) -> dict[str, LinearShares]:
    """Predicts the same from derivatives at the variables' means: no samples.

    Independent variables of deviations s_i make a deviation of sqrt(sum (dy/dx_i s_i)^2).

    Args:
        study: Its variables are masses, coms (``com_x:PATTERN``), ``payload``, or, at rest,
            any.
        metrics: ``base_height``, ``sag``, ``servo_sag``, ``contact_sag`` and ``torque.JOINT``.

    Returns:
        {metric: its shares}.

    Raises:
        ConfigurationError: If a metric or a variable has no derivative, or the stand is not on
            level ground with the com over its centre.
    """
    check_type("study", study, DesignStudy)
    check_type("metrics", metrics, Sequence[str])
    means = {name: mean_of(one) for name, one in study.variables.items()}
    spread = {name: deviation_of(one) for name, one in study.variables.items()}
    maker = Maker(study.source, study.task, study.point)
    varied = [name for name, size in spread.items() if size > 0]
    joints = study.base.joint_names
    known = (*AT_REST, *(f"torque.{joint}" for joint in joints))
    unknown = next((name for name in metrics if name not in known), None)
    if unknown is not None:
        told = diagnose("none-of", value=unknown, known=known)
        raise ConfigurationError("metrics", told)
    slopes: dict[str, dict[str, float]] = {}
    if any(name in AT_REST for name in metrics):
        rest = sag_derivatives(maker, means, varied)
        slopes |= {m: {n: getattr(rest[n], m) for n in varied} for m in AT_REST}
    if any(name not in AT_REST for name in metrics):
        design = maker.design(means)
        moving = [name for name in varied if name.partition(":")[0] not in ("kp", "kd")]
        torque = torque_derivatives(design.robot, design.stand, means, moving, study.point)
        for row, joint in enumerate(joints):
            own = {n: float(torque[n][row]) if n in torque else 0.0 for n in varied}
            slopes[f"torque.{joint}"] = own
    return {name: _shares(name, slopes[name], spread) for name in metrics}


def _shares(name: str, slopes: dict[str, float], spread: Mapping[str, float]) -> LinearShares:
    parts = {number: (slope * spread[number]) ** 2 for number, slope in slopes.items()}
    whole = sum(parts.values())
    shares = {number: part / whole if whole else 0.0 for number, part in parts.items()}
    return LinearShares(name, slopes, shares, float(np.sqrt(whole)))


_EVEN = (np.arange(4096) + 0.5) / 4096


def mean_of(variable: Variable) -> float:
    """Returns the mean of a variable."""
    return variable.mean if isinstance(variable, Normal) else float(variable.at(_EVEN).mean())


def deviation_of(variable: Variable) -> float:
    """Returns the standard deviation of a variable."""
    return variable.deviation if isinstance(variable, Normal) else float(variable.at(_EVEN).std())


# How a stand's torques and sag change with a robot's numbers: derivatives, not differences.


_BASE = 1
"""The number of the joint that moves the base, of a robot whose base is free."""

_DIFFERENCE_STEP = 1e-5
"""Relative, of a number whose effect on the equations, not on their solution, is differenced."""


@dataclass(frozen=True)
class InertialRates:
    """How a number changes the inertial parameters of bodies.

    Attributes:
        change: (njoints - 1, 10) derivative of Pinocchio's dynamic parameters of each body.
        mass: Derivative of the total mass (kg).
        moment: (3,) derivative of mass x com, in the world (kg m).
    """

    change: Array
    mass: float
    moment: Array


def torque_derivatives(
    robot: Robot,
    stand: Stand,
    numbers: Mapping[str, float],
    wanted: Sequence[str],
    point: Place,
) -> dict[str, Array]:
    """Derives the motors' torques in a stand by masses, coms and payload, in closed form.

    With pi the inertial parameters, gravity is Y(q) pi (Pinocchio's regressor), and in balance
    tau = g - J^T f in the joints' rows. A number moves the com, and so the base, to keep it over
    the feet's centre: dq follows from the stand's own Jacobians, of feet, base and com. On level
    ground, the com being kept, all contact forces grow in proportion to the weight. So

        dtau = Y dpi + (dg/dq - d(J^T f)/dq) dq - J^T f dM / M.

    Source: Atkeson, An and Hollerbach, "Estimation of inertial parameters of manipulator loads and
    links", 1986, for the regressor.

    Args:
        robot: The robot.
        stand: Its stand, on level ground, with the com over the centre.
        numbers: Of the design: {number: its value}.
        wanted: The numbers by which: ``mass:PATTERN``, ``com_x:PATTERN``, ``payload``.
        point: Where a payload is (m); see ``find_place``.

    Returns:
        {number: (nu,) N m per factor, or per kg}.

    Raises:
        ConfigurationError: If a number is another one, or the stand is not such.
    """
    robot.check_tree("a linear share")
    task = stand.task
    if not task.ground.level or task.com != "centre" or task.offset is not None:
        raise ConfigurationError("stand", diagnose("derivatives-of-level-stands"))
    config, held = Configuration(robot, stand.qpos), stand_statics(robot, stand)
    feet = list(stand.stance_feet)
    forces = np.array([held.contact_forces[foot] for foot in feet])
    if (forces @ UP <= 0).any():
        raise ConfigurationError("stand", diagnose("unloaded-foot-may-carry"))
    centres = config.foot_positions()
    arms = np.array([held.contact_points[foot] - centres[foot] for foot in feet])
    wrenches = {
        foot: np.concatenate([force, np.cross(arm, force)])
        for foot, force, arm in zip(feet, forces, arms, strict=True)
    }
    rates = config.static_rates(wrenches)
    pushed = np.einsum("fij,fi->j", config.point_jacobians(feet, arms), forces)
    system = _stand_jacobian(config)
    regressor = _gravity_regressor(config)
    found = {}
    for name in wanted:
        inertial = _inertial(config, name, numbers, point)
        total = robot.total_mass
        com = (inertial.moment - config.center_of_mass() * inertial.mass) / total
        moved = np.linalg.solve(system, np.concatenate([np.zeros(len(system) - 2), -com[:2]]))
        torque = regressor @ inertial.change.ravel() + rates @ moved
        found[name] = (torque - pushed * inertial.mass / total)[6:]
    return found


def _stand_jacobian(config: Configuration) -> Array:
    """Returns the derivative (nv, nv) of what a stand fixes: feet, base's height and turn, com."""
    size = config.robot.nv
    feet = np.concatenate(list(config.foot_jacobians().values()))
    base = np.eye(4, size, 2)  # height, and the base's angular velocity
    return np.concatenate([feet, base, config.com_jacobian()[:2]])


def _gravity_regressor(config: Configuration) -> Array:
    """Returns Y (nv, 10 bodies): gravity is Y pi, in the public convention."""
    robot = config.robot
    model, q = robot.pin_model, robot.pin_convention.unit_q(config.qpos)
    still = np.zeros(model.nv)
    data = model.createData()
    own: Array = pin.computeJointTorqueRegressor(model, data, q, still, still)
    regressor: Array = robot.pin_convention.velocity_map(config.qpos).T @ own
    return regressor


def _inertial(
    config: Configuration, name: str, numbers: Mapping[str, float], point: Place
) -> InertialRates:
    robot, named = config.robot, Named.of(name)
    model, data = robot.pin_model, robot.pin_model.createData()
    pin.forwardKinematics(model, data, robot.pin_convention.unit_q(config.qpos))
    tool = find_place(robot, point)
    on = model.frames[model.getFrameId(tool.link, pin.FrameType.BODY)]
    load = on.placement.act(pin.Inertia(1.0, tool.offset, np.zeros((3, 3))))
    grown: list[tuple[int, float, pin.Inertia]] = []  # body, how many times, what
    if name == "payload":
        grown.append((on.parentJoint, 1.0, load))
    elif named is not None and named.kind == "mass":
        share = 1.0 / numbers[name]
        bodies = [model.getJointId(joint) if joint else _BASE for joint in joints_of(robot, named)]
        grown += [(body, share, model.inertias[body]) for body in bodies]
        if on.parentJoint in bodies:  # the payload is welded on when the factors have been applied
            grown.append((on.parentJoint, -share * numbers.get("payload", 0.0), load))
    elif named is None or named.kind not in ("inertia", *AXES):  # gravity sees no inertia
        raise ConfigurationError("vary", diagnose("no-derivative-of-torques", number=name))
    change = np.zeros((model.njoints - 1, 10))
    mass, moment = 0.0, np.zeros(3)
    if named is not None and named.kind in AXES:
        axis = np.eye(3)[AXES.index(named.kind)]
        for joint in joints_of(robot, named):
            body = model.getJointId(joint) if joint else _BASE
            own = float(model.inertias[body].mass)
            # Without the payload, which is welded on when coms have been moved.
            own -= numbers.get("payload", 0.0) if body == on.parentJoint else 0.0
            turn = (
                np.eye(3)
                if joint
                else model.frames[model.getFrameId(robot.base)].placement.rotation
            )
            change[body - 1, 1:4] += own * turn @ axis
            moment += own * data.oMi[body].rotation @ turn @ axis
    for body, times, inertia in grown:
        change[body - 1] += times * np.array(inertia.toDynamicParameters())
        mass += times * float(inertia.mass)
        moment += times * float(inertia.mass) * np.array(data.oMi[body].act(inertia.lever))
    return InertialRates(change, mass, moment)


@dataclass(frozen=True)
class LinearSag:
    """What changes at rest: of the height, and of the parts lost in servos and ground (m)."""

    base_height: float
    sag: float
    servo_sag: float
    contact_sag: float


def sag_derivatives(
    maker: Maker, numbers: Mapping[str, float], wanted: Sequence[str]
) -> dict[str, LinearSag]:
    """Derives where a robot comes to rest on its servos by its numbers.

    With F(z; p) = 0 the equations of the equilibrium, dz/dp = -(dF/dz)^-1 dF/dp. dF/dz is the
    equilibrium's own derivative, in closed form; dF/dp is a central difference of the equations at
    the solution, for the commanded pose, the contacts' softness and the weight: nothing is solved
    again but the stand.

    Args:
        maker: Makes the designs.
        numbers: Of the design about which it is derived.
        wanted: The numbers by which.

    Returns:
        {number: what changes, per unit of the number}.
    """
    design = maker.design(numbers)
    robot, stand = design.robot, design.stand
    robot.check_tree("a linear share")
    rest = steady_state(robot, stand)
    forces = _grounded(stand, rest.contact_forces, rest.stance_feet)
    system = SagEquilibrium(robot, stand, None, "pinned")
    derivative = system.derivative(rest.qpos, forces)
    found = {}
    for name in wanted:
        step = _DIFFERENCE_STEP * max(abs(numbers[name]), 1e-2)

        sides = [maker.design({**numbers, name: numbers[name] + way}) for way in (step, -step)]
        more, less = (
            SagEquilibrium(side.robot, side.stand, None, "pinned").residual(rest.qpos, forces)
            for side in sides
        )
        moved = -np.array(np.linalg.solve(derivative, (more - less) / (2 * step)), float)
        shift = (sides[0].stand.qpos - sides[1].stand.qpos)[:2] / (2 * step)
        at_rest = Configuration(robot, rest.qpos)
        found[name] = _sag(at_rest, stand, moved[: robot.nv], shift)
    return found


def _grounded(stand: Stand, forces: Mapping[str, Array], touching: Sequence[str]) -> Array:
    """Returns the forces (n, 3) on the feet, in the ground's frame: level."""
    if not stand.task.ground.level or tuple(touching) != tuple(
        foot for foot in forces if foot in stand.stance_feet
    ):
        raise ConfigurationError("stand", diagnose("derivatives-of-all-feet"))
    return np.array([forces[foot] for foot in stand.stance_feet])


def _sag(config: Configuration, stand: Stand, moved: Array, shift: Array) -> LinearSag:
    """Returns what changes of the heights at rest.

    Args:
        config: At rest.
        stand: The stand.
        moved: (nv,) how the equilibrium moves.
        shift: (2,) how the stand's base moves, under which the ground's part is taken (m).
    """
    targets = np.array([stand.foot_targets[foot] for foot in stand.stance_feet])
    jacobians, centres = config.foot_jacobians(), config.foot_positions()
    drops = np.array([stand.foot_targets[f][2] - centres[f][2] for f in stand.stance_feet])
    sunk = np.array([-jacobians[foot][2] @ moved for foot in stand.stance_feet])
    place = stand.qpos[:2]
    tilted = interpolate_drop(place + shift, targets, drops) - interpolate_drop(
        place, targets, drops
    )  # a plane
    contact = interpolate_drop(place, targets, sunk) + tilted
    loss = -float(moved[2])
    return LinearSag(-loss, loss, loss - contact, contact)
