"""Maximum errors of `Configuration`: `python benchmarks/configuration_errors.py --table`.

Eight robots in 20 random states each: variants, a fixed base, and random robots with three to six
legs, slides, other joint orders and springs. References are raw Pinocchio (`robot.pin_model` with
its own coordinates) and MuJoCo. Errors are relative to the largest element of the reference, or to
1 if that is larger. `--table` writes docs/data/configuration-errors.csv.
"""

from __future__ import annotations

import itertools
import sys
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import click
import mujoco
import numpy as np
import pinocchio as pin
from tables import write_csv

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

import pupper_analysis as pa  # noqa: E402
from pupper_analysis.statics.polytope import MIN_LEVER_ARM  # noqa: E402
from tests.robot.test_configuration_analysis import (  # noqa: E402
    ODD,
    REFERENCES,
    STATES,
    compute_by_pinocchio,
    links,
    load_odd_robot,
    states,
)
from tests.statics.test_region import farthest_by_linear_programs  # noqa: E402
from tests.support.engines import addresses, evaluate_mujoco, with_efforts  # noqa: E402

Array = np.ndarray
Row = tuple[str, str, Array, Array]
"""Function, engine of the reference, value, reference."""


def compare_frames(config: pa.Configuration, mj: mujoco.MjData, offset: Array) -> Iterator[Row]:
    """Yield the Jacobians of all links, and their time derivatives, by both engines."""
    robot, (_, columns) = config.robot, addresses(config.robot)
    data, _, mapping, rate = compute_by_pinocchio(config)
    for name, body in links(robot):
        frame = robot.pin_model.getFrameId(name, pin.FrameType.BODY)
        for reference, constant in REFERENCES.items():
            jacobian = pin.getFrameJacobian(robot.pin_model, data, frame, constant)
            jacobian = jacobian.reshape(6, -1)
            variation = pin.getFrameJacobianTimeVariation(robot.pin_model, data, frame, constant)
            expected = variation.reshape(6, -1) @ mapping + jacobian @ rate
            mine = config.frame_jacobian(name, reference=reference)
            yield "frame_jacobian", "Pinocchio", mine, jacobian @ mapping
            mine = config.frame_jacobian_time_variation(name, reference=reference)
            yield "frame_jacobian_time_variation", "Pinocchio", mine, expected
        point, rows = config.frame_position(name) + offset, np.zeros((6, robot.mj_model.nv))
        mujoco.mj_jac(robot.mj_model, mj, rows[:3], rows[3:], point, body)
        yield "frame_jacobian", "MuJoCo", config.frame_jacobian(name, offset), rows[:, columns]
        joints = rows[:3, columns[robot.nv - robot.nu :]]
        volume = np.sqrt(max(0.0, np.linalg.det(joints @ joints.T)))
        measure = np.array(config.manipulability(name, offset))
        yield "manipulability", "MuJoCo", measure, np.array(volume)
        mujoco.mj_jacDot(robot.mj_model, mj, rows[:3], rows[3:], point, body)
        mine = config.frame_jacobian_time_variation(name, offset)
        yield "frame_jacobian_time_variation", "MuJoCo", mine, rows[:, columns]


