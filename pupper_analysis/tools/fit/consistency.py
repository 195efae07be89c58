"""Estimates that a body can have: masses above zero, coms within links."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import clarabel
import mujoco
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy import sparse

from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.base.errors import FitError
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.fit.estimate import Posterior
from pupper_analysis.tools.fit.parameters import KINDS, ParameterTable

Array = NDArray[np.float64]

_LEAST = 0.01
"""Of a stated mass or stiffness: a link that weighs a hundredth of it is another link."""

_OUTSIDE = 0.005
"""m: shapes leave out covers, screws and cables, and are drawn by hand."""

_BINDING = 1e-6
"""Standard deviations: a multiplier above it holds an estimate; the others are rounding."""


_NONE = 1e-300
"""What no row is divided by."""


@dataclass(frozen=True, eq=False)
class _Bound:
    """Rows G x <= h of one constraint.

    Attributes:
        matrix: (m, n).
        right: (m,).
        message: What is said where it holds an estimate.
    """

    matrix: Array
    right: Array
    message: Diagnostic


def make_consistent(robot: Robot, posterior: Posterior) -> tuple[Array, tuple[Diagnostic, ...]]:
    """Returns the parameters that a body can have and that are nearest to the estimate.

    Nearest in the metric of the posterior's covariance C: the least (x - mean)^T C^-1 (x - mean)
    with: masses and what else is positive above zero; coms within 5 mm of the hull of their link's
    shapes, or of where the file has them. The density pattern of the file stays, so that an inertia
    is one that a body can have. By Clarabel.

    Args:
        robot: The robot, as its files have it.
        posterior: The estimate.

    Returns:
        (n,) the parameters, and which constraints hold them: none, and the estimate itself, if it
        is consistent.

    Raises:
        FitError: If nothing is.
    """
    mean = np.array(posterior.mean, dtype=float)
    bounds = list(_bounds(robot, posterior))
    if all(_holds(bound, mean) for bound in bounds):
        return mean, ()
    # x = mean + spread y, where y has the covariance 1: the least |y|.
    widths = np.array([one.width for one in posterior.parameters])
    scaled = posterior.covariance / np.outer(widths, widths)
    spread = widths[:, None] * np.linalg.cholesky(scaled)
    rows: list[Array] = []
    right: list[Array] = []
    for bound in bounds:
        matrix, rest = bound.matrix @ spread, bound.right - bound.matrix @ mean
        sizes = np.maximum(np.linalg.norm(matrix, axis=1), _NONE)  # rows in standard deviations
        rows.append(matrix / sizes[:, None])
        right.append(rest / sizes)
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    n = len(mean)
    solution = clarabel.DefaultSolver(
        sparse.identity(n, format="csc"),
        np.zeros(n),
        sparse.csc_matrix(np.concatenate(rows)),
        np.concatenate(right),
        [clarabel.NonnegativeConeT(len(one)) for one in right],
        settings,
    ).solve()
    if solution.status not in (clarabel.SolverStatus.Solved, clarabel.SolverStatus.AlmostSolved):
        raise FitError(diagnose("no-consistent-estimate"))
    step, multipliers = np.array(solution.x), np.array(solution.z)
    found, at = [], 0
    for bound in bounds:
        if np.abs(multipliers[at : at + len(bound.right)]).max(initial=0.0) > _BINDING:
            found.append(bound.message)
        at += len(bound.right)
    off = float(np.linalg.norm(step))
    return mean + spread @ step, (*found, diagnose("estimate-moved", deviations=off))


def _holds(bound: _Bound, x: Array) -> bool:
    return bool((bound.right - bound.matrix @ x >= 0).all())


def _bounds(robot: Robot, posterior: Posterior) -> Iterator[_Bound]:
    parameters = posterior.parameters
    place = {(one.kind, one.subject, one.component): at for at, one in enumerate(parameters)}
    for at, one in enumerate(parameters):
        if KINDS[one.kind].positive:
            least = _LEAST * one.stated if one.kind in ("mass", "kp") else 0.0
            value = Quantity(least, one.unit)
            finding = diagnose("held-above-zero", parameter=one.name, least=value)
            yield _Bound(-np.eye(1, len(parameters), at), np.array([-least]), finding)
    for link in dict.fromkeys(one.subject for one in parameters if one.kind == "com"):
        yield from _within_hull(robot, posterior, place, link)


def _within_hull(
    robot: Robot, posterior: Posterior, place: dict[tuple[str, str, str], int], link: str
) -> Iterator[_Bound]:
    normals, reach = hull_of(robot, link)
    if not len(reach):
        return
    stated = np.array(_inertia(robot, link).lever)
    matrix, known = np.zeros((3, len(posterior.parameters))), stated.copy()
    for axis, component in enumerate("xyz"):
        at = place.get(("com", link, component))
        if at is not None:
            matrix[axis, at], known[axis] = 1.0, 0.0
    # What the file says is not called impossible here: its audit does.
    reach = np.maximum(reach, normals @ stated) + _OUTSIDE
    finding = diagnose("com-held-in-hull", link=link, margin=Quantity(_OUTSIDE, "m"))
    yield _Bound(normals @ matrix, reach - normals @ known, finding)


def _inertia(robot: Robot, link: str) -> pin.Inertia:
    model = robot.pin_model
    at = model.frames[model.getFrameId(link, pin.FrameType.BODY)].parentJoint
    return model.inertias[at]


# The convex hulls of links: where a centre of mass can be.


_G = mujoco.mjtGeom

_UNBOUNDED = (_G.mjGEOM_PLANE.value, _G.mjGEOM_HFIELD.value)

_DIRECTIONS = np.array(
    [d for d in itertools.product((-1.0, 0.0, 1.0), repeat=3) if any(d)], dtype=float
)
"""To the faces, edges and corners of a cube: between them a hull is off by a tenth of its size."""


def hull_of(robot: Robot, link: str) -> tuple[Array, Array]:
    """Returns a polytope around all shapes that move with a link: N c <= b.

    All shapes of MuJoCo's model count, also those that touch nothing. The polytope has faces along
    the link's axes and diagonals, and along the axes of each shape: boxes are exact.

    Args:
        robot: The robot; at zero angles both of its models are one robot.
        link: A link of the URDF.

    Returns:
        N (n, 3) of length 1, and b (n,), in the frame of the joint that moves the link (m); empty
        if it has no shapes.
    """
    model, pin_model = robot.mj_model, robot.pin_model
    frame = pin_model.frames[pin_model.getFrameId(link, pin.FrameType.BODY)]
    here = _joint_pose(robot, link, frame)
    body = _body_of(robot, int(frame.parentJoint))
    data = mujoco.MjData(model)
    robot.mj_convention.set_state(data, robot.neutral())
    mujoco.mj_kinematics(model, data)
    group = np.flatnonzero(model.body_weldid == model.body_weldid[body])
    geoms = [
        geom
        for geom in np.flatnonzero(np.isin(model.geom_bodyid, group)).tolist()
        if model.geom_bodyid[geom] and model.geom_type[geom] not in _UNBOUNDED
    ]
    if not geoms:
        return np.zeros((0, 3)), np.zeros(0)
    placed = []
    for geom in geoms:
        there = pin.SE3(data.geom_xmat[geom].reshape(3, 3), np.array(data.geom_xpos[geom]))
        placed.append((geom, here.actInv(there)))
    turns = [np.array(place.rotation).T for _, place in placed]
    own = np.unique(np.round(np.concatenate([*turns, *(-turn for turn in turns)]), 9), axis=0)
    directions = np.concatenate([_DIRECTIONS, own])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    reach = np.max(
        [
            directions @ place.translation + _reach(model, geom, directions @ place.rotation)
            for geom, place in placed
        ],
        axis=0,
    )
    return directions, reach


def unbounded_coms(robot: Robot, table: ParameterTable) -> Iterator[Diagnostic]:
    """Yields one diagnostic of the links whose com is estimated, and which no shape bounds.

    Args:
        robot: The robot.
        table: What is estimated.
    """
    links = dict.fromkeys(one.subject for one in table if one.kind == "com")
    bare = [link for link in links if not len(hull_of(robot, link)[1])]
    if bare:
        yield diagnose("links-without-shapes", links=bare)


def _joint_pose(robot: Robot, link: str, frame: pin.Frame) -> pin.SE3:
    config = Configuration(robot, robot.neutral())
    pose = pin.SE3(config.frame_rotation(link), config.frame_position(link))
    return pose * frame.placement.inverse()


def _body_of(robot: Robot, joint: int) -> int:
    """Returns the body (MuJoCo's id) that a joint of Pinocchio moves; the base's of others."""
    name, model = str(robot.pin_model.names[joint]), robot.mj_model
    if name not in robot.joint_names:
        return int(model.body(robot.mj_base).id)
    return int(model.jnt_bodyid[model.joint(name).id])


def _reach(model: mujoco.MjModel, geom: int, directions: Array) -> Array:
    """Returns how far a shape reaches along directions (n, 3) in its frame (m)."""
    kind, (x, y, z) = model.geom_type[geom], model.geom_size[geom].tolist()
    along, size = np.abs(directions), np.array([x, y, z])
    if kind == _G.mjGEOM_MESH:
        mesh = int(model.geom_dataid[geom])
        start = int(model.mesh_vertadr[mesh])
        corners = model.mesh_vert[start : start + int(model.mesh_vertnum[mesh])]
        return np.asarray((directions @ corners.T).max(axis=1), dtype=float)
    if kind == _G.mjGEOM_SPHERE:
        return np.full(len(directions), x)
    if kind == _G.mjGEOM_CAPSULE:
        return np.asarray(x + y * along[:, 2], dtype=float)
    if kind == _G.mjGEOM_CYLINDER:
        return np.asarray(x * np.hypot(along[:, 0], along[:, 1]) + y * along[:, 2], dtype=float)
    if kind == _G.mjGEOM_ELLIPSOID:
        return np.asarray(np.linalg.norm(directions * size, axis=1), dtype=float)
    if kind == _G.mjGEOM_BOX:
        return np.asarray(along @ size, dtype=float)
    return np.full(len(directions), float(model.geom_rbound[geom]))