def compare_dynamics(config: pa.Configuration, mj: mujoco.MjData) -> Iterator[Row]:
    """Yield mass matrix, bias forces, inverse dynamics and centroidal quantities."""
    robot, model = config.robot, config.robot.mj_model
    pin_model, (_, columns) = robot.pin_model, addresses(robot)
    _, q, mapping, rate = compute_by_pinocchio(config)
    velocity = mapping @ config.qvel
    qacc = np.linspace(-4, 4, robot.nv)
    upper = np.triu(pin.crba(pin_model, pin_model.createData(), q))
    inertia = upper + np.triu(upper, 1).T
    yield "mass_matrix", "Pinocchio", config.mass_matrix(), mapping.T @ inertia @ mapping
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, mj, full)
    yield "mass_matrix", "MuJoCo", config.mass_matrix(), full[np.ix_(columns, columns)]
    bias = pin.nonLinearEffects(pin_model, pin_model.createData(), q, velocity)
    expected = mapping.T @ (bias + inertia @ rate @ config.qvel)
    yield "bias_forces", "Pinocchio", config.bias_forces(), expected
    yield "bias_forces", "MuJoCo", config.bias_forces(), mj.qfrc_bias[columns]
    torques = config.joint_torque_regressor(qacc) @ config.dynamic_parameters()
    acceleration = mapping @ qacc + rate @ config.qvel
    forces = pin.rnea(pin_model, pin_model.createData(), q, velocity, acceleration)
    expected = mapping.T @ (forces - pin_model.armature * acceleration)
    yield "joint_torque_regressor", "Pinocchio", torques, expected
    mj.qacc[columns] = qacc
    theirs = np.zeros(model.nv)
    mujoco.mj_rne(model, mj, 1, theirs)
    yield "joint_torque_regressor", "MuJoCo", torques, theirs[columns]
    linear, angular = np.zeros((2, 3, model.nv))
    mujoco.mj_jacSubtreeCom(model, mj, linear, 0)
    mujoco.mj_angmomMat(model, mj, angular, 0)
    yield "com_jacobian", "MuJoCo", config.com_jacobian(), linear[:, columns]
    expected = np.vstack([model.body_subtreemass[0] * linear, angular])[:, columns]
    yield "centroidal_map", "MuJoCo", config.centroidal_map(), expected
    if robot.floating:  # Pinocchio's model lacks the mass of a fixed base
        data = pin_model.createData()
        expected = pin.jacobianCenterOfMass(pin_model, data, q) @ mapping
        yield "com_jacobian", "Pinocchio", config.com_jacobian(), expected
        theirs = pin.computeCentroidalMapTimeVariation(pin_model, data, q, velocity)
        yield "centroidal_map", "Pinocchio", config.centroidal_map(), data.Ag @ mapping
        # Pinocchio's derivative keeps the CoM in place (pinocchio#2093).
        moved = theirs.copy()
        moved[3:] -= pin.skew(config.com_jacobian() @ config.qvel) @ data.Ag[:3]
        mine = config.centroidal_map_time_variation()
        expected = moved @ mapping + data.Ag @ rate
        yield "centroidal_map_time_variation", "Pinocchio", mine, expected


EFFORT = 50.0
"""Effort limit of all motors [N m, N] in the comparison of force polytopes. Chosen: it holds the
static load of most states, so that few forces are 0."""


def compare_forces(config: pa.Configuration, offset: Array) -> Iterator[Row]:
    """Yield the largest forces on each link in 26 directions, by a closed form with both engines.

    A force F u is withstood by a motor with the static load l if |l - F J^T u| is at most the
    limit; the result is the smallest F of all motors, and 0 if a static load exceeds the limit.
    Robots with closed loops are left out: their motors bear forces through the loops.
    """
    robot, (_, columns) = config.robot, addresses(config.robot)
    if robot.closure is not None:  # motors bear forces through loops
        return
    strong = with_efforts(robot, EFFORT)
    at_rest = pa.Configuration(strong, config.qpos)
    still = evaluate_mujoco(robot, config.qpos, np.zeros(robot.nv))
    _, q, mapping, _ = compute_by_pinocchio(at_rest)
    gravity = mapping.T @ pin.computeGeneralizedGravity(robot.pin_model, robot.pin_data(), q)
    joints = slice(robot.nv - robot.nu, None)
    springs = still.qfrc_passive[columns][joints]
    data = robot.pin_data()
    pin.computeJointJacobians(robot.pin_model, data, q)
    pin.updateFramePlacements(robot.pin_model, data)
    loads = {
        "Pinocchio": gravity[joints] - springs,
        "MuJoCo": still.qfrc_bias[columns][joints] - springs,
    }
    directions = [
        np.array(way) for way in itertools.product((-1.0, 0.0, 1.0), repeat=3) if any(way)
    ]
    for name, body in links(robot):
        place = (name, *offset)
        polytope = pa.statics.force_polytope(at_rest, place)
        frame = robot.pin_model.getFrameId(name, pin.FrameType.BODY)
        six = pin.getFrameJacobian(robot.pin_model, data, frame, pin.LOCAL_WORLD_ALIGNED)
        lever = data.oMf[frame].rotation @ offset
        by_pin = (six.reshape(6, -1)[:3] - pin.skew(lever) @ six.reshape(6, -1)[3:]) @ mapping
        rows = np.zeros((3, robot.mj_model.nv))
        mujoco.mj_jac(robot.mj_model, still, rows, None, polytope.point, body)
        for engine, jacobian in (("Pinocchio", by_pin), ("MuJoCo", rows[:, columns])):
            load = loads[engine]
            for way in directions:
                unit = way / np.linalg.norm(way)
                lever_arms = unit @ jacobian[:, joints]
                bearing = np.abs(lever_arms) > MIN_LEVER_ARM
                moving = np.isin(robot.joint_names, polytope.joints)
                if not bearing.any():
                    continue
                ends = (EFFORT + np.sign(lever_arms) * load)[bearing] / np.abs(lever_arms[bearing])
                overloaded = bool((np.abs(load[moving]) > EFFORT).any())
                expected = 0.0 if overloaded else float(ends.min())
                # Relative to 1 N or the force: lever arms near zero give forces of 1e9 N.
                mine = polytope.largest_force(unit)
                size = max(1.0, abs(expected))
                yield "force_polytope", engine, np.array(mine / size), np.array(expected / size)


REGION_LEVERS = (0.03, 0.1, 0.3)
"""Effort limits of all motors over the weight [m] in the comparison of support regions. Chosen: of
each robot, motors limit some regions, and some states of most robots have no equilibrium."""

REGION_FRICTION = 0.5
"""Sliding friction coefficient in the comparison of support regions."""


def compare_regions(config: pa.Configuration, offset: Array) -> Iterator[Row]:
    """Yield the extents [m] of the support region in a random and the opposite direction.

    The reference are linear programs with tangent planes of the friction cones (HiGHS), with
    points, Jacobians and loads of MuJoCo. The contact points are where the random joint positions
    put them. Without equilibrium the extents are 0. Robots with closed loops, a fixed base or less
    than three contact points are left out.
    """
    robot = config.robot
    if not robot.floating or robot.closure is not None or len(robot.contact_points) < 3:
        return
    normals = {name: np.array([0.0, 0.0, 1.0]) for name in robot.contact_points}
    direction = offset[:2] / np.linalg.norm(offset[:2])
    for lever in REGION_LEVERS:
        at_rest = pa.Configuration(with_efforts(robot, lever * robot.weight), config.qpos)
        region = pa.statics.support_region(at_rest, friction=REGION_FRICTION)
        for way in (direction, -direction):
            expected = farthest_by_linear_programs(at_rest, normals, REGION_FRICTION, way)
            corners = region.corners @ way
            mine = float(corners.max()) if corners.size else -np.inf
            if np.isinf(expected) and np.isinf(mine):
                mine = expected = 0.0
            yield "support_region", "MuJoCo", np.array(mine), np.array(expected)


@click.command()
@click.option("--table", is_flag=True, help="Write docs/data/configuration-errors.csv.")
def main(*, table: bool) -> None:
    """Print the maximum error of each function against each engine."""
    errors: dict[str, dict[str, float]] = defaultdict(dict)
    worst: dict[str, tuple[float, str]] = defaultdict(lambda: (0.0, ""))
    for name in ODD:
        with TemporaryDirectory() as folder:
            robot = load_odd_robot(name, Path(folder))
            for config, _, offset in states(robot):
                mj = evaluate_mujoco(robot, config.qpos, config.qvel)
                rows = [
                    *compare_frames(config, mj, offset),
                    *compare_dynamics(config, mj),
                    *compare_forces(config, offset),
                    *compare_regions(config, offset),
                ]
                for function, engine, value, expected in rows:
                    size = max(1.0, float(np.abs(expected).max(initial=0.0)))
                    error = float(np.abs(value - expected).max(initial=0.0)) / size
                    errors[function][engine] = max(errors[function].get(engine, 0.0), error)
                    worst[function] = max(worst[function], (error, name))
    lines = [
        (function, *(format_error(found.get(engine)) for engine in ("Pinocchio", "MuJoCo")),
         worst[function][1])
        for function, found in errors.items()
    ]  # fmt: skip
    for line in lines:
        print(*line, sep="  ")
    print(f"{len(ODD)} robots, {STATES} states each")
    if table:
        columns = ("function", "error against Pinocchio", "error against MuJoCo", "worst robot")
        write_csv(ROOT / "docs" / "data" / "configuration-errors.csv", columns, lines)


def format_error(error: float | None) -> str:
    """Return an error with two digits; "" without a reference."""
    return "" if error is None else f"{error:.1e}"


if __name__ == "__main__":
    main()
